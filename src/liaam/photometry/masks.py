"""Masks of pixels that violate the light-invariant model: dark, saturated, and specular pixels.

Highlights are found by the dichromatic model (Shafer, "Using color to separate reflection components", 1985): a glossy
surface adds light of the lamp's colour to its matt colour.
"""

import numpy as np

from liaam.errors import CameraError
from liaam.photometry.encoding import DARK, SATURATED, as_colour, stored_values
from liaam.photometry.response import Response, to_linear

MOST_PIXELS = 500_000
"""Largest number of pixels for finding highlights; larger images are reduced."""

COLOURED = 0.1
"""Relative difference of the largest and the smallest channel below which a pixel counts as grey."""

HUE_STEP = 0.15
"""Difference of hue between neighbouring pixels, in sixths of the circle, that separates two surfaces."""

LIGHT_STEP = 0.1
"""Difference of the log chroma (largest less smallest channel) between neighbouring pixels that separates surfaces."""

SURFACE, SPOT = 64, 5
"""Least number of pixels of a surface to estimate its matt colour, and of a highlight."""

SHINE = 0.1
"""Least specular fraction of the largest channel."""

SPREAD = 2.0
"""Standard deviations of a surface's variation that a highlight has to exceed."""

FADE = 0.7
"""Largest ratio of the specular fraction along the border of a highlight to its maximum: highlights fade out, paint
does not."""

RIM = 2.0
"""Width of the border, pixels."""


def dark_pixels(image: np.ndarray) -> np.ndarray:
    """Mask (h, w) of pixels with a channel that is too dark for a logarithm, or not finite.

    Raises ImageError if the array is not an image.
    """
    colour = as_colour(image)
    return np.asarray((~np.isfinite(colour) | (stored_values(colour) < DARK)).any(axis=2))


def saturated_pixels(image: np.ndarray) -> np.ndarray:
    """Mask of pixels with a clipped channel, (h, w) bool; see :func:`dark_pixels`."""
    return np.asarray((stored_values(as_colour(image)) > SATURATED).any(axis=2))


def usable_pixels(image: np.ndarray) -> np.ndarray:
    """Mask of pixels that are neither dark nor saturated in any channel, (h, w) bool; see :func:`dark_pixels`.

    These are the usable pixels of the encoding ``log`` (:func:`liaam.photometry.encode`).
    """
    return ~(dark_pixels(image) | saturated_pixels(image))


def specular_pixels(
    image: np.ndarray, response: Response = "srgb", light: tuple[float, float, float] = (1.0, 1.0, 1.0)
) -> np.ndarray:
    """Mask of specular pixels: at least a tenth of their light is a reflection of the lamp.

    On a matt surface the ratio of the smallest to the largest channel does not depend on the shading; a reflection
    raises it. The matt ratio of a surface is its median ratio, after Shen and Zheng, "Real-time highlight removal using
    intensity ratio" (Applied Optics 2013). Surfaces are regions in which hue and chroma (largest less smallest channel)
    are continuous, as in Tan and Ikeuchi, "Separating reflection components of textured surfaces using a single image"
    (PAMI 2005). A highlight has to be brighter than its surface, and to fade out towards its border, unlike paler
    paint. Grey and saturated regions inside highlights are part of them.

    Parameters
    ----------
    image : (h, w, 3) uint8, uint16 or float
        Stored values.
    response : Response
        Map from stored values to linear light.
    light : (float, float, float)
        Colour of the lamp (of a white surface) in linear light, on any scale. If a coloured lamp is assumed white,
        highlights are missed; false ones do not appear.

    Returns
    -------
    (h, w) bool
        Not detected are highlights on white and grey surfaces, highlights that cover half of their surface or more, and
        saturated pixels without a highlight around them. Paint that becomes paler gradually may be marked.

    Raises
    ------
    CameraError
        If the light is not three positive numbers.
    ImageError
        If the array is not an image.
    """
    lamp = np.asarray(light, dtype=np.float32)
    if lamp.shape != (3,) or not np.isfinite(lamp).all() or lamp.min() <= 0:
        raise CameraError(f"light {light!r}: give the lamp's colour as three positive numbers, such as (1, 0.8, 0.6)")
    import cv2  # heavy: imported when first needed

    colour, lamp = as_colour(image), lamp / lamp.max()
    linear = np.asarray(to_linear(np.clip(stored_values(colour), 0, 1), response), dtype=np.float32) / lamp
    bright = _reduced(saturated_pixels(colour).astype(np.float32)) > 0
    dark = _reduced(dark_pixels(colour).astype(np.float32)) > 0
    linear = cv2.medianBlur(_reduced(linear), 3)  # noise must not split surfaces
    strongest, weakest = linear.max(axis=2), linear.min(axis=2)
    ratio = weakest / np.maximum(strongest, 1e-6)
    coloured = ~bright & ~dark & (ratio < 1 - COLOURED)
    matt, spread, usual = _matt(_surfaces(linear, coloured), ratio, strongest)
    # Specular fraction of the largest channel; noise around 0 on matt surfaces.
    shine = np.where(coloured & np.isfinite(usual), (ratio - matt) / np.maximum(1 - matt, 1e-6), 0)
    shining = (shine > np.maximum(SHINE, SPREAD * spread)) & (strongest > usual)
    mask = _enclosed(_fading(shining, shine), ~coloured & (bright | ~dark))
    if mask.shape == colour.shape[:2]:
        return mask
    return cv2.resize(mask.astype(np.uint8), colour.shape[1::-1], interpolation=cv2.INTER_NEAREST).astype(bool)


