// Random small fits of the core, for sanitizers: meshes, methods, images and numbers of any kind. Each case runs whole
// fits and checks that what comes back has the right size, and is finite where it must be. The digest of all results that
// it prints says whether a change of the core left every bit as it was, with the same compiler.
//
//     driver CASES [SEED]

#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <limits>
#include <random>

#include "encoding.hpp"
#include "fit.hpp"
#include "painting.hpp"
#include "search.hpp"
#include "splines.hpp"

using namespace liaam;

namespace {

using Rng = std::mt19937_64;

constexpr EncodingConstants kConstants{.all = 0.999f, .unusable = 1e-3f, .log_floor = 0.004f, .softness = 0.1f, .flat = 1e-4f,
                                       .brightness = {1.0f / 3, 1.0f / 3, 1.0f / 3}, .luminance = {0.2126f, 0.7152f, 0.0722f}};

void check(bool holds, const char* what) {
    if (holds) return;
    std::fprintf(stderr, "%s\n", what);
    std::abort();
}

int integer(Rng& rng, int low, int high) { return std::uniform_int_distribution<int>(low, high)(rng); }
double uniform(Rng& rng, double low, double high) { return std::uniform_real_distribution<double>(low, high)(rng); }
double normal(Rng& rng) { return std::normal_distribution<double>()(rng); }

template <class T>
std::vector<T> normals(Rng& rng, std::size_t n, double scale = 1.0) {
    std::vector<T> numbers(n);
    for (T& each : numbers) each = static_cast<T>(scale * normal(rng));
    return numbers;
}

// A number that breaks things, now and then.
double odd(Rng& rng, double usual) {
    const double odd_ones[] = {std::numeric_limits<double>::quiet_NaN(), std::numeric_limits<double>::infinity(), -1e300, 0.0};
    return integer(rng, 0, 19) ? usual : odd_ones[integer(rng, 0, 3)];
}

// A digest (FNV-1a) of the bits of all results.
class Digest {
  public:
    void add(double number) {
        if (std::isnan(number)) number = std::numeric_limits<double>::quiet_NaN();  // whatever its bits
        for (const std::byte each : std::as_bytes(std::span<const double>(&number, 1))) {
            value_ ^= static_cast<std::uint64_t>(each);
            value_ *= 0x100000001b3;
        }
    }
    template <class T>
    void add(std::span<const T> numbers) {
        for (const T each : numbers) add(static_cast<double>(each));
    }
    void add(const Solution& fit) {
        add(std::span<const double>(fit.state.p));
        add(std::span<const double>(fit.state.angles));
        add(std::span<const double>(fit.state.lam));
        add(std::span<const double>(fit.trace.costs));
        add(std::span<const double>(fit.trace.path));
        add(std::span<const double>(fit.expected_hessian.numbers()));
        add(std::span<const float>(fit.usable));
        add(std::span<const float>(fit.residual));
        for (const double number : {fit.noise_variance, fit.squares, fit.weight, fit.prior_scale}) add(number);
        for (const int count : {fit.trace.n_iterations, fit.trace.converged + 0, fit.trace.angle_fixed + 0, fit.trace.no_texture + 0})
            add(static_cast<double>(count));
    }
    std::uint64_t value() const { return value_; }

  private:
    std::uint64_t value_ = 0xcbf29ce484222325;
};

// The arrays of a random objective. The mesh is a square of two triangles; the shape moves its corners.
struct Arrays {
    int side, k, m, n_modes, n_free;
    std::vector<float> beta, mean, mean_gradients, scales, sqrt_weights, metric;
    std::vector<std::int16_t> codes, gradient_codes;
    std::vector<std::int64_t> starts, triangles{0, 1, 2, 2, 1, 3};
    std::vector<double> rest, basis, gram, ridge, errors, prior, directions, shape_basis;
    Objective objective;

    Arrays(Rng& rng, int kind)
        : side(integer(rng, 3, 12)), k(kind == 0 ? 3 : integer(rng, 1, 3)), m(integer(rng, 0, 9)),
          n_modes(integer(rng, 0, 3)), n_free(kind == 2 ? integer(rng, 1, 2) : 0) {
        make_mesh();
        make_shapes(rng);
        make_appearance(rng, kind);
        set_method(rng, kind);
    }

    std::size_t n_p() const { return 4 + n_modes; }
    std::size_t n() const { return beta.size() / 3; }

