#include "search.hpp"

namespace liaam {

namespace {

// A column of packed numbers: one real number, pairs of real and imaginary part, and one real number if there are evenly
// many.
void correlate_column(const float* left, const float* right, std::size_t height, std::size_t width, std::size_t x,
                      float* product) {
    for (std::size_t y = 0; y < height; ++y) product[y * width + x] = 0.0f;
    for (std::size_t c = 0; c < 2; ++c) {
        const float *a = left + c * height * width + x, *b = right + c * height * width + x;
        const auto at = [width](std::size_t y) { return y * width; };
        product[x] += a[0] * b[0];
        for (std::size_t y = 1; y + 1 < height; y += 2) {
            product[at(y) + x] += a[at(y)] * b[at(y)] + a[at(y + 1)] * b[at(y + 1)];
            product[at(y + 1) + x] += a[at(y + 1)] * b[at(y)] - a[at(y)] * b[at(y + 1)];
        }
        if (height % 2 == 0) product[at(height - 1) + x] += a[at(height - 1)] * b[at(height - 1)];
    }
}

// Whether no pixel around is larger.
bool is_peak(const float* image, std::ptrdiff_t height, std::ptrdiff_t width, std::ptrdiff_t stride, std::ptrdiff_t y,
             std::ptrdiff_t x, std::ptrdiff_t reach) {
    const float value = image[y * stride + x];
    for (auto i = std::max<std::ptrdiff_t>(y - reach, 0); i < std::min(y + reach + 1, height); ++i)
        for (auto j = std::max<std::ptrdiff_t>(x - reach, 0); j < std::min(x + reach + 1, width); ++j)
            if (image[i * stride + j] > value) return false;
    return true;
}

}  // namespace

void correlate(const float* left, const float* right, std::size_t height, std::size_t width, float* product) {
    const std::size_t size = height * width, pairs = (width - 1) / 2;
    for (std::size_t y = 0; y < height; ++y) {
        const float *a = left + y * width + 1, *b = right + y * width + 1, *c = a + size, *d = b + size;
        float* out = product + y * width + 1;
#pragma omp simd
        for (std::size_t i = 0; i < pairs; ++i) {
            const std::size_t re = 2 * i, im = 2 * i + 1;
            out[re] = a[re] * b[re] + a[im] * b[im] + c[re] * d[re] + c[im] * d[im];
            out[im] = a[im] * b[re] - a[re] * b[im] + c[im] * d[re] - c[re] * d[im];
        }
    }
    correlate_column(left, right, height, width, 0, product);
    if (width % 2 == 0) correlate_column(left, right, height, width, width - 1, product);
}

std::vector<Peak> best_peaks(const float* image, std::ptrdiff_t height, std::ptrdiff_t width, std::ptrdiff_t stride,
                             std::size_t count, float least, std::ptrdiff_t reach) {
    constexpr std::ptrdiff_t kChunk = 64;  // most chunks have no pixel above the limit, and are skipped at once
    std::vector<Peak> peaks;
    float limit = least;
    for (std::ptrdiff_t y = 0; y < height && count; ++y) {
        const float* row = image + y * stride;
        for (std::ptrdiff_t begin = 0; begin < width; begin += kChunk) {
            const auto end = std::min(begin + kChunk, width);
            float largest = row[begin];
#pragma omp simd reduction(max : largest)
            for (std::ptrdiff_t x = begin; x < end; ++x) largest = row[x] > largest ? row[x] : largest;
            if (!(largest > limit)) continue;
            for (std::ptrdiff_t x = begin; x < end; ++x) {
                if (!(row[x] > limit) || !is_peak(image, height, width, stride, y, x, reach)) continue;
                const auto after = [](float value, const Peak& peak) { return value > peak.value; };
                peaks.insert(std::upper_bound(peaks.begin(), peaks.end(), row[x], after), {y, x, row[x]});
                if (peaks.size() > count) peaks.pop_back();
                if (peaks.size() == count) limit = peaks.back().value;
            }
        }
    }
    return peaks;
}

}  // namespace liaam
