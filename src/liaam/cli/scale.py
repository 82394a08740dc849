"""The command ``liaam scale``."""

import math
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from liaam.cli import inputs
from liaam.cli.terminal import cell, complain, progress_bar, say, show_table, table_of
from liaam.errors import LiaamError
from liaam.io import make_folder, read_image, write_columns, write_image
from liaam.io.atomic import check_output
from liaam.io.files import count_of, existing_file, fingerprint_of, some_names
from liaam.io.overlays import SCALE
from liaam.scale.choice import tagged_length
from liaam.scale.lengths import Length, parse_length, unlike

Row = dict[str, Any]


def scale(
    images: Annotated[
        list[Path],
        typer.Argument(
            metavar="IMAGE...",
            readable=False,
            help="The images, folders of images, or quoted patterns such as 'images/**'.",
        ),
    ],
    output: Annotated[
        Path, typer.Option("--output", "-o", help="Table to write: .csv. Beside it, a folder of overlays to check.")
    ] = Path("scales.csv"),
    ruler: Annotated[
        str | None,
        typer.Option(
            help="Find the ruler in each image: the length from one smallest tick to the next, such as '1 mm'."
        ),
    ] = None,
    scale_bar: Annotated[
        str | None,
        typer.Option(
            help="Find the scale bar in each image: its length, such as '5 mm'. The number beside it is not read."
        ),
    ] = None,
) -> None:
    """Find the length of a pixel of images: from a ruler, a scale bar, or else the tags of TIFF images.

    What is not clear is refused, not guessed. If you know the scale of such an image, write it into its line. Give the
    table to 'liaam measure --scale'. If the table exists, the lines of other images stay in it, as do scales that you
    wrote, or that were found before and are not found now.
    """
    if ruler is not None and scale_bar is not None:
        raise LiaamError("--ruler and --scale-bar: give one of them; crop the images to what they show")
    images = inputs.given_images(images)
    check_output(output)
    if output.suffix.lower() != ".csv":
        raise LiaamError(f"{output}: the table is written as CSV; give a name that ends in .csv")
    earlier = earlier_rows(output)
    known = _known_length(ruler or scale_bar, "--ruler" if ruler else "--scale-bar")
    find = None if known is None else _finder(known if ruler is not None else None)
    folder = output.with_suffix("")
    if find is not None:
        make_folder(folder)
    rows = []
    with progress_bar() as progress:
        names = zip(images, inputs.names_in_folders(images), inputs.unique_stems(images), strict=True)
        for i, (image, name, stem) in enumerate(names):
            progress(i, len(images), name)
            rows.append({"image": name} | _row(image, known, find, folder / f"{stem}{SCALE}"))
        progress(len(images), len(images), "")
    _show_scales(rows)
    n_found = sum(not math.isnan(row["scale"]) for row in rows)
    rows, stayed = with_earlier(rows, earlier)
    if not n_found:
        if find is not None:
            _remove_if_empty(folder)
        complain(f"the scale of none of {count_of(len(rows), 'image')} was found: {output} is not written")
        raise typer.Exit(1)
    names_of_columns = dict.fromkeys(name for row in rows for name in row)
    write_columns(output, {name: [row.get(name, "") for row in rows] for name in names_of_columns})
    _say_kept(len(rows) - len(images), stayed, output)
    drawn = f"; overlays in {folder}" if find is not None else ""
    say(f"{output}: the scale of {n_found} of {count_of(len(images), 'image')}{drawn}")


def earlier_rows(output: Path) -> list[Row]:
    """Return the rows of a table that exists; raise if it is no table of scales."""
    from liaam.io.table_reader import read_named_rows
    from liaam.morphometry.scale_tables import KIND, lengths_in, with_usual_columns

    if not output.exists():
        return []
    try:
        rows = with_usual_columns(read_named_rows(output, KIND), output)
        lengths_in(rows, output)
    except LiaamError as fault:
        raise LiaamError(f"{output} exists, and cannot be completed: {fault}; or give another name with -o") from fault
    return [row for _, row in rows]


