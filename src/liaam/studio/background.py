"""Work in the background: fit new pictures as soon as there is a model, and look for slips in the landmarks.

In a folder without points of its own, the face model that comes with liaam is tried on a few pictures. If it finds
faces in them, the folder gets its points and its proposals, until a person defines other points or trains a model.
"""

import os
import threading
import time
from collections.abc import Mapping, Sequence
from contextlib import closing, suppress
from functools import cached_property, lru_cache, partial
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from liaam.datasets.label_faults import LEAST_PICTURES, find_label_faults
from liaam.datasets.sides import reflected_shapes, sides_of_shapes
from liaam.errors import LiaamError
from liaam.fitting import FitResult, Fitter
from liaam.io import Contour, Landmarks
from liaam.model import AAM, load_model
from liaam.model.shape import diagonal_of
from liaam.models import FACE
from liaam.studio import contract
from liaam.studio.fits import WARM_UP, example, found_nothing
from liaam.studio.layers import fit_file
from liaam.studio.model_store import ModelInUse, ModelStore
from liaam.studio.pictures import file_tag
from liaam.studio.project import Annotated, Project
from liaam.studio.sides import completed
from liaam.studio.template import Template, template_of
from liaam.studio.training import Publish, Trainer
from liaam.workers import in_order

LOOK_SECONDS = 3.0  # how often the folder is looked at for files that other programs add
QUIET_SECONDS = 0.2  # files that are added together arrive in shorter intervals
STOP_SECONDS = 60.0  # how long the end of the thread is waited for, which takes seconds on a busy machine
TRIED = 4  # number of pictures in which faces are looked for before the points of the face model are offered

THREADS = min(4, os.cpu_count() or 1)

BATCH_SECONDS = 0.5
"""Proposals are shown after so long, and after as long again for each thousand pictures, which the page fetches."""

FACE_FACTS = {"source": FACE, "trained": None, "pictures": {}}


