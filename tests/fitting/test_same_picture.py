"""The same photograph in another form gives the same landmarks."""

import io
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import ExifTags, Image

from liaam import datasets
from liaam.fitting import FitResult, Fitter, SolverOptions
from liaam.io import read_image
from liaam.model.aam import named_model
from liaam.photometry import CameraModel, ResponseCurve, from_linear, srgb_to_linear
from setups import disturb

FACE = Path(datasets.__file__).with_name("pictures") / "face" / "lisa.jpg"
CURVE = ResponseCurve((0.01, 1.0), (0.02, 2.0))  # linear light on another scale
# Standard deviations. Block averages, rounding and the order of sums differ, and interpolation between other pixels is
# not quite the same: fits move by 0.01 if the photograph is turned, and by 0.04 if it is halved. If it is cut, other
# pixels are averaged together: in 24 cuts by 0 to 4 pixels, fits move by 0.05 in the median, and by 0.07 at most.
HARDLY, LITTLE = 0.05, 0.1

Points = Callable[[np.ndarray], np.ndarray]


def as_they_are(points: np.ndarray) -> np.ndarray:
    return points


class Portrait:
    """The photograph that comes with liaam, a start, and fits of the face model, each of which is made once."""

    def __init__(self) -> None:
        self.model = named_model("face")
        self.image = read_image(FACE)
        self.fitter = Fitter(self.model)
        self.start = disturb(self.fitter.fit(self.image).landmarks)
        self._known: dict[SolverOptions, FitResult] = {}

    def moved(
        self,
        change: Callable[[np.ndarray], np.ndarray],
        fitter: Fitter | None = None,
        there: Points = as_they_are,
        back: Points = as_they_are,
    ) -> float:
        """Median movement of the landmarks, standard deviations; the maps are those of points between pictures."""
        fitter = fitter or self.fitter
        known = self.known(fitter.options)
        result = fitter.fit(change(self.image), there(self.start))
        assert result.status == known.status
        return float(np.median(np.linalg.norm(back(result.landmarks) - known.landmarks, axis=1) / known.sd))

    def known(self, options: SolverOptions) -> FitResult:
        if options not in self._known:
            self._known[options] = Fitter(self.model, options=options).fit(self.image, self.start)
        return self._known[options]


@pytest.fixture(scope="module")
def portrait() -> Portrait:
    return Portrait()


def stored(image: np.ndarray, response, dtype) -> np.ndarray:
    """Store an 8-bit sRGB image with another response, as floats or as integers of another depth."""
    values = from_linear(srgb_to_linear(image / 255.0), response)
    if np.dtype(dtype).kind == "f":
        return values.astype(dtype)
    return np.rint(values * np.iinfo(dtype).max).astype(dtype)


@pytest.mark.parametrize(
    ("response", "values", "dtype"),
    [
        ("srgb", "srgb", np.uint16),
        ("srgb", "srgb", np.float64),
        ("linear", "linear", np.uint16),
        ("linear", "linear", np.float32),
        (2.2, 2.2, np.uint16),
        (CURVE, "linear", np.float32),
    ],
)
def test_the_response_and_the_depth_do_not_matter(portrait, response, values, dtype):
    """The limit of dark pixels was one of stored values: linear light lost all that is darker than 48 of 255."""
    fitter = Fitter(portrait.model, camera=CameraModel(response=response))
    assert portrait.moved(lambda image: stored(image, values, dtype), fitter) < HARDLY


def test_a_file_that_is_stored_on_its_side_gives_the_same_fit(portrait, tmp_path):
    exif = Image.Exif()
    exif[ExifTags.Base.Orientation] = 6
    Image.fromarray(np.ascontiguousarray(np.rot90(portrait.image))).save(tmp_path / "phone.png", exif=exif)
    result = portrait.fitter.fit(tmp_path / "phone.png", portrait.start)
    np.testing.assert_array_equal(result.landmarks, portrait.known(SolverOptions()).landmarks)


def turn(points: np.ndarray, quarters: int, size: tuple[int, ...]) -> np.ndarray:
    """Turn points like :func:`numpy.rot90` turns an image of a size (width, height)."""
    for _ in range(quarters):
        points = np.column_stack([points[:, 1], size[0] - 1 - points[:, 0]])
        size = size[::-1]
    return points


@pytest.mark.parametrize("quarters", [1, 2])
def test_the_orientation_does_not_matter(portrait, quarters):
    """A picture may be turned, with its start."""
    size = portrait.image.shape[1::-1]
    turned_size = size if quarters == 2 else size[::-1]
    movement = portrait.moved(
        lambda image: np.rot90(image, quarters),
        there=lambda points: turn(points, quarters, size),
        back=lambda points: turn(points, 4 - quarters, turned_size),
    )
    assert movement < HARDLY


@pytest.mark.parametrize(("corner", "limit"), [((1, 0), LITTLE), ((4, 4), HARDLY)])
def test_what_is_cut_off_far_from_the_object_does_not_matter(portrait, corner, limit):
    """Of fits that are taken to the end; others may stop a tenth of a standard deviation away from it."""
    x, y = corner
    movement = portrait.moved(
        lambda image: image[y:, x:],
        Fitter(portrait.model, options=SolverOptions(early_tolerance=0.0)),
        there=lambda points: points - corner,
        back=lambda points: points + corner,
    )
    assert movement < limit


@pytest.mark.parametrize(("times", "how"), [(2.0, cv2.INTER_CUBIC), (0.5, cv2.INTER_AREA)])
def test_the_size_hardly_matters(portrait, times, how):
    shift = 0.5 * (times - 1.0)
    movement = portrait.moved(
        lambda image: cv2.resize(image, None, fx=times, fy=times, interpolation=how),
        there=lambda points: times * points + shift,
        back=lambda points: (points - shift) / times,
    )
    assert movement < LITTLE


def test_light_compression_hardly_matters(portrait):
    def compressed(image: np.ndarray) -> np.ndarray:
        file = io.BytesIO()
        Image.fromarray(image).save(file, "JPEG", quality=95)
        return np.asarray(Image.open(file))

    assert portrait.moved(compressed) < LITTLE
