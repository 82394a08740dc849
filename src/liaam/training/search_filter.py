"""The filter with which the search looks for the object after a fit of low quality, or with several parts.

It is the mean of the training images' gradient orientations, at the resolution of the search and with the small
differences in pose that a search leaves, whitened by the covariance that such orientations have in random images. Of
all linear filters, this one separates the mean from them best. Random images are dead leaves (Lee, Mumford and Huang,
"Occlusion models for natural images", IJCV 2001), whose statistics are those of photographs.
"""

from functools import lru_cache
from typing import cast

import numpy as np

from liaam.fitting.search.templates import TEMPLATE, Grey, soft_directions
from liaam.model import AAM
from liaam.model.mesh import ReferenceFrame
from liaam.model.shape import align, rotation
from liaam.model.warp import picture_corners
from liaam.photometry import Response

# Largest differences in pose that are averaged: degrees, logarithm of size, and pixels of the filter. Rotations of the
# search are 10 degrees apart, and sizes a factor of 1.2.
TURN = 7.0
GROWTH = 0.1
SHIFT = 1.0
RIDGE = 0.1  # Variance added to that of random images, as a fraction of it
# Number of random images, their sides, the number of leaves in each, and the smallest radius of one, pixels
LEAVES = 60
SIDE = 160
N_LEAVES = 600
SMALLEST = 3.0
BORDER = 4  # Margin around the filter's window in which gradients are computed, pixels


class FilterLearner:
    """Collects the orientations of training images around the object, and learns the search's filter from them.

    Parameters
    ----------
    model : AAM
        Model with the mean shape and the mesh.
    blur : float
        Blur of the search, pixels of the model's reference frame.
    """

    def __init__(self, model: AAM, blur: float) -> None:
        factor = min(1.0, TEMPLATE / model.diagonal)
        self.mean = model.shape_model.mean * factor
        self.blur = blur * factor
        self.response: Response = model.response
        frame = ReferenceFrame(self.mean, model.triangles)
        at = np.rint(frame.pixels[:, ::-1] + frame.origin).astype(int)
        self.half = np.abs(at).max(axis=0)
        self.inside = np.zeros(2 * self.half[::-1] + 1, bool)
        self.inside[at[:, 1] + self.half[1], at[:, 0] + self.half[0]] = True
        self.total = np.zeros((*self.inside.shape, 2))
        self.counts = np.zeros(self.inside.shape)  # images that show each pixel's part of the object
        self.count = 0
        self._at = at
        self._frame = frame

    def add(self, image: np.ndarray, points: np.ndarray, known: np.ndarray | None = None) -> None:
        """Add a training image or a copy of one, in a pose near that of its landmarks.

        Pixels that the ``known`` landmarks (n,) do not place are left out.
        """
        import cv2  # heavy: imported when first needed

        rng = np.random.default_rng([40, self.count])
        pose = align(self.mean, points)
        turn = np.deg2rad(rng.uniform(-TURN, TURN))
        growth = np.exp(rng.uniform(-GROWTH, GROWTH))
        matrix = pose.matrix @ rotation(turn) * growth
        offset = pose.offset + pose.scale * rng.uniform(-SHIFT, SHIFT, 2)
        grey = Grey.of(image, self.response, float(np.sqrt(np.linalg.det(matrix))))
        matrix = matrix / grey.reduce
        offset = (offset + 0.5) / grey.reduce - 0.5
        left = max(np.linalg.det(matrix) - 1.0, 0.0)  # what is left to average over, as a variance
        values = cv2.GaussianBlur(grey.values, (0, 0), 0.5 * np.sqrt(left)) if left > 0.01 else grey.values
        affine = np.column_stack([matrix, offset - matrix @ (self.half + BORDER)])
        width, height = (2 * (self.half + BORDER) + 1).tolist()
        # OpenCV samples no picture with a side of 32767 pixels or more, so what lies around the object is cut out.
        ends = picture_corners(height, width) @ affine[:, :2].T + affine[:, 2]
        most = np.array(values.shape[::-1])
        left, top = np.clip(np.floor(ends.min(axis=0)) - 2, 0, most - 1).astype(int)
        right, bottom = np.clip(np.ceil(ends.max(axis=0)) + 3, 1, most).astype(int)
        if most.max() >= 32_767:
            values = values[top:bottom, left:right]
            affine = affine - np.array([[0, 0, left], [0, 0, top]])
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        seen = cv2.warpAffine(values, affine, (width, height), flags=flags, borderMode=cv2.BORDER_REPLICATE)
        field = soft_directions(seen, self.blur)[BORDER:-BORDER, BORDER:-BORDER]
        used = self._used(known)
        self.total += np.stack([np.real(field), np.imag(field)], axis=-1) * used[..., None]
        self.counts += used
        self.count += 1

    def _used(self, known: np.ndarray | None) -> np.ndarray:
        """Return the pixels of the window to use of an image with some known landmarks, (h, w) bool; by default all."""
        if known is None:
            return np.ones(self.inside.shape, bool)
        used = np.zeros(self.inside.shape, bool)
        x, y = self._at[self._frame.are_known(known)].T
        used[y + self.half[1], x + self.half[0]] = True
        return used

    def learnt(self) -> np.ndarray:
        """Return the filter, (h, w, 2) float32, whose response to the mean is 1."""
        y, x = np.nonzero(self.inside)
        mean = (self.total[y, x] / np.maximum(self.counts[y, x], 1)[:, None]).T.ravel()
        along = _covariances(self.blur, max(self.inside.shape))[:, :, y[:, None] - y, x[:, None] - x]
        noise = along.transpose(0, 2, 1, 3).reshape(len(mean), len(mean))
        noise[np.diag_indices(len(mean))] += RIDGE * noise.trace() / len(mean)
        weights = np.linalg.solve(noise, mean)
        weighted = np.zeros(self.total.shape, np.float16)
        weighted[y, x] = (weights / (weights @ mean)).reshape(2, -1).T
        return weighted.astype(np.float32)


