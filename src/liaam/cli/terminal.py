"""What commands print with: plain lines, complaints, tables and a progress bar."""

import io
import os
import sys
import unicodedata
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table
from typer.core import TyperGroup

from liaam.errors import LiaamError
from liaam.progress import Progress

console = Console()
complaints = Console(stderr=True)

INTERRUPTED = 130
"""Exit status after a Ctrl-C, as of a shell: 128 and the signal's number."""

TURNING = ("LRE", "RLE", "LRO", "RLO", "PDF", "LRI", "RLI", "FSI", "PDI")
"""Classes of the characters that turn the direction of writing (Unicode Standard Annex 9)."""


def plain(text: str) -> str:
    """Text without what a terminal obeys: a file's name or a model's may hold anything.

    Control characters, those that turn the direction of writing, and halves of characters are shown as escapes.
    """
    return "".join(ascii(letter)[1:-1] if _is_obeyed(letter) else letter for letter in text)


def _is_obeyed(letter: str) -> bool:
    if unicodedata.category(letter) in ("Cc", "Cs", "Zl", "Zp"):
        return letter not in "\n\t"
    return unicodedata.bidirectional(letter) in TURNING


def cell(text: str) -> str:
    """Text for a table, as it is: brackets are no markup."""
    return escape(plain(text))


class _Commands(TyperGroup):
    """Commands; what a person typed is repeated in complaints without what a terminal obeys.

    A Ctrl-C becomes one line and exit status 130.
    """

    def make_context(self, *arguments: Any, **options: Any) -> Any:
        """Read the arguments of the program."""
        with _plain_complaints():
            return super().make_context(*arguments, **options)

    def invoke(self, ctx: Any) -> Any:
        """Read the arguments of a command, and run it."""
        try:
            with _plain_complaints():
                return super().invoke(ctx)
        except KeyboardInterrupt as stop:
            complain(str(stop) or "stopped")
            raise typer.Exit(INTERRUPTED) from None


@contextmanager
def _plain_complaints() -> Iterator[None]:
    try:
        yield
    except Exception as error:
        if isinstance(message := getattr(error, "message", None), str):  # of click, which typer may bring along
            error.__dict__["message"] = plain(message)
        raise


def make_app(**options: Any) -> typer.Typer:
    """Make a command line with subcommands, as all of ours are; further ``options`` go to typer."""
    return typer.Typer(
        cls=_Commands,
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
    except OSError as error:  # a name that no file can have, missing rights, a disk that is full or gone
        complain(f"error: {_sentence_of(error)}")
        sys.exit(1)


def _sentence_of(error: OSError) -> str:
    """Say what the system has refused, and of which file."""
    name = "" if error.filename is None else os.fsdecode(error.filename)
    shown = f"{name[:60]}...: " if len(name) > 255 else f"{name}: " if name else ""
    return f"{shown}{error.strerror or error}; check the name, the rights and the free space"


def say(text: str) -> None:
    """Print plain text (no markup: file names hold brackets)."""
    console.print(plain(text), markup=False, highlight=False, soft_wrap=True)


def complain(text: str) -> None:
    """Print to standard error."""
    complaints.print(plain(text), markup=False, highlight=False, soft_wrap=True)


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
            bar.update(task, completed=done, total=total, description=plain(what))

        yield tell
