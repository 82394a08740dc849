"""The text of landmark files: 300-W ``.pts``, menpo ``.ljson`` (version 2), ``.tps``, COCO and tables."""

import csv
import io
import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import PurePosixPath
from typing import Any

import numpy as np

from liaam.io.landmarks.base import Landmarks, Size, edges_of

Sizes = Mapping[str, Size]  # width and height of images by file name

TPS_DECIMALS = 3
"""Decimals of coordinates in ``.tps``, in pixels: a hundredth of the error of a good fit, and easy to read."""

TPS_MISSING = "-1 -1"
"""A missing landmark in ``.tps``, as tpsDig writes and reads it; geomorph reads it with ``negNA = TRUE``."""


def pts_text(landmarks: Landmarks) -> str:
    """Return the text of a ``.pts`` file."""
    lines = [f"{x + 1!r} {y + 1!r}" for x, y in landmarks.points.tolist()]
    return "\n".join(["version: 1", f"n_points: {len(lines)}", "{", *lines, "}", ""])


def ljson_text(landmarks: Landmarks) -> str:
    """Return the text of an ``.ljson`` file. It labels each named landmark, or all, which menpo requires with edges.

    Contours that have a name are listed as ``curves``, beside the edges of all, since menpo's labels may be names of
    landmarks.
    """
    points = [[None, None] if x != x else [y, x] for x, y in landmarks.points.tolist()]
    edges = edges_of(landmarks.contours)
    body = {"points": points, **({"connectivity": edges} if edges else {})}
    labels = [{"label": name, "mask": [index]} for index, name in enumerate(landmarks.names)]
    if not labels and (landmarks.contours or landmarks.invisible):  # menpo requires that labels cover all landmarks
        labels = [{"label": "all", "mask": list(range(len(landmarks)))}]
    if landmarks.invisible:
        labels.append({"label": "invisible", "mask": list(landmarks.invisible)})
    scale: dict[str, Any] = {} if landmarks.scale is None else {"scale": landmarks.scale}
    if scale and landmarks.unit:
        scale["scale_unit"] = landmarks.unit
    named = [
        {"name": contour.name, "landmarks": [*contour.indices], "closed": contour.closed}
        for contour in landmarks.contours
        if contour.name
    ]
    curves: dict[str, Any] = {"curves": named} if named else {}
    return (
        json.dumps({"labels": labels, "landmarks": body, **curves, **scale, "version": 2}, ensure_ascii=False, indent=1)
        + "\n"
    )


def csv_text(landmarks: Landmarks, more: Mapping[str, str] = {}) -> str:
    """Return the text of a table of one image's landmarks, with the value of each of ``more`` columns in all rows."""
    return csv_of_many({"": landmarks}, {}, more)


def csv_of_many(collection: Mapping[str, Landmarks], _: Sizes, more: Mapping[str, str] = {}) -> str:
    """Return the text of a table of the landmarks of many images, by file name; see :func:`csv_text`."""
    buffer = io.StringIO(newline="")
    titled = any(collection)
    named = any(landmarks.names for landmarks in collection.values())
    writer = csv.writer(buffer)  # lines end in \r\n, so that a \r in a name is quoted
    writer.writerow(["image"] * titled + ["x", "y"] + ["name"] * named + [*more])
    for image, landmarks in collection.items():
        names = landmarks.names or [""] * len(landmarks)
        for (x, y), name in zip(landmarks.points.tolist(), names, strict=True):
            place = ["", ""] if x != x else [repr(x), repr(y)]
            writer.writerow([image] * titled + place + [name] * named + [*more.values()])
    return buffer.getvalue()


def upwards(landmarks: Landmarks, image_size: Size) -> Landmarks:
    """Count y from the other side of an image of (width, height), also of its other objects."""
    x, y = landmarks.points.T
    others = tuple(upwards(other, image_size) for other in landmarks.others)
    return replace(landmarks, points=np.stack([x, image_size[1] - 1 - y], axis=1), others=others)


