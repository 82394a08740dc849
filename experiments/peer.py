"""menpofit's published protocol on frontal faces with simulated changes of light.

A model of several persons is fitted to other images of the same persons, or of unseen persons, under the training light
and under three changed lights. Errors are divided by 0.3 diagonals of the landmarks' box. Starts are in the true box,
slightly disturbed.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from experiments.lights import LIGHTS
from experiments.protocol import FACE, METHODS, TRAINED, Table, Trained, eight_bit, fits_experiment, group_by_person
from experiments.runner import Experiment, Named, Row
from experiments.solvers import Request
from experiments.subjects import data_facts
from liaam.datasets import Sample
from liaam.errors import LiaamError
from liaam.model.shape import diagonal_of, rotation
from liaam.plotting import figure_of_pictures

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SHOWN = ("none", "smooth", "shadow", "dapples")
"""Lights of the protocol, from :data:`experiments.lights.LIGHTS`."""

PER_FOLD = 2
"""Number of persons left out together, for unseen persons."""

AT_LEAST = 2
"""Minimum number of images of a person."""

SCALE = 0.05
TURN = float(np.deg2rad(3.0))
SHIFT = 0.03
"""Largest disturbance of a start: change of scale, rotation in radians, and shift per axis divided by the box's
diagonal."""

ORIENTATIONS = "menpofit, orientations"
RAW = "menpofit, raw RGB"
"""Names of the peer's methods."""

PUBLISHED: dict[bool, dict[str, Table]] = {
    False: {
        "none": [[RAW, "1.26", "–", "0", "–"]],
        "smooth": [[ORIENTATIONS, "1.60", "–", "18", "–"]],
        "shadow": [[ORIENTATIONS, "1.40", "–", "0", "–"]],
        "dapples": [[ORIENTATIONS, "1.50", "–", "4", "–"]],
    },
    True: {
        "none": [[ORIENTATIONS, "4.90", "–", "–", "–"]],
        "smooth": [[ORIENTATIONS, "7.50", "–", "–", "–"]],
        "shadow": [[ORIENTATIONS, "4.10", "–", "–", "–"]],
    },
}
"""Published results of menpofit, by whether persons are unseen and by light: rows of the table. Its images, lights and
starts are from other seeds, so only large differences matter."""

CHOICES = (
    f"Starts: the mean shape with centre and diagonal of the true box, scaled by ±{SCALE:.0%}, turned by "
    f"±{np.rad2deg(TURN):.0f}° and moved by ±{SHIFT:.0%} of the diagonal along each axis, all uniform.",
    "Smooth: log light is a random polynomial of second order, and each channel has a gain and an offset of its own. "
    "Shadow: half a plane keeps 0.22, 0.28 and 0.36 of the red, green and blue light. Dapples: all but spots keeps "
    "0.25, 0.30 and 0.36. Drawn anew for each start, the same for all methods.",
    f"Errors are shares of {FACE} diagonals of the landmarks' box; converged: below 8 %.",
    TRAINED,
)


@dataclass(frozen=True)
class Fold:
    """Training and test images of one model."""

    training: tuple[Sample, ...]
    tested: tuple[Sample, ...]


@lru_cache(maxsize=2)
def get_folds(folder: Path, unseen: bool) -> tuple[tuple[Fold, ...], tuple[str, ...]]:
    """Split a folder of images that are named after persons, as 01_03; once per process.

    With ``unseen``, two persons at a time are left out. Otherwise every second image of each person, from the first on,
    trains. The unused images are returned with the reasons. Raises a LiaamError if there are too few persons.
    """
    persons, left_out = group_by_person(folder, AT_LEAST)
    if not unseen:
        training = _all(samples[0::2] for samples in persons.values())
        tested = _all(samples[1::2] for samples in persons.values())
        return (Fold(training, tested),), left_out
    if len(persons) <= PER_FOLD:
        raise LiaamError(
            f"{folder}: {len(persons)} persons; with {PER_FOLD} left out none is left to train on: add some, or fit "
            "persons seen in training (without --unseen)"
        )
    groups = list(persons.values())
    folds = []
    for first in range(0, len(groups), PER_FOLD):
        end = first + PER_FOLD
        folds.append(Fold(training=_all(groups[:first] + groups[end:]), tested=_all(groups[first:end])))
    return tuple(folds), left_out


