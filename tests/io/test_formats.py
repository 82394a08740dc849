"""Situations from the documentation and trackers of annotation tools; experiments/notes/formats.md lists all tried."""

import json
from pathlib import Path

import numpy as np
import pytest

from liaam.errors import LandmarkError
from liaam.io.files import natural_key
from liaam.io.landmarks import parse_landmark_data
from liaam.io.landmarks.base import Landmarks
from liaam.io.landmarks.formats import FORMATS, KNOWN_FILES
from liaam.io.landmarks.matching import ImageNames, stem_of
from liaam.io.landmarks.reading import Notes, Reading
from setups import growth

SIZE = (200.0, 160.0)
POINTS = [[10, 20], [30, 40], [50, 60]]
HOLE = [[10, 20], [30, 40], [np.nan, np.nan]]
BOXES = (
    "<dataset><image file='a.png'><box width='99' height='9'><label>scale</label><part name='s' x='1' y='1'/></box>"
    "<box width='9' height='9'><label>wing</label>{}</box></image></dataset>"
).format("".join(f"<part name='{i}' x='{x}' y='{y}'/>" for i, (x, y) in enumerate(POINTS)))


def label_studio(data: dict, **more: object) -> str:
    size = {"original_width": 200, "original_height": 160, **more}
    results = [
        {**size, "value": {"x": x / 2, "y": y / 1.6, "keypointlabels": [f"n{i}"]}} for i, (x, y) in enumerate(POINTS)
    ]
    return json.dumps([{"id": 1, "data": data, "annotations": [{"result": results}]}])


SECOND = "b.png,p,1,2\nb.png,q,3,4\nb.png,r,5,6\n"
NEWLINE = "\n"
IMAGEJ = "".join(f"{i},a.png,{x + 0.5},{y + 0.5}\n" for i, (x, y) in enumerate(POINTS, 1))
SLICES = "".join(f"{line},1\n" for line in IMAGEJ.replace("a.png", "stack.tif:a.png").splitlines())
NUMBERS = "".join(
    f"<points label='lm' points='{POINTS[i][0]},{POINTS[i][1]}'><attribute name='n'>{i + 1}</attribute></points>"
    for i in (2, 0, 1)
)


def labelme(groups: list[int | None], labels: list[str]) -> str:
    """The last point first, and each in a group of its own."""
    each = zip((2, 0, 1), groups, labels, strict=True)
    shapes = [{"label": n, "points": [POINTS[i]], "group_id": g, "shape_type": "point"} for i, g, n in each]
    return json.dumps({"shapes": shapes, "imagePath": "a.png", "imageWidth": 0, "imageHeight": 0})


def coco(factor: int = 1, **more: object) -> str:
    shift = 0.5 * (factor - 1)
    keypoints = [value for x, y in POINTS for value in (x * factor + shift, y * factor + shift, 2)]
    facts = {"image_id": 1, "category_id": 1, "keypoints": keypoints}
    names = {"id": 1, "name": "leg", "keypoints": ["p", "q", "r"]}
    return json.dumps(
        {"images": [{"id": 1, "file_name": "a.png", **more}], "annotations": [facts], "categories": [names]}
    )


