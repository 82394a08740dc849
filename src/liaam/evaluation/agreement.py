"""Automatic landmarks beside people's, for statistics of shape: do they vary as much, and about the same mean?

Errors of landmarks do not tell. A model draws shapes towards its mean where an image says little, so that automatic
shapes vary less than the specimens: means, variances and differences between groups are then too small (attenuation).
With c, x and y the automatic shapes and those of two people, as deviations from their means after one Procrustes
superimposition, and sums over specimens and coordinates,

    slope = sum c y / sum x y,        variance ratio = sum c c / sum x y.

People's errors do not enter the products of different people. If only one has placed landmarks, y is x, and the slope
is that on the labels with their errors: it is too small by the labels' reliability.
"""

from dataclasses import dataclass

import numpy as np

from liaam.errors import LiaamError
from liaam.formatting import short_repr
from liaam.io.files import count_of
from liaam.tables import Columns

FEWEST = 5  # Specimens from which variances are compared
PERMUTATIONS = 999  # Random changes of sign for the test of the means
COMPONENTS = 6  # Principal components that are reported
COPIED = 1e-6  # Largest distance between landmarks that are copies, as a fraction of the centroid size
LEAST_VARIED = 1e-9  # Root mean squared deviation from the mean shape below which shapes are all the same


@dataclass(frozen=True, eq=False)
class ShapeAgreement:
    """How automatic shapes agree with people's.

    Attributes
    ----------
    n_specimens : int
        Specimens that are compared.
    n_left_out : int
        Specimens without all landmarks.
    slope : float
        Slope of automatic on people's shapes: a difference between groups appears multiplied by about this.
    variance_ratio : float
        Variance of automatic shapes as a multiple of that of the specimens.
    mean_distance : float
        Procrustes distance between the mean shapes, as a multiple of the standard error of people's mean.
    p_of_means : float
        Probability of so large a distance if both means are equal: by random changes of sign of each specimen's
        difference.
    size_correlation : float
        Correlation of the centroid sizes.
    size_ratio : float
        Geometric mean of the ratios of automatic to people's centroid sizes.
    components : list of dict
        For each principal component of people's shapes: share of the variance, slope, variance ratio and correlation.
    bias : (n, 2) float64
        Mean difference of each landmark, automatic less people's, in units of centroid size.
    random_error : (n,) float64
        Root mean square of what else differs, in units of centroid size.
    """

    n_specimens: int
    n_left_out: int
    slope: float
    variance_ratio: float
    mean_distance: float
    p_of_means: float
    size_correlation: float
    size_ratio: float
    components: list[dict[str, float]]
    bias: np.ndarray
    random_error: np.ndarray

    __repr__ = short_repr

    def by_component(self) -> Columns:
        """Return one row per principal component of people's shapes."""
        columns: Columns = {"component": list(range(1, len(self.components) + 1))}
        for name in ("share", "slope", "variance_ratio", "correlation"):
            columns[name] = [component[name] for component in self.components]
        return columns

    def by_landmark(self) -> Columns:
        """Return bias and random error of each landmark, in per cent of the centroid size."""
        return {
            "landmark": list(range(1, len(self.bias) + 1)),
            "bias_x_percent": (100 * self.bias[:, 0]).tolist(),
            "bias_y_percent": (100 * self.bias[:, 1]).tolist(),
            "random_percent": (100 * self.random_error).tolist(),
        }

    def report(self) -> str:
        """Describe the agreement in three lines of text."""
        specimens = count_of(self.n_specimens, "specimen")
        by_chance = "as by chance" if self.p_of_means > 0.05 else "more than by chance"
        lines = [
            f"shapes of {specimens}: automatic ones have {self.variance_ratio:.2f} times the variance of the labels, "
            f"and a slope of {self.slope:.2f} on them",
            f"mean shapes: {self.mean_distance:.1f} standard errors apart, {by_chance} (P = {self.p_of_means:.3f})",
            f"centroid sizes: correlation {self.size_correlation:.3f}, ratio {self.size_ratio:.3f}",
        ]
        return "\n".join(lines)


