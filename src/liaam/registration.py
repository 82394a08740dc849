"""Direct light-invariant registration of two images by a homography (the paper's reference [10]).

Cost (eq 9 and 10) and solver are those of a fit. The model is the first image, an appearance without modes, the warp is
a homography, and the method is any of :data:`liaam.fitting.METHODS`.
"""

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np

from liaam.errors import ImageError, MethodError
from liaam.fitting import FitStatus, Method, SolverOptions, get_method
from liaam.fitting.loop.encoded_image import EncodedImage, slope_noise_gain
from liaam.fitting.loop.levels import FittedLevel, LinearImage, Target, is_sane, solve_levels
from liaam.fitting.loop.objective import Objective, State
from liaam.fitting.loop.options import scored
from liaam.fitting.quality import covariance
from liaam.fitting.reference.loop import solve_level
from liaam.formatting import finite_list
from liaam.model.appearance import CHANNELS, AppearanceModel
from liaam.model.sampling import make_patch
from liaam.model.shape import Similarity
from liaam.model.warp import GROUPS, HomographyWarp, apply_homography, picture_corners
from liaam.photometry import LUMINANCE, THETA_DEFAULT, Response, noise_deviation
from liaam.photometry.encoding import refuse_grey, value_luminance
from liaam.photometry.picture import load_picture

__all__ = [
    "Registration",
    "register",
]


def __dir__() -> list[str]:
    return __all__


METHOD = "igo+tukey"
"""Gradient orientations do not depend on the light's intensity, and the robust loss rejects the edges of cast shadows.
Measured on posters and real objects: more accurate than ``li``, ``chroma`` and ``grey``."""

# Blur and sampling distance of each level, coarse to fine, in pixels of the reduced image
LEVELS = ((8.0, 4), (4.0, 2), (2.0, 1), (1.0, 1), (0.5, 1))
SHARP = 1.0  # Blur below which a level is used for clear images only
# Signal-to-noise ratio of a clear image: median of the significant gradients, in standard deviations of their noise.
# The sharpest level halves the errors on objects with fine texture, but with more noise it raises them by a half.
CLEAR = 10.0
MOST_PIXELS = 180_000  # Number of pixels to which larger images are reduced
SIGNIFICANT = 3.0  # Gradient, in standard deviations of its noise, below which its orientation is not used
LARGEST_BLUR = 1 / 12  # Largest blur of a level, as a fraction of the image's shorter side
LEAST_PIXELS = 200  # Smallest number of pixels of a level
LEAST_OVERLAP = 0.25  # Fraction of the first image's pixels that must lie inside the second
# Correlation below which the images do not show the same thing. Right registrations have at least 0.4 (cast shadows,
# twelve directions of light), images of different things at most 0.1.
LEAST_CORRELATION = 0.2
# Scoring corrects an interpolation bias. Samples between pixels are smoother, which moves minima of the cost towards
# the middle between pixels, by up to 0.4 pixels if noise or one image's texture dominates (measured on real objects).
OPTIONS = SolverOptions(max_iterations=60, scoring=20)
LARGEST_SIDE = 32_766  # Of pictures that OpenCV warps; longer ones are warped by parts
LEAST_SIDE = 8  # Of parts: smaller ones that still see too much of a picture are at its horizon, and remain black
# Message of each status: what happened, and what to do
MESSAGES = {
    FitStatus.CONVERGED: "The registration converged.",
    FitStatus.LIGHT_UNOBSERVABLE: "The registration converged. The angle is not observable here and was kept fixed.",
    FitStatus.MAX_ITERATIONS: "The registration did not converge within its iterations; start nearer to the solution.",
    FitStatus.DIVERGED: "The registered images do not match: they show different things, or lie too far apart; give "
    "a nearer start, or images that differ less.",
    FitStatus.LEFT_IMAGE: "The images hardly overlap; give images that share more than a quarter.",
    FitStatus.TOO_DARK: "Too few pixels are well exposed in both images; use brighter ones.",
    FitStatus.NO_TEXTURE: "The images have no texture to register; check the files.",
}


