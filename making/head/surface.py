"""What a head is made of: skin, lips, brows, eyes, hair and clothes, painted on the vertices, and a wall behind it."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from matplotlib.path import Path as Polygon

from making.head.geometry import (
    FACE,
    GUMS_AND_TONGUE,
    HEAD_AND_NECK,
    MOUTH_SOCKET,
    TEETH,
    WHITES,
    ScannedHeads,
    normals_of,
)

FAIR = (0.62, 0.42, 0.33)
DARK = (0.13, 0.075, 0.05)
"""Share of light that the fairest and the darkest skin reflect: red, green, blue."""

GLOSS = 0.028
ROUGHNESS = 0.5
"""Of skin with the usual oil: share of light that it mirrors at right angles, and how rough that layer is."""

LIPS = (0.80, 0.55, 0.55)
"""The same of lips, as multiples of the skin's."""

EYE_WHITES = (0.55, 0.50, 0.47)
IRIS = 0.58
PUPIL = 0.22
"""Radii in the eye, cm."""

TEETH_WHITE = (0.55, 0.50, 0.42)
GUMS = (0.30, 0.12, 0.11)

BROWS = (slice(17, 22), slice(22, 27))
LASHES = (slice(36, 40), slice(42, 46))
"""Landmarks along brows and upper lids."""

BROW_HALF_WIDTH = 0.45
LASH_HALF_WIDTH = 0.15
"""Distances from these lines to the edges of hair, cm."""

COLLAR = -13.5
"""Height below which the mean head wears clothes, cm."""

EAR = 7.9
"""Distance of the ears from the middle of the mean head, cm."""

WALL = 400.0
"""Half the side of the wall, cm."""


@dataclass(frozen=True)
class Look:
    """How a person looks, beside the shape of the head.

    Attributes
    ----------
    skin : (float, float, float)
        Share of red, green and blue light that the skin reflects.
    hair : (float, float, float)
        The same of hair and brows.
    hairline : float
        Height of the hairline in the middle of the forehead of the mean head, cm.
    hair_depth : float
        Thickness of the hair, cm; 0 for a bald head.
    brows : float
        Share of the brows' area that hair covers, 0 to 1.
    beard : float
        The same of the area of a beard.
    oil : float
        Strength of the skin's gloss, 1 for what is usual.
    iris : (float, float, float)
        Share of light that the iris reflects.
    clothes, wall : (float, float, float)
        Share of light that they reflect.
    wall_distance : float
        Distance of the wall behind the head's origin, cm.
    """

    skin: tuple[float, float, float]
    hair: tuple[float, float, float]
    hairline: float
    hair_depth: float
    brows: float
    beard: float
    oil: float
    iris: tuple[float, float, float]
    clothes: tuple[float, float, float]
    wall: tuple[float, float, float]
    wall_distance: float


@dataclass(frozen=True, eq=False)
class Surface:
    """Everything that light meets.

    Attributes
    ----------
    vertices, normals : (n, 3) float64
    triangles : (m, 3) int32
    albedo : (n, 3) float32
        Share of red, green and blue light that is reflected in all directions.
    gloss : (n,) float32
        Share that a mirror-like layer reflects at right angles.
    roughness : (n,) float32
        Of that layer, 0 (mirror) to 1.
    scatters : (n,) float32
        1 where light goes through skin, 0 elsewhere.
    """

    vertices: np.ndarray
    normals: np.ndarray
    triangles: np.ndarray
    albedo: np.ndarray
    gloss: np.ndarray
    roughness: np.ndarray
    scatters: np.ndarray


