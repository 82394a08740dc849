"""Training in the background, in a separate process.

The model is used as soon as it is trained. Then another one is trained without a few held-out pictures, on which its
error is measured. A stopped training keeps the earlier model. The process reports over a pipe. It can be killed at any
time, since all its writes are atomic. :mod:`liaam.studio.background` fits pictures with the model.
"""

import hashlib
import logging
import os
import threading
import warnings
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import partial
from pathlib import Path, PurePosixPath
from types import SimpleNamespace
from typing import Any, Literal

import numpy as np

from liaam.error_measures import point_error
from liaam.errors import ImageError, LiaamError, TrainingError
from liaam.fitting import Fitter
from liaam.io import image_size
from liaam.io.landmarks import Contour, Landmarks
from liaam.model import AAM, load_model
from liaam.model.mesh import folded_share
from liaam.model.shape import align, diagonal_of
from liaam.photometry.encoding import refuse_unscaled
from liaam.studio import contract
from liaam.studio.layers import fit_file
from liaam.studio.model_store import MODEL_FILE, ModelStore, Versions
from liaam.studio.pictures import read_for_work, work_size
from liaam.studio.project import Annotated, Project
from liaam.studio.refusal import Refusal
from liaam.studio.sides import completed
from liaam.tracking.motion import rescaled
from liaam.workers import fresh_interpreters, obey_parent

LEAST = 3  # minimum number of pictures for training
LEAST_OWN = 0.5
"""Least fraction of a held-out picture's points that a person has placed, moved or confirmed. Only these are measured;
if they were fewer, those would be measured that a model had placed badly, and hardly any others."""

HELD_OUT = "held out"
"""Kind of the newest fits to held-out pictures in the store."""

Publish = Callable[[str, Any], None]  # sends an event of a kind to the pages


@dataclass(frozen=True)
class TrainingJob:
    """Input of the training process: pictures, the template of their landmarks, and the file and name of the model."""

    done: list[Annotated]
    contours: tuple[Contour, ...]
    names: tuple[str, ...]
    order: str  # :attr:`liaam.studio.template.Templates.order` of the points
    model: Path
    name: str
    held_out: tuple[str, ...] = ()  # pictures on which a model that is trained without them is measured
    slips: dict[str, str] = field(default_factory=dict)  # pictures left out for landmarks that may be wrong, and why


@dataclass(frozen=True)
class Training:
    """State of the training, for the page."""

    state: Literal["idle", "running", "done", "failed"] = "idle"
    done: int = 0
    total: int = 0
    what: str = ""
    error: str | None = None

    def as_json(self) -> contract.Training:
        """Return it as JSON for the page."""
        return {
            "state": self.state,
            "done": self.done,
            "total": self.total,
            "what": self.what,
            "error": self.error,
        }


