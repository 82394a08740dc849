"""Helpers shared by file readers: existence checks with suggestions, natural sort order, parsing of cells, pixels."""

import difflib
import hashlib
import json
import math
import os
import re
import unicodedata
from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from liaam.errors import ImageError, LiaamError, missing

AnyPath = str | os.PathLike[str]
MAX_PIXELS = 200_000_000  # default limit on width x height. Larger images are rejected before decoding
MAX_PIXELS_VARIABLE = "LIAAM_MAX_PIXELS"  # environment variable of another limit


# What file managers put behind the name of a copy.
_COPY = re.compile(
    r"(?:[ _]\(\d{1,3}\)|[ _]?-[ _]?(?:copy|kopie|copie|copia)(?: \(\d+\))?|[ _]copy(?: \d+)?|~)\Z", re.I
)


def natural_key(text: str) -> list[Any]:
    """Return a case-insensitive sort key that puts ``img2`` before ``img10``."""
    words = re.split(r"([0-9]+)", text.casefold())  # every second one is a number, perhaps too long for int
    numbers = ((len(digits), digits) for digits in (word.lstrip("0") for word in words[1::2]))
    return [*chain.from_iterable(zip(words[::2], numbers, strict=False)), words[-1]]


def is_copy(path: Path) -> bool:
    """Return whether a file has the name of a copy of another, such as ``all (1).tps`` or ``all - Copy.tps``."""
    return _COPY.search(path.stem) is not None


def name_key(name: str) -> str:
    """Return a key that is equal for names that differ in case, or in composed and decomposed letters, only."""
    return unicodedata.normalize("NFC", unicodedata.normalize("NFC", name).casefold())


def some_names(names: Sequence[str], most: int = 6, joint: str = ", ") -> str:
    """Join the first names, and add the number of the rest. A single further name is as short as its number."""
    n = most if len(names) > most + 1 else len(names)
    return joint.join(names[:n]) + (f" and {len(names) - n} more" if len(names) > n else "")


def count_of(number: int, what: str) -> str:
    """Return a number and what it counts, in the plural unless it is 1."""
    return f"{number} {what}" if number == 1 else f"{number} {what}s"


def is_number(cell: Any) -> bool:
    """Return whether a table cell, or a value of JSON, holds a finite number."""
    try:
        return math.isfinite(float(cell))
    except (TypeError, ValueError, OverflowError):
        return False


def writable(text: str) -> str:
    """Replace lone surrogates, which JSON may hold but files and terminals cannot encode."""
    return text.encode("utf-8", "replace").decode("utf-8")


def real_path(path: AnyPath) -> Path:
    """Resolve links, as far as they lead anywhere; unlike :meth:`Path.resolve`, takes links that lead in a circle."""
    return Path(os.path.realpath(path))


def is_file(path: Path) -> bool:
    """Return whether a path is that of a file. A name that is longer than files may have is not."""
    try:
        return path.is_file()
    except OSError:
        return False


_LETTERS = str.maketrans("0123456789abcdef", "abcdefghijklmnop")


def fingerprint_of(path: AnyPath) -> str:
    """Return 16 letters that are the same for files of the same content only, or nothing if the file cannot be read.

    They are letters because spreadsheets take some texts with digits for numbers.
    """
    try:
        with Path(path).open("rb") as file:
            digest = hashlib.file_digest(file, lambda: hashlib.blake2b(digest_size=8))
    except (OSError, ValueError):
        return ""
    return digest.hexdigest().translate(_LETTERS)


def existing_file(path: AnyPath, error: type[LiaamError], kind: str) -> Path:
    """Return the path of a file of a kind, such as "image". Raise if it is missing, a folder, empty or not readable."""
    path = Path(path)
    there = True
    try:
        there = path.exists()
        if path.is_dir():
            os.scandir(path).close()  # report missing permissions first
            fault = f"is a folder; give the name of one {kind} inside it."
        elif not path.is_file():  # reading a pipe or a device could block
            fault = "is not a regular file: give a file on disk."
        else:
            fault = "" if path.stat().st_size else "is empty (0 bytes): copy or export it again."
    except OSError as error_of_disk:  # it exists, in a folder that may not be read
        fault = f"cannot be read ({error_of_disk.strerror or error_of_disk}): check the name and permissions."
    if not there and not path.parent.is_dir():
        raise missing(error)(f"{path} does not exist. The folder {path.parent} does not exist either: check the path.")
    if not there:
        names = [entry.name for entry in path.parent.iterdir() if entry.name != path.name]
        close = " or ".join(difflib.get_close_matches(path.name, names, n=3, cutoff=0.6))
        folder = "the current folder" if path.parent == Path() else path.parent
        hint = f"Did you mean {close}?" if close else f"Nothing in {folder} has a similar name: check the path."
        raise missing(error)(f"{path} does not exist. {hint}")
    if fault:
        raise error(f"{path} {fault}")
    return path


