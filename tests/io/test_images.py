"""Images: what is read is what is stored, and every bad file has a message a person can act on."""

import io
import itertools
import os
import struct
import subprocess
import sys
import tracemalloc
import warnings
import zlib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st
from PIL import Image

from liaam.errors import ImageError
from liaam.io import (
    IMAGE_SUFFIXES,
    decode_image,
    image_kind,
    image_size,
    read_image,
    read_preview,
    write_image,
)
from liaam.photometry import srgb_to_linear

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning:PIL")  # Pillow remarks on broken files

JUNK = settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow]
)
STARTS = [
    b"\x89PNG\r\n\x1a\n",
    b"\xff\xd8\xff",
    b"II*\0",
    b"MM\0*",
    b"II+\0",
    b"BM",
    b"P6\n3 3\n",
    b"P2 1 1 ",
    b"",
]


def make_png(width: int, height: int, bits: int, colour_type: int, raw: bytes, extra: bytes = b"") -> bytes:
    """Build a PNG by hand, for kinds that Pillow does not write."""
    header = struct.pack(">IIBBBBB", width, height, bits, colour_type, 0, 0, 0)
    ending = chunk(b"IDAT", zlib.compress(raw)) + chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + extra + ending


def chunk(tag: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + tag + data + struct.pack(">I", zlib.crc32(tag + data))


def make_tiff(array: np.ndarray, changes: dict[int, list[int]] | None = None, order: str = "<") -> bytes:
    """Build an uncompressed TIFF with its tags before its pixels; a tag without values is left out."""
    height, width = array.shape[:2]
    n_channels = 1 if array.ndim == 2 else array.shape[2]
    kind = {"u": 1, "i": 2, "f": 3}[array.dtype.kind]
    tags = {256: [width], 257: [height], 258: [array.itemsize * 8] * n_channels, 259: [1]}
    tags |= {262: [1 if n_channels == 1 else 2], 273: [0], 277: [n_channels], 278: [height]}
    tags |= {279: [array.nbytes], 284: [1], 339: [kind] * n_channels} | (changes or {})
    tags = {tag: values for tag, values in tags.items() if values}
    blob_at = 8 + 2 + 12 * len(tags) + 4
    blob_size = sum(4 * len(values) for values in tags.values() if len(values) > 1)
    tags[273] = [blob_at + blob_size]
    entries, blob = b"", b""
    for tag, values in sorted(tags.items()):
        packed = struct.pack(f"{order}{len(values)}I", *values)
        if len(values) > 1:
            packed, blob = struct.pack(f"{order}I", blob_at + len(blob)), blob + packed
        entries += struct.pack(f"{order}HHI", tag, 4, len(values)) + packed
    start = (b"II*\0" if order == "<" else b"MM\0*") + struct.pack(f"{order}IH", 8, len(tags))
    return start + entries + b"\0\0\0\0" + blob + array.astype(array.dtype.newbyteorder(order)).tobytes()


def make_big_tiff(array: np.ndarray, order: str = "<") -> bytes:
    """Build a BigTIFF (64-bit offsets) of an (h, w, 3) uint8 or uint16 array."""
    height, width, _ = array.shape
    bits = array.itemsize * 8
    tags = {256: [width], 257: [height], 258: [bits] * 3, 259: [1], 262: [2], 277: [3], 278: [height]}
    tags |= {273: [16 + 8 + 20 * 10 + 8], 279: [array.nbytes], 284: [1]}
    entries = b"".join(
        struct.pack(f"{order}HHQ", tag, 3, len(values)) + struct.pack(f"{order}{len(values)}H", *values).ljust(8, b"\0")
        for tag, values in sorted(tags.items())
    )
    start = (b"II" if order == "<" else b"MM") + struct.pack(f"{order}HHHQQ", 43, 8, 0, 16, len(tags))
    return start + entries + bytes(8) + array.astype(array.dtype.newbyteorder(order)).tobytes()


def colour(rng: np.random.Generator, dtype: type, shape: tuple[int, ...] = (5, 7, 3)) -> np.ndarray:
    if dtype == np.float32:
        return rng.normal(0, 1e3, shape).astype(np.float32)
    return rng.integers(0, np.iinfo(dtype).max, shape, endpoint=True).astype(dtype)


# Round trips ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("suffix", "dtype"),
    [(s, np.uint8) for s in (".png", ".tif", ".tiff", ".bmp", ".ppm", ".pnm", ".PNG")]
    + [(s, np.uint16) for s in (".png", ".tif", ".tiff", ".ppm", ".pnm")]
    + [(s, np.float32) for s in (".tif", ".tiff")],
)
def test_colour_returns_exactly_as_written(tmp_path: Path, rng, suffix: str, dtype: type) -> None:
    array = colour(rng, dtype)
    write_image(tmp_path / f"a{suffix}", array)
    back = read_image(tmp_path / f"a{suffix}")
    assert back.dtype == dtype
    np.testing.assert_array_equal(back, array)
    assert image_size(tmp_path / f"a{suffix}") == (7, 5)


@pytest.mark.parametrize(
    ("suffix", "dtype"),
    [(s, np.uint8) for s in (".png", ".tiff", ".bmp", ".ppm", ".pgm", ".pnm")]
    + [(s, np.uint16) for s in (".png", ".tiff", ".ppm", ".pgm", ".pnm")]
    + [(".tiff", np.float32)],
)
def test_grey_comes_back_as_three_equal_channels(tmp_path: Path, rng, suffix: str, dtype: type) -> None:
    array = colour(rng, dtype, (4, 6))
    write_image(tmp_path / f"a{suffix}", array)
    back = read_image(tmp_path / f"a{suffix}")
    assert back.dtype == dtype
    np.testing.assert_array_equal(back, np.stack([array] * 3, axis=-1))


