"""Reviews: who changed what, the state of each picture that follows from it, and actions on several pictures.

A picture is checked while its landmarks have the revision that was checked, so every change withdraws the check. The
other states hold until the opposite entry. An action is written to the log before anything else changes.
"""

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np

from liaam.errors import LandmarkError
from liaam.io.landmarks import Landmarks, parse_landmark_data
from liaam.studio.folder import File, Listing, revision_of
from liaam.studio.landmark_files import LandmarkFiles, Marks, revision_of_proposal
from liaam.studio.safety import Refusal
from liaam.studio.store import Store, Table
from liaam.studio.template import Templates, text_of

UNDONE = {
    "unchecked": ("checked", "not checked"),
    "taken in": ("left out", "not left out of training"),
    "restored": ("discarded", "no proposed points were discarded"),
    "undeleted": ("deleted", "no landmarks were deleted here"),
}
"""Actions, the actions that they undo, and why there may be nothing to undo."""

ACTIONS = (*(done for done, _ in UNDONE.values()), *UNDONE, "accepted", "scaled", "unscaled")

OPPOSITE = {done: undo for undo, (done, _) in UNDONE.items()}

WRITING = ("accepted", "deleted", "undeleted", "scaled", "unscaled")  # actions that write landmark files
LONGEST_NAME = 60
SHOWN = 20  # number of entries of a picture that the page shows
SAME_WORK = timedelta(minutes=10)  # changes of a picture by one person within this time are one entry

Bar = dict[str, Any] | None
Size = tuple[int, int] | None


class ReviewLog:
    """The log of a folder, by name of the picture."""

    def __init__(self, store: Store) -> None:
        self._store = store
        self._entries: dict[str, list[dict[str, Any]]] = defaultdict(list)
        for entry in store.lines("review"):
            self._entries[entry["picture"]].append(entry)

    def add(self, did: str, who: str, pictures: Mapping[str, str | None]) -> None:
        """Append an entry for each picture, given with the revision of what was done to."""
        facts = {"time": datetime.now(UTC).isoformat(timespec="seconds"), "who": who, "did": did}
        entries = [{**facts, "picture": name, "revision": revision} for name, revision in pictures.items()]
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

    def who(self, did: str, name: str, revision: str | None = None) -> str | None:
        """Return whose action stands for a picture; if a ``revision`` is given, for this one."""
        last = self.standing(name, did)
        return None if last is None or last["revision"] != revision else last["who"] or "someone"