class Trainer:
    """Trains in a separate process, one training at a time, and publishes the model as soon as it is trained."""

    def __init__(self, project: Project, models: ModelStore, publish: Publish) -> None:
        self.project = project
        self.models = models
        self._publish = publish
        self.versions, self._lock = Versions(project.store), threading.RLock()
        self.state = Training()
        self.is_measuring = False  # whether the model of this training is in use already
        self._process: Any = None
        self._listener: threading.Thread | None = None
        self._stopped = False
        self._order = ""

    def start(self, slips: bool = False) -> Training:
        """Train on the done pictures, without those with possible slips unless ``slips``."""
        with self._lock:
            if self.state.state == "running":
                running = self.state.as_json()
                raise Refusal(409, "a training is running: wait for it, or stop it first", training=running)
            job = self._job(slips)
            self._order = job.order
            self._stopped = False
            self.is_measuring = False
            context = fresh_interpreters()
            pipe, there = context.Pipe(duplex=False)
            self._process = context.Process(target=_work, args=(job, there), name="liaam-studio-training", daemon=True)
            self._process.start()
            there.close()
            self._set(Training("running", what="starting"))
            arguments = (job, pipe, self._process)
            self._listener = threading.Thread(target=self._listen, args=arguments, name="studio-training", daemon=True)
            self._listener.start()
            return self.state

    def _job(self, slips: bool) -> TrainingJob:
        """Return what is to be trained, or refuse if there is too little."""
        order = self.project.templates.order  # read first, so that results for points that change are dropped
        done = self.project.annotated()
        template = self.project.templates.current
        wrong = {item.name: f"its points may be wrong: {item.slip}" for item in done if item.slip and not slips}
        used = [item.name for item in done if item.name not in wrong]
        if len(used) < LEAST or template is None:
            text = f"only {len(used)} pictures have all their points"
            raise Refusal(422, f"{text}: complete at least {LEAST}, better 5, to train")
        if len(template) < 3:
            raise Refusal(422, f"the template has {len(template)} points, but a shape needs at least 3: add some")
        truths = [item.name for item in done if item.name in used and item.own[item.placed].mean() >= LEAST_OWN]
        return TrainingJob(
            done=done,
            contours=template.contours,
            names=template.names,
            order=order,
            model=self.project.store.path(MODEL_FILE),
            name=self.project.title,
            held_out=choose_held_out(truths, self.versions.held_out(order), len(used)),
            slips=wrong,
        )

    def stop(self) -> Training:
        """Stop a running training; its results so far are kept."""
        with self._lock:
            self._stopped = True  # messages still in the pipe are ignored
            if self.state.state == "running" and self._process is not None:
                self._process.kill()
        return self.wait()

    def follow_template(self) -> None:
        """Stop the training and set the studio's model aside if they are for an earlier set or order of points."""
        store = self.project.store
        order = self.project.templates.order
        with self._lock:
            is_stale = self.state.state == "running" and self._order != order
        if is_stale:
            self.stop()
        trained = self.models.own
        if trained is not None and trained.facts["source"] == "studio" and trained.facts.get("order", "") != order:
            self.models.publish(None)
            store.set_aside(MODEL_FILE)
            store.put("model", {MODEL_FILE: None})

    def rename(self, name: str, new: str) -> None:
        """Let the studio's model, which was trained on a picture, know it by its new name."""
        trained = self.models.own
        if trained is None or trained.facts["source"] != "studio":
            return
        for names in (trained.facts["pictures"], trained.facts.get("left_out", {}), trained.facts.get("sides", {})):
            if name in names:
                names[new] = names.pop(name)
        self.project.store.put("model", {MODEL_FILE: trained.facts})

    def wait(self, timeout: float | None = None) -> Training:
        """Wait for a running training and return its final state."""
        if self._listener is not None:
            self._listener.join(timeout)
        return self.state

    def _listen(self, job: TrainingJob, pipe: Any, process: Any) -> None:
        end = Training("failed", error="the training ended unexpectedly, perhaps for lack of memory: start it again")
        try:
            with pipe, suppress(EOFError, OSError):
                while end.state == "failed" and not self._stopped:
                    message = pipe.recv()
                    with self._lock:
                        end = end if self._stopped else self._handle(job, message) or end
        except LiaamError as fault:  # such as a missing folder or a full disk
            end = Training("failed", error=self.project.folder.plain(fault))
        except Exception as fault:  # a bug: without an end, the training would run for ever
            logging.getLogger(__name__).exception("the training failed")
            text = f"the training failed ({type(fault).__name__}): see the studio's terminal for details"
            end = Training("failed", error=text)
        process.kill()
        process.join()
        with self._lock:
            self._set(Training() if self._stopped else end)
        self._publish("project", {})

    def _handle(self, job: TrainingJob, message: tuple[str, Any]) -> Training | None:
        """Handle a message of the process; return the final state if it has ended."""
        kind, data = message
        if kind == "progress":
            self._set(Training("running", **data))
        elif kind == "model" and job.order == self.project.templates.order:
            facts = {
                "source": "studio",
                "trained": datetime.now(UTC).isoformat(timespec="milliseconds"),
                "pictures": {item.name: item.revision for item in job.done},
                "left_out": {name: self.project.folder.plain(reason) for name, reason in data.items()},
                "order": job.order,
                "sides": {item.name: item.side for item in job.done if item.side},
            }
            self.project.store.put("model", {MODEL_FILE: facts})
            self.models.publish(load_model(job.model), facts)
            self.is_measuring = True
            self._publish("project", {})
        elif kind == "measured" and self.is_measuring and self.models.own is not None:
            self.versions.add(self.models.own.facts, data["errors"], data["failed"])
            self.project.store.put(HELD_OUT, {"": {"order": job.order, "fits": data["fits"]}})
            self._publish("project", {})
        elif kind == "failed":
            return Training("failed", error=self.project.folder.plain(data))
        elif kind == "done":
            return Training("done", what=data)
        return None

    def _set(self, state: Training) -> None:
        self.state = state
        self._publish("training", state.as_json())


def choose_held_out(names: Sequence[str], before: Sequence[str], n_all: int | None = None) -> tuple[str, ...]:
    """Choose 1, 2, 4 or 8 pictures to measure a model on, at most a quarter of all, where possible those of ``before``.

    The others are in an order that does not depend on the set, so that they stay the same when pictures are added.
    ``n_all`` is the number of pictures that the model is trained on, by default that of those with these names.
    """
    n_all = len(names) if n_all is None else n_all
    count = next((n for n in (8, 4, 2, 1) if 4 * n <= n_all and n <= len(names)), 0)
    order = sorted(names, key=lambda name: (name not in before, hashlib.sha256(name.encode()).digest()))
    return tuple(order[:count])


