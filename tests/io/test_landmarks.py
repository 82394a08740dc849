"""Landmark files: each format's convention by a number, round trips, and a message for every bad file."""

import json
import math
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings, strategies as st

from fuzz.landmarks import corpus
from liaam.error_measures import point_error
from liaam.errors import LandmarkError, LiaamError
from liaam.io import (
    LANDMARK_SUFFIXES,
    Contour,
    Landmarks,
    image_size,
    read_collection,
    read_landmarks,
    write_collection,
    write_image,
    write_landmarks,
)
from liaam.io.landmarks import Notes, Reading, parse_landmark_data
from liaam.io.landmarks.base import chain_edges, contour_of, edges_of
from setups import growth

SOME = settings(
    max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow]
)
NAN = math.nan

ASF = """# a comment
3
0 0 0.25 0.5 0 2 1 0.0 0.0 0.0
0 0 0.50 0.5 1 0 2 0.0 0.0 0.0
0 0 0.00 1.0 2 1 0 0.0 0.0 0.0
# host image
face.jpg
"""
DLIB = """<?xml version='1.0' encoding='ISO-8859-1'?>
<?xml-stylesheet type='text/xsl' href='image_metadata_stylesheet.xsl'?>
<dataset><name>faces</name><images>
  <image file='a.jpg'>
    <box top='0' left='0' width='10' height='10'><part name='0' x='90' y='91'/></box>
    <box top='0' left='0' width='20' height='10'>
      <part name='10' x='5' y='6'/><part name='2' x='3' y='4'/><part name='0' x='1' y='2'/>
    </box>
    <box top='0' left='0' width='90' height='90'/>
  </image> <image file='sub/b.jpg'><box top='0' left='0' width='9' height='9'><part name='2' x='7'
  y='8'/></box></image> <image file='c.jpg'/>
</images></dataset>
"""
COCO = {
    "images": [
        {"id": 7, "file_name": "a.jpg"},
        {"id": 8, "file_name": "b.jpg"},
        {"id": 9, "file_name": "c.jpg"},
    ],
    "annotations": [
        {"image_id": 7, "category_id": 1, "area": 5, "keypoints": [1, 1, 2, 1, 1, 2, 1, 1, 2]},
        {"image_id": 7, "category_id": 1, "area": 50, "keypoints": [10, 20.5, 2, 0, 0, 0, 30, 40, 1]},
        {"image_id": 8, "category_id": 1, "bbox": [0, 0, 2, 3], "keypoints": [1, 2, 2, 3, 4, 2, 5, 6, 2]},
        {"image_id": 8, "category_id": 1, "bbox": [0, 0, 2, 2], "keypoints": [9, 9, 2, 9, 9, 2, 9, 9, 2]},
        {"image_id": 9, "category_id": 1, "area": 5},
    ],
    "categories": [{"id": 1, "keypoints": ["nose", "eye", "ear"], "skeleton": [[1, 2], [2, 3]]}],
}


def save(folder: Path, name: str, content: str | bytes | dict) -> Path:
    if isinstance(content, dict):
        content = json.dumps(content)
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def refusal(path: Path, image_size: tuple[int, int] | None = (100, 100)) -> str:
    with pytest.raises(LandmarkError) as caught:
        read_landmarks(path, image_size)
    assert str(path) in str(caught.value)
    return str(caught.value)


def ljson(points: object, **more: object) -> dict:
    return {"version": 2, "labels": [], "landmarks": {"points": points, **more}}


# Conventions, one number each ----------------------------------------------------------------------


def test_pts_counts_from_one(tmp_path: Path) -> None:
    path = save(tmp_path, "a.pts", "version: 1\nn_points: 2\n{\n1 1\n10.5 20\n}\n")
    assert read_landmarks(path).points.tolist() == [[0, 0], [9.5, 19]]
    write_landmarks(tmp_path / "b.pts", np.array([[0.0, 0.0], [NAN, NAN]]))
    assert (tmp_path / "b.pts").read_text() == "version: 1\nn_points: 2\n{\n1.0 1.0\nnan nan\n}\n"


def test_asf_is_relative_to_width_and_height(tmp_path: Path) -> None:
    shape = read_landmarks(save(tmp_path, "a.asf", ASF), (800, 600))
    assert shape.points.tolist() == [[200, 300], [400, 300], [0, 600]]
    assert shape.contours == (Contour((0, 1, 2), closed=True),)
    assert shape.image_name == "face.jpg"


def test_tem_counts_pixels_from_zero_downwards(tmp_path: Path) -> None:
    text = "4\n0 0\n3.5 7\n5 5\n6 6\n4\n0\n2\n0 0\n0\n4\n0 1 2 0\n1\n3\n1 2 3\n0\n2\n2 3\n"
    template = read_landmarks(save(tmp_path, "a.tem", text))
    assert template.points[:2].tolist() == [[0, 0], [3.5, 7]]
    assert template.contours == (
        Contour((0, 1, 2), closed=True),  # its last point is its first
        Contour((1, 2, 3), closed=True),  # its type is 1
        Contour((2, 3), closed=False),
    )
    assert read_landmarks(save(tmp_path, "b.tem", "1\n2 3\n")).contours == ()
    trailing = read_landmarks(save(tmp_path, "c.tem", text + "43\n"))  # as in faces-cc/canada
    assert trailing.contours == template.contours


def test_ljson_puts_y_first_and_null_is_missing(tmp_path: Path) -> None:
    content = ljson([[20, 10], [None, None], [0.5, 0]], connectivity=[[0, 1], [1, 2], [2, 0]])
    marks = read_landmarks(save(tmp_path, "a.ljson", content))
    np.testing.assert_array_equal(marks.points, [[10, 20], [NAN, NAN], [0, 0.5]])
    assert marks.contours == (Contour((0, 1, 2), closed=True),)
    assert marks.missing.tolist() == [False, True, False]
    three = {"version": 3, "groups": {"LJSON": content}}
    np.testing.assert_array_equal(read_landmarks(save(tmp_path, "b.ljson", three)).points, marks.points)


def test_ljson_is_written_as_menpo_reads_it(tmp_path: Path) -> None:
    write_landmarks(tmp_path / "a.ljson", Landmarks(np.array([[10, 20], [NAN, NAN]]), (Contour((0, 1)),)))
    assert json.loads((tmp_path / "a.ljson").read_text()) == {
        "version": 2,
        "labels": [{"label": "all", "mask": [0, 1]}],
        "landmarks": {"points": [[20, 10], [None, None]], "connectivity": [[0, 1]]},
    }


def test_dlib_counts_pixels_from_zero_and_orders_parts_by_number(tmp_path: Path) -> None:
    found = read_collection(save(tmp_path, "a.xml", DLIB))
    assert list(found) == ["a.jpg", "sub/b.jpg"]
    assert found["a.jpg"].points.tolist() == [[1, 2], [3, 4], [5, 6]]  # of the largest box that has parts
    np.testing.assert_array_equal(found["sub/b.jpg"].points, [[NAN, NAN], [7, 8], [NAN, NAN]])
    assert found["a.jpg"].names == ("0", "2", "10")


