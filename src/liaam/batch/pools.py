"""Where the images of a batch are fitted: in threads of this process."""

from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial

from liaam.batch.work import Job, KeptRow
from liaam.workers import limited_threads, one_thread


@dataclass(frozen=True)
class Pool:
    """Fits images side by side.

    Attributes
    ----------
    submit : callable
        Takes the path of an image, and returns the future of its row.
    room : callable
        Returns how many images may be in progress now.
    died : tuple of exception types
        What a future raises if the process that fitted its image died.
    """

    submit: Callable[[str], "Future[KeptRow]"]
    room: Callable[[], int]
    died: tuple[type[Exception], ...] = ()


@contextmanager
def on_threads(job: Job, threads: int) -> Iterator[Pool]:
    """Yield a pool of threads; fits release the interpreter's lock. At the end, wait for running fits."""
    with one_thread(), limited_threads(threads) as pool:
        yield Pool(partial(pool.submit, job.kept_row), lambda: threads)
