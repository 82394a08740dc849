#include "encoding.hpp"

#include <cmath>

#include "eight.hpp"
#include "elementary.hpp"

namespace liaam {

namespace {

constexpr double kReach = 3.0;  // standard deviations at which a Gaussian is truncated

// Planes (h, w) before they are blurred and interleaved.
struct Planes {
    std::ptrdiff_t height, width;
    std::vector<float>& numbers;  // see EncodingRoom
    bool weighs_brightness = false, weighs_colours = false;  // in the blur, by the weights of the pixels

    Planes(const Means& means, std::vector<float>& room) : height(means.rows), width(means.columns), numbers(room) {
        numbers.resize(6 * height * width);
    }
    float* plane(std::size_t i) { return numbers.data() + i * height * width; }
    const float* plane(std::size_t i) const { return numbers.data() + i * height * width; }
};

constexpr std::size_t kBright = 0, kRed = 1, kKnown = 4, kUsable = 5;

// Logarithms of brightness (for gradients) and of colours (eq 6).
Planes log_planes(const Means& means, const EncodingOptions& options, const EncodingConstants& constants,
                  std::vector<float>& room) {
    Planes planes(means, room);
    const std::ptrdiff_t n = means.rows * means.columns;
    const float red = constants.brightness[0], green = constants.brightness[1], blue = constants.brightness[2];
    float *bright = planes.plane(kBright), *known = planes.plane(kKnown), *usable = planes.plane(kUsable);
    const float* light = means.light.data();
    const float least = means.grey ? 2.0f : constants.all, floor = constants.log_floor;  // grey: no invariant
    float n_known = 0.0f;
#pragma omp simd reduction(+ : n_known)
    for (std::ptrdiff_t i = 0; i < n; ++i) {
        bright[i] = log_of(red * light[4 * i] + green * light[4 * i + 1] + blue * light[4 * i + 2] + floor);
        known[i] = light[4 * i + 3] > least ? 1.0f : 0.0f;
        n_known += known[i];
        usable[i] = 1.0f;
    }
    for (std::size_t c = 0; c < 3; ++c) {
        float* colour = planes.plane(kRed + c);
        const float darkest = options.floor;
#pragma omp simd
        for (std::ptrdiff_t i = 0; i < n; ++i) {
            const float own = light[4 * i + c];
            colour[i] = log_of(own > darkest ? own : darkest);
        }
    }
    planes.weighs_colours = n_known < static_cast<float>(n);
    if (means.finite.empty()) return planes;
    for (std::ptrdiff_t i = 0; i < n; ++i) usable[i] = means.finite[i] > constants.all ? 1.0f : 0.0f;
    planes.weighs_brightness = planes.weighs_colours = true;
    return planes;
}

// sRGB-encoded values, and for `orientation` their luminance.
Planes value_planes(const Means& means, const EncodingOptions& options, const EncodingConstants& constants,
                    std::vector<float>& room) {
    Planes planes(means, room);
    const std::ptrdiff_t n = means.rows * means.columns;
    const bool oriented = options.encoding == Encoding::orientation;
    float *known = planes.plane(kKnown), *usable = planes.plane(kUsable), *bright = planes.plane(kBright);
    const float* light = means.light.data();
    bool every = true;
    for (std::ptrdiff_t i = 0; i < n; ++i) {
        usable[i] = light[4 * i + 3] > constants.all ? 1.0f : 0.0f;
        known[i] = oriented ? 0.0f : usable[i];
        every = every && usable[i] > 0.0f;
    }
    std::fill(bright, bright + n, 0.0f);
    for (std::size_t c = 0; c < 3; ++c) {
        float* colour = planes.plane(kRed + c);
        const float weight = constants.luminance[c];
        srgb_encode(light + c, 4, static_cast<std::size_t>(n), colour);
#pragma omp simd
        for (std::ptrdiff_t i = 0; i < n; ++i) bright[i] += weight * colour[i];
        if (oriented) std::fill(colour, colour + n, 0.0f);
    }
    planes.weighs_brightness = oriented && !every;
    planes.weighs_colours = !oriented && !every;
    return planes;
}

void multiply(float* plane, const float* weights, float more, std::ptrdiff_t n) {
#pragma omp simd
    for (std::ptrdiff_t i = 0; i < n; ++i) plane[i] *= weights[i] + more;
}

void divide(float* line, const float* weights, float more, std::ptrdiff_t n) {
#pragma omp simd
    for (std::ptrdiff_t i = 0; i < n; ++i) line[i] /= weights[i] + more;
}

// Blurs the planes row by row, and interleaves them to channels. In the blur, pixels count by their weights plus a
// little, so that what is unusable hardly spreads.
class Layout {
  public:
    Layout(Planes& planes, const EncodingOptions& options, const EncodingConstants& constants, double softness,
           EncodingRoom& room)
        : planes_(planes), options_(options), constants_(constants), softness_(static_cast<float>(softness)),
          taps_(gaussian_taps(options.blur)), room_(room),
          soft_(options.encoding == Encoding::soft || options.encoding == Encoding::orientation) {
        if (options.blur <= 0.0) planes.weighs_brightness = planes.weighs_colours = false;
        room.lines.assign(kChannels * planes.width, 0.0f);
        room.weights.resize(planes.width);
    }

