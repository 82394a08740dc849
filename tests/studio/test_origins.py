"""Where each point comes from, and which points the object lacks: what the studio stores of both, and who knows it."""

import csv
import io

import numpy as np
import pytest
from small_projects import POINTS, TRIANGLE, by_name, proposal, put, refused, states

from liaam.io import Landmarks, read_landmarks, write_landmarks
from liaam.studio.contract import ShapesQuery
from liaam.studio.fits import error_of, truth_of
from liaam.studio.origins import ORIGINS
from liaam.studio.project import Project
from liaam.studio.sets import agreement, make_set
from liaam.studio.shapes import shapes

ACCEPTED = ["accepted"] * 3


def save(project, name, points=POINTS, **more):
    data = {"points": points, "revision": project.marks(name)["revision"], **more}
    return project.save_marks(name, data)


def origins(project, name="p1.png"):
    return project.marks(name)["origins"]


def test_origins_are_stored_with_the_landmarks_and_survive_a_restart(small):
    save(small, "p1.png", origins=["moved", "accepted", "placed"])
    for project in (small, Project(small.root)):
        assert origins(project) == ["moved", "accepted", "placed"]
        assert by_name(project)["p1.png"]["unconfirmed"] == 1
    assert by_name(small)["p2.png"]["unconfirmed"] == 0
    save(small, "p1.png", origins=["moved", "confirmed", "placed"])  # the same points
    assert origins(small)[1] == "confirmed" and by_name(small)["p1.png"]["unconfirmed"] == 0


def test_a_picture_with_proposed_points_keeps_its_place_by_quality(small):
    small.add_proposals({"p1.png": proposal(), "p2.png": proposal()})
    save(small, "p1.png", origins=["moved", "proposed", "proposed"])
    assert by_name(small)["p1.png"]["quality"] == 0.9
    save(small, "p1.png", origins=["moved", "confirmed", "accepted"])
    assert by_name(small)["p1.png"]["quality"] is None


def test_only_points_of_a_person_are_truth_for_the_error_of_a_fit(small):
    save(small, "p1.png", origins=["moved", "accepted", "confirmed"])
    points = small.own_landmarks("p1.png").points
    assert np.isnan(points[1]).all() and points[[0, 2]].tolist() == [POINTS[0], POINTS[2]]
    save(small, "p1.png", origins=ACCEPTED)
    found = np.array(POINTS)
    assert error_of(found, truth_of(small.own_landmarks("p1.png"))) is None
    assert error_of(found, truth_of(small.landmarks("p1.png"))) == (0.0, 0.0)
    assert small.own_landmarks("p2.png") is None


def test_points_that_are_moved_together_stay_as_proposed(small):
    save(small, "p1.png", origins=["proposed", "proposed", "accepted"])
    revision = small.marks("p1.png")["revision"]
    moved = [[x + 1.5, y] for x, y in POINTS[:2]] + POINTS[2:]
    request = {"points": moved, "invisible": [], "revision": revision, "origins": ["proposed", "proposed", "accepted"]}
    small.save_marks("p1.png", request)
    for project in (small, Project(small.root)):
        assert origins(project) == ["proposed", "proposed", "accepted"]
        assert by_name(project)["p1.png"]["unconfirmed"] == 3


def test_a_request_without_origins_places_what_it_changes(small):
    save(small, "p1.png", origins=ACCEPTED)
    save(small, "p1.png", [[5.0, 6.0], None, POINTS[2]])
    assert origins(small) == ["placed", None, "accepted"]


def test_points_that_another_program_has_moved_count_as_placed(small):
    save(small, "p1.png", origins=ACCEPTED)
    moved = np.array(POINTS)
    moved[1] += 3
    write_landmarks(small.root / "p1.ljson", Landmarks(moved, names=("a", "b", "c")))
    assert origins(Project(small.root)) == ["accepted", "placed", "accepted"]


@pytest.mark.parametrize("suffix", [".ljson", ".pts"])
def test_points_accepted_together_are_known_as_such_also_after_they_were_deleted_and_restored(small, suffix):
    if suffix == ".pts":
        write_landmarks(small.root / "p1.pts", Landmarks(np.full((3, 2), np.nan)))
    small.add_proposals({"p1.png": proposal()})
    small.review({"pictures": ["p1.png"], "did": "accepted"})
    assert origins(small) == ACCEPTED and by_name(small)["p1.png"]["unconfirmed"] == 3
    for did in ("deleted", "undeleted"):
        small.review({"pictures": ["p1.png"], "did": did})
    assert origins(small) == ACCEPTED


