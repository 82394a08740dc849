"""Light: Planckian sources, their spectra, and the shadows they cast.

A source of temperature T has the spectral power E(lambda, T) = I k1 lambda^-5 exp(-k2 / (T lambda)) (Wien's
approximation, as in the paper), or that of Planck's law.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from liaam.errors import LiaamError
from scenes.body import Body
from scenes.raster import coordinates, depth_map, splat_map, transform, visibility

Radiator = Literal["wien", "planck"]
K2_NM = 1.438776877e7  # second radiation constant, nm K
REFERENCE_NM = 550.0  # spectra are 1 at this wavelength, so that strength does not depend on temperature
COLDEST_K, HOTTEST_K = 1500.0, 20000.0

SHADOW_MAP = 420
SHADOW_REACH = 1.55  # half width of the shadow map, head units
PENUMBRA_SAMPLES, WIDE_SAMPLES = 5, 10
# Softness above which shadows are so blurred that the coarse mesh suffices, and a smaller map in small pictures.
WIDE = 0.1
CENTRE = np.array([0.0, -0.15, 0.0])  # middle of the shadow map
DOME_MAP = 110
DOME_SAMPLES = 28


def check_kelvin(name: str, temperature: float) -> None:
    """Raise if a colour temperature is out of range."""
    if not COLDEST_K <= temperature <= HOTTEST_K:
        raise LiaamError(f"{name} is {temperature!r}: give {COLDEST_K:g} to {HOTTEST_K:g} kelvin")


def _check_source(owner: str, temperature: float, strength: float) -> None:
    check_kelvin(f"{owner}.temperature_K", temperature)
    if not np.isfinite(strength) or strength < 0:
        raise LiaamError(f"{owner}.strength is {strength!r}: give a number of at least 0")


@dataclass(frozen=True)
class PointLight:
    """A distant lamp.

    Attributes
    ----------
    direction : (float, float, float)
        Direction towards the lamp (right in the image, up, towards the camera), of any length.
    temperature_K : float
        Colour temperature, kelvin.
    strength : float
        Irradiance of a surface that faces the lamp.
    softness : float
        Angular radius of the lamp, radians; it determines the width of the penumbra.
    """

    direction: tuple[float, float, float] = (0.0, 0.3, 1.0)
    temperature_K: float = 5000.0  # noqa: N815 - a kelvin is a K
    strength: float = 1.0
    softness: float = 0.025

    def __post_init__(self) -> None:
        if not np.all(np.isfinite(self.direction)) or len(self.direction) != 3 or not np.any(self.direction):
            raise LiaamError(f"PointLight.direction is {self.direction!r}: give three numbers, not all zero")
        if not 0 <= self.softness <= 1:
            raise LiaamError(f"PointLight.softness is {self.softness!r}: give 0 (hard) to 1 radian")
        _check_source("PointLight", self.temperature_K, self.strength)

    @property
    def unit(self) -> np.ndarray:
        """Direction (3,) of unit length."""
        direction = np.asarray(self.direction, float)
        return direction / np.linalg.norm(direction)


@dataclass(frozen=True)
class Ambient:
    """Light from all directions, slightly more from above, occluded in concavities.

    Attributes
    ----------
    temperature_K : float
        Colour temperature, kelvin.
    strength : float
        Irradiance of an open surface that faces the camera.
    """

    temperature_K: float = 6500.0  # noqa: N815
    strength: float = 1.0

    def __post_init__(self) -> None:
        _check_source("Ambient", self.temperature_K, self.strength)


Lights = tuple[PointLight | Ambient, ...]

DIFFUSE: Lights = (
    Ambient(temperature_K=5000.0, strength=0.62),
    PointLight((0.0, 0.45, 1.0), temperature_K=5000.0, strength=0.42, softness=0.35),
)
"""Homogeneous frontal light of one temperature, as from a photographer's diffusers."""


def lateral(
    side: Literal["left", "right"] = "left",
    temperature_K: float = 3900.0,
    strength: float = 1.0,
    azimuth: float = 0.90,
    elevation: float = 0.35,
    ambient_temperature_K: float = 7500.0,
    ambient_strength: float = 0.15,
) -> Lights:
    """Hard light from one side of the image, which casts shadows, and weak bluish ambient light.

    Parameters
    ----------
    side : {"left", "right"}
        Side of the image on which the lamp stands.
    temperature_K, ambient_temperature_K : float
        Colour temperatures, kelvin.
    strength, ambient_strength : float
        Irradiances of the lamp and of the ambient.
    azimuth, elevation : float
        Angles of the lamp from the camera's axis, radians.
    """
    if side not in ("left", "right"):
        raise LiaamError(f"the side of a lateral light is {side!r}: give 'left' or 'right'")
    sign = -1.0 if side == "left" else 1.0
    direction = (
        sign * float(np.sin(azimuth) * np.cos(elevation)),
        float(np.sin(elevation)),
        float(np.cos(azimuth) * np.cos(elevation)),
    )
    return PointLight(direction, temperature_K, strength), Ambient(ambient_temperature_K, ambient_strength)


