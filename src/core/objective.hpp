// One level of a fit: the model's side of the residual, the method, the encoded image, and the unknowns.
//
// Sizes: n pixels of the model, k rows of the metric P, m appearance modes (extra modes last), n_p parameters of the
// warp, n_free free angles, q = (p, free angles). Arrays of pixels are flat: residual e = i k + r is row r of pixel i.
#pragma once

#include <array>
#include <vector>

#include "encoding.hpp"
#include "linear.hpp"
#include "mesh.hpp"
#include "modes.hpp"

namespace liaam {

// The mean appearance A_0 and the modes A_i (eq 4), projected by P(theta_1), at a number of residuals.
struct MeanAndModes {
    MatrixView<const float> mean;  // (1, n k), or (3, n k) where theta_1 is free: constant, cos and sin part
    Modes modes;
};

// The model's side of the residual of eq 10, at one level.
struct Model {
    Mesh mesh;
    MeanAndModes appearance;        // at the training camera's angle, or at any
    MeanAndModes gradients;         // spatial gradients of the same, (2 n k): per pixel k by x, then k by y
    Floats sqrt_weights;            // (n k): of the model's weights
    MatrixView<const double> gram;  // (m, m): A'A under these weights
    Doubles ridge;                  // (m): precision of lambda, in units of squared residuals
    Doubles errors;                 // (n): variance of the model's errors, mean over the rows
    Doubles prior;                  // (n_p): precision of a Gaussian prior on p; 0 for none
    double correlated = 1.0;        // pixels per independent residual
    double dof = 0.0;               // freedom of the prior's scale; infinite if fixed
    bool colours = true;            // the model was trained on colour images

    bool theta_1_is_free() const { return appearance.mean.n_rows == 3; }
};

enum class Weighting { model, noise, rows };
enum class Loss { none, huber, l1, cauchy, geman_mcclure, tukey, learnt };  // none, then liaam.fitting.methods.LOSSES
constexpr Loss kLastLoss = Loss::learnt;
enum class StepKind { own, scored, expected };  // gradient of the steps: the image's, first that one, the model's

// A row of the table of methods.
struct Method {
    std::array<Floats, 3> metric;         // P(theta) = metric[0] + cos(theta) metric[1] + sin(theta) metric[2], (k, 8) each
    MatrixView<const double> directions;  // (2, n_free): derivatives of (theta_1, theta_2) by the free angles
    Weighting weighting = Weighting::model;
    Loss loss = Loss::none;
    double gaussian_median = 1.0;     // median magnitude of a Gaussian residual, in standard deviations
    StepKind step = StepKind::own;

    std::size_t n_free() const { return directions.n_columns; }
    bool reweighs() const { return weighting != Weighting::model || loss != Loss::none; }
};

struct Objective {
    Model model;
    Method method;

    std::size_t n() const { return model.mesh.n_pixels(); }
    std::size_t k() const { return method.metric[0].size() / kChannels; }
    std::size_t m() const { return model.ridge.size(); }
    std::size_t n_p() const { return model.prior.size(); }
    std::size_t n_q() const { return n_p() + method.n_free(); }
    std::size_t width() const { return model.appearance.modes.width(); }  // m, padded
};

// An encoded image, and the map from model pixels to its pixels.
struct EncodedImage {
    Floats pixels;  // (h, w, 8)
    int height = 0, width = 0;
    Similarity from_model;
    Floats log_noise;                          // standard deviation of the logarithm, at evenly spaced logarithms
    double first_log = 0.0, last_log = 1.0;    // the lowest and the highest of these
    double value_noise_gain = 1.0;             // of the blur: share of that deviation that it leaves in values
    double slope_noise_gain = 1.0;             // the same in gradients
    double correlated = 1.0;                   // sampled pixels per independent residual, for weights by rows
    EncodingConstants constants{};             // with which it was encoded
    MatrixView<const double> point_precision;  // (n_p, n_p): of p by the points of another landmarker, or empty
    Doubles points;                            // (n_p): p of these points
};

// The unknowns.
struct State {
    std::vector<double> p;
    std::array<double, 2> angles{0.0, 0.0};  // theta_1 (model) and theta_2 (image), radians
    std::vector<double> lam;                 // lambda
};

}  // namespace liaam
