"""Options and checks that several commands share."""

import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from glob import has_magic
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Annotated, TypeVar

import numpy as np
import typer

from liaam.cli.terminal import complain, say
from liaam.datasets import Dataset, Sample, load_folder
from liaam.errors import CameraError, ImageError, LiaamError
from liaam.io import is_raw
from liaam.io.files import count_of, existing_file, is_number, natural_key, real_path, some_names
from liaam.io.images import PICTURE_SUFFIXES, UNREAD_SUFFIXES, VIDEO_SUFFIXES
from liaam.io.landmarks.formats import KNOWN_FILES
from liaam.io.landmarks.matching import unique_names
from liaam.io.landmarks.reading import USUAL, Reading
from liaam.models import FACE, MODELS, model_file

if TYPE_CHECKING:
    from liaam.model import AAM
    from liaam.photometry import CameraModel

# Warning for a start with a low search score
LOW_SCORE = (
    "the search may have found something else (low score): check the overlay; if it is wrong, give the object's "
    "place with --init"
)
# Ways to fit that were not tried. They are for these images alone, as more ways mislead a few fits that were right.
ONE_SIDE = "if the object is of the other side than in training, such as a right wing, add --side both"
TURNED = "if the object is rotated against the training images, add --rotations all"
ALONE = "; fit these images alone again"


def other_ways(model: "AAM", side: str, rotations: str | None, alone: str) -> str:
    """Return which ways to fit were not tried for fits that may be wrong; empty if all were.

    ``alone`` is how to fit these images again.
    """
    from liaam.model.file_format import UPRIGHT
    from liaam.model.shape import mirror_order

    knows_one_side = side == AUTO and model.sides is None and mirror_order(model.shape_model.mean) is None
    is_upright = (rotations or model.rotations) == UPRIGHT
    ways = [*([ONE_SIDE] if knows_one_side else []), *([TURNED] if is_upright else [])]
    return "; ".join(ways) + alone if ways else ""


Given = TypeVar("Given", str, Path)

LandmarkedFolder = Annotated[
    Path,
    typer.Argument(
        metavar="FOLDER",
        readable=False,
        help=f"Folder of images with landmarks beside them, in a file for each image or for many: {KNOWN_FILES}. Or a "
        "quoted pattern: 'faces/07-*' for some of its images, 'faces/**' with its subfolders.",
    ),
]
"""Its permissions are not checked by typer, because the readers' messages say what to do. So for the next one."""
MODEL_SUFFIXES = (".liaam", ".safetensors")  # Suffixes of models, to tell one that is given after the images

ModelAndImages = Annotated[
    list[Path],
    typer.Argument(
        metavar="[MODEL] IMAGE...",
        readable=False,
        help="Model file of 'liaam train', or a name that 'liaam show' lists; then the images. "
        "Without a model, as in 'liaam fit photo.jpg', the face model that comes with liaam is used.",
    ),
]
ModelFile = Annotated[
    Path,
    typer.Argument(
        metavar="MODEL",
        readable=False,
        callback=model_file,
        help="Model file of 'liaam train', or a name that 'liaam show' lists.",
    ),
]
StrictOption = Annotated[
    bool, typer.Option("--strict", help="Stop if landmarks are faulty. By default, these are named and left out.")
]
CategoryOption = Annotated[
    str | None,
    typer.Option(
        help="Which landmarks are the object's: a category of COCO, a label of CVAT's skeletons or dlib's boxes, or a "
        "group of a menpo .ljson."
    ),
]
YDownOption = Annotated[bool, typer.Option("--y-down", help="y of .tps and .nts counts from the top.")]
StoredOption = Annotated[
    bool,
    typer.Option(
        "--stored-orientation", help="Positions are for photos as stored, before their EXIF orientation turns them."
    ),
]
CameraOption = Annotated[
    str | None,
    typer.Option(
        "--camera",
        help="If this is not the camera of the training images: a file of 'liaam camera'; or the response alone: srgb, "
        "linear, or a gamma such as 2.2; or the angle theta alone, in degrees from 60 to 180.",
    ),
]
EllipsesOption = Annotated[bool, typer.Option("--ellipses", help="Draw the 95 % confidence ellipse of each landmark.")]
RotationsOption = Annotated[
    str | None,
    typer.Option(
        "--rotations",
        help="Orientations to search: upright, or all (any rotation, slower). By default as the objects are turned in "
        "the training images.",
    ),
]
SideOption = Annotated[
    str,
    typer.Option(
        "--side",
        help="Side of the objects: auto (both are tried if the model was trained on objects of two sides), both (also "
        "if it was not), or one of its sides, such as left.",
    ),
]
SidesOption = Annotated[
    str,
    typer.Option(
        "--sides",
        help="Objects of two sides, such as left and right wings: auto reflects the images of one side, by a column "
        "'side', folders left and right, names such as wing1_left, or else the shapes, and fits try both; both: fits "
        "try both even if all images are of one; one: use all as they are.",
    ),
]
AbsentOption = Annotated[
    str,
    typer.Option(
        "--absent",
        help="What to write of landmarks that are not there (broken off, covered): empty, or the estimate of their "
        "position from the other landmarks.",
    ),
]

