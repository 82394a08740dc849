"""Read still images as RGB arrays with their stored values, and write them.

Pillow opens and decodes files, converts colour profiles to sRGB and detects truncated files. OpenCV decodes the 16-bit
and float files that Pillow would reduce to 8 bits, and writes. The size in the header is checked before decoding. The
format is recognised by content, not by suffix, except for RAW files (:mod:`liaam.io.raw`).
"""

import importlib
import io
import mimetypes
import os
import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from liaam.errors import ImageError, installing
from liaam.io import tiff
from liaam.io.atomic import write_bytes_atomically
from liaam.io.files import AnyPath, as_three_channels, check_file_size, check_size, enough_memory, existing_file
from liaam.io.raw import RAW_SUFFIXES, is_raw, raw_size, read_raw

IMAGE_SUFFIXES = (".png", ".tif", ".tiff", ".bmp", ".ppm", ".pgm", ".pnm", ".jpg", ".jpeg")
"""Suffixes (lower case) of the image files that can be read and written, lossless ones first."""

STILL_SUFFIXES = (*IMAGE_SUFFIXES, ".jfif", ".jpe", ".webp", ".avif", ".heic", ".heif", ".gif", ".jp2")
"""Suffixes of the images that can be read, without RAW files."""

PICTURE_SUFFIXES = (*STILL_SUFFIXES, *RAW_SUFFIXES)
"""Suffixes of all images that can be read, in order of preference where a camera wrote both RAW and JPEG."""

USUAL_SUFFIXES = f"{', '.join(IMAGE_SUFFIXES)} …"
"""The first of them, for messages."""

UNREAD_SUFFIXES = (".jxl", ".svg", ".psd", ".exr")
"""Suffixes of images that are not supported, to name them in messages."""

VIDEO_SUFFIXES = (".mp4", ".m4v", ".mov", ".mkv", ".avi", ".webm")
"""Suffixes of the videos that can be written."""

_DEEP_SUFFIXES = (".png", ".tif", ".tiff", ".ppm", ".pgm", ".pnm")  # of files that 16 bits can be written to
_FLOAT_SUFFIXES = (".tif", ".tiff")  # of files that floats can be written to
_SIGNATURES = {  # first bytes of the formats, by Pillow's name
    "PNG": rb"\x89PNG\r\n\x1a\n",
    "JPEG": rb"\xff\xd8\xff",
    "TIFF": rb"II[*+]\0|MM\0[*+]",  # + is BigTIFF
    "BMP": rb"BM",
    "PPM": rb"P[1-6]",
    "GIF": rb"GIF8",
    "JPEG2000": rb"\0\0\0\x0cjP  \r\n\x87\n|\xff\x4f\xff\x51",
    "WEBP": rb"RIFF.{4}WEBP",
    "AVIF": rb".{4}ftypavi[fs]",
    "HEIF": rb".{4}ftyp(?:hei[cxm]|hevc|mif1)",
}
_PLUGINS = {"WEBP": "WebP", "JPEG2000": "Jpeg2K"}  # modules of Pillow that are not called as their format
_NEEDS = {
    "AVIF": "AVIF image, which needs Pillow 11.3 or later: 'pip install --upgrade pillow'",
    "HEIF": f"HEIC image, which needs the extra heic: {installing('heic')}",
}
_MAX_BYTES = 4_000_000_000  # of a file: readers of some formats look for their end, in all of it
_KINDS = "PNG, JPEG, TIFF, BMP, PPM, PGM, WebP, AVIF, HEIC, GIF or JPEG 2000"
_EXIF_ORIENTATION = 0x0112
# By the EXIF orientation, how a stored image becomes upright: first rows and columns are exchanged, and then those that
# result are reversed.
_EXCHANGES = (5, 6, 7, 8)
_REVERSES_ROWS = (3, 4, 7, 8)
_REVERSES_COLUMNS = (2, 3, 6, 7)
ROWS_AT_ONCE = 256  # rows converted at a time, because Pillow's conversions take several times the image's memory
# Modes of Pillow's images that the colour profiles of each colour space are for.
_PROFILE_MODES = {"RGB": ("RGB", "RGBA", "P"), "GRAY": ("L", "LA"), "CMYK": ("CMYK",)}
_SAME = 2  # largest difference of 8-bit values between sRGB and a profile that is taken for sRGB, of rounding


