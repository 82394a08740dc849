"""Find labelling errors: landmarks that are exchanged, reversed or far off compared with the other images.

A model would learn a contour labelled from the other end as a shape, and evaluations would count right fits as wrong.
The expected landmarks of an image are the median of its nearest neighbours, which is robust to a few errors.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from liaam.errors import LiaamError
from liaam.evaluation import ranges_of, root_mean_square, short_repr
from liaam.io.landmarks import Landmarks
from liaam.model.shape import diagonal_of, mirror_order, procrustes_mean
from liaam.progress import Progress

LEAST_PICTURES = 8
"""Least number of images to estimate the usual deviations."""

NEIGHBOURS = 9
"""Number of neighbours whose median gives the expected landmarks. Images with the same error are neighbours: errors of
single images are found, but only half of those that a tenth of the images share."""

MOST_COMPARED = 400
"""Largest number of images that each is compared with."""

OUTLIER = 4.0
"""Least distance, in usual deviations, of landmarks that may be exchanged."""

BETTER = 8.0
"""Least factor by which an exchange must reduce the squared distances."""

STRAY, LEAST_STRAY = 8.0, 0.05
"""Least distance of a stray landmark, in usual deviations and as a fraction of the shape's diagonal. The second limit
allows for turned faces."""

LEAST_LANDMARKS, AS_USUAL = 10, 2.5
"""Least number of landmarks, and largest median distance in usual deviations, for stray landmarks to be reported.
Single landmarks of small or unusual shapes cannot be judged."""

ALL_OFF = 3.0
"""Median distance, in usual deviations, above which other orders of all landmarks are tried, and the least factor by
which such an order must reduce it."""


@dataclass(frozen=True, eq=False)
class LabelFault:
    """A labelling error: landmarks of one image that are inconsistent with those of the other images.

    Attributes
    ----------
    picture : int
        Index of the image.
    kind : {"reversed", "shifted", "mirrored", "exchanged", "stray"}
        In reverse order; starting at another landmark; left and right exchanged; exchanged in another way; far off.
    points : tuple of int
        Indices of the landmarks.
    order : (n,) int64
        Correction: ``landmarks[order]`` has the order of the other images. The identity for stray landmarks.
    distance, corrected_distance : float
        Root mean square distance of these landmarks to their expected positions, pixels: in the present order, and in
        the corrected order.
    expected : (n, 2) float64
        Expected positions of all landmarks, image pixels.
    """

    picture: int
    kind: str
    points: tuple[int, ...]
    order: np.ndarray
    distance: float
    corrected_distance: float
    expected: np.ndarray

    __repr__ = short_repr

    @property
    def is_order(self) -> bool:
        """Whether another order corrects the error."""
        return self.kind != "stray"

    def corrected_landmarks(self, landmarks: Landmarks) -> Landmarks:
        """Reorder the image's landmarks as in the other images; names and contours keep their order."""
        hidden = np.isin(self.order, landmarks.invisible)
        return replace(landmarks, points=landmarks.points[self.order], invisible=tuple(np.flatnonzero(hidden).tolist()))

    @property
    def message(self) -> str:
        """Description of the error; landmarks are counted from 1."""
        numbers = ranges_of([point + 1 for point in self.points], most=len(self.points))
        several = len(self.points) > 1
        fault = {
            "mirrored": "left and right are exchanged",
            "reversed": f"points {numbers} are in reverse order",
            "shifted": f"points {numbers} start at another point",
            "exchanged": f"points {numbers} are exchanged",
            "stray": f"{'points' if several else 'point'} {numbers} may be misplaced",
        }[self.kind]
        corrected = f", {self.corrected_distance:.1f} px in the corrected order" if self.is_order else ""
        they = "they are" if several else "it is"
        return f"{fault} ({self.distance:.1f} px from where {they} expected{corrected})"


def find_label_faults(shapes: Sequence[np.ndarray], progress: Progress | None = None) -> list[LabelFault]:
    """Find landmarks that are labelled inconsistently with the other images.

    Parameters
    ----------
    shapes : sequence of (n, 2) float
        Landmarks of each image, none missing.
    progress : callable(done, total, what), optional

    Returns
    -------
    list of LabelFault
        Labelling errors in the order of the images; empty if there are none.

    Raises
    ------
    LiaamError
        If there are fewer than 8 images.
    """
    if len(shapes) < LEAST_PICTURES:
        raise LiaamError(
            f"too few landmarked images to find unusual landmarks ({len(shapes)}); at least {LEAST_PICTURES} are needed"
        )
    forms = {np.shape(shape) if isinstance(shape, np.ndarray | Sequence) else () for shape in shapes}
    if len(forms) > 1 or any(len(form) != 2 for form in forms):
        raise LiaamError(
            "the landmarks are not arrays of one shape (n, 2): give those of each image, as in "
            "[sample.landmarks.points for sample in data]"
        )
    pictures = [i for i, shape in enumerate(shapes) if diagonal_of(shape) > 0]  # coincident points have no order
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
    usual = np.maximum(np.median(off, axis=0), 1e-4)  # of each landmark, as a fraction of the diagonal
    return [
        fault
        for i, picture in enumerate(pictures)
        for fault in _faults_of(picture, own, i, expected[i], sizes[i] * usual, mean, mirrored)
    ]


