"""Messages about folders whose images and landmarks do not match: what is wrong, and what to do."""

import os
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path

from liaam.io.files import is_number, some_names
from liaam.io.images import PICTURE_SUFFIXES, UNREAD_SUFFIXES, USUAL_SUFFIXES
from liaam.io.landmarks import LANDMARK_SUFFIXES
from liaam.io.landmarks.formats import ALSO_OTHER, NOT_READ
from liaam.io.overlays import is_overlay

NO_IMAGE = "no image has its name"  # Reason for leaving out a landmark file
# Reason for leaving out a file that seems to hold landmarks
UNKNOWN = f"unknown format; landmarks are read from {', '.join(LANDMARK_SUFFIXES)}"
# Reason for leaving out an image that has landmarks
UNKNOWN_IMAGE = "unsupported image format; convert it to .png, .tif or .jpg"

ABSENT = "it names images that do not exist"

_SEARCHED = 20_000  # Maximum number of paths in subfolders that are looked at
_SAMPLE = 4096  # Number of bytes of a file that decide whether it is a table of numbers


def unread_landmarks(files: Sequence[Path], bare: Sequence[Path], unrecognised: Sequence[Path] = ()) -> list[Path]:
    """Return files named like an image without landmarks (``bare``), and tables of numbers, of unknown formats.

    ``unrecognised`` are files that have the suffix of a format but are in none.
    """
    stems = {image.with_suffix("") for image in bare}
    suffixes = {*PICTURE_SUFFIXES, *LANDMARK_SUFFIXES}
    others = [file for file in files if file.suffix.lower() not in suffixes or file in unrecognised]

    holders = {*NOT_READ, *ALSO_OTHER} - {".txt"}
    read = {file.with_suffix("") for file in files if file.suffix.lower() in LANDMARK_SUFFIXES}

    def seems_to_hold(file: Path) -> bool:
        if file.with_suffix("") in read - stems and file not in unrecognised:  # as DeepLabCut's .h5 beside its .csv
            return False
        return file.with_suffix("") in stems or file.suffix.lower() in holders or _has_numbers(file)

    return [file for file in others if stems and seems_to_hold(file)]


def unread_images(files: Sequence[Path], orphans: Sequence[Path]) -> list[Path]:
    """Return images of unsupported formats that are named like landmark files without an image."""
    stems = {path.with_suffix("") for path in orphans}
    return [file for file in files if file.suffix.lower() in UNREAD_SUFFIXES and file.with_suffix("") in stems]


def _has_numbers(file: Path) -> bool:
    """Return whether a file begins with text that consists mostly of numbers."""
    try:
        with file.open("rb") as opened:
            text = opened.read(_SAMPLE).decode("ascii")
    except (OSError, UnicodeDecodeError):
        return False
    words = [word for word in re.split(r"[\s,;=]+", text) if word]
    return sum(map(is_number, words)) > max(5, len(words) / 2)


def has_images_below(root: Path) -> bool:
    """Return whether a folder has images in its subfolders."""
    return bool(_below(root, PICTURE_SUFFIXES))


def no_images(root: Path, files: Sequence[Path], pattern: str | None, recursive: bool) -> str:
    """Describe a folder without (matching) images."""
    pictures = [file for file in files if file.suffix.lower() in PICTURE_SUFFIXES]
    images = [file.name for file in pictures if not is_overlay(file)]
    if images:
        return f"{root} contains no image like '{pattern}': its images are {some_names(images)}. Change the pattern."
    below = [] if recursive else _below(root, PICTURE_SUFFIXES)
    if below:
        return (
            f"{root} contains images in its subfolders only ({some_names(below, 3)}): give '{root}/**' (in Python, "
            "recursive=True) to include them."
        )
    if pictures:
        return f"{root} contains only overlays of fits or scales: name the folder of the images themselves."
    others = Counter(file.suffix.lower() for file in files if file.suffix)
    if others:
        listed = ", ".join(f"{suffix} ({n})" for suffix, n in others.most_common(5))
        return (
            f"{root} contains no image that can be read ({USUAL_SUFFIXES}), only files of type {listed}: convert the "
            "images, or name another folder."
        )
    return f"{root} contains no image ({USUAL_SUFFIXES}): name another folder."


def no_pairs(
    root: Path,
    images_root: Path,
    wanted: Sequence[Path],
    left_out: Sequence[tuple[Path, str]],
    unread: Sequence[Path],
    recursive: bool,
) -> str:
    """Describe a folder in which no image has landmarks; ``left_out`` has files and reasons.

    ``images_root`` is another folder if ``root`` has no images, but files that may hold the landmarks of those there.
    """
    count = f"none of the {len(wanted)} images has landmarks" if len(wanted) > 1 else "its only image has no landmarks"
    if images_root != root:
        beside = f"'{images_root.resolve().name}'" if images_root == Path() else str(images_root)
        count = f"no images in this folder; of the images in {beside}, none has landmarks here"
    text = f"{root}: {count} ({some_names([image.name for image in wanted], 3)})."
    if unread:
        names = some_names([file.name for file in unread])
        suffixes = ", ".join(LANDMARK_SUFFIXES)
        simplest = "the simplest is a .csv of a line 'x,y' and then x,y of each landmark, in pixels"
        remedies = {file.suffix.lower(): NOT_READ.get(file.suffix.lower()) for file in unread}
        more = "".join(f" Of {suffix} files: {remedy}." for suffix, remedy in remedies.items() if remedy)
        return f"{text} Files in an unknown format: {names}. Convert them to one of {suffixes}; {simplest}.{more}"
    absent = [f"{path.name}: {reason}." for path, reason in left_out if reason.startswith(ABSENT)]
    faults = [reason for _, reason in left_out if "cannot be read" in reason]
    if faults:
        faults += absent
        which = "first fault" if len(faults) == 1 else "first faults"
        return f"{root}: no image has readable landmarks. The {which}: {' '.join(faults[:3])}"
    example = f"{wanted[0].stem}.pts"
    orphans = [path for path, reason in left_out if reason == NO_IMAGE]
    elsewhere = [path for path in orphans if path.stem in {image.stem for image in wanted}]
    if absent:
        return f"{text} {absent[0]} Correct these names."
    below = [] if recursive or orphans else _below(root, LANDMARK_SUFFIXES)
    below = below or [path.relative_to(root).as_posix() for path in elsewhere]
    if below:
        return f"{text} Landmark files are in other folders ({some_names(below, 3)}): put each beside its image."
    if orphans:
        names = some_names([path.name for path in orphans])
        return f"{text} Landmark files without an image: {names}. Name each after its image, as in {example}."
    return (
        f"{text} Add a file such as {example} for each image ({', '.join(LANDMARK_SUFFIXES)}), or one file that names "
        "the images."
    )


def _below(root: Path, suffixes: Sequence[str]) -> list[str]:
    """Return the paths, inside a folder, of the files in its subfolders that have one of these suffixes."""

    def paths() -> Iterator[Path]:
        for place, folders, names in os.walk(root):
            folders[:] = sorted(name for name in folders if not name.startswith("."))
            yield from (Path(place, name) for name in sorted(names) if Path(place) != root and name[0] != ".")

    matching = [path for path in islice(paths(), _SEARCHED) if path.suffix.lower() in suffixes]
    return [path.relative_to(root).as_posix() for path in matching]