@dataclass(frozen=True)
class _Opened:
    """Header of an image file, whose pixels are not decoded yet."""

    file: Any
    name: object
    kind: str
    image: Any  # Pillow's image; None for a TIFF of more than 8 bits per channel
    width: int  # as stored, before the orientation is applied
    height: int
    deep: bool = False  # whether channels have more than 8 bits
    orientation: int = 1
    fault: str = ""  # why the pixels cannot be decoded, or empty
    pages: tuple[tiff.Page, ...] = ()  # of a TIFF: that of the picture, or those of its red, green and blue
    tags: Mapping[int, Any] = field(default_factory=dict)  # of a TIFF: those of its picture

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) after the orientation is applied."""
        return (self.height, self.width) if self.orientation in _EXCHANGES else (self.width, self.height)


def read_image(path: AnyPath, max_pixels: int | None = None) -> np.ndarray:
    """Read a colour image with its stored values, or those that its colour profile gives in sRGB.

    Parameters
    ----------
    path : path-like
        A PNG, JPEG, TIFF, BMP, PPM, PGM, WebP, AVIF, GIF, JPEG 2000 or HEIC file of one still, or a RAW
        file, recognised by its suffix. HEIC needs the extra ``heic``. RAW values are linear light.
    max_pixels : int, optional
        Larger images are rejected before decoding. By default the environment variable ``LIAAM_MAX_PIXELS``, or 200
        million.

    Returns
    -------
    np.ndarray
        (height, width, 3) uint8, uint16 or float32, in RGB order. A grey image has three equal channels. Transparency
        is dropped, palettes and CMYK are converted, and the EXIF orientation is applied. 64-bit floats become float32,
        and NaN is kept. PPM and PGM values are scaled so that white is 255 or 65535. 8-bit values with an ICC profile
        of another colour space, such as Adobe RGB, are converted to sRGB; 16-bit and float values, and those with a
        damaged profile, are returned as stored.

    Raises
    ------
    ImageError
        If the file is missing, a folder, empty, truncated, damaged or in another format, has more than `max_pixels`
        pixels, or holds several pictures, or values of an unsupported type, such as 32-bit or signed integers.
    """
    return read_preview(path, None, max_pixels)


def read_preview(
    path: AnyPath | bytes, size: int | None, max_pixels: int | None = None, name: str = "image"
) -> np.ndarray:
    """Read an image for display, with sides of at least `size` pixels; see :func:`read_image`.

    A JPEG may be decoded faster at a half, a quarter or an eighth of its size. Bytes are those of an image file, except
    RAW files; errors call it `name`.
    """
    if not isinstance(path, bytes) and is_raw(path):
        return read_raw(path, max_pixels)
    with _opened(path, name) as opened:
        check_size(opened.name, opened.width, opened.height, max_pixels)
        if opened.fault:
            raise ImageError(f"{opened.name} {opened.fault}")
        if len(opened.pages) > 1:
            return _upright(_decode_colours(opened), opened)
        if opened.deep:
            return _upright(_decode_deep(opened), opened)
        if size is not None:
            opened.image.draft(None, (size, size))  # affects JPEG only
        return _upright(rgb_of(opened.image), opened)


def read_strips(
    path: AnyPath | bytes, max_pixels: int | None = None, rows: int = ROWS_AT_ONCE, name: str = "image"
) -> Iterator[np.ndarray]:
    """Yield an image in strips of so many rows, from the top, as :func:`read_image` reads it.

    Images of 8 bits take 4 bytes per pixel meanwhile, instead of 7. Bytes are those of an image file, except RAW files;
    errors call it `name`.
    """
    whole: np.ndarray | None = None
    if not isinstance(path, bytes) and is_raw(path):
        whole = read_raw(path, max_pixels)
    else:
        with _opened(path, name) as opened:
            check_size(opened.name, opened.width, opened.height, max_pixels)
            if not opened.fault and len(opened.pages) <= 1 and not opened.deep:
                yield from _strips_of(opened, rows)
                return
        whole = read_preview(path, None, max_pixels, name)
    for top in range(0, len(whole), rows):
        yield whole[top : top + rows]


def _strips_of(opened: _Opened, rows: int) -> Iterator[np.ndarray]:
    """Decode an image of Pillow, and yield upright strips of it."""
    image = opened.image
    image.load()
    convert = _to_srgb(image) or _to_rgb
    width, height = image.size
    orientation = _orientation_to_apply(opened)
    is_turned = orientation in _EXCHANGES  # rows of the upright image are columns of the stored one
    length = width if is_turned else height
    for top in range(0, length, rows):
        bottom = min(top + rows, length)
        if orientation in _REVERSES_ROWS:
            first = length - bottom
            end = length - top
        else:
            first = top
            end = bottom
        box = (first, 0, end, height) if is_turned else (0, first, width, end)
        yield _upright(np.asarray(convert(image.crop(box))), opened)


def decode_image(data: bytes, name: str = "image", max_pixels: int | None = None) -> np.ndarray:
    """Decode the bytes of an image file, except RAW files. Errors call it `name`. See :func:`read_image`."""
    return read_preview(data, None, max_pixels, name)


def as_pixels(image: Any, name: str = "image") -> Any:
    """Return the pixels of an image of Pillow, of the bytes of an image file, or of a file that is open.

    They are upright, and as :func:`read_image` gives those of a file. Anything else, such as an array, is returned as
    it is. Errors call the image by its name.
    """
    if isinstance(image, bytes | bytearray | memoryview):
        return decode_image(bytes(image), name)
    if hasattr(image, "read") and not hasattr(image, "__array_interface__"):
        return decode_image(_bytes_of(image, name), name)
    if hasattr(image, "getexif") and hasattr(image, "getbands"):
        return _of_pillow(image, name)
    return image


def _bytes_of(file: Any, name: str) -> bytes:
    """Read an open file from its start, if it can go there."""
    if hasattr(file, "seek") and (not hasattr(file, "seekable") or file.seekable()):
        file.seek(0)
    data = file.read(_MAX_BYTES + 1)
    if not isinstance(data, bytes) or len(data) > _MAX_BYTES:
        what = f"more than {_MAX_BYTES:,} bytes" if isinstance(data, bytes) else "text, not bytes"
        raise ImageError(f"{name}: the open file holds {what}: open an image file with open(path, 'rb').")
    return data


def _of_pillow(image: Any, name: str) -> np.ndarray:
    """Return the pixels of an image of Pillow, upright."""
    from PIL import ImageOps

    check_size(name, *image.size)
    try:
        with enough_memory(name, ImageError):
            turned = ImageOps.exif_transpose(image)
            if turned.mode.startswith(("I", "F")):  # of more than 8 bits
                return as_three_channels(np.asarray(turned))
            return rgb_of(turned)
    except (ImageError, MemoryError):
        raise
    except Exception as fault:  # Pillow decodes only now, and raises many classes on bad bytes
        raise ImageError(f"{name} is damaged or cut short ({fault}): open another copy of it.") from fault


def image_size(path: AnyPath | bytes, name: str = "image") -> tuple[int, int]:
    """Return (width, height) of an image in pixels, after its EXIF orientation, from the header only.

    Bytes are those of an image file, except RAW files; errors call it `name`.

    Raises
    ------
    ImageError
        If the file is missing, a folder, empty, or its header cannot be read.
    """
    return size_and_orientation(path, name)[0]


def size_and_orientation(path: AnyPath | bytes, name: str = "image") -> tuple[tuple[int, int], int]:
    """Return (width, height) of an image as :func:`image_size` does, and its EXIF orientation, 1 to 8."""
    if not isinstance(path, bytes) and is_raw(path):
        return raw_size(path), 1
    with _opened(path, name) as opened:
        return opened.size, opened.orientation


def tags_of(path: AnyPath | bytes, name: str = "image") -> Mapping[int, Any]:
    """Return the tags of the picture in a TIFF file, with the description of its first page; none for other images.

    Raises
    ------
    ImageError
        As :func:`image_size` does.
    """
    if not isinstance(path, bytes) and is_raw(path):
        return {}
    with _opened(path, name) as opened:
        return opened.tags


def image_kind(file: Path | bytes) -> str | None:
    """Return the format, except RAW, of an image file, or of its first bytes; None for other files."""
    if isinstance(file, Path):
        with file.open("rb") as opened:
            file = opened.read(16)
    return next((kind for kind, form in _SIGNATURES.items() if re.match(form, file, re.DOTALL)), None)


@contextmanager
def _opened(path: AnyPath | bytes, name: object = "") -> Iterator[_Opened]:
    """Yield the header of an image in a file, or in bytes, which errors call ``name``.

    Raise what Pillow and OpenCV raise in the block as ImageError.
    """
    if isinstance(path, bytes):
        file = io.BytesIO(path)
    else:
        name = path
        file = _open_file(path)
    with file, enough_memory(name, ImageError):
        kind = image_kind(file.read(16))
        if kind is None:
            raise ImageError(f"{name} {_why_no_image(str(name))}")
        file.seek(0)
        try:
            opened = _open_tiff(file, name) if kind == "TIFF" else _open(file, name, kind)
            if opened.width < 1 or opened.height < 1:
                raise ValueError(f"a size of {opened.width} x {opened.height} pixels")
            yield opened
        except (ImageError, MemoryError):
            raise
        except ImportError as fault:
            needs = _NEEDS.get(kind, f"image of a format that needs another Pillow ({kind})")
            raise ImageError(f"{name} is an {needs}, or save the image as PNG.") from fault
        except Exception as fault:  # Pillow's parsers and decoders raise many classes on bad bytes
            remedy = "copy it again, or save it again from the program that made it."
            raise ImageError(f"{name} is damaged or cut short ({fault}): {remedy}") from fault


def _open_file(path: AnyPath) -> BinaryIO:
    """Open a file of an image. Raise if there is none, or it is too large or cannot be read."""
    existing = existing_file(path, ImageError, "image")
    try:
        check_file_size(existing, ImageError, _MAX_BYTES, "save the image again as PNG")
        return existing.open("rb")
    except OSError as fault:
        raise ImageError(f"{path} cannot be read ({fault.strerror}): check its permissions.") from fault


def _why_no_image(name: str) -> str:
    """Say what else a file seems to be, by its name, and how to make an image of it."""
    if name.endswith(".liaam"):
        return "is a model, not an image: give one model first, and then images."
    if name.lower().endswith(VIDEO_SUFFIXES) or (mimetypes.guess_type(name)[0] or "").startswith("video/"):
        return "is a video, not an image: use 'liaam track', or save its frames as images."
    return f"is not a {_KINDS} image: open it in an image program and save it as PNG."


def _pillow(file: Any, kind: str) -> Any:
    """Open with Pillow's reader of this kind. Image.open would apply its own size limit."""
    if kind == "HEIF":
        return importlib.import_module("pillow_heif").HeifImageFile(file)
    from PIL import Image

    if kind == "JPEG2000":  # whose reader makes room for what the header promises, but not beyond the end of bytes
        file = io.BytesIO(file.read())
    importlib.import_module(f"PIL.{_PLUGINS.get(kind, kind.title())}ImagePlugin")
    return Image.OPEN[kind][0](file, "")


