"""A project is a folder: its pictures, their landmark files, the template, and the studio's own files.

:class:`Project` is the thread-safe interface for the rest of the studio. Its parts are not thread-safe, and each
depends only on those before it: :mod:`~liaam.studio.folder`, :mod:`~liaam.studio.store`,
:mod:`~liaam.studio.landmark_files`, :mod:`~liaam.studio.template` and :mod:`~liaam.studio.review`.
"""

import csv
import io
import math
import secrets
import threading
import time
import zipfile
from collections import deque
from collections.abc import Container, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass, replace
from itertools import zip_longest
from pathlib import Path, PurePosixPath
from typing import Any, TypeVar

import numpy as np

from liaam.errors import ImageError, LiaamError
from liaam.io.images import PICTURE_SUFFIXES
from liaam.io.landmarks import Landmarks, collection_text, parse_landmark_data
from liaam.io.sides import stated_side
from liaam.morphometry.scale_tables import images_of
from liaam.studio import contract
from liaam.studio.contract import OMITTED
from liaam.studio.folder import OWN_SUFFIXES, File, Folder, Listing, checked_folder, plain_name, revision_of, sets_in
from liaam.studio.landmark_files import LandmarkFiles, parse_bar
from liaam.studio.measuring import GROUPS, MEASURING, changed, kept_in
from liaam.studio.origins import Origin, Origins, origins_after, own_points, parse_origins
from liaam.studio.pictures import PictureSource, source_of
from liaam.studio.refusal import Refusal
from liaam.studio.review import Done, PictureStates, ReviewLog, parse_who
from liaam.studio.settings import StudioSettings
from liaam.studio.sides import for_measuring, parse_sides
from liaam.studio.store import Store, StoredTable
from liaam.studio.template import (
    Template,
    Templates,
    parse_indices,
    parse_points,
    parse_template,
    sliders_text,
    template_of,
    text_of,
)

PART_SECONDS = 0.02  # how long files are read at a time, while requests wait
REST_SECONDS = 0.3  # files are read more slowly until so long after a request, so that the page opens soon
# Pauses between the parts, during that time and later. The lock is not fair, so that requests get it in pauses only
BUSY_PAUSE_SECONDS = 5 * PART_SECONDS
PAUSE_SECONDS = 0.1 * PART_SECONDS
READ_AT_ONCE = 100  # number of pictures whose files an overview reads in any case
LONG = 2000  # number of pictures above which an overview reads no more files than these

EXPORTS = {
    "pts": "-pts.zip",
    "coco": ".json",
    "tps": ".tps",
    "csv": ".csv",
    "sliders": "-sliders.csv",
}
"""Ends of the names of exported files, by kind."""

FEWEST_PLACED = 3  # fewest points of a picture that training uses; others may be absent
MOST_COMPARED = 300  # pictures that the side of one is found by
FEWEST_SCALED = 2  # fewest pictures with a scale bar that new ones are offered
UNKNOWN_SIZE = (640, 480)  # width and height that a template is read for where no picture can be read


Asked = TypeVar("Asked", bound=contract.Request)


@dataclass(frozen=True)
class Annotated:
    """A picture with its landmarks, for training, and what seems to be wrong with them."""

    name: str
    path: Path
    points: np.ndarray  # (n, 2) float64, pixels; NaN where the object lacks a point
    own: np.ndarray  # (n,) bool: points that a person has placed, moved or confirmed one by one
    revision: str  # :meth:`PictureStates.version_of` the landmarks
    slip: str | None = None  # description of what seems to be wrong
    side: str = ""  # of the object, as a person or the landmark file says

    @property
    def placed(self) -> np.ndarray:
        """Which points have a position, (n,) bool."""
        return np.asarray(~np.isnan(self.points).any(axis=1))


@dataclass(frozen=True)
class Placed:
    """A picture with landmarks, complete or not, for export."""

    file: File
    landmarks: Landmarks  # with the picture's scale and the template's names
    origins: list[str | None]  # of the points (:mod:`liaam.studio.origins`)
    size: tuple[int, int]  # width and height


@dataclass(frozen=True)
class Overview:
    """All pictures of a project at one scan of the folder."""

    stamp: str
    pictures: list[contract.Picture]  # in natural order
    done: dict[str, str]  # revision of the landmarks of each done picture that is not left out of training, by name
    unread: list[str]  # names of the pictures whose files have not been read yet

    @property
    def sides(self) -> dict[str, str]:
        """The sides that are stated, by name."""
        return {each["name"]: side for each in self.pictures if (side := each.get("side"))}


