"""What must not cost a person work: a full disk, a second page, a second studio, a picture that was replaced."""

import errno
import os
import shutil
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from small_projects import POINTS, by_name, proposal, refused

from liaam.errors import LiaamError
from liaam.io import Landmarks, atomic, read_landmarks, write_image, write_landmarks
from liaam.studio import folder as project_folder, landmark_files
from liaam.studio.app import Studio
from liaam.studio.folder import STATE, Listing
from liaam.studio.project import Project
from liaam.studio.refusal import Refusal
from liaam.studio.settings import StudioSettings
from liaam.studio.store import Store

NAMES = {"names": ["a", "b", "c"]}
TURNED = {"names": ["c", "a", "b"], "mapping": [2, 0, 1]}
MOVED = [POINTS[2], POINTS[0], POINTS[1]]


def put(project, name, points, **more):
    return project.save_marks(name, {"points": points, "invisible": [], "revision": None, **more})


@pytest.fixture
def small(tmp_path):
    """Give a folder of three small pictures with landmarks, and a template of three points."""
    folder = tmp_path / "parent" / "small"
    folder.mkdir(parents=True)
    project = Project(folder)
    for name in ("p1.png", "p2.png", "p3.png"):
        write_image(folder / name, np.full((30, 40, 3), 90, np.uint8))
    project.save_template(NAMES)
    for name in ("p1.png", "p2.png", "p3.png"):
        put(project, name, POINTS)
    return project


@pytest.fixture
def disk(monkeypatch):
    """Give a disk that refuses to write files whose names, or entries of the store whose kinds, are in the set."""
    full: set[str] = set()

    def write(path, data, error=LiaamError):
        if path.name in full:
            fault = OSError(errno.ENOSPC, "No space left on device")
            raise error(f"{path} cannot be written ({fault.strerror}): check the free space.") from fault
        real(path, data, error)

    def put(store, kind, values):
        if kind in full:
            raise Refusal(507, "studio.db cannot be written: make room")
        real_put(store, kind, values)

    real, real_put = landmark_files.write_bytes_atomically, Store.put
    monkeypatch.setattr(landmark_files, "write_bytes_atomically", write)
    monkeypatch.setattr(Store, "put", put)
    monkeypatch.setattr(
        landmark_files, "write_text_atomically", lambda path, text, error: write(path, text.encode(), error)
    )
    return full


# A change of the template


@pytest.mark.parametrize("file", ["p1.ljson", "p2.ljson", "p3.ljson", "template"])
def test_a_change_that_fails_half_way_is_finished_and_not_done_twice(small, disk, file):
    change = {**TURNED, "revision": small.templates.as_json()["revision"]}
    disk.add(file)
    refusal = refused(small.save_template, change)
    assert refusal.status == 507 and str(small.root) not in str(refusal)
    for call in (
        lambda: small.marks("p1.png"),
        lambda: put(small, "p1.png", POINTS),
        small.annotated,
        lambda: small.save_template(change),
    ):
        assert refused(call).status == 507
    by_name(small)  # can still be looked at
    assert any("cannot be finished yet" in problem for problem in small.problems)
    disk.clear()
    assert small.save_template(change)[0].names == ("c", "a", "b")  # what the page does: once more
    for project in (small, Project(small.root)):
        assert project.templates.current.names == ("c", "a", "b")
        assert all(project.marks(f"p{i}.png")["points"] == MOVED for i in (1, 2, 3))
        assert project.problems == []


def test_a_change_that_fails_is_finished_by_whatever_comes_next(small, disk):
    disk.add("p2.ljson")
    refused(small.save_template, TURNED)
    disk.clear()
    stamp = small.stamp
    assert [item.points.tolist() for item in small.annotated()] == [MOVED] * 3
    assert small.templates.current.names == ("c", "a", "b") and stamp == small.stamp


def test_a_start_with_a_full_disk_waits_for_space(small, disk):
    disk.add("p2.ljson")
    refused(small.save_template, TURNED)
    project = Project(small.root)
    assert refused(put, project, "p1.png", POINTS).status == 507
    disk.clear()
    assert put(project, "p1.png", MOVED)["picture"]["state"] == "done"


def test_nothing_changes_if_a_change_cannot_even_be_written_down(small, disk):
    disk.add("change")
    with pytest.raises(LiaamError):
        small.save_template(TURNED)
    assert small.marks("p1.png")["points"] == POINTS and small.templates.current.names == ("a", "b", "c")


