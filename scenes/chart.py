"""The chart of a face: coordinates of the skin that do not depend on person and expression.

The chart has coordinates (u, v): v is the height y of the relaxed face, u = 0.75 s with s the angle about the
vertical axis. Two layers use it. The *skin* moves with the expression; the *skull* (eyeballs, teeth,
sockets) is fixed and visible through the openings of the skin. The chart has the mouth slightly open
(`CHART_OPENING`), so that closing the mouth only compresses the opening.
"""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import PchipInterpolator

from scenes.head import Traits

U_PER_RADIAN = 0.75
CHART_OPENING = 0.3
PARTING = 0.10  # where long hair is parted, frontal x

# The layout of the 58 landmarks is that of the IMM face database; "left" and "right" are the image's.
JAW, EYE_RIGHT, EYE_LEFT = range(13), range(13, 21), range(21, 29)
BROW_RIGHT, BROW_LEFT, MOUTH, NOSE = range(29, 34), range(34, 39), range(39, 47), range(47, 58)
CONTOURS: tuple[tuple[tuple[int, ...], bool], ...] = (
    (tuple(JAW), False),
    (tuple(EYE_RIGHT), True),
    (tuple(EYE_LEFT), True),
    (tuple(BROW_RIGHT), False),
    (tuple(BROW_LEFT), False),
    (tuple(MOUTH), True),
    (tuple(NOSE), False),
)


@dataclass(frozen=True)
class Profile:
    """Horizontal sections of the head: half width and half depths as functions of the height."""

    height: np.ndarray
    half_width: np.ndarray
    depth_front: np.ndarray
    depth_back: np.ndarray

    def at(self, v: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Half width, front depth and back depth at the heights ``v``."""
        return (
            np.interp(v, self.height, self.half_width),
            np.interp(v, self.height, self.depth_front),
            np.interp(v, self.height, self.depth_back),
        )


@dataclass(frozen=True)
class Face:
    """Geometry of one identity."""

    traits: Traits
    profile: Profile
    landmarks: np.ndarray
    """(58, 2) positions (x, y) of the landmarks in the chart's frontal view."""
    inner_upper: np.ndarray
    """(9, 2) lower edge of the upper lip, frontal view."""
    inner_lower: np.ndarray
    """(9, 2) upper edge of the lower lip, frontal view."""
    centres: np.ndarray
    """(n, 2) chart positions of the radial basis functions."""
    coefficients: np.ndarray
    """(n, 5, 3) coefficients (du, dv, dz) of these functions per field of `Expression`."""
    u: np.ndarray
    """(N_UP, N_AROUND) chart coordinate of the mesh's vertices."""
    v: np.ndarray
    """(N_UP, N_AROUND) chart coordinate of the mesh's vertices."""
    fields: np.ndarray
    """(N_UP, N_AROUND, 5, 3) displacement per unit of expression at the vertices."""


def frontal_to_u(x: np.ndarray, v: np.ndarray, profile: Profile) -> np.ndarray:
    """Chart coordinate u of a point at (x, v) in the frontal view."""
    ratio = x / np.maximum(profile.at(v)[0], 1e-6)
    return U_PER_RADIAN * np.arcsin(np.clip(ratio, -1, 1))


def u_to_frontal(u: np.ndarray, v: np.ndarray, profile: Profile) -> np.ndarray:
    """Inverse of `frontal_to_u`, continued monotonically around the back of the head."""
    angle = u / U_PER_RADIAN
    sine = np.where(np.abs(angle) <= np.pi / 2, np.sin(angle), np.sign(angle) * (2 - np.abs(np.sin(angle))))
    return profile.at(v)[0] * sine


def hair_depth(face: Face, u: np.ndarray, v: np.ndarray, ragged: float | np.ndarray = 0.0) -> np.ndarray:
    """Signed distance into the hair (positive inside), head units; ``ragged`` frays the hairline."""
    t = face.traits
    across = u_to_frontal(u, v, face.profile)
    x = np.abs(across)
    angle = np.abs(u) / U_PER_RADIAN
    if t.hair_style == "short":
        line = t.hairline + 0.05 * np.exp(-(((x - 0.38) / 0.14) ** 2)) - 1.3 * np.maximum(x - 0.30, 0) ** 1.8
    else:
        line = t.hairline + 0.03 - 1.05 * np.abs(across - PARTING) ** 1.9
    top = v - line
    end = -0.16 if t.hair_style == "short" else -0.45
    temple = 1.24 if t.hair_style == "short" else 1.36
    side = np.minimum(
        (angle - temple - 0.10 * np.sin(3 * v)) * U_PER_RADIAN,
        (v - end) * 0.8 + 0.25 * smoothstep((angle - 1.6) / 0.4),
    )
    return np.maximum(top, side) + ragged


def eye_opening(face: Face, x: np.ndarray, v: np.ndarray, soft: float = 0.012) -> np.ndarray:
    """Soft indicator of the opening between the lids; ``x`` is the distance from the mid-line."""
    upper, lower = eye_curves(face)
    inside = np.minimum(upper(x) - v, v - lower(x))
    ends = face.landmarks[[17, 13], 0]
    return smoothstep(0.5 + np.minimum(inside, np.minimum(x - ends[0], ends[1] - x)) / (2 * soft))


def eye_curves(face: Face) -> tuple[PchipInterpolator, PchipInterpolator]:
    """Upper and lower lid as functions of the distance from the mid-line."""
    eye = face.landmarks[list(EYE_RIGHT)]
    upper, lower = eye[[4, 3, 2, 1, 0]], eye[[4, 5, 6, 7, 0]]
    return PchipInterpolator(*upper.T), PchipInterpolator(*lower.T)


def lip_curves(face: Face) -> tuple[PchipInterpolator, ...]:
    """Outer upper, inner upper, inner lower and outer lower edges of the lips as functions of x."""
    mouth = face.landmarks[list(MOUTH)]
    first, last = mouth[:1], mouth[4:5]
    upper, lower = (np.concatenate([first, edge, last]) for edge in (face.inner_upper, face.inner_lower))
    return tuple(PchipInterpolator(*c.T) for c in (mouth[:5], upper, lower, mouth[[0, 7, 6, 5, 4]]))


def smoothstep(t: np.ndarray | float) -> np.ndarray:
    """Cubic step from 0 (t <= 0) to 1 (t >= 1)."""
    t = np.clip(t, 0.0, 1.0)
    return t * t * (3 - 2 * t)
