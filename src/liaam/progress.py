"""Progress reports of long calls."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from time import perf_counter
from typing import Any

Progress = Callable[[int, int, str], None]
"""Callback for the progress of long calls, called with (done, total, what)."""

PATIENCE = 2.0  # Seconds before a progress bar appears by default


@contextmanager
def reported(what: str, progress: Progress | bool | None) -> Iterator[Progress]:
    """Yield the callback of a long call: the one given, or one that shows a progress bar as :func:`progress_bar`."""
    if callable(progress):
        yield progress
        return
    with progress_bar(what, None, progress, counted=False) as tell:
        yield lambda done, total, _: tell(done, total)


@contextmanager
def progress_bar(
    what: str, total: int | None, show: bool | None = None, counted: bool = True
) -> Iterator[Callable[..., None]]:
    """Show a progress bar with the remaining time on standard error. Yield a function to call with the number done.

    ``what`` names the items, such as ``images``; their total may be unknown. Both may be given later. Items are
    ``counted``, or else a percentage is shown. If ``show``, it is shown from the start, or without a terminal as
    one line at the end; if False, never; by default temporarily, on a terminal only, after :data:`PATIENCE` seconds.
    """
    if show is False or (show is None and not sys.stderr.isatty()):
        yield lambda *_: None
        return
    begin = perf_counter()
    bars = []

    def tell(done: int, total: int | None = total, what: str = what) -> None:
        if not bars and (show or perf_counter() - begin > PATIENCE):
            bars.append(_bar(what, total, counted))
        for bar in bars:
            bar.update(bar.task_ids[0], completed=done, total=total, description=what)

    try:
        yield tell
    finally:
        for bar in bars:
            bar.stop()


def _bar(what: str, total: int | None, counted: bool) -> Any:
    from rich import progress as parts  # slow to import
    from rich.console import Console

    console = Console(stderr=True)
    text = parts.TextColumn
    done = parts.MofNCompleteColumn() if counted else parts.TaskProgressColumn()
    times = parts.TimeElapsedColumn(), text("left:"), parts.TimeRemainingColumn()
    columns = parts.BarColumn(), done, text("{task.description}", markup=False), *times
    bar = parts.Progress(*columns, console=console, transient=console.is_terminal)
    bar.add_task(what, total=total)
    bar.start()
    return bar
