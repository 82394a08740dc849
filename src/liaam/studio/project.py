"""A project is a folder: its pictures, their landmark files, the template, and what the studio keeps of it.

Pictures are looked up in the folder's listing and never joined to a path; a link that leads out of the folder does not
exist for the studio, neither to read nor to write. Landmarks are kept beside the picture as ``.ljson``, or in the
``.pts`` that is there, since :func:`liaam.load_folder` prefers that. A file of another format is read, never written
or removed: what is saved goes into an ``.ljson``, which comes before it.

What belongs to the studio alone lies in ``.liaam-studio``, as JSON: ``template.json``, ``proposals.json`` (places that
the model found), ``invisible.json`` (marks that a ``.pts`` cannot hold), ``change.json`` (a change of the template that
is under way), ``id`` (what a page tells folders apart by), and ``kept`` (landmark files as they were before the studio
replaced what it could not read).

A change of the template is written down whole before its first file is rewritten. From then on it counts: until all of
its files are written, landmarks are neither given nor taken, and every call tries to finish it first.
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
import re
import secrets
import threading
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from liaam.datasets.folder import PICTURE_SUFFIXES, pair_files
from liaam.errors import ImageError, LandmarkError, LiaamError
from liaam.io.atomic import write_bytes_atomically, write_text_atomically
from liaam.io.files import natural_key, read_bytes
from liaam.io.images import image_size
from liaam.io.landmarks import FORMATS, LANDMARK_SUFFIXES, Landmarks, parse_landmark_data
from liaam.photometry.encoding import as_colour
from liaam.studio.safety import Refusal
from liaam.studio.settings import Settings
from liaam.studio.template import (
    Template,
    landmarks_of,
    parse_indices,
    parse_points,
    parse_template,
    template_of,
)

STATE = ".liaam-studio"
_OWN = (".pts", ".ljson")
"""Endings that are written, in the order in which they are read."""

_UNREAD = (".gif", ".webp", ".heic", ".heif", ".avif", ".jxl", ".svg", ".psd", ".jp2", ".exr")
"""Endings of pictures that are not read, which a person may wonder about."""

_TEMPORARY = re.compile(r"\.liaam-[0-9a-f]{16}(\..*)?")
"""What :mod:`liaam.io.atomic` leaves behind where it is killed."""

_NAMED = 3
"""Files that a line about several names."""

_Signature = tuple[int, int, int]


@dataclass(frozen=True)
class _File:
    """A file of the folder, and by what a change of it shows: time, size, and the file itself."""

    name: str
    signature: _Signature

    @property
    def stem(self) -> str:
        return Path(self.name).stem

    @property
    def suffix(self) -> str:
        return Path(self.name).suffix.lower()

    @property
    def tag(self) -> str:
        """What a page tells the file's contents by."""
        return f"{self.signature[0]:x}-{self.signature[1]:x}"


@dataclass(frozen=True, eq=False)
class _Marks:
    """What the file of a picture's landmarks says."""

    file: str
    revision: str
    landmarks: Landmarks | None
    error: str | None = None


@dataclass(frozen=True)
class Annotated:
    """A picture whose landmarks are all there, to learn from."""

    name: str
    path: Path
    points: np.ndarray
    """(n, 2) float64, image pixels."""
    revision: str