@given(
    seed=st.integers(0, 2**32 - 1),
    shape=st.tuples(st.integers(1, 9), st.integers(1, 9)),
    dtype=st.sampled_from([np.uint8, np.uint16, np.float32]),
)
@JUNK
def test_any_size_survives_tiff(tmp_path: Path, seed: int, shape: tuple[int, int], dtype: type) -> None:
    array = colour(np.random.default_rng(seed), dtype, (*shape, 3))
    write_image(tmp_path / "a.tiff", array)
    np.testing.assert_array_equal(read_image(tmp_path / "a.tiff"), array)


def test_nan_and_any_float_survive(tmp_path: Path) -> None:
    array = np.array([[[np.nan, -3, 1e30], [np.inf, 0, 1e-30]]], np.float32)
    write_image(tmp_path / "a.tiff", array)
    np.testing.assert_array_equal(read_image(tmp_path / "a.tiff"), array)


def test_float64_becomes_float32(tmp_path: Path) -> None:
    (tmp_path / "a.tiff").write_bytes(make_tiff(np.full((2, 2, 3), 0.1)))
    back = read_image(tmp_path / "a.tiff")
    assert back.dtype == np.float32
    assert back[0, 0, 0] == np.float32(0.1)


@pytest.mark.parametrize("suffix", IMAGE_SUFFIXES)
def test_every_ending_is_of_its_format(tmp_path: Path, suffix: str) -> None:
    write_image(tmp_path / f"a{suffix}", np.full((8, 8), 90, np.uint8))
    with Image.open(tmp_path / f"a{suffix}") as image:
        kinds = {"jpg": "JPEG", "jpeg": "JPEG", "tif": "TIFF", "tiff": "TIFF", "png": "PNG", "bmp": "BMP"}
        assert image.format == kinds.get(suffix[1:], "PPM")


def test_jpeg_keeps_colour_to_a_few_levels(tmp_path: Path) -> None:
    array = np.zeros((32, 32, 3), np.uint8)
    array[:, :16] = (200, 30, 60)
    array[:, 16:] = (20, 130, 220)
    write_image(tmp_path / "a.jpg", array)
    back = read_image(tmp_path / "a.jpg")
    assert np.abs(back.astype(int) - array).max() <= 6  # with halved chroma this edge is off by over 20
    reference = io.BytesIO()
    Image.fromarray(array).save(reference, "JPEG", quality=95)
    with Image.open(tmp_path / "a.jpg") as ours, Image.open(reference) as theirs:
        assert ours.quantization == theirs.quantization  # type: ignore[attr-defined]


# Kinds of files ------------------------------------------------------------------------------------


def test_channels_are_in_rgb_order(tmp_path: Path) -> None:
    (tmp_path / "a.ppm").write_bytes(b"P6 1 1 255\n" + bytes([10, 20, 30]))
    assert read_image(tmp_path / "a.ppm").tolist() == [[[10, 20, 30]]]
    (tmp_path / "a.png").write_bytes(make_png(1, 1, 16, 2, b"\0" + struct.pack(">HHH", 1000, 2000, 3000)))
    assert read_image(tmp_path / "a.png").tolist() == [[[1000, 2000, 3000]]]


@pytest.mark.parametrize("deep", [False, True])
def test_alpha_is_dropped_and_not_multiplied_in(tmp_path: Path, deep: bool) -> None:
    pixel = struct.pack(">4H", 1000, 2000, 3000, 1) if deep else bytes([10, 20, 30, 1])
    (tmp_path / "a.png").write_bytes(make_png(1, 1, 16 if deep else 8, 6, b"\0" + pixel))
    assert read_image(tmp_path / "a.png").tolist() == [[[1000, 2000, 3000] if deep else [10, 20, 30]]]


def test_deep_grey_with_alpha(tmp_path: Path) -> None:
    (tmp_path / "a.png").write_bytes(make_png(1, 1, 16, 4, b"\0" + struct.pack(">HH", 1000, 7)))
    assert read_image(tmp_path / "a.png").tolist() == [[[1000, 1000, 1000]]]


def test_palette_with_transparency_and_cmyk_and_bilevel(tmp_path: Path) -> None:
    image = Image.new("P", (1, 1), 1)
    image.putpalette([0, 0, 0, 10, 20, 30])
    image.save(tmp_path / "p.png", transparency=b"\x00\x80")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert read_image(tmp_path / "p.png").tolist() == [[[10, 20, 30]]]
    Image.new("CMYK", (8, 8), (0, 255, 255, 0)).save(tmp_path / "c.jpg", quality=100)
    assert np.abs(read_image(tmp_path / "c.jpg")[4, 4].astype(int) - [255, 0, 0]).max() <= 3
    Image.new("1", (1, 1), 1).save(tmp_path / "b.png")
    assert read_image(tmp_path / "b.png").tolist() == [[[255, 255, 255]]]


