"""Landmarks beside the pictures, as they are read and saved."""

import threading
from pathlib import Path

import numpy as np
import pytest
from small_projects import POINTS, TRIANGLE, by_name, put, refused, states

from liaam.datasets import load_folder
from liaam.errors import LandmarkError, LiaamError
from liaam.io import Contour, Landmarks, read_landmarks, write_collection, write_image, write_landmarks
from liaam.studio.folder import STATE
from liaam.studio.project import Project
from liaam.studio.refusal import Refusal


def test_landmarks_are_saved_beside_the_picture_as_train_reads_them(small):
    answer = put(small, "p1.png", POINTS, invisible=[2])
    assert answer["picture"]["state"] == "done"
    marks = small.marks("p1.png")
    assert marks["points"] == POINTS and marks["invisible"] == [2]
    assert (marks["source"], marks["file"], marks["revision"]) == ("file", "p1.ljson", answer["revision"])
    sample = load_folder(small.root)[0]
    np.testing.assert_array_equal(sample.landmarks.points, POINTS)
    assert sample.landmarks.names == ("a", "b", "c")
    assert sample.landmarks.contours == (Contour((0, 1, 2), closed=True),)
    assert Project(small.root).marks("p1.png") == marks


def test_some_points_make_it_partial(small):
    answer = put(small, "p1.png", [[1, 2], None, [3, 4]])
    assert (answer["picture"]["state"], answer["picture"]["placed"]) == ("partial", 2)
    assert small.marks("p1.png")["points"] == [[1, 2], None, [3, 4]]


def test_a_revision_of_before_is_refused_with_what_is_there(small):
    first = put(small, "p1.png", POINTS)["revision"]
    moved = [[5.0, 6.0], *POINTS[1:]]
    second = put(small, "p1.png", moved, first)["revision"]
    assert second != first
    refusal = refused(put, small, "p1.png", POINTS, first)
    assert refusal.status == 409
    assert refusal.details["current"]["points"] == moved
    assert refusal.details["current"]["revision"] == second
    assert small.marks("p1.png")["points"] == moved


def test_who_repeats_what_is_saved_is_told_so(small):
    revision = put(small, "p1.png", POINTS)["revision"]
    assert put(small, "p1.png", POINTS, None)["revision"] == revision


def test_a_file_changed_by_another_program_is_a_conflict(small):
    revision = put(small, "p1.png", POINTS)["revision"]
    write_landmarks(small.root / "p1.ljson", Landmarks([[0, 0], [1, 1], [2, 2]]))
    assert refused(put, small, "p1.png", POINTS[::-1], revision).status == 409
    (small.root / "p1.ljson").unlink()
    refusal = refused(put, small, "p1.png", POINTS, revision)
    assert refusal.details["current"]["source"] == "none"
    assert refusal.details["current"]["revision"] is None


