"""menpo ``.ljson``: points are [y, x], pixel centres counted from 0; ``null`` for a missing one.

Versions 1 to 3 are read; of several groups in 3, the one that is chosen. The edges of the connectivity are joined into
contours. Labels in menpo name sets of landmarks. If each landmark has its own label, the labels become the names of the
landmarks. A further label ``invisible`` holds the occluded landmarks. The length of a pixel, ``scale``, is an addition
of liaam, which menpo ignores.
"""

from itertools import chain
from typing import Any

from liaam.errors import LandmarkError
from liaam.io.landmarks.base import Landmarks
from liaam.io.landmarks.contours import chain_edges
from liaam.io.landmarks.reading import Source
from liaam.io.landmarks.text import check_number

_Mask = tuple[str, list[int]]


def parse(source: Source) -> Landmarks:
    """Parse the group of an image."""
    group = _group(source.json, source.reading.category)
    edges = [(start, end) for start, end in group["landmarks"].get("connectivity") or ()]
    masks = [(str(label["label"]), list(label["mask"])) for label in group.get("labels") or ()]
    pairs = [(x, y) for y, x in group["landmarks"]["points"]]
    if not all(type(index) is int for index in chain(*edges, *(mask for _, mask in masks))):
        raise TypeError("an index is no whole number")
    points: Any = [
        tuple(check_number(value, f"point {number}") for value in pair) for number, pair in enumerate(pairs, 1)
    ]
    masks, invisible = _split(masks, len(points))
    scale = None if group.get("scale") is None else float(check_number(group["scale"], "the scale"))
    return Landmarks(points, chain_edges(edges), _names(masks, len(points)), None, tuple(invisible), scale)


def _group(content: Any, wanted: str | None) -> Any:
    """Find the group of landmarks in the content of any version."""
    version = content.get("version") if isinstance(content, dict) else None
    if version == 2:
        return content
    if version not in (1, 3):
        raise LandmarkError(f"this is not .ljson version 1, 2 or 3 (it says {version}): export it again with menpo.")
    groups = content["groups"]
    if version == 1:
        return _joined(groups)
    if (len(groups) > 1 and wanted is None) or (wanted is not None and wanted not in groups):
        raise LandmarkError(
            f"it holds {len(groups)} groups of landmarks ({', '.join(groups)}): choose one of them with --category."
        )
    return groups[wanted or next(iter(groups), "")]


def _joined(groups: Any) -> Any:
    """Join the groups of version 1, which are labelled parts of one shape, as version 2 has them."""
    points, edges, labels = [], [], []
    for group in groups:
        first, own = len(points), [mark["point"] for mark in group["landmarks"]]
        points += own
        edges += [(start + first, end + first) for start, end in group.get("connectivity") or ()]
        labels.append({"label": group["label"], "mask": list(range(first, len(points)))})
    return {"landmarks": {"points": points, "connectivity": edges}, "labels": labels}


def _split(masks: list[_Mask], n_points: int) -> tuple[list[_Mask], list[int]]:
    """Separate the label of invisible landmarks from the others. "invisible" may also be a landmark's name."""
    at = [i for i, (label, _) in enumerate(masks) if label == "invisible"]
    if not at or _names(masks, n_points):
        return masks, []
    others = masks[: at[-1]] + masks[at[-1] + 1 :]
    # The label "all" is written for a single landmark without a name.
    return ([] if others == [("all", [0])] else others), masks[at[-1]][1]


def _names(masks: list[_Mask], n_points: int) -> tuple[str, ...]:
    """Return the labels as names, if each landmark has exactly one label of its own."""
    by_index = {mask[0]: label for label, mask in masks if len(mask) == 1}
    whole = len(masks) == n_points and by_index.keys() == set(range(n_points))
    return tuple(by_index[index] for index in range(n_points)) if whole else ()
