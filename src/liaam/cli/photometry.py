"""The commands of photometry: ``liaam calibrate``, ``liaam invariant`` and ``liaam register``."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from liaam.cli.inputs import (
    camera_for,
    check_camera_output,
    check_output,
    check_picture,
    names_of,
    numbers_in,
    read_init,
    read_patches,
    read_pictures,
    refuse_inputs,
    starting_camera,
    unique_stems,
)
from liaam.cli.terminal import complain, console, progress_bar, say, table_of
from liaam.errors import CameraError, LiaamError

if TYPE_CHECKING:
    import numpy as np

    from liaam.calibration import AngleEstimate, Averaged, VignettingEstimate
    from liaam.photometry import CameraModel

calibrate = typer.Typer(
    help="Find out what light invariance needs to know of a camera: its angle, response, vignetting and noise. "
    "Writes a small file for '--camera' of train, fit, invariant and register, and a picture to check it by.",
    no_args_is_help=True,
)

Pictures = Annotated[list[Path], typer.Argument(metavar="IMAGE...", help="Pictures of one camera.")]
Output = Annotated[Path, typer.Option("--output", "-o", help="Camera file to write.")]
Start = Annotated[
    Path | None,
    typer.Option("--camera", help="Camera file to start from: what is not estimated here is kept from it."),
]
ResponseOption = Annotated[
    str | None,
    typer.Option("--response", help="Response: srgb, linear, or a gamma; that of --camera, or srgb, if left out."),
]
Trust = Annotated[
    bool, typer.Option("--trust", help="Write the angle even if no physical camera has it, or its minimum is doubtful.")
]
Align = Annotated[
    bool, typer.Option("--align/--no-align", help="Bring the pictures into the frame of the first one beforehand.")
]
FreeBalance = Annotated[
    bool,
    typer.Option(
        "--free-balance",
        help="The pictures' white balance differs: count only what changes from place to place.",
    ),
]
CAMERA_FILE = Path("camera.json")

FAR = 0.04
"""Movement, as a share of the picture's size, that deserves a word: perhaps the scene is not flat."""


@calibrate.command()
def spectral(
    peaks: Annotated[
        str | None, typer.Option(help="Wavelengths of the red, green and blue sensors' peaks, nm: 610,540,450.")
    ] = None,
    curves: Annotated[
        Path | None, typer.Option(help="CSV file of sensitivities: columns wavelength_nm, R, G, B.")
    ] = None,
    output: Output = CAMERA_FILE,
    start: Start = None,
    trust: Trust = False,
) -> None:
    """Angle from the sensors' spectra: from peak wavelengths (Wien's law), or from measured sensitivities."""
    from liaam.calibration import read_sensitivities, theta_from_peaks, theta_from_sensitivities

    check_camera_output(output, start)
    if (peaks is None) == (curves is None):
        raise CameraError("give either --peaks 610,540,450 or --curves FILE.csv")
    if peaks is not None:
        red, green, blue = numbers_in(peaks, 3, "--peaks").tolist()
        estimate, source = theta_from_peaks((red, green, blue)), f"peaks at {peaks} nm"
    else:
        assert curves is not None
        estimate, source = theta_from_sensitivities(*read_sensitivities(curves)), f"sensitivities of {curves.name}"
    conclude_angle(estimate, starting_camera(start), f"spectral, {source}", output, trust)


@calibrate.command()
def pair(
    first: Annotated[Path, typer.Argument(metavar="A", help="Picture of a scene under one light.")],
    second: Annotated[Path, typer.Argument(metavar="B", help="Picture of the same scene under another light.")],
    output: Output = CAMERA_FILE,
    start: Start = None,
    response: ResponseOption = None,
    align: Align = True,
    free_balance: FreeBalance = False,
    trust: Trust = False,
) -> None:
    """Angle from two pictures of one scene under lights of different colour."""
    angle_of_scene([first, second], output, start, response, align, free_balance, trust)


@calibrate.command()
def scene(
    images: Pictures,
    output: Output = CAMERA_FILE,
    start: Start = None,
    response: ResponseOption = None,
    align: Align = True,
    free_balance: FreeBalance = False,
    trust: Trust = False,
) -> None:
    """Angle from several pictures of one scene under lights of different colour."""
    angle_of_scene(images, output, start, response, align, free_balance, trust)


