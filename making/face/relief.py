"""The surface of a face for relighting: normals of a scanned head on the mean shape of a model.

``python -m making.face.relief FACES-CC HEADS``, from the checkout's root, gives the face model its relief without
training it again. ``making.face.build`` says what FACES-CC and HEADS are.
"""

import argparse
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from liaam.model import load_model
from liaam.model.light_basis import SIDE, in_field
from liaam.models import FACE, model_file
from liaam.training.lamps.learning import unit_shape
from making.face.portraits import UPRIGHT, Scheme, fitted_head
from making.head.geometry import normals_of
from scenes.raster import draw

FINER = 4
"""Samples per pixel of the relief and axis."""

SMOOTH = 0.7
"""Standard deviation of the blur of normals, pixels of the relief: light is scattered in skin, and eyes are not balls
of plaster."""

AROUND = 6.0
"""Standard deviation of the blur of what goes on around the head, pixels of the relief."""

EVEN = 0.05
"""Weight of an even surface there, which tells far from the head."""


def main() -> None:
    """Write the face model with its relief."""
    from making.face.build import on_heads

    parser = argparse.ArgumentParser(description=str(__doc__).partition("\n")[0])
    parser.add_argument("folder", type=Path, help="folder with london, smiling, canada and composite")
    parser.add_argument("heads", type=Path, help="ict-face.safetensors")
    given = parser.parse_args()
    model = load_model(model_file(FACE))
    relief = relief_on(on_heads(given.heads, given.folder), unit_shape(model.shape_model.mean))
    replace(model, relief=relief).save(model_file(FACE))


def relief_on(scheme: Scheme, shape: np.ndarray) -> np.ndarray:
    """Return the relief (SIDE, SIDE, 2) float32 of a head with landmarks (n, 2) with the box's centre at 0, diagonal 1.

    Around the head, it becomes even.
    """
    at = FINER * (in_field(shape).astype(np.float64) + 0.5) - 0.5
    vertices = fitted_head(scheme, at).vertices
    triangles = scheme.heads.triangles
    normals = normals_of(vertices * UPRIGHT, triangles) * UPRIGHT
    drawn, covered = draw(vertices, triangles, normals, FINER * SIDE, FINER * SIDE)
    with_share = np.dstack([drawn, covered]).astype(np.float32)
    small = cv2.resize(with_share, (SIDE, SIDE), interpolation=cv2.INTER_AREA)
    far = cv2.GaussianBlur(small, (0, 0), AROUND) + EVEN * np.array([0.0, 0.0, 1.0, 1.0], np.float32)
    share = small[..., 3:]
    smooth = cv2.GaussianBlur(small[..., :3] + (1.0 - share) * far[..., :3] / far[..., 3:], (0, 0), SMOOTH)
    smooth /= np.linalg.norm(smooth, axis=2, keepdims=True)
    return np.ascontiguousarray(smooth[..., :2])


if __name__ == "__main__":
    main()
