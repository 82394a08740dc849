"""Changes of the template and of all landmark files with it, as one transaction that survives a killed process.

The whole change is written to ``change.json`` before the first landmark file is rewritten. Until all files are written,
landmarks can be neither read nor saved, and every call tries to finish the change first.
"""

from __future__ import annotations

import secrets
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from liaam.errors import LiaamError
from liaam.studio.folder import Folder, is_relative, status_of
from liaam.studio.landmark_files import LandmarkFiles, Marks, text_of
from liaam.studio.listing import OWN_SUFFIXES, File, Listing
from liaam.studio.proposals import Proposals
from liaam.studio.safety import Refusal
from liaam.studio.state_files import StateFiles
from liaam.studio.template import Template, landmarks_of, parse_indices
from liaam.studio.template_store import TemplateStore, is_template

CHANGE_FILE = "change.json"


class TemplateChanges:
    """Applies changes of the template and finishes interrupted ones."""

    def __init__(
        self,
        listing: Listing,
        state: StateFiles,
        landmarks: LandmarkFiles,
        proposals: Proposals,
        templates: TemplateStore,
    ) -> None:
        self.is_pending = True  # until change.json has been read
        self._folder: Folder = listing.folder
        self._listing = listing
        self._state = state
        self._landmarks = landmarks
        self._proposals = proposals
        self._templates = templates

    def save(self, template: Template, data: dict[str, Any]) -> bool:
        """Save a template; return whether points were added, removed or reordered.

        Parameters
        ----------
        template : Template
        data : dict
            The request, with ``mapping`` and ``revision`` if known.

        Raises
        ------
        Refusal
            See :meth:`liaam.studio.project.Project.save_template`.
        """
        self.finish()
        self._listing.scan()
        templates = self._templates
        old = templates.current
        marks = [(file, marks) for file in self._listing.pictures if (marks := self._landmarks.of(file)) is not None]
        identity = None if old is None else list(range(len(old)))
        is_there, is_current = template == templates.saved, data.get("revision") == templates.revision
        if "revision" in data and not is_current:
            if is_there:  # sent again, since the first answer may have been lost
                return False
            templates.check(data["revision"], "the template")
        mapping = _mapping(data.get("mapping"), len(template), old, bool(marks))
        if is_there and (mapping == identity or not is_current):
            return False
        moved = old is not None and mapping != identity
        change = self._change(template, old, mapping, marks, moved)
        self.is_pending = True
        self._state.write(CHANGE_FILE, change)  # from here on the change will be finished, even after a crash
        self.finish()
        return moved

    def finish(self) -> None:
        """Finish a pending change.

        Raises
        ------
        Refusal
            503, or 507 if the disk is full: the change cannot be finished yet.
        """
        if not self.is_pending:
            return
        try:
            self._apply()
        except (LiaamError, OSError) as fault:
            cause = fault if isinstance(fault, OSError) else fault.__cause__
            sentence = (
                f"a change of the template cannot be finished yet ({self._folder.plain(fault)}): fix this, and the "
                "studio will finish it"
            )
            self._state.note(CHANGE_FILE, sentence)
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
            target = self._landmarks.target(file)
            name = self._folder.name_of(target)
            stays = not moved and (known.file != name or target.suffix.lower() == ".pts")
            if stays or old is None or known.landmarks is None or len(known.landmarks) != len(old):
                continue
            points = known.points
            hidden = [i for i, source in enumerate(mapping) if source in known.landmarks.invisible]
            landmarks = landmarks_of(template, [None if i is None else points[i] for i in mapping], hidden)
            before = known.revision if known.file == name else None
            text = text_of(landmarks, target)
            files.append({"file": name, "before": before, "text": text, "invisible": hidden})
        order = secrets.token_hex(8) if moved else self._templates.order
        stored = {**template.as_json(), "revision": secrets.token_hex(8), "order": order}
        return {"template": stored, "files": files}

    def _apply(self) -> None:
        """Apply ``change.json`` and remove it. Files that were changed in the meantime are left alone."""
        change = self._state.read(CHANGE_FILE, _is_change)
        if change is None:  # missing, or damaged and noted
            self.is_pending = False
            return
        for item in change["files"]:
            self._landmarks.rewrite(item["file"], item["text"], item["before"], item["invisible"])
        if (change["template"].get("order") or "") != self._templates.order:
            self._proposals.forget()
        self._templates.store(change["template"])
        self._state.remove(CHANGE_FILE)
        self.is_pending = False
        self._landmarks.forget()
        self._listing.scan()


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


def _is_change(data: Any) -> bool:
    return all(_is_item(item) for item in data["files"]) and is_template(data["template"])


def _is_item(item: Any) -> bool:
    """Whether an item describes one landmark file to rewrite."""
    if set(item) != {"file", "before", "text", "invisible"} or not isinstance(item["text"], str):
        return False
    invisible = item["invisible"]
    numbers = isinstance(invisible, list) and all(isinstance(i, int) and i >= 0 for i in invisible)
    return numbers and isinstance(item["before"], str | None) and _is_own(item["file"])


def _is_own(name: str) -> bool:
    """Whether a name is that of a landmark file in the folder, in a format that the studio writes."""
    return is_relative(name) and Path(name).suffix.lower() in OWN_SUFFIXES
