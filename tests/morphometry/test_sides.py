"""Sides of specimens from columns, folders and names, and the reflection of one side."""

import re
import warnings
from dataclasses import replace

import numpy as np
import pytest

from liaam.errors import LiaamError
from liaam.io.sides import folder_side
from liaam.morphometry import Specimen, measure, of_one_side, read_specimens
from liaam.morphometry.sides import structure_name

POINTS = np.array([[0.0, 0], [10, 1], [12, 9], [3, 14]])


def specimens(*names: str, **facts) -> list[Specimen]:
    """Give specimens of one shape, of which those whose names tell the left side are mirrored."""
    sign = [-1 if re.search(r"left|L(_\d)?$|^l$", name, re.IGNORECASE) else 1 for name in names]
    return [Specimen(name, POINTS * [sign[i], 1] + i, **facts) for i, name in enumerate(names)]


@pytest.mark.parametrize(
    ("left", "right", "individual"),
    [
        ("wing1_left", "wing1_right", "wing1"),
        ("left/wing1", "right/wing1", "wing1"),
        ("LeftWing1", "RightWing1", "Wing1"),
        ("wing1-L", "wing1-R", "wing1"),
        ("wing1L", "wing1R", "wing1"),
        ("w_LEFT_1", "w_RIGHT_1", "w_1"),
    ],
)
def test_sides_are_found_in_names(left, right, individual) -> None:
    found, said = of_one_side(specimens(left, right, right.replace("1", "2"), left.replace("1", "2")))
    assert [each.side for each in found] == ["left", "right", "right", "left"]
    assert [each.individual for each in found] == [individual.replace("1", number) for number in "1122"]
    assert said == "2 left specimens were reflected, to be compared with the right ones"
    assert [each.points[1, 0] for each in found] == [10, 11, 12, 7]


@pytest.mark.parametrize(
    ("names", "by", "individuals"),
    [
        (("w1_left_1", "w1_left_2", "w1_right_1", "w1_right_2"), "_", ["w1"] * 4),
        (("w1_1_left", "w1_2_left", "w1_1_right", "w1_2_right"), "_", ["w1"] * 4),
        (("w1_L_1", "w1_L_2", "w1_R_1", "w1_R_2"), "_", ["w1"] * 4),
        (("w1_left", "w1_left#2", "w1_right", "w1_right#2"), "image", ["w1"] * 4),
    ],
)
def test_numbers_of_replicates_are_no_part_of_the_individual(names, by, individuals) -> None:
    found, _ = of_one_side(specimens(*names), by=by)
    assert [each.individual for each in found] == individuals
    assert [each.side for each in found] == ["left", "left", "right", "right"]


@pytest.mark.parametrize(
    "names",
    [
        ("a", "b"),
        ("site_L", "site_R", "site_M"),  # one that is neither
        ("bright_1", "copyright_2"),
        ("wing_l", "wing2_l"),  # no other side
        ("r", "l"),
        ("left_and_right_1", "left_and_right_2"),
    ],
)
def test_names_that_tell_no_sides_change_nothing(names) -> None:
    given = [Specimen(name, POINTS + i) for i, name in enumerate(names)]
    found, said = of_one_side(given)
    assert said == ""
    assert [each.points.tolist() for each in found] == [each.points.tolist() for each in given]
    assert not any(each.side for each in found)


WING = np.array([[0.0, 0], [9, 2], [20, 3], [24, 8], [15, 11], [3, 5]])
"""A shape that does not look the same in a mirror."""


def test_mirrored_shapes_without_a_stated_side_are_reflected_and_named() -> None:
    right = [Specimen(name, WING + i) for i, name in enumerate("abc")]
    mirrored = [replace(each, name=f"m{i}", points=each.points * [-1, 1]) for i, each in enumerate(right[:2])]
    found, said = of_one_side([*right, *mirrored])
    assert said.startswith(
        "2 of 5 specimens are mirrored by their shapes, and were reflected, to be compared with the others: m0, m1; "
        "state the sides"
    )
    assert "--side ignore" in said
    assert [each.side for each in found] == ["original"] * 3 + ["mirrored"] * 2
    assert [each.points.tolist() for each in found[3:]] == [each.points.tolist() for each in right[:2]]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        columns = measure(found)
    np.testing.assert_allclose(columns["X1"], columns["X1"][0])
    found, said = of_one_side([*right, *mirrored], "ignore")
    assert said == "" and [each.points.tolist() for each in found[3:]] == [each.points.tolist() for each in mirrored]