@dataclass(eq=False)
class PictureStates:
    """Describes pictures for the page from their listing, landmarks, proposals and reviews, and acts on several."""

    listing: Listing
    store: Store
    landmarks: LandmarkFiles
    proposals: Table
    unchecked: Table
    templates: Templates
    log: ReviewLog
    slips: dict[str, tuple[str, str, list[int]]] = field(default_factory=dict)
    """:meth:`version_of` the landmarks in which a slip was found, its description, and its points, by picture."""

    def ranks(self) -> dict[str, int]:
        """Rank the pictures that have only a proposal; 1 is the most useful to annotate (:func:`teaching_order`)."""
        unplaced = (file for file in self.listing.pictures if not self.landmarks.of(file).n_placed)
        waiting = {file.name: proposal for file in unplaced if (proposal := self.proposal_of(file)) is not None}
        return {name: rank for rank, name in enumerate(teaching_order(waiting), 1)}

    def as_json(self, file: File, ranks: Mapping[str, int] | None) -> dict[str, Any]:
        """Return one picture as JSON for the page; without ``ranks``, one whose files have not been read yet."""
        if ranks is None:
            return {"name": file.name, "tag": file.tag, "state": "reading", "placed": 0, "doubtful": False}
        size, marks = self.listing.size_of(file), self.landmarks.of(file)
        fault, (width, height) = (size, (None, None)) if isinstance(size, str) else (None, size)
        proposal = None if marks.n_placed or fault is not None else self.proposal_of(file)
        if fault is not None:
            state = "broken"
        elif marks.n_placed:
            state = "done" if self.is_done(file) else "partial"
        else:
            state = "proposed" if proposal else "unchecked" if self.unchecked.get(file.name) == file.tag else "new"
        slip, wrong = self.slip_of(file) if state == "done" else (None, [])
        return {
            "name": file.name,
            "tag": file.tag,
            "state": state,
            "placed": marks.n_placed,
            "error": fault or self._error_of(file, marks),
            "width": width,
            "height": height,
            "uncertainty": proposal["uncertainty"] if proposal else None,
            "quality": proposal["quality"] if proposal else None,
            "doubtful": bool(proposal and proposal["doubtful"]),
            "rank": ranks.get(file.name) if proposal else None,
            "checked": self.log.who("checked", file.name, marks.placement) if state == "done" else None,
            "slip": slip,
            "slip_points": wrong,
            "left_out": self.log.who("left out", file.name),
            "revision": marks.revision,
        }

    def marks_json(self, file: File) -> dict[str, Any]:
        """Return the landmarks of a picture as JSON for the page: from its file, from a proposal, or none."""
        width, height = self.listing.usable_size(file)
        template, marks = self.templates.current, self.landmarks.of(file)
        answer: dict[str, Any] = {
            "points": [None] * (0 if template is None else len(template)),
            "invisible": [],
            "revision": marks.revision,
            "source": "none",
            "tag": file.tag,
            "file": marks.file or None,
            **dict.fromkeys(("covariances", "quality", "status")),
            "doubtful": False,
            "error": marks.error,
            "width": width,
            "height": height,
            "bar": self.landmarks.scale_bar(file)["bar"],
        }
        if marks.landmarks is not None and marks.n_placed:
            answer |= {"points": marks.points, "invisible": list(marks.landmarks.invisible), "source": "file"}
        elif (proposal := self.proposal_of(file)) is not None:
            shown = ("points", "covariances", "quality", "status", "doubtful")
            answer |= {"source": "proposal", **{key: proposal[key] for key in shown}}
        return answer

    def proposal_of(self, file: File) -> dict[str, Any] | None:
        """Return the proposal for a picture, unless it does not fit the template or was discarded."""
        template, proposal = self.templates.current, self.proposals.of(file)
        if proposal is None or template is None or len(proposal["points"] or ()) != len(template):
            return None
        discarded = self.log.standing(file.name, "discarded")
        return None if discarded and discarded["revision"] == revision_of_proposal(proposal) else proposal

    def slip_of(self, file: File) -> tuple[str | None, list[int]]:
        """Return the slip that was found in the landmarks of a picture, and its points; None once they are checked."""
        marks = self.landmarks.of(file)
        revision, slip, wrong = self.slips.get(file.name, (None, None, []))
        is_open = revision == self.version_of(marks) and not self.log.who("checked", file.name, marks.placement)
        return (slip, wrong) if is_open else (None, [])

    def version_of(self, marks: Marks) -> str:
        """Return a value that changes with what a model is trained on: points and template, but not the scale."""
        return f"{marks.placement}-{self.templates.revision}"

    def is_done(self, file: File) -> bool:
        """Whether all points of a picture are placed, most of them inside it."""
        template, marks = self.templates.current, self.landmarks.of(file)
        is_complete = template is not None and marks.fits(template) and marks.n_placed == len(template)
        return is_complete and self._misplaced(file, marks) is None

    def _error_of(self, file: File, marks: Marks) -> str | None:
        template = self.templates.current
        if not marks.file:
            proposal = self.proposals.of(file) or {"points": ()}
            return self.landmarks.fault_of(file) or (str(proposal["message"]) if proposal["points"] is None else None)
        if marks.landmarks is not None and template is not None and len(marks.landmarks) != len(template):
            return (
                f"{marks.file} has {len(marks.landmarks)} points where the template has {len(template)}: "
                "place the points again (a copy of the file is kept), or remove that file"
            )
        return marks.error or self._misplaced(file, marks)

    def _misplaced(self, file: File, marks: Marks) -> str | None:
        """Return an error if most points lie outside the picture, as after it was replaced."""
        size = self.listing.size_of(file)
        if isinstance(size, str) or marks.landmarks is None:
            return None
        placed = marks.landmarks.points[~marks.landmarks.missing]
        n_outside = int(((placed < -0.5) | (placed > np.array(size) - 0.5)).any(axis=1).sum())
        if 2 * n_outside <= len(placed):
            return None
        return (
            f"{n_outside} of the {len(placed)} points of {marks.file} lie outside the picture of "
            f"{size[0]} x {size[1]} pixels, which may have been replaced: place them again, or put the picture back"
        )

    def apply(self, files: list[File], did: str, who: str, bar: Bar = None, like: Size = None) -> dict[str, Any]:
        """Apply an action. "scaled" sets ``bar``; with ``like``, only in pictures of this size without a scale yet.

        Return ``changed``, the names of the pictures that changed; ``refused``, reasons by name of the others;
        and ``revisions`` of landmarks that were written, by name.
        """
        if did not in ACTIONS:
            raise Refusal(422, f"the action is not known: send one of {', '.join(ACTIONS)}")
        revisions: dict[str, str | None] = {}
        refused: dict[str, str] = {}
        for file in files:
            try:
                revisions[file.name] = self._revision(file, did, bar, like)
            except (Refusal, LandmarkError) as fault:
                refused[file.name] = self.store.folder.plain(fault)
        if revisions:
            self.log.add(did, who, revisions)
        if did == "accepted" and revisions:
            self.templates.keep()  # the first save fixes a template that was taken from a file or offered
        written = [file for file in files if file.name in revisions] if did in WRITING else []
        if did in ("scaled", "unscaled"):
            self.landmarks.share_bar(written, bar)
        for file in written:
            marks, template = self.landmarks.of(file), self.templates.current
            if did in ("scaled", "unscaled"):
                has_place = self.landmarks.target(file).suffix.lower() != ".pts"
                if template is not None and marks.landmarks is not None and marks.fits(template) and has_place:
                    self.landmarks.save(file, template, marks.points, marks.landmarks.invisible)
                continue
            template = self.templates.needed
            if did == "undeleted":
                copy = self._copy_of(revisions[file.name] or "")
                points = [None if x != x else (x, y) for x, y in copy.points.tolist()]
                self.landmarks.save(file, template, points, copy.invisible, copy.scale)
            else:
                points = (self.proposal_of(file) or {})["points"] if did == "accepted" else [None] * len(template)
                self.landmarks.save(file, template, points, ())
        now = {file.name: self.landmarks.of(file).revision for file in written}
        return {"changed": list(revisions), "refused": refused, "revisions": now}

    def _revision(self, file: File, did: str, bar: Bar, like: Size) -> str | None:
        """Return the revision of what an action is done to; refuse one that changes nothing."""
        marks, proposal = self.landmarks.of(file), self.proposal_of(file)
        if did in ("scaled", "unscaled"):
            known, size = self.landmarks.scale_bar(file), self.listing.usable_size(file)
            shares = "before" in known  # it was drawn on another picture
            if bar is None and not shares:
                raise Refusal(409, "the scale was not set together with others")
            if like and self.landmarks.scale_of(file) is not None and not shares:
                raise Refusal(409, "has a scale of its own")
            if like and sorted(size) != sorted(like):
                raise Refusal(409, "has another size in pixels, so perhaps another scale")
            if bar and known["bar"] == bar:
                raise Refusal(409, "has this scale already")
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
            if self.log.who("left out", file.name) is None:
                return None
            raise Refusal(409, "left out of training already")
        if did == "checked":
            if not self.is_done(file):
                raise Refusal(409, "not all points are placed: place them first")
            if self.log.who("checked", file.name, marks.placement):
                raise Refusal(409, "checked already")
            return marks.placement
        if marks.landmarks is None or not marks.n_placed:
            raise Refusal(409, "no landmarks")
        text = text_of(marks.landmarks, ".ljson")
        revision = revision_of(text.encode())
        self.store.put("deleted", {revision: text})
        return revision

    def _copy_of(self, revision: str) -> Landmarks:
        """Return deleted landmarks; raise LandmarkError if they are gone."""
        text = self.store.get("deleted", revision)
        landmarks = None if text is None else parse_landmark_data("copy.ljson", text.encode())
        if not isinstance(landmarks, Landmarks):
            raise LandmarkError("the deleted landmarks are not kept any more")
        return landmarks


def teaching_order(proposals: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Order pictures by how useful their annotation is for training (active learning).

    First come pictures in which the search is confident (``found``) but the fit failed (not ``ok``): the object
    looks unlike those in the training pictures. Then pictures by decreasing ``uncertainty``. Last come pictures in
    which the search itself has low confidence: often the object is occluded, cut off or missing, so that annotation
    takes long and helps little.
    """

    def key(name: str) -> tuple[int, float]:
        proposal = proposals[name]
        group = 2 if not proposal["found"] else int(bool(proposal["ok"]))
        return group, -(proposal["uncertainty"] or 0.0)

    return sorted(proposals, key=key)


def parse_who(name: Any) -> str:
    """Check the name of the person who works in the page; "" if it is not known."""
    name = "" if name is None else name
    if not isinstance(name, str) or len(name) > LONGEST_NAME or not name.isprintable():
        raise Refusal(422, f"your name is not valid: enter at most {LONGEST_NAME} printable characters")
    return name.strip()
