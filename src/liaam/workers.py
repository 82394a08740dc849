"""Work in processes or threads with a bounded number of items in progress. Workers end with their parent."""

import multiprocessing
import os
import pickle
import signal
import sys
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import ContextDecorator, contextmanager, suppress
from functools import partial
from importlib import import_module
from itertools import islice
from multiprocessing import connection, resource_tracker
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnContext
from multiprocessing.reduction import ForkingPickler
from typing import Generic, TypeVar, cast

Item = TypeVar("Item")
Result = TypeVar("Result")

AHEAD = 2
"""Items in progress per worker: the current one and the next."""

BEHIND = 8
"""Items per thread, finished or not, that may wait for a slow one before them (:func:`in_order`)."""

TICK = 0.1
"""Seconds between calls of `tick` while :func:`in_order` waits."""


class WorkerDied(Exception, Generic[Item]):  # noqa: N818 (an event for callers to handle)
    """A worker process died: it was killed, ran out of memory or crashed, perhaps by one of the `items` in progress."""

    def __init__(self, items: list[Item]) -> None:
        super().__init__(f"a worker process died with {len(items)} items in progress")
        self.items = items


def all_cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def fresh_interpreters() -> SpawnContext:
    """Return the context that starts processes as fresh interpreters; a fork would copy threads' locks in any state.

    OpenCV is imported first. A process gets the module path of its parent, and while a thread of the parent imports
    OpenCV, that path has a folder whose ``typing`` hides Python's: the process would end at once. An ``import`` may
    return while another thread is at the end of importing it, so that OpenCV's own mark of its loader decides.
    """
    import cv2  # noqa: F401

    while hasattr(sys, "OpenCV_LOADER"):
        time.sleep(0.001)
        import_module("cv2")  # raises where the other thread could not import it

    return multiprocessing.get_context("spawn")


def in_workers(
    perform: Callable[..., Result],
    items: Iterable[Item],
    jobs: int,
    *,
    inherited: tuple = (),
    stop_at_death: bool = False,
) -> Generator[tuple[Item, Result], None, None]:
    """Process picklable items in worker processes. Yield (item, result) in order of completion.

    Each worker has one item at a time. ``perform`` is a function at the top level of a module, or a ``partial`` of one.
    It is sent to each worker once. Its arguments before the item may be ``inherited``: they are passed when the process
    starts, as shared memory must be. Raises WorkerDied if a worker died, after the others have finished their items, or
    at once with ``stop_at_death``. Raises what ``perform`` raised, or why its result cannot be pickled, with the
    worker's traceback as a note.
    """
    rest = iter(items)
    first = list(islice(rest, jobs))
    workers: list[_Worker[Item]] = []
    busy: dict[Connection, _Worker[Item]] = {}
    lost: list[Item] = []

    def give(worker: _Worker[Item], item: Item, *before: object) -> None:
        worker.item = item
        try:
            for message in (*before, (item,)):
                worker.pipe.send(message)
            busy[worker.pipe] = worker
        except OSError:  # a broken pipe: the worker has died
            lost.append(item)

    try:
        with deaf_to_interrupts():
            workers += (_Worker(inherited) for _ in first)
        for worker, item in zip(workers, first, strict=True):
            give(worker, item, perform)
        while busy and not (lost and stop_at_death):
            for pipe in cast(list[Connection], connection.wait(list(busy))):
                worker = busy.pop(pipe)
                done = worker.item
                try:
                    ok, result = pipe.recv()
                except (EOFError, OSError):
                    lost.append(done)
                    continue
                for item in islice(rest, 0 if lost else 1):  # the worker continues before its result is handled
                    give(worker, item)
                if not ok:
                    raise result
                yield done, result
        if lost:
            raise WorkerDied(lost)
    except BaseException:  # including Ctrl-C: discard the items in progress
        for worker in workers:
            worker.process.kill()
        raise
    finally:
        for worker in workers:
            worker.end()


class _Worker(Generic[Item]):
    """A worker process, the pipe to it, and the item that it processes.

    No other process holds the pipe's other end, so that the death of a worker shows at once, even in the middle of a
    result. (A ``ProcessPoolExecutor`` hangs then.) All that may be large is sent by the pipe, too: ``Process.start``
    hangs if a process dies before it has read its arguments.
    """

    item: Item

    def __init__(self, inherited: tuple) -> None:
        context = fresh_interpreters()
        self.pipe, theirs = context.Pipe()
        self.process = context.Process(target=_work, args=(theirs, inherited), daemon=True)
        self.process.start()
        theirs.close()

    def end(self) -> None:
        """Let the process end, and wait for it."""
        with suppress(OSError):  # it is dead
            self.pipe.send(())
        self.pipe.close()
        self.process.join()


