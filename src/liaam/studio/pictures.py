"""Pictures for the page: upright, 8-bit and scaled; thumbnails; and chroma, from which the page computes the invariant
image for any angle. Those of the folder, and dropped ones, which are kept in memory only.

Decoded and encoded pictures are cached up to a limit of bytes. Concurrent requests share one computation.
"""

import os
import secrets
import struct
import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import dataclass
from math import prod
from pathlib import Path
from typing import Generic, TypeVar

import cv2
import numpy as np

from liaam.drawing import as_picture
from liaam.errors import ImageError
from liaam.io import decode_image, image_size, is_raw, read_image, read_preview, read_strips
from liaam.photometry import Response, linear_to_srgb
from liaam.photometry.encoding import as_colour, encode, refuse_grey, stored_values
from liaam.studio.folder import disk_errors, plain_name, size_in_header
from liaam.studio.refusal import Refusal, refusing
from liaam.studio.settings import StudioSettings

JPEG_QUALITY = 92
CHROMA_STEP = 1 / 4096  # step of chroma's 16-bit integers: natural logarithm of a ratio of light
CHROMA_MASKED = -32768  # of a pixel that is dark or saturated in a channel, so that its logarithm is undefined
COPIED_FROM = 4_000_000
"""Pixels of pictures from which on a copy is fitted."""
COPY_SIDE = 1000
"""Pixels of the shortest side of that copy; the longest has at most twice as many."""

LARGE = 50_000_000
"""Pixels of pictures from which on the studio works with a half or a quarter of them, and shows tiles."""

TILE = 512
"""Width and height of a tile of a large picture, in pixels."""

DECODED_BYTES = 150_000_000  # of cached pictures, decoded
ENCODED_BYTES = 50_000_000  # of cached pictures, encoded
DECODED_AT_ONCE = 50_000_000
"""Pixels decoded concurrently: two pictures of an ordinary camera, or one of the largest. Decoding takes 7 to 14 bytes
per pixel."""

WORKED_ON_AT_ONCE = 50_000_000
"""Pixels of pictures that are fitted or drawn concurrently. They take 5 to 45 bytes per pixel, most if float."""

K = TypeVar("K", bound=Hashable)
V = TypeVar("V")


class Kept(Generic[K, V]):
    """A thread-safe least-recently-used cache of at most a total weight; concurrent requests share one computation."""

    def __init__(self, limit: int, weigh: Callable[[V], int] = lambda _: 1) -> None:
        self.limit = limit
        self.weight = 0
        self._weigh = weigh
        self._lock = threading.RLock()
        self._values: OrderedDict[K, tuple[V, int]] = OrderedDict()
        self._being_made: dict[K, Future[V]] = {}

    def __len__(self) -> int:
        return len(self._values)

    def peek(self, key: K) -> V | None:
        """Return the value of a key, or None."""
        with self._lock:
            if key not in self._values:
                return None
            self._values.move_to_end(key)
            return self._values[key][0]

    def found(self, key: K, why_not: str) -> V:
        """Return the value of a key, or refuse the request."""
        if (value := self.peek(key)) is None:
            raise Refusal(404, why_not)
        return value

    def get(self, key: K, make: Callable[[], V]) -> V:
        """Return the value of a key, computed if it is missing. All waiting threads get an error of ``make``."""
        with self._lock:
            if (value := self.peek(key)) is not None:
                return value
            pending = self._being_made.get(key)
            future = self._being_made[key] = pending or Future()
        if pending is None:
            try:
                future.set_result(make())
            except BaseException as fault:
                future.set_exception(fault)
            with self._lock:
                del self._being_made[key]
                if future.exception() is None:
                    self.put(key, future.result())
        return future.result()

    def put(self, key: K, value: V) -> None:
        """Cache a value, unless it weighs more than all values may."""
        weight = self._weigh(value)
        with self._lock:
            self.weight -= self._values.pop(key, (value, 0))[1]
            if weight <= self.limit:
                self._values[key] = value, weight
                self.weight += weight
            while self.weight > self.limit:
                self.weight -= self._values.popitem(last=False)[1][1]

    def keep_only(self, wanted: Callable[[K, V], bool]) -> None:
        """Remove all values for which ``wanted(key, value)`` is false."""
        with self._lock:
            for key in [key for key, (value, _) in self._values.items() if not wanted(key, value)]:
                self.weight -= self._values.pop(key)[1]


