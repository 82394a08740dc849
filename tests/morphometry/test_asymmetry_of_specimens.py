"""Asymmetry of specimens: from files to the analysis, the error term of fits, and bad input."""

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import pytest

from geomorph_results import MATCHING, OBJECT
from liaam.errors import LiaamError
from liaam.morphometry import (
    AsymmetryResult,
    Specimen,
    alike,
    asymmetry,
    measure,
    of_one_side,
    read_specimens,
    symmetry as analysis_of_symmetry,
)
from liaam.morphometry.symmetry import ERROR, _permuted
from liaam.plotting.specimens import figure_of_asymmetry

MEAN = np.array([[-30.0, 20], [30, 20], [-40, -25], [40, -25], [0, 45], [0, -50]])
NAMES = ("left_eye", "right_eye", "left_jaw", "right_jaw", "top", "chin")


def analysed(specimens, kind: str, side: str = "auto", by: str | None = None, **options) -> AsymmetryResult:
    specimens, _ = of_one_side(alike(specimens)[0], side, by)
    wanted: dict[str, Any] = {"permutations": 0} | options
    return asymmetry(specimens, measure(specimens), kind, by=by, **wanted)


@pytest.mark.parametrize(
    ("name", "right"),
    [
        ("matching", (0.41713167, 0.01495313, 0.02377367, 0.00438361)),
        ("mosquito", (0.104888118, 0.003220856, 0.038990419, 0.083258697)),
        ("object", (0.35298514, 0.02868193, 0.03207358, 0.00524288)),
        ("lizards", (0.236787669, 0.009431742, 0.032119281, 0.006283277)),
    ],
)
def test_files_of_geomorph_have_its_sums_of_squares(geomorph, name, right) -> None:
    specimens = read_specimens(geomorph / f"{name}.csv")
    if name in MATCHING:
        found = analysed(specimens, "matching")  # left ones are reflected, those of the mosquitoes were before
    else:
        found = analysed(specimens, "object", pairs=str(geomorph / f"{name}-pairs.csv"))
    digits = 9 if name in ("mosquito", "lizards") else 8
    assert [round(value, digits) for value in found.analysis.shape_anova["SS"][:4]] == [*right]
    assert found.replicates == 2 and found.left_out == ()
    assert name not in OBJECT or found.sides == ("original", "mirrored")


def faces(rng: np.random.Generator, n: int, names=NAMES, records: int = 1, **facts) -> list[Specimen]:
    return [
        Specimen(
            f"face{i}_{record}" if records > 1 else f"face{i}", own + rng.normal(0, 0.3, (6, 2)), names=names, **facts
        )
        for i in range(n)
        for own in [MEAN + rng.normal(0, 2, (6, 2))]
        for record in range(records)
    ]


def test_names_tell_pairs_and_replicates(rng) -> None:
    found = analysed(faces(rng, 6, records=3), "object", by="_")
    assert found.individuals == tuple(f"face{i}" for i in range(6))
    assert found.twins == (2, 1, 4, 3, 5, 6)
    assert found.replicates == 3
    assert found.analysis.error == "replicates"
    assert found.analysis.shape_anova["df"] == [5, 1, 5, 24, 35]
    same = analysed(faces(rng, 6, names=()), "object", pairs="1-2,3-4")
    assert same.twins == found.twins and same.analysis.error == ""
    assert analysed(faces(rng, 6), "object", pairs=[1, 0, 3, 2, 4, 5]).twins == found.twins


def test_landmarks_of_a_scale_bar_are_no_part_of_the_shape(rng) -> None:
    specimens = [
        Specimen(each.name, np.concatenate([[[0, 0]], each.points, [[9, 0]]]), names=("bar1", *NAMES, "bar2"))
        for each in faces(rng, 5)
    ]
    table = measure(specimens, scale="bar1,bar2=10")
    found = asymmetry(specimens, table, "object", permutations=0)
    assert found.landmarks == (2, 3, 4, 5, 6, 7)
    assert found.twins == (3, 2, 5, 4, 6, 7)
    with pytest.raises(LiaamError, match="the pair 1-8 has an end of the scale bar"):
        asymmetry(specimens, table, "object", pairs="1-8,2-3", permutations=0)


