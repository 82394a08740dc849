"""Landmark files of all formats, and folders that hold them."""

from __future__ import annotations

import io
import json
import struct
import zipfile
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from fuzz.mutate import NUMBERS, TEXTS, Random, one_of, spoilt, spoilt_json
from fuzz.target import Target

POINTS = [[1.5, 2.0], [30.25, 4.0], [16.0, 20.5], [8.0, 9.0]]

_PTS = (
    b"version: 1\nn_points: 4\n{\n1.5 2.0\n30.25 4.0\n16 20.5\nnan nan\n}\n",
    b"version: 1 n_points: 3 {\n1 2\n3 4\n5 6\n}",
    b"# made by hand\n{\n1 2 // first\n3 4\n}\n",
)
_TEM = (b"3\n1.0\t2.0\n3.0\t4.0\n5.0\t6.0\n2\n0\n2\n0 1\n1\n3\n0 1 2\n", b"2\n1 2\n3 4\n")
_ASF = (
    b"# points\n3\n# path type x y point from to\n0 0 0.1 0.2 0 2 1\n0 0 0.3 0.4 1 0 2\n0 0 0.5 0.6 2 1 0\nface.jpg\n",
    b"2\n0 4 0.1 0.2 0 0 1 9\n0 4 0.3 0.4 1 0 1 9\n",
)
_CSV = (
    b"x,y,name\r\n1,2,a\r\n3,4,b\r\n,,c\r\n",
    b"image,x,y\n01.png,1,2\n01.png,3,4\n02.png,5,6\n02.png,7,8\n",
    b"x;y\n1,5;2,5\n3;4\n",
    b'name\tx\ty\n"a ""b"" c"\t1\t2\n',
)
_TSV = (b"id\tlandmark\tx\ty\n1\ta\t1,5\t2\n1\tb\t3\t4\n", b" \tLabel\tX\tY\n1\ta.png\t1.5\t2\n2\ta.png\t3\t4\n")
_CSV += (
    b"sep=;\nimage;x;y\n01.png;1,5;2\n",
    b"id,X1,Y1,X2,Y2\n01.png,1,2,3,4\n02.png,5,6,7,8\n",
    b"scorer,me,me,me,me,me,me\nbodyparts,a,a,a,b,b,b\ncoords,x,y,likelihood,x,y,likelihood\n01.png,1,2,0.9,3,4,1\n",
)
_TXT = (
    b"1 2 3 4 0 0 9 9 0 1 0 1 0 0 01.png\n5 6 7 8 0 0 9 9 0 1 0 1 0 0 02.png\n",
    b"01\n1.5 , 2\n3 , 4\n",
    b"a 1 2\nb 3 4\n",
    b"<shapes>\n<image.name type=v >01.png</image.name>\n"
    b"<landmarks.pixel type=matrix >\na\t1\t2\nb\t3\t4\n</landmarks.pixel>\n",
)
_YOLO = b"0 0.5 0.5 0.4 0.3 0.1 0.2 2 0.3 0.4 1 0 0 0\n1 0.2 0.3 0.1 0.1 0.1 0.2 2 0.3 0.4 2 0.5 0.6 2\n"
_TXT += (
    _YOLO,
    b"[individuals]\n2\n[landmarks]\n2\n[dimensions]\n2\n[names]\n01\n02\n[wireframe]\n1 2\n[rawpoints]\n"
    b"'01\n1 2\n3 4\n'02\n5 6\n9999 9999\n",
    b"<shapes>\n<scaling type=vector >0.05</scaling>\n<landmarks.pixel type=matrix >\na\t1\t2\n</landmarks.pixel>\n",
)
_CSV += (
    b"filename,region_id,region_shape_attributes,region_attributes\n"
    b'01.png,0,"{""name"": ""point"", ""cx"": 1, ""cy"": 2}","{""n"": ""a""}"\n'
    b'01.png,1,"{""name"": ""point"", ""cx"": 3, ""cy"": 4}","{""n"": {""b"": true}}"\n',
    b"a,1,2,01.png,32,24\nb,3,4,01.png,32,24\n",
    b"index,axis-0,axis-1\n0,1,2\n1,3,4\n",
    b"track,frame_idx,instance.score,a.x,a.y,a.score,b.x,b.y,b.score\nm,1,2,1,2,1,3,4,1\nn,1,2,,,1,3,4,1\n",
    b'img,kp\n01.png,"[{""x"": 5, ""y"": 6, ""keypointlabels"": [""a""], '
    b'""original_width"": 32, ""original_height"": 24}]"\n',
)
_FCSV = (b"# CoordinateSystem = LPS\n# columns = id,x,y,z,label\na,1,2,0,p\nb,3,4,0,q\n",)
_NTS = (b'"a comment\n1 2L 4 1 -999 DIM=2\n01 02\n1 2 3 4\n5 6 -999 -999\n', b"1 2 2 0 dim=2\n1 2\n3 4\n")
_XML = (
    b"<?xml version='1.0' encoding='ISO-8859-1'?>\n<dataset><name>x</name><images>\n"
    b"<image file='01.png'><box top='1' left='2' width='30' height='40'><label>face</label>"
    b"<part name='00' x='5' y='6'/><part name='01' x='7' y='8'/></box></image>\n"
    b"<image file='02.png'><box top='1' left='2' width='3' height='4'/>"
    b"<box top='1' left='2' width='9' height='9'><label>face</label>"
    b"<part name='10' x='5' y='6'/><part name='2' x='7' y='8'/></box></image>"
    b"</images></dataset>",
    b"<annotations><image id='0' name='01.png' width='32' height='24'><skeleton label='s'>"
    b"<points label='1' outside='0' occluded='1' points='1,2'/><points label='2' outside='1' points='3,4'/></skeleton>"
    b"</image><image name='02.png'><points label='s' points='1,2;3,4'/></image></annotations>",
)
_TPS = (
    b"LM=3\n290. 108.\n100. 179.\n-1 -1\nIMAGE=01.png\nID=0\nSCALE=0.0045\n"
    b"LM=3\r\n1 2\r\nNA NA\r\n5 6\r\nIMAGE=C:\\wings\\02.png\r\nID=1\r\n",
    b"LM=1\n1 2\nCURVES=2\nPOINTS=2\n3 4\n5 6\nPOINTS=1\n7 8\nOUTLINES=1\nPOINTS=1\n9 9\nID=01\nCOMMENT=a\nb\n",
    b"LM=2\n1 2\n3 4\n",
)
_COCO = (
    {
        "images": [{"id": 1, "file_name": "01.png"}, {"id": 2, "file_name": "02.png"}],
        "annotations": [
            {"id": 5, "image_id": 1, "category_id": 1, "keypoints": [1, 2, 2, 3, 4, 1, 0, 0, 0], "area": 12.5},
            {"id": 6, "image_id": 1, "category_id": 1, "keypoints": [1, 2, 2, 3, 4, 1, 5, 6, 2], "bbox": [0, 0, 5, 6]},
            {"id": 7, "image_id": 2, "category_id": 1, "keypoints": [1, 2, 2, 3, 4, 1, 7, 8, 2]},
        ],
        "categories": [{"id": 1, "keypoints": ["a", "b", "c"], "skeleton": [[1, 2], [2, 3]]}],
    },
)
_SIZE = {"original_width": 32, "original_height": 24}
_COCO += (
    {
        "shapes": [
            {"label": "a", "points": [[1, 2]], "shape_type": "point", "group_id": None},
            {"label": "b", "points": [[3, 4]], "shape_type": "point", "group_id": None},
        ],
        "imagePath": "01.png",
        "imageWidth": 32,
        "imageHeight": 24,
    },
    [
        {
            "data": {"img": "/data/upload/1/0123abcd-01.png"},
            "annotations": [
                {
                    "result": [
                        {**_SIZE, "value": {"x": 5, "y": 9, "keypointlabels": ["a"]}},
                        {**_SIZE, "value": {"x": 7, "y": 8, "keypointlabels": ["b"]}},
                    ]
                }
            ],
        }
    ],
)
_FEATURES = [
    {"type": "Feature", "geometry": {"type": "Point", "coordinates": [1, 2]}, "properties": {"name": "a"}},
    {
        "type": "Feature",
        "geometry": {"type": "MultiPoint", "coordinates": [[1, 2], [3, 4]]},
        "properties": {"classification": {"name": "b"}},
    },
]
_GEOJSON = ({"type": "FeatureCollection", "features": _FEATURES}, _FEATURES)
_VIA_REGIONS = [
    {"shape_attributes": {"name": "point", "cx": 1, "cy": 2}, "region_attributes": {"n": "a", "side": {"l": True}}},
    {"shape_attributes": {"name": "point", "cx": 3, "cy": 4}, "region_attributes": {"n": "b", "side": {"l": True}}},
]
_VIA_LINE = {"name": "polyline", "all_points_x": [1, 2, 3], "all_points_y": [3, 4, 5]}
_COCO += (
    {"_via_img_metadata": {"01.png9": {"filename": "01.png", "size": 9, "regions": _VIA_REGIONS}}},
    {"a": {"filename": "01.png", "regions": {"0": {"shape_attributes": _VIA_LINE, "region_attributes": {}}}}},
    {
        "markups": [
            {
                "coordinateSystem": "RAS",
                "controlPoints": [
                    {"label": "a", "position": [1, 2, 0], "positionStatus": "defined"},
                    {"label": "b", "position": [3, 4, 0], "positionStatus": "undefined"},
                ],
            }
        ]
    },
    {
        "shapes": [
            {"label": "leaf", "points": [[0, 0], [9, 9]], "shape_type": "rectangle"},
            {"label": "leaf", "points": [[20, 0], [29, 9]], "shape_type": "rectangle"},
            *(
                {"label": name, "points": [[x, 2]], "shape_type": "point", "group_id": None}
                for name, x in (("a", 1), ("b", 5), ("a", 21), ("b", 25))
            ),
        ],
        "imagePath": "01.png",
    },
    [
        {
            "data": {"img": "01.png"},
            "annotations": [
                {
                    "result": [
                        {
                            **_SIZE,
                            "id": "r",
                            "value": {"x": 1, "y": 1, "width": 9, "height": 9, "rectanglelabels": ["l"]},
                        },
                        {
                            **_SIZE,
                            "id": "k",
                            "type": "keypointlabels",
                            "value": {"x": 5, "y": 9, "keypointlabels": ["a"]},
                        },
                        {"type": "relation", "from_id": "k", "to_id": "r"},
                    ]
                }
            ],
        }
    ],
)
_LJSON = (
    {
        "labels": [{"label": "all", "mask": [0, 1, 2, 3]}, {"label": "invisible", "mask": [2]}],
        "landmarks": {"points": POINTS, "connectivity": [[0, 1], [1, 2], [2, 0]]},
        "version": 2,
    },
    {"version": 3, "groups": {"main": {"landmarks": {"points": [[1, 2], [None, None]]}, "labels": []}}},
    {
        "labels": [{"label": name, "mask": [i]} for i, name in enumerate("abcd")],
        "landmarks": {"points": POINTS},
        "version": 2,
    },
)
_WORDS = {
    ".pts": (b"n_points", b"npoints:", b"version:", b"{", b"}", b" ", b"\n", b"#", b"//", b"%", b"nan", b"1 2\n"),
    ".tem": (b"\n", b"1\n", b"0 1\n", b" ", b"99\n"),
    ".asf": (b"#", b"\n", b"0 0 0.1 0.2 0 2 1\n", b" ", b"-1"),
    ".csv": (b",", b";", b"\t", b'"', b"\r", b"\n", b"image", b"x", b"y", b"name", b"\xef\xbb\xbf", b"\xff\xfe"),
    ".xml": (
        b"<box>",
        b"</box>",
        b"<image>",
        b"</image>",
        b"<part ",
        b"name='",
        b"&#1;",
        b"&amp;",
        b"<!--",
        b"<![CDATA[",
    ),
    ".tsv": (b"\t", b",", b"\n", b"id", b"label", b"x", b"y", b"landmark", b" "),
    ".txt": (b" ", b",", b"\n", b"x", b"y", b"01.png", b"<landmarks.pixel>", b"</landmarks.pixel>", b"nan"),
    ".nts": (b" ", b"\n", b"L", b"DIM=2", b"DIM=3", b'"', b"-999", b"NA", b"1 2b 2 0"),
    ".tps": (b"LM=", b"LM3=2", b"CURVES=", b"POINTS=", b"SCALE=", b"IMAGE=", b"ID=", b"=", b"\n", b" ", b"-1 -1\n"),
    ".json": (b"[", b"{", b"]", b"}", b'"', b",", b":", b"null", b"1e999", b'"keypoints"', b'"skeleton"'),
    ".geojson": (b"[", b"{", b"]", b"}", b'"', b",", b":", b"null", b'"Point"', b'"MultiPoint"', b'"coordinates"'),
    ".fcsv": (b"# columns = id,x,y,z\n", b"#", b" ", b"=", b'"', b",", b"\n", b"nan", b"1e999", b"RAS"),
    ".roi": (b"Iout", b"\xff\xff", b"\0\0", b"\x7f\xc0\0\0", b"\x7f\x80\0\0"),
    ".zip": (b"PK",),
    ".xlsx": (b"PK",),
    ".ljson": (b"[", b"{", b"]", b"}", b'"', b",", b":", b"null", b"NaN", b'"points"', b'"connectivity"'),
}
_NEWER = {".tsv": _TSV, ".txt": _TXT, ".nts": _NTS, ".fcsv": _FCSV}
_JSON = {".json": _COCO, ".ljson": _LJSON, ".geojson": _GEOJSON}
_BINARY = (".roi", ".zip", ".xlsx")


