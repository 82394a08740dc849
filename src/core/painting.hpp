// Loops over the pixels of images for painting and relighting.
#pragma once

#include "arrays.hpp"

namespace liaam {

// Draws triangles and interpolates values of their vertices at the pixels of an image, (h, w, depth). The vertices (n, 3)
// are (column, row, nearness), and may lie outside the image; the largest nearness is visible, and of equal ones the
// first. `owner` becomes the triangle that is visible at a pixel; where there is none, it and the values stay.
void draw_triangles(MatrixView<const double> points, MatrixView<const std::int32_t> triangles, MatrixView<const double> values,
                    MatrixView<std::int32_t> owner, double* drawn);

// Filters (h, w, depth) recursively along each row, forward and backward, with feedback (h, w - 1) between neighbours;
// and along each column, with feedback (h - 1, w) (domain transform, Gastal and Oliveira 2011).
void filter_rows(float* layers, std::size_t height, std::size_t width, std::size_t depth, const float* feedback);
void filter_columns(float* layers, std::size_t height, std::size_t width, std::size_t depth, const float* feedback);

}  // namespace liaam