def _open(file: Any, name: object, kind: str) -> _Opened:
    """Open a file of any kind but TIFF."""
    from PIL import Image

    image: Any = _pillow(file, kind)
    fault = ""
    deep = image.mode.startswith("I")
    if kind == "PNG":
        deep = "16" in image.tile[0][3]  # the mode of the stored pixels, as RGB;16B
        exif = _png_exif(file)
        if exif is None:
            fault = "is cut short (it ends within a chunk): copy it again."
        elif exif:
            image.info["exif"] = exif
    elif kind == "PPM":
        deep = _white_of(image) > 255
        if deep and image.tile[0][0] == "ppm_plain":
            fault = "holds more than 8 bits per channel as plain text: save it as binary PPM or as PNG."
    frames = 1 if kind == "JPEG" else getattr(image, "n_frames", 1)  # a JPEG may hold previews of it
    if frames > 1:
        fault = f"holds {frames} pictures, not one still: save one as PNG, or give a GIF or PNG to 'liaam track'."
    orientation = 1
    with suppress(Exception):  # of damaged EXIF data, which programs that show the image ignore
        orientation = _orientation(Image.Image.getexif(image))  # not image.getexif, which decodes the pixels of a PNG
    width, height = image.size
    return _Opened(file, name, kind, image, width, height, deep, orientation, fault)