def test_coco_is_taken_without_a_shift_and_v_zero_is_missing(tmp_path: Path) -> None:
    found = read_collection(save(tmp_path, "a.json", COCO))
    assert list(found) == ["a.jpg", "b.jpg"]
    np.testing.assert_array_equal(found["a.jpg"].points, [[10, 20.5], [NAN, NAN], [30, 40]])
    assert found["b.jpg"].points.tolist() == [[1, 2], [3, 4], [5, 6]]
    assert found["a.jpg"].names == ("nose", "eye", "ear")
    assert found["a.jpg"].contours == (Contour((0, 1, 2), closed=False),)  # its skeleton counts from 1


def test_csv_is_our_own_convention(tmp_path: Path) -> None:
    marks = read_landmarks(save(tmp_path, "a.csv", "x,y,name\n0,0,nose\n,,ear\n10.5,20,eye\n"))
    np.testing.assert_array_equal(marks.points, [[0, 0], [NAN, NAN], [10.5, 20]])
    assert marks.names == ("nose", "ear", "eye")


def test_csv_collection_groups_rows_by_image(tmp_path: Path) -> None:
    path = save(tmp_path, "a.csv", "image,x,y\na.jpg,1,2\nb.jpg,5,6\na.jpg,3,4\nb.jpg,,\n")
    found = read_collection(path)
    assert found["a.jpg"].points.tolist() == [[1, 2], [3, 4]]
    np.testing.assert_array_equal(found["b.jpg"].points, [[5, 6], [NAN, NAN]])
    assert found["b.jpg"].image_name == "b.jpg"


# Variants of a format ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "text",
    [
        "version: 1\r\nn_points:  2\r\n{\r\n2 3\r\n4 5\r\n}\r\n",
        "\ufeffn_points:2\n{\n2 3\n4 5\n}",
        "# made by hand\nversion: 1.0\nN_POINTS: 2 // two\n{ \n\n2 3 # nose\n4\t5\n\n}\n\n",
        "{\n2 3\n4 5\n}\n",
        "n_points = 2 {\n  2.0e0   3\n4 5}",
    ],
)
def test_pts_header_variants(tmp_path: Path, text: str) -> None:
    assert read_landmarks(save(tmp_path, "a.pts", text)).points.tolist() == [[1, 2], [3, 4]]


@pytest.mark.parametrize("word", ["nan", "NaN", "null", "NA", "?", "-"])
def test_words_for_missing(tmp_path: Path, word: str) -> None:
    path = save(tmp_path, "a.pts", f"n_points: 2\n{{\n{word} {word}\n1 1\n}}")
    assert read_landmarks(path).missing.tolist() == [True, False]


def test_csv_of_european_spreadsheets(tmp_path: Path) -> None:
    path = save(tmp_path, "a.csv", "Name;X;Y;Note\r\nnez;1,5;2;\r\nœil;;;\r\n".encode("utf-16"))
    marks = read_landmarks(path)
    np.testing.assert_array_equal(marks.points, [[1.5, 2], [NAN, NAN]])
    assert marks.names == ("nez", "œil")


def test_text_in_an_old_encoding(tmp_path: Path) -> None:
    path = save(tmp_path, "a.csv", "x,y,name\n1,2,bouché\n".encode("latin-1"))
    assert read_landmarks(path).names == ("bouché",)


def test_suffix_in_capitals_and_text_path(tmp_path: Path) -> None:
    path = save(tmp_path, "A.PTS", "{\n1 1\n}")
    assert read_landmarks(str(path)).points.tolist() == [[0, 0]]


def test_collection_of_one_image_reads_as_one(tmp_path: Path) -> None:
    path = save(tmp_path, "a.csv", "image,x,y\na.jpg,1,2\n")
    assert read_landmarks(path).points.tolist() == [[1, 2]]


def test_coco_without_categories(tmp_path: Path) -> None:
    content = {key: value for key, value in COCO.items() if key != "categories"}
    found = read_collection(save(tmp_path, "a.json", content))
    assert found["a.jpg"].names == ()
    assert found["a.jpg"].contours == ()


def test_tables_in_other_shapes(tmp_path: Path) -> None:
    tabs = read_landmarks(save(tmp_path, "a.csv", "\n \nY\tX\tname\n2\t1\tnose, tip; end\n\n4\t3\t\n"))
    assert (tabs.points.tolist(), tabs.names) == ([[1, 2], [3, 4]], ("nose, tip; end", ""))
    empty = read_landmarks(save(tmp_path, "a.csv", "x,y,name\n1,2,\n,,\n"))  # a row of nothing is a missing landmark
    assert (empty.missing.tolist(), empty.names) == ([False, True], ())
    short = read_landmarks(save(tmp_path, "a.csv", "x;y\n1,5;2,25\n"))
    assert short.points.tolist() == [[1.5, 2.25]]
    commas = read_landmarks(save(tmp_path, "a.csv", "x,y,a;b\n1,2,3\n"))  # a comma comes first
    assert commas.points.tolist() == [[1, 2]]


def test_a_collection_with_names_for_some(tmp_path: Path) -> None:
    named = Landmarks(np.array([[1.0, 2.0], [NAN, NAN]]), names=("nose", "eye"))
    write_collection(tmp_path / "a.csv", {"a.jpg": named, "b.jpg": Landmarks(np.array([[3.0, 4.0]]))})
    assert (tmp_path / "a.csv").read_bytes() == (
        b"image,x,y,name\r\na.jpg,1.0,2.0,nose\r\na.jpg,,,eye\r\nb.jpg,3.0,4.0,\r\n"
    )
    found = read_collection(tmp_path / "a.csv")
    assert (found["a.jpg"].names, found["b.jpg"].names) == (("nose", "eye"), ())
    write_landmarks(tmp_path / "c.csv", named)
    assert (tmp_path / "c.csv").read_bytes() == b"x,y,name\r\n1.0,2.0,nose\r\n,,eye\r\n"
    write_landmarks(tmp_path / "b.csv", np.array([[1.5, 2.0]]))
    assert (tmp_path / "b.csv").read_bytes() == b"x,y\r\n1.5,2.0\r\n"


