"""How does noise affect the landmarks and the angle? (Paper section 7.1, Fig 3b and 3c.)"""

from collections.abc import Sequence
from pathlib import Path

from experiments.runner import Experiment
from experiments.simulated import METHODS, Sweep, simulated_experiment
from experiments.subjects import STRENGTH

SIGMAS = (0.0, 2.0, 5.0, 10.0, 15.0, 20.0)
NOISE_METHODS = (*METHODS, "li+noise", "soft-li")

SWEEP = Sweep(
    name="noise",
    title="Errors against the noise of the picture",
    question=(
        "How do landmarks and angle suffer from noise, when a shadow lies on the object that was not there in "
        "training? Starts are displaced by γ = 4 px (paper Fig 3b and 3c)."
    ),
    column="sigma_n",
    label="noise σn, of 255",
    gamma=4.0,
    shows_angle=True,
)


def noise_experiment(
    data: Path | None = None,
    methods: Sequence[str] = NOISE_METHODS,
    trials: int = 24,
    seed: int = 0,
    solver: str = "paper",
    sigmas: Sequence[float] = SIGMAS,
    strength: float = STRENGTH,
) -> Experiment:
    """Make the experiment; see :func:`experiments.simulated.simulated_experiment`."""
    return simulated_experiment(SWEEP, sigmas, data, methods, trials, seed, solver, strength)
