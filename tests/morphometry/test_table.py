"""Tables of measurements: units, standard errors, what is left empty, and that pandas reads them."""

import numpy as np
import pandas as pd
import pytest

from liaam.errors import LiaamError
from liaam.io import write_columns
from liaam.morphometry import Specimen, measure

SQUARE = np.array([[0.0, 0], [10, 0], [10, 10], [0, 10]])
MEASURES = ("distance:1-2", "angle:1-2-3", "area:1-2-3-4")


def test_values_in_pixels_and_in_units() -> None:
    one = measure([Specimen("a", SQUARE)], MEASURES)
    assert list(one) == [
        *("specimen", "distance_1_2", "angle_1_2_3", "area_1_2_3_4", "centroid_size"),
        *("X1", "Y1", "X2", "Y2", "X3", "Y3", "X4", "Y4"),
    ]
    assert (one["distance_1_2"], one["angle_1_2_3"], one["area_1_2_3_4"]) == ([10], [pytest.approx(90)], [100])
    two = measure([Specimen("a", SQUARE, scale=0.5)], MEASURES)
    assert (two["scale"], two["distance_1_2"], two["area_1_2_3_4"]) == ([0.5], [5], [25])
    assert two["angle_1_2_3"] == one["angle_1_2_3"]
    assert measure([Specimen("a", SQUARE, scale=0.5)], MEASURES, 2)["distance_1_2"] == [20]


def test_one_measure_needs_no_list_and_a_scale_is_positive() -> None:
    specimens = [Specimen("a", SQUARE)]
    assert measure(specimens, "distance:1-2")["distance_1_2"] == [10]
    for scale in (-1, 0.0, np.nan):
        with pytest.raises(LiaamError, match=f"scale '{scale}': give the length of a pixel"):
            measure(specimens, scale=scale)


def test_y_of_shapes_points_upwards() -> None:
    table = measure([Specimen("a", SQUARE)])
    assert table["Y1"][0] > table["Y3"][0]  # the first lies above the third in the image
    assert table["X1"][0] < table["X2"][0]


def test_a_scale_bar_is_not_part_of_the_shape() -> None:
    bar = np.array([[0.0, 50], [0, 90]])
    table = measure([Specimen("a", np.concatenate([SQUARE, bar]))], MEASURES, "5-6=2")
    assert table["scale"] == [0.05]
    assert table["distance_1_2"] == [0.5]
    assert table["centroid_size"][0] == pytest.approx(0.05 * np.sqrt(200))
    assert "X4" in table
    assert "X5" not in table


def test_landmarks_by_name() -> None:
    specimen = Specimen("a", SQUARE, names=("base", "tip", "3", "left-eye"))
    table = measure([specimen], ["distance:base-tip", "distance:tip,left-eye", "distance:1-4"])
    assert table["distance_base_tip"] == [10]
    assert table["distance_tip_left_eye"][0] == pytest.approx(np.sqrt(200))
    with pytest.raises(LiaamError, match=r"distance_1_9: there is no landmark '9'; give numbers from 1 to 4 or their"):
        measure([specimen], ["distance:1-9"])


@pytest.mark.parametrize("scale", [None, "0.02", "7-8=3"])
def test_standard_errors_are_those_of_noisy_landmarks(rng, scale: str | None) -> None:
    """Monte Carlo: the spread over specimens with noise of the given covariances."""
    angles = np.arange(8) * np.pi / 4 + rng.uniform(-0.2, 0.2, 8)
    points = 200 * np.stack([np.cos(angles), np.sin(angles)], axis=1) * rng.uniform(0.7, 1.3, (8, 1))
    roots = rng.normal(0, 0.5, (8, 2, 2))
    covariances = roots @ roots.swapaxes(1, 2)
    noise = np.einsum("nij,mnj->mni", roots, rng.normal(size=(1000, 8, 2)))
    wanted = ("distance:1-4", "angle:1-3-6", "area:1-2-3-4-5-6")
    told = measure([Specimen("a", points, covariances)], wanted, scale)
    seen = measure([Specimen("a", points), *(Specimen("b", points + shift) for shift in noise)], wanted, scale)
    columns = [name for name in told if name.endswith("_se")]
    assert len(columns) == 3 + 1 + 2 * (6 if scale == "7-8=3" else 8)
    for name in columns:
        spread = np.std(seen[name.removesuffix("_se")][1:])
        # The standard deviation of 1,000 draws has an error of 2.2 %.
        assert told[name][0] == pytest.approx(spread, rel=0.09), name


def test_what_cannot_be_measured_is_empty() -> None:
    hole = SQUARE.copy()
    hole[3] = np.nan
    covariances = np.tile(np.eye(2), (4, 1, 1))
    specimens = [
        Specimen("whole", SQUARE, covariances, status="converged"),
        Specimen("hole", hole, covariances),
        Specimen("lost", SQUARE * np.nan, status="diverged"),
        Specimen("error", np.zeros((0, 2)), status="error"),
        Specimen("flat", np.zeros((4, 2)), covariances),
    ]
    table = measure(specimens, MEASURES)
    assert table["status"] == ["converged", "", "diverged", "error", ""]
    np.testing.assert_allclose(table["distance_1_2"], [10, 10, np.nan, np.nan, 0])
    np.testing.assert_allclose(table["distance_1_2_se"], [np.sqrt(2), np.sqrt(2), np.nan, np.nan, np.nan])
    np.testing.assert_allclose(table["area_1_2_3_4"], [100, np.nan, np.nan, np.nan, 0])
    assert np.isfinite(table["X1"]).tolist() == [True, False, False, False, False]


def test_specimens_with_other_landmarks_are_left_out() -> None:
    with pytest.warns(UserWarning, match="b: it has 3 landmarks where most have 4; it is left out"):
        columns = measure([Specimen("a", SQUARE), Specimen("b", SQUARE[:3]), Specimen("c", SQUARE)])
    assert columns["specimen"] == ["a", "c"]


def test_without_landmarks_to_use_there_is_nothing_to_measure() -> None:
    with pytest.raises(LiaamError, match="there are 1 specimens, none with landmarks to use"):
        measure([Specimen("a", SQUARE, status="diverged")])


def test_pandas_reads_the_table(tmp_path) -> None:
    specimens = [
        Specimen("a,1", SQUARE, np.tile(np.eye(2), (4, 1, 1)), status="converged", scale=0.1),
        Specimen("b", SQUARE, status="too dark"),
    ]
    table = measure(specimens, MEASURES)
    write_columns(tmp_path / "t.csv", table)
    read = pd.read_csv(tmp_path / "t.csv")
    pd.testing.assert_frame_equal(read, pd.DataFrame(table), rtol=1e-8)
    assert read["specimen"].tolist() == ["a,1", "b"]
    with pytest.raises(LiaamError, match=r"t\.txt: the table is written as CSV; give a name that ends in \.csv"):
        write_columns(tmp_path / "t.txt", table)
