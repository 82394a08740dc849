"""The core's loops over images in NumPy: they define the result of the compiled functions of the same names.

They also replace these where the core could not be built. That of the fit is :mod:`liaam.fitting.reference.problem`.
"""

import numpy as np

from liaam.encoding_constants import ALL, BRIGHTNESS, FLAT, LOG_FLOOR, LUMINANCE, SOFTNESS, UNUSABLE

CHANNELS = 8  # Channels of an encoded pixel; the last is its weight
ORIENTATIONS = 8  # Orientations of gradients that are counted apart
REACH = 3.0  # Standard deviations at which a Gaussian is truncated
ON_EDGE = 1e-9  # Tolerance on negative barycentric weights of pixels on an edge
VALUE, LOG, ORIENTATION, SOFT = range(4)  # Numbers of the encodings, as in ENCODINGS


def _block_means(values: np.ndarray, start: float, size: float, count: int) -> np.ndarray:
    """Average blocks along the first axis: differences of the cumulative sum, which is linear within a pixel."""
    n = len(values)
    edges = np.minimum(start + size * np.arange(count + 1), n)
    pixels = np.minimum(edges.astype(int), n - 1)  # that the edges cut
    sums_before = np.concatenate([np.zeros((1, *values.shape[1:])), np.cumsum(values, axis=0, dtype=np.float64)])
    parts = (edges - pixels).reshape(-1, *[1] * (values.ndim - 1))
    sums = sums_before[pixels] + parts * values[pixels]
    return np.diff(sums, axis=0) / size


def value_means(values: np.ndarray, x: float, y: float, size: float, rows: int, columns: int) -> np.ndarray:
    """Average blocks of pixels (h, w, c) to (rows, columns, c) float32.

    The first block starts at (x, y), where 0 is the border of the first pixel. Blocks of side ``size``, at least 1, may
    cut through pixels.
    """
    down = _block_means(values, y, size, rows)
    return _block_means(down.swapaxes(0, 1), x, size, columns).swapaxes(0, 1).astype(np.float32)


def stored_means(
    image: np.ndarray,
    table: np.ndarray,
    x: float,
    y: float,
    size: float,
    rows: int,
    columns: int,
) -> np.ndarray:
    """Average blocks of integer pixels (h, w, 3) in linear light: R, G, B and the fraction of usable pixels.

    ``table`` is that of :func:`liaam.photometry.encoding.light_table`; see :func:`value_means`.
    """
    pixels = table[0][image[..., 0]] * table[1][image[..., 1]] * table[2][image[..., 2]]
    return value_means(pixels, x, y, size, rows, columns)


def stored_brightness(
    image: np.ndarray, tables: np.ndarray, x: float, y: float, size: float, rows: int, columns: int
) -> np.ndarray:
    """Average the sum of the channels of integer pixels by a table for each channel, (3, n), over blocks.

    A grey image may have one table for the sum, (1, n). The means are (rows, columns) float32; see :func:`value_means`.
    """
    values = tables[0][image[..., 0]] if len(tables) == 1 else stored_luminance(image, tables)
    return value_means(values[..., None], x, y, size, rows, columns)[..., 0]


def area_means(image: np.ndarray, rows: int, columns: int) -> np.ndarray:
    """Downsample an image (h, w) to means of the blocks that tile it."""
    down = _block_means(np.asarray(image, np.float64), 0.0, image.shape[0] / rows, rows)
    return _block_means(down.T, 0.0, image.shape[1] / columns, columns).T.astype(np.float32)


def stored_luminance(image: np.ndarray, tables: np.ndarray) -> np.ndarray:
    """Sum the channels of integer pixels by a table for each channel, (3, n), to (h, w) float32."""
    channels = [tables[c][image[..., c]] for c in range(3)]
    return np.asarray(channels[0] + channels[1] + channels[2], np.float32)


def has_equal_channels(image: np.ndarray) -> bool:
    """Return whether the three channels of each pixel of an image (h, w, 3) of integers are equal."""
    return all(np.array_equal(image[..., i], image[..., i + 1]) for i in (0, 1))


