"""The template of a project, and what its changes do to landmark files."""

import shutil

import pytest
from small_projects import POINTS, TRIANGLE, by_name, put, refused, states

from liaam.io import Contour, Landmarks, read_landmarks, write_landmarks
from liaam.studio.folder import STATE
from liaam.studio.project import Project


def test_the_template_comes_from_the_first_landmark_file(small):
    shutil.rmtree(small.root / STATE)
    names = ("left_eye", "right_eye", "nose")
    write_landmarks(small.root / "p2.ljson", Landmarks(POINTS, (Contour((0, 1, 2)),), names))
    project = Project(small.root)
    assert project.templates.current.as_json() == {
        "names": list(names),
        "contours": [{"indices": [0, 1, 2], "closed": False}],
        "mirror": [1, 0, 2],
        "points": POINTS,
        "kinds": ["landmark", "semilandmark", "landmark"],
    }
    assert states(project)["p2.png"] == "done"
    assert not (small.root / STATE).exists()
    file = small.root / "p2.ljson"
    file.rename(small.root / "p2.away")
    assert not project.overview().pictures[1]["placed"] and project.templates.current is None
    (small.root / "p2.away").rename(file)
    assert project.overview().pictures[1]["placed"] and project.templates.current.names == names
    put(project, "p1.png", POINTS)
    assert project.store.get("template")["names"] == list(names)


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
    assert project.store.get("change") is None


def test_new_names_and_contours_reach_the_files_and_keep_the_model(small):
    put(small, "p1.png", POINTS)
    _, moved = small.save_template({"names": ["x", "y", "z"], "contours": [{"indices": [0, 2], "closed": False}]})
    assert not moved
    landmarks = read_landmarks(small.root / "p1.ljson")
    assert landmarks.names == ("x", "y", "z") and landmarks.contours == (Contour((0, 2)),)


def test_a_kill_in_the_middle_of_a_change_loses_nothing(small, monkeypatch):
    for name in ("p1.png", "p2.png", "p10.png"):
        put(small, name, POINTS)
    put_away = small.store.put

    def die_at_the_template(kind, values):
        if kind == "template":
            raise KeyboardInterrupt
        put_away(kind, values)

    monkeypatch.setattr(small.store, "put", die_at_the_template)
    with pytest.raises(KeyboardInterrupt):
        small.save_template({"names": ["c", "a"], "mapping": [2, 0]})
    # As if only the first file had been written, and somebody had changed the third since.
    old = Landmarks(POINTS, (Contour((0, 1, 2), closed=True),), ("a", "b", "c"))
    write_landmarks(small.root / "p2.ljson", old)
    write_landmarks(small.root / "p10.ljson", Landmarks([[0, 0], [0, 1], [0, 2]]))
    project = Project(small.root)
    assert project.templates.current.names == ("c", "a")
    assert project.marks("p1.png")["points"] == project.marks("p2.png")["points"] == [POINTS[2], POINTS[0]]
    assert len(project.marks("p10.png")["points"]) == 3
    assert "3 points where the template has 2" in by_name(project)["p10.png"]["error"]
    assert project.store.get("change") is None


def test_templates_that_make_no_sense_are_refused(small):
    put(small, "p1.png", POINTS)
    for change in (
        {"names": []}, {"names": ["a", "a"]}, {"names": ["a", ""]}, {"names": "abc"}, {"names": ["\ud800"]},
        {"names": ["x" * 101]}, {"names": ["a"] * 1001}, {"names": None},
        {"contours": 3}, {"contours": [{"indices": [0, 7], "closed": True}]},
        {"contours": [{"indices": [0], "closed": True}]},
        {"contours": [{"indices": [0, 1], "closed": 1}]}, {"mirror": [1, 2, 0]}, {"mirror": [0, 1]},
        {"mirror": [0, 0, 0]},
        {"points": [[1, 2]]}, {"points": [[1, 2], None, [3, 4]]}, {"mapping": [0, 0, 1]}, {"mapping": [0, 1, 3]},
        {"mapping": "abc"}, {"mapping": [0, 1]},
    ):  # fmt: skip
        assert refused(small.save_template, {**TRIANGLE, **change}).status == 422, change
        assert small.templates.current.names == ("a", "b", "c")


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
