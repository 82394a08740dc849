"""From a pile of specimens to checked landmarks, by a scripted person (:mod:`benchmarks.person`) in a browser.

``python -m benchmarks.specimens FOLDER [PICTURES]``, with a folder of fly wings (:mod:`benchmarks.wings`): first 50
pictures with a ``.tps`` are dropped on an empty folder, then 500 pictures, of which 50 have landmarks, are checked,
accepted, measured and exported. Screenshots are kept in the folder LIAAM_ARTEFACTS, if it is set.
"""

import os
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import psutil

from benchmarks.metrics import report
from benchmarks.person import PICTURES, SEEN_ON_WALL, WAIT, Person
from benchmarks.studio import browsing, start
from benchmarks.wings import write_wings
from liaam.io import Landmarks, read_collection

N_LABELLED = 50
SCALE = 0.005  # millimetres a pixel
MEASURES = {"distance": (0, 1), "angle": (0, 1, 2), "area": (2, 3, 4, 5)}
"""Points of the measures by their kind, by index."""

N_DONE = f"{PICTURES}.filter(({{state}}) => state === 'done').length"
IS_TRAINED = "window.liaamStudio.state.project.model"
IS_TRAINING = "(window.liaamStudio.state.project.training.state === 'running')"
IS_CHECKED = "window.liaamStudio.state.project.checked"
IS_FITTED = f"!window.liaamStudio.state.project.fitting && !{PICTURES}.some(({{state}}) => state === 'new')"
HAS_GONE_ON = """name => window.liaamStudio.annotate.name() !== name
  || window.liaamStudio.state.picture(name).state === 'done'"""
HAS_SLIP = "name => Boolean(window.liaamStudio.state.picture(name).slip)"
ON_A_PAGE = """() => {
  const seen = document.querySelector("[data-testid=strip]").getBoundingClientRect();
  return [...document.querySelectorAll("[data-testid=strip] [data-name]")]
    .map((item) => item.getBoundingClientRect())
    .filter(({top, bottom}) => top >= seen.top - 1 && bottom <= seen.bottom + 1).length;
}"""
POINTS = "url => fetch(url).then((answer) => answer.json()).then(({points}) => points)"


@contextmanager
def studio(work: Path) -> Iterator[tuple[Person, Path, psutil.Process]]:
    """Open the studio of an empty folder; give a person at its page, the folder and the server."""
    (folder := work / "specimens").mkdir()
    server = start(folder, "--port", "0", "--no-face")
    with browsing() as page:
        try:
            page.goto(server.address)
            page.wait_for_function("() => window.liaamStudio?.state.project", timeout=WAIT)
            yield Person(page, {}), folder, psutil.Process(server.process.pid)
        finally:
            server.stop()


def used(server: psutil.Process) -> str:
    """Processor seconds of the server and of its trainings."""
    running = sum(sum(each.cpu_times()[:2]) for each in server.children())
    return f"{sum(server.cpu_times()[:4]) + running:.0f} s of processor time"


def shoot(person: Person, name: str) -> None:
    """Keep a screenshot."""
    if folder := os.environ.get("LIAAM_ARTEFACTS"):
        person.page.screenshot(path=Path(folder) / f"specimens-{name}.png")


def few(data: Path) -> None:
    """Drop 50 wings with their .tps, in which two points of one wing are exchanged, on the page of an empty folder."""
    with tempfile.TemporaryDirectory() as work, studio(Path(work)) as (person, _, server):
        person.truth = write_wings(data, Path(work), N_LABELLED, N_LABELLED, slip=True)
        began = time.monotonic()
        person.drop([*(Path(work) / name for name in person.truth), Path(work) / "wings.tps"])
        person.wait(f"() => {N_DONE} === {N_LABELLED}")
        report("specimens_added_s", time.monotonic() - began, used(server), form=".1f")
        person.wait(f"() => {PICTURES}.some(({{slip}}) => slip)")
        slips = {each["name"]: each["slip"] for each in person.pictures() if each["slip"]}
        assert list(slips) == ["wing-000.jpg"], slips
        report("specimens_slip_shown_s", time.monotonic() - began, slips["wing-000.jpg"], form=".1f")
        shoot(person, "slip")
        person.key("w")
        person.correct()
        person.key("Enter")
        began = time.monotonic()
        person.wait(f"() => {IS_TRAINED}")
        report("specimens_trained_s", time.monotonic() - began, used(server), form=".1f")
        shoot(person, "trained")


def many(data: Path, count: int) -> None:
    """From a folder of pictures, of which 50 have landmarks, to all checked, accepted, exported and measured."""
    with tempfile.TemporaryDirectory() as work, studio(Path(work)) as (person, folder, server):
        person.truth = write_wings(data, folder, count, N_LABELLED)
        began = time.monotonic()
        person.page.reload()
        person.wait(f"() => {N_DONE} === {N_LABELLED}")
        share_scale(person)
        person.wait(f"() => {IS_TRAINED} && {IS_FITTED}")
        report("specimens_proposed_s", time.monotonic() - began, used(server), form=".0f")
        look_at_wall(person)
        opened, dragged = finish(person)
        check_all(person, opened > 0)
        saved = export(person, folder)
        waited = f"of the person; {person.waited / 60:.1f} for the machine; {dict(person.did)}"
        report("specimens_minutes", person.seconds / 60, waited, form=".1f")
        what = f"{opened} pictures opened, {dragged} points dragged"
        report("specimens_actions_a_picture", person.actions / count, what, form=".2f")
        worst = [100 * person.error(name, marks.points).max() for name, marks in saved.items()]
        rest = f"of the diagonal; 95 %: {np.quantile(worst, 0.95):.1f}; server {used(server)}"
        report("specimens_worst_point_percent", max(worst), rest, form=".1f")


