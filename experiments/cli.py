"""The command line ``python -m experiments``."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from liaam.cli.terminal import make_app, progress_bar, run_app, say, show_table, table_of
from liaam.errors import MethodError

if TYPE_CHECKING:
    from experiments.runner import Experiment

app = make_app(
    help="Run an experiment; writes rows, a summary, a figure and a report. A stopped one goes on where it was."
)

OneSubject = Annotated[
    Path | None, typer.Option(help="Folder of one person's landmarked images. By default generated images.")
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
    str,
    typer.Option(
        help="liaam: as 'liaam fit' does; liaam-smooth: so, trained with --prior smooth; liaam-sample: with "
        "--prior sample; paper: pure Gauss-Newton, one level, as the paper writes it; paper-90, paper-100px, "
        "paper-theta1: as paper, but for one choice."
    ),
]

Strength = Annotated[
    float, typer.Option(help="Depth of the simulated shadow: change of log light; -1.2 leaves 0.3 of it, -1.8 0.17.")
]

SIMULATED = "grey,rgb,li,li-lit,li-pc,li-pcs"
COMPARED = "rgb,grey,li,igo,soft-li"

SpotFolder = Annotated[
    Path, typer.Option("--data", help="Folder with images NN-1 … NN-6 of each person and their landmarks.")
]
PersonsFolder = Annotated[
    Path, typer.Option("--data", help="Folder of images named after persons, as 01_01, and their landmarks.")
]
OneLight = Annotated[Path, typer.Option("--data", help="Folder to train on, in one light.")]
Lights = Annotated[Path, typer.Option("--test", help="Folder of other objects, each under several lights.")]
TrainingLamp = Annotated[str, typer.Option(help="Name of the light of training.")]
Lamps = Annotated[Path | None, typer.Option(help="As for generic.")]
Diagonal = Annotated[float, typer.Option(help="Diagonal of the reference frame, pixels.", min=20)]
Starts = Annotated[int, typer.Option(help="Starts per image.", min=1)]


def names_in(text: str, option: str = "--methods") -> tuple[str, ...]:
    """Parse at least one name, separated by commas."""
    names = tuple(name.strip() for name in text.split(",") if name.strip())
    if not names:
        raise MethodError(f"{option} is empty; see 'liaam methods' for those that exist")
    return names


def execute(experiment: "Experiment", out: Path, jobs: int | None) -> dict[str, Any]:
    """Run an experiment behind a progress bar."""
    from experiments.runner import run_experiment

    with progress_bar() as tell:
        return run_experiment(experiment, out, jobs, tell)


def conclude(summary: Mapping[str, Any], out: Path) -> None:
    """Print what was left out, and where the results are."""
    for text in summary["left_out"]:
        say(f"left out: {text}")
    say(f"written to {out}")


def print_lines(lines: Mapping[str, Sequence[tuple[float, float | None]]], title: str) -> None:
    """Print values by method and swept value."""
    if not lines:
        return
    from experiments.measures import or_dash

    table = table_of("method", *(f"{x:g}" for x, _ in next(iter(lines.values()))))
    for method, line in lines.items():
        table.add_row(method, *(or_dash(y) for _, y in line))
    say(title)
    show_table(table)


def run_sweep(make: Callable[..., "Experiment"], out: Path, jobs: int | None, **options) -> None:
    """Run a simulated experiment and print its medians."""
    from experiments.simulated import curves

    summary = execute(make(**options), out, jobs)
    print_lines(curves(summary, "error_px", "median"), f"median error, px, by {summary['swept']}")
    angles = curves(summary, "theta_error_deg", "median")
    if angles:
        print_lines(angles, f"median error of theta, degrees, by {summary['swept']}")
    conclude(summary, out)


def run_protocol(
    make: Callable[..., "Experiment"],
    table: Callable[[dict[str, Any]], tuple[list[str], list[list[str]]]],
    out: Path,
    jobs: int | None,
    request: tuple[Path, str, int, int, str],
    **options: Any,
) -> None:
    """Run an experiment on a folder of persons and print the table of its report.

    The request holds their common options: folder, methods, trials, seed and solver.
    """
    data, methods, *rest = request
    summary = execute(make(data, names_in(methods), *rest, **options), out, jobs)
    print_protocol(table(summary), summary, out)


def print_protocol(table: tuple[list[str], list[list[str]]], summary: Mapping[str, Any], out: Path) -> None:
    """Print the table of a report."""
    header, rows = table
    shown = table_of(*header)
    for row in rows:
        shown.add_row(*row)
    show_table(shown)
    conclude(summary, out)


@app.command()
def displacement(
    out: Out,
    data: OneSubject = None,
    methods: Methods = SIMULATED,
    trials: Trials = 24,
    seed: Seed = 0,
    solver: Solver = "paper",
    strength: Strength = -1.8,
    jobs: Jobs = None,
) -> None:
    """How far from the object can a fit start, under a simulated shadow? (Paper Fig 3a.)"""
    from experiments.displacement import displacement_experiment as make

    options = {"data": data, "trials": trials, "seed": seed, "solver": solver, "strength": strength}
    run_sweep(make, out, jobs, methods=names_in(methods), **options)


@app.command()
def noise(
    out: Out,
    data: OneSubject = None,
    methods: Methods = f"{SIMULATED},li+noise",
    trials: Trials = 24,
    seed: Seed = 0,
    solver: Solver = "paper",
    strength: Strength = -1.8,
    jobs: Jobs = None,
) -> None:
    """How does noise affect landmarks and angle, under a simulated shadow? (Paper Fig 3b and 3c.)"""
    from experiments.noise import noise_experiment as make

    options = {"data": data, "trials": trials, "seed": seed, "solver": solver, "strength": strength}
    run_sweep(make, out, jobs, methods=names_in(methods), **options)


@app.command()
def convergence(
    out: Out,
    data: Annotated[
        Path | None,
        typer.Option(
            help="Folder of the spot protocol, or of one person's images (a shadow is simulated); "
            "generated images under lateral light if left out."
        ),
    ] = None,
    methods: Methods = SIMULATED,
    trials: Trials = 24,
    seed: Seed = 0,
    solver: Solver = "paper",
    jobs: Jobs = None,
) -> None:
    """How fast do fits converge under lateral light? (Paper Fig 5.)"""
    from experiments.convergence import convergence_experiment, shown

    experiment = convergence_experiment(data, names_in(methods), trials, seed, solver)
    summary = execute(experiment, out, jobs)
    print_lines(shown(summary), "median error, px, by iteration")
    conclude(summary, out)


@app.command()
def spot(
    data: Annotated[Path, typer.Option(help="Folder with images NN-1 … NN-6 of each person and their landmarks.")],
    out: Out,
    methods: Methods = "rgb,grey,li,li-lit,li-pc,li-pcs",
    trials: Annotated[int, typer.Option(help="Starts per person.", min=1)] = 3,
    seed: Seed = 0,
    solver: Solver = "liaam",
    jobs: Jobs = None,
) -> None:
    """Person-specific models from diffuse light, fitted to a spot-lit image (paper section 7.2)."""
    from experiments.spot import spot_experiment

    summary = execute(spot_experiment(data, names_in(methods), trials, seed, solver), out, jobs)
    table = table_of("method", "median NME", "p90", "converged", "iterations", "theta")
    for row in spot_rows(summary):
        table.add_row(*row)
    show_table(table)
    conclude(summary, out)


def spot_rows(summary: Mapping[str, Any]) -> Iterable[tuple[str, ...]]:
    """Rows of the spot protocol's table."""
    from experiments.measures import or_dash

    for method, row in summary["methods"].items():
        theta, nme, p90 = row["theta_deg_median"], row["nme_median"], row["nme_p90"]
        yield (
            method,
            or_dash(nme, ".2%"),
            or_dash(p90, ".2%"),
            f"{row['converged']:.0%}",
            f"{row['iterations_median']:.0f}",
            "–" if theta is None else f"{theta:.1f}°",
        )
    yield "bound", f"{summary['bound_median']:.2%}"


