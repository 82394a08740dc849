"""Learning in the background: one process trains on the pictures that are done, and proposes landmarks for the rest.

A quick model comes first, which fits a few pictures, so that a person can go on within seconds; then the same model
with what leaving pictures out tells (how far fits can be trusted), which fits all. The quick one has a file of its own
and serves only where there is no careful one: who stops a training keeps the model of before. The process tells its
parent over a pipe what it does; to stop it is to end it, at any time, since all that it writes is written whole or not
at all.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from liaam.errors import ImageError, LiaamError, TrainingError
from liaam.io.landmarks import Contour, Landmarks
from liaam.studio.pictures import file_tag
from liaam.studio.project import Annotated, Project
from liaam.studio.proposals import is_proposal
from liaam.studio.safety import Refusal

if TYPE_CHECKING:
    from liaam.fitting import FitResult, Fitter
    from liaam.model import AAM

LEAST = 3
"""Pictures to learn from at least."""

MODEL_FILE, FACTS_FILE = "model.liaam", "model.json"
QUICK_FILE, QUICK_FACTS_FILE = "quick.liaam", "quick.json"

OPTIONS: dict[str, Any] = {"prior": "smooth"}
"""How models are trained: ``smooth`` shapes serve best where few pictures have been annotated."""


# The model in use ---------------------------------------------------------------------------------


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


# What the process is told, and tells --------------------------------------------------------------


@dataclass(frozen=True)
class Job:
    """What the training process is to do."""

    done: list[Annotated]
    """Pictures to learn from."""
    waiting: list[tuple[str, Path]]
    """Pictures to propose landmarks for: name and file."""
    contours: tuple[Contour, ...]
    model: Path
    """Where the model is written."""
    quick: Path
    """Where the quick model is written."""
    order: str
    """:attr:`Project.order` of the points."""
    name: str
    """What the model is called."""
    at_once: int
    """Pictures that the quick model fits."""


@dataclass(frozen=True)
class Training:
    """What the training does, for people."""

    state: str = "idle"
    """``idle``, ``running``, ``failed`` or ``done``."""
    phase: str | None = None
    """``training`` or ``proposals``."""
    done: int = 0
    total: int = 0
    what: str = ""
    error: str | None = None


class Trainer:
    """Trains in one process of its own, one at a time.

    Parameters
    ----------
    project : Project
    models : ModelStore
        Where a model is published as soon as it is trained.
    publish : callable
        Told (kind, data) of everything that happens, as :meth:`liaam.studio.events.Events.publish`.
    """

    def __init__(self, project: Project, models: ModelStore, publish: Callable[[str, Any], None]) -> None:
        self.project = project
        self.models = models
        self._publish = publish
        self._lock = threading.RLock()
        self._waiting = threading.Lock()
        """Held while a process is waited for: to the second of two that wait, one that has ended seems alive."""
        self._state = Training()
        self._process: Any = None
        self._listener: threading.Thread | None = None
        self._run = 0
        self._order = ""

    @property
    def state(self) -> Training:
        """What it does now."""
        return self._state

    def start(self) -> Training:
        """Train on the pictures that are done.

        Raises
        ------
        Refusal
            409 while it runs, 422 with too few pictures.
        """
        with self._lock:
            if self._state.state == "running":
                raise Refusal(
                    409, "a training is under way: wait for it, or stop it first", training=asdict(self._state)
                )
            job = self._job()
            self._run += 1
            self._order = job.order
            self._process, pipe = _launch(job)
            self._set(Training("running", "training", 0, 0, "starting"))
            arguments = (self._run, job, pipe, self._process)
            self._listener = threading.Thread(target=self._listen, args=arguments, name="studio-training", daemon=True)
            self._listener.start()
            return self._state

    def stop(self) -> Training:
        """Stop what is under way; what it has found until now is kept."""
        with self._lock:
            if self._state.state == "running":
                self._run += 1  # what is still in the pipe is not listened to
                self._set(Training("idle"))
            process, self._process = self._process, None
        if process is not None:
            self._end(process)
        return self._state

    def stop_unless(self, order: str) -> None:
        """Stop what is under way if it is for points of another order."""
        with self._lock:
            stale = self._state.state == "running" and self._order != order
        if stale:
            self.stop()

    def wait(self, timeout: float | None = None) -> Training:
        """Wait until nothing is under way; gives how it ended."""
        listener = self._listener
        if listener is not None:
            listener.join(timeout)
        return self._state

    def _job(self) -> Job:
        order = self.project.order  # before the points: of those that are changed meanwhile nothing is kept
        done, template = self.project.annotated(), self.project.template
        if len(done) < LEAST or template is None:
            raise Refusal(
                422, f"{len(done)} pictures have all their points; {LEAST} are needed to learn from, 5 are better"
            )
        if len(template) < 3:
            raise Refusal(422, f"the template has {len(template)} points; 3 or more make a shape: add some")
        return Job(
            done,
            self.project.to_propose(self.project.settings.proposals_per_training),
            template.contours,
            self.project.state.path(MODEL_FILE),
            self.project.state.path(QUICK_FILE),
            order,
            self.project.root.name,
            self.project.settings.proposals_at_once,
        )

    # Listening --------------------------------------------------------------------------------

    def _listen(self, run: int, job: Job, pipe: Any, process: Any) -> None:
        """Follow a process until it ends."""
        end: Training | None = None
        try:
            with pipe:
                while end is None:
                    try:
                        message = pipe.recv()
                    except (EOFError, OSError):
                        break
                    with self._lock:
                        if run != self._run:
                            return
                        end = self._heed(job, message)
        except LiaamError as fault:  # the folder has gone, the disk is full
            end = Training("failed", error=self.project.plain(fault))
        with self._waiting:
            process.join()
        with self._lock:
            if run == self._run:
                died = Training("failed", error="the training ended unexpectedly: start it again; it may lack memory")
                self._process = None
                self._set(end or died)
        self._publish("project", {})

    def _heed(self, job: Job, message: tuple[str, Any]) -> Training | None:
        """Act on what the process tells; gives how it ended, if it has."""
        kind, data = message
        if kind == "progress":
            self._set(Training("running", **data))
        elif kind == "model":
            self._use(job, **data)
        elif kind == "proposals":
            self.project.add_proposals({name: item for name, item in data.items() if is_proposal(item)}, job.order)
            self._publish("project", {})
        elif kind == "failed":
            return Training("failed", error=self.project.plain(data))
        elif kind == "done":
            return Training("done", what=data)
        return None

    def _use(self, job: Job, left_out: Mapping[str, str], careful: bool) -> None:
        """Publish a model; a quick one only where there is nothing better."""
        from liaam.model import load_model

        current = self.models.current
        if job.order != self.project.order or not (careful or current is None or not current.is_careful):
            return
        facts = {
            "source": "studio",
            "trained": datetime.now(UTC).isoformat(timespec="seconds"),
            "pictures": {item.name: item.revision for item in job.done},
            "left_out": {name: self.project.plain(reason) for name, reason in left_out.items()},
            "careful": careful,
            "order": job.order,
        }
        self.project.state.write(FACTS_FILE if careful else QUICK_FACTS_FILE, facts)
        self.models.publish(load_model(job.model if careful else job.quick), facts)
        if careful:
            self.project.state.remove(QUICK_FILE, QUICK_FACTS_FILE)
        self._publish("project", {})

    def _end(self, process: Any) -> None:
        """End a process, politely first."""
        process.terminate()
        with self._waiting:
            process.join(2.0)
            if process.is_alive():
                process.kill()
                process.join()

    def _set(self, state: Training) -> None:
        self._state = state
        self._publish("training", asdict(state))


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


# The process --------------------------------------------------------------------------------------


def _launch(job: Job) -> tuple[Any, Any]:
    """Start the process; gives it, and the end of the pipe to listen at."""
    # A fresh interpreter, on every system: a fork copies the locks of the server's threads in whatever state they are.
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe(duplex=False)
    process = context.Process(target=_work, args=(job, there), name="liaam-studio-training", daemon=True)
    process.start()
    there.close()
    return process, here


def _work(job: Job, pipe: Any) -> None:
    """Do a job, in a process of its own."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a Ctrl-C is for the server, which ends this
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=lambda: (parent.join(), os._exit(1)), daemon=True).start()
    with suppress(AttributeError, OSError):
        os.nice(5)  # what a person waits for comes first
    with suppress(BrokenPipeError, ConnectionError):
        try:
            pipe.send(("done", _Worker(job, pipe.send).run()))
        except (LiaamError, MemoryError) as fault:
            pipe.send(("failed", str(fault) or "there is not enough memory: train on smaller pictures"))


