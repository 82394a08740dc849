"""The command ``liaam check``: find images whose landmarks follow another convention than the rest."""

from collections import defaultdict
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer

from liaam.cli import inputs
from liaam.cli.terminal import cell, complain, progress_bar, say, show_table, table_of
from liaam.datasets import Dataset, Sample
from liaam.errors import LiaamError
from liaam.io import is_raw, make_folder, write_image, write_landmarks
from liaam.io.files import count_of, real_path, some_names
from liaam.io.landmarks.reading import Reading

if TYPE_CHECKING:
    from liaam.datasets.label_faults import LabelFault
    from liaam.datasets.sides import SidesOfShapes

SOME = 4  # Images that are drawn with their landmarks, whether they have faults or not
MAX_WARNINGS = 3  # Faults that liaam train prints before it refers to liaam check


def check(
    folder: inputs.LandmarkedFolder,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            help="Folder for an image of each fault, for landmarks in the corrected order, and for a few images with "
            "their landmarks.",
        ),
    ] = None,
    sides: inputs.SidesOption = inputs.AUTO,
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

    if output is not None:
        check_output_folder(output, folder)
    data = inputs.read_folder(folder, Reading(strict, category, y_down, stored_orientation))
    unusable = check_pixels(data)
    samples = with_enough_landmarks(list(data))
    found = compared_sides(samples, sides)
    faults = faults_among(samples, found.is_other, inputs.parse_shapes(shapes))
    if found.against:
        complain("correct the sides that are stated: the column 'side', the folders or the names")
    if output is not None:
        write_some(output, samples)
    if not faults:
        say(f"no {'other ' if unusable or found.against else ''}faults found in the landmarks")
        n_landmarks = len(data.samples[0].landmarks.points)
        if n_landmarks < LEAST_POINTS:
            say(
                f"misplaced and mirrored landmarks were not looked for: {LEAST_POINTS} landmarks are needed, and each "
                f"image has {n_landmarks}"
            )
        if unusable or found.against:
            raise typer.Exit(1)
        return
    table = table_of("image", "fault")
    for sample, faults_of_sample in faults:
        for fault in faults_of_sample:
            table.add_row(cell(sample.name), cell(fault.message))
    show_table(table)
    if output is not None:
        write_faults(output, faults)
    raise typer.Exit(1)


def check_pixels(data: Dataset) -> bool:
    """Name images that are damaged or do not contain their landmarks, and grey images among colour images.

    Return whether any cannot be used.
    """
    from liaam.datasets.copies import copies_fault
    from liaam.datasets.units import units_fault
    from liaam.photometry import is_grey
    from liaam.photometry.encoding import as_colour, refuse_unscaled
    from liaam.training.images import count_outside, describe_cut_off, describe_outside, grey_use
    from liaam.workers import in_threads

    outside_of: dict[str, tuple[int, int]] = {}

    def look(sample: Sample) -> bool | str:
        try:
            image = as_colour(sample.read_image(), sample.name)
            raw = isinstance(sample.image, Path) and is_raw(sample.image)
            refuse_unscaled(image, sample.name, "linear" if raw else "srgb")
        except LiaamError as error:
            return str(error)
        if not sample.landmarks.missing.all():
            outside = describe_outside(sample.landmarks.points, image.shape)
            if outside:
                return f"{sample.name}: {outside}: they belong to another image, or to one of another size"
            outside_of[sample.name] = count_outside(sample.landmarks.points, image.shape)
        return is_grey(image)

    verdicts = in_threads(look, data.samples)
    unusable = [each for each in verdicts if isinstance(each, str)]
    units = units_fault(data.samples)
    if units:
        unusable = [units]
    if copies := copies_fault(data.samples):
        unusable.append(copies)
    for fault in unusable:
        complain(fault)
    if cut_off := describe_cut_off({sample.name: outside_of.get(sample.name, (0, 0)) for sample in data}):
        complain(cut_off)
    grey, colour = (
        [sample.name for sample, each in zip(data, verdicts, strict=True) if each is g] for g in (True, False)
    )
    if grey and colour:
        say(grey_use(grey, colour))
    return bool(unusable)


def faults_by_sample(
    samples: list[Sample], shapes: int | str = inputs.AUTO, sides: str = inputs.AUTO
) -> "list[tuple[Sample, list[LabelFault]]]":
    """Return each sample that has faults, with its faults, and say whose side is not as stated."""
    return faults_among(samples, compared_sides(samples, sides).is_other, shapes)


def faults_among(
    samples: list[Sample], is_other: np.ndarray, shapes: int | str
) -> "list[tuple[Sample, list[LabelFault]]]":
    """Return each sample that has faults, with its faults.

    Objects of the other side are compared reflected, missing landmarks are estimated from the other images, and samples
    of different kinds of shape are compared with their own kind. Lines say so.
    """
    from liaam.datasets.label_faults import find_label_faults
    from liaam.datasets.sides import reflected_shapes
    from liaam.training.shapes import shape_groups

    if not samples:
        return []
    marks = reflected_shapes(np.array([sample.landmarks.points for sample in samples]), is_other)
    known = ~np.isnan(marks[..., 0])
    marks = with_estimates(marks, samples)
    groups = shape_groups(marks, [sample.name for sample in samples], shapes)
    if len(groups) > 1:
        sizes = ", ".join(count_of(len(group), "image") for group in groups)
        say(f"{len(groups)} kinds of shape ({sizes}), each checked by itself; 'liaam check --shapes 1' compares all")
    by_sample: dict[int, list[LabelFault]] = defaultdict(list)
    with progress_bar() as progress:
        for group in groups:
            for fault in find_label_faults(list(marks[group]), progress):
                i = int(group[fault.picture])
                if fault.kind != "stray" or known[i][list(fault.points)].any():  # not of an estimate
                    by_sample[i].append(as_in_image(fault) if is_other[i] else fault)
    return [(samples[i], faults_of_sample) for i, faults_of_sample in sorted(by_sample.items())]


