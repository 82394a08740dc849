"""Read QR and bar codes in images, by zxing-cpp."""

from __future__ import annotations

from dataclasses import dataclass
from types import ModuleType

import cv2
import numpy as np

from liaam.errors import LiaamError, installing
from liaam.formatting import short_repr

FORMATS = "QRCode,MicroQRCode,rMQRCode,DataMatrix,Aztec,PDF417,Code128,Code93,EAN13,EAN8,UPCA,UPCE"
"""Codes that are read: those with check digits. Ticks of rulers and veins are easily taken for others."""

TURNS = (0.0, 18.0, 36.0, 54.0, 72.0)
"""Angles in degrees by which an image is turned. Bar codes are read up to about 10 degrees from the horizontal and the
vertical; other codes at any angle."""

SMALL = 2500
"""Longer side in pixels below which an image is enlarged twice, since codes whose smallest squares are two pixels wide
are read then."""

LONGEST = 100
"""Largest number of characters of a text that may name a specimen."""

_LEAST = 16  # pixels of a side of an image that may hold a code


@dataclass(frozen=True, eq=False, repr=False)
class Code:
    """A code in an image.

    Attributes
    ----------
    text : str
        What it says: printable characters, blanks taken together, at most `LONGEST`.
    corners : (4, 2) float64
        x and y of its corners, in pixels.
    """

    text: str
    corners: np.ndarray

    __repr__ = short_repr


def read_codes(image: np.ndarray) -> list[Code]:
    """Read the QR and bar codes in an image.

    Parameters
    ----------
    image : (h, w, 3) or (h, w) uint8, uint16 or float32
        Floats are from 0 to 1.

    Returns
    -------
    list of Code
        A code at each place, also where several have one text.

    Raises
    ------
    LiaamError
        If zxing-cpp is not installed.
    """
    library = decoder()
    grey = _grey(image)
    if min(grey.shape) < _LEAST:
        return []
    zoom = 2 if max(grey.shape) < SMALL else 1
    found: list[Code] = []
    for turn in TURNS:
        for code in _read_turned(library, grey, turn, zoom):
            if not any(_are_one(code, other) for other in found):
                found.append(code)
    return found


def decoder() -> ModuleType:
    """Return the library that reads codes; raise if it is not installed."""
    try:
        import zxingcpp
    except ImportError as fault:
        raise LiaamError(f"reading codes needs zxing-cpp; run {installing('codes')}") from fault
    return zxingcpp


def _grey(image: np.ndarray) -> np.ndarray:
    """Return an image as (h, w) uint8."""
    values = np.asarray(image)
    span = np.iinfo(values.dtype).max if values.dtype.kind in "iu" else 1.0
    grey = np.clip(np.nan_to_num(values.astype(np.float32)), 0, span) * (255 / span)
    return np.rint(grey.mean(axis=2) if grey.ndim == 3 else grey).astype(np.uint8)


def _read_turned(library: ModuleType, grey: np.ndarray, turn: float, zoom: int) -> list[Code]:
    """Read the codes of an image that is turned by an angle in degrees and enlarged; return them in its own pixels."""
    height, width = grey.shape
    matrix = cv2.getRotationMatrix2D(((width - 1) / 2, (height - 1) / 2), turn, zoom)
    across, down = zoom * (np.abs(matrix[:, :2]) / zoom @ (width, height))
    matrix[:, 2] += (across - width + 1) / 2 - 0.5, (down - height + 1) / 2 - 0.5
    size = (int(np.ceil(across)), int(np.ceil(down)))
    turned = cv2.warpAffine(grey, matrix, size, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_CONSTANT, borderValue=255)
    back = cv2.invertAffineTransform(matrix)
    codes = []
    formats = library.barcode_formats_from_str(FORMATS)
    for read in library.read_barcodes(turned, formats=formats, text_mode=library.TextMode.Plain):
        text = _printable(read.text)
        place = read.position
        corners = [(at.x, at.y) for at in (place.top_left, place.top_right, place.bottom_right, place.bottom_left)]
        if text:
            codes.append(Code(text, np.asarray(corners, np.float64) @ back[:, :2].T + back[:, 2]))
    return codes


def _printable(text: str) -> str:
    """Return the printable characters of a text that may name a specimen; empty if it is too long."""
    words = " ".join("".join(letter if letter.isprintable() else " " for letter in text).split())
    return words if len(words) <= LONGEST else ""


def _are_one(code: Code, other: Code) -> bool:
    """Whether two codes are one that was read twice: of one text, in one place."""
    apart = np.linalg.norm(code.corners.mean(axis=0) - other.corners.mean(axis=0))
    reach = np.linalg.norm(np.ptp(other.corners, axis=0))
    return code.text == other.text and bool(apart < reach / 2)
