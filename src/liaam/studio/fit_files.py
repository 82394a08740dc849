"""Export of fits as files: landmarks, tables and pictures."""

from __future__ import annotations

from collections.abc import Sequence
from urllib.parse import quote

import numpy as np

from liaam.io import Contour, Landmarks, fit_text
from liaam.relighting import Lamp
from liaam.studio import layers
from liaam.studio.fits import Fit, Fits
from liaam.studio.landmark_files import text_of
from liaam.studio.pictures import png_bytes, shown
from liaam.studio.safety import Refusal
from liaam.studio.uploads import plain_name

Light = tuple[Sequence[Lamp], float]
"""Lamps, and the fraction of ambient light."""

FILES = {
    "pts": "text/plain",
    "ljson": "application/json",
    "csv": "text/csv",
    "json": "application/json",
    **dict.fromkeys(("overlay", "flat", "shading", "relit"), "image/png"),
}
"""Kinds of exported files, and their media types."""


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
    if what not in FILES:
        raise Refusal(422, f"a fit cannot be exported as '{what[:40]}': choose one of {', '.join(FILES)}")
    stem, kind = plain_name(fit.source.name).rpartition(".")[0] or plain_name(fit.source.name), FILES[what]
    if kind == "image/png":
        data = png_bytes(_picture(fits, fit, what, light))
        return f"{stem}_{'fit' if what == 'overlay' else what}.png", kind, data
    landmarks = Landmarks(fit.result.landmarks, Contour.all_of(fit.model.contours))
    if what == "json":
        text = fit_text(landmarks, fit.result.to_dict() | {"image": fit.source.name})
    else:
        text = text_of(landmarks, f".{what}")
    return f"{stem}.{what}", kind, text.encode()


def _picture(fits: Fits, fit: Fit, what: str, light: Light) -> np.ndarray:
    """Return the picture to export, in full size."""
    size = fit.source.size
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
