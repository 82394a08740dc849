"""Which pictures a project has, and which of them can be used."""

import threading

import numpy as np
import pytest
from small_projects import POINTS, TRIANGLE, by_name, put, refused

from liaam.datasets import load_folder
from liaam.errors import ImageError
from liaam.io import Landmarks, write_image, write_landmarks
from liaam.studio import folder as listing
from liaam.studio.project import Project
from liaam.studio.settings import StudioSettings


def test_pictures_come_in_natural_order_without_hidden_files_and_folders(small):
    (small.root / "sub").mkdir()
    write_image(small.root / "sub" / "x.png", np.zeros((9, 9, 3), np.uint8))
    write_image(small.root / ".hidden.png", np.zeros((9, 9, 3), np.uint8))
    (small.root / "notes.txt").write_text("hello")
    (small.root / "empty").mkdir()
    assert list(by_name(small)) == ["p1.png", "p2.png", "p10.png", "q.jpg"]
    assert small.problems == [
        "1 subfolder (sub) with pictures not shown, because the folder itself has pictures: "
        "open the studio on a subfolder"
    ]
    assert by_name(small)["p1.png"] == {
        "name": "p1.png", "state": "new", "placed": 0, "error": None, "width": 40, "height": 30,
        "uncertainty": None, "doubtful": False, "rank": None, "checked": None, "left_out": None,
        "quality": None, "slip": None, "slip_points": [], "revision": None, "tag": small.marks("p1.png")["tag"],
        "absent": 0, "unconfirmed": 0, "proposed": 0, "nothing_found": False, "side": "",
    }  # fmt: skip


@pytest.fixture
def nested(tmp_path):
    """Give a project of two persons in subfolders, with pictures of the same names."""
    for name in ("ann/1.png", "ann/2.png", "bob/side/1.png", ".hidden/1.png"):
        (tmp_path / "all" / name).parent.mkdir(parents=True, exist_ok=True)
        write_image(tmp_path / "all" / name, np.full((30, 40, 3), len(name), np.uint8))
    return Project(tmp_path / "all")


def test_without_pictures_in_the_folder_those_of_its_subfolders_are_shown(nested):
    assert list(by_name(nested)) == ["ann/1.png", "ann/2.png", "bob/side/1.png"]
    assert nested.problems == []
    nested.save_template(TRIANGLE)
    put(nested, "bob/side/1.png", POINTS)
    assert (nested.root / "bob" / "side" / "1.ljson").is_file()
    assert by_name(nested)["bob/side/1.png"]["state"] == "done" != by_name(nested)["ann/1.png"]["state"]
    assert [item.name for item in nested.annotated()] == ["bob/side/1.png"]
    assert [sample.name for sample in load_folder(nested.root, recursive=True)] == ["bob/side/1"]
    write_image(nested.root / "top.png", np.zeros((9, 9, 3), np.uint8))
    assert list(by_name(nested)) == ["top.png"]
    assert "1 subfolder (ann) with pictures not shown" in nested.problems[0]


def test_changes_in_subfolders_are_noticed(nested):
    before = nested.stamp
    write_image(nested.root / "bob" / "2.png", np.zeros((9, 9, 3), np.uint8))
    assert nested.stamp != before
    assert nested.source("bob/2.png").size == (9, 9)
    write_landmarks(nested.root / "ann" / "2.pts", Landmarks(POINTS))
    assert nested.marks("ann/2.png")["file"] == "ann/2.pts"


def test_invisible_points_and_changes_of_the_template_know_subfolders(nested):
    nested.save_template(TRIANGLE)
    for name in ("ann/1", "ann/2"):
        write_landmarks(nested.root / f"{name}.pts", Landmarks(POINTS))
    put(nested, "ann/1.png", POINTS, nested.marks("ann/1.png")["revision"], invisible=[1])
    nested.save_template({**TRIANGLE, "names": ["c", "a", "b"], "mapping": [2, 0, 1]})
    again = Project(nested.root)
    assert again.marks("ann/1.png")["points"] == [POINTS[2], POINTS[0], POINTS[1]] == again.marks("ann/2.png")["points"]
    assert (again.marks("ann/1.png")["invisible"], again.marks("ann/2.png")["invisible"]) == ([2], [])


