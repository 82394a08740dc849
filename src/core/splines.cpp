#include "splines.hpp"

namespace liaam {

namespace {

constexpr double kBeside = 1.0 / 6.0, kOwn = 4.0 / 6.0;  // what a slope is weighted with in the equation of a pixel

// Writes scale * (later - earlier).
void write_rise(std::span<double> rise, Doubles earlier, Doubles later, double scale) {
    for (std::size_t k = 0; k < rise.size(); ++k) rise[k] = scale * (later[k] - earlier[k]);
}

// Takes a multiple of another row away.
void subtract(std::span<double> row, Doubles other, double factor) {
    for (std::size_t k = 0; k < row.size(); ++k) row[k] -= factor * other[k];
}

void divide(std::span<double> row, double divisor) {
    for (double& each : row) each /= divisor;
}

// The slopes of one run of at least two pixels: elimination in a tridiagonal system, whose first and last equations
// have the diagonal only. `pivots` is scratch.
void slopes_of_run(MatrixView<const double> values, std::span<const std::int32_t> run, MatrixView<double> slopes,
                   std::vector<double>& pivots) {
    const std::size_t last = run.size() - 1;
    pivots.assign(run.size(), 1.0);
    write_rise(slopes[run[0]], values[run[0]], values[run[1]], 1.0);
    write_rise(slopes[run[last]], values[run[last - 1]], values[run[last]], 1.0);
    for (std::size_t i = 1; i < last; ++i) {
        write_rise(slopes[run[i]], values[run[i - 1]], values[run[i + 1]], 0.5);
        const double factor = kBeside / pivots[i - 1];
        pivots[i] = kOwn - (i == 1 ? 0.0 : factor * kBeside);
        subtract(slopes[run[i]], slopes[run[i - 1]], factor);
    }
    for (std::size_t i = last; i-- > 1;) {
        subtract(slopes[run[i]], slopes[run[i + 1]], kBeside);
        divide(slopes[run[i]], pivots[i]);
    }
}

}  // namespace

void spline_slopes(MatrixView<const double> values, std::span<const std::int32_t> order, std::span<const std::uint8_t> joined,
                   MatrixView<double> slopes) {
    std::vector<double> pivots;
    for (std::size_t first = 0, end = 0; first < order.size(); first = end) {
        for (end = first + 1; end < order.size() && joined[end - 1];) ++end;
        if (end - first > 1)
            slopes_of_run(values, order.subspan(first, end - first), slopes, pivots);
        else
            std::ranges::fill(slopes[order[first]], 0.0);
    }
}

}  // namespace liaam
