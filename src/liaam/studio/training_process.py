"""What a process of its own does: it trains on the pictures that are done, and proposes landmarks for the rest."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from liaam.errors import ImageError, LiaamError, TrainingError
from liaam.io.landmarks import Contour, Landmarks
from liaam.progress import Progress
from liaam.studio.pictures import file_tag
from liaam.studio.project import Annotated

if TYPE_CHECKING:
    from liaam.fitting import FitResult, Fitter
    from liaam.model import AAM

LEAST = 3
"""Pictures to learn from at least."""

OPTIONS: dict[str, Any] = {"prior": "smooth"}
"""How models are trained: ``smooth`` shapes serve best where few pictures have been annotated."""


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


def launch(job: Job) -> tuple[Any, Any]:
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

    def _progress(self, phase: str) -> Progress:
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
    from liaam.model.shape import diagonal_of

    facts = {"status": str(result.status), "message": result.message}
    if not np.isfinite(result.landmarks).all():
        return {**_NOTHING, **facts}
    covariances, size = result.landmark_covariances, diagonal_of(result.landmarks)
    certain = bool(np.isfinite(covariances).all()) and size > 0
    found = not result.place_doubtful
    return {
        **facts,
        "points": [[round(x, 3), round(y, 3)] for x, y in result.landmarks.tolist()],
        "covariances": np.round(covariances, 4).tolist() if certain else None,
        "quality": None if np.isnan(result.quality) else round(float(result.quality), 4),
        "ok": result.status.ok,
        "found": found,
        "doubtful": not found or not result.status.ok,
        "uncertainty": round(float(result.deviations.mean()) / size, 5) if certain else None,
    }
