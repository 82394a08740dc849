"""The landmark template: the points of an object, their names, contours and symmetry; and that of a project.

The template of a project is the saved one, or else that of the first picture with landmarks, or else that of a model.
A change of it and of all landmark files with it is one transaction that survives a killed process: the whole change is
stored before the first landmark file is rewritten. Until all files are written, landmarks can be neither read nor
saved, and every call tries to finish the change first.
"""

import json
import secrets
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from liaam.errors import LiaamError
from liaam.io.files import real_path
from liaam.io.landmarks import Contour, Landmarks
from liaam.io.landmarks.formats import writer_of
from liaam.morphometry.curves import semilandmarks
from liaam.morphometry.pairs import twins_by_names, twins_by_place
from liaam.studio import contract
from liaam.studio.contract import OMITTED, given
from liaam.studio.folder import Folder, Listing, revision_of, status_of
from liaam.studio.measuring import MEASURING, followed, kept_in
from liaam.studio.refusal import Refusal, refusing
from liaam.studio.store import Store, StoredTable

if TYPE_CHECKING:
    from liaam.studio.landmark_files import LandmarkFiles

LONGEST_NAME = 100
FARTHEST = 1e6  # maximum absolute coordinate in pixels
_MOST = 10**6  # maximum number of points of a stored template, above that of a new one, so that it can always be read
LANDMARK: contract.Kind = "landmark"
SEMILANDMARK: contract.Kind = "semilandmark"
KINDS = (LANDMARK, SEMILANDMARK)
"""Kinds of points. Semilandmarks slide along a curve: tracing and spacing it move them, and no landmarks."""


@dataclass(frozen=True)
class Template:
    """The points that are placed on every picture of a project."""

    names: tuple[str, ...]  # unique name of each point
    contours: tuple[Contour, ...] = ()
    mirror: tuple[int, ...] | None = None  # index of each point's twin (itself on the axis); None without symmetry
    points: tuple[tuple[float, float], ...] | None = None  # typical layout, in any units
    kinds: tuple[contract.Kind, ...] = ()  # :data:`KINDS` of the points; if none are given, all are landmarks

    def __post_init__(self) -> None:
        object.__setattr__(self, "kinds", self.kinds or (LANDMARK,) * len(self.names))

    def __len__(self) -> int:
        return len(self.names)

    def as_json(self) -> contract.Template:
        """Return the template as JSON for :func:`parse_template`."""
        return {
            "names": [*self.names],
            "contours": [_contour_json(contour) for contour in self.contours],
            "mirror": None if self.mirror is None else [*self.mirror],
            "points": None if self.points is None else [[*point] for point in self.points],
            "kinds": [*self.kinds],
        }


def _contour_json(contour: Contour) -> contract.Contour:
    named: contract.Contour = {"indices": [*contour.indices], "closed": contour.closed}
    return {**named, "name": contour.name} if contour.name else named


def parse_template(data: Any, most: int) -> Template:
    """Parse and check a template from JSON."""
    if not isinstance(data, dict):
        raise Refusal(422, "the template is not an object: send names, contours, mirror and points")
    asked = given(contract.SaveTemplate, data)
    names = _parse_names(asked.names, most)
    n = len(names)
    points = None if asked.points is None else parse_points(asked.points, n)
    layout = None if points is None else tuple(point for point in points if point is not None)
    if layout is not None and len(layout) < n:
        raise Refusal(422, "the template's layout lacks a point: place all points, or send null for the layout")
    mirror = _parse_mirror(asked.mirror, n)
    contours = _parse_contours(asked.contours, n)
    return Template(names, contours, mirror, layout, _parse_kinds(asked.kinds, names, contours))


