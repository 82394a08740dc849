"""Light: lamps of any size, near and far, and light from all around."""

from dataclasses import dataclass

import numpy as np

FACE_CENTRE = np.array([0.0, 0.0, 9.0])
"""Where the strength of lamps is measured: about the middle of a face, cm."""

WAVELENGTHS_NM = np.array([610.0, 540.0, 465.0])
"""Of the camera's red, green and blue."""

K2_NM = 1.438776877e7
"""Second radiation constant, nm K."""

WHITE_K = 5500.0
"""Temperature of the light whose colour is (1, 1, 1), kelvin."""


@dataclass(frozen=True)
class Lamp:
    """A lamp like a ball that shines evenly.

    Attributes
    ----------
    azimuth, elevation : float
        Direction from the face: to the right of the image, and upwards, radians.
    distance : float
        From the middle of the face, cm.
    radius : float
        Of the ball, cm.
    strength : float
        Irradiance of a surface in the middle of the face that is turned towards the lamp.
    temperature : float
        Colour temperature, kelvin.
    """

    azimuth: float
    elevation: float
    distance: float = 200.0
    radius: float = 5.0
    strength: float = 1.0
    temperature: float = WHITE_K

    @property
    def position(self) -> np.ndarray:
        """Centre of the lamp (3,), cm."""
        towards = (
            np.sin(self.azimuth) * np.cos(self.elevation),
            np.sin(self.elevation),
            np.cos(self.azimuth) * np.cos(self.elevation),
        )
        return FACE_CENTRE + self.distance * np.array(towards)


@dataclass(frozen=True)
class Room:
    """Light from all around.

    Attributes
    ----------
    strength : float
        Irradiance of an open surface, if the light comes from everywhere alike.
    axis : (float, float, float)
        Direction from which most of it comes, and by how much more than on average at its end; zeros for no difference.
    temperature : float
        Colour temperature, kelvin.
    """

    strength: float = 0.1
    axis: tuple[float, float, float] = (0.0, 0.5, 0.0)
    temperature: float = WHITE_K

    def radiance(self, directions: np.ndarray) -> np.ndarray:
        """Return the light that comes from unit directions (..., 3), (..., 3) in RGB."""
        level = self.strength / np.pi * np.maximum(1.0 + directions @ np.array(self.axis), 0.0)
        return level[..., None] * colour_of(self.temperature)


@dataclass(frozen=True)
class Light:
    """Lamps in a room."""

    lamps: tuple[Lamp, ...]
    room: Room


def colour_of(kelvin: float) -> np.ndarray:
    """Return the RGB colour (3,) of a glowing body, by Wien's law: green is 1."""
    mired = 1.0 / kelvin - 1.0 / WHITE_K
    red, green, blue = np.exp(-K2_NM / WAVELENGTHS_NM * mired)
    return np.array([red / green, 1.0, blue / green])
