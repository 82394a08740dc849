"""Work in a background thread, in order: a video is written while the next frames are tracked."""

from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import contextmanager

WAITING = 8
"""Maximum number of waiting items. Adding another one blocks."""


@contextmanager
def aside(work: Callable[..., None]) -> Iterator[Callable[..., None]]:
    """Call work in a background thread, in order. Yield a function that takes the arguments of the next call.

    The end of the block waits for all calls. If the block raises, waiting calls are discarded. An error of the work is
    raised by the next call, or at the end of the block.
    """
    pool, calls = ThreadPoolExecutor(1, "aside"), deque[Future[None]]()

    def limit(most: int) -> None:
        """Wait until at most so many calls are left, and raise the error of a finished one."""
        while calls and (len(calls) > most or calls[0].done()):
            calls[0].result()
            calls.popleft()

    def take(*arguments: object) -> None:
        limit(WAITING)
        calls.append(pool.submit(work, *arguments))

    try:
        yield take
        limit(0)
    finally:
        pool.shutdown(wait=False, cancel_futures=True)
        interrupted: BaseException | None = None
        while running := [call for call in calls if not call.done()]:  # the caller closes the files next
            try:
                wait(running)
            except BaseException as error:  # another Ctrl-C
                interrupted = error
        if interrupted is not None:
            raise interrupted