class _Picture:
    """A picture to learn from, as :func:`liaam.training.train` takes it; remembers what was wrong with it."""

    def __init__(self, item: Annotated, contours: tuple[Contour, ...]) -> None:
        self.name = item.name
        self.landmarks = Landmarks(item.points, contours)
        self.path = item.path
        self.fault: str | None = None
        self.grey: bool | None = None

    def read_image(self) -> np.ndarray:
        from liaam.io import read_image
        from liaam.photometry import is_grey

        try:
            image = read_image(self.path)
        except ImageError as fault:
            self.fault = str(fault)
            raise
        self.grey = is_grey(image)
        return image


@dataclass
class _Worker:
    """Does a job, and tells about it."""

    job: Job
    tell: Callable[[tuple[str, Any]], None]
    left_out: dict[str, str] = field(default_factory=dict)

    def run(self) -> str:
        """Train, propose, train with care, propose; gives a sentence about it."""
        waiting, soon = self.job.waiting, self.job.waiting[: self.job.at_once]
        model = self._train(leave_out=False)
        if soon:
            self._propose(model, soon)
        model = self._train(leave_out=True)
        if waiting:
            self._propose(model, waiting)
        without = f", without {', '.join(self.left_out)}" if self.left_out else ""
        return f"trained on {model.n_images} pictures{without}"

    def _progress(self, phase: str) -> Callable[[int, int, str], None]:
        def progress(done: int, total: int, what: str) -> None:
            self.tell(("progress", {"phase": phase, "done": done, "total": total, "what": what}))

        return progress

    def _train(self, leave_out: bool) -> AAM:
        """Train on the pictures that serve; those that turn out not to are left out, and it begins anew."""
        from liaam.training import train

        items = [_Picture(item, self.job.contours) for item in self.job.done if item.name not in self.left_out]
        while True:
            try:
                model = train(
                    items, leave_out=leave_out, name=self.job.name, progress=self._progress("training"), **OPTIONS
                )
                break
            except (ImageError, TrainingError):
                unfit = _unfit(items)
                if not unfit or len(items) - len(unfit) < LEAST:
                    raise
                self.left_out |= unfit
                items = [item for item in items if item.name not in unfit]
        model.save(self.job.model if leave_out else self.job.quick)
        self.tell(("model", {"left_out": self.left_out, "careful": leave_out}))
        return model

    def _propose(self, model: AAM, pictures: list[tuple[str, Path]]) -> None:
        """Find the object in pictures, and tell of each as it comes, or of several where they come fast."""
        from time import monotonic

        from liaam.fitting import Fitter

        fitter, progress = Fitter(model), self._progress("proposals")
        batch: dict[str, Any] = {}
        told = monotonic()
        for i, (name, path) in enumerate(pictures):
            progress(i, len(pictures), name)
            batch[name] = propose(fitter, path)
            if monotonic() - told > 1.0:
                self.tell(("proposals", batch))
                batch, told = {}, monotonic()
        self.tell(("proposals", batch))
        progress(len(pictures), len(pictures), "")


