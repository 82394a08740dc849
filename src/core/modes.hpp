// Products with the appearance modes, or with their gradients (eq 4): A'A, A'c and A lambda.
//
// Modes are stored in 16 bits, since fits wait for memory more than for arithmetic, and pixel by pixel: one line holds all
// modes at a residual. So sums over residuals and sums over modes both read them once and in order. Eight modes at a time
// become float32 in a register.
#pragma once

#include <array>
#include <vector>

#include "arrays.hpp"
#include "eight.hpp"

namespace liaam {

constexpr std::size_t kBlock = 128;  // residuals whose products are summed in float32 before they are added in float64

// m modes at a number of residuals: mode j at residual e is scales[j] codes[e][j]. Where they depend on theta_1, the codes
// are parts[0] + cos(theta_1) parts[1] + sin(theta_1) parts[2]; else parts[0], and the others are empty.
struct Modes {
    std::array<MatrixView<const std::int16_t>, 3> parts;  // (n k, w) each, w = m padded with zeros to a multiple of eight
    Floats scales;                                        // (w)
    float cosine = 0.0f, sine = 0.0f;                     // of theta_1

    std::size_t width() const { return parts[0].n_columns; }
    bool turn() const { return !parts[1].empty(); }
};

// The codes of modes as float32, eight at a time.
struct FixedLines {
    const std::int16_t* codes;

    Eight at(std::size_t i) const { return load(codes + i); }
};

struct TurnedLines {
    const std::int16_t *constant, *by_cosine, *by_sine;
    float cosine, sine;

    Eight at(std::size_t i) const {
        return load(constant + i) + (cosine * load(by_cosine + i) + sine * load(by_sine + i));
    }
};

// Calls a function with the lines of modes.
template <class Function>
void with_lines(const Modes& modes, Function function) {
    const auto& [constant, by_cosine, by_sine] = modes.parts;
    if (modes.turn()) function(TurnedLines{constant.data, by_cosine.data, by_sine.data, modes.cosine, modes.sine});
    else function(FixedLines{constant.data});
}

// All modes at residual e, (w).
void modes_at_residual(const Modes& modes, std::size_t e, std::span<float> out);

// A'A under weights.
void weighted_gram(const Modes& modes, Floats sqrt_weights, std::vector<float>& block, Matrix& gram);

// A'c: weighted products of a column with the modes.
void multiply_modes(const Modes& modes, Floats sqrt_weights, Floats column, std::span<double> out);

// The weighted product of two columns.
double weighted_product(Floats sqrt_weights, Floats a, Floats b);

// Adds scale A lambda to a column, such as the residual or, of the modes' gradients, the mean's.
void add_modes(const Modes& modes, Doubles lam, double scale, std::span<float> out);

}  // namespace liaam
