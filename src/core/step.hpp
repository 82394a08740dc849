// The step of the warp's parameters and the free angles (the Gauss-Newton step of section 4), the priors, and which
// parameters are observable.
#pragma once

#include "derivatives.hpp"
#include "linear.hpp"

namespace liaam {

// The priors on p, where a residual of weight 1 has a variance.
struct Priors {
    double variance = 0.0;          // converts the points' precision to units of squared residuals
    double scale = 1.0;             // of the shape prior's variances
    std::vector<double> precision;  // (n_p): of the shape prior, in units of squared residuals
};

// What later steps with the expected gradient depend on.
struct NewtonMemory {
    double least_curvature = 0.0;   // lower bound on the curvature, as a fraction of the expected
    std::vector<double> last_step;  // (n_q): the last accepted
};

struct Step {
    bool found = false;
    std::vector<double> q;  // (n_q): change of p and of the free angles
};

// Room for a step, reused by the next.
struct StepRoom {
    NormalEquations with_priors;
    Step step;
    std::vector<char> observable;  // (n_q): which entries of q may move
    Matrix factor, matrix;
    std::vector<double> variances;
    Spectrum spectrum;
};

// The priors and the memory that a level begins with.
void begin_steps(const Objective& objective, Priors& priors, NewtonMemory& memory);

// The entries of q that may move: p, and the angles that the image determines. In the room until the next.
const std::vector<char>& observable_parameters(const Method& method, const Samples& samples,
                                               const FittedAppearance& fitted, const Matrix& hessian, double observable,
                                               StepRoom& room);

// Whether image and model both have texture, and all sums are finite.
bool has_texture(const NormalEquations& equations, const FittedAppearance& fitted, std::size_t n_p);

// The equations with the priors, on p and by points of another landmarker, where a residual of weight 1 has the given
// variance; updates the priors. In the room until the next.
const NormalEquations& add_priors(const Objective& objective, const EncodedImage& image, const std::vector<double>& p,
                                  double strength, double variance, const NormalEquations& equations, Priors& priors,
                                  StepRoom& room);

// The Levenberg step, (H + damping diag H) step = -gradient. In the room until the next, as the one below.
const Step& damped_step(const NormalEquations& equations, const std::vector<char>& observable, double damping,
                        StepRoom& room);

// The Newton step of a symmetric H whose curvature is raised to a fraction of that of B, the expected Hessian: each
// generalised eigenvalue rho of H v = rho B v becomes max(rho, least) + damping. The memory's fraction doubles where
// steps go to and fro.
const Step& clamped_newton_step(const NormalEquations& equations, const std::vector<char>& observable, double damping,
                                NewtonMemory& memory, StepRoom& room);

// The cost that an accepted step must not raise: mean squared residual plus the priors on p and lambda.
double penalised_cost(const Objective& objective, const EncodedImage& image, Doubles p, const FittedAppearance& fitted,
                      const Priors& priors);

// Squared length of a step in the metric of a matrix.
double squared_length(Doubles step, const Matrix& metric);

// Root mean square movement of the landmarks by a step, model pixels.
double movement(const Objective& objective, Doubles step);

// Takes a step (forward-additive).
void take_step(const Method& method, Doubles step, State& state);

// One step of the evidence's fixed point (MacKay, Neural Computation 4, 1992) for the scale of the shape prior. The image
// determines p by a Hessian, where a residual of weight 1 has the given variance.
double next_prior_scale(const Model& model, const Matrix& hessian, const std::vector<double>& p, double scale,
                        double strength, double variance, StepRoom& room);

}  // namespace liaam
