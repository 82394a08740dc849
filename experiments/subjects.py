"""A few images of one person under homogeneous light, and a simulated shadow (paper section 7.1)."""

import hashlib
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from liaam.datasets import Dataset, Sample, load_folder
from liaam.errors import LiaamError
from liaam.photometry import encode, is_grey, linear_to_srgb, srgb_to_linear, temperature_direction
from liaam.photometry.encoding import as_colour

N_IMAGES = 6
"""Number of images in the paper's simulations."""

PAPER_THETA = float(np.deg2rad(146.0))
"""Camera angle of the simulated shadow (paper Fig 2), in radians. Real cameras have 90 to 135 degrees."""

STRENGTH, TEMPERATURE, PENUMBRA = -1.8, 0.5, 4.0
"""Shadow's depth in log light, its shift along the direction of colour temperature, and its edge's width (px)."""

TILT = float(np.deg2rad(20.0))
"""Largest tilt of the shadow's edge from upright, radians."""

SCENE_HEAD = 5
"""Seed of the head in generated images, as in ``liaam demo``."""


@dataclass(frozen=True, eq=False)
class Subject:
    """Images of one person, stored sRGB values (h, w, 3) float32 in [0, 1], and their landmarks (n, 2) float64."""

    name: str
    images: tuple[np.ndarray, ...]
    shapes: tuple[np.ndarray, ...]

    @property
    def pairs(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Images with their landmarks, as input of :func:`liaam.train`."""
        return list(zip(self.images, self.shapes, strict=True))


@lru_cache(maxsize=4)
def get_subject(folder: Path | None, n_images: int = N_IMAGES) -> Subject:
    """Return the subject of a folder, or the generated subject; once per process."""
    return scene_subject(n_images) if folder is None else folder_subject(folder, n_images)


def folder_subject(folder: Path, n_images: int = N_IMAGES, halve: bool = True) -> Subject:
    """Read images of one person in colour, evenly spread over a folder.

    By default blocks of 2 by 2 pixels are averaged, in linear light. Raises a LiaamError if there are too few images,
    or grey ones.
    """
    chosen = _spread(folder, n_images)
    reduce = 2 if halve else 1
    images = tuple(_stored_values(sample, reduce) for sample in chosen)
    shapes = tuple(reduced_points(sample.landmarks.points, reduce) for sample in chosen)
    return Subject(folder.name, images, shapes)


def _spread(folder: Path, n_images: int) -> list[Sample]:
    """Samples evenly spread over a folder."""
    data = load_folder(folder)
    if len(data) < n_images:
        raise LiaamError(
            f"{folder} holds {len(data)} landmarked pictures, but {n_images} of one person are needed; add some"
        )
    return [data[i] for i in np.linspace(0, len(data) - 1, n_images).round().astype(int)]


def subject_facts(folder: Path | None, n_images: int = N_IMAGES) -> dict[str, Any]:
    """Describe a subject's images, for an experiment's settings, without decoding or generating them.

    Raises a LiaamError if there are too few.
    """
    if folder is None:
        return {"data": f"generated scenes of head {SCENE_HEAD}", "pictures": n_images}
    return {"data": folder.resolve().name, **data_facts(_spread(folder, n_images))}


def data_facts(samples: "Dataset | list[Sample]") -> dict[str, Any]:
    """Return names and a digest of images and landmarks, to detect changed files."""
    digest = hashlib.sha256()
    for sample in samples:
        image = sample.image
        digest.update(image.read_bytes() if isinstance(image, Path) else image.tobytes())
        digest.update(sample.landmarks.points.tobytes())
    return {"pictures": [sample.name for sample in samples], "digest": digest.hexdigest()[:12]}


def reduced_points(points: np.ndarray, reduce: int) -> np.ndarray:
    """Return landmarks (n, 2) after averaging blocks of pixels; (0, 0) stays the centre of the top-left pixel."""
    return (np.asarray(points, dtype=np.float64) + 0.5) / reduce - 0.5


def _stored_values(sample: Sample, reduce: int) -> np.ndarray:
    image = as_colour(sample.read_image(), sample.name)
    if is_grey(image):
        raise LiaamError(f"{sample.name} is grey (three equal channels); light invariance needs pictures in colour")
    return np.ascontiguousarray(encode(image, "value", reduce=reduce)[..., :3])


def scene_subject(n_images: int = N_IMAGES) -> Subject:
    """Generate images of one head under diffuse light, from a camera without noise."""
    from scenes import DIFFUSE

    scenes = head_scenes(DIFFUSE, n_images)
    return Subject("generated head", tuple(scene.image for scene in scenes), tuple(scene.landmarks for scene in scenes))


def head_scenes(lights, n_images: int = N_IMAGES) -> list:
    """Scenes of the generated head under given lights. Poses and expressions do not depend on the lights."""
    from scenes import Camera, Head, make_set

    return make_set(n_images, Head(SCENE_HEAD), lights, Camera().noiseless("srgb"))


def random_side(rng: np.random.Generator) -> float:
    """Draw the side of a shadow: left or right of the face, with an edge tilted by up to 20 degrees.

    Returns the direction from the light into the shadow, radians from the image's x axis towards its y axis.
    """
    side = np.pi * rng.integers(2)
    return float(side + rng.uniform(-TILT, TILT))


def simulated_shadow(
    image: np.ndarray,
    shape: np.ndarray,
    side: float = 0.0,
    *,
    strength: float = STRENGTH,
    temperature: float = TEMPERATURE,
    penumbra: float = PENUMBRA,
    theta: float = PAPER_THETA,
) -> tuple[np.ndarray, np.ndarray]:
    """Apply a shadow of another colour to half of a face in an image (h, w, 3) of stored sRGB values (paper Fig 2a).

    In linear light, log rho += mask (strength 1 + temperature d(theta)). This is a change of light in the paper's
    model, so it does not change the invariant of a camera of angle theta. The edge passes through the centre of the
    landmarks' bounding box, ``side`` is the direction into the shadow (:func:`random_side`), and over ``penumbra``
    pixels the shadow goes from 12 to 88 %. Returns the shadowed values, float32, and the fraction of the full shadow
    (h, w).
    """
    height, width = image.shape[:2]
    middle = 0.5 * (shape.min(axis=0) + shape.max(axis=0))
    along = (np.arange(width) - middle[0]) * np.cos(side) + (np.arange(height)[:, None] - middle[1]) * np.sin(side)
    mask = 0.5 * (1.0 + np.tanh(2.0 * along / penumbra))
    change = strength * np.ones(3) + temperature * temperature_direction(theta)
    linear = srgb_to_linear(image.astype(np.float64)) * np.exp(mask[..., None] * change)
    return np.clip(linear_to_srgb(linear), 0.0, 1.0).astype(np.float32), mask
