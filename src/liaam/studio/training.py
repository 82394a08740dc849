"""Training in the background, in a separate process.

The model is used as soon as it is trained. Then another one is trained without a few held-out pictures, on which its
error is measured. A stopped training keeps the earlier model. The process (:mod:`liaam.studio.training_process`)
reports over a pipe. It can be killed at any time, since all its writes are atomic. :mod:`liaam.studio.background` fits
pictures with the model.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from typing import Any

from liaam.errors import LiaamError
from liaam.model import load_model
from liaam.studio.model_store import MODEL_FILE, ModelStore, Versions
from liaam.studio.project import Project
from liaam.studio.safety import Refusal
from liaam.studio.training_process import LEAST, Job, choose_held_out, launch


@dataclass(frozen=True)
class Training:
    """State of the training, for the page."""

    state: str = "idle"
    """``idle``, ``running``, ``failed`` or ``done``."""
    done: int = 0
    total: int = 0
    what: str = ""
    error: str | None = None


class Trainer:
    """Trains in a separate process, one training at a time, and publishes the model as soon as it is trained."""

    def __init__(self, project: Project, models: ModelStore, publish: Callable[[str, Any], None]) -> None:
        self.project = project
        self.models = models
        self.versions = Versions(project.store)
        self._publish = publish
        self._lock = threading.RLock()
        self.state = Training()
        """The current state."""
        self.is_measuring = False
        """Whether the model of this training is in use already."""
        self._process: Any = None
        self._listener: threading.Thread | None = None
        self._stopped = False
        self._order = ""

    def start(self, slips: bool = False) -> Training:
        """Train on the done pictures, without those with possible slips unless ``slips``."""
        with self._lock:
            if self.state.state == "running":
                raise Refusal(409, "a training is running: wait for it, or stop it first", training=asdict(self.state))
            job = self._job(slips)
            self._order, self._stopped, self.is_measuring = job.order, False, False
            self._process, pipe = launch(job)
            self._set(Training("running", what="starting"))
            arguments = (job, pipe, self._process)
            self._listener = threading.Thread(target=self._listen, args=arguments, name="studio-training", daemon=True)
            self._listener.start()
            return self.state

    def stop(self) -> Training:
        """Stop a running training; its results so far are kept."""
        with self._lock:
            self._stopped = True  # messages still in the pipe are ignored
            if self.state.state == "running" and self._process is not None:
                self._process.kill()
        return self.wait()

    def stop_unless(self, order: str) -> None:
        """Stop a running training if it is for another :attr:`Templates.order`."""
        with self._lock:
            stale = self.state.state == "running" and self._order != order
        if stale:
            self.stop()

    def wait(self, timeout: float | None = None) -> Training:
        """Wait for a running training and return its final state."""
        if self._listener is not None:
            self._listener.join(timeout)
        return self.state

    def _job(self, with_slips: bool) -> Job:
        order = self.project.templates.order  # read before the points, so that results for changed points are dropped
        done, template = self.project.annotated(), self.project.templates.current
        slips = {item.name: f"its points may be wrong: {item.slip}" for item in done if item.slip and not with_slips}
        n_used = len(done) - len(slips)
        if n_used < LEAST or template is None:
            raise Refusal(
                422, f"only {n_used} pictures have all their points: complete at least {LEAST}, better 5, to train"
            )
        if len(template) < 3:
            raise Refusal(422, f"the template has {len(template)} points, but a shape needs at least 3: add some")
        return Job(
            done,
            template.contours,
            template.names,
            self.project.store.path(MODEL_FILE),
            order,
            self.project.root.name,
            choose_held_out([item.name for item in done if item.name not in slips], self.versions.held_out(order)),
            slips,
        )

    def _listen(self, job: Job, pipe: Any, process: Any) -> None:
        """Handle the messages of a process until it ends."""
        end = Training("failed", error="the training ended unexpectedly, perhaps for lack of memory: start it again")
        try:
            with pipe, suppress(EOFError, OSError):
                while end.state == "failed" and not self._stopped:
                    message = pipe.recv()
                    with self._lock:
                        end = end if self._stopped else self._handle(job, message) or end
        except LiaamError as fault:  # such as a missing folder or a full disk
            end = Training("failed", error=self.project.plain(fault))
        except Exception as fault:  # a bug: without an end, the training would run for ever
            logging.getLogger(__name__).exception("the training failed")
            text = f"the training failed ({type(fault).__name__}): see the studio's terminal for details"
            end = Training("failed", error=text)
        process.kill()
        process.join()
        with self._lock:
            self._set(Training() if self._stopped else end)
        self._publish("project", {})

    def _handle(self, job: Job, message: tuple[str, Any]) -> Training | None:
        """Handle a message of the process; return the final state if it has ended."""
        kind, data = message
        if kind == "progress":
            self._set(Training("running", **data))
        elif kind == "model":
            self._use(job, data)
        elif kind == "measured" and self.is_measuring and self.models.own is not None:
            self.versions.add(self.models.own.facts, data)
            self._publish("project", {})
        elif kind == "failed":
            return Training("failed", error=self.project.plain(data))
        elif kind == "done":
            return Training("done", what=data)
        return None

    def _use(self, job: Job, left_out: Mapping[str, str]) -> None:
        """Publish a model."""
        if job.order != self.project.templates.order:
            return
        facts = {
            "source": "studio",
            "trained": datetime.now(UTC).isoformat(timespec="milliseconds"),
            "pictures": {item.name: item.revision for item in job.done},
            "left_out": {name: self.project.plain(reason) for name, reason in left_out.items()},
            "order": job.order,
        }
        self.project.store.put("model", {MODEL_FILE: facts})
        self.models.publish(load_model(job.model), facts)
        self.is_measuring = True
        self._publish("project", {})

    def _set(self, state: Training) -> None:
        self.state = state
        self._publish("training", asdict(state))
