"""Points of another landmarker as the start: mapped, fitted from, and weighed in, on the spot protocol.

The other landmarker is simulated: 30 points on the mesh, each with a bias of its own, and on average 5 % of the
distance between the eyes off. ``--theirs`` takes the files of a real one instead.
"""

import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from experiments.charts import figure_of_errors
from experiments.measures import or_dash
from experiments.protocol import RESULTS, Header, Table, held, median_bound, ratio, select, statistics, tell
from experiments.runner import Experiment, Row
from experiments.solvers import get_solver
from experiments.spot import CONVERGED, EYES, Person, facts_of, find_persons, percent
from liaam.errors import LiaamError
from liaam.evaluation import inter_ocular_distance, nme
from liaam.fitting import FitResult, Fitter
from liaam.io import LANDMARK_SUFFIXES, read_landmarks
from liaam.model.mesh import delaunay
from liaam.model.shape import align

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COUNT, OFF, BIAS = 30, 0.05, 0.03
"""Number of simulated points, their mean random distance from where they belong, and their root mean square bias, as
fractions of the distance between the eyes."""

WAYS = ("mapped", "box", "search", "started", "weighed", "mean", "best")
"""Their points mapped to the landmarks; fits from the true box and from a search; fits from the mapped points, and with
these weighed in; the mean of the mapped points and the fit from the box, and their best weighted mean by the truth."""

REPEATS = 3
"""Fits of which the fastest is timed."""

CHOICES = (
    "Models: those of the spot protocol, with the other landmarker's points on the same images.",
    f"Simulated points: {COUNT} random places on the mesh, each moved by a bias of {BIAS:.0%} of the distance between "
    f"the eyes, which turns with the face, and by noise of {OFF:.0%} on average in every image.",
    "Box: that of the true landmarks.",
)


@dataclass(frozen=True)
class Theirs:
    """The other landmarker: a folder of its files, or a simulation."""

    folder: Path | None
    seed: int

    def on_training(self, person: Person) -> list[np.ndarray | None]:
        """Return the points on the training images."""
        if self.folder is not None:
            return [read_points(self.folder, sample.name) for sample in person.training]
        simulated = self._simulated(person)
        rng = np.random.default_rng([self.seed, int(person.name), 0])
        return [simulated.on(sample.landmarks.points, rng) for sample in person.training]

    def on_spot(self, person: Person, trials: int) -> Iterator[np.ndarray | None]:
        """Yield the points on the spot-lit image: one for each trial, or that of the file."""
        if self.folder is not None:
            yield read_points(self.folder, person.spot.name)
            return
        simulated = self._simulated(person)
        for trial in range(trials):
            rng = np.random.default_rng([self.seed, int(person.name), 1 + trial])
            yield simulated.on(person.spot.landmarks.points, rng)

    def _simulated(self, person: Person) -> "Simulated":
        return Simulated.of(person.training[0].landmarks.points, np.random.default_rng(self.seed))


