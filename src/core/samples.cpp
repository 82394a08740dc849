#include "samples.hpp"

#include <cmath>

#include "eight.hpp"

namespace liaam {

namespace {

constexpr std::size_t kAhead = 8;  // pixels that are fetched before they are needed, which lie scattered in the image

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

// The mean at theta_1, from its constant, cos and sin part where that is free.
Floats mean_at(const MatrixView<const float>& parts, double theta_1, std::vector<float>& room) {
    if (parts.n_rows == 1) return parts[0];
    const auto c = static_cast<float>(std::cos(theta_1)), s = static_cast<float>(std::sin(theta_1));
    const float *constant = parts[0].data(), *by_cosine = parts[1].data(), *by_sine = parts[2].data();
    room.resize(parts.n_columns);
#pragma omp simd
    for (std::size_t e = 0; e < room.size(); ++e) room[e] = constant[e] + c * by_cosine[e] + s * by_sine[e];
    return room;
}

Modes modes_at(Modes modes, double theta_1) {
    modes.cosine = static_cast<float>(std::cos(theta_1));
    modes.sine = static_cast<float>(std::sin(theta_1));
    return modes;
}

// Mean, modes and their gradients, projected by P(theta_1).
void set_appearance(const Model& model, double theta_1, SamplingRoom& room) {
    Samples& samples = room.samples;
    samples.mean = mean_at(model.appearance.mean, theta_1, room.mean);
    samples.mean_gradients = mean_at(model.gradients.mean, theta_1, room.mean_gradients);
    samples.modes = modes_at(model.appearance.modes, theta_1);
    samples.mode_gradients = modes_at(model.gradients.modes, theta_1);
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
        const float* next = pixels + kChannels * points.corner[std::min(i + kAhead, n - 1)];
        prefetch(next);
        prefetch(next + 2 * kChannels - 1);
        prefetch(next + below);
        prefetch(next + below + 2 * kChannels - 1);
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
    set_appearance(objective.model, state.angles[0], room);
    vertices_at(objective.model.mesh, state.p, samples.vertices);
    warp_pixels(objective.model.mesh, samples.vertices, image.from_model, image.width, image.height, room.points);
    sample_image(image, room.points, objective.k(), samples);
    return samples;
}

}  // namespace liaam
