// Bindings of single functions, which tests compare with liaam.fitting.reference.problem.
#include <cmath>

#include "angles.hpp"
#include "binding.hpp"
#include "linear.hpp"
#include "modes.hpp"
#include "step.hpp"
#include "weights.hpp"

using namespace liaam;

namespace {

NormalEquations equations_of(const Array<double, 2>& base, const Array<double, 2>& hessian,
                             const Array<double, 1>& gradient, const std::vector<bool>& observable) {
    const std::size_t n = gradient.size();
    require(hessian.shape(0) == n && hessian.shape(1) == n && observable.size() == n, "the system differs in size");
    require(base.shape(0) == n && base.shape(1) == n, "the system differs in size");
    return {matrix_of(hessian), matrix_of(base), numbers_of(gradient)};
}

std::vector<char> chars_of(const std::vector<bool>& given) { return {given.begin(), given.end()}; }

auto damped(const Array<double, 2>& hessian, const Array<double, 1>& gradient, const std::vector<bool>& observable,
            double damping) {
    StepRoom room;
    const auto equations = equations_of(hessian, hessian, gradient, observable);
    const Step& step = damped_step(equations, chars_of(observable), damping, room);
    return std::make_pair(step.found, copied(step.q, {step.q.size()}));
}

auto clamped(const Array<double, 2>& base, const Array<double, 2>& hessian, const Array<double, 1>& gradient,
             const std::vector<bool>& observable, double damping, double least) {
    StepRoom room;
    const auto equations = equations_of(base, hessian, gradient, observable);
    NewtonMemory memory{least, std::vector<double>(gradient.size(), 0.0)};
    const Step& step = clamped_newton_step(equations, chars_of(observable), damping, memory, room);
    return std::make_pair(step.found, copied(step.q, {step.q.size()}));
}

double next_scale(const Array<double, 2>& hessian, const Array<double, 1>& p, const Array<double, 1>& prior, double dof,
                  double scale, double strength, double variance) {
    require(hessian.shape(0) >= p.size() && hessian.shape(0) == hessian.shape(1) && prior.size() == p.size(),
            "the system differs in size");
    StepRoom room;
    Model model;
    model.prior = span_of(prior);
    model.dof = dof;
    return next_prior_scale(model, matrix_of(hessian), numbers_of(p), scale, strength, variance, room);
}

auto observable_of(const Array<double, 2>& hessian, const Array<double, 2>& directions, double squares, double weight,
                   double observable) {
    require(directions.shape(0) == 2 && hessian.shape(0) == hessian.shape(1) && hessian.shape(0) >= directions.shape(1),
            "the system differs in size");
    require(directions.shape(1) <= 2, "there are at most two angles");
    Samples samples;
    samples.metric.assign(8, 1.0f);  // |L'|^2 / |L|^2 = 1
    samples.metric_slope.assign(8, 1.0f);
    FittedAppearance fitted;
    fitted.squares = squares;
    fitted.weight = weight;
    Method method;
    method.directions = view_of(directions);
    StepRoom room;
    const auto& moves = observable_parameters(method, samples, fitted, matrix_of(hessian), observable, room);
    return std::vector<bool>(moves.begin(), moves.end());
}

auto factor_of(const Array<double, 2>& matrix) {
    Matrix factor = matrix_of(matrix);
    require(factor.rows() == factor.columns(), "the matrix is not square");
    const bool found = cholesky(factor);
    return std::make_pair(found, copied(factor));
}

auto solve_clamped_of(const Array<double, 2>& matrix, double least, const Array<double, 1>& right) {
    Matrix own = matrix_of(matrix);
    require(own.rows() == right.size() && own.columns() == right.size(), "the system differs in size");
    Spectrum spectrum;
    std::vector<double> solution = numbers_of(right);
    const bool found = solve_clamped(own, least, spectrum, solution);
    return std::make_pair(found, owned(std::move(solution), {right.size()}));
}

auto gram_of(const Array<std::int16_t, 2>& codes, const Array<float, 1>& scales, std::size_t m,
             const Array<float, 1>& sqrt_weights) {
    require(codes.shape(0) == sqrt_weights.size() && codes.shape(1) == scales.size() && m <= scales.size() &&
                scales.size() % kEight == 0,
            "modes and weights differ in size");
    std::vector<float> block;
    Matrix gram(m, m);
    weighted_gram({{view_of(codes)}, span_of(scales)}, span_of(sqrt_weights), block, gram);
    return copied(gram);
}

double weight_of(int loss, double u) { return loss_weight(numbered<Loss>(loss, kLastLoss, "loss"), u); }

double median_of(std::vector<double> numbers) {
    // A comparison with NaN is no order, on which the search for the median relies.
    require(std::all_of(numbers.begin(), numbers.end(), [](double each) { return std::isfinite(each); }),
            "the median is that of finite numbers");
    return median(numbers);
}

}  // namespace

void bind_parts(nb::module_& module) {
    module.def("damped_step", damped, "hessian"_a, "gradient"_a, "observable"_a, "damping"_a);
    module.def("clamped_newton_step", clamped, "base"_a, "hessian"_a, "gradient"_a, "observable"_a, "damping"_a, "least"_a);
    module.def("next_prior_scale", next_scale, "hessian"_a, "p"_a, "prior"_a, "dof"_a, "scale"_a, "strength"_a,
               "variance"_a);
    module.def("observable_parameters", observable_of, "hessian"_a, "directions"_a, "squares"_a, "weight"_a,
               "observable"_a);
    module.def("cholesky", factor_of, "matrix"_a);
    module.def("solve_clamped", solve_clamped_of, "matrix"_a, "least"_a, "right"_a);
    module.def("weighted_gram", gram_of, "codes"_a, "scales"_a, "m"_a, "sqrt_weights"_a);
    module.def("loss_weight", weight_of, "loss"_a, "u"_a);
    module.def("median", median_of, "numbers"_a);
    module.def("minimise_on_arc", minimise_on_arc, "s"_a, "b"_a, "centre"_a, "reach"_a);
}
