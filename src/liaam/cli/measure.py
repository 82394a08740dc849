"""The command ``liaam measure``."""

from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from liaam.cli.inputs import CategoryOption, StrictOption
from liaam.cli.terminal import cell, complain, say, show_table, table_of
from liaam.errors import LiaamError
from liaam.io import write_columns
from liaam.io.atomic import check_output
from liaam.io.files import count_of, real_path, some_names
from liaam.io.landmarks.formats import KNOWN_FILES
from liaam.io.landmarks.reading import Reading
from liaam.morphometry.specimens import Specimen
from liaam.morphometry.table import scales_in, sizes_in, unit_of_table
from liaam.scale.choice import TRAINING
from liaam.scale.lengths import UNITS, Length, unlike
from liaam.tables import Columns


def measure(
    results: Annotated[
        Path,
        typer.Argument(
            metavar="RESULTS",
            help=f"Folder of 'liaam fit', table of 'liaam batch', or landmarks, a file or a folder: {KNOWN_FILES}.",
        ),
    ],
    output: Annotated[Path, typer.Option("--output", "-o", help="Table to write: .csv.")],
    measures: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="MEASURE...",
            help="distance:1-5, angle:1-2-3 (at landmark 2) or area:1-2-3-4, with landmarks counted from 1, or with "
            "their names.",
        ),
    ] = None,
    scale: Annotated[
        str | None,
        typer.Option(
            help="Length of a pixel, such as '0.0031 mm'; the landmarks at the ends of a scale bar and its length, "
            "such as '11-12=5 mm'; a table of 'liaam scale'; or mm alone, the unit of the SCALE in .tps files. By "
            "default the scale that files and the tags of TIFF images state, or else results are in pixels."
        ),
    ] = None,
    replicates: Annotated[
        str | None,
        typer.Option(
            help="Print and write the measurement error of replicates: 'image' if they are records of one image, also "
            "in several files, or the text before their numbers in names, such as _ for wing1_1 and wing1_2."
        ),
    ] = None,
    resample: Annotated[
        str | None,
        typer.Option(
            help="Points to place evenly along each curve (CURVES of .tps), both ends included: 20, or 20,12 for two."
        ),
    ] = None,
    slide: Annotated[
        str | None,
        typer.Option(
            help="Slide the points of curves between their ends: bending (to the least bending energy), or procrustes "
            "(to the least Procrustes distance)."
        ),
    ] = None,
    plot: Annotated[
        Path | None,
        typer.Option(help="Figure of all shapes on each other and of their principal components: .png, .pdf, .svg."),
    ] = None,
    strict: StrictOption = False,
    category: CategoryOption = None,
) -> None:
    """Measure specimens: distances, angles, areas, centroid size and Procrustes coordinates, with standard errors."""
    from liaam import morphometry

    for path in (output,) if plot is None else (output, plot):
        check_output(path)
        if real_path(path).is_relative_to(real_path(results)):
            raise LiaamError(f"{path} is the input, or a file in it; give a name elsewhere")
    if plot is not None and plot.suffix.lower() not in (".png", ".pdf", ".svg"):
        raise LiaamError(f"{plot}: figures are written as .png, .pdf or .svg; give a name that ends so")
    reading = Reading(strict, category)
    specimens = morphometry.read_specimens(results, complain, reading, replicates is not None)
    specimens = specimens if resample is None else morphometry.with_even_curves(specimens, resample)
    specimens, left_out = morphometry.alike(specimens)
    if left_out and strict:
        raise LiaamError(f"{len(left_out)} specimens have other landmarks than most: {'; '.join(left_out)}")
    for line in left_out:
        complain(line)
    if scale is not None and scale.lower().endswith(".csv"):
        specimens = morphometry.with_lengths(specimens, morphometry.read_lengths(scale))
        scale = None
    columns = morphometry.measure(specimens, measures or (), scale, slide)
    error = None if replicates is None else morphometry.measurement_error(specimens, columns, replicates, bool(slide))
    write_columns(output, columns)
    say(f"{output}: {count_of(len(specimens), 'specimen')}{_unit_said(columns)}")
    if scale is None or scale in UNITS:
        _say_sources(specimens)
    if plot is not None:
        from liaam.plotting import save_figure
        from liaam.plotting.specimens import figure_of_specimens

        save_figure(figure_of_specimens(columns), plot)
        say(f"{plot}: shapes")
    if error is not None:
        beside = output.with_name(f"{output.stem}_replicates.csv")
        write_columns(beside, error)
        _show(error)
        say(f"{beside}: measurement error")
        for line in morphometry.exchanged_landmarks(specimens, replicates or ""):
            complain(line)
    _complain_of_gaps(columns)


