"""The commands ``liaam camera ...``: calibrations, invariant images and registration."""

import json
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer

from liaam.cli.inputs import ModelFile, camera_for, names_of, numbers_in, read_with_start, refuse_inputs, unique_stems
from liaam.cli.terminal import complain, progress_bar, say, show_table, table_of
from liaam.errors import CameraError, LiaamError
from liaam.io import atomic_path, make_folder, read_image, write_image, write_text_atomically
from liaam.io.atomic import check_output
from liaam.io.files import existing_file, is_number, read_bytes, real_path

if TYPE_CHECKING:
    from liaam.calibration import AngleEstimate, Averaged, VignettingEstimate
    from liaam.photometry import CameraModel

group = typer.Typer(
    help="Calibrate a camera (its angle theta, response, vignetting and noise), and use it: invariant images, and "
    "images of one scene aligned. Calibrations write a camera file for --camera of train and fit, and an image to "
    "check it.",
    no_args_is_help=True,
)

Pictures = Annotated[list[Path], typer.Argument(metavar="IMAGE...", readable=False, help="Images of one camera.")]
Output = Annotated[Path, typer.Option("--output", "-o", help="Camera file to write.")]
Start = Annotated[
    str | None,
    typer.Option(
        "--camera",
        help="Camera file to start from, whose other values are kept; or the response alone: srgb (default), linear, "
        "or a gamma.",
    ),
]
Align = Annotated[bool, typer.Option("--align/--no-align", help="Align the images with the first one.")]
FreeBalance = Annotated[
    bool,
    typer.Option(
        "--free-balance", help="The images differ in white balance: use only changes that vary across the image."
    ),
]
CAMERA_FILE = Path("camera.json")
BLOCK = 2  # pixels: comparisons average so many across, against noise and rounding

FAR = 0.04
"""Movement, as a fraction of the image size, above which to warn that the scene may not be flat."""


@group.command()
def spectral(
    peaks: Annotated[
        str | None, typer.Option(help="Peak wavelengths of the red, green and blue sensors in nm: 610,540,450.")
    ] = None,
    curves: Annotated[
        Path | None, typer.Option(help="CSV file of sensitivities, with columns wavelength_nm, R, G, B.")
    ] = None,
    output: Output = CAMERA_FILE,
    start: Start = None,
) -> None:
    """Compute the angle from peak wavelengths (Wien's approximation) or sensitivities of the sensors."""
    from liaam.calibration import read_sensitivities, theta_from_peaks, theta_from_sensitivities

    check_camera_output(output, start)
    if peaks is not None and curves is None:
        red, green, blue = numbers_in(peaks, 3, "--peaks").tolist()
        estimate, source = theta_from_peaks((red, green, blue)), f"peaks at {peaks} nm"
    elif curves is not None and peaks is None:
        estimate, source = theta_from_sensitivities(*read_sensitivities(curves)), f"sensitivities of {curves.name}"
    else:
        raise CameraError("give one of --peaks 610,540,450 and --curves FILE.csv")
    finish_angle(estimate, camera_for([], start), f"spectral, {source}", output)


@group.command()
def scene(
    images: Pictures,
    output: Output = CAMERA_FILE,
    start: Start = None,
    align: Align = True,
    free_balance: FreeBalance = False,
) -> None:
    """Estimate the angle from two or more images of one scene under lights of different colour."""
    from liaam.calibration import STILL, align_pictures, theta_from_scene

    check_camera_output(output, start, images)
    camera, pictures = read_pictures(images, start, at_least=2)
    masks = None
    if align:
        with progress_bar() as progress:
            aligned = align_pictures(pictures, camera, names=[p.name for p in images], progress=progress)
        pictures, masks = list(aligned.pictures), aligned.masks
        moved = max(aligned.moved)
        say(f"aligned: the corners moved by up to {moved:.1f} pixels" if moved > STILL else "the images are aligned")
        if moved > FAR * max(pictures[0].shape[:2]):
            complain("large movement: a homography fits only flat or distant scenes; check the written image")
    with progress_bar() as progress:
        progress(0, 1, "estimating the angle")
        estimate = theta_from_scene(pictures, camera, free_balance=free_balance, masks=masks)
    camera = finish_angle(estimate, camera, f"scene, {names_of(images)}", output)
    write_check(output, pictures, images, camera)


