"""The commands ``liaam show``, ``liaam info``, ``liaam models`` and ``liaam methods``."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer
from rich.table import Table

from liaam.cli.inputs import ModelFile, read_sample
from liaam.cli.lamps import LAMPS_SUFFIX, read_lamps
from liaam.cli.terminal import cell, progress_bar, say, show_table, table_of
from liaam.errors import LiaamError
from liaam.io.atomic import check_output
from liaam.io.files import count_of, existing_file
from liaam.models import MODELS, model_file as file_of

if TYPE_CHECKING:
    from liaam.model import AAM
    from liaam.photometry import CameraModel


def show(
    file: Annotated[
        Path,
        typer.Argument(
            metavar="FILE",
            readable=False,
            help="Model file of 'liaam train', a name of 'liaam models', or lamp file of 'liaam lamps'.",
        ),
    ],
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Figure to write. By default beside the input file.")
    ] = None,
    image: Annotated[
        Path | None,
        typer.Option(help="For lamps: image to draw them on, with landmarks beside it. By default plain grey."),
    ] = None,
) -> None:
    """Draw a model (mean, mesh, shape and appearance modes), or the effect of each lamp in a lamp file."""
    from liaam.model import load_model
    from liaam.plotting import figure_of_lamps, figure_of_model, save_figure

    lit = file.suffix.lower() == LAMPS_SUFFIX
    if image is not None and not lit:
        raise LiaamError("--image works with lamp files only; leave it out to draw a model")
    given, file = file, existing_file(file_of(file), LiaamError, "model or lamp file")
    path = output or given.with_name(f"{given.stem}_{'lamps' if lit else 'model'}.png")
    if path.suffix.lower() not in (".png", ".svg", ".pdf"):
        raise LiaamError(f"{path}: give a name that ends in .png, .svg or .pdf")
    check_output(path)
    credit = ""
    with progress_bar() as progress:
        progress(0, 1, f"drawing {file.name}")
        if not lit:
            model = load_model(file)
            if model.others:
                say(f"shapes, from top to bottom: {describe_shapes(model)}")
            figure, credit = figure_of_model(model), model.credit
        elif image is None:
            figure = figure_of_lamps(read_lamps(file))
        else:
            sample = read_sample(image)
            figure = figure_of_lamps(read_lamps(file), sample.read_image(), sample.landmarks.points)
        save_figure(figure, path)
    if credit:
        say(f"credit: {credit}")
    say(f"written to {path}")


def info(model_file: ModelFile) -> None:
    """Describe a model file."""
    from liaam.model import load_model

    table = Table.grid(padding=(0, 2))
    for key, value in describe(load_model(model_file), model_file).items():
        table.add_row(key, cell(value))
    show_table(table)


def describe_core() -> str:
    """Say what fits: the compiled core and its instruction set, or NumPy."""
    from liaam import _core

    return f"compiled, {_core.INSTRUCTION_SET}" if _core.BUILT else "not compiled (NumPy)"


def count_modes(model: "AAM") -> str:
    """Describe the number of shape modes, for ``soft-li`` and the other methods where it differs."""
    from liaam.model import MESH, SURROUNDINGS

    counts = {name: len(view.shape_model.modes) for name, view in model.views.items()}
    own, others = counts.get(SURROUNDINGS, counts[MESH]), counts[MESH]
    return f"{own}" if own == others else f"{own} for soft-li, {others} for the other methods"


def describe(model: "AAM", path: Path) -> dict[str, str]:
    """Describe a model as labels and texts."""
    from liaam.fitting.held import methods_of

    appearances = {k: v for view in model.views.values() for k, v in view.levels[-1].appearances.items()}
    spread = np.sqrt((model.shape_model.eigenvalues.sum()) / model.n_points)
    width, height = model.frame.size
    more = {}
    if model.points is not None:
        more["starts from"] = f"{model.points.n_theirs} points of another landmarker, too"
    if model.features is not None:
        more["features"] = f"{model.features.name}, a function"
    return {
        "model": f"{model.name or path.stem} ({path.stat().st_size / 1e6:.1f} MB)",
        "trained on": f"{model.n_all_images} {'' if model.is_colour else 'grey '}images{count_copies(model)}",
        **({"shapes": f"{describe_shapes(model)}; below, the first"} if model.others else {}),
        "landmarks": f"{model.n_points}, in {len(model.triangles)} triangles and {len(model.contours)} contours",
        "shape modes": f"{count_modes(model)}, and 4 of position, size and rotation; spread {spread:.1f} px",
        "appearance modes": ", ".join(f"{a.n_modes} {name}" for name, a in appearances.items()),
        "methods": ", ".join(methods_of(model)),
        "quality, ellipses": "calibrated on left-out images" if model.calibrated else "not calibrated",
        **more,
        "reference frame": f"{width}×{height} px, {model.n_pixels} inside the mesh",
        "levels": "blur " + ", ".join(f"{level.blur:g}" for level in model.levels) + " px, coarse to fine",
        "camera": describe_camera(model.camera),
        **({"credit": model.credit} if model.credit else {}),
        "core": describe_core(),
    }


def describe_shapes(model: "AAM") -> str:
    """Describe the shapes of a model by their shares of the training images, the most frequent first."""
    shares = (f"{count_of(part.n_images, 'image')} ({part.n_images / model.n_all_images:.0%})" for part in model.parts)
    return f"{len(model.parts)}, each with a model of its own: {', '.join(shares)}"


def count_copies(model: "AAM") -> str:
    """Describe the mirrored or relit copies among the training images."""
    more = sum(part.n_textures - part.n_images for part in model.parts)
    if more <= 0:
        return ""
    return f" and {more} copies under {model.n_lamps} lamps" if model.n_lamps else f" and {more} mirrored copies"


def describe_camera(camera: "CameraModel") -> str:
    """Describe a camera in one line."""
    error = "assumed" if camera.theta_deviation is None else f"± {np.rad2deg(camera.theta_deviation):.2f}°"
    response = camera.response if isinstance(camera.response, (str, float)) else "measured"
    known = [name for name in ("vignetting", "noise") if getattr(camera, name)]
    return f"response {response}, theta {np.rad2deg(camera.theta):.1f}° ({error})" + "".join(f", {n}" for n in known)


def models() -> None:
    """List the models that come with liaam: what they are for, how accurate they are, and their terms."""
    from liaam.model import load_model

    table = Table.grid(padding=(0, 2))
    for name, known in MODELS.items():
        model = load_model(name)
        images = f"{model.n_images} images{count_copies(model)}"
        rows = {
            "model": name,
            "for": known.purpose,
            "accuracy": known.accuracy,
            "landmarks": f"{model.n_points}, trained on {images}",
            "credit": model.credit,
        }
        for key, value in rows.items():
            table.add_row(key, cell(value))
    show_table(table)
    say("Give its name as MODEL, as in 'liaam fit face photo.jpg'.")


def methods() -> None:
    """List the fitting methods."""
    from liaam.fitting import METHODS
    from liaam.fitting.methods import LOSSES, NOISE_SUFFIX

    table = table_of("method", "compares")
    for method in METHODS.values():
        table.add_row(method.name, method.summary)
    show_table(table)
    say(
        f"For occlusion, add a robust loss to any method, as in grey+tukey: {', '.join(f'+{n}' for n in LOSSES)}. "
        f"Methods on logarithms can also weight pixels by image noise: +{NOISE_SUFFIX}, as in li+{NOISE_SUFFIX}."
    )
