"""What does invariance cost if the light has not changed? Leave-one-out on each person's diffuse images.

An invariant discards information. A light-invariant method should lose little to methods that use the whole image.
"""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from experiments.charts import figure_of_errors
from experiments.measures import or_dash
from experiments.protocol import (
    METHODS,
    STARTS,
    TRAINED,
    Header,
    Request,
    Table,
    columns_of,
    eight_bit,
    median_bound,
    ratio,
    select,
    statistics,
    tell,
)
from experiments.runner import Experiment, Row
from experiments.spot import CONVERGED, EYES, Person, disturbed_start, facts_of, find_persons, percent
from liaam.evaluation import inter_ocular_distance

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PLAIN = ("rgb", "grey", "chroma")
"""Methods without assumptions on the light's geometry. The best of them is the reference."""

CHOICES = (
    STARTS,
    f"Reference: the least median of {', '.join(PLAIN)}, of those that take part.",
    TRAINED,
)


def fit_person(request: Request, person: Person) -> list[Row]:
    """Fit each diffuse image of one person with a model of the others."""
    rows = []
    for sample in person.training:
        others = [other for other in person.training if other is not sample]
        trained = request.train(others, f"{person.key} without {sample.name}")
        image, truth = eight_bit(sample), sample.landmarks.points
        iod = inter_ocular_distance(truth, *EYES)
        for trial in range(request.trials):
            start = disturbed_start(trained.mean, truth, iod, request.rng(sample.name, trial))
            rows += trained.fit(image, truth, iod, start, person=person.name, picture=sample.name, trial=trial)
    return rows


def unchanged_experiment(
    data: Path,
    methods: Sequence[str] = (*METHODS, "chroma"),
    trials: int = 1,
    seed: int = 0,
    solver: str = "liaam",
) -> Experiment:
    """Make the experiment; :data:`experiments.cli.HELP` describes the parameters."""
    request = Request(data, tuple(methods), trials, seed, solver)
    persons, left_out = find_persons(data)
    return Experiment(
        name="unchanged",
        title="No change of light: leave-one-out on diffuse pictures",
        settings={**facts_of(data, persons), **request.settings()},
        tasks=persons,
        work=partial(fit_person, request),
        columns=columns_of("person", "picture", "trial"),
        summarise=partial(summarise, request.methods),
        draw=draw,
        report=report,
        choices=CHOICES,
        left_out=left_out,
        skips_faults=True,
    )


def summarise(methods: Sequence[str], rows: list[Row]) -> dict[str, Any]:
    """Statistics by method, relative to the best plain one."""
    cells = {method: statistics(select(rows, method=method)) for method in methods}
    known = {m: cells[m]["nme_median"] for m in PLAIN if m in cells and cells[m]["nme_median"] is not None}
    reference = min(known, key=lambda method: known[method]) if known else None
    least = known[reference] if reference else None
    return {
        "persons": sorted({row["person"] for row in rows}),
        "bound_median": median_bound(rows),
        "reference": reference,
        "methods": {
            method: cell | {"to_reference": ratio(cell["nme_median"], least)} for method, cell in cells.items()
        },
    }


def table(summary: dict[str, Any]) -> tuple[Header, Table]:
    """Medians by method."""
    header = ["method", "median, %", "p90, %", "> 8 %", f"to {summary['reference'] or 'reference'}"]
    rows = [
        [
            method,
            percent(cell["nme_median"]),
            percent(cell["nme_p90"]),
            percent(cell["beyond"], 0),
            or_dash(cell["to_reference"], ".2f"),
        ]
        for method, cell in summary["methods"].items()
    ]
    return header, [*rows, ["bound", percent(summary["bound_median"]), "–", "–", "–"]]


def draw(rows: list[Row], summary: dict[str, Any]) -> "Figure":
    """Cumulative distributions of the errors, and of the bound."""
    errors = {method: [row["nme"] for row in select(rows, method=method)] for method in summary["methods"]}
    bounds = {row["picture"]: row["bound"] for row in rows}
    return figure_of_errors(errors, bounds.values(), CONVERGED)


def report(summary: dict[str, Any]) -> str:
    """Format the question and the medians."""
    question = (
        f"What does invariance cost where the light is that of training? For each of {len(summary['persons'])} persons "
        "each diffuse picture is fitted with a model of the other four. Median error by inter-ocular distance, and its "
        "ratio to the best of the plain methods."
    )
    return tell(question, table(summary))
