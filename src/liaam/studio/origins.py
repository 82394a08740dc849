"""Where each point of a picture comes from, as the studio stores it with the picture's landmarks.

A person has placed a point, moved it, or confirmed it where it was; or has accepted it together with others; or it is
still as the model, or the mean shape, proposed it. Only the first three are a person's own: accuracy and agreement
count no others, since points that were accepted unseen would confirm the model that placed them.

An origin belongs to a position: a point that another program has moved since counts as placed, and so does every point
of a file from elsewhere. So origins stay right when points are renamed, reordered or deleted.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from liaam.io.files import real_path
from liaam.studio.contract import Origin
from liaam.studio.folder import STATE, Folder, sets_in
from liaam.studio.refusal import Refusal
from liaam.studio.store import Store, StoredTable

ORIGINS: tuple[Origin, ...] = ("placed", "moved", "confirmed", "accepted", "proposed")
OWN: tuple[Origin, ...] = ("placed", "moved", "confirmed")
"""Origins of points that a person has placed, moved or confirmed one by one."""

Points = Sequence[Sequence[float] | None]  # [x, y] each, or None without a position


class Origins:
    """The origins of all points that were not placed, by picture. ``entry`` changes with them."""

    def __init__(self, store: Store) -> None:
        self.table = StoredTable(store, "origin")

    def __contains__(self, name: str) -> bool:
        return name in self.table

    def entry(self, name: str) -> Mapping[str, Any] | None:
        """Return what is stored for a picture: positions by their origin."""
        return self.table.get(name)

    def of(self, name: str, points: Points) -> list[Origin | None]:
        """Return the origin of each point of a picture; None without a position."""
        known: dict[tuple[float, ...], Origin] = {}
        stored = self.table.get(name) or {}
        for origin in ORIGINS:
            for position in stored.get(origin, ()):
                known[tuple(position)] = origin
        return [None if point is None else known.get(tuple(point), "placed") for point in points]

    def save(self, name: str, points: Points, origins: Sequence[Origin | None]) -> None:
        """Store the origins of the points of a picture, before its landmark file is written."""
        entry: dict[str, list[list[float]]] = {}
        for point, origin in zip(points, origins, strict=True):
            if point is not None and origin not in (None, "placed"):
                entry.setdefault(str(origin), []).append(list(point))
        if entry or name in self.table:
            self.table.save({name: entry or None})


SAME = 0.01
"""Distance in pixels up to which a point in a file is the one that the studio stored."""


def without_proposals(points: np.ndarray, proposals: np.ndarray | None) -> tuple[np.ndarray, int]:
    """Return points (n, 2) without those that were proposed (k, 2), which become NaN, and how many these are."""
    if proposals is None:
        return points, 0
    distances = np.linalg.norm(points[:, None] - proposals, axis=2)
    proposed = (distances <= SAME).any(axis=1)
    return np.where(proposed[:, None], np.nan, points), int(proposed.sum())


def saved_proposals(folder: Path) -> dict[str, np.ndarray]:
    """Return the points that the studio saved for a folder as proposed, or accepted together, by picture, (k, 2).

    The folder may be the subfolder of a further set of landmarks.
    """
    store = _store_of(real_path(folder))
    entries = store.all("origin")
    store.close()
    found = {}
    for picture, entry in entries.items():
        positions = [position for origin in ORIGINS if origin not in OWN for position in entry.get(origin, ())]
        if positions:
            found[picture] = np.array(positions, np.float64).reshape(-1, 2)
    return found


def _store_of(folder: Path) -> Store:
    above = Folder(folder.parent)
    is_set = not (folder / STATE).exists() and folder.name in sets_in(above)
    return Store(above, folder.name) if is_set else Store(Folder(folder))


def own_points(origins: Sequence[Origin | None]) -> np.ndarray:
    """Return which points are a person's own, (n,) bool."""
    return np.array([origin in OWN for origin in origins], bool)


def parse_origins(data: Any, points: Points) -> list[Origin | None]:
    """Check the origins in a request, one for each point or null."""
    if not isinstance(data, list) or len(data) != len(points):
        raise Refusal(422, f"the origins are not valid: send one of {', '.join(ORIGINS)} or null for each point")
    for origin in data:
        if origin is not None and origin not in [*ORIGINS]:  # it may have no hash
            raise Refusal(422, f"an origin is not known: send one of {', '.join(ORIGINS)} or null for each point")
    return [None if point is None else (origin or "placed") for point, origin in zip(points, data, strict=True)]


def origins_after(points: Points, before: Points, origins: Sequence[Origin | None]) -> list[Origin | None]:
    """Return the origins of points of a request that says none: those that have changed were placed."""
    after: list[Origin | None] = []
    if len(points) != len(before):  # a file of another template
        before = origins = [None] * len(points)
    for point, point_before, origin in zip(points, before, origins, strict=True):
        if point is None:
            after.append(None)
        elif point_before is not None and list(point) == list(point_before):
            after.append(origin)
        else:
            after.append("placed")
    return after
