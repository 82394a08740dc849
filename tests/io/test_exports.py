"""Exports of annotation tools, spreadsheets and ImageJ's selections, as their programs write them."""

import csv
import io
import json
import struct
import warnings
import zipfile
import zlib
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from liaam.datasets import load_folder
from liaam.errors import LandmarkError
from liaam.io import Reading, read_landmarks, write_image
from liaam.io.landmarks import Landmarks, parse_landmark_data, spreadsheets, unpacking
from liaam.io.landmarks.formats import name_of
from liaam.io.landmarks.reading import Notes
from tests.setups import growth

SIZE = (200.0, 160.0)
POINTS = [(10.0, 20.0), (30.5, 40.0), (50.0, 60.25)]
NAMES = ["tip", "base", "end"]


def parse(name: str, content: Any, **options: Any) -> Any:
    text = content if isinstance(content, (str, bytes)) else json.dumps(content)
    return parse_landmark_data(name, text if isinstance(text, bytes) else text.encode(), SIZE, **options)


def assert_points(read: Any, names: tuple[str, ...] | list[str] = (), image: str = "") -> None:
    landmarks = read[image] if image else read
    assert isinstance(landmarks, Landmarks)
    np.testing.assert_allclose(landmarks.points, POINTS, atol=1e-6)
    assert landmarks.names == tuple(names)


def table(*rows: list[Any]) -> str:
    buffer = io.StringIO()
    csv.writer(buffer).writerows(rows)
    return buffer.getvalue()


# VIA ----------------------------------------------------------------------------------------------


def via_regions(facts: list[dict]) -> list[dict]:
    return [
        {"shape_attributes": {"name": "point", "cx": x, "cy": y}, "region_attributes": fact}
        for (x, y), fact in zip(POINTS, facts, strict=True)
    ]


@pytest.mark.parametrize("project", [False, True])
@pytest.mark.parametrize("version", [1, 2])
def test_via_as_json(project: bool, version: int) -> None:
    regions: Any = via_regions([{"landmark": name, "kind": "x"} for name in NAMES])
    if version == 1:
        regions = {str(i): region for i, region in enumerate(regions)}
    records = {"a.png99": {"filename": "a.png", "size": 99, "regions": regions}}
    assert_points(parse("a.json", {"_via_img_metadata": records} if project else records), NAMES, "a.png")


@pytest.mark.parametrize("title", ["filename", "#filename"])
def test_via_as_table(title: str) -> None:
    header = [title, "file_size", "file_attributes", "region_count", "region_id"]
    header += ["region_shape_attributes", "region_attributes"]
    rows = [
        ["a.png", 9, "{}", 3, i, json.dumps(each["shape_attributes"]), json.dumps(each["region_attributes"])]
        for i, each in enumerate(via_regions([{"n": {name: True, "no": False}} for name in NAMES]))
    ]
    empty = ["b.png", 9, "{}", 0, 0, "{}", "{}"]
    assert_points(parse("a.csv", table(header, *rows, empty)), NAMES, "a.png")


def test_objects_of_an_image_in_via_are_told_by_another_attribute() -> None:
    regions = [
        each | {"shape_attributes": each["shape_attributes"] | {"cx": each["shape_attributes"]["cx"] + shift}}
        for shift, label in ((0, "left"), (100, "right"))
        for each in via_regions([{"side": label, "landmark": name} for name in NAMES])
    ]
    read = parse("a.json", {"a.png": {"filename": "a.png", "regions": regions}})["a.png"]
    assert [read.label, read.others[0].label] == ["left", "right"]
    np.testing.assert_allclose(read.others[0].points, np.add(POINTS, [100, 0]))


def test_points_of_via_without_attributes_and_its_lines_are_in_order() -> None:
    regions = via_regions([{}, {}, {}])
    assert_points(parse("a.json", {"a": {"filename": "a.png", "regions": regions}}), (), "a.png")
    xs, ys = map(list, zip(*POINTS, strict=True))
    line = {"shape_attributes": {"name": "polyline", "all_points_x": xs, "all_points_y": ys}, "region_attributes": {}}
    assert_points(parse("a.json", {"a": {"filename": "a.png", "regions": [line]}}), (), "a.png")


# YOLO ---------------------------------------------------------------------------------------------


def yolo_line(values: int, flags: tuple[int, ...] = (2, 2, 2), label: int = 0, box: float = 0.3) -> str:
    cells = [str(label), "0.5", "0.5", str(box), str(box)]
    for (x, y), flag in zip(POINTS, flags, strict=True):
        cells += [f"{x / SIZE[0]:.6f}", f"{y / SIZE[1]:.6f}", str(flag)][:values]
    return " ".join(cells)


@pytest.mark.parametrize("values", [2, 3])
@pytest.mark.parametrize("settings_text", ["", "kpt_shape: [3, {}]\nnames:\n  0: leaf\n", "kpt_shape:\n- 3\n- {}\n"])
def test_yolo_pose(tmp_path: Path, values: int, settings_text: str) -> None:
    (tmp_path / "a.txt").write_text(yolo_line(values) + "\n")
    if settings_text:
        (tmp_path / "data.yaml").write_text(settings_text.format(values))
    np.testing.assert_allclose(read_landmarks(tmp_path / "a.txt", SIZE).points, POINTS, atol=2e-4)


def test_yolo_objects_flags_names_and_classes(tmp_path: Path) -> None:
    lines = [yolo_line(3, (2, 1, 0), box=0.1), yolo_line(3, label=1)]
    (tmp_path / "a.txt").write_text("\n".join(lines))
    (tmp_path / "data.yaml").write_text(
        "kpt_shape: [3, 3]\nnames: {0: leaf, 1: 'big leaf'}\nkpt_names:\n  0:\n  - tip\n  - base\n  - end\n"
    )
    read = read_landmarks(tmp_path / "a.txt", SIZE)
    assert read.names == tuple(NAMES)
    [small] = read.others
    assert (small.invisible, small.missing.tolist()) == ((1,), [False, False, True])
    only = read_landmarks(tmp_path / "a.txt", SIZE, reading=Reading(category="leaf"))
    assert not only.others and only.missing.any()
    with pytest.raises(LandmarkError, match="no objects of the class 'wing'"):
        read_landmarks(tmp_path / "a.txt", SIZE, reading=Reading(category="wing"))


