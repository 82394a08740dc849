// The linear image: means of blocks of an image's pixels, and other sums over stored values.
#pragma once

#include <array>
#include <vector>

#include "arrays.hpp"

namespace liaam {

// A view of an image (h, w, 3) of stored integers, with any strides, counted in numbers.
template <class T>
struct Stored {
    const T* data = nullptr;
    std::ptrdiff_t height = 0, width = 0;
    std::ptrdiff_t by_row = 0, by_pixel = 3, by_channel = 1;

    const T* row(std::ptrdiff_t y) const { return data + y * by_row; }
    Stored crop(std::ptrdiff_t x, std::ptrdiff_t y, std::ptrdiff_t columns, std::ptrdiff_t rows) const {
        return {data + y * by_row + x * by_pixel, rows, columns, by_row, by_pixel, by_channel};
    }
};

// For each channel and stored value four numbers (3, n, 4), whose products over the channels of a pixel are its linear
// light R, G, B, and 1 if all three values are usable, else 0.
struct LightTable {
    Floats numbers;

    const float* of(std::size_t channel) const { return numbers.data() + channel * numbers.size() / 3; }
};

// Blocks of pixels of side `size`, at least 1, which may cut through pixels; (0, 0) is the border of the first pixel.
struct BlockGrid {
    double x = 0.0, y = 0.0, size = 1.0;
    std::ptrdiff_t rows = 0, columns = 0;
};

// Means of light over blocks: R, G, B and the fraction of usable pixels; and the fraction of finite ones, or nothing
// if all are finite.
struct Means {
    std::ptrdiff_t rows = 0, columns = 0;
    std::vector<float> light;   // (rows, columns, 4)
    std::vector<float> finite;  // (rows, columns) or empty
    bool grey = false;          // the image is grey: colours are not usable
};

// Averages stored values in linear light.
template <class T>
void stored_means(const Stored<T>& image, const LightTable& table, const BlockGrid& blocks, std::vector<float>& means);

// Averages the sum of a pixel's channels, by a table of stored values each; or the first channel, by one table, if the
// image is grey.
template <class T>
void stored_brightness(const Stored<T>& image, MatrixView<const float> tables, const BlockGrid& blocks,
                       std::vector<float>& means);

// Averages pixels of `depth` numbers, (h, w, depth).
void value_means(const float* values, std::ptrdiff_t height, std::ptrdiff_t width, std::ptrdiff_t depth,
                 const BlockGrid& blocks, std::vector<float>& means);

// Averages means over coarser blocks, or whole ones again, which refer to the blocks of the means.
void coarser_means(const Means& means, const BlockGrid& blocks, Means& coarser);

// Downsamples an image (h, w) to the means of the blocks that tile it, as OpenCV's INTER_AREA.
void area_means(const float* image, std::ptrdiff_t height, std::ptrdiff_t width, std::ptrdiff_t rows,
                std::ptrdiff_t columns, float* means);

// Weighted sum of the channels of stored values, by a table per channel.
template <class T>
void stored_luminance(const Stored<T>& image, const std::array<Floats, 3>& tables, float* luminance);

// Whether the three channels of each pixel are equal.
template <class T>
bool has_equal_channels(const Stored<T>& image);

// Samples channels (h, w, c + 1) bilinearly at points (x, y): values (n, c), and 1 where all four pixels around a point
// are inside and usable, else 0. The last channel is the weight of the pixel.
void sample_channels(MatrixView<const float> pixels, std::ptrdiff_t width, MatrixView<const double> points, float* values,
                     float* usable);

}  // namespace liaam
