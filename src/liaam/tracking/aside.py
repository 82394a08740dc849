"""Work on a thread of its own, in order, a few items behind: writing a video while the next frames are tracked."""

import queue
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

WAITING = 8
"""Items that may wait; whoever brings one more waits for the work."""

PATIENCE = 0.1
"""Seconds between two looks at whether the work has failed."""


@contextmanager
def aside(work: Callable[..., None]) -> Iterator[Callable[..., None]]:
    """Do work aside.

    Parameters
    ----------
    work : callable
        Called with the arguments of each item, one after the other, on another thread.

    Yields
    ------
    callable
        Takes the arguments of the next item. All are done once the block has ended; where it ends by an error, those
        that wait are left undone.

    Raises
    ------
    BaseException
        What the work raised, when the next item is brought or the block ends.
    """
    items: queue.Queue[tuple | None] = queue.Queue(WAITING)
    failures: list[BaseException] = []
    given_up, ended = threading.Event(), threading.Event()

    def go() -> None:
        try:
            while (item := items.get()) is not None and not given_up.is_set():
                work(*item)
        except BaseException as error:
            failures.append(error)
            given_up.set()
        finally:
            ended.set()

    def bring(item: tuple | None) -> None:
        while not given_up.is_set():
            try:
                items.put(item, timeout=PATIENCE)
                return
            except queue.Full:
                continue

    def take(*item: object) -> None:
        bring(item)
        if failures:
            raise failures[0]

    threading.Thread(target=go, name="aside", daemon=True).start()
    try:
        yield take
    except BaseException:
        given_up.set()
        _empty(items)
        raise
    finally:
        interrupted: BaseException | None = None
        while not ended.is_set():  # what the work writes to is closed next: never leave while it goes on
            try:
                bring(None)
                if given_up.is_set():
                    _empty(items)
                    items.put(None)
                ended.wait()  # not for the thread: a join that is interrupted takes it for ended
            except BaseException as error:  # another Ctrl-C
                given_up.set()
                interrupted = error
        if interrupted is not None:
            raise interrupted
    if failures:
        raise failures[0]


def _empty(items: queue.Queue) -> None:
    while True:
        try:
            items.get_nowait()
        except queue.Empty:
            return
