"""Forged models that are then fitted: whole model files, whose numbers are plausible for the most part."""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable
from contextlib import suppress
from copy import deepcopy
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from fuzz.engine import METHODS, POINTS, _picture, tiny, twice
from fuzz.mutate import Random, one_of
from fuzz.target import Target
from liaam.errors import MethodError, StartError

Tensors = dict[str, np.ndarray]

EXTREMES = (0.0, -1.0, 1e6, -1e6, 1e30, 1e300, -1e300, 5e-324, 1e-30, np.nan, np.inf, -np.inf)
"""Numbers that no training finds."""

CALIBRATED = ("reliability", "reliability/grey", "reliability/igo", "reliability/li")
"""Starts of the names of calibrations, of methods that are fitted here."""

BOX = (10, 10, 40, 40)
"""A start on the small image."""

SHARE_ACCEPTED = 1 / 3
"""Least fraction of the forged models that are to be accepted and fitted: others test the reader only."""

ASYMMETRIC, INDEFINITE = 1e-9, 1e-7
"""Largest asymmetry of a covariance, and its least eigenvalue below 0, as fractions of its trace: those of rounding."""


# Whole models ---------------------------------------------------------------------------------------


@cache
def _bases() -> tuple[bytes, ...]:
    """Files of small models: of one shape, with a thinned mesh, of two shapes, with a light basis, of one view."""
    from liaam.model import MESH

    whole = tiny()
    thinned, light = _thinned(whole), _light_basis(whole)
    other = replace(whole, points=None, features=None)
    several = replace(whole, others=(other,))
    alone = replace(whole, views={MESH: whole.views[MESH]})
    return tuple(model.to_bytes() for model in (whole, thinned, several, replace(whole, light=light), alone))


def _thinned(model: Any) -> Any:
    """Take a triangle from the mesh, and the pixels in it."""
    from liaam.model.views import VIEWS, Level, View

    triangles = model.triangles[:-1]
    views = {}
    for name, view in model.views.items():
        warp = VIEWS[name](view.shape_model, triangles, model.in_pieces)
        kept = np.arange(warp.frame.n_pixels) % view.warp.frame.n_pixels
        levels = tuple(
            Level(level.blur, {kind: _of_unit_length(each.at(kept)) for kind, each in level.appearances.items()})
            for level in view.levels
        )
        views[name] = View(warp, levels)
    return replace(model, views=views, triangles=triangles)


def _of_unit_length(appearance: Any) -> Any:
    modes = appearance.modes
    sizes = np.sqrt(np.square(modes, dtype=np.float64).sum(axis=(1, 2), keepdims=True))
    return replace(appearance, modes=(modes / np.maximum(sizes, 1e-6)).astype(np.float32))


def _light_basis(model: Any) -> Any:
    from liaam.model.light_basis import SIDE, LightBasis
    from liaam.model.shape import diagonal_of

    mean = model.shape_model.mean - 0.5 * (model.shape_model.mean.min(axis=0) + model.shape_model.mean.max(axis=0))
    across = np.linspace(-1.0, 1.0, SIDE, dtype=np.float32)
    modes = np.stack([np.broadcast_to(each[..., None], (SIDE, SIDE, 3)) for each in np.meshgrid(across, across)])
    return LightBasis(mean / diagonal_of(mean), modes.copy(), np.full((SIDE, SIDE), 0.1, np.float16))


@cache
def _parts_of(index: int) -> tuple[dict, Tensors]:
    """Header and tensors of one of the whole models."""
    from safetensors.numpy import load

    data = _bases()[index]
    return header_of(data), load(data)


def header_of(data: bytes) -> dict:
    """Return the header of a model file."""
    length = int.from_bytes(data[:8], "little")
    return json.loads(json.loads(data[8 : 8 + length])["__metadata__"]["liaam"])


# Changes ----------------------------------------------------------------------------------------


def _some_key(rng: Random, tensors: Tensors, *endings: str) -> str | None:
    keys = [key for key in sorted(tensors) if key.endswith(endings)]
    return one_of(rng, keys) if keys else None


def _positive_definite(rng: Random, count: int, size: int) -> np.ndarray:
    """Covariances (count, size, size), some of them of low rank or 0."""
    factors = rng.normal(size=(count, size, size)) * (rng.random(size) < 0.8)
    return factors @ factors.swapaxes(1, 2) * 10.0 ** rng.uniform(-6, 3)


def _other_variances(rng: Random, header: dict, tensors: Tensors) -> None:
    """Scale variances of modes, each by itself or all."""
    if (key := _some_key(rng, tensors, "eigenvalues")) is not None:
        sizes = len(tensors[key]) if rng.random() < 0.5 else 1
        tensors[key] = tensors[key] * 10.0 ** rng.uniform(-9, 4, sizes) * (rng.random(sizes) < 0.9)


