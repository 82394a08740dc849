"""Specimens from fits, tables of batches and landmark files."""

import csv
import io
import json
import re
import zipfile
from pathlib import Path
from xml.sax.saxutils import escape

import numpy as np
import pytest

from liaam.batch.tables import BatchTable, write_table
from liaam.errors import LiaamError
from liaam.io import Landmarks, read_collection, write_collection, write_columns, write_image, write_landmarks
from liaam.io.fit_files import FIT_SUFFIXES, write_fit
from liaam.io.landmarks import Contour
from liaam.morphometry import Specimen, alike, measure, of_one_side, read_specimens

POINTS = np.array([[1.0, 2], [11, 2], [11, 22]])
SPREAD = np.array([[1.0, 0.5, 2], [2, 0, 2], [3, 1, 4]])
"""xx, xy, yy of each landmark."""


def add_fit(folder: Path, stem: str, status: str = "converged", **facts: object) -> None:
    folder.mkdir(exist_ok=True)
    content = {"status": status, "covariance": SPREAD, **facts}
    for suffix in FIT_SUFFIXES:
        landmarks = Landmarks(POINTS, image_name=f"{stem}.png")
        write_fit(folder / f"{stem}{suffix}", landmarks, content, (30, 40))


def row_of(path: str, status: str = "converged") -> dict:
    known = status == "converged"
    return {
        **dict.fromkeys(
            (
                "message",
                "quality",
                "object",
                "score",
                "n_found",
                "theta_deg",
                "cost",
                "iterations",
                "expansion",
                "seconds",
            )
        ),
        "present": None,
        "path": path,
        "status": status,
        "message": "",
        "landmarks": POINTS.ravel().tolist() if known else None,
        "covariance": SPREAD.ravel().tolist() if known else None,
        "size": [30, 40],
        "specimen": Path(path).stem,
        "side": "",
        "fingerprint": "",
        "code": "",
        "scale": None,
        "scale_unit": "",
        "scale_from": "",
    }


def assert_fit(specimen: Specimen) -> None:
    np.testing.assert_array_equal(specimen.points, POINTS)
    assert specimen.covariances is not None
    np.testing.assert_array_equal(specimen.covariances[0], [[1, 0.5], [0.5, 2]])
    np.testing.assert_array_equal(specimen.covariances[2], [[3, 1], [1, 4]])
    assert specimen.status == "converged"


def test_a_folder_of_fits_counts_each_once(tmp_path: Path) -> None:
    for stem in ("wing10", "wing2"):
        add_fit(tmp_path, stem, scale=0.5)
    (tmp_path / "wing2_history.csv").write_text("iteration,level\n0,0\n")
    skipped: list[str] = []
    specimens = read_specimens(tmp_path, skipped.append)
    assert [specimen.name for specimen in specimens] == ["wing2", "wing10"]
    assert [specimen.scale for specimen in specimens] == [0.5, 0.5]
    for specimen in specimens:
        assert_fit(specimen)
    assert len(skipped) == 1
    assert "wing2_history.csv" in skipped[0]
    assert_fit(read_specimens(tmp_path / "wing10.json")[0])
    assert read_specimens(tmp_path / "wing10.csv")[0].covariances is None


def test_names_of_images_may_be_longer_than_those_of_files(tmp_path: Path) -> None:
    name = f"{'s' * 300}.png"
    rows = "".join(f"{name},{i},{x},{y}\n" for i, (x, y) in enumerate(POINTS, 1))
    (tmp_path / "all.csv").write_text(f"image,landmark,x,y\n{rows}")
    (specimen,) = read_specimens(tmp_path / "all.csv")
    np.testing.assert_array_equal(specimen.points, POINTS)


def test_numbers_of_landmarks_count_from_1_whatever_their_names() -> None:
    specimen = Specimen("a", np.array([[0.0, 0], [1, 0], [3, 0], [7, 0]]), names=("0", "1", "2", "tip"))
    found = measure([specimen], ["distance:1-2", "distance:2-tip"])
    assert (found["distance_1_2"], found["distance_2_tip"]) == ([1.0], [6.0])


