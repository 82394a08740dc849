// A mesh whose vertices follow a shape model, and its piecewise affine warp (paper eq 2 and 3).
#pragma once

#include <vector>

#include "arrays.hpp"

namespace liaam {

// Maps (x, y) to (xx x + xy y + x0, yx x + yy y + y0).
struct Similarity {
    double xx = 1.0, xy = 0.0, x0 = 0.0;
    double yx = 0.0, yy = 1.0, y0 = 0.0;

    double x_of(double x, double y) const { return xx * x + xy * y + x0; }
    double y_of(double x, double y) const { return yx * x + yy * y + y0; }
};

// Views of a model's arrays; pixels are sorted by triangle.
struct Mesh {
    MatrixView<const float> beta;              // (n, 3): barycentric weights of each pixel
    std::span<const std::int64_t> starts;      // (t + 1): first pixel of each triangle, and the end
    MatrixView<const std::int64_t> triangles;  // (t, 3): vertices of each triangle
    MatrixView<const double> rest;             // (v, 2): vertices at p = 0, model pixels
    MatrixView<const double> basis;            // (2 v, w): derivatives of x0, y0, x1, y1 ... by p, padded with zeros
    double movement = 1.0;                     // root mean square movement of the landmarks by a unit step of p

    std::size_t n_pixels() const { return beta.n_rows; }
    std::size_t n_vertices() const { return rest.n_rows; }
};

// The vertices s(p), (v, 2) as x0, y0, x1 ... (eq 2).
void vertices_at(const Mesh& mesh, Doubles p, std::vector<double>& vertices);

// Where each model pixel is sampled in an image: the upper left of the four pixels around it, and the offset from there.
struct SamplePoints {
    std::vector<std::int32_t> corner;    // (n): index of that pixel
    std::vector<float> across, down;     // (n): offset (x, y)
    std::vector<float> inside;           // (n): 1 inside the image, else 0
};

// W(x; p) of every model pixel x, mapped to an image of at least 2 by 2 pixels by a similarity (eq 3).
void warp_pixels(const Mesh& mesh, Doubles vertices, const Similarity& to_image, int width, int height,
                 SamplePoints& points);

// Maps gradients from the reference frame to the image: if V(W(x; p)) = A(x), then grad V = (dW/dx)^-T grad A.
// `slopes` holds k derivatives by x and k by y for each pixel, `out` the derivatives by x and y of each residual.
// Gradients of nearly flat triangles are 0.
void pull_gradients(const Mesh& mesh, Doubles vertices, Floats slopes, std::span<float> out);

}  // namespace liaam
