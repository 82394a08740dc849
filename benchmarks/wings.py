"""Pictures of specimens for a scripted person: deformed copies of photographs of fly wings, with their landmarks."""

import random
from pathlib import Path

import numpy as np

from liaam.datasets import load_folder
from liaam.io import Landmarks, write_collection, write_image


def deformed(image: np.ndarray, points: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Turn, scale, move and bend a picture, and change its light and noise; return it with its landmarks (n, 2)."""
    import cv2

    height, width = image.shape[:2]
    turn, size = rng.normal(0, np.radians(5)), np.exp(rng.normal(0, 0.04))
    matrix = size * np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    middle = np.array([width, height]) / 2
    shift = middle + rng.normal(0, 0.02 * width, 2) - matrix @ middle
    bend = cv2.resize(rng.normal(0, 0.01 * width, (4, 4, 2)), (width, height), interpolation=cv2.INTER_CUBIC)
    pixels = np.stack(np.meshgrid(np.arange(width), np.arange(height)), -1)
    source = ((pixels - shift) @ np.linalg.inv(matrix).T + bend).astype(np.float32)
    warped = cv2.remap(image, source[..., 0], source[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    placed = points @ matrix.T + shift
    for _ in range(20):  # the inverse of the bent map
        at = np.clip(placed.round().astype(int), 0, [width - 1, height - 1])
        placed = (points - bend[at[:, 1], at[:, 0]]) @ matrix.T + shift
    lit = 255 * (warped / 255.0) ** np.exp(rng.normal(0, 0.15)) + rng.normal(0, 2, warped.shape)
    return np.clip(lit, 0, 255).astype(np.uint8), placed


def write_wings(data: Path, folder: Path, count: int, labelled: int, slip: bool = False) -> dict[str, np.ndarray]:
    """Write pictures, and ``wings.tps`` with the landmarks of the first; return the landmarks of all by name.

    Those with landmarks and the others are of different wings. A ``slip`` exchanges two points of the first.
    """
    wings = [(sample.read_image(), sample.landmarks.points) for sample in load_folder(data).samples]
    random.Random(1).shuffle(wings)
    rng, half, truth = np.random.default_rng(1), len(wings) // 2, {}
    for i in range(count):
        which = i % half if i < labelled else half + i % (len(wings) - half)
        image, truth[name := f"wing-{i:03d}.jpg"] = deformed(*wings[which], rng)
        write_image(folder / name, image)
    given = {name: truth[name].copy() for name in list(truth)[:labelled]}
    if slip:
        given["wing-000.jpg"][[1, 2]] = given["wing-000.jpg"][[2, 1]]
    sizes = dict.fromkeys(given, wings[0][0].shape[1::-1])
    write_collection(folder / "wings.tps", {name: Landmarks(points) for name, points in given.items()}, sizes)
    return truth
