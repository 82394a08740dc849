"""Estimates of missing landmarks: geomorph's, known shapes, and what cannot be estimated."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from geomorph_results import read_set
from liaam.errors import LiaamError
from liaam.model.shape import align
from liaam.morphometry import Specimen, estimated_on_a_side, far_estimates, measure, with_estimated_landmarks
from liaam.morphometry.missing import METHODS, estimate_missing
from liaam.morphometry.superimposition import superimpose

GAPS = ((2, 3), (5, 9), (11, 1), (11, 8))
"""Specimens and landmarks, from 1, that geomorph estimated."""


def with_gaps(geomorph: Path) -> np.ndarray:
    shapes, _ = read_set(geomorph, "object")
    shapes = shapes.reshape(-1, *shapes.shape[-2:])
    for specimen, landmark in GAPS:
        shapes[specimen - 1, landmark - 1] = np.nan
    return shapes


def printed(path: Path) -> np.ndarray:
    lines = re.findall(r"specimen (\d+) landmark (\d+): (\S+) (\S+)", path.read_text())
    assert [(int(specimen), int(landmark)) for specimen, landmark, *_ in lines] == [*GAPS]
    return np.array([[float(x), float(y)] for _, _, x, y in lines])


def test_splines_are_geomorphs(geomorph) -> None:
    shapes = with_gaps(geomorph)
    found, faults = estimate_missing(shapes, "tps")
    assert faults == ()
    own = [found[specimen - 1, landmark - 1] for specimen, landmark in GAPS]
    np.testing.assert_allclose(own, printed(geomorph / "object-missing-tps.txt"), atol=1e-6)
    there = np.isfinite(shapes)
    np.testing.assert_array_equal(found[there], shapes[there])


def test_regressions_are_geomorphs(geomorph) -> None:
    shapes = with_gaps(geomorph)
    found, faults = estimate_missing(shapes, "regression")
    assert faults == ()
    complete = shapes[np.isfinite(shapes).all(axis=(1, 2))]
    # geomorph leaves specimens that it completes turned to the mean of the others, about the centroid of what is there.
    fit = superimpose(complete)
    reference = (fit.shapes * fit.sizes[:, None, None]).mean(axis=0)
    own = []
    for specimen, landmark in GAPS:
        shape = shapes[specimen - 1]
        known = np.isfinite(shape).all(axis=1)
        turn = align(shape[known], reference[known] - reference[known].mean(axis=0)).matrix
        turn /= np.sqrt(np.linalg.det(turn))
        own.append((found[specimen - 1, landmark - 1] - shape[known].mean(axis=0)) @ turn.T)
    right = printed(geomorph / "object-missing-regression.txt")
    common = align(np.array(own), right).matrix  # geomorph's mean has another orientation
    common /= np.sqrt(np.linalg.det(common))
    np.testing.assert_allclose(own @ common.T, right, atol=2e-6)


MEAN = np.array([[-30.0, 20], [30, 20], [-40, -25], [40, -25], [0, 45], [0, -50]])


@pytest.mark.parametrize("method", METHODS)
def test_other_positions_turns_and_mirror_images_have_the_same_estimates(method, rng) -> None:
    shapes = MEAN + rng.normal(0, 3, (12, 6, 2))
    shapes[3, 2] = np.nan
    expected = estimate_missing(shapes, method)[0][3, 2]
    turn = np.array([[0.6, 0.8], [-0.8, 0.6]])
    moved = shapes.copy()
    moved[3] = moved[3] @ turn + [1000, -500]
    np.testing.assert_allclose(estimate_missing(moved, method)[0][3, 2], expected @ turn + [1000, -500], atol=1e-8)
    mirrored = estimate_missing(shapes * [-1, 1], method)[0][3, 2]
    np.testing.assert_allclose(mirrored, expected * [-1, 1], atol=1e-8)


@pytest.mark.parametrize("method", METHODS)
def test_estimates_are_nearer_than_the_mean_position(method, rng) -> None:
    angles = np.arange(30) * 2 * np.pi / 30
    circle = 100 * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    shapes = np.repeat(circle[None], 40, axis=0)
    shapes[..., 0] += rng.normal(0, 10, (40, 1)) * np.sin(angles) ** 2  # all bend alike
    truth = shapes.copy()
    shapes[:5, 7] = np.nan
    found, _ = estimate_missing(shapes, method)
    error = np.linalg.norm(found[:5, 7] - truth[:5, 7], axis=1)
    assert error.mean() < 0.5 * np.linalg.norm(truth[5:, 7].mean(axis=0) - truth[:5, 7], axis=1).mean()


def specimens_with_gaps(rng: np.random.Generator) -> list[Specimen]:
    covariances = np.tile(np.eye(2), (6, 1, 1))
    points = MEAN + rng.normal(0, 1, (8, 6, 2))
    points[1, [0, 4]] = np.nan
    return [Specimen(f"w{i}", each, covariances) for i, each in enumerate(points)]


def test_estimates_are_marked_and_have_no_standard_errors(rng) -> None:
    specimens = specimens_with_gaps(rng)
    found, faults = with_estimated_landmarks(specimens, "tps")
    assert faults == ()
    assert [specimen.estimated for specimen in found] == [(), (0, 4), *[()] * 6]
    assert np.isfinite(found[1].points).all()
    table = measure(found, ["distance:1-2", "distance:3-4"])
    assert table["estimated"] == ["", "1; 5", *[""] * 6]
    assert np.isfinite(table["distance_1_2"]).all()
    assert np.isnan(table["distance_1_2_se"][1])
    assert table["distance_3_4_se"][1] == pytest.approx(np.sqrt(2))
    assert "estimated" not in measure(specimens)


def test_ends_of_scale_bars_and_specimens_that_are_not_to_be_used_are_left_alone(rng) -> None:
    specimens = specimens_with_gaps(rng)
    lost = Specimen("lost", np.full((6, 2), np.nan), status="diverged")
    found, _ = with_estimated_landmarks([*specimens, lost], "tps", "5-6=10")
    assert found[1].estimated == (0,)
    assert np.isnan(found[1].points[4]).all()
    assert found[-1] is lost


def test_what_cannot_be_estimated_is_named(rng) -> None:
    mean = MEAN.copy()
    mean[:3] = [[0, 0], [10, 10], [20, 20]]
    points = mean + rng.normal(0, 1, (5, 6, 2))
    points[2:, :3] = mean[:3]
    points[0, :4] = np.nan
    points[1, 3:] = np.nan
    specimens = [Specimen(f"w{i}", each) for i, each in enumerate(points)]
    specimens[2:] = [Specimen(f"w{i}", mean + 5 * i) for i in range(2, 5)]
    found, faults = with_estimated_landmarks(specimens, "tps")
    assert [specimen.estimated for specimen in found] == [()] * 5
    assert faults[0] == "w0: 4 of 6 landmarks are missing, and are not estimated: at least 3 must be there"
    assert faults[1].startswith("w1: the landmarks that are there lie on one line")
    _, faults = with_estimated_landmarks(specimens, "regression")
    assert "w1: 3 landmarks are missing, for which regression needs 8 complete specimens, and there are 3" in faults[1]
    with pytest.raises(LiaamError, match=r"1 of 3 specimens have all landmarks, and two are needed .* some of w0, w1"):
        with_estimated_landmarks(specimens[:3], "tps")
    with pytest.raises(LiaamError, match="cannot be estimated by 'mean': give tps or regression"):
        with_estimated_landmarks(specimens, "mean")


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("known", ["scale", "units", "bar"])
def test_sizes_are_those_by_the_scale_if_it_is_known_of_all(method, known, rng) -> None:
    shapes = MEAN * rng.uniform(0.5, 2.0, (20, 1, 1)) + rng.normal(0, 1, (20, 6, 2))
    shapes[3, 4] = np.nan
    right = estimate_missing(shapes, method)[0][3, 4]
    bars = np.tile([[0.0, 80.0], [10.0, 80.0]], (20, 1, 1))
    zooms = rng.uniform(1.0, 5.0, 20)
    points = np.concatenate([shapes, bars], axis=1) * zooms[:, None, None]
    if known != "bar":
        points = points[:, :6]
    units = [("mm", 1.0) if known != "units" or i % 2 else ("cm", 0.1) for i in range(20)]
    scales = [None if known == "bar" else units[i][1] / zooms[i] for i in range(20)]
    specimens = [Specimen(f"{i}", points[i], scale=scales[i], unit=units[i][0]) for i in range(20)]
    bar = "7-8=10 mm" if known == "bar" else None
    found, _ = with_estimated_landmarks(specimens, method, bar)
    np.testing.assert_allclose(found[3].points[4] / zooms[3], right, atol=1e-8)
    some = [replace(specimens[0], scale=None), *specimens[1:]]  # sizes in pixels, as before
    in_pixels = estimate_missing(points[:, :6], method)[0][3, 4]
    if known != "bar":
        np.testing.assert_allclose(with_estimated_landmarks(some, method)[0][3].points[4], in_pixels, atol=1e-8)


WING = np.array([[0.0, 0], [30, -12], [60, -14], [80, -7], [88, 2], [78, 11], [52, 15], [28, 11], [30, 0], [48, -3]])
TIP = [3, 4, 5]


def wings(rng: np.random.Generator, n: int) -> np.ndarray:
    """Return similar wings, whose tips are far from the centre of the other landmarks."""
    own = WING + rng.normal(0, 1.0, (n, *WING.shape))
    return 5 * own * rng.uniform(0.9, 1.1, (n, 1, 1)) + rng.uniform(0, 200, (n, 1, 2))


@pytest.mark.parametrize("has_bar", [False, True])
def test_estimates_far_from_complete_specimens_are_named(rng, has_bar) -> None:
    shapes = wings(rng, 36)
    truth = shapes[[4, 20]].copy()
    shapes[4, TIP] = np.nan
    shapes[20, 8] = np.nan
    if has_bar:  # whose ends are anywhere
        shapes = np.concatenate([shapes, rng.uniform(-1e3, 1e3, (36, 2, 2))], axis=1)
    bar = "11-12=10" if has_bar else None
    names = tuple("abcdefghijkl"[: shapes.shape[1]])
    specimens = [Specimen(f"w{i}", each, names=names, scale=None) for i, each in enumerate(shapes)]
    found, _ = with_estimated_landmarks(specimens, "tps", bar)
    assert far_estimates(found, bar) == ()
    right = [*found[:4], replace(found[4], points=np.concatenate([truth[0], shapes[4, 10:]])), *found[5:]]
    assert far_estimates(right, bar) == ()
    if has_bar:  # whose lengths make sizes differ too much for a regression
        wrong = found[4].points.copy()
        wrong[TIP] += [0, 150]
        found = [*found[:4], replace(found[4], points=wrong), *found[5:]]
    else:
        found, _ = with_estimated_landmarks(specimens, "regression")
        error = np.linalg.norm(found[4].points[TIP] - truth[0, TIP], axis=1)
        assert error.min() > 40  # a regression about other centres; the wings are 440 long
    lines = far_estimates(found, bar)
    assert len(lines) == 1
    ratios = re.fullmatch(r"w4: d \((\d+) times\), e \((\d+) times\), f \((\d+) times\)", lines[0])
    assert ratios and min(map(int, ratios.groups())) > 4


def test_few_complete_specimens_do_not_say_what_is_far(rng) -> None:
    shapes = wings(rng, 5)
    specimens = [Specimen(f"w{i}", each) for i, each in enumerate(shapes)]
    moved = replace(specimens[0], points=shapes[0] + 300 * (np.arange(10)[:, None] == 4), estimated=(4,))
    assert far_estimates([moved, *specimens[1:]]) == ()
    assert len(far_estimates([moved, *specimens[1:], Specimen("w5", wings(rng, 1)[0])])) == 1
    assert far_estimates(()) == () and far_estimates([moved]) == ()


def test_landmarks_that_are_estimated_on_one_side_only_are_reported(rng):
    base = np.array([[0.0, 0], [60, 5], [120, 20], [90, 70], [30, 60]])
    specimens = [
        Specimen(f"w{i}", base + rng.normal(0, 1, base.shape), side="left" if i % 2 else "right", estimated=(3,))
        for i in range(6)
    ]
    assert estimated_on_a_side(specimens) == ()  # on both
    lacking = [replace(each, estimated=(3,) if each.side == "left" else ()) for each in specimens]
    (line,) = estimated_on_a_side(lacking)
    assert line.startswith("landmark 4 is estimated in all left specimens: differences between the sides there are")
    assert estimated_on_a_side([replace(lacking[1], estimated=()), *lacking]) == ()
    assert estimated_on_a_side([each for each in lacking if each.side == "left"]) == ()
