"""The landmarks of a project: its landmark files, scale bars, and what the model proposes.

Landmarks are saved beside the picture as ``.ljson``, or in an existing ``.pts``, which :func:`liaam.load_folder`
prefers. Files of other formats are read but never written or removed; a saved ``.ljson`` takes precedence over them.
A scale bar, such as one along a ruler, gives the length of a pixel in millimetres: the scale of a picture's landmarks.
The studio also keeps the invisible points, which a ``.pts`` cannot store, and in ``kept`` copies of unreadable landmark
files that were replaced.
"""

import json
import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property, lru_cache
from pathlib import Path
from typing import Any, cast

from liaam.datasets.folder import pair_files
from liaam.errors import LandmarkError
from liaam.io.atomic import write_bytes_atomically, write_text_atomically
from liaam.io.files import read_bytes, some_names
from liaam.io.landmarks import Landmarks, parse_landmark_data
from liaam.io.sides import side_of_text
from liaam.studio import contract
from liaam.studio.folder import OWN_SUFFIXES, File, Listing, Signature, disk_errors, revision_of
from liaam.studio.refusal import Refusal
from liaam.studio.sides import SIDES
from liaam.studio.store import Store, StoredTable
from liaam.studio.template import Template, landmarks_of, parse_points, text_of

UNITS = {"µm": 0.001, "mm": 1.0, "cm": 10.0, "m": 1000.0, "in": 25.4}  # units of length, in millimetres
LONGEST = 1e9


@dataclass(frozen=True, eq=False)
class Marks:
    """The contents of a landmark file; without arguments, those of a picture that has none."""

    file: str = ""
    revision: str | None = None
    landmarks: Landmarks | None = None
    error: str | None = None

    @property
    def points(self) -> list[list[float] | None]:
        """Points for JSON: [x, y] or None."""
        placed = [] if self.landmarks is None else self.landmarks.points.tolist()
        return [None if x != x else [round(x, 3), round(y, 3)] for x, y in placed]

    @cached_property
    def placement(self) -> str:
        """Hash of the points without the scale, by which checks and training know whether they have changed."""
        return revision_of(repr((self.points, self.landmarks and self.landmarks.invisible)).encode())

    @property
    def n_placed(self) -> int:
        """Number of placed points."""
        return 0 if self.landmarks is None else int((~self.landmarks.missing).sum())

    def fits(self, template: Template | None) -> bool:
        """Whether points are placed, and there are as many as the template has."""
        count = None if self.landmarks is None or not self.n_placed else len(self.landmarks)
        return template is not None and count == len(template)


