"""The template of a project and its changes.

The template is the saved one, or else that of the first picture with landmarks, or else that of a model. A change of it
and of all landmark files with it is one transaction that survives a killed process: the whole change is stored before
the first landmark file is rewritten. Until all files are written, landmarks can be neither read nor saved, and every
call tries to finish the change first.
"""

from __future__ import annotations

import json
import secrets
import threading
from collections.abc import Mapping, Sequence
from typing import Any

from liaam.errors import LiaamError
from liaam.io.landmarks import Landmarks
from liaam.studio.folder import Listing, revision_of, status_of
from liaam.studio.landmark_files import LandmarkFiles, text_of
from liaam.studio.safety import Refusal
from liaam.studio.store import Store, Table
from liaam.studio.template import Template, landmarks_of, parse_indices, parse_template, template_of

_MOST = 10**6
"""Maximum number of points of a stored template, far above that of a new one, so that it can always be read."""


class Templates:
    """The current template, its revision, and its ``order``, which changes when points are added, removed or reordered.

    Thread-safe with the project's lock. ``offered`` is the template of a model, for a folder without any, and
    ``offered_by`` its name if it comes with liaam. ``is_pending`` says whether a change may be stored, as before the
    store has been read.
    """

    def __init__(
        self, listing: Listing, store: Store, landmarks: LandmarkFiles, proposals: Table, lock: threading.RLock
    ) -> None:
        self.offered: Template | None = None
        self.offered_by = ""
        self.is_pending = True
        self._listing = listing
        self._store = store
        self._landmarks = landmarks
        self._proposals = proposals
        self._lock = lock
        self._guess: Template | None = None
        self._guessed_of: Landmarks | None = None
        self._guessed_version = -1
        self._take(store.get("template"))

    @property
    def current(self) -> Template | None:
        """The saved template, or else that of the first picture with landmarks."""
        with self._lock:
            if self.saved is None and self._guessed_version != self._listing.version:
                self._guessed_version = self._listing.version
                found = (self._landmarks.of(file).landmarks for file in self._listing.pictures)
                first = next((landmarks for landmarks in found if landmarks is not None), None)
                if self._guessed_of is not first:  # the search for symmetry is slow
                    self._guessed_of, self._guess = first, None if first is None else template_of(first)
            return self.saved or self._guess or self.offered

    @property
    def is_own(self) -> bool:
        """Whether the template is a person's, not that of a model that comes with liaam."""
        return self.current is not None and not self._saved_of and not (self.is_offered and self.offered_by)

    @property
    def is_offered(self) -> bool:
        """Whether the template is offered by a model and was not accepted yet."""
        return self.offered is not None and self.current is self.offered

    @property
    def is_declined(self) -> bool:
        """Whether a person does not want the points of the face model here."""
        return self._store.get("declined") is not None

    def offer(self, template: Template | None, source: str = "") -> None:
        """Offer a template for a folder without one; ``source`` is the name of a model that comes with liaam.

        None drops the template that was offered, and the proposals for its points.
        """
        with self._lock:
            if template is None:
                self._proposals.forget()
            self.offered, self.offered_by = template, source

    def decline(self) -> None:
        """Drop the offered template and its proposals for good."""
        self._store.put("declined", {"": True})
        self.offer(None)

    @property
    def needed(self) -> Template:
        """The current template."""
        template = self.current
        if template is None:
            raise Refusal(422, "there is no template yet: define which points to place, or load a landmark file")
        return template

    @property
    def revision(self) -> str | None:
        """Revision of the current template; None without a template."""
        template = self.current
        if template is None:
            return None
        return self._revision or revision_of(json.dumps(template.as_json()).encode())

    def as_json(self) -> dict[str, Any] | None:
        """Return the template as JSON for the page, with its ``revision``."""
        template = self.current
        return None if template is None else {**template.as_json(), "revision": self.revision}

    def check(self, revision: Any, what: str) -> None:
        """Refuse a request that was made for another revision of the template."""
        if revision != self.revision:
            changed = "the template was changed elsewhere in the meantime"
            text = f"{changed}, so the studio did not save {what}: check and save again"
            raise Refusal(409, text, template=self.as_json())

    def store(self, stored: Mapping[str, Any]) -> None:
        """Save a template, given as JSON with its ``revision`` and ``order``."""
        self._store.put("template", {"": stored})
        self._take(stored)

    def keep(self) -> None:
        """Save a template that was taken from a landmark file."""
        if self.saved is None:
            of = self.offered_by if self.needed is self.offered else ""
            self.store({**self.needed.as_json(), "revision": self.revision, "order": self.order, "of": of})

    def _take(self, stored: Mapping[str, Any] | None) -> None:
        self.saved = None if stored is None else parse_template(stored, _MOST)
        facts = stored or {}
        self._revision, self.order = facts.get("revision") or "", facts.get("order") or ""
        self._saved_of = facts.get("of") or ""  # the model that offered the saved template

    def save(self, template: Template, data: dict[str, Any]) -> bool:
        """Save a template; return whether points were added, removed or reordered.

        ``data`` is the request, with ``mapping``, the old index of each point, and ``revision`` if known.
        """
        self.finish()
        self._listing.scan()
        # The user's points may replace those that a model offers, unless these were accepted.
        is_offer = self.is_offered
        old = None if is_offer and data.get("revision") is None else self.current
        has_marks = any(self._landmarks.of(file).file for file in self._listing.pictures)
        identity = None if old is None else list(range(len(old)))
        revision = self.revision if old is not None else None
        is_there, is_current = template == self.saved, data.get("revision") == revision
        if "revision" in data and not is_current:
            if is_there:  # sent again, since the first answer may have been lost
                return False
            self.check(data["revision"], "the template")
        mapping = _mapping(data.get("mapping"), len(template), old, has_marks)
        if is_there and (mapping == identity or not is_current):
            return False
        moved = is_offer or (old is not None and mapping != identity)
        order = secrets.token_hex(8) if moved else self.order
        stored = {**template.as_json(), "revision": secrets.token_hex(8), "order": order}
        files = [] if old is None else self._rewritten(template, len(old), mapping, moved)
        change = {"template": stored, "files": files, "moved": moved}  # applying it twice has no further effect
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
                    self.store(change["template"])
                    self._store.put("change", {"": None})
                self._store.note("change", None)
                self._listing.scan()
            self.is_pending = False
        except (LiaamError, OSError) as fault:
            cause = fault if isinstance(fault, OSError) else fault.__cause__
            why = self._store.folder.plain(fault)
            text = f"a change of the template cannot be finished yet ({why}): fix this, and the studio will finish it"
            self._store.note("change", text)
            raise Refusal(fault.status if isinstance(fault, Refusal) else status_of(cause), text) from fault

    def _rewritten(self, template: Template, n: int, mapping: Sequence[Any], moved: bool) -> list[dict[str, Any]]:
        """Return the landmark files of ``n`` points for a changed template."""
        files = []
        for file in self._listing.pictures:
            known = self._landmarks.of(file)
            if known.landmarks is None or len(known.landmarks) != n:
                continue
            target = self._landmarks.target(file)
            name = self._store.folder.name_of(target)
            if not moved and (known.file != name or target.suffix.lower() == ".pts"):
                continue
            points, scale = known.points, self._landmarks.scale_of(file)
            hidden = [i for i, source in enumerate(mapping) if source in known.landmarks.invisible]
            landmarks = landmarks_of(template, [None if i is None else points[i] for i in mapping], hidden, scale)
            before = known.revision if known.file == name else None
            text = text_of(landmarks, target.suffix)
            files.append({"file": name, "before": before, "text": text, "invisible": hidden})
        return files


def _mapping(data: Any, n: int, old: Template | None, has_marks: bool) -> list[int | None]:
    """Return the old index of each point, None for a new one."""
    if old is None:
        return [None] * n
    if data is None:
        if has_marks and len(old) != n:
            counts = f"the template had {len(old)} points and now has {n}, but pictures have landmarks"
            raise Refusal(422, f"{counts}: send a mapping with the old index of each point")
        return [i if i < len(old) else None for i in range(n)]
    if not isinstance(data, list) or len(data) != n:
        raise Refusal(422, f"the mapping is not valid: send the old index of each of the {n} points, or null if new")
    parse_indices([index for index in data if index is not None], len(old), "mapping")
    return data
