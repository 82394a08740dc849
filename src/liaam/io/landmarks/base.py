"""The classes `Landmarks` and `Contour`.

In liaam a landmark is (x, y) = (column, row) in pixels, with (0, 0) at the centre of the top-left pixel.
A missing landmark is (NaN, NaN). Each format's module converts from and to its own convention.
"""

import math
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from liaam.errors import LandmarkError
from liaam.io.files import count_of, name_key, some_names

Size = tuple[float, float]  # width and height in pixels

PRESENT = 0.5
"""Probability of being present below which a landmark of a fit is absent."""


@dataclass(frozen=True)
class Contour:
    """A line through landmarks, such as an eyelid or the jaw.

    Attributes
    ----------
    indices : tuple of int
        Landmarks along the line, counted from 0. A closed line does not repeat the first.
    closed : bool
        Whether the last landmark is connected to the first.
    name : str
        What it is called, such as ``costa``; empty if nothing.
    """

    indices: tuple[int, ...]
    closed: bool = False
    name: str = ""

    @classmethod
    def all_of(cls, pairs: Iterable[tuple[Iterable[int], bool]]) -> "tuple[Contour, ...]":
        """Return the contours of (indices, closed), as a model has them."""
        return tuple(cls(tuple(indices), closed) for indices, closed in pairs)


@dataclass(frozen=True)
class Placing:
    """What the positions in a file count from."""

    size: Size | None = None  # that of the image, if the file states it
    upwards: bool = False  # whether y counts upwards from the bottom row
    fractions: bool = False  # whether x and y are fractions of the width and height