def _other_modes(rng: Random, header: dict, tensors: Tensors) -> None:
    """Turn the signs of modes, reorder them, repeat one, or exchange pixels."""
    key = _some_key(rng, tensors, "modes")
    if key is None or not len(tensors[key]) or key.endswith("light.modes"):
        return
    modes, kind = tensors[key], int(rng.integers(4))
    if kind == 0:
        signs = rng.choice([-1, 1], len(modes)).reshape(-1, *[1] * (modes.ndim - 1))
        tensors[key] = (
            np.clip(modes, -127, 127) * signs.astype(modes.dtype) if modes.dtype == np.int8 else modes * signs
        )
        tensors[key] = tensors[key].astype(modes.dtype)
    elif kind == 1:
        tensors[key] = modes[rng.permutation(len(modes))]
    elif kind == 2 and not key.endswith("shape.modes"):
        tensors[key] = np.repeat(modes[:1], len(modes), axis=0)
    elif modes.ndim > 2:
        tensors[key] = modes[:, rng.permutation(modes.shape[1])]


def _fewer_modes(rng: Random, header: dict, tensors: Tensors) -> None:
    """Leave out the last modes, perhaps all; rarely from one of the tensors only."""
    key = _some_key(rng, tensors, "modes")
    if key is None or key.endswith("light.modes"):
        return
    count, prefix = int(rng.integers(len(tensors[key]) + 1)), key.removesuffix("modes")
    names = ("modes", "eigenvalues", "steps") if rng.random() < 0.95 else ("modes",)
    for name in names:
        if prefix + name in tensors:
            tensors[prefix + name] = tensors[prefix + name][:count]


def _other_weights(rng: Random, header: dict, tensors: Tensors) -> None:
    """Change which pixels are usable."""
    if (key := _some_key(rng, tensors, "usable")) is not None:
        usable = rng.random(len(tensors[key])) * (rng.random(len(tensors[key])) < rng.random())
        tensors[key] = (usable if rng.random() < 0.8 else np.round(usable)).astype(tensors[key].dtype)


def _other_means(rng: Random, header: dict, tensors: Tensors) -> None:
    """Scale, turn, mix or clear the mean of an appearance."""
    key = _some_key(rng, tensors, *(f"{kind}.mean" for kind in ("value", "log", "orientation", "search", "soft")))
    if key is None:
        return
    mean, kind = tensors[key], int(rng.integers(4))
    if kind == 0:
        scale = float(10.0 ** rng.uniform(-6, 3)) * one_of(rng, (1.0, -1.0))
        mean = mean.astype(np.float32) * np.float32(scale)
    elif kind == 1:
        mean = rng.permuted(mean)
    elif kind == 2:
        mean = np.zeros_like(mean)
    else:
        mean = rng.normal(0, 10.0 ** rng.uniform(-3, 1), mean.shape).astype(np.float32)
    tensors[key] = mean


def _other_errors(rng: Random, header: dict, tensors: Tensors) -> None:
    """Replace the errors of an appearance or of the shapes; a few are indefinite."""
    key = _some_key(rng, tensors, "unexplained")
    if key is None:
        return
    errors = tensors[key]
    if rng.random() < 0.1:
        del tensors[key]
        return
    size = errors.shape[-1] if errors.ndim == 3 else int((np.sqrt(8 * errors.shape[1] + 1) - 1) / 2)
    made = _positive_definite(rng, len(errors), size)
    if rng.random() < 0.15:
        made[:, 0, -1] = made[:, -1, 0] = made[:, 0, -1] + float(10.0 ** rng.uniform(-9, 4))
    if errors.ndim != 3:
        rows, columns = np.triu_indices(size)
        tensors[key] = made[:, rows, columns].astype(np.float32)
    else:
        tensors[key] = made.astype(errors.dtype)


