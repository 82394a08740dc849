"""Options of training: their meaning, defaults and valid ranges."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from numbers import Integral, Real
from typing import Any

import numpy as np

from liaam.errors import TrainingError, check_options
from liaam.model import MESH, SURROUNDINGS
from liaam.model.file_format import MAX_BLUR, MAX_DIAGONAL, MAX_LEVELS, MOST_SHAPES
from liaam.model.pca import Variance, check_variance
from liaam.model.shape import check_prior
from liaam.training.compacting import Methods, chosen

Blurs = tuple[float, ...]

# Blur of each view's levels from coarse to fine, standard deviation in pixels of the reference frame. Those of the
# surroundings were measured on unseen persons. They shrink in proportion in frames smaller than FULL_SIZE.
BLURS = {MESH: (3.0, 0.5), SURROUNDINGS: (4.0, 2.0, 1.0)}
# Diagonal at which the blurs of the surroundings were measured, pixels, and the smallest blur of smaller frames. At a
# diagonal of 90 pixels faces are fitted to 1.8 % with a last blur of 0.6, and to 2.0 % with 1.
FULL_SIZE = 150.0
LEAST_BLUR = 0.5
AUTO = "auto"  # Value of options that training chooses itself: shapes, and lamps of train
SIDES = (AUTO, "both", "one")
"""What training does about sides (:attr:`TrainingOptions.sides`)."""
# Default and largest number of relit copies of each image
COPIES = 3
MOST_COPIES = 20
# Default fraction of the variance kept by appearances of the surroundings. Their coordinates have a prior, and the
# variance that is left out counts as error: 0.85 is as accurate as 0.98 on IMM and under hard flashes, and faster.
KEPT = 0.85
# Arguments of train by name besides the options, for messages
ARGUMENTS = ("camera", "lamps", "training_lamp", "points", "features", "contours", "name", "progress")
# Remedies for options of the command line that belong to the camera in Python
CAMERA_OPTIONS = {
    "response": "give camera=CameraModel(response=...)",
    "theta": "give camera=CameraModel(theta=...), in radians",
}
# Largest number of landmarks for which the smooth prior is the default. It takes seconds for 200 landmarks, half a
# minute for 1000, and grows with the cube.
MOST_SMOOTH = 200


@dataclass(frozen=True, eq=False)
class TrainingOptions:
    """Options of training. The defaults suit most data.

    Attributes
    ----------
    diagonal : float
        Diagonal of the mean shape in the reference frame, pixels. Larger frames are finer and slower.
    variance : float, int or "auto"
        Fraction of the shapes' variance to keep, in (0, 1], or a number of modes. ``auto`` chooses the number of modes
        under which left-out images are most likely.
    appearance_variance : float, int, "auto" or mapping of views to these, optional
        The same for appearances. Default: ``variance``, and at most 0.85 for the view ``surroundings``.
    prior : {"sample", "smooth", "wide", "shrunk"} or mapping of views to these, optional
        How the covariance of the shapes is estimated, for all views or by name of :data:`liaam.model.VIEWS`.
        ``sample``: the sample covariance, as in the paper. ``smooth``: shrunk towards smooth deformations, with
        mirrored shapes added, as far as this makes left-out shapes more likely. ``wide``: ``smooth``, with four
        times its variances, for objects that differ more from those of training than these do from each other.
        ``shrunk``: the sample modes with the variances of left-out shapes. Default: ``sample`` for ``mesh``; for
        ``surroundings`` (method ``soft-li``) ``smooth``, or ``sample`` if all of the variance is kept or there are more
        than 200 landmarks.
    blurs : tuple of float or mapping of views to these, optional
        Blur of the levels of a fit, from coarse to fine, pixels of the reference frame. Default: (3.0, 0.5) for the
        view ``mesh`` and (4.0, 2.0, 1.0) for the view ``surroundings``, where it is smaller in frames with a diagonal
        below 150.
    triangles : (t, 3) int, optional
        The mesh. Default: the connectivity of the landmark files if it is a mesh, else the Delaunay triangulation of
        the mean shape.
    copies : int, optional
        Relit copies of each image that the default method, the search, ``varied`` and ``aia`` also learn from. Every
        other copy is mirrored if the object is symmetric; without lamps there is one mirrored copy. With many
        images there are fewer copies of each. Default: 3, or 0 if all of the variance is kept.
    methods : names or Methods, or "all"
        Methods to fit with, besides the default ``soft-li``. Each makes training longer and the model file larger. Fits
        of those that are named have a quality; ``"all"`` calibrates the default method only.
    sides : {"auto", "both", "one"}
        What to do about objects of two sides, such as left and right wings. ``auto``: reflect the images of one side,
        by their stated sides (:attr:`liaam.datasets.Sample.side`) or else by their shapes, so that one model is learnt
        from both; fits then try both (:attr:`liaam.FitResult.side`). ``both``: the same, and fits also try both if all
        training images are of one side that is not stated. ``one``: use all images as they are.
    shapes : int or "auto"
        Number of kinds of shape, 1 to 4, such as those of two species. Each has a model of its own
        (:attr:`liaam.AAM.parts`). ``auto``: more than one if this makes left-out shapes clearly more likely.
    regressor : bool or "auto"
        Whether to learn also a regressor of the landmarks (:mod:`liaam.model.regressor`), which fits of the default
        method start from and weigh in. It helps with objects that vary much. ``auto``: if without it some fits to
        left-out images fail, and fewer fail with it; not if the images are relit by lamps, whose light the regressor
        does not learn, nor if all of the variance is kept or no images are left out.
    refiner : bool or "auto"
        Whether to learn also a refiner (:mod:`liaam.model.regressor`), a regression that moves the landmarks of fits
        from where they are to where they should be. ``auto``: if fits to left-out images are nearer with it; not if all
        of the variance is kept or no images are left out.
    leave_out : bool
        Whether to leave images out in turn and fit them, to calibrate ``FitResult.quality`` and
        ``landmark_covariances``. This doubles the time of training.
    strict : bool
        Whether to refuse images with missing landmarks, and those with landmarks that fold the mesh, which are left out
        otherwise.
    """

    diagonal: float = 150.0
    variance: Variance = 0.98
    appearance_variance: Variance | Mapping[str, Variance] | None = None
    prior: str | Mapping[str, str] | None = None
    blurs: Blurs | Mapping[str, Blurs] | None = None
    triangles: np.ndarray | None = None
    copies: int | None = None
    methods: Methods = ()
    sides: str = AUTO
    shapes: int | str = AUTO
    regressor: bool | str = AUTO
    refiner: bool | str = AUTO
    leave_out: bool = True
    strict: bool = False

    def __post_init__(self) -> None:
        """Check that the values are in range."""
        for variance in (self.variance, *self.appearance_variances.values()):
            check_variance(variance)
        if not isinstance(self.diagonal, Real):
            raise TrainingError(f"diagonal {self.diagonal!r}: give a number of pixels")
        if not isinstance(self.n_copies, Integral):
            raise TrainingError(f"copies {self.copies!r}: give a whole number")
        if not 16 <= self.diagonal <= MAX_DIAGONAL:
            raise TrainingError(
                f"diagonal {self.diagonal:g}: give the size of the reference frame, 16 to {MAX_DIAGONAL:g} pixels"
            )
        if self.shapes != AUTO and self.shapes not in range(1, MOST_SHAPES + 1):
            raise TrainingError(f"shapes {self.shapes!r}: give 1 to {MOST_SHAPES}, or '{AUTO}'")
        if self.sides not in SIDES:
            raise TrainingError(f"sides {self.sides!r}: give {', '.join(SIDES)}")
        chosen(self.methods)
        for name, choice in (("regressor", self.regressor), ("refiner", self.refiner)):
            if choice != AUTO and not isinstance(choice, bool):
                raise TrainingError(f"{name} {choice!r}: give True, False or '{AUTO}'")
        for prior in self.priors(0).values():
            check_prior(prior)
        for view, blurs in self.blurs_by_view.items():
            if not isinstance(blurs, Sequence) or not all(isinstance(blur, Real) for blur in blurs):
                raise TrainingError(f"blurs {blurs!r} of the view {view}: give a tuple of numbers, from coarse to fine")
            falling = list(blurs) == sorted(blurs, reverse=True)
            if not 1 <= len(blurs) <= MAX_LEVELS or not falling or not 0 <= blurs[-1] <= blurs[0] <= MAX_BLUR:
                raise TrainingError(
                    f"blurs {blurs} of the view {view}: give 1 to {MAX_LEVELS} of 0 to {MAX_BLUR:g} pixels of the "
                    "reference frame, from coarse to fine"
                )
        if not 0 <= self.n_copies <= MOST_COPIES:
            raise TrainingError(f"copies {self.n_copies}: give 0 to {MOST_COPIES} relit copies of each image")

    def changed(self, changes: Mapping[str, Any]) -> "TrainingOptions":
        """Return a copy with some options replaced by name; raises for unknown names."""
        allowed = [*(field.name for field in fields(self)), *ARGUMENTS]
        check_options(changes, allowed, CAMERA_OPTIONS)
        return replace(self, **changes)

    @property
    def keeps_all(self) -> bool:
        """Whether all of the variance is kept: a model of exactly the training images."""
        return isinstance(self.variance, float) and self.variance == 1.0

    @property
    def appearance_variances(self) -> dict[str, Variance]:
        """Fraction or number of appearance modes, by view."""
        share = isinstance(self.variance, float) and self.variance < 1.0
        usual = {MESH: self.variance, SURROUNDINGS: min(KEPT, self.variance) if share else self.variance}
        return _by_view("appearance_variance", self.appearance_variance, usual)

    @property
    def blurs_by_view(self) -> dict[str, Blurs]:
        """Blur of each level, by view."""
        size = min(1.0, float(self.diagonal) / FULL_SIZE)
        usual = {**BLURS, SURROUNDINGS: tuple(max(LEAST_BLUR, size * blur) for blur in BLURS[SURROUNDINGS])}
        return _by_view("blurs", self.blurs, usual)

    def learns_regressor(self, under_lamps: bool) -> bool:
        """Whether to learn a regressor, of images that are relit by lamps or not."""
        if self.regressor == AUTO:
            return not under_lamps and not self.keeps_all
        return bool(self.regressor)

    @property
    def learns_refiner(self) -> bool:
        """Whether to learn a refiner."""
        if self.refiner == AUTO:
            return self.leave_out and not self.keeps_all
        return bool(self.refiner)

    def priors(self, n_points: int) -> dict[str, str]:
        """Prior of the shapes by view, for a number of landmarks."""
        smooth = not self.keeps_all and n_points <= MOST_SMOOTH
        return _by_view("prior", self.prior, {MESH: "sample", SURROUNDINGS: "smooth" if smooth else "sample"})

    @property
    def n_copies(self) -> int:
        """Relit copies of each image."""
        return self.copies if self.copies is not None else 0 if self.keeps_all else COPIES


def _by_view(option: str, given: Any, usual: Mapping[str, Any]) -> dict[str, Any]:
    """Value of an option for each view: one for all, or by name with defaults for the others."""
    if given is None:
        return dict(usual)
    if not isinstance(given, Mapping):
        return dict.fromkeys(usual, given)
    unknown = [view for view in given if view not in usual]
    if unknown:
        raise TrainingError(f"{option}: unknown view {unknown[0]!r}; choose from {', '.join(usual)}")
    return {**usual, **given}
