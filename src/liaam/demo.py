"""The demo: train on generated heads under soft light, and fit them under hard light with four methods."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from liaam.datasets import load_heads
from liaam.error_measures import point_error
from liaam.fitting import Fitter
from liaam.io import make_folder
from liaam.model.shape import align, rotation
from liaam.plotting import figure_of_fits, save_figure
from liaam.progress import Progress
from liaam.training import train

METHODS = ("grey", "rgb", "li", "soft-li")

SHOWN = 2  # Number of the head that the figure shows


@dataclass(frozen=True)
class DemoRow:
    """Shapes that a method found, (heads, n, 2), and their mean distances from the true landmarks in pixels."""

    method: str
    shapes: np.ndarray
    errors: np.ndarray


def run_demo(folder: Path, progress: Progress | None = None) -> tuple[list[DemoRow], np.ndarray]:
    """Train, fit and write ``figure.png`` to a folder. Return the rows and the errors of the starts in pixels."""
    make_folder(folder)  # raise before any work
    tell = progress or (lambda done, total, what: None)
    total = 1 + len(METHODS)
    tell(0, total, "training")
    training, test = load_heads()
    model = train(training, lamps=None, methods=METHODS, leave_out=False, progress=False)
    images = [sample.read_image() for sample in test]
    truths = [sample.landmarks.points for sample in test]
    starts = [disturbed(truth, model.shape_model.mean) for truth in truths]
    rows = []
    for i, method in enumerate(METHODS):
        tell(1 + i, total, f"fitting with {method}")
        fitter = Fitter(model, method)
        shapes = [fitter.fit(image, start).landmarks for image, start in zip(images, starts, strict=True)]
        rows.append(DemoRow(method, np.array(shapes), _errors(shapes, truths)))
    fits = {row.method: (row.shapes[SHOWN], row.errors[SHOWN]) for row in rows}
    figure = figure_of_fits(training[3 * SHOWN].read_image(), images[SHOWN], starts[SHOWN], truths[SHOWN], fits, model)
    save_figure(figure, folder / "figure.png")
    tell(total, total, "done")
    return rows, _errors(starts, truths)


def _errors(shapes: list[np.ndarray], truths: list[np.ndarray]) -> np.ndarray:
    return np.array([point_error(shape, truth) for shape, truth in zip(shapes, truths, strict=True)])


def disturbed(truth: np.ndarray, mean: np.ndarray) -> np.ndarray:
    """Place the mean shape near the truth with an error in position, rotation and scale, as a rough click has."""
    rough = align(mean, truth)(mean)
    centre = rough.mean(axis=0)
    return 1.06 * (rough - centre) @ rotation(np.deg2rad(4.0)).T + centre + [5.0, -4.0]
