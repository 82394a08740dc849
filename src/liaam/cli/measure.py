"""The command ``liaam measure``."""

import math
import re
from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from liaam.cli.inputs import CategoryOption, StrictOption
from liaam.cli.terminal import cell, complain, say, show_table, table_of
from liaam.errors import LiaamError
from liaam.fitting.result import USABLE
from liaam.io import write_columns
from liaam.io.atomic import check_output, write_text_atomically
from liaam.io.files import count_of, real_path, some_names
from liaam.io.landmarks.formats import KNOWN_FILES
from liaam.io.landmarks.reading import Reading
from liaam.morphometry.asymmetry import MATCHING
from liaam.morphometry.measures import ScaleBar, parse_scale
from liaam.morphometry.replicates import BY_COVARIANCES
from liaam.morphometry.sides import IGNORED
from liaam.morphometry.symmetry import ERROR, INTERACTION
from liaam.morphometry.table import scales_in, sizes_in, unit_of_table
from liaam.scale.choice import TRAINING
from liaam.scale.lengths import UNITS, Length, unlike
from liaam.tables import Columns

if TYPE_CHECKING:
    from liaam.evaluation import ShapeAgreement
    from liaam.morphometry import AsymmetryResult, ShapeVariation, Specimen, SpecimenTable

FIGURES = (".png", ".pdf", ".svg")

# Ends of the names of the files that are written beside the output, whose name begins alike

ERRORS_TABLE = "replicates.csv"
"""Measurement error."""

AGREEMENT_BY_COMPONENT = "shapes.csv"
AGREEMENT_BY_LANDMARK = "bias.csv"
AGREEMENT_JSON = "agreement.json"
AGREEMENT_FIGURE = "agreement.png"
AGREEMENT_FILES = (AGREEMENT_BY_COMPONENT, AGREEMENT_BY_LANDMARK, AGREEMENT_JSON, AGREEMENT_FIGURE)
"""Agreement with people's landmarks."""

VARIATION_BY_SPECIMEN = "scores.csv"
VARIATION_BY_GROUP = "groups.csv"
VARIATION_JSON = "variation.json"
VARIATION_FILES = (VARIATION_BY_SPECIMEN, VARIATION_BY_GROUP, VARIATION_JSON)
"""Variance of shape."""

ANOVA_TABLE = "anova.csv"
ASYMMETRY_BY_INDIVIDUAL = "asymmetry.csv"
ASYMMETRY_BY_COMPONENT = "components.csv"
ASYMMETRY_JSON = "asymmetry.json"
ASYMMETRY_FILES = (ANOVA_TABLE, ASYMMETRY_BY_INDIVIDUAL, ASYMMETRY_BY_COMPONENT, ASYMMETRY_JSON)
"""Asymmetry."""

LEAST_REPEATABLE = 5
"""Number of landmarks with the largest measurement errors to name."""

_PLACE_TWICE = (
    "place the landmarks of some individuals by hand, twice on both sides, and analyse these with --replicates; a "
    "second photograph is no cure, as its fit has nearly the same error"
)

MOST_FAR = 5
"""Largest number of specimens with doubtful estimates to name."""


