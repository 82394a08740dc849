"""Measurement error from replicates: published figures, known noise, and unbalanced replicates."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.stats import f_oneway

from liaam.errors import LiaamError
from liaam.io import Landmarks, write_collection, write_columns
from liaam.morphometry import (
    Specimen,
    measure,
    measurement_error,
    of_one_side,
    read_specimens,
    replicates as module,
    replicates_repeat_errors,
)


def anova(values: np.ndarray, groups: Sequence[str]) -> dict[str, float]:
    return module.anova(values, groups, values)


RATINGS = np.array([[9, 2, 5, 8], [6, 1, 3, 2], [8, 4, 6, 8], [7, 1, 2, 6], [10, 5, 6, 9], [6, 2, 4, 7]], float)
"""Six persons rated four times, of Shrout & Fleiss (1979), table 2."""


def test_intraclass_correlation_is_that_of_shrout_and_fleiss_1979() -> None:
    found = anova(RATINGS.reshape(-1, 1), [*"aaaabbbbccccddddeeeeffff"])
    assert (found["df_among"], found["df_within"]) == (5, 18)
    assert found["ms_among"] == pytest.approx(11.24, abs=0.005)
    assert found["ms_within"] == pytest.approx(6.26, abs=0.005)
    assert found["repeatability"] == pytest.approx(0.17, abs=0.005)  # ICC(1,1), table 4


def test_unbalanced_replicates_have_the_f_of_scipy() -> None:
    rng = np.random.default_rng(1)
    parts = [rng.normal(mean, 1, count) for mean, count in ((0, 2), (1, 5), (3, 1), (4, 3))]
    values, groups = np.concatenate(parts), [*"aabbbbbcddd"]
    gap = np.concatenate([values, [np.nan]])
    for found in (anova(values[:, None], groups), anova(gap[:, None], [*groups, "a"])):
        assert (found["specimens"], found["replicates"]) == (4, 11)
        np.testing.assert_allclose([found["F"], found["P"]], f_oneway(*parts))
    each = (11 - (4 + 25 + 1 + 9) / 11) / 3
    assert found["repeatability"] == pytest.approx((found["F"] - 1) / (found["F"] + each - 1))


def test_extremes_have_a_defined_answer() -> None:
    same = anova(np.array([[1.0], [1], [2], [2]]), list("aabb"))
    assert (same["F"], same["P"], same["repeatability"], same["sd"]) == (np.inf, 0, 1, 0)
    for values, groups in ((np.ones((2, 1)), "ab"), (np.ones((2, 1)), "aa"), (np.full((2, 1), np.nan), "aa")):
        assert np.isnan(anova(values, list(groups))["repeatability"])
    assert anova(1e9 + np.array([[0.0], [1], [2], [3]]), list("aabb"))["ms_within"] == pytest.approx(0.5)


def replicates(name: str, counts=(3,) * 30, bad: int = 4) -> list[Specimen]:
    """Give specimens with noise of 0.5 px, but 2 px at one landmark, along each axis."""
    rng = np.random.default_rng(5)
    mean = 100 * np.stack([np.cos(np.arange(9) * 0.7), np.sin(np.arange(9) * 0.7)], axis=1)
    noise = np.where(np.arange(9) == bad, 2.0, 0.5)[:, None]
    found = []
    for i, count in enumerate(counts):
        own = mean + rng.normal(0, 3, mean.shape) + 200
        found += [
            Specimen(name.format(i, j) if j else name.format(i, j).split("#")[0], own + noise * rng.normal(size=(9, 2)))
            for j in range(count)
        ]
    return found


def errors_of(specimens: list[Specimen], by: str) -> pd.DataFrame:
    table = measure(specimens, "distance:1-5", 0.1)
    return pd.DataFrame(measurement_error(specimens, table, by)).set_index("measure")


@pytest.mark.parametrize(("name", "by"), [("w{}#{}", "image"), ("w{}_{}", "_"), ("w_{}_{}#2", "_")])
def test_known_noise_is_found(name: str, by: str) -> None:
    found = errors_of(replicates(name), by)
    assert list(found.index) == ["shape", "distance_1_5", "centroid_size", *(f"landmark {i}" for i in range(1, 10))]
    shape = found.loc["shape"]
    assert (shape["df_among"], shape["df_within"]) == (29 * 14, 60 * 14)
    noise = 8 / 9 * 0.25 + 4 / 9
    assert shape["repeatability"] == pytest.approx(9 / (9 + noise), abs=0.03)
    assert found.loc["distance_1_5", "sd"] == pytest.approx(0.1 * np.hypot(0.5, 2), rel=0.15)
    landmarks = found.iloc[3:]
    assert landmarks["sd"].idxmax() == "landmark 5"
    expected = np.hypot(2, 2) if by == "image" else np.hypot(2, 2) * 0.9
    assert landmarks.loc["landmark 5", "sd"] == pytest.approx(expected, rel=0.15)
    assert landmarks.loc["landmark 5", "sd_percent"] == pytest.approx(landmarks.loc["landmark 5", "sd"] / 3, rel=0.02)


def test_shapes_analysed_with_specimens_without_a_replicate_or_a_shape() -> None:
    specimens = replicates("w{}#{}", (1, 2, 4, 3))
    hole = specimens[2].points.copy()
    hole[0] = np.nan
    specimens[2] = Specimen(specimens[2].name, hole)
    found = errors_of([*specimens, Specimen("lost", np.zeros((0, 2)), status="error")], "image")
    assert tuple(found.loc["shape", ["specimens", "replicates"]]) == (4, 9)
    assert tuple(found.loc["landmark 1", ["specimens", "replicates"]]) == (4, 9)
    assert tuple(found.loc["landmark 2", ["specimens", "replicates"]]) == (4, 10)


def test_fits_that_are_not_to_be_used_are_left_out() -> None:
    specimens = replicates("w{}#{}", (2, 2, 2))
    lost = Specimen("w1#3", specimens[0].points + 900, status="diverged")
    expected, found = errors_of(specimens, "image"), errors_of([*specimens, lost], "image")
    pd.testing.assert_frame_equal(found, expected)


@pytest.mark.parametrize("by", ["image", "", "_", "w"])
def test_without_replicates_a_message_says_how_they_are_named(by: str) -> None:
    with pytest.raises(LiaamError, match=r"no specimen has replicates, as all names differ \(w0, w1\): give 'image'"):
        errors_of(replicates("w{}#{}", (1, 1)), by)


def test_two_observers_files_of_the_same_images(run, tmp_path) -> None:
    folder = tmp_path / "both"
    folder.mkdir()
    # .tps holds three decimals.
    specimens = [replace(each, points=each.points.round(3)) for each in replicates("w{}#{}", (2,) * 8)]
    for observer, own in (("anna", specimens[::2]), ("bert", specimens[1::2])):
        marks = {f"w{i}.png": Landmarks(each.points) for i, each in enumerate(own)}
        write_collection(folder / f"{observer}.tps", marks, dict.fromkeys(marks, (400, 400)))
    assert [each.name for each in read_specimens(folder, replicates=True)][:3] == ["w0", "w0#bert", "w1"]
    table = tmp_path / "t.csv"
    code, out, err = run("measure", folder, "distance:1-5", "-o", table, "--replicates", "image")
    assert (code, err) == (0, "")
    found = pd.read_csv(tmp_path / "t_replicates.csv", index_col="measure")
    assert len(pd.read_csv(table)) == 16
    assert found.loc["shape", "specimens"] == 8
    expected = errors_of(specimens, "image")
    units = found.pop("unit").fillna("").tolist()
    assert units == expected.pop("unit").tolist() == ["centroid size", "", "", *["px"] * (len(found) - 3)]
    np.testing.assert_allclose(found.loc["shape"].astype(float), expected.loc["shape"].astype(float), rtol=1e-6)
    assert "repeatability" in out
    assert "least repeatable, in % of centroid size: landmark 5 (sd" in out


def test_a_table_with_a_column_for_the_observer(run, tmp_path) -> None:
    specimens = replicates("w{}#{}", (2,) * 5)
    rows = [
        (f"w{i // 2}.png", "anna" if i % 2 == 0 else "bert", number, *point)
        for i, each in enumerate(specimens)
        for number, point in enumerate(each.points, 1)
    ]
    pd.DataFrame(rows, columns=["image", "observer", "landmark", "x", "y"]).to_csv(tmp_path / "a.csv", index=False)
    code, out, err = run("measure", tmp_path / "a.csv", "-o", tmp_path / "t.csv", "--replicates", "image")
    assert (code, err) == (0, "")
    assert "landmark 5" in out
    found = pd.read_csv(tmp_path / "t_replicates.csv", index_col="measure")
    assert (found.loc["shape", "specimens"], found.loc["shape", "replicates"]) == (5, 10)


def test_nothing_is_written_if_there_are_no_replicates(run, tmp_path) -> None:
    write_columns(tmp_path / "x.csv", measure(replicates("w{}#{}", (1, 1))))
    marks = {f"{i}.png": Landmarks(each.points) for i, each in enumerate(replicates("w{}#{}", (1, 1)))}
    write_collection(tmp_path / "a.csv", marks)
    code, _, err = run("measure", tmp_path / "a.csv", "-o", tmp_path / "t.csv", "--replicates", "_")
    assert code == 1 and "no specimen has replicates" in err
    assert not (tmp_path / "t.csv").exists() and not (tmp_path / "t_replicates.csv").exists()


def test_names_that_make_all_records_one_specimen_are_reported(run, tmp_path) -> None:
    marks = {f"IMG_{i}.png": Landmarks(each.points) for i, each in enumerate(replicates("w{}#{}", (1, 1, 1)))}
    write_collection(tmp_path / "a.csv", marks)
    code, out, err = run("measure", tmp_path / "a.csv", "-o", tmp_path / "t.csv", "--replicates", "_")
    assert code == 0 and "takes all records for replicates of one specimen" in err
    assert "nan" not in out and "inf" not in out
    found = pd.read_csv(tmp_path / "t_replicates.csv", index_col="measure")
    assert np.isnan(found.loc["shape", "F"]) and found.loc["shape", "sd"] > 0


def test_estimated_landmarks_are_no_observations() -> None:
    rng = np.random.default_rng(4)
    square = np.array([[0.0, 0], [40, 0], [40, 30], [0, 30]])
    specimens = []
    for i in range(8):
        shape = square + rng.normal(0, 2, square.shape)
        for record in (1, 2):
            specimens.append(Specimen(f"w{i}_{record}", shape + rng.normal(0, 0.2, square.shape)))
    whole = specimens[:14]
    away = np.array([[9.0, 9], [0, 0], [0, 0], [0, 0]])
    guessed = [Specimen(each.name, each.points + away, estimated=(0,)) for each in specimens[14:]]
    found = measurement_error([*whole, *guessed], measure([*whole, *guessed], ["distance:1-3"]), "_")
    at = found["measure"].index("landmark 1")
    assert (found["specimens"][at], found["replicates"][at]) == (7, 14)
    assert found["sd"][at] < 0.4
    at = found["measure"].index("distance_1_3")
    assert found["replicates"][at] == 14


def test_pixels_are_not_compared_with_units() -> None:
    found = [each for i in range(4) for each in replicates(f"s{i}_{{1}}", (3,))]
    scaled = [replace(each, scale=0.01) for each in found]
    measures = ["distance:1-2", "angle:1-2-3"]
    error = measurement_error([*found[:3], *scaled[3:]], measure([*found[:3], *scaled[3:]], measures), "_")
    right = measurement_error(scaled[3:], measure(scaled[3:], measures), "_")
    counts = dict(zip(error["measure"], error["specimens"], strict=True))
    assert (counts["centroid_size"], counts["distance_1_2"]) == (3, 3)
    assert (counts["shape"], counts["angle_1_2_3"]) == (4, 4)
    of_distance = error["measure"].index("distance_1_2")
    assert error["sd"][of_distance] == pytest.approx(right["sd"][of_distance])


def test_a_flipped_image_is_no_replicate_of_the_other_side() -> None:
    points = np.random.default_rng(3).normal(0, 50, (5, 2))
    sides = [("w1_left", "left"), ("w1_right", "right"), ("w2_left", "right"), ("w2_right", "right")]
    specimens = [Specimen(name, points + i, side=side) for i, (name, side) in enumerate(sides)]
    one_side, _ = of_one_side(specimens, by="_")
    with pytest.raises(LiaamError, match="no specimen has replicates"):
        measurement_error(one_side, measure(one_side), "_")
    numbered = [replace(each, name=f"{each.name}_{i}") for each in specimens for i in (1, 2)]
    one_side, _ = of_one_side(numbered, by="_")
    error = measurement_error(one_side, measure(one_side), "_")
    assert (error["specimens"][0], error["replicates"][0]) == (4, 8)


@pytest.mark.parametrize("own", [0.0, 1.5])
def test_replicates_that_repeat_errors_which_covariances_state_are_known(rng, own):
    """Two records of each specimen have one error in common; ``own`` is what each has besides."""
    base = np.array([[0.0, 0], [60, 5], [120, 20], [90, 70], [30, 60]])
    spread = np.tile((1.5**2) * np.eye(2), (5, 1, 1))
    specimens = []
    for i in range(30):
        common = base + rng.normal(0, 4, base.shape) + rng.normal(0, 0.0 if own else 1.5, base.shape)
        for number in (1, 2):
            points = common + rng.normal(0, own or 0.2, base.shape)
            specimens.append(Specimen(f"w{i}_{number}", points, spread, status="converged"))
    error = measurement_error(specimens, measure(specimens, ["distance:1-3"]), "_")
    assert replicates_repeat_errors(error) == (own == 0)
    by_name = dict(zip(error["measure"], zip(error["sd"], error["sd_by_covariances"], strict=True), strict=True))
    assert by_name["distance_1_3"][1] == pytest.approx(1.5 * 2**0.5, rel=0.05)
    for sd, by_covariances in by_name.values():
        assert sd == pytest.approx(by_covariances, rel=0.5) if own else sd < 0.3 * by_covariances
    bare = [replace(each, covariances=None) for each in specimens]
    without = measurement_error(bare, measure(bare), "_")
    assert "sd_by_covariances" not in without and not replicates_repeat_errors(without)


def test_records_of_one_individual_and_side_may_be_the_replicates(rng):
    wing = np.array([[0.0, 0], [9, 2], [20, 3], [24, 8], [15, 11], [3, 5]])
    specimens = [
        Specimen(f"IMG_{4 * i + j}", wing * 10 + rng.normal(0, 1, wing.shape), individual=f"F{i}", side=side)
        for i in range(5)
        for j, side in enumerate(("left", "left", "right", "right"))
    ]
    sided, _ = of_one_side(specimens, "reflected", by="individual")
    assert [each.individual for each in sided[:5]] == ["F0"] * 4 + ["F1"]
    error = measurement_error(sided, measure(sided), "individual")
    assert (error["specimens"][0], error["replicates"][0]) == (10, 20)
