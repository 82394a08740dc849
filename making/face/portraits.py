"""Turned and speaking portraits: frontal photographs on heads from light-stage scans.

A head (:mod:`making.head.geometry`) is fitted to the landmarks of a photograph: its pose, identity and expression, and
smoothly what these leave. The photograph is its texture. Hair, ears, neck and clothes are on a surface around the face
that has the depth of the head. Then the head is turned, and its expression changed. Teeth and the inside of the mouth,
which the photograph does not show, are plain. The nearest surface is drawn, over the background of the photograph.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from matplotlib.path import Path as Polygon
from scipy.interpolate import RBFInterpolator
from scipy.ndimage import distance_transform_edt
from scipy.optimize import lsq_linear
from scipy.spatial import KDTree

from liaam.model.shape import align, diagonal_of
from liaam.morphometry.schemes import in_scheme
from making.head.casting import rotation
from making.head.geometry import (
    GUMS_AND_TONGUE,
    HEAD_AND_NECK,
    MOUTH_SOCKET,
    TEETH,
    WHITES,
    ScannedHeads,
    normals_of,
)
from scenes.raster import draw

NARROW = slice(0, 6706)
"""Vertices of the face without ears, temples and neck."""

SKIN = slice(0, HEAD_AND_NECK.stop)
"""Vertices of face, head and neck."""

EYES, LIPS = slice(36, 48), slice(60, 68)
"""Landmarks of iBUG around the eyes, and of the inner edges of the lips."""

N_IDENTITIES = 60
"""Number of components of identity that are fitted."""

OF_IDENTITY, OF_EXPRESSION = 0.15, 1.0
"""Precision of coordinates of identity, in standard deviations, and of the strengths of expressions, relative to that
of landmarks in centimetres."""

MOST_IDENTITY = 2.0
"""Largest coordinate of identity, standard deviations."""

ROUNDS = 6
"""Number of times that pose and shape of the head are fitted in turn."""

NOT_FITTED = ("cheek", "eyeLook", "jawForward", "noseSneer", "mouthFunnel", "mouthClose")
"""Beginnings of the names of expressions that landmarks hardly tell."""

OPEN = 0.5
"""How far the jaw is open of the head on which neighbours are found, so that the lips lie apart."""

SMOOTH = 1e-3
"""Smoothing of what pose, identity and expression leave."""

HIDDEN = 0.25
"""Distance behind the nearest surface from which a vertex is hidden, centimetres."""

LASHES = 0.35
"""Length of lashes, of which folded lids show nothing, centimetres."""

TEETH_COLOUR = (1.25, 1.3, 1.35)
GUMS_COLOUR = (0.75, 0.5, 0.5)
"""Stored values as multiples of the skin's: red, green, blue."""

DEEP = 1.5
"""Depth behind the lips at which the inside of a mouth has 1/e of its brightness, centimetres."""

STEP = 2
"""Distance between vertices of the surface around the face, pixels."""

BEHIND = 0.1
"""Distance of that surface behind the head, centimetres."""

OVERLAP = 8
"""How far it goes on behind the border of the face, pixels."""

RIM = 4
"""Width of the rim of the background that shows some of the person, pixels."""

AROUND = 0.3
"""Margin of a picture around the landmarks, as a fraction of their diagonal."""

TOLERANCE = 20
"""Largest difference of a studio's background from its colour in the corners, grey values."""

FACE_DEPTH = 8.0
"""Distance of faces before the middle of the head, at which perspective keeps their size, centimetres."""

STRIP = 0.25
"""Half the width of the strips in which the outline of the jaw is looked for, centimetres."""

UPRIGHT = np.array([1.0, -1.0, 1.0])
"""Turns the y axis over: heads have it upwards, and pictures downwards."""


