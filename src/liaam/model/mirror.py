"""The mirror image of a model: of heads turned to one side, it is a model of heads turned to the other."""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from liaam.encoding_constants import GRADIENTS
from liaam.errors import ModelFileError
from liaam.model.appearance import AppearanceModel
from liaam.model.presence import Presence
from liaam.model.shape import ShapeModel
from liaam.model.sides import reflected_covariances
from liaam.model.views import VIEWS, Level, Reliability, View

if TYPE_CHECKING:
    from liaam.model.aam import AAM

BY_X_AND_Y = (*GRADIENTS, "search")  # Appearances whose first channel is a gradient along x

# Of the cosine and the sine of an orientation and of its double, and the length, of a search filter.
_MIRRORED_CHANNELS = np.array([-1, 1, 1, -1, 1], np.float32)


def mirrored_model(model: "AAM", order: np.ndarray) -> "AAM":
    """Mirror a model of one shape left to right, without its light basis, its regressor and its map from other points.

    Parameters
    ----------
    model : AAM
    order : (n,) int
        Index of each landmark's mirror image, as of :func:`liaam.model.shape.mirror_order`.

    Raises
    ------
    ModelFileError
        For a model with channels of a user's function, whose mirror images are not known.
    """
    if model.features is not None:
        raise ModelFileError("a model with features of a function cannot be mirrored; train it without them")
    triangles = order[model.triangles][:, ::-1].astype(np.int32)
    views = _MirroredViews(model.views, triangles, order, model.in_pieces)
    refiner = None
    if model.refiner is not None:
        refiner = model.refiner.mirrored(mirrored_shapes(model.refiner.shape_model, order), order)
    relief = None
    if model.relief is not None:
        relief = np.ascontiguousarray(model.relief[:, ::-1] * np.array([-1, 1], np.float32))
    search_filter = model.search_filter
    if search_filter is not None:
        search_filter = np.ascontiguousarray(search_filter[:, ::-1] * _MIRRORED_CHANNELS[: search_filter.shape[2]])
    return replace(
        model,
        views=views,
        triangles=triangles,
        light=None,
        points=None,
        regressor=None,
        refiner=refiner,
        relief=relief,
        search_filter=search_filter,
        poses=None if model.poses is None else (model.poses * np.array([-1, 1], np.float32))[:, order],
        in_box=None if model.in_box is None else (model.in_box * np.array([-1.0, 1.0]))[order],
        n_missing=None if model.n_missing is None else model.n_missing[order],
    )


def mirrored_shapes(model: ShapeModel, order: np.ndarray) -> ShapeModel:
    """Mirror shapes left to right; ``order`` (n,) is the index of each landmark's mirror image."""
    mirrored = np.array([-1.0, 1.0])
    modes = (model.modes.reshape(len(model.modes), -1, 2) * mirrored)[:, order].reshape(model.modes.shape)
    unexplained = None if model.unexplained is None else reflected_covariances(model.unexplained)[order]
    return replace(model, mean=(model.mean * mirrored)[order], modes=modes, unexplained=unexplained)


class _MirroredViews(Mapping[str, View]):
    """Views that are mirrored when they are first needed, since this takes a quarter of the time of reading a file."""

    def __init__(self, views: Mapping[str, View], triangles: np.ndarray, order: np.ndarray, in_pieces: bool) -> None:
        self.views = views
        self.triangles = triangles
        self.order = order
        self.in_pieces = in_pieces
        self.made: dict[str, View] = {}

    def __getitem__(self, name: str) -> View:
        if name not in self.made:
            self.made[name] = _view(name, self.views[name], self.triangles, self.order, self.in_pieces)
        return self.made[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.views)

    def __len__(self) -> int:
        return len(self.views)


def _view(name: str, view: View, triangles: np.ndarray, order: np.ndarray, in_pieces: bool) -> View:
    shapes = mirrored_shapes(view.shape_model, order)
    warp = VIEWS[name](shapes, triangles, in_pieces)
    frame = warp.frame
    other = view.warp.frame
    width, height = other.size
    x, y = other.origin
    number = np.zeros((height, width), int)
    number[other.pixels[:, 0], other.pixels[:, 1]] = np.arange(other.n_pixels)
    at = frame.pixels[:, ::-1] + frame.origin
    pixels = number[(at[:, 1] - y).astype(int), (-at[:, 0] - x).astype(int)]  # of the mirror image of each pixel
    levels = tuple(
        Level(level.blur, {kind: _appearance(kind, each, pixels) for kind, each in level.appearances.items()})
        for level in view.levels
    )
    reliabilities = {method: _reliability(each, order) for method, each in view.reliabilities.items()}
    # Levels hold the mirror images of the pixels that fits need.
    return View(replace(warp, from_right=not view.warp.from_right), levels, reliabilities)


def _reliability(reliability: Reliability, order: np.ndarray) -> Reliability:
    presence = reliability.presence
    return replace(
        reliability,
        landmarks=reflected_covariances(reliability.landmarks)[order],
        bias=reflected_covariances(reliability.bias)[order],
        scales=None if reliability.scales is None else reflected_covariances(reliability.scales)[order],
        presence=None if presence is None else Presence(*(each[order] for each in vars(presence).values())),
    )


def _appearance(kind: str, appearance: AppearanceModel, pixels: np.ndarray) -> AppearanceModel:
    mean, modes = (np.take(values, pixels, axis=-2) for values in (appearance.mean, appearance.modes))
    errors = None if appearance.unexplained is None else appearance.unexplained[pixels]
    if kind in BY_X_AND_Y:
        for values in (mean, modes):
            values[..., 0] *= -1.0
        if errors is not None:
            errors[:, 0, 1:] *= -1.0
            errors[:, 1:, 0] *= -1.0
    return AppearanceModel(mean, modes, appearance.eigenvalues, appearance.usable[pixels], errors)
