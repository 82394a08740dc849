#include "painting.hpp"

#include <cmath>
#include <limits>

namespace liaam {

namespace {

constexpr double kOnEdge = 1e-9;  // tolerance on negative barycentric weights of pixels on an edge
constexpr double kRounding = 1e-6;  // pixels: more than coordinates within an image are rounded by

std::ptrdiff_t clipped(double at, std::size_t limit) {
    if (!(at > 0.0)) return 0;  // also for NaN
    return static_cast<std::ptrdiff_t>(std::min(at, static_cast<double>(limit)));
}

// The pixels along one axis that a triangle with these coordinates may cover.
struct Stretch {
    std::ptrdiff_t first, end;
};

Stretch covered(double a, double b, double c, std::size_t limit) {
    const auto [low, high] = std::minmax({a, b, c});
    const double beyond = 4.0 * kOnEdge * (high - low) + kRounding;
    return {clipped(std::ceil(low - beyond), limit), clipped(std::floor(high + beyond) + 1.0, limit)};
}

// Moves each number of `row` towards that of `from` by its feedback.
void follow(float* row, const float* from, std::size_t depth, float feedback) {
    for (std::size_t k = 0; k < depth; ++k) row[k] += feedback * (from[k] - row[k]);
}

}  // namespace

void draw_triangles(MatrixView<const double> points, MatrixView<const std::int32_t> triangles, MatrixView<const double> values,
                    MatrixView<std::int32_t> owner, double* drawn) {
    const std::size_t depth = values.n_columns;
    std::vector<double> nearness(owner.n_rows * owner.n_columns, -std::numeric_limits<double>::infinity());
    for (std::size_t t = 0; t < triangles.n_rows; ++t) {
        const auto triangle = triangles[t];
        const double *a = points[triangle[0]].data(), *b = points[triangle[1]].data(), *c = points[triangle[2]].data();
        const double x0 = b[0] - a[0], y0 = b[1] - a[1], x1 = c[0] - a[0], y1 = c[1] - a[1];
        const double determinant = x0 * y1 - x1 * y0;
        if (determinant == 0.0) continue;
        const Stretch rows = covered(a[1], b[1], c[1], owner.n_rows);
        const Stretch columns = covered(a[0], b[0], c[0], owner.n_columns);
        for (auto y = rows.first; y < rows.end; ++y) {
            for (auto x = columns.first; x < columns.end; ++x) {
                const double dx = x - a[0], dy = y - a[1];
                const double v = (y1 * dx - x1 * dy) / determinant, w = (x0 * dy - y0 * dx) / determinant;
                const double u = 1.0 - v - w, near = u * a[2] + v * b[2] + w * c[2];
                const std::size_t pixel = y * owner.n_columns + x;
                if (u < -kOnEdge || v < -kOnEdge || w < -kOnEdge || !(near > nearness[pixel])) continue;
                nearness[pixel] = near;
                owner.data[pixel] = static_cast<std::int32_t>(t);
                for (std::size_t k = 0; k < depth; ++k)
                    drawn[pixel * depth + k] = u * values[triangle[0]][k] + v * values[triangle[1]][k] + w * values[triangle[2]][k];
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
