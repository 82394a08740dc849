"""The triangulated mesh over the mean shape, and the reference frame's pixels in it (paper eq 3)."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from liaam import _core
from liaam.errors import TrainingError

# Fraction of the mesh's area in flipped triangles above which a shape counts as folded. Landmarks of lips and eyelids
# cross by a pixel in good annotations; a wrong order of points flips far more.
FOLD_TOLERANCE = 0.15


_NO_MESH = "the landmarks lie on one line or at one point, so they span no mesh; check their order and units"


def delaunay(points: np.ndarray) -> np.ndarray:
    """Triangles (t, 3) int32 of points (n, 2), with positive signed areas and without slivers on the border."""
    from scipy.spatial import Delaunay, QhullError

    try:
        triangles = np.asarray(Delaunay(points).simplices)
    except QhullError as error:
        raise TrainingError(_NO_MESH) from error
    areas = np.abs(signed_areas(points, triangles))
    return _turned(points, triangles)[areas > 1e-6 * areas.sum()]


def _turned(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Reverse the triangles of negative area."""
    flipped = signed_areas(points, triangles) < 0
    return np.where(flipped[:, None], triangles[:, ::-1], triangles).astype(np.int32)


def triangles_from_edges(points: np.ndarray, edges: np.ndarray) -> np.ndarray | None:
    """Find the triangles that edges (m, 2) form on a mean shape (n, 2); None if the edges are contours and not a mesh.

    The edges form a mesh if every point belongs to a 3-cycle without other points inside.
    """
    neighbours: dict[int, set[int]] = {i: set() for i in range(len(points))}
    for a, b in np.asarray(edges, dtype=int).reshape(-1, 2):
        if a != b:
            neighbours[int(a)].add(int(b))
            neighbours[int(b)].add(int(a))
    cycles = [
        (a, b, c) for a in neighbours for b in neighbours[a] if b > a for c in neighbours[a] & neighbours[b] if c > b
    ]
    faces = []
    for cycle in cycles:
        inside = np.asarray((barycentric(points, points[list(cycle)]) > 1e-9).all(axis=1))
        inside[list(cycle)] = False
        if not inside.any():
            faces.append(cycle)
    if not faces or len({i for face in faces for i in face}) < len(points):
        return None
    return _turned(points, np.array(sorted(faces), dtype=np.int32))


