"""The model file: safetensors with a JSON header, validated when it is read. No code in it is executed."""

import os
import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from liaam.errors import LiaamError, ModelFileError, shortened
from liaam.io.files import json_object, writable
from liaam.model import cost
from liaam.model.appearance import CHANNELS, COPIED_APPEARANCES, AppearanceModel, spread, strongest_modes
from liaam.model.light_basis import SIDE, LightBasis
from liaam.model.mesh import signed_areas
from liaam.model.point_map import LEAST_NOISE, PointMap
from liaam.model.rounding import decoded
from liaam.model.shape import ShapeModel, diagonal_of, similarity_modes
from liaam.model.views import MESH, VIEWS, Level, Reliability, View
from liaam.photometry import camera_from, parse_response
from liaam.photometry.features import LARGEST, WIDEST, Features

# Versions of the format, increased when its meaning changes
SCHEMA_VERSION = 5  # Of a model of one shape
OF_SHAPES = 6  # Of a model of several shapes
OF_MIRRORED = 7  # Of a model with shapes that are stored as mirror images of others
# Versions that are read. Version 4 has the appearances of all methods, modes in single precision.
READABLE = (4, 5, 6, 7)
# Key of a shape's header that is the mirror image of the shape before: the index of each landmark's mirror image
MIRRORED = "mirrored"
MOST_SHAPES = 4  # Largest number of shapes of a model
MAX_DIAGONAL = 2000.0  # Largest diagonal of a reference frame, pixels
MAX_POINTS = 4000  # Largest number of landmarks: the ring around a mesh takes memory that grows with its square
# Largest ratio of a mesh's area to its number of pixels. It exceeds 1 because borders matter in small frames.
ROOMY = 4.0
LONGEST_NAME = 1000  # Largest number of characters of a model's name, its credit and the name of a landmark
MAX_BLUR = 10.0  # Largest blur of a level, pixels of the reference frame
MAX_LEVELS = 10  # Largest number of levels of a view
MAX_LIGHTS = 100  # Largest number of modes of a light basis
MAX_IMAGES = 10**9  # Largest number of training images and copies
# Limits on numbers of files, so that no result overflows. What training finds is stated for the faces of liaam.
# Largest magnitude of a channel, as of a function's (LARGEST); those of faces are below 4.
MAX_VALUE = LARGEST
MAX_LOG_LIGHT = 20.0  # Largest logarithm of a ratio of lights; those of faces are below 1.2
MAX_VARIANCE = MAX_DIAGONAL**2  # Largest variance of a landmark, square pixels of the frame; of faces 31
MAX_FACTOR = 1e6  # Largest factor on the variances of a fit (faces: 2.2), odds (9), and magnitude of their weights (34)
LEAST_UNIT = 1e-12  # Least variance of a residual at weight 1; of faces 0.35
LARGEST_UNIT = 1e12  # Largest one
LEAST_FREEDOM = 1.0  # Least degrees of freedom: with fewer, shapes have no mean
LARGEST_FILTER = 100  # Largest height and width of the search's filter, pixels
# Smallest fraction of the pixels that a file stores. The others take memory that its size does not suggest.
LEAST_SHARE = 0.1
# Tensors of each part of a model: a light basis, a map from another landmarker's points, a function's channels, and
# those of a view. Those of appearances and of the modes of light are in functions below.
STORED = {
    "light": ("mean", "remainder"),
    "points": ("weights", "errors", "noise"),
    "features": ("mean", "projection"),
    "shape": ("modes", "eigenvalues", "unexplained"),
    "reliability": ("landmarks", "bias", "unit", "weights", "variance_factor", "typical", "prior"),
}
MOST_WEIGHT = 1e6  # Largest weight of another landmarker's point
UNIT = 0.1  # Tolerance of scalar products of orthonormal modes; weak modes have large rounding errors
FORMAT = "liaam-aam"  # Format in the headers of model files
LAMPS_FORMAT = "liaam-lamps"  # Format in the headers of lamp files
UNNAMED = "soft-li"  # Method whose calibration is stored without its name


def calibration_of(method: str) -> str:
    """Start of the names of the tensors of a method's calibration."""
    return "reliability" if method == UNNAMED else f"reliability/{method}"