def measure(
    results: Annotated[
        Path,
        typer.Argument(
            metavar="RESULTS",
            help=f"Folder of 'liaam fit', table of 'liaam batch', or landmarks, a file or a folder: {KNOWN_FILES}. "
            "'folder/**' also reads subfolders, and the folder alone those named left and right if it holds no others.",
        ),
    ],
    output: Annotated[Path, typer.Option("--output", "-o", help="Table to write: .csv.")],
    measures: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="MEASURE...",
            help="distance:1-5, angle:1-2-3 (at landmark 2), area:1-2-3-4 or length:1-2-3-4 (of the line through "
            "them), with landmarks counted from 1, or with "
            "their names. A name of the measure may come first: 'wing length=distance:1-5'.",
        ),
    ] = None,
    scales: Annotated[
        list[str] | None,
        typer.Option(
            "--scale",
            help="Length of a pixel, such as '0.0031 mm'; the landmarks at the ends of a scale bar and its length, "
            "such as '11-12=5 mm'; a table of 'liaam scale' or your own, with the columns image, scale and unit, "
            "or several, each after a --scale; or mm alone, the unit of the SCALE in .tps files. By "
            "default the scale that files and the tags of TIFF images state, or else results are in pixels.",
        ),
    ] = None,
    replicates: Annotated[
        str | None,
        typer.Option(
            help="Print and write the measurement error of replicates: 'image' if they are records of one image, also "
            "in several files; 'code' if they are of specimens of one code; 'individual' if a table states the "
            "individual; or the text before their numbers in names, "
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
            "side to this one; reflected: they were reflected before; ignore: these are no sides. Those whose "
            "shape contradicts their side are named."
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
    table: Annotated[
        Path | None,
        typer.Option(
            "--specimens",
            help="Your own table .csv with a row for each image: a column image (or photo, file, specimen), and any of "
            "individual, side and others, such as sex for --groups.",
        ),
    ] = None,
    groups: Annotated[
        str | None,
        typer.Option(
            help="Table .csv with the columns specimen (or image, photo, file) and group (which may have another name "
            "if there is no further column), or a column of --specimens such as sex: as --scores, and test the "
            "differences between the groups' mean shapes, which are written with standard errors. Individuals are "
            "compared, not their records."
        ),
    ] = None,
    compare: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="LABELS",
            help="Landmarks that a person has placed on the same specimens, a file or a folder: print whether those "
            "that are measured are good enough for statistics. Give a second person's with another --compare. "
            "The model must not be trained on their images: with those, the agreement is far too good.",
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

    wants_variation = scores or groups is not None
    ends = [
        *((ERRORS_TABLE,) if replicates is not None else ()),
        *(ASYMMETRY_FILES if symmetry is not None else ()),
        *(AGREEMENT_FILES if compare else ()),
        *(VARIATION_FILES if wants_variation else ()),
    ]
    given = [results, *(compare or ())]
    scale = scales[0] if scales and len(scales) == 1 else None
    tables = [text for text in scales or () if text.lower().endswith(".csv")]
    if scales and len(scales) > 1 and len(tables) < len(scales):
        raise LiaamError(f"--scale {' --scale '.join(scales)}: give one length, or tables of 'liaam scale' only")
    given += [Path(name) for name in (*tables, groups, pairs, table) if name is not None and Path(name).is_file()]
    _check_outputs(given, [output, *(_beside(output, end) for end in ends)], plot)
    if pairs is not None and symmetry != morphometry.OBJECT:
        raise LiaamError("--pairs are the landmarks of both sides of one structure: give --symmetry object, too")
    reading = Reading(strict, category)
    specimens = _comparable_specimens(results, reading, resample, has_replicates=replicates is not None)
    stated = None if table is None else morphometry.read_specimen_table(table)
    if stated is not None:
        specimens, unlisted = stated.of(specimens, sides=side != IGNORED)
        _complain_of_unlisted(unlisted, len(specimens), stated.path)
        _name_rows_of_none(stated.rows_of_none(specimens), stated.path, complain if unlisted else say)
        groups = groups and (stated.column_called(groups) or groups)
    specimens, reflected = morphometry.of_one_side(specimens, side, replicates, strict)
    if tables:
        specimens = morphometry.with_lengths(specimens, morphometry.read_lengths(*tables))
        scale = None  # each specimen now has its own
    if estimate is not None:
        specimens, incomplete = morphometry.with_estimated_landmarks(specimens, estimate, scale)
        _refuse_or_complain(incomplete, "keep missing landmarks", strict)
    _refuse_or_complain_of_far_estimates(morphometry.far_estimates(specimens, scale), estimate, strict)

    _refuse_or_complain(morphometry.estimated_on_a_side(specimens), "lack landmarks of one side", strict)

    # Everything is computed before anything is written, so that an error leaves no part of the files.
    columns = morphometry.measure(specimens, measures or (), scale, slide)
    error = None
    if replicates is not None:
        error = morphometry.measurement_error(specimens, columns, replicates, slid=slide is not None)
    asymmetry = None
    if symmetry == MATCHING and stated is not None:
        stated.refuse_without_individuals(specimens, replicates)
    if symmetry is not None:
        asymmetry = morphometry.asymmetry(
            specimens,
            columns,
            symmetry,
            pairs=_twins(pairs, results, specimens) if symmetry == morphometry.OBJECT else None,
            by=replicates,
            permutations=permutations,
            seed=seed,
        )
        _refuse_or_complain(asymmetry.left_out, "are not compared", strict)
    group_of = None
    if groups is not None:
        group_of = _groups_of(specimens, groups, stated)
    variation = None
    if wants_variation:
        variation = morphometry.shape_variation(specimens, columns, group_of, permutations, seed, replicates)
    agreement = None
    if compare:
        individuals = morphometry.individuals_of(specimens, replicates)
        agreement = _agreement(specimens, compare, group_of, individuals, reading)

    if group_of is not None:
        is_column = stated is not None and groups in stated.columns
        columns = morphometry.with_groups(columns, group_of, str(groups) if is_column else "group")
    write_columns(output, columns)
    what = "specimen" if replicates is None else "record"
    say(f"{output}: {count_of(len(specimens), what)}{_unit_said(columns)}")
    rule = None if scale is None else parse_scale(scale)
    if isinstance(rule, ScaleBar):
        say(f"landmarks {' and '.join(rule.ends)} are the ends of the scale, and no part of the shapes")
    if scale is None or scale in UNITS:  # then nobody gave the length of a pixel
        _say_sources(specimens)
    if stated is not None:
        say(stated.reading_said(groups or ""))
    if reflected:
        say(reflected)
    if asymmetry is not None:
        _write_asymmetry(asymmetry, output)
        _complain_of_error(asymmetry)
        _complain_of_repeated_errors(asymmetry)
        _complain_of_estimated_differences(asymmetry, output)
    if variation is not None:
        _write_variation(variation, output)
    if group_of is not None:
        _say_means(columns, group_of, morphometry.individuals_of(specimens, replicates))
    if agreement is not None:
        _write_agreement(agreement, output)
        _complain_of_absent(specimens)
    if plot is not None:
        _draw(columns, asymmetry, specimens, plot)
    if error is not None and replicates is not None:
        _write_error(error, output, replicates)
        for line in morphometry.exchanged_landmarks(specimens, replicates):
            complain(line)
    _complain_of_estimates(columns)
    _complain_of_specimens_without_scale(columns)
    _complain_of_unlike_scales(columns)
    _complain_of_specimens_without_shape(columns)


def _comparable_specimens(
    results: Path, reading: Reading, resample: str | None, *, has_replicates: bool
) -> "tuple[Specimen, ...]":
    """Read specimens, place points along their curves if asked, and leave out copies and those of other landmarks."""
    from liaam import morphometry

    specimens: Iterable[Specimen] = morphometry.read_specimens(results, complain, reading, has_replicates)
    if resample is not None:
        specimens = morphometry.with_even_curves(specimens, resample)
    alike, left_out = morphometry.alike(specimens)
    _refuse_or_complain(left_out, "have other landmarks than most", reading.strict)
    kept, copies = morphometry.without_copies(alike)
    _refuse_or_complain(copies, "are of copies of pictures", reading.strict)
    return kept


def _complain_of_unlisted(names: Sequence[str], n: int, path: str) -> None:
    """Name the specimens of which a table has no row."""
    if names:
        complain(f"{len(names)} of {count_of(n, 'specimen')} have no row in {path}: {some_names(names)}")


def _name_rows_of_none(names: Sequence[str], path: str, tell: Callable[[str], None]) -> None:
    """Name the rows of a table of which there is no specimen: some may be misspelt."""
    if names:
        tell(f"{path}: {count_of(len(names), 'row')} of no specimen: {some_names(names)}")


def _groups_of(specimens: "Sequence[Specimen]", groups: str, stated: "SpecimenTable | None") -> tuple[str, ...]:
    """Return the group of each specimen: from a column of the table of specimens, or from a table of groups."""
    from liaam import morphometry

    is_file = Path(groups).is_file()
    if stated is not None and (groups in stated.columns or not is_file):
        return stated.cells_of(specimens, groups)
    if not is_file and not Path(groups).suffix:
        raise LiaamError(
            f"--groups {groups}: there is no such file; if {groups} is a column of your own table, give that, too "
            "(--specimens TABLE.csv)"
        )
    return morphometry.groups_of([specimen.name for specimen in specimens], morphometry.read_groups(groups))


def _beside(output: Path, end: str) -> Path:
    """Return the path of a further file beside the output, whose name begins alike."""
    return output.with_name(f"{output.stem}_{end}")


def _check_outputs(given: Sequence[Path], tables: Sequence[Path], plot: Path | None) -> None:
    """Raise unless the tables and the figure can be written, and are none of the files or in the folders given."""
    for path in tables if plot is None else (*tables, plot):
        check_output(path)
        if any(real_path(path).is_relative_to(real_path(each)) for each in given):
            raise LiaamError(f"{path} is an input, or a file in it; give the output a name elsewhere")
    if plot is not None and plot.suffix.lower() not in FIGURES:
        raise LiaamError(f"{plot}: figures are written as .png, .pdf or .svg; give a name that ends so")


def _refuse_or_complain(lines: Sequence[str], what: str, strict: bool) -> None:
    """Print what is wrong with some specimens or individuals, or raise if strict."""
    if lines and strict:
        raise LiaamError(f"{len(lines)} specimens {what}: {'; '.join(lines)}")
    for line in lines:
        complain(line)


def _refuse_or_complain_of_far_estimates(lines: Sequence[str], method: str | None, strict: bool) -> None:
    """Name specimens with doubtful estimates, or raise if strict."""
    if not lines:
        return
    remedy = "two of the other landmarks of these specimens may be exchanged, for example"
    if method == "regression":
        remedy = "regression seldom suits such specimens: take --estimate tps"
    more = f"; and {len(lines) - MOST_FAR} more" if len(lines) > MOST_FAR else ""
    text = (
        f"{count_of(len(lines), 'specimen')} with landmarks estimated far from where they lie in complete specimens, "
        f"in multiples of their root mean square distance from the mean there: {'; '.join(lines[:MOST_FAR])}{more}. "
        f"Check them; {remedy}"
    )
    if strict:
        raise LiaamError(text)
    complain(f"{text}. They are in the table (--strict stops instead)")


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
    specimens: "Sequence[Specimen]",
    labels: Sequence[Path],
    groups: Sequence[str] | None,
    individuals: Sequence[str],
    reading: Reading,
) -> "ShapeAgreement":
    """Compare specimens with the landmarks that people have placed."""
    from liaam.evaluation import compare_specimens

    people = [_labels(path, reading) for path in labels]
    return compare_specimens(specimens, people, groups, individuals=individuals)


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

    by_component = _beside(output, AGREEMENT_BY_COMPONENT)
    by_landmark = _beside(output, AGREEMENT_BY_LANDMARK)
    everything = _beside(output, AGREEMENT_JSON)
    figure = _beside(output, AGREEMENT_FIGURE)
    write_columns(by_component, agreement.by_component())
    write_columns(by_landmark, agreement.by_landmark())
    write_text_atomically(everything, agreement.to_json())
    save_figure(agreement.plot(), figure)
    say(agreement.report())
    say(f"for the section Methods of a paper: {agreement.methods()}")
    others = f"{by_component.name}, {by_landmark.name} and {figure.name}"
    say(f"{everything}: agreement with people's landmarks; also {others}")


def _complain_of_absent(specimens: "Sequence[Specimen]") -> None:
    """Say that fits with absent landmarks are not compared with people's, unlike in liaam evaluate."""
    named = [each.name for each in specimens if each.status in USABLE and np.isnan(each.measured).any()]
    if named:
        complain(
            f"{count_of(len(named), 'fit')} with absent landmarks left out of the comparison with people's landmarks: "
            f"{some_names(named)}; 'liaam evaluate' compares such fits, too, at the positions that they estimate"
        )


def _write_variation(variation: "ShapeVariation", output: Path) -> None:
    """Print the variance of shape, and write scores and group means beside the output."""
    say(variation.report())
    by_specimen = _beside(output, VARIATION_BY_SPECIMEN)
    write_columns(by_specimen, variation.by_specimen())
    say(f"{by_specimen}: scores of principal components")
    if variation.means:
        by_group = _beside(output, VARIATION_BY_GROUP)
        write_columns(by_group, variation.by_group())
        say(f"{by_group}: mean shapes of {count_of(len(variation.means), 'group')}")
    write_text_atomically(_beside(output, VARIATION_JSON), variation.to_json())


def _say_means(columns: Columns, groups: Sequence[str], individuals: Sequence[str]) -> None:
    """Print the mean of each measure in each group, and whether they differ."""
    from liaam.morphometry import measures_in, p_of_means
    from liaam.morphometry.table import comparable

    for name in measures_in(columns):
        values = comparable(columns, name)
        p = p_of_means(values, groups, individuals)
        if math.isnan(p):
            continue
        means = []
        for group in sorted({*groups} - {""}):
            known = [value for value, of in zip(values.tolist(), groups, strict=True) if of == group and value == value]
            if known:
                means.append(f"{group} {float(np.mean(known)):.4g} (n {len(known)})")
        say(f"{name}: {', '.join(means)}; difference between the means: P = {p:.3g}")


def _write_asymmetry(asymmetry: "AsymmetryResult", output: Path) -> None:
    """Print the analysis of variance, and write the tables of asymmetry beside the output."""
    anova = asymmetry.anova()
    _show_anova(anova)
    say(_about_error(asymmetry))
    individuals = count_of(len(asymmetry.individuals), "individual")
    tables = (
        (ANOVA_TABLE, anova, "analysis of variance"),
        (ASYMMETRY_BY_INDIVIDUAL, asymmetry.indices(), f"asymmetry of {individuals}"),
        (
            ASYMMETRY_BY_COMPONENT,
            asymmetry.components(),
            "symmetric, directional and fluctuating components of shape",
        ),
    )
    for end, table, description in tables:
        path = _beside(output, end)
        write_columns(path, table)
        say(f"{path}: {description}")
    everything = _beside(output, ASYMMETRY_JSON)
    write_text_atomically(everything, asymmetry.to_json())
    say(f"{everything}: all of it")


def _write_error(error: Columns, output: Path, by: str) -> None:
    """Write the table of measurement error beside the output, and print it."""
    path = _beside(output, ERRORS_TABLE)
    write_columns(path, error)
    _show_error(error)
    say(f"{path}: measurement error")
    if max(error["specimens"]) == 1:
        complain(
            f"--replicates {by} takes all records for replicates of one specimen; if they are of several, as IMG_1 and "
            "IMG_2 are, give what comes before the number of a replicate in their names"
        )
    _complain_of_repeatable_errors(error)


def _complain_of_repeatable_errors(error: Columns) -> None:
    """Say that the repeatability of fits is not their reliability if replicates repeat errors that fits state."""
    from liaam.morphometry import replicates_repeat_errors

    if replicates_repeat_errors(error):
        complain(
            f"replicates of shape differ by a standard deviation of {error['sd'][0]:.3g}, and the fits state "
            f"{error[BY_COVARIANCES][0]:.3g}: fits to several images of a specimen repeat most of their error, so "
            "this repeatability is that of photographing, not of the landmarks. Compare fits with landmarks that "
            "people placed: --compare, or liaam evaluate"
        )


def _show_anova(anova: Columns) -> None:
    """Print the analyses of variance as geomorph does: numbers that an effect lacks are left blank."""
    numbers = ("df", "SS", "MS", "R2", "F", "Z", "P")
    table = table_of("trait", "effect", *numbers)
    for row in _rows(anova):
        cells = ["" if math.isnan(row[name]) else f"{row[name]:.4g}" for name in numbers]
        table.add_row(cell(row["trait"]), cell(row["effect"]), *cells)
    show_table(table)


def _about_error(asymmetry: "AsymmetryResult") -> str:
    """Say what fluctuating asymmetry is compared with."""
    without = ""
    if asymmetry.n_estimated:
        without = f", without {count_of(asymmetry.n_estimated, 'record')} with estimated landmarks"
    analysis = asymmetry.analysis
    if analysis.error == "replicates":
        what = "side" if analysis.kind == MATCHING else "individual"
        stated = f"error: from {asymmetry.replicates} replicates of each {what}{without}"
        other = asymmetry.error_by_covariances
        return stated if other is None else f"{stated}; expected from the covariances: MS {other['MS']:.4g}"
    if analysis.error == "covariances":
        stated = f"error: expected from the covariances of the fitted landmarks, as there are no replicates{without}"
        return f"{stated}; taken as independent on both sides"
    return (
        "error: unknown, so that fluctuating asymmetry is not tested, and includes it; digitise twice, and give "
        "--replicates"
    )


def _complain_of_error(asymmetry: "AsymmetryResult") -> None:
    """Say that fluctuating asymmetry is not tested if the error that is stated exceeds what the sides differ by."""
    if not asymmetry.error_exceeds_differences:
        return
    ratio = asymmetry.analysis.shape_anova["F"][INTERACTION]
    complain(
        f"the stated error exceeds the differences between the sides (F = {ratio:.2g} of individual x side, where "
        "independent error makes about 1), so the errors of both sides are alike, or smaller than stated. Fluctuating "
        f"asymmetry is not tested by this: {_PLACE_TWICE}"
    )


def _complain_of_repeated_errors(asymmetry: "AsymmetryResult") -> None:
    """Say that replicates of fits lack the error that fits repeat, and what the test is by the other error term."""
    other = asymmetry.error_by_covariances
    if other is None or not asymmetry.replicates_repeat_errors:
        return
    own = asymmetry.analysis.shape_anova["MS"][ERROR]
    complain(
        f"the replicates differ by less than the fits state: the mean square of the error is {own:.2g} from "
        f"replicates, and {other['MS']:.2g} by the covariances, {other['MS'] / own:.0f} times as much. Fits to several "
        "photographs of a specimen repeat most of their error, so that replicates do not show it, and fluctuating "
        f"asymmetry by them may be error of the fits. By the covariances, individual x side has F = {other['F']:.3g}, "
        f"P = {other['P']:.3g}; they take errors as independent on both sides. To know, {_PLACE_TWICE}"
    )


def _complain_of_estimated_differences(asymmetry: "AsymmetryResult", output: Path) -> None:
    """Name the individuals whose sides also differ by the error of estimated landmarks."""
    named = [name for name, labels in zip(asymmetry.individuals, asymmetry.estimated, strict=True) if labels]
    if named:
        table = _beside(output, ASYMMETRY_BY_INDIVIDUAL).name
        complain(
            f"{len(named)} of {len(asymmetry.individuals)} individuals have estimated landmarks, whose error is part "
            f"of their asymmetry: {some_names(named)}; see 'estimated' in {table}, and compare with an analysis that "
            "leaves them out"
        )


def _draw(columns: Columns, asymmetry: "AsymmetryResult | None", specimens: "Sequence[Specimen]", plot: Path) -> None:
    """Write the figure of the shapes, or of their asymmetry."""
    from liaam.plotting import save_figure
    from liaam.plotting.specimens import figure_of_asymmetry, figure_of_specimens

    if asymmetry is None:
        save_figure(figure_of_specimens(columns), plot)
        say(f"{plot}: shapes")
        return
    save_figure(figure_of_asymmetry(**asymmetry.drawing(specimens)), plot)
    say(f"{plot}: asymmetry")


def _show_error(error: Columns) -> None:
    """Print the measurement error: the measures, and the least repeatable landmarks.

    Rows of landmarks have no degrees of freedom, since their positions in different images do not compare.
    """
    stated = ("sd by covariances",) if BY_COVARIANCES in error else ()
    table = table_of("measure", "specimens", "replicates", "df", "F", "P", "repeatability", "sd", "sd %", *stated)
    landmarks = []
    for row in _rows(error):
        if math.isnan(row["df_within"]):
            landmarks.append(row)
            continue
        counts = [f"{row['specimens']:g}", f"{row['replicates']:g}", f"{row['df_among']:g}, {row['df_within']:g}"]
        numbers = [row[name] for name in ("F", "P", "repeatability", "sd", "sd_percent")]
        numbers += [row[BY_COVARIANCES]] if stated else []
        table.add_row(cell(row["measure"]), *counts, *("" if math.isnan(each) else f"{each:.3g}" for each in numbers))
    show_table(table)
    with_replicates = [row for row in landmarks if not math.isnan(row["sd"])]
    worst = sorted(with_replicates, key=lambda row: -row["sd"])[:LEAST_REPEATABLE]
    named = [f"{row['measure']} (sd {row['sd']:.3g} px, {row['sd_percent']:.2g} %)" for row in worst]
    say(f"least repeatable, in % of centroid size: {', '.join(named) or 'none has replicates'}")


def _rows(columns: Columns) -> list[dict[str, Any]]:
    """Return a table's rows, each by the names of its columns."""
    return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]


