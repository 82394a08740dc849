"""The one objective for many pictures at once: :mod:`liaam.fitting.objective` with a leading batch dimension.

Nothing here knows a method. What a method compares is asked of :class:`liaam.fitting.objective.Objective` and
:class:`liaam.fitting.methods.Method` once, and kept as arrays:

* P and the model side are affine in (1, cos theta, sin theta), since L(theta) is: three evaluations say all;
* W(x; p) is affine in p: W(x; 0) and dW/dp say all.

Pixels are in float32, what is summed over them in float64, as for one picture.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from array_api_compat import device as device_of

from liaam.errors import MethodError
from liaam.fitting.batched.equations import Array, Equations, apply, gram, regular_inverse
from liaam.fitting.methods import Method
from liaam.fitting.normal_equations import BLOCK
from liaam.fitting.objective import Objective, State
from liaam.fitting.problem import FitProblem
from liaam.kernels.backends import Backend
from liaam.kernels.reference import carry_batch, pull_batch, steepest_batch
from liaam.warp import PiecewiseAffineWarp


class Pictures(NamedTuple):
    """Fit problems of a batch.

    Attributes
    ----------
    channels : (b, h, w, c + 1) float32
        Patches, padded to a common size.
    sizes : (b, 2) int64
        Width and height of each.
    turn, offset : (b, 2, 2), (b, 2) float64
        Similarity from the model's to the patch's pixels.
    relative : (b, steps) float32
        ``FitProblem.relative_noise``; zeros for methods that do not weigh by it.
    left : (b, 2) float32
        ``noise_left`` and ``slope_left`` of the problem.
    tied : (b,) float64
        Pixels that stand for one independent residual of soft methods.
    """

    channels: Array
    sizes: Array
    turn: Array
    offset: Array
    relative: Array
    left: Array
    tied: Array


class States(NamedTuple):
    """Where the fits stand: ``p`` (b, n_p), ``angles`` (b, 2) and ``lam`` (b, m), float64."""

    p: Array
    angles: Array
    lam: Array


class Trusts(NamedTuple):
    """How far each pixel is trusted (see :class:`liaam.fitting.trust.Trust`).

    Attributes
    ----------
    root : (b, n_pixels, k) float32
        Root of the weights.
    unit : (b,) float64
        Variance that weighs 1; NaN where nothing could be worked out.
    unexplained : (b, groups) float64
    silent : (b, n_pixels) bool
        Pixels whose logarithm says nothing.
    """

    root: Array
    unit: Array
    unexplained: Array
    silent: Array


class Look(NamedTuple):
    """What the pictures show, as for one picture (see :class:`liaam.fitting.problem.Look`), float32.

    Attributes
    ----------
    values : (b, n_pixels, c)
    residual : (b, n_pixels, k)
    steep : (b, n_pixels, k, 2)
    by_angles : (b, n_free, n_pixels * k)
    weights : (b, n_pixels)
    """

    values: Array
    residual: Array
    steep: Array
    by_angles: Array
    weights: Array


class Seen(NamedTuple):
    """Linearisations of a batch."""

    equations: Equations
    look: Look


class Shared(NamedTuple):
    """What all pictures of a batch have in common; first dimension 3 (or 1): the terms of (1, cos, sin) of an angle.

    Attributes
    ----------
    vertices : (1 + n_p, n_vertices, 2) float64
        Of the mesh at rest, and their movement by each parameter.
    corners, beta : (3, n) int64, (3, n, 1) float64
        Vertices around each pixel, and their barycentric weights.
    jacobian : (n, 2, n_p) float32
        dW/dp.
    root : (n, k) float32
        Root of the model's own weights.
    mean, modes : (1 or 3, n, k), (1 or 3, n * k, m) float32
        Model side by theta_1; one term where no method turns it.
    pairs : (2, m (m + 1) / 2) int64
        Every two modes.
    full : (m * m,) int64
        Where each entry of a symmetric matrix (m, m) is in ``pairs``.
    metric, model_metric : (3, k, c) float64
        P by theta_2 and by theta_1.
    slopes : (1 + n_own, n * 2 * c) float32
        Gradients of the mean, the appearance and the illumination modes on the reference frame, unprojected; none
        where they are not asked for.
    triangles : (3, t) int64
    frame : (t, 2, 2) float64
        Edges of the triangles on the reference frame, as columns.
    owners : (n,) int64
        Triangle of each pixel.
    prior : (n_p,) float64
    directions : (2, n_free) float64
    """

    vertices: Array
    corners: Array
    beta: Array
    jacobian: Array
    root: Array
    mean: Array
    modes: Array
    pairs: Array
    full: Array
    metric: Array
    model_metric: Array
    slopes: Array
    triangles: Array
    frame: Array
    owners: Array
    prior: Array
    directions: Array


def unsupported(method: Method) -> str | None:
    """Say what the batched fit cannot do of a method, if anything."""
    if method.noise_weights:
        return "weights by noise (+noise)"
    if method.loss != "squares":
        return f"robust losses (+{method.loss})"
    if method.normalise:
        return "normalisation"
    if method.soft and method.angle_directions.any():
        return "soft weights with a free angle"
    return None


@dataclass(frozen=True, eq=False)
class BatchObjective:
    """An objective seen by an array library.

    Attributes
    ----------
    objective : Objective
    backend : Backend
    scores : bool
        Whether gradients of the model's appearance will be asked for.
    """

    objective: Objective
    backend: Backend
    scores: bool = False

    def __post_init__(self) -> None:
        """Refuse a warp that is not affine in p."""
        if not isinstance(self.objective.warp, PiecewiseAffineWarp):
            raise MethodError("batched fits need a warp that is linear in its parameters; fit one by one with Fitter")

    @property
    def xp(self) -> Any:
        """Namespace of the array library."""
        return self.backend.xp

    @property
    def n_p(self) -> int:
        """Warp parameters."""
        return self.objective.warp.n_parameters

    @cached_property
    def shared(self) -> Shared:
        """What all pictures have in common, on the device."""
        own, method, warp = self.objective, self.objective.method, self.objective.warp
        assert isinstance(warp, PiecewiseAffineWarp)
        turns = bool(method.angle_directions[0].any())
        mean, modes = self._model_side(turns)
        pairs, full = _symmetric(modes.shape[2])
        corners, beta = warp._corners
        triangles = warp.frame.triangles.T.astype(np.int64)
        arrays = Shared(
            vertices=np.concatenate([warp._vertices(warp.rest)[None], warp._vertex_modes]),
            corners=corners.T.astype(np.int64),
            beta=beta.T[..., None],
            jacobian=warp.jacobian(np.zeros(self.n_p)),
            root=own.root_weights,
            mean=mean,
            modes=modes,
            pairs=pairs,
            full=full,
            metric=_by_angle(method.image_metric),
            model_metric=_by_angle(method.model_metric),
            slopes=own._slopes.rows if self.scores else np.zeros((0, 0), np.float32),
            triangles=triangles,
            frame=_edges(np, warp.frame.points, triangles),
            owners=warp._owners.astype(np.int64),
            prior=own.prior,
            directions=method.angle_directions,
        )
        return Shared(*(self.backend.put(array) for array in arrays))

    def _model_side(self, turns: bool) -> tuple[np.ndarray, np.ndarray]:
        """Mean and modes (as columns) of the objective's design."""
        own = self.objective
        if not turns:
            design = own.design(own.theta_model)
            return design.mean[None], np.ascontiguousarray(design.modes.T)[None]
        mean, modes = (
            _by_angle(lambda theta, name=name: getattr(own.design(theta), name)) for name in ("mean", "modes")
        )
        return mean.astype(np.float32), np.ascontiguousarray(modes.swapaxes(1, 2), np.float32)

    def pictures(self, problems: Sequence[FitProblem]) -> Pictures:
        """Bring fit problems together: patches are padded to a common size."""
        patches = [problem.patch.channels for problem in problems]
        height, width = (max(patch.shape[i] for patch in patches) for i in (0, 1))
        if self.backend.compiles:
            height, width = recurring(height), recurring(width)
        channels = np.zeros((len(patches), height, width, patches[0].shape[2]), np.float32)
        for padded, patch in zip(channels, patches, strict=True):
            padded[: patch.shape[0], : patch.shape[1]] = patch
        nothing, soft = np.zeros(2), self.objective.method.soft
        arrays = Pictures(
            channels,
            np.array([patch.shape[1::-1] for patch in patches], np.int64),
            np.array([problem.pose.matrix for problem in problems]),
            np.array([problem.pose.offset for problem in problems]),
            np.array([problem.relative_noise if soft else nothing for problem in problems], np.float32),
            np.array([(problem.noise_left, problem.slope_left) for problem in problems], np.float32),
            np.array([self.objective.tied_in(problem) for problem in problems]),
        )
        return Pictures(*(self.backend.put(array) for array in arrays))

    def states(self, states: Sequence[State]) -> States:
        """Bring states together."""
        stacked = (np.stack([getattr(state, name) for state in states]) for name in States._fields)
        return States(*(self.backend.put(np.asarray(array, np.float64)) for array in stacked))

    def linearise(self, shared: Shared, pictures: Pictures, state: States, trust: Trusts | None) -> Seen:
        """Look at the pictures and weigh what is seen: :meth:`liaam.fitting.objective.Objective.linearise`."""
        return self.weighed(shared, self.look(shared, pictures, state), state, trust)

    def look(self, shared: Shared, pictures: Pictures, state: States) -> Look:
        """Residuals and derivatives: :meth:`liaam.fitting.objective.Objective.look`."""
        xp = self.xp
        metric, turn = self._at(shared.metric, state.angles[:, 1]), pictures.turn
        positions = self._vertices(shared, state.p) @ xp.matrix_transpose(turn) + pictures.offset[:, None]
        values, projected, steep, weights = steepest_batch(
            pictures.channels,
            carry_batch(positions, shared.corners, shared.beta),
            xp.astype(turn, xp.float32),
            xp.astype(metric, xp.float32),
            pictures.sizes,
        )
        residual = projected - self._at(shared.mean, state.angles[:, 0])
        look = Look(values, residual, steep, self._by_angles(shared, state, values), weights)
        return self.moved(shared, look, state, state.lam)

    def _vertices(self, shared: Shared, p: Array) -> Array:
        """Vertices of the mesh, (b, n_vertices, 2) float64, model pixels."""
        by_p = self.xp.reshape(shared.vertices[1:], (self.n_p, -1))
        return shared.vertices[0] + self.xp.reshape(p @ by_p, (-1, *shared.vertices.shape[1:]))

    def moved(self, shared: Shared, look: Look, state: States, step: Array) -> Look:
        """The same after a step of lambda (b, m)."""
        change = self._combine(self._at(shared.modes, state.angles[:, 0]), self.xp.astype(step, self.xp.float32))
        return look._replace(residual=look.residual - self.xp.reshape(change, look.residual.shape))

    def model_gradient(self, shared: Shared, look: Look, state: States) -> Array:
        """Derivative of the fitted appearance by the place, (b, n, k, 2): ``Objective.model_gradient``."""
        xp, n_own, n = self.xp, shared.slopes.shape[0] - 1, look.residual.shape[1]
        scale = xp.ones_like(state.lam[:, :1])
        if self.objective.method.gain:  # its mode is the mean
            scale = scale + state.lam[:, n_own : n_own + 1]
        coordinates = xp.astype(xp.concat([scale, state.lam[:, :n_own]], axis=1), xp.float32)
        metric = xp.astype(self._at(shared.model_metric, state.angles[:, 0]), xp.float32)
        slopes = xp.reshape(coordinates @ shared.slopes, (-1, 2 * n, metric.shape[-1])) @ xp.matrix_transpose(metric)
        inverse = xp.astype(self._inverse_affinities(shared, state.p), xp.float32)
        return pull_batch(xp.reshape(slopes, (-1, n, 2, metric.shape[-2])), inverse, shared.owners)

    def _inverse_affinities(self, shared: Shared, p: Array) -> Array:
        """Linear parts (b, t, 2, 2) of the maps back from each triangle: ``reference.inverse_affinities``."""
        xp, own = self.xp, shared.frame
        there = _edges(xp, self._vertices(shared, p), shared.triangles)
        a, b, c, d = (there[..., i, j] for i in (0, 1) for j in (0, 1))
        determinant = a * d - b * c
        size = xp.abs(own[..., 0, 0] * own[..., 1, 1] - own[..., 0, 1] * own[..., 1, 0])
        flat = ~(xp.abs(determinant) >= 0.05 * size)
        factor = xp.where(flat, 0.0 * determinant, 1.0 / xp.where(flat, xp.ones_like(determinant), determinant))
        # The inverse's rows are (d, -b) and (-c, a) by the factor; sums of two written out, as in the kernel.
        columns = ((d * factor, -c * factor), (-b * factor, a * factor))
        products = [own[..., 0] * x[..., None] + own[..., 1] * y[..., None] for x, y in columns]
        return xp.stack(products, axis=-1)

    def weighed(
        self, shared: Shared, look: Look, state: States, trust: Trusts | None, expected: Array | None = None
    ) -> Seen:
        """Normal equations of what is seen, under weights: :meth:`liaam.fitting.objective.Objective.weighed`.

        With an expected gradient (b, n, k, 2) those of ``Linearisation.expecting``.
        """
        xp = self.xp
        own_root = shared.root[None] if trust is None else trust.root
        root = own_root * look.weights[..., None]
        by_angles = self._rows(root)[..., None] * xp.matrix_transpose(look.by_angles)
        residual = self._rows(root * look.residual)[..., None]
        columns, left = (
            None if steep is None else xp.concat([self._by_warp(shared, root, steep), by_angles, residual], axis=-1)
            for steep in (look.steep, expected)
        )
        modes = self._at(shared.modes, state.angles[:, 0])
        return Seen(self._equations(shared, columns, left, modes, root, trust), look)

    def _by_warp(self, shared: Shared, root: Array, steep: Array) -> Array:
        """Weighted derivatives of the residual by p, (b, n * k, n_p)."""
        steep = root[..., None] * steep
        jacobian = sum(steep[..., i][..., None] * shared.jacobian[:, None, i] for i in (0, 1))
        return self.xp.reshape(jacobian, (root.shape[0], root.shape[1] * root.shape[2], self.n_p))

    def _at(self, terms: Array, theta: Array, slope: bool = False) -> Array:
        """Sum of the terms of (1, cos theta, sin theta), or its derivative, (b or 1, ...), in the terms' type."""
        xp = self.xp
        if terms.shape[0] == 1:
            return terms
        one = xp.ones_like(theta)
        factors = (0.0 * one, -xp.sin(theta), xp.cos(theta)) if slope else (one, xp.cos(theta), xp.sin(theta))
        factors = xp.astype(xp.stack(factors, axis=-1), terms.dtype)
        flat = factors @ xp.reshape(terms, (3, -1))
        return xp.reshape(flat, (-1, *terms.shape[1:]))

    def _combine(self, modes: Array, lam: Array) -> Array:
        """Sum of modes (1 or b, rows, m) by lambda (b, m), (b, rows)."""
        if modes.shape[0] == 1:
            return lam @ self.xp.matrix_transpose(modes[0])
        return apply(modes, lam)

    def _rows(self, values: Array) -> Array:
        """Lay (b, n, k) out as (b, n * k)."""
        return self.xp.reshape(values, (values.shape[0], values.shape[1] * values.shape[2]))

    def _by_angles(self, shared: Shared, state: States, values: Array) -> Array:
        """dr/d(free angles), (b, n_free, n * k): the angle terms of paper eq 10."""
        xp = self.xp
        directions = xp.astype(shared.directions, xp.float32)
        if not directions.shape[1]:
            n, k = shared.root.shape
            return xp.zeros((values.shape[0], 0, n * k), dtype=xp.float32, device=device_of(values))
        slope = xp.astype(self._at(shared.metric, state.angles[:, 1], slope=True), xp.float32)
        columns = directions[1][:, None] * self._rows(values @ xp.matrix_transpose(slope))[:, None]
        if self.objective.method.angle_directions[0].any():
            mean = self._at(shared.mean, state.angles[:, 0], slope=True)
            lam = xp.astype(state.lam, xp.float32)
            turned = self._combine(self._at(shared.modes, state.angles[:, 0], slope=True), lam)
            columns = columns - directions[0][:, None] * (self._rows(mean) + turned)[:, None]
        return columns

    def _equations(
        self, shared: Shared, columns: Array, left: Array | None, modes: Array, root: Array, trust: Trusts | None
    ) -> Equations:
        xp, roots = self.xp, self._rows(root)
        squares = roots * roots
        cross = gram(modes, columns * roots[..., None])
        own = gram(columns if left is None else left, columns)
        if left is not None:  # the angles' rows are their columns' transpose, as the warp expects them
            n = self.n_p
            below = xp.concat([xp.matrix_transpose(own[:, :n, n:]), own[:, n:, n:]], axis=2)
            own = xp.concat([own[:, :n], below], axis=1)
        aa = self._modes_gram(shared, modes, squares)
        weight = xp.sum(squares, axis=-1, dtype=xp.float64)
        unit = xp.full_like(weight, float("nan")) if trust is None else trust.unit
        return Equations(
            own[:, :-1, :-1],
            own[:, :-1, -1],
            cross[:, :, :-1],
            aa,
            cross[:, :, -1],
            own[:, -1, -1],
            weight,
            regular_inverse(aa),
            unit,
        )

    def _modes_gram(self, shared: Shared, modes: Array, squares: Array) -> Array:
        """Gram matrix of the weighted modes, (b, m, m) float64."""
        xp, m = self.xp, modes.shape[-1]
        if modes.shape[0] > 1 or not m:
            return gram(modes + 0.0 * squares[:, :1, None], modes * squares[..., None])
        # Modes that all pictures share: one product of the weights with every two modes, instead of one a picture.
        total = 0.0
        for i in range(0, modes.shape[1], MANY_BLOCKS):
            block = modes[0, i : i + MANY_BLOCKS]
            products = xp.take(block, shared.pairs[0], axis=1) * xp.take(block, shared.pairs[1], axis=1)
            total = gram(xp.matrix_transpose(squares[None, :, i : i + MANY_BLOCKS]), products[None])[0] + total
        return xp.reshape(xp.take(total, shared.full, axis=1), (-1, m, m))


