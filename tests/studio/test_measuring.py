"""What is measured of the pictures is kept with the folder, and belongs to landmarks, not to their numbers."""

import csv

import pytest
from small_projects import POINTS, put, refused

from liaam.studio.contract import ShapesQuery
from liaam.studio.measuring import kept_in
from liaam.studio.project import Project
from liaam.studio.sets import make_set
from liaam.studio.shapes import shapes, table

NOTHING = {"measures": [], "names": {}, "scale": "", "by": "", "gone": []}


def test_measures_the_scale_and_groups_survive_a_restart(small):
    assert kept_in(small.store) == NOTHING
    small.save_measuring({"add": ["distance:1-2", "angle:a-b-c"], "by": "name"})
    small.save_measuring({"add": ["distance:1-2"], "scale": "a-c=5 mm"})
    kept = kept_in(Project(small.root).store)
    measures = ["distance:1-2", "angle:1-2-3"]
    assert kept == {"measures": measures, "names": {}, "scale": "1-3=5 mm", "by": "name", "gone": []}
    small.save_measuring({"remove": ["distance:1-2"], "scale": "", "by": ""})
    assert kept_in(small.store) == {**NOTHING, "measures": ["angle:1-2-3"]}


def test_measures_follow_their_landmarks_through_a_change_of_the_template(small):
    small.save_measuring({"add": ["wing length=distance:a-c", "angle:a-b-c"], "scale": "b-c=2 mm"})
    small.save_template({"names": ["apex", "new", "a", "b"], "mapping": [2, None, 0, 1]})
    kept = kept_in(Project(small.root).store)
    measures = {"measures": ["distance:3-1", "angle:3-4-1"], "names": {"distance:3-1": "wing length"}}
    assert kept == {**measures, "scale": "4-1=2 mm", "by": "", "gone": []}


def test_measures_whose_landmark_is_gone_are_named_until_that_was_seen(small):
    small.save_measuring({"add": ["width=distance:a-c", "distance:a-b"], "scale": "b-c=2 mm"})
    small.save_template({"names": ["b", "a"], "mapping": [1, 0]})
    kept = kept_in(small.store)
    assert kept["measures"] == ["distance:2-1"] and kept["scale"] == ""
    assert kept["gone"] == ["width (distance: a – c)", "scale: b – c = 2 mm"]
    assert small.save_measuring({"seen": True})["gone"] == []


def test_new_names_change_no_measure(small):
    small.save_measuring({"add": ["distance:a-c"]})
    small.save_template({"names": ["x", "y", "z"]})
    assert kept_in(small.store)["measures"] == ["distance:1-3"]


def test_a_further_observer_measures_the_same(small):
    small.save_measuring({"add": ["distance:a-c"]})
    make_set(small, {"name": "bob", "same": True})
    make_set(small, {"name": "hand", "same": False})
    assert kept_in(small.of_set("bob").store)["measures"] == ["distance:1-3"]
    assert kept_in(small.of_set("hand").store) == NOTHING


def test_columns_of_the_table_have_the_names_of_the_landmarks(small):
    put(small, "p1.png", POINTS)
    rows = csv.DictReader(table(small, ShapesQuery(measures="distance:1-3 length:1-3-2"))[1].decode().splitlines())
    assert {"distance_a_c", "length_a_c_b"} <= {*(rows.fieldnames or ())}


def test_a_measure_has_a_name_of_its_own_in_the_table(small):
    put(small, "p1.png", POINTS)
    small.save_measuring({"add": ["distance:1-3", "distance:1-2", "angle:1-2-3"]})
    small.save_measuring({"names": {"distance:1-3": " Wing length ", "angle:1-2-3": "opening"}})
    asked = ShapesQuery(measures="distance:1-3 distance:1-2 angle:1-2-3")
    rows = csv.DictReader(table(small, asked)[1].decode().splitlines())
    assert {"Wing_length", "distance_a_b", "opening_deg"} <= {*(rows.fieldnames or ())}
    assert [column["called"] for column in shapes(small, asked)["columns"]] == ["Wing length", "", "opening", ""]
    said = str(refused(small.save_measuring, {"names": {"distance:1-2": "wing-length"}}))
    assert "'wing-length' is the name of another measure (distance: a – c): choose another name, or rename" in said
    assert "cannot be called 'side'" in str(refused(small.save_measuring, {"names": {"distance:1-2": "side"}}))
    assert kept_in(small.store)["names"] == {"distance:1-3": "Wing length", "angle:1-2-3": "opening"}
    small.save_measuring({"names": {"distance:1-3": ""}})
    small.save_measuring({"remove": ["angle:1-2-3"]})
    assert kept_in(small.store)["names"] == {}


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ({"add": ["distance:1-9"]}, "there is no landmark '9'"),
        ({"add": ["width:1-2"]}, "measure 'width:1-2'"),
        ({"add": "distance:1-2"}, "add is not valid"),
        ({"scale": "banana"}, "scale 'banana'"),
        ({"scale": 3}, "scale is not valid"),
        ({"scale": "200"}, "scale '200': give its unit, such as '0.005 mm', or '200 px/mm'"),
        ({"by": "size"}, "cannot be grouped by 'size'"),
    ],
)
def test_what_cannot_be_measured_is_refused_and_changes_nothing(small, asked, said):
    assert said in str(refused(small.save_measuring, asked))
    assert kept_in(small.store) == NOTHING


def test_the_page_gets_what_is_measured_and_by_whom(small, serve):
    client = serve(small.root, face=False).client
    assert client.put("/api/measuring", json={"add": ["distance:b-c"]}).json()["measures"] == ["distance:2-3"]
    assert client.put("/api/who", json={"who": " Anna "}).json() == {"who": "Anna"}
    project = client.get("/api/project").json()
    assert project["measuring"]["measures"] == ["distance:2-3"] and project["who"] == "Anna"
    assert client.put("/api/who", json={"who": 7}).status_code == 422
