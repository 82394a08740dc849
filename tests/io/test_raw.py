"""RAW files: linear, alike for all pictures of a camera, and every bad file has a message a person can act on."""

import struct
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from liaam.errors import ImageError
from liaam.io import image_size, is_raw, read_image, read_preview, write_image
from liaam.io.raw import RAW_SUFFIXES, read_raw

BLACK, WHITE = 64, 4095
BYTE, ASCII, SHORT, LONG, RATIONAL, SIGNED_RATIONAL = 1, 2, 3, 4, 5, 10
PACKING = {BYTE: "B", SHORT: "H", LONG: "I", RATIONAL: "II", SIGNED_RATIONAL: "ii"}


def make_dng(light: np.ndarray, orientation: int = 1, neutral: tuple[float, ...] = (0.5, 1.0, 0.6), **changes) -> bytes:
    """Build a DNG by hand from linear light (h, w, 3) in [0, 1]: RGGB cells, 12 of 16 bits, not compressed."""
    cells = np.empty(light.shape[:2])
    for y, x, channel in ((0, 0, 0), (0, 1, 1), (1, 0, 1), (1, 1, 2)):
        cells[y::2, x::2] = light[y::2, x::2, channel]
    pixels = np.round(np.clip(cells, 0, 1) * (WHITE - BLACK) + BLACK).astype("<u2").tobytes()
    height, width = cells.shape
    identity = [value for row in np.eye(3, dtype=int).tolist() for one in row for value in (one, 1)]
    as_shot = [value for share in neutral for value in (round(1000 * share), 1000)]
    tags = {
        254: (LONG, [0]), 256: (LONG, [changes.get("width", width)]), 257: (LONG, [changes.get("height", height)]),
        258: (SHORT, [16]), 259: (SHORT, [1]), 262: (SHORT, [32803]), 271: (ASCII, b"liaam\0"), 272: (ASCII, b"test\0"),
        273: (LONG, [0]), 274: (SHORT, [orientation]), 277: (SHORT, [1]), 278: (LONG, [height]),
        279: (LONG, [len(pixels)]), 284: (SHORT, [1]), 33421: (SHORT, [2, 2]), 33422: (BYTE, [0, 1, 1, 2]),
        50706: (BYTE, [1, 4, 0, 0]), 50707: (BYTE, [1, 1, 0, 0]), 50708: (ASCII, b"liaam test\0"),
        50714: (LONG, [BLACK]), 50717: (LONG, [WHITE]), 50721: (SIGNED_RATIONAL, identity),
        50718: (RATIONAL, changes.get("scale", [1, 1, 1, 1])), 50728: (RATIONAL, as_shot), 50778: (SHORT, [21]),
    }  # fmt: skip
    blob_at = 8 + 2 + 12 * len(tags) + 4
    packed = {}
    for tag, (kind, values) in tags.items():
        pair = 2 if kind in (RATIONAL, SIGNED_RATIONAL) else 1
        form = PACKING.get(kind, "B")[-1]
        packed[tag] = (kind, len(values) // pair, struct.pack(f"<{len(values)}{form}", *values))
    long = [data for _, _, data in packed.values() if len(data) > 4]
    packed[273] = (LONG, 1, struct.pack("<I", blob_at + sum(len(data) + len(data) % 2 for data in long)))
    entries, blob = b"", b""
    for tag, (kind, count, data) in sorted(packed.items()):
        field = data.ljust(4, b"\0") if len(data) <= 4 else struct.pack("<I", blob_at + len(blob))
        blob += b"" if len(data) <= 4 else data + b"\0" * (len(data) % 2)
        entries += struct.pack("<HHI", tag, kind, count) + field
    return b"II*\0" + struct.pack("<IH", 8, len(tags)) + entries + b"\0\0\0\0" + blob + pixels


def even(red: float, green: float, blue: float, size: tuple[int, int] = (32, 48)) -> np.ndarray:
    return np.broadcast_to([red, green, blue], (*size, 3))


def refusal(path: Path, **options) -> str:
    with pytest.raises(ImageError) as caught:
        read_image(path, **options)
    assert str(path) in str(caught.value)
    return str(caught.value)


@pytest.fixture
def dng(tmp_path: Path) -> Path:
    path = tmp_path / "a.dng"
    path.write_bytes(make_dng(even(0.5, 0.25, 0.1)))
    return path


# What LibRaw is asked for, without it ---------------------------------------------------------------


class FakeRaw:
    """Stands for an opened file, and remembers what was asked of it."""

    def __init__(self, path: str, image: np.ndarray, flip: int = 0) -> None:
        self.path, self.image, self.asked, self.closed = path, image, {}, False
        self.sizes = SimpleNamespace(iwidth=image.shape[1], iheight=image.shape[0], flip=flip, pixel_aspect=1.0)

    def __enter__(self) -> "FakeRaw":
        return self

    def __exit__(self, *_) -> None:
        self.closed = True

    def postprocess(self, **options) -> np.ndarray:
        self.asked = options
        return self.image


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """Put a module in rawpy's place."""
    module = SimpleNamespace(
        image=np.arange(8 * 10 * 3, dtype=np.uint16).reshape(8, 10, 3),
        flip=0,
        opened=[],
        libraw_version=(0, 22, 0),
        ColorSpace=SimpleNamespace(raw="raw"),
        HighlightMode=SimpleNamespace(Clip="clip"),
        DemosaicAlgorithm=SimpleNamespace(LINEAR="linear"),
        LibRawFileUnsupportedError=type("LibRawFileUnsupportedError", (Exception,), {}),
    )

    def imread(path: str) -> FakeRaw:
        module.opened.append(FakeRaw(path, module.image, module.flip))
        return module.opened[-1]

    module.imread = imread
    monkeypatch.setitem(sys.modules, "rawpy", module)
    return module


def test_nothing_that_depends_on_the_picture_is_asked_for(fake, dng):
    np.testing.assert_array_equal(read_raw(dng), fake.image)
    (raw,) = fake.opened
    assert raw.path == str(dng)
    assert raw.closed
    assert raw.asked == {
        "gamma": (1, 1),
        "no_auto_bright": True,
        "adjust_maximum_thr": 0.0,
        "use_camera_wb": False,
        "use_auto_wb": False,
        "user_wb": [1.0, 1.0, 1.0, 1.0],
        "output_color": "raw",
        "output_bps": 16,
        "highlight_mode": "clip",
        "demosaic_algorithm": "linear",
    }


@pytest.mark.parametrize("suffix", [*RAW_SUFFIXES, ".NEF"])
def test_images_are_raw_by_their_ending(fake, tmp_path, suffix):
    path = tmp_path / f"a{suffix}"
    path.write_bytes(b"II*\0 like a TIFF file")
    assert is_raw(path)
    assert is_raw(str(path))
    np.testing.assert_array_equal(read_image(path), fake.image)
    assert image_size(path) == (10, 8)


@pytest.mark.parametrize("name", ["a.png", "a.tif", "dng", "a.dng.jpg", ".dng"])
def test_other_files_are_not_raw(name):
    assert not is_raw(name)


def test_a_preview_of_a_raw_file_is_all_of_it(fake, dng):
    np.testing.assert_array_equal(read_preview(dng, 5), fake.image)
    with pytest.raises(ImageError, match="more than the 79 allowed"):
        read_preview(dng, 5, max_pixels=79)


def test_too_many_pixels_are_refused_before_decoding(fake, dng):
    message = refusal(dng, max_pixels=79)
    assert message.startswith(f"{dng} has 10 x 8 pixels, more than the 79 allowed")
    assert fake.opened[0].asked == {}
    assert fake.opened[0].closed
    assert read_image(dng, max_pixels=80).shape == (8, 10, 3)


@pytest.mark.parametrize("flip", [5, 6])
def test_the_size_of_a_picture_on_its_side(fake, dng, flip):
    fake.flip = flip
    assert image_size(dng) == (8, 10)


@pytest.mark.parametrize("shape", [(8, 10), (8, 10, 1)])
def test_a_monochrome_sensor_gives_three_equal_channels(fake, dng, shape):
    fake.image = np.arange(80, dtype=np.uint16).reshape(shape)
    image = read_raw(dng)
    assert image.shape == (8, 10, 3)
    assert (image == image[..., :1]).all()


def test_a_sensor_of_four_colours_is_refused(fake, dng):
    fake.image = np.zeros((8, 10, 4), np.uint16)
    assert "sensor with 4 colours" in refusal(dng)


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        (lambda fake: fake.LibRawFileUnsupportedError(b"Unsupported"), "is not a RAW file that LibRaw 0.22.0 can read"),
        (lambda fake: RuntimeError(b"Input/output error"), r"is damaged or cut short (Input/output error)"),
        (lambda fake: ValueError("strange"), r"is damaged or cut short (strange)"),
        (lambda fake: ValueError(), r"is damaged or cut short ()"),
    ],
)
def test_faults_of_the_decoder_name_the_file(fake, dng, monkeypatch, fault, words):
    def postprocess(*_, **__):
        raise fault(fake)

    monkeypatch.setattr(FakeRaw, "postprocess", postprocess)
    assert words in refusal(dng)


