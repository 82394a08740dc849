"""The model file: safetensors with a JSON header, validated when it is read. No code in it is executed."""

import os
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from liaam.errors import LiaamError, ModelFileError, missing, shortened
from liaam.io.files import json_object
from liaam.model import cost
from liaam.model.appearance import CHANNELS
from liaam.model.card import CARD_FIELDS, ModelCard
from liaam.model.file_checks import checked_tensor, finite, text_of
from liaam.model.file_format import (
    FORMAT,
    LAMPS_FORMAT,
    LONGEST_OF_CARD,
    MAX_DIAGONAL,
    MAX_IMAGES,
    MAX_POINTS,
    MIRRORED,
    MOST_SHAPES,
    READABLE,
    ROTATIONS,
    UPRIGHT,
    prefix_of,
)
from liaam.model.file_parts import (
    limits_of_appearances,
    read_features,
    read_in_box,
    read_light,
    read_point_map,
    read_poses,
    read_refiner,
    read_regressor,
    read_relief,
    read_search_filter,
    read_view,
    tensors_below,
)
from liaam.model.mesh import signed_areas
from liaam.model.shape import diagonal_of
from liaam.model.sides import Sides
from liaam.model.views import MESH, shape_model_of
from liaam.models import MODELS
from liaam.photometry import camera_from, parse_response
from liaam.scale.choice import TRAINING
from liaam.scale.lengths import Length


def read_fields(path: str | os.PathLike) -> tuple[dict[str, Any], list[dict[str, Any] | np.ndarray]]:
    """Read and validate the fields of an :class:`~liaam.model.aam.AAM`, and of those of the other shapes.

    Of a shape that is the mirror image of the one before, return the index of each landmark's mirror image, (n,) int.
    Raises like ``load_model``.
    """
    from liaam.model.tensors import read_tensors

    path = Path(path)
    make = "liaam train FOLDER -o MODEL"
    if not path.suffix and not path.exists():  # perhaps a misspelt name of a model
        raise missing(ModelFileError)(
            f"{path}: the model file does not exist; make one with '{make}', or use one that comes with liaam "
            f"({', '.join(MODELS)})"
        )
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
    features = read_features(header, tensors)
    search_filter = read_search_filter(tensors)
    contours = _contours(header, n)
    limits = limits_of_appearances(n_images, n_textures, features)
    in_pieces = bool(header.get("in_pieces", False))
    checked_views = {
        name: read_view(name, description, tensors, mean, triangles, in_pieces, limits)
        for name, description in views.items()
    }
    cost.check_cost(checked_views.values())
    has_invariant = "invariant" in checked_views[MESH].levels[-1].appearances
    return {
        "views": checked_views,
        "triangles": triangles,
        "in_pieces": in_pieces,
        "poses": read_poses(tensors, n),
        "in_box": read_in_box(tensors, n),
        # The header holds the exact angle with which the appearance was learnt; the camera's is rounded.
        "camera": replace(camera, theta=finite(header["theta"]), response=parse_response(header["response"])),
        "n_images": n_images,
        "contours": contours,
        "landmark_names": _names(header.get("landmark_names", []), n),
        "name": text_of(header["name"]),
        "card": _card(header),
        "scale": _scale(header["scale"]) if "scale" in header else None,
        "sides": _sides(header) if "sides" in header else None,
        "fingerprints": _fingerprints(header),
        "failing_methods": _failing_methods(header),
        "same_images": bool(header.get("same_images", False)),
        "rotations": _rotations(header),
        "n_missing": _n_missing(header, n, n_images),
        "n_textures": n_textures,
        "n_lamps": n_lamps,
        "light": read_light(tensors, n) if "light.modes" in tensors else None,
        "points": read_point_map(tensors, n),
        "regressor": read_regressor(tensors, "regressor", shape_model_of(checked_views)),
        "refiner": read_refiner(tensors, mean),
        "relief": read_relief(tensors),
        "features": features,
        "search_filter": search_filter,
        "is_colour": bool(header.get("colour", has_invariant)),
    }


def _card(header: dict) -> ModelCard:
    """Return the card of a model; older files have the credit alone."""
    stored = header.get("card", {"credit": header.get("credit", "")})
    if not isinstance(stored, dict):
        raise ValueError(f"card {shortened(stored)} is not an object")
    return ModelCard(**{name: text_of(stored.get(name, ""), LONGEST_OF_CARD) for name in CARD_FIELDS})


def _scale(stored: Any) -> Length:
    """Return the length of a pixel of the training images."""
    if not isinstance(stored, dict):
        raise ValueError(f"scale {shortened(stored)} is not an object")
    return Length(finite(stored["value"]), text_of(stored["unit"]), source=TRAINING)


def _sides(header: dict) -> Sides:
    """Return the sides of the training images."""
    stored = header["sides"]
    if not isinstance(stored, dict):
        raise ValueError(f"sides {shortened(stored)} is not an object")
    return Sides(str(stored["own"]), _count(stored, "n_own"), _count(stored, "n_other"))


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


def _contours(header: dict, n: int) -> tuple[tuple[tuple[int, ...], bool], ...]:
    """Return the contours through the n landmarks: the indices of each, and whether it is closed."""
    contours = tuple((tuple(int(i) for i in indices), bool(closed)) for indices, closed in header["contours"])
    if any(not 0 <= i < n for indices, _ in contours for i in indices):
        raise ValueError("a contour names a landmark that does not exist")
    return contours


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


def _n_missing(header: dict, n: int, n_images: int) -> np.ndarray | None:
    """Return the number of images in which each of n landmarks was missing, (n,) int64; None if none was."""
    if "n_missing" not in header:
        return None
    counts = np.array(header["n_missing"])
    if counts.shape != (n,) or counts.dtype.kind != "i" or not 0 <= counts.min() <= counts.max() < n_images:
        raise ValueError(f"n_missing has not {n} numbers from 0 to {n_images - 1}")
    return counts.astype(np.int64)


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
        tensors_of_shape = tensors_below(tensors, prefix_of(i))
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


FINGERPRINT = re.compile(r"[a-p]{16}")  # of a file, as liaam.io.files.fingerprint_of makes it

MOST_METHODS = 100  # Largest number of methods that a header names


def _failing_methods(header: dict) -> tuple[str, ...]:
    """Return the methods whose fits to left-out images were mostly wrong."""
    methods = header.get("failing_methods", [])
    if not isinstance(methods, list) or len(methods) > MOST_METHODS:
        raise ValueError("failing_methods is not a list of methods")
    return tuple(text_of(method) for method in methods)


def _fingerprints(header: dict) -> tuple[str, ...]:
    """Return those of the files of the training images; older files have none."""
    prints = header.get("fingerprints", [])
    if not isinstance(prints, list) or not all(
        isinstance(each, str) and FINGERPRINT.fullmatch(each) for each in prints
    ):
        raise ValueError("fingerprints are not a list of 16 letters each")
    return tuple(prints)


def _rotations(header: dict) -> str:
    """Return which rotations of the object fits search for; older files do not say, and mean upright ones."""
    rotations = header.get("rotations", UPRIGHT)
    if rotations not in ROTATIONS:
        raise ValueError(f"rotations {shortened(rotations)} are not known; they are {' or '.join(ROTATIONS)}")
    return rotations


def _names(names: list, n: int) -> tuple[str, ...]:
    """Return the names of the n landmarks; there may be none."""
    if not isinstance(names, list) or len(names) not in (0, n):
        raise ValueError(f"there are not {n} names of landmarks")
    return tuple(text_of(name) for name in names)
