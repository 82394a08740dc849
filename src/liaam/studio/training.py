"""Learning in the background: a process trains and proposes landmarks, and what it tells is heeded here.

A quick model comes first, which fits a few pictures, so that a person can go on within seconds; then the same model
with what leaving pictures out tells (how far fits can be trusted), which fits all. The quick one has a file of its own
and serves only where there is no careful one: who stops a training keeps the model of before. The process
(:mod:`liaam.studio.training_process`) tells its parent over a pipe what it does; to stop it is to end it, at any time,
since all that it writes is written whole or not at all.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from typing import Any

from liaam.errors import LiaamError
from liaam.studio.model_store import FACTS_FILE, MODEL_FILE, QUICK_FACTS_FILE, QUICK_FILE, ModelStore
from liaam.studio.project import Project
from liaam.studio.proposals import is_proposal
from liaam.studio.safety import Refusal
from liaam.studio.training_process import LEAST, Job, launch


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
            self._process, pipe = launch(job)
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
