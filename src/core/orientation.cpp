#include "orientation.hpp"

#include <cmath>
#include <numbers>

#include "eight.hpp"
#include "elementary.hpp"

namespace liaam {

namespace {

constexpr auto kBins = static_cast<float>(kOrientations);

// The length of gradients (across, down), and their orientation in bins, from 0 to 8; both in place.
void to_polar(std::ptrdiff_t n, float* across, float* down) {
    constexpr float kPerRadian = kBins / (2.0f * std::numbers::pi_v<float>);
#pragma omp simd
    for (std::ptrdiff_t i = 0; i < n; ++i) {
        const float x = across[i], y = down[i];
        const float angle = kPerRadian * angle_of(x, y);
        across[i] = std::sqrt(x * x + y * y);
        down[i] = angle < 0.0f ? angle + kBins : angle;
    }
}

// Splits a length between the two nearest orientations, whose counts are 0.
void split(float length, float orientation, float* counts) {
    const auto lower = static_cast<std::size_t>(orientation);  // 8 is 0 again
    const float share = orientation - static_cast<float>(lower);
    counts[lower % kOrientations] = length * (1.0f - share);
    counts[(lower + 1) % kOrientations] = length * share;
}

// Along one axis, the weights of the pixels at a place: a Gaussian, interpolated between two pixels. Those of pixels
// beyond the border count for the pixel of the border.
struct Window {
    std::ptrdiff_t first = 0;
    std::vector<float> weights;

    void move_to(double place, std::ptrdiff_t n, const std::vector<float>& taps) {
        const auto reach = static_cast<std::ptrdiff_t>(taps.size()) - 1;
        const auto tap = [&](std::ptrdiff_t k) { return std::abs(k) <= reach ? taps[std::abs(k)] : 0.0f; };
        place = place > 0.0 ? std::min(place, n - 1.0) : 0.0;  // also NaN
        const auto middle = static_cast<std::ptrdiff_t>(place);
        const auto share = static_cast<float>(place - middle);
        first = std::max<std::ptrdiff_t>(middle - reach, 0);
        weights.assign(std::min(middle + reach + 2, n) - first, 0.0f);
        for (std::ptrdiff_t k = -reach; k <= reach + 1; ++k)
            weights[std::clamp<std::ptrdiff_t>(middle + k, 0, n - 1) - first] += (1.0f - share) * tap(k) + share * tap(k - 1);
    }
};

// Adds pixels of a column of counts, by the weights of the rows and of the column. Halves of eight: where these do not
// fit into a register, compilers keep them in memory.
struct Total {
    Four lower{}, upper{};

    void add(const float* pixels, std::ptrdiff_t by_row, const std::vector<float>& rows, float column) {
        Four low{}, high{};
        for (const float weight : rows) {
            low += weight * load_four(pixels);
            high += weight * load_four(pixels + 4);
            pixels += by_row;
        }
        lower += column * low;
        upper += column * high;
    }
    // Two columns at once, whose sums need not wait for each other.
    void add_two(const float* pixels, std::ptrdiff_t by_row, const std::vector<float>& rows, const float* columns) {
        Four low{}, high{}, next_low{}, next_high{};
        for (const float weight : rows) {
            low += weight * load_four(pixels);
            high += weight * load_four(pixels + 4);
            next_low += weight * load_four(pixels + 8);
            next_high += weight * load_four(pixels + 12);
            pixels += by_row;
        }
        lower += columns[0] * low + columns[1] * next_low;
        upper += columns[0] * high + columns[1] * next_high;
    }
};

}  // namespace

void count_orientations(const float* brightness, const float* finite, std::ptrdiff_t height, std::ptrdiff_t width,
                        const EncodingOptions& options, const EncodingConstants& constants, std::vector<float>& counts) {
    std::vector<float> blurred = blurred_logs(brightness, finite, height, width, options.blur, constants);
    std::vector<float> across(width), down(width);
    const auto softness = static_cast<float>(constants.softness * options.pixel);
    counts.assign(kOrientations * height * width, 0.0f);
    for (std::ptrdiff_t y = 0; y < height; ++y) {
        soft_directions_row(blurred.data(), height, width, y, options.turn, softness, across.data(), down.data());
        to_polar(width, across.data(), down.data());
        float* out = counts.data() + kOrientations * y * width;
        for (std::ptrdiff_t x = 0; x < width; ++x) split(across[x], down[x], out + kOrientations * x);
    }
}

void blurred_at(const float* counts, std::ptrdiff_t height, std::ptrdiff_t width, MatrixView<const double> points,
                double sigma, float* values) {
    const auto by_row = static_cast<std::ptrdiff_t>(kOrientations) * width;
    const std::vector<float> taps = gaussian_taps(sigma);
    Window across, down;
    for (std::size_t i = 0; i < points.n_rows; ++i) {
        across.move_to(points[i][0], width, taps);
        down.move_to(points[i][1], height, taps);
        const float* pixels = counts + down.first * by_row + across.first * static_cast<std::ptrdiff_t>(kOrientations);
        const float* weights = across.weights.data();
        const std::size_t n = across.weights.size();
        Total total;
        std::size_t l = 0;
        for (; l + 2 <= n; l += 2) total.add_two(pixels + kOrientations * l, by_row, down.weights, weights + l);
        if (l < n) total.add(pixels + kOrientations * l, by_row, down.weights, weights[l]);
        store_four(values + kOrientations * i, total.lower);
        store_four(values + kOrientations * i + 4, total.upper);
    }
}

}  // namespace liaam