def wings(rng: np.random.Generator, n: int, deviation: float, common: float = 0, **facts) -> list[Specimen]:
    """Give left and right wings that differ by errors of a standard deviation only, and have other errors in common."""
    found = []
    for i in range(n):
        own = MEAN * [1, 0.6] + [0.4, 0.2] * MEAN[::-1] + rng.normal(0, 3, (6, 2)) + rng.normal(0, common, (6, 2))
        for side, sign in (("left", -1), ("right", 1)):
            points = (own + rng.normal(0, deviation, (6, 2))) * [sign, 1] + 500
            found.append(Specimen(f"fly{i}_{side}", points, **facts))
    return found


def test_errors_of_fits_are_the_error_term_without_replicates(rng) -> None:
    covariances = np.tile(np.eye(2), (6, 1, 1))
    found = analysed(wings(rng, 40, 1.0, covariances=covariances), "matching", permutations=99)
    table = found.analysis.shape_anova
    assert found.analysis.error == "covariances"
    # The interaction is error alone: an F with 39 * 8 degrees of freedom.
    assert table["F"][2] == pytest.approx(1, abs=4 * np.sqrt(2 / (39 * 8)))
    assert 0.01 < table["P"][2] <= 1
    assert np.isnan(table["df"][3]) and np.isnan(table["SS"][3]) and table["MS"][3] > 0
    larger = analysed(wings(rng, 40, 2.0, covariances=covariances), "matching", permutations=99)
    assert larger.analysis.shape_anova["F"][2] == pytest.approx(4, rel=0.3)
    assert larger.analysis.shape_anova["P"][2] == pytest.approx(0.01)


def test_errors_that_both_sides_have_in_common_are_reported(rng) -> None:
    covariances = np.tile(np.eye(2), (6, 1, 1))
    alike = analysed(wings(rng, 20, 0.6, 0.8, covariances=covariances), "matching", permutations=99)
    assert alike.analysis.shape_anova["F"][2] == pytest.approx(0.36, rel=0.3)
    assert alike.analysis.shape_anova["P"][2] == 1
    assert alike.error_exceeds_differences and alike.to_dict()["error_exceeds_differences"] is True
    assert alike.drawing()["error_label"].startswith("by the stated error, which is alike on both\nsides or too large")
    independent = analysed(wings(rng, 20, 1.0, covariances=covariances), "matching", permutations=99)
    assert not independent.error_exceeds_differences
    assert independent.drawing()["error_label"] == "by the stated error, if independent on both sides"


def test_replicates_and_too_few_permutations_say_nothing_of_the_stated_error(rng) -> None:
    replicated = analysed(faces(rng, 6, records=2), "object", by="_", permutations=99)
    assert not replicated.error_exceeds_differences
    assert replicated.drawing()["error_label"] == "by error alone"
    fitted = wings(rng, 20, 0.1, covariances=np.tile(np.eye(2), (6, 1, 1)))
    assert not analysed(fitted, "matching", permutations=0).error_exceeds_differences
    assert not analysed(fitted, "matching", permutations=38).error_exceeds_differences
    assert analysed(fitted, "matching", permutations=39).error_exceeds_differences


@pytest.mark.parametrize("kind", ["matching", "object"])
def test_replicates_that_repeat_the_errors_of_fits_have_a_second_error_term(rng, kind, monkeypatch) -> None:
    """Both records of a structure have one error of 0.5 in common, which the covariances state, and 0.05 besides."""
    facts = {"covariances": np.tile(0.5**2 * np.eye(2), (len(NAMES), 1, 1)), "status": "converged"}
    once = wings(rng, 20, 0.5, **facts) if kind == "matching" else faces(rng, 20, **facts)
    if kind == "object":
        once = [replace(each, points=each.points + rng.normal(0, 0.5, each.points.shape)) for each in once]
    specimens = [
        replace(each, name=f"{each.name}_{number}", points=each.points + rng.normal(0, 0.05, each.points.shape))
        for each in once
        for number in (1, 2)
    ]
    random_orders = []

    def permuted(*arguments):
        random_orders.append(arguments)
        return _permuted(*arguments)

    monkeypatch.setattr(analysis_of_symmetry, "_permuted", permuted)
    result = analysed(specimens, kind, by="_", permutations=99)
    assert len(random_orders) == (2 if kind == "matching" else 1)  # of shape and size, with one error term
    other = result.error_by_covariances
    assert result.replicates_repeat_errors and other is not None and result.analysis.error == "replicates"
    anova = result.analysis.shape_anova
    assert other["MS"] > 20 * anova["MS"][ERROR]
    if kind == "matching":  # without asymmetry, what differs is the error
        assert anova["P"][2] < 0.02 < other["P"] and other["F"] == pytest.approx(1.0, abs=0.4)
    rows = result.anova()
    place = rows["effect"].index("error by covariances")
    assert (rows["trait"][place], rows["MS"][place]) == ("shape", other["MS"])
    told = json.loads(result.to_json())
    assert told["replicates_repeat_errors"] and told["error_by_covariances"] == other
    bare = analysed([replace(each, covariances=None) for each in specimens], kind, by="_")
    assert bare.error_by_covariances is None and not bare.replicates_repeat_errors
    assert "error by covariances" not in bare.anova()["effect"]


