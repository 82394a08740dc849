"""The way of an image from ``liaam.fit`` to the cost of eq 10 and back is short, and goes through each module once."""

import sys
from collections import Counter
from pathlib import Path

import pytest

import liaam
from liaam import _core
from setups import disturb

WALK = (
    "single",  # fitters that are kept
    "fitter",  # image and start
    "search/starts",
    "one_shape_fitter",
    "loop/levels",  # the core's call, in which eq 10 is minimised
    "loop/encoded_image",
    "quality",
    "low_quality",
)
"""Modules of ``liaam.fitting`` in the order in which a fit comes to them, as CONTRIBUTING.md lists them."""

RECORDS = {"methods", "result", "detection", "loop/options", "loop/objective"}
"""Modules whose functions a fit only asks for what they hold."""

STEPS = ("fit", "target", "start_shape", "fit_target", "_call", "result_of", "fit_elsewhere")

FITTING = Path(liaam.fitting.__file__).parent


def room_of(code) -> str | None:
    """Return the module of a function of ``liaam.fitting``, of a package with one door the package; else None."""
    path = Path(code.co_filename)
    if not path.is_relative_to(FITTING):
        return None
    room = path.relative_to(FITTING).with_suffix("").as_posix()
    return "quality" if room.startswith("quality/") else room


@pytest.mark.skipif(not _core.BUILT, reason="the core is not built")
@pytest.mark.parametrize("start", ["shape", "box"])
def test_the_walk_is_short_and_goes_through_each_module_once(calibrated, lit_scene, start):
    shape = disturb(lit_scene.landmarks)
    init = shape if start == "shape" else (*shape.min(axis=0), *shape.max(axis=0))
    liaam.fit(calibrated, lit_scene.image, init)  # what is prepared once
    rooms: list[str] = []
    steps: Counter[tuple[str, str]] = Counter()

    def follow(frame, event, _):
        room = room_of(frame.f_code) if event == "call" else None
        if room is not None and room not in RECORDS:
            rooms.append(room)
            if frame.f_code.co_name in STEPS:
                steps[room, frame.f_code.co_name] += 1

    sys.setprofile(follow)
    try:
        result = liaam.fit(calibrated, lit_scene.image, init)
    finally:
        sys.setprofile(None)
    assert result.status.ok
    assert tuple(dict.fromkeys(rooms)) == WALK
    assert len(steps) >= len(STEPS)
    assert set(steps.values()) == {1}


def test_contributors_find_the_walk():
    text = (Path(__file__).parents[2] / "CONTRIBUTING.md").read_text(encoding="utf-8")
    _, _, of_walk = text.partition("A fit from a start goes through")
    places = [of_walk.index(f"`{room}`") for room in WALK]
    assert places == sorted(places)
