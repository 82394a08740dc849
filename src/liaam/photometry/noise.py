"""Noise of a picture, from the picture itself."""

import numpy as np

from liaam.photometry.encoding import stored_values

ENOUGH = 600
"""Pixels across that are looked at."""

STEP = 1 / 255
"""The step between stored values of 8 bits."""


def noise_deviation(image: np.ndarray) -> float:
    """Standard deviation of white noise in stored values, from one picture.

    A mask that is blind to planes leaves noise and fine texture; its median size tells the noise unless
    texture fills more than half of the picture. After Immerkaer, "Fast noise variance estimation" (CVIU 1996), with
    the median of Donoho (1995) for his mean.

    Parameters
    ----------
    image : (h, w, 3) uint8, uint16 or float32
        Stored values.

    Returns
    -------
    float
        In values of [0, 1], at least what rounding to 8 bits leaves; JPEG's smoothing makes it too small.
    """
    least = STEP / np.sqrt(12.0)
    if min(image.shape[:2]) < 3:
        return least
    # The middle of a large picture tells enough.
    y, x = (max(0, (size - ENOUGH) // 2) for size in image.shape[:2])
    image = image[y : y + ENOUGH, x : x + ENOUGH]
    values = stored_values(image)
    bent = values[:-2] - 2 * values[1:-1] + values[2:]
    bent = bent[:, :-2] - 2 * bent[:, 1:-1] + bent[:, 2:]
    return max(float(1.4826 * np.median(np.abs(bent)) / 6.0), least)
