"""Options of the solver. The loop is ``src/core/level.cpp``, and :mod:`liaam.fitting.reference.loop` in NumPy."""

from dataclasses import dataclass, fields, replace
from functools import cached_property, lru_cache
from numbers import Integral, Real
from typing import Any

import numpy as np

from liaam.errors import MethodError
from liaam.fitting.methods import Method
from liaam.fitting.thresholds import THRESHOLDS
from liaam.formatting import changed_repr

ELIMINATIONS = ("varpro", "joint")
ANGLE_STARTS = ("best", "model")

FINITE = (
    "tolerance",
    "early_tolerance",
    "relative_tolerance",
    "damping",
    "shape_prior",
    "final_prior",
    "observable",
)
"""Options that are finite numbers of at least 0."""

OPTIONAL = ("early_tolerance", "final_prior", "scoring")
"""Options that may be None: the default is the method's own, or the model's."""

MOST_ITERATIONS = 1_000_000
"""Largest number of steps that makes sense: fits take about 15, and the core counts them in 32 bits."""


@dataclass(frozen=True)
class SolverOptions:
    """Options of the iteration.

    Attributes
    ----------
    max_iterations : int
        Maximum number of steps per level, rejected ones included.
    tolerance : float
        Stop when a step moves the landmarks by less than this root mean square, model pixels.
    early_tolerance : float, optional
        Tolerance in the first steps of a level, as a fraction of its blur; 0 disables it. By default 0.25 in the first
        3 steps with the expected gradient, and 0.1 in the first 10 of the other kind. Most fits get so near after two
        or three steps. The others are difficult, and continue until ``tolerance``. At the finest level, steps that
        others with the expected gradient follow stop at 0.4.
    relative_tolerance : float
        Stop also when a step is shorter than this fraction of its own standard deviation, root mean square over the
        parameters. Applies to ``soft-li``, which estimates that deviation. A step of a tenth of it adds a hundredth to
        the variance of a landmark, and shorter ones go to and fro. Coarse levels allow 1.5 times as much
        (``COARSE_RELATIVE``): with 3 times, fits from distant starts stop too early there.
    elimination : {"varpro", "joint"}
        Solve for lambda at every state (variable projection), or update it by the joint step (paper section 4, eq 10).
    damping : float
        Initial Levenberg damping, relative to the Hessian's diagonal (with the expected gradient: to the expected
        Hessian). 0 is pure Gauss-Newton as in the paper, which accepts every step.
    shape_prior : float
        Strength of the Gaussian prior on the shape modes: 1 as learnt, 0 none (the paper).
    final_prior : float, optional
        Strength of that prior at the finest level, as a fraction of ``shape_prior``. By default as the model has learnt
        from left-out images (:attr:`liaam.model.Reliability.final_prior`). A strong prior finds the object, a weaker
        one lets its shape vary more.
    observable : float
        Estimate a common change of both angles only if its curvature exceeds this multiple of the curvature due to
        noise. Measured: 1-16 without a change of light, since the model's errors are not pure noise; 100 and more under
        a lateral light in generated scenes.
    angle_start : {"best", "model"}
        Start theta_2 at its closed-form optimum for the initial shape, or at the model's angle.
    scoring : int, optional
        Maximum number of steps with the expected gradient at the end of the finest level, with weights updated. By
        default, methods that compare logarithms end each level with up to 10 such steps, with fixed
        weights, and other methods with none. All steps of ``soft-li`` use the expected gradient.
    """

    max_iterations: int = 50
    tolerance: float = 0.01
    early_tolerance: float | None = None
    relative_tolerance: float = 0.1
    elimination: str = "varpro"
    damping: float = 1e-3
    shape_prior: float = 1.0
    final_prior: float | None = None
    observable: float = 25.0
    angle_start: str = "best"
    scoring: int | None = None

    __repr__ = changed_repr

    def __post_init__(self) -> None:
        """Raise an error for invalid options."""
        if self.elimination not in ELIMINATIONS:
            raise MethodError(f"unknown elimination {self.elimination!r}; choose from {', '.join(ELIMINATIONS)}")
        if self.angle_start not in ANGLE_STARTS:
            raise MethodError(f"unknown angle_start {self.angle_start!r}; choose from {', '.join(ANGLE_STARTS)}")
        for name in FINITE:
            value = getattr(self, name)
            if value is None and name in OPTIONAL:
                continue
            if not isinstance(value, Real) or not 0.0 <= float(value) < np.inf:
                raise MethodError(f"{name} {value!r}: give a finite number of at least 0")
        for name in ("max_iterations", "scoring"):
            value = getattr(self, name)
            if value is None and name in OPTIONAL:
                continue
            if not isinstance(value, Integral) or not 0 <= int(value) <= MOST_ITERATIONS:
                raise MethodError(f"{name} {value!r}: give a whole number from 0 to {MOST_ITERATIONS:,}")

    @cached_property
    def as_dict(self) -> dict[str, Any]:
        """The options in the form that the core takes."""
        return {each.name: getattr(self, each.name) for each in fields(self)}


def scored(method: Method, options: SolverOptions) -> Method:
    """Return a method with the kind of steps that the options ask for."""
    if options.scoring and method.step == "own":
        return replace(method, step="scored")
    return method


@lru_cache(maxsize=16)
def coarse_options(options: SolverOptions) -> SolverOptions:
    """Return looser options for a coarse level, whose solution only starts the next."""
    scoring = None if options.scoring is None else 0
    tolerance = THRESHOLDS["COARSE"] * options.tolerance
    relative_tolerance = THRESHOLDS["COARSE_RELATIVE"] * options.relative_tolerance
    return replace(options, tolerance=tolerance, relative_tolerance=relative_tolerance, scoring=scoring)
