"""The way of an image from ``liaam.fit`` to the core is short: a reader follows it module by module."""

import sys
from itertools import groupby
from pathlib import Path

import pytest

import liaam
from liaam import _core
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


def ways_to_the_core(fit) -> set[tuple[str, ...]]:
    """Modules on the way to each call of the core for a whole fit."""
    ways = set()

    def watch(frame, event, _argument):
        if event == "call" and frame.f_code.co_name == "_call":  # which calls the core
            ways.add(tuple(modules_on_the_stack(frame)))

    before = sys.getprofile()
    sys.setprofile(watch)
    try:
        fit()
    finally:
        sys.setprofile(before)
    return ways


@pytest.mark.skipif(not _core.BUILT, reason="the core is not built")
@pytest.mark.parametrize("method", ["soft-li", "li"])
def test_the_way_to_the_core_is_short_and_never_climbs_back(model, lit_scene, method):
    about = disturb(lit_scene.landmarks), method
    (way,) = ways_to_the_core(lambda: liaam.fit(model, lit_scene.image, *about, restarts=False, max_iterations=1))
    assert way[-1] == "fitting/levels.py"
    assert len(way) <= 7
    assert len(set(way)) == len(way)


@pytest.mark.skipif(not _core.BUILT, reason="the core is not built")
def test_so_is_that_of_a_doubtful_fit(calibrated, lit_scene):
    far = disturb(lit_scene.landmarks, 0.7, (0.12, -0.04))
    box = [*far.min(axis=0), *far.max(axis=0)]
    ways = ways_to_the_core(lambda: liaam.fit(calibrated, lit_scene.image, box))
    through = {name for way in ways for name in way}
    assert {"fitting/other_places.py", "fitting/search.py"} < through
    assert all(len(way) <= 7 and len(set(way)) == len(way) for way in ways), ways
