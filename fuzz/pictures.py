"""Images of all formats, including RAW files, and videos: corrupt headers and pixels, and truncated files."""

from __future__ import annotations

import io
import struct
import tempfile
import zlib
from collections.abc import Iterator
from functools import cache, partial
from pathlib import Path

import numpy as np

from fuzz.mutate import Random, one_of, spoilt
from fuzz.target import Target

MOST = 4_000_000
"""Limit on decoded pixels, so that time and memory of a case depend on the code, not on the image."""

_WORDS = {
    ".png": (b"IHDR", b"IDAT", b"PLTE", b"tRNS", b"eXIf", b"iCCP", b"zTXt", b"acTL", b"IEND", b"\x89PNG\r\n\x1a\n"),
    ".jpg": (
        b"\xff\xd8\xff",
        b"\xff\xc0",
        b"\xff\xc4",
        b"\xff\xdb",
        b"\xff\xda",
        b"\xff\xe1",
        b"Exif\0\0",
        b"\xff\xd9",
    ),
    ".tif": (
        b"II*\0",
        b"MM\0*",
        b"II+\0",
        b"\x00\x01\x03\x00",
        b"\x11\x01\x04\x00",
        b"\x53\x01\x03\x00",
        b"\x05\0",
        b"\x08\0",
    ),
    ".bmp": (b"BM", b"\x28\0\0\0", b"\x7c\0\0\0", b"\x01\0", b"\x08\0", b"\x20\0", b"\x03\0\0\0"),
    ".ppm": (b"P1", b"P2", b"P3", b"P4", b"P5", b"P6", b"#", b"\n", b" 65535 ", b" 255 ", b"7 5", b"99999 99999"),
    ".gif": (b"GIF89a", b"!\xf9\x04", b",\0\0\0\0", b";"),
    ".webp": (b"RIFF", b"VP8 ", b"VP8L", b"VP8X", b"ICCP", b"ANIM"),
    ".jp2": (b"jP  ", b"ihdr", b"colr", b"jp2c", b"\xff\x4f", b"\xff\x51", b"\xff\x52", b"\xff\x90", b"\xff\xd9"),
    ".dng": (b"II*\0", b"\x00\x01\x04\x00", b"\x11\x01\x04\x00", b"\x05\0", b"\x08\0", b"\x0c\0"),
}


def _noise(height: int, width: int, channels: int, dtype: str = "uint8") -> np.ndarray:
    values = np.random.default_rng(1).integers(np.iinfo(dtype).max, size=(height, width, channels), dtype=dtype)
    return values if channels > 1 else values[..., 0]


@cache
def corpus(suffix: str) -> tuple[bytes, ...]:
    """Valid images of a format."""
    makers = {".png": _pngs, ".jpg": _jpegs, ".tif": _tiffs, ".bmp": _bmps, ".ppm": _pnms, ".dng": _dngs}
    makers |= {".gif": _gifs, ".webp": _webps, ".jp2": _jp2s}
    return makers[suffix]()


def _saved(kind: str, images: list, **options) -> tuple[bytes, ...]:
    import io

    files = []
    for image in images:
        buffer = io.BytesIO()
        image.save(buffer, kind, **options)
        files.append(buffer.getvalue())
    return tuple(files)


def _modes(*modes: str) -> list:
    from PIL import Image

    return [Image.fromarray(_noise(9, 13, 3)).convert(mode) for mode in modes]


def _turned() -> bytes:
    from PIL import Image

    exif = Image.Exif()
    exif[0x0112] = 6
    return exif.tobytes()


def _profiles() -> list[bytes]:
    """Colour profiles of sRGB and of another colour space, which Pillow can make."""
    from PIL import ImageCms

    return [ImageCms.ImageCmsProfile(ImageCms.createProfile(name)).tobytes() for name in ("sRGB", "XYZ")]


def _gifs() -> tuple[bytes, ...]:
    return _saved("GIF", _modes("RGB", "L"))


def _webps() -> tuple[bytes, ...]:
    return (*_saved("WEBP", _modes("RGB", "RGBA")), *_saved("WEBP", _modes("RGB"), lossless=True, exif=_turned()))


def _jp2s() -> tuple[bytes, ...]:
    return _saved("JPEG2000", _modes("RGB", "RGBA", "L"))


