"""Make the wings and the figure of the guide from a folder to a table: ``python -m docs.figures.make_walk flies``.

The photographs are generated: both wings of flies, some of them torn, with a ruler. With ``--run``, the commands of
the guide follow, and its figure is written beside this script.
"""

import os
import re
import shlex
from pathlib import Path

os.environ.setdefault("MPLBACKEND", "Agg")

import cv2
import numpy as np

from docs.figures.commands import run_liaam, write_and_run
from liaam.io import Landmarks, read_image, write_image, write_landmarks
from scenes.wing import LANDMARKS, draw_wing, moved, random_wing

HERE = Path(__file__).parent
GUIDE = HERE.parent / "how-to" / "from-a-folder-to-a-table.md"

DIGITISED = 12  # Flies whose wings a person has digitised
NEW = 20
TORN = ("fly14_right", "fly19_left", "fly27_right")
ERROR = 0.6  # Standard deviation of a person's landmarks in x and in y, pixels
ASYMMETRY = (1.0, 0.8)  # Standard deviations of what differs between the sides of a fly, pixels
DIRECTIONAL = np.array([(0, 0)] * 8 + [(2.5, -1), (2.5, 0), (1, 1.5), (0, 0)], float)  # of left wings, pixels


def write_flies(folder: Path) -> dict[str, np.ndarray]:
    """Write the photographs, and the landmarks of those that are digitised; return the true landmarks of all."""
    rng = np.random.default_rng(61)
    truth = {}
    for fly in range(1, DIGITISED + NEW + 1):
        own = random_wing(rng)
        for side in ("left", "right"):
            name = f"fly{fly:02d}_{side}"
            place = folder / ("digitised" if fly <= DIGITISED else "new")
            place.mkdir(parents=True, exist_ok=True)
            shape = own + moved(rng, *ASYMMETRY) + (DIRECTIONAL if side == "left" else 0)
            wing = draw_wing(shape, rng, is_left=side == "left", is_torn=name in TORN)
            truth[name] = wing.landmarks
            write_image(place / f"{name}.png", wing.image)
            if fly <= DIGITISED:
                placed = wing.landmarks + rng.normal(0, ERROR, LANDMARKS.shape)
                write_landmarks(place / f"{name}.pts", Landmarks(placed))
    return truth


def commands_of_guide() -> list[list[str]]:
    """Return the commands of liaam in the guide, in order, as words."""
    blocks = re.findall(r"^```sh\n(.*?)^```$", GUIDE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    lines = "".join(blocks).replace("\\\n", " ").splitlines()
    commands = [shlex.split(line, comments=True) for line in lines]
    return [words[1:] for words in commands if words[:1] == ["liaam"]]


def expanded(words: list[str]) -> list[str]:
    """Return words with patterns of file names replaced by the names, as a shell does."""
    return [each for word in words for each in (sorted(map(str, Path().glob(word))) if "*" in word else [word])]


def run_commands() -> None:
    """Run the commands of the guide in the folder that holds the wings, and draw its picture."""
    for words in commands_of_guide():
        run_liaam(expanded(words))
    draw()


def draw() -> None:
    """Draw the overlays of a right wing, a left one and a torn one beside each other."""
    shown = [read_image(f"fits/{name}_fit.png") for name in ("fly13_right", "fly13_left", TORN[2])]
    picture = np.concatenate(shown, axis=1)
    small = cv2.resize(picture, None, fx=0.45, fy=0.45, interpolation=cv2.INTER_AREA)
    cv2.imwrite(str(HERE / "walk.jpg"), small[:, :, ::-1], [cv2.IMWRITE_JPEG_QUALITY, 85])


if __name__ == "__main__":
    write_and_run(write_flies, run_commands)
