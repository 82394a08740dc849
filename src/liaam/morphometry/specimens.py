"""The class `Specimen`: the landmarks of one specimen."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from liaam.errors import LandmarkError, LiaamError
from liaam.fitting.result import USABLE, FitResult
from liaam.formatting import short_repr
from liaam.io.landmarks import Contour
from liaam.scale.lengths import UNITS
from liaam.tables import Columns, landmark_columns

MOST = 1e9
"""Largest coordinate in pixels, variance in square pixels, and length of a pixel, so that no measure overflows."""

# Smallest eigenvalue of a covariance, relative to the largest entry of all, because files round them.
_ROUNDING = 1e-5


@dataclass(frozen=True, eq=False)
class Specimen:
    """The landmarks of one specimen.

    Attributes
    ----------
    name : str
        Name, such as the image's file name without suffix.
    points : (n, 2) float64
        x and y in pixels, y downwards; NaN where missing.
    covariances : (n, 2, 2) float64, optional
        Covariances of x and y, square pixels; NaN or None if unknown.
    names : tuple of str
        One name per landmark, or empty.
    scale : float, optional
        Length of a pixel in the specimen's units; None if unknown.
    status : str
        How its fit ended (:class:`liaam.FitStatus`), or empty.
    curves : tuple of liaam.io.landmarks.Contour
        Lines through the landmarks.
    replicate_of : str
        Name of the object that this is a record of. Those of one object are its replicates. Empty if unknown.
    file : str
        Name of the file that it was read from, or empty.
    individual : str
        Individual that it is a structure of, such as the fly of a wing, or empty. Its name is that if unknown.
    side : str
        Side of the individual, ``left`` or ``right`` or as a table has it, or empty if unknown.
    stated_side : str
        Side that its name, a folder or a column states, if its fit or its shape has another, or empty. `side` is then
        by the fit or the shape.
    reflected : bool
        Whether x was reversed, to compare it with specimens of the other side.
    estimated : tuple of int
        Landmarks that were missing, and were estimated from other specimens, or by the fit from its other landmarks,
        counted from 0.
    unit : str
        Unit of the scale, one of `liaam.scale.UNITS`, or empty if unknown.
    scale_se : float
        Standard error of the scale; 0 if it is taken as exact.
    scale_source : str
        Where the scale is from if nobody gave it, for messages, or empty.
    image : str
        Name or path of the image that it is in, if a fit states it, or empty.
    fingerprint : str
        That of the file of this image (:func:`liaam.io.files.fingerprint_of`), if a fit states it, or empty.
    code : str
        The QR or bar code that names it, or empty.

    Raises
    ------
    LandmarkError
        If an array has another shape or holds numbers out of range, or a covariance is not positive definite.
    """

    name: str
    points: np.ndarray
    covariances: np.ndarray | None = None
    names: tuple[str, ...] = ()
    scale: float | None = None
    status: str = ""
    curves: tuple[Contour, ...] = ()
    replicate_of: str = ""
    file: str = ""
    individual: str = ""
    side: str = ""
    stated_side: str = ""
    reflected: bool = False
    estimated: tuple[int, ...] = ()
    unit: str = ""
    scale_se: float = 0.0
    scale_source: str = ""
    image: str = ""
    fingerprint: str = ""
    code: str = ""

    __repr__ = short_repr

    def __post_init__(self) -> None:
        object.__setattr__(self, "points", np.asarray(self.points, np.float64))
        n = len(self.points)
        spread = np.zeros((n, 2, 2)) if self.covariances is None else np.nan_to_num(self.covariances, nan=0)
        if np.shape(self.points) != (n, 2) or np.shape(spread) != (n, 2, 2):
            raise LandmarkError(f"specimen {self.name}: give (n, 2) points and (n, 2, 2) covariances")
        if (np.abs(self.points) > MOST).any() or (self.scale is not None and not 0 < self.scale < MOST):
            raise LandmarkError(f"specimen {self.name}: a point or the scale is out of range: give points in pixels")
        if not 0 <= self.scale_se < MOST or self.unit not in ("", *UNITS):
            raise LandmarkError(f"specimen {self.name}: give the scale's unit as {', '.join(UNITS)}, and its error")
        if (
            not (np.abs(spread) <= MOST).all()
            or (np.linalg.eigvalsh(spread) < -_ROUNDING * np.abs(spread).max(initial=0)).any()
        ):
            raise LandmarkError(f"specimen {self.name}: a covariance is not positive definite: give square pixels")
        if any(not 0 <= index < n for curve in self.curves for index in curve.indices):
            raise LandmarkError(f"specimen {self.name}: a curve has a landmark that does not exist: correct the curve")

    @classmethod
    def of_fit(cls, result: FitResult, name: str = "", absent: str = "empty") -> Specimen:
        """Return the specimen of a fit, with its side, as :func:`liaam.read_specimens` reads it from a file.

        Parameters
        ----------
        result : FitResult
        name : str
            By default that of the image's file, without its ending.
        absent : {"empty", "estimate"}
            What stands for absent landmarks (:attr:`liaam.FitResult.absent`): NaN, or the estimates of the fit, which
            `estimated` then lists.

        Raises
        ------
        LiaamError
            If the image has no file, and no name is given.
        """
        image = result.image.name if isinstance(result.image, Path) else ""
        name = name or Path(image).stem
        if not name:
            raise LiaamError("the image of the fit is from no file: give the specimen a name")
        points, covariances = (np.where(np.abs(each) <= MOST, each, np.nan) for each in result.reported(absent))
        is_estimated = result.absent & np.isfinite(points).all(axis=1) & result.status.ok
        return cls(
            name,
            points,
            covariances,
            names=result.landmark_names,
            status=str(result.status),
            curves=Contour.all_of(result.contours),
            side=result.side,
            estimated=tuple(np.flatnonzero(is_estimated).tolist()),
            image=image,
        )

    @property
    def is_usable(self) -> bool:
        """Whether its landmarks may be measured: those of a fit that may be used, or of a person."""
        return not self.status or self.status in USABLE

    @property
    def measured(self) -> np.ndarray:
        """Its points (n, 2) without those that were estimated, which are NaN."""
        points = self.points.copy()
        points[list(self.estimated)] = np.nan
        return points

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of its landmarks; without names, their numbers from 1."""
        return self.names or tuple(str(number) for number in range(1, len(self.points) + 1))

    def list_of(self, indices: Iterable[int]) -> str:
        """Return names or numbers of landmarks as a cell of a table: with semicolons, as names may hold blanks."""
        return "; ".join(self.labels[index] for index in indices)

    def to_columns(self, name: str | None = None) -> Columns:
        """Return the landmarks as a table of lists, one row per landmark; see :func:`liaam.to_dataframe`."""
        labels = {"specimen": name or self.name}
        more = {"names": self.names, "status": self.status}
        return landmark_columns(labels, self.points, self.covariances, **more)


def has_shape(points: np.ndarray) -> bool:
    """Return whether there are points (n, 2), none is missing and not all are in one place."""
    return len(points) > 0 and bool(np.isfinite(points).all()) and bool(np.ptp(points, axis=0).any())
