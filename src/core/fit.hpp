// A whole fit: the levels from coarse to fine, each from the solution of the one before.
#pragma once

#include <vector>

#include "level.hpp"

namespace liaam {

// The linear image: stored integers with a table of light, or light itself.
struct Picture {
    std::ptrdiff_t height = 0, width = 0;
    const Stored<std::uint8_t>* bytes = nullptr;
    const Stored<std::uint16_t>* words = nullptr;
    LightTable table;
    const float* light = nullptr;   // (h, w, 4): R, G, B and 1 where usable, of floats
    const float* finite = nullptr;  // (h, w), or nothing if all are finite
    bool grey = false;
    Encoding encoding = Encoding::soft;
    float floor = 1e-3f;  // lower bound of light in logarithms
};

// The shape model of the landmarks (eq 2).
struct Shapes {
    MatrixView<const double> basis;  // (n_p, 2 n): shape modes, then the four similarity vectors, all orthonormal
    Doubles mean;                    // (2 n)

    std::vector<double> shape(Doubles p) const;                               // s(p), (2 n)
    std::vector<double> parameters(const std::vector<double>& shape) const;  // of the nearest s(p), (n_p)
};

// The similarity (without reflection) that maps a shape to a target in least squares; its inverse; its scale.
Similarity align(Doubles shape, Doubles target);
Similarity inverse(const Similarity& similarity);
double scale_of(const Similarity& similarity);

// A level to fit.
struct LevelSpec {
    const Objective* objective = nullptr;
    double blur = 0.0;     // of the encoded image, model pixels
    double density = 1.0;  // fraction of the frame's pixels that are sampled
    Shapes shapes;         // with the first modes, as many as are seen under the blur
};

// What a fit starts from, and what is known of the image.
struct Target {
    std::vector<double> start;  // (2 n): landmarks, image pixels
    double margin = 0.4;        // around the start, as a fraction of the object's diagonal
    double theta_1 = 0.0;       // the training camera's angle
    double theta_2 = 0.0;       // of the image's camera, where the method does not estimate it
    bool has_invariant = false;  // the metric is L(theta) alone, so that theta_2 and lambda have a joint optimum
    Floats log_noise;            // of one pixel of the image, over the logarithms between these; see EncodedImage
    double first_log = 0.0, last_log = 1.0;
    std::vector<double> points;  // (2 n): landmarks mapped from the points of another landmarker, image pixels; or empty
    MatrixView<const double> point_precision;  // (n_p, n_p): precision of all p by these landmarks, or empty
};

// The solution of a level, the similarity from model pixels to image pixels that it refers to, and its encoded patch.
struct FittedLevel {
    Solution fit;
    Similarity pose;
    Similarity to_patch;  // image pixels to pixels of the patch
    std::ptrdiff_t patch_height = 0, patch_width = 0;
};

// Averages of blocks of an image. Blocks are counted from 0, which begins at the border of the image's first pixel.
struct BlockMeans {
    Means means;
    std::ptrdiff_t first_x = 0, first_y = 0;  // the block of the first mean
    double size = 1.0;                        // side of a block, image pixels
};

// Room for fits, reused by the next.
struct FitRoom {
    LevelRoom level;
    BlockMeans around_start;  // for all levels, as fine as the sharpest needs
    BlockMeans around_shape;  // for one level, and so is what follows
    Channels channels;
    std::vector<float> noise;
    std::vector<double> points;
    Matrix point_precision;
};

// Fits the levels in order; fewer if the fit diverges.
std::vector<FittedLevel> fit_levels(const std::vector<LevelSpec>& levels, const Picture& picture,
                                    const Target& target, const Options& options, const EncodingConstants& constants,
                                    FitRoom& room, const Interrupted& interrupted);

}  // namespace liaam
