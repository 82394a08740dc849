"""The command ``liaam lamps``, and what other commands do with lamps."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from liaam.cli.inputs import RecursiveOption, check_output, read_folder
from liaam.cli.terminal import progress_bar, say
from liaam.errors import LiaamError

if TYPE_CHECKING:
    from liaam.datasets import Sample
    from liaam.lamps import Lamps
    from liaam.photometry import Response

LAMPS_SUFFIX = ".lamps"
"""Of files of lamps."""

TrainingLampOption = Annotated[
    str | None,
    typer.Option(
        "--training-lamp",
        help="Which lamp, of those in the pictures' names, is the light of the pictures to train on, such as 07.",
    ),
]


def lamps(
    folder: Annotated[
        Path,
        typer.Argument(
            help="Folder of landmarked images of a few objects, each in the light of training and under other lamps "
            "without having moved, named by object and lamp: 037-07, 037-00, 037-03 ..."
        ),
    ],
    output: Annotated[Path, typer.Option("--output", "-o", help=f"File to write, such as faces{LAMPS_SUFFIX}.")],
    training_lamp: TrainingLampOption = None,
    recursive: RecursiveOption = False,
) -> None:
    """Learn what lamps do from a few objects, for 'liaam train --lamps' on other folders; no picture is kept.

    What each does to plain grey is drawn beside the file; 'liaam show' draws it on any landmarked picture.
    """
    check_output(output)
    if output.suffix.lower() != LAMPS_SUFFIX:
        raise LiaamError(f"{output}: a file of lamps ends in {LAMPS_SUFFIX}, such as {output.stem}{LAMPS_SUFFIX}")
    learnt = read_lamps(folder, training_lamp, recursive)
    learnt.save(output)
    say(f"{output}: {len(learnt)} lamps for objects with {len(learnt.mean)} landmarks")
    picture = output.with_suffix(".png")
    draw_lamps(learnt, picture)
    say(f"written to {picture}")


def read_lamps(
    source: Path, training_lamp: str | None = None, recursive: bool = False, response: "Response" = "srgb"
) -> "Lamps":
    """Lamps of a file, or learnt from a folder."""
    from liaam.lamps import learn_lamps, load_lamps

    if not source.is_dir():
        return load_lamps(source)
    data = read_folder(source, None, recursive)
    with progress_bar() as tell:
        return learn_lamps(data, training_lamp, response=response, progress=tell)


def draw_lamps(lamps: "Lamps", path: Path, picture: "Sample | None" = None) -> None:
    """Write a picture of a sample under lamps, or of plain grey."""
    from liaam.plotting import figure_of_lamps, save_figure

    shown = () if picture is None else (picture.read_image(), picture.landmarks.points)
    save_figure(figure_of_lamps(lamps, *shown), path)