def test_coco_is_written_with_names_contours_sizes_and_visibility(tmp_path: Path) -> None:
    contours = (Contour((0, 1, 2), closed=True), Contour((3, 4)))
    points = np.array([[1.0, 2.0], [5.0, 2.0], [5.0, 8.5], [NAN, NAN], [9.0, 9.0]])
    marks = Landmarks(points, contours, tuple("abcde"), invisible=(1,))
    other = Landmarks(points + 1, contours, tuple("abcde"))
    write_collection(tmp_path / "a.json", {"a.jpg": marks, "sub/b.jpg": other}, {"a.jpg": (40, 30)})
    found = read_collection(tmp_path / "a.json")
    assert list(found) == ["a.jpg", "sub/b.jpg"]
    assert np.array_equal(found["a.jpg"].points, points, equal_nan=True)
    assert (found["a.jpg"].invisible, found["sub/b.jpg"].invisible) == ((1,), ())
    assert (found["sub/b.jpg"].names, found["sub/b.jpg"].contours) == (marks.names, contours)
    content = json.loads((tmp_path / "a.json").read_text())
    assert content["images"][0] == {"id": 1, "file_name": "a.jpg", "width": 40, "height": 30}
    annotation = content["annotations"][0]
    assert annotation["keypoints"][2::3] == [2, 1, 2, 0, 2]
    assert (annotation["num_keypoints"], annotation["bbox"], annotation["area"]) == (4, [1, 2, 8, 7], 56)


def test_asf_columns_of_the_user_and_the_host_image_are_optional(tmp_path: Path) -> None:
    short = ASF.replace(" 0.0 0.0 0.0", "")
    assert read_landmarks(save(tmp_path, "a.asf", short), (800, 600)).image_name == "face.jpg"
    alone = short.replace("# host image\nface.jpg\n", "")
    marks = read_landmarks(save(tmp_path, "a.asf", alone), (800, 600))
    assert (marks.image_name, len(marks)) == (None, 3)


def imglab(*boxes: str) -> str:
    return f"<dataset><images><image file='a.jpg'>{''.join(boxes)}</image></images></dataset>"


def box(x: int, size: str = "", name: str = "1") -> str:
    return f"<box {size}><part name='{name}' x='{x}' y='0'/></box>"


@pytest.mark.parametrize(
    ("boxes", "x"),
    [
        ((box(1, "width='2' height='3'"), box(2, "width='3' height='2'")), 1),  # the first of equals
        ((box(1, "width='2' height='3'"), box(2, "width='7' height='1'")), 2),
        ((box(1, "width='9'"), box(2, "height='9' width='1'")), 2),  # what is left out counts as 0
        ((box(1), box(2)), 1),
    ],
)
def test_the_largest_box_comes_first(tmp_path: Path, boxes: tuple[str, ...], x: int) -> None:
    found = read_collection(save(tmp_path, "a.xml", imglab(*boxes)))["a.jpg"]
    assert found.points.tolist() == [[x, 0]]
    assert [other.points.tolist() for other in found.others] == [[[3 - x, 0]]]


@pytest.mark.parametrize("width", ["nan", "wide", "inf"])
def test_a_box_of_unknown_size_is_small(tmp_path: Path, width: str) -> None:
    boxes = box(1, f"width='{width}' height='5'"), box(2, "width='1' height='1'")
    assert read_collection(save(tmp_path, "a.xml", imglab(*boxes)))["a.jpg"].points.tolist() == [[2, 0]]


def test_all_boxes_have_the_same_landmarks(tmp_path: Path) -> None:
    boxes = box(1, "width='9' height='9'", name="2"), box(5, "width='2' height='2'", name="10")
    found = read_collection(save(tmp_path, "a.xml", imglab(*boxes)))["a.jpg"]
    np.testing.assert_array_equal(found.points, [[1, 0], [NAN, NAN]])
    np.testing.assert_array_equal(found.others[0].points, [[NAN, NAN], [5, 0]])
    assert found.names == found.others[0].names == ("2", "10")


def test_dlib_parts_and_images_without_a_name(tmp_path: Path) -> None:
    text = "<dataset><image><box><part x='1' y='2'/><part name='b' x='' y=''/></box></image></dataset>"
    found = read_collection(save(tmp_path, "a.xml", text))
    assert list(found) == [""]
    np.testing.assert_array_equal(found[""].points, [[1, 2], [NAN, NAN]])
    assert found[""].names == ("", "b")


@pytest.mark.parametrize(("n", "refused"), [(20, False), (21, True)])
def test_dlib_images_may_lack_twenty_parts_for_each_that_they_have(tmp_path: Path, n: int, refused: bool) -> None:
    images = "".join(f"<image file='{i}'>{box(1, name=str(i))}</image>" for i in range(n))
    path = save(tmp_path, "a.xml", f"<dataset>{images}</dataset>")
    if not refused:
        assert len(read_collection(path)) == n
        return
    with pytest.raises(LandmarkError, match=r"its 21 boxes share hardly any of the 21 part names"):
        read_collection(path)


def coco(*annotations: dict) -> dict:
    whole = ({"image_id": 7, "keypoints": [i, 0, 2], **more} for i, more in enumerate(annotations, 1))
    return {"images": [{"id": 7, "file_name": "a.jpg"}], "annotations": list(whole)}


@pytest.mark.parametrize(
    ("annotations", "x"),
    [
        (({"area": 5}, {"area": 5}), 1),  # the first of equals
        (({"area": 5}, {"area": 6}), 2),
        (({"area": 5}, {"bbox": [0, 0, 2, 3]}), 2),
        (({"bbox": [9, 9, 2, 3]}, {"bbox": [0, 0, 7, 1]}), 2),
        (({"area": None}, {"area": 1}), 2),  # unknown counts as 0, and so what is no number
        (({"area": "big"}, {"bbox": [0, 0, 1, 1]}), 2),
        (({"bbox": [0, 0, "w", 1]}, {"area": 1}), 2),
        (({"bbox": [0, 0]}, {"area": 1}), 2),
        (({}, {"area": 0.5}), 2),
        (({}, {"area": -1}), 1),
        (({"area": 9, "keypoints": []}, {}), 2),
    ],
)
def test_the_largest_annotation_comes_first(tmp_path: Path, annotations: tuple[dict, ...], x: int) -> None:
    assert read_collection(save(tmp_path, "a.json", coco(*annotations)))["a.jpg"].points.tolist() == [[x, 0]]


def test_other_annotations_come_by_size_unless_they_have_no_keypoint(tmp_path: Path) -> None:
    areas = {"area": 1}, {"area": 9}, {"area": 5}, {"area": 3, "keypoints": [0, 0, 0]}
    found = read_collection(save(tmp_path, "a.json", coco(*areas)))["a.jpg"]
    assert [other.points.tolist() for other in found.others] == [[[3, 0]], [[1, 0]]]
    assert [name for name, _ in found.objects("a")] == ["a", "a#2", "a#3"]


def test_categories_that_say_nothing_or_are_not_used(tmp_path: Path) -> None:
    empty = {"id": 1, "keypoints": None, "skeleton": None}
    unused = {"id": 2, "skeleton": [[1, 2, 3]]}
    found = read_collection(save(tmp_path, "a.json", {**COCO, "categories": [empty, unused]}))
    assert (found["a.jpg"].names, found["a.jpg"].contours) == ((), ())


