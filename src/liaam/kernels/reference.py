"""Reference loops over pixels of images in plain NumPy: slow and short, they define the results of the fast ones."""

import numpy as np


def sample(channels: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Sample an encoded image bilinearly, with the exact gradient of the interpolant.

    The Jacobian is thus the derivative of the cost that is minimised. The gradient is discontinuous at pixel lines; on
    a line it is the derivative from the right (from below).

    Parameters
    ----------
    channels : (h, w, 8) float32
    points : (n, 2) float64

    Returns
    -------
    values : (n, 8) float64
        0 outside the image.
    gradients : (n, 2, 8) float64
        Derivatives by x and y; 0 outside the image.
    usable : (n,) float64
        1 where all four pixels around the point are inside the image and usable, else 0.
    """
    height, width = channels.shape[:2]
    with np.errstate(invalid="ignore"):  # points of a diverging fit may be NaN
        inside = np.asarray(((points >= 0) & (points <= [width - 1, height - 1])).all(axis=1))
    safe = np.where(inside[:, None], points, 0.0)
    x, y = np.minimum(np.floor(safe), [width - 2, height - 2]).astype(int).T
    u, v = (safe - np.stack([x, y], axis=1)).T[..., None]
    pixels, corner = channels.reshape(-1, 8), y * width + x
    c00, c10, c01, c11 = (pixels.take(corner + by, axis=0).astype(np.float64) for by in (0, 1, width, width + 1))
    usable = (c00[:, 7] > 0) & (c10[:, 7] > 0) & (c01[:, 7] > 0) & (c11[:, 7] > 0) & inside
    upper, lower = c10 - c00, c11 - c01
    along_y = c01 + u * lower - (top := c00 + u * upper)
    values, gradients = top + v * along_y, np.stack([upper + v * (lower - upper), along_y], axis=1)
    values[~inside], gradients[~inside] = 0.0, 0.0
    return values, gradients, usable.astype(float)


ON_EDGE = 1e-9
"""Tolerance on negative barycentric weights of pixels on an edge."""


def raster(points: np.ndarray, triangles: np.ndarray, width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
    """Rasterise a mesh: find the triangle of each pixel, and the pixel's barycentric weights (paper eq 3).

    Parameters
    ----------
    points : (n, 2) float64
        Vertices, all within the image.
    triangles : (t, 3) int
        A pixel on a common edge belongs to the first triangle.
    width, height : int
        Size of the image.

    Returns
    -------
    owner : (height, width) int32
        Index of the triangle; -1 outside the mesh.
    weights : (height, width, 3) float64
        Barycentric weights; 0 outside the mesh.
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


def correlate(left: np.ndarray, right: np.ndarray, out: np.ndarray) -> np.ndarray:
    """Compute the spectrum of the correlation of two images, left conj(right), summed over their two channels.

    Parameters
    ----------
    left, right : (2, h, w) float32
        Fourier transforms of real channels as packed by OpenCV's ``dft``: in each row a real number, pairs of real and
        imaginary part, and another real number if w is even. The columns of real numbers are packed in the same way.
    out : (h, w) float32
        Output, so that large arrays can be reused.

    Returns
    -------
    (h, w) float32
        ``out``, packed in the same way.
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
    """Unpack the first half of the columns, (c, h, w // 2 + 1) complex, of packed Fourier transforms (c, h, w)."""
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
    """Find the largest local maxima of an image, in descending order; ties keep raster order.

    Parameters
    ----------
    picture : (h, w) float32
        Finite values.
    count : int
        Largest number of maxima.
    least : float
        Value that a maximum must exceed.
    reach : int
        Half the size of the square neighbourhood in which no pixel may be larger.

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
