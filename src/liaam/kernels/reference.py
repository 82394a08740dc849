"""Reference kernel in plain array code: slow, short, and the definition of right.

It is written against the array API standard, for a batch of images, and without writing into any array, so that
the same lines run on NumPy, PyTorch and JAX (:mod:`liaam.kernels.backends`). Functions without ``_batch`` in their name
are the contract of all kernels, for one image in NumPy.

Gradient convention: samples are bilinear, and the gradient is the exact derivative of the bilinear
interpolant, so that the Jacobian is the derivative of the very cost that is minimised. It jumps at
pixel lines; on a line it is the derivative from the right (from below).
"""

from typing import Any

import numpy as np
from array_api_compat import array_namespace
from array_api_compat import device as device_of

from liaam.kernels.layout import Carried, MeshPixels, Packed, points_of

Array = Any
"""An array of any library of the array API standard."""


def sample_batch(channels: Array, points: Array, sizes: Array | None = None) -> tuple[Array, Array, Array]:
    """Bilinear samples of encoded images with their exact gradient.

    Places are worked out in the precision of the points, so that a point on a pixel line stays on its side; what is
    sampled there in that of the channels.

    Parameters
    ----------
    channels : (b, h, w, c + 1) float32 or float64
        Encoded images of :func:`liaam.photometry.encode`: c channels and the usable weight.
    points : (b, n, 2) float64 or float32
        Where to sample (x, y), pixels.
    sizes : (b, 2) int64, optional
        Width and height of each image, where smaller images are padded to a common size.

    Returns
    -------
    values : (b, n, c) float32
        Zero outside the image.
    gradients : (b, n, 2, c) float32
        d values / dx and d values / dy. Zero outside.
    weights : (b, n) float32
        1 where all four pixels around the point are inside the image and usable, else 0.
    """
    xp, device = array_namespace(channels, points), device_of(channels)
    batch, height, width, n_channels = channels.shape
    sizes = xp.asarray([[width, height]], dtype=xp.int64, device=device) if sizes is None else sizes
    last = xp.astype(sizes, points.dtype)[:, None, :] - 1
    # Written so that NaN counts as outside.
    inside = xp.all((points >= 0) & (points <= last), axis=-1)[..., None]
    safe = xp.where(inside, points, xp.zeros_like(points))
    corner = xp.minimum(xp.floor(safe), last - 1)
    whole, between = xp.astype(corner, xp.int64), xp.astype(safe - corner, channels.dtype)
    u, v = between[..., :1], between[..., 1:]
    first = xp.arange(batch, dtype=xp.int64, device=device)[:, None] * (height * width)
    index = xp.reshape(first + whole[..., 1] * width + whole[..., 0], (-1,))
    flat = xp.reshape(channels, (-1, n_channels))

    def pixels(offset: int) -> Array:
        return xp.reshape(xp.take(flat, index + offset, axis=0), (*points.shape[:2], n_channels))

    c00, c10, c01, c11 = pixels(0), pixels(1), pixels(width), pixels(width + 1)
    top, bottom = c00 + u * (c10 - c00), c01 + u * (c11 - c01)
    values = top + v * (bottom - top)
    along_x = (1 - v) * (c10 - c00) + v * (c11 - c01)
    keep = xp.astype(inside, channels.dtype)
    gradients = xp.stack([along_x[..., :-1] * keep, (bottom - top)[..., :-1] * keep], axis=-2)
    usable = xp.minimum(xp.minimum(c00[..., -1], c10[..., -1]), xp.minimum(c01[..., -1], c11[..., -1]))
    single = (values[..., :-1] * keep, gradients, usable * keep[..., 0])
    values, gradients, weights = (xp.astype(array, xp.float32) for array in single)
    return values, gradients, weights


