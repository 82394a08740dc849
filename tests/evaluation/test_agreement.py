"""Automatic shapes beside people's: known shrinkage, bias and noise come back."""

import json

import numpy as np
import pytest

from liaam.errors import LiaamError
from liaam.evaluation import compare_shapes, compare_specimens
from liaam.model.shape import rotation
from liaam.morphometry import Specimen
from liaam.morphometry.superimposition import superimpose

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
    is_low = "below 0.8, true differences appear too small: place landmarks on more pictures" in found.report()
    assert is_low == (shrinkage < 0.8)


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
    found = compare_shapes(automatic, lacking, estimated=np.arange(12) < 4)
    assert found.n_estimated == 3  # of those that are compared
    assert "(3 of them with absent landmarks, at the positions that the fits estimate; 2 left out" in found.report()
    assert found.slope == pytest.approx(compare_shapes(automatic[kept], truth[kept]).slope)


def test_wrong_input_is_refused_by_name(rng):
    truth = specimens(rng, 8)
    with pytest.raises(LiaamError, match="4 specimens with all landmarks: variances of shape are compared from 5"):
        compare_shapes(truth[:4] + 0.1, truth[:4])
    with pytest.raises(LiaamError, match="the landmarks by hand are copies of the automatic landmarks"):
        compare_shapes(truth, truth)
    alike = np.tile(truth[0], (8, 1, 1))
    with pytest.raises(LiaamError, match="the landmarks by hand of all specimens have the same shape"):
        compare_shapes(truth, alike + rng.normal(size=(8, 1, 2)))
    with pytest.raises(LiaamError, match="3 specimens with all landmarks"):
        compare_shapes(truth, np.where(np.arange(8)[:, None, None] < 5, 7.0, truth + 0.1))  # all in one place
    with pytest.raises(LiaamError, match="not of the same specimens"):
        compare_shapes(truth, truth[:, :3])


@pytest.mark.parametrize(("kept", "size"), [(0.9, 0.05), (0.6, 0.1), (0.75, 0.2)])
def test_what_becomes_of_a_difference_between_groups_is_found(rng, kept, size):
    """The direction of the groups is shrunk less, or more, than the rest of the shape."""
    truth = specimens(rng, 200)
    members = np.arange(200) % 2
    direction = rng.normal(size=MEAN.shape)
    direction *= size / np.linalg.norm(direction)
    truth = truth + 5 * members[:, None, None] * direction
    between = members[:, None, None] * direction * 5
    mean = truth.mean(axis=0)
    automatic = mean + 0.8 * (truth - between - (mean - between.mean(axis=0))) + kept * (between - between.mean(axis=0))
    labels = [observed(truth, rng, 0.02) for _ in range(2)]
    names = np.where(members == 1, "b", "a")
    found = compare_shapes(observed(automatic, rng, 0.02), *labels, groups=names)
    assert found.attenuation == pytest.approx(kept, abs=0.07)
    low, high = found.attenuation_interval
    assert low < found.attenuation < high < low + 0.5
    assert f"multiplied by about {found.attenuation:.2f} (" in found.report()
    by_one = compare_shapes(observed(automatic, rng, 0.02), labels[0], groups=names)
    assert by_one.attenuation == pytest.approx(kept, abs=0.07)  # errors of labels hardly enter means of groups


def test_a_slope_s_interval_holds_it(rng):
    inside = 0
    for _ in range(20):
        truth = specimens(rng, 40)
        mean = truth.mean(axis=0)
        labels = [observed(truth, rng, 0.01) for _ in range(2)]
        found = compare_shapes(observed(mean + 0.8 * (truth - mean), rng, 0.02), *labels, permutations=9)
        low, high = found.slope_interval
        inside += low <= 0.8 <= high
    assert inside >= 16  # 19 are expected; fewer than 16 in one of 400 cases


def test_intraclass_correlation_and_reliability_are_those_of_the_noise(rng):
    truth = specimens(rng, 300)
    people = [observed(truth, rng, 0.02) for _ in range(2)]
    found = compare_shapes(observed(truth, rng, 0.06), *people)
    assert found.repeatability < found.repeatability_of_people - 0.1
    exact = superimpose(truth)
    specimen = np.square(exact.shapes - exact.mean).sum() / (len(truth) - 1)
    noise = 10 * np.square(0.06 / exact.sizes).mean()  # 10 coordinates of shape hold it
    expected = specimen / (specimen + noise)
    assert found.reliability == pytest.approx(expected, abs=0.05)
    assert found.calibration == pytest.approx(expected, abs=0.05)
    assert np.isnan(compare_shapes(observed(truth, rng, 0.06), people[0]).repeatability_of_people)


def test_components_on_which_people_do_not_agree_have_no_slope(rng):
    truth = specimens(rng, 100)
    found = compare_shapes(*(observed(truth, rng, 0.02) for _ in range(3)))
    slopes = np.array([component["slope"] for component in found.components])
    assert np.isfinite(slopes[:2]).all() and np.isnan(slopes[2:]).all()  # the shapes vary along two directions
    assert len(found.plot().axes) == 3
    assert json.loads(found.to_json())["components"][-1]["slope"] is None


