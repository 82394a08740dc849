"""Fit images on a running Dask cluster. Needs the extra ``cluster``."""

import asyncio
import uuid
from collections.abc import Iterator
from concurrent.futures import CancelledError, Future
from contextlib import ExitStack, contextmanager
from functools import partial
from typing import Any, cast
from weakref import WeakSet

from distributed import Client, KilledWorker, Worker, WorkerPlugin, get_worker
from distributed.comm.addressing import parse_address, parse_host_port
from distributed.comm.core import connect
from distributed.comm.registry import get_backend

from liaam import __version__
from liaam.batch.work import FitJob, JournalRow, Pool
from liaam.errors import LiaamError
from liaam.workers import AHEAD, one_thread

ANSWER = 5  # Timeout in seconds for the scheduler, which answers in less than one
PATIENCE = 30  # Timeout in seconds for its first worker


class _Ready(WorkerPlugin):
    """The job on each worker of the cluster, sent once to all workers, including those that join later."""

    def __init__(self, job: FitJob) -> None:
        self.job = job
        self.version = __version__

    def setup(self, worker: Worker) -> None:
        if self.version != __version__:
            raise RuntimeError(f"worker {worker.address} has liaam {__version__}, not {self.version}")
        self.limits = ExitStack()
        self.limits.enter_context(one_thread())  # dask sets the number of threads

    def teardown(self, worker: Worker) -> None:
        self.limits.close()


def _fit(name: str, path: str) -> JournalRow:
    ready: Any = get_worker().plugins[name]
    return ready.job.row(path)


@contextmanager
def on_cluster(job: FitJob, address: str) -> Iterator[Pool]:
    """Yield a pool of the workers of a scheduler. Another worker takes over the images of a lost one."""
    with _connected(address) as client, _prepared(client, job) as name:
        threads = cast(Any, client.nthreads)
        pending = WeakSet()

        def submit(path: str) -> Future[JournalRow]:
            row: Future[JournalRow] = Future()
            asked = client.submit(_fit, name, path, pure=False)
            pending.add(asked)
            asked.add_done_callback(partial(_pass_on, row))
            return row

        def room() -> int:
            return AHEAD * max(1, sum(threads().values()))

        try:
            yield submit, room, (KilledWorker,)
        except CancelledError:
            raise LiaamError(f"{address}: the scheduler is lost; run the same command again to resume") from None
        except LiaamError:
            raise
        except Exception as error:
            raise LiaamError(f"{address}: the workers fail ({error}); {_REMEDY}") from error
        finally:
            client.cancel(list(pending))  # before the workers forget the job


def _pass_on(row: "Future[JournalRow]", asked: Any) -> None:
    """Give a row what a worker answered. If a worker is lost after it has answered, another one fits again.

    The executor of distributed takes such an answer for an error.
    """
    try:
        row.set_result(asked.result())
    except BaseException as error:  # of any class: who waits for the row handles it
        row.set_exception(error)


_REMEDY = f"they need liaam {__version__} and the same version of distributed as here"


@contextmanager
def _connected(address: str) -> Iterator[Client]:
    try:
        # Check the address first: a Client of an invalid address, or of another program, hangs when it is deleted.
        scheme, place = parse_address(address)
        get_backend(scheme)
        if scheme in ("tcp", "tls"):
            parse_host_port(place)
        asyncio.run(_greet(address))
        client = Client(address, timeout=ANSWER, set_as_default=False, name="liaam-batch")
    except Exception as error:  # of any class, if another program answers
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


async def _greet(address: str) -> None:
    """Raise unless a Dask program answers at an address."""
    greeting = await connect(address, timeout=ANSWER)
    await greeting.close()


@contextmanager
def _prepared(client: Client, job: FitJob) -> Iterator[str]:
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
