"""Warps W(x; p) from the reference frame to the image, with one interface for all solvers.

Points and derivatives are in model pixels; the fitting problem adds the similarity between model and image pixels.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from math import sqrt
from typing import NamedTuple

import numpy as np

from liaam.model.mesh import ReferenceFrame, model_frame, surroundings, surroundings_of_pieces
from liaam.model.shape import ShapeModel, Similarity

THINNING = 1.5
"""Distance between sampled pixels, in standard deviations of a level's blur, rounded to whole pixels. Closer pixels are
redundant at the sharpest level; coarse levels need theirs (experiments/notes/engine.md). Of these levels, model files
hold only the pixels that this distance needs (:func:`liaam.fitting.loop.objective.pixels_for`)."""


def thinning_of(encoding: str) -> float:
    """Return the distance between sampled pixels of images in an encoding, in standard deviations of a level's blur.

    It is 0 (every pixel) for orientations: they are normalised after the blur, so neighbours are less redundant.
    Measured with ``igo`` on unseen persons of IMM: 6.1 % with all pixels, 7.1 % with :data:`THINNING`.
    """
    return 0.0 if encoding == "orientation" else THINNING


class Mesh(NamedTuple):
    """Arrays of a piecewise affine warp (paper eq 3) for the core, with pixels sorted by triangle."""

    beta: np.ndarray
    """(n, 3) float32: barycentric weights of each pixel."""
    starts: np.ndarray
    """(t + 1,) int64: first pixel of each triangle, and the end."""
    triangles: np.ndarray
    """(t, 3) int64: vertices of each triangle."""
    rest: np.ndarray
    """(v, 2) float64: vertices at p = 0, model pixels."""
    basis: np.ndarray
    """(2 v, w) float64: derivative of the vertices x0, y0, x1, y1, ... by p, padded with zeros to a multiple of 8."""
    movement: float
    """Root mean square movement of the landmarks by a step of p of unit length, model pixels."""


def padded(n: int) -> int:
    """Return the next multiple of 8, the width of the compiled loops' vectors."""
    return -(-n // 8) * 8


@dataclass(frozen=True, eq=False)
class PiecewiseAffineWarp:
    """Piecewise-affine warp of a mesh whose vertices follow a shape model (paper eq 3).

    W(x; p) = sum_v beta_v(x) s_v(p) is linear in p, so dW/dp_i = sum_v beta_v(x) s_i[v] is constant. ``extension``
    (n_vertices, n_points) maps landmarks to the frame's vertices (:func:`liaam.model.mesh.surroundings`), by default
    the identity. ``selected`` (n_pixels,) holds the indices of the frame's pixels to use, in order, by default all.
    ``from_right`` says whether grids of pixels are laid from the right: of the mirror image of a model.
    """

    frame: ReferenceFrame
    shape_model: ShapeModel
    extension: np.ndarray | None = None
    selected: np.ndarray | None = None
    from_right: bool = False

    @property
    def n_parameters(self) -> int:
        """Number of shape modes plus the four similarity vectors."""
        return len(self.shape_model.basis)

    @property
    def rest(self) -> np.ndarray:
        """The mean shape."""
        return self.shape_model.mean

    def shape(self, p: np.ndarray) -> np.ndarray:
        """Landmarks s(p), (..., n_points, 2) float64."""
        return self.shape_model.shape(p)

    def parameters(self, shape: np.ndarray) -> np.ndarray:
        """Coordinates of a shape's orthogonal projection on the model."""
        return self.shape_model.parameters(shape)

    def movement(self, step: np.ndarray) -> float:
        """Root mean square movement of the landmarks by a step of p, model pixels."""
        # The shape vectors are orthonormal over the 2 n landmark coordinates.
        return sqrt(float(step @ step) / self.shape_model.n_points)

    def points(self, p: np.ndarray, pose: Similarity | None = None) -> np.ndarray:
        """W(x; p) of every model pixel, mapped by a similarity if one is given, (n_pixels, 2) float64."""
        landmarks = self.shape_model.shape(p)
        # Barycentric weights sum to 1, so it suffices to map the landmarks.
        return self.interpolate(landmarks if pose is None else pose(landmarks))

    def interpolate(self, landmarks: np.ndarray) -> np.ndarray:
        """Interpolate positions (n_points, 2) of the landmarks at all model pixels, (n_pixels, 2) float64."""
        corners, beta = self._corners
        return np.einsum("nv,nva->na", beta, self._vertices(landmarks)[corners])

    def are_known(self, known: np.ndarray) -> np.ndarray:
        """Whether each model pixel can be placed by known landmarks (n_points,) bool, (n_pixels,) bool."""
        if self.extension is not None:
            # A vertex around the mesh follows one landmark of its hull, and hardly the others.
            known = known[self.extension.argmax(axis=1)]
        return self._used(self.frame.are_known(known))

    def _vertices(self, landmarks: np.ndarray) -> np.ndarray:
        """Positions of the frame's vertices, (n_vertices, 2), from those of the landmarks."""
        return landmarks if self.extension is None else self.extension @ landmarks

    @cached_property
    def _owners(self) -> np.ndarray:
        return self._used(self.frame.owners)

    @cached_property
    def _corners(self) -> tuple[np.ndarray, np.ndarray]:
        """Vertices around each pixel, (n_pixels, 3) int32, and their weights, (n_pixels, 3) float64."""
        return self.frame.triangles[self._owners], np.ascontiguousarray(self._used(self.frame.weights))

    def _used(self, of_all: np.ndarray) -> np.ndarray:
        return of_all if self.selected is None else of_all[self.selected]

    @cached_property
    def _vertex_modes(self) -> np.ndarray:
        """Movement of the frame's vertices by each parameter, (n_parameters, n_vertices, 2) float64."""
        modes = self.shape_model.basis.reshape(self.n_parameters, -1, 2)
        return modes if self.extension is None else np.einsum("vn,ina->iva", self.extension, modes, optimize=True)

    def mesh(self) -> Mesh:
        """Return the warp's arrays for the core; its pixels must be sorted by triangle."""
        triangles = self.frame.triangles.astype(np.int64)
        modes = self._vertex_modes.reshape(self.n_parameters, -1)
        assert not (np.diff(self._owners) < 0).any()
        return Mesh(
            self._corners[1].astype(np.float32),
            np.searchsorted(self._owners, np.arange(len(triangles) + 1)).astype(np.int64),
            triangles,
            np.ascontiguousarray(self._vertices(self.shape_model.mean), np.float64),
            np.ascontiguousarray(np.pad(modes.T, ((0, 0), (0, padded(len(modes)) - len(modes))))),
            1.0 / sqrt(self.shape_model.n_points),
        )

    @cached_property
    def within_mesh(self) -> np.ndarray:
        """Whether each pixel lies in a triangle of landmarks, not in the surroundings, (n_pixels,) bool."""
        are_landmarks = self.frame.triangles[self._owners] < self.shape_model.n_points
        return np.asarray(are_landmarks.all(axis=1))

    def every(self, spacing: float) -> np.ndarray:
        """Indices of pixels on a square grid of about this spacing, sorted by triangle."""
        rows, columns = self.frame.pixels.T
        columns = self.frame.size[0] - 1 - columns if self.from_right else columns
        step = max(1, round(spacing))
        pixels = np.flatnonzero((rows % step == 0) & (columns % step == 0))
        if len(pixels) < min(FEWEST, len(rows)):  # a small frame under a wide blur
            return self.every(0.5 * spacing)
        return pixels[np.argsort(self.frame.owners[pixels], kind="stable")]

    def at(self, pixels: np.ndarray) -> "PiecewiseAffineWarp":
        """Return the warp of some of the frame's pixels only."""
        return replace(self, selected=pixels)

    @cached_property
    def _jacobian(self) -> np.ndarray:
        corners, beta = self._corners
        jacobian = np.einsum("nv,inva->nai", beta, self._vertex_modes[:, corners], optimize=True)
        return np.ascontiguousarray(jacobian, dtype=np.float32)

    def jacobian(self, p: np.ndarray) -> np.ndarray:
        """dW/dp of every model pixel, (n_pixels, 2, n_parameters) float32; the same for every p."""
        return self._jacobian

    def slopes(self, values: np.ndarray) -> np.ndarray:
        """Derivatives along x and y at the used pixels, of values (n, k) at *all* of the frame's pixels."""
        return self._used(self.frame.gradient(values))

    def pulled(self, slopes: np.ndarray, p: np.ndarray) -> np.ndarray:
        """Map gradients (n_pixels, 2, k) at x to gradients at W(x; p), (n_pixels, k, 2) float32.

        If V(W(x; p)) = values(x), then grad V = (dW/dx)^-T grad values. Nearly flat triangles give 0.
        """
        vertices = self._vertices(self.shape_model.shape(p))
        triangles = self.frame.triangles
        at_rest, now = (  # two edges of each triangle as columns
            (points[triangles[:, 1:]] - points[triangles[:, :1]]).transpose(0, 2, 1)
            for points in (self.frame.points, vertices)
        )
        flat = ~(np.abs(np.linalg.det(now)) > FLAT * np.abs(np.linalg.det(at_rest)))
        back = (at_rest @ _inverse(now, flat))[self._owners]
        return np.einsum("nba,nbk->nka", back, slopes).astype(np.float32)


FEWEST = 8  # Least number of a frame's pixels to use
FLAT = 0.05  # Fraction of its area on the mean shape below which a triangle counts as flat


def _inverse(matrices: np.ndarray, flat: np.ndarray) -> np.ndarray:
    """Inverse of matrices (n, 2, 2), 0 for those that are flat (n,)."""
    (a, b), (c, d) = np.moveaxis(matrices, 0, 2)
    back = np.array([[d, -b], [-c, a]]) / np.where(flat, 1.0, a * d - b * c)  # a tenth of the time of np.linalg.inv
    back[..., flat] = 0.0
    return np.ascontiguousarray(np.moveaxis(back, 2, 0))


def mesh_warp(shape_model: ShapeModel, triangles: np.ndarray, in_pieces: bool = False) -> PiecewiseAffineWarp:
    """Make the warp of a mesh on the mean shape, which may be in pieces."""
    return PiecewiseAffineWarp(model_frame(shape_model.mean, triangles), shape_model)


def surrounded_warp(shape_model: ShapeModel, triangles: np.ndarray, in_pieces: bool = False) -> PiecewiseAffineWarp:
    """Make the warp of a mesh and its surroundings (:func:`liaam.model.mesh.surroundings`), or those of its pieces."""
    surround = surroundings_of_pieces if in_pieces else surroundings
    extension, wider = surround(shape_model.mean, triangles)
    return PiecewiseAffineWarp(model_frame(extension @ shape_model.mean, wider), shape_model, extension)


# Groups of plane maps, and how many of the GENERATORS they have
GROUPS = {"translation": 2, "similarity": 4, "affine": 6, "homography": 8}

GENERATORS = np.array(
    [
        [[0, 0, 1], [0, 0, 0], [0, 0, 0]],
        [[0, 0, 0], [0, 0, 1], [0, 0, 0]],
        [[1, 0, 0], [0, 1, 0], [0, 0, 0]],
        [[0, -1, 0], [1, 0, 0], [0, 0, 0]],
        [[1, 0, 0], [0, -1, 0], [0, 0, 0]],
        [[0, 1, 0], [1, 0, 0], [0, 0, 0]],
        [[0, 0, 0], [0, 0, 0], [1, 0, 0]],
        [[0, 0, 0], [0, 0, 0], [0, 1, 0]],
    ],
    dtype=np.float64,
)

NEAREST = 0.1  # Depth, relative to that of the grid's centre, below which a point counts as behind the image plane


@dataclass(frozen=True, eq=False)
class HomographyWarp:
    """Homography of a regular grid of pixels, or a subgroup with fewer parameters.

    W(x; p) = (N_1 / N_3, N_2 / N_3) with N = (I + sum_i p_i G_i) (x, 1) in centred and scaled coordinates. At p = 0, a
    step of unit length moves the grid's pixels by one pixel (root mean square).

    ``mask`` (rows, columns) selects points of the grid, ``stride`` model pixels apart; the first lies at the origin.
    ``rest`` (n, 2) are the handles in model pixels: four corners or more, no three of the four on a line. ``group`` is
    a key of :data:`GROUPS`.
    """

    mask: np.ndarray
    rest: np.ndarray
    stride: float = 1.0
    group: str = "homography"

    @cached_property
    def pixels(self) -> np.ndarray:
        """Used points of the grid, (n_pixels, 2) float64 model pixels."""
        rows, columns = np.nonzero(self.mask)
        return self.stride * np.column_stack([columns, rows]).astype(np.float64)

    @property
    def n_parameters(self) -> int:
        """Number of parameters: 2, 4, 6 or 8."""
        return len(self._basis)

    def movement(self, step: np.ndarray) -> float:
        """Root mean square movement of the grid's pixels by a step from p = 0, model pixels."""
        return float(np.linalg.norm(step))

    def matrix(self, p: np.ndarray) -> np.ndarray:
        """Homography in model pixels, (3, 3) float64."""
        return np.eye(3) + np.tensordot(p, self._basis, axes=1)

    @cached_property
    def _basis(self) -> np.ndarray:
        """The G_i in model pixels, (n_parameters, 3, 3) float64."""
        n = len(self.pixels)
        centre = self.pixels.mean(axis=0)
        size = max(float(np.sqrt(np.square(self.pixels - centre).sum() / n)), self.stride)
        into = np.array([[1.0, 0.0, -centre[0]], [0.0, 1.0, -centre[1]], [0.0, 0.0, size]]) / size
        plain = np.array([np.linalg.inv(into) @ generator @ into for generator in GENERATORS[: GROUPS[self.group]]])
        x = _homogeneous(self.pixels)
        moved = np.einsum("iab,nb->ina", plain, x, optimize=True)
        flow = (moved[..., :2] - self.pixels * moved[..., 2:]).reshape(len(plain), -1)
        products = flow @ flow.T / n
        products[np.diag_indices_from(products)] *= 1.0 + 1e-9  # pixels on one line do not determine all parameters
        return np.tensordot(np.linalg.inv(np.linalg.cholesky(products)), plain, axes=1)

    @cached_property
    def _single(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Points (x, 1), and rows 1 to 2 and row 3 of the G_i as columns, in single precision."""
        basis = self._basis.astype(np.float32)
        rows = np.ascontiguousarray(basis.transpose(1, 2, 0))
        return _homogeneous(self.pixels).astype(np.float32), rows[:2], rows[2]

    def points(self, p: np.ndarray, pose: Similarity | None = None) -> np.ndarray:
        """W(x; p) of every model pixel, mapped by a similarity if one is given, (n_pixels, 2) float64.

        Points behind the image plane are NaN.
        """
        points = apply_homography(self.matrix(p), self.pixels)
        return points if pose is None else pose(points)

    def jacobian(self, p: np.ndarray) -> np.ndarray:
        """dW/dp of every model pixel, (n_pixels, 2, n_parameters) float32: (G_12 - W G_3) (x, 1) / N_3."""
        x, upper, last = self._single
        matrix = self.matrix(p)
        depth = np.maximum(x @ matrix[2].astype(np.float32), np.float32(NEAREST))[:, None]
        x = x / depth
        along = x @ last
        jacobian = np.empty((len(x), 2, self.n_parameters), np.float32)
        for axis in (0, 1):
            jacobian[:, axis] = x @ upper[axis] - (x @ matrix[axis].astype(np.float32))[:, None] * along
        return jacobian

    def shape(self, p: np.ndarray) -> np.ndarray:
        """Handles at p, (..., n, 2) float64; NaN behind the image plane."""
        if np.ndim(p) > 1:
            return np.array([self.shape(each) for each in p])
        return apply_homography(self.matrix(p), self.rest)

    def parameters(self, shape: np.ndarray) -> np.ndarray:
        """Parameters that move the handles nearest to a shape, (n_parameters,) float64.

        Minimises the algebraic distance N_12 - W N_3, which is linear in p; exact for a homography of four handles.
        """
        moved = np.einsum("iab,nb->ina", self._basis, _homogeneous(self.rest))
        columns = (moved[..., :2] - shape * moved[..., 2:]).reshape(self.n_parameters, -1)
        return np.linalg.lstsq(columns.T, (shape - self.rest).ravel(), rcond=None)[0]

    def slopes(self, values: np.ndarray) -> np.ndarray:
        """Derivatives of per-pixel values (n_pixels, k) along x and y at p = 0, (n_pixels, 2, k) float32.

        Central differences where both neighbours are used, the difference to one where only one is, else 0.
        """
        picture = np.full((*self.mask.shape, values.shape[1]), np.nan)
        picture[self.mask] = values
        slopes = np.stack([_differences(picture, axis)[self.mask] for axis in (1, 0)], axis=1) / self.stride
        return slopes.astype(np.float32)

    def pulled(self, slopes: np.ndarray, p: np.ndarray) -> np.ndarray:
        """Map gradients (n_pixels, 2, k) at x to gradients at W(x; p), (n_pixels, k, 2) float32."""
        matrix = self.matrix(p)
        x = _homogeneous(self.pixels)
        depth = np.maximum(x @ matrix[2], NEAREST)
        moved = apply_homography(matrix, self.pixels)
        slope = (matrix[None, :2, :2] - moved[:, :, None] * matrix[2, :2]) / depth[:, None, None]  # dW/dx
        slope[~np.isfinite(slope).all(axis=(1, 2))] = 0.0  # behind the image plane
        turns_over = ~(slope[:, 0, 0] * slope[:, 1, 1] - slope[:, 0, 1] * slope[:, 1, 0] > 0.05)
        back = _inverse(slope, turns_over)
        return np.einsum("nba,nbk->nka", back, slopes).astype(np.float32)


Warp = PiecewiseAffineWarp | HomographyWarp
"""A warp of either kind. Its handles are the landmarks, or the corners of the grid."""


def _homogeneous(points: np.ndarray) -> np.ndarray:
    return np.column_stack([points, np.ones(len(points))])


def picture_corners(height: int, width: int) -> np.ndarray:
    """Centres (x, y) of an image's corner pixels, clockwise from the top left, (4, 2) float64."""
    return np.array([[0, 0], [width - 1, 0], [width - 1, height - 1], [0, height - 1]], dtype=np.float64)


def apply_homography(matrix: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Apply a homography to (n, 2) points; NaN for points behind the image plane."""
    moved = _homogeneous(points) @ matrix.T
    depth = moved[:, 2]
    return moved[:, :2] / np.where(depth > NEAREST, depth, np.nan)[:, None]


def _differences(picture: np.ndarray, axis: int) -> np.ndarray:
    """Derivative of an image (rows, columns, k) along an axis from the neighbours that are not NaN; 0 without any."""
    ahead = np.diff(picture, axis=axis, append=np.full_like(np.take(picture, [0], axis), np.nan))
    behind = np.roll(ahead, 1, axis)  # the last difference is NaN, so the first pixel has none behind
    finite = np.isfinite(np.stack([ahead, behind]))
    total = np.where(finite, np.stack([ahead, behind]), 0.0).sum(axis=0)
    return total / np.maximum(finite.sum(axis=0), 1)
