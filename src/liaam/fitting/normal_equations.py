"""Normal equations of the fit: accumulated from pixels here, solved without pixels (paper eq 5, 9, 10).

The residual is linear in lambda and linearised in q = (p, free angles):

    r(q + dq, lambda + dl) = r + J dq - A dl

All that a step needs are Gram matrices of the columns [J | r] and A. QJ, with Q the projection on the
complement of A, is never formed: J'QJ = J'J - (A'J)' (A'A)^-1 (A'J).
"""

from dataclasses import dataclass, replace

import numpy as np

BLOCK = 4096
"""Rows whose products are summed in float32 before they are added up in float64."""

RIDGE = 1e-8
"""Relative ridge on A'A, far below any mode that can be seen; it keeps unseen modes from exploding."""


def gram(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Give left' right of two tall float32 matrices, (a, b) float64: BLAS in blocks, summed in float64."""
    rows = len(left)
    whole = rows // BLOCK * BLOCK
    total = left[whole:].T.astype(np.float64) @ right[whole:].astype(np.float64)
    if whole:
        blocks = left[:whole].reshape(-1, BLOCK, left.shape[1])
        others = right[:whole].reshape(-1, BLOCK, right.shape[1])
        total += np.matmul(blocks.transpose(0, 2, 1), others).sum(axis=0, dtype=np.float64)
    return total


@dataclass(frozen=True)
class NormalEquations:
    """Gram matrices of one linearisation.

    Attributes
    ----------
    jj : (n_q, n_q) float64
        J'J.
    jr : (n_q,) float64
        J'r.
    aj : (m, n_q) float64
        A'J.
    aa : (m, m) float64
        A'A.
    ar : (m,) float64
        A'r.
    rr : float
        r'r.
    weight : float
        Sum of the pixels' weights times the rows of P: what a mean residual divides by.
    """

    jj: np.ndarray
    jr: np.ndarray
    aj: np.ndarray
    aa: np.ndarray
    ar: np.ndarray
    rr: float
    weight: float

    @property
    def cost(self) -> float:
        """Mean squared residual; infinite where no pixel counts."""
        return max(self.rr, 0.0) / self.weight if self.weight > 0 else np.inf

    def best_lambda_step(self) -> np.ndarray:
        """Change of lambda that minimises the residual at fixed q, (m,) float64."""
        return _solve_symmetric(self.aa, self.ar)

    def after_lambda_step(self, step: np.ndarray) -> "NormalEquations":
        """Equations after lambda moved by a step, from Gram matrices alone."""
        return replace(
            self,
            jr=self.jr - self.aj.T @ step,
            ar=self.ar - self.aa @ step,
            rr=self.rr - 2.0 * step @ self.ar + step @ self.aa @ step,
        )

    def reduced(self) -> tuple[np.ndarray, np.ndarray]:
        """Hessian J'QJ (n_q, n_q) and gradient J'Qr (n_q,) with lambda eliminated."""
        solved = _solve_symmetric(self.aa, np.column_stack([self.aj, self.ar]))
        hessian = self.jj - self.aj.T @ solved[:, :-1]
        return 0.5 * (hessian + hessian.T), self.jr - self.aj.T @ solved[:, -1]

    def lambda_step(self, step: np.ndarray) -> np.ndarray:
        """Change of lambda that goes with a step of q in the joint system, (m,) float64."""
        return _solve_symmetric(self.aa, self.ar + self.aj @ step)


def _solve_symmetric(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solve a positive semi-definite system after scaling to a unit diagonal, with a tiny ridge."""
    if not len(matrix):
        return np.zeros_like(right)
    diagonal = np.diag(matrix)
    root = np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    scaled = matrix / np.outer(root, root)
    scaled[np.diag_indices_from(scaled)] += RIDGE
    scale = root if right.ndim == 1 else root[:, None]
    return np.linalg.solve(scaled, right / scale) / scale