@pytest.mark.parametrize("given", ["images", "labels", "."])
def test_yolo_folders_of_images_and_labels(tmp_path: Path, given: str) -> None:
    for kind in ("images", "labels"):
        (tmp_path / kind / "train").mkdir(parents=True)
    for name in "ab":
        write_image(tmp_path / f"images/train/{name}.png", np.zeros((160, 200, 3), np.uint8))
        (tmp_path / f"labels/train/{name}.txt").write_text(yolo_line(3))
    (tmp_path / "data.yaml").write_text("kpt_shape: [3, 3]\n")
    data = load_folder(tmp_path / given, recursive=True)
    assert len(data) == 2
    np.testing.assert_allclose(data[0].landmarks.points, POINTS, atol=2e-4)


def test_yolo_files_that_do_not_hold_points_are_named(tmp_path: Path) -> None:
    with pytest.raises(LandmarkError, match="file of YOLO has boxes only, not x and y of points: export pose labels"):
        parse("a.txt", "0 0.5 0.5 0.1 0.1\n1 0.2 0.3 0.1 0.1\n")
    (tmp_path / "data.yaml").write_text("kpt_shape: [4, 3]\n")
    (tmp_path / "a.txt").write_text(yolo_line(3))
    with pytest.raises(LandmarkError, match="says 4 points of 3 numbers, but a line has 9 numbers behind its box"):
        read_landmarks(tmp_path / "a.txt", SIZE)


def test_yolo_flags_written_with_decimals(tmp_path: Path) -> None:
    line = yolo_line(2).split()
    pairs = [f"{x} {y} {flag}" for x, y, flag in zip(line[5::2], line[6::2], ("2.000000", "1.0", "0.0"), strict=True)]
    six = " ".join([*line[:5], *pairs, *pairs])  # 18 numbers, which nine pairs have too
    read = parse("a.txt", six)
    assert (len(read), read.invisible, read.missing.tolist()) == (6, (1, 4), [False, False, True] * 2)


def test_yolo_says_that_it_takes_numbers_for_pairs_where_nothing_tells(tmp_path: Path) -> None:
    notes = Notes()
    assert len(parse("a.txt", "0 .5 .5 .4 .3 .1 .2 .93 .3 .4 .88", notes=notes)) == 3
    assert notes.lines() == ["points of YOLO are taken for x and y, since no data.yaml has kpt_shape: a.txt"]
    notes = Notes()
    assert len(parse("a.txt", "0 .5 .5 .4 .3 .1 .2 .93 .3", notes=notes)) == 2
    assert notes.lines() == []


def test_yolo_objects_without_a_point_do_not_come_first() -> None:
    read = parse("a.txt", "0 .5 .5 .9 .9 0 0 0 0 0 0\n0 .5 .5 .1 .1 .1 .2 2 .3 .4 2\n")
    assert not read.missing.any() and not read.others
    assert parse("a.txt", "0 .5 .5 .9 .9 0 0 0 0 0 0\n").missing.all()


def test_yolo_points_at_minus_one_or_nan_are_missing() -> None:
    assert parse("a.txt", "0 .5 .5 .4 .3 .1 .2 -1 -1 nan nan .5 .5").missing.tolist() == [False, True, True, False]


def test_yolo_lines_of_several_lengths_are_named() -> None:
    with pytest.raises(LandmarkError, match="line 2 has 5 numbers, but line 1 has 9: give each object its class"):
        parse("a.txt", "0 .5 .5 .4 .3 .1 .2 .3 .4\n0 .5 .5 .4 .3\n")


@pytest.mark.parametrize("text", ["\n", "kpt_names:\n  0: {}", "kpt_shape: [{}", "names:{}", " \n"])
def test_time_to_read_yolo_s_settings_is_linear(tmp_path: Path, text: str) -> None:
    (tmp_path / "a.txt").write_text(yolo_line(3))

    def work(size: int) -> None:
        filling = "1" * size if "{}" in text else text * size
        (tmp_path / "data.yaml").write_text(text.format(filling) if "{}" in text else filling)
        assert len(read_landmarks(tmp_path / "a.txt", SIZE)) == 3

    assert growth(work, 10_000) < 30


# Tables -------------------------------------------------------------------------------------------


def test_napari() -> None:
    rows = [[i, y, x] for i, (x, y) in enumerate(POINTS)]
    assert_points(parse("a.csv", table(["index", "axis-0", "axis-1"], *rows)))
    stack = [[i, 3.0, y, x] for i, (x, y) in enumerate(POINTS)]
    header = ["index", "axis-0", "axis-1", "axis-2"]
    assert_points(parse("a.csv", table(header, *stack)))
    stack[0][1] = 4.0
    with pytest.raises(LandmarkError, match="lie on several planes of a stack"):
        parse("a.csv", table(header, *stack))
    with pytest.raises(LandmarkError, match="holds shapes of napari, not points"):
        parse("a.csv", table(["index", "shape-type", "vertex-index", "axis-0", "axis-1"], [0, "path", 0, 1, 2]))


def test_napari_axes_are_told_by_their_numbers() -> None:
    rows = [[i, x, y] for i, (x, y) in enumerate(POINTS)]
    assert_points(parse("a.csv", table(["index", "axis-1", "axis-0"], *rows)))
    stack = [[i, y, x, plane] for i, ((x, y), plane) in enumerate(zip(POINTS, ("3", "3.0", "3.00"), strict=True))]
    assert_points(parse("a.csv", table(["index", "axis-1", "axis-2", "axis-0"], *stack)))
    for header in (["index", "axis-0", "axis-2"], ["index", "axis-0"], ["index", "axis-0", "axis-1", "axis-1"]):
        with pytest.raises(LandmarkError, match="its axes are not axis-0, axis-1 and so on, each once"):
            parse("a.csv", table(header, [0, 1, 2, 3][: len(header)]))


