"""Detection rate and time of the search for faces of unseen persons.

The images of a folder are split into two halves by person, given by the beginning of their names. Each half is searched
with a model of the other. A face is found if the mean error of the start's landmarks is below a quarter of the distance
between the eyes. That distance is taken as 0.3 of the landmarks' diagonal, as on frontal faces.
"""

from pathlib import Path
from time import process_time

import cv2
import numpy as np

from benchmarks.metrics import report
from liaam.datasets import Dataset, load_folder
from liaam.fitting import Finder
from liaam.model.shape import diagonal_of
from liaam.photometry import is_grey
from liaam.training import train
from scenes import DIFFUSE, Head, lateral, random_expression, random_pose, render

EYES = 0.3
LIMIT = 0.25
N_HEADS = 6
SIZE = (240, 180)

Picture = tuple[np.ndarray, np.ndarray]


def scenes() -> tuple[list[Picture], list[Picture]]:
    """Return generated images of some heads under diffuse light, and of others also under light from either side."""

    def picture(seed: int, lights) -> Picture:
        rng = np.random.default_rng(seed)
        scene = render(Head(seed), random_pose(rng, SIZE), random_expression(rng), lights, size=SIZE)
        return scene.image, scene.landmarks

    training = [picture(seed, DIFFUSE) for seed in range(N_HEADS)]
    lamps = (DIFFUSE, lateral("left"), lateral("right"))
    return training, [picture(seed, lights) for seed in range(100, 100 + N_HEADS) for lights in lamps]


def half_sets(folder: Path, letters: int) -> list[tuple[Dataset, Dataset]]:
    """Split a folder's colour images by person into training and test images, in both directions."""
    data = load_folder(folder)
    data = data.select(lambda sample: not is_grey(sample.read_image()))
    persons = sorted({sample.name[:letters] for sample in data})

    def half(which: int) -> Dataset:
        return data.select(lambda sample: persons.index(sample.name[:letters]) % 2 == which)

    return [(half(which), half(1 - which)) for which in (0, 1)]


def pictures_of(samples: Dataset) -> list[Picture]:
    """Images and landmarks of a data set."""
    return [(sample.read_image(), sample.landmarks.points) for sample in samples]


def measure(training: list[Picture], tests: list[Picture]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Errors as fractions of the distance between the eyes, seconds of one core, and scores, (n,) each."""
    finder = Finder(train(training, lamps=None))
    finder.find(tests[0][0])  # makes the templates
    rows = []
    for image, truth in tests:
        before = process_time()
        (found,) = finder.find(image)
        seconds = process_time() - before
        error = np.linalg.norm(found.landmarks - truth, axis=1).mean() / (EYES * diagonal_of(truth))
        rows.append((error, seconds, found.score))
    errors, seconds, scores = np.array(rows).T
    return errors, seconds, scores


def main(folder: str | None = None, letters: int = 2) -> None:
    """Print the metrics for generated images or a folder. The first `letters` of a name identify the person."""
    cv2.setNumThreads(1)
    folds = (
        [scenes()]
        if folder is None
        else [(pictures_of(training), pictures_of(tests)) for training, tests in half_sets(Path(folder), letters)]
    )
    errors, seconds, scores = np.concatenate([measure(*fold) for fold in folds], axis=1)
    report("search_found_percent", 100 * (errors < LIMIT).mean(), f"of {len(errors)}", form=".1f")
    report("search_error", float(np.median(errors)), f"worst {errors.max():.3f}")
    report("search_seconds", float(np.median(seconds)), f"worst {seconds.max():.3f}")
    report("search_score", float(np.median(scores)), f"lowest {scores.min():.2f}", form=".2f")


if __name__ == "__main__":
    import sys

    main(sys.argv[1] if len(sys.argv) > 1 else None, int(sys.argv[2]) if len(sys.argv) > 2 else 2)
