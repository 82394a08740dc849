"""The head's surface: maps chart points to positions in space, under an expression.

The displacement of the skin is interpolated between control points by radial basis functions, and linear in
the fields of `Expression`. Landmarks and mesh use the same function, so landmarks lie on the surface.
"""

from functools import lru_cache

import numpy as np

from liaam.datasets.scenes.anatomy import (
    LOWER_EDGE,
    UPPER_EDGE,
    head_profile,
    moves_of,
    neutral_landmarks,
    neutral_lip_line,
    pins,
)
from liaam.datasets.scenes.chart import CHART_OPENING, U_PER_RADIAN, Face, Profile, frontal_to_u, smoothstep
from liaam.datasets.scenes.head import Expression, Head, traits_of
from liaam.datasets.scenes.relief import skin_relief, skull_relief

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


def head_points(face: Face, expression: Expression) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (N_UP, N_AROUND, 3) in head axes, and the chart positions (..., 2) of the skull below them."""
    shift = np.einsum("...ek,e->...k", face.fields, expression_vector(expression))
    return surface_points(face, face.u, face.v, shift, expression)


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
    height = skin_relief(face, u, v, expression) + skull_relief(face, skull_u, skull_v)
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
    r = np.linalg.norm(points[:, None] - centres[None], axis=-1) / RBF_SUPPORT
    return np.maximum(1 - r, 0) ** 4 * (4 * r + 1)