def test_makesense_names_the_line_of_a_fault_and_takes_numbers_for_names() -> None:
    with pytest.raises(LandmarkError, match="'x' in line 2 is not a number"):
        parse("a.csv", table(["a", 1, 2, "a.png", 200, 160], ["b", "x", 4, "a.png", 200, 160]))
    rows = [[i, x, y, "a.png", 200, 160] for i, (x, y) in enumerate(POINTS, 1)]
    assert_points(parse("a.csv", table(*rows)), (), "a.png")


def test_a_cell_of_a_megabyte_is_named() -> None:
    with pytest.raises(LandmarkError, match="end the quotes, or export JSON if cells are that long"):
        parse("a.csv", "x,y\n1,2\n" + "1" * 200_000)


def test_points_with_and_without_a_name_are_named_so() -> None:
    with pytest.raises(LandmarkError, match="2 of the points of an object have no name: name each of them, or none"):
        parse("a.csv", table(["axis-0", "axis-1", "name"], [1, 2, "a"], [3, 4, ""], [5, 6, ""]))
    assert parse("a.csv", table(["axis-0", "axis-1", "name"], [1, 2, ""])).names == ()


def test_sleap_rows_without_a_frame_or_body_parts_are_named() -> None:
    header = ["track", "frame_idx", "a.x", "a.y", "b.x", "b.y"]
    notes = Notes()
    assert list(parse("a.csv", table(header, ["m", "", 1, 2, 3, 4], ["m", 7, 1, 2, 3, 4]), notes=notes)) == ["7"]
    assert "left out line 2 (because it has no number of its frame" in notes.lines()[0]
    with pytest.raises(LandmarkError, match="no columns of body parts"):
        parse("a.csv", table(header[:2], ["m", 7]))


def test_via_images_of_one_name_or_none_are_named() -> None:
    regions = via_regions([{"n": name} for name in NAMES])
    two = {f"a.png{size}": {"filename": "a.png", "size": size, "regions": regions} for size in (9, 10)}
    notes = Notes()
    assert_points(parse("a.json", two, notes=notes), NAMES, "a.png")
    assert "two images are named 'a.png', of 9 and 10 bytes: rename one" in notes.lines()[0]
    with pytest.raises(LandmarkError, match="has no file name of its image"):
        parse("a.json", {"9": {"filename": "", "size": 9, "regions": regions}})
    header = ["filename", "region_shape_attributes", "region_attributes"]
    shape = json.dumps(regions[0]["shape_attributes"])
    assert list(parse("a.csv", table(header, ["b.png", "", ""], ["", "", ""], ["a.png", shape, "{}"]))) == ["a.png"]


def test_makesense_without_a_first_line() -> None:
    rows = [
        [name, x, y, image, 200, 160]
        for image in ("a.png", "b.png")
        for name, (x, y) in zip(NAMES, POINTS, strict=True)
    ]
    read = parse("a.csv", table(*rows))
    assert_points(read, NAMES, "a.png")
    assert_points(read, NAMES, "b.png")


def test_sleap_table_of_several_animals() -> None:
    header = ["track", "frame_idx", "instance.score"] + [
        f"{name}.{what}" for name in NAMES for what in ("x", "y", "score")
    ]
    rows = [
        [track, frame, 7.5, *(value for x, y in POINTS for value in (x + shift, y, 0.9))]
        for frame in (5, 10)
        for track, shift in (("mouse", 0), ("rat", 50))
    ]
    rows[-1][-3:-1] = ["", ""]
    read = parse("a.csv", table(header, *rows))
    assert list(read) == ["5", "10"]
    assert_points(read, NAMES, "5")
    assert [name for name, _ in read["10"].objects("10")] == ["10#mouse", "10#rat"]
    assert read["10"].others[0].missing.tolist() == [False, False, True]


def label_studio_marks() -> list[dict[str, Any]]:
    size = {"original_width": 200, "original_height": 160}
    return [
        {**size, "x": x / 2, "y": y / 1.6, "width": 0.5, "keypointlabels": [name]}
        for name, (x, y) in zip(NAMES, POINTS, strict=True)
    ]


def test_label_studio_table() -> None:
    header = ["img", "id", "kp", "annotator", "created_at"]
    row = ["/data/upload/1/0a1b2c3d-a.png", 1, json.dumps(label_studio_marks()), 1, "2024-01-01T00:00:00.0Z"]
    assert_points(parse("a.csv", table(header, row)), NAMES, "/data/upload/1/0a1b2c3d-a.png")


@pytest.mark.parametrize("how", ["relations", "boxes"])
@pytest.mark.parametrize("turned", [False, True])
def test_label_studio_points_of_several_boxes(how: str, turned: bool) -> None:
    size = {"original_width": 200, "original_height": 160}
    results: list[dict[str, Any]] = []
    for i, shift in enumerate((0, 40)):
        box = {"x": 2 + shift, "y": 5, "width": 30, "height": 50, "rectanglelabels": ["leaf"]}
        results.append({**size, "id": f"b{i}", "type": "rectanglelabels", "value": box})
        for j, mark in enumerate(label_studio_marks()):
            value = {"x": mark["x"] + shift, "y": mark["y"], "keypointlabels": mark["keypointlabels"]}
            results.append({**size, "id": f"k{i}{j}", "type": "keypointlabels", "value": value})
            if how == "relations":
                ends = (f"b{i}", f"k{i}{j}") if turned else (f"k{i}{j}", f"b{i}")
                results.append({"type": "relation", "from_id": ends[0], "to_id": ends[1], "direction": "right"})
    task = {"id": 1, "data": {"image": "a.png"}, "annotations": [{"result": results}]}
    read = parse("a.json", [task])["a.png"]
    np.testing.assert_allclose(read.points, POINTS)
    np.testing.assert_allclose(read.others[0].points, np.add(POINTS, [80, 0]))


