"""Training: from landmarked images to an active appearance model."""

import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from liaam.errors import TrainingError
from liaam.fitting.methods import DEFAULT_METHOD, ENCODING_OF, METHODS
from liaam.fitting.reliability import LeftOut, calibrate
from liaam.lamps import Copies, Lamps, learn_lamps
from liaam.model import (
    AAM,
    MESH,
    SURROUNDINGS,
    VIEWS,
    Level,
    Reliability,
    make_view,
)
from liaam.model.appearance import (
    CHANNELS,
    COPIED_APPEARANCES,
    AppearanceModel,
    Textures,
    train_appearance_model,
    train_illumination,
)
from liaam.model.file import MAX_BLUR, MAX_DIAGONAL, MAX_LEVELS, MAX_POINTS
from liaam.model.mesh import (
    FOLD_TOLERANCE,
    ReferenceFrame,
    delaunay,
    folded_share,
    signed_areas,
    triangles_from_edges,
)
from liaam.model.pca import Variance, check_variance, count_by_evidence, some_folds
from liaam.model.sampling import make_patch, sample_texture
from liaam.model.shape import Recipe, align, check_prior, choose_recipe, mirror_order, scaled_mean, shape_model_on
from liaam.model.warp import PiecewiseAffineWarp
from liaam.photometry import CameraModel, Response, exposure_faults, invariant_row, is_grey, parse_response
from liaam.photometry.encoding import as_colour
from liaam.progress import Progress

SAMPLED = {MESH: ("value", "log", "orientation", "varied"), SURROUNDINGS: ("soft",)}
"""Appearances of each view that pictures are sampled for; ``varied`` where there are relit copies."""

BLURS = {MESH: (3.0, 0.5), SURROUNDINGS: (4.0, 2.0, 1.0)}
"""Blur of the levels of each view from coarse to fine, standard deviation in pixels of the reference frame. Of the
surroundings measured with persons that a model has not seen: one level more than two, and 1 pixel at the end rather
than 0.5, lose fewer fits; gradients of JPEG's blocks are no better sharp. Those of the surroundings are for frames of
:data:`FULL_SIZE` and more; smaller ones have less in proportion."""

FULL_SIZE, LEAST_BLUR = 150.0, 0.5
"""Diagonal that the blurs of the surroundings were measured at, pixels, and the least of them in smaller frames. What
tells landmarks from their surroundings is as large as a share of the object: faces at a diagonal of 90 pixels end at
2.0 % with a blur of 1 pixel, and at 1.8 % with 0.6."""

COPIES, MOST_COPIES = 3, 20
"""Relit copies of each picture to learn from, and the most that make sense."""

FLATTEST = 0.05
"""Least spread of the landmarks across, as a share of that along: the search's smallest frame has pixels then."""

KEPT = 0.85
"""Share of the variance that appearances of the surroundings keep, unless asked. Their coordinates have a prior, and
what modes leave counts as error: as good as 0.98 on IMM (persons seen and not) and under hard flashes, and fits to
strangers take 28 instead of 34 ms."""

Blurs = tuple[float, ...]


@dataclass(frozen=True)
class _Entry:
    """One training sample, checked: a name for messages, the image's reader, and its landmarks."""

    name: str
    read_image: Callable[[], np.ndarray]
    points: np.ndarray


