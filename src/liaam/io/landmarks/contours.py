"""Lines through landmarks, and their edges."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Contour:
    """A line through landmarks, such as an eyelid or the jaw.

    Attributes
    ----------
    indices : tuple of int
        Landmarks along the line, counted from 0. A closed line does not repeat the first.
    closed : bool
        Whether the last landmark is connected to the first.
    """

    indices: tuple[int, ...]
    closed: bool = False

    @classmethod
    def all_of(cls, pairs: Iterable[tuple[Iterable[int], bool]]) -> "tuple[Contour, ...]":
        """Return the contours of (indices, closed), as a model has them."""
        return tuple(cls(tuple(indices), closed) for indices, closed in pairs)


def contour_of(indices: Sequence[int], closed: bool) -> Contour | None:
    """Make a contour. A repeated first point closes it; a single point gives None."""
    if len(indices) > 2 and indices[0] == indices[-1]:
        indices, closed = indices[:-1], True
    if len(set(indices)) < 2:
        return None
    return Contour(tuple(indices), closed)


def edges_of(contours: Iterable[Contour]) -> list[tuple[int, int]]:
    """List the edges between neighbours along the contours."""
    edges = []
    for contour in contours:
        edges += zip(contour.indices, contour.indices[1:], strict=False)
        if contour.closed:
            edges.append((contour.indices[-1], contour.indices[0]))
    return edges


def edges_from(pairs: Iterable[object], n: int) -> list[tuple[int, int]]:
    """Return those pairs of numbers that are edges between n landmarks. They count from 1, unless one of them is 0."""
    lists = [pair for pair in pairs if isinstance(pair, list) and len(pair) == 2]
    sound = [pair for pair in lists if all(type(number) in (int, float) for number in pair)]
    first = 0 if any(0 in edge for edge in sound) else 1
    return [(int(a) - first, int(b) - first) for a, b in sound if {a - first, b - first} <= {*range(n)}]


def chain_edges(edges: Iterable[tuple[int, int]]) -> tuple[Contour, ...]:
    """Join edges into contours, the inverse of `edges_of` for contours that do not touch.

    Lines end at loose ends and where three or more edges meet; lines without ends are closed. Repeated edges
    count once, and edges from a landmark to itself are ignored.
    """
    neighbours = _neighbours(edges)
    used: set[frozenset[int]] = set()
    ends = [node for node, others in neighbours.items() if len(others) != 2]
    chains = [_walk(node, other, neighbours, used) for node in ends for other in neighbours[node]]
    chains += [_walk(node, others[0], neighbours, used) for node, others in neighbours.items() if others]
    contours = (contour_of(chain, closed=False) for chain in chains)
    found = [contour for contour in contours if contour is not None]
    order = {node: number for number, node in enumerate(neighbours)}
    return tuple(sorted(found, key=lambda contour: min(order[node] for node in contour.indices)))


def _neighbours(edges: Iterable[tuple[int, int]]) -> dict[int, list[int]]:
    neighbours: dict[int, dict[int, None]] = {}
    for start, end in edges:
        if start != end:
            neighbours.setdefault(start, {})[end] = None
            neighbours.setdefault(end, {})[start] = None
    return {node: list(others) for node, others in neighbours.items()}


def _walk(start: int, following: int, neighbours: dict[int, list[int]], used: set[frozenset[int]]) -> list[int]:
    """Follow unused edges from `start` through `following` up to a loose end or a junction."""
    chain = [start]
    node, target = start, following
    while frozenset((node, target)) not in used:
        used.add(frozenset((node, target)))
        chain.append(target)
        others = neighbours[target]
        if len(others) != 2:
            break
        node, target = target, others[0] if others[1] == node else others[1]
    return chain
