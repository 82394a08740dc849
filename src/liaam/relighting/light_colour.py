"""The colour of the light of a whole picture, and its correction: von Kries gains of the channels of linear light.

It is one colour for the whole picture, so that a face, its hair and the wall behind it stay of one light. What a light
does to an object from place to place is in ``shading``.
"""

from dataclasses import dataclass
from functools import reduce

import cv2
import numpy as np

from liaam.formatting import short_repr
from liaam.photometry import Response, to_linear
from liaam.photometry.encoding import stored_values
from liaam.photometry.invariant import CHROMATICITY, LUMINANCE
from liaam.relighting.highlights import BRIGHT, CLIPPED, below_white
from liaam.relighting.painting import eight_bits, log_light, smoothstep

# Distance from no colour, in standard deviations of the estimate (Mahalanobis)
NOTHING = 3.0  # Up to here, nothing was found
FOUND = 3.5  # From here, the estimate is used fully; in between by degrees, so that videos do not flicker

# Log-chromaticities
RENDERED = 0.15  # Standard deviation of how vividly cameras render an object, in the direction of its own colour
MORE = 0.15  # How much more of a colour the object may have than its surroundings
ALIKE = 0.5  # Cosine between the object's own colour and that of the light from which both look alike

POWER = 6.0  # Of the mean over pixels that gives the colour of the surroundings
SEEN_AT = 150  # Longest side at which it is computed, pixels; a part of a pixel is not clipped if its mean is not
LEAST_AROUND = 0.1  # Share of the picture around an object that tells its colour
AROUND_CLIPPED = 250 / 255  # Stored value from which a pixel does not count there

NEARLY_CLIPPED = float(
    np.log(0.8)
)  # Logarithm of light of a pixel's brightest channel from which its colour may be false
NEARLY_WHITE = float(np.log(0.6))  # The same of its middle channel

# Directions of the colours that have names, in logarithms of red, green and blue
NAMES = {
    "red": (1.0, 0.0, 0.0),
    "orange": (1.0, 0.5, 0.0),
    "yellow": (1.0, 1.0, 0.0),
    "green": (0.0, 1.0, 0.0),
    "cyan": (0.0, 1.0, 1.0),
    "blue": (0.0, 0.0, 1.0),
    "magenta": (1.0, 0.0, 1.0),
}


@dataclass(frozen=True, eq=False)
class LightColour:
    """Colour of the light of a picture, relative to the light of the training images.

    Attributes
    ----------
    chromaticity : (2,) float64
        Estimated log-chromaticity, in the coordinates of :data:`liaam.photometry.invariant.CHROMATICITY`.
    covariance : (2, 2) float64
        Its uncertainty: how much the colours of objects differ, as far as the picture does not tell the object's own
        from that of the light.
    """

    chromaticity: np.ndarray
    covariance: np.ndarray

    __repr__ = short_repr

    @classmethod
    def unknown(cls) -> "LightColour":
        """Return no colour, where nothing is known of it."""
        return cls(np.zeros(2), np.eye(2))

    @property
    def distance(self) -> float:
        """How far the estimate is from the training light, in standard deviations."""
        return float(np.sqrt(self.chromaticity @ np.linalg.solve(self.covariance, self.chromaticity)))

    @property
    def share(self) -> float:
        """Share of the estimate that is used: 0 if it may be an object of another colour, 1 if that is unlikely."""
        return float(smoothstep(np.array((self.distance - NOTHING) / (FOUND - NOTHING))))

    @property
    def is_found(self) -> bool:
        """Whether the light has another colour than that of training."""
        return self.share > 0.0

    @property
    def log(self) -> np.ndarray:
        """Logarithms of the gains of red, green and blue that are used, (3,); of mean 0, and 0 if nothing is found."""
        return CHROMATICITY.T @ (self.share * self.chromaticity)

    @property
    def gains(self) -> np.ndarray:
        """Gains of red, green and blue, (3,): what the light makes of a grey of luminance 1, whose luminance stays."""
        gains = np.exp(self.log)
        return gains / (LUMINANCE[0] @ gains)

    @property
    def name(self) -> str:
        """Name of the colour, such as orange; empty if nothing is found."""
        if not self.is_found:
            return ""
        directions = {name: CHROMATICITY @ np.array(rgb) for name, rgb in NAMES.items()}
        return max(directions, key=lambda name: directions[name] @ self.chromaticity / np.linalg.norm(directions[name]))

    def __str__(self) -> str:
        """Say what was found: "orange (red 1.30, green 0.97, blue 0.60 of the training light)"."""
        if not self.is_found:
            return "as in training"
        red, green, blue = self.gains
        return f"{self.name} (red {red:.2f}, green {green:.2f}, blue {blue:.2f} times the light of training)"

    def to_dict(self) -> dict:
        """Return the name, the gains and the distance, for JSON."""
        return {"name": self.name, "gains": self.gains.tolist(), "distance": self.distance}

    def shared_with(self, around: np.ndarray | None, own: np.ndarray) -> "LightColour":
        """Limit the colour of the light on an object to what its surroundings share, where it may be the object's own.

        Tanned or made-up skin, and a camera that renders colours vividly, look like skin in warm light. So light of the
        ``own`` colour of the object, (2,), counts only as far as the surroundings have its colour, too: ``around`` (2,)
        or None if too little of them is seen. In light of other colours, the surroundings are not asked: walls and
        furniture are seldom blue or green.
        """
        size = float(np.linalg.norm(self.chromaticity))
        if around is None or size == 0.0:
            return self
        cosine = self.chromaticity @ own / (size * max(float(np.linalg.norm(own)), 1e-9))
        may_be_own = float(smoothstep(np.array(cosine / ALIKE)))
        along = around @ self.chromaticity / size
        shared = min(1.0, max(0.0, along + MORE) / size)
        return LightColour((1.0 - may_be_own * (1.0 - shared)) * self.chromaticity, self.covariance)

    def correction(self, to: "LightColour | None" = None) -> np.ndarray:
        """Return logarithms of the factors of linear red, green and blue, (3,), that bring a picture to another colour.

        By default to that of the training light. A grey keeps its luminance.
        """
        new = np.ones(3) if to is None else to.gains
        return np.log(new / self.gains)


