"""Pictures of a head by rays: a camera's view of a surface, and its light under lamps.

Light is reflected once by the surface towards the camera, and once more on its way to it (from the wall to the cheek,
from one side of the nose to the other). Skin reflects it in all directions, after a little scattering that is widest in
red, and by a layer of oil, as a microfacet surface (Walter et al., *Microfacet Models for Refraction through Rough
Surfaces*, EGSR 2007).
"""

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from making.head.light import Lamp, Light, colour_of
from making.head.rays import LIFT, Hits, Rays
from making.head.surface import Surface

LAMP_SAMPLES = 16
"""Rays to each lamp from each pixel."""

ROUND_SAMPLES = 32
"""Rays in all directions from each pixel."""

SCATTERING = (0.28, 0.12, 0.06)
"""Standard deviations of the width of scattering in skin, red, green and blue, cm."""


@dataclass(frozen=True)
class Camera:
    """A camera in front of the face that looks at the origin of the head.

    Attributes
    ----------
    distance : float
        From the origin, cm.
    width : float
        Of the plane through the origin that the picture shows, cm.
    size : int
        Width and height of pictures, pixels.
    """

    distance: float = 180.0
    width: float = 40.0
    size: int = 160

    @property
    def position(self) -> np.ndarray:
        """Position of the camera (3,), cm."""
        return np.array([0.0, 0.0, self.distance])

    def directions(self) -> np.ndarray:
        """Return the directions (size * size, 3) of the pixels' rays, unit vectors."""
        steps = (np.arange(self.size) + 0.5) / self.size * self.width - self.width / 2
        x, y = np.meshgrid(steps, -steps)
        towards = np.stack([x, y, np.full_like(x, -self.distance)], axis=-1).reshape(-1, 3)
        return towards / np.linalg.norm(towards, axis=1, keepdims=True)

    def seen_at(self, points: np.ndarray) -> np.ndarray:
        """Return where points (n, 3) appear in the picture, (n, 2) float64."""
        nearer = self.distance / (self.distance - points[:, 2])
        x = points[:, 0] * nearer + self.width / 2
        y = self.width / 2 - points[:, 1] * nearer
        return np.stack([x, y], axis=-1) * (self.size / self.width) - 0.5


@dataclass(frozen=True, eq=False)
class Points:
    """Points on a surface: position, normal and what they reflect."""

    at: np.ndarray
    normals: np.ndarray
    albedo: np.ndarray

    @classmethod
    def of(cls, surface: Surface, hits: Hits, seen_from: np.ndarray) -> "Points":
        """Return the points of hits (n,), lifted off the surface; normals face the directions seen from, (n, 3)."""
        corners = surface.vertices.astype(np.float32)[surface.triangles[hits.triangle]]
        flat = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        flat /= np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-12)
        flat *= np.where(_dot(flat, seen_from) > 0.0, -1.0, 1.0)[:, None]
        normals = hits.interpolated(surface.triangles, surface.normals)
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
        normals *= np.where(_dot(normals, flat) < 0.0, -1.0, 1.0)[:, None]
        at = np.einsum("nc,ncd->nd", hits.weights, corners) + LIFT * flat
        return cls(at, normals, hits.interpolated(surface.triangles, surface.albedo))

    def __len__(self) -> int:
        return len(self.at)


