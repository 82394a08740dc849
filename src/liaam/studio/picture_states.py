"""The state of each picture of a project (reading, new, unchecked, proposed, partial, done or broken) and its error."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from liaam.studio.folder import File, Listing
from liaam.studio.landmark_files import LandmarkFiles, Marks
from liaam.studio.proposals import Proposals, revision_of_proposal, teaching_order
from liaam.studio.review import ReviewLog
from liaam.studio.templates import Templates


@dataclass(frozen=True, eq=False)
class PictureStates:
    """Describes pictures for the page from their listing, landmarks, proposals and reviews."""

    listing: Listing
    landmarks: LandmarkFiles
    proposals: Proposals
    templates: Templates
    log: ReviewLog
    slips: dict[str, tuple[str, str, list[int]]] = field(default_factory=dict)
    """:meth:`version_of` the landmarks in which a slip was found, its description, and its points, by picture."""

    def ranks(self) -> dict[str, int]:
        """Rank the pictures that have only a proposal; 1 is the most useful to annotate (:func:`teaching_order`)."""
        waiting = {
            file.name: proposal
            for file in self.listing.pictures
            if (proposal := self.proposal_of(file)) is not None and not self.landmarks.of(file).n_placed
        }
        return {name: rank for rank, name in enumerate(teaching_order(waiting), 1)}

    def is_read(self, file: File) -> bool:
        """Whether the files of a picture were read before, so that its state is known at once."""
        return self.listing.is_read(file) and self.landmarks.is_read(file)

    def as_json(self, file: File, ranks: Mapping[str, int]) -> dict[str, Any]:
        """Return one picture as JSON for the page."""
        size, fault, marks = self.listing.size_of(file), self.listing.fault_of(file), self.landmarks.of(file)
        proposal = None if marks.n_placed or fault is not None else self.proposal_of(file)
        if fault is not None:
            state = "broken"
        elif marks.n_placed:
            state = "done" if self.is_done(file) else "partial"
        else:
            state = "proposed" if proposal else "unchecked" if self.proposals.is_unchecked(file) else "new"
        checked = self.log.checked_by(file.name, marks.placement) if state == "done" else None
        slip, wrong = self.slip_of(file) if state == "done" else (None, [])
        return {
            "name": file.name,
            "tag": file.tag,
            "state": state,
            "placed": marks.n_placed,
            "error": fault or self._error_of(file, marks),
            "width": None if isinstance(size, str) else size[0],
            "height": None if isinstance(size, str) else size[1],
            "uncertainty": proposal["uncertainty"] if proposal else None,
            "quality": proposal["quality"] if proposal else None,
            "doubtful": bool(proposal and proposal["doubtful"]),
            "rank": ranks.get(file.name) if proposal else None,
            "checked": checked,
            "slip": slip,
            "slip_points": wrong,
            "left_out": self.log.left_out_by(file.name),
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
            "covariances": None,
            "quality": None,
            "status": None,
            "doubtful": False,
            "error": marks.error,
            "width": width,
            "height": height,
            "bar": self.landmarks.bar_of(file),
        }
        if marks.landmarks is not None and marks.n_placed:
            return {**answer, "points": marks.points, "invisible": list(marks.landmarks.invisible), "source": "file"}
        proposal = self.proposal_of(file)
        if proposal is None:
            return answer
        shown = ("points", "covariances", "quality", "status", "doubtful")
        return {**answer, **{key: proposal[key] for key in shown}, "source": "proposal"}

    def proposal_of(self, file: File) -> dict[str, Any] | None:
        """Return the proposal for a picture, unless it does not fit the template or was discarded."""
        template, proposal = self.templates.current, self.proposals.of(file)
        points = None if proposal is None else proposal["points"]
        if proposal is None or points is None or template is None or len(points) != len(template):
            return None
        discarded = self.log.standing(file.name, "discarded")
        return None if discarded and discarded["revision"] == revision_of_proposal(proposal) else proposal

    def slip_of(self, file: File) -> tuple[str | None, list[int]]:
        """Return the slip that was found in the landmarks of a picture, and its points; None once they are checked."""
        marks = self.landmarks.of(file)
        revision, slip, wrong = self.slips.get(file.name, (None, None, []))
        is_open = revision == self.version_of(marks) and not self.log.checked_by(file.name, marks.placement)
        return (slip, wrong) if is_open else (None, [])

    def version_of(self, marks: Marks) -> str:
        """Return a value that changes with what a model is trained on: points and template, but not the scale."""
        return f"{marks.placement}-{self.templates.revision}"

    def is_done(self, file: File) -> bool:
        """Whether all points of a picture are placed, most of them inside it."""
        template, marks = self.templates.current, self.landmarks.of(file)
        if template is None or marks.landmarks is None:
            return False
        is_complete = marks.n_placed == len(template) == len(marks.landmarks)
        return is_complete and self._misplaced(file, marks) is None

    def _error_of(self, file: File, marks: Marks) -> str | None:
        """Return what is wrong with the landmarks of a usable picture."""
        template = self.templates.current
        if not marks.file:
            proposal = self.proposals.of(file)
            failed = proposal is not None and proposal["points"] is None
            return self.landmarks.fault_of(file) or (proposal["message"] if proposal and failed else None)
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
