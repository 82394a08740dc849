"""The studio's files in a project folder, including templates."""

from __future__ import annotations

import json
import shutil
from copy import deepcopy
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from fuzz.mutate import Random, one_of, spoilt, spoilt_json
from fuzz.target import Target
from liaam.errors import LiaamError

POINTS = [[1.0, 2.0], [30.5, 2.25], [15.0, 20.0]]
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
_FILES = {
    "template.json": [TEMPLATE],
    "proposals.json": [{"p1.png": _PROPOSAL, "p2.png": _PROPOSAL}],
    "unchecked.json": [{"p1.png": "1-2"}],
    "invisible.json": [{"p1.pts": {"revision": "ab", "points": [0, 2]}}],
    "change.json": [
        {"template": TEMPLATE, "files": [{"file": "p1.ljson", "before": None, "text": "{}", "invisible": [1]}]},
    ],
    "model.json": [{"source": "studio", "trained": None, "pictures": {"p1.png": "ab"}, "order": "cd"}],
    "log.jsonl": [
        {"time": "2026-01-01T00:00:00+00:00", "who": "Ann", "picture": "p1.png", "did": did, "revision": "ab"}
        for did in ("placed", "checked", "left out", "discarded", "deleted")
    ],
    "versions.jsonl": [{"time": "2026-01-01", "pictures": 3, "order": "", "errors": {"p1.png": 0.01}}],
    "id": ["0123456789abcdef"],
}
_WORDS = (b"[", b"]", b"{", b"}", b'"', b",", b":", b"null", b"NaN", b"1e999", b'"p1.png"', b'"points"')


def make_state(rng: Random) -> tuple[str, bytes]:
    """Make the name and the corrupted content of one of the studio's files."""
    name = one_of(rng, list(_FILES))
    if rng.random() < 0.3:
        return name, spoilt(rng, [json.dumps(document).encode() for document in _FILES[name]], _WORDS)
    data = spoilt_json(rng, _FILES[name])
    return name, json.dumps(_FILES[name][0]).encode() + b"\n" + data + b"\n" if name.endswith(".jsonl") else data


def check_state(given: tuple[str, bytes]) -> None:
    """Open the project and show all of it. A damaged file must be reported and skipped."""
    from liaam.studio.model_store import ModelStore, Versions, load_studio_model
    from liaam.studio.project import Project
    from liaam.studio.review import ACTIONS

    name, data = given
    root = Path("project")
    _fresh(root)
    (root / ".liaam-studio" / name).write_bytes(data)
    project = Project(root)
    load_studio_model(project, ModelStore())
    overview = project.overview()
    answers: list[Any] = [overview.pictures, project.template_json(), project.problems, project.id]
    answers += [project.marks(picture["name"]) for picture in overview.pictures]
    answers += [project.history("p1.png"), Versions(project.state).as_json(project.order)]
    json.dumps(answers, allow_nan=False).encode()  # as sent to the page
    if project.template is not None and len(project.template) == 3:
        project.save_marks("p1.png", {"points": POINTS, "invisible": [], "revision": None})
        answers += [project.review({"pictures": ["p1.png", "p2.png"], "did": did}) for did in ACTIONS]
        json.dumps(answers, allow_nan=False).encode()
    if project.problems:
        raise LiaamError(project.problems[0])


def _fresh(root: Path) -> None:
    """Make a new project with two small images."""
    shutil.rmtree(root, ignore_errors=True)
    (root / ".liaam-studio").mkdir(parents=True)
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
    Target("studio-state", make_state, check_state, lambda: check_state(("id", b'"0123456789abcdef"')), share=0.2),
    Target(
        "studio-template",
        partial(lambda documents, rng: spoilt_json(rng, documents), [TEMPLATE]),
        check_template,
        lambda: check_template(json.dumps(TEMPLATE).encode()),
        ".json",
    ),
)