# Files that are no text ---------------------------------------------------------------------------


def _roi(points: list[list[float]], options: int = 128) -> bytes:
    """A selection of ImageJ."""
    n = len(points)
    header = struct.pack(">4shBBhhhhH", b"Iout", 228, 10, 0, 2, 1, 30, 40, n).ljust(50, b"\0")
    body = np.array(points).T.astype(">i2").tobytes() + np.array(points).T.astype(">f4").tobytes()
    return (header + struct.pack(">hiii", options, 0, 0, 0)).ljust(64, b"\0") + body


def _zip(files: dict[str, bytes], packing: int = zipfile.ZIP_DEFLATED) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", packing) as archive:
        for name, data in files.items():
            archive.writestr(zipfile.ZipInfo(name), data, packing)
    return buffer.getvalue()


_MAIN = b"http://schemas.openxmlformats.org/spreadsheetml/2006/main"
_ROW = (
    b'<row r="%d"><c r="A%d" t="s"><v>%d</v></c><c r="B%d"><v>%d</v></c><c t="inlineStr"><is><t>%d</t></is></c></row>'
)
_CELLS = b"".join(_ROW % (i, i, i % 4, i, i, i) for i in range(2, 6))
_SHEET_PARTS = {
    "xl/workbook.xml": b'<workbook xmlns="%s" xmlns:r="o/relationships"><sheets>'
    b'<sheet name="a" r:id="r1"/></sheets></workbook>' % _MAIN,
    "xl/_rels/workbook.xml.rels": b"<Relationships>"
    b'<Relationship Id="r1" Target="worksheets/sheet1.xml"/></Relationships>',
    "xl/sharedStrings.xml": b'<sst xmlns="%s"><si><t>image</t></si><si><t>x</t></si>'
    b"<si><t>y</t></si><si><t>01</t></si></sst>" % _MAIN,
    "xl/worksheets/sheet1.xml": b'<worksheet xmlns="%s"><sheetData><row r="1"><c r="A1" t="s"><v>0</v></c>'
    b'<c r="B1" t="s"><v>1</v></c><c r="C1" t="s"><v>2</v></c></row>%s</sheetData></worksheet>' % (_MAIN, _CELLS),
}
_XML_WORDS = (b"<c r='XFD9'>", b"<row>", b"</row>", b"<v>9999999</v>", b"t='s'", b"&amp;", b"<!DOCTYPE a>", b"\0")
_BULK = (
    b"<c>",
    b"<a/>",
    b"<si/>",
    b"<row/>",
    b"<row><c/></row>",
    b"<row><c><v>1</v></c></row>",
    b"<c t='s'><v>0</v></c>",
)
_PACKINGS = (zipfile.ZIP_STORED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA)
_ROI_WORDS = (b"Iout", b"\xff\xff", b"\x7f\xc0\0\0")