@dataclass(frozen=True, eq=False)
class Scheme:
    """Scanned heads, and which of their vertices are the landmarks of photographs.

    Attributes
    ----------
    heads : ScannedHeads
    carriers : (n,) int
        Vertex of each landmark.
    jaw : sequence of int
        Landmarks from ear to ear by the chin.
    """

    heads: ScannedHeads
    carriers: np.ndarray
    jaw: Sequence[int]

    @classmethod
    def of(cls, heads: ScannedHeads, mean: np.ndarray, names: Sequence[str], jaw: Sequence[int]) -> "Scheme":
        """Find the vertices by the mean shape (n, 2) of neutral faces, whose landmarks have the model's names."""
        common = in_scheme(mean, names, "ibug-68")
        known = (heads.vertices[heads.landmarks] * UPRIGHT)[:, :2]
        pose = align(common, known)
        spline = RBFInterpolator(pose(common), known, smoothing=0.02, kernel="thin_plate_spline")
        wanted = spline(pose(mean))
        return cls(heads, np.array([_carrier(heads, *each) for each in zip(names, wanted, strict=True)]), jaw)

    @cached_property
    def fitted_expressions(self) -> list[str]:
        """Names of the expressions that are fitted."""
        return [name for name in self.heads.expressions if not name.startswith(NOT_FITTED)]

    @cached_property
    def with_open_mouth(self) -> np.ndarray:
        """Vertices (v, 3) of the mean head with an open mouth: near each other there is near on the skin."""
        return self.heads.shaped(np.zeros(0), {"jawOpen": OPEN})

    @cached_property
    def basis(self) -> np.ndarray:
        """Displacements of the landmarks by identities and expressions, (k, n, 3) float64."""
        known = [self.heads.identities[:N_IDENTITIES, self.carriers]]
        known += [self.heads.expressions[name][None, self.carriers] for name in self.fitted_expressions]
        return np.concatenate(known).astype(np.float64)

    @cached_property
    def inside_of_mouth(self) -> np.ndarray:
        """Colours (v, 3) of what lies in the mouth, relative to the skin's; NaN elsewhere."""
        colours = np.full((len(self.heads.vertices), 3), np.nan)
        for part, colour in ((MOUTH_SOCKET, GUMS_COLOUR), (GUMS_AND_TONGUE, GUMS_COLOUR), (TEETH, TEETH_COLOUR)):
            colours[part] = colour
        return colours

    @cached_property
    def triangles(self) -> np.ndarray:
        """Triangles (m, 3) of face, mouth and eyes."""
        used = np.zeros(len(self.heads.vertices), bool)
        used[NARROW] = True
        used[MOUTH_SOCKET.start :] = True
        return self.heads.triangles[used[self.heads.triangles].all(axis=1)]

    @cached_property
    def skin_triangles(self) -> np.ndarray:
        """Triangles (m, 3) of face, head and neck."""
        return self.heads.triangles[(self.heads.triangles < SKIN.stop).all(axis=1)]


@dataclass(frozen=True)
class Pose:
    """How a head is turned from where it is in a photograph: to the right of the picture, upwards, and clockwise.

    Angles in radians; ``distance`` is that of the camera from the middle of the head, centimetres.
    """

    yaw: float = 0.0
    pitch: float = 0.0
    roll: float = 0.0
    distance: float = 200.0


@dataclass(frozen=True, eq=False)
class FittedHead:
    """A head that is fitted to landmarks, seen from far away.

    Attributes
    ----------
    unit : float
        Pixels per centimetre.
    turn : (3, 3) float64
        Its rotation.
    vertices : (v, 3) float64
        Pixels, and nearness in pixels.
    strengths : dict of str to float
        Strengths of its expressions.
    """

    unit: float
    turn: np.ndarray
    vertices: np.ndarray
    strengths: dict[str, float]