class View:
    """What a camera sees of a surface; pictures under any light follow from it.

    Parameters
    ----------
    surface
        What is seen. Its wall fills the background.
    camera
        The camera.
    rng
        Of the rays' directions.
    """

    def __init__(self, surface: Surface, camera: Camera, rng: np.random.Generator) -> None:
        self.camera = camera
        self._rng = rng
        self._rays = Rays(surface.vertices, surface.triangles)
        directions = camera.directions()
        hits = self._rays.first_hits(np.tile(camera.position, (len(directions), 1)), directions)
        if (hits.triangle < 0).any():
            raise ValueError("the wall does not fill the background; make it larger, or the picture smaller")
        self.points = Points.of(surface, hits, directions)
        self._to_camera = -directions
        self._gloss = hits.interpolated(surface.triangles, surface.gloss)
        self._roughness = hits.interpolated(surface.triangles, surface.roughness)
        self._scatters = hits.interpolated(surface.triangles, surface.scatters)
        self._around = _cosine_directions(self.points.normals, ROUND_SAMPLES, rng)
        origins = np.repeat(self.points.at, ROUND_SAMPLES, axis=0)
        around = self._rays.first_hits(origins, self._around)
        self._is_open = around.triangle < 0
        self._others = Points.of(surface, around[~self._is_open], self._around[~self._is_open])

    def under(self, light: Light) -> np.ndarray:
        """Return the linear picture (size, size, 3) float32 under a light."""
        diffuse = self._light_from_around(light)
        shine = self._mirrored_room(light)
        for lamp in light.lamps:
            facing, shining = self._light_of(lamp)
            colour = lamp.strength * colour_of(lamp.temperature)
            diffuse += facing[:, None] * colour
            shine += shining[:, None] * colour
        size = self.camera.size
        irradiance = self._scattered(diffuse.astype(np.float32).reshape(size, size, 3))
        albedo = self.points.albedo.reshape(size, size, 3)
        return albedo / np.float32(np.pi) * irradiance + shine.astype(np.float32).reshape(size, size, 3)

    def _light_of(self, lamp: Lamp) -> tuple[np.ndarray, np.ndarray]:
        """Return the irradiance and the shine (n,) of the pixels by a lamp of strength 1."""
        n = len(self.points)
        lit = np.zeros(n)
        weight = np.zeros(n)
        facing = np.zeros(n)
        for offset in _ball_samples(n, LAMP_SAMPLES, self._rng):
            towards = lamp.position + lamp.radius * offset - self.points.at
            irradiance = _irradiance(towards, self.points.normals, lamp.distance)
            candidates = np.flatnonzero(irradiance > 0.0)
            blocked = self._rays.are_blocked(self.points.at[candidates], towards[candidates])
            seen = candidates[~blocked]
            lit[seen] += irradiance[seen]
            facing += irradiance
            weight[seen] += 1.0
        seen = weight / LAMP_SAMPLES
        return lit / LAMP_SAMPLES, seen * self._shine(lamp)

    def _shine(self, lamp: Lamp) -> np.ndarray:
        """Return the radiance (n,) that the gloss sends to the camera, without shadows."""
        towards = lamp.position - self.points.at
        distances = np.linalg.norm(towards, axis=1)
        towards = towards / distances[:, None]
        half = towards + self._to_camera
        half /= np.linalg.norm(half, axis=1, keepdims=True)
        facing = np.maximum(_dot(towards, self.points.normals), 0.0)
        seen = np.maximum(_dot(self._to_camera, self.points.normals), 0.05)
        upright = np.maximum(_dot(half, self.points.normals), 0.0)
        # A lamp of some size shines as a point does on a rougher surface.
        alpha = np.minimum(self._roughness**2 + lamp.radius / (2.0 * lamp.distance), 1.0)
        spread = alpha**2 / (np.pi * (upright**2 * (alpha**2 - 1.0) + 1.0) ** 2)
        grazing = (1.0 - _dot(half, self._to_camera)) ** 5
        fresnel = np.where(self._gloss > 0.0, self._gloss + (1.0 - self._gloss) * grazing, 0.0)
        masked = _smith(facing, alpha) * _smith(seen, alpha)
        level = (lamp.distance / distances) ** 2
        return np.where(facing > 0.0, level * spread * fresnel * masked / (4.0 * seen), 0.0)

    def _light_from_around(self, light: Light) -> np.ndarray:
        """Return the irradiance (n, 3) from the room, and from the surface that the room and lamps light."""
        radiance = np.zeros((len(self._around), 3))
        radiance[self._is_open] = light.room.radiance(self._around[self._is_open])
        others = self._others
        arriving = np.pi * light.room.radiance(others.normals) / 2.0  # about half of a corner's room is open
        for lamp in light.lamps:
            towards = lamp.position - others.at
            irradiance = _irradiance(towards, others.normals, lamp.distance)
            candidates = np.flatnonzero(irradiance > 0.0)
            blocked = self._rays.are_blocked(others.at[candidates], towards[candidates])
            irradiance[candidates[blocked]] = 0.0
            arriving += irradiance[:, None] * (lamp.strength * colour_of(lamp.temperature))
        radiance[~self._is_open] = others.albedo / np.pi * arriving
        return np.pi * radiance.reshape(-1, ROUND_SAMPLES, 3).mean(axis=1)

    def _mirrored_room(self, light: Light) -> np.ndarray:
        """Return the shine (n, 3) of the room on the gloss, where the directions around are open."""
        is_open = self._is_open.reshape(-1, ROUND_SAMPLES).mean(axis=1)
        away = 2.0 * _dot(self._to_camera, self.points.normals)[:, None] * self.points.normals - self._to_camera
        seen = np.clip(_dot(self._to_camera, self.points.normals), 0.0, 1.0)
        fresnel = (
            self._gloss
            + (1.0 - self._gloss) * (1.0 - seen) ** 5 * (self._gloss > 0) * (1.0 - self._roughness) ** 2 / 2.0
        )
        return (fresnel * is_open)[:, None] * light.room.radiance(away)

    @cached_property
    def _shares(self) -> list[np.ndarray]:
        """How much scattering skin there is around each pixel, by colour."""
        skin = self._scatters.reshape(self.camera.size, -1)
        return [np.maximum(self._blurred(skin, width), 1e-3) for width in SCATTERING]

    def _scattered(self, irradiance: np.ndarray) -> np.ndarray:
        """Spread the irradiance (size, size, 3) float32 within the skin."""
        skin = self._scatters.reshape(self.camera.size, -1)
        channels = []
        for i, width in enumerate(SCATTERING):
            spread = self._blurred(irradiance[..., i] * skin, width) / self._shares[i]
            channels.append(irradiance[..., i] + skin * (spread - irradiance[..., i]))
        return np.stack(channels, axis=-1)

    def _blurred(self, image: np.ndarray, width: float) -> np.ndarray:
        return cv2.GaussianBlur(image, (0, 0), width * self.camera.size / self.camera.width)


