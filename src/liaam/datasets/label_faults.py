"""Find labelling errors: landmarks that are exchanged, reversed, mirrored or misplaced, compared with other images.

A model would learn a contour labelled from the other end as a shape, and evaluations would count right fits as wrong.
The expected landmarks of an image are the median of its nearest neighbours, and single points are predicted from the
others (:mod:`liaam.datasets.point_outliers`); both are robust to a few errors.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from liaam.datasets.point_outliers import LEAST_POINTS, Outliers, point_outliers, resistant_fit
from liaam.error_measures import root_mean_square
from liaam.errors import LiaamError
from liaam.formatting import ranges_of, short_repr
from liaam.io.landmarks import Landmarks
from liaam.model.shape import align, diagonal_of, mirror_order
from liaam.progress import Progress

LEAST_PICTURES = 8  # Least number of images to estimate the usual deviations
# Number of neighbours whose median gives the expected landmarks. Images with the same error are neighbours: errors of
# single images are found, but only half of those that a tenth of the images share.
NEIGHBOURS = 9
MOST_COMPARED = 400  # Largest number of images that each is compared with
OUTLIER = 4.0  # Least distance, in usual deviations, of landmarks that may be exchanged
BETTER = 8.0  # Least factor by which an exchange must reduce the squared distances
# Median distance, in usual deviations, above which other orders of all landmarks are tried, and the least factor by
# which such an order must reduce it; of reflections, the upper quartile
ALL_OFF = 3.0
# Largest rotation (radians) of a record that is upright once its y is reversed, and least mean resultant length of the
# other records' orientations for it to be judged
UPRIGHT, ALIGNED = np.pi / 4, 0.8


@dataclass(frozen=True, eq=False)
class LabelFault:
    """A labelling error: landmarks of one image that are inconsistent with those of the other images.

    Attributes
    ----------
    picture : int
        Index of the image.
    kind : {"reversed", "shifted", "left-right", "exchanged", "mirrored", "upside-down", "stray"}
        In reverse order; starting at another landmark; left and right exchanged; exchanged in another way; all
        reflected with the landmarks in their order, as on the other side of an animal; y counted the other way;
        misplaced.
    points : tuple of int
        Indices of the landmarks. If several may each explain a record with a misplaced point, the likeliest is first.
    order : (n,) int64
        Correction: ``landmarks[order]`` has the order of the other images. The identity if no
        order corrects the error.
    distance, corrected_distance : float
        Root mean square distance of these landmarks to their expected positions, pixels: in the present order, and in
        the corrected order.
    expected : (n, 2) float64
        Expected positions of all landmarks, image pixels.
    one_of : bool
        Whether just one of ``points`` is misplaced, and the shape does not say which.
    """

    picture: int
    kind: str
    points: tuple[int, ...]
    order: np.ndarray
    distance: float
    corrected_distance: float
    expected: np.ndarray
    one_of: bool = False

    __repr__ = short_repr

    @property
    def is_order(self) -> bool:
        """Whether another order corrects the error."""
        return self.kind not in ("stray", "mirrored", "upside-down")

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
            "left-right": "left and right are exchanged",
            "reversed": f"points {numbers} are in reverse order",
            "shifted": f"points {numbers} start at another point",
            "exchanged": f"points {numbers} are exchanged",
            "mirrored": "mirrored: flip the image with its landmarks, or leave it out",
            "upside-down": "upside down: y counts the other way; read .tps or .nts files whose y counts from the top "
            "with --y-down, and correct a file that mixes both",
            "stray": f"{'one of ' * self.one_of}{'points' if several else 'point'} {numbers} may be misplaced",
        }[self.kind]
        after = "reflected" if self.kind in ("mirrored", "upside-down") else "in the corrected order"
        corrected = "" if self.kind == "stray" else f", {self.corrected_distance:.1f} px {after}"
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
    _refuse_unlike(shapes)
    pictures = [i for i, shape in enumerate(shapes) if diagonal_of(shape) > 0]  # coincident points have no order
    if len(pictures) < LEAST_PICTURES:
        return []
    sizes = np.array([diagonal_of(shapes[i]) for i in pictures])[:, None, None]
    complete = np.array([shapes[i] for i in pictures], dtype=np.float64)
    mean, kinds = _reflections(complete / sizes)
    # Reflected shapes are compared with y reversed. Orders differ from reflections unless the shape is symmetric.
    mirrored = mirror_order(mean)
    kinds = ["" if kind == "mirrored" and mirrored is not None else kind for kind in kinds]
    flips = np.array([[1.0, -1.0 if kind else 1.0] for kind in kinds])[:, None]
    upright = complete * flips
    expected = np.array([_expected(shape, upright, i) for i, shape in enumerate(upright)])
    off = np.linalg.norm(upright - expected, axis=2) / sizes[:, 0]
    usual = np.maximum(np.median(off, axis=0), 1e-4)  # of each landmark, as a fraction of the diagonal
    orders = _orders(mean, mirrored, float(np.median(_fit(upright / sizes, mean))))
    wrong = [
        _reflected(picture, complete[i], kinds[i], mean)
        if kinds[i]
        else _order_fault(picture, upright, i, expected[i], float(sizes[i, 0, 0]) * usual, mean, orders)
        for i, picture in enumerate(pictures)
    ]
    ordered = np.array([shape[fault.order] if fault else shape for shape, fault in zip(upright, wrong, strict=True)])
    near = np.array(
        [fault.expected if fault and fault.is_order else e for e, fault in zip(expected, wrong, strict=True)]
    )
    judged = len(mean) >= LEAST_POINTS
    misplaced = point_outliers(ordered / sizes, near / sizes, progress) if judged else [None] * len(complete)
    faults = []
    for i, (fault, outliers) in enumerate(zip(wrong, misplaced, strict=True)):
        faults += [fault] if fault else []
        if outliers and outliers.points and not (fault and fault.is_order):
            faults.append(_stray(pictures[i], complete[i], outliers, sizes[i] * flips[i]))
    return faults


def _refuse_unlike(shapes: Sequence[np.ndarray]) -> None:
    """Raise unless there are enough shapes, of the same number of landmarks."""
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


def _reflections(shapes: np.ndarray) -> tuple[np.ndarray, list[str]]:
    """Robust mean (n, 2) of shapes (m, n, 2), with diagonal 1, and the kind of each shape's reflection, if any."""
    centred = shapes - shapes.mean(axis=1, keepdims=True)
    mean, flipped, reflected = centred[0], centred * [1.0, -1.0], np.zeros(len(shapes), bool)
    for _ in range(5):
        reflected = _fit(flipped, mean) < _fit(centred, mean)
        reflected = ~reflected if reflected.mean() > 0.5 else reflected
        mean = np.median(resistant_fit(np.where(reflected[:, None, None], flipped, centred), mean), axis=0)
    mean = mean / max(diagonal_of(mean), 1e-12)
    before, after = _fit(centred, mean), _fit(flipped, mean)
    far = before > ALL_OFF * np.maximum(np.median(np.minimum(before, after)), after)
    usual = np.mean([_turn(shape, mean) for shape in centred[~reflected]])
    kinds = [""] * len(shapes)
    for i in np.flatnonzero(reflected & far & (len(mean) >= LEAST_POINTS)):
        upright = abs(np.angle(_turn(flipped[i], mean) * usual.conjugate())) < UPRIGHT and abs(usual) > ALIGNED
        kinds[i] = "upside-down" if upright else "mirrored"
    return mean, kinds