@group.command()
def chart(
    images: Pictures,
    corners: Annotated[
        list[str] | None,
        typer.Option(
            help="Centres of the four corner patches of a chart of 4 by 6, clockwise from the first patch: "
            "x0,y0,x1,y1,x2,y2,x3,y3. "
            "Give it once for all images, or once per image in the same order."
        ),
    ] = None,
    patches: Annotated[
        list[Path] | None,
        typer.Option(help="CSV file with a row x0,y0,x1,y1 per patch. Give it once for all images, or once per image."),
    ] = None,
    output: Output = CAMERA_FILE,
    start: Start = None,
    free_balance: FreeBalance = False,
) -> None:
    """Estimate the angle from images of a colour chart under lights of different colour, without alignment."""
    from liaam.calibration import chart_patches, theta_from_chart

    check_camera_output(output, start, images)
    if (corners is None) == (patches is None):
        raise CameraError(
            "give one of --corners (the centres of the chart's four corner patches) and --patches FILE.csv"
        )
    if corners:
        quads = [chart_patches(numbers_in(text, 8, "--corners").reshape(4, 2)) for text in corners]
    else:
        quads = [read_patches(path) for path in patches or []]
    camera, pictures = read_pictures(images, start, at_least=2)
    if len(quads) not in (1, len(images)):
        raise CameraError(f"{len(quads)} charts for {len(images)} images: give one for all, or one per image")
    quads = quads * len(images) if len(quads) == 1 else quads
    estimate = theta_from_chart(pictures, quads, camera, free_balance=free_balance)
    camera = finish_angle(estimate, camera, f"chart, {names_of(images)}", output)
    write_check(output, pictures, images, camera, quads)


@group.command()
def image(
    picture: Annotated[Path, typer.Argument(metavar="IMAGE", help="Image with shadows.")],
    output: Output = CAMERA_FILE,
    start: Start = None,
) -> None:
    """Estimate the angle from one image with shadows, by entropy minimisation. A last resort, often unreliable."""
    from liaam.calibration import theta_from_image

    check_camera_output(output, start, [picture])
    camera, (pixels,) = read_pictures([picture], start)
    estimate = theta_from_image(pixels, camera.response)
    camera = finish_angle(estimate, camera, f"image, {picture.name}", output)
    write_check(output, [pixels], [picture], camera)


@group.command()
def faces(
    model_file: ModelFile,
    images: Pictures,
    init: Annotated[str, typer.Option(help="Where to start; see 'liaam fit'.")],
    method: Annotated[
        str,
        typer.Option(
            "--method", "-m", help="li-pcs: the model's camera took the images; li-pc: another camera took them."
        ),
    ] = "li-pcs",
    output: Output = CAMERA_FILE,
    start: Start = None,
) -> None:
    """Estimate the angle from fits of a model to many images under lights other than the training light."""
    from liaam.calibration import theta_from_fits
    from liaam.fitting import Fitter
    from liaam.model import load_model

    check_camera_output(output, start)
    if not method.startswith("li-pc"):
        raise CameraError(f"--method {method} does not estimate the camera angle; use li-pcs or li-pc")
    model = load_model(model_file)
    # With li-pc, the vignetting and noise of the model's camera do not apply.
    camera = camera_for(images, start, model.camera if method.startswith("li-pcs") else None)
    fitter, results = Fitter(model, method, camera=camera), []
    with progress_bar() as progress:
        for i, path in enumerate(images):
            progress(i, len(images), path.name)
            results.append(fitter.fit(*read_with_start(path, init), path.name))
    finish_angle(theta_from_fits(results), camera, f"faces, {len(images)} fits with {method}", output)


