// Bindings of a level: its objective, its encoded image, its solution, and its parts at a state.
#include "bind_level.hpp"

#include <memory>

using namespace liaam;

namespace {

std::unique_ptr<FitRoom>& waiting_room() {
    static thread_local std::unique_ptr<FitRoom> room;
    return room;
}

}  // namespace

RoomOfThread::RoomOfThread() : room_(std::move(waiting_room())) {
    if (!room_) room_ = std::make_unique<FitRoom>();
}

RoomOfThread::~RoomOfThread() { waiting_room() = std::move(room_); }

Options options_of(const nb::dict& given) {
    const nb::object early = given["early_tolerance"], scoring = given["scoring"];
    Options options;
    options.max_iterations = nb::cast<int>(given["max_iterations"]);
    options.tolerance = nb::cast<double>(given["tolerance"]);
    options.early_tolerance = early.is_none() ? -1.0 : nb::cast<double>(early);
    options.relative_tolerance = nb::cast<double>(given["relative_tolerance"]);
    options.damping = nb::cast<double>(given["damping"]);
    options.shape_prior = nb::cast<double>(given["shape_prior"]);
    options.observable = nb::cast<double>(given["observable"]);
    options.best_angle = nb::cast<std::string>(given["angle_start"]) == "best";
    options.scoring = scoring.is_none() ? -1 : nb::cast<int>(scoring);
    return options;
}

