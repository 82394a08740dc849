"""The order in which the objects of an image are read, and which of them touch."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import cv2
import numpy as np

IN_ROW = 0.5
"""Greatest vertical distance of neighbours in a row, of the height of the lower one.

Rows of objects of one size that do not overlap are a whole height apart."""

OF_SIZE = 0.7
"""Greatest difference of the logarithms of the sizes of an uncertain object and of the certain ones: a factor of 2."""

IN_STEP = 0.25
"""Greatest distance of an uncertain object in a row from where one should be, of the step from one to the next."""

NEAR = 0.03
"""Gap below which two objects touch, of the smaller one's diagonal: they end a little beyond their landmarks."""


def reading_order(shapes: Sequence[np.ndarray]) -> list[int]:
    """Return the order of objects in an image as text is read: by rows from the top, in each from the left.

    A row goes on with the nearest object to the right whose middle is at about the same height, so that a tray may be
    turned a little.

    Parameters
    ----------
    shapes : sequence of (n, 2) arrays
        Points of each object, pixels, y downwards. Objects without a finite point come last.

    Returns
    -------
    list of int
        Indices of the shapes.
    """
    boxes = [_box(shape) for shape in shapes]
    known = [i for i, box in enumerate(boxes) if box is not None]
    middles = np.array([(box[0] + box[1]) / 2 for box in boxes if box is not None]).reshape(-1, 2)
    heights = np.array([box[1, 1] - box[0, 1] for box in boxes if box is not None])
    rows = [sorted(row, key=lambda i: middles[i, 0]) for row in _rows(middles, heights)]
    rows.sort(key=lambda row: float(middles[row, 1].mean()))
    without_place = [i for i, box in enumerate(boxes) if box is None]
    return [known[i] for row in rows for i in row] + without_place


def unplaced(shapes: Sequence[np.ndarray], certain: Sequence[bool]) -> list[int]:
    """Return which uncertain objects of a tray are at no place of its rows and columns, as those on a label are.

    An uncertain object has a place if it is in a row and in a column of certain ones, at about their size; or, of
    certain ones in a single row, if it is in that row at a whole number of their steps from them. Of a single certain
    object, nothing is known.

    Parameters
    ----------
    shapes : sequence of (n, 2) arrays
        Points of each object, pixels.
    certain : sequence of bool
        Whether each is an object for certain.

    Returns
    -------
    list of int
        Their indices, in reading order.
    """
    boxes = [_box(shape) for shape in shapes]
    grid = np.array([box for box, is_certain in zip(boxes, certain, strict=True) if is_certain and box is not None])
    if len(grid) < 2:
        return []
    return [i for i in reading_order(shapes) if not certain[i] and not _is_in_grid(boxes[i], grid)]


def _is_in_grid(box: np.ndarray | None, grid: np.ndarray) -> bool:
    """Whether a box (2, 2) is of the size of those of a grid (n, 2, 2), and in a row and in a column of them."""
    if box is None:
        return False
    usual_size = np.median(grid[:, 1] - grid[:, 0], axis=0)  # width and height
    size = box[1] - box[0]
    if np.abs(np.log(np.maximum(size, 1e-9) / np.maximum(usual_size, 1e-9))).max() > OF_SIZE:
        return False
    middles = grid.mean(axis=1)
    middle = box.mean(axis=0)
    is_in_column, is_in_row = (np.abs(middles - middle) < IN_ROW * usual_size).T  # of each box of the grid
    if not is_in_row.any():
        return False
    is_single_row = (np.abs(middles[:, 1] - middles[0, 1]) < IN_ROW * usual_size[1]).all()
    if is_single_row:
        return _is_in_step(float(middle[0]), middles[:, 0], float(usual_size[0]))
    return bool(is_in_column.any())


def _is_in_step(x: float, row: np.ndarray, width: float) -> bool:
    """Whether x is a whole number of steps away from the nearest of the places (n,) of a row, which tell its step.

    Two places do not tell it: there may be gaps between them. Objects of a width that lie on each other are at one.
    """
    steps = np.diff(np.sort(row))
    steps = steps[steps > IN_ROW * width]
    if len(steps) < 2:
        return False
    n_steps = np.abs(row - x).min() / steps.min()
    return bool(abs(n_steps - round(n_steps)) < IN_STEP)


