"""The command ``liaam measure``."""

from pathlib import Path
from typing import Annotated

import typer

from liaam.cli.terminal import complain, say
from liaam.errors import LiaamError
from liaam.io.atomic import check_output
from liaam.io.files import count_of, real_path


def measure(
    results: Annotated[
        Path,
        typer.Argument(
            metavar="RESULTS",
            help="Folder of 'liaam fit', table of 'liaam batch', or landmark files, also .tps: a file or a folder.",
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
) -> None:
    """Measure specimens: distances, angles, areas, centroid size and Procrustes coordinates, with standard errors."""
    from liaam.morphometry import measure as measured, read_specimens, write_measurements

    check_output(output)
    if real_path(output).is_relative_to(real_path(results)):
        raise LiaamError(f"{output} is the input, or a file in it; give a name elsewhere with -o")
    specimens = read_specimens(results, complain)
    columns = measured(specimens, measures or (), scale)
    write_measurements(output, columns)
    unit = "" if "scale" in columns else " in pixels (give --scale for other units)"
    say(f"{output}: {count_of(len(specimens), 'specimen')}{unit}")
    unused = [name for name, size in zip(columns["specimen"], columns["centroid_size"], strict=True) if size != size]
    if unused:
        complain(
            f"{len(unused)} of {len(specimens)} have no shape, because landmarks are missing or the fit is not to be "
            f"used (see 'status'): {', '.join(unused[:5])}{' …' if len(unused) > 5 else ''}"
        )
