"""Inputs of fits: models, cameras, images as arrays, and starts."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator
from copy import deepcopy
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fuzz.mutate import VALUES, Random, one_of, spoilt_json
from fuzz.target import Target
from liaam.errors import LiaamError

METHODS = ("soft-li", "grey", "rgb", "li", "li-pc", "chroma", "grey-norm", "igo", "li+noise", "chroma+huber")

NUMBERS = (
    0.0,
    1.0,
    -1.0,
    np.nan,
    np.inf,
    -np.inf,
    1e30,
    -1e30,
    1e-30,
    1e300,
    -1e300,
    5e-324,
    3e38,
    1e-45,
    0.5,
    2.0**31,
)
"""Replacements for a number in arrays."""

SIZE = (48, 56)


@cache
def tiny() -> Any:
    """Return a complete model of five landmarks, which takes seven points of another landmarker."""
    from liaam.training import train

    rng = np.random.default_rng(0)
    shapes = np.array([[20, 20], [50, 20], [52, 50], [20, 50], [35, 33]]) + rng.normal(0, 1, (6, 5, 2))
    coarse = rng.integers(40, 200, (6, 10, 10, 3), dtype=np.uint8)
    images = [np.kron(each, np.ones((7, 7, 1), np.uint8)) for each in coarse]
    points = np.concatenate([shapes, 0.5 * (shapes[:, :2] + shapes[:, 1:3])], axis=1) + rng.normal(0, 1, (6, 7, 2))
    pairs = zip(images, shapes, strict=True)
    return train(pairs, diagonal=16, variance=0.95, points=points, features=twice, methods="all")


def twice(image: np.ndarray) -> np.ndarray:
    """Return eight channels of an image, one more than a model compares."""
    return np.concatenate([image, np.square(image), image[..., :2]], axis=2)


POINTS = ((12, 12), (40, 12), (42, 40), (12, 42), (26, 26), (27, 12), (41, 26))
"""Points of another landmarker on the small image."""


@cache
def _parts() -> tuple[dict, dict[str, np.ndarray]]:
    """Header and tensors of its file."""
    from safetensors.numpy import load

    data = tiny().to_bytes()
    length = int.from_bytes(data[:8], "little")
    return json.loads(json.loads(data[8 : 8 + length])["__metadata__"]["liaam"]), load(data)


@cache
def _picture() -> np.ndarray:
    coarse = np.random.default_rng(1).integers(40, 200, (12, 14, 3), dtype=np.uint8)
    return np.kron(coarse, np.ones((4, 4, 1), np.uint8))


@cache
def _fitter(method: str) -> Any:
    from liaam.fitting import Fitter

    return Fitter(tiny(), method)


def _number(rng: Random, dtype: np.dtype) -> np.ndarray:
    with np.errstate(all="ignore"):
        return np.array(one_of(rng, NUMBERS)).astype(dtype)


def _fit(model: Any, method: Any, start: Any = (10, 10, 40, 40), **options: Any) -> None:
    """Fit to a small image, which must work for any accepted input."""
    from liaam.fitting import Fitter

    result = Fitter(model, method, **options).fit(_picture(), start)
    json.dumps(result.to_dict(), allow_nan=False).encode()


# Models -------------------------------------------------------------------------------------------


def _places(header: Any, way: tuple = ()) -> Iterator[tuple]:
    inner = header.items() if isinstance(header, dict) else enumerate(header[:4]) if isinstance(header, list) else ()
    for key, value in inner:
        yield (*way, key)
        yield from _places(value, (*way, key))


def _spoil_header(rng: Random, header: dict) -> None:
    *way, last = one_of(rng, list(_places(header)))
    inner: Any = header
    for key in way:
        inner = inner[key]
    if rng.random() < 0.2 and isinstance(inner, dict):
        del inner[last]
        return
    inner[last] = deepcopy(one_of(rng, (*VALUES, *NUMBERS, 60_000, 100, 7, [4.0, 1.0], [10.0], [0.0] * 10, "srgb")))


def _spoil_values(rng: Random, tensor: np.ndarray) -> np.ndarray:
    tensor = tensor.copy()
    if rng.random() < 0.6 and tensor.size:
        tensor.reshape(-1)[rng.integers(tensor.size, size=int(rng.integers(1, 20)))] = _number(rng, tensor.dtype)
        return tensor
    if rng.random() < 0.4:
        return rng.permuted(tensor)
    with np.errstate(all="ignore"):
        return (tensor * 10.0 ** rng.integers(-40, 40)).astype(tensor.dtype)


def _spoil_shape(rng: Random, tensor: np.ndarray) -> np.ndarray:
    if rng.random() < 0.3:
        with np.errstate(all="ignore"):
            return tensor.astype(one_of(rng, (np.float32, np.float64, np.int32, np.uint8, np.float16)))
    if rng.random() < 0.3 or not tensor.ndim:
        return tensor.reshape(-1) if rng.random() < 0.5 else tensor[None]
    if rng.random() < 0.5:
        return tensor[: rng.integers(len(tensor) + 1)]
    return np.repeat(tensor, 1 + min(int(rng.geometric(0.3)), 2_000_000 // max(tensor.nbytes, 1)), axis=0)


def make_model(rng: Random) -> bytes:
    """Make a model file with a few faults in its header or tensors, or sometimes in its bytes."""
    from safetensors.numpy import save

    header, tensors = (deepcopy(_parts()[0]), dict(_parts()[1]))
    for _ in range(int(rng.geometric(0.5)) - (rng.random() < 0.1)):
        if rng.random() < 0.4:
            _spoil_header(rng, header)
            continue
        key = one_of(rng, sorted(tensors))
        tensors[key] = np.ascontiguousarray((_spoil_values if rng.random() < 0.7 else _spoil_shape)(rng, tensors[key]))
        if rng.random() < 0.05:
            del tensors[key]
    try:
        data = bytearray(save(tensors, {"liaam": json.dumps(header)}))
    except (ValueError, RecursionError):  # no writer produces this
        data = bytearray(tiny().to_bytes())
    if rng.random() < 0.1:
        data[int(rng.integers(len(data)))] ^= 1 << int(rng.integers(8))
    return bytes(data[: rng.integers(len(data))] if rng.random() < 0.02 else data)


def check_model(data: bytes) -> None:
    """Read a model. If accepted, fitting and writing it must work."""
    from liaam.errors import MethodError, StartError
    from liaam.fitting import features_method
    from liaam.model import load_model

    path = Path("m.liaam")
    path.write_bytes(data)
    model = load_model(path)
    method = METHODS[len(data) % len(METHODS)]
    tried = (
        ("soft-li", (10, 10, 40, 40)),
        (method, None if len(data) % 8 == 0 else (12, 8, 44, 40)),
        (method, POINTS if model.points is not None and model.points.n_theirs == len(POINTS) else (10, 10, 40, 40)),
        (features_method(twice), (10, 10, 40, 40)),
    )
    for name, start in tried:
        try:
            _fit(model, name, start)
        except (MethodError, StartError):  # the model does not support the method, or maps the points elsewhere
            continue
    model.save(path)
    load_model(path)


def prepare() -> None:
    """Prepare what a fit loads when it is first needed."""
    for method in METHODS:
        _fit(tiny(), method)
        _fit(tiny(), method, None)
    check_model(tiny().to_bytes())


# Cameras ------------------------------------------------------------------------------------------


_CAMERAS = (
    {
        "format": "liaam-camera",
        "version": 1,
        "theta_deg": 121.4,
        "theta_standard_error_deg": 0.2,
        "response": {"stored": [0.05, 0.5, 1.0], "linear": [0.002, 0.2, 1.0]},
        "vignetting": [-0.12, 0.01],
        "noise": {"slope": 1e-4, "offset": 2e-6},
        "history": ["a", "b"],
    },
    {"format": "liaam-camera", "version": 1, "theta_deg": 100, "response": 2.2},
    {
        "format": "liaam-camera",
        "version": 1,
        "theta_deg": -30,
        "response": "linear",
        "noise": {"slope": 0, "offset": 0},
    },
)


def make_camera(rng: Random) -> bytes:
    """Make a camera file with absurd numbers or faulty JSON."""
    if rng.random() < 0.4:
        return spoilt_json(rng, _CAMERAS)
    camera: dict[str, Any] = deepcopy(_CAMERAS[0])
    n = int(rng.integers(2, 7))
    steps = 10.0 ** rng.uniform(-3, one_of(rng, (0.0, 2.0)), (2, n))
    stored = np.sort(10.0 ** -np.cumsum(steps[0]))
    with np.errstate(all="ignore"):
        linear = np.exp(np.cumsum(steps[1] * np.diff(np.log(stored), prepend=0.0)))
    if rng.random() < 0.3:
        linear = np.sort(10.0 ** rng.uniform(-12, 12, n))
    camera["response"] = one_of(
        rng, ({"stored": stored.tolist(), "linear": linear.tolist()}, "srgb", "linear", 0.2, 5.0)
    )
    camera["theta_deg"] = float(rng.uniform(-400, 400))
    camera["vignetting"] = rng.normal(0, one_of(rng, (0.3, 5.0)), int(rng.integers(5))).tolist()
    numbers = (0.0, 1e-300, 1e-5, 0.1, 100.0, 1e3, float("nan"))
    camera["noise"] = one_of(rng, (None, {"slope": one_of(rng, numbers), "offset": one_of(rng, numbers)}))
    return json.dumps(camera).encode()


def check_camera(data: bytes) -> None:
    """Read a camera. If accepted, fitting with it and writing it must work."""
    from liaam.photometry import invariant_image, load_camera

    path = Path("camera.json")
    path.write_bytes(data)
    camera = load_camera(path)
    camera.save(path)
    for i, picture in enumerate((_picture(), _picture().astype(np.float32) / 255)):
        invariant_image(picture, camera)
        _fit(tiny(), METHODS[(len(data) + i) % len(METHODS)], camera=camera)


# Images and starts -------------------------------------------------------------------------------


class Case(NamedTuple):
    """An image, a start, and options."""

    image: Any
    start: Any
    method: str


def make_image(rng: Random) -> Case:
    """Make an array that may not be an image."""
    image = _picture() / 255.0
    for _ in range(int(rng.integers(4))):
        where = rng.random(image.shape[:2]) < one_of(rng, (0.002, 0.1, 0.6, 1.0))
        noise = rng.random((int(where.sum()), 3))
        image[where] = noise if rng.random() < 0.3 else noise[:1] if rng.random() < 0.3 else one_of(rng, NUMBERS)
    kind = one_of(rng, ("u1", "u2", "f4", "f8", "f2", ">f4", "i4", "?", "c8", "u8"))
    if kind in ("u1", "u2"):
        image = np.clip(np.nan_to_num(image), 0, 1) * np.iinfo(kind).max
    with np.errstate(all="ignore"):
        image = image.astype(kind)
    height, width = (int(one_of(rng, (1, 7, 8, 9, 20, 47, 48))) for _ in range(2)) if rng.random() < 0.3 else SIZE
    image = image[:height, :width]
    if rng.random() < 0.2:
        shapes = (
            image[..., 0],
            image[..., :1],
            image[..., :2],
            np.dstack([image, image]),
            image[None],
            image[:0],
            image[0, 0],
        )
        image = one_of(rng, shapes)
    if rng.random() < 0.1:
        image = image[::-1, ::-1] if image.ndim > 1 else image
    start = one_of(rng, ((10, 10, 40, 40), (1, 1, 6, 6), (20.0, 20.0, 30.0), None))
    return Case(image, start, one_of(rng, METHODS))


def make_start(rng: Random) -> Case:
    """Make a start that may be invalid."""
    kind, model = int(rng.integers(6)), tiny()
    shape = model.shape_model.mean + np.array([25, 22])
    start: Any = one_of(
        rng, (None, "box", 7, [], {}, np.zeros((0, 2)), np.zeros((5, 3)), np.zeros((3, 2)), b"", [[1], [2, 3]])
    )
    if kind == 1:
        start = tuple(rng.normal(25, one_of(rng, (5.0, 30.0, 1e6, 1e200)), 4))
    elif kind == 2:
        start = (
            *rng.normal(25, one_of(rng, (5.0, 100.0)), 2),
            10.0 ** rng.uniform(-300, 300) if rng.random() < 0.4 else 25.0,
        )
    elif kind >= 3:
        start = shape * 10.0 ** rng.uniform(-0.5, 0.5) if rng.random() < 0.5 else shape + rng.normal(0, 30, shape.shape)
        for _ in range(int(rng.integers(4))):
            start[rng.integers(len(start)), rng.integers(2)] = one_of(rng, NUMBERS)
        if rng.random() < 0.2:
            start = one_of(
                rng, (start[:1].repeat(5, 0), start * [1, 0], start[::-1], start.tolist(), start.astype("f4"))
            )
    return Case(_picture(), start, one_of(rng, METHODS))


def check_fit(case: Case) -> None:
    """Fit an image."""
    result = _fitter(case.method).fit(case.image, case.start)
    json.dumps(result.to_dict(), allow_nan=False).encode()


# Loops over pixels --------------------------------------------------------------------------------


def make_loops(rng: Random) -> tuple[int, np.ndarray]:
    """Make the number of an operation, and an image for it."""
    image = make_image(rng).image
    return int(rng.integers(2**31)), image


def check_loops(case: tuple[int, np.ndarray]) -> None:
    """Call the wrappers of compiled loops with sizes and numbers of any kind."""
    from liaam import _core
    from liaam.fitting import find
    from liaam.model.sampling import make_patch, sample_texture
    from liaam.model.shape import Similarity
    from liaam.photometry import encode, invariant_image, noise_deviation
    from liaam.photometry.encoding import ENCODINGS, as_colour

    rng, image = np.random.default_rng(case[0]), as_colour(case[1], "image")
    encoding, reduce = one_of(rng, (*ENCODINGS, "else")), float(one_of(rng, (1.0, 1.5, 2.0, 3.7)))
    with np.errstate(all="ignore"):
        encode(image, encoding, one_of(rng, ("srgb", "linear", 0.2, 5.0)), one_of(rng, (0.0, 0.3, 4.0)), reduce)
        noise_deviation(image)
        grey = image.mean(axis=2).astype(np.float32)
        _core.area_means(grey, int(rng.integers(1, len(grey) + 1)), int(rng.integers(1, grey.shape[1] + 1)))
        _core.best_peaks(grey, int(rng.integers(1, 9)), float(one_of(rng, NUMBERS)), int(rng.integers(0, 99)))
        pose = Similarity(np.eye(2) * 10.0 ** rng.uniform(-1, 2), rng.normal(20, 20, 2))
        shape = rng.normal(20, 10.0 ** rng.uniform(0, 4), (5, 2))
        patch = make_patch(image, shape, pose, encoding=encoding, response="srgb", blur=1.0, margin=0.3)
        points = rng.normal(20, 10.0 ** rng.uniform(0, 30), (50, 2))
        points[rng.integers(50, size=5)] = one_of(rng, NUMBERS)
        sample_texture(patch, points)
        if rng.random() < 0.2:
            invariant_image(image)
            find(tiny(), image)


def _prepare_loops() -> None:
    prepare()
    for i in range(40):
        with contextlib.suppress(LiaamError):
            check_loops((i, _picture()))


TARGETS = (
    Target("models", make_model, check_model, prepare, ".liaam", 0.1),
    Target("cameras", make_camera, check_camera, prepare, ".json", 0.1),
    Target("images", make_image, check_fit, prepare, ".txt", 0.2),
    Target("starts", make_start, check_fit, prepare, ".txt", 0.2),
    Target("loops", make_loops, check_loops, _prepare_loops, ".txt", 0.2),
)
