"""The model in use: what is known of it, where the studio keeps its own, and when it does not fit any more."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from liaam.errors import LiaamError
from liaam.studio.project import Project

if TYPE_CHECKING:
    from liaam.model import AAM
    from liaam.studio.training import Trainer

MODEL_FILE, FACTS_FILE = "model.liaam", "model.json"
QUICK_FILE, QUICK_FACTS_FILE = "quick.liaam", "quick.json"


@dataclass(frozen=True, eq=False)
class ModelInUse:
    """A model, and what is known of it."""

    model: AAM
    number: int
    """Counts up: another number is another model."""
    facts: dict[str, Any]
    """``source`` ("studio" or "file"), ``trained`` (ISO 8601 or None), ``pictures`` (revision by name); of the studio's
    own also ``careful`` (whether it knows how far it can be trusted) and ``order`` (:attr:`Project.order`)."""

    @property
    def is_careful(self) -> bool:
        """Whether it may not be replaced by a quick one."""
        return bool(self.facts.get("careful", True))


class ModelStore:
    """The model that fits are made with; may be used from any thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._current: ModelInUse | None = None
        self._number = 0
        self.listeners: list[Callable[[ModelInUse | None], object]] = []
        """Called in the thread that publishes, after another model has come into use."""

    @property
    def current(self) -> ModelInUse | None:
        """The model, if there is one."""
        return self._current

    def publish(self, model: AAM, facts: Mapping[str, Any]) -> ModelInUse:
        """Use a model from now on."""
        with self._lock:
            self._number += 1
            self._current = current = ModelInUse(model, self._number, dict(facts))
        for listener in self.listeners:
            listener(current)
        return current

    def withdraw(self) -> None:
        """Use no model any more."""
        with self._lock:
            self._current = None
        for listener in self.listeners:
            listener(None)


# Where it comes from -------------------------------------------------------------------------------


def load_studio_model(project: Project, models: ModelStore) -> None:
    """Publish the model that the studio trained here before, if there is one; what is wrong with it is noted."""
    for file, facts_file, careful in ((MODEL_FILE, FACTS_FILE, True), (QUICK_FILE, QUICK_FACTS_FILE, False)):
        if models.current is None:
            _load_model(project, models, file, facts_file, careful)


def _load_model(project: Project, models: ModelStore, file: str, facts_file: str, careful: bool) -> None:
    from liaam.model import load_model

    project.state.note(file, None)
    try:
        path = project.state.path(file)
        if not path.exists():
            return
        facts = project.state.read(facts_file, _are_facts) or {"source": "studio", "trained": None, "pictures": {}}
        facts = {"order": project.order, **facts, "careful": careful}
        if facts["order"] == project.order:
            models.publish(load_model(path), facts)
    except (LiaamError, OSError) as fault:
        project.state.note(file, f"{fault}; it is passed over: train again")


def forget_studio_model(project: Project, models: ModelStore) -> None:
    """Withdraw the studio's model and remove its files: it is of another template. One that a person named stays."""
    current = models.current
    if current is not None and current.facts["source"] == "studio":
        models.withdraw()
    project.state.remove(MODEL_FILE, FACTS_FILE, QUICK_FILE, QUICK_FACTS_FILE)


def follow_template(project: Project, models: ModelStore, trainer: Trainer) -> None:
    """Stop a training, and withdraw a model, of points that the template has in another order by now."""
    trainer.stop_unless(project.order)
    current = models.current
    if current is not None and current.facts["source"] == "studio" and current.facts.get("order", "") != project.order:
        forget_studio_model(project, models)


def load_given_model(path: Path, models: ModelStore) -> None:
    """Publish a model of a file that a person named.

    Raises
    ------
    ModelFileError
        If it cannot be read.
    """
    from liaam.model import load_model

    models.publish(load_model(path), {"source": "file", "trained": None, "pictures": {}})


def model_json(current: ModelInUse | None, done: Mapping[str, str]) -> dict[str, Any] | None:
    """What the page is told of the model in use, while there are pictures that are done (revisions by name)."""
    if current is None:
        return None
    model, facts = current.model, current.facts
    known = facts["pictures"] if current.is_careful else {}
    stale = sum(known.get(name) != revision for name, revision in done.items())
    return {
        "n_images": model.n_images,
        "n_points": model.n_points,
        "trained": facts["trained"],
        "stale": stale,
        "careful": current.is_careful,
        "colour": model.is_colour,
        "triangles": model.triangles.tolist(),
        "theta_deg": float(np.rad2deg(model.theta)),
        "contours": [{"indices": list(indices), "closed": closed} for indices, closed in model.contours],
        "source": facts["source"],
        "left_out": facts.get("left_out", {}),
        "mean": model.shape_model.mean.tolist(),
    }


def _are_facts(data: Any) -> bool:
    sound = data["source"] == "studio" and isinstance(data["pictures"], dict) and "trained" in data
    return sound and isinstance(data.get("order", ""), str)
