#include "level.hpp"

#include <cmath>
#include <limits>

#include "derivatives.hpp"
#include "eight.hpp"
#include "normal_equations.hpp"
#include "residual.hpp"
#include "step.hpp"
#include "thresholds.hpp"
#include "weights.hpp"

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

// The next step, or why there is none.
struct Proposal {
    bool found = false;       // else there is no texture
    bool all_observable = true;
    bool negligible = false;  // the step is short compared with its standard deviation
};

// Normal equations at the state: with the expected gradient if the steps use it, unless this is the end.
Proposal linearise_state(const Objective& objective, const Controls& controls, bool fresh, bool ends, Workspace& work) {
    if (controls.expected && !ends) {
        model_gradient(objective, work);
        if (fresh) {
            linearise(objective, work, {.image_in_j = false, .image_in_e = false});
            work.expected_hessian = work.hessian;
        }
        linearise(objective, work, {.image_in_j = true, .image_in_e = false});
    } else {
        linearise(objective, work, {.image_in_j = true, .image_in_e = true});
        work.expected_hessian = work.hessian;
    }
    const bool all = observable_parameters(objective.method, controls.observable, work);
    return {has_texture(work, objective.n_p()), all, false};
}

// The step of q = (p, free angles) with its priors.
void propose_step(const Objective& objective, const EncodedImage& image, const Controls& controls, double damping,
                  Workspace& work, Proposal& proposal) {
    const bool known = objective.method.weighting == Weighting::rows && std::isfinite(work.noise_variance);
    const double variance = known ? work.noise_variance : objective.model.correlated * work.squares / work.weight;
    add_priors(objective, image, controls.shape_prior, variance, work);
    proposal.found = controls.expected ? clamped_newton_step(damping, work) : damped_step(damping, work);
    const double limit = controls.relative_tolerance * controls.relative_tolerance * work.step.size() * variance;
    proposal.negligible = known && squared_length(work) < limit && damping <= kMostNegligibleDamping &&
                          movement(objective, work) < kLongestUnseen;
}

// Records the state, or only its cost anew where it was recorded before.
void record(const Workspace& work, bool is_new, Trace& trace) {
    const double infinity = std::numeric_limits<double>::infinity();
    if (is_new) {
        trace.costs.push_back(0.0);
        trace.path.insert(trace.path.end(), work.state.p.begin(), work.state.p.end());
        trace.angles.push_back(work.state.angles);
    }
    trace.costs.back() = work.weight > 0.0 ? work.squares / work.weight : infinity;
}

// The loop's own variables between iterations.
struct Loop {
    double damping;
    double least = std::numeric_limits<double>::infinity();  // the lowest penalised cost under the current weights
    bool tried = false;  // a step was taken and is not judged yet
    bool small = false;  // it was too short to matter
    bool fresh = true;   // the weights are new, so that the expected curvature is out of date
    int rounds = 0;      // alternations of weights and lambda before the next step
};

// Judges the last step; false if it was refused.
bool accept(const Objective& objective, const EncodedImage& image, const Controls& controls, Workspace& work, Loop& loop,
            Trace& trace) {
    const double cost = penalised_cost(objective, image, work), rise = controls.expected ? kExpectedRise : kRise;
    if (controls.damping > 0.0 && !(cost <= rise * loop.least)) {  // NaN is refused, too
        undo_step(work);
        trace.converged = loop.small || loop.damping >= kDampingLimit;
        loop.damping = raised_damping(loop.damping, controls.expected);
        loop.tried = false;
        loop.rounds = 0;
        return false;
    }
    loop.damping = eased_damping(loop.damping, controls);
    work.last_step = work.step;
    loop.least = std::min(loop.least, cost);
    trace.converged = loop.small && loop.damping <= kTrustedDamping;  // else damping may be what makes the step small
    return true;
}

void reweigh(const Objective& objective, const EncodedImage& image, Workspace& work, Loop& loop) {
    for (; loop.rounds > 0 && update_weights(objective, image, work); --loop.rounds) {
        solve_appearance(objective, work, true, true);
        loop.least = std::numeric_limits<double>::infinity();  // new weights invalidate the lowest cost
        loop.fresh = true;
    }
}

bool is_small(const Objective& objective, const Controls& controls, const Proposal& proposal, int n_iterations,
              const Workspace& work) {
    const double length = movement(objective, work);
    return proposal.negligible || length < controls.tolerance ||
           (n_iterations < controls.early_steps && length < controls.early_limit);
}

// Rows of a level that count as contrast: for weights by rows those of the gradients.
std::size_t rows_shown(const Objective& objective) {
    return objective.method.weighting == Weighting::rows ? 2 : objective.k();
}

std::vector<Contrast> contrast_of(const Objective& objective, const Workspace& work, Floats sqrt_weights) {
    const std::size_t k = objective.k();
    std::vector<Contrast> sums(rows_shown(objective), Contrast{});
    for (std::size_t i = 0; i < work.usable.size(); ++i) {
        const Eight value = load(work.values.data() + kChannels * i);
        for (std::size_t r = 0; r < sums.size(); ++r) {
            const std::size_t e = i * k + r;
            const double weight = static_cast<double>(work.usable[i]) * sqrt_weights[e] * sqrt_weights[e];
            const double sample = sum(load(work.metric.data() + kChannels * r) * value), left = work.residual[e];
            sums[r][0] += weight;
            sums[r][1] += weight * sample;
            sums[r][2] += weight * sample * sample;
            sums[r][3] += weight * left * left;
        }
    }
    return sums;
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
    trace.held = more.held;
}

