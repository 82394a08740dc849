"""Extrapolation beyond the mesh, where the model has no values, along the edges of the image.

Averages preserve edges by the domain transform (Gastal and Oliveira, "Domain transform for edge-aware image and video
processing", ACM TOG 2011), in which a change of light counts as a distance.
"""

from dataclasses import dataclass

import numpy as np

from liaam import _core
from liaam.relighting.painting import mean_of

FARTHEST = 4.0
"""Distance beyond the mesh to which values extend, in reaches."""

BLUR_OWN = 1.0
"""Standard deviation of the Gaussian that denoises the image before its edges are used, pixels."""

EDGE = 0.8
"""Change of log light, summed over channels, that counts as a distance of one scale."""

NEARBY = 0.8
"""Scale of averages of values, in reaches."""

COLOUR = 4.0
"""Scale of averages of the colour of light, in reaches. Lamps of two colours mix slowly over a surface, and at the
border of the mesh another colour is rather a brow's."""

ACROSS = 12.0
"""Scale of the division between object and background, in reaches."""

BORDER = 1.0
"""Depth inside the mesh, in reaches, down to which another colour is background, because the fit is not exact."""

BACKGROUND = 8.0
"""Distance beyond the mesh from which an image is background, in reaches."""

BELOW = 0.5
"""What is below the mesh, and by this fraction of its width wider, is no background: a neck or a stem."""

ANOTHER_COLOUR, COLOUR_BLUR = 0.5, 0.1
"""Difference of log-chromaticity from the object's mean from which a pixel is rather background, and standard deviation
of the Gaussian before it is measured, in reaches."""

EVEN = 0.5
"""Scale within which that division is evened out, in reaches."""

BRIGHTER, BRIGHTEST = 0.3, 0.95
"""Logarithm of light above the brightest of the object, from which a pixel is rather background, as a wall is behind a
dark face; the brightest is this quantile."""

DARK = 0.05
"""Light that is added before edges are measured, relative to the brightest of the object: in the dark, noise and JPEG's
blocks are edges of logarithms."""

ROUNDS = 3
"""Number of passes over rows and columns; three leave no visible stripes."""

ENOUGH = 16.0
"""Scale in pixels from which averages are computed at a lower resolution."""

LEAST_SHARE = 1e-3
"""Share below which it is 0."""


@dataclass(frozen=True, eq=False)
class Surroundings:
    """Division of the surroundings of a mesh between object and background, (h, w) pixels.

    Attributes
    ----------
    inside : (h, w) bool
        Inside the mesh.
    belongs : (h, w, 1) float32
        How much a pixel belongs to the object rather than to the background, which is what lies beyond
        :data:`BACKGROUND`, but for what is :data:`BELOW`. In between, the nearer one counts, where edges are distances.
    share : (h, w, 1) float32
        The same, falling to 0 at :data:`FARTHEST` times the reach from the mesh.
    reach : float
        In pixels.
    """

    inside: np.ndarray
    belongs: np.ndarray
    share: np.ndarray
    reach: float

    @classmethod
    def of(cls, inside: np.ndarray, own: np.ndarray, reach: float) -> "Surroundings":
        """Divide an image, whose edges in the logarithms of light (h, w, 3) are distances, around a mask (h, w)."""
        return cls(inside, *_division(inside, own, reach), reach)

    def spread(self, values: np.ndarray, lit: np.ndarray, own: np.ndarray) -> np.ndarray:
        """Return the light (h, w, c) that is ``values`` inside the mesh, and ``lit`` plus the nearby rest around it.

        It follows the edges of the logarithms of light ``own``, (h, w, 3).
        """
        rest = values - lit
        grey = mean_of(rest)[..., None]
        rest = grey + _blurred(rest - grey, self.inside, COLOUR * self.reach)
        nearby = carried(rest, self.inside, own, self.reach)
        light = np.where(self.inside[..., None], self.belongs * values, self.share * nearby + self.belongs * lit)
        return light.astype(np.float32)


def _division(inside: np.ndarray, own: np.ndarray, reach: float) -> tuple[np.ndarray, np.ndarray]:
    """Return ``belongs`` and ``share`` of :class:`Surroundings`."""
    import cv2

    depth, away = _distance(np.pad(inside, 1))[1:-1, 1:-1], _distance(~inside)[..., None]
    own, seen = _edges(own, inside)
    known, elsewhere = inside[..., None].astype(np.float32), (away > BACKGROUND * reach).astype(np.float32)
    rows, columns = (np.flatnonzero(inside.any(axis=axis)) for axis in (1, 0))
    wider = round(BELOW * len(columns))
    elsewhere[rows[-1] :, max(columns[0] - wider, 0) : columns[-1] + wider + 1] = 0.0
    sums = averaged(np.concatenate([known, elsewhere], axis=2), seen, max(1.0, ACROSS * reach))
    object_side, other_side = np.square(sums[..., :1]), np.square(sums[..., 1:])
    belongs = np.where(known > 0, 1.0, object_side / np.maximum(object_side + other_side, 1e-12))
    colours = cv2.GaussianBlur(own, (0, 0), max(BLUR_OWN, COLOUR_BLUR * reach))
    brightness = mean_of(colours)[..., None]
    brighter = np.maximum(brightness - np.quantile(brightness[inside], BRIGHTEST), 0.0) / BRIGHTER
    colours = colours - brightness
    apart = 3.0 * mean_of(np.square(colours - colours[inside].mean(axis=0)))[..., None] / ANOTHER_COLOUR**2
    alike = np.exp(-0.5 * (np.maximum(apart - 1.0, 0.0) + np.square(brighter)))
    certain = (depth > min(BORDER * reach, 0.5 * depth.max()))[..., None]  # that of the mesh is 1
    belongs = np.where(certain, 1.0, alike * belongs)
    belongs = np.where(known > 0, belongs, averaged(belongs, seen, max(1.0, EVEN * reach))).astype(np.float32)
    share = belongs * smoothstep(1.0 - (away - 1.0) / (FARTHEST * reach))
    share = np.where(share > LEAST_SHARE, share, 0.0).astype(np.float32)
    return belongs, np.where(known > 0, belongs, share)


