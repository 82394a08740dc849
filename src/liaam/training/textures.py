"""Sample the textures of all training images and their relit copies on the reference frame, and learn from them."""

from dataclasses import dataclass

import numpy as np

from liaam.fitting.methods import ENCODING_OF
from liaam.model import AAM
from liaam.model.appearance import (
    CHANNELS,
    COPIED_APPEARANCES,
    AppearanceModel,
    Textures,
    strongest_modes,
    train_appearance_model,
    train_illumination,
)
from liaam.model.pca import Variance, count_by_evidence, some_folds
from liaam.model.sampling import make_patch, sample_texture
from liaam.model.shape import align
from liaam.model.warp import PiecewiseAffineWarp
from liaam.photometry import Response, invariant_row
from liaam.photometry.encoding import Encoding, as_colour
from liaam.photometry.features import Encoder
from liaam.progress import Progress
from liaam.training.entries import Entry
from liaam.training.lamps import Copies
from liaam.training.options import Blurs
from liaam.training.search_filter import FilterLearner

# Appearances that are learnt from the textures of another
SOURCES = {"invariant": "log", "search": "orientation", "illumination": "varied"}
FITTED = 6  # Time of fitting a left-out image, from near and far starts, in units of the time of sampling an image

Wanted = dict[str, list[list[str]]]
"""Names of the appearances to learn, by view and level."""


