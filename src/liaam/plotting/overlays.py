"""Overlays of landmarks, meshes, ellipses and label faults on images."""

from collections.abc import Sequence

import cv2
import numpy as np

from liaam.datasets.label_faults import LabelFault
from liaam.drawing import as_picture, ellipses
from liaam.model import AAM

GREEN = (64, 255, 140)  # Colour of landmarks
YELLOW = (255, 220, 64)  # Colour of their ellipses and expected positions
RED = (255, 40, 40)  # Colour of faulty and absent landmarks

LARGE = 700  # Larger side of an image from which it is not enlarged, pixels
# OpenCV draws between pixel centres with fixed-point numbers, of so many bits after the point.
FRACTION_BITS = 4
ONE = 2**FRACTION_BITS  # A pixel in these numbers
FARTHEST = 1e6  # Largest coordinate in pixels that is drawn, so that these numbers do not overflow


def enlarged(image: np.ndarray) -> tuple[np.ndarray, int]:
    """Return a copy of an image to draw on, (h', w', 3) uint8, enlarged if small, and the zoom factor."""
    picture = as_picture(image)
    zoom = max(1, round(LARGE / max(picture.shape[:2])))
    if zoom == 1:
        return picture.copy(), 1
    return cv2.resize(picture, None, fx=zoom, fy=zoom, interpolation=cv2.INTER_CUBIC), zoom


def overlay(
    image: np.ndarray,
    shape: np.ndarray,
    model: AAM,
    covariances: np.ndarray | None = None,
    absent: np.ndarray | None = None,
) -> np.ndarray:
    """Draw a fitted shape on its image.

    Parameters
    ----------
    image : (h, w, 3) array
    shape : (n, 2) float
        Landmarks in image pixels.
    model : AAM
        Model with the mesh (drawn transparent) and the contours (drawn opaque).
    covariances : (n, 2, 2) float, optional
        Covariances of the landmarks in square pixels, drawn as 95 % confidence ellipses.
    absent : (n,) bool, optional
        Landmarks that are not there, drawn as red rings.

    Returns
    -------
    (h', w', 3) uint8
        The image, enlarged if small so that the lines do not cover it.
    """
    picture, zoom = enlarged(image)
    size = float(np.ptp(shape, axis=0).max()) * zoom if np.isfinite(shape).all() else 100.0
    size = float(np.clip(size, 1.0, 4 * max(picture.shape[:2])))  # a failed fit may have any size
    thick = max(1, round(size / 300))
    points = np.clip(np.nan_to_num((shape + 0.5) * zoom - 0.5), -FARTHEST, FARTHEST)
    fixed = np.rint(points * ONE).astype(np.int32)
    with_mesh = picture.copy()
    edges = np.unique(np.sort(model.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0)
    _draw_lines(with_mesh, fixed[edges], False, GREEN, thick)
    opacity = 0.35 if model.contours else 0.6
    picture = cv2.addWeighted(with_mesh, opacity, picture, 1 - opacity, 0)
    for indices, closed in model.contours:
        _draw_lines(picture, fixed[list(indices)][None], closed, GREEN, thick)
    if covariances is not None:
        rings = ellipses(points, zoom**2 * np.asarray(covariances))
        rings = np.clip(np.rint(rings * ONE), -(2**30), 2**30).astype(np.int32)
        _draw_lines(picture, rings, True, YELLOW, thick)
    radius = int(ONE * max(1.2, size / 180))
    is_absent = np.zeros(len(shape), bool) if absent is None else absent
    for (x, y), ringed in zip(fixed.tolist(), is_absent.tolist(), strict=True):
        if ringed:
            cv2.circle(picture, (x, y), 2 * radius, RED, thick, cv2.LINE_AA, FRACTION_BITS)
            continue
        cv2.circle(picture, (x, y), radius, (0, 0, 0), -1, cv2.LINE_AA, FRACTION_BITS)
        cv2.circle(picture, (x, y), int(radius * 0.7), GREEN, -1, cv2.LINE_AA, FRACTION_BITS)
    return picture


def _draw_lines(
    picture: np.ndarray, lines: np.ndarray, closed: bool, colour: tuple[int, int, int], thickness: int
) -> None:
    """Draw lines through points (m, k, 2) int32, pixels times :data:`ONE`, on a picture."""
    cv2.polylines(picture, list(lines[:, :, None]), closed, colour, thickness, cv2.LINE_AA, FRACTION_BITS)


def overlay_of_faults(image: np.ndarray, points: np.ndarray, faults: Sequence[LabelFault]) -> np.ndarray:
    """Draw landmarks on their image, faulty ones in red and numbered, with lines to their expected positions.

    Parameters
    ----------
    image : (h, w, 3) array
    points : (n, 2) float
        Landmarks in image pixels.
    faults : sequence of LabelFault
        Faults of this image.

    Returns
    -------
    (h', w', 3) uint8
        The surroundings of the landmarks, enlarged.
    """
    margin = 0.15 * np.ptp(points, axis=0).max() + 5
    size_of_image = np.array(image.shape[1::-1])
    low = np.clip(np.floor(points.min(axis=0) - margin), 0, size_of_image).astype(int)
    high = np.clip(np.ceil(points.max(axis=0) + margin), 0, size_of_image).astype(int)
    if (high - low < 8).any():  # the landmarks are outside the image
        low = np.zeros(2, int)
        high = size_of_image
    picture, zoom = enlarged(image[low[1] : high[1], low[0] : high[0]])

    def at(point: np.ndarray) -> tuple[int, int]:
        """Return the pixel of the picture at a point (2,) of the image."""
        x, y = np.clip(np.rint((point - low + 0.5) * zoom - 0.5), -FARTHEST, FARTHEST)
        return int(x), int(y)

    size = max(picture.shape[:2]) / LARGE
    thick = max(1, round(size))
    radius = max(2, round(3 * size))
    for point in points:
        cv2.circle(picture, at(point), radius, GREEN, -1, cv2.LINE_AA)
    for fault in faults:
        for i in fault.points:
            cv2.line(picture, at(points[i]), at(fault.expected[i]), YELLOW, thick, cv2.LINE_AA)
            cv2.circle(picture, at(points[i]), radius, RED, -1, cv2.LINE_AA)
        for i in fault.points:
            x, y = at(points[i])
            place = (x + 2 * radius, y - radius)
            cv2.putText(picture, str(i + 1), place, cv2.FONT_HERSHEY_SIMPLEX, 0.45 * size, (255, 255, 255), thick)
    return picture
