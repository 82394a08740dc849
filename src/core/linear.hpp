// Small dense systems: Cholesky's factor, and a symmetric eigensolver through which only the right side passes.
#pragma once

#include <span>
#include <vector>

#include "arrays.hpp"

namespace liaam {

// Replaces the lower triangle of a matrix by its Cholesky factor L; false if it is not positive definite.
bool cholesky(Matrix& matrix);

// Replaces the columns R by L^-1 R, r by L^-1 r, or r by L'^-1 r.
void solve_lower(const Matrix& factor, Matrix& right);
void solve_lower(const Matrix& factor, std::span<double> right);
void solve_upper(const Matrix& factor, std::span<double> right);

// Replaces r by (L L')^-1 r.
void solve(const Matrix& factor, std::span<double> right);

// Writes the first `rows` rows of L'R, of L (n, a) and R (n, b).
void multiply_transposed(MatrixView<const double> left, MatrixView<const double> right, std::size_t rows, Matrix& out);

// Writes the first `rows` rows and columns of an L'R that is symmetric there: only half of them are multiplied.
void multiply_symmetric(MatrixView<const double> left, MatrixView<const double> right, std::size_t rows, Matrix& out);

// Room for the eigensolver, reused between calls.
struct Spectrum {
    std::vector<double> diagonal, beside, factors, moved;
    struct Rotation {
        double c, s;
        std::size_t i;
    };
    std::vector<Rotation> rotations;
};

// Replaces r by (M+ + least)^-1 r, where M+ is a symmetric M with 0 in place of its negative eigenvalues.
// False if the iteration does not converge or the result is not finite; M is overwritten.
bool solve_clamped(Matrix& matrix, double least, Spectrum& spectrum, std::span<double> right);

}  // namespace liaam
