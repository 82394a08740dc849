"""Generic models, fitted to unseen objects under the training light and under other lights.

The folders are ``data`` to train on, ``test`` to fit, and ``lamps`` to learn other lights from
(:mod:`liaam.training.lamps`). Without ``test``, the first few images train and the others are fitted. In a folder of
the spot protocol, one half of the persons trains and the other half is fitted, in two folds. The fitted images are then
diffuse, spot-lit, or diffuse with simulated hard light (:func:`experiments.lights.hard_light`).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from experiments.charts import figure_of_bars
from experiments.lights import hard_light
from experiments.measures import or_dash, percent
from experiments.protocol import (
    METHODS,
    STARTS,
    Header,
    Table,
    Trained,
    disturbed_start,
    eight_bit,
    face_size,
    in_percent,
    is_right,
    largest_bias,
    median_bound,
    quality_area,
    select,
    statistics,
    tell,
)
from experiments.runner import Experiment, Named, Row
from experiments.solvers import Request
from experiments.spot import find_persons
from experiments.subjects import data_facts
from liaam.datasets import Dataset, Sample, load_folder
from liaam.error_measures import inter_ocular_distance
from liaam.errors import LiaamError
from liaam.fitting import FitStatus
from liaam.fitting.methods import DEFAULT_METHOD
from liaam.formatting import finite_or_none
from liaam.photometry import is_grey
from liaam.plotting import figure_of_pictures
from liaam.training.train import AUTO

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FOLDS = 2
LEAST = 3
"""Minimum number of persons in a folder: one to fit and two to train on, in at least one fold."""

STARTED = ("near", "box", "none")
"""Kinds of start: the mean shape near the truth, a detector's box, or none (search)."""

BOX_SHIFT, BOX_SCALE = 0.1, 0.1
"""Standard deviations of a box's position, as a fraction of its sides, and of its size."""

CORNERS = {68: (36, 45)}
"""Outer corners of the eyes by the number of landmarks (300-W), counting from 0."""

UNITS = ("centres", "corners")
"""Units of errors: the distance between the eyes' centres, or between their outer corners."""

INSIDE = ("held_95", "along_95", "across_95")
"""Columns of the shares inside 95 % ellipses, and 95 % intervals along and across contours."""

ALL = "all"
"""Name of the group of images in all lights."""

FEW = 3
"""Maximum number of lights with a panel each in the figure."""

CHOICES = (
    "Of a folder of the spot protocol, persons are taken in the order of their names, every other one into one fold.",
    STARTS,
    f"Boxes are those of the landmarks, moved by N(0, {BOX_SHIFT:g} side) per axis and scaled by N(1, {BOX_SCALE:g}).",
    "Relit: a lamp 50 to 80° from the side on an ellipsoid with Lambert's shading, a cast shadow with an edge as of a "
    "nose, and ambient light of another colour; drawn once for each diffuse picture.",
    "Models keep 98 % of the variance of shape and of appearance, and have learnt how far fits can be trusted, so that "
    "soft-li begins those of little quality again; other methods know no quality.",
)


@dataclass(frozen=True)
class GenericRequest(Request):
    """Options of an experiment.

    ``test`` is the folder of the images to fit; without it, the ``first`` images of ``data`` are for training and the
    others are fitted. ``lamps`` is a folder or file to learn other lights from, and ``training_lamp`` the name of the
    lamp in it that is the training light.
    """

    data: Path
    test: Path | None = None
    first: int | None = None
    lamps: Path | None = None
    training_lamp: str | None = None
    diagonal: float = 150.0
    starts: tuple[str, ...] = STARTED[:1]
    unit: str = UNITS[0]

    def __post_init__(self) -> None:
        """Raise, before any work, if the request is invalid."""
        super().__post_init__()
        if not self.starts or not set(self.starts) <= set(STARTED) or len(set(self.starts)) < len(self.starts):
            raise LiaamError(f"starts {','.join(self.starts)}: give some of {', '.join(STARTED)}, each once")
        if self.unit not in UNITS:
            raise LiaamError(f"unknown unit {self.unit}; choose from {', '.join(UNITS)}")
        if self.test is not None and self.first is not None:
            raise LiaamError("pictures to fit are those of --test, or those of --data after the --first; give one")

    @property
    def has_lamps(self) -> bool:
        """Whether models are trained with lamps."""
        return self.lamps is not None

    def settings(self) -> dict[str, Any]:
        """Settings that determine the results, in addition to the images."""
        own = {"first": self.first, "training_lamp": self.training_lamp, "diagonal": self.diagonal}
        return {**super().settings(), **own, "starts": list(self.starts), "unit": self.unit}

    def size(self, truth: np.ndarray) -> float:
        """Unit of errors, in pixels."""
        if self.unit == "centres":
            return face_size(truth)
        if len(truth) not in CORNERS:
            raise LiaamError(
                f"the corners of the eyes are known of {' and '.join(map(str, CORNERS))} landmarks, not of {len(truth)}"
            )
        return inter_ocular_distance(truth, *(slice(i, i + 1) for i in CORNERS[len(truth)]))


