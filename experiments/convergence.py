"""How fast do fits converge under light from the side? (Paper Fig 5.)

There are three kinds of data: images of many persons as in the spot protocol (:mod:`experiments.spot`), one person's
images with a simulated shadow (:mod:`experiments.simulated`), or generated scenes, trained under diffuse light and
fitted under lateral light.
"""

from collections.abc import Mapping, Sequence
from functools import lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from experiments import simulated, spot
from experiments.charts import Panel, figure_of_curves
from experiments.protocol import STARTS, TRAINED, Split
from experiments.runner import Experiment, Row, Trial
from experiments.solvers import MAX_ITERATIONS, Request
from experiments.subjects import get_subject, head_scenes, subject_facts
from liaam.error_measures import error_statistics, point_error
from liaam.fitting import FitResult, Fitter
from liaam.photometry import THETA_DEFAULT

if TYPE_CHECKING:
    from matplotlib.figure import Figure

GAMMA = 8.0
"""Displacement of the start in pixels, except in the spot protocol."""

SHOWN = (0, 1, 2, 3, 5, 10, 20, MAX_ITERATIONS)
"""Iterations in the report's table."""

CHOICES = (
    "An iteration is an accepted step. The steps at all levels of blur count, one after the other, and a fit that has "
    "ended keeps its last error. Iteration 0 is what the shape model makes of the start.",
)
SHADOW_CHOICES = (
    f"Starts are the true landmarks displaced by γ = {GAMMA:g} px (standard deviation of each coordinate).",
)
SCENE_CHOICES = (
    *SHADOW_CHOICES,
    "Generated pictures, since no folder was given: those fitted have the poses and expressions of those trained on, "
    "under hard light from the left instead of diffuse light; all modes are kept.",
)


def trace_person(setup: Request, person: Split) -> list[Row]:
    """Trace the fits to one person's spot-lit image."""
    study = spot.study_of(person, setup)
    return [
        row
        for trial in range(setup.trials)
        for row in trace(study.fitters, study.image, study.start(setup.seed, trial), study.truth, person.name, trial)
    ]


def trace_shadow(setup: Request, trial: Trial) -> list[Row]:
    """Trace the fits to one of a person's images under a simulated shadow."""
    fitters = simulated.get_fitters(setup.data, setup.methods, setup.solver)
    case = simulated.make_case(get_subject(setup.data), setup.seed, trial.number, GAMMA, sigma_n=0.0)
    return trace(fitters, case.image, case.start, case.truth, case.picture, trial.number)


def trace_scene(setup: Request, trial: Trial) -> list[Row]:
    """Trace the fits to a generated image under lateral light."""
    fitters = simulated.get_fitters(None, setup.methods, setup.solver, THETA_DEFAULT)
    scenes = _lateral_scenes()
    picture = trial.number % len(scenes)
    truth = scenes[picture].landmarks
    start = simulated.displaced(truth, GAMMA, setup.seed, trial.number)
    return trace(fitters, scenes[picture].image, start, truth, picture, trial.number)


@lru_cache(maxsize=1)
def _lateral_scenes() -> list:
    from scenes import lateral

    return head_scenes(lateral("left"))


def trace(
    fitters: Mapping[str, Fitter],
    image: np.ndarray,
    start: np.ndarray,
    truth: np.ndarray,
    picture: object,
    trial: int,
) -> list[Row]:
    """Fit one image with every method and return one row per iteration."""
    return [
        {"method": method, "picture": picture, "trial": trial, "iteration": iteration, "error_px": error}
        for method, fitter in fitters.items()
        for iteration, error in enumerate(errors_by_iteration(fitter.fit(image, start), truth))
    ]


def errors_by_iteration(result: FitResult, truth: np.ndarray) -> list[float]:
    """Mean landmark error at the start and after each of 50 accepted steps. The last value is repeated."""
    history = result.history
    # A level starts at the end of the previous one, which is not a step.
    states = [state for i, state in enumerate(history) if i == 0 or state.level == history[i - 1].level]
    errors = [point_error(state.landmarks, truth) for state in states[: MAX_ITERATIONS + 1]]
    return errors + errors[-1:] * (MAX_ITERATIONS + 1 - len(errors))


def convergence_experiment(
    data: Path | None = None,
    methods: Sequence[str] = simulated.METHODS,
    trials: int = 24,
    seed: int = 0,
    solver: str = "paper",
) -> Experiment:
    """Make the experiment; :data:`experiments.cli.HELP` describes the parameters."""
    setup = Request(data, tuple(methods), trials, seed, solver)
    light, facts, tasks, work, choices, left_out = _plan(setup)
    return Experiment(
        name="convergence",
        title="Error against iterations under lateral light",
        settings={
            **facts,
            "light": light,
            **setup.settings(),
        },
        tasks=tasks,
        work=partial(work, setup),
        summarise=partial(summarise, setup.methods),
        draw=draw,
        report=partial(report, light),
        choices=(*CHOICES, *choices),
        left_out=left_out,
    )


def _plan(setup: Request) -> tuple:
    """Return light, description of the data, tasks, work, choices and unused images, by the kind of data."""
    numbered = tuple(Trial("all", number) for number in range(setup.trials))
    if setup.data is None:
        facts = {**subject_facts(None), "gamma": GAMMA}
        return "generated, hard, from the left", facts, numbered, trace_scene, SCENE_CHOICES, ()
    persons, left_out = spot.group_persons(setup.data)
    if persons:
        return "a spot light", spot.facts_of(setup.data, persons), persons, trace_person, (STARTS, TRAINED), left_out
    facts = {**subject_facts(setup.data), "gamma": GAMMA}
    return (
        "a simulated shadow",
        facts,
        numbered,
        trace_shadow,
        (*SHADOW_CHOICES, simulated.shadow_choice(), *simulated.CHOICES),
        (),
    )


def summarise(methods: Sequence[str], rows: list[Row]) -> dict[str, Any]:
    """Median and 90th percentile of the error by method and iteration."""
    found: dict[str, Any] = {}
    for method in methods:
        errors = np.array([row["error_px"] for row in rows if row["method"] == method]).reshape(-1, MAX_ITERATIONS + 1)
        statistics = [error_statistics(column) for column in errors.T]
        found[method] = {
            "fits": len(errors),
            **{name: [cell[name] for cell in statistics] for name in ("median", "p90")},
        }
    return {"methods": found}


def draw(_rows: list[Row], summary: dict[str, Any]) -> "Figure":
    """Median error against iterations."""
    curves = {method: list(enumerate(found["median"])) for method, found in summary["methods"].items()}
    panel = Panel("iteration", "median error of the landmarks, px", curves, log=True)
    return figure_of_curves([panel])


def shown(summary: dict[str, Any]) -> dict[str, list[tuple[float, float | None]]]:
    """Median error at some iterations, by method."""
    return {method: [(float(i), found["median"][i]) for i in SHOWN] for method, found in summary["methods"].items()}


def report(light: str, summary: dict[str, Any]) -> str:
    """Format the question and the medians at some iterations."""
    return (
        f"How fast do fits converge when the light has changed between training and fitting (here: {light})? (Paper "
        f"Fig 5.)\n\nMedian error of the landmarks, px, by iteration:\n\n{simulated.table_of_curves(shown(summary))}"
    )