def _irradiance(towards: np.ndarray, normals: np.ndarray, distance: float) -> np.ndarray:
    """Return the irradiance (n,) by a small source in directions (n, 3); 1 at a distance, face to face."""
    squared = _dot(towards, towards)
    return np.maximum(_dot(towards, normals), 0.0) * distance**2 / squared**1.5


def _smith(cosine: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Share of a rough surface that its own bumps do not hide (Smith's)."""
    return 2.0 * cosine / np.maximum(cosine + np.sqrt(alpha**2 + (1.0 - alpha**2) * cosine**2), 1e-9)


def _cosine_directions(normals: np.ndarray, n: int, rng: np.random.Generator) -> np.ndarray:
    """Return n random directions about each normal (m, 3), as often as their cosine, (m * n, 3) float32."""
    on_ball = rng.normal(size=(len(normals), n, 3)).astype(np.float32)
    on_ball /= np.linalg.norm(on_ball, axis=2, keepdims=True)
    directions = (on_ball + 1.0001 * normals[:, None].astype(np.float32)).reshape(-1, 3)
    return directions / np.maximum(np.linalg.norm(directions, axis=1, keepdims=True), 1e-6)


def _ball_samples(n: int, count: int, rng: np.random.Generator) -> np.ndarray:
    """Return random points in a ball of radius 1 for n pixels, (count, n, 3)."""
    points = rng.normal(size=(count, n, 3))
    points /= np.linalg.norm(points, axis=2, keepdims=True)
    return points * rng.random((count, n, 1)) ** (1.0 / 3.0)


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.einsum("nd,nd->n", a, b)