def _complain_of_estimates(columns: Columns) -> None:
    """Name the specimens with estimated landmarks."""
    if "estimated" not in columns:
        return
    cells = zip(columns["specimen"], columns["estimated"], strict=True)
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
        lengths = sorted((Length(each.scale or 1.0, each.unit) for each in of_source), key=_millimetres)
        span = " to ".join(dict.fromkeys(str(each) for each in (lengths[0], lengths[-1])))
        doubt = "; give --scale if the images to measure were taken otherwise" if source == TRAINING else ""
        say(f"the scale of {count_of(len(of_source), 'specimen')} is that of {source} ({span} per pixel){doubt}")


def _millimetres(length: Length) -> float:
    """Return a length in millimetres, if its unit is known, to be compared with others."""
    return length.within("mm").value


def _complain_of_specimens_without_scale(columns: Columns) -> None:
    """Name the specimens that may be used and have no scale, where others have one."""
    scales = scales_in(columns)
    if scales is None:
        return
    names = columns["specimen"]
    statuses = columns.get("status", [""] * len(names))
    named = [
        name
        for name, scale, status in zip(names, scales, statuses, strict=True)
        if math.isnan(scale) and (not status or status in USABLE)
    ]
    if named:
        what = "no sizes" if unit_of_table(columns) else "sizes in pixels"
        complain(f"{len(named)} of {len(names)} have no scale, so that they have {what}: {some_names(named)}")


