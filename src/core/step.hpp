// The step of the warp's parameters and the free angles (the Gauss-Newton step of section 4), the priors, and which
// parameters are observable.
#pragma once

#include "objective.hpp"

namespace liaam {

// Marks the entries of q that may move: p, and the angles that the image determines. False if an angle is held.
bool observable_parameters(const Method& method, double observable, Workspace& work);

// Whether image and model both have texture, and all sums are finite.
bool has_texture(const Workspace& work, std::size_t n_p);

// Adds the priors, on p and by points of another landmarker, to the normal equations, where a residual of weight 1 has
// the given variance; updates the scale of the shape prior.
void add_priors(const Objective& objective, const EncodedImage& image, double strength, double variance, Workspace& work);

// The Levenberg step, (H + damping diag H) step = -gradient; false if there is none.
bool damped_step(double damping, Workspace& work);

// The Newton step of a symmetric H whose curvature is raised to a fraction of that of B, the damping matrix: each
// generalised eigenvalue rho of H v = rho B v becomes max(rho, least) + damping. False if there is none.
bool clamped_newton_step(double damping, Workspace& work);

// The cost that an accepted step must not raise: mean squared residual plus the priors on p and lambda.
double penalised_cost(const Objective& objective, const EncodedImage& image, const Workspace& work);

// Squared length of the step in the metric of the damping matrix.
double squared_length(const Workspace& work);

// Root mean square movement of the landmarks by the step, model pixels.
double movement(const Objective& objective, const Workspace& work);

// Takes the step (forward-additive), and keeps the state before it; `undo` goes back to it.
void take_step(const Method& method, Workspace& work);
void undo_step(Workspace& work);

// One step of the evidence's fixed point (MacKay, Neural Computation 4, 1992) for the scale of the shape prior.
double next_prior_scale(const Model& model, double strength, double variance, Workspace& work);

}  // namespace liaam
