"""The command ``liaam show``."""

import json
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer
from rich.table import Table

from liaam.cli.inputs import read_sample
from liaam.cli.lamps import LAMPS_SUFFIX, read_lamps
from liaam.cli.terminal import cell, progress_bar, say, show_table
from liaam.errors import LiaamError
from liaam.io.atomic import check_output, write_text_atomically
from liaam.io.files import count_of
from liaam.models import MODELS, model_file as file_of

FIGURE_SUFFIXES = (".png", ".svg", ".pdf")
FACTS_SUFFIX = ".json"
MOST_NAMED = 6  # Largest number of landmarks that are named as often missing

if TYPE_CHECKING:
    from liaam.model import AAM


def show(
    file: Annotated[
        Path | None,
        typer.Argument(
            metavar="[FILE]",
            readable=False,
            help="Model file of 'liaam train', name of a model that comes with liaam, or lamp file of 'liaam lamps'.",
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            help="Also draw the model, or the effect of each lamp: .png, .svg or .pdf. Or describe the model: .json.",
        ),
    ] = None,
    image: Annotated[
        Path | None,
        typer.Option(help="For lamps: image to draw them on, with landmarks beside it. By default plain grey."),
    ] = None,
) -> None:
    """Describe a model or a lamp file, and draw it with -o. Without a file, list the models that come with liaam."""
    from liaam.model import load_model

    if file is None:
        for name in MODELS:
            model = load_model(name)
            trained = f"{model.n_points}, trained on {model.n_all_images} images{count_copies(model)}"
            print_rows({"model": name, "landmarks": trained, **model.card.stated})
        say("Give its name as MODEL, as in 'liaam fit face photo.jpg'.")
        return
    lit = file.suffix.lower() == LAMPS_SUFFIX
    if image is not None and not lit:
        raise LiaamError("--image works with lamp files only; leave it out to draw a model")
    file = file_of(file)
    as_json = output is not None and output.suffix.lower() == FACTS_SUFFIX and not lit
    if output is not None and not as_json and output.suffix.lower() not in FIGURE_SUFFIXES:
        raise LiaamError(f"{output}: give a name that ends in .png, .svg or .pdf{'' if lit else ', or in .json'}")
    if output is not None:
        check_output(output)
    from liaam.plotting import figure_of_lamps, figure_of_model, save_figure

    if lit:
        lamps = read_lamps(file)
        sample = None if image is None else read_sample(image)
        print_rows({"lamps": ", ".join(lamps.names), "landmarks": f"{len(lamps.mean)}"})
        on = () if sample is None else (sample.read_image(), sample.landmarks.points)
        draw = partial(figure_of_lamps, lamps, *on)
    else:
        model = load_model(file)
        print_rows(describe(model, file))
        if output is not None and as_json:
            write_text_atomically(output, json.dumps(facts_of(model), indent=1, ensure_ascii=False) + "\n")
            say(f"written to {output}")
            return
        draw = partial(figure_of_model, model)
    if output is None:
        return
    with progress_bar() as progress:
        progress(0, 1, f"drawing {file.name}")
        save_figure(draw(), output)
    say(f"written to {output}")


def card(
    file: Annotated[Path, typer.Argument(metavar="MODEL", readable=False, help="Model file of 'liaam train'.")],
    purpose: Annotated[str | None, typer.Option(help="Images that the model is for.")] = None,
    data: Annotated[str | None, typer.Option(help="What the training images show, and where they are from.")] = None,
    accuracy: Annotated[
        str | None,
        typer.Option(help="How accurate fits are, and on which images. 'liaam train' states that of left-out images."),
    ] = None,
    limits: Annotated[str | None, typer.Option(help="What the model should not be used for.")] = None,
    licence: Annotated[str | None, typer.Option(help="Terms of the model, such as 'CC BY 4.0'.")] = None,
    credit: Annotated[str | None, typer.Option(help="Whom to credit for the model and its images.")] = None,
) -> None:
    """State in a model file what its users should know, before you pass it on.

    'liaam show' prints it. What is not given stays as it is, and an empty text removes it.
    """
    from liaam.model import load_model

    if file.name in MODELS:
        raise LiaamError(f"{file} comes with liaam, and its card stays as it is; give the file of a model of your own")
    model = load_model(file)
    given = {
        "purpose": purpose,
        "data": data,
        "accuracy": accuracy,
        "limits": limits,
        "licence": licence,
        "credit": credit,
    }
    changes = {name: text for name, text in given.items() if text is not None}
    if changes:
        model = replace(model, card=replace(model.card, **changes))
        model.save(file)
    print_rows({"model": model.name or file.stem, **model.card.stated, **describe_missing_in_card(model)})


