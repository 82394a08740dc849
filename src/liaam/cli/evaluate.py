"""The command ``liaam evaluate``."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from liaam.cli import inputs
from liaam.cli.terminal import cell, complain, say, show_table, table_of
from liaam.errors import LiaamError
from liaam.fitting.search.starts import read_start
from liaam.io import image_size, make_folder, write_columns
from liaam.io.atomic import check_output, write_text_atomically
from liaam.io.files import count_of, real_path, some_names
from liaam.io.landmarks.reading import Reading
from liaam.tables import Columns

if TYPE_CHECKING:
    from liaam import AAM, Evaluation
    from liaam.datasets import Dataset
    from liaam.evaluation import LearningCurve

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
            help="Number of parts for cross-validation without a MODEL: the images are divided into parts, and for "
            "each part a model that was trained on the other parts is evaluated. Images of one person or object, "
            "according to their names, are in one part.",
            min=2,
        ),
    ] = None,
    learning_curve: Annotated[
        bool,
        typer.Option(
            "--learning-curve",
            help="Train models on 5, 10, 20, ... images of the folder, measure their errors on other images of it, and "
            "forecast the error of a model trained on twice as many images as there are. Give no MODEL.",
        ),
    ] = False,
    second: Annotated[
        Path | None,
        typer.Option(
            help="Landmarks that another person placed on the same images, or the same person again: a file or a "
            "folder. The variance of shape is then estimated without the errors of people."
        ),
    ] = None,
    groups: Annotated[
        Path | None,
        typer.Option(
            help="Table .csv with the columns specimen (or image) and group, to estimate how much smaller differences "
            "between groups appear in automatic shapes."
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
            help="Two landmarks, by their numbers from 1 or their names. Errors are then in % of the distance between "
            "them. By default, errors are in % of the diagonal of the landmarks' box.",
        ),
    ] = None,
    limit: Annotated[
        float | None,
        typer.Option(
            help="Largest mean error of a right fit, in %. By default 3 % of the diagonal, as in training, or 8 % with "
            "--normalise.",
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
    """Fit images that have landmarks, and compare the fits with these landmarks.

    Prints the errors, the number of wrong fits, how many landmarks are inside their 95 % ellipses, and whether
    automatic shapes vary as much as those placed by hand. Writes the errors of each landmark and each image as tables,
    and pictures of the ten worst fits.
    """
    from liaam.model import load_model

    if learning_curve:
        refuse_beside_curve({"--folds": folds, "--groups": groups, "--init": init})
        model_file = None
        folder = folder_of_curve(sources)
    else:
        model_file, folder = model_and_folder(sources, folds, init)
    model = None if model_file is None else load_model(model_file)
    reading = Reading(strict, category, y_down, stored_orientation)
    root, *_ = inputs.folder_of(folder)
    data = without_proposals(inputs.read_folder(folder, reading), root)
    prepare_output(output, root)
    camera = inputs.camera_for(image_files(data), given_camera, None if model is None else model.camera)
    people = None if second is None else second_points(second, root, data, reading)
    options: dict[str, Any] = {
        "method": method,
        "normalise": normalise,
        "camera": camera,
        "limit": None if limit is None else limit / 100,
    }
    if learning_curve:
        show_and_write_curve(output, measure_curve(data, people, options))
        return
    if model is not None:
        evaluation = evaluate_model(model, data, init, options)
    else:
        assert folds is not None  # model_and_folder raises without both
        evaluation = evaluate_folds(data, folds, options)
    show_and_write(output, with_people(evaluation, people, groups))


def refuse_beside_curve(options: dict[str, Any]) -> None:
    """Raise if an option is given that a learning curve does not use."""
    if given := [name for name, value in options.items() if value is not None]:
        raise LiaamError(
            "--learning-curve divides the images itself, searches for the objects and compares no groups; leave "
            f"{', '.join(given)} out"
        )


def folder_of_curve(sources: list[Path]) -> Path:
    """Return the folder of a learning curve; raise if a model is given."""
    if len(sources) != 1:
        raise LiaamError("--learning-curve trains models on the folder itself: give the folder only")
    return sources[0]


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


def prepare_output(output: Path, root: Path) -> None:
    """Raise unless the output can be written, and is outside the folder of landmarks; make it if it is a folder."""
    if real_path(output).is_relative_to(real_path(root)):  # it would be read as landmarks later
        raise LiaamError(f"{output} is inside the folder of landmarks; give another place with -o")
    if output.suffix.lower() == ".csv":
        check_output(output)
    else:
        make_folder(output)


def image_files(data: "Dataset") -> list[Path]:
    """Return the files of the images; one that holds several objects comes once for each."""
    return [sample.image for sample in data if isinstance(sample.image, Path)]


def without_proposals(data: "Dataset", folder: Path) -> "Dataset":
    """Return landmarked images without points that the studio proposed and nobody placed, moved or confirmed.

    They would confirm the model that proposed them.
    """
    from liaam.studio import origins

    proposals_of = origins.saved_proposals(folder) if folder.is_dir() else {}
    samples = []
    changed = []
    n_points = 0
    for sample in data:
        proposals = proposals_of.get(_picture_of(sample.image, folder))
        points, n_proposed = origins.without_proposals(sample.landmarks.points, proposals)
        if n_proposed:
            changed.append(sample.name)
            n_points += n_proposed
        samples.append(replace(sample, landmarks=replace(sample.landmarks, points=points)))
    if changed:
        complain(
            f"{count_of(n_points, 'point')} of {count_of(len(changed), 'image')} left out, because they were accepted "
            f"as the studio proposed them: {some_names(changed)}; move or confirm each point in the studio"
        )
    return replace(data, samples=tuple(samples))


def _picture_of(image: Any, folder: Path) -> str:
    """Return the name of an image as the studio stores it: its path inside the folder."""
    path = real_path(image)
    root = real_path(folder)
    return path.relative_to(root).as_posix() if path.is_relative_to(root) else path.name


def second_points(second: Path, folder: Path, data: "Dataset", reading: Reading) -> dict[str, np.ndarray]:
    """Return the landmarks of a second person by the name of the image, in the order of the first person's."""
    from liaam.evaluation.observers import points_by_name
    from liaam.morphometry import read_specimens

    if real_path(second) == real_path(folder):
        raise LiaamError(f"--second {second} is the folder of the first person's landmarks: give the other's")
    names = next((sample.landmarks.names for sample in data if sample.landmarks.names), ())
    return points_by_name(read_specimens(second, complain, reading), names)