def test_of_many_who_save_at_once_one_wins(small):
    answers = []
    start = threading.Barrier(8)

    def save(i):
        start.wait()
        try:
            answers.append(put(small, "p1.png", [[i, i], [1, 1], [2, 2]])["revision"])
        except Refusal as refusal:
            answers.append(refusal.status)

    threads = [threading.Thread(target=save, args=(i,)) for i in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert answers.count(409) == 7
    assert small.marks("p1.png")["revision"] in answers


def test_without_points_the_file_goes(small):
    revision = put(small, "p1.png", POINTS)["revision"]
    answer = put(small, "p1.png", [None] * 3, revision)
    assert answer["revision"] is None and answer["picture"]["state"] == "new"
    assert not (small.root / "p1.ljson").exists()


def test_a_pts_is_kept_up_with_its_invisible_points(small):
    write_landmarks(small.root / "p1.pts", Landmarks(POINTS))
    revision = small.marks("p1.png")["revision"]
    put(small, "p1.png", POINTS, revision, invisible=[0])
    assert not (small.root / "p1.ljson").exists()
    assert small.marks("p1.png")["file"] == "p1.pts"
    assert Project(small.root).marks("p1.png")["invisible"] == [0]
    revision = put(small, "p1.png", [[9.0, 9.0], *POINTS[1:]], small.marks("p1.png")["revision"])["revision"]
    np.testing.assert_array_equal(read_landmarks(small.root / "p1.pts").points[0], [9, 9])
    put(small, "p1.png", [None] * 3, revision)
    assert read_landmarks(small.root / "p1.pts").missing.all()  # a person's own file is never removed


def test_of_several_objects_in_a_picture_the_largest_is_shown(small):
    parts = "".join(f"<part name='{i}' x='{{0}}' y='{i}'/>" for i in range(3))
    boxes = "".join(f"<box width='{x}' height='1'>{parts.format(x)}</box>" for x in (4, 9, 6))
    (small.root / "all.xml").write_text(f"<dataset><image file='p1.png'>{boxes}</image></dataset>")
    assert [x for x, _ in small.marks("p1.png")["points"]] == [9, 9, 9]
    problem = "p1.png: of several objects in a picture, only the largest is shown and saved"
    assert problem in small.problems


@pytest.mark.parametrize("suffix", [".asf", ".csv", ".tem"])
def test_files_of_other_formats_count_and_are_left_alone(small, suffix):
    texts = {
        ".asf": "3\n0 0 0.025 0.1 0 1 2\n0 0 0.5 0.1 1 2 0\n0 0 0.25 0.5 2 0 1\n",
        ".csv": "x,y\n1,3\n20,3\n10,15\n",
        ".tem": "3\n1 3\n20 3\n10 15\n",
    }
    path = small.root / f"p1{suffix}"
    path.write_text(texts[suffix])
    marks = small.marks("p1.png")
    assert (marks["source"], marks["file"]) == ("file", path.name)
    np.testing.assert_allclose(np.array(marks["points"]), [[1, 3], [20, 3], [10, 15]])
    assert by_name(small)["p1.png"]["state"] == "done"
    revision = put(small, "p1.png", POINTS, marks["revision"])["revision"]
    assert load_folder(small.root)[0].landmark_file.name == "p1.ljson"
    put(small, "p1.png", [None] * 3, revision)  # the other file must not show again
    assert by_name(small)["p1.png"]["state"] == "new"
    assert path.read_text() == texts[suffix]


def test_collections_count_too(small):
    collection = {"p1.png": Landmarks(POINTS), "p10.png": Landmarks(POINTS)}
    write_collection(small.root / "all.csv", collection)
    assert states(small) == {"p1.png": "done", "p2.png": "new", "p10.png": "done", "q.jpg": "new"}
    put(small, "p1.png", POINTS[::-1], small.marks("p1.png")["revision"])
    assert {sample.name: sample.landmark_file.name for sample in load_folder(small.root)} == {
        "p1": "p1.ljson",
        "p10": "all.csv",
    }


def test_a_landmark_file_that_cannot_be_read_is_told_and_kept(small):
    (small.root / "p1.ljson").write_text('{"landmarks": ')
    (small.root / "p2.tem").write_text("3\n1 2\n")
    (small.root / "all.xml").write_text("<dataset>")
    pictures = by_name(small)
    assert pictures["p1.png"]["state"] == pictures["p2.png"]["state"] == "new"
    assert "not complete JSON" in pictures["p1.png"]["error"]
    assert "promises 3 points" in pictures["p2.png"]["error"]
    assert any("all.xml" in problem for problem in small.problems)
    put(small, "p1.png", POINTS, small.marks("p1.png")["revision"])
    (copy,) = (small.root / STATE / "kept").iterdir()
    assert copy.read_text() == '{"landmarks": '
    assert by_name(small)["p1.png"]["error"] is None


def test_a_file_of_another_number_of_points_is_told_and_kept(small):
    write_landmarks(small.root / "p1.ljson", Landmarks(np.arange(8.0).reshape(4, 2)))
    picture = by_name(small)["p1.png"]
    assert picture["state"] == "partial"
    assert "4 points where the template has 3" in picture["error"]
    put(small, "p1.png", POINTS, small.marks("p1.png")["revision"])
    (copy,) = (small.root / STATE / "kept").iterdir()
    assert len(read_landmarks(copy)) == 4


def test_points_that_make_no_sense_are_refused(small):
    for points in (
        None, 7, "abc", [], POINTS[:2], [*POINTS, [1, 2]], [[1, 2], [3, 4], [5]], [[1, 2], [3, 4], [5, "6"]],
        [[1, 2], [3, 4], [5, float("inf")]], [[1, 2], [3, 4], [5, 10**400]], [[1, 2], [3, 4], [True, 1]],
        [[1, 2], [3, 4], {"x": 1}],
    ):  # fmt: skip
        assert refused(put, small, "p1.png", points).status == 422, points
    assert not (small.root / "p1.ljson").exists()


def test_invisible_marks_that_make_no_sense_are_refused(small):
    for invisible in ([3], [-1], ["a"], [0, 0], [[0]]):
        assert refused(put, small, "p1.png", POINTS, None, invisible).status == 422
    assert refused(small.save_marks, "p1.png", [1, 2]).status == 422


def test_without_a_template_nothing_is_saved(tmp_path):
    write_image(tmp_path / "a.png", np.zeros((9, 9, 3), np.uint8))
    assert refused(put, Project(tmp_path), "a.png", []).status == 422


@pytest.fixture
def unreadable(monkeypatch):
    """Give a function after which a file cannot be read any more, from the n-th time on."""

    def make(name, after=0):
        read, counts = Path.read_bytes, [0]

        def read_bytes(path):
            counts[0] += path.name == name
            if path.name == name and counts[0] > after:
                raise PermissionError(13, "Permission denied")
            return read(path)

        monkeypatch.setattr(Path, "read_bytes", read_bytes)

    return make


def test_a_file_that_cannot_be_kept_is_not_replaced(small, unreadable):
    write_landmarks(small.root / "p1.ljson", Landmarks([[0, 0], [1, 1]]))
    revision = small.marks("p1.png")["revision"]
    unreadable("p1.ljson")
    with pytest.raises(LandmarkError, match=r"p1.ljson cannot be read \(Permission denied\)"):
        put(small, "p1.png", POINTS, revision)


def test_a_file_that_cannot_be_read_stops_a_change_of_the_template(small, unreadable):
    put(small, "p1.png", POINTS)
    small.marks("p1.png")  # reads it
    unreadable("p1.ljson")
    changed = {**TRIANGLE, "mapping": [2, 1, 0], "mirror": None}
    with pytest.raises(LiaamError, match=r"p1\.ljson"):
        small.save_template(changed)


def test_a_file_of_another_format_that_cannot_be_read_again_is_reported(small, unreadable):
    write_collection(small.root / "all.csv", {"p1.png": Landmarks(POINTS), "p2.png": Landmarks(POINTS)})
    unreadable("all.csv", after=1)
    assert states(small)["p1.png"] == "new"
    assert any("all.csv cannot be read" in line for line in small.problems)