def train(
    data: Iterable,
    *,
    variance: Variance = 0.98,
    appearance_variance: Variance | Mapping[str, Variance] | None = None,
    prior: str | Mapping[str, str] | None = None,
    diagonal: float = 150.0,
    theta: float | None = None,
    response: Response | None = None,
    camera: CameraModel | None = None,
    blurs: Blurs | Mapping[str, Blurs] | None = None,
    triangles: np.ndarray | None = None,
    lamps: Lamps | Iterable | None = None,
    training_lamp: str | None = None,
    copies: int | None = None,
    leave_out: bool = True,
    name: str = "",
    progress: Progress | None = None,
) -> AAM:
    """Train an active appearance model.

    Parameters
    ----------
    data : Dataset, or iterable of Sample or (image, landmarks) pairs
        Images are (h, w, 3) arrays; landmarks (n, 2) arrays (x, y) or
        :class:`liaam.io.Landmarks`. All must have the same number of points, in the same order.
    variance : float, int or "auto"
        Share of the shapes' variance to keep, in (0, 1], or a count of modes. ``auto`` counts the modes under which
        pictures left out (those of one object together, where names tell) are most likely.
    appearance_variance : float, int, "auto" or mapping of views to these, optional
        The same for appearances. If left out: as ``variance``; of the view ``surroundings``, where that is a share of
        less than 1, :data:`KEPT`.
    prior : {"sample", "smooth", "shrunk"} or mapping of views to these, optional
        How the shapes' covariance is learnt, for all views or by name of :data:`liaam.model.VIEWS`. ``sample`` is the
        covariance of the shapes as they are (the paper). ``smooth``, for shapes that no training picture shows, draws
        it towards smooth deformations, and learns from the mirrored shapes too, as far as shapes left out are likelier
        so. ``shrunk`` takes the variances of shapes left out for eigenvalues. If left out: ``sample`` for the view
        ``mesh``, whose methods know less of what their errors weigh and lose by ``smooth``; for ``surroundings``
        (``soft-li``) ``smooth``, unless all of the variance is kept (which asks for the pictures' shapes and no others)
        or there are more than 200 landmarks (which take minutes).
    diagonal : float
        Diagonal of the mean shape in the reference frame, pixels. More is slower and finer.
    theta : float, optional
        Angle of the training camera (theta_1 of the paper), radians; the camera's if left out.
    response : "srgb", "linear", float or ResponseCurve, optional
        How the pictures' values relate to linear light; the camera's if left out.
    camera : CameraModel, optional
        What is known of the training camera; 122 degrees and sRGB if nothing is.
    blurs : tuple of float or mapping of views to these, optional
        Blur of the levels a fit goes through, from coarse to fine, pixels of the reference frame; :data:`BLURS` of the
        views that are left out.
    triangles : (t, 3) int, optional
        The mesh. If left out: the files' connectivity where it is a mesh, else Delaunay of the mean shape.
    lamps : Lamps, Dataset or iterable of Sample, optional
        Lamps that copies of the pictures are put under, or pictures of a few objects under various lamps to learn these
        from (:func:`liaam.lamps.learn_lamps`).
    training_lamp : str, optional
        Which of the lamps in the pictures' names is the light of ``data``.
    copies : int, optional
        Relit copies of each picture, fewer of many pictures, that the default method, the search and the methods that
        learn what light does (``varied``, ``aia``) learn from as well; every other one is mirrored where the object is
        symmetric. Without lamps there is but a mirrored one. If left
        out :data:`COPIES`, and none where all of the variance is kept, which asks for the pictures and nothing else.
    leave_out : bool
        Leave pictures out in turn and fit them, to learn how far the default method's fits can be trusted
        (``FitResult.quality`` and ``landmark_covariances``). Without it training takes half the time.
    name : str
        What the model shows, for people.
    progress : callable, optional
        Called with (done, total, what) before each step, and at the end; in units of about the same time.

    Returns
    -------
    AAM

    Raises
    ------
    TrainingError
        Fewer than 3 shapes, counts that differ, missing (NaN) or folded landmarks, black images ...
        The message names the sample.
    """
    camera = _camera_of(camera, theta, response)
    blurs = _by_view("blurs", blurs, _usual_blurs(diagonal))
    kept = _by_view("appearance_variance", appearance_variance, _usual_shares(variance))
    _check_options(variance, kept, diagonal, blurs)
    entries, contours, edges = _entries(data)
    priors = _by_view("prior", prior, _usual_priors(variance, len(entries[0].points)))
    for asked in priors.values():
        check_prior(asked)
    shapes, folds = np.array([entry.points for entry in entries]), _folds([entry.name for entry in entries])
    mean = scaled_mean(shapes, diagonal)
    recipes = {asked: choose_recipe(mean, shapes, asked, folds) for asked in dict.fromkeys(priors.values())}
    learnt = {asked: shape_model_on(mean, shapes, variance, recipe, folds) for asked, recipe in recipes.items()}
    _check_flat(mean)
    triangles = _triangles(mean, triangles, edges)
    each = (0 if _is_whole(variance) else COPIES) if copies is None else copies
    copied = _copies(lamps, training_lamp, each, mean, len(entries), camera)
    model = AAM(
        views={view: make_view(view, learnt[priors[view]], triangles) for view in VIEWS},
        triangles=triangles,
        camera=camera,
        n_images=len(entries),
        contours=contours,
        name=name,
        n_textures=len(copied.owners),
    )
    for entry in entries:
        _check_fold(entry, model.frame)
    told = _Progress(progress, _work(len(copied.owners), blurs, folds if leave_out else []))
    sampled = _sample_all(entries, model, blurs, told, copied)
    learn = {
        MESH: lambda i: _appearances(sampled, i, camera.theta, kept[MESH], folds),
        SURROUNDINGS: lambda i: {"soft": _soft_appearance(sampled, i, kept[SURROUNDINGS], folds)},
    }
    for view in VIEWS:
        levels = []
        for i, blur in enumerate(blurs[view]):
            told.step(f"appearance of the {view}", _learning(model.n_textures))
            levels.append(Level(float(blur), learn[view](i)))
        model = model.with_view(view, levels=tuple(levels))
    if leave_out:
        judged = METHODS[DEFAULT_METHOD].view
        how = (recipes[priors[judged]], variance, kept[judged])
        reliability = _reliability(model, entries, shapes, sampled, copied, how, folds, told)
        model = model.with_view(judged, reliability=reliability)
    told.step("trained", 0)
    return model


