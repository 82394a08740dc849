"""Pictures of specimens for a scripted person: deformed copies of photographs of fly wings, with their landmarks."""

import random
from pathlib import Path

import numpy as np

from liaam.datasets import load_folder
from liaam.io import Landmarks, write_collection, write_image

# Standard deviations of what sets a picture apart from the photograph
TURN = np.radians(5)  # Of its angle
SCALE = 0.04  # Of the logarithm of its size
SHIFT = 0.02  # Of its position, relative to the width
BEND = 0.01  # Of the movement of its parts, relative to the width; between 4 x 4 places it is interpolated
GAMMA = 0.15  # Of the logarithm of the exponent of its values
NOISE = 2.0  # Of the noise of its values, which are up to 255

STEPS = 20  # Of the iteration that inverts the bent map: more than enough, since the bend changes slowly


def deformed(image: np.ndarray, points: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Turn, scale, move and bend a picture, and change its light and noise; return it with its landmarks (n, 2)."""
    import cv2

    height, width = image.shape[:2]
    turn = rng.normal(0, TURN)
    size = np.exp(rng.normal(0, SCALE))
    matrix = size * np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    middle = np.array([width, height]) / 2
    shift = middle + rng.normal(0, SHIFT * width, 2) - matrix @ middle
    bend = cv2.resize(rng.normal(0, BEND * width, (4, 4, 2)), (width, height), interpolation=cv2.INTER_CUBIC)
    pixels = np.stack(np.meshgrid(np.arange(width), np.arange(height)), -1)
    source = ((pixels - shift) @ np.linalg.inv(matrix).T + bend).astype(np.float32)
    warped = cv2.remap(image, source[..., 0], source[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    # The picture is looked up at the place in the photograph of each pixel, so that landmarks go the other way.
    placed = points @ matrix.T + shift
    for _ in range(STEPS):
        x, y = np.clip(placed.round().astype(int), 0, [width - 1, height - 1]).T
        placed = (points - bend[y, x]) @ matrix.T + shift
    lit = 255 * (warped / 255.0) ** np.exp(rng.normal(0, GAMMA)) + rng.normal(0, NOISE, warped.shape)
    return np.clip(lit, 0, 255).astype(np.uint8), placed


def write_wings(data: Path, folder: Path, count: int, labelled: int, slip: bool = False) -> dict[str, np.ndarray]:
    """Write pictures, and ``wings.tps`` with the landmarks of the first; return the landmarks of all by name.

    Those with landmarks and the others are of different wings. A ``slip`` exchanges two points of the first.
    """
    wings = [(sample.read_image(), sample.landmarks.points) for sample in load_folder(data).samples]
    random.Random(1).shuffle(wings)
    half = len(wings) // 2
    of_labelled = wings[:half]
    of_others = wings[half:]
    rng = np.random.default_rng(1)
    truth = {}
    for i in range(count):
        source = of_labelled[i % len(of_labelled)] if i < labelled else of_others[i % len(of_others)]
        name = f"wing-{i:03d}.jpg"
        image, truth[name] = deformed(*source, rng)
        write_image(folder / name, image)
    given = {name: truth[name].copy() for name in list(truth)[:labelled]}
    if slip:
        given["wing-000.jpg"][[1, 2]] = given["wing-000.jpg"][[2, 1]]
    sizes = dict.fromkeys(given, wings[0][0].shape[1::-1])
    write_collection(folder / "wings.tps", {name: Landmarks(points) for name, points in given.items()}, sizes)
    return truth
