"""Extrapolation beyond the mesh, where the model has no values, along the edges of the image.

Averages preserve edges by the domain transform (Gastal and Oliveira, "Domain transform for edge-aware image and video
processing", ACM TOG 2011), in which a change of light counts as a distance.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from liaam import _core
from liaam.distance_transform import distance_transform
from liaam.relighting.painting import averages, mean_of, smoothstep

# Distances are in reaches (of `Region`) unless said.
FARTHEST = 4.0  # Distance beyond the mesh to which values extend
LEAST_SHARE = 1e-3  # Share below which it is 0
NEARBY = 0.8  # Scale of averages of values
COLOUR = 4.9  # Radius of averages of the light's colour: lamps mix slowly, and at the border other colours are brows'

EDGE = 0.8  # Change of the image's logarithms, summed over channels, that counts as a distance of one scale
BLUR_OWN = 1.0  # Standard deviation of the Gaussian that removes noise before that is measured, pixels
DARK = 0.05  # Light added, relative to the object's brightest: in the dark, noise and JPEG's blocks are edges of logs
ROUNDS = 3  # Number of passes over rows and columns; three leave no visible stripes

ACROSS = 12.0  # Scale of the division between object and background
EVEN = 0.5  # Scale within which it is evened out
BACKGROUND = 8.0  # Distance beyond the mesh from which an image is background
BORDER = 1.0  # Down to this depth inside the mesh, another colour is background, because the fit is not exact
# Without the differences of colour, light of the object shines on walls.
ANOTHER_COLOUR = 0.5  # Difference of log-chromaticity from the object's mean from which a pixel is rather background
# Whether a colour is rather that of the background: the share of the object's pixels from which there are enough of the
# background, the least standard deviations of log-chromaticity in each and of the logarithm of the background's
# brightness, and squared distances, in standard deviations:
# beyond the first a colour is unlike both, and by the other the background must be nearer, since skin in the shade is
# often a little nearer to a wall.
ENOUGH_BACKGROUND = 0.02
LEAST_DEVIATION = 0.08
LEAST_CHANGE = 0.1
UNLIKE = 16.0
CLEARLY = 12.0
MAD_TO_SD = 1.4826  # Of a normal distribution
# What is brighter than the object is a wall or gloss where its saturation, relative to that mean, is at most PALE, and
# not where it is at least VIVID; in between it is so by degrees.
PALE = 0.5
VIVID = 0.8
NEUTRAL = 0.02  # Square of a difference from grey at which an object has a colour
COLOUR_BLUR = 0.1  # Gaussian before that is measured
BRIGHTER = 0.3  # Log light above the object's brightest from which a pixel is brighter to the full degree of 1
A_LITTLE = 0.1  # Degree from which it can be enclosed by the object
BRIGHTEST = 0.95  # Quantile that is the brightest


@dataclass(frozen=True, eq=False)
class Surroundings:
    """Division of the surroundings of a mesh between object and background.

    Attributes
    ----------
    inside : (h, w) bool
        Mask of the mesh.
    belongs : (h, w, 1) float32
        How much a pixel belongs to the object rather than to the background, 0 to 1: by which of them is nearer, where
        edges of ``seen`` are distances, and by its colour.
    gloss : (h, w, 1) float32
        How much a pixel is gloss on the object, 0 to 1; 0 inside the mesh.
    share : (h, w, 1) float32
        ``belongs``, falling to 0 at ``FARTHEST`` reaches from the mesh.
    seen : (h, w, 3) float32
        Logarithms of the image, as for :meth:`of`, without its noise.
    reach : float
        Distance over which a new light fades out around the mesh, pixels (:class:`Region`).
    """

    inside: np.ndarray
    belongs: np.ndarray
    gloss: np.ndarray
    share: np.ndarray
    seen: np.ndarray
    reach: float

    @classmethod
    def of(cls, inside: np.ndarray, log_image: np.ndarray, reach: float) -> "Surroundings":
        """Divide an image around the mask (h, w) of a mesh.

        ``log_image`` (h, w, 3) float32 are the logarithms of its linear values, without the light as far as it is
        known.
        """
        in_mesh = inside[..., None]
        linear = np.exp(log_image)
        brightest = np.float32(np.quantile(linear[inside], BRIGHTEST))
        log_image = np.log(linear + DARK * brightest)
        seen = cv2.GaussianBlur(log_image, (0, 0), BLUR_OWN)

        # A pixel belongs to the object if the object is nearer than the background, and if it looks like the object:
        # it has about the object's colour, and is not brighter, or it is gloss.
        away = distance_transform(~inside)[..., None]  # distances from the mesh, pixels
        background = _background(inside, away, reach)
        nearer = np.where(in_mesh, np.float32(1.0), _nearer_to_object(inside, background, seen, reach))
        brightness, colours = _brightness_and_colours(log_image, reach)
        alike = _alike_in_colour(inside, colours) * _rather_of_object(inside, background, brightness, colours)
        bright = _brighter_or_paler(inside, brightness, colours)
        # What is bright is gloss if the object is all around it; else it is a wall behind.
        is_object = (bright <= A_LITTLE) & (nearer >= 0.5)
        is_gloss = (bright > A_LITTLE) & _is_enclosed(is_object)
        gloss = bright * is_gloss
        belongs = (alike * (1.0 - bright) + gloss) * np.maximum(nearer, is_gloss)

        depth = distance_transform(np.pad(inside, 1))[1:-1, 1:-1]  # below the mesh's border, also that of the image
        is_deep = depth > min(BORDER * reach, 0.5 * depth.max())
        belongs = np.where(is_deep[..., None], np.float32(1.0), belongs)
        belongs = np.where(in_mesh, belongs, averaged(belongs, seen, max(1.0, EVEN * reach)))
        share = belongs * smoothstep(1.0 - (away - 1.0) / (FARTHEST * reach))
        share[share <= LEAST_SHARE] = 0.0
        gloss[in_mesh] = 0.0
        return cls(inside, belongs, gloss, share, seen, reach)

    def spread(self, values: np.ndarray, lit: np.ndarray) -> np.ndarray:
        """Return the light of the object (h, w, 3), also around the mesh.

        ``values`` (h, w, 3) are the logarithms of the light inside the mesh, and ``lit`` (h, w, 3) those of the light
        that the model's basis gives everywhere. Around the mesh, the difference of both goes on as it is nearby.
        """
        light = self.belongs * lit
        at = _extent(self.share[..., 0] > 0)  # the rest of the image has none of the difference
        difference = values[at] - lit[at]
        inside = self.inside[at]
        in_mesh = inside[..., None]
        grey = mean_of(difference)[..., None]
        colour = averages(difference - grey, in_mesh, COLOUR * self.reach)
        around = carried(grey + colour, inside, self.seen[at], self.reach)
        light[at] += self.share[at] * np.where(in_mesh, difference, around)
        return light


def carried(values: np.ndarray, inside: np.ndarray, seen: np.ndarray, reach: float) -> np.ndarray:
    """Return means of nearby values (h, w, c) float32 of a mask (h, w), within the edges of an image (h, w, 3)."""
    weight = inside[..., None].astype(np.float32)
    sums = averaged(np.concatenate([values * weight, weight], axis=2), seen, max(1.0, NEARBY * reach))
    return sums[..., :-1] / np.maximum(sums[..., -1:], 1e-20)


def _extent(mask: np.ndarray) -> tuple[slice, slice]:
    """Return the rows and columns of a mask (h, w)."""
    rows, columns = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
    return slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)


def _background(inside: np.ndarray, away: np.ndarray, reach: float) -> np.ndarray:
    """Return the mask (h, w) of what is far ``away`` (h, w, 1) from a mask, but not below it, as a neck is."""
    background = away[..., 0] > BACKGROUND * reach
    rows, columns = _extent(inside)
    background[rows.stop - 1 :, columns] = False
    return background


def _nearer_to_object(inside: np.ndarray, background: np.ndarray, seen: np.ndarray, reach: float) -> np.ndarray:
    """Return how much nearer pixels are to the mask than to the background, (h, w, 1) from 0 to 1, within edges."""
    both = averaged(np.dstack([inside, background]), seen, max(1.0, ACROSS * reach))
    near, far = np.dsplit(np.square(both), 2)  # squared, for a steeper division
    return near / np.maximum(near + far, 1e-12)


def _is_enclosed(solid: np.ndarray) -> np.ndarray:
    """Return the mask of what is not solid and not connected to the image's border by such pixels, (h, w, 1)."""
    filled = np.pad(solid, ((1, 1), (1, 1), (0, 0))).astype(np.uint8)  # a border, from which all outside is reached
    cv2.floodFill(filled, None, (0, 0), 1)
    return filled[1:-1, 1:-1] == 0


