"""The training process: it trains a model on the done pictures, then measures one that is trained without some."""

from __future__ import annotations

import hashlib
import os
import warnings
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from liaam.errors import ImageError, LiaamError, TrainingError
from liaam.io.landmarks import Contour, Landmarks
from liaam.model import AAM
from liaam.model.shape import diagonal_of
from liaam.studio.project import Annotated
from liaam.workers import fresh_interpreters, obey_parent

LEAST = 3
"""Minimum number of pictures for training."""

OPTIONS: dict[str, Any] = {"prior": "smooth", "methods": "all"}
"""Options of training. ``smooth`` shapes work best with few annotated pictures."""


@dataclass(frozen=True)
class Job:
    """Input of the training process."""

    done: list[Annotated]
    """Pictures for training."""
    contours: tuple[Contour, ...]
    names: tuple[str, ...]
    """Names of the landmarks."""
    model: Path
    """Output file of the model."""
    order: str
    """:attr:`Templates.order` of the points."""
    name: str
    """Name of the model."""
    held_out: tuple[str, ...] = ()
    """Pictures on which a model that is trained without them is measured."""
    slips: dict[str, str] = field(default_factory=dict)
    """Pictures that are left out because their landmarks may be wrong, and what they may have."""


def choose_held_out(names: Sequence[str], before: Sequence[str]) -> tuple[str, ...]:
    """Choose the pictures to measure a model on: 1, 2, 4 or 8, at most a quarter of all.

    The pictures of the ``before`` model come first, then others in an order that does not depend on the set, so that
    models are measured on the same pictures where possible.
    """
    count = next((n for n in (8, 4, 2, 1) if 4 * n <= len(names)), 0)
    order = sorted(names, key=lambda name: (name not in before, hashlib.sha256(name.encode()).digest()))
    return tuple(order[:count])


def launch(job: Job) -> tuple[Any, Any]:
    """Start the process; return it and the receiving end of its pipe."""
    context = fresh_interpreters()
    here, there = context.Pipe(duplex=False)
    process = context.Process(target=_work, args=(job, there), name="liaam-studio-training", daemon=True)
    process.start()
    there.close()
    return process, here


def _work(job: Job, pipe: Any) -> None:
    """Run a job in the training process."""
    obey_parent()  # the server terminates this process
    with suppress(AttributeError, OSError):
        os.nice(5)  # requests of the user have priority
    with suppress(BrokenPipeError, ConnectionError):
        try:
            pipe.send(("done", _Worker(job, pipe.send, dict(job.slips)).run()))
        except (LiaamError, MemoryError) as fault:
            pipe.send(("failed", str(fault) or "the training ran out of memory: train on smaller pictures"))


class _Picture:
    """A picture for :func:`liaam.training.train`; records its error."""

    def __init__(self, item: Annotated, job: Job) -> None:
        self.name = item.name
        self.landmarks = Landmarks(item.points, job.contours, job.names)
        self.path = item.path
        self.fault: str | None = None

    def read_image(self) -> np.ndarray:
        from liaam.io import read_image
        from liaam.photometry.encoding import refuse_unscaled

        try:
            image = read_image(self.path)
            refuse_unscaled(image, self.name, "srgb")
            return image
        except ImageError as fault:
            self.fault = str(fault)
            raise


@dataclass
class _Worker:
    """Runs a job and reports its progress."""

    job: Job
    send: Callable[[tuple[str, Any]], None]
    left_out: dict[str, str] = field(default_factory=dict)
    warned: str = ""

    def run(self) -> str:
        """Train the model, then measure another that is trained without the held-out pictures; return a summary."""
        model = self._train((), lamps="auto")
        model.save(self.job.model)
        self.send(("model", self.left_out))
        without = f", without {', '.join(self.left_out)}" if self.left_out else ""
        summary = f"trained on {model.n_all_images} pictures{without}{self.warned}"
        with suppress(LiaamError, MemoryError):  # such as too few pictures without those
            rest = self._train(self.job.held_out, "measuring", leave_out=False, lamps=None)
            self.send(("measured", self._measure(rest)))
        return summary

    def _train(self, unused: Sequence[str], what: str = "", **options: Any) -> AAM:
        """Train a model. Leave out pictures that turn out to be unusable and start again."""
        from liaam.training import train

        def progress(done: int, total: int, doing: str) -> None:
            self.send(("progress", {"done": done, "total": total, "what": what or doing}))

        items = [_Picture(item, self.job) for item in self.job.done if item.name not in {*self.left_out, *unused}]
        while True:
            try:
                with warnings.catch_warnings(record=True) as caught:
                    warnings.simplefilter("always", UserWarning)
                    model = train(items, name=self.job.name, progress=progress, **OPTIONS, **options)
                self.warned = "".join(f"; {warning.message}" for warning in caught)
                return model
            except (ImageError, TrainingError):
                unfit = {item.name: item.fault for item in items if item.fault is not None}
                if not unfit or len(items) - len(unfit) < LEAST:
                    raise
                self.left_out |= unfit
                items = [item for item in items if item.name not in unfit]

    def _measure(self, model: AAM) -> dict[str, float]:
        """Return the mean distance of the fitted points to the placed ones in the held-out pictures.

        The unit is the diagonal of the box around the placed points. Pictures that cannot be fitted are missing.
        """
        from liaam.evaluation import point_error
        from liaam.fitting import Fitter

        fitter, errors = Fitter(model), {}
        for item in self.job.done:
            if item.name in self.job.held_out:
                with suppress(LiaamError, MemoryError):
                    error = point_error(fitter.fit(item.path).landmarks, item.points) / diagonal_of(item.points)
                    errors[item.name] = round(error, 5)
        return {name: error for name, error in errors.items() if np.isfinite(error)}
