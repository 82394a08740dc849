"""Places that the model found in pictures, to be looked at by a person: ``proposals.json``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from liaam.studio.listing import File, Listing
from liaam.studio.state_files import StateFiles
from liaam.studio.template import Template, parse_points

PROPOSALS_FILE = "proposals.json"


class Proposals:
    """Proposals for the pictures of a folder, by the picture's name."""

    def __init__(self, listing: Listing, state: StateFiles) -> None:
        self._listing = listing
        self._state = state
        self._kept: dict[str, dict[str, Any]] = state.read(PROPOSALS_FILE, _are_proposals) or {}

    def add(self, proposals: Mapping[str, dict[str, Any]]) -> None:
        """Keep proposals; one that does not say of which file it is counts as of that of now."""
        tags = {name: file.tag for name, file in self._listing.files.items()}
        self._kept.update({name: {"tag": tags.get(name), **item} for name, item in proposals.items()})
        self._state.write(PROPOSALS_FILE, self._kept)

    def forget(self) -> None:
        """Drop all proposals: they are of another template."""
        self._kept = {}
        self._state.write(PROPOSALS_FILE, self._kept)

    def of(self, picture: File) -> dict[str, Any] | None:
        """Proposal for a picture, unless another picture has taken its name since."""
        proposal = self._kept.get(picture.name)
        return proposal if proposal is not None and proposal.get("tag") == picture.tag else None

    def with_points(self, picture: File, template: Template | None) -> dict[str, Any] | None:
        """Proposal for a picture that has points, and as many as the template."""
        proposal = self.of(picture)
        if proposal is None or proposal["points"] is None or template is None:
            return None
        return proposal if len(proposal["points"]) == len(template) else None


def teaching_order(proposals: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Order pictures by how much their annotation would teach the model; the one place that says so.

    First those where the object was surely found but the fit failed or is doubtful: the object is there, and looks as
    no training picture does. Then by uncertainty, highest first: mean deviation of the landmarks as a share of the
    object's size. Last those where the search itself is doubtful: most often the object is hidden, cut off or not
    there, which costs a person much work and teaches the model little.

    Parameters
    ----------
    proposals : dict of str to dict
        By the picture's name, with ``found`` (whether the search is sure), ``ok`` and ``uncertainty``.
    """

    def key(name: str) -> tuple[int, float]:
        proposal = proposals[name]
        group = 2 if not proposal["found"] else int(bool(proposal["ok"]))
        return group, -(proposal["uncertainty"] or 0.0)

    return sorted(proposals, key=key)


def is_proposal(item: Any) -> bool:
    """Whether JSON is a proposal as :mod:`liaam.studio.training_process` makes them."""
    keys = {"points", "covariances", "quality", "status", "ok", "message", "found", "doubtful", "uncertainty"}
    if set(item) - {"tag"} != keys or not isinstance(item["message"], str):
        return False
    if item["uncertainty"] is not None and not isinstance(item["uncertainty"], int | float):
        return False
    return item["points"] is None or None not in parse_points(item["points"], len(item["points"]))


def _are_proposals(data: Any) -> bool:
    return all(is_proposal(item) for item in data.values())
