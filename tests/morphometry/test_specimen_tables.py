"""Tables of what is known of specimens: individual, side and groups."""

from dataclasses import replace

import numpy as np
import pytest

from liaam.errors import LiaamError
from liaam.morphometry import Specimen, of_one_side, read_specimen_table, read_specimens

WING = np.array([[0.0, 0], [9, 2], [20, 3], [24, 8], [15, 11], [3, 5]])

OWN = """Photo,Individual,Side,sex
IMG_1.JPG,F1,L,m
IMG_2.JPG,F1,R,m
IMG_3.JPG,F2,L,f
"""


@pytest.fixture
def own(tmp_path, monkeypatch):
    """Give a function that reads a table of this text, own.csv in the current folder."""
    monkeypatch.chdir(tmp_path)

    def read(text: str):
        (tmp_path / "own.csv").write_text(text)
        return read_specimen_table("own.csv")

    return read


def fits() -> list[Specimen]:
    """Give fits by a model of both sides: the image is known, and the side by the fit."""
    sides = ("original", "mirrored", "original", "mirrored")
    return [
        Specimen(f"IMG_{i}", WING * [1 - 2 * (side == "mirrored"), 1] + i, image=f"new/IMG_{i}.JPG", side=side)
        for i, side in enumerate(sides, 1)
    ]


def test_a_table_states_individuals_sides_and_groups(tmp_path) -> None:
    (tmp_path / "own.csv").write_text(OWN.replace(",", ";"), "utf-8-sig")
    table = read_specimen_table(tmp_path / "own.csv")
    found, unlisted = table.of(fits())
    assert [each.individual for each in found] == ["F1", "F1", "F2", ""] and unlisted == ("IMG_4",)
    assert [each.stated_side for each in found] == ["left", "right", "left", ""]
    assert table.cells_of(fits(), "sex") == ("m", "m", "f", "") == table.cells_of(fits(), "Sex")
    one_side, _ = of_one_side(found[:3])
    assert [each.individual for each in one_side] == ["F1", "F1", "F2"]
    assert [(each.side, each.stated_side) for each in one_side] == [("left", ""), ("right", ""), ("left", "")]
    with pytest.raises(
        LiaamError, match=r"1 of 4 specimens have no side.*: IMG_4; .* complete the column, or remove it"
    ):
        of_one_side(found)


def test_a_side_of_the_table_that_the_fit_contradicts_is_reported(own) -> None:
    """As one of a name is: the fit's is taken."""
    told = [replace(each, status="converged", side="right" if each.side == "original" else "left") for each in fits()]
    found, _ = own(OWN + "IMG_4.JPG,F2,L,f\n").of(told)
    one_side, said = of_one_side(found)
    assert [each.side for each in one_side] == ["right", "left", "right", "left"]
    assert "3 specimens of another side than stated: IMG_1 (stated left, right by the fit), IMG_2" in said
    placed = [replace(each, status="", side="") for each in told]  # by a person: the table is all that is known
    assert [each.side for each in own(OWN).of(placed)[0]] == ["left", "right", "left", ""]
    one_sided, _ = own("image,side\nIMG_1,L\nIMG_3,L\n").of([fits()[0], fits()[2]])
    assert [each.side for each in of_one_side(one_sided)[0]] == ["left", "left"]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("wing,sex\na,m\n", r"own.csv has no column image \(or photo, file, specimen\): it has wing, sex; give a .csv"),
        ("image,sex\n", "own.csv has no rows below its header"),
        ("image,sex\na,m\na,f\n", "own.csv: line 3 has 'a' again"),
        (OWN.replace("F2,L", "F2,lefft"), r"own.csv: .*The side of IMG_3 \('lefft'\) is neither left nor right"),
        ("image,sex\nother,m\n", "no specimen has a row in own.csv, which has names such as other"),
    ],
)
def test_tables_that_do_not_suit_are_named(own, text, words) -> None:
    with pytest.raises(LiaamError, match=words):
        own(text).of(fits())


def test_columns_that_are_absent_are_named(own) -> None:
    with pytest.raises(LiaamError, match=r"own\.csv has no column 'age': it has Photo, Individual, Side, sex"):
        own(OWN).cells_of(fits(), "age")


def test_both_sides_in_one_image_are_of_one_individual() -> None:
    left = [Specimen(f"tray{i}#1", WING * [-1, 1], image=f"tray{i}.jpg", side="left") for i in range(3)]
    right = [Specimen(f"tray{i}#2", WING, image=f"tray{i}.jpg", side="right") for i in range(2)]
    found, _ = of_one_side([*left, *right])
    assert [each.individual for each in found] == ["tray0", "tray1", "tray2", "tray0", "tray1"]
    two_of_a_side = Specimen("tray0#3", WING, image="tray0.jpg", side="right")
    found, _ = of_one_side([*left, *right, two_of_a_side])
    assert [each.individual for each in found][:2] == ["tray0#1", "tray1#1"]


def test_columns_of_a_batch_may_be_written_with_capitals(tmp_path) -> None:
    header = "path,status,quality,x1,y1,x2,y2,x3,y3"
    rows = ["new/a.jpg,converged,1,0,0,9,2,20,3,Left,F1", "new/b.jpg,converged,1,0,0,9,2,20,3,Right,F1"]
    (tmp_path / "b.csv").write_text("\n".join([f"{header},Side,Ind", *rows]))
    found = read_specimens(tmp_path / "b.csv")
    assert [(each.side, each.individual) for each in found] == [("Left", "F1"), ("Right", "F1")]
    (tmp_path / "b.csv").write_text("\n".join([f"{header},Side,side", *rows]))
    with pytest.raises(LiaamError, match="the columns Side and side both are of the side: keep one of them"):
        read_specimens(tmp_path / "b.csv")
