"""The log of who changed what, review states, and actions on several pictures."""

import io
import zipfile
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from small_projects import POINTS, TRIANGLE, by_name, proposal, put, refused, states

from liaam.io import Landmarks, read_collection, read_landmarks, write_landmarks
from liaam.studio.model_store import ModelStore, Versions, model_json
from liaam.studio.project import Project
from liaam.studio.store import StoredTable
from liaam.studio.training import choose_held_out

MOVED = [[5.0, 6.0], *POINTS[1:]]


@pytest.fixture
def placed(small):
    """Give a project with two done pictures of four."""
    for name in ("p1.png", "p2.png"):
        put(small, name, POINTS)
    return small


def act(project, did, *names, who="Ann"):
    return project.review({"pictures": list(names), "did": did, "who": who})


def entries(project):
    return [(entry["picture"], entry["did"], entry["who"]) for entry in project.store.lines("review")]


def test_a_check_holds_for_the_landmarks_that_were_checked(placed):
    answer = act(placed, "checked", "p1.png", "p10.png")
    assert answer["changed"] == ["p1.png"]
    assert answer["refused"] == {"p10.png": "not all points are placed: place them first"}
    before = placed.marks("p1.png")["revision"]
    assert by_name(Project(placed.root))["p1.png"]["checked"] == "Ann"
    put(placed, "p1.png", MOVED, before)
    assert by_name(placed)["p1.png"]["checked"] is None
    put(placed, "p1.png", POINTS, placed.marks("p1.png")["revision"])  # as by undo
    assert by_name(placed)["p1.png"]["checked"] == "Ann"
    assert act(placed, "unchecked", "p1.png", "p2.png")["refused"] == {"p2.png": "not checked"}
    assert by_name(placed)["p1.png"]["checked"] is None


def test_changes_within_minutes_are_one_entry(small, monkeypatch):
    def save(points, who):
        revision = small.marks("p1.png")["revision"]
        small.save_marks("p1.png", {"points": points, "invisible": [], "revision": revision, "who": who})

    for points in (POINTS, MOVED, POINTS):
        save(points, "Ann")
    save(MOVED, "Bob")
    save([None] * 3, "Bob")
    expected = [("p1.png", "placed", "Ann"), ("p1.png", "placed", "Bob"), ("p1.png", "cleared", "Bob")]
    assert entries(small) == expected
    assert [(entry["did"], entry["who"]) for entry in small.history("p1.png")] == [
        ("cleared", "Bob"), ("placed", "Bob"), ("placed", "Ann"),
    ]  # fmt: skip
    with small.store.transaction() as connection:
        connection.execute("DELETE FROM line")
    hour_ago = (datetime.now(UTC) - timedelta(hours=1)).isoformat()
    small.store.append("review", [{**small.history("p1.png")[-1], "time": hour_ago}])
    again = Project(small.root)
    put(again, "p1.png", POINTS)
    assert [who for *_, who in entries(again)] == ["Ann", ""]


def test_a_picture_left_out_is_not_trained_on(placed):
    act(placed, "left out", "p1.png", "q.jpg")
    assert [item.name for item in placed.annotated()] == ["p2.png"]
    assert by_name(placed)["p1.png"]["left_out"] == "Ann"
    assert act(placed, "left out", "p1.png")["changed"] == []
    act(placed, "taken in", "p1.png")
    assert [item.name for item in Project(placed.root).annotated()] == ["p1.png", "p2.png"]


def test_leaving_out_and_taking_in_make_the_model_stale(placed, head_model):
    act(placed, "left out", "p2.png")
    facts = {"source": "studio", "trained": None, "pictures": placed.overview().done}

    def stale(unread=(), **more):
        shown = model_json(ModelStore().publish(head_model, {**facts, **more}), placed.overview().done, unread)
        return shown and shown["stale"]

    assert stale() == 0
    act(placed, "taken in", "p2.png")
    assert stale() == 1
    act(placed, "left out", "p1.png")
    assert stale() == 2
    assert stale(unread=["p1.png"]) == 1
    assert stale(left_out={"p1.png": "the picture is grey"}) == 1  # the model was not trained on it either


def test_a_discarded_proposal_comes_back_by_undo_or_as_another_one(placed):
    placed.add_proposals({"p10.png": proposal()})
    assert states(placed)["p10.png"] == "proposed"
    act(placed, "discarded", "p10.png")
    again = Project(placed.root)
    assert states(again)["p10.png"] == "new" and again.marks("p10.png")["source"] == "none"
    act(again, "restored", "p10.png")
    assert states(again)["p10.png"] == "proposed"
    act(again, "discarded", "p10.png")
    again.add_proposals({"p10.png": proposal(0.02)})
    assert states(again)["p10.png"] == "proposed"
    assert act(again, "discarded", "p1.png")["refused"]


def test_accepted_proposals_are_landmarks_and_undo_makes_them_proposals_again(placed):
    placed.add_proposals({"p10.png": proposal()})
    answer = act(placed, "accepted", "p10.png", "p1.png", "q.jpg")
    assert answer["changed"] == ["p10.png"]
    assert set(answer["refused"].values()) == {"no proposed points"}
    assert answer["revisions"] == {"p10.png": placed.marks("p10.png")["revision"]}
    marks = placed.marks("p10.png")
    assert (states(placed)["p10.png"], marks["points"]) == ("done", proposal()["points"])
    assert entries(placed)[-1] == ("p10.png", "accepted", "Ann")
    act(placed, "deleted", "p10.png")
    assert states(placed)["p10.png"] == "proposed"