NameByOption = Annotated[
    str,
    typer.Option(
        "--name-by",
        help="What names specimens: position (IMAGE#1, IMAGE#2, ... in reading order), code (the QR or bar code beside "
        "each), or label (the only code of the photograph: CODE#1, CODE#2, ...).",
    ),
]


LEAST_ANGLE = 60  # Angle theta in degrees from which a number of --camera is an angle; smaller numbers are a gamma
AUTO = "auto"  # Value of options that liaam chooses itself

ShapesOption = Annotated[
    str,
    typer.Option(
        "--shapes",
        help="Number of kinds of shape, such as those of two species, each with a model of its own: 1 to 4. 'auto' "
        "finds out, from 16 images on.",
    ),
]


def parse_shapes(text: str) -> int | str:
    """Parse a number of kinds of shape, or ``auto``."""
    return int(text) if text.isdecimal() else text


def read_folder(source: Path, reading: Reading = USUAL) -> Dataset:
    """Read a folder of landmarked images, or those that a pattern names, and print a summary."""
    folder, recursive, pattern = folder_of(source)
    data = load_folder(folder, recursive=recursive, reading=reading)
    if pattern is not None:
        named = tuple(sample for sample in data if matches(sample, pattern))
        if not named:
            names = some_names([sample.name for sample in data])
            raise LiaamError(f"{source}: no landmarked image of {folder} matches {pattern}; they are {names}")
        data = replace(data, samples=named)
    say(data.report())
    if not recursive and pattern is None and (below := images_below(folder)):
        complain(f"images in subfolders that are not read: {below}; give '{folder}/**' to read these, too")
    return data


def images_below(folder: Path) -> int:
    """Return the number of images in the subfolders of a folder."""
    from liaam.batch import find_pictures

    try:
        return sum(real_path(image).parent != real_path(folder) for image in find_pictures(folder, on_closed=str))
    except ImageError:  # it has none
        return 0


def folder_of(source: Path) -> tuple[Path, bool, str | None]:
    """Split a pattern such as ``faces/**/07-*``: its folder, whether subfolders count, and the pattern of names."""
    if source.exists() or not has_magic(str(source)):
        return source, False, None
    first = next(i for i, part in enumerate(source.parts) if has_magic(part))
    folder = Path(*source.parts[:first])
    *between, name = source.parts[first:]
    if set(between) - {"**"}:
        raise LiaamError(
            f"{source}: a pattern is for images' names, in a folder ('faces/07-*') or also below it ('faces/**/07-*')"
        )
    return folder, "**" in (*between, name), None if name == "**" else name


def matches(sample: Sample, pattern: str) -> bool:
    """Return whether an image's name, with its suffix or without, matches a pattern."""
    names = [PurePath(sample.name).name, *([sample.image.name] if isinstance(sample.image, Path) else [])]
    return any(fnmatchcase(name, pattern) for name in names)


def read_sample(image: Path) -> Sample:
    """Read an image and the landmarks beside it."""
    existing_file(image, LiaamError, "image")
    sample_of_image = next((sample for sample in load_folder(image.parent) if sample.image == image), None)
    if sample_of_image is None:
        raise LiaamError(f"{image}: no landmarks beside this image; add a landmark file such as {image.stem}.pts")
    return sample_of_image


def unique_stems(images: list[Path]) -> list[str]:
    """Return a unique name for each image: its stem, after the folder's name where stems collide.

    The suffix follows if folder and stem of some images are the same, too.
    """
    stems = [image.stem for image in images]
    counts = Counter(stems)
    in_folders = [f"{real_path(image).parent.name}_{image.stem}" for image in images]
    if max(Counter(in_folders).values(), default=0) > 1:
        in_folders = [f"{real_path(image).parent.name}_{image.name.replace('.', '_')}" for image in images]
    taken: set[str] = set()
    names = []
    for stem, in_folder in zip(stems, in_folders, strict=True):
        name = stem if counts[stem] == 1 else in_folder
        while name in taken:
            name += "_"
        taken.add(name)
        names.append(name)
    return names


def given_images(paths: Iterable[Path]) -> list[Path]:
    """Return the images of all arguments, each once, and say which are given again."""
    images = [image for path in paths for image in pictures_in(path)]
    again: list[str] = []
    once = list(each_once(images, lambda image: again.append(str(image))))
    say_again(again)
    return once


def each_once(images: Iterable[Given], on_again: Callable[[Given], object]) -> Iterator[Given]:
    """Iterate over images, and call a function with those that came before, also by another path."""
    seen: set[Path] = set()
    for image in images:
        place = real_path(image)
        if place in seen:
            on_again(image)
            continue
        seen.add(place)
        yield image


def say_again(images: Sequence[str]) -> None:
    """Say which images were given again."""
    if images:
        complain(f"{count_of(len(images), 'image')} given more than once, and taken once: {some_names(images)}")


