"""A project's folder: its listing of pictures and landmark files, whether each can be used, and files that are added.

Names of files are relative to the folder, with ``/`` between the parts. Names of pictures are looked up in the folder's
listing and never joined to a path. The studio neither reads nor writes through a link that leads out of the folder.
"""

import errno
import hashlib
import os
import re
import shutil
from collections import Counter, deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path, PurePosixPath

import numpy as np

from liaam.errors import ImageError, LiaamError
from liaam.io import image_kind, is_raw
from liaam.io.atomic import write_bytes_atomically
from liaam.io.files import count_of, may_write_in, natural_key, real_path, some_names
from liaam.io.images import PICTURE_SUFFIXES, UNREAD_SUFFIXES, image_size
from liaam.io.landmarks import LANDMARK_SUFFIXES, parse_landmark_data
from liaam.photometry.encoding import as_colour
from liaam.studio import contract
from liaam.studio.refusal import Refusal, refusing
from liaam.studio.tokens import key_of, user_folder

STATE = ".liaam-studio"  # name of the subfolder for the studio's own files
OWN_SUFFIXES = (".pts", ".ljson")  # of the landmark files that the studio writes, in the order in which they are read
SETS = f"{STATE}/sets"  # its subfolder for those of further sets of landmarks, each in a subfolder by its name
SET_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,29}")

COPIED = ("studio.db", "model.liaam")
"""Files of the state of a folder that can only be read, which are copied for the user."""

MOST_FOLDERS = 1000  # maximum number of folders that are listed
LONGEST_NAME = 120  # maximum number of characters of a name
ADDED = "added"  # subfolder of added pictures if others are in subfolders only, which one beside these would hide
SOME_SIZE = (640, 480)  # size of a picture that is assumed where a landmark file needs one

Signature = tuple[int, int, int]


@dataclass(frozen=True)
class Folder:
    """A folder of pictures."""

    root: Path  # path with links resolved

    @cached_property
    def is_read_only(self) -> bool:
        """Whether nothing can be written here, so that pictures are only shown, fitted and relit."""
        return not may_write_in(self.root)

    @cached_property
    def state_root(self) -> Path:
        """The folder that holds the studio's own subfolder: this one, or one of the user if this can only be read."""
        return place_of_state(self.root) if self.is_read_only else self.root

    def check_writable(self) -> None:
        """Refuse a request that would write here if nothing can be written."""
        if self.is_read_only:
            raise Refusal(409, f"{self.root.name or 'the folder'} can only be read: copy it to place landmarks")

    def leads_inside(self, path: Path) -> bool:
        """Whether a path stays in the folder and outside the studio's own subfolder."""
        real = real_path(path)
        return real.is_relative_to(self.root) and STATE not in real.relative_to(self.root).parts

    def inside(self, name: str) -> Path:
        """Return the path of a file in the folder or its subfolders."""
        path = self.root / name
        if not is_relative(name) or not self.leads_inside(path):
            raise Refusal(409, f"{name} is a link that leads out of the folder, so it is not used: remove the link")
        return path

    def name_of(self, path: Path) -> str:
        """Return the name of a file in the folder."""
        return path.relative_to(self.root).as_posix()

    def time(self, subfolder: str) -> int:
        """Return the time of the last added or removed entry of a subfolder, in nanoseconds."""
        with suppress(OSError):
            return (self.root / subfolder).stat().st_mtime_ns
        return 0

    def plain(self, fault: object) -> str:
        """Return an error message in which the folder's path is replaced by its name."""
        name = self.root.name or "the folder"
        return str(fault).replace(f"{self.root}{os.sep}", "").replace(str(self.root), name)


@dataclass(frozen=True)
class File:
    """A file of the folder, with a signature that changes with it: time, size and inode."""

    name: str
    signature: Signature

    @cached_property
    def stem(self) -> str:
        """Name without its suffix."""
        return self.name[: len(self.name) - len(PurePosixPath(self.name).suffix)]

    @cached_property
    def suffix(self) -> str:
        """Suffix in lower case."""
        return PurePosixPath(self.name).suffix.lower()

    @property
    def tag(self) -> str:
        """Identifier of the file's contents for the page."""
        return f"{self.signature[0]:x}-{self.signature[1]:x}"


