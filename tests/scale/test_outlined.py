"""Bars of two or three blocks, of which one is dark and the others are outlined rectangles of the card's colour."""

import cv2
import numpy as np
import pytest

from liaam.errors import LiaamError
from liaam.scale import find_bar

FINE = 4
CARD, INK = 235, 15


def photograph(
    blocks: list[tuple[float, bool]], rng: np.random.Generator, *, angle: float = -8.0, sides: str = "both"
) -> np.ndarray:
    """Draw blocks of these lengths, filled or outlined inside their edges by lines of 1.5 pixels, in the middle."""
    canvas = np.full((360 * FINE, 640 * FINE), 90, np.uint8)
    length = sum(each for each, _ in blocks)

    def box(left: float, top: float, right: float, bottom: float, level: int) -> None:
        rows, columns = (slice(*np.rint(np.array(each) * FINE).astype(int)) for each in ((top, bottom), (left, right)))
        canvas[rows, columns] = level

    left, right = 320 - length / 2, 320 + length / 2
    box(left - 22, 146, right + 22, 214, CARD)
    at = left
    for size, is_filled in blocks:
        box(at, 172, at + size, 188, INK if is_filled else CARD)
        for top in (172, 186.5)[: 2 if sides == "both" else 1]:
            box(at, top, at + size, top + 1.5, INK)
        at += size
    for begin in (left, right - 1.5):
        box(begin, 172, begin + 1.5, 188, INK)
    turn = cv2.getRotationMatrix2D((320 * FINE, 180 * FINE), angle, 1)
    canvas = cv2.warpAffine(canvas, turn, canvas.shape[::-1], flags=cv2.INTER_LINEAR, borderValue=90)
    small = cv2.resize(canvas, (640, 360), interpolation=cv2.INTER_AREA).astype(float)
    return np.clip(cv2.GaussianBlur(small, (0, 0), 0.8) + rng.normal(0, 2, small.shape), 0, 255).astype(np.uint8)


@pytest.mark.parametrize(
    "filled", [(True, False), (False, True), (False, True, False)], ids=["dark first", "light first", "dark between"]
)
@pytest.mark.parametrize("angle", [0.0, -8.0, 35.0])
def test_one_dark_block_is_enough(filled: tuple[bool, ...], angle: float, rng: np.random.Generator) -> None:
    length = 120.0 * len(filled)
    bar = find_bar(photograph([(120.0, each) for each in filled], rng, angle=angle))
    assert abs(bar.length - length) < 2 * bar.length_se < 4
    assert abs((bar.angle + angle + 90) % 180 - 90) < 0.5


@pytest.mark.parametrize(
    "blocks",
    [
        [(120.0, True), (90.0, False)],
        [(120.0, False), (90.0, True)],
        [(80.0, True), (160.0, False)],
        [(110.0, True), (110.0, False), (60.0, False)],
    ],
)
def test_blocks_that_are_not_equal_are_no_bar(blocks: list[tuple[float, bool]], rng: np.random.Generator) -> None:
    with pytest.raises(LiaamError):
        find_bar(photograph(blocks, rng))


def test_a_line_at_one_side_makes_no_block(rng: np.random.Generator) -> None:
    with pytest.raises(LiaamError):
        find_bar(photograph([(120.0, True), (120.0, False)], rng, sides="one"))


def test_blocks_that_go_on_are_not_cut(rng: np.random.Generator) -> None:
    blocks = [(70.0, True), (70.0, False), (70.0, True), (70.0, False), (70.0, True)]
    assert find_bar(photograph(blocks, rng)).length == pytest.approx(350, abs=2)
