"""Training: from landmarked images to an active appearance model."""

import os
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from liaam.appearance import CHANNELS, SURROUNDED, AppearanceModel, train_appearance_model, train_illumination
from liaam.errors import TrainingError
from liaam.fitting.reliability import LeftOut, calibrate
from liaam.mesh import (
    FOLD_TOLERANCE,
    ReferenceFrame,
    delaunay,
    folded_share,
    signed_areas,
    triangles_from_edges,
)
from liaam.model import AAM, MAX_DIAGONAL, Level, Reliability
from liaam.pca import Variance, check_variance, count_by_evidence
from liaam.photometry import ENCODINGS, CameraModel, Response, exposure_faults, invariant_row, is_grey, parse_response
from liaam.photometry.encoding import as_colour
from liaam.sampling import make_patch, sample_texture
from liaam.shape import Recipe, ShapeModel, align, check_prior, choose_recipe, scaled_mean, shape_model_on
from liaam.warp import PiecewiseAffineWarp, surrounded_warp

BLURS_DEFAULT = (3.0, 0.5)
"""Blur of the levels from coarse to fine, standard deviation in pixels of the reference frame."""

SOFT_BLURS = (4.0, 2.0, 1.0)
"""The same for ``soft`` appearances. Measured with persons that a model has not seen: one level more than two, and 1
pixel at the end rather than 0.5, lose fewer fits; gradients of JPEG's blocks are no better sharp."""


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
    appearance_variance: Variance | None = None,
    prior: str = "sample",
    soft_prior: str | None = None,
    diagonal: float = 150.0,
    theta: float | None = None,
    response: Response | None = None,
    camera: CameraModel | None = None,
    blurs: tuple[float, ...] = BLURS_DEFAULT,
    soft_blurs: tuple[float, ...] = SOFT_BLURS,
    triangles: np.ndarray | None = None,
    lit: Iterable | None = None,
    leave_out: bool = True,
    name: str = "",
    progress: Callable[[int, int, str], None] | None = None,
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
    appearance_variance : float, int or "auto", optional
        The same for appearances; as ``variance`` if left out.
    prior : {"sample", "smooth", "shrunk"}
        How the shapes' covariance is learnt. ``sample`` is the covariance of the shapes as they are (the paper).
        ``smooth``, for shapes that no training picture shows, draws it towards smooth deformations, and
        learns from the mirrored shapes too, as far as shapes left out are likelier so. ``shrunk`` takes the variances
        of shapes left out for eigenvalues.
    soft_prior : {"sample", "smooth", "shrunk"}, optional
        The same for ``soft-li``, which fits with shapes of its own where it differs. If left out: ``smooth`` where
        ``prior`` is ``sample``, not all of the variance is kept (which asks for the pictures' shapes and no others) and
        there are at most 200 landmarks (many take minutes), else as ``prior``. The other methods, which know less of
        what their errors weigh, lose by ``smooth``.
    diagonal : float
        Diagonal of the mean shape in the reference frame, pixels. More is slower and finer.
    theta : float, optional
        Angle of the training camera (theta_1 of the paper), radians; the camera's if left out.
    response : "srgb", "linear", float or ResponseCurve, optional
        How the pictures' values relate to linear light; the camera's if left out.
    camera : CameraModel, optional
        What is known of the training camera; 122 degrees and sRGB if nothing is.
    blurs : tuple of float
        Blur of the levels a fit goes through, from coarse to fine, pixels of the reference frame; of all methods but
        ``soft-li``.
    soft_blurs : tuple of float
        The same for ``soft-li``, the default method.
    triangles : (t, 3) int, optional
        The mesh. If left out: the files' connectivity where it is a mesh, else Delaunay of the mean shape.
    lit : Dataset or iterable, optional
        Further pictures of the same kind of object under other lights, for the methods that learn what light
        does (``varied``, ``aia``). Shapes and all other appearances are learnt from ``data`` alone.
    leave_out : bool
        Leave pictures out in turn and fit them, to learn how far the default method's fits can be trusted
        (``FitResult.quality`` and ``landmark_covariances``). Without it training is several times as fast.
    name : str
        What the model shows, for people.
    progress : callable, optional
        Called with (done, total, name) before each image.

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
    _check_options(variance, appearance_variance, diagonal, blurs, soft_blurs)
    for asked in (prior, prior if soft_prior is None else soft_prior):
        check_prior(asked)
    entries, contours, edges = _entries(data)
    shapes, folds = np.array([entry.points for entry in entries]), _folds([entry.name for entry in entries])
    mean = scaled_mean(shapes, diagonal)
    soft_prior = _soft_prior(prior, variance, len(mean)) if soft_prior is None else soft_prior
    recipe = choose_recipe(mean, shapes, prior, folds)
    shape_model = shape_model_on(mean, shapes, variance, recipe, folds)
    soft_shape = None
    if soft_prior != prior:
        recipe = choose_recipe(mean, shapes, soft_prior, folds)
        soft_shape = shape_model_on(mean, shapes, variance, recipe, folds)
    triangles = _triangles(shape_model.mean, triangles, edges)
    frame = ReferenceFrame(shape_model.mean, triangles)
    for entry in entries:
        _check_fold(entry, frame)
    sampled = _sample_all(entries, shape_model, frame, camera, _blurs_by_encoding(blurs, soft_blurs), progress)
    lit_sampled = None
    if lit is not None:
        by_encoding = dict.fromkeys(LIT_ENCODINGS, blurs)
        lit_sampled = _sample_lit(lit, entries, shape_model, frame, camera, by_encoding, progress, sampled.grey)
    kept = variance if appearance_variance is None else appearance_variance
    model = AAM(
        shape_model=shape_model,
        triangles=triangles,
        levels=tuple(
            Level(float(blur), _appearances(sampled, lit_sampled, i, camera.theta, kept, folds))
            for i, blur in enumerate(blurs)
        ),
        soft_levels=tuple(
            Level(float(blur), {"soft": _soft_appearance(sampled.textures["soft"][i], camera.theta, kept, folds)})
            for i, blur in enumerate(soft_blurs)
        ),
        camera=camera,
        n_images=len(entries),
        contours=contours,
        name=name,
        soft_shape=soft_shape,
    )
    if not leave_out:
        return model
    return replace(model, reliability=_reliability(model, entries, shapes, sampled, (recipe, variance, kept), progress))


LIT_ENCODINGS: tuple[str, ...] = ("value", "log")
"""What pictures under other lights are sampled in: to learn from, and to tell whether they show enough."""


def _blurs_by_encoding(blurs: tuple[float, ...], soft_blurs: tuple[float, ...]) -> dict[str, tuple[float, ...]]:
    return {encoding: soft_blurs if encoding == "soft" else blurs for encoding in ENCODINGS}


def _check_options(
    variance: Variance,
    appearance_variance: Variance | None,
    diagonal: float,
    blurs: tuple[float, ...],
    soft_blurs: tuple[float, ...],
) -> None:
    check_variance(variance)
    if appearance_variance is not None:
        check_variance(appearance_variance)
    if not 16 <= diagonal <= MAX_DIAGONAL:
        raise TrainingError(
            f"diagonal {diagonal:g}: give the size of the reference frame, 16 to {MAX_DIAGONAL:g} pixels"
        )
    for name, given in (("blurs", blurs), ("soft_blurs", soft_blurs)):
        if not given or list(given) != sorted(given, reverse=True) or not 0 <= given[-1] <= given[0] <= 10:
            raise TrainingError(f"{name} {given}: give 0 to 10 pixels of the reference frame, from coarse to fine")


MOST_SMOOTH = 200
"""Landmarks up to which soft-li has smooth deformations unasked: learning them takes seconds at 200, half a minute at
1000, and grows with the third power."""


def _soft_prior(prior: str, variance: Variance, n_points: int) -> str:
    """Prior of soft-li's shapes where nobody asks for one."""
    whole = isinstance(variance, float) and variance == 1.0
    return prior if prior != "sample" or whole or n_points > MOST_SMOOTH else "smooth"


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
    points = np.array(getattr(landmarks, "points", landmarks), dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 2 or len(points) < 3:
        raise TrainingError(f"{name}: landmarks of shape {points.shape} are not (n, 2) points with n of at least 3")
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
class _Texture:
    """All samples in one encoding at one blur: values (n, n_pixels, c) and usable (n, n_pixels), float32."""

    values: np.ndarray
    usable: np.ndarray


@dataclass(frozen=True)
class _Sampled:
    """Textures of all samples by encoding, one per blur, and whether all pictures are grey."""

    textures: dict[str, list[_Texture]]
    grey: bool


def _sample_all(
    entries: list[_Entry],
    shape_model: ShapeModel,
    frame: ReferenceFrame,
    camera: CameraModel,
    blurs: dict[str, tuple[float, ...]],
    progress: Callable | None,
) -> _Sampled:
    """Sample the textures of all entries in every encoding asked for, at each of its blurs."""
    plain = PiecewiseAffineWarp(frame, shape_model)
    around = surrounded_warp(shape_model, frame.triangles) if set(SURROUNDED) & set(blurs) else plain
    warps = {encoding: around if encoding in SURROUNDED else plain for encoding in blurs}
    textures: dict[str, list[_Texture]] = {
        encoding: [_empty(len(entries), warps[encoding], encoding) for _ in blurs[encoding]] for encoding in blurs
    }
    grey = []
    for i, entry in enumerate(entries):
        if progress:
            progress(i, len(entries), entry.name)
        image = as_colour(entry.read_image(), entry.name)
        _check_inside(entry, image)
        grey.append(is_grey(image))
        image = camera.flatten(image)
        for encoding, warp in warps.items():
            for texture, blur in zip(textures[encoding], blurs[encoding], strict=True):
                values, usable = sample_appearance(image, entry.points, warp, encoding, camera.response, blur)
                texture.values[i], texture.usable[i] = values[:, : texture.values.shape[2]], usable
        _check_light(entry, image, plain.interpolate(entry.points), textures["log"][-1].usable[i])
    if progress:
        progress(len(entries), len(entries), "appearance")
    if any(grey) and not all(grey):
        name = entries[grey.index(True)].name
        raise TrainingError(
            f"{name} is grey (three equal channels) but others are in colour; leave the grey images out, "
            "or make all grey"
        )
    return _Sampled(textures, all(grey))


def _empty(n: int, warp: PiecewiseAffineWarp, encoding: str) -> _Texture:
    # What is sampled of ``soft`` is more than what is learnt: log RGB and its weight make one row of the metric.
    channels = 6 if encoding == "soft" else CHANNELS[encoding]
    n_pixels = warp.frame.n_pixels
    return _Texture(np.empty((n, n_pixels, channels), np.float32), np.empty((n, n_pixels), np.float32))


def _sample_lit(
    lit: Iterable,
    entries: list[_Entry],
    shape_model: ShapeModel,
    frame: ReferenceFrame,
    camera: CameraModel,
    blurs: dict[str, tuple[float, ...]],
    progress: Callable | None,
    grey: bool,
) -> _Sampled:
    """Sample the pictures under other lights, which have to have the landmarks of the rest."""
    others, *_ = _entries(lit, at_least=1)
    for entry in others:
        if len(entry.points) != len(entries[0].points):
            raise TrainingError(
                f"{entry.name} (another light) has {len(entry.points)} landmarks but {entries[0].name} has "
                f"{len(entries[0].points)}; every image needs the same points in the same order"
            )
        _check_fold(entry, frame)
    sampled = _sample_all(others, shape_model, frame, camera, blurs, progress)
    if sampled.grey != grey:
        raise TrainingError(
            f"the pictures under other lights are {'in colour' if grey else 'grey (three equal channels)'}, unlike "
            f"those to learn from (such as {entries[0].name}); make both alike"
        )
    return sampled


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
    sampled: _Sampled, lit: _Sampled | None, level: int, theta: float, asked: Variance, folds: list[np.ndarray]
) -> dict[str, AppearanceModel]:
    """All appearances of one level but the soft one."""
    textures = {name: by_blur[level] for name, by_blur in sampled.textures.items() if name != "soft"}
    appearances = {
        name: train_appearance_model(texture.values, texture.usable, _counted(texture.values, asked, folds))
        for name, texture in textures.items()
    }
    if not sampled.grey:
        # LIT: project first, then learn (paper section 4).
        projected = textures["log"].values @ invariant_row(theta).T.astype(np.float32)
        kept = _counted(projected, asked, folds)
        appearances["invariant"] = train_appearance_model(projected, textures["log"].usable, kept)
    if lit is not None:
        # How many other lights ask for, the pictures under one light cannot tell.
        variance = 0.98 if asked == "auto" else asked
        other = lit.textures["value"][level]
        appearances["varied"] = train_appearance_model(
            np.concatenate([textures["value"].values, other.values]),
            np.concatenate([textures["value"].usable, other.usable]),
            variance,
        )
        appearances["illumination"] = train_illumination(appearances["value"], other.values, other.usable, variance)
    return appearances


def _soft_appearance(
    texture: _Texture, theta: float, variance: Variance, folds: list[np.ndarray], kept: np.ndarray | None = None
) -> AppearanceModel:
    """Learn gradient and invariant together, from all or the samples kept: what changes one changes the other."""
    values, usable = (texture.values, texture.usable) if kept is None else (texture.values[kept], texture.usable[kept])
    direction, log_rgb, known = np.split(values, [2, 5], axis=2)
    rows = np.concatenate([direction, log_rgb @ invariant_row(theta).T.astype(np.float32)], axis=2)
    seen = np.repeat(usable[..., None], 3, axis=2)
    seen[..., 2:] *= known > 0.99
    if not seen[..., 2].any():  # grey pictures: nothing to compare, and not by rounding either
        rows[..., 2] = 0.0
    return train_appearance_model(rows, seen, _counted(rows, variance, folds), leave_out=kept is None)


LEFT_OUT_FOLDS, LEFT_OUT_PICTURES = 5, 20
"""Models to train without some of the samples, and pictures to fit with them, at most."""


def _reliability(
    model: AAM,
    entries: list[_Entry],
    shapes: np.ndarray,
    sampled: _Sampled,
    learnt: tuple[Recipe, Variance, Variance],
    progress: Callable | None,
) -> Reliability | None:
    """Fit models of some of the samples to others, to learn what right and wrong fits look like.

    Pictures whose names say that they show the same object are left out together: one would give the others away.
    """
    folds = _folds([entry.name for entry in entries])
    each = max(1, LEFT_OUT_PICTURES // len(folds))
    total = sum(min(each, len(fold)) for fold in folds)

    def pictures() -> Iterator[LeftOut]:
        """Give some pictures of each fold with the model of the others, one model at a time."""
        done = 0
        for fold in folds:
            part = _without(model, fold, shapes, sampled, learnt)
            for i in fold[np.linspace(0, len(fold) - 1, min(each, len(fold))).astype(int)]:
                if progress:
                    progress(done, total, f"leaving out {entries[i].name}")
                done += 1
                image = as_colour(entries[i].read_image(), entries[i].name)
                yield LeftOut(part, image, shapes[i])

    found = calibrate(model, pictures())
    if progress:
        progress(total, total, "reliability")
    return found


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

    ``learnt``: how the shapes of ``soft-li`` were learnt, and how much was asked for of shapes and of appearances.
    """
    recipe, variance, appearance_variance = learnt
    others = np.setdiff1d(np.arange(len(shapes)), fold)
    levels = []
    for level, texture in zip(model.soft_levels, sampled.textures["soft"], strict=True):
        kept = level.appearances["soft"].n_modes if appearance_variance == "auto" else appearance_variance
        levels.append(Level(level.blur, {"soft": _soft_appearance(texture, model.theta, kept, [], others)}))
    modes = len(model.shape_of("soft").modes) if variance == "auto" else variance
    part = shape_model_on(model.shape_model.mean, shapes[others], modes, recipe)
    return replace(model, soft_shape=part, soft_levels=tuple(levels))