def test_deep_pnm_is_scaled_by_its_largest_value(tmp_path: Path) -> None:
    (tmp_path / "a.pgm").write_bytes(b"P5\n# a comment\n3 1\n4095\n" + struct.pack(">HHH", 0, 4095, 9999))
    assert read_image(tmp_path / "a.pgm")[0, :, 0].tolist() == [0, 65535, 65535]


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_tiff_of_both_byte_orders_and_big_tiff(tmp_path: Path, rng, dtype: type) -> None:
    array = colour(rng, dtype)
    for data in (make_tiff(array), make_tiff(array, order=">"), make_big_tiff(array)):
        assert image_kind(data)
        assert image_size(data) == (7, 5)
        np.testing.assert_array_equal(decode_image(data), array)
    (tmp_path / "a.tif").write_bytes(make_big_tiff(array, ">"))  # Pillow does not read it
    assert "save it as PNG" in refusal(tmp_path / "a.tif")


def test_tiff_tags_that_may_be_left_out(rng) -> None:
    for shape in ((5, 7), (5, 7, 3)):
        array = colour(rng, np.uint16, shape)
        back = decode_image(make_tiff(array, {284: [], 339: []} | ({277: []} if len(shape) == 2 else {})))
        np.testing.assert_array_equal(back, array if len(shape) == 3 else np.stack([array] * 3, axis=-1))
    bilevel = make_tiff(np.full((3, 1), 0b10100000, np.uint8), {256: [8], 258: [], 277: [], 339: []})
    assert decode_image(bilevel)[:, :, 1].tolist() == [[255, 0, 255, 0, 0, 0, 0, 0]] * 3


def test_grey_tiff_in_separate_planes_is_like_any_other(rng) -> None:
    array = colour(rng, np.uint16, (5, 7))
    np.testing.assert_array_equal(decode_image(make_tiff(array, {284: [2]}))[..., 0], array)


@pytest.mark.parametrize(
    ("data", "pixels"),
    [
        (b"P1 2 1 1 0", [0, 255]),
        (b"P2 2 1 100 50 100", [128, 255]),
        (b"P3 1 1 255 7 7 7", [7]),
        (b"P4 8 1 \xf0", [0, 0, 0, 0, 255, 255, 255, 255]),
        (b"P5 2 1 255 \1\xff", [1, 255]),
        (b"P5 1 1 1 \1", [255]),
        (b"P5 2 1 256 \0\1\1\0", [256, 65535]),
        (b"P5 1 1 65535 \1\2", [258]),
        (b"P6 1 1 255 \7\7\7", [7]),
    ],
)
def test_pnm_of_every_kind(data: bytes, pixels: list[int]) -> None:
    assert image_kind(data)
    assert decode_image(data)[0, :, 1].tolist() == pixels


def test_orientation_behind_the_pixels_of_a_png(tmp_path: Path) -> None:
    exif = Image.Exif()
    exif[0x0112] = 6
    data = make_png(3, 2, 8, 0, b"\0\0\1\2\0\3\4\5")
    tail = chunk(b"eXIf", exif.tobytes().removeprefix(b"Exif\0\0"))
    (tmp_path / "a.png").write_bytes(data[:-12] + tail + data[-12:])
    assert read_image(tmp_path / "a.png")[:, :, 0].tolist() == ORIENTED[6]
    assert image_size(tmp_path / "a.png") == (2, 3)


def test_the_size_is_read_without_decoding(tmp_path: Path, rng) -> None:
    write_image(tmp_path / "a.png", colour(rng, np.uint8, (40, 50, 3)))
    data = (tmp_path / "a.png").read_bytes()
    (tmp_path / "a.png").write_bytes(data[:200])  # no pixel can be decoded
    assert image_size(tmp_path / "a.png") == (50, 40)


def test_the_content_counts_not_the_name(tmp_path: Path) -> None:
    (tmp_path / "a.jpg").write_bytes(b"P6 1 1 255\n" + bytes([10, 20, 30]))
    assert read_image(tmp_path / "a.jpg").tolist() == [[[10, 20, 30]]]


ORIENTED = {  # where the stored pixels [[0, 1, 2], [3, 4, 5]] go under each EXIF orientation
    1: [[0, 1, 2], [3, 4, 5]],
    2: [[2, 1, 0], [5, 4, 3]],
    3: [[5, 4, 3], [2, 1, 0]],
    4: [[3, 4, 5], [0, 1, 2]],
    5: [[0, 3], [1, 4], [2, 5]],
    6: [[3, 0], [4, 1], [5, 2]],
    7: [[5, 2], [4, 1], [3, 0]],
    8: [[2, 5], [1, 4], [0, 3]],
}


@pytest.mark.parametrize(
    ("kind", "orientation"),
    [("png8", 6), ("png16", 5), ("tiff16", 6), ("tiff32f", 7), *itertools.product(("tiff8", "jpeg"), range(1, 9))],
)
def test_orientation_is_applied_once(tmp_path: Path, kind: str, orientation: int) -> None:
    stored = np.arange(6).reshape(2, 3)
    exif = Image.Exif()
    exif[0x0112] = orientation
    path = tmp_path / kind
    if kind == "jpeg":  # blocks of 8 pixels, so that compression does not blur the numbers
        big = np.kron(stored * 40, np.ones((16, 16))).astype(np.uint8)
        Image.fromarray(big).save(path, "JPEG", exif=exif, quality=100)
        want = np.kron(np.array(ORIENTED[orientation]) * 40, np.ones((16, 16)))
        back = read_image(path)
        assert np.abs(back[:, :, 0] - want).max() <= 3
    else:
        path.write_bytes(oriented_bytes(kind, stored, exif, orientation))
        back = read_image(path)
        assert back[:, :, 0].tolist() == ORIENTED[orientation]
    assert image_size(path) == back.shape[1::-1]