@app.command()
def bound(
    out: Out,
    data: OneSubject = None,
    trials: Trials = 24,
    seed: Seed = 0,
    jobs: Jobs = None,
) -> None:
    """What is the smallest possible error under noise, for each kind of measurement? (Cramér-Rao.)"""
    from experiments import bound as module

    summary = execute(module.bound_experiment(data, trials, seed), out, jobs)
    for light in module.UNDER:
        print_lines(module.curves(summary, light, "bound_px"), f"bound, px, by noise of 255: {light}")
    conclude(summary, out)


@app.command()
def calibration(out: Out, trials: Trials = 24, seed: Seed = 0, jobs: Jobs = None) -> None:
    """How accurately do calibrations estimate the camera's angle, and are their error bars correct?"""
    from experiments.calibration import calibration_experiment
    from experiments.measures import or_dash

    summary = execute(calibration_experiment(trials, seed), out, jobs)
    table = table_of("camera", "kind", "noise", "observable", "median", "p95", "stated", "coverage", "plain squares")
    for c in summary["cells"]:
        numbers = (or_dash(c[key]) for key in ("median_deg", "p95_deg", "standard_error_deg"))
        observable = f"{c['observable']}/{c['trials']}"
        coverage, plain = or_dash(c["coverage"], ".2f"), or_dash(c["plain_median_deg"])
        table.add_row(c["camera"], c["kind"], f"{c['sigma_n']:g}", observable, *numbers, coverage, plain)
    say("error of theta, degrees")
    show_table(table)
    conclude(summary, out)