def _calibrate(rng: Random, header: dict, tensors: Tensors) -> None:
    """Calibrate a method, mostly with possible numbers."""
    count, owner = len(tensors["mean"]), f"{one_of(rng, ('mesh', 'surroundings'))}/{one_of(rng, CALIBRATED)}"
    known = {
        "landmarks": _positive_definite(rng, count, 2),
        "bias": _positive_definite(rng, count, 2),
        "unit": 10.0 ** rng.uniform(-6, 3, 1),
        "weights": rng.normal(0, 10.0 ** rng.uniform(-1, 3), 3),
        "variance_factor": 1.0 + 10.0 ** rng.uniform(-3, 3, 1),
        "typical": one_of(rng, (rng.random(1), np.zeros(1), np.ones(1))),
        "prior": 10.0 ** rng.uniform(-5, 5, 1),
    }
    if rng.random() < 0.5:
        known["scales"] = _positive_definite(rng, count, 2)
    if rng.random() < 0.15:
        name = one_of(rng, sorted(known))
        known[name] = (
            known[name] * one_of(rng, EXTREMES) if rng.random() < 0.5 else known[name][::-1, ..., None][..., 0]
        )
    if rng.random() < 0.1:
        known[one_of(rng, ("landmarks", "bias"))] = np.tile([[0.0, 1e300], [1e300, 0.0]], (count, 1, 1))
    tensors |= {f"{owner}.{name}": value for name, value in known.items()}


def _other_blurs(rng: Random, header: dict, tensors: Tensors) -> None:
    """Blur the levels of a view otherwise: all by 0, all alike, falling, or rarely rising."""
    about = header["views"][one_of(rng, sorted(header["views"]))]
    count = len(about["blurs"])
    falling = sorted(rng.uniform(0, 10, count).tolist(), reverse=True)
    alike = [float(one_of(rng, (0.0, 0.01, 0.29, 1.0, 10.0)))] * count
    choices = [[0.0] * count, alike, falling, falling, falling[::-1]]
    about["blurs"] = choices[int(rng.choice(5, p=[0.2, 0.3, 0.2, 0.2, 0.1]))]


def _other_header(rng: Random, header: dict, tensors: Tensors) -> None:
    """Change a number of the header: counts, freedom, the camera, what is drawn."""
    view = header["views"][one_of(rng, sorted(header["views"]))]
    changes: tuple[Callable[[], None], ...] = (
        lambda: header.update(n_images=int(10 ** rng.uniform(0, 9))),
        lambda: header.update(n_textures=int(10 ** rng.uniform(0, 9))),
        lambda: header.update(theta=float(rng.uniform(-6.2, 6.2))),
        lambda: header.update(response=one_of(rng, ("srgb", "linear", 2.2, 0.2, 5.0))),
        lambda: header.update(colour=bool(rng.random() < 0.5)),
        lambda: header.update(contours=[[[0, 1, 2], True], [[3, 4], False], [[2, 2], False], [[], True]]),
        lambda: view.update(freedom=float(10.0 ** rng.uniform(-0.1, 9))),
        lambda: view.update(from_right=True),
        lambda: header["camera"].update(
            noise={"slope": 10.0 ** rng.uniform(-9, 0), "offset": 10.0 ** rng.uniform(-12, 0)}
        ),
        lambda: header["camera"].update(vignetting=rng.normal(0, 0.2, int(rng.integers(4))).tolist()),
        lambda: view.update(n_pixels=view["n_pixels"] + int(rng.integers(-1, 2))),
    )
    one_of(rng, changes)()


def _other_search(rng: Random, header: dict, tensors: Tensors) -> None:
    """Replace the search's filter."""
    size = (*rng.integers(1, 24, 2).tolist(), 2)
    scale = one_of(rng, (0.0, 1e-30, 1e-3, 1.0, 1e5))
    tensors["search_filter"] = (rng.normal(size=size) * scale).astype(np.float32)


def _other_points(rng: Random, header: dict, tensors: Tensors) -> None:
    """Scale the map of another landmarker's points, or its errors."""
    if (key := _some_key(rng, tensors, "points.weights", "points.errors", "points.noise")) is not None:
        tensors[key] = tensors[key] * 10.0 ** rng.uniform(-3, 3)


def _other_mean_shape(rng: Random, header: dict, tensors: Tensors) -> None:
    """Move the landmarks a little: the modes stay nearly orthogonal, and the frame may keep its pixels."""
    mean = tensors["mean"]
    tensors["mean"] = mean + rng.normal(0, 10.0 ** rng.uniform(-9, -1), mean.shape)


def _other_light(rng: Random, header: dict, tensors: Tensors) -> None:
    """Scale the basis of light."""
    if (key := _some_key(rng, tensors, "light.modes", "light.steps", "light.remainder")) is not None:
        with np.errstate(over="ignore"):
            tensors[key] = (tensors[key] * 10.0 ** rng.uniform(-3, 2)).astype(tensors[key].dtype)


def _extreme(rng: Random, header: dict, tensors: Tensors) -> None:
    """Put numbers that no training finds into a tensor."""
    key = _some_key(rng, tensors, "")
    assert key is not None
    tensor = tensors[key].copy()
    if not tensor.size:
        return
    with np.errstate(all="ignore"):
        value = np.array(one_of(rng, EXTREMES)).astype(tensor.dtype)
    tensor.reshape(-1)[rng.integers(tensor.size, size=int(rng.integers(1, 5)))] = value
    tensors[key] = tensor


