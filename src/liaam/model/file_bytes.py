"""The content of a model file: as few and as narrow tensors as hold the model exactly."""

import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from liaam.model import file_format
from liaam.model.appearance import AppearanceModel
from liaam.model.light_basis import LightBasis
from liaam.model.mirror import mirrored_model
from liaam.model.regressor import LandmarkRegressor
from liaam.model.rounding import encoded
from liaam.model.shape import mirror_order
from liaam.model.views import View
from liaam.photometry import describe_response

if TYPE_CHECKING:
    from liaam.model.aam import AAM

Value = TypeVar("Value")


def file_bytes(model: "AAM") -> bytes:
    """Return the content of the file of a model, in the format of safetensors."""
    from safetensors.numpy import save

    header = _header(model)
    tensors = _tensors(model)
    if model.others:
        header["schema"] = file_format.OF_SHAPES
        header["others"] = []
    for i, other in enumerate(model.others):
        mirror_images = _mirror_images_of_landmarks(model, i)
        if mirror_images is None:
            header["others"].append(_header(other))
            tensors |= _named(file_format.prefix_of(i), _tensors(other))
        else:
            header["schema"] = file_format.OF_MIRRORED
            header["others"].append({file_format.MIRRORED: mirror_images.tolist()})
    return save(tensors, {"liaam": json.dumps(header)})


def _mirror_images_of_landmarks(model: "AAM", i: int) -> np.ndarray | None:
    """Return the index of each landmark's mirror image if the i-th other shape is the one before mirrored, or None.

    The file then holds these indices instead of the shape. It does so only if exactly the same shape is made of them.
    """
    if i == 0:
        return None  # readers mirror other shapes only, and there is none before the first
    before = model.others[i - 1]
    other = model.others[i]
    # Mirrored models have as many pixels, and those with features of a function cannot be mirrored.
    if before.n_pixels != other.n_pixels or before.features is not None:
        return None
    order = mirror_order(model.shape_model.mean)
    if order is None or not _have_same_content(mirrored_model(before, order), other):
        return None
    return order


def _have_same_content(first: "AAM", second: "AAM") -> bool:
    """Whether two models are stored as the same header and tensors."""
    tensors = _tensors(first)
    others = _tensors(second)
    if tensors.keys() != others.keys():
        return False
    if not all(np.array_equal(tensors[name], others[name]) for name in tensors):
        return False
    return _header(first) == _header(second)


def _header(model: "AAM") -> dict[str, Any]:
    """Return what a file holds of a model besides its tensors, and without its other shapes."""
    header = {
        "format": file_format.FORMAT,
        "schema": file_format.SCHEMA_VERSION,
        "theta": model.theta,
        "response": describe_response(model.response),
        "camera": model.camera.describe(),
        "views": {name: _header_of_view(view) for name, view in model.views.items()},
        "n_images": model.n_images,
        "n_textures": model.n_textures,
        "n_lamps": model.n_lamps,
        "colour": model.is_colour,
        "contours": [[list(indices), closed] for indices, closed in model.contours],
        "landmark_names": list(model.landmark_names),
        "name": model.name,
    }
    # The following are written only of models that have them; a reader takes their absence for none.
    if model.card.stated:
        header["card"] = model.card.stated
    if model.scale is not None:
        header["scale"] = {"value": model.scale.value, "unit": model.scale.unit}
    if model.sides is not None:
        header["sides"] = vars(model.sides)
    if model.fingerprints:
        header["fingerprints"] = list(model.fingerprints)
    if model.failing_methods:
        header["failing_methods"] = list(model.failing_methods)
    if model.same_images:
        header["same_images"] = True
    if model.in_pieces:
        header["in_pieces"] = True
    if model.rotations != file_format.UPRIGHT:
        header["rotations"] = model.rotations
    if model.n_missing is not None:
        header["n_missing"] = model.n_missing.tolist()
    if model.features is not None:
        header["features"] = model.features.name
    return header


def _header_of_view(view: View) -> dict[str, Any]:
    header: dict[str, Any] = {
        "blurs": [level.blur for level in view.levels],
        "n_pixels": view.warp.frame.n_pixels,
    }
    if np.isfinite(view.shape_model.freedom):  # JSON has no infinity, and a reader takes an absent one for that
        header["freedom"] = view.shape_model.freedom
    if view.warp.from_right:
        header["from_right"] = True
    return header


