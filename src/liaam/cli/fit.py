"""The command ``liaam fit``."""

from collections import defaultdict
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer
from typer.core import TyperCommand

from liaam.cli import inputs
from liaam.cli.terminal import cell, complain, progress_bar, say, show_table, table_of
from liaam.errors import LiaamError
from liaam.fitting.files import FIT_SUFFIXES, corrected_file, read_fit, write_fit
from liaam.io import IMAGE_SUFFIXES, Contour, Landmarks, make_folder, write_image
from liaam.io.files import count_of
from liaam.morphometry.schemes import in_scheme

if TYPE_CHECKING:
    from liaam.fitting import FitResult, Fitter

OF_LANDMARKS = ("landmark_names", "sd", "covariance")  # Facts of a fit of which another scheme has none


class FitCommand(TyperCommand):
    """The command with the table of methods at the end of its help."""

    @property
    def epilog(self) -> str:  # the engine is loaded for the help only
        """Lines on all methods."""
        from liaam.fitting import METHODS
        from liaam.fitting.methods import LOSSES, NOISE_SUFFIX

        return "\n\n".join(
            [
                "Methods:",
                *(f"{method.name}: {method.summary}" for method in METHODS.values()),
                "For occlusion, add a robust loss to any method, as in grey+tukey: "
                f"{', '.join(f'+{name}' for name in LOSSES)}. Methods on logarithms can also weight pixels by image "
                f"noise: +{NOISE_SUFFIX}, as in li+{NOISE_SUFFIX}.",
            ]
        )

    @epilog.setter
    def epilog(self, _text: str | None) -> None:
        pass


def fit(
    files: inputs.ModelAndImages,
    init: Annotated[
        str | None,
        typer.Option(
            help="Where to start: a box x0,y0,x1,y1 around the landmarks; a centre and the box's diagonal x,y,size; "
            "a landmark file, of the landmarks or of the points of 'liaam train --points'; a folder with a landmark "
            "file per image; or mediapipe. By default the object is searched for."
        ),
    ] = None,
    every: Annotated[
        bool, typer.Option("--all", help="Fit every object that the search finds; results are NAME_1, NAME_2 ...")
    ] = False,
    method: Annotated[str, typer.Option("--method", "-m", help="Fitting method; they are listed below.")] = "soft-li",
    output: Annotated[
        Path,
        typer.Option(
            "--output",
            "-o",
            help="Folder for a landmark file and a picture of each image; or, for one image, the only file to write: "
            f"{', '.join(FIT_SUFFIXES)}, or a picture.",
        ),
    ] = Path("liaam-fits"),
    formats: Annotated[
        str,
        typer.Option(
            "--format",
            help="Landmark files to write into the folder: json (with covariances, quality and status), pts, csv or "
            "tps, or several, such as json,tps.",
        ),
    ] = "json",
    scheme: Annotated[
        str | None,
        typer.Option(help="Write the landmarks of another scheme instead: ibug-68, from those of the model 'face'."),
    ] = None,
    rotations: inputs.RotationsOption = "upright",
    ellipses: inputs.EllipsesOption = False,
    given_camera: inputs.CameraOption = None,
) -> None:
    """Fit a model to images. Writes the landmarks and an overlay image for each."""
    from liaam.fitting import Fitter
    from liaam.model import load_model
    from liaam.workers import all_cores, in_order, one_blas_thread, one_thread

    if every and init is not None:
        raise LiaamError("--all searches for every object and --init gives the place of one; use only one of them")
    model_file, images = inputs.model_and_inputs(files, "fit")
    if folder := next((image for image in images if image.is_dir()), None):
        raise LiaamError(f"{folder} is a folder; give its images, such as {folder}/*.png, or use 'liaam batch'")
    outputs = Outputs.asked(output, formats, ellipses, scheme, len(images) > 1 or every)
    inputs.refuse_inputs([output], images)
    model = load_model(model_file)
    camera = inputs.camera_for(images, given_camera, model.camera)
    fitter = Fitter(model, method, camera=camera, rotations=rotations)
    if scheme is not None:
        in_scheme(model.shape_model.mean, model.landmark_names, scheme)  # its errors come before any work
    make_folder(outputs.folder)
    table = table_of("image", "start", "score", "status", "quality", "sd", "iterations", "theta")
    advice: defaultdict[str, list[str]] = defaultdict(list)
    failed, uncalibrated = 0, False
    low_score = inputs.LOW_SCORE + (inputs.TURNED if rotations == "upright" else "")

    results_of = partial(fit_file, fitter, init, every, outputs)
    threads = min(len(images), all_cores())
    # With a single image, its search may use all cores.
    with one_thread() if threads > 1 else one_blas_thread(), progress_bar() as progress:
        progress(0, len(images), images[0].name)
        done = in_order(results_of, zip(images, inputs.unique_stems(images), strict=True), threads)
        for i, (image, results) in enumerate(zip(images, done, strict=True), 1):
            progress(i, len(images), image.name)
            if isinstance(results, LiaamError):
                failed += 1
                complain(f"error: {results}")
                continue
            for stem, result in results.items():
                name = image.name if stem == image.stem else stem  # of several, as their files
                table.add_row(cell(name), *row_of(result))
                uncalibrated |= not result.calibrated
                if not every and result.n_found is not None and result.n_found > 1:
                    more = f"{count_of(result.n_found - 1, 'more object')} in the image"
                    advice[f"{more}: add --all to fit each, or --init to choose one"].append(name)
                if not result.status.ok:
                    failed += 1
                    advice[f"{result.status}: {result.message}"].append(name)
                if result.detection_doubtful and not result.status.unusable:
                    advice[low_score].append(name)
    if table.row_count:
        show_table(table)
        if uncalibrated:
            say("the quality is unknown, and sd and ellipses are not calibrated: see 'liaam show MODEL'")
        say(f"written to {output}")
    inputs.say_advice(advice)
    if failed:
        raise typer.Exit(1)


