#include "search.hpp"

namespace liaam {

namespace {

// Whether no pixel around is larger.
bool is_peak(const Plane& image, std::ptrdiff_t y, std::ptrdiff_t x, std::ptrdiff_t reach) {
    const float value = image.at(y, x);
    for (auto i = std::max<std::ptrdiff_t>(y - reach, 0); i < std::min(y + reach + 1, image.height); ++i)
        for (auto j = std::max<std::ptrdiff_t>(x - reach, 0); j < std::min(x + reach + 1, image.width); ++j)
            if (image.at(i, j) > value) return false;
    return true;
}

constexpr std::size_t kChunk = 512;  // sums that stay in the first cache while channels are added

struct Sums {
    float re[kChunk], im[kChunk];
};

// Adds a conj(b), of complex numbers whose imaginary parts lie so far behind the real ones.
void add_product(const float* a, const float* b, std::size_t behind, std::size_t n, Sums& sums) {
    const float* a_im = a + behind;
    const float* b_im = b + behind;
#pragma omp simd
    for (std::size_t i = 0; i < n; ++i) {
        sums.re[i] += a[i] * b[i] + a_im[i] * b_im[i];
        sums.im[i] += a_im[i] * b[i] - a[i] * b_im[i];
    }
}

}  // namespace

void correlate(const float* image, const float* templates, std::size_t n_channels, std::size_t n, float* product) {
    for (std::size_t begin = 0; begin < n; begin += kChunk) {
        const std::size_t count = std::min(kChunk, n - begin);
        Sums sums{};
        for (std::size_t channel = 0; channel < n_channels; ++channel) {
            const std::size_t first = 2 * channel * n + begin;
            add_product(image + first, templates + first, n, count, sums);
        }
        float* out = product + 2 * begin;
        for (std::size_t i = 0; i < count; ++i) {
            out[2 * i] = sums.re[i];
            out[2 * i + 1] = sums.im[i];
        }
    }
}

std::vector<Peak> best_peaks(const Plane& image, std::size_t count, float least, std::ptrdiff_t reach) {
    constexpr std::ptrdiff_t kChunk = 64;  // most chunks have no pixel above the limit, and are skipped at once
    const auto is_larger = [](float value, const Peak& peak) { return value > peak.value; };
    std::vector<Peak> peaks;  // the largest first
    float limit = least;
    for (std::ptrdiff_t y = 0; y < image.height && count; ++y) {
        const float* row = image.row(y);
        const std::ptrdiff_t step = image.by_pixel;
        for (std::ptrdiff_t begin = 0; begin < image.width; begin += kChunk) {
            const auto end = std::min(begin + kChunk, image.width);
            int is_any = 0;
#pragma omp simd reduction(| : is_any)
            for (std::ptrdiff_t x = begin; x < end; ++x) is_any |= row[x * step] > limit;
            if (!is_any) continue;
            for (std::ptrdiff_t x = begin; x < end; ++x) {
                const float value = row[x * step];
                if (!(value > limit) || !is_peak(image, y, x, reach)) continue;
                peaks.insert(std::upper_bound(peaks.begin(), peaks.end(), value, is_larger), {y, x, value});
                if (peaks.size() > count) peaks.pop_back();
                if (peaks.size() == count) limit = peaks.back().value;
            }
        }
    }
    return peaks;
}

}  // namespace liaam