def test_a_finished_change_keeps_the_invisible_marks_of_other_files(small, disk):
    write_image(small.root / "q.png", np.full((30, 40, 3), 90, np.uint8))
    write_landmarks(small.root / "q.pts", Landmarks(POINTS))
    small.save_marks("q.png", {"points": POINTS, "invisible": [1], "revision": small.marks("q.png")["revision"]})
    disk.add("p3.ljson")
    refused(small.save_template, {**NAMES, "mapping": [0, 2, 1], "revision": small.templates.as_json()["revision"]})
    disk.clear()
    assert Project(small.root).marks("q.png")["invisible"] == [2]


# Which template a change is for


def test_a_change_that_comes_twice_is_done_once(small):
    for change in (TURNED, {**TURNED, "revision": small.templates.as_json()["revision"]}):
        for _ in range(2):
            template, _ = small.save_template(change)
            assert template.names == ("c", "a", "b")
            assert small.marks("p1.png")["points"] == MOVED


def test_a_change_made_for_another_template_is_refused(small):
    old = small.templates.as_json()["revision"]
    small.save_template(TURNED)
    refusal = refused(small.save_template, {"names": ["a", "c"], "mapping": [0, 2], "revision": old})
    assert refusal.status == 409 and refusal.details["template"] == small.templates.as_json()
    assert refused(small.save_template, {**NAMES, "revision": None}).status == 409
    assert small.marks("p1.png")["points"] == MOVED


def test_the_first_template_is_made_for_none(tmp_path):
    project = Project(tmp_path)
    assert refused(project.save_template, {**NAMES, "revision": "another"}).details["template"] is None
    assert project.save_template({**NAMES, "revision": None})[0].names == ("a", "b", "c")


def test_marks_of_another_template_are_refused(small):
    write_image(small.root / "new.png", np.full((30, 40, 3), 90, np.uint8))
    old = small.templates.as_json()["revision"]
    small.save_template(TURNED)
    refusal = refused(lambda: put(small, "new.png", POINTS, template=old))
    assert refusal.status == 409 and refusal.details == {"template": small.templates.as_json()}
    assert not (small.root / "new.ljson").exists()
    assert put(small, "new.png", MOVED, template=small.templates.as_json()["revision"])["picture"]["state"] == "done"


def test_a_template_taken_from_a_file_has_the_same_revision_once_it_is_saved(small):
    shutil.rmtree(small.root / STATE)
    project = Project(small.root)
    revision = project.templates.as_json()["revision"]
    put(project, "p1.png", POINTS[::-1], template=revision, revision=project.marks("p1.png")["revision"])
    assert project.templates.as_json()["revision"] == Project(small.root).templates.as_json()["revision"] == revision


def test_proposals_for_points_of_another_order_are_dropped(small):
    write_image(small.root / "new.png", np.full((30, 40, 3), 90, np.uint8))
    order = small.templates.order
    small.save_template(TURNED)
    small.overview()
    small.add_proposals({"new.png": proposal()}, order)
    assert by_name(small)["new.png"]["state"] == "new"
    small.add_proposals({"new.png": proposal()}, small.templates.order)
    assert by_name(small)["new.png"]["state"] == "proposed"


# Folders


def test_a_folder_keeps_its_id_and_a_copy_has_another(small):
    known = small.store.id
    assert Project(small.root).store.id == known
    moved = small.root.rename(small.root.with_name("moved"))
    assert Project(moved).store.id == known
    shutil.copytree(moved, moved.with_name("copy"))
    assert Project(moved.with_name("copy")).store.id != known


def test_a_second_studio_on_a_folder_is_refused(small):
    first = Studio(small.root, settings=StudioSettings(port=8123))
    try:
        with pytest.raises(LiaamError, match="open in another studio") as caught:
            Studio(small.root)
        assert f"(http://127.0.0.1:8123/, process {os.getpid()})" in str(caught.value)
        assert first.settings.token not in str(caught.value) + (small.root / STATE / "lock").read_text()
    finally:
        first.close()
    Studio(small.root).close()


def test_a_studio_that_could_not_start_leaves_the_folder_free(small, tmp_path):
    (tmp_path / "m.liaam").write_bytes(b"rubbish")
    with pytest.raises(LiaamError):
        Studio(small.root, tmp_path / "m.liaam")
    Studio(small.root).close()


