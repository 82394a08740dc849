"""Fit chunks on a running Dask cluster. Needs the extra ``cluster``."""

import threading
import uuid
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any

from distributed import Client, KilledWorker, Worker, WorkerPlugin, get_worker
from distributed.comm.addressing import parse_address, parse_host_port
from distributed.comm.registry import get_backend

from liaam import __version__
from liaam.batch.pools import Chunk, Finished, row_of_death
from liaam.batch.work import Job, KeptRow, fit_chunk
from liaam.errors import LiaamError
from liaam.workers import AHEAD, flow

PATIENCE = 30
"""Timeout in seconds for the scheduler, and for its first worker."""


class _Ready(WorkerPlugin):
    """The job on each worker of the cluster, sent once to all workers, including those that join later."""

    def __init__(self, job: Job) -> None:
        self.job, self.version = job, __version__

    def setup(self, worker: Worker) -> None:
        if self.version != __version__:
            raise RuntimeError(f"worker {worker.address} has liaam {__version__}, not {self.version}")
        self.turn = threading.Lock()

    def rows(self, chunk: Chunk) -> list[KeptRow]:
        """Fit a chunk. The threads of a worker take turns, because the limit on BLAS threads is per process."""
        with self.turn:
            return fit_chunk(self.job, chunk)


def _fit_chunk(name: str, chunk: Chunk) -> list[KeptRow]:
    ready: Any = get_worker().plugins[name]
    return ready.rows(chunk)


def on_cluster(job: Job, chunks: Iterable[Chunk], address: str) -> Finished:
    """Fit chunks on the workers of a scheduler. Another worker takes over the chunks of a lost one."""
    with _connected(address) as client, _prepared(client, job) as name:
        executor = client.get_executor(pure=False)
        alone: list[Chunk] = []  # images of chunks whose workers died, filled by the first round
        try:
            threads: Any = client.nthreads
            for items, room in ((chunks, lambda: AHEAD * max(1, sum(threads().values()))), (alone, lambda: 1)):
                for chunk, future in flow(lambda chunk: executor.submit(_fit_chunk, name, chunk), items, room):
                    if future.cancelled():
                        raise LiaamError(f"{address}: the scheduler is lost; run the same command again to resume")
                    error = future.exception()
                    if error is None:
                        yield chunk, future.result()
                    elif not isinstance(error, KilledWorker):
                        raise LiaamError(f"{address}: the workers fail ({error}); {_REMEDY}") from error
                    elif items is not alone:
                        alone += [(path,) for path in chunk]
                    else:
                        yield chunk, [row_of_death(job, *chunk)]
        finally:
            executor.shutdown(wait=False)  # cancels pending chunks


_REMEDY = f"they need liaam {__version__} and the same version of distributed as here"


@contextmanager
def _connected(address: str) -> Iterator[Client]:
    try:
        # Check the address first: a Client with an invalid address hangs when it is deleted.
        scheme, place = parse_address(address)
        get_backend(scheme)
        if scheme in ("tcp", "tls"):
            parse_host_port(place)
        client = Client(address, timeout=PATIENCE, set_as_default=False, name="liaam-batch")
    except (OSError, ValueError, ImportError) as error:  # a timeout is an OSError
        raise LiaamError(
            f"{address}: no scheduler answers ({error}); start one with 'dask scheduler' and give the address "
            "that it prints, such as tcp://host:8786"
        ) from None
    with client:
        try:
            client.wait_for_workers(1, timeout=PATIENCE)
        except OSError:
            raise LiaamError(
                f"{address}: the scheduler has no workers; start some with 'dask worker {address} --nthreads 1'"
            ) from None
        yield client


@contextmanager
def _prepared(client: Client, job: Job) -> Iterator[str]:
    """Send the job to all workers once, and yield the name under which they have it."""
    name = f"liaam-{uuid.uuid4().hex}"
    try:
        client.register_plugin(_Ready(job), name=name)
    except Exception as error:  # of any class, raised by the workers
        raise LiaamError(f"the cluster's workers cannot be prepared ({error}); {_REMEDY}") from error
    try:
        yield name
    finally:
        if client.status == "running":
            client.unregister_worker_plugin(name)
