#include "objective.hpp"

#include <limits>

#include "thresholds.hpp"

namespace liaam {

void Workspace::begin(const Objective& objective, const State& start) {
    const Model& model = objective.model;
    const Method& method = objective.method;
    const std::size_t n = objective.n(), k = objective.k(), m = objective.m(), n_q = objective.n_q();
    const double nan = std::numeric_limits<double>::quiet_NaN();
    const bool by_noise = method.weighting == Weighting::noise, expects = method.step != StepKind::own;
    state = before = start;
    rows = model.rows;
    slopes = model.slopes;
    lines = model.lines;
    for (auto* each : {&metric, &metric_slope}) each->resize(k * kChannels);
    places.corner.resize(n);
    for (auto* each : {&places.across, &places.down, &places.inside, &usable, &known, &known_before}) each->resize(n);
    values.resize(kChannels * n);
    for (auto* each : {&residual, &masked}) each->resize(n * k);
    for (auto* each : {&gradients}) each->resize(2 * n * k);
    for (auto* each : {&expected, &appearance_slopes}) each->resize(expects ? 2 * n * k : 0);
    base_sqrt_weights.assign(model.sqrt_weights.begin(), model.sqrt_weights.end());
    sqrt_weights = base_sqrt_weights;
    weight_slope.resize(by_noise && method.n_free() ? n * k : 0);
    channel_noise.assign(by_noise ? kChannels * n : 0, 0.0f);
    model_variance.assign(by_noise ? n : 0, 1.0);
    variance.resize(method.weighting != Weighting::model ? n * k : 0);
    std::fill(known_before.begin(), known_before.end(), std::numeric_limits<float>::quiet_NaN());
    unexplained = unexplained_before = {nan, nan};
    noise_variance = by_noise ? 1.0 : nan;
    gram.resize(m, m);
    std::copy(model.gram.data, model.gram.data + m * m, gram.numbers().begin());
    for (auto* each : {&ar, &lam_step}) each->assign(m, 0.0);
    columns.resize(method.n_free());
    for (auto& column : columns) column.resize(n * k);
    for (auto* each : {&hessian, &expected_hessian, &damping_matrix}) {
        each->resize(n_q, n_q);
        each->fill(0.0);
    }
    aj.resize(m, n_q);
    for (auto* each : {&gradient, &step, &last_step}) each->assign(n_q, 0.0);
    prior_precision.assign(objective.n_p(), 0.0);
    observable.assign(n_q, 1);
    prior_scale = 1.0;
    least_curvature = thresholds::kLeastCurvature;
    point_variance = 0.0;
}

}  // namespace liaam
