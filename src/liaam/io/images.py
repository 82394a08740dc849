"""Read and write still images as RGB arrays with their stored values.

Pillow decodes files with 8 bits per channel and detects truncated ones. OpenCV decodes 16-bit and float files, which
Pillow would reduce to 8 bits. The size in the header is checked before decoding. The format is recognised by content,
not by suffix, except for RAW files (:mod:`liaam.io.raw`).
"""

import io
import os
import re
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from liaam.errors import ImageError, installing
from liaam.io.atomic import write_bytes_atomically
from liaam.io.files import MAX_PIXELS, as_three_channels, check_size, existing_file, read_bytes
from liaam.io.raw import RAW_SUFFIXES, is_raw, raw_size, read_raw

IMAGE_SUFFIXES = (".png", ".tif", ".tiff", ".bmp", ".ppm", ".pgm", ".pnm", ".jpg", ".jpeg")
"""Suffixes (lower case) of the image files that can be read and written, lossless ones first."""

_PILLOW_SUFFIXES = (".jfif", ".jpe", ".webp", ".avif", ".heic", ".heif", ".gif")
"""Suffixes of the image files that can only be read."""

PICTURE_SUFFIXES = (*IMAGE_SUFFIXES, *_PILLOW_SUFFIXES, *RAW_SUFFIXES)
"""Suffixes of image files in order of preference, for images that a camera wrote as both RAW and JPEG."""

UNREAD_SUFFIXES = (".jxl", ".svg", ".psd", ".jp2", ".exr")
"""Suffixes of images that are not supported, to name them in messages."""

_VIDEOS = (".mp4", ".m4v", ".mov", ".mkv", ".avi", ".webm")

_MAX_BYTES = 4_000_000_000
_SIGNATURES = (
    (b"\x89PNG\r\n\x1a\n", "PNG"),
    (b"\xff\xd8\xff", "JPEG"),
    (b"II*\0", "TIFF"),
    (b"MM\0*", "TIFF"),
    (b"II+\0", "TIFF"),  # BigTIFF; Pillow cannot read that of the other byte order
    (b"BM", "BMP"),
    *((b"P%d" % digit, "PNM") for digit in range(1, 7)),
    (b"GIF8", "GIF"),
)
_BRANDS = {b"avif": "AVIF", b"avis": "AVIF", **dict.fromkeys((b"heic", b"heix", b"heim", b"hevc", b"mif1"), "HEIF")}
"""Formats of ISO media files, by the brand in bytes 8 to 11."""

_KINDS = "PNG, JPEG, TIFF, BMP, PPM, PGM, WebP, AVIF, HEIC or GIF"
_DEEP_SUFFIXES = (".png", ".tif", ".tiff", ".ppm", ".pgm", ".pnm")
_FLOAT_SUFFIXES = (".tif", ".tiff")
_EXIF_ORIENTATION = 0x0112
_PNM_HEADER = re.compile(
    rb"P(?P<kind>[1-6])(?:\s|#[^\n\r]*[\n\r])+(?P<width>\d{1,9})(?:\s|#[^\n\r]*[\n\r])+(?P<height>\d{1,9})"
    rb"(?:(?:\s|#[^\n\r]*[\n\r])+(?P<maximum>\d{1,5}))?\s"
)
# Tags of the TIFF 6.0 specification.
_WIDTH, _HEIGHT, _BITS, _PHOTOMETRIC, _SAMPLES, _PLANAR, _FORMAT = 256, 257, 258, 262, 277, 284, 339
_EXTENTS = ((273, 279), (324, 325))  # offsets and byte counts, of strips or of tiles


