"""The command ``liaam lamps``, and helpers for lamps that other commands share."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from liaam.cli.inputs import read_folder
from liaam.cli.terminal import progress_bar, say
from liaam.errors import LiaamError
from liaam.io.atomic import check_output

if TYPE_CHECKING:
    from liaam.photometry import Response
    from liaam.training import LearntLamps

LAMPS_SUFFIX = ".lamps"  # Suffix of lamp files

TrainingLampOption = Annotated[
    str | None,
    typer.Option("--training-lamp", help="Name of the training light in the names of the lamp images, such as 07."),
]


def lamps(
    folder: Annotated[
        Path,
        typer.Argument(
            metavar="FOLDER",
            help="Folder of landmarked images of a few objects, each under the training light and, without moving, "
            "under other lamps. Names give object and lamp: 037-07, 037-00, 037-03 ...",
        ),
    ],
    output: Annotated[Path, typer.Option("--output", "-o", help=f"File to write, such as faces{LAMPS_SUFFIX}.")],
    training_lamp: TrainingLampOption = None,
) -> None:
    """Learn the effect of lamps from a few objects, for 'liaam train --lamps'. The file stores no image.

    'liaam show -o' draws the effect of each lamp on plain grey, or on a landmarked image.
    """
    check_output(output)
    if output.suffix.lower() != LAMPS_SUFFIX:
        raise LiaamError(f"{output}: a lamp file ends in {LAMPS_SUFFIX}, such as {output.stem}{LAMPS_SUFFIX}")
    learnt = read_lamps(folder, training_lamp)
    learnt.save(output)
    say(f"{output}: {len(learnt)} lamps for objects with {len(learnt.mean)} landmarks")
    say(f"draw them with 'liaam show {output} -o lamps.png'")


def read_lamps(source: Path, training_lamp: str | None = None, response: "Response" = "srgb") -> "LearntLamps":
    """Load lamps from a file, or learn them from a folder."""
    from liaam.training import learn_lamps, load_lamps

    if source.is_file():
        return load_lamps(source)
    data = read_folder(source)
    with progress_bar() as progress:
        return learn_lamps(data, training_lamp, response=response, progress=progress)