def test_estimated_landmarks_do_not_count_in_the_error_term(rng) -> None:
    fitted = wings(rng, 10, 0.3, covariances=np.tile(0.09 * np.eye(2), (6, 1, 1)))
    whole = analysed(fitted, "matching").analysis.shape_anova["MS"][ERROR]
    covariances = np.array(fitted[3].covariances)
    covariances[2] = np.nan
    some = [*fitted[:3], replace(fitted[3], covariances=covariances, estimated=(2,)), *fitted[4:]]
    found = analysed(some, "matching", permutations=20)
    assert found.analysis.error == "covariances" and found.n_estimated == 1
    assert found.indices()["estimated"] == ["", "3", *[""] * 8]
    assert found.to_dict()["indices"][1]["estimated"] == "3"
    assert "estimated" not in analysed(fitted, "matching").indices()
    by_fit = [*fitted[:3], replace(fitted[3], estimated=(2,), covariances=100 * np.array(fitted[3].covariances))]
    marked = analysed([*by_fit, *fitted[4:]], "matching").analysis.shape_anova["MS"][ERROR]
    assert marked == pytest.approx(whole, rel=0.05)
    assert found.analysis.shape_anova["MS"][ERROR] == pytest.approx(whole, rel=0.05)
    assert 0 < found.analysis.shape_anova["P"][2] <= 1
    every = [replace(each, covariances=np.full((6, 2, 2), np.nan), estimated=(2,)) for each in fitted]
    assert analysed(every, "matching").analysis.error == ""


def test_the_figure_marks_individuals_with_estimated_landmarks(rng) -> None:
    fitted = faces(rng, 6, covariances=np.tile(0.09 * np.eye(2), (6, 1, 1)))
    given = [*fitted[:2], replace(fitted[2], estimated=(0, 4)), *fitted[3:]]
    found = analysed(given, "object")
    assert found.estimated == ("", "", "left_eye; top", "", "", "")
    axis = figure_of_asymmetry(**found.drawing()).axes[2]
    marked = next(line for line in axis.lines if line.get_label() == "with estimated landmarks")
    np.testing.assert_allclose(marked.get_ydata(), found.analysis.fluctuating_distances[2])
    assert sum(len(line.get_xdata()) for line in axis.lines if line.get_marker() == "o") == 5
    assert "with estimated landmarks" in [text.get_text() for text in axis.get_legend().get_texts()]
    plain = figure_of_asymmetry(**analysed(fitted, "object").drawing()).axes[2]
    assert len(plain.get_legend().get_texts()) == 1


def test_replicates_with_estimated_landmarks_are_no_error(rng) -> None:
    records = faces(rng, 8, records=2)
    names = [each.name for each in records]
    before = analysed(records, "object", by="_")
    same = records[names.index("face0_0")]
    again = [replace(same, name="face0_1", estimated=(1,)) if each.name == "face0_1" else each for each in records]
    found = analysed(again, "object", by="_", permutations=20)
    ninth = analysed([each for each in again if not each.name.startswith("face0_")], "object", by="_")
    assert found.analysis.shape_anova["df"][ERROR] == before.analysis.shape_anova["df"][ERROR] - 2
    assert found.analysis.shape_anova["df"][ERROR] == ninth.analysis.shape_anova["df"][ERROR]
    ratio = found.analysis.shape_anova["MS"][ERROR] / ninth.analysis.shape_anova["MS"][ERROR]
    assert ratio == pytest.approx(1.0, rel=0.02)  # as without this individual, but for the mean shape
    assert found.n_estimated == 1 and found.to_dict()["without_estimated"] == 1


