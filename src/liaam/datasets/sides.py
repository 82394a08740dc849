"""Which of several shapes are mirrored: by the sides that are stated, and by the shapes themselves.

With landmarks as complex numbers, centred and of norm 1, the squared Procrustes distance of two shapes is
1 - |<a, b>|^2, and with one of them mirrored 1 - |<a, conj b>|^2 (Kent, J. R. Stat. Soc. B 56, 1994). The difference
of both says of each pair whether it is of one side. Of all assignments to two sides, that which agrees best with all
pairs is nearly the signs of the leading eigenvector of these differences (the relaxation of Goemans and Williamson,
J. ACM 42, 1995, for two groups), from which single shapes are moved while this improves it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from liaam.errors import LiaamError
from liaam.formatting import short_repr
from liaam.io.files import count_of, some_names
from liaam.io.sides import OTHER_SIDE, contradiction
from liaam.model.shape import align, mirror_order, procrustes_mean
from liaam.model.sides import ORIGINAL, Sides

# Least ratio of the distances from shapes of the other side to those from shapes of its own, as medians over all
# shapes, at which shapes say which are mirrored. Of wings, shells, cephalograms and faces, of which half were mirrored,
# 5 to all at a time, it was 3 to 20, and no shape of 21,000 was assigned wrongly.
CLEARLY = 2.0
MOST_COMPARED = 300  # Largest number of shapes to compare all pairs of; others are compared with these
FEWEST = 3  # Fewest shapes, of which two can be of one side
FEWEST_COMMON = 3  # Fewest landmarks that two shapes must share, as any two points can be aligned to two others
LEAST_NORM = 1e-9  # Least norm of a shape about its centroid, relative to its landmarks
ROUNDS = 20  # Largest number of times that shapes change sides; most are assigned by the first
MEDIANS = 3  # Number of times that shapes are aligned to their median
# Largest rotation, radians, from one group to the other with y reversed, and least mean resultant length of the
# rotations within groups, at which the records may have y counted from the other border: their images are not mirrored.
UPRIGHT = np.pi / 4
ALIGNED = 0.8
FEW = 0.1  # Share of mirrored shapes below which, where more are stated, they were reflected before
FEW_MISTAKES = 2  # Mirrored shapes, whose sides are not stated, that may be mistakes, however few shapes there are
MOST_AGAINST = 0.25  # Largest share of stated sides that the shapes may contradict


@dataclass(frozen=True, eq=False)
class SidesOfShapes:
    """The side of each of several shapes.

    Attributes
    ----------
    is_other : (m,) bool
        Which are of the other side than most, and have to be reflected.
    sides : Sides, optional
        The sides; None if there is only one as far as is known, or if shapes of both are alike as they are.
    said : str
        What is not as stated, or may be wrong; empty if nothing.
    against : tuple of int
        Indices of the shapes that contradict the stated side.
    """

    is_other: np.ndarray
    sides: Sides | None = None
    said: str = ""
    against: tuple[int, ...] = ()

    __repr__ = short_repr


def sides_of_shapes(shapes: np.ndarray, stated: Sequence[str], names: Sequence[str]) -> SidesOfShapes:
    """Return the side of each shape.

    Parameters
    ----------
    shapes : (m, n, 2) float
        Landmarks; NaN where missing.
    stated : sequence of str
        Side of each, ``left`` or ``right``, or empty if unknown.
    names : sequence of str
        Names for messages.

    Returns
    -------
    SidesOfShapes
        If sides are stated, and the shapes clearly contradict some of them, the shapes are believed, as landmarks on a
        mirrored object cannot be those of the other side.

    Raises
    ------
    LiaamError
        If a side is neither left nor right, some lack while others are stated, or the shapes contradict many of them.
    """
    check_stated(stated, names)
    shapes = np.asarray(shapes, np.float64)
    nothing = SidesOfShapes(np.zeros(len(shapes), bool))
    if not any(stated):
        group = mirrored_shapes(shapes)
        if not group.any() or are_upside_down(shapes, group):
            return nothing
        return SidesOfShapes(group, Sides(ORIGINAL, int((~group).sum()), int(group.sum())))
    own, is_other = _fewer_are_other(stated)
    by_shape, why_one = others_by_shape(shapes, is_other)
    if by_shape is None:
        return replace(nothing, said=_used_as_they_are(why_one) if is_other.any() else "")
    against = np.flatnonzero(by_shape != is_other).tolist()
    refuse_many_against([names[i] for i in against], len(shapes), "image")
    said = ""
    if against:
        listed = some_names(
            [f"{names[i]} ({contradiction(stated[i], OTHER_SIDE[stated[i]], 'shape')})" for i in against]
        )
        is_or_are = "image is" if len(against) == 1 else "images are"
        said = f"{len(against)} {is_or_are} taken to be of the other side than stated: {listed}"
    return SidesOfShapes(by_shape, _sides(own, by_shape), said, tuple(against))


def mirrored_shapes(shapes: np.ndarray) -> np.ndarray:
    """Return which shapes are clearly mirrored against most others, where nothing states their sides, (m,) bool.

    Parameters
    ----------
    shapes : (m, n, 2) float64
        Landmarks; NaN where missing.

    Returns
    -------
    (m,) bool
        The smaller group; all False if shapes do not clearly tell, or look the same in a mirror.
    """
    group, ratio = two_groups(shapes)
    if ratio < CLEARLY or not group.any() or is_symmetric(shapes, group):
        return np.zeros(len(shapes), bool)
    return group


def others_by_shape(shapes: np.ndarray, is_other: np.ndarray) -> tuple[np.ndarray | None, str]:
    """Return which shapes are of the other side by themselves, to be compared with what is stated.

    Parameters
    ----------
    shapes : (m, n, 2) float64
        Landmarks; NaN where missing.
    is_other : (m,) bool
        Which are stated to be of the other side. It decides which of two groups of shapes is called the other.

    Returns
    -------
    by_shape : (m,) bool, optional
        As stated if the shapes do not clearly tell; None if no shape is to be reflected.
    why_one : str
        Why none is, or empty.
    """
    group, ratio = two_groups(shapes)
    if is_symmetric(shapes, group):
        return None, "they look the same in a mirror"
    if ratio < CLEARLY:
        return is_other, ""
    if group.mean() < FEW <= is_other.mean():
        return None, "their shapes are alike without a reflection"
    return (group if (group == is_other).mean() >= 0.5 else ~group), ""


def refuse_many_against(against: Sequence[str], n_shapes: int, what: str, otherwise: str = "") -> None:
    """Raise LiaamError if the shapes of many names, of so many in all, contradict the stated side."""
    if len(against) > MOST_AGAINST * n_shapes:
        raise LiaamError(
            f"the sides of {len(against)} of {count_of(n_shapes, what)} are not those of their shapes "
            f"({some_names(against)}): correct the sides (column 'side', folders or names){otherwise}"
        )


def sides_for_check(shapes: np.ndarray, stated: Sequence[str], names: Sequence[str]) -> SidesOfShapes:
    """Return the sides by which landmarks are compared where faults are looked for; as :func:`sides_of_shapes`.

    A few that are mirrored, while sides are not stated, may be mistakes: these are compared as they are.
    """
    found = sides_of_shapes(shapes, stated, names)
    is_few = found.is_other.sum() <= max(FEW_MISTAKES, FEW * len(shapes))
    if found.sides is None or (is_few and not any(stated)):
        return replace(found, is_other=np.zeros(len(shapes), bool), sides=None)
    return found


def check_stated(stated: Sequence[str], names: Sequence[str]) -> None:
    """Raise LiaamError unless all stated sides are left or right, or none is stated."""
    odd = [f"{name} ('{side}')" for name, side in zip(names, stated, strict=True) if side and side not in OTHER_SIDE]
    if odd:
        raise LiaamError(
            f"the side of {count_of(len(odd), 'image')} is neither left nor right: {some_names(odd)}; correct the "
            "column 'side' (left or right, L or R), or give --sides one (sides='one') if it means something else"
        )
    bare = [name for name, side in zip(names, stated, strict=True) if not side]
    if bare and len(bare) < len(names):
        raise LiaamError(
            f"{len(bare)} of {count_of(len(names), 'image')} have no side, and others have: {some_names(bare)}; "
            "complete the column 'side', or remove it, for sides by the shapes"
        )


def _fewer_are_other(stated: Sequence[str]) -> tuple[str, np.ndarray]:
    """Return the side of most, which is right if both are as many, and which are of the other, (m,) bool."""
    n_right = sum(side == "right" for side in stated)
    own = "right" if 2 * n_right >= len(stated) else "left"
    return own, np.array([side != own for side in stated])


def _sides(own: str, is_other: np.ndarray) -> Sides:
    return Sides(own, int((~is_other).sum()), int(is_other.sum()))


def _used_as_they_are(why: str) -> str:
    return f"images of the sides left and right are used as they are, since {why}"


def two_groups(shapes: np.ndarray) -> tuple[np.ndarray, float]:
    """Assign shapes (m, n, 2) to two groups that are mirror images of each other.

    Returns
    -------
    group : (m,) bool
        Which are in the smaller group; all False if all are of one side.
    ratio : float
        By how much the shapes are nearer to each other so than with the other assignment; see :data:`CLEARLY`.
    """
    if len(shapes) < FEWEST:
        return np.zeros(len(shapes), bool), 1.0
    some = np.unique(np.linspace(0, len(shapes) - 1, MOST_COMPARED).astype(int))
    direct, mirrored = _squared_distances(shapes, shapes[some])
    gains = mirrored - direct  # of counting a pair as of one side
    among = gains[some]
    np.fill_diagonal(among, 0.0)
    if not among.any():
        return np.zeros(len(shapes), bool), 1.0
    signs = _signs(np.linalg.eigh(among)[1][:, -1])
    for _ in range(ROUNDS):
        before = signs
        signs = _signs(among @ signs)
        if np.array_equal(signs, before):
            break
    every = _signs(gains @ signs)
    are_same = every[:, None] == signs
    own = np.where(are_same, direct, mirrored)
    other = np.where(are_same, mirrored, direct)
    own[some, np.arange(len(some))] = np.nan  # the distance from itself
    other[some, np.arange(len(some))] = np.nan
    tiny = np.finfo(float).eps
    ratios = np.sqrt((np.nanmedian(other, axis=1) + tiny) / (np.nanmedian(own, axis=1) + tiny))
    group = every < 0
    if group.mean() > 0.5:
        group = ~group
    return group, float(np.median(ratios))


def _signs(values: np.ndarray) -> np.ndarray:
    return np.where(values < 0, -1.0, 1.0)


def _squared_distances(shapes: np.ndarray, others: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Squared Procrustes distances of shapes (m, n, 2) from others (k, n, 2), and from their mirror images, (m, k).

    Pairs are compared at the landmarks that both have; 0 and 0 where they share too few.
    """
    a, known_a = _as_complex(shapes)
    b, known_b = _as_complex(others)
    n_common = known_a @ known_b.T
    is_enough = n_common >= FEWEST_COMMON
    count = np.maximum(n_common, 1.0)
    sum_a = a @ known_b.T  # over the landmarks that both have
    sum_b = known_a @ b.T
    power_a = np.square(np.abs(a)) @ known_b.T - np.square(np.abs(sum_a)) / count
    power_b = known_a @ np.square(np.abs(b)).T - np.square(np.abs(sum_b)) / count
    power = np.maximum(power_a * power_b, LEAST_NORM)
    product = a @ b.conj().T - sum_a * sum_b.conj() / count
    reflected = a @ b.T - sum_a * sum_b / count
    direct = np.where(is_enough, 1.0 - np.square(np.abs(product)) / power, 0.0)
    mirrored = np.where(is_enough, 1.0 - np.square(np.abs(reflected)) / power, 0.0)
    return np.maximum(direct, 0.0), np.maximum(mirrored, 0.0)