@dataclass(frozen=True)
class _Wanted:
    """The marks of a picture as a request wants them, with those that it leaves as they are."""

    points: list[contract.Point]
    invisible: list[int]
    absent: list[int]
    origins: list[Origin | None]
    bar: contract.Bar | None

    @property
    def has_points(self) -> bool:
        """Whether any point has a position."""
        return any(self.points)

    def moves(self, current: contract.Marks) -> bool:
        """Whether positions, or which points are invisible, are other than in the landmark file."""
        before = current["points"] if current["source"] == "file" else [None] * len(self.points)
        return self.points != before or self.invisible != current["invisible"]

    def rescales(self, current: contract.Marks) -> bool:
        """Whether the scale bar is another one."""
        return self.bar != current["bar"]

    @classmethod
    def parse(cls, asked: contract.SaveMarks, current: contract.Marks, n: int) -> "_Wanted":
        """Parse and check the marks of ``n`` points in a request."""
        points: list[contract.Point] = [point and [*point] for point in parse_points(asked.points, n)]
        invisible = [] if asked.invisible is OMITTED else parse_indices(asked.invisible, n, "invisible")
        known = current["absent"] if asked.absent is OMITTED else asked.absent
        absent = parse_indices(known, n, "absent")
        if asked.origins is not None:
            origins = parse_origins(asked.origins, points)
        else:
            before = current["points"] if current["source"] == "file" else [None] * n
            origins = origins_after(points, before, current["origins"] or [None] * len(before))
        return cls(
            points=points,
            invisible=sorted(index for index in invisible if points[index] is not None),
            absent=sorted(index for index in absent if points[index] is None),
            origins=origins,
            bar=current["bar"] if asked.bar is OMITTED else parse_bar(asked.bar),
        )


def _merged(wanted: _Wanted, base: Any, current: contract.Marks) -> _Wanted:
    """Keep what others have changed of absent points and origins since a page read them, as ``base``.

    A point that the page has changed as well is as the page has it.
    """
    n = len(wanted.points)
    absent = wanted.absent
    origins = wanted.origins
    if not isinstance(base, dict):
        return wanted
    read = contract.given(contract.Base, base)
    if read.absent is not OMITTED:
        before = {*parse_indices(read.absent, n, "absent")}
        now = {*current["absent"]}
        mine = {*wanted.absent}
        kept = {index for index in range(n) if index in (now if (index in mine) == (index in before) else mine)}
        absent = sorted(index for index in kept if wanted.points[index] is None)
    known = current["origins"]
    if known is not None and isinstance(read.origins, list) and len(read.origins) == n:
        origins = [
            known[i] if mine == read.origins[i] and wanted.points[i] == current["points"][i] else mine
            for i, mine in enumerate(wanted.origins)
        ]
    return replace(wanted, absent=absent, origins=origins)


