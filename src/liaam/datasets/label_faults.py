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
LEAST_DEVIATION = 1e-4  # Least usual deviation of a landmark, as a fraction of the diagonal, for equal shapes
OUTLIER = 4.0  # Least distance, in usual deviations, of landmarks that may be exchanged
BETTER = 8.0  # Least factor by which an exchange must reduce the squared distances
# Sum of squared distances of a reversed or shifted run, relative to that of an exchange, up to which the run is taken
# for the error: labels are exchanged by runs more often than one by one
RUN_COST = 2.0
RUN_ENDS = 2  # Number of landmarks that a run may have at each end beyond those that are found to be exchanged
# Median distance, in usual deviations, above which other orders of all landmarks are tried, and the least factor by
# which such an order must reduce it. A reflection must reduce the upper quartile by this factor
ALL_OFF = 3.0
MOST_NAMED = 4  # Largest number of landmarks that a description names
MEANS = 5  # Number of times that the mean and the reflections are computed from each other
UPRIGHT = np.pi / 4  # Largest rotation, radians, of a record that is upright once its y is reversed
ALIGNED = 0.8  # Least mean resultant length of the other records' orientations for UPRIGHT to be judged


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
        return self.describe()

    def describe(self, names: Sequence[str] = ()) -> str:
        """Describe the error; a few landmarks by these names, if they are given, others by numbers from 1."""
        numbers = ranges_of([point + 1 for point in self.points], most=len(self.points))
        if names and len(self.points) <= MOST_NAMED:
            numbers = ", ".join(names[point] for point in self.points)
        several = len(self.points) > 1
        which = f"{'one of ' if self.one_of else ''}{'points' if several else 'point'} {numbers}"
        fault = {
            "left-right": "left and right are exchanged",
            "reversed": f"points {numbers} are in reverse order",
            "shifted": f"points {numbers} start at another point",
            "exchanged": f"points {numbers} are exchanged",
            "mirrored": "mirrored, as an object of the other side, whose image training reflects; if it is none, these "
            "are the landmarks of another image",
            "upside-down": "upside down: y counts the other way; read .tps or .nts files whose y counts from the top "
            "with --y-down, and correct a file that mixes both",
            "stray": f"{which} may be misplaced",
        }[self.kind]
        after = "reflected" if self.kind in ("mirrored", "upside-down") else "in the corrected order"
        corrected = "" if self.kind == "stray" else f", {self.corrected_distance:.1f} px {after}"
        they = "they are" if several else "it is"
        return f"{fault} ({self.distance:.1f} px from where {they} expected{corrected})"


@dataclass(frozen=True, eq=False)
class _Compared:
    """The shapes that are compared, and what is usual among them.

    Attributes
    ----------
    shapes : (m, n, 2) float64
        Landmarks in pixels, upright.
    deviations : (n,) float64
        Usual distance of each landmark from its expected position, as a fraction of the diagonal.
    mean : (n, 2) float64
        Mean shape with diagonal 1.
    orders : dict of str to (k, n) int64
        Other orders of all landmarks, by kind.
    """

    shapes: np.ndarray
    deviations: np.ndarray
    mean: np.ndarray
    orders: dict[str, np.ndarray]


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
    landmarks = np.array([shapes[i] for i in pictures], dtype=np.float64)
    mean, reflections = _reflections(landmarks / sizes)
    mirrored = mirror_order(mean)
    if mirrored is not None:  # a symmetric shape looks the same in a mirror: an order of its landmarks explains it
        reflections = ["" if kind == "mirrored" else kind for kind in reflections]
    # Reflected shapes are compared with y reversed.
    flips = np.array([[1.0, -1.0 if kind else 1.0] for kind in reflections])[:, None]
    upright = landmarks * flips
    expected = np.array([_expected(shape, upright, i) for i, shape in enumerate(upright)])
    distances = np.linalg.norm(upright - expected, axis=2) / sizes[:, 0]
    compared = _Compared(
        shapes=upright,
        deviations=np.maximum(np.median(distances, axis=0), LEAST_DEVIATION),
        mean=mean,
        orders=_orders(mean, mirrored, float(np.median(_misfit(upright / sizes, mean)))),
    )
    faults: list[LabelFault | None] = []
    for i, picture in enumerate(pictures):
        if reflections[i]:
            faults.append(_reflected(picture, landmarks[i], reflections[i], mean))
        else:
            faults.append(_order_fault(picture, i, expected[i], float(sizes[i, 0, 0]), compared))
    misplaced = _misplaced_points(upright, expected, sizes, faults, progress)
    every_fault = []
    for i, (fault, outliers) in enumerate(zip(faults, misplaced, strict=True)):
        if fault:
            every_fault.append(fault)
        if outliers and outliers.points and not (fault and fault.is_order):
            every_fault.append(_stray(pictures[i], landmarks[i], outliers, sizes[i] * flips[i]))
    return every_fault


