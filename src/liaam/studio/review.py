"""Reviews: who changed what, the states of pictures that follow from it, and actions on several pictures.

A picture is checked while its landmarks have the revision that was checked, so every change withdraws the check. The
other states hold until the opposite entry. An action is written to the log before anything else changes; deleted
landmarks are kept in the store.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING, Any

from liaam.errors import LandmarkError
from liaam.io.landmarks import Landmarks, parse_landmark_data
from liaam.studio.folder import File, revision_of
from liaam.studio.landmark_files import LandmarkFiles, text_of
from liaam.studio.proposals import revision_of_proposal
from liaam.studio.safety import Refusal
from liaam.studio.store import Store
from liaam.studio.templates import Templates

if TYPE_CHECKING:
    from liaam.studio.picture_states import PictureStates

UNDONE = {
    "unchecked": ("checked", "not checked"),
    "taken in": ("left out", "not left out of training"),
    "restored": ("discarded", "no proposed points were discarded"),
    "undeleted": ("deleted", "no landmarks were deleted here"),
}
"""Actions, the actions that they undo, and why there may be nothing to undo."""

ACTIONS = (*(done for done, _ in UNDONE.values()), *UNDONE, "accepted", "scaled", "unscaled")

OPPOSITE = {done: undo for undo, (done, _) in UNDONE.items()}

WRITING = ("accepted", "deleted", "undeleted", "scaled", "unscaled")
"""Actions that write landmark files."""

LONGEST_NAME = 60
SHOWN = 20
"""Number of entries of a picture that the page shows."""

SAME_WORK = timedelta(minutes=10)
"""Changes of a picture by one person within this time are one entry."""


class ReviewLog:
    """The log of a folder, by name of the picture."""

    def __init__(self, store: Store) -> None:
        self._store = store
        self._entries: dict[str, list[dict[str, Any]]] = defaultdict(list)
        for entry in store.lines("review"):
            self._entries[entry["picture"]].append(entry)

    def add(self, did: str, who: str, pictures: Mapping[str, str | None]) -> None:
        """Append an entry for each picture, given with the revision of what was done to."""
        time = datetime.now(UTC).isoformat(timespec="seconds")
        entries = [
            {"time": time, "who": who, "picture": name, "did": did, "revision": revision}
            for name, revision in pictures.items()
        ]
        self._store.append("review", entries)
        for entry in entries:
            self._entries[entry["picture"]].append(entry)

    def add_change(self, who: str, name: str, did: str, revision: str | None) -> None:
        """Append that the points of a picture were placed or cleared, once for all changes in a few minutes."""
        last = next(iter(self.history(name)), {"who": None, "did": None, "time": "0001-01-01T00:00+00:00"})
        is_recent = datetime.now(UTC) - datetime.fromisoformat(last["time"]) < SAME_WORK
        if not (is_recent and (last["who"], last["did"]) == (who, did)):
            self.add(did, who, {name: revision})

    def history(self, name: str) -> list[dict[str, Any]]:
        """Return the last entries of a picture, newest first."""
        return self._entries.get(name, [])[: -SHOWN - 1 : -1]

    def standing(self, name: str, did: str) -> dict[str, Any] | None:
        """Return the last entry of an action, unless it was undone later."""
        both = (did, OPPOSITE[did])
        last = next((entry for entry in reversed(self._entries.get(name, ())) if entry["did"] in both), None)
        return last if last is not None and last["did"] == did else None

    def checked_by(self, name: str, revision: str | None) -> str | None:
        """Return who checked a revision of the landmarks; None without landmarks."""
        last = self.standing(name, "checked")
        return _who(last) if last is not None and revision is not None and last["revision"] == revision else None

    def left_out_by(self, name: str) -> str | None:
        """Return who left a picture out of training."""
        last = self.standing(name, "left out")
        return None if last is None else _who(last)


@dataclass(frozen=True)
class Sharing:
    """A scale bar that several pictures share."""

    bar: dict[str, Any]
    size: tuple[int, int]
    """Size of the picture on which it was drawn."""
    anyway: bool
    """Whether pictures of another size, or with a scale of their own, get it as well."""


@dataclass(frozen=True, eq=False)
class ReviewActions:
    """Actions on pictures: accept or discard proposals, mark as checked, leave out of training, delete, and undo."""

    store: Store
    landmarks: LandmarkFiles
    templates: Templates
    states: PictureStates
    log: ReviewLog

    def apply(self, files: list[File], did: str, who: str, sharing: Sharing | None = None) -> dict[str, Any]:
        """Apply an action; ``sharing`` is the scale bar of "scaled".

        Return ``changed``, the names of the pictures that changed; ``refused``, reasons by name of the others;
        and ``revisions`` of landmarks that were written, by name.
        """
        if did not in ACTIONS:
            raise Refusal(422, f"the action is not known: send one of {', '.join(ACTIONS)}")
        revisions: dict[str, str | None] = {}
        refused: dict[str, str] = {}
        for file in files:
            try:
                revisions[file.name] = self._revision(file, did, sharing)
            except (Refusal, LandmarkError) as fault:
                refused[file.name] = self.store.folder.plain(fault)
        if revisions:
            self.log.add(did, who, revisions)
        if did == "accepted" and revisions:
            self.templates.keep()  # the first save fixes a template that was taken from a file or offered
        written = [file for file in files if file.name in revisions] if did in WRITING else []
        if sharing is not None:
            self.landmarks.share_bar(written, sharing.bar)
        elif did == "unscaled":
            self.landmarks.unshare_bar(written)
        for file in written:
            self._write(file, did, revisions[file.name])
        now = {file.name: self.landmarks.of(file).revision for file in written}
        return {"changed": list(revisions), "refused": refused, "revisions": now}

    def _revision(self, file: File, did: str, sharing: Sharing | None) -> str | None:
        """Return the revision of what an action is done to; refuse one that changes nothing."""
        marks, proposal = self.landmarks.of(file), self.states.proposal_of(file)
        if did in ("scaled", "unscaled"):
            self._check_scale(file, sharing)
            return marks.revision
        if did == "undeleted" and marks.n_placed:
            raise Refusal(409, "there are landmarks again")
        if did in UNDONE:
            done, why_not = UNDONE[did]
            last = self.log.standing(file.name, done)
            if last is None or (done == "checked" and last["revision"] != marks.placement):
                raise Refusal(409, why_not)
            if done == "deleted" and len(self._copy_of(last["revision"])) != len(self.templates.needed):
                raise Refusal(409, "the deleted landmarks belong to an earlier template")
            return last["revision"]
        if did in ("accepted", "discarded"):
            if proposal is None or marks.n_placed:
                raise Refusal(409, "no proposed points")
            return revision_of_proposal(proposal)
        if did == "left out":
            if self.log.left_out_by(file.name) is not None:
                raise Refusal(409, "left out of training already")
            return None
        if did == "checked":
            if not self.states.is_done(file):
                raise Refusal(409, "not all points are placed: place them first")
            if self.log.checked_by(file.name, marks.placement):
                raise Refusal(409, "checked already")
            return marks.placement
        if marks.landmarks is None or not marks.n_placed:
            raise Refusal(409, "no landmarks")
        text = text_of(marks.landmarks, ".ljson")
        revision = revision_of(text.encode())
        self.store.put("deleted", {revision: text})
        return revision

    def _check_scale(self, file: File, sharing: Sharing | None) -> None:
        """Refuse to replace a scale of the picture's own, and to share one among pictures of several sizes."""
        shares = self.landmarks.shares_scale(file)
        size = self.states.listing.usable_size(file)
        if sharing is None:
            if not shares:
                raise Refusal(409, "the scale was not set together with others")
        elif not sharing.anyway and self.landmarks.scale_of(file) is not None and not shares:
            raise Refusal(409, "has a scale of its own")
        elif not sharing.anyway and sorted(size) != sorted(sharing.size):
            raise Refusal(409, "has another size in pixels, so perhaps another scale")
        elif self.landmarks.bar_of(file) == sharing.bar:
            raise Refusal(409, "has this scale already")

    def _write(self, file: File, did: str, revision: str | None) -> None:
        """Write landmarks from the proposal or from a copy, or remove them; or write their scale."""
        if did in ("scaled", "unscaled"):
            if self.templates.current is not None:
                self.landmarks.write_scale(file, self.templates.current)
            return
        template = self.templates.needed
        points: Sequence[Any] = [None] * len(template)
        invisible: Sequence[int] = ()
        scale = None
        if did == "accepted":
            points = (self.states.proposal_of(file) or {})["points"]
        elif did == "undeleted":
            landmarks = self._copy_of(revision or "")
            points = [None if x != x else (x, y) for x, y in landmarks.points.tolist()]
            invisible, scale = landmarks.invisible, landmarks.scale
        self.landmarks.save(file, template, points, invisible, scale)

    def _copy_of(self, revision: str) -> Landmarks:
        """Return deleted landmarks; raise LandmarkError if they are gone."""
        text = self.store.get("deleted", revision)
        landmarks = None if text is None else parse_landmark_data("copy.ljson", text.encode())
        if not isinstance(landmarks, Landmarks):
            raise LandmarkError("the deleted landmarks are not kept any more")
        return landmarks


def parse_who(name: Any) -> str:
    """Check the name of the person who works in the page; "" if it is not known."""
    if name is None:
        return ""
    if not isinstance(name, str) or len(name) > LONGEST_NAME or not name.isprintable():
        raise Refusal(422, f"your name is not valid: enter at most {LONGEST_NAME} printable characters")
    return name.strip()


def _who(entry: Mapping[str, Any]) -> str:
    return entry["who"] or "someone"
