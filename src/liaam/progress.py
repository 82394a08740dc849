"""How calls that may take long tell how far they are."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from time import perf_counter

Progress = Callable[[int, int, str], None]
"""What long calls are given to tell how far they are: called with (done, total, what)."""

PATIENCE = 2.0
"""Seconds before a bar appears that nobody has asked for."""


@contextmanager
def progress_bar(what: str, total: int | None, show: bool | None = None) -> Iterator[Callable[[int], None]]:
    """Show on standard error how many are done and what time is left; gives a function to call with the number done.

    Parameters
    ----------
    what : str
        What is counted, such as ``pictures``.
    total : int or None
        How many there are; None if nobody knows.
    show : bool or None
        True: from the beginning; where there is no terminal, a line at the end. False: never. None: on a terminal, once
        it takes more than two seconds; it leaves nothing behind.
    """
    if show is False or (show is None and not sys.stderr.isatty()):
        yield lambda done: None
        return
    begin, bars = perf_counter(), []

    def tell(done: int) -> None:
        if not bars and (show or perf_counter() - begin > PATIENCE):
            bars.append(_Bar(what, total))
        for bar in bars:
            bar.tell(done)

    try:
        yield tell
    finally:
        for bar in bars:
            bar.stop()


class _Bar:
    def __init__(self, what: str, total: int | None) -> None:
        # Heavy: imported when first needed.
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
        from rich.progress import Progress as Bar

        console = Console(stderr=True)
        columns = BarColumn(), MofNCompleteColumn(), TextColumn("{task.description}, left:"), TimeRemainingColumn()
        self._bar = Bar(*columns, console=console, transient=console.is_terminal)
        self._task = self._bar.add_task(what, total=total)
        self._bar.start()

    def tell(self, done: int) -> None:
        self._bar.update(self._task, completed=done)

    def stop(self) -> None:
        self._bar.stop()
