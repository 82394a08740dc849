"""The command ``liaam check``: landmarks that were labelled by another rule than in the other pictures."""

from collections import defaultdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.markup import escape

from liaam.errors import LiaamError
from liaam.terminal import Progress, complain, console, progress_bar, say, stoppable_progress, table_of

if TYPE_CHECKING:
    from liaam.datasets import Dataset, Sample
    from liaam.label_faults import LabelFault

TOLD = 3
"""Faults that training tells before it refers to ``liaam check``."""


def check(
    folder: Annotated[Path, typer.Argument(help="Folder of images with landmarks beside them.")],
    images: Annotated[
        list[str] | None,
        typer.Option("--images", help="Only images whose name matches, such as '07-[12346]*'; may be repeated."),
    ] = None,
    recursive: Annotated[bool, typer.Option("--recursive", help="Look into sub-folders too.")] = False,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            help="Folder for a picture of each fault, and landmarks in the order of the others (.pts).",
        ),
    ] = None,
) -> None:
    """Look for landmarks that were exchanged, run backwards, or lie far off, beside the other pictures.

    Nothing in the folder is changed. Ends with status 1 where something is found.
    """
    from liaam.datasets import load_folder

    data = load_folder(folder, recursive=recursive)
    data = data.select(images) if images else data
    say(data.report())
    missing = sum(bool(sample.landmarks.missing.any()) for sample in data)
    if missing:
        complain(f"not looked at, since landmarks are missing: {missing} of {len(data)}")
    with stoppable_progress() as tell:
        faults = faults_by_sample(data, tell)
    if not faults:
        say("no faults found, of those that single pictures have")
        return
    table = table_of("image", "landmarks")
    for sample, own in faults:
        for fault in own:
            table.add_row(escape(sample.name), fault.message)
    console.print(table)
    if output is not None:
        write_faults(output, folder, faults)
    raise typer.Exit(1)


def faults_by_sample(data: "Dataset", tell: Progress | None = None) -> "list[tuple[Sample, list[LabelFault]]]":
    """Samples with faults; those with missing landmarks are not looked at."""
    from liaam.label_faults import find_label_faults

    whole = [sample for sample in data if not sample.landmarks.missing.any()]
    found: dict[int, list[LabelFault]] = defaultdict(list)
    for fault in find_label_faults([sample.landmarks.points for sample in whole], tell):
        found[fault.picture].append(fault)
    return [(whole[i], own) for i, own in sorted(found.items())]


def write_faults(output: Path, folder: Path, faults: "list[tuple[Sample, list[LabelFault]]]") -> None:
    """Write a picture of each sample with faults, and its landmarks in the order of the others."""
    from liaam.io import make_folder, write_image, write_landmarks
    from liaam.plotting import overlay_of_faults

    if output.resolve().is_relative_to(folder.resolve()):
        raise LiaamError(f"{output} is in the folder that is checked; give another with -o: nothing in it is changed")
    make_folder(output)
    mended = 0
    for sample, own in faults:
        place = output / sample.name
        make_folder(place.parent)
        for fault in own:
            if fault.is_order:
                landmarks = fault.mended_landmarks(sample.landmarks)
                told = landmarks.contours or landmarks.names or landmarks.invisible  # what .pts cannot hold
                file = place.with_name(f"{place.name}{'.ljson' if told else '.pts'}")
                if file.exists():
                    raise LiaamError(f"{file} is there already and is not written over; give an empty folder with -o")
                write_landmarks(file, landmarks)
                mended += 1
        try:
            picture = overlay_of_faults(sample.read_image(), sample.landmarks.points, own)
        except LiaamError as error:  # the landmarks are what counts
            complain(str(error))
            continue
        write_image(place.with_name(f"{place.name}_faults.png"), picture)
    said = f"; {mended} with landmarks in the other order, to take over where you agree" if mended else ""
    say(f"written to {output}: pictures of what was found{said}")


def warn_of_faults(data: "Dataset", folder: Path) -> None:
    """Tell of landmarks in another order than those of the other pictures, before a model learns it."""
    from liaam.label_faults import LEAST_PICTURES

    if sum(not sample.landmarks.missing.any() for sample in data) < LEAST_PICTURES:
        return
    with progress_bar() as tell:
        faults = faults_by_sample(data, tell)
    told = [(sample, fault) for sample, own in faults for fault in own if fault.is_order]
    for sample, fault in told[:TOLD]:
        complain(f"{sample.name}: {fault.message}")
    if told:
        more = f"and {len(told) - TOLD} more; " if len(told) > TOLD else ""
        complain(f"{more}the model learns them so; 'liaam check' on {folder} shows them and the other order")