@app.command()
def baselines(
    out: Out,
    data: OneSubject = None,
    trials: Trials = 24,
    seed: Seed = 0,
    solver: Solver = "liaam",
    jobs: Jobs = None,
) -> None:
    """Do AIA, robust losses and normalisation help in the situations that their papers claim?"""
    from experiments.baselines import SITUATIONS, baselines_experiment
    from experiments.measures import or_dash

    summary = execute(baselines_experiment(data, trials, seed, solver), out, jobs)
    for situation in SITUATIONS:
        table = table_of("method", "median error, px", f"better than {situation.baseline}")
        for method, cell in summary["situations"][situation.name]["methods"].items():
            verdict = {True: "yes", False: "no"}.get(cell.get("beats_plain"), "–")
            table.add_row(method, or_dash(cell["median"]), verdict)
        say(situation.title)
        show_table(table)
    conclude(summary, out)


@app.command()
def reconstruct(
    out: Out,
    data: Annotated[
        Path | None,
        typer.Option(
            help="Folder of the spot protocol, or of one person's images (a shadow is simulated); generated images "
            "under lateral light if left out."
        ),
    ] = None,
    methods: Methods = "li,li+noise",
    trials: Annotated[int, typer.Option(help="Pictures of each kind.", min=1)] = 8,
    seed: Seed = 0,
    solver: Solver = "liaam",
    jobs: Jobs = None,
) -> None:
    """What would the object look like without the shadow? (Paper section 6 and Fig 4.)"""
    from experiments import reconstruct as module
    from experiments.measures import or_dash

    summary = execute(module.reconstruct_experiment(data, names_in(methods), trials, seed, solver), out, jobs)
    table = table_of("pictures", "method", "landmarks, px", "input", "rebuilt", "model")
    for kind, found in summary["kinds"].items():
        for method, cell in found.items():
            medians = (cell[quantity]["median"] for quantity in module.QUANTITIES)
            table.add_row(kind, method, *(or_dash(value) for value in medians))
    say("median error of log light: of the input, of what was rebuilt, of the best the model can do")
    show_table(table)
    conclude(summary, out)