@cache
def _packed(suffix: str) -> tuple[dict[str, bytes], ...]:
    """The parts of valid files that are archives."""
    if suffix == ".xlsx":
        return (_SHEET_PARTS,)
    named = {f"{name}.roi": _roi([point]) for name, point in zip("abcd", POINTS, strict=True)}
    return named, {"a.roi": _roi(POINTS), "b.roi": _roi(POINTS[::-1])}


def _make_packed(suffix: str, rng: Random) -> bytes:
    """Pack parts of which one is spoilt or promises too much, or spoil an archive."""
    if rng.random() < 0.3:
        return spoilt(rng, corpus(suffix), (b"PK\1\2", b"PK\3\4", b"PK\5\6", b"\xff\xff\xff\xff"))
    parts = dict(one_of(rng, _packed(suffix)))
    name = one_of(rng, list(parts))
    kind = rng.random()
    if kind < 0.1:
        begin, end = (int(at) for at in np.sort(rng.integers(len(parts[name]) + 1, size=2)))
        word = one_of(rng, (b"\0", *_BULK)) * int(rng.integers(200_000))
        parts[name] = parts[name][:begin] + word + parts[name][begin if rng.random() < 0.8 else end :]
    elif kind < 0.9:
        parts[name] = spoilt(rng, [parts[name]], _XML_WORDS if suffix == ".xlsx" else _ROI_WORDS)
    packing = zipfile.ZIP_DEFLATED if kind < 0.95 else one_of(rng, _PACKINGS)
    return _with_more_entries(rng, _zip(parts, packing)) if kind > 0.9 else _zip(parts, packing)


