// What a state sees: the image at W(x; p) of the shape s(p) (paper eq 2 and 3), projected by P(theta_2) (eq 7 and 8), and
// the appearance of the model, projected by P(theta_1).
#pragma once

#include "objective.hpp"

namespace liaam {

struct Samples {
    std::array<double, 2> angles{};           // theta_1 and theta_2
    std::vector<float> metric, metric_slope;  // (k, 8): P(theta_2) and dP/dtheta_2
    Floats mean, mean_gradients;              // P(theta_1) A_0 (n k) and its spatial gradients (2 n k)
    Modes modes, mode_gradients;              // P(theta_1) A_i and theirs
    std::vector<double> vertices;             // (v, 2): s(p)
    std::vector<float> values;                // (n, 8): the image's channels, E(I(W(x; p)))
    std::vector<float> projected;             // (n k): P(theta_2) E(I(W(x; p)))
    std::vector<float> gradients;             // (2 n k): their spatial gradient by x and y, model pixels
    std::vector<float> usable;                // (n): 0 or 1
};

// Room for samples, reused by the next.
struct SamplingRoom {
    Samples samples;
    SamplePoints points;
    std::vector<float> mean, mean_gradients;  // at theta_1, where it is free
};

// Samples the image at a state. They are in the room until the next.
const Samples& sample(const Objective& objective, const EncodedImage& image, const State& state, SamplingRoom& room);

}  // namespace liaam
