"""Time of a fit of a 640x480 image from a box, including preprocessing, and its scaling.

Models of generated faces with about 10,000 pixels and 24 shape parameters are fitted to images with similar expressions
and poses as in training, under light from the side. The object keeps its size in larger images.
"""

import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from functools import lru_cache, partial
from tempfile import TemporaryDirectory
from time import process_time

import cv2
import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks import iteration
from benchmarks.metrics import in_turn, report
from liaam.error_measures import point_error
from liaam.fitting import Fitter
from liaam.io import write_image
from liaam.model import AAM
from liaam.training import train
from scenes import DIFFUSE, Head, lateral, random_expression, random_pose, render

SIZE, LARGE = (640, 480), (6000, 4000)
N_TRAINING, N_PICTURES, ROUNDS = 24, 8, 5
DIAGONALS = {4_000: 95.0, 16_000: 190.0, 64_000: 380.0}
MODES, MODES_ROUNDS = (25, 50, 100, 200), 40
BARS = {"soft-li": 4.0, "li": 2.5}

Picture = tuple[np.ndarray, np.ndarray]


@lru_cache(maxsize=1)
def make_pictures() -> tuple[list[Picture], list[Picture]]:
    """Make training images under diffuse light, and test images under light from the side, 8-bit."""
    rng = np.random.default_rng(20080624)

    def picture(lights) -> Picture:
        scene = render(Head(1), random_pose(rng, SIZE), random_expression(rng), lights, size=SIZE)
        return scene.image, scene.landmarks

    return [picture(DIFFUSE) for _ in range(N_TRAINING)], [picture(lateral("left")) for _ in range(N_PICTURES)]


@lru_cache(maxsize=4)
def make_model(diagonal: float = 150.0) -> AAM:
    """Train a model with twenty shape modes and twenty appearance modes."""
    return train(
        make_pictures()[0],
        variance=20,
        appearance_variance=20,
        diagonal=diagonal,
        leave_out=False,
        lamps=None,
        methods=["li", "grey"],
    )


def box_of(shape: np.ndarray) -> np.ndarray:
    return np.concatenate([shape.min(axis=0), shape.max(axis=0)])


def milliseconds(calls: Sequence[Callable[[], object]]) -> np.ndarray:
    """Times of calls in turn, (ROUNDS, n), after one warm-up round."""
    return in_turn({"calls": calls}, ROUNDS)["calls"]


def fits(fitter: Fitter, pictures: list[Picture]) -> Sequence[Callable[[], object]]:
    return [partial(fitter.fit, image, box_of(shape)) for image, shape in pictures]


def median_error(shapes: Sequence[np.ndarray], pictures: list[Picture], diagonal: float) -> float:
    """Median distance of shapes from the truth, in pixels of a model of this diagonal."""
    scale = np.linalg.norm(np.ptp(pictures[0][1], axis=0)) / diagonal
    errors = [point_error(shape, truth) for shape, (_, truth) in zip(shapes, pictures, strict=True)]
    return float(np.median(errors) / scale)


def measure_fits() -> None:
    model, pictures = make_model(), make_pictures()[1]
    for method, bar in BARS.items():
        fitter = Fitter(model, method)
        median = float(np.median(milliseconds(fits(fitter, pictures))))
        results = [fitter.fit(image, box_of(shape)) for image, shape in pictures]
        error = median_error([result.landmarks for result in results], pictures, model.diagonal)
        steps = np.median([result.n_iterations for result in results])
        name = method.replace("-", "_")
        note = f"(bar: at most {bar:g}; {steps:.0f} iterations, {error:.2f} px off)"
        report(f"fit_{name}_ms", median, note, form=".2f", width=24)


def measure_growth() -> None:
    """Exponent of the time in the number of pixels, at a fixed number of steps."""
    sizes, times = [], []
    image, shape = make_pictures()[1][0]
    for diagonal in DIAGONALS.values():
        model = make_model(diagonal)
        fitter = Fitter(model, "li")
        sizes.append(model.n_pixels)
        objective = fitter.objectives[-1]
        times.append(float(np.median(milliseconds([iteration_of(fitter, objective, image, shape)]))))
    exponent = np.polyfit(np.log(sizes), np.log(times), 1)[0]
    told = ", ".join(f"{n}: {t:.2f} ms" for n, t in zip(sizes, times, strict=True))
    report("pixels_exponent", exponent, f"(bar: at most 1.1; {told})", form=".2f", width=24)