def prefix_of(i: int) -> str:
    """Start of the names of the tensors of the i-th of the other shapes."""
    return f"others/{i}/"


def read_fields(path: str | os.PathLike) -> tuple[dict[str, Any], list[dict[str, Any] | np.ndarray]]:
    """Read and validate the fields of an :class:`~liaam.model.aam.AAM`, and of those of the other shapes.

    Of a shape that is the mirror image of the one before, return the index of each landmark's mirror image, (n,) int.
    Raises like ``load_model``.
    """
    from liaam.model.tensors import read_tensors

    path = Path(path)
    make = "liaam train FOLDER -o MODEL"
    broken = (
        "this is not a complete liaam model ({fault}); it may be truncated or of another kind: copy it again or "
        "train it again"
    )
    header, tensors = read_tensors(
        path, lambda text, _: _checked_header(path, text), ModelFileError, "model file", make, broken
    )
    try:
        _check_memory(header, tensors)
        return _fields(header, tensors), _fields_of_others(header, tensors)
    except cost.TooLargeError as error:
        remedy = "train it with a smaller diagonal, fewer modes (variance), or larger blurs"
        raise ModelFileError(f"{path}: the model is too large: {error}; {remedy}") from error
    except (KeyError, TypeError, ValueError, IndexError, OverflowError, LiaamError) as error:
        fault = f"the model file contradicts itself ({shortened(error)})"
        raise ModelFileError(f"{path}: {fault}; train the model again") from error


def _checked_header(path: Path, text: str) -> dict:
    """Parse a header, and raise ModelFileError unless it is that of a model in a version that is read."""
    header = json_object(text) or {}
    if header.get("format") == LAMPS_FORMAT:
        raise ModelFileError(
            f"{path} is a lamp file, not a model; draw it with 'liaam show', or train a model under its lamps with "
            "'liaam train FOLDER --lamps LAMPS -o MODEL'"
        )
    if header.get("format") != FORMAT:
        raise ModelFileError(f"{path}: this safetensors file is not a liaam model; make one with 'liaam train'")
    if header.get("schema") not in READABLE:
        readable = f"{READABLE[0]} to {READABLE[-1]}"
        raise ModelFileError(
            f"{path}: the model has schema version {shortened(header.get('schema'))}, this liaam reads versions "
            f"{readable}; train the model again ('liaam train FOLDER -o MODEL'), or use the liaam that wrote it"
        )
    return header


def _fields(header: dict, tensors: dict[str, np.ndarray]) -> dict[str, Any]:
    """Return the validated fields of the model of one shape."""
    mean, triangles = _mesh(tensors)
    n = len(mean)
    n_images = _count(header, "n_images")
    n_textures = _count(header, "n_textures")
    n_lamps = _count(header, "n_lamps")
    if not n_images:
        raise ValueError("there are no training images")
    views = header["views"]
    if not isinstance(views, dict) or MESH not in views:
        raise ValueError(f"there is no view {MESH}")
    if not isinstance(header["camera"], dict):
        raise ValueError(f"camera {shortened(header['camera'])} is not an object")
    camera = camera_from(header["camera"])
    features = _features(header, tensors)
    search_filter = _search_filter(tensors)
    contours = _contours(header, n)
    limits = _limits_of_appearances(n_images, n_textures, features)
    checked_views = {
        name: _view(name, description, tensors, mean, triangles, limits) for name, description in views.items()
    }
    cost.check_cost(checked_views.values())
    has_invariant = "invariant" in checked_views[MESH].levels[-1].appearances
    return {
        "views": checked_views,
        "triangles": triangles,
        # The header holds the exact angle with which the appearance was learnt; the camera's is rounded.
        "camera": replace(camera, theta=finite(header["theta"]), response=parse_response(header["response"])),
        "n_images": n_images,
        "contours": contours,
        "landmark_names": _names(header.get("landmark_names", []), n),
        "name": _text(header["name"]),
        "credit": _text(header.get("credit", "")),
        "same_images": bool(header.get("same_images", False)),
        "n_textures": n_textures,
        "n_lamps": n_lamps,
        "light": _light(tensors, n) if "light.modes" in tensors else None,
        "points": _point_map(tensors, n),
        "features": features,
        "search_filter": search_filter,
        "is_colour": bool(header.get("colour", has_invariant)),
    }