def _png_exif(file: Any) -> bytes | None:
    """Return the eXIf chunk of a PNG, also from behind the pixels; None if the file is cut short."""
    from PIL.PngImagePlugin import ChunkStream

    n_bytes = file.seek(0, os.SEEK_END)
    exif = b""
    end = 8  # bytes of the signature
    chunks = ChunkStream(file)
    while end + 12 <= n_bytes:  # a chunk has at least its size, tag and checksum, 4 bytes each
        file.seek(end)
        tag, start, size = chunks.read()
        end = start + size + 4
        if end > n_bytes:
            return None
        if tag == b"IEND":
            return exif
        if tag == b"eXIf":
            exif = file.read(size)
    return None


def _white_of(image: Any) -> int:
    """Return the value of white of Pillow's PPM image, from the arguments of its decoder."""
    arguments = image.tile[0][3]
    if isinstance(arguments, tuple):  # (mode, white)
        return arguments[1]
    return 65535 if arguments == "I;16B" else 255


def _open_tiff(file: Any, name: object) -> _Opened:
    """Read the tags before Pillow does, because it cannot open a float RGB file."""
    from PIL.TiffImagePlugin import ImageFileDirectory_v2

    pages = tiff.pages_of(file)
    file.seek(0)
    header = file.read(8)
    if header[:4] == b"MM\0+":  # Pillow takes the header for that of another kind
        what = "is a BigTIFF of big-endian order, which is not read"
        raise ImageError(f"{name} {what}: save it as a usual TIFF, or save it as PNG.")
    if header[2] == 43:  # BigTIFF has a longer header
        header += file.read(8)

    def tags_at(offset: int) -> ImageFileDirectory_v2:
        """Read the tags of the page that lies there in the file."""
        tags = ImageFileDirectory_v2(header)
        file.seek(offset)
        tags.load(file)
        return tags

    tags = tags_at(ImageFileDirectory_v2(header).next)  # of the first page
    description = tags.get(tiff.DESCRIPTION, "")
    used, fault = tiff.picture_in(pages, tags)  # indices of the pages that hold the picture
    first_used = used[0]
    if first_used > 0:
        tags = tags_at(pages[first_used].offset)
    fault = fault or tiff.fault_of(tags, file.seek(0, os.SEEK_END))
    deep = max(tags.get(tiff.BITS, (1,))) > 8
    file.seek(0)
    try:
        image = None if deep or fault else _page_of_tiff(file, first_used)
    except SyntaxError as error:
        if str(error) != "unknown pixel mode":
            raise
        image = None
        fault = "stores its pixels in a form that is not read: save it as RGB of 8 bits, or as PNG."
    width = int(tags[tiff.WIDTH])
    height = int(tags[tiff.HEIGHT])
    of_picture = tuple(pages[i] for i in used if i < len(pages))
    facts = {**tags, tiff.DESCRIPTION: description}
    return _Opened(file, name, "TIFF", image, width, height, deep, _orientation(tags), fault, of_picture, facts)


