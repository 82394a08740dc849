"""Fit a model to landmarked images that were not used for training, and compare."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import repeat
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from liaam.datasets import Sample
from liaam.error_measures import landmark_errors
from liaam.errors import LandmarkError, LiaamError
from liaam.evaluation.result import Evaluation
from liaam.fitting import FitResult, Fitter, Method, fit_each
from liaam.fitting.many import starts_for
from liaam.fitting.methods import DEFAULT_METHOD, get_method
from liaam.io import Landmarks, read_landmarks
from liaam.io.files import some_names
from liaam.model import AAM
from liaam.model.contours import Contours
from liaam.model.shape import diagonal_of
from liaam.morphometry.measures import Measure
from liaam.morphometry.table import indices_of
from liaam.training import train
from liaam.training.entries import contours_of
from liaam.training.left_out import folds_of

# Largest mean error of a right fit by default: as a fraction of the diagonal of the landmarks' box, up to which
# training counts left-out fits as right, and of a given distance, as is usual for that between the eyes
LIMIT, LIMIT_BY_DISTANCE = 0.03, 0.08

DIAGONAL = "the diagonal of the landmarks' box"


class _Case(NamedTuple):
    """An image, its number among all images, and the landmarks and the normaliser of each of its objects."""

    name: str
    image: Any
    number: int
    truths: list[np.ndarray]
    sizes: list[float]


class _Protocol(NamedTuple):
    """What fits are compared with: names, number and contours of landmarks, the normaliser, its name, and the limit."""

    names: tuple[str, ...]
    n_points: int
    contours: Contours
    size_of: Callable[[np.ndarray], float]
    normaliser: str
    limit: float


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
    fitter, samples = Fitter.of(model, method, caller=evaluate, **settings), _samples(samples)
    model = fitter.model
    protocol = _protocol(samples, model.landmark_names, model.n_points, model.contours, normalise, limit)
    cases, left_out = _cases(samples, protocol)
    starts = _starts(init, cases, len({_key(sample.image) for sample in samples}))
    return _evaluation(zip(cases, _fits(fitter, cases, starts, workers, progress), strict=True), protocol, left_out)


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
    samples = _samples(samples)
    if folds < 2:
        raise LiaamError(f"folds {folds}: give 2 or more, so that something is left to train on")
    if not samples:
        raise LiaamError("there are no images to evaluate; give landmarked images")
    first, name = samples[0].landmarks, get_method(method).name
    contours = contours_of((training or {}).get("contours") or (), len(first.points))
    protocol = _protocol(samples, first.names, len(first.points), contours, normalise, limit)
    cases, left_out = _cases(samples, protocol)
    options: dict[str, Any] = {"methods": () if name == DEFAULT_METHOD else name, "progress": progress}
    done: dict[int, FitResult | LiaamError] = {}
    for fold in folds_of([case.name for case in cases], folds):
        tested = [cases[i] for i in fold]
        images = {_key(case.image) for case in tested}
        rest = [sample for sample in samples if _key(sample.image) not in images]
        fitter = Fitter.of(train(rest, **{**options, **(training or {})}), method, **settings)
        done |= zip(fold.tolist(), _fits(fitter, tested, None, workers, progress), strict=True)
    return _evaluation(((case, done[i]) for i, case in enumerate(cases)), protocol, left_out)


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
        name, image = (Path(image).stem, Path(image)) if isinstance(image, str | Path) else (f"image {i + 1}", image)
        marks = read_landmarks(landmarks) if isinstance(landmarks, str | Path) else landmarks
        made.append(Sample(name, image, marks if isinstance(marks, Landmarks) else Landmarks(np.asarray(marks))))
    return made


def _protocol(
    samples: Sequence[Sample],
    names: tuple[str, ...],
    n_points: int,
    contours: Contours,
    normalise: str | None,
    limit: float | None,
) -> _Protocol:
    names = names or next((sample.landmarks.names for sample in samples if sample.landmarks.names), ())
    alike = [
        each.landmarks for each in samples if len(each.landmarks) == n_points and each.landmarks.names in ((), names)
    ]
    theirs = next((each.contours for each in alike if each.contours), ())
    contours = contours or tuple((contour.indices, contour.closed) for contour in theirs)
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
        return float(np.linalg.norm(np.subtract(*points[ends])))

    return _Protocol(names, n_points, contours, distance, what, limit or LIMIT_BY_DISTANCE)


def _diagonal(points: np.ndarray) -> float:
    finite = points[np.isfinite(points).all(axis=1)]
    return diagonal_of(finite) if len(finite) else np.nan


def _cases(samples: Sequence[Sample], protocol: _Protocol) -> tuple[list[_Case], list[str]]:
    """Group samples by image. Also return why others are left out."""
    cases: dict[Any, _Case] = {}
    numbers: dict[Any, int] = {}
    left_out = []
    for sample in samples:
        number = numbers.setdefault(_key(sample.image), len(numbers))
        try:
            truth = _truth(sample, protocol)
        except LandmarkError as fault:
            left_out.append(str(fault))
            continue
        case = cases.setdefault(_key(sample.image), _Case(sample.name, sample.image, number, [], []))
        case.truths.append(truth)
        case.sizes.append(protocol.size_of(truth))
    return list(cases.values()), left_out


def _key(image: Any) -> Any:
    return image if isinstance(image, Path) else id(image)


def _truth(sample: Sample, protocol: _Protocol) -> np.ndarray:
    """Return the landmarks of a sample, (n, 2), in the order of the model's. Raise if they cannot be compared."""
    points, names = sample.landmarks.points, sample.landmarks.names
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
    """Return the start of all images, or those of the cases."""
    starts = starts_for(init, n_images)
    if isinstance(starts, repeat):
        return init
    each = list(starts_for(list(starts), n_images))  # the length of a generator is known only now
    return [each[case.number] for case in cases]


def _fits(
    fitter: Fitter, cases: Sequence[_Case], init: Any, workers: int | None, progress: bool | None
) -> Iterator[FitResult | LiaamError]:
    images = [case.image for case in cases]
    return fit_each(fitter, images, init, workers=workers, progress=progress, errors="return")


def _evaluation(
    fits: Iterable[tuple[_Case, FitResult | LiaamError]], protocol: _Protocol, left_out: Sequence[str]
) -> Evaluation:
    """Compare each fit with the nearest object of its image."""
    matches, faults = [], list(left_out)
    for case, result in fits:
        if isinstance(result, LiaamError):
            faults.append(str(result))
            continue
        errors = [np.nanmean(landmark_errors(result.landmarks, truth)) for truth in case.truths]
        matches.append((case, int(np.argmin(errors)), result))
    if not matches:
        reason = f": {faults[0]}" if faults else "; give landmarked images"
        raise LiaamError(f"there are no images to evaluate{reason}")
    return Evaluation(
        names=tuple(case.name for case, _, _ in matches),
        images=tuple(case.image for case, _, _ in matches),
        truths=np.array([case.truths[nearest] for case, nearest, _ in matches]),
        landmarks=np.array([result.landmarks for *_, result in matches]),
        covariances=np.array([result.landmark_covariances for *_, result in matches]),
        qualities=np.array([result.quality for *_, result in matches]),
        statuses=tuple(result.status for *_, result in matches),
        sizes=np.array([case.sizes[nearest] for case, nearest, _ in matches]),
        normaliser=protocol.normaliser,
        limit=protocol.limit,
        landmark_names=protocol.names,
        left_out=tuple(faults),
        contours=tuple(protocol.contours),
    )
