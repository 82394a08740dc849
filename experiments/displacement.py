"""How far from the object can a fit start? (Paper section 7.1, Fig 3a.)"""

from collections.abc import Sequence
from pathlib import Path

from experiments.runner import Experiment
from experiments.simulated import METHODS, Sweep, simulated_experiment
from experiments.subjects import STRENGTH

GAMMAS = (0.0, 2.0, 4.0, 8.0, 12.0, 16.0)

SWEEP = Sweep(
    name="displacement",
    title="Error against the displacement of the start",
    question=(
        "How far from the object may a fit start, when a shadow lies on it that was not there in training? Pictures "
        "have no noise (paper Fig 3a)."
    ),
    column="gamma",
    label="displacement of the start γ, px",
)


def displacement_experiment(
    data: Path | None = None,
    methods: Sequence[str] = METHODS,
    trials: int = 24,
    seed: int = 0,
    solver: str = "paper",
    gammas: Sequence[float] = GAMMAS,
    strength: float = STRENGTH,
) -> Experiment:
    """Make the experiment; see :func:`experiments.simulated.simulated_experiment`."""
    return simulated_experiment(SWEEP, gammas, data, methods, trials, seed, solver, strength)
