"""``.tps``: what a second reader makes of our files, what other programs write, and a message for every fault."""

from pathlib import Path

import numpy as np
import pytest
from ktch.io import TPSData, read_tps

from liaam.datasets import load_folder
from liaam.errors import LandmarkError
from liaam.io import (
    Contour,
    Landmarks,
    read_collection,
    read_landmarks,
    write_collection,
    write_image,
    write_landmarks,
)
from liaam.io.landmarks import Reading, parse_landmark_data

NAN = np.nan
WINGS = (
    "LM=3\n290. 108.\n100. 179.\n0. 0.\nIMAGE=63001.jpg\nID=0\nSCALE=0.004585\n"
    "LM=3\n284. 76.\n55. 156.\n1. 479.\nIMAGE=63002.jpg\nID=1\nSCALE=0.004585\n"
)


def save(folder: Path, text: str | bytes, name: str = "a.tps") -> Path:
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def second_reader(path: Path) -> list[TPSData]:
    found = read_tps(path)
    records = found if isinstance(found, list) else [found]
    assert all(isinstance(record, TPSData) for record in records)
    return records  # pyright: ignore[reportReturnType]


def add_image(path: Path, height: int = 480, width: int = 632) -> None:
    write_image(path, np.zeros((height, width, 3), np.uint8))


def test_y_counts_upwards_from_the_bottom_row(tmp_path: Path) -> None:
    path = save(tmp_path, "LM=2\n0. 0.\n10.5 20.\nID=x\n")
    assert read_landmarks(path, (632, 480)).points.tolist() == [[0, 479], [10.5, 459]]
    write_landmarks(tmp_path / "b.tps", np.array([[0.0, 479.0]]), (632, 480))
    assert (tmp_path / "b.tps").read_text() == "LM=1\n0.0 0.0\n"


def test_each_image_gives_its_own_height(tmp_path: Path) -> None:
    add_image(tmp_path / "63001.jpg")
    add_image(tmp_path / "63002.jpg", height=100)
    found = read_collection(save(tmp_path, WINGS))
    assert found["63001.jpg"].points.tolist() == [[290, 371], [100, 300], [0, 479]]
    assert found["63002.jpg"].points.tolist() == [[284, 23], [55, -57], [1, -380]]
    assert {marks.scale for marks in found.values()} == {0.004585}
    assert read_landmarks(tmp_path / "a.tps", image_name="63001.jpg").points[2].tolist() == [0, 479]
    with pytest.raises(LandmarkError, match=r"a\.tps has no landmarks of b\.jpg: add them"):
        read_landmarks(tmp_path / "a.tps", image_name="b.jpg")


def test_the_path_of_another_computer_leads_to_the_image_beside(tmp_path: Path) -> None:
    add_image(tmp_path / "a.png", 10, 10)
    path = save(tmp_path, "LM=1\n1 2\nIMAGE=C:\\pictures\\a.png\n")
    assert read_landmarks(path).points.tolist() == [[1, 7]]
    with pytest.raises(LandmarkError, match=r"a\.tps: the size of its image is needed: put the image beside"):
        read_landmarks(save(tmp_path, "LM=1\n1 2\n"))


def test_without_the_image_the_message_says_what_to_do(tmp_path: Path) -> None:
    with pytest.raises(LandmarkError, match=r"a\.tps: the size .*63001\.jpg does not exist.*put the image beside"):
        read_collection(save(tmp_path, WINGS))


def test_specimens_of_one_image_their_curves_and_missing_points_round_trip(tmp_path: Path) -> None:
    add_image(tmp_path / "a.png", 100, 100)
    points = np.array([[1, 2.17], [NAN, NAN], [5, 6], [7, 8], [9, 10], [11, 12], [NAN, NAN]], float)
    lines = (Contour((2, 3)), Contour((4, 5, 6)))
    second = Landmarks(points + 40, lines, image_name="a.png", label="left")
    third = Landmarks(points[:2] + 60, image_name="a.png", label="right", side="right")
    first = Landmarks(points, lines, image_name="a.png", scale=0.5, label="7", others=(second, third))
    write_landmarks(tmp_path / "one.tps", first)
    write_collection(tmp_path / "all.tps", {"a.png": first})
    assert (tmp_path / "one.tps").read_text().splitlines()[1:3] == ["1.0 96.83", "-1 -1"]  # not 96.82999999999998
    for name in ("one.tps", "all.tps"):
        read = read_collection(tmp_path / name)["a.png"]
        for written, found in zip((first, second, third), (read, *read.others), strict=True):
            np.testing.assert_allclose(found.points, written.points, rtol=0, atol=1e-9)
            assert (found.contours, found.label, found.scale) == (written.contours, written.label, written.scale)
            assert found.side == written.side


