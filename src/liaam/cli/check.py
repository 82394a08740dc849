"""The command ``liaam check``: find images whose landmarks follow another convention than the rest."""

from collections import defaultdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer

from liaam.cli import inputs
from liaam.cli.terminal import cell, complain, progress_bar, say, show_table, table_of
from liaam.datasets import Dataset, Sample
from liaam.errors import LiaamError
from liaam.io import is_raw, make_folder, write_image, write_landmarks
from liaam.io.files import count_of, real_path
from liaam.io.landmarks.reading import Reading

if TYPE_CHECKING:
    from liaam.datasets.label_faults import LabelFault

MAX_WARNINGS = 3  # Faults that liaam train prints before it refers to liaam check


def check(
    folder: inputs.LandmarkedFolder,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", "-o", help="Folder for an image of each fault, and for landmarks in the corrected order."
        ),
    ] = None,
    shapes: inputs.ShapesOption = inputs.AUTO,
    strict: inputs.StrictOption = False,
    category: inputs.CategoryOption = None,
    y_down: inputs.YDownOption = False,
    stored_orientation: inputs.StoredOption = False,
) -> None:
    """Find landmarks that are exchanged, in reverse order, mirrored, upside down, or misplaced.

    Also names grey images among colour images, damaged images, landmarks outside of their image, and files that do not
    match. Changes nothing in the folder. The exit status is 1 if faults are found.
    """
    from liaam.datasets.point_outliers import LEAST_POINTS

    data = inputs.read_folder(folder, Reading(strict, category, y_down, stored_orientation))
    unusable = check_pixels(data)
    complete = [sample for sample in data if not sample.landmarks.missing.any()]
    if len(complete) < len(data):
        complain(f"skipped {len(data) - len(complete)} of {len(data)} images with missing landmarks")
    faults = faults_by_sample(complete, inputs.parse_shapes(shapes))
    if not faults:
        say(f"no {'other ' if unusable else ''}faults found in the landmarks of single images")
        n_landmarks = len(data.samples[0].landmarks.points)
        if n_landmarks < LEAST_POINTS:
            say(
                f"misplaced and mirrored landmarks were not looked for: {LEAST_POINTS} landmarks are needed, and each "
                f"image has {n_landmarks}"
            )
        if unusable:
            raise typer.Exit(1)
        return
    table = table_of("image", "landmarks")
    for sample, faults_of_sample in faults:
        for fault in faults_of_sample:
            table.add_row(cell(sample.name), cell(fault.message))
    show_table(table)
    if output is not None:
        write_faults(output, folder, faults)
    raise typer.Exit(1)


def check_pixels(data: Dataset) -> bool:
    """Name images that are damaged or do not contain their landmarks, and grey images among colour images.

    Return whether any cannot be used.
    """
    from liaam.datasets.units import units_fault
    from liaam.photometry import is_grey
    from liaam.photometry.encoding import as_colour, refuse_unscaled
    from liaam.training.images import describe_outside, grey_use
    from liaam.workers import in_threads

    def look(sample: Sample) -> bool | str:
        try:
            image = as_colour(sample.read_image(), sample.name)
            raw = isinstance(sample.image, Path) and is_raw(sample.image)
            refuse_unscaled(image, sample.name, "linear" if raw else "srgb")
        except LiaamError as error:
            return str(error)
        placed = sample.landmarks.points[~sample.landmarks.missing]
        outside = describe_outside(placed, image.shape) if len(placed) else ""
        if outside:
            return f"{sample.name}: {outside}: they belong to another image, or to one of another size"
        return is_grey(image)

    verdicts = in_threads(look, data.samples)
    unusable = [each for each in verdicts if isinstance(each, str)]
    units = units_fault(data.samples)
    if units:
        unusable = [units]
    for fault in unusable:
        complain(fault)
    grey, colour = (
        [sample.name for sample, each in zip(data, verdicts, strict=True) if each is g] for g in (True, False)
    )
    if grey and colour:
        say(grey_use(grey, colour))
    return bool(unusable)


def faults_by_sample(samples: list[Sample], shapes: int | str = inputs.AUTO) -> "list[tuple[Sample, list[LabelFault]]]":
    """Return each sample that has faults, with its faults. No sample may have missing landmarks.

    Samples of different kinds of shape are compared with their own kind, and one line says so.
    """
    from liaam.datasets.label_faults import find_label_faults
    from liaam.training.shapes import shape_groups

    marks = np.array([sample.landmarks.points for sample in samples])
    groups = shape_groups(marks, [sample.name for sample in samples], shapes) if len(marks) else []
    if len(groups) > 1:
        sizes = ", ".join(count_of(len(group), "image") for group in groups)
        say(
            f"{len(groups)} kinds of shape ({sizes}), each checked by itself; 'liaam check --shapes 1' compares all, "
            "and shows images that were mirrored by mistake"
        )
    by_sample: dict[int, list[LabelFault]] = defaultdict(list)
    with progress_bar() as progress:
        for group in groups:
            for fault in find_label_faults(list(marks[group]), progress):
                by_sample[int(group[fault.picture])].append(fault)
    return [(samples[i], faults_of_sample) for i, faults_of_sample in sorted(by_sample.items())]


def write_faults(output: Path, folder: Path, faults: "list[tuple[Sample, list[LabelFault]]]") -> None:
    """Write an overlay of each sample with faults, and its landmarks in the corrected order."""
    from liaam.plotting import overlay_of_faults

    if real_path(output).is_relative_to(real_path(inputs.folder_of(folder)[0])):
        raise LiaamError(f"{output} is inside the folder to check, which is never changed; give another folder with -o")
    reordered = 0
    for sample, faults_of_sample in faults:
        place = output / sample.name
        make_folder(place.parent)
        for fault in faults_of_sample:
            if fault.is_order:
                marks = fault.corrected_landmarks(sample.landmarks)
                ending = ".ljson" if marks.contours or marks.names or marks.invisible else ".pts"
                file = place.with_name(f"{place.name}{ending}")
                if file.exists():
                    raise LiaamError(f"{file} already exists and is not overwritten; give an empty folder with -o")
                write_landmarks(file, marks)
                reordered += 1
        try:
            picture = overlay_of_faults(sample.read_image(), sample.landmarks.points, faults_of_sample)
        except LiaamError as error:  # the landmarks are written without the overlay
            complain(str(error))
            continue
        write_image(place.with_name(f"{place.name}_faults.png"), picture)
    said = f", and {count_of(reordered, 'landmark file')} in the corrected order to review" if reordered else ""
    say(f"written to {output}: an image of each fault{said}")


def warn_of_faults(data: Dataset, folder: Path, shapes: int | str = inputs.AUTO) -> None:
    """Warn, before training, about landmarks in another order than in the other images, or far off."""
    from liaam.datasets.label_faults import LEAST_PICTURES
    from liaam.datasets.units import units_fault

    if units := units_fault(data.samples):
        complain(units)
    complete = [sample for sample in data if not sample.landmarks.missing.any()]
    if len(complete) < LEAST_PICTURES:
        return
    pairs = [(sample, fault) for sample, faults in faults_by_sample(complete, shapes) for fault in faults]
    for sample, fault in pairs[:MAX_WARNINGS]:
        complain(f"{sample.name}: {fault.message}")
    if pairs:
        more = f"and {len(pairs) - MAX_WARNINGS} more; " if len(pairs) > MAX_WARNINGS else ""
        complain(f"{more}training does not correct them; run 'liaam check {folder}' to see and fix them")
