"""The command ``liaam fit``."""

from collections import Counter, defaultdict
from collections.abc import Container, Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer
from rich.table import Table
from typer.core import TyperCommand

from liaam.batch.report import REPORT_SUFFIXES, Entry, entry_of_error, entry_of_fit, refuse_other_page, write_entries
from liaam.batch.run import in_words
from liaam.batch.work import ERROR
from liaam.cli import inputs
from liaam.cli.terminal import cell, complain, progress_bar, say, show_table, table_of
from liaam.errors import LiaamError
from liaam.io import IMAGE_SUFFIXES, Contour, Landmarks, make_folder, write_image
from liaam.io.atomic import is_disk_full
from liaam.io.files import count_of, some_names
from liaam.io.fit_files import (
    FIT_SUFFIXES,
    STATELESS,
    corrected_file,
    image_facts,
    is_of_other_image,
    read_fit,
    write_fit,
)
from liaam.io.overlays import CROP, OVERLAYS, is_overlay
from liaam.morphometry.schemes import in_scheme
from liaam.scale.choice import facts_of
from liaam.scale.lengths import Length
from liaam.trays.crops import crop_box
from liaam.trays.naming import POSITION, check_name_by

if TYPE_CHECKING:
    from liaam.fitting import FitResult, Fitter
    from liaam.fitting.specimens import FittedSpecimens
    from liaam.model import AAM

