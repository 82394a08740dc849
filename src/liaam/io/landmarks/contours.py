"""Lines through landmarks, and their edges."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise


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
    closed = (contour.indices + contour.indices[: int(contour.closed)] for contour in contours)
    return [edge for indices in closed for edge in pairwise(indices)]


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
    neighbours: dict[int, dict[int, None]] = {}  # sets in order
    for start, end in edges:
        if start != end:
            neighbours.setdefault(start, {})[end] = None
            neighbours.setdefault(end, {})[start] = None
    used: set[frozenset[int]] = set()
    chains = []
    # From ends and junctions first: what is left are closed lines.
    for start in sorted(neighbours, key=lambda node: len(neighbours[node]) == 2):
        for node in neighbours[start]:
            chain = [start]
            while (edge := frozenset((chain[-1], node))) not in used and len(edge) == 2:
                used.add(edge)
                chain.append(node)
                if len(neighbours[node]) == 2:  # else this is the last
                    node = next(other for other in neighbours[node] if other != chain[-2])
            chains.append(chain)
    contours = (contour_of(chain, closed=False) for chain in chains)
    order = {node: number for number, node in enumerate(neighbours)}
    return tuple(sorted(filter(None, contours), key=lambda contour: min(order[node] for node in contour.indices)))
