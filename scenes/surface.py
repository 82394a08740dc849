"""The head's surface: maps chart points to positions in space, under an expression.

The displacement of the skin is interpolated between control points by radial basis functions, and linear in
the fields of `Expression`. Landmarks and mesh use the same function, so landmarks lie on the surface.
"""

from functools import lru_cache

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.spatial.distance import cdist

from scenes.anatomy import (
    LOWER_EDGE,
    UPPER_EDGE,
    head_profile,
    moves_of,
    neutral_landmarks,
    neutral_lip_line,
    pins,
)
from scenes.chart import (
    CHART_OPENING,
    PARTING,
    U_PER_RADIAN,
    Face,
    Profile,
    eye_opening,
    frontal_to_u,
    hair_depth,
    lip_curves,
    smoothstep,
    u_to_frontal,
)
from scenes.head import Expression, Head, traits_of

N_AROUND, N_UP = 208, 200
RBF_SUPPORT = 0.7
FLATNESS = 2.25


@lru_cache(maxsize=16)
def face_of(head: Head) -> Face:
    """Build the identity's geometry (cached)."""
    traits = traits_of(head)
    profile = head_profile(traits)
    neutral = neutral_landmarks(traits, profile)
    upper, lower = neutral_lip_line(traits)
    anchors = np.concatenate([neutral, upper, lower, pins(traits)])
    moves = moves_of(anchors, traits)
    anchors = anchors + CHART_OPENING * moves[:, 0, :2]
    centres = np.stack([frontal_to_u(anchors[:, 0], anchors[:, 1], profile), anchors[:, 1]], axis=-1)
    gram = _basis(centres, centres) + 1e-6 * np.eye(len(centres))
    coefficients = np.linalg.solve(gram, moves.reshape(len(centres), -1)).reshape(moves.shape)
    u, v = _mesh_grid(profile)
    fields = _basis(np.stack([u, v], -1).reshape(-1, 2), centres) @ coefficients.reshape(len(centres), -1)
    return Face(
        traits,
        profile,
        landmarks=anchors[:58],
        inner_upper=anchors[UPPER_EDGE],
        inner_lower=anchors[LOWER_EDGE],
        centres=centres,
        coefficients=coefficients,
        u=u,
        v=v,
        fields=fields.reshape(*u.shape, *moves.shape[1:]),
    )


def expression_vector(expression: Expression) -> np.ndarray:
    """Amounts (5,) of the displacement fields, relative to the chart's expression."""
    e = expression
    return np.array([e.mouth_open - CHART_OPENING, e.smile, e.brow_raise, e.eye_close, e.pucker])


def every(step: int, count: int) -> np.ndarray:
    """Every ``step``-th of so many rows or columns of a grid, and the last one."""
    return np.unique(np.r_[0:count:step, count - 1])


def thinned(grid: np.ndarray, step: int) -> np.ndarray:
    """Every ``step``-th row and column of a grid (rows, columns, ...), and the last ones."""
    rows, columns = grid.shape[:2]
    return grid[every(step, rows)][:, every(step, columns)]