def carried(values: np.ndarray, inside: np.ndarray, own: np.ndarray, reach: float) -> np.ndarray:
    """Return means of nearby values (h, w, c) float32 of a mask (h, w), within the edges of an image (h, w, 3)."""
    return _means(averaged(_weighted(values, inside), _edges(own, inside)[1], max(1.0, NEARBY * reach)))


def _blurred(values: np.ndarray, inside: np.ndarray, scale: float) -> np.ndarray:
    """Return averages of values (h, w, c) over a mask (h, w), by two box filters of a standard deviation."""
    import cv2

    width = 2 * round(1.22 * scale) + 1  # the variances of boxes, (width**2 - 1) / 12, sum to scale**2
    return _means(cv2.blur(cv2.blur(_weighted(values, inside), (width, width)), (width, width)))


def _weighted(values: np.ndarray, inside: np.ndarray) -> np.ndarray:
    """Return values (h, w, c), 0 outside a mask (h, w), and the mask as a last layer, to be averaged."""
    known = inside[..., None].astype(np.float32)
    return np.concatenate([values * known, known], axis=2)


def _means(sums: np.ndarray) -> np.ndarray:
    """Return the means, (h, w, c), of averages of the layers of :func:`_weighted`."""
    return sums[..., :-1] / np.maximum(sums[..., -1:], 1e-20)


def _distance(mask: np.ndarray) -> np.ndarray:
    """Return the distance of each pixel of a mask (h, w) from the rest, float32."""
    import cv2

    return cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)


def _edges(own: np.ndarray, inside: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return logarithms of light (h, w, 3) without the noise of the dark, and the same blurred, whose edges divide."""
    import cv2

    light = np.exp(own)
    own = np.log(light + DARK * np.float32(np.quantile(light[inside], BRIGHTEST)))
    return own, cv2.GaussianBlur(own, (0, 0), BLUR_OWN)


def averaged(layers: np.ndarray, seen: np.ndarray, scale: float, edge: float = EDGE) -> np.ndarray:
    """Average layers over nearby pixels of similar colour; at a lower resolution if the scale is large.

    Parameters
    ----------
    layers : (h, w, c) float
    seen : (h, w, 3) float
        Image that defines the edges.
    scale : float
        Standard deviation in regions of constant colour, pixels.
    edge : float
        Change of ``seen``, summed over channels, that counts as a distance of ``scale``.

    Returns
    -------
    (h, w, c) float32
    """
    if (step := int(scale / ENOUGH)) > 1:
        height, width = seen.shape[:2]
        small = -(-width // step), -(-height // step)
        found = averaged(_resized(layers, small), _resized(seen, small), scale / step, edge)
        return _resized(found, (width, height))
    found = np.array(layers, np.float32, order="C")
    steps = (np.abs(np.diff(seen, axis=axis)) for axis in (1, 0))
    across, down = (1.0 + np.float32(scale / edge) * (each[..., 0] + each[..., 1] + each[..., 2]) for each in steps)
    for i in range(ROUNDS):  # standard deviations halve, and their squares sum to scale ** 2 (their equation 14)
        deviation = scale * np.sqrt(3.0) * 2.0 ** (ROUNDS - i - 1) / np.sqrt(4.0**ROUNDS - 1.0)
        decay = np.float32(-np.sqrt(2.0) / deviation)
        kept = (np.exp(decay * each) for each in (across, down))
        _core.filter_rows_and_columns(found, *map(np.ascontiguousarray, kept))
    return found


def _resized(layers: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Resize layers (h, w, c) to (width, height), four at a time as OpenCV requires; by area means if smaller."""
    import cv2

    how = cv2.INTER_AREA if size[0] < layers.shape[1] else cv2.INTER_LINEAR
    parts = range(0, layers.shape[2], 4)
    return np.dstack([cv2.resize(layers[..., i : i + 4], size, interpolation=how) for i in parts])


def smoothstep(x):
    """Rise smoothly from 0 at 0 to 1 at 1."""
    x = np.clip(x, 0.0, 1.0)
    return x * x * (3.0 - 2.0 * x)
