#include "weights.hpp"

#include <cmath>
#include <limits>

#include "elementary.hpp"
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
constexpr float kSoftness = 0.1f, kLogFloor = 0.004f, kBrightness = 1.0f / 3.0f;  // as in EncodingConstants

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
void log_variances(const EncodedImage& image, const Workspace& work, std::size_t begin, std::size_t size,
                   const NoiseTable& table, NoisePlanes& planes) {
    const auto keep = static_cast<float>(image.value_left * image.value_left);
    const float* known = work.known.data() + begin;
    for (std::size_t i = 0; i < size; ++i) {
        planes.light[i] = kLogFloor;
        planes.spread[i] = 0.0f;
    }
    for (std::size_t c = 0; c < 3; ++c) {
        const float* values = work.values.data() + kChannels * begin + 2 + c;
        float* variance = planes.channel[2 + c];
        for (std::size_t i = 0; i < size; ++i) {
            planes.log[i] = values[kChannels * i];
            planes.deviation[i] = table(planes.log[i]);
        }
#pragma omp simd
        for (std::size_t i = 0; i < size; ++i) {
            const float log = planes.log[i] < 20.0f ? planes.log[i] : 20.0f;
            const float brightness = kBrightness * exp_of(log > -20.0f ? log : -20.0f);
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
void direction_variances(const EncodedImage& image, const Workspace& work, std::size_t begin, std::size_t size,
                         NoisePlanes& planes) {
    const auto slope = static_cast<float>(std::pow(image.slope_left / kSoftness, 2));
    const float* values = work.values.data() + kChannels * begin;
    for (std::size_t i = 0; i < size; ++i) {
        const float x = values[kChannels * i], y = values[kChannels * i + 1];
        const float rest = std::max(1.0f - x * x - y * y, 0.0f), bend = 1.0f + rest;
        const float of_slope = slope * planes.spread[i] * rest / (planes.light[i] * planes.light[i]);
        planes.channel[0][i] = std::min(of_slope * (1.0f - x * x * bend), kMostDirectionNoise);
        planes.channel[1][i] = std::min(of_slope * (1.0f - y * y * bend), kMostDirectionNoise);
    }
}

// Adds a block's variance of row r by noise to the sums, and keeps it.
void add_row(std::size_t r, std::size_t k, std::size_t begin, std::size_t size, NoisePlanes& planes, Workspace& work,
             RowSums& sums) {
    float squared[5];
    for (std::size_t c = 0; c < 5; ++c) squared[c] = work.metric[kChannels * r + c] * work.metric[kChannels * r + c];
    const float* residual = work.residual.data() + begin * k + r;
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
        work.variance[(begin + i) * k + r] = planes.by_noise[i];
    }
    sums.count += count;
    sums.squares += squares;
    sums.beyond += beyond;
}

// The variance of each row of `soft` due to noise, to first order, and sums of squared residuals.
std::vector<RowSums> row_variances(const Objective& objective, const EncodedImage& image, Workspace& work) {
    const std::size_t n = objective.n(), k = objective.k();
    const Floats own = objective.model.sqrt_weights;
    const NoiseTable table(image);
    std::vector<RowSums> sums(k);
    NoisePlanes planes;
    for (std::size_t begin = 0; begin < n; begin += kPlane) {
        const std::size_t size = std::min(kPlane, n - begin);
        for (std::size_t i = 0; i < size; ++i) {
            const std::size_t at = begin + i;
            work.known[at] = objective.model.colours && work.values[kChannels * at + 5] >= 0.99f ? 1.0f : 0.0f;
            planes.counts[i] = work.usable[at] * own[at * k] > 0.0f ? 1.0f : 0.0f;
        }
        log_variances(image, work, begin, size, table, planes);
        direction_variances(image, work, begin, size, planes);
        for (std::size_t r = 0; r < k; ++r) add_row(r, k, begin, size, planes, work, sums[r]);
    }
    return sums;
}

// The unexplained variance of both groups of rows: the residual's minus that of noise. Under the light of training the
// invariant gets the larger weight; under another light, or with JPEG's errors of colour, the gradients do. Returns the
// number of residuals that count.
double set_unexplained(const std::vector<RowSums>& sums, Workspace& work) {
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
        work.unexplained[group] = total.beyond / count > least ? total.beyond / count : least;
    }
    return counted;
}

// Whether the unexplained variance or the set of pixels with usable colour has changed.
bool has_changed(const Workspace& work) {
    for (std::size_t group = 0; group < 2; ++group) {
        const double change = std::log(work.unexplained[group] / work.unexplained_before[group]);
        if (!(change < kAlike && change > -kAlike)) return true;  // NaN is not alike
    }
    std::size_t count = 0;
    for (std::size_t i = 0; i < work.known.size(); ++i) count += work.known[i] != work.known_before[i];
    return static_cast<double>(count) > kChanged * static_cast<double>(work.known.size());
}

// Square roots of inverse variances (noise plus model), scaled to mean weight 1 over the pixels that count.
void set_row_weights(const Objective& objective, const EncodedImage& image, Workspace& work) {
    const std::size_t n = objective.n(), k = objective.k();
    const Floats own = objective.model.sqrt_weights;
    double precisions = 0.0;
    std::size_t count = 0;
    for (std::size_t r = 0; r < k; ++r) {
        const std::size_t group = r >= kGradientRows;
        const auto tied = static_cast<float>(image.correlated);
        const auto by_model = static_cast<float>(image.correlated * kCorrelated[group] * work.unexplained[group]);
        float precision = 0.0f;
        for (std::size_t i = 0; i < n; ++i) {
            float& variance = work.variance[i * k + r];
            variance = tied * variance + by_model;
            if (!(work.usable[i] * own[i * k] > 0.0f)) continue;
            precision += 1.0f / variance;
            ++count;
        }
        precisions += precision;
    }
    work.noise_variance = count ? count / precisions : 1.0;
    const auto unit = static_cast<float>(work.noise_variance);
#pragma omp simd
    for (std::size_t e = 0; e < n * k; ++e) work.base_sqrt_weights[e] = own[e] * std::sqrt(unit / work.variance[e]);
}

bool weigh_by_rows(const Objective& objective, const EncodedImage& image, Workspace& work) {
    const double counted = set_unexplained(row_variances(objective, image, work), work);
    if (!(counted > 0.0) || !(objective.method.loss != Loss::none || has_changed(work))) return false;
    work.unexplained_before = work.unexplained;
    work.known_before = work.known;
    set_row_weights(objective, image, work);
    return true;
}

bool any_usable(const Workspace& work) {
    return std::any_of(work.usable.begin(), work.usable.end(), [](float each) { return each > 0.0f; });
}

// Negative log likelihood of the residuals if the model's learnt errors are multiplied by a factor.
double surprise(const Objective& objective, const Workspace& work, double factor) {
    const std::size_t k = objective.k();
    double cost = 0.0;
    for (std::size_t i = 0; i < objective.n(); ++i) {
        if (!(work.usable[i] * objective.model.sqrt_weights[i * k] > 0.0f)) continue;
        double squares = 0.0, by_noise = 0.0;
        for (std::size_t e = i * k; e < (i + 1) * k; ++e) {
            squares += static_cast<double>(work.residual[e]) * work.residual[e] / k;
            by_noise += static_cast<double>(work.variance[e]) / k;
        }
        const double expected = by_noise + factor * objective.model.errors[i] + 1e-300;
        cost += std::log(expected) + squares / expected;
    }
    return cost;
}

// Variances of logarithms due to noise, and of the residuals.
void log_channel_noise(const Objective& objective, const EncodedImage& image, Workspace& work) {
    const std::size_t k = objective.k();
    const NoiseTable table(image);
    const auto keep = static_cast<float>(image.value_left * image.value_left);
    for (std::size_t i = 0; i < objective.n(); ++i) {
        float* noise = work.channel_noise.data() + kChannels * i;
        for (std::size_t c = 0; c < 3; ++c) {
            const float deviation = table(work.values[kChannels * i + c]), square = deviation * deviation;
            noise[c] = keep * square + 0.25f * square * square;  // E log(rho + n) is lower by half the relative variance
        }
        for (std::size_t r = 0; r < k; ++r) {
            float variance = 0.0f;
            for (std::size_t c = 0; c < 3; ++c)
                variance += work.metric[kChannels * r + c] * work.metric[kChannels * r + c] * noise[c];
            work.variance[i * k + r] = variance;
        }
    }
}

// Variances due to noise and to the model's errors: all that does not depend on theta_2.
bool weigh_by_noise(const Objective& objective, const EncodedImage& image, Workspace& work) {
    if (!any_usable(work)) return false;
    const Floats own = objective.model.sqrt_weights;
    const std::size_t k = objective.k();
    std::copy(own.begin(), own.end(), work.base_sqrt_weights.begin());
    log_channel_noise(objective, image, work);
    double factor = 0.0, best = std::numeric_limits<double>::infinity();
    for (const double candidate : error_factors()) {
        const double cost = surprise(objective, work, candidate);
        if (cost < best) {
            best = cost;
            factor = candidate;
        }
    }
    double precision = 0.0;
    std::size_t count = 0;
    for (std::size_t i = 0; i < objective.n(); ++i) {
        work.model_variance[i] = factor * objective.model.errors[i];
        double mean = 0.0;
        for (std::size_t e = i * k; e < (i + 1) * k; ++e) {
            work.variance[e] += static_cast<float>(work.model_variance[i]);
            mean += static_cast<double>(work.variance[e]) / k;
        }
        if (!(work.usable[i] * own[i * k] > 0.0f)) continue;
        precision += 1.0 / mean;
        ++count;
    }
    work.noise_variance = count ? count / precision : 1.0;
    return true;
}

// Root mean square residual of each pixel, in standard deviations where these are known.
void set_sizes(const Objective& objective, Workspace& work) {
    const std::size_t k = objective.k();
    const bool learnt = objective.method.loss == Loss::learnt;
    work.sizes.resize(objective.n());
    work.sorted.clear();
    for (std::size_t i = 0; i < objective.n(); ++i) {
        double square = 0.0;
        for (std::size_t e = i * k; e < (i + 1) * k; ++e) {
            const double by = learnt ? objective.model.errors[i] + 1e-12 : work.variance.empty() ? 1.0 : work.variance[e];
            square += static_cast<double>(work.residual[e]) * work.residual[e] / by;
        }
        work.sizes[i] = std::sqrt(square / k);
        const bool counts = work.usable[i] * objective.model.sqrt_weights[i * k] > 0.0f;
        if (counts && std::isfinite(work.sizes[i])) work.sorted.push_back(work.sizes[i]);
    }
}

// Multiplies the weights by those of the robust loss. The scale is robust: a change of light raises all residuals, and
// the median pixel still counts.
void weigh_by_loss(const Objective& objective, Workspace& work) {
    set_sizes(objective, work);
    const Loss loss = objective.method.loss;
    const bool learnt = loss == Loss::learnt;
    const std::size_t k = objective.k(), count = work.sorted.size();
    const double scale = std::max(median(work.sorted) / objective.method.gaussian_median, learnt ? 1.0 : 1e-9);
    double mean = 0.0;
    for (std::size_t i = 0; i < objective.n(); ++i) {
        double& size = work.sizes[i];
        size = std::isfinite(size) ? loss_weight(loss, size / scale) : 0.0;
        if (!learnt) continue;
        size /= std::sqrt(objective.model.errors[i] + 1e-12);
        if (work.usable[i] * objective.model.sqrt_weights[i * k] > 0.0f) mean += size / count;
    }
    for (std::size_t i = 0; i < objective.n(); ++i) {
        const auto factor = static_cast<float>(std::sqrt(learnt && mean > 0.0 ? work.sizes[i] / mean : work.sizes[i]));
        for (std::size_t e = i * k; e < (i + 1) * k; ++e) work.base_sqrt_weights[e] *= factor;
    }
}

bool weigh_by_model(const Objective& objective, Workspace& work) {
    if (!any_usable(work)) return false;
    const Floats own = objective.model.sqrt_weights;
    std::copy(own.begin(), own.end(), work.base_sqrt_weights.begin());
    return true;
}

}  // namespace

