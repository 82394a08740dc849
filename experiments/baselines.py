"""Do the paper's references [1], [6], [11] and [12] work in the situations they were designed for?

Each situation breaks the plain comparison of luminance in one way that a reference addresses: another light similar to
one in training, a patch over a fifth of the face, or a change of gain and offset.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache, partial
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from experiments.charts import figure_of_bars
from experiments.measures import or_dash
from experiments.runner import Experiment, Row, Trial, markdown_table
from experiments.simulated import displaced
from experiments.solvers import Request, get_solver, make_fitters
from experiments.subjects import (
    PAPER_THETA,
    TILT,
    Subject,
    get_subject,
    random_side,
    simulated_shadow,
    subject_facts,
)
from liaam.datasets import Sample
from liaam.error_measures import error_statistics, point_error
from liaam.fitting import Fitter
from liaam.io import Landmarks
from liaam.photometry import CameraModel

if TYPE_CHECKING:
    from matplotlib.figure import Figure

GAMMA = 4.0
"""Displacement of the start, pixels (standard deviation of each coordinate)."""

COPIES = 4
"""Number of relit training copies of each image."""

COVERED = 0.2
"""Fraction of the face's bounding box under the patch."""


@dataclass(frozen=True)
class Situation:
    """One way to break the plain comparison.

    Of the ``methods`` that are compared, the papers of those in ``claimed`` claim to beat the ``baseline``.
    """

    name: str
    title: str
    baseline: str
    methods: tuple[str, ...]
    claimed: tuple[str, ...]


ROBUST = ("grey+huber", "grey+l1", "grey+cauchy", "grey+geman-mcclure", "grey+tukey", "grey+learnt")

SITUATIONS = (
    Situation(
        "light",
        "a shadow whose like was in the training set",
        "grey",
        ("grey", "grey+tukey", "varied", "aia", "igo", "li"),
        ("varied", "aia"),
    ),
    Situation(
        "occlusion",
        "a patch over a fifth of the face",
        "grey",
        ("grey", *ROBUST, "igo", "igo+tukey"),
        ROBUST,
    ),
    Situation(
        "gain",
        "another gain and offset of the stored values",
        "grey-plain",
        ("grey-plain", "grey-norm", "grey", "igo"),
        ("grey-norm", "grey"),
    ),
)

CHOICES = (
    f"Starts are displaced by γ = {GAMMA:g} px; all modes are kept; pictures fitted are those trained on, changed.",
    "Light: three of the six pictures under simulated shadows from the left and from the right, whose edges tilt by "
    f"10° either way, are the lamps of training, which learns from {COPIES} relit copies of each picture; the tilt of "
    "the shadows fitted is drawn from ±20°. `varied` and `aia` agree where all modes are kept, because both then span "
    "the same pictures.",
    f"Occlusion: a rectangle of {COVERED:.0%} of the face's bounding box, of a random colour, anywhere in its middle.",
    "Gain: stored values become 0.5 to 0.8 of themselves plus 0 to 0.15. `grey` holds gain and offset among its modes, "
    "so the plain comparison is `grey-plain` here.",
)


@lru_cache(maxsize=1)
def get_fitters(data: Path | None, solver: str) -> dict[str, Fitter]:
    """Train on the subject, with lamps learnt from some of its shadowed images; once per process."""
    subject = get_subject(data)
    model = get_solver(solver).train(
        subject.pairs,
        camera=CameraModel(theta=PAPER_THETA),
        lamps=[shown for i in range(0, len(subject.pairs), 2) for shown in in_shadow(subject, i)],
        training_lamp="even",
        copies=COPIES,
        name=subject.name,
    )
    return make_fitters(model, sorted({method for situation in SITUATIONS for method in situation.methods}), solver)


def in_shadow(subject: Subject, picture: int) -> Iterator[Sample]:
    """Return one of a subject's images as it is and with the shadows used in training."""
    image, shape = subject.pairs[picture]
    yield Sample(f"{picture}-even", image, Landmarks(shape))
    for number, (side, tilt) in enumerate(product((0.0, np.pi), (-TILT / 2, TILT / 2))):
        yield Sample(f"{picture}-shadow{number}", simulated_shadow(image, shape, side + tilt)[0], Landmarks(shape))


def changed_picture(subject: Subject, situation: str, picture: int, rng: np.random.Generator) -> np.ndarray:
    """Change one of a subject's images, (h, w, 3) float32 stored values in [0, 1]."""
    image, shape = subject.pairs[picture]
    if situation == "light":
        return simulated_shadow(image, shape, random_side(rng))[0]
    if situation == "occlusion":
        return covered(image, shape, rng)
    return np.clip(image * rng.uniform(0.5, 0.8) + rng.uniform(0.0, 0.15), 0, 1).astype(np.float32)