def compare_shapes(
    automatic: np.ndarray,
    labels: np.ndarray,
    second: np.ndarray | None = None,
    *,
    permutations: int = PERMUTATIONS,
    seed: int = 0,
) -> ShapeAgreement:
    """Compare automatic landmarks of some specimens with those that one or two people have placed.

    Parameters
    ----------
    automatic, labels : (m, n, 2) float64
        Landmarks of the same specimens. Specimens that lack landmarks (NaN), or have all in one place, are left out.
    second : (m, n, 2) float64, optional
        Landmarks that another person has placed, or the same person again.
    permutations : int
        Random changes of sign for the test of the means.
    seed : int
        Seed of these.

    Raises
    ------
    LiaamError
        If fewer than 5 specimens have all landmarks, the arrays differ in shape, or the labels are copies of the
        automatic landmarks, or of each other.
    """
    groups = [np.asarray(group, np.float64) for group in (automatic, labels, *(() if second is None else (second,)))]
    if any(group.shape != groups[0].shape for group in groups) or groups[0].ndim != 3:
        raise LiaamError("the landmarks are not of the same specimens: give arrays (m, n, 2) of equal shape")
    complete = np.all([_have_a_shape(group) for group in groups], axis=0)
    n = int(complete.sum())
    if n < FEWEST:
        raise LiaamError(
            f"{count_of(n, 'specimen')} with all landmarks: variances of shape are compared from {FEWEST} specimens on"
        )
    shapes = [_as_complex(group[complete]) for group in groups]
    sizes = [np.linalg.norm(shape, axis=1) for shape in shapes]
    if any(np.abs(shapes[0] - other).max() < COPIED * sizes[0].max() for other in shapes[1:]):
        raise LiaamError("the labels are copies of the automatic landmarks, with which these cannot be compared")
    superimposed = _superimposed(np.concatenate(shapes)).reshape(len(shapes), n, -1)
    deviations = superimposed - superimposed.mean(axis=1, keepdims=True)
    ours = deviations[0]
    first = deviations[1]
    other = deviations[-1]
    if _product(first, first) < n * LEAST_VARIED**2:
        raise LiaamError("the labels of all specimens have one shape, with whose variance none can be compared")
    common = _product(first, other)
    differences = superimposed[0] - superimposed[1]
    bias = differences.mean(axis=0)
    random = differences - bias
    return ShapeAgreement(
        n_specimens=n,
        n_left_out=len(complete) - n,
        slope=_product(ours, other) / common,
        variance_ratio=_product(ours, ours) / common,
        mean_distance=float(np.linalg.norm(bias) / np.sqrt(_product(first, first) / (n - 1) / n)),
        p_of_means=_probability_of(differences, permutations, seed),
        size_correlation=float(np.corrcoef(np.log(sizes[0]), np.log(sizes[1]))[0, 1]),
        size_ratio=float(np.exp(np.mean(np.log(sizes[0] / sizes[1])))),
        components=_components(ours, first, other),
        bias=np.stack([bias.real, bias.imag], axis=1),
        random_error=np.sqrt(np.square(np.abs(random)).mean(axis=0)),
    )


def _have_a_shape(points: np.ndarray) -> np.ndarray:
    """Return which shapes (m, n, 2) have all landmarks, and not all in one place, (m,) bool."""
    return np.isfinite(points).all(axis=(1, 2)) & np.ptp(points, axis=1).any(axis=1)


def _as_complex(points: np.ndarray) -> np.ndarray:
    """Return shapes (m, n, 2) as centred complex numbers (m, n)."""
    numbers = points[..., 0] + 1j * points[..., 1]
    return numbers - numbers.mean(axis=1, keepdims=True)


def _superimposed(shapes: np.ndarray) -> np.ndarray:
    """Superimpose centred shapes (m, n) by generalised Procrustes analysis, with unit size."""
    shapes = shapes / np.linalg.norm(shapes, axis=1, keepdims=True)
    mean = shapes[0]
    for _ in range(50):
        products = shapes @ mean.conj()
        shapes = shapes * (products.conj() / np.abs(products))[:, None]
        new = shapes.mean(axis=0)
        new = new / np.linalg.norm(new)
        moved = float(np.abs(new - mean).max())
        mean = new
        if moved < 1e-12:
            break
    return shapes


def _product(first: np.ndarray, second: np.ndarray) -> float:
    """Return the sum of the scalar products of deviations (m, n)."""
    return float(np.real(first * np.conj(second)).sum())


def _probability_of(differences: np.ndarray, permutations: int, seed: int) -> float:
    """Return the probability of a mean difference as large by random changes of sign of differences (m, n)."""
    rng = np.random.default_rng(seed)
    observed = np.linalg.norm(differences.mean(axis=0))
    signs = rng.choice([-1.0, 1.0], (permutations, len(differences)))
    by_chance = np.linalg.norm(signs @ differences, axis=1) / len(differences)
    return float((1 + (by_chance >= observed * (1 - 1e-12)).sum()) / (1 + permutations))


def _components(ours: np.ndarray, first: np.ndarray, other: np.ndarray) -> list[dict[str, float]]:
    """Compare deviations (m, n) along the principal components of the first person's."""
    ours, first, other = (np.concatenate([np.real(each), np.imag(each)], axis=1) for each in (ours, first, other))
    _, singular, axes = np.linalg.svd(first, full_matrices=False)
    count = min(COMPONENTS, int((singular > 1e-9 * singular[0]).sum()))
    rows = []
    for axis, value in zip(axes[:count], singular[:count], strict=True):
        c = ours @ axis
        x = first @ axis
        y = other @ axis
        common = float(x @ y)
        scale = float(np.sqrt((c @ c) * (x @ x)))
        rows.append(
            {
                "share": float(value**2 / np.square(singular).sum()),
                "slope": float(c @ y) / common,
                "variance_ratio": float(c @ c) / common,
                "correlation": float(c @ x) / scale if scale > 0 else np.nan,
            }
        )
    return rows
