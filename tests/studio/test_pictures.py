"""Pictures for the page: size and place of their pixels, chroma, and what is kept."""

import io
import struct
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from liaam.errors import ImageError
from liaam.io import decode_image, write_image
from liaam.photometry import CameraModel, invariant_image
from liaam.photometry.encoding import usable_range
from liaam.studio import pictures as shown_pictures
from liaam.studio.pictures import (
    CHROMA_MASKED,
    CHROMA_STEP,
    Kept,
    Pictures,
    Room,
    Uploads,
    block_size,
    chroma,
    chroma_bytes,
    fitted_size,
    jpeg_bytes,
    png_bytes,
    shown,
    source_of,
)
from liaam.studio.refusal import Refusal
from liaam.studio.routes import checked_size

LIMIT = 50_000_000


def colours(rng: np.random.Generator, height: int, width: int) -> np.ndarray:
    return rng.integers(20, 240, (height, width, 3)).astype(np.uint8)


def smooth(height: int, width: int) -> np.ndarray:
    """Picture whose channels grow across and down."""
    y, x = np.mgrid[:height, :width]
    return np.dstack([40 + 150 * x / width, 60 + 120 * y / height, np.full((height, width), 90.0)]).astype(np.uint8)


class TestKept:
    def test_forgets_what_was_not_asked_for_longest(self):
        kept = Kept(10, len)
        for letter in "abc":
            kept.get(letter, lambda letter=letter: letter * 4)
            kept.get("a", lambda: pytest.fail("it is kept"))
        assert (len(kept), kept.weight) == (2, 8)
        assert (kept.peek("a"), kept.peek("b"), kept.peek("c")) == ("aaaa", None, "cccc")

    def test_never_weighs_more_than_its_limit(self, rng):
        kept = Kept(1000, len)
        for size in rng.integers(0, 1500, 200):
            assert len(kept.get(int(size), lambda size=size: b"x" * size)) == size
            assert kept.weight <= 1000
        assert kept.weight > 0

    def test_gives_but_does_not_keep_what_is_too_heavy(self):
        kept = Kept(3, len)
        kept.put("small", "ab")
        assert kept.get("large", lambda: "abcdef") == "abcdef"
        assert (kept.peek("large"), kept.peek("small")) == (None, "ab")

    def test_makes_a_value_once_for_all_who_wait(self):
        kept, calls, all_wait = Kept(10), [], threading.Event()

        def make():
            calls.append(1)
            assert all_wait.wait(60)
            return object()

        with ThreadPoolExecutor(10) as pool:
            futures = [pool.submit(kept.get, "key", make) for _ in range(10)]
            all_wait.set()
            values = {id(future.result()) for future in futures}
        assert (len(values), len(calls)) == (1, 1)

    def test_tells_all_who_wait_of_a_fault_and_then_tries_again(self):
        kept, calls, go = Kept(10), [], threading.Event()

        def fail():
            calls.append(1)
            assert go.wait(60)
            raise ImageError("broken")

        with ThreadPoolExecutor(4) as pool:
            futures = [pool.submit(kept.get, "key", fail) for _ in range(4)]
            go.set()
            for future in futures:
                with pytest.raises(ImageError, match="broken"):
                    future.result()
        assert kept.get("key", lambda: "whole") == "whole"


