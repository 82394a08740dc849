"""Helpers shared by tests: training, scenes, disturbed starts, fit problems, persons, files, growth of times, locks."""

import shutil
import sqlite3
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import fields
from pathlib import Path

import cv2
import numpy as np
import pytest

from liaam import _core
from liaam.fitting import get_method
from liaam.fitting.loop.encoded_image import EncodedImage
from liaam.fitting.loop.objective import Objective, make_objectives
from liaam.fitting.reference.problem import Problem
from liaam.io import write_image, write_landmarks
from liaam.model import AAM
from liaam.model.shape import align, diagonal_of
from liaam.photometry import CameraModel
from liaam.training import train
from scenes import (
    DIFFUSE,
    Expression,
    Head,
    Pose,
    Scene,
    lateral,
    random_expression,
    random_pose,
    render,
)

MOVING_FRAMES = 24


@contextmanager
def one_at_a_time(path: Path) -> Iterator[None]:
    """Let one process at a time work on a file, on every system.

    A database holds the lock, because the system lets go of it when its process is killed, which a lock made of a file
    would not survive. Nothing is written to it.
    """
    with closing(sqlite3.connect(path.with_name(f"{path.name}.lock"), timeout=3600, isolation_level=None)) as lock:
        lock.execute("BEGIN EXCLUSIVE")
        yield


def moving_scene(time: float, lights=DIFFUSE) -> Scene:
    """Take a head that turns and talks, at a time; it is back after one unit, which has so many frames."""
    swing, away = np.sin(2 * np.pi * time), np.cos(2 * np.pi * time)
    pose = Pose(yaw=0.12 * swing, roll=0.05 * swing, x=6 * swing, y=3 * away, scale=0.97)
    return render(Head(5), pose, Expression(mouth_open=0.3 + 0.25 * swing, smile=0.3), lights, size=(160, 120))


def train_on(scenes: list[Scene], response: str = "linear", **options) -> AAM:
    """Train on scenes with what is true of their camera, and on the shapes as they are: the scenes' span is known.

    Without lamps, unless some are given: what a fit makes of another light is then the method's merit.
    """
    pairs = [(scene.image, scene.landmarks) for scene in scenes]
    camera = CameraModel(theta=scenes[0].theta, response=response)
    as_they_are = {"prior": "sample", "leave_out": False, "methods": "all", "lamps": None}
    return train(pairs, camera=camera, **{**as_they_are, **options})


BODY = np.array([[0, 0], [26, -6], [52, 4], [60, 22], [34, 30], [8, 24], [24, 12], [40, 14]], float)
"""Landmarks of an object without symmetry, which :class:`TexturedObject` draws."""


class TexturedObject:
    """An object with a texture of its own, in images of a size (width, height)."""

    def __init__(self, rng: np.random.Generator, size: tuple[int, int]) -> None:
        width, height = size
        noise = rng.uniform(0, 255, (height, width, 3)).astype(np.float32)
        texture = cv2.GaussianBlur(noise, (0, 0), 2.0)
        self.size = size
        self.texture = np.clip(128 + 4 * (texture - texture.mean()), 20, 235)

    def photograph(self, shape: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Return an image of the object where a shape (8, 2) is, and its landmarks, with small errors."""
        at = BODY + np.array([24.0, 26.0])
        pose = align(at, shape)
        grid = np.column_stack([pose.matrix, pose.offset])
        image = cv2.warpAffine(self.texture, grid, self.size, borderMode=cv2.BORDER_REFLECT).astype(np.uint8)
        return image, pose(at + rng.normal(0.0, 0.2, at.shape))


def between(a, b):
    """Pose or expression half-way between two: inside the span of a training set that holds both."""
    return type(a)(**{f.name: 0.5 * (getattr(a, f.name) + getattr(b, f.name)) for f in fields(a)})


def disturb(shape: np.ndarray, scale: float = 1.03, shift: tuple[float, float] = (0.02, -0.015)) -> np.ndarray:
    """Scale a shape about its centre, and shift it by a share of its diagonal."""
    centre = shape.mean(axis=0)
    return (shape - centre) * scale + centre + np.array(shift) * diagonal_of(shape)


def model_pixels(model: AAM, shape: np.ndarray, truth: np.ndarray) -> float:
    """Mean distance of landmarks from the truth, in pixels of the model's reference frame."""
    scale = align(model.shape_model.mean, truth).scale
    return float(np.linalg.norm(shape - truth, axis=1).mean()) / scale


ENGINES = ("core", "reference")


def make_level(
    model: AAM, image: np.ndarray, start: np.ndarray, objective: Objective, blur: float = 0.5
) -> tuple[EncodedImage, np.ndarray]:
    """Encode one image for an objective, and return the warp parameters of the start."""
    pose = align(model.shape_model.mean, start)
    encoded = EncodedImage.at(image, start, pose, objective.method, model.response, blur, density=objective.density)
    return encoded, model.views[objective.method.view].shape_model.parameters(pose.inverse()(start))


def problem_of(objective: Objective, image: EncodedImage, engine: str):
    """Return an objective's problem at an image, of the core or the reference; skip what the core leaves out."""
    if engine == "reference":
        return Problem(objective, image)
    if not objective.is_compiled:
        pytest.skip("not in the core")
    return _core.Problem(objective.compiled, image.compiled)


@contextmanager
def without_core() -> Iterator[None]:
    """Fit with the reference meanwhile, as where the core could not be built."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Objective, "is_compiled", False)
        yield


def finest_objective(model: AAM, method) -> Objective:
    """Objective of a method at the model's sharpest level."""
    return make_objectives(model, get_method(method))[-1]


def stands_light(method: str) -> bool:
    """Tell whether a method has a minimum worth the name under another light; rounding decides where others go."""
    row = get_method(method)
    return row.encoding != "value" and row.metric != "chromaticity"


def write_person(folder: Path, person: int, conditions: str = "123456") -> None:
    """Write pictures of one person as the spot protocol names them; 5 has light from the side."""
    rng = np.random.default_rng(person)
    for condition in conditions:
        lights = lateral("left") if condition == "5" else DIFFUSE
        scene = render(Head(person), random_pose(rng, (200, 150)), random_expression(rng), lights, size=(200, 150))
        write_image(folder / f"{person:02d}-{condition}m.png", scene.image)
        write_landmarks(folder / f"{person:02d}-{condition}m.pts", scene.landmarks)


def copy_files(folder: Path, to: Path, *patterns: str) -> Path:
    """Copy the files of a folder whose names match; gives where to, made if need be."""
    to.mkdir(exist_ok=True)
    for pattern in patterns:
        for path in folder.glob(pattern):
            shutil.copy(path, to)
    return to


def open_files(folder: Path) -> list[Path]:
    """Files of a folder that this process holds open; none on systems that do not list them."""
    listed, found = Path("/proc/self/fd"), []
    for link in listed.iterdir() if listed.is_dir() else ():
        with suppress(OSError):  # closed meanwhile, such as this listing itself
            found.append(link.readlink())
    return [file for file in found if file.is_relative_to(folder)]


def growth(work: Callable[[int], object], small: int, times: int = 8) -> float:
    """Time of this process for work of ``times`` the small size, divided by that for the small size.

    About ``times`` if time is proportional to size, and its square if each part is compared with all others. Both are
    the least of three alternating runs, so that a busy machine hardly matters.
    """
    least = [np.inf, np.inf]
    for _ in range(3):
        for i, size in enumerate((small, times * small)):
            begun = time.process_time()
            work(size)
            least[i] = min(least[i], time.process_time() - begun)
    return least[1] / least[0]
