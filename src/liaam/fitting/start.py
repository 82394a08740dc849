"""Where a fit starts: a shape, a box, or a point and a size."""

import numpy as np

from liaam.errors import StartError
from liaam.model import AAM
from liaam.model.shape import align, diagonal_of

WIDEST = 10.0
"""Size of a start at most, in larger sides of the picture: an object that is cut off on all sides is no larger."""


def start_shape(model: AAM, init, image_size: tuple[int, int], name: str = "image") -> np.ndarray:
    """Turn what a person gives into a start shape.

    Parameters
    ----------
    model : AAM
    init : (n, 2) shape, (x0, y0, x1, y1) box, or (x, y, size)
        A shape in image pixels (landmarks may be NaN as long as 3 are not: the mean shape is aligned to
        the rest); the box around the landmarks, whose centre and diagonal the mean shape takes; or the
        centre of the mean shape's bounding box and its diagonal.
    image_size : (int, int)
        Width and height.
    name : str
        What to call the image in an error.

    Returns
    -------
    (n, 2) float64

    Raises
    ------
    StartError
        If the start has another number of points than the model, is no number, or lies outside the image.
    """
    try:
        given = np.asarray(getattr(init, "points", init), dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise StartError(f"{name}: the start {init!r} is no shape, box, or point and size ({error})") from error
    shape = _shape(model, given, name)
    width, height = image_size
    centre = 0.5 * (shape.min(axis=0) + shape.max(axis=0))
    inside = ((shape >= 0) & (shape <= [width - 1, height - 1])).all(axis=1).mean()
    if inside < 0.2:
        raise StartError(
            f"{name}: the start lies outside the image (centre {centre[0]:.0f}, {centre[1]:.0f}; the image is "
            f"{width}×{height} pixels); give a start in pixels of this image"
        )
    extent = np.ptp(shape / max(width, height), axis=0).max()
    if not extent <= WIDEST:
        raise StartError(
            f"{name}: the start is {extent:.3g} times as large as the image ({width}×{height} pixels), and may be "
            f"{WIDEST:g} times as large; give a start in pixels of this image"
        )
    # Of the mean shape once aligned: points on one spot leave no size.
    size = diagonal_of(model.shape_model.mean) * align(model.shape_model.mean, shape).scale
    if not size >= 4.0:
        raise StartError(f"{name}: the start is only {size:.1f} pixels large; give one of the object's size")
    return shape


def _shape(model: AAM, given: np.ndarray, name: str) -> np.ndarray:
    if given.shape == (model.n_points, 2):
        return _from_shape(model, given, name)
    if given.shape == (4,):
        return _from_box(model, given, name)
    if given.shape == (3,):
        return _from_point(model, given, name)
    if given.ndim == 2 and given.shape[1] == 2:
        raise StartError(f"{name}: the start has {len(given)} landmarks but the model has {model.n_points}")
    raise StartError(
        f"{name}: a start of shape {given.shape} is neither landmarks ({model.n_points}, 2), nor a box "
        "(x0, y0, x1, y1), nor a point and a size (x, y, diagonal)"
    )


def _from_shape(model: AAM, shape: np.ndarray, name: str) -> np.ndarray:
    seen = np.asarray(np.isfinite(shape).all(axis=1))
    if seen.all():
        return shape
    if seen.sum() < 3:
        raise StartError(f"{name}: only {seen.sum()} of the start's landmarks are numbers; at least 3 are needed")
    whole = align(model.shape_model.mean, shape)(model.shape_model.mean)
    return np.where(seen[:, None], shape, whole)


def _from_box(model: AAM, box: np.ndarray, name: str) -> np.ndarray:
    x0, y0, x1, y1 = box
    if not np.isfinite(box).all() or x1 <= x0 or y1 <= y0:
        raise StartError(
            f"{name}: the box {', '.join(f'{v:g}' for v in box)} is empty; give left, top, right, bottom in pixels"
        )
    return _place(model, np.array([x0 + x1, y0 + y1]) / 2, float(np.hypot(x1 - x0, y1 - y0)))


def _from_point(model: AAM, given: np.ndarray, name: str) -> np.ndarray:
    if not np.isfinite(given).all() or given[2] <= 0:
        raise StartError(f"{name}: give the start as x, y and a positive size (the object's diagonal in pixels)")
    return _place(model, given[:2], float(given[2]))


def _place(model: AAM, centre: np.ndarray, diagonal: float) -> np.ndarray:
    """Mean shape with its bounding box's centre and diagonal as asked."""
    mean = model.shape_model.mean
    middle = 0.5 * (mean.min(axis=0) + mean.max(axis=0))
    return (mean - middle) * (diagonal / diagonal_of(mean)) + centre
