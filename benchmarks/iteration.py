"""Time of one iteration of ``li`` and of ``soft-li`` beside the BLAS products of the dense form.

One iteration at 10,000 model pixels, 24 shape parameters (20 modes and 4 similarity vectors), 20 appearance
modes and one BLAS thread: what the loop of :func:`liaam.fitting.solver.solve` does between two accepted
states (step, linearisation there, lambda, merit, observable directions). The yardstick is J'J with J
10,000 x 24 and A'J with A 10,000 x 20 in float32, by ``numpy.matmul``.

All parts are timed in turn, many times over, so that a busy spell of the machine touches all alike.
"""

from bisect import bisect_left
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks.metrics import in_turn, quartiles, report
from liaam.appearance import AppearanceModel
from liaam.fitting import SolverOptions, get_method, solver
from liaam.fitting.objective import Objective, State, make_objectives
from liaam.fitting.problem import FitProblem
from liaam.kernels import get_kernel
from liaam.mesh import ReferenceFrame, delaunay, signed_areas
from liaam.model import AAM, Level
from liaam.photometry import CameraModel
from liaam.shape import ShapeModel, Similarity, similarity_modes
from liaam.warp import surrounded_warp

N_PIXELS, N_SHAPE_MODES, N_APPEARANCE_MODES = 10_000, 20, 20
N_SIDE = 8  # landmarks along each side of the grid
IMAGE_SIZE = (480, 640)  # rows, columns
BARS = {"li": 1.3, "soft-li": 2.5 * 1.3}  # times the yardstick
ROUNDS, WARM_UP = 300, 20
SOLVE_STEPS = 10
# Damping to begin with: under it li's steps are short and never refused, though each divides it by ten; those of
# soft-li are taken as they come, and all but short ones ask whether pixels are to be weighed anew.
DAMPING = {"li": 1e3, "soft-li": 1e-3}

Parts = dict[str, Callable[[], object]]


def smooth_noise(rng: np.random.Generator, height: int, width: int, sigma: float, n: int) -> np.ndarray:
    """Smooth random pictures of unit variance, (n, height, width)."""
    from scipy.ndimage import gaussian_filter

    noise = gaussian_filter(rng.normal(size=(n, height, width)), (0, sigma, sigma))
    return noise / noise.std(axis=(1, 2), keepdims=True)


def make_shapes(rng: np.random.Generator, method: str) -> tuple[ShapeModel, ReferenceFrame]:
    """Shape model of a jittered grid of landmarks, and its frame, at the size that gives exactly N_PIXELS pixels.

    The frame of ``soft-li`` goes around the mesh.
    """
    grid = np.stack(np.meshgrid(*[np.arange(N_SIDE, dtype=float)] * 2), axis=-1).reshape(-1, 2)
    points = grid + rng.normal(scale=0.12, size=grid.shape)
    points -= points.mean(axis=0)
    triangles = delaunay(points)
    own = make_shape_model(points, rng)
    about = np.sqrt(N_PIXELS / signed_areas(points, triangles).sum()) * (0.93 if method == "soft-li" else 1.0)

    def at(scale: float) -> tuple[ShapeModel, ReferenceFrame]:
        shape_model = ShapeModel(points * scale, own.modes, own.eigenvalues)
        surrounded = surrounded_warp(shape_model, triangles).frame if method == "soft-li" else None
        return shape_model, ReferenceFrame(points * scale, triangles) if surrounded is None else surrounded

    scales = about * np.linspace(0.95, 1.05, 4001)
    near = bisect_left(scales, N_PIXELS, key=lambda scale: at(scale)[1].n_pixels)
    # Pixels come and go at the border: the first size that has too many is not always next to one that has enough.
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
    """Mean about a level and orthonormal modes that vary smoothly over the frame."""
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
    """A one-level model of exactly the sizes above; nothing is learnt."""
    shape_model, frame = make_shapes(rng, method)
    # Only one is fitted here; "invariant" says that the model is one of colour. Little blur: every pixel counts.
    own = make_appearance(frame, rng, 0.0 if method == "soft-li" else -1.5, n_modes)
    if method == "soft-li":
        plain = make_appearance(ReferenceFrame(shape_model.mean, delaunay(shape_model.mean)), rng, n_modes=3)
        level = Level(0.5, dict.fromkeys(("value", "log", "invariant"), plain))
        soft = (Level(0.5, {"soft": own}),)
    else:
        level, soft = Level(0.5, dict.fromkeys(("value", "log", "invariant"), own)), ()
    triangles = delaunay(shape_model.mean)
    return AAM(shape_model, triangles, (level,), CameraModel(), n_images=25, soft_levels=soft)


def make_problem(model: AAM, rng: np.random.Generator, method: str = "li") -> FitProblem:
    """A smooth random colour picture with the model at its middle, 1.6 image pixels per model pixel."""
    height, width = IMAGE_SIZE
    picture = 0.45 + 0.09 * smooth_noise(rng, height, width, 3.0, 3).transpose(1, 2, 0)
    image = np.rint(255 * picture.clip(0.1, 0.9)).astype(np.uint8)
    pose = Similarity(1.6 * np.eye(2), np.array([width / 2 + 0.3, height / 2 - 0.2]))
    return FitProblem.at(image, pose(model.shape_model.mean), pose, get_method(method), "srgb", 0.5)


