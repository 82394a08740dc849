"""Automatic shapes beside people's: known shrinkage, bias and noise come back."""

import numpy as np
import pytest

from liaam.errors import LiaamError
from liaam.evaluation import compare_shapes
from liaam.model.shape import rotation

MEAN = np.array([[-2.0, -1], [0, -1.4], [2, -1], [2.2, 1], [0, 1.5], [-2.1, 1.2], [0.3, 0.2]])


def specimens(rng: np.random.Generator, m: int = 400) -> np.ndarray:
    """Shapes that vary along two directions."""
    modes = rng.normal(size=(2, *MEAN.shape))
    return MEAN + np.einsum("ik,kna->ina", rng.normal(0, [0.06, 0.03], (m, 2)), modes)


def observed(shapes: np.ndarray, rng: np.random.Generator, noise: float) -> np.ndarray:
    """The landmarks of specimens in images, as one observer places them."""
    scales = np.exp(rng.normal(4, 0.2, len(shapes)))
    turns = [rotation(angle) for angle in rng.normal(0, 0.3, len(shapes))]
    marked = shapes + rng.normal(0, noise, shapes.shape)
    return np.array([s * marks @ turn.T + 100.0 for s, marks, turn in zip(scales, marked, turns, strict=True)])


@pytest.mark.parametrize("shrinkage", [1.0, 0.7])
def test_shrinkage_is_found_whatever_the_labels_noise(rng, shrinkage):
    truth = specimens(rng)
    mean = truth.mean(axis=0)
    automatic = observed(mean + shrinkage * (truth - mean), rng, 0.0)
    labels = [observed(truth, rng, 0.02) for _ in range(2)]
    found = compare_shapes(automatic, *labels)
    assert found.slope == pytest.approx(shrinkage, abs=0.03)
    assert found.variance_ratio == pytest.approx(shrinkage**2, abs=0.04)
    assert found.components[0]["slope"] == pytest.approx(shrinkage, abs=0.03)
    by_one = compare_shapes(automatic, labels[0])
    assert by_one.slope < found.slope - 0.02  # too small by the labels' reliability
    assert found.p_of_means > 0.01


def test_a_bias_is_found_at_its_landmark(rng):
    truth = specimens(rng, 60)
    labels = observed(truth, rng, 0.01)
    moved = truth.copy()
    moved[:, 6] += [0.08, 0.0]
    found = compare_shapes(observed(moved, rng, 0.01), labels)
    assert found.p_of_means < 0.01 and found.mean_distance > 1
    assert np.linalg.norm(found.bias, axis=1).argmax() == 6
    assert found.by_landmark()["bias_x_percent"][6] > 1
    assert "more than by chance" in found.report()


def test_position_size_and_rotation_do_not_matter(rng):
    truth = specimens(rng, 20)
    automatic = truth + rng.normal(0, 0.01, truth.shape)
    found = compare_shapes(automatic, truth)
    moved = compare_shapes(observed(automatic, rng, 0.0), truth)
    assert moved.slope == pytest.approx(found.slope, abs=1e-9)
    assert moved.variance_ratio == pytest.approx(found.variance_ratio, abs=1e-9)


def test_specimens_without_all_landmarks_are_left_out_and_counted(rng):
    truth = specimens(rng, 12)
    automatic = truth + rng.normal(0, 0.01, truth.shape)
    lacking = truth.copy()
    lacking[[1, 4], 2] = np.nan
    found = compare_shapes(automatic, lacking)
    assert (found.n_specimens, found.n_left_out) == (10, 2)
    kept = np.isfinite(lacking).all(axis=(1, 2))
    assert found.slope == pytest.approx(compare_shapes(automatic[kept], truth[kept]).slope)


def test_wrong_input_is_refused_by_name(rng):
    truth = specimens(rng, 8)
    with pytest.raises(LiaamError, match="4 specimens with all landmarks: variances of shape are compared from 5"):
        compare_shapes(truth[:4] + 0.1, truth[:4])
    with pytest.raises(LiaamError, match="the labels are copies of the automatic landmarks"):
        compare_shapes(truth, truth)
    alike = np.tile(truth[0], (8, 1, 1))
    with pytest.raises(LiaamError, match="the labels of all specimens have one shape"):
        compare_shapes(truth, alike + rng.normal(size=(8, 1, 2)))
    with pytest.raises(LiaamError, match="3 specimens with all landmarks"):
        compare_shapes(truth, np.where(np.arange(8)[:, None, None] < 5, 7.0, truth + 0.1))  # all in one place
    with pytest.raises(LiaamError, match="not of the same specimens"):
        compare_shapes(truth, truth[:, :3])