def _pngs() -> tuple[bytes, ...]:
    import cv2

    deep = cv2.imencode(".png", _noise(7, 5, 3, "uint16"))[1].tobytes()
    plain = _saved("PNG", _modes("RGB", "RGBA", "L", "LA", "P", "1"))
    plain += tuple(file for profile in _profiles() for file in _saved("PNG", _modes("RGB"), icc_profile=profile))
    return (*plain, *_saved("PNG", _modes("RGB"), exif=_turned()), *_saved("PNG", _modes("P"), transparency=3), deep)


def _jpegs() -> tuple[bytes, ...]:
    plain = _saved("JPEG", _modes("RGB", "L", "CMYK"), quality=80)
    plain += tuple(file for profile in _profiles() for file in _saved("JPEG", _modes("RGB"), icc_profile=profile))
    return (*plain, *_saved("JPEG", _modes("RGB"), progressive=True), *_saved("JPEG", _modes("RGB"), exif=_turned()))


def _tiffs() -> tuple[bytes, ...]:
    import cv2

    deep = _noise(7, 5, 3, "uint16"), _noise(7, 5, 1, "uint16"), _noise(7, 5, 3).astype(np.float32)
    packed = [cv2.imencode(".tif", image)[1].tobytes() for image in deep]
    squeezed = [_saved("TIFF", _modes("RGB"), compression=name)[0] for name in ("tiff_lzw", "tiff_deflate", "packbits")]
    return (*_saved("TIFF", _modes("RGB", "RGBA", "L", "P", "1", "CMYK")), *packed, *squeezed, *_tiffs_of_pages())


def _tiffs_of_pages() -> Iterator[bytes]:
    """A picture behind its preview, and colours as ImageJ saves them, a page each."""
    from PIL import Image
    from PIL.TiffImagePlugin import ImageFileDirectory_v2

    picture = Image.fromarray(_noise(6, 8, 3))
    grey = Image.fromarray(_noise(6, 8, 1))
    composite = ImageFileDirectory_v2()
    composite[270] = "ImageJ=1.54f\nimages=3\nchannels=3\nhyperstack=true\nmode=composite\n"
    for first, others, tags in (
        (picture.resize((4, 3)), [picture], ImageFileDirectory_v2()),
        (grey, [grey, grey], composite),
    ):
        buffer = io.BytesIO()
        first.save(buffer, "TIFF", save_all=True, append_images=others, tiffinfo=tags)
        yield buffer.getvalue()


def _bmps() -> tuple[bytes, ...]:
    return _saved("BMP", _modes("RGB", "L", "P", "1"))


def _pnms() -> tuple[bytes, ...]:
    return (
        b"P6\n# made by hand\n3 2\n255\n" + bytes(range(18)),
        b"P6 3 2 65535\n" + bytes(range(36)),
        b"P5 3 2 1000\n" + bytes(range(12)),
        b"P3 2 1 255\n1 2 3 4 5 6\n",
        b"P2 2 1 15\n1 2\n",
        b"P1 3 2\n1 0 1 0 1 0\n",
        b"P4 9 2\n" + bytes(4),
    )


def _dngs() -> tuple[bytes, ...]:
    """Make an uncompressed 16-bit DNG with RGGB cells."""
    pixels = _noise(32, 48, 1, "uint16").astype("<u2").tobytes()
    ones = [1, 1, 0, 1, 0, 1, 0, 1, 1, 1, 0, 1, 0, 1, 0, 1, 1, 1]
    short, long, text, byte, rational, signed = 3, 4, 2, 1, 5, 10
    tags = [
        *((254, long, "<I", [0]), (256, long, "<I", [48]), (257, long, "<I", [32]), (258, short, "<H", [16])),
        *(
            (259, short, "<H", [1]),
            (262, short, "<H", [32803]),
            (271, text, "<B", b"liaam\0"),
            (272, text, "<B", b"x\0"),
        ),
        *((273, long, "<I", [0]), (277, short, "<H", [1]), (278, long, "<I", [32]), (279, long, "<I", [len(pixels)])),
        *((33421, short, "<H", [2, 2]), (33422, byte, "<B", [0, 1, 1, 2]), (50706, byte, "<B", [1, 4, 0, 0])),
        *((50714, long, "<I", [64]), (50717, long, "<I", [65535]), (50721, signed, "<i", ones)),
        (50728, rational, "<I", [1, 2, 1, 1, 3, 5]),
    ]
    at = 8 + 2 + 12 * len(tags) + 4
    fields = [b"".join(struct.pack(form, value) for value in values) for _, _, form, values in tags]
    n_long = sum(len(data) for data in fields if len(data) > 4)
    entries, blob = b"", b""
    for (tag, kind, _, values), data in zip(tags, fields, strict=True):
        data = struct.pack("<I", at + n_long) if tag == 273 else data
        count = len(values) // 2 if kind in (rational, signed) else len(values)
        entries += struct.pack("<HHI", tag, kind, count)
        entries += data.ljust(4, b"\0") if len(data) <= 4 else struct.pack("<I", at + len(blob))
        blob += data if len(data) > 4 else b""
    return (b"II*\0" + struct.pack("<IH", 8, len(tags)) + entries + bytes(4) + blob + pixels,)


