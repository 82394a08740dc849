"""A project is a folder: its pictures, their landmark files, the template, and what the studio keeps of it.

:class:`Project` is what the rest of the studio asks, from any thread. Its parts know nothing of threads, and of each
other only what stands before them in this list:

- :mod:`~liaam.studio.folder`: which paths may be touched; :mod:`~liaam.studio.state_files`: the studio's own files;
- :mod:`~liaam.studio.listing`: which pictures there are, and which can be used;
- :mod:`~liaam.studio.landmark_files`: what the landmark files say, and how they are written;
- :mod:`~liaam.studio.proposals`: what the model found;
- :mod:`~liaam.studio.template_store`: the template; :mod:`~liaam.studio.template_change`: its changes;
- :mod:`~liaam.studio.picture_states`: how far each picture is.
"""

from __future__ import annotations

import os
import secrets
import threading
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from liaam.datasets.folder import PICTURE_SUFFIXES
from liaam.errors import LiaamError
from liaam.io.landmarks import Landmarks, parse_landmark_data
from liaam.studio.folder import Folder, checked_folder, revision_of
from liaam.studio.landmark_files import LandmarkFiles, n_placed
from liaam.studio.listing import File, Listing
from liaam.studio.picture_states import PictureStates
from liaam.studio.proposals import Proposals
from liaam.studio.safety import Refusal
from liaam.studio.settings import Settings
from liaam.studio.state_files import StateFiles
from liaam.studio.template import Template, parse_indices, parse_points, parse_template, template_of
from liaam.studio.template_change import TemplateChanges
from liaam.studio.template_store import TemplateStore


@dataclass(frozen=True)
class Annotated:
    """A picture whose landmarks are all there, to learn from."""

    name: str
    path: Path
    points: np.ndarray
    """(n, 2) float64, image pixels."""
    revision: str


@dataclass(frozen=True)
class Overview:
    """All of a project's pictures, of one listing of the folder."""

    stamp: str
    """:attr:`Project.stamp` of then."""
    pictures: list[dict[str, Any]]
    """In natural order, as the page shows them."""
    done: dict[str, str]
    """Revision of the landmarks of each picture that is done, by name."""


