#include "painting.hpp"

#include <cmath>

namespace liaam {

namespace {

constexpr double kOnEdge = 1e-9;  // tolerance on negative barycentric weights of pixels on an edge

std::ptrdiff_t clipped(double at, std::size_t limit) {
    if (!(at > 0.0)) return 0;  // also for NaN
    return static_cast<std::ptrdiff_t>(std::min(at, static_cast<double>(limit)));
}

// Moves each number of `row` towards that of `from` by its feedback.
void follow(float* row, const float* from, std::size_t depth, float feedback) {
    for (std::size_t k = 0; k < depth; ++k) row[k] += feedback * (from[k] - row[k]);
}

}  // namespace

void carry_values(Doubles points, Rows<const std::int32_t> triangles, Rows<const double> values, Rows<std::int32_t> owner,
                  double* carried) {
    const std::size_t depth = values.n_columns;
    for (std::size_t t = 0; t < triangles.n_rows; ++t) {
        const auto triangle = triangles[t];
        const double *a = &points[2 * triangle[0]], *b = &points[2 * triangle[1]], *c = &points[2 * triangle[2]];
        const double x0 = b[0] - a[0], y0 = b[1] - a[1], x1 = c[0] - a[0], y1 = c[1] - a[1];
        const double determinant = x0 * y1 - x1 * y0;
        if (determinant == 0.0) continue;
        const auto top = clipped(std::floor(std::min({a[1], b[1], c[1]})), owner.n_rows);
        const auto bottom = clipped(std::ceil(std::max({a[1], b[1], c[1]})) + 1, owner.n_rows);
        const auto left = clipped(std::floor(std::min({a[0], b[0], c[0]})), owner.n_columns);
        const auto right = clipped(std::ceil(std::max({a[0], b[0], c[0]})) + 1, owner.n_columns);
        for (auto y = top; y < bottom; ++y) {
            for (auto x = left; x < right; ++x) {
                const double dx = x - a[0], dy = y - a[1];
                const double v = (y1 * dx - x1 * dy) / determinant, w = (x0 * dy - y0 * dx) / determinant;
                const double u = 1.0 - v - w;
                std::int32_t& own = owner[y][x];
                if (own >= 0 || u < -kOnEdge || v < -kOnEdge || w < -kOnEdge) continue;
                own = static_cast<std::int32_t>(t);
                double* out = carried + (y * owner.n_columns + x) * depth;
                for (std::size_t n = 0; n < depth; ++n)
                    out[n] = u * values[triangle[0]][n] + v * values[triangle[1]][n] + w * values[triangle[2]][n];
            }
        }
    }
}

void draw_triangles(Rows<const double> points, Rows<const std::int32_t> triangles, Rows<const double> attributes,
                    Rows<double> nearness, float* image) {
    const std::size_t depth = attributes.n_columns;
    for (std::size_t t = 0; t < triangles.n_rows; ++t) {
        const auto triangle = triangles[t];
        const double *a = points[triangle[0]].data(), *b = points[triangle[1]].data(), *c = points[triangle[2]].data();
        const double area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
        if (area == 0.0) continue;
        const auto left = clipped(std::ceil(std::min({a[0], b[0], c[0]})), nearness.n_columns);
        const auto right = clipped(std::floor(std::max({a[0], b[0], c[0]})) + 1, nearness.n_columns);
        const auto top = clipped(std::ceil(std::min({a[1], b[1], c[1]})), nearness.n_rows);
        const auto bottom = clipped(std::floor(std::max({a[1], b[1], c[1]})) + 1, nearness.n_rows);
        for (auto y = top; y < bottom; ++y) {
            for (auto x = left; x < right; ++x) {
                const double v = ((x - a[0]) * (c[1] - a[1]) - (y - a[1]) * (c[0] - a[0])) / area;
                const double w = ((b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0])) / area, u = 1.0 - v - w;
                if (u < -kOnEdge || v < -kOnEdge || w < -kOnEdge) continue;
                const double z = u * a[2] + v * b[2] + w * c[2];
                double& nearest = nearness[y][x];
                if (!(z > nearest)) continue;
                nearest = z;
                float* out = image + (y * nearness.n_columns + x) * depth;
                for (std::size_t k = 0; k < depth; ++k)
                    out[k] = static_cast<float>(u * attributes[triangle[0]][k] + v * attributes[triangle[1]][k] +
                                                w * attributes[triangle[2]][k]);
            }
        }
    }
}

void filter_rows(float* layers, std::size_t height, std::size_t width, std::size_t depth, const float* feedback) {
    for (std::size_t y = 0; y < height; ++y) {
        float* row = layers + y * width * depth;
        const float* kept = feedback + y * (width - 1);
        for (std::size_t x = 1; x < width; ++x) follow(row + x * depth, row + (x - 1) * depth, depth, kept[x - 1]);
        for (std::size_t x = width - 1; x-- > 0;) follow(row + x * depth, row + (x + 1) * depth, depth, kept[x]);
    }
}

void filter_columns(float* layers, std::size_t height, std::size_t width, std::size_t depth, const float* feedback) {
    const std::size_t stride = width * depth;
    for (std::size_t y = 1; y < height; ++y)
        for (std::size_t x = 0; x < width; ++x)
            follow(layers + y * stride + x * depth, layers + (y - 1) * stride + x * depth, depth, feedback[(y - 1) * width + x]);
    for (std::size_t y = height - 1; y-- > 0;)
        for (std::size_t x = 0; x < width; ++x)
            follow(layers + y * stride + x * depth, layers + (y + 1) * stride + x * depth, depth, feedback[y * width + x]);
}

}  // namespace liaam
