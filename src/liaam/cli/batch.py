"""The command ``liaam batch``: it reads options, runs, and prints what came out."""

import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from itertools import chain
from pathlib import Path
from typing import Annotated

import typer

from liaam.cli.inputs import RotationsOption
from liaam.cli.terminal import complain, progress_bar, say
from liaam.errors import LiaamError


def batch(
    model_file: Annotated[Path, typer.Argument(metavar="MODEL", help="Model file of 'liaam train'.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="Table to write: .parquet, .csv or .jsonl.")],
    pictures: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="PICTURES...",
            help="Folders, patterns in quotation marks such as 'images/**', files, or - for a list on standard input.",
        ),
    ] = None,
    listed: Annotated[Path | None, typer.Option("--list", help="File with the path of a picture in each line.")] = None,
    init: Annotated[
        str | None,
        typer.Option(
            help="Where to start: a box x0,y0,x1,y1 or x,y,size for all; a folder with a landmark or .box file for "
            "each picture; or 'beside' for such files beside the pictures. Searched for if left out."
        ),
    ] = None,
    method: Annotated[str, typer.Option("--method", "-m", help="How to compare; see 'liaam methods'.")] = "soft-li",
    rotations: RotationsOption = "upright",
    iterations: Annotated[int, typer.Option(help="Iterations at most, at each sharpness.", min=0)] = 50,
    camera_file: Annotated[
        Path | None,
        typer.Option("--camera", help="Camera file of the pictures' camera, if not the training camera's."),
    ] = None,
    response: Annotated[
        str | None, typer.Option(help="Response of the pictures' camera, if not the training camera's.")
    ] = None,
    covariance: Annotated[bool, typer.Option(help="Whether rows hold the covariance of each landmark.")] = True,
    jobs: Annotated[int | None, typer.Option(help="Worker processes; one per core if left out.", min=1)] = None,
    chunk: Annotated[
        int | None, typer.Option(help="Pictures that a worker does at a time; 16 if left out, or fewer.", min=1)
    ] = None,
    scheduler: Annotated[
        str | None, typer.Option(help="Address of a Dask scheduler, whose workers then do the work.")
    ] = None,
    restart: Annotated[
        bool, typer.Option("--restart", help="Begin anew where there are results of other settings.")
    ] = False,
) -> None:
    """Fit a model to any number of pictures, on all cores or a cluster; writes a table with a row for each.

    A batch that was stopped, by whatever, goes on where it was when the same command is given again.
    """
    from liaam.batch import Settings, run_batch
    from liaam.batch.run import in_words
    from liaam.batch.work import ERROR
    from liaam.photometry import load_camera

    camera = None if camera_file is None else load_camera(camera_file)
    settings = Settings(method, init, iterations, camera, response, covariance, rotations)
    closed: list[str] = []
    with ExitStack() as files, progress_bar() as tell:
        summary = run_batch(
            model_file,
            named_pictures(pictures or [], listed, files, closed.append),
            output,
            settings,
            jobs=jobs,
            chunk=chunk,
            scheduler=scheduler,
            restart=restart,
            progress=tell,
        )
    if not summary.fitted:
        say(f"{output} is complete; there is nothing to do")
    else:
        rate = summary.fitted / summary.seconds
        say(f"{output}: {_count(summary.fitted, 'picture')} done in {summary.seconds:.0f} s, {rate:.1f} a second")
    say(f"{_count(summary.total, 'row')}: {in_words(summary.statuses)}")
    for folder in sorted(set(closed)):
        complain(f"{folder} cannot be read, so it is passed over: check the rights")
    if errors := summary.statuses.get(ERROR, 0):
        complain(f"{_count(errors, 'picture')} could not be fitted; the column 'message' says why")
    if errors == summary.total:
        raise typer.Exit(1)


def named_pictures(
    sources: list[str], listed: Path | None, files: ExitStack, on_closed: Callable[[str], object]
) -> Iterator[str]:
    """Pictures of all arguments and lists, one after the other."""
    from liaam.batch import find_pictures, listed_pictures
    from liaam.io.files import existing_file

    if not sources and listed is None:
        raise LiaamError("no pictures: name a folder, a pattern such as 'images/**', files, or a --list")
    named = [
        listed_pictures(sys.stdin.buffer) if source == "-" else find_pictures(source, on_closed=on_closed)
        for source in sources
    ]
    if listed is not None:
        path = existing_file(listed, LiaamError, "list of pictures")
        named.append(listed_pictures(files.enter_context(path.open("rb"))))
    return chain(*named)


def _count(number: int, what: str) -> str:
    return f"{number} {what}" if number == 1 else f"{number} {what}s"
