"""The two ways of solving that experiments compare: liaam's own, and the paper's to the letter."""

from collections.abc import Sequence
from dataclasses import dataclass

from liaam.errors import MethodError
from liaam.fitting import Fitter, SolverOptions, get_method
from liaam.model import AAM
from liaam.training import BLURS_DEFAULT

MAX_ITERATIONS = 50


@dataclass(frozen=True)
class Solver:
    """How to train and to iterate.

    Attributes
    ----------
    summary : str
        For people.
    options : SolverOptions
    blurs : tuple of float
        Levels of the model.
    """

    summary: str
    options: SolverOptions
    blurs: tuple[float, ...]


SOLVERS = {
    "liaam": Solver(
        "damped steps, a prior on the shape, appearance eliminated, two levels of blur",
        SolverOptions(max_iterations=MAX_ITERATIONS),
        BLURS_DEFAULT,
    ),
    "paper": Solver(
        "pure Gauss-Newton on shape, appearance and angle together, one level",
        SolverOptions(max_iterations=MAX_ITERATIONS, damping=0.0, shape_prior=0.0, elimination="joint"),
        BLURS_DEFAULT[-1:],
    ),
}
"""Solvers by name."""


def get_solver(name: str) -> Solver:
    """Look a solver up by name.

    Raises
    ------
    MethodError
        If there is none of that name.
    """
    if name not in SOLVERS:
        raise MethodError(f"solver {name!r} does not exist; there are {', '.join(SOLVERS)}")
    return SOLVERS[name]


def make_fitters(model: AAM, methods: Sequence[str], solver: str) -> dict[str, Fitter]:
    """One fitter per method, with a solver's options."""
    return {method: Fitter(model, method, get_solver(solver).options) for method in methods}


def check_request(methods: Sequence[str], solver: str, trials: int) -> None:
    """Refuse, before any work, methods and solvers that do not exist, and no trials."""
    for method in methods:
        get_method(method)
    if not methods:
        raise MethodError("no method is given; see 'liaam methods' for those that exist")
    if len(set(methods)) < len(methods):
        raise MethodError(f"a method is given twice: {', '.join(methods)}")
    get_solver(solver)
    if trials < 1:
        raise MethodError("trials must be at least 1")
