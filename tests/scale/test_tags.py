"""Lengths of a pixel in the tags of TIFF files, as ImageJ and microscopes write them."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image, TiffImagePlugin

from liaam.errors import ImageError
from liaam.io import write_image
from liaam.scale.tags import length_in_tags


def save(path: Path, description: str, resolution: Any = None, unit: int = 1) -> Path:
    tags = TiffImagePlugin.ImageFileDirectory_v2()
    tags[270] = description.encode()
    if resolution is not None:
        across, down = resolution if isinstance(resolution, tuple) else (resolution, resolution)
        tags[282] = across
        tags[283] = down
        tags[296] = unit
    Image.fromarray(np.zeros((20, 30, 3), np.uint8)).save(path, tiffinfo=tags)
    return path


@pytest.mark.parametrize(
    ("written", "unit"),
    [("mm", "mm"), ("um", "um"), ("micron", "um"), ("\\u00B5m", "um"), ("µm", "um"), ("cm", "cm"), ("inch", "in")],
)
def test_imagej_states_pixels_for_a_unit(tmp_path: Path, written: str, unit: str) -> None:
    path = save(tmp_path / "a.tif", f"ImageJ=1.53t\nunit={written}\nmin=0\nmax=255\n", 200.0)
    length = length_in_tags(path)
    assert length is not None
    assert (length.value, length.unit, length.source) == (pytest.approx(0.005), unit, "ImageJ's calibration")


OME = '<?xml version="1.0"?><OME><Image><Pixels BigEndian="false" {} SizeX="30"><Channel/></Pixels></Image></OME>'


@pytest.mark.parametrize(
    ("attributes", "value", "unit"),
    [
        ('PhysicalSizeX="0.325" PhysicalSizeY="0.325"', 0.325, "um"),
        ('PhysicalSizeX="0.325" PhysicalSizeXUnit="µm"', 0.325, "um"),
        ('PhysicalSizeXUnit="nm" PhysicalSizeX="65" PhysicalSizeY="0.065"', 65, "nm"),
        ("PhysicalSizeX='0.002' PhysicalSizeXUnit='mm'", 0.002, "mm"),
    ],
)
def test_ome_states_the_size_of_a_pixel(tmp_path: Path, attributes: str, value: float, unit: str) -> None:
    length = length_in_tags(save(tmp_path / "a.ome.tif", OME.format(attributes)))
    assert length is not None
    assert (length.value, length.unit) == (value, unit)


def test_aperio_states_micrometres(tmp_path: Path) -> None:
    text = "Aperio Image Library v11\n46000x32914 (256x256) JPEG/RGB Q=30|AppMag = 20|MPP = 0.4990|Left = 25"
    length = length_in_tags(save(tmp_path / "a.tif", text))
    assert length is not None
    assert (length.value, length.unit) == (0.499, "um")


@pytest.mark.parametrize(
    ("description", "resolution", "unit"),
    [
        ("", 300.0, 2),  # of most programs, whatever the picture shows
        ("ImageJ=1.53t\n", 72.0, 2),
        ("ImageJ=1.53t\nunit=pixel\n", 1.0, 1),
        ("ImageJ=1.53t\nunit=mm\n", 0.0, 1),
        ("ImageJ=1.53t\nunit=mm\n", None, 1),
        ("ImageJ=1.53t\nunit=furlong\n", 3.0, 1),
        (OME.format('SizeY="3"'), 72.0, 2),
        (OME.format('PhysicalSizeX="0"'), 72.0, 2),
        (OME.format('PhysicalSizeX="-1"'), 72.0, 2),
        (OME.format('PhysicalSizeX="nan"'), 72.0, 2),
        (OME.format('PhysicalSizeX="1e999"'), 72.0, 2),
        (OME.format('PhysicalSizeX="3" PhysicalSizeXUnit="reference frame"'), 72.0, 2),
        ("Aperio|MPP = 0..|", None, 1),
        ("<OME" + "<Pixels " * 20_000, None, 1),
        ("ImageJ=1\n" + "unit=" * 20_000, 3.0, 1),
    ],
)
def test_nothing_is_guessed(tmp_path: Path, description: str, resolution: float | None, unit: int) -> None:
    assert length_in_tags(save(tmp_path / "a.tif", description, resolution, unit)) is None


def test_pixels_that_are_not_square_are_refused(tmp_path: Path) -> None:
    path = save(tmp_path / "a.tif", "ImageJ=1.53t\nunit=mm\n", (200.0, 100.0))
    with pytest.raises(ImageError, match=r"a\.tif: its tags state pixels of 0\.005 x 0\.01, which are not square"):
        length_in_tags(path)
    with pytest.raises(ImageError, match="not square: resample it to square pixels, or give --scale"):
        length_in_tags(save(tmp_path / "b.tif", OME.format('PhysicalSizeX="1" PhysicalSizeY="2"')))


def test_other_images_state_none(tmp_path: Path) -> None:
    write_image(tmp_path / "a.png", np.zeros((9, 9, 3), np.uint8))
    assert length_in_tags(tmp_path / "a.png") is None
    assert length_in_tags((tmp_path / "a.png").read_bytes()) is None
    with pytest.raises(ImageError, match="does not exist"):
        length_in_tags(tmp_path / "b.tif")
