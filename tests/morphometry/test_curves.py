"""Curves: even points along their length, bending energy, and semilandmarks that slide."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from ktch.landmark import GeneralizedProcrustesAnalysis, define_curve_sliders

from liaam.errors import LiaamError
from liaam.io import read_collection
from liaam.io.landmarks import Contour
from liaam.model.shape import align, procrustes_mean, rotation
from liaam.morphometry import Specimen, curves, measure, read_specimens, with_even_curves
from liaam.morphometry.curves import CRITERIA, _JoinedCurves, _lengths, bending_energy, resample, semilandmarks, slide

SOME = settings(max_examples=20, deadline=None)
seeds = st.integers(0, 2**32 - 1)

CURVES = (Contour(tuple(range(10))), Contour((9, *range(10, 16), 0)))
"""The upper and the lower margin of a leaf; landmarks 16 and 17 lie on it."""


def leaves(number: int, seed: int = 3) -> np.ndarray:
    """Leaves of length 10 with points at nearly even distances along the margins."""
    rng, found = np.random.default_rng(seed), []
    for _ in range(number):
        a = rng.normal(0, 0.05, 8)
        u, v = np.linspace(0, 1, 10), np.linspace(0, 1, 8)
        u[1:-1] += rng.normal(0, 0.01, 8)
        v[1:-1] += rng.normal(0, 0.01, 6)
        top = np.stack([10 * u, 3 * np.sin(np.pi * u) * (1 + a[0]) + a[1] * 10 * u * (1 - u)], axis=1)
        low = np.stack([10 - 10 * v, -2 * np.sin(np.pi * v) * (1 + a[2]) + a[3] * 8 * v * (1 - v)], axis=1)
        found.append(np.concatenate([top, low[1:-1], [[3 + a[4], 0]], [[7 + a[5], 0.3 + a[6]]]]))
    return np.array(found)


def test_points_at_even_distances() -> None:
    line = np.array([[0.0, 0], [1, 0], [1, 0], [4, 0], [4, 2]])
    np.testing.assert_allclose(resample(line, 4), [[0, 0], [2, 0], [4, 0], [4, 2]])
    square = np.array([[0.0, 0], [2, 0], [2, 2], [0, 2]])
    np.testing.assert_allclose(resample(square, 8, closed=True)[[0, 1, 7]], [[0, 0], [1, 0], [0, 1]])
    np.testing.assert_array_equal(resample(line[:1], 3), np.zeros((3, 2)))
    assert np.isnan(resample(np.array([[0.0, 0], [np.nan, np.nan], [1, 1]]), 5)).all()


def test_spline_of_a_square_to_a_kite_is_that_of_bookstein_1989() -> None:
    square = np.array([[0.0, 1], [-1, 0], [0, -1], [1, 0]])
    kite = np.array([[0, 0.75], [-1, 0.25], [0, -1.25], [1, 0.25]])
    weights = bending_energy(square) @ kite
    np.testing.assert_allclose(weights[:, 0], 0, atol=1e-12)
    np.testing.assert_allclose(weights[:, 1], [-0.0902, 0.0902, -0.0902, 0.0902], atol=5e-5)


@given(seed=seeds)
@SOME
def test_affine_maps_do_not_bend(seed: int) -> None:
    rng = np.random.default_rng(seed)
    shape = rng.normal(0, 1, (8, 2))
    energy = bending_energy(shape)
    np.testing.assert_allclose(energy, energy.T, atol=1e-9 * np.abs(energy).max())
    assert np.linalg.eigvalsh(energy).min() > -1e-9 * np.abs(energy).max()
    moved = shape @ rng.normal(0, 1, (2, 2)) + rng.normal(0, 9, 2)
    np.testing.assert_allclose(energy @ moved, 0, atol=1e-8 * np.abs(energy).max())


def test_points_that_coincide_have_a_bending_energy() -> None:
    shape = leaves(1)[0]
    twice = bending_energy(np.concatenate([shape, shape[:1]]))
    assert np.isfinite(twice).all()
    np.testing.assert_allclose(twice @ np.concatenate([shape, shape[:1]]), 0, atol=1e-9)


@pytest.mark.parametrize("criterion", CRITERIA)
@given(seed=seeds)
@SOME
def test_a_step_of_sliding_never_raises_the_criterion(criterion: str, seed: int) -> None:
    shape, other = leaves(2, seed)
    shape[1:9] += np.random.default_rng(seed).normal(0, 0.2, (8, 2))  # a rough curve
    mean = other - other.mean(axis=0)
    mean /= np.linalg.norm(mean)
    weights = bending_energy(mean) if criterion == "bending" else np.eye(len(mean))
    chain, sliding = semilandmarks(CURVES)
    track = _JoinedCurves(shape, chain, sliding, _lengths(shape[chain]))
    places = track.step(track.lengths, mean, weights)
    assert (np.diff(places) >= 0).all()
    costs = []
    for at in (track.lengths, places):
        away = track.shape_at(at) - align(mean, shape)(mean)
        costs.append(np.trace(away.T @ weights @ away))
    assert costs[1] <= costs[0] * (1 + 1e-12)


@pytest.mark.parametrize("criterion", CRITERIA)
def test_sliding_moves_semilandmarks_only_and_along_their_curves(criterion: str) -> None:
    shapes = leaves(5)
    slid = slide(shapes, CURVES, criterion)
    still = [0, 9, 16, 17]
    np.testing.assert_array_equal(slid[:, still], shapes[:, still])
    assert np.linalg.norm(slid - shapes, axis=2).max() > 0.05
    starts, ends = shapes[:, :9], shapes[:, 1:10]
    for points in np.moveaxis(slid[:, 1:9], 1, 0):
        around = np.linalg.norm(points[:, None] - starts, axis=2) + np.linalg.norm(points[:, None] - ends, axis=2)
        np.testing.assert_allclose((around - np.linalg.norm(ends - starts, axis=2)).min(axis=1), 0, atol=1e-9)


@pytest.mark.parametrize("criterion", CRITERIA)
def test_sliding_does_not_depend_on_position_orientation_and_size(criterion: str) -> None:
    shapes = leaves(4)
    moved = np.array([(3 + i) * shape @ rotation(i).T + 100 * i for i, shape in enumerate(shapes)])
    expected = slide(shapes, CURVES, criterion)
    found = slide(moved, CURVES, criterion)
    back = np.array([(shape - 100 * i) @ rotation(i) / (3 + i) for i, shape in enumerate(found)])
    np.testing.assert_allclose(back, expected, atol=1e-6)


@pytest.mark.parametrize(
    ("criterion", "theirs"), [("bending", "bending_energy"), ("procrustes", "procrustes_distance")]
)
def test_slid_shapes_are_those_of_another_package(criterion: str, theirs: str, monkeypatch) -> None:
    monkeypatch.setattr(curves, "_ROUNDS", 3)
    monkeypatch.setattr(curves, "_TOLERANCE", 0)
    shapes = leaves(12)
    sliders = np.concatenate([define_curve_sliders(range(10)), define_curve_sliders([9, *range(10, 16), 0])])
    gpa = GeneralizedProcrustesAnalysis(curves=sliders, sliding_criterion=theirs, max_iter=3, tol=0)
    with pytest.warns(UserWarning, match="did not converge"):
        other = np.asarray(gpa.fit_transform(shapes.reshape(12, -1))).reshape(shapes.shape)
    slid = slide(shapes, CURVES, criterion)
    assert np.linalg.norm(apart(shapes, other), axis=2).max() > 0.02  # of the centroid size
    assert np.linalg.norm(apart(slid, other), axis=2).max() < 0.0006
    consensus = apart(procrustes_mean(slid)[None], procrustes_mean(other)[None])
    assert np.linalg.norm(consensus, axis=2).max() < 0.0003
    assert spread(slid) == pytest.approx(spread(other), rel=0.01)
    assert spread(slid) < 0.5 * spread(shapes)


def apart(shapes: np.ndarray, others: np.ndarray) -> np.ndarray:
    return np.array([align(shape, other)(shape) - other for shape, other in zip(shapes, others, strict=True)])


def spread(shapes: np.ndarray) -> float:
    """Sum of squared Procrustes distances from the mean shape."""
    mean = procrustes_mean(shapes)
    return sum(np.square(align(shape, mean)(shape) - mean).sum() for shape in shapes)


def test_the_mean_shape_is_the_mean_of_the_aligned_shapes() -> None:
    shapes = leaves(6)
    mean = procrustes_mean(shapes)
    new = np.mean([align(shape, mean)(shape) for shape in shapes], axis=0)
    np.testing.assert_allclose(new / np.linalg.norm(new), mean, atol=1e-9)


def test_which_landmarks_slide() -> None:
    chain, sliding = semilandmarks([Contour((0, 1, 2, 3)), Contour((3, 4, 2, 5)), Contour((6, 7, 8), closed=True)])
    assert chain[sliding].tolist() == [1, 4, 7, 8]  # 2 lies on two curves, 6 begins a closed one
    assert semilandmarks([Contour((0,)), Contour(())])[1].tolist() == []
    shapes = leaves(3)
    np.testing.assert_array_equal(slide(shapes, (), "bending"), shapes)
    with pytest.raises(LiaamError, match="cannot slide by 'energy': give bending or procrustes"):
        slide(shapes, CURVES, "energy")


def traced(path, counts=((5, 4), (9, 3), (4, 7))):
    """Write a .tps with curves of any number of points."""
    records = []
    for i, own in enumerate(counts):
        lines = ["LM=2", "0 0", "10 0", "CURVES=2"]
        for sign, count in zip((1, -1), own, strict=True):
            u = np.linspace(0, 1, count) ** (1 + i / 3)
            lines.append(f"POINTS={count}")
            lines += [f"{10 * t} {sign * (2 + i / 9) * np.sin(np.pi * t)}" for t in u]
        records.append("\n".join([*lines, f"IMAGE={i}.png", f"ID={i}"]))
    path.write_text("\n".join(records) + "\n")
    return path


def test_curves_traced_with_any_number_of_points_become_comparable(tmp_path) -> None:
    specimens = read_specimens(traced(tmp_path / "all.tps"))
    even = with_even_curves(specimens, "6, 5")
    assert {len(own.points) for own in even} == {2 + 6 + 5}
    assert even[0].curves == (Contour(tuple(range(2, 8))), Contour(tuple(range(8, 13))))
    steps = np.linalg.norm(np.diff(resample(specimens[1].points[2:11], 6), axis=0), axis=1)
    assert steps.std() < 0.02 * steps.mean()
    table = measure(even, "distance:1-2", slide="bending")
    assert table["distance_1_2"] == pytest.approx([10, 10, 10])
    assert np.isfinite(table["X13"]).all()
    with pytest.raises(LiaamError, match="no specimen has curves to resample by 6,5,4: give one number"):
        with_even_curves(specimens, "6,5,4")
    for numbers in (2, -5, "", "x", "6,", "9" * 20, "1e3", "²", 1001):
        with pytest.raises(LiaamError, match=f"curves of {numbers} points: give 3 to 1000, such as 20"):
            with_even_curves(specimens, numbers)


def test_shared_landmarks_and_names_stay() -> None:
    points = np.array([[0.0, 0], [1, 1], [2, 0], [1, -1], [1, 0]])
    lines = (Contour((0, 1, 2)), Contour((2, 3, 0)))
    own = Specimen("a", points, np.tile(np.eye(2), (5, 1, 1)), ("base", "up", "tip", "low", "eye"), curves=lines)
    (even,) = with_even_curves([own], 5)
    assert even.names[:3] == ("base", "tip", "eye")
    assert even.curves == (Contour((0, 3, 4, 5, 1)), Contour((1, 6, 7, 8, 0)))
    assert even.covariances is None
    np.testing.assert_allclose(even.points[4], [1, 1])


def test_sliding_leaves_out_the_scale_bar_and_what_has_no_shape() -> None:
    shapes = leaves(4)
    shapes[2, 3] = np.nan
    bars = np.array([[[0.0, -9 - i], [5, -9 + 2 * i]] for i in range(4)])
    plain = [Specimen(str(i), shape, curves=CURVES) for i, shape in enumerate(shapes)]
    both = np.concatenate([shapes, bars], axis=1)
    barred = [Specimen(str(i), shape, curves=CURVES) for i, shape in enumerate(both)]
    expected, found = measure(plain, slide="procrustes"), measure(barred, scale="19-20=5", slide="procrustes")
    np.testing.assert_allclose(found["X5"], expected["X5"], atol=1e-9)
    assert np.isfinite(found["X5"]).tolist() == [True, True, False, True]
    with pytest.raises(LiaamError, match="no specimen has curves to slide along"):
        measure([Specimen("a", shapes[0])], slide="bending")


def test_curves_of_a_public_file_are_measured(shared_data) -> None:
    path = shared_data.parent / "cases" / "07-tps-curves" / "all.tps"
    if not path.exists():
        pytest.skip("the cases are absent")
    table = measure(with_even_curves(read_specimens(path), 7), slide="bending")
    assert len(table["specimen"]) == len(read_collection(path)) == 10
    assert np.isfinite(table["X16"]).all()
