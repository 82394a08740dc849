"""The subject of an image: identity, pose and expression.

Lengths are *head units* of about 10 cm (the pupils are 0.62 apart) and the axes those of the viewer: x to the
right of the image, y up, z towards the camera; the origin lies inside the head at eye level.
"""

from dataclasses import dataclass, fields
from typing import Literal

import numpy as np

from liaam.errors import LiaamError

HairStyle = Literal["short", "long"]


@dataclass(frozen=True)
class Head:
    """A person. Every trait is drawn from ``seed``; a given trait overrides the drawn one.

    Attributes
    ----------
    seed : int
        Identity.
    skin : float, optional
        Depth of the skin's tone, 0 (fair) to 1 (dark).
    hair : {"short", "long"}, optional
        Hair style.
    stubble : float, optional
        Density of the stubble, 0 to 1.
    """

    seed: int = 0
    skin: float | None = None
    hair: HairStyle | None = None
    stubble: float | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.seed, int | np.integer) or self.seed < 0:
            raise LiaamError(f"Head.seed is {self.seed!r}: give an integer of at least 0")
        if self.hair not in (None, "short", "long"):
            raise LiaamError(f"Head.hair is {self.hair!r}: give 'short', 'long' or None (drawn from the seed)")
        for name in ("skin", "stubble"):
            if getattr(self, name) is not None:
                _check_range("Head", name, getattr(self, name), 0.0, 1.0)


@dataclass(frozen=True)
class Pose:
    """Pose of the head: rotation in radians, size relative to the portrait framing, shift in pixels.

    Attributes
    ----------
    yaw : float
        Rotation of the face towards the right of the image.
    pitch : float
        Rotation of the face upwards.
    roll : float
        Tilt of the head, clockwise in the image.
    scale : float
        Size; at 1 the head covers about three quarters of the image's height.
    x : float
        Shift to the right, pixels.
    y : float
        Shift downwards, pixels.
    """

    yaw: float = 0.0
    pitch: float = 0.0
    roll: float = 0.0
    scale: float = 1.0
    x: float = 0.0
    y: float = 0.0

    def __post_init__(self) -> None:
        for name in ("yaw", "pitch", "roll"):
            _check_range("Pose", name, getattr(self, name), -0.6, 0.6)
        _check_range("Pose", "scale", self.scale, 0.2, 3.0)
        _check_range("Pose", "x", self.x, -1e4, 1e4)
        _check_range("Pose", "y", self.y, -1e4, 1e4)

    def rotation(self, amount: float = 1.0) -> np.ndarray:
        """Rotation matrix (3, 3) from head axes to the viewer's, by a fraction ``amount`` of the angles."""
        (cy, cp, cr), (sy, sp, sr) = (
            f(amount * np.array([self.yaw, -self.pitch, -self.roll])) for f in (np.cos, np.sin)
        )
        yaw = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
        pitch = np.array([[1, 0, 0], [0, cp, -sp], [0, sp, cp]])
        roll = np.array([[cr, -sr, 0], [sr, cr, 0], [0, 0, 1]])
        return roll @ yaw @ pitch


@dataclass(frozen=True)
class Expression:
    """Expression of the face; all zeros is the neutral face.

    Attributes
    ----------
    mouth_open : float
        0 (closed) to 1 (wide open).
    smile : float
        -1 (corners down) to 1 (smile).
    brow_raise : float
        -1 (lowered) to 1 (raised).
    eye_close : float
        0 (open) to 1 (closed).
    pucker : float
        0 (relaxed) to 1 (lips pushed together).
    """

    mouth_open: float = 0.0
    smile: float = 0.0
    brow_raise: float = 0.0
    eye_close: float = 0.0
    pucker: float = 0.0

    def __post_init__(self) -> None:
        for field in fields(self):
            low = -1.0 if field.name in ("smile", "brow_raise") else 0.0
            _check_range("Expression", field.name, getattr(self, field.name), low, 1.0)


