// Bindings of the loops over images: liaam.image_reference has the same functions in NumPy.
#include "binding.hpp"
#include "elementary.hpp"
#include "encoding.hpp"
#include "image.hpp"
#include "mean_field.hpp"
#include "orientation.hpp"
#include "painting.hpp"
#include "search.hpp"
#include "splines.hpp"

using namespace liaam;

namespace {

// Refuses blocks that do not fit into an image. Without any block, their size may be anything.
void check_blocks(double height, double width, const BlockGrid& blocks) {
    require(blocks.size >= 1.0 && blocks.x >= 0.0 && blocks.y >= 0.0 && blocks.rows >= 0 && blocks.columns >= 0,
            "blocks start within the image and have a size of at least 1");
    require(blocks.x + blocks.size * blocks.columns <= width + 1e-6 * width + 1e-6 &&
                blocks.y + blocks.size * blocks.rows <= height + 1e-6 * height + 1e-6,
            "the blocks do not fit into the image");
}

template <class T>
nb::object average_stored(const Image<T>& image, const Array<float, 3>& table, double x, double y, double size,
                          std::ptrdiff_t rows, std::ptrdiff_t columns) {
    check_table<T>(table);
    const BlockGrid blocks{x, y, size, rows, columns};
    check_blocks(image.shape(0), image.shape(1), blocks);
    std::vector<float> means;
    if (rows > 0 && columns > 0) {
        const Stored<T> view = stored(image);
        const LightTable light{{data_of(table), table.size()}};
        const Unlocked unlocked;
        stored_means(view, light, blocks, means);
    }
    return owned(std::move(means), {std::size_t(rows), std::size_t(columns), 4});
}

template <class T>
nb::object average_brightness(const Image<T>& image, const Array<float, 2>& tables, double x, double y, double size,
                              std::ptrdiff_t rows, std::ptrdiff_t columns) {
    require((tables.shape(0) == 3 || tables.shape(0) == 1) && tables.shape(1) == std::size_t{1} << (8 * sizeof(T)),
            "there is a table for each channel, or one for all, with an entry for each stored value");
    const BlockGrid blocks{x, y, size, rows, columns};
    check_blocks(image.shape(0), image.shape(1), blocks);
    std::vector<float> means;
    if (rows > 0 && columns > 0) {
        const Stored<T> view = stored(image);
        const MatrixView<const float> by_channel = view_of(tables);
        const Unlocked unlocked;
        stored_brightness(view, by_channel, blocks, means);
    }
    return owned(std::move(means), {std::size_t(rows), std::size_t(columns)});
}

nb::object average_values(const Array<float, 3>& values, double x, double y, double size,
                                             std::ptrdiff_t rows, std::ptrdiff_t columns) {
    const BlockGrid blocks{x, y, size, rows, columns};
    check_blocks(values.shape(0), values.shape(1), blocks);
    std::vector<float> means;
    if (rows > 0 && columns > 0) {
        const float* numbers = data_of(values);
        const Unlocked unlocked;
        value_means(numbers, values.shape(0), values.shape(1), values.shape(2), blocks, means);
    }
    return owned(std::move(means), {std::size_t(rows), std::size_t(columns), values.shape(2)});
}

nb::object average_area(const Array<float, 2>& image, std::size_t rows, std::size_t columns) {
    require(image.size() > 0 && rows <= image.shape(0) && columns <= image.shape(1), "blocks are at least a pixel large");
    require(rows > 0 && columns > 0, "there is at least one block");
    std::vector<float> means(rows * columns);
    const float* numbers = data_of(image);
    {
        const Unlocked unlocked;
        area_means(numbers, image.shape(0), image.shape(1), rows, columns, means.data());
    }
    return owned(std::move(means), {rows, columns});
}

template <class T>
nb::object luminance(const Image<T>& image, const Array<float, 2>& tables) {
    require(tables.shape(0) == 3 && tables.shape(1) == std::size_t{1} << (8 * sizeof(T)),
            "there is a table for each channel, with an entry for each stored value");
    std::vector<float> out(image.shape(0) * image.shape(1));
    const MatrixView<const float> rows = view_of(tables);
    const Stored<T> view = stored(image);
    {
        const Unlocked unlocked;
        stored_luminance(view, {rows[0], rows[1], rows[2]}, out.data());
    }
    return owned(std::move(out), {image.shape(0), image.shape(1)});
}

template <class T>
bool equal_channels(const Image<T>& image) {
    const Stored<T> view = stored(image);
    const Unlocked unlocked;
    return has_equal_channels(view);
}

nb::object encode_light(const Array<float, 3>& light, const std::optional<Array<float, 2>>& finite,
                                           bool grey, int encoding, float floor, double blur, std::array<float, 4> turn,
                                           double pixel) {
    require(light.shape(2) == 4 && light.size() > 0, "light has four channels: R, G, B and the usable share");
    require(blur >= 0.0 && blur < kWidestBlur, "the blur is out of range");
    Means means{static_cast<std::ptrdiff_t>(light.shape(0)), static_cast<std::ptrdiff_t>(light.shape(1)),
                numbers_of(light), {}, grey};
    if (finite) {
        require(finite->shape(0) == light.shape(0) && finite->shape(1) == light.shape(1),
                "there is a finite share for each pixel");
        means.finite = numbers_of(*finite);
    }
    const EncodingConstants& constants = encoding_constants();
    EncodingOptions options{numbered<Encoding>(encoding, kLastEncoding, "encoding"), floor, blur, pixel, turn};
    Channels channels;
    {
        const Unlocked unlocked;
        encode(means, options, constants, channels);
    }
    return owned(std::move(channels.pixels), {light.shape(0), light.shape(1), kChannels});
}

nb::object blur_planes(const Array<float, 3>& planes, double sigma) {
    require(sigma >= 0.0 && sigma < kWidestBlur && planes.size() > 0, "the blur is out of range");
    std::vector<float> out(planes.size()), line;
    const std::size_t height = planes.shape(1), width = planes.shape(2);
    const auto taps = gaussian_taps(sigma);
    const float* numbers = data_of(planes);
    for (std::size_t p = 0; p < planes.shape(0); ++p)
        for (std::size_t y = 0; y < height; ++y)
            blur_row(numbers + p * height * width, height, width, y, taps, line, out.data() + (p * height + y) * width);
    return owned(std::move(out), {planes.shape(0), height, width});
}

nb::object soft_directions(const Array<float, 2>& plane, std::array<float, 4> turn, float softness) {
    const std::size_t height = plane.shape(0), width = plane.shape(1);
    require(plane.size() > 0, "the plane is empty");
    std::vector<float> out(2 * plane.size()), across(width), down(width);
    const float* numbers = data_of(plane);
    for (std::size_t y = 0; y < height; ++y) {
        soft_directions_row(numbers, height, width, y, turn, softness, across.data(), down.data());
        for (std::size_t x = 0; x < width; ++x) {
            out[2 * (y * width + x)] = across[x];
            out[2 * (y * width + x) + 1] = down[x];
        }
    }
    return owned(std::move(out), {height, width, 2});
}

nb::object orientations(const Array<float, 2>& brightness, const std::optional<Array<float, 2>>& finite, double blur,
                        std::array<float, 4> turn, double pixel) {
    const std::size_t height = brightness.shape(0), width = brightness.shape(1);
    require(brightness.size() > 0, "there are no pixels");
    require(blur >= 0.0 && blur < kWidestBlur, "the blur is out of range");
    if (finite) require(finite->shape(0) == height && finite->shape(1) == width, "there is a finite share for each pixel");
    const EncodingOptions options{.blur = blur, .pixel = pixel, .turn = turn};
    const EncodingConstants& constants = encoding_constants();
    const float *light = data_of(brightness), *shares = finite ? data_of(*finite) : nullptr;
    std::vector<float> counts;
    {
        const Unlocked unlocked;
        count_orientations(light, shares, height, width, options, constants, counts);
    }
    return owned(std::move(counts), {height, width, kOrientations});
}

nb::object blurred_counts(const Array<float, 3>& counts, const Array<double, 2>& points, double sigma) {
    require(points.shape(1) == 2 && counts.shape(0) >= 2 && counts.shape(1) >= 2 && counts.shape(2) == kOrientations,
            "points are (n, 2), and counts (h, w, 8), of at least 2 by 2 pixels");
    require(sigma >= 0.0 && sigma < kWidestBlur, "the blur is out of range");
    std::vector<float> values(kOrientations * points.shape(0));
    const float* numbers = data_of(counts);
    const MatrixView<const double> places = view_of(points);
    {
        const Unlocked unlocked;
        blurred_at(numbers, counts.shape(0), counts.shape(1), places, sigma, values.data());
    }
    return owned(std::move(values), {points.shape(0), kOrientations});
}

auto sample_at(const Array<float, 3>& channels, const Array<double, 2>& points) {
    const std::size_t n = points.shape(0), depth = channels.shape(2);
    require(points.shape(1) == 2 && channels.shape(0) >= 2 && channels.shape(1) >= 2 && depth >= 1,
            "points are (n, 2), and the image is at least 2 by 2 pixels");
    std::vector<float> values(size_of({n, depth - 1})), usable(n);
    const MatrixView<const float> pixels{data_of(channels), channels.shape(0) * channels.shape(1), depth};
    const MatrixView<const double> places = view_of(points);
    {
        const Unlocked unlocked;
        sample_channels(pixels, channels.shape(1), places, values.data(), usable.data());
    }
    return std::make_pair(owned(std::move(values), {n, depth - 1}), owned(std::move(usable), {n}));
}

void correlate_spectra(const Array<float, 4>& image, const Array<float, 4>& templates,
                       nb::ndarray<float, nb::ndim<3>, nb::c_contig, nb::device::cpu> product) {
    bool same = image.shape(1) == 2 && product.shape(2) == 2;
    for (std::size_t axis = 0; axis < 4; ++axis) same = same && image.shape(axis) == templates.shape(axis);
    for (std::size_t axis = 0; axis < 2; ++axis) same = same && image.shape(axis + 2) == product.shape(axis);
    require(same, "the spectra differ in size");
    const float *seen = data_of(image), *expected = data_of(templates);
    float* out = data_of(product);
    const Unlocked unlocked;
    correlate(seen, expected, image.shape(0), product.size() / 2, out);
}

auto peaks_of(const nb::ndarray<const float, nb::ndim<2>, nb::device::cpu>& image, std::size_t count, float least,
              std::ptrdiff_t reach) {
    require(reach >= 0 && image.size() > 0, "there are no pixels");
    const auto height = static_cast<std::ptrdiff_t>(image.shape(0)), width = static_cast<std::ptrdiff_t>(image.shape(1));
    const Plane plane{data_of(image), height, width, image.stride(0), image.stride(1)};
    reach = std::min(reach, std::max(height, width));  // beyond that there is nothing, and sums may overflow
    std::vector<Peak> peaks;
    {
        const Unlocked unlocked;
        peaks = best_peaks(plane, count, least, reach);
    }
    std::vector<std::int64_t> places;
    std::vector<float> values;
    for (const Peak& peak : peaks) {
        places.insert(places.end(), {peak.row, peak.column});
        values.push_back(peak.value);
    }
    return std::make_pair(owned(std::move(places), {peaks.size(), 2}), owned(std::move(values), {peaks.size()}));
}

auto draw(const Array<double, 2>& points, const Array<std::int32_t, 2>& triangles, const Array<double, 2>& values,
          std::size_t height, std::size_t width) {
    require(points.shape(1) == 3 && triangles.shape(1) == 3 && values.shape(0) == points.shape(0), "the mesh is damaged");
    const MatrixView<const std::int32_t> named = view_of(triangles);
    require(named.n_rows <= static_cast<std::size_t>(std::numeric_limits<std::int32_t>::max()), "there are too many triangles");
    for (std::size_t i = 0; i < triangles.size(); ++i)
        require(named.data[i] >= 0 && static_cast<std::size_t>(named.data[i]) < points.shape(0),
                "a triangle names a vertex that does not exist");
    const std::size_t n_pixels = size_of({height, width}), n_values = size_of({height, width, values.shape(1)});
    std::vector<std::int32_t> owner(n_pixels, -1);
    std::vector<double> drawn(n_values, 0.0);
    const MatrixView<const double> corners = view_of(points), carried = view_of(values);
    {
        const Unlocked unlocked;
        draw_triangles(corners, named, carried, {owner.data(), height, width}, drawn.data());
    }
    return std::make_pair(owned(std::move(owner), {height, width}),
                          owned(std::move(drawn), {height, width, values.shape(1)}));
}

void filter(nb::ndarray<float, nb::ndim<3>, nb::c_contig, nb::device::cpu> layers, const Array<float, 2>& across,
            const Array<float, 2>& down) {
    const std::size_t height = layers.shape(0), width = layers.shape(1), depth = layers.shape(2);
    require(layers.size() > 0 && across.shape(0) == height && across.shape(1) + 1 == width && down.shape(0) + 1 == height &&
                down.shape(1) == width,
            "there is a feedback between each pair of neighbours");
    float* numbers = data_of(layers);
    const float *by_column = data_of(across), *by_row = data_of(down);
    const Unlocked unlocked;
    filter_rows(numbers, height, width, depth, by_column);
    filter_columns(numbers, height, width, depth, by_row);
}

nb::object slopes_along(const Array<double, 2>& values, const Array<std::int32_t, 1>& order,
                        const Array<std::uint8_t, 1>& joined) {
    const std::size_t n = values.shape(0), width = values.shape(1);
    require(order.shape(0) == n && joined.shape(0) == n, "each pixel is in the order once");
    const auto pixels = span_of(order);
    for (const std::int32_t pixel : pixels)
        require(pixel >= 0 && static_cast<std::size_t>(pixel) < n, "the order names a pixel that does not exist");
    std::vector<double> slopes(values.size(), 0.0);
    const MatrixView<const double> numbers = view_of(values);
    const auto neighbours = span_of(joined);
    {
        const Unlocked unlocked;
        spline_slopes(numbers, pixels, neighbours, {slopes.data(), n, width});
    }
    return owned(std::move(slopes), {n, width});
}

template <float function(float)>
nb::object elementwise(const Array<float, 1>& numbers) {
    std::vector<float> out = numbers_of(numbers);
    for (float& each : out) each = function(each);
    return owned(std::move(out), {numbers.size()});
}

nb::object srgb(const Array<float, 1>& linear) {
    std::vector<float> out(linear.size());
    srgb_encode(data_of(linear), 1, out.size(), out.data());
    return owned(std::move(out), {linear.size()});
}

nb::object segment(const Array<float, 2>& own, const Array<float, 2>& sampled, const Array<float, 1>& taps, float strength,
                   int rounds) {
    const std::size_t height = own.shape(0), width = own.shape(1);
    require(sampled.shape(0) == height && sampled.shape(1) == width, "there is a number for each pixel");
    require(own.size() > 0 && taps.size() > 0, "there are pixels and taps");
    MeanField field;
    {
        const Unlocked unlocked;
        field = mean_field({data_of(own), own.size()}, {data_of(sampled), sampled.size()},
                           static_cast<std::ptrdiff_t>(width), {data_of(taps), taps.size()}, strength, rounds);
    }
    return nb::make_tuple(owned(std::move(field.labels), {height, width}), owned(std::move(field.around), {height, width}));
}

}  // namespace