@lru_cache(maxsize=4)
def _covariances(blur: float, reach: int) -> np.ndarray:
    """Return the covariances (2, 2, size, size) of orientations by their distance along y and x, cyclic.

    The size is a product of small primes: transforms of others take ten times as long.
    """
    from scipy import fft  # heavy: imported when first needed

    size = cast("int", fft.next_fast_len(SIDE + reach, real=True))
    power: np.ndarray | float = 0.0
    for image in _random_images():
        field = soft_directions(image, blur)
        spectrum = np.asarray(fft.rfft2(np.stack([np.real(field), np.imag(field)]), (size, size)))
        power = power + spectrum[:, None] * spectrum[None].conj()
    apart = np.minimum(np.arange(size), size - np.arange(size))
    pairs = np.maximum(SIDE - apart, 1)
    return fft.irfft2(power / LEAVES, (size, size)) / (pairs[:, None] * pairs)


@lru_cache(maxsize=1)
def _random_images() -> np.ndarray:
    """Draw the random images, (LEAVES, SIDE, SIDE) float32, once for all models of a process.

    They are ellipses and boxes that hide each other, with some noise.
    """
    import cv2  # heavy: imported when first needed

    rng = np.random.default_rng(41)
    images = []
    few = (0.5 * SIDE) ** -2
    many = SMALLEST**-2
    for _ in range(LEAVES):
        image = np.full((SIDE, SIDE), rng.uniform(), np.float32)
        for radius in (many + rng.uniform(size=N_LEAVES) * (few - many)) ** -0.5:
            x, y = rng.uniform(-10.0, SIDE + 10.0, 2).tolist()
            box = (x, y), (2.0 * radius, 2.0 * radius * rng.uniform(0.3, 1.0)), rng.uniform(0.0, 180.0)
            if rng.uniform() < 0.5:
                cv2.ellipse(image, box, float(rng.uniform()), -1, cv2.LINE_AA)
            else:
                corners = np.rint(cv2.boxPoints(box)).astype(np.int32)
                cv2.fillConvexPoly(image, corners, float(rng.uniform()), cv2.LINE_AA)
        grain = cv2.GaussianBlur(rng.normal(size=image.shape).astype(np.float32), (0, 0), 1.0)
        images.append(image + 0.03 * grain)
    return np.stack(images)