namespace {

void check_mesh(const Mesh& mesh, std::size_t n_p) {
    const std::size_t n = mesh.n_pixels(), n_vertices = mesh.n_vertices();
    require(mesh.beta.n_columns == 3 && mesh.triangles.n_columns == 3 && mesh.rest.n_columns == 2, "the mesh is damaged");
    require(mesh.starts.size() == mesh.triangles.n_rows + 1 && mesh.basis.n_rows == 2 * n_vertices &&
                mesh.basis.n_columns >= n_p && mesh.basis.n_columns % 8 == 0,
            "the mesh is damaged");
    for (std::size_t t = 0; t + 1 < mesh.starts.size(); ++t)
        require(mesh.starts[t] <= mesh.starts[t + 1], "the pixels are not sorted by triangle");
    require(mesh.starts.front() == 0 && static_cast<std::size_t>(mesh.starts.back()) == n,
            "the pixels are not sorted by triangle");
    for (std::size_t i = 0; i < mesh.triangles.n_rows * 3; ++i)
        require(mesh.triangles.data[i] >= 0 && static_cast<std::size_t>(mesh.triangles.data[i]) < n_vertices,
                "a triangle names a vertex that does not exist");
}

// Mean and modes at a number of residuals, as constant part or as three parts.
void check_modes(const MeanAndModes& given, std::size_t size, std::size_t m, const char* fault) {
    const bool free = given.mean.n_rows == 3;
    require((free || given.mean.n_rows == 1) && given.mean.n_columns == size && given.modes.width() >= m, fault);
    for (std::size_t i = 0; i < (free ? 3 : 1); ++i)
        require(given.modes.parts[i].n_rows == size && given.modes.parts[i].n_columns == given.modes.width(), fault);
    require(free || !given.modes.turn(), fault);
}

void check_objective(const Objective& objective) {
    const Model& model = objective.model;
    const std::size_t n = objective.n(), k = objective.k(), m = objective.m(), e = n * k;
    check_mesh(model.mesh, objective.n_p());
    require(n > 0 && k > 0 && k <= kChannels && objective.method.metric[0].size() == k * kChannels, "the metric is damaged");
    check_modes(model.appearance, e, m, "modes differ in size");
    check_modes(model.gradients, objective.method.step == StepKind::own ? 0 : 2 * e, m, "gradients of modes differ in size");
    require(model.gradients.mean.n_rows == model.appearance.mean.n_rows, "gradients of modes differ in size");
    require(model.sqrt_weights.size() == e && model.gram.n_rows == m && model.gram.n_columns == m &&
                model.errors.size() == n,
            "weights or errors differ in size");
    require(objective.method.directions.n_rows == 2 && objective.method.n_free() <= 2, "there are at most two angles");
    require(objective.method.weighting != Weighting::rows || k >= 2, "weights by rows need the two rows of gradients");
}

std::unique_ptr<HeldObjective> make_objective(const nb::dict& given) {
    auto held = std::make_unique<HeldObjective>();
    Fields fields(given, held->kept);
    Model& model = held->objective.model;
    Method& method = held->objective.method;
    model.mesh = {fields.matrix<float>("beta"), fields.numbers<std::int64_t>("starts"), fields.matrix<std::int64_t>("triangles"),
                  fields.matrix<double>("rest"), fields.matrix<double>("basis"), fields.value<double>("movement")};
    model.appearance = {fields.matrix<float>("mean"), fields.modes("modes", "mode_scales")};
    model.gradients = {fields.matrix<float>("mean_gradients"), fields.modes("mode_gradients", "mode_gradient_scales")};
    model.sqrt_weights = fields.numbers<float>("sqrt_weights");
    model.gram = fields.matrix<double>("gram");
    model.ridge = fields.numbers<double>("ridge");
    model.errors = fields.numbers<double>("errors");
    model.prior = fields.numbers<double>("prior");
    model.correlated = fields.value<double>("correlated");
    model.dof = fields.value<double>("dof");
    model.colours = fields.value<bool>("colours");
    const MatrixView<const float> metric = fields.matrix<float>("metric");
    require(metric.n_rows == 3, "the metric has a constant, a cos and a sin part");
    method.metric = {metric[0], metric[1], metric[2]};
    method.directions = fields.matrix<double>("directions");
    method.weighting = numbered<Weighting>(fields.value<int>("weighting"), Weighting::rows, "weighting");
    method.loss = numbered<Loss>(fields.value<int>("loss"), kLastLoss, "loss");
    method.gaussian_median = fields.value<double>("gaussian_median");
    method.step = numbered<StepKind>(fields.value<int>("step"), StepKind::expected, "kind of step");
    check_objective(held->objective);
    return held;
}

// An encoded image with the arrays that it views.
struct HeldImage {
    EncodedImage image;
    std::vector<nb::object> kept;
};

Similarity similarity_of(const MatrixView<const double>& rows) {
    require(rows.n_rows == 2 && rows.n_columns == 3, "a similarity is (2, 3)");
    return {rows[0][0], rows[0][1], rows[0][2], rows[1][0], rows[1][1], rows[1][2]};
}

std::unique_ptr<HeldImage> make_image(const nb::dict& given) {
    auto held = std::make_unique<HeldImage>();
    Fields fields(given, held->kept);
    EncodedImage& image = held->image;
    image.pixels = fields.numbers<float>("pixels");
    image.height = fields.value<int>("height");
    image.width = fields.value<int>("width");
    require(image.height >= 2 && image.width >= 2 &&
                image.pixels.size() == kChannels * static_cast<std::size_t>(image.height) * image.width &&
                image.pixels.size() / kChannels < (std::size_t{1} << 31),
            "an encoded image has eight channels, and at least 2 by 2 pixels");
    image.from_model = similarity_of(fields.matrix<double>("from_model"));
    image.log_noise = fields.numbers<float>("log_noise");
    image.first_log = fields.value<double>("first_log");
    image.last_log = fields.value<double>("last_log");
    check_noise(image.log_noise, image.first_log, image.last_log);
    image.value_noise_gain = fields.value<double>("value_noise_gain");
    image.slope_noise_gain = fields.value<double>("slope_noise_gain");
    image.correlated = fields.value<double>("correlated");
    image.constants = encoding_constants();
    image.point_precision = fields.matrix<double>("point_precision");
    image.points = fields.numbers<double>("points");
    require(image.point_precision.n_rows == image.points.size() && image.point_precision.n_columns == image.points.size(),
            "the precision of the points differs in size");
    return held;
}

// An objective at an image: what is known of the warp's parameters is about as many as it has.
void check_together(const HeldObjective& held, const HeldImage& image) {
    const std::size_t n_points = image.image.points.size();
    require(n_points == 0 || n_points == held.objective.n_p(), "the precision of the points differs in size from the model");
}

State state_of(const Objective& objective, const Array<double, 1>& p, std::array<double, 2> angles,
               const Array<double, 1>& lam) {
    require(p.size() == objective.n_p() && lam.size() == objective.m(), "the state differs in size from the model");
    return {numbers_of(p), angles, numbers_of(lam)};
}

nb::object contrasts(const std::vector<Contrast>& all) {
    std::vector<double> numbers;
    for (const Contrast& each : all) numbers.insert(numbers.end(), each.begin(), each.end());
    return owned(std::move(numbers), {all.size(), 4});
}

void bind_level_fit(nb::module_& module) {
    nb::class_<Solution>(module, "Solution")
        .def_prop_ro("p", [](const Solution& fit) { return copied(fit.state.p, {fit.state.p.size()}); })
        .def_prop_ro("angles", [](const Solution& fit) { return fit.state.angles; })
        .def_prop_ro("lam", [](const Solution& fit) { return copied(fit.state.lam, {fit.state.lam.size()}); })
        .def_prop_ro("costs", [](const Solution& fit) { return copied(fit.trace.costs, {fit.trace.costs.size()}); })
        .def_prop_ro("path",
                     [](const Solution& fit) {
                         return copied(fit.trace.path, {fit.trace.costs.size(), fit.state.p.size()});
                     })
        .def_prop_ro("angle_history",
                     [](const Solution& fit) {
                         std::vector<double> angles;
                         for (const auto& each : fit.trace.angles) angles.insert(angles.end(), each.begin(), each.end());
                         return owned(std::move(angles), {fit.trace.angles.size(), 2});
                     })
        .def_prop_ro("n_iterations", [](const Solution& fit) { return fit.trace.n_iterations; })
        .def_prop_ro("converged", [](const Solution& fit) { return fit.trace.converged; })
        .def_prop_ro("angle_fixed", [](const Solution& fit) { return fit.trace.angle_fixed; })
        .def_prop_ro("no_texture", [](const Solution& fit) { return fit.trace.no_texture; })
        .def_ro("noise_variance", &Solution::noise_variance)
        .def_ro("squares", &Solution::squares)
        .def_ro("weight", &Solution::weight)
        .def_ro("prior_scale", &Solution::prior_scale)
        .def_ro("n_counted", &Solution::n_counted)
        .def_prop_ro("expected_hessian", [](const Solution& fit) { return copied(fit.expected_hessian); })
        .def_prop_ro("usable", [](const Solution& fit) { return copied(fit.usable, {fit.usable.size()}); })
        .def_prop_ro("samples", [](const Solution& fit) { return copied(fit.samples, {fit.samples.size()}); })
        .def_prop_ro("residual", [](const Solution& fit) { return copied(fit.residual, {fit.residual.size()}); })
        .def_prop_ro("contrast", [](const Solution& fit) { return contrasts(fit.contrast); })
        .def_prop_ro("weighted_contrast", [](const Solution& fit) { return contrasts(fit.weighted_contrast); });
}

// A level at a state, in the parts that the loop calls, in its order: for tests, residual images and relighting.
class Problem {
  public:
    Problem(const HeldObjective& objective, const HeldImage& image) : objective_(objective.objective), image_(image.image) {
        check_together(objective, image);
    }

