"""What the studio keeps, and links, which may be anything."""

import json
import os
import shutil
import sqlite3
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing

import numpy as np
import pytest
from small_projects import POINTS, TRIANGLE, by_name, proposal, put, refused, states

from liaam.io import Landmarks, write_image, write_landmarks
from liaam.studio.folder import STATE, Folder
from liaam.studio.project import Project
from liaam.studio.store import DATABASE, Store, StoredTable


@pytest.fixture
def store(tmp_path):
    return Store(Folder(tmp_path))


def changed(folder, statement, *arguments):
    """Change the database behind the studio's back."""
    with closing(sqlite3.connect(folder / STATE / DATABASE)) as connection, connection:
        connection.execute(statement, arguments)


def test_values_and_lines_are_kept(store, tmp_path):
    store.put("a", {"x": 1, "y": [None, "\ud800"]})
    store.put("b", {"x": 2})
    store.append("a", [{"n": 1}, {"n": 2}])
    store.put("a", {"x": None, "z": {}})
    for one in (store, Store(Folder(tmp_path))):
        assert one.all("a") == {"y": [None, "\ud800"], "z": {}} and one.get("b", "x") == 2 and one.get("a", "x") is None
        assert one.lines("a") == [{"n": 1}, {"n": 2}] and one.lines("b") == []
    StoredTable(store, "a").forget()
    assert store.all("a") == {} and store.lines("a")


def test_a_transaction_writes_all_or_nothing(store, tmp_path):
    store.put("a", {"x": 1})
    with pytest.raises(KeyboardInterrupt), store.transaction():
        store.put("a", {"x": 2})
        store.append("a", [1])
        raise KeyboardInterrupt
    assert store.get("a", "x") == 1 and store.lines("a") == []
    with pytest.raises(ValueError, match="not JSON compliant"):
        store.put("a", {"x": 3, "y": float("nan")})
    assert Store(Folder(tmp_path)).all("a") == {"x": 1}


def test_a_kill_leaves_whole_transactions(tmp_path):
    """Each transaction writes a value and a line with the same number."""
    code = (
        "import sys; from pathlib import Path; from liaam.studio.folder import Folder\n"
        "from liaam.studio.store import Store\n"
        "store = Store(Folder(Path(sys.argv[1])))\n"
        "for i in range(10**6):\n"
        "    with store.transaction(): store.put('a', {'x': i}); store.append('a', [i])\n"
        "    if i == 20: print(flush=True)\n"
    )
    worker = subprocess.Popen([sys.executable, "-c", code, str(tmp_path)], stdout=subprocess.PIPE)
    worker.stdout.readline()
    worker.kill()
    worker.wait()
    worker.stdout.close()
    store = Store(Folder(tmp_path))
    last = store.get("a", "x")
    assert last >= 20 and store.lines("a") == list(range(last + 1))


def test_threads_and_a_second_process_wait_for_each_other(store, tmp_path):
    other = Store(Folder(tmp_path))
    with ThreadPoolExecutor(4) as pool:
        list(pool.map(lambda i: (store, other)[i % 2].append("a", [i]), range(40)))
    assert sorted(store.lines("a")) == list(range(40))


@pytest.mark.parametrize("content", [b"{" * 999, b"SQLite format 3\0" + b"\xff" * 5000, b"\0" * 4096])
def test_a_damaged_database_is_kept_and_begun_anew(small, content):
    put(small, "p1.png", POINTS)
    path = small.root / STATE / DATABASE
    path.write_bytes(content)
    path.with_name(f"{DATABASE}-journal").write_bytes(b"rubbish")
    project = Project(small.root)
    assert states(project)["p1.png"] == "done"
    (problem,) = project.problems
    (kept,) = (small.root / STATE).glob("damaged-*.db")
    assert kept.name in problem and kept.read_bytes() == content
    project.save_template({**TRIANGLE, "names": ["x", "y", "z"]})
    assert Project(small.root).templates.current.names == ("x", "y", "z") and not Project(small.root).problems


