"""StereoMorph's shapes files (``.txt``, one an image): pixels, taken as centres counted from 0, y downwards.

The matrix ``landmarks.pixel`` has rows of name, x and y. Curves are not read.
"""

import re
from typing import Any

from liaam.errors import LandmarkError
from liaam.io.landmarks.base import Landmarks
from liaam.io.landmarks.reading import Source
from liaam.io.landmarks.text import parse_point

_START = re.compile(r"<landmarks\.pixel\b[^<>]*>")
_IMAGE = re.compile(r"<image\.name\b[^<>]*>([^<]*)</image\.name\s*>")


def is_it(source: Source) -> bool:
    """Whether it has elements of landmarks in pixels."""
    return "<landmarks.pixel" in source.text


def parse(source: Source) -> Landmarks:
    """Parse the landmarks of a file."""
    start, image = _START.search(source.text), _IMAGE.search(source.text)
    matrix, end, _ = source.text[start.end() :].partition("</landmarks.pixel") if start else ("", "", "")
    if not end:
        raise LandmarkError("it is cut short within its landmarks: export it again.")
    lines = [line.strip() for line in matrix.splitlines() if line.strip()]
    rows = [re.split(r"\t+| +(?=\S+$)| +(?=\S+\s+\S+$)", line) for line in lines]
    rows = [[cell.strip("\"' ") for cell in row] for row in rows if len(row) in (2, 3) and row[-1].strip("\"'") != "y"]
    points: Any = [parse_point(row[-2:], f"'{row[0]}'") for row in rows]
    names = tuple(row[0] for row in rows if len(row) == 3)
    return Landmarks(points, (), names, image[1].strip("\"' \n\t") if image else None)
