"""Measures and shapes of all pictures, as the page and the table have them."""

import csv

import numpy as np
import pytest
from small_projects import by_name, put, refused

from liaam.errors import LiaamError
from liaam.io import write_image
from liaam.studio.contract import ShapesQuery
from liaam.studio.project import Project
from liaam.studio.shapes import sample_of, save_groups, shapes, table

BASE = np.array([[2.0, 3], [36, 4], [34, 26], [5, 25], [20, 15]])
TEMPLATE = {"names": ["a", "b", "c", "d", "e"], "contours": [], "mirror": None}


@pytest.fixture
def sample(tmp_path, rng) -> Project:
    """Give eight pictures, the last without landmarks, one of the others without its last point."""
    for folder in ("left", "right"):
        (tmp_path / folder).mkdir()
        for i in range(4):
            write_image(tmp_path / folder / f"{folder[0]}{i}.png", np.full((30, 40, 3), 90, np.uint8))
    project = Project(tmp_path)
    project.save_template(TEMPLATE)
    for i, name in enumerate(by_name(project)):
        points = (BASE + rng.normal(0, 0.5, BASE.shape)).round(2).tolist()
        if i < 7:
            put(project, name, [*points[:4], None] if i == 5 else points)
    return project


def test_each_picture_with_landmarks_has_measures_and_those_that_are_complete_a_shape(sample):
    found = shapes(sample, ShapesQuery(measures="distance:1-2 angle:a-b-c distance:1-2", by="folder"))
    assert len(found["pictures"]) == 7 and found["groups"] == ["left"] * 4 + ["right"] * 3
    assert [column["unit"] for column in found["columns"]] == ["px", "°", "px"]
    assert found["columns"][0]["measure"] == "distance:1-2"
    space = found["space"]
    assert space["of"] == [0, 1, 2, 3, 4, 6] and len(space["scores"]) == 6
    assert space["mean"][0][1] < space["mean"][3][1]  # y downwards, as in the pictures
    assert found["columns"][2]["values"][5] is None  # the centroid size of the incomplete one
    (test,) = found["tests"]
    assert test["groups"] == "left – right" and 0 < test["p"] <= 1
    assert all(0 < column["p"] < 1 for column in found["columns"])
    assert all(column["p"] is None for column in shapes(sample, ShapesQuery())["columns"])


def test_missing_points_are_estimated_if_that_is_asked_for(sample):
    found = shapes(sample, ShapesQuery(estimate="1"))
    assert found["estimated"] == [0, 0, 0, 0, 0, 1, 0]
    assert len(found["space"]["of"]) == 7


def test_shapes_that_are_alike_as_they_are_are_not_reflected(sample):
    assert "compared as they are" in shapes(sample, ShapesQuery())["sides"]


def project_of(folder, names) -> Project:
    """Give pictures with these names, in subfolders, and a template."""
    for name in names:
        (folder / name).parent.mkdir(exist_ok=True)
        write_image(folder / f"{name}.png", np.full((30, 40, 3), 90, np.uint8))
    project = Project(folder)
    project.save_template(TEMPLATE)
    return project


def test_shapes_of_the_left_are_reflected_to_the_right(tmp_path, rng):
    project = project_of(tmp_path, ("left/a", "left/b", "right/c", "right/d"))
    for name in by_name(project):
        points = BASE + rng.normal(0, 0.5, BASE.shape)
        put(project, name, (points * [-1, 1] + [39, 0] if name.startswith("left") else points).tolist())
    found = shapes(project, ShapesQuery())
    assert found["sides"].startswith("2 left specimens were reflected")
    assert max(found["space"]["distances"]) < 0.1


def test_shapes_are_shown_while_some_have_no_side(tmp_path, rng):
    project = project_of(tmp_path, ("left/a", "left/b", "right/c", "unsorted/d"))
    for name in by_name(project):
        put(project, name, (BASE + rng.normal(0, 0.5, BASE.shape)).tolist())
    found = shapes(project, ShapesQuery())
    assert "have no side" in found["sides"]
    assert found["space"] is not None


