"""Check which landmarks of the training images are missing."""

import warnings
from collections.abc import Sequence

import numpy as np

from liaam.errors import TrainingError
from liaam.formatting import ranges_of
from liaam.io.files import count_of, some_names
from liaam.model.sides import Sides
from liaam.training.filling import COMMON, unlinked

FEWEST = 2  # Fewest images that should have a landmark, to learn how it varies
MOST_NAMED = 12  # Largest number of landmarks that a message names


def check_known(names: Sequence[str], known: np.ndarray, landmark_names: Sequence[str] = ()) -> None:
    """Check which landmarks of images of these names are known, (m, n) bool. The landmarks may have names.

    Raises a TrainingError if a landmark is missing in all, or if nothing says where some lie relative to others. Warns
    the caller of train of landmarks that hardly any image has.
    """
    counts = known.sum(axis=0)
    if not counts.all():
        absent = np.flatnonzero(counts == 0)
        raise TrainingError(
            f"{_called(absent, landmark_names)} missing in all {len(names)} images: place {_it_or_them(absent)} in "
            f"some images, or remove {_it_or_them(absent)} from all landmark files"
        )
    groups = unlinked(known)
    if len(groups) > 1:
        first = some_names([names[int(i)] for i in groups[0]], 3)
        second = some_names([names[int(i)] for i in groups[1]], 3)
        raise TrainingError(
            f"some images ({first}) share fewer than {COMMON} landmarks with others ({second}), so nothing says where "
            f"landmarks {_numbers_of(known[groups[0]])} lie relative to landmarks "
            f"{_numbers_of(known[groups[1]])}: place both in some images, or train on one of these groups "
            "of images"
        )
    rare = np.flatnonzero(counts < FEWEST)
    if len(rare):
        warnings.warn(
            f"{_called(rare, landmark_names)} placed in only 1 of {len(names)} images, from which little can be "
            f"learnt: place {_it_or_them(rare)} in more images",
            stacklevel=6,
        )


def missing_on_a_side(known: np.ndarray, is_other: np.ndarray, sides: Sides, landmark_names: Sequence[str]) -> str:
    """Say which landmarks are missing in all images of one side; empty if none is.

    ``known`` (m, n) bool are the landmarks of the images, and ``is_other`` (m,) bool which images are reflected.
    """
    said = []
    for side, of_side in ((sides.own, ~is_other), (sides.other, is_other)):
        absent = np.flatnonzero(~known[of_side].any(axis=0)) if of_side.any() else np.zeros(0, int)
        if len(absent):
            count = count_of(int(of_side.sum()), f"{side} image")
            said.append(
                f"{_called(absent, landmark_names)} missing in all {count}: fits of {side} objects place "
                f"{_it_or_them(absent)} as on the other side, so that a difference between the sides there is not "
                f"seen. Place {_it_or_them(absent)} in some {side} images"
            )
    return "; ".join(said)


def _numbers_of(known: np.ndarray) -> str:
    """Return the numbers from 1 of the landmarks that some images have, of those that are known, (k, n) bool."""
    return ranges_of((np.flatnonzero(known.any(axis=0)) + 1).tolist())


def _called(landmarks: np.ndarray, names: Sequence[str]) -> str:
    """Return the numbers of landmarks from 1, and their names if they have any, with the verb to be."""
    labels = [f"{i + 1} ({names[i]})" if names and names[i] != str(i + 1) else f"{i + 1}" for i in landmarks.tolist()]
    if len(landmarks) == 1:
        return f"landmark {labels[0]} is"
    return f"landmarks {some_names(labels, MOST_NAMED)} are"


def _it_or_them(landmarks: np.ndarray) -> str:
    """Return the pronoun for landmarks."""
    return "it" if len(landmarks) == 1 else "them"
