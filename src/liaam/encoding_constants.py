"""Constants of the encodings. The compiled core receives this table when it is imported."""

import numpy as np

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
