"""Fit chunks in worker processes."""

from collections.abc import Generator, Iterable, Iterator
from functools import partial
from itertools import chain

from liaam.batch.work import Job, KeptRow, failed_row, fit_chunk, kept
from liaam.errors import LiaamError
from liaam.workers import WorkerDied, in_workers

Chunk = tuple[str, ...]
Finished = Generator[tuple[Chunk, list[KeptRow]], None, None]


def in_processes(job: Job, chunks: Iterable[Chunk], jobs: int) -> Finished:
    """Fit chunks in worker processes. An image that crashes its worker becomes a row with an error."""
    chunks = iter(chunks)
    while True:
        try:
            yield from in_workers(partial(fit_chunk, job), chunks, jobs)
            return
        except WorkerDied as death:
            suspects = [path for chunk in death.items for path in chunk]
        yield from _one_by_one(job, suspects)


def row_of_death(job: Job, path: str) -> KeptRow:
    """Return the row of an image that crashed its worker."""
    message = f"{path}: the worker process died (killed or out of memory); check the image, or make it smaller"
    return kept(job.complete(failed_row(path, message), None))


def _one_by_one(job: Job, paths: list[str]) -> Finished:
    """Fit images one at a time with one worker, to find the image that crashes it.

    An image is tried twice, since the first worker may have been killed for another reason, such as the memory of
    other programs.
    """
    rest: Iterator[Chunk] = ((path,) for path in paths)
    died: set[Chunk] = set()
    while True:
        try:
            # The empty chunk detects a worker that cannot start, which no image causes.
            for chunk, rows in in_workers(partial(fit_chunk, job), chain([()], rest), 1):
                if chunk:
                    yield chunk, rows
            return
        except WorkerDied as death:
            (chunk,) = death.items
        if not chunk:
            raise LiaamError(
                "worker processes cannot start: a script that uses more than one job needs "
                "'if __name__ == \"__main__\":'; for other causes see the line above; --jobs 1 uses no workers"
            )
        if chunk in died:
            yield chunk, [row_of_death(job, *chunk)]
        else:
            died.add(chunk)
            rest = chain([chunk], rest)
