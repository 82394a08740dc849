"""Helpers shared by image readers."""

from pathlib import Path

import numpy as np

from liaam.errors import ImageError

MAX_PIXELS = 200_000_000
"""Default limit on width x height. Larger images are rejected before decoding."""


def check_size(path: Path | str, width: int, height: int, max_pixels: int) -> None:
    """Raise if an image has too many pixels."""
    if width * height > max_pixels:
        raise ImageError(
            f"{path} has {width} x {height} pixels, more than the {max_pixels:,} allowed: "
            "make the image smaller, or raise max_pixels."
        )


def as_three_channels(grey: np.ndarray) -> np.ndarray:
    """Stack a grey image (h, w) to three equal channels (h, w, 3)."""
    return np.repeat(grey[:, :, None], 3, axis=2)