@dataclass(frozen=True)
class _Header:
    """Header of an image file; width and height are as stored, before the orientation is applied."""

    kind: str
    width: int
    height: int
    bits: int = 8
    orientation: int = 1
    fault: str = ""
    """Why the pixels cannot be decoded, or empty."""
    maximum: int = 255
    """PNM only: the value of white."""
    offset: int = 0
    """PNM only: offset of the pixels in bytes."""

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) after the orientation is applied; orientations 5 to 8 swap them."""
        if self.orientation >= 5:
            return self.height, self.width
        return self.width, self.height


def read_image(path: str | os.PathLike[str], max_pixels: int = MAX_PIXELS) -> np.ndarray:
    """Read a colour image as it is stored.

    Parameters
    ----------
    path : path-like
        A PNG, JPEG, TIFF (first page), BMP, PPM, PGM, WebP, AVIF, GIF or HEIC file of one still, or a RAW file,
        recognised by its suffix. HEIC needs the extra ``heic``. RAW values are linear (see :func:`liaam.io.read_raw`).
    max_pixels : int, optional
        Larger images are rejected before decoding.

    Returns
    -------
    np.ndarray
        (height, width, 3) uint8, uint16 or float32, in RGB order. The response is not changed and colour
        profiles are not applied. A grey image has three equal channels. Transparency is dropped, palettes and
        CMYK are converted, and the EXIF orientation is applied. 64-bit floats become float32, and NaN is kept. PPM
        and PGM values are scaled so that white is 255 or 65535.

    Raises
    ------
    ImageError
        If the file is missing, a folder, empty, truncated, damaged or in another format, has more than `max_pixels`
        pixels, or holds values of an unsupported type, such as 32-bit or signed integers.
    """
    return _read(path, max_pixels)


def read_preview(path: str | os.PathLike[str], size: int, max_pixels: int = MAX_PIXELS) -> np.ndarray:
    """Read an image for display. A JPEG may be decoded faster at a half, a quarter or an eighth of its size.

    Parameters
    ----------
    path : path-like
    size : int
        Minimum length of both sides of the result, unless the image is smaller.
    max_pixels : int, optional

    Returns
    -------
    (h, w, 3) uint8, uint16 or float32
        See :func:`read_image`.

    Raises
    ------
    ImageError
        See :func:`read_image`.
    """
    return _read(path, max_pixels, size)


def decode_image(data: bytes, name: str = "image", max_pixels: int = MAX_PIXELS) -> np.ndarray:
    """Decode the bytes of an image file, except RAW files; see :func:`read_image`.

    Parameters
    ----------
    data : bytes
    name : str
        Name of the image in errors.
    max_pixels : int, optional
        Larger images are rejected before decoding.

    Returns
    -------
    (h, w, 3) uint8, uint16 or float32

    Raises
    ------
    ImageError
        See :func:`read_image`.
    """
    header = _header_of(io.BytesIO(data), name)
    _check_header(name, header, max_pixels)
    return _decode(name, data, header)


def encoded_size(data: bytes, name: str = "image") -> tuple[int, int]:
    """Return (width, height) of an image file given as bytes, as :func:`image_size` does for a path."""
    return _header_of(io.BytesIO(data), name).size


def is_image(data: bytes) -> bool:
    """Return whether the first bytes are those of a format that :func:`read_image` reads, except RAW."""
    return _kind_of(data[:16]) is not None


def image_size(path: str | os.PathLike[str]) -> tuple[int, int]:
    """Return (width, height) of an image in pixels, after its EXIF orientation, from the header only.

    Raises
    ------
    ImageError
        If the file is missing, a folder, empty, or its header cannot be read.
    """
    return size_and_orientation(path)[0]


def size_and_orientation(path: str | os.PathLike[str]) -> tuple[tuple[int, int], int]:
    """Return (width, height) of an image as :func:`image_size` does, and its EXIF orientation, 1 to 8."""
    if is_raw(path):
        return raw_size(path), 1
    header = _read_header(existing_file(path, ImageError, "image"))
    return header.size, header.orientation


def _read(path: str | os.PathLike[str], max_pixels: int, preview: int | None = None) -> np.ndarray:
    """Read an image; see :func:`read_preview` for the size."""
    if is_raw(path):
        return read_raw(path, max_pixels)
    path = existing_file(path, ImageError, "image")
    header = _read_header(path)
    _check_header(path, header, max_pixels)
    return _decode(path, read_bytes(path, ImageError, _MAX_BYTES), header, preview)


def _check_header(path: Path | str, header: _Header, max_pixels: int) -> None:
    check_size(path, header.width, header.height, max_pixels)
    if header.fault:
        raise ImageError(f"{path} {header.fault}")


def write_image(path: str | os.PathLike[str], array: np.ndarray) -> None:
    """Write an image atomically, in the format of the suffix.

    Parameters
    ----------
    path : path-like
        Ends in one of `IMAGE_SUFFIXES`.
    array : np.ndarray
        (height, width, 3) in RGB order, or (height, width) grey. uint8 for every format; uint16 for PNG,
        TIFF, PPM and PGM; float32 for TIFF only. JPEG is written with quality 95 and full-resolution
        chroma.

    Raises
    ------
    ImageError
        If the suffix, the shape or the type cannot be written, or writing fails.
    """
    path = Path(path)
    array = np.asarray(array)
    suffix = _check_writable(path, array)
    if suffix == ".ppm" and array.ndim == 2:
        array = as_three_channels(array)
    data = _encode_shallow(array, suffix) if array.dtype == np.uint8 else _encode_deep(array, suffix)
    write_bytes_atomically(path, data, ImageError)


# Headers ------------------------------------------------------------------------------------------


def _read_header(path: Path) -> _Header:
    """Read kind, size and depth of a file without decoding pixels."""
    try:
        with path.open("rb") as file:
            return _header_of(file, path)
    except OSError as fault:
        raise ImageError(f"{path} cannot be read ({fault.strerror}): check its permissions.") from fault


def _header_of(file: Any, path: Path | str) -> _Header:
    """Read kind, size and depth from an open file without decoding pixels."""
    kind: str | None = None
    try:
        kind = _kind_of(file.read(16))
        if kind is None:
            if str(path).endswith(".liaam"):
                raise ImageError(f"{path} is a model, not an image: give one model first, and then images.")
            if str(path).lower().endswith(_VIDEOS):
                raise ImageError(f"{path} is a video, not an image: use 'liaam track', or save its frames as images.")
            raise ImageError(f"{path} is not a {_KINDS} image: open it in an image program and save it as PNG.")
        file.seek(0)
        header = _HEADER_READERS[kind](file) if kind in _HEADER_READERS else _pillow_header(file, kind)
    except ImageError:
        raise
    except ImportError as fault:
        needs = _NEEDS.get(str(kind), f"image of a format that needs another Pillow ({kind})")
        raise ImageError(f"{path} is an {needs}, or save the image as PNG.") from fault
    except OSError as fault:
        if fault.errno is not None:  # raised by the system, not by Pillow
            raise
        raise _damaged(path, fault) from fault
    except Exception as fault:  # Pillow's parsers raise many classes on bad bytes
        raise _damaged(path, fault) from fault
    if header.width < 1 or header.height < 1:
        raise _damaged(path, f"a size of {header.width} x {header.height} pixels")
    return header


def image_kind(path: Path) -> str | None:
    """Return the format of an image file by its first bytes, or None for other files."""
    with path.open("rb") as file:
        return _kind_of(file.read(16))


def _kind_of(start: bytes) -> str | None:
    """Return the format by the first 16 bytes, or None if unknown."""
    if start[:4] == b"RIFF" and start[8:12] == b"WEBP":
        return "WEBP"
    if start[4:8] == b"ftyp":
        return _BRANDS.get(start[8:12])
    return next((kind for signature, kind in _SIGNATURES if start.startswith(signature)), None)


def _damaged(path: Path | str, fault: object) -> ImageError:
    return ImageError(
        f"{path} is damaged or cut short ({fault}): copy it again, or save it again from the program that made it."
    )


def _open_pillow(file: Any, kind: str) -> Any:
    """Open with Pillow's reader of this kind. Image.open would try others and apply its own size limit."""
    from PIL import BmpImagePlugin, JpegImagePlugin, PngImagePlugin, PpmImagePlugin, TiffImagePlugin

    if kind in _LATER:
        return _LATER[kind](file)
    readers = {
        "PNG": PngImagePlugin.PngImageFile,
        "JPEG": JpegImagePlugin.jpeg_factory,
        "TIFF": TiffImagePlugin.TiffImageFile,
        "BMP": BmpImagePlugin.BmpImageFile,
        "PNM": PpmImagePlugin.PpmImageFile,
    }
    return readers[kind](file)


