// One level of a fit: the model's side of the residual, the method, the encoded image, and the arrays that change.
//
// Sizes: n pixels of the model, k rows of the metric P, m appearance modes (extra modes last), n_p parameters of the
// warp, n_free free angles, q = (p, free angles). Arrays of pixels are flat: residual e = i k + r is row r of pixel i.
#pragma once

#include <array>
#include <vector>

#include "encoding.hpp"
#include "linear.hpp"
#include "mesh.hpp"

namespace liaam {

// The model's side of the residual of eq 10, at one level.
struct Model {
    Mesh mesh;
    Rows<const float> rows;                        // (1 + m, n k): P(theta_1) A_0 and P(theta_1) A_i (eq 4)
    Floats lines;                                  // (n k, w): the transposed modes, padded with zeros
    Rows<const float> slopes;                      // (1 + m, 2 n k): their spatial gradients, per pixel k by x, k by y
    std::array<Rows<const float>, 3> row_parts;    // constant, cos and sin parts of rows; empty if theta_1 is fixed
    std::array<Rows<const float>, 3> slope_parts;  // the same of slopes
    Floats sqrt_weights;                           // (n k): of the model's weights
    Rows<const double> gram;                       // (m, m): A'A under these weights
    Doubles ridge;                                 // (m): precision of lambda, in units of squared residuals
    Doubles errors;                                // (n): variance of the model's errors, mean over the rows
    Doubles prior;                                 // (n_p): precision of a Gaussian prior on p; 0 for none
    double correlated = 1.0;                       // pixels per independent residual
    double dof = 0.0;                              // degrees of freedom of the prior's scale; infinite for a fixed scale
    bool colours = true;                           // the model was trained on colour images

    bool theta_1_is_free() const { return !row_parts[0].empty(); }
};

enum class Weighting { model, noise, rows };
enum class Loss { none, huber, l1, cauchy, geman_mcclure, tukey, learnt };
enum class StepKind { own, scored, expected };  // gradient of the steps: the image's, first that one, the model's

// A row of the table of methods.
struct Method {
    std::array<Floats, 3> metric;     // P(theta) = metric[0] + cos(theta) metric[1] + sin(theta) metric[2], (k, 8) each
    Rows<const double> directions;    // (2, n_free): derivatives of (theta_1, theta_2) by the free angles
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
    std::size_t width() const { return n() ? model.lines.size() / (n() * k()) : 0; }  // of the padded lines
};

// An encoded image, and the map from model pixels to its pixels.
struct EncodedImage {
    Floats pixels;  // (h, w, 8)
    int height = 0, width = 0;
    Similarity from_model;
    Floats log_noise;                         // standard deviation of the logarithm, at evenly spaced logarithms
    double first_log = 0.0, last_log = 1.0;   // the lowest and the highest of these
    double value_left = 1.0, slope_left = 1.0;  // share of that deviation after the blur, in values and in gradients
    double correlated = 1.0;                  // sampled pixels per independent residual, for weights by rows
    Rows<const double> point_precision;       // (n_p, n_p): of p by the points of another landmarker, or empty
    Doubles points;                           // (n_p): p of these points
};

// The unknowns.
struct State {
    std::vector<double> p;
    std::array<double, 2> angles{0.0, 0.0};  // theta_1 (model) and theta_2 (image), radians
    std::vector<double> lam;                 // lambda
};

// What the loop carries from one step to the next: a copy undoes a run of the loop.
struct Memory {
    State state;
    std::vector<float> base_sqrt_weights;  // (n k): without noise weights, which depend on theta_2
    std::vector<float> sqrt_weights;       // (n k)
    std::vector<float> channel_noise;      // (n, 8): variance of the channels, for noise weights
    std::vector<float> known_before;       // (n): 1 where colours were usable at the last weights
    std::vector<double> model_variance;    // (n): variance due to the model's errors, for noise weights
    std::array<double, 2> unexplained_before{};  // variance of gradients and colour at the last weights
    double noise_variance = 0.0;           // at weight 1; NaN if the weights define none
    double prior_scale = 1.0;              // scale of the shape prior's variances
    double least_curvature = 0.5;          // lower bound on the curvature, as a fraction of the expected
    double point_variance = 0.0;           // converts the points' precision to units of squared residuals
    std::vector<double> last_step;
    Matrix gram;                           // A'A
};

// State of a fit, its residual, weights and derivatives there, and room: all that the loop writes. Reused by later fits.
struct Workspace : Memory {
    State before;

    // The residual (residual.cpp)
    std::vector<float> metric, metric_slope;  // (k, 8): P(theta_2) and dP/dtheta_2
    Rows<const float> rows, slopes;           // of the model at theta_1
    Floats lines;
    std::vector<float> own_rows, own_lines, own_slopes;  // where theta_1 is free
    std::vector<double> vertices;
    Places places;
    std::vector<float> values;     // (n, 8): samples of the image's channels
    std::vector<float> residual;   // (n k)
    std::vector<float> gradients;  // (2 n k): spatial gradient of the residual by x and y, model pixels
    std::vector<float> usable;     // (n): 0 or 1

    // Weights (weights.cpp)
    std::vector<float> weight_slope;         // (n k) relative derivative by theta_2, or empty
    std::vector<float> masked;               // (n k): sqrt_weights, 0 at unusable pixels
    std::vector<float> variance;             // (n k): of the residuals, for weights that use it
    std::vector<float> known;                // (n): 1 where colours are usable
    std::array<double, 2> unexplained{};     // variance of gradients and colour
    std::vector<double> sizes, sorted;
    std::vector<float> planes;

    // Normal equations (normal_equations.cpp)
    Matrix factor;                  // the Cholesky factor of A'A plus the ridge over the usable pixels
    std::vector<double> ar;         // A'r - ridge lambda
    std::vector<double> lam_step;
    double squares = 0.0, weight = 0.0;  // r'r and the sum of the weights
    std::vector<float> block;

    // Derivatives (derivatives.cpp)
    std::vector<float> appearance_slopes;  // (2 n k): of the fitted appearance, reference frame
    std::vector<float> expected;           // (2 n k): the gradient that the model expects, by x and y
    std::vector<std::vector<float>> columns;  // derivatives by the free angles
    std::vector<float> fours;  // of the pixels of a triangle
    Matrix by_vertex, modes_by_vertex, carried, carried_modes;
    Matrix aj, whitened, product;
    Matrix hessian;           // E'QJ, with E the expected derivatives or J
    Matrix expected_hessian;  // E'QE
    std::vector<double> gradient;  // E'Qr

    // The step (step.cpp)
    Matrix damping_matrix;  // expected_hessian plus the priors
    Matrix small, other;
    std::vector<char> observable;
    std::vector<double> step, prior_precision, along;
    Spectrum spectrum;

    // Sets the arrays to a state and to the model's weights.
    void begin(const Objective& objective, const State& start);
};

}  // namespace liaam