@group.command("response")
def response_command(
    images: Pictures,
    exposures: Annotated[
        str | None, typer.Option(help="Relative exposures of the images, such as 1,2,4 (from the shutter times).")
    ] = None,
    vignetting: Annotated[
        bool, typer.Option("--vignetting", help="Also estimate vignetting. The images must overlap but not coincide.")
    ] = False,
    align: Align = True,
    output: Output = CAMERA_FILE,
    start: Start = None,
) -> None:
    """Estimate the response (and vignetting, with --vignetting) from images of one scene at different exposures."""
    from liaam.calibration import calibrate_response, homographies_between
    from liaam.plotting.photometry import figure_of_response, save_figure

    check_camera_output(output, start, images)
    camera, pictures = read_pictures(images, start, at_least=2)
    ratios = None if exposures is None else numbers_in(exposures, len(images), "--exposures").tolist()
    homographies = None
    if align:
        with progress_bar() as progress:
            homographies = homographies_between(pictures, camera, names=[p.name for p in images], progress=progress)
    found = calibrate_response(pictures, exposures=ratios, homographies=homographies, vignetting=vignetting)
    say(found.message)
    if not found.observable:
        raise CameraError("nothing was written: these images do not determine the response")
    lens = found.vignetting
    if vignetting:
        say(corner_sentence(lens))
    known = lens.coefficients if lens.observable else camera.vignetting
    if camera.theta_deviation is not None or camera.noise is not None:
        say("the angle and noise in the file were estimated with another response: estimate them again")
    camera = replace(camera, response=found.response, vignetting=known, theta_deviation=None, noise=None)
    write_camera(camera, output, f"response, {names_of(images)}: {found.message}")
    save_figure(figure_of_response(camera), check_picture(output))
    say(f"{check_picture(output)}: the response beside sRGB, for checking")


@group.command("vignetting")
def vignetting_command(
    picture: Annotated[Path, typer.Argument(metavar="IMAGE", help="Image of an evenly lit, plain surface.")],
    output: Output = CAMERA_FILE,
    start: Start = None,
) -> None:
    """Estimate vignetting from one image of an evenly lit white wall or paper."""
    from liaam.calibration import vignetting_from_flat_field

    check_camera_output(output, start, [picture])
    camera, (pixels,) = read_pictures([picture], start)
    found = vignetting_from_flat_field(pixels, camera.response)
    say(corner_sentence(found))
    if not found.observable:
        raise CameraError("nothing was written: this image does not determine the vignetting")
    write_camera(
        replace(camera, vignetting=found.coefficients), output, f"vignetting, {picture.name}: {corner_sentence(found)}"
    )


def corner_sentence(lens: "VignettingEstimate") -> str:
    """Describe a vignetting estimate in a sentence."""
    if not lens.observable:
        return lens.message
    return f"the corners receive {lens.corner:.1%} ± {lens.corner_error:.1%} of the light. {lens.message}"


@group.command("noise")
def noise_command(
    images: Pictures,
    flat: Annotated[
        list[str] | None, typer.Option(help="Box x0,y0,x1,y1 around a plain, evenly lit surface; may be repeated.")
    ] = None,
    output: Output = CAMERA_FILE,
    start: Start = None,
) -> None:
    """Estimate noise from plain surfaces (--flat), two images of one scene under one light, or one image."""
    from liaam.calibration import noise_from_flat, noise_from_image, noise_from_pair

    check_camera_output(output, start, images)
    camera, pictures = read_pictures(images, start)
    if flat:
        boxes = np.rint([numbers_in(text, 4, "--flat") for text in flat]).astype(int)
        found = noise_from_flat(pictures, boxes, camera.response)
    elif len(pictures) == 2:
        found = noise_from_pair(pictures[0], pictures[1], camera.response)
    elif len(pictures) == 1:
        found = noise_from_image(pictures[0], camera.response)
    else:
        raise CameraError(f"{len(pictures)} images without --flat: give two of one scene under one light, or one")
    say(found.message)
    if not found.observable:
        raise CameraError("nothing was written: these images do not determine the noise")
    write_camera(replace(camera, noise=found.noise), output, f"noise, {names_of(images)}: {found.message}")


