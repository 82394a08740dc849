// Bindings of a whole fit.
#include "bind_level.hpp"

#include <cmath>
#include <memory>

using namespace liaam;

namespace {

// A model and a method, prepared for many images.
struct PreparedFit {
    std::vector<LevelSpec> levels;
    Encoding encoding = Encoding::soft;
    double theta_1 = 0.0;
    bool has_invariant = false;
    bool keeps_samples = false;
    std::vector<nb::object> kept;
};

// Shapes whose size lies between these, in model pixels, have scales and blurs that are numbers.
constexpr double kSmallest = 1e-3, kLargest = 1e7;

void check_shapes(const Shapes& shapes) {
    const Doubles mean = shapes.mean;
    require(mean.size() >= 6 && mean.size() % 2 == 0, "the mean shape has at least three points (x, y)");
    require(shapes.basis.n_columns == mean.size(), "the mean shape and its modes have different numbers of points");
    double extent = 0.0;
    for (std::size_t i = 0; i < mean.size(); ++i) {
        require(std::abs(mean[i]) < kLargest, "the mean shape is not finite, or too large");
        extent = std::max(extent, std::abs(mean[i] - mean[i % 2]));
    }
    require(extent > kSmallest, "the mean shape is too small");
}

std::unique_ptr<PreparedFit> prepare(const nb::dict& given) {
    auto prepared = std::make_unique<PreparedFit>();
    Fields fields(given, prepared->kept);
    const Doubles mean = fields.numbers<double>("mean");
    prepared->encoding = numbered<Encoding>(fields.value<int>("encoding"), kLastEncoding, "encoding");
    prepared->theta_1 = fields.value<double>("theta_1");
    prepared->has_invariant = fields.value<bool>("has_invariant");
    prepared->keeps_samples = fields.value<bool>("keeps_samples");
    for (nb::handle each : nb::cast<nb::list>(given["levels"])) {
        const auto own = nb::cast<nb::dict>(each);
        Fields level(own, prepared->kept);
        const nb::object objective = own["objective"];
        const auto& held = nb::cast<const HeldObjective&>(objective);
        const Shapes shapes{level.matrix<double>("basis"), mean};
        const double blur = level.value<double>("blur");
        check_shapes(shapes);
        require(held.objective.n_p() == shapes.basis.n_rows, "a level has other shape modes");
        require(blur >= 0.0 && blur < kWidestBlur, "the blur of a level is out of range");
        require(!prepared->has_invariant || held.objective.k() == 1, "the invariant is one row of the metric");
        prepared->levels.push_back({&held.objective, blur, level.value<double>("density"), shapes});
        prepared->kept.push_back(objective);
    }
    require(!prepared->levels.empty(), "there are no levels");
    for (const LevelSpec& level : prepared->levels)
        require(level.objective->n_p() <= prepared->levels.back().objective->n_p(),
                "a level has more shape modes than the last");
    return prepared;
}

Target target_of(const PreparedFit& prepared, const nb::dict& given, std::vector<nb::object>& kept) {
    Fields fields(given, kept);
    Target target;
    const Doubles start = fields.numbers<double>("start"), points = fields.numbers<double>("points");
    target.start.assign(start.begin(), start.end());
    target.points.assign(points.begin(), points.end());
    target.margin = fields.value<double>("margin");
    target.theta_1 = prepared.theta_1;
    target.theta_2 = fields.value<double>("theta_2");
    target.has_invariant = prepared.has_invariant;
    target.log_noise = fields.numbers<float>("log_noise");
    target.first_log = fields.value<double>("first_log");
    target.last_log = fields.value<double>("last_log");
    target.point_precision = fields.matrix<double>("point_precision");
    const Shapes& shapes = prepared.levels.back().shapes;
    require(start.size() == shapes.mean.size(), "the start has another number of landmarks");
    require(target.margin >= 0.0 && target.margin < kLargest, "the margin is out of range");
    require(std::all_of(start.begin(), start.end(), [](double each) { return std::abs(each) < kLargest; }),
            "the start is not finite, or far away");
    const MatrixView<const double>& precision = target.point_precision;
    require(points.empty() || (points.size() == start.size() && precision.n_rows >= shapes.basis.n_rows &&
                               precision.n_columns == precision.n_rows),
            "the mapped points differ in size");
    check_noise(target.log_noise, target.first_log, target.last_log);
    return target;
}

constexpr std::ptrdiff_t kMostPixels = std::ptrdiff_t{1} << 31;  // their places are counted in 32 bits

std::vector<FittedLevel> run_fit(const PreparedFit& prepared, const Picture& picture, const nb::dict& given,
                                 const nb::dict& options) {
    std::vector<nb::object> kept;
    const Target target = target_of(prepared, given, kept);
    Options own = options_of(options);
    own.keeps_samples = prepared.keeps_samples;
    require(picture.height >= 8 && picture.width >= 8, "the image is smaller than 8 by 8 pixels");
    require(picture.height < kMostPixels / picture.width, "the image has 2^31 pixels or more; crop it to the object");
    Signals signals;
    std::vector<FittedLevel> results;
    const RoomOfThread room;
    {
        const Unlocked unlocked;
        results = fit_levels(prepared.levels, picture, target, own, encoding_constants(), *room, std::ref(signals));
    }
    signals.rethrow();
    return results;
}

template <class T>
std::vector<FittedLevel> fit_stored(const PreparedFit& prepared, const Image<T>& image, const Array<float, 3>& table,
                                    bool grey, float floor, const nb::dict& target, const nb::dict& options) {
    check_table<T>(table);
    const Stored<T> view = stored(image);
    Picture picture;
    picture.height = view.height;
    picture.width = view.width;
    if constexpr (sizeof(T) == 1) picture.bytes = &view;
    else picture.words = &view;
    picture.table = {{data_of(table), table.size()}};
    picture.grey = grey;
    picture.encoding = prepared.encoding;
    picture.floor = floor;
    return run_fit(prepared, picture, target, options);
}

std::vector<FittedLevel> fit_light(const PreparedFit& prepared, const Array<float, 3>& light,
                                   const std::optional<Array<float, 2>>& finite, bool grey, float floor,
                                   const nb::dict& target, const nb::dict& options) {
    require(light.shape(2) == 4, "light has four channels");
    require(!finite || (finite->shape(0) == light.shape(0) && finite->shape(1) == light.shape(1)),
            "there is a finite share for each pixel");
    Picture picture;
    picture.height = light.shape(0);
    picture.width = light.shape(1);
    picture.light = data_of(light);
    picture.finite = finite ? data_of(*finite) : nullptr;
    picture.grey = grey;
    picture.encoding = prepared.encoding;
    picture.floor = floor;
    return run_fit(prepared, picture, target, options);
}

}  // namespace

