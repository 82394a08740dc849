"""Fit a model to landmarked images that were not used for training, and compare."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import repeat
from pathlib import Path
from typing import Any

import numpy as np

from liaam.datasets import Sample
from liaam.error_measures import landmark_errors
from liaam.errors import LandmarkError, LiaamError
from liaam.evaluation.result import Evaluation
from liaam.fitting import FitResult, Fitter, Method, fit_each
from liaam.fitting.many import starts_for
from liaam.fitting.methods import DEFAULT_METHOD, get_method
from liaam.io import Landmarks, read_landmarks
from liaam.io.files import fingerprint_of, some_names
from liaam.model import AAM
from liaam.model.contours import Contours
from liaam.model.shape import diagonal_of
from liaam.morphometry.measures import Measure, indices_of
from liaam.training import train
from liaam.training.entries import contours_of
from liaam.training.objects import folds_of

# Largest mean error of a right fit by default, as a fraction of the diagonal of the landmarks' box: that up to which
# training counts left-out fits as right
LIMIT = 0.03
# The same as a fraction of a given distance, as is usual for that between the eyes
LIMIT_BY_DISTANCE = 0.08

DIAGONAL = "the diagonal of the landmarks' box"


@dataclass(frozen=True, eq=False)
class _Case:
    """An image that is fitted, and its objects that fits are compared with."""

    name: str
    image: Any
    number: int  # of the image among all images, with those that are left out
    truths: list[np.ndarray]  # landmarks of each object, (n, 2) float64
    sizes: list[float]  # normaliser of each object, pixels


@dataclass(frozen=True, eq=False)
class _Protocol:
    """How fits are compared."""

    names: tuple[str, ...]  # of the landmarks, or empty
    n_points: int
    contours: Contours
    size_of: Callable[[np.ndarray], float]  # the normaliser of landmarks (n, 2), pixels; NaN if it is unknown
    normaliser: str  # what the normaliser is, for reports
    limit: float  # largest mean error of a right fit, as a fraction of the normaliser


def evaluate(
    model: AAM | str,
    samples: Iterable,
    init=None,
    method: str | Method = DEFAULT_METHOD,
    *,
    normalise: str | None = None,
    limit: float | None = None,
    workers: int | None = None,
    progress: bool | None = None,
    **settings,
) -> Evaluation:
    """Fit a model to landmarked images that it was not trained on, and compare.

    Parameters
    ----------
    model : AAM or "face"
    samples : Dataset, or iterable of Sample or of (image, landmarks) pairs
        Landmarks are (n, 2) arrays, :class:`liaam.Landmarks` or paths. Landmarks with names are put into the order of
        the model's. Images that cannot be used are left out. Of several objects in an image, the fit is compared with
        the nearest.
    init : start, or iterable of starts, optional
        One start for all images, or one per image of ``samples``, as for :func:`liaam.fit_many`. By default the objects
        are searched for.
    method : str or Method
    normalise : str, optional
        Errors are relative to the distance between two landmarks, such as ``"37-46"`` (numbers from 1, or names). By
        default to the diagonal of the landmarks' box.
    limit : float, optional
        Largest mean error of a right fit, as a fraction of the normaliser. Default: 0.03, or 0.08 with ``normalise``.
    workers, progress
        As for :func:`liaam.fit_many`.
    **settings
        Other keyword arguments of :func:`liaam.fit`.

    Returns
    -------
    Evaluation

    Raises
    ------
    LiaamError
        If no image can be evaluated, or a landmark of ``normalise`` does not exist.

    Examples
    --------
    >>> found = liaam.evaluate(model, liaam.load_folder("new"))                             # doctest: +SKIP
    >>> print(found.report())                                                               # doctest: +SKIP
    >>> found.to_dataframe().groupby("landmark").error.median()                             # doctest: +SKIP
    """
    fitter = Fitter.of(model, method, caller=evaluate, **settings)
    samples = _samples(samples)
    model = fitter.model
    protocol = _protocol(samples, model.landmark_names, model.n_points, model.contours, normalise, limit)
    cases, left_out = _cases(samples, protocol)
    n_images = len({_key(sample.image) for sample in samples})
    starts = _starts(init, cases, n_images)
    results = _fits(fitter, cases, starts, workers, progress)
    found = _evaluation(zip(cases, results, strict=True), protocol, left_out)
    return replace(found, in_training=_in_training(model, found.images))


def _in_training(model: AAM, images: Sequence[Any]) -> tuple[bool, ...]:
    """Return whether the model was trained on the files of images; nothing if it or an image has no file."""
    if not model.fingerprints or not all(isinstance(image, Path) for image in images):
        return ()
    fingerprints = {image: fingerprint_of(image) for image in set(images)}  # an image may show several objects
    known = frozenset(model.fingerprints)
    return tuple(fingerprints[image] in known for image in images)


def cross_validate(
    samples: Iterable,
    folds: int = 5,
    method: str | Method = DEFAULT_METHOD,
    *,
    training: Mapping[str, Any] | None = None,
    normalise: str | None = None,
    limit: float | None = None,
    workers: int | None = None,
    progress: bool | None = None,
    **settings,
) -> Evaluation:
    """Train on landmarked images without a part of them, evaluate on this part, and so on for each part.

    Images of one object, such as a person, are left out together if their names identify it (``anna1``, ``anna2``).

    Parameters
    ----------
    samples : Dataset, or iterable of Sample or of (image, landmarks) pairs
    folds : int
        Number of parts, at least 2; as many as there are images or objects leaves out each in turn.
    method, normalise, limit, workers, progress, **settings
        As for :func:`evaluate`.
    training : mapping of str to object, optional
        Keyword arguments of :func:`liaam.train`.

    Returns
    -------
    Evaluation
        In the order of the samples.

    Raises
    ------
    LiaamError
        If there are fewer than two folds, or as :func:`evaluate` and :func:`liaam.train`.
    """
    if folds < 2:
        raise LiaamError(f"folds {folds}: give 2 or more, so that something is left to train on")
    task = task_of(samples, method, training, normalise, limit, workers, progress, settings)
    return evaluation_by_parts(task, folds_of([case.name for case in task.cases], folds))


@dataclass(frozen=True, eq=False)
class Task:
    """Landmarked images, of which some are left out of training in turn and fitted; see :func:`cross_validate`."""

    samples: list[Sample]
    cases: list[_Case]
    left_out: list[str]  # why samples are not evaluated
    protocol: _Protocol
    method: str | Method
    training: dict[str, Any]
    workers: int | None
    progress: bool | None
    settings: Mapping[str, Any]


def task_of(
    samples: Iterable,
    method: str | Method,
    training: Mapping[str, Any] | None,
    normalise: str | None,
    limit: float | None,
    workers: int | None,
    progress: bool | None,
    settings: Mapping[str, Any],
) -> Task:
    """Return the task of evaluating on samples that are left out of training; see :func:`cross_validate`."""
    samples = _samples(samples)
    if not samples:
        raise LiaamError("there are no images to evaluate; give landmarked images")
    training = training or {}
    first = samples[0].landmarks
    contours = contours_of(training.get("contours") or (), len(first.points))
    protocol = _protocol(samples, first.names, len(first.points), contours, normalise, limit)
    cases, left_out = _cases(samples, protocol)
    name = get_method(method).name
    # Every model can be fitted with the default method, which need not be asked for.
    options = {"methods": () if name == DEFAULT_METHOD else name, "progress": progress, **training}
    return Task(samples, cases, left_out, protocol, method, options, workers, progress, settings)


def _all_of(samples: list[Sample]) -> list[Sample]:
    return samples


def evaluation_by_parts(
    task: Task,
    parts: Sequence[np.ndarray],
    chosen: Callable[[list[Sample]], list[Sample]] = _all_of,
    done: Callable[[], object] = lambda: None,
) -> Evaluation:
    """Fit each part of the cases (indices) with a model of samples chosen from the rest. Call ``done`` after each."""
    results: dict[int, FitResult | LiaamError] = {}  # by index of the case
    for part in parts:
        tested = [task.cases[i] for i in part]
        tested_images = {_key(case.image) for case in tested}
        rest = [sample for sample in task.samples if _key(sample.image) not in tested_images]
        fitter = Fitter.of(train(chosen(rest), **task.training), task.method, **task.settings)
        results |= zip(part.tolist(), _fits(fitter, tested, None, task.workers, task.progress), strict=True)
        done()
    fits = ((case, results[i]) for i, case in enumerate(task.cases) if i in results)
    found = _evaluation(fits, task.protocol, task.left_out)
    return replace(found, in_training=(False,) * len(found))


def _samples(samples: Iterable) -> list[Sample]:
    """Return samples, made from pairs of image and landmarks where these are given."""
    made = []
    for i, each in enumerate(samples):
        if isinstance(each, Sample):
            made.append(each)
            continue
        try:
            image, landmarks = each
        except (TypeError, ValueError):
            what = f"samples[{i}] is {type(each).__name__}"
            raise LiaamError(f"{what}; give samples or pairs of image and landmarks") from None
        if isinstance(image, str | Path):
            image = Path(image)
            name = image.stem
        else:
            name = f"image {i + 1}"
        if isinstance(landmarks, str | Path):
            landmarks = read_landmarks(landmarks)
        elif not isinstance(landmarks, Landmarks):
            landmarks = Landmarks(np.asarray(landmarks))
        made.append(Sample(name, image, landmarks))
    return made


def _protocol(
    samples: Sequence[Sample],
    names: tuple[str, ...],
    n_points: int,
    contours: Contours,
    normalise: str | None,
    limit: float | None,
) -> _Protocol:
    """Return how fits of a model's landmarks are compared, with the arguments of :func:`evaluate`.

    Names and contours that the model lacks are taken from the first sample that has them.
    """
    names = names or next((sample.landmarks.names for sample in samples if sample.landmarks.names), ())
    contours = contours or _contours_in(samples, names, n_points)
    if limit is not None and not 0 < limit < np.inf:
        raise LiaamError(f"limit {limit:g}: give a positive fraction of the normaliser, such as {LIMIT}")
    if normalise is None:
        return _Protocol(names, n_points, contours, _diagonal, DIAGONAL, limit or LIMIT)
    try:
        landmarks = Measure.parse(f"distance:{normalise}").landmarks
    except LiaamError:
        what = f"normalise '{normalise}': give two landmarks, such as 3-7, by numbers from 1 or by names"
        raise LiaamError(what) from None
    ends = indices_of(f"normalise '{normalise}'", landmarks, names, n_points)
    what = f"the distance between landmarks {normalise}"

    def distance(points: np.ndarray) -> float:
        start, end = points[ends]
        return float(np.linalg.norm(np.subtract(start, end)))

    return _Protocol(names, n_points, contours, distance, what, limit or LIMIT_BY_DISTANCE)


def _contours_in(samples: Sequence[Sample], names: tuple[str, ...], n_points: int) -> Contours:
    """Return the contours of the first sample that has some, and its landmarks in the order of the model's."""
    for sample in samples:
        landmarks = sample.landmarks
        is_in_order = len(landmarks) == n_points and landmarks.names in ((), names)
        if is_in_order and landmarks.contours:
            return tuple((contour.indices, contour.closed) for contour in landmarks.contours)
    return ()


