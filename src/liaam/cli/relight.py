"""The command ``liaam relight``."""

from collections import defaultdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer

from liaam.cli import inputs
from liaam.cli.terminal import complain, progress_bar, say
from liaam.errors import CameraError, ImageError, LiaamError
from liaam.io import IMAGE_SUFFIXES, make_folder, read_image, write_image
from liaam.io.atomic import check_output
from liaam.io.files import existing_file
from liaam.io.images import PICTURE_SUFFIXES, UNREAD_SUFFIXES

if TYPE_CHECKING:
    from liaam.fitting import FitResult

FLAT = "flat"  # Value of --light for the training light, and the ending of such images' names


def relight(
    files: inputs.ModelAndImages,
    light: Annotated[
        str,
        typer.Option(
            metavar="flat|X,Y,Z|IMAGE",
            help="Light to show the objects under: flat, that of the training images, without shading; a lamp in "
            "direction x,y,z (right, down, towards the viewer), such as -1,0,1 for one from the left; or that of "
            "another image of such an object.",
        ),
    ] = FLAT,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            help="Image to write, or folder for several images. By default IMAGE_flat.png or IMAGE_relit.png here.",
        ),
    ] = None,
    init: Annotated[
        str | None,
        typer.Option(
            help="Where to start: a box x0,y0,x1,y1; a centre and the box's diagonal x,y,size; a landmark file; or a "
            "folder of them. By default the object is searched for."
        ),
    ] = None,
    method: Annotated[
        str, typer.Option("--method", "-m", help="Fitting method: soft-li, or one on log-RGB such as li.")
    ] = "soft-li",
    certainty: Annotated[
        bool,
        typer.Option(
            "--certainty", help="Also write NAME_certainty.png: how well the light is known, black 0, white 1."
        ),
    ] = False,
    strict: Annotated[
        bool, typer.Option("--strict", help="Write nothing where the fit is doubtful or the light is uncertain.")
    ] = False,
    given_camera: inputs.CameraOption = None,
) -> None:
    """Show the objects in images under the training light, a lamp, or the light of another image."""
    model_file, images = inputs.model_and_inputs(files, "relight")
    direction, like = light_of(light)
    outputs = output_paths(images, output, FLAT if light == FLAT else "relit")
    maps = [map_of(path) for path in outputs] if certainty else []
    read = [*images, *([] if like is None else [like])]
    inputs.refuse_inputs([*outputs, *maps], read)

    from liaam.fitting import Fitter
    from liaam.model import load_model
    from liaam.relighting import Lamp
    from liaam.relighting.appearance import check_colour
    from liaam.relighting.relighter import UNCERTAIN, separated, shown, uncertainty_of

    lamps = None if direction is None else [Lamp(direction)]  # raises before any work
    model = load_model(model_file)
    check_colour(model, str(model_file))
    fitter = Fitter(model, method, camera=inputs.camera_for(read, given_camera, model.camera))
    make_folder(outputs[0].parent)
    written, failed, other = [], False, None
    advice: defaultdict[str, list[str]] = defaultdict(list)
    with progress_bar() as progress:
        progress(0, len(read), read[-1].name)
        if like is not None:
            other, result = separated(fitter, read_image(like), None, str(like))
            failed = add_advice(advice, like, result, "its light was used although the fit may be wrong")
        for i, (image, path) in enumerate(zip(images, outputs, strict=True), len(read) - len(images)):
            progress(i, len(read), image.name)
            try:
                pixels, start = inputs.read_with_start(image, init)
                relighter, result = separated(fitter, pixels, start, str(image))
                uncertain = relighter.certain < UNCERTAIN
                written_here = not (strict and (uncertain or not result.status.ok))
                if written_here:
                    write_image(path, shown(relighter, lamps, other))
                    written.append(path)
                if written_here and certainty:
                    known = np.nan_to_num(relighter.certainty())
                    write_image(map_of(path), np.rint(255 * known).astype(np.uint8)[..., None].repeat(3, axis=2))
                    written.append(map_of(path))
            except LiaamError as error:
                complain(f"error: {error}")
                failed = True
                continue
            done = "the image was relit although the fit may be wrong" if written_here else "nothing was written"
            failed |= add_advice(advice, image, result, done)
            if uncertain and result.status.ok:
                advice[uncertainty_of(relighter)].append(image.name)
                failed |= strict
        progress(len(read), len(read), images[-1].name)
    if written:
        say(f"written to {output or inputs.names_of(written)}")
    inputs.say_advice(advice)
    if failed:
        raise typer.Exit(1)


def light_of(text: str) -> tuple[tuple[float, ...] | None, Path | None]:
    """Return the direction of the lamp, or the image whose light is meant; neither for the training light."""
    if text == FLAT:
        return None, None
    if inputs.names_file(text, (*PICTURE_SUFFIXES, *UNREAD_SUFFIXES)):
        return None, existing_file(text, ImageError, "image")
    try:
        return tuple(inputs.numbers_in(text, 3, "--light")), None
    except CameraError:
        raise LiaamError(
            f"--light {text}: give flat, the direction of a lamp as x,y,z, such as -1,0,1, or an image under that light"
        ) from None


def output_paths(images: list[Path], output: Path | None, ending: str) -> list[Path]:
    """Return the path to write for each image. Raise if one cannot be written."""
    folder = Path() if output is None else output
    if output is not None and len(images) == 1 and not output.is_dir():
        check_output(output)
        if output.suffix.lower() not in IMAGE_SUFFIXES or output.suffix.lower() == ".pgm":  # grey only
            raise LiaamError(f"{output}: give the name of an image file, such as {output.stem}.png")
        return [output]
    if not folder.is_dir() and (folder.exists() or folder.suffix.lower() in IMAGE_SUFFIXES):
        raise LiaamError(f"{folder} is not a folder; for several images, give a folder with -o")
    return [folder / f"{stem}_{ending}.png" for stem in inputs.unique_stems(images)]


def map_of(path: Path) -> Path:
    """Return the path of the map of certainty of an image to write."""
    return path.with_name(f"{path.stem}_certainty.png")


def add_advice(advice: defaultdict[str, list[str]], image: Path, result: "FitResult", what: str) -> bool:
    """Add what may be wrong with a fit, and what was done with it. Return whether it failed."""
    if not result.status.ok:
        text = f"{result.status}: {result.message.rstrip('.')}; {what}"
        advice[text].append(image.name)
    if result.detection_doubtful and not result.status.unusable:
        advice[inputs.LOW_SCORE].append(image.name)
    elif np.isnan(result.quality) and result.status.ok:
        advice["quality unknown: the model has no calibrated quality; check the result"].append(image.name)
    return not result.status.ok
