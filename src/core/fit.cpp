#include "fit.hpp"

#include <cmath>
#include <complex>
#include <limits>
#include <numbers>

#include "angles.hpp"
#include "thresholds.hpp"

namespace liaam {

namespace {

constexpr double kNear = 0.1;           // margin of levels that start from a coarser solution
constexpr double kFineness = 0.5;       // size of a patch's pixels for `soft`, in standard deviations of a wide blur
constexpr double kSizeTolerance = 0.1;  // on the size of blocks that levels share; the blur that follows compensates
constexpr double kRoundingOfCount = 1e-9;  // added to a number of blocks, so that rounding takes none of a whole number
constexpr double kLeastBlur = 0.3;      // blur in pixels up to which it leaves white noise as it is

struct Corner {
    std::ptrdiff_t x, y;
};

struct Region {
    Corner low, high;  // the second excluded
};

struct Box {
    double left, top, right, bottom;

    explicit Box(Doubles shape) : left(shape[0]), top(shape[1]), right(shape[0]), bottom(shape[1]) {
        for (std::size_t i = 0; i < shape.size(); i += 2) {
            left = std::min(left, shape[i]);
            right = std::max(right, shape[i]);
            top = std::min(top, shape[i + 1]);
            bottom = std::max(bottom, shape[i + 1]);
        }
    }
    double diagonal() const { return std::hypot(right - left, bottom - top); }
};

// A shape's surroundings within an image, at least two pixels along each axis. They extend beyond the shape's box by
// `margin`, a fraction of its diagonal, and by twice `size`, image pixels.
Region around(const Picture& picture, Doubles shape, double margin, double size) {
    const Box box(shape);
    const double pad = margin * box.diagonal() + 2.0 * size;
    const auto first = [pad](double low, std::ptrdiff_t n_pixels) {
        return std::min(std::max(std::floor(low - pad), 0.0), n_pixels - 2.0);
    };
    const auto end = [pad](double high, double first_pixel, std::ptrdiff_t n_pixels) {
        return std::min(std::max(std::ceil(high + pad) + 1.0, first_pixel + 2.0), static_cast<double>(n_pixels));
    };
    const double left = first(box.left, picture.width), top = first(box.top, picture.height);
    const double right = end(box.right, left, picture.width), bottom = end(box.bottom, top, picture.height);
    return {{static_cast<std::ptrdiff_t>(left), static_cast<std::ptrdiff_t>(top)},
            {static_cast<std::ptrdiff_t>(right), static_cast<std::ptrdiff_t>(bottom)}};
}

// Side of the block of image pixels that is averaged into one pixel of the patch, at least 1; `scale` is the size of a
// model pixel in image pixels, and the blur is in model pixels.
double block_size(Encoding encoding, double scale, double blur) {
    if (encoding != Encoding::soft) return std::max(1.0, std::floor(scale));  // never coarser than the model's
    // As large as the blur, but at most one model pixel, unless the blur is above two of these.
    const double model_pixels = std::max(kFineness * blur, std::min(blur, 1.0));
    return std::max(1.0, scale * model_pixels);
}

// At least three blocks between two corners.
double limited(double size, const Region& region) {
    const auto side = std::min(region.high.x - region.low.x, region.high.y - region.low.y);
    const auto third = side / 3;  // whole pixels
    return std::max(1.0, std::min(size, static_cast<double>(third)));
}

// Index of the first block of a region that begins at pixel `low`: the block that contains this pixel if blocks are of
// whole pixels, else the first one that begins at or after it. Blocks are counted from the border of the image, not of
// the region, so that they do not depend on the margin, and training and fitting use the same ones.
std::ptrdiff_t first_block(std::ptrdiff_t low, double size) {
    const double at = low / size;
    const bool has_whole_pixels = size == std::floor(size);
    return static_cast<std::ptrdiff_t>(has_whole_pixels ? std::floor(at) : std::ceil(at));
}

// Averages the light of a picture between two corners over blocks, whose grid is relative to the first corner.
void average(const Picture& picture, const Corner& begin, const Corner& end, const BlockGrid& blocks, Means& means) {
    const auto width = end.x - begin.x, height = end.y - begin.y;
    if (picture.bytes) return stored_means(picture.bytes->crop(begin.x, begin.y, width, height), picture.table, blocks, means.light);
    if (picture.words) return stored_means(picture.words->crop(begin.x, begin.y, width, height), picture.table, blocks, means.light);
    // Light: the whole image, so that rows stay contiguous; only the rows in question are read.
    const BlockGrid within{blocks.x + begin.x, blocks.y, blocks.size, blocks.rows, blocks.columns};
    value_means(picture.light + 4 * picture.width * begin.y, height, picture.width, 4, within, means.light);
    if (picture.finite)
        value_means(picture.finite + picture.width * begin.y, height, picture.width, 1, within, means.finite);
}

// Averages a region over blocks of a size, as many as lie in it.
void block_means(const Picture& picture, const Region& region, double size, BlockMeans& out) {
    const Corner first{first_block(region.low.x, size), first_block(region.low.y, size)};
    const Corner begin{static_cast<std::ptrdiff_t>(std::floor(first.x * size)),
                       static_cast<std::ptrdiff_t>(std::floor(first.y * size))};
    BlockGrid blocks{first.x * size - begin.x, first.y * size - begin.y, size, 0, 0};
    blocks.columns = static_cast<std::ptrdiff_t>((region.high.x - begin.x - blocks.x) / size + kRoundingOfCount);
    blocks.rows = static_cast<std::ptrdiff_t>((region.high.y - begin.y - blocks.y) / size + kRoundingOfCount);
    out.means.rows = blocks.rows;
    out.means.columns = blocks.columns;
    out.means.grey = picture.grey;
    out.means.finite.clear();
    out.first_x = first.x;
    out.first_y = first.y;
    out.size = size;
    average(picture, begin, region.high, blocks, out.means);
}

// Joins n by n fine blocks to blocks of about the given size; false if that is not possible or leaves too few.
bool join_blocks(const BlockMeans& fine, const Region& region, double size, BlockMeans& out) {
    const double times = std::max(1.0, std::nearbyint(size / fine.size)), joined = times * fine.size;
    if (std::abs(joined / size - 1.0) > kSizeTolerance) return false;
    const auto n = static_cast<std::ptrdiff_t>(times);
    const Corner first{first_block(region.low.x, joined), first_block(region.low.y, joined)};
    const Corner start{first.x * n - fine.first_x, first.y * n - fine.first_y};  // in fine blocks
    const auto columns = static_cast<std::ptrdiff_t>(region.high.x / joined + kRoundingOfCount) - first.x;
    const auto rows = static_cast<std::ptrdiff_t>(region.high.y / joined + kRoundingOfCount) - first.y;
    const bool begins_inside = start.x >= 0 && start.y >= 0;
    const bool ends_inside = start.x + n * columns <= fine.means.columns && start.y + n * rows <= fine.means.rows;
    const bool can_be_sampled = std::min(columns, rows) >= 2;  // bilinearly
    if (!begins_inside || !ends_inside || !can_be_sampled) return false;
    coarser_means(fine.means, {static_cast<double>(start.x), static_cast<double>(start.y), times, rows, columns}, out.means);
    out.first_x = first.x;
    out.first_y = first.y;
    out.size = joined;
    return true;
}

// Pixels per independent value after a Gaussian blur (pixels), which divides the variance of white noise by this number.
double correlated_pixels(double blur) { return std::max(1.0, 4.0 * std::numbers::pi * blur * blur); }

// Standard deviation of central differences (n(x + 1) - n(x - 1)) / 2 of unit white noise after a Gaussian blur
// (pixels). Their variance is (R(0) - R(2)) / 2, where R(d) = exp(-d^2 / 4 blur^2) / (4 pi blur^2) is the covariance of
// blurred values d pixels apart; without a blur, R(0) = 1 and R(2) = 0.
double slope_noise_gain(double blur) {
    if (!(blur > kLeastBlur)) return std::sqrt(0.5);
    return std::sqrt((1.0 - std::exp(-1.0 / (blur * blur))) / (8.0 * std::numbers::pi * blur * blur));
}

Similarity compose(const Similarity& outer, const Similarity& inner) {
    return {outer.xx * inner.xx + outer.xy * inner.yx, outer.xx * inner.xy + outer.xy * inner.yy,
            outer.x_of(inner.x0, inner.y0),
            outer.yx * inner.xx + outer.yy * inner.yx, outer.yx * inner.xy + outer.yy * inner.yy,
            outer.y_of(inner.x0, inner.y0)};
}

std::vector<double> map(const Similarity& similarity, Doubles shape) {
    std::vector<double> mapped(shape.size());
    for (std::size_t i = 0; i < shape.size(); i += 2) {
        mapped[i] = similarity.x_of(shape[i], shape[i + 1]);
        mapped[i + 1] = similarity.y_of(shape[i], shape[i + 1]);
    }
    return mapped;
}

// Whether a shape is finite and its size not too far from that of the start.
bool is_sane(Doubles shape, Doubles start) {
    if (!std::all_of(shape.begin(), shape.end(), [](double each) { return std::isfinite(each); })) return false;
    const double growth = Box(shape).diagonal() / Box(start).diagonal();
    return thresholds::kLeastGrowth < growth && growth < thresholds::kMostGrowth;
}

// The precision of the n parameters of a level, from that of all: those of the first modes and of the similarity, which
// are the last four.
MatrixView<const double> precision_of(MatrixView<const double> all, std::size_t n, Matrix& room) {
    const std::size_t n_left_out = all.n_rows - n;
    const auto among_all = [&](std::size_t i) { return i + 4 < n ? i : i + n_left_out; };
    room.resize(n, n);
    for (std::size_t i = 0; i < n; ++i)
        for (std::size_t j = 0; j < n; ++j) room[i][j] = all[among_all(i)][among_all(j)];
    return room.view();
}

// One fit, level by level.
class Fit {
  public:
    Fit(const std::vector<LevelSpec>& levels, const Picture& picture, const Target& target,
        const EncodingConstants& constants, FitRoom& room)
        : levels_(levels), picture_(picture), target_(target), constants_(constants), room_(room) {
        average_around_start();
    }

