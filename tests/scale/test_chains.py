"""Bars of blocks on a card of the colour of their light blocks, with thick blocks, and with two rows."""

import cv2
import numpy as np
import pytest

from liaam.errors import LiaamError
from liaam.scale import chains, find_bar

FINE = 4
CARD, LIGHT, DARK = 235, 235, 15


def photograph(
    n: int,
    pitch: float,
    thickness: float,
    rng: np.random.Generator,
    *,
    first: int = 0,
    rows: int = 1,
    line: bool = True,
    light: int = LIGHT,
) -> np.ndarray:
    """Draw blocks on a card, the first one dark if ``first`` is 0, with a line around them or without, turned by 8°."""
    canvas = np.full((360 * FINE, 640 * FINE), 90, np.uint8)

    def box(left: float, top: float, right: float, bottom: float, level: int) -> None:
        rows, columns = (slice(*np.rint(np.array(each) * FINE).astype(int)) for each in ((top, bottom), (left, right)))
        canvas[rows, columns] = level

    left, top = 320 - n * pitch / 2, 180 - rows * thickness / 2
    box(left - 22, top - 30, left + n * pitch + 34, top + rows * thickness + 26, CARD)
    if line:
        box(left - 1, top - 1, left + n * pitch + 1, top + rows * thickness + 1, DARK)
    if line or light != CARD:
        box(left, top, left + n * pitch, top + rows * thickness, light)
    for i in range(n):
        for row in range(rows):
            if (i + row) % 2 == first:
                at = top + row * thickness
                box(left + i * pitch, at, left + (i + 1) * pitch, at + thickness, DARK)
    turn = cv2.getRotationMatrix2D((320 * FINE, 180 * FINE), -8, 1)
    canvas = cv2.warpAffine(canvas, turn, canvas.shape[::-1], flags=cv2.INTER_LINEAR, borderValue=90)
    small = cv2.resize(canvas, (640, 360), interpolation=cv2.INTER_AREA).astype(float)
    return np.clip(cv2.GaussianBlur(small, (0, 0), 0.7) + rng.normal(0, 2, small.shape), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("first", [0, 1])
@pytest.mark.parametrize("n", [4, 5])
def test_light_blocks_of_the_colour_of_the_card_count(n: int, first: int, rng: np.random.Generator) -> None:
    bar = find_bar(photograph(n, 60.0, 14.0, rng, first=first))
    assert abs(bar.length - 60 * n) < max(3 * bar.length_se, 0.5) and bar.length_se < 3


def test_without_a_line_the_card_is_no_block(rng: np.random.Generator) -> None:
    bar = find_bar(photograph(5, 60.0, 14.0, rng, line=False))
    assert abs(bar.length - 300) < max(3 * bar.length_se, 0.5)


@pytest.mark.parametrize("n, first", [(4, 0), (4, 1), (5, 0), (5, 1)])
def test_light_blocks_that_are_a_little_lighter_than_the_card_count(n: int, first: int, rng) -> None:
    bar = find_bar(photograph(n, 60.0, 14.0, rng, first=first, line=False, light=250))
    assert abs(bar.length - 60 * n) < max(3 * bar.length_se, 0.5)


def test_a_light_block_at_an_end_counts_where_glare_hides_those_between(rng: np.random.Generator) -> None:
    image = photograph(10, 30.0, 10.0, rng, line=False, light=250).astype(float)
    glare = 30 * np.clip((470 - np.arange(image.shape[1])) / 60, 0, 1)  # all light blocks but the last are white
    bar = find_bar(np.clip(image + glare, 0, 255).astype(np.uint8))
    assert abs(bar.length - 300) < max(3 * bar.length_se, 0.5)


def test_an_end_that_glare_hides_is_refused(rng: np.random.Generator) -> None:
    image = photograph(4, 60.0, 14.0, rng, line=False, light=250).astype(float)
    glare = 40 * np.clip((np.arange(image.shape[1]) - 340) / 60, 0, 1)  # the last light block is as white as the card
    with pytest.raises(LiaamError, match="not whether a light block follows its last dark one"):
        find_bar(np.clip(image + glare, 0, 255).astype(np.uint8))


def test_a_dark_block_at_an_end_that_glare_makes_lighter_is_refused(rng: np.random.Generator) -> None:
    image = photograph(5, 70.0, 24.0, rng, line=False, light=250).astype(float)
    share = np.clip((227 - np.arange(image.shape[1])) / 10, 0, 1)  # of the first dark block
    with pytest.raises(LiaamError, match="not whether a light block follows its last dark one"):
        find_bar(np.where(image < 200, image + 130 * share, image).clip(0, 255).astype(np.uint8))


def test_an_end_that_is_not_clear_is_refused(rng: np.random.Generator) -> None:
    image = photograph(5, 16.0, 8.0, rng)  # its outline goes on
    turn = cv2.getRotationMatrix2D((320, 180), -8, 1)
    for side in (-1, 1):
        ends = np.array([[280.0, 180 + side * 4.5], [394.0, 180 + side * 4.5]])
        points = np.rint(ends @ turn[:, :2].T + turn[:, 2]).astype(int)
        cv2.line(image, points[0].tolist(), points[1].tolist(), 15, 1)
    with pytest.raises(LiaamError, match=r"a bar of blocks of (79|80)\.\d pixels is found, but not whether a light"):
        find_bar(image)


def test_blocks_may_be_thick(rng: np.random.Generator) -> None:
    bar = find_bar(photograph(5, 90.0, 60.0, rng))
    assert abs(bar.length - 450) < max(3 * bar.length_se, 0.5)


@pytest.mark.parametrize("n", [5, 10])
def test_two_rows_are_one_bar(n: int, rng: np.random.Generator) -> None:
    bar = find_bar(photograph(n, 40.0, 10.0, rng, rows=2))
    assert abs(bar.length - 40 * n) < max(3 * bar.length_se, 0.5)


def test_blocks_that_are_not_seen_alone_count(rng: np.random.Generator) -> None:
    image = photograph(9, 40.0, 14.0, rng)
    cv2.line(image, (240, 188), (236, 60), 15, 3)  # a hair joins a dark block to the ground
    bar = find_bar(image)
    assert abs(bar.length - 360) < max(3 * bar.length_se, 0.5)


def test_squares_of_a_chessboard_are_no_bar(rng: np.random.Generator) -> None:
    board = np.kron(np.indices((8, 8)).sum(axis=0) % 2, np.ones((30, 30))) * 200 + 20
    with pytest.raises(LiaamError):
        find_bar(np.clip(board + rng.normal(0, 2, board.shape), 0, 255).astype(np.uint8))


def test_a_fabric_of_many_threads_hides_no_bar_and_its_work_is_bounded(rng: np.random.Generator) -> None:
    image = photograph(5, 60.0, 14.0, rng)
    is_ground = np.abs(image.astype(int) - 90) < 12
    down, across = np.indices(image.shape)
    image[is_ground & (down % 10 < 5) & (across % 10 < 5)] = 40
    grey = image.astype(np.float32)
    assert len(chains._blocks(grey < 100, 3)) <= chains._MOST_DARK
    found = chains.find_chains(chains.dark_blocks(grey))
    assert len(found) <= chains._MOST_CHAINS and any(abs(chain.pitch - 60) < 2 for chain in found)


def test_blocks_on_a_small_part_of_an_image_are_told_from_light_ones_by_their_level(rng: np.random.Generator) -> None:
    image = photograph(5, 60.0, 46.0, rng, line=False, light=150).astype(float)
    image[np.where(image < 60)] += 60  # dark blocks of about 75, lighter than the ground
    image[:, :60] = 40
    image[:, -60:] = 40
    large = np.full((1400, 1400), 40.0) + rng.normal(0, 2, (1400, 1400))
    large[500:860, 300:940] = image
    bar = find_bar(np.clip(large, 0, 255).astype(np.uint8))
    assert abs(bar.length - 300) < max(3 * bar.length_se, 0.5)


@pytest.mark.parametrize("ground", [90, 20])
def test_numbers_beside_two_rows_add_no_block(ground: int, rng: np.random.Generator) -> None:
    image = photograph(5, 60.0, 14.0, rng, rows=2, line=False)
    image[np.abs(image.astype(int) - 90) < 12] = ground
    for place in (126, 490):  # as if they were blocks of a row, before and after the bar
        cv2.putText(image, "0", (place, 172 + (place - 320) // 7), cv2.FONT_HERSHEY_SIMPLEX, 0.5, 15, 2)
    bar = find_bar(cv2.GaussianBlur(image, (0, 0), 0.5))
    assert abs(bar.length - 300) < max(3 * bar.length_se, 0.5)


def test_dark_blocks_on_a_dark_ground_may_go_on(rng: np.random.Generator) -> None:
    image = photograph(5, 60.0, 14.0, rng, first=1, line=False, light=250)
    down, across = np.indices(image.shape)
    turned = np.deg2rad(-8.0)
    along = (across - 320) * np.cos(turned) - (down - 180) * np.sin(turned)
    aside = (across - 320) * np.sin(turned) + (down - 180) * np.cos(turned)
    is_bar = (np.abs(along) < 148) & (np.abs(aside) < 6)
    image[~is_bar] = np.clip(rng.normal(35, 2, int((~is_bar).sum())), 0, 255).astype(np.uint8)
    with pytest.raises(LiaamError):
        find_bar(image)


def test_the_other_row_of_a_bar_is_no_other_bar(rng: np.random.Generator) -> None:
    image = photograph(8, 40.0, 12.0, rng, rows=2)
    cv2.line(image, (150, 230), (330, 200), 120, 3)  # a pin at the lower row, whose ends are not clear
    bar = find_bar(image)
    assert abs(bar.length - 320) < max(3 * bar.length_se, 0.5)