READ = [
    (
        "a.csv",
        f"image,x_1,y_1,x_²,y_²,x_{'9' * 5000},y_{'9' * 5000}\na.png,10,20,30,40,50,60\n",
        [POINTS[i] for i in (0, 2, 1)],
    ),
    ("a.csv", "id,X2,Y2,X1,Y1,X10,Y10\na.png,30,40,10,20,50,60\n", POINTS),
    ("a.csv", "image,name,x_px,y_px,x_mm,y_mm\na,p,10,20,1,2\na,q,30,40,3,4\na,r,50,60,5,6\n", POINTS),
    ("a.csv", "image,name,x,y\na,p,10,20\na,q,30,40\na,r,-999,-999\n", HOLE),
    ("a.csv", "id,X1,Y1,X2,Y2,X3,Y3\na.png,10,20,30,40,-9999,-9999\n", HOLE),
    ("a.csv", "id,X1,Y1,X2,Y2,X3,Y3\nb.png,1,2,3\na.png,10,20,30,40,-1,-1\n", HOLE),
    ("a.csv", "image,landmark,x,y,visible\na,p,10,20,True\na,q,30,40,True\na,r,-1,-1,False\n", HOLE),
    ("a.csv", "my photo a.png,10,20,30,40,50,60\nmy photo b.png,1,2,3,4,5,6\n", POINTS),
    ("a.tps", "LM=3\n10 139\n30 119\n-999 -999\nIMAGE=a.png\n", HOLE),
    ("a.pts", "n_points: 3\n{\n11;21\n31 ; 41\n51;61\n}\n", POINTS),
    ("a.xml", BOXES, POINTS),
    ("a.xml", BOXES.replace("x='50' y='60'", "x='-1' y='-1'"), HOLE),
    ("a.json", labelme([None] * 3, ["r", "p", "q"]).replace("[50, 60]", "[-999, -999]"), HOLE),
    ("a.json", label_studio({"note": "see p. 3", "image": "/data/upload/1/0a1b2c3d-a.png"}), POINTS),
    ("a.json", label_studio({"image": "a.png"}).replace("keypointlabels", "labels"), POINTS),
    ("a.json", label_studio({"image": "a.png"}).replace("annotations", "completions"), POINTS),
    (
        "a.csv",
        "Bild;Punkt;X;Y\na.png;p;10,0;20,0\na.png;q;30,0;40,0\na.png;r;50,0;60,0\n" + SECOND.replace(",", ";"),
        POINTS,
    ),
    (
        "a.csv",
        "image,nr,x,y\na.png,3,50,60\na.png,1,10,20\na.png,2,30,40\nb.png,1,1,2\nb.png,2,3,4\nb.png,3,5,6\n",
        POINTS,
    ),
    ("a.csv", f"image,landmark,x,y\na.png,p,10,20\n,q,30,40\n,r,50,60\n{SECOND}", POINTS),
    ("a.csv", "image,specimen,landmark,x,y\na,A,p,10,20\n,,q,30,40\n,,r,50,60\n,B,p,1,2\n,,q,3,4\n,,r,5,6\n", POINTS),
    ("a.csv", "id,x,y,x,y,x,y\na.png,10,20,30,40,50,60\n", POINTS),
    ("a.csv", "id,x,y,x.1,y.1,x.2,y.2\na.png,10,20,30,40,50,60\n", POINTS),
    ("a.csv", f" ,Label,X,Y\n{IMAGEJ}4,Mean,30,40\n5,SD,2,2\n6,Min,1,1\n7,Max,9,9\n", POINTS),
    (
        "a.csv",
        f" ,Label,X,Y,Slice\n{SLICES}4,stack.tif:b.png,9,9,2\n",
        POINTS,
    ),
    (
        "a.csv",
        '"Image Name", "Landmark ID", "X (px)", "Y (px)"\n"a", "p", 10, 20\n"a", "q", 30, 40\n"a", "r", 50, 60',
        POINTS,
    ),
    ("a.csv", "image,landmark,x,y,visible\na,p,10,20,1\na,q,30,40,1\na,r,0,0,0\n", HOLE),
    ("a.csv", "image,landmark,x,y\na,p,10,20\na,q,30,40\na,r,#N/A,#N/A\n", HOLE),
    # ImageJ's multi-point tool, OpenFace, and other ways to name columns
    ("a.csv", f" ,Label,X,Y,Slice,Frame\n{IMAGEJ.replace(NEWLINE, ',1,1' + NEWLINE)}", POINTS),
    ("a.csv", "face,file,gaze_x,gaze_y,x_0,x_1,x_2,y_0,y_1,y_2\n0,a.png,0.1,0.2,10,30,50,20,40,60\n", POINTS),
    ("a.csv", "file,x_0,x_1,y_0,y_1,X_0,X_1,Y_0,Y_1,Z_0,Z_1\na.png,10,30,20,40,1,2,3,4,5,6\n", POINTS[:2]),
    ("a.csv", "file,eyeX,eyeY,lip (x),lip (y),tip [x],tip [y]\na.png,10,20,30,40,50,60\n", POINTS),
    ("a.txt", '"x" "y"\n"1" 10 20\n"2"  30 40\n"3" 50 60\n', POINTS),  # R's write.table
    ("a.txt", "a.png 10 20 30 40 -1 -1\nb.png 1 2 3 4 5 6\n", HOLE),
    (
        "a.csv",
        "image,image_width,image_height,x,y\na,400,320,20.5,40.5\na,400,320,60.5,80.5\na,400,320,100.5,120.5\n",
        POINTS,
    ),
    ("a.csv", "file,width,height,x,y\na,400,320,20.5,40.5\na,400,320,60.5,80.5\na,400,320,100.5,120.5\n", POINTS),
    ("a.csv", "file,width,height,x,y\na,45,160,10,20\na,45,160,30,40\na,45,160,50,60\n", POINTS),
    ("a.txt", "a.png\t10,0\t20,0\t30,0\t40,0\t50,0\t60,0\nb.png\t1,0\t2,0\t3,0\t4,0\t5,0\t6,0\n", POINTS),
    ("a.txt", "".join(f"{name}.png 5 5 60 70 10 20 30 40 50 60\n" for name in "abc"), POINTS),
    ("a.txt", "p\t10,0\t20,0\nq\t30,0\t40,0\nr\t50,0\t60,0\n", POINTS),
    ("a.pts", "n_points: 3\n{\n11,0 21,0\n31,0 41,0\n51,0 61,0\n}\n", POINTS),
    ("a.txt", "1 10 20\n2 30 40\n4 50 60\n", POINTS),
    ("a.txt", "tip 1 10 20\ntip 2 30 40\ntip 3 50 60\n", POINTS),
    ("a.txt", "a.png 10 20 30 40 nan NaN\nb.png 1 2 3 4 5 6\n", HOLE),
    ("a.csv", "image,x (px),y [Pixels],x (mm),y (mm)\na,10,20,1,2\na,30,40,3,4\na,50,60,5,6\n", POINTS),
    ("a.csv", "image,landmark,x,y\na,2.0,30,40\na,10.0,50,60\na,1.0,10,20\n", POINTS),
    ("a.csv", "image;landmark;x;y\na;p;10,000;20,0\na;q;30,0;40,0\na;r;50;60\n", POINTS),
    ("a.xml", BOXES.replace("<box width='9'", "<box ignore='False' width='9'"), POINTS),
    ("a.xml", f"<annotations><image name='a.png'>{NUMBERS}</image></annotations>", POINTS),
    ("a.json", labelme([3, 1, 2], ["lm"] * 3), POINTS),
    ("a.json", labelme([5, 6, 7], ["r", "p", "q"]), POINTS),
    ("a.json", coco(width=0, height=0), POINTS),
    ("a.json", coco().replace("10, 20,", '"10", "20",'), POINTS),  # numbers as text
    ("a.json", coco(width=400, height=320, factor=2), POINTS),
]


