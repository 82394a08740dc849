"""The command ``liaam fit``."""

from collections import defaultdict
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer
from rich.table import Table
from typer.core import TyperCommand

from liaam.cli import inputs
from liaam.cli.terminal import cell, complain, progress_bar, say, show_table, table_of
from liaam.errors import LiaamError
from liaam.io import IMAGE_SUFFIXES, Contour, Landmarks, make_folder, write_image
from liaam.io.atomic import is_disk_full
from liaam.io.files import count_of
from liaam.io.fit_files import FIT_SUFFIXES, corrected_file, read_fit, write_fit
from liaam.morphometry.schemes import in_scheme
from liaam.scale.choice import facts_of, length_for

if TYPE_CHECKING:
    from liaam.fitting import FitResult, Fitter

# Facts of a fit on its own landmarks, which are not written with those of another scheme
OF_LANDMARKS = ("landmark_names", "sd", "covariance", "present")


class FitCommand(TyperCommand):
    """The command with the table of methods at the end of its help."""

    @property
    def epilog(self) -> str:  # the engine is loaded for the help only
        """Lines on all methods."""
        from liaam.fitting import METHODS
        from liaam.fitting.methods import LOSSES, NOISE_SUFFIX

        methods = [f"{method.name}: {method.summary}" for method in METHODS.values()]
        losses = ", ".join(f"+{name}" for name in LOSSES)
        suffixes = (
            f"For occlusion, add a robust loss to any method, as in grey+tukey: {losses}. Methods on logarithms can "
            f"also weight pixels by image noise: +{NOISE_SUFFIX}, as in li+{NOISE_SUFFIX}."
        )
        return "\n\n".join(["Methods:", *methods, suffixes])

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
    absent: inputs.AbsentOption = "empty",
    given_camera: inputs.CameraOption = None,
) -> None:
    """Fit a model to images. Writes the landmarks and an overlay image for each."""
    from liaam.fitting import Fitter
    from liaam.fitting.result import check_absent
    from liaam.model import load_model
    from liaam.workers import all_cores, in_order, one_blas_thread, one_thread

    if every and init is not None:
        raise LiaamError("--all searches for every object and --init gives the place of one; use only one of them")
    model_file, images = inputs.model_and_inputs(files, "fit")
    if folder := next((image for image in images if image.is_dir()), None):
        raise LiaamError(f"{folder} is a folder; give its images, such as {folder}/*.png, or use 'liaam batch'")
    check_absent(absent)
    outputs = Outputs.asked(
        output, formats, ellipses=ellipses, scheme=scheme, absent=absent, several=len(images) > 1 or every
    )
    inputs.refuse_inputs([output], images)
    model = load_model(model_file)
    camera = inputs.camera_for(images, given_camera, model.camera)
    fitter = Fitter(model, method, camera=camera, rotations=rotations)
    if scheme is not None:
        in_scheme(model.shape_model.mean, model.landmark_names, scheme)  # its errors come before any work
    make_folder(outputs.folder)

    def fit_or_error(image_and_stem: tuple[Path, str]) -> "dict[str, FitResult] | LiaamError":
        """Fit an image file. An error is returned, so that the other images are fitted all the same."""
        image, stem = image_and_stem
        try:
            return fit_file(fitter, image, stem, init=init, every=every, outputs=outputs)
        except LiaamError as error:
            return error

    report = FitReport(every=every, rotations=rotations)
    threads = min(len(images), all_cores())
    # With a single image, its search may use all cores.
    with one_thread() if threads > 1 else one_blas_thread(), progress_bar() as progress:
        progress(0, len(images), images[0].name)
        tasks = zip(images, inputs.unique_stems(images), strict=True)
        with closing(in_order(fit_or_error, tasks, threads)) as outcomes:  # at a full disk, fits under way end first
            for i, (image, outcome) in enumerate(zip(images, outcomes, strict=True), 1):
                progress(i, len(images), image.name)
                if not isinstance(outcome, LiaamError):
                    report.add_results(image, outcome)
                    continue
                report.add_error(outcome)
                if is_disk_full(outcome):  # the others would end like this
                    complain(f"stopped: {i - 1} of {len(images)} images are done; make room, and fit the others")
                    break
    report.show(output)
    if model.scale is not None and report.table.row_count:
        say(f"images that state no scale have that of the training images, {model.scale} per pixel")
    if report.failed:
        raise typer.Exit(1)


