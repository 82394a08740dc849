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

// The right side of the equations of a step: minus the gradient, and 0 where it is not observable.
void set_right_side(Doubles gradient, const std::vector<char>& observable, std::vector<double>& right) {
    right.resize(gradient.size());
    for (std::size_t i = 0; i < gradient.size(); ++i) right[i] = observable[i] ? -gradient[i] : 0.0;
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

// Replaces the right side of the equations by the step with max(H, least B) + damping B, in coordinates in which
// B = L L' is the identity; false if there is none. H is overwritten. Raising the pivots of a Cholesky factorisation
// instead (Gill and Murray) takes more steps.
bool whitened_step(const Matrix& factor, Matrix& hessian, double least, double damping, Spectrum& spectrum,
                   std::vector<double>& step) {
    solve_lower(factor, hessian);
    transpose(hessian);
    solve_lower(factor, hessian);
    if (!symmetrise(hessian)) return false;
    for (std::size_t i = 0; i < step.size(); ++i) hessian[i][i] -= least;
    solve_lower(factor, step);
    if (!solve_clamped(hessian, least + damping, spectrum, step)) return false;
    solve_upper(factor, step);
    return true;
}

// Steps that oscillate about a kink of the bilinear interpolant, which noise sharpens, need a higher bound.
bool goes_back(Doubles step, Doubles last, const Matrix& metric) {
    double along = 0.0, squares = 0.0;
    for (std::size_t i = 0; i < step.size(); ++i)
        for (std::size_t j = 0; j < step.size(); ++j) {
            along += step[i] * metric[i][j] * last[j];
            squares += last[i] * metric[i][j] * last[j];
        }
    return along < -kToAndFro * squares;
}

// Writes the Newton step whose curvature is at least a fraction of the expected; false if there is none.
bool clamped_step(const NormalEquations& equations, const std::vector<char>& observable, double least, double damping,
                  StepRoom& room) {
    std::vector<double>& step = room.step.q;
    const double largest = largest_observable(equations.expected_hessian, observable);
    Matrix& factor = room.factor;  // B, then L
    Matrix& matrix = room.matrix;  // H, then what it is solved with
    const double ridge = kRounding * largest;  // rounding may make B indefinite
    take_observable(equations.expected_hessian, observable, ridge, factor);
    take_observable(equations.hessian, observable, 0.0, matrix);
    set_right_side(equations.gradient, observable, step);
    if (!(largest > 0.0)) return false;
    const std::size_t n = step.size();
    for (std::size_t i = 0; i < n; ++i)
        for (std::size_t j = 0; j < n; ++j) matrix[i][j] -= least * factor[i][j];
    const bool steep = cholesky(matrix);  // H >= least B already, as it is near the solution
    take_observable(equations.hessian, observable, 0.0, matrix);
    if (!steep) return cholesky(factor) && whitened_step(factor, matrix, least, damping, room.spectrum, step);
    for (std::size_t i = 0; i < n; ++i)
        for (std::size_t j = 0; j < n; ++j) matrix[i][j] += damping * factor[i][j];
    if (!cholesky(matrix)) return false;
    solve(matrix, step);
    return true;
}

// Adds the points of another landmarker, a Gaussian of p, where a residual of weight 1 has the given variance.
void add_points(const EncodedImage& image, Doubles p, double variance, NormalEquations& equations) {
    for (std::size_t i = 0; i < image.points.size(); ++i)
        for (std::size_t j = 0; j < image.points.size(); ++j) {
            const double more = variance * image.point_precision[i][j];
            equations.expected_hessian[i][j] += more;
            equations.hessian[i][j] += more;
            equations.gradient[i] += more * (p[j] - image.points[j]);
        }
}

}  // namespace

void begin_steps(const Objective& objective, Priors& priors, NewtonMemory& memory) {
    priors.variance = 0.0;
    priors.scale = 1.0;
    priors.precision.assign(objective.n_p(), 0.0);
    memory.least_curvature = kLeastCurvature;
    memory.last_step.assign(objective.n_q(), 0.0);
}

