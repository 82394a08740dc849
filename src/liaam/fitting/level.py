"""Inputs and outputs of a level's loop: named tuples of arrays that compiled code reads by field name
(:mod:`liaam.kernels.compiled`).

Sizes: n pixels of the model, k rows of the metric P, n_p parameters of the warp, n_q = n_p + the number of free angles,
m appearance modes (extra modes, such as gain and bias, last). A pixel of an encoded image has 8 channels, the last its
weight. Arrays of pixels are flat: residual e = i k + r is row r of pixel i.
"""

from collections.abc import Callable
from typing import Annotated, Any, NamedTuple

from liaam.kernels.fields import Bool1, Double1, Double2, Double3, Int1, Single1, Single2, Single3
from liaam.model.warp import Mesh

WIDE = 8
"""Vector width of compiled loops (:data:`liaam.kernels.vectors.SIZE`), and number of channels of an encoded image."""

BLOCK = 2048
"""Number of residuals whose products are summed in float32 before they are added in float64."""

PLANE = 512
"""Number of pixels whose variances are computed together, channel by channel."""

ROTATIONS = 3
"""Room for rotations (:func:`liaam.fitting.equations.diagonalise`), as a multiple of n_q^2. About n_q^2 are used."""

RIDGE = 1e-6
"""Ridge on A'A relative to the mode's squared norm before projection by the metric. It keeps modes that the metric
cannot observe, such as pure shading under L(theta), at the mean; otherwise rounding errors determine them."""

GRADIENTS, COLOUR = 0, 1
"""Groups of rows that share one unexplained variance: the first two rows, and the others."""

CORRELATED = (8.0, 30.0)
"""Factors on the number of correlated pixels, for the model's errors in gradients and in colour. Model errors are
patches rather than grains, and widest in colour."""

LEAST_CURVATURE = 0.5
"""Lower bound on the curvature in a step with the expected gradient, as a fraction of the expected curvature. Far from
the solution the gradients of image and model agree less, and undamped steps would diverge. Measured on unseen persons
of IMM: without it a third more fits end beyond 8 %; 1 is Fisher scoring, which takes twice as many steps."""


UNIT, GAIN, OFFSET, SHOWN, SCALE, LEAST, PULL = 0, 1, 2, 3, 4, 5, 6
"""Indices into :attr:`Work.scales`."""


def without(*_: Any) -> Any:
    """Fill the field of a function that a method does not use; compiled code stores no address for it."""
    raise NotImplementedError


class Template(NamedTuple):
    """The model's side of the residual (paper eq 9)."""

    warp: Annotated[Any, Mesh]
    """The mesh; for the reference kernel any :class:`liaam.model.warp.Warp`."""
    rows: Single2
    """(1 + m, n k) float32: P(theta_1) A0 and P(theta_1) A_i."""
    lines: Single1
    """(n k w,) float32: the transposed modes, padded with zeros to w, a multiple of 8."""
    slopes: Single2
    """(1 + m, 2 n k) float32: spatial gradients of mean and modes in the reference frame; per pixel k by x, k by y."""
    parts: Single3
    """(3, 1 + m, n k) float32: constant, cos(theta_1) and sin(theta_1) parts of ``rows``; empty if theta_1 is fixed."""
    slope_parts: Single3
    """(3, 1 + m, 2 n k) float32: the same for ``slopes``."""
    own: Single1
    """(n k,) float32: square root of the model's weights."""
    gram: Double2
    """(m, m) float64: A'A under these weights."""
    ridge: Double1
    """(m,) float64: added to the diagonal of A'A: :data:`RIDGE` plus the precision of a Gaussian prior on lambda, in
    units of squared residuals."""
    errors: Double1
    """(n,) float64: variance of the model's errors, mean over the rows; 0 if unknown."""
    prior: Double1
    """(n_p,) float64: precision of a Gaussian prior on p; 0 for none."""
    correlated: float
    """Number of pixels per independent residual, for weights that do not account for correlation."""
    freedom: float
    """Degrees of freedom of the prior's scale (:func:`liaam.fitting.steps.next_scale`); infinite for a scale of 1."""
    colours: bool
    """Whether the model was trained on colour images."""


