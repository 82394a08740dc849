"""The active appearance model: one frozen object, one safetensors file."""

import json
import os
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from liaam.appearance import CHANNELS, SURROUNDED, AppearanceModel
from liaam.errors import LiaamError, ModelFileError
from liaam.mesh import ReferenceFrame, signed_areas
from liaam.photometry import CameraModel, Response, camera_from, describe_response, parse_response
from liaam.shape import ShapeModel, diagonal_of
from liaam.warp import PiecewiseAffineWarp, surrounded_warp

SCHEMA_VERSION = 2
"""Version of the model file; raised whenever its meaning changes."""

MAX_DIAGONAL = 2000.0
"""Largest reference frame, pixels: a larger one is a forged file or a slip of the pen."""

FORMAT = "liaam-aam"


LITTLE = 2 / 3
"""Share of the log odds at :attr:`Reliability.ordinary` that are little. Measured on strangers of IMM, 924 fits under
four lamps, models with an ordinary quality of 0.90: all 34 fits that end in a wrong place for want of a better start
have less than 0.815, and no right one has less than 0.84; two thirds of the log odds is 0.816."""


@dataclass(frozen=True, eq=False)
class Level:
    """The model's appearance at one sharpness; a fit goes from the blurred levels to the sharp one.

    Attributes
    ----------
    blur : float
        Standard deviation of the Gaussian blur of the encoded images, pixels of the reference frame.
    appearances : dict of str to AppearanceModel
        By name of :data:`liaam.appearance.CHANNELS`, all on the same pixels. ``invariant`` is absent from
        a model trained on grey pictures; ``varied`` and ``illumination`` from one trained under one light.
    """

    blur: float
    appearances: dict[str, AppearanceModel]


@dataclass(frozen=True, eq=False)
class Reliability:
    """What fits of the default method to pictures left out of training tell of those to come.

    Attributes
    ----------
    landmarks : (n, 2, 2) float64
        Covariance of each landmark beyond what a fit states of itself, square pixels of the reference frame.
    weights : (3,) float64
        Log odds that a fit is right: of 1, of the share of the picture it explains, and of its shape's strangeness.
    understated : float
        How many times the variances of a fit's parameters are what it states of itself, at least 1: shapes and
        appearances that the model lacks move the others, too.
    ordinary : float
        Quality that nearly all right fits have: 5 % of those to left-out pictures have less.
    """

    landmarks: np.ndarray
    weights: np.ndarray
    understated: float
    ordinary: float = 0.5

    @property
    def little(self) -> float:
        """Quality far below the ordinary: that of :data:`LITTLE` of its log odds."""
        odds = np.log(max(self.ordinary, 1e-9)) - np.log(max(1.0 - self.ordinary, 1e-9))
        return float(1.0 / (1.0 + np.exp(-LITTLE * odds)))

    def quality(self, evidence: np.ndarray) -> float:
        """Probability, 0 to 1, that a fit of some evidence (2,) is right, where right and wrong are as likely."""
        odds = self.weights[0] + self.weights[1:] @ evidence
        return float(1.0 / (1.0 + np.exp(-np.clip(odds, -50.0, 50.0)))) if np.isfinite(odds) else 0.0