def spectrum(wavelength_nm: np.ndarray, mired: np.ndarray | float, radiator: Radiator) -> np.ndarray:
    """Spectral power relative to that at 550 nm; ``mired`` is 1e6 over the temperature, broadcast with wavelengths."""
    c = K2_NM * np.asarray(mired) * 1e-6
    if radiator == "wien":
        ratio = np.exp(-c * (1 / wavelength_nm - 1 / REFERENCE_NM))
    elif radiator == "planck":
        ratio = np.expm1(c / REFERENCE_NM) / np.expm1(c / wavelength_nm)
    else:
        raise LiaamError(f"the radiator is {radiator!r}: give 'wien' or 'planck'")
    return ratio * (REFERENCE_NM / wavelength_nm) ** 5


def direct_visibility(body: Body, at: np.ndarray, normals: np.ndarray, light: PointLight) -> np.ndarray:
    """Fraction (n,) of a lamp that is visible from points (n, 3) with normals (n, 3)."""
    seen = np.zeros(len(at), np.float32)
    # Offset the points by about a texel, so that the surface does not shadow itself.
    lifted = np.ascontiguousarray((at + normals * 0.022).T)
    samples = _lamp_samples(light)
    triangles = body.triangles
    size = SHADOW_MAP
    if light.softness > WIDE:
        triangles = body.coarse
        size = SHADOW_MAP // body.step
    for direction in samples:
        frame = _light_frame(direction, size, SHADOW_REACH)
        depth = depth_map(transform(body.points, frame), triangles, size)
        seen += visibility(coordinates(lifted, frame), depth, 0.010)
    return seen / len(samples)


def dome_irradiance(body: Body, seen: np.ndarray) -> np.ndarray:
    """Irradiance (n,) of the vertices ``seen`` under an open sky, 1 for an open surface facing the camera; else 0."""
    directions = _dome()
    weights = 1 + 0.45 * directions[:, 1]
    normals = body.normals[seen]
    irradiance = np.zeros(len(seen), np.float32)
    points = np.ascontiguousarray(body.points.T)
    lifted = np.ascontiguousarray((body.points[seen] + normals * 0.035).T)
    for direction, weight in zip(directions, weights, strict=True):
        frame = _light_frame(direction, DOME_MAP, 1.9)
        depth = splat_map(coordinates(points, frame), DOME_MAP)
        facing = np.einsum("nk,k->n", normals, direction)
        towards = np.flatnonzero(facing > 0)
        open_to = visibility(coordinates(lifted.take(towards, axis=1), frame), depth, 0.03)
        irradiance[towards] += weight * facing[towards] * open_to
    total = np.zeros(len(body.normals), np.float32)
    total[seen] = irradiance / np.sum(weights * np.maximum(directions[:, 2], 0))
    return total


def _lamp_samples(light: PointLight) -> np.ndarray:
    """Directions (n, 3) spread evenly over the lamp's disc in a sunflower spiral."""
    unit = light.unit
    side = np.cross(unit, [0.0, 1.0, 0.0] if abs(unit[1]) < 0.9 else [1.0, 0.0, 0.0])
    side /= np.linalg.norm(side)
    n = WIDE_SAMPLES if light.softness > WIDE else PENUMBRA_SAMPLES
    i = np.arange(n) + 0.5
    radius, angle = np.tan(light.softness) * np.sqrt(i / n), np.pi * (1 + 5**0.5) * i
    samples = unit + (radius * np.cos(angle))[:, None] * side
    samples += (radius * np.sin(angle))[:, None] * np.cross(unit, side)
    return samples / np.linalg.norm(samples, axis=1, keepdims=True)


def _dome() -> np.ndarray:
    """Directions (n, 3) spread over the hemisphere that faces the camera, and slightly beyond."""
    i = np.arange(DOME_SAMPLES) + 0.5
    z = 1 - 1.25 * i / DOME_SAMPLES
    turn = np.pi * (1 + 5**0.5) * i
    r = np.sqrt(1 - z**2)
    return np.stack([r * np.cos(turn), r * np.sin(turn), z], -1)


def _light_frame(direction: np.ndarray, size: int, reach: float) -> np.ndarray:
    """Affine map (3, 4) from the viewer's axes to pixels and nearness of a light's depth map."""
    side = np.cross([0.0, 1.0, 0.0] if abs(direction[1]) < 0.9 else [1.0, 0.0, 0.0], direction)
    side /= np.linalg.norm(side)
    scale = size / (2 * reach)
    axes = np.stack([scale * side, scale * np.cross(direction, side), direction])
    offset = np.array([size / 2, size / 2, 0.0]) - axes @ CENTRE
    return np.column_stack([axes, offset])