class Shown(NamedTuple):
    """An image to fit and its light; ``relit`` if the light is simulated."""

    light: str
    sample: Sample
    relit: bool = False


@dataclass(frozen=True, eq=False)
class Fold:
    """Training images of a model, and test images by object."""

    training: tuple[Sample, ...]
    tested: dict[str, tuple[Shown, ...]]


@lru_cache(maxsize=1)
def get_folds(request: GenericRequest) -> tuple[tuple[Fold, ...], tuple[str, ...]]:
    """Split the images into folds, and list unused ones; once per process."""
    if request.test is not None:
        return _of_folders(request.data, request.test)
    return _of_persons(request.data) if request.first is None else _after_first(request.data, request.first)


def _of_folders(data: Path, test: Path) -> tuple[tuple[Fold, ...], tuple[str, ...]]:
    """One folder to train on, another to fit."""
    (training, missing), (tested, missing_there) = _pictures_of(data), _pictures_of(test)
    return (Fold(training, _by_object(tested)),), missing + missing_there


def _after_first(data: Path, first: int) -> tuple[tuple[Fold, ...], tuple[str, ...]]:
    """The first images of a folder to train on, the others to fit."""
    pictures, missing = _pictures_of(data)
    if not 1 < first < len(pictures):
        raise LiaamError(
            f"{data}: {len(pictures)} pictures can be used; train on the first 2 to {len(pictures) - 1} (--first)"
        )
    return (Fold(pictures[:first], _by_object(pictures[first:])),), missing


def _of_persons(folder: Path) -> tuple[tuple[Fold, ...], tuple[str, ...]]:
    """Two folds of a folder of the spot protocol."""
    persons, left_out = find_persons(folder)
    if len(persons) < LEAST:
        raise LiaamError(
            f"{folder}: {len(persons)} persons are complete, but a generic model needs at least {LEAST} to be trained "
            "on some and fitted to others; add some"
        )

    def shown(person) -> tuple[Shown, ...]:
        lights = ((Shown("diffuse", sample), Shown("relit", sample, relit=True)) for sample in person.training)
        return (Shown("spot", person.tested[0]), *(each for pair in lights for each in pair))

    def fold(which: int) -> Fold:
        others = [person for i, person in enumerate(persons) if i % FOLDS != which]
        training = tuple(sample for person in others for sample in person.training)
        return Fold(training, {f"person {person.name}": shown(person) for person in persons[which::FOLDS]})

    return tuple(fold(which) for which in range(FOLDS)), left_out


def _pictures_of(folder: Path) -> tuple[tuple[Sample, ...], tuple[str, ...]]:
    """Return the usable images of a folder, all colour or all grey, and what was left out."""
    data: Dataset = load_folder(folder)
    left_out = [f"{item.path.name}: {item.reason}" for item in data.left_out]
    whole = [sample for sample in data if np.isfinite(sample.landmarks.points).all()]
    left_out += [f"{sample.name}: landmarks are missing" for sample in data if sample not in whole]
    grey = {sample.name for sample in whole if is_grey(sample.read_image())}
    if len(grey) == len(whole):
        return tuple(whole), tuple(left_out)
    left_out += [f"{name}: the picture is grey" for name in sorted(grey)]
    return tuple(sample for sample in whole if sample.name not in grey), tuple(left_out)


def _by_object(samples: Sequence[Sample]) -> dict[str, tuple[Shown, ...]]:
    """Group images named by object and light, as ``037-00``, by object. Other images count as one object each."""
    parts = [sample.name.rpartition("-") for sample in samples]
    told = all(name for name, _, _ in parts)
    groups: dict[str, list[Shown]] = {}
    for sample, (name, _, light) in zip(samples, parts, strict=True):
        groups.setdefault(name if told else sample.name, []).append(Shown(light if told else ALL, sample))
    return {name: tuple(pictures) for name, pictures in groups.items()}


def request_of_folders(
    data: Path, test: Path, lamps: Path | None, training_lamp: str, diagonal: float, **options: Any
) -> tuple[GenericRequest, dict[str, Any], tuple[str, ...]]:
    """Return the request of a `soft-li` model of one folder for the objects of another, its settings, and what was
    left out; the parameters are those of :class:`GenericRequest`.
    """
    given = {"test": test, "lamps": lamps, "training_lamp": training_lamp, "diagonal": diagonal, **options}
    request = GenericRequest(data, ("soft-li",), 1, 0, "liaam", **given)
    (fold,), left_out = get_folds(request)
    samples = [*fold.training, *(each.sample for pictures in fold.tested.values() for each in pictures)]
    return (
        request,
        {"digest": data_facts(samples)["digest"], "lamps": lamps and lamps.name, **request.settings()},
        left_out,
    )


