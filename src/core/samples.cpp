#include "samples.hpp"

#include <cmath>

#include "eight.hpp"

namespace liaam {

namespace {

// P(theta_2) (eq 7 and 8) and its derivative.
void set_metric(const Method& method, double theta_2, Samples& samples) {
    const auto c = static_cast<float>(std::cos(theta_2));
    const auto s = static_cast<float>(std::sin(theta_2));
    const auto& [constant, by_cos, by_sin] = method.metric;
    for (auto* each : {&samples.metric, &samples.metric_slope}) each->resize(constant.size());
    for (std::size_t i = 0; i < constant.size(); ++i) {
        samples.metric[i] = constant[i] + c * by_cos[i] + s * by_sin[i];
        samples.metric_slope[i] = c * by_sin[i] - s * by_cos[i];
    }
}

// Combines constant, cos and sin parts at an angle.
void combine_parts(const std::array<MatrixView<const float>, 3>& parts, double theta, std::vector<float>& out) {
    const auto c = static_cast<float>(std::cos(theta)), s = static_cast<float>(std::sin(theta));
    const float *constant = parts[0].data, *by_cos = parts[1].data, *by_sin = parts[2].data;
    out.resize(parts[0].n_rows * parts[0].n_columns);
#pragma omp simd
    for (std::size_t i = 0; i < out.size(); ++i) out[i] = constant[i] + c * by_cos[i] + s * by_sin[i];
}

// Mean, modes and their gradients, projected by P(theta_1); those of the model where theta_1 is fixed.
Modes modes_at(const Objective& objective, double theta_1, SamplingRoom& room) {
    const Model& model = objective.model;
    if (!model.theta_1_is_free()) return model.modes;
    const std::size_t width = objective.width(), n_rows = model.modes.values.n_rows;
    const std::size_t n_columns = model.modes.values.n_columns;
    combine_parts(model.mode_parts, theta_1, room.modes);
    combine_parts(model.gradient_parts, theta_1, room.mode_gradients);
    room.transposed_modes.assign(width * n_columns, 0.0f);
    for (std::size_t e = 0; e < n_columns; ++e)
        for (std::size_t j = 1; j < n_rows; ++j) room.transposed_modes[e * width + j - 1] = room.modes[j * n_columns + e];
    return {{room.modes.data(), n_rows, n_columns},
            room.transposed_modes,
            {room.mode_gradients.data(), n_rows, model.modes.gradients.n_columns}};
}

// Samples the image bilinearly, and projects samples and gradients by P(theta_2). The gradient is the derivative of the
// interpolant, so that the Jacobian is that of the cost; on a line of pixels it is the one from the right or below.
void sample_image(const EncodedImage& image, const SamplePoints& points, std::size_t k, Samples& samples) {
    const std::size_t n = points.corner.size();
    const float* pixels = image.pixels.data();
    const std::size_t below = kChannels * image.width;
    const auto xx = static_cast<float>(image.from_model.xx), xy = static_cast<float>(image.from_model.xy);
    const auto yx = static_cast<float>(image.from_model.yx), yy = static_cast<float>(image.from_model.yy);
    const float* metric = samples.metric.data();
    samples.values.resize(kChannels * n);
    samples.projected.resize(k * n);
    samples.gradients.resize(2 * k * n);
    samples.usable.resize(n);
    for (std::size_t i = 0; i < n; ++i) {
        const float* at = pixels + kChannels * points.corner[i];
        const float u = points.across[i], v = points.down[i], keep = points.inside[i];
        const Eight c00 = load(at), c10 = load(at + kChannels);
        const Eight c01 = load(at + below), c11 = load(at + below + kChannels);
        const Eight upper = c10 - c00, lower = c11 - c01, top = c00 + u * upper;
        const Eight by_row = keep * (c01 + u * lower - top), by_column = keep * (upper + v * (lower - upper));
        const Eight value = keep * top + v * by_row;
        store(samples.values.data() + kChannels * i, value);
        const bool usable = c00[7] > 0.0f && c10[7] > 0.0f && c01[7] > 0.0f && c11[7] > 0.0f;
        samples.usable[i] = usable ? keep : 0.0f;
        const Eight by_x = xx * by_column + yx * by_row, by_y = xy * by_column + yy * by_row;
        for (std::size_t r = 0; r < k; ++r) {
            const Eight row = load(metric + kChannels * r);
            const std::size_t e = i * k + r;
            samples.projected[e] = sum(row * value);
            samples.gradients[2 * e] = sum(row * by_x);
            samples.gradients[2 * e + 1] = sum(row * by_y);
        }
    }
}

}  // namespace

const Samples& sample(const Objective& objective, const EncodedImage& image, const State& state, SamplingRoom& room) {
    Samples& samples = room.samples;
    samples.angles = state.angles;
    set_metric(objective.method, state.angles[1], samples);
    samples.modes = modes_at(objective, state.angles[0], room);
    vertices_at(objective.model.mesh, state.p, samples.vertices);
    warp_pixels(objective.model.mesh, samples.vertices, image.from_model, image.width, image.height, room.points);
    sample_image(image, room.points, objective.k(), samples);
    return samples;
}

}  // namespace liaam
