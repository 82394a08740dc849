"""The geometry of heads: a mean head from light-stage scans, its identities and its expressions.

The file is ``ict-face.safetensors``, the light version of the ICT face model (Li et al., *Learning Formation of
Physically-Based Face Attributes*, CVPR 2020), under the MIT licence: see LICENSE-DATA. Lengths are centimetres; x
points to the person's left, y up, z towards the camera.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from safetensors import safe_open

N_LANDMARKS = 68
"""The landmarks are those of iBUG, in its order."""

EXTREME = 2.0
"""Largest size of an identity's coordinate, standard deviations: scans of grown-ups hardly go further."""

FACE = slice(0, 9409)
HEAD_AND_NECK = slice(9409, 11248)
MOUTH_SOCKET = slice(11248, 13294)
GUMS_AND_TONGUE = slice(14062, 17039)
TEETH = slice(17039, 21451)
WHITES = (slice(21451, 22221), slice(23021, 23791))
"""Vertices of parts; those of an eye are the whole ball."""


@dataclass(frozen=True, eq=False)
class ScannedHeads:
    """A mean head, and how heads and their expressions differ from it.

    Attributes
    ----------
    vertices : (n, 3) float32
        The mean neutral head.
    triangles : (m, 3) int32
    identities : (100, n, 3) float16
        Displacement by one standard deviation of each principal component.
    expressions : mapping of str to (n, 3) float16
        Displacement of each expression at its full strength, by ARKit's names, such as ``jawOpen``.
    landmarks : (68,) int32
        Vertices of iBUG's landmarks.
    """

    vertices: np.ndarray
    triangles: np.ndarray
    identities: np.ndarray
    expressions: Mapping[str, np.ndarray]
    landmarks: np.ndarray

    def shaped(self, identity: np.ndarray, expression: Mapping[str, float] | None = None) -> np.ndarray:
        """Return the vertices (n, 3) float64 of a head.

        Parameters
        ----------
        identity : (k,) float, k up to 100
            Coordinates of the principal components, in standard deviations.
        expression : mapping of str to float, optional
            Strengths of expressions, 0 to 1. The neutral face by default.
        """
        known = self.identities[: len(identity)].astype(np.float64)
        vertices = self.vertices + np.tensordot(identity, known, axes=1)
        for name, strength in (expression or {}).items():
            vertices = vertices + strength * self.expressions[name]
        return vertices


def load_heads(path: Path) -> ScannedHeads:
    """Read the file of heads."""
    with safe_open(path, "np") as file:
        names = file.metadata()["expressions"].split(",")
        return ScannedHeads(
            file.get_tensor("vertices"),
            file.get_tensor("triangles"),
            file.get_tensor("identities"),
            dict(zip(names, file.get_tensor("expressions"), strict=True)),
            file.get_tensor("landmarks_68"),
        )


def random_identity(rng: np.random.Generator, n: int = 100) -> np.ndarray:
    """Draw the coordinates (n,) of a head."""
    return np.clip(rng.normal(size=n), -EXTREME, EXTREME)


def normals_of(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Return the unit normals (n, 3) of a surface at its vertices: means of the triangles' normals, by their area."""
    corners = vertices[triangles]
    crossed = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.zeros_like(vertices)
    for corner in range(3):
        np.add.at(normals, triangles[:, corner], crossed)
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