def _all(groups: Iterable[Sequence[Sample]]) -> tuple[Sample, ...]:
    """Return the samples of all groups."""
    return tuple(sample for group in groups for sample in group)


@lru_cache(maxsize=1)
def get_trained(request: Request, unseen: bool, fold: int) -> Trained:
    """Train a fold's model; once per process."""
    return Trained.on(request, get_folds(request.data, unseen)[0][fold].training, f"fold {fold}")


def box_start(mean: np.ndarray, truth: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Place the mean shape in the true bounding box and disturb scale, rotation and shift, drawn in this order."""
    size = diagonal_of(truth)
    scale = size / diagonal_of(mean) * rng.uniform(1 - SCALE, 1 + SCALE)
    turn = rotation(rng.uniform(-TURN, TURN))
    shift = rng.uniform(-SHIFT, SHIFT, 2) * size
    return scale * (mean - _middle(mean)) @ turn.T + _middle(truth) + shift


def _middle(shape: np.ndarray) -> np.ndarray:
    """Return the middle (2,) of the box around a shape (n, 2)."""
    return 0.5 * (shape.min(axis=0) + shape.max(axis=0))


def fit_picture(unseen: bool, request: Request, task: Named) -> list[Row]:
    """Fit one image under every light; a start is the same under all of them."""
    trained = get_trained(request, unseen, task.group)
    sample = next(s for s in get_folds(request.data, unseen)[0][task.group].tested if s.name == task.name)
    image = eight_bit(sample)
    truth = sample.landmarks.points
    size = FACE * diagonal_of(truth)
    rows = []
    for trial in range(request.trials):
        start = box_start(trained.mean, truth, request.rng(sample.name, trial))
        for light in SHOWN:
            changed = LIGHTS[light](image, truth, request.rng(sample.name, trial, light))
            labels = {"picture": sample.name, "light": light, "trial": trial}
            rows += trained.fit(changed, truth, size, start, **labels)
    return rows


def peer_experiment(
    data: Path,
    methods: Sequence[str] = METHODS,
    trials: int = 1,
    seed: int = 0,
    solver: str = "liaam",
    unseen: bool = False,
) -> Experiment:
    """Make the experiment; :data:`experiments.cli.HELP` describes the parameters."""
    request = Request(data, tuple(methods), trials, seed, solver)
    folds, left_out = get_folds(data, unseen)
    samples = sorted({s for fold in folds for s in (*fold.training, *fold.tested)}, key=lambda sample: sample.name)
    persons = "unseen" if unseen else "seen"
    return fits_experiment(
        request,
        partial(fit_picture, unseen),
        ("light",),
        PUBLISHED[unseen],
        name="peer",
        title=f"A peer's protocol: persons {persons} in training",
        settings={"data": data.resolve().name, **data_facts(samples), "persons": persons},
        tasks=tuple(Named(i, sample.name) for i, fold in enumerate(folds) for sample in fold.tested),
        report=f"How do we compare with a peer on its own protocol, persons {persons} in training? The rows of "
        "menpofit are its published figures (orientations: gradients' of RGB, Wiberg's algorithm, two scales), with "
        "other draws of light and start than ours.",
        pictures=partial(draw_pictures, request, unseen),
        choices=CHOICES,
        left_out=left_out,
    )


def draw_pictures(request: Request, unseen: bool) -> "Figure":
    """First tested image under every light."""
    sample = get_folds(request.data, unseen)[0][0].tested[0]
    image = eight_bit(sample)
    truth = sample.landmarks.points
    return figure_of_pictures(
        [{light: LIGHTS[light](image, truth, request.rng(sample.name, 0, light)) for light in SHOWN}]
    )
