"""The command line: thin. Everything it does is a call that Python users have too."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer
from rich.table import Table

from liaam import __version__
from liaam.cli_batch import batch
from liaam.cli_check import check, warn_of_faults
from liaam.cli_inputs import (
    DOUBT,
    ImagesOption,
    LandmarkedFolder,
    RecursiveOption,
    RotationsOption,
    camera_for,
    check_output,
    read_folder,
    read_init,
    read_sample,
    unique_stems,
)
from liaam.cli_lamps import LAMPS_SUFFIX, TrainingLampOption, draw_lamps, read_lamps
from liaam.cli_lamps import lamps as lamps_command
from liaam.cli_photometry import calibrate, invariant, register_command
from liaam.cli_relight import relight
from liaam.cli_studio import studio
from liaam.cli_video import track
from liaam.errors import LiaamError
from liaam.terminal import cell, complain, console, make_app, progress_bar, run_app, say, stoppable_progress, table_of

if TYPE_CHECKING:
    import numpy as np

    from liaam.fitting import FitResult, Fitter
    from liaam.model import AAM
    from liaam.photometry import CameraModel

app = make_app(help="Fit deformable models of faces and other objects to colour images under any light.")
app.add_typer(calibrate, name="calibrate")
app.command()(batch)
app.command()(check)
app.command()(invariant)
app.command("lamps")(lamps_command)
app.command("register")(register_command)
app.command()(relight)
app.command()(track)
app.command()(studio)


def version(show: bool) -> None:
    """Print the version and stop."""
    if show:
        say(f"liaam {__version__}")
        raise typer.Exit


@app.callback()
def root(
    _version: Annotated[
        bool, typer.Option("--version", callback=version, is_eager=True, help="Print the version and stop.")
    ] = False,
) -> None:
    """Fit deformable models of faces and other objects to colour images under any light."""


@app.command()
def train(
    folder: LandmarkedFolder,
    output: Annotated[Path, typer.Option("--output", "-o", help="Model file to write.")],
    images: ImagesOption = None,
    recursive: RecursiveOption = False,
    variance: Annotated[
        str,
        typer.Option(
            help="Share of the variance to keep (0.98), a whole number of modes (12), or 'auto': as many as make "
            "left-out pictures likeliest."
        ),
    ] = "0.98",
    appearance_variance: Annotated[
        str | None, typer.Option(help="The same for the appearance; if left out as --variance, and 0.85 for soft-li.")
    ] = None,
    prior: Annotated[
        list[str] | None,
        typer.Option(
            help="What shapes may look like besides those of the pictures: sample (nothing else), smooth (smooth "
            "deformations too), or shrunk (variances of shapes left out); for one of the model's views alone as "
            "surroundings=sample (soft-li, the default method) or mesh=smooth (all others). Repeatable. If left out "
            "sample, and smooth for soft-li unless all of the variance is kept or there are more than 200 landmarks."
        ),
    ] = None,
    diagonal: Annotated[float, typer.Option(help="Size of the object in the model, pixels across its box.")] = 150.0,
    camera_file: Annotated[
        Path | None,
        typer.Option("--camera", help="Camera file of 'liaam calibrate': angle, response, vignetting, noise."),
    ] = None,
    theta: Annotated[
        float | None, typer.Option(help="Angle of the training camera, degrees; 122 for an unknown one.")
    ] = None,
    response: Annotated[
        str | None, typer.Option(help="Camera response: srgb (unless a camera is given), linear, or a gamma.")
    ] = None,
    lamps: Annotated[
        Path | None,
        typer.Option(
            help="Learn from the pictures as other lamps would show them, too: a file of 'liaam lamps', or a folder "
            "of a few objects under various lamps, named by object and lamp, such as 037-00."
        ),
    ] = None,
    training_lamp: TrainingLampOption = None,
    copies: Annotated[
        int | None,
        typer.Option(
            help="Copies of each picture under other lamps, every other one mirrored where the object is symmetric "
            "(without --lamps one that is mirrored); 0 for none."
        ),
    ] = None,
    leave_out: Annotated[
        bool,
        typer.Option(
            help="Leave pictures out in turn and fit them, to learn how far fits can be trusted; takes twice as long."
        ),
    ] = True,
    name: Annotated[str | None, typer.Option(help="What the model shows, for 'liaam info'.")] = None,
) -> None:
    """Train a model on a folder of landmarked images.

    Landmarks: .pts, .asf, .tem, .ljson, .csv beside each image, or one dlib .xml, COCO .json or .csv for all.
    """
    import numpy as np

    from liaam.fitting.methods import DEFAULT_METHOD, METHODS
    from liaam.io import IMAGE_SUFFIXES, LANDMARK_SUFFIXES
    from liaam.training import train as train_model

    if theta is not None and not 60 <= theta <= 180:
        raise LiaamError(f"--theta {theta:g}: give the camera's angle in degrees; cameras lie in 90 to 135")
    options = {
        "variance": parse_variance(variance),
        "appearance_variance": None if appearance_variance is None else parse_variance(appearance_variance),
        "theta": None if theta is None else float(np.deg2rad(theta)),
    }
    check_output(output)
    if output.exists() and output.suffix.lower() in {*IMAGE_SUFFIXES, *LANDMARK_SUFFIXES}:
        raise LiaamError(
            f"{output} is an image or landmark file; name the model otherwise, such as {folder.name}.liaam"
        )
    data = read_folder(folder, images, recursive)
    options["camera"] = camera_for([s.image for s in data if isinstance(s.image, Path)], camera_file, response)
    light = None if lamps is None else read_lamps(lamps, training_lamp, recursive, options["camera"].response)
    warn_of_faults(data, folder)
    with stoppable_progress(counted=False) as tell:
        model = train_model(
            data,
            prior=parse_prior(prior or []),
            diagonal=diagonal,
            lamps=light,
            copies=copies,
            name=name or folder.name,
            leave_out=leave_out,
            progress=tell,
            **options,
        )
    model.save(output)
    learnt = "" if light is None else f" and {model.n_textures - model.n_images} copies under {len(light)} lamps"
    modes = f"{_count_modes(model)} shape and {model.levels[-1].appearances['value'].n_modes} appearance modes"
    say(f"{output}: {modes} from {model.n_images} images{learnt}, {model.n_pixels} pixels")
    view = model.views[METHODS[DEFAULT_METHOD].view]
    bound = view.shape_model.left_out_bound
    say(
        f"left-out bound: even a perfect fit to a new picture is {bound:.1f} pixels off "
        f"({bound / model.diagonal:.1%} of the object's size)"
    )
    if leave_out and view.reliability is None:
        complain("too few fits to pictures left out were right to tell right fits from wrong ones: give more pictures")


def parse_prior(given: list[str]) -> dict[str, str] | None:
    """Read priors of views: ``smooth`` for all, or ``mesh=smooth`` for one; None where nothing is given."""
    from liaam.model import VIEWS

    priors = {}
    for text in given:
        view, _, prior = text.rpartition("=")
        priors |= {view: prior} if view else dict.fromkeys(VIEWS, prior)
    return priors or None


def parse_variance(text: str) -> float | int | Literal["auto"]:
    """Read a share (with a point: 0.98, 1.0), a count (without: 12), or ``auto``."""
    if text.strip() == "auto":
        return "auto"
    try:
        return int(text) if text.strip().isdigit() else float(text)
    except ValueError:
        raise LiaamError(f"variance {text!r}: give a share such as 0.98, a whole number of modes, or 'auto'") from None


@app.command()
def fit(
    model_file: Annotated[Path, typer.Argument(metavar="MODEL", help="Model file of 'liaam train'.")],
    images: Annotated[list[Path], typer.Argument(metavar="IMAGE...", help="Images to fit.")],
    init: Annotated[
        str | None,
        typer.Option(
            help="Where to start: a box x0,y0,x1,y1 around the landmarks; a centre and the box's diagonal x,y,size; "
            "a landmark file; or a folder with a landmark file for each image. Searched for if left out."
        ),
    ] = None,
    every: Annotated[
        bool, typer.Option("--all", help="Fit every object that the search finds; results are numbered NAME_1 and on.")
    ] = False,
    method: Annotated[str, typer.Option("--method", "-m", help="How to compare; see 'liaam methods'.")] = "soft-li",
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder for the results.")] = Path("liaam-fits"),
    rotations: RotationsOption = "upright",
    iterations: Annotated[int, typer.Option(help="Iterations at most, at each sharpness.", min=0)] = 50,
    history: Annotated[bool, typer.Option("--history", help="Also write each iteration's cost and shape.")] = False,
    ellipses: Annotated[
        bool, typer.Option("--ellipses", help="Draw the ellipse that holds each landmark with 95 % probability.")
    ] = False,
    camera_file: Annotated[
        Path | None, typer.Option("--camera", help="Camera file of these images' camera, if not the training camera's.")
    ] = None,
    response: Annotated[
        str | None, typer.Option(help="Response of these images' camera, if not the training camera's.")
    ] = None,
) -> None:
    """Fit a model to images; writes landmarks (.pts, .csv, .json) and an overlay picture for each."""
    from liaam.fitting import Fitter, SolverOptions
    from liaam.io import make_folder
    from liaam.model import load_model
    from liaam.workers import all_cores, in_order, one_blas_thread, one_thread

    if every and init is not None:
        raise LiaamError("--all searches for all objects, and --init says where one is; leave one of them out")
    options, model = SolverOptions(max_iterations=iterations), load_model(model_file)
    camera = camera_for(images, camera_file, response, model.camera)
    fitter = Fitter(model, method, options, camera=camera, rotations=rotations)
    make_folder(output)
    table = table_of("image", "start", "status", "quality", "error", "iterations", "theta")
    advice: dict[str, list[str]] = {}
    failed = 0
    writing = Writing(output, history, ellipses)

    def results_of(named: tuple[Path, str]) -> "list[FitResult] | LiaamError":
        try:
            return fit_file(fitter, named[0], init, every, writing, named[1])
        except LiaamError as error:
            return error

    threads = min(len(images), all_cores())
    # The search of a single picture may have all cores.
    with one_thread() if threads > 1 else one_blas_thread(), progress_bar() as tell:
        tell(0, len(images), images[0].name)
        done = in_order(results_of, zip(images, unique_stems(images), strict=True), threads)
        for i, (image, results) in enumerate(zip(images, done, strict=True), 1):
            tell(i, len(images), image.name)
            if isinstance(results, LiaamError):
                failed += 1
                complain(f"error: {results}")
                continue
            for result in results:
                table.add_row(cell(image.name), *row_of(result))
                if not result.status.ok:
                    failed += 1
                    advice.setdefault(f"{result.status}: {result.message}", []).append(image.name)
                if result.place_doubtful:
                    advice.setdefault(DOUBT, []).append(image.name)
    if table.row_count:
        console.print(table)
        say(f"written to {output}")
    for text, names in advice.items():
        complain(f"{', '.join(names[:5])}{' …' if len(names) > 5 else ''}: {text}")
    if failed:
        raise typer.Exit(1)


def row_of(result: "FitResult") -> tuple[str, ...]:
    """Start, status, quality, typical error of a landmark, iterations and angle of a fit, for the table."""
    import numpy as np

    start = "given" if result.found is None else f"found, {result.found.score:.2f}"
    angle = f"{angle_degrees(result):.1f}°" if angle_degrees(result) is not None else "–"
    quality = "unknown" if np.isnan(result.quality) else f"{result.quality:.2f}"
    error = f"{np.median(result.deviations):.1f} px" if result.status.ok else "–"
    return start, str(result.status), quality, error, str(result.n_iterations), angle


@dataclass(frozen=True)
class Writing:
    """Where results of fits go, and what is written beside landmarks and picture."""

    folder: Path
    history: bool = False
    ellipses: bool = False


def fit_file(
    fitter: "Fitter", image: Path, init: str | None, every: bool, writing: Writing, stem: str
) -> "list[FitResult]":
    """Fit one image file, from the start that is given, the one that is found, or all of these."""
    from liaam.io import read_image

    if not every:
        refuse_to_overwrite(writing.folder, stem)
        pixels = read_image(image)
        start = None if init is None else read_init(init, image, pixels.shape[1::-1])
        return [fit_one(fitter, pixels, start, image, writing, stem)]
    pixels = read_image(image)
    found = fitter.find_all(pixels, name=image.name)
    stems = [f"{stem}_{i}" for i in range(1, len(found) + 1)]
    for name in stems:
        refuse_to_overwrite(writing.folder, name)
    return [fit_one(fitter, pixels, start, image, writing, name) for start, name in zip(found, stems, strict=True)]


def fit_one(fitter: "Fitter", pixels: "np.ndarray", start, image: Path, writing: Writing, stem: str) -> "FitResult":
    """Fit one object of an image and write what belongs to it."""
    from liaam.io import Contour, Landmarks, write_fit, write_image
    from liaam.plotting import overlay

    model = fitter.model
    result = fitter.fit(pixels, start, image.name)
    contours = tuple(Contour(indices, closed) for indices, closed in model.contours)
    write_fit(writing.folder, stem, Landmarks(result.shape, contours), result.facts(image.name))
    drawn = result.landmark_covariances if writing.ellipses else None
    write_image(writing.folder / f"{stem}_fit.png", overlay(pixels, result.shape, model, covariances=drawn))
    if writing.history:
        write_history(writing.folder / f"{stem}_history.csv", result)
    return result


def refuse_to_overwrite(output: Path, stem: str) -> None:
    """Complain if landmarks that no fit has written would be lost (a person's own annotations, say)."""
    if (output / f"{stem}_fit.png").exists():  # an earlier fit's results may be renewed
        return
    for suffix in (".pts", ".csv", ".json"):
        if (output / f"{stem}{suffix}").exists():
            raise LiaamError(
                f"{output / stem}{suffix} exists and is not from an earlier fit; give another folder with -o to keep it"
            )


def angle_degrees(result: "FitResult") -> float | None:
    """Estimated angle of the image's camera in degrees, or None for methods without one."""
    from liaam.fitting.angles import angle_degrees as degrees

    return degrees(result)


def write_history(path: Path, result: "FitResult") -> None:
    """Write one row per accepted iteration: level, cost, theta, and all landmarks."""
    import numpy as np

    from liaam.io import write_text_atomically

    n = len(result.shape)
    lines = [",".join(["iteration", "level", "cost", "theta_deg", *(f"{a}{i}" for i in range(n) for a in "xy")])]
    for i, step in enumerate(result.history):
        theta = f"{np.rad2deg(step.theta):.4f}" if np.isfinite(step.theta) else ""
        coordinates = (f"{v:.3f}" for v in step.shape.ravel())
        lines.append(",".join([str(i), str(step.level), f"{step.cost:.8g}", theta, *coordinates]))
    write_text_atomically(path, "\n".join(lines) + "\n")


@app.command()
def show(
    file: Annotated[Path, typer.Argument(help="Model of 'liaam train', or lamps of 'liaam lamps'.")],
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Picture to write; beside the file if left out.")
    ] = None,
    image: Annotated[
        Path | None,
        typer.Option(help="Lamps: picture to draw them on, with landmarks beside it; plain grey if left out."),
    ] = None,
) -> None:
    """Draw a model: mean, mesh, and what its shape and appearance modes do. Or lamps: a picture under all of them."""
    from liaam.io.files import existing_file

    existing_file(file, LiaamError, "model or file of lamps")
    lit = file.suffix.lower() == LAMPS_SUFFIX
    path = output or file.with_name(f"{file.stem}_{'lamps' if lit else 'model'}.png")
    if path.suffix.lower() not in (".png", ".svg", ".pdf"):
        raise LiaamError(f"{path}: give a picture file that ends in .png, .svg or .pdf")
    if lit:
        draw_lamps(read_lamps(file), path, None if image is None else read_sample(image))
    else:
        from liaam.model import load_model
        from liaam.plotting import figure_of_model, save_figure

        if image is not None:
            raise LiaamError("--image is for lamps; a model is drawn by itself")
        save_figure(figure_of_model(load_model(file)), path)
    say(f"written to {path}")