@lru_cache(maxsize=1)
def get_trained(request: GenericRequest, fold: int) -> Trained:
    """Train a fold's model; once per process, because it is slow."""
    from liaam.training import learn_lamps, load_lamps

    training = get_folds(request)[0][fold].training
    source, light = request.lamps, None
    if source is not None and str(source) == AUTO:
        light = AUTO
    elif source is not None:
        light = learn_lamps(load_folder(source), request.training_lamp) if source.is_dir() else load_lamps(source)
    options = {"lamps": light, "diagonal": request.diagonal}
    # Of the methods only the default one has a quality to calibrate, which takes most of the time.
    return Trained.on(request, training, f"fold {fold}", leave_out=DEFAULT_METHOD in request.methods, **options)


def image_of(request: Request, shown: Shown) -> np.ndarray:
    """Read an image, with simulated light if requested, (h, w, 3) uint8."""
    image, sample = eight_bit(shown.sample), shown.sample
    return hard_light(image, sample.landmarks.points, request.rng(sample.name, "relit")) if shown.relit else image


def start_of(request: GenericRequest, kind: str, mean: np.ndarray, sample: Sample, trial: int) -> np.ndarray | None:
    """Draw a start of some kind: a shape (n, 2), a box (4,), or None."""
    if kind == "none":
        return None
    truth = sample.landmarks.points
    if kind == "near":
        return disturbed_start(mean, truth, request.size(truth), request.rng(sample.name, trial))
    rng, low, high = request.rng(sample.name, trial, kind), truth.min(axis=0), truth.max(axis=0)
    middle = 0.5 * (low + high) + rng.normal(0.0, BOX_SHIFT, 2) * (high - low)
    half = 0.5 * (high - low) * rng.normal(1.0, BOX_SCALE)
    return np.concatenate([middle - half, middle + half])


def fit_object(request: GenericRequest, task: Named) -> list[Row]:
    """Fit all images of one object."""
    trained, rows = get_trained(request, task.group), []
    for shown in get_folds(request)[0][task.group].tested[task.name]:
        image, truth = image_of(request, shown), shown.sample.landmarks.points
        unit = request.size(truth)
        for trial in range(request.trials):
            for kind in request.starts:
                if kind == "none" and trial:
                    continue  # a search has no random start
                start = start_of(request, kind, trained.mean, shown.sample, trial)
                labels = {"object": task.name, "picture": shown.sample.name, "light": shown.light, "start": kind}
                rows += trained.fit(image, truth, unit, start, **labels, trial=trial)
    return rows


def generic_experiment(
    data: Path,
    methods: Sequence[str] = METHODS,
    trials: int = 1,
    seed: int = 0,
    solver: str = "liaam",
    *,
    test: Path | None = None,
    first: int | None = None,
    lamps: Path | None = None,
    training_lamp: str | None = None,
    diagonal: float = 150.0,
    starts: Sequence[str] = STARTED[:1],
    unit: str = UNITS[0],
) -> Experiment:
    """Make the experiment; :data:`experiments.cli.HELP` describes the parameters."""
    light = {"test": test, "first": first, "lamps": lamps, "training_lamp": training_lamp}
    more = {**light, "diagonal": diagonal, "starts": tuple(starts), "unit": unit}
    request = GenericRequest(data, tuple(methods), trials, seed, solver, **more)
    folds, left_out = get_folds(request)
    tasks = tuple(Named(i, name) for i, fold in enumerate(folds) for name in fold.tested)
    shown = [each for fold in folds for pictures in fold.tested.values() for each in pictures]
    request.size(shown[0].sample.landmarks.points)  # raise early
    folders = {name: getattr(request, name) for name in ("data", "test", "lamps")}
    samples = [*folds[0].training, *(each.sample for each in shown if not each.relit)]
    facts = {name: None if folder is None else folder.resolve().name for name, folder in folders.items()}
    return Experiment(
        name="generic",
        title="Generic models, fitted to objects they have never seen under other light",
        settings={**facts, "digest": data_facts(samples)["digest"], **request.settings()},
        tasks=tasks,
        work=partial(fit_object, request),
        summarise=partial(summarise, request),
        draw=draw,
        report=report,
        pictures=partial(draw_pictures, request),
        choices=CHOICES,
        left_out=left_out,
        skips_faults=True,
    )