def read_pictures(
    paths: Sequence[Path], start: str | None, at_least: int = 1
) -> tuple["CameraModel", list[np.ndarray]]:
    """Read images and the camera to start from."""
    if len(paths) < at_least:
        raise CameraError(f"too few images ({len(paths)}): give {at_least} or more, under different lights")
    camera = camera_for(paths, start)
    return camera, [read_image(path) for path in paths]


def check_camera_output(output: Path, start: str | None, inputs: Sequence[Path] = ()) -> None:
    """Raise, before any work, if a camera file cannot be written or would replace an unrelated one."""
    check_output(output)
    if output.suffix.lower() != ".json":
        raise CameraError(f"{output}: a camera file ends in .json, such as camera.json")
    if output.exists() and (start is None or real_path(Path(start)) != real_path(output)):
        raise CameraError(f"{output} exists; add --camera {output} to update it, or give another name with -o")
    refuse_inputs([check_picture(output)], inputs)


def check_picture(output: Path) -> Path:
    """Return the path of the check image beside a camera file."""
    return output.with_name(f"{output.stem}_check.png")


def read_patches(path: Path) -> np.ndarray:
    """Read boxes from a CSV file, (n, 4) float64."""
    data = read_bytes(existing_file(path, CameraError, "patch file"), CameraError, limit=10_000_000)
    try:
        rows = [line for line in data.decode("utf-8-sig").splitlines() if line.strip()]
        rows = rows[1:] if rows and not any(map(is_number, rows[0].split(","))) else rows
        boxes = np.array([[float(part) for part in row.split(",")] for row in rows])
    except ValueError:
        boxes = np.zeros((0, 0))
    if boxes.ndim != 2 or boxes.shape[1] != 4:
        raise CameraError(f"{path} is not a patch file: give one row x0,y0,x1,y1 in pixels per patch")
    return boxes


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
    camera.save(output)
    say(f"written to {output}")
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
    from liaam.plotting.photometry import figure_of_invariants, save_figure

    names = unique_stems(list(paths[:6]))
    figure = figure_of_invariants(
        {n: (p, invariant_image(p, camera, name=n)) for n, p in zip(names, pictures[:6], strict=True)},
        None if patches is None else patches[:6],
    )
    path = check_picture(output)
    save_figure(figure, path)
    say(f"{path}: the images and their invariant images, which should look alike")


@group.command()
def invariant(
    images: Pictures,
    theta: Annotated[float | None, typer.Option(help="Camera angle in degrees; 122 for an unknown camera.")] = None,
    start: Start = None,
    sweep: Annotated[
        bool, typer.Option("--sweep", help="Also draw invariant images over theta, and the entropy curve.")
    ] = False,
    compare: Annotated[
        bool, typer.Option("--compare", help="Also compare the images, which must be registered and of one size.")
    ] = False,
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder for the results.")] = Path("liaam-invariant"),
) -> None:
    """Write the invariant image of each image: .png for viewing, .tif (float) and .npy for computing."""
    from liaam.calibration import averaged
    from liaam.photometry import invariant_image
    from liaam.plotting.photometry import figure_of_sweep, invariant_picture, save_figure

    camera, pictures = read_pictures(images, start)
    if theta is not None:
        if not 0 <= theta <= 360:
            raise LiaamError(f"--theta {theta:g}: give the camera angle in degrees, usually between 90 and 135")
        camera = replace(camera, theta=float(np.deg2rad(theta)))
    # Fail before writing anything if the images cannot be compared.
    averages = None
    if compare:
        averages = averaged(pictures, camera, block=BLOCK, names=[path.name for path in images])
    make_folder(output)
    stems = unique_stems(images)
    with progress_bar() as progress:
        for i, (path, stem, pixels) in enumerate(zip(images, stems, pictures, strict=True)):
            progress(i, len(images), path.name)
            values = invariant_image(pixels, camera, name=path.name)
            seen = float(np.isfinite(values).mean())
            if seen < 0.1:
                complain(f"{path.name}: {1 - seen:.0%} of the pixels are dark or saturated and have no invariant")
            write_image(output / f"{stem}_invariant.png", invariant_picture(values))
            write_image(output / f"{stem}_invariant.tif", values)
            with atomic_path(output / f"{stem}_invariant.npy") as temporary, temporary.open("wb") as file:
                np.save(file, values, allow_pickle=False)
            if sweep:
                save_figure(figure_of_sweep(pixels, camera), output / f"{stem}_sweep.png")
    if averages is not None:
        compare_pictures(pictures, images, averages, output)
    say(f"written to {output}, at theta {degrees(camera.theta)}")