def pictures_in(path: Path) -> list[Path]:
    """Return an image, or those of a folder and its subfolders or of a pattern, without overlays, in natural order.

    A path that is missing is returned as it is.
    """
    from liaam.batch import find_pictures

    is_pattern = has_magic(str(path)) and not path.exists()
    if not (path.is_dir() or is_pattern):
        return [path]
    return sorted(map(Path, find_pictures(path)), key=lambda image: natural_key(str(image)))


def names_in_folders(images: list[Path]) -> list[str]:
    """Return the file name of each image, or its path below the folder of all if some have one stem."""
    if len({image.stem for image in images}) == len(images):
        return [image.name for image in images]
    unique = unique_names(map(str, images))
    return [f"{unique[str(image)].removesuffix(image.suffix)}{image.suffix}" for image in images]


def camera_for(paths: Sequence[Path], camera: str | None, otherwise: "CameraModel | None" = None) -> "CameraModel":
    """Return the camera of images: that of a file, or `otherwise` or the default one, if need be with a response.

    The response of RAW images is linear by default.
    """
    from liaam.photometry import CameraModel

    raw = [is_raw(path) for path in paths]
    if any(raw) and not all(raw):
        raise CameraError("RAW files and other images have different responses; process them separately")
    given, response = camera_in(camera)
    return (given or otherwise or CameraModel()).suited_to(raw=any(raw), response=response)


def camera_in(text: str | None) -> "tuple[CameraModel | None, str | None]":
    """Return the camera or the response that the text of --camera stands for."""
    from liaam.photometry import CameraModel, load_camera, parse_response

    if text is None:
        return None, None
    if names_file(text, (".json",)):
        return load_camera(text), None
    if is_number(text) and LEAST_ANGLE <= float(text) <= 180:
        return CameraModel(theta=math.radians(float(text))), None
    try:
        parse_response(text)
    except ImageError:
        raise CameraError(
            f"--camera {text}: give a file of 'liaam camera'; a response: srgb, linear, or a gamma from 0.2 to 5; or "
            f"the angle theta in degrees, from {LEAST_ANGLE} to 180"
        ) from None
    return None, text


def names_file(text: str, suffixes: tuple[str, ...]) -> bool:
    """Return whether the text of an option is a file's name: by its ending, or because there is such a file."""
    return text.lower().endswith(suffixes) or Path(text).exists()


def numbers_in(text: str, count: int, option: str) -> np.ndarray:
    """Parse `count` numbers separated by commas."""
    try:
        numbers = np.array([float(part) for part in text.split(",")])
    except ValueError:
        numbers = np.zeros(0)
    if len(numbers) != count or not np.isfinite(numbers).all():
        raise CameraError(f"{option} {text}: give {count} numbers, separated by commas")
    return numbers


def refuse_inputs(outputs: Sequence[Path], inputs: Sequence[Path]) -> None:
    """Raise if an output would overwrite an input."""
    for path in outputs:
        if real_path(path) in {real_path(other) for other in inputs}:
            raise LiaamError(f"{path} is one of the input images; give another name with -o")


def say_advice(advice: Mapping[str, Sequence[str]]) -> None:
    """Print each piece of advice once, with the names of the images that it is for."""
    for text, names in advice.items():
        complain(f"{some_names(names)}: {text}")


def names_of(paths: Sequence[Path]) -> str:
    """Return the names of the first six files and the number of the rest."""
    return some_names([path.name for path in paths])


def model_and_inputs(files: Sequence[Given], command: str, inputs: str = "IMAGE...") -> tuple[Path, list[Given]]:
    """Split the files of a command: the first is the model, unless its name is that of an input (:func:`is_input`)."""
    if not files or is_input(str(files[0])):
        paths = [Path(file) for file in files]
        if late := next((path for path in paths if path.suffix.lower() in MODEL_SUFFIXES or str(path) in MODELS), None):
            raise LiaamError(f"{late}: a model comes first, as in 'liaam {command} {late.name} {paths[0].name}'")
        return Path(FACE), list(files)
    if len(files) == 1:
        what = "images" if inputs.endswith("...") else inputs.lower()
        raise LiaamError(f"{files[0]}: give the {what}, too, as in 'liaam {command} MODEL {inputs}'")
    return Path(files[0]), list(files[1:])


def say_if_no_model(files: Sequence[Given], command: str) -> None:
    """Say, after fits that failed, that faces were fitted since no model was given."""
    if files and is_input(str(files[0])):
        say(
            f"no model was given, so faces were looked for; for other objects, give their model first, as in "
            f"'liaam {command} MODEL {files[0]}'"
        )


def is_input(name: str) -> bool:
    """Return whether a name is that of a folder, image, video or camera, or a pattern, or - for standard input."""
    if name.lower().endswith((*PICTURE_SUFFIXES, *UNREAD_SUFFIXES, *VIDEO_SUFFIXES)):
        return True
    if Path(name).exists():  # such as a model whose name has brackets, or is a number
        return Path(name).is_dir()
    return name == "-" or name.isdigit() or has_magic(name)
