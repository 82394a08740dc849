"""Helpers shared by protocols on folders of many persons: grouping by person, rows of fits, and statistics."""

import re
import time
import warnings
import zlib
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from experiments import spot
from experiments.measures import roc_area
from experiments.runner import Row, markdown_table
from experiments.solvers import check_request, get_solver, make_fitters
from experiments.spot import CONVERGED, EYES
from liaam.datasets import Sample, load_folder
from liaam.errors import LiaamError
from liaam.evaluation import (
    Contours,
    along_and_across,
    contour_directions,
    error_statistics,
    finite_or_none,
    inter_ocular_distance,
    nme,
    outline_errors,
    within_ellipses,
    within_intervals,
)
from liaam.fitting import FitResult, Fitter
from liaam.model import AAM
from liaam.model.shape import diagonal_of
from liaam.photometry import is_grey
from liaam.photometry.encoding import as_colour

METHODS = ("rgb", "grey", "li", "igo", "soft-li")
"""Methods that are compared by default."""

VARIANCE = 0.98
"""Fraction of the variance of shape and of appearance that models keep."""

EYES_BY_COUNT = {58: EYES, 68: (slice(36, 42), slice(42, 48)), 73: (slice(16, 24), slice(24, 32))}
"""Landmarks of the two eyes by the number of landmarks (IMM, 300-W, and IMM frontal), counting from 0."""

CONTOURS_BY_COUNT = {
    58: [(0, 12), (13, 20, True), (21, 28, True), (29, 33), (34, 38), (39, 46, True), (47, 57)],
    68: [
        (0, 16),
        (17, 21),
        (22, 26),
        (27, 30),
        (31, 35),
        (36, 41, True),
        (42, 47, True),
        (48, 59, True),
        (60, 67, True),
    ],
}
"""First and last landmark of each contour, counting from 0, and whether it is closed, by the number of landmarks (IMM,
300-W), whose files have no contours."""

FACE = 0.3
"""Substitute for the inter-ocular distance if the eye landmarks are unknown, in diagonals of the landmarks' box."""

RESULTS = {
    "nme": ".6f",
    "bound": ".6f",
    "iterations": "",
    "status": "",
    "quality": ".4f",
    "held_95": ".6f",
    "seconds": ".4f",
}
"""Columns of results.csv that every fit has. ``nme``: mean distance to the landmarks in the protocol's unit.
``bound``: the same for the true shape projected on the shape model. ``held_95``: fraction of the landmarks inside their
95 % ellipse. ``seconds``: time of the fit, which varies between runs."""

FEWEST = 30
"""Fewest fits in a tenth of the quality for which it is compared with the share of right ones."""

OUTLINE = dict.fromkeys(("outline", "along", "across", "along_95", "across_95"), ".6f")
"""More columns. ``outline``: as ``nme``, with the distances of landmarks on contours from the true contours. ``along``
and ``across``: median errors along and across contours; ``along_95``, ``across_95``: fractions inside the 95 %
intervals of that direction. NaN without contours."""

STARTS, TRAINED = spot.CHOICES
"""Descriptions of the starts and models."""

Header = list[str]
Table = list[list[str]]


@dataclass(frozen=True)
class Request:
    """What was asked for.

    Attributes
    ----------
    data : Path
        Folder of images with landmarks.
    methods : tuple of str
    trials : int
        Starts per image.
    seed : int
    solver : str
        One of :data:`experiments.solvers.SOLVERS`.
    """

    data: Path
    methods: tuple[str, ...]
    trials: int
    seed: int
    solver: str

    def __post_init__(self) -> None:
        """Raise, before any work, if the request is invalid."""
        check_request(self.methods, self.solver, self.trials, self.has_lamps)

    @property
    def has_lamps(self) -> bool:
        """Whether models are trained with lamps."""
        return False

    def settings(self) -> dict[str, Any]:
        """Settings that determine the results, in addition to the images."""
        return {
            "methods": list(self.methods),
            "trials": self.trials,
            "seed": self.seed,
            "solver": f"{self.solver}: {get_solver(self.solver).summary}",
        }

    def train(self, samples: Iterable[Sample], name: str, leave_out: bool = False, **options: Any) -> "Trained":
        """Train a model on some images, with a fitter for each method.

        Parameters
        ----------
        samples : iterable of Sample
        name : str
        leave_out : bool
            Whether to calibrate the quality of fits, and restart those of low quality.
        **options
            Further options of :func:`liaam.train`.
        """
        samples = list(samples)
        options = {"variance": VARIANCE, "leave_out": leave_out, "contours": contours_of(samples[0]), **options}
        model = get_solver(self.solver).train(samples, name=name, **options)
        return Trained(model, make_fitters(model, self.methods, self.solver))

    def rng(self, *what: str | int) -> np.random.Generator:
        """Return the generator of one draw. It depends on the seed and on `what`, so methods share it."""
        return np.random.default_rng([self.seed, *(zlib.crc32(str(item).encode()) for item in what)])


