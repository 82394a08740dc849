"""Which side of its object a picture shows: said by a person, by a table, by names or by shapes, and what follows."""

import csv
import io
import re

import numpy as np
import pytest
from small_projects import put

from liaam.datasets import load_folder
from liaam.datasets.sides import sides_of_shapes
from liaam.io import Landmarks, write_image, write_landmarks
from liaam.studio.background import slips_in
from liaam.studio.contract import ShapesQuery
from liaam.studio.model_store import ModelStore, model_json
from liaam.studio.project import Annotated, Project
from liaam.studio.refusal import Refusal
from liaam.studio.shapes import shapes
from liaam.studio.sides import completed, for_measuring, parse_sides

BODY = np.array([[0, 0], [26, -6], [52, 4], [60, 22], [34, 30], [8, 24], [24, 12], [40, 14]], float)


def shapes_of(rng, which):
    """Draw shapes of one body, mirrored where ``which`` says so."""
    noise = rng.normal(0, 0.5, (len(which), *BODY.shape))
    return (BODY + noise) * np.where(np.array(which)[:, None, None], [-1.0, 1.0], 1.0) + (90, 40)


@pytest.fixture
def sided(tmp_path, rng):
    """Give a folder of ten pictures, of which the first four are mirrored, with names that tell no sides."""
    for i, points in enumerate(shapes_of(rng, np.arange(10) < 4)):
        write_image(tmp_path / f"wing-{i}.png", np.full((120, 180, 3), 90 + i, np.uint8))
        write_landmarks(tmp_path / f"wing-{i}.ljson", Landmarks(points))
    return tmp_path


def test_one_side_that_is_said_tells_those_of_all_by_their_shapes(rng):
    which = np.arange(9) < 3
    names = [f"wing-{i}" for i in range(9)]
    expected = ["left" if each else "right" for each in which]
    said = [""] * 9
    assert completed(said, names, shapes_of(rng, which)) == said
    said[1] = "left"
    assert completed(said, names, shapes_of(rng, which)) == expected
    assert completed(["", "", "", "right"] + [""] * 5, names, shapes_of(rng, which)) == expected
    assert completed(said, names, shapes_of(rng, ~which | which)) == ["left"] * 9


def test_names_count_below_what_a_person_says(rng):
    names = ["a_left", "b_right", "c_left"]
    assert completed(["", "", "right"], names, shapes_of(rng, [True, False, False])) == ["left", "right", "right"]


def test_sides_that_the_shapes_do_not_tell_are_not_made_up(rng):
    said = ["left", "right", "", "", "", ""]
    assert completed(said, [f"{i}" for i in range(6)], rng.normal(size=(6, 8, 2))) == [""] * 6


def test_sides_are_said_withdrawn_and_follow_the_picture(sided):
    project = Project(sided)
    before = {each["name"]: each["revision"] for each in project.overview().pictures}
    trained_on = project.overview().done
    assert project.save_sides({"sides": {"wing-0.png": "left"}}) == {"before": {"wing-0.png": ""}}
    assert project.save_sides({"sides": {"wing-0.png": "right"}}) == {"before": {"wing-0.png": "left"}}
    shown = {each["name"]: each for each in Project(sided).overview().pictures}
    assert [shown[name]["side"] for name in ("wing-0.png", "wing-1.png")] == ["right", ""]
    assert {name: each["revision"] for name, each in shown.items()} == before  # no file is written
    changed = {name for name, version in project.overview().done.items() if trained_on[name] != version}
    assert changed == {"wing-0.png"}  # so that a model is trained again
    project.save_sides({"sides": {"wing-0.png": ""}})
    assert project.overview().done == trained_on


def test_the_side_of_a_picture_is_found_before_anybody_says_it(sided):
    project = Project(sided)
    found = [project.found_side(f"wing-{i}.png") for i in range(10)]
    assert [each["side"] for each in found] == ["mirrored"] * 4 + ["original"] * 6 and all(
        each["both"] for each in found
    )
    project.save_sides({"sides": {"wing-9.png": "left"}})
    assert project.found_side("wing-0.png")["side"] == "right"
    write_image(sided / "new.png", np.zeros((120, 180, 3), np.uint8))
    assert project.found_side("new.png") == {"side": "", "both": True}  # it has no landmarks
    for path in sided.glob("*.ljson"):
        path.unlink()
    assert project.found_side("new.png") == {"side": "", "both": False}


def test_exported_files_say_which_pictures_are_mirrored(sided):
    project = Project(sided)
    sides = re.findall("COMMENT=side=(.*)", project.export("tps")[1].decode())
    assert sides == ["mirrored"] * 4 + ["original"] * 6 and project.has_both_sides()
    table = project.export("csv")[1].decode()
    assert [row["side"] for row in csv.DictReader(io.StringIO(table))][::8] == sides
    (sided / "table").mkdir()
    (sided / "table" / "all.csv").write_text(table)
    for path in sided.glob("*.png"):
        write_image(sided / "table" / path.name, np.zeros((120, 180, 3), np.uint8))
    read = Project(sided / "table")  # what shapes told is not stated, and they tell it again
    assert {each["side"] for each in read.overview().pictures} == {""} and read.export("csv")[1].decode() == table
    assert {sample.side for sample in load_folder(sided / "table")} == {""}
    project.save_sides({"sides": {"wing-0.png": "left"}})
    sides = re.findall("COMMENT=side=(.*)", project.export("tps")[1].decode())
    assert sides == ["left"] * 4 + ["right"] * 6


