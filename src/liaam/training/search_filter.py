"""The filter with which the search looks for the object after a fit of low quality, or with several parts.

It is the mean of the training images' gradient orientations, at the resolution of the search and with the small
differences in pose that a search leaves, whitened by the covariance that such orientations have in random images. Of
all linear filters, this one separates the mean from them best (Hariharan, Malik and Ramanan, "Discriminative
decorrelation for clustering and classification", ECCV 2012). Random images are dead leaves (Lee, Mumford and Huang,
"Occlusion models for natural images", IJCV 2001), whose statistics are those of photographs.

Hair before a bright or a dark wall has opposite orientations, which cancel in the mean, while those of the doubled
angle agree. So the filter sees both, and how long they are (:func:`liaam.fitting.search.templates.channels_of`). It
does not respond to a length that is the same everywhere: pictures differ in how many edges they have.
"""

from functools import lru_cache
from typing import cast

import numpy as np

from liaam.fitting.search.templates import TEMPLATE, Grey, channels_of, soft_directions
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
N_CHANNELS = 5  # Of the orientations
LENGTH = 4  # The last of these, the length
RIDGE = 0.1  # Variance added to that of each channel in random images, as a fraction of it
PRECISION = 1e-4  # Of the weights; files hold them in 16 bits
BORDER = 4  # Margin around the filter's window in which gradients are computed, pixels
LEAST_EXCESS = 0.01  # Least excess of pixels that an image is blurred for (see FilterLearner.add)
OPENCV_SIDE = 32_767  # Pixels; of images with such a side OpenCV warps none

N_IMAGES = 60  # Number of random images
SIDE = 160  # Side of one, pixels
N_LEAVES = 600  # Number of leaves in one: they hide about nine tenths of the ground
SMALLEST = 3.0  # Smallest radius of a leaf, pixels; the largest is half the side
LEAST_ASPECT = 0.3  # Least ratio of a leaf's sides
BEYOND = 10.0  # Distance to which centres of leaves lie beyond the image, pixels
GRAIN = 0.03  # Factor on white noise, blurred by 1 pixel; leaves have grey values from 0 to 1


