"""The command ``liaam measure``."""

import re
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer

from liaam.cli.inputs import CategoryOption, StrictOption
from liaam.cli.terminal import cell, complain, say, show_table, table_of
from liaam.errors import LiaamError
from liaam.io import write_columns
from liaam.io.atomic import check_output, write_text_atomically
from liaam.io.files import count_of, real_path, some_names
from liaam.io.landmarks.formats import KNOWN_FILES
from liaam.io.landmarks.reading import Reading
from liaam.morphometry.asymmetry import MATCHING
from liaam.morphometry.table import scales_in, sizes_in, unit_of_table
from liaam.scale.choice import TRAINING
from liaam.scale.lengths import UNITS, Length, unlike
from liaam.tables import Columns

if TYPE_CHECKING:
    from liaam.evaluation import ShapeAgreement
    from liaam.morphometry import AsymmetryResult, ShapeVariation, Specimen

FIGURES = (".png", ".pdf", ".svg")

ERRORS = "replicates.csv"
"""End of the name of the table of measurement error, which is beside the output."""

SHAPES = ("shapes.csv", "bias.csv", "agreement.json", "agreement.png")
"""Ends of the names of the files on the agreement with people's landmarks: by component and landmark, all, a figure."""

VARIATION = ("scores.csv", "groups.csv", "variation.json")
"""Ends of the names of the files on the variance of shape: by specimen, by group, and all of it."""

ASYMMETRY = "asymmetry.json"
"""End of the name of the file that holds all of the asymmetry."""