bool update_weights(const Objective& objective, const EncodedImage& image, Workspace& work) {
    const Weighting weighting = objective.method.weighting;
    const bool changed = weighting == Weighting::rows    ? weigh_by_rows(objective, image, work)
                         : weighting == Weighting::noise ? weigh_by_noise(objective, image, work)
                                                         : weigh_by_model(objective, work);
    if (changed && objective.method.loss != Loss::none) weigh_by_loss(objective, work);
    return changed;
}

void weigh_at_angle(Workspace& work) {
    const std::size_t n = work.model_variance.size(), k = work.metric.size() / kChannels;
    for (std::size_t i = 0; i < n; ++i) {
        const float* noise = work.channel_noise.data() + kChannels * i;
        for (std::size_t r = 0; r < k; ++r) {
            double variance = work.model_variance[i], change = 0.0;
            for (std::size_t c = 0; c < kChannels; ++c) {
                const double scale = work.metric[kChannels * r + c];
                variance += scale * scale * noise[c];
                change += 2.0 * scale * work.metric_slope[kChannels * r + c] * noise[c];
            }
            const std::size_t e = i * k + r;
            work.sqrt_weights[e] = work.base_sqrt_weights[e] * static_cast<float>(std::sqrt(work.noise_variance / variance));
            if (!work.weight_slope.empty()) work.weight_slope[e] = static_cast<float>(-0.5 * change / variance);
        }
    }
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

float log_noise(const EncodedImage& image, float log) { return NoiseTable(image)(log); }

}  // namespace liaam