def print_rows(rows: dict[str, str]) -> None:
    """Print labels and texts."""
    table = Table.grid(padding=(0, 2))
    for key, value in rows.items():
        table.add_row(key, cell(value))
    show_table(table)


def count_modes(model: "AAM") -> str:
    """Describe the number of shape modes, for ``soft-li`` and the other methods where it differs."""
    from liaam.model import MESH, SURROUNDINGS

    counts = {name: len(view.shape_model.modes) for name, view in model.views.items()}
    count = counts.get(SURROUNDINGS, counts[MESH])
    others = counts[MESH]
    return f"{count}" if count == others else f"{count} for soft-li, {others} for the other methods"


def describe(model: "AAM", path: Path) -> dict[str, str]:
    """Describe a model as labels and texts."""
    from liaam import _core
    from liaam.fitting.methods import methods_of
    from liaam.model.file_format import UPRIGHT

    appearances = {k: v for view in model.views.values() for k, v in view.levels[-1].appearances.items()}
    spread = np.sqrt((model.shape_model.eigenvalues.sum()) / model.n_points)
    width, height = model.frame.size
    camera = model.camera
    theta = np.rad2deg(model.theta)
    more = {}
    error = "assumed" if camera.theta_deviation is None else f"± {np.rad2deg(camera.theta_deviation):.2f}°"
    response = camera.response if isinstance(camera.response, (str, float)) else "measured"
    calibrated = "".join(f", {name}" for name in ("vignetting", "noise") if getattr(camera, name))
    if model.points is not None:
        more["starts from"] = f"{model.points.n_theirs} points of another landmarker, too"
    if model.regressor is not None:
        more["regressor"] = describe_regressor(model)
    if model.refiner is not None:
        more["refiner"] = describe_refiner(model)
    if any(part.rotations != UPRIGHT for part in model.parts):
        more["rotations"] = "objects are turned in any direction, and are searched for in all"
    if model.poses is not None:
        more["starts"] = f"{count_of(len(model.poses), 'pose')} of training images, because parts of the object cross"
    if model.scale is not None:
        more["scale"] = f"{model.scale} per pixel in all training images"
    if model.features is not None:
        more["features"] = f"{model.features.name}, a function"
    return {
        "model": f"{model.name or path.stem} ({path.stat().st_size / 1e6:.1f} MB)",
        "trained on": f"{model.n_all_images} {'' if model.is_colour else 'grey '}images{count_copies(model)}",
        **({"shapes": f"{describe_shapes(model)}; below, the first"} if model.others else {}),
        **({} if model.sides is None else {"sides": model.sides.describe()}),
        "landmarks": f"{model.n_points}, in {len(model.triangles)} triangles and {len(model.contours)} contours",
        **({"missing landmarks": describe_missing(model)} if model.n_all_missing.any() else {}),
        "shape modes": f"{count_modes(model)}, and 4 of position, size and rotation; spread {spread:.1f} px",
        "appearance modes": ", ".join(f"{a.n_modes} {name}" for name, a in appearances.items()),
        "methods": ", ".join(methods_of(model)),
        "quality, ellipses": describe_calibration(model),
        **({"variation": describe_variation(model)} if model.calibrated else {}),
        **more,
        "reference frame": f"{width}×{height} px, {model.n_pixels} inside the mesh",
        "levels": "blur " + ", ".join(f"{level.blur:g}" for level in model.levels) + " px, coarse to fine",
        "camera": f"response {response}, theta {theta:.1f}° ({error}){calibrated}",
        **model.card.stated,
        **describe_missing_in_card(model),
        "core": f"compiled, {_core.INSTRUCTION_SET}" if _core.BUILT else "not compiled (NumPy)",
    }


def describe_calibration(model: "AAM") -> str:
    """Return whether quality and ellipses are calibrated."""
    if model.calibrated:
        return "calibrated on left-out images"
    if model.failing_methods:
        return "not calibrated, since too few fits to left-out images were right: all fits are doubtful"
    return "not calibrated"


