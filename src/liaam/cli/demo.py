"""The command ``liaam demo``."""

from pathlib import Path
from typing import Annotated

import typer

from liaam.cli.terminal import progress_bar, say, show_table, table_of


def demo(
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder for the figure.")] = Path("liaam-demo"),
) -> None:
    """Train on simulated portraits under one light and fit four methods under another light."""
    from liaam.demo import run_demo

    with progress_bar() as progress:
        rows, start_error = run_demo(output, progress)
    table = table_of("method", "error (px)", "status", "theta")
    table.add_row("start", f"{start_error:.2f}", "", "")
    for row in rows:
        angle = row.result.theta_degrees
        table.add_row(row.method, f"{row.error:.2f}", str(row.result.status), f"{angle:.1f}°" if angle else "–")
    show_table(table)
    say(f"written to {output / 'figure.png'}")
