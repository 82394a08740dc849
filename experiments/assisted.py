"""Model-assisted annotation: how accurately does a model of the first few images place the next image's points?

There are twelve persons with one image each. A model of the annotated images finds and fits the object in the others.
The annotator corrects one of them, which joins the annotated images. The experiment compares ways to train the model,
and the order of the images: as drawn, or the least certain first.
"""

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from experiments.charts import figure_of_bars
from experiments.protocol import Header, Table, in_percent, select, statistics, tell
from experiments.runner import Experiment, Row
from experiments.solvers import check_trials
from experiments.spot import EYES, facts_of, find_persons, percent
from liaam.datasets import Sample
from liaam.errors import LiaamError, MethodError
from liaam.evaluation import finite_or_none, inter_ocular_distance, nme
from liaam.fitting import FitResult, Fitter
from liaam.model import SURROUNDINGS
from liaam.model.shape import diagonal_of
from liaam.training import train

if TYPE_CHECKING:
    from matplotlib.figure import Figure

RECIPES: dict[str, dict[str, Any]] = {
    "sample": {"prior": {SURROUNDINGS: "sample"}},
    "shrunk": {"prior": {SURROUNDINGS: "shrunk"}},
    "smooth": {"prior": {SURROUNDINGS: "smooth"}},
    "smooth-auto": {"prior": {SURROUNDINGS: "smooth"}, "variance": "auto", "appearance_variance": 0.98},
    "smooth-auto-both": {"prior": {SURROUNDINGS: "smooth"}, "variance": "auto"},
}
"""Ways to train by name: options of :func:`liaam.train`."""

ORDERS = ("drawn", "uncertain")
"""Which image is offered next: as drawn, or the one with the largest mean standard deviation of a landmark."""

PERSONS = 12
"""Number of images to annotate."""

AFTER = (5, 10)
"""Numbers of annotated images after which errors are reported."""

FEWEST = 3
"""Minimum number of annotated images for a model."""

ROLES = ("next", "rest", "fresh")
"""Roles of a fitted image: offered next, offered later, or never annotated."""

COLUMNS = {
    "recipe": "",
    "order": "",
    "trial": "",
    "annotated": "",
    "role": "",
    "person": "",
    "nme": ".6f",
    "point": ".6f",
    "bound": ".6f",
    "start_nme": ".6f",
    "deviation": ".6f",
    "status": "",
    "seconds": ".4f",
}
"""Columns of results.csv. ``point``: median over the image's landmarks, where ``nme`` is the mean. ``start_nme``:
error of the start from the search. ``deviation``: mean standard deviation of a landmark reported by the fit, divided by
the shape's diagonal. The others are as in :mod:`experiments.protocol`."""

CHOICES = (
    "Pictures: the first (diffuse, frontal) one of each person. Who takes part and in which order is drawn anew for "
    "each trial, the same for all recipes.",
    "Fits search for the object by themselves; no start is given.",
    "Order 'uncertain': the first pictures are those drawn first, as many as a model needs; then that with the largest "
    "mean standard deviation of a landmark, by a model trained anew after each.",
    "Persons that are not among those drawn are fitted too ('fresh'): they tell what a model has learnt, whichever "
    "pictures were taken first.",
    "Models are trained without leaving pictures out.",
)


@dataclass(frozen=True)
class Session:
    """One draw of images, annotated with models of one recipe in one order: one task."""

    recipe: str
    order: str
    trial: int

    @property
    def key(self) -> str:
        """Key of the task in the journal."""
        return f"{self.recipe}, {self.order}, trial {self.trial}"


@lru_cache(maxsize=1)
def get_pictures(folder: Path) -> tuple[Sample, ...]:
    """First image of each of a folder's persons; once per process."""
    return tuple(person.training[0] for person in find_persons(folder)[0])