class Project:
    """The folder; may be used from any thread.

    Attributes
    ----------
    root : Path
        The folder, links resolved.
    settings : Settings
    state : StateFiles
        The studio's own files in it.
    """

    def __init__(self, folder: str | os.PathLike[str], settings: Settings | None = None) -> None:
        self.settings = settings or Settings()
        self._folder = Folder(checked_folder(folder))
        self.root = self._folder.root
        self.state = StateFiles(self._folder)
        self._lock = threading.RLock()
        self._salt = secrets.token_hex(8)
        self._listing = listing = Listing(self._folder, self.settings.pixels)
        listing.scan()
        self._landmarks = LandmarkFiles(listing, self.state, self.settings.upload_bytes)
        self._proposals = Proposals(listing, self.state)
        self._templates = TemplateStore(listing, self.state, self._landmarks)
        self._states = PictureStates(listing, self._landmarks, self._proposals, self._templates)
        self._changes = TemplateChanges(listing, self.state, self._landmarks, self._proposals, self._templates)
        self._changes.try_to_settle()

    @property
    def id(self) -> str:
        """What tells this folder from all others, wherever it is moved to; a copy of it has another."""
        return self.state.id

    @property
    def stamp(self) -> str:
        """Changes with the folder's files, and with what the studio keeps of it; quick to ask for."""
        with self._lock:
            self._look()
            return self._stamp()

    def check_id(self, data: Any) -> None:
        """Refuse what a page sends that is another folder's, as it says in ``folder`` of its request.

        Raises
        ------
        Refusal
            409, with this folder's id in ``folder``.
        """
        if isinstance(data, dict) and data.get("folder", self.id) != self.id:
            raise Refusal(
                409, "the studio shows another folder now than this page was opened on: reload the page", folder=self.id
            )

    def prepare(self) -> None:
        """Give the folder its id, and remove what a killed process left half written."""
        with self._lock, suppress(LiaamError, OSError):
            _ = self.id
            self.state.sweep()

    def plain(self, fault: object) -> str:
        """Text of a fault with names instead of paths: the page knows the folder by its name."""
        return self._folder.plain(fault)

    @property
    def problems(self) -> list[str]:
        """What a person should know: files that cannot be read, are passed over, or belong to no picture."""
        with self._lock:
            listing = self._listing
            return [
                *self.state.faults.values(),
                *self._landmarks.problems,
                *listing.passed_over(),
                *listing.orphans(),
            ]

    def _look(self) -> None:
        """List the folder anew, for who only looks."""
        self._changes.try_to_settle()
        self._listing.scan()

    def _stamp(self) -> str:
        listing, state = self._listing, self.state
        files = [(file.name, *file.signature) for file in listing.files.values()]
        faults = sorted(state.faults.items())
        known = (self._salt, state.writes, self._changes.is_pending, faults, listing.stranded)
        return revision_of(repr((known, files)).encode())

    # Pictures -------------------------------------------------------------------------------------

    def overview(self) -> Overview:
        """Give all pictures."""
        with self._lock:
            self._look()
            return self._overview()

    def overview_since(self, stamp: str | None) -> Overview | None:
        """Give all pictures, or None if nothing has changed since a :attr:`stamp`."""
        with self._lock:
            self._look()
            return None if self._stamp() == stamp else self._overview()

    def _overview(self) -> Overview:
        ranks = self._states.ranks()
        return Overview(
            self._stamp(),
            [self._states.as_json(file, ranks) for file in self._listing.pictures],
            {item.name: item.revision for item in self._annotated()},
        )

    def path_of(self, name: str) -> Path:
        """Path of a picture of the folder.

        Raises
        ------
        Refusal
            404 if there is none of that name, or it is a link that leads out of the folder.
        """
        with self._lock:
            return self._folder.inside(self._find(name).name)

    def size_of(self, name: str) -> tuple[int, int]:
        """Width and height of a picture as a person sees it, from its header.

        Raises
        ------
        Refusal
            404 if there is none, 409 if it cannot be used.
        """
        with self._lock:
            return self._listing.usable_size(self._find(name))

    def annotated(self) -> list[Annotated]:
        """Pictures that are done: all points are there.

        Raises
        ------
        Refusal
            503 or 507 while a change of the template cannot be finished.
        """
        with self._lock:
            self._changes.settle()
            self._listing.scan()
            return self._annotated()

    def _annotated(self) -> list[Annotated]:
        found = [(file, self._landmarks.of(file)) for file in self._listing.usable() if self._states.is_done(file)]
        return [
            Annotated(file.name, self.root / file.name, marks.landmarks.points, marks.revision)
            for file, marks in found
            if marks is not None and marks.landmarks is not None
        ]

    def to_propose(self, most: int) -> list[tuple[str, Path]]:
        """Name and path of pictures without a point, to propose landmarks for.

        Of a large folder some at a time, or the person would be far ahead of the model: half of them such as have a
        proposal, those that teach most first, then such as have none yet, in natural order.
        """
        with self._lock:
            self._listing.scan()
            ranks = self._states.ranks()
            blank = [file.name for file in self._listing.usable() if not n_placed(self._landmarks.of(file))]
            known = sorted((name for name in blank if name in ranks), key=ranks.__getitem__)
            fresh = [name for name in blank if name not in ranks]
            known = known[: max(most // 2, most - len(fresh))]
            return [(name, self.root / name) for name in (*known, *fresh[: most - len(known)])]

    def _find(self, name: str) -> File:
        """Find a picture in the listing, which is made anew if anything about the picture has changed."""
        file = self._listing.files.get(name)
        if file is None or not self._landmarks.is_current(file):
            self._listing.scan()
            file = self._listing.files.get(name)
        if file is None or file.suffix not in PICTURE_SUFFIXES:
            raise Refusal(404, f"the folder has no picture '{name[:200]}': reload the page")
        return file

    # Landmarks ------------------------------------------------------------------------------------

    def landmarks(self, name: str) -> Landmarks | None:
        """Landmarks of a picture's file, whether complete or not; None if it has none that can be read."""
        with self._lock:
            marks = self._landmarks.of(self._find(name))
            return None if marks is None else marks.landmarks

    def marks(self, name: str) -> dict[str, Any]:
        """Landmarks of a picture as the page takes them: of its file, or as proposed, or none.

        Raises
        ------
        Refusal
            404 if there is no such picture, 409 if it cannot be used.
        """
        with self._lock:
            self._changes.settle()
            return self._states.marks_json(self._find(name))

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
            self._changes.settle()
            file, template = self._find(name), self._templates.needed
            if "template" in data:
                self._templates.check(data["template"], f"the landmarks of {name}")
            points = parse_points(data.get("points"), len(template))
            invisible = parse_indices(data.get("invisible", []), len(template), "invisible")
            invisible = sorted(index for index in invisible if points[index] is not None)
            current = self._states.marks_json(file)
            same = [None if p is None else list(p) for p in points] == current["points"]
            saved = current["source"] == "file" or not any(points)
            if not (same and saved and invisible == current["invisible"]):
                if data.get("revision") != current["revision"]:
                    raise Refusal(409, _clash(name, current["revision"]), current=current)
                self._templates.keep()  # what was taken from a file is settled by the first save
                self._landmarks.save(file, template, points, invisible)
            revision = self._landmarks.revision(file)
            return {"revision": revision, "picture": self._states.as_json(file, self._states.ranks())}

    # Template -------------------------------------------------------------------------------------

    @property
    def template(self) -> Template | None:
        """The template that was saved, or else that of the first picture with landmarks."""
        with self._lock:
            return self._templates.current

    @property
    def order(self) -> str:
        """Changes whenever points are added, taken away or put in another order."""
        with self._lock:
            return self._templates.order

    def template_json(self) -> dict[str, Any] | None:
        """Give the template as the page takes it, with the ``revision`` that changes are made for."""
        with self._lock:
            return self._templates.as_json()

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
            return template, self._changes.save(template, data)

    def read_template(self, name: str, data: bytes) -> Template:
        """Make a template of a landmark file that was sent; nothing is saved.

        Raises
        ------
        LandmarkError
            If it cannot be read.
        """
        with self._lock:
            sizes = (self._listing.size_of(file) for file in self._listing.pictures)
            size = next((size for size in sizes if not isinstance(size, str)), (640, 480))
        parsed = parse_landmark_data(Path(name).name, data, size)
        landmarks = parsed if isinstance(parsed, Landmarks) else next(iter(parsed.values()))
        if len(landmarks) > self.settings.points:
            raise Refusal(422, f"{name} has {len(landmarks)} points, more than the {self.settings.points} allowed")
        return template_of(landmarks)

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
            if order in (None, self._templates.order):
                self._proposals.add(proposals)


def _clash(name: str, revision: str | None) -> str:
    """Say what happened to landmarks that a page believes to be others."""
    if revision is None:
        return f"the landmark file of {name} was deleted since: save it again, or leave it deleted"
    return f"{name} was changed elsewhere since: look at its landmarks"
