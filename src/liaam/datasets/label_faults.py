"""Landmarks that were labelled by another rule than in the other pictures: exchanged, run backwards, far off.

A contour begun at the other end is no shape, yet a model learns it as one, and a fit that is right is told to be wrong.
What a picture's landmarks should look like, the pictures nearest to it tell, by medians: a few faults do not count.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from liaam.errors import LiaamError
from liaam.evaluation import ranges_of
from liaam.io.landmarks import Landmarks
from liaam.model.shape import diagonal_of, mirror_order, procrustes_mean
from liaam.progress import Progress

LEAST_PICTURES = 8
"""Pictures without which nobody can say what is usual."""

NEIGHBOURS = 9
"""Pictures whose median is what a picture's landmarks are expected at. Those with the same fault are drawn to each
other: faults of single pictures are found, one that a tenth of the pictures share by half."""

MOST_COMPARED = 400
"""Pictures that each is compared with, at most."""

STRANGE = 4.0
"""How many times as far off as is usual landmarks have to lie to be exchanged for others."""

BETTER = 8.0
"""How many times smaller squared distances have to be once they are exchanged."""

STRAY, LEAST_STRAY = 8.0, 0.05
"""How many times as far off as is usual a landmark has to lie, and which share of the shape's diagonal at least, to be
told: a face that turns away has landmarks in places of its own."""

LEAST_LANDMARKS, AS_USUAL = 10, 2.5
"""How many landmarks there have to be, and how many times as far off as is usual half of them may lie, for a single one
to be told: of few landmarks, or in a shape like no other, each may lie anywhere."""

ALL_OFF = 3.0
"""How many times as far off as is usual half of the landmarks have to lie before all are tried in other orders, and how
many times nearer they have to be in one of them: the other way round, begun elsewhere, or left for right."""


@dataclass(frozen=True, eq=False)
class LabelFault:
    """Landmarks of one picture that differ from those of the others by more than shape.

    Attributes
    ----------
    picture : int
        Number of the picture.
    kind : {"reversed", "shifted", "mirrored", "exchanged", "stray"}
        Run the other way round; begin at another one; left and right exchanged; exchanged in some other way; far off.
    points : tuple of int
        Which landmarks.
    order : (n,) int64
        ``landmarks[order]`` are the landmarks as the others have them; all in their places where that is not known.
    distance, mended : float
        Root mean square distance of these landmarks from where the others have them, pixels: as they are, and in the
        other order.
    expected : (n, 2) float64
        Where the others have all landmarks, image pixels.
    """

    picture: int
    kind: str
    points: tuple[int, ...]
    order: np.ndarray
    distance: float
    mended: float
    expected: np.ndarray

    @property
    def is_order(self) -> bool:
        """Whether another order mends it."""
        return self.kind != "stray"

    def mended_landmarks(self, landmarks: Landmarks) -> Landmarks:
        """Landmarks of the picture in the order of the others; names and contours stay with the places."""
        hidden = np.isin(self.order, landmarks.invisible)
        return replace(landmarks, points=landmarks.points[self.order], invisible=tuple(np.flatnonzero(hidden).tolist()))

    @property
    def message(self) -> str:
        """What is wrong, for people who count from 1."""
        told = ranges_of([point + 1 for point in self.points], most=len(self.points))
        if self.kind == "mirrored":
            return f"left and right are exchanged ({self.distance:.1f} px off, {self.mended:.1f} px the other way)"
        said = {
            "reversed": f"points {told} run the other way round",
            "shifted": f"points {told} begin at another one",
            "exchanged": f"points {told} are exchanged",
            "stray": f"point{'s' if len(self.points) > 1 else ''} {told} far off",
        }[self.kind]
        once = f", {self.mended:.1f} px in the other order" if self.is_order else ""
        return f"{said} ({self.distance:.1f} px off{once})"


def find_label_faults(shapes: Sequence[np.ndarray], progress: Progress | None = None) -> list[LabelFault]:
    """Find landmarks that were labelled by another rule than in the other pictures.

    Parameters
    ----------
    shapes : sequence of (n, 2) float
        Landmarks of each picture, none missing.
    progress : callable(done, total, what), optional

    Returns
    -------
    list of LabelFault
        In the order of the pictures; none where there is no fault.

    Raises
    ------
    LiaamError
        If there are fewer than :data:`LEAST_PICTURES` pictures, too few to tell what is usual.
    """
    if len(shapes) < LEAST_PICTURES:
        raise LiaamError(
            f"{len(shapes)} landmarked pictures are too few to tell which landmarks are unusual; at least "
            f"{LEAST_PICTURES} are needed"
        )
    pictures = [i for i, shape in enumerate(shapes) if diagonal_of(shape) > 0]  # points on one spot have no order
    if len(pictures) < LEAST_PICTURES:
        return []
    own = np.array([shapes[i] for i in pictures], dtype=np.float64)
    sizes = np.array([diagonal_of(shape) for shape in own])
    mean = procrustes_mean(own)
    mirrored = mirror_order(mean)
    expected = np.empty_like(own)
    for i, shape in enumerate(own):
        if progress:
            progress(i, len(own), "comparing landmarks")
        expected[i] = _expected(shape, own, i)
    off = np.linalg.norm(own - expected, axis=2) / sizes[:, None]
    usual = np.maximum(np.median(off, axis=0), 1e-4)  # of each landmark, as a share of the diagonal
    return [
        fault
        for i, picture in enumerate(pictures)
        for fault in _faults_of(picture, own, i, expected[i], sizes[i] * usual, mean, mirrored)
    ]


def _others(shapes: np.ndarray, own: int) -> np.ndarray:
    """All shapes but one, or so many that are spread over them."""
    pool = np.delete(np.arange(len(shapes)), own)
    if len(pool) > MOST_COMPARED:
        pool = pool[np.linspace(0, len(pool) - 1, MOST_COMPARED).astype(int)]
    return shapes[pool]


def _expected(shape: np.ndarray, shapes: np.ndarray, own: int) -> np.ndarray:
    """Where the pictures nearest to a shape (n, 2) have its landmarks, (n, 2) float64; its own one does not count."""
    placed = _onto(_others(shapes, own), shape)
    # Medians of distances: the few landmarks that were exchanged have little say in the company.
    nearest = np.median(np.linalg.norm(placed - shape, axis=2), axis=1).argsort(kind="stable")[:NEIGHBOURS]
    return _onto(np.median(placed[nearest], axis=0)[None], shape)[0]


def _onto(shapes: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Bring shapes (m, n, 2) onto another (n, 2) by similarities that the nearer three quarters of landmarks tell."""
    # Similarities are complex factors.
    own, aim = shapes[..., 0] + 1j * shapes[..., 1], target[:, 0] + 1j * target[:, 1]
    placed, near = own, np.ones(own.shape)
    for _ in range(3):
        weights = near / near.sum(axis=1, keepdims=True)
        centre, middle = (weights * own).sum(axis=1, keepdims=True), weights @ aim
        away = own - centre
        power = (weights * np.abs(away) ** 2).sum(axis=1)
        factor = (weights * away.conj() * (aim - middle[:, None])).sum(axis=1) / np.maximum(power, 1e-300)
        placed = factor[:, None] * away + middle[:, None]
        distances = np.abs(placed - aim)
        near = (distances <= np.quantile(distances, 0.75, axis=1, keepdims=True)).astype(float)
    return np.stack([np.real(placed), np.imag(placed)], axis=-1)


