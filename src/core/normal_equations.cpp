#include "normal_equations.hpp"

#include <cmath>

#include "weights.hpp"

namespace liaam {

namespace {

constexpr std::size_t kTile = 4;  // modes whose products are summed together: each number loaded is used four times

// Adds the products of modes i to i + 3 with modes j to j + 3 of a block of weighted modes.
void add_tile(const float* block, std::size_t size, std::size_t m, std::size_t i, std::size_t j, Matrix& gram) {
    const float *a[kTile], *b[kTile];
    for (std::size_t t = 0; t < kTile; ++t) {  // beyond the last mode: that one again
        a[t] = block + std::min(i + t, m - 1) * kBlock;
        b[t] = block + std::min(j + t, m - 1) * kBlock;
    }
    float s00 = 0, s01 = 0, s02 = 0, s03 = 0, s10 = 0, s11 = 0, s12 = 0, s13 = 0;
    float s20 = 0, s21 = 0, s22 = 0, s23 = 0, s30 = 0, s31 = 0, s32 = 0, s33 = 0;
    const float *a0 = a[0], *a1 = a[1], *a2 = a[2], *a3 = a[3], *b0 = b[0], *b1 = b[1], *b2 = b[2], *b3 = b[3];
#pragma omp simd reduction(+ : s00, s01, s02, s03, s10, s11, s12, s13, s20, s21, s22, s23, s30, s31, s32, s33)
    for (std::size_t e = 0; e < size; ++e) {
        const float x0 = a0[e], x1 = a1[e], x2 = a2[e], x3 = a3[e];
        s00 += x0 * b0[e];
        s01 += x0 * b1[e];
        s02 += x0 * b2[e];
        s03 += x0 * b3[e];
        s10 += x1 * b0[e];
        s11 += x1 * b1[e];
        s12 += x1 * b2[e];
        s13 += x1 * b3[e];
        s20 += x2 * b0[e];
        s21 += x2 * b1[e];
        s22 += x2 * b2[e];
        s23 += x2 * b3[e];
        s30 += x3 * b0[e];
        s31 += x3 * b1[e];
        s32 += x3 * b2[e];
        s33 += x3 * b3[e];
    }
    const float sums[kTile][kTile] = {{s00, s01, s02, s03}, {s10, s11, s12, s13}, {s20, s21, s22, s23}, {s30, s31, s32, s33}};
    for (std::size_t t = 0; t < kTile && i + t < m; ++t)
        for (std::size_t u = 0; u < kTile && j + u <= i + t; ++u) gram[i + t][j + u] += sums[t][u];
}

// The square root of the weights at the usable pixels; returns the number of the others.
std::size_t mask_weights(std::size_t k, Workspace& work) {
    std::size_t hidden = 0;
    for (std::size_t i = 0; i < work.usable.size(); ++i) {
        hidden += work.usable[i] == 0.0f;
        for (std::size_t e = i * k; e < (i + 1) * k; ++e) work.masked[e] = work.sqrt_weights[e] * work.usable[i];
    }
    return hidden;
}

// Takes the products of unusable pixels out of A'A, whose lower triangle is given.
void remove_hidden(const Objective& objective, const Workspace& work, Matrix& gram) {
    const std::size_t k = objective.k(), width = objective.width(), m = objective.m();
    for (std::size_t i = 0; i < work.usable.size(); ++i) {
        if (work.usable[i] > 0.0f) continue;
        for (std::size_t e = i * k; e < (i + 1) * k; ++e) {
            const float* line = work.lines.data() + e * width;
            const double square = static_cast<double>(work.sqrt_weights[e]) * work.sqrt_weights[e];
            for (std::size_t a = 0; a < m; ++a) {
                const double scale = square * line[a];
                double* row = gram[a];
#pragma omp simd
                for (std::size_t b = 0; b <= a; ++b) row[b] -= scale * line[b];
            }
        }
    }
}

// The Cholesky factor of A'A plus the ridge, over the usable pixels.
void factorise(const Objective& objective, std::size_t hidden, Workspace& work) {
    const Doubles ridge = objective.model.ridge;
    work.factor = work.gram;
    if (hidden) remove_hidden(objective, work, work.factor);
    for (std::size_t a = 0; a < ridge.size(); ++a) work.factor[a][a] += ridge[a];
    if (cholesky(work.factor)) return;
    work.factor.fill(0.0);  // not positive definite, by rounding: use the diagonal, for small steps of lambda
    for (std::size_t a = 0; a < ridge.size(); ++a)
        work.factor[a][a] = std::sqrt(std::max(work.gram[a][a], 0.0) + ridge[a]);
}

// Subtracts the step of lambda from the residual, and sums the squares that are left and the weights.
void subtract_modes(Workspace& work) {
    work.squares = work.weight = 0.0;
    for (std::size_t begin = 0; begin < work.residual.size(); begin += kBlock) {
        const std::size_t size = std::min(kBlock, work.residual.size() - begin);
        float* left = work.residual.data() + begin;
        for (std::size_t j = 0; j < work.lam_step.size(); ++j) {
            const float* mode = work.rows[1 + j].data() + begin;
            const auto scale = static_cast<float>(work.lam_step[j]);
#pragma omp simd
            for (std::size_t e = 0; e < size; ++e) left[e] -= scale * mode[e];
        }
        const float* own = work.masked.data() + begin;
        float squares = 0.0f, weight = 0.0f;
#pragma omp simd reduction(+ : squares, weight)
        for (std::size_t e = 0; e < size; ++e) {
            const float square = own[e] * own[e];
            squares += square * left[e] * left[e];
            weight += square;
        }
        work.squares += squares;
        work.weight += weight;
    }
}

}  // namespace

void weighted_gram(Rows<const float> rows, Floats sqrt_weights, std::vector<float>& block, Matrix& gram) {
    const std::size_t m = gram.rows();
    gram.fill(0.0);
    block.resize(m * kBlock);
    for (std::size_t begin = 0; begin < sqrt_weights.size(); begin += kBlock) {
        const std::size_t size = std::min(kBlock, sqrt_weights.size() - begin);
        const float* own = sqrt_weights.data() + begin;
        for (std::size_t j = 0; j < m; ++j) {
            const float* mode = rows[1 + j].data() + begin;
            float* weighted = block.data() + j * kBlock;
#pragma omp simd
            for (std::size_t e = 0; e < size; ++e) weighted[e] = mode[e] * own[e];
        }
        for (std::size_t i = 0; i < m; i += kTile)
            for (std::size_t j = 0; j <= i; j += kTile) add_tile(block.data(), size, m, i, j, gram);
    }
    for (std::size_t i = 0; i < m; ++i)
        for (std::size_t j = 0; j < i; ++j) gram[j][i] = gram[i][j];
}

void multiply_modes(Rows<const float> rows, Floats sqrt_weights, Floats column, std::vector<float>& block,
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
            const float* mode = rows[1 + j].data() + begin;
            float product = 0.0f;
#pragma omp simd reduction(+ : product)
            for (std::size_t e = 0; e < size; ++e) product += mode[e] * weighted[e];
            out[j] += product;
        }
    }
}

