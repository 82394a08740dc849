"""Files that are added to the folder."""

import numpy as np
import pytest
from small_projects import POINTS, by_name, put, refused, states

from liaam.io import Landmarks, write_image, write_landmarks
from liaam.studio.pictures import png_bytes
from liaam.studio.project import Project


def png(value=90, size=(30, 40)):
    return png_bytes(np.full((*size, 3), value, np.uint8))


def pts(tmp_path, points=POINTS):
    write_landmarks(tmp_path / "x.pts", Landmarks(points))
    return (tmp_path / "x.pts").read_bytes()


def test_pictures_and_landmark_files_are_added(small, tmp_path):
    assert small.take_in("new.png", png()) == {"name": "new.png", "kind": "picture", "known": False}
    assert small.take_in("new.pts", pts(tmp_path))["kind"] == "landmarks"
    assert by_name(small)["new.png"]["state"] == "done"
    table = "image,point,x,y\n" + "".join(f"q.jpg,{i},{x},{y}\n" for i, (x, y) in enumerate(POINTS))
    small.take_in("all.csv", table.encode())
    assert states(small)["q.jpg"] == "done"


def test_the_same_file_again_is_known_and_another_of_its_name_is_refused(small):
    small.take_in("new.png", png())
    assert small.take_in("new.png", png())["known"]
    assert refused(small.take_in, "new.png", png(10)).status == 409
    assert refused(small.take_in, "new.jpg", png()).status == 409  # both would share their landmarks
    small.overview()
    assert refused(small.take_in, "new.jpg", png()).status == 409
    assert (small.root / "new.png").read_bytes() == png()


def test_landmarks_that_are_there_are_never_replaced(small, tmp_path):
    put(small, "p1.png", POINTS)
    before = (small.root / "p1.ljson").read_bytes()
    for name in ("p1.pts", "p1.ljson"):
        assert refused(small.take_in, name, pts(tmp_path, POINTS[::-1])).status in (409, 422)
    assert (small.root / "p1.ljson").read_bytes() == before and not (small.root / "p1.pts").exists()


@pytest.mark.parametrize(
    ("name", "data", "why"),
    [
        ("notes.txt", b"Buy milk", "notes.txt"),
        ("notes.doc", b"Buy milk", "neither a picture nor a landmark file"),
        ("empty.png", b"", "is empty"),
        ("text.png", b"Buy milk", "is not a PNG, JPEG"),
        ("x.pts", b"version: 1", "x.pts"),
        (".hidden.png", png(), "hidden"),
        ("../../.x/y.pts", b"", "empty"),
    ],
)
def test_what_cannot_be_read_is_left_out_and_told(small, name, data, why):
    before = sorted(path.name for path in small.root.iterdir())
    assert why in str(refused(small.take_in, name, data))
    assert sorted(path.name for path in small.root.iterdir()) == before


def test_paths_do_not_lead_out(small):
    assert small.take_in("../../new.png", png())["name"] == "new.png"
    assert not (small.root.parent / "new.png").exists()


def test_a_picture_that_is_too_large_is_left_out(small):
    small._listing.most_pixels = 1000
    assert "more than 1,000: make" in str(refused(small.take_in, "new.png", png()))


def test_where_pictures_lie_in_subfolders_others_join_them(tmp_path):
    (tmp_path / "day").mkdir()
    write_image(tmp_path / "day" / "a.png", np.full((30, 40, 3), 90, np.uint8))
    project = Project(tmp_path)
    assert project.take_in("b.png", png())["name"] == "added/b.png"
    assert list(states(project)) == ["added/b.png", "day/a.png"]


def test_files_are_added_over_http(folder, serve):
    client = serve(folder(1)).client
    answer = client.post("/api/files", params={"name": "new.png"}, content=png())
    assert answer.status_code == 201 and answer.json()["name"] == "new.png"
    assert [picture["name"] for picture in client.get("/api/project").json()["pictures"]] == ["new.png", "p1.png"]
    answer = client.post("/api/files", params={"name": "x.doc"}, content=b"x")
    assert answer.status_code == 415 and answer.json()["error"].startswith("x.doc is neither")
    assert ".tps" in client.get("/api/project").json()["formats"]["landmarks"]