def angle_of_scene(
    paths: Sequence[Path],
    output: Path,
    start: Path | None,
    response: str | None,
    align: bool,
    free_balance: bool,
    trust: bool,
) -> None:
    """Read, align, estimate, and write what belongs to it."""
    from liaam.calibration import theta_from_scene

    check_camera_output(output, start, paths)
    camera, pictures = read_pictures(paths, start, response, at_least=2)
    masks = None
    if align:
        from liaam.calibration import STILL, align_pictures

        with progress_bar() as tell:
            aligned = align_pictures(pictures, camera, names=[p.name for p in paths], progress=tell)
        pictures, masks = list(aligned.pictures), aligned.masks
        moved = max(aligned.moved)
        say(
            f"aligned: moved by up to {moved:.1f} pixels at the corners"
            if moved > STILL
            else "the pictures are aligned"
        )
        if moved > FAR * max(pictures[0].shape[:2]):
            complain("they moved far: a homography suits flat or far scenes only; check the picture that is written")
    estimate = theta_from_scene(pictures, camera, free_balance=free_balance, masks=masks)
    camera = conclude_angle(estimate, camera, f"scene, {names_of(paths)}", output, trust)
    write_check(output, pictures, paths, camera)


@calibrate.command()
def chart(
    images: Pictures,
    corners: Annotated[
        list[str] | None,
        typer.Option(
            help="Centres of the chart's four corner patches, clockwise from the first patch: x0,y0,x1,y1,x2,y2,x3,y3. "
            "Once for all pictures, or once for each in their order."
        ),
    ] = None,
    patches: Annotated[
        list[Path] | None,
        typer.Option(help="CSV file of patches, a row x0,y0,x1,y1 each; once for all pictures, or once for each."),
    ] = None,
    rows: Annotated[int, typer.Option(help="Rows of the chart.", min=2)] = 4,
    columns: Annotated[int, typer.Option(help="Columns of the chart.", min=2)] = 6,
    output: Output = CAMERA_FILE,
    start: Start = None,
    response: ResponseOption = None,
    free_balance: FreeBalance = False,
    trust: Trust = False,
) -> None:
    """Angle from pictures of a colour chart under lights of different colour; no alignment is needed."""
    from liaam.calibration import chart_patches, theta_from_chart

    check_camera_output(output, start, images)
    if (corners is None) == (patches is None):
        raise CameraError(
            "give either --corners (the centres of the chart's four corner patches) or --patches FILE.csv"
        )
    if corners:
        quads = [chart_patches(numbers_in(text, 8, "--corners").reshape(4, 2), rows, columns) for text in corners]
    else:
        quads = [read_patches(path) for path in patches or []]
    camera, pictures = read_pictures(images, start, response, at_least=2)
    if len(quads) not in (1, len(images)):
        raise CameraError(f"{len(quads)} charts for {len(images)} pictures: give one for all, or one for each")
    quads = quads * len(images) if len(quads) == 1 else quads
    estimate = theta_from_chart(pictures, quads, camera, free_balance=free_balance)
    camera = conclude_angle(estimate, camera, f"chart, {names_of(images)}", output, trust)
    write_check(output, pictures, images, camera, quads)


@calibrate.command()
def image(
    picture: Annotated[Path, typer.Argument(metavar="IMAGE", help="A picture with shadows.")],
    output: Output = CAMERA_FILE,
    start: Start = None,
    response: ResponseOption = None,
    kind: Annotated[Literal["quadratic", "shannon"], typer.Option(help="Entropy to minimise.")] = "quadratic",
    trust: Trust = False,
) -> None:
    """Angle from one picture with shadows (entropy minimisation): a last resort that often cannot be trusted."""
    from liaam.calibration import theta_from_image

    check_camera_output(output, start, [picture])
    camera, (pixels,) = read_pictures([picture], start, response)
    estimate = theta_from_image(pixels, camera.response, kind)
    if trust and not estimate.observable:
        say(f"theta {degrees(estimate.theta)}: {estimate.message}")
        write_camera(replace(camera, theta=estimate.theta, theta_deviation=None), output, f"image, {picture.name}")
    else:
        camera = conclude_angle(estimate, camera, f"image, {picture.name}", output, trust)
    write_check(output, [pixels], [picture], replace(camera, theta=estimate.theta))


