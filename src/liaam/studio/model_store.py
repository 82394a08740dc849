"""The current model: its metadata, its files in the project's folder, and when it becomes invalid."""

import tempfile
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Any, Literal

import numpy as np

from liaam.errors import LiaamError, ModelFileError
from liaam.fitting.methods import methods_of
from liaam.model import AAM, load_model
from liaam.studio import contract
from liaam.studio.project import Project
from liaam.studio.refusal import Refusal
from liaam.studio.store import Store

MODEL_FILE = "model.liaam"  # file of the trained model; the facts about it are in the store
SHOWN_VERSIONS = 30  # number of versions that the page shows

Place = Literal["guest", "own", "spare"]
"""Places of :class:`ModelStore`."""


@dataclass(frozen=True, eq=False)
class ModelInUse:
    """A model and its metadata."""

    model: AAM
    number: int  # incremented with every published model
    facts: dict[str, Any]
    """``source`` ("studio", "file" or "guest"), ``trained`` (ISO 8601 or None) and ``pictures`` (revision by name). A
    model of the studio also has ``order`` (:attr:`liaam.studio.template.Templates.order`), ``left_out`` (the reasons
    why ``pictures`` were left out, by name) and ``sides`` (those that were stated, by name), a guest its ``name``."""

    @property
    def key(self) -> str:
        """Identifier of the model that survives a restart."""
        return self.facts["trained"] or f"{self.facts['source']} {self.model.name}"


class ModelStore:
    """Holds up to three models: the first of ``guest``, ``own`` and ``spare`` that there is, is used; thread-safe.

    A guest was dropped on the page; nothing is trained or saved with it. The folder has its ``own``, and the spare one
    comes with liaam.
    """

    def __init__(self) -> None:
        self.guest: ModelInUse | None = None
        self.own: ModelInUse | None = None
        self.spare: ModelInUse | None = None
        self._numbers = count(1)
        self.listeners: list[Callable[[ModelInUse | None], object]] = []
        """Called in the publishing thread after the current model may have changed."""

    @property
    def current(self) -> ModelInUse | None:
        """The model in use, if there is one."""
        return self.guest or self.own or self.spare

    def publish(
        self, model: AAM | None, facts: Mapping[str, Any] | None = None, place: Place = "own"
    ) -> ModelInUse | None:
        """Set a model by its place; None removes it."""
        published = None if model is None else ModelInUse(model, next(self._numbers), dict(facts or {}))
        setattr(self, place, published)
        for listener in self.listeners:
            listener(self.current)
        return published


class Versions:
    """The trained models of a folder.

    Each has errors by name of a held-out picture: of another model, trained without these pictures. Fits that failed,
    and say so, have errors of any size; they are counted apart.
    """

    def __init__(self, store: Store) -> None:
        self._store = store
        self._all: list[dict[str, Any]] = store.lines("version")

    def add(self, facts: Mapping[str, Any], errors: Mapping[str, float], failed: Sequence[str] = ()) -> None:
        """Append a trained model, with the errors of its fits by picture, and the pictures whose fits failed."""
        n_used = len(facts["pictures"]) - len(facts["left_out"])
        version = {
            "time": facts["trained"],
            "pictures": n_used,
            "order": facts["order"],
            "errors": dict(errors),
            "failed": [*failed],
        }
        self._store.append("version", [version])
        self._all.append(version)

    def held_out(self, order: str) -> list[str]:
        """Return the held-out pictures of the newest model with an order of its points (see ``Templates``)."""
        for version in reversed(self._all):
            if version["order"] == order:
                return list(version["errors"])
        return []

    def as_json(self, order: str) -> list[contract.Version]:
        """Return the newest versions with errors, and with an order of the points, as JSON.

        ``same`` is whether the held-out pictures are those of the newest, so that errors can be compared.
        """
        versions = [version for version in self._all if version["order"] == order and version["errors"]]
        return [
            {
                "time": version["time"],
                "pictures": version["pictures"],
                "error": _usual_error(version),
                "held_out": len(version["errors"]),
                "failed": [*version.get("failed", ())],
                "same": set(version["errors"]) == set(versions[-1]["errors"]),
            }
            for version in versions[-SHOWN_VERSIONS:]
        ]


