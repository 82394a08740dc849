// The appearance that fits samples best (eq 4), and the residual that it leaves (eq 10):
//     r(x) = P(theta_2) E(I(W(x; p))) - P(theta_1) A_0(x) - sum_i lambda_i P(theta_1) A_i(x)
#pragma once

#include "samples.hpp"
#include "weights.hpp"

namespace liaam {

struct FittedAppearance {
    std::vector<double> lam;               // lambda
    std::vector<float> residual;           // (n k)
    std::vector<float> sqrt_weights;       // (n k): 0 at unusable pixels
    double squares = 0.0, weight = 0.0;    // r'r under the weights, and their sum
    Matrix factor;                         // the Cholesky factor of A'A plus the ridge over the usable pixels
    std::vector<double> slope;             // A'r - ridge lambda; 0 where lambda was solved for
};

// Room for an appearance, reused by the next.
struct AppearanceRoom {
    FittedAppearance fitted;
    std::vector<double> step;
    std::vector<float> line;  // the modes at a residual
};

// The appearance of the best lambda under the weights (eq 9 and 10). It is in the room until the next.
const FittedAppearance& fit_appearance(const Objective& objective, const Samples& samples, const Weights& weights,
                                       AppearanceRoom& room);

// The appearance of a given lambda.
const FittedAppearance& given_appearance(const Objective& objective, const Samples& samples, const Weights& weights,
                                         Doubles lam, AppearanceRoom& room);

// The appearance in the room again, for the same samples under new weights: the best lambda, from the last one.
const FittedAppearance& refit_appearance(const Objective& objective, const Samples& samples, const Weights& weights,
                                         AppearanceRoom& room);

}  // namespace liaam