def draw_session(pictures: Sequence[Sample], persons: int, seed: int, trial: int) -> tuple[list[Sample], list[Sample]]:
    """Images to annotate, in their order, and those that never are."""
    order = np.random.default_rng([seed, trial]).permutation(len(pictures))
    return [pictures[i] for i in order[:persons]], [pictures[i] for i in order[persons:]]


def place(fitter: Fitter, sample: Sample) -> Row:
    """Fit one image and return its columns of results.csv."""
    truth = sample.landmarks.points
    unit = inter_ocular_distance(truth, *EYES)
    began = time.perf_counter()
    result = fitter.fit(sample.read_image(), name=sample.name)
    seconds = time.perf_counter() - began
    start = result.start if result.found is None else result.found.landmarks
    return {
        "person": sample.name,
        "nme": nme(result.landmarks, truth, unit),
        "point": float(np.nanmedian(np.linalg.norm(result.landmarks - truth, axis=1))) / unit,
        "bound": nme(fitter.shapes.project(truth), truth, unit),
        "start_nme": nme(start, truth, unit),
        "deviation": uncertainty(result),
        "status": str(result.status),
        "seconds": seconds,
    }


def uncertainty(result: FitResult) -> float:
    """Mean standard deviation of a landmark, divided by the shape's diagonal; infinite if the fit has none."""
    share = float(result.deviations.mean()) / max(diagonal_of(result.landmarks), 1e-9)
    return share if np.isfinite(share) else np.inf


def turns(
    waiting: list[Sample], recipe: str, by_uncertainty: bool, after: Sequence[int]
) -> Iterator[tuple[int, Fitter, list[Row], int]]:
    """Train on the annotated images, fit the remaining ones, annotate the next, and repeat.

    Yields
    ------
    annotated : int
        Number of training images.
    fitter : Fitter
    placed : list of Row
        Results for the remaining images.
    offered : int
        Index of the next image among them.
    """
    annotated, waiting = waiting[:FEWEST], waiting[FEWEST:]
    while waiting:
        offered = 0
        if by_uncertainty or len(annotated) in after:
            fitter = Fitter(train(annotated, leave_out=False, lamps=None, **RECIPES[recipe]))
            placed = [place(fitter, sample) for sample in waiting]
            offered = int(np.argmax([row["deviation"] for row in placed])) if by_uncertainty else 0
            yield len(annotated), fitter, placed, offered
        annotated.append(waiting.pop(offered))


def annotate(data: Path, persons: int, after: Sequence[int], seed: int, session: Session) -> list[Row]:
    """Run one session."""
    waiting, fresh = draw_session(get_pictures(data), persons, seed, session.trial)
    rows: list[Row] = []
    for count, fitter, placed, offered in turns(waiting, session.recipe, session.order == "uncertain", after):
        if count in after:
            roles = [ROLES[i != offered] for i in range(len(placed))] + ["fresh"] * len(fresh)
            labels = {"recipe": session.recipe, "order": session.order, "trial": session.trial, "annotated": count}
            placed = placed + [place(fitter, sample) for sample in fresh]
            rows += [labels | {"role": role} | row for role, row in zip(roles, placed, strict=True)]
    return rows


