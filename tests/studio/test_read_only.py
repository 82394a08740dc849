"""Folders that can only be read: pictures are shown, fitted and measured, and nothing is written beside them."""

import os

import pytest
from small_projects import POINTS, TRIANGLE, proposal, put, refused

from liaam.studio.app import Studio
from liaam.studio.folder import STATE
from liaam.studio.project import Project
from liaam.studio.sets import make_set


@pytest.fixture
def protected(small, monkeypatch, tmp_path):
    """Give a folder with landmarks of one picture, in which nothing can be written any more."""
    put(small, "p1.png", POINTS)
    small.store.close()
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "home"))
    may_access = os.access
    root = small.root
    monkeypatch.setattr(os, "access", lambda path, mode: not str(path).startswith(str(root)) and may_access(path, mode))
    return root


def files_in(root):
    return {path: path.stat().st_mtime_ns for path in root.rglob("*")}


def test_its_landmarks_and_template_are_there_and_proposals_are_kept_for_the_user(protected, tmp_path):
    before = files_in(protected)
    project = Project(protected)
    assert project.folder.is_read_only
    assert project.templates.current is not None and list(project.templates.current.names) == TRIANGLE["names"]
    assert project.marks("p1.png")["points"] == POINTS
    project.add_proposals({"p2.png": proposal()})
    project.store.close()
    assert Project(protected).marks("p2.png")["source"] == "proposal"
    assert files_in(protected) == before
    assert list((tmp_path / "home").rglob(f"{STATE}/studio.db"))


def test_requests_that_would_write_are_refused_with_the_remedy(protected):
    project = Project(protected)
    revision = project.marks("p1.png")["revision"]
    for call in (
        lambda: put(project, "p1.png", [[2.0, 2.0], *POINTS[1:]], revision),
        lambda: project.save_template({**TRIANGLE, "names": ["x", "y", "z"]}),
        lambda: project.take_in("new.png", b"x"),
        lambda: project.review({"pictures": ["p1.png"], "did": "deleted"}),
        lambda: make_set(project, {"name": "anna"}),
    ):
        fault = refused(call)
        assert fault.status == 409 and "can only be read: copy it to place landmarks" in str(fault)
    assert project.marks("p1.png")["points"] == POINTS


def test_a_studio_opens_it_and_a_second_one_is_refused(protected):
    before = files_in(protected)
    studio = Studio(protected)
    try:
        assert refused_by_lock(protected)
    finally:
        studio.close()
    assert files_in(protected) == before


def refused_by_lock(root):
    with pytest.raises(Exception, match="is open in another studio"):
        Studio(root)
    return True
