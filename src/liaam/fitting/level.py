"""What the loop of a level is given and gives back: plain tuples of arrays, so that compiled code reads them
(:mod:`liaam.kernels.compiled`).

n pixels of the model, k rows of the metric P, n_p parameters of the warp, n_q = n_p and the free angles, m modes of
appearance (extra modes, such as gain and bias, last). A pixel of an encoded picture has 8 channels, the last its
weight. Arrays of pixels are flat: residual e = i k + r is row r of pixel i.
"""

from collections.abc import Callable
from typing import Annotated, Any, NamedTuple

from liaam.kernels.fields import Bool1, Double1, Double2, Double3, Int1, Single1, Single2, Single3
from liaam.model.warp import Mesh

WIDE = 8
"""Numbers that compiled loops take at a time (:data:`liaam.kernels.vectors.SIZE`), and channels of a picture."""

BLOCK = 2048
"""Residuals whose products are summed in float32 before they are added up in float64."""

PLANE = 512
"""Pixels whose channels are laid out one after the other while their variances are worked out."""

RIDGE = 1e-6
"""Ridge on A'A as a share of what a mode would add to it if the metric saw all of it. Modes that it cannot see, as of
pure shading by L(theta), stay at their mean; without, they are what rounding makes of them, and a fit's end hangs on
the last bit."""

GRADIENTS, COLOUR = 0, 1
"""Groups of rows whose unexplained part is alike: the first two, and the others."""

CORRELATED = (8.0, 30.0)
"""By how much more the model's errors in gradients, and in colour, are correlated than the blur makes noise: they are
patches, not grains, and those of colour are the widest."""

LEAST_CURVATURE = 0.5
"""Least curvature in a step with the expected gradient, as a share of the expected one: where picture and model are
apart, their gradients agree less, and undamped steps would run off. Measured on strangers of IMM: a third more fits end
beyond 8 % without; 1 would be Fisher scoring, which takes twice as many steps."""


UNIT, GAIN, OFFSET, SHOWN, SCALE, LEAST = 0, 1, 2, 3, 4, 5
"""Places in :attr:`Work.scales`."""


def without(*_: Any) -> Any:
    """Stand for a function that a method does without; compiled code has nothing in its place."""
    raise NotImplementedError


class Template(NamedTuple):
    """What a picture is compared with: the model's side of the residual (paper eq 9)."""

    warp: Annotated[Any, Mesh]
    """The reference kernel takes any :class:`liaam.model.warp.Warp`."""
    rows: Single2
    """(1 + m, n k) float32: P(theta_1) A0 and P(theta_1) A_i."""
    lines: Single1
    """(n k w,) float32: the modes' transpose, with noughts up to w, a multiple of 8."""
    slopes: Single2
    """(1 + m, 2 n k) float32: derivatives of mean and modes by the place at rest; of a pixel k along x, k along y."""
    parts: Single3
    """(3, 1 + m, n k) float32: rows, what is fixed and what goes with cos and sin of theta_1; none where that is
    fixed."""
    slope_parts: Single3
    """(3, 1 + m, 2 n k) float32: the same of the slopes."""
    own: Single1
    """(n k,) float32: root of the model's own weights."""
    gram: Double2
    """(m, m) float64: A'A under these."""
    ridge: Double1
    """(m,) float64: what is added to its diagonal: precision of a Gaussian prior on lambda, in units of squared
    residuals, and enough to hold what the metric cannot see."""
    errors: Double1
    """(n,) float64: variance of the model's errors, mean over the rows; 0 where it is not known."""
    prior: Double1
    """(n_p,) float64: precision of a Gaussian prior on p; 0 for none."""
    correlated: float
    """Pixels that stand for one independent residual, where weights do not say so themselves."""
    freedom: float
    """Degrees of freedom of the prior's scale (:func:`liaam.fitting.steps.next_scale`); infinite where that is 1."""
    colours: bool
    """Whether the model knows colours."""