MOST_PNG_PIXELS = 2_000_000
"""Pixels of an overlay above which it is a JPEG, of about 1 MB instead of 4 MB."""

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
        bool,
        typer.Option(
            "--all",
            help="Fit every object that the search finds, and at least the one that is fitted without --all; results "
            "are NAME_1, NAME_2 ...",
        ),
    ] = False,
    name_by: inputs.NameByOption = "position",
    crops: Annotated[
        bool, typer.Option("--crops", help="Also write the part of the image around each object, NAME_crop.png.")
    ] = False,
    method: Annotated[str, typer.Option("--method", "-m", help="Fitting method; they are listed below.")] = "soft-li",
    output: Annotated[
        Path,
        typer.Option(
            "--output",
            "-o",
            help="Folder for a landmark file and a picture of each image; or, for one image, the only file to write: "
            f"{', '.join(FIT_SUFFIXES)}, or a picture. Or a web page with all fits: report.html.",
        ),
    ] = Path("liaam-fits"),
    formats: Annotated[
        str,
        typer.Option(
            "--format",
            help="Landmark files to write into the folder: json (with covariances, quality and status), csv (with the "
            "status), pts or tps, or several, such as json,tps. Fits that may not be used are written as pts or tps "
            "only beside their json.",
        ),
    ] = "json",
    scheme: Annotated[
        str | None,
        typer.Option(help="Write the landmarks of another scheme instead: ibug-68, from those of the model 'face'."),
    ] = None,
    rotations: inputs.RotationsOption = None,
    side: inputs.SideOption = inputs.AUTO,
    ellipses: inputs.EllipsesOption = False,
    numbers: Annotated[bool, typer.Option("--numbers", help="Draw the number of each landmark, from 1.")] = False,
    names: Annotated[
        bool, typer.Option("--names", help="Draw the name of each landmark, if the model has any.")
    ] = False,
    mesh: Annotated[bool, typer.Option("--mesh", help="Draw the triangles between the landmarks.")] = False,
    absent: inputs.AbsentOption = "empty",
    given_camera: inputs.CameraOption = None,
) -> None:
    """Fit a model to images, or to those of folders. Writes the landmarks and an overlay image for each.

    Overlays are green if the fit may be used, amber if it is doubtful, and red if it failed. The exit status is 1
    unless all fits may be used.
    """
    from liaam.fitting import Fitter
    from liaam.fitting.result import check_absent
    from liaam.model import load_model
    from liaam.workers import all_cores, in_order, one_blas_thread, one_thread

    if every and init is not None:
        raise LiaamError("--all searches for every object and --init gives the place of one; use only one of them")
    model_file, paths = inputs.model_and_inputs(files, "fit")
    images = inputs.given_images(paths)
    check_name_by(name_by)
    check_absent(absent)
    outputs = Outputs.asked(output, formats, scheme=scheme, several=len(images) > 1 or every)
    if crops and outputs.only is not None:
        raise LiaamError(f"{output} is one file, and --crops writes more; give a folder with -o")
    if outputs.report is not None:
        of_files = {"ellipses": ellipses, "numbers": numbers, "names": names, "mesh": mesh, "format": formats != "json"}
        refuse_for_page(output, [name for name, is_given in of_files.items() if is_given])
    outputs = replace(outputs, name_by=name_by, crops=crops, absent=absent)
    inputs.refuse_inputs([output], images)
    model = load_model(model_file)
    outputs = replace(outputs, look=look_of(model, ellipses=ellipses, numbers=numbers, names=names, mesh=mesh))
    camera = inputs.camera_for(images, given_camera, model.camera)
    fitter = Fitter(model, method, camera=camera, rotations=rotations, side=side)
    if scheme is not None:
        in_scheme(model.shape_model.mean, model.landmark_names, scheme)  # its errors come before any work
    make_folder(outputs.folder)
    stems = inputs.unique_stems(images)
    refuse_fits_of_others(images, stems, outputs, every=every)

    def fit_or_error(task: tuple[Path, str, str]) -> "tuple[FittedSpecimens, list[str]] | LiaamError":
        """Fit an image file. An error is returned, so that the other images are fitted all the same."""
        image, name, stem = task
        try:
            return fit_file(fitter, image, stem, name=name, init=init, every=every, outputs=outputs)
        except LiaamError as error:
            return error

    alone = "" if len(images) == 1 else inputs.ALONE
    if alone and outputs.report is None and stems == [image.stem for image in images]:
        alone += ", with the same -o"  # replaces their files, which are named alike
    ways = inputs.other_ways(model, side, rotations, alone)
    report = FitReport(every=every, other_ways=ways, on_absent=outputs.on_absent, on_unusable=outputs.on_unusable)
    threads = min(len(images), all_cores())
    # With a single image, its search may use all cores.
    with one_thread() if threads > 1 else one_blas_thread(), progress_bar() as progress:
        progress(0, len(images), images[0].name)
        tasks = zip(images, inputs.names_in_folders(images), stems, strict=True)
        with closing(in_order(fit_or_error, tasks, threads)) as outcomes:  # at a full disk, fits under way end first
            for i, (image, outcome) in enumerate(zip(images, outcomes, strict=True), 1):
                progress(i, len(images), image.name)
                if not isinstance(outcome, LiaamError):
                    report.add_results(image, *outcome)
                    continue
                report.add_error(outcome)
                outputs.add_error(outcome, image)
                if is_disk_full(outcome):  # the others would end like this
                    complain(f"stopped: {i - 1} of {len(images)} images are done; make room, and fit the others")
                    break
    outputs.write_report(model, paths)
    is_written = outputs.only is None or outputs.only.exists()
    report.show(output if is_written else None, on_page=outputs.report is not None)
    if earlier := outputs.earlier_fits(report.names):
        say(f"{outputs.folder} also holds {count_of(len(earlier), 'fit')} of earlier runs: {some_names(earlier)}")
    if model.scale is not None and report.rows:
        say(f"images that state no scale have that of the training images, {model.scale} per pixel")
    if report.failed:
        inputs.say_if_no_model(files, "fit")
        raise typer.Exit(1)


def refuse_for_page(page: Path, options: list[str]) -> None:
    """Raise if options were given that change files of a folder, but not a web page."""
    if options:
        names = ", ".join(f"--{name}" for name in options)
        raise LiaamError(f"{page} shows every fit in one way: leave {names} out, or give a folder with -o")


