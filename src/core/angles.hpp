// The initial angle of the image's camera: for fixed p, theta_2 and lambda have a joint optimum (docs/explanation/theory.md).
#pragma once

#include "samples.hpp"

namespace liaam {

// The angle theta_2 within 60 degrees of theta_1 that minimises eq 10 over theta_2 and lambda at a state, under the
// model's weights; the state's own where no pixel is usable. The method compares the invariant.
double best_image_angle(const Objective& objective, const EncodedImage& image, const State& state, SamplingRoom& room);

// The angle t within `reach` of `centre` that minimises u'Su - 2b'u over u = (cos t, sin t); S as (S00, S01, S11).
double minimise_on_arc(std::array<double, 3> s, std::array<double, 2> b, double centre, double reach);

}  // namespace liaam
