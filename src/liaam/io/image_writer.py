"""Write still images with OpenCV."""

import os
from pathlib import Path

import numpy as np

from liaam.errors import ImageError
from liaam.io.atomic import write_bytes_atomically
from liaam.io.files import as_three_channels
from liaam.io.images import IMAGE_SUFFIXES

_DEEP_SUFFIXES = (".png", ".tif", ".tiff", ".ppm", ".pgm", ".pnm")
_FLOAT_SUFFIXES = (".tif", ".tiff")


def write_image(path: str | os.PathLike[str], array: np.ndarray) -> None:
    """Write an image atomically, in the format of the suffix.

    Parameters
    ----------
    path : path-like
        Ends in one of `IMAGE_SUFFIXES`.
    array : np.ndarray
        (height, width, 3) in RGB order, or (height, width) grey. uint8 for every format; uint16 for PNG,
        TIFF, PPM and PGM; float32 for TIFF only. JPEG is written with quality 95 and full-resolution
        chroma.

    Raises
    ------
    ImageError
        If the suffix, the shape or the type cannot be written, or writing fails.
    """
    path = Path(path)
    array = np.asarray(array)
    suffix = _check_writable(path, array)
    if suffix == ".ppm" and array.ndim == 2:
        array = as_three_channels(array)
    write_bytes_atomically(path, _encode(array, suffix), ImageError)


def _check_writable(path: Path, array: np.ndarray) -> str:
    """Return the suffix in lower case after checking that it can hold this array."""
    suffix = path.suffix.lower()
    if suffix not in IMAGE_SUFFIXES:
        fault = f"'{path.suffix}' is not a known extension. Use {', '.join(IMAGE_SUFFIXES)}."
    elif array.ndim not in (2, 3) or (array.ndim == 3 and array.shape[2] != 3) or array.size == 0:
        remedy = "Give (height, width, 3) for colour or (height, width) for grey."
        fault = f"the array has shape {array.shape}. {remedy}"
    elif array.dtype not in (np.uint8, np.uint16, np.float32):
        fault = f"the values are {array.dtype}. Convert them to uint8, uint16 or float32."
    elif array.dtype == np.float32 and suffix not in _FLOAT_SUFFIXES:
        fault = f"{suffix} cannot hold float32. Use .tiff, or convert the array to uint8."
    elif array.dtype == np.uint16 and suffix not in _DEEP_SUFFIXES:
        fault = f"{suffix} cannot hold 16 bits. Use .png, or convert the array to uint8."
    elif suffix == ".pgm" and array.ndim == 3:
        fault = ".pgm is for grey images. Use .ppm or .png for colour."
    else:
        return suffix
    raise ImageError(f"{path} cannot be written: {fault}")


def _encode(array: np.ndarray, suffix: str) -> bytes:
    import cv2

    if suffix == ".pnm":
        suffix = ".pgm" if array.ndim == 2 else ".ppm"
    jpeg = [cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444]  # the quality is 95 by default
    tiff = [cv2.IMWRITE_TIFF_COMPRESSION, 1]  # none
    png = [cv2.IMWRITE_PNG_COMPRESSION, 3]  # half the time of 6, for files larger by a twelfth
    options = {".png": png, ".jpg": jpeg, ".jpeg": jpeg, ".tif": tiff, ".tiff": tiff}.get(suffix, [])
    bgr = array if array.ndim == 2 else array[:, :, ::-1]
    _, data = cv2.imencode(suffix, np.ascontiguousarray(bgr), options)
    return data.tobytes()
