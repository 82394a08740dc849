"""Fit the specimens of a photograph, and name them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from liaam.fitting.fitter import Fitter
from liaam.fitting.result import FitResult
from liaam.fitting.search.starts import read_with_start
from liaam.io.files import count_of, fingerprint_of, some_names
from liaam.photometry.picture import load_picture
from liaam.scale.choice import length_for
from liaam.scale.lengths import Length
from liaam.trays.codes import read_codes
from liaam.trays.naming import POSITION, Named, check_name_by, in_sentences, name_specimens
from liaam.trays.order import diagonal, touching, unplaced

SMALL = 0.7
"""Size, of the median of fits that are not lost, below which a place with a lost fit is no specimen."""


@dataclass(frozen=True)
class FittedSpecimens:
    """The specimens of a photograph.

    Attributes
    ----------
    results : list of FitResult
        In reading order.
    named : list of liaam.trays.Named
        The name of each.
    faults : list of str
        What is not clear about the photograph.
    """

    results: list[FitResult]
    named: list[Named]
    faults: list[str]

    def message(self, i: int) -> str:
        """Return what is said of a specimen: of its fit, and what is not clear about it."""
        return in_sentences(self.results[i].message, self.named[i].fault)


@dataclass(frozen=True, eq=False)
class FittedPhotograph:
    """A photograph from a file, and the fits to its specimens.

    Attributes
    ----------
    pixels : (h, w, 3) uint8, uint16 or float32
    specimens : FittedSpecimens
    length : Length, optional
        Length of a pixel: of its start, its tags, or else the training images.
    fingerprint : str
        That of its file (:func:`liaam.io.files.fingerprint_of`).
    """

    pixels: np.ndarray
    specimens: FittedSpecimens
    length: Length | None
    fingerprint: str

    @property
    def size(self) -> tuple[int, int]:
        """Width and height."""
        height, width = self.pixels.shape[:2]
        return width, height


def fit_photograph(
    fitter: Fitter, file: Path, init: str | None = None, *, every: bool, stem: str, name_by: str = POSITION
) -> FittedPhotograph:
    """Read a photograph and its start, fit its specimens, and measure its pixels: what ``liaam fit`` and batches do.

    Parameters
    ----------
    fitter : Fitter
    file : Path
        The photograph.
    init : str, optional
        Its start, as :func:`liaam.fitting.search.starts.read_start` takes it.
    every, stem, name_by
        As for :func:`fit_specimens`.

    Raises
    ------
    LiaamError
        For invalid input, if no object is found, or if codes cannot be read.
    """
    pixels, start = read_with_start(file, init)
    specimens = fit_specimens(fitter, pixels, start, every=every, name=file.name, stem=stem, name_by=name_by)
    return FittedPhotograph(pixels, specimens, length_for(file, start, fitter.model.scale), fingerprint_of(file))


def fit_specimens(
    fitter: Fitter,
    image: Any,
    init: Any = None,
    *,
    every: bool = True,
    name: str = "image",
    stem: str = "image",
    name_by: str = POSITION,
) -> FittedSpecimens:
    """Fit one or every specimen of a photograph, name them, and say which touch.

    Parameters
    ----------
    fitter : Fitter
    image : (h, w, 3) uint8, uint16 or float array, or path
    init : start, optional
        As for :meth:`Fitter.fit`, if only one specimen is fitted.
    every : bool
        Whether every specimen that the search finds is fitted. What lies on a code that names specimens is none.
    name : str
        Name of the image in errors.
    stem : str
        Name of the photograph, which is part of names by position.
    name_by : str
        What names specimens, one of `liaam.trays.NAME_BY`; see :func:`liaam.trays.name_specimens`.

    Raises
    ------
    LiaamError
        For invalid input, if no object is found, or if codes cannot be read.
    """
    check_name_by(name_by)
    pixels, name = load_picture(image, name)
    codes = [] if name_by == POSITION else read_codes(pixels)
    if every:
        fits = fitter.fit_objects(pixels, name, [code.corners for code in codes])
    else:
        fits = [fitter.fit(pixels, init, name)]
    results = without_small_lost(fits)
    last = unplaced([result.place for result in results], [result.status.ok for result in results]) if every else []
    results = [result for i, result in enumerate(results) if i not in last] + [results[i] for i in last]
    shapes = [np.empty((0, 2)) if result.status.lost else result.landmarks for result in results]
    named, faults = name_specimens(shapes, codes, stem, name_by, single=not every)
    named, of_touching = with_touching(named, touching(shapes))
    about = _about_lost(fits, results, named, len(results) - len(last))
    return FittedSpecimens(results, named, [*faults, *of_touching, *about])


def _about_lost(fits: list[FitResult], kept: list[FitResult], named: list[Named], n_placed: int) -> list[str]:
    """Return what is to be said of places left out, and of fits that may not be used: they may be no specimens.

    Those after the first ``n_placed`` are at no place of the tray's rows and columns.
    """
    n_left_out = len(fits) - len(kept)
    where = f"{count_of(n_left_out, 'place')} much smaller than the specimens"
    lines = [f"{where}, where the fit was lost, left out"] if n_left_out else []
    numbered = [i for i, each in enumerate(named) if not each.code]
    unsure = [i for i in numbered if i < n_placed and not kept[i].status.ok]
    if unsure and n_placed > 1 and unsure[0] < numbered[-1]:
        names = some_names([named[i].name for i in unsure])
        lines.append(
            f"fits that may not be used: {names}; if these are no specimens, the numbers after them are too high"
        )
    last = [named[i].name for i in numbered if i >= n_placed]
    if last:
        lines.append(
            f"fits that may not be used, in no row and column of the others, come last: {some_names(last)}; if one is "
            "a specimen, the numbers after its place are too low"
        )
    return lines


def without_small_lost(fits: list[FitResult]) -> list[FitResult]:
    """Return fits without lost ones at places that are clearly smaller than the others, such as on labels."""
    sizes = [diagonal(fit.landmarks) for fit in fits if not fit.status.lost]
    if not sizes:
        return fits
    least = SMALL * float(np.median(sizes))
    return [fit for fit in fits if not (fit.status.lost and diagonal(fit.place) < least)]


def with_touching(named: list[Named], pairs: list[tuple[int, int]]) -> tuple[list[Named], list[str]]:
    """Return named specimens with a fault of those that touch, and a sentence for each pair."""
    found = list(named)
    for i, j in pairs:
        for one, other in ((i, j), (j, i)):
            fault = f"it touches {named[other].name}, or nearly: check its landmarks"
            found[one] = found[one].with_fault(fault)
    return found, [f"{named[i].name} and {named[j].name} touch, or nearly: check their landmarks" for i, j in pairs]
