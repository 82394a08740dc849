"""What readers of pictures share: the largest size, and three channels of one."""

from pathlib import Path

import numpy as np

from liaam.errors import ImageError

MAX_PIXELS = 200_000_000
"""Default limit on width x height: larger images are refused before they are decoded."""


def check_size(path: Path | str, width: int, height: int, max_pixels: int) -> None:
    """Refuse an image of too many pixels."""
    if width * height > max_pixels:
        raise ImageError(
            f"{path} has {width} x {height} pixels, more than the {max_pixels:,} allowed: "
            "make the image smaller, or raise max_pixels."
        )


def as_three_channels(grey: np.ndarray) -> np.ndarray:
    """Give a grey image (h, w) three equal channels."""
    return np.repeat(grey[:, :, None], 3, axis=2)