@dataclass
class FitReport:
    """What the command prints: a table of the fits, and below it advice with the names of the images concerned."""

    every: bool  # whether every object of an image is fitted
    rotations: str
    table: Table = field(
        default_factory=lambda: table_of("image", "start", "score", "status", "quality", "sd", "iterations", "theta")
    )
    advice: defaultdict[str, list[str]] = field(default_factory=lambda: defaultdict(list))
    uncalibrated: bool = False  # whether the quality of a fit is unknown
    failed: bool = False  # whether an image could not be read, or a fit failed

    def add_error(self, error: LiaamError) -> None:
        """Print why an image could not be fitted."""
        self.failed = True
        complain(f"error: {error}")

    def add_results(self, image: Path, results: "dict[str, FitResult]") -> None:
        """Add the fits of an image, by the names of their files."""
        for stem, result in results.items():
            # The only object of an image is named as the image. Of several, each is named as its files.
            name = image.name if stem == image.stem else stem
            self.table.add_row(cell(name), *row_of(result))
            if not result.calibrated:
                self.uncalibrated = True
            if not result.status.ok:
                self.failed = True
            for text in self.advice_on(result):
                self.advice[text].append(name)

    def advice_on(self, result: "FitResult") -> Iterator[str]:
        """Yield what may be wrong with a fit, and what to do about it."""
        if not self.every and result.n_found is not None and result.n_found > 1:
            others = count_of(result.n_found - 1, "more object")
            yield f"{others} in the image: add --all to fit each, or --init to choose one"
        if not result.status.ok:
            yield f"{result.status}: {result.message}"
        elif result.absent.any():
            yield "absent landmarks, which are empty in the files: see the message in .json, or give --absent estimate"
        if result.detection_doubtful and not result.status.unusable:
            yield inputs.LOW_SCORE + (inputs.TURNED if self.rotations == "upright" else "")

    def show(self, output: Path) -> None:
        """Print the table, if there is any fit, and the advice."""
        if self.table.row_count:
            show_table(self.table)
            if self.uncalibrated:
                say("the quality is unknown, and sd and ellipses are not calibrated: see 'liaam show MODEL'")
            say(f"written to {output}")
        inputs.say_advice(self.advice)


def row_of(result: "FitResult") -> tuple[str, ...]:
    """Return the table row of a fit: start, score, status, quality, median landmark sd, iterations and theta."""
    if result.found is None:
        start = "given"
        score = "–"
    else:
        # Where nothing was found, the fit started in the middle of the image.
        start = "searched" if result.found.score != 0 else "not found"
        score = f"{result.found.score:.2f}"
    sd = f"{np.median(result.sd):.1f} px" if result.status.ok else "–"
    theta = "–" if result.theta_degrees is None else f"{result.theta_degrees:.1f}°"
    return start, score, str(result.status), result.quality_text, sd, str(result.n_iterations), theta


@dataclass(frozen=True)
class Outputs:
    """What is written for each fit.

    Attributes
    ----------
    folder : Path
    suffixes : tuple of str
        Suffixes of the landmark files.
    picture : str, optional
        Ending of the name of the overlay image; by default none is written.
    stem : str, optional
        Name, without ending, of the only file that was asked for. By default files are named as their image.
    ellipses : bool
        Whether the overlay image shows the ellipses of landmarks.
    scheme : str, optional
        Scheme of the landmarks in the files; that of the model by default.
    absent : str
        What the files hold of absent landmarks (:data:`liaam.fitting.result.ABSENT`). Those of another scheme are
        computed from all landmarks, so that none is absent.
    """

    folder: Path
    suffixes: tuple[str, ...]
    picture: str | None = None
    stem: str | None = None
    ellipses: bool = False
    scheme: str | None = None
    absent: str = "empty"

    @classmethod
    def asked(
        cls, output: Path, formats: str, *, ellipses: bool, scheme: str | None, absent: str, several: bool
    ) -> "Outputs":
        """Take -o as one file if its suffix is that of one, and else as a folder for files of --format."""
        suffixes = tuple(f".{name.strip().lower().removeprefix('.')}" for name in formats.split(","))
        for suffix in suffixes:
            if suffix not in FIT_SUFFIXES:
                raise LiaamError(f"--format {suffix[1:]} is unknown; choose from json, pts, csv and tps")
        is_picture = output.suffix.lower() in IMAGE_SUFFIXES
        is_landmark_file = output.suffix.lower() in FIT_SUFFIXES
        if output.is_dir() or not (is_picture or is_landmark_file):
            return cls(output, suffixes, picture="_fit.png", ellipses=ellipses, scheme=scheme, absent=absent)
        if several:
            raise LiaamError(f"{output} is one file; give a folder with -o, since there may be several results")
        return cls(
            folder=output.parent,
            suffixes=() if is_picture else (output.suffix,),
            picture=output.suffix if is_picture else None,
            stem=output.stem,
            ellipses=ellipses,
            scheme=scheme,
            absent=absent,
        )

    def path_of(self, name: str, ending: str) -> Path:
        """Return the path of a file for the fit of a name."""
        return self.folder / f"{self.stem or name}{ending}"


