"""Lengths with their units, and the length of a pixel."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from liaam.errors import LiaamError

UNITS = {"nm": 1e-6, "um": 1e-3, "mm": 1.0, "cm": 10.0, "m": 1000.0, "in": 25.4}
"""Units of length, in millimetres."""

_SPELLINGS = {
    "nm": ("nanometer", "nanometre"),
    "um": ("µm", "μm", "\\u00b5m", "micron", "micrometer", "micrometre"),
    "mm": ("millimeter", "millimetre"),
    "cm": ("centimeter", "centimetre"),
    "m": ("meter", "metre"),
    "in": ("inch", "inches", '"'),
}
_UNIT_OF = {spelling: unit for unit in UNITS for spelling in (unit, *_SPELLINGS[unit])}
_UNIT_OF |= {f"{spelling}s": _UNIT_OF[spelling] for spelling in [*_UNIT_OF] if len(spelling) > 4}

_NUMBER = r"(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_LENGTH = re.compile(rf"({_NUMBER})(?:\s*(?:±|\+/?-)\s*({_NUMBER}))?\s*([^\d\s/±+-]*)")
_PER_PIXEL = re.compile(r"\s*(?:/|\bper\b)\s*(?:px|pixels?)\Z", re.IGNORECASE)
_PIXELS_PER = re.compile(rf"({_NUMBER})\s*(?:px|pixels?)\s*(?:/|per\b)\s*(\S+)", re.IGNORECASE)
_DPI = re.compile(rf"({_NUMBER})\s*dpi", re.IGNORECASE)

_COMMA = re.compile(r"(?<![\d.,])(\d+),(\d+)(?![\d.,])")
_THOUSANDS = re.compile(r"[1-9]\d{0,2},\d{3}")

FEWEST = 5
"""Least number of scales in a batch to judge them by each other."""

UNLIKE = 5.0
"""Robust standard deviations from the median beyond which the logarithm of a scale is unlike the others."""

LEAST_DIFFERENCE = 0.05
"""Least relative difference of such a scale, since those of one set-up may be all the same."""


@dataclass(frozen=True)
class Length:
    """A length, such as that of a pixel.

    Attributes
    ----------
    value : float
        In its unit.
    unit : str
        One of `UNITS`; empty if unknown.
    se : float
        Standard error of the value; 0 if it is taken as exact.
    source : str
        Where it is from, for messages, or empty.
    fingerprint : str
        That of the image in which it was found (:func:`liaam.io.files.fingerprint_of`), or empty.

    Raises
    ------
    LiaamError
        If the value is not a positive number, or the error is negative or not a number.
    """

    value: float
    unit: str = ""
    se: float = 0.0
    source: str = ""
    fingerprint: str = ""

    def __post_init__(self) -> None:
        if not 0 < self.value < math.inf or not 0 <= self.se < math.inf:
            remedy = "give a positive number, and an error of 0 or more"
            raise LiaamError(f"the length {self.value:g} ± {self.se:g}: {remedy}")
        if self.unit and self.unit not in UNITS:
            raise LiaamError(f"the unit '{self.unit[:20]}' is unknown: give one of {', '.join(UNITS)}")

    def __str__(self) -> str:
        error = f" ± {self.se:.2g}" if self.se else ""
        return f"{self.value:.6g}{error} {self.unit}".strip()

    def within(self, unit: str) -> Length:
        """Return the same length in another unit; one without a unit is taken to be in it."""
        factor = UNITS[self.unit] / UNITS[unit] if self.unit and unit else 1.0
        return replace(self, value=self.value * factor, se=self.se * factor, unit=unit or self.unit)


def unit_of(text: str) -> str:
    """Return the unit that a text names, such as ``mm`` of ``millimetres``; empty if none of `UNITS`."""
    return _UNIT_OF.get(text.strip().rstrip(".").casefold(), "")


def parse_length(text: str) -> Length:
    """Parse ``5 mm``, ``0.0031mm``, ``3.1 ± 0.02 um`` or ``0.012``, perhaps per pixel, or ``322 px/mm`` or ``600 dpi``.

    The latter two are lengths of a pixel. A decimal comma is taken as a point, as in ``0,5 mm``; but ``1,250 mm`` may
    be 1.25 or 1250, and is refused.

    Raises
    ------
    LiaamError
        If it is something else, or not positive.
    """
    written = with_points(text.strip())
    dots = _DPI.fullmatch(written)
    pixels = _PIXELS_PER.fullmatch(written)
    match = _LENGTH.fullmatch(_PER_PIXEL.sub("", written))
    try:
        if dots is not None:
            return Length(1 / float(dots[1]), "in").within("mm")
        if pixels is not None and unit_of(pixels[2]):
            return Length(1 / float(pixels[1]), unit_of(pixels[2]))
        if match is not None and (unit_of(match[3]) or not match[3]):
            return Length(float(match[1]), unit_of(match[3]), float(match[2] or "0"))
    except (LiaamError, ZeroDivisionError):
        pass  # as if it were no number
    units = ", ".join(UNITS)
    raise LiaamError(f"length '{text[:60]}': give a positive number and its unit, such as 0.0031 mm (units: {units})")


def with_points(text: str) -> str:
    """Return a text whose numbers have points in place of decimal commas. Raise if a comma may separate thousands."""
    return _COMMA.sub(_with_point, text)


def _with_point(number: re.Match[str]) -> str:
    if _THOUSANDS.fullmatch(number[0]):
        digits = number[1], number[2]
        raise LiaamError(f"'{number[0]}' may be {'.'.join(digits)} or {''.join(digits)}: write one of these")
    return ".".join(number.groups())


def widened(free: float) -> float:
    """Return by what to multiply a standard error of so many degrees of freedom: 95 % are then within 1.96 of it."""
    from scipy.special import ndtri, stdtrit

    return float(stdtrit(free, 0.975) / ndtri(0.975))


def unlike(lengths: Sequence[float]) -> np.ndarray:
    """Return which lengths of a pixel, of one unit, are unlike the others of a batch.

    The logarithm of such a length is `UNLIKE` robust standard deviations (1.4826 times the median absolute deviation)
    from the median, and the length differs by `LEAST_DIFFERENCE` at least. None is where there are less than `FEWEST`.

    Parameters
    ----------
    lengths : sequence of float
        Positive; NaN where unknown.

    Returns
    -------
    (n,) bool
    """
    values = np.asarray(lengths, np.float64)
    logarithms = np.log(values, out=np.full(len(values), np.nan), where=values > 0)
    known = logarithms[np.isfinite(logarithms)]
    if len(known) < FEWEST:
        return np.zeros(len(values), bool)
    middle = np.median(known)
    spread = 1.4826 * np.median(np.abs(known - middle))
    return np.abs(logarithms - middle) > max(UNLIKE * spread, math.log1p(LEAST_DIFFERENCE))  # NaN is not