def test_a_message_names_three_of_many_images(tmp_path: Path) -> None:
    path = save(tmp_path, "a.csv", "image,x,y\na,1,2\nb,1,2\nc,1,2\nd,1,2\n")
    assert "holds the landmarks of 4 images (a, b, c ...): use read_collection" in refusal(path)


def test_ljson_names_are_labels_of_one_landmark_each(tmp_path: Path) -> None:
    def labelled(*labels: tuple[str, list[int]]) -> Landmarks:
        content = {**ljson([[1, 2], [3, 4]]), "labels": [{"label": name, "mask": mask} for name, mask in labels]}
        return read_landmarks(save(tmp_path, "a.ljson", content))

    assert labelled(("b", [1]), ("a", [0])).names == ("a", "b")
    for others in ((("a", [0]),), (("a", [0]), ("b", [0])), (("a", [0, 1]), ("b", [1]))):
        assert labelled(*others).names == ()
    hidden = labelled(("a", [0]), ("b", [1]), ("invisible", [1]))
    assert (hidden.names, hidden.invisible) == (("a", "b"), (1,))
    group = labelled(("all", [0, 1]), ("invisible", [0]))
    assert (group.names, group.invisible) == ((), (0,))
    named = labelled(("invisible", [0]), ("b", [1]))
    assert (named.names, named.invisible) == (("invisible", "b"), ())


def test_ljson_without_labels_and_connectivity(tmp_path: Path) -> None:
    write_landmarks(tmp_path / "a.ljson", np.array([[1.0, 2.0]]))
    content = json.loads((tmp_path / "a.ljson").read_text())
    assert content == {"version": 2, "labels": [], "landmarks": {"points": [[2, 1]]}}
    content["landmarks"]["connectivity"] = content["labels"] = None
    marks = read_landmarks(save(tmp_path, "a.ljson", content))
    assert (marks.contours, marks.names, marks.invisible) == ((), (), ())


def test_text_of_every_encoding(tmp_path: Path) -> None:
    for encoding in ("utf-8-sig", "utf-16", "utf-16-le", "latin-1"):
        mark = b"\xff\xfe" if encoding == "utf-16-le" else b""
        path = save(tmp_path, "a.csv", mark + "x,y,name\r\n1,2,é\tü\f\r\n".encode(encoding))
        assert read_landmarks(path).names == ("é\tü\f",)


# Bad files -----------------------------------------------------------------------------------------

BAD = [
    ("a.pts", "n_points: 3\n{\n1 1\n2 2\n}", "promises 3 points but 2 are there"),
    ("a.pts", "n_points: 1\n{\n1 1\n2 2\n}", "promises 1 points but 2 are there"),
    ("a.pts", "n_points: many\n{\n1 1\n}", "'many' is not a number of points"),
    ("a.pts", "n_points: 1\n{\n1 1\n", "no '}' after its points"),
    ("a.pts", "1 1\n", "no '{' before its points"),
    ("a.pts", "{\n1 1 1\n}", "point 1 holds 3 values ('1 1 1')"),
    ("a.pts", "{\n1 1\n1\n}", "point 2 holds 1 values"),
    ("a.pts", "{\n1,5 2\n}", "decimal points, as in 12.5"),
    ("a.pts", "{\n1 1_000\n}", "'1_000' in point 1 is not a number"),
    ("a.pts", "{\n1 inf\n}", "'inf' in point 1 is not a number"),
    ("a.pts", "{\n1 nan\n}", "point 1 has only one of x and y: give both"),
    ("a.pts", "n_points: 0\n{\n}", "n > 0"),
    ("a.pts", "n_points: 999999999999999999\n{\n1 1\n}", "promises 999999999999999999 points but 1 are there"),
    ("a.pts", "n_points: 1000000000000000000\n{\n1 1\n}", "'1000000000000000000' is not a number of points"),
    ("a.pts", "{\n1 " + "x" * 41 + "\n}", f"'{'x' * 37}...' in point 1 is not a number"),
    ("a.pts", "", "is empty (0 bytes)"),
    ("a.pts", " \n\n", "only blank lines"),
    ("a.pts", b"{\n\x00\x01\n}", "is not a text file"),
    ("a.pts", bytes(range(256)), "is not a text file"),
    ("a.pts", b"{\n1 1\n}\x01\xff", "is not a text file"),
    ("a.pts", b"\xff\xfe\x00", "is not a text file"),
    ("a.asf", "# nothing\n", "holds comments only"),
    ("a.asf", ASF.replace("3\n0", "three\n0"), "'three' is not a number of points"),
    ("a.asf", ASF.replace("0.5 1 0 2", "0.5 -1 0 2"), "'-1' is not a number of a point"),
    ("a.asf", ASF.replace("0.5 1 0 2", "0.5 0 0 2"), "number the points 0 to 2"),
    (
        "a.asf",
        ASF.replace("2 0.0 0.0 0.0\n0 0 0.00", "2\n0 0 0.00").replace("0.50 0.5 1 0 2", "0.50 0.5 1 0"),
        "but 2 are",
    ),
    ("a.asf", ASF.replace("3\n0", "88888888888\n0"), "promises 88888888888 points but 3 are there"),
    ("a.asf", ASF.replace("0.5 1 0 2", "0.5 1 0 3"), "names point 3, but has points 0 to 2"),
    ("a.asf", ASF.replace("0.25", "left"), "'left' in point 0 is not a number"),
    ("a.asf", ASF[:60], "promises 3 points but"),
    ("a.tem", "777777777777777\n1 1\n", "promises 777777777777777 points but 1 are there"),
    ("a.tem", "2.5\n1 1\n", "'2.5' is not a number of points"),
    ("a.tem", "2\n1 1\n2 2\n1\n0\n3\n0 1", "ends within its line templates"),
    ("a.tem", "2\n1 1\n2 2\n1\n0\n999999999999\n0 1", "ends within its line templates"),
    ("a.tem", "2\n1 1\n2 2\n1\n0\n2\n0 5", "names landmark 5 (counting from 0), but there are 2"),
    ("a.ljson", '{"version": 2, "landm', "is not complete JSON"),
    ("a.ljson", "[" * 100_000, "is not complete JSON"),
    ("a.ljson", {"version": 4, "groups": []}, "it says 4"),
    ("a.ljson", {"version": 1, "groups": []}, "n > 0"),
    ("a.ljson", "[1]", "it says None"),
    ("a.ljson", {"version": 2}, "lacks the parts of a menpo"),
    ("a.ljson", {"version": 3, "groups": {}}, "lacks the parts of a menpo"),
    ("a.ljson", {"version": 3, "groups": {"a": 1, "b": 2}}, "2 groups of landmarks (a, b)"),
    ("a.ljson", ljson([[1, 2, 3]]), "lacks the parts of a menpo"),
    ("a.ljson", ljson([["one", 2]]), "'one' in point 1 is not a number"),
    ("a.ljson", ljson([[True, 2]]), "'True' in point 1 is not a number"),
    ("a.ljson", ljson([[10**400, 2]]), "in point 1 is not a number"),
    ("a.ljson", ljson([[1, None]]), "only one of x and y"),
    ("a.ljson", ljson([[1, 2]], connectivity=[[0, 4]]), "names landmark 4"),
    ("a.ljson", ljson([[1, 2]], connectivity=[[0, 0.5]]), "lacks the parts of a menpo"),
    ("a.ljson", ljson([]), "n > 0"),
    ("a.ljson", ljson([[1, 2], ["x" * 50, 2]]), f"'{'x' * 37}...' in point 2 is not a number: correct it"),
    ("a.ljson", {**ljson([[1, 2]]), "labels": [{"label": "a", "mask": [0.5]}]}, "lacks the parts of a menpo"),
    ("a.ljson", {"version": 2, "landmarks": 5}, "lacks the parts of a menpo"),
    ("a.ljson", "[" + "1," * 90 + "x", "is not complete JSON (Expecting value: line 1 column 182 (char 181))"),
    ("a.xml", DLIB[:-40], "is not complete XML"),
    ("a.xml", "<dataset><images/></dataset>", "no landmarks in it (dlib imglab)"),
    ("a.xml", '<!DOCTYPE d [<!ENTITY a "aaaa">]><d>&a;</d>', "not safe to read"),
    ("a.xml", '<!DOCTYPE d [<!ENTITY a "aaaa">]><d>&a;</d>'.encode("utf-16"), "not safe to read"),
    ("a.xml", "<!DOCTYPE d><dataset/>", "not safe to read"),
    ("a.xml", "<dataset/><!ENTITY a 'a'>", "not safe to read"),
    ("a.xml", DLIB, "holds the landmarks of 2 images (a.jpg, sub/b.jpg ...)"),
    ("a.json", "{}", "this is none of LabelMe"),
    ("a.json", {**COCO, "images": [7]}, "lacks the parts of a COCO"),
    ("a.json", {**COCO, "annotations": [7]}, "lacks the parts of a COCO"),
    ("a.json", "3", "this is none of LabelMe"),
    ("a.json", {**COCO, "annotations": []}, "no landmarks in it (COCO keypoints)"),
    (
        "a.json",
        {**COCO, "annotations": [{"image_id": 1, "keypoints": [1, 2, 2]}]},
        "the file has no image 1: add it",
    ),
    ("a.json", {**COCO, "annotations": [{"image_id": 7, "keypoints": [1, 2]}]}, "has 2 keypoint values"),
    (
        "a.json",
        {**COCO, "annotations": [{"image_id": 7, "keypoints": "abc"}]},
        "'c' in a keypoint of 'a.jpg'",
    ),
    ("a.csv", "a,b\n1,2\n", "no columns x and y"),
    ("a.csv", "x,y\n", "no landmarks in it (table)"),
    ("a.csv", "x,y\n1,2\n\n\n3,4,5\n", "line 5 has 3 cells but the header 2"),
    ("a.csv", 'x,y,name\n1,2,"a\nb"\n1,\n', "line 4 has 2 cells but the header 3"),
    ("a.csv", "x,y\n,2\n", "line 2 has only one of x and y: give both"),
    ("a.csv", 'x,y\n1,"2,5"\n', "'2,5' in line 2 is not a number"),
    ("a.csv", 'x,y\n1,"2\n' + "2" * 200_000, "is not a CSV table"),
    ("a.txt", "Read me, please.\n", "no columns x and y, or rows of x and y"),
    ("a.nts", "1 1L 3 0 DIM=3\na\n1 2 3\n", "it holds 3 columns of 3 dimensions"),
    ("a.doc", "1 2\n", "has the extension '.doc', not that of a landmark format: use .pts (300-W points)"),
    ("a", "1 2\n", "has the extension ''"),
]