def with_earlier(rows: list[Row], earlier: list[Row]) -> tuple[list[Row], list[str]]:
    """Return the rows of a table with those of other images in an earlier one, which come first.

    Earlier lines of these images stay if a person has written them, or if nothing is found now in the same file. The
    names of these images are returned, too.
    """
    new = {row["image"]: row for row in rows}
    stayed = [row["image"] for row in earlier if row["image"] in new and _stays(row, new[row["image"]])]
    kept = [row if row["image"] not in new or row["image"] in stayed else new[row["image"]] for row in earlier]
    known = {row["image"] for row in earlier}
    return [*kept, *(row for row in rows if row["image"] not in known)], stayed


def _stays(earlier: Row, new: Row) -> bool:
    """Return whether the earlier line of an image stays: it has a scale, by hand or where none is found now."""
    if not earlier["scale"].strip():
        return False
    if not earlier.get("how", "").strip():  # written by hand
        return True
    return math.isnan(new["scale"]) and earlier.get("fingerprint", "").strip() in ("", new["fingerprint"])


def _say_kept(n_others: int, stayed: list[str], output: Path) -> None:
    """Say which lines of an earlier table stay."""
    if n_others > 0:
        say(f"{output}: {count_of(n_others, 'line')} of other images stay")
    if stayed:
        say(f"{output}: earlier lines of these images stay, by hand or as no scale is found now: {some_names(stayed)}")


def _known_length(text: str | None, option: str) -> Length | None:
    """Parse the length that an option gives, which needs a unit."""
    length = None if text is None else parse_length(text)
    if length is not None and not length.unit:
        raise LiaamError(f"{option} {text}: give the unit, too, such as '{text} mm'")
    return length


def _finder(tick: Length | None) -> Callable[[np.ndarray], Any]:
    """Return the function that finds a ruler with ticks of a length, or else a scale bar."""
    from liaam.scale.bars import find_bar
    from liaam.scale.rulers import find_ruler

    return find_bar if tick is None else partial(find_ruler, tick=tick)


def _row(image: Path, known: Length | None, find: Callable[[np.ndarray], Any] | None, overlay: Path) -> Row:
    """Return the row of an image without its name, and write its overlay. What is wrong is its message."""
    row: Row = {"scale": math.nan, "unit": "", "scale_se": math.nan, "how": "", "message": "", "fingerprint": ""}
    try:
        existing_file(image, LiaamError, "image")
        row["fingerprint"] = fingerprint_of(image)
        if find is None or known is None:
            length, fault = tagged_length(image)
            lacking = "" if length else "no tag states the scale: give --ruler or --scale-bar"
            row["message"] = _without_name(fault, image) or lacking
        else:
            pixels = read_image(image)
            found = find(pixels)
            length = found.pixel(known)
            _draw(pixels, found, length, overlay)
    except LiaamError as fault:
        return row | {"message": _without_name(str(fault), image)}
    if length is None:
        return row
    return row | {"scale": length.value, "unit": length.unit, "scale_se": length.se, "how": length.source}


def _without_name(message: str, image: Path) -> str:
    """Return a message without the name of an image at its start, as the row has it."""
    return message.removeprefix(str(image)).lstrip(": ")


def _draw(pixels: np.ndarray, found: Any, length: Length, path: Path) -> None:
    """Write an image with the ruler or the scale bar that was found in it, and the length of a pixel."""
    from liaam.plotting.scales import overlay_of_scale

    write_image(path, overlay_of_scale(pixels, found, f"{length.value:.5g} {length.unit}/px"))


def _remove_if_empty(folder: Path) -> None:
    """Remove the folder of overlays if there are none."""
    with suppress(OSError):  # it holds those of earlier images
        folder.rmdir()


def _show_scales(rows: list[Row]) -> None:
    """Print the scales, what was refused and why, and which are unlike the others."""
    table = table_of("image", "scale", "standard error", "from")
    for row in rows:
        if not math.isnan(row["scale"]):
            error = f"{100 * row['scale_se'] / row['scale']:.2g} %"
            table.add_row(cell(row["image"]), f"{row['scale']:.6g} {row['unit']}", error, cell(row["how"]))
    if table.row_count:
        show_table(table)
    for row in rows:
        if row["message"]:
            complain(f"{row['image']}: {row['message']}")
    units = {row["unit"] for row in rows if row["unit"]}
    if len(units) == 1:
        odd = [rows[i]["image"] for i in np.flatnonzero(unlike([row["scale"] for row in rows])).tolist()]
        if odd:
            n_found = sum(not math.isnan(row["scale"]) for row in rows)
            complain(f"{len(odd)} of {n_found} scales are unlike the others; check them: {some_names(odd)}")
