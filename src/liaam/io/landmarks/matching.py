"""Find the images that landmark files name: on another computer, in another case, encoding or format."""

import re
from collections import defaultdict
from collections.abc import Iterable, Iterator
from contextlib import suppress
from functools import lru_cache
from itertools import takewhile
from pathlib import Path, PurePosixPath, PureWindowsPath
from urllib.parse import unquote

from liaam.io.files import name_key
from liaam.io.images import PICTURE_SUFFIXES, UNREAD_SUFFIXES

# Encodings of names that are tried, because text that is not UTF-8 is read as Latin-1.
CODECS = ("cp1251", "cp1252", "cp1250", "cp932", "gb18030", "big5", "euc_kr", "koi8_r", "cp866", "cp437", "mac_roman")
CASE = "images are named in another case in the landmark file"
EXTENSION = "images are named with another extension in the landmark file"
SPELLING = "images are named in another spelling in the landmark file"

_UPLOADED = r"^[0-9a-f]{8}-(?=.)"  # what Label Studio puts before the names of images that are uploaded
_SUFFIXES = {*PICTURE_SUFFIXES, *UNREAD_SUFFIXES}


class ImageNames:
    """Images by name, given in order of preference where several have one stem."""

    def __init__(self, images: Iterable[Path]) -> None:
        self._by_name, self._by_stem = defaultdict[str, list[Path]](list), defaultdict[str, list[Path]](list)
        for image in images:
            self._by_name[name_key(image.name)].append(image)
            self._by_stem[name_key(image.stem)].append(image)

    def find(self, entry: str, folder: Path = Path()) -> tuple[Path | None, str]:
        """Return the one image that an entry of a file in a folder names, if any, and what to say about the name."""
        for text, spelling in _spellings(entry):
            image, how = self._find(PurePosixPath(text.replace("\\", "/")), folder)
            if image is not None:
                return image, how or spelling
        return None, ""

    def of_file(self, file: Path, stem: str = "") -> Path | None:
        """Return the image beside a landmark file, ``a.pts`` or ``a.png.pts``, if possible in the same case.

        Its stem may be given, as of ``a.mrk.json``.
        """
        stem = stem or file.stem
        key = name_key(stem)
        named = self._by_stem.get(key) or self._by_name.get(key, [])
        beside = [image for image in named if image.parent == file.parent]
        return next((image for image in beside if image.stem == stem), beside[0] if beside else None)

    def _find(self, path: PurePosixPath, folder: Path) -> tuple[Path | None, str]:
        named = self._by_name.get(name_key(path.name), [])
        best = _best(named, path, folder)
        if named:
            cases = best is not None and all(name_key(name) == name.casefold() for name in (best.name, path.name))
            return best, CASE if best is not None and best.name != path.name and cases else ""
        other = path.suffix.lower() in _SUFFIXES
        stem = path.stem if other else path.name
        firsts = {image.parent: image for image in reversed(self._by_stem.get(name_key(stem), []))}
        best = _best(list(firsts.values()), path.parent / stem, folder)
        return best, EXTENSION if other else ""


def _best(images: list[Path], path: PurePosixPath, folder: Path) -> Path | None:
    """Return the image at a path; or the only one; or the one that shares the longest end of the path."""
    exact = [image for image in images if folder / path in (image, image.with_suffix(""))]
    if exact or len(images) < 2:
        return next(iter(exact or images), None)

    def shared(image: Path) -> int:
        pairs = zip(image.parts[-2::-1], path.parts[-2::-1], strict=False)
        return [*(name_key(a) == name_key(b) for a, b in pairs), False].index(False)

    ranked = sorted(images, key=shared, reverse=True)
    return ranked[0] if shared(ranked[0]) > shared(ranked[1]) else None


def names_picture(entry: str) -> bool:
    """Whether a text, perhaps an address, ends as the name of a picture."""
    return PurePosixPath(_path_of(entry)).suffix.lower() in _SUFFIXES


@lru_cache(10_000)  # tables repeat the name in each row
def without_title(name: str) -> str:
    """Return an image's name without what ImageJ adds to it: ``a.png:eye``, ``stack.tif:a.png``."""
    return next((part for part in reversed(re.split(r":(?![\\/])", name)) if names_picture(part)), name)


def stem_of(entry: str) -> str:
    """Return an image's name without folders, its suffix, and what Label Studio puts before it."""
    return re.sub(_UPLOADED, "", PureWindowsPath(_path_of(entry)).stem)


def _shared_parts(paths: Iterable[PureWindowsPath]) -> tuple[str, ...]:
    """Return the parts of the folder that all paths share."""
    folders = [path.parent.parts for path in paths]
    shared = takewhile(lambda parts: len({*parts}) == 1, zip(*folders, strict=False))
    return tuple(parts[0] for parts in shared)


def shared_folder(entries: Iterable[str]) -> str:
    """Return the last part of the folder that all images share, or nothing."""
    parts = _shared_parts(PureWindowsPath(_path_of(entry)) for entry in entries)
    return parts[-1] if parts else ""


def unique_names(entries: Iterable[str]) -> dict[str, str]:
    """Return a name for each image: its stem, or, where several have one stem, as much of its path as tells all apart.

    The names then are the paths below the folder that all share, without suffix, or with it if only that differs.

    Examples
    --------
    >>> unique_names(["data/left/w0.png", "data/right/w0.png"])
    {'data/left/w0.png': 'left/w0', 'data/right/w0.png': 'right/w0'}
    """
    entries = list(dict.fromkeys(entries))
    paths = {entry: PureWindowsPath(_path_of(entry)) for entry in entries}
    shared = len(_shared_parts(paths.values()))
    below = {entry: PurePosixPath(*path.parts[shared:]) for entry, path in paths.items()}
    tried = (
        {entry: stem_of(entry) for entry in entries},
        {entry: str(path.with_name(stem_of(path.name) or path.name)) for entry, path in below.items() if path.name},
        {entry: str(path) for entry, path in below.items()},
    )
    return next(
        (names for names in tried if len({*names.values()}) == len(entries)), {entry: entry for entry in entries}
    )


def _path_of(entry: str) -> str:
    """Return the path of an address, without what is asked for behind it."""
    path = entry.partition("?d=")[2] or (entry.partition("?")[0] if "://" in entry else entry)
    return unquote(path)


def _spellings(entry: str) -> Iterator[tuple[str, str]]:
    """Yield an entry as it is, and as it may have been meant."""
    if "://" not in entry:  # else its end may be that of a query
        yield entry, ""
    entry = _path_of(entry.strip())
    yield entry, SPELLING
    folder, _, name = entry.replace("\\", "/").rpartition("/")
    if re.match(_UPLOADED, name):
        yield f"{folder}/{name[9:]}", SPELLING
    for encoding in () if entry.isascii() else CODECS:
        with suppress(UnicodeError):
            yield entry.encode("latin-1").decode(encoding), SPELLING