class FilterLearner:
    """Collects the orientations of training images around the object, and learns the search's filter from them.

    The filter's window is the smallest rectangle around the mean shape, at the size of the search's templates, whose
    middle pixel is the origin of the shape.

    Parameters
    ----------
    model : AAM
        Model with the mean shape and the mesh.
    blur : float
        Blur of the search, pixels of the model's reference frame.

    Attributes
    ----------
    mean : (n, 2) float64
        Mean shape, pixels of the filter, and the blur in these.
    half : (2,) int
        Pixels (x, y) of the window on each side of the middle one.
    inside : (h, w) bool
        Pixels of the window inside the mesh.
    total : (5, h, w) float64
        Sums of the channels, and ``counts`` (h, w) of the images that they are of, which show that part.
    n_images : int
        Number of images so far.
    """

    def __init__(self, model: AAM, blur: float) -> None:
        factor = min(1.0, TEMPLATE / model.diagonal)
        self.mean = model.shape_model.mean * factor
        self.blur = blur * factor
        self.response: Response = model.response
        self._frame = ReferenceFrame(self.mean, model.triangles)
        # (x, y) of the mesh's pixels from the origin of the shape
        pixels = np.rint(self._frame.pixels[:, ::-1] + self._frame.origin).astype(int)
        self.half = np.abs(pixels).max(axis=0)
        self._x, self._y = (pixels + self.half).T  # of the same pixels in the window
        self.inside = np.zeros(2 * self.half[::-1] + 1, bool)
        self.inside[self._y, self._x] = True
        self.total = np.zeros((N_CHANNELS, *self.inside.shape))
        self.counts = np.zeros(self.inside.shape)
        self.n_images = 0

    def add(self, image: np.ndarray, points: np.ndarray, known: np.ndarray | None = None) -> None:
        """Add a training image or a copy of one, in a pose near that of its landmarks.

        Pixels that the ``known`` landmarks (n,) do not place are left out.
        """
        import cv2  # heavy: imported when first needed

        rng = np.random.default_rng([40, self.n_images])  # other images make no difference
        pose = align(self.mean, points)
        turn = np.deg2rad(rng.uniform(-TURN, TURN))
        growth = np.exp(rng.uniform(-GROWTH, GROWTH))
        # A similarity from pixels of the filter, relative to the shape's origin, to pixels of the image.
        matrix = pose.matrix @ rotation(turn) * growth
        offset = pose.offset + pose.scale * rng.uniform(-SHIFT, SHIFT, 2)
        grey = Grey.of(image, self.response, float(np.sqrt(np.linalg.det(matrix))))
        matrix = matrix / grey.reduce  # to pixels of the reduced image, whose centres lie in the middle of blocks
        offset = (offset + 0.5) / grey.reduce - 0.5
        values = grey.values
        # A pixel of the filter covers s^2 pixels of the image. A blur by half of sqrt(s^2 - 1) prevents aliasing.
        excess = max(np.linalg.det(matrix) - 1.0, 0.0)
        if excess > LEAST_EXCESS:
            values = cv2.GaussianBlur(values, (0, 0), 0.5 * np.sqrt(excess))
        affine = np.column_stack([matrix, offset - matrix @ (self.half + BORDER)])  # from the window with its border
        width, height = (2 * (self.half + BORDER) + 1).tolist()
        values, affine = _cut_for_opencv(values, affine, width, height)
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        window = cv2.warpAffine(values, affine, (width, height), flags=flags, borderMode=cv2.BORDER_REPLICATE)
        field = soft_directions(window, self.blur)[BORDER:-BORDER, BORDER:-BORDER]
        used = self._used(known)
        self.total += channels_of(field, N_CHANNELS) * used
        self.counts += used
        self.n_images += 1

    def _used(self, known: np.ndarray | None) -> np.ndarray:
        """Return the pixels of the window to use of an image with some known landmarks, (h, w) bool; by default all."""
        if known is None:
            return np.ones(self.inside.shape, bool)
        are_known = self._frame.are_known(known)
        used = np.zeros(self.inside.shape, bool)
        used[self._y[are_known], self._x[are_known]] = True
        return used

    def learnt(self) -> np.ndarray:
        """Return the filter, whose response to the mean is 1: (h, w, 5) float32, rounded to 16 bits as in its file."""
        mean = self._without_mean_length(self.total / np.maximum(self.counts, 1) * self.inside)
        weights = self._whitened(mean)
        search_filter = weights / (weights * mean).sum()
        return np.moveaxis(search_filter, 0, 2).astype(np.float16).astype(np.float32)

    def _without_mean_length(self, channels: np.ndarray) -> np.ndarray:
        """Subtract the mean of the lengths inside from them, in channels (5, h, w) that are 0 outside."""
        centred = channels.copy()
        centred[LENGTH] -= self.inside * (channels[LENGTH].sum() / self.inside.sum())
        return centred

    def _whitened(self, mean: np.ndarray) -> np.ndarray:
        """Solve C w = m, with the covariance C of random images inside the mesh, for the mean m (5, h, w).

        C depends on the distance of two pixels alone, so that a product with it is a convolution. Conjugate gradients
        need some dozens of these.
        """
        from scipy import fft  # heavy: imported when first needed
        from scipy.sparse.linalg import LinearOperator, cg

        by_distance = _covariances(self.blur, max(self.inside.shape))
        variances = np.einsum("ccyx->cyx", by_distance)[:, 0, 0]
        height, width = self.inside.shape
        size = (fft.next_fast_len(2 * height - 1, real=True), fft.next_fast_len(2 * width - 1, real=True))
        spectrum = fft.rfft2(_cut_cyclic(by_distance, height, width, size))

        def product(flat: np.ndarray) -> np.ndarray:
            weights = self._without_mean_length(flat.reshape(mean.shape))
            of_weights = fft.rfft2(weights, size)
            values = fft.irfft2(np.einsum("cdyx,dyx->cyx", spectrum, of_weights), size)[:, :height, :width]
            values = values * self.inside + RIDGE * variances[:, None, None] * weights
            return self._without_mean_length(values).ravel()

        operator = LinearOperator((mean.size, mean.size), matvec=product, dtype=np.float64)
        weights, _ = cg(operator, mean.ravel(), rtol=PRECISION)
        return weights.reshape(mean.shape)