class Project:
    """A project's folder; thread-safe. ``root`` is the folder with links resolved.

    A further set of landmarks of the folder (:mod:`liaam.studio.sets`) is a project with a ``set_name``, which shares
    the scale bars and the lock of the ``first`` one.
    """

    def __init__(
        self,
        folder: str | Path,
        settings: StudioSettings | None = None,
        set_name: str = "",
        first: "Project | None" = None,
    ) -> None:
        self.settings = settings or StudioSettings()
        self.set_name = set_name
        self._sets: dict[str, Project] = first._sets if first else {"": self}
        self.folder = Folder(checked_folder(folder))
        self.root = self.folder.root
        self.title = "-".join(filter(None, (self.root.name, set_name)))  # name of the model and of exported files
        self.store = Store(self.folder, set_name)
        self._lock = first._lock if first else threading.RLock()
        self._asked = 0.0  # time of the last request for pictures
        self._salt = secrets.token_hex(8)  # makes stamps of another run different
        self._listing = Listing(self.folder, self.settings.pixels, place=f"{set_name}/" if set_name else "")
        bars = first._landmarks.bars if first else StoredTable(self.store, "bar")
        sides = first._landmarks.sides if first else StoredTable(self.store, "side")
        self._landmarks = LandmarkFiles(self._listing, self.store, self.settings.upload_bytes, bars, sides)
        self._proposals = StoredTable(self.store, "proposal")
        # Pictures left at the mean shape have no landmark file, so no training uses them.
        self._unchecked = StoredTable(self.store, "unchecked")
        self._absent = StoredTable(self.store, "absent")
        self._origins = Origins(self.store)
        self.templates = Templates(
            self._listing, self.store, self._landmarks, self._proposals, self._absent, self._lock
        )
        self._log = ReviewLog(self.store)
        self._states = PictureStates(
            listing=self._listing,
            store=self.store,
            landmarks=self._landmarks,
            proposals=self._proposals,
            unchecked=self._unchecked,
            templates=self.templates,
            log=self._log,
            origins=self._origins,
            absent=self._absent,
        )
        self._rescan()

    @property
    def stamp(self) -> str:
        """Value that changes with the folder's files and the studio's own files; quick to compute."""
        with self._lock:
            self._rescan()
            return self._stamp()

    def checked(self, kind: type[Asked], data: Any, wanted: str) -> Asked:
        """Return the fields of a request. Refuse what is no object, or whose ``folder`` is the id of another folder."""
        if not isinstance(data, dict):
            raise Refusal(422, f"send an object with {wanted}")
        asked = contract.given(kind, data)
        folder = self.store.id
        if asked.folder is not OMITTED and asked.folder != folder:
            raise Refusal(409, "the studio now serves another folder than this page shows: reload it", folder=folder)
        return asked

    @property
    def sets(self) -> list[str]:
        """The names of all sets of landmarks of the folder."""
        return ["", *sets_in(self.folder)]

    def of_set(self, name: str) -> "Project":
        """Return the project of another set of landmarks of the folder."""
        with self._lock:
            if name not in self._sets:
                if name not in self.sets:
                    raise Refusal(404, f"the folder has no set of landmarks '{name[:40]}'")
                self._sets[name] = Project(self.root, self.settings, name, self._sets[""])
            return self._sets[name]

    @property
    def problems(self) -> list[str]:
        """Messages for the user about files that cannot be read, are skipped, or belong to no picture."""
        with self._lock:
            return [*self.store.faults.values(), *self._landmarks.problems, *self._listing.notices()]

    def _rescan(self, strict: bool = False) -> None:
        """Scan the folder; only if ``strict``, raise if a change of the template cannot be finished yet."""
        with nullcontext() if strict else suppress(Refusal):  # it has been noted
            self.templates.finish()
        self._listing.scan()

    def _stamp(self) -> str:
        """Return the stamp of what was found by the last scan, and of what the studio holds."""
        listing = self._listing
        store = self.store
        templates = self.templates
        of_folder = (listing.version, listing.stranded, listing.unlisted)
        of_store = (store.writes, sorted(store.faults.items()))
        of_studio = (templates.offered, templates.is_pending, self._states.slips)
        return revision_of(repr((self._salt, of_folder, of_store, of_studio)).encode())

    def overview(self, stamp: str | None = None, seconds: float = math.inf) -> Overview | None:
        """Return all pictures, or None if nothing has changed since a :attr:`stamp`.

        Files are read for about so many ``seconds``, but those of the first pictures in any case. The remaining
        pictures are in the state ``reading``, and the overview has a stamp that is never current.
        """
        self._asked = time.monotonic()
        with self._lock:
            self._rescan()
            if self._stamp() == stamp:
                return None
            files = self._listing.pictures
            is_long = len(files) > LONG and seconds < math.inf
            self._read_for(0.0 if is_long else seconds, deque(files), READ_AT_ONCE)
            stamp = self._stamp()
            ranks = self._states.ranks()
            read = {file.name for file in files if self._listing.is_read(file) and self._landmarks.is_read(file)}
            if len(read) < len(files):
                stamp += "-reading"
            return Overview(
                stamp=stamp,
                pictures=[self._states.as_json(file, ranks if file.name in read else None) for file in files],
                done=self._revisions(read),
                unread=[file.name for file in files if file.name not in read],
            )

    def read_files(self, until: threading.Event) -> None:
        """Read the files of all pictures in small parts, so that others can use the project meanwhile."""
        with self._lock:
            self._rescan()
            waiting = deque(self._listing.pictures)
        while waiting and not until.is_set():
            with self._lock:
                self._read_for(PART_SECONDS, waiting)
            is_busy = time.monotonic() < self._asked + REST_SECONDS
            time.sleep(BUSY_PAUSE_SECONDS if is_busy else PAUSE_SECONDS)

    def _read_for(self, seconds: float, waiting: deque[File], least: int = 1) -> None:
        """Read the files of waiting pictures for so many seconds, but of the ``least`` number in any case."""
        until = time.monotonic() + seconds
        n_read = 0
        while waiting and (n_read < least or time.monotonic() < until):
            file = waiting.popleft()
            if self._listing.files.get(file.name) == file:
                self._states.as_json(file, {})  # which reads them
            n_read += 1

    def source(self, name: str) -> PictureSource:
        """Return a picture that can be decoded."""
        with self._lock:
            self._listing.usable_size(self._find(name))
            path = self.folder.inside(name)
        return source_of(path, self.settings.pixels, name)

    def mark_unreadable(self, source: PictureSource, fault: ImageError) -> None:
        """Remember that a picture without landmarks cannot be decoded, unless that may pass."""
        cause: BaseException | None = fault
        while cause is not None:
            if isinstance(cause, OSError) and cause.errno is not None:
                return
            cause = cause.__cause__
        with self._lock:
            file = self._listing.files.get(source.name)
            if file is None or file.tag != source.tag or not self._listing.is_current(file):
                return  # it may be readable when it comes back
            if not self._landmarks.of(file).n_placed:
                self._listing.mark_unreadable(file, str(fault))

    def _revisions(self, among: Container[str]) -> dict[str, str]:
        """Return the revisions of :meth:`annotated` pictures, of those with these names at the last scan."""
        files = [file for file in self._listing.pictures if file.name in among and self._is_for_training(file)]
        return {file.name: self._states.version_of(file, self._landmarks.of(file)) for file in files}

    def annotated(self) -> list[Annotated]:
        """Return the pictures that have all points, but for absent ones, and are not left out of training."""
        annotated = []
        with self._lock:
            self._rescan(strict=True)
            for file in self._listing.pictures:
                if self._is_for_training(file):
                    marks = self._landmarks.of(file)
                    assert marks.landmarks is not None
                    slip, _ = self._states.slip_of(file)
                    annotated.append(
                        Annotated(
                            name=file.name,
                            path=self.root / file.name,
                            points=marks.landmarks.points,
                            own=own_points(self._states.origins_of(file, marks)),
                            revision=self._states.version_of(file, marks),
                            slip=slip,
                            side=self._landmarks.side_of(file),
                        )
                    )
        return annotated

    def _is_for_training(self, file: File) -> bool:
        """Return whether a picture can be read, has enough points, and is not left out of training."""
        is_unreadable = isinstance(self._listing.size_of(file), str)  # why it cannot be read
        if is_unreadable or not self._states.is_done(file) or self._landmarks.of(file).n_placed < FEWEST_PLACED:
            return False
        return self._log.who("left out", file.name) is None

    def export(self, kind: str) -> tuple[str, bytes]:
        """Return the name and the content of a file with the landmarks of all pictures, one of :data:`EXPORTS`."""
        if kind not in EXPORTS:
            raise Refusal(422, f"landmarks cannot be exported as '{kind[:40]}': choose one of {', '.join(EXPORTS)}")
        name = plain_name(self.title) + EXPORTS[kind]
        if kind == "sliders":
            return name, sliders_text(self.templates.needed).encode()
        pictures = self.placed("export")
        if kind == "pts":
            stream = io.BytesIO()
            with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
                for picture in pictures:
                    archive.writestr(f"{picture.file.stem}.pts", text_of(picture.landmarks, ".pts"))
            return name, stream.getvalue()
        sides = _sides_of(pictures)
        collection = {
            picture.file.name: replace(picture.landmarks, side=side)
            for picture, side in zip(pictures, sides, strict=True)
        }
        sizes = {picture.file.name: picture.size for picture in pictures}
        text = collection_text(name, collection, sizes)
        if kind == "csv":
            text = _with_column(text, "origin", [origin or "" for picture in pictures for origin in picture.origins])
            if any(sides):
                of_points = [side for picture, side in zip(pictures, sides, strict=True) for _ in picture.origins]
                text = _with_column(text, "side", of_points)
        return name, text.encode()

    def has_both_sides(self) -> bool:
        """Return whether specimens of two sides have landmarks, which an export holds as they lie in the pictures."""
        return len({*_sides_of(self.placed())} - {""}) > 1

    def placed(self, to: str = "export") -> list[Placed]:
        """Return the usable pictures with landmarks for the current template; ``to`` is what they are needed for."""
        pictures = []
        with self._lock:
            self._rescan(strict=True)
            template = self.templates.current
            for file in self._listing.pictures:
                marks = self._landmarks.of(file)
                size = self._listing.size_of(file)
                if template and marks.landmarks and marks.fits(template) and not isinstance(size, str):
                    scale = self._landmarks.scale_of(file)
                    unit = self._landmarks.unit_of(file) if scale else ""
                    side = self._landmarks.side_of(file) or stated_side(marks.landmarks.side)
                    landmarks = replace(marks.landmarks, scale=scale, unit=unit, names=template.names, side=side)
                    pictures.append(Placed(file, landmarks, [*self._states.origins_of(file, marks)], size))
        if not pictures:
            raise self._nothing_placed(to)
        return pictures

    def _nothing_placed(self, to: str) -> Refusal:
        """Return why nothing can be done with the landmarks of the folder: there are none, or only proposed ones."""
        with self._lock:
            proposed = sum(1 for file in self._listing.pictures if (self._proposals.of(file) or {}).get("points"))
        if not proposed:
            return Refusal(422, f"no picture has landmarks yet: place the points of one, then {to}")
        which = "the points of the picture are" if proposed == 1 else f"the points of {proposed} pictures are"
        return Refusal(
            422, f"{which} only proposed: accept them in Annotate or on the wall, then {to}", proposed=proposed
        )

    def unfitted(self, model: str = "") -> list[tuple[str, Path]]:
        """Return the names and paths of the usable pictures without points to which a model, by key, was not fitted.

        Pictures with the proposal of another model, in ``review.teaching_order``, take turns with the others.
        """
        with self._lock:
            self._rescan()
            blank = [file for file in self._listing.pictures if self._is_blank(file, model)]
            names = [file.name for file in blank if not isinstance(self._listing.size_of(file), str)]
            has_proposals = any(self._proposals.of(file) for file in blank)
            ranks = self._states.ranks() if has_proposals else {}  # which reads the files of all pictures
            ranked = sorted((name for name in names if name in ranks), key=ranks.__getitem__)
            others = [name for name in names if name not in ranks]
            in_turns = [name for turn in zip_longest(ranked, others) for name in turn if name is not None]
            return [(name, self.root / name) for name in in_turns]

    def _is_blank(self, file: File, model: str) -> bool:
        """Return whether a picture has neither points nor a proposal of a model."""
        proposal = self._proposals.of(file)
        if proposal is not None and proposal.get("model", "") == model:
            return False
        return not self._landmarks.of(file).n_placed

    def take_in(self, name: str, data: bytes) -> contract.Added:
        """Add a picture or a landmark file to the folder (:meth:`liaam.studio.folder.Listing.add`)."""
        with self._lock:
            return self._listing.add(name, data)

    @contextmanager
    def changing(self) -> Iterator[None]:
        """Hold the lock while files of the folder are moved, and list the folder before and after, in all sets."""
        with self._lock:
            self._rescan(strict=True)
            for name in self.sets:
                templates = self.of_set(name).templates
                if templates.current is not None and not templates.is_offered:
                    templates.keep()  # the picture that it was taken from may go
            try:
                yield
            finally:
                for name in self.sets:
                    self.of_set(name)._rescan()

    def files_of(self, name: str) -> list[str]:
        """Return a picture's file and the landmark files that the studio writes for it, in all sets, by name."""
        with self._lock:
            file = self._find(name)
            found = [file.name]
            if self._listing.winners[file.stem] == file.name:
                for each in self.sets:
                    listing = self.of_set(each)._listing
                    listing.scan()
                    own = [f"{listing.place}{file.stem}{suffix}" for suffix in OWN_SUFFIXES]
                    found += [landmarks for landmarks in own if landmarks in listing.files]
            return found

    def has_stem(self, stem: str, but: str) -> bool:
        """Return whether another picture than ``but`` has a name that differs by its suffix only."""
        with self._lock:
            return self._listing.winners.get(stem, but) != but

    def take_own(self, name: str) -> None:
        """Write the landmarks of a picture into a file of its own, in all sets, if they are in another one."""
        with self._lock:
            file = self._find(name)
            for each in self.sets:
                project = self.of_set(each)
                marks = project._landmarks.of(file)
                template = project.templates.current
                is_other = marks.n_placed and project._listing.own(file) is None
                if is_other and template is not None and marks.landmarks is not None and marks.fits(template):
                    project._landmarks.save(file, template, marks.points, marks.landmarks.invisible)

    def rekey(self, name: str, new: str, moves: Mapping[str, str]) -> None:
        """Give what is kept of a picture its new name, in all sets; ``moves`` are its files, by their old names."""
        with self._lock:
            for each in self.sets:
                project = self.of_set(each)
                tables = (project._proposals, project._unchecked, project._absent, project._origins.table)
                shared = (project._landmarks.bars, project._landmarks.sides)
                for table in (*tables, *shared) if each == "" else tables:
                    table.rename({name: new})
                project._landmarks.rename_invisible(moves)
                project._rename_in_groups(name, new)
                project._log.rename(name, new)
                project._states.slips.pop(name, None)

    def _rename_in_groups(self, name: str, new: str) -> None:
        """Let a picture that has another name stay in its group."""
        groups: dict[str, str] = self.store.get(GROUPS) or {}
        before, after = (str(PurePosixPath(each).with_suffix("")) for each in (name, new))
        with suppress(LiaamError):  # a name that may mean several
            (key,) = images_of([before], [*groups])
            if key is not None:
                self.store.put(GROUPS, {"": {after if each == key else each: group for each, group in groups.items()}})

    def set_slips(self, slips: dict[str, tuple[str, str, list[int]]]) -> None:
        """Set the revision of the landmarks, the slip in them and its points, by picture."""
        self._states.slips = slips

    def own_complete(self) -> tuple[dict[str, np.ndarray], list[str]]:
        """Return the points of pictures that lack none and are all a person's own, and the names of other whole ones.

        The pictures are those of :meth:`annotated`.
        """
        done = [item for item in self.annotated() if item.placed.all()]
        own = {item.name: item.points for item in done if item.own.all()}
        return own, [item.name for item in done if item.name not in own]

    def _find(self, name: str) -> File:
        """Find a picture in the listing; scan the folder again if the picture or its files have changed."""
        self._asked = time.monotonic()
        file = self._listing.files.get(name)
        if file is None or not self._landmarks.is_current(file):
            self._listing.scan()
            file = self._listing.files.get(name)
        if file is None or file.suffix not in PICTURE_SUFFIXES:
            raise Refusal(404, f"the folder has no picture '{name[:200]}': reload the page")
        return file

    def landmarks(self, name: str) -> Landmarks | None:
        """Return the landmarks in a picture's file, complete or not, or None if no file can be read."""
        with self._lock:
            return self._landmarks.of(self._find(name)).landmarks

    def own_landmarks(self, name: str) -> Landmarks | None:
        """Return the landmarks of a picture that a person has placed, moved or confirmed; the others are missing."""
        with self._lock:
            file = self._find(name)
            marks = self._landmarks.of(file)
            if marks.landmarks is None:
                return None
            is_own = own_points(self._states.origins_of(file, marks))
            return replace(marks.landmarks, points=np.where(is_own[:, None], marks.landmarks.points, np.nan))

    def pixel_length(self, name: str) -> tuple[float, str] | None:
        """Return the length of a pixel of a picture and its unit; None if it has no scale, or none with a unit."""
        with self._lock:
            file = self._find(name)
            scale = self._landmarks.scale_of(file)
            unit = self._landmarks.unit_of(file)
        return (scale, unit) if scale and unit else None

    def shared_scale(self) -> contract.SharedScale:
        """Return the scale bar that all pictures with a scale have, and those of the same size that lack one."""
        with self._lock:
            self._rescan()
            files = self._listing.pictures
            scaled = [file for file in files if self._landmarks.scale_of(file)]
            bars = [self._landmarks.scale_bar(file)["bar"] for file in scaled]
            if len(bars) < FEWEST_SCALED or bars[0] is None or any(bar != bars[0] for bar in bars):
                return {"bar": None, "of": "", "without": []}
            sizes = {file: self._listing.size_of(file) for file in files}
            size = sizes[scaled[0]]
            alike = [file for file in files if sorted(sizes[file]) == sorted(size)]  # also those that were turned
            return {
                "bar": bars[0],
                "of": scaled[0].name,
                "without": [file.name for file in alike if not self._landmarks.scale_of(file)],
            }

    def marks(self, name: str) -> contract.Marks:
        """Return the landmarks of a picture as JSON for the page: from its file, from a proposal, or none."""
        with self._lock:
            self.templates.finish()
            return self._states.marks_json(self._find(name))

    def save_marks(self, name: str, data: Any) -> contract.Saved:
        """Save the landmarks of a picture if its file has not changed since the page read it.

        The data are those of :class:`liaam.studio.contract.SaveMarks`. ``template`` is the revision of the template of
        the points, to check; ``unchecked`` says whether a picture without points was left at the mean shape. The scale
        bar and the absent points stay as they are without ``bar`` and ``absent``. Without ``origins``, points that have
        changed were placed. With ``base``, absent points and origins that others have changed since stay as they are.
        ``who`` is the name of the person, for the log. Landmarks equal to those in the file are
        accepted with any revision, since an earlier answer may have been lost.
        """
        asked = self.checked(contract.SaveMarks, data, "points, invisible and revision")
        self.folder.check_writable()
        who = parse_who(asked.who)
        with self._lock:
            self.templates.finish()
            file = self._find(name)
            template = self.templates.needed
            if asked.template is not OMITTED:
                self.templates.check(asked.template, f"the landmarks of {name}")
            current = self._states.marks_json(file)
            of_page = _Wanted.parse(asked, current, len(template))
            wanted = _merged(of_page, asked.base, current)
            if (wanted.moves(current) or wanted.rescales(current)) and asked.revision != current["revision"]:
                clash = f"the landmarks of {name} were changed elsewhere in the meantime: check them"
                gone = f"the landmark file of {name} was deleted in the meantime: save it again, or let it be"
                raise Refusal(409, gone if current["revision"] is None else clash, current=current)
            self._write(file, template, wanted, current, who)
            if asked.unchecked is not OMITTED and not wanted.has_points:
                self._set_unchecked(file, bool(asked.unchecked))
            marks = self._landmarks.of(file)
            return {
                "revision": marks.revision,
                "beside": self._states.beside(file, marks),
                "merged": wanted != of_page,
                "picture": self._states.as_json(file, self._states.ranks()),
            }

    def _write(self, file: File, template: Template, wanted: _Wanted, current: contract.Marks, who: str) -> None:
        """Write what the marks of a picture change."""
        has_moved = wanted.moves(current)
        is_rescaled = wanted.rescales(current)
        if is_rescaled:
            self._landmarks.set_bar(file, wanted.bar)
        if wanted.has_points and (has_moved or wanted.origins != current["origins"]):  # they belong to positions
            self._origins.save(file.name, wanted.points, wanted.origins)  # first, as it belongs to what is written
        if wanted.absent != (self._absent.get(file.name) or []):  # the model may have found others
            self._absent.save({file.name: wanted.absent or None})
        if has_moved:
            self.templates.keep()  # the first save fixes a template that was taken from a file
        if has_moved or (is_rescaled and self._landmarks.of(file).n_placed):  # landmark files state the scale
            self._landmarks.save(file, template, wanted.points, wanted.invisible)
        if has_moved:
            with suppress(LiaamError):  # the landmarks are saved
                did = "placed" if wanted.has_points else "cleared"
                self._log.add_change(who, file.name, did, self._landmarks.of(file).revision)

    def _set_unchecked(self, file: File, is_unchecked: bool) -> None:
        """Store whether a picture without points was left at the mean shape, if that has changed."""
        tag = file.tag if is_unchecked else None
        if self._unchecked.get(file.name) != tag:
            self._unchecked.save({file.name: tag})

    def review(self, data: Any) -> Done:
        """Apply an action to several pictures (:meth:`liaam.studio.review.PictureStates.apply`).

        The data are those of :class:`liaam.studio.contract.Review`; ``did`` is one of
        :data:`liaam.studio.review.ACTIONS`.
        """
        asked = self.checked(contract.Review, data, "pictures, a list of names, and did")
        names = asked.pictures
        if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
            raise Refusal(422, "send an object with pictures, a list of names, and did")
        who = parse_who(asked.who)
        with self._lock:
            self._rescan(strict=True)
            files = [self._find(name) for name in dict.fromkeys(names)]
            if asked.did != "scaled":
                return self._states.apply(files, str(asked.did), who)
            bar = parse_bar(asked.bar)
            if bar is None or not isinstance(asked.of, str):
                raise Refusal(422, "send the scale bar, bar, and the picture on which it was drawn, of")
            of_any_size = asked.anyway is True
            size = self._listing.usable_size(self._find(asked.of))
            return self._states.apply(files, "scaled", who, bar, like=None if of_any_size else size)

    def found_side(self, name: str) -> contract.FoundSide:
        """Return the side of the object in a picture: of itself, if it has landmarks, and by comparison with others."""
        with self._lock:
            file = self._find(name)
        try:
            placed = self.placed()
        except Refusal:
            return {"side": "", "both": False}
        own = [picture for picture in placed if picture.file.name == file.name]
        others = [picture for picture in placed if picture.file.name != file.name]
        step = max(1, math.ceil(len(others) / MOST_COMPARED))
        sides = _sides_of([*own, *others[::step]])
        return {"side": sides[0] if own else "", "both": len({*sides} - {""}) > 1}

    def stated_sides(self) -> dict[str, str]:
        """Return the sides of the objects that people or landmark files state, by picture."""
        with self._lock:
            self._rescan()
            sides = {file.name: self._landmarks.side_of(file) for file in self._listing.pictures}
            return {name: side for name, side in sides.items() if side}

    def save_sides(self, data: Any) -> contract.SidesBefore:
        """Say the ``sides`` of the objects in pictures, by name (:func:`liaam.studio.sides.parse_sides`)."""
        sides = parse_sides(self.checked(contract.SaveSides, data, "sides, by picture").sides)
        self.folder.check_writable()
        with self._lock:
            self._rescan(strict=True)
            table = self._landmarks.sides
            names = [self._find(name).name for name in sides]
            before = {name: table.get(name, "") for name in names}
            table.save({name: sides[name] or None for name in names})
            return {"before": before}

    def save_measuring(self, data: Any) -> contract.Measuring:
        """Change what is measured of the pictures (:class:`liaam.studio.contract.SaveMeasuring`); return it."""
        asked = self.checked(contract.SaveMeasuring, data, "add, remove, scale or by")
        with self._lock:
            self.templates.finish()
            template = self.templates.current
            measuring = changed(kept_in(self.store), asked, () if template is None else template.names)
            if template is not None and measuring["measures"] and not self.templates.is_offered:
                self.templates.keep()  # measures belong to its points
            self.store.put(MEASURING, {"": measuring})
            return measuring

    def save_who(self, data: Any) -> contract.Who:
        """Keep the name of the person who works here, in this set of landmarks."""
        who = parse_who(self.checked(contract.SaveWho, data, "who, your name").who)
        self.store.put("who", {"": who})
        return {"who": who}

    def history(self, name: str) -> list[contract.HistoryEntry]:
        """Return the newest entries of a picture in the log."""
        with self._lock:
            return self._log.history(self._find(name).name)

    def save_template(self, data: Any) -> tuple[Template, bool]:
        """Save a template; return it, and whether points were added, removed or reordered, so that models are invalid.

        The data are those of :class:`liaam.studio.contract.SaveTemplate`. Landmark files are updated by ``mapping``.
        """
        asked = self.checked(contract.SaveTemplate, data, "names, contours, mirror and points")
        template = parse_template(data, self.settings.points)
        self.folder.check_writable()
        with self._lock:
            return template, self.templates.save(template, asked)

    def read_template(self, name: str, data: bytes) -> Template:
        """Create a template from the contents of a landmark file, without saving it."""
        with self._lock:
            sizes = (self._listing.size_of(file) for file in self._listing.pictures)
            size = next((size for size in sizes if not isinstance(size, str)), UNKNOWN_SIZE)
        parsed = parse_landmark_data(Path(name).name, data, size)
        landmarks = parsed if isinstance(parsed, Landmarks) else next(iter(parsed.values()))
        if len(landmarks) > self.settings.points:
            raise Refusal(422, f"{name} has {len(landmarks)} points, more than the {self.settings.points} allowed")
        return template_of(landmarks)

    def add_proposals(self, proposals: Mapping[str, dict[str, Any]], order: str | None = None) -> None:
        """Save proposals by picture, whose ``tag`` is by default the current one; none for another order of points."""
        with self._lock:
            if order not in (None, self.templates.order):
                return
            tagged = {}
            for name, proposal in proposals.items():
                file = self._listing.files.get(name)
                tagged[name] = {"tag": None if file is None else file.tag, **proposal}
            self._proposals.save(tagged)


def _sides_of(pictures: Sequence[Placed]) -> list[str]:
    """Return the side of each picture for those who read it, such as ``mirrored`` if none is stated."""
    stated = [picture.landmarks.side for picture in pictures]
    shapes = np.array([picture.landmarks.points for picture in pictures])
    sides = for_measuring(stated, [picture.file.stem for picture in pictures], shapes)
    return sides if any(sides) else stated


def _with_column(text: str, title: str, values: Sequence[str]) -> str:
    """Return a table in CSV with another column."""
    rows = list(csv.reader(io.StringIO(text, newline="")))
    buffer = io.StringIO(newline="")
    writer = csv.writer(buffer)
    writer.writerow([*rows[0], title])
    writer.writerows([*row, value] for row, value in zip(rows[1:], values, strict=True))
    return buffer.getvalue()