@pytest.mark.parametrize(("name", "text", "points"), READ, ids=[f"{name}-{text[:24]}" for name, text, _ in READ])
def test_a_file_is_read_rightly(name: str, text: str, points: list) -> None:
    parsed = parse_landmark_data(name, text.encode(), SIZE)
    first = parsed if isinstance(parsed, Landmarks) else next(iter(parsed.values()))
    np.testing.assert_allclose(first.in_order_of(sorted(first.names, key=natural_key)).points, points)


FRACTIONS = "0.05,0.125,0.15,0.25,0.25,0.375"
REFUSED = [
    ("a.csv", "image,X1,Y1,XX,Y2,X3,Y3\na,1,2,3,4,5,6\nb,1,2,3,4,5,7\n", "'Y2' has no column 'X2' beside it"),
    ("a.csv", f"image,X1,Y1,X2,Y2,X3,Y3\na.png,{FRACTIONS}\n", "all positions lie between 0 and 1"),
    (
        "a.csv",
        "eye_x,eye_y,tip_x,tip_y,Image\n1,2,3,4,238 236\n1,2,3,4,9 8\n",
        "the column 'image' holds the images' pixels",
    ),
    ("a.csv", "image,x,y\na,0.1,0.2\na,0.3,1.02\na,0.5,0.6\n", "all positions lie between 0.1 and 1.02"),
    ("a.csv", "image,x,y\na,-0.1,0.2\na,0.3,-1\na,0.5,0.6\n", "all positions lie between -1 and 0.6"),
    ("a.txt", "10 20 0.98\n30 40 0.91\n50 60 0.99\n", "no columns x and y, or rows of x and y"),
    ("a.txt", "10.5\t20\t5\n30.5\t40\t5\n", "no columns x and y, or rows of x and y: name"),
    ("a.txt", "1 10 20 5\n2 30 40 5\n3 50 60 5\n", "no columns x and y, or rows of x and y: name the"),
    ("a.txt", "a.png p 10 20\na.png q 30 40\nb.png p 11 21\n", "no columns x and y, or rows of x and y: name the c"),
    ("a.csv", "image,name,x (mm),y (mm)\na.png,p,1,2\na.png,q,3,4\n", "no columns x and y, or rows of x"),
    ("a.csv", "image,name,x [%],y [%]\na.png,p,10,20\na.png,q,30,40\n", "no columns x and y, or rows of"),
    ("a.csv", "image;name;x;y\na;p;1,010;20.5\na;q;30.5;40.5\n", "'1,010' and '20.5' have a comma and a point"),
    ("a.csv", "image;name;x;y\na;p;1.010;20,5\na;q;30,5;40,5\n", "'20,5' and '1.010' have a comma and a point"),
    (
        "a.json",
        json.dumps({"_of_no_tool": {}}),
        "this is none of LabelMe, .*, Label Studio, COCO keypoints, fit by liaam: export",
    ),
    ("a.json", label_studio({"image": "a.png"}, image_rotation=90), "was labelled on a turned picture"),
    ("a.nts", "1 1 4 1 .. DIM=2\n1 2 3 4\n", "there is no header of a matrix"),
    ("a.nts", "1 9 0 0 DIM=2\n", "9 x 0 numbers are promised but 0 are there"),
    ("a.txt", "<landmarks.pixel>" * 20_000, "it is cut short within its landmarks"),
    ("a.nts", "1 999999999 2 0 DIM=2\n1 2\n", "999999999 x 2 numbers are promised but 2 are there"),
    ("a.json", label_studio({"image": "a.png"}, original_width=10**400), "has keypoints for several sizes, or none"),
    ("a.xml", BOXES, "no landmarks of the category 'leg': it has scale, wing"),
    ("a.nts", f"1 9{' ' * 40_000}9{' ' * 40_000}1 1 dim\n1 2\n", "there is no header of a matrix"),
    ("a.nts", f"1 2L 4 1 -{'9' * 200_000}x\n1 2\n", "there is no header of a matrix"),
    ("a.csv", "id,x1,y1,x2,y2,X1,Y1\na,1,2,3,4,5,6\n", "'x1' and 'X1' both may be x of '1'"),
    ("a.json", coco().replace("}]}", '}, {"id": 1, "name": "b"}]}'), "several categories have the number 1"),
    ("a.json", coco().replace('.png"}', '.png"}, {"id": 1, "file_name": "b"}'), "the file has no image 1: .* several"),
]