def _misplaced_points(
    shapes: np.ndarray,
    expected: np.ndarray,
    sizes: np.ndarray,
    faults: Sequence[LabelFault | None],
    progress: Progress | None,
) -> Sequence[Outliers | None]:
    """Find the misplaced points of shapes (m, n, 2) of sizes (m, 1, 1), in the corrected order of their landmarks.

    None for each shape if it has too few landmarks to predict one from the others.
    """
    if shapes.shape[1] < LEAST_POINTS:
        return [None] * len(shapes)
    ordered = shapes.copy()
    expected = expected.copy()
    for i, fault in enumerate(faults):
        if fault:
            ordered[i] = shapes[i][fault.order]
        if fault and fault.is_order:
            expected[i] = fault.expected
    return point_outliers(ordered / sizes, expected / sizes, progress)


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
    """Robust mean (n, 2) of shapes (m, n, 2) of diagonal 1, also of diagonal 1, and the kind of reflection of each.

    A kind is "mirrored", "upside-down" or, for a shape that is no reflection of most others, "".
    """
    centred = shapes - shapes.mean(axis=1, keepdims=True)
    flipped = centred * [1.0, -1.0]
    mean = centred[0]
    reflected = np.zeros(len(shapes), bool)
    for _ in range(MEANS):
        reflected = _misfit(flipped, mean) < _misfit(centred, mean)
        if reflected.mean() > 0.5:  # the fewer are the reflected ones
            reflected = ~reflected
        mean = np.median(resistant_fit(np.where(reflected[:, None, None], flipped, centred), mean), axis=0)
    mean = mean / max(diagonal_of(mean), 1e-12)
    kinds = [""] * len(shapes)
    if len(mean) < LEAST_POINTS:
        return mean, kinds
    before = _misfit(centred, mean)
    after = _misfit(flipped, mean)
    usual_misfit = np.median(np.minimum(before, after))
    far = before > ALL_OFF * np.maximum(usual_misfit, after)
    usual_rotation = np.mean([_rotation(shape, mean) for shape in centred[~reflected]])
    for i in np.flatnonzero(reflected & far):
        difference = np.angle(_rotation(flipped[i], mean) * usual_rotation.conjugate())
        is_upright = abs(difference) < UPRIGHT and abs(usual_rotation) > ALIGNED
        kinds[i] = "upside-down" if is_upright else "mirrored"
    return mean, kinds


def _misfit(shapes: np.ndarray, mean: np.ndarray) -> np.ndarray:
    """Upper quartile of the distances of each shape's landmarks to those of the mean, (m,) float64.

    The median would be that of points which any similarity fits, if there are four.
    """
    return np.quantile(np.linalg.norm(resistant_fit(shapes, mean) - mean, axis=2), 0.75, axis=1)


def _rotation(shape: np.ndarray, mean: np.ndarray) -> complex:
    """Rotation of a shape to the mean, as a complex number of modulus 1."""
    (a, _), (b, _) = align(shape, mean).matrix
    return complex(a, b) / max(abs(complex(a, b)), 1e-300)


def _rms_distance(shape: np.ndarray, expected: np.ndarray) -> float:
    """Root mean square distance of landmarks (n, 2) from their expected positions, pixels."""
    return root_mean_square(np.linalg.norm(shape - expected, axis=1))


def _reflected(picture: int, shape: np.ndarray, kind: str, mean: np.ndarray) -> LabelFault:
    """Fault of a shape that is a reflection of the others."""
    every = np.arange(len(shape))
    expected_as_is = resistant_fit(mean[None], shape)[0]
    expected = resistant_fit(mean[None] * [1.0, -1.0], shape)[0]
    return LabelFault(
        picture=picture,
        kind=kind,
        points=tuple(every.tolist()),
        order=every,
        distance=_rms_distance(shape, expected_as_is),
        corrected_distance=_rms_distance(shape, expected),
        expected=expected,
    )


