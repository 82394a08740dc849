// The residual of a state (paper eq 10, with eq 2 to 4 and 6 to 8):
//     r(x) = P(theta_2) E(I(W(x; p))) - P(theta_1) A_0(x) - sum_i lambda_i P(theta_1) A_i(x)
#pragma once

#include "objective.hpp"

namespace liaam {

// Computes residual, spatial gradient and usable pixels of a state; with the mean appearance only and lambda = 0 if
// lambda is to be solved for.
void evaluate_residual(const Objective& objective, const EncodedImage& image, Workspace& work, bool solves);

}  // namespace liaam