FITTED = 6
"""How many times as long as sampling a picture it takes to fit one that was left out, from near and far."""


def _learning(n: int) -> int:
    """How many times as long as sampling one of n pictures it takes to learn a level's appearances of them."""
    return max(1, n // 10)


def _work(n: int, blurs: dict[str, Blurs], folds: list[np.ndarray]) -> int:
    """How many times as long as sampling a picture it takes to train on n pictures and copies."""
    learning = _learning(n) * (sum(map(len, blurs.values())) + len(folds))
    return n + learning + FITTED * sum(len(_fitted(fold, folds)) for fold in folds)


@dataclass
class _Progress:
    """Tells of all that training does on one scale."""

    tell: Progress | None
    total: int
    done: int = 0

    def step(self, what: str, cost: int = 1) -> None:
        """Tell what comes next, and how many times as long as sampling a picture it takes."""
        if self.tell:
            self.tell(self.done, self.total, what)
        self.done += cost


def _by_view(option: str, given: Any, usual: Mapping[str, Any]) -> dict[str, Any]:
    """Value of an option for each view: one for all, or by name, and the usual ones where none is given."""
    if given is None:
        return dict(usual)
    if not isinstance(given, Mapping):
        return dict.fromkeys(usual, given)
    unknown = [view for view in given if view not in usual]
    if unknown:
        raise TrainingError(f"{option}: view {unknown[0]!r} does not exist; there are {', '.join(usual)}")
    return {**usual, **given}


def _check_options(
    variance: Variance,
    kept: dict[str, Variance],
    diagonal: float,
    blurs: dict[str, Blurs],
) -> None:
    for asked in (variance, *kept.values()):
        check_variance(asked)
    if not 16 <= diagonal <= MAX_DIAGONAL:
        raise TrainingError(
            f"diagonal {diagonal:g}: give the size of the reference frame, 16 to {MAX_DIAGONAL:g} pixels"
        )
    for view, given in blurs.items():
        falling = list(given) == sorted(given, reverse=True)
        if not 1 <= len(given) <= MAX_LEVELS or not falling or not 0 <= given[-1] <= given[0] <= MAX_BLUR:
            raise TrainingError(
                f"blurs {given} of the view {view}: give 1 to {MAX_LEVELS} of 0 to {MAX_BLUR:g} pixels of the "
                "reference frame, from coarse to fine"
            )


MOST_SMOOTH = 200
"""Landmarks up to which there are smooth deformations unasked: learning them takes seconds at 200, half a minute at
1000, and grows with the third power."""


def _copies(
    lamps: Lamps | Iterable | None, training_lamp: str | None, each: int, mean: np.ndarray, n: int, camera: CameraModel
) -> Copies:
    """Copies to make of n pictures, under lamps that are given or learnt."""
    if not 0 <= each <= MOST_COPIES:
        raise TrainingError(f"copies {each}: give 0 to {MOST_COPIES} relit copies of each picture")
    if lamps is not None and not isinstance(lamps, Lamps):
        lamps = learn_lamps(lamps, training_lamp, response=camera.response)
    if lamps is not None:
        lamps.check_landmarks(len(mean), "the pictures")
    return Copies.of(lamps, n, each, mirror_order(mean) if each else None)


def _usual_blurs(diagonal: float) -> dict[str, Blurs]:
    """Blurs of the views' levels where nobody asks for any."""
    size = min(1.0, diagonal / FULL_SIZE)
    return {**BLURS, SURROUNDINGS: tuple(max(LEAST_BLUR, size * blur) for blur in BLURS[SURROUNDINGS])}


def _usual_shares(variance: Variance) -> dict[str, Variance]:
    """How much of the appearances' variance the views keep where nobody asks for any."""
    share = isinstance(variance, float) and variance < 1.0
    return {MESH: variance, SURROUNDINGS: min(KEPT, variance) if share else variance}


def _is_whole(variance: Variance) -> bool:
    """Whether all of the variance is kept, for a model of the pictures as they are and nothing else."""
    return isinstance(variance, float) and variance == 1.0


def _usual_priors(variance: Variance, n_points: int) -> dict[str, str]:
    """Priors of the views' shapes where nobody asks for any."""
    return {MESH: "sample", SURROUNDINGS: "sample" if _is_whole(variance) or n_points > MOST_SMOOTH else "smooth"}


def _camera_of(camera: CameraModel | None, theta: float | None, response: Response | None) -> CameraModel:
    """Training camera, with what was given beside it."""
    camera = camera or CameraModel()
    if theta is not None:
        if not abs(theta) <= 2 * np.pi:
            raise TrainingError(f"theta {theta:g}: give the camera's angle in radians (122 degrees are 2.13)")
        camera = replace(camera, theta=float(theta), theta_deviation=None)
    return camera if response is None else replace(camera, response=parse_response(response))


def _entries(data: Iterable, at_least: int = 3) -> tuple[list[_Entry], tuple, np.ndarray]:
    """Checked samples, the contours and the connectivity of the first that has any."""
    entries: list[_Entry] = []
    contours: tuple = ()
    if isinstance(data, (str, os.PathLike)) or not isinstance(data, Iterable):
        raise TrainingError(f"{data!r} is not a set of landmarked images; for a folder give liaam.load_folder(folder)")
    for i, item in enumerate(data):
        entry, own = _entry(item, i)
        if entries and len(entry.points) != len(entries[0].points):
            raise TrainingError(
                f"{entry.name} has {len(entry.points)} landmarks but {entries[0].name} has {len(entries[0].points)}; "
                "every image needs the same points in the same order"
            )
        entries.append(entry)
        contours = contours or own
    if len(entries) < at_least:
        raise TrainingError(
            f"{len(entries)} landmarked images are too few to learn from; at least {at_least} are needed, "
            "5 to 20 better"
        )
    return entries, contours, _edges(contours)


def _entry(item, i: int) -> tuple[_Entry, tuple]:
    if hasattr(item, "landmarks"):
        name, landmarks, read = item.name, item.landmarks, item.read_image
    else:
        try:
            image, landmarks = item
        except (TypeError, ValueError):
            raise TrainingError(
                f"training item {i + 1} is no (image, landmarks) pair; for a folder give liaam.load_folder(folder)"
            ) from None
        name = f"image {i + 1}"
        read = lambda: image  # noqa: E731
    try:
        points = np.array(getattr(landmarks, "points", landmarks), dtype=np.float64)
    except (TypeError, ValueError):
        raise TrainingError(f"{name}: the landmarks are no numbers; give (n, 2) points") from None
    if points.ndim != 2 or points.shape[1] != 2 or len(points) < 3:
        raise TrainingError(f"{name}: landmarks of shape {points.shape} are not (n, 2) points with n of at least 3")
    if len(points) > MAX_POINTS:
        raise TrainingError(
            f"{name}: {len(points)} landmarks are more than {MAX_POINTS}: leave some out of all pictures"
        )
    missing = ~np.isfinite(points).all(axis=1)
    if missing.any():
        which = ", ".join(str(j + 1) for j in np.flatnonzero(missing)[:5])
        raise TrainingError(
            f"{name}: {missing.sum()} of {len(points)} landmarks are missing (NaN; point {which} counting from 1); "
            "place them or leave this image out"
        )
    if np.ptp(points, axis=0).max() < 2:
        raise TrainingError(f"{name}: all landmarks lie within 2 pixels of each other; are they in pixels?")
    contours = tuple((tuple(c.indices), bool(c.closed)) for c in getattr(landmarks, "contours", ()))
    return _Entry(name, read, points), contours


def _edges(contours: tuple) -> np.ndarray:
    pairs: list[tuple[int, int]] = []
    for indices, closed in contours:
        pairs += pairwise(indices)
        if closed:
            pairs.append((indices[-1], indices[0]))
    return np.array(pairs, dtype=int).reshape(-1, 2)


def _check_flat(mean: np.ndarray) -> None:
    """Refuse a shape so flat that hardly a pixel's centre lies inside it, least of all where the search looks."""
    along, across = np.linalg.svd(mean - mean.mean(axis=0), compute_uv=False)
    if across < FLATTEST * along:
        raise TrainingError(
            f"the landmarks lie on one line or in one place, or almost so ({across / along:.1%} as wide as long, "
            f"and {FLATTEST:.0%} are needed); check their order and units, or add some beside that line"
        )


def _triangles(mean: np.ndarray, given: np.ndarray | None, edges: np.ndarray) -> np.ndarray:
    if given is None:
        mesh = triangles_from_edges(mean, edges) if len(edges) else None
        return delaunay(mean) if mesh is None else mesh
    triangles = np.asarray(given)
    right = triangles.ndim == 2 and triangles.shape[1] == 3 and triangles.dtype.kind in "iu" and len(triangles)
    if not right or triangles.min() < 0 or triangles.max() >= len(mean):
        raise TrainingError(f"triangles must be (t, 3) whole numbers from 0 to {len(mean) - 1}")
    triangles = triangles.astype(np.int32)
    # People's triangles come clockwise or not; what matters is that all agree.
    return triangles[:, ::-1].copy() if (signed_areas(mean, triangles) < 0).mean() > 0.5 else triangles


def _check_fold(entry: _Entry, frame: ReferenceFrame) -> None:
    upright = align(entry.points, frame.points)(entry.points)
    share = folded_share(upright, frame.triangles)
    if share > FOLD_TOLERANCE:
        raise TrainingError(
            f"{entry.name}: its landmarks fold the mesh ({share:.0%} of the area is turned over); "
            "are its points in the same order as in the other images, and the image not mirrored?"
        )


@dataclass(frozen=True)
class _Sampled:
    """Textures of all samples by appearance, one per blur.

    Attributes
    ----------
    textures : dict of str to list of Textures
    owners : (n_textures,) int
        Which sample the textures of :data:`COPIED_APPEARANCES` are of: each sample's own, then those of its copies.
    grey : bool
        Whether all pictures are grey.
    """

    textures: dict[str, list[Textures]]
    owners: np.ndarray
    grey: bool

    @property
    def n_samples(self) -> int:
        return int(self.owners[-1]) + 1

    @property
    def copies(self) -> np.ndarray:
        """Which textures of :data:`COPIED_APPEARANCES` are of copies, (n_textures,) bool."""
        return np.diff(self.owners, prepend=-1) == 0

    def rows(self, name: str, samples: np.ndarray) -> np.ndarray:
        """Which textures of an appearance are of some samples."""
        return np.flatnonzero(np.isin(self.owners, samples)) if name in COPIED_APPEARANCES else samples

    def folds(self, name: str, folds: list[np.ndarray]) -> list[np.ndarray]:
        """Textures of an appearance to leave out together, for samples to leave out together."""
        return [self.rows(name, fold) for fold in folds]


def _sample_all(
    entries: list[_Entry], model: AAM, blurs: dict[str, Blurs], told: _Progress, copied: Copies
) -> _Sampled:
    """Sample the textures of all entries, and those of copies, at each blur of the views' levels."""
    camera, owners = model.camera, copied.owners
    view_of = {name: view for view, known in SAMPLED.items() for name in known if name != "varied" or copied.are_relit}
    counts = {name: len(owners) if name in COPIED_APPEARANCES else len(entries) for name in view_of}
    warps = {name: model.views[view].warp for name, view in view_of.items()}
    room = {name: [_room(n, warps[name], name) for _ in blurs[view_of[name]]] for name, n in counts.items()}

    def sample(image: np.ndarray, points: np.ndarray, name: str, row: int) -> None:
        encoding = ENCODING_OF[name]
        for (values, usable), blur in zip(room[name], blurs[view_of[name]], strict=True):
            found = sample_appearance(image, points, warps[name], encoding, camera.response, blur)
            values[row], usable[row] = _learnt(encoding, *found, camera.theta)

    copied_names = [name for name in view_of if name in COPIED_APPEARANCES]
    grey, first = [], np.searchsorted(owners, np.arange(len(entries)))
    for i, entry in enumerate(entries):
        told.step(entry.name)
        image = as_colour(entry.read_image(), entry.name)
        _check_inside(entry, image)
        grey.append(is_grey(image))
        image = camera.flatten(image)
        for name in view_of:
            sample(image, entry.points, name, first[i] if name in COPIED_APPEARANCES else i)
        made = copied.of_picture(i, image, entry.points, camera.response, model.diagonal)
        for row, (copy, points) in enumerate(made, first[i] + 1):
            told.step(f"a copy of {entry.name}")
            for name in copied_names:
                sample(copy, points, name, row)
        _check_light(entry, image, model.warp.interpolate(entry.points), room["log"][-1][1][i])
    if any(grey) and not all(grey):
        name = entries[grey.index(True)].name
        raise TrainingError(
            f"{name} is grey (three equal channels) but others are in colour; leave the grey images out, "
            "or make all grey"
        )
    textures = {name: [Textures.of(*each) for each in by_blur] for name, by_blur in room.items()}
    return _Sampled(textures, owners, all(grey))


def _room(n: int, warp: PiecewiseAffineWarp, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Room for the values of n textures of an appearance, and for what is usable of them."""
    shape = (n, warp.frame.n_pixels, CHANNELS[name])
    # Of ``soft``, gradient and invariant are usable each for itself.
    return np.empty(shape, np.float32), np.empty(shape if name == "soft" else shape[:2], np.float32)


def _learnt(encoding: str, values: np.ndarray, usable: np.ndarray, theta: float) -> tuple[np.ndarray, np.ndarray]:
    """What is learnt of samples in an encoding, (n_pixels, c), and what is usable of it.

    Of ``soft``, which is log RGB and how far it is known besides the gradient, the invariant is learnt.
    """
    if encoding != "soft":
        return values[:, : CHANNELS[encoding]], usable
    direction, log_rgb, known = np.split(values, [2, 5], axis=1)
    rows = np.concatenate([direction, log_rgb @ invariant_row(theta).T.astype(np.float32)], axis=1)
    return rows, np.column_stack([usable, usable, usable * (known[:, 0] > 0.99)])


def sample_appearance(
    image: np.ndarray,
    shape: np.ndarray,
    warp: PiecewiseAffineWarp,
    encoding: str,
    response: Response,
    blur: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Sample one image under its own landmarks on the reference frame.

    Parameters
    ----------
    image : (h, w, 3) uint8, uint16 or float32
    shape : (n, 2) float
        Landmarks, image pixels.
    warp : PiecewiseAffineWarp
        Of the model.
    encoding, response
        See :func:`liaam.photometry.encode`.
    blur : float
        Pixels of the reference frame.

    Returns
    -------
    values : (n_pixels, c) float32
    usable : (n_pixels,) float32 in {0, 1}
    """
    pose = align(warp.rest, shape)
    patch = make_patch(image, shape, pose, encoding=encoding, response=response, blur=blur, margin=0.1)
    points = warp.interpolate(shape)
    # Beyond the border the nearest pixel stands in, with weight 0.
    border = np.clip(points, 0, np.array(image.shape[1::-1]) - 1.0)
    values, usable = sample_texture(patch, border)
    return values, usable * (border == points).all(axis=1)


def _check_inside(entry: _Entry, image: np.ndarray) -> None:
    height, width = image.shape[:2]
    outside = np.asarray(((entry.points < -0.5) | (entry.points > [width - 0.5, height - 0.5])).any(axis=1))
    if outside.mean() > 0.1:
        raise TrainingError(
            f"{entry.name}: {outside.sum()} of {len(outside)} landmarks lie outside the image of {width}×{height} "
            "pixels; do the landmarks belong to this image at this size?"
        )


def _check_light(entry: _Entry, image: np.ndarray, points: np.ndarray, usable: np.ndarray) -> None:
    if usable.mean() >= 0.2:
        return
    inside = np.clip(np.rint(points).astype(int), 0, np.array(image.shape[1::-1]) - 1)
    dark, clipped = exposure_faults(image[inside[:, 1], inside[:, 0]])
    raise TrainingError(
        f"{entry.name}: the object is almost wholly {'black' if dark >= clipped else 'saturated'} there "
        f"({usable.mean():.0%} of its pixels usable); leave this image out or expose it otherwise"
    )


def _counted(values: np.ndarray, variance: Variance, folds: list[np.ndarray]) -> float | int:
    """Share or count to keep of textures (n, n_pixels, c): counted by evidence where that is asked for."""
    return count_by_evidence(values.reshape(len(values), -1), folds) if variance == "auto" else variance


def _appearances(
    sampled: _Sampled, level: int, theta: float, asked: Variance, folds: list[np.ndarray]
) -> dict[str, AppearanceModel]:
    """All appearances of one level of the view ``mesh``."""
    textures = {name: sampled.textures[name][level] for name in SAMPLED[MESH] if name in sampled.textures}
    if not sampled.grey:
        # LIT: project first, then learn (paper section 4).
        log = textures["log"]
        textures["invariant"] = Textures.of(log.values @ invariant_row(theta).T.astype(np.float32), log.usable)
    appearances, every = {}, some_folds(sampled.n_samples)
    for name, each in textures.items():
        share = _counted(each.values, asked, sampled.folds(name, folds))
        appearances[name] = train_appearance_model(each, share, left_out=sampled.folds(name, every))
    if "varied" in textures:
        # How many modes another light asks for, pictures left out under their own cannot tell.
        share, relit = 0.98 if asked == "auto" else asked, textures["varied"].of_rows(sampled.copies)
        appearances["illumination"] = train_illumination(appearances["value"], relit, share)
    return appearances


def _soft_appearance(sampled: _Sampled, level: int, variance: Variance, folds: list[np.ndarray]) -> AppearanceModel:
    """Learn gradient and invariant together: what changes one changes the other."""
    textures = sampled.textures["soft"][level]
    share = _counted(textures.values, variance, sampled.folds("soft", folds))
    return train_appearance_model(textures, share, left_out=sampled.folds("soft", some_folds(sampled.n_samples)))


LEFT_OUT_FOLDS, LEFT_OUT_PICTURES = 5, 20
"""Models to train without some of the samples, and pictures to fit with them, at most."""


def _reliability(
    model: AAM,
    entries: list[_Entry],
    shapes: np.ndarray,
    sampled: _Sampled,
    copied: Copies,
    learnt: tuple[Recipe, Variance, Variance],
    folds: list[np.ndarray],
    told: _Progress,
) -> Reliability | None:
    """Fit models of some of the samples to others, as they are and relit, to learn what right and wrong fits look like.

    Pictures whose names say that they show the same object are left out together: one would give the others away.
    """

    def pictures() -> Iterator[LeftOut]:
        """Give some pictures of each fold with the model of the others, one model at a time."""
        for i, fold in enumerate(folds):
            told.step(f"leaving out part {i + 1} of {len(folds)}", _learning(len(entries)))
            part = _without(model, fold, shapes, sampled, learnt)
            for j in _fitted(fold, folds):
                told.step(f"fitting {entries[j].name}", FITTED)
                image = as_colour(entries[j].read_image(), entries[j].name)
                yield LeftOut(part, image, shapes[j])
                for relit in copied.relit(j, image, shapes[j], model.response):
                    yield LeftOut(part, relit, shapes[j], relit=True)

    return calibrate(model, pictures())


def _fitted(fold: np.ndarray, folds: list[np.ndarray]) -> np.ndarray:
    """Pictures of a fold that are fitted when it is left out."""
    each = max(1, LEFT_OUT_PICTURES // len(folds))
    return fold[np.linspace(0, len(fold) - 1, min(each, len(fold))).astype(int)]


def _folds(names: list[str]) -> list[np.ndarray]:
    """Samples to leave out together: by object, where names such as 07-1, 07-2 or anna1, anna2 tell."""
    groups: dict[str, list[int]] = {}
    for i, name in enumerate(names):
        groups.setdefault(re.sub(r"([-_. ][^-_. /]*|\d+)$", "", re.sub(r"\.[A-Za-z]{2,4}\d?$", "", name)), []).append(i)
    several = len(groups) >= 3 and max(map(len, groups.values())) <= len(names) / 2
    members = list(groups.values()) if several else [[i] for i in range(len(names))]
    parts = np.array_split(np.arange(len(members)), min(len(members), LEFT_OUT_FOLDS))
    return [np.array(sorted(i for member in part for i in members[member])) for part in parts]


def _without(
    model: AAM,
    fold: np.ndarray,
    shapes: np.ndarray,
    sampled: _Sampled,
    learnt: tuple[Recipe, Variance, Variance],
) -> AAM:
    """Model of all samples but a fold's, on the frame of the model of all, learnt in the same way.

    ``learnt``: how the shapes of the view were learnt, and how much was asked for of shapes and of appearances.
    """
    recipe, variance, appearance_variance = learnt
    others, name = np.setdiff1d(np.arange(len(shapes)), fold), METHODS[DEFAULT_METHOD].view
    view, levels, rows = model.views[name], [], sampled.rows("soft", others)
    for level, textures in zip(view.levels, sampled.textures["soft"], strict=True):
        whole = level.appearances["soft"]
        kept = whole.n_modes if appearance_variance == "auto" else appearance_variance
        part = train_appearance_model(textures, kept, rows, left_out=None)
        # How far models err on what they have not seen, the folds of all have told.
        levels.append(Level(level.blur, {"soft": replace(part, unexplained=whole.unexplained)}))
    modes = len(view.shape_model.modes) if variance == "auto" else variance
    part = shape_model_on(view.shape_model.mean, shapes[others], modes, recipe)
    return model.with_view(name, warp=replace(view.warp, shape_model=part), levels=tuple(levels))
