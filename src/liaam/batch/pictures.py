"""Iterate over the images of folders, patterns, files and lists."""

import errno
import fnmatch
import glob
import os
import warnings
from collections.abc import Callable, Iterable, Iterator
from itertools import takewhile
from pathlib import Path

from liaam.errors import ImageError
from liaam.io.files import existing_file
from liaam.io.images import PICTURE_SUFFIXES, USUAL_SUFFIXES
from liaam.io.overlays import is_overlay


def find_pictures(*sources: str | os.PathLike[str], on_closed: Callable[[str], object] | None = None) -> Iterator[str]:
    """Iterate over the paths of images.

    Parameters
    ----------
    *sources : path-like
        Folders, searched with their subfolders; patterns such as ``images/**/left*.png``, where ``**`` matches any
        folders; or files with any name. Hidden files and folders are skipped, and so are overlays of fits and scales.
    on_closed : callable, optional
        Called with each folder that is skipped because it cannot be read. Default: issue a warning.

    Yields
    ------
    str
        A path, absolute or relative as in the source.

    Raises
    ------
    ImageError
        If a source does not exist, cannot be read, or is a folder or pattern without images, or with overlays only.
    """
    on_closed = on_closed or _warn
    for source in [os.fspath(source) for source in sources]:
        if os.path.isdir(source):  # noqa: PTH112 (keeps the text unchanged)
            found = _in_folder(source, on_closed)
        elif glob.has_magic(source) and not os.path.lexists(source):
            found = _of_pattern(source, on_closed)
        else:
            if not os.path.lexists(source):
                existing_file(source, ImageError, "image")  # raises
            yield source  # its row reports other faults
            continue
        pictures = _without_overlays(found, source)
        first = next(pictures, None)
        if first is None:
            raise ImageError(
                f"{source}: no images ({USUAL_SUFFIXES}); give a folder of images, or a quoted "
                "pattern such as 'images/**'"
            )
        yield first
        yield from pictures


def listed_pictures(lines: Iterable[bytes]) -> Iterator[str]:
    """Iterate over the paths of a list with one path per line. A missing file becomes a row with an error."""
    for number, line in enumerate(lines):
        path = os.fsdecode(line.removeprefix(b"\xef\xbb\xbf") if number == 0 else line).rstrip("\r\n")
        if path.strip():
            yield path


def _without_overlays(pictures: Iterable[str], source: str) -> Iterator[str]:
    """Yield the pictures of a source that are no overlays; raise an ImageError if all are."""
    n_overlays = n_yielded = 0
    for picture in pictures:
        if is_overlay(Path(picture)):
            n_overlays += 1
            continue
        n_yielded += 1
        yield picture
    if n_overlays and not n_yielded:
        raise ImageError(
            f"{source}: its images are overlays of earlier fits or scales; give the folder of the images themselves"
        )


def _warn(folder: str) -> None:
    warnings.warn(f"skipped {folder}: it cannot be read; check its permissions", stacklevel=3)


def _in_folder(folder: str, on_closed: Callable[[str], object]) -> Iterator[str]:
    try:
        os.scandir(folder).close()
    except OSError as fault:
        raise ImageError(f"{folder} cannot be read ({fault.strerror or fault}): check its permissions") from fault
    for parent, folders, names in os.walk(folder, onerror=lambda fault: on_closed(fault.filename)):
        folders[:] = [name for name in folders if not name.startswith(".")]
        yield from (os.path.join(parent, name) for name in names if _is_picture(name))  # noqa: PTH118


def _of_pattern(pattern: str, on_closed: Callable[[str], object]) -> Iterator[str]:
    """Iterate over the images that match a pattern, listing each folder once."""
    parts = pattern.split(os.sep)  # noqa: PTH206 (keeps the beginning of the path unchanged)
    fixed = [*takewhile(lambda part: not glob.has_magic(part), parts)]
    parts = [part for part in parts[len(fixed) : -1] if part] + parts[-1:]
    todo = [(os.sep.join([*fixed, ""]), {0})]  # noqa: PTH118
    while todo:
        folder, places = todo.pop()
        # Positions in the pattern that entries of this folder can match; '**' may also match no folder.
        for place in range(len(parts) - 1):
            if place in places and parts[place] == "**":
                places.add(place + 1)
        for entry in _entries(folder, on_closed):
            met = {place for place in places if _matches(entry.name, parts[place])}
            if not _is_folder(entry):
                if len(parts) - 1 in met and _is_picture(entry.name):
                    yield folder + entry.name
                continue
            below = {place if parts[place] == "**" else place + 1 for place in met} - {len(parts)}
            if below:
                todo.append((os.path.join(folder, entry.name, ""), below))  # noqa: PTH118


def _entries(folder: str, on_closed: Callable[[str], object]) -> "list[os.DirEntry[str]]":
    try:
        with os.scandir(folder or ".") as entries:
            return list(entries)
    except OSError as fault:
        if fault.errno not in (errno.ENOENT, errno.ENOTDIR):
            on_closed(folder.rstrip(os.sep) or folder)
        return []


def _matches(name: str, part: str) -> bool:
    if name.startswith(".") and not part.startswith("."):
        return False
    return part == "**" or fnmatch.fnmatch(name, part)


def _is_folder(entry: "os.DirEntry[str]") -> bool:
    """Whether an entry is a folder to search. A link to a folder that contains it would never end."""
    if not entry.is_dir() or not entry.is_symlink():
        return entry.is_dir()
    here, there = (Path(os.path.realpath(path)) for path in (Path(entry.path).parent, entry.path))
    return not here.is_relative_to(there)


def _is_picture(name: str) -> bool:
    return not name.startswith(".") and name.lower().endswith(PICTURE_SUFFIXES)
