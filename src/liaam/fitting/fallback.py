"""The start in place of a fit that failed far from it.

A fit that failed may end anywhere. The start, such as the mean shape in a box, is then nearer to the object.
"""

from dataclasses import replace

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


def overlap(shape: np.ndarray, other: np.ndarray) -> float:
    """Return the intersection over the union of the boxes around two shapes (n, 2); 0 if one is not finite."""
    if not (np.isfinite(shape).all() and np.isfinite(other).all()):
        return 0.0
    common = common_area(shape, other)
    union = area_of_box(shape) + area_of_box(other) - common
    return common / union if union > 0.0 else 0.0
