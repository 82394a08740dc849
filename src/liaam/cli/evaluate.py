"""The command ``liaam evaluate``."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from liaam.cli import inputs
from liaam.cli.terminal import cell, say, show_table, table_of
from liaam.errors import LiaamError
from liaam.fitting.search.starts import read_start
from liaam.io import image_size, make_folder, write_columns
from liaam.io.atomic import check_output
from liaam.io.files import real_path
from liaam.io.landmarks.reading import Reading

if TYPE_CHECKING:
    from liaam import Evaluation

SHOWN = 10  # Landmarks in the printed table, and images on the contact sheet: those with the largest errors


def evaluate(
    sources: Annotated[
        list[Path],
        typer.Argument(
            metavar="[MODEL] FOLDER",
            readable=False,
            help="Model file of 'liaam train', and a folder of images with landmarks that it was not trained on. With "
            "--folds, the folder only.",
        ),
    ],
    output: Annotated[
        Path, typer.Option("--output", "-o", help="Folder for tables and pictures; or a .csv for all errors only.")
    ] = Path("liaam-evaluation"),
    folds: Annotated[
        int | None,
        typer.Option(
            help="Cross-validate without a MODEL: divide the images into so many parts, and evaluate on each a model "
            "of the others. Images of one person or object, by their names, stay together. As many parts as images: "
            "leave one out.",
            min=2,
        ),
    ] = None,
    init: Annotated[
        str | None,
        typer.Option(
            help="Where to start: a box x0,y0,x1,y1 or x,y,size for all images; or a folder with a landmark or .box "
            "file for each image. By default the object is searched for."
        ),
    ] = None,
    normalise: Annotated[
        str | None,
        typer.Option(
            metavar="A-B",
            help="Give errors in % of the distance between two landmarks, by numbers from 1 or by names. By default of "
            "the diagonal of the landmarks' box.",
        ),
    ] = None,
    limit: Annotated[
        float | None,
        typer.Option(
            help="Largest mean error of a right fit, in %. By default 3 % of the diagonal, up to which training counts "
            "fits as right, or 8 % with --normalise.",
            min=0.01,
        ),
    ] = None,
    method: Annotated[str, typer.Option("--method", "-m", help="Fitting method; see 'liaam fit --help'.")] = "soft-li",
    given_camera: inputs.CameraOption = None,
    strict: inputs.StrictOption = False,
    category: inputs.CategoryOption = None,
    y_down: inputs.YDownOption = False,
    stored_orientation: inputs.StoredOption = False,
) -> None:
    """Fit landmarked images and compare: errors, lost fits, and coverage of the 95 % ellipses.

    Writes the errors of each landmark and image as tables, their cumulative distribution, and the worst ten fits.
    """
    from liaam.evaluation import cross_validate, evaluate as evaluated
    from liaam.model import load_model
    from liaam.training.left_out import describe_objects

    model_file, folder = model_and_folder(sources, folds, init)
    model = None if model_file is None else load_model(model_file)
    reading = Reading(strict, category, y_down, stored_orientation)
    data = inputs.read_folder(folder, reading)
    if real_path(output).is_relative_to(real_path(inputs.folder_of(folder)[0])):  # it would be read as landmarks later
        raise LiaamError(f"{output} is inside the folder of landmarks; give another place with -o")
    (check_output if output.suffix.lower() == ".csv" else make_folder)(output)
    paths = [sample.image for sample in data if isinstance(sample.image, Path)]
    camera = inputs.camera_for(paths, given_camera, None if model is None else model.camera)
    options: dict[str, Any] = {"method": method, "normalise": normalise, "camera": camera}
    options["limit"] = None if limit is None else limit / 100
    if model is None:
        if together := describe_objects([sample.name for sample in data]):
            say(together)
        evaluation = cross_validate(data, folds or 2, training={"camera": camera}, **options)
    else:
        # Of several objects in an image there is one start.
        starts = None if init is None else [read_start(init, path, image_size(path)) for path in dict.fromkeys(paths)]
        evaluation = evaluated(model, data, starts, **options)
    write(output, evaluation)
    show_landmarks(evaluation)
    say(evaluation.report())
    say(f"written to {output}")


def model_and_folder(sources: list[Path], folds: int | None, init: str | None) -> tuple[Path | None, Path]:
    """Return the model file, if any, and the folder. Raise unless there is a model or --folds, and not both."""
    if folds is None and len(sources) == 2:
        return sources[0], sources[1]
    if folds is None:
        raise LiaamError("give a model and a folder of landmarked images, or one folder and --folds 5 to train on it")
    if len(sources) != 1:
        raise LiaamError("--folds trains models on the folder itself; give the folder only, or leave --folds out")
    if init is not None:
        raise LiaamError("--folds evaluates fits that search for the object; leave --init or --folds out")
    return None, sources[0]


def write(output: Path, evaluation: "Evaluation") -> None:
    """Write all errors as a table; into a folder also those by image and by landmark, and pictures."""
    from liaam.plotting import save_figure

    if output.suffix.lower() == ".csv":
        write_columns(output, evaluation.to_columns())
        return
    write_columns(output / "errors.csv", evaluation.to_columns())
    write_columns(output / "images.csv", evaluation.by_image())
    write_columns(output / "landmarks.csv", evaluation.by_landmark())
    if evaluation.agreement is not None:
        write_columns(output / "shapes.csv", evaluation.agreement.by_component())
        write_columns(output / "bias.csv", evaluation.agreement.by_landmark())
    save_figure(evaluation.plot().figure, output / "errors.png")  # type: ignore[arg-type]
    save_figure(evaluation.plot_worst(SHOWN), output / "worst.png")


def show_landmarks(evaluation: "Evaluation") -> None:
    """Print the landmarks with the largest errors."""
    columns = evaluation.by_landmark()
    order = sorted(range(len(columns["landmark"])), key=lambda i: -columns["median"][i])[:SHOWN]
    table = table_of("landmark", "median", "90th percentile", "in 95 % ellipse")
    for i in sorted(order):
        name = f" {columns['name'][i]}" if columns["name"][i] else ""
        errors = (f"{columns[f'{q}_percent'][i]:.2f} % ({columns[q][i]:.1f} px)" for q in ("median", "p90"))
        inside = columns["inside_percent"][i]
        table.add_row(cell(f"{i + 1}{name}"), *errors, "–" if inside != inside else f"{inside:.0f} %")
    show_table(table)
