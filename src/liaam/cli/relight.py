"""The command for relighting: thin. Everything it does is a call that Python users have too."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from liaam.cli.inputs import DOUBT, camera_for, check_output, numbers_in, read_init, refuse_inputs
from liaam.cli.terminal import complain, progress_bar, say
from liaam.errors import LiaamError

if TYPE_CHECKING:
    from liaam.fitting import FitResult, Fitter
    from liaam.relighting import Relighter


def relight(
    model_file: Annotated[Path, typer.Argument(metavar="MODEL", help="Model file of 'liaam train'.")],
    image: Annotated[Path, typer.Argument(metavar="IMAGE", help="Picture to relight.")],
    flat: Annotated[
        bool, typer.Option("--flat", help="Under the light of training, without shading; so if no light is given.")
    ] = False,
    light: Annotated[
        str | None,
        typer.Option(
            metavar="X,Y,Z",
            help="Under a lamp in this direction: x to the right, y down, z to the viewer; 0,0,1 is in front.",
        ),
    ] = None,
    like: Annotated[
        Path | None, typer.Option(metavar="OTHER", help="Under the light of another picture of such an object.")
    ] = None,
    ambient: Annotated[
        float | None, typer.Option(help="With --light: share of light from everywhere, 0 to 1 (0.25 if left out).")
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="Picture to write; IMAGE_flat.png or IMAGE_relit.png if left out."),
    ] = None,
    init: Annotated[
        str | None,
        typer.Option(
            help="Where the object is: a box x0,y0,x1,y1, a centre and the box's diagonal x,y,size, a landmark file, "
            "or a folder of them. Searched for if left out."
        ),
    ] = None,
    like_init: Annotated[str | None, typer.Option("--like-init", help="Where it is in OTHER; as --init.")] = None,
    method: Annotated[
        str, typer.Option("--method", "-m", help="How to fit: soft-li, or one that fits log-RGB, such as li.")
    ] = "soft-li",
    camera_file: Annotated[
        Path | None,
        typer.Option("--camera", help="Camera file of these pictures' camera, if not the training camera's."),
    ] = None,
    response: Annotated[
        str | None, typer.Option(help="Response of these pictures' camera, if not the training camera's.")
    ] = None,
) -> None:
    """Show the object of a picture under the light of training, under a lamp, or under another picture's light."""
    direction = check_lights(flat, light, like, ambient, like_init)
    output = output or Path(f"{image.stem}_{'relit' if light or like else 'flat'}.png")
    check_picture_name(output)
    refuse_inputs([output], [path for path in (image, like) if path is not None])

    from liaam.fitting import Fitter
    from liaam.io import write_image
    from liaam.model import load_model
    from liaam.relighting.relighter import AMBIENT, check_ambient, unit_direction

    if direction is not None:
        unit_direction(direction)  # it may refuse: before the work
        check_ambient(AMBIENT if ambient is None else ambient)
    model = load_model(model_file)
    if not model.is_colour:
        raise LiaamError(
            f"{model_file}: the model is of grey pictures, and shading is told by colours; train on colour pictures"
        )
    camera = camera_for([path for path in (image, like) if path is not None], camera_file, response, model.camera)
    fitter = Fitter(model, method, camera=camera)
    with progress_bar() as tell:
        tell(0, 2, image.name)
        relighter, result = taken_apart(fitter, image, init)
        results = {image.name: result}
        if like is not None:
            tell(1, 2, like.name)
            other, results[like.name] = taken_apart(fitter, like, like_init)
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
    """Complain about several lights at once and about options of another; gives the lamp's direction, if any."""
    given = [name for name, is_given in (("--flat", flat), ("--light", light), ("--like", like)) if is_given]
    if len(given) > 1:
        raise LiaamError(f"{' and '.join(given)} are different lights; give one of them")
    if ambient is not None and light is None:
        raise LiaamError("--ambient goes with a lamp; add its direction with --light, or leave --ambient out")
    if like_init is not None and like is None:
        raise LiaamError("--like-init says where the object is in the picture of --like; add that, or leave it out")
    return None if light is None else tuple(numbers_in(light, 3, "--light"))


def check_picture_name(output: Path) -> None:
    """Complain about a name that no picture can have."""
    from liaam.io import IMAGE_SUFFIXES

    check_output(output)
    if output.suffix.lower() not in IMAGE_SUFFIXES or output.suffix.lower() == ".pgm":  # that is grey
        raise LiaamError(f"{output}: give the name of a picture, such as {output.stem}.png")


def taken_apart(fitter: "Fitter", path: Path, init: str | None) -> "tuple[Relighter, FitResult]":
    """Fit a picture, and take its light off."""
    from liaam.io import read_image
    from liaam.relighting import Relighter

    pixels = read_image(path)
    start = None if init is None else read_init(init, path, pixels.shape[1::-1])
    result = fitter.fit(pixels, start, path.name)
    return Relighter.of(fitter, pixels, result, name=str(path)), result


def report(results: "dict[str, FitResult]") -> bool:
    """Say which fits may be wrong; gives whether one is."""
    import numpy as np

    for name, result in results.items():
        if not result.status.ok:
            complain(f"{name}: {result.status}: {result.message}")
        if result.place_doubtful:
            complain(f"{name}: {DOUBT}")
        elif np.isnan(result.quality):
            place = "" if result.found is None else f", the search's score {result.found.score:.2f}"
            complain(f"{name}: quality unknown{place}: the model was trained without leaving pictures out; look at it")
    return any(not result.status.ok for result in results.values())
