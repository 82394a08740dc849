"""Large pictures: tiles of all levels, work on a half, and strips of images in any orientation."""

from io import BytesIO

import cv2
import numpy as np
import pytest
from PIL import Image

from liaam.io import read_image, read_strips, write_image
from liaam.studio import pictures as module
from liaam.studio.pictures import Pictures, Uploads, read_for_work, source_of, work_size
from liaam.studio.refusal import Refusal
from liaam.studio.tiles import Tiles, size_at


def smooth(rng: np.random.Generator, width: int, height: int) -> np.ndarray:
    small = rng.integers(0, 256, (height // 40, width // 40, 3), dtype=np.uint8)
    return cv2.resize(small, (width, height), interpolation=cv2.INTER_CUBIC)


def decoded(data: bytes) -> np.ndarray:
    return np.asarray(Image.open(BytesIO(data)))


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
def test_tiles_of_each_level_make_the_picture(tmp_path, rng, suffix):
    path = tmp_path / f"wing{suffix}"
    image = smooth(rng, 1300, 700)
    write_image(path, image)
    source = source_of(path, 10**9)
    tiles = Tiles(Pictures())
    for level in (0, 1, 2):
        width, height = size_at(source, level)
        rows = [
            np.hstack([decoded(tiles.get(source, level, column, row)) for column in range(-(-width // 512))])
            for row in range(-(-height // 512))
        ]
        whole = np.vstack(rows)
        assert whole.shape == (height, width, 3)
        expected = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)
        assert np.abs(whole.astype(float) - expected).mean() < 2.5  # two JPEG encodings


def test_tiles_that_are_not_there_are_refused(tmp_path, rng):
    path = tmp_path / "wing.png"
    write_image(path, smooth(rng, 600, 400))
    source = source_of(path, 10**9)
    tiles = Tiles(Pictures())
    for level, column, row in ((0, 2, 0), (0, 0, 1), (40, 0, 0), (-1, 0, 0)):
        with pytest.raises(Refusal) as caught:
            tiles.get(source, level, column, row)
        assert caught.value.status == 404


@pytest.mark.parametrize("orientation", range(1, 9))
def test_strips_are_those_of_the_upright_image(tmp_path, rng, orientation):
    path = tmp_path / "turned.png"
    exif = Image.Exif()
    exif[0x0112] = orientation
    Image.fromarray(rng.integers(0, 256, (70, 50, 3), dtype=np.uint8)).save(path, exif=exif)
    strips = list(read_strips(path, rows=16))
    assert [len(strip) for strip in strips[:-1]] == [16] * (len(strips) - 1)
    assert np.array_equal(np.vstack(strips), read_image(path))


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_strips_of_deep_images_are_the_same_values(tmp_path, rng, dtype):
    path = tmp_path / "deep.tif"
    write_image(path, rng.integers(0, 255, (40, 30, 3)).astype(dtype))
    assert np.array_equal(np.vstack(list(read_strips(path, rows=7))), read_image(path))


def test_large_pictures_are_worked_on_at_half_their_size(tmp_path, rng, monkeypatch):
    monkeypatch.setattr(module, "LARGE", 300_000)
    path = tmp_path / "wing.jpg"
    write_image(path, smooth(rng, 1001, 700))
    source = source_of(path, 10**9)
    assert source.size == (1001, 700) and source.work_size == (500, 350) == work_size(1001, 700)
    assert Pictures().pixels(source).shape == (350, 500, 3)
    assert read_for_work(path).shape == (350, 500, 3)
    header = np.frombuffer(Pictures().chroma(source, 200, "srgb")[8:16], np.float32)
    assert header[0] == pytest.approx(1001, rel=0.03)  # in pixels of the picture


def test_dropped_pictures_have_tiles_too(tmp_path, rng):
    path = tmp_path / "wing.jpg"
    write_image(path, smooth(rng, 1300, 700))
    pictures = Pictures()
    uploads = Uploads(pictures)
    source = uploads.source(uploads.add(path.read_bytes(), "wing.jpg").id)
    of_file = Tiles(pictures).get(source_of(path, 10**9), 0, 1, 1)
    assert Tiles(pictures).get(source, 0, 1, 1) == of_file
    assert np.array_equal(np.vstack(list(read_strips(path.read_bytes(), rows=100))), read_image(path))