def oriented_bytes(kind: str, stored: np.ndarray, exif: Image.Exif, orientation: int) -> bytes:
    if kind.startswith("tiff"):
        dtype = {"tiff8": np.uint8, "tiff16": np.uint16, "tiff32f": np.float32}[kind]
        return make_tiff(np.stack([stored] * 3, -1).astype(dtype), {274: [orientation]})
    bits = int(kind[3:])
    rows = b"".join(b"\0" + row.tobytes() for row in stored.astype(f">u{bits // 8}"))
    return make_png(3, 2, bits, 0, rows, chunk(b"eXIf", exif.tobytes().removeprefix(b"Exif\0\0")))


# Bad files -----------------------------------------------------------------------------------------


def refusal(path: Path, **options: int) -> str:
    with pytest.raises(ImageError) as caught:
        read_image(path, **options)
    assert str(caught.value).startswith(str(path))
    return str(caught.value)


def test_missing_file_suggests_close_names(tmp_path: Path) -> None:
    (tmp_path / "face_01.png").write_bytes(b"x")
    assert "does not exist. Did you mean face_01.png?" in refusal(tmp_path / "face_1.png")
    assert "similar name" in refusal(tmp_path / "quite different.jpg")
    assert "does not exist either" in refusal(tmp_path / "no" / "a.png")


def test_folder_empty_file_and_text(tmp_path: Path) -> None:
    assert refusal(tmp_path) == f"{tmp_path} is a folder; give the name of one image inside it."
    with pytest.raises(ImageError, match="give the name of one image inside it"):
        image_size(tmp_path)
    (tmp_path / "empty.png").touch()
    assert "is empty (0 bytes)" in refusal(tmp_path / "empty.png")
    (tmp_path / "text.png").write_text("hello")
    assert "is not a PNG, JPEG, TIFF, BMP, PPM, PGM, WebP, AVIF, HEIC, GIF or JPEG 2000 image" in refusal(
        tmp_path / "text.png"
    )
    (tmp_path / "faces.liaam").write_text("hello")
    assert "faces.liaam is a model, not an image: give one model first" in refusal(tmp_path / "faces.liaam")


def test_a_pipe_is_refused_instead_of_waiting(tmp_path: Path) -> None:
    if not hasattr(os, "mkfifo"):
        pytest.skip("this system has no named pipes")
    os.mkfifo(tmp_path / "a.png")
    assert "is not a regular file" in refusal(tmp_path / "a.png")


def test_unreadable_file(tmp_path: Path) -> None:
    (tmp_path / "a.png").write_bytes(b"x")
    (tmp_path / "a.png").chmod(0)
    if os.access(tmp_path / "a.png", os.R_OK):
        pytest.skip("this user may read everything")
    assert "Permission denied" in refusal(tmp_path / "a.png")


@pytest.mark.parametrize(
    ("suffix", "dtype"),
    [(s, np.uint8) for s in (".png", ".jpg", ".tiff", ".bmp", ".ppm")]
    + [(s, np.uint16) for s in (".png", ".tiff", ".ppm")]
    + [(".tiff", np.float32)],
)
@pytest.mark.parametrize("kept", [0.02, 0.9])
def test_truncated_files_are_noticed(tmp_path: Path, rng, suffix: str, dtype: type, kept: float) -> None:
    path = tmp_path / f"a{suffix}"
    write_image(path, colour(rng, dtype, (40, 50, 3)))
    data = path.read_bytes()
    path.write_bytes(data[: int(kept * len(data))])
    assert "cut short" in refusal(path)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_truncated_tiff_with_its_tags_first(tmp_path: Path, rng, dtype: type) -> None:
    data = make_tiff(colour(rng, dtype, (40, 50, 3)))
    (tmp_path / "a.tiff").write_bytes(data[:-1])
    assert "cut short" in refusal(tmp_path / "a.tiff")


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("size", [b"\x7f\0\0\0", b"\0\0\0\1"])  # OpenCV would make room for 2 GB
def test_png_whose_last_chunk_promises_too_much(tmp_path: Path, rng, dtype: type, size: bytes) -> None:
    write_image(tmp_path / "a.png", colour(rng, dtype))
    data = (tmp_path / "a.png").read_bytes()
    (tmp_path / "a.png").write_bytes(data[:-12] + size + data[-8:])
    assert "ends within a chunk" in refusal(tmp_path / "a.png")


@pytest.mark.parametrize("lost", [1, 4, 11, 12, 13])
def test_png_that_lacks_a_few_bytes(tmp_path: Path, rng, lost: int) -> None:
    write_image(tmp_path / "a.png", colour(rng, np.uint8))
    data = (tmp_path / "a.png").read_bytes()
    (tmp_path / "a.png").write_bytes(data[:-lost])
    assert refusal(tmp_path / "a.png") == (
        f"{tmp_path / 'a.png'} is cut short (it ends within a chunk): copy it again."
    )


def test_deep_tiff_with_alpha(rng) -> None:
    array = colour(rng, np.uint16, (5, 7, 4))
    np.testing.assert_array_equal(decode_image(make_tiff(array, {338: [2]})), array[..., :3])


