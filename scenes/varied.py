"""Generated objects that vary: fish of many kinds, an animal that walks, one from above that turns, and jointed bars.

Each maker draws a picture and its landmarks from a kind and a random generator:

>>> rng = np.random.default_rng(0)
>>> kind = WalkingAnimal.drawn(rng)
>>> image, landmarks = kind.picture(rng)

Pictures are (h, w, 3) uint8, landmarks (n, 2) float64 in their pixels. They are drawings of flat shapes with texture,
under a light that varies a little: what is hard about them is their shapes.
"""

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Protocol

import cv2
import numpy as np

from liaam.model.shape import Similarity, rotation

Picture = tuple[np.ndarray, np.ndarray]
"""An image and its landmarks."""

DETAIL = 2
"""Pixels of the drawing in a pixel of the picture, along each axis."""

FRACTION_BITS = 4
"""Binary digits after the point of the coordinates of polygons."""


class Kind(Protocol):
    """A kind of object, of which pictures can be drawn."""

    def picture(self, rng: np.random.Generator) -> Picture:
        """Draw an object of this kind."""
        ...


class Drawing:
    """A picture that is being drawn, at a higher resolution, before a background."""

    def __init__(self, rng: np.random.Generator, width: int, height: int) -> None:
        self.width = width
        self.height = height
        colour = rng.uniform(0.25, 0.8, 3).astype(np.float32)
        backdrop = np.ones((height, width, 3), np.float32) * colour
        for size, contrast in ((3, 0.02), (12, 0.04), (40, 0.06)):
            backdrop *= 1.0 + _smooth_noise(rng, height, width, size, contrast)[..., None]
        enlarged = (width * DETAIL, height * DETAIL)
        self.values = cv2.resize(np.clip(backdrop, 0.0, 1.0), enlarged, interpolation=cv2.INTER_LINEAR)

    @property
    def points(self) -> np.ndarray:
        """Positions of the drawing's pixels in the picture, (h, w, 2) float64."""
        rows, columns = np.mgrid[0 : self.height * DETAIL, 0 : self.width * DETAIL]
        return np.stack([columns, rows], axis=-1) / DETAIL

    def fill(self, polygon: np.ndarray, colour: np.ndarray) -> None:
        """Fill a polygon (k, 2) with a colour (3,), or a texture (h, w, 3) of all of the drawing's pixels."""
        mask = np.zeros(self.values.shape[:2], np.uint8)
        corners = np.rint(np.asarray(polygon) * DETAIL * 2**FRACTION_BITS).astype(np.int32)
        cv2.fillPoly(mask, [corners], 255, cv2.LINE_AA, FRACTION_BITS)
        share = (mask / np.float32(255))[..., None]
        self.values = self.values * (1.0 - share) + np.asarray(colour, np.float32) * share

    def finished(self, rng: np.random.Generator) -> np.ndarray:
        """Return the picture under a light that falls off to one side, with blur, noise and sRGB's response."""
        size = (self.width, self.height)
        picture = cv2.resize(self.values.astype(np.float32), size, interpolation=cv2.INTER_AREA)
        rows, columns = np.mgrid[0 : self.height, 0 : self.width]
        direction = rng.uniform(0.0, 2.0 * np.pi)
        across = (columns / self.width - 0.5) * np.cos(direction) + (rows / self.height - 0.5) * np.sin(direction)
        light = (1.0 + 2.0 * rng.uniform(0.0, 0.3) * across)[..., None]
        colour = rng.uniform(0.7, 1.05) * (1.0 + rng.normal(0.0, 0.04, 3))
        seen = cv2.GaussianBlur((picture * light * colour).astype(np.float32), (0, 0), 0.7)
        noisy = seen + rng.normal(0.0, 0.012, seen.shape)
        return (255.0 * np.clip(noisy, 0.0, 1.0) ** (1 / 2.2)).astype(np.uint8)


