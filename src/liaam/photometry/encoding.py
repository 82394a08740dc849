"""Encodings: the channels in which a method compares images (docs/explanation/theory.md, "One objective").

An image is encoded to float32 channels: usually three colours, and last the weight of the pixel (1 usable, 0 not).
This module alone defines the result for NaN, black, saturated, 16-bit and float images.
"""

import os
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from liaam import _core, encoding_constants
from liaam.encoding_constants import ALL, BRIGHTNESS, UNUSABLE
from liaam.errors import ImageError, LiaamError, MethodError
from liaam.io.images import as_pixels
from liaam.photometry.features import Encoder
from liaam.photometry.invariant import LUMINANCE
from liaam.photometry.response import Response, from_linear, linear_to_srgb, log_slope, srgb_to_linear, to_linear

ENCODINGS = tuple(encoding_constants.ENCODINGS)
"""Names of the encodings (:data:`liaam.encoding_constants.ENCODINGS`)."""

Encoding = str | Encoder
"""A name of :data:`ENCODINGS`, or a function of the user with a model's projection."""

# Light that sRGB stores as these values, both between two 8-bit values: below the first a logarithm is unusable because
# of noise and JPEG rounding, and above the second a channel counts as clipped. See `usable_range`.
DARK = 7.5 / 255
SATURATED = 250.5 / 255
# Largest change of the logarithm of light by one step of an integer type at which it can be measured: that of 8-bit
# sRGB at DARK. Linear light in 8 bits reaches it at the same stored value, which is much brighter.
COARSEST = 1 / 7.5
BRIGHTEST = 1e6  # upper bound of stored values and linear light of float images
FLOATS_AT_ONCE = 4_000_000  # pixels of a picture of floats whose light is worked out at a time, 40 bytes a pixel


def as_colour(image: Any, name: str = "image") -> np.ndarray:
    """Validate an image (h, w), or (h, w, c) of 1, 3 or 4 channels, and convert it to (h, w, 3), floats to float32.

    An image of Pillow, the bytes of an image file and an open file are read like a file, upright. Integers range from 0
    to their type's maximum, floats from 0 to 1. A fourth channel (alpha) is dropped. Raises an ImageError that begins
    with the name if the array is not an image of at least 8 by 8 pixels.
    """
    if isinstance(image, str | os.PathLike):
        raise ImageError(f"{name}: {os.fspath(image)!r} is a path, not an image; give liaam.read_image(path)")
    image = np.asarray(as_pixels(image, name))
    if image.ndim == 2:
        image = image[..., None]
    if image.ndim != 3 or image.shape[2] not in (1, 3, 4):
        raise ImageError(f"{name}: an array of shape {image.shape} is not an image; give (height, width, 3)")
    if min(image.shape[:2]) < 8:
        size = f"{image.shape[1]}×{image.shape[0]}"
        raise ImageError(f"{name}: the image is {size} pixels, too small to fit to; at least 8×8 are needed")
    image = _native(image, name)
    if image.dtype.kind == "f":
        _check_range(image, name)
        image = image.astype(np.float32, copy=False)
    return np.repeat(image, 3, axis=2) if image.shape[2] == 1 else image[..., :3]


def _native(image: np.ndarray, name: str) -> np.ndarray:
    """Pixels in this machine's byte order, each at a multiple of its size; raises if their type is not supported."""
    image = image.astype(image.dtype.newbyteorder("="), copy=False)
    if image.dtype not in (np.uint8, np.uint16, np.float16, np.float32, np.float64):
        raise ImageError(f"{name}: pixels of type {image.dtype} are not supported; use uint8, uint16 or float")
    return image if _is_aligned(image) else image.copy()


def _is_aligned(image: np.ndarray) -> bool:
    """Whether all numbers begin at multiples of their size: fields of packed records and views of bytes may not.

    The core reads whole numbers, and counts strides in numbers.
    """
    return image.flags.aligned and not any(stride % image.itemsize for stride in image.strides)


