"""What a model found in pictures, until a person has placed points there."""

from small_projects import POINTS, TRIANGLE, by_name, proposal, put, refused, states

from liaam.studio.project import Project
from liaam.studio.review import teaching_order


def test_proposals_are_shown_until_there_are_landmarks(small):
    small.add_proposals({"p1.png": proposal(0.02), "p2.png": proposal(0.03)})
    for project in (small, Project(small.root)):
        assert states(project)["p1.png"] == "proposed"
        assert {name: picture["rank"] for name, picture in by_name(project).items()} == {
            "p1.png": 2, "p2.png": 1, "p10.png": None, "q.jpg": None,
        }  # fmt: skip
        marks = project.marks("p1.png")
        assert (marks["source"], marks["points"], marks["revision"]) == ("proposal", POINTS, None)
        assert marks["quality"] == 0.9
    fault = refused(small.export, "pts")
    assert "points of 2 pictures are only proposed: accept them" in str(fault)
    assert fault.details == {"proposed": 2}
    put(small, "p1.png", POINTS)  # taken as it is
    marks = small.marks("p1.png")
    assert (marks["source"], marks["fitted"], len(marks["covariances"])) == ("file", POINTS, 3)  # for the ellipses
    assert by_name(small)["p1.png"]["uncertainty"] is None
    assert by_name(small)["p2.png"]["rank"] == 1


def test_a_picture_that_cannot_be_fitted_says_why(small):
    small.add_proposals({"p1.png": proposal(None, points=None, message="p1.png is grey")})
    assert by_name(small)["p1.png"]["state"] == "new"
    assert by_name(small)["p1.png"]["error"] == "p1.png is grey"


def test_proposals_of_another_template_are_dropped(small):
    small.add_proposals({"p1.png": proposal()})
    small.save_template({**TRIANGLE, "mapping": [1, 0, 2], "revision": small.templates.as_json()["revision"]})
    assert states(small)["p1.png"] == "new"


def test_each_model_is_fitted_to_all_pictures_first_to_those_that_teach_most(small):
    def names(model=""):
        return [name for name, _ in small.unfitted(model)]

    assert names() == names("new") == ["p1.png", "p2.png", "p10.png", "q.jpg"]
    small.add_proposals({"p1.png": proposal(0.02), "p2.png": proposal(0.03)})
    assert names() == ["p10.png", "q.jpg"]
    assert names("new") == ["p2.png", "p10.png", "p1.png", "q.jpg"]
    small.add_proposals({"p2.png": {**proposal(0.01), "model": "new"}, "p10.png": {**proposal(0.01), "model": "new"}})
    assert names("new") == ["p1.png", "q.jpg"]
    put(small, "p1.png", POINTS)
    (small.root / "q.jpg").write_bytes(b"rubbish")
    assert names("new") == []


def test_the_order_in_which_pictures_teach():
    order = teaching_order(
        {
            "sure": proposal(0.01),
            "unsure": proposal(0.05),
            "not there": proposal(0.2, found=False, ok=False),
            "failed": proposal(0.02, ok=False),
            "diverged": proposal(None, ok=False),
        }
    )
    assert order == ["failed", "diverged", "unsure", "sure", "not there"]


def test_a_picture_left_at_the_mean_shape_is_not_checked_until_a_point_is_placed(small):
    small.save_marks("p1.png", {"points": [None] * 3, "revision": None, "unchecked": True})
    assert states(small)["p1.png"] == "unchecked"
    assert small.annotated() == []
    again = Project(small.root)
    assert states(again)["p1.png"] == "unchecked"
    assert [name for name, _ in again.unfitted()] == ["p1.png", "p2.png", "p10.png", "q.jpg"]
    put(again, "p1.png", POINTS)
    assert states(again)["p1.png"] == "done"
    again.save_marks("p2.png", {"points": [None] * 3, "revision": None, "unchecked": True})
    again.add_proposals({"p2.png": proposal()})
    assert states(again)["p2.png"] == "proposed"


def test_a_replaced_picture_is_no_longer_marked_as_not_checked(small):
    small.save_marks("p1.png", {"points": [None] * 3, "revision": None, "unchecked": True})
    (small.root / "p1.png").write_bytes((small.root / "p2.png").read_bytes() + b"\0")
    assert states(small)["p1.png"] == "new"
