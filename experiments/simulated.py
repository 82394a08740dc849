"""Fits to images under a simulated shadow, with one condition swept (paper section 7.1, Fig 3).

Each trial applies a random shadow to one of the training images, adds noise, displaces the true landmarks, and fits
with every method. Random values depend only on the seed and the trial: all methods, and all values of the swept
condition, share the same shadow and the same directions of displacement and noise.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from experiments.charts import Panel, figure_of_curves
from experiments.cramer_rao import Bound, cramer_rao_bound
from experiments.runner import Experiment, Row, Trial, markdown_table
from experiments.solvers import Request, get_solver, make_fitters
from experiments.subjects import (
    PAPER_THETA,
    PENUMBRA,
    STRENGTH,
    TEMPERATURE,
    Subject,
    get_subject,
    random_side,
    simulated_shadow,
    subject_facts,
)
from liaam.error_measures import angle_difference, error_statistics, point_error, rms_error, root_mean_square
from liaam.errors import LiaamError
from liaam.fitting import FitResult, Fitter, get_method
from liaam.formatting import finite_or_none
from liaam.model import AAM
from liaam.photometry import CameraModel, encode, invariant, temperature_direction
from liaam.plotting import figure_of_pictures
from liaam.training import TrainingOptions, train

if TYPE_CHECKING:
    from matplotlib.figure import Figure

METHODS = ("grey", "rgb", "li", "li-lit", "li-pc", "li-pcs")


def shadow_colour(strength: float = STRENGTH) -> str:
    """Describe the fraction of light in full shadow, by channel."""
    left = np.exp(strength + TEMPERATURE * temperature_direction(PAPER_THETA))
    return ", ".join(f"{share:.2f}" for share in left)


def shadow_choice(strength: float = STRENGTH) -> str:
    """Describe the choice of the shadow."""
    return (
        "The strength of the simulated shadow is not given: log light changes by "
        f"{strength:g} (1, 1, 1) + {TEMPERATURE:g} d(θ) in full shadow, whose edge goes through the middle of the face "
        f"and is {PENUMBRA:g} px wide; side (left or right) and tilt (up to 20°) are drawn for each trial. Full shadow "
        f"leaves {shadow_colour(strength)} of the red, green and blue light."
    )


CHOICES = (
    "θ = 146° is the camera of the simulated shadow, so models are trained with θ = 146°.",
    "γ and σn are taken as standard deviations: of each coordinate of each landmark, and of each channel of the "
    "stored values, which are cut to [0, 255] but not rounded.",
    "The angle of `li` and `li-lit` starts at its closed-form optimum for the start's shape; those of `li-pc` and "
    "`li-pcs` start at the trained one. Under the solver `liaam` these two are held, so that their error is 0, where "
    "noise hides the change of light; under `paper` they stay free.",
    "All modes of shape and appearance are kept, but under `paper-90`: the pictures fitted are those trained on, under "
    "another light.",
    "Pictures of a folder are halved (means of 2 by 2 pixels in linear light); the reference frame is 150 px across, "
    "but under `paper-100px`.",
)
"""Choices that the paper leaves open, besides the shadow."""

START = "start"
"""Name of the displaced start after projection on the shape model. A fit with a larger error made it worse."""

BOUND = "bound (li)"
"""Name of the invariant's Cramer-Rao bound, in place of a method's name in rows and curves."""

MEDIAN_OF_GAUSSIAN = 0.6745
"""Median absolute value of a Gaussian error, in standard deviations."""

Curves = dict[str, list[tuple[float, float | None]]]
"""Points (swept value, quantity) by method."""


@dataclass(frozen=True)
class Sweep:
    """The swept condition: its column in results.csv, its label with unit, and the others at their values.

    ``gamma`` is the displacement of the start in pixels, ``sigma_n`` the noise in 8-bit units. The figure has a panel
    for the angle if it ``shows_angle``.
    """

    name: str
    title: str
    question: str
    column: str
    label: str
    gamma: float = 0.0
    sigma_n: float = 0.0
    shows_angle: bool = False

    def conditions(self, value: float) -> dict[str, float]:
        """Displacement and noise at a swept value."""
        return {"gamma": self.gamma, "sigma_n": self.sigma_n, self.column: value}


@dataclass(frozen=True)
class Setup(Request):
    """What was asked for, with the swept condition and the change of log light in the shadow."""

    sweep: Sweep
    strength: float = STRENGTH


@dataclass(frozen=True, eq=False)
class Case:
    """An image to fit, (h, w, 3) float32 in [0, 1], truth and start (n, 2), and the image's index."""

    image: np.ndarray
    truth: np.ndarray
    start: np.ndarray
    picture: int