MANY_BLOCKS = 4 * BLOCK
"""Rows of which every two modes are multiplied at a time."""


def recurring(size: int) -> int:
    """Size rounded up to 2^i or 3 * 2^i, for libraries that compile anew for every size."""
    power = 1 << max(size - 1, 0).bit_length()
    return 3 * power // 4 if power >= 4 and 3 * power // 4 >= size else power


def _symmetric(m: int) -> tuple[np.ndarray, np.ndarray]:
    """Every two of m modes (2, m (m + 1) / 2), and where each entry of a symmetric matrix is there, (m * m,) int64."""
    first, second = np.triu_indices(m)
    index = np.zeros((m, m), np.int64)
    index[first, second] = index[second, first] = np.arange(len(first))
    return np.stack([first, second]).astype(np.int64), index.ravel()


def _by_angle(function: Callable[[float], np.ndarray]) -> np.ndarray:
    """Terms of 1, cos theta and sin theta of what is affine in them, (3, ...) float64."""
    ahead, across, behind = (np.asarray(function(theta), np.float64) for theta in (0.0, 0.5 * np.pi, np.pi))
    constant = 0.5 * (ahead + behind)
    return np.stack([constant, ahead - constant, across - constant])


def _edges(xp: Any, vertices: Array, triangles: Array) -> Array:
    """Two edges of each triangle (3, t) on vertices (..., n_vertices, 2), as columns, (..., t, 2, 2)."""
    a, b, c = (xp.take(vertices, triangles[i, ...], axis=-2) for i in range(3))
    return xp.stack([b - a, c - a], axis=-1)