def _diagonal(points: np.ndarray) -> float:
    """Return the diagonal of the box of the points (n, 2) that are not missing; NaN if all are."""
    present = points[np.isfinite(points).all(axis=1)]
    return diagonal_of(present) if len(present) else np.nan


def _cases(samples: Sequence[Sample], protocol: _Protocol) -> tuple[list[_Case], list[str]]:
    """Group samples by image. Also return why others are left out."""
    cases: dict[Any, _Case] = {}
    numbers: dict[Any, int] = {}
    left_out = []
    for sample in samples:
        key = _key(sample.image)
        number = numbers.setdefault(key, len(numbers))
        try:
            truth = _truth(sample, protocol)
        except LandmarkError as fault:
            left_out.append(str(fault))
            continue
        if key not in cases:
            cases[key] = _Case(sample.name, sample.image, number, truths=[], sizes=[])
        case = cases[key]
        case.truths.append(truth)
        case.sizes.append(protocol.size_of(truth))
    return list(cases.values()), left_out


def _key(image: Any) -> Any:
    """Return what samples of one image have in common: its path, or the identity of its array."""
    return image if isinstance(image, Path) else id(image)


def _truth(sample: Sample, protocol: _Protocol) -> np.ndarray:
    """Return the landmarks of a sample, (n, 2), in the order of the model's. Raise if they cannot be compared."""
    points = sample.landmarks.points
    names = sample.landmarks.names
    if len(points) != protocol.n_points:
        raise LandmarkError(f"{sample.name}: it has {len(points)} landmarks, where {protocol.n_points} are fitted")
    if names and protocol.names and names != protocol.names:
        if set(names) != set(protocol.names):
            others = [name for name in protocol.names if name not in names]
            raise LandmarkError(f"{sample.name}: it has no landmark {some_names(others, 3)}")
        points = points[[names.index(name) for name in protocol.names]]
    if not protocol.size_of(points) > 0:
        raise LandmarkError(f"{sample.name}: {protocol.normaliser} is 0 or unknown, since landmarks are missing")
    return points