@dataclass(frozen=True, eq=False)
class Trained:
    """A model and its fitters by method."""

    model: AAM
    fitters: Mapping[str, Fitter]

    @property
    def mean(self) -> np.ndarray:
        """Mean shape, (n, 2) float64, centred, model pixels."""
        return self.model.shape_model.mean

    def fit(
        self, image: np.ndarray, truth: np.ndarray, unit: float, start: np.ndarray | None, /, **labels: Any
    ) -> list[Row]:
        """Fit an image with every method from one start.

        Parameters
        ----------
        image : (h, w, 3) uint8
        truth : (n, 2) float64
        unit : float
            Unit of errors, in pixels.
        start : (n, 2) or (4,) float64, optional
            A shape or a box. By default the object is searched for.
        **labels
            Further columns.
        """
        bound = nme(self.model.shape_model.project(truth), truth, unit)
        rows = []
        for method, fitter in self.fitters.items():
            began = time.perf_counter()
            result = fitter.fit(image, start)
            seconds = time.perf_counter() - began
            row = {"method": method, **labels, "nme": nme(result.landmarks, truth, unit), "bound": bound}
            row |= {"iterations": result.n_iterations, "status": str(result.status), "quality": result.quality}
            row |= by_outline(result, truth, unit, self.model.contours)
            rows.append(row | {"held_95": held(result, truth, 95), "seconds": seconds})
        return rows


@dataclass(frozen=True)
class Split:
    """Training and test images of one person: one task.

    Attributes
    ----------
    name : str
        Name of the person.
    training, tested : tuple of Sample
    """

    name: str
    training: tuple[Sample, ...]
    tested: tuple[Sample, ...]

    @property
    def key(self) -> str:
        """Key of the task in the journal."""
        return f"person {self.name}"


def group_by_person(folder: Path, at_least: int) -> tuple[dict[str, tuple[Sample, ...]], tuple[str, ...]]:
    """Group a folder whose images are named ``PERSON-…`` or ``PERSON_…``.

    Parameters
    ----------
    folder : Path
    at_least : int
        Minimum number of images of a person.

    Returns
    -------
    persons : dict of str to tuple of Sample
        By name, in order; images in natural order.
    left_out : tuple of str
        Unused images, with the reasons.

    Raises
    ------
    LiaamError
        If no person is left.
    """
    data = load_folder(folder)
    left_out = [f"{item.path.name}: {item.reason}" for item in data.left_out]
    groups: dict[str, list[Sample]] = defaultdict(list)
    for sample in data:
        match = re.match(r"([^-_]+)[-_].", Path(sample.name).name)
        if match is None:
            left_out.append(f"{sample.name}: the name does not begin with a person's, as in 01_03")
        elif not np.isfinite(sample.landmarks.points).all():
            left_out.append(f"{sample.name}: landmarks are missing")
        else:
            groups[match[1]].append(sample)
    faults = {name: _fault_of(samples, at_least) for name, samples in groups.items()}
    left_out += [f"person {name}: {fault}" for name, fault in sorted(faults.items()) if fault]
    persons = {name: tuple(samples) for name, samples in sorted(groups.items()) if not faults[name]}
    if not persons:
        raise LiaamError(
            f"{folder}: no person has {at_least} landmarked pictures in colour; name pictures after persons, as 01_01, "
            f"01_02, 02_01 …{f' (left out: {left_out[0]})' if left_out else ''}"
        )
    return persons, tuple(left_out)


def _fault_of(samples: Sequence[Sample], at_least: int) -> str | None:
    if len(samples) < at_least:
        return f"{len(samples)} pictures where {at_least} are needed"
    return "the pictures are grey" if is_grey(samples[0].read_image()) else None


def eight_bit(sample: Sample) -> np.ndarray:
    """Read an image as (h, w, 3) uint8, because lights and patches are made for 8 bits."""
    image = as_colour(sample.read_image(), sample.name)
    if image.dtype == np.uint8:
        return image
    whole = np.iinfo(image.dtype).max if np.issubdtype(image.dtype, np.integer) else 1.0
    return np.clip(np.rint(image * (255.0 / whole)), 0, 255).astype(np.uint8)


def face_size(truth: np.ndarray) -> float:
    """Inter-ocular distance of a face in pixels, or an estimate if the eye landmarks are unknown."""
    eyes = EYES_BY_COUNT.get(len(truth))
    return inter_ocular_distance(truth, *eyes) if eyes else FACE * diagonal_of(truth)