@dataclass(frozen=True, eq=False, repr=False)
class Landmarks:
    """The landmarks of one image.

    Attributes
    ----------
    points : (n, 2) float64
        Read-only x and y in pixels; a missing landmark is (NaN, NaN).
    contours : tuple of Contour
        Lines through the landmarks, if the file has them.
    names : tuple of str
        One name per landmark, or empty.
    image_name : str, optional
        The image's file name, if the landmark file gives it.
    invisible : tuple of int
        Occluded landmarks with known positions, ascending. Only ``.ljson`` and ``.json`` store them.
    scale : float, optional
        Length of a pixel in the specimen's units, such as 0.01 mm. Only ``.tps`` and ``.ljson`` store it.
    others : tuple of Landmarks
        Further objects of the same image: the larger ones first where their sizes are known, else in the file's order.
    label : str
        What the file calls this object, such as the ID of a specimen, or empty.
    placing : Placing
        What the positions count from, until they are converted to pixels of the image.
    format : str
        Name of the file's format, or empty.
    individual : str
        Individual that the object belongs to, such as the fly of a wing, if a table has a column for it, or empty.
    side : str
        Side of the individual, if a table has a column for it, or empty.
    unit : str
        Unit of the scale, such as mm, or empty if unknown. Only ``.ljson`` stores it.
    status : str
        How the fit ended that placed the landmarks, if a table has a column for it, or empty.

    Raises
    ------
    LandmarkError
        If the points are not (n, 2), infinite or half missing, if a contour or the names do not match them, or if the
        scale is not positive.
    """

    points: np.ndarray
    contours: tuple[Contour, ...] = ()
    names: tuple[str, ...] = ()
    image_name: str | None = None
    invisible: tuple[int, ...] = ()
    scale: float | None = None
    others: "tuple[Landmarks, ...]" = ()
    label: str = ""
    placing: Placing = Placing()
    format: str = ""
    individual: str = ""
    side: str = ""
    unit: str = ""
    status: str = ""

    def __post_init__(self) -> None:
        points = _checked_points(self.points)
        points.setflags(write=False)
        object.__setattr__(self, "points", points)
        object.__setattr__(self, "invisible", tuple(sorted(set(self.invisible))))
        if self.names and len(self.names) != len(points):
            raise LandmarkError(f"there are {len(self.names)} names for {len(points)} landmarks: give one name each.")
        _check_indices("a contour names", [i for contour in self.contours for i in contour.indices], len(points))
        _check_indices("marked as invisible is", self.invisible, len(points))
        if self.scale is not None and not 0 < self.scale < math.inf:
            raise LandmarkError(f"the scale is {self.scale:g}: give the length of a pixel, a positive number.")

    def __len__(self) -> int:
        return len(self.points)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        if copy is False and np.dtype(dtype or self.points.dtype) != self.points.dtype:
            raise ValueError(f"landmarks are float64: an array of {dtype} is a copy")  # as NumPy asks for
        return np.array(self.points, dtype) if copy else np.asarray(self.points, dtype)

    def __repr__(self) -> str:
        points = count_of(len(self), "point")
        contours = count_of(len(self.contours), "contour")
        return f"Landmarks({points}, {self.missing.sum()} missing, {contours})"

    @property
    def missing(self) -> np.ndarray:
        """(n,) bool mask of missing landmarks."""
        return np.isnan(self.points[:, 0])

    def objects(self, name: str) -> "Iterator[tuple[str, Landmarks]]":
        """Yield each object and its name: ``name``, ``name#2``, ..., or ``name#ID`` if IDs tell them apart."""
        every = (self, *self.others)
        labels = [re.sub(r"[\\/#]", "_", each.label) for each in every]  # names may become those of files
        if self.others and all(labels) and len(set(labels)) == len(labels):
            for label, each in zip(labels, every, strict=True):
                yield f"{name}#{label}", each
            return
        yield name, self
        for number, other in enumerate(self.others, 2):
            yield f"{name}#{number}", other

    def in_order_of(self, names: Sequence[str]) -> "Landmarks":
        """Return the landmarks with these names, in this order; unchanged if either has no names, or none in common.

        Case, blanks around a name, zeros before a number and the form of its Unicode do not matter where they tell no
        landmarks apart.

        Raises
        ------
        LandmarkError
            If some of the names are missing, or name several landmarks.
        """
        wanted_keys = [_spelling_key(name) for name in names]
        keys = [_spelling_key(name) for name in self.names]
        if len(set(wanted_keys)) < len(names) or len(set(keys)) < len(self.names):  # only the spelling tells some apart
            wanted_keys = list(names)
            keys = list(self.names)
        if self.names == tuple(names) or not set(wanted_keys) & set(keys):
            return self
        counts = Counter(keys)
        lacking = [name for name, key in zip(names, wanted_keys, strict=True) if counts[key] != 1]
        if lacking:
            raise LandmarkError(f"its names lack {some_names(lacking)}, or have them twice: name each landmark once.")
        wanted_name = dict(zip(wanted_keys, names, strict=True))
        renamed = tuple(wanted_name.get(key, name) for key, name in zip(keys, self.names, strict=True))
        return replace(self, names=renamed).with_names(names)

    def with_names(self, names: Sequence[str]) -> "Landmarks":
        """Return the landmarks of these names, in this order; those that lack are missing.

        Contours through landmarks that are none of these are left out.
        """
        old_index = {name: i for i, name in enumerate(self.names)}
        order = [old_index.get(name, -1) for name in names]  # -1 for names that lack
        is_lacking = np.less(order, 0)
        new_index = {old: new for new, old in enumerate(order) if old >= 0}
        contours = [
            replace(contour, indices=tuple(new_index[i] for i in contour.indices))
            for contour in self.contours
            if all(i in new_index for i in contour.indices)
        ]
        return replace(
            self,
            points=np.where(is_lacking[:, None], np.nan, self.points[order]),
            names=tuple(names),
            contours=tuple(contours),
            invisible=tuple(new_index[i] for i in self.invisible if i in new_index),
        )


def _checked_points(values: Any) -> np.ndarray:
    """Return a copy of points as (n, 2) float64. Raise unless each is finite, or missing in both coordinates."""
    try:
        points = np.array(values, dtype=np.float64)
    except (TypeError, ValueError) as fault:
        raise LandmarkError(f"the landmarks are not numbers ({fault}): give an (n, 2) array of x, y.") from fault
    if points.ndim != 2 or points.shape[1] != 2 or len(points) == 0:
        raise LandmarkError(f"the landmarks have shape {points.shape}: give an (n, 2) array of x, y with n > 0.")
    half_missing = np.flatnonzero(np.isnan(points).sum(axis=1) == 1)
    if len(half_missing):
        which = f"landmark {half_missing[0] + 1} (counting from 1)"
        raise LandmarkError(f"{which} has only one of x and y: give both, or leave out both.")
    if np.isinf(points).any():
        raise LandmarkError("a landmark is infinite: give finite pixels, or NaN for a missing one.")
    return points