def _starts(init: Any, cases: Sequence[_Case], n_images: int) -> Any:
    """Return the start of all images, or those of the cases, as :func:`fit_each` takes them."""
    starts = starts_for(init, n_images)
    if isinstance(starts, repeat):
        return init
    each = list(starts_for(list(starts), n_images))  # the length of a generator is known only now
    return [each[case.number] for case in cases]


def _fits(
    fitter: Fitter, cases: Sequence[_Case], init: Any, workers: int | None, progress: bool | None
) -> Iterator[FitResult | LiaamError]:
    """Fit the images of cases, from one start or one each. Yield an error in place of a result."""
    images = [case.image for case in cases]
    return fit_each(fitter, images, init, workers=workers, progress=progress, errors="return")


def _evaluation(
    fits: Iterable[tuple[_Case, FitResult | LiaamError]], protocol: _Protocol, left_out: Sequence[str]
) -> Evaluation:
    """Compare each fit with the nearest object of its image."""
    cases: list[_Case] = []
    results: list[FitResult] = []
    nearest: list[int] = []  # indices of the objects
    faults = list(left_out)
    for case, result in fits:
        if isinstance(result, LiaamError):
            faults.append(str(result))
            continue
        errors = [np.nanmean(landmark_errors(result.landmarks, truth)) for truth in case.truths]
        cases.append(case)
        results.append(result)
        nearest.append(int(np.argmin(errors)))
    if not cases:
        reason = f": {faults[0]}" if faults else "; give landmarked images"
        raise LiaamError(f"there are no images to evaluate{reason}")
    any_absent = any(result.absent.any() for result in results)
    return Evaluation(
        names=tuple(case.name for case in cases),
        images=tuple(case.image for case in cases),
        truths=np.array([case.truths[i] for case, i in zip(cases, nearest, strict=True)]),
        landmarks=np.array([result.landmarks for result in results]),
        covariances=np.array([result.landmark_covariances for result in results]),
        qualities=np.array([result.quality for result in results]),
        statuses=tuple(result.status for result in results),
        sizes=np.array([case.sizes[i] for case, i in zip(cases, nearest, strict=True)]),
        normaliser=protocol.normaliser,
        limit=protocol.limit,
        landmark_names=protocol.names,
        left_out=tuple(faults),
        contours=tuple(protocol.contours),
        sides=tuple(result.side for result in results) if any(result.side for result in results) else (),
        at_start=tuple(result.at_start for result in results) if any(result.at_start for result in results) else (),
        has_absent=tuple(bool(result.absent.any()) for result in results) if any_absent else (),
    )
