"""Images given as arrays or as paths."""

import os
from pathlib import Path

import numpy as np

from liaam.errors import ImageError
from liaam.io.images import as_pixels, read_image
from liaam.photometry.encoding import as_colour


def load_picture(image, name: str) -> tuple[np.ndarray, str]:
    """Return an image with three channels, and its name in messages (a path's file name).

    It is given as an array, a path, an image of Pillow, the bytes of an image file, or an open one.
    """
    if not isinstance(image, (str, os.PathLike)):
        image = as_pixels(image, name)
        if np.ndim(image) < 2:
            raise ImageError(f"{name}: {described(image)} is not an image; give a path, or an array (height, width, 3)")
        return as_colour(image, name), name
    path = Path(image)
    return as_colour(read_image(path), path.name), path.name


def described(given: object) -> str:
    """Return what a wrong argument is, in one line: its shape if it is an array."""
    if isinstance(given, np.ndarray):
        return f"an array of shape {given.shape}"
    text = repr(given)
    return text if len(text) < 100 and "\n" not in text else f"an object of type {type(given).__name__}"


def path_of(image) -> Path | None:
    """Return the absolute path of an image that is given by its path, or None."""
    return Path(image).absolute() if isinstance(image, (str, os.PathLike)) else None
