"""menpo ``.ljson``: points are [y, x], pixel centres counted from 0; ``null`` for a missing one.

Versions 1 to 3 are read (of several groups in 3, the one that is chosen), and version 2 is written. The edges of the
connectivity are joined into contours. Labels in menpo name sets of landmarks. If each landmark has its own label, the
labels become the names of the landmarks. A further label ``invisible`` holds the occluded landmarks.
"""

import json
from itertools import chain
from pathlib import Path
from typing import Any

from liaam.errors import LandmarkError
from liaam.io.landmarks.base import Landmarks, Source, chain_edges, check_number, edges_of, make_landmarks

_ALL, _INVISIBLE = "all", "invisible"


def parse(source: Source) -> Landmarks:
    """Parse the text of an ``.ljson`` file."""
    path = source.path
    group = _group(source, source.json)
    try:
        rows = group["landmarks"]["points"]
        edges = [(start, end) for start, end in group["landmarks"].get("connectivity") or ()]
        masks = [(str(label["label"]), list(label["mask"])) for label in group.get("labels") or ()]
        pairs = [(x, y) for y, x in rows]
        sound = all(type(index) is int for index in chain(*edges, *(mask for _, mask in masks)))
    except (TypeError, KeyError, ValueError, AttributeError) as fault:
        raise _misshapen(path) from fault
    if not sound:
        raise _misshapen(path)
    points = [
        tuple(check_number(path, value, f"point {number}") for value in pair) for number, pair in enumerate(pairs, 1)
    ]
    masks, invisible = _split(masks, len(points))
    return make_landmarks(path, points, chain_edges(edges), _names(masks, len(points)), invisible=invisible)


def dump(landmarks: Landmarks) -> str:
    """Return the text of a version 2 ``.ljson`` file."""
    points = [[None, None] if x != x else [y, x] for x, y in landmarks.points.tolist()]
    body: dict[str, Any] = {"points": points}
    edges = edges_of(landmarks.contours)
    if edges:
        body["connectivity"] = edges
    content = {"labels": _labels(landmarks), "landmarks": body, "version": 2}
    return json.dumps(content, ensure_ascii=False, indent=1) + "\n"


def _misshapen(path: Path) -> LandmarkError:
    return LandmarkError(
        f"{path} lacks the parts of a menpo .ljson file (landmarks, points as [y, x]): export it again."
    )


def _group(source: Source, content: Any) -> Any:
    """Find the group of landmarks in the content of any version."""
    path, version = source.path, content.get("version") if isinstance(content, dict) else None
    if version == 2:
        return content
    if version not in (1, 3):
        raise LandmarkError(f"{path} is not .ljson version 1, 2 or 3 (it says {version}): export it again with menpo.")
    groups = content.get("groups")
    if version == 1:
        return _joined(path, groups)
    if not isinstance(groups, dict) or not groups:
        raise _misshapen(path)
    wanted = source.reading.group
    if (len(groups) > 1 and wanted is None) or (wanted is not None and wanted not in groups):
        raise LandmarkError(
            f"{path} holds {len(groups)} groups of landmarks ({', '.join(groups)}): choose one of them with --group."
        )
    return next(iter(groups.values())) if wanted is None else groups[wanted]


def _joined(path: Path, groups: Any) -> Any:
    """Join the groups of version 1, which are labelled parts of one shape, as version 2 has them."""
    points, edges, labels = [], [], []
    try:
        for group in groups:
            first, own = len(points), [mark["point"] for mark in group["landmarks"]]
            points += own
            edges += [(start + first, end + first) for start, end in group.get("connectivity") or ()]
            labels.append({"label": group["label"], "mask": list(range(first, len(points)))})
    except (TypeError, KeyError, ValueError) as fault:
        raise _misshapen(path) from fault
    return {"landmarks": {"points": points, "connectivity": edges}, "labels": labels}


def _labels(landmarks: Landmarks) -> list[dict[str, Any]]:
    """Label each named landmark, or else all together, because menpo requires a label if there are edges."""
    hidden = [{"label": _INVISIBLE, "mask": list(landmarks.invisible)}] if landmarks.invisible else []
    if landmarks.names:
        return [{"label": name, "mask": [index]} for index, name in enumerate(landmarks.names)] + hidden
    if not landmarks.contours and not hidden:  # menpo requires that labels cover all landmarks
        return []
    return [{"label": _ALL, "mask": list(range(len(landmarks)))}, *hidden]


_Mask = tuple[str, list[int]]


def _split(masks: list[_Mask], n_points: int) -> tuple[list[_Mask], list[int]]:
    """Separate the label of invisible landmarks from the others. "invisible" may also be a landmark's name."""
    at = [i for i, (label, _) in enumerate(masks) if label == _INVISIBLE]
    if not at or _names(masks, n_points):
        return masks, []
    others = masks[: at[-1]] + masks[at[-1] + 1 :]
    # `_labels` writes the label "all" for a single landmark without a name.
    return ([] if others == [(_ALL, [0])] else others), masks[at[-1]][1]


def _names(masks: list[_Mask], n_points: int) -> tuple[str, ...]:
    """Return the labels as names, if each landmark has exactly one label of its own."""
    by_index = {mask[0]: label for label, mask in masks if len(mask) == 1}
    if len(masks) != n_points or set(by_index) != set(range(n_points)):
        return ()
    return tuple(by_index[index] for index in range(n_points))