def _complain_of_unlike_scales(columns: Columns) -> None:
    """Name the specimens whose scale differs from that of most."""
    scales = scales_in(columns)
    if scales is None:
        return
    names = columns["specimen"]
    unit = unit_of_table(columns)
    named = [f"{names[i]} ({scales[i]:.4g})" for i in np.flatnonzero(unlike(scales)).tolist()]
    if named:
        usual = f"the usual {float(np.nanmedian(scales)):.4g}{f' {unit}' if unit else ''} per pixel"
        complain(f"{len(named)} of {len(names)} have a scale unlike {usual}; check it: {some_names(named)}")


def _complain_of_specimens_without_shape(columns: Columns) -> None:
    """Name the specimens that have no shape."""
    names = columns["specimen"]
    named = [name for name, has_shape in zip(names, _have_shapes(columns), strict=True) if not has_shape]
    if named:
        why = "because landmarks are missing"
        if "status" in columns:
            why += " or the fit is not to be used (see 'status')"
        complain(f"{len(named)} of {len(names)} have no shape, {why}: {some_names(named)}")


def _have_shapes(columns: Columns) -> list[bool]:
    """Return whether each specimen has Procrustes coordinates, or sizes if the table has no coordinates."""
    first = next((name for name in columns if re.fullmatch(r"X\d+", name)), None)  # not X1, which may be a scale bar's
    values = sizes_in(columns) if first is None else columns[first]
    return [not math.isnan(value) for value in values]