def row_of(result: "FitResult") -> tuple[str, ...]:
    """Return the table row of a fit: start, score, status, quality, median landmark sd, iterations and theta."""
    start, score = ("given", "–") if result.found is None else ("searched", f"{result.found.score:.2f}")
    if result.found is not None and result.found.score == 0:  # its start is the middle of the image
        start = "not found"
    angle = "–" if result.theta_degrees is None else f"{result.theta_degrees:.1f}°"
    sd = f"{np.median(result.sd):.1f} px" if result.status.ok else "–"
    return start, score, str(result.status), result.quality_text, sd, str(result.n_iterations), angle


@dataclass(frozen=True)
class Outputs:
    """What is written for each image: files of these suffixes in a folder, or the only file of a given stem."""

    folder: Path
    suffixes: tuple[str, ...]
    picture: str | None = "_fit.png"
    stem: str | None = None
    ellipses: bool = False
    scheme: str | None = None

    @classmethod
    def asked(cls, output: Path, formats: str, ellipses: bool, scheme: str | None, several: bool) -> "Outputs":
        """Take -o as one file if its suffix is that of one, and else as a folder for files of --format."""
        suffix = output.suffix.lower()
        suffixes = tuple(f".{name.strip().lower().removeprefix('.')}" for name in formats.split(","))
        if unknown := [each for each in suffixes if each not in FIT_SUFFIXES]:
            raise LiaamError(f"--format {unknown[0][1:]} is unknown; choose from json, pts, csv and tps")
        if output.is_dir() or suffix not in (*FIT_SUFFIXES, *IMAGE_SUFFIXES):
            return cls(output, suffixes, ellipses=ellipses, scheme=scheme)
        if several:
            raise LiaamError(f"{output} is one file; give a folder with -o, since there may be several results")
        picture = output.suffix if suffix in IMAGE_SUFFIXES else None
        return cls(output.parent, () if picture else (output.suffix,), picture, output.stem, ellipses, scheme)


def fit_file(
    fitter: "Fitter", init: str | None, every: bool, outputs: Outputs, named: tuple[Path, str]
) -> "dict[str, FitResult] | LiaamError":
    """Fit an image file from `init`, from the start that the search finds, or from `every` start it finds.

    ``named`` are the file and the name of its results. Return them by the name of their files, or an error.
    """
    from liaam.plotting import overlay

    (image, stem), model, results = named, fitter.model, {}
    try:
        pixels, start = inputs.read_with_start(image, init)
        starts = {stem: start}
        if every:
            starts = {f"{stem}_{i}": found for i, found in enumerate(fitter.find_all(pixels, name=image.name), 1)}
        for name in starts:
            refuse_to_overwrite([outputs.folder / f"{outputs.stem or name}{suffix}" for suffix in outputs.suffixes])
        for name, start in starts.items():
            results[name] = result = fitter.fit(pixels, start, image.name)
            points, contours, names = result.landmarks, Contour.all_of(model.contours), result.landmark_names
            scale = start.scale if isinstance(start, Landmarks) else None
            facts = result.to_dict() | {"image": image.name, "scale": scale}
            if outputs.scheme is not None:
                points, contours, names = in_scheme(points, names, outputs.scheme), (), ()
                facts = {key: value for key, value in facts.items() if key not in OF_LANDMARKS}
            landmarks = Landmarks(points, contours, names, image_name=image.name, scale=scale)
            path = outputs.folder / (outputs.stem or name)
            for suffix in outputs.suffixes:
                write_fit(path.with_name(path.name + suffix), landmarks, facts, pixels.shape[1::-1])
            if outputs.picture:
                drawn = result.landmark_covariances if outputs.ellipses else None
                picture = overlay(pixels, result.landmarks, model, covariances=drawn)
                write_image(path.with_name(path.name + outputs.picture), picture)
    except LiaamError as error:
        return error
    return results


def refuse_to_overwrite(paths: list[Path]) -> None:
    """Raise if landmarks that no earlier fit wrote, or that were corrected since, would be overwritten."""
    for path in paths:
        known = path.with_suffix(".json")
        if fit := read_fit(known):  # results of an earlier fit may be replaced
            if corrected := corrected_file(known, fit):
                raise LiaamError(f"{corrected}: its points were changed after the fit; give another -o to keep them")
        elif path.exists():
            raise LiaamError(f"{path} exists and is not from an earlier fit; give another -o to keep it, or remove it")
