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
