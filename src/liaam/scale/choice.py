"""The length of a pixel of an image that is fitted, and what to say of it."""

import math
from collections.abc import Sequence
from pathlib import Path

from liaam.errors import ImageError
from liaam.io.landmarks import Landmarks
from liaam.scale.lengths import Length, unit_of
from liaam.scale.tags import length_in_tags

TRAINING = "the training images"
"""Source of a length that all training images have."""

_SAME = 1e-3  # greatest relative difference of scales that are the same

_SUFFIXES = (".tif", ".tiff")  # of images whose tags may state the length of a pixel


def length_of(landmarks: Landmarks) -> Length | None:
    """Return the length of a pixel that a landmark file states, if it does."""
    return None if landmarks.scale is None else Length(landmarks.scale, unit_of(landmarks.unit))


def tagged_length(image: Path) -> tuple[Length | None, str]:
    """Return the length that the tags of an image state, if they do, and why it cannot be used, or ""."""
    if image.suffix.lower() not in _SUFFIXES:
        return None, ""
    try:
        return length_in_tags(image), ""
    except ImageError as fault:
        return None, str(fault)


def length_for(image: Path, start: object, trained: Length | None) -> Length | None:
    """Return the length of a pixel of an image that is fitted: of its start, its tags, or else the training images."""
    given = length_of(start) if isinstance(start, Landmarks) else None
    return given or tagged_length(image)[0] or trained


def shared_length(lengths: Sequence[Length | None]) -> Length | None:
    """Return the length of a pixel that several images have in common; None if some differ, or lack it."""
    first = lengths[0] if lengths else None
    if first is None:
        return None
    alike = all(
        each is not None and each.unit == first.unit and math.isclose(each.value, first.value, rel_tol=_SAME)
        for each in lengths
    )
    return Length(first.value, first.unit, source=TRAINING) if alike else None


def columns_of(length: Length | None) -> dict[str, float | str | None]:
    """Return the entries of a length in a table of results."""
    if length is None:
        return {"scale": None, "scale_unit": "", "scale_from": ""}
    return {"scale": length.value, "scale_unit": length.unit, "scale_from": length.source}


def facts_of(length: Length | None) -> dict[str, float | str | None]:
    """Return the entries of a length in a file of results, without those that are unknown."""
    return {key: value for key, value in columns_of(length).items() if value or key == "scale"}
