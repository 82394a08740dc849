"""Options and checks that several commands share."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from liaam.cli.terminal import complain, say
from liaam.errors import CameraError, LiaamError
from liaam.io.atomic import check_output
from liaam.io.files import real_path, some_names

if TYPE_CHECKING:
    import numpy as np

    from liaam.datasets import Dataset, Sample
    from liaam.photometry import CameraModel

LOW_SCORE = (
    "the search may have found something else (low score): check the overlay; if it is wrong, give the object's "
    "place with --init"
)
"""Warning for a start with a low search score."""

TURNED = "; if the object is rotated against the training images, add --rotations all"
"""Ending of warnings, if only upright objects were searched for."""


LandmarkedFolder = Annotated[Path, typer.Argument(readable=False, help="Folder of images with landmarks beside them.")]
"""Its permissions are not checked by typer, because the readers' messages say what to do. So for the next one."""
ModelFile = Annotated[Path, typer.Argument(metavar="MODEL", readable=False, help="Model file of 'liaam train'.")]
ImagesOption = Annotated[
    list[str] | None,
    typer.Option("--images", help="Use only images whose name matches, such as '07-[12346]*'; may be repeated."),
]
RecursiveOption = Annotated[bool, typer.Option("--recursive", help="Include subfolders.")]
CameraOption = Annotated[
    Path | None,
    typer.Option("--camera", help="Camera file, if this is not the camera of the training images."),
]
ResponseOption = Annotated[str | None, typer.Option(help="Camera response, if it differs from the training camera's.")]
EllipsesOption = Annotated[bool, typer.Option("--ellipses", help="Draw the 95 % confidence ellipse of each landmark.")]
RotationsOption = Annotated[
    str,
    typer.Option(
        "--rotations",
        help="Orientations to search: upright (as in training), or all (any rotation, slower).",
    ),
]


def read_folder(folder: Path, images: Sequence[str] | None, recursive: bool) -> "Dataset":
    """Read a folder of landmarked images and print a summary."""
    from liaam.datasets import load_folder

    data = load_folder(folder, recursive=recursive)
    data = data.select(images) if images else data
    say(data.report())
    return data


def read_sample(image: Path) -> "Sample":
    """Read an image and the landmarks beside it."""
    from liaam.datasets import load_folder
    from liaam.io.files import existing_file

    existing_file(image, LiaamError, "image")
    found = next((sample for sample in load_folder(image.parent) if sample.image == image), None)
    if found is None:
        raise LiaamError(f"{image}: no landmarks beside this image; add a landmark file such as {image.stem}.pts")
    return found


def read_init(text: str, image: Path, size: tuple[int, int]):
    """Read --init for one image: numbers, a landmark file, or a folder of them."""
    from liaam.io import read_start

    return read_start(text, image, size)


def read_with_start(image: Path, init: str | None):
    """Read an image, and --init for it if given."""
    from liaam.io import read_image

    pixels = read_image(image)
    return pixels, None if init is None else read_init(init, image, pixels.shape[1::-1])


def unique_stems(images: list[Path]) -> list[str]:
    """Return a unique name for each image: its stem, with the folder's name where stems collide."""
    stems = [image.stem for image in images]
    taken: set[str] = set()
    names = []
    for image, stem in zip(images, stems, strict=True):
        name = stem if stems.count(stem) == 1 else f"{real_path(image).parent.name}_{image.name.replace('.', '_')}"
        while name in taken:
            name += "_"
        taken.add(name)
        names.append(name)
    return names


def starting_camera(start: Path | None) -> "CameraModel":
    """Return the camera of a file, or the default camera."""
    from liaam.photometry import CameraModel, load_camera

    return CameraModel() if start is None else load_camera(start)


def read_pictures(
    paths: Sequence[Path], start: Path | None, response: str | None, at_least: int = 1
) -> tuple["CameraModel", list["np.ndarray"]]:
    """Read images and the camera to start from."""
    from liaam.io import read_image

    if len(paths) < at_least:
        raise CameraError(f"too few images ({len(paths)}): give {at_least} or more, under different lights")
    camera = camera_for(paths, start, response)
    return camera, [read_image(path) for path in paths]


def camera_for(
    paths: Sequence[Path], start: Path | None, response: str | None, otherwise: "CameraModel | None" = None
) -> "CameraModel":
    """Return the camera of a file, or `otherwise`. The response of RAW images is linear unless one is given."""
    from liaam.io import is_raw

    raw = [is_raw(path) for path in paths]
    if any(raw) and not all(raw):
        raise CameraError("RAW files and other images have different responses; process them separately")
    camera = starting_camera(start) if start or otherwise is None else otherwise
    return camera.suited_to(raw=any(raw), response=response)


def numbers_in(text: str, count: int, option: str) -> "np.ndarray":
    """Parse `count` numbers separated by commas."""
    import numpy as np

    try:
        numbers = np.array([float(part) for part in text.split(",")])
    except ValueError:
        numbers = np.zeros(0)
    if len(numbers) != count or not np.isfinite(numbers).all():
        raise CameraError(f"{option} {text}: give {count} numbers, separated by commas")
    return numbers


def check_camera_output(output: Path, start: Path | None, inputs: Sequence[Path] = ()) -> None:
    """Raise, before any work, if a camera file cannot be written or would replace an unrelated one."""
    check_output(output)
    if output.suffix.lower() != ".json":
        raise CameraError(f"{output}: a camera file ends in .json, such as camera.json")
    if output.exists() and (start is None or real_path(start) != real_path(output)):
        raise CameraError(f"{output} exists; add --camera {output} to update it, or give another name with -o")
    refuse_inputs([check_picture(output)], inputs)


def check_picture(output: Path) -> Path:
    """Return the path of the check image beside a camera file."""
    return output.with_name(f"{output.stem}_check.png")


def refuse_inputs(outputs: Sequence[Path], inputs: Sequence[Path]) -> None:
    """Raise if an output would overwrite an input."""
    for path in outputs:
        if real_path(path) in {real_path(other) for other in inputs}:
            raise LiaamError(f"{path} is one of the input images; give another name with -o")


def read_patches(path: Path) -> "np.ndarray":
    """Read boxes from a CSV file, (n, 4) float64."""
    import numpy as np

    from liaam.io.files import existing_file, is_number, read_bytes

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


def say_advice(advice: Mapping[str, Sequence[str]]) -> None:
    """Print each piece of advice once, with the names of the images that it is for."""
    for text, names in advice.items():
        complain(f"{', '.join(names[:5])}{' …' if len(names) > 5 else ''}: {text}")


def names_of(paths: Sequence[Path]) -> str:
    """Return the names of the first six files and the number of the rest."""
    return some_names([path.name for path in paths])
