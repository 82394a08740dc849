"""Lamps as fields on the mean shape: the factor by which each lamp changes the values of an image.

A field is the logarithm of the ratio of the values stored under a lamp and under the training light, on a square around
the mean shape. A piecewise-linear map through the landmarks warps it to an image. Outside the landmarks the map
interpolates towards the square's border, which follows the shape's pose.
"""

import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from liaam.errors import LiaamError, TrainingError
from liaam.io import write_bytes_atomically
from liaam.io.files import count_of, json_object
from liaam.model.file import LAMPS_FORMAT, MAX_LOG_LIGHT
from liaam.model.light_basis import HALF, SIDE, LightBasis, in_field, sample_field
from liaam.model.rounding import rounded
from liaam.model.shape import align
from liaam.model.tensors import Shapes, read_tensors
from liaam.photometry import Response, is_grey
from liaam.photometry.encoding import stored_values
from liaam.photometry.invariant import CHROMATICITY
from liaam.photometry.response import from_linear, linear_to_srgb, srgb_to_linear, to_linear

DARK = 4.0 / 255.0  # Added to stored values before the logarithm, to suppress rounding and noise in dark pixels
GAMMA = 2.2  # Change of the logarithm of light with that of stored sRGB values, on average
# Distances from the mean shape up to which a light basis is sharp, and at which it has faded out; and the standard
# deviation of the blur in between, where surroundings differ from those of the lamps' objects. In diagonals.
SHARP, FADED, SOFTNESS = 0.15, 0.5, 0.15
# Number of modes of a light basis, and standard deviation of the uniform changes of colour that are added to it
MODES, TINT = 16, 0.1
STRIDE = 4  # Spacing of the pixels for which the map is computed; it is interpolated in between

SCHEMA_VERSION = 1

MAKE = "liaam lamps FOLDER -o LAMPS"  # The command that makes a lamp file
MOST = 10_000  # Largest number of lamps in a file


