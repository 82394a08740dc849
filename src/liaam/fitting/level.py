"""Inputs and outputs of a level's loop: named tuples of arrays that compiled code reads by field name
(:mod:`liaam.kernels.compiled`).

Sizes: n pixels of the model, k rows of the metric P, v vertices of the mesh, n_p parameters of the warp, n_free free
angles, n_q = n_p + n_free, m appearance modes (extra modes, such as gain and bias, last); w_p and w_m are n_p and m
rounded up to multiples of 8. n_noise, n_turned, n_known and n_expected are n, or 0 for methods without such arrays. A
pixel of an encoded image has 8 channels, the last its weight. Arrays of pixels are flat: residual e = i k + r is row r
of pixel i.
"""

from collections.abc import Callable, Mapping
from math import prod
from typing import Annotated, Any, NamedTuple, get_args

from liaam.kernels.fields import Bool1, Double1, Double2, Double3, Int1, Single1, Single2, Single3
from liaam.model.warp import Mesh

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
    """State of a fit, its residual, weights and derivatives there, and scratch arrays: all that the loop writes.

    The annotations declare the shapes (:func:`work_shapes`), except those of arrays that may be the template's, and
    those of arrays for i steps.
    """

    p: Annotated[Double1, "n_p"]
    """Parameters of the warp."""
    angles: Annotated[Double1, "2"]
    """theta_1 (model) and theta_2 (image), radians."""
    lam: Annotated[Double1, "m"]
    """lambda, coordinates of the appearance, extra modes last."""
    before: Annotated[Double1, "n_p + 2 + m"]
    """p, angles and lambda before the last step."""
    metric: Annotated[Single1, "8 k"]
    """P(theta_2)."""
    slope: Annotated[Single1, "8 k"]
    """dP/dtheta_2."""
    rows: Single2
    """This, ``lines`` and ``slopes``: the template's at the current theta_1 (the same arrays if theta_1 is fixed)."""
    lines: Single1
    slopes: Single2
    points: Annotated[Double2, "v, 2"]
    """Vertices of the mesh, model pixels."""
    corner: Annotated[Int1, "n"]
    """This and the next are outputs of :func:`liaam.fitting.residual.place`."""
    between: Annotated[Single1, "3 n"]
    values: Annotated[Single1, "8 n"]
    """Samples of the image's channels."""
    residual: Annotated[Single1, "n k"]
    image_slopes: Annotated[Single1, "2 n k"]
    """Spatial gradient of the residual, model pixels."""
    usable: Annotated[Single1, "n"]
    """The image's weight, 0 or 1."""
    weighed: Annotated[Single1, "n k"]
    """Square root of the weights without noise weights, which depend on theta_2."""
    own: Annotated[Single1, "n k"]
    """Square root of the weights, before unusable pixels are set to 0."""
    own_derivative: Annotated[Single1, "n_turned k"]
    """Relative derivative of ``own`` by theta_2; empty if it does not depend on theta_2."""
    root: Annotated[Single1, "n k"]
    """Square root of the weights, 0 at unusable pixels."""
    noise: Annotated[Single1, "8 n_noise"]
    """Variance of the channels due to noise, for noise weights."""
    by_model: Annotated[Double1, "n_noise"]
    """Variance due to the model's errors, for noise weights."""
    variance: Annotated[Single1, "n_known k"]
    """Variance of the residuals, for weights that use it."""
    known: Annotated[Single1, "n_known"]
    """1 where colours were usable when weights by rows were last computed, else 0; NaN before."""
    known_now: Annotated[Single1, "n_known"]
    """The same at the current state."""
    unexplained: Annotated[Double2, "2, 2"]
    """Unexplained variance of gradients and colour, when weights were last computed and now."""
    scales: Annotated[Double1, "7"]
    """Variance at weight 1 (NaN if the weights define none), gain and offset of the samples, gain in ``image_slopes``,
    scale of the prior, lower bound on the curvature (:data:`LEAST_CURVATURE`), and the factor that converts
    ``Picture.pull`` to units of squared residuals."""
    gram: Annotated[Double2, "m, m"]
    """A'A under ``own``."""
    factor: Annotated[Double2, "m, m"]
    """Cholesky factor of A'A under ``root``, with a ridge."""
    ar: Annotated[Double1, "m"]
    """A'r - ridge * lambda."""
    sums: Annotated[Double1, "2"]
    """r'r and the sum of the weights."""
    expected: Annotated[Single1, "2 n_expected k"]
    """Expected spatial gradient of the residual, model pixels."""
    appearance_slopes: Annotated[Single1, "2 n_expected k"]
    """Spatial gradient of the fitted appearance, in the reference frame."""
    columns: Annotated[Single2, "n_free, n k"]
    """Derivatives by the free angles."""
    aj: Annotated[Double2, "m, n_q"]
    """A'J."""
    hessian: Annotated[Double2, "n_q, n_q"]
    """E'QJ, with E the expected derivatives or J."""
    gradient: Annotated[Double1, "n_q"]
    """E'Qr."""
    base: Annotated[Double2, "n_q, n_q"]
    """Expected curvature, E'QE."""
    step: Annotated[Double1, "n_q"]
    last_step: Annotated[Double1, "n_q"]
    """The last accepted step; zero before."""
    lam_step: Annotated[Double1, "m"]
    free: Annotated[Bool1, "n_q"]
    """Entries of q that may move."""
    precision: Annotated[Double1, "n_p"]
    """Precision of the prior on p, in units of squared residuals."""
    fours: Annotated[Single1, "4 n k + 8"]
    """This and the arrays below down to ``along``, but for ``damper``, are scratch."""
    room: Annotated[Single1, "48"]
    squares: Annotated[Double2, "2 v, w_p + 8"]
    products: Annotated[Double2, "2 v, w_m"]
    carried_squares: Annotated[Double2, "n_p, w_p + 8"]
    carried_products: Annotated[Double2, "n_p, w_m"]
    line: Annotated[Single1, "BLOCK"]
    block: Annotated[Single2, "m, BLOCK"]
    planes: Annotated[Single2, "10, PLANE"]
    sizes: Annotated[Double2, "2, n"]
    row_sums: Annotated[Double2, "k, 3"]
    damper: Annotated[Double2, "n_q, n_q"]
    """``base`` plus the prior; damping is relative to it."""
    small: Annotated[Double3, "2, n_q, n_q"]
    spectrum: Annotated[Double2, "4, n_q"]
    """See :func:`liaam.fitting.equations.tridiagonalise`."""
    rotations: Annotated[Double2, "ROTATIONS n_q n_q, 3"]
    eliminated: Annotated[Double2, "m, n_q"]
    along: Annotated[Double2, "m, 1"]
    costs: Double1
    """(i + 1,) float64: mean squared residual at the start and after every accepted step."""
    path: Double2
    """(i + 1, n_p) float64: p there."""
    turns: Double2
    """(i + 1, 2) float64: the angles there."""
    outcome: Annotated[Double1, "5"]
    """Number of accepted steps and of all, and ``converged``, ``held`` and ``flat`` as in
    :class:`liaam.fitting.solver.Solution`."""


def work_shapes(sizes: Mapping[str, int]) -> dict[str, tuple[str, tuple[int, ...]]]:
    """Return type and shape of each array of :class:`Work` whose annotation declares its shape."""
    sizes = {"BLOCK": BLOCK, "PLANE": PLANE, "ROTATIONS": ROTATIONS, **sizes}
    found = {}
    for name, hint in Work.__annotations__.items():
        _, dtype, _, *shape = get_args(hint)
        if shape:
            found[name] = dtype, tuple(_size(axis, sizes) for axis in shape[0].split(", "))
    return found


def _size(text: str, sizes: Mapping[str, int]) -> int:
    """Return a size such as ``4 n k + 8``, a sum of products of numbers and names."""
    return sum(prod(sizes[name] if name in sizes else int(name) for name in term.split()) for term in text.split("+"))