def test_records_with_y_from_the_other_border_are_reflected_and_have_no_side() -> None:
    upright = [Specimen(name, WING + i) for i, name in enumerate("abc")]
    turned = [replace(each, name=f"u{i}", points=each.points * [1, -1]) for i, each in enumerate(upright[:2])]
    found, said = of_one_side([*upright, *turned])
    assert "u0, u1; y of these seems to count from the other border" in said
    assert not any(each.side for each in found)
    columns = measure(found)
    np.testing.assert_allclose(columns["X1"], columns["X1"][0])


def test_one_side_alone_stays_as_it_is() -> None:
    found, said = of_one_side(specimens("a_left", "b_left", "c"))
    assert said == "" and [each.points[1, 0] for each in found] == [-10, -9, 12]


def test_specimens_without_a_side_among_both_are_refused_by_name() -> None:
    with pytest.raises(
        LiaamError, match=r"1 of 3 specimens have no side \(c\), and others are left and right"
    ) as fault:
        of_one_side(specimens("a_left", "a_right", "c"))
    assert "--side ignore" in str(fault.value)
    found, said = of_one_side(specimens("a_left", "a_right", "c"), "ignore")
    assert said == "" and not any(each.side for each in found)


def test_the_side_that_others_are_reflected_to_can_be_chosen() -> None:
    found, said = of_one_side(specimens("a_left", "a_right"), "left")
    assert [each.points[1, 0] for each in found] == [-10, -11]
    assert said.startswith("1 right specimen was reflected")
    found, said = of_one_side(specimens("a_left", "a_right"), "reflected")
    assert [each.points[1, 0] for each in found] == [-10, 11]
    assert said == "" and [each.side for each in found] == ["left", "right"]
    with pytest.raises(LiaamError, match="--side right: no specimen has a known side; give auto"):
        of_one_side(specimens("a", "b"), "right")
    with pytest.raises(LiaamError, match="--side up: the specimens are of the sides left, right"):
        of_one_side(specimens("a_left", "a_right"), "up")


def test_sides_of_a_column_may_have_other_names_but_are_two() -> None:
    given = [replace(specimens(name)[0], name="a", side=side) for name, side in (("l", "1"), ("r", "2"))]
    found, said = of_one_side(given)
    assert said == "1 specimen of the side '1' was reflected, to be compared with '2'"
    assert [each.individual for each in found] == ["a", "a"]
    more = [replace(each, file="t.csv") for each in (*given, *given, *specimens("b", side="3"))]
    with pytest.raises(LiaamError, match=r"t\.csv: .*more than two sides\. The side of b \('3'\) is neither 1 nor 2:"):
        of_one_side(more)
    odd = [*specimens("l", side="left"), *specimens("r", side="right"), *specimens("w", side="lefft")]
    with pytest.raises(LiaamError, match=r"The side of w \('lefft'\) is neither left nor right: correct the column"):
        of_one_side(odd)


def test_reflection_turns_covariances_and_keeps_measures() -> None:
    covariances = np.tile([[2.0, 0.7], [0.7, 1.0]], (4, 1, 1))
    given = specimens("a_left", "a_right", covariances=covariances)
    found, _ = of_one_side(given)
    assert found[0].covariances is not None
    np.testing.assert_allclose(found[0].covariances[1], [[2, -0.7], [-0.7, 1]])
    np.testing.assert_array_equal(found[1].covariances, covariances)
    names = ["distance:1-3", "angle:1-2-3", "area:1-2-3-4"]
    before = measure([replace(each, side="") for each in given], names)
    after = measure(found, names)
    assert after["side"] == ["left", "right"] and "side" not in before
    for column in before:
        if column.startswith(("distance", "angle", "area", "centroid")):
            np.testing.assert_allclose(after[column], before[column], rtol=1e-12, err_msg=column)


@pytest.mark.parametrize(
    ("path", "side"),
    [
        ("left/a.jpg", "left"),
        ("wings\\R\\a.jpg", "right"),
        ("left/right/a.jpg", ""),
        ("left.jpg", ""),
        ("lefties/a.jpg", ""),
        ("", ""),
    ],
)
def test_folders_tell_the_side(path, side) -> None:
    assert folder_side(path) == side


def test_sides_that_are_alike_as_they_are_stay_and_this_is_said() -> None:
    mirrored, right = specimens("l", "r")
    given = [replace(right, name="a_left"), replace(right, name="a_right")]
    found, said = of_one_side(given)
    assert [each.points.tolist() for each in found] == [right.points.tolist()] * 2
    assert said.startswith(
        "specimens of the sides left, right are compared as they are, since they are more alike than"
    )
    assert [each.side for each in found] == ["left", "right"] and [each.reflected for each in found] == [True, False]
    found, said = of_one_side(given, "right")
    assert said.startswith("1 left specimen was reflected") and found[0].points[1, 0] == -right.points[1, 0]
    gaps = [
        Specimen("a_left", np.full((4, 2), np.nan)),
        replace(right, name="a_right"),
        replace(mirrored, name="b_left"),
    ]
    assert of_one_side(gaps)[1].startswith("2 left specimens were reflected")


