"""Standard deviation of an image's noise, in sRGB-encoded values."""

import numpy as np

from liaam.photometry.encoding import encode, stored_values
from liaam.photometry.response import Response

ENOUGH = 600  # Side of the central crop that noise_deviation uses, pixels
# Approximate number of pixels that it uses, in evenly spaced rows; their median is accurate to 2 per cent
SPARSE = 5_000
# The filter of Immerkaer: second differences (1, -2, 1) along both axes, which are zero on planes. Its 3 by 3 weights
# have a root sum of squares of 6, so that it multiplies the standard deviation of white noise by 6.
FILTER_SIDE = 3
FILTER_GAIN = 6.0
PER_MEDIAN = 1.4826  # Standard deviation of normal values per median of their magnitudes


def noise_deviation(image: np.ndarray, response: Response = "srgb") -> float:
    """Standard deviation of white noise of an image (h, w, 3), in sRGB-encoded values of [0, 1].

    Stored values of another response are first encoded so: the same image has the same noise in any encoding, and
    photon noise, which grows with the light, has about the same standard deviation in dark and in bright pixels.

    A filter that is zero on planes leaves noise and fine texture. Its median absolute response estimates the noise,
    unless texture fills more than half of the image. After Immerkaer, "Fast noise variance estimation" (CVIU 1996),
    with the median of Donoho (1995) instead of the mean. The result is at least the error of rounding to 8 bits. It is
    too small for images of JPEG, which smooths noise.
    """
    least = 1 / 255 / np.sqrt(12.0)  # of an error that is uniform within a step
    if min(image.shape[:2]) < FILTER_SIDE:
        return least
    image = _central_crop(image)
    height, width = image.shape[:2]
    step = max(1, height * width // SPARSE)
    if step % 2 == 0:  # an odd step visits rows at all positions in JPEG's blocks of 8 by 8
        step += 1
    rows = np.arange(1, height - 1, step)
    above, white = _values(image[rows - 1], response)
    centre, _ = _values(image[rows], response)
    below, _ = _values(image[rows + 1], response)
    bent = above - 2 * centre + below
    filtered = bent[:, :-2] - 2 * bent[:, 1:-1] + bent[:, 2:]
    median = np.median(np.abs(filtered))
    return max(float(PER_MEDIAN * median / (FILTER_GAIN * white)), least)


def _central_crop(image: np.ndarray) -> np.ndarray:
    """Return the middle of an image (h, w, 3), at most :data:`ENOUGH` pixels along each axis."""
    height, width = image.shape[:2]
    top = max(0, (height - ENOUGH) // 2)
    left = max(0, (width - ENOUGH) // 2)
    return image[top : top + ENOUGH, left : left + ENOUGH]


def _values(image: np.ndarray, response: Response) -> tuple[np.ndarray, float]:
    """Return the sRGB-encoded values of an image (h, w, 3), and that of white: integers as they are, else 1."""
    if response != "srgb":
        return encode(image, "value", response)[..., :3], 1.0
    if image.dtype.kind == "u":  # differences of integers are exact
        return image.astype(np.int32), float(np.iinfo(image.dtype).max)
    return stored_values(image), 1.0