# A second reader ------------------------------------------------------------------------------------


def test_a_second_reader_finds_the_marked_pixels(tmp_path: Path) -> None:
    """The flip is right if a bright pixel lies where the other reader, counting rows from the bottom, finds it."""
    spots = np.array([[3, 1], [8, 6], [0, 9]])
    image = np.zeros((12, 10, 3), np.uint8)
    image[spots[:, 1], spots[:, 0]] = 255
    write_image(tmp_path / "wing.png", image)
    write_landmarks(tmp_path / "wing.tps", Landmarks(spots, image_name="wing.png", scale=0.25))
    (theirs,) = second_reader(tmp_path / "wing.tps")
    columns, rows = theirs.landmarks.astype(int).T
    assert (np.flipud(image)[rows, columns] == 255).all()
    assert (theirs.image_path, theirs.specimen_name, theirs.scale) == ("wing.png", "wing", 0.25)


def test_a_second_reader_reads_collections_curves_and_missing_points(tmp_path: Path) -> None:
    points = np.array([[1.5, 2], [NAN, NAN], [5, 6], [7, 8], [9, 10], [11, 12.25]])
    curves = (Contour((2, 3)), Contour((4, 5)))
    marks = {name: Landmarks(points + i, curves) for i, name in enumerate(("my wing 1.jpg", "b/c.jpg"))}
    write_collection(tmp_path / "all.tps", marks, dict.fromkeys(marks, (100, 50)))
    first, second = second_reader(tmp_path / "all.tps")
    np.testing.assert_array_equal(first.landmarks, [[1.5, 47], [-1, -1]])  # as tpsDig writes a missing one
    assert [curve.tolist() for curve in first.curves or ()] == [[[5, 43], [7, 41]], [[9, 39], [11, 36.75]]]
    assert (first.specimen_name, second.specimen_name, second.image_path) == ("my wing 1", "c", "b/c.jpg")
    data = (tmp_path / "all.tps").read_bytes()
    back = parse_landmark_data("all.tps", data, (100, 50))
    assert isinstance(back, dict)
    np.testing.assert_array_equal(back["my wing 1.jpg"].points, points)
    assert back["my wing 1.jpg"].contours == curves


@pytest.mark.parametrize("contours", [(Contour((0, 1, 2), closed=True),), (Contour((0, 1)),), (Contour((2, 1)),)])
def test_other_contours_are_not_curves(tmp_path: Path, contours: tuple[Contour, ...]) -> None:
    write_landmarks(tmp_path / "a.tps", Landmarks(np.eye(3, 2), contours), (9, 9))
    assert (tmp_path / "a.tps").read_text().startswith("LM=3\n")
    assert "CURVES" not in (tmp_path / "a.tps").read_text()


# What other programs write --------------------------------------------------------------------------


@pytest.mark.parametrize("missing", ["NA NA", "NaN NaN", "-1 -1", "-1.00000 -1.00000", "nan\tnan"])
def test_missing_points(missing: str) -> None:
    marks = parse_landmark_data("a.tps", f"LM=2\n{missing}\n-1 5\nID=0\n".encode(), (10, 10))
    assert isinstance(marks, dict)
    np.testing.assert_array_equal(marks["0"].points, [[NAN, NAN], [-1, 4]])