def head_points(face: Face, expression: Expression, step: int = 1) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices (rows, columns, 3) in head axes, their chart positions (..., 2), and those of the skull below them.

    Of the mesh's ``N_UP`` rows and ``N_AROUND`` columns, every ``step``-th is taken.
    """
    u = thinned(face.u, step)
    v = thinned(face.v, step)
    shift = np.einsum("...ek,e->...k", thinned(face.fields, step), expression_vector(expression))
    points, skull = surface_points(face, u, v, shift, expression)
    return points, np.stack([u, v], -1), skull


def landmark_points(face: Face, expression: Expression) -> np.ndarray:
    """Landmarks (58, 3) on the surface, in head axes."""
    x, v = face.landmarks.T
    u = frontal_to_u(x, v, face.profile)
    basis = _basis(np.stack([u, v], -1), face.centres)
    shift = np.einsum("nc,cek,e->nk", basis, face.coefficients, expression_vector(expression))
    return surface_points(face, u, v, shift, expression)[0]


def surface_points(
    face: Face, u: np.ndarray, v: np.ndarray, shift: np.ndarray, expression: Expression
) -> tuple[np.ndarray, np.ndarray]:
    """Positions (..., 3) and skull coordinates (..., 2) of chart points under given shifts (..., 3)."""
    skull_u, skull_v = u + shift[..., 0], v + shift[..., 1]
    angle = skull_u / U_PER_RADIAN
    width, front, back = face.profile.at(v)
    height = _skin_relief(face, u, v, expression) + _skull_relief(face, skull_u, skull_v)
    # Relief is horizontal on the face and turns upwards on the crown.
    up = np.sin(np.pi / 2 * smoothstep((v - 0.45) / 0.65))
    out = height * np.sqrt(1 - up**2)
    x = (width + out) * np.sin(angle)
    z = np.where(np.cos(angle) > 0, front * _flattened(angle), back * np.cos(angle))
    z += out * np.cos(angle) + shift[..., 2]
    return np.stack([x, skull_v + height * up, z], axis=-1), np.stack([skull_u, skull_v], axis=-1)


def _flattened(angle: np.ndarray) -> np.ndarray:
    """Superelliptic version of the cosine, since a face is flatter than an ellipsoid."""
    return np.maximum(1 - np.abs(np.sin(angle)) ** FLATNESS, 0) ** (1 / FLATNESS)


def _mesh_grid(profile: Profile) -> tuple[np.ndarray, np.ndarray]:
    """Chart coordinates of the vertices; three quarters of the columns face the camera."""
    t = np.linspace(-1, 1, N_AROUND)
    angle = np.pi * (0.62 * t + 0.38 * t**5)
    length = np.cumsum(np.hypot(np.diff(profile.height), 0.6 * np.diff(profile.half_width)))
    at = np.concatenate([[0], length]) / length[-1]
    v = np.interp(np.linspace(0, 1, N_UP), at, profile.height)
    return np.meshgrid(U_PER_RADIAN * angle, v)


def _basis(points: np.ndarray, centres: np.ndarray) -> np.ndarray:
    """Wendland's compactly supported C2 function of the distances, (n_points, n_centres)."""
    r = cdist(points, centres) / RBF_SUPPORT
    near = np.maximum(1 - r, 0)
    for _ in range(2):
        np.square(near, out=near)  # many numbers: a power takes ten times as long
    r *= 4
    r += 1
    near *= r
    return near


# The relief: height over the base shape of the head, in head units, as a function of the chart.


