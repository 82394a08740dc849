"""Removing and renaming pictures of the folder, each of which can be undone.

A removed picture and its landmark files lie in the studio's own folder until it is restored. The store says beforehand
what is moved, so that a killed studio loses nothing. A renamed picture takes its landmarks and its history along, in
all sets of landmarks. What is kept of a removed one has another name meanwhile, so that it does not count for a later
picture of the same name.
"""

import secrets
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path, PurePosixPath
from typing import Any

from liaam.io.files import some_names
from liaam.studio import contract
from liaam.studio.folder import disk_errors, is_relative, plain_name
from liaam.studio.project import Project
from liaam.studio.refusal import Refusal

REMOVED = "removed"
"""Kind of what was removed in the store, and the subfolder where it lies."""


def remove(project: Project, data: Any) -> contract.Removed:
    """Remove the ``pictures`` in a request from the folder, with their landmark files."""
    names = project.checked(contract.RemovePictures, data, "pictures, a list of names").pictures
    project.folder.check_writable()
    if not isinstance(names, list) or not names or not all(isinstance(name, str) for name in names):
        raise Refusal(422, "send an object with pictures, a list of names")
    names = [*dict.fromkeys(names)]
    token = secrets.token_hex(8)
    with project.changing():
        files = [file for name in names for file in project.files_of(name)]
        project.store.put(REMOVED, {token: {"pictures": names, "files": files}})
        for file in files:
            _move(project.root / file, _place(project, token, file))
        for name in names:
            project.rekey(name, _kept_name(token, name), {})
    return {"token": token, "pictures": names}


def restore(project: Project, data: Any) -> contract.Removed:
    """Bring back what was removed under the ``token`` in a request."""
    token = project.checked(contract.RestorePictures, data, "token").token
    project.folder.check_writable()
    kept = project.store.get(REMOVED, token) if isinstance(token, str) else None
    if kept is None:
        raise Refusal(404, "these pictures are not kept, or are back already: reload the page")
    with project.changing():
        waiting = [file for file in kept["files"] if _place(project, token, file).exists()]
        taken = [file for file in waiting if (project.root / file).exists()]
        if taken:
            raise Refusal(409, f"the folder has other files of these names: {some_names(taken, 3)}; rename them first")
        for file in waiting:
            _move(_place(project, token, file), project.root / file)
        for name in kept["pictures"]:
            project.rekey(_kept_name(token, name), name, {})
        project.store.put(REMOVED, {token: None})
        _tidy(_place(project, token, "x").parent)
    return {"token": token, "pictures": kept["pictures"]}


def rename(project: Project, data: Any) -> contract.Renamed:
    """Give the ``picture`` in a request the name ``to``, in its subfolder and with its suffix."""
    asked = project.checked(contract.RenamePicture, data, "picture and to, its new name")
    project.folder.check_writable()
    name = asked.picture
    wanted = asked.to
    if not isinstance(name, str) or not isinstance(wanted, str):
        raise Refusal(422, "send an object with picture and to, its new name")
    with project.changing():
        files = project.files_of(name)
        new = _new_name(name, wanted)
        if new == name:
            return {"before": name, "name": name}
        moves = {file: _moved(file, name, new) for file in files}
        taken = [to for to in moves.values() if (project.root / to).exists() and not _is_same(project, to, moves)]
        stem = new.removesuffix(PurePosixPath(new).suffix)
        if taken or project.has_stem(stem, but=name):
            other = taken[0] if taken else stem
            raise Refusal(409, f"the folder has {other} already: choose another name")
        project.take_own(name)  # landmarks in a file of all pictures stay there, under the old name
        moves = {file: _moved(file, name, new) for file in project.files_of(name)}
        for file, to in moves.items():
            _move(project.root / file, project.root / to)
        project.rekey(name, new, moves)
    return {"before": name, "name": new}


def _new_name(name: str, wanted: str) -> str:
    """Return the new name of a picture, from what a person has typed."""
    path = PurePosixPath(name)
    typed = plain_name(wanted.strip())
    given = typed[: -len(path.suffix)] if typed.lower().endswith(path.suffix.lower()) else typed
    new = f"{given.strip()}{path.suffix}"
    if not wanted.strip() or not given.strip() or "/" in wanted or "\\" in wanted or not is_relative(new):
        raise Refusal(422, f"'{wanted[:60]}' is no name for a picture: use letters and digits, no / and no dot first")
    return new if path.parent == PurePosixPath() else f"{path.parent}/{new}"


def _moved(file: str, name: str, new: str) -> str:
    """Return the new name of a picture's file, or of a landmark file of it, perhaps in the subfolder of a set."""
    stem = name.removesuffix(PurePosixPath(name).suffix)
    new_stem = new.removesuffix(PurePosixPath(new).suffix)
    place = file[: -len(stem + PurePosixPath(file).suffix)]
    return f"{place}{new_stem}{PurePosixPath(file).suffix}"


def _is_same(project: Project, to: str, moves: dict[str, str]) -> bool:
    """Return whether a file that is there is the one to be renamed, where names ignore upper and lower case."""
    source = next(file for file, target in moves.items() if target == to)
    return (project.root / to).samefile(project.root / source)


def _place(project: Project, token: str, file: str) -> Path:
    return project.store.path(f"{REMOVED}/{token}/{file}")


def _kept_name(token: str, name: str) -> str:
    """Return the name under which what is known of a removed picture is kept; no picture has it."""
    return f"{REMOVED}/{token}/{name}"


def _move(source: Path, target: Path) -> None:
    with disk_errors(f"{source.name} cannot be moved"):
        target.parent.mkdir(parents=True, exist_ok=True)
        source.replace(target)


def _tidy(folder: Path) -> None:
    """Remove the empty subfolders of a folder, and the folder."""
    inner: Sequence[Path] = sorted(folder.rglob("*"), reverse=True)
    with suppress(OSError):
        for each in (*inner, folder):
            each.rmdir()
