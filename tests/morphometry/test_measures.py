"""Functions of landmarks: known values, exact derivatives, and what the short names mean."""

import numpy as np
import pytest
from hypothesis import assume, given, settings, strategies as st
from ktch.landmark import GeneralizedProcrustesAnalysis

from finite_differences import assert_jacobian
from liaam.errors import LiaamError
from liaam.model.shape import procrustes_mean
from liaam.morphometry.measures import (
    Measure,
    ScaleBar,
    angle,
    area,
    centroid_size,
    distance,
    length,
    parse_scale,
    procrustes,
)
from liaam.scale import Length

SOME = settings(max_examples=60, deadline=None)
seeds = st.integers(0, 2**32 - 1)


def test_known_values() -> None:
    assert distance(np.array([[1.0, 2], [4, 6]]))[0] == 5
    assert angle(np.array([[3.0, 0], [0, 0], [0, 2]]))[0] == pytest.approx(90)
    assert angle(np.array([[1.0, 0], [0, 0], [-1, 1]]))[0] == pytest.approx(135)
    assert area(np.array([[0.0, 0], [0, 3], [2, 3], [2, 0]]))[0] == 6  # in either direction
    assert area(np.array([[2.0, 0], [2, 3], [0, 3], [0, 0]]))[0] == 6
    assert length(np.array([[0.0, 0], [3, 4], [3, 10]]))[0] == 11
    assert centroid_size(np.array([[0.0, 0], [2, 0]]))[0] == pytest.approx(np.sqrt(2))


@pytest.mark.parametrize(("function", "n"), [(distance, 2), (angle, 3), (area, 5), (length, 4), (centroid_size, 6)])
@given(seed=seeds)
@SOME
def test_gradients(function, n: int, seed: int) -> None:
    points = np.random.default_rng(seed).normal(0, 50, (n, 2))
    arms = np.diff(points, axis=0)
    assume(np.linalg.norm(arms, axis=1).min() > 5)
    if function is angle:
        assume(5 < angle(points)[0] < 175)  # it has a kink where the arms are in line
    gradient = function(points)[1].reshape(1, -1)
    assume(np.abs(gradient).min() > 1e-3 * np.abs(gradient).max())

    def value(flat: np.ndarray) -> np.ndarray:
        return np.array([function(flat.reshape(-1, 2))[0]])

    assert_jacobian(value, gradient, points.ravel(), steps=1e-3, tolerance=1e-4)


@given(seed=seeds)
@SOME
def test_jacobian_of_procrustes_coordinates(seed: int) -> None:
    rng = np.random.default_rng(seed)
    mean = rng.normal(0, 1, (6, 2))
    mean = (mean - mean.mean(0)) / np.linalg.norm(mean - mean.mean(0))
    points = 40 * (mean + rng.normal(0, 0.05, (6, 2))) + rng.normal(0, 100, 2)
    shape, jacobian = procrustes(points, mean)
    assert np.linalg.norm(shape) == pytest.approx(1)
    np.testing.assert_allclose(shape.mean(axis=0), 0, atol=1e-12)

    def value(flat: np.ndarray) -> np.ndarray:
        return procrustes(flat.reshape(-1, 2), mean)[0].ravel()

    assert_jacobian(value, jacobian, points.ravel(), steps=1e-3, tolerance=1e-6)


def test_shapes_are_those_of_another_package(rng: np.random.Generator) -> None:
    shapes = rng.normal(0, 1, (7, 2)) + rng.normal(0, 0.05, (9, 7, 2))
    mean = procrustes_mean(shapes)
    ours = np.array([procrustes(shape, mean)[0] for shape in shapes])
    theirs = np.asarray(GeneralizedProcrustesAnalysis(scaling=True).fit_transform(shapes.reshape(9, -1)))
    theirs = theirs.reshape(9, 7, 2)
    # Up to one rotation of all.
    turn = procrustes(theirs[0], ours[0])[0]
    spun = np.linalg.lstsq(theirs[0], turn, rcond=None)[0]
    np.testing.assert_allclose(
        theirs @ spun / np.linalg.norm(theirs @ spun, axis=(1, 2), keepdims=True), ours, atol=2e-3
    )


def test_short_names() -> None:
    assert Measure.parse("distance:1-5") == Measure("distance", ("1", "5"))
    assert Measure.parse("angle:left-eye, nose, right-eye").landmarks == ("left-eye", "nose", "right-eye")
    assert Measure.parse("area:1-2-3-4").column == "area_1_2_3_4"
    assert Measure.parse("distance:left-eye,tip of nose").column == "distance_left_eye_tip_of_nose"
    assert Measure.parse("wing length = distance:1-5") == Measure("distance", ("1", "5"), "wing length")
    assert Measure.parse("wing length=distance:1-5").column == "wing_length"
    assert Measure.parse("opening=angle:1-2-3").column == "opening_deg"
    assert parse_scale("0.012") == Length(0.012)
    assert parse_scale("0.0031mm") == Length(0.0031, "mm")
    assert parse_scale("11-12=5") == ScaleBar(("11", "12"), 5)
    assert parse_scale("left-eye, right-eye = 5 ± 0.1 mm") == ScaleBar(("left-eye", "right-eye"), 5, "mm", 0.1)
    assert parse_scale("0,005 mm") == Length(0.005, "mm")
    assert parse_scale("11,12=2,5 mm") == ScaleBar(("11", "12"), 2.5, "mm")
    assert parse_scale("mm") == "mm"


@pytest.mark.parametrize("text", ["1-5", "distance", "distance:", "width:1-2", "distance:1-", ""])
def test_unknown_measures(text: str) -> None:
    with pytest.raises(LiaamError, match=f"measure '{text}': give distance:1-5, angle:1-2-3"):
        Measure.parse(text)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("12=distance:1-2", "cannot be called '12': .* with letters"),
        ("a=b=distance:1-2", "cannot be called 'a=b': .* without ':' and '='"),
        ("Centroid size=distance:1-2", "as another column of tables is"),
        (f"{'w' * 61}=distance:1-2", "longer than 60 characters: shorten it"),
        ("distance:1-2-3", "distance takes 2 different landmarks"),
        ("distance:1-1", "distance takes 2 different"),
        ("angle:1-2", "angle takes 3 different"),
        ("area:1-2", "area takes 3 or more different landmarks"),
        ("length:1", "length takes 2 or more different landmarks"),
    ],
)
def test_wrong_names_and_numbers_of_landmarks(text: str, words: str) -> None:
    with pytest.raises(LiaamError, match=words):
        Measure.parse(text)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "-1",
        "0",
        "nan",
        "5 apples",
        "milimeter",
        "1-2",
        "11,12",
        "1-2=",
        "1-2=mm",
        "1-2=0",
        "1-1=5",
        "1=5",
        "1-2-3=5",
        "=5",
    ],
)
def test_wrong_scales(text: str) -> None:
    with pytest.raises(LiaamError, match=f"scale '{text}': give the length of a pixel") as fault:
        parse_scale(text)
    unknown = {"5 apples": "apples", "milimeter": "milimeter", "nan": "nan"}.get(text)
    assert (f"The unit '{unknown}' is unknown: give one of nm, um, mm" in str(fault.value)) == (unknown is not None)


def test_a_comma_of_thousands_is_told_from_a_decimal_one() -> None:
    with pytest.raises(LiaamError, match=r"'1,250' may be 1\.250 or 1250"):
        parse_scale("1-2=1,250 mm")
