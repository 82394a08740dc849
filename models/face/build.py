"""Make the face model that comes with liaam: ``python models/face/build.py FACES-CC``.

FACES-CC is a folder with the pictures and WebMorph templates of ``london/``, ``canada/`` and ``composite/``, and the
pictures of ``smiling/``; LICENSE-DATA says where they are from. ``points.json`` beside this script chooses and names
landmarks of the template. ``smiling.csv`` has the same landmarks of the smiling faces. On one machine, the model is
always the same, byte for byte.
"""

import argparse
import csv
import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

import liaam
from liaam.datasets import Sample
from liaam.io import Contour, Landmarks

HERE = Path(__file__).parent
MODEL = HERE.parents[1] / "src/liaam/models/face.liaam"

CREDIT = (
    "Model under CC BY 4.0 (https://creativecommons.org/licenses/by/4.0/), by the liaam developers, from photographs "
    "under the same licence, which were reduced, mirrored and relit: "
    "DeBruine, L. & Jones, B. (2017), Face Research Lab London Set (Version 5), doi 10.6084/m9.figshare.5047666.v5; "
    "DeBruine, L. & Jones, B. (2017), Young Adult White Faces with Manipulated Versions (Version 1), "
    "doi 10.6084/m9.figshare.4220517.v1; "
    "DeBruine, L. (2016), Young adult composite faces, doi 10.6084/m9.figshare.4055130.v1."
)

KEPT = {"mesh": 0.95, "surroundings": 0.85}
"""Fractions of the appearances' variance. That of the mesh serves relighting; with 0.98 the file exceeds 8 MB."""


def main() -> None:
    """Train the model and write it."""
    parser = argparse.ArgumentParser(description=str(__doc__).partition("\n")[0])
    parser.add_argument("folder", type=Path, help="folder with london, smiling, canada and composite")
    parser.add_argument("-o", "--output", type=Path, default=MODEL, help="model file to write")
    given = parser.parse_args()
    data = [*neutral(given.folder), *smiling(given.folder / "smiling")]
    model = liaam.train(data, appearance_variance=KEPT, name="face")
    replace(model, credit=CREDIT).save(given.output)


def scheme() -> tuple[list[int], list[str], tuple[Contour, ...]]:
    """Return the landmarks of the model: indices in the template, names, and contours."""
    known = json.loads((HERE / "points.json").read_text())
    indices, names = ([point[key] for point in known["points"]] for key in ("index", "name"))
    number = {name: i for i, name in enumerate(names)}
    lines = [tuple(number[name] for name in line) for line in known["contours"]]
    closed = [Contour(line[:-1], True) if line[0] == line[-1] else Contour(line, False) for line in lines]
    return indices, names, tuple(closed)


def neutral(folder: Path) -> Iterator[Sample]:
    """Yield the pictures with templates. Those of one person have names that begin alike, so training sees them."""
    indices, names, contours = scheme()
    for kind in ("london", "canada", "composite"):
        for file in sorted((folder / kind).glob("*.tem")):
            points = liaam.read_landmarks(file).points[indices]
            landmarks = Landmarks(points, contours, tuple(names))
            yield Sample(name_of(kind, file.stem, "neutral"), file.with_suffix(".jpg"), landmarks)


def smiling(folder: Path) -> Iterator[Sample]:
    """Yield the smiling pictures of the London set that have landmarks."""
    _, names, contours = scheme()
    with (HERE / "smiling.csv").open(newline="") as file:
        rows = sorted(csv.DictReader(file), key=lambda row: row["image"])
    for row in rows:
        points = np.array([(row[f"{name}_x"], row[f"{name}_y"]) for name in names], float)
        image = folder / row["image"]
        yield Sample(name_of("london", image.stem, "smiling"), image, Landmarks(points, contours, tuple(names)))


def name_of(kind: str, stem: str, expression: str) -> str:
    """Name a picture by its person and expression; the number after the underscore in London is of the picture."""
    person = stem.partition("_")[0] if kind == "london" else stem.replace("_", "")
    return f"{kind}{person}-{expression}"


if __name__ == "__main__":
    main()
