"""Errors of fits to landmarked images, by image, by landmark and by contour."""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from liaam.evaluation import (
    Contours,
    along_and_across,
    contour_directions,
    landmark_errors,
    outline_errors,
    within_ellipses,
    within_intervals,
)
from liaam.fitting import FitStatus
from liaam.io.files import count_of, some_names
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
        return np.array([np.nanmean(outline_errors(*own, self.contours)) for own in each]) / self.sizes

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
            landmark_columns({"image": name}, own, spread, self.landmark_names, quality=quality, status=str(status))
            for name, own, spread, quality, status in zip(
                self.names, self.landmarks, self.covariances, self.qualities.tolist(), self.statuses, strict=True
            )
        ]
        found = {column: [cell for part in parts for cell in part[column]] for column in parts[0]}
        relative = 100 * self.distances / self.sizes[:, None]
        x, y = self.truths[..., 0].ravel().tolist(), self.truths[..., 1].ravel().tolist()
        errors = {"error": self.distances.ravel().tolist(), "error_percent": relative.ravel().tolist()}
        if self.contours:
            errors |= dict(zip(("along", "across"), self.components.reshape(-1, 2).T.tolist(), strict=True))
        return found | {"true_x": x, "true_y": y, **errors, "inside": self.inside.ravel().tolist()}

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
            **(self._by_direction() if self.contours else {}),
        }

    def _by_direction(self) -> Columns:
        """Return the median errors along and across contours, and their coverage, of each landmark."""
        percent = 100 * np.abs(self.components) / self.sizes[:, None, None]
        inside, columns = self.inside_components[self.called_right], {}
        for i, name in enumerate(("along", "across")):
            columns[f"{name}_percent"] = [_percentile(each, 50) for each in percent[..., i].T]
            columns[f"inside_{name}_percent"] = [100 * _mean(each) for each in inside[..., i].T]
        return columns

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
            lines += self._report_of_contours()
        if self.left_out:
            lines.append(f"left out {len(self.left_out)}: {some_names(self.left_out, 3, '; ')}")
        return "\n".join(lines)

    def _report_of_contours(self) -> list[str]:
        lost, refused = self._lost_and_refused(self.outline_outcomes)
        median, percent = _percentile(100 * self.outline_errors, 50), 100 * self.components / self.sizes[:, None, None]
        along, across = (_percentile(np.abs(percent[..., i]).ravel(), 50) for i in range(2))
        inside = self.inside_components[self.called_right]
        held = [f"{100 * _mean(inside[..., i]):.1f} %" for i in range(2)]
        return [
            f"by outline (of landmarks on contours, the distance to the contour): median {median:.2f}, lost {lost}, "
            f"refused {refused}",
            f"landmarks on contours: median error along {along:.2f}, across {across:.2f}; inside their 95 % intervals "
            f"along {held[0]}, across {held[1]}",
        ]

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
    known = values[~np.isnan(values)]
    if not len(known):
        return np.nan
    with np.errstate(invalid="ignore"):  # between two infinite values
        return float(np.nan_to_num(np.percentile(known, percent), nan=np.inf, posinf=np.inf))


def _mean(values: np.ndarray) -> float:
    known = values[~np.isnan(values)]
    return float(known.mean()) if len(known) else np.nan
