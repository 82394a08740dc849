"""Fits to pictures under a simulated shadow, with one condition swept (paper section 7.1, Fig 3).

Each trial lays a random shadow over one of the training pictures, adds noise, displaces the true landmarks, and
fits with every method. What is drawn at random depends on the seed and the trial only: all methods, and all
values of the swept condition, see the same shadow and the same directions of displacement and noise.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from liaam.evaluation import angle_difference, error_statistics, point_error
from liaam.experiments.runner import Experiment, Row, markdown_table
from liaam.experiments.solvers import check_request, get_solver, make_fitters
from liaam.experiments.subjects import (
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
from liaam.fitting import FitResult, Fitter
from liaam.plotting import Panel, figure_of_curves
from liaam.training import train

if TYPE_CHECKING:
    from matplotlib.figure import Figure

METHODS = ("grey", "rgb", "li", "li-lit", "li-pc", "li-pcs")

CHOICES = (
    "The strength of the simulated shadow is not given: log light changes by "
    f"{STRENGTH:g} (1, 1, 1) + {TEMPERATURE:g} d(θ) in full shadow, whose edge goes through the middle of the face and "
    f"is {PENUMBRA:g} px wide; side (left or right) and tilt (up to 20°) are drawn for each trial.",
    "θ = 146° is the camera of the simulated shadow, so models are trained with θ = 146°.",
    "γ and σn are taken as standard deviations: of each coordinate of each landmark, and of each channel of the "
    "stored values, which are cut to [0, 255] but not rounded.",
    "The angle of `li` and `li-lit` starts at its closed-form optimum for the start's shape; those of `li-pc` and "
    "`li-pcs` start at the trained one, and are held there, so that their error is 0, where noise hides the change of "
    "light.",
    "All modes of shape and appearance are kept: the pictures fitted are those trained on, under another light.",
    "Pictures of a folder are halved (means of 2 by 2 pixels); the reference frame is 150 px across.",
)
"""What was chosen where the paper leaves it open."""

START = "start"
"""What the shape model makes of a displaced start: a fit that ends above it did harm."""

References = Mapping[str, Mapping[str, Sequence[tuple[float, float | None]]]]
"""Lines to draw in, by column (``error_px`` or ``theta_error_deg``) and name."""


@dataclass(frozen=True)
class Sweep:
    """Which condition is swept, and how that is told.

    Attributes
    ----------
    name, title, question : str
    column : {"gamma", "sigma_n"}
        The swept condition, and its column in results.csv.
    label : str
        With its unit.
    gamma : float
        Displacement of the start where it is not swept, pixels.
    sigma_n : float
        Noise where it is not swept, 8-bit units.
    shows_angle : bool
        Whether the figure has a panel for the angle.
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
class Setup:
    """What all trials share.

    Attributes
    ----------
    sweep : Sweep
    data : Path, optional
        Folder of one person's pictures; generated ones if None.
    methods : tuple of str
    solver : str
    seed : int
    """

    sweep: Sweep
    data: Path | None
    methods: tuple[str, ...]
    solver: str
    seed: int


@dataclass(frozen=True)
class Trial:
    """One task: a swept value and the number of a draw."""

    value: float
    number: int

    @property
    def key(self) -> str:
        """Name for the journal."""
        return f"{self.value:g}, trial {self.number}"


@dataclass(frozen=True, eq=False)
class Case:
    """A picture to fit.

    Attributes
    ----------
    image : (h, w, 3) float32
        Stored sRGB values in [0, 1].
    truth, start : (n, 2) float64
    picture : int
        Which of the subject's pictures it is.
    """

    image: np.ndarray
    truth: np.ndarray
    start: np.ndarray
    picture: int


def make_case(subject: Subject, seed: int, trial: int, gamma: float, sigma_n: float) -> Case:
    """Lay a shadow over one of a subject's pictures, add noise, and displace the truth."""
    shadow, noise = (np.random.default_rng([seed, trial, stream]) for stream in (0, 2))
    picture = trial % len(subject.images)
    truth = subject.shapes[picture]
    image, _ = simulated_shadow(subject.images[picture], truth, random_side(shadow))
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
    model = train(subject.pairs, variance=1.0, theta=theta, blurs=get_solver(solver).blurs, name=subject.name)
    return make_fitters(model, methods, solver)


def run_trial(setup: Setup, trial: Trial) -> list[Row]:
    """Fit one case with every method."""
    fitters = get_fitters(setup.data, setup.methods, setup.solver)
    case = make_case(get_subject(setup.data), setup.seed, trial.number, **setup.sweep.conditions(trial.value))
    rows = []
    for method, fitter in fitters.items():
        result = fitter.fit(case.image, case.start)
        rows.append(
            {
                "method": method,
                setup.sweep.column: trial.value,
                "trial": trial.number,
                "image": case.picture,
                "start_px": point_error(result.start, case.truth),
                "error_px": point_error(result.shape, case.truth),
                "theta_error_deg": float(np.rad2deg(angle_error(result, PAPER_THETA))),
                "iterations": result.n_iterations,
                "status": str(result.status),
            }
        )
    return rows