@dataclass(frozen=True, eq=False)
class Registration:
    """Result of a registration.

    Attributes
    ----------
    homography : (3, 3) float64
        Maps pixels of the first image to those of the second; its last entry is 1.
    status : FitStatus
        How the registration ended; use the result if ``status.ok``.
    correlation : float
        Correlation of the compared quantities where the images overlap.
    theta : float
        Angle of the second image's camera, radians; NaN for methods without angles.
    cost : float
        Mean squared residual, in the method's units.
    n_iterations : int
        Number of steps, rejected ones included.
    corner_deviation : (4,) float64
        Standard errors of the mapped corners of the first image, pixels of the second (square root of the sum of both
        axes' variances). The Gauss-Newton covariance behind them accounts for noise only.
    size : (int, int)
        Height and width of the first image.
    method : str
        Name of the method.
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
        """What happened, and what to do."""
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
        """Warp the second image to the frame of the first.

        Parameters
        ----------
        second : (h, w, c) uint8, uint16 or float32

        Returns
        -------
        picture : (h', w', c) of the same type
            0 beyond the second image's border.
        mask : (h', w') bool
            True inside the second image.
        """
        covered = np.ones(second.shape[:2], np.float32)
        mask = warp_picture(covered, self.homography, self.size) > 0.999
        return warp_picture(second, self.homography, self.size), np.asarray(mask)


@dataclass(frozen=True, eq=False)
class PlaneObjective(Objective):
    """The cost of a method for a plane at one level.

    Its loop is the one in NumPy, also where the core is built: the core sums over the triangles of a mesh.
    """

    @property
    def is_compiled(self) -> bool:
        """False."""
        return False

    def solve(self, image: EncodedImage, state: State, options: SolverOptions, evaluate_last: bool = True) -> Any:
        """Minimise the cost over one image from a state; see :meth:`Objective.solve`."""
        p, angles, lam = state
        return solve_level(self, image, p, tuple(angles.tolist()), lam, options, image.blur, evaluate_last)


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
    """Register two images of a plane, or of a scene from one viewpoint, under any light.

    Parameters
    ----------
    a, b : (h, w, 3) uint8, uint16 or float array, or path
        Images; their sizes may differ.
    method : str or Method
        What is compared; see :data:`liaam.fitting.METHODS`.
    group : {"homography", "affine", "similarity", "translation"}
        Group of transformations.
    response : Response
        Response of the camera.
    theta : float
        Angle of the first image's camera, radians, for methods with angles.
    init : (3, 3) float, optional
        Initial homography, pixels of ``a`` to pixels of ``b``. By default ``a`` is scaled to the size of ``b``. A start
        may be wrong by about a tenth of the image's size.
    mask : (h, w) bool, optional
        Pixels of ``a`` to use; by default all.
    options : SolverOptions

    Returns
    -------
    Registration
        Also if the registration fails: see its ``status``.

    Raises
    ------
    ImageError
        For an invalid image, mask or start, and for a grey image if the method compares colours.
    MethodError
        For an unknown method or group.
    """
    a, name_a = load_picture(a, "first image")
    b, name_b = load_picture(b, "second image")
    method = get_method(method)
    if method.encoding == "soft":
        raise MethodError(f"method {method.name} needs a trained model, not a second image; use li, igo or grey")
    if callable(method.encoding):
        raise MethodError(
            f"method {method.name}: registration takes the methods that 'liaam fit --help' lists, not functions"
        )
    if method.encoding == "log" and method.bias == "none":
        # Constants for the white balance. Without them, gains of (1.3, 1, 0.8) multiply the errors of ``li`` by six.
        method = replace(method, bias="rows")
    method = scored(method, options)
    if group not in GROUPS:
        raise MethodError(f"unknown warp {group!r}; choose from {', '.join(GROUPS)}")
    for picture, name in ((a, name_a), (b, name_b)):
        if method.needs_colour:
            refuse_grey(picture, name, f"method {method.name} compares colours; use igo or grey")
    if mask is not None and mask.shape != a.shape[:2]:
        size = f"{a.shape[1]}×{a.shape[0]}"
        raise ImageError(f"the mask is {mask.shape[1]}×{mask.shape[0]} pixels; give one of {name_a}'s size, {size}")
    levels, to_a = _levels(a, method, group, response, theta, mask)
    size = a.shape[:2]
    if not levels:
        nan = float("nan")
        status = FitStatus.TOO_DARK if method.encoding == "log" else FitStatus.NO_TEXTURE
        return Registration(np.eye(3), status, 0.0, nan, nan, 0, np.full(4, np.inf), size, method.name)
    if init is None:  # scale the first image to the size of the second
        scale = np.array(b.shape[1::-1], dtype=np.float64) / size[::-1]
        init = np.array([[scale[0], 0.0, (scale[0] - 1.0) / 2.0], [0.0, scale[1], (scale[1] - 1.0) / 2.0], [0, 0, 1]])
    homography = np.asarray(init, dtype=np.float64)
    if homography.shape != (3, 3) or not np.isfinite(homography).all():
        raise ImageError("the start is not a homography; give a finite 3 by 3 matrix from pixels of the first image")
    handles = apply_homography(homography, to_a(levels[0].warp.rest))
    if not np.isfinite(handles).all():
        raise ImageError("the start maps a corner of the first image behind the image plane; give another start")
    stages = solve_levels(levels, Target(LinearImage(b, response), handles), options)
    return _judged(stages, handles, to_a, size, b.shape[:2])


def warp_picture(picture: np.ndarray, homography: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Sample a picture (h, w, ...) where a homography maps the pixels of an image of a size (height, width).

    The result has the picture's type, and is 0 beyond its border.
    """
    height, width = size
    if max(height, width, *picture.shape[:2]) <= LARGEST_SIDE:
        return cv2.warpPerspective(picture, homography, (width, height), flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)
    warped = np.zeros((height, width, *picture.shape[2:]), picture.dtype)
    _warp_parts(picture, homography, warped)
    return warped