def compare_pictures(pictures: Sequence[np.ndarray], paths: Sequence[Path], seen: "Averaged", output: Path) -> None:
    """Write and print the pairwise correlations of invariant images and of log grey."""
    from liaam.calibration import agreement
    from liaam.plotting.photometry import figure_of_agreement, save_figure

    found = agreement(seen)
    lines = ["first,second,invariant,log_grey,share"]
    table = table_of("first", "second", "invariant", "log grey", "fraction of pixels")
    for pair_ in found:
        names = paths[pair_.first].name, paths[pair_.second].name
        lines.append(f"{names[0]},{names[1]},{pair_.invariant:.6f},{pair_.log_grey:.6f},{pair_.share:.6f}")
        table.add_row(*names, f"{pair_.invariant:.3f}", f"{pair_.log_grey:.3f}", f"{pair_.share:.2f}")
    write_text_atomically(output / "agreement.csv", "\n".join(lines) + "\n")
    save_figure(figure_of_agreement(pictures, [p.name for p in paths], seen, found), output / "agreement.png")
    if len(found) <= 15:
        show_table(table)
    medians = (np.median([getattr(p, key) for p in found]) for key in ("invariant", "log_grey"))
    say("median correlation: invariant {:.3f}, log grey {:.3f}".format(*medians))


@group.command()
def register(
    first: Annotated[Path, typer.Argument(metavar="A", help="Reference image.")],
    second: Annotated[Path, typer.Argument(metavar="B", help="Image to align with A.")],
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Image to write. By default B_registered.png.")
    ] = None,
    warp: Annotated[str, typer.Option(help="homography, affine, similarity or translation.")] = "homography",
    start: Start = None,
) -> None:
    """Align two images of a flat or distant scene, even under different lights."""
    from liaam.plotting.photometry import checkerboard
    from liaam.registration import register as align

    output = output or Path(f"{second.stem}_registered.png")
    check_output(output)
    board, facts_file = (output.with_name(f"{output.stem}_{name}") for name in ("check.png", "homography.json"))
    refuse_inputs([output, board], [first, second])
    camera, (a, b) = read_pictures([first, second], start)
    with progress_bar() as progress:
        progress(0, 2, f"registering {second.name}")
        found = align(a, b, group=warp, response=camera.response, theta=camera.theta)
        if not found.status.ok:
            raise LiaamError(
                f"{second.name} could not be registered with {first.name} ({found.status}): {found.message}"
            )
        progress(1, 2, f"writing {output.name}")
        sampled, _ = found.warp(b)
        write_image(output, sampled)
        write_image(board, checkerboard(a, sampled))
        facts = {"first": first.name, "second": second.name, **found.to_dict()}
        write_text_atomically(facts_file, json.dumps(facts, indent=1) + "\n")
    say(f"{found.status}: {found.message}")
    say(f"written to {output}, {facts_file.name} (pixels of A to pixels of B) and {board.name}")


def degrees(angle: float, digits: int = 1) -> str:
    """Format an angle, given in radians, in degrees."""
    return f"{math.degrees(angle):.{digits}f}°"