def random_look(rng: np.random.Generator) -> Look:
    """Draw how a person looks."""
    darkness = rng.beta(1.1, 1.9)
    skin = np.exp((1 - darkness) * np.log(FAIR) + darkness * np.log(DARK))
    shade = np.exp(rng.uniform(np.log(0.02), np.log(0.25)))
    hair = shade * np.array([1.0, 0.8, 0.65]) * (1 - 0.7 * darkness)
    return Look(
        skin=tuple(skin * rng.uniform(0.9, 1.1, 3)),
        hair=tuple(hair),
        hairline=rng.uniform(9.3, 11.8),
        hair_depth=rng.uniform(0.3, 2.5),
        brows=rng.uniform(0.3, 1.0),
        beard=rng.uniform(0.2, 0.9) if rng.random() < 0.25 else 0.0,
        oil=rng.uniform(0.3, 1.3),
        iris=tuple(rng.uniform(0.03, 0.15) * np.array([1.0, 0.8, rng.uniform(0.6, 1.2)])),
        clothes=tuple(rng.uniform(0.03, 0.5, 3)),
        wall=tuple(rng.uniform(0.1, 0.7) * rng.uniform(0.8, 1.2, 3)),
        wall_distance=float(np.exp(rng.uniform(np.log(20.0), np.log(200.0)))),
    )


def dressed(heads: ScannedHeads, vertices: np.ndarray, look: Look, rng: np.random.Generator) -> Surface:
    """Give a head with vertices (n, 3) skin, hair and clothes, and put it in front of a wall."""
    hair = _hair(heads, look, rng)
    vertices = vertices + (look.hair_depth * hair)[:, None] * normals_of(vertices, heads.triangles)
    n = len(vertices)
    albedo = np.tile(np.array(look.skin, np.float32), (n, 1))
    gloss = np.full(n, GLOSS * look.oil, np.float32)
    roughness = np.full(n, ROUGHNESS, np.float32)
    scatters = np.ones(n, np.float32)

    lips = _lips(heads)
    albedo[lips] *= np.array(LIPS, np.float32)
    roughness[lips] = 0.3
    hairs = (
        look.brows * _near_lines(heads, BROWS, BROW_HALF_WIDTH),
        _near_lines(heads, LASHES, LASH_HALF_WIDTH),
        look.beard * _beard(heads),
        np.minimum(1.0, 3.0 * hair),
    )
    covered = np.maximum.reduce(hairs)
    albedo += covered[:, None] * (np.array(look.hair, np.float32) - albedo)
    gloss *= 1.0 - 0.5 * covered
    scatters *= 1.0 - covered
    _paint_eyes_and_mouth(heads, look, albedo, gloss, roughness, scatters)
    wears = (heads.vertices[:, 1] < COLLAR) & _in(n, FACE, HEAD_AND_NECK)
    albedo[wears] = look.clothes
    gloss[wears] = 0.0
    scatters[wears] = 0.0
    head = Surface(vertices, normals_of(vertices, heads.triangles), heads.triangles, albedo, gloss, roughness, scatters)
    return _before_wall(head, look)


def _before_wall(head: Surface, look: Look) -> Surface:
    """Add a wall behind a head."""
    z = -look.wall_distance
    corners = np.array([(-WALL, -WALL, z), (WALL, -WALL, z), (WALL, WALL, z), (-WALL, WALL, z)])
    n = len(head.vertices)
    return Surface(
        np.concatenate([head.vertices, corners]),
        np.concatenate([head.normals, np.tile((0.0, 0.0, 1.0), (4, 1))]),
        np.concatenate([head.triangles, np.array([(n, n + 1, n + 2), (n, n + 2, n + 3)], np.int32)]),
        np.concatenate([head.albedo, np.tile(np.array(look.wall, np.float32), (4, 1))]),
        np.append(head.gloss, np.zeros(4, np.float32)),
        np.append(head.roughness, np.ones(4, np.float32)),
        np.append(head.scatters, np.zeros(4, np.float32)),
    )