def _fit(shapes: np.ndarray, mean: np.ndarray) -> np.ndarray:
    """Upper quartile of the distances of each shape's landmarks to those of the mean, (m,) float64.

    The median would be that of points which any similarity fits, if there are four.
    """
    return np.quantile(np.linalg.norm(resistant_fit(shapes, mean) - mean, axis=2), 0.75, axis=1)


def _turn(shape: np.ndarray, mean: np.ndarray) -> complex:
    """Rotation of a shape to the mean, as a complex number of modulus 1."""
    (a, _), (b, _) = align(shape, mean).matrix
    return complex(a, b) / max(abs(complex(a, b)), 1e-300)


def _reflected(picture: int, shape: np.ndarray, kind: str, mean: np.ndarray) -> LabelFault:
    """Fault of a shape that is a reflection of the others."""
    every = np.arange(len(shape))
    before = shape - resistant_fit(mean[None], shape)[0]
    expected = resistant_fit(mean[None] * [1.0, -1.0], shape)[0]
    now, after = (root_mean_square(np.linalg.norm(away, axis=1)) for away in (before, shape - expected))
    return LabelFault(picture, kind, tuple(every.tolist()), every, now, after, expected)


def _stray(picture: int, shape: np.ndarray, outliers: Outliers, scale: np.ndarray) -> LabelFault:
    """Fault of misplaced points. ``scale`` converts predicted positions to image pixels."""
    expected, several = outliers.expected * scale, bool(outliers.instead)
    points = outliers.points + outliers.instead if several else tuple(sorted(outliers.points))
    far = root_mean_square(np.linalg.norm(shape - expected, axis=1)[list(outliers.points)])
    return LabelFault(picture, "stray", points, np.arange(len(shape)), far, far, expected, several)


