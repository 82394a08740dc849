"""Align images of one scene with the first."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from liaam.errors import CameraError
from liaam.evaluation import rms_error
from liaam.model.warp import apply_homography, picture_corners
from liaam.photometry import CameraModel
from liaam.progress import Progress
from liaam.registration import Registration, register

STILL = 0.25
"""Movement of the corners, pixels, up to which an image counts as aligned and is not resampled."""


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
    """

    pictures: tuple[np.ndarray, ...]
    masks: tuple[np.ndarray, ...]
    moved: tuple[float, ...]


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
    first, camera = pictures[0], camera or CameraModel()
    corners = picture_corners(*first.shape[:2])
    aligned, masks, moved = [first], [np.ones(first.shape[:2], dtype=bool)], [0.0]
    for picture, found in zip(pictures[1:], _register_all(pictures, camera, names, progress), strict=True):
        moved.append(rms_error(apply_homography(found.homography, corners), corners))
        if moved[-1] <= STILL and picture.shape == first.shape:
            sampled, mask = picture, masks[0]
        else:
            sampled, mask = found.warp(picture)
        aligned.append(sampled)
        masks.append(mask)
    return Aligned(tuple(aligned), tuple(masks), tuple(moved))


def homographies_between(
    pictures: Sequence[np.ndarray],
    camera: CameraModel | None = None,
    *,
    names: Sequence[str] | None = None,
    progress: Progress | None = None,
) -> list[np.ndarray]:
    """Estimate homographies from the pixels of each image to those of the first, (3, 3) float64 each.

    Parameters and errors are those of :func:`align_pictures`.
    """
    found = _register_all(pictures, camera or CameraModel(), names, progress)
    return [np.eye(3), *(np.linalg.inv(one.homography) for one in found)]


def _register_all(
    pictures: Sequence[np.ndarray], camera: CameraModel, names: Sequence[str] | None, progress: Progress | None
) -> list[Registration]:
    """Register the first image with each of the others."""
    names, found = names or [f"image {i + 1}" for i in range(len(pictures))], []
    for i, (picture, name) in enumerate(zip(pictures[1:], names[1:], strict=True)):
        if progress:
            progress(i, len(pictures) - 1, name)
        found.append(register(pictures[0], picture, response=camera.response, theta=camera.theta))
        if not found[-1].status.ok:
            raise CameraError(
                f"{name} could not be aligned with {names[0]} ({found[-1].message}); take the images from a tripod "
                "and skip the alignment, or choose images that differ less"
            )
    return found