def _tensors(model: "AAM") -> dict[str, np.ndarray]:
    """Return the tensors of a model by their names in the file, without those of its other shapes."""
    tensors: dict[str, np.ndarray | None] = {"mean": model.shape_model.mean, "triangles": model.triangles}
    if model.poses is not None:
        tensors["poses"] = model.poses.astype(np.float32)
    if model.in_box is not None:
        tensors["in_box"] = model.in_box
    if model.search_filter is not None:
        tensors["search_filter"] = _half_if_exact(model.search_filter)
    if model.light is not None:
        tensors |= _named("light.", _light_tensors(model.light))
    if model.points is not None:
        tensors |= _named("points.", _stored_fields(model.points, "points"))
    if model.regressor is not None:
        tensors |= _named("regressor.", _regressor_tensors(model.regressor))
    if model.refiner is not None:
        tensors |= _named("refiner.", _regressor_tensors(model.refiner))
        tensors |= _named("refiner.shape.", _stored_fields(model.refiner.shape_model, "shape"))
        tensors["refiner.share"] = np.array(model.refiner.share)
        tensors["refiner.sharpness"] = np.array(model.refiner.sharpness)
    if model.relief is not None:
        tensors["relief"] = np.rint(file_format.RELIEF_STEPS * model.relief).astype(np.int8)
    if model.features is not None:
        tensors |= _named("features.", _stored_fields(model.features, "features"))
    for name, view in model.views.items():
        tensors |= _named(f"{name}/", _view_tensors(view))
    return {name: np.ascontiguousarray(np.atleast_1d(value)) for name, value in tensors.items() if value is not None}


def _view_tensors(view: View) -> dict[str, np.ndarray | None]:
    tensors = _named("shape.", _stored_fields(view.shape_model, "shape"))
    for method, reliability in view.reliabilities.items():
        calibration = file_format.calibration_of(method)
        tensors |= _named(f"{calibration}.", _stored_fields(reliability, "reliability"))
        if reliability.presence is not None:
            tensors |= _named(f"{calibration}.presence.", _stored_fields(reliability.presence, "presence"))
    for i, level in enumerate(view.levels):
        for kind, appearance in level.appearances.items():
            tensors |= _named(f"{i}/{kind}.", _appearance_tensors(appearance))
    return tensors


def _appearance_tensors(appearance: AppearanceModel) -> dict[str, np.ndarray | None]:
    """Return the tensors that hold an appearance exactly, as few and as narrow as that is possible."""
    mask = appearance.mask
    if mask.sum() < file_format.LEAST_SHARE * len(mask):  # readers refuse so few; the others are stored too, as zeros
        mask = np.ones(len(mask), bool)
    unexplained = None
    if appearance.unexplained is not None:
        unexplained = _half_if_exact(_upper_triangles(appearance.unexplained[mask]))
    return {
        "known": None if mask.all() else np.packbits(mask),
        "mean": _half_if_exact(appearance.mean[mask]),
        **_mode_tensors(appearance.modes[:, mask]),
        "eigenvalues": appearance.eigenvalues,
        "usable": _half_if_exact(appearance.usable[mask]),
        "unexplained": unexplained,
    }


def _regressor_tensors(regressor: LandmarkRegressor) -> dict[str, np.ndarray]:
    """Return the tensors of a regressor: those of its steps, one after the other, and its errors."""
    steps = regressor.steps
    return {
        "spacings": np.array([step.spacing for step in steps]),
        "weights": _half_if_exact(np.stack([step.weights for step in steps])),
        "offsets": np.stack([step.offsets for step in steps]),
        "variances": np.stack([step.errors for step in steps]),
        "errors": regressor.left_out.errors,
        "noise": np.array(regressor.left_out.noise),
    }


def _light_tensors(light: LightBasis) -> dict[str, np.ndarray]:
    """Return the tensors of a light basis, whose modes (k, side, side, 3) are 0 far from the object."""
    mask = light.modes.any(axis=(0, 3))
    return {
        **_stored_fields(light, "light"),
        "known": np.packbits(mask),
        **_mode_tensors(light.modes[:, mask]),
    }


def _stored_fields(part: object, kind: str) -> dict[str, Any]:
    """Return the fields of a part of a model that a file holds as they are, by their names."""
    return {field: getattr(part, field) for field in file_format.STORED[kind]}


def _named(prefix: str, tensors: Mapping[str, Value]) -> dict[str, Value]:
    """Put a prefix before the names of tensors."""
    return {f"{prefix}{name}": value for name, value in tensors.items()}


def _mode_tensors(modes: np.ndarray) -> dict[str, np.ndarray]:
    """Return modes rounded to 8 bits as codes and steps, and others in 16 bits if that is exact, or as they are."""
    rounded = encoded(modes)
    if rounded is None:
        return {"modes": _half_if_exact(modes)}
    codes, steps = rounded
    return {"modes": codes, "steps": steps}


def _half_if_exact(values: np.ndarray) -> np.ndarray:
    """Return values in half precision if none of them changes, or as they are."""
    with np.errstate(over="ignore"):
        half = values.astype(np.float16)
    return half if np.array_equal(half, values) else values


def _upper_triangles(matrices: np.ndarray) -> np.ndarray:
    """Return the upper triangles (n, c (c + 1) / 2), row by row, of symmetric matrices (n, c, c)."""
    rows, columns = np.triu_indices(matrices.shape[1])
    return matrices[:, rows, columns]