def iteration_of(fitter: Fitter, objective, image: np.ndarray, shape: np.ndarray) -> Callable[[], object]:
    """Return ten evaluations at the finest level, each with the Hessian and the gradient."""
    from liaam.fitting.loop.encoded_image import EncodedImage
    from liaam.model.shape import align

    pose = align(objective.warp.rest, shape)
    encoded = EncodedImage.at(image, shape, pose, objective.method, "srgb", fitter.model.levels[-1].blur)
    state, problem = objective.start(objective.warp.parameters(pose.inverse()(shape))), objective.problem(encoded)
    problem.begin(state.p, tuple(state.angles), state.lam)

    def evaluations() -> None:
        for _ in range(10):
            problem.evaluate(True)
            problem.differentiate(True, True)

    return evaluations


def measure_modes() -> None:
    """Exponent of an iteration's time in the number of appearance modes, at a fixed number of pixels."""
    for method in BARS:
        loops = {n: iteration.make_loops(*iteration.make_fit(method, n)) for n in MODES}
        calls = {f"{n} {name}": [call] for n, loop in loops.items() for name, call in loop.items()}
        times = in_turn(calls, MODES_ROUNDS, warm_up=3)
        more = [times[f"{n} more"] - times[f"{n} one"] for n in MODES]
        medians = [float(np.median(own)) / iteration.STEPS for own in more]
        exponent = np.polyfit(np.log(MODES), np.log(medians), 1)[0]
        last = np.log(medians[-1] / medians[-2]) / np.log(MODES[-1] / MODES[-2])
        told = ", ".join(f"{n}: {t:.2f} ms" for n, t in zip(MODES, medians, strict=True))
        name = f"modes_exponent_{method.replace('-', '_')}"
        report(name, exponent, f"(bar: at most 1; {last:.2f} from the last but one on; {told})", form=".2f", width=24)


def measure_large_picture() -> None:
    """The same object in an image of 24 megapixels."""
    fitter, (image, shape) = Fitter(make_model()), make_pictures()[1][0]
    large = np.zeros((LARGE[1], LARGE[0], 3), np.uint8)
    at = np.array([2000, 1500])
    large[at[1] : at[1] + image.shape[0], at[0] : at[0] + image.shape[1]] = image
    calls = [lambda: fitter.fit(image, box_of(shape)), lambda: fitter.fit(large, box_of(shape + at))]
    small, big = np.median(milliseconds(calls), axis=0)
    report("large_picture_ratio", big / small, "(bar: at most 1.3)", form=".2f", width=24)


FIRST_FIT = """
import sys, time
import numpy as np
import liaam
folder = sys.argv[1]
model, image = liaam.load_model(folder + "/model.liaam"), liaam.read_image(folder + "/image.png")
liaam.fit(model, image, np.loadtxt(folder + "/box.txt"))
print(time.process_time())
"""
"""A program that fits one image and prints its processor time, imports included."""


def measure_start() -> None:
    """Processor time of a process that fits one image: nothing is compiled at the first."""
    image, shape = make_pictures()[1][0]
    with TemporaryDirectory() as folder:
        make_model().save(f"{folder}/model.liaam")
        write_image(f"{folder}/image.png", image)
        np.savetxt(f"{folder}/box.txt", box_of(shape))
        command = [sys.executable, "-c", FIRST_FIT, folder]
        environment = os.environ | {"OPENBLAS_NUM_THREADS": "1"}
        ran = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
        report("process_s", float(ran.stdout), "(bar: at most 0.8)", form=".2f", width=24)


def main() -> None:
    begin = process_time()
    cv2.setNumThreads(1)
    with threadpool_limits(1):
        model = make_model()
        print(
            f"whole fits from a box: {SIZE[0]}x{SIZE[1]} pixels, model of {model.n_pixels} pixels, "
            f"{len(model.shape_model.basis)} shape parameters, 1 thread"
        )
        measure_fits()
        measure_start()
        measure_growth()
        measure_modes()
        measure_large_picture()
    print(f"  ({process_time() - begin:.0f} s of processor time)")


if __name__ == "__main__":
    main()