@pytest.mark.parametrize(("name", "text", "words"), REFUSED, ids=[f"{name}-{text[:24]}" for name, text, _ in REFUSED])
def test_what_cannot_be_read_rightly_is_refused(name: str, text: str, words: str) -> None:
    with pytest.raises(LandmarkError, match=words):
        parse_landmark_data(name, text.encode(), SIZE, Reading(category="leg"))


MIXED = (
    ("a.csv", "image,lm,x,y\na,03,50,60\na,01,10,20\na,02,30,40\nb,1,10,20\nb,2,30,40\nb,3,50,60\n"),
    ("a.xml", "<d>{}{}</d>"),
)


@pytest.mark.parametrize(("name", "text"), MIXED)
def test_a_number_is_the_same_however_it_is_written(name: str, text: str) -> None:
    parts = ("".join(f"<part name='{i:0{w}d}' x='{x}' y='{y}'/>" for i, (x, y) in enumerate(POINTS)) for w in (1, 2))
    boxes = [f"<image file='{w}'><box>{each}</box></image>" for w, each in enumerate(parts)]
    parsed = parse_landmark_data(name, text.format(*boxes).encode(), SIZE)
    assert isinstance(parsed, dict)
    assert [own.points.tolist() for own in parsed.values()] == [POINTS, POINTS]