def make_iteration(objective: Objective, problem: FitProblem) -> tuple[Parts, State]:
    """One iteration from a fixed state, whole and in parts, as functions to be timed."""
    options = SolverOptions(tolerance=0.0)
    run = solver._begin(objective, problem, objective.start(np.zeros(objective.warp.n_parameters)), options)
    state, last, trust = run.state, run.last, run.trust
    kernel = get_kernel(objective.kernel)
    propose = solver._expected_step if objective.method.soft else solver._own_step
    tried = propose(objective, run, options)
    assert tried is not None
    run = run._replace(**tried.expected)  # as between two steps under the same weights: the expected curvature is known
    design, metric = objective.design(float(state.angles[0])), objective.method.image_metric(state.angles[1])
    places, mesh = objective.warp.places(state.p, problem.pose), objective.warp.mesh_pixels()
    assert mesh is not None
    root = objective._root_weights(state.angles[1], trust)[0] * last.weights[:, None]

    known = [linearisation for linearisation in (last, last.last and last.last.before) if linearisation]
    if objective.n_q > objective.warp.n_parameters:
        known = []  # what of the angles can be observed is asked where a step ends: those equations are the ones timed

    def whole() -> None:
        for linearisation in known:  # it has not worked out anything yet
            for name in ("equations", "look"):
                linearisation.__dict__.pop(name, None)
        solver._iterate(objective, problem, run, options, 1, propose, weighs=False)

    def carry_points() -> None:
        objective.warp.places(state.p, problem.pose)

    def sample() -> None:
        kernel.steepest(problem.patch.channels, places, problem.pose.matrix, metric)

    def look() -> None:
        objective.look(problem, state, trust)

    def sparse_products() -> None:
        steep = last.look.steep
        kernel.mesh_products(steep, root, design.packed, last.look.columns, mesh)

    def products() -> None:
        objective.weighed(last.look, state, trust).equations  # noqa: B018

    own = None if objective.method.soft else last.equations  # a step with the expected gradient asks for none

    def solves() -> None:
        known = replace(last)
        if own is not None:
            known.__dict__["equations"] = replace(own)
        propose(objective, run._replace(last=known), options)

    def weigh() -> None:
        solver._weigh_anew(objective, problem, state, last, options, None)

    parts: Parts = {
        "iteration": whole,
        "points": carry_points,
        "sample": sample,
        "look": look,
        "sparse_products": sparse_products,
        "products": products,
        "solve": solves,
    }
    return (parts | {"weigh": weigh} if objective.method.reweighs else parts), state


def make_yardstick(rng: np.random.Generator, n_columns: int) -> Callable[[], object]:
    """J'J and A'J alone."""
    J = rng.normal(size=(N_PIXELS, n_columns)).astype(np.float32)
    A = rng.normal(size=(N_PIXELS, N_APPEARANCE_MODES)).astype(np.float32)
    return lambda: (np.matmul(J.T, J), np.matmul(A.T, J))


def measure(parts: Parts) -> dict[str, np.ndarray]:
    """Milliseconds of each part, (ROUNDS,) each, timed in turn."""
    times = in_turn({name: [part] for name, part in parts.items()}, ROUNDS, WARM_UP)
    return {name: own[:, 0] for name, own in times.items()}


def make_loops(objective: Objective, problem: FitProblem, state: State) -> Parts:
    """The solver itself over one iteration and over SOLVE_STEPS more; the difference is theirs alone."""

    def loop(n: int) -> Callable[[], object]:
        options = SolverOptions(max_iterations=n, tolerance=0.0, notice=0.0, damping=DAMPING[objective.method.name])
        solution = solver.solve(objective, problem, state, options)
        assert len(solution.path) == n + 1, "a step was refused: the loop's time is not that of its iterations"
        return lambda: solver.solve(objective, problem, state, options)

    return {"one": loop(1), "more": loop(1 + SOLVE_STEPS)}


def make_fit(method: str, n_modes: int = N_APPEARANCE_MODES) -> tuple[Objective, FitProblem]:
    """A random model seen through a method, and a picture."""
    rng = np.random.default_rng(20080624)
    model = make_model(rng, method, n_modes)
    problem = make_problem(model, rng, method)
    (objective,) = make_objectives(model, get_method(method))
    assert len(objective.appearance.mean) == N_PIXELS, "every pixel has to count"
    return objective, problem


def measure_method(method: str) -> tuple[str, dict[str, np.ndarray]]:
    """What was timed, and the times."""
    objective, problem = make_fit(method)
    rng = np.random.default_rng(1)
    parts, state = make_iteration(objective, problem)
    loops = make_loops(objective, problem, state)
    times = measure({"yardstick": make_yardstick(rng, objective.warp.n_parameters), **parts, **loops})
    times["solve_loop"] = (times.pop("more") - times.pop("one")) / SOLVE_STEPS
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
        for name in ("iteration", "solve_loop"):
            ratio = np.median(times[name]) / np.median(times["yardstick"])
            report(f"{prefix}{name}_ratio", ratio, f"(bar: at most {bar:g})", form=".2f", width=24)


if __name__ == "__main__":
    main()
