"""Direct light-invariant registration of two pictures by a homography (the paper's reference [10]).

The objective and the solver are those of a fit: the first picture's pixels are the model (an appearance without
modes), a homography is the warp, and any method of :data:`liaam.fitting.METHODS` says what is compared.
"""

from dataclasses import dataclass, replace

import numpy as np

from liaam.errors import ImageError, MethodError
from liaam.evaluation import finite_list
from liaam.fitting import FitStatus, Method, SolverOptions, get_method
from liaam.fitting.fitter import covariance
from liaam.fitting.levels import Stage, Target, is_sane, solve_levels
from liaam.fitting.objective import Objective
from liaam.fitting.picture import load_picture
from liaam.fitting.problem import correlated_pixels, slope_left
from liaam.fitting.solver import scored
from liaam.model.appearance import AppearanceModel
from liaam.model.sampling import make_patch
from liaam.model.shape import Similarity
from liaam.model.warp import GENERATORS, HomographyWarp, apply_homography, picture_corners
from liaam.photometry import LUMINANCE, THETA_DEFAULT, Response, noise_deviation
from liaam.photometry.encoding import refuse_grey, stored_values

METHOD = "igo+tukey"
"""Gradient orientations are blind to the light's strength; what is left of cast shadows, their edges, is for the
robust loss. Measured on posters and real objects: nearer to the truth than ``li``, ``chroma`` and ``grey``."""

LEVELS = ((8.0, 4), (4.0, 2), (2.0, 1), (1.0, 1), (0.5, 1))
"""Blur, and distance between the pixels that count, of each level, coarse to fine, pixels of the reduced picture."""

SHARP = 1.0
"""Blur below which a level is left out unless the picture is clear."""

CLEAR = 10.0
"""Median of the significant gradients, in standard deviations of their noise, above which a picture is clear. Measured:
fine texture makes real objects half as far off as a last blur of 1; where noise is stronger the sharpest level adds a
half to the error of planes."""

MOST_PIXELS = 180_000
"""Pixels that a picture is reduced to at most."""

SIGNIFICANT = 3.0
"""Gradient, in standard deviations of its noise, below which its direction says nothing."""

LARGEST_BLUR = 1 / 12
"""Blur of a level, as a share of the picture's lesser side, beyond which the level is left out."""

LEAST_PIXELS = 200
"""Pixels that a level needs to be of use."""

LEAST_OVERLAP = 0.25
"""Share of the first picture's pixels that must lie inside the second."""

LEAST_CORRELATION = 0.2
"""Correlation of what is compared below which the pictures do not show the same thing. Right registrations have 0.4
and more (cast shadows, twelve directions of light), pictures of different things 0.1 and less."""

OPTIONS = SolverOptions(max_iterations=60, scoring=20)
"""Scoring: samples between pixels are smoother, so that plain minima lie off by up to 0.4 pixels towards the middle
between pixels where the residual is mostly noise or texture of one picture only (measured on real objects)."""

MESSAGES = {
    FitStatus.CONVERGED: "The registration settled.",
    FitStatus.LIGHT_UNOBSERVABLE: "The registration settled; the pictures do not tell the angle, so it was held.",
    FitStatus.MAX_ITERATIONS: "The registration was still moving when its iterations ran out; start nearer to it.",
    FitStatus.DIVERGED: "What was found does not look alike in both pictures: they show different things, or lie too "
    "far apart; bring them nearer to each other, or give pictures that differ less.",
    FitStatus.LEFT_IMAGE: "The pictures hardly overlap; give pictures that share more than a quarter.",
    FitStatus.TOO_DARK: "Too few pixels are well exposed in both pictures; use brighter ones.",
    FitStatus.NO_TEXTURE: "There is nothing to register by: the pictures are flat.",
}
"""What happened, and what to do about it."""


