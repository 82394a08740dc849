#include "derivatives.hpp"

#include <cmath>

#include "eight.hpp"
#include "modes.hpp"
#include "normal_equations.hpp"

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
void weigh_columns(const Workspace& work, const std::vector<float>& gradients, const float* column, Range residuals,
                   std::vector<float>& fours) {
    const float *root = work.masked.data(), *residual = work.residual.data(), *slopes = gradients.data();
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

// Adds the products of a triangle to the rows of its vertices: with the six coordinates that move its pixels, carried to
// the warp's parameters; with the residual; and with the angle column.
void add_triangle(const Mesh& mesh, std::span<const std::int64_t> triangle, const CornerPairs& pairs, Matrix& sums) {
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
                weights[2 * c] = pair[4 * axis];
                weights[2 * c + 1] = pair[4 * axis + 1];
                by_residual += pair[4 * axis + 2];  // barycentric weights sum to 1
                by_angle += pair[4 * axis + 3];
            }
            double* own = sums[2 * triangle[corner] + axis];
#pragma omp simd
            for (std::size_t j = 0; j < width; ++j)
                own[j] += ((weights[0] * rows[0][j] + weights[1] * rows[1][j]) +
                           (weights[2] * rows[2][j] + weights[3] * rows[3][j])) +
                          (weights[4] * rows[4][j] + weights[5] * rows[5][j]);
            own[width] += by_residual;
            own[width + 1] += by_angle;
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

// Adds J'A of a triangle to the rows of its vertices.
void add_triangle_modes(const Objective& objective, std::span<const std::int64_t> triangle, Range pixels, Workspace& work) {
    const Mesh& mesh = objective.model.mesh;
    const std::size_t k = objective.k(), width = objective.width();
    for (std::size_t column = 0; column < width; column += kEight) {
        ModeSums sums;
        const float* four = work.fours.data();
        const float* lines = work.lines.data() + pixels.begin * k * width + column;
        for (std::size_t i = pixels.begin; i < pixels.end; ++i) {
            Eight x{}, y{};
            for (std::size_t r = 0; r < k; ++r, four += 4, lines += width) {
                const Eight line = load(lines);
                x += four[0] * line;
                y += four[1] * line;
            }
            sums.add(mesh.beta[i].data(), x, y);
        }
        const Eight* of_corner[3][2] = {{&sums.ax, &sums.ay}, {&sums.bx, &sums.by}, {&sums.cx, &sums.cy}};
        for (std::size_t corner = 0; corner < 3; ++corner)
            for (std::size_t axis = 0; axis < 2; ++axis) {
                double* out = work.modes_by_vertex[2 * triangle[corner] + axis] + column;
                for (std::size_t j = 0; j < kEight; ++j) out[j] += (*of_corner[corner][axis])[j];
            }
    }
}

// E'J, E'r and E' times an angle column, for x and y of each vertex; and J'A, with the first column. Triangle by
// triangle, so that what is summed stays in the cache.
void sum_by_vertex(const Objective& objective, const std::vector<float>& of_j, const std::vector<float>& of_e,
                   std::size_t f, Workspace& work) {
    const Mesh& mesh = objective.model.mesh;
    const std::size_t k = objective.k();
    const float* column = work.columns.empty() ? nullptr : work.columns[f].data();
    work.by_vertex.resize(2 * mesh.n_vertices(), mesh.basis.n_columns + kEight);
    work.by_vertex.fill(0.0);
    if (f == 0) {
        work.modes_by_vertex.resize(2 * mesh.n_vertices(), objective.width());
        work.modes_by_vertex.fill(0.0);
    }
    for (std::size_t t = 0; t < mesh.triangles.n_rows; ++t) {
        const Range pixels{static_cast<std::size_t>(mesh.starts[t]), static_cast<std::size_t>(mesh.starts[t + 1])};
        if (pixels.begin == pixels.end) continue;
        weigh_columns(work, of_j, column, {pixels.begin * k, pixels.end * k}, work.fours);
        CornerPairs pairs;
        const float* fours = work.fours.data();
        for (std::size_t i = pixels.begin; i < pixels.end; ++i, fours += 4 * k)
            pairs.add(mesh.beta[i].data(), pixel_products(fours, of_e.data() + 2 * i * k, k));
        add_triangle(mesh, mesh.triangles[t], pairs, work.by_vertex);
        if (f == 0) add_triangle_modes(objective, mesh.triangles[t], pixels, work);
    }
}

void differentiate_angle(const Objective& objective, std::size_t f, Workspace& work) {
    const double by_model = objective.method.directions[0][f], theta = work.state.angles[0];
    const auto by_image = static_cast<float>(objective.method.directions[1][f]);
    const std::size_t k = objective.k();
    std::vector<float>& out = work.columns[f];
    for (std::size_t e = 0; e < out.size(); ++e) {
        const float *slope = work.metric_slope.data() + kChannels * (e % k), *value = work.values.data() + kChannels * (e / k);
        float change = 0.0f;
        for (std::size_t c = 0; c + 1 < kChannels; ++c) change += slope[c] * value[c];
        if (!work.weight_slope.empty()) change += work.weight_slope[e] * work.residual[e];
        out[e] = by_image * change;
    }
    if (!objective.model.theta_1_is_free()) return;
    const auto along = static_cast<float>(by_model * std::cos(theta)), across = static_cast<float>(by_model * std::sin(theta));
    const auto& parts = objective.model.row_parts;
    for (std::size_t j = 0; j < parts[0].n_rows; ++j) {
        const float scale = j == 0 ? 1.0f : static_cast<float>(work.state.lam[j - 1]);
        const float *by_cos = parts[1][j].data(), *by_sin = parts[2][j].data();
#pragma omp simd
        for (std::size_t e = 0; e < out.size(); ++e) out[e] -= scale * (along * by_sin[e] - across * by_cos[e]);
    }
}

double weighted_product(const std::vector<float>& root, const std::vector<float>& a, const std::vector<float>& b) {
    double product = 0.0;
    for (std::size_t e = 0; e < root.size(); ++e) product += root[e] * root[e] * a[e] * b[e];
    return product;
}

// Products of the angles' columns with each other, with the modes and with the residual.
void sum_angle_products(const Objective& objective, Workspace& work) {
    const std::size_t n_p = objective.n_p(), n_free = work.columns.size();
    for (std::size_t f = 0; f < n_free; ++f) {
        multiply_modes(work.rows, work.masked, work.columns[f], work.block, work.lam_step);
        for (std::size_t j = 0; j < work.lam_step.size(); ++j) work.aj[j][n_p + f] = work.lam_step[j];
        for (std::size_t g = 0; g < n_free; ++g)
            work.hessian[n_p + f][n_p + g] = weighted_product(work.masked, work.columns[f], work.columns[g]);
        work.gradient[n_p + f] = weighted_product(work.masked, work.columns[f], work.residual);
    }
}

}  // namespace