ASYMMETRY_TABLES = {
    "anova.csv": "analysis of variance",
    "asymmetry.csv": "asymmetry of {}",
    "components.csv": "symmetric, directional and fluctuating components of shape",
}
"""Ends of the names of its tables, and what these hold."""


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
            help="distance:1-5, angle:1-2-3 (at landmark 2), area:1-2-3-4 or length:1-2-3-4 (of the line through "
            "them), with landmarks counted from 1, or with "
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
            "in several files; 'code' if they are of specimens of one code; or the text before their numbers in names, "
            "such as _ for wing1_1 and wing1_2."
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
    side: Annotated[
        str,
        typer.Option(
            help="If specimens are of the left and right side (by a column 'side', folders left and right, or names "
            "such as wing1_left or wing1_L): auto reflects the left ones; left or right reflects those of the other "
            "side to this one; reflected: they were reflected before; ignore: these are no sides."
        ),
    ] = "auto",
    estimate: Annotated[
        str | None,
        typer.Option(
            help="Estimate missing landmarks from complete specimens: tps (thin-plate spline) or regression. The "
            "column 'estimated' lists them."
        ),
    ] = None,
    symmetry: Annotated[
        str | None,
        typer.Option(
            help="Analyse asymmetry: matching (of left and right structures), or object (of structures with landmarks "
            "on both sides). Prints the Procrustes analysis of variance, and writes tables and .json beside the output."
        ),
    ] = None,
    pairs: Annotated[
        str | None,
        typer.Option(
            help="Landmarks that are each other's mirror image, for --symmetry object: 1-2,3-4, or a .csv file with "
            "two in each row. By default by their names (left_eye, right_eye), or else from the studio's template."
        ),
    ] = None,
    scores: Annotated[
        bool,
        typer.Option(
            "--scores",
            help="Write scores of the principal components of shape with standard errors, and print how much of the "
            "variance of shape is of specimens, and how much of measuring.",
        ),
    ] = False,
    groups: Annotated[
        Path | None,
        typer.Option(
            help="Table .csv with the columns specimen (or image) and group: as --scores, and test the differences "
            "between the groups' mean shapes, which are written with standard errors."
        ),
    ] = None,
    compare: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="LABELS",
            help="Landmarks that a person has placed on the same specimens, a file or a folder: print whether those "
            "that are measured are good enough for statistics. Give a second person's with another --compare.",
        ),
    ] = None,
    permutations: Annotated[int, typer.Option(help="Random permutations for the tests of asymmetry and groups.")] = 999,
    seed: Annotated[int, typer.Option(help="Seed of the permutations.", min=0)] = 0,
    plot: Annotated[
        Path | None,
        typer.Option(
            help="Figure of all shapes, drawn over each other, and of their principal components, or with --symmetry "
            "of the asymmetry: .png, .pdf, .svg."
        ),
    ] = None,
    strict: StrictOption = False,
    category: CategoryOption = None,
) -> None:
    """Measure specimens: distances, angles, areas, centroid size and Procrustes coordinates, with standard errors."""
    from liaam import morphometry

    more = (*(SHAPES if compare else ()), *(VARIATION if scores or groups is not None else ()))
    _check_outputs(results, [*_tables(output, replicates, symmetry), *(_beside(output, end) for end in more)], plot)
    if pairs is not None and symmetry != morphometry.OBJECT:
        raise LiaamError("--pairs are the landmarks of both sides of one structure: give --symmetry object, too")
    reading = Reading(strict, category)
    specimens = morphometry.read_specimens(results, complain, reading, replicates is not None)
    specimens = specimens if resample is None else morphometry.with_even_curves(specimens, resample)
    specimens, left_out = morphometry.alike(specimens)
    _refuse_or_complain(left_out, "have other landmarks than most", strict)
    specimens, reflected = morphometry.of_one_side(specimens, side, replicates)
    if scale is not None and scale.lower().endswith(".csv"):
        specimens = morphometry.with_lengths(specimens, morphometry.read_lengths(scale))
        scale = None
    if estimate is not None:
        specimens, left = morphometry.with_estimated_landmarks(specimens, estimate, scale)
        _refuse_or_complain(left, "keep missing landmarks", strict)
    columns = morphometry.measure(specimens, measures or (), scale, slide)
    error = None if replicates is None else morphometry.measurement_error(specimens, columns, replicates, bool(slide))
    found = None
    if symmetry is not None:
        twins = _twins(pairs, results, specimens) if symmetry == morphometry.OBJECT else None
        options = {"pairs": twins, "by": replicates, "permutations": permutations, "seed": seed}
        found = morphometry.asymmetry(specimens, columns, symmetry, **options)
        _refuse_or_complain(found.left_out, "are not compared", strict)
    of_groups = None
    if groups is not None:
        of_groups = morphometry.groups_of([specimen.name for specimen in specimens], morphometry.read_groups(groups))
    variation = None
    if scores or of_groups is not None:
        variation = morphometry.shape_variation(specimens, columns, of_groups, permutations, seed)
    agreement = _agreement(specimens, compare, of_groups, reading) if compare else None
    write_columns(output, columns)
    what = "specimen" if replicates is None else "record"
    say(f"{output}: {count_of(len(specimens), what)}{_unit_said(columns)}")
    if scale is None or scale in UNITS:
        _say_sources(specimens)
    if reflected:
        say(reflected)
    if found is not None:
        _write_asymmetry(found, output)
    if variation is not None:
        _write_variation(variation, output)
    if agreement is not None:
        _write_agreement(agreement, output)
    if plot is not None:
        _draw(columns, found, specimens, plot)
    if error is not None:
        beside = _beside(output, ERRORS)
        write_columns(beside, error)
        _show(error)
        say(f"{beside}: measurement error")
        for line in morphometry.exchanged_landmarks(specimens, replicates or ""):
            complain(line)
    _complain_of_estimates(columns)
    _complain_of_gaps(columns)


def _beside(output: Path, end: str) -> Path:
    """Return the path of a further file beside the output, whose name begins alike."""
    return output.with_name(f"{output.stem}_{end}")


def _tables(output: Path, replicates: str | None, symmetry: str | None) -> list[Path]:
    """Return the paths of all files that are written besides the figure."""
    ends = []
    if replicates is not None:
        ends.append(ERRORS)
    if symmetry is not None:
        ends += [*ASYMMETRY_TABLES, ASYMMETRY]
    return [output, *(_beside(output, end) for end in ends)]


