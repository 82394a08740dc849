"""Which pictures: of folders, patterns, files and lists, one at a time, so that there may be any number."""

import glob
import os
from collections.abc import Iterable, Iterator
from pathlib import Path

from liaam.errors import ImageError
from liaam.io import IMAGE_SUFFIXES, RAW_SUFFIXES
from liaam.io.files import existing_file

SUFFIXES = (*IMAGE_SUFFIXES, *RAW_SUFFIXES)


def find_pictures(*sources: str | os.PathLike[str]) -> Iterator[str]:
    """Give the paths of pictures.

    Parameters
    ----------
    *sources : path-like
        Folders, of which all pictures are taken, those of sub-folders too (a folder that may not be read is given in
        their place, so that its row says so); patterns such as ``images/**/left*.png``,
        where ``**`` stands for any folders; or files, whatever they are called. Hidden files and folders are passed
        over.

    Yields
    ------
    str
        A path, as the source names it.

    Raises
    ------
    ImageError
        If a source is not there, or is a folder or pattern without pictures.
    """
    for source in [os.fspath(source) for source in sources]:
        if os.path.isdir(source):  # noqa: PTH112 (a str stays one, as people wrote it)
            found = _in_folder(source)
        elif glob.has_magic(source) and not os.path.lexists(source):
            found = _of_pattern(source)
        else:
            if not os.path.lexists(source):
                existing_file(source, ImageError, "picture")  # says what is wrong
            found = iter([source])  # whatever else is wrong with it is said in its row
        first = next(found, None)
        if first is None:
            raise ImageError(
                f"{source}: there is no picture ({', '.join(SUFFIXES[:9])} …); give a folder of pictures, or a pattern "
                "in quotation marks, such as 'images/**'"
            )
        yield first
        yield from found


def listed_pictures(lines: Iterable[bytes]) -> Iterator[str]:
    """Give the paths of a list, one in each line; a file that is not there becomes a row that says so."""
    for number, line in enumerate(lines):
        path = os.fsdecode(line.removeprefix(b"\xef\xbb\xbf") if number == 0 else line).rstrip("\r\n")
        if path.strip():
            yield path


def _in_folder(folder: str) -> Iterator[str]:
    closed: list[str] = []
    for parent, folders, names in os.walk(folder, onerror=lambda fault: closed.append(fault.filename)):
        folders[:] = [name for name in folders if not name.startswith(".")]
        yield from (os.path.join(parent, name) for name in names if _is_picture(name))  # noqa: PTH118
    yield from closed


def _of_pattern(pattern: str) -> Iterator[str]:
    found = glob.iglob(pattern, recursive=True)  # noqa: PTH207 (Path.glob sorts nothing either, and makes objects)
    yield from (path for path in found if _is_picture(Path(path).name) and not os.path.isdir(path))  # noqa: PTH112
    yield from _closed(pattern)


def _closed(pattern: str) -> Iterator[str]:
    """Folders that a pattern leads into and that may not be read, which glob passes over."""
    told: set[str] = set()
    folders = pattern if pattern.endswith("**") else os.path.dirname(pattern)  # noqa: PTH120
    while folders and folders.rstrip(os.sep):
        for folder in glob.iglob(os.path.join(folders, ""), recursive=True):  # noqa: PTH118, PTH207
            folder = folder.rstrip(os.sep)
            if folder not in told and not _may_be_listed(folder):
                told.add(folder)
                yield folder
        folders = os.path.dirname(folders)  # noqa: PTH120


def _may_be_listed(folder: str) -> bool:
    try:
        os.scandir(folder).close()
    except OSError:
        return False
    return True


def _is_picture(name: str) -> bool:
    return not name.startswith(".") and name.lower().endswith(SUFFIXES)
