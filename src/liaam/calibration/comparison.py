"""Agreement of the invariant images of registered images."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from liaam.calibration.scatter import block_labels, observe
from liaam.errors import ImageError
from liaam.photometry.camera import CameraModel, NoiseModel
from liaam.photometry.encoding import as_colour, refuse_grey
from liaam.photometry.invariant import LUMINANCE, invariant


@dataclass(frozen=True)
class Agreement:
    """Agreement of two images of one scene under different lights.

    Attributes
    ----------
    first, second : int
        Indices of the images.
    invariant, log_grey : float
        Correlation of their invariant images, and of the logarithms of their luminance; NaN without enough pixels.
    share : float
        Fraction of the selected pixels that are well exposed in both.
    """

    first: int
    second: int
    invariant: float
    log_grey: float
    share: float


@dataclass(frozen=True, eq=False)
class Averaged:
    """Projections of the mean linear light of registered images in blocks.

    Attributes
    ----------
    invariant : (m, h, w) float64
        Invariant values of m images, NaN where a block is dark, saturated or masked.
    log_grey : (m, h, w) float64
        Logarithm of luminance, NaN in the same blocks.
    wanted : int
        Number of selected blocks: all, or those of the mask.
    """

    invariant: np.ndarray
    log_grey: np.ndarray
    wanted: int


def averaged(
    images: Sequence[np.ndarray],
    camera: CameraModel | None = None,
    *,
    block: int = 1,
    dark: float | None = None,
    mask: np.ndarray | None = None,
    names: Sequence[str] | None = None,
) -> Averaged:
    """Average registered images over blocks in linear light, and project the means.

    Parameters
    ----------
    images : sequence of (h, w, 3) uint8, uint16 or float arrays
        Images of equal size in which a pixel shows the same surface.
    camera : CameraModel, optional
    block : int
        Side of a block, pixels; averaging reduces noise and rounding errors, 1 disables it.
    dark : float, optional
        Stored value, in [0, 1], below which a block is unusable, in any channel; by default the least with a usable
        logarithm, 7.5/255 of sRGB.
    mask : (h, w) bool, optional
        Selected pixels.
    names : sequence of str, optional
        Names of the images in error messages.

    Returns
    -------
    Averaged

    Raises
    ------
    ImageError
        If there are fewer than two images, they differ in size, or are grey.
    CameraError
        If the blocks are wider than a third of the images.
    """
    camera = camera or CameraModel()
    names = names or [f"image {i + 1}" for i in range(len(images))]
    pictures = [as_colour(image, name) for image, name in zip(images, names, strict=True)]
    if len(pictures) < 2 or len({picture.shape for picture in pictures}) > 1:
        raise ImageError("to compare invariant images, give two or more registered images of one size")
    for picture, name in zip(pictures, names, strict=True):
        refuse_grey(picture, name, "an invariant image needs colour")
    height, width = pictures[0].shape[:2]
    labels, (down, across) = block_labels(height, width, block)
    if mask is not None:
        if mask.shape != (height, width):
            raise ImageError(f"the mask is {mask.shape[1]}×{mask.shape[0]} pixels, the images {width}×{height}")
        labels = np.where(mask, labels, -1)
    m = len(pictures)
    # Without noise, observe keeps no distance from the limits of exposure, and does not correct logarithms for it.
    noiseless = replace(camera, noise=NoiseModel(0.0, 0.0))
    surfaces = observe(pictures, [labels] * m, down * across, noiseless, full=block * block, dark=dark)

    def maps(values: np.ndarray) -> np.ndarray:
        """Arrange values (blocks, m) as images (m, down, across), NaN where a block is not well exposed."""
        return np.where(surfaces.exposed, values, np.nan).T.reshape(m, down, across)

    log_grey = np.log(np.exp(surfaces.log_rgb) @ LUMINANCE[0])
    return Averaged(
        invariant=maps(invariant(surfaces.log_rgb, camera.theta)),
        log_grey=maps(log_grey),
        wanted=len(np.unique(labels[labels >= 0])),
    )


def agreement(blocks: Averaged) -> list[Agreement]:
    """Correlate the invariant images, and the logarithms of luminance, of all pairs of registered images.

    Parameters
    ----------
    blocks : Averaged
        Result of :func:`averaged`.

    Returns
    -------
    list of Agreement
        One for each pair.
    """
    agreements = []
    for i, j in combinations(range(len(blocks.invariant)), 2):
        both = np.isfinite(blocks.invariant[i]) & np.isfinite(blocks.invariant[j])
        agreements.append(
            Agreement(
                first=i,
                second=j,
                invariant=_correlation(blocks.invariant[i][both], blocks.invariant[j][both]),
                log_grey=_correlation(blocks.log_grey[i][both], blocks.log_grey[j][both]),
                share=float(both.sum() / max(blocks.wanted, 1)),
            )
        )
    return agreements


def _correlation(a: np.ndarray, b: np.ndarray) -> float:
    """Pearson's correlation; NaN for fewer than three values or constant values."""
    if len(a) < 3 or not (np.ptp(a) > 0 and np.ptp(b) > 0):
        return float("nan")
    return float(np.corrcoef(a, b)[0, 1])