@app.command()
def generic(
    data: Annotated[
        Path,
        typer.Option(
            help="Folder to train on; without --test or --first a model of one half of its persons, NN-1 … NN-6 each, "
            "is fitted to the other."
        ),
    ],
    out: Out,
    test: Annotated[Path | None, typer.Option(help="Folder of the images to fit.")] = None,
    first: Annotated[
        int | None, typer.Option(help="Train on this many images of --data, and fit the others.", min=2)
    ] = None,
    lamps: Annotated[
        Path | None,
        typer.Option(
            help="Folder or file that the model learns other light from, or auto, as for 'liaam train'. Default: none."
        ),
    ] = None,
    training_lamp: Annotated[
        str | None, typer.Option(help="Name of the lamp there that is the light of training.")
    ] = None,
    starts: Annotated[
        str,
        typer.Option(
            help="From where to fit: near (the truth), box (a detector's), none (the object is searched for)."
        ),
    ] = "near",
    unit: Annotated[
        str, typer.Option(help="Errors are shares of the distance of the eyes' centres, or of their outer corners.")
    ] = "centres",
    diagonal: Diagonal = 150.0,
    methods: Methods = COMPARED,
    trials: Starts = 1,
    seed: Seed = 0,
    solver: Solver = "liaam",
    jobs: Jobs = None,
) -> None:
    """How much does another light degrade a generic model, on unseen objects?"""
    from experiments import generic as module

    options = {"test": test, "first": first, "lamps": lamps, "training_lamp": training_lamp, "unit": unit}
    options |= {"starts": names_in(starts, "--starts"), "diagonal": diagonal}
    request = data, methods, trials, seed, solver
    run_protocol(module.generic_experiment, module.table, out, jobs, request, **options)


@app.command()
def relight(
    data: OneLight,
    test: Lights,
    training_lamp: TrainingLamp,
    out: Out,
    lamps: Lamps = None,
    diagonal: Diagonal = 150.0,
    jobs: Jobs = None,
) -> None:
    """How alike do images of unseen objects become in the training light, and is there a seam?"""
    from experiments import relight as module

    summary = execute(module.relight_experiment(data, test, lamps, training_lamp, diagonal), out, jobs)
    print_protocol(module.table(summary), summary, out)


@app.command()
def recognise(
    data: OneLight,
    test: Lights,
    training_lamp: TrainingLamp,
    out: Out,
    lamps: Lamps = None,
    far: Annotated[str, typer.Option(help="Lights to report together, separated by commas.")] = "",
    diagonal: Diagonal = 150.0,
    jobs: Jobs = None,
) -> None:
    """Are persons found again under other lights, from the canonical appearance? (Paper section 1.)"""
    from experiments import recognise as module

    grouped = names_in(far, "--far") if far else ()
    summary = execute(module.recognise_experiment(data, test, lamps, training_lamp, diagonal, grouped), out, jobs)
    print_protocol(module.table(summary), summary, out)


@app.command()
def compress(
    data: OneLight,
    test: Lights,
    training_lamp: TrainingLamp,
    out: Out,
    lamps: Lamps = None,
    diagonal: Diagonal = 150.0,
    jobs: Jobs = None,
) -> None:
    """How good are images kept as appearance and light, beside JPEG and WebP of as many bytes? (Paper section 1.)"""
    from experiments import compress as module

    summary = execute(module.compress_experiment(data, test, lamps, training_lamp, diagonal), out, jobs)
    print_protocol(module.table(summary), summary, out)


@app.command()
def peer(
    data: PersonsFolder,
    out: Out,
    methods: Methods = COMPARED,
    trials: Annotated[int, typer.Option(help="Starts per image and light.", min=1)] = 1,
    seed: Seed = 0,
    solver: Solver = "liaam",
    unseen: Annotated[
        bool, typer.Option("--unseen", help="Fit persons that the model has not seen, two left out at a time.")
    ] = False,
    jobs: Jobs = None,
) -> None:
    """How does liaam compare with menpofit's published results, on menpofit's protocol?"""
    from experiments import peer as module

    run_protocol(module.peer_experiment, module.table, out, jobs, (data, methods, trials, seed, solver), unseen=unseen)


@app.command()
def basin(
    data: Annotated[
        Path, typer.Option(help="Folder of the spot protocol, or of images named after persons, as 01_01.")
    ],
    out: Out,
    methods: Methods = COMPARED,
    trials: Starts = 20,
    seed: Seed = 0,
    solver: Solver = "liaam",
    jobs: Jobs = None,
) -> None:
    """From how far away do fits still find the object?"""
    from experiments import basin as module

    run_protocol(module.basin_experiment, module.table, out, jobs, (data, methods, trials, seed, solver))


