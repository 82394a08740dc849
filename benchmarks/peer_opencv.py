"""A model file of the same heads for OpenCV's FacemarkAAM, whose Python binding can load and fit, but not train.

The file has the content that OpenCV's training writes: the mean shape, shape modes, the triangles' pixels in the
reference frame, and the modes of the grey values there. A fit starts from the mean shape at the centre of the image, at
its own size, so the image is first cropped and scaled to the box. It uses 50 iterations and 10 shape modes, which the
binding cannot change.
"""

from collections.abc import Iterable
from pathlib import Path

import cv2
import numpy as np

from liaam.model import AAM
from liaam.model.shape import similarity_modes

ITERATIONS = 50
"""What OpenCV takes, for the report."""

BORDER = 2.0
"""Pixels around the mean shape in the reference frame."""

Picture = tuple[np.ndarray, np.ndarray]
Scalars = Iterable[int | float]


def base_shape(model: AAM) -> np.ndarray:
    """The mean shape in the reference frame."""
    mean = model.shape_model.mean
    return (mean - mean.min(axis=0) + BORDER).astype(np.float32)


def triangle_picture(base: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the number of each pixel's triangle, from 1 on, 0 outside; and the triangles that have pixels.

    OpenCV does not support triangles without pixels.
    """
    width, height = np.ceil(np.ptp(base, axis=0) + 3).astype(int)
    picture = np.zeros((height, width), np.uint8)
    for i, triangle in enumerate(triangles):
        cv2.fillConvexPoly(picture, np.rint(base[triangle]).astype(np.int32), i + 1)
    kept = np.isin(np.arange(len(triangles)) + 1, picture)
    numbers = np.concatenate([[0], np.cumsum(kept)]).astype(np.uint8)
    return numbers[picture], triangles[kept]


def grey_of(image: np.ndarray) -> np.ndarray:
    """Return the grey values (h, w) of an image (h, w, 3) in RGB."""
    return cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)


def carried(grey: np.ndarray, shape: np.ndarray, base: np.ndarray, labels: np.ndarray, triangles: np.ndarray):
    """Warp the grey values of an image to the reference frame, piecewise affine."""
    places = np.zeros((*labels.shape, 2), np.float32)
    for i, triangle in enumerate(triangles):
        y, x = np.nonzero(labels == i + 1)
        affine = cv2.getAffineTransform(base[triangle], shape[triangle].astype(np.float32))
        # OpenCV counts columns from 1 and rows from 2 here, in the frame and in the image.
        places[y, x] = np.column_stack([x + 1, y + 2, np.ones_like(x)]) @ affine.T - (1, 2)
    return cv2.remap(grey, places[..., 0], places[..., 1], cv2.INTER_LINEAR)


def column_order(mask: np.ndarray) -> np.ndarray:
    """Indices of a mask's pixels, column by column."""
    return np.flatnonzero(mask.T)


def stacked(modes: np.ndarray, n_points: int) -> np.ndarray:
    """Reorder modes (k, 2 n) of interleaved x and y to columns of all x, then all y."""
    return np.ascontiguousarray(modes.reshape(-1, n_points, 2).transpose(2, 1, 0).reshape(2 * n_points, -1), np.float32)


def write_model(path: Path, model: AAM, training: list[Picture], n_modes: int) -> int:
    """Write a model of liaam's shapes and of grey values. Return the number of pixels that fits compare.

    Grey values are stored without the border of the mesh, and compared without the border of these, where gradients
    need pixels outside.
    """
    base = base_shape(model)
    n_points = model.shape_model.n_points
    labels, triangles = triangle_picture(base, model.triangles)
    stored = cv2.erode((labels > 0).astype(np.uint8), np.ones((3, 3), np.uint8))
    compared = cv2.erode(stored, np.ones((3, 3), np.uint8))
    stored_pixels = column_order(stored)
    compared_pixels = column_order(compared)
    textures = [carried(grey_of(image), shape, base, labels, triangles) for image, shape in training]
    values = [texture.T.ravel()[stored_pixels] for texture in textures]
    mean = np.mean(values, axis=0)
    _, _, rows = np.linalg.svd(np.array(values) - mean, full_matrices=False)
    modes = rows[:n_modes].T
    is_compared = np.isin(stored_pixels, compared_pixels)
    orthonormal, _ = np.linalg.qr(modes[is_compared])
    file = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    write_numbers(file, "AAM_tri", triangles.ravel().tolist())
    write_numbers(file, "scales", [1.0])
    write_numbers(file, "s0", model.shape_model.mean.ravel().tolist())
    file.write("S", stacked(model.shape_model.modes, n_points))
    file.write("Q", stacked(similarity_modes(model.shape_model.mean), n_points))
    file.write("scale0_max_m", n_modes)
    write_numbers(file, "scale0_resolution", [0, 0, labels.shape[1], labels.shape[0]])
    file.startWriteStruct("scale0_textureIdx", cv2.FILE_NODE_SEQ)
    for i in range(len(triangles)):
        write_numbers(file, "", np.argwhere(labels == i + 1)[:, ::-1].ravel().tolist())
    file.endWriteStruct()
    write_numbers(file, "scale0_base_shape", base.ravel().tolist())
    file.write("scale0_A", np.ascontiguousarray(modes, np.float32))
    file.write("scale0_A0", np.ascontiguousarray(mean[:, None], np.float32))
    file.write("scale0_AA", np.ascontiguousarray(orthonormal, np.float32))
    # A vector of one dimension is a column in OpenCV 4, a row in 5.
    is_column = int(cv2.__version__.split(".")[0]) < 5
    mean_compared = mean[is_compared].astype(np.float32)
    file.write("scale0_AA0", mean_compared[:, None] if is_column else mean_compared[None])
    write_numbers(file, "scale0_ind1", stored_pixels.tolist())
    write_numbers(file, "scale0_ind2", compared_pixels.tolist())
    file.release()
    return len(compared_pixels)


def write_numbers(file, name: str, numbers: Scalars) -> None:
    """Write a sequence."""
    file.startWriteStruct(name, cv2.FILE_NODE_SEQ + cv2.FILE_NODE_FLOW)
    for number in numbers:
        file.write("", number)
    file.endWriteStruct()


class BoxFit:
    """Fits from a box with a model file."""

    def __init__(self, path: Path, model: AAM) -> None:
        self.mean = model.shape_model.mean
        self.facemark = cv2.face.createFacemarkAAM()  # type: ignore
        self.facemark.loadModel(str(path))

    def __call__(self, image: np.ndarray, box: np.ndarray) -> np.ndarray:
        """Return the shape in the image, (n, 2), fitted in a small image around the box at the model's size."""
        low = self.mean.min(axis=0)
        high = self.mean.max(axis=0)
        diagonal = np.linalg.norm(high - low)
        scale = np.linalg.norm(box[2:] - box[:2]) / diagonal  # from the model's size to the box's
        side = 2 * int(diagonal)  # of the small image, with room around the object
        # OpenCV starts from the mean shape with its origin in the middle of the small image. The middle of the shape,
        # which need not be its origin, shall be that of the box.
        origin = 0.5 * (box[:2] + box[2:]) - scale * (side / 2 + 0.5 * (low + high))
        affine = np.column_stack([scale * np.eye(2), origin])
        small = cv2.warpAffine(image, affine, (side, side), flags=cv2.INTER_AREA | cv2.WARP_INVERSE_MAP)
        found, shapes = self.facemark.fit(grey_of(small), np.array([[0, 0, side, side]], np.int32))
        if not found:
            raise RuntimeError("FacemarkAAM gives no landmarks")
        return origin + scale * np.asarray(shapes[0], float).reshape(-1, 2)
