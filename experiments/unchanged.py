"""What does invariance cost if the light has not changed? Leave-one-out on each person's diffuse images.

An invariant discards information. A light-invariant method should lose little to methods that use the whole image.
"""

from collections.abc import Sequence
from pathlib import Path

from experiments.protocol import (
    EYES,
    METHODS,
    STARTS,
    TRAINED,
    Split,
    Trained,
    disturbed_start,
    eight_bit,
    fits_experiment,
)
from experiments.runner import Experiment, Row
from experiments.solvers import Request
from experiments.spot import facts_of, find_persons
from liaam.error_measures import inter_ocular_distance


def fit_person(request: Request, person: Split) -> list[Row]:
    """Fit each diffuse image of one person with a model of the others."""
    rows = []
    for sample in person.training:
        others = [other for other in person.training if other is not sample]
        trained = Trained.on(request, others, f"{person.key} without {sample.name}")
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
    return fits_experiment(
        request,
        fit_person,
        name="unchanged",
        title="No change of light: leave-one-out on diffuse pictures",
        settings=facts_of(data, persons),
        tasks=persons,
        report="What does invariance cost where the light is that of training? Each diffuse picture of a person is "
        "fitted with a model of the other four. Errors by inter-ocular distance. Methods without assumptions on the "
        "light's geometry are rgb, grey and chroma.",
        choices=(STARTS, TRAINED),
        left_out=left_out,
    )
