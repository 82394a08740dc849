"""Noise of pictures: the line sigma^2 = slope * rho + offset of linear light.

The line is the Poissonian-Gaussian model of Foi, Trimeche, Katkovnik and Egiazarian, "Practical Poissonian-Gaussian
noise modeling and fitting for single-image raw-data" (IEEE TIP 2008). Whatever it is estimated from becomes a
table of small blocks, each with its brightness and the variance about a smooth surface; one median regression
draws the line through them, and a jackknife over the blocks gives the errors.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from functools import lru_cache

import numpy as np

from liaam.errors import CameraError
from liaam.photometry.camera import NoiseModel
from liaam.photometry.encoding import DARK, SATURATED, as_colour, stored_values
from liaam.photometry.response import Response, log_slope, to_linear

SIDE = 8
"""Pixels across a block."""

ENOUGH_BLOCKS = 20_000
"""Blocks that are looked at; larger pictures are thinned out evenly."""

FEWEST = 24
"""Values (blocks times channels) without which there is no estimate."""

SILENT = 1e-14
"""Energy of what varies in a block below which it is painted or clipped: noise spares no block."""

TREND = 2
"""Degree of the polynomial that stands for the light within a block; what is above counts as noise."""

COARSE, FINE = 7, 9
"""Degrees from which a block of one picture shows little texture, and from which its noise is taken."""

WEAKEST = 0.1
"""Share of one picture's blocks that are believed: those of the weakest texture."""

BINS, BIN = 24, 100
"""Most classes of brightness within which textures are compared, and fewest values of each."""

BEND = 0.1
"""Relative deviation from the line up to which a block counts by its square, above by its size."""

ROUNDED = 0.4
"""Noise of fewer steps of stored values than this drowns in their rounding."""

ENDS = (0.05, 0.8)
"""Brightnesses, as shares of white, between which the line has to be known."""

VAGUE = 0.25
"""Relative standard error of the deviation at either end above which it is not."""

NARROW = 1.5
"""Ratio of the brightest to the darkest blocks below which they count as one brightness."""

COLOURED = 1.5
"""Ratio of coarse to fine noise above which it is not white."""

FLICKER = 0.1
"""Relative change of brightness above which two pictures have not the same exposure."""

MOVED = 0.25
"""Share of blocks that may differ by more than noise before a pair is distrusted."""

GROUPS, CLASSES = 40, 12
"""Groups of the jackknife: of places, and of brightnesses in one picture."""


@dataclass(frozen=True)
class NoiseEstimate:
    """Noise of linear light, estimated, with how far it can be trusted.

    Attributes
    ----------
    noise : NoiseModel
        The line; where its two numbers cannot be told apart, `message` says what was assumed.
    slope_error, offset_error : float
        Standard errors of the slope and the offset; infinite where nothing tells them apart.
    observable : bool
        Whether the material tells the deviation to a quarter of itself wherever it matters (`ENDS`).
    message : str
        The noise in numbers, and what is missing or doubtful, in a sentence or two.
    n : int
        Number of blocks (of one channel each) it rests on.
    """

    noise: NoiseModel
    slope_error: float
    offset_error: float
    observable: bool
    message: str
    n: int


