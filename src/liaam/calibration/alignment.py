"""Align images of one scene with the first."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from liaam.error_measures import rms_error
from liaam.errors import CameraError
from liaam.model.warp import apply_homography, picture_corners
from liaam.photometry import CameraModel
from liaam.progress import Progress
from liaam.registration import register

STILL = 0.25  # Movement of the corners, pixels, up to which an image counts as aligned and is not resampled


@dataclass(frozen=True, eq=False)
class Aligned:
    """Images warped to the pixels of the first.

    Attributes
    ----------
    pictures : tuple of (h, w, 3) arrays
    masks : tuple of (h, w) bool
        Valid pixels of each image.
    moved : tuple of float
        Root mean square movement of each image's corners, pixels.
    homographies : tuple of (3, 3) float64
        Maps from the pixels of each image to those of the first.
    """

    pictures: tuple[np.ndarray, ...]
    masks: tuple[np.ndarray, ...]
    moved: tuple[float, ...]
    homographies: tuple[np.ndarray, ...]


def align_pictures(
    pictures: Sequence[np.ndarray],
    camera: CameraModel | None = None,
    *,
    names: Sequence[str] | None = None,
    progress: Progress | None = None,
) -> Aligned:
    """Align images of one scene under different lights with the first.

    Parameters
    ----------
    pictures : sequence of (h, w, 3) uint8, uint16 or float arrays
    camera : CameraModel, optional
        Camera with response and angle.
    names : sequence of str, optional
        Names of the images in error messages.
    progress : callable, optional
        Called with (done, total, name) before each image.

    Returns
    -------
    Aligned

    Raises
    ------
    CameraError
        If an image cannot be aligned; the message names it.
    """
    first = pictures[0]
    camera = camera or CameraModel()
    names = names or [f"image {i + 1}" for i in range(len(pictures))]
    corners = picture_corners(*first.shape[:2])
    aligned = [first]
    masks = [np.ones(first.shape[:2], dtype=bool)]
    moved = [0.0]
    maps = [np.eye(3)]
    for i, (picture, name) in enumerate(zip(pictures[1:], names[1:], strict=True)):
        if progress:
            progress(i, len(pictures) - 1, name)
        registration = register(first, picture, response=camera.response, theta=camera.theta)
        if not registration.status.ok:
            raise CameraError(
                f"{name} could not be aligned with {names[0]} ({registration.message}); take the images from a tripod "
                "and skip the alignment, or choose images that differ less"
            )
        moved.append(rms_error(apply_homography(registration.homography, corners), corners))
        is_still = moved[-1] <= STILL and picture.shape == first.shape
        sampled, mask = (picture, masks[0]) if is_still else registration.warp(picture)
        aligned.append(sampled)
        masks.append(mask)
        maps.append(np.linalg.inv(registration.homography))
    return Aligned(tuple(aligned), tuple(masks), tuple(moved), tuple(maps))
