"""The command of the studio: thin. It serves a page on this machine."""

from pathlib import Path
from typing import Annotated

import typer

from liaam.cli.terminal import complain, say


def studio(
    folder: Annotated[
        Path, typer.Argument(help="Folder of pictures to annotate, train on and fit; landmarks are saved beside them.")
    ] = Path(),
    model: Annotated[
        Path | None,
        typer.Option("--model", help="Model to begin with, instead of what the studio trained in this folder before."),
    ] = None,
    host: Annotated[
        str, typer.Option(help="Address to listen on; others than the loopback let other machines in.")
    ] = "127.0.0.1",
    port: Annotated[
        int | None, typer.Option(help="Port to listen on; the first free one from 8765 if left out.")
    ] = None,
    browser: Annotated[bool, typer.Option("--browser/--no-browser", help="Open the page in the browser.")] = True,
) -> None:
    """Annotate, train, fit and relight in the browser.

    Serves a page on this machine only, and prints its address, which holds a secret token. Ctrl-C stops it.
    """
    from liaam.studio.serving import serve

    def tell(line: str) -> None:
        (complain if line.startswith("warning") else say)(line)

    serve(folder, model, host, port, browser, tell)
    say("stopped")