class Portrait:
    """A frontal photograph on a head.

    Parameters
    ----------
    scheme : Scheme
    image : (h, w, 3) uint8
        A face before the background of a studio.
    points : (n, 2) float64
        Its landmarks.
    """

    def __init__(self, scheme: Scheme, image: np.ndarray, points: np.ndarray) -> None:
        self.scheme = scheme
        self.image = image
        self.points = points
        self.head = fitted_head(scheme, points)
        self._centre = np.append(
            self.head.vertices[scheme.heads.landmarks[EYES], :2].mean(axis=0), self.head.vertices[SKIN, 2].mean()
        )
        behind = background(image)
        colour = image[behind].mean(axis=0) if behind.any() else image[0].mean(axis=0)
        far = cv2.erode(behind.astype(np.uint8), np.ones((2 * RIM + 1, 2 * RIM + 1), np.uint8)) > 0
        self._wall = np.where(far[..., None], image, np.rint(colour).astype(image.dtype))
        self._around, self._triangles_around = self._surface_around(behind)
        self._attributes = np.concatenate([self._attributes_of_head(), _attributes_around(self._around)])

    def seen(self, pose: Pose, change: Mapping[str, float] | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Return a picture (h, w, 3) uint8 of the face, cropped, and its landmarks (n, 2).

        ``change`` are strengths of expressions, such as ``jawOpen``, that are added to those of the photograph.
        """
        vertices = self._with_expression(change or {})
        head = self._turned(vertices, pose)
        around = self._turned(self._around, pose)
        points = self._landmarks(vertices, head)
        margin = AROUND * diagonal_of(points)
        size = np.array(self.image.shape[1::-1])
        low = np.clip(points.min(axis=0) - margin, 0, size - 1).astype(int)
        width, height = (np.clip(points.max(axis=0) + margin, 0, size - 1).astype(int) + 1 - low).tolist()
        triangles = np.concatenate([self.scheme.triangles, self._triangles_around + len(head)])
        screen = np.concatenate([head, around]) - [*low, 0.0]
        drawn, covered = draw(screen, triangles, self._attributes, height, width)
        x, y, shown = (np.ascontiguousarray(each, np.float32) for each in np.moveaxis(drawn[..., :3], -1, 0))
        photograph = cv2.remap(self.image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        surface = shown[..., None] * photograph + (1.0 - shown[..., None]) * drawn[..., 3:]
        wall = self._wall[low[1] : low[1] + height, low[0] : low[0] + width]
        picture = np.where(covered[..., None], surface, wall)
        return np.rint(np.clip(picture, 0.0, 255.0)).astype(np.uint8), points - low

    def _attributes_of_head(self) -> np.ndarray:
        """Return of each vertex where the photograph shows it, how much of the photograph it has, and its own colour.

        (v, 6) float64. What the photograph hides of the skin looks like the nearest skin that it shows.
        """
        vertices = self.head.vertices
        height, width = self.image.shape[:2]
        nearness, covered = draw(vertices, self.scheme.heads.triangles, vertices[:, 2:], height, width)
        column = np.clip(np.rint(vertices[:, 0]).astype(int), 0, width - 1)
        row = np.clip(np.rint(vertices[:, 1]).astype(int), 0, height - 1)
        in_front = nearness[row, column, 0] - vertices[:, 2] < HIDDEN * self.head.unit
        is_seen = covered[row, column] & in_front
        texture = vertices[:, :2].copy()
        seen = np.flatnonzero(is_seen[NARROW])
        hidden = np.flatnonzero(~is_seen[NARROW])
        places = self.scheme.with_open_mouth
        lids = KDTree(places[self.scheme.heads.landmarks[EYES]])
        plain = seen[lids.query(places[seen])[0] > LASHES]
        texture[hidden] = texture[plain[KDTree(places[plain]).query(places[hidden])[1]]]
        skin = np.median(self.image[row[seen], column[seen]], axis=0)
        inside = self.scheme.inside_of_mouth
        depth = np.maximum(vertices[self.scheme.heads.landmarks[LIPS], 2].mean() - vertices[:, 2], 0.0)
        colours = np.nan_to_num(inside * skin) * np.exp(-depth / (DEEP * self.head.unit))[:, None]
        from_photograph = np.isnan(inside[:, 0]) | is_seen
        return np.column_stack([texture, from_photograph, colours])

    def _surface_around(self, behind: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the vertices (n, 3) and triangles (m, 3) around the face, but not where only background is."""
        vertices = self.head.vertices
        height, width = self.image.shape[:2]
        of_skin = np.ascontiguousarray(vertices[SKIN])
        depths, covered = draw(of_skin, self.scheme.skin_triangles, of_skin[:, 2:], height, width)
        _, face = draw(vertices, self.scheme.triangles, vertices[:, 2:], height, width)
        nearest = distance_transform_edt(~covered, return_distances=False, return_indices=True)
        smooth = cv2.GaussianBlur(depths[..., 0][tuple(np.array(nearest))], (0, 0), STEP)
        rows = np.arange(0, height, STEP)
        columns = np.arange(0, width, STEP)
        places = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2).astype(np.float64)
        at = smooth[np.ix_(rows, columns)].ravel() - BEHIND * self.head.unit
        within = cv2.distanceTransform(face.astype(np.uint8), cv2.DIST_L2, 3) > OVERLAP
        return np.column_stack([places, at]), _triangles(~(behind | within)[np.ix_(rows, columns)])

    def _with_expression(self, change: Mapping[str, float]) -> np.ndarray:
        """Return the vertices (v, 3) with other strengths of expressions."""
        vertices = self.head.vertices
        for name, added in change.items():
            before = self.head.strengths.get(name, 0.0)
            moved = self.scheme.heads.expressions[name].astype(np.float64) @ self.head.turn.T
            vertices = vertices + (np.clip(before + added, 0.0, 1.0) - before) * self.head.unit * moved * UPRIGHT
        return vertices

    def _turned(self, at: np.ndarray, pose: Pose) -> np.ndarray:
        """Turn positions (n, 3) about the middle of the head, as the camera sees them."""
        turn = rotation(pose.yaw, -pose.pitch, -pose.roll)
        moved = ((at - self._centre) * UPRIGHT) @ turn.T * UPRIGHT
        away = pose.distance * self.head.unit
        moved[:, :2] *= ((away - FACE_DEPTH * self.head.unit) / (away - moved[:, 2]))[:, None]
        return moved + self._centre

    def _landmarks(self, vertices: np.ndarray, head: np.ndarray) -> np.ndarray:
        """Return the landmarks (n, 2) on a turned head; those of the jaw that the face hides move to its outline."""
        carriers = self.scheme.carriers
        points = head[carriers, :2].copy()
        line = vertices[carriers[self.scheme.jaw], :2]
        along = np.gradient(line, axis=0)
        outward = np.column_stack([-along[:, 1], along[:, 0]]) / np.linalg.norm(along, axis=1, keepdims=True)
        outward *= np.sign(((line - vertices[carriers, :2].mean(axis=0)) * outward).sum(axis=1, keepdims=True))
        face = head[self._within_landmarks, :2]
        for i, normal in zip(self.scheme.jaw, outward, strict=True):
            apart = face - points[i]
            near = np.abs(apart @ [-normal[1], normal[0]]) < STRIP * self.head.unit
            points[i] += float((apart[near] @ normal).max(initial=0.0)) * normal
        return points

    @cached_property
    def _within_landmarks(self) -> np.ndarray:
        """The vertices of the face within the hull of the landmarks, by index."""
        hull = Polygon(cv2.convexHull(self.points.astype(np.float32))[:, 0])
        return np.flatnonzero(hull.contains_points(self.head.vertices[NARROW, :2]))


