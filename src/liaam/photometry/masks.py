"""Masks of pixels that light invariance cannot use: too dark, saturated, or shining.

The first two are told by the stored value, with the limits of :mod:`liaam.photometry.encoding`. Highlights are told
by the dichromatic model (Shafer, "Using color to separate reflection components", 1985): a glossy surface adds light
of the lamp's colour to its matt colour.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from liaam.errors import CameraError
from liaam.photometry.encoding import DARK, SATURATED, as_colour, stored_values
from liaam.photometry.response import Response, to_linear

MOST_PIXELS = 500_000
"""Pixels among which highlights are looked for; larger pictures are reduced."""

COLOURED = 0.1
"""Relative difference of the strongest and the weakest channel below which a pixel is grey, and tells nothing."""

HUE_STEP = 0.15
"""Difference of hue from pixel to pixel, in sixths of the circle, at which one surface ends and another begins."""

LIGHT_STEP = 0.1
"""The same for the logarithm of what matt light alone gives: the strongest channel less the weakest."""

SURFACE, SPOT = 64, 5
"""Fewest pixels of a surface whose matt colour can be told, and of a highlight."""

SHINE = 0.1
"""Least share of the strongest channel that is the lamp's reflection."""

SPREAD = 2.0
"""Standard deviations of a surface's own variation that a highlight has to exceed."""

FADE = 0.7
"""Shine along the border of a highlight, relative to its strongest: a highlight fades out, paint ends."""

RIM = 2.0
"""Pixels that count as the border."""


def dark_pixels(image: np.ndarray) -> np.ndarray:
    """Tell which pixels are too dark for a logarithm, or not a number, in any channel.

    Parameters
    ----------
    image : (h, w, 3) uint8, uint16 or float
        Stored values; one channel will do.

    Returns
    -------
    (h, w) bool

    Raises
    ------
    ImageError
        If the array is no image.
    """
    colour = as_colour(image)
    return np.asarray((~np.isfinite(colour) | (stored_values(colour) < DARK)).any(axis=2))


def saturated_pixels(image: np.ndarray) -> np.ndarray:
    """Tell which pixels are clipped in any channel, (h, w) bool; see :func:`dark_pixels`."""
    return np.asarray((stored_values(as_colour(image)) > SATURATED).any(axis=2))


def usable_pixels(image: np.ndarray) -> np.ndarray:
    """Tell which pixels are neither dark nor saturated in any channel, (h, w) bool; see :func:`dark_pixels`.

    They are those that count in the encoding ``log`` (:func:`liaam.photometry.encode`).
    """
    return ~(dark_pixels(image) | saturated_pixels(image))


def specular_pixels(
    image: np.ndarray, response: Response = "srgb", light: tuple[float, float, float] = (1.0, 1.0, 1.0)
) -> np.ndarray:
    """Tell which pixels shine: where at least a tenth of the light is the lamp's reflection.

    A matt surface keeps the ratio of its weakest to its strongest channel, whatever the shading; a reflection of the
    lamp, white once the picture is divided by the lamp's colour, raises it. The median ratio of a surface is its matt
    one, after Shen and Zheng, "Real-time highlight removal using intensity ratio" (Applied Optics 2013). Surfaces are
    regions in which what no highlight changes is continuous: the hue, and the strongest channel less the weakest, a
    specular-free image like that of Tan and Ikeuchi, "Separating reflection components of textured surfaces
    using a single image" (PAMI 2005). A highlight has to be brighter than its surface, and to fade out towards its
    border, as paint of a paler shade does not. Grey and saturated pixels that highlights enclose belong to them.

    Parameters
    ----------
    image : (h, w, 3) uint8, uint16 or float
        Stored values.
    response : Response
        From stored values to linear light.
    light : (float, float, float)
        Colour of the lamp in linear light, on any scale: that of a white surface. With a lamp taken for white that is
        not, highlights are missed rather than invented.

    Returns
    -------
    (h, w) bool
        None in a grey picture. What colour cannot tell is not marked: highlights on white and grey surfaces, those
        that are half of their surface or more, and saturated pixels without a highlight around them (see
        :func:`saturated_pixels`). Paint that turns paler gradually, at one hue, may be marked.

    Raises
    ------
    CameraError
        If the light is not three positive numbers.
    ImageError
        If the array is no image.
    """
    tint = np.asarray(light, dtype=np.float32)
    if tint.shape != (3,) or not np.isfinite(tint).all() or tint.min() <= 0:
        raise CameraError(f"light {light!r}: give the lamp's colour as three positive numbers, such as (1, 0.8, 0.6)")
    colour = as_colour(image)
    pixels = _Pixels.of(colour, response, tint / tint.max())
    mask = _enclosed(_fading(_shining(pixels), pixels.shine), pixels)
    return _enlarged(mask, colour.shape[:2])


