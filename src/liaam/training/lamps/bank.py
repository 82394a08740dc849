"""Lamps as fields on the mean shape: the factor by which each lamp changes the values of an image.

A field is the logarithm of the ratio of the values stored under a lamp and under the training light, on a square around
the mean shape. A piecewise-linear map through the landmarks warps it to an image. Outside the landmarks the map
interpolates towards the square's border, which follows the shape's pose.
"""

import json
import os
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from liaam.distance_transform import distance_transform
from liaam.errors import LiaamError, TrainingError
from liaam.io import write_bytes_atomically
from liaam.io.files import count_of, json_object
from liaam.model.file_format import LAMPS_FORMAT, MAX_LOG_LIGHT
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
# A light basis is blurred and fades out around the mean shape, where surroundings differ from those of the lamps'
# objects. In diagonals:
SHARP = 0.15  # Distance from the mean shape up to which it does not fade; from twice that on, it is only blurred
FADED = 0.5  # Distance at which it has faded out
SOFTNESS = 0.15  # Standard deviation of the blur
MODES = 16  # Largest number of modes of a light basis
TINT = 0.1  # Standard deviation of the uniform changes of colour that are added to it
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
        at = places(self.mean, points, image.shape[1::-1])
        values = as_srgb(image, response) + np.float32(DARK)
        grey = is_grey(image)
        images = []
        for i in which:
            field = self.fields[i].astype(np.float32)
            if grey:
                field = field.mean(axis=2, keepdims=True).repeat(3, axis=2)
            relit = np.clip(values * cv2.exp(sample_field(field, at)) - np.float32(DARK), 0.0, 1.0)
            images.append(_stored(relit, response, image.dtype))
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
        names = [name.rpartition("-")[2] for name in self.names]  # without the objects
        unique_names, lamps = np.unique(names, return_inverse=True)
        brightness = self.fields.astype(np.float32).mean(axis=3).reshape(len(self), -1)
        mean_of_lamps = np.array([brightness[lamps == i].mean(axis=0) for i in range(len(unique_names))])
        deviations = mean_of_lamps - mean_of_lamps.mean(axis=0)
        _, vectors = np.linalg.eigh(deviations @ deviations.T)
        coordinates = vectors[:, -1]  # along the strongest mode, up to a factor
        sign = 1.0 if coordinates[0] >= 0 else -1.0  # that of an eigenvector is arbitrary
        order = np.argsort(coordinates * sign, kind="stable")
        return [np.flatnonzero(np.isin(lamps, half)) for half in np.array_split(order, min(2, len(order)))]

    def basis(self, mirrored: bool) -> LightBasis:
        """Summarise the lamps, and their mirror images if the objects are symmetric, by a low-rank basis."""
        distances = _away_from(self.mean)
        fade = _fade(distances)
        fields = _softened(GAMMA * self.fields.astype(np.float32), distances) * fade
        objects = [name.rpartition("-")[0] for name in self.names]
        groups = np.array(objects if len(set(objects)) > 1 else self.names)
        parts = _parts(fields, mirrored)
        remainder = _left_out(fields, parts, groups, inside=distances <= 0)
        tints = TINT * CHROMATICITY[:, None, None] * fade
        modes = np.concatenate([_modes(parts, np.ones(len(fields), bool)), tints])
        return LightBasis(self.mean, rounded(modes), remainder.astype(np.float16))

    def save(self, path: str | os.PathLike) -> None:
        """Write the lamps as one safetensors file, atomically.

        Raises
        ------
        LiaamError
            If the folder does not exist or cannot be written.
        """
        from safetensors.numpy import save

        tensors = {"mean": self.mean, "fields": self.fields}
        header = {"format": LAMPS_FORMAT, "schema": SCHEMA_VERSION, "names": list(self.names)}
        write_bytes_atomically(path, save(tensors, {"liaam": json.dumps(header)}))


def _stored(srgb: np.ndarray, response: Response, dtype: np.dtype) -> np.ndarray:
    """Convert sRGB values (h, w, 3) float32 in [0, 1] to values that a camera stores, of a type."""
    stored = srgb
    if response != "srgb":
        stored = from_linear(srgb_to_linear(srgb), response).astype(np.float32)
    if dtype.kind == "f":
        return stored
    white = np.float32(np.iinfo(dtype).max)
    return np.rint(np.clip(stored, 0.0, 1.0) * white).astype(dtype)


def _fade(distances: np.ndarray) -> np.ndarray:
    """Return the factor on a light basis at distances (side, side) from the mean shape, (side, side, 1), 1 to 0."""
    linear = np.clip((FADED - distances[..., None]) / (FADED - SHARP), 0.0, 1.0)
    return linear * linear * (3.0 - 2.0 * linear)


