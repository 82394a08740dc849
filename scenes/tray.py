"""Photographs of leaves: one on paper, or a tray of several, each with its label, and a ruler."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from scenes.ruler import draw

FINE = 4
"""Pixels that are drawn for one of the photograph, along each side."""

NAMES = ("base", "tip", "left1", "left2", "left3", "right1", "right2", "right3", "mid1", "mid2", "mid3")
"""Landmarks: both ends of the blade, and where its veins leave the midrib and reach the margin on each side."""

CELL = (360, 240)
"""Height and width of the place of a leaf on a tray, pixels."""

_JUNCTIONS = (0.25, 0.48, 0.7)  # of the veins, along the midrib
_PAPER = 226.0
_LABEL = 3  # pixels of a square of a QR code


@dataclass(frozen=True)
class Leaf:
    """The shape of a leaf.

    Attributes
    ----------
    length : float
        From base to tip along the midrib, pixels.
    width : float
        Greatest width, of the length.
    fullness : float
        Exponent that moves the widest place towards the tip (above 1) or the base.
    bend : float
        Sagitta of the midrib, of the length.
    turn : float
        Angle to the vertical, radians, clockwise.
    green : float
        Colour, 0 to 1.
    """

    length: float
    width: float
    fullness: float
    bend: float
    turn: float
    green: float

    def place(self, along: np.ndarray, across: np.ndarray) -> np.ndarray:
        """Return points (..., 2) relative to the middle, from places along (0 to 1) and across (-1 to 1) the leaf."""
        along = np.asarray(along, np.float64)
        half = 0.5 * self.width * np.sin(np.pi * np.clip(along, 0, 1) ** self.fullness)
        x = half * across + self.bend * 4 * along * (1 - along)
        y = 0.5 - along + 0.12 * half * np.abs(across)
        across_image = x * np.cos(self.turn) - y * np.sin(self.turn)
        down_image = x * np.sin(self.turn) + y * np.cos(self.turn)
        return self.length * np.stack([across_image, down_image], axis=-1)

    @property
    def landmarks(self) -> np.ndarray:
        """Its landmarks (11, 2), relative to its middle."""
        along = np.array([0.0, 1.0, *self._margin, *self._margin, *_JUNCTIONS])
        across = np.array([0.0, 0.0, -1, -1, -1, 1, 1, 1, 0, 0, 0])
        return self.place(along, across)

    @property
    def _margin(self) -> np.ndarray:
        """Where the veins reach the margin, along the midrib."""
        return np.array(_JUNCTIONS) + 0.12


def random_leaf(rng: np.random.Generator, length: tuple[float, float] = (130.0, 180.0)) -> Leaf:
    """Draw the shape of a leaf."""
    return Leaf(
        length=rng.uniform(*length),
        width=rng.uniform(0.42, 0.6),
        fullness=rng.uniform(0.75, 1.1),
        bend=rng.uniform(-0.06, 0.06),
        turn=rng.uniform(-0.2, 0.2),
        green=rng.uniform(0, 1),
    )


@dataclass(frozen=True)
class Tray:
    """A photograph of leaves.

    Attributes
    ----------
    image : (h, w, 3) uint8
    landmarks : list of (11, 2) arrays
        Of each leaf in reading order, pixels.
    texts : tuple of str
        What the label of each leaf says, or empty.
    period : float
        Pixels from one tick of the ruler to the next; NaN without a ruler.
    """

    image: np.ndarray
    landmarks: list[np.ndarray]
    texts: tuple[str, ...]
    period: float


def draw_leaf_on_paper(leaf: Leaf, rng: np.random.Generator, shape: tuple[int, int] = CELL) -> Tray:
    """Draw a photograph of one leaf."""
    return draw_tray([leaf], rng, columns=1, cell=shape)


def draw_tray(
    leaves: Sequence[Leaf],
    rng: np.random.Generator,
    *,
    texts: Sequence[str] = (),
    columns: int = 3,
    cell: tuple[int, int] = CELL,
    ruler: float | None = None,
    turn: float = 0.0,
    noise: float = 2.0,
) -> Tray:
    """Draw a tray of leaves in rows, with a QR code under each, and a ruler at the lower end.

    Parameters
    ----------
    leaves : sequence of Leaf
        In reading order.
    rng : numpy.random.Generator
    texts : sequence of str
        Texts of the codes, one for each leaf; "" for none.
    columns : int
        Leaves in a row.
    cell : (int, int)
        Height and width of the place of a leaf, pixels.
    ruler : float, optional
        Pixels from tick to tick; no ruler by default.
    turn : float
        By which the tray is turned, degrees, clockwise; then without a ruler.
    noise : float
        Standard deviation of the noise, levels of 255.
    """
    rows = -(-len(leaves) // columns)
    height = rows * cell[0]
    width = columns * cell[1]
    ground = _PAPER + 6 * (np.mgrid[:height, :width][1] / width - 0.5)
    fine = cv2.resize(np.repeat(ground[:, :, None], 3, axis=2).astype(np.float32), None, fx=FINE, fy=FINE)
    middles = [
        np.array([(i % columns + 0.5) * cell[1], (i // columns + 0.4) * cell[0]]) + rng.uniform(-6, 6, 2)
        for i in range(len(leaves))
    ]
    for leaf, middle in zip(leaves, middles, strict=True):
        _paint(fine, leaf, middle)
    for text, middle in zip(texts, middles, strict=False):
        if text:
            _stick(fine, text, middle + np.array([0.0, 0.45 * cell[0]]))
    if turn:
        matrix = cv2.getRotationMatrix2D((fine.shape[1] / 2, fine.shape[0] / 2), -turn, 1.0)
        fine = cv2.warpAffine(fine, matrix, fine.shape[1::-1], borderMode=cv2.BORDER_REPLICATE)
        matrix[:, 2] /= FINE
    else:
        matrix = np.eye(2, 3)
    small = cv2.GaussianBlur(cv2.resize(fine, (width, height), interpolation=cv2.INTER_AREA), (0, 0), 0.6)
    image = np.clip(np.rint(small + rng.normal(0, noise, small.shape)), 0, 255).astype(np.uint8)
    if ruler is not None:
        strip = draw("hierarchical", rng, size=ruler, shape=(90, width), noise=noise).image
        image = np.concatenate([image, strip])
    places = []
    for leaf, middle in zip(leaves, middles, strict=True):
        places.append((leaf.landmarks + middle + 0.5) @ matrix[:, :2].T + matrix[:, 2] - 0.5)
    return Tray(image, places, tuple(texts), float("nan") if ruler is None else ruler)


def _paint(fine: np.ndarray, leaf: Leaf, middle: np.ndarray) -> None:
    """Paint a leaf at a place of a fine picture."""
    along = np.linspace(0, 1, 80)
    outline = np.concatenate([leaf.place(along, -np.ones(80)), leaf.place(along[::-1], np.ones(80))])
    blade = np.array([70.0, 118.0, 52.0]) + leaf.green * np.array([50.0, 22.0, 10.0])
    _fill(fine, outline + middle, blade)
    vein = blade + 55
    _line(fine, leaf.place(along, np.zeros(80)) + middle, vein, 2.2)
    stalk = leaf.place(np.array([-0.12, 0.0]), np.zeros(2))
    _line(fine, stalk + middle, blade - 25, 3.0)
    for start, end in zip(_JUNCTIONS, leaf._margin, strict=True):
        steps = np.linspace(0, 1, 20)
        for side in (-1, 1):
            _line(fine, leaf.place(start + (end - start) * steps, side * steps) + middle, vein, 1.4)


def _fixed(points: np.ndarray) -> np.ndarray:
    """Return points of the photograph as numbers of a fine picture with four bits after the point, for OpenCV."""
    return np.rint(((points + 0.5) * FINE - 0.5) * 16).astype(np.int32)


def _fill(fine: np.ndarray, points: np.ndarray, colour: np.ndarray) -> None:
    cv2.fillPoly(fine, [_fixed(points)], colour.tolist(), cv2.LINE_8, 4)


def _line(fine: np.ndarray, points: np.ndarray, colour: np.ndarray, thick: float) -> None:
    cv2.polylines(fine, [_fixed(points)], False, colour.tolist(), round(thick * FINE), cv2.LINE_8, 4)


def _stick(fine: np.ndarray, text: str, middle: np.ndarray) -> None:
    """Stick a label with a QR code, and a quiet zone around it, on a fine picture."""
    code = cv2.QRCodeEncoder.create().encode(text)
    side = _LABEL * FINE
    label = cv2.resize(code, None, fx=side, fy=side, interpolation=cv2.INTER_NEAREST)
    label = cv2.copyMakeBorder(label, 2 * side, 2 * side, 2 * side, 2 * side, cv2.BORDER_CONSTANT, value=255)
    left, top = np.rint((middle * FINE) - np.array(label.shape[::-1]) / 2).astype(int).tolist()
    fine[top : top + label.shape[0], left : left + label.shape[1]] = 25 + 0.86 * label[:, :, None].astype(np.float32)