def _check_outputs(results: Path, tables: Sequence[Path], plot: Path | None) -> None:
    """Raise unless the tables and the figure can be written, and are no inputs."""
    for path in tables if plot is None else (*tables, plot):
        check_output(path)
        if real_path(path).is_relative_to(real_path(results)):
            raise LiaamError(f"{path} is the input, or a file in it; give the output a name elsewhere")
    if plot is not None and plot.suffix.lower() not in FIGURES:
        raise LiaamError(f"{plot}: figures are written as .png, .pdf or .svg; give a name that ends so")


def _refuse_or_complain(lines: Sequence[str], what: str, strict: bool) -> None:
    """Print what is wrong with some specimens or individuals, or raise if strict."""
    if lines and strict:
        raise LiaamError(f"{len(lines)} specimens {what}: {'; '.join(lines)}")
    for line in lines:
        complain(line)


def _twins(pairs: str | None, results: Path, specimens: "Sequence[Specimen]") -> str | tuple[int, ...] | None:
    """Return the pairs that are given, or those of the studio's template if names tell none."""
    from liaam.morphometry.pairs import twins_by_names
    from liaam.studio.template import saved_twins

    first = next((specimen for specimen in specimens if len(specimen.points)), None)
    if pairs is not None or first is None or twins_by_names(first.names) is not None:
        return pairs
    folder = results if results.is_dir() else results.parent
    return saved_twins(folder, first.names, len(first.points))


def _agreement(
    specimens: "Sequence[Specimen]", labels: Sequence[Path], groups: Sequence[str] | None, reading: Reading
) -> "ShapeAgreement":
    """Compare specimens with the landmarks that people have placed."""
    from liaam.evaluation import compare_specimens

    return compare_specimens(specimens, [_labels(path, reading) for path in labels], groups)


def _labels(path: Path, reading: Reading) -> "list[Specimen]":
    """Read the landmarks that a person has placed, without points that the studio proposed and nobody confirmed."""
    from liaam.morphometry import read_specimens
    from liaam.studio.origins import saved_proposals, without_proposals

    folder = path if path.is_dir() else path.parent
    proposals = {picture.rpartition(".")[0]: points for picture, points in saved_proposals(folder).items()}
    specimens = []
    changed = []
    for specimen in read_specimens(path, complain, reading):
        own, n_proposed = without_proposals(specimen.points, proposals.get(specimen.name))
        if n_proposed:
            changed.append(specimen.name)
        specimens.append(replace(specimen, points=own) if n_proposed else specimen)
    if changed:
        complain(
            f"{count_of(len(changed), 'specimen')} of {path} left out, because points were accepted as the studio "
            f"proposed them: {some_names(changed)}; move or confirm each point in the studio"
        )
    return specimens


def _write_agreement(agreement: "ShapeAgreement", output: Path) -> None:
    """Print the agreement with people's landmarks, and write it beside the output."""
    from liaam.plotting import save_figure

    shapes, bias, everything, figure = (_beside(output, end) for end in SHAPES)
    write_columns(shapes, agreement.by_component())
    write_columns(bias, agreement.by_landmark())
    write_text_atomically(everything, agreement.to_json())
    save_figure(agreement.plot(), figure)
    say(agreement.report())
    say(f"for the section Methods of a paper: {agreement.methods()}")
    say(f"{everything}: agreement with people's landmarks; also {shapes.name}, {bias.name} and {figure.name}")


def _write_variation(variation: "ShapeVariation", output: Path) -> None:
    """Print the variance of shape, and write scores and group means beside the output."""
    by_specimen, by_group, everything = (_beside(output, end) for end in VARIATION)
    say(variation.report())
    write_columns(by_specimen, variation.by_specimen())
    say(f"{by_specimen}: scores of principal components")
    if variation.means:
        write_columns(by_group, variation.by_group())
        say(f"{by_group}: mean shapes of {count_of(len(variation.means), 'group')}")
    write_text_atomically(everything, variation.to_json())