@pytest.mark.parametrize("suffix", [".json", ".tps"])
def test_curves_of_fits_are_read(tmp_path: Path, suffix: str) -> None:
    lines = (Contour((1, 2)),)
    write_fit(tmp_path / f"a{suffix}", Landmarks(POINTS, lines), {"status": "converged"}, (30, 40))
    assert read_specimens(tmp_path / f"a{suffix}")[0].curves == lines
    facts = {"status": "converged", "contours": [[[1, 9], 0]]}
    write_fit(tmp_path / "a.json", Landmarks(POINTS, lines), facts, (30, 40))
    assert read_specimens(tmp_path / "a.json")[0].curves == lines


def test_a_curve_has_landmarks_that_exist() -> None:
    with pytest.raises(LiaamError, match="specimen a: a curve has a landmark that does not exist"):
        Specimen("a", POINTS, curves=(Contour((0, 3)),))


def test_curves_follow_the_order_of_names() -> None:
    names = ("a", "b", "c")
    first = Specimen("1", POINTS, names=names)
    other = Specimen("2", POINTS[::-1], names=names[::-1], curves=(Contour((0, 1)),))
    kept, _ = alike([first, other])
    assert (kept[1].names, kept[1].curves) == (names, (Contour((2, 1)),))


def test_specimens_take_landmarks_and_lists() -> None:
    for points in (Landmarks(POINTS), POINTS.tolist()):
        assert measure([Specimen("a", points)], ["distance:1-2"])["distance_1_2"][0] == 10  # type: ignore[arg-type]


@pytest.mark.parametrize("suffix", [".pts", ".csv", ".tps"])
def test_landmarks_corrected_after_the_fit_are_measured(tmp_path: Path, suffix: str) -> None:
    for stem in ("wing1", "wing2_1", "wing2_2"):  # two objects in one image
        add_fit(tmp_path, stem, scale=0.5, landmark_names=["a", "b", "c"])
    corrected = POINTS + np.array([[0, 0.5], [0, 0.5], [0, 0.5]])
    corrected[2] = np.nan
    for stem in ("wing2_1", "wing2_2"):
        write_landmarks(tmp_path / f"{stem}{suffix}", Landmarks(corrected, image_name="wing2.png"), (30, 40))
    said: list[str] = []
    first, *others = read_specimens(tmp_path, said.append)
    end = f"{suffix}, whose points were changed after the fit"
    assert said == [f"wing2_{i}: measured from wing2_{i}{end}" for i in (1, 2)]
    assert_fit(first)
    assert [other.name for other in others] == ["wing2_1", "wing2_2"]
    for other in others:
        np.testing.assert_allclose(other.points, corrected)
        assert (other.covariances, other.status, other.scale, other.names) == (None, "", 0.5, ("a", "b", "c"))


@pytest.mark.parametrize("of", ["files", "table"])
def test_positions_of_absent_landmarks_of_fits_are_estimates(tmp_path: Path, of: str) -> None:
    statuses = {"whole": "converged", "torn": "converged", "empty": "converged", "doubtful": "doubtful"}
    present = {"whole": [1.0, 0.9, 0.51], "torn": [0.2, 1.0, 0.49], "empty": [1.0, 1.0, 0.1], "doubtful": [0.1] * 3}
    gap = np.where(np.arange(3)[:, None] == 2, np.nan, POINTS)
    if of == "files":
        for name, status in statuses.items():
            facts = {"status": status, "present": present[name]}
            write_fit(tmp_path / f"{name}.json", Landmarks(gap if name == "empty" else POINTS), facts, (30, 40))
    else:
        rows = [row_of(f"{name}.png") | {"status": statuses[name], "present": present[name]} for name in statuses]
        rows[2]["landmarks"] = [*POINTS[:2].ravel().tolist(), None, None]
        write_table(tmp_path / "fits.csv", BatchTable([(json.dumps(row), row) for row in rows], 3, True, {}))
    specimens = {each.name: each for each in read_specimens(tmp_path, [].append)}
    assert {name: each.estimated for name, each in specimens.items()} == {
        "whole": (), "torn": (0, 2), "empty": (), "doubtful": ()
    }  # fmt: skip
    columns = measure(specimens.values())
    assert dict(zip(columns["specimen"], columns["estimated"], strict=True))["torn"] == "1; 3"