@calibrate.command()
def faces(
    model_file: Annotated[Path, typer.Argument(metavar="MODEL", help="Model file of 'liaam train'.")],
    images: Pictures,
    init: Annotated[str, typer.Option(help="Where to start, as for 'liaam fit'.")],
    method: Annotated[
        str, typer.Option("--method", "-m", help="li-pcs: one camera for all; li-pc: the model has another one.")
    ] = "li-pcs",
    output: Output = CAMERA_FILE,
    start: Start = None,
    trust: Trust = False,
) -> None:
    """Angle pooled over fits of a model to many pictures, under lights other than the training light."""
    from liaam.calibration import theta_from_fits
    from liaam.fitting import Fitter
    from liaam.io import read_image
    from liaam.model import load_model

    check_camera_output(output, start)
    if not method.startswith("li-pc"):
        raise CameraError(f"--method {method}: only li-pcs and li-pc estimate the camera's angle")
    model = load_model(model_file)
    # One camera for all is the model's; another one is not known to have its vignetting or noise.
    camera = camera_for(images, start, None, model.camera if method.startswith("li-pcs") else None)
    fitter, results = Fitter(model, method, camera=camera), []
    with progress_bar() as tell:
        for i, path in enumerate(images):
            tell(i, len(images), path.name)
            pixels = read_image(path)
            results.append(fitter.fit(pixels, read_init(init, path, pixels.shape[1::-1]), path.name))
    conclude_angle(theta_from_fits(results), camera, f"faces, {len(images)} fits with {method}", output, trust)


@calibrate.command("response")
def response_command(
    images: Pictures,
    exposures: Annotated[
        str | None,
        typer.Option(help="Exposures of the pictures relative to each other, such as 1,2,4 (from the shutter times)."),
    ] = None,
    vignetting: Annotated[
        bool, typer.Option("--vignetting", help="Also estimate vignetting; the pictures have to overlap, not coincide.")
    ] = False,
    align: Align = True,
    output: Output = CAMERA_FILE,
    start: Start = None,
) -> None:
    """Response, and with --vignetting the light's falloff, from pictures of one scene at different exposures."""
    from liaam.calibration import calibrate_response
    from liaam.plotting.photometry import figure_of_response, save_figure

    check_camera_output(output, start, images)
    camera, pictures = read_pictures(images, start, None, at_least=2)
    ratios = None if exposures is None else numbers_in(exposures, len(images), "--exposures").tolist()
    homographies = None
    if align:
        from liaam.calibration import homographies_between

        with progress_bar() as tell:
            homographies = homographies_between(pictures, camera, names=[p.name for p in images], progress=tell)
    found = calibrate_response(pictures, exposures=ratios, homographies=homographies, vignetting=vignetting)
    say(found.message)
    if not found.observable:
        raise CameraError("nothing was written: these pictures do not tell the response")
    lens = found.vignetting
    if vignetting:
        say(corner_sentence(lens))
    known = lens.coefficients if lens.observable else camera.vignetting
    if camera.theta_deviation is not None or camera.noise is not None:
        say("the file's angle and noise were estimated under another response: estimate them again")
    camera = replace(camera, response=found.response, vignetting=known, theta_deviation=None, noise=None)
    write_camera(camera, output, f"response, {names_of(images)}: {found.message}")
    save_figure(figure_of_response(camera), check_picture(output))
    say(f"{check_picture(output)}: the response beside sRGB, to look at")


@calibrate.command("vignetting")
def vignetting_command(
    picture: Annotated[Path, typer.Argument(metavar="IMAGE", help="Picture of an evenly lit, plain surface.")],
    output: Output = CAMERA_FILE,
    start: Start = None,
    response: ResponseOption = None,
) -> None:
    """Vignetting from one picture of an evenly lit white wall or paper."""
    from liaam.calibration import vignetting_from_flat_field

    check_camera_output(output, start, [picture])
    camera, (pixels,) = read_pictures([picture], start, response)
    found = vignetting_from_flat_field(pixels, camera.response)
    say(corner_sentence(found))
    if not found.observable:
        raise CameraError("nothing was written: this picture does not tell the vignetting")
    write_camera(
        replace(camera, vignetting=found.coefficients), output, f"vignetting, {picture.name}: {corner_sentence(found)}"
    )


def corner_sentence(lens: "VignettingEstimate") -> str:
    """What is known of the light's falloff."""
    if not lens.observable:
        return f"vignetting: {lens.message}"
    return f"{lens.corner:.0%} ± {lens.corner_error:.0%} of the light arrives in the corners. {lens.message}"


