"""The command ``liaam check``: landmarks that were labelled by another rule than in the other pictures."""

from collections import defaultdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from liaam.cli.inputs import ImagesOption, LandmarkedFolder, RecursiveOption, read_folder
from liaam.cli.terminal import cell, complain, console, progress_bar, say, table_of
from liaam.errors import LiaamError
from liaam.progress import Progress

if TYPE_CHECKING:
    from liaam.datasets import Dataset, Sample
    from liaam.datasets.label_faults import LabelFault
    from liaam.io import Landmarks

TOLD = 3
"""Faults that training tells before it refers to ``liaam check``."""


def check(
    folder: LandmarkedFolder,
    images: ImagesOption = None,
    recursive: RecursiveOption = False,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", "-o", help="Folder for a picture of each fault, and landmarks in the order of the others."
        ),
    ] = None,
) -> None:
    """Look for landmarks that were exchanged, run backwards, or lie far off, beside the other pictures.

    Nothing in the folder is changed. Ends with status 1 where something is found.
    """
    data = read_folder(folder, images, recursive)
    whole = without_missing(data)
    if len(whole) < len(data):
        complain(f"not looked at, since landmarks are missing: {len(data) - len(whole)} of {len(data)}")
    with progress_bar() as tell:
        faults = faults_by_sample(whole, tell)
    if not faults:
        say("no faults found, of those that single pictures have")
        return
    table = table_of("image", "landmarks")
    for sample, own in faults:
        for fault in own:
            table.add_row(cell(sample.name), cell(fault.message))
    console.print(table)
    if output is not None:
        write_faults(output, folder, faults)
    raise typer.Exit(1)


def without_missing(data: "Dataset") -> "list[Sample]":
    """Samples all of whose landmarks are there."""
    return [sample for sample in data if not sample.landmarks.missing.any()]


def faults_by_sample(samples: "list[Sample]", tell: Progress) -> "list[tuple[Sample, list[LabelFault]]]":
    """Samples with faults, and theirs; none may have missing landmarks."""
    from liaam.datasets.label_faults import find_label_faults

    found: dict[int, list[LabelFault]] = defaultdict(list)
    for fault in find_label_faults([sample.landmarks.points for sample in samples], tell):
        found[fault.picture].append(fault)
    return [(samples[i], own) for i, own in found.items()]


def write_faults(output: Path, folder: Path, faults: "list[tuple[Sample, list[LabelFault]]]") -> None:
    """Write a picture of each sample with faults, and its landmarks in the order of the others."""
    from liaam.io import make_folder, write_image
    from liaam.plotting import overlay_of_faults

    if output.resolve().is_relative_to(folder.resolve()):
        raise LiaamError(f"{output} is in the folder that is checked; give another with -o: nothing in it is changed")
    mended = 0
    for sample, own in faults:
        place = output / sample.name
        make_folder(place.parent)
        for fault in own:
            if fault.is_order:
                write_mended(place, fault.mended_landmarks(sample.landmarks))
                mended += 1
        try:
            picture = overlay_of_faults(sample.read_image(), sample.landmarks.points, own)
        except LiaamError as error:  # the landmarks are what counts
            complain(str(error))
            continue
        write_image(place.with_name(f"{place.name}_faults.png"), picture)
    said = f"; {mended} with landmarks in the other order, to take over where you agree" if mended else ""
    say(f"written to {output}: pictures of what was found{said}")


def write_mended(place: Path, landmarks: "Landmarks") -> None:
    """Write landmarks to a place without ending, in a format that holds all of them, and never over others."""
    from liaam.io import write_landmarks

    ending = ".ljson" if landmarks.contours or landmarks.names or landmarks.invisible else ".pts"
    file = place.with_name(f"{place.name}{ending}")
    if file.exists():
        raise LiaamError(f"{file} is there already and is not written over; give an empty folder with -o")
    write_landmarks(file, landmarks)


def warn_of_faults(data: "Dataset", folder: Path) -> None:
    """Tell of landmarks in another order than those of the other pictures, before a model learns it."""
    from liaam.datasets.label_faults import LEAST_PICTURES

    whole = without_missing(data)
    if len(whole) < LEAST_PICTURES:
        return
    with progress_bar() as tell:
        faults = faults_by_sample(whole, tell)
    told = [(sample, fault) for sample, own in faults for fault in own if fault.is_order]
    for sample, fault in told[:TOLD]:
        complain(f"{sample.name}: {fault.message}")
    if told:
        more = f"and {len(told) - TOLD} more; " if len(told) > TOLD else ""
        complain(f"{more}the model learns them so; 'liaam check' on {folder} shows them and the other order")
