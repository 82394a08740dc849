// Weights of pixels: from noise, the model's errors, or a robust loss (docs/explanation/theory.md, "Weights"). They are
// updated between steps and fixed within one.
#pragma once

#include "samples.hpp"

namespace liaam {

// The weights, and what their next update compares with.
struct Weights {
    std::vector<float> base_sqrt_weights;  // (n k): square roots without noise weights, which depend on theta_2
    std::vector<float> sqrt_weights;       // (n k): square roots at the angles of the samples
    std::vector<float> slope;              // (n k): their relative derivative by theta_2, or empty
    Matrix gram;                           // A'A under them
    std::vector<float> variance;           // (n k): of the residuals, for weights that use it
    double noise_variance = 0.0;           // at weight 1; NaN if the weights define none
    std::vector<float> channel_noise;      // (n, 8): variance of the channels, for noise weights
    std::vector<double> model_variance;    // (n): variance due to the model's errors, for noise weights
    std::vector<float> known_before;       // (n): 1 where colours were usable at the last weights by rows
    std::array<double, 2> unexplained_before{};  // variance of gradients and colour at these weights
};

// Room for an update of the weights, reused by the next.
struct WeighingRoom {
    std::vector<float> known;              // (n): 1 where colours are usable
    std::array<double, 2> unexplained{};   // variance of gradients and colour
    std::vector<double> sizes, sorted;     // of the residuals
    std::vector<float> block;
};

// Sets the model's weights, with which a level begins.
void begin_weights(const Objective& objective, Weights& weights);

// Turns the weights, and A'A under them, to the angles of the samples: noise depends on theta_2, and A on theta_1.
// Noise weights have a derivative, which is part of the derivatives of eq 10: with weights fixed at the last angle, the
// sum of squares is biased towards angles of low noise.
void turn_weights(const Objective& objective, const Samples& samples, Weights& weights, WeighingRoom& room);

// Updates the weights, and A'A under them, at a residual; false if they have not changed enough, or no pixel is usable.
bool update_weights(const Objective& objective, const EncodedImage& image, const Samples& samples, Floats residual,
                    Weights& weights, WeighingRoom& room);

// Weight of a residual of u standard deviations.
double loss_weight(Loss loss, double u);

// Upper median of finite numbers, which are reordered; 0 if there are none.
double median(std::span<double> numbers);

}  // namespace liaam