    void write(Channels& channels) {
        const auto n = planes_.height * planes_.width;
        if (soft_ && planes_.weighs_brightness) multiply(planes_.plane(kBright), planes_.plane(kUsable), more(), n);
        if (planes_.weighs_colours)
            for (std::size_t c = 0; c < 3; ++c) multiply(planes_.plane(kRed + c), planes_.plane(kKnown), more(), n);
        if (soft_) blur_brightness();
        channels.height = planes_.height;
        channels.width = planes_.width;
        channels.pixels.resize(kChannels * n);
        for (std::ptrdiff_t y = 0; y < planes_.height; ++y) {
            make_lines(y);
            interleave(channels.pixels.data() + kChannels * y * planes_.width);
        }
    }

  private:
    float more() const { return constants_.unusable; }
    float* line(std::size_t i) { return room_.lines.data() + i * planes_.width; }

    void blur(std::size_t plane, std::ptrdiff_t y, float* out) {
        blur_row(planes_.plane(plane), planes_.height, planes_.width, y, taps_, room_.line, out);
    }

    void blur_brightness() {
        room_.bright.resize(planes_.height * planes_.width);
        for (std::ptrdiff_t y = 0; y < planes_.height; ++y) {
            float* own = room_.bright.data() + y * planes_.width;
            blur(kBright, y, own);
            if (!planes_.weighs_brightness) continue;
            blur(kUsable, y, room_.weights.data());
            divide(own, room_.weights.data(), more(), planes_.width);
        }
    }

    // The channels of a row: directions first if there are any, then colours and their weight, and the pixel's weight.
    void make_lines(std::ptrdiff_t y) {
        const auto width = planes_.width;
        const std::size_t colours = soft_ ? 2 : 0;
        const float* known = planes_.plane(kKnown) + y * width;
        for (std::size_t c = 0; c < 3; ++c) blur(kRed + c, y, line(colours + c));
        if (planes_.weighs_colours) {
            blur(kKnown, y, room_.weights.data());
            for (std::size_t c = 0; c < 3; ++c) divide(line(colours + c), room_.weights.data(), more(), width);
        }
        if (soft_) {
            soft_directions_row(room_.bright.data(), planes_.height, width, y, options_.turn, softness_, line(0), line(1));
            std::copy(known, known + width, line(5));
        }
        const float* usable = planes_.plane(soft_ ? kUsable : kKnown) + y * width;
        std::copy(usable, usable + width, line(7));
    }

    void interleave(float* pixels) {
        const auto width = planes_.width;
        const float* lines = room_.lines.data();
        std::ptrdiff_t x = 0;
        for (; x + static_cast<std::ptrdiff_t>(kEight) <= width; x += kEight)
            transpose(lines + x, static_cast<std::size_t>(width), pixels + kChannels * x);
        for (; x < width; ++x)
            for (std::size_t c = 0; c < kChannels; ++c) pixels[kChannels * x + c] = lines[c * width + x];
    }