def with_enough_landmarks(samples: list[Sample]) -> list[Sample]:
    """Return the samples whose missing landmarks can be estimated, and name the others."""
    from liaam.training.filling import FEWEST_KNOWN

    enough = [sample for sample in samples if can_be_completed(sample)]
    poor = [sample.name for sample in samples if not can_be_completed(sample)]
    if poor:
        complain(f"skipped {count_of(len(poor), 'image')} with fewer than {FEWEST_KNOWN} landmarks: {some_names(poor)}")
    return enough


def can_be_completed(sample: Sample) -> bool:
    """Return whether a sample has enough landmarks to estimate the others."""
    from liaam.training.filling import FEWEST_KNOWN

    return bool((~sample.landmarks.missing).sum() >= FEWEST_KNOWN)


def compared_sides(samples: list[Sample], sides: str) -> "SidesOfShapes":
    """Return which samples are compared reflected, and say how many, and whose side is not as stated."""
    from liaam.datasets.sides import SidesOfShapes, sides_for_check

    if sides == "one" or not samples:
        return SidesOfShapes(np.zeros(len(samples), bool))
    stated = [sample.side for sample in samples]
    marks = np.array([sample.landmarks.points for sample in samples])
    found = sides_for_check(marks, stated, [sample.name for sample in samples])
    if found.said:
        complain(found.said)
    if found.sides is not None and found.sides.n_other:
        which = some_names([samples[i].name for i in np.flatnonzero(found.is_other).tolist()])
        count = f"{found.sides.n_other} of {count_of(len(samples), 'image')}"
        say(f"side {found.sides.other}: {count}, whose landmarks are compared reflected: {which}")
    return found


def with_estimates(marks: np.ndarray, samples: list[Sample]) -> np.ndarray:
    """Return landmarks (m, n, 2) with estimates for missing ones (NaN), and say how many images lack some."""
    from liaam.training.filling import filled, is_enough
    from liaam.training.incomplete import check_known
    from liaam.training.objects import folds_of

    known = ~np.isnan(marks[..., 0])
    if known.all():
        return marks
    names = [sample.name for sample in samples]
    if not is_enough(known):
        check_known(names, known, samples[0].landmarks.names)
    n_incomplete = int((~known.all(axis=1)).sum())
    say(f"{count_of(n_incomplete, 'image')} with missing landmarks, which are estimated to compare the others")
    with progress_bar(counted=False) as progress:
        return filled(marks, folds_of(names), progress)[0]


def as_in_image(fault: "LabelFault") -> "LabelFault":
    """Return a fault that was found in landmarks with x reversed."""
    return replace(fault, expected=fault.expected * [-1.0, 1.0])


def check_output_folder(output: Path, folder: Path) -> None:
    """Raise if the faults of a folder cannot be written to an output, before they are looked for."""
    if output.is_file():
        raise LiaamError(f"{output} is a file; give a folder with -o")
    if real_path(output).is_relative_to(real_path(inputs.folder_of(folder)[0])):
        raise LiaamError(f"{output} is inside the folder to check, which is never changed; give another folder with -o")


def write_some(output: Path, samples: list[Sample]) -> None:
    """Write some of the images, at even distances, with their numbered landmarks: all may have the same fault."""
    from liaam.plotting import overlay_of_faults

    shown = [samples[i] for i in np.unique(np.linspace(0, len(samples) - 1, SOME).astype(int))] if samples else []
    n_written = 0
    for sample in shown:
        try:
            picture = overlay_of_faults(sample.read_image(), sample.landmarks.points, [])
        except LiaamError:  # said before
            continue
        place = output / f"{sample.name}_landmarks.png"
        make_folder(place.parent)
        write_image(place, picture)
        n_written += 1
    if n_written:
        say(f"written to {output}: {count_of(n_written, 'image')} with the landmarks, which should be upright")


def write_faults(output: Path, faults: "list[tuple[Sample, list[LabelFault]]]") -> None:
    """Write an overlay of each sample with faults, and its landmarks in the corrected order."""
    from liaam.plotting import overlay_of_faults

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


def warn_of_faults(data: Dataset, folder: Path, shapes: int | str = inputs.AUTO, sides: str = inputs.AUTO) -> None:
    """Warn, before training, about landmarks in another order than in the other images, or far off.

    Finds the same faults as ``liaam check``. Training itself names the images with too few landmarks.
    """
    from liaam.datasets.copies import copies_fault
    from liaam.datasets.label_faults import LEAST_PICTURES
    from liaam.datasets.units import units_fault

    if copies := copies_fault(data.samples):
        complain(copies)
    if units := units_fault(data.samples):
        complain(units)
    samples = [sample for sample in data if can_be_completed(sample)]
    if len(samples) < LEAST_PICTURES:
        return
    found = [(sample, fault) for sample, faults in faults_by_sample(samples, shapes, sides) for fault in faults]
    # Training reflects images that are mirrored.
    pairs = [(sample, fault) for sample, fault in found if fault.kind != "mirrored" or sides == "one"]
    for sample, fault in pairs[:MAX_WARNINGS]:
        complain(f"{sample.name}: {fault.message}")
    if pairs:
        more = f"and {len(pairs) - MAX_WARNINGS} more; " if len(pairs) > MAX_WARNINGS else ""
        complain(f"{more}training does not correct them; run 'liaam check {folder}' to see and fix them")
