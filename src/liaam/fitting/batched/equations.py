"""Normal equations of many fits at once: :mod:`liaam.fitting.normal_equations` with a leading batch dimension."""

from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

from array_api_compat import array_namespace
from array_api_compat import device as device_of

from liaam.fitting.normal_equations import BLOCK, RIDGE

Array = Any
Tree = TypeVar("Tree", bound=tuple)


def map_arrays(function: Callable[..., Array], first: Tree, *others: Tree) -> Tree:
    """Apply a function to the arrays of tuples (of tuples) that are built alike."""

    def of(*parts: Any) -> Any:
        return map_arrays(function, *parts) if isinstance(parts[0], tuple) else function(*parts)

    made = [of(*parts) for parts in zip(first, *others, strict=True)]
    return type(first)(*made) if hasattr(first, "_fields") else type(first)(made)


def choose(mask: Array, there: Tree, here: Tree) -> Tree:
    """Take the items of a mask (b,) from one tuple of arrays, and the others from another one."""

    def pick(a: Array, b: Array) -> Array:
        xp = array_namespace(a)
        return xp.where(xp.reshape(mask, (-1,) + (1,) * (a.ndim - 1)), a, b)

    return map_arrays(pick, there, here)


class Equations(NamedTuple):
    """Gram matrices of one linearisation each (see :class:`liaam.fitting.normal_equations.NormalEquations`).

    Attributes
    ----------
    jj : (b, n_q, n_q) float64
    jr : (b, n_q) float64
    aj : (b, m, n_q) float64
    aa : (b, m, m) float64
    ar : (b, m) float64
    rr : (b,) float64
    weight : (b,) float64
    inverse : (b, m, m) float64
        Regular inverse of A'A.
    unit : (b,) float64
        NaN where it is not known.
    """

    jj: Array
    jr: Array
    aj: Array
    aa: Array
    ar: Array
    rr: Array
    weight: Array
    inverse: Array
    unit: Array


def apply(matrix: Array, vector: Array) -> Array:
    """Products of matrices (b, i, j) and vectors (b, j), (b, i)."""
    return (matrix @ vector[..., None])[..., 0]


def gram(left: Array, right: Array) -> Array:
    """Give left' right of tall float32 matrices (b, n, i) and (b or 1, n, j), (b, i, j) float64: summed in blocks."""
    xp = array_namespace(left)
    n = left.shape[1]
    whole = n - n % BLOCK
    total = xp.astype(xp.matrix_transpose(left[:, whole:]) @ right[:, whole:], xp.float64)
    if not whole:
        return total
    first, second = (
        xp.reshape(matrix[:, :whole], (-1, whole // BLOCK, BLOCK, matrix.shape[2])) for matrix in (left, right)
    )
    return total + xp.sum(xp.matrix_transpose(first) @ second, axis=1, dtype=xp.float64)


def regular_inverse(matrix: Array) -> Array:
    """Inverses of positive semi-definite matrices (b, m, m), scaled to a unit diagonal, with a tiny ridge."""
    xp = array_namespace(matrix)
    if not matrix.shape[-1]:
        return matrix
    diagonal = xp.linalg.diagonal(matrix)
    root = xp.sqrt(xp.where(diagonal > 0, diagonal, xp.ones_like(diagonal)))
    outer = root[:, :, None] * root[:, None, :]
    return xp.linalg.inv(matrix / outer + RIDGE * identity(matrix)) / outer


def identity(like: Array) -> Array:
    """Unit matrix (m, m) of the type and on the device of matrices (b, m, m)."""
    xp = array_namespace(like)
    return xp.eye(like.shape[-1], dtype=like.dtype, device=device_of(like))


def cost(equations: Equations) -> Array:
    """Mean squared residual, (b,) float64; infinite where no pixel counts."""
    xp = array_namespace(equations.rr)
    counts = equations.weight > 0
    mean = xp.maximum(equations.rr, xp.zeros_like(equations.rr)) / xp.where(counts, equations.weight, 1.0)
    return xp.where(counts, mean, xp.full_like(mean, float("inf")))


def after_lambda_step(equations: Equations, step: Array) -> Equations:
    """Equations after lambda moved by a step (b, m), from Gram matrices alone."""
    xp = array_namespace(step)
    moved = apply(equations.aa, step)
    rr = equations.rr + xp.sum(step * (moved - 2.0 * equations.ar), axis=-1)
    jr = equations.jr - apply(xp.matrix_transpose(equations.aj), step)
    return equations._replace(jr=jr, ar=equations.ar - moved, rr=rr)


def reduced(equations: Equations) -> tuple[Array, Array]:
    """Hessians J'QJ (b, n_q, n_q) and gradients J'Qr (b, n_q) with lambda eliminated."""
    xp = array_namespace(equations.jj)
    carried = xp.matrix_transpose(equations.aj) @ equations.inverse
    hessian = equations.jj - carried @ equations.aj
    return 0.5 * (hessian + xp.matrix_transpose(hessian)), equations.jr - apply(carried, equations.ar)