@calibrate.command("noise")
def noise_command(
    images: Pictures,
    flat: Annotated[
        list[str] | None,
        typer.Option(help="Box x0,y0,x1,y1 around a plain, evenly lit surface; may be repeated for others."),
    ] = None,
    output: Output = CAMERA_FILE,
    start: Start = None,
    response: ResponseOption = None,
) -> None:
    """Noise from plain surfaces (--flat), from two pictures of one scene under one light, or from one picture."""
    import numpy as np

    from liaam.calibration import noise_from_flat, noise_from_image, noise_from_pair

    check_camera_output(output, start, images)
    camera, pictures = read_pictures(images, start, response)
    if flat:
        boxes = np.rint([numbers_in(text, 4, "--flat") for text in flat]).astype(int)
        found = noise_from_flat(pictures, boxes, camera.response)
    elif len(pictures) == 2:
        found = noise_from_pair(pictures[0], pictures[1], camera.response)
    elif len(pictures) == 1:
        found = noise_from_image(pictures[0], camera.response)
    else:
        raise CameraError(f"{len(pictures)} pictures without --flat: give two of one scene under one light, or one")
    say(found.message)
    if not found.observable:
        raise CameraError("nothing was written: these pictures do not tell the noise")
    write_camera(replace(camera, noise=found.noise), output, f"noise, {names_of(images)}: {found.message}")


def conclude_angle(
    estimate: "AngleEstimate", camera: "CameraModel", source: str, output: Path, trust: bool
) -> "CameraModel":
    """Say what was found, and write the camera; an angle that cannot be told is not guessed."""
    if not estimate.observable:
        raise CameraError(f"nothing was written: {estimate.message}")
    if not estimate.physical and not trust:
        raise CameraError(
            f"nothing was written: theta {degrees(estimate.theta)} ± {degrees(estimate.standard_error)}; "
            f"{estimate.message} (--trust writes it nonetheless)"
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
    pictures: Sequence["np.ndarray"],
    paths: Sequence[Path],
    camera: "CameraModel",
    patches: Sequence["np.ndarray"] | None = None,
) -> None:
    """Write the pictures beside their invariant images, for people to see whether the light is gone."""
    from liaam.photometry import invariant_image
    from liaam.plotting.photometry import figure_of_invariants, save_figure

    names = unique_stems(list(paths[:6]))
    figure = figure_of_invariants(
        {n: (p, invariant_image(p, camera, name=n)) for n, p in zip(names, pictures[:6], strict=True)},
        None if patches is None else patches[:6],
    )
    path = check_picture(output)
    save_figure(figure, path)
    say(f"{path}: the pictures and their invariant images, which should look alike")


def invariant(
    images: Pictures,
    theta: Annotated[float | None, typer.Option(help="Angle of the camera, degrees; 122 for an unknown one.")] = None,
    camera_file: Annotated[Path | None, typer.Option("--camera", help="Camera file of 'liaam calibrate'.")] = None,
    response: ResponseOption = None,
    sweep: Annotated[
        bool, typer.Option("--sweep", help="Also a strip of invariant images over theta with the entropy's curve.")
    ] = False,
    compare: Annotated[
        bool, typer.Option("--compare", help="Also a table of how well the pictures agree (registered, of one size).")
    ] = False,
    block: Annotated[int, typer.Option(help="For --compare: average this many pixels across first.", min=1)] = 2,
    dark: Annotated[
        float, typer.Option(help="For --compare: stored value, of 255, below which pixels say nothing.", min=0, max=250)
    ] = 8.0,
    mask: Annotated[Path | None, typer.Option(help="For --compare: picture that is white where pixels count.")] = None,
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder for the results.")] = Path("liaam-invariant"),
) -> None:
    """Write the invariant image of pictures: .png to look at, .tif (float) and .npy to compute with."""
    import numpy as np

    from liaam.io import make_folder, write_bytes_atomically, write_image
    from liaam.photometry import invariant_image
    from liaam.plotting.photometry import figure_of_sweep, invariant_picture, save_figure

    camera, pictures = read_pictures(images, camera_file, response)
    if theta is not None:
        if not 0 <= theta <= 360:
            raise LiaamError(f"--theta {theta:g}: give the camera's angle in degrees; cameras lie in 90 to 135")
        camera = replace(camera, theta=float(np.deg2rad(theta)))
    # Before anything is written: pictures that cannot be compared are a mistake.
    seen_by_all = average_pictures(pictures, images, camera, block, dark / 255.0, mask) if compare else None
    make_folder(output)
    stems = unique_stems(images)
    with progress_bar() as tell:
        for i, (path, stem, pixels) in enumerate(zip(images, stems, pictures, strict=True)):
            tell(i, len(images), path.name)
            values = invariant_image(pixels, camera, name=path.name)
            seen = float(np.isfinite(values).mean())
            if seen < 0.1:
                complain(f"{path.name}: {1 - seen:.0%} of the pixels are dark or saturated and have no invariant")
            write_image(output / f"{stem}_invariant.png", invariant_picture(values))
            write_image(output / f"{stem}_invariant.tif", values)
            with_npy = output / f"{stem}_invariant.npy"
            write_bytes_atomically(with_npy, npy_bytes(values))
            if sweep:
                save_figure(figure_of_sweep(pixels, camera), output / f"{stem}_sweep.png")
    if seen_by_all is not None:
        compare_pictures(pictures, images, seen_by_all, output)
    say(f"written to {output}, at theta {degrees(camera.theta)}")