def make_case(
    subject: Subject, seed: int, trial: int, gamma: float, sigma_n: float, strength: float = STRENGTH
) -> Case:
    """Apply a shadow to one of a subject's images, add noise, and displace the truth."""
    shadow, noise = (np.random.default_rng([seed, trial, stream]) for stream in (0, 2))
    picture = trial % len(subject.images)
    truth = subject.shapes[picture]
    image, _ = simulated_shadow(subject.images[picture], truth, random_side(shadow), strength=strength)
    if sigma_n > 0:
        image = np.clip(image + sigma_n / 255 * noise.standard_normal(image.shape), 0, 1).astype(np.float32)
    return Case(image, truth, displaced(truth, gamma, seed, trial), picture)


def displaced(truth: np.ndarray, gamma: float, seed: int, trial: int) -> np.ndarray:
    """Move each coordinate of each landmark by N(0, gamma)."""
    return truth + gamma * np.random.default_rng([seed, trial, 1]).standard_normal(truth.shape)


@lru_cache(maxsize=2)
def get_fitters(
    data: Path | None, methods: tuple[str, ...], solver: str, theta: float = PAPER_THETA
) -> dict[str, Fitter]:
    """Train on the subject, all modes kept; once per process."""
    subject = get_subject(data)
    model = get_solver(solver).train(subject.pairs, camera=CameraModel(theta=theta), name=subject.name)
    return make_fitters(model, methods, solver)


@lru_cache(maxsize=2)
def sharp_model(data: Path | None) -> AAM:
    """Train on the subject without blur and with all modes, as the true model of a bound."""
    subject = get_subject(data)
    options = TrainingOptions(variance=1.0, prior="sample", blurs=(0.0,), methods="all", leave_out=False)
    return train(subject.pairs, options, camera=CameraModel(theta=PAPER_THETA), name=subject.name)


def run_trial(setup: Setup, trial: Trial) -> list[Row]:
    """Fit one case with every method."""
    fitters = get_fitters(setup.data, setup.methods, setup.solver)
    conditions = setup.sweep.conditions(trial.condition)
    case = make_case(get_subject(setup.data), setup.seed, trial.number, **conditions, strength=setup.strength)
    rows = []
    for method, fitter in fitters.items():
        result = fitter.fit(case.image, case.start)
        rows.append(
            {
                "method": method,
                setup.sweep.column: trial.condition,
                "trial": trial.number,
                "image": case.picture,
                "start_px": point_error(result.start, case.truth),
                "error_px": point_error(result.landmarks, case.truth),
                "rms_px": rms_error(result.landmarks, case.truth),
                "theta_error_deg": float(np.rad2deg(angle_error(result, PAPER_THETA))),
                "iterations": result.n_iterations,
                "status": str(result.status),
            }
        )
    return rows + _bound_rows(setup, trial)


def _bound_rows(setup: Setup, trial: Trial) -> list[Row]:
    """Return the bound of the invariant for the same image without noise, in a row like that of a fit."""
    conditions = setup.sweep.conditions(trial.condition)
    if not conditions["sigma_n"] > 0:
        return []
    sigma, (picture, unit) = conditions["sigma_n"], _unit_bound(setup.data, setup.seed, trial.number, setup.strength)
    row: Row = {
        "method": BOUND,
        setup.sweep.column: trial.condition,
        "trial": trial.number,
        "image": picture,
        "start_px": np.nan,
        "error_px": sigma * unit.mean_distance,
        "rms_px": sigma * unit.rms,
        "theta_error_deg": float(np.rad2deg(sigma * unit.theta)),
        "iterations": 0,
        "status": "",
    }
    return [row]


