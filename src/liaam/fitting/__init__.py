"""Fitting: the table of methods, the objective and the solver that all methods use."""

from typing import TYPE_CHECKING

from liaam.fitting.fitter import Fitter, fit
from liaam.fitting.many import fit_each, fit_many
from liaam.fitting.methods import METHODS, Method, features_method, get_method
from liaam.fitting.result import FitResult, FitStatus, Iteration
from liaam.fitting.search import Candidate, Finder, find
from liaam.fitting.solver import SolverOptions
from liaam.lazy import submodules

__all__ = [
    "METHODS",
    "Candidate",
    "Finder",
    "FitResult",
    "FitStatus",
    "Fitter",
    "Iteration",
    "Method",
    "SolverOptions",
    "features_method",
    "find",
    "fit",
    "fit_each",
    "fit_many",
    "get_method",
]

if TYPE_CHECKING:
    from liaam.fitting import bound as bound
else:
    __getattr__ = submodules(__name__, "bound")
