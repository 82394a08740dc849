"""Pictures as the page shows them: upright, of 8 bits, scaled; thumbnails; and chroma, from which the page itself makes
the invariant image for any angle.

What is decoded or encoded is kept within a limit of bytes, and made once however many ask for it at a time.
"""

from __future__ import annotations

import os
import struct
import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, TypeVar

import numpy as np

from liaam.errors import ImageError
from liaam.io import image_size, is_raw, read_image, read_preview
from liaam.photometry import Response
from liaam.studio.safety import Refusal

JPEG_QUALITY = 92

THUMBNAIL = 160
"""Longest side of a thumbnail, pixels."""

SIZES = (16, 16384)
"""Sizes that may be asked for, pixels along the longest side."""

CHROMA_STEP = 1 / 4096
"""What one stands for in chroma's 16-bit numbers, natural logarithm of a ratio of light."""

CHROMA_MASKED = -32768
"""In chroma: a pixel that is dark or saturated in a channel, so that its logarithm says nothing."""

DECODED_BYTES = 300_000_000
ENCODED_BYTES = 200_000_000

DECODED_AT_ONCE = 50_000_000
"""Pixels: two pictures of an ordinary camera, or one of the largest. Decoding takes 7 to 14 bytes a pixel."""

K = TypeVar("K", bound=Hashable)
V = TypeVar("V")


class Kept(Generic[K, V]):
    """Values by key, those not asked for longest forgotten first; each is made once, whoever else asks meanwhile.

    Parameters
    ----------
    limit : int
        Weight of all values together; a value that is heavier by itself is given but not kept.
    weigh : callable
        Weight of a value; 1 each if left out.
    """

    def __init__(self, limit: int, weigh: Callable[[V], int] = lambda _: 1) -> None:
        self.limit = limit
        self.weight = 0
        self._weigh = weigh
        self._lock = threading.Lock()
        self._values: OrderedDict[K, tuple[V, int]] = OrderedDict()
        self._being_made: dict[K, Future[V]] = {}

    def __len__(self) -> int:
        return len(self._values)

    def peek(self, key: K) -> V | None:
        """Value of a key if it is there."""
        with self._lock:
            if key not in self._values:
                return None
            self._values.move_to_end(key)
            return self._values[key][0]

    def get(self, key: K, make: Callable[[], V]) -> V:
        """Value of a key, made if it is not there; what ``make`` raises, all who wait for it get."""
        with self._lock:
            if key in self._values:
                self._values.move_to_end(key)
                return self._values[key][0]
            future = self._being_made.get(key)
            is_first = future is None
            if future is None:
                future = self._being_made[key] = Future()
        if not is_first:
            return future.result()
        try:
            value = make()
        except BaseException as fault:
            with self._lock:
                del self._being_made[key]
            future.set_exception(fault)
            raise
        with self._lock:
            del self._being_made[key]
            self._put(key, value)
        future.set_result(value)
        return value

    def put(self, key: K, value: V) -> None:
        """Keep a value."""
        with self._lock:
            self._put(key, value)

    def _put(self, key: K, value: V) -> None:
        if key in self._values:
            self.weight -= self._values.pop(key)[1]
        weight = self._weigh(value)
        if weight > self.limit:
            return
        self._values[key] = value, weight
        self.weight += weight
        while self.weight > self.limit:
            self.weight -= self._values.popitem(last=False)[1][1]


class Room:
    """Room for pixels: a thread that wants more than is left waits."""

    def __init__(self, size: int) -> None:
        self.size = self.left = size
        self._changed = threading.Condition()

    @contextmanager
    def of(self, n: int) -> Iterator[None]:
        """Take room for so many, all there is at most, for a while."""
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
class Source:
    """Where a picture's pixels come from.

    Attributes
    ----------
    name : str
        What people call it.
    tag : str
        Of the content: changes when the file does.
    width, height : int
        Upright, pixels.
    read : callable
        Decodes it: (h, w, 3) uint8, uint16 or float32.
    preview : callable, optional
        Decodes it for a size, perhaps smaller than it is (see :func:`liaam.io.read_preview`).
    raw : bool
        Whether its values are linear light.
    """

    name: str
    tag: str
    width: int
    height: int
    read: Callable[[], np.ndarray]
    preview: Callable[[int], np.ndarray] | None = None
    raw: bool = False


