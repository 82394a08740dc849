"""The command line ``python -m experiments``: one command for each experiment, with the parameters of its function."""

import inspect
from collections.abc import Callable, Mapping
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_type_hints

import typer

from liaam.cli.terminal import make_app, progress_bar, run_app, say
from liaam.errors import MethodError

if TYPE_CHECKING:
    from experiments.runner import Experiment

app = make_app(
    help="Run an experiment; writes rows, a summary, a figure and a report. A stopped one goes on where it was."
)

EXPERIMENTS = (
    "displacement", "noise", "convergence", "spot", "bound", "calibration", "baselines", "reconstruct", "generic",
    "relight", "peer", "basin", "occlusion", "unchanged", "uncertainty",
)  # fmt: skip
"""Modules with a function ``NAME_experiment``. Their first line is the command's help."""

HELP = {
    "data": "Folder of images with landmarks; experiments/README.md says of which. Where it may be left out: generated "
    "images.",
    "methods": "Methods, separated by commas; 'liaam fit --help' lists them.",
    "trials": "Draws for each value, image or person, such as of start and shadow.",
    "seed": "Seed of everything that is drawn.",
    "solver": "liaam: as 'liaam fit' does; liaam-smooth: so, trained with the prior smooth; liaam-sample: with the "
    "prior sample; paper: pure Gauss-Newton, one level, as the paper writes it; paper-90, paper-100px, paper-theta1: "
    "as paper, but for one choice.",
    "strength": "Depth of the simulated shadow: change of log light; -1.2 leaves 0.3 of it, -1.8 0.17.",
    "test": "Folder of the images to fit: other objects, each under several lights.",
    "first": "Train on this many images of --data, and fit the others.",
    "lamps": "Folder or file that the model learns other light from, or auto, as for 'liaam train'. Default: none.",
    "training_lamp": "Name of the light of training.",
    "starts": "From where to fit: near (the truth), box (a detector's), none (the object is searched for).",
    "unit": "Errors are shares of the distance of the eyes' centres, or of their outer corners.",
    "diagonal": "Diagonal of the reference frame, pixels.",
    "unseen": "Fit persons that the model has not seen, two left out at a time.",
    "heads": "Generated heads.",
}
"""Help of the options by parameter. Other parameters, such as swept values, have no option."""

NAMES = ("methods", "starts")
"""Parameters that take several names, separated by commas."""

Out = Annotated[
    Path,
    typer.Option("--out", "-o", help="Folder for results.csv, summary.json, figure.png, figure.svg and report.md."),
]
Jobs = Annotated[int | None, typer.Option(help="Worker processes; one per core if left out.", min=1)]


def names_in(text: str, option: str = "--methods") -> tuple[str, ...]:
    """Parse at least one name, separated by commas."""
    names = tuple(name.strip() for name in text.split(",") if name.strip())
    if not names:
        raise MethodError(f"{option} is empty; 'liaam fit --help' lists the methods")
    return names


def execute(experiment: "Experiment", out: Path, jobs: int | None) -> dict[str, Any]:
    """Run an experiment behind a progress bar."""
    from experiments.runner import run_experiment

    with progress_bar() as tell:
        return run_experiment(experiment, out, jobs, tell)


def add_command(name: str) -> None:
    """Add the command of an experiment."""
    module = import_module(f"experiments.{name}")
    make: Callable[..., Experiment] = getattr(module, f"{name}_experiment")

    def command(out: Path, jobs: int | None, **options: Any) -> None:
        given = {
            key: names_in(value, f"--{key}") if key in NAMES and value else value for key, value in options.items()
        }
        experiment = make(**given)
        summary = execute(experiment, out, jobs)
        say(experiment.report(summary))
        for text in summary["left_out"]:
            say(f"left out: {text}")
        say(f"written to {out}")

    command.__doc__ = (module.__doc__ or "").splitlines()[0]
    command.__annotations__ = {}
    command.__dict__["__signature__"] = inspect.Signature(
        [*_options(make), _keyword("out", Out), _keyword("jobs", Jobs, None)]
    )
    app.command(name)(command)


def _options(make: Callable[..., "Experiment"]) -> list[inspect.Parameter]:
    """Return options for the parameters of a function that have a help text."""
    hints, found = get_type_hints(make), []
    for key, parameter in inspect.signature(make).parameters.items():
        if key in HELP:
            kind, default = hints[key], parameter.default
            if key in NAMES:
                kind, default = str, default if default is inspect.Parameter.empty else ",".join(default)
            flag = [f"--{key}"] if kind is bool else []
            found.append(_keyword(key, Annotated[kind, typer.Option(*flag, help=HELP[key])], default))
    return found


def _keyword(name: str, annotation: Any, default: Any = inspect.Parameter.empty) -> inspect.Parameter:
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation)


@app.command()
def reproduce(
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for report.html and a folder for each experiment.")],
    person: Annotated[
        Path | None, typer.Option(help="Folder of one person's landmarked images under homogeneous light.")
    ] = None,
    persons: Annotated[Path | None, typer.Option(help="Folder of many persons, as 'spot' takes it.")] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Few trials: minutes instead of an hour or so.")] = False,
    seed: Annotated[int, typer.Option(help=HELP["seed"], min=0)] = 0,
    jobs: Jobs = None,
) -> None:
    """Run the paper's experiments and write one report with a table of its claims.

    Always uses generated images, and also real ones if folders are given.
    """
    from experiments.reproduce import reproduce as run

    with progress_bar() as tell:
        verdicts = run(out, person, persons, "quick" if quick else "full", seed, jobs, tell)
    print_verdicts(verdicts)
    say(f"written to {out / 'report.html'}")


def print_verdicts(verdicts: Mapping[str, Mapping[str, Any]]) -> None:
    """Print which of the paper's claims hold, for each kind of data and choice."""
    from experiments.claims import CLAIMS

    for column, found in verdicts.items():
        failed = [claim for claim in CLAIMS if claim.name in found and not found[claim.name].holds]
        say(f"{column}: {len(found) - len(failed)} of {len(found)} claims hold")
        for claim in failed:
            say(f"  not: {claim.text} ({found[claim.name].evidence})")


for _name in EXPERIMENTS:
    add_command(_name)


def main() -> None:
    """Run the command line."""
    run_app(app)