@app.command()
def info(
    model_file: Annotated[Path, typer.Argument(metavar="MODEL", help="Model file of 'liaam train'.")],
) -> None:
    """Describe a model file."""
    from liaam.model import load_model

    table = Table.grid(padding=(0, 2))
    for key, value in describe(load_model(model_file), model_file).items():
        table.add_row(key, cell(value))
    console.print(table)


def _count_modes(model: "AAM") -> str:
    """Shape modes, and those of views with others than the mesh."""
    counts = {name: len(view.shape_model.modes) for name, view in model.views.items()}
    others = [f"{count} of {name}" for name, count in counts.items() if count != len(model.shape_model.modes)]
    return f"{len(model.shape_model.modes)}" + (f" ({', '.join(others)})" if others else "")


def describe(model: "AAM", path: Path) -> dict[str, str]:
    """Facts of a model in words."""
    import numpy as np

    appearances = model.levels[-1].appearances
    spread = np.sqrt((model.shape_model.eigenvalues.sum()) / model.n_points)
    width, height = model.frame.size
    return {
        "model": f"{model.name or path.stem} ({path.stat().st_size / 1e6:.1f} MB)",
        "trained on": f"{model.n_images} {'colour' if model.is_colour else 'grey'} images{_copies(model)}",
        "landmarks": f"{model.n_points}, in {len(model.triangles)} triangles and {len(model.contours)} contours",
        "shape modes": f"{_count_modes(model)} + 4 (position, size, turn); spread {spread:.1f} px",
        "appearance modes": ", ".join(f"{a.n_modes} {name}" for name, a in appearances.items()),
        "reference frame": f"{width}×{height} px, {model.n_pixels} inside the mesh",
        "levels": "blur " + ", ".join(f"{level.blur:g}" for level in model.levels) + " px, coarse to fine",
        "camera": describe_camera(model.camera),
    }