def npy_bytes(values: "np.ndarray") -> bytes:
    """Contents of a .npy file."""
    import io

    import numpy as np

    buffer = io.BytesIO()
    np.save(buffer, values, allow_pickle=False)
    return buffer.getvalue()


def average_pictures(
    pictures: Sequence["np.ndarray"],
    paths: Sequence[Path],
    camera: "CameraModel",
    block: int,
    dark: float,
    mask_file: Path | None,
) -> "Averaged":
    """Average registered pictures in blocks, where a mask's file is white."""
    from liaam.calibration import averaged
    from liaam.io import read_image
    from liaam.photometry.encoding import stored_values

    mask = None if mask_file is None else stored_values(read_image(mask_file)[..., 0]) > 0.5
    return averaged(pictures, camera, block=block, dark=dark, mask=mask, names=[path.name for path in paths])


def compare_pictures(pictures: Sequence["np.ndarray"], paths: Sequence[Path], seen: "Averaged", output: Path) -> None:
    """Write and print how well invariant images agree, each with each, with log-grey beside them."""
    import numpy as np

    from liaam.calibration import agreement
    from liaam.io import write_text_atomically
    from liaam.plotting.photometry import figure_of_agreement, save_figure

    found = agreement(seen)
    lines = ["first,second,invariant,log_grey,share"]
    table = table_of("first", "second", "invariant", "log grey", "share of pixels")
    for pair_ in found:
        names = paths[pair_.first].name, paths[pair_.second].name
        lines.append(f"{names[0]},{names[1]},{pair_.invariant:.6f},{pair_.log_grey:.6f},{pair_.share:.6f}")
        table.add_row(*names, f"{pair_.invariant:.3f}", f"{pair_.log_grey:.3f}", f"{pair_.share:.2f}")
    write_text_atomically(output / "agreement.csv", "\n".join(lines) + "\n")
    save_figure(figure_of_agreement(pictures, [p.name for p in paths], seen, found), output / "agreement.png")
    if len(found) <= 15:
        console.print(table)
    medians = (np.median([getattr(p, key) for p in found]) for key in ("invariant", "log_grey"))
    say("median correlation: invariant {:.3f}, log grey {:.3f}".format(*medians))


def register_command(
    first: Annotated[Path, typer.Argument(metavar="A", help="Picture whose frame is kept.")],
    second: Annotated[Path, typer.Argument(metavar="B", help="Picture to bring into the frame of A.")],
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Picture to write; B_registered.png if left out.")
    ] = None,
    method: Annotated[str | None, typer.Option("--method", "-m", help="How to compare; see 'liaam methods'.")] = None,
    group: Annotated[str, typer.Option("--warp", help="homography, affine, similarity or translation.")] = "homography",
    camera_file: Annotated[Path | None, typer.Option("--camera", help="Camera file of 'liaam calibrate'.")] = None,
    response: ResponseOption = None,
) -> None:
    """Align two pictures of a plane (or a far scene) by a homography, whatever the light in each."""
    import json

    from liaam.io import write_image, write_text_atomically
    from liaam.plotting.photometry import checkerboard
    from liaam.registration import METHOD, register

    output = output or Path(f"{second.stem}_registered.png")
    check_output(output)
    board, facts_file = (output.with_name(f"{output.stem}_{name}") for name in ("check.png", "homography.json"))
    refuse_inputs([output, board], [first, second])
    camera, (a, b) = read_pictures([first, second], camera_file, response)
    found = register(a, b, method or METHOD, group=group, response=camera.response, theta=camera.theta)
    if not found.status.ok:
        raise LiaamError(f"{second.name} could not be registered with {first.name} ({found.status}): {found.message}")
    say(f"{found.status}: {found.message}")
    sampled, _ = found.warp(b)
    write_image(output, sampled)
    write_image(board, checkerboard(a, sampled))
    facts = {"first": first.name, "second": second.name, **found.to_dict()}
    write_text_atomically(facts_file, json.dumps(facts, indent=1) + "\n")
    say(f"written to {output}, {facts_file.name} (pixels of A to pixels of B) and {board.name}")


def degrees(angle: float, digits: int = 1) -> str:
    """Angle for people."""
    import math

    return f"{math.degrees(angle):.{digits}f}°"
