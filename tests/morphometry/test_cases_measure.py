"""Measures of inputs from public reports have the right values: landmarks go by their names."""

import csv
from pathlib import Path

import pytest

from liaam.morphometry import alike, measure, read_specimens

A1 = {"img05": 36.7342633, "img06": 38.2988773, "img07": 30.8926739, "img08": 35.8408663, "img09": 36.0284915}


@pytest.fixture
def cases(shared_data):
    folder = Path(shared_data).parent / "cases"
    if not folder.is_dir():
        pytest.skip("the cases are absent")
    return folder


def column(path, text, scale=None):
    columns = measure(read_specimens(path), text, scale)
    return dict(zip(columns["specimen"], list(columns.values())[1 + ("scale" in columns)], strict=True))


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