class Background:
    """Fits pictures with each new model, and checks landmarks, in a thread."""

    def __init__(self, project: Project, models: ModelStore, trainer: Trainer, publish: Publish) -> None:
        self.project = project
        self.models = models
        self.trainer = trainer
        self.progress: contract.Counted | None = None  # of the pictures that are being fitted
        self.looking = False  # for faces, before the points of the face model are offered
        self._publish = publish
        self.woken = threading.Event()  # set to have the folder looked at now
        self._stopped = threading.Event()
        self._fitter_of = lru_cache(maxsize=1)(Fitter)
        self._without_faces: set[tuple[str, str]] = set()
        self._checked: dict[str, str] | None = None  # revisions of the landmarks that were checked, by picture
        self.checks = 0
        self._next_check = 0.0
        self._seen: object = None
        self._thread = threading.Thread(target=self._run, name="studio-background", daemon=True)
        models.listeners.append(lambda _: self.woken.set())

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def stop(self) -> None:
        """End the thread, after what it does at the moment."""
        self._stopped.set()
        self.woken.set()
        if self._thread.ident is not None:  # compiled code that runs when the interpreter ends aborts the process
            self._thread.join(STOP_SECONDS)

    def _run(self) -> None:
        with suppress(LiaamError):  # thousands of files take a while; errors are reported when the page asks
            self.project.read_files(self._stopped)
            self._publish("project", {})
        with suppress(OSError, AttributeError):  # a person who fits a picture comes first
            os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), 5)
        with suppress(LiaamError):  # the first photographs do not wait until the face model is ready
            if self.models.own is None and self._may_use_face():
                self._lend()
                self._fitter_of(self._face).fit(example(self._face, WARM_UP))
        while not self._stopped.is_set():
            with suppress(LiaamError, OSError):  # such as a folder that is gone for a while; the page says so
                trained = self.models.own
                now = (self.project.stamp, self.trainer.state.state, trained and trained.number)
                if now != self._seen:
                    self.fit_new()
                    self._seen = now if self.check_landmarks() else None
            is_woken = self.woken.wait(LOOK_SECONDS)
            until = time.monotonic() + LOOK_SECONDS
            while is_woken and not self._stopped.is_set():  # until no more files arrive, but not for ever
                self.woken.clear()
                is_woken = self.woken.wait(QUIET_SECONDS) and time.monotonic() < until
            self.woken.clear()

    def fit_new(self) -> None:
        """Propose landmarks for all pictures without any that the model has not been fitted to."""
        if self._is_paused():
            return
        waiting = self.project.unfitted() if self.models.own is None else []
        self._lend()
        model = self._find_model(waiting)
        if model is not None and (waiting := self.project.unfitted(model.key)):
            self._propose(model, waiting)

    @property
    def may_return(self) -> bool:
        """Whether the face model can be used instead of one that was trained here."""
        own = self.models.own
        return own is not None and own.facts["source"] == "studio" and self.models.spare is not None

    def decline(self) -> None:
        """Do without the points of the face model in this folder."""
        self.project.store.put("declined", {"": True})
        self.project.templates.offer(None)
        self._lend()
        self._publish("project", {})

    @cached_property
    def _face(self) -> AAM:
        return load_model(FACE)

    def _may_use_face(self) -> bool:
        project = self.project
        may_lend = project.settings.face and not project.templates.is_own
        return may_lend and project.store.get("declined") is None

    def _lend(self) -> None:
        """Let pictures be fitted with the face model, unless the folder has points or pictures without faces."""
        wanted = self._may_use_face() and not self._without_faces
        models = self.models
        if wanted == (models.spare is not None):
            return
        models.publish(self._face if wanted else None, FACE_FACTS, "spare")
        if not wanted and self.project.templates.is_own:
            self.project.templates.offer(None)
        self._publish("project", {})

    def _is_paused(self) -> bool:
        return self._stopped.is_set() or (self.trainer.state.state == "running" and not self.trainer.is_measuring)

    def _find_model(self, waiting: list[tuple[str, Path]]) -> ModelInUse | None:
        """Return the model of the folder, or else the face model if it finds faces."""
        trained = self.models.own
        templates = self.project.templates
        if trained is not None:
            if templates.current is None:
                templates.offer(template_of_model(trained.model))
            return trained
        if not waiting or not self._may_use_face():
            return None
        has_faces = templates.current is not None
        fresh = []
        if not has_faces:  # it finds a face in half of the first few pictures that it has not been tried on
            tagged = [(name, file_tag(path), path) for name, path in waiting]
            fresh = [each for each in tagged if each[:2] not in self._without_faces][:TRIED]
            if fresh:
                self.looking = True
                self._publish("project", {})
            trial = partial(propose, self._fitter_of(self._face))
            try:
                proposals = list(in_order(trial, [path for *_, path in fresh], THREADS))
            finally:
                self.looking = False
            has_faces = bool(fresh) and 2 * sum(not proposal["doubtful"] for proposal in proposals) >= len(fresh)
            self._without_faces.update(each[:2] for each in fresh)
        if has_faces:
            self._without_faces.clear()
        self._lend()
        if has_faces:
            templates.offer(template_of_model(self._face), FACE)
        elif fresh:
            self._publish("project", {})
        return self.models.spare

    def _propose(self, model: ModelInUse, waiting: list[tuple[str, Path]]) -> None:
        order = self.project.templates.order
        fitter = self._fitter_of(model.model)
        total = len(waiting)
        batch: dict[str, Any] = {}
        seconds = BATCH_SECONDS * (1 + total / 1000)
        saved = time.monotonic()
        with closing(in_order(partial(propose, fitter), [path for _, path in waiting], THREADS)) as proposals:
            try:
                for done, ((name, _), proposal) in enumerate(zip(waiting, proposals, strict=True), 1):
                    batch[name] = {**proposal, "model": model.key}
                    if done == total or time.monotonic() - saved > seconds:
                        self.project.add_proposals(batch, order)
                        batch = {}
                        saved = time.monotonic()
                        self._show(done, total)
                    if self._is_paused() or model not in (self.models.own, self.models.spare):
                        return
            finally:
                self._show(0, 0)

    def _show(self, done: int, total: int) -> None:
        self.progress = {"done": done, "total": total} if total else None
        self._publish("fitting", self.progress)
        self._publish("project", {})

    def check_landmarks(self) -> bool:
        """Look for slips in changed landmarks, for a tenth of the time at most; return False if that has to wait."""
        began = time.monotonic()
        if began < self._next_check:
            return False
        done = self.project.annotated()
        revisions = {item.name: item.revision for item in done}
        if revisions == self._checked:
            return True
        template = self.project.templates.current
        names = () if template is None else template.names
        self.project.set_slips(slips_in([item for item in done if item.placed.all()], names))
        self._checked = revisions
        self.checks += 1
        self._next_check = time.monotonic() + 9 * (time.monotonic() - began)
        self._publish("project", {})
        return True

    def has_checked(self, done: Mapping[str, str]) -> bool:
        """Whether these landmarks, revisions by picture, have been checked, or nothing is checked at all."""
        return self._thread.ident is None or self._checked == done