def _work(pipe: Connection, inherited: tuple) -> None:
    """Do items in a worker process until there is none in a message, or its parent is gone. It ignores Ctrl-C."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    if parent is not None:  # otherwise the worker would wait for work for ever when its parent has died
        threading.Thread(target=lambda: (parent.join(), os._exit(1)), daemon=True).start()
    try:
        perform = partial(pipe.recv(), *inherited)
        while message := pipe.recv():
            pipe.send_bytes(_answer(perform, *message))
    except (EOFError, OSError):  # nobody waits for it any more
        return


def _answer(perform: Callable[[Item], object], item: Item) -> "bytes | memoryview":
    """Pickle whether an item could be done, and its result or error."""
    try:
        return ForkingPickler.dumps((True, perform(item)))
    except Exception as error:
        fault, note = error, f"In a worker process:\n{traceback.format_exc()}"
        try:
            pickle.loads(pickle.dumps(fault))
        except Exception:
            fault = RuntimeError(f"{type(error).__name__}: {error}")
        fault.add_note(note)
        return ForkingPickler.dumps((False, fault))


def flow(
    submit: Callable[[Item], "Future[Result]"], items: Iterable[Item], room: Callable[[], int]
) -> Iterator[tuple[Item, "Future[Result]"]]:
    """Keep a bounded number of items in progress, as many as there is room for now. Yield each with its future."""
    rest, under_way = iter(items), {}

    def fill() -> None:
        under_way.update((submit(item), item) for item in islice(rest, max(0, room() - len(under_way))))

    fill()
    while under_way:
        for future in wait(under_way, return_when=FIRST_COMPLETED).done:
            item = under_way.pop(future)
            if not future.cancelled() and future.exception() is None:
                fill()  # first, so that workers continue while this process handles the result
            yield item, future
        fill()


@contextmanager
def deaf_to_interrupts() -> Iterator[None]:
    """Block Ctrl-C for a moment: processes that start meanwhile ignore it, so that only their parent handles it."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows, where workers ignore it once they have started
        yield
        return
    resource_tracker.ensure_running()  # the first process starts it, and that unblocks signals
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def in_threads(perform: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
    """Process items in parallel threads, as many as OpenCV may use. Return the results in the items' order.

    For work that releases the GIL, such as calls of the core and of OpenCV. Under :func:`one_thread` it is sequential.
    """
    import cv2

    threads = min(cv2.getNumThreads(), all_cores(), len(items))
    if threads <= 1:
        return [perform(item) for item in items]
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(perform, items))


def in_order(
    perform: Callable[[Item], Result],
    items: Iterable[Item],
    threads: int,
    *,
    tick: Callable[[], object] = lambda: None,
) -> Generator[Result, None, None]:
    """Process items in threads. Yield results in the items' order, as soon as all earlier ones are finished.

    For work that releases the GIL. The caller's thread consumes the items one by one. At most ``AHEAD`` items per
    thread are in progress, and at most ``BEHIND`` including finished ones that wait for an earlier item. If an item
    fails or the caller stops, no further item starts, and running ones are completed. ``tick`` is called regularly.
    """
    from threadpoolctl import threadpool_limits

    rest, kept = iter(items), deque[Future[Result]]()
    # OpenMP's limit is per thread.
    pool = ThreadPoolExecutor(threads, "liaam", partial(threadpool_limits, limits=1, user_api="openmp"))
    try:
        while True:
            under_way = [future for future in kept if not future.done()]
            room = min(AHEAD * threads - len(under_way), BEHIND * threads - len(kept))
            begun = [pool.submit(perform, item) for item in islice(rest, max(0, room))]
            kept += begun
            if not kept:
                return
            if kept[0].done():
                yield kept.popleft().result()
            else:
                # With a timeout, because on some systems Ctrl-C does not interrupt a wait.
                wait([*under_way, *begun], TICK, FIRST_COMPLETED)
                tick()
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


class _Hold(ContextDecorator):
    """A process-wide setting that several threads may hold at once. The last one to release it restores it."""

    def __init__(self, take: Callable[[], Callable[[], object]]) -> None:
        self._take, self._turn, self._holders = take, threading.Lock(), 0
        self._restore: Callable[[], object] = lambda: None

    def __enter__(self) -> None:
        with self._turn:
            restore = self._take()  # each time, because other code may have changed the setting
            if not self._holders:
                self._restore = restore
            self._holders += 1

    def __exit__(self, *_: object) -> None:
        with self._turn:
            self._holders -= 1
            if not self._holders:
                self._restore()


def _take_blas() -> Callable[[], object]:
    import scipy.linalg  # noqa: F401 (loads its own BLAS, which must be loaded to be limited)
    from threadpoolctl import threadpool_limits

    return threadpool_limits(limits=1).restore_original_limits


def _take_opencv() -> Callable[[], object]:
    import cv2

    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    return partial(cv2.setNumThreads, before)


_blas, _opencv = _Hold(_take_blas), _Hold(_take_opencv)


def one_blas_thread() -> _Hold:
    """Limit BLAS and OpenMP to one thread, for the whole process; also to decorate functions.

    Matrices of fits and of training are too small for more threads, which would busy-wait: on two cores, training on 60
    images takes as long with one as with two, and beside eight other programs 48 s instead of 129. Sums then have a
    fixed order.
    """
    return _blas


@contextmanager
def one_thread() -> Iterator[None]:
    """Limit BLAS, OpenMP and OpenCV to one thread, so that workers do not compete for cores."""
    with _opencv, _blas:
        yield
