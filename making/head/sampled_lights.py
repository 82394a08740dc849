"""Lights to train with: those under which people photograph faces to train on, and others that span light."""

import numpy as np
from scipy.stats import qmc

from making.head.light import Lamp, Light, Room

AZIMUTHS = (-95.0, 95.0)
ELEVATIONS = (-25.0, 60.0)
"""Ranges of the lamps' directions, degrees."""

DISTANCES = (60.0, 300.0)
RADII = (2.0, 40.0)
"""Ranges of their distances and sizes, cm; they are drawn in proportion, as are all ranges below."""

LARGEST = 0.4
"""Largest radius of a lamp as a fraction of its distance."""

TEMPERATURES = (2800.0, 8000.0)
ROOM_TEMPERATURES = (4000.0, 9000.0)
"""Ranges of colour temperatures, kelvin."""

ROOMS = (0.07, 0.7)
"""Range of the strength of the room's light, that of the lamp being 1."""

ROOM_AXES = (0.0, 0.8)
"""Range of how much more of the room's light comes from above than from the side."""

PAIRS = 0.2
"""Share of lights with a second lamp on the other side."""

PAIRED_AZIMUTHS = (20.0, 90.0)
PAIRED_ELEVATIONS = (-10.0, 45.0)
PAIRED_STRENGTHS = (0.2, 0.9)
"""Ranges of the direction, degrees, and strength of the second lamp."""

COORDINATES = 13
"""Number of coordinates of a light."""


def training_light(rng: np.random.Generator) -> Light:
    """Draw a light under which training images are taken: a flash, two screens, or a large one and a bright room."""
    above = float(rng.uniform(0.0, 0.6))
    kind = rng.choice(("flash", "two screens", "bright room"))
    if kind == "flash":
        lamps = (Lamp(rng.uniform(-0.1, 0.1), rng.uniform(0.0, 0.3), distance=170.0),)
        return Light(lamps, Room(rng.uniform(0.1, 0.5), (0.0, above, 0.0)))
    if kind == "two screens":
        elevation = rng.uniform(0.1, 0.6)
        sides = (-rng.uniform(0.5, 0.9), rng.uniform(0.5, 0.9))
        lamps = tuple(Lamp(side, elevation, distance=150.0, radius=35.0, strength=0.6) for side in sides)
        return Light(lamps, Room(rng.uniform(0.3, 0.7), (0.0, above, 0.0)))
    lamps = (Lamp(rng.uniform(-0.3, 0.3), rng.uniform(0.1, 0.6), distance=150.0, radius=50.0),)
    return Light(lamps, Room(rng.uniform(0.3, 1.0), (0.0, above, 0.0)))


def spread_lights(n: int) -> list[Light]:
    """Return n lights whose directions, sizes, colours and rooms are spread evenly, by Halton's sequence."""
    points = qmc.Halton(COORDINATES, rng=np.random.default_rng(0)).random(n)
    return [spread_light(point) for point in points]


def spread_light(point: np.ndarray) -> Light:
    """Return the light at a point (COORDINATES,) of the unit cube."""
    share = iter(point)
    azimuth = np.deg2rad(between(AZIMUTHS, next(share)))
    elevation = np.deg2rad(between(ELEVATIONS, next(share)))
    distance = in_proportion(DISTANCES, next(share))
    radius = min(in_proportion(RADII, next(share)), LARGEST * distance)
    lamps = [Lamp(azimuth, elevation, distance, radius, 1.0, in_proportion(TEMPERATURES, next(share)))]
    axis = (0.0, between(ROOM_AXES, next(share)), 0.0)
    room = Room(in_proportion(ROOMS, next(share)), axis, in_proportion(ROOM_TEMPERATURES, next(share)))
    if next(share) < PAIRS:
        other_azimuth = -np.sign(azimuth) * np.deg2rad(between(PAIRED_AZIMUTHS, next(share)))
        other_elevation = np.deg2rad(between(PAIRED_ELEVATIONS, next(share)))
        strength = between(PAIRED_STRENGTHS, next(share))
        temperature = in_proportion(TEMPERATURES, next(share))
        lamps.append(Lamp(other_azimuth, other_elevation, strength=strength, temperature=temperature))
    return Light(tuple(lamps), room)


def between(ends: tuple[float, float], share: float) -> float:
    """Return the number at a share of the way from one end to the other."""
    return float(ends[0] + (ends[1] - ends[0]) * share)


def in_proportion(ends: tuple[float, float], share: float) -> float:
    """Do the same on a logarithmic scale."""
    return float(ends[0] * (ends[1] / ends[0]) ** share)