def _warp_parts(picture: np.ndarray, homography: np.ndarray, warped: np.ndarray) -> None:
    """Fill ``warped`` part by part, each from a part of the picture, so that no side is too long for OpenCV."""
    height, width = warped.shape[:2]
    box = _seen_box(homography, (height, width), picture.shape[:2])
    if box is not None and max(height, width, *(each.stop - each.start for each in box)) <= LARGEST_SIDE:
        part = picture[box]
        if part.size:
            shift = np.array([[1.0, 0.0, -box[1].start], [0.0, 1.0, -box[0].start], [0.0, 0.0, 1.0]])
            warped[:] = warp_picture(part, shift @ homography, (height, width)).reshape(warped.shape)
        return
    if max(height, width) <= LEAST_SIDE:
        return
    middle = max(height, width) // 2
    down = height >= width
    first, second = (warped[:middle], warped[middle:]) if down else (warped[:, :middle], warped[:, middle:])
    there = np.eye(3)
    there[int(down), 2] = middle
    _warp_parts(picture, homography, first)
    _warp_parts(picture, homography @ there, second)


def _seen_box(homography: np.ndarray, size: tuple[int, ...], limits: tuple[int, ...]) -> tuple[slice, slice] | None:
    """Return the rows and columns of a picture that an image sees; None if it reaches to the horizon.

    ``size`` and ``limits`` are the height and width of the image and of the picture.
    """
    corners = np.pad(picture_corners(size[0], size[1]), ((0, 0), (0, 1)), constant_values=1.0) @ homography.T
    depth = corners[:, 2:]
    if not ((depth > 0).all() or (depth < 0).all()):
        return None
    points = corners[:, :2] / depth
    most = np.array(limits[::-1])
    left, top = np.clip(np.floor(points.min(axis=0)) - 1, 0, most).astype(int).tolist()
    right, bottom = np.clip(np.ceil(points.max(axis=0)) + 2, 0, most).astype(int).tolist()
    return slice(top, bottom), slice(left, right)


def _levels(
    a: np.ndarray, method: Method, group: str, response: Response, theta: float, mask: np.ndarray | None
) -> tuple[list[Objective], Similarity]:
    """Return objectives, coarse to fine, and the similarity from their pixels to those of ``a``."""
    height, width = a.shape[:2]
    reduce = max(1, int(np.ceil(np.sqrt(height * width / MOST_PIXELS))))
    scaling = Similarity(np.eye(2) * reduce, np.full(2, (reduce - 1) / 2.0))
    corners = picture_corners(height, width)
    patches = [
        make_patch(a, corners, scaling, encoding=method.encoding, response=response, blur=blur, margin=0.0)
        for blur, _ in LEVELS
    ]
    # All levels have the same pixels; they differ in blur only.
    from_a = patches[0].from_image
    size = patches[0].channels.shape[:2]
    wanted = np.ones(size, dtype=bool)
    if mask is not None:
        wanted = cv2.resize(mask.astype(np.float32), size[::-1], interpolation=cv2.INTER_AREA) > 0.999
    luminance = cv2.resize(value_luminance(a, response), size[::-1], interpolation=cv2.INTER_AREA)
    noise = float(noise_deviation(a, response) * np.linalg.norm(LUMINANCE) * np.sqrt(np.prod(size) / (height * width)))
    levels = []
    for patch, (blur, stride) in zip(patches, LEVELS, strict=True):
        selected = (patch.channels[..., -1] > 0) & wanted
        slopes = np.gradient(cv2.GaussianBlur(luminance, (0, 0), blur))
        # Gradients in standard deviations of their noise.
        stands_out = np.hypot(*slopes) / (noise * slope_noise_gain(blur))
        significant = stands_out[selected & (stands_out > SIGNIFICANT)]
        if blur < SHARP and not (significant.size and np.median(significant) > CLEAR):
            continue
        if method.encoding == "orientation":
            selected &= stands_out > SIGNIFICANT
        selected = selected[::stride, ::stride]
        if selected.sum() < LEAST_PIXELS or max(blur, 1.0) > LARGEST_BLUR * min(size):
            continue
        mean = patch.channels[::stride, ::stride][selected]
        mean = np.ascontiguousarray(mean[:, : CHANNELS[method.encoding_name]])
        if method.appearance == "invariant":
            mean = mean @ method.image_metric(theta).T.astype(np.float32)
        blank = np.zeros((0, *mean.shape), np.float32)
        appearance = AppearanceModel(mean, blank, np.zeros(0), np.ones(len(mean), np.float32))
        warp = HomographyWarp(selected, from_a(corners), float(stride), group)
        levels.append(PlaneObjective(method, warp, appearance, theta, prior=np.zeros(warp.n_parameters), blur=blur))
    return levels, from_a.inverse()


