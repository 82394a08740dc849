"""Normal equations of the fit: accumulated from pixels here, solved without pixels (paper eq 5, 9, 10).

The residual is linear in lambda and linearised in q = (p, free angles):

    r(q + dq, lambda + dl) = r + J dq - A dl

All that a step needs are Gram matrices of the columns [J | r] and A. QJ, with Q the projection on the
complement of A, is never formed: J'QJ = J'J - (A'J)' (A'A)^-1 (A'J).
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Self

import numpy as np

SINGULAR = 1e-11
"""Least square on the diagonal of a Cholesky factor, as a share of the matrix's largest entry, that is no rounding."""

STEEPEST = 1e300
"""What no ratio of curvatures exceeds."""

FEW = 0.25
"""Share of a matrix's eigenvectors up to which those alone take less time than all."""

FLATTEST = 1e-6
"""Share by which a Hessian has to be steeper than needs be to be used as it is."""

BLOCK = 1024
"""Residuals whose products are summed in float32 before they are added up in float64."""

RIDGE = 1e-8
"""Relative ridge on A'A, far below any mode that can be seen; it keeps unseen modes from exploding."""


ROUNDING = 1e-7
"""Least eigenvalue of an expected Hessian, as a share of its largest: below it single precision says nothing."""


def gram(left: np.ndarray, right: np.ndarray, block: int = BLOCK) -> np.ndarray:
    """Products of the rows of two wide float32 matrices, (a, b) float64: BLAS in blocks, summed in float64."""
    total = np.zeros((len(left), len(right)))
    for i in range(0, left.shape[1], block):
        # The same array twice goes to BLAS's symmetric product, at half the work.
        part = left[:, i : i + block]
        total += part @ (part if right is left else right[:, i : i + block]).T
    return total


def on_diagonal(matrix: np.ndarray) -> np.ndarray:
    """Diagonal of a matrix, (n,): a view that may be written to, for a tenth of what index arrays take."""
    for along in (matrix, matrix.T):
        if along.flags.c_contiguous:
            return along.reshape(-1)[:: len(matrix) + 1]
    return np.einsum("ii->i", matrix)


def regular_inverse(matrix: np.ndarray) -> np.ndarray:
    """Inverse of a positive semi-definite matrix after scaling to a unit diagonal, with a tiny ridge."""
    diagonal = matrix.diagonal()
    root = np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    outer = root[:, None] * root
    scaled = matrix / outer
    ridged = on_diagonal(scaled)  # a view
    ridged += RIDGE
    if not len(matrix):
        return scaled
    inverse, failed = _lapack("posv")(scaled, np.eye(len(matrix)), lower=1)[1:]
    return (np.linalg.inv(scaled) if failed else inverse) / outer


def positive_inverse(matrix: np.ndarray) -> np.ndarray | None:
    """Inverse of a symmetric positive definite matrix; None where it is not, or where doubles hardly tell."""
    factor = _positive_factor(matrix)
    if factor is None:
        return None
    half = _lapack("potri")(factor, lower=1)[0]
    inverse = half + half.T
    inverse_diagonal = on_diagonal(inverse)  # a view
    inverse_diagonal *= 0.5
    return inverse


def diagonal_of_inverse(matrix: np.ndarray) -> np.ndarray | None:
    """Diagonal of what :func:`positive_inverse` gives."""
    factor = _positive_factor(matrix)
    return None if factor is None else np.square(_lapack("trtri")(factor, lower=1)[0]).sum(axis=0)


def _positive_factor(matrix: np.ndarray) -> np.ndarray | None:
    """Cholesky factor of a matrix that is safely positive."""
    factor, failed = _lapack("potrf")(matrix, lower=1)
    # Written so that NaN counts as failed.
    safe = not failed and on_diagonal(factor).min() ** 2 > SINGULAR * matrix.diagonal().max()
    return factor if safe else None


def solve_lifted(base: np.ndarray, hessian: np.ndarray, right: np.ndarray, lift: float, damping: float) -> np.ndarray:
    """Solve by a symmetric matrix that is nowhere flatter than a share of another one, and damped by that.

    Parameters
    ----------
    base : (n, n) float64
        Positive, but for rounding; nought as a whole it may not be.
    hessian : (n, n) float64
    right : (n,) float64
    lift, damping : float
        With H v = rho B v, rho becomes max(rho, lift) + damping.

    Returns
    -------
    (n,) float64
    """
    potrf, potrs, sygst = (_lapack(name) for name in ("potrf", "potrs", "sygst"))
    flat = _negative_count(hessian - (lift + FLATTEST) * base)
    if not flat:  # as near the end
        damped = hessian + damping * base
        factor, failed = potrf(damped, lower=1)
        # What is steep by rounding only is no slope to go down on.
        if not failed and on_diagonal(factor).min() ** 2 > ROUNDING * damped.trace():
            return potrs(factor, right, lower=1)[0]
    factor, failed = potrf(base, lower=1)
    # Sums of float32 products need not be quite positive.
    if failed or on_diagonal(factor).min() ** 2 < ROUNDING * base.trace():
        return _solve_lifted_by_axes(base, hessian, right, lift, damping)
    found = _least_eigenvalues(sygst(hessian, factor, lower=1)[0], lift, flat)
    if found is None:
        return _solve_lifted_by_axes(base, hessian, right, lift, damping)
    ratios, axes = found
    low = factor @ axes  # all other directions stay as they are
    lifted = hessian + damping * base + (low * (lift - ratios)) @ low.T
    solution, failed = _lapack("posv")(lifted, right, lower=1)[1:]
    return _solve_lifted_by_axes(base, hessian, right, lift, damping) if failed else solution