@dataclass
class FitReport:
    """What the command prints: a table of the fits, and below it advice with the names of the images concerned."""

    every: bool  # whether every object of an image is fitted
    other_ways: str  # what to try for fits that may be wrong
    on_absent: str  # what is said of absent landmarks
    on_unusable: str  # what is said of fits that may not be used and are not written, or empty
    rows: list[dict[str, str]] = field(default_factory=list)  # cells by the name of their column
    names: set[str] = field(default_factory=set)  # of the files of the fits, without suffixes
    advice: defaultdict[str, list[str]] = field(default_factory=lambda: defaultdict(list))
    statuses: Counter[str] = field(default_factory=Counter)
    uncalibrated: bool = False  # whether the quality of a fit is unknown
    failed: bool = False  # whether an image could not be read, or a fit failed

    def add_error(self, error: LiaamError) -> None:
        """Print why an image could not be fitted."""
        self.failed = True
        self.statuses[ERROR] += 1
        complain(f"error: {error}")

    def add_results(self, image: Path, fitted: "FittedSpecimens", stems: list[str]) -> None:
        """Add the fits of an image, whose files have these names."""
        for fault in fitted.faults:
            self.advice[fault].append(image.name)
        self.names.update(stems)
        for stem, result in zip(stems, fitted.results, strict=True):
            # The only object of an image is named as the image. Of several, each is named as its files.
            name = image.name if stem == image.stem else stem
            self.rows.append({"image": name, **row_of(result)})
            self.statuses[str(result.status)] += 1
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
            if self.on_unusable:
                yield self.on_unusable
        elif result.absent.any():
            yield self.on_absent
        if result.status.ok and result.without_colour:
            yield "the image is grey, unlike those of training, so that its landmarks are less certain"
        if result.status.unusable or result.found is None:
            return
        if result.detection_doubtful:
            yield "; ".join(filter(None, (inputs.LOW_SCORE, self.other_ways)))
        elif not result.status.ok and result.calibrated and self.other_ways:
            yield self.other_ways

    def table(self) -> Table:
        """Return the table of all fits, without columns that are empty in all."""
        columns = [name for name in self.rows[0] if any(row[name] for row in self.rows)]
        table = table_of(*columns)
        for row in self.rows:
            table.add_row(*(cell(row[name] or "–") for name in columns))
        return table

    def show(self, output: Path | None, *, on_page: bool = False) -> None:
        """Print the table, if there is any fit, or if it is on a page the numbers of fits by status; and the advice."""
        if on_page:
            say(in_words(self.statuses))
        elif self.rows:
            show_table(self.table())
        if self.uncalibrated:
            say("the quality is unknown, and uncertainty and ellipses are not calibrated: see 'liaam show MODEL'")
        if output is not None and (self.rows or on_page):
            say(f"written to {output}")
        inputs.say_advice(self.advice)


def row_of(result: "FitResult") -> dict[str, str]:
    """Return the cells of a fit in the table by their column; they are empty where there is nothing to say."""
    if result.found is None:
        start = "given"
    elif result.found.score == 0:
        start = "not found"  # the fit started in the middle of the image
    else:
        start = f"searched (score {result.found.score:.2f})"
    return {
        "status": str(result.status),
        "quality": result.quality_text,
        "side": result.side,
        "uncertainty": f"± {np.median(result.sd):.1f} px" if result.status.ok else "",
        "start": start,
        "theta": "" if result.theta_degrees is None else f"{result.theta_degrees:.1f}°",
    }


def look_of(model: "AAM", *, ellipses: bool, numbers: bool, names: bool, mesh: bool) -> dict[str, Any]:
    """Return what an overlay shows, as arguments of :func:`liaam.plotting.overlay_of_fit`."""
    if numbers and names:
        raise LiaamError("--numbers and --names would be drawn on each other; use only one of them")
    if names and not model.landmark_names:
        raise LiaamError("--names: the model's landmarks have no names; use --numbers")
    labels = tuple(str(number) for number in range(1, model.n_points + 1)) if numbers else ()
    return {"ellipses": ellipses, "labels": model.landmark_names if names else labels, "mesh": mesh}


