"""Landmarkers of others by name, whose points a fit can start from and a model can be trained with."""

import threading
from collections.abc import Callable

import numpy as np

from liaam.errors import StartError, installing
from liaam.io.files import as_8_bits

_OWN = threading.local()
"""A face mesh for each thread, because it takes one image at a time."""


def face_mesh(image: np.ndarray) -> np.ndarray | None:
    """Return the 478 points of MediaPipe's face mesh on the most certain face of an image.

    It needs ``pip install ".[mediapipe]"`` in a checkout of liaam, which includes the networks; nothing
    is downloaded when it runs.

    Parameters
    ----------
    image : (h, w, 3) uint8, uint16 or float
        Stored sRGB values.

    Returns
    -------
    (478, 2) float64 or None
        Image pixels; None if there is no face.
    """
    if not hasattr(_OWN, "mesh"):
        try:
            from mediapipe.python.solutions.face_mesh import FaceMesh  # type: ignore
        except ImportError as error:
            raise StartError(
                f"MediaPipe's face mesh is not available ({error}); install it with {installing('mediapipe')} "
                "(Python 3.11 or 3.12)"
            ) from error
        _OWN.mesh = FaceMesh(static_image_mode=True, max_num_faces=1, refine_landmarks=True)
    faces = _OWN.mesh.process(np.ascontiguousarray(as_8_bits(image))).multi_face_landmarks
    if not faces:
        return None
    size = np.array(image.shape[1::-1])
    # MediaPipe's coordinates are fractions of the size, from the border of the first pixel.
    return np.array([(point.x, point.y) for point in faces[0].landmark]) * size - 0.5


LANDMARKERS: dict[str, Callable[[np.ndarray], np.ndarray | None]] = {"mediapipe": face_mesh}
"""Landmarkers by name, for ``--points`` and ``--init``."""
