"""The studio's own files, and links, which may be anything."""

import json
import os
import shutil

import numpy as np
import pytest
from small_projects import POINTS, TRIANGLE, by_name, proposal, put, refused, states

from liaam.io import Landmarks, write_image, write_landmarks
from liaam.studio.folder import STATE
from liaam.studio.project import Project


@pytest.mark.parametrize("content", [b"", b"{", b"[]", b"7", b'{"a": 1}', b"\xff\xfe", b"[" * 100_000])
@pytest.mark.parametrize("name", ["template.json", "proposals.json", "unchecked.json", "invisible.json", "change.json"])
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


def test_half_of_a_surrogate_pair_is_damage(small):
    change = {"template": {**TRIANGLE, "order": "\ud800"}, "files": []}
    (small.root / STATE / "change.json").write_text(json.dumps(change))
    project = Project(small.root)
    assert any("change.json" in problem for problem in project.problems)
    assert states(project)["p1.png"] == "new"


def test_a_state_file_that_is_a_link_to_itself_is_replaced(small):
    for name in ("proposals.json", "template.json"):
        (small.root / STATE / name).unlink(missing_ok=True)
        (small.root / STATE / name).symlink_to(name)
    project = Project(small.root)
    project.save_template(TRIANGLE)
    assert Project(small.root).template is not None


@pytest.mark.parametrize("name", ["../evil.ljson", "/tmp/evil.ljson", "p1.png", "sub/../x.pts", ".sub/x.pts", 7])
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
    (problem,) = project.problems
    assert "remove it" in problem
    assert refused(project.save_template, TRIANGLE).status == 409
    assert refused(project.state.path, "model.liaam").status == 409
    assert [path.name for path in outside.iterdir()] == ["template.json"]
    (small.root / STATE).unlink()
    project.save_template(TRIANGLE)
    assert not project.problems


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
