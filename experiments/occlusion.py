"""How much does a textured patch over the object degrade fits of person-specific models to real faces?

Each person's spot-lit image is fitted with a model of the five others, and one diffuse image with a model of the
remaining four. Each start is used once without and once with a patch over about a fifth of the face.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from experiments.protocol import (
    EYES,
    METHODS,
    STARTS,
    TRAINED,
    Split,
    Trained,
    disturbed_start,
    eight_bit,
    fits_experiment,
)
from experiments.runner import Experiment, Row
from experiments.solvers import Request
from experiments.spot import facts_of, find_persons
from liaam.error_measures import inter_ocular_distance
from liaam.plotting import figure_of_pictures

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COVERED = 0.2
"""Fraction of the object's area under the patch."""

PATCHES = ("colours", "copy")
CELLS = 5
"""Number of random colours along each side of a patch."""

TRIES = 100
"""Number of positions to try for a patch, or for the region it copies."""

CHOICES = (
    f"Patch: a rectangle of {COVERED:.0%} of the area of the landmarks' convex hull, shaped as their box, with its "
    "corners inside the hull; it shows random smooth colours, or another place of the same picture, by turns.",
    STARTS,
    "A start is the same with and without patch. The diffuse picture is the first of the first person, the second of "
    "the next, and so on.",
    TRAINED,
)


@dataclass(frozen=True)
class Case:
    """One image of one person, in diffuse or spot light: one task.

    Kinds of patch alternate by ``turn``, the index of the person.
    """

    split: Split
    light: str
    turn: int

    @property
    def key(self) -> str:
        """Key of the task in the journal."""
        return f"{self.split.key}, {self.light}"

    def patch(self, trial: int) -> str:
        """Return the kind of patch of a trial."""
        return PATCHES[(self.turn + trial) % len(PATCHES)]


def cases_of(turn: int, person: Split) -> tuple[Case, Case]:
    """Return one person's diffuse and spot-lit image, each with its training images."""
    out = turn % len(person.training)
    others = person.training[:out] + person.training[out + 1 :]
    return (
        Case(Split(person.name, others, (person.training[out],)), "diffuse", turn),
        Case(person, "spot", turn),
    )


def patch_box(landmarks: np.ndarray, size: tuple[int, int], rng: np.random.Generator) -> tuple[int, int, int, int]:
    """Choose the position of a patch in an image of a width and height: x0, y0, x1, y1, exclusive at the end.

    It is the first of 100 positions with all corners inside the hull of the landmarks (n, 2), or else the one with most
    corners inside.
    """
    import cv2

    hull = cv2.convexHull(landmarks.astype(np.float32))
    low, extent = landmarks.min(axis=0), np.ptp(landmarks, axis=0)
    patch = extent * np.sqrt(COVERED * cv2.contourArea(hull) / np.prod(extent))
    corners = low + (extent - patch) * rng.uniform(size=(TRIES, 2))
    inside = [
        sum(cv2.pointPolygonTest(hull, (x + dx * patch[0], y + dy * patch[1]), False) >= 0 for dx, dy in CORNERS)
        for x, y in corners
    ]
    corner = corners[int(np.argmax(inside))]
    (x0, y0), (x1, y1) = (np.clip(np.rint(point).astype(int), 0, size) for point in (corner, corner + patch))
    return int(x0), int(y0), int(x1), int(y1)


CORNERS = ((0, 0), (1, 0), (0, 1), (1, 1))


def covered(image: np.ndarray, landmarks: np.ndarray, kind: str, rng: np.random.Generator) -> np.ndarray:
    """Cover about a fifth of an object in an image (h, w, 3) uint8 with a textured patch.

    The patch shows random smooth ``colours``, or a ``copy`` of another region of the same image.
    """
    x0, y0, x1, y1 = patch_box(landmarks, (image.shape[1], image.shape[0]), rng)
    size = (x1 - x0, y1 - y0)
    patch = _colours(size, rng) if kind == "colours" else _elsewhere(image, (x0, y0), size, rng)
    image = image.copy()
    image[y0:y1, x0:x1] = patch
    return image


def _colours(size: tuple[int, int], rng: np.random.Generator) -> np.ndarray:
    """Random colours with smooth transitions, (h, w, 3) uint8."""
    import cv2

    colours = rng.uniform(0, 255, (CELLS, CELLS, 3))
    return np.clip(np.rint(cv2.resize(colours, size, interpolation=cv2.INTER_CUBIC)), 0, 255).astype(np.uint8)


def _elsewhere(
    image: np.ndarray, corner: tuple[int, int], size: tuple[int, int], rng: np.random.Generator
) -> np.ndarray:
    """Copy a region of the image from another place: of several random ones, the one that overlaps least."""
    room = np.array([image.shape[1] - size[0], image.shape[0] - size[1]])
    places = rng.integers(0, room + 1, (TRIES, 2))
    overlap = np.prod(np.clip(np.array(size) - np.abs(places - corner), 0, None), axis=1)
    x, y = places[int(np.argmin(overlap))]
    return image[y : y + size[1], x : x + size[0]]


def fit_case(request: Request, case: Case) -> list[Row]:
    """Fit one image with and without patches."""
    (sample,) = case.split.tested
    trained = Trained.on(request, case.split.training, case.key)
    image, truth = eight_bit(sample), sample.landmarks.points
    iod = inter_ocular_distance(truth, *EYES)
    rows = []
    for trial in range(request.trials):
        start = disturbed_start(trained.mean, truth, iod, request.rng(sample.name, trial))
        patched = covered(image, truth, case.patch(trial), request.rng(sample.name, trial, "patch"))
        labels = {"person": case.split.name, "picture": sample.name, "light": case.light, "trial": trial}
        rows += trained.fit(image, truth, iod, start, **labels, face="bare", patch="none")
        rows += trained.fit(patched, truth, iod, start, **labels, face="covered", patch=case.patch(trial))
    return rows


def occlusion_experiment(
    data: Path, methods: Sequence[str] = METHODS, trials: int = 2, seed: int = 0, solver: str = "liaam"
) -> Experiment:
    """Make the experiment; :data:`experiments.cli.HELP` describes the parameters."""
    request = Request(data, tuple(methods), trials, seed, solver)
    persons, left_out = find_persons(data)
    cases = tuple(case for turn, person in enumerate(persons) for case in cases_of(turn, person))
    return fits_experiment(
        request,
        fit_case,
        ("light", "face"),
        name="occlusion",
        title="A textured patch over a fifth of the face",
        settings=facts_of(data, persons),
        tasks=cases,
        report="What does a patch over a fifth of the face cost? Models of one person each, fitted to a picture under "
        "the light of training and to one under a spot light. Errors by inter-ocular distance.",
        pictures=partial(draw_pictures, request, cases[0]),
        choices=CHOICES,
        left_out=left_out,
    )


def draw_pictures(request: Request, case: Case) -> "Figure":
    """First image without and with each kind of patch."""
    (sample,) = case.split.tested
    image, truth = eight_bit(sample), sample.landmarks.points
    patched = {kind: covered(image, truth, kind, request.rng(sample.name, 0, "patch")) for kind in PATCHES}
    return figure_of_pictures([{"uncovered": image, **patched}])