void model_gradient(const Objective& objective, Workspace& work) {
    std::copy_n(work.slopes.data, work.appearance_slopes.size(), work.appearance_slopes.begin());
    add_modes(work.slopes, work.state.lam, 1.0, work.appearance_slopes);
    vertices_at(objective.model.mesh, work.state.p, work.vertices);
    pull_gradients(objective.model.mesh, work.vertices, work.appearance_slopes, work.expected);
}

void differentiate_angles(const Objective& objective, Workspace& work) {
    for (std::size_t f = 0; f < work.columns.size(); ++f) differentiate_angle(objective, f, work);
}

void linearise(const Objective& objective, Workspace& work, Linearisation kind) {
    const Mesh& mesh = objective.model.mesh;
    const std::size_t n_p = objective.n_p(), n_free = work.columns.size(), width = mesh.basis.n_columns;
    const auto &of_j = kind.image_in_j ? work.gradients : work.expected;
    const auto &of_e = kind.image_in_e ? work.gradients : work.expected;
    differentiate_angles(objective, work);
    sum_angle_products(objective, work);
    for (std::size_t f = 0; f < std::max<std::size_t>(n_free, 1); ++f) {
        sum_by_vertex(objective, of_j, of_e, f, work);
        multiply_transposed(mesh.basis, work.by_vertex.view(), n_p, work.carried);
        for (std::size_t i = 0; i < n_p && n_free; ++i)
            work.hessian[i][n_p + f] = work.hessian[n_p + f][i] = work.carried[i][width + 1];
    }
    multiply_transposed(mesh.basis, work.modes_by_vertex.view(), n_p, work.carried_modes);
    for (std::size_t i = 0; i < n_p; ++i) {
        work.gradient[i] = work.carried[i][width];
        std::copy_n(work.carried[i], n_p, work.hessian[i]);
        for (std::size_t j = 0; j < work.ar.size(); ++j) work.aj[j][i] = work.carried_modes[i][j];
    }
    eliminate_appearance(work);
}

}  // namespace liaam