def test_too_many_pixels_are_refused_before_decoding(tmp_path: Path) -> None:
    (tmp_path / "bomb.png").write_bytes(make_png(60_000, 60_000, 8, 2, b""))
    message = refusal(tmp_path / "bomb.png")
    assert "60000 x 60000 pixels, more than the 200,000,000 allowed" in message
    assert "max_pixels" in message and "set LIAAM_MAX_PIXELS to 3600000000" in message
    (tmp_path / "bomb.ppm").write_bytes(b"P6 999999999 999999999 255\n")
    assert "more than" in refusal(tmp_path / "bomb.ppm")
    write_image(tmp_path / "a.png", np.zeros((3, 4), np.uint8))
    assert read_image(tmp_path / "a.png", max_pixels=12).shape == (3, 4, 3)
    assert "more than the 11 allowed" in refusal(tmp_path / "a.png", max_pixels=11)


@pytest.mark.parametrize(
    ("array", "changes", "words"),
    [
        (np.zeros((2, 2, 3), np.int16), {}, "does not hold 8- or 16-bit unsigned"),
        (np.zeros((2, 2, 3), np.uint32), {}, "does not hold 8- or 16-bit unsigned"),
        (np.zeros((2, 2, 3), np.float16), {}, "does not hold 8- or 16-bit unsigned"),
        (np.zeros((2, 2), np.uint16), {262: [0]}, "not a grey or RGB image"),
        (np.zeros((2, 2, 2), np.uint16), {262: [1]}, "not a grey or RGB image"),
        (np.zeros((2, 2, 3), np.uint16), {284: [2]}, "separate planes"),
    ],
)
def test_tiff_that_cannot_be_given_as_stored(
    tmp_path: Path, array: np.ndarray, changes: dict[int, list[int]], words: str
) -> None:
    (tmp_path / "a.tiff").write_bytes(make_tiff(array, changes))
    assert words in refusal(tmp_path / "a.tiff")


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"P6 5", "EOF while reading header"),
        (b"P6 5 5 25", "not enough image data"),
        (b"P5 1 1 \0", "invalid literal"),
        (b"P5 1 1 0 \0", "maxval must be greater than 0"),
        (b"P5 1 1 65536 \0\0", "less than 65536"),
        (b"P5 0 1 255 \0", ""),
        (b"P5 1 0 255 \0", ""),
        (b"P5 2 1 65535 \0\1\0", "image file is truncated"),
        (b"P6 1 1 65535 \0\1\0\1\0", "not enough image data"),
    ],
)
def test_pnm_that_is_not_whole(tmp_path: Path, data: bytes, words: str) -> None:
    (tmp_path / "a.pnm").write_bytes(data)
    message = refusal(tmp_path / "a.pnm")
    assert words in message
    assert "damaged or cut short" in message and "copy it again" in message


@pytest.mark.parametrize("tag", [273, 324])
def test_tiff_whose_strips_or_tiles_lie_behind_its_end(tmp_path: Path, tag: int) -> None:
    data = make_tiff(np.zeros((2, 2), np.uint8), {324: [10], 325: [10_000]} if tag == 324 else {279: [5]})
    (tmp_path / "a.tif").write_bytes(data)
    assert "it ends before its pixels do" in refusal(tmp_path / "a.tif")


def test_deep_tiff_whose_pixels_are_nonsense(tmp_path: Path) -> None:
    (tmp_path / "a.tif").write_bytes(make_tiff(np.full((9, 9), 65535, np.uint16), {259: [5]}))  # of LZW
    assert "is damaged or cut short" in refusal(tmp_path / "a.tif")


def test_memory_errors_are_no_damage(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise MemoryError

    write_image(tmp_path / "a.png", np.zeros((2, 2), np.uint8))
    monkeypatch.setattr("liaam.io.images.rgb_of", full)
    with pytest.raises(ImageError, match=r"a\.png is too large for the free memory: make it smaller") as caught:
        read_image(tmp_path / "a.png")
    assert isinstance(caught.value.__cause__, MemoryError)


def test_deep_plain_text_pnm_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.pgm").write_bytes(b"P2 1 1 65535 7\n")
    assert "plain text" in refusal(tmp_path / "a.pgm")


@given(start=st.sampled_from(STARTS), rest=st.binary(max_size=200))
@JUNK
def test_junk_raises_only_image_errors(tmp_path: Path, start: bytes, rest: bytes) -> None:
    (tmp_path / "junk").write_bytes(start + rest)
    try:
        array = read_image(tmp_path / "junk", max_pixels=10_000)
    except ImageError as error:
        assert "junk" in str(error)
    else:
        assert array.ndim == 3


@given(seed=st.integers(0, 2**32 - 1), kind=st.sampled_from([".png", ".jpg", ".tiff", ".bmp", ".ppm"]))
@JUNK
def test_flipped_bytes_raise_only_image_errors(tmp_path: Path, seed: int, kind: str) -> None:
    rng = np.random.default_rng(seed)
    write_image(tmp_path / f"a{kind}", colour(rng, np.uint8, (9, 11, 3)))
    data = bytearray((tmp_path / f"a{kind}").read_bytes())
    for place in rng.integers(0, len(data), 3):
        data[place] = rng.integers(256)
    (tmp_path / "junk").write_bytes(data)
    try:
        array = read_image(tmp_path / "junk", max_pixels=10_000)
    except ImageError as error:
        assert "junk" in str(error)
    else:
        assert array.shape[2] == 3


# Writing -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "array", "words"),
    [
        ("a.gif", np.zeros((2, 2), np.uint8), "'.gif' is not a known extension"),
        ("a.png", np.zeros((2, 2), np.float32), "Use .tiff, or convert"),
        ("a.jpg", np.zeros((2, 2), np.uint16), "cannot hold 16 bits"),
        ("a.png", np.zeros((2, 2)), "the values are float64"),
        ("a.png", np.zeros((2, 2, 4), np.uint8), "shape (2, 2, 4)"),
        ("a.png", np.zeros((0, 2), np.uint8), "shape (0, 2)"),
        ("a.pgm", np.zeros((2, 2, 3), np.uint8), ".pgm is for grey images"),
        ("no/a.png", np.zeros((2, 2), np.uint8), "does not exist. Make it first"),
    ],
)
def test_what_cannot_be_written_leaves_nothing(tmp_path: Path, name: str, array: np.ndarray, words: str) -> None:
    with pytest.raises(ImageError) as caught:
        write_image(tmp_path / name, array)
    assert words in str(caught.value)
    assert name in str(caught.value)
    assert list(tmp_path.iterdir()) == []


