"""Lamps as fields: by how much each changes a picture's values, place by place on the mean shape and around it.

A field is the logarithm of what a picture stores under a lamp, over what it stores in the light of training, on a
square about the mean shape. Landmarks carry it to any picture: piecewise linear between them, and beyond them towards
the square's border, which follows the shape's pose.
"""

import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from liaam.errors import LiaamError, TrainingError
from liaam.io import write_bytes_atomically
from liaam.io.tensors import read_tensors
from liaam.model.shape import align
from liaam.photometry import Response, is_grey
from liaam.photometry.encoding import stored_values
from liaam.photometry.response import from_linear, linear_to_srgb, srgb_to_linear, to_linear

HALF = 0.9
"""Half the side of a field's square, in diagonals of the mean shape: the object, what surrounds it, and the background
that a search looks at."""

SIDE = 128
"""Pixels across a field."""

DARK = 4.0 / 255.0
"""Added to stored values before their logarithm: rounding and noise of the dark are no light."""

STRIDE = 4
"""Pixels of a picture between those whose place in a field is worked out; the others' lie between."""

FORMAT, SCHEMA_VERSION = "liaam-lamps", 1

MAKE = "liaam lamps FOLDER -o LAMPS"
"""The command that makes a file of lamps."""

MOST = 10_000
"""Lamps in a file at most."""


