"""Tell the pictures that liaam has written beside results from photographs."""

from contextlib import suppress
from pathlib import Path

from liaam.io.files import real_path
from liaam.io.fit_files import read_fit

OVERLAYS = ("_fit.png", "_fit.jpg")
"""Ends of the names of overlays of fits, of small and of large images."""

CROP = "_crop.png"
"""End of the names of the parts of images around the objects."""

SCALE = "_scale.png"
"""End of the names of overlays of scales."""

_HEADER = 200  # bytes of the first line of a table that are read


def is_overlay(image: Path) -> bool:
    """Return whether an image is an overlay or a crop of a fit, which is beside it, or an overlay of a scale."""
    name, _, ending = image.name.rpartition("_")
    if f"_{ending}" == SCALE:
        return _is_scale_table(real_path(image).parent)
    return f"_{ending}" in (*OVERLAYS, CROP) and read_fit(image.with_name(f"{name}.json")) is not None


def _is_scale_table(folder: Path) -> bool:
    """Return whether the table beside a folder of overlays, which has its name, is one of scales."""
    header = b""
    with suppress(OSError), folder.with_name(f"{folder.name}.csv").open("rb") as file:
        header = file.readline(_HEADER)
    return b"image" in header and b"scale_se" in header