def _faults_of(
    picture: int,
    shapes: np.ndarray,
    own: int,
    expected: np.ndarray,
    usual: np.ndarray,
    mean: np.ndarray,
    mirrored: np.ndarray | None,
) -> Iterator[LabelFault]:
    """Faults of the shape number ``own`` of all (m, n, 2), which is that of a picture."""
    shape = shapes[own]
    distances = np.linalg.norm(shape - expected, axis=1)
    identity, everything = np.arange(len(shape)), tuple(range(len(shape)))
    if np.median(distances / usual) > ALL_OFF:
        kind, order, elsewhere = _best_whole(shapes, own, usual, mean, mirrored)
        after = np.linalg.norm(shape[order] - elsewhere, axis=1)
        if np.median(after / usual) * ALL_OFF < np.median(distances / usual):
            yield LabelFault(picture, kind, everything, order, _rms(distances), _rms(after), elsewhere)
            return
    order = _exchanged(shape, expected, usual)
    moved = np.flatnonzero(order != identity)
    if len(moved):
        run = np.arange(moved.min(), moved.max() + 1)
        after = np.linalg.norm(shape[order] - expected, axis=1)
        kind = _kind_of(order[run], run)
        points = tuple(run.tolist()) if kind != "exchanged" else tuple(moved.tolist())
        at = list(points)
        yield LabelFault(picture, kind, points, order, _rms(distances[at]), _rms(after[at]), expected)
    limit = np.maximum(STRAY * usual, LEAST_STRAY * diagonal_of(shape))
    stray = np.flatnonzero((distances > limit) & (order == identity))
    others_as_usual = len(shape) >= LEAST_LANDMARKS and np.median(distances / usual) < AS_USUAL
    if len(stray) and others_as_usual:
        far = _rms(distances[stray])
        yield LabelFault(picture, "stray", tuple(stray.tolist()), identity, far, far, expected)