    // Encodes the surroundings of a shape for a level, and returns the state that the level starts from, with both
    // angles at that of the training camera. Sets all of the result but the solution.
    State prepare(const LevelSpec& level, const std::vector<double>& shape, double margin, FittedLevel& result) {
        result.pose = align(level.shapes.mean, shape);
        encode_around(level, shape, margin, result);
        const Similarity to_model = inverse(result.pose);
        if (!target_.points.empty()) {
            room_.points = level.shapes.parameters(map(to_model, target_.points));
            image_.point_precision = precision_of(target_.point_precision, level.shapes.basis.n_rows, room_.point_precision);
            image_.points = room_.points;
        }
        State start;
        start.p = level.shapes.parameters(map(to_model, shape));
        start.angles = {target_.theta_1, target_.theta_1};
        start.lam.assign(level.objective->m(), 0.0);
        return start;
    }

    const EncodedImage& image() const { return image_; }

  private:
    // The image averaged once for all levels, as fine as the sharpest needs.
    void average_around_start() {
        const double scale = scale_of(align(levels_.front().shapes.mean, target_.start));
        double finest = std::numeric_limits<double>::infinity(), coarsest = 0.0;
        for (const LevelSpec& level : levels_) {
            const double size = block_size(picture_.encoding, scale, level.blur);
            finest = std::min(finest, size);
            coarsest = std::max(coarsest, size);
        }
        // The coarsest patch extends by two of its pixels, and begins with a whole one.
        const Region region = around(picture_, target_.start, target_.margin, 2.0 * coarsest);
        block_means(picture_, region, limited(finest, region), room_.around_start);
    }

