"""Fit left-out images to calibrate the quality of fits."""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from liaam.fitting.methods import Method, needed_by
from liaam.io.files import some_names
from liaam.model import AAM, VIEWS, Level
from liaam.model.appearance import COPIED_APPEARANCES, train_appearance_model
from liaam.model.pca import Variance
from liaam.model.shape import Recipe, shape_model_on
from liaam.photometry.encoding import as_colour
from liaam.training.entries import Entry, image_of
from liaam.training.lamps import Copies
from liaam.training.reliability import LeftOutImage, calibrate
from liaam.training.textures import FITTED, SOURCES, Sampled, Steps, learning_cost

# Largest numbers of models to train without a fold, and of left-out images to fit
LEFT_OUT_FOLDS, LEFT_OUT_PICTURES = 5, 20


ViewSettings = Mapping[str, tuple[Recipe, Variance, Variance]]
"""Recipe of the shapes, and variances of shapes and appearances to keep, by view."""


def calibrated(
    model: AAM,
    entries: list[Entry],
    shapes: np.ndarray,
    sampled: Sampled,
    copied: Copies,
    settings: ViewSettings,
    methods: Sequence[Method],
    folds: list[np.ndarray],
    steps: Steps,
) -> AAM:
    """Calibrate the quality of methods' fits on left-out images, original and relit by left-out lamps.

    Images of one object, recognised by their names, are left out together. With each fold one half of the lamps is left
    out, because the light of later images differs from all lamps, and more than neighbouring lamps differ.
    """
    halves = [np.zeros(0, int)] if copied.lamps is None else copied.lamps.halves()

    def images() -> Iterator[LeftOutImage]:
        """Yield some images of each fold with the model of the other folds, one model at a time."""
        for i, fold in enumerate(folds):
            steps.next(f"leaving out part {i + 1} of {len(folds)}", learning_cost(model.n_textures))
            lamps = halves[i % len(halves)]
            usable_rows = np.flatnonzero(~np.isin(copied.lit_by, lamps))
            part = _without(model, fold, shapes, sampled, settings, methods, usable_rows)
            for j in fitted_of(fold, folds):
                steps.next(f"fitting {entries[j].name}", FITTED)
                image = as_colour(entries[j].read_image(), entries[j].name)
                yield LeftOutImage(part, image, shapes[j])
                for relit in copied.relit(j, image, shapes[j], model.response, lamps):
                    yield LeftOutImage(part, relit, shapes[j], relit=True)

    reliabilities = calibrate(model, images(), methods)
    for view in VIEWS:
        of_view = {
            method.name: reliabilities[method.name]
            for method in methods
            if method.view == view and method.name in reliabilities
        }
        model = model.with_view(view, reliabilities=of_view)
    return model


def can_be_calibrated(method: Method) -> bool:
    """Return whether a method fits appearances that can be learnt again without some images."""
    return not set(needed_by(method)) & {*SOURCES, "features"}


def fitted_of(fold: np.ndarray, folds: list[np.ndarray]) -> np.ndarray:
    """Images of a left-out fold to fit."""
    each = max(1, LEFT_OUT_PICTURES // len(folds))
    return fold[np.linspace(0, len(fold) - 1, min(each, len(fold))).astype(int)]


def objects_of(names: Sequence[str]) -> dict[str, list[int]]:
    """Group samples by object if names such as 07-1, 07-2 or anna1, anna2 identify it; else return nothing.

    There must be at least three objects, none of which has more than half of the images.
    """
    groups: dict[str, list[int]] = {}
    for i, name in enumerate(map(image_of, names)):
        object_name = re.sub(r"([-_. ][^-_. /]*|\d+)$", "", re.sub(r"\.[A-Za-z]{2,4}\d?$", "", name))
        groups.setdefault(object_name or name, []).append(i)
    return groups if len(groups) >= 3 and max(map(len, groups.values())) <= len(names) / 2 else {}


def describe_objects(names: Sequence[str]) -> str:
    """Return which samples are left out together, if any are."""
    counts = {name: len(members) for name, members in objects_of(names).items()}
    if max(counts.values(), default=1) == 1:
        return ""
    shown = some_names([f"{name} ({count})" for name, count in counts.items()], 4)
    return f"images of one object, by their names, are left out together: {shown}"


def folds_of(names: Sequence[str], most: int = LEFT_OUT_FOLDS) -> list[np.ndarray]:
    """At most so many folds of samples, by object if their names identify it (:func:`objects_of`)."""
    members = list(objects_of(names).values()) or [[i] for i in range(len(names))]
    parts = np.array_split(np.arange(len(members)), min(len(members), most))
    return [np.array(sorted(i for member in part for i in members[member])) for part in parts]


def _without(
    model: AAM,
    fold: np.ndarray,
    shapes: np.ndarray,
    sampled: Sampled,
    settings: ViewSettings,
    methods: Sequence[Method],
    usable_rows: np.ndarray,
) -> AAM:
    """Train a model without a fold, on the frame and with the settings of the whole model.

    Of the textures with copies, only the ``usable_rows`` are used: those under lamps that are not left out.
    """
    others = np.setdiff1d(np.arange(len(shapes)), fold)
    for name in dict.fromkeys(method.view for method in methods):
        recipe, variance, appearance_variance = settings[name]
        view, levels = model.views[name], []
        needed = set().union(*(needed_by(method) for method in methods if method.view == name))
        for i, level in enumerate(view.levels):
            appearances = {}
            for kind in needed & level.appearances.keys():
                whole, rows = level.appearances[kind], sampled.rows(kind, others)
                rows = np.intersect1d(rows, usable_rows) if kind in COPIED_APPEARANCES else rows
                retained = whole.n_modes if appearance_variance == "auto" else appearance_variance
                part = train_appearance_model(sampled.textures[kind][i], retained, rows, left_out=None)
                # The error on unseen images is that of the whole model's folds.
                appearances[kind] = replace(part, unexplained=whole.unexplained)
            levels.append(Level(level.blur, appearances))
        modes = len(view.shape_model.modes) if variance == "auto" else variance
        part = shape_model_on(view.shape_model.mean, shapes[others], modes, recipe)
        model = model.with_view(name, warp=replace(view.warp, shape_model=part), levels=tuple(levels))
    return model
