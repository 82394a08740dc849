"""Work in many processes: started safely, bounded in what is under way, ended with their parent."""

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, ThreadPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from functools import partial
from itertools import islice
from typing import Generic, TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")

AHEAD = 2
"""Items under way for each worker: one that it does, and the next."""


class WorkerDied(Exception, Generic[Item]):  # noqa: N818 (it tells what happened; callers say what to do about it)
    """A worker process died (killed, out of memory, or crashed by what it did).

    Attributes
    ----------
    items : list
        What was under way and gave no result; one of these may be why.
    """

    def __init__(self, items: list[Item]) -> None:
        super().__init__(f"a worker process died with {len(items)} items under way")
        self.items = items


def all_cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def in_workers(
    perform: Callable[[Item], Result],
    items: Iterable[Item],
    jobs: int,
    *,
    prepare: Callable[[], object] | None = None,
    ahead: int = AHEAD,
) -> Generator[tuple[Item, Result], None, None]:
    """Do items in worker processes; they come in the order in which they finish.

    However many items there are, only ``jobs * ahead`` of them are taken at a time.

    Parameters
    ----------
    perform : callable
        From an item to its result; at the top of a module, or a ``functools.partial`` of such.
    items : iterable
        Picklable.
    jobs : int
        Worker processes.
    prepare : callable, optional
        What each worker does once, before its first item.
    ahead : int
        Items under way for each worker.

    Raises
    ------
    WorkerDied
        Once all that was finished has been given.
    """
    others = set(multiprocessing.active_children())
    # A fresh interpreter per worker, on every system: a fork copies threads' locks in whatever state they are.
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(jobs, context, initializer=_start, initargs=(prepare,))
    try:
        yield from _results(partial(pool.submit, perform), items, jobs * ahead)
    except BaseException:  # also a Ctrl-C: nobody waits for what the workers have in hand
        for worker in set(multiprocessing.active_children()) - others:
            worker.terminate()
        raise
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _results(
    submit: Callable[[Item], "Future[Result]"], items: Iterable[Item], room: int
) -> Generator[tuple[Item, Result], None, None]:
    lost = []
    for item, future in flow(submit, items, lambda: 0 if lost else room):
        if isinstance(future.exception(), BrokenProcessPool):
            lost.append(item)
        else:
            yield item, future.result()
    if lost:
        raise WorkerDied(lost)


def flow(
    submit: Callable[[Item], "Future[Result]"], items: Iterable[Item], room: Callable[[], int]
) -> Iterator[tuple[Item, "Future[Result]"]]:
    """Keep a bounded number of items under way; gives each with its finished future.

    Parameters
    ----------
    submit : callable
        Starts an item. The first ones are started deaf to Ctrl-C, and with them the processes that do them.
    items : iterable
        Read only as far as there is room.
    room : callable
        Says how many may be under way now.
    """
    rest, under_way = iter(items), {}

    def fill() -> None:
        for item in islice(rest, max(0, room() - len(under_way))):
            try:
                under_way[submit(item)] = item
            except BrokenProcessPool as death:
                failed: Future = Future()
                failed.set_exception(death)
                under_way[failed] = item
                return

    with deaf_to_interrupts():
        fill()
    while under_way:
        for future in wait(under_way, return_when=FIRST_COMPLETED).done:
            item = under_way.pop(future)
            if not future.cancelled() and future.exception() is None:
                fill()  # first, so that workers go on while this process sees to the result
            yield item, future
        fill()


@contextmanager
def deaf_to_interrupts() -> Iterator[None]:
    """Ignore Ctrl-C for a moment, so that processes started meanwhile ignore it for good.

    It reaches all processes of a terminal, but is for the one that can say something about it.
    """
    if threading.current_thread() is not threading.main_thread():  # where Python lets nobody set this
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _start(prepare: Callable[[], object] | None) -> None:
    """Make this worker deaf to Ctrl-C, and end when its parent is killed; it would wait for more work for ever."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=lambda: (parent.join(), os._exit(1)), daemon=True).start()
    if prepare is not None:
        prepare()


def in_threads(perform: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
    """Do items side by side in threads of this process, as many as OpenCV may have; results in the items' order.

    For work that lets go of the interpreter: kernels, and what OpenCV does. Under :func:`one_thread`, one by one.
    """
    import cv2

    threads = min(cv2.getNumThreads(), all_cores(), len(items))
    if threads <= 1:
        return [perform(item) for item in items]
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(perform, items))


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Hold BLAS and OpenMP to one thread: the matrices of a fit are too small for more, which wait in loops.

    Sums then come in one order wherever they are made. It holds for the whole process.
    """
    import scipy.linalg  # noqa: F401 (it brings a BLAS of its own, which has to be there to be held)
    from threadpoolctl import threadpool_limits

    with threadpool_limits(limits=1):
        yield


@contextmanager
def one_thread() -> Iterator[None]:
    """Hold BLAS, OpenMP and OpenCV to one thread: workers leave each other's cores alone."""
    import cv2

    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        with one_blas_thread():
            yield
    finally:
        cv2.setNumThreads(before)
