"""Label Studio (``.json`` and its short form): percent of the image's width and height, which the file states.

One file holds many images. Keypoints are named by their labels. Those with one parent are an object. Of several
annotations of an image the first that was not cancelled is read.
"""

import math
from collections import defaultdict
from typing import Any

from liaam.errors import LandmarkError
from liaam.io.landmarks.base import Landmarks, Placing
from liaam.io.landmarks.matching import names_picture
from liaam.io.landmarks.reading import Source, named_points, names_of
from liaam.io.landmarks.text import check_number

_Keypoints = list[dict[str, Any]]


def is_it(source: Source) -> bool:
    """Whether it is a list of tasks, or a task."""
    content = source.json
    return isinstance(content, list) or (isinstance(content, dict) and {"data", "annotations"} <= content.keys())


def parse(source: Source) -> list[Landmarks]:
    """Parse the keypoints of tasks."""
    tasks = source.json if isinstance(source.json, list) else [source.json]
    records = ((f"task {i}", task) for i, task in enumerate(tasks, 1))
    found = [own for objects in source.each(records, lambda task: _objects(source, task)) for own in objects]
    return named_points(source, found)


def _objects(source: Source, task: dict[str, Any]) -> list[Landmarks]:
    """Return the objects of a task, each from its keypoints."""
    done = [each for each in task.get("annotations") or task.get("completions") or () if not each.get("was_cancelled")]
    if len(done) > 1:
        source.notes.say("of several annotations the first is read", str(task.get("id", "")))
    marks = [{**each, **each["value"]} for each in done[0]["result"] if each.get("value")] if done else _lists(task)
    texts = [value for value in task.get("data", task).values() if isinstance(value, str) and "." in value]
    image = next(filter(names_picture, texts), texts[0] if texts else "")
    groups: dict[Any, _Keypoints] = defaultdict(list)
    for mark in marks:
        if "keypointlabels" in mark or ({"labels", "x"} <= mark.keys() and "height" not in mark):
            groups[mark.get("parentID")].append(mark)
    return [_landmarks(image, own) for own in groups.values()]


def _lists(task: dict[str, Any]) -> _Keypoints:
    """Return the marks of a task in the short form."""
    lists = (value for value in task.values() if isinstance(value, list))
    return [each for value in lists for each in value if isinstance(each, dict)]


def _landmarks(image: str, marks: _Keypoints) -> Landmarks:
    points: Any = [[check_number(mark[axis], f"'{image}'") / 100 for axis in "xy"] for mark in marks]
    sizes = {(float(mark["original_width"]), float(mark["original_height"])) for mark in marks}
    if len(sizes) != 1 or not all(math.isfinite(side) and side > 0 for side in next(iter(sizes))):
        raise LandmarkError(f"'{image}' has keypoints for several sizes: label it again.")
    if any(mark.get("image_rotation") for mark in marks):
        raise LandmarkError(f"'{image}' was labelled on a turned picture: turn the image itself, and label that.")
    names = names_of([str((mark.get("keypointlabels") or mark["labels"])[0]) for mark in marks])
    return Landmarks(points, names=names, image_name=image, placing=Placing(next(iter(sizes)), fractions=True))
