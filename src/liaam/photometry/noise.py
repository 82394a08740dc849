"""Standard deviation of a picture's noise, in stored values."""

from __future__ import annotations

import numpy as np

from liaam.photometry.encoding import stored_values

ENOUGH = 600
"""Pixels across that :func:`noise_deviation` looks at."""

SPARSE = 5_000
"""Pixels within them that it looks at, in rows evenly apart; the median of as many is right to 2 per cent."""

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
    # So do some of its rows.
    step = max(1, image.shape[0] * image.shape[1] // SPARSE) | 1  # odd: rows of all phases of JPEG's blocks
    rows = np.arange(1, image.shape[0] - 1, step)
    whole = image.dtype.kind == "u"  # differences of integers are exact
    top = np.iinfo(image.dtype).max if whole else 1.0
    if image.dtype == np.uint8:
        from liaam.photometry import averaging  # numba: imported when first needed

        middle = _median_of_counts(averaging.bent_counts(image, rows))
    else:
        above, own, below = (
            image[rows + shift].astype(np.int32) if whole else stored_values(image[rows + shift])
            for shift in (-1, 0, 1)
        )
        bent = above - 2 * own + below
        middle = np.median(np.abs(bent[:, :-2] - 2 * bent[:, 1:-1] + bent[:, 2:]))
    return max(float(1.4826 * middle / (6.0 * top)), least)


def _median_of_counts(counts: np.ndarray) -> float:
    """Median of whole numbers of which it is known how often each occurs."""
    up_to = counts.cumsum()
    # The two in the middle, one and the same of an odd number.
    return float(np.searchsorted(up_to, ((up_to[-1] - 1) // 2, up_to[-1] // 2), side="right").mean())