# JSON of an image ---------------------------------------------------------------------------------


def test_labelme_points_in_boxes() -> None:
    shapes: list[dict[str, Any]] = []
    for shift in (0, 90):
        shapes.append({"label": "leaf", "points": [[55 + shift, 70], [5 + shift, 10]], "shape_type": "rectangle"})
        shapes += [
            {"label": name, "points": [[x + shift, y]], "shape_type": "point", "group_id": None}
            for name, (x, y) in zip(NAMES, POINTS, strict=True)
        ]
    content: dict[str, Any] = {"shapes": shapes, "imagePath": "a.png", "imageWidth": 200, "imageHeight": 160}
    read = parse("a.json", content)
    assert_points(read, NAMES)
    np.testing.assert_allclose(read.others[0].points, np.add(POINTS, [90, 0]))
    shapes[0]["points"] = [[5, 10], [25, 70]]
    with pytest.raises(LandmarkError, match="point 'base' lies in no box: group the points by object"):
        parse("a.json", content)


def feature(kind: str, coordinates: Any, **properties: Any) -> dict[str, Any]:
    return {"type": "Feature", "geometry": {"type": kind, "coordinates": coordinates}, "properties": properties}


def test_geojson_of_qupath() -> None:
    points = [
        feature("Point", list(pair), objectType="annotation", classification={"name": name})
        for name, pair in zip(NAMES, POINTS, strict=True)
    ]
    cell = feature("Polygon", [[[0, 0], [1, 0], [1, 1], [0, 0]]])
    for content in ({"type": "FeatureCollection", "features": [*points, cell]}, [*points, cell]):
        assert_points(parse("a.geojson", content), NAMES)
        assert_points(parse("a.json", content), NAMES)
    assert_points(parse("a.geojson", [feature("MultiPoint", POINTS, classification={"name": "tips"})]))
    with pytest.raises(LandmarkError, match="GeoJSON without points: place the landmarks as points"):
        parse("a.geojson", [cell])


def test_markups_of_slicer(tmp_path: Path) -> None:
    controls = [
        {"label": name, "position": [x, y, 0.0], "positionStatus": "defined"}
        for name, (x, y) in zip(NAMES, POINTS, strict=True)
    ]
    markup = {"type": "Fiducial", "coordinateSystem": "LPS", "controlPoints": controls}
    assert_points(parse("a.mrk.json", {"markups": [markup]}), NAMES)
    lines = [
        f"n{i},{-x},{-y},0,0,0,0,1,1,1,0,{name},," for i, (name, (x, y)) in enumerate(zip(NAMES, POINTS, strict=True))
    ]
    head = "# Markups fiducial file version = 4.10\n# CoordinateSystem = {}\n"
    head += "# columns = id,x,y,z,ow,ox,oy,oz,vis,sel,lock,label,desc,associatedNodeID\n"
    for system in ("0", "RAS"):
        assert_points(parse("a.fcsv", head.format(system) + "\n".join(lines)), NAMES)
    controls[0]["position"][2] = 4.0
    with pytest.raises(LandmarkError, match="differ in z, so they are not those of a picture"):
        parse("a.mrk.json", {"markups": [markup]})
    write_image(tmp_path / "a.png", np.zeros((160, 200, 3), np.uint8))
    controls[0]["position"][2] = 0.0
    (tmp_path / "a.mrk.json").write_text(json.dumps({"markups": [markup]}))
    assert_points(load_folder(tmp_path)[0].landmarks, NAMES)


def test_fiducials_of_slicer_with_a_comma_in_a_label() -> None:
    text = '# CoordinateSystem = LPS\n# columns = id,x,y,z,label\na,1,2,0,"p, left"\nb,3,4,0,q\n'
    assert parse("a.fcsv", text).names == ("p, left", "q")


def test_time_to_read_the_comments_of_slicer_is_linear() -> None:
    def work(size: int) -> None:
        text = f"# columns = id,x,y,z,l{' ' * size}x\n#{' ' * size}\n# a = {' ' * size}.\na,1,2,0,p\nb,3,4,0,q\n"
        assert len(parse("a.fcsv", text)) == 2

    assert growth(work, 10_000) < 30


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ({"version": "2.0", "item": {}, "annotations": []}, "an export of Darwin"),
        ([{"data_title": "a.png", "data_units": {}}], "an export of Encord"),
        ([{"image": "a.png", "annotations": [{"label": "p", "coordinates": {"x": 1}}]}], "an export of CreateML"),
    ],
)
def test_other_tools_are_named(content: Any, words: str) -> None:
    with pytest.raises(LandmarkError, match=words):
        parse("a.json", content)


def test_boxes_of_labelimg_are_named() -> None:
    box = "<annotation><object><name>p</name><bndbox><xmin>1</xmin></bndbox></object></annotation>"
    with pytest.raises(LandmarkError, match=r"labelImg .* which holds boxes, not points"):
        parse("a.xml", box)


# Morphometric files -------------------------------------------------------------------------------


def test_morphologika() -> None:
    text = "[individuals]\r\n2\r\n[landmarks]\r\n3\r\n[dimensions]\r\n2\r\n[names]\r\na\r\nb c\r\n"
    text += "[wireframe]\r\n1 2\r\n2 3\r\n[rawpoints]\r\n'a\r\n10 20\r\n30.5\t40\r\n50 60.25\r\n"
    text += "'b c\r\n1 2\r\n9999 9999\r\n5 6\r\n"
    read = parse("shapes.txt", text)
    assert_points(read, (), "a")
    assert read["a"].contours[0].indices == (0, 1, 2)
    assert read["b c"].missing.tolist() == [False, True, False]
    assert list(parse("shapes.txt", text.replace("[names]\r\na\r\nb c\r\n", ""))) == ["a", "b c"]
    with pytest.raises(LandmarkError, match="promises 6 points but 5 are there"):
        parse("shapes.txt", text.replace("5 6\r\n", ""))
    with pytest.raises(LandmarkError, match="x, y and z"):
        parse("shapes.txt", text.replace("[dimensions]\r\n2", "[dimensions]\r\n3"))