def _check_indices(what: str, indices: Iterable[int], n_points: int) -> None:
    """Raise if an index is not that of a landmark; `what` says what it is for, as the subject and verb of a message."""
    for index in indices:
        if not 0 <= index < n_points:
            which = f"{what} landmark {index} (counting from 0)"
            raise LandmarkError(f"{which}, but there are {n_points} landmarks: correct the indices.")


def _spelling_key(name: str) -> str:
    """Return what the spellings of a name have in common."""
    return without_zeros(name_key(name.strip()))


def without_zeros(name: str) -> str:
    """Return a name that is a number without zeros in front."""
    return re.sub(r"\A0+(?=\d+\Z)", "", name)


def contour_of(indices: Sequence[int], closed: bool) -> Contour | None:
    """Make a contour. A repeated first point closes it; a single point gives None."""
    if len(indices) > 2 and indices[0] == indices[-1]:
        indices = indices[:-1]
        closed = True
    return Contour(tuple(indices), closed) if len({*indices}) > 1 else None


def edges_of(contours: Iterable[Contour]) -> list[tuple[int, int]]:
    """List the edges between neighbours along the contours."""
    edges = []
    for contour in contours:
        edges += pairwise(contour.indices)
        if contour.closed and contour.indices:
            edges.append((contour.indices[-1], contour.indices[0]))
    return edges


def edges_from(pairs: Iterable[object], n: int) -> list[tuple[int, int]]:
    """Return those values of JSON that are edges between n landmarks, as pairs of indices from 0.

    In the values landmarks count from 1, unless one of them is 0. What is no pair of such numbers is ignored.
    """
    lists = [pair for pair in pairs if isinstance(pair, list) and len(pair) == 2]
    edges = [pair for pair in lists if all(type(number) in (int, float) for number in pair)]  # true and false are none
    first = 0 if any(0 in edge for edge in edges) else 1
    landmarks = {first + i for i in range(n)}
    return [(int(start) - first, int(end) - first) for start, end in edges if {start, end} <= landmarks]


def chain_edges(edges: Iterable[tuple[int, int]]) -> tuple[Contour, ...]:
    """Join edges into contours, the inverse of `edges_of` for contours that do not touch.

    Lines end at loose ends and where three or more edges meet; lines without ends are closed. Repeated edges
    count once, and edges from a landmark to itself are ignored.
    """
    neighbours: dict[int, dict[int, None]] = {}  # the keys of the inner ones are sets that keep their order
    for start, end in edges:
        if start != end:
            neighbours.setdefault(start, {})[end] = None
            neighbours.setdefault(end, {})[start] = None
    used: set[frozenset[int]] = set()
    contours = []
    # From ends and junctions first: what is left are closed lines.
    for start in sorted(neighbours, key=lambda node: len(neighbours[node]) == 2):
        for second in neighbours[start]:
            contour = contour_of(_chain(start, second, neighbours, used), closed=False)
            if contour is not None:
                contours.append(contour)
    order = {node: number for number, node in enumerate(neighbours)}
    return tuple(sorted(contours, key=lambda contour: min(order[node] for node in contour.indices)))


def _chain(start: int, second: int, neighbours: dict[int, dict[int, None]], used: set[frozenset[int]]) -> list[int]:
    """Follow unused edges from a landmark through its neighbour to an end or a junction, or once around.

    Its edges are added to those used. If the first one is used, the chain is the start alone.
    """
    chain = [start]
    node = second
    while (edge := frozenset((chain[-1], node))) not in used:
        used.add(edge)
        chain.append(node)
        if len(neighbours[node]) != 2:  # an end or a junction
            break
        before, after = neighbours[node]
        node = after if before == chain[-2] else before
    return chain
