"""Check which landmarks of the training images are missing."""

import warnings
from collections.abc import Sequence

import numpy as np

from liaam.errors import TrainingError
from liaam.formatting import ranges_of
from liaam.io.files import some_names
from liaam.training.filling import COMMON, unlinked

FEWEST = 2  # Fewest images that should have a landmark, to learn how it varies


def check_known(names: Sequence[str], known: np.ndarray) -> None:
    """Check which landmarks of images of these names are known, (m, n) bool.

    Raises a TrainingError if a landmark is missing in all, or if nothing says where some lie relative to others. Warns
    the caller of train of landmarks that hardly any image has.
    """
    counts = known.sum(axis=0)
    if not counts.all():
        absent = np.flatnonzero(counts == 0)
        raise TrainingError(
            f"{_numbers_of(absent)} missing in all {len(names)} images: place {_it_or_them(absent)} in some "
            f"images, or remove {_it_or_them(absent)} from all landmark files"
        )
    groups = unlinked(known)
    if len(groups) > 1:
        first = some_names([names[int(i)] for i in groups[0]], 3)
        second = some_names([names[int(i)] for i in groups[1]], 3)
        raise TrainingError(
            f"some images ({first}) share fewer than {COMMON} landmarks with others ({second}), so nothing says where "
            f"{_numbers_of(np.flatnonzero(known[groups[0]].any(axis=0)), ('', ''))} lie relative to "
            f"{_numbers_of(np.flatnonzero(known[groups[1]].any(axis=0)), ('', ''))}: place both in some images, or "
            "train on one of these groups of images"
        )
    rare = np.flatnonzero(counts < FEWEST)
    if len(rare):
        warnings.warn(
            f"{_numbers_of(rare)} placed in only 1 of {len(names)} images, from which little can be learnt: place "
            f"{_it_or_them(rare)} in more images",
            stacklevel=6,
        )


def _numbers_of(landmarks: np.ndarray, verbs: tuple[str, str] = (" is", " are")) -> str:
    """Name landmarks by their numbers from 1, with a verb for one and for several."""
    numbers = ranges_of([int(i) + 1 for i in landmarks])
    return f"landmark {numbers}{verbs[0]}" if len(landmarks) == 1 else f"landmarks {numbers}{verbs[1]}"


def _it_or_them(landmarks: np.ndarray) -> str:
    """Return the pronoun for landmarks."""
    return "it" if len(landmarks) == 1 else "them"