def _parse_names(data: Any, most: int) -> tuple[str, ...]:
    """Check the names of at most so many points."""
    if not isinstance(data, list) or not data or not all(isinstance(name, str) and name.strip() for name in data):
        raise Refusal(422, "the template has no valid list of names: give every point a name")
    names = tuple(name.strip() for name in data)
    if not all(name.isprintable() for name in names):  # such as half of a surrogate pair, which no file can store
        raise Refusal(422, "a point's name has unprintable characters: give it another name")
    if len(names) > most:
        raise Refusal(422, f"the template has {len(names)} points, more than the {most} allowed: remove some")
    if max(map(len, names)) > LONGEST_NAME:
        raise Refusal(422, f"a point's name has more than {LONGEST_NAME} characters: shorten it")
    duplicate = next((name for i, name in enumerate(names) if name in names[:i]), None)
    if duplicate is not None:
        raise Refusal(422, f"two points have the name '{duplicate}': rename one")
    return names


def _parse_mirror(data: Any, n: int) -> tuple[int, ...] | None:
    """Check the twins of n points."""
    if data is None:
        return None
    mirror = tuple(parse_indices(data, n, "mirror"))
    if len(mirror) != n or any(mirror[mirror[i]] != i for i in range(n)):
        raise Refusal(422, "mirror does not pair the points: if b is the twin of a, a must be the twin of b")
    return mirror


def _parse_contours(data: list[contract.Contour] | None, n: int) -> tuple[Contour, ...]:
    """Check the contours through n points."""
    sent = [] if data is None else data
    if not isinstance(sent, list) or len(sent) > n:
        raise Refusal(422, f"the template's contours are not valid: send a list of at most {n} contours")
    contours = []
    for i, item in enumerate(sent, 1):
        is_whole = isinstance(item, dict) and contract.Contour.__required_keys__ <= item.keys()
        if not is_whole or not isinstance(item["closed"], bool):
            raise Refusal(422, f"contour {i} is not valid: send {{indices, closed}}")
        indices = parse_indices(item["indices"], n, f"contour {i}")
        if len(indices) < 2:
            raise Refusal(422, f"contour {i} has fewer than 2 points: add one, or remove the contour")
        contours.append(Contour(tuple(indices), item["closed"], _parse_name_of_curve(item.get("name", ""), i)))
    called = [contour.name.casefold() for contour in contours if contour.name]
    duplicate = next((contour.name for contour in contours if called.count(contour.name.casefold()) > 1), None)
    if duplicate is not None:
        raise Refusal(422, f"two curves have the name '{duplicate}': rename one")
    return tuple(contours)


def _parse_name_of_curve(data: Any, number: int) -> str:
    """Check the name of a curve, which may be empty."""
    if not isinstance(data, str) or not data.isprintable() or len(data) > LONGEST_NAME:
        raise Refusal(422, f"the name of curve {number} is not valid: send at most {LONGEST_NAME} printable characters")
    return data.strip()


def _parse_kinds(data: Any, names: Sequence[str], contours: Sequence[Contour]) -> tuple[contract.Kind, ...]:
    """Check the kinds of points; without any, as in templates of earlier versions, all are landmarks."""
    if data is None:
        return (LANDMARK,) * len(names)
    if not isinstance(data, list) or len(data) != len(names) or not all(kind in [*KINDS] for kind in data):
        raise Refusal(422, f"the kinds of points are not valid: send one of {', '.join(KINDS)} for each")
    on_curve = {index for contour in contours for index in contour.indices}
    alone = next((name for i, name in enumerate(names) if data[i] == SEMILANDMARK and i not in on_curve), None)
    if alone is not None:
        raise Refusal(422, f"'{alone}' is a semilandmark, but on no contour: make it a landmark, or add it to one")
    return tuple(data)


def parse_points(data: Any, n: int) -> tuple[tuple[float, float] | None, ...]:
    """Parse and check ``n`` points from JSON, [x, y] or null each."""
    if not isinstance(data, list) or len(data) != n:
        count = len(data) if isinstance(data, list) else "no"
        raise Refusal(422, f"there are {count} points where the template has {n}: send one [x, y] or null for each")
    for i, point in enumerate(data, 1):
        valid = isinstance(point, list) and len(point) == 2 and all(type(value) in (int, float) for value in point)
        if point is not None and not (valid and all(abs(value) <= FARTHEST for value in point)):  # False for NaN
            raise Refusal(422, f"point {i} is not valid: send [x, y] in pixels, or null if it is not placed")
    return tuple(point and (round(float(point[0]), 3), round(float(point[1]), 3)) for point in data)


