"""Tables of ``liaam scale``: lengths of a pixel by the image of a specimen."""

from pathlib import Path

import numpy as np
import pytest

from liaam.errors import LiaamError
from liaam.morphometry import Specimen, read_lengths, with_lengths

HEADER = "image,scale,unit,scale_se,how\n"


def save(folder: Path, text: str) -> Path:
    path = folder / "scales.csv"
    path.write_text(text)
    return path


def test_specimens_get_the_lengths_of_their_images(tmp_path: Path) -> None:
    table = save(tmp_path, HEADER + "tray.png,0.01,mm,0.0001,ruler\nB 2.jpg,20,um,,tags\nc.png,,,,refused\n")
    names = ["tray#2", "tray_1", "tray", "b 2", "c", "other"]
    specimens = [Specimen(name, np.zeros((2, 2)), scale=7.0) for name in names]
    found = with_lengths(specimens, read_lengths(table))
    assert [(each.scale, each.unit, each.scale_se) for each in found] == [
        *[(0.01, "mm", 0.0001)] * 3,
        (20.0, "um", 0.0),
        *[(None, "", 0.0)] * 2,
    ]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a,b\n1,2\n", "has no columns image, scale, unit: give a table of 'liaam scale'"),
        (HEADER, "has no columns"),
        (HEADER + "a.png,x,mm,0,ruler\n", "line 2 has no length of a pixel"),
        (HEADER + "a.png,-1,mm,0,ruler\n", "line 2 has no length of a pixel"),
        (HEADER + "a.png,1,apples,0,ruler\n", "line 2 has no length of a pixel"),
        (HEADER + "a.png,1,mm,0,ruler\na.png,2,mm,0,ruler\n", "line 3 has 'a.png' again"),
    ],
)
def test_tables_that_cannot_be_used_are_named(tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(LiaamError, match=words):
        read_lengths(save(tmp_path, text))


def test_a_table_of_other_images_is_refused(tmp_path: Path) -> None:
    lengths = read_lengths(save(tmp_path, HEADER + "a.png,1,mm,0,ruler\n"))
    with pytest.raises(LiaamError, match=r"no specimen is of an image in the table of scales, such as a\.png"):
        with_lengths([Specimen("b", np.zeros((2, 2)))], lengths)
