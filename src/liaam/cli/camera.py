"""The commands ``liaam camera ...`` that calibrate."""

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer

from liaam.cli import inputs
from liaam.cli.terminal import complain, progress_bar, say
from liaam.errors import CameraError, ImageError
from liaam.fitting.search.starts import read_with_start
from liaam.io import read_image
from liaam.io.atomic import check_output

if TYPE_CHECKING:
    from liaam.calibration import AngleEstimate
    from liaam.photometry import CameraModel, Response

group = typer.Typer(
    help="Calibrate a camera (its angle theta, response, vignetting and noise), and use it: invariant images, and "
    "images of one scene aligned. Calibrations add to one camera file, for --camera of train and fit, and write an "
    "image to check it.",
    no_args_is_help=True,
)

Pictures = Annotated[list[Path], typer.Argument(metavar="IMAGE...", readable=False, help="Images of one camera.")]
Output = Annotated[
    Path,
    typer.Option(
        "--output", "-o", help="Camera file to write. If it exists, its other values are used, and kept in the file."
    ),
]
FreeBalance = Annotated[
    bool,
    typer.Option(
        "--free-balance", help="The images differ in white balance: use only changes that vary across the image."
    ),
]
CAMERA_FILE = Path("camera.json")

FAR = 0.04  # Movement, as a fraction of the image size, above which to warn that the scene may not be flat


@group.command()
def spectral(
    sensors: Annotated[
        str,
        typer.Argument(
            metavar="PEAKS|FILE",
            help="Peak wavelengths of the red, green and blue sensors in nm, such as 610,540,450; or a CSV file of "
            "sensitivities, with columns wavelength_nm, R, G, B.",
        ),
    ],
    output: Output = CAMERA_FILE,
) -> None:
    """Compute the angle from peak wavelengths (Wien's approximation) or sensitivities of the sensors."""
    from liaam.calibration import read_sensitivities, theta_from_peaks, theta_from_sensitivities

    check_camera_output(output)
    if inputs.names_file(sensors, (".csv",)):
        estimate = theta_from_sensitivities(*read_sensitivities(Path(sensors)))
        source = f"sensitivities of {sensors}"
    else:
        red, green, blue = inputs.numbers_in(sensors, 3, "peak wavelengths").tolist()
        estimate = theta_from_peaks((red, green, blue))
        source = f"peaks at {sensors} nm"
    finish_angle(estimate, camera_in_file([], output), f"spectral, {source}", output)


@group.command()
def scene(
    images: Pictures,
    output: Output = CAMERA_FILE,
    free_balance: FreeBalance = False,
) -> None:
    """Estimate the angle from two or more images of one scene under lights of different colour."""
    from liaam.calibration import STILL, align_pictures, theta_from_scene

    camera, pictures = read_pictures(images, output, at_least=2)
    with progress_bar() as progress:
        aligned = align_pictures(pictures, camera, names=[p.name for p in images], progress=progress)
    pictures = list(aligned.pictures)
    moved = max(aligned.moved)
    say(f"aligned: the corners moved by up to {moved:.1f} pixels" if moved > STILL else "the images are aligned")
    if moved > FAR * max(pictures[0].shape[:2]):
        complain("large movement: a homography fits only flat or distant scenes; check the written image")
    with progress_bar() as progress:
        progress(0, 1, "estimating the angle")
        estimate = theta_from_scene(pictures, camera, free_balance=free_balance, masks=aligned.masks)
    camera = finish_angle(estimate, camera, f"scene, {inputs.names_of(images)}", output)
    write_check(output, pictures, images, camera)


@group.command()
def chart(
    images: Pictures,
    patches: Annotated[
        list[str],
        typer.Option(
            help="Where the patches are: centres of the four corner patches of a chart of 4 by 6, clockwise from the "
            "first patch, x0,y0,x1,y1,x2,y2,x3,y3; or a CSV file with a row x0,y0,x1,y1 per patch. Give it once for "
            "all images, or once per image in the same order."
        ),
    ],
    output: Output = CAMERA_FILE,
    free_balance: FreeBalance = False,
) -> None:
    """Estimate the angle from images of a colour chart under lights of different colour, without alignment."""
    from liaam.calibration import theta_from_chart

    quads = [patches_in(text) for text in patches]
    camera, pictures = read_pictures(images, output, at_least=2)
    if len(quads) not in (1, len(images)):
        raise CameraError(f"{len(quads)} charts for {len(images)} images: give one for all, or one per image")
    quads = quads * len(images) if len(quads) == 1 else quads
    estimate = theta_from_chart(pictures, quads, camera, free_balance=free_balance)
    camera = finish_angle(estimate, camera, f"chart, {inputs.names_of(images)}", output)
    write_check(output, pictures, images, camera, quads)


@group.command()
def image(
    picture: Annotated[Path, typer.Argument(metavar="IMAGE", help="Image with shadows.")],
    output: Output = CAMERA_FILE,
) -> None:
    """Estimate the angle from one image with shadows, by entropy minimisation. A last resort, often unreliable."""
    from liaam.calibration import theta_from_image

    camera, (pixels,) = read_pictures([picture], output)
    estimate = theta_from_image(pixels, camera.response)
    camera = finish_angle(estimate, camera, f"image, {picture.name}", output)
    write_check(output, [pixels], [picture], camera)