def parse_indices(data: Any, n: int, what: str) -> list[int]:
    """Check a list of unique point indices from 0 to ``n - 1``."""
    valid = isinstance(data, list) and all(type(index) is int and 0 <= index < n for index in data)
    if not valid or len(set(data)) != len(data):
        raise Refusal(422, f"{what} is not valid: send a list of different whole numbers from 0 to {n - 1}")
    return data


def template_of(landmarks: Landmarks) -> Template:
    """Create the template of the landmarks of one picture."""
    n = len(landmarks)
    named = len(set(landmarks.names)) == n and all(name.strip() for name in landmarks.names)
    names = tuple(name[:LONGEST_NAME] for name in landmarks.names) if named else tuple(str(i + 1) for i in range(n))
    complete = not landmarks.missing.any()
    points = tuple((round(x, 3), round(y, 3)) for x, y in landmarks.points.tolist()) if complete else None
    twins = twins_by_names(names) or (twins_by_place(landmarks.points) if complete else None)
    chain, sliding = semilandmarks(landmarks.contours)
    slides = set(chain[sliding].tolist())
    kinds: tuple[contract.Kind, ...] = tuple(SEMILANDMARK if index in slides else LANDMARK for index in range(n))
    return Template(names, landmarks.contours, twins, points, kinds)


def saved_twins(folder: Path, names: Sequence[str], n: int) -> tuple[int, ...] | None:
    """Return the twins of n landmarks in the template that the studio saved for a folder, if it suits them.

    Names decide where there are names, or else the number of landmarks.
    """
    store = Store(Folder(real_path(folder)))
    data = store.get("template")
    store.close()
    template = None if data is None else parse_template(data, _MOST)
    if template is None or template.mirror is None or len(template) != n:
        return None
    if not names:
        return template.mirror
    if {*template.names} != {*names}:
        return None
    place = {name: i for i, name in enumerate(names)}
    twin_of = {name: template.names[twin] for name, twin in zip(template.names, template.mirror, strict=True)}
    return tuple(place[twin_of[name]] for name in names)


def sliders_text(template: Template) -> str:
    """Return the sliders of a template as geomorph reads them: rows of the points before, sliding and after, from 1."""
    rows = []
    for contour in template.contours:
        n = len(contour.indices)
        for place, index in enumerate(contour.indices):
            has_neighbours = contour.closed or 0 < place < n - 1
            if template.kinds[index] == SEMILANDMARK and has_neighbours:
                before = contour.indices[place - 1]
                after = contour.indices[(place + 1) % n]
                rows.append(f"{before + 1},{index + 1},{after + 1}")
    if not rows:
        raise Refusal(422, "no point of the template is a semilandmark: draw a curve in the template first")
    return "\n".join(["before,slide,after", *rows, ""])


def landmarks_of(
    template: Template, points: Sequence[Any], invisible: Sequence[int] = (), scale: float | None = None
) -> Landmarks:
    """Return a picture's points as landmarks with the template's names and contours."""
    placed = [(np.nan, np.nan) if point is None else point for point in points]
    with refusing():
        return Landmarks(np.array(placed), template.contours, template.names, None, tuple(invisible), scale)


def text_of(landmarks: Landmarks, suffix: str) -> str:
    """Return the text of a landmark file in a format that can be written."""
    return writer_of(Path(f"x{suffix}"))(landmarks)