def evaluate_model(model: "AAM", data: "Dataset", init: str | None, options: dict[str, Any]) -> "Evaluation":
    """Evaluate a model, from the start ``init`` in each image if there is one."""
    from liaam.evaluation import evaluate as evaluate_fits

    if init is None:
        starts = None
    else:
        paths = dict.fromkeys(image_files(data))  # of several objects in an image there is one start
        starts = [read_start(init, path, image_size(path)) for path in paths]
    return evaluate_fits(model, data, starts, **options)


def evaluate_folds(data: "Dataset", folds: int, options: dict[str, Any]) -> "Evaluation":
    """Evaluate models of the others on each of so many parts of the images; say which images stay together."""
    from liaam.datasets.copies import copies_fault
    from liaam.evaluation import cross_validate
    from liaam.training.objects import describe_objects

    if copies := copies_fault(data.samples):
        complain(copies)
    together = describe_objects([sample.name for sample in data])
    if together:
        say(together)
    return cross_validate(data, folds, training={"camera": options["camera"]}, **options)


def with_people(evaluation: "Evaluation", people: dict[str, np.ndarray] | None, groups: Path | None) -> "Evaluation":
    """Return an evaluation with the landmarks of a second person, and with groups."""
    from liaam.evaluation.observers import points_of
    from liaam.morphometry import groups_of, read_groups

    if people is not None:
        points = points_of(evaluation.names, people, evaluation.truths.shape[1], "--second")
        evaluation = replace(evaluation, second=points)
    if groups is not None:
        evaluation = replace(evaluation, groups=groups_of(evaluation.names, read_groups(groups)))
    return evaluation


