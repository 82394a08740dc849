#include "modes.hpp"

#include "eight.hpp"

namespace liaam {

namespace {

constexpr std::size_t kTall = 4, kWide = 3;  // products summed together: twelve sums and four factors fill 16 registers

// Adds the products of four modes from i on with three from j on, of a block of weighted modes, below the diagonal.
void add_tile(const float* block, std::size_t size, std::size_t m, std::size_t i, std::size_t j, Matrix& gram) {
    const float *a[kTall], *b[kWide];  // beyond the last mode: that one again
    for (std::size_t t = 0; t < kTall; ++t) a[t] = block + std::min(i + t, m - 1) * kBlock;
    for (std::size_t u = 0; u < kWide; ++u) b[u] = block + std::min(j + u, m - 1) * kBlock;
    Eight sums[kTall][kWide]{};
    for (std::size_t e = 0; e < size; e += kEight) {
        const Eight b0 = load(b[0] + e), b1 = load(b[1] + e), b2 = load(b[2] + e);
        for (std::size_t t = 0; t < kTall; ++t) {
            const Eight own = load(a[t] + e);
            sums[t][0] += own * b0;
            sums[t][1] += own * b1;
            sums[t][2] += own * b2;
        }
    }
    for (std::size_t t = 0; t < kTall && i + t < m; ++t)
        for (std::size_t u = 0; u < kWide && j + u <= i + t; ++u) gram[i + t][j + u] += sum(sums[t][u]);
}

}  // namespace

void weighted_gram(MatrixView<const float> modes, Floats sqrt_weights, std::vector<float>& block, Matrix& gram) {
    const std::size_t m = gram.rows();
    gram.fill(0.0);
    block.resize(m * kBlock);
    for (std::size_t begin = 0; begin < sqrt_weights.size(); begin += kBlock) {
        const std::size_t size = std::min(kBlock, sqrt_weights.size() - begin);
        const std::size_t padded = (size + kEight - 1) / kEight * kEight;
        const float* own = sqrt_weights.data() + begin;
        for (std::size_t j = 0; j < m; ++j) {
            const float* mode = modes[1 + j].data() + begin;
            float* weighted = block.data() + j * kBlock;
#pragma omp simd
            for (std::size_t e = 0; e < size; ++e) weighted[e] = mode[e] * own[e];
            std::fill(weighted + size, weighted + padded, 0.0f);
        }
        for (std::size_t i = 0; i < m; i += kTall)
            for (std::size_t j = 0; j < std::min(i + kTall, m); j += kWide) add_tile(block.data(), padded, m, i, j, gram);
    }
    for (std::size_t i = 0; i < m; ++i)
        for (std::size_t j = 0; j < i; ++j) gram[j][i] = gram[i][j];
}

void multiply_modes(MatrixView<const float> modes, Floats sqrt_weights, Floats column, std::vector<float>& block,
                    std::span<double> out) {
    std::fill(out.begin(), out.end(), 0.0);
    block.resize(std::max(block.size(), kBlock));
    float* weighted = block.data();
    for (std::size_t begin = 0; begin < column.size(); begin += kBlock) {
        const std::size_t size = std::min(kBlock, column.size() - begin);
        const float *own = sqrt_weights.data() + begin, *values = column.data() + begin;
#pragma omp simd
        for (std::size_t e = 0; e < size; ++e) weighted[e] = own[e] * own[e] * values[e];
        for (std::size_t j = 0; j < out.size(); ++j) {
            const float* mode = modes[1 + j].data() + begin;
            float product = 0.0f;
#pragma omp simd reduction(+ : product)
            for (std::size_t e = 0; e < size; ++e) product += mode[e] * weighted[e];
            out[j] += product;
        }
    }
}

double weighted_product(Floats sqrt_weights, Floats a, Floats b) {
    double product = 0.0;
#pragma omp simd reduction(+ : product)
    for (std::size_t e = 0; e < a.size(); ++e)
        product += static_cast<double>(sqrt_weights[e]) * sqrt_weights[e] * a[e] * b[e];
    return product;
}

void add_modes(MatrixView<const float> modes, Doubles lam, double scale, std::span<float> out) {
    const auto factor = [&](std::size_t j) { return static_cast<float>(scale * lam[j]); };
    for (std::size_t begin = 0; begin < out.size(); begin += kBlock) {
        const std::size_t size = std::min(kBlock, out.size() - begin);
        float* sums = out.data() + begin;
        const auto mode = [&](std::size_t j) { return modes[1 + j].data() + begin; };
        std::size_t j = 0;
        for (; j + 4 <= lam.size(); j += 4) {  // each sum is loaded and stored once for four modes
            const float *a = mode(j), *b = mode(j + 1), *c = mode(j + 2), *d = mode(j + 3);
            const float wa = factor(j), wb = factor(j + 1), wc = factor(j + 2), wd = factor(j + 3);
#pragma omp simd
            for (std::size_t e = 0; e < size; ++e) sums[e] += (wa * a[e] + wb * b[e]) + (wc * c[e] + wd * d[e]);
        }
        for (; j < lam.size(); ++j) {
            const float *a = mode(j), wa = factor(j);
#pragma omp simd
            for (std::size_t e = 0; e < size; ++e) sums[e] += wa * a[e];
        }
    }
}

}  // namespace liaam
