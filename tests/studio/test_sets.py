"""Several sets of landmarks in a folder: their files, templates, and agreement between observers."""

import subprocess
import sys
import textwrap
from dataclasses import replace

import cv2
import numpy as np
import pytest
from small_projects import POINTS, TRIANGLE, browser_of, by_name, put, refused, states

from liaam.cli.inputs import read_folder
from liaam.datasets import load_folder
from liaam.io import Landmarks, read_landmarks, write_image, write_landmarks
from liaam.morphometry import measure, measurement_error, read_specimens
from liaam.studio.model_store import ModelStore, load_studio_model
from liaam.studio.project import Project
from liaam.studio.refusal import Refusal
from liaam.studio.sets import agreement, make_set, others

HAND = {"names": ["u", "v"], "contours": [], "mirror": None}
OTHER = [[2.0, 2.0], [30.5, 3.25], [14.0, 20.0]]


@pytest.fixture
def first(small) -> Project:
    """Give the first set of a folder with four pictures, of which one is done."""
    put(small, "p1.png", POINTS)
    return small


def made(project, name="anna", *, same=True) -> Project:
    return project.of_set(make_set(project, {"name": name, "same": same})["name"])


def test_a_set_has_its_own_template_files_and_states(first):
    hand = made(first, "hand", same=False)
    assert first.sets == ["", "hand"] and hand.templates.current is None
    hand.save_template(HAND)
    put(hand, "p1.png", [[3.0, 4.0], [5.0, 6.0]])
    put(hand, "p2.png", [[3.0, 4.0], None])
    assert states(hand) == {"p1.png": "done", "p2.png": "partial", "p10.png": "new", "q.jpg": "new"}
    assert states(first) == {"p1.png": "done", "p2.png": "new", "p10.png": "new", "q.jpg": "new"}
    assert read_landmarks(first.root / "hand" / "p1.ljson").names == ("u", "v")
    assert read_landmarks(first.root / "p1.ljson").points.tolist() == POINTS
    assert [each.name for each in first.root.glob("*.ljson")] == ["p1.ljson"]
    assert first.marks("p1.png")["points"] == POINTS and hand.marks("p1.png")["points"] == [[3.0, 4.0], [5.0, 6.0]]
    assert hand.store.id != first.store.id and not hand.problems and not first.problems
    name, data = hand.export("csv")
    assert name == "small-hand.csv" and data.count(b"p1.png") == 2  # a row for each point
    # A change of one template leaves the files of the other set alone.
    hand.save_template({"names": ["v", "u"], "mapping": [1, 0]})
    assert read_landmarks(first.root / "hand" / "p1.ljson").points.tolist() == [[5.0, 6.0], [3.0, 4.0]]
    assert first.marks("p1.png")["points"] == POINTS
    again = Project(first.root)
    assert again.sets == ["", "hand"] and states(again.of_set("hand")) == states(hand)


def test_a_revision_of_another_set_or_an_old_one_is_refused(first):
    anna = made(first)
    put(anna, "p1.png", OTHER)
    old = anna.marks("p1.png")["revision"]
    put(anna, "p1.png", POINTS, old)
    assert refused(put, anna, "p1.png", OTHER, old).status == 409
    foreign = {"points": OTHER, "invisible": [], "revision": None, "folder": first.store.id}
    assert refused(anna.save_marks, "p2.png", foreign).status == 409  # a page of the other set
    assert anna.marks("p1.png")["points"] == POINTS


NO_NAMES = ("", ".", "..", "../out", "a/b", "a\\b", ".liaam-studio", "-a", "a.b", "a b", "é", "x" * 31, "a\n", None, 3)


def test_names_that_are_no_plain_subfolder_are_refused(first):
    root = first.root
    before = sorted(root.parent.rglob("*"))
    for name in (*NO_NAMES, "added"):
        assert refused(make_set, first, {"name": name}).status in (409, 422), name
        assert sorted(root.parent.rglob("*")) == before and first.sets == [""]


def test_a_name_that_is_taken_is_refused(first, tmp_path):
    root = first.root
    made(first, "anna")
    (root / "file").touch()
    (root / "link").symlink_to(tmp_path)
    (root / "more" / "deep").mkdir(parents=True)
    write_image(root / "more" / "deep" / "a.png", np.zeros((3, 3, 3), np.uint8))
    for name in ("anna", "ANNA", "file", "link", "more"):
        assert refused(make_set, first, {"name": name}).status == 409
    assert first.sets == ["", "anna"]
    assert refused(first.of_set, "nobody").status == 404 and refused(first.of_set, "../small").status == 404


