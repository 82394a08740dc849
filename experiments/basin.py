"""From how far away do fits still find the object? (The basin of convergence, person by person.)

Starts are disturbed by shift, rotation and scale together, far more than in the spot protocol. The end of a fit is
compared with the landmarks, and with the end of the fit from a small disturbance. The second comparison does not depend
on the error of a method's own minimum.
"""

from collections.abc import Sequence
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from experiments.charts import Panel, figure_of_curves
from experiments.measures import percent
from experiments.protocol import (
    CONVERGED,
    METHODS,
    TRAINED,
    Header,
    Split,
    Table,
    Trained,
    eight_bit,
    face_size,
    group_by_person,
    select,
    tell,
)
from experiments.runner import Experiment, Row
from experiments.solvers import Request
from experiments.spot import group_persons
from experiments.subjects import data_facts
from liaam.error_measures import nme, point_error
from liaam.model.shape import rotation

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SHIFT, TURN, SCALE = 0.25, float(np.deg2rad(15.0)), 0.20
"""Largest disturbance: shift as a fraction of the inter-ocular distance, rotation in radians, and change of scale."""

SMALL = 0.1
"""Size of a small disturbance, as a fraction of the largest one."""

SAME_END = 0.01
"""Distance below which two fits have the same end, as a fraction of the inter-ocular distance."""

AT_LEAST = 6
"""Minimum number of images of a person. Half of them train, and a model needs three."""

EDGES = (0.0, 0.05, 0.10, 0.15, 0.20, 0.25, 0.30, 0.50)
"""Bins of the size of a disturbance: mean distance of the landmarks from the undisturbed start, divided by the IOD."""

CHOICES = (
    f"Starts: the mean shape at the true centroid and size, moved by up to {SHIFT:.0%} of the inter-ocular distance in "
    f"a random direction, turned by up to {np.rad2deg(TURN):.0f}° and scaled by up to {SCALE:.0%}, all uniform; small: "
    f"{SMALL:.0%} of that, drawn once for each picture.",
    "Size of a disturbance: mean distance of the start's landmarks from the undisturbed start's.",
    "Pictures: those of the spot protocol where a folder has them (diffuse ones train, the spot-lit one is fitted), "
    "else every other picture of each person trains, from the first, and the rest are fitted. Where nobody knows which "
    "landmarks are eyes, 0.3 diagonals of the landmarks' box stand for the inter-ocular distance.",
    TRAINED,
)


def find_splits(folder: Path) -> tuple[tuple[Split, ...], tuple[str, ...]]:
    """Split each person's images into training and test images; the unused ones are returned with the reasons."""
    persons, left_out = group_persons(folder)
    if persons:
        return persons, left_out
    groups, left_out = group_by_person(folder, AT_LEAST)
    return tuple(Split(name, samples[0::2], samples[1::2]) for name, samples in groups.items()), left_out


