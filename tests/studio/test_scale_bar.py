"""Scale bars: the scale that follows from them is in the landmark file, the export, and the measurements."""

import numpy as np
import pytest
from small_projects import POINTS, TRIANGLE, by_name, proposal, refused

from liaam.io import Landmarks, read_collection, read_landmarks, write_image, write_landmarks
from liaam.morphometry import measure, read_specimens
from liaam.studio.contract import ShapesQuery
from liaam.studio.project import Project
from liaam.studio.shapes import table

BAR = {"ends": [[2.0, 5.0], [22.0, 5.0]], "length": 5, "unit": "mm"}  # 0.25 mm a pixel
CM = {"ends": [[2.0, 5.0], [2.0, 25.0]], "length": 1, "unit": "cm"}  # 0.5


def put(project, name, points=POINTS, **more):
    return project.save_marks(name, {"points": points, "revision": project.marks(name)["revision"], **more})


def test_the_scale_is_saved_with_the_landmarks_exported_and_measured(small):
    put(small, "p1.png", bar=BAR)
    put(small, "p2.png", bar=CM)
    assert read_landmarks(small.root / "p1.ljson").scale == pytest.approx(0.25)
    assert small.marks("p1.png")["bar"] == Project(small.root).marks("p1.png")["bar"] == BAR
    _, tps = small.export("tps")
    (small.root / "all.tps").write_bytes(tps)
    scales = [landmarks.scale for landmarks in read_collection(small.root / "all.tps").values()]
    assert scales == pytest.approx([0.25, 0.5])
    specimens = [one for name in ("p1", "p2") for one in read_specimens(small.root / f"{name}.ljson")]
    lengths = measure(specimens, ["distance:1-2"])
    (lengths,) = [values for name, values in lengths.items() if "distance" in name]
    assert lengths == pytest.approx(np.linalg.norm(np.subtract(*POINTS[:2])) * np.array([0.25, 0.5]))
    assert "0.25" in table(small, ShapesQuery(measures="distance:1-2"))[1].decode()


def test_points_are_moved_and_the_bar_stays(small):
    put(small, "p1.png", bar=BAR)
    put(small, "p1.png", [[5.0, 5.0], *POINTS[1:]])  # does not name it
    assert small.marks("p1.png")["bar"] == BAR
    small.save_template({**TRIANGLE, "mapping": [1, 0, 2]})
    assert read_landmarks(small.root / "p1.ljson").scale == pytest.approx(0.25)
    put(small, "p1.png", small.marks("p1.png")["points"], bar=None)
    assert small.marks("p1.png")["bar"] is None
    assert read_landmarks(small.root / "p1.ljson").scale is None


def test_a_bar_is_drawn_before_there_are_points(small):
    small.add_proposals({"p1.png": proposal()})
    put(small, "p1.png", [None] * 3, bar=BAR)
    marks = small.marks("p1.png")
    assert (marks["source"], marks["bar"], marks["revision"]) == ("proposal", BAR, None)
    assert small.history("p1.png") == [] and not (small.root / "p1.ljson").exists()
    small.review({"pictures": ["p1.png"], "did": "accepted"})
    assert read_landmarks(small.root / "p1.ljson").scale == pytest.approx(0.25)
    for did in ("deleted", "undeleted"):
        assert small.review({"pictures": ["p1.png"], "did": did})["changed"]
    assert read_landmarks(small.root / "p1.ljson").scale == pytest.approx(0.25)


def test_the_scale_of_a_file_stays(small):
    write_landmarks(small.root / "p1.tps", Landmarks(np.array(POINTS), scale=0.1, image_name="p1.png"))
    put(small, "p1.png", [[5.0, 5.0], *POINTS[1:]])
    assert read_landmarks(small.root / "p1.ljson").scale == pytest.approx(0.1)
    assert small.marks("p1.png")["pixel"] is None  # the file states no unit
    for did in ("deleted", "undeleted"):
        assert small.review({"pictures": ["p1.png"], "did": did})["changed"]
    assert read_landmarks(small.root / "p1.ljson").scale == pytest.approx(0.1)


def test_a_scale_in_a_file_is_known_where_its_measures_are_drawn(small):
    write_landmarks(small.root / "p1.ljson", Landmarks(np.array(POINTS), scale=0.1, unit="mm"))
    assert small.marks("p1.png")["pixel"] == {"length": 0.1, "unit": "mm"}
    put(small, "p1.png", bar=BAR)
    assert small.marks("p1.png")["pixel"] is None  # the bar says it


def test_the_scale_of_measure_is_that_of_pictures_without_one(small):
    small.save_measuring({"scale": "200 px/mm"})
    assert small.marks("p1.png")["pixel"] == {"length": 0.005, "unit": "mm"}
    small.save_measuring({"scale": "a-b=5 mm"})  # measured in each picture
    assert small.marks("p1.png")["pixel"] is None


def test_a_pts_file_has_no_room_for_it_but_the_studio_knows_it(small):
    write_landmarks(small.root / "p1.pts", Landmarks(np.array(POINTS)))
    put(small, "p1.png", bar=CM)
    assert b"SCALE=0.5" in small.export("tps")[1]


def test_a_picture_that_was_replaced_has_no_bar(small):
    put(small, "p1.png", bar=BAR)
    (small.root / "p1.png").write_bytes((small.root / "p2.png").read_bytes() + b"\0")
    assert small.marks("p1.png")["bar"] is None


