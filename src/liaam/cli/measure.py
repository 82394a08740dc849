"""The command ``liaam measure``."""

from pathlib import Path
from typing import Annotated

import typer

from liaam.cli.inputs import CategoryOption, GroupOption, StrictOption
from liaam.cli.terminal import complain, say
from liaam.errors import LiaamError
from liaam.io.atomic import check_output
from liaam.io.files import count_of, real_path
from liaam.io.landmarks import Reading
from liaam.io.landmarks.formats import KNOWN_FILES


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
            help="Length of a pixel, such as 0.012; or the landmarks at the ends of a scale bar and its length, such "
            "as 11-12=5. By default the SCALE of .tps, or else results are in pixels."
        ),
    ] = None,
    strict: StrictOption = False,
    category: CategoryOption = None,
    group: GroupOption = None,
) -> None:
    """Measure specimens: distances, angles, areas, centroid size and Procrustes coordinates, with standard errors."""
    from liaam.morphometry import alike, measure as measured, read_specimens, write_measurements

    check_output(output)
    if real_path(output).is_relative_to(real_path(results)):
        raise LiaamError(f"{output} is the input, or a file in it; give a name elsewhere with -o")
    specimens = read_specimens(results, complain, Reading(strict, category, group))
    specimens, left_out = alike(specimens)
    if left_out and strict:
        raise LiaamError(f"{len(left_out)} specimens have other landmarks than most: {'; '.join(left_out)}")
    for line in left_out:
        complain(line)
    columns = measured(specimens, measures or (), scale)
    write_measurements(output, columns)
    unit = "" if "scale" in columns else " in pixels (give --scale for other units)"
    say(f"{output}: {count_of(len(specimens), 'specimen')}{unit}")
    names, sizes = columns["specimen"], columns["centroid_size"]
    unused = [name for name, size in zip(names, sizes, strict=True) if size != size]
    scales = zip(names, columns.get("scale", sizes), sizes, strict=True)
    pixels = [name for name, scale, size in scales if scale != scale and size == size]
    if pixels:
        some = ", ".join(pixels[:5]) + " …" * (len(pixels) > 5)
        complain(f"{len(pixels)} of {len(specimens)} have no scale, so that they are in pixels: {some}")
    if unused:
        complain(
            f"{len(unused)} of {len(specimens)} have no shape, because landmarks are missing or the fit is not to be "
            f"used (see 'status'): {', '.join(unused[:5])}{' …' if len(unused) > 5 else ''}"
        )