def test_a_database_whose_schema_is_no_text_is_begun_anew(small):
    put(small, "p1.png", POINTS)
    path = small.root / STATE / DATABASE
    content = path.read_bytes()
    assert b"CREATE TABLE item" in content
    path.write_bytes(content.replace(b"CREATE TABLE item", b"CREATE T\xf4BLE item"))  # SQLite's message repeats it
    (problem,) = Project(small.root).problems
    assert "was damaged" in problem


def test_a_damaged_entry_is_told_and_passed_over(small):
    small.add_proposals({"p1.png": proposal(), "p2.png": proposal()})
    changed(small.root, "UPDATE item SET json = '{' WHERE kind = 'proposal' AND name = 'p1.png'")
    project = Project(small.root)
    assert [states(project)[name] for name in ("p1.png", "p2.png")] == ["new", "proposed"]
    assert "1 of the entries" in project.problems[0]


def test_a_full_disk_is_told_and_keeps_what_is_there(store):
    store.put("a", {"x": 1})
    (pages,) = store._open().execute("PRAGMA page_count").fetchone()
    store._open().execute(f"PRAGMA max_page_count = {pages}")
    refusal = refused(store.put, "a", {"x": "long" * 10_000})
    assert refusal.status == 507 and "make room" in str(refusal)
    store.put("a", {"y": 2})
    assert store.all("a") == {"x": 1, "y": 2}


def test_a_database_that_was_removed_is_made_again(small):
    shutil.rmtree(small.root / STATE)
    small.add_proposals({"p1.png": proposal()})
    assert "p1.png" in Store(Folder(small.root)).all("proposal")


@pytest.mark.parametrize("name", ["../evil.ljson", "/tmp/evil.ljson", "p1.png", "sub/../x.pts", ".sub/x.pts"])
def test_a_change_writes_landmark_files_of_the_folder_only(small, name):
    item = {"file": name, "before": None, "text": "evil", "invisible": []}
    small.store.put("change", {"": {"template": TRIANGLE, "files": [item], "moved": False}})
    before = (small.root / "p1.png").read_bytes()
    Project(small.root).overview()
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
    assert refused(small.source, "link.png").status == 404
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
    outside = tmp_path / "outside"
    (small.root / STATE).rename(outside)
    before = {path: path.read_bytes() for path in outside.iterdir()}
    (small.root / STATE).symlink_to(outside)
    project = Project(small.root)
    assert project.templates.current is None
    (problem,) = project.problems
    assert "remove it" in problem
    assert refused(project.save_template, TRIANGLE).status == 409
    assert refused(project.store.path, "model.liaam").status == 409
    assert {path: path.read_bytes() for path in outside.iterdir()} == before
    (small.root / STATE).unlink()
    project.save_template(TRIANGLE)
    assert not project.problems


def test_a_database_that_leads_out_is_not_used(small, tmp_path):
    outside = tmp_path / "outside.db"
    (small.root / STATE / DATABASE).rename(outside)
    before = outside.read_bytes()
    (small.root / STATE / DATABASE).symlink_to(outside)
    project = Project(small.root)
    assert project.templates.current is None and project.problems
    assert refused(project.save_template, {**TRIANGLE, "names": ["x", "y", "z"]}).status == 409
    assert outside.read_bytes() == before


def test_names_that_are_not_of_the_listing_are_no_pictures(small):
    for name in ("../x.png", "..", ".", "", "/etc/passwd", "p1.png/", "p1.ljson", "P1.PNG\0", "a" * 5000):
        assert refused(small.source, name).status == 404, name


def test_names_that_no_answer_can_hold_are_passed_over(small):
    try:
        (small.root / os.fsdecode(b"bad\xff.png")).write_bytes((small.root / "p1.png").read_bytes())
    except OSError:
        pytest.skip("this file system takes no such names")
    assert json.dumps(small.overview().pictures, ensure_ascii=False).encode()