class LandmarkFiles:
    """Landmark files of the listed pictures, cached until they change; ``problems`` are those of no picture."""

    def __init__(self, listing: Listing, store: Store, most_bytes: int, bars: StoredTable, sides: StoredTable) -> None:
        self._listing = listing
        self._store = store
        self._folder = listing.folder
        self._most_bytes = most_bytes
        self._read: dict[str, tuple[Signature, Marks]] = {}
        self._paired: dict[str, Marks] = {}
        self._faults: dict[str, str] = {}
        self.problems: list[str] = []
        self._pairs_of = lru_cache(1)(self._pair)
        self._paired_version = -1
        self.bars = bars  # shared by all sets of landmarks of the folder, as are the sides
        self.sides = sides
        self._invisible = StoredTable(store, "invisible")  # points by name and revision of a .pts

    def of(self, picture: File) -> Marks:
        """Return the landmarks of a picture, none if it has no file or the file belongs to another picture."""
        if self._listing.winners[picture.stem] != picture.name:
            return Marks()
        file = self._listing.own(picture)
        if file is None:
            return self._foreign().get(picture.name, Marks())
        if not self.is_read(picture):
            self._read[file.name] = (file.signature, self._read_own(file))
        return self._read[file.name][1]

    def fault_of(self, picture: File) -> str | None:
        """Return why the file of another format cannot be read for a picture without landmarks."""
        self._foreign()
        return self._faults.get(picture.name)

    def is_current(self, picture: File) -> bool:
        """Whether the listing is current for a picture: no file was added or removed, and its files are unchanged."""
        foreign = self._foreign().get(picture.name, Marks())
        others = [self._listing.own(picture), self._listing.files.get(foreign.file)]
        return self._listing.is_current(picture, *filter(None, others))

    def is_read(self, picture: File) -> bool:
        """Whether the landmark file of a picture was read before, so that :meth:`of` is quick."""
        file = self._listing.own(picture)
        return file is None or self._read.get(file.name, (None,))[0] == file.signature

    def _read_own(self, file: File) -> Marks:
        revision = ""
        try:
            data = self._bytes(self._folder.inside(file.name))
            revision = revision_of(data)
            landmarks = parse_landmark_data(file.name, data)
        except LandmarkError as fault:
            text = f"{fault} A copy is kept when you place the points again." if revision else self._folder.plain(fault)
            return Marks(file.name, revision, None, text)
        assert isinstance(landmarks, Landmarks)  # these formats hold one picture
        invisible = self._invisible.get(f"{file.name} {revision}", ())
        if max(invisible, default=0) < len(landmarks):
            landmarks = replace(landmarks, invisible=(*landmarks.invisible, *invisible))
        return Marks(file.name, revision, landmarks)

    def _foreign(self) -> dict[str, Marks]:
        """Return the landmarks of files in other formats by picture, paired as ``liaam train`` does."""
        listing = self._listing
        if self._paired_version != listing.version:
            self._paired_version, others = listing.version, tuple(listing.other_files)
            pairs = self._pairs_of(others, tuple(listing.winners.values())) if others else ({}, {}, [])
            self._paired, self._faults, self.problems = pairs
        return self._paired

    def _pair(self, others: tuple[File, ...], pictures: tuple[str, ...]) -> tuple[dict, dict, list]:
        """Pair pictures with files of other formats; return landmarks, errors by picture, and other errors."""
        root = self._folder.root
        listing = self._listing
        name_of = self._folder.name_of
        files = [root / file.name for file in others]
        samples, left_out = pair_files(root, [root / name for name in pictures], files, root / listing.place)
        marks = {}
        faults = {}
        problems = []

        @cache  # one file may hold the landmarks of all pictures
        def revision_in(file: Path) -> str | None:
            try:
                return revision_of(self._bytes(file))
            except LandmarkError as fault:  # it has changed since it was parsed
                problems.append(self._folder.plain(fault))
                return None

        for sample in samples:
            file = sample.landmark_file
            assert isinstance(sample.image, Path) and file is not None
            revision = revision_in(file)
            if revision is not None:  # of several objects in a picture, the largest comes first
                marks.setdefault(name_of(sample.image), Marks(name_of(file), revision, sample.landmarks))
        several = [name for name, mark in marks.items() if mark.landmarks is not None and mark.landmarks.others]
        if several:
            only = "of several objects in a picture, only the largest is shown and saved"
            problems.append(f"{some_names(several)}: {only}")
        for left in left_out:
            if "cannot be read" not in left.reason:
                continue
            reason = self._folder.plain(left.reason)
            picture = listing.winners.get(name_of(left.path.with_suffix("")).removeprefix(listing.place))
            if picture is None:
                problems.append(f"{name_of(left.path)}: {reason}")
            elif picture not in marks:
                faults[picture] = reason
        return marks, faults, problems

    def target(self, picture: File) -> Path:
        """Return the file to which a picture's landmarks are written."""
        file = self._listing.own(picture)
        path = self._folder.inside(f"{self._listing.place}{picture.stem}.ljson" if file is None else file.name)
        if self._listing.place:
            with disk_errors(f"{path.parent} cannot be made"):
                path.parent.mkdir(parents=True, exist_ok=True)
        return path

    def scale_of(self, picture: File) -> float | None:
        """Return the length of a pixel: in millimetres by the scale bar, or else as the landmark file has it."""
        state = self.scale_bar(picture)
        bar = state["bar"]
        return state["scale"] if bar is None else bar["length"] * UNITS[bar["unit"]] / math.dist(*bar["ends"])

    def unit_of(self, picture: File) -> str:
        """Return the unit of :meth:`scale_of`; empty if the landmark file states none."""
        landmarks = self.of(picture).landmarks
        if self.scale_bar(picture)["bar"] is not None:
            return "mm"
        return "" if landmarks is None else landmarks.unit

    def side_of(self, picture: File) -> str:
        """Return the side of the object, as a person or the landmark file says; empty if none says left or right."""
        landmarks = self.of(picture).landmarks
        said = self.sides.get(picture.name) or side_of_text("" if landmarks is None else landmarks.side)
        return said if said in SIDES else ""

    def scale_bar(self, picture: File) -> dict[str, Any]:
        """Return the ``bar`` of a picture; its ``scale`` without one; and, of a shared bar, what was ``before``."""
        landmarks = self.of(picture).landmarks
        scale = None if landmarks is None else landmarks.scale
        return self.bars.of(picture) or {"tag": picture.tag, "bar": None, "scale": scale}

    def set_bar(self, picture: File, bar: contract.Bar | None) -> None:
        """Set the scale bar of a picture; None removes it. The next :meth:`save` writes the scale."""
        self.bars.save({picture.name: {"tag": picture.tag, "bar": bar, "scale": None}})

    def share_bar(self, pictures: Sequence[File], bar: contract.Bar | None) -> None:
        """Set a scale bar that was drawn on another picture; None gives pictures the scale that they had before."""
        before = {each: self.scale_bar(each) for each in pictures}
        shared = {each.name: {"tag": each.tag, "bar": bar, "scale": None, "before": before[each]} for each in pictures}
        self.bars.save({each.name: before[each]["before"] for each in pictures} if bar is None else shared)

    def save(
        self, picture: File, template: Template, points: Sequence, invisible: Sequence[int], scale: float | None = None
    ) -> None:
        """Write a picture's landmarks, or remove its ``.ljson`` if no point is placed.

        ``scale`` is written if the picture has none. One that cannot be read, or has other points, is kept as a copy.
        """
        target = self.target(picture)
        before = self.of(picture)
        name = self._folder.name_of(target)
        if picture.name not in self.sides and (side := self.side_of(picture)):
            self.sides.save({picture.name: side})  # of a table; the file that replaces it holds none
        if before.file == name and (before.landmarks is None or len(before.landmarks) != len(template)):
            data = read_bytes(target, LandmarkError, sys.maxsize)
            copy = self._store.path(f"kept/{target.stem}.{revision_of(data)}{target.suffix}")
            write_bytes_atomically(copy, data)
        # If the .ljson were removed, a file of another format would be read again.
        is_alone = picture.name not in self._foreign()
        if not any(points) and target.suffix.lower() == ".ljson" and is_alone:
            with disk_errors(f"{target} cannot be removed"):
                target.unlink(missing_ok=True)
        else:
            landmarks = landmarks_of(template, points, invisible, self.scale_of(picture) or scale)
            landmarks = replace(landmarks, unit=self.unit_of(picture) if landmarks.scale else "")
            text = text_of(landmarks, target.suffix)
            self._remember_invisible(name, text.encode(), landmarks.invisible)
            write_text_atomically(target, text, LandmarkError)
        self._listing.renew(name)
        self._read.pop(name, None)  # the signature may not change within the clock's resolution

    def rewrite(self, name: str, text: str, before: str | None, invisible: Sequence[int]) -> None:
        """Replace a file if its revision is ``before``; leave it alone otherwise, or if its folder is gone."""
        self._read.pop(name, None)
        try:
            target = self._folder.inside(name)
            after = text.encode()
        except Refusal:  # it has become a link that leads out of the folder
            return
        if not target.parent.is_dir() or target.suffix.lower() not in OWN_SUFFIXES:
            return
        data = self._bytes(target) if target.is_file() else None
        if data != after and (None if data is None else revision_of(data)) != before:
            return
        self._remember_invisible(name, after, invisible)
        if data != after:
            write_bytes_atomically(target, after, LandmarkError)

    def rename_invisible(self, moves: Mapping[str, str]) -> None:
        """Keep the invisible points of landmark files that were renamed, by their old names."""
        names = {}
        for key in self._invisible:
            file, _, revision = key.rpartition(" ")
            if file in moves:
                names[key] = f"{moves[file]} {revision}"
        self._invisible.rename(names)

    def _bytes(self, path: Path) -> bytes:
        return read_bytes(path, LandmarkError, self._most_bytes)

    def _remember_invisible(self, name: str, data: bytes, invisible: Sequence[int]) -> None:
        """Save which points of a ``.pts`` are invisible, since the format cannot, before the file is written."""
        key = f"{name} {revision_of(data)}"
        if Path(name).suffix.lower() == ".pts" and list(invisible) != self._invisible.get(key, []):
            self._invisible.save({key: list(invisible) or None})


def revision_of_proposal(proposal: Mapping[str, Any]) -> str:
    """Return a hash of a proposal."""
    return revision_of(json.dumps(proposal, sort_keys=True).encode())


def parse_bar(data: Any) -> contract.Bar | None:
    """Parse and check a scale bar from JSON: ``ends``, ``length`` and ``unit``, or null."""
    if data is None:
        return None
    is_whole = isinstance(data, dict) and contract.Bar.__required_keys__ <= data.keys()
    bar = cast(contract.Bar, data)
    if not is_whole or bar["unit"] not in [*UNITS]:  # it may have no hash
        raise Refusal(422, f"the scale bar is not valid: send ends, length and unit, one of {', '.join(UNITS)}")
    ends = parse_points(bar["ends"], 2)
    length = bar["length"]
    if isinstance(length, bool) or not isinstance(length, int | float) or not 0 < length < LONGEST:
        raise Refusal(422, "the length of the scale bar is not valid: enter a positive number")
    if ends[0] is None or ends[1] is None or math.dist(ends[0], ends[1]) < 1:
        raise Refusal(422, "the ends of the scale bar are less than a pixel apart: draw it longer")
    return {"ends": [list(ends[0]), list(ends[1])], "length": length, "unit": bar["unit"]}