def _open_webp(file: Any) -> Any:
    from PIL import WebPImagePlugin

    return WebPImagePlugin.WebPImageFile(file)


def _open_gif(file: Any) -> Any:
    from PIL import GifImagePlugin

    return GifImagePlugin.GifImageFile(file)


def _open_avif(file: Any) -> Any:
    from PIL import AvifImagePlugin  # since Pillow 11.3

    return AvifImagePlugin.AvifImageFile(file)


def _open_heif(file: Any) -> Any:
    from pillow_heif import HeifImageFile  # type: ignore

    return HeifImageFile(file)


_LATER = {"WEBP": _open_webp, "GIF": _open_gif, "AVIF": _open_avif, "HEIF": _open_heif}
"""How the formats are opened that older versions of Pillow, or Pillow alone, may lack."""

_NEEDS = {
    "AVIF": "AVIF image, which needs Pillow 11.3 or later: 'pip install --upgrade pillow'",
    "HEIF": f"HEIC image, which needs the extra heic: {installing('heic')}",
}


def _pillow_header(file: Any, kind: str) -> _Header:
    image = _open_pillow(file, kind)
    frames = getattr(image, "n_frames", 1) if kind in _LATER else 1
    fault = f"holds {frames} pictures, not one still: save one of them as PNG." if frames > 1 else ""
    return _Header(kind, *image.size, orientation=_orientation(image.getexif()), fault=fault)


