"""How accurate a model's fits are: errors on landmarked images that were not used for training."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import repeat
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from liaam.datasets import Sample
from liaam.errors import LandmarkError, LiaamError
from liaam.evaluation import landmark_errors, within_ellipses
from liaam.fitting import FitResult, FitStatus, Fitter, Method, fit_each
from liaam.fitting.many import starts_for
from liaam.fitting.methods import DEFAULT_METHOD, get_method
from liaam.io import Landmarks, read_landmarks, to_dataframe
from liaam.io.files import count_of, some_names
from liaam.io.tables import Columns, landmark_columns
from liaam.model import AAM
from liaam.model.shape import diagonal_of
from liaam.morphometry.measures import Measure
from liaam.morphometry.table import indices_of
from liaam.plotting.errors import figure_of_worst, plot_cumulative
from liaam.training import train
from liaam.training.left_out import folds_of

if TYPE_CHECKING:
    import pandas
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LIMIT, LIMIT_BY_DISTANCE = 0.03, 0.08
"""Largest mean error of a right fit by default: as a fraction of the diagonal of the landmarks' box, up to which
training counts left-out fits as right, and of a given distance, as is usual for that between the eyes."""

DIAGONAL = "the diagonal of the landmarks' box"


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Fits to k landmarked images, beside their n landmarks.

    Attributes
    ----------
    names : tuple of str
        Name of each image.
    images : tuple of array or Path
        The images.
    truths : (k, n, 2) float64
        Landmarks of the images, pixels; NaN where missing.
    landmarks : (k, n, 2) float64
        Landmarks of the fits, pixels.
    covariances : (k, n, 2, 2) float64
        Their covariances, square pixels.
    qualities : (k,) float64
        Quality of each fit, 0 to 1; NaN if unknown.
    statuses : tuple of FitStatus
        Status of each fit.
    sizes : (k,) float64
        Normaliser of each image: the length that errors are divided by, pixels.
    normaliser : str
        What the normaliser is.
    limit : float
        Largest mean error of a right fit, as a fraction of the normaliser.
    landmark_names : tuple of str
        One name per landmark, or empty.
    left_out : tuple of str
        Why images were not evaluated, one sentence each.
    """

    names: tuple[str, ...]
    images: tuple[Any, ...]
    truths: np.ndarray
    landmarks: np.ndarray
    covariances: np.ndarray
    qualities: np.ndarray
    statuses: tuple[FitStatus, ...]
    sizes: np.ndarray
    normaliser: str
    limit: float
    landmark_names: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()

    def __repr__(self) -> str:
        return f"Evaluation({count_of(len(self), 'image')}, median error {_percentile(self.errors, 50):.2%})"

    def __len__(self) -> int:
        return len(self.names)

    @cached_property
    def distances(self) -> np.ndarray:
        """Distance of each landmark from the truth, (k, n) float64, pixels; NaN where the truth is missing."""
        return landmark_errors(self.landmarks, self.truths)

    @cached_property
    def errors(self) -> np.ndarray:
        """Mean error of each image, (k,) float64, as a fraction of its normaliser; infinite if the fit diverged."""
        return np.nanmean(self.distances, axis=1) / self.sizes

    @property
    def right(self) -> np.ndarray:
        """Whether the error of each image is at most the limit, (k,) bool."""
        return self.errors <= self.limit

    @property
    def called_right(self) -> np.ndarray:
        """Whether the status of each fit says that its landmarks may be used, (k,) bool."""
        return np.array([status.ok for status in self.statuses])

    @property
    def outcomes(self) -> list[str]:
        """Outcome of each image.

        ``right``; ``refused``: right, but not called right; ``lost``: wrong; or ``silent``: wrong, but called right.
        """
        words = {(True, True): "right", (True, False): "refused", (False, False): "lost", (False, True): "silent"}
        return [words[pair] for pair in zip(self.right.tolist(), self.called_right.tolist(), strict=True)]

    @cached_property
    def inside(self) -> np.ndarray:
        """Whether the 95 % ellipse of each landmark holds the truth, (k, n) float64: 1, 0, or NaN if unknown."""
        return within_ellipses(self.landmarks, self.truths, self.covariances)

    @property
    def coverage(self) -> float:
        """Fraction of the landmarks inside their 95 % ellipses, of fits called right; NaN if there are none."""
        return _mean(self.inside[self.called_right])

    def to_columns(self) -> Columns:
        """Return one row per image and landmark: as of fits, and the truth and its distance (``error``, pixels)."""
        parts = [
            landmark_columns({"image": name}, own, spread, self.landmark_names, quality=quality, status=str(status))
            for name, own, spread, quality, status in zip(
                self.names, self.landmarks, self.covariances, self.qualities.tolist(), self.statuses, strict=True
            )
        ]
        found = {column: [cell for part in parts for cell in part[column]] for column in parts[0]}
        relative = 100 * self.distances / self.sizes[:, None]
        x, y = self.truths[..., 0].ravel().tolist(), self.truths[..., 1].ravel().tolist()
        errors = {"error": self.distances.ravel().tolist(), "error_percent": relative.ravel().tolist()}
        return found | {"true_x": x, "true_y": y, **errors, "inside": self.inside.ravel().tolist()}

    def to_dataframe(self) -> "pandas.DataFrame":
        """Convert to a pandas data frame with the columns of :meth:`to_columns`."""
        return to_dataframe(self)

    def by_image(self) -> Columns:
        """Return one row per image: its mean error in pixels and in per cent of the normaliser, and the outcome."""
        return {
            "image": list(self.names),
            "error": (self.errors * self.sizes).tolist(),
            "error_percent": (100 * self.errors).tolist(),
            "normaliser": self.sizes.tolist(),
            "quality": self.qualities.tolist(),
            "status": [str(status) for status in self.statuses],
            "outcome": self.outcomes,
        }

    def by_landmark(self) -> Columns:
        """Return one row per landmark: median and 90th percentile of its errors, and the coverage of its ellipses."""
        n, relative = self.landmarks.shape[1], 100 * self.distances / self.sizes[:, None]
        inside = self.inside[self.called_right]
        return {
            "landmark": list(range(1, n + 1)),
            "name": list(self.landmark_names) or [""] * n,
            "median": [_percentile(column, 50) for column in self.distances.T],
            "p90": [_percentile(column, 90) for column in self.distances.T],
            "median_percent": [_percentile(column, 50) for column in relative.T],
            "p90_percent": [_percentile(column, 90) for column in relative.T],
            "inside_percent": [100 * _mean(column) for column in inside.T],
        }

    def report(self) -> str:
        """Summarise the errors, the outcomes and the coverage, as text."""
        k, outcomes, percent = len(self), self.outcomes, 100 * self.errors
        silent = outcomes.count("silent")
        held = "unknown, since no fit is called right" if np.isnan(self.coverage) else f"{self.coverage:.1%}"
        median, p90, largest = (_percentile(percent, q) for q in (50, 90, 100))
        lines = [
            f"{count_of(k, 'image')}; mean error in % of {self.normaliser}: median {median:.2f}, 90th percentile "
            f"{p90:.2f}, largest {largest:.2f}",
            f"lost (error above {self.limit:.1%}): {outcomes.count('lost') + silent} of {k}, of which silent (called "
            f"right): {silent}",
            f"refused (right, but called doubtful or failed): {outcomes.count('refused')}",
            f"landmarks inside their 95 % ellipses, of fits called right: {held}",
        ]
        if self.left_out:
            lines.append(f"left out {len(self.left_out)}: {some_names(self.left_out, 3, '; ')}")
        return "\n".join(lines)

    def worst(self, count: int = 10) -> np.ndarray:
        """Return the indices of the images with the largest errors, (min(k, count),) int64, the largest first."""
        return np.argsort(-self.errors, kind="stable")[:count]

    def plot(self, *, ax: "Axes | None" = None) -> "Axes":
        """Draw the cumulative distribution of the images' errors and the limit with Matplotlib."""
        return plot_cumulative(self.errors, self.limit, f"mean error, % of {self.normaliser}", ax)

    def plot_worst(self, count: int = 10) -> "Figure":
        """Draw the images with the largest errors: their landmarks, and those of the fits."""
        shown = self.worst(count)
        titles = [f"{self.names[i]}\n{self.errors[i]:.1%}, {self.statuses[i]}" for i in shown]
        return figure_of_worst([self.images[i] for i in shown], self.truths[shown], self.landmarks[shown], titles)


