"""Export as files: the landmarks of a project; and of a fit, its landmarks, tables and pictures."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from liaam.fitting.files import fit_text
from liaam.io import Contour, Landmarks
from liaam.io.landmarks import collection_text
from liaam.io.table_writer import columns_text
from liaam.morphometry import Specimen, measure
from liaam.relighting import Lamp
from liaam.studio import layers
from liaam.studio.fits import Fit, Fits
from liaam.studio.landmark_files import text_of
from liaam.studio.pictures import png_bytes, shown
from liaam.studio.project import Project
from liaam.studio.safety import Refusal
from liaam.studio.uploads import plain_name

KINDS = {"pts": "-pts.zip", "coco": ".json", "tps": ".tps", "csv": ".csv"}
"""Kinds of files with the landmarks of a project, and the ends of their names."""

Light = tuple[Sequence[Lamp], float]
"""Lamps, and the fraction of ambient light."""

FILES = {
    "pts": "text/plain",
    "ljson": "application/json",
    "csv": "text/csv",
    "json": "application/json",
    **dict.fromkeys(("overlay", "flat", "shading", "relit"), "image/png"),
}
"""Kinds of files of a fit, and their media types."""


def export_of(project: Project, kind: str) -> tuple[str, bytes]:
    """Return the name and the content of a file with the landmarks of all pictures that have any."""
    if kind not in KINDS:
        raise Refusal(422, f"landmarks cannot be exported as '{kind[:40]}': choose one of {', '.join(KINDS)}")
    found = project.placed()
    if not found:
        raise Refusal(422, "no picture has landmarks yet: place the points of one, then export")
    name = f"{plain_name(project.root.name)}{KINDS[kind]}"
    if kind == "pts":
        stream = io.BytesIO()
        with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
            for file, landmarks, _ in found:
                archive.writestr(f"{file.stem}.pts", text_of(landmarks, ".pts"))
        return name, stream.getvalue()
    names = project.templates.needed.names
    collection = {file.name: replace(landmarks, names=names) for file, landmarks, _ in found}
    return name, collection_text(name, collection, {file.name: size for file, _, size in found}).encode()


def measurements_of(project: Project, measures: str, scale: str) -> tuple[str, bytes]:
    """Return the name and the content of a table of measurements, as ``liaam measure`` writes them."""
    found = project.placed()
    if not found:
        raise Refusal(422, "no picture has landmarks yet: place the points of one, then measure")
    names = project.templates.needed.names
    specimens = [Specimen(file.stem, own.points, names=names, scale=own.scale) for file, own, _ in found]
    columns = measure(specimens, measures.split(), scale or None)
    return f"{plain_name(project.root.name)}-measurements.csv", columns_text(columns).encode()


def file_of(fits: Fits, fit: Fit, what: str, light: Light) -> tuple[str, str, bytes]:
    """Return the name, media type and content of an exported file, one of :data:`FILES`; the light is for ``relit``."""
    if what not in FILES:
        raise Refusal(422, f"a fit cannot be exported as '{what[:40]}': choose one of {', '.join(FILES)}")
    stem, kind = plain_name(fit.source.name).rpartition(".")[0] or plain_name(fit.source.name), FILES[what]
    if kind == "image/png":
        data = png_bytes(_picture(fits, fit, what, light))
        return f"{stem}_{'fit' if what == 'overlay' else what}.png", kind, data
    landmarks = Landmarks(fit.result.landmarks, Contour.all_of(fit.model.contours), fit.model.landmark_names)
    if what == "json":
        text = fit_text(landmarks, fit.result.to_dict() | {"image": fit.source.name, "image_size": fit.source.size})
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
