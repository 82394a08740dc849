"""Images given as arrays or as paths."""

import os
from pathlib import Path

import numpy as np

from liaam.photometry.encoding import as_colour


def load_picture(image, name: str) -> tuple[np.ndarray, str]:
    """Return an image with three channels from an array or a path, and its name in messages (a path's file name)."""
    if not isinstance(image, (str, os.PathLike)):
        return as_colour(image, name), name
    from liaam.io import read_image

    path = Path(image)
    return as_colour(read_image(path), path.name), path.name
