"""Errors of fits to landmarked images, by image, by landmark and by contour."""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from liaam.datasets.sides import reflected_shapes, squared_distances_of_pairs, two_groups
from liaam.error_measures import landmark_errors, within_ellipses
from liaam.errors import LiaamError
from liaam.evaluation.agreement import ShapeAgreement, compare_shapes
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
    second : (k, n, 2) float64, optional
        Landmarks that another person has placed, or the same person again, pixels; NaN where missing.
    groups : tuple of str
        Group of each image, such as the species; empty if unknown, or there are none.
    sides : tuple of str
        Side of the object by each fit (:attr:`liaam.FitResult.side`); empty if the model has one side only.
    at_start : tuple of bool
        Whether each fit failed and has the landmarks of its start (:attr:`liaam.FitResult.at_start`); empty if none.
    in_training : tuple of bool
        Whether the model was trained on the file of each image, by its content; empty if the model does not say.
    has_absent : tuple of bool
        Whether each fit found landmarks absent (:attr:`liaam.FitResult.absent`), which are then at their estimated
        positions; empty if none did.
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
    second: np.ndarray | None = None
    groups: tuple[str, ...] = ()
    sides: tuple[str, ...] = ()
    at_start: tuple[bool, ...] = ()
    in_training: tuple[bool, ...] = ()
    has_absent: tuple[bool, ...] = ()

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
        """As :attr:`errors`, with the distances of landmarks on contours from the true contours, (k,) float64."""
        distances = [
            np.nanmean(outline_errors(landmarks, truth, self.contours))
            for landmarks, truth in zip(self.landmarks, self.truths, strict=True)
        ]
        return np.array(distances) / self.sizes

    @cached_property
    def directions(self) -> np.ndarray:
        """Direction of the true contour at each landmark, (k, n, 2) float64; NaN at those on no contour."""
        return contour_directions(self.truths, self.contours)

    @cached_property
    def components(self) -> np.ndarray:
        """Signed error of each landmark along and across its contour, (k, n, 2) float64, pixels; NaN on no contour."""
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
        """As :attr:`outcomes`, by :attr:`outline_errors`."""
        return self._outcomes(self.outline_errors)

    def _outcomes(self, errors: np.ndarray) -> list[str]:
        """Return the outcome of each image, given its error (k,)."""
        outcomes = []
        for is_right, is_called_right in zip(errors <= self.limit, self.called_right, strict=True):
            if is_right:
                outcomes.append("right" if is_called_right else "refused")
            else:
                outcomes.append("silent" if is_called_right else "lost")
        return outcomes

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
        tables = [
            landmark_columns(
                {"image": self.names[i]},
                self.landmarks[i],
                self.covariances[i],
                self.landmark_names,
                quality=float(self.qualities[i]),
                status=str(self.statuses[i]),
            )
            for i in range(len(self))
        ]
        columns: Columns = {name: [] for name in tables[0]}
        for table in tables:
            for name, cells in table.items():
                columns[name] += cells
        compared = {
            "true_x": self.truths[..., 0],
            "true_y": self.truths[..., 1],
            "error": self.distances,
            "error_percent": self._percent,
        }
        if self.contours:
            compared["along"] = self.components[..., 0]
            compared["across"] = self.components[..., 1]
        compared["inside"] = self.inside
        return columns | {name: values.ravel().tolist() for name, values in compared.items()}

    @property
    def _percent(self) -> np.ndarray:
        """The distances, (k, n) float64, in per cent of the normaliser."""
        return 100 * self.distances / self.sizes[:, None]

    def to_dataframe(self) -> "pandas.DataFrame":
        """Convert to a pandas data frame with the columns of :meth:`to_columns`."""
        return to_dataframe(self)

    def by_image(self) -> Columns:
        """Return one row per image: its mean error in pixels and in per cent of the normaliser, and the outcome.

        Also whether the model was trained on it, if it was on any.

        With contours also both by outline.
        """
        columns: Columns = {
            "image": list(self.names),
            "error": (self.errors * self.sizes).tolist(),
            "error_percent": (100 * self.errors).tolist(),
            "normaliser": self.sizes.tolist(),
            "quality": self.qualities.tolist(),
            "status": [str(status) for status in self.statuses],
            "outcome": self.outcomes,
        }
        if any(self.in_training):
            columns["in_training"] = list(self.in_training)
        if self.sides:
            columns["side"] = list(self.sides)
            columns["wrong_side"] = self.on_wrong_side.tolist()
        if self.contours:
            columns["outline_percent"] = (100 * self.outline_errors).tolist()
            columns["outline_outcome"] = self.outline_outcomes
        return columns

    def by_landmark(self) -> Columns:
        """Return one row per landmark: median and 90th percentile of its errors, and the coverage of its ellipses.

        With contours also the median error along and across them, and the coverage of the 95 % intervals.
        """
        n = self.landmarks.shape[1]
        columns: Columns = {"landmark": list(range(1, n + 1)), "name": list(self.landmark_names) or [""] * n}
        columns["median"] = _percentiles(self.distances, 50)
        columns["p90"] = _percentiles(self.distances, 90)
        columns["median_percent"] = _percentiles(self._percent, 50)
        columns["p90_percent"] = _percentiles(self._percent, 90)
        columns["inside_percent"] = _percent_inside(self.inside[self.called_right])
        if self.contours:
            for axis, name in enumerate(("along", "across")):
                errors, inside = self._in_direction(axis)
                columns[f"{name}_percent"] = _percentiles(errors, 50)
                columns[f"inside_{name}_percent"] = _percent_inside(inside)
        return columns

    def _in_direction(self, axis: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the errors along (axis 0) or across (1) contours, (k, n), in per cent of the normaliser.

        Also whether the 95 % intervals of the fits called right hold them, (fits, n): 1, 0, or NaN.
        """
        errors = 100 * np.abs(self.components[..., axis]) / self.sizes[:, None]
        return errors, self.inside_components[self.called_right][..., axis]

    @cached_property
    def on_wrong_side(self) -> np.ndarray:
        """Whether each fit is nearer to the mirror image of the truth than to the truth, (k,) bool.

        Only fits by models of two sides can be.
        """
        if not self.sides:
            return np.zeros(len(self), bool)
        direct, mirrored = squared_distances_of_pairs(self.landmarks, self.truths)
        return mirrored < direct

    @cached_property
    def agreement(self) -> ShapeAgreement | None:
        """How the shapes of right fits agree with the labels; None if they cannot be compared."""
        return self._compared if isinstance(self._compared, ShapeAgreement) else None

    @cached_property
    def _compared(self) -> ShapeAgreement | str:
        """How the shapes of right fits agree with the labels, or why they cannot be compared."""
        is_right = self.errors <= self.limit
        if self.at_start:  # these have the model's shape, not the specimen's
            is_right = is_right & ~np.array(self.at_start)
        second = None if self.second is None else self.second[is_right]
        groups = None
        if self.groups:
            groups = [group for group, right in zip(self.groups, is_right, strict=True) if right]
        automatic = self.landmarks[is_right]
        labels = self.truths[is_right]
        if self.sides:
            is_mirrored, _ = two_groups(labels)
            automatic = reflected_shapes(automatic, is_mirrored)
            labels = reflected_shapes(labels, is_mirrored)
            second = None if second is None else reflected_shapes(second, is_mirrored)
        try:
            estimated = None
            if self.has_absent:
                estimated = [absent for absent, right in zip(self.has_absent, is_right, strict=True) if right]
            return compare_shapes(automatic, labels, second, groups=groups, estimated=estimated)
        except LiaamError as fault:
            return str(fault)

    def report(self) -> str:
        """Summarise the errors, the outcomes and the coverage, as text."""
        k = len(self)
        held = "unknown, since no fit may be used" if np.isnan(self.coverage) else f"{self.coverage:.1%}"
        median = _percentile(100 * self.errors, 50)
        p90 = _percentile(100 * self.errors, 90)
        largest = _percentile(100 * self.errors, 100)
        lines = [
            f"{count_of(k, 'image')}; mean error in % of {self.normaliser}: median {median:.2f}, 90th percentile "
            f"{p90:.2f}, largest {largest:.2f}",
            f"wrong (error above {self.limit:.1%}): {_wrong_said(self.outcomes)}",
            "refused (error within this limit, but the status is doubtful or failed): "
            f"{self.outcomes.count('refused')}",
            f"landmarks inside their 95 % ellipses, in fits that may be used: {held}",
        ]
        if doubt := self.doubt_about_training():
            lines.insert(1, doubt)
        if self.sides:
            counts = ", ".join(f"{self.sides.count(side)} {side}" for side in sorted(set(self.sides)))
            lines.append(f"sides: {counts}; fits of the wrong side: {int(self.on_wrong_side.sum())}")
        if self.contours:
            outcomes = self.outline_outcomes
            along, held_along = self._in_direction(0)
            across, held_across = self._in_direction(1)
            lines += [
                "by outline (errors of landmarks on contours are distances from the contour): median "
                f"{_percentile(100 * self.outline_errors, 50):.2f}; wrong {_wrong_said(outcomes)}; refused "
                f"{outcomes.count('refused')}",
                f"landmarks on contours: median error along the contour {_percentile(along.ravel(), 50):.2f}, across "
                f"it {_percentile(across.ravel(), 50):.2f}; inside the 95 % interval along the contour "
                f"{100 * _mean(held_along):.1f} %, across it {100 * _mean(held_across):.1f} %",
            ]
        if isinstance(self._compared, ShapeAgreement):
            lines.append(self._compared.report())
        else:
            lines.append(f"shapes of right fits are not compared: {self._compared}")
        if self.left_out:
            lines.append(f"left out {len(self.left_out)}: {some_names(self.left_out, 3, '; ')}")
        return "\n".join(lines)

    def doubt_about_training(self) -> str:
        """Say which images the model was trained on, or that it does not say; empty if it was trained on none."""
        if not self.in_training:
            return (
                "the model does not say which images it was trained on: these figures hold only if these are others "
                "(--folds 5 trains on other images in turn)"
            )
        names = [name for name, is_known in zip(self.names, self.in_training, strict=True) if is_known]
        if not names:
            return ""
        return (
            f"the model was trained on {len(names)} of these {count_of(len(self), 'image')} ({some_names(names, 3)}), "
            "whose errors are smaller than those of new images: evaluate others, or give --folds 5 to train on other "
            "images in turn"
        )

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


def _wrong_said(outcomes: list[str]) -> str:
    """Say how many fits are wrong, and how many of these are silent."""
    silent = outcomes.count("silent")
    wrong = outcomes.count("lost") + silent
    return f"{wrong} of {len(outcomes)}, {silent} of them silent (the status says that they may be used)"


def _percentile(values: np.ndarray, percent: float) -> float:
    """Return a percentile of the values that are known; infinite where it lies among infinite ones."""
    present = values[~np.isnan(values)]
    if not len(present):
        return np.nan
    with np.errstate(invalid="ignore"):  # between two infinite values
        return float(np.nan_to_num(np.percentile(present, percent), nan=np.inf, posinf=np.inf))


def _percentiles(errors: np.ndarray, percent: float) -> list[float]:
    """Return a percentile of the errors (k, n) of each landmark."""
    return [_percentile(column, percent) for column in errors.T]


def _percent_inside(inside: np.ndarray) -> list[float]:
    """Return the coverage of each landmark in per cent; ``inside`` (k, n) is 1, 0, or NaN where it is unknown."""
    return [100 * _mean(column) for column in inside.T]


def _mean(values: np.ndarray) -> float:
    """Return the mean of the values that are known; NaN if there are none."""
    known = values[~np.isnan(values)]
    return float(known.mean()) if len(known) else np.nan