def _softened(fields: np.ndarray, distances: np.ndarray) -> np.ndarray:
    """Blur fields (k, side, side, 3) float32 the more, the farther they are from the mean shape."""
    sharp = np.clip((2 * SHARP - distances[..., None]) / (FADED - SHARP), 0.0, 1.0)
    blur = SOFTNESS * SIDE / (2 * HALF)  # pixels of a field
    softened = []
    for field in fields:
        soft = cv2.GaussianBlur(field, (0, 0), blur)
        softened.append(field * sharp + soft * (1.0 - sharp))
    return np.stack(softened)


@dataclass(frozen=True, eq=False)
class _Part:
    """A part of each field, such that the modes of all fields are those of the parts.

    If the objects are symmetric, a field and its mirror image have the same even part and opposite odd parts, so that
    each mode of fields and mirror images is even or odd. Their left half says all of such parts.
    """

    values: np.ndarray  # (n, side, columns, 3) float32; inner products are those of the parts on the whole square
    sign: int  # of the right half, mirrored, by the left half: 1 if even, -1 if odd; 0 for whole fields
    gram: np.ndarray  # (n, n), the inner products

    @classmethod
    def of(cls, values: np.ndarray, sign: int) -> "_Part":
        flat = values.reshape(len(values), -1)
        return cls(values, sign, flat @ flat.T)

    def whole(self, values: np.ndarray) -> np.ndarray:
        """Return parts (k, side, columns, 3) on the whole square."""
        if not self.sign:
            return values
        left = values / np.sqrt(np.float32(2.0))
        return np.concatenate([left, self.sign * left[:, :, ::-1]], axis=2)


def _parts(fields: np.ndarray, mirrored: bool) -> list[_Part]:
    """Split fields (n, side, side, 3) and their mirror images into even and odd parts; without these, do not split."""
    if not mirrored:
        return [_Part.of(fields, 0)]
    left, right = np.split(fields, 2, axis=2)
    scale = np.sqrt(np.float32(0.5))
    return [_Part.of(scale * (left + sign * right[:, :, ::-1]), sign) for sign in (1, -1)]


