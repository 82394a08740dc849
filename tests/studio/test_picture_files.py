"""Removing and renaming pictures: everything that belongs to them goes along, and comes back."""

import pytest
from small_projects import POINTS, by_name, proposal, put, refused, states

from liaam.io import Landmarks, write_collection
from liaam.studio.contract import ShapesQuery
from liaam.studio.picture_files import remove, rename, restore
from liaam.studio.project import Project
from liaam.studio.sets import make_set
from liaam.studio.shapes import save_groups, shapes


@pytest.fixture
def two(small) -> Project:
    """Give a folder with landmarks of one picture in two sets, and what else is kept of it."""
    put(small, "p1.png", POINTS, invisible=[1])
    small.review({"pictures": ["p1.png"], "did": "checked", "who": "Ada"})
    small.add_proposals({"p2.png": proposal()})
    anna = small.of_set(make_set(small, {"name": "anna", "same": True})["name"])
    anna.save_marks("p1.png", {"points": POINTS, "revision": None, "origins": ["accepted"] * 3})
    return small


def facts(project, name):
    picture = by_name(project)[name]
    return picture["state"], picture["checked"], picture["unconfirmed"]


def test_removed_pictures_come_back_with_all_that_belongs_to_them(two):
    before = {path.relative_to(two.root): path.read_bytes() for path in two.root.rglob("p*.*")}
    known = [facts(two, "p1.png"), facts(two.of_set("anna"), "p1.png")]
    token = remove(two, {"pictures": ["p1.png", "p2.png"]})["token"]
    assert set(states(two)) == {"p10.png", "q.jpg"} and not list((two.root / "anna").iterdir())
    assert not two.problems
    two.store.close()
    again = Project(two.root)  # also after the studio was started again
    assert restore(again, {"token": token})["pictures"] == ["p1.png", "p2.png"]
    assert {path.relative_to(two.root): path.read_bytes() for path in two.root.rglob("p*.*")} == before
    assert [facts(again, "p1.png"), facts(again.of_set("anna"), "p1.png")] == known
    assert states(again)["p2.png"] == "proposed"
    assert refused(restore, again, {"token": token}).status == 404


def test_what_was_said_of_a_removed_picture_does_not_count_for_a_later_one_of_the_same_name(two):
    two.save_sides({"sides": {"p1.png": "left"}})
    two.review({"pictures": ["p1.png"], "did": "left out", "who": "Ada"})
    two.save_marks("p2.png", {"points": [*POINTS[:2], None], "absent": [2], "revision": None})
    said = [by_name(two)["p1.png"], two.history("p1.png"), two.marks("p2.png")["absent"]]
    other = (two.root / "q.jpg").read_bytes()
    token = remove(two, {"pictures": ["p1.png", "p2.png"]})["token"]
    for name in ("p1.png", "p2.png"):
        (two.root / name).write_bytes(other)
    for project in (two, Project(two.root)):
        later = by_name(project)["p1.png"]
        assert (later["side"], later["left_out"], project.history("p1.png")) == ("", None, [])
        assert project.marks("p2.png")["absent"] == []
    again = remove(two, {"pictures": ["p1.png", "p2.png"]})["token"]
    restore(two, {"token": token})
    assert [by_name(two)["p1.png"], two.history("p1.png"), two.marks("p2.png")["absent"]] == said
    remove(two, {"pictures": ["p1.png", "p2.png"]})
    restore(two, {"token": again})
    assert by_name(two)["p1.png"]["side"] == ""


def test_a_picture_is_not_restored_over_another_one(two):
    token = remove(two, {"pictures": ["p1.png"]})["token"]
    (two.root / "p1.png").write_bytes((two.root / "p2.png").read_bytes())
    fault = refused(restore, two, {"token": token})
    assert fault.status == 409 and "other files of these names: p1.png" in str(fault)
    (two.root / "p1.png").unlink()
    restore(two, {"token": token})
    assert two.marks("p1.png")["points"] == POINTS


def test_a_renamed_picture_keeps_its_landmarks_history_and_origins_in_all_sets(two):
    known = [facts(two, "p1.png"), facts(two.of_set("anna"), "p1.png")]
    assert rename(two, {"picture": "p1.png", "to": "wing 7"}) == {"before": "p1.png", "name": "wing 7.png"}
    two.store.close()
    for project in (two, Project(two.root)):
        assert [facts(project, "wing 7.png"), facts(project.of_set("anna"), "wing 7.png")] == known
        assert [entry["did"] for entry in project.history("wing 7.png")] == ["checked", "placed"]
        assert project.marks("wing 7.png")["invisible"] == [1]
        assert project.of_set("anna").marks("wing 7.png")["origins"] == ["accepted"] * 3
    assert not list(two.root.glob("p1.*")) and not two.problems
    rename(two, {"picture": "wing 7.png", "to": "p1"})
    assert facts(two, "p1.png") == known[0]


def test_landmarks_in_a_file_of_all_pictures_go_along(tmp_path, small):
    for path in small.root.glob("*.ljson"):
        path.unlink()
    write_collection(small.root / "all.csv", {"p2.png": Landmarks(POINTS)}, {"p2.png": (30, 40)})
    project = Project(small.root)
    assert project.marks("p2.png")["points"] == POINTS
    rename(project, {"picture": "p2.png", "to": "z"})
    assert project.marks("z.png")["points"] == POINTS


@pytest.mark.parametrize("to", ["p2", "P2.PNG/../x", ".hidden", "", "a/b", "q"])
def test_names_that_cannot_be_given_are_refused(two, to):
    before = sorted(path.name for path in two.root.iterdir())
    assert refused(rename, two, {"picture": "p1.png", "to": to}).status in (409, 422)
    assert sorted(path.name for path in two.root.iterdir()) == before


def test_wrong_requests_are_refused(two):
    for data in ({}, {"pictures": []}, {"pictures": "p1.png"}, {"pictures": [1]}):
        assert refused(remove, two, data).status == 422
    assert refused(remove, two, {"pictures": ["../x.png"]}).status == 404
    for data in ({"token": "x"}, {"token": 1}, {}):
        assert refused(restore, two, data).status == 404


def test_a_renamed_picture_stays_in_its_group(two):
    put(two, "p2.png", POINTS)
    save_groups(two, {"text": "specimen,group\np1,x\np2.png,y\n", "name": "groups.csv"})
    rename(two, {"picture": "p1.png", "to": "lisa"})
    rename(two, {"picture": "p2.png", "to": "fly five"})
    found = shapes(two, ShapesQuery(by="table"))
    assert dict(zip(found["pictures"], found["groups"], strict=True)) == {"lisa.png": "x", "fly five.png": "y"}
    token = remove(two, {"pictures": ["lisa.png"]})["token"]
    restore(two, {"token": token})
    assert shapes(two, ShapesQuery(by="table"))["groups"] == found["groups"]
