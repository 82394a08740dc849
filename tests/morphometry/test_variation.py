"""Variance of shape: that of specimens and that of measuring come apart, and so do groups."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import t as student

from liaam.errors import LiaamError
from liaam.morphometry import Specimen, groups_of, measure, p_of_means, read_groups, shape_variation

MEAN = 100 * np.array([[-2.0, -1], [0, -1.4], [2, -1], [2.2, 1], [0, 1.5], [-2.1, 1.2], [0.3, 0.2]])


def fitted(rng: np.random.Generator, truth: np.ndarray, sd: float) -> list[Specimen]:
    """Specimens with errors of a known size, and with their covariances."""
    spread = np.tile(sd**2 * np.eye(2), (len(MEAN), 1, 1))
    return [Specimen(f"w{i}", points + rng.normal(0, sd, points.shape), spread) for i, points in enumerate(truth)]


def truth_of(rng: np.random.Generator, m: int) -> np.ndarray:
    mode = rng.normal(size=MEAN.shape)
    return MEAN + 3 * rng.normal(size=(m, 1, 1)) * mode


def test_the_variance_of_measuring_is_that_of_the_errors(rng):
    truth = truth_of(rng, 300)
    exact = fitted(rng, truth, 1e-6)
    noisy = fitted(rng, truth, 2.0)
    without = shape_variation(exact, measure(exact))
    found = shape_variation(noisy, measure(noisy))
    assert found.measuring == pytest.approx(found.total - without.total, rel=0.15)
    assert found.reliability == pytest.approx(without.total / found.total, abs=0.03)
    assert 0.9 < found.reliabilities[0] < 1.0
    assert not found.reliabilities[-1] > 0.3  # beyond the first, all is noise
    assert without.reliability == pytest.approx(1.0)


def test_standard_errors_of_scores_hold_the_true_ones(rng):
    truth = truth_of(rng, 60)
    exact = fitted(rng, truth, 1e-6)
    noisy = fitted(rng, truth, 2.0)
    errors = shape_variation(noisy, measure(noisy)).scores[:, 0] - shape_variation(exact, measure(exact)).scores[:, 0]
    se = shape_variation(noisy, measure(noisy)).scores_se[:, 0]
    assert np.std(errors / se) == pytest.approx(1.0, abs=0.25)  # 60 draws: a standard error of 0.09


def test_groups_have_means_with_standard_errors_and_a_test(rng):
    truth = truth_of(rng, 40)
    truth[20:, 6] += [8.0, 0.0]
    specimens = fitted(rng, truth, 1.0)
    groups = ["a"] * 20 + ["b"] * 19 + [""]
    found = shape_variation(specimens, measure(specimens), groups, permutations=199)
    (test,) = found.tests
    assert test["groups"] == "a – b" and test["specimens"] == 39
    assert test["P"] == pytest.approx(1 / 200)
    apart = found.means["b"] - found.means["a"]
    assert np.linalg.norm(apart) == pytest.approx(float(test["distance"]))
    assert np.linalg.norm(apart, axis=1).argmax() == 6
    assert 0 < float(test["R2"]) < 1
    assert (found.means_se_by_measuring["a"] < found.means_se["a"] * 1.5).all()
    size = float(np.linalg.norm(MEAN - MEAN.mean(axis=0)))
    assert found.means_se_by_measuring["a"].max() == pytest.approx(1.0 / size / np.sqrt(20), rel=0.3)
    by_group = found.by_group()
    assert by_group["group"] == ["a"] * 7 + ["b"] * 7 and by_group["specimens"][0] == 20
    assert json.loads(found.to_json())["tests"][0]["P"] == test["P"]
    assert "a – b: means" in found.report()


def records_of(rng, individuals: np.ndarray, n: int, sd: float) -> list[Specimen]:
    """Give n records of each individual's shape, whose names tell the individual and the record."""
    return [
        Specimen(f"fly{i}#{j}", points + rng.normal(0.0, sd, points.shape), individual=f"fly{i}")
        for i, points in enumerate(individuals)
        for j in range(n)
    ]