def test_groups_come_from_a_table_that_is_kept(sample):
    text = "specimen,group\nl0,x\nl1,x\nr0,y\n"
    assert save_groups(sample, {"text": text, "name": "groups.csv"}) == {"specimens": 3}
    found = shapes(Project(sample.root), ShapesQuery(by="table"))
    assert found["groups"] == ["x", "x", "", "", "y", "", ""] and found["has_table"]
    name, data = table(sample, ShapesQuery(by="table", measures="area:1-2-3-4"))
    rows = list(csv.DictReader(data.decode().splitlines()))
    assert name.endswith("-measurements.csv")
    assert rows[4]["group"] == "y" and float(rows[4]["area_a_b_c_d"]) > 0
    assert rows[5]["PC1"] == "" or rows[5]["PC1"] == "nan"
    name, data = table(sample, ShapesQuery(by="table", measures="area:1-2-3-4", only="1"))
    assert name.endswith("-measures.csv")
    of_measures = [*next(csv.DictReader(data.decode().splitlines()))]
    assert of_measures[:2] == ["specimen", "group"] and {"area_a_b_c_d", "centroid_size"} <= {*of_measures}
    assert not {"X1", "Y1", "PC1", "area_a_b_c_d_se"} & {*of_measures}


@pytest.mark.parametrize("text", ["a,b\n1,2\n", "specimen,group\nother,x\n", f"specimen,group\n{'x' * 200_000},y\n"])
def test_a_table_of_something_else_is_refused(sample, text):
    said = r"x\.csv has no columns|no specimen is in the table|x\.csv: this is not a CSV table"
    with pytest.raises(LiaamError, match=said):
        save_groups(sample, {"text": text, "name": "x.csv"})
    assert shapes(sample, ShapesQuery())["has_table"] is False


def test_wrong_requests_are_refused(sample):
    assert "cannot be grouped by 'size'" in str(refused(shapes, sample, ShapesQuery(by="size")))
    assert refused(save_groups, sample, {"text": 1}).status == 422
    with pytest.raises(LiaamError, match="there is no landmark '9'"):
        shapes(sample, ShapesQuery(measures="distance:1-9"))


def test_points_on_a_line_have_no_grid(sample):
    for name, picture in by_name(sample).items():
        points = [[float(x), 10.0] for x in range(1, 6)]
        put(sample, name, points, picture["revision"])
    found = shapes(sample, ShapesQuery())
    assert found["space"]["grid"] is None


def test_shapes_that_are_all_alike_have_a_space_of_no_extent(sample):
    for name, picture in by_name(sample).items():
        put(sample, name, BASE.tolist(), picture["revision"])
    space = shapes(sample, ShapesQuery(by="folder"))["space"]
    assert space["limit"] == 0 and set(space["distances"]) == {0.0} and not np.isnan(space["scores"]).any()


@pytest.mark.parametrize(
    ("names", "groups"),
    [
        (("male_01", "male_02", "female_01", "female_02"), ("male", "male", "female", "female")),
        (("wing01_A", "wing02_A", "wing16_B", "wing17_B"), ("A", "A", "B", "B")),
        (("fly five", "wing02_A", "wing01_A", "wing16_B", "wing17_B"), ("five", "A", "A", "B", "B")),
        (("a1", "a2", "a3"), ("a", "a", "a")),
    ],
)
def test_pictures_are_grouped_by_the_letters_in_which_their_names_differ(tmp_path, names, groups):
    project = project_of(tmp_path, names)
    for name in by_name(project):
        put(project, name, BASE.tolist())
    found = shapes(project, ShapesQuery(by="name"))
    by_picture = dict(zip(found["pictures"], found["groups"], strict=True))
    assert by_picture == {f"{name}.png": group for name, group in zip(names, groups, strict=True)}


def test_pictures_without_a_scale_are_named_where_others_have_one(sample):
    assert shapes(sample, ShapesQuery(scale="mm"))["unscaled"] == []  # in pixels while no picture has a scale
    first, *_ = by_name(sample)
    bar = {"ends": [[0.0, 0.0], [20.0, 0.0]], "length": 10.0, "unit": "mm"}
    sample.review({"pictures": [first], "did": "scaled", "bar": bar, "of": first})
    assert shapes(sample, ShapesQuery())["unscaled"] == [1, 2, 3, 4, 5, 6]
    columns = sample_of(sample, ShapesQuery(scale="0.25 mm")).columns
    assert columns["scale_mm_per_px"] == [0.5] + [0.25] * 6  # the first has its own
