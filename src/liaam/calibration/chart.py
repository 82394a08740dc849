"""Estimate the angle from images of a colour chart, and locate its patches."""

from collections.abc import Sequence

import cv2
import numpy as np

from liaam.calibration.estimate import AngleEstimate
from liaam.calibration.scatter import as_pictures, observe, theta_of_least_scatter
from liaam.errors import CameraError
from liaam.photometry.camera import CameraModel


def theta_from_chart(
    images: Sequence[np.ndarray],
    patches: Sequence[np.ndarray],
    camera: CameraModel | None = None,
    *,
    free_balance: bool = False,
) -> AngleEstimate:
    """Estimate the angle from images of a chart (or of any flat patches of colour) under several lights.

    Parameters
    ----------
    images : sequence of (h, w, 3) uint8, uint16 or float arrays
        Two or more images; they need not be registered.
    patches : sequence of (n, 4) or (n, 4, 2) float arrays, one for each image
        The same patches in each image: boxes x0, y0, x1, y1, or four corners in order around each patch, pixels (see
        :func:`chart_patches`).
    camera, free_balance
        As for :func:`theta_from_scene`.

    Returns
    -------
    AngleEstimate

    Raises
    ------
    CameraError
        If a patch lies outside its image, the numbers of patches differ, or too few are well exposed in two images.
    """
    pictures = as_pictures(images)
    camera = camera or CameraModel()
    if len(patches) != len(pictures) or len({len(p) for p in patches}) != 1:
        raise CameraError(f"{len(pictures)} images need as many lists of patches, with the same patches in each")
    regions = [
        patch_labels(quads, picture.shape[:2], f"image {i + 1}")
        for i, (picture, quads) in enumerate(zip(pictures, patches, strict=True))
    ]
    return theta_of_least_scatter(observe(pictures, regions, len(patches[0]), camera), free_balance=free_balance)


def chart_patches(corners: np.ndarray, rows: int = 4, columns: int = 6, share: float = 0.5) -> np.ndarray:
    """Compute the patches of a chart from the centres of its four corner patches.

    Parameters
    ----------
    corners : (4, 2) float
        Centres of the first patch of the first row, the last of the first row, the last of the last row and the
        first of the last row (x, y), pixels: clockwise for an upright chart.
    rows, columns : int
        Numbers of rows and columns of patches.
    share : float
        Side of the used part of a patch, as a fraction of the distance between patches.

    Returns
    -------
    (rows * columns, 4, 2) float64
        Corners around each patch, row by row.
    """
    corners = np.asarray(corners, dtype=np.float32)
    if corners.shape != (4, 2) or not np.isfinite(corners).all() or rows < 2 or columns < 2:
        raise CameraError("a chart needs the centres of its four corner patches: eight numbers x0,y0,...,x3,y3")
    if not cv2.isContourConvex(corners.reshape(-1, 1, 2)):
        raise CameraError("the corner patches of the chart are not in order: give them around the chart from the first")
    ends = np.array([[0, 0], [columns - 1, 0], [columns - 1, rows - 1], [0, rows - 1]], dtype=np.float32)
    homography = cv2.getPerspectiveTransform(ends, corners)
    middle = np.array([(c, r) for r in range(rows) for c in range(columns)], dtype=np.float64)
    half = 0.5 * share * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    quads = (middle[:, None] + half).reshape(-1, 1, 2)
    return cv2.perspectiveTransform(quads, homography).reshape(-1, 4, 2)


def patch_corners(patches: np.ndarray) -> np.ndarray:
    """Corner pixels of patches, (n, 4, 2) float64; converts boxes (n, 4), whose x1 and y1 are excluded."""
    patches = np.asarray(patches, dtype=np.float64)
    if patches.ndim != 2 or patches.shape[1] != 4:
        return patches
    x0, y0, x1, y1 = patches.T
    return np.stack([np.stack(c, -1) for c in ((x0, y0), (x1 - 1, y0), (x1 - 1, y1 - 1), (x0, y1 - 1))], axis=1)


def patch_labels(patches: np.ndarray, size: tuple[int, int], name: str = "image") -> np.ndarray:
    """Label each pixel of an image with the index of its patch, -1 outside patches, (h, w) int32.

    Raises CameraError if a patch lies outside the image or has fewer than 4 pixels.
    """
    patches = patch_corners(patches)
    if patches.ndim != 3 or patches.shape[1:] != (4, 2) or not np.isfinite(patches).all():
        raise CameraError(f"{name}: patches are boxes x0,y0,x1,y1 or four corners each, not {patches.shape}")
    labels = np.full(size, -1, dtype=np.int32)
    for i, quad in enumerate(patches):
        if quad.min() < 0 or (quad > np.array(size[::-1]) - 1).any():
            raise CameraError(f"{name}: patch {i + 1} lies partly outside the image of {size[1]}×{size[0]} pixels")
        cv2.fillConvexPoly(labels, np.rint(quad).astype(np.int32), i)
    counts = np.bincount(labels[labels >= 0], minlength=len(patches))
    if counts.min() < 4:
        raise CameraError(f"{name}: patch {counts.argmin() + 1} has {counts.min()} pixels; 4 or more are needed")
    return labels
