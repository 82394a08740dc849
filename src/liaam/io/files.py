"""What readers of files share: finding them, saying why one cannot be found, natural order, cells of tables."""

from __future__ import annotations

import difflib
import math
import os
import re
from itertools import chain
from pathlib import Path
from typing import Any

from liaam.errors import LiaamError


def natural_key(text: str) -> list[Any]:
    """Give a sort key under which ``img2`` comes before ``img10``, whatever the case of the letters."""
    words = re.split(r"([0-9]+)", text.casefold())  # every other one is a number, of any length: int has a limit
    numbers = ((len(digits), digits) for digits in (word.lstrip("0") for word in words[1::2]))
    return [*chain.from_iterable(zip(words[::2], numbers, strict=False)), words[-1]]


def is_number(text: str) -> bool:
    """Whether a cell of a table holds a finite number."""
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False


def writable(text: str) -> str:
    """Give a text without halves of surrogate pairs, which JSON may hold and no file or terminal can."""
    return text.encode("utf-8", "replace").decode("utf-8")


def existing_file(path: str | os.PathLike[str], error: type[LiaamError], kind: str) -> Path:
    """Check that a file is there and not empty.

    Parameters
    ----------
    path : path-like
        The file asked for.
    error : type of LiaamError
        The class of error to raise.
    kind : str
        What the file should be, for the message: "image", "landmark file" ...

    Returns
    -------
    Path
        The same path.

    Raises
    ------
    LiaamError
        Of class `error`, if the path is missing, a folder, empty, or not accessible.
    """
    path = Path(path)
    try:
        if path.is_dir():
            os.scandir(path).close()  # fails where it may not be read, which is what there is to say then
            raise error(f"{path} is a folder; give the name of one {kind} inside it.")
        if not path.exists():
            raise error(f"{path} does not exist. {_closest(path)}")
        if not path.is_file():  # a pipe or a device could block for ever
            raise error(f"{path} is not an ordinary file: give one on disk.")
        if path.stat().st_size == 0:
            raise error(f"{path} is empty (0 bytes): copy or export it again.")
    except OSError as fault:
        raise error(f"{path} cannot be read ({fault.strerror or fault}): check the name and the rights.") from fault
    return path


def read_bytes(path: Path, error: type[LiaamError], limit: int) -> bytes:
    """Read a whole file of at most `limit` bytes; a fault is raised as `error`."""
    try:
        size = path.stat().st_size
        if size > limit:
            raise error(f"{path} has {size:,} bytes, more than the {limit:,} allowed: split it into smaller files.")
        return path.read_bytes()
    except OSError as fault:
        raise error(f"{path} cannot be read ({fault.strerror or fault}): check the rights on the file.") from fault


def _closest(path: Path) -> str:
    """Say which files of the folder have a similar name."""
    if not path.parent.is_dir():
        return f"The folder {path.parent} does not exist either: check the path."
    names = [entry.name for entry in path.parent.iterdir() if entry.name != path.name]
    close = difflib.get_close_matches(path.name, names, n=3, cutoff=0.6)
    if not close:
        return f"Nothing in {path.parent} has a similar name: check the path."
    return f"Did you mean {' or '.join(close)}?"


def make_folder(folder: Path) -> None:
    """Make a folder for results, or say why it cannot be."""
    if folder.is_file():
        raise LiaamError(f"{folder} is a file, so the folder cannot be made; give another with -o")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise LiaamError(
            f"{folder}: the folder cannot be made ({error.strerror or error}); give another with -o"
        ) from error