def test_pictures_that_an_earlier_version_has_accepted_are_known_by_the_log(small):
    small.add_proposals({"p1.png": proposal()})
    small.review({"pictures": ["p1.png"], "did": "accepted"})
    small.store.put("origin", {"p1.png": None})
    again = Project(small.root)
    assert origins(again) == ACCEPTED and by_name(again)["p1.png"]["unconfirmed"] == 3
    save(again, "p1.png", [[5.0, 6.0], *POINTS[1:]])
    assert origins(again) == ["placed", "accepted", "accepted"]


def test_origins_go_along_when_the_points_of_the_template_change(small):
    save(small, "p1.png", origins=["moved", "accepted", "placed"])
    small.save_template({"names": ["c", "new", "b"], "mapping": [2, None, 1]})
    assert origins(small) == ["placed", None, "accepted"]


def test_origins_that_are_not_valid_are_refused(small):
    for wrong in ("placed", ["placed"], ["placed", "x", None], ["placed", {}, None], [1, 2, 3]):
        data = {"points": POINTS, "revision": None, "origins": wrong}
        assert refused(small.save_marks, "p1.png", data).status == 422, wrong
    assert set(ORIGINS) == {"placed", "moved", "confirmed", "accepted", "proposed"}


def test_the_exported_table_says_the_origin_of_each_point(small):
    save(small, "p1.png", origins=["moved", "accepted", "placed"])
    save(small, "p2.png", [POINTS[0], None, POINTS[2]], origins=["confirmed", None, "proposed"])
    rows = list(csv.DictReader(io.StringIO(small.export("csv")[1].decode())))
    assert [row["origin"] for row in rows] == ["moved", "accepted", "placed", "confirmed", "", "proposed"]


def test_points_accepted_unseen_are_no_observation(small):
    anna = small.of_set(make_set(small, {"name": "anna", "same": True})["name"])
    for name in ("p1.png", "p2.png"):
        save(small, name)
    save(anna, "p1.png", (np.array(POINTS) + 1).tolist())
    save(anna, "p2.png", (np.array(POINTS) + 1).tolist(), origins=["moved", "accepted", "moved"])
    found = agreement(small)
    assert [name for name, _ in found["pictures"]] == ["p1.png"] and found["unconfirmed"] == ["p2.png"]
    save(anna, "p1.png", (np.array(POINTS) + 1).tolist(), origins=ACCEPTED)
    assert "accepted as they were proposed" in str(refused(agreement, small))


def test_only_points_of_a_persons_own_are_truth_for_training(small):
    save(small, "p1.png", origins=["moved", "accepted", "placed"])
    (item,) = small.annotated()
    assert item.own.tolist() == [True, False, True]


# Absent points -----------------------------------------------------------------------------------------------------


def test_a_picture_is_done_without_the_points_that_its_object_lacks(small):
    save(small, "p1.png", [POINTS[0], None, POINTS[2]], absent=[1])
    put(small, "p2.png", [POINTS[0], None, POINTS[2]])
    for project in (small, Project(small.root)):
        assert (states(project)["p1.png"], states(project)["p2.png"]) == ("done", "partial")
        assert by_name(project)["p1.png"]["absent"] == 1 and project.marks("p1.png")["absent"] == [1]
        assert project.annotated() == []  # training needs three points
    assert read_landmarks(small.root / "p1.ljson").missing.tolist() == [False, True, False]
    save(small, "p1.png", POINTS)  # placed after all
    assert small.marks("p1.png")["absent"] == [] and len(small.annotated()) == 1


def test_an_accepted_proposal_has_no_absent_points(small):
    small.add_proposals({"p1.png": proposal()})
    save(small, "p1.png", [None] * 3, absent=[1])
    small.review({"pictures": ["p1.png"], "did": "accepted"})
    assert small.marks("p1.png")["points"] == [POINTS[0], None, POINTS[2]]
    assert (small.marks("p1.png")["absent"], states(small)["p1.png"]) == ([1], "done")


def test_absent_points_are_stored_before_any_is_placed_and_go_along_with_the_template(small):
    save(small, "p1.png", [None] * 3, absent=[0, 2])
    assert states(small)["p1.png"] == "new" and not (small.root / "p1.ljson").exists()
    save(small, "p1.png", [None, POINTS[1], None])
    assert states(small)["p1.png"] == "done"
    small.save_template({**TRIANGLE, "names": ["c", "b"], "contours": [], "mirror": None, "mapping": [2, 1]})
    assert (small.marks("p1.png")["absent"], states(small)["p1.png"]) == ([0], "done")
    data = {"points": [None] * 2, "revision": None, "absent": [7]}
    assert refused(small.save_marks, "p2.png", data).status == 422


