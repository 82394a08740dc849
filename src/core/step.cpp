#include "step.hpp"

#include <cmath>
#include <limits>

#include "thresholds.hpp"

namespace liaam {

using namespace thresholds;

namespace {

// The observable entries of a matrix, with `more` added to their diagonal; the others become those of the identity.
void take_observable(const Matrix& source, const std::vector<char>& observable, double more, Matrix& out) {
    const std::size_t n = observable.size();
    out.resize(n, n);
    for (std::size_t i = 0; i < n; ++i) {
        for (std::size_t j = 0; j < n; ++j) out[i][j] = observable[i] && observable[j] ? source[i][j] : 0.0;
        out[i][i] += observable[i] ? more : 1.0;
    }
}

// The largest observable entry of a matrix's diagonal, at least 0.
double largest_observable(const Matrix& matrix, const std::vector<char>& observable) {
    double largest = 0.0;
    for (std::size_t i = 0; i < observable.size(); ++i)
        if (observable[i] && matrix[i][i] > largest) largest = matrix[i][i];
    return largest;
}

// Sets the step to the right side of its equations: minus the gradient, and 0 where it is not observable.
void set_right_side(Workspace& work) {
    for (std::size_t i = 0; i < work.step.size(); ++i) work.step[i] = work.observable[i] ? -work.gradient[i] : 0.0;
}

// Makes a matrix whose upper triangle may be stale symmetric; false if a number is not finite.
bool symmetrise(Matrix& matrix) {
    const std::size_t n = matrix.rows();
    bool finite = true;
    for (std::size_t i = 0; i < n; ++i)
        for (std::size_t j = 0; j <= i; ++j) {
            matrix[i][j] = matrix[j][i] = 0.5 * (matrix[i][j] + matrix[j][i]);
            finite = finite && std::isfinite(matrix[i][j]);
        }
    return finite;
}

void transpose(Matrix& matrix) {
    for (std::size_t i = 0; i < matrix.rows(); ++i)
        for (std::size_t j = 0; j < i; ++j) std::swap(matrix[i][j], matrix[j][i]);
}

// The step with max(H, least B) + damping B, in coordinates in which B = L L' is the identity. Raising the pivots of a
// Cholesky factorisation instead (Gill and Murray) takes more steps.
bool whitened_step(double damping, const Matrix& factor, Matrix& matrix, Workspace& work) {
    const std::size_t n = work.step.size();
    solve_lower(factor, matrix);
    transpose(matrix);
    solve_lower(factor, matrix);
    if (!symmetrise(matrix)) return false;
    for (std::size_t i = 0; i < n; ++i) {
        matrix[i][i] -= work.least_curvature;
        for (std::size_t j = 0; j < i; ++j) work.step[i] -= factor[i][j] * work.step[j];
        work.step[i] /= factor[i][i];
    }
    if (!solve_clamped(matrix, work.least_curvature + damping, work.spectrum, work.step)) return false;
    for (std::size_t i = n; i-- > 0;) {
        work.step[i] /= factor[i][i];
        for (std::size_t j = 0; j < i; ++j) work.step[j] -= factor[i][j] * work.step[i];
    }
    return true;
}

// Steps that oscillate about a kink of the bilinear interpolant, which noise sharpens, need a higher bound.
bool goes_back(const Workspace& work) {
    double along = 0.0, squares = 0.0;
    for (std::size_t i = 0; i < work.step.size(); ++i)
        for (std::size_t j = 0; j < work.step.size(); ++j) {
            along += work.step[i] * work.damping_matrix[i][j] * work.last_step[j];
            squares += work.last_step[i] * work.damping_matrix[i][j] * work.last_step[j];
        }
    return along < -kToAndFro * squares;
}

// The Newton step before the bound on the curvature is adapted.
bool clamped_step(double damping, Workspace& work) {
    const double largest = largest_observable(work.damping_matrix, work.observable);
    const double least = work.least_curvature;
    Matrix& factor = work.small;  // B, then L
    Matrix& matrix = work.other;  // H, then what it is solved with
    take_observable(work.damping_matrix, work.observable, kRounding * largest, factor);  // rounding may make B indefinite
    take_observable(work.hessian, work.observable, 0.0, matrix);
    set_right_side(work);
    if (!(largest > 0.0)) return false;
    const std::size_t n = work.step.size();
    for (std::size_t i = 0; i < n; ++i)
        for (std::size_t j = 0; j < n; ++j) matrix[i][j] -= least * factor[i][j];
    const bool steep = cholesky(matrix);  // H >= least B already, as it is near the solution
    take_observable(work.hessian, work.observable, 0.0, matrix);
    if (!steep) return cholesky(factor) && whitened_step(damping, factor, matrix, work);
    for (std::size_t i = 0; i < n; ++i)
        for (std::size_t j = 0; j < n; ++j) matrix[i][j] += damping * factor[i][j];
    if (!cholesky(matrix)) return false;
    solve(matrix, work.step);
    return true;
}

// Adds the points of another landmarker: a Gaussian of p.
void add_points(const EncodedImage& image, Workspace& work) {
    for (std::size_t i = 0; i < image.points.size(); ++i)
        for (std::size_t j = 0; j < image.points.size(); ++j) {
            const double more = work.point_variance * image.point_precision[i][j];
            work.damping_matrix[i][j] += more;
            work.hessian[i][j] += more;
            work.gradient[i] += more * (work.state.p[j] - image.points[j]);
        }
}

}  // namespace

bool observable_parameters(const Method& method, double observable, Workspace& work) {
    std::fill(work.observable.begin(), work.observable.end(), 1);
    const std::size_t n_free = method.n_free();
    const std::size_t n_p = work.observable.size() - n_free;
    if (!n_free) return true;
    // Without a change of light, a common turn of both angles changes only noise: |dr/dtheta|^2 is then
    // |r|^2 |L'|^2 / |L|^2. Turns whose curvature is little more than that are held, so that noise cannot make them drift.
    double squares_of_slope = 0.0;
    double squares_of_metric = 0.0;
    for (std::size_t c = 0; c < work.metric.size(); ++c) {
        squares_of_slope += static_cast<double>(work.metric_slope[c]) * work.metric_slope[c];
        squares_of_metric += static_cast<double>(work.metric[c]) * work.metric[c];
    }
    const double noise = work.squares * squares_of_slope / squares_of_metric + kLeastAngleNoise * work.weight;
    const double observable_apart = std::min(kObservableApart, observable);  // 0 keeps all free, as in the paper
    const double theta_1 = work.hessian[n_p][n_p];
    if (n_free == 1) {
        const bool turns_both = method.directions[0][0] != 0.0;
        work.observable[n_p] = theta_1 > (turns_both ? observable : observable_apart) * noise;
        return work.observable[n_p];
    }
    // In coordinates (common turn, theta_2 alone), with the second eliminated from the first.
    const double cross = work.hessian[n_p][n_p + 1];
    const double theta_2 = work.hessian[n_p + 1][n_p + 1];
    const double mixed = cross + theta_2;
    work.observable[n_p + 1] = theta_2 > observable_apart * noise;
    const double eliminated = work.observable[n_p + 1] ? mixed * mixed / theta_2 : 0.0;
    const double together = theta_1 + 2.0 * cross + theta_2 - eliminated;
    work.observable[n_p] = work.observable[n_p + 1] && together > observable * noise;
    return work.observable[n_p];
}

bool has_texture(const Workspace& work, std::size_t n_p) {
    // The image's own curvature is 0 for a flat image, the expected one for a mesh folded to zero area.
    const auto finite = [](double each) { return std::isfinite(each); };
    const auto& of_image = work.hessian.numbers();
    const auto& of_model = work.expected_hessian.numbers();
    if (!std::isfinite(work.squares) || !std::all_of(of_image.begin(), of_image.end(), finite) ||
        !std::all_of(of_model.begin(), of_model.end(), finite))
        return false;
    double image_curvature = 0.0;
    double model_curvature = 0.0;
    for (std::size_t i = 0; i < n_p; ++i) {
        image_curvature = std::max(image_curvature, std::abs(work.hessian[i][i]));
        model_curvature = std::max(model_curvature, work.expected_hessian[i][i]);
    }
    return work.weight > 0.0 && image_curvature > kTexture * work.weight && model_curvature > 0.0;
}

double next_prior_scale(const Model& model, double strength, double variance, Workspace& work) {
    // The prior is a Student distribution: p ~ N(0, scale Lambda) with dof degrees of freedom. The scale becomes
    // (dof + p' Lambda^-1 p) / (dof + gamma), with gamma the number of parameters that the image determines.
    const double scale = work.prior_scale;
    if (!(variance > 0.0 && variance < std::numeric_limits<double>::infinity())) return scale;
    const std::size_t n = model.prior.size();
    Matrix &matrix = work.small, &inverse = work.other;
    matrix.resize(n, n);
    inverse.resize(n, n);
    inverse.fill(0.0);
    double largest = 0.0;
    for (std::size_t i = 0; i < n; ++i) {
        for (std::size_t j = 0; j < n; ++j) matrix[i][j] = work.damping_matrix[i][j] / variance;
        matrix[i][i] += strength * model.prior[i] / scale;
        inverse[i][i] = 1.0;
        largest = std::max(largest, matrix[i][i]);
    }
    for (std::size_t i = 0; i < n; ++i) matrix[i][i] += kLeastPrecision * largest + 1e-300;
    if (!cholesky(matrix)) return scale;
    solve_lower(matrix, inverse);
    std::vector<double>& variances = work.along;
    variances.assign(n, 0.0);
    for (std::size_t j = 0; j < n; ++j)
        for (std::size_t i = 0; i <= j; ++i) variances[i] += inverse[j][i] * inverse[j][i];
    double gamma = 0.0, squares = 0.0;
    for (std::size_t i = 0; i < n; ++i) {
        if (!(model.prior[i] > 0.0)) continue;
        gamma += 1.0 - strength * model.prior[i] / scale * variances[i];
        squares += strength * model.prior[i] * work.state.p[i] * work.state.p[i];
    }
    const double next = (model.dof + squares) / (model.dof + gamma);
    return next < std::numeric_limits<double>::infinity() ? next : scale;
}

void add_priors(const Objective& objective, const EncodedImage& image, double strength, double variance, Workspace& work) {
    const Model& model = objective.model;
    work.point_variance = variance;
    work.damping_matrix = work.expected_hessian;
    add_points(image, work);
    if (strength > 0.0 && std::isfinite(model.dof))
        work.prior_scale = next_prior_scale(model, strength, variance, work);
    for (std::size_t i = 0; i < model.prior.size(); ++i) {
        const double precision = strength * (variance / work.prior_scale) * model.prior[i];
        work.prior_precision[i] = precision;
        work.damping_matrix[i][i] += precision;
        work.hessian[i][i] += precision;
        work.gradient[i] += precision * work.state.p[i];
    }
}

bool damped_step(double damping, Workspace& work) {
    const double largest = largest_observable(work.hessian, work.observable);
    const double floor = kDampingFloor * largest;
    Matrix& matrix = work.small;
    take_observable(work.hessian, work.observable, floor, matrix);
    set_right_side(work);
    for (std::size_t i = 0; i < work.step.size(); ++i)
        if (work.observable[i]) matrix[i][i] += damping * std::max(work.hessian[i][i], floor);
    if (largest > 0.0 && cholesky(matrix)) {
        solve(matrix, work.step);
        return true;
    }
    std::fill(work.step.begin(), work.step.end(), 0.0);
    return false;
}

bool clamped_newton_step(double damping, Workspace& work) {
    const bool found = clamped_step(damping, work);
    if (goes_back(work)) work.least_curvature *= 2.0;
    return found;
}

double penalised_cost(const Objective& objective, const EncodedImage& image, const Workspace& work) {
    const auto &p = work.state.p, &lam = work.state.lam;
    double squares = work.squares;
    for (std::size_t i = 0; i < p.size(); ++i) squares += work.prior_precision[i] * p[i] * p[i];
    for (std::size_t i = 0; i < image.points.size(); ++i)
        for (std::size_t j = 0; j < image.points.size(); ++j)
            squares += work.point_variance * (p[i] - image.points[i]) * image.point_precision[i][j] * (p[j] - image.points[j]);
    for (std::size_t j = 0; j < lam.size(); ++j) squares += objective.model.ridge[j] * lam[j] * lam[j];
    return work.weight > 0.0 ? squares / work.weight : std::numeric_limits<double>::infinity();
}

double squared_length(const Workspace& work) {
    double squares = 0.0;
    for (std::size_t i = 0; i < work.step.size(); ++i)
        for (std::size_t j = 0; j < work.step.size(); ++j)
            squares += work.step[i] * work.damping_matrix[i][j] * work.step[j];
    return squares;
}

double movement(const Objective& objective, const Workspace& work) {
    double squares = 0.0;
    for (std::size_t i = 0; i < objective.n_p(); ++i) squares += work.step[i] * work.step[i];
    return objective.model.mesh.movement * std::sqrt(squares);
}

void take_step(const Method& method, Workspace& work) {
    work.before = work.state;
    const std::size_t n = work.state.p.size();
    for (std::size_t i = 0; i < n; ++i) work.state.p[i] += work.step[i];
    for (std::size_t a = 0; a < 2; ++a)
        for (std::size_t f = 0; f < method.n_free(); ++f) work.state.angles[a] += method.directions[a][f] * work.step[n + f];
}

void undo_step(Workspace& work) { work.state = work.before; }

}  // namespace liaam