def test_means_of_measures_are_compared_by_individuals(rng):
    values = np.r_[rng.normal(10, 1, 20), rng.normal(11.5, 3, 12), np.nan]
    groups = ["a"] * 20 + ["b"] * 13
    names = [f"{i}" for i in range(33)]
    a, b = values[:20], values[20:32]
    t = (a.mean() - b.mean()) / np.hypot(a.std(ddof=1) / 20**0.5, b.std(ddof=1) / 12**0.5)
    parts = np.array([a.var(ddof=1) / 20, b.var(ddof=1) / 12])
    freedom = parts.sum() ** 2 / (parts[0] ** 2 / 19 + parts[1] ** 2 / 11)  # Welch & Satterthwaite
    expected = 2 * student.sf(abs(t), freedom)
    assert p_of_means(values, groups, names) == pytest.approx(expected, rel=1e-6)
    doubled = p_of_means(np.tile(values, 2), groups * 2, names * 2)  # each specimen twice, which tells nothing new
    assert doubled == pytest.approx(expected, rel=1e-6)
    assert p_of_means(np.tile(values, 2), groups * 2, [f"{i}" for i in range(66)]) < expected
    three = np.r_[values[:32], rng.normal(20, 1, 5)]
    assert p_of_means(three, groups[:32] + ["c"] * 5, [f"{i}" for i in range(37)]) < 1e-6
    assert np.isnan(p_of_means(values[:21], groups[:21], names[:21]))  # one individual in b
    assert np.isnan(p_of_means(np.ones(4), ["a", "a", "b", "b"], names[:4]))  # that do not vary


def test_groups_are_compared_by_individuals_of_which_there_are_several_records(rng):
    individuals = truth_of(rng, 12)
    specimens = records_of(rng, individuals, 4, 0.01)
    groups = [group for group in "ab" * 6 for _ in range(4)]
    found = shape_variation(specimens, measure(specimens), groups, permutations=199)
    (test,) = found.tests
    assert (test["specimens"], test["individuals"]) == (48, 12)
    assert "of 12 individuals" in found.report() and "by the means of individuals" in found.report()
    assert found.by_group()["individuals"][0] == 6 and found.by_specimen()["individual"][:5] == ["fly0"] * 4 + ["fly1"]
    assert json.loads(found.to_json())["individuals"] == 12
    # The records of an individual are alike, so that one of each says the same.
    alone = specimens[::4]
    of_one = shape_variation(alone, measure(alone), groups[::4], permutations=199)
    assert float(test["P"]) == pytest.approx(float(of_one.tests[0]["P"]), abs=0.03)
    assert found.means_se["a"].max() == pytest.approx(of_one.means_se["a"].max(), rel=0.05)
    independent = [Specimen(each.name, each.points) for each in specimens]
    as_specimens = shape_variation(independent, measure(independent), groups, permutations=199)
    assert as_specimens.individuals == () and float(as_specimens.tests[0]["P"]) < float(test["P"])


def test_groups_within_individuals_are_exchanged_within_them(rng):
    individuals = truth_of(rng, 8)
    moved = individuals.copy()
    moved[:, 6] += [0.8, 0.0]  # far less than individuals differ by
    specimens = [
        Specimen(f"fly{i}{side}", points + rng.normal(0.0, 0.1, points.shape), individual=f"fly{i}")
        for side, shapes in (("l", individuals), ("r", moved))
        for i, points in enumerate(shapes)
    ]
    found = shape_variation(specimens, measure(specimens), ["l"] * 8 + ["r"] * 8, permutations=499)
    assert float(found.tests[0]["P"]) <= 0.02 and float(found.tests[0]["R2"]) < 0.1
    assert "8 individuals have records in several groups" in found.report()


def test_few_individuals_in_several_groups_are_refused_by_name(rng):
    specimens = records_of(rng, truth_of(rng, 6), 2, 0.1)
    groups = ["a", "a", "a", "b", *"aabbbbbb"]
    with pytest.raises(LiaamError, match=r"1 of 6 individuals have records in several groups, .* \(fly1\): correct"):
        shape_variation(specimens, measure(specimens), groups)


def test_a_group_of_records_of_one_individual_is_too_small(rng):
    specimens = records_of(rng, truth_of(rng, 3), 3, 0.1)
    with pytest.raises(LiaamError, match="need two groups of 2 individuals or more"):
        shape_variation(specimens, measure(specimens), ["a"] * 3 + ["b"] * 6)