@dataclass(frozen=True)
class Outputs:
    """What is written for each fit.

    Attributes
    ----------
    folder : Path
    suffixes : tuple of str
        Suffixes of the landmark files.
    picture : bool
        Whether to write an overlay image.
    only : Path, optional
        The only file that was asked for. By default files are named as their image.
    look : dict
        What the overlay image shows, as arguments of :func:`liaam.plotting.overlay_of_fit`.
    scheme : str, optional
        Scheme of the landmarks in the files; that of the model by default.
    report : Path, optional
        Web page with all fits, instead of a file for each.
    entries : list of Entry
        Its fits and errors, in the order in which they are done.
    name_by : str
        What names the specimens (:data:`liaam.trays.NAME_BY`).
    crops : bool
        Whether the part of the image around each object is written.
    absent : str
        What the files hold of absent landmarks (:data:`liaam.fitting.result.ABSENT`). Those of another scheme are
        computed from all landmarks, so that none is absent.
    """

    folder: Path
    suffixes: tuple[str, ...]
    picture: bool = True
    only: Path | None = None
    look: dict[str, Any] = field(default_factory=dict)
    scheme: str | None = None
    report: Path | None = None
    entries: list[Entry] = field(default_factory=list)
    name_by: str = POSITION
    crops: bool = False
    absent: str = "empty"

    @classmethod
    def asked(cls, output: Path, formats: str, *, scheme: str | None, several: bool) -> "Outputs":
        """Take -o as one file if its suffix is that of one, and else as a folder for files of --format."""
        suffixes = tuple(f".{name.strip().lower().removeprefix('.')}" for name in formats.split(","))
        for suffix in suffixes:
            if suffix not in FIT_SUFFIXES:
                raise LiaamError(f"--format {suffix[1:]} is unknown; choose from json, pts, csv and tps")
        if output.suffix.lower() in REPORT_SUFFIXES and not output.is_dir():
            if scheme is not None:
                raise LiaamError(f"{output} shows the model's own landmarks; give --scheme for landmark files only")
            refuse_other_page(output)
            return cls(folder=output.parent, suffixes=(), picture=False, report=output)
        is_picture = output.suffix.lower() in IMAGE_SUFFIXES
        is_landmark_file = output.suffix.lower() in FIT_SUFFIXES
        if output.is_dir() or not (is_picture or is_landmark_file):
            return cls(folder=output, suffixes=suffixes, scheme=scheme)
        if several:
            raise LiaamError(f"{output} is one file; give a folder with -o, since there may be several results")
        suffixes = () if is_picture else (output.suffix,)
        return cls(folder=output.parent, suffixes=suffixes, picture=is_picture, only=output, scheme=scheme)

    def suffixes_for(self, result: "FitResult") -> tuple[str, ...]:
        """Return the suffixes of the landmark files of a fit.

        One that may not be used is written only where its status is, or beside its .json file, to be corrected.
        """
        if result.status.ok or ".json" in self.suffixes:
            return self.suffixes
        return tuple(suffix for suffix in self.suffixes if suffix.lower() not in STATELESS)

    @property
    def on_unusable(self) -> str:
        """What is said of fits that may not be used and are therefore not written; empty if all are."""
        left_out = [suffix for suffix in self.suffixes if suffix.lower() in STATELESS]
        if not left_out or ".json" in self.suffixes:
            return ""
        remedy = "give a name that ends in .json or .csv" if self.only is not None else "--format json or csv states it"
        return f"not written as {' and '.join(left_out)}, which cannot state that a fit may not be used; {remedy}"

    @property
    def on_absent(self) -> str:
        """What is said of a fit with absent landmarks: how they are in its files, and where they are named."""
        if self.report is None and not self.suffixes:
            return "some landmarks are absent; the picture has red rings at their places"
        if self.scheme is not None:
            return (
                f"some landmarks are absent, so some of {self.scheme} are estimates; fit without --scheme to see which"
            )
        place = "the files" if self.report is None else "the table of the page"
        named = "--format json writes their names" if self.report is None else "the messages there name them"
        if ".json" in self.suffixes:
            named = "the messages in the .json files name them"
        if self.absent == "estimate":
            return f"some landmarks are absent; their positions in {place} are estimates ({named})"
        empty = f"some landmarks are absent; their positions in {place} are empty ({named})"
        return f"{empty}. --absent estimate writes estimates instead"

    def path_of(self, name: str, suffix: str) -> Path:
        """Return the path of a landmark file for the fit of a name."""
        return self.only or self.folder / f"{name}{suffix}"

    def earlier_fits(self, names: Container[str]) -> list[str]:
        """Return the fits in the folder that have other names than these: those of earlier runs."""
        if self.only is not None or self.report is not None:
            return []
        earlier = []
        for path in sorted(self.folder.glob("*.json")):
            with suppress(LiaamError):  # of a file that is no text
                if path.stem not in names and read_fit(path) is not None:
                    earlier.append(path.stem)
        return earlier

    def write_picture(self, name: str, picture: np.ndarray) -> None:
        """Write the overlay image of the fit of a name: as JPEG if it is large, and else as PNG."""
        if self.only is not None:
            write_image(self.only, picture)
            return
        height, width = picture.shape[:2]
        png, jpeg = (self.folder / f"{name}{ending}" for ending in OVERLAYS)
        wanted, other = (jpeg, png) if height * width > MOST_PNG_PIXELS else (png, jpeg)
        write_image(wanted, picture)
        other.unlink(missing_ok=True)  # that of an earlier fit, to a copy of another size

    def add_fit(
        self, result: "FitResult", pixels: np.ndarray, image: Path, facts: dict[str, Any], length: Length | None
    ) -> None:
        """Keep the fit of a specimen for the report, with its facts as in the landmark file."""
        if self.report is not None:
            entry = entry_of_fit(result, pixels, str(image), image.name, facts.get("object"), length, self.absent)
            named = {name: facts[name] for name in ("specimen", "code", "message", "fingerprint") if name in facts}
            self.entries.append(replace(entry, row=entry.row | named))

    def add_error(self, error: LiaamError, image: Path) -> None:
        """Keep an image that could not be fitted for the report."""
        if self.report is not None:
            self.entries.append(entry_of_error(error, str(image), image.name))

    def write_report(self, model: "AAM", given: list[Path]) -> None:
        """Write the report, if there is to be one."""
        if self.report is not None:
            what = given[0].name if len(given) == 1 else f"{len(given)} images or folders"
            title = f"{what}: {count_of(len(self.entries), 'fit')} of the model {model.name}".rstrip()
            write_entries(self.report, self.entries, model.n_points, model.landmark_names, title)


