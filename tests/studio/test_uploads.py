"""Dropped pictures: what is taken, and a defined answer for everything else."""

import asyncio
import io
import struct
import zlib
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import cv2
import numpy as np
import pytest
from PIL import Image

from liaam.studio.folder import plain_name
from liaam.studio.pictures import Pictures, Uploads
from liaam.studio.refusal import Refusal
from liaam.studio.routes import read_json
from liaam.studio.settings import StudioSettings


def colours(height: int = 24, width: int = 32) -> np.ndarray:
    y, x = np.mgrid[:height, :width]
    return np.dstack([8 * x % 256, 8 * y % 256, 100 + 0 * x]).astype(np.uint8)


def file_of(image: Image.Image, kind: str, **options) -> bytes:
    buffer = io.BytesIO()
    image.save(buffer, kind, **options)
    return buffer.getvalue()


def deep(image: np.ndarray, suffix: str) -> bytes:
    return cv2.imencode(suffix, image[..., ::-1])[1].tobytes()


def bomb(width: int, height: int) -> bytes:
    """PNG whose header promises many pixels, in few bytes."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return (
        b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(b"\0" * 100)) + chunk(b"IEND", b"")
    )


@pytest.fixture
def uploads() -> Uploads:
    return Uploads(Pictures())


PNG = file_of(Image.fromarray(colours()), "PNG")
EXIF = Image.Exif()
EXIF[0x0112] = 8


class TestTaken:
    @pytest.mark.parametrize(
        ("data", "kind"),
        [
            (PNG, np.uint8),
            (file_of(Image.fromarray(colours()), "JPEG"), np.uint8),
            (file_of(Image.fromarray(colours()).convert("CMYK"), "JPEG"), np.uint8),
            (file_of(Image.fromarray(colours()).convert("L"), "PNG"), np.uint8),
            (file_of(Image.fromarray(colours()).convert("P"), "PNG"), np.uint8),
            (file_of(Image.fromarray(colours()).convert("RGBA"), "PNG"), np.uint8),
            (deep(colours().astype(np.uint16) * 257, ".png"), np.uint16),
            (deep((colours() / 255).astype(np.float32), ".tiff"), np.float32),
            (b"P5 32 24 255\n" + colours()[..., 0].tobytes(), np.uint8),
        ],
        ids=["png", "jpeg", "cmyk", "grey", "palette", "alpha", "16 bits", "float", "pgm"],
    )
    def test_pictures_of_all_kinds(self, uploads, data, kind):
        upload = uploads.add(data, "photo.bin")
        source = uploads.source(upload.id)
        assert (upload.name, upload.width, upload.height) == ("photo.bin", 32, 24)
        pixels = uploads._pictures.pixels(source)
        assert (pixels.shape, pixels.dtype) == ((24, 32, 3), kind)

    def test_a_picture_turned_by_exif_is_upright(self, uploads):
        upload = uploads.add(file_of(Image.fromarray(colours()), "PNG", exif=EXIF), "a.png")
        assert (upload.width, upload.height) == (24, 32)
        pixels = uploads._pictures.pixels(uploads.source(upload.id))
        assert np.array_equal(pixels, np.rot90(colours()))

    def test_the_newest_few_are_kept(self):
        uploads = Uploads(Pictures(), StudioSettings(uploads_kept=3))
        added = [uploads.add(PNG, f"{i}.png") for i in range(5)]
        assert len(uploads._uploads) == 3
        assert [uploads.get(upload.id).name for upload in added[2:]] == ["2.png", "3.png", "4.png"]
        for upload in added[:2]:
            with pytest.raises(Refusal, match="only the 3 last used are kept: drop it again") as refused:
                uploads.source(upload.id)
            assert refused.value.status == 404

    def test_so_many_bytes_are_kept_and_the_newest_in_any_case(self):
        uploads = Uploads(Pictures(), StudioSettings(uploads_bytes=2 * len(PNG)))
        added = [uploads.add(PNG, f"{i}.png") for i in range(2)]
        assert len(uploads._uploads) == 2
        uploads.add(PNG, "2.png")
        assert len(uploads._uploads) == 2
        with pytest.raises(Refusal):
            uploads.get(added[0].id)
        small = Uploads(Pictures(), StudioSettings(uploads_bytes=1))
        assert small.get(small.add(PNG, "a.png").id).data == PNG
        last = small.add(PNG, "b.png")
        assert len(small._uploads) == 1 and small.get(last.id).name == "b.png"

    def test_pictures_at_the_limits(self):
        uploads = Uploads(Pictures(), StudioSettings(pixels=24 * 32, upload_bytes=len(PNG)))
        assert uploads.add(PNG, "a.png").width == 32
        with pytest.raises(Refusal, match=f"a.png has {len(PNG) + 1:,} bytes, more than {len(PNG):,}: make it smaller"):
            uploads.add(PNG + b"x", "a.png")

    def test_is_a_source_without_its_folder(self, uploads):
        upload = uploads.add(PNG, "folder/a.png")
        source = uploads.source(upload.id)
        assert (source.name, source.tag) == ("a.png", f"upload-{upload.id}")
        assert source.size == (32, 24)
        assert len(upload.id) >= 12

    def test_a_picture_can_be_decoded_again_while_it_is_kept(self):
        uploads = Uploads(Pictures(decoded=24 * 32 * 3), StudioSettings(uploads_kept=2))
        first = uploads.source(uploads.add(PNG, "a.png").id)
        uploads.add(PNG, "b.png")  # pushes the first one's pixels out
        assert np.array_equal(uploads._pictures.pixels(first), colours())
        uploads.add(PNG, "c.png")  # takes the place of b.png, which nobody has asked for
        assert np.array_equal(uploads._pictures.pixels(first), colours())
        for name in ("d.png", "e.png"):  # and these two that of the first
            uploads.add(PNG, name)
        with pytest.raises(Refusal, match="drop it again"):
            uploads._pictures.pixels(first)

    def test_from_many_threads(self):
        uploads = Uploads(Pictures(), StudioSettings(uploads_kept=6))
        with ThreadPoolExecutor(10) as pool:
            added = list(pool.map(lambda i: uploads.add(PNG, f"{i}.png"), range(40)))
        assert len(uploads._uploads) == 6
        assert len({upload.id for upload in added}) == 40

    def test_nothing_is_written_to_disk(self, uploads, tmp_path, monkeypatch):
        monkeypatch.chdir(tmp_path)
        uploads.add(PNG, "../../a.png")
        assert list(tmp_path.iterdir()) == []


class TestRefused:
    @pytest.mark.parametrize(
        ("data", "name", "status", "text"),
        [
            (b"", "a.png", 422, "a.png is empty"),
            (b"\0" * 5000, "a.png", 415, "a.png is not a PNG"),
            (b"<svg xmlns='http://www.w3.org/2000/svg'/>", "a.svg", 415, "a.svg is not a PNG"),
            (b"GIF89a" + b"\0" * 100, "a.gif", 422, "a.gif is damaged"),
            (PNG, "a.NEF", 415, "RAW file"),
            (PNG[: len(PNG) // 2], "a.png", 422, "a.png is cut short"),
            (PNG[:12], "a.png", 422, "a.png is damaged"),
            (file_of(Image.fromarray(colours()), "JPEG")[:300], "a.jpg", 422, "a.jpg is damaged"),
            (bomb(30_000, 30_000), "a.png", 413, "30000 x 30000 pixels"),
            (bomb(2**31 - 1, 2**31 - 1), "a.png", 413, "pixels"),
            (bomb(0, 7), "a.png", 422, "damaged"),
            (bomb(640, 480), "a.png", 422, "a.png is damaged"),
            (b"P6 99999 99999 255\n", "a.ppm", 413, "99999 x 99999"),
            (b"II*\0" + b"\xff" * 60, "a.tif", 422, "a.tif is damaged"),
            (file_of(Image.fromarray(colours(5, 5)), "PNG"), "a.png", 422, "too small"),
        ],
        ids=[
            "empty",
            "zeros",
            "svg",
            "gif",
            "raw",
            "cut short",
            "header only",
            "half a jpeg",
            "bomb",
            "largest bomb",
            "no width",
            "no pixels",
            "ppm bomb",
            "tiff",
            "too small",
        ],
    )
    def test_with_a_status_and_the_reason(self, uploads, data, name, status, text):
        with pytest.raises(Refusal, match=text) as refused:
            uploads.add(data, name)
        assert refused.value.status == status
        assert len(uploads._uploads) == 0

    def test_what_has_more_pixels_than_allowed(self):
        uploads = Uploads(Pictures(), StudioSettings(pixels=24 * 32 - 1))
        with pytest.raises(Refusal, match="32 x 24 pixels, more than 767") as refused:
            uploads.add(PNG, "a.png")
        assert refused.value.status == 413

    def test_what_has_more_bytes_than_allowed(self):
        with pytest.raises(Refusal, match="more than 20") as refused:
            Uploads(Pictures(), StudioSettings(upload_bytes=20)).add(PNG, "a.png")
        assert refused.value.status == 413

    def test_a_thousand_damaged_files_raise_nothing_else(self, rng):
        uploads = Uploads(Pictures(), replace(StudioSettings(), pixels=100_000))
        files = [
            PNG,
            file_of(Image.fromarray(colours()), "JPEG"),
            deep(colours().astype(np.uint16), ".tiff"),
            file_of(Image.fromarray(colours()), "BMP"),
            b"P6 32 24 255\n" + colours().tobytes(),
        ]
        refused = 0
        for i in range(1000):
            data = bytearray(files[i % len(files)])
            for at in rng.integers(0, min(len(data), 200), rng.integers(1, 6)):
                data[at] = rng.integers(0, 256)
            try:
                uploads.add(bytes(data), "a.png")
            except Refusal as fault:
                assert fault.status in (413, 415, 422)
                refused += 1
        assert 100 < refused < 1000


@pytest.mark.parametrize(
    ("given", "plain"),
    [
        ("a.png", "a.png"),
        ("../../etc/passwd", "passwd"),
        ("C:\\Users\\me\\Bild ä.jpg", "Bild ä.jpg"),
        ("", "picture"),
        ("\r\n\0", "picture"),
        ("a\r\nSet-Cookie: x.png", "a  Set-Cookie: x.png"),
        ("x" * 500 + ".png", "x" * 116 + ".png"),
    ],
)
def test_names_are_plain(given, plain):
    assert plain_name(given) == plain


class Request:
    """As much of a request as is read."""

    def __init__(self, *parts: bytes, kind: str = "application/json") -> None:
        self.parts = parts
        self.headers = {"content-type": kind}

    async def body(self):
        return b"".join(self.parts)


class TestBodies:
    def test_json(self):
        assert asyncio.run(read_json(Request(b'{"a":', b"[1]}"))) == {"a": [1]}  # type: ignore[arg-type]

    @pytest.mark.parametrize("body", [b"", b"{", b'{"a": NaN}', b"[" * 100_000, b"\xff\xfe", b"Infinity"])
    def test_what_is_no_json(self, body):
        with pytest.raises(Refusal, match="not JSON") as refused:
            asyncio.run(read_json(Request(body)))  # type: ignore[arg-type]
        assert refused.value.status == 400

    @pytest.mark.parametrize("kind", ["", "text/plain", "multipart/form-data; boundary=x"])
    def test_json_of_another_type(self, kind):
        with pytest.raises(Refusal, match="send application/json") as refused:
            asyncio.run(read_json(Request(b"{}", kind=kind)))  # type: ignore[arg-type]
        assert refused.value.status == 415

    def test_the_type_may_have_a_charset_and_capitals(self):
        asked = Request(b"[1]", kind=" Application/JSON ; charset=utf-8")
        assert asyncio.run(read_json(asked)) == [1]  # type: ignore[arg-type]

    def test_messages_are_short(self):
        with pytest.raises(Refusal) as refused:
            asyncio.run(read_json(Request(b"{}", kind="x" * 60)))  # type: ignore[arg-type]
        assert str(refused.value) == f"the request is of type '{'x' * 50}': send application/json"
        with pytest.raises(Refusal) as refused:
            asyncio.run(read_json(Request(b'"' + b"\\ud800" * 60 + b'"')))  # type: ignore[arg-type]
        reason = str(refused.value).removeprefix("the request is not JSON (").removesuffix(")")
        assert len(reason) <= 100 and "surrogates" in reason

    def test_a_request_that_tells_no_type_is_refused(self):
        asked = Request(b"{}")
        asked.headers = {}
        with pytest.raises(Refusal, match="the request is of type ''"):
            asyncio.run(read_json(asked))  # type: ignore[arg-type]

    def test_escapes_are_read(self):
        assert asyncio.run(read_json(Request(b'"\\u00e9\\ud83d\\ude00"'))) == "\u00e9\U0001f600"  # type: ignore[arg-type]