def source_of(path: Path, max_pixels: int) -> Source:
    """Picture of a file.

    Raises
    ------
    ImageError
        If it is no image, or too large.
    """
    tag = file_tag(path)
    width, height = _of_file(path, image_size)

    def read(read_some: Callable[[Path], np.ndarray]) -> np.ndarray:
        image = _of_file(path, read_some)
        if file_tag(path) != tag:
            raise Refusal(409, f"{path.name} has changed since: look at it again, and fit it again")
        return image

    return Source(
        path.name,
        tag,
        width,
        height,
        lambda: read(lambda file: read_image(file, max_pixels)),
        lambda size: read(lambda file: read_preview(file, size, max_pixels)),
        is_raw(path),
    )


def file_tag(path: Path) -> str:
    """What a file's change shows by."""
    try:
        facts = path.stat()
    except OSError as fault:
        raise ImageError(f"{path.name} cannot be read ({fault.strerror or fault}): put it back, or reload") from fault
    return f"{facts.st_mtime_ns:x}-{facts.st_size:x}"


def _of_file(path: Path, read: Callable[[Path], V]) -> V:
    """What is read of a file; errors name it without its folder."""
    try:
        return read(path)
    except ImageError as fault:
        raise ImageError(str(fault).replace(f"{path.parent}{os.sep}", "")) from fault


class Pictures:
    """Decoded pictures, and what was made of them for the page; may be used from any thread.

    Parameters
    ----------
    decoded, encoded : int
        Bytes that may be kept.
    """

    def __init__(self, decoded: int = DECODED_BYTES, encoded: int = ENCODED_BYTES) -> None:
        self._decoded: Kept[Hashable, np.ndarray] = Kept(decoded, lambda image: image.nbytes)
        self._encoded: Kept[Hashable, bytes] = Kept(encoded, len)
        # A page asks for many thumbnails at once, and pictures on their way are as large as those that are kept.
        self.room = Room(DECODED_AT_ONCE)

    def pixels(self, source: Source) -> np.ndarray:
        """Decoded picture, three channels. Shared: nobody may write to it."""
        from liaam.photometry.encoding import as_colour

        def read() -> np.ndarray:
            with self.room.of(source.width * source.height):
                return as_colour(source.read(), source.name)

        return self._decoded.get((source.name, source.tag), read)

    def keep(self, source: Source, image: np.ndarray) -> None:
        """Keep a picture that is decoded already."""
        self._decoded.put((source.name, source.tag), image)

    def image(self, source: Source, size: int) -> bytes:
        """JPEG to look at, its longest side at most ``size``."""
        return self._encoded.get(("image", source.name, source.tag, size), lambda: self._image(source, size))

    def thumbnail(self, source: Source) -> bytes:
        """Small JPEG."""
        return self.image(source, THUMBNAIL)

    def chroma(self, source: Source, size: int, response: Response) -> bytes:
        """Chroma of a picture (see :func:`chroma`)."""
        key = ("chroma", source.name, source.tag, size, response)
        return self._encoded.get(key, lambda: chroma_bytes(self.pixels(source), size, response, source.name))

    def _image(self, source: Source, size: int) -> bytes:
        # Half as large as it is or smaller: there may be a short way, which does not depend on what is kept.
        if source.preview is not None and 2 * size <= max(source.width, source.height):
            with self.room.of(source.width * source.height):
                return _displayed(source, source.preview(size), size)
        return _displayed(source, self.pixels(source), size)


def _displayed(source: Source, image: np.ndarray, size: int) -> bytes:
    return jpeg_bytes(shown(image, fitted_size(source.width, source.height, size), source.raw))


def checked_size(text: str | None, otherwise: int) -> int:
    """Read a size that the page asks for."""
    if text is None:
        return otherwise
    if not (text.isascii() and text.isdigit() and len(text) < 7):
        raise Refusal(422, f"size {text[:20]!r} is no whole number of pixels: give the longest side, such as 1024")
    return int(np.clip(int(text), *SIZES))


def fitted_size(width: int, height: int, size: int) -> tuple[int, int]:
    """Width and height of a picture made so small that its longest side is at most ``size``."""
    factor = min(1.0, size / max(width, height))
    return max(1, round(width * factor)), max(1, round(height * factor))


