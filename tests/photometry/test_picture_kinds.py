"""Images of Pillow, bytes of image files and open files are pictures like the files they come from."""

import io
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageCms

from liaam.errors import ImageError
from liaam.io import read_image
from liaam.photometry.encoding import as_colour
from liaam.photometry.picture import load_picture


@pytest.fixture
def photo(tmp_path: Path, rng: np.random.Generator) -> Path:
    """A photograph of a phone: turned by its EXIF orientation, with the profile of another colour space."""
    exif = Image.Exif()
    exif[0x0112] = 6
    pixels = rng.integers(0, 255, (12, 20, 3), np.uint8)
    profile = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    Image.fromarray(pixels).save(tmp_path / "a.png", exif=exif, icc_profile=profile)
    return tmp_path / "a.png"


def test_each_way_to_give_a_photograph_is_upright(photo: Path) -> None:
    right = read_image(photo)
    assert right.shape == (20, 12, 3)
    with Image.open(photo) as opened, photo.open("rb") as file:
        buffer = io.BytesIO(photo.read_bytes())
        buffer.seek(0, io.SEEK_END)  # as behind what was written
        for given in (opened, file, buffer, photo.read_bytes(), bytearray(photo.read_bytes())):
            for _ in range(2):  # an open file is read again
                np.testing.assert_array_equal(as_colour(given), right)
            pixels, name = load_picture(given, "image 3")
            np.testing.assert_array_equal(pixels, right)
            assert name == "image 3"


@pytest.mark.parametrize("mode", ["L", "P", "RGBA", "CMYK", "1", "LA", "YCbCr"])
def test_images_of_pillow_of_every_mode_are_colour(rng: np.random.Generator, mode: str) -> None:
    image = Image.fromarray(rng.integers(0, 255, (9, 10, 3), np.uint8)).convert(mode)
    expected = np.asarray(image.convert("RGB"))
    np.testing.assert_array_equal(as_colour(image), expected)


def test_images_of_pillow_of_16_bits_keep_them(rng: np.random.Generator) -> None:
    pixels = rng.integers(0, 65535, (9, 10), np.uint16)
    assert (as_colour(Image.fromarray(pixels))[..., 1] == pixels).all()


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (b"no image", "image: .*is not a PNG, JPEG"),
        (b"", "is not a PNG, JPEG"),
        (io.StringIO("text"), "the open file holds text, not bytes: open an image file with open"),
    ],
)
def test_what_is_no_image_is_refused(given: object, words: str) -> None:
    with pytest.raises(ImageError, match=words.removeprefix("image: .*")) as caught:
        load_picture(given, "image 3")
    assert str(caught.value).startswith("image 3")


def test_a_cut_image_of_pillow_is_refused(photo: Path) -> None:
    cut = io.BytesIO(photo.read_bytes()[:-200])
    with pytest.raises(ImageError, match="image is damaged or cut short"):
        as_colour(Image.open(cut))