const std::vector<char>& observable_parameters(const Method& method, const Samples& samples,
                                               const FittedAppearance& fitted, const Matrix& hessian, double observable,
                                               StepRoom& room) {
    std::vector<char>& moves = room.observable;
    moves.assign(hessian.rows(), 1);
    const std::size_t n_free = method.n_free();
    const std::size_t n_p = moves.size() - n_free;
    if (!n_free) return moves;
    // Without a change of light, a common turn of both angles changes only noise: |dr/dtheta|^2 is then
    // |r|^2 |L'|^2 / |L|^2. Turns whose curvature is little more than that are held, so that noise cannot make them drift.
    double squares_of_slope = 0.0;
    double squares_of_metric = 0.0;
    for (std::size_t c = 0; c < samples.metric.size(); ++c) {
        squares_of_slope += static_cast<double>(samples.metric_slope[c]) * samples.metric_slope[c];
        squares_of_metric += static_cast<double>(samples.metric[c]) * samples.metric[c];
    }
    const double noise = fitted.squares * squares_of_slope / squares_of_metric + kLeastAngleNoise * fitted.weight;
    const double observable_apart = std::min(kObservableApart, observable);  // 0 keeps all free, as in the paper
    const double theta_1 = hessian[n_p][n_p];
    if (n_free == 1) {
        const bool turns_both = method.directions[0][0] != 0.0;
        moves[n_p] = theta_1 > (turns_both ? observable : observable_apart) * noise;
        return moves;
    }
    // In coordinates (common turn, theta_2 alone), with the second eliminated from the first.
    const double cross = hessian[n_p][n_p + 1];
    const double theta_2 = hessian[n_p + 1][n_p + 1];
    const double mixed = cross + theta_2;
    moves[n_p + 1] = theta_2 > observable_apart * noise;
    const double eliminated = moves[n_p + 1] ? mixed * mixed / theta_2 : 0.0;
    const double together = theta_1 + 2.0 * cross + theta_2 - eliminated;
    moves[n_p] = moves[n_p + 1] && together > observable * noise;
    return moves;
}

bool has_texture(const NormalEquations& equations, const FittedAppearance& fitted, std::size_t n_p) {
    // The image's own curvature is 0 for a flat image, the expected one for a mesh folded to zero area.
    const auto finite = [](double each) { return std::isfinite(each); };
    const auto& of_image = equations.hessian.numbers();
    const auto& of_model = equations.expected_hessian.numbers();
    if (!std::isfinite(fitted.squares) || !std::all_of(of_image.begin(), of_image.end(), finite) ||
        !std::all_of(of_model.begin(), of_model.end(), finite))
        return false;
    double image_curvature = 0.0;
    double model_curvature = 0.0;
    for (std::size_t i = 0; i < n_p; ++i) {
        image_curvature = std::max(image_curvature, std::abs(equations.hessian[i][i]));
        model_curvature = std::max(model_curvature, equations.expected_hessian[i][i]);
    }
    return fitted.weight > 0.0 && image_curvature > kTexture * fitted.weight && model_curvature > 0.0;
}

double next_prior_scale(const Model& model, const Matrix& hessian, const std::vector<double>& p, double scale,
                        double strength, double variance, StepRoom& room) {
    // The prior is a Student distribution: p ~ N(0, scale Lambda) with dof degrees of freedom. The scale becomes
    // (dof + p' Lambda^-1 p) / (dof + gamma), with gamma the number of parameters that the image determines.
    if (!(variance > 0.0 && variance < std::numeric_limits<double>::infinity())) return scale;
    const std::size_t n = model.prior.size();
    Matrix &matrix = room.matrix, &inverse = room.factor;
    matrix.resize(n, n);
    inverse.resize(n, n);
    inverse.fill(0.0);
    double largest = 0.0;
    for (std::size_t i = 0; i < n; ++i) {
        for (std::size_t j = 0; j < n; ++j) matrix[i][j] = hessian[i][j] / variance;
        matrix[i][i] += strength * model.prior[i] / scale;
        inverse[i][i] = 1.0;
        largest = std::max(largest, matrix[i][i]);
    }
    for (std::size_t i = 0; i < n; ++i) matrix[i][i] += kLeastPrecision * largest + 1e-300;
    if (!cholesky(matrix)) return scale;
    solve_lower(matrix, inverse);
    std::vector<double>& variances = room.variances;
    variances.assign(n, 0.0);
    for (std::size_t j = 0; j < n; ++j)
        for (std::size_t i = 0; i <= j; ++i) variances[i] += inverse[j][i] * inverse[j][i];
    double gamma = 0.0, squares = 0.0;
    for (std::size_t i = 0; i < n; ++i) {
        if (!(model.prior[i] > 0.0)) continue;
        gamma += 1.0 - strength * model.prior[i] / scale * variances[i];
        squares += strength * model.prior[i] * p[i] * p[i];
    }
    const double next = (model.dof + squares) / (model.dof + gamma);
    return next < std::numeric_limits<double>::infinity() ? next : scale;
}

