"""Terminal output of the commands: lines, tables, progress bars, and errors."""

import io
import os
import sys
import unicodedata
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any, NoReturn

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table
from typer.core import TyperGroup

from liaam.errors import LiaamError
from liaam.progress import Progress, progress_bar as library_bar

console = Console()
error_console = Console(stderr=True)

MISUSED = 2
"""Exit status after an unknown option or a value of the wrong type, as of other programs."""

INTERRUPTED = 130
"""Exit status after Ctrl-C, as in a shell: 128 and the number of the signal."""

UNCUT = 500
"""Width in characters of tables that do not go to a terminal: more than any table of a command has."""

CONTROL = ("Cc", "Cs", "Zl", "Zp")
"""Unicode's categories of control characters, surrogates, and separators of lines and of paragraphs."""

BIDIRECTIONAL = ("LRE", "RLE", "LRO", "RLO", "PDF", "LRI", "RLI", "FSI", "PDI")
"""Bidirectional classes of the characters that change the writing direction (Unicode Standard Annex 9)."""

LONGEST_NAME = 255
"""Number of characters above which a name is cut in messages; file systems allow no more in a name."""

MOST_WORDS = 20
"""Number of arguments that are looked at for a name with blanks that was given without quotes."""


def plain(text: str) -> str:
    """Escape control characters, which the names of files and models may hold.

    Also escapes characters that change the writing direction, and lone surrogates.
    """
    return "".join(ascii(letter)[1:-1] if _is_hidden(letter) else letter for letter in text)


def _is_hidden(letter: str) -> bool:
    """Return whether a character does something else than to be shown, other than a line break or a tab."""
    is_control = unicodedata.category(letter) in CONTROL and letter not in "\n\t"
    return is_control or unicodedata.bidirectional(letter) in BIDIRECTIONAL


def cell(text: str) -> str:
    """Return the text of a table cell, in which brackets are not markup."""
    return escape(plain(text))


class StoppedError(Exception):
    """A command was stopped by Ctrl-C. Its text is printed, and the exit status is :data:`INTERRUPTED`."""


class _Commands(TyperGroup):
    """Command group whose error messages repeat arguments without control characters."""

    def make_context(self, *arguments: Any, **options: Any) -> Any:
        """Read the arguments of the program."""
        with _plain_complaints():
            return super().make_context(*arguments, **options)

    def invoke(self, ctx: Any) -> Any:
        """Read the arguments of a command, and run it."""
        with _plain_complaints(), warnings_as_lines():
            return super().invoke(ctx)


@contextmanager
def _plain_complaints() -> Iterator[None]:
    """Print the error of a misused option or argument as one line, and exit; raise StoppedError on Ctrl-C."""
    try:
        yield
    except KeyboardInterrupt as stop:
        raise StoppedError(str(stop) or "stopped") from None
    except Exception as error:
        # Errors of misuse are known by their exit status: their class is one of click, which may be the one in typer.
        if getattr(error, "exit_code", None) != MISUSED:
            raise
        text = error.format_message()  # type: ignore
        if not text or "\n" in text:  # a command without arguments prints its help
            raise
        context = getattr(error, "ctx", None)
        command = "liaam" if context is None else context.command_path
        see = f"see '{command} --help'"
        if "extra argument" in text and (path := _unquoted_path(sys.argv[1:])):
            see = f"put quotes around a name with blanks: '{path}'"
        complain(f"error: {text} {see.capitalize()}" if text.endswith("?") else f"error: {text.rstrip('.')}; {see}")
        raise SystemExit(MISUSED) from None


def _unquoted_path(arguments: Sequence[str]) -> str:
    """Return an existing path with blanks that successive arguments are parts of, or nothing."""
    first = arguments[:MOST_WORDS]
    runs = (" ".join(first[i:j]) for i in range(len(first)) for j in range(i + 2, len(first) + 1))
    return next((run for run in runs if os.path.exists(run)), "")  # noqa: PTH110 (takes names of any length)


def make_app(**options: Any) -> typer.Typer:
    """Make a command line with subcommands. Pass `options` to typer."""
    return typer.Typer(
        cls=_Commands,
        no_args_is_help=True,
        add_completion=False,
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["-h", "--help"]},
        **options,
    )


def run_app(app: typer.Typer) -> None:
    """Run a command line. Print an error or a stop as one line and exit with a non-zero status."""
    for stream in (sys.stdout, sys.stderr):  # print ? where the terminal cannot show × or θ
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")
    try:
        app()
    except StoppedError as stop:
        _exit_stopped(str(stop))
    except SystemExit as end:  # typer ends like this, without a word, on a Ctrl-C between its steps
        if end.code == INTERRUPTED:
            _exit_stopped("stopped")
        raise
    except LiaamError as error:
        complain(f"error: {error}")
        sys.exit(1)
    except OSError as error:  # an invalid name, missing permissions, a full or removed disk
        remedy = "check the name, the permissions and the free space"
        complain(f"error: {_name_in(error)}{error.strerror or error}; {remedy}")
        sys.exit(1)


def _name_in(error: OSError) -> str:
    """Return the name of the file that an error is about and a colon; nothing if it names none."""
    if not error.filename:
        return ""
    name = os.fsdecode(error.filename)
    return f"{name[:60]}...: " if len(name) > LONGEST_NAME else f"{name}: "


def _exit_stopped(text: str) -> NoReturn:
    """Print why a command stopped, and exit."""
    # Not through the console: if it was interrupted while it printed, it keeps what follows to itself.
    print(plain(text), file=sys.stderr)
    sys.exit(INTERRUPTED)


def say(text: str) -> None:
    """Print a line of plain text, without markup, since file names may hold brackets."""
    console.print(plain(text), markup=False, highlight=False, soft_wrap=True)


def complain(text: str) -> None:
    """Print a line of plain text to standard error."""
    error_console.print(plain(text), markup=False, highlight=False, soft_wrap=True)


def show_table(table: Table) -> None:
    """Print a table; in full width if the output goes to a file or another program, which would not see what is cut."""
    if console.is_terminal:
        console.print(table)
    else:
        Console(width=UNCUT).print(table)


@contextmanager
def warnings_as_lines() -> Iterator[None]:
    """Print warnings for users as lines on standard error, without the line of code that gives them."""
    with warnings.catch_warnings():
        show = warnings.showwarning

        def show_as_line(message: Warning | str, category: type[Warning], *where: Any, **options: Any) -> None:
            if issubclass(category, UserWarning):
                complain(str(message))
            else:
                show(message, category, *where, **options)

        warnings.showwarning = show_as_line
        yield


def table_of(*header: str) -> Table:
    """Make an empty table in the style of all commands."""
    return Table(*header, box=None, header_style="bold")


@contextmanager
def progress_bar(counted: bool = True) -> Iterator[Progress]:
    """Show a temporary progress bar with the remaining time, on terminals only.

    Show counts if `counted`, or else a percentage.
    """
    with library_bar("", None, error_console.is_terminal, counted) as tell:

        def tell_plainly(done: int, total: int, what: str) -> None:
            tell(done, total, plain(what))

        yield tell_plainly
