// Normal equations with the appearance eliminated (the Gauss-Newton step of section 4).
//
// The residual is linear in lambda and linearised in q = (p, free angles): r + J dq - A dl. With Q the projection on the
// complement of A, a step solves J'QJ dq = -J'Qr. Neither Q nor QJ is formed, only Gram matrices of the columns:
// J'QJ = J'J - (A'J)' (A'A)^-1 (A'J).
#pragma once

#include "objective.hpp"

namespace liaam {

// Solves for lambda under the weights if `solves`, and sums the squares of the residual that it leaves (eq 9 and 10).
// `weighed` says that the weights have changed.
void solve_appearance(const Objective& objective, Workspace& work, bool weighed, bool solves);

// Replaces J'J and J'r by the symmetrised Hessian J'QJ and the gradient J'Qr.
void eliminate_appearance(Workspace& work);

}  // namespace liaam
