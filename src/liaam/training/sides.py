"""Reflect the images of one side, so that one model is learnt from both, such as left and right wings."""

import warnings
from collections.abc import Sequence
from dataclasses import replace

from liaam.datasets.sides import SidesOfShapes, sides_of_shapes
from liaam.errors import LiaamError, TrainingError
from liaam.model.sides import ORIGINAL, Sides
from liaam.training.entries import Entry, TrainingData, known_of
from liaam.training.incomplete import missing_on_a_side


def on_one_side(data: TrainingData, choice: str) -> TrainingData:
    """Reflect the samples of the side that fewer have.

    Parameters
    ----------
    data : TrainingData
        Missing landmarks are NaN.
    choice : str
        As :attr:`liaam.training.TrainingOptions.sides`.

    Raises
    ------
    TrainingError
        If sides are stated for some samples only, are neither left nor right, or contradict the shapes.
    """
    if choice == "one":
        return data
    found = _sides_of(data)
    if found.said:
        warnings.warn(found.said, stacklevel=4)  # the caller of train, which is decorated
    sides = found.sides
    if sides is None and choice == "both":
        return replace(data, sides=Sides(ORIGINAL, len(data.entries)))
    if sides is None:
        return data
    lacking = missing_on_a_side(known_of(data.entries), found.is_other, sides, data.landmark_names)
    if lacking:
        warnings.warn(lacking, stacklevel=4)  # the caller of train, which is decorated
    entries = [
        entry.reflection() if is_other else entry
        for entry, is_other in zip(data.entries, found.is_other.tolist(), strict=True)
    ]
    return replace(data, entries=entries, sides=sides)


def counted(sides: Sides | None, entries: Sequence[Entry]) -> Sides | None:
    """Return the sides with the numbers of samples of each that a model is learnt from: some may have been left out."""
    if sides is None:
        return None
    n_other = sum(entry.reflected for entry in entries)
    return replace(sides, n_own=len(entries) - n_other, n_other=n_other)


def of_all(sides: Sequence[Sides | None]) -> Sides | None:
    """Return the sides of several models of one set of samples, with the numbers of samples of all together."""
    known = [each for each in sides if each is not None]
    if not known:
        return None
    return replace(known[0], n_own=sum(each.n_own for each in known), n_other=sum(each.n_other for each in known))


def _sides_of(data: TrainingData) -> SidesOfShapes:
    try:
        return sides_of_shapes(data.shapes, [entry.side for entry in data.entries], data.names)
    except LiaamError as fault:
        raise TrainingError(str(fault)) from fault