def test_two_pages_keep_the_absent_points_and_confirmations_of_each_other(small):
    save(small, "p1.png", [POINTS[0], None, None], origins=["proposed", None, None])
    read = small.marks("p1.png")
    base = {"absent": read["absent"], "origins": read["origins"]}
    page = {"points": read["points"], "revision": read["revision"], "base": base}
    first = small.save_marks("p1.png", {**page, "absent": [1], "origins": read["origins"]})
    assert not first["merged"] and first["beside"] != read["beside"]
    second = small.save_marks("p1.png", {**page, "absent": [2], "origins": ["confirmed", None, None]})
    now = small.marks("p1.png")
    assert second["merged"] and now["absent"] == [1, 2] and now["origins"] == ["confirmed", None, None]
    third = small.save_marks("p1.png", {**page, "absent": [], "origins": ["proposed", None, None]})
    assert third["merged"] and small.marks("p1.png")["absent"] == [1, 2]  # it had changed nothing
    assert small.marks("p1.png")["origins"] == ["confirmed", None, None] and third["beside"] == now["beside"]
    withdrawn = {**page, "base": {"absent": [1, 2]}, "absent": [2]}
    small.save_marks("p1.png", withdrawn)
    assert small.marks("p1.png")["absent"] == [2]


def test_a_base_that_is_not_valid_is_refused_or_ignored(small):
    save(small, "p1.png")
    read = small.marks("p1.png")
    page = {"points": read["points"], "revision": read["revision"], "absent": []}
    assert refused(small.save_marks, "p1.png", {**page, "base": {"absent": [9]}}).status == 422
    for base in (None, 3, [], {"origins": 3}, {"origins": []}):
        assert not small.save_marks("p1.png", {**page, "base": base})["merged"]


def test_points_that_the_model_finds_absent_are_proposed_as_absent(small):
    found = {**proposal(), "absent": [1]}
    small.add_proposals({"p1.png": found, "p2.png": found, "p10.png": found})
    assert small.marks("p1.png")["absent"] == []  # as far as anybody has said, all objects are complete
    save(small, "q.jpg", [POINTS[0], None, POINTS[2]], absent=[1])
    marks = small.marks("p1.png")
    assert marks["absent"] == [1] and marks["points"][1] is None and marks["points"][0] == POINTS[0]
    base = {"absent": marks["absent"]}
    page = {"points": marks["points"], "revision": None, "absent": [1], "base": base}
    assert small.save_marks("p1.png", page)["picture"]["state"] == "done"
    small.review({"pictures": ["p2.png"], "did": "accepted"})
    assert small.marks("p2.png")["absent"] == [1] and by_name(small)["p2.png"]["state"] == "done"
    there = {"points": POINTS, "revision": None, "absent": [], "base": base}
    small.save_marks("p10.png", there)  # a person has found and placed it
    assert small.marks("p10.png")["absent"] == [] and small.marks("p10.png")["points"] == POINTS


@pytest.mark.parametrize(
    ("points", "more", "state"),
    [
        (POINTS, {"origins": ["moved", "proposed", "proposed"]}, "partial"),  # one point of a proposal was dragged
        ([None, *POINTS[1:]], {"origins": [None, "proposed", "proposed"], "absent": [0]}, "partial"),
        (POINTS, {"origins": ["moved", "confirmed", "proposed"]}, "partial"),
        (POINTS, {"origins": ["moved", "accepted", "accepted"]}, "done"),
        ([None, *POINTS[1:]], {"origins": [None, "placed", "confirmed"], "absent": [0]}, "done"),
    ],
)
def test_a_picture_is_done_once_a_person_said_so_of_all_points(small, points, more, state):
    save(small, "p1.png", points, **more)
    assert states(small)["p1.png"] == state == states(Project(small.root))["p1.png"]
    assert by_name(small)["p1.png"]["proposed"] == more["origins"].count("proposed")
    if state == "partial":
        assert small.annotated() == []
        refusals = small.review({"pictures": ["p1.png"], "did": "checked"})["refused"]
        assert "some points are only proposed" in refusals["p1.png"]


def test_points_that_are_only_proposed_are_not_measured(small):
    save(small, "p1.png", origins=["moved", "placed", "proposed"])
    save(small, "p2.png", origins=["proposed"] * 3)
    found = shapes(small, ShapesQuery(measures="distance:1-2 distance:1-3"))
    assert found["pictures"] == ["p1.png"]
    assert [column["values"][0] is None for column in found["columns"][:2]] == [False, True]
    save(small, "p1.png", origins=["proposed"] * 3)
    assert "accept those of a picture" in str(refused(shapes, small, ShapesQuery()))
