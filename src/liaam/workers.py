"""Work in threads with a bounded number of items in progress, and settings of the process for it."""

import multiprocessing
import os
import signal
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import ContextDecorator, contextmanager
from functools import lru_cache, partial
from importlib import import_module
from itertools import islice
from multiprocessing.context import SpawnContext
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from threadpoolctl import ThreadpoolController

Item = TypeVar("Item")
Result = TypeVar("Result")

AHEAD = 2  # Items in progress per worker: the current one, and the next, so that none waits for this process
BEHIND = 8  # Items per thread, finished or not, that may wait for a slow one before them (in_order)
TICK = 0.1  # Seconds between calls of `tick` while in_order waits


def all_cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def fresh_interpreters() -> SpawnContext:
    """Return the context that starts processes as fresh interpreters; a fork would copy threads' locks in any state.

    OpenCV is imported first, and this waits until no thread imports it any more: a new process gets the ``sys.path`` of
    its parent, to which OpenCV adds, while it is imported, a folder whose ``typing`` hides Python's.
    """
    import cv2  # noqa: F401

    # The import above may return while another thread is at the end of its own. OpenCV sets this mark meanwhile.
    while hasattr(sys, "OpenCV_LOADER"):
        time.sleep(0.001)
        import_module("cv2")  # raises where the other thread could not import it

    return multiprocessing.get_context("spawn")


def obey_parent() -> None:
    """Ignore Ctrl-C in a process, which its parent handles, and end when the parent does."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    if parent is None:
        return

    def end_with_parent() -> None:
        parent.join()
        os._exit(1)  # from a thread, sys.exit would end the thread only

    threading.Thread(target=end_with_parent, daemon=True).start()


def flow(
    submit: Callable[[Item], "Future[Result]"], items: Iterable[Item], room: Callable[[], int]
) -> Iterator[tuple[Item, "Future[Result]"]]:
    """Keep items in progress, as many as ``room`` returns at the moment. Yield each with its future once it is done.

    If an item is cancelled or fails, no further item starts before it is yielded, so that the caller may stop.
    """
    waiting = iter(items)
    under_way: dict[Future[Result], Item] = {}

    def fill() -> None:
        """Submit as many items as there is room for."""
        for item in islice(waiting, max(0, room() - len(under_way))):
            under_way[submit(item)] = item

    fill()
    while under_way:
        for future in wait(under_way, return_when=FIRST_COMPLETED).done:
            item = under_way.pop(future)
            if not future.cancelled() and future.exception() is None:
                fill()  # first, so that workers continue while this process handles the result
            yield item, future
        fill()  # also after failed items, which the caller has now seen


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


def limited_threads(threads: int) -> ThreadPoolExecutor:
    """Return a pool of threads, each of which may use one OpenMP thread: OpenMP's limit is per thread."""
    from threadpoolctl import threadpool_limits

    return ThreadPoolExecutor(threads, "liaam", partial(threadpool_limits, limits=1, user_api="openmp"))


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
    waiting = iter(items)
    in_turn = deque[Future[Result]]()  # what has begun and is not yielded, in the items' order
    pool = limited_threads(threads)
    try:
        while True:
            under_way = [future for future in in_turn if not future.done()]
            room = min(AHEAD * threads - len(under_way), BEHIND * threads - len(in_turn))
            begun = [pool.submit(perform, item) for item in islice(waiting, max(0, room))]
            in_turn += begun
            if not in_turn:
                return
            if in_turn[0].done():
                yield in_turn.popleft().result()
            else:
                # With a timeout, because on some systems Ctrl-C does not interrupt a wait.
                wait([*under_way, *begun], TICK, FIRST_COMPLETED)
                tick()
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


class _Hold(ContextDecorator):
    """A process-wide setting that several threads may hold at once. The last one to release it restores it.

    ``take`` makes the setting, and returns a function that restores what was set before.
    """

    def __init__(self, take: Callable[[], Callable[[], object]]) -> None:
        self._take = take
        self._lock = threading.Lock()
        self._n_holders = 0
        self._restore: Callable[[], object] = lambda: None

    def __enter__(self) -> None:
        with self._lock:
            restore = self._take()  # each time, because other code may have changed the setting
            if not self._n_holders:
                self._restore = restore
            self._n_holders += 1

    def __exit__(self, *_: object) -> None:
        with self._lock:
            self._n_holders -= 1
            if not self._n_holders:
                self._restore()


def _take_blas() -> Callable[[], object]:
    """Limit BLAS and OpenMP to one thread, as far as they are loaded; return a function that restores their limits."""
    return _loaded_blas(len(sys.modules)).limit(limits=1).restore_original_limits


@lru_cache(maxsize=1)
def _loaded_blas(n_modules: int) -> "ThreadpoolController":
    """Find the loaded BLAS and OpenMP libraries, which takes as long as an iteration of a fit.

    ``n_modules`` is the number of imported modules: only an import brings another library.
    """
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


def _take_opencv() -> Callable[[], object]:
    """Limit OpenCV to one thread; return a function that restores its limit."""
    import cv2

    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    return partial(cv2.setNumThreads, before)


_blas = _Hold(_take_blas)
_opencv = _Hold(_take_opencv)


class _WithSciPy(ContextDecorator):
    """The hold on BLAS after SciPy is loaded: it brings a BLAS of its own, which must be loaded to be limited."""

    def __enter__(self) -> None:
        import scipy.linalg  # noqa: F401

        _blas.__enter__()

    def __exit__(self, *_: object) -> None:
        _blas.__exit__()


_blas_with_scipy = _WithSciPy()


def one_numpy_thread() -> _Hold:
    """Limit the BLAS of NumPy to one thread, for the whole process, and that of SciPy only if it is loaded already.

    For work without SciPy, which takes long to load. Sums then have a fixed order, and products of the size of a fit's
    are no slower.
    """
    return _blas


def one_blas_thread() -> _WithSciPy:
    """Limit BLAS and OpenMP to one thread, for the whole process; also to decorate functions.

    Matrices of fits and of training are too small for more threads, which would busy-wait: on two cores, training on 60
    images takes as long with one as with two, and beside eight other programs 48 s instead of 129. Sums then have a
    fixed order.
    """
    return _blas_with_scipy


@contextmanager
def one_thread() -> Iterator[None]:
    """Limit BLAS, OpenMP and OpenCV to one thread, so that workers do not compete for cores."""
    with _opencv, _blas_with_scipy:
        yield