@app.command()
def points(
    data: SpotFolder,
    out: Out,
    theirs: Annotated[
        Path | None,
        typer.Option(help="Folder of another landmarker's files, named as the images. By default it is simulated."),
    ] = None,
    trials: Annotated[int, typer.Option(help="Draws of the simulated points of an image.", min=1)] = 3,
    seed: Seed = 0,
    jobs: Jobs = None,
) -> None:
    """What are the points of another landmarker worth as the start of a fit?"""
    from experiments import points as module

    summary = execute(module.points_experiment(data, theirs, trials, seed), out, jobs)
    print_protocol(module.table(summary), summary, out)


@app.command()
def occlusion(
    data: SpotFolder,
    out: Out,
    methods: Methods = COMPARED,
    trials: Annotated[int, typer.Option(help="Starts and patches per image.", min=1)] = 2,
    seed: Seed = 0,
    solver: Solver = "liaam",
    jobs: Jobs = None,
) -> None:
    """How much does a textured patch over a fifth of the face degrade fits?"""
    from experiments import occlusion as module

    run_protocol(module.occlusion_experiment, module.table, out, jobs, (data, methods, trials, seed, solver))


@app.command()
def unchanged(
    data: SpotFolder,
    out: Out,
    methods: Methods = f"{COMPARED},chroma",
    trials: Starts = 1,
    seed: Seed = 0,
    solver: Solver = "liaam",
    jobs: Jobs = None,
) -> None:
    """What does invariance cost if the light has not changed? (Leave-one-out on diffuse images.)"""
    from experiments import unchanged as module

    run_protocol(module.unchanged_experiment, module.table, out, jobs, (data, methods, trials, seed, solver))


@app.command()
def assisted(
    data: SpotFolder,
    out: Out,
    recipes: Annotated[
        str, typer.Option(help="Ways to train: sample, shrunk, smooth, smooth-auto, smooth-auto-both.")
    ] = "sample,smooth",
    orders: Annotated[str, typer.Option(help="Which image comes next: drawn, uncertain.")] = "drawn",
    trials: Annotated[int, typer.Option(help="Draws of twelve persons and their order.", min=1)] = 24,
    seed: Seed = 0,
    jobs: Jobs = None,
) -> None:
    """How accurately does a model of the first few annotated images place the next image's points?"""
    from experiments import assisted as module

    given = names_in(recipes, "--recipes"), names_in(orders, "--orders")
    summary = execute(module.assisted_experiment(data, *given, trials, seed), out, jobs)
    print_protocol(module.table(summary), summary, out)


@app.command()
def shapes(
    data: Annotated[Path, typer.Option(help="Folder of at least 40 images of one kind of object and their landmarks.")],
    out: Out,
    jobs: Jobs = None,
) -> None:
    """What do objects of two kinds of shape lose in one Gaussian, and in a model for each kind?"""
    from experiments import shapes as module

    summary = execute(module.shapes_experiment(data), out, jobs)
    print_protocol(module.table(summary), summary, out)


@app.command()
def uncertainty(
    out: Out,
    data: Annotated[
        Path | None, typer.Option(help="Folder of the spot protocol, fitted beside generated heads if given.")
    ] = None,
    heads: Annotated[int, typer.Option(help="Generated heads.", min=1)] = 4,
    seed: Seed = 0,
    solver: Solver = "liaam",
    jobs: Jobs = None,
) -> None:
    """Do the confidence ellipses contain the truth, and does the quality separate right fits from wrong ones?"""
    from experiments import uncertainty as module

    summary = execute(module.uncertainty_experiment(data, heads, seed, solver), out, jobs)
    print_protocol(module.table(summary), summary, out)


@app.command()
def reproduce(
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for report.html and a folder for each experiment.")],
    person: Annotated[
        Path | None, typer.Option(help="Folder of one person's landmarked images under homogeneous light.")
    ] = None,
    persons: Annotated[Path | None, typer.Option(help="Folder of many persons, as 'spot' takes it.")] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Few trials: minutes instead of an hour or so.")] = False,
    seed: Seed = 0,
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


def main() -> None:
    """Run the command line."""
    run_app(app)
