import json
import os
import shutil
import threading

import numpy as np
import pytest

from liaam.datasets import load_folder
from liaam.errors import ImageError
from liaam.io import Contour, Landmarks, read_landmarks, write_collection, write_image, write_landmarks
from liaam.studio.folder import STATE
from liaam.studio.project import Project
from liaam.studio.proposals import teaching_order
from liaam.studio.safety import Refusal
from liaam.studio.settings import Settings

TRIANGLE = {"names": ["a", "b", "c"], "contours": [{"indices": [0, 1, 2], "closed": True}], "mirror": [1, 0, 2]}


def by_name(project):
    return {picture["name"]: picture for picture in project.overview().pictures}


def states(project):
    return {name: picture["state"] for name, picture in by_name(project).items()}


def refused(call, *arguments):
    with pytest.raises(Refusal) as caught:
        call(*arguments)
    return caught.value


@pytest.fixture
def small(tmp_path):
    """Give a folder of four small pictures, and a template of three points."""
    folder = tmp_path / "parent" / "small"
    folder.mkdir(parents=True)
    for name in ("p1.png", "p2.png", "p10.png", "q.jpg"):
        write_image(folder / name, np.full((30, 40, 3), 90, np.uint8))
    project = Project(folder)
    project.save_template(TRIANGLE)
    return project


def put(project, name, points, revision=None, invisible=()):
    return project.save_marks(name, {"points": points, "invisible": list(invisible), "revision": revision})


POINTS = [[1.0, 2.0], [30.5, 2.25], [15.0, 20.0]]


# The listing


def test_pictures_come_in_natural_order_without_hidden_files_and_folders(small):
    (small.root / "sub").mkdir()
    write_image(small.root / "sub" / "x.png", np.zeros((9, 9, 3), np.uint8))
    write_image(small.root / ".hidden.png", np.zeros((9, 9, 3), np.uint8))
    (small.root / "notes.txt").write_text("hello")
    assert list(by_name(small)) == ["p1.png", "p2.png", "p10.png", "q.jpg"]
    assert by_name(small)["p1.png"] == {
        "name": "p1.png", "state": "new", "placed": 0, "error": None, "width": 40, "height": 30,
        "uncertainty": None, "doubtful": False, "rank": None, "tag": small.marks("p1.png")["tag"],
    }  # fmt: skip


def test_pictures_that_come_and_go_are_noticed(small):
    write_image(small.root / "new.png", np.zeros((8, 9, 3), np.uint8))
    (small.root / "p1.png").unlink()
    assert list(by_name(small)) == ["new.png", "p2.png", "p10.png", "q.jpg"]
    assert refused(small.marks, "p1.png").status == 404
    assert small.size_of("new.png") == (9, 8)


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
    project = Project(small.root, Settings(pixels=1000))
    assert "40 x 30 pixels, more than the 1,000 allowed" in by_name(project)["p1.png"]["error"]


def test_sizes_are_upright(small):
    from PIL import Image

    exif = Image.Exif()
    exif[0x0112] = 6
    Image.new("RGB", (50, 20)).save(small.root / "turned.jpg", exif=exif)
    assert small.size_of("turned.jpg") == (20, 50)


def test_folders_that_cannot_be_used_are_refused(tmp_path, monkeypatch):
    with pytest.raises(ImageError, match="does not exist"):
        Project(tmp_path / "missing")
    (tmp_path / "file").touch()
    with pytest.raises(ImageError, match="is a file, not a folder"):
        Project(tmp_path / "file")
    monkeypatch.setattr(os, "access", lambda *_: False)
    with pytest.raises(ImageError, match="cannot be written to"):
        Project(tmp_path)


def test_an_empty_folder_is_fine(tmp_path):
    project = Project(tmp_path)
    assert project.overview().pictures == [] and project.template is None and project.problems == []
    assert list(tmp_path.iterdir()) == []  # looking leaves nothing behind


# Landmarks


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


@pytest.mark.parametrize(
    "points",
    [
        None, 7, "abc", [], POINTS[:2], [*POINTS, [1, 2]], [[1, 2], [3, 4], [5]], [[1, 2], [3, 4], [5, "6"]],
        [[1, 2], [3, 4], [5, float("inf")]], [[1, 2], [3, 4], [5, 10**400]], [[1, 2], [3, 4], [True, 1]],
        [[1, 2], [3, 4], {"x": 1}],
    ],
)  # fmt: skip
def test_points_that_make_no_sense_are_refused(small, points):
    assert refused(put, small, "p1.png", points).status == 422
    assert not (small.root / "p1.ljson").exists()