def share_scale(person: Person) -> None:
    """Draw a scale bar, and use it for all."""
    person.opened()
    person.key("s")
    person.click_at([20, 20])
    person.click_at([420, 20])
    person.type("scale-length", str(400 * SCALE))
    person.click("scale-share")
    person.page.locator(".toast", has_text="Scale set in").wait_for(timeout=WAIT)


def look_at_wall(person: Person) -> None:
    """Glance at all pictures on the wall, open and correct what looks wrong, accept the others and go on."""
    person.key("g")
    person.page.wait_for_timeout(1500)
    shoot(person, "wall")
    order, opened = person.page.evaluate("() => window.liaamStudio.state.order"), 0
    on_a_page = person.page.evaluate(ON_A_PAGE)
    for first in range(0, len(order), on_a_page):
        names = order[first : first + on_a_page]
        person.did["glance"] += len(names)
        points = {name: person.page.evaluate(POINTS, f"/api/pictures/{name}/landmarks") for name in names}
        wrong = [name for name in names if person.error(name, points[name]).max() > SEEN_ON_WALL]
        opened += len(wrong)
        for name in wrong:
            person.click_on(f"[data-testid=strip] [data-name='{name}']")
            person.correct()
            if name != wrong[-1]:
                person.key("g")
        person.key("Shift+Enter")  # also from the last that was opened
        person.page.wait_for_timeout(500)  # until the next pictures are drawn
        if wrong:  # a person takes longer for a page than the check and the training
            person.wait(f"() => {IS_CHECKED}")
            person.page.wait_for_timeout(500)  # until the training has begun
            person.wait(f"() => {IS_TRAINED} && !{IS_TRAINING} && {IS_FITTED}")
    person.wait(f"() => !{PICTURES}.some(({{state, doubtful}}) => state === 'proposed' && !doubtful)")
    done = sum(each["state"] == "done" for each in person.pictures())
    report(
        "specimens_done_on_wall", done - N_LABELLED, f"of {len(order) - N_LABELLED}; {opened} were opened", form=".0f"
    )


def finish(person: Person) -> tuple[int, int]:
    """Open the worst, correct, next, until all are done; return how many were opened, and how many points dragged."""
    opened = dragged = 0
    while any(each["state"] != "done" or each["slip"] for each in person.pictures()):
        if not opened:
            person.key("w")
        name = person.opened()
        moved = person.correct()
        opened, dragged = opened + 1, dragged + moved
        is_none = not moved and person.page.evaluate(HAS_SLIP, name)
        person.key("Enter")
        if is_none:
            person.sign()
            person.wait(f"name => !({HAS_SLIP})(name)", name)
        person.wait(HAS_GONE_ON, name)
    return opened, dragged


def check_all(person: Person, is_in_picture: bool) -> None:
    """Mark all pictures as checked, on the wall."""
    if is_in_picture:
        person.key("g")
    person.key("Control+a")
    person.choose("bulk-action", "checked")
    person.sign()
    person.wait(f"() => {PICTURES}.every(({{checked}}) => checked)")
    shoot(person, "checked")
    person.key("g")


def export(person: Person, folder: Path) -> dict[str, Landmarks]:
    """Save the landmarks with their scales, and a table of three measurements; return the landmarks."""
    person.save(lambda: person.choose("export-all", "tps"), folder.parent / "all.tps")
    person.choose("export-all", "measure")
    for kind, points in MEASURES.items():
        measure(person, kind, points)
    person.save(lambda: person.choose("measure-save", "csv"), folder.parent / "measured.csv")
    rows = (folder.parent / "measured.csv").read_text().splitlines()
    saved = read_collection((folder.parent / "all.tps").rename(folder / "all.tps"))  # beside the pictures
    assert len(saved) == len(rows) - 1 == len(person.truth), (len(saved), len(rows))
    scales = np.array([marks.scale for marks in saved.values()], float)
    assert np.allclose(scales, SCALE, rtol=0.02), scales
    print(rows[0], rows[1], sep="\n")
    return saved


def measure(person: Person, kind: str, points: tuple[int, ...]) -> None:
    """Click the points of a measure, by index."""
    person.click(f"measure-kind-{kind}")
    for point in points:
        person.click_on(f".plot-pick[data-index='{point}']")
    if kind == "area":  # of as many points as one likes
        person.click("measure-add")
    person.page.locator(f"[data-testid=measure-list] li >> nth={list(MEASURES).index(kind)}").wait_for(timeout=WAIT)


if __name__ == "__main__":
    few(Path(sys.argv[1]))
    many(Path(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 500)