@pytest.mark.parametrize(("n", "points"), [(999_999_999, 0), (0, 2), (999_999_999, 2)])
def test_morphologika_s_counts_are_checked_before_they_are_used(n: int, points: int) -> None:
    with pytest.raises(LandmarkError, match=r"it says that it has|points but 0 are there"):
        parse("a.txt", f"[individuals]\n{n}\n[landmarks]\n{points}\n[rawpoints]\n")


def test_scale_of_stereomorph() -> None:
    text = "<shapes>\n<scaling type=vector >0.05</scaling>\n<landmarks.pixel type=matrix >\n"
    text += "\ttip\t10\t20\n\tb\t1\t2\n</landmarks.pixel>\n"
    assert parse("a.txt", text).scale == 0.05
    assert parse("a.txt", text).unit == ""
    units = "</scaling>\n<scaling.units type=v >mm</scaling.units>"
    assert parse("a.txt", text.replace("</scaling>", units)).unit == "mm"
    assert parse("a.txt", text.replace("0.05", "NA")).scale is None
    notes = Notes()
    assert parse("a.txt", text.replace("0.05", "-1"), notes=notes).scale is None
    assert notes.lines() == ["there is no scale, because scaling is not a positive number: a.txt"]


@pytest.mark.parametrize("name", ["all.tps.txt", "all.txt", "ALL.TPS.TXT"])
def test_a_tps_file_with_the_ending_that_windows_hides(tmp_path: Path, name: str) -> None:
    rows = "\n".join(f"{x} {SIZE[1] - 1 - y}" for x, y in POINTS)
    write_image(tmp_path / "a.png", np.zeros((160, 200, 3), np.uint8))
    (tmp_path / name).write_text(f"LM=3\n{rows}\nIMAGE=a.png\n")
    assert_points(load_folder(tmp_path)[0].landmarks)


def test_names_of_files_for_one_image() -> None:
    names = ["a.pts", "a.b.pts", "a.pts.txt", "a.mrk.json", "a_RoiSet.zip", "RoiSet.zip", "a.txt"]
    assert [name_of(Path(name)) for name in names] == ["a", "a.b", "a", "a", "a", "RoiSet", "a"]


def test_a_record_that_occurs_twice_is_read_once() -> None:
    box = "<box width='9' height='9'><part name='1' x='5' y='6'/><part name='2' x='7' y='8'/></box>"
    notes = Notes()
    read = parse("a.xml", f"<dataset><image file='a.png'>{box}{box}</image></dataset>", notes=notes)
    assert not read["a.png"].others
    assert notes.lines() == ["records that occur twice are read once: a.png"]


# ImageJ -------------------------------------------------------------------------------------------


def roi(points: list[tuple[float, float]], kind: int = 10, whole: bool = False, plane: int = 0) -> bytes:
    left, top = (int(min(values)) for values in zip(*points, strict=True))
    header = struct.pack(">4shBBhhhhH", b"Iout", 228, kind, 0, top, left, 99, 99, len(points)).ljust(50, b"\0")
    header += struct.pack(">hi", 0 if whole else 128, 0) + struct.pack(">ii", plane, 0)
    xs, ys = zip(*points, strict=True)
    body = struct.pack(f">{2 * len(points)}h", *(int(x) - left for x in xs), *(int(y) - top for y in ys))
    if not whole:
        body += struct.pack(f">{2 * len(points)}f", *xs, *ys)
    return header.ljust(64, b"\0") + body


def archive(files: dict[str, bytes]) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as made:
        for name, data in files.items():
            made.writestr(name, data)
    return buffer.getvalue()


def test_selections_of_imagej() -> None:
    corners = [(x + 0.5, y + 0.5) for x, y in POINTS]
    assert_points(parse("a.roi", roi(corners)))
    assert_points(parse("a.roi", roi(corners, kind=5)))
    whole = [(x, y) for x, y in np.round(POINTS).tolist()]
    np.testing.assert_array_equal(parse("a.roi", roi(whole, whole=True)).points, whole)
    named = archive({f"{name}.roi": roi([at]) for name, at in zip(NAMES, corners, strict=True)})
    assert_points(parse("a.zip", named), NAMES)
    numbered = archive({f"000{i}-0020-0010.roi": roi([at]) for i, at in enumerate(corners)})
    assert_points(parse("a.zip", numbered))
    both = parse("a.zip", archive({"b.roi": roi(corners), "c.roi": roi([(x + 9, y) for x, y in corners])}))
    np.testing.assert_allclose(both.others[0].points, np.add(POINTS, [9, 0]))


def far_roi(points: list[tuple[int, int]]) -> bytes:
    """Whole pixels, as ImageJ stores them: 16 bits without a sign where they exceed 32767."""
    left, top = (min(values) for values in zip(*points, strict=True))
    header = struct.pack(">4shBBHHhhH", b"Iout", 228, 10, 0, top % 65536, left % 65536, 0, 0, len(points))
    xs, ys = zip(*points, strict=True)
    body = struct.pack(f">{2 * len(points)}H", *(x - left for x in xs), *(y - top for y in ys))
    return header.ljust(64, b"\0") + body


@pytest.mark.parametrize(
    "points", [[(40_000, 10), (41_000, 33_000)], [(-3, -5), (50_000, 7)], [(32_768, 32_767), (32_768, 32_767)]]
)
def test_whole_pixels_beyond_those_of_16_bits_with_a_sign(points: list[tuple[int, int]]) -> None:
    np.testing.assert_array_equal(parse("a.roi", far_roi(points)).points, points)