@dataclass(frozen=True)
class Traits:
    """Measurements of one person: lengths in head units, colours in linear RGB."""

    width: float
    jaw: float
    chin: float
    cheekbone: float
    eye_x: float
    eye_half_width: float
    eye_height: float
    eye_slant: float
    brow_height: float
    brow_arch: float
    brow_thickness: float
    nose_length: float
    nose_width: float
    nose_projection: float
    mouth_y: float
    mouth_half_width: float
    lip_upper: float
    lip_lower: float
    hairline: float
    skin: float
    redness: float
    freckles: float
    stubble: float
    hair_style: HairStyle
    hair_colour: tuple[float, float, float]
    iris_colour: tuple[float, float, float]
    cloth_colour: tuple[float, float, float]
    wall_colour: tuple[float, float, float]


HAIR_COLOURS = ((0.035, 0.026, 0.022), (0.075, 0.042, 0.025), (0.16, 0.085, 0.042), (0.36, 0.22, 0.10))
IRIS_COLOURS = ((0.10, 0.045, 0.02), (0.16, 0.09, 0.035), (0.13, 0.15, 0.07), (0.12, 0.20, 0.30))
CLOTH_COLOURS = (
    (0.10, 0.15, 0.26),
    (0.27, 0.10, 0.09),
    (0.12, 0.20, 0.15),
    (0.32, 0.30, 0.27),
    (0.16, 0.15, 0.17),
)
WALL_COLOURS = ((0.24, 0.28, 0.31), (0.30, 0.28, 0.25), (0.22, 0.27, 0.25), (0.26, 0.25, 0.29))


def traits_of(head: Head) -> Traits:
    """Draw the measurements of a person from the seed."""
    rng = np.random.default_rng([head.seed, 0x4EAD])
    vary = lambda mean, spread: float(mean + spread * np.clip(rng.normal(), -1.8, 1.8))  # noqa: E731
    skin = float(rng.beta(1.3, 1.9))
    feminine = bool(rng.random() < 0.5)
    style: HairStyle = head.hair or ("long" if feminine else "short")
    skin = skin if head.skin is None else float(head.skin)
    # Dark skin rarely comes with fair hair or eyes.
    lightest = 4 if skin < 0.35 else 3 if skin < 0.55 else 1
    stubble = 0.0 if style == "long" else float(rng.uniform(0, 1) * rng.integers(0, 2))
    return Traits(
        width=vary(0.745, 0.018),
        jaw=vary(0.555 if style == "long" else 0.605, 0.02),
        chin=vary(-1.10 if style == "long" else -1.14, 0.028),
        cheekbone=vary(0.035, 0.012),
        eye_x=vary(0.312, 0.010),
        eye_half_width=vary(0.142, 0.006),
        eye_height=vary(0.058, 0.005),
        eye_slant=vary(0.010, 0.008),
        brow_height=vary(0.180 if style == "long" else 0.165, 0.012),
        brow_arch=vary(0.040 if style == "long" else 0.026, 0.008),
        brow_thickness=vary(0.034 if style == "long" else 0.043, 0.004),
        nose_length=vary(0.445, 0.022),
        nose_width=vary((0.152 if style == "long" else 0.168) + 0.03 * skin, 0.010),
        nose_projection=vary(0.27, 0.022),
        mouth_y=vary(-0.66, 0.012),
        mouth_half_width=vary(0.255, 0.014),
        lip_upper=vary(0.060 + 0.018 * skin, 0.007),
        lip_lower=vary(0.084 + 0.018 * skin, 0.007),
        hairline=vary(0.66, 0.035),
        skin=skin,
        redness=vary(1.0, 0.25),
        freckles=float(rng.uniform(0.3, 1.0) * (rng.random() < 0.35) * (skin < 0.4)),
        stubble=stubble if head.stubble is None else float(head.stubble),
        hair_style=style,
        hair_colour=HAIR_COLOURS[rng.integers(lightest)],
        iris_colour=IRIS_COLOURS[rng.integers(lightest)],
        cloth_colour=CLOTH_COLOURS[rng.integers(len(CLOTH_COLOURS))],
        wall_colour=WALL_COLOURS[rng.integers(len(WALL_COLOURS))],
    )


def _check_range(owner: str, name: str, value: float, low: float, high: float) -> None:
    if not np.isfinite(value) or not low <= value <= high:
        raise LiaamError(f"{owner}.{name} is {value!r}: give a number from {low:g} to {high:g}")
