"""How well the invariant images of registered pictures agree."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from liaam.calibration.scatter import block_labels, observe
from liaam.errors import ImageError
from liaam.photometry.camera import CameraModel
from liaam.photometry.encoding import DARK, as_colour, refuse_grey
from liaam.photometry.invariant import LUMINANCE, invariant


@dataclass(frozen=True)
class Agreement:
    """How well two pictures of one scene under different lights agree.

    Attributes
    ----------
    first, second : int
        Numbers of the pictures, from 0.
    invariant, log_grey : float
        Correlation of their invariant images, and of the logarithms of their luminance; NaN where nothing is left.
    share : float
        Share of the pixels asked for that are well exposed in both.
    """

    first: int
    second: int
    invariant: float
    log_grey: float
    share: float


@dataclass(frozen=True, eq=False)
class Averaged:
    """What registered pictures look like in blocks: the mean linear light of each, projected.

    Attributes
    ----------
    invariant : (m, h, w) float64
        Invariant values of m pictures, NaN where a block is dark, saturated or masked.
    log_grey : (m, h, w) float64
        Logarithm of luminance, NaN at the same places.
    wanted : int
        Blocks that were asked for: all, or those of the mask.
    """

    invariant: np.ndarray
    log_grey: np.ndarray
    wanted: int


def averaged(
    images: Sequence[np.ndarray],
    camera: CameraModel | None = None,
    *,
    block: int = 1,
    dark: float = DARK,
    mask: np.ndarray | None = None,
    names: Sequence[str] | None = None,
) -> Averaged:
    """Average registered pictures over blocks of linear light, and project.

    Parameters
    ----------
    images : sequence of (h, w, 3) uint8, uint16 or float arrays
        Pictures of one size in which a pixel shows the same surface.
    camera : CameraModel, optional
    block : int
        Pixels across a block, against noise and rounding; 1 for the pixels themselves.
    dark : float
        Stored value, in [0, 1], below which a block says nothing, in any channel.
    mask : (h, w) bool, optional
        Pixels that count.
    names : sequence of str, optional
        What to call the pictures in errors.

    Returns
    -------
    Averaged

    Raises
    ------
    ImageError
        If the pictures are fewer than two, differ in size, or are grey.
    CameraError
        If the blocks are wider than a third of the pictures.
    """
    camera = camera or CameraModel()
    names = names or [f"picture {i + 1}" for i in range(len(images))]
    pictures = [as_colour(image, name) for image, name in zip(images, names, strict=True)]
    if len(pictures) < 2 or len({picture.shape for picture in pictures}) > 1:
        raise ImageError("to compare invariant images, give two or more registered pictures of one size")
    for picture, name in zip(pictures, names, strict=True):
        refuse_grey(picture, name, "an invariant image needs colour")
    height, width = pictures[0].shape[:2]
    labels, (down, across) = block_labels(height, width, block)
    if mask is not None:
        if mask.shape != (height, width):
            raise ImageError(f"the mask is {mask.shape[1]}×{mask.shape[0]} pixels, the pictures {width}×{height}")
        labels = np.where(mask, labels, -1)
    m = len(pictures)
    surfaces = observe(pictures, [labels] * m, down * across, camera, [0.0] * m, full=block * block, dark=dark)

    def maps(values: np.ndarray) -> np.ndarray:
        return np.where(surfaces.seen, values, np.nan).T.reshape(m, down, across)

    log_grey = np.log(np.exp(surfaces.log_rgb) @ LUMINANCE[0])
    wanted = len(np.unique(labels[labels >= 0]))
    return Averaged(maps(invariant(surfaces.log_rgb, camera.theta)), maps(log_grey), wanted)


def agreement(seen: Averaged) -> list[Agreement]:
    """Correlate the invariant images of registered pictures, each with each, and their log-grey beside it.

    Parameters
    ----------
    seen : Averaged
        Of :func:`averaged`.

    Returns
    -------
    list of Agreement
        One for each pair.
    """
    found = []
    for i, j in combinations(range(len(seen.invariant)), 2):
        both = np.isfinite(seen.invariant[i]) & np.isfinite(seen.invariant[j])
        found.append(
            Agreement(
                i,
                j,
                _correlation(seen.invariant[i][both], seen.invariant[j][both]),
                _correlation(seen.log_grey[i][both], seen.log_grey[j][both]),
                float(both.sum() / max(seen.wanted, 1)),
            )
        )
    return found


def _correlation(a: np.ndarray, b: np.ndarray) -> float:
    """Pearson's correlation, NaN where there are fewer than three values or no variation."""
    if len(a) < 3 or not (np.ptp(a) > 0 and np.ptp(b) > 0):
        return float("nan")
    return float(np.corrcoef(a, b)[0, 1])
