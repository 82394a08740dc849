"""Kinds of points: landmarks, and semilandmarks that slide along a curve."""

import pytest
from small_projects import POINTS, TRIANGLE, put, refused

from liaam.io import Contour, Landmarks, read_landmarks
from liaam.studio.project import Project
from liaam.studio.template import sliders_text, template_of

CURVE = {"names": ["a", "b", "c"], "contours": [{"indices": [0, 1, 2], "closed": False}], "mirror": None}
SLIDING = ["landmark", "semilandmark", "landmark"]


def test_kinds_are_stored_and_a_template_of_an_earlier_version_has_landmarks_only(small):
    assert small.templates.as_json()["kinds"] == ["landmark"] * 3
    small.save_template({**CURVE, "kinds": SLIDING})
    assert Project(small.root).templates.as_json()["kinds"] == SLIDING
    stored = small.store.get("template")
    del stored["kinds"]
    small.store.put("template", {"": stored})
    assert Project(small.root).templates.as_json()["kinds"] == ["landmark"] * 3


def test_points_between_the_ends_of_contours_in_a_file_are_semilandmarks(small):
    points = [[float(i), float(i % 2)] for i in range(9)]
    contours = (Contour((0, 1, 2)), Contour((2, 3, 0)), Contour((4, 5, 6), closed=True))
    kinds = template_of(Landmarks(points, contours)).kinds
    assert [i for i, kind in enumerate(kinds) if kind == "semilandmark"] == [1, 3, 5, 6]


def test_the_name_of_a_curve_goes_to_the_landmark_files_and_comes_back(small):
    put(small, "p1.png", POINTS)
    two = [{"indices": [0, 1, 2], "closed": False, "name": " costa "}, {"indices": [0, 2], "closed": False}]
    small.save_template({**CURVE, "contours": two})
    stored = read_landmarks(small.root / "p1.ljson")
    assert stored.contours == (Contour((0, 1, 2), name="costa"), Contour((0, 2)))
    assert template_of(stored).as_json()["contours"] == [{**two[0], "name": "costa"}, two[1]]
    for second in ("Costa", 7, "x" * 101, "a\nb"):
        said = str(refused(small.save_template, {**CURVE, "contours": [two[0], {**two[1], "name": second}]}))
        assert "two curves have the name 'costa': rename one" in said or "the name of curve 2 is not valid" in said


def test_kinds_that_are_not_valid_are_refused(small):
    for kinds in ("landmark", ["landmark"], ["landmark", "curve", "landmark"], [{}, [], 3]):
        assert refused(small.save_template, {**CURVE, "kinds": kinds}).status == 422
    alone = {**CURVE, "contours": [], "kinds": SLIDING}
    assert "'b' is a semilandmark, but on no contour" in str(refused(small.save_template, alone))


@pytest.mark.parametrize(("closed", "rows"), [(False, ["1,2,3"]), (True, ["3,1,2", "1,2,3", "2,3,1"])])
def test_sliders_are_exported_as_geomorph_reads_them(small, closed, rows):
    contours = [{"indices": [0, 1, 2], "closed": closed}]
    template, _ = small.save_template({**CURVE, "contours": contours, "kinds": ["semilandmark"] * 3})
    assert small.export("sliders") == ("small-sliders.csv", "\n".join(["before,slide,after", *rows, ""]).encode())
    assert sliders_text(template).splitlines()[1:] == rows


def test_without_semilandmarks_there_are_no_sliders(small):
    small.save_template(TRIANGLE)
    put(small, "p1.png", [[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]])
    assert "draw a curve" in str(refused(small.export, "sliders"))
