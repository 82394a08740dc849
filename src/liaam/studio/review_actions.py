"""Actions on several pictures at once: mark as checked, discard proposals, leave out of training, delete landmarks.

Each action is written to the log before anything else changes, and has an opposite that undoes it. Deleted landmarks
are kept in ``kept``.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from liaam.errors import LandmarkError
from liaam.io.files import read_bytes
from liaam.io.landmarks import FORMATS, Landmarks, parse_landmark_data
from liaam.studio.folder import revision_of
from liaam.studio.landmark_files import LandmarkFiles, n_placed
from liaam.studio.listing import File
from liaam.studio.picture_states import PictureStates
from liaam.studio.proposals import revision_of_proposal
from liaam.studio.review import ReviewLog
from liaam.studio.safety import Refusal
from liaam.studio.state_files import StateFiles
from liaam.studio.template_store import TemplateStore


class ReviewActions:
    """Applies actions to pictures."""

    def __init__(
        self,
        state: StateFiles,
        landmarks: LandmarkFiles,
        templates: TemplateStore,
        states: PictureStates,
        log: ReviewLog,
        most_bytes: int,
    ) -> None:
        self._state = state
        self._landmarks = landmarks
        self._templates = templates
        self._states = states
        self._log = log
        self._most_bytes = most_bytes
        self._checks: dict[str, Callable[[File], str | None]] = {
            "checked": self._checked,
            "unchecked": self._unchecked,
            "left out": lambda file: self._flag(file, True),
            "taken in": lambda file: self._flag(file, False),
            "discarded": self._discarded,
            "restored": self._restored,
            "deleted": self._deleted,
            "undeleted": self._undeleted,
        }

    def apply(self, files: list[File], did: str, who: str) -> dict[str, Any]:
        """Apply an action.

        Returns
        -------
        dict
            ``changed``, the names of the pictures that changed; ``refused``, reasons by name of the others; and
            ``revisions`` of landmarks that were written, by name.
        """
        if did not in self._checks:
            raise Refusal(422, f"the action is not known: send one of {', '.join(self._checks)}")
        revisions: dict[str, str | None] = {}
        refused: dict[str, str] = {}
        for file in files:
            try:
                revisions[file.name] = self._checks[did](file)
            except (Refusal, LandmarkError) as fault:
                refused[file.name] = self._state.folder.plain(fault)
        if revisions:
            self._log.add(did, who, revisions)
        written = [file for file in files if file.name in revisions] if did in ("deleted", "undeleted") else []
        for file in written:
            self._write(file, revisions[file.name] if did == "undeleted" else None)
        now = {file.name: self._landmarks.revision(file) for file in written}
        return {"changed": list(revisions), "refused": refused, "revisions": now}

    # Checks: each returns the revision of what is acted on, or raises a Refusal ----------------------------

    def _checked(self, file: File) -> str | None:
        if not self._states.is_done(file):
            raise Refusal(409, "not all of its points are placed: place them first")
        revision = self._landmarks.revision(file)
        if revision is not None and self._log.checked_by(file.name, revision):
            raise Refusal(409, "it is checked already")
        return revision

    def _unchecked(self, file: File) -> str | None:
        revision = self._landmarks.revision(file)
        if revision is None or self._log.checked_by(file.name, revision) is None:
            raise Refusal(409, "it is not checked")
        return revision

    def _flag(self, file: File, on: bool) -> None:
        if (self._log.left_out_by(file.name) is not None) == on:
            raise Refusal(409, "it is left out of training already" if on else "it is not left out of training")

    def _discarded(self, file: File) -> str | None:
        proposal = self._states.proposal_of(file)
        if proposal is None or n_placed(self._landmarks.of(file)):
            raise Refusal(409, "it has no proposed points")
        return revision_of_proposal(proposal)

    def _restored(self, file: File) -> str | None:
        revision = self._log.discarded(file.name)
        if revision is None:
            raise Refusal(409, "no proposed points of it were discarded")
        return revision

    def _deleted(self, file: File) -> str | None:
        """Keep a copy of the landmarks."""
        marks = self._landmarks.of(file)
        if marks is None or marks.landmarks is None or not marks.n_placed:
            raise Refusal(409, "it has no landmarks")
        dump = FORMATS[".ljson"].dump
        assert dump is not None
        data = dump(marks.landmarks).encode()
        self._state.write(_copy(revision_of(data)), data)
        return revision_of(data)

    def _undeleted(self, file: File) -> str | None:
        if n_placed(self._landmarks.of(file)):
            raise Refusal(409, "it has landmarks again")
        revision = self._log.deleted(file.name)
        if revision is None:
            raise Refusal(409, "no landmarks of it were deleted here")
        if len(self._copy_of(revision)) != len(self._templates.needed):
            raise Refusal(409, "its deleted landmarks belong to an earlier template")
        return revision

    # Files ------------------------------------------------------------------------------------------------

    def _write(self, file: File, revision: str | None) -> None:
        """Write landmarks from a copy; remove them without one."""
        template = self._templates.needed
        landmarks = None if revision is None else self._copy_of(revision)
        points = [[np.nan, np.nan]] * len(template) if landmarks is None else landmarks.points.tolist()
        invisible = () if landmarks is None else landmarks.invisible
        self._landmarks.save(file, template, [None if x != x else (x, y) for x, y in points], invisible)

    def _copy_of(self, revision: str) -> Landmarks:
        """Read a copy of deleted landmarks; raise LandmarkError if it is gone or was changed."""
        data = read_bytes(self._state.path(_copy(revision)), LandmarkError, self._most_bytes)
        landmarks = parse_landmark_data("copy.ljson", data)
        if revision_of(data) != revision or not isinstance(landmarks, Landmarks):
            raise LandmarkError("the copy of its deleted landmarks was changed")
        return landmarks


def _copy(revision: str) -> str:
    """Return the name of a copy. A revision from the log may hold any characters, so it is hashed."""
    return f"kept/deleted.{revision_of(revision.encode())}.ljson"
