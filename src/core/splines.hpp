// Slopes of cubic splines through the pixels of a frame.
#pragma once

#include "arrays.hpp"

namespace liaam {

// Slopes (n, k) of the cubic splines through values (n, k) of runs of neighbouring pixels. `order` (n) lists the pixels
// along the lines, and `joined` (n) says whether one and the next of the list are neighbours, as the last has none. The
// slopes m of a spline through f obey (m[-1] + 4 m[0] + m[1]) / 6 = (f[1] - f[-1]) / 2; the ends of a run have the
// difference to their neighbour, and pixels without one have 0.
void spline_slopes(MatrixView<const double> values, std::span<const std::int32_t> order, std::span<const std::uint8_t> joined,
                   MatrixView<double> slopes);

}  // namespace liaam
