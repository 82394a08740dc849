"""Actions on several pictures at once: mark as checked, discard proposals, leave out of training, delete landmarks.

Each action is written to the log before anything else changes, and has an opposite that undoes it. Deleted landmarks
are kept in ``kept``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Any

from liaam.errors import LandmarkError
from liaam.io.files import read_bytes
from liaam.io.landmarks import Landmarks, parse_landmark_data
from liaam.studio.folder import revision_of
from liaam.studio.landmark_files import LandmarkFiles, text_of
from liaam.studio.listing import File
from liaam.studio.picture_states import PictureStates
from liaam.studio.proposals import revision_of_proposal
from liaam.studio.review import ReviewLog
from liaam.studio.safety import Refusal
from liaam.studio.state_files import StateFiles
from liaam.studio.template_store import TemplateStore

LONGEST_STEM = 50
"""Characters of a picture's name in the name of a copy, so that it does not become too long for the disk."""


@dataclass(frozen=True, eq=False)
class ReviewActions:
    """Applies actions to pictures."""

    state: StateFiles
    landmarks: LandmarkFiles
    templates: TemplateStore
    states: PictureStates
    log: ReviewLog
    most_bytes: int
    """Maximum size of a file that is read."""

    def apply(self, files: list[File], did: str, who: str) -> dict[str, Any]:
        """Apply an action.

        Returns
        -------
        dict
            ``changed``, the names of the pictures that changed; ``refused``, reasons by name of the others; and
            ``revisions`` of landmarks that were written, by name.
        """
        checks: dict[str, Callable[[File], str | None]] = {
            "checked": self._checked,
            "unchecked": self._unchecked,
            "left out": lambda file: self._flag(file, True),
            "taken in": lambda file: self._flag(file, False),
            "discarded": self._discarded,
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
                refused[file.name] = self.state.folder.plain(fault)
        if revisions:
            self.log.add(did, who, revisions)
        written = [file for file in files if file.name in revisions] if did in ("deleted", "undeleted") else []
        for file in written:
            self._write(file, revisions[file.name] if did == "undeleted" else None)
        now = {file.name: self.landmarks.of(file).revision for file in written}
        return {"changed": list(revisions), "refused": refused, "revisions": now}

    # Checks: each returns the revision of what is acted on, or raises a Refusal ----------------------------

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

    def _discarded(self, file: File) -> str | None:
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
        data = text_of(marks.landmarks, ".ljson").encode()
        self.state.write(_copy(file, revision_of(data)), data)
        return revision_of(data)

    def _undeleted(self, file: File) -> str | None:
        if self.landmarks.of(file).n_placed:
            raise Refusal(409, "there are landmarks again")
        revision = self.log.deleted(file.name)
        if revision is None:
            raise Refusal(409, "no landmarks were deleted here")
        if len(self._copy_of(file, revision)) != len(self.templates.needed):
            raise Refusal(409, "the deleted landmarks belong to an earlier template")
        return revision

    # Files ------------------------------------------------------------------------------------------------

    def _write(self, file: File, revision: str | None) -> None:
        """Write landmarks from a copy; remove them without one."""
        template = self.templates.needed
        if revision is None:
            self.landmarks.save(file, template, [None] * len(template), ())
            return
        landmarks = self._copy_of(file, revision)
        points = [None if x != x else (x, y) for x, y in landmarks.points.tolist()]
        self.landmarks.save(file, template, points, landmarks.invisible)

    def _copy_of(self, file: File, revision: str) -> Landmarks:
        """Read a copy of deleted landmarks; raise LandmarkError if it is gone or was changed."""
        data = read_bytes(self.state.path(_copy(file, revision)), LandmarkError, self.most_bytes)
        landmarks = parse_landmark_data("copy.ljson", data)
        if revision_of(data) != revision or not isinstance(landmarks, Landmarks):
            raise LandmarkError("the copy of the deleted landmarks was changed")
        return landmarks


def _copy(file: File, revision: str) -> str:
    """Return the name of a copy. A revision from the log may hold any characters, so it is hashed."""
    stem = PurePosixPath(file.stem).name[:LONGEST_STEM]
    return f"kept/{stem}.deleted.{revision_of(revision.encode())}.ljson"