def _smooth_noise(rng: np.random.Generator, height: int, width: int, size: float, contrast: float) -> np.ndarray:
    noise = cv2.GaussianBlur(rng.standard_normal((height, width)).astype(np.float32), (0, 0), size)
    return contrast * noise / max(float(noise.std()), 1e-6)


def placed_at(centre: np.ndarray, length: float, turn: float, middle: tuple[float, float] = (0.5, 0.0)) -> Similarity:
    """Return the map from an object's own coordinates, in units of its length, to the picture.

    ``middle`` are the own coordinates of the point that lies at the centre; ``turn`` is in radians.
    """
    matrix = length * rotation(turn)
    return Similarity(matrix, centre - matrix @ middle)


def moved(point: np.ndarray, x: float, y: float) -> np.ndarray:
    """Return a point (2,) moved to the right and down."""
    return point + np.array([x, y])


def limb(start: np.ndarray, end: np.ndarray, start_width: float, end_width: float) -> np.ndarray:
    """Outline (16, 2) of a limb with round ends, of which half the widths are given."""
    start = np.asarray(start, float)
    end = np.asarray(end, float)
    along = (end - start) / max(float(np.linalg.norm(end - start)), 1e-6)
    across = np.array([-along[1], along[0]])
    angles = np.linspace(0.0, np.pi, 8)
    tip = np.outer(np.sin(angles), along) - np.outer(np.cos(angles), across)
    base = -np.outer(np.sin(angles), along) + np.outer(np.cos(angles), across)
    return np.concatenate([end + end_width * tip, start + start_width * base])


# Fish of many kinds: proportions and appearance differ.


@dataclass(frozen=True)
class Fish:
    """A kind of fish from the side; 14 landmarks."""

    depth: float
    tail: float
    fork: float
    snout: float
    fin: float
    fin_at: float
    eye: float
    colours: np.ndarray
    stripes: int
    angle: float
    bend: float = 0.0
    turn: float = 0.12
    """Standard deviation of the rotation, radians."""

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> "Fish":
        """Draw a kind."""
        return cls(
            depth=rng.uniform(0.22, 0.5),
            tail=rng.uniform(0.18, 0.38),
            fork=rng.uniform(0.0, 0.15),
            snout=rng.uniform(0.1, 0.3),
            fin=rng.uniform(0.05, 0.25),
            fin_at=rng.uniform(0.35, 0.6),
            eye=rng.uniform(0.02, 0.045),
            colours=rng.uniform(0.08, 0.9, (3, 3)),
            stripes=int(rng.integers(0, 7)),
            angle=rng.uniform(0.0, np.pi),
        )

    def varied(self, rng: np.random.Generator, amount: float) -> "Fish":
        """Return a fish of this kind whose proportions differ by this standard deviation."""
        lengths = {
            name: getattr(self, name) * np.exp(rng.normal(0.0, amount))
            for name in ("depth", "tail", "fork", "snout", "fin", "fin_at", "eye")
        }
        colours = np.clip(self.colours * np.exp(rng.normal(0.0, 0.5 * amount, (3, 3))), 0.03, 1.0)
        return replace(self, **lengths, bend=rng.normal(0.0, 0.5 * amount), colours=colours)

    def picture(self, rng: np.random.Generator) -> Picture:
        """Draw the fish."""
        width, height = 320, 240
        drawing = Drawing(rng, width, height)
        centre = np.array([width, height]) * (0.5 + rng.uniform(-0.06, 0.06, 2))
        placed = placed_at(centre, rng.uniform(0.55, 0.75) * width, rng.normal(0.0, self.turn))

        def bent(points: np.ndarray) -> np.ndarray:
            points = np.atleast_2d(np.asarray(points, float)).copy()
            points[:, 1] += 4.0 * self.bend * (points[:, 0] - 0.5) ** 2
            return placed(points)

        upper, lower = self._sides()
        at = int(np.clip(59 * self.fin_at / (1.0 - self.tail), 8, 45))
        dorsal = np.array([upper[at - 6], upper[at] - [0.0, self.fin], upper[at + 10]])
        anal = np.array([lower[at + 2], lower[at + 8] + [0.0, 0.7 * self.fin], lower[at + 12]])
        base = lower[-1]
        tail = np.array(
            [
                base * [1.0, -1.0],
                [1.0, -0.45 * self.depth],
                [1.0 - self.fork, 0.0],
                [1.0, 0.45 * self.depth],
                base,
            ]
        )
        eye = np.array([0.09, -0.12 * self.depth])
        for outline, colour in (
            (dorsal, self.colours[2]),
            (anal, self.colours[2]),
            (tail, self.colours[1]),
            (np.concatenate([upper, lower[::-1]]), self._texture(placed.inverse()(drawing.points))),
            (_disc(eye, self.eye), np.array([0.9, 0.9, 0.85])),
            (_disc(eye, 0.55 * self.eye), np.array([0.02, 0.02, 0.02])),
        ):
            drawing.fill(bent(outline), colour)
        landmarks = bent(np.array([[0, 0], eye, *dorsal, upper[50], *tail[1:4], lower[50], *anal[::-1], lower[12]]))
        return drawing.finished(rng), landmarks

    def _sides(self) -> tuple[np.ndarray, np.ndarray]:
        """Upper and lower outline of the body, (60, 2) each, from snout to tail."""
        x = np.linspace(0.0, 1.0, 60)
        steepness = np.log(0.5) / np.log(0.3 + self.snout)
        half = np.sin(np.pi * x**steepness) ** 0.8 * (1.0 - 0.75 * x) + 0.05
        half *= 0.5 * self.depth / half.max()
        along = x * (1.0 - self.tail)
        return np.column_stack([along, -half]), np.column_stack([along, half])

    def _texture(self, own: np.ndarray) -> np.ndarray:
        """Stripes, darker above, (h, w, 3)."""
        phase = own[..., 0] * np.cos(self.angle) + own[..., 1] * np.sin(self.angle)
        share = (0.5 + 0.5 * np.sin(2.0 * np.pi * self.stripes * phase))[..., None]
        shade = 1.0 - 0.5 * np.clip(-own[..., 1:] / self.depth, -0.5, 0.8)
        return (self.colours[0] * (1.0 - share) + self.colours[1] * share) * shade


