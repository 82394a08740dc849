"""Positions of the features of a neutral face, and their displacements by each expression."""

import numpy as np
from scipy.interpolate import PchipInterpolator

from scenes.chart import CHART_OPENING, EYE_LEFT, EYE_RIGHT, JAW, MOUTH, Profile
from scenes.head import Traits

LIP_LINE = np.array([-0.96, -0.82, -0.60, -0.30, 0.0, 0.30, 0.60, 0.82, 0.96])

# Control points of an expression: the 58 landmarks, both edges of the lips' opening, and pins on either side.
UPPER_EDGE, LOWER_EDGE = slice(58, 67), slice(67, 76)
LID, BELOW_EYE, CHEEK, BELOW_LIP, JOWL = ([76 + i, 86 + i] for i in range(5, 10))


def head_profile(t: Traits) -> Profile:
    """Sections of the skull; knots from crown to chin, smooth in the knot's index."""
    crown, chin = 1.10, t.chin - 0.15 * CHART_OPENING
    drop = lambda d: chin + d  # noqa: E731
    knots = np.array(
        [  # height, half width, front, back
            (crown, 0.0, 0.0, 0.0),
            (1.065, 0.24, 0.26, 0.32),
            (0.95, 0.445, 0.49, 0.58),
            (0.72, 0.620, 0.70, 0.82),
            (0.40, 0.720, 0.82, 0.94),
            (0.10, t.width, 0.85, 0.95),
            (-0.20, 0.5 * (t.width + 0.715), 0.855, 0.86),
            (-0.48, 0.5 * (t.jaw + 0.70), 0.865, 0.68),
            (-0.72, t.jaw - 0.015, 0.865, 0.50),
            (drop(0.22), t.jaw - 0.135, 0.845, 0.40),
            (drop(0.10), t.jaw - 0.255, 0.82, 0.30),
            (drop(0.03), 0.5 * t.jaw - 0.05, 0.74, 0.22),
            (drop(-0.01), 0.5 * t.jaw - 0.14, 0.56, 0.16),
            (drop(-0.02), 0.0, 0.0, 0.0),
        ]
    )
    dense = np.linspace(0, len(knots) - 1, 1200)
    curves = PchipInterpolator(np.arange(len(knots)), knots)(dense)[::-1]
    return Profile(*np.ascontiguousarray(curves.T))


def neutral_landmarks(t: Traits, profile: Profile) -> np.ndarray:
    """The 58 landmarks (x, y) of the neutral face in frontal view; the face is symmetric."""
    chin = t.chin
    jaw_y = np.array([-0.36, -0.54, -0.72, -0.87, -0.99, chin + 0.055, chin + 0.025])
    jaw_y[:5] = -0.36 + (jaw_y[:5] + 0.36) * (chin + 0.14 + 0.36) / (-0.99 + 0.36)
    share = np.array([0.955, 0.95, 0.94, 0.92, 0.85, 0.55, 0.0])
    jaw = np.stack([-share * profile.at(jaw_y)[0], jaw_y], -1)
    w, h, slant = t.eye_half_width, t.eye_height, t.eye_slant
    eye = np.array([(1, 0.2), (0.55, 0.78), (0, 1), (-0.55, 0.66), (-1, -0.2)])
    eye = np.concatenate([eye, [(-0.5, -0.62), (0, -0.8), (0.55, -0.62)]]) * (w, h)
    eye += np.stack([np.full(8, t.eye_x), eye[:, 0] / w * slant], -1)
    brow_x = np.array([-0.170, -0.06, 0.06, 0.15, 0.215]) + t.eye_x
    brow_y = t.brow_height + t.brow_arch * np.array([0.0, 0.5, 1.0, 0.8, -0.3])
    brow = np.stack([brow_x, brow_y], -1)
    m, y = t.mouth_half_width, t.mouth_y
    upper = np.array([(-m, y + 0.008), (-0.42 * m, y + 0.92 * t.lip_upper), (0, y + 0.84 * t.lip_upper)])
    lower = np.array([(0.48 * m, y - 0.86 * t.lip_lower), (0, y - t.lip_lower)])
    mirror = np.array([-1.0, 1.0])
    mouth = np.concatenate([upper, upper[1::-1] * mirror, lower, lower[:1] * mirror])
    n, b = t.nose_width, -t.nose_length
    side = np.array([(-0.092, 0.0), (-0.108, -0.17), (-0.93 * n, b + 0.13), (-n, b + 0.045), (-0.56 * n, b + 0.0)])
    nose = np.concatenate([side, [(0, b - 0.022)], side[::-1] * mirror])
    return np.concatenate([jaw, jaw[-2::-1] * mirror, eye, eye * mirror, brow, brow * mirror, mouth, nose])