@dataclass(eq=False)
class Templates:
    """The current template, its revision, and its ``order``, which changes when points are added, removed or reordered.

    Thread-safe with the project's lock. ``offered`` is the template of a model, for a folder without any, and
    ``offered_by`` its name if it comes with liaam. ``is_pending`` says whether a change may be stored, as before the
    store has been read.
    """

    _listing: Listing
    _store: Store
    _landmarks: "LandmarkFiles"
    _proposals: StoredTable
    _absent: StoredTable
    _lock: threading.RLock
    offered: Template | None = None
    offered_by: str = ""
    is_pending: bool = True
    _guess: Template | None = None
    _guessed_version: int = -1

    def __post_init__(self) -> None:
        self._template_of = lru_cache(1)(template_of)  # its search for symmetry is slow
        self._take(self._store.get("template"))

    @property
    def current(self) -> Template | None:
        """The saved template, or else that of the first picture with landmarks."""
        with self._lock:
            if self.saved is None and self._guessed_version != self._listing.version:
                self._guessed_version = self._listing.version
                candidates = (self._landmarks.of(file).landmarks for file in self._listing.pictures)
                first = next((landmarks for landmarks in candidates if landmarks is not None), None)
                self._guess = None if first is None else self._template_of(first)
            return self.saved or self._guess or self.offered

    @property
    def is_own(self) -> bool:
        """Whether the template is a person's, not that of a model that comes with liaam."""
        return self.current is not None and not self._saved_of and not (self.is_offered and self.offered_by)

    @property
    def is_offered(self) -> bool:
        """Whether the template is offered by a model and was not accepted yet."""
        return self.offered is not None and self.current is self.offered

    def offer(self, template: Template | None, source: str = "") -> None:
        """Offer a template of a model, ``source`` if it comes with liaam; None drops the offer, and its proposals."""
        with self._lock:
            if template is None:
                self._proposals.forget()
            self.offered = template
            self.offered_by = source

    @property
    def needed(self) -> Template:
        """The current template."""
        if (template := self.current) is None:
            raise Refusal(422, "there is no template yet: define which points to place, or load a landmark file")
        return template

    @property
    def revision(self) -> str | None:
        """Revision of the current template; None without a template."""
        template = self.current
        return None if template is None else self._revision or revision_of(json.dumps(template.as_json()).encode())

    def as_json(self) -> contract.Template | None:
        """Return the template as JSON for the page, with its ``revision``."""
        template = self.current
        return None if template is None else {**template.as_json(), "revision": self.revision}

    def check(self, revision: Any, what: str) -> None:
        """Refuse a request that was made for another revision of the template."""
        if revision != self.revision:
            changed = "the template was changed elsewhere in the meantime"
            text = f"{changed}, so the studio did not save {what}: check and save again"
            raise Refusal(409, text, template=self.as_json())

    def keep(self) -> None:
        """Save a template that was taken from a landmark file."""
        if self.saved is None:
            of = self.offered_by if self.needed is self.offered else ""
            stored = {**self.needed.as_json(), "revision": self.revision, "order": self.order, "of": of}
            self._store.put("template", {"": stored})
            self._take(stored)

    def _take(self, stored: Mapping[str, Any] | None) -> None:
        self.saved = None if stored is None else parse_template(stored, _MOST)
        facts = stored or {}
        self._revision, self.order = facts.get("revision", ""), facts.get("order", "")
        self._saved_of = facts.get("of", "")  # the model that offered the saved template

    def save(self, template: Template, asked: contract.SaveTemplate) -> bool:
        """Save the template of a request, for :meth:`liaam.studio.project.Project.save_template`."""
        self.finish()
        self._listing.scan()
        # The user's points may replace those that a model offers, unless these were accepted.
        is_offer = self.is_offered
        revision = None if asked.revision is OMITTED else asked.revision
        old = None if is_offer and revision is None else self.current
        identity = None if old is None else list(range(len(old)))
        is_there = template == self.saved
        is_current = revision == (old and self.revision)
        if asked.revision is not OMITTED and not is_current:
            if is_there:  # sent again, since the first answer may have been lost
                return False
            self.check(revision, "the template")
        mapping = self._mapping(asked.mapping, len(template), old)
        if is_there and (mapping == identity or not is_current):
            return False
        moved = is_offer or (old is not None and mapping != identity)
        order = secrets.token_hex(8) if moved else self.order
        stored = {**template.as_json(), "revision": secrets.token_hex(8), "order": order}
        files = [] if old is None else self._rewritten(template, len(old), mapping, moved)
        # Applying it twice has no further effect, since the mapping is applied as it is removed.
        change = {"template": stored, "files": files, "moved": moved, "mapping": None if old is None else mapping}
        if moved:
            names = () if self.current is None else self.current.names
            change["measuring"] = followed(kept_in(self._store), mapping, names)
        self.is_pending = True
        self._store.put("change", {"": change})  # from here on the change will be finished, even after a crash
        self.finish()
        return moved

    def finish(self) -> None:
        """Finish a pending change. Files that were changed in the meantime are left alone."""
        try:
            change = self._store.get("change") if self.is_pending else None
            if change is not None:
                for item in change["files"]:
                    self._landmarks.rewrite(item["file"], item["text"], item["before"], item["invisible"])
                with self._store.transaction():
                    if change["moved"]:
                        self._proposals.forget()
                        self._map_absent(change.get("mapping"))
                        self._store.put(MEASURING, {"": change.get("measuring")})
                    self._store.put("template", {"": change["template"]})
                    self._store.put("change", {"": None})
                self._take(change["template"])
                self._store.note("change", None)
                self._listing.scan()
            self.is_pending = False
        except (LiaamError, OSError) as fault:
            cause = fault if isinstance(fault, OSError) else fault.__cause__
            why = self._store.folder.plain(fault)
            text = f"a change of the template cannot be finished yet ({why}): fix this, and the studio will finish it"
            self._store.note("change", text)
            raise Refusal(fault.status if isinstance(fault, Refusal) else status_of(cause), text) from fault

    def _map_absent(self, mapping: Sequence[int | None] | None) -> None:
        """Give the points that pictures lack their new indices."""
        if mapping is not None:
            moved = {}
            for name, absent in self._absent.items():
                moved[name] = [index for index, old in enumerate(mapping) if old in absent] or None
            self._absent.save(moved)

    def _rewritten(self, template: Template, n: int, mapping: Sequence[Any], moved: bool) -> list[dict[str, Any]]:
        files = []
        for file in self._listing.pictures:
            marks = self._landmarks.of(file)
            if marks.landmarks is None or len(marks.landmarks) != n:
                continue
            target = self._landmarks.target(file)
            name = self._store.folder.name_of(target)
            if not moved and (marks.file != name or target.suffix.lower() == ".pts"):
                continue
            points = marks.points
            scale = self._landmarks.scale_of(file)
            hidden = [i for i, source in enumerate(mapping) if source in marks.landmarks.invisible]
            landmarks = landmarks_of(template, [None if i is None else points[i] for i in mapping], hidden, scale)
            landmarks = replace(landmarks, unit=self._landmarks.unit_of(file) if scale else "")
            before = marks.revision if marks.file == name else None
            text = text_of(landmarks, target.suffix)
            files.append({"file": name, "before": before, "text": text, "invisible": hidden})
        return files

    def _mapping(self, data: Any, n: int, old: Template | None) -> list[int | None]:
        if old is None:
            return [None] * n
        if data is None:
            if len(old) != n and any(self._landmarks.of(file).file for file in self._listing.pictures):
                counts = f"the template had {len(old)} points and now has {n}, but pictures have landmarks"
                raise Refusal(422, f"{counts}: send a mapping with the old index of each point")
            return [i if i < len(old) else None for i in range(n)]
        if not isinstance(data, list) or len(data) != n:
            raise Refusal(422, f"the mapping is not valid: send the old index of each of {n} points, or null if new")
        parse_indices([index for index in data if index is not None], len(old), "mapping")
        return data
