"""The encodings and their constants. The compiled core receives the constants when it is imported."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class EncodingFacts:
    """What all of liaam needs to know of an encoding; see :func:`liaam.photometry.encoding.encode`.

    Attributes
    ----------
    channels : int
        Number of channels of an encoded image, without the weight of the pixel.
    learnt : int
        Number of channels of an appearance in this encoding, the first ones if there are more.
    is_logarithmic : bool
        Whether dark and saturated pixels are unusable.
    is_gradient : bool
        Whether the first two channels are a gradient along x and y. It is learnt from the copies of images too, and
        compared as it is.
    """

    channels: int
    learnt: int
    is_logarithmic: bool = False
    is_gradient: bool = False


ENCODINGS = {
    "value": EncodingFacts(3, learnt=3),
    "log": EncodingFacts(3, learnt=3, is_logarithmic=True),
    "orientation": EncodingFacts(3, learnt=2, is_gradient=True),
    "soft": EncodingFacts(6, learnt=3, is_logarithmic=True, is_gradient=True),
}
"""The encodings by name, in the order of the core's (``src/core/encoding.hpp``).

- ``value``: sRGB-encoded values in [0, 1].
- ``log``: natural logarithm of linear light.
- ``orientation``: cosine and sine of the direction of luminance's gradient, third channel zero (Tzimiropoulos,
  Zafeiriou and Pantic, "Subspace learning from image gradient orientations", PAMI 2012).
- ``soft``: softly normalised gradient of log brightness, log of linear light, and the weight of that log. Appearances
  hold the gradient and the invariant.
"""

GRADIENTS = tuple(name for name, facts in ENCODINGS.items() if facts.is_gradient)

# Weights of linear R, G and B in the brightness for the gradients of ``soft``. On simulated scenes equal weights have a
# sixth less error by noise than luminance, which is mostly green.
BRIGHTNESS = np.full(3, 1.0 / 3.0)

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])  # weights of linear R, G and B in luminance, of sRGB's primaries

# Gradient of log brightness, per pixel of the reference frame, for which the squared length is normalised to one half.
# On photographs of faces, 0.025 to 0.1 perform alike.
SOFTNESS = 0.1
LOG_FLOOR = 0.004  # added to linear brightness before the logarithm, to suppress gradients of noise in dark pixels

# Gradient of luminance per pixel, in values of [0, 1], below which its direction fades to zero. The published
# orientation has no such limit, and is undefined in flat regions.
FLAT = 1e-4

UNUSABLE = 1e-3  # weight of an unusable pixel in a blur; usable pixels have about 1
ALL = 0.999  # fraction of a block's pixels above which the whole block counts as usable

TABLE = {
    "all": ALL,
    "unusable": UNUSABLE,
    "log_floor": LOG_FLOOR,
    "softness": SOFTNESS,
    "flat": FLAT,
    "brightness": tuple(BRIGHTNESS.tolist()),
    "luminance": tuple(LUMINANCE.tolist()),
}
"""The constants by their names in the core (``src/core/encoding.hpp``)."""