def test_invisible_marks_that_make_no_sense_are_refused(small):
    for invisible in ([3], [-1], ["a"], [0, 0], [[0]]):
        assert refused(put, small, "p1.png", POINTS, None, invisible).status == 422
    assert refused(small.save_marks, "p1.png", [1, 2]).status == 422


def test_without_a_template_nothing_is_saved(tmp_path):
    write_image(tmp_path / "a.png", np.zeros((9, 9, 3), np.uint8))
    assert refused(put, Project(tmp_path), "a.png", []).status == 422


# The template


def test_the_template_comes_from_the_first_landmark_file(small):
    shutil.rmtree(small.root / STATE)
    names = ("left_eye", "right_eye", "nose")
    write_landmarks(small.root / "p2.ljson", Landmarks(POINTS, (Contour((0, 1, 2)),), names))
    project = Project(small.root)
    assert project.template.as_json() == {
        "names": list(names),
        "contours": [{"indices": [0, 1, 2], "closed": False}],
        "mirror": [1, 0, 2],
        "points": POINTS,
    }
    assert states(project)["p2.png"] == "done"
    assert not (small.root / STATE).exists()
    file = small.root / "p2.ljson"
    file.rename(small.root / "p2.away")
    assert not project.overview().pictures[1]["placed"] and project.template is None
    (small.root / "p2.away").rename(file)
    assert project.overview().pictures[1]["placed"] and project.template.names == names
    put(project, "p1.png", POINTS)
    assert json.loads((small.root / STATE / "template.json").read_text())["names"] == list(names)


def test_changing_the_template_rewrites_all_files(small):
    put(small, "p1.png", POINTS, invisible=[0])
    put(small, "p2.png", [[7, 8], None, [9, 9]])
    (small.root / "p10.tem").write_text("3\n1 3\n20 3\n10 15\n")
    template, moved = small.save_template({"names": ["c", "new", "a"], "mapping": [2, None, 0]})
    assert moved and template.names == ("c", "new", "a")
    for project in (small, Project(small.root)):
        assert project.marks("p1.png")["points"] == [POINTS[2], None, POINTS[0]]
        assert project.marks("p1.png")["invisible"] == [2]
        assert project.marks("p2.png")["points"] == [[9, 9], None, [7, 8]]
        assert project.marks("p10.png")["points"] == [[10, 15], None, [1, 3]]
        assert project.marks("p10.png")["file"] == "p10.ljson"
        assert states(project) == {"p1.png": "partial", "p2.png": "partial", "p10.png": "partial", "q.jpg": "new"}
    assert not (small.root / STATE / "change.json").exists()


def test_new_names_and_contours_reach_the_files_and_keep_the_model(small):
    put(small, "p1.png", POINTS)
    _, moved = small.save_template({"names": ["x", "y", "z"], "contours": [{"indices": [0, 2], "closed": False}]})
    assert not moved
    landmarks = read_landmarks(small.root / "p1.ljson")
    assert landmarks.names == ("x", "y", "z") and landmarks.contours == (Contour((0, 2)),)


def test_a_kill_in_the_middle_of_a_change_loses_nothing(small, monkeypatch):
    for name in ("p1.png", "p2.png", "p10.png"):
        put(small, name, POINTS)
    write = small.state.write

    def die_at_the_template(name, content):
        if name == "template.json":
            raise KeyboardInterrupt
        write(name, content)

    monkeypatch.setattr(small.state, "write", die_at_the_template)
    with pytest.raises(KeyboardInterrupt):
        small.save_template({"names": ["c", "a"], "mapping": [2, 0]})
    # As if only the first file had been written, and somebody had changed the third since.
    old = Landmarks(POINTS, (Contour((0, 1, 2), closed=True),), ("a", "b", "c"))
    write_landmarks(small.root / "p2.ljson", old)
    write_landmarks(small.root / "p10.ljson", Landmarks([[0, 0], [0, 1], [0, 2]]))
    project = Project(small.root)
    assert project.template.names == ("c", "a")
    assert project.marks("p1.png")["points"] == project.marks("p2.png")["points"] == [POINTS[2], POINTS[0]]
    assert len(project.marks("p10.png")["points"]) == 3
    assert "3 points where the template has 2" in by_name(project)["p10.png"]["error"]
    assert not (small.root / STATE / "change.json").exists()