ONE_RECORD = [
    ("a.xml", DLIB.replace("x='90'", "x='ninety'"), "'ninety' in point '0' of 'a.jpg' is not a number"),
    ("a.xml", DLIB.replace("name='2' x='3'", "name='0' x='3'"), "part '0' of image 'a.jpg' occurs twice"),
    (
        "a.json",
        {**COCO, "annotations": [{**COCO["annotations"][0], "keypoints": [1, 2, 2]}]},
        "3 names for 1",
    ),
    ("a.json", {**COCO, "categories": [{"id": 1, "skeleton": [[1, 2, 3]]}]}, "edges of the skeleton are left out"),
    ("a.json", {**COCO, "categories": [{"id": 1, "skeleton": [[-1, 1]]}]}, "edges of the skeleton are left out"),
    ("a.json", {**COCO, "images": [{"id": 7}, *COCO["images"][1:]]}, "lacks parts or has others"),
]


@pytest.mark.parametrize(("name", "content", "words"), ONE_RECORD, ids=[f"{n}-{w[:30]}" for n, _, w in ONE_RECORD])
def test_one_bad_record_stops_only_strict_reading(tmp_path: Path, name: str, content: str | dict, words: str) -> None:
    path = save(tmp_path, name, content)
    with pytest.warns(UserWarning, match=r"left out|names for|without names"):
        assert read_collection(path)
    with pytest.raises(LandmarkError) as caught:
        read_collection(path, Reading(strict=True))
    assert words in str(caught.value)


@pytest.mark.parametrize(("name", "content", "words"), BAD, ids=[f"{n}-{w[:30]}" for n, _, w in BAD])
def test_bad_files_are_refused_with_a_message(
    tmp_path: Path, name: str, content: str | bytes | dict, words: str
) -> None:
    assert words in refusal(save(tmp_path, name, content))


def test_missing_file_and_folder(tmp_path: Path) -> None:
    save(tmp_path, "face_01.pts", "{\n1 1\n}")
    assert "Did you mean face_01.pts?" in refusal(tmp_path / "face_1.pts")
    (tmp_path / "b.pts").mkdir()
    assert "is a folder" in refusal(tmp_path / "b.pts")


def test_asf_without_a_size_says_what_to_pass(tmp_path: Path) -> None:
    assert "pass image_size=(width, height)" in refusal(save(tmp_path, "a.asf", ASF), None)


def test_a_huge_file_is_not_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("liaam.io.landmarks.reading.MAX_BYTES", 10)
    assert "more than the 10 allowed" in refusal(save(tmp_path, "a.pts", "{\n1 1\n2 2\n}"))


def test_read_collection_of_one_image_s_file(tmp_path: Path) -> None:
    for name, text in (("a.pts", "{\n1 1\n}"), ("a.csv", "x,y\n1,2\n")):
        with pytest.raises(LandmarkError, match="use read_landmarks"):
            read_collection(save(tmp_path, name, text))