def _box(points: np.ndarray) -> np.ndarray | None:
    """Return the least and greatest x and y (2, 2) of the finite points of an object, None if it has none."""
    finite = np.asarray(points, np.float64).reshape(-1, 2)
    finite = finite[np.isfinite(finite).all(axis=1)]
    return np.array([finite.min(axis=0), finite.max(axis=0)]) if len(finite) else None


def _rows(middles: np.ndarray, heights: np.ndarray) -> list[list[int]]:
    """Return the objects of each row, given their middles (n, 2) and heights (n,)."""
    row_of = list(range(len(middles)))
    for i in range(len(middles)):
        right = _next_in_row(i, middles, heights)
        if right is not None:
            joined = row_of[right]
            row_of = [row_of[i] if row == joined else row for row in row_of]
    return [[i for i, row in enumerate(row_of) if row == each] for each in dict.fromkeys(row_of)]


def _next_in_row(i: int, middles: np.ndarray, heights: np.ndarray) -> int | None:
    """Return the nearest object to the right of one, at about its height; None if there is none."""
    across, down = (middles - middles[i]).T
    height = np.minimum(heights, heights[i])  # a fit that went astray may be of any height
    is_beside = (across > 0) & (np.abs(down) < np.minimum(IN_ROW * height, across))
    if not is_beside.any():
        return None
    return int(np.where(is_beside, across, np.inf).argmin())


def touching(shapes: Sequence[np.ndarray]) -> list[tuple[int, int]]:
    """Return the pairs of objects whose convex hulls overlap or nearly touch: a fit may have points on the other.

    Parameters
    ----------
    shapes : sequence of (n, 2) arrays
        Points of each object, pixels. Those that are not finite are left out.

    Returns
    -------
    list of (int, int)
        Indices of the shapes.
    """
    hulls = [hull_of(shape) for shape in shapes]
    return [
        (i, j)
        for (i, first), (j, second) in combinations(enumerate(hulls), 2)
        if len(first) and len(second) and gap(first, second) <= NEAR * min(diagonal(first), diagonal(second))
    ]


def is_inside(points: np.ndarray, area: np.ndarray) -> bool:
    """Whether more than half of the convex hull of points (n, 2) lies in a convex area with corners (m, 2)."""
    hull = hull_of(points).astype(np.float32).reshape(-1, 1, 2)
    outline = hull_of(area).astype(np.float32).reshape(-1, 1, 2)
    if min(len(hull), len(outline)) < 3:
        return False
    shared, _ = cv2.intersectConvexConvex(hull, outline)
    return shared > 0.5 * cv2.contourArea(hull)


def hull_of(points: np.ndarray) -> np.ndarray:
    """Return the convex hull (m, 2) of the finite points of an object."""
    finite = np.asarray(points, np.float64).reshape(-1, 2)
    finite = finite[np.isfinite(finite).all(axis=1)].astype(np.float32)
    return cv2.convexHull(finite).reshape(-1, 2).astype(np.float64) if len(finite) else np.empty((0, 2))


def diagonal(points: np.ndarray) -> float:
    """Return the diagonal of the box around points (n, 2)."""
    return float(np.hypot(*np.ptp(points, axis=0)))


def gap(hull: np.ndarray, other: np.ndarray) -> float:
    """Return the distance of two convex polygons (n, 2), 0 if they overlap."""
    outlines = [polygon.astype(np.float32).reshape(-1, 1, 2) for polygon in (hull, other)]
    distances = [
        -cv2.pointPolygonTest(outline, (float(x), float(y)), measureDist=True)
        for outline, points in zip(outlines, (other, hull), strict=True)
        for x, y in points
    ]
    are_areas = min(len(hull), len(other)) > 2
    overlap = cv2.intersectConvexConvex(outlines[0], outlines[1])[0] if are_areas else 0.0
    return 0.0 if overlap > 0 else max(min(distances), 0.0)