    // Encodes the surroundings of a shape at the resolution of a level.
    void encode_around(const LevelSpec& level, const std::vector<double>& shape, double margin, FittedLevel& result) {
        const double scale = scale_of(result.pose);
        double size = block_size(picture_.encoding, scale, level.blur);
        const Region region = around(picture_, shape, margin, size);
        size = limited(size, region);
        BlockMeans& blocks = room_.around_shape;
        if (!join_blocks(room_.around_start, region, size, blocks)) block_means(picture_, region, size, blocks);
        const double pixel = blocks.size / scale;  // of the patch, in model pixels
        double blur = level.blur;
        if (picture_.encoding == Encoding::soft) {
            // The part of the blur that is left to do: averaging over pixels blurs by 1/12 of their squared size, and
            // interpolation between them by 2/12.
            blur = std::sqrt(std::max(level.blur * level.blur - pixel * pixel / 4.0, 0.0));
        }
        EncodingOptions options;
        options.encoding = picture_.encoding;
        options.floor = picture_.floor;
        options.blur = std::min(blur / pixel, kWidestBlur);
        options.pixel = pixel;
        options.turn = {static_cast<float>(result.pose.xx / scale), static_cast<float>(result.pose.yx / scale),
                        static_cast<float>(result.pose.xy / scale), static_cast<float>(result.pose.yy / scale)};
        encode(blocks.means, options, constants_, room_.channels);
        // The centre of the first block, which is pixel 0 of the patch, is at first * size + (size - 1) / 2.
        const double reduction = 1.0 / blocks.size, half = 0.5 * (blocks.size - 1.0) / blocks.size;
        result.to_patch = {reduction, 0.0, -blocks.first_x - half, 0.0, reduction, -blocks.first_y - half};
        result.patch_height = room_.channels.height;
        result.patch_width = room_.channels.width;
        set_image(level, result, blocks.size);
    }