def blur_planes(planes: np.ndarray, sigma: float) -> np.ndarray:
    """Blur planes (n, h, w) with standard deviation ``sigma``; border pixels are replicated."""
    from scipy.ndimage import gaussian_filter  # heavy: imported when first needed

    radius = int(np.ceil(REACH * sigma))
    sigmas = (0.0, sigma, sigma)  # each plane is blurred by itself
    blurred = gaussian_filter(planes, sigmas, output=np.float64, mode="nearest", radius=radius)
    return blurred.astype(np.float32)


def soft_directions(plane: np.ndarray, turn, softness: float) -> np.ndarray:
    """Softly normalised gradient (h, w, 2) of an image (h, w): g / sqrt(|g|^2 + softness^2).

    ``softness`` is the gradient per pixel for which the squared length is normalised to one half, and ``turn`` (4,) the
    rotation from the image's to the object's axes.
    """
    by_x = _slope(plane, axis=1)
    by_y = _slope(plane, axis=0)
    gradient = np.stack([by_x, by_y], axis=2) @ np.reshape(turn, (2, 2)).T
    length = np.sqrt(np.square(gradient).sum(axis=2) + softness**2)
    return (gradient / length[..., None]).astype(np.float32)


def _slope(plane: np.ndarray, axis: int) -> np.ndarray:
    """Central differences along an axis, and those to the one neighbour at the border; 0 for a single pixel."""
    if plane.shape[axis] < 2:
        return np.zeros_like(plane)
    return np.gradient(plane, axis=axis)


def srgb(linear: np.ndarray) -> np.ndarray:
    """Encode linear light by the sRGB curve."""
    power = np.power(np.maximum(linear, 1e-9), 1 / 2.4)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * power - 0.055)


def encode(
    light: np.ndarray,
    finite: np.ndarray | None,
    grey: bool,
    encoding: int,
    floor: float,
    blur: float,
    turn,
    pixel: float,
) -> np.ndarray:
    """Encode means of light (h, w, 4) to eight channels (h, w, 8) float32.

    ``finite`` (h, w) is the fraction of finite pixels, None if all are; ``floor`` the lower bound of light in
    logarithms, ``blur`` a standard deviation in pixels, ``turn`` and ``pixel`` see
    :func:`liaam.photometry.encoding.encode`.
    """
    colours = light[..., :3].astype(np.float64)
    usable = (light[..., 3] > ALL).astype(float)
    channels = np.zeros((*usable.shape, CHANNELS), np.float32)
    if encoding == VALUE:
        channels[..., :3] = _blurred_colours(srgb(colours), None if usable.all() else usable, blur)
        channels[..., -1] = usable
        return channels
    if encoding == ORIENTATION:
        luminance = srgb(colours) @ LUMINANCE
        luminance = _weighted_blur(luminance[None], None if usable.all() else usable, blur)[0]
        channels[..., :2] = soft_directions(luminance, turn, FLAT)
        channels[..., -1] = usable
        return channels
    # Brightness counts wherever the image is finite; colour where it is usable, and nowhere in grey images.
    valid = np.ones_like(usable) if finite is None else (finite > ALL).astype(float)
    has_colour = np.zeros_like(usable) if grey else usable
    is_weighted = finite is not None or not has_colour.all()
    logs = _blurred_colours(np.log(np.maximum(colours, floor)), has_colour if is_weighted else None, blur)
    if encoding == LOG:
        channels[..., :3] = logs
        channels[..., -1] = has_colour
        return channels
    brightness = np.log(colours @ BRIGHTNESS + LOG_FLOOR)
    brightness = _weighted_blur(brightness[None], None if finite is None else valid, blur)[0]
    channels[..., :2] = soft_directions(brightness, turn, SOFTNESS * pixel)
    channels[..., 2:5] = logs
    channels[..., 5] = has_colour
    channels[..., -1] = valid
    return channels


