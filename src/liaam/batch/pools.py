"""Who does the chunks: this process, worker processes, or a cluster; all give the same rows."""

from collections.abc import Generator, Iterable, Iterator
from functools import partial
from itertools import chain

from liaam.batch.work import Job, KeptRow, failed_row, fit_chunk, kept, prepare
from liaam.errors import LiaamError
from liaam.workers import WorkerDied, in_workers, one_thread

Chunk = tuple[str, ...]
Finished = Generator[tuple[Chunk, list[KeptRow]], None, None]


def in_turn(job: Job, chunks: Iterable[Chunk]) -> Finished:
    """Do chunks in this process."""
    with one_thread():
        for chunk in chunks:
            yield chunk, job.rows(chunk)


def in_processes(job: Job, chunks: Iterable[Chunk], jobs: int) -> Finished:
    """Do chunks in worker processes; a picture that kills its worker becomes a row that says so."""
    chunks = iter(chunks)
    while True:
        try:
            yield from in_workers(fit_chunk, chunks, jobs, prepare=partial(prepare, job))
            return
        except WorkerDied as death:
            suspects = [path for chunk in death.items for path in chunk]
        yield from _one_by_one(job, suspects)


def deadly(path: str) -> KeptRow:
    """Row of a picture whose worker died, all alone with it."""
    message = f"{path}: the process that read and fitted it died (killed, or out of memory); look at it, or shrink it"
    row = failed_row(path, message)
    return kept({**row, "seconds": None})


def _one_by_one(job: Job, paths: list[str]) -> Finished:
    """Find out which picture it was: one worker, one picture at a time."""
    # The empty chunk tells a worker that cannot even start, which is no picture's fault.
    rest = iter(paths)
    while True:
        chunks: Iterator[Chunk] = chain([()], ((path,) for path in rest))
        try:
            for chunk, rows in in_workers(fit_chunk, chunks, 1, prepare=partial(prepare, job)):
                if chunk:
                    yield chunk, rows
            return
        except WorkerDied as death:
            (chunk,) = death.items
        if not chunk:
            raise LiaamError(
                "worker processes cannot start: a script that asks for more than one job needs the usual "
                "'if __name__ == \"__main__\":'; otherwise the line above says why, and --jobs 1 does without them"
            )
        yield chunk, [deadly(*chunk)]