def test_what_tpsdig_writes_besides_points_is_skipped(tmp_path: Path) -> None:
    text = (
        "LM=1\r\n1.00000 2.00000\r\nCURVES=2\r\nPOINTS=2\r\n3 4\r\n5 6\r\nPOINTS=0\r\nOUTLINES=1\r\nPOINTS=2\r\n7 8\r\n"
        "9 9\r\nRADII=2\r\n3.5\r\n4.5\r\nVARIABLES=a=1\r\nCOMMENT=Flügel von 1\r\nzweite Zeile\r\n"
        "IMAGE=C:\\Bilder\\Flügel 1.JPG\r\nID=Flügel 1\r\nScale = 0.5\r\n"
    )
    add_image(tmp_path / "flügel 1.jpg", 10, 10)
    save(tmp_path, text.encode("latin-1"))
    sample = load_folder(tmp_path)[0]
    assert sample.landmarks.points.tolist() == [[1, 7], [3, 5], [5, 3]]
    assert sample.landmarks.contours == (Contour((1, 2)),)
    assert sample.landmarks.scale == 0.5


def test_images_that_are_not_digitised_yet_are_left_out(tmp_path: Path) -> None:
    for name in ("a", "b"):
        add_image(tmp_path / f"{name}.png", 10, 10)
    save(tmp_path, "LM=1\n1 2\nIMAGE=a.png\nID=0\nLM=0\nIMAGE=b.png\nID=1\n", "all.tps")
    dataset = load_folder(tmp_path)
    assert [sample.name for sample in dataset] == ["a"]
    assert [(left.path.name, left.reason) for left in dataset.left_out] == [("b.png", "the image has no landmarks")]


def test_a_record_names_its_image_by_its_id_or_lies_beside_it(tmp_path: Path) -> None:
    for name in ("a", "b"):
        add_image(tmp_path / f"{name}.png", 10, 10)
    save(tmp_path, "LM=1\n1 2\nID=a\n", "all.tps")
    save(tmp_path, "LM=1\n3 4\n", "b.tps")
    assert [sample.landmarks.points.tolist() for sample in load_folder(tmp_path)] == [[[1, 7]], [[3, 5]]]


def test_names_that_no_image_has_are_reported(tmp_path: Path) -> None:
    add_image(tmp_path / "a.png", 10, 10)
    save(tmp_path, "LM=1\n1 2\nID=7\n", "all.tps")
    with pytest.raises(LandmarkError, match=r"all\.tps: it names images that do not exist: 7\. Correct these names"):
        load_folder(tmp_path)


def test_an_image_that_cannot_be_read_is_left_out(tmp_path: Path) -> None:
    add_image(tmp_path / "63001.jpg")
    save(tmp_path, b"no image", "63002.jpg")
    save(tmp_path, WINGS)
    dataset = load_folder(tmp_path)
    assert len(dataset) == 1
    assert "its image cannot be read" in dataset.left_out[0].reason


# Faults ---------------------------------------------------------------------------------------------

BAD = [
    ("LM3=2\n1 2 3\n4 5 6\nID=0\n", r"line 1 \('LM3=2'\) begins points with x, y and z: export x and y only"),
    ("IMAGE=a.jpg\nLM=1\n1 2\n", r"line 1 \('IMAGE=a.jpg'\) comes before any LM=: export the file again"),
    ("LM=3\n1 2\n3 4\nID=0\n", r"line 1 \('LM=3'\) promises 3 points but 2 follow.*correct the number"),
    ("LM=1\n1 2\n3 4\nID=0\n", r"line 3 \('3 4'\) is not expected here: correct the number of points above it"),
    ("LM=999999999999999999999999999999\n1 2\n", "promises 999999999999999999999999999999 points but 1 follow"),
    ("LM=" + "9" * 5000 + "\n1 2\n", r"promises 9+\.\.\. points but 1 follow"),
    ("LM=-1\nID=0\n", r"line 1 \('LM=-1'\) has no number of points"),
    ("LM=two\n", "has no number of points after '=': correct it, such as LM=12"),
    ("LM=1\n1 2 3\nID=0\n", "line 2 holds 3 values"),
    ("LM=1\n1 NA\nID=0\n", "line 2 has only one of x and y: give both, or neither"),
    ("LM=1\n1,5 2\nID=0\n", r"'1,5' in line 2 is not a number: correct it \(decimal points"),
    ("LM=1\n1 1e999\nID=0\n", "in line 2 is not a number"),
    ("LM=1\n1 2\nCURVES=1\nPOINTS=2\n1 2\nID=0\n", r"line 4 \('POINTS=2'\) promises 2 points but 1 follow"),
    ("LM=0\nIMAGE=a.jpg\n", r"no landmarks in it \(tpsDig points\): place those of at least one image"),
    ("nothing of the kind\n", r"'nothing of the kind' is not expected here, before any LM="),
]