def shown(image: np.ndarray, size: tuple[int, int], raw: bool = False) -> np.ndarray:
    """Picture to look at, (height, width, 3) uint8, of a (width, height), which may not be larger than it is.

    Pixels are averaged, so centres of pixels go where they belong: x to (x + 0.5) * width' / width - 0.5.
    """
    from liaam.drawing import as_picture
    from liaam.photometry import linear_to_srgb
    from liaam.photometry.encoding import stored_values

    if raw:  # linear light: averaged as such, then encoded as screens want it
        return as_picture(linear_to_srgb(np.clip(averaged(stored_values(image), size), 0.0, 1.0)))
    return averaged(as_picture(image), size)


def averaged(image: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Picture of a (width, height) not more than its own, its pixels averaged; of the same type."""
    import cv2

    if (image.shape[1], image.shape[0]) == size:
        return image
    return cv2.resize(np.ascontiguousarray(image), size, interpolation=cv2.INTER_AREA)


def jpeg_bytes(image: np.ndarray) -> bytes:
    """JPEG of a picture (h, w, 3) uint8, with all of its colours' resolution."""
    import cv2

    options = [
        cv2.IMWRITE_JPEG_QUALITY,
        JPEG_QUALITY,
        cv2.IMWRITE_JPEG_SAMPLING_FACTOR,
        cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444,
    ]
    return _encoded(".jpg", image, options)


def png_bytes(image: np.ndarray, compression: int = 1) -> bytes:
    """PNG of a picture (h, w, 3) or (h, w, 4) uint8."""
    import cv2

    return _encoded(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, compression])


def _encoded(suffix: str, image: np.ndarray, options: list[int]) -> bytes:
    import cv2

    order = cv2.COLOR_RGBA2BGRA if image.shape[2] == 4 else cv2.COLOR_RGB2BGR
    return cv2.imencode(suffix, cv2.cvtColor(np.ascontiguousarray(image), order), options)[1].tobytes()


def chroma(image: np.ndarray, size: int, response: Response = "srgb", name: str = "image") -> np.ndarray:
    """Log-chromaticities of a picture, averaged to a size in linear light.

    The invariant image of any angle is ``cos(theta) * chroma[..., 0] + sin(theta) * chroma[..., 1]``, since the rows of
    L(theta) sum to zero.

    Parameters
    ----------
    image : (h, w, 3) uint8, uint16 or float array
    size : int
        Of the longest side, pixels, at most; somewhat less is taken where blocks then fill the picture better.
    response : Response
        Of the image's camera.
    name : str
        What to call the image in errors.

    Returns
    -------
    (h', w', 2) int16
        log R/B and log G/B in steps of :data:`CHROMA_STEP`; :data:`CHROMA_MASKED` where any pixel of a block is dark or
        saturated.

    Raises
    ------
    ImageError
        If the picture is grey.
    """
    from liaam.photometry.encoding import as_colour, encode, refuse_grey

    image = as_colour(image, name)
    refuse_grey(image, name, "there is no colour to make an invariant image of")
    encoded = encode(image, "log", response, reduce=block_size(image.shape[1], image.shape[0], size))
    ratios = (encoded[..., :2] - encoded[..., 2:3]) / np.float32(CHROMA_STEP)
    numbers = np.rint(np.clip(ratios, -32767, 32767)).astype(np.int16)
    numbers[encoded[..., 3] <= 0] = CHROMA_MASKED
    return numbers


def chroma_bytes(image: np.ndarray, size: int, response: Response = "srgb", name: str = "image") -> bytes:
    """Chroma for the page, all little-endian.

    Width and height as uint32; how much of the picture they cover, from its left and upper border, as float32, pixels
    of the picture (blocks need not fill it); then :func:`chroma` row by row.
    """
    numbers = chroma(image, size, response, name)
    (height, width), (rows, columns) = numbers.shape[:2], image.shape[:2]
    block = block_size(columns, rows, size)
    header = struct.pack("<IIff", width, height, min(width * block, columns), min(height * block, rows))
    return header + numbers.astype("<i2").tobytes()


def block_size(width: int, height: int, size: int) -> float:
    """Size of square blocks that fill a picture with the least rest, the longest side being at most ``size`` blocks."""
    longest, shortest = max(width, height), min(width, height)
    if longest <= size:
        return 1.0
    counts = np.arange(max(1, int(0.9 * size)), size + 1)
    across = shortest * counts / longest
    rest = (across - np.floor(across + 1e-6)) / np.maximum(across, 1.0)
    # Of equals the finest.
    return longest / float(counts[::-1][np.argmin(np.round(rest[::-1], 6))])
