"""The command ``liaam demo``."""

from pathlib import Path
from typing import Annotated

import typer

from liaam.cli.terminal import progress_bar, say, show_table, table_of


def demo(
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder for the figure.")] = Path("liaam-demo"),
) -> None:
    """Train on generated heads under soft light and fit them under hard light with four methods."""
    from liaam.demo import run_demo

    with progress_bar() as progress:
        rows, start_errors = run_demo(output, progress)
    table = table_of("method", "mean error (px)", "largest")
    for name, errors in (("start", start_errors), *((row.method, row.errors) for row in rows)):
        table.add_row(name, f"{errors.mean():.1f}", f"{errors.max():.1f}")
    show_table(table)
    say(f"written to {output / 'figure.png'}")
