"""Turn the heads of frontal photographs.

The depth of a face is that of a generated head, placed on the photograph by common landmarks. The person is drawn as a
surface with that depth, the nearest part in front, over the background of the photograph.
"""

from collections.abc import Callable, Sequence
from functools import lru_cache

import cv2
import numpy as np
from scipy.interpolate import RBFInterpolator
from scipy.ndimage import distance_transform_edt, map_coordinates

from liaam.model.shape import diagonal_of
from scenes import Expression, Head, Pose
from scenes.body import build_body
from scenes.raster import draw
from scenes.surface import face_of, landmark_points

SIDE, REACH = 256, 1.3
"""Resolution of a depth map, and its extent from the centre, in head units (0.62 between the eyes)."""

STEP, COARSE = 2, 8
"""Distance between vertices of the surface, and between points at which the map to the head is computed, pixels."""

FINER = 2
"""Samples per pixel and axis of a turned photograph."""

AROUND = 0.3
"""Margin of a turned photograph around the landmarks, as a fraction of their diagonal."""

SMOOTH = 1e-4
"""Smoothing of the map from photograph to head."""

TOLERANCE = 20
"""Largest difference of a studio's background from its colour in the corners, grey values."""

COMMON = {
    "right_eye_outer": 21,
    "right_eye_inner": 25,
    "left_eye_inner": 17,
    "left_eye_outer": 13,
    "mouth_right": 39,
    "upper_lip_top": 41,
    "mouth_left": 43,
    "lower_lip_bottom": 45,
    "nose_base": 52,
    "chin": 6,
}
"""Landmarks of a face by name, and their numbers on a generated head. The jaw of the latter is 0 to 12."""

STRIP = 0.04
"""Half the width of the strips in which the contour is looked for, in head units."""


class Portrait:
    """A frontal photograph with the depth of a generated head.

    Parameters
    ----------
    image : (h, w, 3) uint8
        A face before the background of a studio.
    points, names : (n, 2) float64, and sequence of str
        Its landmarks.
    jaw : sequence of int
        Landmarks from ear to ear by the chin.
    seed : int
        Which head.
    """

    def __init__(self, image: np.ndarray, points: np.ndarray, names: Sequence[str], jaw: Sequence[int], seed: int):
        self.image, self.points, self.jaw = image, points, list(jaw)
        own = {name: points[names.index(name)] for name in COMMON}
        known, depth = generated(seed)
        eyes = np.array([own[name] for name in list(COMMON)[:4]])
        self.centre = eyes.mean(axis=0)
        apart = [np.linalg.norm(e[:2].mean(axis=0) - e[2:].mean(axis=0)) for e in (eyes, known[[21, 25, 17, 13]])]
        self.unit = float(apart[0] / apart[1])
        to_head = _map_to(known, own, points[self.jaw], self.centre, self.unit)
        height, width = image.shape[:2]
        rows, columns = np.arange(0, height, STEP), np.arange(0, width, STEP)
        self.vertices = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2).astype(np.float64)
        self.depths = self.unit * _look_up(depth, _coarsely(to_head, self.vertices, (height, width)))
        self.depths_of_points = self.unit * _look_up(depth, to_head(points))
        behind = background(image)
        self.triangles = _triangles(~behind[np.ix_(rows, columns)])
        colour = image[behind].mean(axis=0) if behind.any() else image[0].mean(axis=0)
        self.wall = np.where(behind[..., None], image, np.rint(colour).astype(image.dtype))
        hull = np.zeros((height, width), np.uint8)
        cv2.fillConvexPoly(hull, cv2.convexHull(np.rint(points).astype(np.int32)), 1)
        self.in_face = hull[np.ix_(rows, columns)].ravel() > 0

    def turned(self, yaw: float, pitch: float) -> tuple[np.ndarray, np.ndarray]:
        """Return the face, cropped, and its landmarks, turned to the right of the image and upwards by radians."""
        moved = self._moved(self.vertices, self.depths, yaw, pitch)
        points = self._landmarks(yaw, pitch, moved[self.in_face, :2])
        around, size = AROUND * diagonal_of(points), np.array(self.image.shape[1::-1])
        low = np.clip(points.min(axis=0) - around, 0, size - 1).astype(int)
        width, height = (np.clip(points.max(axis=0) + around, 0, size - 1).astype(int) + 1 - low).tolist()
        screen = (moved - [*low, 0.0]) * [FINER, FINER, 1.0] + [(FINER - 1) / 2, (FINER - 1) / 2, 0.0]
        where, covered = draw(screen, self.triangles, self.vertices, FINER * height, FINER * width)
        x, y = (np.ascontiguousarray(each, np.float32) for each in np.moveaxis(where, -1, 0))
        wall = self.wall[low[1] : low[1] + height, low[0] : low[0] + width]
        wall = cv2.resize(wall, (FINER * width, FINER * height))
        seen = np.where(covered[..., None], cv2.remap(self.image, x, y, cv2.INTER_LINEAR), wall)
        return cv2.resize(seen, (width, height), interpolation=cv2.INTER_AREA), points - low

    def _moved(self, at: np.ndarray, z: np.ndarray, yaw: float, pitch: float) -> np.ndarray:
        """Rotate positions (n, 2) with depths (n,); return (n, 3)."""
        x, y = (at - self.centre).T
        x, z = np.cos(yaw) * x + np.sin(yaw) * z, np.cos(yaw) * z - np.sin(yaw) * x
        y, z = np.cos(pitch) * y - np.sin(pitch) * z, np.cos(pitch) * z + np.sin(pitch) * y
        return np.column_stack([x + self.centre[0], y + self.centre[1], z])

    def _landmarks(self, yaw: float, pitch: float, face: np.ndarray) -> np.ndarray:
        """Rotate the landmarks; those of the jaw that the face hides move out to its contour."""
        points = self._moved(self.points, self.depths_of_points, yaw, pitch)[:, :2]
        line = self.points[self.jaw]
        along = np.gradient(line, axis=0)
        outward = np.column_stack([-along[:, 1], along[:, 0]]) / np.linalg.norm(along, axis=1, keepdims=True)
        outward *= np.sign(((line - self.points.mean(axis=0)) * outward).sum(axis=1, keepdims=True))
        for i, normal in zip(self.jaw, outward, strict=True):
            apart = face - points[i]
            near = np.abs(apart @ [-normal[1], normal[0]]) < STRIP * self.unit
            points[i] += float((apart[near] @ normal).max(initial=0.0)) * normal
        return points


