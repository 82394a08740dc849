"""Tables of measurements: units, standard errors, what is left empty, and that pandas reads them."""

from typing import Any

import numpy as np
import pandas as pd
import pytest

from liaam.errors import LiaamError
from liaam.io import write_columns
from liaam.morphometry import Specimen, measure
from liaam.morphometry.table import comparable

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


def test_columns_of_measures_with_names() -> None:
    specimens = [square("a", scale=0.5, unit="mm"), square("b")]
    table = measure(specimens, ["Wing length=distance:1-2", "opening=angle:1-2-3"])
    assert table["Wing_length_mm"][0] == 5
    assert comparable(table, "opening_deg").tolist() == [90, 90]  # angles need no scale
    with pytest.raises(LiaamError, match="two measures have the column 'Width': give one of them another name"):
        measure(specimens, ["width=distance:1-2", "Width=distance:1-3"])


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
    has_bar = scale == "7-8=3"
    assert len(columns) == 3 + 1 + has_bar + 2 * (6 if has_bar else 8)
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


# Units --------------------------------------------------------------------------------------------


def square(name: str, **facts: Any) -> Specimen:
    return Specimen(name, np.array([[0.0, 0], [10, 0], [10, 10], [0, 10]]), **facts)


def test_columns_have_the_unit_that_is_known() -> None:
    wanted = ["distance:1-2", "angle:1-2-3", "area:1-2-3-4"]
    table = measure([square("a")], wanted, "0.0031mm")
    assert list(table)[:6] == [
        *("specimen", "scale_mm_per_px", "distance_1_2_mm", "angle_1_2_3", "area_1_2_3_4_mm2", "centroid_size_mm")
    ]
    assert (table["distance_1_2_mm"], table["area_1_2_3_4_mm2"]) == ([pytest.approx(0.031)], [pytest.approx(0.031**2)])
    assert "distance_1_2" in measure([square("a")], wanted, 0.0031)  # no unit is known
    bar = measure([square("a", covariances=np.tile(np.eye(2), (4, 1, 1)))], wanted[:1], "3-4=5 cm")
    assert bar["distance_1_2_cm"] == [pytest.approx(5)]
    assert bar["scale_cm_per_px_se"] == [pytest.approx(0.5 * np.sqrt(2) / 10)]


def test_scales_of_several_units_are_brought_to_one() -> None:
    specimens = [
        square("a", scale=0.5, unit="mm"),
        square("b", scale=500.0, unit="um"),
        square("c", scale=1, unit="mm"),
    ]
    assert measure(specimens, "distance:1-2")["distance_1_2_mm"] == pytest.approx([5, 5, 10])
    assert measure(specimens, "distance:1-2", "um")["distance_1_2_um"] == pytest.approx([5000, 5000, 10_000])


def test_a_unit_is_not_guessed_for_scales_without_one() -> None:
    specimens = [square("a", scale=0.5, unit="mm"), square("b", scale=0.5)]
    with pytest.raises(LiaamError, match=r"the scale of b has no unit, but that of a is in mm: .*, such as --scale mm"):
        measure(specimens, "distance:1-2")
    assert measure(specimens, "distance:1-2", "mm")["distance_1_2_mm"] == [5, 5]


def test_a_specimen_without_a_scale_has_no_size_in_a_known_unit() -> None:
    table = measure([square("a", scale=0.5, unit="mm"), square("b")], ["distance:1-2", "angle:1-2-3"])
    assert table["distance_1_2_mm"][0] == 5 and np.isnan(table["distance_1_2_mm"][1])
    assert table["angle_1_2_3"] == [90, 90] and table["X1"][0] == pytest.approx(table["X1"][1])


def test_the_error_of_a_scale_is_in_the_table_if_only_specimens_without_a_shape_have_one() -> None:
    broken = square("a", scale=0.1, unit="mm", scale_se=0.01)
    broken.points[0] = np.nan
    columns = measure([broken, square("b")])
    assert columns["scale_mm_per_px_se"] == pytest.approx([0.01, np.nan], nan_ok=True)


def test_the_error_of_a_scale_is_in_the_standard_errors() -> None:
    spread = np.tile(0.01 * np.eye(2), (4, 1, 1))
    [plain, unsure] = (
        measure(
            [square("a", covariances=spread, scale=0.5, unit="mm", scale_se=error)], ["distance:1-2", "area:1-2-3-4"]
        )
        for error in (0.0, 0.01)
    )
    of_points = plain["distance_1_2_mm_se"][0]
    assert of_points == pytest.approx(0.5 * np.sqrt(0.02))
    assert unsure["distance_1_2_mm_se"][0] == pytest.approx(np.hypot(of_points, 10 * 0.01))
    by_scale = 2 * 100 * 0.5 * 0.01  # the area grows with the square of the scale
    assert unsure["area_1_2_3_4_mm2_se"][0] == pytest.approx(np.hypot(plain["area_1_2_3_4_mm2_se"][0], by_scale))
    assert unsure["scale_mm_per_px_se"] == [0.01] and "scale_mm_per_px_se" not in plain
    given = measure([square("a", covariances=spread)], "distance:1-2", "0.5 ± 0.01 mm")
    assert given["distance_1_2_mm_se"] == pytest.approx(unsure["distance_1_2_mm_se"])
    noise = np.random.default_rng(3).normal(0, 1, 20_000)  # Monte Carlo: the delta method holds for 2 % of error
    assert np.std((0.5 + 0.01 * noise) ** 2 * 100) == pytest.approx(by_scale, rel=0.02)
