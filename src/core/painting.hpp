// Loops over the pixels of images for painting and relighting.
#pragma once

#include "arrays.hpp"

namespace liaam {

// Interpolates values of a mesh's vertices at the pixels of an image, (h, w, depth). `owner` becomes the first triangle
// that a pixel lies in, and -1 outside the mesh, where the values stay. Vertices may lie outside the image.
void carry_values(Doubles points, Rows<const std::int32_t> triangles, Rows<const double> values, Rows<std::int32_t> owner,
                  double* carried);

// Draws triangles over a z-buffer, and interpolates their attributes to an image (h, w, depth). The vertices (n, 3) are
// (column, row, nearness); the largest nearness is visible, and of equal ones the first.
void draw_triangles(Rows<const double> points, Rows<const std::int32_t> triangles, Rows<const double> attributes,
                    Rows<double> nearness, float* image);

// Filters (h, w, depth) recursively along each row, forward and backward, with feedback (h, w - 1) between neighbours;
// and along each column, with feedback (h - 1, w) (domain transform, Gastal and Oliveira 2011).
void filter_rows(float* layers, std::size_t height, std::size_t width, std::size_t depth, const float* feedback);
void filter_columns(float* layers, std::size_t height, std::size_t width, std::size_t depth, const float* feedback);

}  // namespace liaam