def _turns(n: int) -> dict[str, np.ndarray]:
    """Orders of n landmarks in a row by kind, (n, n) int64 each: begun at each of them, and so the other way round."""
    rolls = (np.arange(n)[:, None] + np.arange(n)) % n
    return {"shifted": rolls, "reversed": rolls[:, ::-1]}


def _best_whole(
    shapes: np.ndarray, own: int, usual: np.ndarray, mean: np.ndarray, mirrored: np.ndarray | None
) -> tuple[str, np.ndarray, np.ndarray]:
    """Kind and order in which a shape is nearest to the pictures that are then like it, and where those have it.

    Of each kind the order is tried that is nearest to the mean shape.
    """
    turns = _turns(len(mean))
    orders = {"shifted": turns["shifted"][1:], "reversed": turns["reversed"]}  # the first is the one that it has
    if mirrored is not None:
        orders = {"mirrored": mirrored[None], **orders}
    tried = []
    for kind, each in orders.items():
        placed = _onto(shapes[own][each], mean)
        order = each[np.median(np.linalg.norm(placed - mean, axis=2), axis=1).argmin()]
        shape = shapes[own][order]
        expected = _expected(shape, shapes, own)
        tried.append((np.median(np.linalg.norm(shape - expected, axis=1) / usual), kind, order, expected))
    return min(tried, key=lambda each: each[0])[1:]


def _exchanged(shape: np.ndarray, expected: np.ndarray, usual: np.ndarray) -> np.ndarray:
    """Order of the landmarks that agrees with what is expected, (n,) int64; as they are where there is no doubt."""
    from scipy.optimize import linear_sum_assignment

    identity = np.arange(len(shape))
    squares = np.square(expected[:, None] - shape[None]).sum(axis=2)  # of place i and landmark j
    if not (np.sqrt(np.diagonal(squares)) > STRANGE * usual).sum() >= 2:
        return identity
    assigned = linear_sum_assignment(squares)[1]
    order = identity.copy()
    for cycle in _cycles(assigned):
        before, after = squares[cycle, cycle].sum(), squares[cycle, assigned[cycle]].sum()
        if before > BETTER * after and before > STRANGE**2 * np.square(usual[cycle]).sum():
            order[cycle] = assigned[cycle]
    return _as_run(order, squares)


def _cycles(order: np.ndarray) -> Iterator[np.ndarray]:
    """Cycles of a permutation with more than one entry."""
    left = set(np.flatnonzero(order != np.arange(len(order))).tolist())
    while left:
        cycle = [left.pop()]
        while (following := int(order[cycle[-1]])) != cycle[0]:
            cycle.append(following)
            left.discard(following)
        yield np.array(cycle)


def _as_run(order: np.ndarray, squares: np.ndarray) -> np.ndarray:
    """Give the run that an exchange most likely is: backwards, or begun elsewhere; the exchange itself if none fits.

    Neighbours that lie close together would not have been exchanged by themselves; as parts of a run they are.
    """
    identity = np.arange(len(order))
    moved = np.flatnonzero(order != identity)
    if len(moved) < 2:
        return order
    best, least = order, BETTER / 4 * squares[identity, order].sum()
    for first in range(max(moved.min() - 2, 0), moved.min() + 1):
        for last in range(moved.max(), min(moved.max() + 2, len(order) - 1) + 1):
            run = np.arange(first, last + 1)
            for orders in _turns(len(run)).values():
                for turned in orders:
                    tried = identity.copy()
                    tried[run] = run[turned]
                    cost = squares[identity, tried].sum()
                    if cost < least:
                        best, least = tried, cost
    return best


def _kind_of(order: np.ndarray, run: np.ndarray) -> str:
    for kind, orders in _turns(len(run)).items():
        if (run[orders] == order).all(axis=1).any():
            return kind
    return "exchanged"


def _rms(distances: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(distances))))