@group.command()
def faces(
    model_file: inputs.ModelFile,
    images: Pictures,
    init: Annotated[str, typer.Option(help="Where to start; see 'liaam fit'.")],
    method: Annotated[
        str,
        typer.Option(
            "--method", "-m", help="li-pcs: the model's camera took the images; li-pc: another camera took them."
        ),
    ] = "li-pcs",
    output: Output = CAMERA_FILE,
) -> None:
    """Estimate the angle from fits of a model to many images under lights other than the training light."""
    from liaam.calibration import theta_from_fits
    from liaam.fitting import Fitter
    from liaam.model import load_model

    check_camera_output(output)
    if not method.startswith("li-pc"):
        raise CameraError(f"--method {method} does not estimate the camera angle; use li-pcs or li-pc")
    model = load_model(model_file)
    # With li-pc, the vignetting and noise of the model's camera do not apply.
    camera = camera_in_file(images, output, model.camera if method.startswith("li-pcs") else None)
    fitter = Fitter(model, method, camera=camera)
    results = []
    with progress_bar() as progress:
        for i, path in enumerate(images):
            progress(i, len(images), path.name)
            results.append(fitter.fit(*read_with_start(path, init), path.name))
    finish_angle(theta_from_fits(results), camera, f"faces, {len(images)} fits with {method}", output)


@group.command("response")
def response_command(
    images: Annotated[
        list[Path],
        typer.Argument(
            metavar="IMAGE...|RESPONSE", readable=False, help="Images, or a known response: srgb, linear, or a gamma."
        ),
    ],
    exposures: Annotated[
        str | None, typer.Option(help="Relative exposures of the images, such as 1,2,4 (from the shutter times).")
    ] = None,
    vignetting: Annotated[
        bool, typer.Option("--vignetting", help="Also estimate vignetting. The images must overlap but not coincide.")
    ] = False,
    output: Output = CAMERA_FILE,
) -> None:
    """Estimate the response (and vignetting, with --vignetting) from images of one scene at different exposures.

    A known response is written to the camera file, for calibrations that follow: liaam camera response linear.
    """
    from liaam.calibration import align_pictures, calibrate_response
    from liaam.photometry import parse_response
    from liaam.plotting import save_figure
    from liaam.plotting.photometry import figure_of_response

    check_camera_output(output, images)
    if len(images) == 1 and not images[0].exists():
        try:
            response = parse_response(str(images[0]))
        except ImageError:
            needed = "give two images or more, or srgb, linear, or a gamma"
            raise CameraError(f"{images[0]}: this is neither an image nor a response; {needed}") from None
        camera = with_response(camera_in_file([], output), response)
        write_camera(camera, output, f"response {images[0]}, as given")
        return
    camera, pictures = read_pictures(images, output, at_least=2)
    ratios = None if exposures is None else inputs.numbers_in(exposures, len(images), "--exposures").tolist()
    with progress_bar() as progress:
        maps = align_pictures(pictures, camera, names=[p.name for p in images], progress=progress).homographies
    estimate = calibrate_response(pictures, exposures=ratios, homographies=maps, vignetting=vignetting)
    say(estimate.message)
    if not estimate.observable:
        raise CameraError("nothing was written: these images do not determine the response")
    lens = estimate.vignetting
    if vignetting:
        say(lens.message)
    coefficients = lens.coefficients if lens.observable else camera.vignetting
    camera = with_response(replace(camera, vignetting=coefficients), estimate.response)
    write_camera(camera, output, f"response, {inputs.names_of(images)}: {estimate.message}")
    save_figure(figure_of_response(camera), check_picture(output))
    say(f"{check_picture(output)}: the response beside sRGB, for checking")


def with_response(camera: "CameraModel", response: "Response") -> "CameraModel":
    """Return a camera with another response, without what was estimated with the response before."""
    if response != camera.response and (camera.theta_deviation is not None or camera.noise is not None):
        say("the angle and noise in the file were estimated with another response: estimate them again")
        camera = replace(camera, theta_deviation=None, noise=None)
    return replace(camera, response=response)


@group.command("vignetting")
def vignetting_command(
    picture: Annotated[Path, typer.Argument(metavar="IMAGE", help="Image of an evenly lit, plain surface.")],
    output: Output = CAMERA_FILE,
) -> None:
    """Estimate vignetting from one image of an evenly lit white wall or paper."""
    from liaam.calibration import vignetting_from_flat_field

    camera, (pixels,) = read_pictures([picture], output)
    estimate = vignetting_from_flat_field(pixels, camera.response)
    say(estimate.message)
    if not estimate.observable:
        raise CameraError("nothing was written: this image does not determine the vignetting")
    camera = replace(camera, vignetting=estimate.coefficients)
    write_camera(camera, output, f"vignetting, {picture.name}: {estimate.message}")


