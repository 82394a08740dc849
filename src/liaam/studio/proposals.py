"""Landmarks proposed by the model, for a person to check (``proposals.json``), and pictures left at the mean shape
(``unchecked.json``).
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from liaam.studio.folder import revision_of
from liaam.studio.listing import File, Listing
from liaam.studio.state_files import StateFiles
from liaam.studio.template import parse_points

PROPOSALS_FILE = "proposals.json"
UNCHECKED_FILE = "unchecked.json"


class Proposals:
    """Proposals for the pictures of a folder, by name of the picture."""

    def __init__(self, listing: Listing, state: StateFiles) -> None:
        self._listing = listing
        self._state = state
        self._kept: dict[str, dict[str, Any]] = state.read(PROPOSALS_FILE, _are_proposals) or {}

    def add(self, proposals: Mapping[str, dict[str, Any]]) -> None:
        """Save proposals; the default ``tag`` is that of the current file."""
        tags = {name: file.tag for name, file in self._listing.files.items()}
        self._kept.update({name: {"tag": tags.get(name), **item} for name, item in proposals.items()})
        self._state.write(PROPOSALS_FILE, self._kept)

    def forget(self) -> None:
        """Drop all proposals, because the template changed."""
        self._kept = {}
        self._state.write(PROPOSALS_FILE, self._kept)

    def of(self, picture: File) -> dict[str, Any] | None:
        """Return the proposal for a picture, unless the picture has been replaced since."""
        proposal = self._kept.get(picture.name)
        return proposal if proposal is not None and proposal.get("tag") == picture.tag else None


def revision_of_proposal(proposal: Mapping[str, Any]) -> str:
    """Return a hash of a proposal."""
    return revision_of(json.dumps(proposal, sort_keys=True).encode())


class Unchecked:
    """Pictures that were left at the mean shape. They have no landmark file, so no training uses them."""

    def __init__(self, state: StateFiles) -> None:
        self._state = state
        self._tags: dict[str, str] = state.read(UNCHECKED_FILE, _are_tags) or {}

    def __contains__(self, picture: File) -> bool:
        return self._tags.get(picture.name) == picture.tag

    def mark(self, picture: File, unchecked: bool) -> None:
        """Mark a picture as not checked, or remove the mark."""
        if (picture in self) == unchecked:
            return
        tags = {name: tag for name, tag in self._tags.items() if name != picture.name}
        tags |= {picture.name: picture.tag} if unchecked else {}
        self._state.write(UNCHECKED_FILE, tags)
        self._tags = tags


def teaching_order(proposals: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Order pictures by how useful their annotation is for training (active learning).

    First come pictures in which the search is confident but the fit failed or has low confidence: the object looks
    unlike those in the training pictures. Then pictures by decreasing uncertainty, the mean standard deviation of the
    landmarks relative to the object's size. Last come pictures in which the search itself has low confidence: often the
    object is occluded, cut off or missing, so that annotation takes long and helps little.

    Parameters
    ----------
    proposals : dict of str to dict
        Proposals by name of the picture, with ``found`` (whether the search is confident), ``ok`` and ``uncertainty``.
    """

    def key(name: str) -> tuple[int, float]:
        proposal = proposals[name]
        group = 2 if not proposal["found"] else int(bool(proposal["ok"]))
        return group, -(proposal["uncertainty"] or 0.0)

    return sorted(proposals, key=key)


def is_proposal(item: Any) -> bool:
    """Whether JSON is a proposal of :mod:`liaam.studio.training_process`."""
    keys = {"points", "covariances", "quality", "status", "ok", "message", "found", "doubtful", "uncertainty"}
    if set(item) - {"tag"} != keys or not isinstance(item["message"], str):
        return False
    if item["uncertainty"] is not None and not isinstance(item["uncertainty"], int | float):
        return False
    return item["points"] is None or None not in parse_points(item["points"], len(item["points"]))


def _are_proposals(data: Any) -> bool:
    return all(is_proposal(item) for item in data.values())


def _are_tags(data: Any) -> bool:
    return all(isinstance(tag, str) for tag in data.values())
