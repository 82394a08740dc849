"""The command ``liaam relight``."""

from collections import defaultdict
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
import typer

from liaam.cli import inputs
from liaam.cli.terminal import complain, progress_bar, say
from liaam.errors import CameraError, ImageError, LiaamError
from liaam.fitting.search.starts import read_with_start
from liaam.io import IMAGE_SUFFIXES, make_folder, read_image, write_image
from liaam.io.atomic import check_output
from liaam.io.files import existing_file
from liaam.io.images import PICTURE_SUFFIXES, UNREAD_SUFFIXES

if TYPE_CHECKING:
    from liaam.fitting import FitResult, Fitter
    from liaam.relighting import Lamp, Relighter

FLAT = "flat"  # Value of --light for the training light
OWN: Literal["own"] = "own"  # that for the light of the image, of which only the colour is corrected
ENDINGS = {FLAT: "flat", OWN: "balanced"}  # of the names of images; of others "relit"


def relight(
    files: inputs.ModelAndImages,
    light: Annotated[
        str,
        typer.Option(
            metavar="flat|own|left|right|above|below|front|X,Y,Z|IMAGE",
            help="Light to show the objects under: flat, that of the training images, without shading; own, that of "
            "the image, with its colour corrected; a lamp from the left, right, above, below or front, or in direction "
            "x,y,z (right, down, towards the viewer), such as -1,-0.5,0.5; or that of another image of such an object.",
        ),
    ] = FLAT,
    strength: Annotated[
        float, typer.Option(help="Share of the change of light, from 0 for the image as it is to 1.")
    ] = 1.0,
    ambient: Annotated[
        float | None,
        typer.Option(help="Light from all around with a lamp, as a fraction of all light, 0 to 1. By default 0.25."),
    ] = None,
    colour: Annotated[
        str, typer.Option(metavar="R,G,B", help="Colour of the lamp: linear red, green and blue, 0 to 1.")
    ] = "1,1,1",
    balance: Annotated[
        bool,
        typer.Option(
            "--balance/--no-balance",
            help="Correct the colour of the light in the whole image, if it is clearly orange, blue, green or so. "
            "--no-balance keeps it, on the object as well.",
        ),
    ] = True,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            help="Image to write, or folder for several images. By default IMAGE_flat.png, IMAGE_balanced.png "
            "or IMAGE_relit.png here.",
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
    wanted = light_of(light, colour)
    if wanted == OWN and not balance:
        raise LiaamError("--light own corrects the colour of the light, which --no-balance keeps: give one of them")
    like = wanted if isinstance(wanted, Path) else None
    outputs = output_paths(images, output, ENDINGS.get(light, "relit"))
    maps = [map_of(path) for path in outputs] if certainty else []
    images_read = images if like is None else [*images, like]
    inputs.refuse_inputs([*outputs, *maps], images_read)

    from liaam.fitting import Fitter
    from liaam.model import load_model
    from liaam.relighting.appearance import check_colour
    from liaam.relighting.lamp import AMBIENT, check_ambient, check_strength
    from liaam.relighting.relighter import separated

    ambient = AMBIENT if ambient is None else ambient
    check_ambient(ambient)
    check_strength(strength)
    model = load_model(model_file)
    check_colour(model, str(model_file))
    fitter = Fitter(model, method, camera=inputs.camera_for(images_read, given_camera, model.camera))
    make_folder(outputs[0].parent)
    report = RelightReport(strict)
    n_images = len(images_read)
    n_done = 0
    other = None
    with progress_bar() as progress:
        if like is not None:
            progress(n_done, n_images, like.name)
            other, result = separated(fitter, read_image(like), None, str(like))
            report.add_fit(like, result, "its light was used although the fit may be wrong")
            n_done = 1
        change = Change(other if isinstance(wanted, Path) else wanted, ambient, strength, balance, init, certainty)
        for image, path in zip(images, outputs, strict=True):
            progress(n_done, n_images, image.name)
            n_done += 1
            try:
                relight_file(fitter, image, path, change, report)
            except LiaamError as error:
                report.add_error(error)
        progress(n_images, n_images, images[-1].name)
    report.show(output)
    if report.failed:
        raise typer.Exit(1)


@dataclass(frozen=True)
class Change:
    """How every image is relit.

    Attributes
    ----------
    light : list of Lamp, Relighter or "own", optional
        Lamps, the image whose light is used, or the image's own light of corrected colour. By default that of training.
    ambient : float
        Fraction of ambient light beside lamps.
    strength : float
        Share of the change of light.
    balance : bool
        Whether the colour of the light is corrected in the whole image.
    init : str, optional
        Start of the fits, as in the command.
    certainty : bool
        Whether to write a map of how well the light is known.
    """

    light: "list[Lamp] | Relighter | Literal['own'] | None"
    ambient: float
    strength: float
    balance: bool
    init: str | None
    certainty: bool


@dataclass
class RelightReport:
    """What the command prints: the written files, and advice with the names of the images concerned."""

    strict: bool  # whether nothing is written where the fit is doubtful or the light is uncertain
    written: list[Path] = field(default_factory=list)
    advice: defaultdict[str, list[str]] = field(default_factory=lambda: defaultdict(list))
    failed: bool = False  # whether the command ends with an exit status that is not 0

    def add_error(self, error: LiaamError) -> None:
        """Print why an image could not be relit."""
        complain(f"error: {error}")
        self.failed = True

    def add_fit(self, image: Path, result: "FitResult", action: str) -> None:
        """Add what may be wrong with a fit, and what was done with it."""
        if not result.status.ok:
            self.failed = True
            self.advice[f"{result.status}: {result.message.rstrip('.')}; {action}"].append(image.name)
        if result.detection_doubtful and not result.status.unusable:
            self.advice[inputs.LOW_SCORE].append(image.name)
        elif np.isnan(result.quality) and result.status.ok:
            self.advice["quality unknown: the model has no calibrated quality; check the result"].append(image.name)

    def add_uncertainty(self, image: Path, text: str) -> None:
        """Add that the light of an image is uncertain."""
        self.advice[text].append(image.name)
        if self.strict:
            self.failed = True

    def add_colour(self, image: Path, relighter: "Relighter", change: Change) -> None:
        """Add that the light of an image has another colour than that of training, and what was done about it."""
        if relighter.colour.is_found:
            done = "corrected in the whole image" if change.balance else "kept"
            self.advice[f"the light is {relighter.colour}: {done}"].append(image.name)
        elif change.light == OWN:
            self.advice["the light has no clear colour, so the image was written as it is"].append(image.name)

    def show(self, output: Path | None) -> None:
        """Print where the results are, and the advice."""
        if self.written:
            say(f"written to {output or inputs.names_of(self.written)}")
        inputs.say_advice(self.advice)


def relight_file(fitter: "Fitter", image: Path, path: Path, change: Change, report: RelightReport) -> None:
    """Fit an image file, and write it to a path in another light."""
    from liaam.relighting.relighter import UNCERTAIN, separated, shown, uncertainty_of

    pixels, start = read_with_start(image, change.init)
    relighter, result = separated(fitter, pixels, start, str(image))
    is_uncertain = relighter.certain < UNCERTAIN
    if report.strict and (is_uncertain or not result.status.ok):
        action = "nothing was written"
    else:
        action = "the image was relit all the same: check it"
        write_image(path, shown(relighter, change.light, change.ambient, change.strength, change.balance))
        report.add_colour(image, relighter, change)
        report.written.append(path)
        if change.certainty:
            write_image(map_of(path), picture_of_certainty(relighter))
            report.written.append(map_of(path))
    report.add_fit(image, result, action)
    if is_uncertain and result.status.ok:
        report.add_uncertainty(image, uncertainty_of(relighter))


def picture_of_certainty(relighter: "Relighter") -> np.ndarray:
    """Draw how well the light is known, (h, w, 3) uint8: black 0 and outside the mesh, white 1."""
    certainty = np.nan_to_num(relighter.certainty())
    grey = np.rint(255 * certainty).astype(np.uint8)
    return grey[..., None].repeat(3, axis=2)


def light_of(text: str, colour: str) -> "list[Lamp] | Path | Literal['own'] | None":
    """Return the lamp that ``--light`` and its colour mean, or the image whose light is meant; None for training's."""
    from liaam.relighting.lamp import DIRECTIONS, Lamp

    if text == FLAT:
        return None
    if text == OWN:
        return OWN
    if text in DIRECTIONS:
        return [Lamp(DIRECTIONS[text], _colour_of(colour))]
    if inputs.names_file(text, (*PICTURE_SUFFIXES, *UNREAD_SUFFIXES)):
        return existing_file(text, ImageError, "image")
    try:
        direction = tuple(inputs.numbers_in(text, 3, "--light"))
    except CameraError:
        raise LiaamError(
            f"--light {text}: give flat, own, the direction of a lamp as x,y,z, such as -1,0,1, or its name "
            f"({', '.join(DIRECTIONS)}), or an image under that light"
        ) from None
    return [Lamp(direction, _colour_of(colour))]


def _colour_of(text: str) -> tuple[float, ...]:
    """Return the red, green and blue of a lamp."""
    try:
        return tuple(inputs.numbers_in(text, 3, "--colour"))
    except CameraError:
        raise LiaamError(f"--colour {text}: give red, green and blue from 0 to 1, such as 1,0.7,0.4") from None


def output_paths(images: list[Path], output: Path | None, ending: str) -> list[Path]:
    """Return the path to write for each image. Raise if one cannot be written."""
    if output is not None and len(images) == 1 and not output.is_dir():
        check_output(output)
        suffix = output.suffix.lower()
        if suffix not in IMAGE_SUFFIXES or suffix == ".pgm":  # which is grey only
            raise LiaamError(f"{output}: give the name of an image file, such as {output.stem}.png")
        return [output]
    folder = Path() if output is None else output
    if not folder.is_dir() and (folder.exists() or folder.suffix.lower() in IMAGE_SUFFIXES):
        raise LiaamError(f"{folder} is not a folder; for several images, give a folder with -o")
    return [folder / f"{stem}_{ending}.png" for stem in inputs.unique_stems(images)]


def map_of(path: Path) -> Path:
    """Return the path of the map of certainty of an image to write."""
    return path.with_name(f"{path.stem}_certainty.png")
