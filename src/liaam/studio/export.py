"""Export of all landmarks of a project as one file."""

from __future__ import annotations

import io
import zipfile
from dataclasses import replace

from liaam.io.landmarks import collection_text
from liaam.studio.landmark_files import text_of
from liaam.studio.project import Project
from liaam.studio.safety import Refusal
from liaam.studio.uploads import plain_name

KINDS = {"pts": "-pts.zip", "coco": ".json", "tps": ".tps", "csv": ".csv"}
"""Kinds of files, and the ends of their names."""


def export_of(project: Project, kind: str) -> tuple[str, bytes]:
    """Return the name and the content of a file with the landmarks of all pictures that have any.

    Raises
    ------
    Refusal
        422 if the kind is not known, or no picture has landmarks.
    """
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
    names = project.template.names if project.template is not None else ()
    collection = {file.name: replace(landmarks, names=names) for file, landmarks, _ in found}
    return name, collection_text(name, collection, {file.name: size for file, _, size in found}).encode()