def measure_curve(data: "Dataset", people: dict[str, np.ndarray] | None, options: dict[str, Any]) -> "LearningCurve":
    """Measure the errors of models of more and more images, beside those of a second person if there is one."""
    from liaam.evaluation import learning_curve

    return learning_curve(data, second=people, training={"camera": options["camera"]}, **options)


def show_and_write_curve(output: Path, curve: "LearningCurve") -> None:
    """Print and write a learning curve, and print its report."""
    columns = curve.to_columns()
    show_curve(columns)
    write_curve(output, curve, columns)
    say(curve.report())
    say(f"written to {output}")


def show_curve(columns: Columns) -> None:
    """Print the columns of a learning curve."""
    table = table_of("images", "median", "90th percentile", "wrong", "slope of shapes")
    for i, slope in enumerate(columns["slope"]):
        table.add_row(
            str(columns["pictures"][i]),
            f"{columns['median_percent'][i]:.2f} %",
            f"{columns['p90_percent'][i]:.2f} %",
            f"{columns['lost_percent'][i]:.0f} %",
            "–" if np.isnan(slope) else f"{slope:.2f}",
        )
    show_table(table)


def write_curve(output: Path, curve: "LearningCurve", columns: Columns) -> None:
    """Write a learning curve as a table, and into a folder also as text in JSON and as a figure."""
    from liaam.plotting import save_figure

    if output.suffix.lower() == ".csv":
        write_columns(output, columns)
        return
    write_columns(output / "learning-curve.csv", columns)
    write_text_atomically(output / "learning-curve.json", curve.to_json() + "\n")
    save_figure(curve.plot().figure, output / "learning-curve.png")  # type: ignore[arg-type]


def show_and_write(output: Path, evaluation: "Evaluation") -> None:
    """Write an evaluation, and print its landmarks and its report."""
    write(output, evaluation)
    show_landmarks(evaluation)
    say(evaluation.report())
    if any(evaluation.in_training):
        complain("no sentences for a paper, since the model was trained on some of these images")
    elif evaluation.agreement is not None:
        say(f"for the section Methods of a paper: {evaluation.agreement.methods()}")
    say(f"written to {output}")


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
        write_text_atomically(output / "shapes.json", evaluation.agreement.to_json())
        save_figure(evaluation.agreement.plot(), output / "shapes.png")
    save_figure(evaluation.plot().figure, output / "errors.png")  # type: ignore[arg-type]
    save_figure(evaluation.plot_worst(SHOWN), output / "worst.png")


def show_landmarks(evaluation: "Evaluation") -> None:
    """Print the landmarks with the largest errors, in the order of their numbers."""
    columns = evaluation.by_landmark()
    worst_first = sorted(range(len(columns["landmark"])), key=lambda i: -columns["median"][i])
    table = table_of("landmark", "median", "90th percentile", "in 95 % ellipse")
    for i in sorted(worst_first[:SHOWN]):
        name = f" {columns['name'][i]}" if columns["name"][i] else ""
        inside = columns["inside_percent"][i]
        table.add_row(
            cell(f"{i + 1}{name}"),
            f"{columns['median_percent'][i]:.2f} % ({columns['median'][i]:.1f} px)",
            f"{columns['p90_percent'][i]:.2f} % ({columns['p90'][i]:.1f} px)",
            "–" if np.isnan(inside) else f"{inside:.0f} %",
        )
    show_table(table)
    if len(worst_first) > SHOWN:
        say(f"these are the {SHOWN} landmarks of {len(worst_first)} with the largest errors; a folder -o has all")
