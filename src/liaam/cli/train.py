"""The command ``liaam train``."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from liaam.cli import inputs
from liaam.cli.check import warn_of_faults
from liaam.cli.lamps import LAMPS_SUFFIX, TrainingLampOption, read_lamps
from liaam.cli.models import (
    count_copies,
    count_modes,
    describe_missing,
    describe_refiner,
    describe_regressor,
    describe_shapes,
)
from liaam.cli.terminal import complain, progress_bar, say
from liaam.errors import LiaamError
from liaam.io import IMAGE_SUFFIXES, LANDMARK_SUFFIXES
from liaam.io.atomic import check_output
from liaam.io.landmarks.reading import Reading

if TYPE_CHECKING:
    from liaam.model import AAM
    from liaam.photometry import CameraModel
    from liaam.training import LearntLamps

MODEL_SUFFIX = ".liaam"  # Suffix of files that may be replaced by a model

MethodsOption = Annotated[
    str,
    typer.Option(
        help="Methods to fit with, besides soft-li, such as li,grey, or 'all'. Each makes the file larger; see "
        "'liaam fit --help'."
    ),
]


def train(
    folder: inputs.LandmarkedFolder,
    output: Annotated[Path, typer.Option("--output", "-o", help="Model file to write.")],
    diagonal: Annotated[float, typer.Option(help="Diagonal of the object's box in the model, in pixels.")] = 150.0,
    given_camera: Annotated[
        str | None,
        typer.Option(
            "--camera",
            help="Camera of the images: a file of 'liaam camera' (angle, response, vignetting, noise); or the response "
            "alone: srgb (default), linear, or a gamma such as 2.2; or the angle theta alone, in degrees from 60 to "
            "180 (122 for an unknown camera).",
        ),
    ] = None,
    lamps: Annotated[
        Path,
        typer.Option(
            help="Also train on copies of the images under other lamps. Give a file of 'liaam lamps', or a folder of "
            "a few objects under several lamps, named by object and lamp, such as 037-00. 'auto' uses lamps of "
            "rendered heads if the objects are faces; 'none' uses none."
        ),
    ] = Path(inputs.AUTO),
    training_lamp: TrainingLampOption = None,
    copies: Annotated[
        int | None,
        typer.Option(
            help="Number of copies of each image under other lamps. If the object is symmetric, every second copy is "
            "mirrored, and without lamps there is one mirrored copy. 0 for none."
        ),
    ] = None,
    points: Annotated[
        Path | None,
        typer.Option(
            help="Folder with the points that another program found on the images, in files with the names of the "
            "images; or 'mediapipe' for its face mesh. Fits can then start from such points with --init, and use them "
            "as a prior."
        ),
    ] = None,
    contour: Annotated[
        list[str] | None,
        typer.Option(
            help="Landmarks on a contour such as the jaw, by numbers from 1: 1-17, or 37-42,37 for a closed contour. "
            "They are less certain along the contour than across it. May be repeated. By default the contours of the "
            "landmark files."
        ),
    ] = None,
    methods: MethodsOption = "",
    sides: inputs.SidesOption = inputs.AUTO,
    shapes: inputs.ShapesOption = inputs.AUTO,
    regressor: Annotated[
        str,
        typer.Option(
            help="Whether to learn to predict the landmarks by regression, too: 'always', 'none', or 'auto' (only if "
            "fewer fits to left-out images fail with it). Fits then start from the prediction and take it into account."
        ),
    ] = inputs.AUTO,
    refiner: Annotated[
        str,
        typer.Option(
            help="Whether to learn to correct the landmarks of fits by regression: 'always', 'none', or 'auto' (only "
            "if fits to left-out images are nearer with it)."
        ),
    ] = inputs.AUTO,
    leave_out: Annotated[
        bool,
        typer.Option(
            help="Fit left-out images to calibrate the quality and covariance of later fits. Doubles the time."
        ),
    ] = True,
    name: Annotated[str | None, typer.Option(help="Name of the model, for 'liaam show'.")] = None,
    strict: inputs.StrictOption = False,
    category: inputs.CategoryOption = None,
    y_down: inputs.YDownOption = False,
    stored_orientation: inputs.StoredOption = False,
) -> None:
    """Train a model on a folder of landmarked images."""
    from liaam.training import train as train_model
    from liaam.training.objects import describe_objects

    check_model_name(output, folder)
    with_regressor = parse_choice("--regressor", regressor)  # its errors come before any work
    with_refiner = parse_choice("--refiner", refiner)
    if training_lamp is not None and not inputs.folder_of(lamps)[0].is_dir():
        raise LiaamError(
            f"--training-lamp {training_lamp}: this names the training light in a folder of lamp images; give that "
            "folder with --lamps, or leave --training-lamp out"
        )
    reading = Reading(strict, category, y_down, stored_orientation)
    data = inputs.read_folder(folder, reading)
    camera = inputs.camera_for([s.image for s in data if isinstance(s.image, Path)], given_camera)
    contours = [parse_contour(text) for text in contour or ()]
    light = parse_lamps(lamps, training_lamp, camera)
    warn_of_faults(data, folder, inputs.parse_shapes(shapes), sides)
    if leave_out and (together := describe_objects([sample.name for sample in data])):
        say(together)
    with progress_bar(counted=False) as progress:
        model = train_model(
            data,
            camera=camera,
            diagonal=diagonal,
            lamps=light,
            copies=copies,
            points=points,
            contours=contours or None,
            methods=parse_methods(methods),
            sides=sides,
            shapes=inputs.parse_shapes(shapes),
            regressor=with_regressor,
            refiner=with_refiner,
            name=name or inputs.folder_of(folder)[0].name,
            leave_out=leave_out,
            strict=strict,
            progress=progress,
        )
    model.save(output)
    report(model, output, light, leave_out)


def compact(
    model_file: inputs.ModelFile,
    output: Annotated[Path, typer.Option("--output", "-o", help="Model file to write.")],
    methods: MethodsOption = "",
) -> None:
    """Write a model again as a small file, which holds soft-li and the methods asked for.

    It fits as before. Files of older versions of liaam hold all methods and are ten times as large.
    """
    from liaam.fitting.methods import methods_of
    from liaam.model import load_model
    from liaam.training import compact as compact_model

    check_model_name(output, model_file.with_suffix(""))
    model = load_model(model_file)
    before = model_file.stat().st_size
    model = compact_model(model, parse_methods(methods))
    model.save(output)
    sizes = f"{output.stat().st_size / 1e6:.1f} MB instead of {before / 1e6:.1f} MB"
    say(f"{output}: {sizes}; fits with {', '.join(methods_of(model))}")


def parse_methods(text: str) -> list[str] | Literal["all"]:
    """Parse methods, separated by commas, or ``all``."""
    names = [name for part in text.split(",") if (name := part.strip())]
    return "all" if names == ["all"] else names


def parse_contour(text: str) -> list[int]:
    """Parse the landmarks of a line, numbers and ranges from 1 such as ``37-42,37``; return their indices from 0."""
    numbers: list[int] = []
    for part in text.split(","):
        ends = part.strip().split("-")
        if len(ends) > 2 or not all(end.strip().isdecimal() and int(end) > 0 for end in ends):
            raise LiaamError(f"--contour {text}: give numbers of landmarks from 1, such as 1-17 or 37-42,37")
        first = int(ends[0])
        last = int(ends[-1])
        numbers += range(first, last + 1) if first <= last else range(first, last - 1, -1)
    return [number - 1 for number in numbers]


def check_model_name(output: Path, folder: Path) -> None:
    """Raise if no model can, or should, be written to this file."""
    check_output(output)
    if output.exists() and output.suffix.lower() != MODEL_SUFFIX:
        raise LiaamError(
            f"{output} exists and is not a {MODEL_SUFFIX} file, so it is kept; give another name for the model, such "
            f"as {folder.resolve().name}{MODEL_SUFFIX}"
        )
    if output.suffix.lower() in {*IMAGE_SUFFIXES, *LANDMARK_SUFFIXES, LAMPS_SUFFIX}:
        raise LiaamError(
            f"{output}: a model ends in {MODEL_SUFFIX}, not in {output.suffix}; give a name such as "
            f"{output.with_suffix(MODEL_SUFFIX)}"
        )


def parse_choice(option: str, text: str) -> bool | str:
    """Return what an option says: whether there is to be a regressor or a refiner, or ``auto``."""
    choices: dict[str, bool | str] = {inputs.AUTO: inputs.AUTO, "always": True, "none": False}
    if text not in choices:
        raise LiaamError(f"{option} {text}: give {', '.join(choices)}")
    return choices[text]


def parse_lamps(
    lamps: Path, training_lamp: str | None, camera: "CameraModel"
) -> "LearntLamps | Literal['auto'] | None":
    """Return the lamps that --lamps names or, if it is a folder, those learnt from its images."""
    if str(lamps) in (inputs.AUTO, "none"):
        return None if str(lamps) == "none" else inputs.AUTO
    if not inputs.folder_of(lamps)[0].exists():
        raise LiaamError(f"--lamps {lamps}: this does not exist; give a lamp file, a folder, 'auto' or 'none'")
    return read_lamps(lamps, training_lamp, camera.response)


def report(model: "AAM", output: Path, light: "LearntLamps | Literal['auto'] | None", leave_out: bool) -> None:
    """Print what was trained, and how accurate its fits can be."""
    from liaam.fitting.methods import DEFAULT_METHOD, METHODS

    modes = f"shape modes: {count_modes(model)}; pixels: {model.n_pixels}"
    say(f"{output}: trained on {model.n_all_images} images{count_copies(model)}; {modes}")
    if model.n_all_missing.any():
        say(f"missing landmarks: {describe_missing(model)}")
    if model.sides is not None:
        say(f"sides: {model.sides.describe()} (to train on all images as they are, use --sides one)")
    if model.others:
        say(f"kinds of shape: {describe_shapes(model)} (--shapes 1 for one model)")
    if not len(model.shape_model.modes):
        say("the shape is rigid, without shape modes: fits find position, size and rotation only")
    if light == inputs.AUTO and model.n_lamps:
        say(
            "the objects are faces, so liaam also trained on copies in the light of lamps that it knows from rendered "
            "heads (to train without such copies, use --lamps none)"
        )
    view = model.views[METHODS[DEFAULT_METHOD].view]
    bound = view.shape_model.left_out_bound
    say(
        "limit of accuracy: the best shapes that the model can make for left-out images are off by "
        f"{bound / model.diagonal:.1%} of the diagonal of the landmarks' box. Fits have larger errors. With more "
        "training images, this limit and the errors become smaller"
    )
    if model.card.accuracy:
        say(model.card.accuracy)
    if model.points is not None:
        away = model.points.deviation
        say(
            f"the other landmarker's {model.points.n_theirs} points: mapped to the landmarks with an error of "
            f"{away:.1f} pixels ({away / model.diagonal:.1%}) on left-out images"
        )
    if model.regressor is not None:
        say(f"{describe_regressor(model)} (--regressor none for none)")
    if model.refiner is not None:
        say(f"{describe_refiner(model)} (--refiner none for none)")
    if not leave_out:
        say("the quality and the ellipses of fits are not calibrated (--no-leave-out)")
    elif not model.calibrated:
        complain(
            "fits have no calibrated quality, and all are called doubtful: too few fits to left-out images were right; "
            "train on more images"
        )
    if model.scale is not None:
        say(f"all images have a scale of {model.scale} per pixel, which fits keep for images that state none")