    // Describes the encoded patch, whose pixels are averages over blocks of a size in image pixels.
    void set_image(const LevelSpec& level, const FittedLevel& result, double size) {
        image_ = EncodedImage{};
        image_.pixels = room_.channels.pixels;
        image_.height = static_cast<int>(room_.channels.height);
        image_.width = static_cast<int>(room_.channels.width);
        image_.constants = constants_;
        image_.from_model = compose(result.to_patch, result.pose);
        const double scale = scale_of(image_.from_model), blur = scale * level.blur;
        room_.noise.assign(target_.log_noise.begin(), target_.log_noise.end());
        for (float& each : room_.noise) each /= static_cast<float>(size);  // averages of size * size pixels have less
        image_.log_noise = room_.noise;
        image_.first_log = target_.first_log;
        image_.last_log = target_.last_log;
        image_.value_noise_gain = 1.0 / std::sqrt(correlated_pixels(blur));
        image_.slope_noise_gain = scale * slope_noise_gain(blur);
        // In an image smaller than the model's frame, one image pixel covers several model pixels.
        const double pixels_per_dof = std::max(correlated_pixels(level.blur), 1.0 / (scale * scale));
        image_.correlated = std::max(1.0, level.density * pixels_per_dof);
    }

    const std::vector<LevelSpec>& levels_;
    const Picture& picture_;
    const Target& target_;
    const EncodingConstants& constants_;
    FitRoom& room_;
    EncodedImage image_;
};

// Looser options for a coarse level, whose solution only starts the next.
Options coarse(Options options) {
    options.tolerance *= thresholds::kCoarse;
    options.relative_tolerance *= thresholds::kCoarseRelative;
    if (options.scoring >= 0) options.scoring = 0;
    return options;
}

// The angles that the first level starts from: theta_2 is given where the method estimates no angle, and at its optimum
// for the start where it estimates this alone.
std::array<double, 2> first_angles(const Objective& objective, const Target& target, const Options& options,
                                   const EncodedImage& image, const State& state, SamplingRoom& room) {
    const Method& method = objective.method;
    if (!method.n_free()) return {target.theta_1, target.theta_2};
    const bool image_only = method.n_free() == 1 && method.directions[0][0] == 0.0;
    if (!image_only || !target.has_invariant || !options.best_angle) return state.angles;
    return {state.angles[0], best_image_angle(objective, image, state, room)};
}

}  // namespace

std::vector<double> Shapes::shape(Doubles p) const {
    std::vector<double> sum(mean.begin(), mean.end());
    for (std::size_t i = 0; i < p.size(); ++i)
        for (std::size_t c = 0; c < sum.size(); ++c) sum[c] += p[i] * basis[i][c];
    return sum;
}

std::vector<double> Shapes::parameters(const std::vector<double>& shape) const {
    std::vector<double> p(basis.n_rows, 0.0);
    for (std::size_t i = 0; i < p.size(); ++i)
        for (std::size_t c = 0; c < shape.size(); ++c) p[i] += basis[i][c] * (shape[c] - mean[c]);
    return p;
}

Similarity align(Doubles shape, Doubles target) {
    // A similarity without reflection is a complex factor: b = factor * a.
    using Complex = std::complex<double>;
    const std::size_t n = shape.size() / 2;
    Complex mean_a, mean_b, product;
    for (std::size_t i = 0; i < n; ++i) {
        mean_a += Complex(shape[2 * i], shape[2 * i + 1]) / static_cast<double>(n);
        mean_b += Complex(target[2 * i], target[2 * i + 1]) / static_cast<double>(n);
    }
    double power = 0.0;
    for (std::size_t i = 0; i < n; ++i) {
        const Complex a = Complex(shape[2 * i], shape[2 * i + 1]) - mean_a;
        product += std::conj(a) * (Complex(target[2 * i], target[2 * i + 1]) - mean_b);
        power += std::norm(a);
    }
    const Complex factor = power > 0.0 ? product / power : Complex(1.0, 0.0), offset = mean_b - factor * mean_a;
    return {factor.real(), -factor.imag(), offset.real(), factor.imag(), factor.real(), offset.imag()};
}

double scale_of(const Similarity& s) { return std::sqrt(std::abs(s.xx * s.yy - s.xy * s.yx)); }

Similarity inverse(const Similarity& s) {
    const double determinant = s.xx * s.yy - s.xy * s.yx;
    Similarity back{s.yy / determinant, -s.xy / determinant, 0.0, -s.yx / determinant, s.xx / determinant, 0.0};
    back.x0 = -(back.xx * s.x0 + back.xy * s.y0);
    back.y0 = -(back.yx * s.x0 + back.yy * s.y0);
    return back;
}

std::vector<FittedLevel> fit_levels(const std::vector<LevelSpec>& levels, const Picture& picture,
                                    const Target& target, const Options& options, const EncodingConstants& constants,
                                    FitRoom& room, const Interrupted& interrupted) {
    Fit fit(levels, picture, target, constants, room);
    std::vector<FittedLevel> results;
    std::vector<double> shape = target.start;
    double margin = target.margin;
    for (const LevelSpec& level : levels) {
        const bool last = &level == &levels.back();
        const Options level_options = last ? options : coarse(options);
        FittedLevel result;
        State start = fit.prepare(level, shape, margin, result);
        if (results.empty())
            start.angles = first_angles(*level.objective, target, level_options, fit.image(), start, room.level.sampling);
        else
            start.angles = results.back().fit.state.angles;
        result.fit = solve_level(*level.objective, fit.image(), start, level_options, level.blur, last, room.level,
                                 interrupted);
        const auto before = map(result.pose, level.shapes.shape(start.p));
        const auto after = map(result.pose, level.shapes.shape(result.fit.state.p));
        // The part of the shape that the level's modes cannot show stays as it is.
        for (std::size_t i = 0; i < shape.size(); ++i) shape[i] += after[i] - before[i];
        results.push_back(std::move(result));
        if (!is_sane(shape, target.start)) break;
        margin = kNear;
    }
    return results;
}

}  // namespace liaam