class TestShown:
    @pytest.mark.parametrize(
        ("width", "height", "size"), [(640, 480, 320), (101, 67, 50), (30, 2000, 160), (64, 48, 900)]
    )
    def test_has_the_size_asked_for_and_is_never_enlarged(self, rng, width, height, size):
        to = fitted_size(width, height, size)
        assert max(to) == min(size, max(width, height))
        assert abs(to[0] / to[1] / (width / height) - 1) <= 1 / min(to)
        assert shown(colours(rng, height, width), to).shape == (to[1], to[0], 3)

    def test_keeps_the_centres_of_pixels(self):
        """A ramp says where each pixel of the small picture looks at: (x + 0.5) * scale - 0.5."""
        ramp = np.repeat(np.linspace(0, 1, 320, dtype=np.float32)[None, :, None], 240, axis=0).repeat(3, axis=2)
        small = shown((ramp * 65535).astype(np.uint16), (80, 60))
        expected = ((np.arange(80) + 0.5) * 4 - 0.5) / 319 * 255
        assert np.abs(small[30, :, 0] - expected).max() <= 1.0

    @pytest.mark.parametrize("kind", ["uint8", "uint16", "float32"])
    def test_looks_alike_whatever_the_depth(self, kind):
        eight = smooth(40, 60)
        image = {"uint8": eight, "uint16": eight.astype(np.uint16) * 257, "float32": (eight / 255).astype(np.float32)}[
            kind
        ]
        assert np.abs(shown(image, (30, 20)).astype(int) - shown(eight, (30, 20))).max() <= 1

    def test_shows_nan_as_black(self):
        image = np.full((20, 20, 3), np.nan, np.float32)
        assert not shown(image, (10, 10)).any()

    def test_shows_linear_light_as_screens_want_it(self):
        grey = np.full((16, 16, 3), 0.2140411, np.float32)  # half of what sRGB stores
        assert np.abs(shown((grey * 65535).astype(np.uint16), (8, 8), raw=True).astype(int) - 128).max() <= 1

    def test_jpeg_keeps_the_resolution_of_colours(self):
        stripes = np.zeros((32, 32, 3), np.uint8)
        stripes[:, ::2], stripes[:, 1::2] = (200, 40, 40), (40, 40, 200)
        seen = decode_image(jpeg_bytes(stripes)).astype(int)
        assert np.abs(seen - stripes).mean() < 8  # with halved colours, all stripes are violet

    def test_png_keeps_colours_and_transparency(self, rng):
        from PIL import Image

        image = rng.integers(0, 256, (9, 7, 4)).astype(np.uint8)
        assert np.array_equal(np.array(Image.open(io.BytesIO(png_bytes(image)))), image)

    def test_asks_for_sizes_that_make_sense(self):
        assert checked_size(None, 640) == 640
        assert (checked_size("320", 640), checked_size("1", 640), checked_size("999999", 640)) == (320, 16, 16384)
        for text in ("", "-1", "1e3", "12.5", "٣", "9" * 30):
            with pytest.raises(Refusal, match="whole number") as refused:
                checked_size(text, 640)
            assert refused.value.status == 422