class Picture(NamedTuple):
    """An encoded picture, and how the model's pixels come to lie in it."""

    pixels: Single1
    """(8 h w,) float32."""
    height: int
    width: int
    similarity: Double2
    """(2, 3) float64: model pixels to those of the patch."""
    noise: Single1
    """(s,) float32: deviation of a logarithm by noise, at evenly spaced logarithms."""
    span: Double1
    """(2,) float64: the lowest and highest of these."""
    kept: Double1
    """(2,) float64: shares of that deviation which the blur leaves to values, and to slopes per model pixel."""
    correlated: float
    """Pixels looked at that stand for one independent residual, for weights that count so."""


class Row(NamedTuple):
    """A method in numbers (:class:`liaam.fitting.Method`)."""

    metric: Single2
    """(3, 8 k) float32: P(theta) = metric[0] + cos(theta) metric[1] + sin(theta) metric[2]."""
    directions: Double2
    """(2, n_free) float64: derivative of (theta_1, theta_2) by the free angles."""
    weights: int
    """0: the model's; 1: by noise; 2: by noise and by what the model leaves unexplained."""
    loss: int
    """Robust loss, -1 for none (:data:`liaam.fitting.losses.LOSSES`)."""
    median: float
    """Median of the size of a Gaussian residual, root mean square over the rows, in standard deviations."""
    normalise: bool
    """Bring samples to the mean and deviation of the model's mean."""
    look: Callable[["Template", Picture, "Row", "Work", bool], None]
    """What the loop calls (:mod:`liaam.fitting.evaluate`); :func:`without` where the method has none."""
    turn: Callable[["Template", "Work"], None]
    weigh: Callable[["Template", Picture, "Row", "Work"], bool]
    weigh_by_loss: Callable[["Template", "Row", "Work"], None]
    settle: Callable[["Template", "Row", "Work", bool, bool], None]
    normalise_samples: Callable[["Row", "Work"], None]
    whiten: Callable[["Work"], None]
    expect: Callable[["Template", "Work"], None]
    differentiate: Callable[["Template", "Row", "Work", Single1, Single1], None]
    add_angles: Callable[["Template", "Row", "Work"], None]
    damped: Callable[["Work", float], bool]
    """:mod:`liaam.fitting.steps`."""
    raised: Callable[["Work", float], bool]


class Controls(NamedTuple):
    """How to iterate: :class:`liaam.fitting.SolverOptions` as a level's loop takes them."""

    max_iterations: int
    tolerance: float
    loose: float
    """Tolerance for the first steps: a fit that is so near after so few of them is an ordinary one."""
    quick: int
    """How many steps these are."""
    notice: float
    damping: float
    shape_prior: float
    observable: float
    joint: bool
    """Lambda moves by its part of the joint step; else it is solved afresh at every state."""
    expected: bool
    """Steps with the model's gradient; else with the picture's."""
    reweigh: bool
    """Weights are worked out anew between steps."""
    solve: bool
    """Lambda is solved for at the start; else it starts as it is."""
    look: bool
    """Look at the picture once more after the last step."""


