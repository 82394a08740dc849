"""Trays of six real specimens with their codes, composed from single photographs that the model was not trained on."""

import cv2
import numpy as np
import pytest

from liaam.datasets import Sample, load_folder
from liaam.fitting import Fitter
from liaam.fitting.specimens import fit_specimens
from liaam.io import read_image
from liaam.training import train

pytest.importorskip("zxingcpp")

HEIGHT = 480  # of the place of a specimen, pixels
WIDTH = 520
N_TRAYS = 3


def cut_out(sample: Sample) -> tuple[np.ndarray, np.ndarray]:
    """Give a specimen with some ground, at most 440 x 300 pixels, and its landmarks there."""
    picture = read_image(sample.image)
    points = np.asarray(sample.landmarks.points)
    margin = 0.12 * np.ptp(points, axis=0).max()
    left, top = np.maximum(np.floor(points.min(axis=0) - margin), 0).astype(int)
    right, bottom = np.minimum(np.ceil(points.max(axis=0) + margin), picture.shape[1::-1]).astype(int)
    part = picture[top:bottom, left:right]
    zoom = min(300 / part.shape[0], 440 / part.shape[1])
    part = cv2.resize(part, None, fx=zoom, fy=zoom, interpolation=cv2.INTER_AREA)
    colour = part if part.ndim == 3 else np.repeat(part[:, :, None], 3, axis=2)
    return colour, (points - (left, top) + 0.5) * zoom - 0.5


def label(text: str) -> np.ndarray:
    code = cv2.resize(cv2.QRCodeEncoder.create().encode(text), None, fx=3, fy=3, interpolation=cv2.INTER_NEAREST)
    return cv2.copyMakeBorder(code, 6, 6, 6, 6, cv2.BORDER_CONSTANT, value=255)


def compose(samples: list[Sample], texts: list[str]) -> tuple[np.ndarray, list[np.ndarray]]:
    """Give a photograph of six specimens, each above its code, and their landmarks."""
    tray = np.full((2 * HEIGHT, 3 * WIDTH, 3), 225, np.uint8)
    truth = []
    for i, (sample, text) in enumerate(zip(samples, texts, strict=True)):
        part, points = cut_out(sample)
        for picture, middle in ((part, 160), (label(text)[:, :, None], 400)):
            left = i % 3 * WIDTH + (WIDTH - picture.shape[1]) // 2
            top = i // 3 * HEIGHT + middle - picture.shape[0] // 2
            tray[top : top + picture.shape[0], left : left + picture.shape[1]] = picture
            if picture is part:
                truth.append(points + np.array([left, top]))
    return tray, truth


@pytest.fixture(scope="module")
def wings(shared_data):
    """Give a model of real wings, and the wings that it was not trained on."""
    samples = list(load_folder(shared_data / "wings"))
    return train([sample for i, sample in enumerate(samples) if i % 5], lamps=None), samples[::5]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["wings", "shells"])
def test_six_specimens_of_a_tray_are_found_and_none_is_mixed_up(request, rng, name):
    model, held_out = request.getfixturevalue(name)
    errors = []
    for tray in range(N_TRAYS):
        texts = [f"T{tray}-{i}" for i in range(6)]
        chosen = [held_out[i] for i in rng.choice(len(held_out), 6, replace=False)]
        image, truth = compose(chosen, texts)
        fitted = fit_specimens(Fitter(model), image, name_by="code")
        assert [each.name for each in fitted.named] == [each.code for each in fitted.named] == texts
        for result, points in zip(fitted.results, truth, strict=True):
            size = np.hypot(*np.ptp(points, axis=0))
            errors.append(np.linalg.norm(result.landmarks - points, axis=1).mean() / size)
            # The next specimen is a diagonal away. A landmark of a shell may slide to the label below it.
            assert np.linalg.norm(result.landmarks.mean(axis=0) - points.mean(axis=0)) < 0.4 * size
    assert np.median(errors) < 0.02