def _show(error: Columns) -> None:
    """Print the measurement error: the measures, and the landmarks that repeat worst."""
    rows = [dict(zip(error, values, strict=True)) for values in zip(*error.values(), strict=True)]
    table = table_of("measure", "specimens", "replicates", "df", "F", "P", "repeatability", "sd", "sd %")
    for row in rows:
        numbers = [f"{row[name]:.3g}" for name in ("F", "P", "repeatability", "sd", "sd_percent")]
        counts = [f"{row['specimens']:g}", f"{row['replicates']:g}", f"{row['df_among']:g}, {row['df_within']:g}"]
        if row["df_within"] == row["df_within"]:
            table.add_row(cell(row["measure"]), *counts, *numbers)
    show_table(table)
    landmarks = (row for row in rows if row["df_within"] != row["df_within"] and row["sd"] == row["sd"])
    worst = sorted(landmarks, key=lambda row: -row["sd"])[:5]
    some = (f"{row['measure']} (sd {row['sd']:.3g} px, {row['sd_percent']:.2g} %)" for row in worst)
    say(f"least repeatable, in % of centroid size: {', '.join(some) or 'none has replicates'}")


def _unit_said(columns: Columns) -> str:
    """Say in which unit a table is."""
    unit = unit_of_table(columns)
    if unit:
        return f" in {unit}"
    if scales_in(columns) is None:
        return " in pixels (give --scale for other units)"
    return " (the scale has no unit: state it, as in --scale '0.012 mm', or --scale mm for that of the files)"


def _say_sources(specimens: Sequence[Specimen]) -> None:
    """Say where scales are from that nobody gave for these specimens."""
    sources: dict[str, list[Specimen]] = defaultdict(list)
    for specimen in specimens:
        if specimen.scale is not None and specimen.scale_source:
            sources[specimen.scale_source].append(specimen)
    for source, of_source in sources.items():
        first = Length(of_source[0].scale or 1.0, of_source[0].unit)
        doubt = "; give --scale if the images to measure were taken otherwise" if source == TRAINING else ""
        say(f"the scale of {count_of(len(of_source), 'specimen')} is that of {source} ({first} per pixel){doubt}")


def _complain_of_gaps(columns: Columns) -> None:
    """Name specimens without a scale among others, those of an unlike one, and those without a shape."""
    names = columns["specimen"]
    sizes = sizes_in(columns)
    scales = scales_in(columns)
    unit = unit_of_table(columns)
    whole = [index for index, x in enumerate(columns.get("X1", sizes)) if x == x]
    unused = [name for index, name in enumerate(names) if index not in set(whole)]
    bare = [names[index] for index in whole if scales is not None and scales[index] != scales[index]]
    have = f"of {len(names)} have no"
    if bare:
        what = "no sizes" if unit else "sizes in pixels"
        complain(f"{len(bare)} {have} scale, so that they have {what}: {some_names(bare)}")
    if scales is not None:
        middle = float(np.nanmedian(scales))
        odd = [f"{names[i]} ({scales[i]:.4g})" for i in np.flatnonzero(unlike(scales)).tolist()]
        if odd:
            usual = f"the usual {middle:.4g}{f' {unit}' if unit else ''} per pixel"
            complain(f"{len(odd)} of {len(names)} have a scale unlike {usual}; check it: {some_names(odd)}")
    if unused:
        why = "because landmarks are missing or the fit is not to be used (see 'status')"
        complain(f"{len(unused)} {have} shape, {why}: {some_names(unused)}")