def _modes(parts: list[_Part], which: np.ndarray) -> np.ndarray:
    """Return the strongest modes (k, side, side, 3) of some of the fields, and their mirror images if they have parts.

    Each is one standard deviation, the strongest first. ``which`` (n,) bool chooses among the fields. No mean is
    subtracted: the training light is the origin.
    """
    from scipy.linalg import eigh  # heavy: imported when first needed

    n_chosen = int(which.sum())
    n_modes = min(MODES, (len(parts) * n_chosen + 1) // 2)
    last = [max(0, n_chosen - n_modes), n_chosen - 1]
    found = [eigh(part.gram[np.ix_(which, which)], subset_by_index=last) for part in parts]
    variances = np.concatenate([values for values, _ in found])
    least = np.sort(variances)[-n_modes]
    strengths = []
    modes = []
    for part, (values, vectors) in zip(parts, found, strict=True):
        is_strong = values >= least
        weights = np.zeros((int(is_strong.sum()), len(which)), np.float32)
        weights[:, which] = vectors[:, is_strong].T / np.sqrt(n_chosen)
        flat = weights @ part.values.reshape(len(which), -1)
        modes.append(part.whole(flat.reshape(-1, *part.values.shape[1:])))
        strengths.append(values[is_strong])
    order = np.argsort(-np.concatenate(strengths), kind="stable")[:n_modes]
    return np.concatenate(modes)[order]


def _left_out(fields: np.ndarray, parts: list[_Part], groups: np.ndarray, inside: np.ndarray) -> np.ndarray:
    """Return the root mean square (side, side) of what the modes of the other groups do not explain of each field.

    It is that of the mean of the colours, also of the mirror images. The coordinates are those that fit best ``inside``
    (side, side), because relighting estimates them there.
    """
    squares = np.zeros(fields.shape[1:3])
    thirds = np.full(3, 1.0 / 3.0, np.float32)  # a product takes a twentieth of the time of a mean of three
    for group in np.unique(groups):
        in_group = groups == group
        rest = fields[in_group]
        if len(parts) > 1:
            rest = np.concatenate([rest, rest[:, :, ::-1]])
        if not in_group.all():
            modes = _modes(parts, ~in_group)
            modes_inside = modes[:, inside].reshape(len(modes), -1)
            rest_inside = rest[:, inside].reshape(len(rest), -1)
            coordinates = np.linalg.lstsq(modes_inside.T, rest_inside.T, rcond=None)[0]
            rest = rest - np.tensordot(coordinates.T, modes, axes=1)
        squares += np.square(rest @ thirds).sum(axis=0)
    return np.sqrt(squares / (len(parts) * len(fields)))


def places(mean: np.ndarray, points: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Return the position in a field of each pixel of an image of a size (width, height), (h, w, 2) float32.

    ``mean`` is the mean shape of the fields, and ``points`` are the landmarks in the image.
    """
    width, height = size
    x = np.arange(0, width + STRIDE, STRIDE)
    y = np.arange(0, height + STRIDE, STRIDE)
    coarse = np.stack(np.meshgrid(x, y), axis=-1).astype(np.float64)
    coarse_positions = in_field(_to_mean(mean, points, coarse))
    columns = np.arange(width, dtype=np.float32) / STRIDE
    rows = np.arange(height, dtype=np.float32) / STRIDE
    return cv2.remap(coarse_positions, *np.meshgrid(columns, rows), cv2.INTER_LINEAR)


def carried(mean: np.ndarray, fields: np.ndarray, shape: np.ndarray) -> np.ndarray:
    """Carry fields (k, side, side, 3) on a mean shape to the square around another, (k, SIDE, SIDE, 3) float16.

    ``shape`` (n, 2) are the landmarks of the first mean shape in the coordinates of the other.
    """
    pixels_per_pixel = np.float32((fields.shape[1] - 1) / (SIDE - 1))  # of the given fields, per one of a new field
    at = in_field(_to_mean(mean, shape, square())) * pixels_per_pixel
    x = at[..., 0]
    y = at[..., 1]
    moved = []
    for field in fields:
        field = field.astype(np.float32)
        moved.append(cv2.remap(field, x, y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE))
    return np.array(moved, np.float16)


def _to_mean(mean: np.ndarray, points: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Map positions (..., 2) in the image of the landmarks ``points`` to the coordinates of the mean shape."""
    from scipy.interpolate import LinearNDInterpolator  # heavy: imported when first needed

    on_mean, in_image = anchors(mean, points)
    # Triangulate the image's points, not the mean shape: this cannot fold.
    inside = LinearNDInterpolator(in_image, on_mean)(at)  # NaN outside the border
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
    return distance_transform(outside) * np.float32(step)


def _border() -> np.ndarray:
    """Return five points on each side of the square, with its corners, (16, 2) float64."""
    steps = np.linspace(-HALF, HALF, 5)
    ends = (-HALF, HALF)
    top_and_bottom = [(step, end) for step in steps for end in ends]
    left_and_right = [(end, step) for step in steps[1:-1] for end in ends]  # the corners are above
    return np.array(top_and_bottom + left_and_right)


BORDER = _border()  # Points that follow the shape's pose


def anchors(mean: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Corresponding points, landmarks and border, (n + 16, 2) each: on the mean shape, and in an image."""
    border = align(mean, points)(BORDER)
    return np.concatenate([mean, BORDER]), np.concatenate([points, border])


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
    names, tensors = read_tensors(path, partial(_names, path), LiaamError, "lamp file", MAKE, broken)
    mean = tensors["mean"]
    fields = tensors["fields"]
    has_types = mean.dtype == np.float64 and fields.dtype == np.float16
    # NaN is not below a limit, either.
    if not has_types or not (np.abs(fields) <= MAX_LOG_LIGHT).all() or not (np.abs(mean) <= 1.0).all():
        raise LiaamError(f"{path}: {_CONTRADICTORY}")
    return LearntLamps(mean, fields, tuple(names))


_CONTRADICTORY = "the lamp file contradicts itself; copy it again or make it again"


def _names(path: Path, text: str, shapes: Shapes) -> list[str]:
    """Read the names of the lamps from a file's header, and check them against the tensors' shapes."""
    header = json_object(text) or {}
    if header.get("format") != LAMPS_FORMAT or header.get("schema") != SCHEMA_VERSION:
        raise LiaamError(f"{path}: this file contains no lamps; make one with '{MAKE}'")
    names: Any = header.get("names")
    are_names = isinstance(names, list) and 1 <= len(names) <= MOST and all(isinstance(name, str) for name in names)
    mean = shapes.get("mean", ())
    is_shape = len(mean) == 2 and mean[0] >= 3 and mean[1] == 2
    if not are_names or not is_shape or shapes.get("fields") != (len(names), SIDE, SIDE, 3):
        raise LiaamError(f"{path}: {_CONTRADICTORY}")
    return names