@lru_cache
def generated(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return landmarks (58, 2) and depth map (SIDE, SIDE) of a generated head, in head units; y points down."""
    face = face_of(Head(seed, hair="short"))
    points = landmark_points(face, Expression())[:, :2] * [1.0, -1.0]
    body = build_body(face, Pose(), Expression())
    at = body.points * [1.0, -1.0, 1.0]
    screen = np.column_stack([(at[:, :2] + REACH) * (SIDE / (2 * REACH)) - 0.5, at[:, 2]])
    depth, covered = draw(screen, body.triangles, at[:, 2:], SIDE, SIDE)
    nearest = distance_transform_edt(~covered, return_distances=False, return_indices=True)
    return points, depth[..., 0][tuple(np.array(nearest))]


def background(image: np.ndarray) -> np.ndarray:
    """Return the mask (h, w) of a studio's background: what is connected to the sides and has their colour."""
    smooth = cv2.GaussianBlur(image, (0, 0), 1.5)
    height, width = image.shape[:2]
    mask, limits = np.zeros((height + 2, width + 2), np.uint8), (TOLERANCE,) * 3
    flags = 4 | (1 << 8) | cv2.FLOODFILL_MASK_ONLY | cv2.FLOODFILL_FIXED_RANGE
    for row in (0, height // 3):
        for column in (0, width - 1):
            cv2.floodFill(smooth, mask, (column, row), (0, 0, 0), limits, limits, flags)
    return mask[1:-1, 1:-1] > 0


def _map_to(
    known: np.ndarray, own: dict[str, np.ndarray], jaw: np.ndarray, centre: np.ndarray, unit: float
) -> Callable[[np.ndarray], np.ndarray]:
    """Return the map of a photograph's positions (n, 2) to a head; jaws correspond at the same heights."""
    axis = (own["chin"] - centre) / np.linalg.norm(own["chin"] - centre) ** 2
    eyes, chin = known[[21, 25, 17, 13], 1].mean(), known[COMMON["chin"], 1]
    heights, middle = (known[:13, 1] - eyes) / (chin - eyes), int(np.argmax((jaw - centre) @ axis))
    right, left = jaw[: middle + 1], jaw[middle:][::-1]
    both = [_at_height(right, centre, axis, h) for h in heights[:6]]
    both += [_at_height(left, centre, axis, h) for h in heights[7:]]
    here = np.array([*own.values(), *both])
    there = known[[*COMMON.values(), *range(6), *range(7, 13)]]
    spline = RBFInterpolator((here - centre) / unit, there, smoothing=SMOOTH, kernel="thin_plate_spline")
    return lambda at: spline((at - centre) / unit)


def _at_height(line: np.ndarray, centre: np.ndarray, axis: np.ndarray, height: float) -> np.ndarray:
    """Return the point of a line (n, 2) at a height along an axis."""
    heights = (line - centre) @ axis
    order = np.argsort(heights)
    return np.array([np.interp(height, heights[order], line[order, i]) for i in (0, 1)])


def _coarsely(function: Callable[[np.ndarray], np.ndarray], at: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Evaluate a smooth map at positions (n, 2) within a size by interpolation between coarse ones."""
    rows, columns = (np.arange(0, n + COARSE, COARSE) for n in size)
    grid = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2).astype(np.float64)
    known = function(grid).reshape(len(rows), len(columns), 2)
    x, y = at.T / COARSE
    return np.column_stack([map_coordinates(known[..., i], [y, x], order=1) for i in (0, 1)])


def _look_up(depth: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Return the depth at positions (n, 2) in head units."""
    x, y = ((at + REACH) * (SIDE / (2 * REACH)) - 0.5).T
    return map_coordinates(depth, [y, x], order=1, mode="nearest")


def _triangles(solid: np.ndarray) -> np.ndarray:
    """Return the triangles (m, 3) of a grid of vertices, without those at the background."""
    number = np.arange(solid.size).reshape(solid.shape)
    a, b, c, d = number[:-1, :-1], number[:-1, 1:], number[1:, :-1], number[1:, 1:]
    whole = solid[:-1, :-1] & solid[:-1, 1:] & solid[1:, :-1] & solid[1:, 1:]
    a, b, c, d = (each[whole] for each in (a, b, c, d))
    return np.concatenate([np.stack([a, b, c], 1), np.stack([b, d, c], 1)])