def noise_from_flat(
    images: np.ndarray | Sequence[np.ndarray], boxes: np.ndarray | None = None, response: Response = "srgb"
) -> NoiseEstimate:
    """Noise from smooth surfaces: patches of a chart, or an evenly lit sheet, best out of focus.

    From each block of 8 by 8 pixels the best polynomial of second degree is taken off, so that the light may fall
    off; what is left is noise, in all but the few blocks with dust or an edge. One brightness gives one
    variance and cannot tell the slope from the offset: give patches of different brightness, or pictures of one
    sheet under different exposures.

    Parameters
    ----------
    images : sequence of (h, w, 3) uint8, uint16 or float, or one of them
        Stored values, all of one camera at one sensitivity (ISO).
    boxes : (n, 4) int, optional
        x0, y0, x1, y1 of each smooth region, the last pixel not included, the same in every picture; the whole
        picture if left out.
    response : Response
        From stored values to linear light.

    Returns
    -------
    NoiseEstimate
        Its errors treat blocks, but not channels, as independent.

    Raises
    ------
    CameraError
        If a box lies outside its picture, or too few blocks are neither dark nor saturated.
    ImageError
        If a picture is none.
    """
    pictures = [images] if isinstance(images, np.ndarray) and images.ndim <= 3 else list(images)
    regions = [
        region
        for number, picture in enumerate(pictures, 1)
        for region in _regions(as_colour(picture, f"picture {number}"), boxes, number)
    ]
    if not regions:
        raise CameraError("there is no picture or no box to take the noise from: give at least one of each")
    return _estimate(_joined([_blocks(region, None, response) for region in regions]), response)


def noise_from_pair(first: np.ndarray, second: np.ndarray, response: Response = "srgb") -> NoiseEstimate:
    """Noise from two pictures of one scene under one light, taken from one spot with one exposure.

    Half the variance of their difference, block by block, is the noise at the block's brightness, whatever is in the
    picture. A small flicker of the light is taken out, and the median forgives blocks in which something moved.

    Parameters
    ----------
    first, second : (h, w, 3) uint8, uint16 or float
        Stored values of the same size.
    response : Response
        From stored values to linear light.

    Returns
    -------
    NoiseEstimate

    Raises
    ------
    CameraError
        If the pictures differ in size, are the same, or too few blocks are neither dark nor saturated.
    ImageError
        If a picture is none.
    """
    first, second = as_colour(first, "first picture"), as_colour(second, "second picture")
    if first.shape != second.shape or first.dtype != second.dtype:
        raise CameraError(
            f"the pair's pictures are {_size(first)} and {_size(second)}: give two of the same size and depth, taken "
            "from the same spot"
        )
    if np.array_equal(first, second, equal_nan=first.dtype.kind == "f"):
        raise CameraError("the pair's pictures are the same: give two that were taken one after the other")
    blocks = _blocks(first, second, response)
    estimate = _estimate(blocks, response)
    expected = estimate.noise.variance(blocks.level) + blocks.rounding
    moved = float(np.mean(blocks.variance(TREND + 1) > 2.5 * expected))
    if not estimate.observable or moved <= MOVED:
        return estimate
    doubt = f"; but {moved:.0%} of the blocks differ by more than that: use a tripod, a still scene and a steady light"
    return replace(
        estimate, observable=False, slope_error=np.inf, offset_error=np.inf, message=estimate.message + doubt
    )


def noise_from_image(image: np.ndarray, response: Response = "srgb") -> NoiseEstimate:
    """Noise from one picture of anything.

    Blocks compete within classes of brightness: the tenth with the least texture, told by their coarse structure,
    give the noise by their fine structure, which white noise makes independent of the coarse one. After Ponomarenko,
    Lukin, Zriakhov, Kaarna and Astola, "An automatic approach to lossy compression of AVIRIS images" (IGARSS 2007), and
    Colom and Buades, "Analysis and extension of the Ponomarenko et al. method, estimating a noise curve from a
    single image" (IPOL 2013), with discrete polynomials in place of cosines: they are blind to smooth shading.

    Parameters
    ----------
    image : (h, w, 3) uint8, uint16 or float
        Stored values.
    response : Response
        From stored values to linear light.

    Returns
    -------
    NoiseEstimate
        Too large where texture is left in the fine structure, as at a brightness that only hair or cloth has; too
        small where JPEG smoothed the noise away. Coarser and finer structure then disagree, and the errors hold
        what they disagree by.

    Raises
    ------
    CameraError
        If too few blocks are neither dark nor saturated.
    ImageError
        If the picture is none.
    """
    return _estimate(_blocks(as_colour(image), None, response), response, single=True)


