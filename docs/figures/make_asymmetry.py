"""Make the picture of the guide to asymmetry: ``python -m docs.figures.make_asymmetry``. Needs no data.

The landmarks are those of generated wings of thirty flies, digitised twice. The table and the analysis of the guide are
of the same wings; the script prints them.
"""

import contextlib
import os
import sys
import tempfile
from pathlib import Path

os.environ.setdefault("MPLBACKEND", "Agg")

import numpy as np
from PIL import Image

from liaam.cli.main import app
from liaam.io import Contour, Landmarks, write_landmarks
from scenes.wing import moved

HERE = Path(__file__).parent

N_FLIES = 30
SIZE = (1000, 600)

# Landmarks of a right wing, in pixels, y downwards: hinge, veins at the margin, and crossings of veins.
WING = np.array(
    [
        (110, 300),  # 1 hinge
        (330, 190),
        (640, 165),
        (830, 230),
        (905, 315),  # 5 tip
        (800, 405),
        (560, 455),
        (300, 410),
        (350, 295),  # 9 crossings of veins
        (560, 270),
        (585, 340),
        (300, 330),
    ],
    float,
)
LINES = [(0, 1, 2, 3, 4, 5, 6, 7, 0), (0, 8, 9, 3), (0, 11, 10, 4), (11, 7), (9, 10), (10, 6)]

REACH = 250.0  # pixels over which landmarks move together

# Standard deviations of what landmarks have in common and of their own, pixels
INDIVIDUALS = (9.0, 6.0)
ASYMMETRY = (2.0, 2.5)
ERROR = (0.0, 1.2)
DIRECTIONAL = np.array([(0, 0)] * 8 + [(6, -2), (7, 1), (2, 4), (0, 0)], float)  # of left wings


def smooth(rng: np.random.Generator, deviations: tuple[float, float]) -> np.ndarray:
    """Move landmarks at random, (12, 2): together with those near them, and each for itself."""
    common, own = deviations
    return moved(rng, common, own, WING, REACH)


def digitised(rng: np.random.Generator) -> dict[str, Landmarks]:
    """Return the landmarks of both wings of all flies, by image: each photographed and digitised twice."""
    contours = tuple(Contour(line[:-1], True) if line[0] == line[-1] else Contour(line) for line in LINES)
    marks = {}
    for fly in range(1, N_FLIES + 1):
        own = WING + smooth(rng, INDIVIDUALS)
        for side in ("left", "right"):
            wing = own + smooth(rng, ASYMMETRY) + (DIRECTIONAL if side == "left" else 0)
            for record in (1, 2):
                points = wing + smooth(rng, ERROR)
                if side == "left":
                    points = points * [-1, 1] + [SIZE[0] - 1, 0]
                marks[f"fly{fly:02d}_{side}_{record}.jpg"] = Landmarks(points, contours)
    return marks


def main() -> None:
    """Write the picture beside this script, and print what the command prints."""
    rng = np.random.default_rng(7)
    with tempfile.TemporaryDirectory() as name, contextlib.chdir(name):
        folder = Path("wings")
        folder.mkdir()
        for image, marks in digitised(rng).items():
            write_landmarks(folder / f"{Path(image).stem}.ljson", marks)
        sys.argv = ["liaam", "measure", "wings", "-o", "wings.csv", "--symmetry", "matching", "--replicates", "_"]
        sys.argv += ["--scale", "0.0025", "--plot", "asymmetry.png"]
        app(standalone_mode=False)
        Image.open("asymmetry.png").convert("P", palette=Image.Palette.ADAPTIVE, colors=64).save(
            HERE / "asymmetry.png", optimize=True
        )
        for table in ("wings_asymmetry.csv", "wings_components.csv", "wings_replicates.csv"):
            print(*Path(table).read_text().splitlines()[:4], sep="\n")


if __name__ == "__main__":
    main()