def test_sizes_have_the_unit_of_the_table(rng) -> None:
    specimens, _ = of_one_side(wings(rng, 5, 1.0))
    found = [
        asymmetry(specimens, measure(specimens, scale=scale), "matching", permutations=0) for scale in (None, 0.01)
    ]
    pixels, millimetres = (each.analysis.size_anova["SS"][0] for each in found)
    assert millimetres == pytest.approx(1e-4 * pixels)
    np.testing.assert_allclose(found[0].analysis.size_ratios, found[1].analysis.size_ratios)


def test_left_and_right_structures_are_no_replicates_of_an_object(rng) -> None:
    found = analysed(wings(rng, 3, 1.0), "object", pairs="1-2,3-4")
    assert found.individuals[:2] == ("fly0 left", "fly0 right") and len(found.individuals) == 6
    assert (found.replicates, found.analysis.error) == (1, "")


@pytest.mark.parametrize("unit", ["mm", ""])
def test_individuals_without_a_scale_are_left_out_of_the_analysis_of_sizes(rng, unit) -> None:
    specimens, _ = of_one_side(wings(rng, 5, 1.0, scale=0.01, unit=unit))
    bare = [replace(each, scale=None, unit="") if each.name == "fly2_left" else each for each in specimens]
    found = asymmetry(bare, measure(bare), "matching", permutations=9)
    assert found.individuals == ("fly0", "fly1", "fly2", "fly3", "fly4")
    others = [each for each in specimens if not each.name.startswith("fly2")]
    expected = asymmetry(others, measure(others), "matching", permutations=9)
    for name in ("df", "SS", "F", "P"):
        np.testing.assert_allclose(found.analysis.size_anova[name], expected.analysis.size_anova[name])
    assert np.flatnonzero(np.isnan(found.analysis.size_ratios)).tolist() == [2]
    assert json.loads(found.to_json())["indices"][2]["log_size_ratio"] is None


def test_without_sizes_to_compare_there_is_an_analysis_of_shape_alone(rng) -> None:
    specimens, _ = of_one_side(wings(rng, 3, 1.0, scale=0.01, unit="mm"))
    bare = [replace(each, scale=None) if each.side == "left" else each for each in specimens]
    found = asymmetry(bare, measure(bare), "matching", permutations=9)
    assert found.analysis.size_anova == {} and set(found.anova()["trait"]) == {"shape"}


def test_tables_and_json_hold_everything(rng) -> None:
    found = analysed(wings(rng, 4, 1.0), "matching", permutations=19, seed=3)
    anova = pd.DataFrame(found.anova())
    assert anova["trait"].tolist() == ["shape"] * 5 + ["centroid_size"] * 5
    indices = pd.DataFrame(found.indices())
    assert indices["individual"].tolist() == ["fly0", "fly1", "fly2", "fly3"]
    components = pd.DataFrame(found.components())
    assert components["component"].value_counts().to_dict() == {
        "mean": 1, "directional": 2, "symmetric": 4, "asymmetric": 4, "fluctuating": 4
    }  # fmt: skip
    facts = json.loads(json.dumps(found.to_dict(), allow_nan=False))
    assert (facts["symmetry"], facts["seed"], facts["permutations"], facts["error_term"]) == ("matching", 3, 19, None)
    assert facts["anova"][2]["F"] is None and facts["anova"][0]["F"] > 0
    assert len(facts["components"]) == 15


def test_individuals_without_a_side_or_a_replicate_are_left_out_by_name(rng) -> None:
    given = wings(rng, 6, 1.0)
    hole = given[2].points.copy()
    hole[0] = np.nan
    given[2] = Specimen(given[2].name, hole)
    found = analysed([*given[:-1], Specimen("fly5_left#2", given[-2].points + 1)], "matching", by="image")
    assert found.individuals == ("fly0", "fly2", "fly3", "fly4")
    assert found.left_out == (
        "fly1: it has 0 left and 1 right records with a shape, where most have 1 of each side; it is left out",
        "fly5: it has 2 left and 0 right records with a shape, where most have 1 of each side; it is left out",
    )
    sided, _ = of_one_side(wings(rng, 3, 1.0))
    sided = [*sided, replace(sided[0], name="stray", individual="stray", side="")]
    assert (
        asymmetry(sided, measure(sided), "matching", permutations=0).left_out[0].startswith("stray: it has 0 left and")
    )
    uneven = faces(rng, 4, records=2)
    found = analysed(uneven[:-1], "object", by="_")
    assert found.individuals == ("face0", "face1", "face2")
    assert found.left_out == ("face3: it has 1 records with a shape, where most have 2; it is left out",)


