"""Work in a background thread, in order: a video is written while the next frames are tracked."""

import queue
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

WAITING = 8
"""Maximum number of waiting items. Adding another one blocks."""

PATIENCE = 0.1
"""Seconds between checks whether the work has failed."""


@contextmanager
def aside(work: Callable[..., None]) -> Iterator[Callable[..., None]]:
    """Run work in a background thread.

    Parameters
    ----------
    work : callable
        Called with the arguments of each item, in order, in the other thread.

    Yields
    ------
    callable
        Takes the arguments of the next item. The end of the block waits for all items. If the block raises, waiting
        items are discarded.

    Raises
    ------
    BaseException
        The error of the work, when the next item is added or the block ends.
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
        while not ended.is_set():  # the caller closes the files next: wait until the work has ended
            try:
                bring(None)
                if given_up.is_set():
                    _empty(items)
                    items.put(None)
                ended.wait()  # rather than join, which an interrupt can end early
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
