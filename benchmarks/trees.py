"""Regression trees of dlib that are trained on landmarked pictures, to compare fits with."""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from benchmarks.fit import Picture, box_of


def dlib_box(shape: np.ndarray) -> Any:
    """Make a dlib rectangle of a shape (n, 2)."""
    dlib: Any = __import__("dlib")
    return dlib.rectangle(*map(int, np.rint(box_of(shape))))


def trained_trees(pictures: Sequence[Picture], **options: float) -> Any:
    """Train a predictor, in one thread; ``options`` are fields of dlib's options that differ from its defaults."""
    dlib: Any = __import__("dlib")
    settings = dlib.shape_predictor_training_options()
    settings.num_threads = 1
    settings.be_verbose = False
    for name, value in options.items():
        setattr(settings, name, value)
    objects = []
    for _, shape in pictures:
        points = [dlib.point(*map(int, np.rint(point))) for point in shape]
        objects.append([dlib.full_object_detection(dlib_box(shape), points)])
    return dlib.train_shape_predictor([image for image, _ in pictures], objects, settings)


def points_of(found: Iterable[Any]) -> np.ndarray:
    """Return the points that a predictor has found, (n, 2) float64."""
    return np.array([(point.x, point.y) for point in found], float)