def test_fractions_of_pixels_beyond_those_of_16_bits() -> None:
    at = np.array([[40_000.25, 10.5], [60_000.5, 50_000.75]])
    data = bytearray(roi([(1.0, 2.0), (3.0, 4.0)]))
    data[-16:] = at.T.astype(">f4").tobytes()
    np.testing.assert_array_equal(parse("a.roi", bytes(data)).points, at - 0.5)


def test_more_points_than_16_bits_can_count() -> None:
    points = np.arange(2 * 70_000).reshape(2, -1) % 30_000
    header = bytearray(roi([(0, 0)], whole=True)[:64])
    header[16:22] = struct.pack(">Hi", 0, points.shape[1])
    read = parse("a.roi", bytes(header) + points.astype(">i2").tobytes())
    np.testing.assert_array_equal(read.points, points.T)


def test_points_of_one_selection_on_several_planes_are_named() -> None:
    data = bytearray(roi(POINTS))
    data[60:64] = struct.pack(">i", len(data))
    data += bytes(48) + struct.pack(">i", len(data) + 64) + bytes(12)
    planes = [1 << 8 | 3, 1 << 8, 1 << 8]
    assert len(parse("a.roi", bytes(data) + struct.pack(">3i", *planes))) == 3
    with pytest.raises(LandmarkError, match="points of 'a' lie on several planes of a stack"):
        parse("a.roi", bytes(data) + struct.pack(">3i", *planes[:2], 2 << 8))


def test_selections_of_one_name_are_all_read_and_what_a_mac_adds_is_not() -> None:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as made, warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        for x, y in POINTS:
            made.writestr("tip.roi", roi([(x + 0.5, y + 0.5)]))
        made.writestr("__MACOSX/._tip.roi", b"\0\5\x16\7")
    notes = Notes()
    assert_points(parse("a.zip", buffer.getvalue(), notes=notes))
    assert notes.lines() == ["selections of ImageJ are read in their order, because some have one name: tip"]


@pytest.mark.parametrize("kind", [zipfile.ZIP_LZMA, zipfile.ZIP_BZIP2])
def test_ways_of_packing_that_may_need_gigabytes_are_refused(kind: int) -> None:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", kind) as made:
        made.writestr("a.roi", roi(POINTS))
    with pytest.raises(LandmarkError, match="packed in a way that is not read"):
        parse("a.zip", buffer.getvalue())


def test_a_name_that_is_no_text_is_a_damage() -> None:
    data = archive({"é.roi": roi(POINTS)}).replace("é".encode(), b"\xff\xff")
    with pytest.raises(LandmarkError, match=r"a\.zip: it is no sound \.zip"):
        parse("a.zip", data)


def entries(name: bytes, n: int, packed: bytes = b"", size: int = 0) -> bytes:
    """An archive whose list has n entries that all name one part, of so many bytes unpacked."""
    checksum = zlib.crc32(bytes(size))
    facts = struct.pack("<2HIII2H", 0, 0, checksum, len(packed), size, len(name), 0)
    part = b"PK\3\4" + struct.pack("<3H", 20, 0, 8) + facts + name + packed
    listed = (b"PK\1\2" + struct.pack("<4H", 20, 20, 0, 8) + facts + bytes(14) + name) * n
    end = b"PK\5\6" + struct.pack("<4H2IH", 0, 0, n % 65536, n % 65536, len(listed), len(part), 0)
    return part + listed + end


