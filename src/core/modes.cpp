#include "modes.hpp"

namespace liaam {

namespace {

constexpr std::size_t kTall = 6, kWide = 16;  // a tile of A'A: twelve vectors of sums, and their factors, fill 16 registers
constexpr std::size_t kVectors = 4;          // vectors of modes that are summed together, so that none waits for its last sum

// Adds the products of six modes from i on with sixteen from j on, of a block of weighted modes.
void add_tile(const float* block, std::size_t size, std::size_t stride, std::size_t i, std::size_t j, Matrix& gram) {
    const std::size_t m = gram.rows();
    std::size_t rows[kTall];  // beyond the last: that one again
    for (std::size_t t = 0; t < kTall; ++t) rows[t] = std::min(i + t, m - 1);
    float sums[kTall][kWide]{};
    for (std::size_t e = 0; e < size; ++e, block += stride)
        for (std::size_t t = 0; t < kTall; ++t) {
            const float own = block[rows[t]];
#pragma omp simd
            for (std::size_t c = 0; c < kWide; ++c) sums[t][c] += own * block[j + c];
        }
    for (std::size_t t = 0; t < kTall && i + t < m; ++t)
        for (std::size_t c = 0; c < kWide && j + c <= i + t; ++c) gram[i + t][j + c] += sums[t][c];
}

// Multiplies the codes of residuals by their weights.
template <class Lines>
void weigh_block(const Lines& lines, std::size_t begin, std::size_t size, std::size_t width, const float* sqrt_weights,
                 std::size_t stride, float* block) {
    for (std::size_t e = 0; e < size; ++e)
        for (std::size_t j = 0; j < width; j += kEight)
            store(block + e * stride + j, sqrt_weights[e] * lines.at((begin + e) * width + j));
}

// Adds the products of a block of a column with 32 modes from j on.
template <class Lines>
void multiply_block(const Lines& lines, std::size_t begin, std::size_t size, std::size_t width, std::size_t j,
                    const float* column, std::span<double> out) {
    std::size_t columns[kVectors];  // beyond the last: that one again
    for (std::size_t v = 0; v < kVectors; ++v) columns[v] = std::min(j + v * kEight, width - kEight);
    Eight sums[kVectors]{};
    for (std::size_t e = 0, line = begin * width; e < size; ++e, line += width)
        for (std::size_t v = 0; v < kVectors; ++v) sums[v] += column[e] * lines.at(line + columns[v]);
    for (std::size_t v = 0; v < kVectors; ++v)
        for (std::size_t c = 0, at = j + v * kEight; c < kEight && at + c < out.size(); ++c) out[at + c] += sums[v][c];
}

}  // namespace

void modes_at_residual(const Modes& modes, std::size_t e, std::span<float> out) {
    with_lines(modes, [&](const auto& lines) {
        for (std::size_t j = 0; j < out.size(); j += kEight)
            store(out.data() + j, load(modes.scales.data() + j) * lines.at(e * out.size() + j));
    });
}

void weighted_gram(const Modes& modes, Floats sqrt_weights, std::vector<float>& block, Matrix& gram) {
    const std::size_t m = gram.rows(), width = modes.width();
    gram.fill(0.0);
    const std::size_t stride = (width + kWide - 1) / kWide * kWide;
    block.assign(kBlock * stride, 0.0f);
    for (std::size_t begin = 0; begin < sqrt_weights.size(); begin += kBlock) {
        const std::size_t size = std::min(kBlock, sqrt_weights.size() - begin);
        with_lines(modes, [&](const auto& lines) {
            weigh_block(lines, begin, size, width, sqrt_weights.data() + begin, stride, block.data());
        });
        for (std::size_t i = 0; i < m; i += kTall)
            for (std::size_t j = 0; j < std::min(i + kTall, m); j += kWide) add_tile(block.data(), size, stride, i, j, gram);
    }
    for (std::size_t i = 0; i < m; ++i)
        for (std::size_t j = 0; j <= i; ++j) gram[j][i] = gram[i][j] *= static_cast<double>(modes.scales[i]) * modes.scales[j];
}

void multiply_modes(const Modes& modes, Floats sqrt_weights, Floats column, std::span<double> out) {
    float weighted[kBlock];
    std::fill(out.begin(), out.end(), 0.0);
    for (std::size_t begin = 0; begin < column.size(); begin += kBlock) {
        const std::size_t size = std::min(kBlock, column.size() - begin);
        const float *own = sqrt_weights.data() + begin, *values = column.data() + begin;
#pragma omp simd
        for (std::size_t e = 0; e < size; ++e) weighted[e] = own[e] * own[e] * values[e];
        with_lines(modes, [&](const auto& lines) {
            for (std::size_t j = 0; j < out.size(); j += kVectors * kEight)
                multiply_block(lines, begin, size, modes.width(), j, weighted, out);
        });
    }
    for (std::size_t j = 0; j < out.size(); ++j) out[j] *= modes.scales[j];
}

double weighted_product(Floats sqrt_weights, Floats a, Floats b) {
    double product = 0.0;
#pragma omp simd reduction(+ : product)
    for (std::size_t e = 0; e < a.size(); ++e)
        product += static_cast<double>(sqrt_weights[e]) * sqrt_weights[e] * a[e] * b[e];
    return product;
}

void add_modes(const Modes& modes, Doubles lam, double scale, std::span<float> out) {
    const std::size_t width = modes.width(), whole = out.size() / kEight * kEight;
    std::vector<float> factors(width, 0.0f);  // of the codes
    for (std::size_t j = 0; j < lam.size(); ++j) factors[j] = static_cast<float>(scale * lam[j] * modes.scales[j]);
    with_lines(modes, [&](const auto& lines) {
        for (std::size_t e = 0; e < whole; e += kEight) {
            Eight sums[kEight]{};
            for (std::size_t j = 0; j < width; j += kEight) {
                const Eight own = load(factors.data() + j);
                for (std::size_t i = 0; i < kEight; ++i) sums[i] += own * lines.at((e + i) * width + j);
            }
            store(out.data() + e, load(out.data() + e) + sums_of(sums));
        }
        for (std::size_t e = whole; e < out.size(); ++e) {
            Eight total{};
            for (std::size_t j = 0; j < width; j += kEight) total += load(factors.data() + j) * lines.at(e * width + j);
            out[e] += sum(total);
        }
    });
}

}  // namespace liaam