def _with_more_entries(rng: Random, data: bytes) -> bytes:
    """Repeat an entry of the list of an archive; the size of the list may say so."""
    begin = data.rindex(b"PK\1\2")
    end = data.rindex(b"PK\5\6")
    more = data[begin:end] * int(rng.integers(one_of(rng, (4, 1000, 100_000))))
    size = int.from_bytes(data[end + 12 : end + 16], "little") + len(more) * int(rng.integers(2))
    return data[:end] + more + data[end : end + 12] + struct.pack("<I", size) + data[end + 16 :]


@cache
def corpus(suffix: str) -> tuple[bytes, ...]:
    """Valid files of a format."""
    if suffix == ".roi":
        return _roi(POINTS), _roi(POINTS[:2], options=0)
    if suffix in _BINARY:
        return tuple(map(_zip, _packed(suffix)))
    if suffix in _JSON:
        return tuple(json.dumps(document).encode() for document in _JSON[suffix])
    return {".pts": _PTS, ".tem": _TEM, ".asf": _ASF, ".csv": _CSV, ".xml": _XML, ".tps": _TPS, **_NEWER}[suffix]


def make(suffix: str, rng: Random) -> bytes:
    """Corrupt a file of a format."""
    kind = rng.random()
    if suffix in (".zip", ".xlsx"):
        return _make_packed(suffix, rng)
    if suffix == ".xml" and kind < 0.4:
        return _tree(rng)
    if suffix in _JSON and kind < 0.7:
        return spoilt_json(rng, _JSON[suffix])
    if suffix == ".csv" and kind < 0.02:  # of many images
        rows = (f"{i % 997}.png,{i},{i}" for i in range(int(rng.integers(20_000))))
        return "\n".join(["image,x,y", *rows]).encode()
    return spoilt(rng, corpus(suffix), _WORDS[suffix])


