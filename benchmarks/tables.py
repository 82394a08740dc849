"""Write the times of the saved run of ``peers`` into the tables and sentences of the README files.

    python -m benchmarks peers --save && python -m benchmarks.tables

Numbers keep their decimals, and what stands around them stays. A test compares the files with the saved run.
"""

import re
from collections.abc import Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import NamedTuple

from benchmarks.metrics import BASELINE, BaselineError, Value, read_baseline

ROOT = Path(__file__).resolve().parents[1]
STILL = "mediapipe_still"
WILD = "mediapipe_wild"
NUMBER = r"\d+(?:\.\d+)?"


class Place(NamedTuple):
    """Where numbers stand: the text before each of them as a regular expression, in which a space is any white space.

    Attributes
    ----------
    file : str
        Relative to the root of the checkout.
    before : tuple of str
        What stands before each number, from one to the next.
    metrics : tuple of str
        Each is a metric of ``peers`` in ms, without ``peers_`` and ``_ms``, or one divided by another (``a / b``).
    """

    file: str
    before: tuple[str, ...]
    metrics: tuple[str, ...]

    @property
    def pattern(self) -> re.Pattern:
        """Matches the numbers as its even groups, and what stands before them as the odd ones."""
        groups = "".join(f"({before})({NUMBER})" for before in self.before)
        return re.compile(groups.replace(" ", r"\s+"))

    def with_times(self, text: str, saved: Mapping[str, Value]) -> str:
        """Return a text with the times of a saved run. Raise a ValueError if the place is not there."""
        found = self.pattern.search(text)
        if found is None:
            raise ValueError(f"{self.file} has no {self.before[0]!r}")
        numbers = [as_precise_as(found[2 * i + 2], value_of(each, saved)) for i, each in enumerate(self.metrics)]
        parts = [found[2 * i + 1] + number for i, number in enumerate(numbers)]
        return text[: found.start()] + "".join(parts) + text[found.end() :]


def value_of(metric: str, saved: Mapping[str, Value]) -> float:
    """Return a time of a saved run in ms, or the quotient of two. Raise a BaselineError if one was not measured."""
    numerator, _, denominator = metric.partition(" / ")
    value = _time_of(numerator, saved)
    return value / _time_of(denominator, saved) if denominator else value


def _time_of(name: str, saved: Mapping[str, Value]) -> float:
    time = saved.get(f"peers_{name}_ms")
    if not time:
        raise BaselineError(f"the saved run has no peers_{name}_ms: save a run of peers with all of them installed")
    return float(time)


def as_precise_as(shown: str, value: float) -> str:
    """Format a value with as many decimals as a number."""
    return f"{value:.{len(shown.partition('.')[2])}f}"


def row(file: str, name: str, before_last: int, *columns: Sequence[str]) -> Place:
    """Return the place of the last columns of the row of a table, of which each has some metrics.

    ``before_last`` is the number of columns between the name and these.
    """
    cell = r"[^|\n]*\|"
    before = []
    for i, column in enumerate(columns):
        start = rf"\| {re.escape(name)} \|" + before_last * cell if i == 0 else cell
        before += [start + r"\D*", *[r"\D+"] * (len(column) - 1)]
    # Spaces are any white space in a place, and so in names.
    return Place(file, tuple(each.replace("\\ ", " ") for each in before), tuple(chain.from_iterable(columns)))


README = "README.md"
TABLE = "benchmarks/README.md"


def _photographs(name: str, *metrics: str, of: str = STILL) -> Place:
    return row(TABLE, name, 0, metrics, [f"{each} / {of}" for each in metrics])


PLACES = (
    row(README, "liaam, `soft-li` (default)", 3, ["liaam_soft_li"]),
    row(README, "liaam, `grey`", 3, ["liaam_grey"]),
    row(README, "menpofit, gradient orientations", 3, ["menpofit_igo"]),
    row(README, "menpofit, grey values", 3, ["menpofit_grey"]),
    row(README, "OpenCV, `FacemarkAAM`", 3, ["opencv_aam"]),
    row(README, "dlib, trained on the same 24 images", 3, ["dlib_trained"]),
    row(README, "liaam, the face model that comes with it", 3, ["liaam_face", "liaam_face_found"]),
    row(README, "dlib and MediaPipe, ready-made face models", 3, ["dlib_68", STILL]),
    Place(
        README,
        ("face model takes ", " ms if you give a box, and "),
        ("liaam_face", "liaam_face_found"),
    ),
    Place(README, ("in the wild, the face model takes ", " ms, and MediaPipe "), ("liaam_face_wild", WILD)),
    Place(README, ("who was not in training takes ", " ms from a box, and "), ("liaam_photo", "liaam_photo_found")),
    row(TABLE, "liaam `soft-li`", 0, ["liaam_soft_li"]),
    row(TABLE, "liaam `soft-li`", 2, ["liaam_soft_li_iteration"]),
    row(TABLE, "liaam `li`", 0, ["liaam_li"]),
    row(TABLE, "liaam `li`", 2, ["liaam_li_iteration"]),
    row(TABLE, "liaam `grey`", 0, ["liaam_grey"]),
    row(TABLE, "liaam `grey`", 2, ["liaam_grey_iteration"]),
    row(TABLE, "menpofit, orientations", 0, ["menpofit_igo"]),
    row(TABLE, "menpofit, orientations", 2, ["menpofit_igo_iteration"]),
    row(TABLE, "menpofit, grey", 0, ["menpofit_grey"]),
    row(TABLE, "menpofit, grey", 2, ["menpofit_grey_iteration"]),
    row(TABLE, "OpenCV `FacemarkAAM`", 0, ["opencv_aam"]),
    row(TABLE, "OpenCV `FacemarkAAM`", 2, ["opencv_aam_iteration"]),
    row(TABLE, "dlib, trained on the heads", 0, ["dlib_trained"]),
    row(TABLE, "BLAS products alone", 2, ["floor_blas"]),
    _photographs("`soft-li`, a model of other persons, from a box", "liaam_photo"),
    _photographs("the same with the search", "liaam_photo_found"),
    _photographs("the same, the tracker's next frame", "liaam_photo_video"),
    _photographs("the face model that comes with liaam, from a box", "liaam_face"),
    _photographs("the same with its search", "liaam_face_found"),
    _photographs("the same in the wild: median", "liaam_face_wild", of=WILD),
    _photographs("mean", "liaam_face_wild_mean", of=WILD),
    _photographs("the slowest of 40", "liaam_face_wild_most", of=WILD),
    _photographs("dlib, 68 points from a box; its detector", "dlib_68", "dlib_detect"),
    _photographs("MediaPipe, still; the next frame of a video", STILL, "mediapipe_video"),
)
"""All places of times."""


def with_times(file: str, text: str, saved: Mapping[str, Value]) -> str:
    """Return the text of a file with the times of a saved run."""
    for place in PLACES:
        if place.file == file:
            text = place.with_times(text, saved)
    return text


def main() -> None:
    """Write the times of the saved run into the README files."""
    saved = read_baseline(BASELINE)["peers"]["metrics"]
    texts = {file: with_times(file, (ROOT / file).read_text(), saved) for file in (README, TABLE)}
    for file, text in texts.items():  # once all times are known
        (ROOT / file).write_text(text)


if __name__ == "__main__":
    main()
