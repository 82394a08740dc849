"""The commands below ``liaam experiment``: they read options, run, and print what came out."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from liaam.errors import MethodError
from liaam.terminal import complain, console, progress_bar, say, table_of

if TYPE_CHECKING:
    from liaam.experiments.runner import Experiment

experiments = typer.Typer(
    help="Run an experiment; writes rows, a summary, a figure and a report. A stopped one goes on where it was.",
    no_args_is_help=True,
)

OneSubject = Annotated[
    Path | None, typer.Option(help="Folder of one person's landmarked pictures; generated ones if left out.")
]
Out = Annotated[
    Path,
    typer.Option("--out", "-o", help="Folder for results.csv, summary.json, figure.png, figure.svg and report.md."),
]
Methods = Annotated[str, typer.Option(help="Methods, separated by commas; see 'liaam methods'.")]
Trials = Annotated[int, typer.Option(help="Draws for each value, such as of start and shadow.", min=1)]
Seed = Annotated[int, typer.Option(help="Seed of everything that is drawn.", min=0)]
Jobs = Annotated[int | None, typer.Option(help="Worker processes; one per core if left out.", min=1)]
Solver = Annotated[
    str, typer.Option(help="liaam: as 'liaam fit' does; paper: pure Gauss-Newton, one level, as the paper writes it.")
]

SIMULATED = "grey,rgb,li,li-lit,li-pc,li-pcs"


def names_in(text: str, option: str = "--methods") -> tuple[str, ...]:
    """Names of a list with commas, at least one."""
    names = tuple(name.strip() for name in text.split(",") if name.strip())
    if not names:
        raise MethodError(f"{option} is empty; see 'liaam methods' for those that exist")
    return names


def execute(experiment: "Experiment", out: Path, jobs: int | None) -> dict[str, Any]:
    """Run an experiment behind a progress bar; a Ctrl-C becomes one line and exit status 130."""
    from liaam.experiments.runner import run_experiment

    try:
        with progress_bar() as tell:
            return run_experiment(experiment, out, jobs, tell)
    except KeyboardInterrupt as stop:
        complain(str(stop) or "stopped")
        raise typer.Exit(130) from None


def conclude(summary: Mapping[str, Any], out: Path) -> None:
    """Say what was left out, and where the results are."""
    for text in summary["left_out"]:
        say(f"left out: {text}")
    say(f"written to {out}")


def print_lines(lines: Mapping[str, Sequence[tuple[float, float | None]]], title: str) -> None:
    """Print values by method and swept value."""
    table = table_of("method", *(f"{x:g}" for x, _ in next(iter(lines.values()))))
    for method, line in lines.items():
        table.add_row(method, *("–" if y is None else f"{y:.3f}" for _, y in line))
    say(title)
    console.print(table)


def run_sweep(make: Callable[..., "Experiment"], out: Path, jobs: int | None, **options) -> None:
    """Run a simulated experiment and print its medians."""
    from liaam.experiments.simulated import curves

    summary = execute(make(**options), out, jobs)
    print_lines(curves(summary, "error_px", "median"), f"median error, px, by {summary['swept']}")
    angles = curves(summary, "theta_error_deg", "median")
    if angles:
        print_lines(angles, f"median error of theta, degrees, by {summary['swept']}")
    conclude(summary, out)


@experiments.command()
def displacement(
    out: Out,
    data: OneSubject = None,
    methods: Methods = SIMULATED,
    trials: Trials = 24,
    seed: Seed = 0,
    solver: Solver = "liaam",
    jobs: Jobs = None,
) -> None:
    """How far from the object may a fit start, under a simulated shadow? (Paper Fig 3a.)"""
    from liaam.experiments.displacement import displacement_experiment as make

    run_sweep(make, out, jobs, data=data, methods=names_in(methods), trials=trials, seed=seed, solver=solver)


@experiments.command()
def noise(
    out: Out,
    data: OneSubject = None,
    methods: Methods = f"{SIMULATED},li+noise",
    trials: Trials = 24,
    seed: Seed = 0,
    solver: Solver = "liaam",
    jobs: Jobs = None,
) -> None:
    """What does noise do to landmarks and angle, under a simulated shadow? (Paper Fig 3b and 3c.)"""
    from liaam.experiments.noise import noise_experiment as make

    run_sweep(make, out, jobs, data=data, methods=names_in(methods), trials=trials, seed=seed, solver=solver)


@experiments.command()
def convergence(
    out: Out,
    data: Annotated[
        Path | None,
        typer.Option(
            help="Folder of the spot protocol, or of one person's pictures (a shadow is simulated); "
            "generated pictures under lateral light if left out."
        ),
    ] = None,
    methods: Methods = SIMULATED,
    trials: Trials = 24,
    seed: Seed = 0,
    solver: Solver = "liaam",
    jobs: Jobs = None,
) -> None:
    """How fast do fits converge under lateral light? (Paper Fig 5.)"""
    from liaam.experiments.convergence import convergence_experiment, shown

    experiment = convergence_experiment(data, names_in(methods), trials, seed, solver)
    summary = execute(experiment, out, jobs)
    print_lines(shown(summary), "median error, px, by iteration")
    conclude(summary, out)


@experiments.command()
def spot(
    data: Annotated[Path, typer.Option(help="Folder with pictures NN-1 … NN-6 of each person and their landmarks.")],
    out: Out,
    methods: Methods = "rgb,grey,li,li-lit,li-pc,li-pcs",
    trials: Annotated[int, typer.Option(help="Starts per person.", min=1)] = 3,
    seed: Seed = 0,
    solver: Solver = "liaam",
    jobs: Jobs = None,
) -> None:
    """Person-specific models from diffuse light, fitted to a spot-lit picture (paper section 7.2)."""
    from liaam.experiments.spot import spot_experiment

    summary = execute(spot_experiment(data, names_in(methods), trials, seed, solver), out, jobs)
    table = table_of("method", "median NME", "p90", "converged", "iterations", "theta")
    for row in spot_rows(summary):
        table.add_row(*row)
    console.print(table)
    conclude(summary, out)


def spot_rows(summary: Mapping[str, Any]) -> Iterable[tuple[str, ...]]:
    """Rows of the spot protocol's table."""
    for method, row in summary["methods"].items():
        theta, nme, p90 = row["theta_deg_median"], row["nme_median"], row["nme_p90"]
        yield (
            method,
            "–" if nme is None else f"{nme:.2%}",
            "–" if p90 is None else f"{p90:.2%}",
            f"{row['converged']:.0%}",
            f"{row['iterations_median']:.0f}",
            "–" if theta is None else f"{theta:.1f}°",
        )
    yield "bound", f"{summary['bound_median']:.2%}"