ONE_RECORD = [
    *(
        (f"LM=1\n1 2\nSCALE={scale}\n", "SCALE= is not a positive number: a.tps")
        for scale in ("-0.5", "0", "inf", "big", "")
    ),
    ("LM=1\n1 2\nIMAGE=a.jpg\nLM=1\n3 4\nSCALE=1\n", "the record of line 4 .* names no image: add a line IMAGE="),
]


@pytest.mark.parametrize(("text", "words"), ONE_RECORD, ids=[words[:40] for _, words in ONE_RECORD])
def test_one_bad_record_stops_only_strict_reading(tmp_path: Path, text: str, words: str) -> None:
    path = save(tmp_path, text)
    with pytest.warns(UserWarning, match=r"a\.tps: (there is no scale|left out line 4)"):
        assert read_landmarks(path, (100, 100)).scale is None
    with pytest.raises(LandmarkError, match=words):
        read_landmarks(path, (100, 100), reading=Reading(strict=True))


def test_two_records_of_an_image_are_two_specimens(tmp_path: Path) -> None:
    text = "LM=1\n1 2\nIMAGE=a.jpg\nID={}\nLM=1\n3 4\nIMAGE=a.jpg\nID={}\n"
    named = read_landmarks(save(tmp_path, text.format("left", "right")), (10, 10))
    assert [name for name, _ in named.objects("a")] == ["a#left", "a#right"]
    numbered = read_landmarks(save(tmp_path, text.format(0, 0)), (10, 10))
    assert [(name, own.points.tolist()) for name, own in numbered.objects("a")] == [("a", [[1, 7]]), ("a#2", [[3, 5]])]


@pytest.mark.parametrize(("text", "words"), BAD, ids=[words[:40] for _, words in BAD])
def test_faults_are_reported_with_the_line_and_a_remedy(tmp_path: Path, text: str, words: str) -> None:
    path = save(tmp_path, text)
    with pytest.raises(LandmarkError, match=words) as caught:
        read_landmarks(path, (100, 100))
    assert str(path) in str(caught.value)


def test_scales_are_positive() -> None:
    with pytest.raises(LandmarkError, match="the scale is -1: give the length of a pixel"):
        Landmarks(np.zeros((1, 2)), scale=-1)


def test_a_scale_may_have_a_decimal_comma(tmp_path: Path) -> None:
    assert read_landmarks(save(tmp_path, "LM=1\n1,5 2,5\nSCALE=0,25\n"), (100, 100)).scale == 0.25


def test_the_wings(shared_data: Path) -> None:
    dataset = load_folder(shared_data / "wings")
    assert len(dataset) == 58
    assert "tpsDig points (.tps): 58" in dataset.report()
    assert dataset[0].landmarks.points[0].tolist() == [290, 371]
    theirs = second_reader(shared_data / "wings" / "tps-example.tps")
    for sample, own in zip(dataset, theirs, strict=True):
        np.testing.assert_array_equal(sample.landmarks.points, own.landmarks * (1, -1) + (0, 479))
    # The file of another tool is named, and does not get in the way.
    assert [left.path.name for left in dataset.left_out] == ["csv-example.csv"]


def test_a_folder_is_not_listed_for_an_image_that_has_the_name_in_the_file(tmp_path, monkeypatch):
    """Files of a folder that are read one by one took as many lists of it."""
    write_image(tmp_path / "a.png", np.zeros((20, 30, 3), np.uint8))
    (tmp_path / "a.tps").write_text("LM=2\n1 2\n3 4\nIMAGE=a.png\n")
    monkeypatch.setattr(Path, "iterdir", lambda folder: pytest.fail("the folder is listed"))
    assert read_landmarks(tmp_path / "a.tps").points.tolist() == [[1, 17], [3, 15]]