# Real files ----------------------------------------------------------------------------------------


def test_real_images_are_as_pillow_decodes_them(shared_data: Path) -> None:
    for name in ("imm/01-1m.jpg", "london/001_03.jpg", "one-person/107_0764.png"):
        back = read_image(shared_data / name)
        with Image.open(shared_data / name) as image:
            np.testing.assert_array_equal(back, np.asarray(image))
            assert image_size(shared_data / name) == image.size
    assert np.ptp(read_image(shared_data / "imm/02-1m.jpg").astype(int), axis=2).max() == 0  # grey, per its README


def test_truncated_real_jpeg(shared_data: Path, tmp_path: Path) -> None:
    data = (shared_data / "imm/01-1m.jpg").read_bytes()
    (tmp_path / "a.jpg").write_bytes(data[: len(data) * 2 // 3])
    assert "truncated" in refusal(tmp_path / "a.jpg")


def test_importing_liaam_io_needs_no_decoder() -> None:
    code = "import sys, liaam.io, liaam.datasets.folder; print({'cv2', 'PIL', 'rich'} & set(sys.modules))"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.strip() == "set()"


def test_buffers_are_not_shared(tmp_path: Path) -> None:
    buffer = io.BytesIO()
    Image.new("RGB", (2, 2)).save(buffer, "PNG")
    (tmp_path / "a.png").write_bytes(buffer.getvalue())
    array = read_image(tmp_path / "a.png")
    array[0, 0] = 7  # callers may write to what they are given
    assert read_image(tmp_path / "a.png")[0, 0].tolist() == [0, 0, 0]


# Bytes and previews -------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".tif", ".bmp", ".ppm"])
@pytest.mark.parametrize("deep", [False, True])
def test_bytes_are_read_as_files_are(tmp_path, rng, suffix, deep):
    if deep and suffix in (".jpg", ".bmp"):
        deep = False
    path = tmp_path / f"a{suffix}"
    write_image(path, rng.integers(0, 65536 if deep else 256, (13, 17, 3)).astype(np.uint16 if deep else np.uint8))
    data = path.read_bytes()
    assert np.array_equal(decode_image(data), read_image(path))
    assert image_size(data) == image_size(path) == (17, 13)
    assert image_kind(data)


def test_bytes_that_are_no_image_are_named(tmp_path):
    assert not image_kind(b"")
    assert not image_kind(b"RIFF....WAVE")
    assert not image_kind(b"P0 1 1 255 0") and not image_kind(b"P7 1 1 255 0")
    for read in (decode_image, image_size):
        with pytest.raises(ImageError, match=r"photo\.webp is not a PNG"):
            read(b"RIFF....WAVE", "photo.webp")
        with pytest.raises(ImageError, match=r"photo\.webp is damaged or cut short"):
            read(b"RIFF....WEBP", "photo.webp")
        with pytest.raises(ImageError, match=r"clip\.mp4 is a video, not an image: use 'liaam track'"):
            read(b"\0\0\0\x18ftypmp42", "clip.mp4")
        with pytest.raises(ImageError, match=r"clip\.MPG is a video"):
            read(b"\0\0\1\xba", "clip.MPG")
    write_image(tmp_path / "a.png", np.zeros((20, 30, 3), np.uint8))
    data = (tmp_path / "a.png").read_bytes()
    with pytest.raises(ImageError, match="photo has 30 x 20 pixels, more than the 599 allowed"):
        decode_image(data, "photo", max_pixels=599)
    with pytest.raises(ImageError, match="photo is cut short"):
        decode_image(data[:-12], "photo")


@pytest.mark.parametrize(
    ("size", "seen"), [(40, (50, 75)), (50, (50, 75)), (51, (100, 150)), (400, (400, 600)), (900, (400, 600))]
)
def test_a_preview_is_not_smaller_than_asked_for(tmp_path, size, seen):
    y, x = np.mgrid[:400, :600]
    image = np.dstack([x / 3, y / 2, 0 * x + 90]).astype(np.uint8)
    for name in ("a.jpg", "a.png"):
        write_image(tmp_path / name, image)
        preview = read_preview(tmp_path / name, size)
        assert preview.shape[:2] == (seen if name == "a.jpg" else (400, 600))
        step = 400 // preview.shape[0]
        means = image.reshape(400 // step, step, 600 // step, step, 3).mean(axis=(1, 3))
        assert np.abs(preview - means).max() <= 4


def test_a_preview_is_upright(tmp_path):
    exif = Image.Exif()
    exif[0x0112] = 6
    Image.fromarray(np.zeros((400, 600, 3), np.uint8)).save(tmp_path / "a.jpg", exif=exif)
    assert read_preview(tmp_path / "a.jpg", 50).shape == (75, 50, 3)


def test_the_size_that_is_checked_is_the_one_that_is_decoded():
    data = b"P5 9#c\n9 9 255\n" + bytes(99 * 9)  # 9 x 9 pixels by the format's rules, 99 x 9 by Pillow's
    with pytest.raises(ImageError, match="99 x 9 pixels, more than the 100 allowed"):
        decode_image(data, "x", 100)
    assert decode_image(data, "x", 1000).shape == (9, 99, 3)


def test_deep_pictures_are_decoded_without_a_copy_too_many(tmp_path, rng):
    image = rng.random((2000, 1500, 3), dtype=np.float32)
    write_image(tmp_path / "x.tif", image)
    data = (tmp_path / "x.tif").read_bytes()
    tracemalloc.start()
    decoded = decode_image(data)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert np.array_equal(decoded, image)
    assert peak < 1.5 * image.nbytes


@pytest.mark.parametrize("suffix", [".webp", ".avif", ".gif", ".jfif", ".jp2"])
def test_what_pillow_opens_is_read_if_it_is_one_still(tmp_path, suffix):
    grey = np.repeat(np.repeat(np.array([[0, 255], [85, 170]], np.uint8), 8, axis=0), 8, axis=1)
    path, still = tmp_path / f"a{suffix}", Image.fromarray(grey).convert("RGB")
    kind = {".jfif": "JPEG", ".jp2": "JPEG2000"}.get(suffix, suffix[1:].upper())
    if suffix not in Image.registered_extensions():  # AVIF, before Pillow 11.3
        path.write_bytes(b"\0\0\0\x18ftypavif" + bytes(40))
        with pytest.raises(ImageError, match=r"a\.avif is an AVIF image, which needs Pillow 11.3 or later"):
            read_image(path)
        return
    still.save(path, format=kind, **({} if kind == "JPEG2000" else {"quality": 100}))
    assert image_size(path) == (16, 16)
    np.testing.assert_allclose(read_image(path)[4::8, 4::8, 1], grey[4::8, 4::8], atol=4)
    if suffix in (".webp", ".gif"):
        still.save(path, format=kind, save_all=True, append_images=[Image.fromarray(255 - grey).convert("RGB")])
        with pytest.raises(ImageError, match="holds 2 pictures, not one still"):
            read_image(path)


def test_a_photo_of_a_phone_names_the_extra(tmp_path):
    pytest.importorskip("PIL")
    (tmp_path / "a.heic").write_bytes(b"\0\0\0\x18ftypheic" + bytes(40))
    with pytest.raises(ImageError, match=r"a\.heic is (an HEIC image, which needs .*\[heic\]|damaged)"):
        read_image(tmp_path / "a.heic")


def test_an_animated_png_is_no_still(tmp_path):
    first, second = (Image.fromarray(np.full((8, 8, 3), grey, np.uint8)) for grey in (10, 200))
    first.save(tmp_path / "a.png", save_all=True, append_images=[second])
    with pytest.raises(ImageError, match=r"a\.png holds 2 pictures, not one still: save one as PNG, or .* 'liaam t"):
        read_image(tmp_path / "a.png")


def test_a_jpeg_with_a_preview_behind_it_or_with_damaged_exif_data_is_read(tmp_path):
    first, second = (Image.fromarray(np.full((16, 16, 3), grey, np.uint8)) for grey in (90, 200))
    first.save(tmp_path / "phone.jpg", "MPO", save_all=True, append_images=[second])
    first.save(tmp_path / "exif.jpg", exif=b"Exif\0\0no tags")
    for name in ("phone.jpg", "exif.jpg"):
        assert np.abs(read_image(tmp_path / name).astype(int) - 90).max() <= 1


def test_a_jpeg_2000_of_16_bits_is_read_as_stored(rng):
    grey, buffer = colour(rng, np.uint16, (9, 8)), io.BytesIO()
    Image.fromarray(grey).save(buffer, "JPEG2000")
    np.testing.assert_array_equal(decode_image(buffer.getvalue())[..., 1], grey)


@pytest.mark.parametrize(
    ("given", "words"), [("11", "more than the 11 allowed"), ("many", "is not a number of pixels")]
)
def test_the_limit_of_pixels_is_set_for_commands_by_a_variable(tmp_path, monkeypatch, given, words):
    write_image(tmp_path / "a.png", np.zeros((3, 4), np.uint8))
    monkeypatch.setenv("LIAAM_MAX_PIXELS", given)
    with pytest.raises(ImageError, match=words):
        read_image(tmp_path / "a.png")
    assert read_image(tmp_path / "a.png", max_pixels=12).shape == (3, 4, 3)  # an argument comes first
    monkeypatch.setenv("LIAAM_MAX_PIXELS", "12")
    assert read_image(tmp_path / "a.png").shape == (3, 4, 3)


# Colour profiles ----------------------------------------------------------------------------------

ADOBE = ((0.60974, 0.31111, 0.01947), (0.20528, 0.62567, 0.06087), (0.14919, 0.06322, 0.74457))
P3 = ((0.51512, 0.24120, -0.00105), (0.29198, 0.69225, 0.04189), (0.15710, 0.06657, 0.78407))
SRGB = ((0.43607, 0.22249, 0.01392), (0.38515, 0.71687, 0.09708), (0.14307, 0.06061, 0.71410))
PROPHOTO = ((0.79767, 0.28804, 0.0), (0.13519, 0.71188, 0.0), (0.03134, 0.00009, 0.82491))
WHITE = (0.9642, 1.0, 0.8249)


def make_profile(primaries: tuple[tuple[float, ...], ...], gamma: float | np.ndarray) -> bytes:
    """Build an ICC profile by hand: of RGB with these XYZ of its primaries, or of grey without any.

    Instead of ``gamma`` the light of evenly spaced values can be given, (n,) from 0 to 1.
    """

    def xyz(values: tuple[float, ...]) -> bytes:
        return struct.pack(">3i", *(round(value * 65536) for value in values))

    if isinstance(gamma, np.ndarray):
        curve = b"curv" + struct.pack(">II", 0, len(gamma)) + np.rint(65535 * gamma).astype(">u2").tobytes()
    else:
        curve = b"curv" + struct.pack(">IIHxx", 0, 1, round(gamma * 256))
    tags = {b"wtpt": b"XYZ \0\0\0\0" + xyz(WHITE)}
    for letter, primary in zip((b"r", b"g", b"b"), primaries, strict=False):
        tags |= {letter + b"XYZ": b"XYZ \0\0\0\0" + xyz(primary), letter + b"TRC": curve}
    if not primaries:
        tags[b"kTRC"] = curve
    table, blob, start = b"", b"", 132 + 12 * len(tags)
    for tag, data in tags.items():
        table, blob = table + tag + struct.pack(">II", start + len(blob), len(data)), blob + data
    space = b"RGB " if primaries else b"GRAY"
    head = struct.pack(">I4xI4s4s4s12x4s28x", start + len(blob), 0x02100000, b"mntr", space, b"XYZ ", b"acsp")
    return (head + xyz(WHITE)).ljust(128, b"\0") + struct.pack(">I", len(tags)) + table + blob


def to_srgb(values: np.ndarray, primaries: tuple[tuple[float, ...], ...], gamma: float) -> np.ndarray:
    """Convert 8-bit values (n, 3) by the definition of the colour spaces."""
    matrix = np.array(
        [[3.1338561, -1.6168667, -0.4906146], [-0.9787684, 1.9161415, 0.0334540], [0.0719453, -0.2289914, 1.4052427]]
    )
    linear = np.clip((values / 255) ** gamma @ np.array(primaries) @ np.transpose(matrix), 0, 1)
    return 255 * np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


@pytest.mark.parametrize(("primaries", "gamma"), [(ADOBE, 2.19921875), (P3, 2.2), (PROPHOTO, 1.8)])
@pytest.mark.parametrize("kind", ["PNG", "TIFF", "WEBP"])
def test_a_colour_profile_is_converted_to_srgb(tmp_path, primaries, gamma, kind):
    colours = np.array([[[90, 120, 80], [128, 128, 128], [150, 110, 100], [20, 18, 25]]], np.uint8)
    options = {"lossless": True} if kind == "WEBP" else {}
    Image.fromarray(colours).save(tmp_path / "a", kind, icc_profile=make_profile(primaries, gamma), **options)
    seen = read_image(tmp_path / "a")
    assert np.abs(seen[0] - to_srgb(colours[0], primaries, gamma)).max() <= 2
    assert np.abs(seen[0].astype(int) - colours[0]).max() >= 4
    assert np.ptp(seen[0, 1]) == 0  # grey stays grey


@pytest.mark.parametrize(("darker", "seen"), [(2, 255), (3, 252)])
def test_only_profiles_that_differ_from_srgb_by_more_than_rounding_change_values(tmp_path, darker, seen):
    light = srgb_to_linear(np.linspace(0, 1, 256)) * srgb_to_linear(np.array(1 - darker / 255))
    white = Image.new("RGB", (4, 3), (255, 255, 255))
    white.save(tmp_path / "a.png", icc_profile=make_profile(SRGB, light))
    assert (read_image(tmp_path / "a.png") == seen).all()


def test_grey_and_cmyk_of_other_profiles(tmp_path):
    ramp = np.arange(256, dtype=np.uint8)[None]
    Image.fromarray(ramp).save(tmp_path / "grey.png", icc_profile=make_profile((), 1.8))
    seen = read_image(tmp_path / "grey.png")
    assert np.ptp(seen.astype(int), axis=2).max() == 0
    assert np.abs(seen[0, :, 0] - to_srgb(np.repeat(ramp[0, :, None], 3, 1), ADOBE, 1.8)[:, 0]).max() <= 2
    profile = make_profile(ADOBE, 2.2)  # of RGB, which is none of CMYK
    Image.new("CMYK", (8, 8), (0, 255, 255, 0)).save(tmp_path / "c.jpg", quality=100, icc_profile=profile)
    assert np.abs(read_image(tmp_path / "c.jpg")[4, 4].astype(int) - [255, 0, 0]).max() <= 3


def test_values_are_as_stored_in_srgb_and_where_a_profile_is_damaged_or_the_file_deep(tmp_path, rng):
    from PIL import ImageCms

    array = colour(rng, np.uint8)
    for profile in (ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes(), b"junk", bytes(200)):
        Image.fromarray(array).save(tmp_path / "a.png", icc_profile=profile)
        np.testing.assert_array_equal(read_image(tmp_path / "a.png"), array)
    profile = chunk(b"iCCP", b"x\0\0" + zlib.compress(make_profile(PROPHOTO, 1.8)))
    deep = make_png(1, 1, 16, 2, b"\0" + struct.pack(">HHH", 1000, 2000, 3000), profile)
    assert decode_image(deep).tolist() == [[[1000, 2000, 3000]]]
