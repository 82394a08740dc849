"""How many pictures are enough: errors of models of more and more pictures, and a forecast for twice as many.

Each picture is left out of training once for each size of the training set. The logarithm of the error falls about
linearly with that of the number of pictures (a power law, Viering & Loog 2023), with an exponent that is estimated from
the last two sizes together with what is usual.
"""

import itertools
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from liaam.datasets import Sample
from liaam.error_measures import landmark_errors
from liaam.errors import LiaamError
from liaam.evaluation.measure import Task, evaluation_by_parts, task_of
from liaam.evaluation.result import Evaluation
from liaam.fitting import Method
from liaam.fitting.methods import DEFAULT_METHOD
from liaam.formatting import json_value, short_repr
from liaam.plotting.errors import plot_curve
from liaam.progress import progress_bar
from liaam.tables import Columns
from liaam.training.entries import FEWEST as FEWEST_IN_TRAINING
from liaam.training.objects import folds_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SIZES = (5, 10, 20, 40, 80, 160, 320)  # Pictures that models are trained on by default
FOLDS = 5  # Parts that are left out in turn
FEWEST = 8  # Pictures from which a curve is measured: with parts of up to 2, models of 5 and of 6 pictures are compared
# Exponent of the power law before anything is measured, and its standard deviation: it is between 0, that of an error
# which labels limit, and 1/2, that of the error of a mean.
EXPONENT = 0.25
SPREAD_OF_EXPONENT = 0.15
INTERVAL = 1.96  # Standard deviations of a 95 % interval
QUARTILES = 1.349  # Distance between the quartiles of normal values, in standard deviations
BOOTSTRAPS = 500  # Random draws of pictures for the standard error of a median, which this gives within about 3 %
GAIN = 0.05  # Share of the error that twice as many pictures must save to be called a gain
ERROR_WITHOUT_FIT = 1.0  # Error of a picture whose fit has no landmarks: as large as the normaliser
LEAST_ERROR = 1e-9  # Errors below it count as it, since 0 has no logarithm


