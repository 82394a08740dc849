"""Progress reports of long calls."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from time import perf_counter
from typing import Any

Progress = Callable[[int, int, str], None]
"""Callback for the progress of long calls, called with (done, total, what)."""

PATIENCE = 2.0
"""Seconds before a progress bar appears by default."""


@contextmanager
def progress_bar(what: str, total: int | None, show: bool | None = None) -> Iterator[Callable[[int], None]]:
    """Show a progress bar with the remaining time on standard error. Yield a function to call with the number done.

    ``what`` names the items, such as ``images``; their total may be unknown. If ``show``, it is shown from the start,
    or without a terminal as one line at the end; if False, never; by default temporarily, on a terminal only, after
    :data:`PATIENCE` seconds.
    """
    if show is False or (show is None and not sys.stderr.isatty()):
        yield lambda done: None
        return
    begin, bars = perf_counter(), []

    def tell(done: int) -> None:
        if not bars and (show or perf_counter() - begin > PATIENCE):
            bars.append(_bar(what, total))
        for bar in bars:
            bar.update(bar.task_ids[0], completed=done)

    try:
        yield tell
    finally:
        for bar in bars:
            bar.stop()


def _bar(what: str, total: int | None) -> Any:
    # Slow to import.
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar

    console = Console(stderr=True)
    columns = BarColumn(), MofNCompleteColumn(), TextColumn("{task.description}, left:"), TimeRemainingColumn()
    bar = Bar(*columns, console=console, transient=console.is_terminal)
    bar.add_task(what, total=total)
    bar.start()
    return bar
