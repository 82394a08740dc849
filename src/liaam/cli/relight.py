"""The command ``liaam relight``."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from liaam.cli.inputs import (
    LOW_SCORE,
    CameraOption,
    ResponseOption,
    camera_for,
    check_output,
    numbers_in,
    read_with_start,
    refuse_inputs,
)
from liaam.cli.terminal import complain, progress_bar, say
from liaam.errors import LiaamError

if TYPE_CHECKING:
    from liaam.fitting import FitResult, Fitter
    from liaam.relighting import Relighter


def relight(
    model_file: Annotated[Path, typer.Argument(metavar="MODEL", help="Model file of 'liaam train'.")],
    image: Annotated[Path, typer.Argument(metavar="IMAGE", help="Image to relight.")],
    flat: Annotated[
        bool, typer.Option("--flat", help="Show the object under the training light, without shading (default).")
    ] = False,
    light: Annotated[
        str | None,
        typer.Option(
            metavar="X,Y,Z",
            help="Show it under a lamp in this direction: x right, y down, z towards the viewer; 0,0,1 is frontal.",
        ),
    ] = None,
    like: Annotated[
        Path | None, typer.Option(metavar="OTHER", help="Show it under the light of another image of such an object.")
    ] = None,
    ambient: Annotated[
        float | None, typer.Option(help="With --light: fraction of ambient light, 0 to 1. By default 0.25.")
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="Image to write. By default IMAGE_flat.png or IMAGE_relit.png."),
    ] = None,
    init: Annotated[
        str | None,
        typer.Option(
            help="Where to start: a box x0,y0,x1,y1; a centre and the box's diagonal x,y,size; a landmark file; or a "
            "folder of them. By default the object is searched for."
        ),
    ] = None,
    like_init: Annotated[str | None, typer.Option("--like-init", help="As --init, for OTHER.")] = None,
    method: Annotated[
        str, typer.Option("--method", "-m", help="Fitting method: soft-li, or one on log-RGB such as li.")
    ] = "soft-li",
    camera_file: CameraOption = None,
    response: ResponseOption = None,
) -> None:
    """Show the object in an image under the training light, a lamp, or the light of another image."""
    direction = check_lights(flat, light, like, ambient, like_init)
    output = output or Path(f"{image.stem}_{'relit' if light or like else 'flat'}.png")
    check_image_name(output)
    refuse_inputs([output], [path for path in (image, like) if path is not None])

    from liaam.fitting import Fitter
    from liaam.io import write_image
    from liaam.model import load_model
    from liaam.relighting.relighter import AMBIENT, check_ambient, unit_direction

    if direction is not None:
        unit_direction(direction)  # raise before any work
        check_ambient(AMBIENT if ambient is None else ambient)
    model = load_model(model_file)
    if not model.is_colour:
        raise LiaamError(
            f"{model_file}: the model was trained on grey images, and estimating shading needs colour; train on colour "
            "images"
        )
    camera = camera_for([path for path in (image, like) if path is not None], camera_file, response, model.camera)
    fitter = Fitter(model, method, camera=camera)
    with progress_bar() as progress:
        progress(0, 2, image.name)
        relighter, result = fit_relighter(fitter, image, init)
        results = {image.name: result}
        if like is not None:
            progress(1, 2, like.name)
            other, results[like.name] = fit_relighter(fitter, like, like_init)
            picture = relighter.like(other)
        elif direction is not None:
            picture = relighter.under(direction, AMBIENT if ambient is None else ambient)
        else:
            picture = relighter.flat()
        write_image(output, picture)
    say(f"written to {output}")
    if report(results):
        raise typer.Exit(1)


def check_lights(
    flat: bool, light: str | None, like: Path | None, ambient: float | None, like_init: str | None
) -> "tuple[float, ...] | None":
    """Return the direction of the lamp, if any. Raise if options contradict each other."""
    given = [name for name, is_given in (("--flat", flat), ("--light", light), ("--like", like)) if is_given]
    if len(given) > 1:
        raise LiaamError(f"{' and '.join(given)} cannot be combined; give one of them")
    if ambient is not None and light is None:
        raise LiaamError("--ambient needs a lamp; add its direction with --light, or leave --ambient out")
    if like_init is not None and like is None:
        raise LiaamError("--like-init needs --like OTHER; add it, or leave --like-init out")
    return None if light is None else tuple(numbers_in(light, 3, "--light"))


def check_image_name(output: Path) -> None:
    """Raise if a colour image cannot be written under a name."""
    from liaam.io import IMAGE_SUFFIXES

    check_output(output)
    if output.suffix.lower() not in IMAGE_SUFFIXES or output.suffix.lower() == ".pgm":  # grey only
        raise LiaamError(f"{output}: give the name of an image file, such as {output.stem}.png")


def fit_relighter(fitter: "Fitter", path: Path, init: str | None) -> "tuple[Relighter, FitResult]":
    """Fit an image and estimate its shading."""
    from liaam.relighting import Relighter

    pixels, start = read_with_start(path, init)
    result = fitter.fit(pixels, start, path.name)
    return Relighter.of(fitter, pixels, result, name=str(path)), result


def report(results: "dict[str, FitResult]") -> bool:
    """Warn about fits that may be wrong. Return whether any failed."""
    import numpy as np

    for name, result in results.items():
        if not result.status.ok:
            complain(f"{name}: {result.status}: {result.message}")
        if result.place_doubtful:
            complain(f"{name}: {LOW_SCORE}")
        elif np.isnan(result.quality):
            place = "" if result.found is None else f", search score {result.found.score:.2f}"
            complain(f"{name}: quality unknown{place}: the model has no calibrated quality; check the result")
    return any(not result.status.ok for result in results.values())
