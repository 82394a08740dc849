"""Measures of inputs from public reports have the right values: landmarks go by their names."""

import csv
from pathlib import Path

import pytest

from liaam.morphometry import alike, measure, read_specimens
from liaam.morphometry.table import scales_in

A1 = {"img05": 36.7342633, "img06": 38.2988773, "img07": 30.8926739, "img08": 35.8408663, "img09": 36.0284915}


@pytest.fixture
def cases(shared_data):
    folder = Path(shared_data).parent / "cases"
    if not folder.is_dir():
        pytest.skip("the cases are absent")
    return folder


def column(path, text, scale=None):
    columns = measure(read_specimens(path), text, scale)
    first = 1 + (scales_in(columns) is not None)
    return dict(zip(columns["specimen"], list(columns.values())[first], strict=True))


def test_rows_in_another_order_go_by_names(cases):
    assert column(cases / "92-csv-rows-shuffled/p.csv", "distance:p0-p1")["img00"] == pytest.approx(38.6208493)


def test_keypoints_of_a_second_file_go_by_names(cases):
    found = column(cases / "A1-coco-names-order-two-files", "distance:p0-p1")
    assert {name: found[name] for name in A1} == pytest.approx(A1)


def test_names_decide_within_one_table(tmp_path):
    rows = [("a.png", "p0", 0, 0), ("a.png", "p1", 3, 4), ("a.png", "p2", 50, 0)]
    rows += [("b.png", "p2", 50, 0), ("b.png", "p1", 3, 4), ("b.png", "p0", 0, 0)]
    with (tmp_path / "t.csv").open("w", newline="") as file:
        csv.writer(file).writerows([("image", "name", "x", "y"), *rows])
    assert column(tmp_path / "t.csv", "distance:p0-p1") == pytest.approx({"a": 5, "b": 5})


def test_one_record_of_another_count_does_not_stop_the_others(cases):
    kept, left_out = alike(read_specimens(cases / "F1-measure-one-bad-record/all.tps"))
    assert len(kept) == 9
    assert left_out == ("img06: it has 7 landmarks where most have 8; it is left out",)


def test_a_specimen_without_its_scale_bar_is_in_pixels(cases):
    columns = measure(read_specimens(cases / "96-scalebar-missing/all.tps"), "distance:1-2", "7-8=5")
    at = columns["specimen"].index("img03")
    assert columns["scale"][at] != columns["scale"][at]
    assert columns["distance_1_2"][at] == pytest.approx(27.8386871, rel=1e-3)


def test_strict_refuses_what_would_be_left_out(run, cases, tmp_path):
    given = ("measure", cases / "F1-measure-one-bad-record/all.tps", "distance:1-2", "-o", tmp_path / "o.csv")
    code, _, err = run(*given, "--strict")
    assert code == 1 and "img06" in err and not (tmp_path / "o.csv").exists()
    code, _, err = run(*given)
    assert code == 0 and "img06: it has 7 landmarks where most have 8" in err


MEASURED = [
    ("103-same-name-in-two-folders/data/all.json", "distance:p0-p1", {"left/w0": 29.6074, "right/w0": 29.5571}),
    ("108-measure-zero-zero/data/all.tps", "distance:1-2", {"img03": 32.0840}),
    ("110-via-csv/data/via_export_csv.csv", "distance:p0-p1", {"img00": 28.7924}),
    ("112-sleap-csv/data/labels.csv", "distance:p0-p1", {"40": 29.6074}),
    ("121-stereomorph-scaling/data", "distance:p0-p1", {"img00": 1.48037}),
    ("122-makesense-points-csv/data/labels.csv", "distance:p0-p1", {"img00": 28.7924}),
    ("125-morphologika/data/shapes.txt", "distance:1-2", {"img00": 29.6074}),
]


@pytest.mark.parametrize(("name", "text", "right"), MEASURED, ids=[name.partition("/")[0] for name, *_ in MEASURED])
@pytest.mark.filterwarnings("ignore:landmarks at 0, 0")
def test_exports_of_tools_are_measured(cases, name, text, right):
    found = column(cases / name, text)
    assert len(found) == 10
    assert {key: found[key] for key in right} == pytest.approx(right, rel=1e-5)


REPLICATES = [
    ("102-replicates-hash-in-names/data/all.tps", "distance:1-2"),
    ("103-same-name-in-two-folders/data/all.json", "distance:p0-p1"),
    ("112-sleap-csv/data/labels.csv", "distance:p0-p1"),
]


@pytest.mark.parametrize(("name", "text"), REPLICATES, ids=[name.partition("/")[0] for name, _ in REPLICATES])
def test_records_of_several_images_are_no_replicates(run, cases, tmp_path, name, text):
    code, _, err = run("measure", cases / name, text, "-o", tmp_path / "o.csv", "--replicates", "image")
    assert code == 1 and "no specimen has replicates" in err


def test_objects_of_an_image_are_no_replicates_of_each_other(run, cases, tmp_path):
    folder = cases / "101-replicates-two-objects-an-image/data"
    code, _, _ = run("measure", folder, "distance:p0-p1", "-o", tmp_path / "o.csv", "--replicates", "image")
    assert code == 0
    with (tmp_path / "o_replicates.csv").open(newline="") as file:
        rows = {row["measure"]: row for row in csv.DictReader(file)}
    distance = rows["distance_p0_p1"]
    assert (rows["shape"]["df_among"], rows["shape"]["df_within"]) == ("228", "240")
    found = [float(distance[name]) for name in ("df_among", "df_within", "F", "sd", "repeatability")]
    assert found == pytest.approx([19, 20, 289.7, 0.0975, 0.9931], rel=1e-3)
    assert float(rows["landmark p0"]["sd"]) == pytest.approx(0.1379, rel=1e-3)


SAID = [
    ("104-imagej-results-in-mm/data/Results.csv", "distance:1-2", "x and y are not pixels, but in another unit"),
    ("108-measure-zero-zero/data/all.tps", "distance:1-2", "landmarks at 0, 0.*: img03 (landmark 3)"),
    (
        "120-annotators-in-another-order/data",
        "distance:3-4",
        "landmarks 3 and 4 are exchanged between first.tps",
    ),
]


@pytest.mark.parametrize(("name", "text", "said"), SAID, ids=[name.partition("/")[0] for name, *_ in SAID])
def test_doubts_are_said(run, cases, tmp_path, name, text, said):
    more = ["--replicates", "image"] if name.startswith("120") else []
    code, _, err = run("measure", cases / name, text, "-o", tmp_path / "o.csv", *more)
    assert code == 0
    start, _, end = said.partition(".*")
    assert start in err and end in err


def test_positions_in_millimetres_are_no_pixels(run, cases):
    code, out, err = run("check", cases / "104-imagej-results-in-mm/data")
    assert code == 1 and "no faults" not in out
    assert "all landmarks lie within the first 7 pixels of every image, so that they are not pixels" in err
