// The encoded level: the channels in which a method compares images (docs/explanation/theory.md, "One objective").
#pragma once

#include <array>
#include <vector>

#include "image.hpp"
#include "mesh.hpp"

namespace liaam {

constexpr std::size_t kChannels = 8;  // of an encoded pixel; the last is its weight

constexpr double kWidestBlur = 1e4;   // standard deviation in pixels, above which a blur is a mistake and takes minutes

enum class Encoding { value, log, orientation, soft };  // in the order of liaam.encoding_constants.ENCODINGS
constexpr Encoding kLastEncoding = Encoding::soft;

// Constants of the encodings. Their values, and the reasons, are in liaam.encoding_constants.
struct EncodingConstants {
    float all;        // fraction of a block's pixels above which the block counts as usable
    float unusable;   // weight of an unusable pixel in a blur
    float log_floor;  // added to brightness before the logarithm
    float softness;   // gradient of log brightness at which the squared length is one half
    float flat;       // the same for `orientation`
    std::array<float, 3> brightness, luminance;  // weights of R, G and B
};

// How to encode means of light: `floor` is the lower bound of linear light in logarithms, `blur` in pixels, `pixel` the
// size of a pixel in pixels of the reference frame, and `turn` the rotation from the image's to the object's axes.
struct EncodingOptions {
    Encoding encoding = Encoding::soft;
    float floor = 1e-3f;
    double blur = 0.0;
    double pixel = 1.0;
    std::array<float, 4> turn{1.0f, 0.0f, 0.0f, 1.0f};
};

// Room for encoding, reused between calls.
struct EncodingRoom {
    std::vector<float> planes;  // (6, h, w): brightness or luminance, colours, weight of the colours, of the pixel
    std::vector<float> bright, lines, weights, line;
};

// The channels of an image: those of the encoding, zeros, and last the weight of the pixel in {0, 1}.
struct Channels {
    std::ptrdiff_t height = 0, width = 0;
    std::vector<float> pixels;  // (h, w, 8)
    EncodingRoom room;
};

void encode(const Means& means, const EncodingOptions& options, const EncodingConstants& constants, Channels& channels);

// Logarithms of brightness (h, w) after a blur, in which pixels count by their `finite` share (h, w) if that is given.
std::vector<float> blurred_logs(const float* brightness, const float* finite, std::ptrdiff_t height, std::ptrdiff_t width,
                                double blur, const EncodingConstants& constants);

// Half of a Gaussian's taps, truncated at three standard deviations.
std::vector<float> gaussian_taps(double sigma);

// Blurs a row of a plane (h, w), first along columns, then along the row; border pixels are replicated. `line` is room.
void blur_row(const float* plane, std::ptrdiff_t height, std::ptrdiff_t width, std::ptrdiff_t y,
              const std::vector<float>& taps, std::vector<float>& line, float* out);

// Softly normalised gradient g / sqrt(|g|^2 + softness^2) along a row of a plane, by differences of neighbours,
// rotated by `turn`.
void soft_directions_row(const float* plane, std::ptrdiff_t height, std::ptrdiff_t width, std::ptrdiff_t y,
                         const std::array<float, 4>& turn, float softness, float* across, float* down);

}  // namespace liaam