class TestPictures:
    def test_does_not_depend_on_what_is_kept(self, tmp_path):
        write_image(tmp_path / "a.jpg", smooth(480, 640))
        source = source_of(tmp_path / "a.jpg", LIMIT)
        fresh, used = Pictures(), Pictures()
        used.pixels(source)
        for size in (64, 160, 320, 639, 2048):
            assert fresh.image(source, size) == used.image(source, size)

    def test_reduced_decoding_shows_the_same_picture(self, tmp_path):
        write_image(tmp_path / "a.jpg", smooth(603, 997))
        source = source_of(tmp_path / "a.jpg", LIMIT)
        seen = decode_image(Pictures().image(source, 160)).astype(int)
        assert seen.shape == (97, 160, 3)
        assert np.abs(seen - shown(smooth(603, 997), (160, 97))).max() <= 6

    def test_turns_thumbnails_as_pictures(self, tmp_path):
        from PIL import Image

        exif = Image.Exif()
        exif[0x0112] = 6
        Image.fromarray(smooth(480, 640)).save(tmp_path / "a.jpg", exif=exif, quality=95)
        source = source_of(tmp_path / "a.jpg", LIMIT)
        assert source.size == (480, 640)
        upright = np.rot90(smooth(480, 640), -1)
        seen = decode_image(Pictures().image(source, 160)).astype(int)
        assert seen.shape == (160, 120, 3)
        assert np.abs(seen - shown(np.ascontiguousarray(upright), (120, 160))).max() <= 8

    def test_decodes_once_for_ten_who_ask(self, tmp_path, monkeypatch):
        calls = []
        read = shown_pictures.read_image
        monkeypatch.setattr(shown_pictures, "read_image", lambda *given: calls.append(1) or read(*given))
        write_image(tmp_path / "a.png", smooth(60, 80))
        source, pictures = source_of(tmp_path / "a.png", LIMIT), Pictures()
        with ThreadPoolExecutor(10) as pool:
            seen = list(pool.map(lambda _: pictures.chroma(source, 640, "srgb"), range(10)))
            looks = list(pool.map(lambda size: pictures.image(source, size), [48, 60, 70, 80, 90] * 2))
        assert len(calls) == 1
        assert len(set(seen)) == 1
        assert looks[:5] == looks[5:]

    def test_keeps_decoded_pictures_within_its_bytes(self, tmp_path):
        pictures = Pictures(decoded=3 * 60 * 80 * 3)
        for name in "abcdefg":
            write_image(tmp_path / f"{name}.png", smooth(60, 80))
            pictures.pixels(source_of(tmp_path / f"{name}.png", LIMIT))
        assert (len(pictures._decoded), pictures._decoded.weight) == (3, 3 * 60 * 80 * 3)

    def test_a_changed_file_is_another_picture(self, tmp_path):
        path, pictures = tmp_path / "a.png", Pictures()
        write_image(path, smooth(60, 80))
        before = source_of(path, LIMIT)
        write_image(path, smooth(60, 90))
        after = source_of(path, LIMIT)
        assert before.tag != after.tag
        assert pictures.pixels(after).shape == (60, 90, 3)
        with pytest.raises(Refusal, match=r"a\.png has changed") as refused:
            pictures.pixels(before)
        assert refused.value.status == 409

    def test_faults_name_the_file_without_its_folder(self, tmp_path):
        (tmp_path / "a.png").write_bytes(b"no image")
        with pytest.raises(ImageError) as fault:
            source_of(tmp_path / "a.png", LIMIT)
        assert str(fault.value).startswith("a.png is not a PNG")
        with pytest.raises(ImageError, match=r"gone\.png cannot be read"):
            source_of(tmp_path / "gone.png", LIMIT)


