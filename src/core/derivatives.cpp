#include "derivatives.hpp"

#include <cmath>

#include "eight.hpp"
#include "linear.hpp"
#include "modes.hpp"

namespace liaam {

namespace {

// Sums over the pixels of a triangle, of products with each pair of its corners' barycentric weights.
struct CornerPairs {
    Eight aa{}, ab{}, ac{}, bb{}, bc{}, cc{};

    void add(const float* beta, Eight sum) {
        const Eight by_a = beta[0] * sum, by_b = beta[1] * sum, by_c = beta[2] * sum;
        aa += beta[0] * by_a;
        ab += beta[0] * by_b;
        ac += beta[0] * by_c;
        bb += beta[1] * by_b;
        bc += beta[1] * by_c;
        cc += beta[2] * by_c;
    }
};

// Pixels of a triangle, and their residuals.
struct Range {
    std::size_t begin, end;
};

// w^2 (gradient by x, by y, residual, angle column or 0) of the residuals of a triangle's pixels.
void weigh_columns(const FittedAppearance& fitted, Floats gradients, const float* column, Range residuals,
                   std::vector<float>& fours) {
    const float *root = fitted.sqrt_weights.data(), *residual = fitted.residual.data(), *slopes = gradients.data();
    fours.resize(std::max(fours.size(), 4 * (residuals.end - residuals.begin) + kEight));
    float* out = fours.data();
    for (std::size_t e = residuals.begin; e < residuals.end; ++e, out += 4) {
        const float square = root[e] * root[e];
        out[0] = square * slopes[2 * e];
        out[1] = square * slopes[2 * e + 1];
        out[2] = square * residual[e];
        out[3] = column ? square * column[e] : 0.0f;
    }
}

// The eight sums of a pixel: the products of the expected gradient by x with its four columns, then those by y.
inline Eight pixel_products(const float* fours, const float* expected, std::size_t k) {
    Eight by_x{}, by_y{};
    for (std::size_t r = 0; r < k; ++r) {
        const Eight four = load(fours + 4 * r);  // the upper half is of the next residual, and not used
        by_x += expected[2 * r] * four;
        by_y += expected[2 * r + 1] * four;
    }
    return lower_halves(by_x, by_y);
}

// Adds the products of a triangle to the rows of its vertices: with the six coordinates that move its pixels, symmetrised
// and carried to the warp's parameters; and with the residual and the angle column.
void add_triangle(const Mesh& mesh, std::span<const std::int64_t> triangle, const CornerPairs& pairs, Matrix& sums,
                  Matrix& right) {
    const std::size_t width = mesh.basis.n_columns;
    const Eight* of_corner[3][3] = {
        {&pairs.aa, &pairs.ab, &pairs.ac}, {&pairs.ab, &pairs.bb, &pairs.bc}, {&pairs.ac, &pairs.bc, &pairs.cc}};
    const double* rows[6];
    for (std::size_t c = 0; c < 3; ++c) {
        rows[2 * c] = mesh.basis[2 * triangle[c]].data();
        rows[2 * c + 1] = mesh.basis[2 * triangle[c] + 1].data();
    }
    for (std::size_t corner = 0; corner < 3; ++corner) {
        for (std::size_t axis = 0; axis < 2; ++axis) {
            double weights[6], by_residual = 0.0, by_angle = 0.0;
            for (std::size_t c = 0; c < 3; ++c) {
                const Eight& pair = *of_corner[corner][c];
                const double own = pair[5 * axis], mixed = 0.5 * (pair[1] + pair[4]);  // xx or yy; xy and yx
                weights[2 * c] = axis == 0 ? own : mixed;
                weights[2 * c + 1] = axis == 0 ? mixed : own;
                by_residual += pair[4 * axis + 2];  // barycentric weights sum to 1
                by_angle += pair[4 * axis + 3];
            }
            double* own = sums[2 * triangle[corner] + axis];
#pragma omp simd
            for (std::size_t j = 0; j < width; ++j)
                own[j] += ((weights[0] * rows[0][j] + weights[1] * rows[1][j]) +
                           (weights[2] * rows[2][j] + weights[3] * rows[3][j])) +
                          (weights[4] * rows[4][j] + weights[5] * rows[5][j]);
            right[2 * triangle[corner] + axis][0] += by_residual;
            right[2 * triangle[corner] + axis][1] += by_angle;
        }
    }
}

// J'A of eight modes over a triangle, for x and y of its three vertices.
struct ModeSums {
    Eight ax{}, ay{}, bx{}, by{}, cx{}, cy{};

