"""Make the data and the figure of the guide to statistics: ``python -m docs.figures.make_leaves leaves``.

The leaves are generated, of two groups: those from shade are wider. Two people, whose errors are random, have placed
the landmarks of 30 of them. With ``--run``, the commands of the guide follow, and their figure is written beside this
script.
"""

import os
from pathlib import Path

os.environ.setdefault("MPLBACKEND", "Agg")

import numpy as np
from PIL import Image

from docs.figures.commands import run_liaam, write_and_run
from liaam.io import Landmarks, write_image, write_landmarks
from scenes.leaf import draw_leaf

HERE = Path(__file__).parent

WIDTHS = {"sun": 60.0, "shade": 70.0}  # Mean widths, pixels; they vary by 6
LABELLED = 30
NEW = 60
ERROR = 0.8  # Standard deviation of a person's landmarks in x and in y, pixels

COMMANDS = (
    "evaluate leaves/labelled --folds 5 --second leaves/second --groups leaves/groups.csv",
    "evaluate leaves/labelled --learning-curve --second leaves/second -o curve",
    "train leaves/labelled -o leaf.liaam",
    "batch leaf.liaam leaves/new -o fits.csv",
    "measure fits.csv -o table.csv --groups leaves/groups.csv",
)


def write_leaves(folder: Path) -> None:
    """Write images, the landmarks of two people, and the table of groups."""
    rng = np.random.default_rng(62)
    for name in ("labelled", "second", "new"):
        (folder / name).mkdir(parents=True)
    rows = ["specimen,group"]
    for i in range(LABELLED + NEW):
        group = list(WIDTHS)[i % 2]
        name = f"leaf{i:02d}"
        image, truth = draw_leaf(rng, WIDTHS[group])
        rows.append(f"{name},{group}")
        write_image(folder / ("labelled" if i < LABELLED else "new") / f"{name}.png", image)
        for person in ("labelled", "second") if i < LABELLED else ():
            write_landmarks(folder / person / f"{name}.pts", Landmarks(truth + rng.normal(0, ERROR, truth.shape)))
    (folder / "groups.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")


def run_commands() -> None:
    """Run the commands of the guide in the folder that holds the leaves."""
    for command in COMMANDS:
        run_liaam(command.split())
    image = Image.open("liaam-evaluation/shapes.png").convert("P", palette=Image.Palette.ADAPTIVE, colors=64)
    image.save(HERE / "statistics.png", optimize=True)


if __name__ == "__main__":
    write_and_run(write_leaves, run_commands)