def _tree(rng: Random) -> bytes:
    """Well-formed XML of imglab's elements in any order, wide or deep."""
    tags = ("dataset", "images", "image", "box", "part")
    parts, open_tags = ["<dataset>"], ["dataset"]
    deep = rng.random()
    for _ in range(int(rng.integers(1, 3000 if rng.random() < 0.03 else 60))):
        if len(open_tags) > 1 and rng.random() > deep:
            parts.append(f"</{open_tags.pop()}>")
            continue
        tag = one_of(rng, tags)
        given = {key: _attribute(rng) for key in ("file", "name", "x", "y", "width", "height") if rng.random() < 0.5}
        parts.append(f"<{tag} " + " ".join(f'{key}="{value}"' for key, value in given.items()) + ">")
        open_tags.append(tag)
    return "".join([*parts, *(f"</{tag}>" for tag in reversed(open_tags))]).encode("utf-8", "replace")


def _attribute(rng: Random) -> str:
    if rng.random() < 0.7:
        return str(int(rng.integers(30)))
    text = one_of(rng, (*TEXTS, *(number.decode() for number in NUMBERS)))
    return "".join(letter for letter in text if letter.isprintable() and letter not in '<&"')


def check(suffix: str, data: bytes) -> None:
    """Parse it. If accepted, its points must be finite, and writing and reading them must work."""
    from liaam.io.landmarks import Landmarks, parse_landmark_data
    from liaam.io.landmarks.formats import writer_of
    from liaam.io.landmarks.writers import upwards

    path, size = Path(f"x{suffix}"), (640.0, 480.0)
    parsed = parse_landmark_data(path.name, data, size)
    every = [parsed] if isinstance(parsed, Landmarks) else list(parsed.values())
    for landmarks in every:
        assert not np.isinf(landmarks.points).any()
    if suffix not in (".pts", ".ljson", ".tps", ".csv"):
        return
    text_of = writer_of(path)
    for landmarks in every[:20]:
        if len(landmarks) < 1000 and len(set(landmarks.names)) in (0, len(landmarks)):
            placed = upwards(landmarks, size) if suffix == ".tps" else landmarks
            text = text_of(placed).encode("utf-8", "surrogatepass")
            again = parse_landmark_data(path.name, text, size)
            again = again if isinstance(again, Landmarks) else next(iter(again.values()))
            np.testing.assert_allclose(again.points, landmarks.points, rtol=1e-12, atol=1e-12 * size[1])


