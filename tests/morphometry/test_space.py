"""The space of shapes: distances and components of known changes, and grids that bend with the landmarks."""

import numpy as np
import pytest
from scipy.interpolate import RBFInterpolator

from liaam.errors import LiaamError
from liaam.morphometry import Specimen, measure, shape_space, shape_variation, thin_plate_weights

MEAN = 100 * np.array([[-2.0, -1], [0, -1.4], [2, -1], [2.2, 1], [0, 1.5], [-2.1, 1.2], [0.3, 0.2]])


def sample(rng: np.random.Generator, m: int = 30) -> list[Specimen]:
    return [Specimen(f"w{i}", MEAN + rng.normal(0, 4, MEAN.shape)) for i in range(m)]


def test_scores_are_those_of_the_variation_of_shape(rng):
    specimens = sample(rng)
    space = shape_space(specimens)
    known = shape_variation(specimens, measure(specimens))
    assert space.scores[:, :10] == pytest.approx(known.scores, abs=1e-12)
    assert space.shares[:10] == pytest.approx(known.shares)
    assert space.shares.sum() == pytest.approx(1.0)  # 10 dimensions, all kept
    rebuilt = space.mean + np.einsum("mc,ckx->mkx", space.scores, space.axes)
    assert rebuilt == pytest.approx(space.shapes, abs=1e-9)


def test_an_exchanged_landmark_is_unusual_and_an_incomplete_specimen_has_no_shape(rng):
    specimens = sample(rng)
    wrong = specimens[7].points.copy()
    wrong[[0, 5]] = wrong[[5, 0]]
    specimens[7] = Specimen("wrong", wrong)
    gap = specimens[3].points.copy()
    gap[2] = np.nan
    specimens[3] = Specimen("gap", gap)
    space = shape_space(specimens)
    assert 3 not in space.specimens
    unusual = space.specimens[space.distances > space.limit]
    assert unusual.tolist() == [7]


def test_a_grid_passes_through_the_landmarks_and_is_the_spline_of_another_package(rng):
    space = shape_space(sample(rng))
    grid = space.grid()
    assert grid.points.shape == (grid.rows * grid.columns, 2)
    assert (grid.points.min(axis=0) < space.mean.min(axis=0)).all()
    assert (grid.points.max(axis=0) > space.mean.max(axis=0)).all()
    change = np.einsum("c,ckx->kx", space.scores[0], space.axes)
    spline = RBFInterpolator(space.mean, change, kernel="thin_plate_spline")
    bent = np.einsum("c,cgx->gx", space.scores[0], grid.bends)
    assert bent == pytest.approx(spline(grid.points), abs=1e-9)
    assert thin_plate_weights(space.mean, space.mean) == pytest.approx(np.eye(len(MEAN)), abs=1e-9)


def test_an_affine_change_bends_no_line(rng):
    places = rng.normal(size=(20, 2))
    weights = thin_plate_weights(MEAN, places)
    affine = np.array([[1.1, 0.3], [-0.2, 0.8]])
    assert weights @ (MEAN @ affine) == pytest.approx(places @ affine, abs=1e-8)


@pytest.mark.parametrize(
    "shape", [[[0, 0], [1, 1], [2, 2], [3, 3]], [[0, 0], [0, 0], [1, 0], [0, 1]], [[0, 0], [1, 0]]]
)
def test_points_on_one_line_or_in_one_place_have_no_spline(shape):
    with pytest.raises(LiaamError, match="on one line, or two in one place"):
        thin_plate_weights(np.array(shape, float), np.zeros((1, 2)))


def test_two_specimens_have_no_space(rng):
    with pytest.raises(LiaamError, match="2 specimens with all landmarks"):
        shape_space(sample(rng, 2))
