"""Changes of the template and of all landmark files with it, as one transaction that survives a killed process.

The whole change is stored before the first landmark file is rewritten. Until all files are written,
landmarks can be neither read nor saved, and every call tries to finish the change first.
"""

from __future__ import annotations

import secrets
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from liaam.errors import LiaamError
from liaam.studio.folder import status_of
from liaam.studio.landmark_files import LandmarkFiles, Marks, text_of
from liaam.studio.listing import File, Listing
from liaam.studio.proposals import Proposals
from liaam.studio.safety import Refusal
from liaam.studio.store import Store
from liaam.studio.template import Template, landmarks_of, parse_indices
from liaam.studio.template_store import TemplateStore


@dataclass(eq=False)
class TemplateChanges:
    """Applies changes of the template and finishes interrupted ones."""

    listing: Listing
    store: Store
    landmarks: LandmarkFiles
    proposals: Proposals
    templates: TemplateStore
    is_pending: bool = True
    """Whether a change may be stored, as before the store has been read."""

    def save(self, template: Template, data: dict[str, Any]) -> bool:
        """Save a template; return whether points were added, removed or reordered.

        Parameters
        ----------
        data : dict
            The request, with ``mapping`` and ``revision`` if known.
        """
        self.finish()
        self.listing.scan()
        templates = self.templates
        # The user's points may replace those that a model offers, unless these were accepted.
        is_offer = templates.is_offered
        old = None if is_offer and data.get("revision") is None else templates.current
        marks = [(file, marks) for file in self.listing.pictures if (marks := self.landmarks.of(file)).file]
        identity = None if old is None else list(range(len(old)))
        revision = templates.revision if old is not None else None
        is_there, is_current = template == templates.saved, data.get("revision") == revision
        if "revision" in data and not is_current:
            if is_there:  # sent again, since the first answer may have been lost
                return False
            templates.check(data["revision"], "the template")
        mapping = _mapping(data.get("mapping"), len(template), old, bool(marks))
        if is_there and (mapping == identity or not is_current):
            return False
        moved = is_offer or (old is not None and mapping != identity)
        change = self._change(template, old, mapping, marks, moved)
        self.is_pending = True
        self.store.put("change", {"": change})  # from here on the change will be finished, even after a crash
        self.finish()
        return moved

    def finish(self) -> None:
        """Finish a pending change."""
        if not self.is_pending:
            return
        try:
            self._apply()
        except (LiaamError, OSError) as fault:
            cause = fault if isinstance(fault, OSError) else fault.__cause__
            sentence = (
                f"a change of the template cannot be finished yet ({self.store.folder.plain(fault)}): fix this, and "
                "the studio will finish it"
            )
            self.store.note("change", sentence)
            status = fault.status if isinstance(fault, Refusal) else status_of(cause)
            raise Refusal(status, sentence) from fault

    def try_to_finish(self) -> None:
        """Finish a pending change if possible."""
        with suppress(Refusal):  # the error has been noted
            self.finish()

    def _change(
        self,
        template: Template,
        old: Template | None,
        mapping: Sequence[int | None],
        marks: list[tuple[File, Marks]],
        moved: bool,
    ) -> dict[str, Any]:
        """Return a change in full. Applying it twice has no further effect."""
        files = []
        for file, known in marks:
            target = self.landmarks.target(file)
            name = self.store.folder.name_of(target)
            stays = not moved and (known.file != name or target.suffix.lower() == ".pts")
            if stays or old is None or known.landmarks is None or len(known.landmarks) != len(old):
                continue
            points, scale = known.points, self.landmarks.scale_of(file)
            hidden = [i for i, source in enumerate(mapping) if source in known.landmarks.invisible]
            landmarks = landmarks_of(template, [None if i is None else points[i] for i in mapping], hidden, scale)
            before = known.revision if known.file == name else None
            text = text_of(landmarks, target.suffix)
            files.append({"file": name, "before": before, "text": text, "invisible": hidden})
        order = secrets.token_hex(8) if moved else self.templates.order
        stored = {**template.as_json(), "revision": secrets.token_hex(8), "order": order}
        return {"template": stored, "files": files, "moved": moved}

    def _apply(self) -> None:
        """Apply a stored change and remove it. Files that were changed in the meantime are left alone."""
        change = self.store.get("change")
        if change is None:
            self.is_pending = False
            return
        for item in change["files"]:
            self.landmarks.rewrite(item["file"], item["text"], item["before"], item["invisible"])
        with self.store.transaction():
            if change["moved"]:
                self.proposals.forget()
            self.templates.store(change["template"])
            self.store.put("change", {"": None})
        self.store.note("change", None)
        self.is_pending = False
        self.landmarks.forget()
        self.listing.scan()


def _mapping(data: Any, n: int, old: Template | None, has_marks: bool) -> list[int | None]:
    """Return the old index of each point, None for a new one."""
    if old is None:
        return [None] * n
    if data is None:
        if has_marks and len(old) != n:
            raise Refusal(
                422,
                f"the template had {len(old)} points and now has {n}, but pictures have landmarks: "
                "send a mapping with the old index of each point",
            )
        return [i if i < len(old) else None for i in range(n)]
    if not isinstance(data, list) or len(data) != n:
        raise Refusal(422, f"the mapping is not valid: send the old index of each of the {n} points, or null if new")
    parse_indices([index for index in data if index is not None], len(old), "mapping")
    return data
