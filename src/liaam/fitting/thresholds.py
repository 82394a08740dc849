"""Every threshold at which the loop of a level stops, accepts or refuses, as in the core.

What was measured for them is in experiments/notes/engine.md.
"""

THRESHOLDS: dict[str, float] = {
    "DAMPING_LIMIT": 1e7,  # the loop gives up
    "TRUSTED_DAMPING": 1e-2,  # most damping at which a small step means convergence, not damping
    "LEAST_DAMPING": 1e-7,  # after accepted steps with the image's gradient
    "FIRST_DAMPING": 1e-3,  # after the first refused step
    "FIRST_EXPECTED_DAMPING": 1.0,  # the same with the expected gradient, relative to that curvature
    "RISE": 1.0 + 1e-6,  # largest ratio of an accepted cost to the lowest: rounding
    "EXPECTED_RISE": 1.25,  # the same with the expected gradient, whose zero is not the cost's minimum
    "STILL": 0.2,  # step in model pixels below which weights by rows are kept
    "LONGEST_UNSEEN": 1.0,  # longest step accepted as shorter than its deviation, model pixels
    "MOST_NEGLIGIBLE_DAMPING": 0.1,  # most damping at which a step counts as shorter than its deviation
    "ROUNDS": 3,  # alternations of robust weights and lambda: outliers and lambda interact
    "SCORING_STEPS": 10,  # most steps with the expected gradient at the end of a level
    "SCORING_RISE": 1.25,  # largest ratio of the cost after these steps to that before, as EXPECTED_RISE
    # Tolerance of the first steps, as a fraction of the blur, and the number of these steps: with the expected
    # gradient; with the image's own, which converges slowly; and with that at the finest level if the expected follows.
    "EARLY_EXPECTED": 0.25,
    "EARLY_EXPECTED_STEPS": 3,
    "EARLY_OWN": 0.1,
    "EARLY_OWN_STEPS": 10,
    "EARLY_SCORED": 0.4,
    # Factors on the tolerance and on the relative tolerance at all levels but the finest, which only start that one.
    # With a second factor of 3, distant starts are lost.
    "COARSE": 10.0,
    "COARSE_RELATIVE": 1.5,
    "LEAST_GROWTH": 1.0 / 3.0,  # change of size below which a fit has diverged
    "MOST_GROWTH": 3.0,  # change of size above which it has
    # Least curvature of steps with the expected gradient, as a fraction of the expected curvature: far from the
    # solution, undamped steps diverge.
    "LEAST_CURVATURE": 0.5,
    "TEXTURE": 1e-10,  # curvature per unit of weight below which there is no texture
    "DAMPING_FLOOR": 1e-9,  # least curvature that damping is relative to, as a fraction of the largest
    "ROUNDING": 1e-7,  # ridge on the expected curvature, which single precision may make indefinite
    "LEAST_PRECISION": 1e-9,  # least precision of a parameter, as a fraction of the largest
    "TO_AND_FRO": 0.5,  # largest fraction of the last step that a step may undo before the least curvature is doubled
    # As ``SolverOptions.observable``, for the image's angle relative to the model's. The object's colours determine it
    # even without a change of light.
    "OBSERVABLE_APART": 2.0,
    "LEAST_ANGLE_NOISE": 1e-12,  # least noise of an angle's curvature, per unit of weight: rounding
    # Change of the logarithm of an unexplained variance, and fraction of pixels that become usable or cease to be,
    # below which weights by rows are kept.
    "ALIKE": 0.2,
    "CHANGED": 0.02,
}
"""The thresholds of the core (``src/core/thresholds.hpp``); a test compares them."""
