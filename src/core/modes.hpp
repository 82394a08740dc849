// Products with the appearance modes: A'A, A'c and A lambda (eq 4). Of modes (1 + m, n k), the first is the mean.
#pragma once

#include <vector>

#include "arrays.hpp"

namespace liaam {

constexpr std::size_t kBlock = 2048;  // residuals whose products are summed in float32 before they are added in float64

// A'A of the modes without the mean, under weights.
void weighted_gram(MatrixView<const float> modes, Floats sqrt_weights, std::vector<float>& block, Matrix& gram);

// A'c: weighted products of a column with the modes.
void multiply_modes(MatrixView<const float> modes, Floats sqrt_weights, Floats column, std::vector<float>& block,
                    std::span<double> out);

// The weighted product of two columns.
double weighted_product(Floats sqrt_weights, Floats a, Floats b);

// Adds scale A lambda to a column, such as the residual or, of the modes' gradients, the mean's.
void add_modes(MatrixView<const float> modes, Doubles lam, double scale, std::span<float> out);

}  // namespace liaam