class Room:
    """A weighted semaphore: limits the number of pixels that are decoded concurrently."""

    def __init__(self, size: int) -> None:
        self.size = self.left = size
        self._changed = threading.Condition()

    @contextmanager
    def of(self, n: int) -> Iterator[None]:
        """Acquire ``n`` pixels, at most the whole size, and release them at the end of the block."""
        n = min(n, self.size)
        with self._changed:
            self._changed.wait_for(lambda: self.left >= n)
            self.left -= n
        try:
            yield
        finally:
            with self._changed:
                self.left += n
                self._changed.notify_all()


@dataclass(frozen=True, eq=False)
class PictureSource:
    """A picture that can be decoded."""

    name: str
    tag: str  # identifier of the contents; changes with the file
    size: tuple[int, int]  # width and height of the upright picture in pixels
    read: Callable[[], np.ndarray]
    preview: Callable[[int], np.ndarray] | None = None
    """Decodes the picture for a size, perhaps at a lower resolution (see :func:`liaam.io.read_preview`)."""
    raw: bool = False  # whether the values are linear

    strips: Callable[[], Iterator[np.ndarray]] | None = None
    """Decodes the picture in strips of rows, for tiles."""

    @property
    def has_copy(self) -> bool:
        """Whether there is a smaller copy to fit (:meth:`Pictures.pixels`)."""
        return self.preview is not None and prod(self.size) > COPIED_FROM

    @property
    def work_size(self) -> tuple[int, int]:
        """Width and height at which it is worked on: its size, or a half or a quarter of that."""
        return work_size(*self.size)


def source_of(path: Path, max_pixels: int, name: str = "") -> PictureSource:
    """Return the picture of a file; its name is by default that of the file."""
    tag = file_tag(path)

    def read(call: Callable[..., V], *arguments: int) -> V:
        try:
            value = call(path, *arguments)
        except ImageError as fault:
            raise ImageError(str(fault).replace(f"{path.parent}{os.sep}", "")) from fault
        if file_tag(path) != tag:
            raise Refusal(409, f"{path.name} has changed: open it and fit it again")
        return value

    def decode() -> np.ndarray:
        return read(read_image, max_pixels)

    def preview(size: int) -> np.ndarray:
        return read(read_preview, size, max_pixels)

    def strips() -> Iterator[np.ndarray]:
        return read_strips(path, max_pixels, TILE)

    return PictureSource(name or path.name, tag, read(image_size), decode, preview, is_raw(path), strips)


