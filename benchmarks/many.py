"""Images per second of ``liaam.fit_many`` on one thread and on two, compared with the gain that two cores allow.

Generated faces under hard light from the side are fitted with a model of the same head under diffuse light, from starts
with errors of a few per cent. The images are in memory. Time is wall-clock time. What two cores allow is measured in
turn with two processes, which share no interpreter: caches and memory are shared there too.
"""

import os
from collections.abc import Callable
from time import perf_counter

import numpy as np

from benchmarks.metrics import report
from liaam.fitting import Fitter, fit_each
from liaam.model import AAM
from liaam.model.shape import diagonal_of
from liaam.training import train
from scenes import DIFFUSE, Head, lateral, make_set

SIZE = (240, 180)
N_TRAINING, N_SCENES, N_PICTURES = 10, 8, 64
ROUNDS = 7
METHODS = ("soft-li", "li")
DIAGONAL = 150.0
BAR = 1.85


def make_model() -> AAM:
    """Model of one head under diffuse light."""
    scenes = make_set(N_TRAINING, Head(7), DIFFUSE, seed=1, size=SIZE)
    pairs = [(scene.image, scene.landmarks) for scene in scenes]
    return train(pairs, diagonal=DIAGONAL, leave_out=False, lamps=None, methods=METHODS)


def make_pictures() -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Images under light from the side, and starts."""
    rng = np.random.default_rng(2)
    scenes = make_set(N_SCENES, Head(7), lateral("left"), seed=2, size=SIZE)
    chosen = [scenes[i % N_SCENES] for i in range(N_PICTURES)]
    starts = [s.landmarks + rng.normal(scale=0.01, size=2) * diagonal_of(s.landmarks) for s in chosen]
    return [scene.image for scene in chosen], starts


def seconds(work: Callable[[], object]) -> float:
    """Wall-clock time of some work."""
    begin = perf_counter()
    work()
    return perf_counter() - begin


def in_processes(n: int, fit_all: Callable[[slice], None]) -> None:
    """Let each of ``n`` processes fit a share of the images."""
    children = []
    for i in range(1, n):
        if not (child := os.fork()):
            fit_all(slice(i, None, n))
            os._exit(0)
        children.append(child)
    fit_all(slice(0, None, n))
    for child in children:
        os.waitpid(child, 0)


def measure(fitter: Fitter, name: str, images: list[np.ndarray], starts: list[np.ndarray]) -> None:
    """Print the metrics of one method: medians over rounds that time all variants in turn."""

    def fits(workers: int, chosen: slice = slice(None)) -> None:
        for _ in fit_each(fitter, images[chosen], starts[chosen], workers=workers, progress=False):
            pass

    fits(2)
    kinds = {"threads": fits, "processes": lambda n: in_processes(n, lambda chosen: fits(1, chosen))}
    times = {(kind, n): np.empty(ROUNDS) for kind in kinds for n in (1, 2)}
    for i in range(ROUNDS):
        for (kind, n), own in times.items():
            own[i] = seconds(lambda kind=kind, n=n: kinds[kind](n))
    for n in (1, 2):
        report(f"many_{name}_rate_{n}", len(images) / np.median(times["threads", n]), "pictures a second", form=".1f")
    gain, machine = (float(np.median(times[kind, 1] / times[kind, 2])) for kind in kinds)
    report(f"many_{name}_speedup", gain, f"(bar: at least {BAR}, or 0.95 of two processes, {machine:.2f})", form=".2f")


def main() -> None:
    """Print the metrics."""
    model, (images, starts) = make_model(), make_pictures()
    for method in METHODS:
        measure(Fitter(model, method), method.replace("-", "_"), images, starts)


if __name__ == "__main__":
    main()