def _usual_error(version: Mapping[str, Any]) -> float:
    """Return the median error of the fits of a version that have not failed; if all have, of these."""
    failed = version.get("failed", ())  # earlier versions of the studio did not note them
    errors = [error for name, error in version["errors"].items() if name not in failed]
    return float(np.median(errors or list(version["errors"].values())))


def is_set_aside(store: Store) -> bool:
    """Return whether a person went back to the model that comes with liaam from that of the folder."""
    return bool((store.get("model", MODEL_FILE) or {}).get("set_aside"))


def set_aside(project: Project, models: ModelStore, aside: bool) -> None:
    """Use the model of the folder no longer, or again; a training of another one ends that."""
    facts = project.store.get("model", MODEL_FILE) or {}
    project.store.put("model", {MODEL_FILE: facts | {"set_aside": aside}})
    models.publish(None)
    load_studio_model(project, models)


def load_studio_model(project: Project, models: ModelStore) -> None:
    """Publish the model that the studio trained here before, if there is one; errors are noted in the state."""
    if is_set_aside(project.store):
        return
    project.store.note(MODEL_FILE, None)
    try:
        path = project.store.path(MODEL_FILE)
        order = project.templates.order
        facts = {"source": "studio", "trained": None, "pictures": {}, "order": order}
        facts |= project.store.get("model", MODEL_FILE) or {}
        if path.exists() and facts["order"] == order:
            models.publish(load_model(path), facts)
    except (LiaamError, OSError) as fault:
        project.store.note(MODEL_FILE, f"{fault}; the model is ignored: train again")


def load_dropped_model(data: bytes, name: str, points: int) -> AAM:
    """Read a model that was dropped on the page, with at most so many points."""
    with tempfile.TemporaryDirectory() as folder:  # safetensors reads the metadata of files only
        path = Path(folder) / "dropped.liaam"
        path.write_bytes(data)
        try:
            model = load_model(path)
        except ModelFileError as fault:
            raise Refusal(422, str(fault).replace(str(path), name)) from fault
    if model.n_points > points:
        raise Refusal(422, f"{name} has {model.n_points} points, more than the {points} that the studio handles")
    return model


def model_json(
    current: ModelInUse | None,
    done: Mapping[str, str],
    unread: Collection[str] = (),
    sides: Mapping[str, str] | None = None,
) -> contract.Model | None:
    """Return the current model as JSON for the page.

    ``done`` are the revisions of the landmarks of pictures for training, by name; ``unread`` names of pictures whose
    files have not been read, so that it is not known whether they are done; ``sides`` those that are stated, by name.
    """
    if current is None:
        return None
    model = current.model
    facts = current.facts
    trained_on = facts["pictures"]
    left_out = facts.get("left_out", {})
    # Pictures that were left out by the user since, or have no landmarks now.
    lost = trained_on.keys() - left_out.keys() - done.keys() - set(unread)
    unchanged = {name for name, revision in done.items() if trained_on.get(name) == revision}
    return {
        "number": current.number,
        "name": facts.get("name", model.name),
        "n_images": model.n_all_images,
        "n_points": model.n_points,
        "names": list(model.landmark_names),
        "trained": facts["trained"],
        "stale": len(done) - len(unchanged) + len(lost),
        "colour": model.is_colour,
        "methods": [*methods_of(model)],
        "triangles": model.triangles.tolist(),
        "theta_deg": float(np.rad2deg(model.theta)),
        "contours": [{"indices": [*indices], "closed": closed} for indices, closed in model.contours],
        "source": facts["source"],
        # Without pictures that have changed since: the next training may use them.
        "left_out": {name: why for name, why in left_out.items() if name in unchanged},
        "mean": model.shape_model.mean.tolist(),
        "sides": _sides_json(model),
        "sides_changed": _has_other_sides(facts, done, sides or {}),
    }


def _has_other_sides(facts: Mapping[str, Any], done: Mapping[str, str], sides: Mapping[str, str]) -> bool:
    """Return whether the side of a training picture was stated or withdrawn since; it may tell those of all."""
    before = facts.get("sides")
    if before is None:  # a model that did not note them
        return False
    return any(sides.get(name, "") != before.get(name, "") for name in facts["pictures"].keys() & done.keys())


def _sides_json(model: AAM) -> contract.Sides | None:
    sides = model.sides
    if sides is None:
        return None
    return {"own": sides.own, "other": sides.other, "n_own": sides.n_own, "n_other": sides.n_other}
