"""The template of a project: the saved one, or else that of the first picture with landmarks."""

from __future__ import annotations

import json
import threading
from collections.abc import Mapping
from typing import Any

from liaam.io.landmarks import Landmarks
from liaam.studio.folder import revision_of
from liaam.studio.landmark_files import LandmarkFiles
from liaam.studio.listing import Listing
from liaam.studio.proposals import Proposals
from liaam.studio.safety import Refusal
from liaam.studio.store import Store
from liaam.studio.template import Template, parse_template, template_of

_MOST = 10**6
"""Maximum number of points of a stored template, far above that of a new one, so that it can always be read."""


class TemplateStore:
    """The current template, its revision, and its ``order``, which changes when points are added, removed or reordered.

    Thread-safe with the project's lock. ``offered`` is the template of a model, for a folder without any, and
    ``offered_by`` its name if it comes with liaam.
    """

    def __init__(
        self, listing: Listing, store: Store, landmarks: LandmarkFiles, proposals: Proposals, lock: threading.RLock
    ) -> None:
        self.saved: Template | None = None
        self.order = ""
        self.offered: Template | None = None
        self.offered_by = ""
        self._saved_of = ""  # the model that offered the saved template
        self._revision = ""
        self._listing = listing
        self._store = store
        self._landmarks = landmarks
        self._proposals = proposals
        self._lock = lock
        self._guess: Template | None = None
        self._guessed_of: Landmarks | None = None
        self._guessed_version = -1
        stored = store.get("template")
        if stored is not None:
            self._take(stored)

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
        current = self.current
        return current is not None and not self._saved_of and (current is not self.offered or not self.offered_by)

    @property
    def is_offered(self) -> bool:
        """Whether the template is offered by a model and was not accepted yet."""
        current = self.current
        return current is not None and current is self.offered

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
            raise Refusal(
                409,
                f"the template was changed elsewhere in the meantime, so the studio did not save {what}: check and "
                "save again",
                template=self.as_json(),
            )

    def store(self, stored: Mapping[str, Any]) -> None:
        """Save a template, given as JSON with its ``revision`` and ``order``."""
        self._store.put("template", {"": stored})
        self._take(stored)

    def keep(self) -> None:
        """Save a template that was taken from a landmark file."""
        if self.saved is None:
            of = self.offered_by if self.needed is self.offered else ""
            self.store({**self.needed.as_json(), "revision": self.revision, "order": self.order, "of": of})

    def _take(self, stored: Mapping[str, Any]) -> None:
        self.saved = parse_template(stored, _MOST)
        self._revision = stored.get("revision") or ""
        self.order = stored.get("order") or ""
        self._saved_of = stored.get("of") or ""
