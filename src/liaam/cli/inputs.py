"""What the commands read: starts, pictures, cameras, lists of numbers; names for what they write, and a warning."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from liaam.cli.terminal import say
from liaam.errors import CameraError, LiaamError

if TYPE_CHECKING:
    import numpy as np

    from liaam.datasets import Dataset, Sample
    from liaam.photometry import CameraModel

DOUBT = (
    "it is doubtful that the search found the object (a low score): look at the overlay, and if it shows something "
    "else, say where the object is with --init"
)
"""What to say of a start that is as likely something else."""


LandmarkedFolder = Annotated[Path, typer.Argument(help="Folder of images with landmarks beside them.")]
ImagesOption = Annotated[
    list[str] | None,
    typer.Option("--images", help="Only images whose name matches, such as '07-[12346]*'; may be repeated."),
]
RecursiveOption = Annotated[bool, typer.Option("--recursive", help="Look into sub-folders too.")]
RotationsOption = Annotated[
    str,
    typer.Option(
        "--rotations",
        help="How objects that are searched for may lie: upright (as in training), or all (turned in any way, slower).",
    ),
]


def read_folder(folder: Path, images: Sequence[str] | None, recursive: bool) -> "Dataset":
    """Read a folder of landmarked images, some or all, and say what was found."""
    from liaam.datasets import load_folder

    data = load_folder(folder, recursive=recursive)
    data = data.select(images) if images else data
    say(data.report())
    return data


def read_sample(image: Path) -> "Sample":
    """A picture with the landmarks beside it."""
    from liaam.datasets import load_folder
    from liaam.io.files import existing_file

    existing_file(image, LiaamError, "picture")
    found = next((sample for sample in load_folder(image.parent) if sample.image == image), None)
    if found is None:
        raise LiaamError(f"{image}: there are no landmarks beside this picture")
    return found


def read_init(text: str, image: Path, size: tuple[int, int]):
    """Read --init for one image: numbers, a landmark file, or a folder of them."""
    from liaam.io import read_start

    return read_start(text, image, size)


def unique_stems(images: list[Path]) -> list[str]:
    """Give names for the results, each once: the image's stem, with its folder where stems collide."""
    stems = [image.stem for image in images]
    taken: set[str] = set()
    names = []
    for image, stem in zip(images, stems, strict=True):
        name = stem if stems.count(stem) == 1 else f"{image.resolve().parent.name}_{image.name.replace('.', '_')}"
        while name in taken:
            name += "_"
        taken.add(name)
        names.append(name)
    return names


def starting_camera(start: Path | None) -> "CameraModel":
    """Camera to start from: a file's, or the default."""
    from liaam.photometry import CameraModel, load_camera

    return CameraModel() if start is None else load_camera(start)


def read_pictures(
    paths: Sequence[Path], start: Path | None, response: str | None, at_least: int = 1
) -> tuple["CameraModel", list["np.ndarray"]]:
    """Read pictures and the camera to start from."""
    from liaam.io import read_image

    if len(paths) < at_least:
        raise CameraError(f"{len(paths)} picture is too few: give {at_least} or more, under different lights")
    camera = camera_for(paths, start, response)
    return camera, [read_image(path) for path in paths]


def camera_for(
    paths: Sequence[Path], start: Path | None, response: str | None, otherwise: "CameraModel | None" = None
) -> "CameraModel":
    """Camera of pictures: a file's, or another if there is none; RAW files are linear unless told otherwise."""
    from liaam.io import is_raw

    raw = [is_raw(path) for path in paths]
    if any(raw) and not all(raw):
        raise CameraError("RAW files and others have different responses; give them apart")
    camera = starting_camera(start) if start or otherwise is None else otherwise
    return camera.suited_to(raw=any(raw), response=response)


def numbers_in(text: str, count: int, option: str) -> "np.ndarray":
    """Numbers of a list with commas, so many of them."""
    import numpy as np

    try:
        numbers = np.array([float(part) for part in text.split(",")])
    except ValueError:
        numbers = np.zeros(0)
    if len(numbers) != count or not np.isfinite(numbers).all():
        raise CameraError(f"{option} {text}: give {count} numbers, separated by commas")
    return numbers


def check_camera_output(output: Path, start: Path | None, inputs: Sequence[Path] = ()) -> None:
    """Complain, before the work, about a camera file that cannot be written or would undo another."""
    check_output(output)
    if output.suffix.lower() != ".json":
        raise CameraError(f"{output}: a camera file ends in .json, such as camera.json")
    if output.exists() and (start is None or start.resolve() != output.resolve()):
        raise CameraError(
            f"{output} exists; add --camera {output} to keep what it knows and add to it, or give another name with -o"
        )
    refuse_inputs([check_picture(output)], inputs)


def check_picture(output: Path) -> Path:
    """Name of the picture that is written beside a camera file."""
    return output.with_name(f"{output.stem}_check.png")


def refuse_inputs(outputs: Sequence[Path], inputs: Sequence[Path]) -> None:
    """Complain about an output that would overwrite an input."""
    for path in outputs:
        if path.resolve() in {other.resolve() for other in inputs}:
            raise LiaamError(f"{path} is one of the pictures to be read; give another name with -o")


def read_patches(path: Path) -> "np.ndarray":
    """Boxes of a CSV file, (n, 4) float64."""
    import numpy as np

    from liaam.io.files import existing_file, is_number, read_bytes

    data = read_bytes(existing_file(path, CameraError, "file of patches"), CameraError, limit=10_000_000)
    try:
        rows = [line for line in data.decode("utf-8-sig").splitlines() if line.strip()]
        rows = rows[1:] if rows and not any(map(is_number, rows[0].split(","))) else rows
        boxes = np.array([[float(part) for part in row.split(",")] for row in rows])
    except ValueError:
        boxes = np.zeros((0, 0))
    if boxes.ndim != 2 or boxes.shape[1] != 4:
        raise CameraError(f"{path}: a file of patches has one row x0,y0,x1,y1 for each, in pixels")
    return boxes


def check_output(output: Path) -> None:
    """Complain about a file that cannot be written before the work, not after it."""
    if output.is_dir() or not output.parent.is_dir():
        what = "is a folder" if output.is_dir() else f"cannot be written: the folder {output.parent} does not exist"
        raise LiaamError(f"{output} {what}; give the name of a file in a folder that exists")


def names_of(paths: Sequence[Path]) -> str:
    """Names of files, the first few."""
    return ", ".join(path.name for path in paths[:6]) + (f" and {len(paths) - 6} more" if len(paths) > 6 else "")
