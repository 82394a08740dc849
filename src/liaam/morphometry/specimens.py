"""Read specimens: fits, tables of batches, and landmark files."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path, PureWindowsPath
from typing import Any

import numpy as np

from liaam.batch.tables import TABLE_SUFFIXES, is_table, read_rows
from liaam.errors import LandmarkError, LiaamError
from liaam.formatting import short_repr
from liaam.io.files import existing_file, natural_key, some_names
from liaam.io.fit_files import corrected_file, points_of_fit, read_fit
from liaam.io.landmarks import LANDMARK_SUFFIXES, Contour, LandmarkFile
from liaam.io.landmarks.matching import stem_of
from liaam.io.landmarks.reading import USUAL, Reading, UnrecognisedError
from liaam.tables import Columns, landmark_columns

# Largest coordinate in pixels, variance in square pixels, and length of a pixel, so that no measure overflows
_MOST = 1e9
_SAME = 2.0  # Difference in pixels that rounding to whole pixels can make between distances, and a little more
_ROUNDING = 1e-5  # Smallest eigenvalue of a covariance, relative to the largest entry of all, because files round them


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

    __repr__ = short_repr

    def __post_init__(self) -> None:
        object.__setattr__(self, "points", np.asarray(self.points, np.float64))
        n = len(self.points)
        spread = np.zeros((n, 2, 2)) if self.covariances is None else np.nan_to_num(self.covariances, nan=0)
        if np.shape(self.points) != (n, 2) or np.shape(spread) != (n, 2, 2):
            raise LandmarkError(f"specimen {self.name}: give (n, 2) points and (n, 2, 2) covariances")
        if (np.abs(self.points) > _MOST).any() or (self.scale is not None and not 0 < self.scale < _MOST):
            raise LandmarkError(f"specimen {self.name}: a point or the scale is out of range: give points in pixels")
        if (
            not (np.abs(spread) <= _MOST).all()
            or (np.linalg.eigvalsh(spread) < -_ROUNDING * np.abs(spread).max(initial=0)).any()
        ):
            raise LandmarkError(f"specimen {self.name}: a covariance is not positive definite: give square pixels")
        if any(not 0 <= index < n for curve in self.curves for index in curve.indices):
            raise LandmarkError(f"specimen {self.name}: a curve has a landmark that does not exist: correct the curve")

    def to_columns(self, name: str | None = None) -> Columns:
        """Return the landmarks as a table of lists, one row per landmark; see :func:`liaam.to_dataframe`."""
        labels = {"specimen": name or self.name}
        more = {"names": self.names, "status": self.status}
        return landmark_columns(labels, self.points, self.covariances, **more)


def read_specimens(
    path: str | os.PathLike[str],
    on_fault: Callable[[str], object] | None = None,
    reading: Reading = USUAL,
    replicates: bool = False,
) -> tuple[Specimen, ...]:
    """Read the specimens of a folder or a file.

    Parameters
    ----------
    path : path-like
        A ``.json`` of ``liaam fit``; a table of ``liaam batch``; a landmark file in any format, also with many images;
        or a folder of such files. Of several files of an image, its ``.json`` is read, or else the first in the order
        of `liaam.io.LANDMARK_SUFFIXES`. Images are not needed, except for ``.asf``.
    on_fault : callable, optional
        Called with a message for each file of a folder that is skipped because it cannot be read, and about records
        that are left out. Default: a warning.
    reading : Reading, optional
        How to read landmark files. If strict, a file or record that cannot be read is an error.
    replicates : bool
        Whether to keep an image's records in all files, named ``image#file`` from the second on, not only in the first.

    Returns
    -------
    tuple of Specimen
        In natural order of their names (2 before 10) for a folder, otherwise in the order of the file.

    Raises
    ------
    LiaamError
        If the path does not exist, a file cannot be read, or a folder holds none that can.
    """
    path = Path(path)
    complain = on_fault or partial(warnings.warn, stacklevel=2)
    if not path.is_dir():
        return tuple(_of_file(existing_file(path, LiaamError, "file of results"), complain, reading))
    by_name: dict[str, Specimen] = {}
    for file in _chosen(path):
        others = []
        try:
            for specimen in _of_file(file, complain, reading):
                again = replicates and specimen.name in by_name
                named = replace(specimen, name=f"{specimen.name}#{file.stem}") if again else specimen
                if _differ(by_name.setdefault(named.name, named).points, named.points):
                    others.append(named.name)
        except LiaamError as fault:
            if isinstance(fault, UnrecognisedError) and file.suffix.lower() == ".txt":
                continue
            if reading.strict:
                raise
            complain(f"skipped {file.name}: {str(fault).removeprefix(f'{file}: ')}")
        if others:
            complain(f"left out of {file.name}, because others of these names were read before: {some_names(others)}")
    if not by_name:
        raise LiaamError(
            f"{path} holds no results that can be read: name a folder of 'liaam fit', a table of 'liaam batch', or "
            f"landmark files ({', '.join(LANDMARK_SUFFIXES)})"
        )
    return tuple(by_name[name] for name in sorted(by_name, key=natural_key))


def _differ(points: np.ndarray, others: np.ndarray) -> bool:
    """Return whether landmarks have other distances than by rounding to whole pixels; those of y upwards do not."""
    if points.shape != others.shape:
        return True
    steps, other_steps = (np.linalg.norm(np.diff(each, axis=0), axis=1) for each in (points, others))
    return bool((np.abs(steps - other_steps) > _SAME).any())


def _chosen(folder: Path) -> list[Path]:
    """Return one file per stem, so that the files of a fit count once."""
    order = (".json", *TABLE_SUFFIXES, *LANDMARK_SUFFIXES)
    files = [file for file in folder.iterdir() if file.suffix.lower() in order and not file.name.startswith(".")]
    chosen: dict[str, Path] = {}
    for file in sorted(files, key=lambda file: (order.index(file.suffix.lower()), natural_key(file.name))):
        chosen.setdefault(file.stem, file)
    return list(chosen.values())


def _of_file(path: Path, complain: Callable[[str], object], reading: Reading) -> Iterator[Specimen]:
    fit = read_fit(path) if path.suffix.lower() == ".json" else None
    if fit:  # other .json files hold landmarks only
        fitted = _specimen(path, path.stem, fit, fit.get("covariance"))
        yield _corrected(path, fit, fitted, complain)
    elif is_table(path):
        for row in read_rows(path):
            number = f"#{row['object']}" if row.get("object") else ""
            yield _specimen(path, PureWindowsPath(row["path"]).stem + number, row, row.get("covariance"))
    else:
        yield from _of_landmarks(path, reading, complain)


def _specimen(path: Path, name: str, facts: dict[str, Any], covariances: Any) -> Specimen:
    try:
        points = _numbers(facts["landmarks"] or []).reshape(-1, 2)
        spread = None
        if covariances:
            xx, xy, yy = _numbers(covariances).reshape(len(points), 3).T
            spread = np.stack([xx, xy, xy, yy], axis=1).reshape(-1, 2, 2)
        scale = facts.get("scale")
        names = tuple(map(str, facts.get("landmark_names") or ()))
        curves = Contour.all_of(facts.get("contours") or ())
        return Specimen(name, points, spread, names, scale and float(scale), str(facts["status"]), curves)
    except (TypeError, ValueError, OverflowError, LandmarkError) as fault:
        raise LandmarkError(f"{path}: the landmarks of {name} are damaged ({fault}): fit the image again") from fault


def _corrected(path: Path, fit: dict, fitted: Specimen, complain: Callable[[str], object]) -> Specimen:
    """Return a fit's specimen with the points of a landmark file beside it that was changed since, if there is one."""
    file = corrected_file(path, fit)
    if file is None:
        return fitted
    try:
        points = points_of_fit(file, fit)
        names, curves = (fitted.names, fitted.curves) if len(points) == len(fitted.points) else ((), ())
        corrected = replace(fitted, points=points, covariances=None, names=names, status="", curves=curves)
    except LandmarkError as fault:
        complain(f"{path.stem}: {fault}; the points of the fit are used")
        return fitted
    complain(f"{path.stem}: measured from {file.name}, whose points were changed after the fit")
    return corrected


def _numbers(values: Any) -> np.ndarray:
    """Convert to float64. What is out of range, as in fits that diverged, is NaN."""
    numbers = np.array(values, dtype=np.float64)
    return np.where(np.abs(numbers) <= _MOST, numbers, np.nan)


def _of_landmarks(path: Path, reading: Reading, complain: Callable[[str], object]) -> Iterator[Specimen]:
    file = LandmarkFile.read(path, reading)

    def make(entry: str) -> list[Specimen]:
        # Measures depend on neither the height of an image nor its orientation, but on its size if the file states one.
        placing = file.entries[entry].placing
        placed = file.placed(entry, None if placing.size or placing.fractions else (1, 1))
        every = placed.objects(path.stem if file.is_single else stem_of(entry))
        return [
            Specimen(name, landmarks.points, None, landmarks.names, landmarks.scale, curves=landmarks.contours)
            for name, landmarks in every
        ]

    try:
        for specimens in file.each(((entry or path.stem, entry) for entry in file.entries), make):
            yield from specimens
    except LandmarkError as fault:
        raise LandmarkError(f"{path}: {str(fault).removeprefix(f'{path}: ')}") from fault
    for line in file.notes.lines():
        complain(f"{path.name}: {line.replace(f'{path}: ', '')}")
