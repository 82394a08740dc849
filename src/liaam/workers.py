"""Work in many processes or threads: started safely, bounded in what is under way, ended with their parent."""

import multiprocessing
import os
import signal
import threading
import traceback
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager, suppress
from functools import partial
from itertools import islice
from multiprocessing import connection
from multiprocessing.connection import Connection
from typing import Generic, TypeVar, cast

Item = TypeVar("Item")
Result = TypeVar("Result")

AHEAD = 2
"""Items under way for each worker: one that it does, and the next."""

BEHIND = 8
"""Items for each thread that may wait, done or not, for one before them that takes long (:func:`in_order`)."""

TICK = 0.1
"""Seconds after which :func:`in_order` looks up from waiting."""


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
    prepare: Callable[..., object] | None = None,
    inherited: tuple = (),
) -> Generator[tuple[Item, Result], None, None]:
    """Do items in worker processes; they come in the order in which they finish.

    However many items there are, each worker has one at a time.

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
    inherited : tuple
        Arguments of ``prepare`` that can only be given to a process as it starts, such as shared memory; small.

    Raises
    ------
    WorkerDied
        Once all that was finished has been given.
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
        except OSError:  # a broken pipe: it is dead already
            lost.append(item)

    try:
        with deaf_to_interrupts():
            workers += (_Worker(inherited) for _ in first)
        for worker, item in zip(workers, first, strict=True):
            give(worker, item, (perform, prepare))
        while busy:
            for pipe in cast(list[Connection], connection.wait(list(busy))):
                worker = busy.pop(pipe)
                done = worker.item
                try:
                    ok, result = pipe.recv()
                except (EOFError, OSError):
                    lost.append(done)
                    continue
                for item in islice(rest, 0 if lost else 1):  # before the result is looked at: the worker goes on
                    give(worker, item)
                if not ok:
                    raise result
                yield done, result
        if lost:
            raise WorkerDied(lost)
    except BaseException:  # also a Ctrl-C: nobody waits for what the workers have in hand
        for worker in workers:
            worker.process.kill()
        raise
    finally:
        for worker in workers:
            worker.end()


class _Worker(Generic[Item]):
    """A worker process, the pipe to it, and the item that it does.

    Nobody else holds the pipe's other end, so that a worker that dies shows at once, even in the middle of a result.
    (A ``ProcessPoolExecutor`` waits for ever for the rest of the result: its workers share one pipe.) All that may be
    large comes by the pipe, too: ``Process.start`` waits for ever for a process that dies before it has read it.
    """

    item: Item

    def __init__(self, inherited: tuple) -> None:
        # A fresh interpreter per worker, on every system: a fork copies threads' locks in whatever state they are.
        context = multiprocessing.get_context("spawn")
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
    """Do items in a worker process until there is none in a message."""
    _start()
    try:
        perform, prepare = pipe.recv()
        if prepare is not None:
            prepare(*inherited)
        while message := pipe.recv():
            pipe.send(_answer(perform, *message))
    except (EOFError, OSError):  # nobody waits for it any more
        return


def _answer(perform: Callable[[Item], Result], item: Item) -> tuple[bool, Result | Exception]:
    """Whether an item could be done, and its result, or why not."""
    try:
        return True, perform(item)
    except Exception as fault:
        fault.add_note(f"In a worker process:\n{traceback.format_exc()}")
        return False, fault


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
        under_way.update((submit(item), item) for item in islice(rest, max(0, room() - len(under_way))))

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
    """Hold a Ctrl-C back for a moment, so that processes started meanwhile do not hear it, then or later.

    It reaches all processes of a terminal, but is for the one that can say something about it.
    """
    if not hasattr(signal, "pthread_sigmask"):  # Windows, where workers are deaf once they have started
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _start() -> None:
    """Make this worker deaf to Ctrl-C, and end when its parent is killed; it would wait for more work for ever."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=lambda: (parent.join(), os._exit(1)), daemon=True).start()


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


def in_order(
    perform: Callable[[Item], Result],
    items: Iterable[Item],
    threads: int,
    *,
    tick: Callable[[], object] = lambda: None,
) -> Generator[Result, None, None]:
    """Do items in threads of this process; results come in the items' order, as soon as those before them are there.

    For work that lets go of the interpreter. Items are taken one by one, in the caller's thread: ``AHEAD`` for each
    thread are under way at most, and ``BEHIND`` with those that wait for one before them. If an item fails, or the
    caller stops (by a Ctrl-C, say), no other is begun, and those that threads have in hand are waited for.

    Parameters
    ----------
    perform : callable
    items : iterable
    threads : int
    tick : callable
        Called now and then while nothing else happens.
    """
    rest, kept = iter(items), deque[Future[Result]]()
    pool = ThreadPoolExecutor(threads, "liaam", _hold_this_thread)
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
                # Not for ever: on some systems a Ctrl-C does not end a wait.
                wait([*under_way, *begun], TICK, FIRST_COMPLETED)
                tick()
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _hold_this_thread() -> None:
    """Hold OpenMP to one thread for this thread, which has a number of its own."""
    from threadpoolctl import threadpool_limits

    threadpool_limits(limits=1, user_api="openmp")


class _Hold:
    """A setting of the process that several threads may hold at once: the last of them to let go restores it."""

    def __init__(self, take: Callable[[], Callable[[], object]]) -> None:
        self._take, self._turn, self._holders = take, threading.Lock(), 0
        self._restore: Callable[[], object] = lambda: None

    def __enter__(self) -> None:
        with self._turn:
            restore = self._take()  # by each: somebody may have changed it meanwhile
            if not self._holders:
                self._restore = restore
            self._holders += 1

    def __exit__(self, *_: object) -> None:
        with self._turn:
            self._holders -= 1
            if not self._holders:
                self._restore()


def _take_blas() -> Callable[[], object]:
    import scipy.linalg  # noqa: F401 (it brings a BLAS of its own, which has to be there to be held)
    from threadpoolctl import threadpool_limits

    return threadpool_limits(limits=1).restore_original_limits


def _take_opencv() -> Callable[[], object]:
    import cv2

    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    return partial(cv2.setNumThreads, before)


_blas, _opencv = _Hold(_take_blas), _Hold(_take_opencv)


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Hold BLAS and OpenMP to one thread: the matrices of a fit are too small for more, which wait in loops.

    Sums then come in one order wherever they are made. It holds for the whole process.
    """
    with _blas:
        yield


@contextmanager
def one_thread() -> Iterator[None]:
    """Hold BLAS, OpenMP and OpenCV to one thread: workers leave each other's cores alone."""
    with _opencv, _blas:
        yield
