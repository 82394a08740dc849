#include "image.hpp"

#include <cmath>
#include <cstdlib>

#include "eight.hpp"

namespace liaam {

namespace {

// Of the blocks along a side: the first pixel of each, and the weights of it and the following ones in the mean.
struct Taps {
    std::size_t n_taps, stride;  // the shares of a block are followed by zeros up to a multiple of four
    std::vector<std::ptrdiff_t> first;
    std::vector<float> shares;

    Taps(std::ptrdiff_t n_in, double start, double size, std::ptrdiff_t n_out)
        : n_taps(static_cast<std::size_t>(std::ceil(size)) + (start != std::floor(start) || size != std::floor(size))),
          stride((n_taps + 3) / 4 * 4), first(n_out), shares(n_out * stride) {
        for (std::ptrdiff_t j = 0; j < n_out; ++j) {
            const double low = start + j * size, high = std::min(low + size, static_cast<double>(n_in));
            first[j] = std::min(static_cast<std::ptrdiff_t>(low), n_in - 1);
            for (std::size_t k = 0; k < n_taps; ++k) {
                const double left = std::max<double>(first[j] + k, low), right = std::min<double>(first[j] + k + 1, high);
                shares[j * stride + k] = right > left ? static_cast<float>((right - left) / size) : 0.0f;
            }
        }
    }
    const float* of(std::ptrdiff_t j) const { return shares.data() + j * stride; }
};

// Averages a sum of rows of pixels, `depth` numbers each, along the row.
void cut_row(const std::vector<float>& sums, const Taps& taps, std::ptrdiff_t columns, std::ptrdiff_t depth,
             float* means) {
    for (std::ptrdiff_t j = 0; j < columns; ++j) {
        const float* shares = taps.of(j);
        const float* from = sums.data() + depth * taps.first[j];
        for (std::ptrdiff_t c = 0; c < depth; ++c) {
            float total = 0.0f;
            for (std::size_t k = 0; k < taps.n_taps; ++k) total += shares[k] * from[depth * k + c];
            means[depth * j + c] = total;
        }
    }
}

// The same for one number.
void cut_plane(const std::vector<float>& sums, const Taps& taps, std::ptrdiff_t columns, float* means) {
    for (std::ptrdiff_t j = 0; j < columns; ++j) {
        const float* shares = taps.of(j);
        const float* from = sums.data() + taps.first[j];
        Four total{};
        for (std::size_t k = 0; k < taps.n_taps; k += 4) total += load_four(shares + k) * load_four(from + k);
        means[j] = (total[0] + total[1]) + (total[2] + total[3]);
    }
}

// The same for four numbers: the light of a pixel.
void cut_light(const std::vector<float>& sums, const Taps& taps, std::ptrdiff_t columns, float* means) {
    for (std::ptrdiff_t j = 0; j < columns; ++j) {
        const float* shares = taps.of(j);
        const float* from = sums.data() + 4 * taps.first[j];
        Four total{};
        for (std::size_t k = 0; k < taps.n_taps; ++k) total += shares[k] * load_four(from + 4 * k);
        store_four(means + 4 * j, total);
    }
}

template <class T>
void decode_row(const Stored<T>& image, std::ptrdiff_t y, const LightTable& table, float* light) {
    const T* pixel = image.row(y);
    const float *reds = table.of(0), *greens = table.of(1), *blues = table.of(2);
    for (std::ptrdiff_t x = 0; x < image.width; ++x, pixel += image.by_pixel) {
        const Four red = load_four(reds + 4 * pixel[0]), green = load_four(greens + 4 * pixel[image.by_channel]);
        const Four blue = load_four(blues + 4 * pixel[2 * image.by_channel]);
        store_four(light + 4 * x, red * green * blue);
    }
}

// The sum of each pixel's channels by their tables.
template <class T>
void sum_row(const Stored<T>& image, std::ptrdiff_t y, const std::array<Floats, 3>& tables, float* sums) {
    const T* pixel = image.row(y);
    const float *reds = tables[0].data(), *greens = tables[1].data(), *blues = tables[2].data();
    for (std::ptrdiff_t x = 0; x < image.width; ++x, pixel += image.by_pixel)
        sums[x] = reds[pixel[0]] + greens[pixel[image.by_channel]] + blues[pixel[2 * image.by_channel]];
}

// The first channel of each pixel by a table.
template <class T>
void look_up_row(const Stored<T>& image, std::ptrdiff_t y, Floats table, float* values) {
    const T* pixel = image.row(y);
    const float* numbers = table.data();
    std::ptrdiff_t x = 0;
    for (; x + 4 <= image.width; x += 4)  // in a third of the time of a plain loop, which compilers do not unroll
        for (std::ptrdiff_t k = 0; k < 4; ++k, pixel += image.by_pixel) values[x + k] = numbers[*pixel];
    for (; x < image.width; ++x, pixel += image.by_pixel) values[x] = numbers[*pixel];
}

// Whether the channels of pixels that lie one after the other are equal. Each number is compared with the next, also that
// of the next pixel, which is left out of the result: so compilers vectorise the loop.
template <class T>
bool has_equal_neighbours(const Stored<T>& image) {
    const std::ptrdiff_t n = 3 * image.width - 1;
    std::vector<T> counts(n + 1, static_cast<T>(~T{0}));
    for (std::ptrdiff_t i = 2; i <= n; i += 3) counts[i] = 0;
    const T* of_pixel = counts.data();
    for (std::ptrdiff_t y = 0; y < image.height; ++y) {
        const T* row = image.row(y);
        T differing = 0;  // bits
#pragma omp simd reduction(| : differing)
        for (std::ptrdiff_t i = 0; i < n; ++i) differing |= static_cast<T>((row[i] ^ row[i + 1]) & of_pixel[i]);
        if (differing != 0) return false;
    }
    return true;
}

// A sum of rows, each times a share; what lies beyond their n numbers stays 0.
class RowSum {
  public:
    RowSum(std::size_t n, std::size_t beyond) : sums_(n + beyond), n_(n) {}