def test_what_a_killed_process_left_is_swept(small):
    name = f".liaam-{atomic._HOST}-999999999-{'0' * 16}"  # no process has such a number
    left = [small.root / STATE / f"{name}.liaam", small.root / STATE / f"{name}.json", small.root / f"{name}.ljson"]
    own = [small.root / ".liaam-mine.png", small.root / STATE / ".liaam-mine.json"]
    for path in (*left, *own):
        path.touch()
    with atomic.atomic_path(small.root / "x.csv") as being_written:
        Studio(small.root).close()
        assert being_written.exists()
    assert not any(path.exists() for path in left) and all(path.exists() for path in own)


@pytest.mark.parametrize("after", ["invisible", "p4.pts"])
def test_a_save_that_is_cut_short_keeps_landmarks_and_marks_together(small, monkeypatch, after):
    write_image(small.root / "p4.png", np.full((30, 40, 3), 90, np.uint8))
    write_landmarks(small.root / "p4.pts", Landmarks(POINTS))
    saved = {"points": POINTS, "invisible": [1]}
    small.save_marks("p4.png", {**saved, "revision": small.marks("p4.png")["revision"]})

    real, put = landmark_files.write_text_atomically, small.store.put
    monkeypatch.setattr(landmark_files, "write_text_atomically", lambda path, *more: cut(real, path.name, path, *more))
    monkeypatch.setattr(small.store, "put", lambda kind, values: cut(put, kind, kind, values))

    def cut(write, name, *arguments):
        write(*arguments)
        if name == after:
            raise KeyboardInterrupt  # as good as a kill

    change = {"points": MOVED, "invisible": [0, 2]}
    with pytest.raises(KeyboardInterrupt):
        small.save_marks("p4.png", {**change, "revision": small.marks("p4.png")["revision"]})
    monkeypatch.undo()
    marks = Project(small.root).marks("p4.png")
    assert {key: marks[key] for key in saved} == (change if after == "p4.pts" else saved)
    again = Project(small.root)
    again.save_marks("p4.png", {**change, "revision": again.marks("p4.png")["revision"]})
    assert Project(small.root).marks("p4.png")["invisible"] == [0, 2]
    again.save_marks("p4.png", {"points": MOVED, "invisible": [], "revision": again.marks("p4.png")["revision"]})
    assert Project(small.root).marks("p4.png")["invisible"] == []


def test_a_stamp_changes_with_all_that_is_shown(small):
    seen = [small.stamp]
    assert small.stamp == seen[0]

    def changed():
        seen.append(small.stamp)
        return seen[-1] not in seen[:-1]

    write_image(small.root / "p9.png", np.full((30, 40, 3), 90, np.uint8))
    assert changed()
    small.add_proposals({"p9.png": proposal()})
    assert changed()
    (small.root / "p9.png").unlink()
    assert changed()
    (small.root / "p1.ljson").unlink()
    assert changed()
    small.save_template(TURNED)
    assert changed()
    small.store.note("something", "is wrong")
    assert changed()


# Pictures


def test_a_picture_that_was_replaced_keeps_nothing_of_the_one_before(small):
    write_image(small.root / "new.png", np.full((30, 40, 3), 90, np.uint8))
    small.overview()
    small.add_proposals({"new.png": proposal()})
    before = by_name(small)["new.png"]
    assert before["state"] == "proposed" and small.marks("new.png")["tag"] == before["tag"]
    write_image(small.root / "new.png", np.full((60, 90, 3), 70, np.uint8))
    after = by_name(small)["new.png"]
    assert (after["state"], after["rank"]) == ("new", None) and after["tag"] != before["tag"]
    assert small.marks("new.png")["source"] == "none"
    assert by_name(Project(small.root))["new.png"]["state"] == "new"


def test_points_outside_the_picture_are_told_and_not_learnt_from(small):
    write_image(small.root / "p2.png", np.full((15, 14, 3), 90, np.uint8))
    picture = by_name(small)["p2.png"]
    assert picture["state"] == "partial"
    assert "2 of the 3 points of p2.ljson lie outside the picture of 14 x 15 pixels" in picture["error"]
    assert [item.name for item in small.annotated()] == ["p1.png", "p3.png"]
    write_image(small.root / "p2.png", np.full((15, 16, 3), 90, np.uint8))  # half of an object may be cut off
    put(small, "p2.png", [[1, 2], [3, 4], [15.5, 20]], revision=small.marks("p2.png")["revision"])
    assert by_name(small)["p2.png"]["state"] == "done"


