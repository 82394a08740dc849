"""Learn lamps from objects that were photographed under several lamps without moving."""

from collections import Counter
from collections.abc import Iterable

import cv2
import numpy as np

from liaam.datasets import Sample
from liaam.error_measures import point_error
from liaam.errors import TrainingError
from liaam.model.shape import diagonal_of, procrustes_mean
from liaam.photometry import Response
from liaam.photometry.encoding import as_colour
from liaam.progress import Progress
from liaam.training.lamps.bank import DARK, LearntLamps, anchors, as_srgb, square

# Standard deviation of the blur of a ratio of two images, as a fraction of the object's diagonal. It keeps the light,
# and removes fine texture and the effect of small movements.
BLUR = 0.016
# Mean distance of landmarks between two images of an object, as a fraction of its diagonal, above which the object
# counts as moved
MOVED = 0.03
LEAST_BLUR = 0.2  # Blur in pixels below which it changes nothing: the weight of the next pixel is below 4e-6


def learn_lamps(
    data: Iterable,
    training_lamp: str | None = None,
    *,
    response: Response = "srgb",
    progress: Progress | None = None,
) -> LearntLamps:
    """Learn lamps from a few objects, each photographed under the training light and under other lamps.

    Parameters
    ----------
    data : Dataset or iterable of Sample
        Samples named by object and lamp with a ``-`` in between: ``037-00`` and ``037-07`` show object ``037`` under
        the lamps ``00`` and ``07``. An object must not move between its images.
    training_lamp : str, optional
        Name of the lamp of the training images. It may be omitted if exactly one lamp is common to all objects.
    response : Response
        Response of the camera.
    progress : callable, optional
        Called with (done, total, what) before each image, and at the end.

    Returns
    -------
    LearntLamps
        One lamp for each image that is not under the training light.

    Raises
    ------
    TrainingError
        If the names do not contain object and lamp, an object has no image under the training light, or it has moved.
    """
    objects = _by_object(data)
    training_lamp = _training_lamp(objects, training_lamp)
    bases = {name: _base(name, pictures, training_lamp) for name, pictures in objects.items()}
    mean = unit_shape(procrustes_mean(np.array([base.landmarks.points for base in bases.values()])))
    total = sum(map(len, objects.values())) - len(objects)  # the images under the training light are no lamps
    fields = []
    names = []
    for name, pictures in objects.items():
        base = bases[name]
        before = as_srgb(as_colour(base.read_image(), base.name), response)
        for picture in pictures:
            if picture is base:
                continue
            if progress:
                progress(len(fields), total, picture.name)
            after = as_srgb(as_colour(picture.read_image(), picture.name), response)
            fields.append(_field(before, after, base, picture, mean))
            names.append(picture.name)
    if progress:
        progress(total, total, "learnt")
    return LearntLamps(mean, np.array(fields), tuple(names))


def unit_shape(mean: np.ndarray) -> np.ndarray:
    """Normalise a shape: centre of the bounding box at the origin, diagonal 1."""
    low = mean.min(axis=0)
    high = mean.max(axis=0)
    return (mean - 0.5 * (low + high)) / diagonal_of(mean)


def _by_object(data: Iterable) -> dict[str, list[Sample]]:
    """Group samples by their object, the part of the name before the last hyphen, and check them."""
    objects: dict[str, list[Sample]] = {}
    for sample in data:
        if not hasattr(sample, "landmarks"):
            raise TrainingError("lamps are learnt from named samples; for a folder, pass liaam.load_folder(folder)")
        name = sample.name.rpartition("-")[0]
        if not name:
            raise TrainingError(
                f"{sample.name}: the name lacks object and lamp; name the images such as 037-00 and 037-07"
            )
        if not np.isfinite(sample.landmarks.points).all():
            raise TrainingError(f"{sample.name}: landmarks are missing (NaN); place them or remove this image")
        objects.setdefault(name, []).append(sample)
    if not objects:
        raise TrainingError("there are no images to learn lamps from; pass at least two of one object")
    counts = {len(picture.landmarks) for pictures in objects.values() for picture in pictures}
    if len(counts) > 1:
        raise TrainingError(
            f"the images to learn lamps from have {min(counts)} to {max(counts)} landmarks; use the same number in all"
        )
    return objects


def _lamp_of(picture: Sample) -> str:
    """Return the name of an image's lamp, the part of its name after the last hyphen."""
    return picture.name.rpartition("-")[2]


def _training_lamp(objects: dict[str, list[Sample]], requested: str | None) -> str:
    """Return the name of the training lamp: the requested one, or the only one that all objects have in common."""
    counts = Counter()  # number of objects with each lamp
    for pictures in objects.values():
        counts.update({_lamp_of(picture) for picture in pictures})
    choice = f"choose from {', '.join(sorted(counts))}"
    if requested is not None:
        if requested not in counts:
            raise TrainingError(f"no image has the lamp {requested!r} in its name; {choice}")
        return requested
    common = [lamp for lamp, count in counts.items() if count == len(objects)]
    if len(common) != 1:
        fault = "the training light is ambiguous: name its lamp (--training-lamp, or training_lamp=...)"
        raise TrainingError(f"{fault}; {choice}")
    return common[0]


def _base(name: str, pictures: list[Sample], training_lamp: str) -> Sample:
    """Return the image of an object under the training light. Raise if it has none or no others, or has moved."""
    base = next((picture for picture in pictures if _lamp_of(picture) == training_lamp), None)
    if base is None:
        raise TrainingError(
            f"object {name} has no image under lamp {training_lamp}, the training light; add one, or remove the object"
        )
    if len(pictures) == 1:
        raise TrainingError(f"object {name} has an image under lamp {training_lamp} only; add images under other lamps")
    place = base.landmarks.points
    for picture in pictures:
        moved = point_error(picture.landmarks.points, place) / diagonal_of(place)
        if moved > MOVED:
            raise TrainingError(
                f"{picture.name}: its landmarks lie {moved:.0%} of the object's size from those of {base.name}; use "
                "images of objects that have not moved"
            )
    return base


def _field(before: np.ndarray, after: np.ndarray, base: Sample, picture: Sample, mean: np.ndarray) -> np.ndarray:
    """Return the logarithm of the ratio of two images, warped to the mean shape, (SIDE, SIDE, 3) float16.

    ``before`` and ``after`` are sRGB values of ``base`` and ``picture``, (h, w, 3) float32.
    """
    from scipy.interpolate import LinearNDInterpolator  # heavy: imported when first needed

    if before.shape != after.shape:
        raise TrainingError(f"{picture.name} and {base.name} differ in size; use images of equal size")
    ratio = np.log((after + np.float32(DARK)) / (before + np.float32(DARK)))
    blur = BLUR * diagonal_of(base.landmarks.points)
    if blur > LEAST_BLUR:
        ratio = cv2.GaussianBlur(ratio, (0, 0), blur, borderType=cv2.BORDER_REPLICATE)
    to_image = LinearNDInterpolator(*anchors(mean, base.landmarks.points))
    x, y = np.moveaxis(to_image(square()).astype(np.float32), -1, 0)
    field = cv2.remap(ratio, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.nan_to_num(field).astype(np.float16)
