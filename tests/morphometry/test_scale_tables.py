"""Tables of ``liaam scale``: lengths of a pixel by the image of a specimen."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from liaam.errors import LiaamError
from liaam.morphometry import Specimen, read_lengths, with_lengths

HEADER = "image,scale,unit,scale_se,how\n"


def save(folder: Path, text: str) -> Path:
    path = folder / "scales.csv"
    path.write_text(text)
    return path


def test_specimens_get_the_lengths_of_their_images(tmp_path: Path) -> None:
    table = save(tmp_path, HEADER + "tray.png,0.01,mm,0.0001,ruler\nB 2.jpg,20,um,,tags\nc.png,,,,refused\n")
    names = ["tray#2", "tray_1", "tray", "b 2", "c", "other"]
    specimens = [Specimen(name, np.zeros((2, 2)), scale=7.0) for name in names]
    found = with_lengths(specimens, read_lengths(table))
    assert [(each.scale, each.unit, each.scale_se) for each in found] == [
        *[(0.01, "mm", 0.0001)] * 3,
        (20.0, "um", 0.0),
        *[(None, "", 0.0)] * 2,
    ]


def test_an_image_whose_scale_was_refused_has_not_that_of_another(tmp_path: Path) -> None:
    lengths = read_lengths(save(tmp_path, HEADER + "fly.png,0.01,mm,0,ruler\nfly_2.png,,,,\n"))
    specimens = [Specimen(name, np.zeros((2, 2))) for name in ("fly", "fly_2", "fly_3")]
    assert [each.scale for each in with_lengths(specimens, lengths)] == [0.01, None, 0.01]
    with pytest.raises(LiaamError, match="no specimen is of an image with a scale in the table of scales"):
        with_lengths(specimens[1:2], lengths)


def test_images_of_one_name_are_told_apart_by_folder(tmp_path: Path) -> None:
    rows = "wings/left/a.jpg,0.01,mm,0,ruler\nwings/right/a.jpg,0.02,mm,0,ruler\n"
    lengths = read_lengths(save(tmp_path, HEADER + rows))
    names = ["left/a", "right/a#2", "photos/wings/left/a", "below_a/a"]
    found = with_lengths([Specimen(name, np.zeros((2, 2))) for name in names], lengths)
    assert [each.scale for each in found] == [0.01, 0.02, 0.01, None]
    with pytest.raises(LiaamError, match=r"specimen a may be of the images wings/left/a\.jpg, wings/right/a\.jpg"):
        with_lengths([Specimen("a", np.zeros((2, 2)))], lengths)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            "a,b\n1,2\n",
            r"no columns image \(or photo, file, specimen\), scale, unit: it has a, b; give a table of 'liaam",
        ),
        ("photo,scale\na.png,1\n", r"has no column unit: it has photo, scale; .* or one of your own, with the columns"),
        (HEADER, "has no rows below its header"),
        (HEADER + "a.png,x,mm,0,ruler\n", "line 2 has no length of a pixel"),
        (HEADER + "a.png,-1,mm,0,ruler\n", "line 2 has no length of a pixel"),
        (HEADER + "a.png,1,apples,0,ruler\n", "line 2 has no length of a pixel"),
        (HEADER + "a.png,1,mm,0,ruler\na.png,2,mm,0,ruler\n", "line 3 has 'a.png' again"),
    ],
)
def test_tables_that_cannot_be_used_are_named(tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(LiaamError, match=words):
        read_lengths(save(tmp_path, text))


def test_a_table_of_other_images_is_refused(tmp_path: Path) -> None:
    lengths = read_lengths(save(tmp_path, HEADER + "a.png,1,mm,0,ruler\n"))
    with pytest.raises(LiaamError, match=r"no specimen is of an image in the table of scales, such as a\.png"):
        with_lengths([Specimen("b", np.zeros((2, 2)))], lengths)


def fits_of(*images: str, fingerprints: dict[str, str] | None = None) -> list[Specimen]:
    """Return specimens of fits to images, whose files have these fingerprints."""
    known = fingerprints or {}
    return [
        Specimen(image.replace("/", "_")[:-4], np.zeros((2, 2)), image=image, fingerprint=known.get(image, ""))
        for image in images
    ]


def test_a_line_is_not_that_of_images_in_two_folders(tmp_path: Path) -> None:
    lengths = read_lengths(save(tmp_path, HEADER + "fly.png,0.01,mm,0,ruler\n"))
    with pytest.raises(LiaamError, match=r"fly\.png in the table of scales is one image, and a/fly\.png and b/fly"):
        with_lengths(fits_of("a/fly.png", "b/fly.png"), lengths)
    found = with_lengths(fits_of("a/fly.png", "data/a/fly.png", "fly.png"), lengths)  # may all be the same
    assert [each.scale for each in found] == [0.01] * 3


def test_a_table_of_other_images_of_the_same_names_is_refused(tmp_path: Path) -> None:
    header = "image,scale,unit,fingerprint\n"
    lengths = read_lengths(save(tmp_path, header + "a/fly.png,0.01,mm,aa\nb/fly.png,0.02,mm,bb\n"))
    assert [each.scale for each in with_lengths(fits_of("fly.png", fingerprints={"fly.png": "bb"}), lengths)] == [0.02]
    with pytest.raises(LiaamError, match=r"a/fly\.png in the table of scales is another image than that of specimen"):
        with_lengths(fits_of("fly.png", fingerprints={"fly.png": "cc"}), lengths)
    with pytest.raises(LiaamError, match="may be of the images"):  # as a fit of an earlier version
        with_lengths(fits_of("fly.png"), lengths)
    lengths = read_lengths(save(tmp_path, header + "fly.tif,0.01,mm,aa\n"))  # of which fly.png may be a copy
    assert with_lengths(fits_of("fly.png", fingerprints={"fly.png": "bb"}), lengths)[0].scale == 0.01


@pytest.mark.parametrize(
    ("text", "encoding"),
    [
        ("\ufeffimage;scale;unit;scale_se\na.png;0,0055;mm;0,0001\n;;;\n", "utf-8"),
        ("image\tscale\tunit\tscale_se\na.png\t0.0055\tmm\t0.0001\n", "utf-16"),
        ("sep=;\nimage;scale;unit;scale_se\na.png;5,5;µm;0,1\n", "latin-1"),
        ("image,scale,unit,scale_se\na.png,5.5,μm,0.1\n", "utf-8"),
        ("image,scale,unit,scale_se\na.png,5.5,microns,0.1\n", "utf-8"),
        ("Photo,Scale,Unit,scale_se\na.png,5.5,microns,0.1\n", "utf-8"),
    ],
)
def test_tables_that_spreadsheets_save_are_read(tmp_path: Path, text: str, encoding: str) -> None:
    path = tmp_path / "scales.csv"
    path.write_bytes(text.encode(encoding))
    length = read_lengths(path)["a.png"]
    assert length is not None and str(length.within("mm")) == "0.0055 ± 0.0001 mm"


def test_lengths_have_the_source_that_their_row_states(tmp_path: Path) -> None:
    table = save(tmp_path, HEADER + "a.png,1,mm,0,a scale bar in the image\nb.png,1,mm,,\nc.png,1,mm\n")
    sources = {image: length and length.source for image, length in read_lengths(table).items()}
    assert sources == {
        "a.png": "a scale bar in the image",
        "b.png": "the table of scales",
        "c.png": "the table of scales",
    }


def test_tables_complete_each_other_and_may_not_disagree(tmp_path: Path) -> None:
    rulers = save(tmp_path, HEADER + "a.png,0.01,mm,0,ruler\nb.png,,,,\n")
    bars = tmp_path / "bars.csv"
    bars.write_text(HEADER + "b.png,0.02,mm,0,bar\nc.png,,,,\n")
    lengths = read_lengths(rulers, bars)
    assert {name: length and length.value for name, length in lengths.items()} == {
        "a.png": 0.01,
        "b.png": 0.02,
        "c.png": None,
    }
    bars.write_text(HEADER + "a.png,0.02,mm,0,bar\n")
    with pytest.raises(LiaamError, match=r"scales\.csv and .*bars\.csv both have a scale of 'a\.png': keep one"):
        read_lengths(rulers, bars)


def test_images_of_one_name_are_told_apart_by_their_endings(tmp_path: Path) -> None:
    table = read_lengths(save(tmp_path, HEADER + "IMG_9.JPG,0.01,mm,0,ruler\nIMG_9.tif,0.02,mm,0,ruler\n"))
    named = [Specimen(name, np.zeros((2, 2))) for name in ("IMG_9.JPG", "IMG_9.tif")]
    fitted = [replace(each, name=f"w{i}", image=f"study/pair/{each.name}") for i, each in enumerate(named)]
    for specimens in (named, fitted):
        assert [each.scale for each in with_lengths(specimens, table)] == [0.01, 0.02]
    with pytest.raises(LiaamError, match=r"specimen IMG_9 may be of the images IMG_9\.JPG, IMG_9\.tif"):
        with_lengths([Specimen("IMG_9", np.zeros((2, 2)))], table)
    other_format = [Specimen("IMG_9.png", np.zeros((2, 2)), image="IMG_9.png")]  # of the same photograph
    alone = read_lengths(save(tmp_path, HEADER + "IMG_9.JPG,0.01,mm,0,ruler\n"))
    assert with_lengths(other_format, alone)[0].scale == 0.01