def signed_areas(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Signed areas of triangles, (t,) float64; negative for flipped triangles."""
    a, b, c = (points[triangles[:, i]] for i in range(3))
    u = b - a
    v = c - a
    return 0.5 * (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])


def folded_share(shape: np.ndarray, triangles: np.ndarray, known: np.ndarray | None = None) -> float:
    """Fraction of a shape's absolute area in flipped triangles, 0 to 1 (1 if it has no area).

    If only some points are ``known`` (n,), triangles with others do not count as flipped.
    """
    areas = signed_areas(shape, triangles)
    total = np.abs(areas).sum()
    are_flipped = areas < 0
    if known is not None:
        are_flipped &= known[triangles].all(axis=1)
    return float(np.abs(areas[are_flipped]).sum() / total) if total > 0 else 1.0


def barycentric(points: np.ndarray, triangle: np.ndarray) -> np.ndarray:
    """Barycentric weights of (m, 2) points in one (3, 2) triangle, (m, 3); they sum to 1."""
    a, b, c = triangle
    basis = np.column_stack([b - a, c - a])
    determinant = basis[0, 0] * basis[1, 1] - basis[0, 1] * basis[1, 0]
    if determinant == 0:
        return np.full((len(points), 3), -1.0)
    d = points - a
    v = (basis[1, 1] * d[:, 0] - basis[0, 1] * d[:, 1]) / determinant
    w = (basis[0, 0] * d[:, 1] - basis[1, 0] * d[:, 0]) / determinant
    return np.column_stack([1.0 - v - w, v, w])


# Width of the ring around a mesh, as a fraction of the distance from the shape's centre. Locating an outline needs
# pixels on both of its sides; at twice the width the background begins to matter (measured on the spot protocol).
SURROUND = 0.06
MAX_RING_WEIGHTS = 32_000_000  # Largest number of weights of landmarks in all vertices, of meshes in pieces


def surroundings(points: np.ndarray, triangles: np.ndarray, width: float = SURROUND) -> tuple[np.ndarray, np.ndarray]:
    """Add a ring of vertices around the hull of the mesh of a mean shape (n, 2), which follow the landmarks.

    Each lies outside a landmark s_h of the mean shape's hull: (1 + width) s_h - width mean(s). This is linear in the
    shape and commutes with affine maps. Return the matrix (n + r, n) that maps landmarks to all vertices, the landmarks
    and then the ring; and the triangles of the mesh, and then of the strip between its hull and the ring.
    """
    hull = _hull(points)
    n = len(points)
    beyond = np.full((len(hull), n), -width / n)
    beyond[np.arange(len(hull)), hull] += 1.0 + width
    return _with_strips(points, triangles, [hull], [beyond])


def surroundings_of_pieces(
    points: np.ndarray, triangles: np.ndarray, width: float = SURROUND
) -> tuple[np.ndarray, np.ndarray]:
    """Add a ring of vertices around each piece of a mesh that is in pieces (:func:`pieces_of`).

    The ring's vertices lie outside those of the piece's hull, at ``width`` times the root mean square distance of the
    landmarks from their centre, or half as far as the piece is thin. They follow the landmarks of the piece linearly
    and commute with affine maps, as those of :func:`surroundings`, which also says what is returned.
    """
    apart = width * float(np.sqrt(np.square(points - points.mean(axis=0)).sum(axis=1).mean()))
    hulls = []
    rings = []
    pieces = [np.unique(triangles[piece]) for piece in pieces_of(triangles)]
    if (len(points) + sum(map(len, pieces))) * len(points) > MAX_RING_WEIGHTS:  # as of a forged file
        raise TrainingError(f"the mesh of {len(points)} landmarks is in {len(pieces)} pieces, which are too many")
    for members in pieces:
        hull = members[_hull(points[members])]
        centred = points[members] - points[members].mean(axis=0)
        thickness = float(np.linalg.svd(centred, compute_uv=False)[-1] / np.sqrt(len(members)))
        outwards = _outwards(points[hull]) * min(apart, 0.5 * thickness)
        # The weights of least norm that move a vertex so far
        moves = outwards @ np.linalg.inv(centred.T @ centred) @ centred.T
        beyond = np.zeros((len(hull), len(points)))
        beyond[:, members] = moves
        beyond[np.arange(len(hull)), hull] += 1.0
        hulls.append(hull)
        rings.append(beyond)
    return _with_strips(points, triangles, hulls, rings)


def pieces_of(triangles: np.ndarray) -> list[np.ndarray]:
    """Indices of the triangles (t, 3) of each piece of a mesh: those that are connected by shared edges."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    owners = np.repeat(np.arange(len(triangles)), 3)
    edges = np.sort(np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=-1).reshape(-1, 2), axis=1)
    _, edge_numbers = np.unique(edges, axis=0, return_inverse=True)
    edge_numbers = edge_numbers.ravel()
    has_edge = coo_array((np.ones(len(owners), int), (owners, edge_numbers))).tocsr()
    count, labels = connected_components(has_edge @ has_edge.T, directed=False)
    return [np.flatnonzero(labels == label) for label in range(count)]


def _hull(points: np.ndarray) -> np.ndarray:
    """Indices of the points (n, 2) on their convex hull, in the order that gives a ring's triangles positive areas."""
    import cv2

    hull = cv2.convexHull(points.astype(np.float32), clockwise=False, returnPoints=False).ravel().astype(int)
    if len(hull) < 3:
        raise TrainingError(_NO_MESH)
    return hull


