"""Several sets of landmarks in a folder: other points, or the same points placed by another observer; their agreement.

The landmarks of the first set, "", lie beside the pictures, those of a further one in a subfolder of its name. Each set
has a template, proposals, reviews and a model of its own.
"""

import threading
from functools import partial
from typing import Any

import numpy as np

from liaam.evaluation import finite_or_none
from liaam.io.images import PICTURE_SUFFIXES
from liaam.io.table_writer import columns_text
from liaam.morphometry import Specimen, measure, measurement_error
from liaam.studio.folder import ADDED, SET_NAME, disk_errors, plain_name, sets_in
from liaam.studio.project import Project
from liaam.studio.safety import Refusal
from liaam.studio.store import DATABASE, Store
from liaam.tables import Columns


class Sets:
    """The sets of landmarks of a folder by name, each a :class:`Project`; thread-safe."""

    def __init__(self, first: Project) -> None:
        self._first, self._projects, self._lock = first, {"": first}, threading.Lock()

    @property
    def names(self) -> list[str]:
        """The names of all sets."""
        return ["", *sets_in(self._first.folder)]

    def get(self, name: str) -> Project:
        """Return the project of a set."""
        with self._lock:
            if name not in self._projects:
                if name not in self.names:
                    raise Refusal(404, f"the folder has no set of landmarks '{name[:40]}'")
                self._projects[name] = Project(self._first.root, self._first.settings, name, self._first)
            return self._projects[name]

    def make(self, data: Any, by: Project) -> dict[str, str]:
        """Make a set with the ``name`` in a request; if ``same``, of the points of the set from which it comes.

        A subfolder of this name that holds landmark files, but no pictures, becomes the set's.
        """
        data = by.checked(data, "name and same")
        name, template = data.get("name"), by.templates.needed if data.get("same") else None
        if not isinstance(name, str) or not SET_NAME.fullmatch(name):
            raise Refusal(422, "the name is not valid: use at most 30 letters from A to Z, digits, - and _")
        if name.casefold() in (ADDED, *map(str.casefold, self.names)):
            raise Refusal(409, f"the name {name} is taken: choose another one")
        place = self._first.root / name
        with disk_errors(f"{name} cannot be made", error=partial(Refusal, 503)):
            if place.is_symlink() or (place.exists() and not place.is_dir()):
                raise Refusal(409, f"{name} is a file or a link beside the pictures: choose another name")
            if any(path.suffix.lower() in PICTURE_SUFFIXES for path in place.rglob("*")):
                raise Refusal(409, f"{name} is a subfolder with pictures: choose another name")
            place.mkdir(exist_ok=True)
        Store(self._first.folder, name).path(DATABASE)  # makes its folder, by which the set is known
        made = self.get(name)
        made.store.put("declined", {"": True})  # the points of the face model are the first set's, or of no use here
        if template is not None and made.templates.current is None:
            made.save_template({**template.as_json(), "points": None})  # they may be where the other placed them
        return {"name": name}

    def others(self, of: Project, picture: str) -> dict[str, Any]:
        """Return all points that other observers placed on a picture, by set; refused before it is done in this set."""
        marks = {name: self.get(name).marks(picture) for name in self.observers(of)}
        placed = {name: own["points"] for name, own in marks.items() if own["source"] == "file"}
        done = {name: points for name, points in placed.items() if None not in points}
        if done.pop(of.set_name, None) is None:
            raise Refusal(409, "the points of other observers are shown once all points are placed")
        return done

    def agreement(self, of: Project) -> dict[str, Any]:
        """Return how far observers of a set's points are apart, as standard deviations, from the largest one on."""
        pictures = self._compared(of)
        table = _errors(pictures, of)
        rows = list(zip(table["measure"], table["sd"], table["sd_percent"], strict=True))
        points = [(name.removeprefix("landmark "), *own) for name, *own in rows if name.startswith("landmark ")]
        overall = np.sqrt(np.square([own for _, *own in points]).mean(axis=0))
        spread = {name: _spread(list(own.values())) for name, own in pictures.items()}
        return {
            "observers": sorted({observer for own in pictures.values() for observer in own}),
            "sd": finite_or_none(overall[0]),
            "percent": finite_or_none(overall[1]),
            "repeatability": finite_or_none(table["repeatability"][0]),
            "points": sorted(points, key=lambda row: -row[1]),
            "pictures": sorted(spread.items(), key=lambda item: -item[1]),
        }

    def agreement_table(self, of: Project) -> tuple[str, bytes]:
        """Return the name and the content of a table of measurement errors, with observers as replicates."""
        columns = _errors(self._compared(of), of)
        return f"{plain_name(of.title)}-agreement.csv", columns_text(columns).encode()

    def observers(self, of: Project) -> list[str]:
        """Return the sets that have the points of a set, itself included."""
        current = {name: self.get(name).templates.current for name in self.names}
        own = current[of.set_name]
        return [name for name, template in current.items() if own and template and template.names == own.names]

    def _compared(self, of: Project) -> dict[str, dict[str, np.ndarray]]:
        """Return the points of each picture that is done in at least two sets, by picture and set."""
        placed: dict[str, dict[str, np.ndarray]] = {}
        for name in self.observers(of):
            for item in self.get(name).annotated():
                placed.setdefault(item.name, {})[name] = item.points
        compared = {name: own for name, own in placed.items() if len(own) > 1}
        if not compared:
            raise Refusal(422, "no picture is done in two sets of the same points yet: let another observer place them")
        return compared


def _errors(pictures: dict[str, dict[str, np.ndarray]], of: Project) -> Columns:
    names, every = of.templates.needed.names, [(name, own) for name, each in pictures.items() for own in each.values()]
    specimens = [Specimen(f"{name}#{i}", points, names=names) for i, (name, points) in enumerate(every, 1)]
    return measurement_error(specimens, measure(specimens), "image")


def _spread(replicates: list[np.ndarray]) -> float:
    """Return the standard deviation of points between replicates, x and y together, over all points."""
    return float(np.sqrt(np.var(replicates, axis=0, ddof=1).sum(axis=1).mean()))