@group.command("noise")
def noise_command(
    images: Pictures,
    flat: Annotated[
        list[str] | None, typer.Option(help="Box x0,y0,x1,y1 around a plain, evenly lit surface; may be repeated.")
    ] = None,
    output: Output = CAMERA_FILE,
) -> None:
    """Estimate noise from plain surfaces (--flat), two images of one scene under one light, or one image."""
    from liaam.calibration import noise_from_flat, noise_from_image, noise_from_pair

    camera, pictures = read_pictures(images, output)
    if flat:
        boxes = np.rint([inputs.numbers_in(text, 4, "--flat") for text in flat]).astype(int)
        estimate = noise_from_flat(pictures, boxes, camera.response)
    elif len(pictures) == 2:
        estimate = noise_from_pair(pictures[0], pictures[1], camera.response)
    elif len(pictures) == 1:
        estimate = noise_from_image(pictures[0], camera.response)
    else:
        raise CameraError(f"{len(pictures)} images without --flat: give two of one scene under one light, or one")
    say(estimate.message)
    if not estimate.observable:
        raise CameraError("nothing was written: these images do not determine the noise")
    write_camera(replace(camera, noise=estimate.noise), output, f"noise, {inputs.names_of(images)}: {estimate.message}")


def read_pictures(paths: Sequence[Path], output: Path, at_least: int = 1) -> tuple["CameraModel", list[np.ndarray]]:
    """Check the output, read images, and what the camera file to write knows already."""
    check_camera_output(output, paths)
    if len(paths) < at_least:
        raise CameraError(f"too few images ({len(paths)}): give {at_least} or more, under different lights")
    return camera_in_file(paths, output), [read_image(path) for path in paths]


def camera_in_file(paths: Sequence[Path], output: Path, otherwise: "CameraModel | None" = None) -> "CameraModel":
    """Return the camera of a file that a calibration adds to or, if there is no such file yet, another or a new one."""
    return inputs.camera_for(paths, str(output) if output.exists() else None, otherwise)


def check_camera_output(output: Path, read: Sequence[Path] = ()) -> None:
    """Raise, before any work, if a camera file cannot be written. An existing one is checked when it is read."""
    check_output(output)
    if output.suffix.lower() != ".json":
        raise CameraError(f"{output}: a camera file ends in .json, such as camera.json")
    inputs.refuse_inputs([check_picture(output)], read)


def check_picture(output: Path) -> Path:
    """Return the path of the check image beside a camera file."""
    return output.with_name(f"{output.stem}_check.png")


def patches_in(text: str) -> np.ndarray:
    """Return the boxes of a chart's patches, (n, 4) float64, from the centres of its corner patches or from a file."""
    from liaam.calibration.chart import chart_patches
    from liaam.calibration.columns import read_columns

    if inputs.names_file(text, (".csv",)):
        return read_columns(text, "patch file", ("x0", "y0", "x1", "y1"))
    return chart_patches(inputs.numbers_in(text, 8, "--patches").reshape(4, 2))


def finish_angle(estimate: "AngleEstimate", camera: "CameraModel", source: str, output: Path) -> "CameraModel":
    """Print the estimate and write the camera. Raise if the angle is not observable."""
    if not estimate.observable:
        raise CameraError(f"nothing was written: {estimate.message}")
    if not estimate.physical:
        raise CameraError(
            f"nothing was written: theta {degrees(estimate.theta)} ± {degrees(estimate.standard_error)}; "
            f"{estimate.message}"
        )
    low, high = estimate.interval
    say(f"theta {degrees(estimate.theta)} ± {degrees(estimate.standard_error, 2)}")
    say(f"95 % interval {degrees(low)} to {degrees(high)}; {estimate.message}")
    camera = replace(camera, theta=estimate.theta, theta_deviation=estimate.standard_error)
    return write_camera(camera, output, f"theta from {source}: {estimate.message}")


def write_camera(camera: "CameraModel", output: Path, sentence: str) -> "CameraModel":
    """Add a sentence to the camera's history and write it."""
    camera = replace(camera, history=(*camera.history, sentence))
    done = "added" if output.exists() else "written"
    camera.save(output)
    say(f"{done} to {output}")
    return camera


def write_check(
    output: Path,
    pictures: Sequence[np.ndarray],
    paths: Sequence[Path],
    camera: "CameraModel",
    patches: Sequence[np.ndarray] | None = None,
) -> None:
    """Write a figure of the images beside their invariant images, to check that the light is removed."""
    from liaam.photometry import invariant_image
    from liaam.plotting import save_figure
    from liaam.plotting.photometry import figure_of_invariants

    names = inputs.unique_stems(list(paths[:6]))
    figure = figure_of_invariants(
        {n: (p, invariant_image(p, camera, name=n)) for n, p in zip(names, pictures[:6], strict=True)},
        None if patches is None else patches[:6],
    )
    path = check_picture(output)
    save_figure(figure, path)
    say(f"{path}: the images and their invariant images, which should look alike")


def degrees(angle: float, digits: int = 1) -> str:
    """Format an angle, given in radians, in degrees."""
    return f"{math.degrees(angle):.{digits}f}°"
