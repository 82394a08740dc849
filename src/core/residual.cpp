#include "residual.hpp"

#include <cmath>

#include "eight.hpp"
#include "modes.hpp"

namespace liaam {

namespace {

// P(theta_2) (eq 7 and 8) and its derivative.
void set_metric(const Method& method, Workspace& work) {
    const auto c = static_cast<float>(std::cos(work.state.angles[1]));
    const auto s = static_cast<float>(std::sin(work.state.angles[1]));
    const auto& [constant, by_cos, by_sin] = method.metric;
    for (std::size_t i = 0; i < work.metric.size(); ++i) {
        work.metric[i] = constant[i] + c * by_cos[i] + s * by_sin[i];
        work.metric_slope[i] = c * by_sin[i] - s * by_cos[i];
    }
}

// Combines constant, cos and sin parts at an angle.
void combine_parts(const std::array<Rows<const float>, 3>& parts, double theta, std::vector<float>& out) {
    const auto c = static_cast<float>(std::cos(theta)), s = static_cast<float>(std::sin(theta));
    const float *constant = parts[0].data, *by_cos = parts[1].data, *by_sin = parts[2].data;
    out.resize(parts[0].n_rows * parts[0].n_columns);
#pragma omp simd
    for (std::size_t i = 0; i < out.size(); ++i) out[i] = constant[i] + c * by_cos[i] + s * by_sin[i];
}

// Projects mean, modes and their gradients by P(theta_1), where theta_1 is free.
void project_model(const Objective& objective, Workspace& work) {
    const Model& model = objective.model;
    const std::size_t width = objective.width(), n_rows = model.rows.n_rows, n_columns = model.rows.n_columns;
    combine_parts(model.row_parts, work.state.angles[0], work.own_rows);
    combine_parts(model.slope_parts, work.state.angles[0], work.own_slopes);
    work.own_lines.assign(width * n_columns, 0.0f);
    for (std::size_t e = 0; e < n_columns; ++e)
        for (std::size_t j = 1; j < n_rows; ++j) work.own_lines[e * width + j - 1] = work.own_rows[j * n_columns + e];
    work.rows = {work.own_rows.data(), n_rows, n_columns};
    work.slopes = {work.own_slopes.data(), n_rows, model.slopes.n_columns};
    work.lines = work.own_lines;
}

// Samples the image bilinearly, and projects samples and gradients by P(theta_2). The gradient is the derivative of the
// interpolant, so that the Jacobian is that of the cost; on a line of pixels it is the one from the right or below.
void sample(const EncodedImage& image, std::size_t k, Workspace& work) {
    const float* pixels = image.pixels.data();
    const std::size_t below = kChannels * image.width;
    const auto xx = static_cast<float>(image.from_model.xx), xy = static_cast<float>(image.from_model.xy);
    const auto yx = static_cast<float>(image.from_model.yx), yy = static_cast<float>(image.from_model.yy);
    const float* metric = work.metric.data();
    for (std::size_t i = 0; i < work.usable.size(); ++i) {
        const float* at = pixels + kChannels * work.places.corner[i];
        const float u = work.places.across[i], v = work.places.down[i], keep = work.places.inside[i];
        const Eight c00 = load(at), c10 = load(at + kChannels);
        const Eight c01 = load(at + below), c11 = load(at + below + kChannels);
        const Eight upper = c10 - c00, lower = c11 - c01, top = c00 + u * upper;
        const Eight by_row = keep * (c01 + u * lower - top), by_column = keep * (upper + v * (lower - upper));
        const Eight value = keep * top + v * by_row;
        store(work.values.data() + kChannels * i, value);
        const bool usable = c00[7] > 0.0f && c10[7] > 0.0f && c01[7] > 0.0f && c11[7] > 0.0f;
        work.usable[i] = usable ? keep : 0.0f;
        const Eight by_x = xx * by_column + yx * by_row, by_y = xy * by_column + yy * by_row;
        for (std::size_t r = 0; r < k; ++r) {
            const Eight row = load(metric + kChannels * r);
            const std::size_t e = i * k + r;
            work.residual[e] = sum(row * value);
            work.gradients[2 * e] = sum(row * by_x);
            work.gradients[2 * e + 1] = sum(row * by_y);
        }
    }
}

// Subtracts the appearance (eq 4) from the samples.
void subtract_appearance(Workspace& work) {
    const float* mean = work.rows[0].data();
    float* residual = work.residual.data();
#pragma omp simd
    for (std::size_t e = 0; e < work.residual.size(); ++e) residual[e] -= mean[e];
    if (std::any_of(work.state.lam.begin(), work.state.lam.end(), [](double each) { return each != 0.0; }))
        add_modes(work.rows, work.state.lam, -1.0, work.residual);
}

}  // namespace

void evaluate_residual(const Objective& objective, const EncodedImage& image, Workspace& work, bool solves) {
    set_metric(objective.method, work);
    if (objective.model.theta_1_is_free()) project_model(objective, work);
    vertices_at(objective.model.mesh, work.state.p, work.vertices);
    warp_pixels(objective.model.mesh, work.vertices, image.from_model, image.width, image.height, work.places);
    sample(image, objective.k(), work);
    if (solves) std::fill(work.state.lam.begin(), work.state.lam.end(), 0.0);
    subtract_appearance(work);
}

}  // namespace liaam