def _brightness_and_colours(log_image: np.ndarray, reach: float) -> tuple[np.ndarray, np.ndarray]:
    """Divide the logarithms of an image (h, w, 3), smoothed, into the means of channels (h, w, 1) and the rest.

    The rest (h, w, 3) is log-chromaticity, which a brighter light does not change.
    """
    smooth = cv2.GaussianBlur(log_image, (0, 0), max(BLUR_OWN, COLOUR_BLUR * reach))
    brightness = mean_of(smooth)[..., None]
    return brightness, smooth - brightness


def _alike_in_colour(inside: np.ndarray, colours: np.ndarray) -> np.ndarray:
    """Return how much pixels are like the object in log-chromaticity (h, w, 3), (h, w, 1) from 0 to 1."""
    mean = colours[inside].mean(axis=0)
    squares = 3.0 * mean_of(np.square(colours - mean))[..., None]  # sums over the three channels
    return np.exp(-0.5 * np.maximum(squares / ANOTHER_COLOUR**2 - 1.0, 0.0))


def _rather_of_object(
    inside: np.ndarray, background: np.ndarray, brightness: np.ndarray, colours: np.ndarray
) -> np.ndarray:
    """Return how much pixels are rather of the object than of the background by colour, (h, w, 1) from 0 to 1.

    Only this recognises a wall whose colour is not far from that of skin. It is about as bright as the rest of the
    background, while an ear in the shade, whose colour is uncertain, is darker. Pixels inside the mesh are of the
    object, and what is unlike both, such as hair, may be.
    """
    if background.sum() < ENOUGH_BACKGROUND * inside.sum():
        return np.ones_like(brightness)
    from_background = _squares(background, colours, LEAST_DEVIATION) + _squares(background, brightness, LEAST_CHANGE)
    from_object = _squares(inside, colours, LEAST_DEVIATION)
    nearer_to_object = np.minimum(from_background, UNLIKE) - np.minimum(from_object, UNLIKE)
    of_object = 1.0 / (1.0 + np.exp(-0.5 * (nearer_to_object + CLEARLY)))
    return np.where(inside[..., None], np.float32(1.0), of_object)