def test_nothing_is_written_through_a_link_that_replaced_a_set(first, tmp_path):
    anna, out = made(first), tmp_path / "out"
    out.mkdir()
    (anna.root / "anna").rmdir()
    (anna.root / "anna").symlink_to(out)
    with pytest.raises(Refusal, match="link"):
        put(anna, "p1.png", OTHER)
    assert not list(out.iterdir()) and by_name(anna)["p1.png"]["state"] == "new"


def test_landmark_files_that_are_there_become_the_sets(first):
    root = first.root
    (root / "bob").mkdir()
    write_landmarks(root / "bob" / "p2.ljson", Landmarks(np.array(OTHER), names=("a", "b", "c")))
    (root / "bob" / "all.csv").write_text("image,x1,y1,x2,y2,x3,y3\nq.jpg,1,2,3,4,5,6\n")
    bob = made(first, "bob")
    assert states(bob) == {"p1.png": "new", "p2.png": "done", "p10.png": "new", "q.jpg": "done"}
    assert bob.marks("q.jpg")["points"] == [[1, 2], [3, 4], [5, 6]]
    assert bob.marks("q.jpg")["file"] == "bob/all.csv"


def test_pictures_in_subfolders(tmp_path):
    for name in ("day1/a.png", "day2/a.png"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        write_image(tmp_path / name, np.full((30, 40, 3), 90, np.uint8))
    first = Project(tmp_path)
    first.save_template(TRIANGLE)
    anna = made(first)
    put(anna, "day2/a.png", OTHER)
    assert (tmp_path / "anna" / "day2" / "a.ljson").is_file()
    assert states(anna) == {"day1/a.png": "new", "day2/a.png": "done"}
    assert states(first) == {"day1/a.png": "new", "day2/a.png": "new"} and not first.problems
    again = Project(tmp_path)
    assert states(again.of_set("anna")) == states(anna) and not again.problems
    assert anna.take_in("more.pts", b"version: 1\nn_points: 1\n{\n1 1\n}\n")["name"] == "anna/added/more.pts"


def test_the_scale_of_a_picture_holds_in_all_sets(first):
    bar = {"ends": [[0, 0], [10, 0]], "length": 5, "unit": "mm"}
    anna = made(first)
    put(anna, "p1.png", OTHER)
    first.save_marks("p1.png", {"points": POINTS, "revision": first.marks("p1.png")["revision"], "bar": bar})
    assert anna.marks("p1.png")["bar"] == bar and b"0.5" in anna.export("tps")[1]


def test_a_change_of_a_template_is_finished_after_a_kill(first):
    anna = made(first)
    for name in ("p1.png", "p2.png"):
        put(anna, name, OTHER)
    script = """
        import os, sys
        from pathlib import Path
        from liaam.studio.landmark_files import LandmarkFiles
        from liaam.studio.project import Project
        from liaam.studio.sets import agreement, make_set, others
        rewrite, left = LandmarkFiles.rewrite, [1]
        def dying(self, *arguments):
            if not left:
                os._exit(9)
            left.pop()
            rewrite(self, *arguments)
        LandmarkFiles.rewrite = dying
        Project(sys.argv[1]).of_set("anna").save_template({"names": ["c", "a", "b"], "mapping": [2, 0, 1]})
        """
    root = first.root
    ended = subprocess.run([sys.executable, "-c", textwrap.dedent(script), str(root)], check=False)
    assert ended.returncode == 9
    again = Project(root)
    moved = [OTHER[2], OTHER[0], OTHER[1]]
    assert [again.of_set("anna").marks(name)["points"] for name in ("p1.png", "p2.png")] == [moved, moved]
    assert again.of_set("anna").templates.current.names == ("c", "a", "b")
    assert again.marks("p1.png")["points"] == POINTS and again.templates.current.names == (
        "a",
        "b",
        "c",
    )


def test_the_other_observers_points_are_hidden_until_all_own_are_placed(first):
    anna = made(first)
    hand = made(first, "hand", same=False)
    hand.save_template(HAND)
    put(hand, "p1.png", [[3.0, 4.0], [5.0, 6.0]])
    assert anna.marks("p1.png")["source"] == "none"
    put(anna, "p1.png", [OTHER[0], None, None])
    assert refused(others, anna, "p1.png").status == 409
    put(anna, "p1.png", OTHER, anna.marks("p1.png")["revision"])
    assert others(anna, "p1.png") == {"": POINTS} and others(first, "p1.png") == {"anna": OTHER}


def test_agreement_of_two_observers(first):
    anna = made(first)
    assert refused(agreement, first).status == 422
    rng = np.random.default_rng(0)
    shapes = {name: np.array(POINTS) + rng.uniform(-2, 2, (3, 2)) for name in ("p1.png", "p2.png", "p10.png")}
    # By 2, 0 and 4 pixels: the standard deviation of two values is their distance by the square root of 2.
    apart = np.array([[2.0, 0.0], [0.0, 0.0], [0.0, 4.0]])
    far = {"p1.png": 1.0, "p2.png": 0.5, "p10.png": 0.0}
    for name, shape in shapes.items():
        revision = first.marks(name)["revision"]
        put(first, name, shape.tolist(), revision)
        put(anna, name, (shape + far[name] * apart).tolist())
    put(anna, "q.jpg", POINTS)  # by one observer only
    found = agreement(anna)
    assert {**agreement(first), "file": found["file"]} == found and found["observers"] == ["", "anna"]
    share = np.sqrt((1 + 0.25 + 0) / 3 / 2)
    assert [name for name, *_ in found["points"]] == ["c", "a", "b"]
    assert np.allclose([sd for _, sd, _ in found["points"]], [4 * share, 2 * share, 0], atol=1e-3)
    assert found["sd"] == pytest.approx(np.sqrt((16 + 4 + 0) / 3) * share, abs=1e-3)
    sizes = [np.linalg.norm(points - points.mean(axis=0)) for points in _all(first, anna, shapes)]
    assert found["percent"] == pytest.approx(100 * found["sd"] / np.mean(sizes), rel=1e-3)
    assert [name for name, _ in found["pictures"]] == ["p1.png", "p2.png", "p10.png"]
    assert found["pictures"][0][1] == pytest.approx(np.sqrt((4 + 16) / 2 / 3), abs=1e-3)
    assert found["pictures"][2][1] == pytest.approx(0, abs=1e-3)
    assert 0 < found["repeatability"] < 1
    assert found["file"] == "small-anna-agreement.csv"
    assert "landmark c" in found["table"] and "repeatability" in found["table"]
    assert found["pixel"] is None
    bar = {"ends": [[0.0, 0.0], [20.0, 0.0]], "length": 10.0, "unit": "mm"}
    first.review({"pictures": [*shapes], "did": "scaled", "bar": bar, "of": "p1.png", "anyway": True})
    assert agreement(anna)["pixel"] == {"length": 0.5, "unit": "mm"}


def test_mirrored_specimens_do_not_make_observers_agree(tmp_path):
    base = np.array([[40, 40], [280, 50], [260, 190], [60, 200], [150, 120], [200, 80]], float)
    found = []
    for n_mirrored in (0, 3):
        rng = np.random.default_rng(3)
        root = tmp_path / f"wings{n_mirrored}"
        root.mkdir()
        second = {}
        for i in range(10):
            write_image(root / f"w{i}.png", np.full((240, 320, 3), 120, np.uint8))
            truth = base + rng.normal(0, 4, base.shape)
            both = np.array([truth, truth + rng.normal(0, 3, base.shape)])
            own, second[f"w{i}.ljson"] = both * (-1, 1) + (319, 0) if i < n_mirrored else both
            write_landmarks(root / f"w{i}.ljson", Landmarks(own, (), tuple("abcdef")))
        project = Project(root)
        make_set(project, {"name": "anna", "same": True})
        for name, points in second.items():
            write_landmarks(root / "anna" / name, Landmarks(points, (), tuple("abcdef")))
        found.append(agreement(project))
    plain, mirrored = found
    assert mirrored["repeatability"] == pytest.approx(plain["repeatability"], abs=1e-3)
    assert plain["repeatability"] < 0.9
    assert mirrored["shapes"][0]["slope"] == pytest.approx(plain["shapes"][0]["slope"], abs=1e-3)
    assert mirrored["sd"] == pytest.approx(plain["sd"], abs=1e-3)


def _all(first, anna, names):
    return [np.array(project.marks(name)["points"]) for project in (first, anna) for name in names]


def test_agreement_is_that_of_liaam_measure(first, tmp_path):
    anna, rng = made(first), np.random.default_rng(1)
    for name in ("p2.png", "p10.png", "q.jpg"):
        for project in (first, anna):
            put(project, name, (np.array(POINTS) + rng.normal(0, 1, (3, 2))).tolist())
    for k, project in enumerate((first, anna), 1):
        (tmp_path / f"{k}.tps").write_bytes(project.export("tps")[1])
    specimens = [
        own for k in (1, 2) for own in read_specimens(tmp_path / f"{k}.tps") if "p1" not in own.name.split(".")
    ]
    both = [replace(own, name=f"{own.name}#{i}") for i, own in enumerate(specimens)]
    table = measurement_error(both, measure(both), "image")
    assert agreement(first)["repeatability"] == pytest.approx(table["repeatability"][0], rel=1e-3)


def test_pages_of_a_set_have_an_address_of_their_own(folder, serve):
    running = serve(folder(3, 3))
    client, base = running.client, running.client.get("/api/project").json()
    assert base["set"] == "" and base["sets"] == [""]
    asked = {"name": "anna", "same": True, "folder": base["id"]}
    assert client.post("/api/sets", json=asked).json() == {"name": "anna"}
    assert client.get("/api/project").json()["sets"] == ["", "anna"]
    anna = client.get("/set/anna/api/project").json()
    assert anna["set"] == "anna" and anna["template"]["names"] == base["template"]["names"]
    assert [each["state"] for each in anna["pictures"]] == ["new"] * 3
    assert "<html" in client.get("/set/anna/").text and client.get("/set/anna/js/api.js").status_code == 200
    assert client.get("/set/anna/api/pictures/p1.png/image").headers["content-type"] == "image/jpeg"
    for wrong in ("/set/nobody/api/project", "/set/..%2F..%2Fx/api/project", "/set/%2e%2e/api/project"):
        assert client.get(wrong).status_code == 404
    with browser_of(running.url) as stranger:
        assert stranger.get("/set/anna/api/project").status_code == 401
    large = b"x" * 2_100_000  # more than a request may have that is no upload
    assert client.post("/set/anna/api/files?name=a.tps", content=large).status_code != 413
    assert client.put("/set/anna/api/template", content=large).status_code == 413
    # A page of one set that saves to the other, as after an address was typed, is refused.
    assert (
        client.post("/set/anna/api/review", json={"folder": base["id"], "pictures": [], "did": "x"}).status_code == 409
    )


def test_a_set_trains_a_model_of_its_own(small, serve, rng):
    for picture in small.root.glob("p*.png"):
        write_image(picture, cv2.GaussianBlur(rng.integers(0, 256, (30, 40, 3)).astype(np.uint8), (0, 0), 2))
    running = serve(small.root)
    client = running.client
    client.post("/api/sets", json={"name": "anna", "same": True})
    first = running.studio.project
    anna = running.studio.of_set("anna")
    for name in ("p1.png", "p2.png", "p10.png"):
        put(anna.project, name, (np.array(POINTS) + rng.uniform(-1, 1, (3, 2))).tolist())
    assert client.post("/set/anna/api/training").status_code == 202
    assert anna.training.wait(120).state == "done", anna.training.state
    assert anna.models.current is not None and running.studio.models.current is None
    assert (first.root / ".liaam-studio" / "sets" / "anna" / "model.liaam").is_file()
    assert client.get("/set/anna/api/project").json()["model"]["name"] == "small-anna"
    again, models = Project(first.root), {"": ModelStore(), "anna": ModelStore()}
    for name, store in models.items():
        load_studio_model(again.of_set(name), store)
    assert models[""].current is None and models["anna"].current is not None


def test_a_set_trains_from_the_command_line(folder):
    root = folder(3, 3)
    (root / "anna").mkdir()
    for i in (1, 3):
        (root / f"p{i}.ljson").rename(root / "anna" / f"p{i}.ljson")
    data = read_folder(root / "anna")
    assert [sample.image for sample in data] == [root / "p1.png", root / "p3.png"]
    assert [sample.image for sample in load_folder(root)] == [root / "p2.png"]
