"""Read RAW files of cameras as the sensor saw the light: linear, and alike for all pictures of a camera.

LibRaw decodes them, through the optional package rawpy. Everything that would depend on the picture is switched off.
"""

from __future__ import annotations

import importlib
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from liaam.errors import ImageError
from liaam.io.files import existing_file
from liaam.io.pixels import MAX_PIXELS, as_three_channels, check_size

RAW_SUFFIXES = (".dng", ".nef", ".cr2", ".cr3", ".arw", ".orf", ".rw2", ".raf", ".pef", ".srw")
"""Endings (lower case) of the RAW files that can be read. They are told by name: many are TIFF files inside, whose
first page is a thumbnail."""


def is_raw(path: str | os.PathLike[str]) -> bool:
    """Tell by its ending whether a file is a RAW file, so that its response is "linear" whatever the camera's is.

    Examples
    --------
    >>> is_raw("holiday/DSC_0042.NEF"), is_raw("holiday/DSC_0042.JPG")
    (True, False)
    """
    return Path(path).suffix.lower() in RAW_SUFFIXES


def read_raw(path: str | os.PathLike[str], max_pixels: int = MAX_PIXELS, half_size: bool = False) -> np.ndarray:
    """Read a RAW file as linear light.

    The channels are the sensor's own: no colour matrix mixes them, which the theory of light invariance would not
    survive, and one gain multiplies all three. So a picture looks greenish; but no channel clips before its sensor
    does, photon noise grows alike in all, and the invariant does not mind fixed gains. Black is 0 and the sensor's
    white level 65535 in every picture: left to itself, LibRaw takes the brightest pixel of a bright picture for
    white. Missing colours are interpolated linearly; finer methods presuppose channels that are balanced.

    Parameters
    ----------
    path : path-like
        A file with one of the endings `RAW_SUFFIXES`.
    max_pixels : int, optional
        Files with more pixels are refused before they are decoded.
    half_size : bool
        Make one pixel of each 2 x 2 cell of the sensor instead of interpolating: nothing is invented, and the
        noise of neighbours is independent.

    Returns
    -------
    (h, w, 3) uint16
        Linear light (`response="linear"`), upright. A monochrome sensor gives three equal channels.

    Raises
    ------
    ImageError
        If rawpy is not installed, or the file is missing, too large, no RAW file, cut short, damaged, or of a sensor
        with four colours.
    """
    with _opened(path) as (rawpy, raw):
        check_size(Path(path), *_upright_size(raw), max_pixels)
        image = raw.postprocess(
            demosaic_algorithm=rawpy.DemosaicAlgorithm.LINEAR,
            half_size=half_size,
            gamma=(1, 1),
            no_auto_bright=True,
            adjust_maximum_thr=0.0,
            use_camera_wb=False,
            use_auto_wb=False,
            user_wb=[1.0, 1.0, 1.0, 1.0],
            output_color=rawpy.ColorSpace.raw,
            output_bps=16,
            highlight_mode=rawpy.HighlightMode.Clip,
        )
    image = image.reshape(*image.shape[:2], -1)
    if image.shape[2] == 1:
        return as_three_channels(image[:, :, 0])
    if image.shape[2] != 3:
        raise ImageError(
            f"{path} is of a sensor with {image.shape[2]} colours, and three are needed: convert it to a 16-bit TIFF."
        )
    return image


def raw_size(path: str | os.PathLike[str]) -> tuple[int, int]:
    """Read only the header of a RAW file: the picture's (width, height) in pixels, upright.

    Raises
    ------
    ImageError
        If rawpy is not installed, or the file is missing or no RAW file.
    """
    with _opened(path) as (_, raw):
        return _upright_size(raw)


@contextmanager
def _opened(path: str | os.PathLike[str]) -> Iterator[tuple[Any, Any]]:
    """Open a RAW file, with rawpy beside it; its faults are raised as ImageError."""
    path = existing_file(path, ImageError, "RAW file")
    try:
        rawpy = importlib.import_module("rawpy")  # optional
    except ImportError as fault:
        raise ImageError(
            f'{path} is a RAW file, and rawpy, which reads them, is not installed: pip install "liaam[raw]".'
        ) from fault
    try:
        with rawpy.imread(str(path)) as raw:
            yield rawpy, raw
    except (ImageError, MemoryError):
        raise
    except rawpy.LibRawFileUnsupportedError as fault:
        raise ImageError(
            f"{path} is no RAW file that LibRaw {'.'.join(map(str, rawpy.libraw_version))} knows, whatever its name "
            "says: convert it to DNG, or install a newer rawpy."
        ) from fault
    except Exception as fault:  # LibRaw meets bad bytes with errors of many classes
        reason = fault.args[0].decode() if fault.args and isinstance(fault.args[0], bytes) else fault
        raise ImageError(f"{path} is damaged or cut short ({reason}): copy it again from the camera.") from fault


def _upright_size(raw: Any) -> tuple[int, int]:
    """(width, height) of the picture that will come out; LibRaw gives the sensor's, and how it was turned."""
    sizes = raw.sizes
    return (sizes.iheight, sizes.iwidth) if sizes.flip in (5, 6) else (sizes.iwidth, sizes.iheight)