const NormalEquations& add_priors(const Objective& objective, const EncodedImage& image, const std::vector<double>& p,
                                  double strength, double variance, const NormalEquations& equations, Priors& priors,
                                  StepRoom& room) {
    const Model& model = objective.model;
    NormalEquations& all = room.with_priors;
    all = equations;
    priors.variance = variance;
    add_points(image, p, variance, all);
    if (strength > 0.0 && std::isfinite(model.dof))
        priors.scale = next_prior_scale(model, all.expected_hessian, p, priors.scale, strength, variance, room);
    for (std::size_t i = 0; i < model.prior.size(); ++i) {
        const double precision = strength * (variance / priors.scale) * model.prior[i];
        priors.precision[i] = precision;
        all.expected_hessian[i][i] += precision;
        all.hessian[i][i] += precision;
        all.gradient[i] += precision * p[i];
    }
    return all;
}

const Step& damped_step(const NormalEquations& equations, const std::vector<char>& observable, double damping,
                        StepRoom& room) {
    std::vector<double>& step = room.step.q;
    const double largest = largest_observable(equations.hessian, observable);
    const double floor = kDampingFloor * largest;
    Matrix& matrix = room.matrix;
    take_observable(equations.hessian, observable, floor, matrix);
    set_right_side(equations.gradient, observable, step);
    for (std::size_t i = 0; i < step.size(); ++i)
        if (observable[i]) matrix[i][i] += damping * std::max(equations.hessian[i][i], floor);
    room.step.found = largest > 0.0 && cholesky(matrix);
    if (room.step.found) solve(matrix, step);
    else std::fill(step.begin(), step.end(), 0.0);
    return room.step;
}

const Step& clamped_newton_step(const NormalEquations& equations, const std::vector<char>& observable, double damping,
                                NewtonMemory& memory, StepRoom& room) {
    room.step.found = clamped_step(equations, observable, memory.least_curvature, damping, room);
    if (goes_back(room.step.q, memory.last_step, equations.expected_hessian)) memory.least_curvature *= 2.0;
    return room.step;
}

double penalised_cost(const Objective& objective, const EncodedImage& image, Doubles p, const FittedAppearance& fitted,
                      const Priors& priors) {
    double squares = fitted.squares;
    for (std::size_t i = 0; i < p.size(); ++i) squares += priors.precision[i] * p[i] * p[i];
    for (std::size_t i = 0; i < image.points.size(); ++i)
        for (std::size_t j = 0; j < image.points.size(); ++j)
            squares += priors.variance * (p[i] - image.points[i]) * image.point_precision[i][j] * (p[j] - image.points[j]);
    for (std::size_t j = 0; j < fitted.lam.size(); ++j)
        squares += objective.model.ridge[j] * fitted.lam[j] * fitted.lam[j];
    return fitted.weight > 0.0 ? squares / fitted.weight : std::numeric_limits<double>::infinity();
}

double squared_length(Doubles step, const Matrix& metric) {
    double squares = 0.0;
    for (std::size_t i = 0; i < step.size(); ++i)
        for (std::size_t j = 0; j < step.size(); ++j) squares += step[i] * metric[i][j] * step[j];
    return squares;
}

double movement(const Objective& objective, Doubles step) {
    double squares = 0.0;
    for (std::size_t i = 0; i < objective.n_p(); ++i) squares += step[i] * step[i];
    return objective.model.mesh.movement * std::sqrt(squares);
}

void take_step(const Method& method, Doubles step, State& state) {
    const std::size_t n = state.p.size();
    for (std::size_t i = 0; i < n; ++i) state.p[i] += step[i];
    for (std::size_t a = 0; a < 2; ++a)
        for (std::size_t f = 0; f < method.n_free(); ++f) state.angles[a] += method.directions[a][f] * step[n + f];
}

}  // namespace liaam