class Listing:
    """The folder's files at the time of the last scan; ``version`` is incremented with every change.

    If there is no picture in the folder itself, the files of its subfolders are listed as well. ``files`` are by
    name, in natural order, ``other_files`` landmark files in other formats. ``winners`` are the pictures to which
    landmark files belong, by stem. ``stranded`` are links that lead out of the folder, and ``unlisted`` subfolders
    that are not listed. ``place`` is what the names of landmark files begin with: the subfolder of a further set.
    """

    def __init__(self, folder: Folder, most_pixels: int, place: str = "") -> None:
        self.folder = folder
        self.most_pixels = most_pixels
        self.place = place
        self.version = 0
        self.files: dict[str, File] = {}
        self.stranded: list[str] = []
        self.unlisted: list[str] = []
        self._times: dict[str, int] = {}
        self._sizes: dict[str, tuple[Signature, tuple[int, int] | str]] = {}
        self._added: dict[str, str] = {}  # name of each picture that :meth:`add` has written, by its stem
        self._arrange()

    def scan(self) -> None:
        """List the folder."""
        self.stranded = []
        self.unlisted = []
        self._times = {}
        unavailable = partial(Refusal, 503)
        with disk_errors(f"{self.folder.root.name} cannot be read", "is the folder still there?", unavailable):
            signatures, below = self._listed("")
        sets = sets_in(self.folder)
        waiting = deque(name for name in below if name not in sets)
        if any(PurePosixPath(name).suffix.lower() in PICTURE_SUFFIXES for name in signatures):
            self.unlisted.extend(waiting)
            waiting.clear()
        waiting.extendleft(name for name in below if f"{name}/" == self.place)
        while waiting:
            name = waiting.popleft()
            with suppress(OSError):
                if len(self._times) < MOST_FOLDERS:
                    more, below = self._listed(name)
                    signatures.update(more)
                    waiting.extend(below)
                    continue
            self.unlisted.append(name)
        if signatures == {name: file.signature for name, file in self.files.items()}:
            return  # sorting thousands of files takes far longer than listing them
        self.files = {name: File(name, signatures[name]) for name in sorted(signatures, key=natural_key)}
        self._arrange()

    def renew(self, name: str) -> None:
        """Update the entry of one landmark file in a format that the studio writes."""
        subfolder = name.rpartition("/")[0]
        self._times[subfolder] = self.folder.time(subfolder)
        try:
            file = self.files[name] = File(name, _signature((self.folder.root / name).stat()))
        except OSError:
            self.files.pop(name, None)
        else:
            stem = file.stem.removeprefix(self.place)
            if self._own.get(stem, file).name == name:
                self._own[stem] = file  # to arrange thousands of files for each that is written would take minutes
                self.version += 1
                return
        self._arrange()

    def is_current(self, *files: File) -> bool:
        """Whether no file was added or removed, and the given files are unchanged."""
        with suppress(OSError):
            same = all(self.folder.time(name) == time for name, time in self._times.items())
            return same and all(file.signature == _signature((self.folder.root / file.name).stat()) for file in files)
        return False

    def own(self, picture: File) -> File | None:
        """Return the landmark file of a picture in a format that the studio writes."""
        return self._own.get(picture.stem)

    def _arrange(self) -> None:
        """Sort the files into pictures, landmark files in the studio's formats, and other landmark files."""
        files = self.files.values()
        marks = [file for file in files if file.name.startswith(self.place)]
        outside = [file for file in files if not self.place or not file.name.startswith(self.place)]
        self.pictures = [file for file in outside if file.suffix in PICTURE_SUFFIXES]
        own_files = [file for suffix in OWN_SUFFIXES[::-1] for file in marks if file.suffix == suffix]
        self._own = {file.stem.removeprefix(self.place): file for file in own_files}
        others = {*LANDMARK_SUFFIXES} - {*OWN_SUFFIXES}
        self.other_files = [file for file in marks if file.suffix in others]
        self.winners: dict[str, str] = {}
        for file in sorted(self.pictures, key=lambda file: PICTURE_SUFFIXES.index(file.suffix)):
            self.winners.setdefault(file.stem, file.name)
        self.version += 1

    def _listed(self, subfolder: str) -> tuple[dict[str, Signature], list[str]]:
        """List the files of a folder, without links that lead out and unreadable entries, and its subfolders."""
        time = self.folder.time(subfolder)  # before the scan, so that changes during it are noticed
        signatures = {}
        below = []
        with os.scandir(self.folder.root / subfolder) as entries:
            for entry in entries:
                if entry.name.startswith("."):
                    continue
                name = f"{subfolder}/{entry.name}" if subfolder else entry.name
                try:
                    name.encode()
                    if entry.is_symlink() and not self.folder.leads_inside(Path(entry.path)):
                        is_known = PurePosixPath(name).suffix.lower() in (*PICTURE_SUFFIXES, *LANDMARK_SUFFIXES)
                        self.stranded += [name] if is_known else []
                    elif entry.is_file():
                        signatures[name] = _signature(entry.stat())
                    elif entry.is_dir(follow_symlinks=False):  # a link could lead to a folder above it
                        below.append(name)
                except (OSError, UnicodeEncodeError):
                    continue
        self._times[subfolder] = time
        return signatures, sorted(below, key=natural_key)

    def usable_size(self, picture: File) -> tuple[int, int]:
        """Return the width and height of a picture."""
        size = self.size_of(picture)
        if isinstance(size, str):
            raise Refusal(409, f"{picture.name} cannot be used: {size}")
        return size

    def size_of(self, picture: File) -> tuple[int, int] | str:
        """Return the width and height of a picture from its header, or why it cannot be used."""
        if not self.is_read(picture):
            size: tuple[int, int] | str
            try:
                size = image_size(self.folder.inside(picture.name))
                check_pixels(picture.name, size, self.most_pixels)
                as_colour(np.broadcast_to(np.uint8(0), (*size[::-1], 3)), picture.name)
            except LiaamError as fault:
                size = self.folder.plain(fault)
            self._sizes[picture.name] = (picture.signature, size)
        winner = self.winners[picture.stem]
        if winner != picture.name:
            return f"{winner} has the same name except for its suffix, so both would share landmark files: rename one"
        return self._sizes[picture.name][1]

    def mark_unreadable(self, picture: File, fault: str) -> None:
        """Remember that a picture cannot be decoded, although its header can be read."""
        self._sizes[picture.name] = (picture.signature, self.folder.plain(fault))
        self.version += 1

    def is_read(self, picture: File) -> bool:
        """Whether the header of a picture was read before, so that :meth:`size_of` is quick."""
        return picture.name in self._sizes and self._sizes[picture.name][0] == picture.signature

    def notices(self) -> list[str]:
        """Return messages about files that look like pictures but are skipped, and landmark files without a picture."""
        files = self.files.values()
        unread = [file.name for file in files if file.suffix in UNREAD_SUFFIXES]
        kinds = Counter(PurePosixPath(name).suffix.lower() for name in unread)
        endings = ", ".join(f"{count} {suffix}" for suffix, count in sorted(kinds.items()))
        below = []
        for name in self.unlisted:
            with suppress(OSError), os.scandir(self.folder.root / name) as entries:
                if any(Path(entry.name).suffix.lower() in PICTURE_SUFFIXES for entry in entries):
                    below.append(name)
        reason = "there are too many" if len(self._times) >= MOST_FOLDERS else "the folder itself has pictures"
        orphans = [file.name for stem, file in self._own.items() if stem not in self.winners]
        remedy = "if the picture was renamed, rename the landmark file too"
        notices = (
            (unread, "picture", f"skipped, because the format is not supported ({endings}): save as PNG or JPEG"),
            (self.stranded, "file", "skipped, because the link leads out of the folder: put a copy in its place"),
            (below, "subfolder", f"with pictures not shown, because {reason}: open the studio on a subfolder"),
            (orphans, "landmark file", f"without a picture of the same name: {remedy}"),
        )
        return [f"{count_of(len(names), what)} ({some_names(names, 3)}) {why}" for names, what, why in notices if names]

    def add(self, name: str, data: bytes) -> contract.Added:
        """Write a file that replaces none, and none of the landmarks that are there."""
        self.folder.check_writable()
        name = plain_name(name)
        is_picture = Path(name).suffix.lower() in PICTURE_SUFFIXES
        _check_addable(name, data)
        place = self._place_for(name, is_picture)
        path = self.folder.inside(place)
        is_known = path.exists()
        if is_known and path.read_bytes() != data:
            raise Refusal(409, f"{name}: the folder has another file of this name; rename one of them")
        if not is_known:
            self._check_content(name, data, is_picture)
            self._check_stem(place, is_picture)
            path.parent.mkdir(parents=True, exist_ok=True)
            write_bytes_atomically(path, data)
        return {"name": place, "kind": "picture" if is_picture else "landmarks", "known": is_known}

    def _place_for(self, name: str, is_picture: bool) -> str:
        """Return the name in the folder for a file that is added, beside the files of its kind that are there."""
        place = f"{ADDED}/{name}" if self.pictures and all("/" in each.name for each in self.pictures) else name
        return place if is_picture else f"{self.place}{place}"

    def _check_content(self, name: str, data: bytes, is_picture: bool) -> None:
        """Refuse a file that cannot be read."""
        if not is_picture:
            with refusing():
                parse_landmark_data(name, data, SOME_SIZE)
        elif not is_raw(name):  # RAW files can only be read from the disk
            size_in_header(data, name, self.most_pixels)

    def _check_stem(self, place: str, is_picture: bool) -> None:
        """Refuse a picture that would share landmark files with another, and landmarks of a picture that has some."""
        suffix = Path(place).suffix
        stem = place.removesuffix(suffix)
        if is_picture and (other := self._added.setdefault(stem, self.winners.get(stem, place))) != place:
            raise Refusal(409, f"{place} and {other} have the same name except for the suffix: rename one of them")
        others = [stem + ending for ending in OWN_SUFFIXES] if suffix.lower() in OWN_SUFFIXES else []
        there = [other for other in others if self.folder.inside(other).exists()]
        if there:
            raise Refusal(409, f"{place}: the picture has landmarks already, in {there[0]}")