# Blocks -------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class _Blocks:
    """Blocks of one channel each: how bright they are, and what varies in them."""

    level: np.ndarray
    """(n,) float64: mean linear light."""
    rounding: np.ndarray
    """(n,) float64: variance that the rounding of stored values adds to linear light."""
    energy: np.ndarray
    """(n, 2 SIDE - 1) float64: sum of squared polynomial coefficients of each degree."""
    place: np.ndarray
    """(n,) int: number of the block in its picture, the same for its three channels."""
    trust: np.ndarray
    """(n,) float64: weights, at most 1."""

    def __len__(self) -> int:
        return len(self.level)

    def __getitem__(self, chosen: np.ndarray) -> _Blocks:
        return _Blocks(*(getattr(self, column.name)[chosen] for column in fields(self)))

    def variance(self, low: int, high: int = 2 * SIDE - 2) -> np.ndarray:
        """Variance (n,) by the coefficients of degrees low to high, its *median* true under white noise."""
        count = sum(min(d + 1, 2 * SIDE - 1 - d) for d in range(low, high + 1))
        median = (1.0 - 2.0 / (9.0 * count)) ** 3  # of chi squared over its degrees of freedom (Wilson, Hilferty 1931)
        return self.energy[:, low : high + 1].sum(axis=1) / (count * median)


@lru_cache(maxsize=1)
def _polynomials() -> np.ndarray:
    """Orthonormal polynomials on a block, (SIDE^2, SIDE^2): columns x^i y^j, i slowest, made orthogonal."""
    line, _ = np.linalg.qr(np.vander(np.linspace(-1, 1, SIDE), SIDE, increasing=True))
    return np.kron(line, line)


def _cut(image: np.ndarray) -> np.ndarray:
    """Cut an image (h, w, 3) into blocks (n, 3, SIDE^2) that do not overlap, evenly thinned out if there are many."""
    windows = np.lib.stride_tricks.sliding_window_view(image, (SIDE, SIDE), axis=(0, 1))
    every = SIDE * int(np.ceil(np.sqrt(windows.shape[0] * windows.shape[1] / (ENOUGH_BLOCKS * SIDE**2))))
    return windows[::every, ::every].reshape(-1, 3, SIDE**2)


def _blocks(first: np.ndarray, second: np.ndarray | None, response: Response) -> _Blocks:
    """Blocks of one picture, or of the difference of two that show the same.

    A difference is scaled to have the noise of one picture. A block counts where it is neither dark nor saturated;
    the pixels of a pair are judged by their mean, which knows nothing of their difference.
    """
    stored, linear, usable = _values(first, response)
    signal, judged = linear, stored.mean(axis=2, keepdims=True)
    if second is not None:
        other_stored, other_linear, other_finite = _values(second, response)
        judged = stored = (stored + other_stored) / 2
        usable &= other_finite
    usable &= ((judged >= DARK) & (judged <= SATURATED)).all(axis=2)
    if second is not None:
        gain = np.sqrt(_flicker(linear, other_linear, usable))
        signal = (linear * gain - other_linear / gain) / np.sqrt(2)
        linear = (linear + other_linear) / 2
    positive = np.maximum(stored, 1e-4)
    step = 1.0 / np.iinfo(first.dtype).max if first.dtype.kind == "u" else 0.0
    rounding = np.square(step * log_slope(positive, response) * to_linear(positive, response)).mean(axis=2) / 12
    degree = np.add.outer(np.arange(SIDE), np.arange(SIDE)).ravel()
    energy = np.square(signal @ _polynomials()) @ (degree[:, None] == np.arange(2 * SIDE - 1)).astype(float)
    place = np.broadcast_to(np.arange(len(stored))[:, None], usable.shape)
    return _Blocks(linear.mean(axis=2), rounding, energy, place, np.ones(usable.shape))[usable]