@pytest.mark.parametrize("suffix", [".ljson", ".pts"])
def test_deleted_landmarks_are_restored_even_by_another_studio(small, suffix):
    write_landmarks(small.root / f"p1{suffix}", Landmarks(np.array(POINTS)))
    put(small, "p1.png", MOVED, small.marks("p1.png")["revision"], invisible=[2])
    before = small.marks("p1.png")
    assert act(small, "deleted", "p1.png", "p2.png")["changed"] == ["p1.png"]
    assert states(small)["p1.png"] == "new"
    again = Project(small.root)
    answer = act(again, "undeleted", "p1.png")
    after = again.marks("p1.png")
    assert answer["revisions"] == {"p1.png": after["revision"]}
    assert (after["points"], after["invisible"]) == (before["points"], [2])
    assert "landmarks again" in act(again, "undeleted", "p1.png")["refused"]["p1.png"]


def test_deleted_landmarks_are_not_restored_once_gone_or_for_another_template(placed):
    act(placed, "deleted", "p1.png")
    placed.save_template({**TRIANGLE, "names": ["a", "b"], "contours": [], "mirror": None, "mapping": [0, 1]})
    assert "earlier template" in act(placed, "undeleted", "p1.png")["refused"]["p1.png"]
    StoredTable(placed.store, "deleted").forget()
    assert "not kept any more" in act(placed, "undeleted", "p1.png")["refused"]["p1.png"]


def test_requests_that_are_not_valid_are_refused(placed):
    for change in ({"did": "eaten"}, {"pictures": "p1.png"}, {"pictures": [7]}, {"who": 7}, {"who": "x" * 61},
                   {"who": "a\nb"}):  # fmt: skip
        assert refused(placed.review, {"pictures": ["p1.png"], "did": "checked", **change}).status == 422, change
    assert refused(placed.review, {"pictures": ["no.png"], "did": "checked"}).status == 404
    assert entries(placed)[-1][1] == "placed"


# Export ----------------------------------------------------------------------------------------------------------


def test_all_landmarks_are_exported(placed, tmp_path):
    put(placed, "q.jpg", [POINTS[0], None, POINTS[2]])
    name, data = placed.export("pts")
    assert name == f"{placed.root.name}-pts.zip"
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        assert archive.namelist() == ["p1.pts", "p2.pts", "q.pts"]
        archive.extract("q.pts", tmp_path)
    assert read_landmarks(tmp_path / "q.pts").missing.tolist() == [False, True, False]
    for kind in ("coco", "tps", "csv"):
        name, data = placed.export(kind)
        (placed.root / name).write_bytes(data)
        found = read_collection(placed.root / name)
        assert list(found) == ["p1.png", "p2.png", "q.jpg"]
        assert found["p2.png"].points == pytest.approx(np.array(POINTS))
        (placed.root / name).unlink()


def test_nothing_and_unknown_kinds_are_not_exported(small):
    assert "no picture has landmarks" in str(refused(small.export, "coco"))
    assert refused(small.export, "../x").status == 422


# Versions of the model -------------------------------------------------------------------------------------------


def test_models_are_measured_on_the_same_pictures_where_possible():
    names = [f"{i}.png" for i in range(40)]
    assert [len(choose_held_out(names[:n], [])) for n in (3, 4, 7, 8, 15, 16, 31, 32, 40)] == [
        0,
        1,
        1,
        2,
        2,
        4,
        4,
        8,
        8,
    ]
    first = choose_held_out(names[:16], [])
    assert choose_held_out(names[:31][::-1], first) == first
    assert set(first) < set(choose_held_out(names, first))
    gone = [name for name in names[:31] if name != first[0]]
    assert set(first[1:]) < set(choose_held_out(gone, first)) and first[0] not in choose_held_out(gone, first)


def test_versions_are_kept_and_compared(small):
    versions = Versions(small.store)
    facts = {
        "trained": "2026-01-01",
        "pictures": {"a": "1", "b": "2", "c": "3"},
        "left_out": {"c": "why"},
        "order": "x",
    }
    for errors in ({"a": 0.03}, {"a": 0.02, "b": 0.04}, {"b": 0.01, "a": 0.03}, {}):
        versions.add(facts, errors)
    versions.add({**facts, "order": "y"}, {"a": 0.5})
    again = Versions(Project(small.root).store)
    assert again.held_out("x") == [] and again.held_out("y") == ["a"] and again.held_out("z") == []
    shown = again.as_json("x")
    assert [version["error"] for version in shown] == pytest.approx([0.03, 0.03, 0.02])
    assert [version["same"] for version in shown] == [False, True, True]
    assert shown[0] == {"time": "2026-01-01", "pictures": 2, "error": 0.03, "held_out": 1, "failed": [], "same": False}


def test_fits_that_failed_are_named_and_not_mixed_into_the_error(small):
    versions = Versions(small.store)
    facts = {"trained": "2026-01-01", "pictures": {}, "left_out": {}, "order": "x"}
    versions.add(facts, {"a": 0.004, "b": 0.106, "c": 0.065, "d": 0.003}, ["b", "c"])
    versions.add(facts, {"a": 0.1}, ["a"])
    first, second = Versions(Project(small.root).store).as_json("x")
    assert (first["error"], first["held_out"], first["failed"]) == (pytest.approx(0.0035), 4, ["b", "c"])
    assert (second["error"], second["failed"]) == (0.1, ["a"])
