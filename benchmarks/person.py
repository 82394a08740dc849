"""A scripted person at the studio's page, whose time is the sum of fixed times for each action and look.

The person knows where the points are, and sees on the wall what is off by 2 % of the object's size, and in an
open picture what is off by 1 %. The time for which the person waits for the machine is added up apart.
"""

import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from liaam.model.shape import diagonal_of

SECONDS = {"click": 1.2, "key": 0.6, "drag": 2.5, "typed": 4.0, "look": 2.0, "glance": 0.8}
"""A click with finding its target, a key, a drag of a point or a slider, a text that is typed; and, which are no
actions, a look at an open picture, and a glance at one picture of the wall."""

LOOKS = ("look", "glance")
SEEN_ON_WALL, SEEN_OPEN = 0.02, 0.01
WAIT = 300_000  # milliseconds
PICTURES = "(window.liaamStudio?.state.project?.pictures ?? [])"

DROP = """(input) => {
  const transfer = new DataTransfer();
  for (const file of input.files) transfer.items.add(file);
  for (const type of ["dragenter", "dragover", "drop"])
    document.body.dispatchEvent(new DragEvent(type, {dataTransfer: transfer, bubbles: true, cancelable: true}));
  input.remove();
}"""
INPUT = """() => document.body.append(
  Object.assign(document.createElement("input"), {type: "file", multiple: true, id: "by-hand"}))"""


@dataclass
class Person:
    """Acts on a page, and counts what is done."""

    page: Any
    truth: dict[str, np.ndarray]
    """Landmarks by picture."""
    did: Counter = field(default_factory=Counter)
    """How often each of :data:`SECONDS` was done."""
    waited: float = 0.0
    """Seconds."""
    signed: bool = False
    """Whether the page knows the person's name."""

    @property
    def actions(self) -> int:
        """Number of clicks, keys, drags and typed texts."""
        return sum(count for what, count in self.did.items() if what not in LOOKS)

    @property
    def seconds(self) -> float:
        """Time of all actions and looks."""
        return sum(SECONDS[what] * count for what, count in self.did.items())

    def click(self, testid: str) -> None:
        """Click a control."""
        self.click_on(f"[data-testid={testid}]")

    def click_on(self, selector: str) -> None:
        """Click an element."""
        self.did["click"] += 1
        self.page.locator(selector).click(timeout=WAIT)

    def click_at(self, point: Any) -> None:
        """Click a position of the open picture."""
        self.did["click"] += 1
        self.page.mouse.click(*self._at(point))

    def choose(self, testid: str, value: str) -> None:
        """Open a menu and choose from it."""
        self.did["click"] += 2
        self.page.locator(f"[data-testid={testid}]").select_option(value, timeout=WAIT)

    def type(self, testid: str, text: str) -> None:
        """Type a text into a field."""
        self.did["typed"] += 1
        self.page.locator(f"[data-testid={testid}]").fill(text, timeout=WAIT)

    def sign(self) -> None:
        """Give a name for the history, for which the page asks once."""
        if self.signed:
            return
        self.signed = True
        self.type("who", "Ada")
        self.click("who-save")

    def key(self, key: str) -> None:
        """Press a key."""
        self.did["key"] += 1
        self.page.keyboard.press(key)

    def drop(self, paths: list[Path]) -> None:
        """Drop files on the page."""
        self.did["drag"] += 1
        self.page.evaluate(INPUT)
        self.page.locator("#by-hand").set_input_files([str(path) for path in paths])
        self.page.locator("#by-hand").evaluate(DROP)

    def save(self, act: Any, path: Path) -> None:
        """Do what downloads a file."""
        with self.page.expect_download(timeout=WAIT) as waited:
            act()
        waited.value.save_as(path)

    def wait(self, condition: str, argument: Any = None) -> None:
        """Wait until JavaScript says yes."""
        began = time.monotonic()
        self.page.wait_for_function(condition, arg=argument, timeout=WAIT, polling=50)
        self.waited += time.monotonic() - began

    def pictures(self) -> list[dict[str, Any]]:
        """What the page knows of all pictures."""
        return self.page.evaluate(f"() => {PICTURES}")

    def opened(self) -> str:
        """Wait until a picture is open; return its name."""
        self.wait("() => window.liaamStudio.annotate?.source()")
        return self.page.evaluate("() => window.liaamStudio.annotate.name()")

    def error(self, name: str, points: Any) -> np.ndarray:
        """Error of each point, as a fraction of the object's size."""
        return np.linalg.norm(np.array(points, float) - self.truth[name], axis=1) / diagonal_of(self.truth[name])

    def correct(self) -> int:
        """Look at the open picture, and drag what is off; return how many points."""
        name = self.opened()
        self.did["look"] += 1
        shown = self.page.evaluate("() => window.liaamStudio.annotate.points()")
        off = np.flatnonzero(self.error(name, shown) > SEEN_OPEN)
        for i in off:
            self.did["drag"] += 1
            self.page.mouse.move(*self._at(int(i)))
            self.page.mouse.down()
            self.page.mouse.move(*self._at(self.truth[name][i].tolist()), steps=3)
            self.page.mouse.up()
        return len(off)

    def _at(self, point: Any) -> list[float]:
        return self.page.evaluate("where => window.liaamStudio.annotate.toClient(where)", point)
