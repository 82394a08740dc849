"""Reviews: who changed what, the state of each picture that follows from it, and actions on several pictures.

A picture is checked while its landmarks have the revision that was checked, so every change withdraws the check. The
other states hold until the opposite entry. An action is written to the log before anything else changes.
"""

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from itertools import islice
from typing import Any

import numpy as np

from liaam.errors import LandmarkError
from liaam.io.landmarks import Landmarks, parse_landmark_data
from liaam.studio import contract
from liaam.studio.folder import File, Listing, revision_of
from liaam.studio.landmark_files import LandmarkFiles, Marks, revision_of_proposal
from liaam.studio.measuring import kept_in, pixel_by
from liaam.studio.origins import OWN, Origin, Origins
from liaam.studio.refusal import Refusal
from liaam.studio.store import Store, StoredTable
from liaam.studio.template import Templates, text_of

UNDONE = {
    "unchecked": ("checked", "not checked"),
    "taken in": ("left out", "not left out of training"),
    "restored": ("discarded", "no proposed points were discarded"),
    "undeleted": ("deleted", "no landmarks were deleted here"),
}
"""Actions, the actions that they undo, and why there may be nothing to undo."""

OPPOSITE = {done: undo for undo, (done, _) in UNDONE.items()}
"""The action that undoes each of those that can be undone."""

ACTIONS = (*OPPOSITE, *UNDONE, "accepted", "scaled", "unscaled")
"""All actions that the page may send."""

CHANGES = ("placed", "accepted", "cleared")
"""Entries of the log after which the points of a picture are others."""

WRITING = ("accepted", "deleted", "undeleted", "scaled", "unscaled")
"""Actions that write landmark files."""

LONGEST_NAME = 60  # largest number of characters of a person's name
SHOWN = 20  # number of entries of a picture that the page shows
SAME_WORK = timedelta(minutes=10)  # changes of a picture by one person within this time are one entry

Bar = contract.Bar | None  # a scale bar as the page sends it, or none
Size = tuple[int, int] | None  # width and height of a picture, pixels, or none


class ReviewLog:
    """The log of a folder, by name of the picture."""

    def __init__(self, store: Store) -> None:
        self._store = store
        self._entries: dict[str, list[contract.HistoryEntry]] = defaultdict(list)
        for entry in store.lines("review"):
            self._entries[entry["picture"]].append(entry)

    def add(self, did: str, who: str, pictures: Mapping[str, str | None]) -> None:
        """Append an entry for each picture, given with the revision of what the action was done to."""
        time = datetime.now(UTC).isoformat(timespec="seconds")
        entries: list[contract.HistoryEntry] = [
            {"time": time, "who": who, "did": did, "picture": name, "revision": revision}
            for name, revision in pictures.items()
        ]
        self._store.append("review", entries)
        for entry in entries:
            self._entries[entry["picture"]].append(entry)

    def rename(self, name: str, new: str) -> None:
        """Give the entries of a picture its new name."""

        def changed(entry: contract.HistoryEntry) -> contract.HistoryEntry:
            return {**entry, "picture": new} if entry["picture"] == name else entry

        self._store.replace_lines("review", changed)
        entries = [changed(entry) for entry in self._entries.pop(name, [])]
        if entries:
            self._entries[new] = entries

    def add_change(self, who: str, name: str, did: str, revision: str | None) -> None:
        """Append that the points of a picture were placed or cleared, once for all changes in a few minutes."""
        if not self._is_same_work(who, name, did):
            self.add(did, who, {name: revision})

    def _is_same_work(self, who: str, name: str, did: str) -> bool:
        """Whether the last entry of a picture is of the same person and action, a few minutes ago."""
        entries = self._entries.get(name)
        if not entries:
            return False
        last = entries[-1]
        age = datetime.now(UTC) - datetime.fromisoformat(last["time"])
        return age < SAME_WORK and last["who"] == who and last["did"] == did

    def last_change(self, name: str) -> str | None:
        """Return how the points of a picture were changed last, one of :data:`CHANGES`; None if they were not."""
        newest_first = reversed(self._entries.get(name, []))
        return next((entry["did"] for entry in newest_first if entry["did"] in CHANGES), None)

    def history(self, name: str) -> list[contract.HistoryEntry]:
        """Return the last entries of a picture, newest first."""
        newest_first = reversed(self._entries.get(name, []))
        return list(islice(newest_first, SHOWN))

    def standing(self, name: str, did: str) -> contract.HistoryEntry | None:
        """Return the last entry of an action, unless it was undone later."""
        for entry in reversed(self._entries.get(name, [])):
            if entry["did"] == did:
                return entry
            if entry["did"] == OPPOSITE[did]:
                return None
        return None

    def who(self, did: str, name: str, revision: str | None = None) -> str | None:
        """Return whose action stands for a revision of a picture; None if there is none.

        Actions on a picture as a whole, such as leaving it out, have no revision.
        """
        entry = self.standing(name, did)
        if entry is None or entry["revision"] != revision:
            return None
        return entry["who"] or "someone"  # who did not enter a name


