"""The solvers that the experiments compare: liaam's own and the paper's."""

import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from liaam.errors import MethodError
from liaam.fitting import Fitter, SolverOptions, get_method
from liaam.model import AAM, MESH
from liaam.training import train
from liaam.training.options import BLURS, Blurs

MAX_ITERATIONS = 50


@dataclass(frozen=True)
class Solver:
    """Options of training and of the solver, and their description.

    ``blurs`` are the levels of the model and ``prior`` the estimator of the shape covariance, by default those of
    ``liaam train``; if all modes are kept, the prior is ``sample``. ``variance`` is the fraction kept in
    person-specific models of the simulated experiments, ``diagonal`` that of the reference frame in pixels.
    """

    summary: str
    options: SolverOptions
    blurs: Mapping[str, Blurs] | None
    variance: float = 1.0
    diagonal: float = 150.0
    prior: str | None = None

    def train(self, data: Iterable, **options: Any) -> AAM:
        """Train a model for this solver, with `options` of :func:`liaam.train`.

        By default it is trained without lamps and for all methods.
        """
        own = {"variance": self.variance, "blurs": self.blurs, "diagonal": self.diagonal}
        own |= {"leave_out": False, "lamps": None, "methods": "all"}
        options = {**own, **options}
        whole = options["variance"] == 1.0
        return train(data, **{"prior": "sample" if whole else self.prior, **options})


PAPER = Solver(
    "pure Gauss-Newton on shape, appearance and angle together, one level",
    SolverOptions(max_iterations=MAX_ITERATIONS, damping=0.0, shape_prior=0.0, elimination="joint", observable=0.0),
    {MESH: BLURS[MESH][-1:]},
    prior="sample",
)

LIAAM = Solver(
    "damped steps, a prior on the shape, appearance eliminated, two levels of blur",
    SolverOptions(max_iterations=MAX_ITERATIONS),
    None,
)

SOLVERS = {
    "liaam": LIAAM,
    "liaam-smooth": replace(LIAAM, summary=f"{LIAAM.summary}; all methods with smooth deformations", prior="smooth"),
    "liaam-sample": replace(
        LIAAM, summary=f"{LIAAM.summary}; soft-li without smooth deformations, too", prior="sample"
    ),
    "paper": PAPER,
    "paper-90": replace(PAPER, summary=f"{PAPER.summary}; modes of 90 % of the variance", variance=0.9),
    "paper-100px": replace(PAPER, summary=f"{PAPER.summary}; reference frame of 100 px", diagonal=100.0),
    "paper-theta1": replace(
        PAPER,
        summary=f"{PAPER.summary}; the image's angle starts at the trained one",
        options=replace(PAPER.options, angle_start="model"),
    ),
}
"""Solvers by name. Those that start with ``paper-`` change one choice that the paper leaves open."""


def get_solver(name: str) -> Solver:
    """Get a solver by name. Raises a MethodError if there is none of that name."""
    if name not in SOLVERS:
        raise MethodError(f"unknown solver {name!r}; choose from {', '.join(SOLVERS)}")
    return SOLVERS[name]


def make_fitters(model: AAM, methods: Sequence[str], solver: str) -> dict[str, Fitter]:
    """One fitter per method, with a solver's options."""
    return {method: Fitter(model, method, get_solver(solver).options) for method in methods}


@dataclass(frozen=True)
class Request:
    """What was asked for; :data:`experiments.cli.HELP` describes the fields."""

    data: Path | None
    methods: tuple[str, ...]
    trials: int
    seed: int
    solver: str

    def __post_init__(self) -> None:
        """Raise, before any work, if the request is invalid."""
        for method in self.methods:
            row = get_method(method)
            if not self.has_lamps and (row.illumination or row.appearance == "varied"):
                raise MethodError(
                    f"method {method} needs a model that has been trained with lamps; "
                    "'python -m experiments generic --lamps' and 'python -m experiments baselines' compare it"
                )
        if not self.methods:
            raise MethodError("no method is given; see 'liaam fit --help' for those that exist")
        if len(set(self.methods)) < len(self.methods):
            raise MethodError(f"a method is given twice: {', '.join(self.methods)}")
        get_solver(self.solver)
        if self.trials < 1:
            raise MethodError("trials must be at least 1")

    @property
    def has_lamps(self) -> bool:
        """Whether models are trained with lamps."""
        return False

    def settings(self) -> dict[str, Any]:
        """Settings that determine the results, in addition to the images."""
        solver = f"{self.solver}: {get_solver(self.solver).summary}"
        return {"methods": list(self.methods), "trials": self.trials, "seed": self.seed, "solver": solver}

    def rng(self, *what: str | int) -> np.random.Generator:
        """Return the generator of one draw. It depends on the seed and on `what`, so methods share it."""
        return np.random.default_rng([self.seed, *(zlib.crc32(str(item).encode()) for item in what)])
