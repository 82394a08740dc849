"""Read specimens: fits, tables of batches, and landmark files."""

from __future__ import annotations

import os
import warnings
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from liaam.batch.tables import TABLE_SUFFIXES, TEXT_SUFFIXES, is_table_of_text, read_rows, rows_of_text
from liaam.datasets.units import CORNER, FEWEST
from liaam.errors import LandmarkError, LiaamError
from liaam.fitting.result import USABLE, FitStatus
from liaam.io.files import existing_file, is_copy, natural_key, some_names
from liaam.io.fit_files import ROUNDING, corrected_file, points_of_fit, read_fit
from liaam.io.landmarks import LANDMARK_SUFFIXES, Contour, LandmarkFile, Landmarks
from liaam.io.landmarks.base import PRESENT
from liaam.io.landmarks.formats import ALSO_OTHER, name_of
from liaam.io.landmarks.matching import shared_folder, unique_names
from liaam.io.landmarks.reading import USUAL, Reading, UnrecognisedError
from liaam.io.landmarks.tables import is_of_imagej, parse_long
from liaam.io.sides import folder_side, side_of_text
from liaam.morphometry.records import Record, doubts_about, objects_of_records, with_unique_codes
from liaam.morphometry.specimens import MOST, Specimen
from liaam.scale.choice import length_of, tagged_length
from liaam.scale.lengths import Length, unit_of

STATUSES = frozenset(("error", *map(str, FitStatus)))
"""What a column ``status`` of landmarks means; other words, such as ``checked``, mean nothing."""

_LOOKED_AT = 20  # Images of a file that are looked at to judge the unit of its positions
_SAME = 2.0  # Difference in pixels that rounding to whole pixels can make between distances, and a little more


def read_specimens(
    path: str | os.PathLike[str],
    on_fault: Callable[[str], object] | None = None,
    reading: Reading = USUAL,
    replicates: bool = False,
) -> tuple[Specimen, ...]:
    """Read the specimens of a folder or a file.

    Parameters
    ----------
    path : path-like
        A ``.json`` of ``liaam fit``; a table of ``liaam batch``; a landmark file in any format, also with many images;
        or a folder of such files. Of several files of an image, its ``.json`` is read, or else the first in the order
        of `liaam.io.LANDMARK_SUFFIXES`. Images are not needed, except for ``.asf``. The files of subfolders are read,
        too, if the path ends in ``**``, or if the folder itself holds none and its subfolders are named left and right.
        Their names begin with the subfolder.
    on_fault : callable, optional
        Called with a message for each file of a folder that is skipped because it cannot be read, and about records
        that are left out. Default: a warning.
    reading : Reading, optional
        How to read landmark files. If strict, a file or record that cannot be read is an error.
    replicates : bool
        Whether to keep an image's records in all files, named ``image#file`` from the second on, not only in the first.

    Returns
    -------
    tuple of Specimen
        In natural order of their names (2 before 10) for a folder, otherwise in the order of the file. Each has a name
        of its own: that of its image, with folders where images of several folders have one name, and a number or ID
        where the image has several records. Records of one image that lie on each other are of one object; others are
        of several (see `replicate_of`).

    Raises
    ------
    LiaamError
        If the path does not exist, a file cannot be read, or a folder holds none that can.
    """
    path = Path(path)
    complain = on_fault or partial(warnings.warn, stacklevel=2)
    is_recursive = path.name == "**"
    if is_recursive:
        path = path.parent
    if not path.is_dir():
        records = list(_of_file(existing_file(path, LiaamError, "file of results"), complain, reading))
        records = with_unique_codes(records, complain)
        for line in doubts_about(records):
            complain(line)
        return tuple(objects_of_records(records))
    others: list[str] = []
    read = _of_files(path, _chosen_below(path) if is_recursive else _chosen(path), others, complain, reading)
    if not read and not is_recursive:
        read = _of_files(path, _of_sides(path), others, complain, reading)
    if not read:
        besides = f"; no landmarks are in {some_names(others)}" if others else ""
        raise LiaamError(
            f"{path} holds no results that can be read: name a folder of 'liaam fit', a table of 'liaam batch', or "
            f"landmark files ({', '.join(LANDMARK_SUFFIXES)}); '{path}/**' also reads its subfolders{besides}"
        )
    read = with_unique_codes(read, complain)
    for line in doubts_about(read):
        complain(line)
    specimens = objects_of_records(read) if replicates else _of_first_files(read, complain)
    return tuple(sorted(specimens, key=lambda specimen: natural_key(specimen.name)))