    void make_mesh() {
        const double half = 0.5 * side;
        rest = {-half, -half, half, -half, -half, half, half, half};
        starts = {0};
        for (int upper = 1; upper >= 0; --upper) {
            for (int y = 0; y < side; ++y)
                for (int x = 0; x < side; ++x) {
                    const float u = (x + 0.5f) / side, v = (y + 0.5f) / side;
                    if ((u + v < 1.0f) != static_cast<bool>(upper)) continue;
                    if (upper) beta.insert(beta.end(), {1.0f - u - v, u, v});
                    else beta.insert(beta.end(), {1.0f - u, 1.0f - v, u + v - 1.0f});
                }
            starts.push_back(static_cast<std::int64_t>(beta.size() / 3));
        }
    }

    void make_shapes(Rng& rng) {
        const double scale = 1.0 / std::sqrt(2.0 * side * side);
        shape_basis = normals<double>(rng, 8 * n_modes, 0.3);
        for (int v = 0; v < 4; ++v) shape_basis.insert(shape_basis.end(), {scale * rest[2 * v], scale * rest[2 * v + 1]});
        for (int v = 0; v < 4; ++v) shape_basis.insert(shape_basis.end(), {-scale * rest[2 * v + 1], scale * rest[2 * v]});
        for (int v = 0; v < 4; ++v) shape_basis.insert(shape_basis.end(), {0.5, 0.0});
        for (int v = 0; v < 4; ++v) shape_basis.insert(shape_basis.end(), {0.0, 0.5});
        basis.assign(8 * 8, 0.0);
        for (std::size_t i = 0; i < n_p(); ++i)
            for (std::size_t c = 0; c < 8; ++c) basis[c * 8 + i] = shape_basis[i * 8 + c];
        prior.assign(n_p(), 0.0);
        for (int i = 0; i < n_modes; ++i) prior[i] = uniform(rng, 0.1, 4.0);
    }

    void make_appearance(Rng& rng, int kind) {
        const std::size_t e = n() * k, n_parts = n_free == 2 ? 3 : 1;
        mean = normals<float>(rng, n_parts * e);
        mean_gradients = normals<float>(rng, n_parts * 2 * e);
        codes = random_codes(rng, n_parts * e);
        gradient_codes = random_codes(rng, n_parts * 2 * e);
        scales.assign(width(), 1e-3f);
        sqrt_weights.assign(e, 1.0f);
        for (std::size_t i = 0; i < n(); ++i)
            if (!integer(rng, 0, 9)) std::fill_n(sqrt_weights.begin() + i * k, k, 0.0f);
        gram.assign(m * m, 0.0);
        for (int a = 0; a < m; ++a)
            for (int b = 0; b < m; ++b)
                for (std::size_t i = 0; i < e; ++i)
                    gram[a * m + b] += 1e-6 * codes[i * width() + a] * codes[i * width() + b] * sqrt_weights[i];
        ridge.assign(m, 1e-4);
        errors.assign(n(), kind == 1 ? 0.0 : uniform(rng, 0.0, 0.1));
        metric = normals<float>(rng, 3 * 8 * k);
        for (int row = 0; row < 3 * k; ++row) metric[row * 8 + 7] = 0.0f;
        directions = n_free == 0 ? std::vector<double>{} : n_free == 1 ? std::vector<double>{0, 1} : std::vector<double>{1, 0, 0, 1};
    }

    std::size_t width() const { return (static_cast<std::size_t>(m) + 7) / 8 * 8; }

    // Lines of modes of about unit variance, padded with zeros.
    std::vector<std::int16_t> random_codes(Rng& rng, std::size_t lines) const {
        std::vector<std::int16_t> all(lines * width(), 0);
        for (std::size_t e = 0; e < lines; ++e)
            for (int j = 0; j < m; ++j) all[e * width() + j] = static_cast<std::int16_t>(1000.0 * normal(rng));
        return all;
    }

    // The mean and the modes at a number of residuals, of one part or three.
    MeanAndModes appearance(const std::vector<float>& of_mean, const std::vector<std::int16_t>& of_modes, std::size_t size) const {
        MeanAndModes found{{of_mean.data(), of_mean.size() / size, size}, {{}, scales}};
        for (std::size_t i = 0; i < found.mean.n_rows; ++i)
            found.modes.parts[i] = {of_modes.data() + i * size * width(), size, width()};
        return found;
    }