def slips_in(whole: Sequence[Annotated], names_of_points: Sequence[str] = ()) -> dict[str, tuple[str, str, list[int]]]:
    """Return the revision, the slip and its points of pictures that have all points, by name of those with a slip.

    Objects of the other side are compared reflected: what training reflects is no slip.
    """
    if len(whole) < LEAST_PICTURES:
        return {}
    shapes = np.array([item.points for item in whole])
    names = [str(PurePosixPath(item.name).with_suffix("")) for item in whole]
    sides = completed([item.side for item in whole], names, shapes)
    with suppress(LiaamError):  # many shapes contradict their sides; training will say so
        shapes = reflected_shapes(shapes, sides_of_shapes(shapes, sides, names).is_other)
    slips: dict[str, tuple[str, str, list[int]]] = {}
    for fault in find_label_faults([*shapes]):
        item = whole[fault.picture]
        described = fault.describe(names_of_points)
        slips.setdefault(item.name, (item.revision, described, [int(index) for index in fault.points]))
    return slips


def template_of_model(model: AAM) -> Template:
    """Return the points of a model as a template."""
    mean = model.shape_model.mean.reshape(-1, 2)
    return template_of(Landmarks(mean, Contour.all_of(model.contours), model.landmark_names))


def propose(fitter: Fitter, path: Path) -> dict[str, Any]:
    """Find the object in a picture; return the proposal as JSON, without points if there is no fit."""
    try:
        tag = file_tag(path)  # before reading: the proposal is not valid for a file that replaces it meanwhile
        return {**proposal_of(fit_file(fitter, path)), "tag": tag}
    except LiaamError as fault:
        message = str(fault).replace(f"{path.parent}{os.sep}", "")
    except MemoryError:
        message = f"{path.name} does not fit into memory: make it smaller"
    return {**_NOTHING, "status": "not fitted", "message": message}


_NOTHING: dict[str, Any] = dict.fromkeys(("points", "covariances", "quality", "uncertainty"))
_NOTHING |= {"ok": False, "found": False, "doubtful": True}


def proposal_of(result: FitResult) -> dict[str, Any]:
    """Return a fit as a proposal. A failed fit keeps its points: correcting them is less work than placing them."""
    facts = {"status": str(result.status), "message": result.message}
    if not np.isfinite(result.landmarks).all():
        return {**_NOTHING, **facts}
    covariances = result.landmark_covariances
    size = diagonal_of(result.landmarks)
    has_covariances = bool(np.isfinite(covariances).all()) and size > 0
    is_certain = not result.detection_doubtful
    return {
        **facts,
        "points": [[round(x, 3), round(y, 3)] for x, y in result.landmarks.tolist()],
        "covariances": np.round(covariances, 4).tolist() if has_covariances else None,
        "quality": None if np.isnan(result.quality) else round(float(result.quality), 4),
        "ok": result.status.ok,
        "found": is_certain,
        "nothing_found": found_nothing(result),
        "doubtful": not is_certain or not result.status.ok,
        "uncertainty": round(float(result.sd.mean()) / size, 5) if has_covariances else None,
        "absent": np.flatnonzero(result.absent).tolist() if result.status.ok else [],
    }
