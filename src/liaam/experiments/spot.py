"""The spot protocol: person-specific models from diffuse light, fitted to a spot-lit picture (paper section 7.2).

A folder holds pictures ``NN-Js.jpg`` of person NN under condition J with 58 landmarks each, as the IMM face
database does. Models are trained on J = 1, 2, 3, 4, 6 and fitted to J = 5 (spot light), starting from the mean
shape at the true centroid and size, then disturbed.
"""

import csv
import io
import json
import re
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, fields
from pathlib import Path

import numpy as np

from liaam.datasets import Sample, load_folder
from liaam.errors import LiaamError
from liaam.evaluation import inter_ocular_distance, nme
from liaam.fitting import Fitter, get_method
from liaam.io import make_folder, write_text_atomically
from liaam.model import AAM
from liaam.photometry import is_grey
from liaam.plotting import figure_of_errors, save_figure
from liaam.shape import rotation
from liaam.training import train

TRAINING_CONDITIONS = ("1", "2", "3", "4", "6")
SPOT_CONDITION = "5"
EYES = (slice(13, 21), slice(21, 29))
"""Landmarks of the two eyes, counting from 0."""

CONVERGED = 0.08
"""NME below which a fit counts as converged."""


@dataclass(frozen=True)
class SpotRow:
    """One fit, one row of results.csv.

    Attributes
    ----------
    method, person : str
    trial : int
        Counts from 0.
    nme : float
        Mean point-to-point distance as a share of the inter-ocular distance.
    bound : float
        The same for the true shape projected on the shape model: what a perfect fit could reach.
    converged : bool
        NME below 0.08.
    iterations : int
    theta_deg : float
        Estimated image angle, degrees; NaN for methods without one.
    status : str
    """

    method: str
    person: str
    trial: int
    nme: float
    bound: float
    converged: bool
    iterations: int
    theta_deg: float
    status: str


@dataclass(frozen=True)
class Person:
    """Pictures of one person."""

    name: str
    training: tuple[Sample, ...]
    spot: Sample


def find_persons(folder: Path) -> tuple[list[Person], list[str]]:
    """Group a folder by person.

    Returns
    -------
    persons : list of Person
        Those with all six conditions, in colour.
    left_out : list of str
        Who was left out, and why.

    Raises
    ------
    LiaamError
        If no person is complete.
    """
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
    if not persons:
        raise LiaamError(
            f"{folder}: no person has pictures NN-1, -2, -3, -4, -6 (training) and NN-5 (spot light) with 58 landmarks "
            "each; the spot experiment needs a folder named as the IMM face database is"
        )
    return persons, left_out


def disturbed_start(mean: np.ndarray, truth: np.ndarray, iod: float, rng: np.random.Generator) -> np.ndarray:
    """Mean shape at the true centroid and size, then disturbed.

    Rotation N(0, 4 degrees), scale N(1, 0.05), translation N(0, 0.08 IOD) per axis, drawn in this order.
    """
    centred = mean - mean.mean(axis=0)
    centre = truth.mean(axis=0)
    size = np.linalg.norm(truth - centre) / np.linalg.norm(centred)
    angle = np.deg2rad(rng.normal(0.0, 4.0))
    size *= rng.normal(1.0, 0.05)
    shift = rng.normal(0.0, 0.08 * iod, 2)
    return size * centred @ rotation(angle).T + centre + shift


def fit_person(person: Person, methods: list[str], trials: int, seed: int) -> Iterator[SpotRow]:
    """Train one person's model and fit the spot picture with every method from the same starts."""
    model: AAM = train(person.training, name=f"person {person.name}")
    image, truth = person.spot.read_image(), person.spot.landmarks.points
    iod = inter_ocular_distance(truth, *EYES)
    bound = nme(model.shape_model.project(truth), truth, iod)
    fitters = {method: Fitter(model, method) for method in methods}
    for trial in range(trials):
        rng = np.random.default_rng([seed, int(person.name), trial])
        start = disturbed_start(model.shape_model.mean, truth, iod, rng)
        for method, fitter in fitters.items():
            result = fitter.fit(image, start, person.spot.name)
            error = nme(result.shape, truth, iod)
            yield SpotRow(
                method, person.name, trial, error, bound, error < CONVERGED, result.n_iterations,
                float(np.rad2deg(result.theta)), str(result.status),
            )  # fmt: skip


def run_spot(
    data: Path,
    out: Path,
    methods: list[str],
    trials: int = 3,
    seed: int = 0,
    progress: Callable[[int, int, str], None] | None = None,
) -> dict:
    """Run the protocol and write results.csv, summary.json and figure.png.

    Parameters
    ----------
    data : Path
        Folder of pictures ``NN-Js.*`` with landmarks.
    out : Path
        Folder for the results; made if it does not exist.
    methods : list of str
    trials : int
        Starts per person.
    seed : int
        Starts depend on seed, person and trial only, so methods share them.
    progress : callable, optional
        Called with (done, total, person).

    Returns
    -------
    dict
        The summary, as written.
    """
    for method in methods:
        get_method(method)
    if trials < 1:
        raise LiaamError("trials must be at least 1")
    persons, left_out = find_persons(data)
    make_folder(out)
    rows: list[SpotRow] = []
    for i, person in enumerate(persons):
        if progress:
            progress(i, len(persons), f"person {person.name}")
        try:
            rows += list(fit_person(person, methods, trials, seed))
        except LiaamError as error:
            left_out.append(f"person {person.name}: {error}")
    if not rows:
        raise LiaamError(f"{data}: no person could be fitted; {'; '.join(left_out)}")
    if progress:
        progress(len(persons), len(persons), "figure")
    summary = summarise(rows, methods, trials, seed, left_out)
    write_text_atomically(out / "results.csv", as_csv(rows))
    errors = {method: [row.nme for row in rows if row.method == method] for method in methods}
    bounds = {row.person: row.bound for row in rows}
    save_figure(figure_of_errors(errors, bounds.values(), CONVERGED), out / "figure.png")
    write_text_atomically(out / "summary.json", json.dumps(summary, indent=2) + "\n")
    return summary


def as_csv(rows: list[SpotRow]) -> str:
    """Rows as CSV text with a header."""
    text = io.StringIO()
    writer = csv.DictWriter(text, [field.name for field in fields(SpotRow)], lineterminator="\n")
    writer.writeheader()
    writer.writerows(
        {
            **asdict(row),
            "nme": f"{row.nme:.6f}",
            "bound": f"{row.bound:.6f}",
            "theta_deg": f"{row.theta_deg:.3f}",
        }
        for row in rows
    )
    return text.getvalue()


def summarise(rows: list[SpotRow], methods: list[str], trials: int, seed: int, left_out: list[str]) -> dict:
    """Medians and rates by method."""
    return {
        "experiment": "spot",
        "trials": trials,
        "seed": seed,
        "persons": sorted({row.person for row in rows}),
        "left_out": left_out,
        "bound_median": float(np.median([row.bound for row in rows])),
        "methods": {method: _summary_of([row for row in rows if row.method == method]) for method in methods},
    }


def _summary_of(rows: list[SpotRow]) -> dict:
    errors = np.array([row.nme for row in rows])
    angles = np.array([row.theta_deg for row in rows])
    return {
        "nme_median": float(np.median(errors)),
        "nme_p90": float(np.percentile(errors, 90)),
        "converged": float((errors < CONVERGED).mean()),
        "iterations_median": float(np.median([row.iterations for row in rows])),
        "theta_deg_median": float(np.nanmedian(angles)) if np.isfinite(angles).any() else None,
    }