@pytest.mark.parametrize(
    ("points", "more", "words"),
    [
        ([[1, 2, 3]], {}, r"shape \(1, 3\)"),
        ([], {}, "n > 0"),
        ("ab", {}, "not numbers"),
        ([[1, NAN]], {}, "only one of x and y"),
        ([[1, math.inf]], {}, "infinite"),
        ([[1, 2]], {"names": ("a", "b")}, "2 names for 1 landmarks"),
        ([[1, 2]], {"contours": (Contour((0, 1)),)}, "names landmark 1"),
        ([[1, 2]], {"contours": (Contour((-1, 0)),)}, "names landmark -1"),
        ([[1, 2]], {"invisible": (-1,)}, r"marked as invisible is landmark -1 .*but there are 1"),
        (np.zeros((0, 2)), {}, r"shape \(0, 2\)"),
        ([[1, 2], [NAN, 2]], {}, r"landmark 2 \(counting from 1\) has only one of x and y"),
    ],
)
def test_landmarks_are_validated(points: object, more: dict, words: str) -> None:
    with pytest.raises(LandmarkError, match=words):
        Landmarks(points, **more)  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize("names", [("T1.PNG", "T2.png"), ("t1", "t2"), ("C:\\scans\\t1.png", "T2")])
def test_images_are_named_in_any_case_or_without_suffix(tmp_path: Path, names: tuple[str, str]) -> None:
    for stem in ("t1", "t2", "t12"):
        write_image(tmp_path / f"{stem}.png", np.zeros((20, 30, 3), np.uint8))
    records = [f"LM=1\n{3 + i} 4\nIMAGE={name}\nID={i}\n" for i, name in enumerate(names)]
    (tmp_path / "w.tps").write_text("".join(records))
    assert list(read_collection(tmp_path / "w.tps")) == list(names)
    second = read_landmarks(tmp_path / "w.tps", image_name="t2.png")
    np.testing.assert_array_equal(second.points, [[4, 15]])
    write_image(tmp_path / "t2.tif", np.zeros((40, 30, 3), np.uint8))  # as in load_folder, the .png counts
    np.testing.assert_array_equal(read_collection(tmp_path / "w.tps")[names[1]].points, [[4, 15]])
    (tmp_path / "w.tps").write_text(f"LM=1\n1 2\nIMAGE={'x' * 300}.png\nID=0\n")
    with pytest.raises(LandmarkError, match="the size of its image is needed"):
        read_landmarks(tmp_path / "w.tps")
    (tmp_path / "w.tps").write_text("".join(records))
    with pytest.raises(LandmarkError, match=r"no landmarks of t3\.png"):
        read_landmarks(tmp_path / "w.tps", image_name="t3.png")


def test_landmarks_are_arrays_where_arrays_are_asked_for(tmp_path: Path) -> None:
    points = np.array([[1.0, 2], [3, 5], [4, 4]])
    np.testing.assert_array_equal(np.asarray(Landmarks(points)), points)
    assert point_error(Landmarks(points), points + 1) == pytest.approx(np.sqrt(2))  # type: ignore[arg-type]
    with pytest.raises(LiaamError, match=r"shapes of \(3, 2\) and \(2, 2\) cannot be compared"):
        point_error(points, points[1:])
    write_collection(tmp_path / "all.csv", {"a.png": points})
    np.testing.assert_array_equal(read_collection(tmp_path / "all.csv")["a.png"].points, points)
    with pytest.raises(LandmarkError, match=r"\.json holds many images, so it is written by write_collection"):
        write_landmarks(tmp_path / "a.json", points)


def test_landmarks_are_a_frozen_copy() -> None:
    points = np.zeros((3, 2))
    marks = Landmarks(points)
    points[0] = 7
    assert marks.points[0].tolist() == [0, 0]
    assert marks.points.dtype == np.float64
    with pytest.raises(ValueError, match="read-only"):
        marks.points[0] = 1
    assert repr(marks) == "Landmarks(3 points, 0 missing, 0 contours)"
    assert repr(Landmarks(points[:1], (Contour((0,)),))) == "Landmarks(1 point, 0 missing, 1 contour)"


# Writing -------------------------------------------------------------------------------------------


def test_what_cannot_be_written(tmp_path: Path) -> None:
    with pytest.raises(LandmarkError, match=r"\.tem is only read\. Use \.pts, \.ljson, \.tps, \.csv\."):
        write_landmarks(tmp_path / "a.tem", np.zeros((1, 2)))
    with pytest.raises(LandmarkError, match="not that of a landmark format"):
        write_landmarks(tmp_path / "a.doc", np.zeros((1, 2)))
    with pytest.raises(LandmarkError, match="shape"):
        write_landmarks(tmp_path / "a.pts", np.zeros((2, 3)))
    with pytest.raises(LandmarkError, match=r"does not exist\. Make it first"):
        write_landmarks(tmp_path / "no" / "a.pts", np.zeros((1, 2)))
    with pytest.raises(LandmarkError, match=r"only \.json, \.tps, \.csv hold many"):
        write_collection(tmp_path / "a.pts", {})
    with pytest.raises(LandmarkError, match="there are no landmarks"):
        write_collection(tmp_path / "a.csv", {})
    assert list(tmp_path.iterdir()) == []


# A magnitude at which adding 1 and taking it away again loses less than 1e-9 of a pixel.
coordinates = st.floats(-1e5, 1e5, allow_nan=False)
point_lists = st.lists(st.one_of(st.tuples(coordinates, coordinates), st.just((NAN, NAN))), min_size=1, max_size=12)
texts = st.text(st.characters(codec="utf-8", exclude_characters="\0"), min_size=1, max_size=8)


@given(points=point_lists, suffix=st.sampled_from([".pts", ".csv", ".ljson", ".tps"]))
@SOME
def test_written_points_come_back(tmp_path: Path, points: list, suffix: str) -> None:
    known = np.array([point for point in points if np.isfinite(point).all()])
    assume(len(known) < 3 or np.abs(known).max() > 2.0)  # others are refused as fractions of the image's size
    write_landmarks(tmp_path / f"a{suffix}", np.array(points), (640, 480))
    back = read_landmarks(tmp_path / f"a{suffix}", (640, 480)).points
    precision = {".pts": 1e-9, ".tps": 0.500001e-3}  # .tps has three decimals
    np.testing.assert_allclose(back, points, rtol=0, atol=precision.get(suffix, 0))


@given(points=point_lists, data=st.data(), suffix=st.sampled_from([".csv", ".ljson"]))
@SOME
def test_names_come_back(tmp_path: Path, points: list, data: st.DataObject, suffix: str) -> None:
    names = tuple(data.draw(st.lists(texts, min_size=len(points), max_size=len(points))))
    counts = {names.count(name) for name in names}
    assume(suffix != ".csv" or len(set(names)) < 2 or counts == {1} or len(counts) > 1)  # those are of several images
    write_landmarks(tmp_path / f"a{suffix}", Landmarks(np.array(points), names=names))
    assert read_landmarks(tmp_path / f"a{suffix}").names == names