def test_unreflected_sides_are_warned_of() -> None:
    given = [*specimens("a", side="left"), *specimens("b", side="right")]
    with pytest.warns(UserWarning, match="of two sides are compared unreflected; pass them to .*of_one_side"):
        measure(given)
    for side in ("auto", "reflected", "ignore"):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            measure(of_one_side(given, side)[0])


def test_columns_of_a_table_tell_the_individual_and_the_side(tmp_path) -> None:
    rows = ["specimen,ind,side,replicate,landmark,x,y"]
    for number, (individual, side) in enumerate([("i1", "L"), ("i1", "Right"), ("i2", "left"), ("i2", "right")]):
        rows += [f"s{number},{individual},{side},1,{i + 1},{x},{y}" for i, (x, y) in enumerate(POINTS)]
    (tmp_path / "t.csv").write_text("\n".join(rows))
    found = read_specimens(tmp_path / "t.csv")
    assert [each.name for each in found] == ["s0", "s1", "s2", "s3"]
    assert [each.individual for each in found] == ["i1", "i1", "i2", "i2"]
    assert [each.side for each in found] == ["left", "right", "left", "right"]


def test_a_column_individual_beside_one_of_images_is_read(tmp_path) -> None:
    rows = ["image,side,individual,landmark,x,y"]
    for number, (individual, side) in enumerate([("F1", "left"), ("F1", "right"), ("F2", "left")]):
        rows += [f"IMG_{number}.jpg,{side},{individual},{i + 1},{x},{y}" for i, (x, y) in enumerate(POINTS)]
    rows += [f"tray.jpg,left,{name},{i + 1},{x},{y}" for name in ("F3", "F4") for i, (x, y) in enumerate(POINTS)]
    (tmp_path / "t.csv").write_text("\n".join(rows))
    found = read_specimens(tmp_path / "t.csv")
    assert [each.name for each in found][:3] == ["IMG_0", "IMG_1", "IMG_2"]
    assert [each.individual for each in found] == ["F1", "F1", "F2", "F3", "F4"]
    assert [each.side for each in found] == ["left", "right", "left", "left", "left"]


def test_a_row_for_each_image_may_tell_them_too(tmp_path) -> None:
    rows = ["image,individual,side,X1,Y1,X2,Y2,X3,Y3"]
    rows += [f"left/{i}.jpg,i{i},,0,0,5,1,3,4" for i in range(2)]
    rows += [f"right/{i}b.jpg,i{i},right,0,0,5,1,3,4" for i in range(2)]
    (tmp_path / "t.csv").write_text("\n".join(rows))
    found = read_specimens(tmp_path / "t.csv")
    assert [each.side for each in found] == ["left", "left", "right", "right"]
    assert [each.individual for each in found] == ["i0", "i1", "i0", "i1"]


def fits(*names_and_sides: tuple[str, str], status: str = "converged") -> list[Specimen]:
    """Give fits of one shape, of which the mirrored and the left ones are mirrored."""
    sign = {"mirrored": -1, "left": -1, "original": 1, "right": 1}
    return [
        Specimen(name, POINTS * [sign[side], 1] + i, side=side, status=status)
        for i, (name, side) in enumerate(names_and_sides)
    ]


def test_nameless_sides_of_fits_are_called_as_their_names_say() -> None:
    found, said = of_one_side(fits(("w1_left", "original"), ("w1_right", "mirrored"), ("w2_right", "mirrored")))
    assert [each.side for each in found] == ["left", "right", "right"]
    assert [each.individual for each in found] == ["w1", "w1", "w2"]
    assert said == "1 left specimen was reflected, to be compared with the right ones"
    found, said = of_one_side(fits(("w1", "original"), ("w2", "mirrored"), ("w3", "original")))
    assert [each.side for each in found] == ["original", "mirrored", "original"]
    assert [each.reflected for each in found] == [False, True, False]


def test_fits_of_another_side_than_their_names_are_named() -> None:
    given = fits(("w1_left", "left"), ("w1_right", "right"), ("w2_left", "right"), ("w2_right", "right"))
    found, said = of_one_side(given)
    assert [each.side for each in found] == ["left", "right", "right", "right"]
    assert [each.stated_side for each in found] == ["", "", "left", ""]
    assert (
        "; 1 specimen of another side than stated: w2_left (stated left, right by the fit). The side of the fit" in said
    )
    with pytest.raises(LiaamError, match="1 specimen of another side than stated: w2_left"):
        of_one_side(given, strict=True)
    given = fits(("w1_left", "original"), ("w1_right", "mirrored"), ("w2_left", "original"), ("w2_right", "original"))
    assert "w2_right (stated right, left by the fit)" in of_one_side(given)[1]
    lost = [replace(each, status="doubtful") for each in given]
    assert "another side" not in of_one_side(lost)[1]  # these are not measured