def _of_files(
    folder: Path, files: Iterable[Path], others: list[str], complain: Callable[[str], object], reading: Reading
) -> list[Record]:
    """Return the records of files below a folder; add the names of those that seem to be no results to the others."""
    read: list[Record] = []
    for file in files:
        name = file.relative_to(folder).as_posix()
        try:
            read += _below(folder, file, _of_file(file, complain, reading))
        except LiaamError as fault:
            if isinstance(fault, UnrecognisedError) and file.suffix.lower() in ALSO_OTHER:  # such as notes
                others.append(name)
                continue
            if reading.strict:
                raise
            complain(f"skipped {name}: {str(fault).removeprefix(f'{file}: ')}")
    return read


def _of_first_files(records: Iterable[Record], complain: Callable[[str], object]) -> list[Specimen]:
    """Return the specimens of each image in the first file that has it, and tell of others that differ.

    Files whose fits to an image may not be used come last: another file may have it fitted again, in another way.
    """
    records = tuple(records)
    first_file: dict[str, str] = {}
    for record in records:
        if record.specimen.is_usable:
            first_file.setdefault(record.image, record.specimen.file)
    used: list[Record] = []
    by_name: dict[str, Specimen] = {}
    others: dict[tuple[str, str], list[str]] = defaultdict(list)
    for record in records:
        specimen = record.specimen
        file = first_file.setdefault(record.image, specimen.file)
        if specimen.file == file:
            used.append(record)
            by_name.setdefault(specimen.name, specimen)
        elif not specimen.is_usable:
            continue
        elif specimen.name not in by_name or _differ(by_name[specimen.name].points, specimen.points):
            others[specimen.file, file].append(specimen.name)
    for (file, first), names in others.items():
        complain(
            f"left out of {file}, because others of these names were read before, from {first}: {some_names(names)}"
        )
    return objects_of_records(used)


def _differ(points: np.ndarray, others: np.ndarray) -> bool:
    """Return whether landmarks have other distances than by rounding to whole pixels; those of y upwards do not."""
    if points.shape != others.shape:
        return True
    steps, other_steps = (np.linalg.norm(np.diff(each, axis=0), axis=1) for each in (points, others))
    return bool((np.abs(steps - other_steps) > _SAME).any())


def _chosen(folder: Path) -> list[Path]:
    """Return one file per stem, so that the files of a fit count once; copies of files come last."""
    order = (".json", *TABLE_SUFFIXES, *LANDMARK_SUFFIXES)
    files = [
        file for file in folder.iterdir() if file.suffix.lower() in order and not file.name.startswith((".", "~$"))
    ]
    chosen: dict[str, Path] = {}

    def rank(file: Path) -> tuple[Any, ...]:
        return is_copy(file), order.index(file.suffix.lower()), natural_key(file.name)

    for file in sorted(files, key=rank):
        chosen.setdefault(file.stem, file)
    return list(chosen.values())


def _chosen_below(folder: Path) -> list[Path]:
    """Return one file per stem of a folder, and of each of its subfolders that is not hidden, in natural order."""
    folders = [folder, *(each for each in folder.rglob("*") if each.is_dir())]
    seen = [each for each in folders if not any(part.startswith(".") for part in each.relative_to(folder).parts)]
    return [file for each in sorted(seen, key=lambda each: natural_key(str(each))) for file in _chosen(each)]


def _of_sides(folder: Path) -> list[Path]:
    """Return the files in the subfolders of a folder if all of these are named after sides."""
    files = [file for file in _chosen_below(folder) if file.parent != folder]
    return files if all(folder_side(file.relative_to(folder).as_posix()) for file in files) else []