@dataclass(frozen=True, eq=False)
class Lamps:
    """Lamps that pictures of a class of objects can be put under.

    Attributes
    ----------
    mean : (n, 2) float64
        Landmarks of the mean shape, the middle of their box at the origin and its diagonal 1.
    fields : (k, SIDE, SIDE, 3) float16
        Logarithm of what a lamp does to stored sRGB values (to these plus :data:`DARK`), red, green and blue.
    names : tuple of str
        Of the lamps, for people.
    """

    mean: np.ndarray
    fields: np.ndarray
    names: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.fields)

    def __repr__(self) -> str:
        return f"Lamps({len(self)} lamps, {len(self.mean)} landmarks)"

    def check_landmarks(self, n: int, whose: str) -> None:
        """Complain unless objects with n landmarks are of the kind that the lamps were learnt from."""
        if n != len(self.mean):
            raise TrainingError(
                f"the lamps were learnt with {len(self.mean)} landmarks, but {whose} have {n}; lamps serve objects "
                "with the same landmarks only"
            )

    def relit(self, image: np.ndarray, points: np.ndarray, which, response: Response = "srgb") -> list[np.ndarray]:
        """Put a picture that was taken in the light of training under lamps.

        Parameters
        ----------
        image : (h, w, 3) uint8, uint16 or float32
        points : (n, 2) float
            Its landmarks.
        which : iterable of int
            Numbers of lamps.
        response
            Of the picture's camera.

        Returns
        -------
        list of (h, w, 3) arrays of the image's type
            As the camera would store them: rounded, and cut where they are too bright.

        Raises
        ------
        TrainingError
            If the lamps belong to objects with other landmarks.
        """
        import cv2  # heavy: imported when first needed

        self.check_landmarks(len(points), "these pictures")
        places, values = self._places(points, image.shape[1::-1]), as_srgb(image, response) + np.float32(DARK)
        grey, pictures = is_grey(image), []
        for i in which:
            field = self.fields[i].astype(np.float32)
            field = field.mean(axis=2, keepdims=True).repeat(3, axis=2) if grey else field
            carried = cv2.remap(
                field, places[..., 0], places[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
            )
            changed = np.clip(values * cv2.exp(carried) - np.float32(DARK), 0.0, 1.0)
            pictures.append(_as_stored(changed, image.dtype, response))
        return pictures

    def _places(self, points: np.ndarray, size: tuple[int, int]) -> np.ndarray:
        """Pixel of a field for each pixel of a picture of some size (width, height), (h, w, 2) float32."""
        import cv2  # heavy: imported when first needed
        from scipy.interpolate import LinearNDInterpolator

        width, height = size
        x, y = np.arange(0, width + STRIDE, STRIDE), np.arange(0, height + STRIDE, STRIDE)
        coarse = np.stack(np.meshgrid(x, y), axis=-1).astype(np.float64)
        pose, (rest, there) = align(self.mean, points), anchors(self.mean, points)
        # Triangles of the picture's own points: none is folded, whatever the shape does.
        found = LinearNDInterpolator(there, rest)(coarse)
        found = np.where(np.isfinite(found), found, pose.inverse()(coarse.reshape(-1, 2)).reshape(coarse.shape))
        found = ((found + HALF) * ((SIDE - 1) / (2 * HALF))).astype(np.float32)
        across, down = (np.arange(n, dtype=np.float32) / STRIDE for n in size)
        return cv2.remap(found, *np.meshgrid(across, down), cv2.INTER_LINEAR)

    def save(self, path: str | os.PathLike) -> None:
        """Write the lamps as one safetensors file, atomically.

        Raises
        ------
        LiaamError
            If the folder does not exist or cannot be written.
        """
        from safetensors.numpy import save

        about = {"format": FORMAT, "schema": SCHEMA_VERSION, "names": list(self.names)}
        write_bytes_atomically(path, save({"mean": self.mean, "fields": self.fields}, {"liaam": json.dumps(about)}))


def square() -> np.ndarray:
    """Places of a field's pixels about the mean shape, (SIDE, SIDE, 2) float64."""
    steps = np.linspace(-HALF, HALF, SIDE)
    return np.stack(np.meshgrid(steps, steps), axis=-1)


def _border() -> np.ndarray:
    steps, ends = np.linspace(-HALF, HALF, 5), (-HALF, HALF)
    return np.array([(s, e) for s in steps for e in ends] + [(e, s) for s in steps[1:-1] for e in ends])


BORDER = _border()
"""Points on a square's border, (16, 2) float64: they follow the shape's pose."""


def anchors(mean: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Places that carry a field between the mean shape and a picture: landmarks and border, here and there."""
    return np.concatenate([mean, BORDER]), np.concatenate([points, align(mean, points)(BORDER)])


def as_srgb(image: np.ndarray, response: Response) -> np.ndarray:
    """Values of a picture, (h, w, 3) float32, as an sRGB camera would store them, from 0 to 1."""
    stored = stored_values(image)
    return stored if response == "srgb" else linear_to_srgb(to_linear(stored, response)).astype(np.float32)


def _as_stored(values: np.ndarray, dtype: np.dtype, response: Response) -> np.ndarray:
    """Give sRGB values (h, w, 3) of 0 to 1 as a camera of some response and type would store them."""
    stored = values if response == "srgb" else from_linear(srgb_to_linear(values), response).astype(np.float32)
    if dtype.kind == "f":
        return stored
    return np.rint(np.clip(stored, 0.0, 1.0) * np.float32(np.iinfo(dtype).max)).astype(dtype)


def load_lamps(path: str | os.PathLike) -> Lamps:
    """Read a file of lamps, checking all of it.

    Raises
    ------
    LiaamError
        If the file is missing, cut short, forged, or holds no lamps.
    """
    path = Path(path)
    broken = "this is no complete file of lamps ({fault}); copy it or make it again"
    names, tensors = read_tensors(path, lambda text: _names(path, text), LiaamError, "file of lamps", MAKE, broken)
    mean, fields = tensors.get("mean"), tensors.get("fields")
    if mean is None or fields is None or not _are_sound(mean, fields, names):
        raise LiaamError(f"{path}: the file of lamps contradicts itself; copy it or make it again")
    return Lamps(mean, fields, tuple(names))


def _names(path: Path, text: str) -> Any:
    """Names of the lamps, by a file's header."""
    try:
        about = json.loads(text)
    except (ValueError, RecursionError):
        about = None
    if not isinstance(about, dict) or (about.get("format"), about.get("schema")) != (FORMAT, SCHEMA_VERSION):
        raise LiaamError(f"{path}: this file holds no lamps; make one with '{MAKE}'")
    return about.get("names")


def _are_sound(mean: np.ndarray, fields: np.ndarray, names: Any) -> bool:
    return (
        mean.dtype == np.float64
        and mean.ndim == 2
        and mean.shape[1] == 2
        and len(mean) >= 3
        and fields.dtype == np.float16
        and fields.shape[1:] == (SIDE, SIDE, 3)
        and 1 <= len(fields) <= MOST
        and bool(np.isfinite(fields).all())
        and bool((np.abs(mean) <= 1.0).all())
        and isinstance(names, list)
        and len(names) == len(fields)
        and all(isinstance(name, str) for name in names)
    )