class Project:
    """The folder; may be used from any thread.

    Attributes
    ----------
    root : Path
        The folder, links resolved.
    settings : Settings
    """

    def __init__(self, folder: str | os.PathLike[str], settings: Settings | None = None) -> None:
        self.settings = settings or Settings()
        self.root = checked_folder(folder)
        self._lock = threading.RLock()
        self._sizes: dict[str, tuple[_Signature, tuple[int, int] | str]] = {}
        self._read: dict[str, tuple[_Signature, _Marks]] = {}
        self._foreign: tuple[object, dict[str, _Marks], dict[str, str], list[str]] = (None, {}, {}, [])
        self._faults: dict[str, str] = {}
        self._files: dict[str, _File] = {}
        self._listed_at = 0
        self._id = ""
        self._stranded: list[str] = []
        self._writes = 0
        self._salt = secrets.token_hex(8)
        self._is_changing = True  # until it has been looked for
        self._template: Template | None = None
        self._revision_of_template = ""
        self._order = ""
        self._guess: Template | None = None
        self._guessed_of: Landmarks | None = None
        self._proposals: dict[str, dict[str, Any]] = {}
        self._invisible: dict[str, Any] = {}
        with self._lock:
            self._load()
            self._try_to_settle()

    @property
    def id(self) -> str:
        """What tells this folder from all others, wherever it is moved to; a copy of it has another."""
        with self._lock:
            if not self._id:
                known = self._read_state("id", _is_id)
                if known is None:
                    known = secrets.token_hex(16)
                    with suppress(LiaamError):  # it then holds until the studio ends
                        self._write_state("id", known)
                facts = self.root.stat()
                self._id = _hash(f"{known} {facts.st_dev} {facts.st_ino}".encode())
            return self._id

    @property
    def stamp(self) -> str:
        """Changes with the folder's files, and with what the studio keeps of it; quick to ask for."""
        with self._lock:
            self._try_to_settle()
            self._scan()
            listing = [(file.name, *file.signature) for file in self._files.values()]
            known = (self._salt, self._writes, self._is_changing, sorted(self._faults.items()), self._stranded)
            return _hash(repr((known, listing)).encode())

    # Pictures -------------------------------------------------------------------------------------

    def overview(self) -> list[dict[str, Any]]:
        """Give all pictures in natural order, as the page shows them."""
        with self._lock:
            self._try_to_settle()
            self._scan()
            ranks = self._ranks()
            return [self._picture(file, ranks) for file in self._pictures()]

    def picture(self, name: str) -> dict[str, Any]:
        """Give one picture, as the page shows it.

        Raises
        ------
        Refusal
            404 if the folder has no such picture.
        """
        with self._lock:
            return self._picture(self._find(name), self._ranks())

    def path_of(self, name: str) -> Path:
        """Path of a picture of the folder.

        Raises
        ------
        Refusal
            404 if there is none of that name, or it is a link that leads out of the folder.
        """
        with self._lock:
            return self._inside(self._find(name).name)

    def size_of(self, name: str) -> tuple[int, int]:
        """Width and height of a picture as a person sees it, from its header.

        Raises
        ------
        Refusal
            404 if there is none, 409 if it cannot be used.
        """
        with self._lock:
            return self._usable_size(self._find(name))

    def landmarks(self, name: str) -> Landmarks | None:
        """Landmarks of a picture's file, whether complete or not; None if it has none that can be read."""
        with self._lock:
            marks = self._marks_of(self._find(name))
            return None if marks is None else marks.landmarks

    def annotated(self) -> list[Annotated]:
        """Pictures that are done: all points are there."""
        with self._lock:
            self._settle()
            self._scan()
            template = self.template
            if template is None:
                return []
            found = [(file, self._marks_of(file)) for file in self._pictures() if self._fault_of(file) is None]
            return [
                Annotated(file.name, self.root / file.name, marks.landmarks.points, marks.revision)
                for file, marks in found
                if marks is not None and marks.landmarks is not None and self._is_done(file, marks, template)
            ]

    def to_propose(self, most: int) -> list[tuple[str, Path]]:
        """Name and path of pictures without a point, to propose landmarks for.

        Of a large folder some at a time, or the person would be far ahead of the model: half of them such as have a
        proposal, those that teach most first, then such as have none yet, in natural order.
        """
        with self._lock:
            self._scan()
            ranks = self._ranks()
            open_ones = [file.name for file in self._pictures() if self._fault_of(file) is None]
            blank = [name for name in open_ones if not _n_placed(self._marks_of(self._files[name]))]
            known = sorted((name for name in blank if name in ranks), key=ranks.__getitem__)
            fresh = [name for name in blank if name not in ranks]
            known = known[: max(most // 2, most - len(fresh))]
            return [(name, self.root / name) for name in (*known, *fresh[: most - len(known)])]

    @property
    def problems(self) -> list[str]:
        """What a person should know: files that cannot be read, are passed over, or belong to no picture."""
        with self._lock:
            return [*self._faults.values(), *self._foreign[3], *self._passed_over(), *self._orphans()]

    def _passed_over(self) -> list[str]:
        """Say what lies in the folder and looks like a picture but is not shown, and why."""
        unread = [file.name for file in self._files.values() if file.suffix in _UNREAD]
        kinds = Counter(Path(name).suffix.lower() for name in unread)
        lines = []
        if unread:
            endings = ", ".join(f"{count} {suffix}" for suffix, count in sorted(kinds.items()))
            lines.append(
                f"{_several(unread, 'picture')} passed over, of a format that is not read ({endings}): "
                "save as PNG or JPEG"
            )
        if self._stranded:
            lines.append(
                f"{_several(self._stranded, 'file')} passed over, as a link that leads out of the folder: "
                "put a copy in its place"
            )
        return lines

    def _orphans(self) -> list[str]:
        """Say which landmark files have no picture: perhaps one was renamed."""
        names = [file.name for (stem, _), file in self._own_files.items() if stem not in self._winners]
        if not names:
            return []
        return [
            f"{_several(names, 'landmark file')} without a picture of the same name: "
            "if the picture was renamed, rename the file too"
        ]

    # Landmarks ------------------------------------------------------------------------------------

    def marks(self, name: str) -> dict[str, Any]:
        """Landmarks of a picture as the page takes them: of its file, or as proposed, or none.

        Raises
        ------
        Refusal
            404 if there is no such picture, 409 if it cannot be used.
        """
        with self._lock:
            self._settle()
            return self._marks_json(self._find(name))

    def save_marks(self, name: str, data: Any) -> dict[str, Any]:
        """Save the landmarks of a picture, if its file is still what the page believes it to be.

        Parameters
        ----------
        name : str
        data : dict
            ``points``, ``invisible`` and ``revision``, as JSON gives them; ``template``, the revision of the template
            that they are points of, if it is to be checked.

        Returns
        -------
        dict
            ``revision`` and ``picture``. Who sends what the file says already is told so, whatever the revision: an
            answer may have been lost on its way.

        Raises
        ------
        Refusal
            404, 409 (with ``current`` where the file has changed, with ``template`` where the template has), 422; 503
            or 507 while the disk refuses.
        """
        if not isinstance(data, dict):
            raise Refusal(422, "send an object with points, invisible and revision")
        with self._lock:
            self._settle()
            file, template = self._find(name), self._needed_template()
            if "template" in data:
                self._check_revision(data["template"], f"the landmarks of {name}")
            points = parse_points(data.get("points"), len(template))
            invisible = parse_indices(data.get("invisible", []), len(template), "invisible")
            invisible = sorted(index for index in invisible if points[index] is not None)
            current = self._marks_json(file)
            same = [None if p is None else list(p) for p in points] == current["points"]
            saved = current["source"] == "file" or not any(points)
            if not (same and saved and invisible == current["invisible"]):
                if data.get("revision") != current["revision"]:
                    raise Refusal(409, _clash(name, current["revision"]), current=current)
                self._save(file, template, points, invisible)
            return {"revision": self._revision(file), "picture": self._picture(file, self._ranks())}

    def _save(self, file: _File, template: Template, points: Sequence[Any], invisible: Sequence[int]) -> None:
        if self._template is None:  # what was taken from a file is settled by the first save
            stored = {**template.as_json(), "revision": self._template_revision(), "order": self._order}
            self._write_state("template.json", stored)
            self._take_template(stored)
        target = self._target(file)
        before = self._marks_of(file)
        self._keep_unreadable(before, target, template)
        if not any(points) and target.suffix.lower() == ".ljson" and not self._has_other(file):
            _remove(self._inside(target.name))
        else:
            landmarks = landmarks_of(template, points, invisible)
            self._write_landmarks(target, landmarks)
            self._remember_invisible(target, landmarks)
        self._look_again(target.name)

    def _target(self, file: _File) -> Path:
        """File that a picture's landmarks are written to."""
        own = self._own(file)
        return self._inside(own.name if own is not None else f"{file.stem}.ljson")

    def _write_landmarks(self, target: Path, landmarks: Landmarks) -> None:
        dump = FORMATS[target.suffix.lower()].dump
        assert dump is not None
        write_text_atomically(self._inside(target.name), dump(landmarks), LandmarkError)

    def _keep_unreadable(self, before: _Marks | None, target: Path, template: Template) -> None:
        """Keep a copy of what a person may miss: a file that cannot be read, or of another number of points."""
        if before is None or before.file != target.name:
            return
        if before.landmarks is None or len(before.landmarks) != len(template):
            data = target.read_bytes()
            self._write_state(f"kept/{target.stem}.{_hash(data)}{target.suffix}", data)

    def _remember_invisible(self, target: Path, landmarks: Landmarks) -> None:
        """Keep the marks that a ``.pts`` has no place for."""
        known = {k: v for k, v in self._invisible.items() if k != target.name}
        if target.suffix.lower() == ".pts" and landmarks.invisible:
            known[target.name] = {"revision": _hash(target.read_bytes()), "points": list(landmarks.invisible)}
        if known != self._invisible:
            self._invisible = known
            self._write_state("invisible.json", known)

    def _marks_json(self, file: _File) -> dict[str, Any]:
        width, height = self._usable_size(file)
        template, marks = self.template, self._marks_of(file)
        answer: dict[str, Any] = {
            "points": [None] * (0 if template is None else len(template)),
            "invisible": [],
            "revision": None if marks is None else marks.revision,
            "source": "none",
            "tag": file.tag,
            "file": None if marks is None else marks.file,
            "covariances": None,
            "quality": None,
            "status": None,
            "doubtful": False,
            "error": None if marks is None else marks.error,
            "width": width,
            "height": height,
        }
        if marks is not None and marks.landmarks is not None and _n_placed(marks):
            points = _listed(marks.landmarks.points)
            return {**answer, "points": points, "invisible": list(marks.landmarks.invisible), "source": "file"}
        proposal = self._proposal(file)
        if proposal is None:
            return answer
        shown = ("points", "covariances", "quality", "status", "doubtful")
        return {**answer, **{key: proposal[key] for key in shown}, "source": "proposal"}

    # Template -------------------------------------------------------------------------------------

    @property
    def template(self) -> Template | None:
        """The template that was saved, or else that of the first picture with landmarks."""
        with self._lock:
            if self._template is None and not self._has_looked:
                self._has_looked = True
                self._guess = self._guessed()
            return self._template or self._guess

    def _guessed(self) -> Template | None:
        all_marks = (self._marks_of(file) for file in self._pictures())
        first = next((marks for marks in all_marks if marks is not None and marks.landmarks is not None), None)
        if first is None or first.landmarks is None:
            self._guessed_of = None
            return None
        if self._guessed_of is not first.landmarks:  # to look for symmetry takes a moment
            self._guessed_of, self._guess = first.landmarks, template_of(first.landmarks)
        return self._guess

    def save_template(self, data: Any) -> tuple[Template, bool]:
        """Take a template; landmark files follow it if ``mapping`` says from where each point comes.

        Returns
        -------
        Template
        bool
            Whether points were added, taken away or put in another order: models of before do not fit any more.

        Raises
        ------
        Refusal
            422 if it is not sound, or the number of points changes without a mapping while there are landmarks; 409,
            with ``template``, if ``revision`` is sent and is not that of the template that there is; 503 or 507 if the
            disk refuses: the change is then finished later.
        """
        template = parse_template(data, self.settings.points)
        with self._lock:
            self._settle()
            self._scan()
            old = self.template
            marks = [(file, marks) for file in self._pictures() if (marks := self._marks_of(file)) is not None]
            identity = None if old is None else list(range(len(old)))
            is_there, is_current = template == self._template, data.get("revision") == self._template_revision()
            if "revision" in data and not is_current:
                if is_there:  # sent once more: the answer may have been lost on its way
                    return template, False
                self._check_revision(data["revision"], "the template")
            mapping = _mapping(data.get("mapping"), len(template), old, bool(marks))
            if is_there and (mapping == identity or not is_current):
                return template, False
            moved = old is not None and mapping != identity
            change = self._change(template, old, mapping, marks, moved)
            self._is_changing = True
            self._write_state("change.json", change)  # from here on the change will be finished, even after a kill
            self._settle()
            return template, moved

    @property
    def order(self) -> str:
        """Changes whenever points are added, taken away or put in another order."""
        with self._lock:
            return self._order

    def template_json(self) -> dict[str, Any] | None:
        """Give the template as the page takes it, with the ``revision`` that changes are made for."""
        with self._lock:
            template = self.template
            return None if template is None else {**template.as_json(), "revision": self._template_revision()}

    def _template_revision(self) -> str | None:
        template = self.template
        if template is None:
            return None
        return self._revision_of_template or _hash(json.dumps(template.as_json()).encode())

    def _check_revision(self, revision: Any, what: str) -> None:
        """Refuse what was made for another template than there is."""
        if revision != self._template_revision():
            raise Refusal(
                409,
                f"the template was changed elsewhere since, and {what} came for the one before: look at it again",
                template=self.template_json(),
            )

    def _take_template(self, stored: Mapping[str, Any]) -> None:
        """Use a template as it is stored."""
        self._template = parse_template(stored, 10**6)
        self._revision_of_template = stored.get("revision") or ""
        self._order = stored.get("order") or ""

    def _change(
        self,
        template: Template,
        old: Template | None,
        mapping: Sequence[int | None],
        marks: list[tuple[_File, _Marks]],
        moved: bool,
    ) -> dict[str, Any]:
        """What a change of the template writes, in full: doing it twice does no harm."""
        files = []
        for file, known in marks:
            target = self._target(file)
            stays = not moved and (known.file != target.name or target.suffix.lower() == ".pts")
            if stays or old is None or known.landmarks is None or len(known.landmarks) != len(old):
                continue
            points = _listed(known.landmarks.points)
            hidden = [i for i, source in enumerate(mapping) if source in known.landmarks.invisible]
            landmarks = landmarks_of(template, [None if i is None else points[i] for i in mapping], hidden)
            dump = FORMATS[target.suffix.lower()].dump
            assert dump is not None
            text = dump(landmarks)
            before = known.revision if known.file == target.name else None
            files.append({"file": target.name, "before": before, "text": text, "invisible": hidden})
        order = secrets.token_hex(8) if moved else self._order
        stored = {**template.as_json(), "revision": secrets.token_hex(8), "order": order}
        return {"template": stored, "files": files}

    def _settle(self) -> None:
        """Finish a change of the template that is under way; nothing may be read or written between its files.

        Raises
        ------
        Refusal
            503, or 507 where there is no space: it cannot be finished yet.
        """
        if not self._is_changing:
            return
        try:
            self._finish_change()
        except (LiaamError, OSError) as fault:
            cause = fault if isinstance(fault, OSError) else fault.__cause__
            sentence = f"a change of the template cannot be finished yet ({self.plain(fault)}): it is tried again"
            self.note("change.json", sentence)
            status = fault.status if isinstance(fault, Refusal) else status_of(cause)
            raise Refusal(status, sentence) from fault

    def _try_to_settle(self) -> None:
        with suppress(Refusal):  # it has been noted
            self._settle()

    def _finish_change(self) -> None:
        """Do what ``change.json`` says, and remove it; files that somebody changed meanwhile are left alone."""
        change = self._read_state("change.json", _is_change)
        if change is None:  # none, or damaged, which is noted
            self._is_changing = False
            return
        for item in change["files"]:
            self._redo(item)
        if (change["template"].get("order") or "") != self._order:
            self.forget_proposals()
        self._write_state("template.json", change["template"])
        self._take_template(change["template"])
        _remove(self._state() / "change.json")
        self._is_changing = False
        self._read.clear()
        self._scan()

    def _redo(self, item: Mapping[str, Any]) -> None:
        try:
            target, after = self._inside(item["file"]), item["text"].encode()
        except Refusal:  # it has become a link that leads out: not ours to write
            return
        data = target.read_bytes() if target.is_file() else None
        if data != after and (None if data is None else _hash(data)) == item["before"]:
            write_bytes_atomically(target, after, LandmarkError)
        if target.suffix.lower() == ".pts" and item["invisible"]:
            self._invisible[target.name] = {"revision": _hash(after), "points": item["invisible"]}
            self._write_state("invisible.json", self._invisible)

    def read_template(self, name: str, data: bytes) -> Template:
        """Make a template of a landmark file that was sent; nothing is saved.

        Raises
        ------
        LandmarkError
            If it cannot be read.
        """
        with self._lock:
            sizes = (self._size(file) for file in self._pictures())
            size = next((size for size in sizes if not isinstance(size, str)), (640, 480))
        parsed = parse_landmark_data(Path(name).name, data, size)
        landmarks = parsed if isinstance(parsed, Landmarks) else next(iter(parsed.values()))
        if len(landmarks) > self.settings.points:
            raise Refusal(422, f"{name} has {len(landmarks)} points, more than the {self.settings.points} allowed")
        return template_of(landmarks)

    def _needed_template(self) -> Template:
        template = self.template
        if template is None:
            raise Refusal(422, "there is no template yet: define which points to place, or load a landmark file")
        return template

    # Proposals ------------------------------------------------------------------------------------

    def add_proposals(self, proposals: Mapping[str, dict[str, Any]], order: str | None = None) -> None:
        """Keep what a model found in pictures, by name.

        Parameters
        ----------
        proposals : dict of str to dict
            Each with the ``tag`` of the picture that was looked at; it counts as that of now if left out.
        order : str, optional
            :attr:`order` that they were made for; proposals for another are dropped.
        """
        with self._lock:
            if order not in (None, self._order):
                return
            tags = {name: file.tag for name, file in self._files.items()}
            self._proposals.update({name: {"tag": tags.get(name), **item} for name, item in proposals.items()})
            self._write_state("proposals.json", self._proposals)

    def forget_proposals(self) -> None:
        """Drop all proposals: they are of another template."""
        with self._lock:
            self._proposals = {}
            self._write_state("proposals.json", self._proposals)

    def _proposal(self, file: _File) -> dict[str, Any] | None:
        """Proposal for a picture that has points, and as many as the template."""
        proposal, template = self._proposal_of(file), self.template
        if proposal is None or proposal["points"] is None or template is None:
            return None
        return proposal if len(proposal["points"]) == len(template) else None

    def _proposal_of(self, file: _File) -> dict[str, Any] | None:
        """Proposal for a picture, unless another picture has taken its name since."""
        proposal = self._proposals.get(file.name)
        return proposal if proposal is not None and proposal.get("tag") == file.tag else None

    def _ranks(self) -> dict[str, int]:
        """Rank the pictures that have only a proposal: 1 teaches most (see :func:`teaching_order`)."""
        waiting = {
            file.name: proposal
            for file in self._pictures()
            if (proposal := self._proposal(file)) is not None and not _n_placed(self._marks_of(file))
        }
        return {name: rank for rank, name in enumerate(teaching_order(waiting), 1)}

    # The studio's own files -----------------------------------------------------------------------

    def state_path(self, name: str) -> Path:
        """Path of a file of the studio's own, whose folder exists then.

        Raises
        ------
        Refusal
            409 if it would lie outside the project's folder.
        """
        path = self._state() / name
        if not path.resolve().is_relative_to(self.root / STATE):
            raise Refusal(409, f"{STATE}/{name} is a link that leads elsewhere, so it is not used: remove it")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as fault:
            raise LiaamError(
                f"{path.parent} cannot be made ({fault.strerror or fault}): check the rights on the folder."
            ) from fault
        return path

    def note(self, key: str, fault: str | None) -> None:
        """Note what is wrong with a file of the studio's own, or that nothing is (any more)."""
        if fault is None:
            self._faults.pop(key, None)
        else:
            self._faults[key] = self.plain(fault)

    def read_state(self, name: str, check: Callable[[Any], bool]) -> Any:
        """Read a JSON file of the studio's own; None if there is none, or it is damaged, which is noted then."""
        with self._lock:
            return self._read_state(name, check)

    def remove_state(self, *names: str) -> None:
        """Remove files of the studio's own, if they are there."""
        with self._lock:
            for name in names:
                _remove(self.state_path(name))
            self._writes += 1

    def prepare(self) -> None:
        """Give the folder its id, and remove what a killed process left half written; no other may write now."""
        with self._lock, suppress(LiaamError, OSError):
            _ = self.id
            for folder in (self._state(), self._state() / "kept"):
                for path in list(folder.iterdir()):
                    if _TEMPORARY.fullmatch(path.name) and path.is_file() and not path.is_symlink():
                        path.unlink()

    def write_state(self, name: str, content: Any) -> None:
        """Write a JSON file of the studio's own, all or nothing."""
        with self._lock:
            self._write_state(name, content)

    def _load(self) -> None:
        self._scan()
        data = self._read_state("template.json", _is_template)
        if data is not None:
            self._take_template(data)
        self._proposals = self._read_state("proposals.json", _are_proposals) or {}
        self._invisible = self._read_state("invisible.json", _is_invisible) or {}
        self._read.clear()  # read before what is invisible was known

    def _state(self) -> Path:
        folder = self.root / STATE
        if folder.is_symlink() or (folder.exists() and not folder.is_dir()):
            raise Refusal(409, f"{STATE} is a link or a file where the studio keeps a folder: remove it")
        return folder

    def _write_state(self, name: str, content: Any) -> None:
        data = content if isinstance(content, bytes) else json.dumps(content, ensure_ascii=False).encode()
        write_bytes_atomically(self.state_path(name), data)
        self._writes += name != "id"  # which changes nothing that is shown
        self.note(name, None)

    def _read_state(self, name: str, check: Callable[[Any], bool]) -> Any:
        self.note(name, None)
        try:
            path = self._state() / name
        except Refusal as refusal:
            self.note(STATE, str(refusal))
            return None
        try:
            if not path.is_file():
                return None
            content = json.loads(self.state_path(name).read_bytes())
            json.dumps(content, allow_nan=False)  # NaN, too, is no JSON that the page could read
            if check(content):
                return content
            fault: object = "it is not of the studio's making"
        except (OSError, ValueError, RecursionError, LiaamError, KeyError, TypeError, AttributeError) as error:
            fault = error
        self.note(name, f"{STATE}/{name} cannot be read ({fault}), so it is passed over: remove it, or mend it")
        return None

    # The listing ----------------------------------------------------------------------------------

    def _scan(self) -> None:
        """List the folder."""
        self._listed_at = self._folder_time()  # before: what comes meanwhile will be noticed
        self._stranded = []
        try:
            with os.scandir(self.root) as entries:
                found = [self._entry(entry) for entry in entries if not entry.name.startswith(".")]
        except OSError as fault:
            raise Refusal(
                503, f"{self.root.name} cannot be read ({fault.strerror or fault}): is the folder still there?"
            ) from fault
        files = sorted((file for file in found if file is not None), key=lambda file: natural_key(file.name))
        self._files = {file.name: file for file in files}
        self._arrange()

    def _arrange(self) -> None:
        """Sort the listing into pictures, landmark files of the studio's formats, and others."""
        files = self._files.values()
        self._picture_files = [file for file in files if file.suffix in PICTURE_SUFFIXES]
        self._own_files = {(file.stem, file.suffix): file for file in files if file.suffix in _OWN}
        self._other_files = [file for file in files if file.suffix in LANDMARK_SUFFIXES and file.suffix not in _OWN]
        self._winners: dict[str, str] = {}
        for file in sorted(self._picture_files, key=lambda file: PICTURE_SUFFIXES.index(file.suffix)):
            self._winners.setdefault(file.stem, file.name)
        self._has_looked = self._has_paired = False

    def _entry(self, entry: os.DirEntry[str]) -> _File | None:
        """One file of the listing; None for folders, links that lead out, and what has gone or cannot be named."""
        try:
            entry.name.encode()
            if entry.is_symlink() and not self._leads_inside(Path(entry.path)):
                if Path(entry.name).suffix.lower() in (*PICTURE_SUFFIXES, *LANDMARK_SUFFIXES):
                    self._stranded.append(entry.name)
                return None
            if not entry.is_file():
                return None
            facts = entry.stat()
        except (OSError, UnicodeEncodeError):
            return None
        return _File(entry.name, (facts.st_mtime_ns, facts.st_size, facts.st_ino))

    def _leads_inside(self, path: Path) -> bool:
        real = Path(os.path.realpath(path))
        return real.is_relative_to(self.root) and STATE not in real.relative_to(self.root).parts

    def _inside(self, name: str) -> Path:
        """Path of a file of the folder itself, which a link does not lead out of it."""
        path = self.root / name
        if path.name != name or not self._leads_inside(path):
            raise Refusal(409, f"{name} is a link that leads out of the folder, so it is not used: remove the link")
        return path

    def _look_again(self, name: str) -> None:
        """Renew what is known of one file of the folder."""
        try:
            facts = (self.root / name).stat()
            self._files[name] = _File(name, (facts.st_mtime_ns, facts.st_size, facts.st_ino))
        except OSError:
            self._files.pop(name, None)
        self._listed_at = self._folder_time()
        self._read.pop(name, None)  # a write within the clock's resolution does not show in the signature
        self._arrange()

    def _find(self, name: str) -> _File:
        """Find a picture in the listing, which is made anew if anything about the picture has changed."""
        file = self._files.get(name)
        if file is None or not self._is_listed(file):
            self._scan()
            file = self._files.get(name)
        if file is None or file.suffix not in PICTURE_SUFFIXES:
            raise Refusal(404, f"the folder has no picture '{name[:200]}': reload the page")
        return file

    def _is_listed(self, file: _File) -> bool:
        """Whether the listing holds what there is of a picture: no file has come or gone, and its own are the same."""
        marks = self._foreign_marks().get(file.name)
        others = [self._own(file), None if marks is None else self._files.get(marks.file)]
        known = [file, *(other for other in others if other is not None)]
        return self._listed_at == self._folder_time() and all(map(self._is_current, known))

    def _folder_time(self) -> int:
        """When an entry of the folder came or went last."""
        try:
            return self.root.stat().st_mtime_ns
        except OSError:
            return 0

    def _is_current(self, file: _File) -> bool:
        try:
            facts = (self.root / file.name).stat()
        except OSError:
            return False
        return file.signature == (facts.st_mtime_ns, facts.st_size, facts.st_ino)

    def _pictures(self) -> list[_File]:
        return self._picture_files

    def _picture(self, file: _File, ranks: Mapping[str, int]) -> dict[str, Any]:
        size, fault, marks = self._size(file), self._fault_of(file), self._marks_of(file)
        template, proposal = self.template, self._proposal(file)
        placed = _n_placed(marks)
        waiting = proposal is not None and not placed and fault is None
        if fault is not None:
            state = "broken"
        elif placed:
            state = "done" if self._is_done(file, marks, template) else "partial"
        else:
            state = "proposed" if waiting else "new"
        return {
            "name": file.name,
            "tag": file.tag,
            "state": state,
            "placed": placed,
            "error": fault or self._error_of(file, marks, template),
            "width": None if isinstance(size, str) else size[0],
            "height": None if isinstance(size, str) else size[1],
            "uncertainty": proposal["uncertainty"] if waiting and proposal else None,
            "doubtful": bool(waiting and proposal and proposal["doubtful"]),
            "rank": ranks.get(file.name) if waiting else None,
        }

    def _error_of(self, file: _File, marks: _Marks | None, template: Template | None) -> str | None:
        """What is wrong with the landmarks of a picture that can be shown."""
        if marks is None:
            proposal = self._proposal_of(file)
            failed = proposal is not None and proposal["points"] is None
            return self._foreign[2].get(file.name) or (proposal["message"] if proposal and failed else None)
        if marks.landmarks is not None and template is not None and len(marks.landmarks) != len(template):
            return (
                f"{marks.file} has {len(marks.landmarks)} points where the template has {len(template)}: "
                "place the points anew, or remove that file"
            )
        return marks.error or self._misplaced(file, marks)

    def _is_done(self, file: _File, marks: _Marks | None, template: Template | None) -> bool:
        """Whether a picture has all of its points, and they are of that picture."""
        return _is_complete(marks, template) and marks is not None and self._misplaced(file, marks) is None

    def _misplaced(self, file: _File, marks: _Marks) -> str | None:
        """Say so if most points lie outside the picture: they are of another one."""
        size = self._size(file)
        if isinstance(size, str) or marks.landmarks is None:
            return None
        placed = marks.landmarks.points[~marks.landmarks.missing]
        n_outside = int(((placed < -0.5) | (placed > np.array(size) - 0.5)).any(axis=1).sum())
        if 2 * n_outside <= len(placed):
            return None
        return (
            f"{n_outside} of the {len(placed)} points of {marks.file} lie outside the picture of "
            f"{size[0]} x {size[1]} pixels, which may have been replaced: place them anew, or put the picture back"
        )

    def _fault_of(self, file: _File) -> str | None:
        """Why a picture cannot be used."""
        winner = self._winners[file.stem]
        if winner != file.name:
            return f"{winner} has the same name but for its ending, and landmark files tell by the name: rename one"
        size = self._size(file)
        return size if isinstance(size, str) else None

    def plain(self, fault: object) -> str:
        """Text of a fault with names instead of paths: the page knows the folder by its name."""
        name = self.root.name or "the folder"
        return str(fault).replace(f"{self.root}{os.sep}", "").replace(str(self.root), name)

    def _usable_size(self, file: _File) -> tuple[int, int]:
        fault, size = self._fault_of(file), self._size(file)
        if fault is not None or isinstance(size, str):
            raise Refusal(409, f"{file.name} cannot be used: {fault or size}")
        return size

    def _size(self, file: _File) -> tuple[int, int] | str:
        """Size of a picture from its header, or why it has none."""
        known = self._sizes.get(file.name)
        if known is None or known[0] != file.signature:
            known = self._sizes[file.name] = (file.signature, self._read_size(file))
        return known[1]

    def _read_size(self, file: _File) -> tuple[int, int] | str:
        try:
            width, height = image_size(self._inside(file.name))
        except LiaamError as fault:
            return self.plain(fault)
        if width * height > self.settings.pixels:
            return (
                f"{file.name} has {width} x {height} pixels, more than the {self.settings.pixels:,} allowed: "
                "make the picture smaller"
            )
        try:
            as_colour(np.broadcast_to(np.uint8(0), (height, width, 3)), file.name)
        except ImageError as fault:
            return str(fault)
        return width, height

    # Landmark files -------------------------------------------------------------------------------

    def _own(self, file: _File) -> _File | None:
        """Landmark file of a picture in a format that the studio writes."""
        return next((own for suffix in _OWN if (own := self._own_files.get((file.stem, suffix))) is not None), None)

    def _marks_of(self, file: _File) -> _Marks | None:
        if self._winners[file.stem] != file.name:
            return None
        own = self._own(file)
        return self._foreign_marks().get(file.name) if own is None else self._own_marks(own)

    def _revision(self, file: _File) -> str | None:
        marks = self._marks_of(file)
        return None if marks is None else marks.revision

    def _has_other(self, file: _File) -> bool:
        """Whether a file of another format would show again if the studio's own were removed."""
        return file.name in self._foreign_marks()

    def _own_marks(self, own: _File) -> _Marks:
        known = self._read.get(own.name)
        if known is None or known[0] != own.signature:
            known = self._read[own.name] = (own.signature, self._read_marks(own))
        return known[1]

    def _read_marks(self, own: _File) -> _Marks:
        try:
            data = read_bytes(self._inside(own.name), LandmarkError, self.settings.upload_bytes)
        except LandmarkError as fault:
            return _Marks(own.name, "", None, self.plain(fault))
        revision = _hash(data)
        try:
            landmarks = parse_landmark_data(own.name, data)
        except LandmarkError as fault:
            return _Marks(own.name, revision, None, f"{fault} A copy is kept when you place points anew.")
        assert isinstance(landmarks, Landmarks)  # these formats are of one picture
        marks = self._invisible.get(own.name)
        if marks is not None and marks["revision"] == revision and max(marks["points"], default=0) < len(landmarks):
            landmarks = replace(landmarks, invisible=tuple(marks["points"]))
        return _Marks(own.name, revision, landmarks)

    def _foreign_marks(self) -> dict[str, _Marks]:
        """Landmarks by picture of all files that are read only, paired as ``liaam train`` pairs them."""
        if self._has_paired:
            return self._foreign[1]
        self._has_paired = True
        if not self._other_files:
            self._foreign = (None, {}, {}, [])
            return {}
        images = [self.root / name for name in self._winners.values()]
        key = (tuple(self._other_files), tuple(images))
        if self._foreign[0] != key:
            self._foreign = (key, *self._pair(images))
        return self._foreign[1]

    def _pair(self, images: list[Path]) -> tuple[dict[str, _Marks], dict[str, str], list[str]]:
        """Pair pictures with files of other formats: landmarks, faults by picture, and faults of other files."""
        samples, left_out = pair_files(self.root, images, [self.root / file.name for file in self._other_files])
        marks, revisions = {}, {}
        for sample in samples:
            file = sample.landmark_file
            assert isinstance(sample.image, Path)
            assert file is not None
            if file not in revisions:  # one file may be of all pictures
                revisions[file] = _hash(file.read_bytes())
            marks[sample.image.name] = _Marks(file.name, revisions[file], sample.landmarks)
        faults, problems = {}, []
        for left in left_out:
            if "cannot be read" not in left.reason:
                continue
            reason = self.plain(left.reason)
            picture = self._winners.get(left.path.stem)
            if picture is None:
                problems.append(f"{left.path.name}: {reason}")
            elif picture not in marks:
                faults[picture] = reason
        return marks, faults, problems


def teaching_order(proposals: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Order pictures by how much their annotation would teach the model; the one place that says so.

    First those where the object was surely found but the fit failed or is doubtful: the object is there, and looks as
    no training picture does. Then by uncertainty, highest first: mean deviation of the landmarks as a share of the
    object's size. Last those where the search itself is doubtful: most often the object is hidden, cut off or not
    there, which costs a person much work and teaches the model little.

    Parameters
    ----------
    proposals : dict of str to dict
        By the picture's name, with ``found`` (whether the search is sure), ``ok`` and ``uncertainty``.
    """

    def key(name: str) -> tuple[int, float]:
        proposal = proposals[name]
        group = 2 if not proposal["found"] else int(bool(proposal["ok"]))
        return group, -(proposal["uncertainty"] or 0.0)

    return sorted(proposals, key=key)


def checked_folder(folder: str | os.PathLike[str]) -> Path:
    """Give a folder with links resolved, if pictures can be kept in it.

    Raises
    ------
    ImageError
        If it is none, or cannot be read or written.
    """
    folder = Path(folder)
    try:
        if not folder.is_dir():
            what = "is a file, not a folder" if folder.exists() else "does not exist"
            raise ImageError(f"{folder} {what}: name the folder that holds the pictures.")
        with os.scandir(folder):
            pass
    except OSError as fault:
        raise ImageError(f"{folder} cannot be read ({fault.strerror or fault}): check the rights on it.") from fault
    if not os.access(folder, os.W_OK | os.X_OK):
        raise ImageError(f"{folder} cannot be written to: check the rights on it; landmarks are saved beside pictures.")
    return folder.resolve()


def _mapping(data: Any, n: int, old: Template | None, has_marks: bool) -> list[int | None]:
    """Index of each point before the change, None for a new one."""
    if old is None:
        return [None] * n
    if data is None:
        if has_marks and len(old) != n:
            raise Refusal(
                422,
                f"the template had {len(old)} points and now has {n}, but pictures have landmarks: "
                "send a mapping that says which point was which",
            )
        return [i if i < len(old) else None for i in range(n)]
    if not isinstance(data, list) or len(data) != n:
        raise Refusal(422, f"the mapping has to say for each of the {n} points which it was, or null for a new one")
    parse_indices([index for index in data if index is not None], len(old), "mapping")
    return data


def status_of(fault: BaseException | None) -> int:
    """Status to answer with where the disk refuses: 507 where it is full, 503 otherwise. To try again may help."""
    return 507 if isinstance(fault, OSError) and fault.errno in (errno.ENOSPC, errno.EDQUOT) else 503


def _remove(path: Path) -> None:
    """Remove a file, if it is there."""
    try:
        path.unlink(missing_ok=True)
    except OSError as fault:
        raise LiaamError(f"{path} cannot be removed ({fault.strerror or fault}): check the rights on it.") from fault


def _clash(name: str, revision: str | None) -> str:
    """Say what happened to landmarks that a page believes to be others."""
    if revision is None:
        return f"the landmark file of {name} was deleted since: save it again, or leave it deleted"
    return f"{name} was changed elsewhere since: look at its landmarks"


def _several(names: Sequence[str], what: str) -> str:
    """Count files, and name the first few."""
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    return f"{len(names)} {what}{'s' if len(names) > 1 else ''} ({', '.join(names[:_NAMED])}{more})"


def _hash(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()[:16]


def _listed(points: np.ndarray) -> list[list[float] | None]:
    return [None if x != x else [round(x, 3), round(y, 3)] for x, y in points.tolist()]


def _n_placed(marks: _Marks | None) -> int:
    return 0 if marks is None or marks.landmarks is None else int((~marks.landmarks.missing).sum())


def _is_complete(marks: _Marks | None, template: Template | None) -> bool:
    return template is not None and marks is not None and _n_placed(marks) == len(template) == _n_points(marks)


def _n_points(marks: _Marks) -> int:
    return 0 if marks.landmarks is None else len(marks.landmarks)


def _is_id(data: Any) -> bool:
    return isinstance(data, str) and 16 <= len(data) <= 64


def _is_template(data: Any) -> bool:
    known = all(data.get(key) is None or isinstance(data[key], str) for key in ("revision", "order"))
    return known and bool(parse_template(data, 10**6))


def _is_change(data: Any) -> bool:
    keys = {"file", "before", "text", "invisible"}
    sound = all(set(item) == keys and isinstance(item["text"], str) and _is_own(item["file"]) for item in data["files"])
    return sound and _is_template(data["template"])


def _is_own(name: str) -> bool:
    """Whether a name is that of a landmark file of the folder itself, in a format that is written."""
    return Path(name).name == name and Path(name).suffix.lower() in _OWN


def _is_invisible(data: Any) -> bool:
    return all(isinstance(item["revision"], str) and all(i >= 0 for i in item["points"]) for item in data.values())


def _are_proposals(data: Any) -> bool:
    return all(is_proposal(item) for item in data.values())


def is_proposal(item: Any) -> bool:
    """Whether JSON is a proposal as :mod:`liaam.studio.training` makes them."""
    keys = {"points", "covariances", "quality", "status", "ok", "message", "found", "doubtful", "uncertainty"}
    if set(item) - {"tag"} != keys or not isinstance(item["message"], str):
        return False
    if item["uncertainty"] is not None and not isinstance(item["uncertainty"], int | float):
        return False
    return item["points"] is None or None not in parse_points(item["points"], len(item["points"]))