@dataclass(frozen=True)
class _Pixels:
    """What is known of each pixel, (h, w), perhaps reduced."""

    strongest: np.ndarray
    """float32: strongest channel of linear light, relative to the lamp's."""
    shine: np.ndarray
    """float32: share of it that is the lamp's reflection; noise around 0 on matt surfaces."""
    spread: np.ndarray
    """float32: standard deviation of the shine on the matt part of the surface."""
    usual: np.ndarray
    """float32: strongest channel that is usual on the surface; infinite where no surface is known."""
    silent: np.ndarray
    """bool: grey or saturated, so that colour tells nothing, but not dark."""

    @classmethod
    def of(cls, colour: np.ndarray, response: Response, tint: np.ndarray) -> _Pixels:
        """Measure the pixels of an image (h, w, 3)."""
        import cv2  # heavy: imported when first needed

        linear = np.asarray(to_linear(np.clip(stored_values(colour), 0, 1), response), dtype=np.float32) / tint
        bright = _reduced(saturated_pixels(colour).astype(np.float32)) > 0
        dark = _reduced(dark_pixels(colour).astype(np.float32)) > 0
        linear = cv2.medianBlur(_reduced(linear), 3)  # noise must not tear surfaces apart
        strongest, weakest = linear.max(axis=2), linear.min(axis=2)
        ratio = weakest / np.maximum(strongest, 1e-6)
        told = ~bright & ~dark & (ratio < 1 - COLOURED)
        matt, spread, usual = _matt(_surfaces(linear, told), ratio, strongest)
        shine = np.where(told & np.isfinite(usual), (ratio - matt) / np.maximum(1 - matt, 1e-6), 0)
        return cls(strongest, shine, spread, usual, ~told & ~(dark & ~bright))


