"""The studio's files in a project folder, including templates."""

from __future__ import annotations

import json
import shutil
import tempfile
from copy import deepcopy
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from fuzz.mutate import Random, spoilt, spoilt_json
from fuzz.target import Target
from liaam.errors import LiaamError
from liaam.studio.folder import STATE, Folder
from liaam.studio.store import DATABASE, Store

POINTS = [[1.0, 2.0], [30.5, 2.25], [15.0, 20.0]]
BAR = {"ends": [[1.0, 2.0], [21.0, 2.0]], "length": 5.0, "unit": "mm"}
TEMPLATE = {
    "names": ["a", "b", "c"],
    "contours": [{"indices": [0, 1, 2], "closed": True}],
    "mirror": [1, 0, 2],
    "points": POINTS,
    "revision": "ab",
    "order": "cd",
}
_PROPOSAL = {
    "points": POINTS,
    "covariances": [[[1, 0], [0, 1]]] * 3,
    "quality": 0.9,
    "status": "converged",
    "ok": True,
    "message": "The fit converged.",
    "found": True,
    "doubtful": False,
    "uncertainty": 0.01,
    "tag": None,
}
_KEPT = {
    "template": {"": TEMPLATE},
    "proposal": {"p1.png": _PROPOSAL, "p2.png": _PROPOSAL},
    "unchecked": {"p1.png": "1-2"},
    "invisible": {"p1.pts ab": [0, 2]},
    "change": {
        "": {
            "template": TEMPLATE,
            "files": [{"file": "p2.ljson", "before": None, "text": "{}", "invisible": [1]}],
            "moved": True,
        }
    },
    "model": {"model.liaam": {"source": "studio", "trained": None, "pictures": {"p1.png": "ab"}, "order": "cd"}},
    "id": {"": "0123456789abcdef"},
}
_LINES = {
    "review": [
        {"time": "2026-01-01T00:00:00+00:00", "who": "Ann", "picture": "p1.png", "did": did, "revision": "ab"}
        for did in ("placed", "checked", "left out", "discarded", "deleted")
    ],
    "version": [{"time": "2026-01-01", "pictures": 3, "order": "", "errors": {"p1.png": 0.01}}],
}


@cache
def _database() -> bytes:
    """Return a database of the studio."""
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder).resolve()
        _fresh(root)
        store = Store(Folder(root))
        for kind, values in _KEPT.items():
            store.put(kind, values)
        for kind, lines in _LINES.items():
            store.append(kind, lines)
        store.close()
        return (root / STATE / DATABASE).read_bytes()


def make_state(rng: Random) -> bytes:
    """Corrupt the studio's database."""
    return spoilt(rng, [_database()], (b"{", b"null", b"p1.png", b"proposal", b"\0"))


def check_state(data: bytes) -> None:
    """Open the project and show all of it. Damage must be reported and skipped."""
    from liaam.studio.model_store import ModelStore, Versions, load_studio_model
    from liaam.studio.project import Project
    from liaam.studio.review import ACTIONS

    root = Path("project")
    _fresh(root)
    (root / STATE / DATABASE).write_bytes(data)
    project = Project(root)
    load_studio_model(project, ModelStore())
    overview = project.overview()
    assert overview is not None
    answers: list[Any] = [overview.pictures, project.templates.as_json(), project.problems, project.store.id]
    answers += [project.marks(picture["name"]) for picture in overview.pictures]
    answers += [project.history("p1.png"), Versions(project.store).as_json(project.templates.order)]
    json.dumps(answers, allow_nan=False).encode()  # as sent to the page
    if project.templates.current is not None and len(project.templates.current) == 3:
        project.save_marks("p1.png", {"points": POINTS, "invisible": [], "revision": None})
        asked = {"pictures": ["p1.png", "p2.png"], "bar": BAR, "of": "p1.png"}
        answers += [project.review({**asked, "did": did}) for did in ACTIONS]
        json.dumps(answers, allow_nan=False).encode()
    project.store.close()
    if project.problems:
        raise LiaamError(project.problems[0])


def _fresh(root: Path) -> None:
    """Make a new project with two small images."""
    shutil.rmtree(root, ignore_errors=True)
    (root / STATE).mkdir(parents=True)
    for name in ("p1.png", "p2.png"):
        (root / name).write_bytes(_png())


@cache
def _png() -> bytes:
    import cv2

    return cv2.imencode(".png", np.full((24, 32, 3), 90, np.uint8))[1].tobytes()


def check_template(data: bytes) -> None:
    """Read an uploaded template, and convert it to JSON."""
    from liaam.studio.template import parse_template

    try:
        content = json.loads(data)
    except (ValueError, RecursionError) as fault:
        raise LiaamError("no JSON") from fault
    template = parse_template(content, 1000)
    assert parse_template(deepcopy(template.as_json()), 1000) == template
    json.dumps(template.as_json(), allow_nan=False).encode()


TARGETS = (
    Target("studio-state", make_state, check_state, lambda: check_state(_database()), share=0.2),
    Target(
        "studio-template",
        partial(lambda documents, rng: spoilt_json(rng, documents), [TEMPLATE]),
        check_template,
        lambda: check_template(json.dumps(TEMPLATE).encode()),
        ".json",
    ),
)