def test_estimates_that_a_person_has_moved_are_none(tmp_path: Path) -> None:
    add_fit(tmp_path, "torn", present=[0.2, 1.0, 0.3])
    assert read_specimens(tmp_path)[0].estimated == (0, 2)
    write_landmarks(tmp_path / "torn.pts", Landmarks(POINTS + np.eye(3, 2)), (30, 40))
    assert read_specimens(tmp_path, [].append)[0].estimated == (2,)


def test_a_correction_counts_also_beside_a_file_that_cannot_be_read(tmp_path: Path) -> None:
    add_fit(tmp_path, "a")
    write_landmarks(tmp_path / "a.csv", Landmarks(POINTS + 1))
    (tmp_path / "a.pts").write_bytes(b"\0\xff")
    (specimen,) = read_specimens(tmp_path, [].append)
    np.testing.assert_array_equal(specimen.points, POINTS + 1)


@pytest.mark.parametrize("shift", [(0.0, 0.0), (0.0, 0.03), (np.nan, np.nan), (2e6, 0.0)])
def test_any_change_of_a_point_is_a_correction(tmp_path: Path, shift: tuple[float, float]) -> None:
    fitted = POINTS.copy()
    fitted[1] = (3e6, 5.0)
    write_fit(tmp_path / "a.json", Landmarks(fitted), {"status": "diverged"}, (30, 40))
    write_landmarks(tmp_path / "a.csv", Landmarks(fitted + np.array([(0, 0), (0, 0), shift])))
    said: list[str] = []
    read_specimens(tmp_path, said.append)
    assert bool(said) == (shift != (0.0, 0.0))


@pytest.mark.parametrize("landmarks", ["abc", [[1, 2], [3]], {"a": 1}, 5, [["a", "b"]]])
def test_damaged_fits_are_skipped(tmp_path: Path, landmarks: object) -> None:
    add_fit(tmp_path, "good")
    add_fit(tmp_path, "bad")
    content = json.loads((tmp_path / "bad.json").read_text()) | {"landmarks": landmarks}
    (tmp_path / "bad.json").write_text(json.dumps(content))
    (tmp_path / "good.pts").write_bytes(b"\0\xff")  # not written by liaam like this, and no points
    said: list[str] = []
    (good,) = read_specimens(tmp_path, said.append)
    assert_fit(good)
    assert len(said) == 2
    assert said[0].startswith("skipped bad.json") and "damaged" in said[0]
    assert said[1].startswith("good: ") and said[1].endswith("the points of the fit are used")


@pytest.mark.parametrize("suffix", [".csv", ".jsonl", ".parquet"])
@pytest.mark.parametrize("names", [(), ("base", "left tip", "x"), ("2", "3", "1")])
def test_tables_of_batches_keep_the_names_of_landmarks(tmp_path: Path, suffix: str, names: tuple[str, ...]) -> None:
    path, row = tmp_path / f"t{suffix}", row_of("a.png")
    write_table(path, BatchTable([(json.dumps(row), row)], 3, True, {}, names=names))
    (specimen,) = read_specimens(path)
    assert_fit(specimen)
    assert specimen.names == names
    assert measure([specimen], ["distance:1-2"])["distance_1_2"][0] == pytest.approx(10)
    if "base" in names:
        assert measure([specimen], ["distance:base-x"])["distance_base_x"][0] == pytest.approx(np.hypot(10, 20))
    if suffix == ".csv":
        first = path.read_text().partition("\n")[0].split(",")
        assert first[13:15] == ([f"x_{names[0]}", f"y_{names[0]}"] if names else ["x1", "y1"])
        start = read_collection(path)["a.png"]  # of other fits
        order = [start.names.index(name) for name in names] if start.names else slice(None)
        np.testing.assert_array_equal(start.points[order], POINTS)


