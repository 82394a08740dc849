// The loop of a level: weighted, damped Gauss-Newton steps of p and the free angles (paper section 4).
#pragma once

#include <functional>

#include "step.hpp"

namespace liaam {

// What a run of the loop did: the start and every accepted state, and how it ended.
struct Trace {
    std::vector<double> costs;                  // mean squared residual
    std::vector<double> path;                   // p, one after the other
    std::vector<std::array<double, 2>> angles;
    int n_iterations = 0;                       // refused steps included
    bool converged = false;
    bool angle_fixed = false;  // an angle was not observable
    bool no_texture = false;   // there is none under the model
};

// Sums over the usable pixels of one row: weights, weighted samples and their squares, weighted squares of the residual.
using Contrast = std::array<double, 4>;

// The solution of a level, and what covariances and quality need.
struct Solution {
    State state;
    Trace trace;
    double noise_variance = 0.0;  // at weight 1; NaN if the weights define none
    double squares = 0.0, weight = 0.0;
    double prior_scale = 1.0;
    Matrix expected_hessian;
    std::vector<float> usable;
    std::vector<Contrast> contrast, weighted_contrast;  // under the model's weights, and under the last ones
    std::vector<float> samples, residual;               // (n k), where asked for
    std::size_t n_counted = 0;                          // residuals with a weight, of the rows that count as contrast
};

// Options of a fit (liaam.fitting.SolverOptions).
struct Options {
    int max_iterations = 50;
    double tolerance = 0.01;           // root mean square movement of the landmarks, model pixels
    double early_tolerance = -1.0;     // fraction of the blur; negative: the default of the kind of steps
    double relative_tolerance = 0.1;   // length of a step in its own standard deviations
    double damping = 1e-3;             // initial; 0 accepts every step, as the paper does
    double shape_prior = 1.0;
    double observable = 25.0;
    bool best_angle = true;  // start theta_2 at its optimum for the initial shape
    int scoring = -1;        // most steps with the expected gradient at the end; negative: the method's own
    bool keeps_samples = false;  // return the samples and the residual
};

// Options of one run of the loop.
struct Controls : Options {
    double early_limit = 0.0;   // tolerance of the first steps: a fit that gets so near so soon is not a difficult one
    int early_steps = 0;
    bool expected = false;      // steps with the expected gradient; else with the image's own
    bool reweigh = false;       // update the weights between steps
    bool evaluate_last = true;  // evaluate the residual once more after a last step that is too short to matter
};

// What a run of the loop carries from one step to the next: a copy undoes a run.
struct Memory {
    State state;
    Weights weights;
    Priors priors;
    NewtonMemory newton;
};

// Room for a level, reused by the next. What each part returns stays in its room until it is called again.
struct LevelRoom {
    Memory memory;
    SamplingRoom sampling;
    WeighingRoom weighing;
    AppearanceRoom appearance;
    LinearisationRoom linearisation;
    StepRoom step;
};

// Sets a memory to a start and to the model's weights.
void begin_level(const Objective& objective, const State& start, LevelRoom& room);

// Whether to stop: asked once in a while, so that Ctrl-C ends a fit.
using Interrupted = std::function<bool()>;

// Runs the loop from the state in the room's memory. Always terminates.
Trace run_level(const Objective& objective, const EncodedImage& image, const Controls& controls, LevelRoom& room,
                const Interrupted& interrupted);

// Minimises the cost over one image at one level, from a start: the loop with the method's steps, and for `scored` the
// loop with the expected gradient at the end.
Solution solve_level(const Objective& objective, const EncodedImage& image, const State& start, const Options& options,
                     double blur, bool evaluate_last, LevelRoom& room, const Interrupted& interrupted);

}  // namespace liaam
