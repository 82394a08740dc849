#include "normal_equations.hpp"

#include <cmath>

#include "modes.hpp"
#include "weights.hpp"

namespace liaam {

namespace {

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
    add_modes(work.rows, work.lam_step, -1.0, work.residual);
    work.squares = work.weight = 0.0;
    for (std::size_t begin = 0; begin < work.residual.size(); begin += kBlock) {
        const std::size_t size = std::min(kBlock, work.residual.size() - begin);
        const float *left = work.residual.data() + begin, *own = work.masked.data() + begin;
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
    multiply_transposed(work.whitened.view(), work.whitened.view(), n, work.product);
    for (std::size_t a = 0; a < n; ++a)
        for (std::size_t b = 0; b <= a; ++b)
            work.hessian[a][b] = work.hessian[b][a] =
                0.5 * (work.hessian[a][b] + work.hessian[b][a]) - work.product[a][b];
}

}  // namespace liaam
