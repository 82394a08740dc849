"""The start in place of a fit that failed far from it.

A fit that failed may end anywhere. The start, such as the mean shape in a box, is then nearer to the object.

A fit starts from the mean shape with its own proportions, of which the box gives centre and size. Where the image has
added nothing to it, the mean of training shapes that are stretched into the box is nearer: of cephalograms, shells and
fish of many kinds the median error is 2.6, 3.8 and 5.3 instead of 2.8, 4.0 and 5.9 % of the diagonal, and of wings
1.1 % either way.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from liaam.fitting.detection import area_of_box, common_area
from liaam.fitting.result import FitResult
from liaam.model.shape import ShapeModel, align

# Overlap of the boxes around a fit that may not be used and around its start, intersection over union, below which the
# start is the better one. Of 124 fits to generated fish from true boxes, by models of 5 fish of other lots or of 20 of
# many kinds, 63 of 64 with less overlap were worse than their starts, and none of the 36 right ones that are doubtful
# had less.
LEAST_OVERLAP = 0.65


def start_if_failed_far(result: FitResult, start: np.ndarray, shapes: ShapeModel) -> FitResult:
    """Return a fit, with the landmarks (n, 2) of its start if it may not be used and ended far from there.

    Its status and quality stay, and so do fits that failed since the image has no usable pixels there.
    """
    if result.status.ok or result.status.unusable or overlap(result.landmarks, start) >= LEAST_OVERLAP:
        return result
    pose = align(shapes.mean, start)
    return replace(
        result,
        landmarks=start,
        p=shapes.parameters(pose.inverse()(start)),
        pose=pose,
        history=(*result.history, replace(result.history[-1], landmarks=start)),
        expansion=1.0,
        shift=None,
        present=None,
        at_start=True,
    )


def shape_without_fit(init: Any, start: np.ndarray, in_box: np.ndarray | None) -> np.ndarray:
    """Return the landmarks (n, 2) that are the best guess before an image is seen.

    Parameters
    ----------
    init : start
        As given: a box (x0, y0, x1, y1) says where its landmarks are on average. Of other starts it is their shape.
    start : (n, 2) float64
        The shape that the fit started from.
    in_box : (n, 2) float64, optional
        Mean positions of the landmarks in their box (:attr:`liaam.AAM.in_box`).
    """
    box = _given_box(init)
    if in_box is None or box is None:
        return start
    return 0.5 * (box[:2] + box[2:]) + in_box * (box[2:] - box[:2])


def is_in_box(landmarks: np.ndarray, init: Any) -> bool:
    """Return whether a start that was given is a box (x0, y0, x1, y1), and landmarks (n, 2) about fill it."""
    box = _given_box(init)
    return box is not None and overlap(landmarks, box.reshape(2, 2)) >= LEAST_OVERLAP


def _given_box(init: Any) -> np.ndarray | None:
    """Return the box (x0, y0, x1, y1) that a start is; None for other starts."""
    box = np.asarray(getattr(init, "points", init))
    return box if box.shape == (4,) else None


def overlap(shape: np.ndarray, other: np.ndarray) -> float:
    """Return the intersection over the union of the boxes around two shapes (n, 2); 0 if one is not finite."""
    if not (np.isfinite(shape).all() and np.isfinite(other).all()):
        return 0.0
    common = common_area(shape, other)
    union = area_of_box(shape) + area_of_box(other) - common
    return common / union if union > 0.0 else 0.0
