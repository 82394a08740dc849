// Peaks of the search: correlation of orientations in the Fourier domain, and the largest local maxima.
#pragma once

#include <vector>

#include "arrays.hpp"

namespace liaam {

// Sum over channels of the products of the spectra of an image with the conjugates of those of templates, each
// (n_channels, 2, n): first the real parts, then the imaginary ones. In the product (n, 2) they alternate.
void correlate(const float* image, const float* templates, std::size_t n_channels, std::size_t n, float* product);

// A view of an image (h, w), with the distances between its rows and pixels.
struct Plane {
    const float* data;
    std::ptrdiff_t height, width, by_row, by_pixel;

    const float* row(std::ptrdiff_t y) const { return data + y * by_row; }
    float at(std::ptrdiff_t y, std::ptrdiff_t x) const { return data[y * by_row + x * by_pixel]; }
};

struct Peak {
    std::int64_t row, column;
    float value;
};

// Up to `count` local maxima above `least`, the largest first; ties in raster order. No pixel within a square of `reach`
// pixels around a maximum is larger.
std::vector<Peak> best_peaks(const Plane& image, std::size_t count, float least, std::ptrdiff_t reach);

}  // namespace liaam