class Picture(NamedTuple):
    """An encoded image, and the map from model pixels to its pixels."""

    pixels: Single1
    """(8 h w,) float32."""
    height: int
    width: int
    similarity: Double2
    """(2, 3) float64: model pixels to image pixels."""
    noise: Single1
    """(s,) float32: standard deviation of the logarithm due to noise, at evenly spaced logarithms."""
    span: Double1
    """(2,) float64: the lowest and the highest of these logarithms."""
    kept: Double1
    """(2,) float64: fraction of that deviation left after the blur, in values and in gradients per model pixel."""
    correlated: float
    """Number of sampled pixels per independent residual, for weights by rows."""
    pull: Double2
    """(n_p, n_p) float64: precision of p by the points of another landmarker; (0, 0) for none."""
    towards: Double1
    """(n_p,) float64: p of these points."""


class Row(NamedTuple):
    """A method (:class:`liaam.fitting.Method`) as the compiled loop needs it: arrays, numbers and functions."""

    metric: Single2
    """(3, 8 k) float32: P(theta) = metric[0] + cos(theta) metric[1] + sin(theta) metric[2]."""
    directions: Double2
    """(2, n_free) float64: derivatives of (theta_1, theta_2) by the free angles."""
    weights: int
    """0 for the model's, 1 for noise, 2 for weights by rows (noise and unexplained variance)."""
    loss: int
    """Index of the robust loss in :data:`liaam.fitting.losses.LOSSES`; -1 for none."""
    median: float
    """Median magnitude of a Gaussian residual (root mean square over the rows), in standard deviations."""
    normalise: bool
    """Bring samples to the mean and standard deviation of the mean appearance."""
    evaluate_residual: Callable[["Template", Picture, "Row", "Work", bool], None]
    """This and the functions below are those of :mod:`liaam.fitting.evaluate`, ``weights`` and ``steps``;
    :func:`without` if not used."""
    turn: Callable[["Template", "Work"], None]
    weigh: Callable[["Template", Picture, "Row", "Work"], bool]
    weigh_by_loss: Callable[["Template", "Row", "Work"], None]
    solve_lambda: Callable[["Template", "Row", "Work", bool, bool], None]
    normalise_samples: Callable[["Work"], None]
    whiten: Callable[["Work"], None]
    expect: Callable[["Template", "Work"], None]
    differentiate: Callable[["Template", "Row", "Work", Single1, Single1], None]
    add_angles: Callable[["Template", "Row", "Work"], None]
    damped: Callable[["Work", float], bool]
    raised: Callable[["Work", float], bool]


class Controls(NamedTuple):
    """The options of :class:`liaam.fitting.SolverOptions` for one level's loop."""

    max_iterations: int
    tolerance: float
    early_tolerance: float
    """Larger tolerance for the first ``early_steps`` steps: a fit that gets so near so soon is not a difficult one."""
    early_steps: int
    relative_tolerance: float
    damping: float
    shape_prior: float
    observable: float
    joint: bool
    """Update lambda by its part of the joint step (eq 5); else solve for it at every state."""
    expected: bool
    """Take steps with the expected gradient; else with the image's own."""
    reweigh: bool
    """Update the weights between steps."""
    solve: bool
    """Solve for lambda at the first state; else keep it."""
    evaluate_last: bool
    """Evaluate the residual once more after a last step that is too short to matter."""