def _stray(picture: int, shape: np.ndarray, outliers: Outliers, scale: np.ndarray) -> LabelFault:
    """Fault of misplaced points. ``scale`` (1, 2) converts predicted positions to image pixels."""
    expected = outliers.expected * scale
    one_of = bool(outliers.instead)
    distance = root_mean_square(np.linalg.norm(shape - expected, axis=1)[list(outliers.points)])
    return LabelFault(
        picture=picture,
        kind="stray",
        points=outliers.points + outliers.instead if one_of else tuple(sorted(outliers.points)),
        order=np.arange(len(shape)),
        distance=distance,
        corrected_distance=distance,
        expected=expected,
        one_of=one_of,
    )


def _expected(shape: np.ndarray, shapes: np.ndarray, index: int) -> np.ndarray:
    """Expected landmarks (n, 2) float64 of a shape (n, 2): median of its nearest neighbours among shapes (m, n, 2).

    ``shapes[index]``, which is the same shape, perhaps in another order, is no neighbour.
    """
    pool = np.delete(np.arange(len(shapes)), index)
    if len(pool) > MOST_COMPARED:
        pool = pool[np.linspace(0, len(pool) - 1, MOST_COMPARED).astype(int)]
    placed = resistant_fit(shapes[pool], shape)
    # The median of distances: a few exchanged landmarks hardly change the choice of neighbours.
    nearest = np.median(np.linalg.norm(placed - shape, axis=2), axis=1).argsort(kind="stable")[:NEIGHBOURS]
    return resistant_fit(np.median(placed[nearest], axis=0)[None], shape)[0]


def _order_fault(picture: int, index: int, expected: np.ndarray, size: float, compared: _Compared) -> LabelFault | None:
    """Return the fault of the shape of an index, of an image and a size, that another order corrects, if any."""
    shape = compared.shapes[index]
    usual = size * compared.deviations
    return _fault_of_all(picture, index, expected, usual, compared) or _fault_of_some(picture, shape, expected, usual)


@dataclass(frozen=True, eq=False)
class _Reordered:
    """A shape in another order, beside what the other images then let expect."""

    kind: str
    order: np.ndarray  # (n,) int64
    expected: np.ndarray  # (n, 2) float64, pixels
    distances: np.ndarray  # (n,) float64 of the reordered landmarks from the expected ones, pixels


def _fault_of_all(
    picture: int, index: int, expected: np.ndarray, usual: np.ndarray, compared: _Compared
) -> LabelFault | None:
    """Return the fault of a shape that another order of all landmarks corrects; ``usual`` deviations are pixels."""
    shape = compared.shapes[index]
    distances = np.linalg.norm(shape - expected, axis=1)
    if not compared.orders or not np.median(distances / usual) > ALL_OFF:
        return None
    tried = [_best_of_kind(kind, index, compared) for kind in compared.orders]
    best = min(tried, key=lambda reordered: np.median(reordered.distances / usual))
    if not np.median(best.distances / usual) * ALL_OFF < np.median(distances / usual):
        return None
    return LabelFault(
        picture=picture,
        kind=best.kind,
        points=tuple(range(len(shape))),
        order=best.order,
        distance=root_mean_square(distances),
        corrected_distance=root_mean_square(best.distances),
        expected=best.expected,
    )


def _best_of_kind(kind: str, index: int, compared: _Compared) -> _Reordered:
    """Return a shape in that order of a kind in which it is nearest to the mean shape."""
    shape = compared.shapes[index]
    orders = compared.orders[kind]
    placed = resistant_fit(shape[orders], compared.mean)
    order = orders[np.median(np.linalg.norm(placed - compared.mean, axis=2), axis=1).argmin()]
    expected = _expected(shape[order], compared.shapes, index)
    return _Reordered(kind, order, expected, np.linalg.norm(shape[order] - expected, axis=1))