@pytest.mark.parametrize("name", ["a.zip", "t.xlsx"])
def test_archives_of_millions_of_parts_are_refused_before_their_list_is_read(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(unpacking, "ZipFile", None)
    with pytest.raises(LandmarkError, match=f"{name}: it holds 2,000,000 files, more than 30,000: save fewer in it"):
        parse(name, entries(b"a.roi", 2_000_000))


def test_entries_that_all_name_one_large_part_are_refused() -> None:
    packer = zlib.compressobj(9, zlib.DEFLATED, -15)
    packed = packer.compress(bytes(900_000)) + packer.flush()
    with pytest.raises(LandmarkError, match="no selection of ImageJ"):
        parse("a.zip", entries(b"a.roi", 1, packed, 900_000))
    part = roi([(float(i), 0.0) for i in range(20_000)])
    packer = zlib.compressobj(9, zlib.DEFLATED, -15)
    packed = packer.compress(part) + packer.flush()
    data = entries(b"a.roi", 1000, packed, len(part)).replace(
        struct.pack("<I", zlib.crc32(bytes(len(part)))), struct.pack("<I", zlib.crc32(part))
    )
    # Python refuses them by itself from some versions on.
    with pytest.raises(LandmarkError, match=r"its files have more than 40,000,000 bytes together|Overlapped entries"):
        parse("a.zip", data)


@pytest.mark.parametrize(
    ("name", "data", "words"),
    [
        ("a.roi", b"Iout" + bytes(10), "is no selection of ImageJ, or is cut short"),
        ("a.roi", roi(POINTS)[:-1], "is cut short"),
        ("a.roi", roi(POINTS, kind=1), "has no points: use the multi-point tool"),
        ("a.roi", roi(POINTS)[:-4] + b"\x7f\xc0\0\0", "positions that are no numbers"),
        ("a.zip", archive({"a.txt": b"1"}), "has no selections of ImageJ"),
        ("a.zip", archive({"a.roi": roi(POINTS), "b.roi": roi(POINTS[:2])}), "have 2 and 3 points"),
        ("a.zip", archive({"a.roi": roi(POINTS), "b.roi": roi(POINTS, plane=2)}), "several planes of a stack"),
        ("a.zip", archive({"a.roi": bytes(30_000_000)}), "more than is read of such a file"),
        ("a.zip", archive({"a.roi": roi(POINTS)})[:-9], "no sound .zip"),
        ("a.zip", b"PK", "no sound .zip"),
    ],
)
def test_selections_that_cannot_be_read_are_named(name: str, data: bytes, words: str) -> None:
    with pytest.raises(LandmarkError, match=words):
        parse(name, data)


def test_other_archives_beside_images_are_passed_over(tmp_path: Path) -> None:
    write_image(tmp_path / "a.png", np.zeros((160, 200, 3), np.uint8))
    (tmp_path / "photos.zip").write_bytes(archive({"b.png": b"1"}))
    (tmp_path / "a.csv").write_text("x,y\n1,2\n3,4\n")
    data = load_folder(tmp_path)
    assert (len(data), data.left_out) == (1, ())


def test_deeplabcut_s_h5_is_not_needed_beside_its_table(tmp_path: Path) -> None:
    for name in "ab":
        write_image(tmp_path / f"{name}.png", np.zeros((160, 200, 3), np.uint8))
    (tmp_path / "CollectedData.h5").write_bytes(b"\x89HDF\r\n\x1a\n")
    with pytest.raises(LandmarkError, match=r"unknown format: CollectedData\.h5.* Of \.h5 files: DeepLabCut writes a"):
        load_folder(tmp_path)
    rows = ["scorer,me,me,me,me", "bodyparts,p,p,q,q", "coords,x,y,x,y", "a.png,1,2,3,4"]
    (tmp_path / "CollectedData.csv").write_text("\n".join(rows))
    data = load_folder(tmp_path)
    assert (len(data), [left.path.name for left in data.left_out]) == (1, ["b.png"])
    with pytest.raises(LandmarkError, match=r"'\.mat', not that of a landmark format: in MATLAB, save a table"):
        read_landmarks(tmp_path / "a.mat")


# Spreadsheets -------------------------------------------------------------------------------------

SHEET = (
    '<worksheet xmlns="http://schemas.openxmlformats.org/spreadsheetml/2006/main"><sheetData>{}</sheetData></worksheet>'
)


def xlsx(sheets: dict[str, list[list[Any]]], texts: list[str] | None = None, hidden: str = "") -> bytes:
    """Build a spreadsheet as Excel writes it, with shared texts if asked for."""
    main = "http://schemas.openxmlformats.org/spreadsheetml/2006/main"
    office = "http://schemas.openxmlformats.org/officeDocument/2006/relationships"
    listed = "".join(
        f'<sheet name="{name}" sheetId="{i}" r:id="rId{i}"{chr(32) + hidden if hidden and i == 1 else ""}/>'
        for i, name in enumerate(sheets, 1)
    )
    links = "".join(f'<Relationship Id="rId{i}" Target="worksheets/sheet{i}.xml"/>' for i in range(1, len(sheets) + 1))
    files = {
        "xl/workbook.xml": f'<workbook xmlns="{main}" xmlns:r="{office}"><sheets>{listed}</sheets></workbook>',
        "xl/_rels/workbook.xml.rels": f"<Relationships>{links}</Relationships>",
    }
    if texts is not None:
        items = "".join(f"<si><r><t>{text[:1]}</t></r><r><t>{text[1:]}</t></r></si>" for text in texts)
        files["xl/sharedStrings.xml"] = f'<sst xmlns="{main}">{items}</sst>'
    for i, rows in enumerate(sheets.values(), 1):
        lines = []
        for r, row in enumerate(rows, 1):
            cells = [_cell(f"{chr(65 + c)}{r}", value, texts) for c, value in enumerate(row) if value is not None]
            lines.append(f'<row r="{r}">{"".join(cells)}</row>')
        files[f"xl/worksheets/sheet{i}.xml"] = SHEET.format("".join(lines))
    return archive({name: text.encode() for name, text in files.items()})


def _cell(place: str, value: Any, texts: list[str] | None) -> str:
    if not isinstance(value, str):
        return f'<c r="{place}"><v>{value}</v></c>'
    if texts is None:
        return f'<c r="{place}" t="inlineStr"><is><t>{value}</t></is></c>'
    return f'<c r="{place}" t="s"><v>{texts.index(value)}</v></c>'


LONG: list[list[Any]] = [["image", "landmark", "x", "y"]]
LONG += [["a.png" if i == 0 else None, name, x, y] for i, (name, (x, y)) in enumerate(zip(NAMES, POINTS, strict=True))]


@pytest.mark.parametrize("texts", [None, ["image", "landmark", "x", "y", "a.png", *NAMES]])
def test_the_table_of_a_spreadsheet(texts: list[str] | None) -> None:
    assert_points(parse("t.xlsx", xlsx({"points": LONG}, texts)), NAMES, "a.png")
    notes = Notes()
    assert_points(parse("t.xlsx", xlsx({"notes": [], "points": LONG}, texts), notes=notes), NAMES, "a.png")
    assert "of 2 sheets 'points' is read: t.xlsx" in notes.lines()
    other = [["specimen", "sex"], ["a", "m"]] if texts is None else [["image"]]
    assert_points(parse("t.xlsx", xlsx({"no": other, "points": LONG}, texts, 'state="hidden"')), NAMES, "a.png")


def test_numbers_with_decimal_commas_in_a_spreadsheet() -> None:
    rows = [["x", "y"], *([f"{x}".replace(".", ","), f"{y}".replace(".", ",")] for x, y in POINTS)]
    assert_points(parse("t.xlsx", xlsx({"s": rows})))


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"PK\3\4", "no sound .xlsx"),
        (archive({"a": b""}), "no sound .xlsx"),
        (xlsx({"s": []}), "its sheets are empty"),
        (xlsx({"s": [["x", "y", "a"]]}, ["x", "y", "a"], 'state="hidden"'), "its sheets are empty"),
        (archive({"xl/workbook.xml": b'<!DOCTYPE a [<!ENTITY b "c">]><a/>'}), "declares entities"),
        (archive({"xl/workbook.xml": b"<a>" * 9_000_000}), "more than is read of such a file"),
        (archive({"xl/workbook.xml": b"<a>"}), "a part of it is damaged"),
    ],
)
def test_spreadsheets_that_cannot_be_read_are_named(data: bytes, words: str) -> None:
    with pytest.raises(LandmarkError, match=words) as caught:
        parse("t.xlsx", data)
    assert str(caught.value).startswith("t.xlsx: ")


