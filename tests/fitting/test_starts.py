"""Starts as people say them."""

from pathlib import Path

import pytest

from liaam.errors import LandmarkError, StartError
from liaam.fitting.search.starts import check_start, read_start, start_file
from liaam.io import Landmarks, write_landmarks

IMAGE, SIZE = Path("faces/anna.png"), (100, 80)


def test_reads_numbers_files_and_folders(tmp_path):
    assert read_start("1,2,30,40", IMAGE, SIZE) == [1, 2, 30, 40]
    assert read_start("5, 6,20", IMAGE, SIZE) == [5, 6, 20]
    (tmp_path / "anna.box").write_text("1 2\t30, 40\n")
    assert read_start(str(tmp_path), IMAGE, SIZE) == [1, 2, 30, 40]
    assert read_start(str(tmp_path / "anna.box"), IMAGE, SIZE) == [1, 2, 30, 40]
    write_landmarks(tmp_path / "anna.pts", [[1, 2], [3, 4], [5, 7]])
    start = read_start(str(tmp_path), IMAGE, SIZE)  # landmarks say more than a box
    assert not isinstance(start, list)
    assert start.points.tolist() == [[1, 2], [3, 4], [5, 7]]
    assert start_file(str(tmp_path), IMAGE) == start_file(str(tmp_path / "anna.pts"), IMAGE) == tmp_path / "anna.pts"
    assert start_file(str(tmp_path), Path("otto.png")) is start_file("1,2,3", IMAGE) is None
    check_start("1,2,3")
    check_start(str(tmp_path))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("nowhere", "--init nowhere: there is no such file or folder, and it is neither a box"),
        ("1,2", "--init 1,2: give four numbers .* not 2"),
        ("{folder}", r"anna.png: .* holds no landmark file for it; add one such as anna.pts"),
        ("{folder}/words.box", r"words.box: it is neither a box"),
        ("{folder}/five.box", r"five.box: give four numbers .* not 5"),
        ("{folder}/empty.box", r"empty.box is empty"),
    ],
)
def test_refuses_what_is_no_start(tmp_path, text, message):
    (tmp_path / "words.box").write_text("left, right")
    (tmp_path / "five.box").write_text("1 2 3 4 5")
    (tmp_path / "empty.box").touch()
    with pytest.raises(StartError, match=message):
        read_start(text.format(folder=tmp_path), IMAGE, SIZE)


@pytest.mark.parametrize("text", ["nowhere", "1,2", "a,b,c"])
def test_checks_a_start_before_there_is_a_picture(text):
    with pytest.raises(StartError):
        check_start(text)


def test_numbers_too_many_for_a_name_are_counted(tmp_path):
    shape = ",".join(["123.25"] * 136)
    for complain in (check_start, lambda text: read_start(text, IMAGE, SIZE)):
        with pytest.raises(StartError, match="not 136"):
            complain(shape)


def test_a_start_that_may_not_be_looked_at_is_told(monkeypatch):
    def forbidden(*_, **__):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "stat", forbidden)
    with pytest.raises(StartError, match=r"secret/anna.pts cannot be read \(Permission denied\)"):
        check_start("secret/anna.pts")


@pytest.mark.parametrize(("text", "shown"), [("x" * 100, "x" * 100), ("x" * 101, "x" * 100 + "...")])
def test_a_message_shows_the_beginning_of_a_long_start(text, shown):
    with pytest.raises(StartError) as caught:
        check_start(text)
    assert str(caught.value) == (
        f"--init {shown}: there is no such file or folder, and it is neither a box x0,y0,x1,y1 nor x,y,size"
    )


def test_a_fault_without_a_reason_is_shown_as_it_is(monkeypatch):
    def broken(*_, **__):
        raise OSError("odd")

    monkeypatch.setattr(Path, "stat", broken)
    with pytest.raises(StartError, match=r"--init: a.pts cannot be read \(odd\): check its permissions"):
        check_start("a.pts")


def test_names_that_no_file_can_have_are_no_files(tmp_path):
    (tmp_path / "notes.txt").write_text("hello")
    for text in (f"{tmp_path}/notes.txt/anna.pts", "a\0b", "x" * 5000):
        assert start_file(text, IMAGE) is None
        with pytest.raises(StartError, match="there is no such file or folder"):
            check_start(text)


def test_what_is_neither_file_nor_folder_is_no_start(tmp_path):
    assert start_file("/dev/null", IMAGE) is None
    (tmp_path / "anna.pts").mkdir()  # has the name of a file
    (tmp_path / "anna.BOX").write_text("1,2,3")
    with pytest.raises(StartError) as caught:
        read_start(str(tmp_path), IMAGE, SIZE)
    assert str(caught.value) == f"anna.png: {tmp_path} holds no landmark file for it; add one such as anna.pts"
    assert read_start(str(tmp_path / "anna.BOX"), IMAGE, SIZE) == [1, 2, 3]


def test_a_box_file_is_small_text(tmp_path):
    path = tmp_path / "anna.box"
    path.write_bytes(b"\xef\xbb\xbf1,2,3".ljust(1000))
    assert read_start(str(path), IMAGE, SIZE) == [1, 2, 3]
    path.write_bytes(b"1,2,3".ljust(1001))
    with pytest.raises(StartError, match="more than the 1,000 allowed"):
        read_start(str(path), IMAGE, SIZE)
    path.write_bytes(b"1,2,\xff")
    with pytest.raises(StartError, match=r"anna\.box: it is neither a box x0,y0,x1,y1 nor x,y,size"):
        read_start(str(path), IMAGE, SIZE)


def test_relative_landmarks_are_read_for_the_size_of_the_image(tmp_path):
    (tmp_path / "anna.asf").write_text("1\n0 0 0.5 0.25 0 0 0\n")
    start = read_start(str(tmp_path), IMAGE, SIZE)
    assert not isinstance(start, list)
    assert start.points.tolist() == [[50, 20]]


def test_a_file_of_many_images_starts_each(tmp_path):
    path = tmp_path / "all.tps"
    path.write_text("LM=1\n1 2\nIMAGE=a.png\nSCALE=0.5\nLM=1\n3 4\nIMAGE=C:\\x\\b.png\nSCALE=0.5\n")
    start = read_start(str(path), tmp_path / "b.png", (10, 20))
    assert isinstance(start, Landmarks)
    assert (start.points.tolist(), start.scale) == ([[3, 15]], 0.5)
    with pytest.raises(LandmarkError, match=r"all\.tps has no landmarks of c\.png"):
        read_start(str(path), tmp_path / "c.png", (10, 20))
