// Counts of gradient orientations, as regressors see an image (liaam.model.regressor).
#pragma once

#include "encoding.hpp"

namespace liaam {

constexpr std::size_t kOrientations = 8;  // that are counted apart

// The length of the softly normalised gradient of the logarithm of brightness (h, w) at each pixel, split between the two
// nearest orientations: (h, w, 8). `blur`, `pixel` and `turn` of the options count. Pixels that are not `finite`, a
// share of each or nothing, hardly count in the blur.
void count_orientations(const float* brightness, const float* finite, std::ptrdiff_t height, std::ptrdiff_t width,
                        const EncodingOptions& options, const EncodingConstants& constants, std::vector<float>& counts);

// Counts (h, w, 8) after a Gaussian blur, interpolated bilinearly at points (x, y), where alone they are computed. The
// pixels of the border are replicated, and points beyond are moved there.
void blurred_at(const float* counts, std::ptrdiff_t height, std::ptrdiff_t width, MatrixView<const double> points,
                double sigma, float* values);

}  // namespace liaam