MITRE = 2.0  # Largest distance of a ring's vertex from that of a sharp corner, in units of the ring's width


def _outwards(hull: np.ndarray) -> np.ndarray:
    """Displacements (r, 2) of the vertices of a convex polygon (r, 2) that move each of its edges outwards by 1."""
    edges = np.roll(hull, -1, axis=0) - hull
    normals = np.stack([edges[:, 1], -edges[:, 0]], axis=1) / np.linalg.norm(edges, axis=1, keepdims=True)
    before = np.roll(normals, 1, axis=0)
    moves = (before + normals) / (1.0 + (before * normals).sum(axis=1, keepdims=True))
    lengths = np.linalg.norm(moves, axis=1, keepdims=True)
    return moves * np.minimum(1.0, MITRE / lengths)


def _with_strips(
    points: np.ndarray, triangles: np.ndarray, hulls: Sequence[np.ndarray], rings: Sequence[np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Add rings of vertices, rows (r, n) of weights of the landmarks, around hulls (r,) to a mesh of points (n, 2).

    Return the weights of all vertices, and the triangles of the mesh and of the strips between hulls and rings.
    """
    strips = []
    n_before = len(points)
    for hull in hulls:
        ring = n_before + np.arange(len(hull))
        next_of_hull = np.roll(hull, -1)
        next_of_ring = np.roll(ring, -1)
        strips.append(np.stack([hull, ring, next_of_hull], 1))
        strips.append(np.stack([next_of_hull, ring, next_of_ring], 1))
        n_before += len(hull)
    strip = np.concatenate(strips)
    extension = np.concatenate([np.eye(len(points)), *rings])
    areas = signed_areas(extension @ points, strip)
    strip = strip[areas > 1e-6 * np.abs(areas).sum()]
    return extension, np.concatenate([triangles, strip]).astype(np.int32)


# Largest weight of estimated landmarks in the position of a pixel that counts as known. Trained on 30 fly wings, nine
# in ten without one landmark, fits are off by 0.391 % of the diagonal (0.403 with a weight of 0, 0.393 with 1/2); on 40
# cephalograms without a fifth of their landmarks by 1.21 % (1.24, 1.23; experiments/notes/missing-landmarks.md).
MOST_ESTIMATED = 1 / 3


@dataclass(frozen=True, eq=False)
class ReferenceFrame:
    """Pixels inside the mesh of the mean shape, on which the appearance is defined.

    Attributes
    ----------
    points : (n_points, 2) float64
        Mean shape s0, centred, in pixels.
    triangles : (t, 3) int32
        All of positive signed area on s0.
    """

    points: np.ndarray
    triangles: np.ndarray

    def __post_init__(self) -> None:
        areas = signed_areas(self.points, self.triangles)
        if (areas <= 0).any():
            where = self.triangles[int(areas.argmin())].tolist()
            raise TrainingError(
                f"the mesh is folded on the mean shape (triangle of points {where}, counting from 0): "
                "check the triangles, or omit them to triangulate the landmarks"
            )

    @cached_property
    def origin(self) -> np.ndarray:
        """Coordinates of the frame's top-left pixel on s0, (2,) float64 with integer values."""
        return np.floor(self.points.min(axis=0)) - 1.0

    @cached_property
    def size(self) -> tuple[int, int]:
        """Width and height of the frame in pixels."""
        extent = np.ceil(self.points.max(axis=0)) + 1.0 - self.origin + 1.0
        return int(extent[0]), int(extent[1])

    @cached_property
    def _raster(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Pixel indices (row, column), triangle and weights of every pixel inside the mesh."""
        points = self.points - self.origin
        nothing = np.zeros((len(self.points), 0))
        flat = np.pad(points, ((0, 0), (0, 1)))
        owner, _ = _core.draw_triangles(flat, np.ascontiguousarray(self.triangles, np.int32), nothing, *self.size[::-1])
        rows, columns = np.nonzero(owner >= 0)
        owners = owner[rows, columns]
        a, b, c = points[self.triangles[owners]].transpose(1, 2, 0)
        (x0, y0), (x1, y1), (dx, dy) = b - a, c - a, np.stack([columns, rows]) - a
        determinant = x0 * y1 - x1 * y0
        v = (y1 * dx - x1 * dy) / determinant
        w = (x0 * dy - y0 * dx) / determinant
        return np.column_stack([rows, columns]), owners, np.column_stack([1.0 - v - w, v, w])

    @property
    def pixels(self) -> np.ndarray:
        """Row and column of each model pixel in the frame, (n_pixels, 2) int, in raster order."""
        return self._raster[0]

    @property
    def n_pixels(self) -> int:
        """Number of model pixels."""
        return len(self._raster[0])

    @property
    def vertices(self) -> np.ndarray:
        """The three mesh vertices around each model pixel, (n_pixels, 3) int32."""
        return self.triangles[self._raster[1]]

    @property
    def owners(self) -> np.ndarray:
        """Triangle of each model pixel, (n_pixels,) int32."""
        return self._raster[1]

    @property
    def weights(self) -> np.ndarray:
        """Barycentric weights beta_v(x) of those vertices, (n_pixels, 3) float64."""
        return self._raster[2]

    def are_known(self, known: np.ndarray) -> np.ndarray:
        """Whether each model pixel can be placed by known vertices (n_points,) bool, (n_pixels,) bool.

        Those that are not known have a weight of at most :data:`MOST_ESTIMATED` there.
        """
        return (self.weights * ~known[self.vertices]).sum(axis=1) <= MOST_ESTIMATED

    def gradient(self, values: np.ndarray) -> np.ndarray:
        """Derivatives of per-pixel values (n_pixels, k) along x and y, (n_pixels, 2, k) float64.

        Those of the cubic spline through the pixels: central differences lose a third of the slope of a wave of four
        pixels, and with it the information of fine texture about the shape. Pixels with one neighbour along an axis use
        the difference to it; those with none get 0.
        """
        values = np.ascontiguousarray(values, np.float64)
        return np.stack([_core.spline_slopes(values, order, joined) for order, joined in self._lines], 1)

    @cached_property
    def _lines(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """The pixels along x and along y, (n_pixels,) int32, and whether one and the next are neighbours, uint8."""
        width, height = self.size
        number = np.full((height, width), -1, dtype=np.int32)
        number[self.pixels[:, 0], self.pixels[:, 1]] = np.arange(self.n_pixels)
        lines = []
        for grid in (number, number.T):
            inside = grid >= 0
            after = np.pad(inside, ((0, 0), (0, 1)))[:, 1:][inside]
            lines.append((grid[inside], after.astype(np.uint8)))
        return lines

    def picture(self, values: np.ndarray, fill: float = 0.0) -> np.ndarray:
        """Arrange per-pixel values (n_pixels, ...) as an image (height, width, ...) float32; ``fill`` is around it."""
        width, height = self.size
        out = np.full((height, width, *np.shape(values)[1:]), fill, dtype=np.float32)
        out[self.pixels[:, 0], self.pixels[:, 1]] = values
        return out


# Largest total size of the triangles' bounding boxes in pixels; rasterising visits each of these pixels
MAX_RASTER_PIXELS = 2e7


def model_frame(points: np.ndarray, triangles: np.ndarray) -> ReferenceFrame:
    """Make the reference frame of a model. Raises for a mesh that is folded or would take minutes to rasterise.

    A forged model file may contain such a mesh.
    """
    frame = ReferenceFrame(points, triangles)
    if np.prod(np.ptp(points[triangles], axis=1) + 2.0, axis=1).sum() > MAX_RASTER_PIXELS:
        raise TrainingError(
            f"the mesh has {len(triangles)} triangles, too many long ones for a frame of "
            f"{frame.size[0]}×{frame.size[1]} pixels: use a smaller diagonal, or omit the triangles"
        )
    return frame
