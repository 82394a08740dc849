"""Memory of the studio over a working day: ``python -m benchmarks soak``.

A script does what a person does in the page in an hour, through HTTP, against a real ``liaam studio``, as quickly as
the server answers: new pictures, points dragged and saved, edits of the template, trainings, fits with all that they
show, uploads, files taken away, pages opened and closed. It does so eight times. After each hour, and a short rest,
the memory of the server and of its children is measured.
"""

from __future__ import annotations

import json
import shutil
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, quote, urlsplit

import numpy as np

from benchmarks.metrics import report
from benchmarks.studio import Server, start
from liaam.io import Contour, write_image
from liaam.studio.template import Template
from scenes import DIFFUSE, Head, Scene, lateral, make_set

HOURS = 8
SCALE, NOISE = 6, 3.0
"""Pictures are rendered at 320×240, enlarged to 1920×1440, and given a camera's noise (standard deviation of 8-bit
values), so that their files are as large as photographs'."""

METHODS = ("soft-li", "li", "grey", "igo", "chroma")
EXPORTS = ("pts", "ljson", "csv", "json", "overlay", "flat", "shading", "relit")
LIGHTS = ((1, 0, 0.5), (-1, 0, 0.5), (0, -1, 0.5))
REST = 10.0
"""Seconds between the last answer of an hour and the look at the memory."""

BAR_PERCENT = 10.0
"""Growth from the first hour to the last at most."""

AT_ONCE = 6
"""Connections of a browser to one server."""


@dataclass(frozen=True)
class Hour:
    """What a person does in an hour."""

    pictures: int = 30
    by_hand: int = 6
    """Of those, pictures that are annotated before the first training."""
    drags: int = 4
    """Points that are dragged in each picture, each followed by a save."""
    fits: int = 12
    uploads: int = 6
    pages: int = 5
    """Times that the page is opened and closed again."""


# A page of the studio ------------------------------------------------------------------------------


class Page:
    """What a page asks the server for. Answers other than the expected stop the benchmark."""

    def __init__(self, address: str) -> None:
        import httpx

        parts = urlsplit(address)
        token = parse_qs(parts.query)["token"][0]
        self.client = httpx.Client(
            base_url=f"http://{parts.hostname}:{parts.port}",
            headers={"authorization": f"Bearer {token}"},
            limits=httpx.Limits(max_connections=AT_ONCE + 8, max_keepalive_connections=AT_ONCE),
            timeout=300,
            trust_env=False,
        )
        self.n_requests = 0

    def close(self) -> None:
        """End its connections."""
        self.client.close()

    def ask(self, method: str, path: str, **options: Any) -> Any:
        """Give the answer, repeated while the server is busy."""
        for _ in range(30):
            answer = self.client.request(method, f"/api/{path}", **options)
            self.n_requests += 1
            wait = answer.headers.get("retry-after")
            if answer.status_code != 503 or wait is None:
                break
            time.sleep(float(wait))
        answer.raise_for_status()
        return answer

    def get(self, path: str) -> Any:
        """Answer to GET."""
        return self.ask("GET", path)

    def send(self, method: str, path: str, data: Any) -> Any:
        """Send JSON; gives that of the answer."""
        return self.ask(method, path, json=data).json()

    def project(self) -> dict[str, Any]:
        """All that the page shows of the project."""
        return self.get("project").json()

    @contextmanager
    def open(self) -> Iterator[dict[str, Any]]:
        """Open the page: its files, its event stream, the project, and all thumbnails."""
        with self.client.stream("GET", "/api/events") as stream:
            reader = threading.Thread(target=_read_to_the_end, args=(stream,), daemon=True)
            reader.start()
            for file in ("/", "/style.css", "/js/main.js"):
                self.client.get(file).raise_for_status()
            project = self.project()
            names = [picture["name"] for picture in project["pictures"]]
            with ThreadPoolExecutor(AT_ONCE) as pool:
                list(pool.map(self.get, (f"pictures/{quote(name)}/image?size=160" for name in names)))
            yield project
        reader.join(10)

    def train(self) -> None:
        """Train, and wait for the end.

        Raises
        ------
        RuntimeError
            If the training fails.
        """
        self.ask("POST", "training")
        while (state := self.project()["training"])["state"] == "running":
            time.sleep(0.2)
        if state["state"] != "done":
            raise RuntimeError(f"the training ended as {state}")