def test_without_a_difference_the_test_finds_none(rng):
    specimens = fitted(rng, truth_of(rng, 40), 1.0)
    groups = ["a", "b", "c", "d"] * 10
    found = shape_variation(specimens, measure(specimens), groups, permutations=99)
    assert len(found.tests) == 7  # all, and six pairs
    assert float(found.tests[0]["P"]) > 0.02
    assert np.isnan(float(found.tests[0]["distance"]))


def test_what_is_unknown_is_said(rng):
    points = truth_of(rng, 6)
    points[2, 1] = np.nan
    specimens = [Specimen(f"w{i}", each) for i, each in enumerate(points)]
    found = shape_variation(specimens, measure(specimens))
    assert (len(found.names), found.n_left_out) == (5, 1)
    assert np.isnan(found.measuring) and np.isnan(found.reliability)
    assert "that of measuring is unknown" in found.report() and "1 without a shape left out" in found.report()
    assert "PC1_se" not in found.by_specimen()
    assert json.loads(found.to_json())["reliability"] is None
    with pytest.raises(
        LiaamError, match="2 specimens with a shape: the variance of shape is split from 3 specimens on"
    ):
        shape_variation(specimens[:3], measure(specimens[:3]))
    with pytest.raises(LiaamError, match="-1 permutations: give 0 to 100000"):
        shape_variation(specimens, measure(specimens), permutations=-1)
    (untested,) = shape_variation(specimens, measure(specimens), ["a", "b"] * 3, permutations=0).tests
    assert np.isnan(float(untested["P"]))
    with pytest.raises(LiaamError, match=r"two groups of 2 specimens or more that can be compared: there are a \(5\)"):
        shape_variation(specimens, measure(specimens), ["a"] * 6)


def test_specimens_of_one_shape_have_no_variance():
    specimens = [Specimen(f"w{i}", MEAN + i) for i in range(4)]
    found = shape_variation(specimens, measure(specimens), ["a", "a", "b", "b"], permutations=9)
    assert found.total < 1e-20
    assert float(found.tests[0]["P"]) > 0.05


def test_groups_are_read_and_found_by_name(tmp_path: Path):
    table = tmp_path / "groups.csv"
    table.write_text("specimen,group\nwings/a.jpg,male\nb,female\n", encoding="utf-8")
    groups = read_groups(table)
    assert groups_of(["a", "b#2", "c"], groups) == ("male", "female", "")
    with pytest.raises(LiaamError, match="no specimen is in the table of groups, which has names such as wings/a"):
        groups_of(["x"], groups)
    table.write_text("image,group\na.jpg,male\n", encoding="utf-8")
    assert read_groups(table) == {"a.jpg": "male"}
    table.write_text("\ufeffimage;group\na.jpg;male\n;\n", encoding="utf-8")  # as Excel saves it
    assert read_groups(table) == {"a.jpg": "male"}
    table.write_text("specimen,group\na,male\na,female\n", encoding="utf-8")
    with pytest.raises(LiaamError, match="line 3 has 'a' again"):
        read_groups(table)
    table.write_text("Photo,Group\na.jpg,male\n", encoding="utf-8")
    assert read_groups(table) == {"a.jpg": "male"}
    table.write_text("Photo,Gruppe\na.jpg,male\n", encoding="utf-8")
    assert read_groups(table) == {"a.jpg": "male"}  # no other column can be meant
    table.write_text("Photo,Gruppe,Alter\na.jpg,male,3\n", encoding="utf-8")
    with pytest.raises(LiaamError, match="has no column group: it has Photo, Gruppe, Alter; call the columns so"):
        read_groups(table)
    table.write_text("Photo\na.jpg\n", encoding="utf-8")
    with pytest.raises(LiaamError, match="has no column group: it has Photo; add it, with one row"):
        read_groups(table)
    table.write_text("name,sex\na,male\n", encoding="utf-8")
    with pytest.raises(LiaamError, match=r"has no columns specimen \(or picture, image\) and group"):
        read_groups(table)


def test_errors_that_exceed_the_variance_split_nothing(rng):
    truth = truth_of(rng, 20)
    spread = np.tile(900.0 * np.eye(2), (len(MEAN), 1, 1))
    specimens = [Specimen(f"w{i}", points, spread) for i, points in enumerate(truth)]
    found = shape_variation(specimens, measure(specimens))
    assert found.measuring > found.total and np.isnan(found.reliability)
    assert "so that it cannot be split: compare with landmarks that people placed" in found.report()