@lru_cache(maxsize=256)
def _unit_bound(data: Path | None, seed: int, trial: int, strength: float) -> tuple[int, Bound]:
    """Image index of a trial, and its bound at a noise of 1 of 255. The bound is proportional to the noise."""
    case = make_case(get_subject(data), seed, trial, 0.0, 0.0, strength)
    return case.picture, cramer_rao_bound(sharp_model(data), case.image, case.truth, "li", 1 / 255)


def angle_error(result: FitResult, truth: float) -> float:
    """Error of the image's angle, in radians; NaN for methods without one.

    The angles of both cameras are ambiguous by half a turn. The model's angle resolves the ambiguity.
    """
    half_turn = np.pi if np.cos(result.theta_model - truth) < 0 else 0.0
    return angle_difference(result.theta - half_turn, truth)


def simulated_experiment(
    sweep: Sweep,
    values: Sequence[float],
    data: Path | None = None,
    methods: Sequence[str] = METHODS,
    trials: int = 24,
    seed: int = 0,
    solver: str = "paper",
    strength: float = STRENGTH,
) -> Experiment:
    """Make the experiment of a sweep over some values; :data:`experiments.cli.HELP` describes the other parameters.

    Trial i uses image i modulo 6.
    """
    setup = Setup(data, tuple(methods), trials, seed, solver, sweep, strength)
    if not -5.0 <= strength <= 0.0:
        raise LiaamError(f"strength {strength:g}: give the shadow's change of log light, -5 (black) to 0 (none)")
    conditions = sweep.conditions(0.0)
    return Experiment(
        name=sweep.name,
        title=sweep.title,
        settings={
            **subject_facts(data),
            **setup.settings(),
            "strength": float(strength),
            **{key: value for key, value in conditions.items() if key != sweep.column},
            sweep.column: [float(value) for value in values],
        },
        tasks=tuple(Trial(float(value), number) for value in values for number in range(trials)),
        work=partial(run_trial, setup),
        summarise=partial(summarise, sweep.column, setup.methods),
        draw=partial(draw, sweep),
        report=partial(report, sweep),
        pictures=partial(draw_pictures, setup),
        choices=(shadow_choice(strength), *CHOICES),
    )


def summarise(column: str, methods: Sequence[str], rows: list[Row]) -> dict[str, Any]:
    """Statistics by method and swept value, with the efficiency of the light-invariant ones."""
    values = sorted({row[column] for row in rows})

    def at(method: str, value: float) -> list[Row]:
        return [row for row in rows if row["method"] == method and row[column] == value]

    bounds = [{column: value, **bound_statistics(at(BOUND, value))} for value in values if at(BOUND, value)]
    least = {cell[column]: cell["rms_px"] for cell in bounds if cell["rms_px"] is not None}
    return {
        "swept": column,
        "start_px_median": [
            [value, float(np.median([r["start_px"] for r in at(methods[0], value)]))] for value in values
        ],
        "bound": bounds,
        "li_and_lit_px": _differences(column, rows),
        "methods": {
            method: [
                {column: value, **statistics(at(method, value), least.get(value) if _is_invariant(method) else None)}
                for value in values
            ]
            for method in methods
        },
    }


def _differences(column: str, rows: list[Row]) -> list[dict[str, Any]] | None:
    """Differences between the errors of ``li`` and ``li-lit``, by fit, at each value; None without both methods."""
    errors = {
        method: {(row[column], row["trial"]): row["error_px"] for row in rows if row["method"] == method}
        for method in ("li", "li-lit")
    }
    if not all(errors.values()):
        return None
    gaps = {key: abs(error - errors["li-lit"][key]) for key, error in errors["li"].items()}
    values = sorted({value for value, _ in gaps})
    return [
        {column: v, **error_statistics(np.array([gap for key, gap in gaps.items() if key[0] == v]))} for v in values
    ]


def _is_invariant(method: str) -> bool:
    return get_method(method).metric == "invariant"


def bound_statistics(rows: list[Row]) -> dict[str, Any]:
    """Bound at one value: the approximate medians of an efficient estimator, and the root mean square."""
    return {
        "error_px": finite_or_none(np.median([row["error_px"] for row in rows])),
        "rms_px": finite_or_none(root_mean_square([row["rms_px"] for row in rows])),
        "theta_error_deg": finite_or_none(MEDIAN_OF_GAUSSIAN * np.median([row["theta_error_deg"] for row in rows])),
    }