def _orientation(tags: Any) -> int:
    value = tags.get(_EXIF_ORIENTATION, 1)
    return value if value in range(1, 9) else 1


def _png_header(file: Any) -> _Header:
    """Read the chunks directly, because Pillow decodes the pixels to find an eXIf chunk after them."""
    from PIL import Image

    width, height, bits = struct.unpack(">IIB", file.read(25)[16:])  # IHDR always comes first
    chunks = _png_chunks(file, file.seek(0, os.SEEK_END))
    exif = Image.Exif()
    if b"eXIf" in chunks:
        offset, size = chunks[b"eXIf"]
        file.seek(offset)
        exif.load(file.read(size))
    fault = "" if b"IEND" in chunks else "is cut short (it ends within a chunk): copy it again."
    return _Header("PNG", width, height, bits=bits, orientation=_orientation(exif), fault=fault)


def _png_chunks(file: Any, n_bytes: int) -> dict[bytes, tuple[int, int]]:
    """Return the offset and size of the data of each kind of chunk that is complete."""
    chunks: dict[bytes, tuple[int, int]] = {}
    offset = 8
    while offset + 12 <= n_bytes and b"IEND" not in chunks:
        file.seek(offset)
        size, tag = struct.unpack(">I4s", file.read(8))
        if offset + 12 + size <= n_bytes:
            chunks[tag] = (offset + 8, size)
        offset += 12 + size
    return chunks


def _pnm_header(file: Any) -> _Header:
    match = _PNM_HEADER.match(file.read(10_000))
    bilevel = match is not None and match["kind"] in b"14"
    if match is None or (match["maximum"] is None and not bilevel):
        raise ValueError("its header is incomplete")
    maximum = 1 if bilevel else int(match["maximum"])
    if not 1 <= maximum <= 65535:
        raise ValueError(f"its header gives {maximum} as the largest value")
    deep = maximum > 255
    plain_text = "holds more than 8 bits per channel as plain text: save it as binary PPM or as PNG."
    return _Header(
        "PNM",
        int(match["width"]),
        int(match["height"]),
        bits=16 if deep else 8,
        fault=plain_text if deep and match["kind"] in b"23" else "",
        maximum=maximum,
        offset=match.end(),
    )