    void set_method(Rng& rng, int kind) {
        const std::size_t e = n() * k, free = static_cast<std::size_t>(n_free), modes = static_cast<std::size_t>(m);
        Model& model = objective.model;
        model.mesh = {{beta.data(), n(), 3}, starts, {triangles.data(), 2, 3}, {rest.data(), 4, 2}, {basis.data(), 8, 8}, 0.5};
        model.appearance = appearance(mean, codes, e);
        model.gradients = appearance(mean_gradients, gradient_codes, 2 * e);
        model.sqrt_weights = sqrt_weights;
        model.gram = {gram.data(), modes, modes};
        model.ridge = ridge;
        model.errors = errors;
        model.prior = prior;
        model.dof = kind == 0 ? 5.0 : std::numeric_limits<double>::infinity();
        Method& method = objective.method;
        const Floats all = metric;
        method.metric = {all.subspan(0, 8 * k), all.subspan(8 * k, 8 * k), all.subspan(16 * k, 8 * k)};
        method.directions = {directions.data(), 2, free};
        method.weighting = kind == 0 ? Weighting::rows : kind == 2 && integer(rng, 0, 1) ? Weighting::noise : Weighting::model;
        method.loss = integer(rng, 0, 2) ? Loss::none : static_cast<Loss>(integer(rng, 1, 5));
        method.step = kind == 0 ? StepKind::expected : static_cast<StepKind>(integer(rng, 0, 1));
    }
};

// A stored image, with a few unusable values.
struct Photo {
    std::vector<std::uint8_t> pixels;
    std::vector<float> table;
    Stored<std::uint8_t> view;
    Picture picture;

