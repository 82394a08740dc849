"""Rulers on rough and patterned grounds are found along their straight edges."""

import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from liaam.errors import LiaamError
from liaam.scale import Length, find_ruler, strips

FINE = 4


def photograph(ground: str, period: float, rng: np.random.Generator, *, angle: float = 0.0, n: int = 41) -> np.ndarray:
    """Draw a light ruler with short dark ticks, of which every fifth and tenth is longer, on gravel or fabric."""
    height, width = 480, 640
    y, x = np.mgrid[:height, :width].astype(float)
    if ground == "gravel":
        rough = cv2.GaussianBlur(rng.normal(0, 1, (height, width)), (0, 0), 4)
        level = 110 + 45 * np.clip(rough / rough.std(), -2, 2)
    else:
        level = 120 + 30 * np.where((x // 8 + y // 8) % 2 > 0, np.cos(2 * np.pi * x / 8), np.cos(2 * np.pi * y / 8))
    body = np.zeros((height * FINE, width * FINE), np.uint8)
    left, top = 320 - (n - 1) * period / 2, 200.0
    corners = np.array([left - 12, top, 640 - left + 12, top + 46]) * FINE
    body[round(corners[1]) : round(corners[3]), round(corners[0]) : round(corners[2])] = 255
    ink = np.zeros_like(body)
    for i in range(n):
        length = 14 if i % 10 == 0 else 10 if i % 5 == 0 else 6
        begin, end = (round((left + i * period + side * 0.14 * period) * FINE) for side in (-0.5, 0.5))
        ink[round((top + 46 - length) * FINE) : round((top + 46) * FINE), begin:end] = 255
    turn = cv2.getRotationMatrix2D((320 * FINE, 220 * FINE), -angle, 1)
    shares = [
        cv2.resize(
            cv2.warpAffine(each, turn, each.shape[::-1], flags=cv2.INTER_LINEAR),
            (width, height),
            interpolation=cv2.INTER_AREA,
        )
        / 255.0
        for each in (body, ink)
    ]
    level = level * (1 - shares[0]) + 190 * shares[0]
    level = level * (1 - shares[1]) + 60 * shares[1]
    return np.clip(cv2.GaussianBlur(level, (0, 0), 0.8) + rng.normal(0, 3, level.shape), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("angle", [7.0, 11.0, -20.0])
def test_short_ticks_are_found_along_the_edge_of_a_ruler(angle: float, rng: np.random.Generator) -> None:
    image = photograph("gravel", 11.3, rng, angle=angle)
    ruler = find_ruler(image, Length(1, "mm"))
    assert ruler.period == pytest.approx(11.3, rel=1e-3) and ruler.longest == 10


def test_the_best_strips_are_those_with_the_ticks(rng: np.random.Generator) -> None:
    best = strips.find_strips(photograph("gravel", 13.3, rng).astype(np.float32))[:3]
    assert any(abs(strip.period / 13.3 - 1) < 0.05 for strip in best)


@pytest.mark.parametrize("ground", ["gravel", "fabric"])
def test_a_board_without_ticks_is_no_ruler(ground: str, rng: np.random.Generator) -> None:
    with pytest.raises(LiaamError):
        find_ruler(photograph(ground, 13.3, rng, n=1), Length(1, "mm"))


def test_an_even_image_has_no_strips() -> None:
    assert strips.find_strips(np.zeros((60, 80), np.float32)) == []


def test_many_edges_do_not_crash_the_process_with_one_thread(tmp_path: Path, rng: np.random.Generator) -> None:
    # Canny's method of OpenCV 5.0.0 for grey images did, within twenty searches of this fabric.
    grey = tmp_path / "grey.npy"
    np.save(grey, photograph("fabric", 13.3, rng, n=1).astype(np.float32))
    code = (
        "import cv2, sys, numpy; from liaam.scale.strips import _edges; cv2.setNumThreads(1)\n"
        "for _ in range(20): _edges(numpy.load(sys.argv[1]))"
    )
    subprocess.run([sys.executable, "-c", code, grey], check=True, timeout=60)
