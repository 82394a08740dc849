"""Landmarks proposed by the model, for a person to check, and pictures left at the mean shape."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from liaam.errors import LiaamError
from liaam.model.shape import diagonal_of
from liaam.studio.folder import File, Listing, revision_of
from liaam.studio.pictures import file_tag
from liaam.studio.store import Store, Table

if TYPE_CHECKING:
    from liaam.fitting import FitResult, Fitter


class Proposals:
    """Proposals for the pictures of a folder, and which of them were left at the mean shape, by name of the picture.

    Pictures left at the mean shape have no landmark file, so no training uses them.
    """

    def __init__(self, listing: Listing, store: Store) -> None:
        self._listing = listing
        self._kept = Table(store, "proposal")
        self._unchecked = Table(store, "unchecked")
        self.forget = self._kept.forget
        """Drop all proposals, because the template changed."""

    def add(self, proposals: Mapping[str, dict[str, Any]]) -> None:
        """Save proposals; the default ``tag`` is that of the current file."""
        files = self._listing.files
        self._kept.save(
            {name: {"tag": files[name].tag if name in files else None, **item} for name, item in proposals.items()}
        )

    def of(self, picture: File) -> dict[str, Any] | None:
        """Return the proposal for a picture, unless the picture has been replaced since."""
        proposal = self._kept.get(picture.name)
        return proposal if proposal is not None and proposal.get("tag") == picture.tag else None

    def is_by(self, model: str, picture: File) -> bool:
        """Whether a picture has a proposal, or a failed fit, of a model."""
        proposal = self.of(picture)
        return proposal is not None and proposal.get("model", "") == model

    def is_unchecked(self, picture: File) -> bool:
        """Whether a picture was left at the mean shape, unless it has been replaced since."""
        return self._unchecked.get(picture.name) == picture.tag

    def mark_unchecked(self, picture: File, unchecked: bool) -> None:
        """Mark a picture as left at the mean shape, or remove the mark."""
        if self.is_unchecked(picture) != unchecked:
            self._unchecked.save({picture.name: picture.tag if unchecked else None})


def revision_of_proposal(proposal: Mapping[str, Any]) -> str:
    """Return a hash of a proposal."""
    return revision_of(json.dumps(proposal, sort_keys=True).encode())


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


def propose(fitter: Fitter, path: Path) -> dict[str, Any]:
    """Find the object in a picture; return the proposal as JSON, without points if there is no fit."""
    try:
        tag = file_tag(path)  # before reading: the proposal is not valid for a file that replaces it meanwhile
        return {**proposal_of(fitter.fit(path)), "tag": tag}
    except LiaamError as fault:
        message = str(fault).replace(f"{path.parent}{os.sep}", "")
    except MemoryError:
        message = f"{path.name} does not fit into memory: make it smaller"
    return {**_NOTHING, "status": "not fitted", "message": message}


_NOTHING: dict[str, Any] = {
    "points": None,
    "covariances": None,
    "quality": None,
    "ok": False,
    "found": False,
    "doubtful": True,
    "uncertainty": None,
}


def proposal_of(result: FitResult) -> dict[str, Any]:
    """Return a fit as a proposal. A failed fit keeps its points: correcting them is less work than placing them."""
    facts = {"status": str(result.status), "message": result.message}
    if not np.isfinite(result.landmarks).all():
        return {**_NOTHING, **facts}
    covariances, size = result.landmark_covariances, diagonal_of(result.landmarks)
    has_covariances = bool(np.isfinite(covariances).all()) and size > 0
    found = not result.detection_doubtful
    return {
        **facts,
        "points": [[round(x, 3), round(y, 3)] for x, y in result.landmarks.tolist()],
        "covariances": np.round(covariances, 4).tolist() if has_covariances else None,
        "quality": None if np.isnan(result.quality) else round(float(result.quality), 4),
        "ok": result.status.ok,
        "found": found,
        "doubtful": not found or not result.status.ok,
        "uncertainty": round(float(result.deviations.mean()) / size, 5) if has_covariances else None,
    }
