"""Fit a model to images: the search for the object, the table of methods, and the one objective and solver of all."""

from liaam.fitting.detection import Detection
from liaam.fitting.fitter import Fitter
from liaam.fitting.loop.options import SolverOptions
from liaam.fitting.many import fit_each, fit_many
from liaam.fitting.methods import METHODS, Method, features_method, get_method
from liaam.fitting.result import FitResult, FitStatus, Iteration
from liaam.fitting.search.finder import Finder, find
from liaam.fitting.search.starts import check_start, read_start, start_file
from liaam.fitting.single import fit, fit_all

__all__ = [
    "METHODS",
    "Detection",
    "Finder",
    "FitResult",
    "FitStatus",
    "Fitter",
    "Iteration",
    "Method",
    "SolverOptions",
    "check_start",
    "features_method",
    "find",
    "fit",
    "fit_all",
    "fit_each",
    "fit_many",
    "get_method",
    "read_start",
    "start_file",
]