def test_memory_errors_are_no_damage(fake, dng, monkeypatch):
    def postprocess(*_, **__):
        raise MemoryError

    monkeypatch.setattr(FakeRaw, "postprocess", postprocess)
    with pytest.raises(ImageError, match="is too large for the free memory"):
        read_raw(dng)


def test_without_rawpy_the_remedy_is_named(dng, monkeypatch):
    monkeypatch.setitem(sys.modules, "rawpy", None)
    for read in (read_raw, read_image, image_size):
        with pytest.raises(ImageError, match=r'a\.dng is a RAW file.*pip install "\.\[raw\]"'):
            read(dng)


def test_a_missing_or_empty_file_is_told_before_rawpy_is_missed(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "rawpy", None)
    assert "does not exist" in refusal(tmp_path / "a.nef")
    (tmp_path / "a.nef").touch()
    assert "is empty (0 bytes)" in refusal(tmp_path / "a.nef")
    (tmp_path / "b.nef").mkdir()
    assert "is a folder" in refusal(tmp_path / "b.nef")


def test_raw_files_are_not_written(tmp_path):
    with pytest.raises(ImageError, match="is not a known extension"):
        write_image(tmp_path / "a.dng", np.zeros((8, 8, 3), np.uint16))


# LibRaw itself ---------------------------------------------------------------------------------------


