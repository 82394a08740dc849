"""Standard deviation of an image's noise, in sRGB-encoded values."""

import numpy as np

from liaam.photometry.encoding import encode, stored_values
from liaam.photometry.response import Response

ENOUGH = 600  # Side of the central crop that noise_deviation uses, pixels
# Approximate number of pixels that it uses, in evenly spaced rows; their median is accurate to 2 per cent
SPARSE = 5_000


def noise_deviation(image: np.ndarray, response: Response = "srgb") -> float:
    """Standard deviation of white noise of an image (h, w, 3), in sRGB-encoded values of [0, 1].

    Stored values of another response are first encoded so: the same image has the same noise in any encoding, and
    photon noise, which grows with the light, has about the same standard deviation in dark and in bright pixels.

    A filter that is zero on planes leaves noise and fine texture. Its median absolute response estimates the noise,
    unless texture fills more than half of the image. After Immerkaer, "Fast noise variance estimation" (CVIU 1996),
    with the median of Donoho (1995) instead of the mean. The result is at least the error of rounding to 8 bits. JPEG
    smooths noise, which makes it too small.
    """
    least = 1 / 255 / np.sqrt(12.0)
    if min(image.shape[:2]) < 3:
        return least
    # The central crop of a large image suffices.
    y, x = (max(0, (size - ENOUGH) // 2) for size in image.shape[:2])
    image = image[y : y + ENOUGH, x : x + ENOUGH]
    step = max(1, image.shape[0] * image.shape[1] // SPARSE) | 1  # odd: rows at all positions in JPEG's blocks
    rows = np.arange(1, image.shape[0] - 1, step)
    parts = [image[rows + shift] for shift in (-1, 0, 1)]
    top = 1.0
    if response != "srgb":
        parts = [encode(part, "value", response)[..., :3] for part in parts]
    elif image.dtype.kind == "u":  # differences of integers are exact
        top = np.iinfo(image.dtype).max
        parts = [part.astype(np.int32) for part in parts]
    else:
        parts = [stored_values(part) for part in parts]
    above, centre, below = parts
    bent = above - 2 * centre + below
    middle = np.median(np.abs(bent[:, :-2] - 2 * bent[:, 1:-1] + bent[:, 2:]))
    return max(float(1.4826 * middle / (6.0 * top)), least)