def fit_file(
    fitter: "Fitter", image: Path, stem: str, *, name: str, init: str | None, every: bool, outputs: Outputs
) -> "tuple[FittedSpecimens, list[str]]":
    """Fit an image file, and write its fits: from `init` or, without, of the first object found, or of `every` one.

    ``name`` is that of the image in its files, which has its folder where images of several folders have one name.
    Return the fits and the names of their files: ``stem``, or ``stem_1``, ``stem_2``, ... in reading order if `every`
    object is fitted.
    """
    from liaam.fitting.specimens import fit_photograph

    if not every:  # of every object, the names are not known yet
        refuse_to_overwrite([outputs.path_of(stem, suffix) for suffix in outputs.suffixes])
    photograph = fit_photograph(fitter, image, init, every=every, stem=stem, name_by=outputs.name_by)
    pixels = photograph.pixels
    fitted = photograph.specimens
    length = photograph.length
    stems = [stem]
    if every:
        stems = [f"{stem}_{i}" for i in range(1, len(fitted.results) + 1)]
        for each in stems:
            refuse_to_overwrite([outputs.path_of(each, suffix) for suffix in outputs.suffixes])
    if outputs.crops:
        refuse_images([outputs.path_of(each, CROP) for each in stems])
    for i, (stem_of_object, result, specimen) in enumerate(zip(stems, fitted.results, fitted.named, strict=True)):
        facts = result.to_dict(outputs.absent)
        facts["image"] = name
        facts |= image_facts(image, photograph.fingerprint, outputs.folder)
        facts["specimen"] = specimen.name
        if every:
            facts["object"] = i + 1
        if specimen.code:
            facts["code"] = specimen.code
        facts["message"] = fitted.message(i)
        write_object(fitter.model, pixels, result, stem_of_object, facts, length, outputs)
        outputs.add_fit(result, pixels, image, facts, length)
    return fitted, stems