@pytest.fixture
def libraw() -> None:
    pytest.importorskip("rawpy", reason='RAW files are decoded by rawpy: pip install ".[raw]"')


def written(tmp_path: Path, light: np.ndarray, **options) -> Path:
    path = tmp_path / "a.dng"
    path.write_bytes(make_dng(light, **options))
    return path


@pytest.mark.usefixtures("libraw")
def test_values_are_linear_light_of_the_sensor(tmp_path):
    image = read_raw(written(tmp_path, even(0.5, 0.25, 0.1)))
    assert image.dtype == np.uint16
    assert image.shape == (32, 48, 3)
    np.testing.assert_allclose(
        image / 65535, np.broadcast_to([0.5, 0.25, 0.1], image.shape), atol=1.5 / (WHITE - BLACK)
    )


@pytest.mark.usefixtures("libraw")
def test_white_balance_and_brightness_do_not_depend_on_the_picture(tmp_path):
    readings = [
        read_raw(written(tmp_path, even(gain * 0.9, gain * 0.3, gain * 0.1), neutral=neutral))[16, 24] / gain
        for gain in (1.0, 0.95, 0.2)
        for neutral in ((0.5, 1.0, 0.6), (1.0, 0.4, 0.3))
    ]
    # Bright pictures are where LibRaw by itself takes the brightest pixel for white.
    np.testing.assert_allclose(readings, readings[0][None].repeat(6, axis=0), rtol=5e-3)