@dataclass(frozen=True, eq=False)
class Simulated:
    """A landmarker of other points.

    Attributes
    ----------
    frame : (n, 2) float64
        Landmarks in whose orientation the bias is given.
    corners : (m, 3) int
        Landmarks around each point.
    shares : (m, 3) float64
        Barycentric coordinates.
    bias : (m, 2) float64
        As a fraction of the distance between the eyes.
    """

    frame: np.ndarray
    corners: np.ndarray
    shares: np.ndarray
    bias: np.ndarray

    @classmethod
    def of(cls, frame: np.ndarray, rng: np.random.Generator) -> "Simulated":
        """Draw the points."""
        triangles = delaunay(frame)
        corners = triangles[rng.choice(len(triangles), COUNT)]
        return cls(frame, corners, rng.dirichlet([2, 2, 2], COUNT), rng.normal(0.0, BIAS / np.sqrt(2), (COUNT, 2)))

    def on(self, shape: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Return the points on an image with given landmarks (n, 2)."""
        turn, iod = align(self.frame, shape), inter_ocular_distance(shape, *EYES)
        places = np.einsum("mk,mkd->md", self.shares, shape[self.corners])
        # The mean length of N(0, s I) in the plane is s sqrt(pi / 2).
        noise = rng.normal(0.0, OFF * np.sqrt(2 / np.pi), places.shape)
        return places + iod * (self.bias @ turn.matrix.T / turn.scale + noise)


def read_points(folder: Path, name: str) -> np.ndarray | None:
    """Read the points of an image from a file with its name, or return None."""
    files = (folder / f"{Path(name).name}{suffix}" for suffix in LANDMARK_SUFFIXES)
    found = next((file for file in files if file.is_file()), None)
    return None if found is None else read_landmarks(found).points


def fit_person(theirs: Theirs, trials: int, person: Person) -> list[Row]:
    """Fit one person's spot-lit image in every way."""
    model = get_solver("liaam").train(
        person.training, variance=0.98, points=theirs.on_training(person), name=person.key
    )
    fitter, image, truth = Fitter(model), person.spot.read_image(), person.spot.landmarks.points
    assert model.points is not None
    iod = inter_ocular_distance(truth, *EYES)
    bound = nme(fitter.shapes.project(truth), truth, iod)
    box = np.concatenate([truth.min(axis=0), truth.max(axis=0)])
    rows = []
    for trial, points in enumerate(theirs.on_spot(person, trials)):
        if points is None:
            continue
        mapped = model.points(points)
        labels = {"person": person.name, "trial": trial, "bound": bound, "correlation": np.nan}
        unfitted = {"iterations": 0, "status": "", "quality": np.nan, "held_95": np.nan, "seconds": 0.0}
        rows.append({"method": "mapped", **labels, "nme": nme(mapped, truth, iod), **unfitted})
        fits: dict[str, FitResult] = {}
        for way, start in (("box", box), ("search", None), ("started", mapped), ("weighed", points)):
            result, seconds = timed(fitter, image, start)
            fits[way] = result
            rows.append(
                {
                    "method": way,
                    **labels,
                    "nme": nme(result.landmarks, truth, iod),
                    "iterations": result.n_iterations,
                    "status": str(result.status),
                    "quality": result.quality,
                    "held_95": held(result, truth, 95),
                    "seconds": seconds,
                }
            )
        means = [w * mapped + (1 - w) * fits["box"].landmarks for w in np.linspace(0.0, 1.0, 21)]
        errors = [nme(mean, truth, iod) for mean in means]
        labels["correlation"] = correlation(mapped - truth, fits["box"].landmarks - truth)
        rows.append({"method": "mean", **labels, "nme": errors[10], **unfitted})
        rows.append({"method": "best", **labels, "nme": min(errors), **unfitted})
    return rows


def correlation(one: np.ndarray, other: np.ndarray) -> float:
    """Correlation of two estimates' errors (n, 2) about zero."""
    return float((one * other).sum() / np.sqrt(np.square(one).sum() * np.square(other).sum()))


def timed(fitter: Fitter, image: np.ndarray, start) -> tuple[FitResult, float]:
    """Return a fit and the least processor time that it took."""
    times = []
    for _ in range(REPEATS):
        began = time.process_time()
        result = fitter.fit(image, start)
        times.append(time.process_time() - began)
    return result, min(times)


def points_experiment(data: Path, theirs: Path | None = None, trials: int = 3, seed: int = 0) -> Experiment:
    """Make the experiment.

    Parameters
    ----------
    data : Path
        Folder of images ``NN-Js.*`` with landmarks.
    theirs : Path, optional
        Folder of another landmarker's files, named as the images; by default it is simulated.
    trials : int
        Draws of the simulated points of an image.
    seed : int
    """
    if theirs is not None and not theirs.is_dir():
        raise LiaamError(f"{theirs} is not a folder; give the folder of the other landmarker's files")
    persons, left_out = find_persons(data)
    return Experiment(
        name="points",
        title="Points of another landmarker as the start",
        settings={
            **facts_of(data, persons),
            "theirs": "simulated" if theirs is None else theirs.resolve().name,
            "trials": 1 if theirs is not None else trials,
            "seed": seed,
        },
        tasks=persons,
        work=partial(fit_person, Theirs(theirs, seed), trials),
        columns={"method": "", "person": "", "trial": "", **RESULTS, "correlation": ".4f"},
        summarise=summarise,
        draw=draw,
        report=report,
        choices=CHOICES,
        left_out=left_out,
        skips_faults=True,
    )


def summarise(rows: list[Row]) -> dict[str, Any]:
    """Statistics of each way, with time relative to a fit from the box."""
    cells = {way: statistics(select(rows, method=way)) for way in WAYS}
    from_box = cells["box"]["seconds_median"]
    return {
        "persons": sorted({row["person"] for row in rows}),
        "bound_median": median_bound(rows),
        "methods": {way: cell | {"to_box": ratio(cell["seconds_median"], from_box)} for way, cell in cells.items()},
        "correlation": float(np.median([row["correlation"] for row in select(rows, method="mean")])),
        "p90_gain": ratio(cells["weighed"]["nme_p90"], min(cells[way]["nme_p90"] for way in ("mapped", "box"))),
    }


def table(summary: dict[str, Any]) -> tuple[Header, Table]:
    """Medians by way."""
    header = ["way", "median, %", "p90, %", "> 8 %", "time, of a fit from the box"]
    rows = [
        [
            way,
            percent(cell["nme_median"]),
            percent(cell["nme_p90"]),
            percent(cell["beyond"], 0),
            or_dash(cell["to_box"], ".2f") if cell["to_box"] else "–",
        ]
        for way, cell in summary["methods"].items()
    ]
    return header, [*rows, ["bound", percent(summary["bound_median"]), "–", "–", "–"]]


def draw(rows: list[Row], summary: dict[str, Any]) -> "Figure":
    """Cumulative distributions of the errors."""
    errors = {way: [row["nme"] for row in select(rows, method=way)] for way in summary["methods"]}
    return figure_of_errors(errors, [row["bound"] for row in select(rows, method="box")], CONVERGED)


def report(_rows: list[Row], summary: dict[str, Any]) -> str:
    """Format the question and the table."""
    question = (
        "Another landmarker has other points, which jitter. What are they worth as the start of a fit? *mapped*: "
        "their points mapped to the landmarks; *box*, *search*: fits without them; *started*: fits that only start "
        "from them; *weighed*: fits that weigh them in. The spot protocol, with images of "
        f"{len(summary['persons'])} persons. The last two combine *mapped* and *box*: their *mean*, and the *best* "
        "weighted mean of each image, which needs the truth. The median correlation of their errors is "
        f"{summary['correlation']:.2f}."
    )
    return tell(question, table(summary))