@pytest.mark.parametrize(
    "change",
    [
        {"names": []}, {"names": ["a", "a"]}, {"names": ["a", ""]}, {"names": "abc"}, {"names": ["\ud800"]},
        {"names": ["x" * 101]}, {"names": ["a"] * 1001}, {"names": None},
        {"contours": 3}, {"contours": [{"indices": [0, 7], "closed": True}]},
        {"contours": [{"indices": [0], "closed": True}]},
        {"contours": [{"indices": [0, 1], "closed": 1}]}, {"mirror": [1, 2, 0]}, {"mirror": [0, 1]},
        {"mirror": [0, 0, 0]},
        {"points": [[1, 2]]}, {"points": [[1, 2], None, [3, 4]]}, {"mapping": [0, 0, 1]}, {"mapping": [0, 1, 3]},
        {"mapping": "abc"}, {"mapping": [0, 1]},
    ],
)  # fmt: skip
def test_templates_that_make_no_sense_are_refused(small, change):
    put(small, "p1.png", POINTS)
    assert refused(small.save_template, {**TRIANGLE, **change}).status == 422
    assert small.template.names == ("a", "b", "c")


def test_the_number_of_points_does_not_change_unsaid(small):
    small.save_template({"names": ["a", "b", "c", "d"]})
    put(small, "p1.png", [*POINTS, [1, 1]])
    assert "send a mapping" in str(refused(small.save_template, TRIANGLE))


def test_a_template_is_read_from_any_landmark_file(small):
    template = small.read_template("../x.tem", b"3\n1 3\n20 3\n10 15\n")
    assert len(template) == 3 and template.points == ((1, 3), (20, 3), (10, 15))
    xml = "<dataset><images><image file='a.png'><box><part name='left' x='1' y='2'/><part name='right' x='3' y='2'/>"
    template = small.read_template("all.xml", f"{xml}</box></image></images></dataset>".encode())
    assert template.names == ("left", "right") and template.mirror == (1, 0)


# Proposals


def proposal(uncertainty=0.01, *, points=POINTS, ok=True, found=True, message="The fit settled."):
    return {
        "points": points, "covariances": [[[1, 0], [0, 1]]] * 3, "quality": 0.9, "status": "converged", "ok": ok,
        "message": message, "found": found, "doubtful": not (ok and found), "uncertainty": uncertainty,
    }  # fmt: skip


def test_proposals_are_shown_until_there_are_landmarks(small):
    small.add_proposals({"p1.png": proposal(0.02), "p2.png": proposal(0.03)})
    for project in (small, Project(small.root)):
        assert states(project)["p1.png"] == "proposed"
        assert {name: picture["rank"] for name, picture in by_name(project).items()} == {
            "p1.png": 2, "p2.png": 1, "p10.png": None, "q.jpg": None,
        }  # fmt: skip
        marks = project.marks("p1.png")
        assert (marks["source"], marks["points"], marks["revision"]) == ("proposal", POINTS, None)
        assert marks["quality"] == 0.9
    put(small, "p1.png", POINTS)  # taken as it is
    assert small.marks("p1.png")["source"] == "file"
    assert by_name(small)["p1.png"]["uncertainty"] is None
    assert by_name(small)["p2.png"]["rank"] == 1


def test_a_picture_that_cannot_be_fitted_says_why(small):
    small.add_proposals({"p1.png": proposal(None, points=None, message="p1.png is grey")})
    assert by_name(small)["p1.png"]["state"] == "new"
    assert by_name(small)["p1.png"]["error"] == "p1.png is grey"


def test_proposals_of_another_template_are_dropped(small):
    small.add_proposals({"p1.png": proposal()})
    small.save_template({**TRIANGLE, "mapping": [1, 0, 2], "revision": small.template_json()["revision"]})
    assert states(small)["p1.png"] == "new"


def test_of_a_large_folder_some_pictures_are_proposed_at_a_time(small):
    def names(most):
        return [name for name, _ in small.to_propose(most)]

    assert names(100) == ["p1.png", "p2.png", "p10.png", "q.jpg"]
    assert names(2) == ["p1.png", "p2.png"]
    small.add_proposals({"p1.png": proposal(0.02), "p2.png": proposal(0.03), "p10.png": proposal(0.01)})
    assert names(2) == ["p2.png", "q.jpg"]
    assert names(100) == ["p2.png", "p1.png", "p10.png", "q.jpg"]
    put(small, "p2.png", POINTS)
    assert names(3) == ["p1.png", "p10.png", "q.jpg"]
    (small.root / "q.jpg").write_bytes(b"rubbish")
    assert names(3) == ["p1.png", "p10.png"]


def test_the_order_in_which_pictures_teach():
    order = teaching_order(
        {
            "sure": proposal(0.01),
            "unsure": proposal(0.05),
            "not there": proposal(0.2, found=False, ok=False),
            "failed": proposal(0.02, ok=False),
            "diverged": proposal(None, ok=False),
        }
    )
    assert order == ["failed", "diverged", "unsure", "sure", "not there"]