@pytest.mark.usefixtures("libraw")
def test_what_saturates_the_sensor_is_white_in_each_channel_alone(tmp_path):
    np.testing.assert_allclose(
        read_raw(written(tmp_path, even(1.3, 0.3, 0.1)))[16, 24] / 65535, [1, 0.3, 0.1], atol=1e-3
    )


@pytest.mark.usefixtures("libraw")
def test_linear_shading_survives_the_interpolation(tmp_path):
    ramp = np.linspace(0.1, 0.9, 48)[None, :, None] * np.array([1.0, 0.7, 0.4]) * np.ones((32, 1, 1))
    image = read_raw(written(tmp_path, ramp)) / 65535
    np.testing.assert_allclose(image[2:-2, 2:-2], ramp[2:-2, 2:-2], atol=1e-3)


@pytest.mark.usefixtures("libraw")
@pytest.mark.parametrize(("orientation", "shape"), [(1, (32, 48)), (3, (32, 48)), (6, (48, 32)), (8, (48, 32))])
def test_pictures_are_upright(tmp_path, orientation, shape):
    light = even(0.3, 0.3, 0.3) * np.ones((32, 48, 1))
    light[:8, :8] = 0.9  # the corner at the top left
    path = written(tmp_path, light, orientation=orientation)
    image = read_image(path)
    assert image.shape[:2] == shape
    assert image_size(path) == shape[::-1]
    corners = {1: (2, 2), 3: (-3, -3), 6: (2, -3), 8: (-3, 2)}
    assert image[corners[orientation]].min() > 0.8 * 65535
    assert np.median(image) < 0.4 * 65535


@pytest.mark.usefixtures("libraw")
@pytest.mark.parametrize("kept", [0.02, 0.1, 0.5, 0.9])
def test_truncated_files_are_noticed(tmp_path, kept):
    path = written(tmp_path, even(0.5, 0.25, 0.1))
    path.write_bytes(path.read_bytes()[: int(kept * path.stat().st_size)])
    assert "cut short" in refusal(path) or "is not a RAW file" in refusal(path)


@pytest.mark.usefixtures("libraw")
def test_the_last_byte_counts(tmp_path):
    path = written(tmp_path, even(0.5, 0.25, 0.1))
    path.write_bytes(path.read_bytes()[:-1])
    assert "cut short" in refusal(path)


@pytest.mark.usefixtures("libraw")
def test_what_is_no_raw_file_is_told(tmp_path):
    (tmp_path / "text.dng").write_text("these are the notes of a photographer\n" * 40)
    assert "is not a RAW file" in refusal(tmp_path / "text.dng")
    write_image(tmp_path / "a.png", np.zeros((16, 16, 3), np.uint8))
    (tmp_path / "a.png").rename(tmp_path / "a.nef")
    assert "is not a RAW file" in refusal(tmp_path / "a.nef")
    (tmp_path / "zeros.cr2").write_bytes(bytes(5000))
    assert "is not a RAW file" in refusal(tmp_path / "zeros.cr2")


@pytest.mark.usefixtures("libraw")
def test_a_header_that_promises_too_much_is_refused(tmp_path):
    path = written(tmp_path, even(0.5, 0.25, 0.1), width=60_000, height=60_000)
    assert "60000 x 60000 pixels, more than the 200,000,000 allowed" in refusal(path)


@pytest.mark.parametrize("orientation", [1, 6])
@pytest.mark.parametrize(
    ("scale", "size"), [([2, 1, 1, 1], (96, 32)), ([2, 1, 3, 1], (48, 48)), ([1, 1, 1, 1], (48, 32))]
)
def test_pixels_that_are_not_square_count_in_the_size(tmp_path, scale, size, orientation):
    path = written(tmp_path, even(0.5, 0.25, 0.1), scale=scale, orientation=orientation)
    width, height = image_size(path)
    assert read_raw(path).shape == (height, width, 3)
    assert (width, height) == (size if orientation == 1 else size[::-1])
    assert f"{width} x {height} pixels, more than" in refusal(path, max_pixels=width * height - 1)