def fitted_head(scheme: Scheme, points: np.ndarray) -> FittedHead:
    """Fit a head to landmarks (n, 2): pose, identity and expression in turn, and smoothly what these leave."""
    mean = scheme.heads.vertices[scheme.carriers].astype(np.float64)
    names = scheme.fitted_expressions
    counts = (N_IDENTITIES, len(names))
    coordinates = np.zeros(len(scheme.basis))
    weights = np.diag(np.sqrt(np.repeat((OF_IDENTITY, OF_EXPRESSION), counts)))
    limits = np.repeat((-MOST_IDENTITY, 0.0), counts), np.repeat((MOST_IDENTITY, 1.0), counts)
    target = points * UPRIGHT[:2]
    for _ in range(ROUNDS):
        shape = mean + np.tensordot(coordinates, scheme.basis, axes=1)
        scale, turn, shift = _pose(shape, target)
        moved = (scheme.basis @ turn.T)[..., :2].reshape(len(coordinates), -1).T
        wanted = ((target - shift) / scale - (mean @ turn.T)[:, :2]).ravel()
        system = np.concatenate([moved, weights])
        coordinates = lsq_linear(system, np.append(wanted, np.zeros(len(coordinates))), limits).x
    strengths = dict(zip(names, coordinates[N_IDENTITIES:].tolist(), strict=True))
    vertices = scheme.heads.shaped(coordinates[:N_IDENTITIES], strengths) @ turn.T * scale
    vertices[:, :2] += shift
    vertices *= UPRIGHT
    places = scheme.with_open_mouth
    left = points - vertices[scheme.carriers, :2]
    vertices[:, :2] += RBFInterpolator(places[scheme.carriers], left, smoothing=SMOOTH, kernel="linear")(places)
    vertices[scheme.carriers, :2] = points
    return FittedHead(scale, turn, vertices, strengths)