def fit_file(
    fitter: "Fitter", image: Path, stem: str, *, init: str | None, every: bool, outputs: Outputs
) -> "dict[str, FitResult]":
    """Fit an image file from `init`, from the start that the search finds, or from `every` start it finds.

    Return the results by the name of their files, which is ``stem``, or begins with it if `every` object is fitted.
    """
    pixels, start = inputs.read_with_start(image, init)
    if every:
        detections = fitter.find_all(pixels, name=image.name)
        starts = {f"{stem}_{i}": detection for i, detection in enumerate(detections, 1)}
    else:
        starts = {stem: start}
    for name in starts:
        refuse_to_overwrite([outputs.path_of(name, suffix) for suffix in outputs.suffixes])
    return {name: fit_object(fitter, image, pixels, start, name, outputs) for name, start in starts.items()}


def fit_object(
    fitter: "Fitter", image: Path, pixels: np.ndarray, start: Any, name: str, outputs: Outputs
) -> "FitResult":
    """Fit one object of an image file, and write the results to files of a name."""
    from liaam.plotting import overlay

    model = fitter.model
    result = fitter.fit(pixels, start, image.name)
    length = length_for(image, start, model.scale)
    scale = None if length is None else length.value
    unit = "" if length is None else length.unit
    facts = result.to_dict(outputs.absent) | {"image": image.name} | facts_of(length)
    if outputs.scheme is None:
        landmarks = Landmarks(
            points=result.reported(outputs.absent)[0],
            contours=Contour.all_of(model.contours),
            names=result.landmark_names,
            image_name=image.name,
            invisible=tuple(np.flatnonzero(result.absent).tolist()) if outputs.absent == "estimate" else (),
            scale=scale,
            unit=unit,
        )
    else:
        points = in_scheme(result.landmarks, result.landmark_names, outputs.scheme)
        landmarks = Landmarks(points, image_name=image.name, scale=scale, unit=unit)
        facts = {key: value for key, value in facts.items() if key not in OF_LANDMARKS}
    height, width = pixels.shape[:2]
    with all_or_none([outputs.path_of(name, suffix) for suffix in outputs.suffixes]) as paths:
        for path in paths:
            write_fit(path, landmarks, facts, (width, height))
        if outputs.picture is not None:
            covariances = result.landmark_covariances if outputs.ellipses else None
            picture = overlay(pixels, result.landmarks, model, covariances=covariances, absent=result.absent)
            write_image(outputs.path_of(name, outputs.picture), picture)
    return result


@contextmanager
def all_or_none(paths: list[Path]) -> Iterator[list[Path]]:
    """Yield the paths of the files of a fit. If the block fails, remove those that it made, which would lack others."""
    new = [path for path in paths if not path.exists()]
    try:
        yield paths
    except LiaamError:
        for path in new:
            path.unlink(missing_ok=True)
        raise


def refuse_to_overwrite(paths: list[Path]) -> None:
    """Raise if landmarks that no earlier fit wrote, or that were corrected since, would be overwritten."""
    for path in paths:
        fit_path = path.with_suffix(".json")
        earlier_fit = read_fit(fit_path)
        if earlier_fit is None:
            if path.exists():
                raise LiaamError(
                    f"{path} exists and is not from an earlier fit; give another -o to keep it, or remove it"
                )
            continue
        # The results of an earlier fit may be replaced, unless someone worked on them.
        if corrected := corrected_file(fit_path, earlier_fit):
            raise LiaamError(f"{corrected}: its points were changed after the fit; give another -o to keep them")
