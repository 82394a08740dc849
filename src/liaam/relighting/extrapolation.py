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

EDGE = 0.8  # Change of log light, summed over channels, that counts as a distance of one scale
BLUR_OWN = 1.0  # Standard deviation of the Gaussian that removes noise before that is measured, pixels
DARK = 0.05  # Light added, relative to the object's brightest: in the dark, noise and JPEG's blocks are edges of logs
ROUNDS = 3  # Number of passes over rows and columns; three leave no visible stripes

ACROSS = 12.0  # Scale of the division between object and background
EVEN = 0.5  # Scale within which it is evened out
BACKGROUND = 8.0  # Distance beyond the mesh from which an image is background
BORDER = 1.0  # Down to this depth inside the mesh, another colour is background, because the fit is not exact
# Without the differences of colour, light of the object shines on walls.
ANOTHER_COLOUR = 0.5  # Difference of log-chromaticity from the object's mean from which a pixel is rather background
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
    """Division of the surroundings of a mesh, whose mask is ``inside`` (h, w), between object and background.

    ``belongs`` (h, w, 1) is how much a pixel belongs to the object rather than to the background, whichever is nearer,
    where edges of the logarithms of light ``seen`` (h, w, 3) are distances. ``share`` (h, w, 1) is the same, falling to
    0 at ``FARTHEST`` times the ``reach``, pixels, from the mesh. ``gloss`` (h, w, 1) is how much it shines.
    """

    inside: np.ndarray
    belongs: np.ndarray
    gloss: np.ndarray
    share: np.ndarray
    seen: np.ndarray
    reach: float

    @classmethod
    def of(cls, inside: np.ndarray, own: np.ndarray, reach: float) -> "Surroundings":
        """Divide an image, whose edges in the logarithms of light (h, w, 3) are distances, around a mask (h, w)."""
        light = np.exp(own)
        own = np.log(light + DARK * np.float32(np.quantile(light[inside], BRIGHTEST)))
        seen = cv2.GaussianBlur(own, (0, 0), BLUR_OWN)
        away = distance_transform(~inside)[..., None]
        in_object = inside[..., None]
        nearer = np.where(in_object, np.float32(1.0), _nearer_to_object(inside, away, seen, reach))
        alike, bright = _alike(inside, own, reach)
        enclosed = (bright > A_LITTLE) & _is_enclosed((bright <= A_LITTLE) & (nearer >= 0.5))
        gloss = bright * enclosed
        belongs = (alike * (1.0 - bright) + gloss) * np.maximum(nearer, enclosed)
        depth = distance_transform(np.pad(inside, 1))[1:-1, 1:-1]
        is_deep = depth > min(BORDER * reach, 0.5 * depth.max())
        belongs = np.where(is_deep[..., None], np.float32(1.0), belongs)
        belongs = np.where(in_object, belongs, averaged(belongs, seen, max(1.0, EVEN * reach)))
        share = belongs * smoothstep(1.0 - (away - 1.0) / (FARTHEST * reach))
        share[share <= LEAST_SHARE] = 0.0
        gloss[in_object] = 0.0
        return cls(inside, belongs, gloss, share, seen, reach)

    def spread(self, values: np.ndarray, lit: np.ndarray) -> np.ndarray:
        """Return the light (h, w, 3) that is ``values`` inside the mesh, and ``lit`` plus the nearby rest around it."""
        at = _extent(self.share[..., 0] > 0)
        light = self.belongs * lit
        rest = values[at] - lit[at]
        inside = self.inside[at]
        grey = mean_of(rest)[..., None]
        in_object = inside[..., None]
        colour = averages(rest - grey, in_object, COLOUR * self.reach)
        light[at] += self.share[at] * np.where(
            in_object, rest, carried(grey + colour, inside, self.seen[at], self.reach)
        )
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


def _nearer_to_object(inside: np.ndarray, away: np.ndarray, seen: np.ndarray, reach: float) -> np.ndarray:
    """Return how much nearer pixels are to the mask than to the background, (h, w, 1) from 0 to 1, within edges.

    Background is what is far ``away`` (h, w, 1) from the mask, but not what is below it, such as a neck or a stem.
    """
    background = (away > BACKGROUND * reach).astype(np.float32)
    rows, columns = _extent(inside)
    background[rows.stop - 1 :, columns] = 0.0
    both = averaged(np.dstack([inside, background]), seen, max(1.0, ACROSS * reach))
    near, far = np.dsplit(np.square(both), 2)
    return near / np.maximum(near + far, 1e-12)


def _is_enclosed(solid: np.ndarray) -> np.ndarray:
    """Return the mask of what is not solid and not connected to the image's border by such pixels, (h, w, 1)."""
    filled = np.pad(solid, ((1, 1), (1, 1), (0, 0))).astype(np.uint8)
    cv2.floodFill(filled, None, (0, 0), 1)
    return filled[1:-1, 1:-1] == 0


def _alike(inside: np.ndarray, own: np.ndarray, reach: float) -> tuple[np.ndarray, np.ndarray]:
    """Return how much pixels are like the object in colour, and how much they are brighter, or paler too, (h, w, 1)."""
    colours = cv2.GaussianBlur(own, (0, 0), max(BLUR_OWN, COLOUR_BLUR * reach))
    brightness = mean_of(colours)[..., None]
    brighter = np.maximum(brightness - np.quantile(brightness[inside], BRIGHTEST), 0.0) / BRIGHTER
    colours = colours - brightness
    mean = colours[inside].mean(axis=0)
    apart = 3.0 * mean_of(np.square(colours - mean))[..., None] / ANOTHER_COLOUR**2
    along = np.einsum("hwc,c->hw", colours, mean)[..., None]  # a matrix product depends on BLAS's number of threads
    saturation = (along + NEUTRAL) / (np.square(mean).sum() + NEUTRAL)
    pale = smoothstep((VIVID - saturation) / (VIVID - PALE)) * smoothstep(brighter)
    return np.exp(-0.5 * np.maximum(apart - 1.0, 0.0)), 1.0 - (1.0 - pale) * np.exp(-0.5 * np.square(brighter))


def averaged(layers: np.ndarray, seen: np.ndarray, scale: float) -> np.ndarray:
    """Average layers (h, w, c) in a Gaussian of ``scale`` pixels within the edges of an image ``seen``, (h, w, 3)."""
    filtered = np.array(layers, np.float32, order="C")
    # Standard deviations halve, and their squares sum to scale ** 2 (their equation 14).
    deviation = scale * np.sqrt(3.0) * 2.0 ** (ROUNDS - 1) / np.sqrt(4.0**ROUNDS - 1.0)
    steps = (np.abs(np.diff(seen, axis=axis)) for axis in (1, 0))
    lengths = (1.0 + np.float32(scale / EDGE) * (each[..., 0] + each[..., 1] + each[..., 2]) for each in steps)
    factors = [np.exp(np.float32(-np.sqrt(2.0) / deviation) * each) for each in lengths]
    for _ in range(ROUNDS):
        _core.filter_rows_and_columns(filtered, *factors)
        factors = [np.square(each) for each in factors]
    return filtered
