"""Time of one ``li`` iteration beside the BLAS products that it cannot do without.

One iteration at 10,000 model pixels, 24 shape parameters (20 modes and 4 similarity vectors), 20 appearance
modes and one BLAS thread: what the loop of :func:`liaam.fitting.solver.solve` does between two accepted
states (step, linearisation there, lambda, merit, observable directions). The yardstick is J'J with J
10,000 x 24 and A'J with A 10,000 x 20 in float32, by ``numpy.matmul``.

All parts are timed in turn, many times over, so that a busy spell of the machine touches all alike.
"""

from collections.abc import Callable
from dataclasses import replace
from time import perf_counter

import numpy as np
from threadpoolctl import threadpool_limits

from liaam.appearance import AppearanceModel
from liaam.fitting import SolverOptions, get_method, solver
from liaam.fitting.objective import FitProblem, Objective, State, make_objectives
from liaam.kernels import get_kernel
from liaam.mesh import ReferenceFrame, delaunay, signed_areas
from liaam.model import AAM, Level
from liaam.photometry import CameraModel
from liaam.sampling import make_patch
from liaam.shape import ShapeModel, Similarity, similarity_modes

N_PIXELS, N_SHAPE_MODES, N_APPEARANCE_MODES = 10_000, 20, 20
N_SIDE = 8  # landmarks along each side of the grid
IMAGE_SIZE = (480, 640)  # rows, columns
BAR = 2.5  # times the yardstick
ROUNDS, WARM_UP = 300, 20
SOLVE_STEPS = 10
HEAVY = 1e3  # damping under which the loop hardly moves, so that each of its steps costs the same

Parts = dict[str, Callable[[], object]]


def smooth_noise(rng: np.random.Generator, height: int, width: int, sigma: float, n: int) -> np.ndarray:
    """Smooth random pictures of unit variance, (n, height, width)."""
    from scipy.ndimage import gaussian_filter

    noise = gaussian_filter(rng.normal(size=(n, height, width)), (0, sigma, sigma))
    return noise / noise.std(axis=(1, 2), keepdims=True)


def make_frame(rng: np.random.Generator) -> ReferenceFrame:
    """Mesh over a jittered grid of landmarks, at the size that gives exactly N_PIXELS pixels."""
    grid = np.stack(np.meshgrid(*[np.arange(N_SIDE, dtype=float)] * 2), axis=-1).reshape(-1, 2)
    points = grid + rng.normal(scale=0.12, size=grid.shape)
    points -= points.mean(axis=0)
    triangles = delaunay(points)
    about = np.sqrt(N_PIXELS / signed_areas(points, triangles).sum())
    for scale in about * np.linspace(0.99, 1.01, 2001):
        frame = ReferenceFrame(points * scale, triangles)
        if frame.n_pixels == N_PIXELS:
            return frame
    raise RuntimeError(f"no size gives {N_PIXELS} pixels")


def make_shape_model(mean: np.ndarray, rng: np.random.Generator) -> ShapeModel:
    """Random orthonormal modes, orthogonal to the similarities."""
    rigid = similarity_modes(mean)
    columns = np.concatenate([rigid, rng.normal(size=(N_SHAPE_MODES, mean.size))]).T
    modes = np.linalg.qr(columns)[0].T[4:]
    return ShapeModel(mean, np.ascontiguousarray(modes), np.geomspace(100.0, 1.0, N_SHAPE_MODES))


def make_appearance(frame: ReferenceFrame, rng: np.random.Generator) -> AppearanceModel:
    """Mean and orthonormal modes that vary smoothly over the frame."""
    width, height = frame.size
    rows, columns = frame.pixels.T
    pictures = smooth_noise(rng, height, width, 4.0, 3 * (N_APPEARANCE_MODES + 1))
    textures = pictures[:, rows, columns].reshape(-1, 3, frame.n_pixels).transpose(0, 2, 1)
    flat = textures[1:].reshape(N_APPEARANCE_MODES, -1)
    modes = np.linalg.qr(flat.T)[0].T.reshape(textures[1:].shape)
    return AppearanceModel(
        mean=(0.3 * textures[0] - 1.5).astype(np.float32),
        modes=np.ascontiguousarray(modes, dtype=np.float32),
        eigenvalues=np.geomspace(300.0, 3.0, N_APPEARANCE_MODES),
        usable=np.ones(frame.n_pixels, np.float32),
    )


def make_model(rng: np.random.Generator) -> AAM:
    """A one-level model of exactly the sizes above; nothing is learnt."""
    frame = make_frame(rng)
    appearance = make_appearance(frame, rng)
    # Only "log" is fitted here; "invariant" says that the model is one of colour.
    level = Level(0.5, dict.fromkeys(("value", "log", "invariant"), appearance))
    shape_model = make_shape_model(frame.points, rng)
    return AAM(shape_model, frame.triangles, (level,), CameraModel(), n_images=25)


def make_problem(model: AAM, rng: np.random.Generator) -> FitProblem:
    """A smooth random colour picture with the model at its middle, 1.6 image pixels per model pixel."""
    height, width = IMAGE_SIZE
    picture = 0.45 + 0.09 * smooth_noise(rng, height, width, 3.0, 3).transpose(1, 2, 0)
    image = np.rint(255 * picture.clip(0.1, 0.9)).astype(np.uint8)
    pose = Similarity(1.6 * np.eye(2), np.array([width / 2 + 0.3, height / 2 - 0.2]))
    start = pose(model.shape_model.mean)
    patch = make_patch(image, start, pose, encoding="log", response="srgb", blur=model.levels[0].blur, margin=0.6)
    offset = patch.from_image(pose.offset[None])[0]
    return FitProblem(patch, Similarity(patch.from_image.matrix @ pose.matrix, offset))