def _below(folder: Path, file: Path, records: Iterable[Record]) -> list[Record]:
    """Return the records of a file, whose names and sides are also by the subfolder of a folder that it is in."""
    inside = file.parent.relative_to(folder).as_posix()
    if inside == ".":
        return list(records)
    placed = []
    for record in records:
        specimen = record.specimen
        name = specimen.name if specimen.code else f"{inside}/{specimen.name}"
        specimen = replace(specimen, name=name, side=specimen.side or folder_side(f"{inside}/"))
        placed.append(record._replace(image=f"{inside}/{record.image}", specimen=specimen))
    return placed


def _of_file(path: Path, complain: Callable[[str], object], reading: Reading) -> Iterator[Record]:
    fit = read_fit(path) if path.suffix.lower() == ".json" else None
    if fit:  # other .json files hold landmarks only
        number = fit.get("object")
        place = f"{path.stem.removesuffix(f'_{number}')}#{number}" if number else path.stem
        name = str(fit.get("specimen") or "") if fit.get("code") else place
        fitted = _specimen(path, name or place, fit, fit.get("covariance"))
        yield Record(place, _corrected(path, fit, fitted, complain))
        return
    if path.suffix.lower() in TABLE_SUFFIXES and path.suffix.lower() not in TEXT_SUFFIXES:
        yield from _of_batch(path, list(read_rows(path)))
        return
    file = LandmarkFile.read(path, reading)
    if is_table_of_text(file):
        yield from _of_batch(path, list(rows_of_text(file)))
    else:
        yield from _of_landmarks(file, complain)


def _of_batch(path: Path, rows: Sequence[dict[str, Any]]) -> Iterator[Record]:
    """Yield the records of a table of a batch, given its rows."""
    names = unique_names(row["path"] for row in rows)
    for row in rows:
        place = names[row["path"]] + (f"#{row['object']}" if row.get("object") else "")
        name = str(row["specimen"]) if row.get("code") else place
        specimen = _specimen(path, name, row, row.get("covariance"))
        side = specimen.side or folder_side(row["path"])
        yield Record(place, replace(specimen, side=side, image=row["path"]))


def _specimen(path: Path, name: str, facts: dict[str, Any], covariances: Any) -> Specimen:
    try:
        points = _numbers(facts["landmarks"] or []).reshape(-1, 2)
        spread = None
        if covariances:
            xx, xy, yy = _numbers(covariances).reshape(len(points), 3).T
            spread = np.stack([xx, xy, xy, yy], axis=1).reshape(-1, 2, 2)
        scale = facts.get("scale") or None
        is_used = facts["status"] in USABLE
        return Specimen(
            name,
            points,
            covariances=spread,
            names=tuple(map(str, facts.get("landmark_names") or ())),
            scale=None if scale is None else float(scale),
            status=str(facts["status"]),
            curves=Contour.all_of(facts.get("contours") or ()),
            file=path.name,
            side=str(facts.get("side") or ""),
            estimated=_estimated(points, facts.get("present")) if is_used else (),
            unit=unit_of(str(facts.get("scale_unit") or "")),
            scale_source=str(facts.get("scale_from") or ""),
            image=str(facts.get("image") or ""),
            fingerprint=str(facts.get("fingerprint") or ""),
            code=str(facts.get("code") or ""),
            individual=str(facts.get("individual") or ""),
        )
    except (TypeError, ValueError, OverflowError, LandmarkError) as fault:
        raise LandmarkError(f"{path}: the landmarks of {name} are damaged ({fault}): fit the image again") from fault


def _estimated(points: np.ndarray, present: Any) -> tuple[int, ...]:
    """Return the landmarks of a fit that are absent and have positions, which are then estimates."""
    if not present:
        return ()
    is_absent = _numbers(present).reshape(len(points)) < PRESENT
    return tuple(np.flatnonzero(is_absent & np.isfinite(points).all(axis=1)).tolist())