def _paint_eyes_and_mouth(heads: ScannedHeads, look: Look, albedo, gloss, roughness, scatters) -> None:
    """Paint what is not of skin, in place."""
    for part, colour in ((MOUTH_SOCKET, GUMS), (GUMS_AND_TONGUE, GUMS), (TEETH, TEETH_WHITE)):
        albedo[part] = colour
        roughness[part] = 0.3
    for part in WHITES:  # They enclose the irises, so these are painted on them.
        ball = heads.vertices[part].astype(np.float64)
        front = ball[ball[:, 2] > ball[:, 2].max() - 0.1].mean(axis=0)
        from_axis = np.linalg.norm((ball - front)[:, :2], axis=1)[:, None]
        is_front = (ball[:, 2] > ball[:, 2].mean())[:, None]
        albedo[part] = np.where(is_front & (from_axis < IRIS), look.iris, EYE_WHITES)
        albedo[part] = np.where(is_front & (from_axis < PUPIL), 0.01, albedo[part])
        gloss[part] = 0.03
        roughness[part] = 0.12
    scatters[MOUTH_SOCKET.start :] = 0.0


def _hair(heads: ScannedHeads, look: Look, rng: np.random.Generator) -> np.ndarray:
    """Return where hair grows, (n,) from 0 at its edge to 1, with bumps."""
    n = len(heads.vertices)
    if look.hair_depth <= 0:
        return np.zeros(n)
    x, y, z = heads.vertices.astype(np.float64).T
    above = y - (look.hairline - 0.035 * x**2)  # the forehead's edge is an arc, lower at the temples
    behind = np.minimum(2.0 - z + 0.1 * (y - 4.0), y - (1.0 if look.hairline > 10.5 else -3.0))
    depth = np.clip(np.maximum(above, behind) / 2.0, 0.0, 1.0)
    is_ear = (np.abs(x) > EAR - 0.6) & (y > -1.5) & (y < 5.5) & (z > -2.2) & (z < 2.6) & _in(n, FACE)
    depth[is_ear | ~_in(n, FACE, HEAD_AND_NECK)] = 0.0
    bumps = np.zeros(n)
    for _ in range(12):
        wave = rng.normal(size=3) * 1.2
        bumps += np.sin(heads.vertices @ wave + rng.uniform(0.0, 2.0 * np.pi))
    return depth * np.clip(1.0 + 0.12 * bumps, 0.3, 1.7)


def _in(n: int, *parts: slice) -> np.ndarray:
    """Whether each of n vertices is in one of the parts."""
    inside = np.zeros(n, bool)
    for part in parts:
        inside[part] = True
    return inside


def _lips(heads: ScannedHeads) -> np.ndarray:
    """Whether each vertex is of the lips."""
    points = heads.vertices[heads.landmarks]
    outline = Polygon(points[48:60, :2])
    inside = outline.contains_points(heads.vertices[:, :2])
    return inside & (heads.vertices[:, 2] > points[48:60, 2].min() - 0.5) & _in(len(heads.vertices), FACE)


def _near_lines(heads: ScannedHeads, lines: Sequence[slice], half_width: float) -> np.ndarray:
    """Return how near vertices are to lines of landmarks, 1 within a distance in cm to 0 outside, (n,) float."""
    points = heads.vertices[heads.landmarks].astype(np.float64)
    nearest = np.full(len(heads.vertices), np.inf)
    for line in lines:
        for start, end in pairwise(points[line]):
            step = end - start
            along = np.clip((heads.vertices - start) @ step / np.sum(step**2), 0.0, 1.0)
            foot = start + along[:, None] * step
            nearest = np.minimum(nearest, np.linalg.norm(heads.vertices - foot, axis=1))
    near = np.clip(1.5 - nearest / half_width, 0.0, 1.0)
    near[FACE.stop :] = 0.0
    return near


def _beard(heads: ScannedHeads) -> np.ndarray:
    """Return where a beard grows, 1 within to 0 outside, (n,) float."""
    x, y, z = heads.vertices.astype(np.float64).T
    lip = heads.vertices[heads.landmarks[33]]  # below the nose
    low = np.clip((lip[1] - 0.2 - y - 0.02 * x**2 + 0.09 * np.maximum(0.0, np.abs(x) - 3.0) ** 2) / 0.8, 0.0, 1.0)
    grows = low * np.clip((y + 10.0) / 1.5, 0.0, 1.0) * (z > 0.5)
    grows[_lips(heads)] = 0.0
    grows[FACE.stop :] = 0.0
    return grows
