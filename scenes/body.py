"""The whole figure as one posed triangle mesh: head, ears, long hair, neck and shoulders."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.interpolate import PchipInterpolator

from scenes.chart import Face
from scenes.head import Expression, Pose
from scenes.surface import head_points, thinned

HEAD, SKIN, CLOTH, HAIR = 1, 2, 3, 4
NECK = np.array([0.0, -0.75, -0.22])  # centre of the head's rotation
BODY_FOLLOWS = 0.22


@dataclass(frozen=True)
class Body:
    """Vertices in the viewer's axes (head units, centre of the neutral head at the origin)."""

    points: np.ndarray
    """(n, 3) float64."""
    normals: np.ndarray
    """(n, 3) float64, unit length, outwards."""
    triangles: np.ndarray
    """(m, 3) int32."""
    coarse: np.ndarray
    """(about m / 4, 3) int32: every second row and column."""
    chart: np.ndarray
    """(n, 4) chart coordinates of skin and skull on the head; texture coordinates elsewhere."""
    part: np.ndarray
    """(n,) HEAD, SKIN, CLOTH or HAIR."""
    step: int
    """1 for the whole mesh; 2 for every second row and column of it, and so on."""


@dataclass(frozen=True)
class _Patch:
    """A grid of vertices with outward normals."""

    points: np.ndarray
    chart: np.ndarray
    part: int

    def thinned(self, step: int) -> "_Patch":
        return _Patch(thinned(self.points, step), thinned(self.chart, step), self.part)


def build_body(face: Face, pose: Pose, expression: Expression, step: int = 1) -> Body:
    """Pose the figure; the shoulders follow the head by a fraction.

    Small pictures need every ``step``-th row and column of the mesh only.
    """
    points, chart, skull = head_points(face, expression, step)
    moving = [_Patch(points, np.concatenate([chart, skull], axis=-1), HEAD)]
    still = [patch.thinned(step) for patch in _torso()]
    if face.traits.hair_style == "long":
        moving.append(_long_hair().thinned(step))
    else:
        half_width = face.profile.at(np.zeros(1))[0][0]
        moving += [ear.thinned(step) for ear in _ears(half_width)]
    placed = [(patch, pose.rotation()) for patch in moving] + [(patch, pose.rotation(BODY_FOLLOWS)) for patch in still]
    return _join(placed, step)


def turn(points: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """Rotate points (..., 3) about the neck."""
    return (points - NECK) @ rotation.T + NECK


def _join(placed: list[tuple[_Patch, np.ndarray]], step: int) -> Body:
    points, normals, charts, parts, triangles, coarse, count = [], [], [], [], [], [], 0
    for patch, rotation in placed:
        rows, columns = patch.points.shape[:2]
        points.append(turn(patch.points, rotation).reshape(-1, 3))
        normals.append((_normals(patch.points) @ rotation.T).reshape(-1, 3))
        charts.append(patch.chart.reshape(-1, 4))
        parts.append(np.full(rows * columns, patch.part))
        triangles.append(_grid_triangles(rows, columns) + count)
        coarse.append(_grid_triangles(rows, columns, 2) + count)
        count += rows * columns
    join = np.concatenate
    meshes = (join(triangles).astype(np.int32), join(coarse).astype(np.int32))
    return Body(join(points), join(normals), *meshes, join(charts), join(parts), step)


def _normals(points: np.ndarray) -> np.ndarray:
    """Outward normals of a grid whose rows go upwards and whose columns go around from left to right."""
    around, up = np.gradient(points, axis=1), np.gradient(points, axis=0)
    normals = np.cross(around, up)
    return normals / np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-12)


@lru_cache(maxsize=16)
def _grid_triangles(rows: int, columns: int, step: int = 1) -> np.ndarray:
    """Triangles (m, 3) of a grid, or of every ``step``-th row and column and the last ones."""
    index = np.arange(rows * columns, dtype=np.int32).reshape(rows, columns)
    index = thinned(index, step)
    a, b, c, d = (s.ravel() for s in (index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]))
    return np.concatenate([np.stack([a, b, c], -1), np.stack([b, d, c], -1)])


