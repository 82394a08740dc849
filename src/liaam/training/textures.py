"""Sample the textures of all training images and their relit copies on the reference frame, and learn from them."""

from collections.abc import Collection
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from liaam.fitting.methods import ALL_COLOUR, ENCODING_OF
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
from liaam.photometry import CameraModel, Response, invariant_row
from liaam.photometry.encoding import Encoding, as_colour
from liaam.photometry.features import Encoder
from liaam.progress import Progress
from liaam.training.entries import Entry
from liaam.training.lamps import Copies
from liaam.training.options import Blurs
from liaam.training.refiner import Refinement
from liaam.training.search_filter import FilterLearner

# Appearances that are learnt from the textures of another
SOURCES = {"invariant": "log", "search": "orientation", "illumination": "varied"}
# Time of fitting a left-out image from near the object, or from all other starts, in units of that of sampling an image
FITTED = 3
# Share of the variance of relit copies that the modes of illumination explain, if their number is automatic: evidence
# from left-out images under the training light cannot choose it.
ILLUMINATION_VARIANCE = 0.98

Wanted = dict[str, list[list[str]]]
"""Names of the appearances to learn, by view and level."""


class ViewLevel(NamedTuple):
    """A level of a view, by its number from coarse to fine."""

    view: str
    level: int


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
    """Textures of all samples by appearance and level.

    ``owners`` (n_textures,) is the sample of each texture of :data:`COPIED_APPEARANCES`; copies follow their sample.
    ``coloured`` (m,) are the samples of the other appearances: those in colour, or all if all are grey.
    """

    textures: dict[str, dict[int, Textures]]
    owners: np.ndarray
    coloured: np.ndarray
    grey: bool  # whether all images are grey

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
        samples_of_textures = self.owners if name in COPIED_APPEARANCES else self.coloured
        return np.flatnonzero(np.isin(samples_of_textures, samples))

    def folds(self, name: str, folds: list[np.ndarray]) -> list[np.ndarray]:
        """Convert folds of samples to folds of textures of an appearance."""
        all_rows = [self.rows(name, fold) for fold in folds]
        rows = [rows_of_fold for rows_of_fold in all_rows if len(rows_of_fold)]
        if len(rows) > 1:
            return rows
        # All folds but one have grey images only: leave out its textures one by one.
        return list(np.concatenate(rows)[:, None])


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
    refinement: Refinement | None = None,
) -> Sampled:
    """Sample the textures of all entries and their copies at the views' levels, for the appearances to learn.

    ``varied`` is sampled only with relit copies, and ``features`` only with a function of the user. ``filters`` sees
    all images and copies, and ``refinement`` those that refiners learn from.

    Grey images (mask ``grey``) among colour images have no colours to learn: only their gradients are sampled.
    """
    camera = model.camera
    owners = copied.owners
    coloured = np.arange(len(entries)) if grey.all() else np.flatnonzero(~grey)
    absent = set()
    if not copied.are_relit:
        absent.add("varied")
    if encoder is None:
        absent.add("features")
    stores = {}
    for name, levels in _levels_to_sample(wanted, absent).items():
        n_textures = len(owners) if name in COPIED_APPEARANCES else len(coloured)
        stores[name] = _store(name, levels, n_textures, model, blurs, encoder)
    stores_of_copies = [store for name, store in stores.items() if name in COPIED_APPEARANCES]
    other_stores = [store for name, store in stores.items() if name not in COPIED_APPEARANCES]

    first_rows = np.searchsorted(owners, np.arange(len(entries)))  # of each image among the textures with copies
    for i, entry in enumerate(entries):
        steps.next(entry.name)
        image = camera.flatten(as_colour(entry.read_image(), entry.name))
        has_colour = not grey[i]
        row = int(first_rows[i])
        filters.add(image, entry.points, entry.known)
        if refinement is not None:
            refinement.see(row, image, entry.points, entry.known)
        for store in stores_of_copies:
            store.add(row, image, entry.points, entry.known, camera, has_colour)
        for row_of_coloured in np.flatnonzero(coloured == i):  # one row, or none
            for store in other_stores:
                store.add(int(row_of_coloured), image, entry.points, entry.known, camera, has_colour)
        copies = copied.of_picture(i, image, entry.points, camera.response, model.diagonal)
        for j, (copy, points) in enumerate(copies):
            steps.next(f"a copy of {entry.name}")
            known = copied.known_of(i, j, entry.known)
            filters.add(copy, points, known)
            if refinement is not None:
                refinement.see(row + 1 + j, copy, points, known)
            for store in stores_of_copies:
                store.add(row + 1 + j, copy, points, known, camera, has_colour)
    textures = {name: store.textures() for name, store in stores.items()}
    return Sampled(textures, owners, coloured, bool(grey.all()))


def _levels_to_sample(wanted: Wanted, absent: Collection[str]) -> dict[str, list[ViewLevel]]:
    """Return where each appearance is sampled, by name: those wanted and the sources of these, without the absent."""
    levels: dict[str, list[ViewLevel]] = {}
    for view, names_by_level in wanted.items():
        for level, names in enumerate(names_by_level):
            sampled_names = dict.fromkeys(SOURCES.get(name, name) for name in names)  # each once
            for name in sampled_names:
                if name not in absent:
                    levels.setdefault(name, []).append(ViewLevel(view, level))
    return levels


