// The normal equations of a step: derivatives of the residual, their products, and the elimination of the appearance
// (the Gauss-Newton step of section 4).
//
// The residual is linear in lambda and linearised in q = (p, free angles): r + J dq - A dl. With Q the projection on the
// complement of A, a step solves J'QJ dq = -J'Qr. Neither Q nor QJ is formed, only Gram matrices of the columns:
// J'QJ = J'J - (A'J)' (A'A)^-1 (A'J).
//
// A pixel moves only with the three vertices of its triangle (eq 3), so that its row of derivatives by the vertices,
// dr(x) / d(vertex v) = beta_v(x) gradient(x), has six entries that are not 0. Products are summed by triangle and
// mapped to the warp's parameters at the end.
#pragma once

#include "appearance.hpp"

namespace liaam {

// Equations H dq = -g of a step of q, without the appearance.
struct NormalEquations {
    Matrix hessian;                // E'QJ, with E the derivatives that the model expects, or J
    Matrix expected_hessian;       // E'QE
    std::vector<double> gradient;  // E'Qr
};

// Room for normal equations, reused by the next.
struct LinearisationRoom {
    NormalEquations equations;
    std::vector<float> appearance_gradients;  // (2 n k): of the fitted appearance, reference frame
    std::vector<float> expected;              // (2 n k): the gradient that the model expects, by x and y
    std::vector<std::vector<float>> columns;  // (n k) each: derivatives by the free angles
    std::vector<float> fours;                 // of the pixels of a triangle
    Matrix by_vertex, modes_by_vertex;        // E'J, symmetrised, and J'A, by the coordinates of the vertices
    Matrix right_by_vertex;                   // E'r, E' times an angle column, and zeros up to the width of a vector
    Matrix carried, carried_modes, carried_right;  // the same by p
    Matrix aj;                                // A'J
    Matrix whitened, product;                 // L^-1 A'J, and its square
    std::vector<double> whitened_slope;       // L^-1 A'r
    std::vector<double> mode_products;
};

// Sets the expected Hessian to 0, until there is one.
void begin_equations(const Objective& objective, NormalEquations& equations);

// The normal equations at samples, in the room until the next. `expects` asks for the derivatives E with the spatial
// gradient that the model expects; else E is J, with the image's own. E'QE is kept unless it is `fresh`.
const NormalEquations& linearise(const Objective& objective, const Samples& samples, const FittedAppearance& fitted,
                                 const Weights& weights, bool expects, bool fresh, LinearisationRoom& room);

// The spatial gradient of the residual that the model expects: that of the fitted appearance, carried to the image.
const std::vector<float>& expected_gradient(const Objective& objective, const Samples& samples, Doubles lam,
                                            LinearisationRoom& room);

// Sets the Hessian E'QJ and the gradient E'Qr, with J of one spatial gradient of the residual, and E of another.
void multiply_derivatives(const Objective& objective, const Samples& samples, const FittedAppearance& fitted,
                          const Weights& weights, Floats of_j, Floats of_e, LinearisationRoom& room);

}  // namespace liaam