@dataclass(frozen=True, eq=False)
class LearningCurve:
    """Errors of models of more and more pictures.

    Attributes
    ----------
    sizes : tuple of int
        Pictures that models were trained on, increasing.
    errors : (s, m) float64
        Mean error of each of m left-out pictures with models of each size, as a fraction of the normaliser.
    lost : (s,) float64
        Share of the left-out pictures whose error is beyond the limit.
    slopes : (s,) float64
        Slope of automatic on labelled shapes (:class:`ShapeAgreement`); NaN if too few fits are right.
    n_pictures : int
        All pictures.
    normaliser : str
        What errors are relative to.
    people : float
        Median distance between the landmarks of two people, as a fraction of the normaliser; NaN if unknown.
    """

    sizes: tuple[int, ...]
    errors: np.ndarray
    lost: np.ndarray
    slopes: np.ndarray
    n_pictures: int
    normaliser: str
    people: float = np.nan

    __repr__ = short_repr

    @property
    def medians(self) -> np.ndarray:
        """Median error with models of each size, (s,) float64."""
        return np.median(self.errors, axis=1)

    def forecast(self, n: int | None = None) -> tuple[float, float, float]:
        """Forecast the median error of models of n pictures on as many other pictures as were left out.

        Parameters
        ----------
        n : int, optional
            Default: twice as many as there are.

        Returns
        -------
        error, lowest, highest : float
            The forecast and its 95 % interval.
        """
        n = n or 2 * self.n_pictures
        last = self.errors[-1]
        exponent, exponent_se = self._exponent()
        log_ratio = np.log(n / self.sizes[-1])  # of the numbers of pictures
        log_error = np.log(np.median(last)) - exponent * log_ratio
        # Uncertain are the median that was measured and, by as much, that of another model on other pictures.
        median_se = _error_of_log_median(last)
        both_medians_se = np.hypot(median_se, median_se)
        half = INTERVAL * np.hypot(both_medians_se, exponent_se * log_ratio)
        return float(np.exp(log_error)), float(np.exp(log_error - half)), float(np.exp(log_error + half))

    def _exponent(self) -> tuple[float, float]:
        """Return the exponent of the power law and its standard deviation: from the last two sizes, and the usual."""
        if len(self.sizes) < 2:
            return EXPONENT, SPREAD_OF_EXPONENT
        log_ratio = np.log(self.sizes[-1] / self.sizes[-2])  # of the numbers of pictures
        log_gains = np.log(self.errors[-2] / self.errors[-1])  # of each picture
        measured = float(np.median(log_gains)) / log_ratio  # the median, as lost fits would decide a mean
        # The variance of a median of normal values is pi / 2 times that of their mean.
        variance = np.pi / 2 * float(np.square(_spread(log_gains))) / len(log_gains) / log_ratio**2
        # The mean of both, weighted by the reciprocals of their variances.
        weight = SPREAD_OF_EXPONENT**2 / (SPREAD_OF_EXPONENT**2 + variance)
        exponent = EXPONENT + weight * (measured - EXPONENT)
        return max(0.0, exponent), float(np.sqrt(1 - weight) * SPREAD_OF_EXPONENT)

    def to_columns(self) -> Columns:
        """Return one row per size: median and 90th percentile of the errors, in per cent, share lost, and slope."""
        return {
            "pictures": list(self.sizes),
            "median_percent": (100 * self.medians).tolist(),
            "p90_percent": (100 * np.percentile(self.errors, 90, axis=1)).tolist(),
            "lost_percent": (100 * self.lost).tolist(),
            "slope": self.slopes.tolist(),
        }

    def to_json(self) -> str:
        """Return the curve, the forecast and what it means as text in JSON; what is unknown is null."""
        n = 2 * self.n_pictures
        error, lowest, highest = (100 * each for each in self.forecast())
        forecast = {"pictures": n, "median_percent": error, "interval_percent": [lowest, highest]}
        values = self.to_columns() | {
            "forecast": forecast,
            "people_percent": 100 * self.people,
            "report": self.report(),
        }
        return json.dumps(json_value(values), indent=1)

    def plot(self, *, ax: "Axes | None" = None) -> "Axes":
        """Draw the curve with the forecast and, if it is known, the distance between people, with Matplotlib."""
        ends = (2 * self.n_pictures, self.forecast())
        return plot_curve(self.sizes, self.medians, ends, self.people, f"median error, % of {self.normaliser}", ax)

    def report(self) -> str:
        """Say what more pictures would gain, and whether models repeat landmarks as well as people."""
        n = self.n_pictures
        error, lowest, highest = (100 * each for each in self.forecast())
        exponent, _ = self._exponent()
        log_of_now = np.log(self.medians[-1]) - exponent * np.log(n / self.sizes[-1])
        now = 100 * float(np.exp(log_of_now))  # with all pictures, of which each model had only a part
        lines = [
            f"forecast for {2 * n} training images: median error {error:.2f} % of {self.normaliser} (95 % interval "
            f"{lowest:.2f} to {highest:.2f}); with all {n} images: {now:.2f} %"
        ]
        if error > (1 - GAIN) * now:
            gain = max(0.0, now - error)
            lines.append(f"twice as many images would lower the error by only {gain:.2f} %: the images are enough")
        if np.isfinite(self.people):
            reached = [size for size, median in zip(self.sizes, self.medians, strict=True) if median <= self.people]
            what = f"models of {reached[0]} images or more are as near" if reached else "no model is as near yet"
            lines.append(f"two people's landmarks are {100 * self.people:.2f} % apart; {what} to people's landmarks")
        return "\n".join(lines)