def summarise(request: GenericRequest, rows: list[Row]) -> dict[str, Any]:
    """Statistics by method, start and light."""
    lights = list(dict.fromkeys(row["light"] for row in rows))

    def cells(own: list[Row]) -> dict[str, Any]:
        several = {} if len(lights) == 1 else {ALL: _cell(own)}
        return several | {light: _cell(select(own, light=light)) for light in lights}

    return {
        "objects": sorted({row["object"] for row in rows}),
        "lights": lights,
        "bound_median": {light: median_bound(select(rows, light=light)) for light in lights},
        "methods": {
            method: {start: cells(select(rows, method=method, start=start)) for start in request.starts}
            for method in request.methods
        },
    }


def _cell(rows: list[Row]) -> dict[str, Any]:
    """Return statistics, area under the ROC curve and coverage; None where unknown."""
    known = any(np.isfinite(row["quality"]) for row in rows)
    # By outline: fits that are right by points would be those that happen not to have slid along the contours.
    right = [row for row in rows if is_right(row, "outline")]
    return statistics(rows) | {
        **_silent_and_refused(rows, "nme"),
        "by_outline": _silent_and_refused(rows, "outline"),
        "roc_area": quality_area(rows) if known else None,
        "bias": largest_bias(rows),
        **{column: _mean(right, column) for column in INSIDE},
    }


def _silent_and_refused(rows: list[Row], error: str) -> dict[str, float | None]:
    """Share of fits that are wrong by an error and called right, and of the right ones that are not called right."""
    right = [row for row in rows if is_right(row, error)]
    silent = [row for row in rows if not is_right(row, error) and FitStatus(row["status"]).ok]
    refused = [row for row in right if not FitStatus(row["status"]).ok]
    return {
        "silent": len(silent) / len(rows) if rows else None,
        "refused": len(refused) / len(right) if right else None,
    }


def _mean(rows: list[Row], column: str) -> float | None:
    return finite_or_none(float(np.mean([row[column] for row in rows]))) if rows else None


def table(summary: dict[str, Any]) -> tuple[Header, Table]:
    """Tabulate the results by start, light and method."""
    shares = ["> 8 %", "silent", "by outline", "refused", "by outline", "ROC", "bias", "in 95 %", "along", "across"]
    header = ["start", "light", "method", "median", "p90", *shares, "excess", "ms"]
    return header, [
        [
            start,
            light,
            method,
            percent(cell["nme_median"]),
            percent(cell["nme_p90"]),
            percent(cell["beyond"], 1),
            *(percent(each[share], 1) for share in ("silent", "refused") for each in (cell, cell["by_outline"])),
            or_dash(cell["roc_area"], ".3f"),
            or_dash(cell["bias"], ".2f"),
            *(percent(cell[column], 1) for column in INSIDE),
            percent(cell["excess_median"]),
            "–" if cell["seconds_median"] is None else f"{1000 * cell['seconds_median']:.0f}",
        ]
        for start in next(iter(summary["methods"].values()))
        for light in next(iter(summary["methods"].values()))[start]
        for method, starts in summary["methods"].items()
        for cell in [starts[start][light]]
    ]


def draw(_rows: list[Row], summary: dict[str, Any]) -> "Figure":
    """Median errors as bars, a panel for each start and, of a few, each light."""
    methods, lights = summary["methods"], summary["lights"]
    shown = lights if len(lights) <= FEW else [ALL]
    starts = list(next(iter(methods.values())))
    groups = {
        ", ".join([light] * (shown != [ALL]) + [f"start: {start}"] * (len(starts) > 1)) or ALL: in_percent(
            {method: cells[start][light]["nme_median"] for method, cells in methods.items()}
        )
        for start in starts
        for light in shown
    }
    return figure_of_bars(groups, "median error, % of inter-ocular distance")


def draw_pictures(request: GenericRequest) -> "Figure":
    """The first object in its lights, as many as fit on a line."""
    shown: dict[str, np.ndarray | None] = {}
    for each in next(iter(get_folds(request)[0][0].tested.values())):
        if each.light not in shown and len(shown) < 2 * FEW:
            shown[each.light] = image_of(request, each)
    return figure_of_pictures([shown])


def report(summary: dict[str, Any]) -> str:
    """Format the question and the medians."""
    question = (
        f"What does another light cost a generic model? It is fitted to {len(summary['objects'])} objects that it has "
        "not seen. Errors are mean distances of the landmarks, per cent of the inter-ocular distance; silent: fits "
        "beyond 8 % whose status says that they can be used; refused: share of the right fits whose status says that "
        "they cannot be used; by outline: the same, with the distances of landmarks on contours from the contours; "
        "ROC: area under the curve by which the quality tells fits beyond 8 % from others; bias: largest difference of "
        "quality and share of fits right by outline, in tenths of the quality with 30 fits; in 95 %: share of the "
        "landmarks of fits that are right by outline in their ellipse, and in the 95 % intervals along and across "
        "contours; excess: median of what the error has on top of that of the true shape projected on the shape model."
    )
    return tell(question, table(summary))
