"""Generic models: trained on half of a folder's persons under diffuse light, fitted to the other half.

The persons that a model has never seen are fitted under the light of training, under a real spot light, and under hard
lateral light laid over their diffuse pictures (:func:`liaam.experiments.lights.hard_light`). In two folds every
person is fitted once. Pictures are grouped and starts are drawn as in :mod:`liaam.experiments.spot`.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from liaam.datasets import Sample
from liaam.errors import LiaamError
from liaam.evaluation import inter_ocular_distance, or_dash
from liaam.experiments.lights import hard_light
from liaam.experiments.protocol import (
    METHODS,
    STARTS,
    TRAINED,
    Header,
    Request,
    Table,
    Trained,
    columns_of,
    eight_bit,
    median_bound,
    medians_by_light,
    ratio,
    select,
    statistics,
    tell,
)
from liaam.experiments.runner import Experiment, Row
from liaam.experiments.spot import EYES, Person, disturbed_start, facts_of, find_persons, percent
from liaam.plotting import figure_of_bars, figure_of_pictures

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LIGHTS = ("diffuse", "spot", "relit")
FOLDS = 2
LEAST = 3
"""Persons that a folder must have: one to fit, and more than a person's pictures to train on in one fold at least."""

CHOICES = (
    "Persons are taken in the order of their names, every other one into one fold.",
    STARTS,
    "Relit: a lamp 50 to 80° from the side on an ellipsoid with Lambert's shading, a cast shadow with an edge as of a "
    "nose, and ambient light of another colour; drawn once for each diffuse picture.",
    TRAINED,
    "Models have learnt how far fits can be trusted, so that soft-li begins those of little quality again; other "
    "methods know no quality.",
)


@dataclass(frozen=True)
class HeldOut:
    """One person who is fitted with the model of the other fold: one task."""

    fold: int
    person: str

    @property
    def key(self) -> str:
        """Name for the journal."""
        return f"fold {self.fold}, person {self.person}"


@lru_cache(maxsize=1)
def get_persons(folder: Path) -> tuple[Person, ...]:
    """Find a folder's persons; once per process."""
    return find_persons(folder)[0]


@lru_cache(maxsize=1)
def get_trained(request: Request, fold: int) -> Trained:
    """Train on all persons but a fold's; once per process, since it takes as long as fitting some persons."""
    persons = [person for i, person in enumerate(get_persons(request.data)) if i % FOLDS != fold]
    samples = [sample for person in persons for sample in person.training]
    return request.train(samples, f"without fold {fold}", leave_out=True)


def pictures_of(request: Request, person: Person) -> Iterator[tuple[str, Sample, np.ndarray]]:
    """Give a person's pictures with their light, as (h, w, 3) uint8."""
    yield "spot", person.spot, eight_bit(person.spot)
    for sample in person.training:
        image = eight_bit(sample)
        yield "diffuse", sample, image
        yield "relit", sample, hard_light(image, sample.landmarks.points, request.rng(sample.name, "relit"))


def fit_person(request: Request, task: HeldOut) -> list[Row]:
    """Fit all pictures of one person."""
    trained = get_trained(request, task.fold)
    person = next(person for person in get_persons(request.data) if person.name == task.person)
    rows = []
    for light, sample, image in pictures_of(request, person):
        truth = sample.landmarks.points
        iod = inter_ocular_distance(truth, *EYES)
        for trial in range(request.trials):
            start = disturbed_start(trained.mean, truth, iod, request.rng(sample.name, trial))
            labels = {"person": person.name, "picture": sample.name, "light": light, "trial": trial}
            rows += trained.fit(image, truth, iod, start, **labels)
    return rows


def generic_experiment(
    data: Path, methods: Sequence[str] = METHODS, trials: int = 1, seed: int = 0, solver: str = "liaam"
) -> Experiment:
    """Make the experiment.

    Parameters
    ----------
    data : Path
        Folder of pictures ``NN-Js.*`` with landmarks, as the spot protocol has them.
    methods : sequence of str
    trials : int
        Starts per picture.
    seed : int
    solver : str
        Of :data:`liaam.experiments.solvers.SOLVERS`.

    Raises
    ------
    LiaamError
        If there are too few persons.
    """
    request = Request(data, tuple(methods), trials, seed, solver)
    persons, left_out = find_persons(data)
    if len(persons) < LEAST:
        raise LiaamError(
            f"{data}: {len(persons)} persons are complete, but a generic model needs at least {LEAST} to be trained on "
            "some and fitted to others; add some"
        )
    return Experiment(
        name="generic",
        title="Generic models, fitted to persons they have never seen under other light",
        settings={**facts_of(data, persons), **request.settings()},
        tasks=tuple(
            HeldOut(fold, person.name) for fold in range(FOLDS) for i, person in enumerate(persons) if i % FOLDS == fold
        ),
        work=partial(fit_person, request),
        columns=columns_of("person", "picture", "light", "trial"),
        summarise=partial(summarise, request.methods),
        draw=draw,
        report=report,
        pictures=partial(draw_pictures, request),
        choices=CHOICES,
        left_out=left_out,
        skips_faults=True,
    )


def summarise(methods: Sequence[str], rows: list[Row]) -> dict[str, Any]:
    """Statistics by method and light."""
    return {
        "persons": sorted({row["person"] for row in rows}),
        "bound_median": {light: median_bound(select(rows, light=light)) for light in LIGHTS},
        "methods": {method: _by_light(select(rows, method=method)) for method in methods},
    }


def _by_light(rows: list[Row]) -> dict[str, Any]:
    cells = {light: statistics(select(rows, light=light)) for light in LIGHTS}
    diffuse = cells["diffuse"]["nme_median"]
    return {light: cell | {"to_diffuse": ratio(cell["nme_median"], diffuse)} for light, cell in cells.items()}


def table(summary: dict[str, Any]) -> tuple[Header, Table]:
    """Medians by light and method."""
    header = ["light", "method", "median, %", "p90, %", "> 8 %", "to diffuse", "excess, %", "ms"]
    return header, [
        [
            light,
            method,
            percent(cells[light]["nme_median"]),
            percent(cells[light]["nme_p90"]),
            percent(cells[light]["beyond"], 0),
            or_dash(cells[light]["to_diffuse"], ".2f"),
            percent(cells[light]["excess_median"]),
            f"{1000 * cells[light]['seconds_median']:.0f}",
        ]
        for light in LIGHTS
        for method, cells in summary["methods"].items()
    ]


def draw(_rows: list[Row], summary: dict[str, Any]) -> "Figure":
    """Median errors as bars, a panel for each light."""
    return figure_of_bars(medians_by_light(summary, LIGHTS), "median error, % of inter-ocular distance")


def draw_pictures(request: Request) -> "Figure":
    """First person: a diffuse picture, the spot-lit one, and the diffuse one relit."""
    shown: dict[str, np.ndarray | None] = {}
    for light, _, image in pictures_of(request, get_persons(request.data)[0]):
        shown.setdefault(light, image)
    return figure_of_pictures([{light: shown[light] for light in LIGHTS}])


def report(_rows: list[Row], summary: dict[str, Any]) -> str:
    """What was asked, and the medians."""
    question = (
        f"What does another light cost a generic model? {len(summary['persons'])} persons in two folds: a model of "
        "one half's diffuse pictures is fitted to the other half's, to their spot-lit ones, and to the diffuse ones "
        "under simulated hard light. NME: mean distance to the landmarks by inter-ocular distance; to diffuse: median "
        "by the same method's under diffuse light; excess: median of what the error has on top of that of the true "
        "shape projected on the shape model."
    )
    return tell(question, table(summary))
