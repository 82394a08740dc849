"""Label Studio (``.json`` and its short form): percent of the image's width and height, which the file states.

One file holds many images. Keypoints are named by their labels. Those with one parent are an object. Of several
annotations of an image the first that was not cancelled is read.
"""

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

from liaam.errors import LandmarkError
from liaam.io.landmarks.base import (
    Landmarks,
    Placing,
    Source,
    check_number,
    in_objects,
    make_landmarks,
    named_points,
)

_Keypoints = list[dict[str, Any]]


def is_it(source: Source) -> bool:
    """Whether it is a list of tasks, or a task."""
    return isinstance(source.json, list) or (
        isinstance(source.json, dict) and {"data", "annotations"} <= source.json.keys()
    )


def parse(source: Source) -> dict[str, Landmarks]:
    """Parse the text of an export into landmarks by the image's file name."""
    tasks = source.json if isinstance(source.json, list) else [source.json]
    records = ((f"task {i}", task) for i, task in enumerate(tasks, 1))
    found = [own for objects in source.each(records, lambda task: _objects(source, task)) for own in objects]
    if not found:
        raise LandmarkError(f"{source.path} is Label Studio's without keypoints: label at least one image.")
    return in_objects(named_points(source, found))


def _objects(source: Source, task: dict[str, Any]) -> list[Landmarks]:
    """Return the objects of a task, each from its keypoints."""
    done = [each for each in task.get("annotations") or () if not each.get("was_cancelled")]
    facts = task.get("data", task)
    if len(done) > 1:
        source.notes.say("of several annotations the first is read", str(task.get("id", "")))
    marks = _results(done[0]["result"]) if done else list(_lists(task))
    image = next((str(value) for value in facts.values() if isinstance(value, str) and "." in value), "")
    groups: dict[Any, _Keypoints] = {}
    for mark in marks:
        groups.setdefault(mark.get("parentID"), []).append(mark)
    return [_landmarks(source, image, own) for own in groups.values()]


def _results(results: list[dict[str, Any]]) -> _Keypoints:
    return [{**each, **each["value"]} for each in results if "keypointlabels" in (each.get("value") or ())]


def _lists(task: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield the keypoints of a task in the short form."""
    for value in task.values():
        for each in value if isinstance(value, list) else ():
            if isinstance(each, dict) and "keypointlabels" in each:
                yield each


def _landmarks(source: Source, image: str, marks: _Keypoints) -> Landmarks:
    names = [str(mark["keypointlabels"][0]) for mark in marks]
    points = [[check_number(source.path, mark[axis], f"'{image}'") / 100 for axis in "xy"] for mark in marks]
    sizes = {(float(mark["original_width"]), float(mark["original_height"])) for mark in marks}
    if len(sizes) != 1 or not all(math.isfinite(side) and side > 0 for side in next(iter(sizes))):
        raise LandmarkError(f"{source.path}: '{image}' has keypoints for several sizes: label it again.")
    same = len(set(names)) == 1 < len(names)
    made = make_landmarks(source.path, points, names=() if same else names, image_name=image)
    return replace(made, placing=Placing(next(iter(sizes)), fractions=True))
