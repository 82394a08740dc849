"""Find images that are copies of each other."""

from collections import defaultdict
from collections.abc import Iterable, Sequence
from pathlib import Path

from liaam.datasets.dataset import Sample
from liaam.io.files import fingerprint_of, some_names


def copies_among(files: Iterable[Path]) -> list[list[Path]]:
    """Return the groups of files that have the same content. Only files of equal size are read."""
    of_size = defaultdict[int, list[Path]](list)
    for file in dict.fromkeys(files):
        if file.is_file():
            of_size[file.stat().st_size].append(file)
    groups = defaultdict[str, list[Path]](list)
    for file in (file for files in of_size.values() if len(files) > 1 for file in files):
        groups[fingerprint_of(file)].append(file)
    return [group for fingerprint, group in groups.items() if fingerprint and len(group) > 1]


def copies_fault(samples: Sequence[Sample]) -> str:
    """Return a sentence if images of several samples are copies of each other; several objects of one image are not."""
    groups = copies_among(sample.image for sample in samples if isinstance(sample.image, Path))
    if not groups:
        return ""
    named = some_names([" = ".join(file.name for file in group) for group in groups], 3)
    return (
        f"copies of one image: {named}; keep one of each, since models that are trained on one would be judged by the "
        "other"
    )
