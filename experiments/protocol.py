"""What the protocols on folders of many persons share: grouping by person, starts, fits, statistics, tables, figures.

A protocol declares its tasks, how a task is fitted, and the columns that tell its conditions apart
(:func:`fits_experiment`).
"""

import re
import time
import warnings
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from experiments.charts import figure_of_bars, figure_of_errors
from experiments.measures import or_dash, percent, roc_area
from experiments.runner import Experiment, Row, markdown_table
from experiments.solvers import Request, get_solver, make_fitters
from liaam.datasets import Sample, load_folder
from liaam.error_measures import error_statistics, inter_ocular_distance, nme, within_ellipses
from liaam.errors import LiaamError
from liaam.fitting import FitResult, Fitter
from liaam.formatting import finite_or_none
from liaam.model import AAM
from liaam.model.contours import Contours, along_and_across, contour_directions, outline_errors, within_intervals
from liaam.model.shape import diagonal_of, rotation
from liaam.photometry import is_grey
from liaam.photometry.encoding import as_colour

if TYPE_CHECKING:
    from matplotlib.figure import Figure

METHODS = ("rgb", "grey", "li", "igo", "soft-li")
"""Methods that are compared by default."""

VARIANCE = 0.98
"""Fraction of the variance of shape and of appearance that models keep."""

EYES = (slice(13, 21), slice(21, 29))
"""Landmarks of the two eyes of 58, counting from 0."""

CONVERGED = 0.08
"""NME below which a fit counts as converged."""

EYES_BY_COUNT = {58: EYES, 68: (slice(36, 42), slice(42, 48)), 73: (slice(16, 24), slice(24, 32))}
"""Landmarks of the two eyes by the number of landmarks (IMM, 300-W, and IMM frontal), counting from 0."""

CONTOURS_BY_COUNT = {
    58: [
        (0, 12, False),
        (13, 20, True),
        (21, 28, True),
        (29, 33, False),
        (34, 38, False),
        (39, 46, True),
        (47, 57, False),
    ],
    68: [
        (0, 16, False),
        (17, 21, False),
        (22, 26, False),
        (27, 30, False),
        (31, 35, False),
        (36, 41, True),
        (42, 47, True),
        (48, 59, True),
        (60, 67, True),
    ],
}
"""First and last landmark of each contour, counting from 0, and whether it is closed, by the number of landmarks (IMM,
300-W), whose files have no contours."""

ALL = "all"
"""Name of the only condition, and of all images together."""

FACE = 0.3
"""Substitute for the inter-ocular distance if the eye landmarks are unknown, in diagonals of the landmarks' box."""

FEWEST = 30
"""Fewest fits in a tenth of the quality for which it is compared with the share of right ones."""

STARTS = (
    "Starts: the mean shape at the true centroid and size, then turned by N(0, 4°), scaled by N(1, 0.05) and moved by "
    "N(0, 0.08 IOD) per axis (IOD: inter-ocular distance)."
)
TRAINED = "Models keep 98 % of the variance of shape and of appearance, and are trained with θ = 122°."

Header = list[str]
Table = list[list[str]]


@dataclass(frozen=True, eq=False)
class Trained:
    """A model and its fitters by method."""

    model: AAM
    fitters: Mapping[str, Fitter]

    @classmethod
    def on(cls, request: Request, samples: Iterable[Sample], name: str, leave_out: bool = False, **options: Any):
        """Train a model on some images, with a fitter for each method, and options of :func:`liaam.train`.

        With ``leave_out``, the quality of fits is calibrated, and those of low quality are restarted.
        """
        samples = list(samples)
        options = {"variance": VARIANCE, "leave_out": leave_out, "contours": contours_of(samples[0]), **options}
        model = get_solver(request.solver).train(samples, name=name, **options)
        return cls(model, make_fitters(model, request.methods, request.solver))

    @property
    def mean(self) -> np.ndarray:
        """Mean shape, (n, 2) float64, centred, model pixels."""
        return self.model.shape_model.mean

    def fit(
        self, image: np.ndarray, truth: np.ndarray, unit: float, start: np.ndarray | None, /, **labels: Any
    ) -> list[Row]:
        """Fit an image (h, w, 3) uint8 with every method from a shape or a box, or search for the object.

        Errors are divided by ``unit``, in pixels; labels are further columns. ``bound`` is the error of the true shape
        projected on the shape model, ``held_95`` the fraction of the landmarks inside their 95 % ellipse, and
        ``seconds`` the time of the fit, which varies between runs.
        """
        bound = nme(self.model.shape_model.project(truth), truth, unit)
        rows = []
        for method, fitter in self.fitters.items():
            began = time.perf_counter()
            result = fitter.fit(image, start)
            seconds = time.perf_counter() - began
            rows.append(
                {
                    "method": method,
                    **labels,
                    "nme": nme(result.landmarks, truth, unit),
                    "bound": bound,
                    "iterations": result.n_iterations,
                    "status": str(result.status),
                    "quality": result.quality,
                    **by_outline(result, truth, unit, self.model.contours),
                    "held_95": held(result, truth, 95),
                    "seconds": seconds,
                }
            )
        return rows


@dataclass(frozen=True)
class Split:
    """Training and test images of one person: one task."""

    name: str
    training: tuple[Sample, ...]
    tested: tuple[Sample, ...]

    @property
    def key(self) -> str:
        """Key of the task in the journal."""
        return f"person {self.name}"


