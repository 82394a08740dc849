// Labels of pixels, present or absent, by the mean field of a conditional random field (Krähenbühl and Koltun, NIPS
// 2011). liaam.fitting.quality.segmentation says what for.
#pragma once

#include <vector>

#include "arrays.hpp"

namespace liaam {

// Planes (h, w): the labels from -1 to 1, and their mean around each pixel.
struct MeanField {
    std::vector<float> labels, around;
};

// Updates labels by the log odds `own` of each pixel, and by those of its neighbours: `strength` if all are of one kind.
// Neighbours count by a Gaussian, of which half the taps are given, and if they are `sampled` (1, else 0).
MeanField mean_field(Floats own, Floats sampled, std::ptrdiff_t width, Floats taps, float strength, int rounds);

}  // namespace liaam