def _page_of_tiff(file: Any, index: int) -> Any:
    """Open a page of a TIFF with Pillow."""
    image = _pillow(file, "TIFF")
    if index:
        image.seek(index)
    return image


def _decode_colours(opened: _Opened) -> np.ndarray:
    """Decode a picture whose red, green and blue are a page each."""
    if opened.deep:
        channels = [_decode_deep(replace(opened, pages=(page,)))[..., 0] for page in opened.pages]
    else:
        channels = []
        for page in opened.pages:
            opened.file.seek(0)
            channels.append(rgb_of(_page_of_tiff(opened.file, page.index))[..., 0])
    if len({channel.shape for channel in channels}) > 1:
        raise ValueError("its colours have different sizes")
    return np.stack(channels, axis=-1)


def _orientation(tags: Any) -> int:
    """Return the EXIF orientation in tags, 1 if there is none or no valid one."""
    value = tags.get(_EXIF_ORIENTATION, 1)
    return value if value in range(1, 9) else 1


def rgb_of(image: Any) -> np.ndarray:
    """Decode a Pillow image to (h, w, 3) uint8, in sRGB."""
    image.load()
    width, height = image.size
    array = np.empty((height, width, 3), np.uint8)
    convert = _to_srgb(image) or _to_rgb
    for top in range(0, height, ROWS_AT_ONCE):
        strip = image.crop((0, top, width, min(top + ROWS_AT_ONCE, height)))
        array[top : top + strip.height] = convert(strip)
    return array