def group_by_person(folder: Path, at_least: int) -> tuple[dict[str, tuple[Sample, ...]], tuple[str, ...]]:
    """Group a folder whose images are named ``PERSON-…`` or ``PERSON_…``, in natural order, by name.

    The unused images are returned with the reasons, among them those of persons with too few. Raises a LiaamError if no
    person is left.
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
    """Return why the images of a person are not used; None if they are."""
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
    contours = []
    for first, last, is_closed in lines:
        indices = list(range(first, last + 1))
        contours.append([*indices, first] if is_closed else indices)
    return contours


def by_outline(result: FitResult, truth: np.ndarray, unit: float, contours: Contours) -> Row:
    """Return columns of a fit by outline; NaN without contours.

    ``outline`` is as ``nme``, with the distances of landmarks on contours from the true contours, ``along`` and
    ``across`` are median errors along and across contours, and ``along_95`` and ``across_95`` the fractions inside the
    95 % intervals of that direction.
    """
    directions = contour_directions(truth, contours)
    errors = result.landmarks - truth
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # without contours all values are NaN
        components = np.abs(along_and_across(errors, directions))
        are_inside = within_intervals(errors, result.landmark_covariances, directions)
        along, across = np.nanmedian(components, axis=0) / unit
        along_95, across_95 = np.nanmean(are_inside, axis=0)
    outline = float(np.mean(outline_errors(result.landmarks, truth, contours))) / unit
    return {"outline": outline, "along": along, "across": across, "along_95": along_95, "across_95": across_95}


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
    qualities = np.array([row["quality"] for row in rows])
    are_right = np.array([is_right(row, "outline") for row in rows])
    if not np.isfinite(qualities).all():
        return None
    tenths = np.clip(10 * qualities, 0, 9).astype(int)
    differences = []
    for tenth in range(10):
        members = tenths == tenth
        if members.sum() >= FEWEST:
            differences.append(abs(float(qualities[members].mean() - are_right[members].mean())))
    return max(differences, default=None)


def qualities_of(rows: Sequence[Row]) -> tuple[np.ndarray, np.ndarray]:
    """Qualities of right and of wrong fits; 0 if unknown."""
    qualities = np.array([np.nan_to_num(row["quality"]) for row in rows], float)
    are_right = np.array([is_right(row) for row in rows], bool)
    return qualities[are_right], qualities[~are_right]


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


def fits_experiment(
    request: Request,
    work: Callable[[Request, Any], list[Row]],
    labels: tuple[str, ...] = (),
    published: Mapping[str, Table] | None = None,
    **options: Any,
) -> Experiment:
    """Make an experiment whose rows are fits, with a table of errors by method and condition.

    ``work`` makes rows (:meth:`Trained.fit`) from the request and a task, the values of the columns ``labels`` tell
    conditions apart, and ``published`` are further rows of the table by condition. The options are those of
    :class:`Experiment`; its ``report`` is the question.
    """
    question = options.pop("report")
    return Experiment(
        settings={**options.pop("settings"), **request.settings()},
        work=partial(work, request),
        summarise=partial(summarise, request.methods, labels),
        draw=draw,
        report=lambda summary: tell(question, table(summary, published or {})),
        skips_faults=True,
        **options,
    )


def summarise(methods: Sequence[str], labels: tuple[str, ...], rows: list[Row]) -> dict[str, Any]:
    """Statistics by method and condition, in the order of the rows."""
    conditions = {}  # the values of the labels, by the name of the condition
    for row in rows:
        values = {label: row[label] for label in labels}
        conditions[", ".join(values.values()) or ALL] = values
    by_method = {}
    for method in methods:
        by_method[method] = {
            name: statistics(select(rows, method=method, **values)) for name, values in conditions.items()
        }
    return {"bound_median": median_bound(rows), "methods": by_method}


def table(summary: dict[str, Any], published: Mapping[str, Table]) -> tuple[Header, Table]:
    """Errors by condition and method, and the bound of the shape model."""
    rows = []
    for condition in next(iter(summary["methods"].values())):
        for method, cells in summary["methods"].items():
            cell = cells[condition]
            errors = (percent(cell["nme_median"]), percent(cell["nme_p90"]), percent(cell["beyond"], 0))
            seconds = cell["seconds_median"]
            rows.append([condition, method, *errors, or_dash(None if seconds is None else 1000 * seconds, ".0f")])
        rows += [[condition, *row] for row in published.get(condition, ())]
    rows.append([ALL, "bound", percent(summary["bound_median"]), "–", "–", "–"])
    return ["pictures", "method", "median, %", "p90, %", "> 8 %", "ms"], rows


def draw(rows: list[Row], summary: dict[str, Any]) -> "Figure":
    """Median errors as bars, a panel for each condition; cumulative errors, and those of the bound, if there is one."""
    methods = summary["methods"]
    conditions = list(next(iter(methods.values())))
    if conditions == [ALL]:
        errors = {method: [row["nme"] for row in select(rows, method=method)] for method in methods}
        bound_of_picture = {row["picture"]: row["bound"] for row in rows}  # the same for all methods
        return figure_of_errors(errors, bound_of_picture.values(), CONVERGED)
    medians = {}
    for name in conditions:
        medians[name] = in_percent({method: cells[name]["nme_median"] for method, cells in methods.items()})
    return figure_of_bars(medians, "median error, %")
