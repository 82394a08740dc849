"""The command line ``liaam`` with all its commands."""

from typing import Annotated

import typer

from liaam import __version__
from liaam.cli.batch import batch
from liaam.cli.camera import group as camera
from liaam.cli.check import check
from liaam.cli.demo import demo
from liaam.cli.evaluate import evaluate
from liaam.cli.fit import FitCommand, fit
from liaam.cli.invariant import invariant, register
from liaam.cli.lamps import lamps
from liaam.cli.measure import measure
from liaam.cli.models import card, show
from liaam.cli.relight import relight
from liaam.cli.scale import scale
from liaam.cli.studio import studio
from liaam.cli.terminal import make_app, run_app, say
from liaam.cli.train import compact, train
from liaam.cli.video import track

app = make_app(help="Fit deformable models of faces and other objects to colour images under any light.")
for command in (
    train,
    evaluate,
    batch,
    measure,
    scale,
    track,
    relight,
    studio,
    check,
    lamps,
    show,
    card,
    compact,
    demo,
):
    app.command()(command)
app.command(cls=FitCommand)(fit)
for command in (invariant, register):
    camera.command()(command)
app.add_typer(camera, name="camera")


def version(show: bool) -> None:
    """Print the version and exit."""
    if show:
        say(f"liaam {__version__}")
        raise typer.Exit


@app.callback()
def root(
    _version: Annotated[
        bool, typer.Option("--version", callback=version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    """Fit deformable models of faces and other objects to colour images under any light."""


def main() -> None:
    """Run the command line. Print an error as one line and exit with a non-zero status."""
    run_app(app)