def _tiff_header(file: Any) -> _Header:
    """Read the tags directly, because Pillow cannot open a float RGB file."""
    from PIL.TiffImagePlugin import ImageFileDirectory_v2

    start = file.read(8)
    if start[2] == 43:  # BigTIFF has a longer header
        start += file.read(8)
    tags = ImageFileDirectory_v2(start)
    file.seek(tags.next)
    tags.load(file)
    return _Header(
        "TIFF",
        int(tags[_WIDTH]),
        int(tags[_HEIGHT]),
        bits=max(tags.get(_BITS, (1,))),
        orientation=_orientation(tags),
        fault=_tiff_fault(tags, file.seek(0, os.SEEK_END)),
    )


def _tiff_fault(tags: Any, n_bytes: int) -> str:
    """Describe why the pixels cannot be decoded; empty if they can."""
    for offsets, counts in _EXTENTS:
        pairs = zip(tags.get(offsets, ()), tags.get(counts, ()), strict=False)
        if any(offset + count > n_bytes for offset, count in pairs):
            return "is cut short (it ends before its pixels do): copy it again."
    bits = set(tags.get(_BITS, (1,)))
    if max(bits) <= 8:
        return ""
    kinds = {(depth, form) for depth in bits for form in tags.get(_FORMAT, (1,))}
    if kinds not in ({(16, 1)}, {(32, 3)}, {(64, 3)}):
        return "does not hold 8- or 16-bit unsigned integers or 32-bit floats: convert it to one of these."
    n_samples = tags.get(_SAMPLES, 1)
    if n_samples not in (1, 3, 4) or tags.get(_PHOTOMETRIC) not in (1, 2):
        return "is not a grey or RGB image: convert it to RGB."
    if n_samples > 1 and tags.get(_PLANAR, 1) != 1:
        return "stores its channels in separate planes: save it with interleaved channels."
    return ""


_HEADER_READERS = {"PNG": _png_header, "TIFF": _tiff_header, "PNM": _pnm_header}


# Decoding -----------------------------------------------------------------------------------------


def _decode(path: Path | str, data: bytes, header: _Header, preview: int | None = None) -> np.ndarray:
    """Decode a file's bytes; see :func:`read_preview` for the size."""
    if header.bits <= 8:
        return _decode_shallow(path, data, header, preview)
    if header.kind == "PNM":
        return _decode_deep_pnm(path, data, header)
    return _decode_deep(path, data, header)


def _decode_shallow(path: Path | str, data: bytes, header: _Header, preview: int | None = None) -> np.ndarray:
    """Decode an image with at most 8 bits per channel, and detect truncation."""
    try:
        image = _open_pillow(io.BytesIO(data), header.kind)
        if image.size not in ((header.width, header.height), header.size):  # what was checked would not be decoded
            raise ValueError("its size can be read in two ways")
        if preview is not None:
            image.draft(None, (preview, preview))  # affects JPEG only
        image.load()
        array = _rgb_of(image)
    except MemoryError:
        raise
    except Exception as fault:  # Pillow's decoders raise many classes on bad bytes
        raise _damaged(path, fault) from fault
    return _upright(array, header)


ROWS_AT_ONCE = 256
"""Rows converted at a time, because Pillow's conversions take several times the image's memory."""


def _rgb_of(image: Any) -> np.ndarray:
    """Convert a Pillow image to (h, w, 3) uint8."""
    width, height = image.size
    array = np.empty((height, width, 3), np.uint8)
    for top in range(0, height, ROWS_AT_ONCE):
        strip = image.crop((0, top, width, min(top + ROWS_AT_ONCE, height)))
        if "transparency" in image.info:  # a palette with transparency cannot be converted to RGB directly
            strip = strip.convert("RGBA")
        array[top : top + strip.height] = strip.convert("RGB")
    return array