def test_boxes_of_another_label_are_left_out_with_a_line() -> None:
    notes = Notes()
    parse_landmark_data("a.xml", BOXES.encode(), SIZE, notes=notes)
    assert notes.lines() == ["left out the category 'scale', because 'wing' has more (--category chooses): a.png"]


def test_a_column_that_tells_landmarks_apart_by_its_values_is_named() -> None:
    notes = Notes()
    rows = "".join(f"{image},{n},{n},{n}\n" for image in ("a.png", "b.png") for n in (3, 1, 2))
    parse_landmark_data("a.csv", f"image,nr,x,y\n{rows}".encode(), SIZE, notes=notes)
    assert notes.lines() == [
        "landmarks are named by the values of a column: nr",
    ]


def test_columns_beside_numbered_landmarks_are_named() -> None:
    notes = Notes()
    parse_landmark_data("a.csv", b"id,x1,y1,x2,y2,gaze_x,gaze_y\na,1,2,3,4,5,6\n", SIZE, notes=notes)
    assert notes.lines() == ["columns of x and y beside those of numbered landmarks are not read: gaze"]


SHUFFLED = (
    ("a.csv", "id,x,y\n3,50,60\n1,10,20\n2,30,40\n"),
    ("a.csv", "x,y,anatomy\n50,60,r\n10,20,p\n30,40,q\n"),
    ("a.txt", "3 50 60\n1 10 20\n2 30 40\n"),
)


@pytest.mark.parametrize(("name", "text"), SHUFFLED)
def test_names_and_numbers_in_a_file_of_one_image_decide(name: str, text: str) -> None:
    parsed = parse_landmark_data(name, text.encode(), SIZE)
    assert isinstance(parsed, Landmarks)
    assert parsed.in_order_of(("p", "q", "r")).points.tolist() == POINTS


def test_values_that_number_no_landmarks_are_no_names() -> None:
    for rows in ("0,10,20\n1,30,40\n2,50,60\n", "7,10,20\n3,30,40\n5,50,60\n"):
        parsed = parse_landmark_data("a.csv", f"index,x,y\n{rows}".encode(), SIZE)
        assert isinstance(parsed, Landmarks)
        assert parsed.names == () and parsed.points.tolist() == POINTS


def test_a_box_behind_the_points_of_a_list_is_skipped() -> None:
    lines = "".join(f"{name}.png 10 20 30 40 50 60 5 5 60 70\n" for name in "abc")
    notes = Notes()
    parsed = parse_landmark_data("a.txt", lines.encode(), SIZE, notes=notes)
    assert isinstance(parsed, dict)
    assert [own.points.tolist() for own in parsed.values()] == [POINTS] * 3
    assert notes.lines() == ["four numbers behind the points are taken for a box around them: a.txt"]


def test_points_without_a_group_belong_to_the_only_object_that_lacks_them() -> None:
    parsed = parse_landmark_data("a.json", labelme([1, 1, None], ["r", "p", "q"]).encode(), SIZE)
    assert isinstance(parsed, Landmarks)
    assert parsed.in_order_of(("p", "q", "r")).points.tolist() == POINTS and parsed.others == ()