def _expected(shape: np.ndarray, shapes: np.ndarray, own: int) -> np.ndarray:
    """Expected landmarks (n, 2) float64 of a shape (n, 2): median of its nearest neighbours, without itself."""
    pool = np.delete(np.arange(len(shapes)), own)
    if len(pool) > MOST_COMPARED:
        pool = pool[np.linspace(0, len(pool) - 1, MOST_COMPARED).astype(int)]
    placed = _onto(shapes[pool], shape)
    # The median of distances: a few exchanged landmarks hardly change the choice of neighbours.
    nearest = np.median(np.linalg.norm(placed - shape, axis=2), axis=1).argsort(kind="stable")[:NEIGHBOURS]
    return _onto(np.median(placed[nearest], axis=0)[None], shape)[0]


def _onto(shapes: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Align shapes (m, n, 2) to another (n, 2) by similarities, fitted to the nearest three quarters of landmarks."""
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
    """Yield the faults of ``shapes[own]``, the shape of image ``picture``."""
    shape = shapes[own]
    distances = np.linalg.norm(shape - expected, axis=1)
    identity, everything = np.arange(len(shape)), tuple(range(len(shape)))
    if np.median(distances / usual) > ALL_OFF:
        kind, order, elsewhere = _best_whole(shapes, own, usual, mean, mirrored)
        after = np.linalg.norm(shape[order] - elsewhere, axis=1)
        if np.median(after / usual) * ALL_OFF < np.median(distances / usual):
            yield LabelFault(
                picture, kind, everything, order, root_mean_square(distances), root_mean_square(after), elsewhere
            )
            return
    order = _exchanged(shape, expected, usual)
    moved = np.flatnonzero(order != identity)
    if len(moved):
        run = np.arange(moved.min(), moved.max() + 1)
        after = np.linalg.norm(shape[order] - expected, axis=1)
        kind = _kind_of(order[run], run)
        at = moved if kind == "exchanged" else run
        before, later = root_mean_square(distances[at]), root_mean_square(after[at])
        yield LabelFault(picture, kind, tuple(at.tolist()), order, before, later, expected)
    limit = np.maximum(STRAY * usual, LEAST_STRAY * diagonal_of(shape))
    stray = np.flatnonzero((distances > limit) & (order == identity))
    others_as_usual = len(shape) >= LEAST_LANDMARKS and np.median(distances / usual) < AS_USUAL
    if len(stray) and others_as_usual:
        far = root_mean_square(distances[stray])
        yield LabelFault(picture, "stray", tuple(stray.tolist()), identity, far, far, expected)


def _turns(n: int) -> dict[str, np.ndarray]:
    """Cyclic shifts of n landmarks, and the same in reverse order, (n, n) int64 each."""
    rolls = (np.arange(n)[:, None] + np.arange(n)) % n
    return {"shifted": rolls, "reversed": rolls[:, ::-1]}


def _best_whole(
    shapes: np.ndarray, own: int, usual: np.ndarray, mean: np.ndarray, mirrored: np.ndarray | None
) -> tuple[str, np.ndarray, np.ndarray]:
    """Kind, order and expected landmarks for the order of all landmarks that is nearest to its neighbours.

    Of each kind only the order nearest to the mean shape is tried.
    """
    turns = _turns(len(mean))
    orders = {"shifted": turns["shifted"][1:], "reversed": turns["reversed"]}  # the first shift is the identity
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
    """Order of the landmarks that matches the expected ones, (n,) int64; the identity without clear exchanges."""
    from scipy.optimize import linear_sum_assignment

    identity = np.arange(len(shape))
    squares = np.square(expected[:, None] - shape[None]).sum(axis=2)  # between expected landmark i and landmark j
    if not (np.sqrt(np.diagonal(squares)) > OUTLIER * usual).sum() >= 2:
        return identity
    assigned = linear_sum_assignment(squares)[1]
    order = identity.copy()
    for cycle in _cycles(assigned):
        before, after = squares[cycle, cycle].sum(), squares[cycle, assigned[cycle]].sum()
        if before > BETTER * after and before > OUTLIER**2 * np.square(usual[cycle]).sum():
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
    """Replace an exchange by the reversed or shifted run that explains it best; the exchange itself if none does.

    A run includes neighbours that lie too close together to be detected as exchanged.
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
    if len(run) == 2:
        return "exchanged"
    for kind, orders in _turns(len(run)).items():
        if (run[orders] == order).all(axis=1).any():
            return kind
    return "exchanged"
