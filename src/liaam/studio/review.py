"""Who changed what: an append-only log of the folder and the review states that follow from it.

A picture is checked while its landmarks have the revision that was checked, so every change withdraws the check. The
other states hold until the opposite entry.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from datetime import UTC, datetime, timedelta
from typing import Any

from liaam.studio.safety import Refusal
from liaam.studio.store import Store

OPPOSITE = {
    "checked": "unchecked",
    "left out": "taken in",
    "discarded": "restored",
    "deleted": "undeleted",
}
"""Actions on pictures, and the actions that undo them."""

ACTIONS = (*OPPOSITE, *OPPOSITE.values(), "accepted")

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
        entries = self._entries.get(name)
        last = entries[-1] if entries else None
        age = SAME_WORK if last is None else datetime.now(UTC) - datetime.fromisoformat(last["time"])
        if last is None or (last["who"], last["did"]) != (who, did) or age >= SAME_WORK:
            self.add(did, who, {name: revision})

    def history(self, name: str) -> list[dict[str, Any]]:
        """Return the last entries of a picture, newest first."""
        return self._entries.get(name, [])[: -SHOWN - 1 : -1]

    def checked_by(self, name: str, revision: str | None) -> str | None:
        """Return who checked a revision of the landmarks; None without landmarks."""
        last = self._standing(name, "checked")
        return _who(last) if last is not None and revision is not None and last["revision"] == revision else None

    def left_out_by(self, name: str) -> str | None:
        """Return who left a picture out of training."""
        last = self._standing(name, "left out")
        return None if last is None else _who(last)

    def discarded(self, name: str) -> str | None:
        """Return the revision of the proposal that was discarded."""
        last = self._standing(name, "discarded")
        return None if last is None else last["revision"]

    def deleted(self, name: str) -> str | None:
        """Return the revision of the landmarks that were deleted and can be restored."""
        last = self._standing(name, "deleted")
        return None if last is None else last["revision"]

    def _standing(self, name: str, did: str) -> dict[str, Any] | None:
        """Return the last entry of an action, unless its opposite came later."""
        both = (did, OPPOSITE[did])
        last = next((entry for entry in reversed(self._entries.get(name, ())) if entry["did"] in both), None)
        return last if last is not None and last["did"] == did else None


def parse_who(name: Any) -> str:
    """Check the name of the person who works in the page; "" if it is not known."""
    if name is None:
        return ""
    if not isinstance(name, str) or len(name) > LONGEST_NAME or not name.isprintable():
        raise Refusal(422, f"your name is not valid: enter at most {LONGEST_NAME} printable characters")
    return name.strip()


def _who(entry: Mapping[str, Any]) -> str:
    return entry["who"] or "someone"