# The studio's own files, and links


@pytest.mark.parametrize("content", [b"", b"{", b"[]", b"7", b'{"a": 1}', b"\xff\xfe", b"[" * 100_000])
@pytest.mark.parametrize("name", ["template.json", "proposals.json", "invisible.json", "change.json"])
def test_damaged_files_are_told_and_passed_over(small, name, content):
    put(small, "p1.png", POINTS)
    (small.root / STATE / name).write_bytes(content)
    project = Project(small.root)
    assert states(project)["p1.png"] == "done"
    assert any(f"{STATE}/{name}" in problem for problem in project.problems)


def test_numbers_that_no_page_could_read_are_damage(small):
    for number in ("NaN", "1e999"):
        text = json.dumps({"p1.png": proposal()}).replace("0.01", number)
        (small.root / STATE / "proposals.json").write_text(text)
        project = Project(small.root)
        assert states(project)["p1.png"] == "new" and project.problems


@pytest.mark.parametrize("name", ["../evil.ljson", "/tmp/evil.ljson", "p1.png", "sub/x.pts", 7])
def test_a_change_writes_landmark_files_of_the_folder_only(small, name):
    item = {"file": name, "before": None, "text": "evil", "invisible": []}
    (small.root / STATE / "change.json").write_text(json.dumps({"template": TRIANGLE, "files": [item]}))
    before = (small.root / "p1.png").read_bytes()
    assert any("change.json" in problem for problem in Project(small.root).problems)
    assert (small.root / "p1.png").read_bytes() == before
    assert not list(small.root.parent.glob("**/evil*"))


def test_links_that_lead_out_do_not_exist(small, tmp_path):
    outside = tmp_path / "outside"
    outside.mkdir()
    write_image(outside / "secret.png", np.zeros((9, 9, 3), np.uint8))
    write_landmarks(outside / "secret.ljson", Landmarks(POINTS))
    before = (outside / "secret.ljson").read_bytes()
    (small.root / "link.png").symlink_to(outside / "secret.png")
    (small.root / "p1.ljson").symlink_to(outside / "secret.ljson")
    (small.root / "p2.ljson").symlink_to(outside / "new.ljson")
    assert "link.png" not in by_name(small)
    assert refused(small.path_of, "link.png").status == 404
    assert states(small)["p1.png"] == "new"
    for name in ("p1.png", "p2.png"):
        assert refused(put, small, name, POINTS).status == 409
    assert sorted(path.name for path in outside.iterdir()) == ["secret.ljson", "secret.png"]
    assert (outside / "secret.ljson").read_bytes() == before


def test_links_that_stay_inside_work(small):
    (small.root / "alias.png").symlink_to("p1.png")
    put(small, "alias.png", POINTS)
    assert (small.root / "alias.ljson").is_file()


def test_a_state_folder_that_leads_out_is_not_used(small, tmp_path):
    shutil.rmtree(small.root / STATE)
    outside = tmp_path / "outside"
    outside.mkdir()
    (outside / "template.json").write_text(json.dumps(TRIANGLE))
    (small.root / STATE).symlink_to(outside)
    project = Project(small.root)
    assert project.template is None
    assert any("remove it" in problem for problem in project.problems)
    assert refused(project.save_template, TRIANGLE).status == 409
    assert refused(project.state.path, "model.liaam").status == 409
    assert [path.name for path in outside.iterdir()] == ["template.json"]


def test_a_state_file_that_leads_out_is_not_used(small, tmp_path):
    outside = tmp_path / "outside.json"
    outside.write_text(json.dumps(TRIANGLE))
    (small.root / STATE / "template.json").unlink()
    (small.root / STATE / "template.json").symlink_to(outside)
    project = Project(small.root)
    assert project.template is None and project.problems
    assert refused(project.save_template, {**TRIANGLE, "names": ["x", "y", "z"]}).status == 409
    assert json.loads(outside.read_text()) == TRIANGLE


@pytest.mark.parametrize(
    "name", ["../x.png", "..", ".", "", "/etc/passwd", "p1.png/", "p1.ljson", "P1.PNG\0", "a" * 5000]
)
def test_names_that_are_not_of_the_listing_are_no_pictures(small, name):
    assert refused(small.path_of, name).status == 404


def test_names_that_no_answer_can_hold_are_passed_over(small):
    try:
        (small.root / os.fsdecode(b"bad\xff.png")).write_bytes((small.root / "p1.png").read_bytes())
    except OSError:
        pytest.skip("this file system takes no such names")
    assert json.dumps(small.overview().pictures, ensure_ascii=False).encode()