def _write_asymmetry(found: "AsymmetryResult", output: Path) -> None:
    """Print the analysis of variance, and write the tables of asymmetry beside the output."""
    anova = found.anova()
    _show_anova(anova)
    say(_about_error(found))
    tables = (anova, found.indices(), found.components())
    individuals = count_of(len(found.individuals), "individual")
    for (end, about), table in zip(ASYMMETRY_TABLES.items(), tables, strict=True):
        beside = _beside(output, end)
        write_columns(beside, table)
        say(f"{beside}: {about.format(individuals)}")
    beside = _beside(output, ASYMMETRY)
    write_text_atomically(beside, found.to_json())
    say(f"{beside}: all of it")


def _show_anova(anova: Columns) -> None:
    """Print the analyses of variance as geomorph does."""
    table = table_of("trait", "effect", "df", "SS", "MS", "R2", "F", "Z", "P")
    for row in (dict(zip(anova, values, strict=True)) for values in zip(*anova.values(), strict=True)):
        numbers = [
            "" if row[name] != row[name] else f"{row[name]:.4g}" for name in ("df", "SS", "MS", "R2", "F", "Z", "P")
        ]
        table.add_row(cell(row["trait"]), cell(row["effect"]), *numbers)
    show_table(table)


def _about_error(found: "AsymmetryResult") -> str:
    """Say what fluctuating asymmetry is compared with."""
    without = f", without {count_of(found.n_estimated, 'record')} with estimated landmarks" if found.n_estimated else ""
    if found.analysis.error == "replicates":
        what = "side" if found.analysis.kind == MATCHING else "individual"
        return f"error: from {found.replicates} replicates of each {what}{without}"
    if found.analysis.error == "covariances":
        return f"error: expected from the covariances of the fitted landmarks, as there are no replicates{without}"
    return (
        "error: unknown, so that fluctuating asymmetry is not tested, and includes it; digitise twice, and give "
        "--replicates"
    )


def _draw(columns: Columns, found: "AsymmetryResult | None", specimens: "Sequence[Specimen]", plot: Path) -> None:
    """Write the figure of the shapes, or of their asymmetry."""
    from liaam.plotting import save_figure
    from liaam.plotting.specimens import figure_of_asymmetry, figure_of_specimens

    if found is None:
        save_figure(figure_of_specimens(columns), plot)
        say(f"{plot}: shapes")
        return
    save_figure(figure_of_asymmetry(**found.drawing(specimens)), plot)
    say(f"{plot}: asymmetry")


def _show(error: Columns) -> None:
    """Print the measurement error: the measures, and the least repeatable landmarks."""
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


def _complain_of_estimates(columns: Columns) -> None:
    """Name the specimens with estimated landmarks."""
    cells = zip(columns["specimen"], columns.get("estimated", [""] * len(columns["specimen"])), strict=True)
    named = [name for name, estimated in cells if isinstance(estimated, str) and estimated]
    if named:
        complain(f"{count_of(len(named), 'specimen')} with estimated landmarks (see 'estimated'): {some_names(named)}")


def _unit_said(columns: Columns) -> str:
    """Say in which unit a table is."""
    unit = unit_of_table(columns)
    if unit:
        return f" in {unit}"
    if scales_in(columns) is None:
        return " in pixels (give --scale for other units)"
    return " (the scale has no unit: state it, as in --scale '0.012 mm', or --scale mm for that of the files)"


def _say_sources(specimens: "Sequence[Specimen]") -> None:
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
    first = next((name for name in columns if re.fullmatch(r"X\d+", name)), None)  # a scale bar is no part of the shape
    whole = [index for index, x in enumerate(sizes if first is None else columns[first]) if x == x]
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