def test_links_to_folders_are_not_followed(nested, tmp_path):
    (tmp_path / "outside").mkdir()
    write_image(tmp_path / "outside" / "x.png", np.zeros((9, 9, 3), np.uint8))
    (nested.root / "out").symlink_to(tmp_path / "outside")
    (nested.root / "ann" / "loop").symlink_to(nested.root)
    assert list(by_name(nested)) == ["ann/1.png", "ann/2.png", "bob/side/1.png"]
    for name in ("out/x.png", "ann/../ann/1.png", "ann//1.png", "../outside/x.png", ".hidden/1.png"):
        assert refused(nested.source, name).status == 404


def test_subfolders_above_a_limit_are_named(nested, monkeypatch):
    monkeypatch.setattr(listing, "MOST_FOLDERS", 3)
    project = Project(nested.root)
    assert list(by_name(project)) == ["ann/1.png", "ann/2.png"]
    assert "1 subfolder (bob/side) with pictures not shown, because there are too many" in project.problems[0]


def test_pictures_that_come_and_go_are_noticed(small):
    write_image(small.root / "new.png", np.zeros((8, 9, 3), np.uint8))
    (small.root / "p1.png").unlink()
    assert list(by_name(small)) == ["new.png", "p2.png", "p10.png", "q.jpg"]
    assert refused(small.marks, "p1.png").status == 404
    assert small.source("new.png").size == (9, 8)


def test_a_corrupt_picture_is_broken_with_the_reason(small):
    (small.root / "bad.png").write_bytes(b"\x89PNG\r\n\x1a\n rubbish")
    (small.root / "text.jpg").write_text("no picture")
    (small.root / "empty.png").touch()
    pictures = by_name(small)
    for name in ("bad.png", "text.jpg", "empty.png"):
        assert pictures[name]["state"] == "broken"
        assert pictures[name]["error"].startswith(name)
        assert str(small.root) not in pictures[name]["error"]
        assert refused(small.marks, name).status == 409
        assert refused(put, small, name, POINTS).status == 409


def test_of_two_pictures_of_one_stem_the_second_is_broken(small):
    write_image(small.root / "p1.jpg", np.zeros((9, 9, 3), np.uint8))
    put(small, "p1.png", POINTS)
    pictures = by_name(small)
    assert pictures["p1.png"]["state"] == "done"
    assert pictures["p1.jpg"]["state"] == "broken"
    assert "p1.png has the same name" in pictures["p1.jpg"]["error"]
    assert [sample.image.name for sample in load_folder(small.root)] == ["p1.png"]


def test_a_picture_of_too_many_pixels_is_broken(small):
    project = Project(small.root, StudioSettings(pixels=1000))
    assert "40 x 30 pixels, more than 1,000: make" in by_name(project)["p1.png"]["error"]


def test_sizes_are_upright(small):
    from PIL import Image

    exif = Image.Exif()
    exif[0x0112] = 6
    Image.new("RGB", (50, 20)).save(small.root / "turned.jpg", exif=exif)
    assert small.source("turned.jpg").size == (20, 50)


def test_folders_that_cannot_be_used_are_refused(tmp_path):
    with pytest.raises(ImageError, match="does not exist"):
        Project(tmp_path / "missing")
    (tmp_path / "file").touch()
    with pytest.raises(ImageError, match="is a file, not a folder"):
        Project(tmp_path / "file")


def test_an_empty_folder_is_fine(tmp_path):
    project = Project(tmp_path)
    assert project.overview().pictures == [] and project.templates.current is None and project.problems == []
    assert list(tmp_path.iterdir()) == []  # looking leaves nothing behind


def test_an_overview_does_not_wait_for_files_that_were_not_read(small, monkeypatch):
    monkeypatch.setattr("liaam.studio.project.READ_AT_ONCE", 0)
    put(small, "p1.png", POINTS)
    project = Project(small.root)
    first = project.overview(None, seconds=0.0)
    assert {picture["state"] for picture in first.pictures} == {"reading"}
    assert [picture["name"] for picture in first.pictures] == ["p1.png", "p2.png", "p10.png", "q.jpg"]
    assert first.done == {}
    project.read_files(threading.Event())
    then = project.overview(first.stamp, seconds=0.0)
    assert [picture["state"] for picture in then.pictures] == ["done", "new", "new", "new"]
    assert list(then.done) == ["p1.png"]
    assert project.overview(then.stamp, seconds=0.0) is None
    (small.root / "p2.png").unlink()
    assert len(project.overview(then.stamp, seconds=0.0).pictures) == 3