def with_part(name: str, text: str, sheet: str = "") -> bytes:
    """Build a spreadsheet with another part, and perhaps another sheet."""
    with zipfile.ZipFile(io.BytesIO(xlsx({"s": LONG}, ["image", "landmark", "x", "y", "a.png", *NAMES]))) as made:
        parts = {part: made.read(part) for part in made.namelist()}
    assert f"xl/{name}.xml" in parts
    parts[f"xl/{name}.xml"] = text.encode()
    if sheet:
        parts["xl/worksheets/sheet1.xml"] = sheet.encode()
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as stored:  # as it is, so that nothing but the content is too large
        for part, data in parts.items():
            stored.writestr(part, data)
    return buffer.getvalue()


def test_a_cell_far_out_is_refused() -> None:
    with pytest.raises(LandmarkError, match="more than 5,000 columns"):
        parse("t.xlsx", with_part("worksheets/sheet1", SHEET.format('<row r="1"><c r="XFD1"><v>1</v></c></row>')))


@pytest.mark.parametrize(
    "rows", ["<a/>" * 4_800_000, "<row/>" * 200_000, f"<row>{'<c/>' * 4000}</row>" * 1000, "<a>" * 1_800_000]
)
def test_spreadsheets_of_many_elements_are_refused_before_they_are_parsed(
    rows: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    parsed = []
    parse_xml = ElementTree.fromstring
    monkeypatch.setattr(ElementTree, "fromstring", lambda data: parsed.append(len(data)) or parse_xml(data))
    with pytest.raises(LandmarkError, match=r"t\.xlsx: it has more cells, or other parts, than are read"):
        parse("t.xlsx", with_part("worksheets/sheet1", SHEET.format(rows)))
    assert max(parsed) < 10_000


def test_a_sheet_that_is_listed_often_is_not_read_each_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(spreadsheets, "_MOST_MARKS", 20_000)
    book = '<workbook xmlns:r="o/relationships">{}</workbook>'.format('<sheet name="a" r:id="rId1"/>' * 1000)
    parts = {"xl/workbook.xml": book.encode(), "xl/worksheets/sheet1.xml": SHEET.format("<c/>" * 5000).encode()}
    parts["xl/_rels/workbook.xml.rels"] = b'<a><b Id="rId1" Target="worksheets/sheet1.xml"/></a>'
    with pytest.raises(LandmarkError, match="more cells, or other parts, than are read"):
        parse("t.xlsx", archive(parts))


def test_a_long_text_that_many_cells_refer_to_is_refused() -> None:
    with pytest.raises(LandmarkError, match="has 32,768 letters, more than 32,767: shorten it"):
        parse("t.xlsx", with_part("sharedStrings", f"<sst><si><t>{'a' * 32_768}</t></si></sst>"))
    texts = f"<sst><si><t>{'a' * 32_767}</t></si></sst>"
    sheet = SHEET.format('<row><c t="s"><v>0</v></c></row>' * 611)
    with pytest.raises(LandmarkError, match="more than 1,000,000 cells, or 20,000,000 letters in them"):
        parse("t.xlsx", with_part("sharedStrings", texts, sheet))


def test_rows_that_one_cell_pads_to_many_are_counted() -> None:
    sheet = SHEET.format('<row><c r="GAA1"><v>1</v></c></row>' + "<row><c><v>1</v></c></row>" * 210)
    with pytest.raises(LandmarkError, match="more than 1,000,000 cells"):
        parse("t.xlsx", with_part("worksheets/sheet1", sheet))


def test_texts_in_formats_within_formats_are_not_followed() -> None:
    deep = "<r>" * 50_000 + "</r>" * 50_000
    texts = "".join(f"<si><r><t>{text}</t></r></si>" for text in ["image", "landmark", "x", "y", "a.png", *NAMES])
    texts = texts.replace("</si>", f"{deep}</si>", 1)
    assert_points(parse("t.xlsx", with_part("sharedStrings", f"<sst>{texts}</sst>")), NAMES, "a.png")


def test_empty_cells_at_the_end_of_a_row_are_missing_landmarks() -> None:
    rows = [["image", "landmark", "x", "y"], ["a.png", "a", None, None], ["a.png", "b", 3, 4]]
    assert parse("t.xlsx", xlsx({"s": rows}))["a.png"].missing.tolist() == [True, False]
    with pytest.raises(LandmarkError, match="line 2 has only one of x and y"):
        parse("t.xlsx", xlsx({"s": [["x", "y"], [1, "#N/A"]]}))


def test_a_spreadsheet_with_a_password_is_named() -> None:
    with pytest.raises(LandmarkError, match=r"has a password, or is an older \.xls: save it as \.xlsx without one"):
        parse("t.xlsx", b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" + bytes(512))


@pytest.mark.parametrize("name", ["a.roi", "a.zip", "t.xlsx"])
@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_damaged_binary_files_raise_only_landmark_errors(name: str, data: st.DataObject) -> None:
    whole = {"a.roi": roi(POINTS), "a.zip": archive({"a.roi": roi(POINTS)}), "t.xlsx": xlsx({"s": LONG})}[name]
    spoilt = bytearray(whole)
    for _ in range(data.draw(st.integers(1, 4))):
        spoilt[data.draw(st.integers(0, len(spoilt) - 1))] = data.draw(st.integers(0, 255))
    try:
        read = parse(name, bytes(spoilt[: data.draw(st.integers(1, len(spoilt)))]))
    except LandmarkError as fault:
        assert name in str(fault)
    else:
        assert isinstance(read, (Landmarks, dict))
