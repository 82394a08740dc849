"""Heads under lamps: random persons before random walls, photographed under a training light and other lamps."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np

from liaam.datasets import Sample
from liaam.io import Landmarks
from making.head.geometry import ScannedHeads, random_identity
from making.head.light import Light
from making.head.photographs import Development, brightness, face_in
from making.head.render import Camera, View
from making.head.surface import dressed, random_look

TURNS = (0.12, 0.10, 0.03)
"""Standard deviations of yaw, pitch and roll of heads, radians."""

EYES_CLOSED = (0.1, 0.5)
"""Range of how far eyes are closed: those of the mean head are wide open."""

SKIN_LEVEL = (0.35, 0.75)
"""Range of the brightness of faces in a picture, linear."""

EXPOSURE = (-0.3, 0.4)
"""Mean and standard deviation of the logarithm of the face's brightness under a lamp, relative to the training light:
cameras adapt to the light, but not fully."""


@dataclass(frozen=True, eq=False)
class Sitter:
    """A person before a camera, and how the camera develops pictures.

    Attributes
    ----------
    view : View
    points : (68, 2) float64
        Landmarks in pictures.
    development : Development
    level : float
        Brightness of the face under the training light, linear.
    """

    view: View
    points: np.ndarray
    development: Development
    level: float

    def photographed(self, light: Light, adaption: float, rng: np.random.Generator) -> np.ndarray:
        """Return the picture (h, w, 3) uint8 under a light, with the face exp(adaption) times as bright as usual."""
        linear = self.view.under(light)
        gain = self.level * np.exp(adaption) / brightness(linear, face_in(linear.shape, self.points))
        return self.development.stored(gain * linear, rng)


def sitter(heads: ScannedHeads, rng: np.random.Generator, size: int, looks: Mapping[str, Any] | None = None) -> Sitter:
    """Draw a person and a camera whose pictures have a width and height.

    ``looks`` are fields of :class:`Look` that are not drawn.
    """
    look = replace(random_look(rng), **(looks or {}))
    closed = rng.uniform(*EYES_CLOSED)
    expression = {"eyeBlink_L": closed, "eyeBlink_R": closed}
    vertices = heads.shaped(random_identity(rng), expression) @ rotation(*rng.normal(size=3) * TURNS).T
    surface = dressed(heads, vertices, look, rng)
    view = View(surface, Camera(size=size, distance=rng.uniform(90.0, 250.0)), rng)
    points = view.camera.seen_at(surface.vertices[heads.landmarks])
    development = Development(contrast=rng.uniform(0.0, 0.6), black=rng.uniform(0.0, 0.02))
    return Sitter(view, points, development, rng.uniform(*SKIN_LEVEL))


def under_lamps(
    heads: ScannedHeads, name: str, before: Light, lights: Sequence[Light], rng: np.random.Generator, size: int
) -> Iterator[Sample]:
    """Photograph a random person under the training light, ``NAME-00``, and under lamps, ``NAME-01`` and so on."""
    person = sitter(heads, rng, size)
    landmarks = Landmarks(person.points)
    yield Sample(f"{name}-00", person.photographed(before, 0.0, rng), landmarks)
    for i, light in enumerate(lights, 1):
        yield Sample(f"{name}-{i:02d}", person.photographed(light, rng.normal(*EXPOSURE), rng), landmarks)


def rotation(yaw: float, pitch: float, roll: float) -> np.ndarray:
    """Return the matrix (3, 3) that turns a head to its left, downwards and to its right shoulder, by radians."""
    return (
        cv2.Rodrigues(np.array([0.0, 0.0, roll]))[0]
        @ cv2.Rodrigues(np.array([pitch, 0.0, 0.0]))[0]
        @ (cv2.Rodrigues(np.array([0.0, yaw, 0.0]))[0])
    )