def write_object(
    model: "AAM",
    pixels: np.ndarray,
    result: "FitResult",
    name: str,
    facts: dict[str, Any],
    length: Length | None,
    outputs: Outputs,
) -> None:
    """Write the fit of one object of an image to files of a name."""
    from liaam.drawing import as_picture
    from liaam.plotting import overlay_of_fit

    of_image = {
        "image_name": facts["image"],
        "label": facts["specimen"],
        "scale": None if length is None else length.value,
        "unit": "" if length is None else length.unit,
    }
    facts = facts | facts_of(length)
    height, width = pixels.shape[:2]
    box = crop_box(result.place, (width, height)) if outputs.crops else None
    if box is not None:
        facts["crop"] = box
    if outputs.scheme is None:
        lines = Contour.all_of(model.contours)
        landmarks = Landmarks(
            points=result.reported(outputs.absent)[0],
            contours=lines,
            names=result.landmark_names,
            invisible=tuple(np.flatnonzero(result.absent).tolist()) if outputs.absent == "estimate" else (),
            **of_image,
        )
    else:
        points = in_scheme(result.landmarks, result.landmark_names, outputs.scheme)
        landmarks = Landmarks(points, **of_image)
        facts = {key: value for key, value in facts.items() if key not in OF_LANDMARKS}
    suffixes = outputs.suffixes_for(result)
    for suffix in (suffix for suffix in outputs.suffixes if suffix not in suffixes):
        outputs.path_of(name, suffix).unlink(missing_ok=True)  # that of an earlier fit
    with all_or_none([outputs.path_of(name, suffix) for suffix in suffixes]) as paths:
        for path in paths:
            write_fit(path, landmarks, facts, (width, height))
        if outputs.picture:
            outputs.write_picture(name, overlay_of_fit(pixels, result, model, **outputs.look))
        if box is not None:
            left, top, right, bottom = box
            crop = pixels[top:bottom, left:right]
            if crop.dtype.kind != "u":  # floats, which not every format can hold
                crop = as_picture(crop)
            write_image(outputs.path_of(name, CROP), crop)


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


def refuse_images(crops: list[Path]) -> None:
    """Raise if an image that is not a crop of an earlier fit would be overwritten."""
    for crop in crops:
        if crop.exists() and not is_overlay(crop):
            raise LiaamError(f"{crop} exists and is not from an earlier fit; give another -o to keep it, or remove it")


def refuse_fits_of_others(images: list[Path], stems: list[str], outputs: Outputs, *, every: bool) -> None:
    """Raise, before any work, if fits would replace those of other images of the same names."""
    if outputs.only is not None or outputs.report is not None:
        return
    ending = "_1" if every else ""
    files = [outputs.path_of(f"{stem}{ending}", ".json") for stem in stems]
    others = [file.stem for image, file in zip(images, files, strict=True) if is_of_other_image(file, image)]
    if others:
        raise LiaamError(
            f"{outputs.folder} holds fits of other images of these names: {some_names(others)}; give another folder "
            "with -o, or fit all images in one run, into a new folder, so that each fit has a name of its own"
        )


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
