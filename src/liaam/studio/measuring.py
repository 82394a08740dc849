"""What is measured of the pictures of a project, as its store keeps it: measures, the scale, and what groups pictures.

Measures belong to landmarks. They are kept in the form that ``liaam measure`` takes, with the numbers of their
landmarks, and a change of the template gives them the new numbers. Those that lose a landmark are named as gone.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from liaam.morphometry import Measure
from liaam.morphometry.measures import ScaleBar, indices_of, parse_scale, same_name
from liaam.scale.lengths import Length
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
    nothing: contract.Measuring = {"measures": [], "names": {}, "scale": "", "by": "", "gone": []}
    kept: contract.Measuring = store.get(MEASURING) or nothing
    return {**nothing, **kept}  # earlier versions kept no names


def pixel_by(kept: contract.Measuring) -> contract.Pixel | None:
    """Return the length of a pixel of pictures that have no scale; None if none is given, or by two points."""
    pixel = parse_scale(kept["scale"]) if kept["scale"] else None
    return {"length": pixel.value, "unit": pixel.unit} if isinstance(pixel, Length) else None


def changed(kept: contract.Measuring, asked: contract.SaveMeasuring, names: Sequence[str]) -> contract.Measuring:
    """Return what is measured after a request, with landmarks of these names."""
    add = [] if asked.add is OMITTED else _texts(asked.add, "add")
    remove = [] if asked.remove is OMITTED else _texts(asked.remove, "remove")
    with refusing():
        parsed = [Measure.parse(text) for text in add]
        added = {_numbered(measure, names): measure.name for measure in parsed}
        measures = [text for text in dict.fromkeys([*kept["measures"], *added]) if text not in remove]
        given = {text: name for text, name in added.items() if name} | _new_names(asked.names)
        called = _renamed(kept["names"], given, measures, names)
        scale = kept["scale"] if asked.scale is OMITTED else _numbered_scale(asked.scale, names)
    by = kept["by"] if asked.by is OMITTED else asked.by
    if by not in [*GROUPED_BY]:
        raise Refusal(422, f"pictures cannot be grouped by '{str(by)[:20]}': choose one of {', '.join(GROUPED_BY[1:])}")
    if len(measures) > MOST:
        raise Refusal(422, f"there are {len(measures)} measures, more than the {MOST} allowed: remove some")
    gone = [] if asked.seen is True else kept["gone"]
    return {"measures": measures, "names": called, "scale": scale, "by": by, "gone": gone}


def _new_names(data: Any) -> dict[str, str]:
    if data is OMITTED:
        return {}
    if not isinstance(data, dict) or not all(isinstance(name, str) for name in data.values()):
        raise Refusal(422, "names is not valid: send the name of each measure, such as {'distance:1-5': 'wing length'}")
    return {measure: name.strip() for measure, name in data.items()}


def _renamed(
    before: dict[str, str], given: dict[str, str], measures: Sequence[str], landmarks: Sequence[str]
) -> dict[str, str]:
    """Return the names of measures after some have been given new ones."""
    after = {measure: name for measure, name in (before | given).items() if name and measure in measures}
    for measure, name in given.items():
        replace(Measure.parse(measure), name=name)  # refuses what cannot be a name
        owner = next((each for each in measures if each != measure and _has_name(each, after.get(each), name)), None)
        if name and owner is not None:
            taken = f"'{name}' is the name of another measure ({_described(Measure.parse(owner), landmarks)})"
            raise Refusal(422, f"{taken}: choose another name, or rename that measure first")
    return after


def _has_name(measure: str, called: str | None, name: str) -> bool:
    """Return whether a measure, as it is called, would have the column of a name in tables."""
    return same_name(called or Measure.parse(measure).column, name)


def _described(measure: Measure, landmarks: Sequence[str]) -> str:
    return f"{measure.kind}: {_called(measure.landmarks, landmarks)}"


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
    called = {}
    gone = [*kept["gone"]]
    for text in kept["measures"]:
        measure = Measure.parse(text)
        name = kept["names"].get(text, "")
        if all(number in place for number in measure.landmarks):
            measures.append(_text(measure.kind, [place[number] for number in measure.landmarks]))
            called |= {measures[-1]: name} if name else {}
        else:
            gone.append(f"{name} ({_described(measure, names)})" if name else _described(measure, names))
    scale = kept["scale"]
    bar = parse_scale(scale) if scale else None
    if isinstance(bar, ScaleBar):
        length = scale.rpartition("=")[2]
        if all(number in place for number in bar.ends):
            scale = f"{'-'.join(place[number] for number in bar.ends)}={length}"
        else:
            gone.append(f"scale: {_called(bar.ends, names)} = {length}")
            scale = ""
    return {"measures": measures, "names": called, "scale": scale, "by": kept["by"], "gone": gone}


def columns_of(measures: Sequence[Measure], names: Sequence[str]) -> dict[str, str]:
    """Return the columns of measures by those that names of landmarks make, such as ``distance_base_tip``.

    Measures that have a name keep it.
    Columns stay as they are where names would make two alike.
    """
    named = {}
    for measure in measures:
        indices = indices_of("measures", measure.landmarks, names, len(names))
        own = measure if measure.name else Measure(measure.kind, tuple(names[i] for i in indices))
        named[measure.column] = own.column
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
    if isinstance(bar, Length) and not bar.unit:
        raise Refusal(422, f"scale '{text.strip()}': give its unit, such as '0.005 mm', or '200 px/mm'")
    if not isinstance(bar, ScaleBar):
        return text.strip()
    return f"{'-'.join(_numbers('scale', bar.ends, names))}={text.rpartition('=')[2].strip()}"


def _numbers(what: str, landmarks: Sequence[str], names: Sequence[str]) -> list[str]:
    return [str(index + 1) for index in indices_of(what, landmarks, names, len(names))]


def _text(kind: str, numbers: Sequence[str]) -> str:
    return f"{kind}:{'-'.join(numbers)}"


def _called(numbers: Sequence[str], names: Sequence[str]) -> str:
    return " – ".join(names[int(number) - 1] if int(number) <= len(names) else number for number in numbers)