def _judged(
    stages: list[FittedLevel], start: np.ndarray, to_a: Similarity, size: tuple[int, int], other: tuple[int, int]
) -> Registration:
    """Return the result in image pixels, with its status."""
    stage = stages[-1]
    objective = stage.objective
    solution = stage.solution
    has_angle = objective.method.has_angles
    warp = objective.warp
    assert isinstance(warp, HomographyWarp)
    matrix = _matrix(stage.pose) @ warp.matrix(solution.p) @ np.linalg.inv(_matrix(to_a))
    points = warp.points(solution.p, stage.pose)
    inside = np.asarray(((points >= 0) & (points <= np.array(other[::-1]) - 1)).all(axis=1))
    correlation = _correlation(stage)
    variances = np.full(4, np.inf)
    if solution.usable.any():
        n = warp.n_parameters
        step = 1e-4
        moves = [(warp.shape(solution.p + step * e) - warp.shape(solution.p - step * e)) for e in np.eye(n)]
        slopes = np.stack(moves, axis=-1) / (2 * step)
        variances = np.einsum("cai,ij,caj->c", slopes, covariance(stage)[:n, :n], slopes)
    return Registration(
        homography=matrix / matrix[2, 2],
        status=_status(stage, start, inside, correlation),
        correlation=correlation,
        theta=float(solution.angles[1]) if has_angle else float("nan"),
        cost=float(solution.costs[-1]),
        n_iterations=sum(s.solution.n_iterations for s in stages),
        corner_deviation=stage.pose.scale * np.sqrt(np.maximum(variances, 0.0)),
        size=size,
        method=objective.method.name,
    )


def _status(stage: FittedLevel, start: np.ndarray, inside: np.ndarray, correlation: float) -> FitStatus:
    solution = stage.solution
    if solution.no_texture:
        return FitStatus.NO_TEXTURE
    if not is_sane(stage.reached, start):
        return FitStatus.DIVERGED
    if inside.mean() < LEAST_OVERLAP:
        return FitStatus.LEFT_IMAGE
    if solution.usable[inside].mean() < LEAST_OVERLAP:
        return FitStatus.TOO_DARK
    if not correlation >= LEAST_CORRELATION:
        return FitStatus.DIVERGED
    if not solution.converged:
        return FitStatus.MAX_ITERATIONS
    return FitStatus.LIGHT_UNOBSERVABLE if solution.angle_fixed else FitStatus.CONVERGED


def _correlation(stage: FittedLevel) -> float:
    """Return the correlation of the compared quantities over the pixels usable in both images; 0 if there are none."""
    solution = stage.solution
    seen = solution.usable > 0
    if not seen.any():
        return 0.0
    theirs = solution.samples[seen]
    ours = stage.objective.mean_at(solution.angles[0]).reshape(len(seen), -1)[seen].astype(np.float64)
    ours = ours - ours.mean(axis=0)
    theirs = theirs - theirs.mean(axis=0)
    scale = np.sqrt(np.square(ours).sum() * np.square(theirs).sum())
    return float((ours * theirs).sum() / scale) if scale > 0 else 0.0


def _matrix(similarity: Similarity) -> np.ndarray:
    matrix = np.eye(3)
    matrix[:2, :2] = similarity.matrix
    matrix[:2, 2] = similarity.offset
    return matrix
