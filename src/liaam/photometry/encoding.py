"""Encodings: what a fitting method measures in an image (DESIGN section 1, column "encoding").

A stored image becomes float32 channels: the encoded ones, three colours for most, and a last one that says how
far the pixel may be trusted (1 usable, 0 not). NaN, black, saturated, 16-bit and float images all
get a defined answer here and nowhere else.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from liaam.errors import ImageError, LiaamError, MethodError
from liaam.photometry.invariant import LUMINANCE
from liaam.photometry.response import Response, linear_to_srgb, to_linear

ENCODINGS = ("value", "log", "orientation", "soft")
"""``value``: sRGB-encoded values in [0, 1]; ``log``: natural logarithm of linear light; ``orientation``: cosine
and sine of the direction of luminance's gradient, third channel zero (Tzimiropoulos, Zafeiriou and Pantic,
"Subspace learning from image gradient orientations", PAMI 2012); ``soft``: the gradient of log brightness, softly
normalised, log of linear light, and whether that log says anything (six channels, see :func:`encode`)."""

BRIGHTNESS = np.full(3, 1.0 / 3.0)
"""Weights of linear R, G and B in the brightness that ``soft`` takes gradients of. The eye's luminance leans on green
and throws red and blue away: with equal weights errors by noise are a sixth smaller (generated scenes, efficiency 0.80
instead of 0.67), and on photographs as large."""

SOFTNESS = 0.1
"""Gradient of log brightness, per pixel of the object's own frame, at which its length is half normalised away.
Measured on real faces: 0.025 to 0.1 alike, the larger a little ahead with persons that a model has not seen."""

LOG_FLOOR = 0.004
"""Added to linear brightness before its logarithm, so that the noise of black makes no strong gradients."""

FLAT = 1e-4
"""Gradient of luminance per pixel, in values of [0, 1], below which its direction fades to nothing: a fortieth
of an 8-bit step. The published orientation has no such limit, and no answer where a picture is flat."""

DARK = 8 / 255
"""Stored value below which a logarithm says nothing (noise and JPEG rounding), in any channel."""

SATURATED = 250 / 255
"""Stored value above which a channel is taken as clipped."""


def as_colour(image: np.ndarray, name: str = "image") -> np.ndarray:
    """Check a user's image array and give it three channels.

    Parameters
    ----------
    image : (h, w), (h, w, 1), (h, w, 3) or (h, w, 4) uint8, uint16 or float
        Integer images count from 0 to their type's maximum, floats from 0 to 1. A fourth channel
        (alpha) is dropped.
    name : str
        What to call the image in an error.

    Returns
    -------
    (h, w, 3) array of the same type (floats as float32)

    Raises
    ------
    ImageError
        If the array is no image of at least 8 by 8 pixels.
    """
    image = np.asarray(image)
    image = image.astype(image.dtype.newbyteorder("="), copy=False)
    if image.ndim == 2:
        image = image[..., None]
    if image.ndim != 3 or image.shape[2] not in (1, 3, 4):
        raise ImageError(f"{name}: an array of shape {image.shape} is no image; give (height, width, 3)")
    if min(image.shape[:2]) < 8:
        size = f"{image.shape[1]}×{image.shape[0]}"
        raise ImageError(f"{name}: the image is {size} pixels, too small to fit to; at least 8×8 are needed")
    if image.dtype == np.bool_ or image.dtype.kind not in "uf" or image.dtype.itemsize > 8:
        raise ImageError(f"{name}: pixels of type {image.dtype} are not supported; use uint8, uint16 or float")
    if image.dtype.kind == "u" and image.dtype not in (np.uint8, np.uint16):
        raise ImageError(f"{name}: pixels of type {image.dtype} are not supported; use uint8, uint16 or float")
    if image.dtype.kind == "f":
        _check_range(image, name)
        image = image.astype(np.float32, copy=False)
    return np.repeat(image, 3, axis=2) if image.shape[2] == 1 else image[..., :3]


def _check_range(image: np.ndarray, name: str) -> None:
    """Refuse floats that count to 255 or the like; a few values above 1 (highlights) are fine."""
    sparse = image[:: max(1, image.shape[0] // 64), :: max(1, image.shape[1] // 64)]
    finite = sparse[np.isfinite(sparse)]
    if finite.size and np.percentile(finite, 90) > 4.0:
        raise ImageError(
            f"{name}: its float values reach {finite.max():g}, but float images count from 0 to 1; divide by the "
            "largest possible value (255 or 65535)"
        )


def is_grey(image: np.ndarray) -> bool:
    """Tell whether all three channels are equal everywhere (a grey picture stored as colour)."""
    sparse = image[:: max(1, image.shape[0] // 64), :: max(1, image.shape[1] // 64)]
    # Most colour pictures are told by a few pixels; only a suspect is looked at in full.
    for part in (sparse, image):
        nan = part.dtype.kind == "f"
        if not all(np.array_equal(part[..., i], part[..., i + 1], equal_nan=nan) for i in (0, 1)):
            return False
    return bool(np.isfinite(image).any())  # a picture of holes is nothing, not grey


def refuse_grey(image: np.ndarray, name: str, need: str, error: type[LiaamError] = ImageError) -> None:
    """Raise an error about a grey picture where colours are needed; ``need`` says what needs them."""
    if is_grey(image):
        raise error(f"{name}: the picture is grey (three equal channels); {need}")


def stored_values(image: np.ndarray, dtype: type = np.float32) -> np.ndarray:
    """Stored values counted from 0 to 1, finite, in a float type; integers count to their type's maximum."""
    top = np.iinfo(image.dtype).max if image.dtype.kind == "u" else 1.0
    return np.nan_to_num(image.astype(dtype) / dtype(top))