def _decode_deep(path: Path | str, data: bytes, header: _Header) -> np.ndarray:
    """Decode 16-bit PNG, and 16-bit and float TIFF."""
    import cv2

    if header.kind == "PNG":  # detect truncation with Pillow, because OpenCV may fill missing pixels with zeros
        _decode_shallow(path, data, header)
    try:
        array = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as fault:
        raise _damaged(path, fault) from fault
    if array is None:
        raise _damaged(path, "its pixels cannot be decoded")
    if array.dtype == np.float64:
        with np.errstate(over="ignore"):
            array = array.astype(np.float32)
    if array.ndim == 2:
        return _upright(as_three_channels(array), header)
    # In place: the picture may be all that the memory holds.
    rgb = cv2.cvtColor(array, cv2.COLOR_BGR2RGB, array) if array.shape[2] == 3 else array[:, :, 2::-1]
    return _upright(np.ascontiguousarray(rgb), header)


def _decode_deep_pnm(path: Path | str, data: bytes, header: _Header) -> np.ndarray:
    n_channels = 3 if data[1:2] == b"6" else 1
    n_values = header.width * header.height * n_channels
    if len(data) - header.offset < 2 * n_values:
        raise _damaged(path, f"{2 * n_values} bytes of pixels expected, {len(data) - header.offset} found")
    values = np.frombuffer(data, ">u2", n_values, header.offset).astype(np.float64)
    scaled = np.rint(np.minimum(values, header.maximum) * (65535 / header.maximum)).astype(np.uint16)
    array = scaled.reshape(header.height, header.width, n_channels)
    return array if n_channels == 3 else as_three_channels(array[:, :, 0])


def _upright(array: np.ndarray, header: _Header) -> np.ndarray:
    """Apply the EXIF orientation, except to TIFF, where both decoders already did."""
    if header.kind == "TIFF" or header.orientation == 1:
        return array
    if header.orientation >= 5:
        array = array.transpose(1, 0, 2)
    if header.orientation in (3, 4, 7, 8):
        array = array[::-1]
    if header.orientation in (2, 3, 6, 7):
        array = array[:, ::-1]
    return np.ascontiguousarray(array)


def _check_writable(path: Path, array: np.ndarray) -> str:
    """Return the suffix in lower case after checking that it can hold this array."""
    suffix = path.suffix.lower()
    if suffix not in IMAGE_SUFFIXES:
        fault = f"'{path.suffix}' is not a known extension. Use {', '.join(IMAGE_SUFFIXES)}."
    elif array.ndim not in (2, 3) or (array.ndim == 3 and array.shape[2] != 3) or array.size == 0:
        remedy = "Give (height, width, 3) for colour or (height, width) for grey."
        fault = f"the array has shape {array.shape}. {remedy}"
    elif array.dtype not in (np.uint8, np.uint16, np.float32):
        fault = f"the values are {array.dtype}. Convert them to uint8, uint16 or float32."
    elif array.dtype == np.float32 and suffix not in _FLOAT_SUFFIXES:
        fault = f"{suffix} cannot hold float32. Use .tiff, or convert the array to uint8."
    elif array.dtype == np.uint16 and suffix not in _DEEP_SUFFIXES:
        fault = f"{suffix} cannot hold 16 bits. Use .png, or convert the array to uint8."
    elif suffix == ".pgm" and array.ndim == 3:
        fault = ".pgm is for grey images. Use .ppm or .png for colour."
    else:
        return suffix
    raise ImageError(f"{path} cannot be written: {fault}")


def _encode_shallow(array: np.ndarray, suffix: str) -> bytes:
    from PIL import Image

    buffer = io.BytesIO()
    buffer.name = f"image{suffix}"  # Pillow takes the format from it, and loads further plugins only if it has to
    options: dict[str, Any] = {"quality": 95, "subsampling": 0} if suffix in (".jpg", ".jpeg") else {}
    Image.fromarray(np.ascontiguousarray(array)).save(buffer, **options)
    return buffer.getvalue()


def _encode_deep(array: np.ndarray, suffix: str) -> bytes:
    import cv2

    if suffix == ".pnm":
        suffix = ".pgm" if array.ndim == 2 else ".ppm"
    bgr = array if array.ndim == 2 else array[:, :, ::-1]
    options = [cv2.IMWRITE_TIFF_COMPRESSION, 1] if suffix in _FLOAT_SUFFIXES else []
    _, data = cv2.imencode(suffix, np.ascontiguousarray(bgr), options)
    return data.tobytes()