def _corrected(path: Path, fit: dict, fitted: Specimen, complain: Callable[[str], object]) -> Specimen:
    """Return a fit's specimen with the points of a landmark file beside it that was changed since, if there is one."""
    file = corrected_file(path, fit)
    if file is None:
        return fitted
    try:
        points = points_of_fit(file, fit)
        is_alike = len(points) == len(fitted.points)
        names, curves = (fitted.names, fitted.curves) if is_alike else ((), ())
        kept = tuple(i for i in fitted.estimated if is_alike and np.abs(points[i] - fitted.points[i]).max() <= ROUNDING)
        corrected = replace(
            fitted, points=points, covariances=None, names=names, status="", curves=curves, estimated=kept
        )
    except LandmarkError as fault:
        complain(f"{path.stem}: {fault}; the points of the fit are used")
        return fitted
    complain(f"{path.stem}: measured from {file.name}, whose points were changed after the fit")
    return corrected


def _numbers(values: Any) -> np.ndarray:
    """Convert to float64. What is out of range, as in fits that diverged, is NaN."""
    numbers = np.array(values, dtype=np.float64)
    return np.where(np.abs(numbers) <= MOST, numbers, np.nan)


def _of_landmarks(file: LandmarkFile, complain: Callable[[str], object]) -> Iterator[Record]:
    path = file.path
    names = {"": name_of(path)} if file.is_single else unique_names(file.entries)
    folder = "" if file.is_single else shared_folder(file.entries)

    def make(entry: str) -> list[Record]:
        # Measures depend on neither the height of an image nor its orientation, but on its size if the file states one.
        placing = file.entries[entry].placing
        placed = file.placed(entry, None if placing.size or placing.fractions else (1, 1))
        length = length_of(placed) or _tagged(file, entry, complain)
        image = names[""] if file.is_single else names[entry]
        raw = (file.entries[entry], *file.entries[entry].others)
        zeros = {
            id(each): file.zeros_of(as_in_file) for each, as_in_file in zip((placed, *placed.others), raw, strict=True)
        }
        return [
            Record(image, _specimen_of(name, landmarks, path, entry, length), folder, zeros[id(landmarks)])
            for name, landmarks in placed.objects(image)
        ]

    try:
        for records in file.each(((entry or path.stem, entry) for entry in file.entries), make):
            yield from records
    except LandmarkError as fault:
        raise LandmarkError(f"{path}: {str(fault).removeprefix(f'{path}: ')}") from fault
    if not file.is_single and (doubt := _doubt_about_units(file)):
        complain(f"{path.name}: {doubt}")
    for line in file.notes.lines():
        complain(f"{path.name}: {line.replace(f'{path}: ', '')}")


def _specimen_of(name: str, landmarks: Landmarks, path: Path, entry: str, of_image: Length | None) -> Specimen:
    """Return the specimen of the landmarks of a name in a file, which has them for an image.

    Its length of a pixel is that of the landmarks, or else that of the image.
    """
    length = length_of(landmarks) or of_image
    return Specimen(
        name,
        landmarks.points,
        names=landmarks.names,
        scale=None if length is None else length.value,
        curves=landmarks.contours,
        file=path.name,
        status=landmarks.status if landmarks.status in STATUSES else "",
        individual=landmarks.individual,
        side=side_of_text(landmarks.side) or folder_side(entry),
        unit="" if length is None else length.unit,
        scale_source="" if length is None else length.source,
    )


def _tagged(file: LandmarkFile, entry: str, complain: Callable[[str], object]) -> Length | None:
    """Return the length of a pixel that the tags of an image beside a landmark file state, if they do."""
    image = file.beside.image_of(entry, file.path)
    length, fault = (None, "") if image is None else tagged_length(image)
    if fault:
        complain(f"{fault} Until then, its specimens have no scale.")
    return length


def _doubt_about_units(file: LandmarkFile) -> str:
    """Return what has to be said about the unit of the positions of many images: nothing if the images suit them."""
    n_images = 0
    for entry, landmarks in islice(file.entries.items(), _LOOKED_AT):
        if landmarks.placing.upwards or landmarks.placing.fractions:
            return ""
        try:
            size, _ = file.beside.size_of(entry)
        except LandmarkError:
            continue
        n_images += 1
        if np.nanmax(landmarks.points / size, initial=0.0) > CORNER:
            return ""
    if n_images >= FEWEST:
        return "all landmarks lie in the top-left corner of their images: x and y are not pixels, but in another unit"
    if file.form.parse is parse_long and is_of_imagej(file):
        return "X and Y of ImageJ's results are taken for pixels; those of a calibrated image are in its unit"
    return ""
