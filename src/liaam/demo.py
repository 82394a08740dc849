"""The demo: train on simulated portraits under one light and fit under a hard lateral light."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from liaam.evaluation import point_error
from liaam.fitting import FitResult, Fitter
from liaam.io import Contour, Landmarks, make_folder
from liaam.model.shape import align, rotation
from liaam.plotting import figure_of_fits, save_figure
from liaam.progress import Progress
from liaam.training import train

METHODS = ("grey", "rgb", "li", "soft-li")

N_TRAINING = 12


@dataclass(frozen=True)
class DemoRow:
    """One method's result, and its mean distance from the true landmarks in pixels."""

    method: str
    error: float
    result: FitResult


def run_demo(folder: Path, progress: Progress | None = None) -> tuple[list[DemoRow], float]:
    """Render, train, fit and write ``figure.png`` to a folder. Return the rows and the start's error in pixels."""
    from liaam.datasets.scenes import Expression, Head, Pose, lateral, make_set, render

    make_folder(folder)  # raise before any work
    tell = progress or (lambda done, total, what: None)
    total = N_TRAINING + 3
    head = Head(5)
    training = []
    for i in range(N_TRAINING):
        tell(i, total, "rendering training images")
        training += make_set(1, head=head, seed=i)
    test = render(head, Pose(yaw=0.06, x=3.0), Expression(smile=0.3, mouth_open=0.15), lights=lateral("left"), seed=99)
    tell(N_TRAINING, total, "training")
    pairs = [(scene.image, Landmarks(scene.landmarks, Contour.all_of(scene.contours))) for scene in training]
    model = train(pairs, name="demo head", lamps=None, methods=METHODS, leave_out=False, progress=False)
    start = disturbed(test.landmarks, model.shape_model.mean)
    rows = []
    for i, method in enumerate(METHODS):
        tell(N_TRAINING + 1 + (i > 0), total, f"fitting with {method}")
        result = Fitter(model, method).fit(test.image, start)
        rows.append(DemoRow(method, point_error(result.landmarks, test.landmarks), result))
    fits = {row.method: (row.result.landmarks, row.error) for row in rows}
    figure = figure_of_fits(training[0].image, test.image, start, test.landmarks, fits, model)
    save_figure(figure, folder / "figure.png")
    tell(total, total, "done")
    return rows, point_error(start, test.landmarks)


def disturbed(truth: np.ndarray, mean: np.ndarray) -> np.ndarray:
    """Place the mean shape near the truth with an error in position, rotation and scale, as a rough click has."""
    rough = align(mean, truth)(mean)
    centre = rough.mean(axis=0)
    return 1.06 * (rough - centre) @ rotation(np.deg2rad(4.0)).T + centre + [5.0, -4.0]
