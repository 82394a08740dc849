"""Errors of fits to landmarked images, by image, by landmark and by contour."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from liaam.error_measures import landmark_errors, within_ellipses
from liaam.fitting import FitStatus
from liaam.io.files import count_of, some_names
from liaam.model.contours import Contours, along_and_across, contour_directions, outline_errors, within_intervals
from liaam.plotting.errors import figure_of_worst, plot_cumulative
from liaam.tables import Columns, landmark_columns, to_dataframe

if TYPE_CHECKING:
    import pandas
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


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
    contours : tuple of (indices, closed)
        Lines through landmarks, along which fits and labels are less certain than across.
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
    contours: Contours = ()

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

    @cached_property
    def outline_errors(self) -> np.ndarray:
        """The same with the distances of landmarks on contours from the true contours, (k,) float64."""
        each = zip(self.landmarks, self.truths, strict=True)
        return np.array([np.nanmean(outline_errors(*pair, self.contours)) for pair in each]) / self.sizes

    @cached_property
    def directions(self) -> np.ndarray:
        """Direction of the true contour at each landmark, (k, n, 2) float64; NaN at those on no contour."""
        return contour_directions(self.truths, self.contours)

    @cached_property
    def components(self) -> np.ndarray:
        """Error of each landmark along and across its contour, (k, n, 2) float64, pixels, signed; else NaN."""
        return along_and_across(self.landmarks - self.truths, self.directions)

    @property
    def called_right(self) -> np.ndarray:
        """Whether the status of each fit says that its landmarks may be used, (k,) bool."""
        return np.array([status.ok for status in self.statuses])

    @property
    def outcomes(self) -> list[str]:
        """Outcome of each image, by its error and :attr:`limit`.

        ``right``; ``refused``: right, but not called right; ``lost``: wrong; or ``silent``: wrong, but called right.
        """
        return self._outcomes(self.errors)

    @property
    def outline_outcomes(self) -> list[str]:
        """The same by :attr:`outline_errors`."""
        return self._outcomes(self.outline_errors)

    def _outcomes(self, errors: np.ndarray) -> list[str]:
        words = {(True, True): "right", (True, False): "refused", (False, False): "lost", (False, True): "silent"}
        return [words[pair] for pair in zip((errors <= self.limit).tolist(), self.called_right.tolist(), strict=True)]

    @cached_property
    def inside(self) -> np.ndarray:
        """Whether the 95 % ellipse of each landmark holds the truth, (k, n) float64: 1, 0, or NaN if unknown."""
        return within_ellipses(self.landmarks, self.truths, self.covariances)

    @property
    def coverage(self) -> float:
        """Fraction of the landmarks inside their 95 % ellipses, of fits called right; NaN if there are none."""
        return _mean(self.inside[self.called_right])

    @cached_property
    def inside_components(self) -> np.ndarray:
        """Whether the 95 % intervals along and across contours hold the errors, (k, n, 2) float64: 1, 0, or NaN."""
        return within_intervals(self.landmarks - self.truths, self.covariances, self.directions)

    def to_columns(self) -> Columns:
        """Return one row per image and landmark: as of fits, and the truth and its distance (``error``, pixels).

        With contours also the error ``along`` and ``across`` them, pixels.
        """
        parts = [
            landmark_columns(
                {"image": name}, landmarks, spread, self.landmark_names, quality=quality, status=str(status)
            )
            for name, landmarks, spread, quality, status in zip(
                self.names, self.landmarks, self.covariances, self.qualities.tolist(), self.statuses, strict=True
            )
        ]
        columns = {column: [cell for part in parts for cell in part[column]] for column in parts[0]}
        more = {"true_x": self.truths[..., 0], "true_y": self.truths[..., 1]}
        more |= {"error": self.distances, "error_percent": self._relative}
        if self.contours:
            more |= {"along": self.components[..., 0], "across": self.components[..., 1]}
        return columns | {name: values.ravel().tolist() for name, values in (more | {"inside": self.inside}).items()}

    @property
    def _relative(self) -> np.ndarray:
        """The distances, (k, n), in per cent of the normaliser."""
        return 100 * self.distances / self.sizes[:, None]

    def to_dataframe(self) -> "pandas.DataFrame":
        """Convert to a pandas data frame with the columns of :meth:`to_columns`."""
        return to_dataframe(self)

    def by_image(self) -> Columns:
        """Return one row per image: its mean error in pixels and in per cent of the normaliser, and the outcome.

        With contours also both by outline.
        """
        by_outline = {"outline_percent": (100 * self.outline_errors).tolist(), "outline_outcome": self.outline_outcomes}
        return {
            "image": list(self.names),
            "error": (self.errors * self.sizes).tolist(),
            "error_percent": (100 * self.errors).tolist(),
            "normaliser": self.sizes.tolist(),
            "quality": self.qualities.tolist(),
            "status": [str(status) for status in self.statuses],
            "outcome": self.outcomes,
            **(by_outline if self.contours else {}),
        }

    def by_landmark(self) -> Columns:
        """Return one row per landmark: median and 90th percentile of its errors, and the coverage of its ellipses.

        With contours also the median error along and across them, and the coverage of the 95 % intervals.
        """
        n = self.landmarks.shape[1]
        columns: Columns = {"landmark": list(range(1, n + 1)), "name": list(self.landmark_names) or [""] * n}
        for unit, errors in (("", self.distances), ("_percent", self._relative)):
            for name, percent in (("median", 50), ("p90", 90)):
                columns[f"{name}{unit}"] = [_percentile(column, percent) for column in errors.T]
        columns["inside_percent"] = [100 * _mean(column) for column in self.inside[self.called_right].T]
        for name, errors, inside in self._by_direction():
            columns[f"{name}_percent"] = [_percentile(column, 50) for column in errors.T]
            columns[f"inside_{name}_percent"] = [100 * _mean(column) for column in inside.T]
        return columns

    def _by_direction(self) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
        """Yield the errors along and across contours, (k, n), in per cent, and whether the intervals hold them."""
        errors, inside = 100 * np.abs(self.components) / self.sizes[:, None, None], self.inside_components
        if self.contours:
            for i, name in enumerate(("along", "across")):
                yield name, errors[..., i], inside[self.called_right][..., i]

    def report(self) -> str:
        """Summarise the errors, the outcomes and the coverage, as text."""
        k = len(self)
        held = "unknown, since no fit is called right" if np.isnan(self.coverage) else f"{self.coverage:.1%}"
        median, p90, largest = (_percentile(100 * self.errors, q) for q in (50, 90, 100))
        lost, refused = self._lost_and_refused(self.outcomes)
        lines = [
            f"{count_of(k, 'image')}; mean error in % of {self.normaliser}: median {median:.2f}, 90th percentile "
            f"{p90:.2f}, largest {largest:.2f}",
            f"lost (error above {self.limit:.1%}): {lost}",
            f"refused (right, but called doubtful or failed): {refused}",
            f"landmarks inside their 95 % ellipses, of fits called right: {held}",
        ]
        if self.contours:
            lost, refused = self._lost_and_refused(self.outline_outcomes)
            (_, along, held_along), (_, across, held_across) = self._by_direction()
            lines += [
                "by outline (of landmarks on contours, the distance to the contour): median "
                f"{_percentile(100 * self.outline_errors, 50):.2f}, lost {lost}, refused {refused}",
                f"landmarks on contours: median error along {_percentile(along.ravel(), 50):.2f}, across "
                f"{_percentile(across.ravel(), 50):.2f}; inside their 95 % intervals along "
                f"{100 * _mean(held_along):.1f} %, across {100 * _mean(held_across):.1f} %",
            ]
        if self.left_out:
            lines.append(f"left out {len(self.left_out)}: {some_names(self.left_out, 3, '; ')}")
        return "\n".join(lines)

    def _lost_and_refused(self, outcomes: list[str]) -> tuple[str, int]:
        silent = outcomes.count("silent")
        lost = f"{outcomes.count('lost') + silent} of {len(self)}, of which silent (called right): {silent}"
        return lost, outcomes.count("refused")

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


def _percentile(values: np.ndarray, percent: float) -> float:
    """Return a percentile of the values that are known; infinite where it lies among infinite ones."""
    present = values[~np.isnan(values)]
    if not len(present):
        return np.nan
    with np.errstate(invalid="ignore"):  # between two infinite values
        return float(np.nan_to_num(np.percentile(present, percent), nan=np.inf, posinf=np.inf))


def _mean(values: np.ndarray) -> float:
    present = values[~np.isnan(values)]
    return float(present.mean()) if len(present) else np.nan