def _reduced(image: np.ndarray) -> np.ndarray:
    """Reduce an image by the least integer factor that leaves at most :data:`MOST_PIXELS`."""
    import cv2  # heavy: imported when first needed

    height, width = image.shape[:2]
    factor = int(np.ceil(np.sqrt(height * width / MOST_PIXELS)))
    size = (max(width // factor, 1), max(height // factor, 1))
    return image if factor == 1 else cv2.resize(image, size, interpolation=cv2.INTER_AREA)


def _surfaces(linear: np.ndarray, coloured: np.ndarray) -> np.ndarray:
    """Label (h, w) of the surface of each pixel; neighbours share a surface if hue and chroma are continuous."""
    from scipy import sparse  # heavy: imported when first needed
    from scipy.sparse.csgraph import connected_components

    red, green, blue = np.moveaxis(linear, 2, 0)
    matt = np.maximum(linear.max(axis=2) - linear.min(axis=2), 1e-6)
    sixths = np.stack([green - blue, blue - red, red - green]) / matt + np.array([0.0, 2.0, 4.0])[:, None, None]
    hue = np.take_along_axis(sixths, linear.argmax(axis=2)[None], axis=0)[0]
    number = np.arange(coloured.size).reshape(coloured.shape)
    ties = []
    for one, other in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
        turn = np.abs((hue[one] - hue[other] + 3) % 6 - 3)
        step = np.abs(np.log(matt[one] / matt[other]))
        tied = coloured[one] & coloured[other] & (turn < HUE_STEP) & (step < LIGHT_STEP)
        ties.append((number[one][tied], number[other][tied]))
    ends = tuple(np.concatenate(column) for column in zip(*ties, strict=True))
    graph = sparse.coo_array((np.ones(len(ends[0]), dtype=bool), ends), shape=(coloured.size, coloured.size))
    return connected_components(graph, directed=False)[1].reshape(coloured.shape)


def _matt(surfaces: np.ndarray, ratio: np.ndarray, strongest: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Matt ratio of each pixel's surface, its standard deviation, and the median largest channel, (h, w) each."""
    from scipy import ndimage  # heavy: imported when first needed

    sizes = np.bincount(surfaces.ravel())
    large = np.flatnonzero(sizes >= SURFACE)
    matt, spread, usual = np.zeros(len(sizes)), np.zeros(len(sizes)), np.full(len(sizes), np.inf)
    if len(large):
        matt[large] = ndimage.median(ratio, surfaces, large)
        usual[large] = ndimage.median(strongest, surfaces, large)
        # Highlights only raise the ratio, so deviations below the median are the surface's variation.
        lower = np.where(ratio <= matt[surfaces], surfaces, -1)
        below = ndimage.median(ratio, lower, large)
        spread[large] = 1.4826 * (matt[large] - below) / np.maximum(1 - matt[large], 1e-6)
    return matt[surfaces], spread[surfaces], usual[surfaces]


def _regions(mask: np.ndarray, connectivity: int) -> tuple[int, np.ndarray]:
    """Number of a mask's connected regions plus one, and the label (h, w) of each pixel, 0 outside."""
    import cv2  # heavy: imported when first needed

    return cv2.connectedComponents(mask.astype(np.uint8), connectivity=connectivity)


def _fading(mask: np.ndarray, shine: np.ndarray) -> np.ndarray:
    """Mask of the regions whose specular fraction fades out towards the border."""
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


def _enclosed(mask: np.ndarray, colourless: np.ndarray) -> np.ndarray:
    """Add to a mask the regions of grey or saturated pixels of whose neighbours at least half are in it."""
    from scipy import ndimage  # heavy: imported when first needed

    count, regions = _regions(colourless, 4)
    around = np.where(colourless, 0, ndimage.grey_dilation(regions, size=(3, 3)))
    neighbours = np.bincount(around.ravel(), minlength=count)
    marked = np.bincount(around[mask], minlength=count)
    enclosed = (neighbours > 0) & (2 * marked >= neighbours)
    enclosed[0] = False
    return mask | enclosed[regions]
