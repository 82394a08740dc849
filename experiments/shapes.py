"""Objects of two kinds of shape: what one Gaussian of shapes loses, and what a model for each kind loses.

Every other image of a folder is mirrored with its landmarks, or its object is bent into another outline. One half of
the images, of both kinds, trains, the other half is fitted without a start, and the other way round.
"""

from contextlib import suppress
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np

from experiments.charts import figure_of_bars
from experiments.protocol import Header, Table, in_percent, select, tell
from experiments.runner import Experiment, Row
from experiments.spot import percent
from experiments.subjects import data_facts
from liaam.datasets import load_folder
from liaam.errors import LiaamError, TrainingError
from liaam.evaluation import nme
from liaam.fitting import Fitter
from liaam.model.shape import align, diagonal_of, scaled_mean
from liaam.training import train

KINDS = ("as it is", "mirrored", "bent")
"""What is done to every other image."""

MODELS: dict[str, int | str] = {"one Gaussian": 1, "as found": "auto"}
"""Values of the option ``shapes`` by what they stand for."""

LIMIT = 0.03
"""Error, as a fraction of the diagonal of the landmarks' box, above which a fit is lost."""

BEND, TAPER, CURVE = 0.5, 1.8, 1.4
"""Coefficients of the other outline: (x + BEND y², y (1 + TAPER x) + CURVE x²), coordinates in diagonals."""

COLUMNS = {"kind": "", "model": "", "picture": "", "shapes": "", "error": ".6f", "status": ""}
"""Columns of results.csv; ``shapes`` is the number of shapes of the model, 0 if training is refused."""


class Half(NamedTuple):
    """One half of the images of a kind, to be fitted by a model of the other half: one task."""

    kind: str
    model: str
    fold: int

    @property
    def key(self) -> str:
        """Key of the task in the journal."""
        return f"{self.kind}, {self.model}, half {self.fold}"


def bent(points: np.ndarray) -> np.ndarray:
    """Move points (n, 2), in diagonals from the middle of the object."""
    x, y = points.T
    return np.column_stack([x + BEND * y * y, y * (1 + TAPER * x) + CURVE * x * x])


def changed(image: np.ndarray, points: np.ndarray, kind: str, mean: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mirror or bend an image and its landmarks; ``mean`` (n, 2) is the mean shape, with diagonal 1."""
    if kind == KINDS[0]:
        return image, points
    if kind == "mirrored":
        return np.ascontiguousarray(image[:, ::-1]), points * [-1.0, 1.0] + [image.shape[1] - 1.0, 0.0]
    pose, (height, width) = align(points, mean), image.shape[:2]
    there = pose(np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1).reshape(-1, 2).astype(float))
    source = there
    for _ in range(60):  # a contraction near the object
        source = np.clip(source - 0.7 * (bent(source) - there), -9.0, 9.0)
    at = pose.inverse()(source).astype(np.float32).reshape(height, width, 2)
    image = cv2.remap(image, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
    return image, pose.inverse()(bent(pose(points)))


@lru_cache(maxsize=1)
def get_pictures(data: Path, kind: str) -> list[tuple[str, np.ndarray, np.ndarray]]:
    """Return names, images and landmarks, every other one changed; once per process."""
    samples = list(load_folder(data))
    mean = scaled_mean(np.array([sample.landmarks.points for sample in samples]), 1.0)
    kinds = [kind if i % 2 else KINDS[0] for i in range(len(samples))]
    return [
        (sample.name, *changed(sample.read_image(), sample.landmarks.points, own, mean))
        for sample, own in zip(samples, kinds, strict=True)
    ]


def fit_half(data: Path, task: Half) -> list[Row]:
    """Train on one half and fit the other."""
    pictures, rows, fitter = get_pictures(data, task.kind), [], None
    halves = [[each for i, each in enumerate(pictures) if i // 2 % 2 == half] for half in range(2)]  # of both kinds
    with suppress(TrainingError):
        training = [(image, points) for _, image, points in halves[1 - task.fold]]
        fitter = Fitter(train(training, shapes=MODELS[task.model], lamps=None))
    for name, image, points in halves[task.fold]:
        found: Row = {"shapes": 0, "error": np.inf, "status": "not trained"}
        if fitter is not None:
            result = fitter.fit(image, name=name)
            error = nme(result.landmarks, points, diagonal_of(points))
            found = {"shapes": len(fitter.parts), "error": error, "status": str(result.status)}
        rows.append({"kind": task.kind, "model": task.model, "picture": name} | found)
    return rows


def shapes_experiment(data: Path) -> Experiment:
    """Make the experiment of a folder of landmarked images."""
    samples = list(load_folder(data))
    if len(samples) < 40:
        raise LiaamError(f"{data}: {len(samples)} images, but 40 are needed, 10 of each kind to train on")
    return Experiment(
        name="shapes",
        title="Objects of two kinds of shape",
        settings=data_facts(samples),
        tasks=tuple(Half(kind, model, fold) for kind in KINDS for model in MODELS for fold in range(2)),
        work=partial(fit_half, data),
        columns=COLUMNS,
        summarise=summarise,
        draw=lambda rows, summary: figure_of_bars(lost(summary), "lost, %"),
        report=lambda rows, summary: tell(
            "What is lost, in images of two kinds of shape, by one Gaussian and by a model for each kind found? Lost: "
            f"errors above {LIMIT:.0%} of the diagonal. A set that cannot be trained on is lost.",
            table(summary),
        ),
    )


def summarise(rows: list[Row]) -> dict[str, Any]:
    """Statistics by kind and model."""
    return {"kinds": {k: {model: _cell(select(rows, kind=k, model=model)) for model in MODELS} for k in KINDS}}


def _cell(rows: list[Row]) -> dict[str, Any]:
    errors = np.array([row["error"] for row in rows])
    median, p90 = (float(np.percentile(errors, q)) if np.isfinite(errors).all() else None for q in (50, 90))
    shapes = ", ".join(str(number) for number in sorted({row["shapes"] for row in rows}))
    return {"shapes": shapes, "median": median, "p90": p90, "lost": float((errors > LIMIT).mean())}


def table(summary: dict[str, Any]) -> tuple[Header, Table]:
    """Tabulate errors by kind and model."""
    return ["every other image", "model", "shapes", "median", "p90", "lost"], [
        [kind, model, cell["shapes"], percent(cell["median"]), percent(cell["p90"]), percent(cell["lost"], 1)]
        for kind, each in summary["kinds"].items()
        for model, cell in each.items()
    ]


def lost(summary: dict[str, Any]) -> dict[str, dict[str, float | None]]:
    """Return the share of lost fits, in per cent, by kind and model."""
    return {kind: in_percent({m: cell["lost"] for m, cell in each.items()}) for kind, each in summary["kinds"].items()}