def _skull_relief(face: Face, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Relief that does not move with expressions: sockets, eyeballs, brow ridge, cheekbones, temples."""
    t = face.traits
    x = np.abs(u_to_frontal(u, v, face.profile))
    relief = -0.085 * _bump(x, v, t.eye_x - 0.02, 0.030, 0.150, 0.085)
    relief -= 0.045 * _bump(x, v, 0.150, 0.03, 0.050, 0.080)
    relief += 0.062 * _bump(x, v, t.eye_x, 0.0, 0.100, 0.075)
    relief += 0.034 * _bump(x, v, t.eye_x, t.brow_height, 0.190, 0.055)
    relief += t.cheekbone * _bump(x, v, 0.43, -0.20, 0.160, 0.110)
    relief -= 0.045 * _bump(x, v, 0.47, -0.62, 0.140, 0.170)
    return relief - 0.030 * _bump(x, v, 0.68, 0.25, 0.120, 0.200)


def _skin_relief(face: Face, u: np.ndarray, v: np.ndarray, expression: Expression) -> np.ndarray:
    """Relief that moves with the skin: nose, lips, chin, folds and hair."""
    x = np.abs(u_to_frontal(u, v, face.profile))
    relief = _nose(face, x, v) + _lips(face, x, v) + _chin(face, x, v)
    smile = max(expression.smile, 0.0)
    relief += 0.030 * smile * _bump(x, v, 0.37, -0.34, 0.110, 0.090)
    relief -= (0.010 + 0.022 * smile) * _fold(face, x, v)
    front = np.abs(u) < U_PER_RADIAN * np.pi / 2
    relief += np.where(front, -0.012 * eye_opening(face, x, v), 0.0)
    thick = 0.075 + 0.06 * np.clip(v, 0, 1)
    if face.traits.hair_style == "long":
        thick = thick * (1 - 0.45 * np.exp(-(((u_to_frontal(u, v, face.profile) - PARTING) / 0.05) ** 2)))
    return relief + thick * smoothstep(hair_depth(face, u, v) / 0.26)


def _nose(face: Face, x: np.ndarray, v: np.ndarray) -> np.ndarray:
    t = face.traits
    base, out = -t.nose_length, t.nose_projection
    knots = np.array([base - 0.06, base - 0.025, base + 0.015, base + 0.065, base + 0.115, -0.15, 0.0, 0.10, 0.20])
    ridge = PchipInterpolator(knots, out * np.array([0, 0.10, 0.60, 0.97, 0.98, 0.52, 0.20, 0.14, 0.0]))
    half = PchipInterpolator(knots, np.array([0.50, 0.54, 0.60, 0.62, 0.56, 0.46, 0.36, 0.42, 0.60]) * 0.165)
    inside = np.clip(v, knots[0], knots[-1])
    relief = ridge(inside) * np.exp(-(np.abs(x / half(inside)) ** 2.3))
    relief += 0.095 * _bump(x, v, 0.72 * t.nose_width, base + 0.050, 0.046, 0.048)
    return relief - 0.05 * _bump(x, v, 0.42 * t.nose_width, base + 0.002, 0.030, 0.020)


def _lips(face: Face, x: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Two rolls between the edges of the lips, on the gentle dome of the teeth."""
    t = face.traits
    half = face.landmarks[43, 0]
    across = np.sqrt(np.clip(1 - (x / half) ** 2, 0, 1))
    inside = np.minimum(x, half)
    upper_out, upper_in, lower_in, lower_out = (c(np.minimum(inside, 0.999 * half)) for c in lip_curves(face))
    relief = 0.042 * across * _roll(v, upper_in, upper_out) + 0.052 * across * _roll(v, lower_out, lower_in)
    relief -= 0.03 * across * smoothstep((upper_in - v) / 0.03) * smoothstep((v - lower_in) / 0.03)
    relief += 0.045 * _bump(x, v, 0.0, t.mouth_y - 0.02, 0.30, 0.19)
    philtrum = 0.5 * (t.mouth_y - t.nose_length)
    return relief - 0.007 * _bump(x, v, 0.0, philtrum, 0.022, 0.055) + 0.004 * _bump(x, v, 0.05, philtrum, 0.02, 0.06)


def _roll(v: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    share = (v - low) / np.maximum(high - low, 1e-3)
    return np.where((share > -0.4) & (share < 1.4), np.cos(np.pi * (np.clip(share, -0.4, 1.4) - 0.5) / 1.8) ** 2, 0.0)


def _chin(face: Face, x: np.ndarray, v: np.ndarray) -> np.ndarray:
    chin, lip = face.landmarks[6, 1], face.landmarks[45, 1]
    relief = -0.050 * _bump(x, v, 0.0, lip - 0.075, 0.17, 0.045)
    return relief + 0.050 * _bump(x, v, 0.0, chin + 0.15, 0.15, 0.095)


def _fold(face: Face, x: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Nasolabial fold: a soft groove from the wing of the nose to beside the mouth."""
    t = face.traits
    top, bottom = -t.nose_length + 0.06, face.landmarks[39, 1]
    share = np.clip((top - v) / (top - bottom), 0, 1)
    line = (t.nose_width + 0.015) * (1 - share) + (t.mouth_half_width + 0.055) * share
    return (
        np.exp(-(((x - line) / 0.026) ** 2))
        * smoothstep((top + 0.04 - v) / 0.08)
        * smoothstep((v - bottom + 0.1) / 0.14)
    )


def _bump(x: np.ndarray, v: np.ndarray, cx: float, cv: float, sx: float, sv: float) -> np.ndarray:
    """Gaussian hill of height 1 at (cx, cv)."""
    return np.exp(-(((x - cx) / sx) ** 2) - ((v - cv) / sv) ** 2)
