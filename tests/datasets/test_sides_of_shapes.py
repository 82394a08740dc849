"""Which shapes are mirrored, by stated sides and by the shapes."""

import numpy as np
import pytest

from liaam.datasets.sides import sides_of_shapes, squared_distances_of_pairs, two_groups
from liaam.errors import LiaamError
from liaam.model.shape import rotation
from liaam.model.sides import Sides

BODY = np.array([[0, 0], [26, -6], [52, 4], [60, 22], [34, 30], [8, 24], [24, 12], [40, 14]], float)
SYMMETRIC = np.array([[-20, 0], [20, 0], [-12, 30], [12, 30], [0, 14], [0, 44]], float)


def shapes_of(rng, which, mean=BODY, spread=0.6, turn=0.1):
    """Draw shapes, mirrored where ``which`` says so, at any position and size."""
    drawn = []
    for is_mirrored in which:
        shape = (mean + rng.normal(0, spread, mean.shape)) * ([-1.0, 1.0] if is_mirrored else [1.0, 1.0])
        drawn.append(rng.uniform(0.8, 1.2) * shape @ rotation(rng.normal(0, turn)).T + rng.uniform(50, 90, 2))
    return np.array(drawn)


def names_of(count):
    return [f"image {i}" for i in range(count)]


def sides_in(shapes, stated=None):
    return sides_of_shapes(shapes, stated or [""] * len(shapes), names_of(len(shapes)))


@pytest.mark.parametrize("n", [3, 6, 40, 400])
@pytest.mark.parametrize("share", [0.2, 0.5])
def test_mirrored_shapes_are_found(rng, n, share):
    which = np.arange(n) < max(1, int(share * n))
    found = sides_in(shapes_of(rng, which))
    np.testing.assert_array_equal(found.is_other if found.is_other[0] else ~found.is_other, which)
    assert found.sides is not None and found.sides.own == "original" and found.sides.other == "mirrored"
    assert (found.sides.n_own, found.sides.n_other) == (n - found.is_other.sum(), found.is_other.sum())
    assert found.sides.n_other <= found.sides.n_own


def test_missing_landmarks_do_not_matter(rng):
    which = np.arange(30) % 3 == 0
    shapes = shapes_of(rng, which)
    shapes[np.arange(30), np.arange(30) % 8] = np.nan
    np.testing.assert_array_equal(sides_in(shapes).is_other, which)


@pytest.mark.parametrize("mean", [SYMMETRIC, BODY])
def test_shapes_of_one_side_stay(rng, mean):
    found = sides_in(shapes_of(rng, np.zeros(20, bool), mean))
    assert not found.is_other.any() and found.sides is None and found.said == ""


def test_symmetric_shapes_stay_though_landmarks_of_some_are_exchanged(rng):
    shapes = shapes_of(rng, np.zeros(20, bool), SYMMETRIC)
    shapes[:2] = shapes[:2, [1, 0, 3, 2, 4, 5]]
    assert sides_in(shapes).sides is None
    found = sides_in(shapes[2:], ["left", "right"] * 9)
    assert found.sides is None and "look the same in a mirror" in found.said


def test_random_shapes_have_no_sides(rng):
    assert sides_in(rng.normal(size=(20, 6, 2))).sides is None
    assert sides_in(np.zeros((5, 6, 2))).sides is None


def test_y_counted_from_the_other_border_is_no_side(rng):
    which = np.arange(20) % 2 == 0
    upside_down = shapes_of(rng, np.zeros(20, bool)) * np.where(which[:, None, None], [1.0, -1.0], 1.0)
    assert two_groups(upside_down)[0].sum() == 10
    assert sides_in(upside_down).sides is None
    stated = ["left" if each else "right" for each in which]
    np.testing.assert_array_equal(sides_in(upside_down, stated).is_other, which)  # of wings that lie so


def test_stated_sides_name_those_of_the_shapes(rng):
    which = np.arange(12) < 5
    shapes = shapes_of(rng, which)
    found = sides_in(shapes, ["left"] * 5 + ["right"] * 7)
    np.testing.assert_array_equal(found.is_other, which)
    assert found.sides == Sides("right", 7, 5) and found.said == ""
    assert sides_in(shapes, ["right"] * 5 + ["left"] * 7).sides == Sides("left", 7, 5)
    only = sides_in(shapes[5:], ["left"] * 7)
    assert only.sides == Sides("left", 7, 0) and not only.is_other.any()


def test_a_side_that_the_shape_contradicts_is_named(rng):
    which = np.arange(12) < 5
    found = sides_in(shapes_of(rng, which), ["left"] * 4 + ["right"] * 8)
    np.testing.assert_array_equal(found.is_other, which)
    assert found.said == (
        "1 image is taken to be of the other side than stated: image 4 (stated right, left by the shape)"
    )
    assert found.against == (4,)
    with pytest.raises(LiaamError, match=r"the sides of 5 of 12 images are not those of their shapes \(image 1"):
        sides_in(shapes_of(rng, which), ["left", "right"] * 6)


def test_shapes_that_were_reflected_before_stay(rng):
    found = sides_in(shapes_of(rng, np.zeros(12, bool)), ["left", "right"] * 6)
    assert found.sides is None and not found.is_other.any()
    assert found.said == (
        "images of the sides left and right are used as they are, since their shapes are alike without a reflection"
    )


def test_sides_that_cannot_be_are_refused(rng):
    shapes = shapes_of(rng, np.zeros(4, bool))
    with pytest.raises(LiaamError, match=r"side of 1 image is neither left nor right: image 2 \('lfet'\); correct"):
        sides_in(shapes, ["left", "right", "lfet", "left"])
    with pytest.raises(LiaamError, match=r"2 of 4 images have no side, and others have: image 1, image 3; complete"):
        sides_in(shapes, ["left", "", "right", ""])


def test_distances_are_those_of_procrustes(rng):
    one, other = shapes_of(rng, [False, False])
    direct, mirrored = squared_distances_of_pairs(np.array([one, one]), np.array([other, one * [-2, 2] + 3]))
    assert 0 < direct[0] < 0.05 < mirrored[0] and mirrored[1] == pytest.approx(0.0, abs=1e-12) and direct[1] > 0.1
