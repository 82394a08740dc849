#include "linear.hpp"

#include <cmath>

namespace liaam {

namespace {

constexpr double kNegligible = 1e-13;  // entries beside the diagonal that count as 0, relative to the largest
constexpr std::size_t kRotations = 3;  // most rotations, as a multiple of n^2; about n^2 are used

constexpr std::size_t kTall = 4, kWide = 8;  // a tile of a product, whose sums stay in registers

// Rows i to i + kTall and columns j to j + kWide of L'R.
void multiply_tile(MatrixView<const double> left, MatrixView<const double> right, std::size_t i, std::size_t j, Matrix& out) {
    double sums[kTall][kWide]{};
    const double *a = left.data + i, *b = right.data + j;
    for (std::size_t k = 0; k < left.n_rows; ++k, a += left.n_columns, b += right.n_columns)
        for (std::size_t t = 0; t < kTall; ++t)
#pragma omp simd
            for (std::size_t u = 0; u < kWide; ++u) sums[t][u] += a[t] * b[u];
    for (std::size_t t = 0; t < kTall; ++t) std::copy_n(sums[t], kWide, out[i + t] + j);
}

// As many rows and columns of L'R as there are, fewer than those of a tile.
void multiply_small(MatrixView<const double> left, MatrixView<const double> right, Matrix& out) {
    out.fill(0.0);
    for (std::size_t k = 0; k < left.n_rows; ++k)
        for (std::size_t i = 0; i < out.rows(); ++i)
            for (std::size_t j = 0; j < out.columns(); ++j) out[i][j] += left[k][i] * right[k][j];
}

// Replaces r by (I - f v v') r; v begins at index `first`.
void reflect(const double* v, std::size_t first, double factor, std::span<double> right) {
    double along = 0.0;
    for (std::size_t j = first; j < right.size(); ++j) along += v[j] * right[j];
    for (std::size_t j = first; j < right.size(); ++j) right[j] -= factor * along * v[j];
}

// One of Householder's reflections: clears row and column k of the matrix beyond the entry beside the diagonal.
void reflect_matrix(Matrix& matrix, std::size_t k, double factor, std::vector<double>& moved) {
    const std::size_t n = matrix.rows();
    const double* v = matrix[k];
    double along = 0.0;
    for (std::size_t i = k + 1; i < n; ++i) {
        const double* row = matrix[i];
        double total = 0.0;
#pragma omp simd reduction(+ : total)
        for (std::size_t j = k + 1; j < n; ++j) total += row[j] * v[j];
        moved[i] = factor * total;
        along += moved[i] * v[i];
    }
    for (std::size_t i = k + 1; i < n; ++i) moved[i] -= 0.5 * factor * along * v[i];
    for (std::size_t i = k + 1; i < n; ++i) {
        double* row = matrix[i];
        const double own = v[i], other = moved[i];
#pragma omp simd
        for (std::size_t j = k + 1; j < n; ++j) row[j] -= own * moved[j] + other * v[j];
    }
}

// Reduces a symmetric M to a tridiagonal T = Q'MQ by Householder's reflections, and replaces r by Q'r. Row k of the
// matrix then holds, right of the diagonal, the vector of reflection k.
void tridiagonalise(Matrix& matrix, Spectrum& spectrum, std::span<double> right) {
    const std::size_t n = matrix.rows();
    for (auto* each : {&spectrum.diagonal, &spectrum.beside, &spectrum.factors, &spectrum.moved}) each->assign(n, 0.0);
    for (std::size_t k = 0; k < n; ++k) {
        double* v = matrix[k];
        double squares = 0.0;
        spectrum.diagonal[k] = v[k];
        for (std::size_t j = k + 1; j < n; ++j) squares += v[j] * v[j];
        if (!(squares > 1e-300)) continue;
        const double first = v[k + 1];
        const double beside = first > 0.0 ? -std::sqrt(squares) : std::sqrt(squares);  // the sign without cancellation
        v[k + 1] = first - beside;
        spectrum.beside[k] = beside;
        spectrum.factors[k] = 1.0 / (squares - first * beside);
        reflect_matrix(matrix, k, spectrum.factors[k], spectrum.moved);
        reflect(v, k + 1, spectrum.factors[k], right);
    }
}

// One implicit QL step on entries low to high of a tridiagonal matrix; r passes its rotations.
void implicit_step(std::size_t low, std::size_t high, Spectrum& spectrum, std::span<double> right) {
    auto &d = spectrum.diagonal, &e = spectrum.beside;
    const double shift = (d[low + 1] - d[low]) / (2.0 * e[low]);
    const double root = std::sqrt(shift * shift + 1.0);
    double g = d[high] - d[low] + e[low] / (shift + (shift >= 0.0 ? root : -root));
    double s = 1.0, c = 1.0, back = 0.0;
    for (std::size_t i = high; i-- > low;) {
        const double f = s * e[i], b = c * e[i], size = std::sqrt(f * f + g * g);
        e[i + 1] = size;
        s = size > 0.0 ? f / size : 0.0;
        c = size > 0.0 ? g / size : 1.0;
        g = d[i + 1] - back;
        const double more = (d[i] - g) * s + 2.0 * c * b;
        back = s * more;
        d[i + 1] = g + back;
        g = c * more - b;
        spectrum.rotations.push_back({c, s, i});
        const double below = right[i + 1], own = right[i];
        right[i + 1] = s * own + c * below;
        right[i] = c * own - s * below;
    }
    d[low] -= back;
    e[low] = g;
    e[high] = 0.0;
}

// Reduces a tridiagonal T to a diagonal S'TS by implicit QL steps (Golub and Van Loan, section 8.3), and replaces r
// by S'r. False if there are too many.
bool diagonalise(Spectrum& spectrum, std::span<double> right) {
    const auto &d = spectrum.diagonal, &e = spectrum.beside;
    const std::size_t n = right.size();
    double least = 0.0;
    for (std::size_t i = 0; i < n; ++i) least = std::max(least, kNegligible * (std::abs(d[i]) + std::abs(e[i])));
    spectrum.rotations.clear();
    for (std::size_t low = 0; low < n;) {
        std::size_t high = low;
        while (high + 1 < n && std::abs(e[high]) > least) ++high;
        if (high == low) {
            ++low;
            continue;
        }
        if (spectrum.rotations.size() + (high - low) > kRotations * n * n) return false;
        implicit_step(low, high, spectrum, right);
    }
    return true;
}

}  // namespace

bool cholesky(Matrix& matrix) {
    const std::size_t n = matrix.rows();
    for (std::size_t j = 0; j < n; ++j) {
        double* own = matrix[j];
        for (std::size_t i = j; i < n; ++i) {
            double* other = matrix[i];
            double left = other[j];
#pragma omp simd reduction(- : left)
            for (std::size_t k = 0; k < j; ++k) left -= own[k] * other[k];
            if (i > j) {
                other[j] = left / own[j];
            } else if (left > 0.0) {  // written so that NaN fails
                own[j] = std::sqrt(left);
            } else {
                return false;
            }
        }
    }
    return true;
}

void solve_lower(const Matrix& factor, Matrix& right) {
    const std::size_t n = factor.rows(), width = right.columns();
    for (std::size_t i = 0; i < n; ++i) {
        const double* own = factor[i];
        double* row = right[i];
        std::size_t j = 0;
        for (; j + 4 <= i; j += 4) {  // four at a time: each number of the sum is loaded once for four products
            const double *a = right[j], *b = right[j + 1], *c = right[j + 2], *d = right[j + 3];
#pragma omp simd
            for (std::size_t x = 0; x < width; ++x)
                row[x] -= (own[j] * a[x] + own[j + 1] * b[x]) + (own[j + 2] * c[x] + own[j + 3] * d[x]);
        }
        for (; j < i; ++j) {
            const double* a = right[j];
#pragma omp simd
            for (std::size_t x = 0; x < width; ++x) row[x] -= own[j] * a[x];
        }
        const double scale = 1.0 / own[i];
        for (std::size_t x = 0; x < width; ++x) row[x] *= scale;
    }
}

void solve_lower(const Matrix& factor, std::span<double> right) {
    for (std::size_t i = 0; i < factor.rows(); ++i) {
        const double* own = factor[i];
        double left = right[i];
        for (std::size_t j = 0; j < i; ++j) left -= own[j] * right[j];
        right[i] = left / own[i];
    }
}

void solve_upper(const Matrix& factor, std::span<double> right) {
    for (std::size_t i = factor.rows(); i-- > 0;) {
        const double* own = factor[i];
        right[i] /= own[i];
        for (std::size_t j = 0; j < i; ++j) right[j] -= own[j] * right[i];
    }
}

void solve(const Matrix& factor, std::span<double> right) {
    solve_lower(factor, right);
    solve_upper(factor, right);
}

void multiply_transposed(MatrixView<const double> left, MatrixView<const double> right, std::size_t rows, Matrix& out) {
    const std::size_t width = right.n_columns;
    out.resize(rows, width);
    if (rows < kTall || width < kWide) return multiply_small(left, right, out);
    for (std::size_t i = 0; i < rows; i += kTall)  // the last tiles overlap those before them
        for (std::size_t j = 0; j < width; j += kWide)
            multiply_tile(left, right, std::min(i, rows - kTall), std::min(j, width - kWide), out);
}

void multiply_symmetric(MatrixView<const double> left, MatrixView<const double> right, std::size_t rows, Matrix& out) {
    out.resize(rows, rows);
    if (rows < kWide) return multiply_small(left, right, out);
    for (std::size_t i = 0; i < rows; i += kTall) {
        const std::size_t top = std::min(i, rows - kTall);
        for (std::size_t j = 0; j < top + kTall; j += kWide)
            multiply_tile(left, right, top, std::min(j, rows - kWide), out);
    }
    for (std::size_t i = 0; i < rows; ++i)
        for (std::size_t j = 0; j < i; ++j) out[j][i] = out[i][j];
}

bool solve_clamped(Matrix& matrix, double least, Spectrum& spectrum, std::span<double> right) {
    tridiagonalise(matrix, spectrum, right);
    const bool found = diagonalise(spectrum, right);
    for (std::size_t i = 0; i < right.size(); ++i) right[i] /= std::max(spectrum.diagonal[i], 0.0) + least;
    for (std::size_t t = spectrum.rotations.size(); t-- > 0;) {
        const auto [c, s, i] = spectrum.rotations[t];
        const double own = right[i], below = right[i + 1];
        right[i] = c * own + s * below;
        right[i + 1] = c * below - s * own;
    }
    for (std::size_t k = right.size(); k-- > 0;) reflect(matrix[k], k + 1, spectrum.factors[k], right);
    return found && (right.empty() || std::isfinite(right[0]));
}

}  // namespace liaam