def test_a_side_that_is_stated_or_withdrawn_after_a_training_is_told(sided, head_model):
    project = Project(sided)
    project.save_sides({"sides": {"wing-1.png": "left"}})
    overview = project.overview()
    del overview.done["wing-9.png"]  # placed after the training
    facts = {"source": "studio", "trained": None, "pictures": overview.done}

    def has_changed(facts):
        now = project.overview()
        return model_json(ModelStore().publish(head_model, facts), now.done, sides=now.sides)["sides_changed"]

    assert not has_changed(facts)  # of an earlier version, which did not note the sides
    facts["sides"] = overview.sides
    assert not has_changed(facts)
    project.save_sides({"sides": {"wing-9.png": "right"}})
    assert not has_changed(facts)
    project.save_sides({"sides": {"wing-0.png": "left"}})
    assert has_changed(facts)
    project.save_sides({"sides": {"wing-0.png": ""}})
    assert not has_changed(facts)
    project.save_sides({"sides": {"wing-1.png": ""}})
    assert has_changed(facts)


@pytest.mark.parametrize("sides", [None, {}, {"wing-0.png": "up"}, {"wing-0.png": None}, ["wing-0.png"], "left"])
def test_other_sides_are_refused(sides):
    with pytest.raises(Refusal, match="left, right or nothing"):
        parse_sides(sides)


def test_the_side_of_a_table_stays_when_points_are_moved(sided):
    project = Project(sided)
    project.save_sides({"sides": {f"wing-{i}.png": "left" if i < 4 else "right" for i in range(10)}})
    table = project.export("csv")[1].decode()
    rows = list(csv.DictReader(io.StringIO(table)))
    assert {(row["image"], row["side"]) for row in rows} >= {("wing-0.png", "left"), ("wing-9.png", "right")}

    for path in [*sided.glob("*.ljson"), *sided.glob(".liaam-studio/studio.db")]:
        path.unlink()
    (sided / "all.csv").write_text(table)
    project = Project(sided)
    sides = {each["name"]: each["side"] for each in project.overview().pictures}
    assert sides["wing-0.png"] == "left" and sides["wing-9.png"] == "right"
    marks = project.marks("wing-0.png")
    marks["points"][0][0] += 3
    put(project, "wing-0.png", marks["points"], marks["revision"])
    assert (sided / "wing-0.ljson").exists()
    assert {each["name"]: each["side"] for each in Project(sided).overview().pictures} == sides


def test_a_table_that_is_exported_has_the_sides_that_a_stated_one_tells(sided):
    """Training refuses a table in which some pictures have a side and others have none."""
    project = Project(sided)
    project.save_sides({"sides": {"wing-0.png": "left"}})
    rows = csv.DictReader(io.StringIO(project.export("csv")[1].decode()))
    sides = {row["image"]: row["side"] for row in rows}
    assert sides == {f"wing-{i}.png": "left" if i < 4 else "right" for i in range(10)}


def test_other_words_in_a_column_of_sides_are_left_as_they_are(rng):
    stated = ["dorsal", "", "left"]
    assert completed(stated, ["a", "b", "c"], shapes_of(rng, [True, False, False])) == stated


def test_shapes_are_measured_reflected_whether_or_not_a_side_is_stated(sided):
    project = Project(sided)
    by_shape = shapes(project, ShapesQuery())
    assert by_shape["sides"].startswith("4 mirrored specimens were reflected")
    assert max(by_shape["space"]["distances"]) < 0.1  # mirrored ones would be far from the others
    project.save_sides({"sides": {"wing-0.png": "left"}})
    stated = shapes(project, ShapesQuery())
    assert stated["sides"].startswith("4 left specimens were reflected")
    assert max(stated["space"]["distances"]) == pytest.approx(max(by_shape["space"]["distances"]))


@pytest.mark.parametrize("mirrored", [1, 2, 3])
def test_a_few_mirrored_shapes_are_measured_reflected_as_they_are_trained(rng, mirrored):
    which = np.arange(30) < mirrored
    names = [f"{i}" for i in range(30)]
    expected = ["mirrored" if each else "original" for each in which]
    found = shapes_of(rng, which)
    assert for_measuring([""] * 30, names, found) == expected
    assert (sides_of_shapes(found, [""] * 30, names).is_other == which).all()  # by which training goes


def test_mirrored_objects_are_no_slips_however_few_they_are(rng):
    def found(which, sides):
        items = [
            Annotated(f"wing-{i}.png", None, points, np.ones(8, bool), "1", side=side)
            for i, (points, side) in enumerate(zip(shapes_of(rng, which), sides, strict=True))
        ]
        return slips_in(items)

    several = np.arange(12) < 4
    assert found(several, [""] * 12) == {}
    one = np.arange(12) < 1
    assert found(one, [""] * 12) == {}
    assert found(one, ["left"] + [""] * 11) == {}


def test_exchanged_points_of_a_mirrored_object_are_a_slip(rng):
    points = shapes_of(rng, np.arange(12) < 1)
    points[0][[1, 3]] = points[0][[3, 1]]
    items = [Annotated(f"wing-{i}.png", None, each, np.ones(8, bool), "1") for i, each in enumerate(points)]
    assert [*slips_in(items)] == ["wing-0.png"]
    _, said, points_of_slip = slips_in(items, tuple("abcdefgh"))["wing-0.png"]
    assert points_of_slip == [1, 2, 3] and said.startswith("points b, c, d are in reverse order")


def test_the_page_says_sides_by_a_request(sided, serve):
    client = serve(sided, face=False).client
    answer = client.put("/api/sides", json={"sides": {"wing-3.png": "left"}})
    assert (answer.status_code, answer.json()) == (200, {"before": {"wing-3.png": ""}})
    pictures = client.get("/api/project").json()["pictures"]
    assert [each["side"] for each in pictures if each.get("side")] == ["left"]
    assert client.put("/api/sides", json={"sides": {"no.png": "left"}}).status_code == 404