@given(points=point_lists, data=st.data())
@SOME
def test_invisible_points_come_back_from_ljson(tmp_path: Path, points: list, data: st.DataObject) -> None:
    n = len(points)
    hidden = tuple(sorted(data.draw(st.sets(st.integers(0, n - 1)))))
    words = st.one_of(texts, st.just("invisible"), st.just("all"))
    names = tuple(data.draw(st.one_of(st.just([]), st.lists(words, min_size=n, max_size=n))))
    assume(names != ("all",) or not hidden)  # so one landmark without a name is written
    write_landmarks(tmp_path / "a.ljson", Landmarks(np.array(points), (), names, None, hidden))
    back = read_landmarks(tmp_path / "a.ljson")
    assert (back.invisible, back.names) == (hidden, names)


def test_a_label_for_invisible_points_is_written_as_menpo_reads_it(tmp_path: Path) -> None:
    write_landmarks(tmp_path / "a.ljson", Landmarks(np.array([[1, 2], [3, 4]]), invisible=(1,)))
    labels = [{"label": "all", "mask": [0, 1]}, {"label": "invisible", "mask": [1]}]
    assert json.loads((tmp_path / "a.ljson").read_text())["labels"] == labels


@pytest.mark.parametrize("suffix", [".pts", ".csv"])
def test_other_formats_drop_what_is_invisible(tmp_path: Path, suffix: str) -> None:
    write_landmarks(tmp_path / f"a{suffix}", Landmarks(np.array([[1, 2], [3, 4]]), invisible=(1,)))
    assert read_landmarks(tmp_path / f"a{suffix}").invisible == ()


def test_invisible_points_are_in_order_and_there_once() -> None:
    assert Landmarks(np.zeros((3, 2)), invisible=(2, 0, 2)).invisible == (0, 2)


def test_invisible_points_have_to_be_there(tmp_path: Path) -> None:
    with pytest.raises(LandmarkError, match=r"marked as invisible is landmark 2 .*but there are 2"):
        Landmarks(np.zeros((2, 2)), invisible=(2,))
    content = {**ljson([[1, 2], [3, 4]]), "labels": [{"label": "invisible", "mask": [7]}]}
    with pytest.raises(LandmarkError, match=r"a\.ljson: marked as invisible is landmark 7"):
        read_landmarks(save(tmp_path, "a.ljson", content))


@given(order=st.permutations(range(9)), cuts=st.sets(st.integers(1, 8)), data=st.data())
@SOME
def test_contours_come_back_from_ljson(tmp_path: Path, order: list[int], cuts: set[int], data: st.DataObject) -> None:
    bounds = [0, *sorted(cuts), 9]
    parts = [tuple(order[a:b]) for a, b in pairwise(bounds) if b - a > 1]
    names = [data.draw(st.sampled_from(["", f"curve {i}"])) for i in range(len(parts))]
    contours = tuple(
        Contour(part, len(part) > 2 and data.draw(st.booleans()), name) for part, name in zip(parts, names, strict=True)
    )
    write_landmarks(tmp_path / "a.ljson", Landmarks(np.zeros((9, 2)), contours))
    assert read_landmarks(tmp_path / "a.ljson").contours == contours


@given(collection=st.dictionaries(texts, point_lists, min_size=1, max_size=4))
@SOME
def test_collections_come_back_from_csv(tmp_path: Path, collection: dict[str, list]) -> None:
    marks = {name: Landmarks(np.array(points)) for name, points in collection.items()}
    write_collection(tmp_path / "a.csv", marks)
    back = read_collection(tmp_path / "a.csv")
    assert list(back) == list(marks)
    for name in marks:
        np.testing.assert_array_equal(back[name].points, marks[name].points)


@pytest.mark.parametrize("suffix", LANDMARK_SUFFIXES)
@given(junk=st.one_of(st.binary(max_size=150), texts.map(str.encode)))
@SOME
def test_junk_raises_only_landmark_errors(tmp_path: Path, suffix: str, junk: bytes) -> None:
    path = save(tmp_path, f"junk{suffix}", junk)
    try:
        read_landmarks(path, (10, 10))  # Hypothesis also draws bytes of modules that are loaded, such as sound files
    except LandmarkError as error:
        assert "junk" in str(error)


BINARY = (".roi", ".zip", ".xlsx")  # test_exports.py damages these


@pytest.mark.filterwarnings("ignore::UserWarning")  # of lines that are left out
@pytest.mark.parametrize("suffix", [suffix for suffix in LANDMARK_SUFFIXES if suffix not in BINARY])
@given(data=st.data())
@SOME
def test_damaged_files_raise_only_landmark_errors(tmp_path: Path, suffix: str, data: st.DataObject) -> None:
    text = data.draw(st.sampled_from(corpus(suffix))).decode()
    place = data.draw(st.integers(0, len(text) - 1))
    patch = data.draw(st.text(st.sampled_from("0123456789-.,[]{}<>/'\"\\ \n\txyn&!#"), max_size=3))
    path = save(tmp_path, f"junk{suffix}", text[:place] + patch + text[place + data.draw(st.integers(0, 5)) :])
    try:
        marks = read_landmarks(path, (10, 10))
    except LandmarkError as error:
        assert "junk" in str(error)
    else:
        assert marks.points.shape[1] == 2


@given(cut=st.integers(0, 50))
@SOME
def test_a_pts_file_cut_anywhere_is_refused(tmp_path: Path, cut: int) -> None:
    whole = "version: 1\nn_points: 2\n{\n1 1\n2 2\n}\n"
    assume(cut < whole.index("}"))
    with pytest.raises(LandmarkError):
        read_landmarks(save(tmp_path, "a.pts", whole[:cut]))


# Contours ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("edges", "contours"),
    [
        ([(0, 1), (1, 2)], [((0, 1, 2), False)]),
        ([(2, 1), (0, 1)], [((2, 1, 0), False)]),
        ([(0, 1), (1, 2), (2, 0)], [((0, 1, 2), True)]),
        ([(4, 5), (0, 1)], [((4, 5), False), ((0, 1), False)]),
        ([(0, 1), (1, 0), (2, 2)], [((0, 1), False)]),
        ([(0, 1), (1, 2), (1, 3)], [((0, 1), False), ((1, 2), False), ((1, 3), False)]),
        ([(0, 1), (1, 2), (2, 3), (3, 1)], [((0, 1), False), ((1, 2, 3), True)]),
        ([], []),
    ],
)
def test_edges_are_chained(edges: list, contours: list) -> None:
    assert chain_edges(edges) == tuple(Contour(*contour) for contour in contours)


@given(edges=st.lists(st.tuples(st.integers(0, 8), st.integers(0, 8))))
def test_chaining_keeps_every_edge_once(edges: list[tuple[int, int]]) -> None:
    want = sorted({(min(edge), max(edge)) for edge in edges if edge[0] != edge[1]})
    assert sorted((min(edge), max(edge)) for edge in edges_of(chain_edges(edges))) == want