def _other_type(rng: Random, header: dict, tensors: Tensors) -> None:
    """Store a tensor as another type, or with another shape."""
    key = _some_key(rng, tensors, "")
    assert key is not None
    with np.errstate(all="ignore"):
        kind = one_of(rng, (np.float16, np.float32, np.float64, np.int32))
        tensors[key] = tensors[key].astype(kind) if rng.random() < 0.7 else tensors[key][: len(tensors[key]) // 2]


PLAUSIBLE = (
    *(_other_variances, _other_modes, _fewer_modes, _other_weights, _other_means, _other_errors, _calibrate),
    *(_calibrate, _other_blurs, _other_header, _other_search, _other_points, _other_mean_shape, _other_light),
)
"""Changes that are accepted for the most part."""

IMPLAUSIBLE = (_extreme, _other_type)
"""Changes that are refused for the most part."""


def make(rng: Random) -> bytes:
    """Make a model file with a few changes."""
    from safetensors.numpy import save

    index = int(rng.choice(len(_bases()), p=[0.4, 0.15, 0.15, 0.15, 0.15]))
    header, tensors = deepcopy(_parts_of(index)[0]), dict(_parts_of(index)[1])
    for _ in range(int(rng.geometric(0.4))):
        one_of(rng, IMPLAUSIBLE if rng.random() < 0.06 else PLAUSIBLE)(rng, header, tensors)
    tensors = {key: np.ascontiguousarray(value) for key, value in tensors.items()}
    return save(tensors, {"liaam": json.dumps(header)})


# Fits -------------------------------------------------------------------------------------------


def check(data: bytes) -> None:
    """Read a model. If it is accepted, all fits with it end, without a warning, in a sound result."""
    from liaam.fitting import features_method
    from liaam.model import load_model

    path = Path("forged.liaam")
    path.write_bytes(data)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        model = load_model(path)
        drawn = sum(data[-64:])
        other = (
            features_method(twice) if model.features is not None and drawn % 8 == 0 else METHODS[drawn % len(METHODS)]
        )
        points = POINTS if model.points is not None else BOX
        n_fits = _fit(model, "soft-li", (BOX, None))
        if drawn % 3 == 0:
            n_fits += _fit(model, other, (points,) if drawn % 2 else (BOX,))
        if not n_fits:  # it lacks what the first method needs
            _fit(model, "grey", (BOX, None))


def _fit(model: Any, method: Any, starts: tuple) -> int:
    """Fit with a method from each start; return how many results there are."""
    from liaam.fitting import Fitter

    n_fits = 0
    with suppress(MethodError):  # the model lacks what the method needs
        fitter = Fitter(model, method)
        for start in starts:
            with suppress(StartError, MethodError):  # points are mapped elsewhere; nothing can be searched for
                check_result(fitter.fit(_picture(), start))
                n_fits += 1
    return n_fits


def check_result(result: Any) -> None:
    """Assert that a result is sound, whatever its status."""
    from liaam.fitting import FitStatus

    json.dumps(result.to_dict(), allow_nan=False).encode()
    assert isinstance(result.status, FitStatus), result.status
    assert np.isnan(result.quality) or 0.0 <= result.quality <= 1.0, result.quality
    assert _is_covariance(result.covariance[None]), "covariance"
    if result.status.lost:
        return
    for name in ("landmarks", "p", "lam", "evidence", "residual_variance", "cost", "landmark_covariances"):
        assert np.isfinite(getattr(result, name)).all(), name
    assert _is_covariance(result.landmark_covariances), "landmark_covariances"
    assert result.residual_variance >= 0.0, result.residual_variance


def _is_covariance(matrices: np.ndarray) -> bool:
    """Tell whether matrices (n, c, c) are finite, symmetric and positive semidefinite, but for rounding."""
    if not np.isfinite(matrices).all():
        return False
    sizes = np.maximum(np.trace(matrices, axis1=1, axis2=2), 0.0)
    apart = np.abs(matrices - matrices.swapaxes(1, 2)).max(axis=(1, 2))
    least = np.linalg.eigvalsh(matrices)[:, 0]
    return bool((apart <= ASYMMETRIC * sizes).all() and (least >= -INDEFINITE * sizes).all())


def prepare() -> None:
    """Prepare what fits load when they are first needed."""
    for data in _bases():
        check(data)


TARGETS = (Target("forged", make, check, prepare, ".liaam", 0.1),)
