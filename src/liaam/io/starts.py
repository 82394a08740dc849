"""Where fits of image files start, as people say it: numbers, a landmark file, or a folder with a file for each."""

import errno
import stat
from pathlib import Path

from liaam.errors import StartError
from liaam.io.files import existing_file, read_bytes
from liaam.io.landmarks import LANDMARK_SUFFIXES, Landmarks, read_landmarks

_SHOWN = 100
"""Characters of a start that a message shows."""

BOX_SUFFIX = ".box"
"""Ending of a text file that holds a box x0,y0,x1,y1 or x,y,size, as detectors give them."""


def read_start(text: str, image: Path, size: tuple[int, int]) -> Landmarks | list[float]:
    """Read the start of one image.

    Parameters
    ----------
    text : str
        A box ``x0,y0,x1,y1``; a centre and a size ``x,y,size``; a landmark file, or a text file ``.box`` of such
        numbers; or a folder that holds such a file of the image's name.
    image : Path
    size : (int, int)
        Width and height of the image.

    Returns
    -------
    Landmarks or list of float
        A start for :meth:`liaam.fitting.Fitter.fit`.
    """
    path = start_file(text, image)
    if path is not None:
        return _read(path, size)
    if _kind(text) == "folder":
        raise StartError(f"{image.name}: {Path(text)} holds no landmark file for it ({image.stem}.pts or the like)")
    shown = text if len(text) <= _SHOWN else f"{text[:_SHOWN]}..."
    return _numbers(text, f"--init {shown}: there is no such file or folder, and it")


def start_file(text: str, image: Path) -> Path | None:
    """File that the start of an image is read from; None if it is no file, or if none is there."""
    path, kind = Path(text), _kind(text)
    if kind == "folder":
        candidates = (path / f"{image.stem}{suffix}" for suffix in (*LANDMARK_SUFFIXES, BOX_SUFFIX))
        return next((candidate for candidate in candidates if _kind(str(candidate)) == "file"), None)
    return path if kind == "file" else None


def check_start(text: str) -> None:
    """Complain about a start that is none for any image: no file or folder, and no numbers either."""
    if not _kind(text):
        read_start(text, Path(), (1, 1))


def _kind(text: str) -> str:
    """Tell whether a text is the name of a file or a folder; "" if it is neither, or longer than a name can be."""
    try:
        mode = Path(text).stat().st_mode
    except (FileNotFoundError, NotADirectoryError, ValueError):
        return ""
    except OSError as fault:
        if fault.errno == errno.ENAMETOOLONG:
            return ""
        raise StartError(
            f"--init: {text} cannot be looked at ({fault.strerror or fault}): check the rights on it"
        ) from fault
    return "folder" if stat.S_ISDIR(mode) else "file" if stat.S_ISREG(mode) else "other"


def _read(path: Path, size: tuple[int, int]) -> Landmarks | list[float]:
    if path.suffix.lower() != BOX_SUFFIX:
        return read_landmarks(path, size)
    text = read_bytes(existing_file(path, StartError, "box"), StartError, limit=1000).decode("utf-8-sig", "replace")
    return _numbers(",".join(text.replace(",", " ").split()), f"{path}: it")


def _numbers(text: str, what: str) -> list[float]:
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        raise StartError(f"{what} is no box x0,y0,x1,y1 and no x,y,size either") from None
    if len(numbers) not in (3, 4):
        raise StartError(
            f"{what.partition(':')[0]}: give four numbers x0,y0,x1,y1 (a box) or three x,y,size, not {len(numbers)}"
        )
    return numbers
