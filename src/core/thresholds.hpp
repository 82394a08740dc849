// Every threshold at which the loop of a level stops, accepts or refuses, with its reason. The table of
// liaam.fitting.thresholds is the same; a test compares them. Measurements are in experiments/notes/engine.md.
#pragma once

namespace liaam::thresholds {

constexpr double kDampingLimit = 1e7;      // the loop gives up
constexpr double kTrustedDamping = 1e-2;   // most damping at which a small step means convergence, not damping
constexpr double kLeastDamping = 1e-7;     // after accepted steps with the image's gradient
constexpr double kFirstDamping = 1e-3;     // after the first refused step
constexpr double kFirstExpectedDamping = 1.0;  // the same with the expected gradient, relative to that curvature
constexpr double kRise = 1.0 + 1e-6;       // largest ratio of an accepted cost to the lowest: rounding
constexpr double kExpectedRise = 1.25;     // the zero of the expected gradient is not the cost's minimum
constexpr double kStill = 0.2;             // step in model pixels below which weights by rows are kept
constexpr double kLongestUnseen = 1.0;     // longest step in model pixels accepted as shorter than its deviation
constexpr double kMostNegligibleDamping = 0.1;  // most damping at which a step counts as shorter than its deviation
constexpr int kRounds = 3;                 // alternations of robust weights and lambda: outliers and lambda interact

constexpr int kScoringSteps = 10;          // most steps with the expected gradient at the end of a level
constexpr double kScoringRise = 1.25;      // largest ratio of the cost after these steps to that before, as kExpectedRise
constexpr double kEarlyExpected = 0.25;    // tolerance of the first steps, as a fraction of the blur, with the expected
constexpr int kEarlyExpectedSteps = 3;     // gradient, and the number of these steps
constexpr double kEarlyOwn = 0.1;          // the same with the image's own gradient, which converges slowly
constexpr int kEarlyOwnSteps = 10;
constexpr double kEarlyScored = 0.4;       // the same at the finest level if steps with the expected gradient follow
constexpr double kCoarse = 10.0;           // factor on the tolerance at all levels but the finest: they only start it
constexpr double kCoarseRelative = 1.5;    // factor on the relative tolerance there; 3 loses distant starts

constexpr double kLeastGrowth = 1.0 / 3.0;  // change of size beyond which a fit has diverged
constexpr double kMostGrowth = 3.0;
constexpr double kLeastCurvature = 0.5;    // lower bound on the curvature of steps with the expected gradient, as a fraction
                                           // of the expected curvature: far from the solution, undamped steps diverge

constexpr double kTexture = 1e-10;         // curvature per unit of weight below which there is no texture
constexpr double kDampingFloor = 1e-9;     // least curvature that damping is relative to, as a fraction of the largest
constexpr double kRounding = 1e-7;         // ridge on the expected curvature: the error of single precision
constexpr double kLeastPrecision = 1e-9;   // least precision of a parameter, as a fraction of the largest
constexpr double kToAndFro = 0.5;          // largest fraction of the last step that a step may undo
constexpr double kObservableApart = 2.0;   // as `observable`, for the image's angle relative to the model's: the
                                           // object's colours determine it even without a change of light
constexpr double kLeastAngleNoise = 1e-12;  // least noise of an angle's curvature, per unit of weight: rounding

constexpr double kAlike = 0.2;     // change of the logarithm of a variance below which weights by rows are kept
constexpr double kChanged = 0.02;  // share of the pixels that may become usable or cease to be, likewise

}  // namespace liaam::thresholds