def _read_to_the_end(stream: Any) -> None:
    import httpx

    try:
        for _ in stream.iter_raw():
            pass
    except (httpx.HTTPError, httpx.StreamError, OSError):  # the page was closed
        return


# What a person does --------------------------------------------------------------------------------


class Person:
    """Does an hour's work.

    Parameters
    ----------
    page : Page
    folder : Path
        Of the studio.
    shelf : sequence of (Path, (n, 2) float)
        Pictures to put into the folder under new names, and their landmarks.
    hour : Hour
    """

    def __init__(
        self, page: Page, folder: Path, shelf: Sequence[tuple[Path, np.ndarray]], hour: Hour | None = None
    ) -> None:
        self.page, self.folder, self.shelf = page, folder, shelf
        self.hour = hour or Hour()
        self.template = _template(len(shelf[0][1]))

    def work(self, number: int) -> None:
        """Work for an hour; pictures of the hour before have gone."""
        rng, truth = np.random.default_rng(number), self._bring(number)
        names = list(truth)
        first, rest = names[: self.hour.by_hand], names[self.hour.by_hand :]
        with self.page.open() as project:
            self._edit_template(project)
            for name in first:
                self._annotate(name, truth[name], rng)
            self.page.train()
            for name in rest:
                self._annotate(name, truth[name], rng)
            self.page.train()
            self._begin_a_training()
            for i in range(self.hour.fits):
                self._fit({"picture": names[i % len(names)]}, i, f"pictures/{quote(names[i % len(names)])}")
            for i in range(self.hour.uploads):
                self._upload(i)
            self.page.get("model/file")
        for _ in range(self.hour.pages - 1):
            with self.page.open():
                pass

    def _bring(self, number: int) -> dict[str, np.ndarray]:
        """Take the old pictures and their landmarks away, and bring new ones; gives their landmarks by name."""
        for path in self.folder.iterdir():
            if path.is_file():
                path.unlink()
        truth = {}
        for i in range(self.hour.pictures):
            path, points = self.shelf[i % len(self.shelf)]
            name = f"hour{number}-{i:03d}{path.suffix}"
            shutil.copyfile(path, self.folder / name)
            truth[name] = points
        return truth

    def _edit_template(self, project: dict[str, Any]) -> None:
        """Set the template, then rename a point, add one, and take it away again."""
        n, revision = len(self.template["names"]), (project["template"] or {}).get("revision")
        renamed = {**self.template, "names": [*self.template["names"][:-1], "renamed"]}
        names = [*self.template["names"], "added"]
        longer = {**self.template, "names": names, "points": None, "mirror": None, "kinds": None}
        same = list(range(n))
        for template, mapping in (
            (self.template, same if revision else None),
            (renamed, same),
            (self.template, same),
            (longer, [*same, None]),
            (self.template, same),
        ):
            answer = self.page.send("PUT", "template", {**template, "mapping": mapping, "revision": revision})
            revision = answer["revision"]

    def _annotate(self, name: str, points: np.ndarray, rng: np.random.Generator) -> None:
        """Look at a picture and its invariant image, and drag points until they are in place."""
        path = f"pictures/{quote(name)}"
        marks = self.page.get(f"{path}/landmarks").json()
        for view in ("image", "chroma"):
            self.page.get(f"{path}/{view}")
        revision, placed = marks["revision"], points + rng.normal(0, 2.0, points.shape)
        for i in range(self.hour.drags):
            placed[i % len(placed)] = points[i % len(points)]
            asked = {"points": placed.round(2).tolist(), "invisible": [], "revision": revision}
            revision = self.page.send("PUT", f"{path}/landmarks", asked)["revision"]
            self.page.project()

    def _begin_a_training(self) -> None:
        """Begin to train, and change one's mind."""
        self.page.ask("POST", "training")
        time.sleep(0.5)
        self.page.ask("DELETE", "training")

    def _upload(self, i: int) -> None:
        path, _ = self.shelf[-1 - i % len(self.shelf)]
        upload = self.page.ask("POST", f"uploads?name=dropped{i}{path.suffix}", content=path.read_bytes()).json()
        self._fit({"upload": upload["id"]}, i, f"uploads/{upload['id']}")

    def _fit(self, what: dict[str, str], i: int, path: str) -> None:
        """Fit a picture and look at all there is to see; take a file away."""
        for view in ("image", "chroma"):
            self.page.get(f"{path}/{view}")
        fit = self.page.send("POST", "fits", {**what, "method": METHODS[i % len(METHODS)]})
        for layer in fit["layers"]:
            self.page.get(f"fits/{fit['id']}/layers/{layer}")
        if "flat" not in fit["layers"]:
            return
        for x, y, z in LIGHTS:
            self.page.get(f"fits/{fit['id']}/relit?light={light_from(x, y, z)}")
        self.page.get(f"fits/{fit['id']}/export?what={EXPORTS[i % len(EXPORTS)]}&light={light_from(1, 0, 1)}")