def learning_curve(
    samples: Iterable,
    sizes: Sequence[int] = SIZES,
    method: str | Method = DEFAULT_METHOD,
    *,
    second: Mapping[str, np.ndarray] | None = None,
    training: Mapping[str, Any] | None = None,
    normalise: str | None = None,
    limit: float | None = None,
    workers: int | None = None,
    progress: bool | None = None,
    seed: int = 0,
    **settings,
) -> LearningCurve:
    """Measure the errors of models of more and more pictures, on pictures that are left out.

    Five parts are left out in turn. For each, models are trained on some pictures of the rest, drawn at random, and
    last on all of the rest.

    Parameters
    ----------
    samples : Dataset, or iterable of Sample or of (image, landmarks) pairs
    sizes : sequence of int
        Numbers of pictures to train on. Those below 3 are left out, and those for which there are too few pictures.
    method, normalise, limit, workers, training, **settings
        As for :func:`liaam.cross_validate`.
    second : mapping of str to (n, 2) float64, optional
        Landmarks that another person has placed, by the name of the picture.
    progress : bool, optional
        Whether to show a progress bar.
    seed : int
        Seed of the draws.

    Returns
    -------
    LearningCurve

    Raises
    ------
    LiaamError
        If there are fewer than 8 pictures, or as :func:`liaam.cross_validate`.
    """
    training = {**(training or {}), "progress": False}
    task = task_of(samples, method, training, normalise, limit, workers, False, settings)
    if len(task.cases) < FEWEST:
        raise LiaamError(f"{len(task.cases)} pictures: a learning curve is measured from {FEWEST} pictures on")
    parts = folds_of([case.name for case in task.cases], FOLDS)
    all_of_rest = len(task.cases) - max(map(len, parts))
    used_sizes = [size for size in sorted(set(sizes)) if FEWEST_IN_TRAINING <= size < all_of_rest] + [all_of_rest]
    evaluations = []
    with progress_bar("models", len(used_sizes) * len(parts), progress) as tell:
        models = itertools.count(1)
        for size in used_sizes:
            evaluations.append(_evaluation_of(task, parts, size, seed, lambda: tell(next(models))))
    last = evaluations[-1]
    errors_by_name = [_errors_by_name(each) for each in evaluations]
    shared = [name for name in last.names if all(name in errors for errors in errors_by_name)]
    errors = np.array([[errors[name] for name in shared] for errors in errors_by_name])
    return LearningCurve(
        sizes=tuple(used_sizes),
        errors=errors,
        lost=(errors > last.limit).mean(axis=1),
        slopes=np.array([np.nan if each.agreement is None else each.agreement.slope for each in evaluations]),
        n_pictures=len(task.cases),
        normaliser=last.normaliser,
        people=np.nan if second is None else _between_people(last, second),
    )


def _evaluation_of(
    task: Task, parts: Sequence[np.ndarray], size: int, seed: int, tell: Callable[[], object]
) -> Evaluation:
    """Evaluate models of so many pictures, drawn from the rest of each part. ``tell`` is called after each model."""
    rng = np.random.default_rng([seed, size])

    def drawn(rest: list[Sample]) -> list[Sample]:
        return [rest[i] for i in sorted(rng.permutation(len(rest))[:size].tolist())]

    return evaluation_by_parts(task, parts, drawn, tell)


def _errors_by_name(evaluation: Evaluation) -> dict[str, float]:
    """Return the mean error of each picture, as a fraction of the normaliser, such that it has a logarithm."""
    errors = np.nan_to_num(evaluation.errors, nan=ERROR_WITHOUT_FIT, posinf=ERROR_WITHOUT_FIT)
    return dict(zip(evaluation.names, np.maximum(errors, LEAST_ERROR).tolist(), strict=True))


def _between_people(evaluation: Evaluation, second: Mapping[str, np.ndarray]) -> float:
    """Return the median distance between two people's landmarks of a picture; NaN if no picture has both."""
    distances = [
        float(np.nanmean(landmark_errors(second[name], truth))) / size
        for name, truth, size in zip(evaluation.names, evaluation.truths, evaluation.sizes, strict=True)
        if name in second and np.shape(second[name]) == truth.shape
    ]
    return float(np.nanmedian(distances)) if distances else np.nan


def _error_of_log_median(values: np.ndarray) -> float:
    """Return the standard error of the logarithm of a median (m,), by the bootstrap."""
    rng = np.random.default_rng(0)
    drawn = rng.choice(values, (BOOTSTRAPS, len(values)))
    return float(np.log(np.median(drawn, axis=1)).std())


def _spread(values: np.ndarray) -> float:
    """Return the standard deviation of normal values (m,) by their quartiles, which few outliers do not change."""
    low, high = np.percentile(values, [25, 75])
    return float(high - low) / QUARTILES