@dataclass(frozen=True, eq=False)
class _Store:
    """How one appearance is sampled, and room for its textures.

    Attributes
    ----------
    encoding : Encoding
    warp : PiecewiseAffineWarp
        Warp of the appearance's view.
    blurs : dict of int to float
        Standard deviation of the blur of each level at which it is learnt, pixels of the reference frame.
    values : dict of int to (n_textures, n_pixels, c) float32 array
        Values by level.
    usable : dict of int to (n_textures, n_pixels) or (n_textures, n_pixels, c) float32 array
        Whether they are usable, 0 or 1, by level.
    known : (n_textures, n_pixels) bool array
        Whether known landmarks place a pixel.
    """

    encoding: Encoding
    warp: PiecewiseAffineWarp
    blurs: dict[int, float]
    values: dict[int, np.ndarray]
    usable: dict[int, np.ndarray]
    known: np.ndarray

    def add(
        self,
        row: int,
        image: np.ndarray,
        points: np.ndarray,
        known: np.ndarray | None,
        camera: CameraModel,
        has_colour: bool,
    ) -> None:
        """Sample an image, warped by its landmarks (n, 2), and keep that in a row of all levels.

        Pixels that the ``known`` landmarks (n,) do not place are not observed.
        """
        if known is not None:
            self.known[row] = self.warp.are_known(known)
        for level, blur in self.blurs.items():
            values, usable = sample_appearance(image, points, self.warp, self.encoding, camera.response, blur)
            values, usable = _to_learn(self.encoding, values, usable, camera.theta, has_colour)
            self.values[level][row] = values
            self.usable[level][row] = usable

    def textures(self) -> dict[int, Textures]:
        """Return the textures by level."""
        known = None if self.known.all() else self.known
        return {level: Textures.of(self.values[level], self.usable[level], known) for level in self.blurs}


def _store(
    name: str,
    levels: list[ViewLevel],
    n_textures: int,
    model: AAM,
    blurs: dict[str, Blurs],
    encoder: Encoder | None,
) -> _Store:
    """Make room for the textures of an appearance at some levels, all of one view."""
    view = levels[0].view
    warp = model.views[view].warp
    encoding = ENCODING_OF[name]
    n_channels = CHANNELS[name]
    if name == "features" and encoder is not None:
        encoding = encoder
        n_channels = encoder.width
    shape = (n_textures, warp.frame.n_pixels, n_channels)
    # ``soft`` has separate masks for gradient and invariant.
    shape_of_usable = shape if name == "soft" else shape[:2]
    return _Store(
        encoding=encoding,
        warp=warp,
        blurs={each.level: blurs[view][each.level] for each in levels},
        values={each.level: np.empty(shape, np.float32) for each in levels},
        usable={each.level: np.empty(shape_of_usable, np.float32) for each in levels},
        known=np.ones(shape[:2], bool),
    )


def _to_learn(
    encoding: Encoding, values: np.ndarray, usable: np.ndarray, theta: float, has_colour: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Convert samples in an encoding, (n_pixels, c'), to values to learn, (n_pixels, c), and their usable mask.

    For ``soft``, log RGB is projected to the invariant, which is unusable without colour; the mask is (n_pixels, c).
    """
    if not isinstance(encoding, str):  # channels of a function of the user
        return values, usable
    if encoding != "soft":
        return values[:, : CHANNELS[encoding]], usable
    direction, log_rgb, colour_weight = np.split(values, [2, 5], axis=1)
    invariant = log_rgb @ invariant_row(theta).T.astype(np.float32)
    is_usable_colour = (colour_weight[:, 0] > ALL_COLOUR) & has_colour
    to_learn = np.concatenate([direction, invariant], axis=1)
    return to_learn, np.column_stack([usable, usable, usable * is_usable_colour])


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


def sample_known(
    image: np.ndarray,
    shape: np.ndarray,
    known: np.ndarray | None,
    warp: PiecewiseAffineWarp,
    encoding: Encoding,
    response: Response,
    blur: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Sample an image as :func:`sample_appearance`; pixels that landmarks not ``known`` (n,) place are unusable."""
    values, usable = sample_appearance(image, shape, warp, encoding, response, blur)
    return values, usable if known is None else usable * warp.are_known(known)


def level_appearances(
    sampled: Sampled, names: list[str], level: int, theta: float, variance: Variance, folds: list[np.ndarray]
) -> dict[str, AppearanceModel]:
    """Learn the appearances of the given names at one level of a view, as far as images were sampled for them."""
    folds_of_errors = some_folds(sampled.n_samples)  # by which the errors on unseen images are measured
    appearances = {}
    for name in names:
        textures_by_level = sampled.textures.get(SOURCES.get(name, name), {})
        if level not in textures_by_level or (name == "invariant" and sampled.grey):
            continue
        textures = textures_by_level[level]
        if name == "illumination":
            appearances[name] = _illumination(appearances["value"], textures, sampled.copies, variance)
            continue
        if name == "invariant":
            # LIT: project first, then learn (paper section 4).
            projected = textures.values @ invariant_row(theta).T.astype(np.float32)
            textures = Textures.of(projected, textures.usable, textures.known)
        modes = count_by_evidence(textures.vectors, sampled.folds(name, folds)) if variance == "auto" else variance
        if name == "search":
            appearances[name] = strongest_modes(train_appearance_model(textures, modes))
        else:
            left_out = sampled.folds(name, folds_of_errors)
            appearances[name] = train_appearance_model(textures, modes, left_out=left_out)
    return appearances


def _illumination(
    values: AppearanceModel, textures: Textures, copies: np.ndarray, variance: Variance
) -> AppearanceModel:
    """Learn the modes of light in the copies among textures (mask ``copies``) that the modes of ``values`` lack."""
    modes = ILLUMINATION_VARIANCE if variance == "auto" else variance
    known = None if textures.known is None else textures.known[copies]
    relit = Textures(textures.values[copies], textures.observed[copies], textures.usable[copies], known)
    return train_illumination(values, relit, modes)
