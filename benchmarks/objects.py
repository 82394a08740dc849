"""Objects that vary: accuracy and honesty of fits, beside regression trees that are trained on the same pictures.

``python -m benchmarks objects``: for each set, models of :data:`N_TRAINING` pictures are fitted to others, from the box
of the true landmarks and without a start. Generated sets (:mod:`scenes.varied`) are always there; sets of photographs
are if the shared data are. dlib's trees run beside if they are installed (``pip install dlib``), from the true box. So
does the mean shape stretched into the true box, which no fit should be worse than.

Errors are mean distances of the landmarks in % of the diagonal of their box. A fit is lost beyond 5 %, silent if it is
lost and its status is ok, refused if it is right and its status is not ok.
"""

import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from importlib.util import find_spec

import numpy as np

from benchmarks.metrics import report
from benchmarks.track import data_folder
from benchmarks.trees import dlib_box, points_of, trained_trees
from liaam.datasets import load_folder
from liaam.fitting import Fitter
from liaam.model.shape import diagonal_of
from liaam.training import train
from scenes.varied import AnimalFromAbove, Fish, JointedBars, Picture, WalkingAnimal

N_TRAINING = 40
N_TEST = 24
DRAWS = 2
LOST = 5.0
"""Error beyond which a fit is lost, % of the diagonal."""

LOT = 5
"""Number of fish of one lot that train; others are of other lots."""

PHOTOGRAPHS = ("wings", "ceph", "shells")
TREES = {"tree_depth": 2, "oversampling_amount": 50, "oversampling_translation_jitter": 0.05}
"""Options of dlib's trainer, tuned on sets of specimens."""


@dataclass
class Errors:
    """Errors of fits, % of the diagonal, and whether their status is ok."""

    errors: list[float] = field(default_factory=list)
    are_ok: list[bool] = field(default_factory=list)

    def add(self, landmarks: np.ndarray, truth: np.ndarray, is_ok: bool = True) -> None:
        """Add a fit; one without finite landmarks is lost."""
        error = 100.0 * float(np.linalg.norm(landmarks - truth, axis=1).mean()) / diagonal_of(truth)
        self.errors.append(error if np.isfinite(error) else np.inf)
        self.are_ok.append(is_ok)

    def report(self, name: str, note: str = "") -> None:
        """Report the median and the shares of fits that are lost, silent and refused."""
        lost = np.array(self.errors) > LOST
        ok = np.array(self.are_ok)
        p90 = np.percentile(self.errors, 90)
        report(f"{name}_median", float(np.median(self.errors)), f"% of the diagonal, p90 {p90:.2f}; {note}", form=".2f")
        report(f"{name}_lost", 100.0 * float(lost.mean()), f"% of {len(lost)} fits", form=".1f")
        report(f"{name}_silent", 100.0 * float((lost & ok).mean()), "% lost with a status that is ok", form=".1f")
        report(f"{name}_refused", 100.0 * float((~lost & ~ok).mean()), "% right with one that is not", form=".1f")


def main() -> None:
    """Measure all sets that are there."""
    for name in ("fish", "lot", "walking", "above", "bars", *PHOTOGRAPHS):
        if name not in PHOTOGRAPHS or (data_folder() / name).is_dir():
            measure(name)


def measure(name: str) -> None:
    """Measure a set by its name."""
    from_box = Errors()
    found = Errors()
    in_box = Errors()
    trees = Errors()
    for draw in range(DRAWS):
        training, others = pictures_of(name, draw)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # pictures that are left out, and the like
            fitter = Fitter(train(training, progress=False))
        mean = np.mean([(shape - shape.min(axis=0)) / np.ptp(shape, axis=0) for _, shape in training], axis=0)
        for image, truth in others:
            low = truth.min(axis=0)
            high = truth.max(axis=0)
            in_box.add(low + mean * (high - low), truth)
            for start, errors in ((np.concatenate([low, high]), from_box), (None, found)):
                result = fitter.fit(image, start)
                errors.add(result.landmarks, truth, bool(result.status.ok))
        for landmarks, (_, truth) in zip(fits_of_trees(training, others), others, strict=False):
            trees.add(landmarks, truth)
    report(f"objects_{name}_mean_in_box", float(np.median(in_box.errors)), "% of the diagonal", form=".2f")
    from_box.report(f"objects_{name}_box", "from the true box")
    found.report(f"objects_{name}_found", "without a start")
    if trees.errors:
        trees.report(f"objects_{name}_trees", "dlib's regression trees from the true box")


def pictures_of(name: str, draw: int) -> tuple[list[Picture], list[Picture]]:
    """Return the pictures of a set that train, and others."""
    rng = np.random.default_rng([9, draw])
    if name in PHOTOGRAPHS:
        samples = list(load_folder(data_folder() / name))
        chosen = [samples[i] for i in rng.permutation(len(samples))[: N_TRAINING + N_TEST]]
        pictures = [(sample.read_image(), sample.landmarks.points) for sample in chosen]
        return pictures[:N_TRAINING], pictures[N_TRAINING:]
    if name == "lot":
        lot = Fish.drawn(rng)
        training = [lot.varied(rng, 0.02).picture(rng) for _ in range(LOT)]
        return training, [Fish.drawn(rng).varied(rng, 0.02).picture(rng) for _ in range(N_TEST)]
    if name == "fish":
        drawn = [Fish.drawn(rng).varied(rng, 0.05) for _ in range(N_TRAINING + N_TEST)]
        pictures = [fish.picture(rng) for fish in drawn]
    else:
        kind = {"walking": WalkingAnimal, "above": AnimalFromAbove, "bars": JointedBars}[name].drawn(rng)
        pictures = [kind.picture(rng) for _ in range(N_TRAINING + N_TEST)]
    return pictures[:N_TRAINING], pictures[N_TRAINING:]


def fits_of_trees(training: Sequence[Picture], others: Sequence[Picture]) -> Iterator[np.ndarray]:
    """Yield the landmarks that dlib's trees find in other pictures, from the true box; nothing if dlib is missing."""
    if find_spec("dlib") is None:
        return
    predictor = trained_trees(training, **TREES)
    for image, truth in others:
        yield points_of(predictor(image, dlib_box(truth)).parts())
