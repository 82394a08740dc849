#include "appearance.hpp"

#include <cmath>

#include "linear.hpp"
#include "modes.hpp"

namespace liaam {

namespace {

constexpr std::size_t kSummed = 2048;  // residuals that are summed in float32 before they are added in float64

// Subtracts the appearance of a lambda (eq 4) from the samples.
void subtract_appearance(const Samples& samples, Doubles lam, FittedAppearance& fitted) {
    fitted.lam.assign(lam.begin(), lam.end());
    fitted.residual.resize(samples.projected.size());
    const float* mean = samples.mean.data();
    const float* projected = samples.projected.data();
    float* residual = fitted.residual.data();
#pragma omp simd
    for (std::size_t e = 0; e < fitted.residual.size(); ++e) residual[e] = projected[e] - mean[e];
    if (std::any_of(lam.begin(), lam.end(), [](double each) { return each != 0.0; }))
        add_modes(samples.modes, lam, -1.0, fitted.residual);
}

// The square root of the weights at the usable pixels; returns the number of the others.
std::size_t mask_weights(const Samples& samples, const Weights& weights, std::size_t k, std::vector<float>& masked) {
    std::size_t hidden = 0;
    masked.resize(weights.sqrt_weights.size());
    for (std::size_t i = 0; i < samples.usable.size(); ++i) {
        hidden += samples.usable[i] == 0.0f;
        for (std::size_t e = i * k; e < (i + 1) * k; ++e) masked[e] = weights.sqrt_weights[e] * samples.usable[i];
    }
    return hidden;
}

// Takes the products of unusable pixels out of A'A, whose lower triangle is given.
void remove_hidden(const Objective& objective, const Samples& samples, const Weights& weights, std::vector<float>& line,
                   Matrix& gram) {
    const std::size_t k = objective.k(), m = objective.m();
    line.resize(objective.width());
    for (std::size_t i = 0; i < samples.usable.size(); ++i) {
        if (samples.usable[i] > 0.0f) continue;
        for (std::size_t e = i * k; e < (i + 1) * k; ++e) {
            modes_at_residual(samples.modes, e, line);
            const double square = static_cast<double>(weights.sqrt_weights[e]) * weights.sqrt_weights[e];
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
void factorise(const Objective& objective, const Samples& samples, const Weights& weights, std::size_t hidden,
               std::vector<float>& line, Matrix& factor) {
    const Doubles ridge = objective.model.ridge;
    factor = weights.gram;
    if (hidden) remove_hidden(objective, samples, weights, line, factor);
    for (std::size_t a = 0; a < ridge.size(); ++a) factor[a][a] += ridge[a];
    if (cholesky(factor)) return;
    factor.fill(0.0);  // not positive definite, by rounding: use the diagonal, for small steps of lambda
    for (std::size_t a = 0; a < ridge.size(); ++a)
        factor[a][a] = std::sqrt(std::max(weights.gram[a][a], 0.0) + ridge[a]);
}

// Subtracts the step of lambda from the residual, and sums the squares that are left and the weights.
void subtract_modes(const Samples& samples, Doubles step, FittedAppearance& fitted) {
    add_modes(samples.modes, step, -1.0, fitted.residual);
    fitted.squares = fitted.weight = 0.0;
    for (std::size_t begin = 0; begin < fitted.residual.size(); begin += kSummed) {
        const std::size_t size = std::min(kSummed, fitted.residual.size() - begin);
        const float *left = fitted.residual.data() + begin, *own = fitted.sqrt_weights.data() + begin;
        float squares = 0.0f, weight = 0.0f;
#pragma omp simd reduction(+ : squares, weight)
        for (std::size_t e = 0; e < size; ++e) {
            const float square = own[e] * own[e];
            squares += square * left[e] * left[e];
            weight += square;
        }
        fitted.squares += squares;
        fitted.weight += weight;
    }
}

// Steps to the best lambda, if `solves`, from the lambda and the residual in the room.
const FittedAppearance& solve_appearance(const Objective& objective, const Samples& samples, const Weights& weights,
                                         bool solves, AppearanceRoom& room) {
    FittedAppearance& fitted = room.fitted;
    const std::size_t hidden = mask_weights(samples, weights, objective.k(), fitted.sqrt_weights);
    factorise(objective, samples, weights, hidden, room.line, fitted.factor);
    fitted.slope.resize(objective.m());
    multiply_modes(samples.modes, fitted.sqrt_weights, fitted.residual, fitted.slope);
    for (std::size_t j = 0; j < fitted.lam.size(); ++j) fitted.slope[j] -= objective.model.ridge[j] * fitted.lam[j];
    room.step.assign(objective.m(), 0.0);
    if (solves) {
        room.step = fitted.slope;
        solve(fitted.factor, room.step);
        for (std::size_t j = 0; j < fitted.lam.size(); ++j) fitted.lam[j] += room.step[j];
        std::fill(fitted.slope.begin(), fitted.slope.end(), 0.0);
    }
    subtract_modes(samples, room.step, fitted);
    return fitted;
}

}  // namespace

const FittedAppearance& fit_appearance(const Objective& objective, const Samples& samples, const Weights& weights,
                                       AppearanceRoom& room) {
    room.step.assign(objective.m(), 0.0);
    subtract_appearance(samples, room.step, room.fitted);
    return solve_appearance(objective, samples, weights, true, room);
}

const FittedAppearance& given_appearance(const Objective& objective, const Samples& samples, const Weights& weights,
                                         Doubles lam, AppearanceRoom& room) {
    subtract_appearance(samples, lam, room.fitted);
    return solve_appearance(objective, samples, weights, false, room);
}

const FittedAppearance& refit_appearance(const Objective& objective, const Samples& samples, const Weights& weights,
                                         AppearanceRoom& room) {
    return solve_appearance(objective, samples, weights, true, room);
}

}  // namespace liaam