    Photo(Rng& rng, Encoding encoding) {
        const int height = integer(rng, 8, 60), width = integer(rng, 8, 60), base = integer(rng, 0, 255);
        for (int i = 0; i < 3 * height * width; ++i)
            pixels.push_back(static_cast<std::uint8_t>(std::clamp(base + static_cast<int>(40 * normal(rng)), 0, 255)));
        table.assign(3 * 256 * 4, 1.0f);
        for (int c = 0; c < 3; ++c)
            for (int v = 0; v < 256; ++v) {
                table[(c * 256 + v) * 4 + c] = static_cast<float>(v) / 255.0f;
                table[(c * 256 + v) * 4 + 3] = v > 8 && v < 250 ? 1.0f : 0.0f;
            }
        view = {pixels.data(), height, width, 3 * width, 3, 1};
        picture.height = height;
        picture.width = width;
        picture.bytes = &view;
        picture.table = {table};
        picture.grey = !integer(rng, 0, 9);
        picture.encoding = encoding;
    }
};

void fit_once(Rng& rng, Digest& digest) {
    const int kind = integer(rng, 0, 2);
    const Encoding encoding = kind == 0 ? Encoding::soft : kind == 2 ? Encoding::log : static_cast<Encoding>(integer(rng, 0, 2));
    const Photo photo(rng, encoding);
    Arrays coarse(rng, kind);
    const Shapes shapes{{coarse.shape_basis.data(), coarse.n_p(), 8}, coarse.rest};
    const std::vector<float> noise(16, 0.1f);
    Target target;
    const double scale = std::exp(uniform(rng, -1.5, 1.5));
    for (std::size_t i = 0; i < 8; ++i) target.start.push_back(scale * coarse.rest[i] + uniform(rng, -5.0, 60.0) * (i < 2 ? 0 : 1));
    target.margin = uniform(rng, 0.0, 1.0);
    target.has_invariant = kind == 2 && coarse.k == 1 && coarse.n_free == 1;
    target.log_noise = noise;
    Options options;
    options.max_iterations = integer(rng, 0, 12);
    options.damping = integer(rng, 0, 3) ? 1e-3 : 0.0;
    options.scoring = integer(rng, -1, 3);
    options.keeps_samples = true;
    static FitRoom room;
    const std::vector<LevelSpec> levels{{&coarse.objective, 2.0, 1.0, shapes},
                                        {&coarse.objective, odd(rng, 0.0) == 0.0 ? 0.0 : 1.0, 0.5, shapes}};
    const auto results = fit_levels(levels, photo.picture, target, options, kConstants, room, [] { return false; });
    check(!results.empty() && results.size() <= 2, "a fit has one or two levels");
    for (const FittedLevel& result : results) {
        check(result.fit.trace.path.size() == result.fit.trace.costs.size() * coarse.n_p(), "the path has other lengths");
        check(result.fit.usable.size() == coarse.n(), "usable pixels differ in number");
        check(result.fit.state.lam.size() == static_cast<std::size_t>(coarse.m), "lambda has another length");
        digest.add(result.fit);
    }
}

// A level from a state that may be no number.
void solve_once(Rng& rng, Digest& digest) {
    Arrays arrays(rng, integer(rng, 0, 2));
    const int height = integer(rng, 2, 20), width = integer(rng, 2, 20);
    std::vector<float> pixels = normals<float>(rng, 8 * height * width), noise(16, 0.1f);
    for (std::size_t i = 7; i < pixels.size(); i += 8) pixels[i] = integer(rng, 0, 9) ? 1.0f : 0.0f;
    EncodedImage image;
    image.pixels = pixels;
    image.height = height;
    image.width = width;
    image.from_model.x0 = odd(rng, 0.5 * width);
    image.from_model.y0 = odd(rng, 0.5 * height);
    image.log_noise = noise;
    image.constants = kConstants;
    State start{normals<double>(rng, arrays.n_p(), 0.5), {2.0, 2.1}, normals<double>(rng, arrays.m)};
    start.p[0] = odd(rng, start.p[0]);
    Options options;
    options.max_iterations = integer(rng, 0, 8);
    static LevelRoom room;
    const Solution fit = solve_level(arrays.objective, image, start, options, 1.0, integer(rng, 0, 1), room, [] { return false; });
    check(fit.trace.n_iterations <= 2 * options.max_iterations, "too many steps");
    check(fit.state.p.size() == arrays.n_p(), "p has another length");
    digest.add(fit);
}

void draw_once(Rng& rng) {
    const std::size_t n = integer(rng, 3, 8), height = integer(rng, 1, 20), width = integer(rng, 1, 20);
    std::vector<double> points = normals<double>(rng, 3 * n, 20.0), values = normals<double>(rng, 2 * n);
    points[0] = odd(rng, points[0]);
    std::vector<std::int32_t> triangles(12);
    for (std::int32_t& corner : triangles) corner = integer(rng, 0, static_cast<int>(n) - 1);
    std::vector<std::int32_t> owner(height * width, -1);
    std::vector<double> drawn(2 * height * width);
    draw_triangles({points.data(), n, 3}, {triangles.data(), 4, 3}, {values.data(), n, 2}, {owner.data(), height, width}, drawn.data());
    const std::vector<float> image(drawn.begin(), drawn.end());
    const Plane plane{image.data(), static_cast<std::ptrdiff_t>(height), static_cast<std::ptrdiff_t>(width),
                      static_cast<std::ptrdiff_t>(2 * width), 2};
    const auto peaks = best_peaks(plane, integer(rng, 0, 5), 0.1f, integer(rng, 0, 4));
    check(peaks.size() <= 5, "too many peaks");
}

void differentiate_once(Rng& rng) {
    const std::size_t n = integer(rng, 1, 20), width = integer(rng, 0, 3);
    const std::vector<double> values = normals<double>(rng, n * width);
    std::vector<std::int32_t> order;
    std::vector<std::uint8_t> joined;
    for (std::size_t i = 0; i < n; ++i) {
        order.push_back(integer(rng, 0, static_cast<int>(n) - 1));
        joined.push_back(integer(rng, 0, 4) > 0);
    }
    std::vector<double> slopes(n * width);
    spline_slopes({values.data(), n, width}, order, joined, {slopes.data(), n, width});
}

}  // namespace

int main(int argc, char** argv) {
    const int cases = argc > 1 ? std::atoi(argv[1]) : 1000;
    Rng rng(argc > 2 ? std::strtoull(argv[2], nullptr, 10) : 1);
    Digest digest;
    for (int i = 0; i < cases; ++i) {
        if (i % 4 == 1) differentiate_once(rng);
        if (i % 4 == 0) draw_once(rng);
        if (i % 2 == 0) solve_once(rng, digest);
        else fit_once(rng, digest);
    }
    std::printf("%d cases, digest %016llx\n", cases, static_cast<unsigned long long>(digest.value()));
}
