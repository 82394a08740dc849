"""The length of a pixel that the tags of a TIFF state: ImageJ's calibration, OME-XML, and Aperio's."""

import math
import re
from collections.abc import Mapping
from os import PathLike
from typing import Any

from liaam.errors import ImageError, LiaamError
from liaam.io.images import tags_of
from liaam.scale.lengths import Length, unit_of

_DESCRIPTION = 270
_X_RESOLUTION = 282
_Y_RESOLUTION = 283
_LONGEST = 1_000_000  # letters of a description that are looked at
_HEAD = 2000  # letters in which the root of OME-XML is, after a declaration and comments
_LONG_HEAD = 20_000  # letters in which the first sizes are, of OME-XML whose root is not named so
_SQUARE = 1e-3  # greatest relative difference of the sides of a pixel
_PIXELS = re.compile(r"<(?:\w+:)?Pixels\b[^<>]*>")  # of OME-XML
_ATTRIBUTE = re.compile(r"\b(PhysicalSize[XY](?:Unit)?)\s*=\s*[\"']([^\"'<>]{0,40})[\"']")
_APERIO = re.compile(r"\|\s*MPP\s*=\s*([\d.]{1,12})\s*(?:\||\Z)")  # micrometres per pixel
_FACT = re.compile(r"^(unit|yunit)=([^\r\n]{1,40})", re.MULTILINE)  # of ImageJ


def length_in_tags(image: str | PathLike[str] | bytes, name: str = "image") -> Length | None:
    """Return the length of a pixel that the tags of a TIFF state, as microscopes and ImageJ write them.

    Resolutions in dots per inch are no such lengths: most programs write 72 or 300 whatever the picture shows.

    Parameters
    ----------
    image : path-like or bytes
        Of an image file of any format.
    name : str
        What errors call bytes.

    Returns
    -------
    Length or None
        None where no tag states it, or the file is no TIFF.

    Raises
    ------
    ImageError
        If the file cannot be read, or states pixels that are not square.
    """
    tags = tags_of(image, name)
    name = name if isinstance(image, bytes) else str(image)
    description = _text(tags.get(_DESCRIPTION, ""))
    try:
        if description.startswith("ImageJ="):
            return _of_imagej(description, tags)
        if "<OME" in description[:_HEAD] or "PhysicalSizeX" in description[:_LONG_HEAD]:
            return _of_ome(description)
        match = _APERIO.search(description) if description.startswith("Aperio") else None
        return None if match is None else Length(float(match[1]), "um", source="Aperio's tags")
    except _NotSquareError as fault:
        raise ImageError(f"{name}: {fault}") from fault
    except (LiaamError, ValueError, ZeroDivisionError):  # a number that is none
        return None


def _text(value: Any) -> str:
    """Return the text of a tag, which Pillow takes for Latin-1 and most programs write as UTF-8."""
    data = value if isinstance(value, bytes) else str(value)[:_LONGEST].encode("latin-1", "replace")
    try:
        return data[:_LONGEST].decode("utf-8")
    except UnicodeDecodeError:
        return data[:_LONGEST].decode("latin-1")


class _NotSquareError(LiaamError):
    """Pixels that are not square."""


def _of_imagej(description: str, tags: Mapping[int, Any]) -> Length | None:
    """Return the length by ImageJ's unit and the numbers of pixels for one, which it stores as the resolution."""
    facts = dict(_FACT.findall(description))
    unit = unit_of(facts.get("unit", ""))
    across = float(tags.get(_X_RESOLUTION, 0))
    down = float(tags.get(_Y_RESOLUTION, across))
    if not unit or not across > 0:
        return None
    if unit_of(facts.get("yunit", "")) in ("", unit):
        _check_square(1 / across, 1 / down if down else math.nan)
    return Length(1 / across, unit, source="ImageJ's calibration")


def _of_ome(description: str) -> Length | None:
    """Return the length by the sizes of a pixel in OME-XML, which are in micrometres unless it says so."""
    pixels = _PIXELS.search(description)
    facts = dict(_ATTRIBUTE.findall(pixels[0])) if pixels is not None else {}
    unit = unit_of(facts.get("PhysicalSizeXUnit", "um"))
    if "PhysicalSizeX" not in facts or not unit:
        return None
    width = float(facts["PhysicalSizeX"])
    if unit_of(facts.get("PhysicalSizeYUnit", "um")) == unit:
        _check_square(width, float(facts.get("PhysicalSizeY", width)))
    return Length(width, unit, source="OME-XML")


def _check_square(width: float, height: float) -> None:
    """Raise if a pixel is clearly wider than high, or the other way."""
    if not (0 < width < math.inf and 0 < height < math.inf) or abs(width - height) <= _SQUARE * width:
        return
    sides = f"its tags state pixels of {width:.4g} x {height:.4g}, which are not square"
    raise _NotSquareError(f"{sides}: resample it to square pixels, or give --scale.")