def _prepare(suffix: str) -> None:
    for data in corpus(suffix):
        check(suffix, data)


# YOLO's settings ----------------------------------------------------------------------------------


_SETTINGS = (
    b"kpt_shape: [3, 3]\nnames:\n  0: leaf\n  1: wing\nkpt_names:\n  0:\n    - a\n    - b\n    - c\n",
    b"kpt_shape:\n- 3\n- 3\nnames: {0: leaf, 1: 'wing'}\nkpt_names: [a, b, c]\n",
)
_SETTINGS_WORDS = (b" ", b"\n", b"\t", b"-", b":", b"[", b"kpt_shape:", b"kpt_names:", b"names:", b"1", b"'", b"\n \n")


def make_settings(rng: Random) -> bytes:
    """Corrupt the settings beside labels of YOLO, of which liaam reads no more than 100 kB."""
    return spoilt(rng, _SETTINGS, _SETTINGS_WORDS)[:100_000]


def check_settings(data: bytes) -> None:
    """Read the points of labels beside such settings."""
    from liaam.io.landmarks import read_landmarks

    Path("data.yaml").write_bytes(data)
    Path("x.txt").write_bytes(_YOLO)
    try:
        assert len(read_landmarks("x.txt", (640, 480))) == 3
    finally:
        Path("data.yaml").unlink()


# Folders ------------------------------------------------------------------------------------------


_PICTURES = (
    "01.png",
    "02.png",
    "a.b.png",
    ".hidden.png",
    "01.ppm",
    "x" * 240 + ".png",
    "\x1b[31m.png",
    "ü.png",
    "²1.png",
)


def make_folder(rng: Random) -> list[tuple[str, bytes]]:
    """Make the files of a folder: images and landmark files, whose names may not match."""
    files = [(one_of(rng, _PICTURES), _picture()) for _ in range(int(rng.integers(1, 4)))]
    for _ in range(int(rng.integers(1, 4))):
        suffix = one_of(rng, list(_WORDS))
        stems = ("all", "x", "²", "1" * 240, *(name.rpartition(".")[0] for name, _ in files))
        data = one_of(rng, corpus(suffix)) if rng.random() < 0.5 else make(suffix, rng)
        files.append((f"{one_of(rng, stems)}{suffix}", data))
    return files


@cache
def _picture() -> bytes:
    return b"P6 4 4 255\n" + bytes(48)


def check_folder(files: list[tuple[str, bytes]]) -> None:
    """Load a folder of such files, and make its report."""
    from liaam.datasets import load_folder

    folder = Path("folder")
    folder.mkdir(exist_ok=True)
    for path in folder.iterdir():
        path.unlink()
    for name, data in files:
        (folder / name).write_bytes(data)
    load_folder(folder).report()


# Results ------------------------------------------------------------------------------------------


