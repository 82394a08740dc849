"""Estimate from the symmetry of objects how far their landmarks lie to one side of where they should."""

from collections.abc import Sequence

import numpy as np

from liaam.model.shape import align
from liaam.model.warp import PiecewiseAffineWarp
from liaam.photometry import CameraModel
from liaam.photometry.encoding import as_colour
from liaam.training.entries import Entry
from liaam.training.lamps.copies import mirrored
from liaam.training.textures import sample_known
from liaam.workers import in_threads

# Smallest and largest number of images to compare with their mirror images
FEWEST = 5
MOST = 120
# Smallest offset that counts, in image pixels and in standard errors
LEAST = 0.2
LEAST_ERRORS = 4.0
# Least share of the mean difference between images and their mirror images that an offset must explain. Light from one
# side and marks on one side also give an offset, but it explains at most 0.02 for faces under flashes and lamps. The
# offsets of the landmarks of three sets of photographs explain 0.08 to 0.6.
EXPLAINED = 0.05


def sideways_offset(
    entries: Sequence[Entry], order: np.ndarray, warp: PiecewiseAffineWarp, camera: CameraModel, blur: float
) -> float:
    """Estimate how far the landmarks lie to the right of where the symmetry of the objects puts them, in image pixels.

    The offset is the same in all images, as from pixels that are counted from 1 or from their corners. Images and their
    mirror images then differ by a shift of twice the offset. The result is 0 if the offset is small, uncertain, or
    explains too little of this difference. ``order`` is that of :func:`liaam.model.shape.mirror_order`.
    """
    if len(entries) < FEWEST:
        return 0.0

    def compare(entry: Entry) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Mean and difference of both gradients (n_pixels, 2), and their shift (2,) by an offset of one pixel."""
        image = camera.flatten(as_colour(entry.read_image(), entry.name))
        both = ((image, entry.points), mirrored(image, entry.points, order))
        known = entry.known
        known_of_both = (known, None if known is None else known[order])
        (direct, usable), (other, also) = (
            sample_known(*pair, known, warp, "soft", camera.response, blur)
            for pair, known in zip(both, known_of_both, strict=True)
        )
        direct, other = (values[:, :2] * (usable * also)[:, None] for values in (direct, other))
        move = sum(align(warp.rest, points).inverse().matrix[:, 0] for _, points in both)
        return (direct + other) / 2.0, direct - other, np.asarray(move)

    some = np.unique(np.linspace(0, len(entries) - 1, MOST).astype(int))
    compared = in_threads(compare, [entries[i] for i in some])
    means, differences, moves = (np.array(each) for each in zip(*compared, strict=True))
    slopes = warp.slopes(means.mean(axis=0)).reshape(*means.shape[1:], 2)  # slopes along x and y, then channels
    shifted = np.einsum("ia,pac->ipc", moves, slopes)  # differences that an offset of one pixel makes
    products, powers = ((shifted * other).sum(axis=(1, 2)) for other in (differences, shifted))
    if not powers.any():
        return 0.0
    offset = float(products.sum() / powers.sum())
    n = len(some)
    error = np.linalg.norm(products - offset * powers) / powers.sum() * np.sqrt(n / (n - 1))
    mean = differences.mean(axis=0)
    unexplained = np.square(mean - offset * shifted.mean(axis=0)).sum()
    clear = abs(offset) > max(LEAST, LEAST_ERRORS * error) and unexplained < (1.0 - EXPLAINED) * np.square(mean).sum()
    return offset if clear else 0.0


def describe_offset(offset: float) -> str:
    """Describe what training does about an offset."""
    side = "right" if offset > 0 else "left"
    return (
        f"the landmarks lie {abs(offset):.1f} pixels to the {side} of where the symmetry of the objects puts them; "
        "mirrored copies allow for it"
    )