def make_iteration(objective: Objective, problem: FitProblem) -> tuple[Parts, State]:
    """One iteration from a fixed state, whole and in parts, as functions to be timed."""
    options = SolverOptions(tolerance=0.0)
    workspace = objective.workspace()
    start = objective.start(np.zeros(objective.warp.n_parameters))
    state, last = solver._evaluate(objective, problem, start, options, workspace, None, start_up=True)
    precision = solver._prior_precision(objective, last.equations, options.shape_prior)
    free, _ = solver._free_directions(objective, state, last.equations, options.observable)
    kernel, n_p = get_kernel(objective.kernel), objective.warp.n_parameters
    root = objective.root_weights * last.weights[:, None]
    design, lam = objective.design(float(state.angles[0])), state.lam.astype(np.float32)
    metric = objective.method.image_metric(state.angles[1])
    points = objective.warp.points(state.p, problem.pose)
    projected = last.residual + design.mean
    # The kernel is timed on columns of its own, so that those of the products stay valid.
    scratch = objective.workspace()

    def whole() -> None:
        prior = solver._prior_precision(objective, last.equations, options.shape_prior)
        steps = solver._step(last.equations, state, prior, free, options.damping)
        assert steps is not None
        step, lambda_step = steps
        objective.warp.movement(step[:n_p])
        moved = objective.update(state, step, lambda_step)
        new, there = solver._evaluate(objective, problem, moved, options, workspace, None, start_up=False)
        solver._merit(there.equations, new, prior)
        solver._merit(last.equations, state, prior)
        solver._free_directions(objective, new, there.equations, options.observable)

    def carry_points() -> None:
        objective.warp.points(state.p, problem.pose)

    def sample() -> None:
        jacobian = objective.warp.jacobian(state.p)
        channels, turn = problem.patch.channels, problem.pose.matrix
        kernel.linearise(channels, points, jacobian, turn, metric, objective.root_weights, scratch)

    def angle_and_residual() -> None:
        residual = projected - design.mean
        residual -= (design.modes @ lam).reshape(residual.shape)
        scratch[:, n_p : objective.n_q] = objective.angle_columns(state, last.values, lam, root)
        scratch[:, objective.n_q] = (root * residual).ravel()

    def products() -> None:
        objective._equations(workspace, design, last.weights, objective.root_weights, None)

    def solves() -> None:
        fresh = replace(last.equations)  # without what it has worked out already
        solved = fresh.after_lambda_step(fresh.best_lambda_step())
        solver._step(solved, state, precision, free, options.damping)
        solver._free_directions(objective, state, solved, options.observable)

    parts: Parts = {
        "iteration": whole,
        "points": carry_points,
        "kernel": sample,
        "angle_and_residual": angle_and_residual,
        "products": products,
        "solve": solves,
    }
    return parts, state


def make_yardstick(rng: np.random.Generator, n_columns: int) -> Callable[[], object]:
    """J'J and A'J alone."""
    J = rng.normal(size=(N_PIXELS, n_columns)).astype(np.float32)
    A = rng.normal(size=(N_PIXELS, N_APPEARANCE_MODES)).astype(np.float32)
    return lambda: (np.matmul(J.T, J), np.matmul(A.T, J))


def measure(parts: Parts) -> dict[str, np.ndarray]:
    """Milliseconds of each part, (ROUNDS,) each, timed in turn."""
    times = {name: np.empty(ROUNDS) for name in parts}
    for i in range(-WARM_UP, ROUNDS):
        for name, part in parts.items():
            begin = perf_counter()
            part()
            if i >= 0:
                times[name][i] = 1e3 * (perf_counter() - begin)
    return times


def make_loops(objective: Objective, problem: FitProblem, state: State) -> Parts:
    """The solver itself over one iteration and over SOLVE_STEPS more; the difference is theirs alone."""

    def loop(n: int) -> Callable[[], object]:
        options = SolverOptions(max_iterations=n, tolerance=0.0, damping=HEAVY)
        solution = solver.solve(objective, problem, state, options)
        assert len(solution.path) == n + 1, "a step was refused: the loop's time is not that of its iterations"
        return lambda: solver.solve(objective, problem, state, options)

    return {"one": loop(1), "more": loop(1 + SOLVE_STEPS)}


def main() -> None:
    rng = np.random.default_rng(20080624)
    with threadpool_limits(1):
        model = make_model(rng)
        problem = make_problem(model, rng)
        (objective,) = make_objectives(model, get_method("li"))
        parts, state = make_iteration(objective, problem)
        loops = make_loops(objective, problem, state)
        times = measure({"yardstick": make_yardstick(rng, objective.warp.n_parameters), **parts, **loops})
    times["solve_loop"] = (times.pop("more") - times.pop("one")) / SOLVE_STEPS
    print(
        f"li iteration: {model.n_pixels} pixels, {objective.warp.n_parameters} shape parameters, "
        f"{objective.n_lambda} appearance modes, 1 BLAS thread, {ROUNDS} rounds"
    )
    for name, values in times.items():
        low, median, high = np.percentile(values, [25, 50, 75])
        print(f"  {name + '_ms':<24}{median:8.3f}   (quartiles {low:.3f} to {high:.3f})")
    for name in ("iteration", "solve_loop"):
        ratio = np.median(times[name]) / np.median(times["yardstick"])
        print(f"  {name + '_ratio':<24}{ratio:8.2f}   (bar: at most {BAR})")


if __name__ == "__main__":
    main()