void solve_appearance(const Objective& objective, Workspace& work, bool weighed, bool solves) {
    const bool by_noise = objective.method.weighting == Weighting::noise;
    if (by_noise) {
        weigh_at_angle(work);
    } else if (weighed) {
        work.sqrt_weights = work.base_sqrt_weights;
    }
    if (weighed || by_noise || objective.model.theta_1_is_free())
        weighted_gram(work.rows, work.sqrt_weights, work.block, work.gram);
    factorise(objective, mask_weights(objective.k(), work), work);
    multiply_modes(work.rows, work.masked, work.residual, work.block, work.ar);
    for (std::size_t j = 0; j < work.ar.size(); ++j) work.ar[j] -= objective.model.ridge[j] * work.state.lam[j];
    std::fill(work.lam_step.begin(), work.lam_step.end(), 0.0);
    if (solves) {
        work.lam_step = work.ar;
        solve(work.factor, work.lam_step);
        for (std::size_t j = 0; j < work.ar.size(); ++j) work.state.lam[j] += work.lam_step[j];
        std::fill(work.ar.begin(), work.ar.end(), 0.0);
    }
    subtract_modes(work);
}

void eliminate_appearance(Workspace& work) {
    const std::size_t n = work.gradient.size(), m = work.ar.size();
    work.whitened = work.aj;  // L^-1 A'J
    solve_lower(work.factor, work.whitened);
    work.along = work.ar;  // L^-1 A'r
    for (std::size_t i = 0; i < m; ++i) {
        for (std::size_t j = 0; j < i; ++j) work.along[i] -= work.factor[i][j] * work.along[j];
        work.along[i] /= work.factor[i][i];
        for (std::size_t a = 0; a < n; ++a) work.gradient[a] -= work.along[i] * work.whitened[i][a];
    }
    multiply_transposed(work.whitened, work.whitened, n, work.product);
    for (std::size_t a = 0; a < n; ++a)
        for (std::size_t b = 0; b <= a; ++b)
            work.hessian[a][b] = work.hessian[b][a] =
                0.5 * (work.hessian[a][b] + work.hessian[b][a]) - work.product[a][b];
}

}  // namespace liaam
