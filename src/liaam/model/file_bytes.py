"""The content of a model file: as few and as narrow tensors as hold the model exactly."""

import json
from typing import TYPE_CHECKING

import numpy as np

from liaam.model import file
from liaam.model.appearance import AppearanceModel
from liaam.model.mirror import mirrored_model
from liaam.model.rounding import encoded
from liaam.model.shape import mirror_order
from liaam.photometry import describe_response

if TYPE_CHECKING:
    from liaam.model.aam import AAM


def file_bytes(model: "AAM") -> bytes:
    """Return the content of a model file."""
    from safetensors.numpy import save

    header, tensors = _header(model), _tensors(model)
    if model.others:
        header |= {"schema": file.OF_SHAPES, "others": []}
    for i, other in enumerate(model.others):
        own, order = _tensors(other), _mirror(model, i)
        if order is None:
            header["others"].append(_header(other))
            tensors |= {f"{file.prefix_of(i)}{key}": value for key, value in own.items()}
        else:
            header |= {"schema": file.OF_MIRRORED}
            header["others"].append({file.MIRRORED: order.tolist()})
    return save(tensors, {"liaam": json.dumps(header)})


def _mirror(model: "AAM", i: int) -> np.ndarray | None:
    """Return the order of landmarks that makes the i-th other shape the mirror image of the one before, or None."""
    before, other = model.others[i - 1], model.others[i]
    order = mirror_order(model.shape_model.mean) if i and before.n_pixels == other.n_pixels else None
    if order is None or before.features is not None:
        return None
    mirrored = mirrored_model(before, order)
    own, theirs = _tensors(mirrored), _tensors(other)
    same = own.keys() == theirs.keys() and all(np.array_equal(own[key], theirs[key]) for key in own)
    return order if same and _header(mirrored) == _header(other) else None


def _header(model: "AAM") -> dict:
    return {
        "format": file.FORMAT,
        "schema": file.SCHEMA_VERSION,
        "theta": model.theta,
        "response": describe_response(model.response),
        "camera": model.camera.describe(),
        "views": {
            name: {
                "blurs": [level.blur for level in view.levels],
                "n_pixels": view.warp.frame.n_pixels,
                **({"freedom": view.shape_model.freedom} if np.isfinite(view.shape_model.freedom) else {}),
                **({"from_right": True} if view.warp.from_right else {}),
            }
            for name, view in model.views.items()
        },
        "n_images": model.n_images,
        "n_textures": model.n_textures,
        "n_lamps": model.n_lamps,
        "colour": model.is_colour,
        "contours": [[list(indices), closed] for indices, closed in model.contours],
        "landmark_names": list(model.landmark_names),
        "name": model.name,
        **({"credit": model.credit} if model.credit else {}),
        **({"same_images": True} if model.same_images else {}),
        **({} if model.features is None else {"features": model.features.name}),
    }


def _tensors(model: "AAM") -> dict[str, np.ndarray]:
    tensors = {"mean": model.shape_model.mean, "triangles": model.triangles}
    if model.search_filter is not None:
        tensors["search_filter"] = _half_if_exact(model.search_filter)
    parts = [(part, getattr(model, part), part) for part in ("light", "points", "features")]
    for name, view in model.views.items():
        parts += [
            (f"{name}/shape", view.shape_model, "shape"),
            *((f"{name}/{file.calibration_of(m)}", known, "reliability") for m, known in view.reliabilities.items()),
        ]
        for i, level in enumerate(view.levels):
            for kind, appearance in level.appearances.items():
                tensors |= {f"{name}/{i}/{kind}.{k}": v for k, v in _appearance_tensors(appearance).items()}
    for prefix, owner, kind in parts:
        if owner is not None:
            tensors |= {f"{prefix}.{key}": getattr(owner, key) for key in file.STORED[kind]}
    if model.light is not None:  # its modes are 0 far from the object
        known = model.light.modes.any(axis=(0, 3))
        about = {"known": np.packbits(known), **_mode_tensors(model.light.modes[:, known])}
        tensors |= {f"light.{key}": value for key, value in about.items()}
    return {key: np.ascontiguousarray(np.atleast_1d(value)) for key, value in tensors.items() if value is not None}


def _appearance_tensors(appearance: AppearanceModel) -> dict[str, np.ndarray | None]:
    """Return the tensors that hold an appearance exactly, as few and as narrow as that is possible."""
    known = appearance.known
    if known.sum() < file.LEAST_SHARE * len(known):
        known = np.ones(len(known), bool)
    errors = appearance.unexplained
    if errors is not None:
        rows, columns = np.triu_indices(errors.shape[1])
        errors = _half_if_exact(errors[known][:, rows, columns])
    return {
        "known": None if known.all() else np.packbits(known),
        "mean": _half_if_exact(appearance.mean[known]),
        **_mode_tensors(appearance.modes[:, known]),
        "eigenvalues": appearance.eigenvalues,
        "usable": _half_if_exact(appearance.usable[known]),
        "unexplained": errors,
    }


def _mode_tensors(modes: np.ndarray) -> dict[str, np.ndarray]:
    """Return modes rounded to 8 bits as codes and steps, and others in 16 bits if that is exact, or as they are."""
    found = encoded(modes)
    return {"modes": _half_if_exact(modes)} if found is None else dict(zip(("modes", "steps"), found, strict=True))


def _half_if_exact(values: np.ndarray) -> np.ndarray:
    with np.errstate(over="ignore"):
        half = values.astype(np.float16)
    return half if np.array_equal(half, values) else values