def exposure_faults(pixels: np.ndarray) -> tuple[float, float]:
    """Shares of pixels whose logarithm says nothing because a channel is dark, or because one is clipped.

    Parameters
    ----------
    pixels : (n, 3) uint8, uint16 or float32
        Stored values.

    Returns
    -------
    dark, clipped : float
        Shares, 0 to 1; a pixel may count in both, and one that is not a number counts as dark.
    """
    values = stored_values(pixels, np.float64)
    return float((values < DARK).any(axis=1).mean()), float((values > SATURATED).any(axis=1).mean())


def encode(
    image: np.ndarray,
    encoding: str,
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
        Stored values. Integers count from 0 to the type's maximum.
    encoding : {"value", "log", "orientation", "soft"}
        See :data:`ENCODINGS`.
    response : Response
        How stored values relate to linear light.
    blur : float
        Standard deviation, in pixels after reduction, of a Gaussian blur of the *encoded* channels, 0 for
        none. Blurring a logarithm keeps shading additive, so the invariant of a blurred image is the blurred
        invariant; blurring linear light mixes lit with shadowed pixels and loses that (measured on the spot
        protocol: at 2 pixels, ``li`` has a median of 5.4 % this way and 6.3 % the other).
    reduce : float
        Average blocks of this many pixels across into one, in linear light (at least 1; blocks may cut through
        pixels); a rest at the right and lower border is dropped.
    turn : (2, 2) float, optional
        Rotation from the image's to the object's axes, in which directions are given; none if left out.
    pixel : float
        Size of a pixel, after reduction, in pixels of the object's own frame; gradients of ``soft`` are per pixel of
        that frame, so that their normalisation does not depend on the object's size in the picture.
    start : (x, y)
        Where the first block begins, pixels; 0 is the border of the first pixel.

    Returns
    -------
    ((h - y) // reduce, (w - x) // reduce, c + 1) float32
        Encoded channels, always finite, and the usable weight in {0, 1}: not NaN, and for
        ``log`` neither dark nor saturated in any channel. For ``soft`` the six channels are the gradient's two
        components g / sqrt(|g|^2 + SOFTNESS^2), log R, log G, log B, and how far these three may be trusted (0 to 1);
        the gradient may be used in the dark and in highlights too.
    """
    if encoding not in ENCODINGS:
        raise MethodError(f"encoding {encoding!r} does not exist; there are {', '.join(ENCODINGS)}")
    if encoding == "soft":
        return _encode_soft(image, response, blur, _Blocks.of(image, reduce, start), turn, pixel)
    if reduce > 1:
        means = _block_means(image, encoding, response, _Blocks.of(image, reduce, start))
        colour, usable = _encode_linear(means[..., :3], encoding, response), means[..., 3] > ALL
    else:
        stored, usable = _stored_and_usable(image, encoding)
        is_integer = image.dtype.kind == "u"
        colour = (
            _table(image.dtype.str, encoding, response)[image] if is_integer else _encode(stored, encoding, response)
        )
    if blur > 0.0:
        colour = _blurred(colour, usable, blur)
    if encoding == "orientation":
        colour = _orientation(colour @ LUMINANCE[0].astype(np.float32), turn)
    return np.concatenate([colour, usable[..., None].astype(np.float32)], axis=2)


ALL = 0.999
"""Share of a block's pixels above which all are meant."""


class _Blocks(NamedTuple):
    """Blocks of pixels to be averaged: where the first begins, their size in pixels, and how many rows and columns."""

    start: tuple[float, float]
    size: float
    shape: tuple[int, int]

    @classmethod
    def of(cls, image: np.ndarray, size: float, start: tuple[float, float]) -> "_Blocks":
        """As many as the image holds."""
        rows, columns = (int((n - first) / size + 1e-9) for n, first in zip(image.shape, start[::-1], strict=False))
        return cls(start, size, (rows, columns))


def _block_means(image: np.ndarray, encoding: str, response: Response, blocks: _Blocks) -> np.ndarray:
    """Mean linear R, G and B of blocks, and the shares of their pixels usable for the encoding, and finite.

    Returns
    -------
    (rows, columns, 5) float32
        Without the last where all are finite.
    """
    from liaam.photometry import averaging  # numba: imported when first needed

    if image.dtype.kind == "u":
        low, high = _usable_range(image.dtype) if encoding == "log" else (0, np.iinfo(image.dtype).max)
        table = _table(image.dtype.str, "linear", response)
        return averaging.stored_means(np.ascontiguousarray(image), table, (low, high), *blocks)
    stored, usable = _stored_and_usable(image, encoding)
    masks = np.stack([usable, _stored_and_usable(image, "value")[1]], axis=-1)
    return averaging.value_means(
        np.concatenate([_linear(image, stored, response), masks], axis=2, dtype=np.float32), *blocks
    )


def _encode_soft(
    image: np.ndarray, response: Response, blur: float, blocks: _Blocks, turn: np.ndarray | None, pixel: float
) -> np.ndarray:
    """Encode for ``soft``: gradients of log brightness, softly normalised, and log RGB with its own weight."""
    import cv2  # heavy: imported when first needed

    from liaam.photometry import averaging

    # Of a grey picture there is no invariant to know.
    settings = is_grey(image), BRIGHTNESS, LOG_FLOOR, float(_floor(response))
    finite = image.dtype.kind == "u"
    if finite and blocks == _Blocks((0.0, 0.0), 1.0, image.shape[:2]):  # nothing to be averaged
        table = _table(image.dtype.str, "linear", response)
        light, masks, every = averaging.stored_light(image, table, _usable_range(image.dtype), *settings)
    else:
        light, masks, every = averaging.soft_light(_block_means(image, "log", response, blocks), ALL, *settings)
    logs = cv2.log(light, light)
    if blur > 0.0:
        logs = _smooth(logs, blur) if every else _blurred_by_masks(logs, masks, blur, finite)
    return averaging.soft_channels(logs, masks, np.eye(2) if turn is None else turn, SOFTNESS * pixel)


def _blurred_by_masks(logs: np.ndarray, masks: np.ndarray, blur: float, finite: bool) -> np.ndarray:
    """Blur log brightness by where it is finite, and log RGB by where it is known; the logarithms given are lost."""
    from liaam.photometry import averaging

    weights = averaging.weigh(logs, masks, float(UNUSABLE), finite)
    blurred = _smooth(logs, blur)
    averaging.divide(blurred, _smooth(weights, blur).reshape(weights.shape))
    return blurred


def _usable_range(dtype: np.dtype) -> tuple[int, int]:
    """Lowest and highest stored value whose logarithm says something."""
    top = np.iinfo(dtype).max
    return int(np.ceil(DARK * top)), int(np.floor(SATURATED * top))


def _stored_and_usable(image: np.ndarray, encoding: str) -> tuple[np.ndarray, np.ndarray]:
    """Finite stored values in [0, 1] and the mask of usable pixels."""
    if image.dtype.kind == "u":
        if encoding != "log":
            return image, np.ones(image.shape[:2], dtype=bool)
        import cv2  # heavy: imported when first needed

        low, high = ((value,) * 3 for value in _usable_range(image.dtype))
        return image, cv2.inRange(image, low, high) > 0
    finite = np.asarray(np.isfinite(image).all(axis=-1))
    stored = np.where(finite[..., None], np.clip(np.nan_to_num(image), 0.0, 1e6), np.float32(0.0))
    if encoding != "log":
        return stored, finite
    return stored, finite & np.asarray(((stored >= DARK) & (stored <= SATURATED)).all(axis=-1))


def _linear(image: np.ndarray, stored: np.ndarray, response: Response) -> np.ndarray:
    """Linear light of stored values, float32, by table for integers."""
    if image.dtype.kind == "u":
        return _table(image.dtype.str, "linear", response)[image]
    return to_linear(stored, response).astype(np.float32)


def _encode(stored: np.ndarray, encoding: str, response: Response) -> np.ndarray:
    if encoding == "linear":
        return to_linear(stored, response).astype(np.float32)
    return _encode_linear(to_linear(stored, response), encoding, response)


def _encode_linear(linear: np.ndarray, encoding: str, response: Response) -> np.ndarray:
    if encoding != "log":  # orientations are those of values, taken after the blur
        return linear_to_srgb(linear).astype(np.float32)
    return np.log(np.maximum(linear, _floor(response))).astype(np.float32)


def _floor(response: Response) -> np.float32:
    """Linear light that keeps black's logarithm finite and lies below every usable pixel, whatever the response."""
    return np.float32(0.5 * float(to_linear(np.array(DARK), response)))


@lru_cache(maxsize=16)
def _table(dtype: str, encoding: str, response: Response) -> np.ndarray:
    """Look-up table of an encoding for an integer pixel type."""
    stored = np.linspace(0.0, 1.0, np.iinfo(dtype).max + 1)
    return _encode(stored, encoding, response)


def value_luminance(image: np.ndarray, response: Response = "srgb") -> np.ndarray:
    """Luminance of the encoding ``value``, (h, w) float32; see :func:`encode`."""
    from liaam.photometry import averaging  # numba: imported when first needed

    if image.dtype.kind != "u":
        return encode(image, "value", response)[..., :3] @ LUMINANCE[0].astype(np.float32)
    return averaging.stored_luminance(image, _table(image.dtype.str, "value", response), LUMINANCE[0])


def _orientation(luminance: np.ndarray, turn: np.ndarray | None) -> np.ndarray:
    """Direction of the gradient as a unit vector in the first two of three channels, (h, w, 3) float32."""
    return np.dstack([soft_direction(luminance, FLAT, turn), np.zeros_like(luminance)]).astype(np.float32)


def soft_direction(luminance: np.ndarray, softness: float, turn: np.ndarray | None = None) -> np.ndarray:
    """Direction of the gradient, fading where it is weak: g / sqrt(|g|^2 + softness^2).

    Parameters
    ----------
    luminance : (h, w) float32
    softness : float
        Gradient per pixel at which half of its square is normalised away.
    turn : (2, 2) float, optional
        Rotation from the image's to the object's axes; none if left out.

    Returns
    -------
    (h, w, 2) float32
    """
    from liaam.photometry import averaging  # numba: imported when first needed

    return averaging.soft_directions(luminance, np.eye(2) if turn is None else turn, softness)


UNUSABLE = np.float32(1e-3)
"""Weight of an unusable pixel in a blur beside a usable one."""


def _blurred(colour: np.ndarray, usable: np.ndarray, sigma: float) -> np.ndarray:
    """Gaussian blur in which unusable pixels count next to nothing."""
    if usable.all():
        return _smooth(colour, sigma)
    weight = usable.astype(np.float32) + UNUSABLE
    return _smooth(colour * weight[..., None], sigma) / _smooth(weight, sigma)[..., None]


def _smooth(channels: np.ndarray, sigma: float) -> np.ndarray:
    import cv2  # heavy: imported when first needed

    return cv2.GaussianBlur(channels, (0, 0), float(sigma), borderType=cv2.BORDER_REPLICATE)