def light_from(*direction: float) -> str:
    """Return a light for the query of a relit picture."""
    return quote(json.dumps({"lamps": [{"direction": direction}], "ambient": 0.3}))


def _template(n: int) -> Mapping[str, Any]:
    contours = (Contour(tuple(range(min(13, n)))),)
    return Template(tuple(f"point {i + 1}" for i in range(n)), contours).as_json()


def fill_shelf(folder: Path, n: int = 12) -> list[tuple[Path, np.ndarray]]:
    """Write pictures of one person, the last third of them under hard light; gives them with their landmarks."""
    n_lit = n // 3
    scenes = [*make_set(n - n_lit, Head(7), DIFFUSE, seed=3), *make_set(n_lit, Head(7), lateral("left"), seed=4)]
    return [_on_the_shelf(folder, i, scene) for i, scene in enumerate(scenes)]


def _on_the_shelf(folder: Path, i: int, scene: Scene) -> tuple[Path, np.ndarray]:
    import cv2

    path, rng = folder / f"shelf-{i:02d}.jpg", np.random.default_rng(i)
    large = cv2.resize(scene.image, None, fx=SCALE, fy=SCALE, interpolation=cv2.INTER_CUBIC)
    write_image(path, np.clip(large + rng.normal(0, NOISE, large.shape), 0, 255).astype(np.uint8))
    return path, (scene.landmarks + 0.5) * SCALE - 0.5


# The measurement -----------------------------------------------------------------------------------


def resident(server: Server) -> int:
    """Resident memory of a server and its children, bytes."""
    import psutil

    process = psutil.Process(server.process.pid)
    total = 0
    for one in (process, *process.children(recursive=True)):
        try:
            total += one.memory_info().rss
        except psutil.NoSuchProcess:  # it has ended meanwhile
            continue
    return total


def measure(
    hours: int = HOURS,
    hour: Hour | None = None,
    tell: Callable[[int, int, float, int], object] = lambda *_: None,
) -> list[int]:
    """Work for some hours.

    Parameters
    ----------
    hours : int
    hour : Hour, optional
        What is done in each.
    tell : callable
        Told the number of each hour, the memory at its end, the seconds that it took, and the requests so far.

    Returns
    -------
    list of int
        Resident memory at the end of each hour, bytes.
    """
    memory = []
    with tempfile.TemporaryDirectory() as shelf, tempfile.TemporaryDirectory() as folder:
        pictures = fill_shelf(Path(shelf))
        server = start(Path(folder), "--port", "0")
        try:
            with closing(Page(server.address)) as page:
                person = Person(page, Path(folder), pictures, hour)
                for number in range(1, hours + 1):
                    begun = time.monotonic()
                    person.work(number)
                    took = time.monotonic() - begun
                    time.sleep(REST)
                    memory.append(resident(server))
                    tell(number, memory[-1], took, page.n_requests)
        finally:
            server.stop()
    return memory


def _say(number: int, memory: int, seconds: float, n_requests: int) -> None:
    print(f"hour {number}: {memory / 1e6:.0f} MB, {n_requests} requests so far, {seconds:.0f} s", flush=True)


def main() -> None:
    """Report the memory after the first and the last hour, and its growth."""
    memory = measure(tell=_say)
    report("studio_soak_first_hour_mb", memory[0] / 1e6, "MB", form=".0f")
    report("studio_soak_last_hour_mb", memory[-1] / 1e6, f"MB, hour {HOURS}", form=".0f")
    growth = 100.0 * (memory[-1] / memory[0] - 1.0)
    report("studio_soak_growth_percent", growth, f"%, the bar is {BAR_PERCENT:.0f}", form=".1f")


if __name__ == "__main__":
    main()
