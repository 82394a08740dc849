"""Whether the tissue at each landmark is what the model expects, from the residual around it.

The concordance of the gradients s of the image and those m of the fitted appearance around a landmark,

    c = 2 sum w s.m / (sum w |s|^2 + sum w |m|^2 + floor) = 1 - sum w |s - m|^2 / (...),

is Lin's coefficient (Biometrics 45, 1989) of gradients, whose mean is 0: the share of the contrast of both that the
residual leaves. It is near 1 where the image is what the model expects, and near 0 where it is something else, or
blank. ``w`` is a Gaussian window. :class:`liaam.model.presence.Presence` makes probabilities of it, and of the contrast
of s by that of m, which is low where the image is blank. They say whether a part of the object is absent; which part it
is says :mod:`liaam.fitting.quality.segmentation`.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from liaam.fitting.loop.objective import Objective
from liaam.fitting.methods import GRADIENT_ROWS
from liaam.fitting.quality.segmentation import Segmentation, segmented
from liaam.fitting.result import LEAST_PRESENT
from liaam.io.landmarks.base import PRESENT
from liaam.model.presence import Agreement, Presence
from liaam.model.shape import diagonal_of
from liaam.model.warp import THINNING, PiecewiseAffineWarp

# Standard deviation of the windows, as a fraction of the diagonal of the mean shape: narrow enough that landmarks
# beside a hole of 15 % of the diagonal are not called absent, and wide enough for some ten independent samples.
WIDTH = 0.03
# Squared gradients (of softly normalised ones, at most 1) that count as contrast everywhere: of windows with less
# contrast, noise determines the concordance.
FLOOR = 0.02
# Weight of pixels beside the object: another one may lie there, such as a label, without covering a landmark
BESIDE = 0.25
LEAST_CONTRAST = 1e-9  # of a window without usable pixels
REACH = 4.0  # Standard deviations at which a Gaussian is truncated


@dataclass(frozen=True, eq=False)
class Agreements:
    """How well image and fit agree around each landmark, and around each sampled pixel.

    Attributes
    ----------
    surroundings : Surroundings
    sums : (3, n_cells) float32
        Sums over the window around each cell: what image and fit share, and the contrast of each.
    """

    surroundings: "Surroundings"
    sums: np.ndarray

    @property
    def landmarks(self) -> Agreement:
        """The agreement around each landmark."""
        return self._in(self.surroundings.cells_of_landmarks)

    @property
    def pixels(self) -> Agreement:
        """The agreement around each sampled pixel."""
        return self._in(self.surroundings.cells_of_pixels)

    def _in(self, cells: np.ndarray) -> Agreement:
        """Return the agreement in some cells, by index."""
        shared, of_image, of_fit = self.sums[:, cells]
        floor = self.surroundings.floor[cells]
        of_image = np.maximum(of_image, 0.0) + floor
        of_fit = np.maximum(of_fit, 0.0) + floor
        return Agreement(2.0 * shared / (of_image + of_fit), np.log(of_image / of_fit))


class Gradients(NamedTuple):
    """Gradients (n_pixels, 2) of the image, 0 where it is not usable, and of the fit."""

    seen: np.ndarray
    expected: np.ndarray


@dataclass(frozen=True, eq=False)
class Surroundings:
    """Windows around the landmarks and around the sampled pixels of a level.

    They lie on a grid over the reference frame, whose cells are as far apart as the sampled pixels.
    """

    objective: Objective

    def compared(self, samples: np.ndarray, residual: np.ndarray, usable: np.ndarray) -> Agreements:
        """Compare image and fit around each landmark and each sampled pixel.

        Parameters
        ----------
        samples, residual : (n_pixels * k,) or (n_pixels, k)
            Samples of the image, and what the fit leaves of them.
        usable : (n_pixels,)
            Which of these are in the image and usable. The others agree with nothing.
        """
        return self._agreements(self._gradients(samples, residual, usable))

    def _agreements(self, gradients: Gradients) -> Agreements:
        """Compare image and fit around each landmark and each sampled pixel by their gradients."""
        seen, expected = gradients
        pairs = ((seen, expected), (seen, seen), (expected, expected))
        products = np.stack([np.einsum("nk,nk->n", first, second) for first, second in pairs])
        return Agreements(self, self._summed(self.weights * np.nan_to_num(products, posinf=0.0, neginf=0.0)))

    def _gradients(self, samples: np.ndarray, residual: np.ndarray, usable: np.ndarray) -> Gradients:
        """Return the gradients of the image and of the fit at each sampled pixel."""
        k = self.objective.method.n_rows
        samples = np.reshape(samples, (-1, k))[:, :GRADIENT_ROWS]
        expected = samples - np.reshape(residual, (-1, k))[:, :GRADIENT_ROWS]
        seen = samples.copy()
        seen[~(np.asarray(usable) > 0)] = 0.0
        return Gradients(seen, expected)

    def _gradients_in(self, solution: Any) -> Gradients:
        """Return the gradients in a solution that keeps its samples."""
        return self._gradients(solution.samples, solution.residual, solution.usable)

    def compared_in(self, solution: Any) -> Agreements:
        """Compare image and fit in a solution that keeps its samples."""
        return self._agreements(self._gradients_in(solution))

    def _summed(self, values: np.ndarray) -> np.ndarray:
        """Sum values (c, n_pixels) of the sampled pixels over the window around each cell, (c, n_cells) float32."""
        picture = self.on_grid(values.T)
        return self.blurred(picture, WIDTH).reshape(-1, len(values)).T

    def on_grid(self, values: np.ndarray) -> np.ndarray:
        """Return values (n_pixels, ...) of the sampled pixels in the cells of the grid, (h, w, ...) float32."""
        height, width = self._size
        grid = np.zeros((height * width, *values.shape[1:]), np.float32)
        grid[self.cells_of_pixels] = values
        return grid.reshape(height, width, *values.shape[1:])

    def blurred(self, picture: np.ndarray, width: float) -> np.ndarray:
        """Blur values on the grid (h, w, ...); the deviation is a fraction of the diagonal of the mean shape."""
        import cv2  # heavy: imported when first needed

        return cv2.GaussianBlur(picture, (0, 0), self._cells_across(width), borderType=cv2.BORDER_CONSTANT)

    def taps(self, width: float) -> np.ndarray:
        """Return half the taps of a Gaussian on the grid, from the middle on, (k,) float32; for its width see there."""
        import cv2  # heavy: imported when first needed

        reach = int(np.ceil(REACH * self._cells_across(width)))
        return cv2.getGaussianKernel(2 * reach + 1, self._cells_across(width), cv2.CV_32F)[reach:, 0]

    def _cells_across(self, width: float) -> float:
        """Return a fraction of the diagonal of the mean shape in cells of the grid."""
        return width * self._diagonal / self._step

    @cached_property
    def weights(self) -> np.ndarray:
        """Weights of the sampled pixels, (n_pixels,) float32."""
        beside = np.where(_mesh_warp(self.objective).within_mesh, 1.0, BESIDE)
        return (beside * self.objective.appearance.usable).astype(np.float32)

    @cached_property
    def floor(self) -> np.ndarray:
        """Contrast that is added to that of the image and to that of the fit around each cell, (n_cells,) float32.

        Both together have the contrast :data:`FLOOR`, under the weights of the window.
        """
        of_pixels = 0.5 * FLOOR * self.weights
        return np.maximum(self._summed(of_pixels[None])[0], LEAST_CONTRAST)

    def probabilities(self, presence: Presence, solution: Any) -> np.ndarray:
        """Return the probability that each landmark is present in a solution that keeps its samples, (n,) float64.

        The object is segmented where the windows say that a part is absent, or the segmentation is sure of it. Of a fit
        of which most is absent, which is elsewhere, the windows decide.
        """
        gradients = self._gradients_in(solution)
        by_windows = presence.probabilities(self._agreements(gradients).landmarks)
        if _are_mostly_absent(by_windows) or not self.can_segment:
            return by_windows
        segmentation = self._segmented(gradients)
        if _are_mostly_absent(segmentation.landmarks):
            return by_windows
        is_incomplete = (by_windows < PRESENT).any() or segmentation.is_sure
        return segmentation.landmarks if is_incomplete else by_windows

    def present_pixels(self, presence: Presence, solution: Any) -> np.ndarray:
        """Return at which sampled pixels a solution's image is what the model expects, (n_pixels,) bool."""
        if self.can_segment:
            return self._segmented(self._gradients_in(solution)).pixels >= PRESENT
        return presence.agree(self.compared_in(solution).pixels, self._landmarks_around)

    def _segmented(self, gradients: Gradients) -> Segmentation:
        """Segment the object by gradients."""
        return segmented(self, np.nan_to_num(gradients.seen), np.nan_to_num(gradients.expected))

    @cached_property
    def can_segment(self) -> bool:
        """Whether training has estimated the model's errors."""
        return bool(self.error_variances.any())

    @cached_property
    def error_variances(self) -> np.ndarray:
        """Variance of the model's errors in a gradient of each sampled pixel, (n_pixels,) float32; 0 if unknown."""
        return self.objective.error_variances(GRADIENT_ROWS).astype(np.float32)

    @cached_property
    def is_sampled(self) -> np.ndarray:
        """Whether a cell of the grid has a sampled pixel, (h, w) float32 in {0, 1}."""
        return self.on_grid(np.ones(len(self.cells_of_pixels)))

    def nearest_of(self, objective: Objective) -> np.ndarray:
        """Return the nearest sampled pixel to each pixel of another level on the same frame, (m,) int."""
        from scipy.spatial import KDTree  # heavy: imported when first needed

        return np.asarray(KDTree(_places(self.objective)).query(_places(objective))[1])

    @cached_property
    def _landmarks_around(self) -> np.ndarray:
        """Weights of the landmarks around each sampled pixel, (n_pixels, n) float64."""
        return _mesh_warp(self.objective).interpolate(np.eye(len(self.objective.warp.rest)))

    @cached_property
    def _diagonal(self) -> float:
        return diagonal_of(self.objective.warp.rest)

    @cached_property
    def _step(self) -> int:
        """Distance of the sampled pixels, pixels of the frame."""
        return max(1, round(THINNING * self.objective.blur))

    @cached_property
    def _size(self) -> tuple[int, int]:
        """Rows and columns of the grid."""
        width, height = _mesh_warp(self.objective).frame.size
        return (height - 1) // self._step + 1, (width - 1) // self._step + 1

    @cached_property
    def cells_of_pixels(self) -> np.ndarray:
        """Cell of each sampled pixel, (n_pixels,) int."""
        return self._cells(_places(self.objective))

    @cached_property
    def cells_of_landmarks(self) -> np.ndarray:
        """Cell of each landmark of the mean shape, (n,) int."""
        warp = _mesh_warp(self.objective)
        return self._cells(warp.rest - warp.frame.origin)

    def _cells(self, places: np.ndarray) -> np.ndarray:
        """Return the cells of places (m, 2), (x, y) from the frame's top-left pixel, (m,) int."""
        height, width = self._size
        # Halves are rounded up: the pixels of a mirrored model may lie half-way between cells.
        rounded = np.floor(places / self._step + 0.5).astype(int)
        columns, rows = np.clip(rounded, 0, (width - 1, height - 1)).T
        return rows * width + columns


def _are_mostly_absent(probabilities: np.ndarray) -> bool:
    """Return whether most landmarks are absent, by their probabilities to be present (n,)."""
    return bool((~(probabilities < PRESENT)).mean() < LEAST_PRESENT)


def _mesh_warp(objective: Objective) -> PiecewiseAffineWarp:
    """Return the warp of an objective; only methods that fit meshes are calibrated."""
    assert isinstance(objective.warp, PiecewiseAffineWarp)
    return objective.warp


def _places(objective: Objective) -> np.ndarray:
    """Return (x, y) of the pixels of a level from the frame's top-left pixel, (m, 2) int."""
    warp = _mesh_warp(objective)
    pixels = warp.frame.pixels[:, ::-1]
    return pixels if warp.selected is None else pixels[warp.selected]
