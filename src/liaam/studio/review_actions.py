"""Actions on several pictures at once: accept or discard proposals, mark as checked, leave out of training, delete.

Each action is written to the log before anything else changes, and has an opposite that undoes it. Deleted landmarks
are kept in the store.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from liaam.errors import LandmarkError
from liaam.io.landmarks import Landmarks, parse_landmark_data
from liaam.studio.folder import revision_of
from liaam.studio.landmark_files import LandmarkFiles, text_of
from liaam.studio.listing import File
from liaam.studio.picture_states import PictureStates
from liaam.studio.proposals import revision_of_proposal
from liaam.studio.review import ReviewLog
from liaam.studio.safety import Refusal
from liaam.studio.store import Store
from liaam.studio.template_store import TemplateStore

WRITING = ("accepted", "deleted", "undeleted")
"""Actions that write landmark files."""


@dataclass(frozen=True, eq=False)
class ReviewActions:
    """Applies actions to pictures."""

    store: Store
    landmarks: LandmarkFiles
    templates: TemplateStore
    states: PictureStates
    log: ReviewLog

    def apply(self, files: list[File], did: str, who: str) -> dict[str, Any]:
        """Apply an action.

        Return ``changed``, the names of the pictures that changed; ``refused``, reasons by name of the others;
        and ``revisions`` of landmarks that were written, by name.
        """
        checks: dict[str, Callable[[File], str | None]] = {
            "accepted": self._proposed,
            "checked": self._checked,
            "unchecked": self._unchecked,
            "left out": lambda file: self._flag(file, True),
            "taken in": lambda file: self._flag(file, False),
            "discarded": self._proposed,
            "restored": self._restored,
            "deleted": self._deleted,
            "undeleted": self._undeleted,
        }
        if did not in checks:
            raise Refusal(422, f"the action is not known: send one of {', '.join(checks)}")
        revisions: dict[str, str | None] = {}
        refused: dict[str, str] = {}
        for file in files:
            try:
                revisions[file.name] = checks[did](file)
            except (Refusal, LandmarkError) as fault:
                refused[file.name] = self.store.folder.plain(fault)
        if revisions:
            self.log.add(did, who, revisions)
        if did == "accepted" and revisions:
            self.templates.keep()  # the first save fixes a template that was taken from a file or offered
        written = [file for file in files if file.name in revisions] if did in WRITING else []
        for file in written:
            self._write(file, did, revisions[file.name])
        now = {file.name: self.landmarks.of(file).revision for file in written}
        return {"changed": list(revisions), "refused": refused, "revisions": now}

    def _checked(self, file: File) -> str | None:
        if not self.states.is_done(file):
            raise Refusal(409, "not all points are placed: place them first")
        revision = self.landmarks.of(file).revision
        if self.log.checked_by(file.name, revision):
            raise Refusal(409, "checked already")
        return revision

    def _unchecked(self, file: File) -> str | None:
        revision = self.landmarks.of(file).revision
        if self.log.checked_by(file.name, revision) is None:
            raise Refusal(409, "not checked")
        return revision

    def _flag(self, file: File, on: bool) -> None:
        if (self.log.left_out_by(file.name) is not None) == on:
            raise Refusal(409, "left out of training already" if on else "not left out of training")

    def _proposed(self, file: File) -> str | None:
        proposal = self.states.proposal_of(file)
        if proposal is None or self.landmarks.of(file).n_placed:
            raise Refusal(409, "no proposed points")
        return revision_of_proposal(proposal)

    def _restored(self, file: File) -> str | None:
        revision = self.log.discarded(file.name)
        if revision is None:
            raise Refusal(409, "no proposed points were discarded")
        return revision

    def _deleted(self, file: File) -> str | None:
        """Keep a copy of the landmarks."""
        marks = self.landmarks.of(file)
        if marks.landmarks is None or not marks.n_placed:
            raise Refusal(409, "no landmarks")
        text = text_of(marks.landmarks, ".ljson")
        revision = revision_of(text.encode())
        self.store.put("deleted", {revision: text})
        return revision

    def _undeleted(self, file: File) -> str | None:
        if self.landmarks.of(file).n_placed:
            raise Refusal(409, "there are landmarks again")
        revision = self.log.deleted(file.name)
        if revision is None:
            raise Refusal(409, "no landmarks were deleted here")
        if len(self._copy_of(revision)) != len(self.templates.needed):
            raise Refusal(409, "the deleted landmarks belong to an earlier template")
        return revision

    def _write(self, file: File, did: str, revision: str | None) -> None:
        """Write landmarks from the proposal or from a copy, or remove them."""
        template = self.templates.needed
        points: Sequence[Any] = [None] * len(template)
        invisible: Sequence[int] = ()
        if did == "accepted":
            points = (self.states.proposal_of(file) or {})["points"]
        elif did == "undeleted":
            landmarks = self._copy_of(revision or "")
            points = [None if x != x else (x, y) for x, y in landmarks.points.tolist()]
            invisible = landmarks.invisible
        self.landmarks.save(file, template, points, invisible)

    def _copy_of(self, revision: str) -> Landmarks:
        """Return deleted landmarks; raise LandmarkError if they are gone."""
        text = self.store.get("deleted", revision)
        landmarks = None if text is None else parse_landmark_data("copy.ljson", text.encode())
        if not isinstance(landmarks, Landmarks):
            raise LandmarkError("the deleted landmarks are not kept any more")
        return landmarks