def test_points_of_cvat_are_told_apart_by_their_groups() -> None:
    points = "".join(
        f"<points label='{n}' group_id='{g}' points='{x + g},{y}'/>"
        for g in (1, 2)
        for n, (x, y) in zip("pqr", POINTS, strict=True)
    )
    parsed = parse_landmark_data("a.xml", f"<annotations><image name='a.png'>{points}</image></annotations>".encode())
    assert isinstance(parsed, dict)
    [first] = parsed.values()
    assert first.points[:, 0].tolist() == [11, 31, 51] and first.others[0].points[:, 0].tolist() == [12, 32, 52]


NO_LANDMARKS = (
    ("a.txt", "0 img0.png 1 2 3 4\n1 img1.png 5 6 7 8\n", "there are no columns x and y"),
    ("a.txt", "nose 0.98 1 2\nchin 0.97 3 4\n", "there are no columns x and y"),
    ("a.csv", "image,p_x,p_y,p_z,q_x,q_y\na,1,2,3,4,5\n", "it has columns of z"),
    ("a.csv", "landmark,a_x,a_y,b_x,b_y\np,1,2,3,4\nq,5,6,7,8\n", "a row for each landmark and columns for each image"),
)


@pytest.mark.parametrize(("name", "text", "words"), NO_LANDMARKS)
def test_what_are_no_landmarks_of_images_is_refused(name: str, text: str, words: str) -> None:
    with pytest.raises(LandmarkError, match=words):
        parse_landmark_data(name, text.encode(), SIZE)


def test_columns_that_name_different_images_are_refused() -> None:
    with pytest.raises(LandmarkError, match="'frame' and 'file' both may name the same"):
        parse_landmark_data("a.csv", b"file,frame,x,y\na.tif,1,2,3\na.tif,1,5,6\na.tif,2,3,4\n", SIZE)


def test_images_are_found_beside_files_that_keep_their_suffix() -> None:
    names = ImageNames([Path("a.png"), Path("b.png"), Path("b.png.png")])
    assert names.of_file(Path("a.png.pts")) == Path("a.png")
    assert names.of_file(Path("b.png.pts")) == Path("b.png.png")


def test_images_are_found_by_addresses() -> None:
    names = ImageNames([Path("a b.png"), Path("c.png")])
    assert names.find("https://host/x/a%20b.png?sig=1.2&b=/c.png")[0] == Path("a b.png")
    assert names.find("s3://bucket/c.png")[0] == Path("c.png")
    assert stem_of("/data/upload/1/0a1b2c3d-wing.one.png") == stem_of("https://host/wing.one.png?x=1.5") == "wing.one"


def test_names_are_the_same_in_another_case_with_blanks_or_in_another_unicode_form() -> None:
    other = Landmarks(np.array(POINTS), names=("Tip ", "a\u0308", "EYE"))
    assert other.in_order_of(("eye", "tip", "\u00e4")).points.tolist() == [POINTS[2], POINTS[0], POINTS[1]]
    padded = Landmarks(np.array(POINTS), names=("03", "01", "02"))
    assert padded.in_order_of(("1", "2", "3")).points.tolist() == [POINTS[1], POINTS[2], POINTS[0]]
    apart = Landmarks(np.array(POINTS), names=("a", "A", "b"))
    assert apart.in_order_of(("A", "a", "b")).points.tolist() == [POINTS[1], POINTS[0], POINTS[2]]
    with pytest.raises(LandmarkError, match="its names lack b2"):
        apart.in_order_of(("A", "a", "b2"))


def test_help_and_messages_name_every_format() -> None:
    assert all(form.title in KNOWN_FILES and ", ".join(form.suffixes) in KNOWN_FILES for form in FORMATS)


def test_time_is_proportional_to_the_number_of_columns_of_one_name():
    """Each column was counted among all before it."""

    def refuse(columns: int) -> None:
        with pytest.raises(LandmarkError):
            parse_landmark_data("a.csv", f"{'x,' * columns}y\n".encode(), SIZE)

    assert growth(refuse, 3_000) < 24  # 8 times the columns; 64 if compared with each other