class TestChroma:
    @pytest.mark.parametrize("response", ["srgb", "linear", 1.8])
    def test_is_the_invariant_image_of_every_angle(self, rng, response):
        image = colours(rng, 30, 41)
        image[:4] = 0  # dark in every response
        image[4:8, :, 1] = 254  # saturated
        numbers = chroma(image, 640, response)
        masked = (numbers == CHROMA_MASKED).all(axis=2)
        for theta in (0.0, 1.1, 2.13, 3.0):
            expected = invariant_image(image, CameraModel(theta, response=response))
            seen = numbers @ np.array([np.cos(theta), np.sin(theta)]) * CHROMA_STEP
            assert np.array_equal(masked, np.isnan(expected))
            assert np.abs(seen - expected)[~masked].max() <= CHROMA_STEP * np.sqrt(0.5) + 1e-5
        assert masked[:8].all()
        assert 0.5 < (~masked).mean() < 1

    def test_averages_light_before_the_logarithm(self):
        image = np.zeros((4 * 8, 4 * 8, 3), np.uint8)
        image[:] = 100
        image[::2, :, 0] = 200
        numbers = chroma(image, 8, "linear")
        assert numbers.shape == (8, 8, 2)
        assert np.allclose(numbers[..., 0] * CHROMA_STEP, np.log(1.5), atol=2 * CHROMA_STEP)
        assert not numbers[..., 1].any()

    def test_a_block_with_one_dark_pixel_is_masked(self):
        image = smooth(32, 32)
        image[9, 13] = 0
        numbers = chroma(image, 8)
        masked = (numbers == CHROMA_MASKED).all(axis=2)
        assert np.argwhere(masked).tolist() == [[2, 3]]

    @pytest.mark.parametrize(
        ("width", "height"), [(640, 480), (6000, 4000), (4000, 2661), (997, 603), (480, 6000), (641, 640)]
    )
    def test_blocks_fill_the_picture(self, width, height):
        block = block_size(width, height, 640)
        columns, rows = int(width / block + 1e-6), int(height / block + 1e-6)
        assert 0.9 * min(640, max(width, height)) - 1 <= max(columns, rows) <= 640
        assert abs(columns * block - width) <= 0.1 * block
        assert abs(rows * block - height) <= 0.1 * block

    def test_goes_to_the_page_as_little_endian_numbers(self):
        data = chroma_bytes(smooth(20, 30), 640)
        width, height, *covered = struct.unpack_from("<IIff", data)
        assert (width, height, covered) == (30, 20, [30, 20])
        numbers = np.frombuffer(data, "<i2", offset=16).reshape(height, width, 2)
        assert np.array_equal(numbers, chroma(smooth(20, 30), 640))

    @pytest.mark.parametrize(("width", "height", "size"), [(2000, 8, 640), (1001, 97, 100), (97, 1001, 100)])
    def test_says_how_much_of_the_picture_it_covers(self, width, height, size):
        image = np.full((height, width, 3), (200, 120, 60), np.uint8)
        data = chroma_bytes(image, size)
        columns, rows, right, lower = struct.unpack_from("<IIff", data)
        block = block_size(width, height, size)
        assert (right, lower) == pytest.approx((columns * block, rows * block), rel=1e-6)
        assert width - block < right <= width and height - block < lower <= height
        # What lies beyond has no say.
        image[int(np.ceil(lower)) :], image[:, int(np.ceil(right)) :] = 10, 250
        assert chroma_bytes(image, size) == data

    @pytest.mark.parametrize("response", ["srgb", "linear", 5.0])
    def test_the_largest_ratio_of_usable_light_fits(self, response):
        low, high = usable_range(response)
        numbers = chroma(np.full((8, 8, 3), [0.999 * high, 0.999 * high, 1.001 * low], np.float32), 640, response)
        assert (numbers * CHROMA_STEP).min() == pytest.approx(np.log(0.961 / 0.00228), abs=0.05)

    @pytest.mark.parametrize("value", [0, 128, 255])
    def test_a_grey_picture_has_none(self, value):
        with pytest.raises(ImageError, match=r"a\.png: the image is grey"):
            chroma(np.full((20, 20, 3), value, np.uint8), 640, name="a.png")

    def test_a_picture_of_holes_is_masked_all_over(self):
        assert (chroma(np.full((20, 20, 3), np.nan, np.float32), 640) == CHROMA_MASKED).all()


class TestRoom:
    def test_who_wants_more_than_is_left_waits(self):
        room, most, now, lock = Room(10), [0], [0], threading.Lock()

        def take(n: int) -> None:
            with room.of(n):
                with lock:
                    now[0] += min(n, 10)
                    most[0] = max(most[0], now[0])
                time.sleep(0.002)
                with lock:
                    now[0] -= min(n, 10)

        with ThreadPoolExecutor(8) as pool:
            list(pool.map(take, [6, 4, 99, 5, 5, 10, 1, 3] * 4))
        assert 5 < most[0] <= 10 and room.left == 10

    def test_it_is_given_back_after_a_fault(self):
        room = Room(10)
        with pytest.raises(ImageError), room.of(7):
            raise ImageError("damaged")
        assert room.left == 10

    def test_dropped_and_other_pictures_are_decoded_in_the_same_room(self):
        pictures = Pictures()
        pictures.room = Room(1)
        with ThreadPoolExecutor(1) as pool:
            with pictures.room.of(1):
                adding = pool.submit(Uploads(pictures).add, png_bytes(smooth(20, 30)), "a.png")
                with pytest.raises(TimeoutError):
                    adding.result(0.2)
            assert adding.result(60).width == 30