@dataclass(frozen=True, eq=False)
class AAM:
    """An active appearance model.

    Attributes
    ----------
    shape_model : ShapeModel
        Shapes in pixels of the reference frame.
    triangles : (t, 3) int32
        The mesh.
    levels : tuple of Level
        Appearance from coarse to fine.
    camera : CameraModel
        The training camera.
    n_images : int
        Number of training images.
    contours : tuple of (indices, closed)
        Lines between landmarks, for drawing.
    name : str
        What the model was trained on, for people.
    soft_levels : tuple of Level
        The ``soft`` appearance, coarse to fine, on the pixels of ``surrounded``; none in files of earlier versions.
    reliability : Reliability, optional
        What tells right fits from wrong ones, where training has found out.
    soft_shape : ShapeModel, optional
        Shapes as ``soft`` appearances are fitted with, about the same mean; ``shape_model`` if there is none.
    """

    shape_model: ShapeModel
    triangles: np.ndarray
    levels: tuple[Level, ...]
    camera: CameraModel
    n_images: int
    contours: tuple[tuple[tuple[int, ...], bool], ...] = ()
    name: str = ""
    soft_levels: tuple[Level, ...] = ()
    reliability: Reliability | None = None
    soft_shape: ShapeModel | None = None

    def __repr__(self) -> str:
        return f"AAM({self.name!r}, {self.n_points} landmarks, {self.n_pixels} pixels, {self.n_images} images)"

    @property
    def theta(self) -> float:
        """Angle of the training camera (theta_1 of the paper), radians."""
        return self.camera.theta

    @property
    def response(self) -> Response:
        """Response of the training camera."""
        return self.camera.response

    @cached_property
    def frame(self) -> ReferenceFrame:
        """Pixels of the mean shape."""
        return ReferenceFrame(self.shape_model.mean, self.triangles)

    @cached_property
    def warp(self) -> PiecewiseAffineWarp:
        """Piecewise-affine warp of the mesh under the shape model."""
        return PiecewiseAffineWarp(self.frame, self.shape_model)

    @cached_property
    def surrounded(self) -> PiecewiseAffineWarp:
        """Warp of the mesh and what surrounds it; its ``frame`` has the pixels of ``soft`` appearances."""
        return surrounded_warp(self.shape_of("soft"), self.triangles)

    def levels_of(self, appearance: str) -> tuple[Level, ...]:
        """Levels that hold an appearance, coarse to fine."""
        return self.soft_levels if appearance in SURROUNDED else self.levels

    def shape_of(self, appearance: str) -> ShapeModel:
        """Shapes that an appearance is fitted with."""
        own = self.soft_shape if appearance in SURROUNDED else None
        return self.shape_model if own is None else own

    def warp_of(self, appearance: str) -> PiecewiseAffineWarp:
        """Warp whose pixels an appearance lives on."""
        return self.surrounded if appearance in SURROUNDED else self.warp

    @property
    def n_points(self) -> int:
        """Number of landmarks."""
        return self.shape_model.n_points

    @property
    def n_pixels(self) -> int:
        """Number of pixels of the reference frame inside the mesh."""
        return self.frame.n_pixels

    @property
    def diagonal(self) -> float:
        """Diagonal of the mean shape's bounding box, pixels of the reference frame."""
        return diagonal_of(self.shape_model.mean)

    @property
    def is_colour(self) -> bool:
        """Whether the model was trained on colour pictures."""
        return "invariant" in self.levels[-1].appearances

    def save(self, path: str | os.PathLike) -> None:
        """Write the model as one safetensors file, atomically.

        Raises
        ------
        ModelFileError
            If the folder does not exist or cannot be written.
        """
        from liaam.io import write_bytes_atomically

        write_bytes_atomically(path, self.to_bytes(), ModelFileError)

    def to_bytes(self) -> bytes:
        """What a model file holds."""
        from safetensors.numpy import save

        return save(_tensors(self), {"liaam": json.dumps(_header(self))})


def _header(model: AAM) -> dict:
    return {
        "format": FORMAT,
        "schema": SCHEMA_VERSION,
        "theta": model.theta,
        "response": describe_response(model.response),
        "camera": model.camera.describe(),
        "blurs": [level.blur for level in model.levels],
        "soft_blurs": [level.blur for level in model.soft_levels],
        "n_images": model.n_images,
        "n_pixels": model.n_pixels,
        "contours": [[list(indices), closed] for indices, closed in model.contours],
        "name": model.name,
        **{f"{key}_freedom": shape.freedom for key, shape in _shapes(model).items() if np.isfinite(shape.freedom)},
    }


def _shapes(model: AAM) -> dict[str, ShapeModel]:
    """Shape models by their key in the file."""
    own = {} if model.soft_shape is None else {"soft_shape": model.soft_shape}
    return {"shape": model.shape_model, **own}


def _tensors(model: AAM) -> dict[str, np.ndarray]:
    tensors = {"shape.mean": model.shape_model.mean, "triangles": model.triangles}
    for key, shape in _shapes(model).items():
        for field in ("modes", "eigenvalues", "unexplained"):
            if getattr(shape, field) is not None:
                tensors[f"{key}.{field}"] = getattr(shape, field)
    if model.reliability is not None:
        tensors["reliability.landmarks"] = model.reliability.landmarks
        tensors["reliability.weights"] = model.reliability.weights
        tensors["reliability.understated"] = np.array([model.reliability.understated])
        tensors["reliability.ordinary"] = np.array([model.reliability.ordinary])
    for prefix, levels in (("level", model.levels), ("soft_level", model.soft_levels)):
        for i, level in enumerate(levels):
            for name, appearance in level.appearances.items():
                for field in ("mean", "modes", "eigenvalues", "usable", "unexplained"):
                    if getattr(appearance, field) is not None:
                        tensors[f"{prefix}{i}.{name}.{field}"] = getattr(appearance, field)
    return {key: np.ascontiguousarray(value) for key, value in tensors.items()}


def load_model(path: str | os.PathLike) -> AAM:
    """Read a model file, checking all of it. Nothing in the file is ever run.

    Raises
    ------
    ModelFileError
        If the file is missing, cut short, forged, of another version, or no liaam model.
    """
    path = Path(path)
    header, tensors = _read(path)
    try:
        model = _build(header, tensors)
    except (KeyError, TypeError, ValueError, IndexError, OverflowError, LiaamError) as error:
        raise ModelFileError(f"{path}: the model file contradicts itself ({error}); train the model again") from error
    return model