def _values(image: np.ndarray, response: Response) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Stored values and linear light of an image's blocks (n, 3, SIDE^2), and which are finite throughout (n, 3)."""
    cut = _cut(image)
    finite = np.asarray(np.isfinite(cut).all(axis=2))
    stored = np.clip(np.where(finite[..., None], stored_values(cut, np.float64), 0.0), -1.0, 4.0)
    return stored, np.asarray(to_linear(stored, response), dtype=np.float64), finite


def _flicker(first: np.ndarray, second: np.ndarray, usable: np.ndarray) -> float:
    """Ratio of the second picture's brightness to the first's, from blocks (n, 3, SIDE^2) of which some are usable."""
    if not usable.any():
        return 1.0
    gain = float(np.median(second.mean(axis=2)[usable] / np.maximum(first.mean(axis=2)[usable], 1e-6)))
    if abs(gain - 1) > FLICKER:
        raise CameraError(
            f"the pair's pictures differ in brightness by {abs(gain - 1):.0%}: take both with one exposure under one "
            "light"
        )
    return gain


def _regions(picture: np.ndarray, boxes: np.ndarray | None, number: int) -> list[np.ndarray]:
    """Cut boxes (n, 4) out of a picture."""
    if boxes is None:
        return [picture]
    corners = np.asarray(boxes)
    if corners.ndim != 2 or corners.shape[1] != 4 or corners.dtype.kind not in "iu":
        raise CameraError(f"boxes of shape {corners.shape} and type {corners.dtype}: give whole numbers, (n, 4)")
    for x0, y0, x1, y1 in corners:
        inside = min(x0, y0) >= 0 and x1 <= picture.shape[1] and y1 <= picture.shape[0]
        if not inside or min(x1 - x0, y1 - y0) < SIDE:
            raise CameraError(
                f"box {x0}, {y0}, {x1}, {y1}: give x0, y0, x1, y1 of at least {SIDE}×{SIDE} pixels inside picture "
                f"{number}, which has {_size(picture)}"
            )
    return [picture[y0:y1, x0:x1] for x0, y0, x1, y1 in corners]


def _size(picture: np.ndarray) -> str:
    return f"{picture.shape[1]}×{picture.shape[0]} pixels of {picture.dtype}"


def _joined(parts: list[_Blocks]) -> _Blocks:
    """Put the blocks of several regions into one table."""
    starts = np.cumsum([0] + [int(part.place.max(initial=0)) + 1 for part in parts])
    moved = [replace(part, place=part.place + start) for part, start in zip(parts, starts, strict=False)]
    return _Blocks(*(np.concatenate([getattr(part, column.name) for part in moved]) for column in fields(_Blocks)))