def _squares(mask: np.ndarray, values: np.ndarray, least: float) -> np.ndarray:
    """Return the sums (h, w, 1) of squared differences of values (h, w, c) from the usual ones in a mask.

    They are in robust standard deviations, which are at least about ``least``.
    """
    own = values[mask]
    usual = np.median(own, axis=0)
    deviation = MAD_TO_SD * np.median(np.abs(own - usual), axis=0)
    return (np.square(values - usual) / (np.square(deviation) + least**2)).sum(axis=2, keepdims=True)


def _brighter_or_paler(inside: np.ndarray, brightness: np.ndarray, colours: np.ndarray) -> np.ndarray:
    """Return how much pixels are brighter than the object, or brighter and paler, (h, w, 1) from 0 to 1.

    A little brighter is enough for pixels that are paler, too, as gloss and white walls are.
    """
    brighter = np.maximum(brightness - np.quantile(brightness[inside], BRIGHTEST), 0.0) / BRIGHTER
    mean = colours[inside].mean(axis=0)
    along = np.einsum("hwc,c->hw", colours, mean)[..., None]  # a matrix product depends on BLAS's number of threads
    saturation = (along + NEUTRAL) / (np.square(mean).sum() + NEUTRAL)  # relative to that of the object
    paler = smoothstep((VIVID - saturation) / (VIVID - PALE)) * smoothstep(brighter)
    return 1.0 - (1.0 - paler) * np.exp(-0.5 * np.square(brighter))


def averaged(layers: np.ndarray, seen: np.ndarray, scale: float) -> np.ndarray:
    """Average layers (h, w, c) in a Gaussian of ``scale`` pixels within the edges of an image ``seen``, (h, w, 3)."""
    filtered = np.array(layers, np.float32, order="C")
    # Standard deviations halve, and their squares sum to scale ** 2 (their equation 14).
    deviation = scale * np.sqrt(3.0) * 2.0 ** (ROUNDS - 1) / np.sqrt(4.0**ROUNDS - 1.0)
    factors = [_feedback(seen, axis, scale, deviation) for axis in (1, 0)]
    for _ in range(ROUNDS):
        _core.filter_rows_and_columns(filtered, *factors)
        factors = [np.square(each) for each in factors]  # those of half the standard deviation
    return filtered


def _feedback(seen: np.ndarray, axis: int, scale: float, deviation: float) -> np.ndarray:
    """Return how much of an average a recursive filter of a standard deviation carries from a pixel to the next one.

    They are next to each other along an axis of the image (h, w, 3). Their distance in the paper's transformed domain
    is 1 plus the change between them.
    """
    changes = np.abs(np.diff(seen, axis=axis))
    distances = 1.0 + np.float32(scale / EDGE) * (changes[..., 0] + changes[..., 1] + changes[..., 2])
    return np.exp(np.float32(-np.sqrt(2.0) / deviation) * distances)
