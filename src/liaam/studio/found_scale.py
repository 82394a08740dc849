"""The scale of a picture from the ruler or the scale bar in it, for the page to show and to ask for."""

import numpy as np

from liaam.errors import LiaamError
from liaam.scale.bars import find_bar
from liaam.scale.lengths import Length, unit_of
from liaam.scale.rulers import Ruler, find_ruler
from liaam.studio import contract
from liaam.studio.landmark_files import LONGEST, UNITS
from liaam.studio.refusal import Refusal

KINDS = ("ruler", "bar")


def found_scale(pixels: np.ndarray, size: tuple[int, int], asked: contract.ScaleQuery) -> contract.FoundScale:
    """Find the ruler or the scale bar of a picture.

    Parameters
    ----------
    pixels : (h, w, 3)
        The picture, perhaps reduced.
    size : (int, int)
        Its width and height, of whose pixels the answer is.
    asked : ScaleQuery
        What is in the picture, one of `KINDS`, and its length.

    Raises
    ------
    Refusal
        If what is asked is not clear, or if nothing is found that is.
    """
    kind = asked.kind
    unit = asked.unit
    if kind not in KINDS or unit is None or unit not in UNITS:
        raise Refusal(422, f"send kind, {' or '.join(KINDS)}, and unit, one of {', '.join(UNITS)}")
    known = _length(asked.length or "", unit)
    try:
        found = find_ruler(pixels, known) if kind == "ruler" else find_bar(pixels)
    except LiaamError as fault:
        why = str(fault).partition(": ")[0]
        other = "a scale bar" if kind == "ruler" else "a ruler"
        raise Refusal(
            422,
            f"{why[0].upper()}{why[1:]}. If the picture shows {other}, choose that in the list; or else click both "
            "ends of a known length.",
        ) from fault
    times = np.divide(size, pixels.shape[1::-1])
    ends = (found.ends + 0.5) * times - 0.5
    pixel = found.pixel(known)
    n_ticks = found.n_ticks if isinstance(found, Ruler) else None
    length = known.value * (n_ticks - 1) if n_ticks else known.value
    return {
        "bar": {"ends": ends.round(3).tolist(), "length": length, "unit": unit},
        "pixel": pixel.value / float(times[0]),
        "error": pixel.se / pixel.value,
        "ticks": n_ticks,
    }


def _length(text: str, unit: str) -> Length:
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0 < value < LONGEST:
        raise Refusal(422, "the length is not valid: enter a positive number")
    return Length(value, unit_of(unit))