def _fault_of_some(picture: int, shape: np.ndarray, expected: np.ndarray, usual: np.ndarray) -> LabelFault | None:
    """Return the fault of some exchanged landmarks of a shape, if any; ``usual`` deviations are pixels."""
    order = _exchanged(shape, expected, usual)
    moved = np.flatnonzero(order != np.arange(len(shape)))
    if not len(moved):
        return None
    run = np.arange(moved.min(), moved.max() + 1)
    kind = _kind_of_run(run, order)
    points = moved if kind == "exchanged" else run
    before = np.linalg.norm(shape - expected, axis=1)
    after = np.linalg.norm(shape[order] - expected, axis=1)
    return LabelFault(
        picture=picture,
        kind=kind,
        points=tuple(points.tolist()),
        order=order,
        distance=root_mean_square(before[points]),
        corrected_distance=root_mean_square(after[points]),
        expected=expected,
    )


def _kind_of_run(run: np.ndarray, order: np.ndarray) -> str:
    """Return how an order changes a run of landmarks: "shifted", "reversed", or else "exchanged"."""
    if len(run) > 2:  # the exchange of two is a shift as well as a reversal
        for kind, orders in _turns(len(run)).items():
            if (run[orders] == order[run]).all(axis=1).any():
                return kind
    return "exchanged"


def _turns(n: int) -> dict[str, np.ndarray]:
    """Cyclic shifts of n landmarks, and the same in reverse order, (n, n) int64 each."""
    rolls = (np.arange(n)[:, None] + np.arange(n)) % n
    return {"shifted": rolls, "reversed": rolls[:, ::-1]}


def _orders(mean: np.ndarray, mirrored: np.ndarray | None, natural: float) -> dict[str, np.ndarray]:
    """Orders of all landmarks by kind that change the mean shape by more than the natural deviations of shapes.

    Turned by a half, four landmarks may look as before.
    """
    turns = _turns(len(mean))
    candidates = {"shifted": turns["shifted"][1:], "reversed": turns["reversed"]}  # the first shift is the identity
    if mirrored is not None:
        candidates = {"left-right": mirrored[None], **candidates}
    orders = {}
    for kind, each in candidates.items():
        distinct = each[_misfit(mean[each], mean) > ALL_OFF * natural]
        if len(distinct):
            orders[kind] = distinct
    return orders


def _exchanged(shape: np.ndarray, expected: np.ndarray, usual: np.ndarray) -> np.ndarray:
    """Order of the landmarks that matches the expected ones, (n,) int64; the identity without clear exchanges.

    ``usual`` deviations (n,) are pixels.
    """
    from scipy.optimize import linear_sum_assignment

    identity = np.arange(len(shape))
    squares = np.square(expected[:, None] - shape[None]).sum(axis=2)  # between expected landmark i and landmark j
    is_far = np.sqrt(np.diagonal(squares)) > OUTLIER * usual
    if is_far.sum() < 2:
        return identity
    _, assigned = linear_sum_assignment(squares)
    order = identity.copy()
    for cycle in _cycles(assigned):
        before = squares[cycle, cycle].sum()
        after = squares[cycle, assigned[cycle]].sum()
        if before > BETTER * after and before > OUTLIER**2 * np.square(usual[cycle]).sum():
            order[cycle] = assigned[cycle]
    return _as_run(order, squares)


def _cycles(order: np.ndarray) -> Iterator[np.ndarray]:
    """Cycles of a permutation (n,) with more than one entry, as indices (k,) int64."""
    remaining = set(np.flatnonzero(order != np.arange(len(order))).tolist())
    while remaining:
        cycle = [remaining.pop()]
        while (following := int(order[cycle[-1]])) != cycle[0]:
            cycle.append(following)
            remaining.discard(following)
        yield np.array(cycle)


def _as_run(order: np.ndarray, squares: np.ndarray) -> np.ndarray:
    """Replace an exchange by the reversed or shifted run that explains it best; the exchange itself if none does.

    A run includes neighbours that lie too close together to be detected as exchanged. ``squares`` (n, n) are the
    squared distances between expected landmark i and landmark j.
    """
    identity = np.arange(len(order))
    moved = np.flatnonzero(order != identity)
    if len(moved) < 2:
        return order
    best = order
    least = RUN_COST * squares[identity, order].sum()
    for first in range(max(moved.min() - RUN_ENDS, 0), moved.min() + 1):
        for last in range(moved.max(), min(moved.max() + RUN_ENDS, len(order) - 1) + 1):
            run = np.arange(first, last + 1)
            for turned in np.concatenate(list(_turns(len(run)).values())):
                tried = identity.copy()
                tried[run] = run[turned]
                cost = squares[identity, tried].sum()
                if cost < least:
                    best = tried
                    least = cost
    return best
