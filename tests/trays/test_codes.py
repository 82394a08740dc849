"""QR and bar codes in images."""

import sys

import cv2
import numpy as np
import pytest

from liaam.errors import LiaamError
from liaam.trays import codes as module, read_codes

zxingcpp = pytest.importorskip("zxingcpp")


def qr(text: str, side: int = 3) -> np.ndarray:
    return cv2.resize(cv2.QRCodeEncoder.create().encode(text), None, fx=side, fy=side, interpolation=cv2.INTER_NEAREST)


def bars(text: str, form: str = "Code128", width: int = 2) -> np.ndarray:
    made = zxingcpp.create_barcode(text, zxingcpp.barcode_format_from_str(form))
    line = np.array(zxingcpp.write_barcode_to_image(made, scale=1))[:1]
    return np.pad(np.repeat(np.repeat(line, width, axis=1), 60, axis=0), 20, constant_values=255)


def sheet(rng, *pictures: np.ndarray, turn: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Give an image with pictures side by side, turned by degrees, and their middles."""
    image = np.full((420, 240 * len(pictures) + 200, 3), 205, np.uint8)
    middles = []
    for i, picture in enumerate(pictures):
        top, left = 210 - picture.shape[0] // 2, 220 + 240 * i - picture.shape[1] // 2
        image[top : top + picture.shape[0], left : left + picture.shape[1]] = picture[:, :, None]
        middles.append((left + (picture.shape[1] - 1) / 2, top + (picture.shape[0] - 1) / 2))
    matrix = cv2.getRotationMatrix2D((image.shape[1] / 2, 210), turn, 1)
    turned = cv2.warpAffine(image, matrix, image.shape[1::-1], borderValue=(205, 205, 205))
    blurred = cv2.GaussianBlur(turned, (0, 0), 0.7) + rng.normal(0, 3, image.shape)
    return np.clip(blurred, 0, 255).astype(np.uint8), np.array(middles) @ matrix[:, :2].T + matrix[:, 2]


@pytest.mark.parametrize("turn", [0, 7, 31, 45, 90, 170])
def test_codes_are_read_at_any_angle_where_they_are(rng, turn):
    image, middles = sheet(rng, qr("NHM 1"), bars("AB-12"), turn=turn)
    found = {code.text: code.corners.mean(axis=0) for code in read_codes(image)}
    assert found.keys() == {"NHM 1", "AB-12"}
    np.testing.assert_allclose(found["NHM 1"], middles[0], atol=6)
    np.testing.assert_allclose(found["AB-12"], middles[1], atol=20)  # its height is not known exactly


@pytest.mark.parametrize("dtype", [np.uint16, np.float32])
def test_images_of_all_types_are_read(rng, dtype):
    image, _ = sheet(rng, qr("A"))
    scaled = image.astype(dtype) * (257 if dtype is np.uint16 else 1 / 255)
    assert [code.text for code in read_codes(scaled.astype(dtype))] == ["A"]
    assert [code.text for code in read_codes(image[:, :, 0])] == ["A"]


def test_one_text_at_two_places_is_two_codes(rng):
    image, middles = sheet(rng, qr("A"), qr("A"))
    found = sorted(code.corners.mean(axis=0)[0] for code in read_codes(image))
    np.testing.assert_allclose(found, middles[:, 0], atol=6)


def test_a_large_image_is_read_as_it_is(rng, monkeypatch):
    image, middles = sheet(rng, qr("A", side=5))
    monkeypatch.setattr(module, "SMALL", 100)
    (code,) = read_codes(image)
    np.testing.assert_allclose(code.corners.mean(axis=0), middles[0], atol=6)


def test_texts_are_one_printable_line(rng):
    image, _ = sheet(rng, qr("../a\n b\x07"), qr("x" * 150, side=2))
    assert [code.text for code in read_codes(image)] == ["../a b"]


def test_no_codes_are_none(image_of_nothing):
    assert read_codes(image_of_nothing) == []


@pytest.mark.parametrize("kind", ["plain", "hierarchical", "blocks", "steel"])
def test_rulers_are_no_codes(rng, kind):
    from scenes.ruler import draw

    assert read_codes(draw(kind, rng, ground="veins").image) == []


def test_the_decoder_is_an_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "zxingcpp", None)
    with pytest.raises(LiaamError, match=r'reading codes needs zxing-cpp; run pip install "\.\[codes\]"'):
        read_codes(np.zeros((20, 20), np.uint8))