def _check_addable(name: str, data: bytes) -> None:
    """Refuse a file that is of no kind that the studio reads, is empty, or would be hidden."""
    if Path(name).suffix.lower() not in (*PICTURE_SUFFIXES, *LANDMARK_SUFFIXES):
        raise Refusal(415, f"{name} is neither a picture nor a landmark file that liaam reads")
    if not data:
        raise Refusal(422, f"{name} is empty (0 bytes): copy or export it again")
    if not is_relative(name):
        raise Refusal(422, f"{name} is the name of a hidden file: rename it")


def sets_in(folder: Folder) -> list[str]:
    """Return the names of the further sets of landmarks of a folder."""
    with suppress(OSError):
        return sorted(path.name for path in (folder.root / SETS).iterdir() if SET_NAME.fullmatch(path.name))
    return []


def _signature(facts: os.stat_result) -> Signature:
    return facts.st_mtime_ns, facts.st_size, facts.st_ino


def is_relative(name: str) -> bool:
    """Whether a name stays in the folder and names no hidden file or folder."""
    return all(part and not part.startswith(".") for part in name.split("/")) and not Path(name).is_absolute()


def checked_folder(folder: str | os.PathLike[str]) -> Path:
    """Check a folder and return it with links resolved."""
    folder = Path(folder)
    with disk_errors(f"{folder} cannot be read", error=ImageError):
        if not folder.is_dir():
            what = "is a file, not a folder" if folder.exists() else "does not exist"
            raise ImageError(f"{folder} {what}: name the folder that holds the pictures.")
        list(folder.iterdir())
    return real_path(folder)