def tps_text(landmarks: Landmarks) -> str:
    """Return the text of a record of ``.tps``. y counts upwards; a missing landmark is :data:`TPS_MISSING`.

    Open contours of the last landmarks in order are written as curves, as these are read; others are not. Points have
    at most :data:`TPS_DECIMALS` decimals. Further objects of a named image have records of their own. The label of an
    object is its ID, or else the name of the image is. Its side is a comment, such as ``COMMENT=side=left``, which
    other programs skip.
    """
    points = np.round(landmarks.points, TPS_DECIMALS) + 0.0  # no -0.0
    lines = [TPS_MISSING if x != x else f"{x!r} {y!r}" for x, y in points.tolist()]
    curves = [contour.indices for contour in landmarks.contours if not contour.closed]
    tail = [index for curve in curves for index in curve]
    first = len(lines) - len(tail)
    if len(curves) != len(landmarks.contours) or tail != list(range(first, len(lines))):
        curves = []
        first = len(lines)
    text = [f"LM={first}", *lines[:first], *([f"CURVES={len(curves)}"] if curves else [])]
    for curve in curves:
        text += [f"POINTS={len(curve)}", *(lines[index] for index in curve)]
    if landmarks.image_name:
        name = " ".join(landmarks.image_name.splitlines())
        label = " ".join(landmarks.label.split())
        text += [f"IMAGE={name}", f"ID={label or PurePosixPath(name).stem}"]
    text += [] if landmarks.scale is None else [f"SCALE={landmarks.scale!r}"]
    text += [f"COMMENT=side={landmarks.side}"] if landmarks.side else []
    others = landmarks.others if landmarks.image_name else ()  # else all records would be of one unnamed image
    further = "".join(tps_text(replace(other, image_name=landmarks.image_name)) for other in others)
    return "\n".join([*text, ""]) + further


def tps_of_many(collection: Mapping[str, Landmarks], _: Sizes) -> str:
    """Return the text of a ``.tps`` file of many images, by file name. y counts upwards."""
    return "".join(map(tps_text, collection.values()))


def coco_of_many(collection: Mapping[str, Landmarks], sizes: Sizes) -> str:
    """Return the text of a COCO file of many images, by file name.

    Missing landmarks have visibility 0, invisible ones 1, all others 2. Names and contours are those of the first
    image.
    """
    first = next(iter(collection.values()))
    names = first.names or tuple(str(i + 1) for i in range(len(first)))
    edges = [[start + 1, end + 1] for start, end in edges_of(first.contours)]
    images = []
    annotations = []
    for number, (name, landmarks) in enumerate(collection.items(), 1):
        size = dict(zip(("width", "height"), sizes.get(name, ()), strict=False))
        images.append({"id": number, "file_name": name, **size})
        for each in (landmarks, *landmarks.others):
            facts = {"id": len(annotations) + 1, "image_id": number, "category_id": 1, "iscrowd": 0}
            annotations.append({**facts, **_keypoints(each.in_order_of(names))})
    category = {"id": 1, "name": "object", "supercategory": "", "keypoints": list(names), "skeleton": edges}
    return json.dumps({"images": images, "annotations": annotations, "categories": [category]}, ensure_ascii=False)


def _keypoints(landmarks: Landmarks) -> dict[str, Any]:
    placed = landmarks.points[~landmarks.missing]
    low, extent = (placed.min(axis=0), np.ptp(placed, axis=0)) if len(placed) else (np.zeros(2), np.zeros(2))
    flags = [1 if i in landmarks.invisible else 2 for i in range(len(landmarks))]
    triples = zip(landmarks.points.tolist(), flags, strict=True)
    return {
        "keypoints": [value for (x, y), flag in triples for value in ((0, 0, 0) if x != x else (x, y, flag))],
        "num_keypoints": len(placed),
        "bbox": [*low.tolist(), *extent.tolist()],
        "area": float(extent.prod()),
    }