def _cut_for_opencv(values: np.ndarray, affine: np.ndarray, width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
    """Cut out of an image (h, w) what an affine map (2, 3) takes a window of a size to, if its sides are too long.

    Return the part, with the map to it; or both as they are.
    """
    size = np.array(values.shape[::-1])
    if size.max() < OPENCV_SIDE:
        return values, affine
    corners = picture_corners(height, width) @ affine[:, :2].T + affine[:, 2]
    # With two pixels around, between which the border is interpolated.
    left, top = np.clip(np.floor(corners.min(axis=0)) - 2, 0, size - 1).astype(int)
    right, bottom = np.clip(np.ceil(corners.max(axis=0)) + 3, 1, size).astype(int)
    return values[top:bottom, left:right], affine - np.array([[0, 0, left], [0, 0, top]])


@lru_cache(maxsize=4)
def _covariances(blur: float, reach: int) -> np.ndarray:
    """Return the covariances of the channels of orientations in random images, by the distance of two pixels.

    The result is (5, 5, size, size): first, second channel, distance along y and x. Distances are cyclic, so that
    index -1 is a distance of -1; those of at most ``reach`` are valid.
    """
    from scipy import fft  # heavy: imported when first needed

    # A product of small primes: transforms of other sizes take ten times as long.
    size = cast("int", fft.next_fast_len(SIDE + reach, real=True))
    fields = [channels_of(soft_directions(image, blur), N_CHANNELS) for image in _random_images()]
    mean = np.mean([field.mean(axis=(1, 2)) for field in fields], axis=0)  # not 0 of the lengths
    power: np.ndarray | float = 0.0
    for field in fields:
        spectrum = np.asarray(fft.rfft2(field - mean[:, None, None], (size, size)))
        power = power + spectrum[:, None] * spectrum[None].conj()
    distance = np.minimum(np.arange(size), size - np.arange(size))
    n_pairs = np.maximum(SIDE - distance, 1)  # of rows, or of columns, of an image at that distance
    return fft.irfft2(power / N_IMAGES, (size, size)) / (n_pairs[:, None] * n_pairs)


def _cut_cyclic(values: np.ndarray, height: int, width: int, size: tuple[int, int]) -> np.ndarray:
    """Return values by cyclic distance (..., n, n) for smaller distances than height and width, in arrays of a size."""
    rows = np.arange(1 - height, height)[:, None]
    columns = np.arange(1 - width, width)
    cut = np.zeros((*values.shape[:-2], *size))
    cut[..., rows, columns] = values[..., rows, columns]
    return cut


@lru_cache(maxsize=1)
def _random_images() -> np.ndarray:
    """Draw the random images, (N_IMAGES, SIDE, SIDE) float32, once for all models of a process.

    They are ellipses and boxes that hide each other, with some noise.
    """
    import cv2  # heavy: imported when first needed

    rng = np.random.default_rng(41)
    images = []
    # The density of radii r is r^-3, under which dead leaves look alike at every scale. Its distribution is linear in
    # r^-2, which is drawn uniformly between those of the smallest and of the largest radius.
    of_smallest = SMALLEST**-2
    of_largest = (0.5 * SIDE) ** -2
    for _ in range(N_IMAGES):
        image = np.full((SIDE, SIDE), rng.uniform(), np.float32)
        radii = (of_smallest + rng.uniform(size=N_LEAVES) * (of_largest - of_smallest)) ** -0.5
        for radius in radii:
            x, y = rng.uniform(-BEYOND, SIDE + BEYOND, 2).tolist()
            box = (x, y), (2.0 * radius, 2.0 * radius * rng.uniform(LEAST_ASPECT, 1.0)), rng.uniform(0.0, 180.0)
            if rng.uniform() < 0.5:
                cv2.ellipse(image, box, float(rng.uniform()), -1, cv2.LINE_AA)
            else:
                corners = np.rint(cv2.boxPoints(box)).astype(np.int32)
                cv2.fillConvexPoly(image, corners, float(rng.uniform()), cv2.LINE_AA)
        grain = cv2.GaussianBlur(rng.normal(size=image.shape).astype(np.float32), (0, 0), 1.0)
        images.append(image + GRAIN * grain)
    return np.stack(images)
