"""The spot protocol: person-specific models from diffuse light, fitted to a spot-lit image (paper section 7.2).

A folder holds images ``NN-Js.jpg`` of person NN under condition J with 58 landmarks each, like the IMM face database.
Models are trained on J = 1, 2, 3, 4, 6 and fitted to J = 5 (spot light). The start is the mean shape at the true
centroid and size, disturbed.
"""

import re
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from experiments.protocol import EYES, STARTS, TRAINED, Split, Trained, disturbed_start, fits_experiment
from experiments.runner import Experiment, Row
from experiments.solvers import Request
from experiments.subjects import data_facts
from liaam.datasets import Sample, load_folder
from liaam.error_measures import inter_ocular_distance
from liaam.errors import LiaamError
from liaam.fitting import Fitter
from liaam.photometry import is_grey

METHODS = ("rgb", "grey", "li", "li-lit", "li-pc", "li-pcs", "soft-li")

TRAINING_CONDITIONS = ("1", "2", "3", "4", "6")
SPOT_CONDITION = "5"


@dataclass(frozen=True, eq=False)
class Study:
    """One person's model and spot-lit image (h, w, 3) uint8, with landmarks (n, 2) and the inter-ocular distance."""

    person: Split
    trained: Trained
    image: np.ndarray
    truth: np.ndarray
    iod: float

    @property
    def fitters(self) -> Mapping[str, Fitter]:
        """Fitters by method."""
        return self.trained.fitters

    def start(self, seed: int, trial: int) -> np.ndarray:
        """Draw a start. It depends only on seed, person and trial, so methods share it."""
        rng = np.random.default_rng([seed, int(self.person.name), trial])
        return disturbed_start(self.trained.mean, self.truth, self.iod, rng)


def find_persons(folder: Path) -> tuple[tuple[Split, ...], tuple[str, ...]]:
    """Group a folder by person: those with all six conditions, in colour, and the others with the reasons.

    Raises a LiaamError if no person is complete.
    """
    persons, left_out = group_persons(folder)
    if not persons:
        raise LiaamError(
            f"{folder}: no person has pictures NN-1, -2, -3, -4, -6 (training) and NN-5 (spot light) with 58 landmarks "
            "each; the spot experiment needs a folder named as the IMM face database is"
        )
    return persons, left_out


def group_persons(folder: Path) -> tuple[tuple[Split, ...], tuple[str, ...]]:
    """As :func:`find_persons`, but a folder without a complete person does not raise."""
    by_person: dict[str, dict[str, Sample]] = defaultdict(dict)
    data = load_folder(folder)
    persons, left_out = [], [f"{item.path.name}: {item.reason}" for item in data.left_out]
    for sample in data:
        match = re.fullmatch(r"(\d+)-(\d)\w*", Path(sample.name).name)
        if match and len(sample.landmarks.points) == 58:
            by_person[match[1]][match[2]] = sample
    for name, pictures in sorted(by_person.items()):
        missing = {*TRAINING_CONDITIONS, SPOT_CONDITION} - set(pictures)
        if missing:
            left_out.append(f"person {name}: picture {', '.join(sorted(missing))} is missing")
        elif is_grey(pictures[SPOT_CONDITION].read_image()):
            left_out.append(f"person {name}: the pictures are grey")
        else:
            persons.append(Split(name, tuple(pictures[j] for j in TRAINING_CONDITIONS), (pictures[SPOT_CONDITION],)))
    return tuple(persons), tuple(left_out)


def facts_of(folder: Path, persons: Sequence[Split]) -> dict[str, Any]:
    """Describe the images, for an experiment's settings."""
    samples = [sample for person in persons for sample in (*person.training, person.tested[0])]
    return {
        "data": folder.resolve().name,
        "persons": [person.name for person in persons],
        "digest": data_facts(samples)["digest"],
    }


def study_of(person: Split, request: Request) -> Study:
    """Train one person's model and read the spot-lit image."""
    truth = person.tested[0].landmarks.points
    trained = Trained.on(request, person.training, person.key, contours=None)
    return Study(person, trained, person.tested[0].read_image(), truth, inter_ocular_distance(truth, *EYES))


def fit_person(request: Request, person: Split) -> list[Row]:
    """Fit one person's spot image with every method from the same starts."""
    study, rows = study_of(person, request), []
    for trial in range(request.trials):
        labels = {"person": person.name, "picture": person.tested[0].name, "trial": trial}
        rows += study.trained.fit(study.image, study.truth, study.iod, study.start(request.seed, trial), **labels)
    return rows


def spot_experiment(
    data: Path, methods: Sequence[str] = METHODS, trials: int = 3, seed: int = 0, solver: str = "liaam"
) -> Experiment:
    """Make the experiment; :data:`experiments.cli.HELP` describes the parameters."""
    request = Request(data, tuple(methods), trials, seed, solver)
    persons, left_out = find_persons(data)
    return fits_experiment(
        request,
        fit_person,
        name="spot",
        title="Spot protocol: models from diffuse light, fitted under a spot light",
        settings=facts_of(data, persons),
        tasks=persons,
        report="Does light invariance pay on real faces? For each person a model of that person is trained on five "
        "pictures under diffuse light and fitted to the one under a spot light (paper section 7.2). Errors: mean "
        "distance to the landmarks by inter-ocular distance; bound: the error of the true shape projected on the shape "
        "model.",
        choices=(STARTS, TRAINED),
        left_out=left_out,
    )