def neutral_lip_line(t: Traits) -> tuple[np.ndarray, np.ndarray]:
    """Both edges of the closed mouth's opening, (9, 2) each."""
    share = LIP_LINE
    x = t.mouth_half_width * share
    bow = t.mouth_y + 0.008 * share**4 + 0.006 * np.cos(1.5 * np.pi * share) * (1 - share**2)
    return np.stack([x, bow + 0.001], -1), np.stack([x, bow - 0.001], -1)


def pins(t: Traits) -> np.ndarray:
    """Additional points with prescribed displacements, (n, 2); the constants above name them."""
    half = np.array(
        [
            (0.20, 0.50),
            (0.50, 0.45),
            (0.68, 0.15),
            (0.69, -0.10),
            (0.08, 0.08),
            (t.eye_x, 0.110),
            (t.eye_x, -0.130),
            (0.40, -0.34),
            (0.05, t.mouth_y - 0.18),
            (0.46, -0.60),
        ]
    )
    return np.concatenate([half, half * (-1, 1)])


def moves_of(p: np.ndarray, t: Traits) -> np.ndarray:
    """Displacements (n, 5, 3) of the control points ``p`` (n, 2) per unit of each field of `Expression`."""
    moves = np.zeros((len(p), 5, 3))
    _open_mouth(moves[:, 0], p, t)
    _smile(moves[:, 1], p, t)
    _raise_brows(moves[:, 2], p, t)
    _close_eyes(moves[:, 3], p)
    _pucker(moves[:, 4], p, t)
    return moves


def _open_mouth(d: np.ndarray, p: np.ndarray, t: Traits) -> None:
    jaw = [*JAW, *BELOW_LIP, *JOWL]
    fall = np.clip((-0.42 - p[jaw, 1]) / (-0.42 - t.chin), 0, 1)
    d[jaw, 1], d[jaw, 2] = -0.15 * fall, -0.05 * fall
    d[BELOW_LIP, 1] = -0.16
    d[list(MOUTH), 1] = (-0.055, 0.012, 0.016, 0.012, -0.055, -0.155, -0.175, -0.155)
    d[list(MOUTH), 0] = (0.022, 0.005, 0, -0.005, -0.022, -0.012, 0, 0.012)
    dome = 1 - LIP_LINE**2
    d[UPPER_EDGE, 1] = 0.016 - 0.071 * (1 - dome) ** 2.5
    d[LOWER_EDGE, 1] = d[UPPER_EDGE, 1] - 0.195 * dome**0.8
    d[UPPER_EDGE, 0] = d[LOWER_EDGE, 0] = -0.022 * LIP_LINE


def _smile(d: np.ndarray, p: np.ndarray, t: Traits) -> None:
    lips = [*MOUTH, *range(58, 76)]
    across = np.clip(p[lips, 0] / t.mouth_half_width, -1, 1)
    d[lips, 0] = 0.070 * across
    d[lips, 1] = 0.075 * np.abs(across) ** 1.6 + 0.010
    d[lips, 2] = -0.030
    sides = np.r_[49:52, 53:56]
    d[sides, 0], d[sides, 1] = 0.014 * np.sign(p[sides, 0]), 0.010
    d[[18, 19, 20, 26, 27, 28], 1] = 0.012
    for cheek in CHEEK:
        d[cheek] = (0.02 * np.sign(p[cheek, 0]), 0.045, 0.01)
    d[BELOW_EYE, 1] = 0.020


def _raise_brows(d: np.ndarray, p: np.ndarray, t: Traits) -> None:
    d[29:34, 1] = d[34:39, 1] = (0.050, 0.066, 0.072, 0.066, 0.046)
    d[29:39, 0] = 0.012 * np.sign(p[29:39, 0])
    d[LID, 1] = 0.030
    d[[14, 15, 16, 22, 23, 24], 1] = 0.008


def _close_eyes(d: np.ndarray, p: np.ndarray) -> None:
    """Upper lids come down almost to the lower ones, which rise a little."""
    for first in (EYE_RIGHT.start, EYE_LEFT.start):
        upper, lower = first + np.array([1, 2, 3]), first + np.array([7, 6, 5])
        d[lower, 1] = 0.006
        d[upper, 1] = 0.006 - 0.94 * (p[upper, 1] - p[lower, 1])
    d[LID, 1] = -0.026


def _pucker(d: np.ndarray, p: np.ndarray, t: Traits) -> None:
    lips = [*MOUTH, *range(58, 76)]
    across = p[lips, 0] / t.mouth_half_width
    d[lips, 0] = -0.085 * across
    d[lips, 1] = 0.10 * (p[lips, 1] - t.mouth_y)
    d[lips, 2] = 0.055
