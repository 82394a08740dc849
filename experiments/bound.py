"""Cramer-Rao bound of the error for each kind of measurement, and how close fits come to it."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from experiments.charts import Panel, figure_of_curves
from experiments.cramer_rao import cramer_rao_bound
from experiments.runner import Experiment, Row, Trial
from experiments.simulated import Curves, make_case, sharp_model, table_of_curves
from experiments.solvers import Request
from experiments.subjects import get_subject, subject_facts
from liaam.error_measures import root_mean_square
from liaam.fitting import Method
from liaam.formatting import finite_or_none

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SIGMAS = (1.0, 2.0, 5.0, 10.0, 15.0, 20.0)

MEASURES = {
    "grey": "grey",
    "rgb": "rgb",
    "log-rgb": Method("log-rgb", "log-RGB, light known", "log", "log", "rgb"),
    "log-rgb+gains": Method(
        "log-rgb+gains", "log-RGB, the light's colour and strength unknown", "log", "log", "rgb", bias="rows"
    ),
    "chroma": "chroma",
    "li": "li",
}
"""Kinds of measurement, from the most to the least information per pixel."""

UNDER = {"same light": tuple(MEASURES), "shadow": ("li",)}
"""Measurements that are valid under each light. Under a shadow of another colour, only the invariant is."""

CHOICES = (
    "Noise is white, of the stored values (sRGB), before they are cut to [0, 255]; the bound takes every pixel inside "
    "the mesh once, all modes of shape and appearance as unknown, and no prior.",
    "It is the root mean square over landmarks, pictures and draws. Pixels too dark or too bright for a logarithm do "
    "not count for log-rgb, chroma and li.",
    "Under the shadow only the invariant describes the pictures exactly, so only its bound is given there.",
)


def run_trial(setup: Request, sigmas: tuple[float, ...], trial: Trial) -> list[Row]:
    """Compute all bounds for one image, with and without its shadow."""
    model, subject = sharp_model(setup.data), get_subject(setup.data)
    case = make_case(subject, setup.seed, trial.number, gamma=0.0, sigma_n=0.0)
    images = {"same light": subject.images[case.picture], "shadow": case.image}
    rows = []
    for light, measures in UNDER.items():
        for measure in measures:
            # The bound is proportional to the noise.
            unit = cramer_rao_bound(model, images[light], case.truth, MEASURES[measure], 1 / 255)
            rows += [
                {
                    "light": light,
                    "measure": measure,
                    "sigma_n": sigma,
                    "trial": trial.number,
                    "image": case.picture,
                    "bound_px": sigma * unit.rms,
                    "theta_bound_deg": float(np.rad2deg(sigma * unit.theta)),
                }
                for sigma in sigmas
            ]
    return rows


def bound_experiment(
    data: Path | None = None, trials: int = 24, seed: int = 0, sigmas: Sequence[float] = SIGMAS
) -> Experiment:
    """Make the experiment; :data:`experiments.cli.HELP` describes the parameters."""
    setup = Request(data, ("li",), trials, seed, "paper")
    sigmas = tuple(map(float, sigmas))
    return Experiment(
        name="bound",
        title="The bound that noise sets",
        settings={
            **subject_facts(data),
            "measures": list(MEASURES),
            "trials": trials,
            "seed": seed,
            "sigma_n": list(sigmas),
        },
        tasks=tuple(Trial("all", number) for number in range(trials)),
        work=partial(run_trial, setup, sigmas),
        summarise=summarise,
        draw=draw,
        report=report,
        choices=CHOICES,
    )


def summarise(rows: list[Row]) -> dict[str, Any]:
    """Root mean square of the bounds by light, measure and noise."""
    found: dict[str, Any] = {}
    for light, measures in UNDER.items():
        found[light] = {
            measure: [
                {"sigma_n": sigma, **_rms([r for r in rows if _is(r, light, measure, sigma)])}
                for sigma in sorted({row["sigma_n"] for row in rows})
            ]
            for measure in measures
        }
    return {"bounds": found}


def _is(row: Row, light: str, measure: str, sigma: float) -> bool:
    return (row["light"], row["measure"], row["sigma_n"]) == (light, measure, sigma)


def _rms(rows: list[Row]) -> dict[str, float | None]:
    return {
        column: finite_or_none(root_mean_square([row[column] for row in rows]))
        for column in ("bound_px", "theta_bound_deg")
    }


def curves(summary: dict[str, Any], light: str, quantity: str) -> Curves:
    """A bound against the noise, by measure; measures without the quantity are left out."""
    lines = {
        measure: [(cell["sigma_n"], cell[quantity]) for cell in cells]
        for measure, cells in summary["bounds"][light].items()
    }
    return {measure: line for measure, line in lines.items() if any(y is not None for _, y in line)}


def draw(_rows: list[Row], summary: dict[str, Any]) -> "Figure":
    """Bounds of the landmarks under the same light, and of the invariant's under the shadow."""
    shadow: dict[str, Curves] = {
        quantity: {"li, under the shadow": curves(summary, "shadow", quantity)["li"]}
        for quantity in ("bound_px", "theta_bound_deg")
    }
    noise = "noise σn, of 255"
    return figure_of_curves(
        [
            Panel(
                noise,
                "bound of the landmarks, px",
                curves(summary, "same light", "bound_px"),
                shadow["bound_px"],
                log=True,
            ),
            Panel(
                noise,
                "bound of the image's θ, degrees",
                curves(summary, "same light", "theta_bound_deg"),
                shadow["theta_bound_deg"],
                log=True,
            ),
        ]
    )


def report(summary: dict[str, Any]) -> str:
    """One table for each light."""
    parts = ["What is the least error that noise leaves to an unbiased estimator that measures a picture in each way?"]
    for light in UNDER:
        lines = curves(summary, light, "bound_px")
        parts += [
            f"**{light[0].upper()}{light[1:]}**: bound of the landmarks (RMS), px, by σn of 255:",
            table_of_curves(lines),
        ]
    price = summary["bounds"]["same light"]
    li, rgb = (price[measure][0]["bound_px"] for measure in ("li", "rgb"))
    if li is None or rgb is None:
        return "\n\n".join(parts)
    ratio = li / rgb
    parts.append(
        f"Invariance has its price: under the same light, at the same noise, `li` is at best {ratio:.1f} times as far "
        "from the truth as `rgb`."
    )
    return "\n\n".join(parts)
