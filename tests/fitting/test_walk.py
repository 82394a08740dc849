"""The way of an image from ``liaam.fit`` to the loop is short: a reader follows it module by module."""

import sys
from itertools import groupby
from pathlib import Path

import pytest

import liaam
from setups import disturb

SOURCE = Path(liaam.__file__).parent


def modules_on_the_stack(frame) -> list[str]:
    """Modules of liaam from the outermost call to the innermost, each once in a row."""
    files = []
    while frame is not None:
        files.append(Path(frame.f_code.co_filename))
        frame = frame.f_back
    inside = [str(file.relative_to(SOURCE)) for file in reversed(files) if file.is_relative_to(SOURCE)]
    return [name for name, _ in groupby(inside)]


@pytest.mark.parametrize("method", ["soft-li", "li"])
def test_the_way_to_the_loop_is_short_and_never_climbs_back(model, lit_scene, method):
    ways = set()

    def watch(frame, event, _argument):
        if event == "call" and frame.f_code.co_name == "solve_level":
            ways.add(tuple(modules_on_the_stack(frame)))

    before = sys.getprofile()
    sys.setprofile(watch)
    try:
        # The reference kernel runs the loop's own lines in Python, where they can be watched.
        settings = {"kernel": "reference", "restarts": False, "max_iterations": 1}
        liaam.fit(model, lit_scene.image, disturb(lit_scene.landmarks), method, **settings)
    finally:
        sys.setprofile(before)
    (way,) = ways
    assert way[-1] == "fitting/loop.py"
    assert len(way) <= 8
    assert len(set(way)) == len(way)
