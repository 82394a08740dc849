"""Images of one object, by their names: they are left out together, as they are more alike than others."""

import re
from collections.abc import Sequence
from itertools import takewhile

import numpy as np

from liaam.io.files import some_names
from liaam.io.sides import LEFT, RIGHT, in_places_or_names
from liaam.training.entries import image_of

LEFT_OUT_FOLDS = 5  # Largest number of folds: a model is trained without each, which takes as long as a level

FILE_SUFFIX = re.compile(r"\.[A-Za-z]{2,4}\d?$")  # such as .png or .jp2
# The end of an image's name that differs between the images of an object: what follows the last separator, or a number
NUMBER_OF_IMAGE = re.compile(r"([-_. ][^-_. /]*|\d+)$")
AFTER_SEPARATOR = re.compile(r"[-_. ][^-_. /]*$")


def objects_of(names: Sequence[str]) -> dict[str, list[int]]:
    """Group samples by object if names such as 07-1, 07-2 or anna1, anna2 identify it; else return nothing.

    Both sides of an individual are of one object, in names (fly1_left) and in folders (left/fly1). There must be at
    least three objects, none of which has more than half of the images.
    """
    images = [FILE_SUFFIX.sub("", image_of(name)) for name in names]
    for objects in (*_individuals_of(images), [_without_number(image) for image in images]):
        groups: dict[str, list[int]] = {}
        for i, name in enumerate(objects):
            groups.setdefault(name, []).append(i)
        if len(groups) >= 3 and max(map(len, groups.values())) <= len(names) / 2:
            return groups
    return {}


def _individuals_of(images: Sequence[str]) -> list[list[str]]:
    """Return what the individuals may be called of which images show both sides, the likeliest first; else nothing."""
    named = in_places_or_names(images)
    of_left, of_right = ({each.rest for each in named if each.side == side} for side in (LEFT, RIGHT))
    if not of_left & of_right:
        return []
    without_side = [each.rest for each in named]
    return [list(map(_individual, images, without_side)), without_side]


def _individual(image: str, without_side: str) -> str:
    """Return the name of an individual, without what may be the number of its image: fly1_left_2, left/fly1_2."""
    folder, slash, name = without_side.rpartition("/")
    of_image = image.rpartition("/")[2]
    alike = takewhile(lambda letters: letters[0] == letters[1], zip(of_image, name, strict=False))
    before_side = "".join(letter for letter, _ in alike).rstrip("-_. ")
    if of_image != name and before_side:
        return folder + slash + before_side
    return AFTER_SEPARATOR.sub("", without_side)


def _without_number(image: str) -> str:
    """Return the name of an image without its number, or as it is if it is a number."""
    return NUMBER_OF_IMAGE.sub("", image) or image


def groups_of(names: Sequence[str]) -> list[np.ndarray]:
    """Group samples by object if their names identify it (:func:`objects_of`); else each is a group."""
    groups = list(objects_of(names).values()) or [[i] for i in range(len(names))]
    return [np.array(group) for group in groups]


def describe_objects(names: Sequence[str]) -> str:
    """Return which samples are left out together, if any are."""
    counts = {name: len(members) for name, members in objects_of(names).items()}
    if max(counts.values(), default=1) == 1:
        return ""
    shown = some_names([f"{name} ({count})" for name, count in counts.items()], 4)
    return f"images of the same object, by their names: {shown}; cross-validation leaves them out together"


def folds_of(names: Sequence[str], most: int = LEFT_OUT_FOLDS) -> list[np.ndarray]:
    """At most so many folds of samples, by object if their names identify it (:func:`objects_of`)."""
    samples_of_objects = groups_of(names)
    n_objects = len(samples_of_objects)
    folds = []
    for objects in np.array_split(np.arange(n_objects), min(n_objects, most)):
        samples = [sample for i in objects for sample in samples_of_objects[i]]
        folds.append(np.array(sorted(samples)))
    return folds