def place_of_state(folder: Path) -> Path:
    """Return a folder of the user for the state of a folder that can only be read, with a copy of the state there."""
    place = user_folder() / "folders" / key_of(folder)
    with disk_errors(f"{place} cannot be made"):
        place.mkdir(parents=True, exist_ok=True, mode=0o700)
        for name in COPIED:
            source = folder / STATE / name
            target = place / STATE / name
            is_newer = source.is_file() and (not target.exists() or source.stat().st_mtime > target.stat().st_mtime)
            if is_newer:
                target.parent.mkdir(exist_ok=True)
                shutil.copyfile(source, target)
    return place


@contextmanager
def disk_errors(
    what: str, remedy: str = "check the rights on it.", error: Callable[[str], LiaamError] = LiaamError
) -> Iterator[None]:
    """Raise an error of the disk in the block as one that says what failed and what to do."""
    try:
        yield
    except OSError as fault:
        raise error(f"{what} ({fault.strerror or fault}): {remedy}") from fault


def check_pixels(name: str, size: tuple[int, int], most: int) -> None:
    """Refuse a picture of a size (width, height) with more than so many pixels."""
    if size[0] * size[1] > most:
        raise Refusal(413, f"{name} has {size[0]} x {size[1]} pixels, more than {most:,}: make the picture smaller")


def status_of(fault: BaseException | None) -> int:
    """Return the HTTP status of a failed write: 507 if the disk is full, 503 otherwise. The page retries after both."""
    return 507 if isinstance(fault, OSError) and fault.errno in (errno.ENOSPC, errno.EDQUOT) else 503


def revision_of(data: bytes) -> str:
    """Return a hash of the contents of a file."""
    return hashlib.sha256(data).hexdigest()[:16]


def size_in_header(data: bytes, name: str, most_pixels: int) -> tuple[int, int]:
    """Return the width and height of an image file from its header; refuse other files and too large images."""
    if not data:
        raise Refusal(422, f"{name} is empty (0 bytes): copy or export it again")
    if not image_kind(data):
        raise Refusal(415, f"{name} is not a PNG, JPEG, TIFF, BMP, PPM or PGM image: save it as PNG in another program")
    with refusing():
        size = image_size(data, name)
    check_pixels(name, size, most_pixels)
    return size


def plain_name(name: str) -> str:
    """Return a file name without folders and unprintable characters, or "picture" if nothing is left."""
    last = name.replace("\\", "/").rpartition("/")[2]
    shown = "".join(letter if letter.isprintable() else " " for letter in last).strip()
    return shown[-LONGEST_NAME:] or "picture"