class Work(NamedTuple):
    """State of a fit, its residual, weights and derivatives there, and scratch arrays: all that the loop writes."""

    p: Double1
    """(n_p,) float64: parameters of the warp."""
    angles: Double1
    """(2,) float64: theta_1 (model) and theta_2 (image), radians."""
    lam: Double1
    """(m,) float64: lambda, coordinates of the appearance, extra modes last."""
    before: Double1
    """(n_p + 2 + m,) float64: p, angles and lambda before the last step."""
    metric: Single1
    """(8 k,) float32: P(theta_2)."""
    slope: Single1
    """(8 k,) float32: dP/dtheta_2."""
    rows: Single2
    """This, ``lines`` and ``slopes``: the template's at the current theta_1 (the same arrays if theta_1 is fixed)."""
    lines: Single1
    slopes: Single2
    points: Double2
    """(v, 2) float64: vertices of the mesh, model pixels."""
    corner: Int1
    """(n,) int32: this and the next are outputs of :func:`liaam.fitting.residual.place`."""
    between: Single1
    """(3 n,) float32."""
    values: Single1
    """(8 n,) float32: samples of the image's channels."""
    residual: Single1
    """(n k,) float32."""
    image_slopes: Single1
    """(2 n k,) float32: spatial gradient of the residual, model pixels."""
    usable: Single1
    """(n,) float32: the image's weight, 0 or 1."""
    weighed: Single1
    """(n k,) float32: square root of the weights without noise weights, which depend on theta_2."""
    own: Single1
    """(n k,) float32: square root of the weights, before unusable pixels are set to 0."""
    own_derivative: Single1
    """(n k,) float32: relative derivative of ``own`` by theta_2; empty if it does not depend on theta_2."""
    root: Single1
    """(n k,) float32: square root of the weights, 0 at unusable pixels."""
    noise: Single1
    """(8 n,) float32: variance of the channels due to noise, for noise weights."""
    by_model: Double1
    """(n,) float64: variance due to the model's errors, for noise weights."""
    variance: Single1
    """(n k,) float32: variance of the residuals, for weights that use it."""
    known: Single1
    """(n,) float32: 1 where colours were usable when weights by rows were last computed, else 0; NaN before."""
    known_now: Single1
    """(n,) float32: the same at the current state."""
    unexplained: Double2
    """(2, 2) float64: unexplained variance of gradients and colour, when weights were last computed and now."""
    scales: Double1
    """(7,) float64: variance at weight 1 (NaN if the weights define none), gain and offset of the samples, gain in
    ``image_slopes``, scale of the prior, lower bound on the curvature (:data:`LEAST_CURVATURE`), and the factor that
    converts ``Picture.pull`` to units of squared residuals."""
    gram: Double2
    """(m, m) float64: A'A under ``own``."""
    factor: Double2
    """(m, m) float64: Cholesky factor of A'A under ``root``, with a ridge."""
    ar: Double1
    """(m,) float64: A'r - ridge * lambda."""
    sums: Double1
    """(2,) float64: r'r and the sum of the weights."""
    expected: Single1
    """(2 n k,) float32: expected spatial gradient of the residual, model pixels."""
    appearance_slopes: Single1
    """(2 n k,) float32: spatial gradient of the fitted appearance, in the reference frame."""
    columns: Single2
    """(n_free, n k) float32: derivatives by the free angles."""
    aj: Double2
    """(m, n_q) float64: A'J."""
    hessian: Double2
    """(n_q, n_q) float64: E'QJ, with E the expected derivatives or J."""
    gradient: Double1
    """(n_q,) float64: E'Qr."""
    base: Double2
    """(n_q, n_q) float64: expected curvature, E'QE."""
    step: Double1
    """(n_q,) float64."""
    last_step: Double1
    """(n_q,) float64: the last accepted step; zero before."""
    lam_step: Double1
    """(m,) float64."""
    free: Bool1
    """(n_q,) bool: entries of q that may move."""
    precision: Double1
    """(n_p,) float64: precision of the prior on p, in units of squared residuals."""
    fours: Single1
    """(4 n k + 8,) float32: this and the arrays below down to ``along``, but for ``damper``, are scratch."""
    room: Single1
    """(48,) float32."""
    squares: Double2
    """(2 v, w + 8) float64, with w columns in the mesh's basis."""
    products: Double2
    """(2 v, w) float64."""
    carried_squares: Double2
    """(n_p, w + 8) float64."""
    carried_products: Double2
    """(n_p, w) float64."""
    line: Single1
    """(2048,) float32."""
    block: Single2
    """(m, 2048) float32."""
    planes: Single2
    """(10, 512) float32."""
    sizes: Double2
    """(2, n) float64."""
    row_sums: Double2
    """(k, 3) float64."""
    damper: Double2
    """(n_q, n_q) float64: ``base`` plus the prior; damping is relative to it."""
    small: Double3
    """(2, n_q, n_q) float64."""
    spectrum: Double2
    """(4, n_q) float64; see :func:`liaam.fitting.equations.tridiagonalise`."""
    rotations: Double2
    """(3 n_q^2, 3) float64."""
    eliminated: Double2
    """(m, n_q) float64."""
    along: Double2
    """(m, 1) float64."""
    costs: Double1
    """(i + 1,) float64: mean squared residual at the start and after every accepted step."""
    path: Double2
    """(i + 1, n_p) float64: p there."""
    turns: Double2
    """(i + 1, 2) float64: the angles there."""
    outcome: Double1
    """(6,) float64: the numbers of :class:`Outcome`."""


class Outcome(NamedTuple):
    """How a level's loop ended; the solution is in :class:`Work`."""

    n_taken: int
    """Accepted steps."""
    n_tried: int
    """Accepted and refused steps."""
    moved: float
    """Root mean square movement of the landmarks by the last accepted step, model pixels."""
    converged: bool
    """The loop converged: the last step was too small to matter."""
    held: bool
    """An angle, or the common turn of both, was unobservable at the end and kept fixed."""
    flat: bool
    """The image has no texture to descend on."""