def angle_error(result: FitResult, truth: float) -> float:
    """Error of the image's angle, radians; NaN for methods without one.

    Both cameras' angles together are known up to half a turn only, so the model's one decides which is meant.
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
    solver: str = "liaam",
    references: References | None = None,
) -> Experiment:
    """Make the experiment of a sweep.

    Parameters
    ----------
    sweep : Sweep
    values : sequence of float
        Of the swept condition.
    data : Path, optional
        Folder of one person's pictures; generated ones if left out.
    methods : sequence of str
    trials : int
        Draws of shadow, start and noise; trial i takes picture i modulo 6.
    seed : int
    solver : {"liaam", "paper"}
    references : mapping, optional
        Lines to draw in, such as a bound: ``{"error_px": {"bound": [(0, 0.01), (4, 0.02)]}}``.
    """
    check_request(tuple(methods), solver, trials)
    setup = Setup(sweep, data, tuple(methods), solver, seed)
    conditions = sweep.conditions(0.0)
    return Experiment(
        name=sweep.name,
        title=sweep.title,
        settings={
            **subject_facts(data),
            "methods": list(methods),
            "trials": trials,
            "seed": seed,
            "solver": f"{solver}: {get_solver(solver).summary}",
            **{key: value for key, value in conditions.items() if key != sweep.column},
            sweep.column: [float(value) for value in values],
        },
        tasks=tuple(Trial(float(value), number) for value in values for number in range(trials)),
        work=partial(run_trial, setup),
        columns={
            "method": "",
            sweep.column: "g",
            "trial": "",
            "image": "",
            "start_px": ".6f",
            "error_px": ".6f",
            "theta_error_deg": ".5f",
            "iterations": "",
            "status": "",
        },
        summarise=partial(summarise, sweep.column, setup.methods),
        draw=partial(draw, sweep, references or {}),
        report=partial(report, sweep),
        choices=CHOICES,
    )


def summarise(column: str, methods: Sequence[str], rows: list[Row]) -> dict[str, Any]:
    """Statistics by method and swept value."""
    values = sorted({row[column] for row in rows})
    return {
        "swept": column,
        "start_px_median": [
            [value, float(np.median([row["start_px"] for row in rows if row[column] == value]))] for value in values
        ],
        "methods": {
            method: [
                {column: value, **statistics([r for r in rows if r["method"] == method and r[column] == value])}
                for value in values
            ]
            for method in methods
        },
    }


def statistics(rows: list[Row]) -> dict[str, Any]:
    """Statistics of one method at one value."""
    angles = np.abs([row["theta_error_deg"] for row in rows])
    statuses = [row["status"] for row in rows]
    return {
        "error_px": error_statistics(np.array([row["error_px"] for row in rows])),
        "theta_error_deg": error_statistics(angles),
        "iterations_median": float(np.median([row["iterations"] for row in rows])),
        "statuses": {status: statuses.count(status) / len(rows) for status in sorted(set(statuses))},
    }


def curves(summary: dict[str, Any], quantity: str, statistic: str) -> dict[str, list[tuple[float, float | None]]]:
    """A statistic against the swept value, by method; methods without the quantity are left out."""
    lines = {
        method: [(cell[summary["swept"]], cell[quantity][statistic]) for cell in cells]
        for method, cells in summary["methods"].items()
    }
    return {method: line for method, line in lines.items() if any(y is not None for _, y in line)}


def draw(sweep: Sweep, references: References, _rows: list[Row], summary: dict[str, Any]) -> "Figure":
    """Median error against the swept value, with that of the start, and the angle's where it is asked for."""
    lines = {START: summary["start_px_median"], **references.get("error_px", {})}
    panels = [
        Panel(
            sweep.label,
            "median error of the landmarks, px",
            curves(summary, "error_px", "median"),
            lines,
            log=True,
        )
    ]
    if sweep.shows_angle:
        angle = Panel(
            sweep.label,
            "median error of the image's θ, degrees",
            curves(summary, "theta_error_deg", "median"),
            references.get("theta_error_deg", {}),
            log=True,
        )
        panels.append(angle)
    return figure_of_curves(panels)


def report(sweep: Sweep, _rows: list[Row], summary: dict[str, Any]) -> str:
    """What was asked, and the medians."""
    parts = [sweep.question]
    more = {"error_px": {START: summary["start_px_median"]}}
    for quantity, what in (("error_px", "error of the landmarks, px"), ("theta_error_deg", "|error of θ|, degrees")):
        lines = curves(summary, quantity, "median")
        if lines:
            lines |= more.get(quantity, {})
            parts += [f"Median {what}, by {sweep.label}:", table_of_curves(lines)]
    return "\n\n".join(parts)


def table_of_curves(lines: Mapping[str, Sequence[tuple[float, float | None]]]) -> str:
    """Curves as a table in markdown, a row per method."""
    header = ["method", *(f"{x:g}" for x, _ in next(iter(lines.values())))]
    rows = [[method, *("–" if y is None else f"{y:.3f}" for _, y in line)] for method, line in lines.items()]
    return markdown_table(header, rows)