class Done(contract.Reviewed):
    """What an action has done, also to landmark files."""

    revisions: dict[str, str | None]  # of landmarks that were written, by picture


@dataclass(frozen=True, eq=False)
class _Count:
    """How many points of a picture are unconfirmed, of its landmarks and what is stored of their origins.

    ``proposed`` counts those that are still as they were proposed.
    """

    marks: Marks
    origins: Mapping[str, Any] | None
    unconfirmed: int
    proposed: int

    def holds(self, marks: Marks, origins: Mapping[str, Any] | None) -> bool:
        """Whether landmarks and origins are still those that were counted: both are replaced when they change."""
        return self.marks is marks and self.origins is origins


@dataclass(eq=False)
class PictureStates:
    """Describes pictures for the page from their listing, landmarks, proposals and reviews, and acts on several."""

    listing: Listing
    store: Store
    landmarks: LandmarkFiles
    proposals: StoredTable
    unchecked: StoredTable
    templates: Templates
    log: ReviewLog
    origins: Origins
    absent: StoredTable
    """Indices of the points that are absent in the object that a picture shows, by picture."""

    slips: dict[str, tuple[str, str, list[int]]] = field(default_factory=dict)
    """:meth:`version_of` the landmarks in which a slip was found, its description, and its points, by picture."""

    _counts: dict[str, "_Count"] = field(default_factory=dict)
    """The last :meth:`_count` by picture."""

    def ranks(self) -> dict[str, int]:
        """Rank the pictures that have only a proposal; 1 is the most useful to annotate (:func:`teaching_order`)."""
        waiting = {}
        for file in self.listing.pictures:
            if self.landmarks.of(file).n_placed:
                continue
            proposal = self.proposal_of(file)
            if proposal is not None:
                waiting[file.name] = proposal
        return {name: rank for rank, name in enumerate(teaching_order(waiting), 1)}

    def as_json(self, file: File, ranks: Mapping[str, int] | None) -> contract.Picture:
        """Return one picture as JSON for the page; without ``ranks``, one whose files have not been read yet."""
        if ranks is None:
            return {"name": file.name, "tag": file.tag, "state": "reading", "placed": 0, "doubtful": False}
        marks = self.landmarks.of(file)
        size = self.listing.size_of(file)
        if isinstance(size, str):  # why the picture cannot be read
            fault = size
            width = height = None
        else:
            fault = None
            width, height = size
        proposal = None
        count = self._count(file, marks)
        n_proposed = count.proposed if count else 0
        if fault is None and (n_proposed or not marks.n_placed):
            proposal = self.proposal_of(file)
        state: contract.Progress = "broken" if fault is not None else self._state_of(file, marks, proposal)
        checked_by = slip = None
        wrong_points: list[int] = []
        if state == "done":
            checked_by = self.log.who("checked", file.name, marks.placement)
            slip, wrong_points = self.slip_of(file)
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
            "nothing_found": bool(proposal and proposal.get("nothing_found")),  # of earlier versions: not known
            "rank": ranks.get(file.name) if proposal else None,
            "checked": checked_by,
            "slip": slip,
            "slip_points": wrong_points,
            "left_out": self.log.who("left out", file.name),
            "absent": len(self.absent_of(file, marks)),
            "unconfirmed": count.unconfirmed if count else 0,
            "proposed": n_proposed,
            "revision": marks.revision,
            "side": self.landmarks.side_of(file),
        }

    def _state_of(self, file: File, marks: Marks, proposal: Mapping[str, Any] | None) -> contract.Progress:
        """Return the state of a picture that can be read, by which the page groups pictures."""
        if marks.n_placed:
            return "done" if self.is_done(file) else "partial"
        if proposal:
            return "proposed"
        if self.unchecked.get(file.name) == file.tag:
            return "unchecked"
        return "new"

    def marks_json(self, file: File) -> contract.Marks:
        """Return the landmarks of a picture as JSON for the page: from its file, from a proposal, or none."""
        width, height = self.listing.usable_size(file)
        template = self.templates.current
        marks = self.landmarks.of(file)
        n_points = 0 if template is None else len(template)
        scale_bar = self.landmarks.scale_bar(file)
        answer: contract.Marks = {
            "points": [None] * n_points,
            "invisible": [],
            "revision": marks.revision,
            "source": "none",
            "tag": file.tag,
            "file": marks.file or None,
            "covariances": None,
            "fitted": None,
            "quality": None,
            "status": None,
            "doubtful": False,
            "error": marks.error,
            "width": width,
            "height": height,
            "bar": scale_bar["bar"],
            "bar_shared": "before" in scale_bar,
            "pixel": None if scale_bar["bar"] else self._pixel_of(file),
            "absent": self.absent_of(file, marks),
            "origins": None,
            "beside": self.beside(file, marks),
        }
        proposal = self.proposal_of(file)
        if proposal is not None:
            answer["covariances"] = proposal["covariances"]
            answer["fitted"] = proposal["points"]
        if marks.landmarks is not None and marks.n_placed:
            answer["source"] = "file"
            answer["points"] = marks.points
            answer["invisible"] = list(marks.landmarks.invisible)
            answer["origins"] = self.origins_of(file, marks)
        elif proposal is not None:
            answer["source"] = "proposal"
            for key in ("points", "quality", "status", "doubtful"):
                answer[key] = proposal[key]
            answer["absent"] = self._absent_with(file, proposal)
            answer["points"] = [None if i in answer["absent"] else point for i, point in enumerate(answer["points"])]
        return answer

    def _pixel_of(self, file: File) -> contract.Pixel | None:
        """Return the length of a pixel of a picture by its file, or else by what is kept for all; None if unknown."""
        length = self.landmarks.scale_of(file)
        if not length:
            return pixel_by(kept_in(self.store))
        unit = self.landmarks.unit_of(file)
        return {"length": length, "unit": unit} if unit else None

    def _absent_with(self, file: File, proposal: Mapping[str, Any]) -> list[int]:
        """Return the points that a person said to be absent in a picture, and those that the model found absent.

        What the model finds counts once a person has marked a point as absent in any picture: of objects that are all
        complete, it would be wrong wherever it says so.
        """
        found = proposal.get("absent", ()) if any(self.absent.values()) else ()
        return sorted({*self.absent.get(file.name, ()), *found})

    def beside(self, file: File, marks: Marks) -> str:
        """Return a hash of the absent points and the origins of a picture, which its landmark file does not hold."""
        return revision_of(repr((self.absent_of(file, marks), self.origins.entry(file.name))).encode())

    def absent_of(self, file: File, marks: Marks) -> list[int]:
        """Return the points that the object in a picture lacks; those with a position are there after all."""
        absent = self.absent.get(file.name)
        template = self.templates.current
        if not absent or template is None:
            return []
        placed = marks.points if marks.fits(template) else [None] * len(template)
        return [index for index in absent if index < len(template) and placed[index] is None]

    def origins_of(self, file: File, marks: Marks) -> list[Origin | None]:
        """Return the origin of each point in a picture's landmark file; None without a position."""
        if self._were_accepted(file):
            return [None if point is None else "accepted" for point in marks.points]
        return self.origins.of(file.name, marks.points)

    def _were_accepted(self, file: File) -> bool:
        """Whether all points were accepted together by an earlier version, which stored no origins."""
        return file.name not in self.origins and self.log.last_change(file.name) == "accepted"

    def _count(self, file: File, marks: Marks) -> _Count | None:
        """Count the points of a picture that no person has placed, moved or confirmed one by one; None if all were."""
        if file.name not in self.origins and not self._were_accepted(file):
            return None
        entry = self.origins.entry(file.name)
        count = self._counts.get(file.name)
        if count is None or not count.holds(marks, entry):
            origins = self.origins_of(file, marks)
            unconfirmed = sum(origin not in (None, *OWN) for origin in origins)
            count = _Count(marks, entry, unconfirmed, origins.count("proposed"))
            self._counts[file.name] = count
        return count

    def proposal_of(self, file: File) -> dict[str, Any] | None:
        """Return the proposal for a picture, unless it does not fit the template or was discarded."""
        template = self.templates.current
        proposal = self.proposals.of(file)
        if proposal is None or template is None:
            return None
        points = proposal["points"]  # None if the fit failed
        if points is None or len(points) != len(template):
            return None
        discarded = self.log.standing(file.name, "discarded")
        if discarded and discarded["revision"] == revision_of_proposal(proposal):
            return None
        return proposal

    def slip_of(self, file: File) -> tuple[str | None, list[int]]:
        """Return the slip that was found in the landmarks of a picture, and its points; None once they are checked."""
        if file.name not in self.slips:
            return None, []
        version, slip, wrong_points = self.slips[file.name]
        marks = self.landmarks.of(file)
        has_changed = version != self.version_of(file, marks)
        is_checked = self.log.who("checked", file.name, marks.placement) is not None
        if has_changed or is_checked:
            return None, []
        return slip, wrong_points

    def version_of(self, file: File, marks: Marks) -> str:
        """Return a value that changes with what a model is trained on: points, template and side, but not the scale."""
        side = self.landmarks.side_of(file)
        version = f"{marks.placement}-{self.templates.revision}"
        return f"{version}-{side}" if side else version

    def is_done(self, file: File) -> bool:
        """Whether a person said of all points where they are, most of them inside the picture, or that they are absent.

        If a few points of a proposal were moved, the picture is not done until the others are accepted.
        """
        template = self.templates.current
        marks = self.landmarks.of(file)
        if template is None or not marks.fits(template):
            return False
        if marks.n_placed + len(self.absent_of(file, marks)) < len(template):
            return False
        count = self._count(file, marks)
        if count is not None and count.proposed:
            return False
        return self._misplaced(file, marks) is None

    def _error_of(self, file: File, marks: Marks) -> str | None:
        """Return what is wrong with the landmarks of a usable picture, or why the model proposed none."""
        if not marks.file:
            return self.landmarks.fault_of(file) or self._failure_of_fit(file)
        template = self.templates.current
        if marks.landmarks is not None and template is not None and len(marks.landmarks) != len(template):
            return (
                f"{marks.file} has {len(marks.landmarks)} points where the template has {len(template)}: "
                "place the points again (a copy of the file is kept), or remove that file"
            )
        return marks.error or self._misplaced(file, marks)

    def _failure_of_fit(self, file: File) -> str | None:
        """Return why the fit that would be proposed for a picture failed; None if it did not, or there was none."""
        proposal = self.proposals.of(file)
        if proposal is None or proposal["points"] is not None:
            return None
        return str(proposal["message"])

    def _misplaced(self, file: File, marks: Marks) -> str | None:
        """Return an error if most points lie outside the picture, as after it was replaced."""
        size = self.listing.size_of(file)
        if isinstance(size, str) or marks.landmarks is None:
            return None
        placed = marks.landmarks.points[~marks.landmarks.missing]
        # Coordinates are of pixel centres, so the picture ends half a pixel beyond the last.
        is_outside = (placed < -0.5) | (placed > np.array(size) - 0.5)
        n_outside = int(is_outside.any(axis=1).sum())
        if 2 * n_outside <= len(placed):
            return None
        return (
            f"{n_outside} of the {len(placed)} points of {marks.file} lie outside the picture of "
            f"{size[0]} x {size[1]} pixels, which may have been replaced: place them again, or put the picture back"
        )

    def apply(self, files: list[File], did: str, who: str, bar: Bar = None, like: Size = None) -> Done:
        """Apply an action. "scaled" sets ``bar``; with ``like``, only in pictures of this size without a scale yet."""
        if did not in ACTIONS:
            raise Refusal(422, f"the action is not known: send one of {', '.join(ACTIONS)}")
        if did in WRITING:
            self.store.folder.check_writable()
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
        changed = [file for file in files if file.name in revisions]
        written = changed if did in WRITING else []
        if did in ("scaled", "unscaled"):
            self.landmarks.share_bar(written, bar)
        for file in written:
            self._write(file, did, revisions[file.name])
        return {
            "changed": list(revisions),
            "refused": refused,
            "revisions": {file.name: self.landmarks.of(file).revision for file in written},
        }

    def _revision(self, file: File, did: str, bar: Bar, like: Size) -> str | None:
        """Return the revision of what an action is done to. Refuse an action that changes nothing.

        That is the revision of the landmarks, of their placement where they are checked, or of the proposal. An action
        that undoes another has the revision of that one. Leaving a picture out has none. Before landmarks are deleted,
        they are kept in the store.
        """
        if did in ("scaled", "unscaled"):
            return self._revision_to_scale(file, bar, like)
        if did in UNDONE:
            return self._revision_to_undo(file, did)
        if did in ("accepted", "discarded"):
            return self._revision_of_waiting_proposal(file)
        if did == "left out":
            if self.log.who("left out", file.name) is not None:
                raise Refusal(409, "left out of training already")
            return None
        if did == "checked":
            return self._revision_to_check(file)
        return self._revision_to_delete(file)

    def _revision_to_scale(self, file: File, bar: Bar, like: Size) -> str | None:
        """Return the revision of the landmarks of a picture whose scale is set.

        Refuse to replace a scale of the picture's own, and to share one among pictures of several sizes.
        """
        scale_bar = self.landmarks.scale_bar(file)
        size = self.listing.usable_size(file)
        is_shared = "before" in scale_bar  # it was drawn on another picture
        if bar is None and not is_shared:
            raise Refusal(409, "the scale was not set together with others")
        if like and self.landmarks.scale_of(file) is not None and not is_shared:
            raise Refusal(409, "has a scale of its own")
        if like and sorted(size) != sorted(like):  # a picture that was turned has the same scale
            raise Refusal(409, "has another size in pixels, so perhaps another scale")
        if bar and scale_bar["bar"] == bar:
            raise Refusal(409, "has this scale already")
        return self.landmarks.of(file).revision

    def _revision_to_undo(self, file: File, did: str) -> str | None:
        """Return the revision of what the action was done to that is undone.

        Refuse if no such action stands, or if deleted landmarks have no place any more.
        """
        marks = self.landmarks.of(file)
        if did == "undeleted" and marks.n_placed:
            raise Refusal(409, "there are landmarks again")
        done, why_not = UNDONE[did]
        last = self.log.standing(file.name, done)
        if last is None or (done == "checked" and last["revision"] != marks.placement):
            raise Refusal(409, why_not)
        if done == "deleted" and len(self._copy_of(last["revision"] or "")) != len(self.templates.needed):
            raise Refusal(409, "the deleted landmarks belong to an earlier template")
        return last["revision"]

    def _revision_of_waiting_proposal(self, file: File) -> str:
        """Return the revision of a proposal. Refuse if there is none, or landmarks have been placed since."""
        proposal = self.proposal_of(file)
        if proposal is None or self.landmarks.of(file).n_placed:
            raise Refusal(409, "no proposed points")
        return revision_of_proposal(proposal)

    def _revision_to_check(self, file: File) -> str | None:
        """Return the placement of the landmarks of a picture. Refuse if it is not complete, or checked already."""
        marks = self.landmarks.of(file)
        if not self.is_done(file):
            count = self._count(file, marks)
            if count is not None and count.proposed:
                raise Refusal(409, "some points are only proposed: open it, and press Enter if they are right")
            raise Refusal(409, "not all points are placed: place them first")
        placement = marks.placement
        if self.log.who("checked", file.name, placement):
            raise Refusal(409, "checked already")
        return placement

    def _revision_to_delete(self, file: File) -> str:
        """Keep a copy of the landmarks in the store, and return its revision. Refuse if there are none."""
        marks = self.landmarks.of(file)
        if marks.landmarks is None or not marks.n_placed:
            raise Refusal(409, "no landmarks")
        text = text_of(marks.landmarks, ".ljson")
        revision = revision_of(text.encode())
        self.store.put("deleted", {revision: text})
        return revision

    def _write(self, file: File, did: str, revision: str | None) -> None:
        """Write the landmarks of a picture, as an action wants them."""
        if did in ("scaled", "unscaled"):
            self._write_scale(file)
            return
        template = self.templates.needed
        if did == "accepted":
            proposal = self.proposal_of(file) or {}
            absent = self._absent_with(file, proposal)
            points = [None if index in absent else point for index, point in enumerate(proposal["points"])]
            self.absent.save({file.name: absent or None})
            accepted: list[Origin | None] = ["accepted"] * len(points)
            self.origins.save(file.name, points, accepted)
            self.landmarks.save(file, template, points, ())
        elif did == "undeleted":
            copy = self._copy_of(revision or "")
            points = [None if x != x else (x, y) for x, y in copy.points.tolist()]  # of a missing point, x is NaN
            self.landmarks.save(file, template, points, copy.invisible, copy.scale)
        else:  # deleted
            self.landmarks.save(file, template, [None] * len(template), ())

    def _write_scale(self, file: File) -> None:
        """Write the scale of a picture into its landmark file, unless that is a .pts, which holds none."""
        marks = self.landmarks.of(file)
        template = self.templates.current
        can_hold_scale = self.landmarks.target(file).suffix.lower() != ".pts"
        if can_hold_scale and template is not None and marks.landmarks is not None and marks.fits(template):
            self.landmarks.save(file, template, marks.points, marks.landmarks.invisible)

    def _copy_of(self, revision: str) -> Landmarks:
        """Return deleted landmarks; raise LandmarkError if they are gone."""
        text = self.store.get("deleted", revision)
        if text is not None:
            landmarks = parse_landmark_data("copy.ljson", text.encode())
            if isinstance(landmarks, Landmarks):
                return landmarks
        raise LandmarkError("the deleted landmarks are not kept any more")


def teaching_order(proposals: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Order pictures by how useful their annotation is for training (active learning).

    First come pictures in which the search is confident (``found``) but the fit failed (not ``ok``): the object
    looks unlike those in the training pictures. Then pictures by decreasing ``uncertainty``. Last come pictures in
    which the search itself has low confidence: often the object is occluded, cut off or missing, so that annotation
    takes long and helps little.
    """

    def key(name: str) -> tuple[int, float]:
        proposal = proposals[name]
        if not proposal["found"]:
            group = 2
        elif proposal["ok"]:
            group = 1
        else:
            group = 0
        uncertainty = proposal["uncertainty"] or 0.0
        return group, -uncertainty

    return sorted(proposals, key=key)


def parse_who(name: Any) -> str:
    """Check the name of the person who works in the page; "" if it is not known."""
    if name is None:
        return ""
    if not isinstance(name, str) or len(name) > LONGEST_NAME or not name.isprintable():
        raise Refusal(422, f"your name is not valid: enter at most {LONGEST_NAME} printable characters")
    return name.strip()