def _mesh(tensors: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean shape, (n, 2) float64, and the triangles, (t, 3) int32, after a check that they form a mesh."""
    mean = checked_tensor(tensors, "mean", np.float64, (None, 2))
    n = len(mean)
    triangles = checked_tensor(tensors, "triangles", np.int32, (None, 3))
    if n > MAX_POINTS:
        raise ValueError(f"it has {n} landmarks; the maximum is {MAX_POINTS}")
    if n < 3 or not len(triangles) or triangles.min() < 0 or triangles.max() >= n:
        raise ValueError("the mesh does not match the landmarks")
    # The mean is centred, so that no coordinate exceeds the diagonal; differences of larger ones might overflow.
    if np.abs(mean).max() > MAX_DIAGONAL or not 8.0 <= diagonal_of(mean) <= MAX_DIAGONAL:
        raise ValueError(f"the diagonal of the reference frame is not between 8 and {MAX_DIAGONAL:.0f} pixels")
    area = float(np.abs(signed_areas(mean, triangles)).sum())
    if len(triangles) > 2 * n or area > 1.001 * float(np.prod(np.ptp(mean, axis=0))):
        raise ValueError("the mesh overlaps itself")
    if not (signed_areas(mean, triangles) > 0).all():
        raise ValueError("the mesh is flat or folded")
    return mean, triangles


def _search_filter(tensors: dict[str, np.ndarray]) -> np.ndarray | None:
    """Return the filter of the search, (h, w, 2) float32; None if the model has none."""
    key = "search_filter"
    if key not in tensors:
        return None
    search_filter = half_or_single(tensors, key, (None, None, 2))
    height, width = search_filter.shape[:2]
    if not (1 <= height <= LARGEST_FILTER and 1 <= width <= LARGEST_FILTER):
        raise ValueError(f"{key} has shape {search_filter.shape}")
    check_magnitude(key, search_filter, MAX_VALUE)
    return search_filter


def _contours(header: dict, n: int) -> tuple[tuple[tuple[int, ...], bool], ...]:
    """Return the contours through the n landmarks: the indices of each, and whether it is closed."""
    contours = tuple((tuple(int(i) for i in indices), bool(closed)) for indices, closed in header["contours"])
    if any(not 0 <= i < n for indices, _ in contours for i in indices):
        raise ValueError("a contour names a landmark that does not exist")
    return contours


@dataclass(frozen=True)
class _Limits:
    """What the size of an appearance may be: its channels, and the number of textures that it was learnt from."""

    n_channels: int
    n_textures: int


def _limits_of_appearances(n_images: int, n_textures: int, features: Features | None) -> dict[str, _Limits]:
    """Return the limits on each appearance, by name; ``n_textures`` is the number of images with their copies."""
    limits = {}
    for name, n_channels in CHANNELS.items():
        if name == "features" and features is not None:
            n_channels = features.width
        n_learnt = max(n_images, n_textures) if name in COPIED_APPEARANCES else n_images
        limits[name] = _Limits(n_channels, n_learnt)
    return limits


# Key of the modes of an appearance: of one of the other shapes, if any, of a view, of a level
MODES_KEY = re.compile(r"(?:others/(?P<other>[0-9])/)?(?P<view>[a-z]+)/[0-9]+/(?P<appearance>[a-z]+)\.modes")


def _check_memory(header: dict, tensors: dict[str, np.ndarray]) -> None:
    """Raise ValueError if the modes of all shapes take too much memory; files hold a byte of four, on some pixels."""
    total = 0.0
    for key, modes in tensors.items():
        match = MODES_KEY.fullmatch(key)
        if match is None or match["appearance"] not in CHANNELS:
            continue
        n_pixels = _n_pixels(header, match["other"], match["view"])
        total += cost.LOADED * float(len(modes)) * n_pixels * CHANNELS[match["appearance"]]
    cost.check_memory(total)


def _n_pixels(header: dict, other: str | None, view: str) -> float:
    """Number of pixels of a view, as a header states it; 0 if it does not, for which the file is refused later."""
    try:
        header_of_shape = header if other is None else header["others"][int(other)]
        return float(header_of_shape["views"][view]["n_pixels"])
    except (KeyError, IndexError, TypeError, ValueError):
        return 0.0


def _count(header: dict, key: str) -> int:
    """Number of images or lamps in a header; only that of images must be there."""
    count = header[key] if key == "n_images" else header.get(key, 0)
    if int(count) != count or not 0 <= count <= MAX_IMAGES:
        raise ValueError(f"{key} is not a number from 0 to {MAX_IMAGES:,}")
    return int(count)


def _fields_of_others(header: dict, tensors: dict[str, np.ndarray]) -> list[dict[str, Any] | np.ndarray]:
    """Fields of the models of the other shapes, which have as many landmarks; see :func:`read_fields`."""
    others = header.get("others", [])
    if not isinstance(others, list) or len(others) >= MOST_SHAPES:
        raise ValueError(f"there are not 1 to {MOST_SHAPES} shapes")
    fields: list[dict[str, Any] | np.ndarray] = []
    for i, header_of_shape in enumerate(others):
        if i and MIRRORED in header_of_shape:
            fields.append(_mirror_order(header_of_shape, len(tensors["mean"])))
            continue
        tensors_of_shape = _below(tensors, prefix_of(i))
        if tensors_of_shape["mean"].shape != tensors["mean"].shape:
            raise ValueError("the shapes do not have the same number of landmarks")
        fields.append(_fields(header_of_shape, tensors_of_shape))
    return fields


def _mirror_order(header: dict, n: int) -> np.ndarray:
    """Return the index of each landmark's mirror image, (n,) int, from the header of a mirrored shape."""
    order = np.array(header[MIRRORED])
    if order.shape != (n,) or order.dtype.kind != "i" or not 0 <= order.min() <= order.max() < n:
        raise ValueError(f"{MIRRORED} has not {n} indices of landmarks")
    if not np.array_equal(order[order], np.arange(n)):
        raise ValueError(f"{MIRRORED} does not exchange pairs of landmarks")
    return order


def _below(tensors: dict[str, np.ndarray], prefix: str) -> dict[str, np.ndarray]:
    """Return the tensors whose names start with a prefix, by the rest of their names."""
    return {key.removeprefix(prefix): tensor for key, tensor in tensors.items() if key.startswith(prefix)}


def _light(tensors: dict[str, np.ndarray], n: int) -> LightBasis:
    """Return the light basis of a model with n landmarks."""
    mean = checked_tensor(tensors, "light.mean", np.float64, (n, 2))
    stored = _stored_pixels(tensors, "light", SIDE * SIDE)
    if stored is None:
        modes = _modes(tensors, "light", (None, SIDE, SIDE, 3))
    else:
        modes = _modes(tensors, "light", (None, int(stored.sum()), 3))
    if not 1 <= len(modes) <= MAX_LIGHTS:
        raise ValueError(f"light.modes has shape {modes.shape}")
    if stored is not None:
        modes = spread(modes, stored, axis=1).reshape(-1, SIDE, SIDE, 3)
    remainder = checked_tensor(tensors, "light.remainder", np.float16, (SIDE, SIDE))
    # Coordinates of a mean shape with diagonal 1, and standard deviations.
    if np.abs(mean).max() > 1.0 or diagonal_of(mean) < 0.5 or (remainder < 0).any():
        raise ValueError("the light basis has values out of range")
    check_magnitude("light.modes", modes, MAX_LOG_LIGHT)
    check_magnitude("light.remainder", remainder, MAX_LOG_LIGHT)
    return LightBasis(mean, modes, remainder)


def _features(header: dict, tensors: dict[str, np.ndarray]) -> Features | None:
    """What is known of the user's function."""
    if "features" not in header:
        return None
    mean = checked_tensor(tensors, "features.mean", np.float64, (None,))
    projection = checked_tensor(tensors, "features.projection", np.float64, (len(mean), None))
    name = str(header["features"])
    width = projection.shape[1]
    if not name.isidentifier() or not 1 <= width <= WIDEST or not are_unit(projection.T):
        raise ValueError("features.projection is not a projection")
    if np.abs(mean).max(initial=0.0) > LARGEST:
        raise ValueError("features.mean is out of range")
    return Features(name, mean, projection)


def _point_map(tensors: dict[str, np.ndarray], n: int) -> PointMap | None:
    """The map from another landmarker's points."""
    if "points.weights" not in tensors:
        return None
    weights = checked_tensor(tensors, "points.weights", np.float64, (n, None))
    errors = checked_tensor(tensors, "points.errors", np.float64, (None, 2 * n))
    noise = float(checked_tensor(tensors, "points.noise", np.float64, (1,))[0])
    if not 3 <= weights.shape[1] <= MAX_POINTS or weights.shape[1] == n or np.abs(weights).max() > MOST_WEIGHT:
        raise ValueError("points.weights do not map another landmarker's points")
    if np.abs(errors).max(initial=0.0) > MAX_DIAGONAL or not LEAST_NOISE <= noise <= MAX_DIAGONAL**2:
        raise ValueError("points.errors or points.noise are out of range")
    return PointMap(weights, errors, noise)


def _view(
    name: str,
    description: dict,
    tensors: dict[str, np.ndarray],
    mean: np.ndarray,
    triangles: np.ndarray,
    limits: dict[str, _Limits],
) -> View:
    """Make one view from its header ``description``; all views share the mean shape. ``limits`` are by appearance."""
    if name not in VIEWS:
        raise ValueError(f"view {shortened(name)!r} is unknown; the views are {', '.join(VIEWS)}")
    if not isinstance(description, dict):
        raise ValueError(f"view {name} is described by {shortened(description)}")
    tensors = _below(tensors, f"{name}/")
    blurs = [finite(blur) for blur in description["blurs"]]
    n_pixels = description["n_pixels"]
    if not 1 <= len(blurs) <= MAX_LEVELS or not all(0 <= blur <= MAX_BLUR for blur in blurs):
        raise ValueError(f"blurs {shortened(blurs)}: 1 to {MAX_LEVELS} numbers between 0 and {MAX_BLUR:g} are expected")
    if not isinstance(n_pixels, int) or n_pixels < 1:
        raise ValueError(f"{shortened(n_pixels)} is not a positive integer")
    if blurs != sorted(blurs, reverse=True):
        raise ValueError(f"blurs {blurs} do not fall from coarse to fine")
    # Appearances first: their tensors limit the number of pixels to what the size of the file allows.
    levels = []
    for i, blur in enumerate(blurs):
        appearances = {}
        for kind in CHANNELS:
            if f"{i}/{kind}.mean" in tensors:
                appearances[kind] = _appearance(tensors, f"{i}/{kind}", n_pixels, limits[kind])
        # In files without an appearance for the search, it is the strongest modes of the orientations.
        if name == MESH and i == 0 and "search" not in appearances and "orientation" in appearances:
            appearances["search"] = strongest_modes(appearances["orientation"])
        levels.append(Level(blur, appearances))
    if _lacks_appearance(name, levels):
        raise ValueError(f"view {name} lacks an appearance")
    if signed_areas(mean, triangles).sum() > ROOMY * n_pixels:
        raise ValueError(f"the reference frame of view {name} does not match its number of pixels")
    warp = VIEWS[name](_shape_model(description, tensors, mean), triangles)
    if n_pixels != warp.frame.n_pixels:
        raise ValueError(f"the reference frame of view {name} does not match its number of pixels")
    warp = replace(warp, from_right=bool(description.get("from_right", False)))
    return View(warp, tuple(levels), _reliabilities(tensors, len(mean)))


def _lacks_appearance(view: str, levels: list[Level]) -> bool:
    """Return whether a view lacks an appearance that every model has."""
    if view == MESH:
        # The drawings of a model and the light on its object need the logarithms of the sharpest level.
        return "log" not in levels[-1].appearances
    return not all(level.appearances for level in levels)


# Key of the weights of a method's calibration
WEIGHTS_KEY = re.compile(r"(?P<calibration>reliability(?:/(?P<method>[a-z0-9-]{1,40}))?)\.weights")


def _reliabilities(tensors: dict[str, np.ndarray], n: int) -> dict[str, Reliability]:
    """Return the calibrations in the tensors of a view with n landmarks, by method."""
    prefixes = {}
    for key in sorted(tensors):
        match = WEIGHTS_KEY.fullmatch(key)
        if match is not None:
            prefixes[match["method"] or UNNAMED] = match["calibration"]
    return {method: _reliability(tensors, prefix, n) for method, prefix in prefixes.items()}


def _shape_model(description: dict, tensors: dict[str, np.ndarray], mean: np.ndarray) -> ShapeModel:
    """Return the shape model of a view from its header and its tensors."""
    n = len(mean)
    modes = checked_tensor(tensors, "shape.modes", np.float64, (None, 2 * n))
    if len(modes) > 2 * n - 4:  # they are orthogonal to each other and to the four similarity vectors
        raise ValueError(f"{len(modes)} shape modes are too many for {n} landmarks")
    basis = np.concatenate([modes, similarity_modes(mean)])
    products = np.einsum("id,jd->ij", modes, basis)  # threads of BLAS would wait longer than this takes
    if not are_unit(modes) or np.abs(products - np.eye(len(modes), len(basis))).max(initial=0.0) > UNIT:
        raise ValueError("shape.modes are not orthonormal")
    eigenvalues = checked_tensor(tensors, "shape.eigenvalues", np.float64, (len(modes),))
    key = "shape.unexplained"
    unexplained = checked_tensor(tensors, key, np.float64, (n, 2, 2)) if key in tensors else None
    if unexplained is not None:
        check_covariances(key, unexplained, MAX_VARIANCE)
    check_magnitude("shape.eigenvalues", eigenvalues, n * MAX_VARIANCE)
    freedom = finite(description["freedom"]) if "freedom" in description else np.inf
    if not freedom >= LEAST_FREEDOM:
        raise ValueError(f"freedom {freedom:g} is below {LEAST_FREEDOM:g}")
    return ShapeModel(mean, modes, eigenvalues, unexplained, freedom)


def _reliability(tensors: dict[str, np.ndarray], prefix: str, n: int) -> Reliability:
    """Return the calibration of a method with n landmarks; ``prefix`` starts the names of its tensors."""
    landmarks = checked_tensor(tensors, f"{prefix}.landmarks", np.float64, (n, 2, 2))
    bias = checked_tensor(tensors, f"{prefix}.bias", np.float64, (n, 2, 2))
    unit = _number(tensors, f"{prefix}.unit")
    factor = _number(tensors, f"{prefix}.variance_factor")
    typical = _number(tensors, f"{prefix}.typical")
    has_prior = f"{prefix}.prior" in tensors  # older files have none
    prior = _number(tensors, f"{prefix}.prior") if has_prior else 1.0
    check_covariances(f"{prefix}.landmarks", landmarks, MAX_VARIANCE)
    check_covariances(f"{prefix}.bias", bias, MAX_VARIANCE)
    if not unit > 0.0:
        raise ValueError(f"{prefix}.unit is not positive")
    if not prior > 0.0:
        raise ValueError(f"{prefix}.prior is not positive")
    if not LEAST_UNIT <= unit <= LARGEST_UNIT:
        raise ValueError(f"{prefix}.unit {unit:g} is not between {LEAST_UNIT:g} and {LARGEST_UNIT:g}")
    if not 1.0 / MAX_FACTOR <= prior <= MAX_FACTOR:
        raise ValueError(f"{prefix}.prior {prior:g} is not between {1.0 / MAX_FACTOR:g} and {MAX_FACTOR:g}")
    if factor < 1.0:
        raise ValueError(f"{prefix}.variance_factor is below 1")
    check_magnitude(f"{prefix}.variance_factor", np.array(factor), MAX_FACTOR)
    if not 0.0 <= typical <= 1.0:
        raise ValueError(f"{prefix}.typical is not a probability")
    weights = checked_tensor(tensors, f"{prefix}.weights", np.float64, (3,))
    check_magnitude(f"{prefix}.weights", weights, MAX_FACTOR)
    return Reliability(
        landmarks=landmarks,
        bias=bias,
        unit=unit,
        weights=weights,
        variance_factor=factor,
        typical=typical,
        prior=prior,
    )


def _number(tensors: dict[str, np.ndarray], key: str) -> float:
    """Return the value of a tensor of one number."""
    return float(checked_tensor(tensors, key, np.float64, (1,))[0])


def _appearance(tensors: dict[str, np.ndarray], prefix: str, n_pixels: int, limits: _Limits) -> AppearanceModel:
    """Return an appearance on all pixels of a view, from the tensors whose names start with ``prefix``."""
    channels = limits.n_channels
    stored = _stored_pixels(tensors, prefix, n_pixels)
    n_stored = n_pixels if stored is None else int(stored.sum())
    modes = _modes(tensors, prefix, (None, n_stored, channels))
    # More modes than images would need more memory in a fit than the file's size suggests.
    most = min(n_pixels * channels, limits.n_textures)
    if len(modes) > most:
        raise ValueError(f"{prefix} has {len(modes)} modes; the maximum is {most}")
    # Modes of which only the used pixels are stored, or not 0, are shorter than they were learnt.
    is_part = stored is not None or not modes.any(axis=(0, 2)).all()
    if not are_unit(modes.reshape(len(modes), n_stored * channels), at_most=is_part):
        raise ValueError(f"{prefix}.modes are not of unit length")
    unexplained = _unexplained(tensors, f"{prefix}.unexplained", n_stored, channels)
    mean = half_or_single(tensors, f"{prefix}.mean", (n_stored, channels))
    check_magnitude(f"{prefix}.mean", mean, MAX_VALUE)
    eigenvalues = checked_tensor(tensors, f"{prefix}.eigenvalues", np.float64, (len(modes),))
    check_magnitude(f"{prefix}.eigenvalues", eigenvalues, n_pixels * channels * MAX_VALUE**2)
    appearance = AppearanceModel(
        mean=mean,
        modes=modes,
        eigenvalues=eigenvalues,
        usable=half_or_single(tensors, f"{prefix}.usable", (n_stored,)),
        unexplained=unexplained,
    )
    return appearance if stored is None else appearance.spread(stored)


def _unexplained(tensors: dict[str, np.ndarray], key: str, n_pixels: int, channels: int) -> np.ndarray | None:
    """Return the covariance of an appearance's errors at each pixel, (n_pixels, channels, channels) float32, or None.

    Files store the upper triangle of each matrix, row by row; those of version 4 the whole matrices.
    """
    if key not in tensors:
        return None
    if tensors[key].ndim == 3:
        matrices = half_or_single(tensors, key, (n_pixels, channels, channels))
    else:
        rows, columns = np.triu_indices(channels)
        triangle = half_or_single(tensors, key, (n_pixels, len(rows)))
        matrices = np.empty((n_pixels, channels, channels), np.float32)
        matrices[:, rows, columns] = triangle
        matrices[:, columns, rows] = triangle
    check_variances(key, matrices)
    check_covariances(key, matrices, MAX_VALUE**2, ROUNDED)
    return matrices


def _stored_pixels(tensors: dict[str, np.ndarray], prefix: str, n_pixels: int) -> np.ndarray | None:
    """Mask of the pixels that are stored, (n_pixels,) bool; None if all are. Files store one bit of it per pixel."""
    key = f"{prefix}.known"
    if key not in tensors:
        return None
    n_bytes = -(-n_pixels // 8)  # rounded up
    bits = checked_tensor(tensors, key, np.uint8, (n_bytes,))
    stored = np.unpackbits(bits, count=n_pixels).astype(bool)
    if stored.sum() < LEAST_SHARE * n_pixels:
        raise ValueError(f"{prefix} has {stored.sum()} of {n_pixels} pixels; at least {LEAST_SHARE:.0%} are expected")
    return stored


def _modes(tensors: dict[str, np.ndarray], prefix: str, shape: tuple[int | None, ...]) -> np.ndarray:
    """Modes in single precision; they are stored as codes and steps, or in 16 or 32 bits."""
    key = f"{prefix}.modes"
    if tensors[key].dtype != np.int8:
        return half_or_single(tensors, key, shape)
    codes = checked_tensor(tensors, key, np.int8, shape)
    steps = checked_tensor(tensors, f"{prefix}.steps", np.float32, (len(codes),))
    if (steps < 0).any() or steps.max(initial=0.0) > 1.0:
        raise ValueError(f"{prefix}.steps has values out of range")
    return decoded(codes, steps)


def _names(names: list, n: int) -> tuple[str, ...]:
    """Return the names of the n landmarks; there may be none."""
    if not isinstance(names, list) or len(names) not in (0, n):
        raise ValueError(f"there are not {n} names of landmarks")
    return tuple(_text(name) for name in names)


def _text(value: object) -> str:
    """Return a text of a header in a form that can be shown and written, shortened."""
    return writable(str(value))[:LONGEST_NAME]


def half_or_single(tensors: dict[str, np.ndarray], key: str, shape: tuple[int | None, ...]) -> np.ndarray:
    """A tensor in 16 or 32 bits, in single precision."""
    dtype = np.float16 if tensors[key].dtype == np.float16 else np.float32
    return checked_tensor(tensors, key, dtype, shape).astype(np.float32, copy=False)


def checked_tensor(tensors: dict[str, np.ndarray], key: str, dtype: type, shape: tuple[int | None, ...]) -> np.ndarray:
    """Return a tensor of a type and shape (None for any length), whose values its name allows. Raises ValueError."""
    tensor = tensors[key]
    if tensor.dtype != dtype or not _has_shape(tensor, shape):
        raise ValueError(f"{key} has type {tensor.dtype} and shape {tensor.shape}")
    if tensor.dtype.kind == "f" and not np.isfinite(tensor).all():
        raise ValueError(f"{key} has values that are not finite")
    if key.endswith("eigenvalues") and (tensor < 0).any():
        raise ValueError(f"{key} has values out of range")
    if key.endswith("usable") and ((tensor < 0).any() or (tensor > 1).any()):
        raise ValueError(f"{key} has values out of range")
    if key.endswith(("shape.unexplained", "landmarks", "bias")):
        check_variances(key, tensor)
    return tensor


def _has_shape(tensor: np.ndarray, shape: tuple[int | None, ...]) -> bool:
    """Return whether a tensor has a shape, of which None stands for any length."""
    if tensor.ndim != len(shape):
        return False
    return all(expected in (None, length) for expected, length in zip(shape, tensor.shape, strict=True))


def check_variances(key: str, matrices: np.ndarray) -> None:
    """Raise ValueError if a diagonal of matrices (n, c, c) has negative values."""
    if (np.diagonal(matrices, axis1=1, axis2=2) < 0).any():
        raise ValueError(f"{key} has negative variances")


@dataclass(frozen=True)
class _Rounding:
    """By how much rounding may make a covariance asymmetric or indefinite."""

    of_trace: float  # relative to the trace
    least: float  # added to that, since the smallest numbers of a type are this far apart, or less


EXACT = _Rounding(of_trace=1e-9, least=1e-12)  # Of double precision, after the sums of a covariance
ROUNDED = _Rounding(of_trace=1e-2, least=1e-6)  # Of the 16 bits in which errors of appearances are stored


def check_covariances(key: str, matrices: np.ndarray, largest: float, rounding: _Rounding = EXACT) -> None:
    """Raise ValueError unless matrices (n, c, c) are symmetric and positive semidefinite, with bounded variances."""
    check_magnitude(key, matrices, largest)
    matrices = matrices.astype(np.float64, copy=False)
    allowed = rounding.of_trace * np.trace(matrices, axis1=1, axis2=2) + rounding.least
    if (np.abs(matrices - matrices.swapaxes(1, 2)) > allowed[:, None, None]).any():
        raise ValueError(f"{key} has matrices that are not symmetric")
    try:
        np.linalg.cholesky(matrices + allowed[:, None, None] * np.eye(matrices.shape[1]))
    except np.linalg.LinAlgError as error:
        raise ValueError(f"{key} has matrices that are not positive semidefinite") from error


def check_magnitude(key: str, values: np.ndarray, largest: float) -> None:
    """Raise ValueError if a value exceeds the largest magnitude."""
    if max(values.max(initial=0.0), -values.min(initial=0.0)) > largest:
        raise ValueError(f"{key} has values beyond {largest:g}")


def are_unit(modes: np.ndarray, at_most: bool = False) -> bool:
    """Whether modes (m, d) have unit length, or at most that if only a part of them is kept."""
    if max(modes.max(initial=0.0), -modes.min(initial=0.0)) > 2.0:  # the squares might overflow
        return False
    beyond = np.einsum("md,md->m", modes, modes) - 1.0
    return bool(((beyond if at_most else np.abs(beyond)) < UNIT).all())


def finite(value: float) -> float:
    """Return a finite number; raise ValueError for others."""
    if not np.isfinite(value):
        raise ValueError(f"{shortened(value)} is not a finite number")
    return float(value)
