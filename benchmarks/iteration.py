"""Time of one iteration of ``li`` and of ``soft-li`` relative to the BLAS products of the dense form.

One iteration has 10,000 model pixels, 24 shape parameters (20 modes and 4 similarity vectors), 20 appearance modes and
one thread. It is the work of a level's compiled loop from one accepted state to the next: the difference of
:meth:`liaam.fitting.loop.objective.Objective.solve` over eleven iterations and over one. The reference is J'J with J
10,000 x 24 and A'J with A 10,000 x 20 in float32, by ``numpy.matmul``.

All parts are timed in turn, many times, so that other load on the machine affects all equally.
"""

from bisect import bisect_left
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks.metrics import in_turn, quartiles, report
from liaam.fitting import METHODS, SolverOptions, get_method
from liaam.fitting.loop.encoded_image import EncodedImage
from liaam.fitting.loop.objective import Objective, make_objectives
from liaam.model import AAM, MESH, VIEWS, Level, View
from liaam.model.appearance import AppearanceModel
from liaam.model.mesh import ReferenceFrame, delaunay, signed_areas
from liaam.model.shape import ShapeModel, Similarity, similarity_modes
from liaam.photometry import CameraModel

N_PIXELS, N_SHAPE_MODES, N_APPEARANCE_MODES = 10_000, 20, 20
N_SIDE = 8  # landmarks along each side of the grid
IMAGE_SIZE = (480, 640)  # rows, columns
BARS = {"li": 1.3, "soft-li": 2.5 * 1.3}  # times the reference
ROUNDS, WARM_UP = 300, 20
STEPS = 10  # additional iterations of the longer loop
# Initial damping. With it, li's steps are short and never rejected, although each step divides it by ten. soft-li
# accepts its steps, and all but short ones check whether to update the weights.
DAMPING = {"li": 1e3, "soft-li": 1e-3}

Parts = dict[str, Callable[[], object]]


def smooth_noise(rng: np.random.Generator, height: int, width: int, sigma: float, n: int) -> np.ndarray:
    """Smooth random images of unit variance, (n, height, width)."""
    from scipy.ndimage import gaussian_filter

    noise = gaussian_filter(rng.normal(size=(n, height, width)), (0, sigma, sigma))
    return noise / noise.std(axis=(1, 2), keepdims=True)


def make_shapes(rng: np.random.Generator, method: str) -> tuple[ShapeModel, ReferenceFrame]:
    """Make a shape model of a jittered grid of landmarks, and its frame with exactly N_PIXELS pixels.

    The frame of ``soft-li`` also covers the surroundings of the mesh.
    """
    grid = np.stack(np.meshgrid(*[np.arange(N_SIDE, dtype=float)] * 2), axis=-1).reshape(-1, 2)
    points = grid + rng.normal(scale=0.12, size=grid.shape)
    points -= points.mean(axis=0)
    triangles = delaunay(points)
    own = make_shape_model(points, rng)
    about = np.sqrt(N_PIXELS / signed_areas(points, triangles).sum()) * (0.93 if method == "soft-li" else 1.0)

    def at(scale: float) -> tuple[ShapeModel, ReferenceFrame]:
        shape_model = ShapeModel(points * scale, own.modes, own.eigenvalues)
        return shape_model, VIEWS[METHODS[method].view](shape_model, triangles).frame

    scales = about * np.linspace(0.95, 1.05, 4001)
    near = bisect_left(scales, N_PIXELS, key=lambda scale: at(scale)[1].n_pixels)
    # The number of pixels is not monotonic in the size, because of the border.
    for i in sorted(range(len(scales)), key=lambda i: abs(i - near)):
        shape_model, frame = at(scales[i])
        if frame.n_pixels == N_PIXELS:
            return shape_model, frame
    raise RuntimeError(f"no size gives {N_PIXELS} pixels")


def make_shape_model(mean: np.ndarray, rng: np.random.Generator) -> ShapeModel:
    """Random orthonormal modes, orthogonal to the similarities."""
    rigid = similarity_modes(mean)
    columns = np.concatenate([rigid, rng.normal(size=(N_SHAPE_MODES, mean.size))]).T
    modes = np.linalg.qr(columns)[0].T[4:]
    return ShapeModel(mean, np.ascontiguousarray(modes), np.geomspace(100.0, 1.0, N_SHAPE_MODES))


def make_appearance(
    frame: ReferenceFrame, rng: np.random.Generator, level: float = -1.5, n_modes: int = N_APPEARANCE_MODES
) -> AppearanceModel:
    """Make a mean around a level, and orthonormal modes that vary smoothly over the frame."""
    width, height = frame.size
    rows, columns = frame.pixels.T
    pictures = smooth_noise(rng, height, width, 4.0, 3 * (n_modes + 1))
    textures = pictures[:, rows, columns].reshape(-1, 3, frame.n_pixels).transpose(0, 2, 1)
    flat = textures[1:].reshape(n_modes, -1)
    modes = np.linalg.qr(flat.T)[0].T.reshape(textures[1:].shape)
    return AppearanceModel(
        mean=(0.3 * textures[0] + level).astype(np.float32),
        modes=np.ascontiguousarray(modes, dtype=np.float32),
        eigenvalues=np.geomspace(300.0, 3.0, n_modes),
        usable=np.ones(frame.n_pixels, np.float32),
    )