    void begin(const Array<double, 1>& p, std::array<double, 2> angles, const Array<double, 1>& lam) {
        begin_level(objective_, state_of(objective_, p, angles, lam), room_);
        reached_ = Reached::begun;
    }
    void set_state(const Array<double, 1>& p, std::array<double, 2> angles, const Array<double, 1>& lam) {
        require(reached_ >= Reached::begun, kNotBegun);
        room_.memory.state = state_of(objective_, p, angles, lam);
        reached_ = Reached::begun;
    }
    void evaluate(bool solves) {
        require(reached_ >= Reached::begun, kNotBegun);
        auto& [state, weights, priors, newton] = room_.memory;
        const Samples& samples = sample(objective_, image_, state, room_.sampling);
        turn_weights(objective_, samples, weights, room_.weighing);
        if (solves) state.lam = fit_appearance(objective_, samples, weights, room_.appearance).lam;
        else given_appearance(objective_, samples, weights, state.lam, room_.appearance);
        reached_ = Reached::evaluated;
    }
    bool reweigh(bool solves) {
        require(reached_ == Reached::evaluated, kNotEvaluated);
        if (!objective_.method.reweighs()) return false;
        auto& [state, weights, priors, newton] = room_.memory;
        const Samples& samples = room_.sampling.samples;
        const Floats residual = room_.appearance.fitted.residual;
        if (!update_weights(objective_, image_, samples, residual, weights, room_.weighing)) return false;
        if (solves) state.lam = refit_appearance(objective_, samples, weights, room_.appearance).lam;
        else given_appearance(objective_, samples, weights, state.lam, room_.appearance);
        return true;
    }
    void differentiate(bool image_in_j, bool image_in_e) {
        require(reached_ == Reached::evaluated, kNotEvaluated);
        require((image_in_j && image_in_e) || objective_.method.step != StepKind::own, "the method expects no gradient");
        const Samples& samples = room_.sampling.samples;
        const FittedAppearance& fitted = room_.appearance.fitted;
        const Floats own = samples.gradients;
        const bool expects = !image_in_j || !image_in_e;
        const Floats expected = expects ? expected_gradient(objective_, samples, fitted.lam, room_.linearisation) : own;
        multiply_derivatives(objective_, samples, fitted, room_.memory.weights, image_in_j ? own : expected,
                             image_in_e ? own : expected, room_.linearisation);
    }
    const LevelRoom& evaluated() const {
        require(reached_ == Reached::evaluated, kNotEvaluated);
        return room_;
    }
    const Objective& objective() const { return objective_; }

  private:
    enum class Reached { nothing, begun, evaluated };
    static constexpr const char* kNotBegun = "the problem has no state yet; call begin first";
    static constexpr const char* kNotEvaluated = "the problem has no residual yet; call evaluate first";