def make(suffix: str, rng: Random) -> bytes:
    """Corrupt an image. A PNG keeps valid checksums, so that decoders read past them."""
    data = spoilt(rng, corpus(suffix), _WORDS[suffix])
    return _with_sums(data) if suffix == ".png" and rng.random() < 0.7 else data


def _with_sums(data: bytes) -> bytes:
    """Recompute the checksums of a PNG's chunks."""
    whole, at = data[:8], 8
    while at + 12 <= len(data):
        size = int.from_bytes(data[at : at + 4], "big")
        if at + 12 + size > len(data):
            break
        chunk = data[at + 4 : at + 8 + size]
        whole += data[at : at + 4] + chunk + struct.pack(">I", zlib.crc32(chunk))
        at += 12 + size
    return whole + data[at:]


def check(data: bytes) -> None:
    """Decode it. The image must have the size in its header."""
    from liaam.io import decode_image, image_size

    image = decode_image(data, "x", MOST)
    assert image.dtype in (np.uint8, np.uint16, np.float32)
    assert image.shape == (*image_size(data, "x")[::-1], 3)


def check_file(suffix: str, data: bytes) -> None:
    """Read it from a file, also as a preview."""
    from liaam.io import image_size, read_image, read_preview

    path = Path(f"x{suffix}")
    path.write_bytes(data)
    width, height = image_size(path)
    assert read_image(path, MOST).shape == (height, width, 3)
    read_preview(path, 4, MOST)


def _prepare(suffix: str) -> None:
    for data in corpus(suffix):
        check(data)


def _prepare_file(suffix: str) -> None:
    for data in corpus(suffix):
        check_file(suffix, data)


# Videos -------------------------------------------------------------------------------------------

_VIDEO_WORDS = (
    b"moov",
    b"mdat",
    b"stco",
    b"stsz",
    b"stts",
    b"trak",
    b"elst",
    b"ftyp",
    b"RIFF",
    b"idx1",
    b"\x1aE\xdf\xa3",
)


@cache
def videos() -> tuple[bytes, ...]:
    """Valid videos of three frames."""
    from liaam.io import video_writer

    files = []
    with tempfile.TemporaryDirectory() as folder:
        for suffix in (".mp4", ".avi", ".mkv"):
            path = Path(folder) / f"x{suffix}"
            with video_writer(path) as video:
                for i in range(3):
                    video.write(np.roll(_noise(32, 48, 3), i, axis=1))
            files.append(path.read_bytes())
    return tuple(files)


def make_video(rng: Random) -> bytes:
    """Corrupt a video."""
    return spoilt(rng, videos(), _VIDEO_WORDS)


def check_video(data: bytes) -> None:
    """Read its first frames, or later ones."""
    from liaam.io import VideoReader

    path = Path("x.mp4")
    path.write_bytes(data)
    with VideoReader(path, len(data) % 2, 4) as frames:
        for frame in frames:
            assert frame.image.dtype == np.uint8 and frame.image.shape[2] == 3


def _prepare_videos() -> None:
    for data in videos():
        check_video(data)


def make_file(rng: Random) -> bytes:
    """Corrupt an image of any format."""
    return make(one_of(rng, [suffix for suffix in _WORDS if suffix != ".dng"]), rng)


def _targets() -> tuple[Target, ...]:
    formats = [
        Target(f"pictures{suffix}", partial(make, suffix), check, partial(_prepare, suffix), suffix, share=0.7)
        for suffix in _WORDS
        if suffix != ".dng"
    ]
    return (
        *formats,
        Target("picture-files", make_file, partial(check_file, ".png"), partial(_prepare_file, ".png"), ".png", 0.5),
        Target("raw", partial(make, ".dng"), partial(check_file, ".dng"), partial(_prepare_file, ".dng"), ".dng", 0.2),
        Target("videos", make_video, check_video, _prepare_videos, ".mp4", 0.1),
    )


TARGETS = _targets()