def folded(model: AAM, used: Sequence[Annotated]) -> dict[str, str]:
    """Return why training has left out pictures that it was given, by name: their points fold the mesh."""
    n_folded = len(used) - model.n_all_images
    if n_folded <= 0:
        return {}
    signs = [[1.0, 1.0]] if model.sides is None else [[1.0, 1.0], [-1.0, 1.0]]  # of two sides, one was reflected
    shares = {
        item.name: min(_folded_share(kind, item.points * sign) for kind in model.parts for sign in signs)
        for item in used
    }
    worst = sorted(shares, key=lambda name: -shares[name])[:n_folded]
    what = "its points fold the mesh ({:.0%} of its area is flipped)"
    remedy = "look for points that are misplaced, exchanged or mirrored"
    return {name: f"{what.format(shares[name])}: {remedy}" for name in worst}


def _folded_share(model: AAM, points: np.ndarray) -> float:
    """Return the fraction of a model's mesh that points (n, 2) flip; some may be NaN."""
    mean = model.shape_model.mean.reshape(-1, 2)
    aligned = align(points, mean)(points)
    lacks = np.isnan(aligned)
    return float(folded_share(np.where(lacks, mean, aligned), model.triangles, np.asarray(~lacks.any(axis=1))))


def _work(job: TrainingJob, pipe: Any) -> None:
    """Train the model, then measure another that is trained without the held-out pictures."""
    obey_parent()  # the server terminates this process
    with suppress(AttributeError, OSError):
        os.nice(5)  # requests of the user have priority
    with suppress(BrokenPipeError, ConnectionError):
        try:
            left_out = dict(job.slips)
            model, warned = _train(job, pipe.send, left_out, lamps="auto")
            model.save(job.model)
            pipe.send(("model", left_out))
            without = f", without {', '.join(left_out)}" if left_out else ""
            sides = "" if model.sides is None else f"; {model.sides.describe()}"
            summary = f"trained on {model.n_all_images} pictures{without}{sides}{warned}"
            with suppress(LiaamError, MemoryError):  # such as too few pictures without those
                rest, _ = _train(job, pipe.send, dict(left_out), job.held_out, "measuring", leave_out=False, lamps=None)
                fitter = Fitter(rest)
                errors = {}  # relative to the diagonal of the points
                failed = []  # those whose fit says so
                fits = {}
                for item in job.done:
                    if item.name in job.held_out:
                        with suppress(LiaamError, MemoryError):
                            result = fit_file(fitter, item.path)
                            landmarks = result.landmarks
                            size = diagonal_of(item.points[item.placed])
                            error = point_error(landmarks[item.own], item.points[item.own]) / size
                            if np.isfinite(error):
                                errors[item.name] = round(error, 5)
                                if result.status.ok:
                                    fits[item.name] = np.round(landmarks, 3).tolist()
                                else:
                                    failed.append(item.name)
                pipe.send(("measured", {"errors": errors, "failed": failed, "fits": fits}))
            pipe.send(("done", summary))
        except (LiaamError, MemoryError) as fault:
            pipe.send(("failed", str(fault) or "the training ran out of memory: train on smaller pictures"))


def _points_at_work(item: Annotated) -> np.ndarray:
    """Return the points of a picture in the pixels at which it is worked on."""
    width, height = image_size(item.path)
    to = work_size(width, height)
    return rescaled(item.points, (height, width), (to[1], to[0]))


def _train(
    job: TrainingJob,
    send: Callable,
    left_out: dict[str, str],
    unused: Sequence[str] = (),
    what: str = "",
    **options: Any,
) -> tuple[AAM, str]:
    """Train a model; also return its warnings. Add pictures that turn out to be unusable to those ``left_out``."""
    from liaam.training import train

    faults: dict[str, str] = {}

    def read(item: Annotated) -> np.ndarray:
        try:
            image = read_for_work(item.path)
            refuse_unscaled(image, item.name, "srgb")
            return image
        except ImageError as fault:
            faults[item.name] = str(fault)
            raise

    def progress(done: int, total: int, doing: str) -> None:
        send(("progress", {"done": done, "total": total, "what": what or doing}))

    while True:
        used = [item for item in job.done if item.name not in {*left_out, *unused}]
        marks = [Landmarks(_points_at_work(item), job.contours, job.names) for item in used]
        names = [str(PurePosixPath(item.name).with_suffix("")) for item in used]
        sides = completed([item.side for item in used], names, np.array([each.points for each in marks]))
        items = [
            SimpleNamespace(name=item.name, landmarks=landmarks, read_image=partial(read, item), side=side)
            for item, landmarks, side in zip(used, marks, sides, strict=True)
        ]
        try:
            with warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always", UserWarning)
                # Smooth shapes work best with few annotated pictures.
                model = train(items, prior="smooth", methods="all", name=job.name, progress=progress, **options)
            left_out |= folded(model, used)
            return model, "".join(f"; {warning.message}" for warning in caught)
        except (ImageError, TrainingError):
            if not faults or len(items) - len(faults) < LEAST:
                raise
            left_out |= faults
            faults.clear()