// Steps with the expected gradient from the solution of a level; none if they raise the cost. The weights are kept,
// unless their number was asked for.
void score(const Objective& objective, const EncodedImage& image, Controls controls, Trace& trace, Workspace& work,
           const Interrupted& interrupted) {
    const Memory before = work;
    const Trace more = run_level(objective, image, controls, work, interrupted);
    if (more.costs.back() <= kScoringRise * trace.costs.back()) {
        append(more, objective.n_p(), trace);
        return;
    }
    static_cast<Memory&>(work) = before;
    controls.max_iterations = 0;
    controls.expected = controls.reweigh = false;
    controls.evaluate_last = true;
    run_level(objective, image, controls, work, interrupted);
}

}  // namespace

Trace run_level(const Objective& objective, const EncodedImage& image, const Controls& controls, Workspace& work,
                const Interrupted& interrupted) {
    const bool averages = objective.method.weighting == Weighting::rows && objective.method.loss == Loss::none;
    const int again = objective.method.loss == Loss::none ? 1 : kRounds;
    Trace trace;
    Loop loop{controls.damping};
    // Twice at first if each pixel's weight depends on its own residual, and so on the weights before.
    loop.rounds = !controls.reweigh ? 0 : averages ? 1 : std::max(again, 2);
    while (true) {
        evaluate_residual(objective, image, work, true);   // eq 10, with lambda = 0
        solve_appearance(objective, work, false, true);    // the best lambda for this state (eq 4)
        if (loop.tried && !accept(objective, image, controls, work, loop, trace)) continue;
        reweigh(objective, image, work, loop);
        record(work, loop.tried || trace.costs.empty(), trace);
        const bool ends = trace.converged || trace.n_iterations >= controls.max_iterations ||
                          !std::isfinite(trace.costs.back()) || interrupted();
        if (ends && !controls.evaluate_last) break;
        Proposal proposal = linearise_state(objective, controls, loop.fresh, ends, work);
        if (proposal.found && !ends) propose_step(objective, image, controls, loop.damping, work, proposal);
        trace.held = !proposal.all_observable;
        trace.flat = !proposal.found;
        if (ends || trace.flat) break;
        loop.least = std::min(loop.least, penalised_cost(objective, image, work));
        loop.small = is_small(objective, controls, proposal, trace.n_iterations, work);
        loop.rounds = controls.reweigh && !loop.small && !(averages && movement(objective, work) < kStill) ? again : 0;
        loop.fresh = false;
        loop.tried = true;
        ++trace.n_iterations;
        take_step(objective.method, work);                 // p and the free angles, forward-additive
        if (loop.small && !controls.evaluate_last && loop.damping <= kTrustedDamping) {
            trace.converged = true;  // without the last evaluation
            record(work, true, trace);
            break;
        }
    }
    return trace;
}

Solution collect(const Objective& objective, Trace trace, const Workspace& work, bool keeps_samples) {
    Solution fit;
    fit.state = work.state;
    fit.trace = std::move(trace);
    fit.noise_variance = work.noise_variance;
    fit.squares = work.squares;
    fit.weight = work.weight;
    fit.prior_scale = work.prior_scale;
    fit.expected_hessian = work.expected_hessian;
    fit.usable = work.usable;
    fit.contrast = contrast_of(objective, work, objective.model.sqrt_weights);
    fit.weighted_contrast = contrast_of(objective, work, work.masked);
    const std::size_t k = objective.k(), shown = rows_shown(objective);
    for (std::size_t e = 0; e < work.masked.size(); ++e) fit.n_counted += e % k < shown && work.masked[e] != 0.0f;
    if (!keeps_samples) return fit;
    fit.residual = work.residual;
    fit.samples.resize(work.residual.size());
    for (std::size_t e = 0; e < fit.samples.size(); ++e)
        fit.samples[e] = sum(load(work.metric.data() + kChannels * (e % k)) * load(work.values.data() + kChannels * (e / k)));
    return fit;
}

Solution solve_level(const Objective& objective, const EncodedImage& image, const State& start, const Options& options,
                     double blur, bool evaluate_last, Workspace& work, const Interrupted& interrupted) {
    const bool expected = objective.method.step == StepKind::expected, reweighs = objective.method.reweighs();
    const int scoring = options.scoring < 0 ? kScoringSteps : options.scoring;
    const int more = objective.method.step == StepKind::scored ? std::min(scoring, options.max_iterations) : 0;
    work.begin(objective, start);
    Controls controls{options, 0.0, 0, expected, reweighs, evaluate_last};
    set_early(objective.method, blur, more > 0, controls);
    Trace trace = run_level(objective, image, controls, work, interrupted);
    if (more > 0 && !trace.flat) {
        controls = {options, 0.0, 0, true, reweighs && options.scoring >= 0, evaluate_last};
        controls.max_iterations = more;
        controls.damping = 0.0;
        score(objective, image, controls, trace, work, interrupted);
    }
    return collect(objective, std::move(trace), work, options.keeps_samples);
}

}  // namespace liaam