def _copies(model: "AAM") -> str:
    """Copies of the images that a model has learnt from, too."""
    more = model.n_textures - model.n_images
    return f", and {more} copies of them, mirrored or under other lamps" if more > 0 else ""


def describe_camera(camera: "CameraModel") -> str:
    """What is known of a camera, in a line."""
    import numpy as np

    error = "assumed" if camera.theta_deviation is None else f"± {np.rad2deg(camera.theta_deviation):.2f}°"
    response = camera.response if isinstance(camera.response, (str, float)) else "measured"
    known = [name for name in ("vignetting", "noise") if getattr(camera, name)]
    return f"response {response}, theta {np.rad2deg(camera.theta):.1f}° ({error})" + "".join(f", {n}" for n in known)


@app.command()
def methods() -> None:
    """List the fitting methods."""
    from liaam.fitting import METHODS
    from liaam.fitting.losses import LOSSES
    from liaam.fitting.methods import NOISE_SUFFIX

    table = table_of("method", "compares", "what it is")
    for method in METHODS.values():
        table.add_row(method.name, f"{method.encoding}, {method.metric}", method.summary)
    console.print(table)
    say(
        f"Any of them stands occlusion with one of {', '.join(f'+{name}' for name in LOSSES)}, such as grey+tukey; "
        f"those of logarithms weigh pixels by the picture's noise with +{NOISE_SUFFIX}, such as li+{NOISE_SUFFIX}."
    )


@app.command()
def demo(
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder for the figure.")] = Path("liaam-demo"),
) -> None:
    """Train on simulated portraits under one light, fit under another: grey and RGB drift, LI holds."""
    from liaam.demo import run_demo

    with progress_bar() as tell:
        rows, start_error = run_demo(output, tell)
    table = table_of("method", "error (px)", "status", "theta")
    table.add_row("start", f"{start_error:.2f}", "", "")
    for row in rows:
        angle = angle_degrees(row.result)
        table.add_row(row.method, f"{row.error:.2f}", str(row.result.status), f"{angle:.1f}°" if angle else "–")
    console.print(table)
    say(f"written to {output / 'figure.png'}")


def main() -> None:
    """Run the command line; errors become one line and an exit status."""
    run_app(app)


if __name__ == "__main__":
    main()
