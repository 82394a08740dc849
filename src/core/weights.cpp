#include "weights.hpp"

#include <cmath>
#include <limits>

#include "elementary.hpp"
#include "modes.hpp"
#include "thresholds.hpp"

namespace liaam {

using thresholds::kAlike;
using thresholds::kChanged;

namespace {

constexpr float kUnknown = 1e5f;              // variance of a pixel whose logarithm is not usable
constexpr double kLeastUnexplained = 0.02;    // least unexplained variance, as a fraction of the residual's
constexpr float kMostDirectionNoise = 0.5f;   // most variance of a component of a direction: that of a random one
constexpr double kCorrelated[2] = {8.0, 30.0};  // factors on correlated pixels, for errors of gradients and of colour
constexpr std::size_t kPlane = 512;           // pixels whose variances are computed together
constexpr std::size_t kGradientRows = 2;      // of `soft`; the others are of colour

// Candidate factors on the model's learnt errors, of which the most likely one is used: 0, and 1e-3 to 30.
const std::array<double, 20>& error_factors() {
    static const std::array<double, 20> factors = [] {
        std::array<double, 20> all{};
        for (std::size_t i = 1; i < all.size(); ++i) all[i] = 1e-3 * std::pow(3e4, (i - 1) / 18.0);
        return all;
    }();
    return factors;
}

// The table of noise, ready for many look-ups.
struct NoiseTable {
    const float* table;
    float first, steps, top;
    std::int32_t last;

    explicit NoiseTable(const EncodedImage& image)
        : table(image.log_noise.data()), first(static_cast<float>(image.first_log)),
          steps(static_cast<float>((image.log_noise.size() - 1) / (image.last_log - image.first_log))),
          top(static_cast<float>(image.log_noise.size() - 1)), last(static_cast<std::int32_t>(image.log_noise.size()) - 2) {}