class Work(NamedTuple):
    """Where a fit stands, what it sees there, and room: all that the loop writes."""

    p: Double1
    """(n_p,) float64: parameters of the warp."""
    angles: Double1
    """(2,) float64: theta_1 (model) and theta_2 (picture), radians."""
    lam: Double1
    """(m,) float64: coordinates of the appearance, extra modes last."""
    before: Double1
    """(n_p + 2 + m,) float64: the same before the last step."""
    metric: Single1
    """(8 k,) float32: P(theta_2)."""
    slope: Single1
    """(8 k,) float32: dP/dtheta_2."""
    rows: Single2
    """The template's at theta_1; its own where theta_1 is fixed."""
    lines: Single1
    slopes: Single2
    points: Double2
    """(v, 2) float64: vertices of the mesh, model pixels."""
    corner: Int1
    """(n,) int32: see :func:`liaam.fitting.residual.place`."""
    between: Single1
    """(3 n,) float32."""
    values: Single1
    """(8 n,) float32: samples of the picture's channels."""
    residual: Single1
    """(n k,) float32."""
    steep: Single1
    """(2 n k,) float32: derivative of the residual by the place, model pixels."""
    usable: Single1
    """(n,) float32: the picture's weight, 0 or 1."""
    weighed: Single1
    """(n k,) float32: root of the weights but for those by noise, which turn with an angle."""
    own: Single1
    """(n k,) float32: root of the weights, wherever the picture is usable."""
    growth: Single1
    """(n k,) float32: its relative derivative by theta_2; none where it does not depend on that."""
    root: Single1
    """(n k,) float32: root of the weights, 0 where the picture says nothing."""
    noise: Single1
    """(8 n,) float32: variance of the channels by noise, of weights by noise."""
    by_model: Double1
    """(n,) float64: variance by the model's errors, of weights by noise."""
    variance: Single1
    """(n k,) float32: of the residuals, where weights go by it."""
    known: Single1
    """(n,) float32: 1 where colours were known when weights by rows were worked out, else 0; NaN before."""
    known_now: Single1
    unexplained: Double2
    """(2, 2) float64: variance that the model leaves unexplained, of gradients and of colour; then and now."""
    scales: Double1
    """(6,) float64: variance that weighs 1 (NaN where weights do not say); gain and offset of the samples; gain that
    ``steep`` has; scale of the prior; and least curvature of a step (:data:`LEAST_CURVATURE`)."""
    gram: Double2
    """(m, m) float64: A'A under ``own``."""
    factor: Double2
    """(m, m) float64: Cholesky factor of A'A under ``root``, with a ridge."""
    ar: Double1
    """(m,) float64: A'r less what the ridge pulls back."""
    sums: Double1
    """(2,) float64: r'r and the sum of the weights."""
    expected: Single1
    """(2 n k,) float32: derivative of the residual by the place as the model expects it."""
    at_rest: Single1
    """(2 n k,) float32: slopes of the fitted appearance."""
    columns: Single2
    """(n_free, n k) float32: derivatives by the free angles."""
    aj: Double2
    """(m, n_q) float64: A'J."""
    hessian: Double2
    """(n_q, n_q) float64: E'QJ, E the derivatives as they are expected, or J."""
    gradient: Double1
    """(n_q,) float64: E'Qr."""
    base: Double2
    """(n_q, n_q) float64: curvature that is expected, E'QE."""
    step: Double1
    """(n_q,) float64."""
    last_step: Double1
    """(n_q,) float64: the last one that was taken; nought before."""
    lam_step: Double1
    """(m,) float64."""
    free: Bool1
    """(n_q,) bool: entries of q that may move."""
    precision: Double1
    """(n_p,) float64: of the prior, in units of squared residuals."""
    fours: Single1
    """(4 n k + 8,) float32: room."""
    room: Single1
    """(48,) float32."""
    squares: Double2
    """(2 v, n_p + 2) float64."""
    products: Double2
    """(2 v, w) float64."""
    carried_squares: Double2
    """(n_p, n_p + 2) float64."""
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
    """(n_q, n_q) float64: ``base`` with the prior, which damping is relative to."""
    small: Double3
    """(2, n_q, n_q) float64."""
    cubes: Double3
    """(3, n_q, n_q) float64."""
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
    """How a level's loop stopped; the rest is in :class:`Work`."""

    n_taken: int
    """Steps accepted."""
    n_tried: int
    """Steps tried."""
    moved: float
    """Root mean square movement of the landmarks by the last accepted step, model pixels."""
    settled: bool
    """The last step was too small to matter."""
    held: bool
    """The angles, or one combination of them, could not be observed at the end."""
    flat: bool
    """There was nothing to descend on."""