def _unfit(items: list[_Picture]) -> dict[str, str]:
    """Pictures that cannot be read, or are grey among coloured ones (or the other way round), with the reason."""
    broken = {item.name: item.fault for item in items if item.fault is not None}
    if broken:
        return broken
    grey = [item for item in items if item.grey]
    colour = [item for item in items if item.grey is False]
    fewer, kind = (grey, "grey") if len(grey) <= len(colour) else (colour, "in colour")
    return {item.name: f"the picture is {kind}, unlike most" for item in fewer}


def propose(fitter: Fitter, path: Path) -> dict[str, Any]:
    """Find the object in a picture; gives JSON, without points where that makes no sense."""
    nothing = {**_NOTHING, "status": "not fitted"}
    try:
        tag = file_tag(path)  # before it is read: of what replaces it meanwhile this is no proposal
        return {**proposal_of(fitter.fit(path)), "tag": tag}
    except LiaamError as fault:
        return {**nothing, "message": str(fault).replace(f"{path.parent}{os.sep}", "")}
    except MemoryError:
        return {**nothing, "message": f"{path.name} is too large for the memory: make it smaller"}


_NOTHING: dict[str, Any] = {
    "points": None,
    "covariances": None,
    "quality": None,
    "ok": False,
    "found": False,
    "doubtful": True,
    "uncertainty": None,
}


def proposal_of(result: FitResult) -> dict[str, Any]:
    """Give a fit as a proposal. One that failed keeps its points: to correct is less work than to begin."""
    from liaam.shape import diagonal_of

    facts = {"status": str(result.status), "message": result.message}
    if not np.isfinite(result.shape).all():
        return {**_NOTHING, **facts}
    covariances, size = result.landmark_covariances, diagonal_of(result.shape)
    certain = bool(np.isfinite(covariances).all()) and size > 0
    found = result.found is None or not result.found.doubtful
    return {
        **facts,
        "points": [[round(x, 3), round(y, 3)] for x, y in result.shape.tolist()],
        "covariances": np.round(covariances, 4).tolist() if certain else None,
        "quality": None if np.isnan(result.quality) else round(float(result.quality), 4),
        "ok": result.status.ok,
        "found": found,
        "doubtful": not found or not result.status.ok,
        "uncertainty": round(float(result.deviations.mean()) / size, 5) if certain else None,
    }