def learning_cost(n: int) -> int:
    """Time of learning a level's appearances from n images, in units of the time of sampling one of them."""
    return max(1, n // 10)


@dataclass
class Steps:
    """Reports all steps of training on one scale."""

    report: Progress | None
    total: int
    done: int = 0

    def next(self, what: str, cost: int = 1) -> None:
        """Report the next step and its cost, in units of the time of sampling an image."""
        if self.report:
            self.report(self.done, self.total, what)
        self.done += cost


@dataclass(frozen=True)
class Sampled:
    """Textures of all samples by appearance and level, and whether all images are grey.

    ``owners`` (n_textures,) is the sample of each texture of :data:`COPIED_APPEARANCES`; copies follow their sample.
    ``coloured`` (m,) are the samples of the other appearances: those in colour, or all if all are grey.
    """

    textures: dict[str, dict[int, Textures]]
    owners: np.ndarray
    coloured: np.ndarray
    grey: bool

    @property
    def n_samples(self) -> int:
        """Number of training images."""
        return int(self.owners[-1]) + 1

    @property
    def copies(self) -> np.ndarray:
        """Mask of the copies among the textures of :data:`COPIED_APPEARANCES`, (n_textures,) bool."""
        return np.diff(self.owners, prepend=-1) == 0

    def rows(self, name: str, samples: np.ndarray) -> np.ndarray:
        """Indices of an appearance's textures of some samples."""
        return np.flatnonzero(np.isin(self.owners if name in COPIED_APPEARANCES else self.coloured, samples))

    def folds(self, name: str, folds: list[np.ndarray]) -> list[np.ndarray]:
        """Convert folds of samples to folds of textures of an appearance."""
        rows = [each for each in (self.rows(name, fold) for fold in folds) if len(each)]
        # Grey images may be in all folds but one.
        return rows if len(rows) > 1 else list(np.concatenate(rows)[:, None])


def sample_all(
    entries: list[Entry],
    grey: np.ndarray,
    model: AAM,
    blurs: dict[str, Blurs],
    wanted: Wanted,
    steps: Steps,
    copied: Copies,
    encoder: Encoder | None,
    filters: FilterLearner,
) -> Sampled:
    """Sample the textures of all entries and their copies at the views' levels, for the appearances to learn.

    ``varied`` is sampled only with relit copies, and ``features`` only with a function of the user. ``filters`` sees
    all images and copies.

    Grey images (mask ``grey``) among colour images have no colours to learn: only their gradients are sampled.
    """
    camera, owners = model.camera, copied.owners
    coloured = np.arange(len(entries)) if grey.all() else np.flatnonzero(~grey)
    absent = {"varied": not copied.are_relit, "features": encoder is None}
    levels: dict[str, list[int]] = {}
    view_of: dict[str, str] = {}
    for view, by_level in wanted.items():
        for level, names in enumerate(by_level):
            for name in dict.fromkeys(SOURCES.get(name, name) for name in names):
                if not absent.get(name):
                    view_of[name] = view
                    levels.setdefault(name, []).append(level)
    channels = CHANNELS if encoder is None else {**CHANNELS, "features": encoder.width}
    counts = {name: len(owners) if name in COPIED_APPEARANCES else len(coloured) for name in view_of}
    warps = {name: model.views[view].warp for name, view in view_of.items()}
    room = {
        name: {level: _room(n, warps[name], name, channels[name]) for level in levels[name]}
        for name, n in counts.items()
    }

    def sample(image: np.ndarray, points: np.ndarray, name: str, row: int, colour: bool) -> None:
        encoding = encoder if encoder is not None and name == "features" else ENCODING_OF[name]
        for level, (values, usable) in room[name].items():
            blur = blurs[view_of[name]][level]
            sampled_pixels = sample_appearance(image, points, warps[name], encoding, camera.response, blur)
            values[row], usable[row] = _learnt(encoding, *sampled_pixels, camera.theta, colour)

    copied_names = [name for name in view_of if name in COPIED_APPEARANCES]
    first = np.searchsorted(owners, np.arange(len(entries)))
    for i, entry in enumerate(entries):
        steps.next(entry.name)
        image = camera.flatten(as_colour(entry.read_image(), entry.name))
        filters.add(image, entry.points)
        rows = np.flatnonzero(coloured == i)
        for name in view_of:
            for row in [first[i]] if name in COPIED_APPEARANCES else rows:
                sample(image, entry.points, name, int(row), not grey[i])
        made = copied.of_picture(i, image, entry.points, camera.response, model.diagonal)
        for row, (copy, points) in enumerate(made, first[i] + 1):
            steps.next(f"a copy of {entry.name}")
            filters.add(copy, points)
            for name in copied_names:
                sample(copy, points, name, row, not grey[i])
    textures = {name: {i: Textures.of(*each) for i, each in by_level.items()} for name, by_level in room.items()}
    return Sampled(textures, owners, coloured, bool(grey.all()))


def _room(n: int, warp: PiecewiseAffineWarp, name: str, channels: int) -> tuple[np.ndarray, np.ndarray]:
    """Allocate the values of n textures of an appearance, and their usable masks."""
    shape = (n, warp.frame.n_pixels, channels)
    # ``soft`` has separate masks for gradient and invariant.
    return np.empty(shape, np.float32), np.empty(shape if name == "soft" else shape[:2], np.float32)


def _learnt(
    encoding: Encoding, values: np.ndarray, usable: np.ndarray, theta: float, colour: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Convert samples in an encoding to values to learn, (n_pixels, c), and their usable mask.

    For ``soft``, log RGB is projected to the invariant, which is unusable without colour.
    """
    if encoding != "soft":
        return values[:, : CHANNELS[encoding] if isinstance(encoding, str) else None], usable
    direction, log_rgb, colour_known = np.split(values, [2, 5], axis=1)
    rows = np.concatenate([direction, log_rgb @ invariant_row(theta).T.astype(np.float32)], axis=1)
    return rows, np.column_stack([usable, usable, usable * ((colour_known[:, 0] > 0.99) & colour)])


def sample_appearance(
    image: np.ndarray,
    shape: np.ndarray,
    warp: PiecewiseAffineWarp,
    encoding: Encoding,
    response: Response,
    blur: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Sample an image on the reference frame, warped by its landmarks: values (n_pixels, c) and whether usable, 0 or 1.

    See :func:`liaam.photometry.encode`. The blur's standard deviation is in pixels of the reference frame.
    """
    pose = align(warp.rest, shape)
    patch = make_patch(image, shape, pose, encoding=encoding, response=response, blur=blur, margin=0.1)
    points = warp.interpolate(shape)
    # Points outside the image take the value of the nearest pixel, with weight 0.
    border = np.clip(points, 0, np.array(image.shape[1::-1]) - 1.0)
    values, usable = sample_texture(patch, border)
    return values, usable * (border == points).all(axis=1)


def level_appearances(
    sampled: Sampled, names: list[str], level: int, theta: float, variance: Variance, folds: list[np.ndarray]
) -> dict[str, AppearanceModel]:
    """Learn the appearances of the given names at one level of a view, as far as images were sampled for them."""
    appearances, every = {}, some_folds(sampled.n_samples)
    for name in names:
        source = sampled.textures.get(SOURCES.get(name, name), {})
        if level not in source or (name == "invariant" and sampled.grey):
            continue
        textures = source[level]
        if name == "illumination":
            # Evidence from left-out images under the training light cannot choose the number of illumination modes.
            share = 0.98 if variance == "auto" else variance
            rows = sampled.copies
            relit = Textures(textures.values[rows], textures.observed[rows], textures.usable[rows])
            appearances[name] = train_illumination(appearances["value"], relit, share)
            continue
        if name == "invariant":
            # LIT: project first, then learn (paper section 4).
            textures = Textures.of(textures.values @ invariant_row(theta).T.astype(np.float32), textures.usable)
        share = count_by_evidence(textures.vectors, sampled.folds(name, folds)) if variance == "auto" else variance
        if name == "search":
            appearances[name] = strongest_modes(train_appearance_model(textures, share))
        else:
            appearances[name] = train_appearance_model(textures, share, left_out=sampled.folds(name, every))
    return appearances