    void begin() { is_empty_ = true; }
    void add(float share, const float* row) {
        if (is_empty_) set_first(share, row);
        else add_next(share, row);
        is_empty_ = false;
    }
    const std::vector<float>& total() {
        if (is_empty_) std::fill_n(sums_.begin(), n_, 0.0f);
        return sums_;
    }

  private:
    void set_first(float share, const float* row) {
        float* sums = sums_.data();
#pragma omp simd
        for (std::size_t x = 0; x < n_; ++x) sums[x] = share * row[x];
    }
    void add_next(float share, const float* row) {
        float* sums = sums_.data();
#pragma omp simd
        for (std::size_t x = 0; x < n_; ++x) sums[x] += share * row[x];
    }

    std::vector<float> sums_;
    std::size_t n_;
    bool is_empty_ = true;
};

void cut(const std::vector<float>& sums, const Taps& taps, std::ptrdiff_t columns, std::ptrdiff_t depth, float* means) {
    if (depth == 4) cut_light(sums, taps, columns, means);
    else if (depth == 1) cut_plane(sums, taps, columns, means);
    else cut_row(sums, taps, columns, depth, means);
}

// Means of the blocks of an image (h, w, depth).
void mean_blocks(const float* values, std::ptrdiff_t width, std::ptrdiff_t depth, const Taps& down, const Taps& across,
                 float* means) {
    const std::size_t n = depth * width, columns = across.first.size();
    RowSum sum(n, depth * across.stride);  // blocks at the border read beyond, with weight 0
    for (std::size_t i = 0; i < down.first.size(); ++i, means += depth * columns) {
        sum.begin();
        for (std::size_t k = 0; k < down.n_taps; ++k) {
            const float share = down.of(i)[k];
            if (share > 0.0f) sum.add(share, values + (down.first[i] + k) * n);
        }
        cut(sum.total(), across, columns, depth, means);
    }
}

// Averages blocks of rows that `decode` writes, one at a time, `depth` numbers for each pixel. Rows are summed first, so
// that only the sums are cut into blocks.
template <class Decode>
void mean_rows(std::ptrdiff_t height, std::ptrdiff_t width, std::ptrdiff_t depth, const BlockGrid& blocks,
               const Decode& decode, std::vector<float>& means) {
    const Taps across(width, blocks.x, blocks.size, blocks.columns);
    const Taps down(height, blocks.y, blocks.size, blocks.rows);
    const std::size_t n = depth * width;
    RowSum sum(n, depth * across.stride);  // see mean_blocks
    std::vector<float> row(n);
    means.resize(depth * blocks.rows * blocks.columns);
    std::ptrdiff_t decoded = -1;
    for (std::ptrdiff_t i = 0; i < blocks.rows; ++i) {
        sum.begin();
        for (std::size_t k = 0; k < down.n_taps; ++k) {
            const float share = down.of(i)[k];
            if (share <= 0.0f) continue;
            const auto y = down.first[i] + static_cast<std::ptrdiff_t>(k);
            if (y != decoded) decode(y, row.data());  // blocks that cut through pixels share a row
            decoded = y;
            sum.add(share, row.data());
        }
        cut(sum.total(), across, blocks.columns, depth, means.data() + depth * blocks.columns * i);
    }
}

}  // namespace

template <class T>
void stored_means(const Stored<T>& image, const LightTable& table, const BlockGrid& blocks, std::vector<float>& means) {
    const auto decode = [&](std::ptrdiff_t y, float* light) { decode_row(image, y, table, light); };
    mean_rows(image.height, image.width, 4, blocks, decode, means);
}

template void stored_means(const Stored<std::uint8_t>&, const LightTable&, const BlockGrid&, std::vector<float>&);
template void stored_means(const Stored<std::uint16_t>&, const LightTable&, const BlockGrid&, std::vector<float>&);

template <class T>
void stored_brightness(const Stored<T>& image, MatrixView<const float> tables, const BlockGrid& blocks,
                       std::vector<float>& means) {
    if (tables.n_rows == 1) {
        const auto look_up = [&](std::ptrdiff_t y, float* values) { look_up_row(image, y, tables[0], values); };
        mean_rows(image.height, image.width, 1, blocks, look_up, means);
        return;
    }
    const std::array<Floats, 3> of_channels{tables[0], tables[1], tables[2]};
    const auto sum = [&](std::ptrdiff_t y, float* sums) { sum_row(image, y, of_channels, sums); };
    mean_rows(image.height, image.width, 1, blocks, sum, means);
}

template void stored_brightness(const Stored<std::uint8_t>&, MatrixView<const float>, const BlockGrid&,
                                std::vector<float>&);
template void stored_brightness(const Stored<std::uint16_t>&, MatrixView<const float>, const BlockGrid&,
                                std::vector<float>&);

void value_means(const float* values, std::ptrdiff_t height, std::ptrdiff_t width, std::ptrdiff_t depth,
                 const BlockGrid& blocks, std::vector<float>& means) {
    means.resize(depth * blocks.rows * blocks.columns);
    mean_blocks(values, width, depth, Taps(height, blocks.y, blocks.size, blocks.rows),
                Taps(width, blocks.x, blocks.size, blocks.columns), means.data());
}

void coarser_means(const Means& means, const BlockGrid& blocks, Means& coarser) {
    coarser.rows = blocks.rows;
    coarser.columns = blocks.columns;
    coarser.grey = means.grey;
    coarser.finite.clear();
    value_means(means.light.data(), means.rows, means.columns, 4, blocks, coarser.light);
    if (!means.finite.empty()) value_means(means.finite.data(), means.rows, means.columns, 1, blocks, coarser.finite);
}

void area_means(const float* image, std::ptrdiff_t height, std::ptrdiff_t width, std::ptrdiff_t rows,
                std::ptrdiff_t columns, float* means) {
    mean_blocks(image, width, 1, Taps(height, 0.0, static_cast<double>(height) / rows, rows),
                Taps(width, 0.0, static_cast<double>(width) / columns, columns), means);
}

template <class T>
void stored_luminance(const Stored<T>& image, const std::array<Floats, 3>& tables, float* luminance) {
    for (std::ptrdiff_t y = 0; y < image.height; ++y) sum_row(image, y, tables, luminance + y * image.width);
}

template void stored_luminance(const Stored<std::uint8_t>&, const std::array<Floats, 3>&, float*);
template void stored_luminance(const Stored<std::uint16_t>&, const std::array<Floats, 3>&, float*);

template <class T>
bool has_equal_channels(const Stored<T>& image) {
    if (image.by_pixel == 3 && image.by_channel == 1) return has_equal_neighbours(image);
    for (std::ptrdiff_t y = 0; y < image.height; ++y) {
        const T* pixel = image.row(y);
        for (std::ptrdiff_t x = 0; x < image.width; ++x, pixel += image.by_pixel)
            if (pixel[0] != pixel[image.by_channel] || pixel[0] != pixel[2 * image.by_channel]) return false;
    }
    return true;
}

template bool has_equal_channels(const Stored<std::uint8_t>&);
template bool has_equal_channels(const Stored<std::uint16_t>&);

void sample_channels(MatrixView<const float> pixels, std::ptrdiff_t width, MatrixView<const double> points, float* values,
                     float* usable) {
    const std::size_t last = pixels.n_columns - 1;
    const auto height = static_cast<std::ptrdiff_t>(pixels.n_rows) / width;
    for (std::size_t i = 0; i < points.n_rows; ++i) {
        const double x = points[i][0], y = points[i][1];
        float* out = values + i * last;
        if (!(0.0 <= x && x <= width - 1.0 && 0.0 <= y && y <= height - 1.0)) {  // also NaN
            std::fill(out, out + last, 0.0f);
            usable[i] = 0.0f;
            continue;
        }
        const auto column = std::min(static_cast<std::ptrdiff_t>(x), width - 2);
        const auto row = std::min(static_cast<std::ptrdiff_t>(y), height - 2);
        const double u = x - column, v = y - row;
        const float *a = pixels[row * width + column].data(), *b = a + pixels.n_columns;
        const float *c = a + width * pixels.n_columns, *d = c + pixels.n_columns;
        for (std::size_t k = 0; k < last; ++k) {
            const double top = a[k] + u * (b[k] - a[k]), bottom = c[k] + u * (d[k] - c[k]);
            out[k] = static_cast<float>(top + v * (bottom - top));
        }
        usable[i] = std::min(std::min(a[last], b[last]), std::min(c[last], d[last]));
    }
}

}  // namespace liaam
