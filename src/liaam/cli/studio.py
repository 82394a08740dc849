"""The command ``liaam studio``."""

from pathlib import Path
from typing import Annotated

import typer

from liaam.cli.terminal import complain, say


def studio(
    folder: Annotated[
        Path,
        typer.Argument(
            metavar="FOLDER", help="Folder of images to annotate, train on and fit. Landmarks are saved beside them."
        ),
    ] = Path(),
    model: Annotated[
        Path | None,
        typer.Option("--model", help="Model to start with. By default the model last trained in this folder."),
    ] = None,
    host: Annotated[
        str, typer.Option(help="Address to listen on. Other addresses give other machines access.")
    ] = "127.0.0.1",
    port: Annotated[
        int | None, typer.Option(help="Port to listen on. By default the first free port from 8765.")
    ] = None,
    face: Annotated[
        bool,
        typer.Option(
            "--face/--no-face",
            help="Propose the points of the face model that comes with liaam, if no others are there.",
        ),
    ] = True,
    browser: Annotated[bool, typer.Option("--browser/--no-browser", help="Open the page in the browser.")] = True,
) -> None:
    """Annotate, train, fit and relight in the browser.

    Serves a page on this machine only and prints its address, which holds a secret token. Stop it with Ctrl-C.
    """
    from liaam.studio.serving import serve

    def print_line(line: str) -> None:
        (complain if line.startswith("warning") else say)(line)

    serve(folder, model, host, port, browser, print_line, face)
    say("stopped")
