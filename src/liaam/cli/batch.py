"""The command ``liaam batch``."""

import sys
from collections.abc import Callable, Iterator
from itertools import chain
from pathlib import Path
from typing import Annotated

import typer

from liaam.cli.inputs import (
    ALONE,
    AUTO,
    AbsentOption,
    CameraOption,
    NameByOption,
    RotationsOption,
    SideOption,
    camera_in,
    each_once,
    model_and_inputs,
    other_ways,
    say_again,
    say_if_no_model,
)
from liaam.cli.terminal import complain, progress_bar, say
from liaam.errors import LiaamError
from liaam.io.files import count_of

SEE_MESSAGES = "see the column 'message'"
ANOTHER_TABLE = ", into another table in the same folder: 'liaam measure FOLDER' takes the usable fits of both"

LANDMARKS_ONLY = ".tps"
"""Suffix of the output that has landmarks and no columns."""


def batch(
    sources: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[MODEL] IMAGE...",
            help="Model file of 'liaam train', or a name that 'liaam show' lists, by default 'face'; then folders, "
            "quoted patterns such as 'images/**', files, or - for a list of paths from standard input, one per line.",
        ),
    ] = None,
    *,
    output: Annotated[
        Path, typer.Option("--output", "-o", help="Table to write: .parquet, .csv or .jsonl. Only landmarks: .tps.")
    ],
    init: Annotated[
        str | None,
        typer.Option(
            help="Where to start: a box x0,y0,x1,y1 or x,y,size for all images; a folder with a landmark or .box file "
            "for each image; 'beside' for such files next to the images; or mediapipe. By default the object is "
            "searched for."
        ),
    ] = None,
    every: Annotated[
        bool, typer.Option("--all", help="Fit every object that the search finds in an image, with a row for each.")
    ] = False,
    name_by: NameByOption = "position",
    method: Annotated[str, typer.Option("--method", "-m", help="Fitting method; see 'liaam fit --help'.")] = "soft-li",
    rotations: RotationsOption = None,
    side: SideOption = AUTO,
    absent: AbsentOption = "empty",
    given_camera: CameraOption = None,
    jobs: Annotated[int | None, typer.Option(help="Number of threads. By default one per core.", min=1)] = None,
    scheduler: Annotated[
        str | None, typer.Option(help="Address of a Dask scheduler; its workers then fit the images.")
    ] = None,
    restart: Annotated[
        bool, typer.Option("--restart", help="Start over, and discard results of other settings.")
    ] = False,
) -> None:
    """Fit a model to many images, on all cores or a cluster, and write a table with one row per image.

    If a batch is interrupted, run the same command again to resume it.
    """
    from liaam.batch import Settings, run_batch
    from liaam.batch.run import in_words
    from liaam.batch.work import ERROR
    from liaam.fitting import FitStatus
    from liaam.fitting.result import USABLE
    from liaam.model import load_model

    camera, response = camera_in(given_camera)
    how = {"rotations": rotations, "side": side, "every": every, "name_by": name_by, "absent": absent}
    settings = Settings(method, init, camera=camera, response=response, **how)
    model_file, pictures = model_and_inputs(sources or [], "batch")
    closed: list[str] = []
    again: list[str] = []
    with progress_bar() as progress:
        summary = run_batch(
            model_file,
            input_paths(pictures, closed.append, again.append),
            output,
            settings,
            jobs=jobs,
            scheduler=scheduler,
            restart=restart,
            progress=progress,
        )
    if not summary.fitted:
        say(f"{output} is complete; nothing to do")
    else:
        rate = summary.fitted / summary.seconds
        say(f"{output}: {count_of(summary.fitted, 'image')} done in {summary.seconds:.0f} s, {rate:.1f} per second")
    n_rows = sum(summary.rows.values())
    of = f" of {count_of(summary.total, 'image')}" if n_rows != summary.total else ""
    is_tps = output.suffix.lower() == LANDMARKS_ONLY
    say(f"{count_of(n_rows, 'fit' if is_tps else 'row')}{of}: {in_words(summary.rows)}")
    if is_tps:
        n_written = sum(summary.rows.get(status, 0) for status in USABLE)
        say(f"{output}: landmarks of the {count_of(n_written, 'fit')} that may be used; messages are in tables (.csv)")
    say_again(again)
    for folder in sorted(set(closed)):
        complain(f"skipped {folder}: it cannot be read; check its permissions")
    errors = summary.statuses.get(ERROR, 0)
    if errors:
        for fault in summary.faults:
            complain(fault)
        complain(f"{count_of(errors, 'image')} could not be fitted{'' if is_tps else f'; {SEE_MESSAGES}'}")
    if summary.absent:
        what = "estimates" if absent == "estimate" else "empty"
        see = "" if is_tps else f": {SEE_MESSAGES}"
        say(f"{count_of(summary.absent, 'fit')} with absent landmarks, which are {what}{see}")
    if is_tps and len(summary.sides) > 1:
        complain(_about_sides(output, summary.sides))
    # A fit to another object, or to one that is turned, may also not converge.
    if uncertain := sum(summary.rows.get(status, 0) for status in (FitStatus.DOUBTFUL, FitStatus.MAX_ITERATIONS)):
        which = "they are not written" if is_tps else "check those, by the column 'status'"
        advice = f"fits that may be wrong: {uncertain}; {which}"
        ways = "" if init else other_ways(load_model(model_file), side, rotations, f"{ALONE}{ANOTHER_TABLE}")
        complain("; ".join(filter(None, (advice, ways))))
        say_if_no_model(sources or [], "batch")
    if errors == summary.total:
        raise typer.Exit(1)


def _about_sides(output: Path, sides: dict[str, int]) -> str:
    """Say that a file of landmarks has no sides, and what this means for statistics."""
    counts = " and ".join(f"{n} {side}" for side, n in sides.items())
    return (
        f"{output}: {counts} ones are as they lie in the images, and .tps has no sides: the shapes of one side are "
        "mirrored against the other. 'liaam measure' reflects them; for other programs, reflect one side first, by the "
        "column 'side' of a table (-o fits.csv)"
    )


def input_paths(
    sources: list[str], on_closed: Callable[[str], object], on_again: Callable[[str], object]
) -> Iterator[str]:
    """Iterate over the image paths of all arguments, each once."""
    from liaam.batch import find_pictures, listed_pictures

    if not sources:
        raise LiaamError("no images: give a folder, a pattern such as 'images/**', files, or - for a list of paths")
    paths = chain.from_iterable(
        listed_pictures(sys.stdin.buffer) if source == "-" else find_pictures(source, on_closed=on_closed)
        for source in sources
    )
    return paths if len(sources) == 1 else each_once(paths, on_again)  # a folder or list may be too long to remember