def squared_distances_of_pairs(shapes: np.ndarray, others: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Squared Procrustes distances of shapes (m, n, 2) from another each, and from its mirror image, (m,) each."""
    pairs = [_squared_distances(shape[None], other[None]) for shape, other in zip(shapes, others, strict=True)]
    return np.array([direct.item() for direct, _ in pairs]), np.array([mirrored.item() for _, mirrored in pairs])


def _as_complex(shapes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Shapes as complex numbers (m, n), centred and of norm 1, 0 where missing; and which landmarks are known."""
    known = np.isfinite(shapes).all(axis=2).astype(float)
    points = np.where(known > 0, shapes[..., 0] + 1j * shapes[..., 1], 0.0)
    centre = points.sum(axis=1, keepdims=True) / np.maximum(known.sum(axis=1, keepdims=True), 1.0)
    points = (points - centre) * known
    norm = np.linalg.norm(points, axis=1, keepdims=True)
    return points / np.where(norm > 0, norm, 1.0), known


def reflected_shapes(shapes: np.ndarray, which: np.ndarray) -> np.ndarray:
    """Return shapes (m, n, 2) with x reversed in those of ``which`` (m,)."""
    return shapes * np.where(which[:, None, None], [-1.0, 1.0], 1.0)


def is_symmetric(shapes: np.ndarray, group: np.ndarray) -> bool:
    """Return whether the median of shapes (m, n, 2), of one side, is its own mirror image with landmarks exchanged."""
    is_known = ~np.isnan(shapes).any(axis=2).all(axis=0)
    shapes = reflected_shapes(shapes, group)[:, is_known]
    middle = procrustes_mean(shapes)
    for _ in range(MEDIANS):  # a few shapes with exchanged landmarks must not make it asymmetric
        middle = np.nanmedian([align(shape, middle)(shape) for shape in shapes], axis=0)
    return bool(np.isfinite(middle).all()) and mirror_order(middle) is not None


def are_upside_down(shapes: np.ndarray, group: np.ndarray) -> bool:
    """Return whether a group of shapes (m, n, 2) becomes upright like the others with y reversed, instead of x."""
    one = _turns(shapes[~group], shapes[~group])
    other = _turns(shapes[group] * [1.0, -1.0], shapes[~group])
    if min(abs(one.mean()), abs(other.mean())) < ALIGNED:
        return False
    return bool(abs(np.angle(other.mean() * one.mean().conjugate())) < UPRIGHT)


def _turns(shapes: np.ndarray, of: np.ndarray) -> np.ndarray:
    """Rotations of shapes (k, n, 2) relative to the most complete of others, as complex numbers of modulus 1, (k,)."""
    reference = of[np.isfinite(of).sum(axis=(1, 2)).argmax()]
    matrices = np.array([align(shape, reference).matrix for shape in shapes])
    turns = matrices[:, 0, 0] + 1j * matrices[:, 1, 0]
    return turns / np.maximum(np.abs(turns), LEAST_NORM)