def work_size(width: int, height: int) -> tuple[int, int]:
    """Return the width and height at which a picture is worked on: halved until it is no :data:`LARGE` one."""
    while width * height > LARGE:
        width = max(1, width // 2)
        height = max(1, height // 2)
    return width, height


def read_for_work(path: Path) -> np.ndarray:
    """Read a picture in the size at which it is worked on (:func:`work_size`)."""
    size = image_size(path)
    to = work_size(*size)
    if to == size:
        return read_image(path)
    return averaged(as_colour(read_preview(path, min(to)), path.name), to)


def file_tag(path: Path) -> str:
    """Return an identifier of a file's contents, from its time and size."""
    with disk_errors(f"{path.name} cannot be read", "put it back, or reload", ImageError):
        facts = path.stat()
    return f"{facts.st_mtime_ns:x}-{facts.st_size:x}"


class Pictures:
    """Caches of at most so many bytes of decoded pictures and of their encodings for the page; thread-safe."""

    def __init__(self, decoded: int = DECODED_BYTES, encoded: int = ENCODED_BYTES) -> None:
        self._decoded: Kept[Hashable, np.ndarray] = Kept(decoded, lambda image: image.nbytes)
        self._encoded: Kept[Hashable, bytes] = Kept(encoded, len)
        # A page requests many thumbnails at once, and pictures being decoded are as large as cached ones.
        self.room = Room(DECODED_AT_ONCE)
        # Acquired before a picture is decoded, so that a waiting thread does not hold one.
        self.work_room = Room(WORKED_ON_AT_ONCE)

    def pixels(self, source: PictureSource, small: bool = False) -> np.ndarray:
        """Return the decoded picture with three channels, in its ``work_size``, or a ``small`` copy of it.

        The array must not be modified.
        """

        def read() -> np.ndarray:
            with self.room.of(prod(source.size)):
                if source.preview is not None and not small and source.work_size != source.size:
                    image = as_colour(source.preview(min(source.work_size)), source.name)
                    return averaged(image, source.work_size)
                if not small or source.preview is None:
                    return as_colour(source.read(), source.name)
                image = as_colour(source.preview(COPY_SIDE), source.name)
                return averaged(image, fitted_size(image.shape[1], image.shape[0], 2 * COPY_SIDE))

        return self._decoded.get((source.name, source.tag, small), read)

    @contextmanager
    def at_work(self, source: PictureSource, small: bool = False) -> Iterator[np.ndarray]:
        """Yield :meth:`pixels`, within a limit of those at work. Nested, or around a :meth:`Kept.get`, it can lock."""
        with self.work_room.of(prod(source.size)):
            yield self.pixels(source, small)

    def image(self, source: PictureSource, size: int) -> bytes:
        """Return a JPEG for display, its longest side at most ``size``."""

        def make() -> bytes:
            to = fitted_size(*source.work_size, size)
            # At half size or less, decoding a preview may be faster, and independent of the cache.
            if source.preview is not None and 2 * size <= max(source.size):
                with self.room.of(prod(source.size)):
                    return jpeg_bytes(shown(source.preview(size), to, source.raw))
            with self.at_work(source) as image:
                return jpeg_bytes(shown(image, to, source.raw))

        return self._encoded.get(("image", source.name, source.tag, size), make)

    def chroma(self, source: PictureSource, size: int, response: Response) -> bytes:
        """Return the chroma of a picture (see :func:`chroma`)."""

        def make() -> bytes:
            with self.at_work(source) as image:
                return chroma_bytes(image, size, response, source.name, source.size)

        return self._encoded.get(("chroma", source.name, source.tag, size, response), make)


@dataclass(frozen=True, eq=False)
class Upload:
    """A dropped picture."""

    id: str
    name: str  # name of the file without folders
    data: bytes
    width: int  # width of the upright picture in pixels
    height: int


class Uploads:
    """The last used dropped pictures, up to limits of number, bytes and pixels; thread-safe."""

    def __init__(self, pictures: Pictures, settings: StudioSettings | None = None) -> None:
        self._pictures = pictures
        self._settings = settings or StudioSettings()
        most = self._settings.uploads_bytes
        self._least = self._settings.uploads_bytes // self._settings.uploads_kept
        self._uploads: Kept[str, Upload] = Kept(most, lambda upload: min(max(len(upload.data), self._least), most))

    def add(self, data: bytes, name: str) -> Upload:
        """Check, decode and keep a picture."""
        name = plain_name(name)
        most = self._settings.upload_bytes
        if len(data) > most:
            raise Refusal(413, f"{name} has {len(data):,} bytes, more than {most:,}: make it smaller")
        if data and is_raw(name):
            raise Refusal(415, f"{name} is a RAW file, which can only be read from the folder: put it there")
        upload = Upload(secrets.token_urlsafe(9), name, data, *size_in_header(data, name, self._settings.pixels))
        source = self._source(upload, data)
        with refusing():
            self._pictures.pixels(source, source.has_copy)
        self._uploads.put(upload.id, upload)
        return upload

    def get(self, number: str) -> Upload:
        """Return the upload with an id."""
        limit = f"only the {self._settings.uploads_kept} last used are kept"
        return self._uploads.found(number, f"this picture is no longer in memory, where {limit}: drop it again")

    def source(self, number: str) -> PictureSource:
        """Return an upload as a :class:`PictureSource`, which can be read while the upload is in memory."""
        return self._source(self.get(number))

    def _source(self, upload: Upload, data: bytes | None = None) -> PictureSource:
        # A source may outlive the upload, so it must not hold its bytes, unless they are not kept yet.
        number = upload.id
        name = upload.name
        pixels = self._settings.pixels
        return PictureSource(
            name,
            f"upload-{number}",
            (upload.width, upload.height),
            lambda: decode_image(data or self.get(number).data, name, pixels),
            lambda size: read_preview(data or self.get(number).data, size, pixels, name),
            strips=lambda: read_strips(data or self.get(number).data, pixels, TILE, name),
        )


def fitted_size(width: int, height: int, size: int) -> tuple[int, int]:
    """Return the width and height of a picture scaled down so that its longest side is at most ``size``."""
    factor = min(1.0, size / max(width, height))
    return max(1, round(width * factor)), max(1, round(height * factor))


def shown(image: np.ndarray, size: tuple[int, int], raw: bool = False) -> np.ndarray:
    """Scale a picture down for display, (height, width, 3) uint8; ``size`` is (width, height).

    Pixels are averaged: pixel centre x moves to (x + 0.5) * width' / width - 0.5.
    """
    if raw:  # linear values are averaged, then encoded as sRGB
        return as_picture(linear_to_srgb(np.clip(averaged(stored_values(image), size), 0.0, 1.0)))
    return averaged(as_picture(image), size)


def averaged(image: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Scale an image down to (width, height) by averaging pixels; the dtype is kept."""
    if (image.shape[1], image.shape[0]) == size:
        return image
    return cv2.resize(np.ascontiguousarray(image), size, interpolation=cv2.INTER_AREA)


def jpeg_bytes(image: np.ndarray) -> bytes:
    """Encode an image (h, w, 3) uint8 as JPEG without chroma subsampling."""
    sampling = (cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444)
    return _encoded(".jpg", image, *sampling, cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY)


def png_bytes(image: np.ndarray) -> bytes:
    """Encode an image (h, w, 3) or (h, w, 4) uint8 as PNG, quickly rather than small."""
    return _encoded(".png", image, cv2.IMWRITE_PNG_COMPRESSION, 1)


def _encoded(suffix: str, image: np.ndarray, *options: int) -> bytes:
    order = cv2.COLOR_RGBA2BGRA if image.shape[2] == 4 else cv2.COLOR_RGB2BGR
    return cv2.imencode(suffix, cv2.cvtColor(np.ascontiguousarray(image), order), options)[1].tobytes()


def chroma(image: np.ndarray, size: int, response: Response = "srgb", name: str = "image") -> np.ndarray:
    """Compute the log-chromaticities of an image, averaged in linear light: log R/B and log G/B, (h', w', 2) int16.

    The invariant image of an angle is ``cos(theta) * chroma[..., 0] + sin(theta) * chroma[..., 1]``, since the rows
    of L(theta) sum to zero. Values are in steps of :data:`CHROMA_STEP`, and :data:`CHROMA_MASKED` where any pixel
    of a block is dark or saturated. The longest side is at most ``size``, or slightly less if blocks then cover the
    image better.
    """
    image = as_colour(image, name)
    refuse_grey(image, name, "an invariant image needs colour")
    encoded = encode(image, "log", response, reduce=block_size(image.shape[1], image.shape[0], size))
    ratios = (encoded[..., :2] - encoded[..., 2:3]) / np.float32(CHROMA_STEP)
    # Ratios of usable light are 25,000 steps at most; only those of masked pixels may exceed the range.
    numbers = np.rint(np.clip(ratios, -32767, 32767)).astype(np.int16)
    numbers[encoded[..., 3] <= 0] = CHROMA_MASKED
    return numbers


def chroma_bytes(
    image: np.ndarray,
    size: int,
    response: Response = "srgb",
    name: str = "image",
    whole: tuple[int, int] | None = None,
) -> bytes:
    """Encode the chroma of an image for the page, little-endian.

    First width and height (uint32), and the pixels that they cover (float32), then :func:`chroma` row by row. If the
    image is a copy, ``whole`` is the width and height of the picture.
    """
    numbers = chroma(image, size, response, name)
    height, width = numbers.shape[:2]
    rows, columns = image.shape[:2]
    block = block_size(columns, rows, size)
    factor = 1.0 if whole is None else whole[0] / columns
    covered = (factor * min(width * block, columns), factor * min(height * block, rows))
    header = struct.pack("<IIff", width, height, *covered)
    return header + numbers.astype("<i2").tobytes()


def block_size(width: int, height: int, size: int) -> float:
    """Return the size of square blocks that leave the smallest rest, with at most ``size`` blocks per side."""
    longest = max(width, height)
    shortest = min(width, height)
    if longest <= size:
        return 1.0
    counts = np.arange(max(1, int(0.9 * size)), size + 1)
    across = shortest * counts / longest
    rest = (across - np.floor(across + 1e-6)) / np.maximum(across, 1.0)
    # Prefer the finest of equal blocks.
    return longest / float(counts[::-1][np.argmin(np.round(rest[::-1], 6))])
