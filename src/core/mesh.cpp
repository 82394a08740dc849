#include "mesh.hpp"

#include <cmath>

namespace liaam {

namespace {

constexpr double kFlat = 0.05;  // fraction of its rest area below which a triangle counts as flat

// Two edges of a triangle, from its first vertex.
struct Edges {
    double ux, uy, vx, vy;

    Edges(const double* points, std::span<const std::int64_t> triangle) {
        const double *a = points + 2 * triangle[0], *b = points + 2 * triangle[1], *c = points + 2 * triangle[2];
        ux = b[0] - a[0];
        uy = b[1] - a[1];
        vx = c[0] - a[0];
        vy = c[1] - a[1];
    }
    double twice_area() const { return ux * vy - vx * uy; }
};

}  // namespace

void vertices_at(const Mesh& mesh, Doubles p, std::vector<double>& vertices) {
    vertices.resize(2 * mesh.n_vertices());
    for (std::size_t i = 0; i < vertices.size(); ++i) {
        const double* row = mesh.basis[i].data();
        double moved = mesh.rest.data[i];
#pragma omp simd reduction(+ : moved)
        for (std::size_t j = 0; j < p.size(); ++j) moved += row[j] * p[j];
        vertices[i] = moved;
    }
}

void warp_pixels(const Mesh& mesh, Doubles vertices, const Similarity& to, int width, int height,
                 SamplePoints& points) {
    points.corner.resize(mesh.n_pixels());
    for (auto* each : {&points.across, &points.down, &points.inside}) each->resize(mesh.n_pixels());
    const double right = width - 1.0, bottom = height - 1.0, last_column = width - 2.0, last_row = height - 2.0;
    for (std::size_t t = 0; t < mesh.triangles.n_rows; ++t) {
        const auto triangle = mesh.triangles[t];
        const Edges edges(vertices.data(), triangle);
        const double* a = vertices.data() + 2 * triangle[0];
        const double x0 = to.x_of(a[0], a[1]), y0 = to.y_of(a[0], a[1]);
        const double bx = to.xx * edges.ux + to.xy * edges.uy, by = to.yx * edges.ux + to.yy * edges.uy;
        const double cx = to.xx * edges.vx + to.xy * edges.vy, cy = to.yx * edges.vx + to.yy * edges.vy;
        const auto begin = static_cast<std::size_t>(mesh.starts[t]), end = static_cast<std::size_t>(mesh.starts[t + 1]);
        const float* beta = mesh.beta.data;
#pragma omp simd
        for (std::size_t i = begin; i < end; ++i) {
            const double second = beta[3 * i + 1], third = beta[3 * i + 2];
            double x = x0 + second * bx + third * cx, y = y0 + second * by + third * cy;
            const bool inside = (x >= 0.0) & (y >= 0.0) & (x <= right) & (y <= bottom);  // NaN is outside
            x = inside ? x : 0.0;
            y = inside ? y : 0.0;
            double column = std::floor(x), row = std::floor(y);
            column = column < last_column ? column : last_column;
            row = row < last_row ? row : last_row;
            points.corner[i] = static_cast<std::int32_t>(row * width + column);
            points.across[i] = static_cast<float>(x - column);
            points.down[i] = static_cast<float>(y - row);
            points.inside[i] = inside ? 1.0f : 0.0f;
        }
    }
}

void pull_gradients(const Mesh& mesh, Doubles vertices, Floats slopes, std::span<float> out) {
    const std::size_t n = mesh.n_pixels(), k = n ? slopes.size() / (2 * n) : 0;
    for (std::size_t t = 0; t < mesh.triangles.n_rows; ++t) {
        const Edges now(vertices.data(), mesh.triangles[t]), rest(mesh.rest.data, mesh.triangles[t]);
        const double area = now.twice_area();
        const bool flat = !(std::abs(area) > kFlat * std::abs(rest.twice_area()));  // also for NaN
        const double factor = flat ? 0.0 : 1.0 / area;
        const auto xx = static_cast<float>((rest.ux * now.vy - rest.vx * now.uy) * factor);
        const auto xy = static_cast<float>((rest.vx * now.ux - rest.ux * now.vx) * factor);
        const auto yx = static_cast<float>((rest.uy * now.vy - rest.vy * now.uy) * factor);
        const auto yy = static_cast<float>((rest.vy * now.ux - rest.uy * now.vx) * factor);
        for (auto i = static_cast<std::size_t>(mesh.starts[t]); i < static_cast<std::size_t>(mesh.starts[t + 1]); ++i) {
            const float* by_x = slopes.data() + 2 * i * k;
            const float* by_y = by_x + k;
            float* pulled = out.data() + 2 * i * k;
            for (std::size_t r = 0; r < k; ++r) {
                pulled[2 * r] = xx * by_x[r] + yx * by_y[r];
                pulled[2 * r + 1] = xy * by_x[r] + yy * by_y[r];
            }
        }
    }
}

}  // namespace liaam
