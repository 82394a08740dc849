#include "level.hpp"

#include <cmath>
#include <limits>

#include "thresholds.hpp"

namespace liaam {

using namespace thresholds;

namespace {

double raised_damping(double damping, bool expected) {
    return std::max(10.0 * damping, expected ? kFirstExpectedDamping : kFirstDamping);
}

double eased_damping(double damping, const Controls& controls) {
    if (controls.expected) return damping > kTrustedDamping ? 0.1 * damping : 0.0;
    return controls.damping > 0.0 ? std::max(0.1 * damping, kLeastDamping) : 0.0;
}

// The loop's own variables between iterations.
struct Loop {
    double damping = 0.0;
    int rounds = 0;      // alternations of weights and lambda before the next step
    double least = std::numeric_limits<double>::infinity();  // the lowest penalised cost under the current weights
    bool tried = false;  // a step was taken and is not judged yet
    bool small = false;  // it was too short to matter
    bool fresh = true;   // the weights are new, so that the expected curvature is out of date
};

// Whether each update of the weights depends on means over many pixels only, so that one update is enough.
bool weighs_by_means(const Method& method) {
    return method.weighting == Weighting::rows && method.loss == Loss::none;
}

// Updates of the weights after a step.
int usual_rounds(const Method& method) { return method.loss == Loss::none ? 1 : kRounds; }

// Updates of the weights at the start: two at least if each pixel's weight depends on its own residual, and so on the
// weights before.
int first_rounds(const Method& method) { return weighs_by_means(method) ? 1 : std::max(usual_rounds(method), 2); }

// Judges the step that was tried by its cost; false if it is refused.
bool judge(double cost, const Controls& controls, Loop& loop, Trace& trace) {
    const double rise = controls.expected ? kExpectedRise : kRise;
    loop.tried = !(controls.damping > 0.0 && !(cost <= rise * loop.least));  // NaN is refused, too
    if (!loop.tried) {
        trace.converged = loop.small || loop.damping >= kDampingLimit;
        loop.damping = raised_damping(loop.damping, controls.expected);
        loop.rounds = 0;
        return false;
    }
    loop.damping = eased_damping(loop.damping, controls);
    loop.least = std::min(loop.least, cost);
    trace.converged = loop.small && loop.damping <= kTrustedDamping;  // else damping may be what makes the step small
    return true;
}

// Records a state, or only its cost anew where it was recorded before.
void record(const State& state, const FittedAppearance& fitted, bool is_new, Trace& trace) {
    if (is_new) {
        trace.costs.push_back(0.0);
        trace.path.insert(trace.path.end(), state.p.begin(), state.p.end());
        trace.angles.push_back(state.angles);
    }
    trace.costs.back() =
        fitted.weight > 0.0 ? fitted.squares / fitted.weight : std::numeric_limits<double>::infinity();
}

// The variance of a residual of weight 1, and whether the weights say it; else it is that of the residuals.
struct ResidualVariance {
    double value;
    bool known;
};

ResidualVariance residual_variance(const Objective& objective, const Weights& weights, const FittedAppearance& fitted) {
    const bool known = objective.method.weighting == Weighting::rows && std::isfinite(weights.noise_variance);
    return {known ? weights.noise_variance : objective.model.correlated * fitted.squares / fitted.weight, known};
}

// The step of q = (p, free angles) that solves the equations.
const Step& solve(const NormalEquations& equations, const std::vector<char>& observable, double damping, bool expected,
                  NewtonMemory& memory, StepRoom& room) {
    if (expected) return clamped_newton_step(equations, observable, damping, memory, room);
    return damped_step(equations, observable, damping, room);
}

// Whether a step is short compared with its own standard deviation, where that is known.
bool is_negligible(const Controls& controls, Doubles step, double length, const Matrix& metric, double damping,
                   const ResidualVariance& variance) {
    const double limit = controls.relative_tolerance * controls.relative_tolerance * step.size() * variance.value;
    return variance.known && squared_length(step, metric) < limit && damping <= kMostNegligibleDamping &&
           length < kLongestUnseen;
}

// Whether a step of a length is shorter than the tolerance, which is larger for the first ones.
bool is_short(const Controls& controls, double length, int n_iterations) {
    return length < controls.tolerance || (n_iterations < controls.early_steps && length < controls.early_limit);
}

// Rows of a level that count as contrast: for weights by rows those of the gradients.
std::size_t rows_shown(const Objective& objective) {
    return objective.method.weighting == Weighting::rows ? 2 : objective.k();
}

std::vector<Contrast> contrast_of(const Objective& objective, const Samples& samples, Floats residual,
                                  Floats sqrt_weights) {
    const std::size_t k = objective.k();
    std::vector<Contrast> sums(rows_shown(objective), Contrast{});
    for (std::size_t i = 0; i < samples.usable.size(); ++i) {
        for (std::size_t r = 0; r < sums.size(); ++r) {
            const std::size_t e = i * k + r;
            const double weight = static_cast<double>(samples.usable[i]) * sqrt_weights[e] * sqrt_weights[e];
            const double sample = samples.projected[e], left = residual[e];
            sums[r][0] += weight;
            sums[r][1] += weight * sample;
            sums[r][2] += weight * sample * sample;
            sums[r][3] += weight * left * left;
        }
    }
    return sums;
}

// Collects the solution that a level ended with.
Solution collect(const Objective& objective, Trace trace, const LevelRoom& room, bool keeps_samples) {
    const Samples& samples = room.sampling.samples;
    const FittedAppearance& fitted = room.appearance.fitted;
    Solution fit;
    fit.state = room.memory.state;
    fit.trace = std::move(trace);
    fit.noise_variance = room.memory.weights.noise_variance;
    fit.squares = fitted.squares;
    fit.weight = fitted.weight;
    fit.prior_scale = room.memory.priors.scale;
    fit.expected_hessian = room.linearisation.equations.expected_hessian;
    fit.usable = samples.usable;
    fit.contrast = contrast_of(objective, samples, fitted.residual, objective.model.sqrt_weights);
    fit.weighted_contrast = contrast_of(objective, samples, fitted.residual, fitted.sqrt_weights);
    const std::size_t k = objective.k(), shown = rows_shown(objective);
    for (std::size_t e = 0; e < fitted.sqrt_weights.size(); ++e)
        fit.n_counted += e % k < shown && fitted.sqrt_weights[e] != 0.0f;
    if (!keeps_samples) return fit;
    fit.residual = fitted.residual;
    fit.samples = samples.projected;
    return fit;
}

// Sets the tolerance of the first steps of a level, and their number.
void set_early(const Method& method, double blur, bool is_scored, Controls& controls) {
    double fraction = 0.0;
    if (method.step == StepKind::expected) {
        fraction = kEarlyExpected;
        controls.early_steps = kEarlyExpectedSteps;
    } else if (controls.evaluate_last && is_scored && !method.reweighs()) {
        // Weights that the steps update are those of the solution only at the end.
        fraction = kEarlyScored;
        controls.early_steps = controls.max_iterations;
    } else if (!controls.evaluate_last || is_scored) {
        fraction = kEarlyOwn;
        controls.early_steps = kEarlyOwnSteps;
    }  // else these steps are the last: they converge slowly, and need the full tolerance
    controls.early_limit = blur * (controls.early_tolerance >= 0.0 ? controls.early_tolerance : fraction);
}

void append(const Trace& more, std::size_t n_p, Trace& trace) {
    trace.costs.insert(trace.costs.end(), more.costs.begin() + 1, more.costs.end());
    trace.path.insert(trace.path.end(), more.path.begin() + static_cast<std::ptrdiff_t>(n_p), more.path.end());
    trace.angles.insert(trace.angles.end(), more.angles.begin() + 1, more.angles.end());
    trace.n_iterations += more.n_iterations;
    trace.angle_fixed = more.angle_fixed;
}

// Steps with the expected gradient from the solution of a level; none if they raise the cost. The weights are kept,
// unless their number was asked for.
void score(const Objective& objective, const EncodedImage& image, Controls controls, Trace& trace, LevelRoom& room,
           const Interrupted& interrupted) {
    const Memory before = room.memory;
    const Trace more = run_level(objective, image, controls, room, interrupted);
    if (more.costs.back() <= kScoringRise * trace.costs.back()) {
        append(more, objective.n_p(), trace);
        return;
    }
    room.memory = before;
    controls.max_iterations = 0;
    controls.expected = controls.reweigh = false;
    controls.evaluate_last = true;
    run_level(objective, image, controls, room, interrupted);
}

}  // namespace

void begin_level(const Objective& objective, const State& start, LevelRoom& room) {
    room.memory.state = start;
    begin_weights(objective, room.memory.weights);
    begin_steps(objective, room.memory.priors, room.memory.newton);
    begin_equations(objective, room.linearisation.equations);
}

Trace run_level(const Objective& objective, const EncodedImage& image, const Controls& controls, LevelRoom& room,
                const Interrupted& interrupted) {
    const Method& method = objective.method;
    auto& [state, weights, priors, newton] = room.memory;
    State before;
    Trace trace;
    Loop loop{.damping = controls.damping, .rounds = controls.reweigh ? first_rounds(method) : 0};
    while (true) {
        const Samples& samples = sample(objective, image, state, room.sampling);  // log and P at W(x; p): eq 3, 6 to 8
        turn_weights(objective, samples, weights, room.weighing);
        const FittedAppearance& fitted = fit_appearance(objective, samples, weights, room.appearance);  // eq 4 and 10
        state.lam = fitted.lam;
        const bool is_new = loop.tried || trace.costs.empty();
        if (loop.tried) {
            if (!judge(penalised_cost(objective, image, state.p, fitted, priors), controls, loop, trace)) {
                state = before;
                continue;
            }
            newton.last_step = room.step.step.q;
        }
        while (loop.rounds > 0 && update_weights(objective, image, samples, fitted.residual, weights, room.weighing)) {
            state.lam = refit_appearance(objective, samples, weights, room.appearance).lam;
            loop.least = std::numeric_limits<double>::infinity();  // new weights invalidate the lowest cost
            loop.fresh = true;
            --loop.rounds;
        }
        record(state, fitted, is_new, trace);
        const bool ends = trace.converged || trace.n_iterations >= controls.max_iterations ||
                          !std::isfinite(trace.costs.back()) || interrupted();
        if (ends && !controls.evaluate_last) break;

        const NormalEquations& equations = linearise(objective, samples, fitted, weights, controls.expected && !ends,
                                                     loop.fresh, room.linearisation);
        const auto& observable =
            observable_parameters(method, samples, fitted, equations.hessian, controls.observable, room.step);
        trace.angle_fixed = std::find(observable.begin(), observable.end(), 0) != observable.end();
        trace.no_texture = !has_texture(equations, fitted, objective.n_p());
        if (ends || trace.no_texture) break;

        const ResidualVariance variance = residual_variance(objective, weights, fitted);
        const NormalEquations& system =
            add_priors(objective, image, state.p, controls.shape_prior, variance.value, equations, priors, room.step);
        const Step& step = solve(system, observable, loop.damping, controls.expected, newton, room.step);
        trace.no_texture = !step.found;
        if (trace.no_texture) break;

        const double length = movement(objective, step.q);
        loop.least = std::min(loop.least, penalised_cost(objective, image, state.p, fitted, priors));
        loop.small = is_short(controls, length, trace.n_iterations) ||
                     is_negligible(controls, step.q, length, system.expected_hessian, loop.damping, variance);
        const bool keeps_weights = loop.small || (weighs_by_means(method) && length < kStill);
        loop.rounds = controls.reweigh && !keeps_weights ? usual_rounds(method) : 0;
        loop.fresh = false;
        loop.tried = true;
        ++trace.n_iterations;
        before = state;
        take_step(method, step.q, state);  // p and the free angles, forward-additive
        if (loop.small && !controls.evaluate_last && loop.damping <= kTrustedDamping) {
            trace.converged = true;  // without the last evaluation
            record(state, fitted, true, trace);
            break;
        }
    }
    return trace;
}

Solution solve_level(const Objective& objective, const EncodedImage& image, const State& start, const Options& options,
                     double blur, bool evaluate_last, LevelRoom& room, const Interrupted& interrupted) {
    const bool expected = objective.method.step == StepKind::expected, reweighs = objective.method.reweighs();
    const int scoring = options.scoring < 0 ? kScoringSteps : options.scoring;
    const int more = objective.method.step == StepKind::scored ? std::min(scoring, options.max_iterations) : 0;
    begin_level(objective, start, room);
    Controls controls{options, 0.0, 0, expected, reweighs, evaluate_last};
    set_early(objective.method, blur, more > 0, controls);
    Trace trace = run_level(objective, image, controls, room, interrupted);
    if (more > 0 && !trace.no_texture) {
        controls = {options, 0.0, 0, true, reweighs && options.scoring >= 0, evaluate_last};
        controls.max_iterations = more;
        controls.damping = 0.0;
        score(objective, image, controls, trace, room, interrupted);
    }
    return collect(objective, std::move(trace), room, options.keeps_samples);
}

}  // namespace liaam