def _to_rgb(image: Any) -> Any:
    """Convert Pillow's image to RGB, without its transparency."""
    if "transparency" in image.info:  # such a palette cannot be converted to RGB directly
        image = image.convert("RGBA")
    return image.convert("RGB")


def _to_srgb(image: Any) -> Callable[[Any], Any] | None:
    """Return a function that converts parts of an image to sRGB; None if its values are to be taken as stored."""
    profile = image.info.get("icc_profile")
    if not profile:
        return None
    from PIL import Image, ImageCms

    try:
        source: Any = ImageCms.ImageCmsProfile(io.BytesIO(profile))
        space = source.profile.xcolor_space.strip()
        if image.mode not in _PROFILE_MODES.get(space, ()):
            return None
        mode = _PROFILE_MODES[space][0]
        transform: Any = ImageCms.buildTransform(source, ImageCms.createProfile("sRGB"), mode, "RGB")
    except (ImageCms.PyCMSError, OSError):  # a damaged profile
        return None

    def from_grey(part: Any) -> Any:
        green = transform.apply(part.convert("L")).getchannel("G")  # lcms gives channels that differ by rounding
        return Image.merge("RGB", [green, green, green])

    def from_rgb(part: Any) -> Any:
        return transform.apply(_to_rgb(part))

    if mode == "L":
        return from_grey
    if mode == "RGB":
        return None if _changes_nothing(transform) else from_rgb
    return transform.apply


def _changes_nothing(transform: Any) -> bool:
    """Whether a transform from RGB to sRGB gives colours of the whole cube back, but for rounding."""
    from PIL import Image

    levels = np.arange(0, 256, 15, dtype=np.uint8)
    colours = np.stack(np.meshgrid(levels, levels, levels), axis=-1)  # (18, 18, 18, 3)
    picture = colours.reshape(-1, len(levels), 3)
    transformed = np.asarray(transform.apply(Image.fromarray(picture)), int)
    return bool(np.abs(transformed - picture).max() <= _SAME)