def companions(folder: Path, names: Iterable[str], suffixes: Collection[str]) -> Iterator[Path]:
    """Yield where files of some names, such as the stem of an image, may lie in a folder, the preferred first."""
    for name in names:
        for suffix in suffixes:
            yield folder / f"{name}{suffix}"


def read_bytes(path: Path, error: type[LiaamError], limit: int) -> bytes:
    """Read a file of at most `limit` bytes. Raise `error` if that fails."""
    try:
        check_file_size(path, error, limit, "split it into smaller files")
        with enough_memory(path, error):
            return path.read_bytes()
    except OSError as fault:
        raise error(f"{path} cannot be read ({fault.strerror or fault}): check its permissions.") from fault


def check_file_size(path: Path, error: type[LiaamError], limit: int, remedy: str) -> None:
    """Raise if a file has more than `limit` bytes: some formats would be read to the end before they are refused."""
    if (size := path.stat().st_size) > limit:
        raise error(f"{path} has {size:,} bytes, more than the {limit:,} allowed: {remedy}.")


@contextmanager
def enough_memory(name: object, error: type[LiaamError]) -> Iterator[None]:
    """Raise `error`, which names a file or an image, if the memory does not suffice to read it in the block."""
    try:
        yield
    except MemoryError as fault:
        remedy = "make it smaller, close other programs, or raise the limit on memory"
        raise error(f"{name} is too large for the free memory: {remedy}.") from fault


def json_object(text: str | bytes) -> dict[str, Any] | None:
    """Parse a JSON object. Return None for anything else."""
    try:
        parsed = json.loads(text)
    except (ValueError, TypeError, RecursionError):
        return None
    return parsed if isinstance(parsed, dict) else None


def make_folder(folder: Path) -> None:
    """Create a folder for results and its parents, if missing."""
    if folder.is_file():
        raise LiaamError(f"{folder} is a file, so the folder cannot be created; give another folder with -o")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        why = f"cannot be created ({error.strerror or error})"
        raise LiaamError(f"{folder}: the folder {why}; give another folder with -o") from error
    if not may_write_in(folder):
        raise LiaamError(f"{folder}: the folder is read-only; change its permissions, or give another folder with -o")


def may_write_in(folder: Path) -> bool:
    """Return whether files can be made in an existing folder, as far as its permissions say."""
    return os.access(folder, os.W_OK | os.X_OK)


def check_size(name: object, width: int, height: int, max_pixels: int | None = None) -> None:
    """Raise if an image has too many pixels: by default more than the environment variable LIAAM_MAX_PIXELS allows."""
    given = os.environ.get(MAX_PIXELS_VARIABLE) or str(MAX_PIXELS)
    if max_pixels is None and not given.isdecimal():
        raise ImageError(f"{MAX_PIXELS_VARIABLE}={given} is not a number of pixels: set it, such as to {MAX_PIXELS}.")
    limit = int(given) if max_pixels is None else max_pixels
    if width * height > limit:
        remedy = f"raise max_pixels (for commands, set {MAX_PIXELS_VARIABLE} to {width * height})"
        size = f"{width} x {height} pixels, more than the {limit:,} allowed"
        raise ImageError(f"{name} has {size}: make the image smaller, or {remedy}.")


def as_three_channels(grey: np.ndarray) -> np.ndarray:
    """Stack a grey image (h, w) to three equal channels (h, w, 3)."""
    return np.repeat(grey[:, :, None], 3, axis=2)


def as_8_bits(image: np.ndarray) -> np.ndarray:
    """Convert values of integers up to their largest, or of floats up to 1, to uint8."""
    if image.dtype == np.uint8:
        return image
    top = np.iinfo(image.dtype).max if image.dtype.kind == "u" else 1.0
    return np.clip(np.nan_to_num(image.astype(np.float32)) * (255.0 / top), 0, 255).astype(np.uint8)
