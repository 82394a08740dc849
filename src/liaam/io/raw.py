"""Read camera RAW files as linear sensor values, with the same processing for all images.

The optional package rawpy (LibRaw) decodes them. All processing that depends on the image content is off.
"""

import importlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from liaam.errors import ImageError, installing
from liaam.io.files import AnyPath, as_three_channels, check_size, enough_memory, existing_file

# RAW files are recognised by name, because many are TIFF files whose first page is a thumbnail.
RAW_SUFFIXES = (".dng", ".nef", ".cr2", ".cr3", ".arw", ".orf", ".rw2", ".raf", ".pef", ".srw")


def is_raw(path: AnyPath) -> bool:
    """Return whether a file is a RAW file, with linear values, by its suffix.

    Examples
    --------
    >>> is_raw("holiday/DSC_0042.NEF"), is_raw("holiday/DSC_0042.JPG")
    (True, False)
    """
    return Path(path).suffix.lower() in RAW_SUFFIXES


def read_raw(path: AnyPath, max_pixels: int | None = None) -> np.ndarray:
    """Read a RAW file as (h, w, 3) uint16 of linear light, upright.

    The channels are the sensor's own. No colour matrix mixes them, because that would break the light invariance.
    There is no white balance, so images look greenish, but fixed gains do not affect the invariant. No channel clips
    before its sensor does, and photon noise scales equally in all channels. Black is 0 and the sensor's white level is
    65535 in every image; by default LibRaw would use the brightest pixel of a bright image as white. Demosaicing is
    linear, because finer methods assume balanced channels. A monochrome sensor gives three equal channels.
    """
    with _opened(path) as (rawpy, raw):
        check_size(Path(path), *_upright_size(raw), max_pixels)
        image = raw.postprocess(
            demosaic_algorithm=rawpy.DemosaicAlgorithm.LINEAR,
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
    n_colours = 1 if image.ndim == 2 else image.shape[2]
    if n_colours == 1:
        return as_three_channels(image.reshape(image.shape[:2]))
    if n_colours != 3:
        raise ImageError(f"{path} is from a sensor with {n_colours} colours, not three: convert it to a 16-bit TIFF.")
    return image


def raw_size(path: AnyPath) -> tuple[int, int]:
    """Return (width, height) of a RAW file in pixels, upright, from the header only."""
    with _opened(path) as (_, raw):
        return _upright_size(raw)


@contextmanager
def _opened(path: AnyPath) -> Iterator[tuple[Any, Any]]:
    """Yield rawpy and an opened RAW file. Raise its errors as ImageError."""
    path = existing_file(path, ImageError, "RAW file")
    try:
        rawpy = importlib.import_module("rawpy")  # optional
    except ImportError as fault:
        need = "rawpy, which reads them, is not installed"
        raise ImageError(f"{path} is a RAW file, and {need}: {installing('raw')}.") from fault
    try:
        with enough_memory(path, ImageError), rawpy.imread(str(path)) as raw:
            yield rawpy, raw
    except ImageError:
        raise
    except rawpy.LibRawFileUnsupportedError as fault:
        what = f"a RAW file that LibRaw {'.'.join(map(str, rawpy.libraw_version))} can read"
        raise ImageError(f"{path} is not {what}: convert it to DNG, or install a newer rawpy.") from fault
    except Exception as fault:  # LibRaw raises many classes on bad bytes
        is_bytes = bool(fault.args) and isinstance(fault.args[0], bytes)
        reason = fault.args[0].decode() if is_bytes else fault
        raise ImageError(f"{path} is damaged or cut short ({reason}): copy it again from the camera.") from fault


def _upright_size(raw: Any) -> tuple[int, int]:
    """Return (width, height) of the decoded image. LibRaw gives those of the sensor, and its rotation."""
    sizes = raw.sizes
    width = sizes.iwidth
    height = sizes.iheight
    aspect = sizes.pixel_aspect
    # LibRaw stretches the image where pixels are not square, so that it never loses rows or columns.
    if aspect < 1:
        height = int(height / aspect + 0.5)
    if aspect > 1:
        width = int(width * aspect + 0.5)
    is_turned_by_a_quarter = sizes.flip in (5, 6)  # counter-clockwise and clockwise; 3 is a half turn, 0 none
    return (height, width) if is_turned_by_a_quarter else (width, height)