def test_a_picture_that_is_too_small_is_broken(small):
    write_image(small.root / "tiny.png", np.full((7, 40, 3), 90, np.uint8))
    write_image(small.root / "least.png", np.full((8, 8, 3), 90, np.uint8))
    pictures = by_name(small)
    assert pictures["tiny.png"]["state"] == "broken" and "at least 8×8 are needed" in pictures["tiny.png"]["error"]
    assert pictures["least.png"]["state"] == "new"


def test_what_is_passed_over_is_told(small, tmp_path):
    for name in ("a.svg", "b.PSD", "c.jxl", "d.jxl"):
        (small.root / name).touch()
    (small.root / "link.png").symlink_to(tmp_path / "outside.png")
    (small.root / "p1.png").rename(small.root / "renamed.png")
    small.overview()
    pictures, links, orphans = small.problems
    assert pictures.startswith("4 pictures (a.svg, b.PSD, c.jxl, d.jxl) skipped")
    assert "(2 .jxl, 1 .psd, 1 .svg)" in pictures
    assert links.startswith("1 file (link.png) skipped")
    assert orphans.startswith("1 landmark file (p1.ljson) without a picture of the same name")


def test_a_landmark_file_that_was_deleted_is_called_so(small):
    revision = small.marks("p1.png")["revision"]
    (small.root / "p1.ljson").unlink()
    refusal = refused(lambda: put(small, "p1.png", MOVED, revision=revision))
    assert "was deleted in the meantime" in str(refusal) and refusal.details["current"]["revision"] is None
    assert put(small, "p1.png", MOVED)["picture"]["state"] == "done"  # written again


# Two tabs, and a clock that jumps


def test_of_many_tabs_that_save_at_once_one_is_heard_and_the_others_are_told(small, serve):
    client = serve(small.root).client
    revision = client.get("/api/pictures/p1.png/landmarks").json()["revision"]
    sent = [{"points": [[i, 1], [2, 3], [4, 5]], "invisible": [], "revision": revision} for i in range(12)]
    with ThreadPoolExecutor(12) as tabs:
        answers = list(tabs.map(lambda data: client.put("/api/pictures/p1.png/landmarks", json=data), sent))
    heard = [data for data, answer in zip(sent, answers, strict=True) if answer.status_code == 200]
    assert len(heard) == 1 and {answer.status_code for answer in answers} == {200, 409}
    assert client.get("/api/pictures/p1.png/landmarks").json()["points"] == heard[0]["points"]
    shown = [answer.json()["current"]["points"] for answer in answers if answer.status_code == 409]
    assert all(points == heard[0]["points"] for points in shown)
    assert read_landmarks(small.root / "p1.ljson").points.tolist() == heard[0]["points"]


@pytest.mark.parametrize("age", [4e9, 1e6])
def test_a_file_that_is_changed_elsewhere_is_noticed_whatever_the_clock_says(small, age):
    os.utime(small.root / "p1.ljson", (age, age))
    before = small.marks("p1.png")
    write_landmarks(small.root / "p1.ljson", Landmarks(MOVED))
    os.utime(small.root / "p1.ljson", (age - 100, age - 100))  # older than the one before
    assert small.marks("p1.png")["points"] == MOVED
    assert refused(lambda: put(small, "p1.png", POINTS, revision=before["revision"])).status == 409
    os.utime(small.root, (age, age))
    put(small, "p1.png", POINTS, revision=small.marks("p1.png")["revision"])
    assert Project(small.root).marks("p1.png")["points"] == POINTS


# What the page is told


def test_a_full_disk_is_told_as_such(small, serve, disk):
    client = serve(small.root).client
    marks = client.get("/api/pictures/p1.png/landmarks").json()
    disk.add("p1.ljson")
    answer = client.put("/api/pictures/p1.png/landmarks", json={**marks, "points": MOVED})
    assert answer.status_code == 507
    assert answer.json()["error"].startswith("p1.ljson cannot be written (No space left on device)")
    change = {**TURNED, "revision": client.get("/api/project").json()["template"]["revision"]}
    answer = client.put("/api/template", json=change)
    assert answer.status_code == 507 and str(small.root) not in answer.text
    assert client.get("/api/pictures/p1.png/landmarks").status_code == 507
    assert client.get("/api/project").status_code == 200
    disk.clear()
    assert client.put("/api/template", json=change).json()["names"] == ["c", "a", "b"]
    assert client.get("/api/pictures/p1.png/landmarks").json()["points"] == MOVED