def covered(image: np.ndarray, shape: np.ndarray, rng: np.random.Generator, share: float = COVERED) -> np.ndarray:
    """Cover a fraction of a face's bounding box with a rectangle of random colour."""
    low, high = shape.min(axis=0), shape.max(axis=0)
    size = (high - low) * np.sqrt(share)
    corner = low + (high - low) * rng.uniform(0.25, 0.75, 2) - size / 2
    (x0, y0), (x1, y1) = (
        np.clip(np.rint(point).astype(int), 0, image.shape[1::-1]) for point in (corner, corner + size)
    )
    image = image.copy()
    image[y0:y1, x0:x1] = rng.uniform(0, 1, 3)
    return image


def run_trial(setup: Request, trial: Trial) -> list[Row]:
    """Fit one changed image with the situation's methods."""
    fitters, subject = get_fitters(setup.data, setup.solver), get_subject(setup.data)
    situation = next(s for s in SITUATIONS if s.name == trial.condition)
    picture = trial.number % len(subject.images)
    rng = np.random.default_rng([setup.seed, trial.number, 3])
    image, truth = changed_picture(subject, situation.name, picture, rng), subject.shapes[picture]
    start = displaced(truth, GAMMA, setup.seed, trial.number)
    rows = []
    for method in situation.methods:
        result = fitters[method].fit(image, start)
        rows.append(
            {
                "situation": situation.name,
                "method": method,
                "trial": trial.number,
                "image": picture,
                "error_px": point_error(result.landmarks, truth),
                "iterations": result.n_iterations,
                "status": str(result.status),
            }
        )
    return rows


def baselines_experiment(
    data: Path | None = None, trials: int = 24, seed: int = 0, solver: str = "liaam"
) -> Experiment:
    """Make the experiment; :data:`experiments.cli.HELP` describes the parameters."""
    setup = Request(data, ("grey",), trials, seed, solver)  # each situation has its own methods
    return Experiment(
        name="baselines",
        title="The paper's references, each where it should help",
        settings={
            **subject_facts(data),
            **setup.settings(),
            "methods": sorted({method for situation in SITUATIONS for method in situation.methods}),
            "gamma": GAMMA,
        },
        tasks=tuple(Trial(situation.name, number) for situation in SITUATIONS for number in range(trials)),
        work=partial(run_trial, setup),
        summarise=summarise,
        draw=draw,
        report=report,
        choices=CHOICES,
    )


def summarise(rows: list[Row]) -> dict[str, Any]:
    """Statistics by situation and method, and whether each beats the plain comparison."""
    found: dict[str, Any] = {}
    for situation in SITUATIONS:
        cells: dict[str, dict[str, Any]] = {
            method: error_statistics(
                np.array([r["error_px"] for r in rows if (r["situation"], r["method"]) == (situation.name, method)])
            )
            for method in situation.methods
        }
        plain = cells[situation.baseline]["median"]
        for method in situation.claimed:
            median = cells[method]["median"]
            cells[method]["beats_plain"] = median is not None and (plain is None or median < plain)
        found[situation.name] = {"baseline": situation.baseline, "methods": cells}
    return {"situations": found}


def draw(_rows: list[Row], summary: dict[str, Any]) -> "Figure":
    """Median errors as bars, a panel for each situation."""
    groups = {
        situation.title: {m: c["median"] for m, c in summary["situations"][situation.name]["methods"].items()}
        for situation in SITUATIONS
    }
    return figure_of_bars(groups, "median error of the landmarks, px")


def report(summary: dict[str, Any]) -> str:
    """One table for each situation."""
    parts = ["Do the paper's references help where their papers say so, against the plain comparison of luminance?"]
    for situation in SITUATIONS:
        cells = summary["situations"][situation.name]["methods"]
        rows = [
            [method, or_dash(cell["median"]), or_dash(cell["p90"]), _verdict(cell)] for method, cell in cells.items()
        ]
        header = ["method", "median error, px", "90th percentile", f"better than {situation.baseline}"]
        parts += [f"**{situation.title[0].upper()}{situation.title[1:]}**", markdown_table(header, rows)]
    return "\n\n".join(parts)


def _verdict(cell: dict[str, Any]) -> str:
    return {True: "yes", False: "no", None: "–"}[cell.get("beats_plain")]