def placed(mean: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Place the mean shape at the true centroid and size, (n, 2) float64."""
    centre, centred = truth.mean(axis=0), mean - mean.mean(axis=0)
    return centred * (np.linalg.norm(truth - centre) / np.linalg.norm(centred)) + centre


def disturbed(shape: np.ndarray, unit: float, share: float, rng: np.random.Generator) -> np.ndarray:
    """Shift, turn and scale a shape (n, 2) about its centroid, by up to a share of the largest disturbance.

    ``unit`` is the inter-ocular distance in pixels.
    """
    length, direction = share * SHIFT * unit * rng.uniform(), rng.uniform(0, 2 * np.pi)
    turn = rotation(rng.uniform(-share * TURN, share * TURN))
    scale = 1 + rng.uniform(-share * SCALE, share * SCALE)
    centre = shape.mean(axis=0)
    return scale * (shape - centre) @ turn.T + centre + length * np.array([np.cos(direction), np.sin(direction)])


def fit_person(request: Request, split: Split) -> list[Row]:
    """Fit one person's images from all starts."""
    trained = Trained.on(request, split.training, split.key)
    rows = []
    for sample in split.tested:
        image, truth = eight_bit(sample), sample.landmarks.points
        labels = {"person": split.name, "picture": sample.name}
        rows += [labels | row for row in fit_picture(request, trained, image, truth, sample.name)]
    return rows


def fit_picture(request: Request, trained: Trained, image: np.ndarray, truth: np.ndarray, name: str) -> list[Row]:
    """Fit one image from all starts with every method. Distances are divided by the inter-ocular distance.

    ``disturbance`` is the size of the start's disturbance, ``reference_nme`` the error of the fit from a small
    disturbance, and ``away`` the mean distance between the ends of both fits.
    """
    unit, rest = face_size(truth), placed(trained.mean, truth)
    near = disturbed(rest, unit, SMALL, request.rng(name, "near"))
    starts = [disturbed(rest, unit, 1.0, request.rng(name, trial)) for trial in range(request.trials)]
    rows = []
    for method, fitter in trained.fitters.items():
        reference = fitter.fit(image, near).landmarks
        for trial, start in enumerate(starts):
            result = fitter.fit(image, start)
            error, away = nme(result.landmarks, truth, unit), _distance(result.landmarks, reference) / unit
            rows.append(
                {
                    "method": method,
                    "trial": trial,
                    "disturbance": point_error(start, rest) / unit,
                    "nme": error,
                    "converged": int(error < CONVERGED),
                    "reference_nme": nme(reference, truth, unit),
                    "away": away,
                    "same_end": int(away < SAME_END),
                    "iterations": result.n_iterations,
                    "status": str(result.status),
                }
            )
    return rows


def _distance(shape: np.ndarray, reference: np.ndarray) -> float:
    """Mean distance of two fits' landmarks, infinite if either is not finite."""
    return point_error(shape, reference) if np.isfinite(reference).all() else np.inf


def basin_experiment(
    data: Path, methods: Sequence[str] = METHODS, trials: int = 20, seed: int = 0, solver: str = "liaam"
) -> Experiment:
    """Make the experiment; :data:`experiments.cli.HELP` describes the parameters."""
    request = Request(data, tuple(methods), trials, seed, solver)
    splits, left_out = find_splits(data)
    samples = [sample for split in splits for sample in (*split.training, *split.tested)]
    return Experiment(
        name="basin",
        title="Basin of convergence: fits from far away",
        settings={"data": data.resolve().name, **data_facts(samples), **request.settings()},
        tasks=splits,
        work=partial(fit_person, request),
        summarise=partial(summarise, request.methods),
        draw=draw,
        report=report,
        choices=CHOICES,
        left_out=left_out,
        skips_faults=True,
    )


def summarise(methods: Sequence[str], rows: list[Row]) -> dict[str, Any]:
    """Fractions by method, over all starts and by the size of the disturbance."""
    return {
        "persons": sorted({row["person"] for row in rows}),
        "methods": {
            method: _shares(select(rows, method=method))
            | {"by_disturbance": _by_disturbance(select(rows, method=method))}
            for method in methods
        },
    }


def _shares(rows: Sequence[Row]) -> dict[str, Any]:
    names = ("converged", "same_end")
    if not rows:
        return {"fits": 0, **dict.fromkeys((*names, "reference_converged"))}
    return {
        "fits": len(rows),
        **{name: float(np.mean([row[name] for row in rows])) for name in names},
        "reference_converged": float(np.mean([row["reference_nme"] < CONVERGED for row in rows])),
    }


def _by_disturbance(rows: Sequence[Row]) -> list[dict[str, Any]]:
    classes = np.digitize([row["disturbance"] for row in rows], EDGES[1:-1])
    return [
        {"from": low, "to": high, **_shares([row for row, at in zip(rows, classes, strict=True) if at == i])}
        for i, (low, high) in enumerate(pairwise(EDGES))
    ]


def table(summary: dict[str, Any]) -> tuple[Header, Table]:
    """Fractions by method."""
    header = ["method", "fits", "converged, %", "same end, %", "from near, %"]
    shares = ("converged", "same_end", "reference_converged")
    return header, [
        [method, str(cell["fits"]), *(percent(cell[name], 1) for name in shares)]
        for method, cell in summary["methods"].items()
    ]


def draw(rows: list[Row], summary: dict[str, Any]) -> "Figure":
    """Shares against the size of the disturbance."""
    titles = {"converged": "converged (error < 8 %), %", "same_end": "ended where a near start ends, %"}
    label = "disturbance, % of inter-ocular distance"
    return figure_of_curves([Panel(label, title, _curves(rows, summary, name)) for name, title in titles.items()])


def _curves(rows: list[Row], summary: dict[str, Any], name: str) -> dict[str, list[tuple[float, float | None]]]:
    """Points (middle of a class, share) by method, in per cent; classes without starts are left out."""
    return {
        method: [
            (50 * (cell["from"] + cell["to"]), 100 * cell[name]) for cell in found["by_disturbance"] if cell["fits"]
        ]
        for method, found in summary["methods"].items()
    }


def report(summary: dict[str, Any]) -> str:
    """Format the question and the fractions."""
    question = (
        "From how far away do fits find the object? Models of one person each, of "
        f"{len(summary['persons'])} persons. Converged: mean distance to the landmarks below 8 % of the inter-ocular "
        "distance. Same end: within 1 % of where the same method ends from a small disturbance, right or wrong. From "
        "near: converged from that one."
    )
    return tell(question, table(summary))