@dataclass(frozen=True, eq=False)
class Registration:
    """Result of a registration.

    Attributes
    ----------
    homography : (3, 3) float64
        From pixels of the first picture to those of the second, its last entry 1.
    status : FitStatus
        How it ended; ``status.ok`` says whether to use it.
    correlation : float
        Of what was compared, between the pictures where they overlap.
    theta : float
        Angle of the second picture's camera, radians; NaN for methods without angles.
    cost : float
        Mean squared residual, in the method's own units.
    n_iterations : int
        Steps tried.
    corner_deviation : (4,) float64
        Standard error of where the first picture's corners come to lie, pixels of the second (root of the sum of both
        axes' variances): by the Gauss-Newton covariance of independent residuals, which knows noise only.
    size : (int, int)
        Height and width of the first picture.
    method : str
    """

    homography: np.ndarray
    status: FitStatus
    correlation: float
    theta: float
    cost: float
    n_iterations: int
    corner_deviation: np.ndarray
    size: tuple[int, int]
    method: str

    @property
    def message(self) -> str:
        """What happened, and what to do about it."""
        return MESSAGES[self.status]

    def to_dict(self) -> dict:
        """Convert the result to a dictionary that JSON can hold; values that are unknown are None."""
        correlation, theta, cost = finite_list(np.array([self.correlation, np.rad2deg(self.theta), self.cost]))
        return {
            "homography": finite_list(self.homography),
            "status": str(self.status),
            "message": self.message,
            "method": self.method,
            "correlation": correlation,
            "theta_deg": theta,
            "cost": cost,
            "iterations": self.n_iterations,
            "corner_standard_error_px": finite_list(self.corner_deviation),
        }

    def warp(self, second: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Bring the second picture into the frame of the first.

        Parameters
        ----------
        second : (h, w, c) uint8, uint16 or float32

        Returns
        -------
        picture : (h', w', c) of the same type
            0 beyond the second picture's border.
        mask : (h', w') bool
            Where it shows anything.
        """
        import cv2  # heavy: imported when first needed

        height, width = self.size
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        picture = cv2.warpPerspective(second, self.homography, (width, height), flags=flags)
        covered = np.ones(second.shape[:2], np.float32)
        mask = cv2.warpPerspective(covered, self.homography, (width, height), flags=flags) > 0.999
        return picture, np.asarray(mask)


def register(
    a,
    b,
    method: str | Method = METHOD,
    *,
    group: str = "homography",
    response: Response = "srgb",
    theta: float = THETA_DEFAULT,
    init: np.ndarray | None = None,
    mask: np.ndarray | None = None,
    options: SolverOptions = OPTIONS,
) -> Registration:
    """Align two pictures of a plane, or of anything seen from one place, whatever the light in each.

    Parameters
    ----------
    a, b : (h, w, 3) uint8, uint16 or float array, or path
        Their sizes may differ.
    method : str or Method
        What is compared; see :data:`liaam.fitting.METHODS`.
    group : {"homography", "affine", "similarity", "translation"}
        What may differ between the pictures.
    response : Response
        Of the camera.
    theta : float
        Angle of the first picture's camera, radians, for the methods with angles.
    init : (3, 3) float, optional
        Homography to start from, pixels of ``a`` to pixels of ``b``; the whole of one on the whole of the other if
        left out, the identity for pictures of one size. From there a tenth of the picture's size can be made up for.
    mask : (h, w) bool, optional
        Pixels of ``a`` that count.
    options : SolverOptions

    Returns
    -------
    Registration
        Also for one that fails: see its ``status``.

    Raises
    ------
    ImageError
        For a picture that is none, or is grey where colours are compared.
    MethodError
        For a method or group that does not exist.
    """
    a, name_a = load_picture(a, "first picture")
    b, name_b = load_picture(b, "second picture")
    method = scored(_with_constants(get_method(method)), options)
    if group not in GENERATORS:
        raise MethodError(f"warp {group!r} does not exist; there are {', '.join(GENERATORS)}")
    for picture, name in ((a, name_a), (b, name_b)):
        if method.needs_colour:
            refuse_grey(picture, name, f"method {method.name} compares colours: use igo or grey")
    if mask is not None and mask.shape != a.shape[:2]:
        raise ImageError(f"the mask is {mask.shape[1]}×{mask.shape[0]} pixels, {name_a} {a.shape[1]}×{a.shape[0]}")
    levels, to_a = _levels(a, method, group, response, theta, mask)
    size = a.shape[:2]
    if not levels:
        return _nothing(size, method, FitStatus.NO_TEXTURE if method.encoding != "log" else FitStatus.TOO_DARK)
    homography = _whole_on_whole(size, b.shape[:2]) if init is None else np.asarray(init, dtype=np.float64)
    if homography.shape != (3, 3) or not np.isfinite(homography).all():
        raise ImageError("the start of a registration is a homography: 3 by 3 numbers, from the first picture's pixels")
    handles = apply_homography(homography, to_a(levels[0][0].warp.rest))
    if not np.isfinite(handles).all():
        raise ImageError("the start carries a corner of the first picture behind the second; give another one")
    stages = solve_levels(levels, Target(b, handles, response), options)
    return _judged(stages, handles, to_a, size, b.shape[:2])


def _whole_on_whole(size: tuple[int, int], other: tuple[int, int]) -> np.ndarray:
    """Homography that scales one picture to the other's size (height, width), centre on centre."""
    scale = np.array(other[::-1], dtype=np.float64) / size[::-1]
    matrix = np.diag([*scale, 1.0])
    matrix[:2, 2] = (scale - 1.0) / 2.0
    return matrix


def _with_constants(method: Method) -> Method:
    """Let a method of logarithms add a constant per row: each picture may have a white balance of its own.

    Gains of (1.3, 1, 0.8) make ``li`` six times as far off without it.
    """
    return replace(method, bias="rows") if method.encoding == "log" and method.bias == "none" else method


def _levels(
    a: np.ndarray, method: Method, group: str, response: Response, theta: float, mask: np.ndarray | None
) -> tuple[list[tuple[Objective, float]], Similarity]:
    """Objectives with their blurs, coarse to fine, and the similarity from their pixels to those of ``a``."""
    height, width = a.shape[:2]
    reduce = max(1, int(np.ceil(np.sqrt(height * width / MOST_PIXELS))))
    scaling = Similarity(np.eye(2) * reduce, np.full(2, (reduce - 1) / 2.0))
    corners = picture_corners(height, width)
    patches = [
        make_patch(a, corners, scaling, encoding=method.encoding, response=response, blur=blur, margin=0.0)
        for blur, _ in LEVELS
    ]
    # Levels differ in their blur only: size and place of their pixels are the same.
    from_a, size = patches[0].from_image, patches[0].channels.shape[:2]
    wanted = np.ones(size, dtype=bool) if mask is None else _reduced(mask.astype(np.float32), size) > 0.999
    luminance, noise = _luminance_and_noise(a, size)
    levels = []
    for patch, (blur, stride) in zip(patches, LEVELS, strict=True):
        kept = (patch.channels[..., -1] > 0) & wanted
        stands_out = _significance(luminance, noise, blur)
        significant = stands_out[kept & (stands_out > SIGNIFICANT)]
        if blur < SHARP and not (significant.size and np.median(significant) > CLEAR):
            continue
        if method.encoding == "orientation":
            kept &= stands_out > SIGNIFICANT
        kept = kept[::stride, ::stride]
        if kept.sum() < LEAST_PIXELS or max(blur, 1.0) > LARGEST_BLUR * min(size):
            continue
        mean = patch.channels[::stride, ::stride][kept]
        mean = np.ascontiguousarray(mean[:, : 2 if method.encoding == "orientation" else 3])
        if method.appearance == "invariant":
            mean = mean @ method.image_metric(theta).T.astype(np.float32)
        blank = np.zeros((0, *mean.shape), np.float32)
        appearance = AppearanceModel(mean, blank, np.zeros(0), np.ones(len(mean), np.float32))
        warp = HomographyWarp(kept, from_a(corners), float(stride), group)
        own = method, warp, appearance, theta, np.zeros(warp.n_parameters)
        levels.append((Objective(*own, kernel="reference", correlated=correlated_pixels(blur)), blur))
    return levels, from_a.inverse()


def _reduced(image: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    import cv2  # heavy: imported when first needed

    return image if image.shape[:2] == size else cv2.resize(image, size[::-1], interpolation=cv2.INTER_AREA)


def _luminance_and_noise(image: np.ndarray, size: tuple[int, int]) -> tuple[np.ndarray, float]:
    """Luminance of stored values, reduced to a size (h, w), and the standard deviation of its noise."""
    luminance = _reduced(np.ascontiguousarray(stored_values(image) @ LUMINANCE[0].astype(np.float32)), size)
    averaged = np.sqrt(np.prod(size) / np.prod(image.shape[:2]))
    return luminance, float(noise_deviation(image) * np.linalg.norm(LUMINANCE) * averaged)


def _significance(luminance: np.ndarray, noise: float, blur: float) -> np.ndarray:
    """Gradient of the blurred luminance, in standard deviations that noise gives it, (h, w)."""
    import cv2  # heavy: imported when first needed

    down, right = np.gradient(cv2.GaussianBlur(luminance, (0, 0), blur))
    return np.hypot(down, right) / (noise * slope_left(blur))


def _judged(
    stages: list[Stage], start: np.ndarray, to_a: Similarity, size: tuple[int, int], other: tuple[int, int]
) -> Registration:
    """Homography in pictures' pixels, and whether it can be believed."""
    stage = stages[-1]
    objective, solution = stage.objective, stage.solution
    state, has_angle, warp = solution.state, objective.method.has_angles, objective.warp
    assert isinstance(warp, HomographyWarp)
    matrix = _matrix(stage.pose) @ warp.matrix(state.p) @ np.linalg.inv(_matrix(to_a))
    points = warp.points(state.p, stage.pose)
    inside = np.asarray(((points >= 0) & (points <= np.array(other[::-1]) - 1)).all(axis=1))
    correlation = _correlation(stage)
    return Registration(
        homography=matrix / matrix[2, 2],
        status=_status(stage, start, inside, correlation),
        correlation=correlation,
        theta=float(state.angles[1]) if has_angle else float("nan"),
        cost=float(solution.costs[-1]),
        n_iterations=sum(s.solution.n_iterations for s in stages),
        corner_deviation=_corner_deviation(stage),
        size=size,
        method=objective.method.name,
    )


def _status(stage: Stage, start: np.ndarray, inside: np.ndarray, correlation: float) -> FitStatus:
    solution = stage.solution
    if solution.flat:
        return FitStatus.NO_TEXTURE
    if not is_sane(stage.shape(solution.state), start):
        return FitStatus.DIVERGED
    if inside.mean() < LEAST_OVERLAP:
        return FitStatus.LEFT_IMAGE
    if solution.work.usable[inside].mean() < LEAST_OVERLAP:
        return FitStatus.TOO_DARK
    if not correlation >= LEAST_CORRELATION:
        return FitStatus.DIVERGED
    if not solution.settled:
        return FitStatus.MAX_ITERATIONS
    return FitStatus.LIGHT_UNOBSERVABLE if solution.held else FitStatus.CONVERGED


def _correlation(stage: Stage) -> float:
    """Correlation of what is compared, over all pixels that count in both pictures; 0 where there are none."""
    objective, work = stage.objective, stage.solution.work
    metric = objective.method.image_metric(work.angles[1]).T
    seen = work.usable > 0
    if not seen.any():
        return 0.0
    ours = work.rows[0].reshape(len(seen), -1)[seen].astype(np.float64)
    theirs = work.values.reshape(len(seen), -1)[seen, : len(metric)] @ metric
    ours, theirs = ours - ours.mean(axis=0), theirs - theirs.mean(axis=0)
    scale = np.sqrt(np.square(ours).sum() * np.square(theirs).sum())
    return float((ours * theirs).sum() / scale) if scale > 0 else 0.0


def _corner_deviation(stage: Stage) -> np.ndarray:
    warp, p = stage.objective.warp, stage.solution.state.p
    n, step = warp.n_parameters, 1e-4
    if not stage.solution.work.usable.any():
        return np.full(4, np.inf)
    spread = covariance(stage)[:n, :n]
    slopes = np.stack([(warp.shape(p + step * e) - warp.shape(p - step * e)) / (2 * step) for e in np.eye(n)], axis=-1)
    variances = np.einsum("cai,ij,caj->c", slopes, spread, slopes)
    return stage.pose.scale * np.sqrt(np.maximum(variances, 0.0))


def _matrix(similarity: Similarity) -> np.ndarray:
    matrix = np.eye(3)
    matrix[:2, :2], matrix[:2, 2] = similarity.matrix, similarity.offset
    return matrix


def _nothing(size: tuple[int, int], method: Method, status: FitStatus) -> Registration:
    nan = float("nan")
    return Registration(np.eye(3), status, 0.0, nan, nan, 0, np.full(4, np.inf), size, method.name)