def count_orientations(
    brightness: np.ndarray, finite: np.ndarray | None, blur: float, turn, pixel: float
) -> np.ndarray:
    """Count the orientations of gradients of means of brightness (h, w), (h, w, ORIENTATIONS) float32.

    Orientation 0 is along x, and they proceed from x towards y. The length of the softly normalised gradient of the
    logarithm at each pixel is split between the two nearest. For the other parameters see :func:`encode`.
    """
    logs = np.log(brightness.astype(np.float64) + LOG_FLOOR)
    valid = None if finite is None else (finite > ALL).astype(float)
    directions = soft_directions(_weighted_blur(logs[None], valid, blur)[0], turn, SOFTNESS * pixel)
    across = directions[..., 0].ravel()
    down = directions[..., 1].ravel()
    length = np.hypot(across, down)
    angle = np.arctan2(down, across) * (ORIENTATIONS / (2.0 * np.pi))
    lower = np.floor(angle)
    share = angle - lower
    lower = lower.astype(int) % ORIENTATIONS
    counts = np.zeros((length.size, ORIENTATIONS), np.float32)
    pixels = np.arange(length.size)
    counts[pixels, lower] = length * (1.0 - share)
    counts[pixels, (lower + 1) % ORIENTATIONS] += length * share
    return counts.reshape(*brightness.shape, ORIENTATIONS)


def blurred_at(counts: np.ndarray, points: np.ndarray, sigma: float) -> np.ndarray:
    """Interpolate counts (h, w, ORIENTATIONS) after a blur at points (m, 2), (m, ORIENTATIONS) float32.

    The image is at least 2 by 2 pixels, and ends with those of its border, to which points beyond it are moved.
    """
    blurred = np.moveaxis(blur_planes(np.moveaxis(counts, 2, 0), sigma), 0, 2)
    inside = np.clip(points, 0.0, np.array(counts.shape[1::-1]) - 1.0)
    return sample(blurred, inside)[0].astype(np.float32)


def mean_field(
    own: np.ndarray, sampled: np.ndarray, taps: np.ndarray, strength: float, rounds: int
) -> tuple[np.ndarray, np.ndarray]:
    """Update labels (h, w), from -1 to 1, by the log odds ``own`` of each pixel, and by those of its neighbours.

    These are ``strength`` if all neighbours are of one kind. They count by a Gaussian, of which half the ``taps`` are
    given, and if they are ``sampled`` (1, else 0). Returns the labels, and their mean around each pixel.
    """
    from scipy.ndimage import correlate1d  # heavy: imported when first needed

    kernel = np.concatenate([taps[:0:-1], taps])

    def blurred(plane: np.ndarray) -> np.ndarray:
        return correlate1d(correlate1d(plane, kernel, axis=0, mode="constant"), kernel, axis=1, mode="constant")

    shares = blurred(sampled) + np.float32(1e-6)
    labels = np.tanh(0.5 * blurred(own * sampled) / shares)
    for _ in range(rounds):
        labels = np.tanh(0.5 * (own + strength * blurred(labels * sampled) / shares))
    return labels, blurred(labels * sampled) / shares


def _blurred_colours(colours: np.ndarray, weights: np.ndarray | None, sigma: float) -> np.ndarray:
    """Blur colours (h, w, 3), of which pixels count by weights (h, w), if there are any."""
    planes = np.moveaxis(colours, 2, 0)
    return np.moveaxis(_weighted_blur(planes, weights, sigma), 0, 2)


def _weighted_blur(planes: np.ndarray, weights: np.ndarray | None, sigma: float) -> np.ndarray:
    """Blur planes (n, h, w), in which pixels count by their weights (h, w) plus a little; None for equal weights."""
    if sigma <= 0.0 or weights is None:
        return blur_planes(planes, sigma)
    total = weights + UNUSABLE
    # The weight in the denominator is blurred before the little is added.
    return blur_planes(planes * total, sigma) / (blur_planes(weights[None], sigma) + UNUSABLE)


