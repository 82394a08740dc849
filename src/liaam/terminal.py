"""What commands print with: plain lines, complaints, tables and a progress bar."""

import io
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import typer
from rich.console import Console
from rich.table import Table

from liaam.errors import LiaamError

console = Console()
complaints = Console(stderr=True)

Progress = Callable[[int, int, str], None]


def make_app(**options) -> typer.Typer:
    """Make a command line with subcommands, as all of ours are; further ``options`` go to typer."""
    return typer.Typer(
        no_args_is_help=True,
        add_completion=False,
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["-h", "--help"]},
        **options,
    )


def run_app(app: typer.Typer) -> None:
    """Run a command line; errors become one line and an exit status."""
    for stream in (sys.stdout, sys.stderr):  # a terminal without × or θ gets a ? instead of a traceback
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")
    try:
        app()
    except LiaamError as error:
        complain(f"error: {error}")
        sys.exit(1)


def say(text: str) -> None:
    """Print plain text (no markup: file names hold brackets)."""
    console.print(text, markup=False, highlight=False, soft_wrap=True)


def complain(text: str) -> None:
    """Print to standard error."""
    complaints.print(text, markup=False, highlight=False, soft_wrap=True)


def table_of(*header: str) -> Table:
    """Give an empty table in the style of all commands."""
    return Table(*header, box=None, header_style="bold")


@contextmanager
def progress_bar(counted: bool = True) -> Iterator[Progress]:
    """Show a bar, with the time that remains; it appears on terminals only and leaves nothing behind.

    Steps that are not things to be counted are told as a share.
    """
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar

    columns = (
        BarColumn(),
        MofNCompleteColumn() if counted else TextColumn("{task.percentage:>3.0f} %"),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
        TextColumn("{task.description}", markup=False),
    )
    with Bar(*columns, console=complaints, transient=True, disable=not complaints.is_terminal) as bar:
        task = bar.add_task("")

        def tell(done: int, total: int, what: str) -> None:
            bar.update(task, completed=done, total=total, description=what)

        yield tell


@contextmanager
def stoppable_progress(counted: bool = True) -> Iterator[Progress]:
    """Show a progress bar; a Ctrl-C becomes one line and exit status 130."""
    try:
        with progress_bar(counted) as tell:
            yield tell
    except KeyboardInterrupt as stop:
        complain(str(stop) or "stopped")
        raise typer.Exit(130) from None
