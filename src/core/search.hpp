// Peaks of the search: correlation of orientations in the Fourier domain, and the largest local maxima.
#pragma once

#include <vector>

#include "arrays.hpp"

namespace liaam {

// Spectrum of the correlation of two images of two channels, left conj(right) summed over the channels. All are Fourier
// transforms of real images (h, w) as packed by OpenCV's dft.
void correlate(const float* left, const float* right, std::size_t height, std::size_t width, float* product);

struct Peak {
    std::int64_t row, column;
    float value;
};

// Up to `count` local maxima above `least`, the largest first; ties in raster order. No pixel within a square of `reach`
// pixels around a maximum is larger. `stride` is the distance between rows.
std::vector<Peak> best_peaks(const float* image, std::ptrdiff_t height, std::ptrdiff_t width, std::ptrdiff_t stride,
                             std::size_t count, float least, std::ptrdiff_t reach);

}  // namespace liaam