def test_a_file_that_cannot_be_removed_is_no_bug(small, serve, monkeypatch):
    client = serve(small.root).client
    marks = client.get("/api/pictures/p1.png/landmarks").json()

    def refuse(path, missing_ok=False):
        raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setattr(project_folder.Path, "unlink", refuse)
    answer = client.put("/api/pictures/p1.png/landmarks", json={**marks, "points": [None] * 3})
    assert answer.status_code == 503 and answer.json()["error"].startswith("p1.ljson cannot be removed")


def test_a_page_asks_cheaply_whether_anything_changed(small, serve, head_model):
    running = serve(small.root)
    client = running.client
    project = client.get("/api/project").json()
    assert project["id"] == running.studio.project.store.id
    again = client.get("/api/project", params={"stamp": project["stamp"]}).json()
    assert again == {"unchanged": True, "stamp": project["stamp"]}
    running.studio.models.publish(head_model, {"source": "file", "trained": None, "pictures": {}})
    project = client.get("/api/project", params={"stamp": project["stamp"]}).json()
    assert project["model"]["source"] == "file"
    (small.root / "p1.ljson").unlink()
    project = client.get("/api/project", params={"stamp": project["stamp"]}).json()
    assert project["pictures"][0]["state"] == "new"


@pytest.mark.parametrize("folder", ["another", None])
def test_what_was_made_for_another_folder_is_refused(small, serve, head_model, folder):
    running = serve(small.root)
    running.studio.models.publish(head_model, {"source": "file", "trained": None, "pictures": {}})
    client, known = running.client, running.client.get("/api/project").json()
    requests = [
        (
            "PUT",
            "/api/pictures/p1.png/landmarks",
            {**client.get("/api/pictures/p1.png/landmarks").json(), "points": MOVED},
        ),
        ("POST", "/api/fits", {"picture": "p1.png"}),
        ("PUT", "/api/template", {**TURNED, "revision": known["template"]["revision"]}),
    ]
    training = [("POST", "/api/training", {}), ("DELETE", "/api/training", {})]
    before = (small.root / "p1.ljson").read_bytes()
    for method, address, body in requests + training:
        answer = client.request(method, address, json={**body, "folder": folder})
        assert answer.status_code == 409 and answer.json()["folder"] == known["id"]
        assert "another folder" in answer.json()["error"]
    assert (small.root / "p1.ljson").read_bytes() == before
    assert client.get("/api/project", params={"stamp": known["stamp"]}).json()["unchanged"]
    for method, address, body in [*requests, training[1]]:
        answer = client.request(method, address, json={**body, "folder": known["id"]})
        assert answer.status_code == 200


def test_the_folder_is_listed_once_for_each_time_the_page_asks(small, serve, head_model, monkeypatch):
    running = serve(small.root)
    running.studio.models.publish(head_model, {"source": "studio", "trained": None, "pictures": {}})
    running.client.get("/api/project").raise_for_status()
    listed, scan = [], Listing.scan
    monkeypatch.setattr(Listing, "scan", lambda listing: listed.append(listing) or scan(listing))
    project = running.client.get("/api/project").json()
    assert len(listed) == 1 and project["model"]["stale"] == 3
    assert running.client.get("/api/project", params={"stamp": project["stamp"]}).json()["unchanged"]
    assert len(listed) == 2


def test_a_change_of_the_template_leaves_a_given_model_alone(small, serve, head_model, tmp_path):
    head_model.save(tmp_path / "m.liaam")
    client = serve(small.root, tmp_path / "m.liaam").client
    client.put("/api/template", json=TURNED).raise_for_status()
    assert client.get("/api/project").json()["model"]["source"] == "file"


def test_a_model_for_points_of_another_order_goes(small, serve, head_model):
    running = serve(small.root)
    facts = {"source": "studio", "trained": None, "pictures": {}, "order": running.studio.project.templates.order}
    running.studio.models.publish(head_model, facts)
    assert running.client.get("/api/project").json()["model"]["source"] == "studio"
    running.client.put("/api/template", json={**NAMES, "contours": []}).raise_for_status()
    assert running.client.get("/api/project").json()["model"]["source"] == "studio"
    running.client.put("/api/template", json=TURNED).raise_for_status()
    assert running.client.get("/api/project").json()["model"] is None
