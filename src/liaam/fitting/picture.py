"""What a person gives as a picture: an array, or the name of a file."""

import os
from pathlib import Path

import numpy as np

from liaam.photometry.encoding import as_colour


def load_picture(image, name: str) -> tuple[np.ndarray, str]:
    """Picture of three channels, and what to call it, from an array or a path (whose own name is used)."""
    if not isinstance(image, (str, os.PathLike)):
        return as_colour(image, name), name
    from liaam.io import read_image

    path = Path(image)
    return as_colour(read_image(path), path.name), path.name