def statistics(rows: list[Row], least: float | None) -> dict[str, Any]:
    """Statistics of one method at one value; `least` is the bound of its root mean square error."""
    angles = np.abs([row["theta_error_deg"] for row in rows])
    statuses = [row["status"] for row in rows]
    spread = root_mean_square([row["rms_px"] for row in rows])
    return {
        "error_px": error_statistics(np.array([row["error_px"] for row in rows])),
        "rms_px": finite_or_none(spread),
        "efficiency": None if least is None else least / spread,
        "theta_error_deg": error_statistics(angles),
        "iterations_median": float(np.median([row["iterations"] for row in rows])),
        "statuses": {status: statuses.count(status) / len(rows) for status in sorted(set(statuses))},
    }


def curves(summary: dict[str, Any], quantity: str, statistic: str | None = None) -> Curves:
    """A quantity, or its statistic, against the swept value, by method; methods without it are left out."""
    lines = {
        method: [(cell[summary["swept"]], cell[quantity][statistic] if statistic else cell[quantity]) for cell in cells]
        for method, cells in summary["methods"].items()
    }
    return {method: line for method, line in lines.items() if any(y is not None for _, y in line)}


def references(summary: dict[str, Any], quantity: str) -> Curves:
    """Reference lines of a quantity's medians: the start, and the bound if there is noise."""
    lines: Curves = {START: summary["start_px_median"]} if quantity == "error_px" else {}
    if summary["bound"]:
        lines[BOUND] = [(cell[summary["swept"]], cell[quantity]) for cell in summary["bound"]]
    return lines


QUANTITIES = {
    "error_px": "median error of the landmarks, px",
    "theta_error_deg": "median error of the image's θ, degrees",
}


def draw(sweep: Sweep, _rows: list[Row], summary: dict[str, Any]) -> "Figure":
    """Draw the median error against the swept value, with that of the start and, on request, of the angle."""
    shown = list(QUANTITIES.items())[: 2 if sweep.shows_angle else 1]
    return figure_of_curves(
        [
            Panel(sweep.label, label, curves(summary, quantity, "median"), references(summary, quantity), log=True)
            for quantity, label in shown
        ]
    )


def draw_pictures(setup: Setup) -> "Figure":
    """An image without and with its simulated shadow, and their invariants (paper Fig 2)."""
    subject = get_subject(setup.data)
    case = make_case(subject, setup.seed, 0, 0.0, 0.0, setup.strength)
    pair = {"in training": subject.images[case.picture], "under the shadow": case.image}
    invariants = {name: invariant(encode(image, "log")[..., :3], PAPER_THETA) for name, image in pair.items()}
    low, high = np.percentile(invariants["in training"], (1, 99))
    scaled = {
        f"invariant, {name}": np.clip((values - low) / (high - low + 1e-9), 0, 1) for name, values in invariants.items()
    }
    return figure_of_pictures([{**pair, **scaled}])


def report(sweep: Sweep, summary: dict[str, Any]) -> str:
    """Format the question, the medians and the efficiencies."""
    parts = [sweep.question]
    for quantity, what in QUANTITIES.items():
        lines = curves(summary, quantity, "median")
        if lines:
            what = f"{what[0].upper()}{what[1:]}"
            parts += [f"{what}, by {sweep.label}:", table_of_curves({**lines, **references(summary, quantity)})]
    efficiencies = curves(summary, "efficiency")
    if efficiencies:
        parts += [
            f"Efficiency (bound of li / RMS error of the landmarks), by {sweep.label}:",
            table_of_curves(efficiencies),
        ]
    return "\n\n".join(parts)


def table_of_curves(lines: Mapping[str, Sequence[tuple[float, float | None]]]) -> str:
    """Format curves as a markdown table, one row per method. The first curve must have all swept values."""
    if not lines:
        return "Nothing finite."
    values = [x for x, _ in next(iter(lines.values()))]
    header = ["method", *(f"{x:g}" for x in values)]
    cells = {method: {x: y for x, y in line if y is not None} for method, line in lines.items()}
    rows = [[method, *(f"{line[x]:.3f}" if x in line else "–" for x in values)] for method, line in cells.items()]
    return markdown_table(header, rows)