def _disc(centre: np.ndarray, radius: float) -> np.ndarray:
    angles = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
    return centre + radius * np.column_stack([np.cos(angles), np.sin(angles)])


# An animal that walks: its legs swing, and cross.


@dataclass(frozen=True)
class WalkingAnimal:
    """A striped animal from the side; 22 landmarks, four of each leg."""

    colour: np.ndarray
    stripes: int
    dark: float
    leg: float
    swing: float = 0.85
    """Largest angle of a leg, radians."""

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> "WalkingAnimal":
        """Draw an animal."""
        return cls(
            colour=rng.uniform(0.15, 0.8, 3),
            stripes=int(rng.integers(6, 12)),
            dark=rng.uniform(0.1, 0.4),
            leg=rng.uniform(0.28, 0.36),
        )

    def picture(self, rng: np.random.Generator) -> Picture:
        """Draw the animal at a moment of its walk."""
        width, height = 360, 280
        drawing = Drawing(rng, width, height)
        centre = np.array([width, height]) * (0.5 + rng.uniform(-0.05, 0.05, 2)) - [0.0, 0.12 * height]
        placed = placed_at(centre, rng.uniform(0.5, 0.62) * width, rng.normal(0.0, 0.05))
        coat = self._coat(placed.inverse()(drawing.points))
        phase = rng.uniform(0.0, 2.0 * np.pi)
        hip = np.array([0.88, 0.1])
        shoulder = np.array([0.22, 0.12])
        head = np.array([0.02, -0.12 + rng.normal(0.0, 0.03)])
        neck = moved(shoulder, -0.02, -0.16)
        tail_tip = moved(hip, 0.16 + rng.normal(0.0, 0.02), 0.05 + rng.normal(0.0, 0.07))
        eye = moved(head, -0.02, -0.02)
        far = 0.55 * self.colour

        def drawn_leg(root: np.ndarray, at: float, colour: np.ndarray) -> np.ndarray:
            knee, foot = self._leg(root, at, rng)
            drawing.fill(placed(limb(root, knee, 0.055, 0.035)), colour)
            drawing.fill(placed(limb(knee, foot, 0.035, 0.025)), colour)
            return np.array([root, knee, moved(foot, -0.03, 0.0), moved(foot, 0.03, 0.0)])

        legs = [drawn_leg(moved(shoulder, 0.03, 0.0), phase + np.pi, far)]
        legs.append(drawn_leg(moved(hip, -0.02, 0.0), phase + 0.9 * np.pi, far))
        drawing.fill(placed(limb(moved(hip, 0.0, -0.1), tail_tip, 0.03, 0.02)), coat)
        trunk = [[0.16, -0.1], [0.35, -0.06 + rng.normal(0.0, 0.01)], [0.6, -0.08], [0.9, -0.06], [0.95, 0.06]]
        trunk += [[0.86, 0.18], [0.6, 0.2], [0.35, 0.21], [0.18, 0.18]]
        drawing.fill(placed(np.array(trunk)), coat)
        drawing.fill(placed(limb(head, moved(neck, 0.03, 0.05), 0.075, 0.1)), coat)
        drawing.fill(placed(limb(head, moved(head, -0.07, 0.04), 0.045, 0.035)), coat)
        legs.append(drawn_leg(shoulder, phase, coat))
        legs.append(drawn_leg(hip, phase + 1.1 * np.pi, coat))
        drawing.fill(placed(_disc(eye, 0.016)), np.full(3, 0.03))
        landmarks = [moved(head, -0.1, 0.05), eye, neck, trunk[2], trunk[3], tail_tip]
        return drawing.finished(rng), placed(np.concatenate([landmarks, *legs]))

    def _leg(self, root: np.ndarray, phase: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Knee and foot of a leg at a phase of the walk."""
        upper = self.swing * np.sin(phase) + rng.normal(0.0, 0.05)
        lower = upper + 0.35 * np.cos(phase) + rng.normal(0.0, 0.08) - 0.1
        knee = root + 0.5 * self.leg * np.array([np.sin(upper), np.cos(upper)])
        return knee, knee + 0.5 * self.leg * np.array([np.sin(lower), np.cos(lower)])

    def _coat(self, own: np.ndarray) -> np.ndarray:
        """Stripes that curve, darker below, (h, w, 3)."""
        x = own[..., :1]
        y = own[..., 1:]
        is_dark = np.sin(2.0 * np.pi * self.stripes * x + 3.0 * np.sin(5.0 * y)) > 0.45
        return self.colour * (1.0 - (1.0 - self.dark) * is_dark) * (1.0 - 0.6 * y)


# An animal from above, which lies in any direction and bends.


@dataclass(frozen=True)
class AnimalFromAbove:
    """An animal with a tail, from above, in any direction; 9 landmarks."""

    colour: np.ndarray
    patch: np.ndarray
    width: float

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> "AnimalFromAbove":
        """Draw an animal."""
        return cls(rng.uniform(0.1, 0.6, 3), rng.uniform(0.3, 0.9, 3), rng.uniform(0.14, 0.2))

    def picture(self, rng: np.random.Generator) -> Picture:
        """Draw the animal."""
        size = 320
        drawing = Drawing(rng, size, size)
        centre = size * (0.5 + rng.uniform(-0.08, 0.08, 2))
        placed = placed_at(centre, rng.uniform(0.38, 0.5) * size, rng.uniform(0.0, 2.0 * np.pi), middle=(0.45, 0.0))
        bend = rng.normal(0.0, 0.25)
        x = np.linspace(0.0, 1.0, 40)
        spine = np.column_stack([x, 1.2 * bend * (x - 0.4) ** 2])
        half = self._half_widths(x)
        along = np.linspace(0.0, 1.0, 20)
        swing = 0.3 * (2.0 * bend + rng.normal(0.0, 0.5))
        tail = spine[-1] + np.column_stack([0.5 * along, swing * along**2 + 0.7 * bend * along])
        for start, end in pairwise(tail):
            drawing.fill(placed(limb(start, end, 0.018, 0.016)), 0.8 * self.colour + 0.1)
        for at in (12, 30):
            for side in (1.0, -1.0):
                hip = spine[at] + [0.0, 0.8 * side * half[at]]
                foot = spine[at] + [rng.normal(-0.05, 0.06), side * (half[at] + 0.06)]
                drawing.fill(placed(limb(hip, foot, 0.03, 0.025)), 0.9 * self.colour + 0.08)
        width = np.column_stack([np.zeros(40), half])
        drawing.fill(placed(np.concatenate([spine + width, (spine - width)[::-1]])), self.colour)
        drawing.fill(placed(limb(spine[19], spine[29], 0.5 * half[24], 0.4 * half[24])), self.patch)
        ears = [spine[9] + [0.0, side * (half[9] + 0.02)] for side in (1.0, -1.0)]
        for ear in ears:
            drawing.fill(placed(limb(ear, moved(ear, 0.03, 0.0), 0.045, 0.045)), 0.7 * self.colour + 0.15)
        flanks = [spine[26] + [0.0, side * half[26]] for side in (1.0, -1.0)]
        landmarks = [spine[0], *ears, spine[20], *flanks, spine[-1], tail[10], tail[-1]]
        return drawing.finished(rng), placed(np.array(landmarks))

    def _half_widths(self, x: np.ndarray) -> np.ndarray:
        """Half the width of the body along it, widest behind the middle."""
        from_widest = (x - 0.62) / np.where(x < 0.62, 0.66, 0.4)
        return self.width * np.sqrt(np.clip(1.0 - from_widest**2, 0.0, 1.0)) * x**0.25


# Three bars on joints, which turn and cross.


@dataclass(frozen=True)
class JointedBars:
    """Three striped bars, each on the end of the one before, in any direction; 12 landmarks."""

    lengths: np.ndarray
    widths: np.ndarray
    colours: np.ndarray
    stripes: np.ndarray
    phases: np.ndarray

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> "JointedBars":
        """Draw bars."""
        return cls(
            lengths=rng.uniform(0.8, 1.2, 3),
            widths=rng.uniform(0.3, 0.45, 3),
            colours=rng.uniform(0.1, 0.9, (3, 2, 3)),
            stripes=rng.uniform(0.5, 2.0, 3),
            phases=rng.uniform(0.0, 1.0, 3),
        )

    def picture(self, rng: np.random.Generator) -> Picture:
        """Draw the bars at some angles."""
        size = 320
        drawing = Drawing(rng, size, size)
        unit = rng.uniform(0.2, 0.27) * size
        angles = rng.uniform(0.0, 2.0 * np.pi) + np.cumsum([0.0, *rng.normal(0.0, 1.0, 2)])
        directions = np.column_stack([np.cos(angles), np.sin(angles)])
        joints = np.concatenate([np.zeros((1, 2)), np.cumsum(unit * self.lengths[:, None] * directions, axis=0)])
        joints += 0.5 * size - joints.mean(axis=0)
        landmarks = []
        for i, direction in enumerate(directions):
            across = 0.5 * self.widths[i] * unit * np.array([-direction[1], direction[0]])
            start = joints[i]
            end = joints[i + 1]
            corners = np.array([start - across, start + across, end + across, end - across])
            along = (drawing.points - start) @ direction / (unit * self.lengths[i])
            share = 0.5 + 0.5 * np.sin(2.0 * np.pi * (self.stripes[i] * along + self.phases[i]))[..., None]
            drawing.fill(corners, self.colours[i, 0] * (1.0 - share) + self.colours[i, 1] * share)
            landmarks.append(corners)
        return drawing.finished(rng), np.concatenate(landmarks)