    void add(const float* beta, Eight x, Eight y) {
        ax += beta[0] * x;
        ay += beta[0] * y;
        bx += beta[1] * x;
        by += beta[1] * y;
        cx += beta[2] * x;
        cy += beta[2] * y;
    }
};

// Adds J'A of a triangle, of the codes of the modes, to the rows of its vertices.
template <class Lines>
void add_triangle_modes(const Mesh& mesh, std::span<const std::int64_t> triangle, Range pixels, std::size_t k,
                        const Lines& lines, const std::vector<float>& fours, Matrix& sums_of_all) {
    const std::size_t width = sums_of_all.columns();
    for (std::size_t column = 0; column < width; column += kEight) {
        ModeSums sums;
        const float* four = fours.data();
        std::size_t at = pixels.begin * k * width + column;
        for (std::size_t i = pixels.begin; i < pixels.end; ++i) {
            Eight x{}, y{};
            for (std::size_t r = 0; r < k; ++r, four += 4, at += width) {
                const Eight own = lines.at(at);
                x += four[0] * own;
                y += four[1] * own;
            }
            sums.add(mesh.beta[i].data(), x, y);
        }
        const Eight* of_corner[3][2] = {{&sums.ax, &sums.ay}, {&sums.bx, &sums.by}, {&sums.cx, &sums.cy}};
        for (std::size_t corner = 0; corner < 3; ++corner)
            for (std::size_t axis = 0; axis < 2; ++axis) {
                double* out = sums_of_all[2 * triangle[corner] + axis] + column;
                for (std::size_t j = 0; j < kEight; ++j) out[j] += (*of_corner[corner][axis])[j];
            }
    }
}

// E'J, E'r and E' times an angle column, for x and y of each vertex; and J'A, with the first column, of the codes of the
// modes. Triangle by triangle, so that what is summed stays in the cache.
void sum_by_vertex(const Objective& objective, const Samples& samples, const FittedAppearance& fitted, Floats of_j,
                   Floats of_e, std::size_t f, LinearisationRoom& room) {
    const Mesh& mesh = objective.model.mesh;
    const std::size_t k = objective.k();
    const float* column = room.columns.empty() ? nullptr : room.columns[f].data();
    room.by_vertex.resize(2 * mesh.n_vertices(), mesh.basis.n_columns);
    room.by_vertex.fill(0.0);
    room.right_by_vertex.resize(2 * mesh.n_vertices(), kEight);
    room.right_by_vertex.fill(0.0);
    if (f == 0) {
        room.modes_by_vertex.resize(2 * mesh.n_vertices(), objective.width());
        room.modes_by_vertex.fill(0.0);
    }
    for (std::size_t t = 0; t < mesh.triangles.n_rows; ++t) {
        const Range pixels{static_cast<std::size_t>(mesh.starts[t]), static_cast<std::size_t>(mesh.starts[t + 1])};
        if (pixels.begin == pixels.end) continue;
        weigh_columns(fitted, of_j, column, {pixels.begin * k, pixels.end * k}, room.fours);
        CornerPairs pairs;
        const float* fours = room.fours.data();
        for (std::size_t i = pixels.begin; i < pixels.end; ++i, fours += 4 * k)
            pairs.add(mesh.beta[i].data(), pixel_products(fours, of_e.data() + 2 * i * k, k));
        add_triangle(mesh, mesh.triangles[t], pairs, room.by_vertex, room.right_by_vertex);
        if (f > 0) continue;
        with_lines(samples.modes, [&](const auto& lines) {
            add_triangle_modes(mesh, mesh.triangles[t], pixels, k, lines, room.fours, room.modes_by_vertex);
        });
    }
}

// The derivative of the weighted residual by a free angle, divided by the square root of the weight: that of eq 10 is
// L'(theta_2) log I and -L'(theta_1) A.
void differentiate_angle(const Objective& objective, std::size_t f, const Samples& samples,
                         const FittedAppearance& fitted, const Weights& weights, std::vector<float>& out) {
    const double by_model = objective.method.directions[0][f], theta = samples.angles[0];
    const auto by_image = static_cast<float>(objective.method.directions[1][f]);
    const std::size_t k = objective.k();
    out.resize(fitted.residual.size());
    for (std::size_t e = 0; e < out.size(); ++e) {
        const float* slope = samples.metric_slope.data() + kChannels * (e % k);
        const float* value = samples.values.data() + kChannels * (e / k);
        float change = 0.0f;
        for (std::size_t c = 0; c + 1 < kChannels; ++c) change += slope[c] * value[c];
        if (!weights.slope.empty()) change += weights.slope[e] * fitted.residual[e];
        out[e] = by_image * change;
    }
    if (!objective.model.theta_1_is_free()) return;
    const auto along = static_cast<float>(by_model * std::cos(theta)), across = static_cast<float>(by_model * std::sin(theta));
    const auto& [mean, modes] = objective.model.appearance;
    const float *by_cosine = mean[1].data(), *by_sine = mean[2].data();
#pragma omp simd
    for (std::size_t e = 0; e < out.size(); ++e) out[e] -= along * by_sine[e] - across * by_cosine[e];
    add_modes({{modes.parts[1]}, modes.scales}, fitted.lam, across, out);
    add_modes({{modes.parts[2]}, modes.scales}, fitted.lam, -along, out);
}

// Products of the angles' columns with each other, with the modes and with the residual.
void sum_angle_products(const Objective& objective, const Samples& samples, const FittedAppearance& fitted,
                        LinearisationRoom& room) {
    const std::size_t n_p = objective.n_p(), n_free = room.columns.size(), m = objective.m();
    room.mode_products.resize(m);
    for (std::size_t f = 0; f < n_free; ++f) {
        multiply_modes(samples.modes, fitted.sqrt_weights, room.columns[f], room.mode_products);
        for (std::size_t j = 0; j < m; ++j) room.aj[j][n_p + f] = room.mode_products[j];
        for (std::size_t g = f; g < n_free; ++g)
            room.equations.hessian[n_p + f][n_p + g] = room.equations.hessian[n_p + g][n_p + f] =
                weighted_product(fitted.sqrt_weights, room.columns[f], room.columns[g]);
        room.equations.gradient[n_p + f] = weighted_product(fitted.sqrt_weights, room.columns[f], fitted.residual);
    }
}

// Replaces the symmetrised E'J and E'r by the Hessian E'QJ and the gradient E'Qr.
void eliminate_appearance(const FittedAppearance& fitted, LinearisationRoom& room) {
    auto& [hessian, expected, gradient] = room.equations;
    const std::size_t n = gradient.size();
    room.whitened = room.aj;
    solve_lower(fitted.factor, room.whitened);
    room.whitened_slope = fitted.slope;
    solve_lower(fitted.factor, room.whitened_slope);
    for (std::size_t i = 0; i < room.whitened_slope.size(); ++i)
        for (std::size_t a = 0; a < n; ++a) gradient[a] -= room.whitened_slope[i] * room.whitened[i][a];
    multiply_symmetric(room.whitened.view(), room.whitened.view(), n, room.product);
    for (std::size_t a = 0; a < n; ++a)
        for (std::size_t b = 0; b < n; ++b) hessian[a][b] -= room.product[a][b];
}

}  // namespace

void begin_equations(const Objective& objective, NormalEquations& equations) {
    equations.expected_hessian.resize(objective.n_q(), objective.n_q());
    equations.expected_hessian.fill(0.0);
}

const std::vector<float>& expected_gradient(const Objective& objective, const Samples& samples, Doubles lam,
                                            LinearisationRoom& room) {
    std::vector<float>& own = room.appearance_gradients;
    own.assign(samples.mean_gradients.begin(), samples.mean_gradients.end());
    add_modes(samples.mode_gradients, lam, 1.0, own);
    room.expected.resize(own.size());
    pull_gradients(objective.model.mesh, samples.vertices, own, room.expected);
    return room.expected;
}

void multiply_derivatives(const Objective& objective, const Samples& samples, const FittedAppearance& fitted,
                          const Weights& weights, Floats of_j, Floats of_e, LinearisationRoom& room) {
    const Mesh& mesh = objective.model.mesh;
    const std::size_t n_p = objective.n_p(), n_q = objective.n_q(), m = objective.m();
    const std::size_t n_free = objective.method.n_free();
    Matrix& hessian = room.equations.hessian;
    hessian.resize(n_q, n_q);
    room.equations.gradient.resize(n_q);
    room.aj.resize(m, n_q);
    room.columns.resize(n_free);
    for (std::size_t f = 0; f < n_free; ++f)
        differentiate_angle(objective, f, samples, fitted, weights, room.columns[f]);
    sum_angle_products(objective, samples, fitted, room);
    for (std::size_t f = 0; f < std::max<std::size_t>(n_free, 1); ++f) {
        sum_by_vertex(objective, samples, fitted, of_j, of_e, f, room);
        multiply_symmetric(mesh.basis, room.by_vertex.view(), n_p, room.carried);
        multiply_transposed(mesh.basis, room.right_by_vertex.view(), n_p, room.carried_right);
        for (std::size_t i = 0; i < n_p && n_free; ++i)
            hessian[i][n_p + f] = hessian[n_p + f][i] = room.carried_right[i][1];
    }
    multiply_transposed(mesh.basis, room.modes_by_vertex.view(), n_p, room.carried_modes);
    for (std::size_t i = 0; i < n_p; ++i) {
        room.equations.gradient[i] = room.carried_right[i][0];
        std::copy_n(room.carried[i], n_p, hessian[i]);
        for (std::size_t j = 0; j < m; ++j) room.aj[j][i] = samples.modes.scales[j] * room.carried_modes[i][j];
    }
    eliminate_appearance(fitted, room);
}

const NormalEquations& linearise(const Objective& objective, const Samples& samples, const FittedAppearance& fitted,
                                 const Weights& weights, bool expects, bool fresh, LinearisationRoom& room) {
    NormalEquations& equations = room.equations;
    if (!expects) {
        multiply_derivatives(objective, samples, fitted, weights, samples.gradients, samples.gradients, room);
        equations.expected_hessian = equations.hessian;
        return equations;
    }
    const Floats expected = expected_gradient(objective, samples, fitted.lam, room);
    if (fresh) {
        multiply_derivatives(objective, samples, fitted, weights, expected, expected, room);
        equations.expected_hessian = equations.hessian;
    }
    multiply_derivatives(objective, samples, fitted, weights, samples.gradients, expected, room);
    return equations;
}

}  // namespace liaam