def _read(path: Path) -> tuple[dict, dict[str, np.ndarray]]:
    """Header and tensors of a file; sizes are checked by safetensors against the file's own length."""
    from safetensors import SafetensorError, safe_open

    if not path.is_file():
        what = "is a folder" if path.is_dir() else "does not exist"
        raise ModelFileError(f"{path}: the model file {what}; make one with 'liaam train FOLDER -o MODEL'")
    try:
        with safe_open(path, framework="numpy") as file:
            header = _checked_header(path, (file.metadata() or {}).get("liaam", ""))
            return header, {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118 (no mapping)
    except (
        SafetensorError,
        AttributeError,
        TypeError,
    ) as error:  # the last two: number types that numpy lacks
        raise ModelFileError(
            f"{path}: this is no complete liaam model ({error}); it may be cut short or of another kind: "
            "copy it again or train it again"
        ) from error
    except OSError as error:
        raise ModelFileError(f"{path}: the model file cannot be read ({error.strerror or error})") from error


def _checked_header(path: Path, text: str) -> dict:
    try:
        header = json.loads(text)
    except (ValueError, RecursionError):
        header = None
    if not isinstance(header, dict) or header.get("format") != FORMAT:
        raise ModelFileError(f"{path}: this safetensors file is no liaam model; make one with 'liaam train'")
    if header.get("schema") != SCHEMA_VERSION:
        raise ModelFileError(
            f"{path}: the model has schema version {header.get('schema')}, this liaam reads version {SCHEMA_VERSION}; "
            "train the model again, or use the liaam that wrote it"
        )
    return header


def _build(header: dict, tensors: dict[str, np.ndarray]) -> AAM:
    mean = _tensor(tensors, "shape.mean", np.float64, (None, 2))
    n = len(mean)
    triangles = _tensor(tensors, "triangles", np.int32, (None, 3))
    if n < 3 or not len(triangles) or triangles.min() < 0 or triangles.max() >= n:
        raise ValueError("the mesh does not belong to the landmarks")
    # The mean is centred, so that no coordinate exceeds the diagonal; differences of larger ones might overflow.
    if np.abs(mean).max() > MAX_DIAGONAL or not 8.0 <= diagonal_of(mean) <= MAX_DIAGONAL:
        raise ValueError(f"a reference frame of no sensible size (8 to {MAX_DIAGONAL:.0f} pixels)")
    area = float(np.abs(signed_areas(mean, triangles)).sum())
    if len(triangles) > 2 * n or area > 1.001 * float(np.prod(np.ptp(mean, axis=0))):
        raise ValueError("the mesh overlaps itself")
    frame = ReferenceFrame(mean, triangles)
    if frame.n_pixels != header["n_pixels"]:
        raise ValueError("its reference frame does not match its pixels")
    shape_model = _shape_model(header, tensors, "shape", mean)
    return AAM(
        shape_model=shape_model,
        soft_shape=_shape_model(header, tensors, "soft_shape", mean) if "soft_shape.modes" in tensors else None,
        triangles=triangles,
        levels=tuple(_level(tensors, i, blur, frame.n_pixels) for i, blur in enumerate(_blurs(header["blurs"]))),
        soft_levels=_soft_levels(tensors, header.get("soft_blurs", []), shape_model, triangles),
        reliability=_reliability(tensors, n),
        camera=_camera(header),
        n_images=int(header["n_images"]),
        contours=_contours(header["contours"], n),
        name=str(header["name"]),
    )


def _shape_model(header: dict, tensors: dict[str, np.ndarray], key: str, mean: np.ndarray) -> ShapeModel:
    """One of the shape models, about the mean of all."""
    n = len(mean)
    modes = _tensor(tensors, f"{key}.modes", np.float64, (None, 2 * n))
    eigenvalues = _tensor(tensors, f"{key}.eigenvalues", np.float64, (len(modes),))
    unexplained = None  # absent from files of earlier versions
    if f"{key}.unexplained" in tensors:
        unexplained = _tensor(tensors, f"{key}.unexplained", np.float64, (n, 2, 2))
        if (np.diagonal(unexplained, axis1=1, axis2=2) < 0).any():
            raise ValueError(f"{key}.unexplained has variances below 0")
    freedom = _finite(header[f"{key}_freedom"]) if f"{key}_freedom" in header else np.inf
    if not freedom > 0:
        raise ValueError(f"{key}_freedom {freedom:g}")
    return ShapeModel(mean, modes, eigenvalues, unexplained, freedom)


def _camera(header: dict) -> CameraModel:
    """The training camera; files of earlier versions know its angle and response only."""
    known = camera_from(header["camera"]) if "camera" in header else CameraModel()
    # The angle itself, to the last digit, is what the appearance was learnt with.
    return replace(known, theta=_finite(header["theta"]), response=parse_response(header["response"]))


def _blurs(blurs: list) -> list[float]:
    blurs = [_finite(blur) for blur in blurs]
    if not 1 <= len(blurs) <= 10 or not all(0 <= blur <= 100 for blur in blurs):
        raise ValueError(f"blurs {blurs}")
    return blurs


def _level(tensors: dict[str, np.ndarray], i: int, blur: float, n_pixels: int) -> Level:
    names = [name for name in CHANNELS if f"level{i}.{name}.mean" in tensors]
    if "value" not in names or "log" not in names:
        raise ValueError("an appearance is missing")
    return Level(blur, {name: _appearance(tensors, f"level{i}.{name}", name, n_pixels) for name in names})


def _reliability(tensors: dict[str, np.ndarray], n: int) -> Reliability | None:
    if "reliability.weights" not in tensors:
        return None
    landmarks = _tensor(tensors, "reliability.landmarks", np.float64, (n, 2, 2))
    if (np.diagonal(landmarks, axis1=1, axis2=2) < 0).any():
        raise ValueError("reliability.landmarks has variances below 0")
    understated = float(_tensor(tensors, "reliability.understated", np.float64, (1,))[0])
    if understated < 1.0:
        raise ValueError("reliability.understated is below 1")
    weights = _tensor(tensors, "reliability.weights", np.float64, (3,))
    if "reliability.ordinary" not in tensors:  # files of earlier versions
        return Reliability(landmarks, weights, understated)
    ordinary = float(_tensor(tensors, "reliability.ordinary", np.float64, (1,))[0])
    if not 0.0 <= ordinary <= 1.0:
        raise ValueError("reliability.ordinary is no probability")
    return Reliability(landmarks, weights, understated, ordinary)


def _soft_levels(
    tensors: dict[str, np.ndarray], blurs: list, shape_model: ShapeModel, triangles: np.ndarray
) -> tuple[Level, ...]:
    """Levels of the ``soft`` appearance; none in files of earlier versions."""
    if not blurs:
        return ()
    n_pixels = surrounded_warp(shape_model, triangles).frame.n_pixels
    return tuple(
        Level(blur, {"soft": _appearance(tensors, f"soft_level{i}.soft", "soft", n_pixels)})
        for i, blur in enumerate(_blurs(blurs))
    )


def _appearance(tensors: dict[str, np.ndarray], prefix: str, name: str, n_pixels: int) -> AppearanceModel:
    channels = CHANNELS[name]
    modes = _tensor(tensors, f"{prefix}.modes", np.float32, (None, n_pixels, channels))
    unexplained = None  # absent from an illumination basis and from the files of earlier versions
    if f"{prefix}.unexplained" in tensors:
        unexplained = _tensor(tensors, f"{prefix}.unexplained", np.float32, (n_pixels, channels, channels))
        if (np.diagonal(unexplained, axis1=1, axis2=2) < 0).any():
            raise ValueError(f"{prefix}.unexplained has variances below 0")
    return AppearanceModel(
        mean=_tensor(tensors, f"{prefix}.mean", np.float32, (n_pixels, channels)),
        modes=modes,
        eigenvalues=_tensor(tensors, f"{prefix}.eigenvalues", np.float64, (len(modes),)),
        usable=_tensor(tensors, f"{prefix}.usable", np.float32, (n_pixels,)),
        unexplained=unexplained,
    )


def _tensor(tensors: dict[str, np.ndarray], key: str, dtype: type, shape: tuple) -> np.ndarray:
    tensor = tensors[key]
    fits = tensor.ndim == len(shape) and all(
        want in (None, have) for want, have in zip(shape, tensor.shape, strict=True)
    )
    if tensor.dtype != dtype or not fits:
        raise ValueError(f"{key} has type {tensor.dtype} and shape {tensor.shape}")
    if tensor.dtype.kind == "f" and not np.isfinite(tensor).all():
        raise ValueError(f"{key} has values that are not numbers")
    if (key.endswith(("eigenvalues", "usable")) and (tensor < 0).any()) or (
        key.endswith("usable") and (tensor > 1).any()
    ):
        raise ValueError(f"{key} has values out of range")
    return tensor


def _finite(value: float) -> float:
    if not np.isfinite(value):
        raise ValueError(f"{value} is not a finite number")
    return float(value)


def _contours(rows: list, n: int) -> tuple[tuple[tuple[int, ...], bool], ...]:
    contours = tuple((tuple(int(i) for i in indices), bool(closed)) for indices, closed in rows)
    if any(not 0 <= i < n for indices, _ in contours for i in indices):
        raise ValueError("a contour names a landmark that does not exist")
    return contours