def make_model(rng: np.random.Generator, method: str = "li", n_modes: int = N_APPEARANCE_MODES) -> AAM:
    """Make a random model with one level of exactly the sizes above."""
    shape_model, frame = make_shapes(rng, method)
    # Only one is fitted here. Little blur, so that every pixel counts.
    own = make_appearance(frame, rng, 0.0 if method == "soft-li" else -1.5, n_modes)
    triangles, view = delaunay(shape_model.mean), METHODS[method].view
    mesh = View(VIEWS[MESH](shape_model, triangles), ())
    plain = own if view == MESH else make_appearance(mesh.warp.frame, rng, n_modes=3)
    views = {MESH: replace(mesh, levels=(Level(0.5, dict.fromkeys(("value", "log", "invariant"), plain)),))}
    if view != MESH:
        views[view] = View(VIEWS[view](shape_model, triangles), (Level(0.5, {METHODS[method].appearance: own}),))
    return AAM(views, triangles, CameraModel(), n_images=25)


def make_image(model: AAM, rng: np.random.Generator, method: str = "li") -> EncodedImage:
    """Make a smooth random colour image with the model at its centre, 1.6 image pixels per model pixel."""
    height, width = IMAGE_SIZE
    picture = 0.45 + 0.09 * smooth_noise(rng, height, width, 3.0, 3).transpose(1, 2, 0)
    image = np.rint(255 * picture.clip(0.1, 0.9)).astype(np.uint8)
    pose = Similarity(1.6 * np.eye(2), np.array([width / 2 + 0.3, height / 2 - 0.2]))
    return EncodedImage.at(image, pose(model.shape_model.mean), pose, get_method(method), "srgb", 0.5)


def make_loops(objective: Objective, image: EncodedImage) -> Parts:
    """Make the loop over one iteration and over :data:`STEPS` more. Their difference excludes the overhead."""
    start = objective.start(np.zeros(objective.warp.n_parameters))
    damping = DAMPING.get(objective.method.name, DAMPING["li"])

    def loop(n: int) -> Callable[[], int]:
        options = SolverOptions(
            max_iterations=n, tolerance=0.0, early_tolerance=0.0, relative_tolerance=0.0, damping=damping, scoring=0
        )

        def call() -> int:
            return len(objective.solve(image, start, options, evaluate_last=False).costs) - 1  # accepted steps

        assert call() == n, "a step was refused: the loop's time is not that of its iterations"
        return call

    return {"one": loop(1), "more": loop(1 + STEPS)}


def make_parts(objective: Objective, image: EncodedImage) -> Parts:
    """Make the parts of an iteration, each separately and from a fixed state."""
    problem, start = objective.problem(image), objective.start(np.zeros(objective.warp.n_parameters))
    state = start.p, tuple(start.angles), start.lam
    problem.begin(*state)
    problem.evaluate(True)
    problem.reweigh(True)
    expects = objective.method.step == "expected"
    parts: Parts = {
        "evaluate": lambda: problem.evaluate(True),
        "differentiate": lambda: problem.differentiate(True, not expects),
    }

    def weigh() -> bool:
        problem.begin(*state)  # force a full evaluation
        problem.evaluate(True)
        return problem.reweigh(True)

    return parts | {"evaluate_and_weigh": weigh} if objective.method.reweighs else parts


def make_yardstick(rng: np.random.Generator, n_columns: int) -> Callable[[], object]:
    """Make the products J'J and A'J."""
    J = rng.normal(size=(N_PIXELS, n_columns)).astype(np.float32)
    A = rng.normal(size=(N_PIXELS, N_APPEARANCE_MODES)).astype(np.float32)
    return lambda: (np.matmul(J.T, J), np.matmul(A.T, J))


def measure(parts: Parts) -> dict[str, np.ndarray]:
    """Milliseconds of each part, (ROUNDS,) each, timed in turn."""
    times = in_turn({name: [part] for name, part in parts.items()}, ROUNDS, WARM_UP)
    return {name: own[:, 0] for name, own in times.items()}


def make_fit(method: str, n_modes: int = N_APPEARANCE_MODES) -> tuple[Objective, EncodedImage]:
    """Make the objective of a method for a random model, and an image."""
    rng = np.random.default_rng(20080624)
    model = make_model(rng, method, n_modes)
    image = make_image(model, rng, method)
    (objective,) = make_objectives(model, get_method(method))
    assert len(objective.appearance.mean) == N_PIXELS, "every pixel has to count"
    return objective, image


def measure_method(method: str) -> tuple[str, dict[str, np.ndarray]]:
    """Return a description and the times."""
    objective, image = make_fit(method)
    rng = np.random.default_rng(1)
    loops, parts = make_loops(objective, image), make_parts(objective, image)
    times = measure({"yardstick": make_yardstick(rng, objective.warp.n_parameters), **loops, **parts})
    times["iteration"] = (times.pop("more") - times.pop("one")) / STEPS
    told = (
        f"{method} iteration: {N_PIXELS} pixels, {objective.warp.n_parameters} shape parameters, "
        f"{objective.n_lambda} appearance modes, {objective.method.n_rows} rows, 1 BLAS thread, {ROUNDS} rounds"
    )
    return told, times


def main() -> None:
    for method, bar in BARS.items():
        with threadpool_limits(1):
            told, times = measure_method(method)
        print(told)
        prefix = "" if method == "li" else "soft_"
        for name, values in times.items():
            report(f"{prefix}{name}_ms", float(np.median(values)), f"({quartiles(values, '.3f')})", width=24)
        ratio = np.median(times["iteration"]) / np.median(times["yardstick"])
        report(f"{prefix}iteration_ratio", ratio, f"(bar: at most {bar:g})", form=".2f", width=24)


if __name__ == "__main__":
    main()