class _Case(NamedTuple):
    """An image, its number among all images, and the landmarks and the normaliser of each of its objects."""

    name: str
    image: Any
    number: int
    truths: list[np.ndarray]
    sizes: list[float]


class _Protocol(NamedTuple):
    """What fits are compared with: names and number of landmarks, the normaliser, its name, and the limit."""

    names: tuple[str, ...]
    n_points: int
    size_of: Callable[[np.ndarray], float]
    normaliser: str
    limit: float


def evaluate(
    model: AAM,
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
    model : AAM
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
    fitter, samples = Fitter.of(model, method, **settings), _samples(samples)
    protocol = _protocol(samples, model.landmark_names, model.n_points, normalise, limit)
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
    protocol = _protocol(samples, first.names, len(first.points), normalise, limit)
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
    return [each if isinstance(each, Sample) else _sample(each, i) for i, each in enumerate(samples)]


def _sample(pair: Any, i: int) -> Sample:
    try:
        image, landmarks = pair
    except (TypeError, ValueError):
        what = f"samples[{i}] is {type(pair).__name__}"
        raise LiaamError(f"{what}; give samples or pairs of image and landmarks") from None
    named = isinstance(image, (str, Path))
    if isinstance(landmarks, (str, Path)):
        landmarks = read_landmarks(landmarks)
    marks = landmarks if isinstance(landmarks, Landmarks) else Landmarks(np.asarray(landmarks))
    return Sample(Path(image).stem if named else f"image {i + 1}", Path(image) if named else image, marks)


def _protocol(
    samples: Sequence[Sample], names: tuple[str, ...], n_points: int, normalise: str | None, limit: float | None
) -> _Protocol:
    names = names or next((sample.landmarks.names for sample in samples if sample.landmarks.names), ())
    if limit is not None and not 0 < limit < np.inf:
        raise LiaamError(f"limit {limit:g}: give a positive fraction of the normaliser, such as {LIMIT}")
    if normalise is None:
        return _Protocol(names, n_points, _diagonal, DIAGONAL, limit or LIMIT)
    try:
        landmarks = Measure.parse(f"distance:{normalise}").landmarks
    except LiaamError:
        what = f"normalise '{normalise}': give two landmarks, such as 3-7, by numbers from 1 or by names"
        raise LiaamError(what) from None
    ends = indices_of(f"normalise '{normalise}'", landmarks, names, n_points)
    what = f"the distance between landmarks {normalise}"

    def distance(points: np.ndarray) -> float:
        return float(np.linalg.norm(np.subtract(*points[ends])))

    return _Protocol(names, n_points, distance, what, limit or LIMIT_BY_DISTANCE)


def _diagonal(points: np.ndarray) -> float:
    known = points[np.isfinite(points).all(axis=1)]
    return diagonal_of(known) if len(known) else np.nan


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
    rows, faults = [], list(left_out)
    for case, result in fits:
        if isinstance(result, LiaamError):
            faults.append(str(result))
            continue
        own = np.array([landmark_errors(result.landmarks, truth) for truth in case.truths])
        nearest = int(np.argmin(np.nanmean(own, axis=1)))
        truth, size = case.truths[nearest], case.sizes[nearest]
        spread, marks = result.landmark_covariances, result.landmarks
        rows.append((case.name, case.image, truth, marks, spread, result.quality, result.status, size))
    if not rows:
        reason = f": {faults[0]}" if faults else "; give landmarked images"
        raise LiaamError(f"there are no images to evaluate{reason}")
    names, images, truths, marks, spreads, qualities, statuses, sizes = zip(*rows, strict=True)
    return Evaluation(
        names=names,
        images=images,
        truths=np.array(truths),
        landmarks=np.array(marks),
        covariances=np.array(spreads),
        qualities=np.array(qualities),
        statuses=statuses,
        sizes=np.array(sizes),
        normaliser=protocol.normaliser,
        limit=protocol.limit,
        landmark_names=protocol.names,
        left_out=tuple(faults),
    )


def _percentile(values: np.ndarray, percent: float) -> float:
    """Return a percentile of the values that are known; infinite where it lies among infinite ones."""
    known = values[~np.isnan(values)]
    if not len(known):
        return np.nan
    with np.errstate(invalid="ignore"):  # between two infinite values
        return float(np.nan_to_num(np.percentile(known, percent), nan=np.inf, posinf=np.inf))


def _mean(values: np.ndarray) -> float:
    known = values[~np.isnan(values)]
    return float(known.mean()) if len(known) else np.nan