void bind_images(nb::module_& module) {
    module.def("stored_means", average_stored<std::uint8_t>, "image"_a.noconvert(), "table"_a, "x"_a, "y"_a, "size"_a,
               "rows"_a, "columns"_a);
    module.def("stored_means", average_stored<std::uint16_t>, "image"_a.noconvert(), "table"_a, "x"_a, "y"_a, "size"_a,
               "rows"_a, "columns"_a);
    module.def("stored_brightness", average_brightness<std::uint8_t>, "image"_a.noconvert(), "tables"_a, "x"_a, "y"_a,
               "size"_a, "rows"_a, "columns"_a);
    module.def("stored_brightness", average_brightness<std::uint16_t>, "image"_a.noconvert(), "tables"_a, "x"_a, "y"_a,
               "size"_a, "rows"_a, "columns"_a);
    module.def("value_means", average_values, "values"_a, "x"_a, "y"_a, "size"_a, "rows"_a, "columns"_a);
    module.def("area_means", average_area, "image"_a, "rows"_a, "columns"_a);
    module.def("stored_luminance", luminance<std::uint8_t>, "image"_a.noconvert(), "tables"_a);
    module.def("stored_luminance", luminance<std::uint16_t>, "image"_a.noconvert(), "tables"_a);
    module.def("has_equal_channels", equal_channels<std::uint8_t>, "image"_a.noconvert());
    module.def("has_equal_channels", equal_channels<std::uint16_t>, "image"_a.noconvert());
    module.def("encode", encode_light, "light"_a, "finite"_a.none(), "grey"_a, "encoding"_a, "floor"_a, "blur"_a, "turn"_a,
               "pixel"_a);
    module.def("blur_planes", blur_planes, "planes"_a, "sigma"_a);
    module.def("soft_directions", soft_directions, "plane"_a, "turn"_a, "softness"_a);
    module.def("count_orientations", orientations, "brightness"_a, "finite"_a.none(), "blur"_a, "turn"_a, "pixel"_a);
    module.def("blurred_at", blurred_counts, "counts"_a, "points"_a, "sigma"_a);
    module.def("mean_field", segment, "own"_a, "sampled"_a, "taps"_a, "strength"_a, "rounds"_a);
    module.def("sample_channels", sample_at, "channels"_a, "points"_a);
    module.def("correlate", correlate_spectra, "image"_a, "templates"_a, "product"_a.noconvert());
    module.def("best_peaks", peaks_of, "image"_a, "count"_a, "least"_a, "reach"_a);
    module.def("draw_triangles", draw, "points"_a, "triangles"_a, "values"_a, "height"_a, "width"_a);
    module.def("spline_slopes", slopes_along, "values"_a, "order"_a, "joined"_a);
    module.def("filter_rows_and_columns", filter, "layers"_a.noconvert(), "across"_a, "down"_a);
    module.def("log", elementwise<log_of>, "numbers"_a);
    module.def("exp", elementwise<exp_of>, "numbers"_a);
    module.def("srgb", srgb, "linear"_a);
}