@pytest.mark.parametrize(
    ("kind", "options", "words"),
    [
        ("both", {}, "symmetry 'both' is unknown: give object or matching"),
        ("object", {"permutations": -1}, "-1 permutations: give 0 to 100000"),
        (
            "matching",
            {},
            "(face0, face1, face2 and 2 more) have no sides: name them such as wing1_left and wing1_right",
        ),
        ("object", {"pairs": [0, 0, 0, 0, 0, 0]}, "do not pair 6 landmarks"),
        ("object", {"pairs": "1-1"}, "the pair 1-1 names the same landmark twice"),
    ],
)
def test_bad_input_is_named(rng, kind, options, words) -> None:
    with pytest.raises(LiaamError) as fault:
        analysed(faces(rng, 5), kind, **options)
    assert words in str(fault.value)


def test_individuals_whose_side_the_shape_contradicts_are_left_out_by_name(rng) -> None:
    given = wings(rng, 6, 1.0)
    flipped = replace(given[4], points=given[4].points * [-1, 1])
    found = analysed([*given[:4], flipped, *given[5:]], "matching", permutations=99)
    assert found.left_out == ("fly2: fly2_left is stated left, and is right by its landmarks; it is left out",)
    others = analysed([*given[:4], *given[6:]], "matching", permutations=99)
    assert found.individuals == others.individuals
    np.testing.assert_allclose(found.analysis.distances, others.analysis.distances, rtol=0.05)
    exchanged = [replace(flipped, name="fly2_left"), replace(given[5], points=given[5].points * [-1, 1])]
    found = analysed([*given[:4], *exchanged, *given[6:]], "matching", permutations=99)
    assert len(found.left_out) == 1 and found.individuals == others.individuals


def test_the_side_of_a_fit_is_taken_and_explains_why_an_individual_is_left_out(rng) -> None:
    given = [replace(each, side=each.name.partition("_")[2], status="converged") for each in wings(rng, 6, 1.0)]
    flipped = replace(given[4], points=given[4].points * [-1, 1], side="right")
    found = analysed([*given[:4], flipped, *given[5:]], "matching", permutations=0)
    assert found.left_out == (
        "fly2: it has 0 left and 2 right records with a shape, where most have 1 of each side (fly2_left is stated "
        "left, and is right by its landmarks); it is left out",
    )
    exchanged = [replace(given[4], name="fly2_right"), replace(given[5], name="fly2_left")]
    found = analysed([*given[:4], *exchanged, *given[6:]], "matching", permutations=0)
    assert found.left_out == () and len(found.individuals) == 6


def test_one_specimen_and_one_side_are_too_few(rng) -> None:
    with pytest.raises(LiaamError, match="1 of 1 individuals can be compared, and 2 are needed: digitise more of them"):
        analysed(faces(rng, 1), "object")
    with pytest.raises(LiaamError, match="have only the side left"):
        analysed(wings(rng, 3, 1.0)[::2], "matching")
    with pytest.raises(
        LiaamError, match="1 of 3 individuals can be compared, and 2 are needed: fly1: it has 1 left and 0"
    ):
        analysed(wings(rng, 3, 1.0)[:2] + wings(rng, 3, 1.0)[2::2], "matching")
    alone = [replace(each, individual=each.name) for each in wings(rng, 3, 1.0)]  # as IMG_1 and IMG_2
    with pytest.raises(LiaamError, match=r"0 of 6 individuals .* name their images alike .* a column 'individual'"):
        analysed(alone, "matching")
    given = wings(rng, 3, 1.0)
    unreflected = [replace(each, side=each.name.partition("_")[2]) for each in given]
    with (
        pytest.warns(UserWarning),
        pytest.raises(LiaamError, match="sides left, right are not reflected to each other"),
    ):
        asymmetry(unreflected, measure(unreflected), "matching")
    empty = [Specimen(f"a{i}", np.full((6, 2), np.nan), names=NAMES) for i in range(3)]
    with pytest.raises(LiaamError, match="no specimen has a shape whose asymmetry can be measured"):
        analysed(empty, "object")