def sample(channels: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Sample an encoded image bilinearly, with the exact gradient of the interpolant.

    The Jacobian is thus the derivative of the cost that is minimised. The gradient is discontinuous at pixel lines; on
    a line it is the derivative from the right (from below). Channels are (h, w, c) and points (n, 2). Return the values
    (n, c), the derivatives by x and y (n, 2, c), both 0 outside the image, and the weights (n,): 1 where all four
    pixels around the point are inside the image and usable, else 0.
    """
    height, width, depth = channels.shape
    with np.errstate(invalid="ignore"):  # points of a diverging fit may be NaN
        inside = np.asarray(((points >= 0) & (points <= [width - 1, height - 1])).all(axis=1))
    safe = np.where(inside[:, None], points, 0.0)
    x, y = np.minimum(np.floor(safe), [width - 2, height - 2]).astype(int).T
    u, v = (safe - np.stack([x, y], axis=1)).T[..., None]
    pixels = channels.reshape(-1, depth)
    corner = y * width + x
    # The four pixels around: top left, top right, bottom left, bottom right.
    c00, c10, c01, c11 = (pixels.take(corner + by, axis=0).astype(np.float64) for by in (0, 1, width, width + 1))
    usable = (c00[:, -1] > 0) & (c10[:, -1] > 0) & (c01[:, -1] > 0) & (c11[:, -1] > 0) & inside
    by_x_top = c10 - c00
    by_x_bottom = c11 - c01
    top = c00 + u * by_x_top
    bottom = c01 + u * by_x_bottom
    by_x = by_x_top + v * (by_x_bottom - by_x_top)
    by_y = bottom - top
    values = top + v * by_y
    gradients = np.stack([by_x, by_y], axis=1)
    values[~inside] = 0.0
    gradients[~inside] = 0.0
    return values, gradients, usable.astype(float)


def sample_channels(channels: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Sample an image (h, w, c + 1) bilinearly: values (n, c) and weights (n,), float32.

    The last channel is the weight of the pixel; that of a sample is the least of the four pixels around.
    """
    values, _, _ = sample(channels, points)
    size = np.array(channels.shape[1::-1])  # width and height
    with np.errstate(invalid="ignore"):  # points may be NaN
        inside = np.asarray(((points >= 0) & (points <= size - 1)).all(axis=1))
    x, y = np.minimum(np.where(inside[:, None], points, 0.0).astype(int), size - 2).T
    weights = channels[..., -1]
    least = np.min([weights[y + i, x + j] for i in (0, 1) for j in (0, 1)], axis=0)
    return values[:, :-1].astype(np.float32), np.where(inside, least, 0.0).astype(np.float32)


def correlate(image: np.ndarray, templates: np.ndarray, product: np.ndarray) -> None:
    """Sum, over channels c, the products of spectra and the conjugates of others.

    Both are (c, 2, h, w): real and imaginary parts. The sum (h, w, 2) is written to ``product``.
    """
    of_image = image[:, 0] + 1j * image[:, 1]
    of_templates = templates[:, 0] + 1j * templates[:, 1]
    product.view(np.complex64)[..., 0] = (of_image * of_templates.conj()).sum(axis=0)


def best_peaks(image: np.ndarray, count: int, least: float, reach: int) -> tuple[np.ndarray, np.ndarray]:
    """Find up to ``count`` local maxima above ``least`` of a finite image, the largest first; ties in raster order.

    The image is (h, w). No pixel within a square of ``reach`` pixels around a maximum is larger. Return rows and
    columns (k, 2), and values (k,).
    """
    import cv2  # heavy: imported when first needed

    size = 2 * reach + 1
    square = np.ones((size, size), np.uint8)
    largest_around = cv2.dilate(np.ascontiguousarray(image), square, borderType=cv2.BORDER_REPLICATE)
    rows, columns = np.nonzero((image >= largest_around) & (image > np.float32(least)))
    best = np.argsort(-image[rows, columns], kind="stable")[:count]
    places = np.column_stack([rows, columns])[best]
    return places, image[places[:, 0], places[:, 1]]


def draw_triangles(
    points: np.ndarray, triangles: np.ndarray, values: np.ndarray, height: int, width: int
) -> tuple[np.ndarray, np.ndarray]:
    """Draw triangles (m, 3), and interpolate values of their vertices, (n, c) float64, at the pixels of an image.

    The vertices (n, 3) are (column, row, nearness), and may lie outside the image; the largest nearness is visible, and
    of equal ones the first. Return the index of each pixel's triangle, (height, width) int32, -1 where there is none,
    and the values, (height, width, c), 0 there.
    """
    owner = np.full((height, width), -1, np.int32)
    drawn = np.zeros((height, width, values.shape[1]))
    nearness = np.full((height, width), -np.inf)
    for t, corners in enumerate(triangles):
        a, b, c = points[corners]
        x0, y0 = (b - a)[:2]
        x1, y1 = (c - a)[:2]
        determinant = x0 * y1 - x1 * y0
        if determinant == 0:  # the triangle has no area
            continue
        low = np.clip(np.floor(np.min([a, b, c], axis=0)[:2]), 0, [width, height]).astype(int)
        high = np.clip(np.ceil(np.max([a, b, c], axis=0)[:2]) + 1, 0, [width, height]).astype(int)
        x, y = np.mgrid[low[0] : high[0], low[1] : high[1]].reshape(2, -1)
        # Barycentric coordinates of the pixels in the box around the triangle.
        dx = x - a[0]
        dy = y - a[1]
        v = (y1 * dx - x1 * dy) / determinant
        w = (x0 * dy - y0 * dx) / determinant
        weights = np.column_stack([1.0 - v - w, v, w])
        near = weights @ [a[2], b[2], c[2]]
        is_visible = (weights >= -ON_EDGE).all(axis=1) & (near > nearness[y, x])
        at = y[is_visible], x[is_visible]
        owner[at] = t
        nearness[at] = near[is_visible]
        drawn[at] = weights[is_visible] @ values[corners]
    return owner, drawn


def spline_slopes(values: np.ndarray, order: np.ndarray, joined: np.ndarray) -> np.ndarray:
    """Return slopes (n, k) of the cubic splines through values (n, k) float64 of runs of neighbouring pixels.

    ``order`` (n,) int32 lists the pixels along the lines, and ``joined`` (n,) uint8 says whether one and the next of
    the list are neighbours. The slopes m of a spline through f obey (m[-1] + 4 m[0] + m[1]) / 6 = (f[1] - f[-1]) / 2;
    the ends of a run have the difference to their neighbour, and pixels without one have 0.
    """
    from scipy.linalg import solve_banded  # heavy: imported when first needed

    along = values[order]
    place = np.arange(len(order))
    after = joined.astype(bool)
    before = np.roll(after, 1)
    between = before & after
    bands = np.stack([np.roll(between / 6, 1), np.where(between, 4 / 6, 1.0), np.roll(between / 6, -1)])
    rises = np.where(between, 0.5, 1.0)[:, None] * (along[place + after] - along[place - before])
    slopes = np.empty_like(along)
    slopes[order] = solve_banded((1, 1), bands, rises, check_finite=False)
    return slopes


def filter_rows_and_columns(layers: np.ndarray, across: np.ndarray, down: np.ndarray) -> None:
    """Filter (h, w, c) recursively along rows and then columns, forward and backward, in place.

    ``across`` (h, w - 1) and ``down`` (h - 1, w) are the feedback between neighbours (domain transform, Gastal and
    Oliveira, ACM TOG 2011).
    """
    _filter_lines(layers.swapaxes(0, 1), across.T)
    _filter_lines(layers, down)


def _filter_lines(lines: np.ndarray, feedback: np.ndarray) -> None:
    """Filter lines (n, m, c) forward and backward in place; ``feedback`` (n - 1, m) is that between neighbours."""
    for i in range(1, len(lines)):
        lines[i] += feedback[i - 1][:, None] * (lines[i - 1] - lines[i])
    for i in range(len(lines) - 2, -1, -1):
        lines[i] += feedback[i][:, None] * (lines[i + 1] - lines[i])