def _negative_count(matrix: np.ndarray) -> int:
    """Count of a symmetric matrix's negative eigenvalues, by Sylvester's law: of a factor, in a tenth of their time."""
    factor, pivots, _ = _lapack("sytrf")(matrix, lower=1)
    alone = pivots > 0  # the others are pivots of 2 by 2, each with one eigenvalue below nought
    return int(np.count_nonzero(on_diagonal(factor)[alone] < 0) + np.count_nonzero(~alone) // 2)


def _least_eigenvalues(matrix: np.ndarray, below: float, about: int) -> tuple[np.ndarray, np.ndarray] | None:
    """Eigenvalues of a symmetric matrix below a limit, ``about`` so many, and vectors in columns; None if it fails."""
    if about <= FEW * len(matrix):
        values, axes, count, _, failed = _lapack("syevx")(matrix, range="V", vl=-STEEPEST, vu=below, lower=1)
    else:
        values, axes, failed = _lapack("syevd")(matrix, lower=1)
        count = np.count_nonzero(values < below)
    return None if failed else (values[:count], axes[:, :count])


@lru_cache(maxsize=16)
def _lapack(name: str) -> Callable:
    """LAPACK itself: of systems this small, checking takes as long as solving."""
    from scipy.linalg.lapack import get_lapack_funcs  # heavy: imported when first needed

    return get_lapack_funcs((name,), dtype=np.float64)[0]


def _solve_lifted_by_axes(
    base: np.ndarray, hessian: np.ndarray, right: np.ndarray, lift: float, damping: float
) -> np.ndarray:
    """As :func:`solve_lifted`, with the least eigenvalues of the base lifted out of its rounding."""
    sizes, axes = np.linalg.eigh(base)
    whiten = axes / np.sqrt(np.maximum(sizes, ROUNDING * sizes[-1]))
    ratios, axes = np.linalg.eigh(whiten.T @ hessian @ whiten)
    axes = whiten @ axes
    return axes @ ((axes.T @ right) / (np.maximum(ratios, lift) + damping))


@dataclass(frozen=True, eq=False, kw_only=True)
class Sums:
    """What the residual and the appearance say together, without derivatives: all that lambda and the cost need.

    Attributes
    ----------
    aa : (m, m) float64
        A'A.
    ar : (m,) float64
        A'r.
    rr : float
        r'r.
    weight : float
        Sum of the pixels' weights times the rows of P: what a mean residual divides by.
    unit : float
        Variance, correlation included, that a residual of weight 1 stands for; NaN where it is not known.
    inverse : (m, m) float64, optional
        :func:`regular_inverse` of A'A, where it is known already.
    """

    aa: np.ndarray
    ar: np.ndarray
    rr: float
    weight: float
    inverse: np.ndarray | None = None
    unit: float = np.nan

    @cached_property
    def _inverse(self) -> np.ndarray:
        return regular_inverse(self.aa) if self.inverse is None else self.inverse

    @property
    def cost(self) -> float:
        """Mean squared residual; infinite where no pixel counts."""
        return max(self.rr, 0.0) / self.weight if self.weight > 0 else np.inf

    def best_lambda_step(self) -> np.ndarray:
        """Change of lambda that minimises the residual at fixed q, (m,) float64."""
        return self._inverse @ self.ar

    def after_lambda_step(self, step: np.ndarray) -> "Sums":
        """Sums after lambda moved by a step, from Gram matrices alone."""
        explained = self.aa @ step
        rr = float(self.rr - 2.0 * step @ self.ar + step @ explained)
        ar, inverse = self.ar - explained, self._inverse
        return Sums(aa=self.aa, ar=ar, rr=rr, weight=self.weight, inverse=inverse, unit=self.unit)


@dataclass(frozen=True, eq=False, kw_only=True)
class NormalEquations(Sums):
    """Gram matrices of one linearisation.

    Attributes
    ----------
    jj : (n_q, n_q) float64
        J'J.
    jr : (n_q,) float64
        J'r.
    aj : (m, n_q) float64
        A'J.
    """

    jj: np.ndarray
    jr: np.ndarray
    aj: np.ndarray

    @classmethod
    def of(cls, sums: Sums, jj: np.ndarray, jr: np.ndarray, aj: np.ndarray) -> Self:
        """Add the products of the derivatives to what is known without them."""
        return cls(
            aa=sums.aa,
            ar=sums.ar,
            rr=sums.rr,
            weight=sums.weight,
            inverse=sums.inverse,
            unit=sums.unit,
            jj=jj,
            jr=jr,
            aj=aj,
        )

    @cached_property
    def _reduced(self) -> tuple[np.ndarray, np.ndarray]:
        carried = self.aj.T @ self._inverse
        hessian = self.jj - carried @ self.aj
        return 0.5 * (hessian + hessian.T), self.jr - carried @ self.ar

    def after_lambda_step(self, step: np.ndarray, sums: Sums | None = None) -> "NormalEquations":
        """Equations after lambda moved by a step, from Gram matrices alone, and the sums then if they are known."""
        sums = super().after_lambda_step(step) if sums is None else sums
        return self.of(sums, self.jj, self.jr - self.aj.T @ step, self.aj)

    def reduced(self) -> tuple[np.ndarray, np.ndarray]:
        """Hessian J'QJ (n_q, n_q) and gradient J'Qr (n_q,) with lambda eliminated."""
        return self._reduced

    def lambda_step(self, step: np.ndarray) -> np.ndarray:
        """Change of lambda that goes with a step of q in the joint system, (m,) float64."""
        return self._inverse @ (self.ar + self.aj @ step)
