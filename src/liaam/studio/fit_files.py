"""Export of fits as files: landmarks, tables and pictures."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING
from urllib.parse import quote

from liaam.io import Contour, Landmarks, fit_text
from liaam.relighting import Lamp
from liaam.studio import layers
from liaam.studio.landmark_files import text_of
from liaam.studio.pictures import png_bytes, shown
from liaam.studio.safety import Refusal
from liaam.studio.uploads import plain_name

if TYPE_CHECKING:
    import numpy as np

    from liaam.studio.fits import Fit, Fits

Light = tuple[Sequence[Lamp], float]
"""Lamps, and the fraction of ambient light."""

FILES = ("pts", "ljson", "csv", "json", "overlay", "flat", "shading", "relit")
"""Kinds of exported files."""


def file_of(fits: Fits, fit: Fit, what: str, light: Light) -> tuple[str, str, bytes]:
    """Return the name, media type and content of an exported file.

    Parameters
    ----------
    fits : Fits
    fit : Fit
    what : str
        One of :data:`FILES`.
    light : (lamps, ambient)
        For ``relit``.
    """
    stem = plain_name(fit.source.name).rpartition(".")[0] or plain_name(fit.source.name)
    contours = Contour.all_of(fit.model.contours)
    if what in ("pts", "ljson", "csv", "json"):
        landmarks = Landmarks(fit.result.landmarks, contours)
        if what == "json":
            facts = fit.result.to_dict() | {"image": fit.source.name}
            return f"{stem}.json", "application/json", fit_text(landmarks, facts).encode()
        kind = "application/json" if what == "ljson" else "text/csv" if what == "csv" else "text/plain"
        return f"{stem}.{what}", kind, text_of(landmarks, f".{what}").encode()
    if what not in FILES:
        raise Refusal(422, f"a fit cannot be exported as '{what[:40]}': choose one of {', '.join(FILES)}")
    return (
        f"{stem}_{'fit' if what == 'overlay' else what}.png",
        "image/png",
        png_bytes(_picture(fits, fit, what, light)),
    )


def _picture(fits: Fits, fit: Fit, what: str, light: Light) -> np.ndarray:
    """Return the picture to export, in full size."""
    size = fit.source.width, fit.source.height
    if what == "relit":
        return fits.whole_light(fit).under_lamps(*light)
    if what == "flat":
        return fits.whole_light(fit).flat()
    if what == "shading":
        return layers.shading_layer(fits.whole_light(fit), size)
    from liaam.plotting import overlay

    with fits.pictures.at_work(fit.source) as pixels:
        image = shown(pixels, size, fit.source.raw)
    return overlay(image, fit.result.landmarks, fit.model, covariances=fit.result.landmark_covariances)


def attachment(name: str) -> str:
    """Return the Content-Disposition header for a file name with any characters (RFC 6266)."""
    plain = "".join(letter if letter.isascii() and (letter.isalnum() or letter in "._- ") else "_" for letter in name)
    return f"attachment; filename=\"{plain}\"; filename*=UTF-8''{quote(name, safe='')}"
