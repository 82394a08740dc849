"""Which pages of a TIFF are the picture, and what is said of others."""

import struct
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pytest

from liaam.errors import ImageError
from liaam.io import decode_image, image_size

IMAGEJ = b"ImageJ=1.54f\nimages=3\nchannels=3\nhyperstack=true\nmode=composite\n\0"
COLOURS = {"R": (255, 0, 0), "G": (0, 255, 0), "B": (0, 0, 255), "C": (0, 255, 255), "Y": (255, 255, 0)}


def tiff_of(pages: Sequence[tuple[np.ndarray, Mapping[int, Any]]], order: Any = "<", big: bool = False) -> bytes:
    """Build a TIFF of uncompressed pages with further tags: whole numbers, or bytes."""
    data = bytearray((b"II" if order == "<" else b"MM") + struct.pack(f"{order}H", 43 if big else 42))
    data += struct.pack(f"{order}HHQ", 8, 0, 0) if big else struct.pack(f"{order}I", 0)
    link = 8 if big else 4
    number = "Q" if big else "I"
    for array, more in pages:
        bands = 1 if array.ndim == 2 else array.shape[2]
        tags: dict[int, Any] = {256: array.shape[1], 257: array.shape[0], 258: [8 * array.itemsize] * bands}
        tags |= {259: 1, 262: 1 if bands == 1 else 2, 277: bands, 278: array.shape[0], 279: array.nbytes, **more}
        tags[273] = [len(data) + i * array.nbytes // 3 for i in range(3)] if 273 in more else len(data)
        data += array.astype(array.dtype.newbyteorder(order)).tobytes()
        entries = b""
        for tag, value in sorted(tags.items()):
            kind, form = (7, "B") if isinstance(value, bytes) else (16, "Q") if big else (4, "I")
            values = list(value) if isinstance(value, (bytes, list)) else [value]
            packed = struct.pack(f"{order}{len(values)}{form}", *values)
            if len(packed) > (8 if big else 4):
                at = len(data)
                data += packed
                packed = struct.pack(f"{order}{number}", at)
            entries += struct.pack(f"{order}HH{number}", tag, kind, len(values)) + packed.ljust(8 if big else 4, b"\0")
        struct.pack_into(f"{order}{number}", data, link, len(data))
        data += struct.pack(f"{order}{'Q' if big else 'H'}", len(tags)) + entries
        link = len(data)
        data += struct.pack(f"{order}{number}", 0)
    return bytes(data)


def luts(order: str) -> dict[int, object]:
    """ImageJ's colour tables of three channels."""
    header = b"IJIJ" + b"luts" + struct.pack(">I", 3)
    tables = b"".join(bytes(i * top // 255 for top in COLOURS[name] for i in range(256)) for name in order)
    return {50838: [len(header), 768, 768, 768], 50839: header + tables}


def channels(rng: np.random.Generator, dtype: type = np.uint8) -> list[np.ndarray]:
    return [rng.integers(0, np.iinfo(dtype).max, (5, 7), dtype, endpoint=True) for _ in range(3)]


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize(
    ("order", "big"), [("<", False), (">", False), ("<", True)]
)  # the fourth is refused, see below
def test_colours_that_imagej_saves_as_pages_are_one_picture(rng, dtype: type, order: str, big: bool) -> None:
    pages = channels(rng, dtype)
    data = tiff_of([(pages[0], {270: IMAGEJ}), (pages[1], {}), (pages[2], {})], order, big)
    np.testing.assert_array_equal(decode_image(data), np.stack(pages, axis=-1))


def test_colour_tables_decide_which_page_is_which_colour(rng) -> None:
    pages = channels(rng)
    data = tiff_of([(pages[0], {270: IMAGEJ} | luts("GBR")), (pages[1], {}), (pages[2], {})])
    np.testing.assert_array_equal(decode_image(data), np.stack([pages[2], pages[0], pages[1]], axis=-1))
    other = tiff_of([(pages[0], {270: IMAGEJ} | luts("CYR")), (pages[1], {}), (pages[2], {})])
    with pytest.raises(
        ImageError, match=r"holds 3 pictures \(7 x 5 pixels\).*the colours of one picture, save it as RGB"
    ):
        decode_image(other)


@pytest.mark.parametrize("mark", [{254: 1}, {255: 2}, {}])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_a_reduced_copy_is_not_the_picture_wherever_it_lies(rng, mark: dict, dtype: type) -> None:
    picture = rng.integers(0, 255, (12, 16, 3), dtype)
    small = picture[::2, ::2]
    for pages in ([(small, mark), (picture, {})], [(picture, {}), (small, mark)]):
        data = tiff_of(pages)
        assert image_size(data) == (16, 12)
        np.testing.assert_array_equal(decode_image(data), picture)


@pytest.mark.parametrize("second", [(12, 16), (3, 16), (11, 16), (5, 4)])
def test_several_pictures_are_refused(rng, second: tuple[int, int]) -> None:
    first = rng.integers(0, 255, (12, 16, 3), np.uint8)
    with pytest.raises(ImageError, match=r"holds 2 pictures .* not one: save the one to use as a file of its own"):
        decode_image(tiff_of([(first, {}), (np.zeros((*second, 3), np.uint8), {})]))


def test_a_stack_that_imagej_saves_as_one_page_is_refused(rng) -> None:
    stack = {270: b"ImageJ=1.54f\nimages=40\nslices=40\n\0"}
    with pytest.raises(ImageError, match="holds 40 pictures"):
        decode_image(tiff_of([(channels(rng)[0], stack)]))


def test_a_chain_of_pages_that_leads_back_is_read_once(rng) -> None:
    array = rng.integers(0, 255, (5, 7, 3), np.uint8)
    data = bytearray(tiff_of([(array, {})]))
    data[-4:] = data[4:8]  # the next page is the first
    np.testing.assert_array_equal(decode_image(bytes(data)), array)
    data[-4:] = b"\xff\xff\xff\x7f"  # or lies behind the end
    np.testing.assert_array_equal(decode_image(bytes(data)), array)


@pytest.mark.parametrize(
    ("array", "more", "words"),
    [
        (np.zeros((9, 9, 3), np.uint8), {259: 34712}, "compressed by JPEG 2000, which is not read: save it as TIFF"),
        (np.zeros((9, 9, 3), np.uint16), {259: 33005}, "compressed by JPEG 2000"),
        (np.zeros((9, 9, 5), np.uint8), {262: 1}, "has 5 bands: save those for red, green and blue as RGB"),
        (np.zeros((9, 9, 3), np.uint8), {262: 9}, "stores its pixels in a form that is not read"),
    ],
)
def test_sound_files_that_are_not_read_are_not_called_damaged(array: np.ndarray, more: dict, words: str) -> None:
    with pytest.raises(ImageError, match=words) as caught:
        decode_image(tiff_of([(array, more)]))
    assert "damaged" not in str(caught.value)


def test_big_tiff_of_big_endian_order_is_named() -> None:
    with pytest.raises(
        ImageError, match="is a BigTIFF of big-endian order, which is not read: save it as a usual TIFF"
    ):
        decode_image(tiff_of([(np.zeros((9, 9, 3), np.uint8), {})], ">", big=True))


def test_colours_in_separate_planes_of_one_page(rng) -> None:
    planes = np.stack(channels(rng))
    tags = {257: 5, 258: [8, 8, 8], 262: 2, 273: [0, 0, 0], 277: 3, 278: 5, 279: [35, 35, 35], 284: 2}
    data = tiff_of([(planes.reshape(15, 7), tags)])
    np.testing.assert_array_equal(decode_image(data), planes.transpose(1, 2, 0))


def test_a_preview_of_a_sub_page_is_not_taken_for_the_picture(rng) -> None:
    small = rng.integers(0, 255, (5, 7, 3), np.uint8)
    with pytest.raises(ImageError, match="holds a reduced copy, and its picture in a sub-page, which is not read"):
        decode_image(tiff_of([(small, {254: 1, 330: 8})]))
    np.testing.assert_array_equal(decode_image(tiff_of([(small, {254: 1})])), small)