def colour_around(image: np.ndarray, shape: np.ndarray, response: Response) -> np.ndarray | None:
    """Return the log-chromaticity (2,) of what is bright around an object with landmarks (n, 2).

    None if little of it is seen.

    The mean of a high power of the light in each channel is about the colour of white and grey surfaces (Finlayson and
    Trezzi, "Shades of gray and colour constancy", Color and Imaging Conference 2004).
    """
    factor = min(1.0, SEEN_AT / max(image.shape[:2]))
    width, height = (max(1, round(factor * side)) for side in image.shape[1::-1])
    small = cv2.resize(stored_values(image), (width, height), interpolation=cv2.INTER_AREA)
    on_object = np.zeros((height, width), np.uint8)
    corners = (shape + 0.5) * (width / image.shape[1], height / image.shape[0]) - 0.5
    cv2.fillConvexPoly(on_object, cv2.convexHull(np.rint(corners).astype(np.int32)), 1)
    around = small[cv2.dilate(on_object, np.ones((3, 3), np.uint8)) == 0]
    around = around[around.max(axis=1, initial=0.0) < AROUND_CLIPPED]
    if len(around) < LEAST_AROUND * on_object.size:
        return None
    means = np.mean(to_linear(around, response).astype(np.float64) ** POWER, axis=0)
    if not means.all():  # black
        return None
    return CHROMATICITY @ np.log(means) / POWER


def balanced(log_rgb: np.ndarray, log_own: np.ndarray, correction: np.ndarray) -> np.ndarray:
    """Change the colour of light by von Kries gains, without false colours where the camera clipped.

    Parameters
    ----------
    log_rgb : (h, w, 3) float32
        Logarithms of linear light.
    log_own : (h, w, 3) float32
        The same in the original picture, in which pixels are clipped.
    correction : (3,) float
        Logarithms of the gains.

    Returns
    -------
    (h, w, 3) float32
        What is nearly clipped in two channels becomes grey, so that white stays white, and highlights do not take the
        opposite colour. What becomes brighter approaches white gradually.
    """
    changed = log_rgb + correction.astype(np.float32)
    red, green, blue = cv2.split(log_own)
    brightest = cv2.max(cv2.max(red, green), blue)
    middle = cv2.max(cv2.min(red, green), cv2.min(cv2.max(red, green), blue))
    degree = _degree(brightest, NEARLY_CLIPPED) * _degree(middle, NEARLY_WHITE)
    white = reduce(cv2.max, cv2.split(changed))
    changed += degree[..., None] * (white[..., None] - changed)
    return below_white(changed, log_rgb)


def _degree(log_light: np.ndarray, least: float) -> np.ndarray:
    """Return how near logarithms of light are to being clipped, from 0 at the least one to 1."""
    return smoothstep((log_light - np.float32(least)) / np.float32(CLIPPED - least))


def balanced_picture(picture: np.ndarray, correction: np.ndarray, response: Response) -> np.ndarray:
    """Change the colour of the light of a whole picture (h, w, 3) uint8, as :func:`balanced` does; return another."""
    values = log_light(np.arange(256, dtype=np.uint8), response)
    new = values[:, None] + correction.astype(np.float32)  # (256, 3): of each stored value, in each channel
    changed = cv2.LUT(picture, eight_bits(new, response)[None])
    # Only bright pixels depend on more than one channel.
    is_bright = (values[:, None] > NEARLY_CLIPPED) | (new > BRIGHT)
    table = np.ascontiguousarray(is_bright[None].astype(np.uint8))
    at = np.nonzero(reduce(cv2.max, cv2.split(cv2.LUT(picture, table))))
    if len(at[0]):
        own = values[picture[at]][:, None]
        changed[at] = eight_bits(balanced(own, own, correction), response)[:, 0]
    return changed
