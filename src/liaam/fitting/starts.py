"""Parse the start of a fit: numbers, a landmark file, a folder with a file per image, or another's landmarker."""

import errno
import stat
import threading
from collections.abc import Callable
from pathlib import Path

import numpy as np

from liaam.errors import StartError, installing
from liaam.io.files import as_8_bits, existing_file, read_bytes
from liaam.io.images import read_image
from liaam.io.landmarks import LANDMARK_SUFFIXES, Landmarks, read_landmarks

_SHOWN = 100
"""Maximum number of characters of a start shown in a message."""

BOX_SUFFIX = ".box"
"""Suffix of a text file that holds a detector's box, x0,y0,x1,y1 or x,y,size."""


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


def read_start(text: str, image: Path, size: tuple[int, int]) -> Landmarks | list[float]:
    """Read the start of one image of a size (width, height), in a form that :meth:`liaam.fitting.Fitter.fit` takes.

    The text is a box ``x0,y0,x1,y1``; a centre and a size ``x,y,size``; a landmark file; a text file ``.box`` with such
    numbers; a folder that holds such a file with the image's name; or a name of :data:`LANDMARKERS`.
    """
    path = start_file(text, image)
    if path is not None:
        return _read(path, image, size)
    if text in LANDMARKERS:
        points = LANDMARKERS[text](read_image(image))
        if points is None:
            raise StartError(f"{image.name}: {text} finds nothing in this image; give a box, or leave --init out")
        return Landmarks(points)
    if _kind(text) == "folder":
        raise StartError(f"{image.name}: {Path(text)} holds no landmark file for it; add one such as {image.stem}.pts")
    shown = text if len(text) <= _SHOWN else f"{text[:_SHOWN]}..."
    return _numbers(text, f"--init {shown}: there is no such file or folder, and it")


def start_file(text: str, image: Path) -> Path | None:
    """Return the file that holds the start of an image, or None if there is no such file."""
    path, kind = Path(text), _kind(text)
    if kind == "folder":
        candidates = (path / f"{image.stem}{suffix}" for suffix in (*LANDMARK_SUFFIXES, BOX_SUFFIX))
        return next((candidate for candidate in candidates if _kind(str(candidate)) == "file"), None)
    return path if kind == "file" else None


def check_start(text: str) -> None:
    """Raise if a text cannot be a start for any image: not a file, a folder, or numbers."""
    if not _kind(text) and text not in LANDMARKERS:
        read_start(text, Path(), (1, 1))


def _kind(text: str) -> str:
    """Return "file", "folder" or "other" for an existing path, or else ""."""
    try:
        mode = Path(text).stat().st_mode
    except (FileNotFoundError, NotADirectoryError, ValueError):
        return ""
    except OSError as fault:
        if fault.errno == errno.ENAMETOOLONG:
            return ""
        raise StartError(f"--init: {text} cannot be read ({fault.strerror or fault}): check its permissions") from fault
    return "folder" if stat.S_ISDIR(mode) else "file" if stat.S_ISREG(mode) else "other"


def _read(path: Path, image: Path, size: tuple[int, int]) -> Landmarks | list[float]:
    if path.suffix.lower() != BOX_SUFFIX:
        return read_landmarks(path, size, image.name)
    text = read_bytes(existing_file(path, StartError, "box"), StartError, limit=1000).decode("utf-8-sig", "replace")
    return _numbers(",".join(text.replace(",", " ").split()), f"{path}: it")


def _numbers(text: str, what: str) -> list[float]:
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        raise StartError(f"{what} is neither a box x0,y0,x1,y1 nor x,y,size") from None
    if len(numbers) not in (3, 4):
        raise StartError(
            f"{what.partition(':')[0]}: give four numbers x0,y0,x1,y1 (a box) or three x,y,size, not {len(numbers)}"
        )
    return numbers
