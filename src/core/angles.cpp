#include "angles.hpp"

#include <cmath>
#include <numbers>

#include "linear.hpp"
#include "modes.hpp"

namespace liaam {

namespace {

// Physical cameras have 90 to 135 degrees. Far from the object, the minimum over the full circle is often an inverted
// image.
constexpr double kSearch = std::numbers::pi / 3.0;
constexpr int kScanned = 240;   // angles tried along the arc; at most four are stationary
constexpr double kRidge = 1e-6;  // on A'A, as a fraction of its largest entry

}  // namespace

double minimise_on_arc(std::array<double, 3> s, std::array<double, 2> b, double centre, double reach) {
    const auto cost = [&](double t) {
        const double x = std::cos(t), y = std::sin(t);
        return s[0] * x * x + 2.0 * s[1] * x * y + s[2] * y * y - 2.0 * (b[0] * x + b[1] * y);
    };
    const auto slope = [&](double t) {
        const double x = std::cos(t), y = std::sin(t);
        return 2.0 * ((s[2] - s[0]) * x * y + s[1] * (x * x - y * y) + b[0] * y - b[1] * x);
    };
    const double step = 2.0 * reach / kScanned;
    double best = centre, lowest = cost(centre);
    for (int i = 0; i <= kScanned; ++i) {
        const double angle = centre - reach + i * step, value = cost(angle);
        if (value < lowest) {
            lowest = value;
            best = angle;
        }
    }
    double low = std::max(best - step, centre - reach), high = std::min(best + step, centre + reach);
    for (int i = 0; i < 60; ++i) {  // the cost falls before its minimum and rises after it
        const double middle = 0.5 * (low + high);
        (slope(middle) < 0.0 ? low : high) = middle;
    }
    const double refined = 0.5 * (low + high);
    return cost(refined) < lowest ? refined : best;
}

double best_image_angle(const Objective& objective, const EncodedImage& image, const State& state, SamplingRoom& room) {
    const std::size_t n = objective.n(), m = objective.m();
    const Samples& samples = sample(objective, image, state, room);
    std::vector<float> sqrt_weights(n);
    for (std::size_t i = 0; i < n; ++i) sqrt_weights[i] = objective.model.sqrt_weights[i] * samples.usable[i];
    // The columns log R - log B and log G - log B of the image, and the mean appearance.
    std::array<std::vector<float>, 3> columns{std::vector<float>(n), std::vector<float>(n), std::vector<float>(n)};
    for (std::size_t i = 0; i < n; ++i) {
        const float* value = samples.values.data() + kChannels * i;
        columns[0][i] = value[0] - value[2];
        columns[1][i] = value[1] - value[2];
        columns[2][i] = samples.mean[i];
    }
    std::vector<float> block;
    Matrix gram(m, m), cross(m, 3);
    weighted_gram(samples.modes, sqrt_weights, block, gram);
    double largest = 1e-300;
    for (std::size_t j = 0; j < m; ++j) largest = std::max(largest, gram[j][j]);
    for (std::size_t j = 0; j < m; ++j) gram[j][j] += kRidge * largest;
    std::vector<double> products(m);
    for (std::size_t c = 0; c < 3; ++c) {
        multiply_modes(samples.modes, sqrt_weights, columns[c], products);
        for (std::size_t j = 0; j < m; ++j) cross[j][c] = products[j];
    }
    if (!cholesky(gram)) return state.angles[1];
    solve_lower(gram, cross);
    double inner[3][3];
    for (std::size_t a = 0; a < 3; ++a)
        for (std::size_t b = 0; b < 3; ++b) {
            inner[a][b] = weighted_product(sqrt_weights, columns[a], columns[b]);
            for (std::size_t j = 0; j < m; ++j) inner[a][b] -= cross[j][a] * cross[j][b];
            if (!std::isfinite(inner[a][b])) return state.angles[1];
        }
    if (inner[0][0] + inner[1][1] <= 0.0) return state.angles[1];
    return minimise_on_arc({inner[0][0], inner[0][1], inner[1][1]}, {inner[0][2], inner[1][2]}, state.angles[0],
                           kSearch);
}

}  // namespace liaam