def assisted_experiment(
    data: Path,
    recipes: Sequence[str] = tuple(RECIPES),
    orders: Sequence[str] = ORDERS[:1],
    trials: int = 24,
    seed: int = 0,
    persons: int = PERSONS,
    after: Sequence[int] = AFTER,
) -> Experiment:
    """Make the experiment.

    Parameters
    ----------
    data : Path
        Folder of images ``NN-Js.*`` with landmarks, as in the spot protocol.
    recipes : sequence of str
        One of :data:`RECIPES`.
    orders : sequence of str
        One of :data:`ORDERS`.
    trials : int
        Draws of persons and their order.
    seed : int
    persons : int
        Images to annotate.
    after : sequence of int
        Numbers of annotated images after which errors are reported.
    """
    for what, given, known in (("recipe", recipes, RECIPES), ("order", orders, ORDERS)):
        for name in given:
            if name not in known:
                raise MethodError(f"unknown {what} {name!r}; choose from {', '.join(known)}")
        if not given:
            raise MethodError(f"no {what} is given; choose from {', '.join(known)}")
    check_trials("liaam", trials)
    found, left_out = find_persons(data)
    if len(found) < persons:
        raise LiaamError(f"{data}: {len(found)} persons are complete, but {persons} are to be annotated; add some")
    return Experiment(
        name="assisted",
        title="Annotating with the model's help",
        settings={
            **facts_of(data, found),
            "recipes": {name: RECIPES[name] for name in recipes},
            "orders": list(orders),
            "trials": trials,
            "seed": seed,
            "annotated": persons,
            "after": list(after),
        },
        tasks=tuple(Session(recipe, order, i) for i in range(trials) for recipe in recipes for order in orders),
        work=partial(annotate, data, persons, tuple(after), seed),
        columns=COLUMNS,
        summarise=partial(summarise, tuple(recipes), tuple(orders), tuple(after)),
        draw=draw,
        report=report,
        choices=CHOICES,
        left_out=left_out,
    )


def summarise(recipes: Sequence[str], orders: Sequence[str], after: Sequence[int], rows: list[Row]) -> dict[str, Any]:
    """Statistics by recipe, order, number of annotated images and role."""
    return {
        "after": list(after),
        "cells": [
            {
                "recipe": recipe,
                "order": order,
                "after": [_after(count, select(own, annotated=count)) for count in after],
            }
            for recipe in recipes
            for order in orders
            if (own := select(rows, recipe=recipe, order=order))
        ],
    }


def _after(count: int, rows: list[Row]) -> dict[str, Any]:
    waiting = [row for row in rows if row["role"] != "fresh"]
    return {
        "annotated": count,
        "bound_median": _median(waiting, "bound"),
        "point_median": _median(select(rows, role="next"), "point"),
        "next": statistics(select(rows, role="next")),
        "waiting": statistics(waiting),
        "fresh": statistics(select(rows, role="fresh")),
    }


def _median(rows: Sequence[Row], name: str) -> float | None:
    return finite_or_none(np.median([row[name] for row in rows])) if rows else None


def table(summary: Mapping[str, Any]) -> tuple[Header, Table]:
    """Medians by recipe, order and number of annotated images."""
    header = [
        "annotated",
        "recipe",
        "order",
        "next, %",
        "its points, %",
        "all left, %",
        "p90, %",
        "> 8 %",
        "fresh, %",
        "bound, %",
    ]
    return header, [
        [
            str(cell["annotated"]),
            found["recipe"],
            found["order"],
            percent(cell["next"]["nme_median"]),
            percent(cell["point_median"]),
            percent(cell["waiting"]["nme_median"]),
            percent(cell["waiting"]["nme_p90"]),
            percent(cell["waiting"]["beyond"], 0),
            percent(cell["fresh"]["nme_median"]),
            percent(cell["bound_median"]),
        ]
        for i in range(len(summary["after"]))
        for found in summary["cells"]
        for cell in (found["after"][i],)
    ]


def draw(_rows: list[Row], summary: Mapping[str, Any]) -> "Figure":
    """Draw the median error of the remaining images as bars, one panel per number of annotated images."""
    bars = {
        f"after {count} pictures": in_percent(
            {
                f"{found['recipe']}, {found['order']}": found["after"][i]["waiting"]["nme_median"]
                for found in summary["cells"]
            }
        )
        for i, count in enumerate(summary["after"])
    }
    return figure_of_bars(bars, "median error, % of inter-ocular distance")


def report(_rows: list[Row], summary: Mapping[str, Any]) -> str:
    """Format the question and the medians."""
    question = (
        "How near does a model of the first few annotated pictures place the points of the others? Median error by "
        "inter-ocular distance: of the picture that is offered next (mean over its points, and median over them), of "
        "all that are left of the session, and of persons that never belong to it; bound: the error of the true shape "
        "projected on the shape model."
    )
    return tell(question, table(summary))