_FITS = (
    {
        "image": "01.png",
        "status": "converged",
        "landmarks": POINTS,
        "covariance": [[1.5, 0.5, 2.0]] * 4,
        "scale": 0.5,
    },
    {"status": "converged", "path": "a/01.png", "landmarks": [1, 2, 3, 4, 5.5, 6, 7, 8], "covariance": [1, 0, 1] * 4},
    {"status": "error", "path": "02.png", "landmarks": None, "covariance": None},
)
_TABLE = (
    b"path,status,message,x0,y0,x1,y1,x2,y2,x3,y3,xx0,xy0,yy0,xx1,xy1,yy1,xx2,xy2,yy2,xx3,xy3,yy3\n"
    b"a/01.png,converged,,1,2,3,4,5,6,7,8,1,0,1,1,0,1,1,0,1,1,0,1\n02.png,error,no,,,,,,,,,,,,,,,,,,,,\n",
)


def make_results(rng: Random) -> tuple[str, bytes]:
    """Make the name and content of a fit or of a table of a batch, spoilt."""
    suffix = one_of(rng, (".json", ".jsonl", ".csv"))
    if suffix == ".csv":
        return f"x{suffix}", spoilt(rng, _TABLE, _WORDS[".csv"])
    lines = [spoilt_json(rng, _FITS) for _ in range(1 if suffix == ".json" else 3)]
    return f"x{suffix}", b"\n".join(lines)


def check_results(named: tuple[str, bytes]) -> None:
    """Read and measure them. Values must be numbers, or NaN where unknown."""
    from liaam.morphometry import measure, read_specimens

    path = Path(named[0])
    path.write_bytes(named[1])
    _check_numbers(measure(read_specimens(path), ["distance:1-2", "angle:1-2-3", "area:1-2-3"]))


def _check_numbers(table: dict[str, list]) -> None:
    for cells in table.values():
        assert not any(np.isinf(cell) for cell in cells if not isinstance(cell, str))


_SIDES = (
    b"specimen,individual,side,X1,Y1,X2,Y2,X3,Y3,X4,Y4\n"
    + b"".join(
        f"s{i},i{i // 2},{'left' if i % 2 else 'R'},0,{i},{9 + i},2,{30 - i % 3},40,4,{20 + i % 4}\n".encode()
        for i in range(6)
    )
    + b"s7,i0,left,,,1,2,3,4,5,6\n",
)


def make_sides(rng: Random) -> bytes:
    """Make the table of left and right specimens, of which one lacks a landmark, spoilt."""
    return spoilt(rng, _SIDES, _WORDS[".csv"])


def check_sides(data: bytes) -> None:
    """Read, reflect, complete and measure specimens, and analyse their asymmetry. No number is infinite but an F."""
    from liaam.morphometry import (
        alike,
        asymmetry,
        far_estimates,
        measure,
        of_one_side,
        read_specimens,
        with_estimated_landmarks,
    )

    path = Path("sides.csv")
    path.write_bytes(data)
    specimens, _ = of_one_side(alike(read_specimens(path))[0])
    table = measure(specimens)
    for kind, pairs in (("matching", None), ("object", "1-2")):
        found = asymmetry(specimens, table, kind, pairs=pairs, permutations=2)
        _check_numbers(found.indices())
        _check_numbers(found.components())
        found.to_json()
    for method in ("tps", "regression"):
        completed, _ = with_estimated_landmarks(specimens, method)
        _check_numbers(measure(completed))
        far_estimates(completed)


def _targets() -> list[Target]:
    formats = [
        Target(f"landmarks{suffix}", partial(make, suffix), partial(check, suffix), partial(_prepare, suffix), suffix)
        for suffix in _WORDS
    ]
    valid: Any = [("01.png", _picture()), ("01.pts", _PTS[0])]
    fit: Any = ("x.json", json.dumps(_FITS[0]).encode())
    settings = Target(
        "yolo-settings", make_settings, check_settings, partial(check_settings, _SETTINGS[0]), ".yaml", share=0.5
    )
    results = Target("results", make_results, check_results, partial(check_results, fit), share=0.5)
    sides = Target("sides", make_sides, check_sides, partial(check_sides, _SIDES[0]), ".csv", share=0.5)
    return [
        *formats,
        settings,
        results,
        sides,
        Target("folder", make_folder, check_folder, partial(check_folder, valid), share=0.5),
    ]


TARGETS = _targets()
