// Weights of pixels: from noise, the model's errors, or a robust loss (docs/explanation/theory.md, "Weights"). They are
// updated between steps and fixed within one.
#pragma once

#include "objective.hpp"

namespace liaam {

// Updates the weights at the current residual; false if they have not changed enough, or no pixel is usable.
bool update_weights(const Objective& objective, const EncodedImage& image, Workspace& work);

// Square root of noise weights at theta_2, and its relative derivative, which is part of the derivatives of eq 10: with
// weights fixed at the last angle, the sum of squares is biased towards angles of low noise.
void weigh_at_angle(Workspace& work);

// Weight of a residual of u standard deviations.
double loss_weight(Loss loss, double u);

// Upper median of finite numbers, which are reordered; 0 if there are none.
double median(std::span<double> numbers);

// Standard deviation of a logarithm due to noise, from a table; constant beyond its ends.
float log_noise(const EncodedImage& image, float log);

}  // namespace liaam