def _three_channels(image: np.ndarray) -> np.ndarray:
    """Check an array that is encoded directly, and give its pixels as :func:`_native` does."""
    if image.ndim != 3 or image.shape[2] != 3:
        raise ImageError(f"image: an array of shape {image.shape} cannot be encoded; give (height, width, 3)")
    return _native(image, "image")


def _sparse(image: np.ndarray) -> np.ndarray:
    """Return about 64 by 64 pixels of an image, spread over it."""
    return image[:: max(1, image.shape[0] // 64), :: max(1, image.shape[1] // 64)]


def _check_range(image: np.ndarray, name: str) -> None:
    """Reject floats that range to 255 or similar; a few values above 1 (highlights) are accepted."""
    sparse = _sparse(image)
    finite = sparse[np.isfinite(sparse)]
    if finite.size and np.percentile(finite, 90) > 4.0:
        raise ImageError(
            f"{name}: its float values reach {finite.max():g}, but float images range from 0 to 1; divide by the "
            "largest possible value (255 or 65535)"
        )


def is_grey(image: np.ndarray) -> bool:
    """Whether all three channels are equal everywhere (a grey image stored as colour)."""
    # A few pixels identify most colour images; the whole image is compared only if they are grey.
    if image.dtype.kind == "u":
        return _core.has_equal_channels(_sparse(image)) and _core.has_equal_channels(image)
    for part in (_sparse(image), image):
        if not all(np.array_equal(part[..., i], part[..., i + 1], equal_nan=True) for i in (0, 1)):
            return False
    return bool(np.isfinite(image).any())  # an image of NaN only is not grey


def refuse_unscaled(image: np.ndarray, name: str, response: Response) -> None:
    """Raise an error if 16-bit values (h, w, c) are those of fewer bits, as scientific cameras often store them.

    Dim images of linear light are accepted, since their scale hardly matters.
    """
    if image.dtype != np.uint16 or _sparse(image).max() > 4095:
        return
    largest = int(image.max())
    reach = f"{name}: its 16-bit values reach only {largest} of 65535"
    if 0 < largest < 256:
        raise ImageError(f"{reach}; convert 8-bit values to uint8")
    if 0 < largest < 4096 and response != "linear":
        raise ImageError(
            f"{reach}, which is almost black; multiply 12-bit values by 16, or set the response to linear if they "
            "are linear light"
        )


def refuse_grey(image: np.ndarray, name: str, need: str, error: type[LiaamError] = ImageError) -> None:
    """Raise an error if an image is grey; ``need`` is the reason in the message."""
    if is_grey(image):
        raise error(f"{name}: the image is grey (three equal channels); {need}")


def stored_values(image: np.ndarray, dtype: type = np.float32) -> np.ndarray:
    """Convert stored values to finite floats from 0 to 1; integers are divided by their type's maximum."""
    values = image.astype(dtype)
    if image.dtype.kind != "u":
        return np.nan_to_num(values, copy=False)
    values /= dtype(np.iinfo(image.dtype).max)
    return values


@lru_cache(maxsize=64)
def usable_range(response: Response, dtype: str | None = None) -> tuple[float, float]:
    """Return the lowest and the highest stored value, in [0, 1], between which a logarithm of light is usable.

    Both are limits of light relative to the light of white, so that an image has the same usable pixels whatever its
    response and its number of bits. Measurements of single images name their integer type too: the lowest value is then
    higher where a step of that type changes the light by more than :data:`COARSEST`.
    """
    low = DARK
    high = SATURATED
    if response != "srgb":
        white = to_linear(np.array(1.0), response)
        low, high = from_linear(white * srgb_to_linear(np.array([DARK, SATURATED])), response).tolist()
    if dtype is None or np.dtype(dtype).kind != "u":
        return low, high
    top = np.iinfo(dtype).max
    coarse = np.flatnonzero(log_slope(np.arange(1, top + 1) / top, response) / top > COARSEST)
    if not coarse.size:
        return low, high
    coarsest = coarse[-1] + 1  # the first value is 1
    return max(low, (coarsest + 0.5) / top), high


def exposure_faults(pixels: np.ndarray, response: Response = "srgb") -> tuple[float, float]:
    """Fractions of pixels (n, 3), stored values, that are dark, and that are clipped, in any channel.

    A pixel can count in both, and NaN counts as dark. For the limits see :func:`usable_range`.
    """
    values = stored_values(pixels, np.float64)
    low, high = usable_range(response)
    return float((values < low).any(axis=1).mean()), float((values > high).any(axis=1).mean())


def encode(
    image: np.ndarray,
    encoding: Encoding,
    response: Response = "srgb",
    blur: float = 0.0,
    reduce: float = 1.0,
    turn: np.ndarray | None = None,
    pixel: float = 1.0,
    start: tuple[float, float] = (0.0, 0.0),
) -> np.ndarray:
    """Encode an image for fitting.

    Parameters
    ----------
    image : (h, w, 3) uint8, uint16 or float32
        Stored values. Integers range from 0 to the type's maximum.
    encoding : {"value", "log", "orientation", "soft"} or Encoder
        See :data:`ENCODINGS`.
    response : Response
        Map from stored values to linear light.
    blur : float
        Standard deviation, pixels after reduction, of a Gaussian blur of the *encoded* channels. Blurring a logarithm
        keeps shading additive. With a blur of 2 pixels, ``li`` has a median error of 5.4 % on the spot protocol, and of
        6.3 % if linear light is blurred.
    reduce : float
        Side of the blocks of pixels that are averaged in linear light, at least 1. Blocks may cut through pixels;
        incomplete blocks at the right and lower border are dropped.
    turn : (2, 2) float, optional
        Rotation from the image's to the object's axes, to which directions refer; the identity by default.
    pixel : float
        Size of a pixel, after reduction, in pixels of the reference frame, to which gradients of ``soft`` refer.
    start : (x, y)
        Start of the first block, pixels; 0 is the border of the first pixel.

    Returns
    -------
    ((h - y) // reduce, (w - x) // reduce, c + 1) float32
        Encoded channels, always finite, and the weight of the pixel in {0, 1}. Pixels with NaN have weight 0; for
        ``log`` also those with a dark or saturated channel (:func:`usable_range`). For ``soft`` the six channels are
        the gradient's two components g / sqrt(|g|^2 + SOFTNESS^2), log R, log G, log B, and the weight of these three
        (0 to 1). The gradient is usable in dark and saturated pixels too.

    Raises
    ------
    ImageError
        If the array has another shape or type.
    """
    channels = encode_means(
        block_means(image, encoding, response, reduce, start), encoding, response, blur, turn, pixel
    )
    return np.concatenate([channels[..., : width_of(encoding)], channels[..., -1:]], axis=2)


class Means(NamedTuple):
    """Linear light of blocks of pixels."""

    light: np.ndarray  # (rows, columns, 4) float32: R, G, B, and the fraction of usable pixels
    finite: np.ndarray | None = None  # (rows, columns) float32: the fraction of finite pixels; None if all are finite
    grey: bool = False  # whether the image is grey, so that colours are unusable

    def averaged(self, start: tuple[float, float], size: float, shape: tuple[int, int]) -> "Means":
        """Average blocks of ``size`` by ``size`` blocks; the first starts at ``start`` (x, y)."""
        if size == 1 and start[0] == int(start[0]) and start[1] == int(start[1]):
            x = int(start[0])
            y = int(start[1])
            part = np.s_[y : y + shape[0], x : x + shape[1]]
            return self._replace(light=self.light[part], finite=None if self.finite is None else self.finite[part])
        light = _core.value_means(self.light, *start, size, *shape)
        finite = self.finite
        if finite is not None:
            finite = _core.value_means(np.ascontiguousarray(finite[..., None]), *start, size, *shape)[..., 0]
        return self._replace(light=light, finite=finite)


def block_means(
    image: np.ndarray,
    encoding: Encoding,
    response: Response,
    size: float,
    start: tuple[float, float] = (0.0, 0.0),
    grey: bool | None = None,
) -> Means:
    """Average an image in linear light over complete blocks; the encoding defines the usable pixels.

    Blocks of side ``size``, at least 1, may cut through pixels. ``grey`` says whether the image is grey; by default it
    is found out. For all other parameters see :func:`encode`.
    """
    if not callable(encoding) and encoding not in ENCODINGS:
        raise MethodError(f"unknown encoding {encoding!r}; choose from {', '.join(ENCODINGS)}")
    image = _three_channels(image)
    rows, columns = _blocks_in(image, size, start)
    if grey is None:
        grey = encoding == "soft" and is_grey(image)
    if image.dtype.kind == "u":
        table = light_table(image.dtype.str, encoding, response)
        return Means(_core.stored_means(image, table, *start, size, rows, columns), None, grey)
    at_once = max(1, int(FLOATS_AT_ONCE / (image.shape[1] * size)))  # rows of blocks
    parts = []
    for first in range(0, max(rows, 1), at_once):
        n_rows = min(at_once, rows - first)
        y = start[1] + first * size
        top = int(y)
        bottom = int(np.ceil(y + n_rows * size + 1e-6))
        pixels = light_of_floats(image[top:bottom], encoding, response)
        parts.append(pixels.averaged((start[0], y - top), size, (n_rows, columns)))
    if len(parts) == 1:
        return parts[0]._replace(grey=grey)
    finite = None
    if any(part.finite is not None for part in parts):
        finite = [np.ones(part.light.shape[:2], np.float32) if part.finite is None else part.finite for part in parts]
        finite = np.concatenate(finite)
    return Means(np.concatenate([part.light for part in parts]), finite, grey)


def _blocks_in(image: np.ndarray, size: float, start: tuple[float, float]) -> tuple[int, int]:
    """Return the numbers of rows and columns of complete blocks in an image."""
    rows, columns = (int((n - first) / size + 1e-9) for n, first in zip(image.shape, start[::-1], strict=False))
    return rows, columns


def block_brightness(
    image: np.ndarray,
    response: Response,
    size: float,
    start: tuple[float, float] = (0.0, 0.0),
    *,
    grey: bool = False,
) -> tuple[np.ndarray, np.ndarray | None]:
    """Average the brightness of an image, whose logarithm has the gradients of ``soft``, over complete blocks.

    If the image is known to be ``grey``, that takes less time; for the other parameters see :func:`block_means`.
    Return (rows, columns) float32, and the fraction of finite pixels; None if all are finite.
    """
    if image.dtype.kind != "u":
        means = block_means(image, "soft", response, size, start, grey=False)
        return means.light[..., :3] @ BRIGHTNESS.astype(np.float32), means.finite
    image = _three_channels(image)
    tables = brightness_tables(image.dtype.str, response, grey)
    return _core.stored_brightness(image, tables, *start, size, *_blocks_in(image, size, start)), None


def in_all_channels(holds: np.ndarray) -> np.ndarray:
    """Return where a mask (h, w, 3) holds in all channels; ``all(axis=-1)`` takes ten times as long."""
    return holds[..., 0] & holds[..., 1] & holds[..., 2]


def light_of_floats(image: np.ndarray, encoding: Encoding, response: Response) -> Means:
    """Return the linear light of each pixel of an image of floats (h, w, 3)."""
    finite = in_all_channels(np.isfinite(image))
    stored = np.clip(image, 0.0, BRIGHTEST)
    if not finite.all():
        stored = np.where(finite[..., None], stored, np.float32(0.0))
    usable = finite
    if is_logarithmic(encoding):
        low, high = usable_range(response)
        usable = finite & in_all_channels((stored >= low) & (stored <= high))
    # A curve may map highlights of float images beyond the range of single precision.
    linear = np.minimum(to_linear(stored, response), BRIGHTEST).astype(np.float32, copy=False)
    light = np.concatenate([linear, usable[..., None]], axis=2, dtype=np.float32)
    return Means(light, None if finite.all() else finite.astype(np.float32))


def encode_means(
    means: Means,
    encoding: Encoding,
    response: Response,
    blur: float = 0.0,
    turn: np.ndarray | None = None,
    pixel: float = 1.0,
) -> np.ndarray:
    """Encode averaged light to eight channels (h, w, 8) float32, as the core samples them.

    These are the encoding's channels (:func:`width_of`), zeros, and last the weight of the pixel in {0, 1}. The means
    are from :func:`block_means` for the same encoding; for the other parameters see :func:`encode`.
    """
    if callable(encoding):  # unusable pixels hardly count in the blur
        usable = (means.light[..., 3] > ALL).astype(np.float32)
        values = encoding(np.ascontiguousarray(linear_to_srgb(means.light[..., :3]), np.float32))
        channels = np.zeros((*usable.shape, 8), np.float32)
        channels[..., : values.shape[2]] = values
        channels[..., -1] = usable
        if blur > 0.0:
            weight = usable + np.float32(UNUSABLE)
            planes = np.moveaxis(channels, -1, 0) * weight
            planes[-1] = weight
            blurred = _core.blur_planes(np.ascontiguousarray(planes), blur)
            channels[..., :-1] = np.moveaxis(blurred[:-1] / blurred[-1], 0, -1)
        return channels
    light = np.ascontiguousarray(means.light)
    finite = means.finite
    finite = None if finite is None else np.ascontiguousarray(finite)
    axes = (1.0, 0.0, 0.0, 1.0) if turn is None else tuple(np.ravel(turn).tolist())
    number = ENCODINGS.index(encoding)
    return _core.encode(light, finite, means.grey, number, log_floor(response), float(blur), axes, float(pixel))


def width_of(encoding: Encoding) -> int:
    """Number of channels of an encoding, without the weight of the pixel."""
    return encoding_constants.ENCODINGS[encoding].channels if isinstance(encoding, str) else encoding.width


def is_logarithmic(encoding: Encoding) -> bool:
    """Return whether dark and saturated pixels are unusable in an encoding."""
    return isinstance(encoding, str) and encoding_constants.ENCODINGS[encoding].is_logarithmic


@lru_cache(maxsize=16)
def _table(dtype: str, encoding: str, response: Response) -> np.ndarray:
    """Look-up table of linear light or of the encoding ``value`` for an integer pixel type."""
    linear = to_linear(np.linspace(0.0, 1.0, np.iinfo(dtype).max + 1), response)
    return (linear if encoding == "linear" else linear_to_srgb(linear)).astype(np.float32)


@lru_cache(maxsize=16)
def light_table(dtype: str, encoding: Encoding, response: Response) -> np.ndarray:
    """Four numbers for each channel and stored value of an integer type, (3, n, 4) float32.

    Their products over the channels of a pixel are its linear light R, G, B, and 1 if the encoding can use all three
    values, else 0.
    """
    top = np.iinfo(dtype).max
    values = np.arange(top + 1)
    table = np.ones((3, top + 1, 4), np.float32)
    low, high = usable_range(response) if is_logarithmic(encoding) else (0.0, 1.0)
    table[..., 3] = (low * top <= values) & (values <= high * top)
    table[range(3), :, range(3)] = _table(dtype, "linear", response)
    return table


@lru_cache(maxsize=16)
def brightness_tables(dtype: str, response: Response, grey: bool) -> np.ndarray:
    """What each channel and stored value of an integer type adds to a pixel's brightness, (3, n) float32.

    For grey images that of all channels together, (1, n).
    """
    weights = BRIGHTNESS.sum(keepdims=True) if grey else BRIGHTNESS
    return np.outer(weights, _table(dtype, "linear", response)).astype(np.float32)


@lru_cache(maxsize=16)
def log_floor(response: Response) -> float:
    """Lower bound of linear light that keeps logarithms finite, below every usable pixel."""
    return 0.5 * float(to_linear(np.array(usable_range(response)[0]), response))


def value_luminance(image: np.ndarray, response: Response = "srgb") -> np.ndarray:
    """Luminance of the encoding ``value``, (h, w) float32; see :func:`encode`."""
    image = _three_channels(image)
    if image.dtype.kind != "u":
        return encode(image, "value", response)[..., :3] @ LUMINANCE[0].astype(np.float32)
    tables = np.outer(LUMINANCE[0], _table(image.dtype.str, "value", response)).astype(np.float32)
    return _core.stored_luminance(image, tables)