def test_tables_of_earlier_versions_count_from_0(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text("path,status,message,x0,y0,x1,y1\na.png,converged,,1,2,4,6\n")
    (specimen,) = read_specimens(tmp_path / "t.csv")
    assert measure([specimen], ["distance:1-2"])["distance_1_2"] == [5.0]


@pytest.mark.parametrize("suffix", [".csv", ".jsonl", ".parquet"])
@pytest.mark.parametrize("covariance", [True, False])
def test_tables_of_batches(tmp_path: Path, suffix: str, covariance: bool) -> None:
    rows = [row_of("wings/a.png"), row_of("wings/b.png", "error")]
    texts = [json.dumps(row if covariance else {**row, "covariance": None}) for row in rows]
    path = tmp_path / f"t{suffix}"
    write_table(path, BatchTable(zip(texts, rows, strict=True), 3, covariance, {}))
    first, second = read_specimens(path)
    assert (first.name, second.name, second.status, len(second.points)) == ("a", "b", "error", 0)
    np.testing.assert_array_equal(first.points, POINTS)
    if covariance:
        assert_fit(first)
    else:
        assert first.covariances is None
    assert measure([first, second], ["distance:1-2"])["distance_1_2"][0] == 10


def test_landmark_files(tmp_path: Path) -> None:
    write_landmarks(tmp_path / "a.pts", POINTS)
    write_landmarks(tmp_path / "b.csv", Landmarks(POINTS, names=("base", "tip", "end")))
    marks = {"a.png": Landmarks(POINTS + 9, scale=0.1), "c.png": Landmarks(POINTS, scale=0.1)}
    write_collection(tmp_path / "all.tps", marks, dict.fromkeys(marks, (30, 40)))
    a, b, c = read_specimens(tmp_path)  # no image is there
    np.testing.assert_array_equal(a.points, POINTS)  # its own file comes first
    assert b.names == ("base", "tip", "end")
    assert (c.name, c.scale) == ("c", 0.1)
    np.testing.assert_array_equal(c.points - c.points[0], POINTS - POINTS[0])


def test_files_of_a_folder_that_cannot_be_read_are_named(tmp_path: Path) -> None:
    write_landmarks(tmp_path / "a.pts", POINTS)
    (tmp_path / "other.csv").write_text("id,X1,Y1\n1,2,3\n")
    with pytest.warns(UserWarning, match=r"skipped other\.csv: .*there are no columns x and y"):
        assert len(read_specimens(tmp_path)) == 1


def test_fits_that_diverged_do_not_stop_the_others(tmp_path: Path) -> None:
    add_fit(tmp_path, "good")
    add_fit(tmp_path, "lost", "diverged", covariance=np.full((3, 3), np.nan))
    text = (tmp_path / "lost.json").read_text().replace("11.0", "1e300")
    (tmp_path / "lost.json").write_text(text)
    for suffix in (".pts", ".csv", ".tps"):
        (tmp_path / f"lost{suffix}").unlink()
    good, lost = read_specimens(tmp_path)
    assert_fit(good)
    assert lost.covariances is not None
    assert np.isnan(lost.covariances).all()
    assert np.isnan(lost.points).sum() == 2
    table = measure([good, lost], ["distance:1-2"])
    np.testing.assert_array_equal(table["distance_1_2"], [10, np.nan])


@pytest.mark.parametrize(
    ("points", "more", "words"),
    [
        (POINTS[0], {}, r"give \(n, 2\) points"),
        (POINTS, {"covariances": np.eye(2)}, r"and \(n, 2, 2\) covariances"),
        (POINTS * 1e12, {}, "a point or the scale is out of range"),
        (POINTS, {"scale": -1.0}, "a point or the scale is out of range"),
        (POINTS, {"covariances": np.tile([[1.0, 2], [2, 1]], (3, 1, 1))}, "a covariance is not positive definite"),
    ],
)
def test_specimens_are_checked(points: np.ndarray, more: dict, words: str) -> None:
    with pytest.raises(LiaamError, match=f"specimen a: .*{words}"):
        Specimen("a", points, **more)


def test_wrong_input(tmp_path: Path) -> None:
    with pytest.raises(LiaamError, match=r"no\.csv does not exist"):
        read_specimens(tmp_path / "no.csv")
    with pytest.raises(LiaamError, match="holds no results that can be read: name a folder of 'liaam fit'"):
        read_specimens(tmp_path)
    (tmp_path / "fit.json").write_text('{"status": "converged", "landmarks": [[1, 2], [3]]}')
    with pytest.raises(LiaamError, match=r"fit\.json: the landmarks of fit are damaged .*fit the image again"):
        read_specimens(tmp_path / "fit.json")
    (tmp_path / "t.jsonl").write_text('{"path": "a", "status": "converged", "landmarks": [1, 2]}\n{"path": 3}\n')
    with pytest.raises(LiaamError, match=r"t\.jsonl: row 2 is not one of 'liaam batch' .*run the batch again"):
        read_specimens(tmp_path / "t.jsonl")
    (tmp_path / "t.parquet").write_text("nothing of the kind")
    with pytest.raises(LiaamError, match=r"t\.parquet: row 1 is not one of 'liaam batch'"):
        read_specimens(tmp_path / "t.parquet")
    (tmp_path / "t.csv").write_text("path,status,message,x0,y0\na.png,converged,,1,two\n")
    with pytest.raises(LiaamError, match=r"t\.csv: row 1 is not one of 'liaam batch' .*'two'"):
        read_specimens(tmp_path / "t.csv")


def test_each_object_of_an_image_is_a_specimen(tmp_path: Path) -> None:
    box = "<box width='{0}' height='1'><part name='1' x='{0}' y='0'/></box>"
    text = f"<dataset><image file='tray.png'>{box.format(1)}{box.format(2)}</image></dataset>"
    (tmp_path / "all.xml").write_text(text)
    specimens = read_specimens(tmp_path / "all.xml")
    assert [(each.name, each.points.tolist()) for each in specimens] == [("tray", [[2, 0]]), ("tray#2", [[1, 0]])]


def test_positions_for_another_size_of_an_image_that_is_there_are_scaled(tmp_path):
    write_image(tmp_path / "a.png", np.zeros((20, 30, 3), np.uint8))
    marks = [("p", 2.5, 4.5), ("q", 8.5, 12.5)]
    shapes = [{"label": name, "points": [[x, y]], "shape_type": "point"} for name, x, y in marks]
    for name, size in (("a", (60, 40)), ("b", (60, 40)), ("c", (30, 20))):
        facts = {"imagePath": f"{name}.png", "imageWidth": size[0], "imageHeight": size[1]}
        (tmp_path / f"{name}.json").write_text(json.dumps({"shapes": shapes, **facts}))
    said: list[str] = []
    found = {own.name: np.linalg.norm(np.diff(own.points, axis=0)) for own in read_specimens(tmp_path, said.append)}
    assert found == {"a": 5, "b": 10, "c": 10}
    assert said == ["a.json: positions are for another size of the image, and are scaled along: a.png"]


def test_a_record_for_an_image_of_another_form_is_left_out(tmp_path):
    write_image(tmp_path / "a.png", np.zeros((20, 30, 3), np.uint8))
    rows = "".join(f"{name},{w},20,{x},{x}\n" for name, w in (("a.png", 20), ("b.png", 30)) for x in (2, 4))
    (tmp_path / "t.csv").write_text(f"image,image_width,image_height,x,y\n{rows}")
    said: list[str] = []
    assert [own.name for own in read_specimens(tmp_path / "t.csv", said.append)] == ["b"]
    assert len(said) == 1 and said[0].startswith("t.csv: left out a.png (because the file is for an image of 20 x 20")


def test_specimens_of_one_name_with_other_landmarks_are_named(tmp_path):
    for name, more in (("a", 0), ("b", 1), ("c", 9)):
        (tmp_path / f"{name}.csv").write_text(f"image,x,y\nwing1,1,2\nwing1,3,{4 + more}\n")
    said: list[str] = []
    assert [own.points.tolist() for own in read_specimens(tmp_path, said.append)] == [[[1, 2], [3, 4]]]
    assert said == ["left out of c.csv, because others of these names were read before, from a.csv: wing1"]


def test_landmarks_in_subfolders_of_sides_are_read(tmp_path: Path) -> None:
    for side, shift in (("left", 0.0), ("right", 5.0)):
        (tmp_path / side).mkdir()
        for name in ("w1", "w2"):
            write_landmarks(tmp_path / side / f"{name}.pts", Landmarks(POINTS + shift))
    (tmp_path / ".hidden").mkdir()
    write_landmarks(tmp_path / ".hidden" / "w3.pts", Landmarks(POINTS))
    (tmp_path / "notes.txt").write_text("The flies of the third drawer.\n")
    for path in (tmp_path, tmp_path / "**"):
        specimens = read_specimens(path)
        assert [each.name for each in specimens] == ["left/w1", "left/w2", "right/w1", "right/w2"]
        assert [each.side for each in specimens] == ["left", "left", "right", "right"]
        assert np.asarray(specimens[2].points) == pytest.approx(POINTS + 5.0)
    assert [each.individual for each in of_one_side(specimens, "reflected")[0]] == ["w1", "w2", "w1", "w2"]
    write_landmarks(tmp_path / "w0.pts", Landmarks(POINTS))
    assert [each.name for each in read_specimens(tmp_path)] == ["w0"]
    assert len(read_specimens(tmp_path / "**")) == 5
    (tmp_path / "w0.pts").rename(tmp_path / ".hidden" / "w0.pts")
    (tmp_path / "left").rename(tmp_path / "hand")
    with pytest.raises(
        LiaamError, match=r"holds no results .*/\*\*' also reads its subfolders; no landmarks are in notes\.txt"
    ):
        read_specimens(tmp_path)


def test_individuals_may_be_added_to_a_table_of_a_batch(tmp_path: Path) -> None:
    path, row = tmp_path / "t.csv", row_of("a.png")
    write_table(path, BatchTable([(json.dumps(row), row)], 3, True, {}))
    header, line = path.read_text(encoding="utf-8").splitlines()
    path.write_text(f"{header},individual\n{line},fly 1\n", encoding="utf-8")
    (specimen,) = read_specimens(path)
    assert specimen.individual == "fly 1"
    assert_fit(specimen)


def saved_by_a_person(table: Path, how: str) -> Path:
    """Save a table of a batch again, as spreadsheets do, or with its columns in another order."""
    rows = list(csv.reader(table.read_text(encoding="utf-8").splitlines()))
    if how == "utf-8 with a byte order mark":
        return saved_as(table.with_name("own.csv"), rows, ",", "utf-8-sig")
    if how == "semicolons and decimal commas":
        rows = [[re.sub(r"\A(-?\d+)\.(\d+)\Z", r"\1,\2", value) for value in row] for row in rows]
        return saved_as(table.with_name("own.csv"), rows, ";", "latin-1")
    if how == "unicode text":
        return saved_as(table.with_name("own.txt"), rows, "\t", "utf-16")
    if how == "spreadsheet":
        path = table.with_name("own.xlsx")
        path.write_bytes(workbook_of(rows))
        return path
    rows = [["fly 1" if i else "individual", *reversed(row)] for i, row in enumerate(rows)]
    return saved_as(table.with_name("own.csv"), rows, ",", "utf-8")


def workbook_of(rows: list[list[str]]) -> bytes:
    main = "http://schemas.openxmlformats.org/spreadsheetml/2006/main"
    office = "http://schemas.openxmlformats.org/officeDocument/2006/relationships"
    cells = [[f'<c t="inlineStr"><is><t>{escape(value)}</t></is></c>' for value in row] for row in rows]
    lines = "".join(f"<row>{''.join(row)}</row>" for row in cells)
    sheet = '<sheets><sheet name="t" r:id="a"/></sheets>'
    parts = {
        "xl/workbook.xml": f'<workbook xmlns="{main}" xmlns:r="{office}">{sheet}</workbook>',
        "xl/_rels/workbook.xml.rels": '<Relationships><Relationship Id="a" Target="worksheets/a.xml"/></Relationships>',
        "xl/worksheets/a.xml": f'<worksheet xmlns="{main}"><sheetData>{lines}</sheetData></worksheet>',
    }
    data = io.BytesIO()
    with zipfile.ZipFile(data, "w") as archive:
        for name, text in parts.items():
            archive.writestr(name, text)
    return data.getvalue()


def saved_as(path: Path, rows: list[list[str]], separator: str, encoding: str) -> Path:
    with path.open("w", encoding=encoding, newline="") as file:
        csv.writer(file, delimiter=separator).writerows(rows)
    return path


@pytest.mark.parametrize(
    "how",
    [
        "utf-8 with a byte order mark",
        "semicolons and decimal commas",
        "unicode text",
        "spreadsheet",
        "another order, and a first column of individuals",
    ],
)
def test_tables_of_batches_that_people_save_keep_status_and_errors(tmp_path: Path, how: str) -> None:
    rows = [row_of("bräutigam_left.png"), row_of("b.png", "doubtful") | {"side": "right"}]
    path = tmp_path / "t.csv"
    write_table(path, BatchTable([(json.dumps(row), row) for row in rows], 3, True, {}))
    first, second = read_specimens(saved_by_a_person(path, how))
    assert (first.name, first.status) == ("bräutigam_left", "converged")
    assert (second.name, second.status, second.side, second.is_usable) == ("b", "doubtful", "right", False)
    assert_fit(first)


def test_a_line_of_a_table_of_a_batch_with_too_many_cells_is_named(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text("path,status,quality,x1,y1\na.png,converged,1,2,3\nb.png,converged,1,2,3,4\n")
    with pytest.raises(LiaamError, match=r"t\.csv: line 3 has 6 cells but the header 5: correct the line"):
        read_specimens(tmp_path / "t.csv")


@pytest.mark.parametrize("names", [(), ("base", "tip", "end")])
def test_a_fit_as_csv_keeps_its_status_and_side(tmp_path: Path, names: tuple[str, ...]) -> None:
    landmarks = Landmarks(POINTS, names=names)
    write_fit(tmp_path / "a_left.csv", landmarks, {"status": "doubtful", "side": "right"}, (30, 40))
    (specimen,) = read_specimens(tmp_path)
    assert (specimen.status, specimen.side, specimen.names, specimen.is_usable) == ("doubtful", "right", names, False)
    np.testing.assert_array_equal(specimen.points, POINTS)


def test_a_column_status_counts_if_it_is_that_of_a_fit(tmp_path: Path) -> None:
    rows = ["a,1,2,checked", "a,3,5,checked", "b,1,2,diverged", "b,3,5,diverged", "c,1,2,", "c,3,5,"]
    (tmp_path / "t.csv").write_text("\n".join(["image,x,y,status", *rows]))
    statuses = [specimen.status for specimen in read_specimens(tmp_path / "t.csv")]
    assert statuses == ["", "diverged", ""]
    (tmp_path / "t.csv").write_text("image,X1,Y1,X2,Y2,status\na,1,2,3,5,error\nb,1,2,3,5,converged\n")
    assert [specimen.is_usable for specimen in read_specimens(tmp_path / "t.csv")] == [False, True]


@pytest.mark.parametrize("scale", [None, "0.1 mm"])
def test_tables_of_measurements_are_no_landmarks(tmp_path: Path, scale: str | None) -> None:
    moved = [Specimen(f"w{i}", POINTS * (i + 1), side="right") for i in range(3)]
    write_columns(tmp_path / "table.csv", measure(moved, "distance:1-2", scale))
    with pytest.raises(LiaamError, match=r"table\.csv: it is a table of 'liaam measure', whose coordinates are those"):
        read_specimens(tmp_path / "table.csv")
    for name in ("table_groups.csv", "table_components.csv"):
        first = "group,specimens,landmark,x,y" if "groups" in name else "component,of,X1,Y1,X2,Y2"
        row = "female,3,1,0.5,-0.5" if "groups" in name else "mean,,0.5,-0.5,0.1,0.2"
        (tmp_path / name).write_text(f"{first}\n{row}\n{row}\n")
        with pytest.raises(LiaamError, match=f"{name}: it is a table of 'liaam measure'"):
            read_specimens(tmp_path / name)
    (tmp_path / "theirs.csv").write_text("specimen,centroid_size,X1,Y1,X2,Y2\na,5,10,20,13,24\n")
    (specimen,) = read_specimens(tmp_path / "theirs.csv")
    assert measure([specimen], "distance:1-2")["distance_1_2"] == [5.0]
