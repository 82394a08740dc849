"""Landmarks in other units than pixels are found."""

import numpy as np
import pytest

from liaam.datasets import Sample
from liaam.datasets.units import units_fault
from liaam.io import Landmarks

SHAPE = np.array([[10.0, 20], [150, 30], [80, 100]])


def samples(scale: float, count: int = 3) -> list[Sample]:
    image = np.zeros((120, 160, 3), np.uint8)
    return [Sample(f"a{i}", image, Landmarks(SHAPE * scale + i)) for i in range(count)]


def test_landmarks_in_the_corner_of_all_images_are_no_pixels() -> None:
    assert units_fault(samples(0.05)).startswith("all landmarks lie within the first 10 pixels of every image, so that")


@pytest.mark.parametrize(
    "given",
    [samples(1), samples(0.05, 1), [*samples(0.05), *samples(1)], []],
    ids=["in pixels", "one image", "one that is in pixels", "none"],
)
def test_other_landmarks_are_pixels(given: list[Sample]) -> None:
    assert units_fault(given) == ""


def test_missing_landmarks_do_not_matter() -> None:
    [first, *others] = samples(0.05)
    points = first.landmarks.points.copy()
    points[1] = np.nan
    assert units_fault([Sample("a", first.image, Landmarks(points)), *others])
    assert not units_fault([Sample("a", first.image, Landmarks(np.full((3, 2), np.nan)))] * 3)
