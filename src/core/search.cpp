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

}  // namespace

void correlate(const float* image, const float* templates, std::size_t n, float* product) {
    // conj(b) a + conj(d) c, of complex numbers: a and c are the spectra of the image and of its conjugate.
    const float* a = image;
    const float* b = templates;
    const float* c = image + 2 * n;
    const float* d = templates + 2 * n;
#pragma omp simd
    for (std::size_t i = 0; i < n; ++i) {
        const std::size_t re = 2 * i;
        const std::size_t im = 2 * i + 1;
        product[re] = (a[re] * b[re] + a[im] * b[im]) + (c[re] * d[re] + c[im] * d[im]);
        product[im] = (a[im] * b[re] - a[re] * b[im]) + (c[im] * d[re] - c[re] * d[im]);
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