def describe_variation(model: "AAM") -> str:
    """Return what fits do so that their shapes vary as much as the objects do, by method."""
    lines = []
    for view in model.views.values():
        for name, reliability in view.reliabilities.items():
            prior = f"{name}: {reliability.final_prior:.0%} of the prior on the shape at the finest level"
            if reliability.expansion > 1.0:
                prior += f", shapes at {reliability.expansion:.2f} times their distance from the mean"
            lines.append(prior)
    return "; ".join(lines)


def describe_missing_in_card(model: "AAM") -> dict[str, str]:
    """Describe what the card of a model does not state as a label and a text; nothing if it states all."""
    if not model.card.missing:
        return {}
    return {"not stated": f"{', '.join(model.card.missing)} (add them with 'liaam card')"}


def describe_regressor(model: "AAM") -> str:
    """Return how well the regressor of a model finds the landmarks."""
    assert model.regressor is not None
    share = model.regressor.left_out.deviation / model.diagonal
    return f"fits start from landmarks by regression, which are off by {share:.1%} of the object's size"


def describe_refiner(model: "AAM") -> str:
    """Return what becomes of fits, and how well the refiner finds the landmarks by itself."""
    assert model.refiner is not None
    error = model.refiner.left_out.deviation / model.diagonal
    return (
        f"fits are moved {model.refiner.share:.0%} of the way to landmarks by regression from there, "
        f"which are off by {error:.1%} of the object's size"
    )


def describe_missing(model: "AAM") -> str:
    """Describe how often landmarks were missing in the training images, those that most images lacked first."""
    counts = model.n_all_missing
    n_images = model.n_all_images
    total = int(counts.sum())
    often = [int(i) for i in np.argsort(-counts, kind="stable") if counts[i]]
    most = often[0]
    named = [f"landmark {_label(model, most)} is missing in {counts[most]}"]
    named += [f"{_label(model, i)} in {counts[i]}" for i in often[1:MOST_NAMED]]
    others = len(often) - len(named)
    rest = f" and {others} more in at most {counts[often[MOST_NAMED]]}" if others else ""
    share = total / (model.n_points * n_images)
    return (
        f"{total} of {model.n_points * n_images} ({share:.0%}), estimated from the others. Of "
        f"{count_of(n_images, 'image')}, {', '.join(named)}{rest}"
    )


def _label(model: "AAM", i: int) -> str:
    """Return the number of a landmark from 1, and its name if it has one."""
    return f"{i + 1} ({model.landmark_names[i]})" if model.landmark_names else f"{i + 1}"


def facts_of(model: "AAM") -> dict[str, Any]:
    """Describe a model as JSON: its images, landmarks and methods.

    Of each landmark, ``missing`` is the number of training images in which it was missing.
    """
    from liaam.fitting.methods import methods_of

    names = model.landmark_names or (None,) * model.n_points
    return {
        "name": model.name,
        "images": model.n_all_images,
        "copies": model.n_copies,
        "images_by_shape": [part.n_images for part in model.parts],
        "sides": None if model.sides is None else vars(model.sides) | {"other": model.sides.other},
        "colour": model.is_colour,
        "landmarks": [
            {"number": i + 1, "name": name, "missing": int(missing)}
            for i, (name, missing) in enumerate(zip(names, model.n_all_missing, strict=True))
        ],
        "methods": list(methods_of(model)),
        "calibrated": model.calibrated,
        "card": model.card.stated,
    }


def describe_shapes(model: "AAM") -> str:
    """Describe the shapes of a model by their shares of the training images, the most frequent first."""
    parts = f"{len(model.parts)}, each with a model of its own"
    if model.same_images:
        return f"{parts}, from copies of the same images"
    shares = (f"{count_of(part.n_images, 'image')} ({part.n_images / model.n_all_images:.0%})" for part in model.parts)
    return f"{parts}: {', '.join(shares)}"


def count_copies(model: "AAM") -> str:
    """Describe the mirrored, relit or turned copies among the training images."""
    more = model.n_copies
    if not more:
        return ""
    if model.n_lamps:
        return f" and {more} copies in other light ({model.n_lamps} lamps)"
    return f" and {more} mirrored copies"