def _weakest(blocks: _Blocks) -> _Blocks:
    """Blocks of the least texture among those about as bright."""
    share = max(WEAKEST, min(1.0, FEWEST / len(blocks)))
    texture = blocks.energy[:, TREND + 1 : COARSE].sum(axis=1)
    classes = np.array_split(np.argsort(blocks.level), int(np.clip(len(blocks) // BIN, 1, BINS)))
    best = [class_[np.argsort(texture[class_])[: int(np.ceil(share * len(class_)))]] for class_ in classes]
    return blocks[np.concatenate(best)]


def _distrusted(blocks: _Blocks, line: np.ndarray) -> _Blocks:
    """Blocks that count the less the more their texture exceeds the noise."""
    noise = np.maximum(blocks.level * line[0] + line[1] + blocks.rounding, SILENT)
    texture = np.maximum(blocks.variance(TREND + 1, COARSE - 1), SILENT)
    return replace(blocks, trust=np.square(np.minimum(1.0, noise / texture)))


# The line -----------------------------------------------------------------------------------------
def _line(
    blocks: _Blocks,
    low: int,
    high: int = 2 * SIDE - 2,
    start: np.ndarray | None = None,
    free: bool = False,
    rounds: int = 40,
) -> np.ndarray:
    """Slope and offset, (2,) float64, of the variance of blocks in the degrees low to high.

    The sum of relative deviations is least, by iterated weighted least squares, so that half of the blocks but one may
    hold something else than noise. Neither number is below 0 unless `free`, for the errors' sake.
    """
    variance = blocks.variance(low, high)
    wanted = variance - blocks.rounding
    design = np.column_stack([blocks.level, np.ones(len(blocks))])
    line = np.array([max(np.median(wanted / blocks.level), 0.0), 0.0]) if start is None else start
    least = max(1e-3 * float(np.median(variance)), 1e-16)
    for _ in range(rounds):
        expected = np.maximum(design @ line + blocks.rounding, least)
        deviation = np.abs(wanted - design @ line) / expected
        weight = blocks.trust / (np.square(expected) * np.maximum(deviation, BEND))
        normal, right = (design.T * weight) @ design, (design.T * weight) @ wanted
        line = np.linalg.lstsq(normal, right, rcond=1e-12)[0]
        if not free and line.min() < 0:
            kept = int(line[0] < 0)  # the one that is left when the other is 0
            line = np.zeros(2)
            line[kept] = max(right[kept] / normal[kept, kept], 0.0)
    return line


def _jackknife(blocks: _Blocks, groups: np.ndarray, estimate: Callable[[_Blocks], np.ndarray]) -> np.ndarray:
    """Covariance (k, k) of an estimate, leaving out one of the groups (n,) of blocks after another."""
    numbers = np.unique(groups)
    draws = np.array([estimate(blocks[groups != number]) for number in numbers])
    return (len(numbers) - 1) * np.cov(draws.T, bias=True)


# The verdict --------------------------------------------------------------------------------------
def _estimate(blocks: _Blocks, response: Response, single: bool = False) -> NoiseEstimate:
    """Draw the line through blocks, and judge what it is worth."""
    white = float(to_linear(np.array(1.0), response))
    noisy = _enough(blocks)[blocks.energy[:, TREND + 1 :].sum(axis=1) > SILENT]
    if len(noisy) < FEWEST:
        return _silent(blocks)
    low = FINE if single else TREND + 1
    used, line = _drawn(_weakest(noisy) if single else noisy, low, single)
    reach = 3 * np.sqrt(used.level * line[0] + line[1])
    used = _enough(used[(used.level > reach) & (used.level < white - reach)])  # clipping hides noise
    used, line = _drawn(used, low, single)
    steps = (used.level * line[0] + line[1]) / np.maximum(12 * used.rounding, 1e-300)
    if np.median(steps) < ROUNDED**2:
        return _silent(used)
    tint = _tint(used, low, single)
    darkest, brightest = np.percentile(used.level, [5, 95])
    if brightest < NARROW * darkest:
        return _of_one_brightness(used, low, tint)
    spread = _spread(used, low, line, single)
    ends = np.column_stack([white * np.array(ENDS), np.ones(2)])
    vague = (np.sqrt(np.einsum("ij,jk,ik->i", ends, spread, ends)) > 2 * VAGUE * (ends @ line)).any()
    doubt = (
        f"; brightnesses of {darkest:.2g} to {brightest:.2g} in {len(used)} blocks leave it in doubt" if vague else ""
    )
    model, errors = NoiseModel(float(line[0]), float(line[1])), np.sqrt(np.diag(spread))
    levels = [white * rho for rho in (ENDS[0], 0.2, ENDS[1])]
    message = f"noise of deviation {_deviations(model, levels)}{doubt}{tint}"
    return NoiseEstimate(model, float(errors[0]), float(errors[1]), not vague, message, len(used))


def _of_one_brightness(blocks: _Blocks, low: int, tint: str) -> NoiseEstimate:
    """Put all noise down to photons, whose share is the larger at ordinary exposures."""
    slope = float(np.median((blocks.variance(low) - blocks.rounding) / blocks.level))
    model = NoiseModel(max(slope, 0.0), 0.0)
    message = (
        f"noise of deviation {_deviations(model, [float(np.median(blocks.level))])}; one brightness cannot tell photon "
        f"noise from noise in the dark, so all is put down to photons: add darker or brighter surfaces{tint}"
    )
    return NoiseEstimate(model, np.inf, np.inf, False, message, len(blocks))


def _drawn(blocks: _Blocks, low: int, single: bool) -> tuple[_Blocks, np.ndarray]:
    """Blocks, those of one picture with the trust they deserve, and their line."""
    line = _line(blocks, low)
    for _ in range(3 * single):
        blocks = _distrusted(blocks, line)
        line = _line(blocks, low)
    return blocks, line


def _enough(blocks: _Blocks) -> _Blocks:
    if len(blocks) >= FEWEST:
        return blocks
    raise CameraError(
        f"only {len(blocks)} blocks of {SIDE}×{SIDE} pixels, counted in each channel, are neither dark, saturated, "
        f"broken nor clipped by noise, and it takes {FEWEST}: give larger regions or a better exposed picture"
    )


def _silent(blocks: _Blocks) -> NoiseEstimate:
    """Say that the stored values are too coarse to show noise, and give what they could hide."""
    hidden = ROUNDED**2 * 12 * float(np.median(blocks.rounding))
    message = (
        f"no noise is seen beyond the rounding of stored values: from pixel to pixel its deviation is at most about "
        f"{np.sqrt(hidden):.2g}, or JPEG smoothed it away; give pictures of 16 bits, or RAW files"
        if hidden > 0
        else "there is no noise at all: this picture was computed, not taken"
    )
    return NoiseEstimate(NoiseModel(0.0, hidden), np.inf, np.inf, False, message, len(blocks))


def _spread(blocks: _Blocks, low: int, line: np.ndarray, single: bool) -> np.ndarray:
    """Covariance (2, 2) of slope and offset.

    The channels of a place are left out together, as demosaicking makes them share their noise. One picture has two
    errors more: blocks of about one brightness share their texture, so they are left out together as well; and what
    coarser and finer structure disagree by, more than by chance, is texture too. (Without the two, 95 % intervals from
    simulated portraits held the true offset in 54 to 60 % of cases, with them in 85 to 100 %.)
    """

    def again(part: _Blocks) -> np.ndarray:
        return _line(part, low, start=line, free=True, rounds=12)

    chance = _jackknife(blocks, np.unique(blocks.place, return_inverse=True)[1] % GROUPS, again)
    if not single:
        return chance

    def disagreement(part: _Blocks) -> np.ndarray:
        return again(part) - _line(part, COARSE, FINE - 1, start=line, free=True, rounds=12)

    alike = np.argsort(np.argsort(blocks.level)) * CLASSES // len(blocks)
    excess = np.square(disagreement(blocks)) - np.diag(_jackknife(blocks, alike, disagreement))
    return chance + _jackknife(blocks, alike, again) + np.diag(np.maximum(excess, 0.0))


def _tint(blocks: _Blocks, low: int, single: bool) -> str:
    """Say that the noise is not white, where it is not."""
    coarse = blocks.variance(COARSE, FINE - 1) if single else blocks.variance(low, COARSE - 1)
    ratio = float(np.median(coarse) / max(np.median(blocks.variance(FINE)), 1e-300))
    if ratio < COLOURED:
        return ""
    cause = (
        "texture is left in it, or JPEG or demosaicking smoothed it" if single else "JPEG or demosaicking smoothed it"
    )
    return f"; it is {np.sqrt(ratio):.1f} times as strong in coarse as in fine structure: {cause}"


def _deviations(model: NoiseModel, levels: list[float]) -> str:
    """Write deviations at brightnesses."""
    parts = [f"{np.sqrt(model.variance(np.array(level))):.2g} at brightness {level:.2g}" for level in levels]
    return ", ".join(parts)