def sample(channels: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Bilinear samples of one encoded image with their exact gradient: :func:`sample_batch` of one.

    Parameters
    ----------
    channels : (h, w, c + 1) float32
    points : (n, 2) float64

    Returns
    -------
    values : (n, c) float32
    gradients : (n, 2, c) float32
    weights : (n,) float32
    """
    with np.errstate(invalid="ignore"):  # points of a diverging fit need not be numbers
        values, gradients, weights = sample_batch(
            np.asarray(channels, np.float64)[None], np.asarray(points, np.float64)[None]
        )
    return values[0], gradients[0], weights[0]


def carry_batch(positions: Array, corners: Array, beta: Array) -> Array:
    """Carry vertices to the pixels of a mesh: W(x; p) = sum_v beta_v(x) s_v.

    Parameters
    ----------
    positions : (b, n_vertices, 2) float64
    corners : (3, n) int64
        The three vertices around each pixel.
    beta : (3, n, 1) float64
        Their barycentric weights.

    Returns
    -------
    (b, n, 2) float64
    """
    xp = array_namespace(positions, beta)
    return sum(beta[i, ...] * xp.take(positions, corners[i, ...], axis=1) for i in range(3))


def carry(positions: np.ndarray, corners: np.ndarray, beta: np.ndarray) -> np.ndarray:
    """Carry vertices to the pixels of a mesh: :func:`carry_batch` of one.

    Parameters
    ----------
    positions : (n_vertices, 2) float
    corners : (n, 3) int32
        The three vertices around each pixel.
    beta : (n, 3) float64
        Their barycentric weights.

    Returns
    -------
    (n, 2) float64
    """
    return carry_batch(np.asarray(positions, np.float64)[None], corners.T, beta.T[..., None])[0]


def pull_batch(slopes: Array, inverse: Array, owners: Array) -> Array:
    """Carry gradients along with the triangles: grad V = (dW/dx)^-T grad values, in the precision of ``inverse``.

    Parameters
    ----------
    slopes : (b, n, 2, k) float32
        Derivatives along x and y at rest.
    inverse : (b, t, 2, 2) float
        (dW/dx)^-1 of each triangle.
    owners : (n,) int64
        Triangle of each pixel.

    Returns
    -------
    (b, n, k, 2) float32
    """
    xp = array_namespace(slopes, inverse)
    back, slopes = xp.take(inverse, owners, axis=1), xp.astype(slopes, inverse.dtype)
    pulled = [
        back[..., 0, i][..., None] * slopes[..., 0, :] + back[..., 1, i][..., None] * slopes[..., 1, :] for i in (0, 1)
    ]
    return xp.astype(xp.stack(pulled, axis=-1), xp.float32)


def pull(slopes: np.ndarray, inverse: np.ndarray, owners: np.ndarray) -> np.ndarray:
    """Carry gradients along with the triangles: grad V = (dW/dx)^-T grad values; :func:`pull_batch` of one.

    Parameters
    ----------
    slopes : (n, 2, k) float32
        Derivatives along x and y at rest.
    inverse : (t, 2, 2) float
        (dW/dx)^-1 of each triangle.
    owners : (n,) int32
        Triangle of each pixel.

    Returns
    -------
    (n, k, 2) float32
    """
    return pull_batch(slopes[None], np.asarray(inverse, np.float64)[None], owners)[0]


ON_EDGE = 1e-9
"""Barycentric weight below nought at which a pixel still lies on an edge."""

FLAT = 0.05
"""Share of its area at rest below which a triangle counts as flat."""


def inverse_affinities(points: np.ndarray, shape: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Linear parts of the maps from each triangle on a shape back to the one at rest; 0 for triangles that are flat.

    Parameters
    ----------
    points : (n_vertices, 2) float64
        Vertices at rest.
    shape : (n_vertices, 2) float64
    triangles : (t, 3) int

    Returns
    -------
    (t, 2, 2) float64
    """

    def edges(vertices: np.ndarray) -> np.ndarray:
        a, b, c = (vertices[triangles[:, i]] for i in range(3))
        return np.stack([b - a, c - a], axis=-1)

    here, there = edges(points), edges(shape)
    flat = np.abs(np.linalg.det(there)) <= FLAT * np.abs(np.linalg.det(here))
    there[flat] = np.eye(2)
    here[flat] = 0.0
    return here @ np.linalg.inv(there)


def steepest_batch(
    channels: Array, points: Array, turn: Array, metric: Array, sizes: Array | None = None
) -> tuple[Array, Array, Array, Array]:
    """Sample encoded images, project them by a metric, and differentiate by the place.

    All is worked out in the precision of the channels, but places in that of the points, and given in single precision.

    Parameters
    ----------
    channels : (b, h, w, c + 1) float32 or float64
        Encoded images.
    points : (b, n, 2) float64 or float32
        W(x; p) in each image's pixels.
    turn : (1 or b, 2, 2) of the channels' type
        Linear part of the similarity from the model's to the image's pixels.
    metric : (1 or b, k, c) of the channels' type
        Rows of P.
    sizes : (b, 2) int64, optional
        Width and height of each image, where smaller images are padded to a common size.

    Returns
    -------
    values : (b, n, c) float32
        Samples of the encoded images.
    projected : (b, n, k) float32
        P times the samples.
    steep : (b, n, k, 2) float32
        P dE/dx, x in the model's pixels; zero outside the image.
    weights : (b, n) float32
        Image weight in {0, 1} of each pixel.
    """
    xp = array_namespace(channels, points)
    values, gradients, weights = sample_batch(channels, points, sizes)
    across = xp.matrix_transpose(metric)
    projected = xp.astype(values, channels.dtype) @ across
    batch, n, _, n_channels = gradients.shape
    along = xp.astype(xp.reshape(gradients, (batch, 2 * n, n_channels)), channels.dtype) @ across
    along, turn = xp.reshape(along, (batch, n, 2, across.shape[-1])), turn[:, None, None, ...]
    # Sums of two written out: libraries are slow at a million products of 2 by 2.
    steep = [along[:, :, 0, :] * turn[..., 0, i] + along[:, :, 1, :] * turn[..., 1, i] for i in (0, 1)]
    return values, xp.astype(projected, xp.float32), xp.astype(xp.stack(steep, axis=-1), xp.float32), weights


def steepest(
    channels: np.ndarray, points: np.ndarray | Carried, turn: np.ndarray, metric: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Sample an encoded image, project it by a metric, and differentiate by the place: :func:`steepest_batch` of one.

    Parameters
    ----------
    channels : (h, w, c + 1) float32
        Encoded image, at least 2 pixels high and wide.
    points : (n, 2) float64, or Carried
        W(x; p) in the image's pixels.
    turn : (2, 2) float
        Linear part of the similarity from the model's to the image's pixels.
    metric : (k, c) float
        Rows of P.

    Returns
    -------
    values : (n, c) float32
        Samples of the encoded image.
    projected : (n, k) float32
        P times the samples.
    steep : (n, k, 2) float32
        P dE/dx, x in the model's pixels; zero outside the image.
    weights : (n,) float32
        Image weight in {0, 1} of each pixel.
    """
    arguments = (np.asarray(array, dtype=np.float64)[None] for array in (channels, points_of(points), turn, metric))
    with np.errstate(invalid="ignore"):  # points of a diverging fit need not be numbers
        values, projected, steep, weights = steepest_batch(*arguments)
    return values[0], projected[0], steep[0], weights[0]


def weighted_gram(modes: np.ndarray, roots: np.ndarray) -> np.ndarray:
    """Gram matrix of weighted modes.

    Parameters
    ----------
    modes : (m, n * k) float32
        A, unweighted.
    roots : (n, k) float32
        Roots of the weights.

    Returns
    -------
    (m, m) float64
    """
    weighted = modes.astype(np.float64) * roots.reshape(-1)
    return weighted @ weighted.T


def less(values: np.ndarray, packed: Packed, factors: np.ndarray) -> np.ndarray:
    """What is left of values when combined rows are taken off: values - factors A.

    Parameters
    ----------
    values : array of n * k numbers, float32
    packed : Packed
        A (m, n * k).
    factors : (m,) float

    Returns
    -------
    array as the values, float32
    """
    with np.errstate(over="ignore", invalid="ignore"):  # a fit that blows up; its cost says so
        taken = np.asarray(factors, np.float64) @ packed.rows.astype(np.float64)
        return (values - taken.reshape(values.shape)).astype(np.float32)


def combined(packed: Packed, factors: np.ndarray) -> np.ndarray:
    """Rows A (m, n * k) combined by factors (m,): factors A, (n * k,) float32."""
    return less(np.zeros(packed.steps.shape[1], np.float32), packed, -np.asarray(factors))


def column_sums(
    columns: np.ndarray,
    packed: Packed,
    own: np.ndarray,
    weights: np.ndarray,
    values: np.ndarray | None = None,
    factors: np.ndarray | None = None,
) -> tuple[np.ndarray, bool, float, np.ndarray, np.ndarray]:
    """Weighted products of the residual and of derivatives by angles, among themselves and with the modes.

    Parameters
    ----------
    columns : (b, n * k) float32
        Derivatives by the free angles, and the residual in the last row; unweighted. Where values are given, that row
        is written to: with what is left of them (:func:`less`).
    packed : Packed
        A (m, n * k), unweighted.
    own : (n, k) float32
        Roots of the weights.
    weights : (n,) float32
        The image's weights in {0, 1}.
    values : (n, k) float32, optional
    factors : (m,) float, optional
        Of the modes that are taken off the values; none are if left out.

    Returns
    -------
    roots : (n, k) float32
        Roots of the weights, the image's included.
    all_seen : bool
        Whether the image has a weight at every pixel.
    weight : float
        Sum of all weights.
    by_modes : (b, m) float64
    by_columns : (b, b) float64
    """
    if values is not None:
        columns[-1] = (values if factors is None else less(values, packed, factors)).reshape(-1)
    roots = own * weights[:, None]
    squares = np.square(roots.astype(np.float64)).reshape(-1)
    weighted = (columns * squares).T
    all_seen = bool((weights > 0).all())
    return roots, all_seen, float(squares.sum()), (packed.rows @ weighted).T, columns @ weighted


def raster(points: np.ndarray, triangles: np.ndarray, width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
    """Tell in which triangle of a mesh each pixel of a picture lies, and where in it.

    Parameters
    ----------
    points : (n, 2) float64
        Vertices, all within the picture.
    triangles : (t, 3) int
        A pixel on the edge of several belongs to the first.
    width, height : int

    Returns
    -------
    owner : (height, width) int32
        Number of the triangle; -1 outside the mesh.
    weights : (height, width, 3) float64
        Barycentric; 0 outside.
    """
    owner, weights = np.full((height, width), -1, dtype=np.int32), np.zeros((height, width, 3))
    for t, (a, b, c) in enumerate(points[triangles]):
        (left, above), (right, below) = np.floor(np.min([a, b, c], axis=0)), np.ceil(np.max([a, b, c], axis=0))
        x, y = np.mgrid[int(left) : int(right) + 1, int(above) : int(below) + 1].reshape(2, -1)
        (x0, y0), (x1, y1) = b - a, c - a
        determinant = x0 * y1 - x1 * y0
        if determinant == 0:
            continue
        dx, dy = x - a[0], y - a[1]
        v, w = (y1 * dx - x1 * dy) / determinant, (x0 * dy - y0 * dx) / determinant
        own = np.column_stack([1.0 - v - w, v, w])
        inside = (own >= -ON_EDGE).all(axis=1) & (owner[y, x] < 0)
        owner[y[inside], x[inside]], weights[y[inside], x[inside]] = t, own[inside]
    return owner, weights


def mesh_products(
    steep: np.ndarray,
    root: np.ndarray,
    packed: Packed,
    right: np.ndarray,
    mesh: MeshPixels,
    expected: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Weighted products of the derivatives by a mesh's vertices with themselves and with other columns.

    A pixel moves with the three vertices around it only, so that of its row of derivatives,

        dr(x) / d(vertex v) = beta_v(x) steep(x),

    all but six entries are zero: this is the sparse form of J'J and A'J. What they sum up to is carried on to the
    warp's parameters, which the vertices follow.

    Parameters
    ----------
    steep : (n, k, 2) float32
        Derivative of each pixel's residuals by the place.
    root : (n, k) float32
        Root of the weights, the image's included.
    packed : Packed
        A (m, n * k), unweighted.
    right : (b, n * k) float32
        Further columns, unweighted, one at least: of the angles, and the residual.
    mesh : MeshPixels
        Where the pixels lie.
    expected : (n, k, 2) float32, optional
        What the derivatives are expected to be, E; J'J and right'J become E'J and right'E.

    Returns
    -------
    jj : (n_p, n_p) float64
    aj : (m, n_p) float64
    rj : (b, n_p) float64
    """
    owners = np.repeat(np.arange(len(mesh.triangles)), np.diff(mesh.starts))

    def columns_of(slopes: np.ndarray) -> np.ndarray:
        columns = np.zeros((*root.shape, len(mesh.basis) // 2, 2))
        for corner in range(3):
            at = mesh.triangles[owners, corner]
            columns[np.arange(len(root)), :, at] = (mesh.beta[:, corner, None] * root)[..., None] * slopes
        return columns.reshape(root.size, len(mesh.basis)) @ mesh.basis

    by_root, columns = root.reshape(-1, 1), columns_of(steep)
    left = columns if expected is None else columns_of(expected)
    return left.T @ columns, packed.rows @ (by_root * columns), right @ (by_root * left)


def soft_noise_batch(
    values: Array,
    relative: Array,
    span: tuple[float, float],
    left: Array,
    softness: float,
    floor: float,
    brightness: np.ndarray,
    unknown: float,
    most: float,
) -> Array:
    """Variance of the six channels of ``soft`` by each image's noise, to first order.

    With o = g / sqrt(|g|^2 + e^2), do/dg = (I - o o') / sqrt(|g|^2 + e^2), and the root follows from |o| itself. All is
    worked out in the precision of ``relative``.

    Parameters
    ----------
    values : (b, n, 6) float32
    relative : (b, s) float
    span : (lowest, highest)
    left : (b, 2) of the type of ``relative``
    softness, floor, brightness, unknown, most
        As for :func:`soft_variances`.

    Returns
    -------
    (b, n, 6) float32
    """
    xp = array_namespace(values, relative)
    values = xp.astype(values, relative.dtype)
    direction, logs, known = values[..., :2], values[..., 2:5], values[..., 5:]
    linear, deviation = xp.exp(logs), _interpolate(logs, relative, span)
    share, left = [float(weight) for weight in brightness], left[:, None, None, :]
    total = sum(linear[..., i : i + 1] * share[i] for i in range(3)) + floor
    squares = xp.square(left[..., 1] * deviation * linear)
    slope = sum(squares[..., i : i + 1] * share[i] ** 2 for i in range(3)) / xp.square(total)
    rest = xp.clip(1.0 - xp.sum(xp.square(direction), axis=-1)[..., None], 0.0, None)
    by_component = 1.0 - xp.square(direction) * (1.0 + rest)
    of_direction = xp.clip(slope * rest / softness**2 * by_component, None, most)
    # A blur averages noise away, but not what the logarithm's curvature makes of it.
    of_log = xp.square(left[..., 0] * deviation) + xp.square(0.5 * xp.square(deviation))
    of_log = xp.where(known < 0.99, xp.full_like(of_log, unknown), of_log)
    return xp.astype(xp.concat([of_direction, of_log, xp.zeros_like(known)], axis=-1), xp.float32)


def _interpolate(at: Array, table: Array, span: tuple[float, float]) -> Array:
    """Values of tables (b, s), evenly spaced over a span, at places (b, ...); beyond it the nearest counts."""
    xp, (batch, size) = array_namespace(at, table), table.shape
    place = xp.clip((at - span[0]) * ((size - 1) / (span[1] - span[0])), 0.0, float(size - 1))
    whole = xp.clip(xp.floor(place), None, float(size - 2))
    first = xp.arange(batch, dtype=xp.int64, device=device_of(table)) * size
    first = xp.reshape(first, (batch,) + (1,) * (at.ndim - 1))
    index, flat = xp.reshape(first + xp.astype(whole, xp.int64), (-1,)), xp.reshape(table, (-1,))
    low, high = (xp.reshape(xp.take(flat, index + i, axis=0), at.shape) for i in (0, 1))
    return low + (place - whole) * (high - low)


def beyond_noise_batch(residual: Array, by_noise: Array, usable: Array, limit: float) -> Array:
    """Squares of residuals, and what they have beyond noise, summed over the pixels where noise says something.

    Parameters
    ----------
    residual, by_noise : (b, n, k) float32
    usable : (b, n) bool
    limit : float
        Variance from which on a residual says nothing.

    Returns
    -------
    (b, k, 3) float64
    """
    xp = array_namespace(residual, by_noise)
    known = usable[..., None] & (by_noise < limit)
    squares = xp.square(xp.astype(residual, xp.float64))
    nothing = xp.zeros_like(squares)
    columns = (xp.astype(known, xp.float64), squares, squares - xp.astype(by_noise, xp.float64))
    return xp.stack([xp.sum(xp.where(known, column, nothing), axis=1) for column in columns], axis=-1)


def soft_variances(
    values: np.ndarray,
    residual: np.ndarray,
    weights: np.ndarray,
    squared: np.ndarray,
    relative: np.ndarray,
    span: tuple[float, float],
    left: tuple[float, float],
    softness: float,
    floor: float,
    brightness: np.ndarray,
    unknown: float,
    most: float,
    colours: bool,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Variance of ``soft`` by the image's noise, and squares of residuals summed where that says something.

    :func:`soft_noise_batch` and :func:`beyond_noise_batch` of one.

    Parameters
    ----------
    values : (n, 6) float32
        Samples: o, log R, G and B, and how far those are known.
    residual : (n, k) float32
    weights : (n,) float32
        Positive for pixels that count.
    squared : (k, 6) float
        Squares of the metric's entries; the sixth channel has no noise.
    relative : (s,) float64
        Standard deviation of the logarithm by noise, at evenly spaced logarithms.
    span : (lowest, highest)
        Of these logarithms; beyond them the nearest counts.
    left : (values, slopes)
        Share of the noise's deviation that the blur leaves, and deviation of a slope by noise of unit deviation.
    softness, floor : float
        Those of the encoding.
    brightness : (3,) float64
        Weights of R, G and B.
    unknown : float
        Variance of a logarithm that is not known; rows from half of it on do not count.
    most : float
        Largest variance of a component of o.
    colours : bool
        Whether logarithms say anything at all.

    Returns
    -------
    noise : (n, 6) float32
        Variance of the channels.
    by_noise : (n, k) float32
        Of the rows.
    sums : (k, 3) float64
        Of each row: how many pixels count, their squared residuals, and these less the variance by noise.
    """
    settings = softness, floor, brightness, unknown, most
    noise = soft_noise_batch(values[None], np.asarray(relative, np.float64)[None], span, np.array([left]), *settings)[0]
    if not colours:
        noise[:, 2:5] = unknown
    by_noise = (noise @ squared.T).astype(np.float32)
    return noise, by_noise, beyond_noise_batch(residual[None], by_noise[None], weights[None] > 0, 0.5 * unknown)[0]


def soft_roots(
    by_noise: np.ndarray, model: np.ndarray, tied: float, own: np.ndarray, weights: np.ndarray
) -> tuple[np.ndarray, float]:
    """Roots of soft weights: those of the variance's inverse, brought to a mean weight of 1 over pixels that count.

    Parameters
    ----------
    by_noise : (n, k) float32
        Variance of each pixel's rows by noise.
    model : (k,) float
        Variance of each row by the model's errors.
    tied : float
        Pixels that the blur ties to one.
    own : (n, k) float32
        Root of the model's own weights.
    weights : (n,) float32
        The image's weights in {0, 1}.

    Returns
    -------
    roots : (n, k) float32
    unit : float
        Variance that weighs 1; NaN where no pixel counts.
    """
    precision = 1.0 / (tied * by_noise.astype(np.float64) + np.asarray(model, np.float64))
    usable = weights * own[:, 0] > 0
    unit = 1.0 / precision[usable].mean() if usable.any() else np.nan
    return (own * np.sqrt(unit * precision)).astype(np.float32), float(unit)


def correlate(left: np.ndarray, right: np.ndarray, out: np.ndarray) -> np.ndarray:
    """Spectrum of the correlation of two pictures, summed over their two channels: left conj(right).

    Parameters
    ----------
    left, right : (2, h, w) float32
        Fourier transforms of real channels as OpenCV's ``dft`` packs them: in each row a real number, pairs of real and
        imaginary part, and a real one more where w is even; the columns of those real ones are packed alike.
    out : (h, w) float32
        Written to, so that large arrays are made once.

    Returns
    -------
    (h, w) float32
        ``out``, packed alike.
    """
    height, width = left.shape[1:]
    a, b = (_unpacked(channels.astype(np.float64)) for channels in (left, right))
    product = (a * b.conj()).sum(axis=0)
    packed = out
    pairs = product[:, 1 : (width + 1) // 2]
    packed[:, 1 : 1 + 2 * pairs.shape[1]] = np.stack([pairs.real, pairs.imag], axis=2).reshape(height, -1)
    for x, column in ((0, product[:, 0]), (width - 1, product[:, -1]))[: 2 - width % 2]:
        packed[0, x] = column[0].real
        packed[1::2, x] = column[1 : height // 2 + 1].real
        packed[2::2, x] = column[1 : (height + 1) // 2].imag
    return packed


def _unpacked(packed: np.ndarray) -> np.ndarray:
    """First half of the columns of the Fourier transforms (c, h, w // 2 + 1) that are packed in (c, h, w)."""
    height, width = packed.shape[1:]
    spectrum = np.zeros((len(packed), height, width // 2 + 1), complex)
    n = (width - 1) // 2
    spectrum[:, :, 1 : n + 1] = packed[:, :, 1 : 2 * n + 1 : 2] + 1j * packed[:, :, 2 : 2 * n + 2 : 2]
    for x, column in ((0, 0), (width - 1, -1))[: 2 - width % 2]:
        for y in range(height):
            k = min(y, height - y)
            real = packed[:, 2 * k - 1 if k else 0, x]
            imaginary = packed[:, 2 * k, x] if 0 < 2 * k < height else 0.0
            spectrum[:, y, column] = real + (1j if y == k else -1j) * imaginary
    return spectrum


def best_peaks(picture: np.ndarray, count: int, least: float, reach: int) -> tuple[np.ndarray, np.ndarray]:
    """Largest local maxima of a picture, the first of equals first.

    Parameters
    ----------
    picture : (h, w) float32
        Finite.
    count : int
        How many at most.
    least : float
        Value that a maximum has to exceed.
    reach : int
        No pixel so many rows and columns away, or nearer, may be larger.

    Returns
    -------
    places : (k, 2) int64
        Rows and columns.
    values : (k,) float32
    """
    around = np.pad(picture, reach, constant_values=-np.inf)
    windows = np.lib.stride_tricks.sliding_window_view(around, (2 * reach + 1, 2 * reach + 1))
    places = np.argwhere((picture >= windows.max(axis=(2, 3))) & (picture > np.float32(least)))
    values = picture[places[:, 0], places[:, 1]]
    order = np.argsort(-values, kind="stable")[:count]
    return places[order], values[order]


def damped_step(
    hessian: np.ndarray, gradient: np.ndarray, precision: np.ndarray, free: np.ndarray, damping: float
) -> np.ndarray | None:
    """Levenberg's step: (H + damping diag H) step = -gradient, H the Hessian and a prior's precision.

    Parameters
    ----------
    hessian : (n, n) float64
        Symmetric, positive but for rounding.
    gradient : (n,) float64
        Prior included.
    precision : (n,) float64
        Of the prior.
    free : (n,) bool
        Entries that may move; the others' steps are 0.
    damping : float
        As a share of the diagonal.

    Returns
    -------
    (n,) float64, or None where the system is singular
    """
    own = hessian[np.ix_(free, free)] + np.diag(precision[free])
    diagonal = own.diagonal().copy()
    floor = 1e-9 * diagonal.max(initial=0.0)
    own[np.diag_indices_from(own)] += damping * np.maximum(diagonal, floor) + floor
    step = np.zeros(len(free))
    try:
        step[free] = np.linalg.solve(own, -gradient[free])
    except np.linalg.LinAlgError:
        return None
    return step