void bind_fit(nb::module_& module) {
    const auto rows = [](const Similarity& s) {
        return owned(std::vector<double>{s.xx, s.xy, s.x0, s.yx, s.yy, s.y0}, {2, 3});
    };
    nb::class_<FittedLevel>(module, "FittedLevel")
        .def_ro("fit", &FittedLevel::fit)
        .def_prop_ro("pose", [rows](const FittedLevel& result) { return rows(result.pose); })
        .def_prop_ro("to_patch", [rows](const FittedLevel& result) { return rows(result.to_patch); })
        .def_prop_ro("patch_size",
                     [](const FittedLevel& result) { return std::make_pair(result.patch_height, result.patch_width); });
    nb::class_<PreparedFit>(module, "PreparedFit")
        .def("fit", fit_stored<std::uint8_t>, "image"_a.noconvert(), "table"_a, "grey"_a, "floor"_a, "target"_a, "options"_a)
        .def("fit", fit_stored<std::uint16_t>, "image"_a.noconvert(), "table"_a, "grey"_a, "floor"_a, "target"_a, "options"_a)
        .def("fit_light", fit_light, "light"_a, "finite"_a.none(), "grey"_a, "floor"_a, "target"_a, "options"_a);
    module.def("prepare", prepare, "fields"_a);
}
