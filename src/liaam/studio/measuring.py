"""What is measured of the pictures of a project, as its store keeps it: measures, the scale, and what groups pictures.

Measures belong to landmarks. They are kept in the form that ``liaam measure`` takes, with the numbers of their
landmarks, and a change of the template gives them the new numbers. Those that lose a landmark are named as gone.
"""

from collections.abc import Sequence
from typing import Any

from liaam.morphometry import Measure
from liaam.morphometry.measures import ScaleBar, indices_of, parse_scale
from liaam.studio import contract
from liaam.studio.contract import OMITTED
from liaam.studio.refusal import Refusal, refusing
from liaam.studio.store import Store

MEASURING = "measuring"
"""Kind of it in the store."""

GROUPS = "groups"
"""Kind of the table of groups in the store: the group of each specimen, by its name there."""

GROUPED_BY = ("", "folder", "name", "table")
"""What pictures are grouped by: nothing, their subfolder, the letters that names begin with, or a table."""

MOST = 200
"""Largest number of measures that are kept."""


def kept_in(store: Store) -> contract.Measuring:
    """Return what is measured in a folder, or a set of its landmarks."""
    nothing: contract.Measuring = {"measures": [], "scale": "", "by": "", "gone": []}
    return store.get(MEASURING) or nothing


def changed(kept: contract.Measuring, asked: contract.SaveMeasuring, names: Sequence[str]) -> contract.Measuring:
    """Return what is measured after a request, with landmarks of these names."""
    add = [] if asked.add is OMITTED else _texts(asked.add, "add")
    remove = [] if asked.remove is OMITTED else _texts(asked.remove, "remove")
    with refusing():
        added = [_numbered(Measure.parse(text), names) for text in add]
        measures = [text for text in dict.fromkeys([*kept["measures"], *added]) if text not in remove]
        scale = kept["scale"] if asked.scale is OMITTED else _numbered_scale(asked.scale, names)
    by = kept["by"] if asked.by is OMITTED else asked.by
    if by not in [*GROUPED_BY]:
        raise Refusal(422, f"pictures cannot be grouped by '{str(by)[:20]}': choose one of {', '.join(GROUPED_BY[1:])}")
    if len(measures) > MOST:
        raise Refusal(422, f"there are {len(measures)} measures, more than the {MOST} allowed: remove some")
    return {"measures": measures, "scale": scale, "by": by, "gone": [] if asked.seen is True else kept["gone"]}


def followed(kept: contract.Measuring, mapping: Sequence[int | None], names: Sequence[str]) -> contract.Measuring:
    """Return what is measured after a change of the template.

    Parameters
    ----------
    kept : dict
        Before the change.
    mapping : sequence of int
        The old index of each landmark; None of a new one.
    names : sequence of str
        The old names.
    """
    place = {str(old + 1): str(new + 1) for new, old in enumerate(mapping) if old is not None}
    measures = []
    gone = [*kept["gone"]]
    for text in kept["measures"]:
        measure = Measure.parse(text)
        if all(number in place for number in measure.landmarks):
            measures.append(_text(measure.kind, [place[number] for number in measure.landmarks]))
        else:
            gone.append(f"{measure.kind}: {_called(measure.landmarks, names)}")
    scale = kept["scale"]
    bar = parse_scale(scale) if scale else None
    if isinstance(bar, ScaleBar):
        length = scale.rpartition("=")[2]
        if all(number in place for number in bar.ends):
            scale = f"{'-'.join(place[number] for number in bar.ends)}={length}"
        else:
            gone.append(f"scale: {_called(bar.ends, names)} = {length}")
            scale = ""
    return {"measures": measures, "scale": scale, "by": kept["by"], "gone": gone}


def columns_of(measures: Sequence[Measure], names: Sequence[str]) -> dict[str, str]:
    """Return the columns of measures by those that names of landmarks make, such as ``distance_base_tip``.

    Columns stay as they are where names would make two alike.
    """
    named = {}
    for measure in measures:
        indices = indices_of("measures", measure.landmarks, names, len(names))
        named[measure.column] = Measure(measure.kind, tuple(names[i] for i in indices)).column
    unique = [column for column in named.values() if [*named.values()].count(column) == 1]
    return {column: name for column, name in named.items() if name in unique}


def _texts(data: Any, what: str) -> list[str]:
    if not isinstance(data, list) or not all(isinstance(text, str) for text in data):
        raise Refusal(422, f"{what} is not valid: send a list of measures, such as distance:1-5")
    return data


def _numbered(measure: Measure, names: Sequence[str]) -> str:
    """Return a measure with the numbers of its landmarks."""
    return _text(measure.kind, _numbers("measures", measure.landmarks, names))


def _numbered_scale(text: Any, names: Sequence[str]) -> str:
    """Return a scale with the numbers of the landmarks at the ends of a bar."""
    if not isinstance(text, str):
        raise Refusal(422, "scale is not valid: send text, such as 11-12=5 mm")
    bar = parse_scale(text) if text.strip() else None
    if not isinstance(bar, ScaleBar):
        return text.strip()
    return f"{'-'.join(_numbers('scale', bar.ends, names))}={text.rpartition('=')[2].strip()}"


def _numbers(what: str, landmarks: Sequence[str], names: Sequence[str]) -> list[str]:
    return [str(index + 1) for index in indices_of(what, landmarks, names, len(names))]


def _text(kind: str, numbers: Sequence[str]) -> str:
    return f"{kind}:{'-'.join(numbers)}"


def _called(numbers: Sequence[str], names: Sequence[str]) -> str:
    return " – ".join(names[int(number) - 1] if int(number) <= len(names) else number for number in numbers)
