"""Pictures a second of batched fits on every array library at hand, beside the loop over ``Fitter.fit``.

Generated faces under hard light from the side, fitted with a model of the same head under diffuse light, from starts a
few per cent off: each fit is a different one. One thread, but for a GPU, which is taken where a library finds one. The
pictures are in memory; what a library compiles, and what numba does, is compiled before.
"""

import os
from collections.abc import Callable
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from time import perf_counter

import cv2
import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks.metrics import report
from liaam.datasets.scenes import DIFFUSE, Head, lateral, make_set
from liaam.fitting import Fitter
from liaam.fitting.batched import BatchFitter
from liaam.kernels.backends import BACKENDS
from liaam.model import AAM
from liaam.shape import diagonal_of
from liaam.training import train

SIZE = (240, 180)
N_TRAINING, N_SCENES, N_PICTURES = 10, 8, 48
BATCH_SIZES = (1, 48)
METHODS = ("li", "soft-li")
DIAGONAL = 150.0

Picture = tuple[np.ndarray, np.ndarray]


def make_model() -> AAM:
    """Model of one head under diffuse light."""
    scenes = make_set(N_TRAINING, Head(7), DIFFUSE, seed=1, size=SIZE)
    return train([(scene.image, scene.landmarks) for scene in scenes], diagonal=DIAGONAL, leave_out=False)


def make_pictures() -> list[Picture]:
    """Pictures under light from the side, and starts."""
    rng = np.random.default_rng(2)
    scenes = make_set(N_SCENES, Head(7), lateral("left"), seed=2, size=SIZE)
    pictures = []
    for i in range(N_PICTURES):
        scene = scenes[i % N_SCENES]
        shift = rng.normal(scale=0.01, size=2) * diagonal_of(scene.landmarks)
        pictures.append((scene.image, scene.landmarks + shift))
    return pictures


def per_second(work: Callable[[], object]) -> float:
    """Pictures a second, once everything is compiled."""
    begin = perf_counter()
    work()
    return N_PICTURES / (perf_counter() - begin)


def prepare(backend: str) -> str | None:
    """Bring a library down to one thread; the device that it will use, or None where it is not installed."""
    if find_spec(backend) is None:
        return None
    if backend == "torch":
        torch = import_module("torch")
        torch.set_num_threads(1)
        return "cuda" if torch.cuda.is_available() else "cpu"
    if backend == "jax":
        return import_module("jax").devices()[0].platform
    return "cpu"


def main() -> None:
    # Read when JAX is first imported.
    os.environ.setdefault("XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1")
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    cv2.setNumThreads(1)
    model, pictures = make_model(), make_pictures()
    images, starts = map(list, zip(*pictures, strict=True))
    print(f"batched fits: {model.n_pixels} pixels, {len(model.shape_model.basis)} shape parameters, 1 thread")
    with threadpool_limits(1):
        for method in METHODS:
            compare(Fitter(model, method), method, images, starts)


def compare(fitter: Fitter, method: str, images: list[np.ndarray], starts: list[np.ndarray]) -> None:
    """Print the metrics of one method."""
    fitter.fit(images[0], starts[0])
    loop = per_second(lambda: [fitter.fit(*picture) for picture in zip(images, starts, strict=True)])
    report(f"{method}_loop_per_second", loop, form=".2f", width=40)
    for backend in BACKENDS:
        device = prepare(backend)
        if device is None:
            print(f"  {method}_{backend}: not installed")
            continue
        batched = BatchFitter(fitter, backend)
        for size in BATCH_SIZES:
            batched.fit(images[:size], starts[:size], size)
            rate = per_second(partial(batched.fit, images, starts, size))
            name = f"{method}_{backend}_{device}_batch_{size}_per_second"
            report(name, rate, f"({rate / loop:.2f} of the loop)", form=".2f", width=40)


if __name__ == "__main__":
    main()
