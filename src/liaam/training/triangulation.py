"""The mesh of a model: given, or a triangulation of its landmarks.

Poses of some objects fold a mesh of all landmarks, such as those of animals whose legs cross. Of the triangles that the
landmarks of some training image form, those are chosen that no pose turns over, the least deformed first, unless others
cover most of them. Where parts of the object move against each other, no triangle spans the gap, and the mesh is in
pieces. Landmarks without a triangle, as of a leg that lies behind another on the mean shape, have no appearance of
their own: their positions follow from the others, and from the model's regressor if it has one.
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from liaam.errors import TrainingError
from liaam.io.files import count_of, some_names
from liaam.model.mesh import FOLD_TOLERANCE, barycentric, delaunay, signed_areas, triangles_from_edges
from liaam.model.shape import aligned_to
from liaam.training.entries import TrainingData, folded_shares

# Least number of images that fold the mesh, and their least share, from which on they are taken for poses of the object
# and not for faults of the landmarks
LEAST_POSES = 2
MANY = 0.05
LEAST_IMAGES = 8  # Least number of images that tell poses from faults
MOST_OUTSIDE = 0.5  # Largest share of the landmarks that may belong to no triangle
FAULTY = 0.5  # Share of the mesh's area beyond which it is no pose: landmarks in another order, or a mirrored image
MOST_TURNED = 0.05  # Largest share of images that turn a triangle over
MOST_DEFORMED = 1.0  # Largest root mean square of the logarithm of the ratio of stretches
FARTHEST = 5.0  # Largest such logarithm that is counted, and that of triangles that are turned over
LEAST_AREA = 1e-4  # Least area on the mean shape, relative to the largest triangle
# Largest share of a triangle that those chosen before may cover on the mean shape, where parts that cross overlap
MOST_COVERED = 0.1
NEIGHBOURS = 3  # Number of landmarks that may be of one part with another, whose distances from it vary least
# Barycentric weights of points inside a triangle, evenly spaced, (k, 3)
INSIDE = np.array([(i + 1 / 3, j + 1 / 3, 9 - i - j + 1 / 3) for i in range(10) for j in range(10 - i)]) / 10.0


@dataclass(frozen=True, eq=False)
class MeshOfLandmarks:
    """A mesh of landmarks.

    Attributes
    ----------
    triangles : (t, 3) int32
        All of positive area on the mean shape.
    folding : tuple of str
        Names of the samples whose poses fold a mesh of all landmarks, for which the mesh leaves out triangles.
    """

    triangles: np.ndarray
    folding: tuple[str, ...] = ()

    @property
    def in_pieces(self) -> bool:
        """Whether the mesh leaves out triangles that poses turn over (:attr:`liaam.AAM.in_pieces`)."""
        return bool(self.folding)

    def describe(self, n_images: int, landmark_names: Sequence[str], n_points: int) -> str:
        """Say why triangles are left out, and which landmarks belong to none."""
        outside = np.setdiff1d(np.arange(n_points), self.triangles).tolist()
        names = [str(landmark_names[i]) if landmark_names else str(i + 1) for i in outside]
        lacking = f"; none is left around landmark {some_names(names, 20)}" if names else ""
        return (
            f"{len(self.folding)} of {count_of(n_images, 'image')} would fold a mesh of all landmarks "
            f"({some_names(list(self.folding), 5)}), which is taken for their pose: the mesh leaves out triangles that "
            f"poses turn over{lacking}. If points of these images are in another order, correct them ('liaam check' "
            "finds such points)"
        )


def mesh_of(data: TrainingData, mean: np.ndarray, given: np.ndarray | None) -> MeshOfLandmarks:
    """Return the mesh of landmarks, with triangles of positive area on their mean shape (n, 2).

    Its triangles are the given ones, or the landmark files' connectivity if that is a mesh, or the Delaunay
    triangulation; or, if poses fold that, the triangles that keep their orientation in all poses.
    """
    if given is not None:
        return MeshOfLandmarks(_checked(given, mean))
    mesh = triangles_from_edges(mean, data.edges) if len(data.edges) else None
    if mesh is not None:
        return MeshOfLandmarks(mesh)
    triangles = delaunay(mean)
    shares = folded_shares(data.entries, mean, triangles)
    are_folded = shares > FOLD_TOLERANCE
    posed = [entry.points for entry, share in zip(data.entries, shares, strict=True) if share <= FAULTY]
    if are_folded.sum() < max(LEAST_POSES, MANY * len(shares)) or len(posed) < LEAST_IMAGES:
        return MeshOfLandmarks(triangles)
    steady = steady_triangles(aligned_to(mean, np.array(posed)), mean)
    if len(np.unique(steady)) < (1.0 - MOST_OUTSIDE) * len(mean):
        return MeshOfLandmarks(triangles)
    are_still_folded = folded_shares(data.entries, mean, steady) > FOLD_TOLERANCE
    helped = np.flatnonzero(are_folded & ~are_still_folded)
    if len(helped) <= int((are_still_folded & ~are_folded).sum()):
        return MeshOfLandmarks(triangles)
    return MeshOfLandmarks(steady, tuple(data.entries[i].name for i in helped.tolist()))


def _checked(given: np.ndarray, mean: np.ndarray) -> np.ndarray:
    """Return triangles that a user gives, (t, 3) int32, in the orientation of the mean shape."""
    triangles = np.asarray(given)
    has_form = triangles.ndim == 2 and triangles.shape[1] == 3 and triangles.dtype.kind in "iu" and len(triangles) > 0
    if not has_form or triangles.min() < 0 or triangles.max() >= len(mean):
        raise TrainingError(f"triangles must be (t, 3) integers from 0 to {len(mean) - 1}")
    triangles = triangles.astype(np.int32)
    # Triangles may be given in either orientation, as long as it is the same for all.
    are_reversed = (signed_areas(mean, triangles) < 0).mean() > 0.5
    return triangles[:, ::-1].copy() if are_reversed else triangles


def steady_triangles(shapes: np.ndarray, mean: np.ndarray) -> np.ndarray:
    """Choose triangles that no pose turns over, (t, 3) int32, of positive area on the mean; there may be none.

    Parameters
    ----------
    shapes : (m, n, 2) float64
        Landmarks of the images, aligned to the mean.
    mean : (n, 2) float64
        Mean shape.
    """
    triangles = _candidates([mean, *shapes])
    areas_of_mean = signed_areas(mean, triangles)
    triangles = np.where((areas_of_mean < 0)[:, None], triangles[:, ::-1], triangles)
    are_turned = np.array([signed_areas(shape, triangles) <= 0 for shape in shapes])
    deformation = _deformations(shapes, triangles)
    areas_of_mean = np.abs(areas_of_mean)
    may_be_used = (
        (are_turned.mean(axis=0) <= MOST_TURNED)
        & (deformation <= MOST_DEFORMED)
        & (areas_of_mean > LEAST_AREA * areas_of_mean.max())
    )
    # Limits of model files
    most = 2 * len(mean)
    box = float(np.prod(np.ptp(mean, axis=0)))
    area = 0.0
    chosen: list[int] = []
    for i in np.argsort(deformation, kind="stable").tolist():
        if len(chosen) == most or not may_be_used[i] or area + areas_of_mean[i] > box:
            continue
        if _covered_share(mean[triangles[i]], mean[triangles[chosen]]) <= MOST_COVERED:
            chosen.append(i)
            area += areas_of_mean[i]
    return triangles[chosen].astype(np.int32)


def _candidates(shapes: list[np.ndarray]) -> np.ndarray:
    """Triangles of the Delaunay triangulations of all shapes, and of each landmark's own part, each once, (t, 3).

    Where parts meet, the triangulation of all landmarks may have no triangle within a part.
    """
    triangles = []
    for shape in shapes:
        with suppress(TrainingError):  # all landmarks on one line
            triangles.append(delaunay(shape))
    mean = shapes[0]
    for part in _rigid_neighbours(np.array(shapes[1:])):
        with suppress(TrainingError):
            triangles.append(part[delaunay(mean[part])])
    return np.unique(np.sort(np.concatenate(triangles), axis=1), axis=0)


def _rigid_neighbours(shapes: np.ndarray) -> np.ndarray:
    """Return each landmark and those whose distances from it vary least over shapes (m, n, 2), (n, 1 + NEIGHBOURS)."""
    distances = np.linalg.norm(shapes[:, :, None] - shapes[:, None], axis=-1)
    logarithms = np.log(np.maximum(distances, 1e-9))
    first, second = np.triu_indices(shapes.shape[1], 1)
    logarithms -= np.median(logarithms[:, first, second], axis=1)[:, None, None]  # sizes of the shapes
    variation = logarithms.std(axis=0)
    np.fill_diagonal(variation, -1.0)
    return np.argsort(variation, axis=1, kind="stable")[:, : 1 + NEIGHBOURS]


def _deformations(shapes: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Root mean square deformation of triangles over shapes (m, n, 2), from their median form, (t,).

    That is the logarithm of the ratio of the two stretches that map one onto the other. It is the hyperbolic distance
    of their shape coordinates (c - a) / (b - a) as complex numbers (Bookstein, Statistical Science 1986).
    """
    points = shapes[..., 0] + 1j * shapes[..., 1]
    a, b, c = (points[:, triangles[:, i]] for i in range(3))
    with np.errstate(divide="ignore", invalid="ignore"):
        forms = (c - a) / (b - a)
    usual = np.nanmedian(forms.real, axis=0) + 1j * np.nanmedian(forms.imag, axis=0)
    heights = forms.imag * usual.imag
    are_same_way_up = np.isfinite(forms) & (heights > 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        distances = np.arccosh(1.0 + np.abs(forms - usual) ** 2 / (2.0 * heights))
    distances = np.where(are_same_way_up, np.minimum(distances, FARTHEST), FARTHEST)
    return np.sqrt(np.square(distances).mean(axis=0))


def _covered_share(triangle: np.ndarray, others: np.ndarray) -> float:
    """Return the share of a triangle (3, 2) that others (k, 3, 2) cover, by points inside it, 0 to 1."""
    points = INSIDE @ triangle
    covered = np.zeros(len(points), bool)
    are_near = (others.min(axis=1) < triangle.max(axis=0)) & (others.max(axis=1) > triangle.min(axis=0))
    for other in others[are_near.all(axis=1)]:
        covered |= (barycentric(points, other) >= 0).all(axis=1)
    return float(covered.mean())