    const Objective& objective_;
    const EncodedImage& image_;
    LevelRoom room_;
    Reached reached_ = Reached::nothing;
};

// The mean and the modes in float32, (1 + m, n k).
std::vector<float> mean_and_modes(const Samples& samples, std::size_t m) {
    const std::size_t size = samples.mean.size();
    std::vector<float> all(samples.mean.begin(), samples.mean.end()), line(samples.modes.width());
    all.resize((1 + m) * size);
    for (std::size_t e = 0; e < size; ++e) {
        modes_at_residual(samples.modes, e, line);
        for (std::size_t j = 0; j < m; ++j) all[(1 + j) * size + e] = line[j];
    }
    return all;
}

nb::dict arrays_of(const Problem& problem) {
    const LevelRoom& room = problem.evaluated();
    const Samples& samples = room.sampling.samples;
    const Weights& weights = room.memory.weights;
    const FittedAppearance& fitted = room.appearance.fitted;
    const LinearisationRoom& linearisation = room.linearisation;
    const Objective& objective = problem.objective();
    const std::size_t n = objective.n(), k = objective.k();
    nb::dict all;
    all["values"] = copied(samples.values, {n, kChannels});
    all["residual"] = copied(fitted.residual, {n * k});
    all["gradients"] = copied(samples.gradients, {n * k, 2});
    all["usable"] = copied(samples.usable, {n});
    all["modes"] = owned(mean_and_modes(samples, objective.m()), {1 + objective.m(), n * k});
    all["metric"] = copied(samples.metric, {k, kChannels});
    all["base_sqrt_weights"] = copied(weights.base_sqrt_weights, {n * k});
    all["sqrt_weights"] = copied(weights.sqrt_weights, {n * k});
    all["weight_slope"] = copied(weights.slope, {weights.slope.size()});
    all["masked"] = copied(fitted.sqrt_weights, {n * k});
    all["variance"] = copied(weights.variance, {weights.variance.size()});
    all["noise_variance"] = weights.noise_variance;
    all["squares"] = fitted.squares;
    all["weight"] = fitted.weight;
    all["lam"] = copied(fitted.lam, {fitted.lam.size()});
    all["gram"] = copied(weights.gram);
    all["factor"] = copied(fitted.factor);
    all["ar"] = copied(fitted.slope, {fitted.slope.size()});
    all["expected"] = copied(linearisation.expected, {linearisation.expected.size() / 2, 2});
    std::vector<float> columns;
    for (const auto& column : linearisation.columns) columns.insert(columns.end(), column.begin(), column.end());
    all["columns"] = owned(std::move(columns), {linearisation.columns.size(), n * k});
    all["aj"] = copied(linearisation.aj);
    all["hessian"] = copied(linearisation.equations.hessian);
    all["gradient"] = copied(linearisation.equations.gradient, {linearisation.equations.gradient.size()});
    return all;
}

void bind_problem(nb::module_& module) {
    nb::class_<Problem>(module, "Problem")
        .def(nb::init<const HeldObjective&, const HeldImage&>(), nb::keep_alive<1, 2>(), nb::keep_alive<1, 3>())
        .def("begin", &Problem::begin, "p"_a, "angles"_a, "lam"_a)
        .def("set_state", &Problem::set_state, "p"_a, "angles"_a, "lam"_a)
        .def("evaluate", &Problem::evaluate, "solves"_a)
        .def("reweigh", &Problem::reweigh, "solves"_a)
        .def("differentiate", &Problem::differentiate, "image_in_j"_a, "image_in_e"_a)
        .def("arrays", arrays_of);
}

Solution solve_one(const HeldObjective& held, const HeldImage& image, const Array<double, 1>& p,
                   std::array<double, 2> angles, const Array<double, 1>& lam, const nb::dict& options, double blur,
                   bool evaluate_last) {
    check_together(held, image);
    const State start = state_of(held.objective, p, angles, lam);
    Options own = options_of(options);
    own.keeps_samples = true;
    Signals signals;
    Solution fit;
    const RoomOfThread room;
    {
        const Unlocked unlocked;
        fit = solve_level(held.objective, image.image, start, own, blur, evaluate_last, (*room).level, std::ref(signals));
    }
    signals.rethrow();
    return fit;
}

}  // namespace

void bind_level(nb::module_& module) {
    nb::class_<HeldObjective>(module, "Objective");
    nb::class_<HeldImage>(module, "EncodedImage");
    module.def("make_objective", make_objective, "fields"_a);
    module.def("make_image", make_image, "fields"_a);
    bind_level_fit(module);
    bind_problem(module);
    module.def("solve_level", solve_one, "objective"_a, "image"_a, "p"_a, "angles"_a, "lam"_a, "options"_a, "blur"_a,
               "evaluate_last"_a);
}
