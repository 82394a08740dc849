"""The spot protocol: person-specific models from diffuse light, fitted to a spot-lit image (paper section 7.2).

A folder holds images ``NN-Js.jpg`` of person NN under condition J with 58 landmarks each, like the IMM face database.
Models are trained on J = 1, 2, 3, 4, 6 and fitted to J = 5 (spot light). The start is the mean shape at the true
centroid and size, disturbed.
"""

import re
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from experiments.charts import figure_of_errors
from experiments.runner import Experiment, Row, markdown_table
from experiments.solvers import check_request, get_solver, make_fitters
from experiments.subjects import data_facts
from liaam.datasets import Sample, load_folder
from liaam.errors import LiaamError
from liaam.evaluation import error_statistics, inter_ocular_distance, nme
from liaam.fitting import Fitter
from liaam.model import AAM
from liaam.model.shape import rotation
from liaam.photometry import is_grey

if TYPE_CHECKING:
    from matplotlib.figure import Figure

METHODS = ("rgb", "grey", "li", "li-lit", "li-pc", "li-pcs", "soft-li")

TRAINING_CONDITIONS = ("1", "2", "3", "4", "6")
SPOT_CONDITION = "5"
EYES = (slice(13, 21), slice(21, 29))
"""Landmarks of the two eyes, counting from 0."""

CONVERGED = 0.08
"""NME below which a fit counts as converged."""

COLUMNS = {
    "method": "",
    "person": "",
    "trial": "",
    "nme": ".6f",
    "bound": ".6f",
    "converged": "",
    "iterations": "",
    "theta_deg": ".3f",
    "status": "",
}
"""Columns of results.csv. ``nme``: mean point-to-point distance as a fraction of the inter-ocular distance; ``bound``:
the same for the true shape projected on the shape model, that is, of a perfect fit; ``theta_deg``: estimated
angle of the image, NaN for methods without one."""

CHOICES = (
    "Starts: the mean shape at the true centroid and size, then turned by N(0, 4°), scaled by N(1, 0.05) and moved by "
    "N(0, 0.08 IOD) per axis (IOD: inter-ocular distance).",
    "Models keep 98 % of the variance of shape and of appearance, and are trained with θ = 122°.",
)
"""Choices that the paper leaves open."""


@dataclass(frozen=True)
class Person:
    """Images of one person: one task."""

    name: str
    training: tuple[Sample, ...]
    spot: Sample

    @property
    def key(self) -> str:
        """Key of the task in the journal."""
        return f"person {self.name}"


@dataclass(frozen=True, eq=False)
class Study:
    """One person's model and spot-lit image.

    Attributes
    ----------
    person : Person
    model : AAM
    fitters : dict of str to Fitter
        By method.
    image : (h, w, 3) uint8
    truth : (n, 2) float64
    iod : float
        Inter-ocular distance, pixels.
    """

    person: Person
    model: AAM
    fitters: dict[str, Fitter]
    image: np.ndarray
    truth: np.ndarray
    iod: float

    def start(self, seed: int, trial: int) -> np.ndarray:
        """Draw a start. It depends only on seed, person and trial, so methods share it."""
        rng = np.random.default_rng([seed, int(self.person.name), trial])
        return disturbed_start(self.model.shape_model.mean, self.truth, self.iod, rng)


def find_persons(folder: Path) -> tuple[tuple[Person, ...], tuple[str, ...]]:
    """Group a folder by person.

    Returns
    -------
    persons : tuple of Person
        Persons with all six conditions, in colour.
    left_out : tuple of str
        Unused persons, with the reasons.

    Raises
    ------
    LiaamError
        If no person is complete.
    """
    persons, left_out = group_persons(folder)
    if not persons:
        raise LiaamError(
            f"{folder}: no person has pictures NN-1, -2, -3, -4, -6 (training) and NN-5 (spot light) with 58 landmarks "
            "each; the spot experiment needs a folder named as the IMM face database is"
        )
    return persons, left_out


def group_persons(folder: Path) -> tuple[tuple[Person, ...], tuple[str, ...]]:
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
            persons.append(Person(name, tuple(pictures[j] for j in TRAINING_CONDITIONS), pictures[SPOT_CONDITION]))
    return tuple(persons), tuple(left_out)


def facts_of(folder: Path, persons: Sequence[Person]) -> dict[str, Any]:
    """Describe the images, for an experiment's settings."""
    samples = [sample for person in persons for sample in (*person.training, person.spot)]
    return {
        "data": folder.resolve().name,
        "persons": [person.name for person in persons],
        "digest": data_facts(samples)["digest"],
    }


def disturbed_start(mean: np.ndarray, truth: np.ndarray, iod: float, rng: np.random.Generator) -> np.ndarray:
    """Place the mean shape at the true centroid and size, and disturb it.

    Rotation N(0, 4 degrees), scale N(1, 0.05), translation N(0, 0.08 IOD) per axis, drawn in this order.
    """
    centred = mean - mean.mean(axis=0)
    centre = truth.mean(axis=0)
    size = np.linalg.norm(truth - centre) / np.linalg.norm(centred)
    angle = np.deg2rad(rng.normal(0.0, 4.0))
    size *= rng.normal(1.0, 0.05)
    shift = rng.normal(0.0, 0.08 * iod, 2)
    return size * centred @ rotation(angle).T + centre + shift