def test_sentences_for_methods_and_json_hold_the_numbers(rng):
    truth = specimens(rng, 12)
    found = compare_shapes(observed(truth, rng, 0.03), observed(truth, rng, 0.02), observed(truth, rng, 0.02))
    said = found.methods()
    assert said.count(". ") == 1 and said.endswith(".")
    assert f"a slope of {found.slope:.2f}" in said and "of 12 specimens" in said and "(between people" in said
    read = json.loads(found.to_json())
    assert read["methods"] == said
    assert read["slope"] == pytest.approx(found.slope) and read["attenuation"] is None
    assert np.shape(read["bias"]) == (7, 2)
    assert len(found.plot().axes) == 3


def test_labels_that_are_copies_are_left_out_and_counted(rng):
    truth = specimens(rng, 20)
    automatic = 300 * observed(truth, rng, 0.02)
    labels = 300 * observed(truth, rng, 0.02)
    labels[:6] = np.round(automatic[:6])
    labels[6, :4] = automatic[6, :4]  # most of it was accepted
    labels[7, 0] = automatic[7, 0]
    found = compare_shapes(automatic, labels)
    assert (found.n_specimens, found.n_copied) == (13, 7)
    assert "7 left out, whose landmarks by hand are copies of the automatic landmarks" in found.report()
    labels[7:17] = automatic[7:17]
    with pytest.raises(LiaamError, match=r"copies of the automatic landmarks \(17 of 20 specimens\)"):
        compare_shapes(automatic, labels)


def test_groups_that_are_too_small_are_refused(rng):
    truth = specimens(rng, 8)
    pair = (truth + rng.normal(0, 0.01, truth.shape), truth)
    with pytest.raises(
        LiaamError, match=r"two groups of 2 specimens or more that can be compared: there are a \(7\), b \(1\)"
    ):
        compare_shapes(*pair, groups=["a"] * 7 + ["b"])
    with pytest.raises(LiaamError, match="3 groups of 8 specimens"):
        compare_shapes(*pair, groups=["a", "a", "b"])


def test_specimens_are_paired_by_name(rng):
    truth = specimens(rng, 8)
    automatic = truth + rng.normal(0, 0.02, truth.shape)
    names = tuple("abcdefg")
    fits = [Specimen(f"w{i}", points, names=names) for i, points in enumerate(automatic)]
    order = [6, 5, 4, 3, 2, 1, 0]
    labels = [Specimen(f"w{i}", truth[i][order], names=names[::-1]) for i in (7, 5, 3, 1, 0, 2, 4)]
    found = compare_specimens(fits, [labels])
    used = [0, 1, 2, 3, 4, 5, 7]
    assert (found.n_specimens, found.n_left_out) == (7, 1)
    assert found.slope == pytest.approx(compare_shapes(automatic[used], truth[used]).slope)
    with pytest.raises(LiaamError, match="labels: there are no landmarks of the same specimens: it has x0"):
        compare_specimens(fits, [[Specimen("x0", truth[0])]])
    with pytest.raises(LiaamError, match="labels: w3 has 5 landmarks where the others have 7"):
        compare_specimens(fits, [[Specimen("w3", truth[3][:5])]])


def test_estimated_landmarks_are_compared_with_nobody_s(rng):
    truth = specimens(rng, 8)
    fits = [
        Specimen(f"w{i}", points, estimated=(2,) if i == 3 else ())
        for i, points in enumerate(truth + rng.normal(0, 0.02, truth.shape))
    ]
    labels = [Specimen(f"w{i}", points, estimated=(0, 4) if i == 5 else ()) for i, points in enumerate(truth)]
    found = compare_specimens(fits, [labels])
    assert (found.n_specimens, found.n_left_out) == (6, 2)


def test_records_of_an_individual_count_together(rng):
    truth = np.repeat(specimens(rng, 10), 4, axis=0)
    automatic = observed(truth, rng, 0.02)
    labels = observed(truth, rng, 0.02)
    flies = [f"fly{i // 4}" for i in range(40)]
    found = compare_shapes(automatic, labels, individuals=flies)
    alone = compare_shapes(automatic, labels)
    assert (found.n_specimens, found.n_individuals, alone.n_individuals) == (40, 10, 40)
    assert found.slope == alone.slope and found.slope_interval != alone.slope_interval
    assert found.mean_distance < 0.7 * alone.mean_distance  # the mean of 10 flies is known less well than that of 40
    assert "Automatic landmarks of 40 records of 10 individuals were" in found.methods()
    assert "shapes of 40 records of 10 individuals" in found.report()
    with pytest.raises(LiaamError, match=r"4 individuals with all landmarks: .* from 5 individuals on"):
        compare_shapes(automatic[:16], labels[:16], individuals=flies[:16])
    with pytest.raises(LiaamError, match="10 individuals of 40 specimens"):
        compare_shapes(automatic, labels, individuals=flies[::4])
