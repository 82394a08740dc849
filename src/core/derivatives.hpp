// Derivatives of the residual, and their products.
//
// A pixel moves only with the three vertices of its triangle (eq 3), so that its row of derivatives by the vertices,
// dr(x) / d(vertex v) = beta_v(x) gradient(x), has six entries that are not 0. Products are summed by triangle and
// mapped to the warp's parameters at the end.
#pragma once

#include "objective.hpp"

namespace liaam {

// The spatial gradient of the residual that the model expects: that of the fitted appearance, carried to the image.
void model_gradient(const Objective& objective, Workspace& work);

// The Hessian E'QJ and the gradient E'Qr, with J from the image's gradient and E from the expected one, where asked for.
struct Linearisation {
    bool image_in_j = true;    // J is of the image's own gradient; else of the expected one
    bool image_in_e = true;    // the same of E
};
void linearise(const Objective& objective, Workspace& work, Linearisation kind);

// Derivatives of the weighted residual by the free angles, divided by the square root of the weight: those of eq 10 are
// L'(theta_2) log I and -L'(theta_1) A.
void differentiate_angles(const Objective& objective, Workspace& work);

}  // namespace liaam