def _reduced(image: np.ndarray) -> np.ndarray:
    """Average blocks of pixels into one, as few as make the image small enough."""
    import cv2  # heavy: imported when first needed

    height, width = image.shape[:2]
    factor = int(np.ceil(np.sqrt(height * width / MOST_PIXELS)))
    size = (max(width // factor, 1), max(height // factor, 1))
    return image if factor == 1 else cv2.resize(image, size, interpolation=cv2.INTER_AREA)


def _enlarged(mask: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    import cv2  # heavy: imported when first needed

    if mask.shape == size:
        return mask
    return cv2.resize(mask.astype(np.uint8), size[::-1], interpolation=cv2.INTER_NEAREST).astype(bool)


def _surfaces(linear: np.ndarray, told: np.ndarray) -> np.ndarray:
    """Number of the surface of each pixel (h, w); neighbours are of one if what no highlight changes is continuous."""
    from scipy import sparse  # heavy: imported when first needed
    from scipy.sparse.csgraph import connected_components

    red, green, blue = np.moveaxis(linear, 2, 0)
    matt = np.maximum(linear.max(axis=2) - linear.min(axis=2), 1e-6)
    sixths = np.stack([green - blue, blue - red, red - green]) / matt + np.array([0.0, 2.0, 4.0])[:, None, None]
    hue = np.take_along_axis(sixths, linear.argmax(axis=2)[None], axis=0)[0]
    number = np.arange(told.size).reshape(told.shape)
    ties = []
    for one, other in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
        turn = np.abs((hue[one] - hue[other] + 3) % 6 - 3)
        step = np.abs(np.log(matt[one] / matt[other]))
        tied = told[one] & told[other] & (turn < HUE_STEP) & (step < LIGHT_STEP)
        ties.append((number[one][tied], number[other][tied]))
    ends = tuple(np.concatenate(column) for column in zip(*ties, strict=True))
    graph = sparse.coo_array((np.ones(len(ends[0]), dtype=bool), ends), shape=(told.size, told.size))
    return connected_components(graph, directed=False)[1].reshape(told.shape)


def _matt(surfaces: np.ndarray, ratio: np.ndarray, strongest: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Matt ratio of each pixel's surface, the shine's spread there, and its usual strongest channel, (h, w) each."""
    from scipy import ndimage  # heavy: imported when first needed

    sizes = np.bincount(surfaces.ravel())
    large = np.flatnonzero(sizes >= SURFACE)
    matt, spread, usual = np.zeros(len(sizes)), np.zeros(len(sizes)), np.full(len(sizes), np.inf)
    if len(large):
        matt[large] = ndimage.median(ratio, surfaces, large)
        usual[large] = ndimage.median(strongest, surfaces, large)
        # Highlights only raise the ratio, so what lies below the median is the surface's own variation.
        lower = np.where(ratio <= matt[surfaces], surfaces, -1)
        below = ndimage.median(ratio, lower, large)
        spread[large] = 1.4826 * (matt[large] - below) / np.maximum(1 - matt[large], 1e-6)
    return matt[surfaces], spread[surfaces], usual[surfaces]


def _shining(pixels: _Pixels) -> np.ndarray:
    enough = np.maximum(SHINE, SPREAD * pixels.spread)
    return (pixels.shine > enough) & (pixels.strongest > pixels.usual)


def _regions(mask: np.ndarray, connectivity: int) -> tuple[int, np.ndarray]:
    """One more than the number of a mask's connected regions, and the region (h, w) of each pixel, 0 outside."""
    import cv2  # heavy: imported when first needed

    return cv2.connectedComponents(mask.astype(np.uint8), connectivity=connectivity)


def _fading(mask: np.ndarray, shine: np.ndarray) -> np.ndarray:
    """Regions of a mask whose shine fades out towards the border."""
    import cv2  # heavy: imported when first needed
    from scipy import ndimage

    count, regions = _regions(mask, 8)
    sizes = np.bincount(regions.ravel(), minlength=count)
    large = 1 + np.flatnonzero(sizes[1:] >= SPOT)
    if not len(large):
        return np.zeros_like(mask)
    inside = cv2.distanceTransform(np.pad(mask.astype(np.uint8), 1), cv2.DIST_L2, 3)[1:-1, 1:-1]
    rim = ndimage.median(shine, np.where(inside <= RIM, regions, 0), large)
    peak = ndimage.labeled_comprehension(shine, regions, large, lambda v: np.percentile(v, 95), float, 0.0)
    fades = np.zeros(count, dtype=bool)
    fades[large] = np.asarray(rim) < FADE * np.asarray(peak)
    return fades[regions]


def _enclosed(mask: np.ndarray, pixels: _Pixels) -> np.ndarray:
    """The mask, with the regions without colour of whose neighbours at least half are in it."""
    from scipy import ndimage  # heavy: imported when first needed

    count, regions = _regions(pixels.silent, 4)
    around = np.where(pixels.silent, 0, ndimage.grey_dilation(regions, size=(3, 3)))
    neighbours = np.bincount(around.ravel(), minlength=count)
    marked = np.bincount(around[mask], minlength=count)
    enclosed = (neighbours > 0) & (2 * marked >= neighbours)
    enclosed[0] = False
    return mask | enclosed[regions]