def study_of(person: Person, methods: Sequence[str], solver: str) -> Study:
    """Train one person's model and read the spot-lit image."""
    model = get_solver(solver).train(person.training, variance=0.98, name=person.key)
    truth = person.spot.landmarks.points
    iod = inter_ocular_distance(truth, *EYES)
    return Study(person, model, make_fitters(model, methods, solver), person.spot.read_image(), truth, iod)


def fit_person(methods: Sequence[str], trials: int, seed: int, solver: str, person: Person) -> list[Row]:
    """Fit one person's spot image with every method from the same starts."""
    study = study_of(person, methods, solver)
    bound = nme(study.model.shape_model.project(study.truth), study.truth, study.iod)
    rows = []
    for trial in range(trials):
        start = study.start(seed, trial)
        for method, fitter in study.fitters.items():
            result = fitter.fit(study.image, start, person.spot.name)
            error = nme(result.landmarks, study.truth, study.iod)
            rows.append(
                {
                    "method": method,
                    "person": person.name,
                    "trial": trial,
                    "nme": error,
                    "bound": bound,
                    "converged": error < CONVERGED,
                    "iterations": result.n_iterations,
                    "theta_deg": float(np.rad2deg(result.theta)),
                    "status": str(result.status),
                }
            )
    return rows


def spot_experiment(
    data: Path, methods: Sequence[str] = METHODS, trials: int = 3, seed: int = 0, solver: str = "liaam"
) -> Experiment:
    """Make the experiment; :data:`experiments.cli.HELP` describes the parameters."""
    check_request(methods, solver, trials)
    persons, left_out = find_persons(data)
    return Experiment(
        name="spot",
        title="Spot protocol: models from diffuse light, fitted under a spot light",
        settings={
            **facts_of(data, persons),
            "methods": list(methods),
            "trials": trials,
            "seed": seed,
            "solver": f"{solver}: {get_solver(solver).summary}",
        },
        tasks=persons,
        work=partial(fit_person, tuple(methods), trials, seed, solver),
        columns=COLUMNS,
        summarise=partial(summarise, tuple(methods), trials, seed),
        draw=draw,
        report=report,
        choices=CHOICES,
        left_out=left_out,
        skips_faults=True,
    )


def summarise(methods: Sequence[str], trials: int, seed: int, rows: list[Row]) -> dict[str, Any]:
    """Medians and rates by method."""
    return {
        "trials": trials,
        "seed": seed,
        "persons": sorted({row["person"] for row in rows}),
        "bound_median": float(np.median([row["bound"] for row in rows])),
        "methods": {method: _summary_of([row for row in rows if row["method"] == method]) for method in methods},
    }


def _summary_of(rows: list[Row]) -> dict[str, Any]:
    errors = error_statistics(np.array([row["nme"] for row in rows]))
    angles = np.array([row["theta_deg"] for row in rows])
    return {
        "nme_median": errors["median"],
        "nme_p90": errors["p90"],
        "converged": float(np.mean([row["converged"] for row in rows])),
        "iterations_median": float(np.median([row["iterations"] for row in rows])),
        "theta_deg_median": float(np.nanmedian(angles)) if np.isfinite(angles).any() else None,
    }


def draw(rows: list[Row], summary: dict[str, Any]) -> "Figure":
    """Cumulative distributions of the errors, and of the bound."""
    errors = {method: [row["nme"] for row in rows if row["method"] == method] for method in summary["methods"]}
    bounds = {row["person"]: row["bound"] for row in rows}
    return figure_of_errors(errors, bounds.values(), CONVERGED)


def report(summary: dict[str, Any]) -> str:
    """Format the question and the medians."""
    header = ["method", "median NME, %", "90th percentile, %", "converged, %", "iterations"]
    table = [
        [
            method,
            percent(cell["nme_median"]),
            percent(cell["nme_p90"]),
            percent(cell["converged"], 0),
            f"{cell['iterations_median']:.0f}",
        ]
        for method, cell in summary["methods"].items()
    ]
    table.append(["bound", percent(summary["bound_median"]), "–", "–", "–"])
    question = (
        f"Does light invariance pay on real faces? For each of {len(summary['persons'])} persons a model of that "
        "person is trained on five pictures under diffuse light and fitted to the one under a spot light (paper "
        "section 7.2). NME: mean distance to the landmarks by inter-ocular distance; converged: below 8 %; bound: the "
        "error of the true shape projected on the shape model."
    )
    return f"{question}\n\n{markdown_table(header, table)}"


def percent(share: float | None, digits: int = 2) -> str:
    """Format a fraction in per cent, or a dash."""
    return "–" if share is None else f"{100 * share:.{digits}f}"