    Planes& planes_;
    const EncodingOptions& options_;
    const EncodingConstants& constants_;
    float softness_;
    std::vector<float> taps_;
    EncodingRoom& room_;
    bool soft_;
};

}  // namespace

std::vector<float> blurred_logs(const float* brightness, const float* finite, std::ptrdiff_t height, std::ptrdiff_t width,
                                double blur, const EncodingConstants& constants) {
    const std::ptrdiff_t n = height * width;
    const bool weighs = finite != nullptr && blur > 0.0;
    const float more = constants.unusable, floor = constants.log_floor;
    std::vector<float> logs(n), blurred(n), usable(weighs ? n : 0), weights(weighs ? width : 0), line;
#pragma omp simd
    for (std::ptrdiff_t i = 0; i < n; ++i) logs[i] = log_of(brightness[i] + floor);
    if (weighs) {
        for (std::ptrdiff_t i = 0; i < n; ++i) usable[i] = finite[i] > constants.all ? 1.0f : 0.0f;
        multiply(logs.data(), usable.data(), more, n);
    }
    const std::vector<float> taps = gaussian_taps(blur);
    for (std::ptrdiff_t y = 0; y < height; ++y) {
        float* own = blurred.data() + y * width;
        blur_row(logs.data(), height, width, y, taps, line, own);
        if (!weighs) continue;
        blur_row(usable.data(), height, width, y, taps, line, weights.data());
        divide(own, weights.data(), more, width);
    }
    return blurred;
}

std::vector<float> gaussian_taps(double sigma) {
    const auto reach = static_cast<std::size_t>(std::ceil(kReach * sigma));
    std::vector<double> taps(reach + 1);
    double total = -1.0;
    for (std::size_t k = 0; k <= reach; ++k) {
        taps[k] = std::exp(-0.5 * std::pow(k / std::max(sigma, 1e-9), 2));
        total += 2.0 * taps[k];
    }
    std::vector<float> normalised(reach + 1);
    for (std::size_t k = 0; k <= reach; ++k) normalised[k] = static_cast<float>(taps[k] / total);
    return normalised;
}

void blur_row(const float* plane, std::ptrdiff_t height, std::ptrdiff_t width, std::ptrdiff_t y,
              const std::vector<float>& taps, std::vector<float>& line, float* out) {
    const auto reach = static_cast<std::ptrdiff_t>(taps.size()) - 1;
    const float* own = plane + y * width;
    line.resize(width + 2 * reach);
    float* middle = line.data() + reach;
    const float centre = taps[0];
#pragma omp simd
    for (std::ptrdiff_t x = 0; x < width; ++x) middle[x] = centre * own[x];
    for (std::ptrdiff_t k = 1; k <= reach; ++k) {
        const float* up = plane + std::max<std::ptrdiff_t>(y - k, 0) * width;
        const float* down = plane + std::min(y + k, height - 1) * width;
        const float tap = taps[k];
#pragma omp simd
        for (std::ptrdiff_t x = 0; x < width; ++x) middle[x] += tap * (up[x] + down[x]);
    }
    std::fill(line.data(), middle, middle[0]);
    std::fill(middle + width, middle + width + reach, middle[width - 1]);
#pragma omp simd
    for (std::ptrdiff_t x = 0; x < width; ++x) out[x] = centre * middle[x];
    for (std::ptrdiff_t k = 1; k <= reach; ++k) {
        const float tap = taps[k];
#pragma omp simd
        for (std::ptrdiff_t x = 0; x < width; ++x) out[x] += tap * (middle[x - k] + middle[x + k]);
    }
}

void soft_directions_row(const float* plane, std::ptrdiff_t height, std::ptrdiff_t width, std::ptrdiff_t y,
                         const std::array<float, 4>& turn, float softness, float* across, float* down) {
    const float* own = plane + y * width;
    const float *above = y > 0 ? own - width : own, *below = y < height - 1 ? own + width : own;
    const float half = 0 < y && y < height - 1 ? 0.5f : 1.0f, square = softness * softness;
    const std::ptrdiff_t right = width - 1;
    for (std::ptrdiff_t x = 1; x < right; ++x) across[x] = 0.5f * (own[x + 1] - own[x - 1]);
    across[0] = own[std::min<std::ptrdiff_t>(1, right)] - own[0];
    across[right] = own[right] - own[std::max<std::ptrdiff_t>(right - 1, 0)];
    const float xx = turn[0], xy = turn[1], yx = turn[2], yy = turn[3];
#pragma omp simd
    for (std::ptrdiff_t x = 0; x < width; ++x) {
        const float gx = across[x], gy = half * (below[x] - above[x]);
        const float tx = xx * gx + xy * gy, ty = yx * gx + yy * gy;
        const float scale = 1.0f / std::sqrt(tx * tx + ty * ty + square);
        across[x] = tx * scale;
        down[x] = ty * scale;
    }
}

void encode(const Means& means, const EncodingOptions& options, const EncodingConstants& constants, Channels& channels) {
    const bool logarithmic = options.encoding == Encoding::log || options.encoding == Encoding::soft;
    std::vector<float>& room = channels.room.planes;
    Planes planes = logarithmic ? log_planes(means, options, constants, room) : value_planes(means, options, constants, room);
    const double softness = options.encoding == Encoding::soft ? constants.softness * options.pixel : constants.flat;
    Layout(planes, options, constants, softness, channels.room).write(channels);
}

}  // namespace liaam