def test_a_bar_that_was_changed_elsewhere_is_a_conflict(small):
    put(small, "p1.png")
    before = small.marks("p1.png")["revision"]
    put(small, "p1.png", bar=BAR)
    late = {"points": POINTS, "revision": before, "bar": CM}
    assert refused(small.save_marks, "p1.png", late).details["current"]["bar"] == BAR
    small.save_marks("p1.png", {**late, "bar": BAR})  # sent again: there is nothing to change


def share(project, bar=BAR, of="p1.png", did="scaled", **more):
    names = ["p2.png", "p10.png", "q.jpg"]
    return project.review({"pictures": names, "did": did, "bar": bar, "of": of, **more})


def scales_of(project):
    return {picture.file.name: picture.landmarks.scale for picture in project.placed()}


def test_one_bar_for_all_is_written_exported_and_taken_back(small):
    put(small, "p1.png", bar=BAR)
    put(small, "p2.png")
    write_landmarks(small.root / "p10.pts", Landmarks(np.array(POINTS)))
    small.add_proposals({"q.jpg": proposal()})
    small.review({"pictures": ["p2.png"], "did": "checked", "who": "Ada"})
    done = small.annotated()

    answer = share(small)
    assert answer["changed"] == ["p2.png", "p10.png", "q.jpg"]
    assert answer["revisions"]["p2.png"] == small.marks("p2.png")["revision"]
    assert read_landmarks(small.root / "p2.ljson").scale == pytest.approx(0.25)
    assert small.marks("q.jpg")["bar"] == BAR and small.marks("q.jpg")["source"] == "proposal"
    assert [small.marks(name)["bar_shared"] for name in ("p1.png", "q.jpg")] == [False, True]
    assert small.export("tps")[1].count(b"SCALE=0.25") == 3
    assert by_name(small)["p2.png"]["checked"] == "Ada"  # its points are as before,
    assert [item.revision for item in small.annotated()] == [item.revision for item in done]  # for training, too
    small.review({"pictures": ["q.jpg"], "did": "accepted"})
    assert read_landmarks(small.root / "q.ljson").scale == pytest.approx(0.25)

    assert share(small, CM)["changed"] == ["p2.png", "p10.png", "q.jpg"]  # another one: none of them has one of its own
    assert set(scales_of(small).values()) == {0.25, 0.5}
    assert share(small, did="unscaled")["changed"] and set(scales_of(small).values()) == {0.25}
    assert share(small, did="unscaled")["changed"]
    assert scales_of(small) == {"p1.png": 0.25, "p2.png": None, "p10.png": None, "q.jpg": None}
    assert read_landmarks(small.root / "p2.ljson").scale is None
    assert share(small, did="unscaled")["changed"] == []


def test_new_pictures_are_offered_the_scale_that_all_others_share(small):
    nothing = {"bar": None, "of": "", "without": []}
    put(small, "p1.png", bar=BAR)
    assert small.shared_scale() == nothing  # it was not shared
    small.review({"pictures": ["p2.png"], "did": "scaled", "bar": BAR, "of": "p1.png"})
    height, width = 60, 40
    write_image(small.root / "new.png", np.full((height, width, 3), 99, np.uint8))
    assert small.shared_scale()["without"] == ["p10.png", "q.jpg"]
    write_image(small.root / "q.jpg", np.full((50, 70, 3), 99, np.uint8))
    (small.root / "broken.png").write_bytes(b"?")
    assert small.shared_scale() == {"bar": BAR, "of": "p1.png", "without": ["p10.png"]}
    put(small, "p10.png", bar=CM)
    assert small.shared_scale() == nothing  # there are two


@pytest.mark.parametrize("part", [{"bar": None}, {"of": None}, {"of": 3}])
def test_a_bar_for_all_needs_the_bar_and_its_picture(small, part):
    assert "send the scale bar" in str(refused(lambda: share(small, **part)))


def test_a_scale_of_its_own_and_another_size_are_left_alone_unless_asked(small):
    put(small, "p2.png", bar=CM)
    write_landmarks(small.root / "p10.tps", Landmarks(np.array(POINTS), scale=0.1, image_name="p10.png"))
    write_image(small.root / "q.jpg", np.full((50, 70, 3), 99, np.uint8))
    refused_for = share(small)["refused"]
    assert "own" in refused_for["p2.png"] and "own" in refused_for["p10.png"] and "size" in refused_for["q.jpg"]
    assert len(share(small, anyway=True)["changed"]) == 3
    assert scales_of(small) == {"p2.png": 0.25, "p10.png": 0.25}
    share(small, did="unscaled")
    assert scales_of(small) == {"p2.png": 0.5, "p10.png": pytest.approx(0.1)}
    put(small, "p2.png", bar=BAR)  # drawn after the scale was shared
    assert "p2.png" in share(small, did="unscaled")["refused"]
    assert refused(share, small, None).status == 422


@pytest.mark.parametrize(
    "bar",
    [7, {}, {**BAR, "unit": "ell"}, {**BAR, "unit": ["mm"]}, {**BAR, "length": 0}, {**BAR, "length": float("nan")},
     {**BAR, "length": True}, {**BAR, "ends": [[1, 1]]}, {**BAR, "ends": [[1, 1], None]},
     {**BAR, "ends": [[1, 1], [1.5, 1]]}],
)  # fmt: skip
def test_bars_that_make_no_sense_are_refused(small, bar):
    assert refused(small.save_marks, "p1.png", {"points": POINTS, "revision": None, "bar": bar}).status == 422
    assert small.marks("p1.png")["source"] == "none"
