"""Convert Pillow's images to RGB, and those with a colour profile to sRGB."""

import io
from collections.abc import Callable
from typing import Any

import numpy as np

ROWS_AT_ONCE = 256  # rows converted at a time, because Pillow's conversions take several times the image's memory
# Modes of Pillow's images that the colour profiles of each colour space are for.
_PROFILE_MODES = {"RGB": ("RGB", "RGBA", "P"), "GRAY": ("L", "LA"), "CMYK": ("CMYK",)}
_SAME = 2  # largest difference of 8-bit values between sRGB and a profile that is taken for sRGB, of rounding


def rgb_of(image: Any) -> np.ndarray:
    """Decode a Pillow image to (h, w, 3) uint8, in sRGB."""
    image.load()
    width, height = image.size
    array, convert = np.empty((height, width, 3), np.uint8), _to_srgb(image) or _to_rgb
    for top in range(0, height, ROWS_AT_ONCE):
        strip = image.crop((0, top, width, min(top + ROWS_AT_ONCE, height)))
        array[top : top + strip.height] = convert(strip)
    return array


def _to_rgb(image: Any) -> Any:
    # A palette with transparency cannot be converted to RGB directly.
    return (image.convert("RGBA") if "transparency" in image.info else image).convert("RGB")


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
        transform = ImageCms.buildTransform(source, ImageCms.createProfile("sRGB"), mode, "RGB")
    except (ImageCms.PyCMSError, OSError):
        return None
    if mode == "L":  # as lcms gives channels that differ by rounding
        return lambda part: Image.merge("RGB", [transform.apply(part.convert("L")).getchannel("G")] * 3)
    colours = np.stack(np.meshgrid(*[np.arange(0, 256, 15, dtype=np.uint8)] * 3), axis=-1).reshape(-1, 18, 3)
    if mode == "RGB" and np.abs(np.asarray(transform.apply(Image.fromarray(colours)), int) - colours).max() <= _SAME:
        return None  # it is sRGB but for rounding
    return lambda part: transform.apply(_to_rgb(part) if mode == "RGB" else part)