    float operator()(float log) const {
        float at = (log - first) * steps;
        at = at > 0.0f ? at : 0.0f;  // also for NaN
        at = at < top ? at : top;
        std::int32_t below = static_cast<std::int32_t>(at);
        below = below < last ? below : last;
        return table[below] + (at - static_cast<float>(below)) * (table[below + 1] - table[below]);
    }
};

// Sums over the usable pixels of a row of the metric.
struct RowSums {
    double count = 0.0, squares = 0.0, beyond = 0.0;  // beyond: squares minus the variance of noise
};

// Room for the variances of up to kPlane pixels, by channel.
struct NoisePlanes {
    float counts[kPlane], light[kPlane], spread[kPlane], channel[5][kPlane], by_noise[kPlane], log[kPlane],
        deviation[kPlane];
};

// The variances of the three logarithms of a block of pixels, its light, and the light's variance.
void log_variances(const EncodedImage& image, const Samples& samples, const float* known, std::size_t begin,
                   std::size_t size, const NoiseTable& table, NoisePlanes& planes) {
    const auto keep = static_cast<float>(image.value_noise_gain * image.value_noise_gain);
    for (std::size_t i = 0; i < size; ++i) {
        planes.light[i] = image.constants.log_floor;
        planes.spread[i] = 0.0f;
    }
    for (std::size_t c = 0; c < 3; ++c) {
        const float* values = samples.values.data() + kChannels * begin + 2 + c;
        float* variance = planes.channel[2 + c];
        const float share = image.constants.brightness[c];
        for (std::size_t i = 0; i < size; ++i) {
            planes.log[i] = values[kChannels * i];
            planes.deviation[i] = table(planes.log[i]);
        }
#pragma omp simd
        for (std::size_t i = 0; i < size; ++i) {
            const float log = planes.log[i] < 20.0f ? planes.log[i] : 20.0f;
            const float brightness = share * exp_of(log > -20.0f ? log : -20.0f);
            const float square = planes.deviation[i] * planes.deviation[i];
            planes.light[i] += brightness;
            planes.spread[i] += square * brightness * brightness;
            // The blur reduces noise, but not the bias that the logarithm's curvature makes of it.
            variance[i] = known[i] > 0.0f ? keep * square + 0.25f * square * square : kUnknown;
        }
    }
}

// The variances of the two components of directions: with o = g / sqrt(|g|^2 + s^2),
// do/dg = (I - o o') / sqrt(|g|^2 + s^2), and the square root follows from |o|.
void direction_variances(const EncodedImage& image, const Samples& samples, std::size_t begin, std::size_t size,
                         NoisePlanes& planes) {
    const auto slope = static_cast<float>(std::pow(image.slope_noise_gain / image.constants.softness, 2));
    const float* values = samples.values.data() + kChannels * begin;
    for (std::size_t i = 0; i < size; ++i) {
        const float x = values[kChannels * i], y = values[kChannels * i + 1];
        const float rest = std::max(1.0f - x * x - y * y, 0.0f), bend = 1.0f + rest;
        const float of_slope = slope * planes.spread[i] * rest / (planes.light[i] * planes.light[i]);
        planes.channel[0][i] = std::min(of_slope * (1.0f - x * x * bend), kMostDirectionNoise);
        planes.channel[1][i] = std::min(of_slope * (1.0f - y * y * bend), kMostDirectionNoise);
    }
}

// Adds a block's variance of row r by noise to the sums, and writes it; residual and variance begin at the block.
void add_row(const float* metric, std::size_t r, std::size_t k, std::size_t size, const float* residuals,
             NoisePlanes& planes, float* variance, RowSums& sums) {
    float squared[5];
    for (std::size_t c = 0; c < 5; ++c) squared[c] = metric[kChannels * r + c] * metric[kChannels * r + c];
    const float* residual = residuals + r;
    float count = 0.0f, squares = 0.0f, beyond = 0.0f;
#pragma omp simd
    for (std::size_t i = 0; i < size; ++i)
        planes.by_noise[i] = squared[0] * planes.channel[0][i] + squared[1] * planes.channel[1][i] +
                             squared[2] * planes.channel[2][i] + squared[3] * planes.channel[3][i] +
                             squared[4] * planes.channel[4][i];
    for (std::size_t i = 0; i < size; ++i) {
        const float counted = planes.by_noise[i] < 0.5f * kUnknown ? planes.counts[i] : 0.0f;
        const float square = residual[i * k] * residual[i * k];
        count += counted;
        squares += counted * square;
        beyond += counted * (square - planes.by_noise[i]);
        variance[i * k + r] = planes.by_noise[i];
    }
    sums.count += count;
    sums.squares += squares;
    sums.beyond += beyond;
}

// Whether a pixel is usable and has a weight.
bool counts(const Objective& objective, const Samples& samples, std::size_t i) {
    return samples.usable[i] * objective.model.sqrt_weights[i * objective.k()] > 0.0f;
}

// The variance of each row of `soft` due to noise, to first order, and sums of squared residuals.
std::vector<RowSums> row_variances(const Objective& objective, const EncodedImage& image, const Samples& samples,
                                   Floats residual, std::vector<float>& variance, std::vector<float>& known) {
    const std::size_t n = objective.n(), k = objective.k();
    const NoiseTable table(image);
    std::vector<RowSums> sums(k);
    NoisePlanes planes;
    known.resize(n);
    for (std::size_t begin = 0; begin < n; begin += kPlane) {
        const std::size_t size = std::min(kPlane, n - begin);
        for (std::size_t i = 0; i < size; ++i) {
            const std::size_t at = begin + i;
            known[at] = objective.model.colours && samples.values[kChannels * at + 5] >= 0.99f ? 1.0f : 0.0f;
            planes.counts[i] = counts(objective, samples, at) ? 1.0f : 0.0f;
        }
        log_variances(image, samples, known.data() + begin, begin, size, table, planes);
        direction_variances(image, samples, begin, size, planes);
        for (std::size_t r = 0; r < k; ++r)
            add_row(samples.metric.data(), r, k, size, residual.data() + begin * k, planes, variance.data() + begin * k,
                    sums[r]);
    }
    return sums;
}

// The unexplained variance of both groups of rows: the residual's minus that of noise. Under the light of training the
// invariant gets the larger weight; under another light, or with JPEG's errors of colour, the gradients do. Returns the
// number of residuals that count.
double set_unexplained(const std::vector<RowSums>& sums, std::array<double, 2>& unexplained) {
    double counted = 0.0;
    for (std::size_t group = 0; group < 2; ++group) {
        RowSums total;
        for (std::size_t r = 0; r < sums.size(); ++r) {
            if ((r >= kGradientRows) != (group == 1)) continue;
            total.count += sums[r].count;
            total.squares += sums[r].squares;
            total.beyond += sums[r].beyond;
        }
        counted += total.count;
        const double count = std::max(total.count, 1.0);
        const double least = kLeastUnexplained * total.squares / count + 1e-9;
        unexplained[group] = total.beyond / count > least ? total.beyond / count : least;
    }
    return counted;
}

// Whether the unexplained variance or the set of pixels with usable colour has changed.
bool has_changed(const Weights& weights, const WeighingRoom& now) {
    for (std::size_t group = 0; group < 2; ++group) {
        const double change = std::log(now.unexplained[group] / weights.unexplained_before[group]);
        if (!(change < kAlike && change > -kAlike)) return true;  // NaN is not alike
    }
    std::size_t count = 0;
    for (std::size_t i = 0; i < now.known.size(); ++i) count += now.known[i] != weights.known_before[i];
    return static_cast<double>(count) > kChanged * static_cast<double>(now.known.size());
}

// Square roots of inverse variances (noise plus model), scaled to mean weight 1 over the pixels that count.
void set_row_weights(const Objective& objective, const EncodedImage& image, const Samples& samples,
                     const std::array<double, 2>& unexplained, Weights& weights) {
    const std::size_t n = objective.n(), k = objective.k();
    const Floats own = objective.model.sqrt_weights;
    double precisions = 0.0;
    std::size_t count = 0;
    for (std::size_t r = 0; r < k; ++r) {
        const std::size_t group = r >= kGradientRows;
        const auto pixels_per_dof = static_cast<float>(image.correlated);
        const auto by_model = static_cast<float>(image.correlated * kCorrelated[group] * unexplained[group]);
        float precision = 0.0f;
        for (std::size_t i = 0; i < n; ++i) {
            float& variance = weights.variance[i * k + r];
            variance = pixels_per_dof * variance + by_model;
            if (!counts(objective, samples, i)) continue;
            precision += 1.0f / variance;
            ++count;
        }
        precisions += precision;
    }
    weights.noise_variance = count ? count / precisions : 1.0;
    const auto unit = static_cast<float>(weights.noise_variance);
    float* base = weights.base_sqrt_weights.data();
    const float* variance = weights.variance.data();
#pragma omp simd
    for (std::size_t e = 0; e < n * k; ++e) base[e] = own[e] * std::sqrt(unit / variance[e]);
}

bool weigh_by_rows(const Objective& objective, const EncodedImage& image, const Samples& samples, Floats residual,
                   Weights& weights, WeighingRoom& room) {
    const auto sums = row_variances(objective, image, samples, residual, weights.variance, room.known);
    const double counted = set_unexplained(sums, room.unexplained);
    if (!(counted > 0.0) || !(objective.method.loss != Loss::none || has_changed(weights, room))) return false;
    weights.unexplained_before = room.unexplained;
    weights.known_before = room.known;
    set_row_weights(objective, image, samples, room.unexplained, weights);
    return true;
}

bool any_usable(const Samples& samples) {
    return std::any_of(samples.usable.begin(), samples.usable.end(), [](float each) { return each > 0.0f; });
}

// Negative log likelihood of residuals whose variance by noise is given, if the model's learnt errors are
// multiplied by a factor.
double negative_log_likelihood(const Objective& objective, const Samples& samples, Floats residual, Floats noise,
                               double factor) {
    const std::size_t k = objective.k();
    double cost = 0.0;
    for (std::size_t i = 0; i < objective.n(); ++i) {
        if (!counts(objective, samples, i)) continue;
        double squares = 0.0, by_noise = 0.0;
        for (std::size_t e = i * k; e < (i + 1) * k; ++e) {
            squares += static_cast<double>(residual[e]) * residual[e] / k;
            by_noise += static_cast<double>(noise[e]) / k;
        }
        const double expected = by_noise + factor * objective.model.errors[i] + 1e-300;
        cost += std::log(expected) + squares / expected;
    }
    return cost;
}

// Variances of logarithms due to noise, and of the residuals.
void log_channel_noise(const Objective& objective, const EncodedImage& image, const Samples& samples, Weights& weights) {
    const std::size_t k = objective.k();
    const NoiseTable table(image);
    const auto keep = static_cast<float>(image.value_noise_gain * image.value_noise_gain);
    for (std::size_t i = 0; i < objective.n(); ++i) {
        float* noise = weights.channel_noise.data() + kChannels * i;
        for (std::size_t c = 0; c < 3; ++c) {
            const float deviation = table(samples.values[kChannels * i + c]), square = deviation * deviation;
            noise[c] = keep * square + 0.25f * square * square;  // E log(rho + n) is lower by half the relative variance
        }
        for (std::size_t r = 0; r < k; ++r) {
            float variance = 0.0f;
            for (std::size_t c = 0; c < 3; ++c)
                variance += samples.metric[kChannels * r + c] * samples.metric[kChannels * r + c] * noise[c];
            weights.variance[i * k + r] = variance;
        }
    }
}

// The factor on the model's errors under which the residuals are most likely.
double likeliest_factor(const Objective& objective, const Samples& samples, Floats residual, Floats noise) {
    double factor = 0.0, best = std::numeric_limits<double>::infinity();
    for (const double candidate : error_factors()) {
        const double cost = negative_log_likelihood(objective, samples, residual, noise, candidate);
        if (cost < best) {
            best = cost;
            factor = candidate;
        }
    }
    return factor;
}

void set_model_weights(const Objective& objective, Weights& weights) {
    const Floats own = objective.model.sqrt_weights;
    weights.base_sqrt_weights.assign(own.begin(), own.end());
}

// Variances due to noise and to the model's errors: all that does not depend on theta_2.
bool weigh_by_noise(const Objective& objective, const EncodedImage& image, const Samples& samples, Floats residual,
                    Weights& weights) {
    if (!any_usable(samples)) return false;
    const std::size_t k = objective.k();
    set_model_weights(objective, weights);
    log_channel_noise(objective, image, samples, weights);
    const double factor = likeliest_factor(objective, samples, residual, weights.variance);
    double precision = 0.0;
    std::size_t count = 0;
    for (std::size_t i = 0; i < objective.n(); ++i) {
        weights.model_variance[i] = factor * objective.model.errors[i];
        double mean = 0.0;
        for (std::size_t e = i * k; e < (i + 1) * k; ++e) {
            weights.variance[e] += static_cast<float>(weights.model_variance[i]);
            mean += static_cast<double>(weights.variance[e]) / k;
        }
        if (!counts(objective, samples, i)) continue;
        precision += 1.0 / mean;
        ++count;
    }
    weights.noise_variance = count ? count / precision : 1.0;
    return true;
}

bool weigh_by_model(const Objective& objective, const Samples& samples, Weights& weights) {
    if (!any_usable(samples)) return false;
    set_model_weights(objective, weights);
    return true;
}

// Root mean square residual of each pixel, in standard deviations where these are known; those that count also unsorted.
void set_sizes(const Objective& objective, const Samples& samples, Floats residual, Floats variance, WeighingRoom& room) {
    const std::size_t k = objective.k();
    const bool learnt = objective.method.loss == Loss::learnt;
    room.sizes.resize(objective.n());
    room.sorted.clear();
    for (std::size_t i = 0; i < objective.n(); ++i) {
        double square = 0.0;
        for (std::size_t e = i * k; e < (i + 1) * k; ++e) {
            const double by = learnt ? objective.model.errors[i] + 1e-12 : variance.empty() ? 1.0 : variance[e];
            square += static_cast<double>(residual[e]) * residual[e] / by;
        }
        room.sizes[i] = std::sqrt(square / k);
        if (counts(objective, samples, i) && std::isfinite(room.sizes[i])) room.sorted.push_back(room.sizes[i]);
    }
}

// Multiplies the weights by those of the robust loss. The scale is robust: a change of light raises all residuals, and
// the median pixel still counts.
void weigh_by_loss(const Objective& objective, const Samples& samples, Floats residual, Weights& weights,
                   WeighingRoom& room) {
    set_sizes(objective, samples, residual, weights.variance, room);
    const Loss loss = objective.method.loss;
    const bool learnt = loss == Loss::learnt;
    const std::size_t k = objective.k(), count = room.sorted.size();
    const double scale = std::max(median(room.sorted) / objective.method.gaussian_median, learnt ? 1.0 : 1e-9);
    double mean = 0.0;
    for (std::size_t i = 0; i < objective.n(); ++i) {
        double& size = room.sizes[i];
        size = std::isfinite(size) ? loss_weight(loss, size / scale) : 0.0;
        if (!learnt) continue;
        size /= std::sqrt(objective.model.errors[i] + 1e-12);
        if (counts(objective, samples, i)) mean += size / count;
    }
    for (std::size_t i = 0; i < objective.n(); ++i) {
        const auto factor = static_cast<float>(std::sqrt(learnt && mean > 0.0 ? room.sizes[i] / mean : room.sizes[i]));
        for (std::size_t e = i * k; e < (i + 1) * k; ++e) weights.base_sqrt_weights[e] *= factor;
    }
}

// Noise weights at theta_2, and their relative derivative.
void weigh_at_angle(const Samples& samples, Weights& weights) {
    const std::size_t n = weights.model_variance.size(), k = samples.metric.size() / kChannels;
    for (std::size_t i = 0; i < n; ++i) {
        const float* noise = weights.channel_noise.data() + kChannels * i;
        for (std::size_t r = 0; r < k; ++r) {
            double variance = weights.model_variance[i], change = 0.0;
            for (std::size_t c = 0; c < kChannels; ++c) {
                const double scale = samples.metric[kChannels * r + c];
                variance += scale * scale * noise[c];
                change += 2.0 * scale * samples.metric_slope[kChannels * r + c] * noise[c];
            }
            const std::size_t e = i * k + r;
            const auto at_angle = static_cast<float>(std::sqrt(weights.noise_variance / variance));
            weights.sqrt_weights[e] = weights.base_sqrt_weights[e] * at_angle;
            if (!weights.slope.empty()) weights.slope[e] = static_cast<float>(-0.5 * change / variance);
        }
    }
}

}  // namespace

void begin_weights(const Objective& objective, Weights& weights) {
    const Method& method = objective.method;
    const std::size_t n = objective.n(), k = objective.k(), m = objective.m();
    const double nan = std::numeric_limits<double>::quiet_NaN();
    const bool by_noise = method.weighting == Weighting::noise;
    set_model_weights(objective, weights);
    weights.sqrt_weights = weights.base_sqrt_weights;
    weights.slope.resize(by_noise && method.n_free() ? n * k : 0);
    weights.gram.resize(m, m);
    std::copy_n(objective.model.gram.data, m * m, weights.gram.numbers().begin());
    weights.variance.resize(method.weighting != Weighting::model ? n * k : 0);
    weights.noise_variance = by_noise ? 1.0 : nan;
    weights.channel_noise.assign(by_noise ? kChannels * n : 0, 0.0f);
    weights.model_variance.assign(by_noise ? n : 0, 1.0);
    weights.known_before.assign(n, std::numeric_limits<float>::quiet_NaN());
    weights.unexplained_before = {nan, nan};
}

void turn_weights(const Objective& objective, const Samples& samples, Weights& weights, WeighingRoom& room) {
    const bool by_noise = objective.method.weighting == Weighting::noise;
    if (by_noise) weigh_at_angle(samples, weights);
    if (by_noise || objective.model.theta_1_is_free())
        weighted_gram(samples.modes, weights.sqrt_weights, room.block, weights.gram);
}

bool update_weights(const Objective& objective, const EncodedImage& image, const Samples& samples, Floats residual,
                    Weights& weights, WeighingRoom& room) {
    const Weighting weighting = objective.method.weighting;
    const bool changed = weighting == Weighting::rows    ? weigh_by_rows(objective, image, samples, residual, weights, room)
                         : weighting == Weighting::noise ? weigh_by_noise(objective, image, samples, residual, weights)
                                                         : weigh_by_model(objective, samples, weights);
    if (!changed) return false;
    if (objective.method.loss != Loss::none) weigh_by_loss(objective, samples, residual, weights, room);
    if (weighting == Weighting::noise) weigh_at_angle(samples, weights);
    else weights.sqrt_weights = weights.base_sqrt_weights;
    weighted_gram(samples.modes, weights.sqrt_weights, room.block, weights.gram);
    return true;
}

double loss_weight(Loss loss, double u) {
    switch (loss) {
        case Loss::none: return 1.0;
        case Loss::huber: return u > 1.345 ? 1.345 / u : 1.0;
        case Loss::l1: return u > 0.1 ? 0.1 / u : 1.0;  // stops growing below a tenth of a standard deviation
        case Loss::cauchy: return 1.0 / (1.0 + std::pow(u / 2.385, 2));
        case Loss::geman_mcclure: return 1.0 / std::pow(1.0 + std::pow(u / 3.65, 2), 2);
        case Loss::tukey: return u < 4.685 ? std::pow(1.0 - std::pow(u / 4.685, 2), 2) : 0.0;
        case Loss::learnt: return std::exp(-0.5 * u * u);
    }
    return 1.0;
}

double median(std::span<double> numbers) {
    if (numbers.empty()) return 0.0;
    const auto middle = numbers.begin() + static_cast<std::ptrdiff_t>(numbers.size() / 2);
    std::nth_element(numbers.begin(), middle, numbers.end());
    return *middle;
}

}  // namespace liaam