def _ears(half_width: float) -> list[_Patch]:
    """Two flattened, hollow shells, tilted back and outwards."""
    s, w = np.meshgrid(np.linspace(-np.pi, np.pi, 36), np.linspace(-1, 1, 24))
    ring = np.sqrt(np.clip(1 - w**2, 0, 1))
    hollow = 1 - 0.45 * np.exp(-((np.cos(s) - 1) ** 2 + (w - 0.1) ** 2) / 0.25)
    local = np.stack([0.055 * ring * np.sin(s), 0.245 * w * (np.ones_like(s)), 0.135 * ring * np.cos(s) * hollow], -1)
    ears = []
    for side in (-1.0, 1.0):
        out = side * 0.62
        turn_out = np.array([[np.cos(out), 0, np.sin(out)], [0, 1, 0], [-np.sin(out), 0, np.cos(out)]])
        points = local @ turn_out.T + (side * (half_width + 0.015), -0.16, -0.06)
        ears.append(_Patch(points, np.stack([s, w, s, w], -1), SKIN))
    return ears


def _torso() -> tuple[_Patch, _Patch]:
    """Neck, and a garment over the shoulders."""
    neck = [
        (-1.75, 0.60, 0.40, -0.30),
        (-1.45, 0.44, 0.40, -0.28),
        (-1.15, 0.375, 0.38, -0.25),
        (-0.6, 0.40, 0.40, -0.2),
    ]
    coat = [
        (-3.4, 1.85, 0.70, -0.36),
        (-2.2, 1.78, 0.66, -0.36),
        (-1.90, 1.56, 0.60, -0.36),
        (-1.72, 1.22, 0.54, -0.35),
        (-1.58, 0.86, 0.50, -0.33),
        (-1.46, 0.60, 0.475, -0.30),
        (-1.385, 0.50, 0.46, -0.28),
        (-1.375, 0.475, 0.43, -0.28),
        (-1.43, 0.465, 0.41, -0.28),
    ]
    return _Patch(*_tube(neck, 48, 40), SKIN), _Patch(*_tube(coat, 96, 90, dip=0.16), CLOTH)


def _tube(
    sections: list[tuple[float, ...]], rows: int, columns: int, dip: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Tube through elliptic sections (y, half width, half depth, z); its upper rim dips in front."""
    knots = np.arange(len(sections))
    t = np.linspace(0, knots[-1], rows)
    y, a, b, z = PchipInterpolator(knots, np.array(sections))(t).T[:, :, None]
    s = np.linspace(-np.pi, np.pi, columns)[None]
    fall = dip * np.clip(np.cos(s), 0, 1) ** 2 * (t[:, None] / knots[-1]) ** 2
    points = np.stack(np.broadcast_arrays(a * np.sin(s), y - fall, z + b * np.cos(s)), -1)
    flat = np.broadcast_to(s, points.shape[:2])
    return points, np.stack([flat, points[..., 1], flat, points[..., 1]], -1)


def _long_hair() -> _Patch:
    """A mantle of hair behind the face, down to the shoulders, in soft locks."""
    sections = [
        (-1.66, 0.10, 0.05, -0.52),
        (-1.62, 0.62, 0.24, -0.50),
        (-1.40, 0.80, 0.34, -0.48),
        (-1.00, 0.86, 0.46, -0.42),
        (-0.50, 0.845, 0.62, -0.34),
        (0.00, 0.85, 0.74, -0.30),
        (0.40, 0.83, 0.82, -0.24),
        (0.72, 0.71, 0.80, -0.18),
        (0.98, 0.50, 0.58, -0.14),
        (1.15, 0.22, 0.26, -0.12),
        (1.185, 0.0, 0.0, -0.12),
    ]
    points, chart = _tube(sections, 110, 150)
    s, y = chart[..., 0], chart[..., 1]
    locks = 1 + 0.018 * np.sin(17 * s + 2.5 * np.sin(2.2 * y)) + 0.012 * np.sin(41 * s + 3 * np.sin(1.7 * y + 1))
    return _Patch(points * np.stack([locks, np.ones_like(locks), locks], -1), chart, HAIR)
