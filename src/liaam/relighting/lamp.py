"""Distant lamps, and their light on a surface: the model's relief, or the inflated outline of the mesh without one."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from liaam.errors import LiaamError
from liaam.model import AAM
from liaam.model.light_basis import sample_field
from liaam.model.mesh import ReferenceFrame
from liaam.model.shape import diagonal_of
from liaam.relighting.painting import Region
from liaam.relighting.shading import field_on_image, frame_in_field, middle_of

AMBIENT = 0.25  # Default fraction of ambient light
DIRECTIONS = {
    "left": (-1.0, 0.0, 0.5),
    "right": (1.0, 0.0, 0.5),
    "above": (0.0, -1.0, 0.5),
    "below": (0.0, 1.0, 0.5),
    "front": (0.0, 0.0, 1.0),
}  # Directions to lamps by name, as seen in the image
STRONGEST = 10.0  # Largest strength of a lamp
LEAST_FACING = 0.2  # Least component of a relief's normals towards the viewer, before they are made unit vectors
DARKEST = 0.02  # Least light at a pixel, relative to a white lamp from the front, because black has no logarithm
STEEPEST = np.tan(np.deg2rad(65.0))  # Limit of the surface's slope, at the mesh's border
ROUNDING = 0.03  # Gaussian that smooths its slopes, in diagonals; it removes ridges at the outline's corners


@dataclass(frozen=True)
class Lamp:
    """A distant lamp.

    Attributes
    ----------
    direction : (3,) float
        Direction to the lamp: x to the right, y down, z to the viewer; its length does not matter.
    colour : (3,) float
        Linear red, green and blue, 0 to 1. Default: white.
    strength : float
        Factor of its light, 0 to 10.
    softness : float
        Size of the lamp, 0 (a point, with a sharp edge between light and shadow) to 1 (the light wraps around the
        object).

    Raises
    ------
    LiaamError
        For a zero or non-finite direction, and for other values out of range.
    """

    direction: Sequence[float]
    colour: Sequence[float] = (1.0, 1.0, 1.0)
    strength: float = 1.0
    softness: float = 0.0

    def __post_init__(self) -> None:
        unit_direction(self.direction)
        if len(self.colour) != 3 or not all(0.0 <= value <= 1.0 for value in self.colour):
            raise LiaamError(f"lamp colour {self.colour}: give red, green and blue from 0 to 1")
        if not 0.0 <= self.strength <= STRONGEST:
            raise LiaamError(f"lamp strength {self.strength:g}: give a factor from 0 to {STRONGEST:g}")
        if not 0.0 <= self.softness <= 1.0:
            raise LiaamError(f"lamp softness {self.softness:g}: give a number from 0 (a point) to 1")


def light_of(lamps: Sequence[Lamp], normals: np.ndarray, ambient: float) -> np.ndarray:
    """Return the light of lamps, and a fraction of white ambient light, on normals (..., 3) by Lambert's law.

    (..., 3) float32, or (..., 1) if all lamps are white; at least :data:`DARKEST`.
    """
    colours = np.array([np.multiply(lamp.colour, lamp.strength) for lamp in lamps], np.float32).reshape(-1, 3)
    if (np.ptp(colours, axis=1) == 0).all():
        colours = colours[:, :1]
    light = np.full((*normals.shape[:-1], colours.shape[1]), ambient, np.float32)
    for lamp, colour in zip(lamps, colours, strict=True):
        light += lit(normals @ unit_direction(lamp.direction), lamp.softness)[..., None] * ((1.0 - ambient) * colour)
    return np.maximum(light, DARKEST)


def lit(facing: np.ndarray, softness: float) -> np.ndarray:
    """Return the light of a white lamp from the cosine between normal and lamp.

    A large lamp still reaches parts that face away from its middle: near the horizon, Lambert's law, max(c, 0), is
    averaged over lamps whose cosines c lie evenly from ``facing - softness`` to ``facing + softness``.
    """
    near = np.square(facing + softness) / max(4.0 * softness, 1e-9)
    return np.where(np.abs(facing) < softness, near, np.maximum(facing, 0.0))


def unit_direction(direction: Sequence[float]) -> np.ndarray:
    """Normalise a direction to unit length, (3,) float32. Raise if it is not three finite numbers, or all are 0."""
    try:
        light = np.asarray(direction, dtype=np.float64)
    except (TypeError, ValueError):
        light = np.zeros(0)
    if light.shape != (3,) or not np.isfinite(light).all() or not light.any():
        shown = ",".join(f"{value:g}" for value in light.ravel()) or repr(direction)
        raise LiaamError(
            f"light direction {shown} is not valid; give three numbers x,y,z, not all 0 (right, down, to the viewer)"
        )
    light = light / np.abs(light).max()
    return (light / np.linalg.norm(light)).astype(np.float32)


def check_ambient(ambient: float) -> None:
    """Raise an error for ambient light out of range."""
    if not 0.0 <= ambient <= 1.0:
        raise LiaamError(f"ambient light {ambient:g}: give a fraction from 0 (only the lamp) to 1 (no lamp)")


def check_strength(strength: float) -> None:
    """Raise an error for a strength of a change of light out of range."""
    if not 0.0 <= strength <= 1.0:
        raise LiaamError(f"strength {strength:g}: give a share of the change, from 0 (the image as it is) to 1")


def direction_named(name: str) -> tuple[float, float, float]:
    """Return the direction to a lamp by its name."""
    if name not in DIRECTIONS:
        raise LiaamError(f"light {name!r}: give a direction (x, y, z), or one of {', '.join(DIRECTIONS)}")
    return DIRECTIONS[name]


def surface_of(model: AAM) -> np.ndarray:
    """Return unit normals of a model's surface at the pixels of its frame, (n_pixels, 3) float32.

    They are those of its relief, or else of the inflated outline of its mesh (:func:`normals_of`).
    """
    if model.relief is None:
        return normals_of(model.frame)
    return _normals(sample_field(model.relief, frame_in_field(model))[:, 0])


def surface_on_image(model: AAM, region: Region) -> np.ndarray:
    """Return unit normals of a model with a relief in a region of an image, also around the mesh, (h, w, 3) float32.

    They are along the axes of the model.
    """
    mean = model.shape_model.mean
    assert model.relief is not None
    return _normals(field_on_image(model.relief, (mean - middle_of(mean)) / diagonal_of(mean), region))


def _normals(across: np.ndarray) -> np.ndarray:
    """Return unit normals (..., 3) float32 with components to the right and down (..., 2)."""
    towards = np.sqrt(np.maximum(1.0 - np.square(across).sum(axis=-1, keepdims=True), LEAST_FACING**2))
    normals = np.concatenate([across, towards], axis=-1)
    return normals / np.linalg.norm(normals, axis=-1, keepdims=True)


@lru_cache(maxsize=4)
def normals_of(frame: ReferenceFrame) -> np.ndarray:
    """Compute unit normals of an inflated surface, (n_pixels, 3) float32: x to the right, y down, z to the viewer.

    u solves Poisson's equation, laplacian(u) = -1 with 0 on the border. The height 2 sqrt(u) is a hemisphere over a
    disc, and smooth over other outlines. Its slopes are smoothed, and limited at the border, where they are infinite.
    """
    from scipy.ndimage import gaussian_filter
    from scipy.sparse import coo_array, diags_array
    from scipy.sparse.linalg import splu

    # The matrix of the discrete Laplacian: 4 on the diagonal, and -1 for each two pixels beside each other.
    n = frame.n_pixels
    numbers = frame.picture(np.arange(n) + 1.0).astype(int)  # of the pixels, from 1; 0 around the frame
    rights = numbers[:, :-1].ravel(), numbers[:, 1:].ravel()
    downs = numbers[:-1].T.ravel(), numbers[1:].T.ravel()
    firsts, seconds = np.hstack([rights, downs])
    are_pixels = (firsts > 0) & (seconds > 0)
    a = firsts[are_pixels] - 1
    b = seconds[are_pixels] - 1
    links = coo_array((np.ones(2 * len(a)), (np.concatenate([a, b]), np.concatenate([b, a]))), shape=(n, n))
    laplacian = (diags_array(np.full(n, 4.0)) - links).tocsc()
    u = splu(laplacian).solve(np.ones(n))

    scale = ROUNDING * float(np.hypot(*frame.size))
    height = np.pad(frame.picture(2.0 * np.sqrt(u)), round(3 * scale))  # room for the Gaussian
    inside = height > 0
    down, right = np.gradient(height)
    weights = np.maximum(gaussian_filter(1.0 * inside, scale)[inside], 1e-6)
    slopes = np.column_stack([gaussian_filter(each * inside, scale)[inside] for each in (right, down)])
    slopes = slopes / weights[:, None]
    steepness = np.linalg.norm(slopes, axis=1, keepdims=True)
    slopes = slopes / np.sqrt(1.0 + np.square(steepness / STEEPEST))  # smooth saturation
    normals = np.column_stack([-slopes, np.ones(n)])
    return (normals / np.linalg.norm(normals, axis=1, keepdims=True)).astype(np.float32)