def _decode_deep(opened: _Opened) -> np.ndarray:
    """Decode images of more than 8 bits per channel."""
    import cv2

    file = opened.file
    white = _white_of(opened.image) if opened.kind == "PPM" else 65535  # of other kinds, values are never scaled
    if opened.image is not None:  # Pillow detects truncation, where OpenCV may fill missing pixels with zeros
        opened.image.load()
    if file.seek(0, os.SEEK_END) > _MAX_BYTES:
        raise ValueError(f"more than {_MAX_BYTES:,} bytes")
    file.seek(0)
    data: Any = file.read()
    if opened.pages and opened.pages[0].index:  # OpenCV reads the first page
        data = tiff.starting_at(data, opened.pages[0])
    array = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    if array is None:
        raise ValueError("its pixels cannot be decoded")
    if white != 65535:  # of a PPM, which OpenCV does not scale
        array = np.rint(np.minimum(array, white) * (65535 / white)).astype(np.uint16)
    if array.dtype == np.float64:
        with np.errstate(over="ignore"):
            array = array.astype(np.float32)
    if array.ndim == 2:
        return as_three_channels(array)
    if array.shape[2] != 3:
        return np.ascontiguousarray(array[:, :, 2::-1])  # without the fourth channel, transparency
    # In place: the picture may be all that the memory holds.
    return np.ascontiguousarray(cv2.cvtColor(array, cv2.COLOR_BGR2RGB, array))


def _orientation_to_apply(opened: _Opened) -> int:
    """Return the EXIF orientation of what is decoded: 1 of TIFF, to which both decoders already apply it."""
    return 1 if opened.kind == "TIFF" else opened.orientation


def _upright(array: np.ndarray, opened: _Opened) -> np.ndarray:
    """Apply the EXIF orientation to an image (h, w, 3), or to a strip of one."""
    orientation = _orientation_to_apply(opened)
    if orientation == 1:
        return array
    if orientation in _EXCHANGES:
        array = array.swapaxes(0, 1)
    if orientation in _REVERSES_ROWS:
        array = array[::-1]
    if orientation in _REVERSES_COLUMNS:
        array = array[:, ::-1]
    return np.ascontiguousarray(array)


def write_image(path: AnyPath, array: np.ndarray) -> None:
    """Write an image atomically, in the format of the suffix.

    Parameters
    ----------
    path : path-like
        Ends in one of `IMAGE_SUFFIXES`.
    array : np.ndarray
        (height, width, 3) in RGB order, or (height, width) grey. uint8 for every format; uint16 for PNG, TIFF, PPM and
        PGM; float32 for TIFF only. JPEG is written with quality 95 and full-resolution chroma.

    Raises
    ------
    ImageError
        If the suffix, the shape or the type cannot be written, or writing fails.
    """
    path = Path(path)
    array = np.asarray(array)
    suffix = _check_writable(path, array)
    import cv2

    if suffix in (".jpg", ".jpeg"):
        options = [cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444]  # of quality 95 by default
    elif suffix in (".tif", ".tiff"):
        options = [cv2.IMWRITE_TIFF_COMPRESSION, 1]  # none
    elif suffix == ".png":
        options = [cv2.IMWRITE_PNG_COMPRESSION, 3]  # half the time of 6, for files larger by a twelfth
    else:
        options = []
    is_grey = array.ndim == 2
    if suffix == ".pnm":
        suffix = ".pgm" if is_grey else ".ppm"
    elif suffix == ".ppm" and is_grey:
        array = as_three_channels(array)
    bgr = array if array.ndim == 2 else array[:, :, ::-1]
    _, data = cv2.imencode(suffix, np.ascontiguousarray(bgr), options)
    write_bytes_atomically(path, data.tobytes(), ImageError)


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