@dataclass(frozen=True, eq=False)
class LearntLamps:
    """Lamps for relighting images of a class of objects.

    Attributes
    ----------
    mean : (n, 2) float64
        Mean shape. The centre of its bounding box is the origin, and the diagonal 1.
    fields : (k, SIDE, SIDE, 3) float16
        Log ratio of stored sRGB values plus 4/255, under each lamp and under the training light, in RGB order.
    names : tuple of str
        Names of the lamps, for display.
    """

    mean: np.ndarray
    fields: np.ndarray
    names: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.fields)

    def __repr__(self) -> str:
        return f"LearntLamps({count_of(len(self), 'lamp')}, {len(self.mean)} landmarks)"

    def check_landmarks(self, n: int, whose: str) -> None:
        """Raise unless the lamps were learnt with n landmarks; ``whose`` names the objects in the message."""
        if n != len(self.mean):
            raise TrainingError(
                f"the lamps were learnt with {len(self.mean)} landmarks, but {whose} have {n}; use lamps learnt with "
                "the same landmarks"
            )

    def relit(self, image: np.ndarray, points: np.ndarray, which, response: Response = "srgb") -> list[np.ndarray]:
        """Relight an image that was taken under the training light.

        Parameters
        ----------
        image : (h, w, 3) uint8, uint16 or float32
        points : (n, 2) float
            Its landmarks.
        which : iterable of int
            Indices of lamps.
        response
            Response of the image's camera.

        Returns
        -------
        list of (h, w, 3) arrays of the image's type
            Relit images as the camera would store them, rounded and clipped.

        Raises
        ------
        TrainingError
            If the lamps were learnt with another number of landmarks.
        """
        self.check_landmarks(len(points), "these images")
        at, values = places(self.mean, points, image.shape[1::-1]), as_srgb(image, response) + np.float32(DARK)
        grey, images = is_grey(image), []
        for i in which:
            field = self.fields[i].astype(np.float32)
            field = field.mean(axis=2, keepdims=True).repeat(3, axis=2) if grey else field
            relit = np.clip(values * cv2.exp(sample_field(field, at)) - np.float32(DARK), 0.0, 1.0)
            if response != "srgb":
                relit = from_linear(srgb_to_linear(relit), response).astype(np.float32)
            if image.dtype.kind != "f":
                relit = np.rint(np.clip(relit, 0.0, 1.0) * np.float32(np.iinfo(image.dtype).max)).astype(image.dtype)
            images.append(relit)
        return images

    def halves(self) -> list[np.ndarray]:
        """Split the lamps into two halves with light as different as possible, such as from the left and the right.

        They are ordered by the strongest mode of their brightness, about the mean. A lamp on several objects, by names
        such as ``object-lamp``, is not split.

        Returns
        -------
        list of (m,) int64
            Indices of each half's lamps; there is only one half of a single lamp.
        """
        lamp_names, lamps = np.unique([name.rpartition("-")[2] for name in self.names], return_inverse=True)
        brightness = self.fields.astype(np.float32).mean(axis=3).reshape(len(self), -1)
        mean = np.array([brightness[lamps == i].mean(axis=0) for i in range(len(lamp_names))])
        away = mean - mean.mean(axis=0)
        along = np.linalg.eigh(away @ away.T)[1][:, -1]
        order = np.argsort(along * (1.0 if along[0] >= 0 else -1.0), kind="stable")
        return [np.flatnonzero(np.isin(lamps, half)) for half in np.array_split(order, min(2, len(order)))]

    def basis(self, mirrored: bool) -> LightBasis:
        """Summarise the lamps, and their mirror images if the objects are symmetric, by a low-rank basis."""
        away = _away_from(self.mean)[..., None]
        sharp, fade = (np.clip((far - away) / (FADED - SHARP), 0.0, 1.0) for far in (2 * SHARP, FADED))
        fade = fade * fade * (3.0 - 2.0 * fade)
        fields = GAMMA * self.fields.astype(np.float32)
        blur = SOFTNESS * SIDE / (2 * HALF)
        fields = np.stack([f * sharp + cv2.GaussianBlur(f, (0, 0), blur) * (1.0 - sharp) for f in fields]) * fade
        fields = np.concatenate([fields, fields[:, :, ::-1]]) if mirrored else fields
        objects = [name.rpartition("-")[0] for name in self.names]
        groups = objects if len(set(objects)) > 1 else list(self.names)
        inside = away[..., 0] <= 0
        rest = _left_out(fields, np.tile(groups, len(fields) // len(groups)), inside)
        remainder = np.sqrt(np.square(rest.mean(axis=3)).mean(axis=0))
        modes = np.concatenate([_modes(fields), TINT * CHROMATICITY[:, None, None] * fade])
        return LightBasis(self.mean, rounded(modes), remainder.astype(np.float16))

    def save(self, path: str | os.PathLike) -> None:
        """Write the lamps as one safetensors file, atomically.

        Raises
        ------
        LiaamError
            If the folder does not exist or cannot be written.
        """
        from safetensors.numpy import save

        header = {"format": LAMPS_FORMAT, "schema": SCHEMA_VERSION, "names": list(self.names)}
        write_bytes_atomically(path, save({"mean": self.mean, "fields": self.fields}, {"liaam": json.dumps(header)}))


def _modes(fields: np.ndarray) -> np.ndarray:
    """Return the strongest modes (k, side, side, 3) of fields (n, side, side, 3), one standard deviation each.

    No mean is subtracted: the training light is the origin.
    """
    flat = fields.reshape(len(fields), -1)
    left = np.linalg.eigh(flat @ flat.T)[1][:, ::-1][:, : min(MODES, (len(flat) + 1) // 2)]
    return (left.T @ flat / np.sqrt(len(flat))).reshape(-1, *fields.shape[1:])


def _left_out(fields: np.ndarray, groups: np.ndarray, inside: np.ndarray) -> np.ndarray:
    """Return what the modes of the other groups do not explain of each field.

    The coordinates are those that fit best ``inside``, because relighting estimates them there.
    """
    rest = fields.copy()
    for group in np.unique(groups):
        in_group = groups == group
        if in_group.all():
            break
        modes = _modes(fields[~in_group])
        near = modes[:, inside].reshape(len(modes), -1)
        coordinates = np.linalg.lstsq(near.T, fields[in_group][:, inside].reshape(in_group.sum(), -1).T, rcond=None)[0]
        rest[in_group] -= np.tensordot(coordinates.T, modes, axes=1)
    return rest


def places(mean: np.ndarray, points: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Return the position in a field of each pixel of an image of a size (width, height), (h, w, 2) float32.

    ``mean`` is the mean shape of the fields, and ``points`` are the landmarks in the image.
    """
    width, height = size
    x, y = np.arange(0, width + STRIDE, STRIDE), np.arange(0, height + STRIDE, STRIDE)
    coarse = np.stack(np.meshgrid(x, y), axis=-1).astype(np.float64)
    positions = in_field(_to_mean(mean, points, coarse))
    across, down = (np.arange(n, dtype=np.float32) / STRIDE for n in size)
    return cv2.remap(positions, *np.meshgrid(across, down), cv2.INTER_LINEAR)


def carried(mean: np.ndarray, fields: np.ndarray, shape: np.ndarray) -> np.ndarray:
    """Carry fields (k, side, side, 3) on a mean shape to the square around another, (k, SIDE, SIDE, 3) float16.

    ``shape`` (n, 2) are the landmarks of the first mean shape in the coordinates of the other.
    """
    at = in_field(_to_mean(mean, shape, square())) * np.float32((fields.shape[1] - 1) / (SIDE - 1))
    x, y, border = at[..., 0], at[..., 1], cv2.BORDER_REPLICATE
    moved = [cv2.remap(field.astype(np.float32), x, y, cv2.INTER_CUBIC, borderMode=border) for field in fields]
    return np.array(moved, np.float16)


def _to_mean(mean: np.ndarray, points: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Map positions (..., 2) in the image of the landmarks ``points`` to the coordinates of the mean shape."""
    from scipy.interpolate import LinearNDInterpolator  # heavy: imported when first needed

    rest, there = anchors(mean, points)
    # Triangulate the image's points, not the mean shape: this cannot fold.
    inside = LinearNDInterpolator(there, rest)(at)
    outside = align(mean, points).inverse()(at.reshape(-1, 2)).reshape(at.shape)
    return np.where(np.isfinite(inside), inside, outside)


def square() -> np.ndarray:
    """Positions of a field's pixels in the coordinates of the mean shape, (SIDE, SIDE, 2) float64."""
    steps = np.linspace(-HALF, HALF, SIDE)
    return np.stack(np.meshgrid(steps, steps), axis=-1)


def _away_from(mean: np.ndarray) -> np.ndarray:
    """Return the distance of a field's pixels from the convex hull of the mean shape, (SIDE, SIDE) float32."""
    step = 2 * HALF / (SIDE - 1)
    outside = np.ones((SIDE, SIDE), np.uint8)
    cv2.fillConvexPoly(outside, cv2.convexHull(np.rint((mean + HALF) / step).astype(np.int32)), 0)
    return cv2.distanceTransform(outside, cv2.DIST_L2, cv2.DIST_MASK_PRECISE) * np.float32(step)


_STEPS, _ENDS = np.linspace(-HALF, HALF, 5), (-HALF, HALF)
# Points on the square's border, (16, 2) float64, which follow the shape's pose
BORDER = np.array([(s, e) for s in _STEPS for e in _ENDS] + [(e, s) for s in _STEPS[1:-1] for e in _ENDS])


def anchors(mean: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Corresponding points (landmarks and border) in the coordinates of the mean shape and of an image."""
    return np.concatenate([mean, BORDER]), np.concatenate([points, align(mean, points)(BORDER)])


def as_srgb(image: np.ndarray, response: Response) -> np.ndarray:
    """Convert an image to sRGB values, (h, w, 3) float32, 0 to 1."""
    stored = stored_values(image)
    return stored if response == "srgb" else linear_to_srgb(to_linear(stored, response)).astype(np.float32)


def load_lamps(path: str | os.PathLike) -> LearntLamps:
    """Read and validate a lamp file.

    Raises
    ------
    LiaamError
        If the file is missing, truncated, inconsistent, or not a lamp file.
    """
    path = Path(path)
    broken = "this is not a complete lamp file ({fault}); copy it again or make it again"
    names, tensors = read_tensors(path, lambda *header: _names(path, *header), LiaamError, "lamp file", MAKE, broken)
    mean, fields = tensors["mean"], tensors["fields"]
    has_types = mean.dtype == np.float64 and fields.dtype == np.float16
    # NaN is not below a limit, either.
    if not has_types or not (np.abs(fields) <= MAX_LOG_LIGHT).all() or not (np.abs(mean) <= 1.0).all():
        raise LiaamError(f"{path}: {_CONTRADICTORY}")
    return LearntLamps(mean, fields, tuple(names))


_CONTRADICTORY = "the lamp file contradicts itself; copy it again or make it again"


def _names(path: Path, text: str, shapes: Shapes) -> list[str]:
    """Read the names of the lamps from a file's header, and check them against the tensors' shapes."""
    header = json_object(text) or {}
    if (header.get("format"), header.get("schema")) != (LAMPS_FORMAT, SCHEMA_VERSION):
        raise LiaamError(f"{path}: this file contains no lamps; make one with '{MAKE}'")
    names: Any = header.get("names")
    are_names = isinstance(names, list) and 1 <= len(names) <= MOST and all(isinstance(name, str) for name in names)
    mean = shapes.get("mean", ())
    is_shape = len(mean) == 2 and mean[0] >= 3 and mean[1] == 2
    if not are_names or not is_shape or shapes.get("fields") != (len(names), SIDE, SIDE, 3):
        raise LiaamError(f"{path}: {_CONTRADICTORY}")
    return names