def held(result: FitResult, truth: np.ndarray, level: float) -> float:
    """Fraction of the landmarks (n, 2) inside the confidence ellipses of a result, at a level in per cent."""
    return float(np.mean(within_ellipses(result.landmarks, truth, result.landmark_covariances, level / 100)))


def contours_of(sample: Sample) -> list[list[int]] | None:
    """Contours of a set whose landmark files have none, as :func:`liaam.train` takes them; else None."""
    lines = CONTOURS_BY_COUNT.get(len(sample.landmarks.points), ())
    if sample.landmarks.contours or not lines:
        return None
    return [[*range(first, last + 1), *([first] if closed else [])] for first, last, *closed in lines]


def by_outline(result: FitResult, truth: np.ndarray, unit: float, contours: Contours) -> Row:
    """Return the columns :data:`OUTLINE` of a fit."""
    directions, errors = contour_directions(truth, contours), result.landmarks - truth
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # without contours all values are NaN
        along, across = np.nanmedian(np.abs(along_and_across(errors, directions)), axis=0) / unit
        held = np.nanmean(within_intervals(errors, result.landmark_covariances, directions), axis=0)
    outline = float(np.mean(outline_errors(result.landmarks, truth, contours))) / unit
    return {"outline": outline, "along": along, "across": across, "along_95": held[0], "across_95": held[1]}


def is_right(row: Row, error: str = "nme") -> bool:
    """Return whether a fit is right, by its distance from the landmarks or by its ``outline``."""
    return bool(row[error] < CONVERGED)


def quality_area(rows: Sequence[Row]) -> float | None:
    """Area under the ROC curve of the quality; None if all fits are right or all wrong."""
    return finite_or_none(roc_area(*qualities_of(rows)))


def largest_bias(rows: Sequence[Row]) -> float | None:
    """Largest difference of quality and share of fits right by outline, over tenths of the quality with 30 fits.

    None if there are none, or qualities are unknown.
    """
    quality, right = (np.array(each) for each in ([r["quality"] for r in rows], [is_right(r, "outline") for r in rows]))
    bins = [np.clip(10 * quality, 0, 9).astype(int) == i for i in range(10)] if np.isfinite(quality).all() else []
    return max((float(abs(quality[b].mean() - right[b].mean())) for b in bins if b.sum() >= FEWEST), default=None)


def qualities_of(rows: Sequence[Row]) -> tuple[np.ndarray, np.ndarray]:
    """Qualities of right and of wrong fits; 0 if unknown."""
    known = [(float(np.nan_to_num(row["quality"])), is_right(row)) for row in rows]
    return tuple(np.array([quality for quality, right in known if right is wanted]) for wanted in (True, False))  # type: ignore[return-value]


def columns_of(*labels: str) -> dict[str, str]:
    """Columns of results.csv and their formats."""
    return {"method": "", **dict.fromkeys(labels, ""), **RESULTS, **OUTLINE}


def select(rows: Iterable[Row], **labels: Any) -> list[Row]:
    """Select rows with given values in some columns."""
    return [row for row in rows if all(row[name] == value for name, value in labels.items())]


def statistics(rows: Sequence[Row]) -> dict[str, Any]:
    """Statistics of a set of fits; None for values that are not finite."""
    if not rows:
        return {"fits": 0, **dict.fromkeys(("nme_median", "nme_p90", "beyond", "excess_median", "seconds_median"))}
    errors = np.array([row["nme"] for row in rows])
    found = error_statistics(errors)
    return {
        "fits": len(rows),
        "nme_median": found["median"],
        "nme_p90": found["p90"],
        "beyond": float(np.mean(~(errors < CONVERGED))),
        "excess_median": finite_or_none(np.median(errors - [row["bound"] for row in rows])),
        "seconds_median": float(np.median([row["seconds"] for row in rows])),
    }


def ratio(value: float | None, reference: float | None) -> float | None:
    """Quotient of two medians; None if either is missing."""
    return None if value is None or not reference else value / reference


def median_bound(rows: Sequence[Row]) -> float | None:
    """Median of the shape model's bound over images. It is the same for all methods."""
    first = rows[0]["method"]
    return finite_or_none(np.median([row["bound"] for row in rows if row["method"] == first]))


def in_percent(values: Mapping[str, float | None]) -> dict[str, float | None]:
    """Fractions by method in per cent, for bars."""
    return {method: None if value is None else 100 * value for method, value in values.items()}


def tell(question: str, table: tuple[Header, Table]) -> str:
    """Write the body of a report: the question and a table."""
    return f"{question}\n\n{markdown_table(*table)}"