def _expected(shape: np.ndarray, shapes: np.ndarray, index: int) -> np.ndarray:
    """Expected landmarks (n, 2) float64 of a shape (n, 2): median of its nearest neighbours, without itself."""
    pool = np.delete(np.arange(len(shapes)), index)
    if len(pool) > MOST_COMPARED:
        pool = pool[np.linspace(0, len(pool) - 1, MOST_COMPARED).astype(int)]
    placed = resistant_fit(shapes[pool], shape)
    # The median of distances: a few exchanged landmarks hardly change the choice of neighbours.
    nearest = np.median(np.linalg.norm(placed - shape, axis=2), axis=1).argsort(kind="stable")[:NEIGHBOURS]
    return resistant_fit(np.median(placed[nearest], axis=0)[None], shape)[0]


def _order_fault(
    picture: int,
    shapes: np.ndarray,
    index: int,
    expected: np.ndarray,
    usual: np.ndarray,
    mean: np.ndarray,
    orders: dict[str, np.ndarray],
) -> LabelFault | None:
    """Return the fault of ``shapes[own]``, the shape of image ``picture``, that another order corrects, if any."""
    shape = shapes[index]
    distances = np.linalg.norm(shape - expected, axis=1)
    identity, everything = np.arange(len(shape)), tuple(range(len(shape)))
    if orders and np.median(distances / usual) > ALL_OFF:
        tried = []
        for kind, each in orders.items():  # of each kind, the order nearest to the mean shape
            placed = resistant_fit(shape[each], mean)
            order = each[np.median(np.linalg.norm(placed - mean, axis=2), axis=1).argmin()]
            elsewhere = _expected(shape[order], shapes, index)
            after = np.linalg.norm(shape[order] - elsewhere, axis=1)
            tried.append((np.median(after / usual), kind, order, elsewhere, after))
        _, kind, order, elsewhere, after = min(tried, key=lambda each: each[0])
        if np.median(after / usual) * ALL_OFF < np.median(distances / usual):
            far, near = root_mean_square(distances), root_mean_square(after)
            return LabelFault(picture, kind, everything, order, far, near, elsewhere)
    order = _exchanged(shape, expected, usual)
    moved = np.flatnonzero(order != identity)
    if not len(moved):
        return None
    run = np.arange(moved.min(), moved.max() + 1)
    after = np.linalg.norm(shape[order] - expected, axis=1)
    turns = _turns(len(run)).items() if len(run) > 2 else ()
    kind = next((kind for kind, each in turns if (run[each] == order[run]).all(axis=1).any()), "exchanged")
    at = moved if kind == "exchanged" else run
    before, later = root_mean_square(distances[at]), root_mean_square(after[at])
    return LabelFault(picture, kind, tuple(at.tolist()), order, before, later, expected)


def _turns(n: int) -> dict[str, np.ndarray]:
    """Cyclic shifts of n landmarks, and the same in reverse order, (n, n) int64 each."""
    rolls = (np.arange(n)[:, None] + np.arange(n)) % n
    return {"shifted": rolls, "reversed": rolls[:, ::-1]}


def _orders(mean: np.ndarray, mirrored: np.ndarray | None, natural: float) -> dict[str, np.ndarray]:
    """Orders of all landmarks by kind that change the mean shape by more than the natural deviations of shapes.

    Turned by a half, four landmarks may look as before.
    """
    turns = _turns(len(mean))
    orders = {"shifted": turns["shifted"][1:], "reversed": turns["reversed"]}  # the first shift is the identity
    if mirrored is not None:
        orders = {"left-right": mirrored[None], **orders}
    told = {kind: each[_fit(mean[each], mean) > ALL_OFF * natural] for kind, each in orders.items()}
    return {kind: each for kind, each in told.items() if len(each)}


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
