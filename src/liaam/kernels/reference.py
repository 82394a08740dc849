"""Reference kernel in plain array code: slow, short, and the definition of right.

Gradient convention: samples are bilinear, and the gradient is the exact derivative of the bilinear
interpolant, so that the Jacobian is the derivative of the very cost that is minimised. It jumps at
pixel lines; on a line it is the derivative from the right (from below).
"""

import numpy as np


def sample(channels: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Bilinear samples of an encoded image with their exact gradient.

    Parameters
    ----------
    channels : (h, w, c + 1) float32
        Encoded image of :func:`liaam.photometry.encode`: c channels and the usable weight.
    points : (n, 2) float64
        Where to sample (x, y), pixels.

    Returns
    -------
    values : (n, c) float32
        Zero outside the image.
    gradients : (n, 2, c) float32
        d values / dx and d values / dy. Zero outside.
    weights : (n,) float32
        1 where all four pixels around the point are inside the image and usable, else 0.
    """
    height, width = channels.shape[:2]
    points = np.asarray(points, dtype=np.float64)
    with np.errstate(invalid="ignore"):
        inside = (points >= 0).all(axis=1) & (points[:, 0] <= width - 1) & (points[:, 1] <= height - 1)
    safe = np.where(inside[:, None], points, 0.0)
    corner = np.minimum(np.floor(safe).astype(np.int64), [width - 2, height - 2])
    x, y = corner.T
    u, v = (safe - corner).T[:, :, None]
    c00, c10 = channels[y, x].astype(np.float64), channels[y, x + 1].astype(np.float64)
    c01, c11 = channels[y + 1, x].astype(np.float64), channels[y + 1, x + 1].astype(np.float64)
    top, bottom = c00 + u * (c10 - c00), c01 + u * (c11 - c01)
    values = top + v * (bottom - top)
    along_x = (1 - v) * (c10 - c00) + v * (c11 - c01)
    along_y = bottom - top
    usable = np.minimum(np.minimum(c00[:, -1], c10[:, -1]), np.minimum(c01[:, -1], c11[:, -1]))
    weights = np.where(inside, usable, 0.0)
    keep = inside[:, None]
    gradients = np.stack([along_x[:, :-1] * keep, along_y[:, :-1] * keep], axis=1)
    return (values[:, :-1] * keep).astype(np.float32), gradients.astype(np.float32), weights.astype(np.float32)


def linearise(
    channels: np.ndarray,
    points: np.ndarray,
    warp_jacobian: np.ndarray,
    turn: np.ndarray,
    metric: np.ndarray,
    root_weights: np.ndarray,
    columns: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Sample an encoded image, project it by a metric, and differentiate by the warp's parameters.

    Parameters
    ----------
    channels : (h, w, c + 1) float32
        Encoded image.
    points : (n, 2) float64
        W(x; p) in the image's pixels.
    warp_jacobian : (n, 2, n_p) float32
        dW/dp in the model's pixels.
    turn : (2, 2) float64
        Linear part of the similarity from the model's to the image's pixels.
    metric : (k, c) float64
        Rows of P.
    root_weights : (n, k) float32
        Square root of the model's own weight of each pixel and row of P.
    columns : (n * k, n_columns) float32, n_columns >= n_p
        Receives, in its first n_p columns, root_weight * P dE/dp, row i * k + r for pixel i and row r of P;
        zero where the image weight is 0.

    Returns
    -------
    values : (n, c) float32
        Samples of the encoded image.
    projected : (n, k) float32
        P times the samples.
    weights : (n,) float32
        Image weight in {0, 1} of each pixel.
    """
    values, gradients, weights = sample(channels, points)
    n, n_p = len(values), warp_jacobian.shape[2]
    projected = values.astype(np.float64) @ metric.T
    steepest = np.einsum("nac,rc,ab->nrb", gradients.astype(np.float64), metric, turn)
    steepest *= (root_weights * weights[:, None]).astype(np.float64)[:, :, None]
    jacobian = np.einsum("nrb,nbp->nrp", steepest, warp_jacobian.astype(np.float64))
    columns[:, :n_p] = jacobian.reshape(n * len(metric), n_p)
    return values, projected.astype(np.float32), weights


def carry(positions: np.ndarray, corners: np.ndarray, beta: np.ndarray) -> np.ndarray:
    """Carry vertices to the pixels of a mesh: W(x; p) = sum_v beta_v(x) s_v.

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
    return np.einsum("nv,nva->na", beta, np.asarray(positions, np.float64)[corners])


def pull(slopes: np.ndarray, inverse: np.ndarray, owners: np.ndarray) -> np.ndarray:
    """Carry gradients along with the triangles: grad V = (dW/dx)^-T grad values.

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
    return np.einsum("nba,nbk->nka", inverse[owners], slopes).astype(np.float32)


def steepest(
    channels: np.ndarray, points: np.ndarray, turn: np.ndarray, metric: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Sample an encoded image, project it by a metric, and differentiate by the place.

    Parameters
    ----------
    channels : (h, w, c + 1) float32
        Encoded image.
    points : (n, 2) float64
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
    values, gradients, weights = sample(channels, points)
    projected = values.astype(np.float64) @ metric.T
    steep = np.einsum("nac,rc,ab->nrb", gradients.astype(np.float64), metric, turn)
    return values, projected.astype(np.float32), steep.astype(np.float32), weights


def mesh_products(
    steep: np.ndarray,
    root: np.ndarray,
    modes: np.ndarray,
    right: np.ndarray,
    beta: np.ndarray,
    starts: np.ndarray,
    triangles: np.ndarray,
    n_vertices: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Weighted products of the derivatives by a mesh's vertices with themselves and with other columns.

    A pixel moves with the three vertices around it only, so that of its row of derivatives,

        dr(x) / d(vertex v) = beta_v(x) steep(x),

    all but six entries are zero: this is the sparse form of J'J and A'J, before the vertices are made to follow
    the shape modes.

    Parameters
    ----------
    steep : (n, k, 2) float32
        Derivative of each pixel's residuals by the place.
    root : (n, k) float32
        Root of the weights, the image's included.
    modes : (m, n * k) float32
        A, unweighted.
    right : (b, n * k) float32
        Further columns, unweighted: of the angles, and the residual.
    beta : (n, 3) float32
        Barycentric weights of the triangle's vertices; pixels in the order of their triangles.
    starts : (t + 1,) int64
        First pixel of each triangle, and the end.
    triangles : (t, 3) int64
    n_vertices : int

    Returns
    -------
    jj : (2 n_vertices, 2 n_vertices) float64
        Vertices' coordinates x and y in turn.
    aj : (m, 2 n_vertices) float64
    rj : (b, 2 n_vertices) float64
    """
    n, k = root.shape
    owners = np.repeat(np.arange(len(triangles)), np.diff(starts))
    columns = np.zeros((n, k, n_vertices, 2))
    for corner in range(3):
        columns[np.arange(n), :, triangles[owners, corner]] = (beta[:, corner, None] * root)[..., None] * steep
    columns = columns.reshape(n * k, 2 * n_vertices)
    by_root = root.reshape(-1, 1) * columns
    return columns.T @ columns, modes @ by_root, right @ by_root


def soft_noise(
    values: np.ndarray,
    relative: np.ndarray,
    span: tuple[float, float],
    left: tuple[float, float],
    softness: float,
    floor: float,
    luminance: np.ndarray,
    unknown: float,
    most: float,
) -> np.ndarray:
    """Variance of the six channels of ``soft`` by the image's noise, to first order.

    With o = g / sqrt(|g|^2 + e^2), do/dg = (I - o o') / sqrt(|g|^2 + e^2), and the root follows from |o| itself.

    Parameters
    ----------
    values : (n, 6) float32
        Samples: o, log R, G and B, and how far those are known.
    relative : (s,) float64
        Standard deviation of the logarithm by noise, at evenly spaced logarithms.
    span : (lowest, highest)
        Of these logarithms; beyond them the nearest counts.
    left : (values, slopes)
        Share of the noise's deviation that the blur leaves, and deviation of a slope by noise of unit deviation.
    softness, floor : float
        Those of the encoding.
    luminance : (3,) float64
        Weights of R, G and B.
    unknown : float
        Variance of a logarithm that is not known.
    most : float
        Largest variance of a component of o.

    Returns
    -------
    (n, 6) float32
    """
    values = values.astype(np.float64)
    direction, logs = values[:, :2], values[:, 2:5]
    linear = np.exp(logs)
    deviation = np.interp(logs, np.linspace(*span, len(relative)), relative)
    total = linear @ luminance + floor
    slope = np.square(left[1] * deviation * linear) @ np.square(luminance) / np.square(total)
    rest = np.maximum(1.0 - np.square(direction).sum(axis=1), 0.0)
    by_component = 1.0 - np.square(direction) * (1.0 + rest[:, None])
    noise = np.zeros(values.shape, np.float32)
    noise[:, :2] = np.minimum((slope * rest / softness**2)[:, None] * by_component, most)
    # A blur averages noise away, but not what the logarithm's curvature makes of it.
    noise[:, 2:5] = np.square(left[0] * deviation) + np.square(0.5 * np.square(deviation))
    noise[values[:, 5] < 0.99, 2:5] = unknown
    return noise


def beyond_noise(residual: np.ndarray, by_noise: np.ndarray, usable: np.ndarray, limit: float) -> np.ndarray:
    """Squares of residuals, and what they have beyond noise, summed over the pixels where noise says something.

    Parameters
    ----------
    residual, by_noise : (n, k) float32
        Residuals, and their variance by noise.
    usable : (n,) bool
    limit : float
        Variance from which on a residual says nothing.

    Returns
    -------
    (k, 3) float64
        Of each row: how many count, their squares, and these less the variance by noise.
    """
    known = usable[:, None] & (by_noise < limit)
    squares = np.where(known, np.square(residual.astype(np.float64)), 0.0)
    beyond = np.where(known, squares - by_noise, 0.0)
    return np.column_stack([known.sum(axis=0), squares.sum(axis=0), beyond.sum(axis=0)])
