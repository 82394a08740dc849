"""Fitting many pictures at once: prepare each, solve together, judge each as :class:`liaam.fitting.Fitter` does."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from liaam.errors import MethodError, StartError
from liaam.fitting.batched.objective import BatchObjective, unsupported
from liaam.fitting.batched.solver import BatchSolver
from liaam.fitting.fitter import Fitter
from liaam.fitting.levels import Stage, Target, is_sane, prepare_level, spare
from liaam.fitting.methods import DEFAULT_METHOD, Method
from liaam.fitting.result import FitResult, FitStatus
from liaam.fitting.solver import SolverOptions
from liaam.kernels.backends import get_backend
from liaam.model import AAM
from liaam.photometry import CameraModel

BATCH_SIZE = 64
"""Pictures solved together, unless told otherwise."""


@dataclass(frozen=True, eq=False)
class BatchResult:
    """Results of fitting many pictures, in their order.

    Attributes
    ----------
    shapes : (b, n, 2) float64
        Landmarks (x, y), image pixels.
    statuses : tuple of FitStatus
        How each fit ended; failure of one is a value, and leaves the others alone.
    costs : (b,) float64
        Mean squared residual in the method's own units.
    n_iterations : (b,) int64
        Steps tried.
    thetas : (b,) float64
        Angle of each image's camera, radians; NaN for methods without angles.
    p : (b, m + 4) float64
        Shape parameters in the model's pixels, of the sharpest level.
    landmark_covariances : (b, n, 2, 2) float64
        Of each landmark, image pixels squared.
    quality : (b,) float64
        Probability that the fit is right, where the method and the model know it, else NaN.
    method : str
    backend : str
    """

    shapes: np.ndarray
    statuses: tuple[FitStatus, ...]
    costs: np.ndarray
    n_iterations: np.ndarray
    thetas: np.ndarray
    p: np.ndarray
    landmark_covariances: np.ndarray
    quality: np.ndarray
    method: str
    backend: str

    def __len__(self) -> int:
        """Number of pictures."""
        return len(self.shapes)

    def __repr__(self) -> str:
        return f"BatchResult({self.method} on {self.backend}: {len(self)} pictures, {int(self.ok.sum())} ok)"

    @property
    def ok(self) -> np.ndarray:
        """Whose landmarks may be used, (b,) bool."""
        return np.array([status.ok for status in self.statuses], bool)

    @property
    def messages(self) -> tuple[str, ...]:
        """What happened to each, and what to do about it."""
        return tuple(status.message for status in self.statuses)


def fit_many(
    model: AAM,
    images: Sequence,
    starts: Sequence,
    method: str | Method = DEFAULT_METHOD,
    *,
    backend: str = "numpy",
    device: str | None = None,
    batch_size: int = BATCH_SIZE,
    camera: CameraModel | None = None,
    **options,
) -> BatchResult:
    """Fit a model to many images at once.

    Each picture comes to what a :class:`liaam.fitting.Fitter` without restarts gives for it, up to rounding; the
    pictures of a batch share the library's calls. Patches are cut and encoded on the CPU, the rest is done by the
    library on its device.

    Parameters
    ----------
    model : AAM
    images : sequence of (h, w, 3) uint8, uint16 or float arrays, or paths
        Of any sizes; the same picture may come several times, with several starts.
    starts : sequence of (n, 2) shapes, (x0, y0, x1, y1) boxes, (x, y, diagonal), or Candidates
        Where to start, image pixels, one for each image (see :func:`liaam.find` where you have none).
    method : str or Method
        Methods without robust losses, ``+noise`` or normalisation.
    backend : {"numpy", "torch", "jax"}
    device : str, optional
        As the library calls it; a GPU where it finds one if left out, else the CPU.
    batch_size : int
        Pictures solved together; bound by the memory of the device.
    camera : CameraModel, optional
        Of the images; the training camera if left out.
    **options
        Fields of :class:`liaam.fitting.SolverOptions`, such as ``max_iterations``.

    Returns
    -------
    BatchResult

    Raises
    ------
    MethodError
        If the method, the library or the device cannot do it.
    ImageError, StartError
        For input that makes no sense; the message says which picture.

    Examples
    --------
    >>> result = fit_many(model, crops, boxes, backend="torch", batch_size=512)    # doctest: +SKIP
    >>> result.shapes[result.ok]                                                   # doctest: +SKIP
    """
    fitter = BatchFitter(Fitter(model, method, SolverOptions.of(**options), camera=camera), backend, device)
    return fitter.fit(images, starts, batch_size)


@dataclass(frozen=True, eq=False)
class BatchFitter:
    """A fitter and an array library, ready for many batches: what is worked out or compiled once is kept.

    Attributes
    ----------
    fitter : Fitter
        Gives objectives, camera and options, and judges what comes out.
    backend : {"numpy", "torch", "jax"}
    device : str, optional
    """

    fitter: Fitter
    backend: str = "numpy"
    device: str | None = None

    def __post_init__(self) -> None:
        self.solvers  # noqa: B018 (complain now, not at the first batch)

    @cached_property
    def solvers(self) -> tuple[BatchSolver, ...]:
        """One solver for each level of the model, coarse to fine."""
        options, method = self.fitter.options, self.fitter.objectives[0].method
        refused = unsupported(method)
        if refused is not None:
            raise MethodError(
                f"method {method.name}: batched fits cannot do {refused}; fit one by one with Fitter, or use another "
                "method"
            )
        library, sparing = get_backend(self.backend, self.device), spare(options)
        solvers = []
        for objective in self.fitter.objectives:
            own = options if objective is self.fitter.objectives[-1] else sparing
            seen = BatchObjective(objective, library, scores=method.soft or own.scoring > 0)
            solvers.append(BatchSolver(seen, own))
        return tuple(solvers)

    def fit(self, images: Sequence, starts: Sequence, batch_size: int = BATCH_SIZE) -> BatchResult:
        """Fit many images (see :func:`fit_many`)."""
        if batch_size < 1:
            raise MethodError(f"a batch_size of {batch_size} holds no picture; give at least 1")
        if len(images) != len(starts):
            raise StartError(f"there are {len(images)} images but {len(starts)} starts; give one start for each image")
        results: list[FitResult] = []
        for first in range(0, len(images), batch_size):
            chosen = range(first, min(first + batch_size, len(images)))
            targets = [self._target(images[i], starts[i], f"image {i}") for i in chosen]
            results += [
                self.fitter.judged(target.image, stages)
                for target, stages in zip(targets, self._solve_levels(targets), strict=True)
            ]
        return self._gather(results)

    def _target(self, image, start, name: str) -> Target:
        """Picture and start, checked; its noise is measured once for all levels."""
        target, _ = self.fitter.target(image, start, name)
        return target.measured(self.fitter.objectives[0].method)

    def _solve_levels(self, targets: Sequence[Target]) -> list[list[Stage]]:
        """Solve a batch from the coarsest level to the finest; what is lost on the way goes no further."""
        stages: list[list[Stage]] = [[] for _ in targets]
        for level, solver in zip(self.fitter._levels, self.solvers, strict=True):
            going = [i for i, own in enumerate(stages) if not own or is_sane(own[-1].reached, targets[i].start)]
            if not going:
                break
            objective = solver.objective.objective
            prepared = [prepare_level(objective, level.blur, targets[i], stages[i], solver.options) for i in going]
            problems, states, poses = zip(*prepared, strict=True)
            solutions = solver.solve(problems, states)
            for i, problem, pose, solution in zip(going, problems, poses, solutions, strict=True):
                stages[i].append(Stage(objective, problem, pose, solution))
        return stages

    def _gather(self, results: list[FitResult]) -> BatchResult:
        model = self.fitter.model

        def stacked(name: str, *shape: int) -> np.ndarray:
            return np.array([getattr(result, name) for result in results], float).reshape(len(results), *shape)

        return BatchResult(
            shapes=stacked("shape", model.n_points, 2),
            statuses=tuple(result.status for result in results),
            costs=stacked("cost"),
            n_iterations=stacked("n_iterations").astype(np.int64),
            thetas=stacked("theta"),
            p=stacked("p", len(self.fitter.shapes.basis)),
            landmark_covariances=stacked("landmark_covariances", model.n_points, 2, 2),
            quality=stacked("quality"),
            method=self.fitter.objectives[0].method.name,
            backend=self.backend,
        )