def background(image: np.ndarray) -> np.ndarray:
    """Return the mask (h, w) of a studio's background: what is connected to the sides and has their colour."""
    smooth = cv2.GaussianBlur(image, (0, 0), 1.5)
    height, width = image.shape[:2]
    mask = np.zeros((height + 2, width + 2), np.uint8)
    limits = (TOLERANCE,) * 3
    flags = 4 | (1 << 8) | cv2.FLOODFILL_MASK_ONLY | cv2.FLOODFILL_FIXED_RANGE
    for row in (0, height // 3):
        for column in (0, width - 1):
            cv2.floodFill(smooth, mask, (column, row), (0, 0, 0), limits, limits, flags)
    return mask[1:-1, 1:-1] > 0


def _carrier(heads: ScannedHeads, name: str, at: np.ndarray) -> int:
    """Return the vertex of the mean head that is a landmark with a name, which lies at (2,) as seen from the front."""
    if name.endswith("pupil"):
        ball = WHITES[0] if name.startswith("left") else WHITES[1]
        return ball.start + int(np.argmax(heads.vertices[ball, 2]))
    face = heads.vertices[NARROW].astype(np.float64)
    moves_with_jaw = heads.expressions["jawOpen"][NARROW, 1].astype(np.float64) < -0.6
    if "lip" in name:  # their inner edges touch
        allowed = moves_with_jaw if "lower" in name else ~moves_with_jaw
    else:
        allowed = normals_of(heads.vertices.astype(np.float64), heads.triangles)[NARROW, 2] > 0.0
    apart = np.linalg.norm((face * UPRIGHT)[:, :2] - at, axis=1)
    behind = face[:, 2].max() - face[:, 2]
    return int(np.argmin(np.where(allowed, apart + 0.05 * behind, np.inf)))


def _pose(shape: np.ndarray, target: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Return scale, rotation (3, 3) and shift (2,) that bring points (n, 3) onto (n, 2), seen from far away."""
    middle = shape.mean(axis=0)
    goal = target.mean(axis=0)
    linear = np.linalg.lstsq(shape - middle, target - goal, rcond=None)[0].T
    scale = float(np.linalg.norm(linear, axis=1).mean())
    u, _, v = np.linalg.svd(linear, full_matrices=False)
    first, second = u @ v
    turn = np.stack([first, second, np.cross(first, second)])
    return scale, turn, goal - scale * (turn @ middle)[:2]


def _attributes_around(surface: np.ndarray) -> np.ndarray:
    """Return the attributes (n, 6) of the surface around the face, which shows the photograph where it is."""
    return np.column_stack([surface[:, :2], np.ones(len(surface)), np.zeros((len(surface), 3))])


def _triangles(solid: np.ndarray) -> np.ndarray:
    """Return the triangles (m, 3) of a grid of vertices, without those that are not solid."""
    number = np.arange(solid.size).reshape(solid.shape)
    a, b, c, d = number[:-1, :-1], number[:-1, 1:], number[1:, :-1], number[1:, 1:]
    whole = solid[:-1, :-1] & solid[:-1, 1:] & solid[1:, :-1] & solid[1:, 1:]
    a, b, c, d = (each[whole] for each in (a, b, c, d))
    return np.concatenate([np.stack([a, b, c], 1), np.stack([b, d, c], 1)])