WING = np.array([[0, 0], [26, -6], [52, 4], [60, 22], [34, 30], [8, 24], [24, 12], [40, 14]], float)


def wings(rng, *names: str, flipped: tuple[str, ...] = (), **facts) -> list[Specimen]:
    """Give wings of the sides that their names state, but of the other if they are flipped."""
    found = []
    for name in names:
        sign = -1 if ("left" in name) != (name in flipped) else 1
        found.append(Specimen(name, (WING + rng.normal(0, 0.5, WING.shape)) * [sign, 1] + 100, **facts))
    return found


def names_of(n: int) -> list[str]:
    return [f"fly{i}_{side}" for i in range(n) for side in ("left", "right")]


@pytest.mark.parametrize("facts", [{}, {"side": "left", "status": "converged"}, {"side": "left"}])
def test_a_shape_that_contradicts_its_side_is_named_and_compared_as_it_is(rng, facts) -> None:
    given = wings(rng, *names_of(4), flipped=("fly2_left",))
    given[4] = replace(
        given[4], **facts
    )  # also if a table that was corrected by hand says that the fit is of this side
    found, said = of_one_side(given)
    assert said.startswith("3 left specimens were reflected, to be compared with the right ones; 1 specimen of another")
    assert "fly2_left (stated left, right by the shape)" in said
    for cause in ("the name, folder or column 'side' is wrong", "the landmarks are", "the photograph is flipped"):
        assert cause in said
    assert [each.name for each in found if each.stated_side] == ["fly2_left"]
    assert (found[4].side, found[4].stated_side, found[4].individual) == ("right", "left", "fly2")
    for each in found:
        assert np.abs(each.points - each.points.mean(axis=0) - (WING - WING.mean(axis=0))).max() < 4
    with pytest.raises(LiaamError, match=r"fly2_left \(stated left, right by the shape\)"):
        of_one_side(given, strict=True)
    assert of_one_side(given, "ignore")[1] == ""


def test_shapes_that_agree_with_their_sides_or_lack_landmarks_are_not_named(rng) -> None:
    given = wings(rng, *names_of(4))
    for i, each in enumerate(given):
        each.points[i] = np.nan
    given.append(Specimen("fly9_left", np.full((8, 2), np.nan)))
    given.append(Specimen("fly9_right", np.full((8, 2), 5.0)))
    given.append(Specimen("fly10_left", np.zeros((0, 2)), status="lost"))
    assert of_one_side(given)[1] == "6 left specimens were reflected, to be compared with the right ones"
    turned = replace(given[6], points=given[6].points * [-1, 1])
    assert "fly3_left (stated left, right by the shape)" in of_one_side([*given[:6], turned, *given[7:]])[1]
    one_side = wings(rng, "a_left", "b_left", "c_left", "d_left", "e_left", flipped=("e_left",))
    found, said = of_one_side(one_side)
    assert "e_left (stated left, right by the shape)" in said
    assert [each.reflected for each in found] == [False] * 4 + [True]


def test_a_shape_that_was_not_reflected_as_the_others_is_named(rng) -> None:
    given = wings(rng, *names_of(4))
    before = [replace(each, points=each.points * [-1, 1]) if "left" in each.name else each for each in given]
    before[4] = given[4]
    found, said = of_one_side(before, "reflected")
    assert said.startswith("1 specimen of another side than stated: fly2_left (mirrored, unlike most others)")
    assert found[4].points[1, 0] == -given[4].points[1, 0] and found[4].side == found[4].stated_side == "left"
    assert "fly2_left (mirrored, unlike most others)" in of_one_side(before)[1]


def test_sides_that_many_shapes_contradict_are_refused(rng) -> None:
    given = wings(rng, *names_of(4), flipped=("fly0_left", "fly1_left", "fly3_right"))
    with pytest.raises(LiaamError, match=r"the sides of 3 of 8 specimens are not those of .* --side ignore if"):
        of_one_side(given)


def test_a_flipped_photograph_is_no_replicate_of_the_other_side(rng) -> None:
    given = wings(rng, *names_of(4), flipped=("fly2_left",))
    assert [structure_name(each, "_") for each in of_one_side(given)[0]] == [
        name.replace("_", " ") for name in names_of(4)
    ]