def test_contour_of_degenerate_lines() -> None:
    assert contour_of([3], closed=False) is None
    assert contour_of([3, 3], closed=False) is None
    assert contour_of([], closed=True) is None
    assert contour_of([3, 4], closed=True) == Contour((3, 4), closed=True)
    assert contour_of([3, 4], closed=False) == Contour((3, 4), closed=False)
    assert contour_of([3, 4, 3], closed=False) == Contour((3, 4), closed=True)


# Real files ----------------------------------------------------------------------------------------


def test_imm_has_58_points_inside_its_images(shared_data: Path) -> None:
    files = sorted((shared_data / "imm").glob("*.pts"))
    assert len(files) == 132
    for file in files:
        points = read_landmarks(file).points
        assert points.shape == (58, 2)
        assert (points >= 0).all()
        assert (points < (640, 480)).all()
    assert read_landmarks(shared_data / "imm/01-1m.pts").points[0].tolist() == [
        228,
        307,
    ]  # the file says 229 308


def test_imm_frontal_has_73_points_and_its_contours(shared_data: Path) -> None:
    for file in sorted((shared_data / "imm-frontal").glob("*.asf")):
        shape = read_landmarks(file, image_size(file.with_suffix(".jpg")))
        assert len(shape) == 73
        assert shape.image_name == file.with_suffix(".jpg").name
        # 12 paths, of which pupils and the tip of the nose are lone points; brows, eyes and lips are closed
        assert [(len(contour.indices), contour.closed) for contour in shape.contours] == [
            *((8, True),) * 4,
            (11, False),
            (10, True),
            (3, False),
            (3, False),
            (11, False),
        ]
    first = read_landmarks(shared_data / "imm-frontal/01_01.asf", (800, 600)).points[0]
    np.testing.assert_allclose(first, (0.31251052 * 800, 0.37090045 * 600), rtol=0, atol=1e-12)


def test_london_has_189_points_and_its_lines(shared_data: Path) -> None:
    files = sorted((shared_data / "london").glob("*.tem"))
    assert len(files) == 60
    for file in files:
        template = read_landmarks(file)
        assert len(template) == 189
        assert len(template.contours) == 42  # 44 lines, of which 2 stay on the pupils
        assert sum(contour.closed for contour in template.contours) == 2  # the irises
    pupils = read_landmarks(shared_data / "london/001_03.tem").points[:2]
    assert pupils.tolist() == [[188.3333, 210.6667], [259.3333, 208.0]]


# What grows faster than the file ------------------------------------------------------------------


def _message(name: str, data: bytes) -> str:
    """Message of what is refused; empty where it is read."""
    try:
        parse_landmark_data(name, data)
    except LandmarkError as fault:
        return str(fault)
    return ""


def _grows_with_the_file(name: str, text_of: Callable[[int], str], small: int) -> None:
    """A file of 8 times the size takes about 8 times as long; 64 if each part is compared with all others."""
    files = {size: text_of(size).encode() for size in (small, 8 * small)}
    assert growth(lambda size: _message(name, files[size]), small) < 24


@pytest.mark.parametrize("head", ["n_points{}", "n_points:{}", "{}"])
@pytest.mark.parametrize("blank", [" ", " \n", "n_points"])
def test_the_time_of_a_pts_header_grows_with_its_length(head: str, blank: str) -> None:
    _grows_with_the_file("x.pts", lambda size: head.format(blank * size) + "{1 2\n3 4}", 20_000)


def test_a_count_may_stand_apart_from_its_word() -> None:
    assert "promises 3 points" in _message("x.pts", b"n_points\n :\n 3 {\n1 2\n}")


def test_the_time_of_nested_boxes_grows_with_their_number() -> None:
    def nested(n: int) -> str:
        deep = "<image file='a'>" * n + "<box><part name='1' x='1' y='2'/>" * n + "</box>" * n + "</image>" * n
        return f"<dataset>{deep}</dataset>"

    _grows_with_the_file("x.xml", nested, 400)


def test_parts_belong_to_the_box_that_they_stand_in() -> None:
    inner = "<box width='9' height='9'><part name='2' x='3' y='4'/></box>"
    text = f"<dataset><image file='a'><box><part name='1' x='1' y='2'/>{inner}</box></image></dataset>"
    parsed = parse_landmark_data("x.xml", text.encode())
    assert isinstance(parsed, dict)
    assert parsed["a"].names == ("1",)


def test_pictures_of_a_dlib_file_that_share_no_parts_are_refused() -> None:
    def unlike(n: int) -> str:
        images = "".join(f"<image file='{i}'><box><part name='{i}' x='1' y='2'/></box></image>" for i in range(n))
        return f"<dataset>{images}</dataset>"

    assert "hardly any of the 300 part names" in _message("x.xml", unlike(300).encode())
    _grows_with_the_file("x.xml", unlike, 150)


def test_names_of_thousands_of_digits_are_sorted() -> None:
    names = ["10" + "0" * 5000, "9", "10"]
    parts = "".join(f"<part name='{name}' x='1' y='2'/>" for name in names)
    parsed = parse_landmark_data("x.xml", f"<dataset><image file='a'><box>{parts}</box></image></dataset>".encode())
    assert isinstance(parsed, dict)
    assert parsed["a"].names == ("9", "10", names[0])


@pytest.mark.parametrize("end", ["Infinity", "NaN", "1e999", "1.5", '"2"', "true"])
def test_a_skeleton_of_what_are_no_numbers_of_points_is_left_out(end: str) -> None:
    text = json.dumps(
        {
            "images": [{"id": 1, "file_name": "a.png"}],
            "annotations": [{"image_id": 1, "category_id": 1, "keypoints": [1, 2, 2, 3, 4, 2]}],
            "categories": [{"id": 1, "skeleton": [[1, "END"]]}],
        }
    ).replace('"END"', end)
    notes = Notes()
    parsed = parse_landmark_data("x.json", text.encode(), notes=notes)
    assert isinstance(parsed, dict) and parsed["a.png"].contours == ()
    assert "edges of the skeleton are left out" in notes.lines()[0]
    with pytest.raises(LandmarkError, match="edges of the skeleton"):
        parse_landmark_data("x.json", text.encode(), reading=Reading(strict=True))


def test_a_long_skeleton_is_chained_once() -> None:
    def text_of(n: int) -> str:
        content = {
            "images": [{"id": i, "file_name": f"{i}.png"} for i in range(n)],
            "annotations": [{"image_id": i, "category_id": 1, "keypoints": [1, 2, 2, 3, 4, 2]} for i in range(n)],
            "categories": [{"id": 1, "skeleton": [[1, 2]] * (3 * n)}],
        }
        return json.dumps(content)

    assert not _message("x.json", text_of(20).encode())
    _grows_with_the_file("x.json", text_of, 250)
