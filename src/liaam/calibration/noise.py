"""Estimate the noise of images: the line sigma^2 = slope * rho + offset of linear light.

The line is the Poissonian-Gaussian model of Foi, Trimeche, Katkovnik and Egiazarian, "Practical Poissonian-Gaussian
noise modeling and fitting for single-image raw-data" (IEEE TIP 2008). Images are divided into small blocks, each with
its brightness and the variance about a smooth surface. A median regression fits the line, and a jackknife over the
blocks estimates its standard errors.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from liaam.calibration.estimate import jackknife
from liaam.errors import CameraError
from liaam.photometry.camera import NoiseModel
from liaam.photometry.encoding import as_colour, stored_values, usable_range
from liaam.photometry.response import Response, log_slope, to_linear

SIDE = 8  # Side of a block, pixels
ENOUGH_BLOCKS = 20_000  # Largest number of blocks; those of larger images are subsampled evenly
FEWEST = 24  # Least number of values (blocks times channels) for an estimate
# Energy of a block's variation below which it is synthetic or clipped, since every real block has noise
CONSTANT = 1e-14
TREND = 2  # Degree of the polynomial that models the light in a block; higher degrees count as noise
# For a single image: degrees from which a block has little texture, and from which noise is estimated
COARSE, FINE = 7, 9
WEAKEST = 0.1  # For a single image: fraction of the blocks to use, those of the weakest texture
# Largest number of classes of brightness within which textures are compared, and least number of values in each
BINS, BIN = 24, 100
BEND = 0.1  # Relative deviation from the line at which the loss changes from quadratic to linear
ROUNDED = 0.4  # Standard deviation, in steps of stored values, below which rounding hides noise
ENDS = (0.05, 0.8)  # Range of brightness, as fractions of white, in which the line has to be known
VAGUE = 0.25  # Largest relative standard error of the standard deviation at both ends of the range
NARROW = 1.5  # Ratio of the brightest to the darkest blocks below which they count as one brightness
COLOURED = 1.5  # Ratio of coarse to fine noise above which it is not white
FLICKER = 0.1  # Largest relative difference in brightness of two images of the same exposure
MOVED = 0.25  # Fraction of blocks with differences above the noise from which a pair is rejected
GROUPS, CLASSES = 40, 12  # Numbers of groups of the jackknife: of positions, and of brightnesses in a single image


@dataclass(frozen=True)
class NoiseEstimate:
    """Estimate of the noise of linear light with standard errors.

    Attributes
    ----------
    noise : NoiseModel
        The line. If the data do not determine both numbers, `message` states the assumption.
    slope_error, offset_error : float
        Standard errors of the slope and the offset; infinite if the data do not determine both.
    observable : bool
        Whether the standard deviation is known to 25 % throughout `ENDS`.
    message : str
        The noise in numbers, and the missing data.
    n : int
        Number of blocks (of one channel each) used.
    """

    noise: NoiseModel
    slope_error: float = np.inf
    offset_error: float = np.inf
    observable: bool = False
    message: str = ""
    n: int = 0


def noise_from_flat(
    images: np.ndarray | Sequence[np.ndarray], boxes: np.ndarray | None = None, response: Response = "srgb"
) -> NoiseEstimate:
    """Estimate noise from smooth surfaces: patches of a chart, or an evenly lit sheet, ideally out of focus.

    A second-degree polynomial is subtracted from each block of 8 by 8 pixels, so that the light may vary. The residual
    is noise, except in a few blocks with dust or an edge. A single brightness does not determine slope and offset: use
    patches of different brightness, or images of one sheet under different exposures.

    Parameters
    ----------
    images : sequence of (h, w, 3) uint8, uint16 or float, or one of them
        Stored values, all of one camera at one sensitivity (ISO).
    boxes : (n, 4) int, optional
        x0, y0, x1, y1 of each smooth region (x1 and y1 are excluded), the same in every image; the whole
        image by default.
    response : Response
        Map from stored values to linear light.

    Returns
    -------
    NoiseEstimate
        Its standard errors treat blocks, but not channels, as independent.

    Raises
    ------
    CameraError
        If a box lies outside its image, or too few blocks are neither dark nor saturated.
    ImageError
        If an array is not an image.
    """
    pictures = [images] if isinstance(images, np.ndarray) and images.ndim <= 3 else list(images)
    pictures = [as_colour(picture, f"image {number}") for number, picture in enumerate(pictures, 1)]
    regions = pictures if boxes is None else _regions(pictures, np.asarray(boxes))
    if not regions:
        raise CameraError("there is no image or no box to estimate the noise from: give at least one of each")
    parts = [_blocks(region, None, response) for region in regions]
    # A place is one of all regions.
    blocks, own = np.concatenate(parts), np.repeat(np.arange(len(parts)), [len(part) for part in parts])
    blocks["place"] += own * (blocks["place"].max(initial=0) + 1)
    return _estimate(blocks, response)


def noise_from_pair(first: np.ndarray, second: np.ndarray, response: Response = "srgb") -> NoiseEstimate:
    """Estimate noise from two images of one scene, with the same light, camera position and exposure.

    Half the variance of the difference of a block is the noise at the block's brightness, for any scene. A small
    flicker of the light is corrected, and the median is robust to blocks in which something moved.

    Parameters
    ----------
    first, second : (h, w, 3) uint8, uint16 or float
        Stored values of the same size.
    response : Response
        Map from stored values to linear light.

    Returns
    -------
    NoiseEstimate

    Raises
    ------
    CameraError
        If the images differ in size, are identical, or too few blocks are neither dark nor saturated.
    ImageError
        If an array is not an image.
    """
    first, second = as_colour(first, "first image"), as_colour(second, "second image")
    if first.shape != second.shape or first.dtype != second.dtype:
        raise CameraError(
            f"the pair's images are {_size(first)} and {_size(second)}: give two of the same size and depth, taken "
            "from the same position"
        )
    if np.array_equal(first, second, equal_nan=first.dtype.kind == "f"):
        raise CameraError("the pair's images are identical: give two that were taken one after the other")
    blocks = _blocks(first, second, response)
    estimate = _estimate(blocks, response)
    expected = estimate.noise.variance(blocks["level"]) + blocks["rounding"]
    moved = float(np.mean(_variance(blocks, TREND + 1) > 2.5 * expected))
    if not estimate.observable or moved <= MOVED:
        return estimate
    fault = f"; but {moved:.0%} of the blocks differ by more than that: use a tripod, a still scene and a steady light"
    return NoiseEstimate(estimate.noise, message=estimate.message + fault, n=estimate.n)


def noise_from_image(image: np.ndarray, response: Response = "srgb") -> NoiseEstimate:
    """Estimate noise from a single image.

    In each class of brightness, the coarse structure selects the tenth of the blocks with the least texture, and their
    fine structure gives the noise. After Ponomarenko, Lukin, Zriakhov, Kaarna and Astola, "An automatic approach to
    lossy compression of AVIRIS images" (IGARSS 2007), and Colom and Buades, "Analysis and extension of the Ponomarenko
    et al. method, estimating a noise curve from a single image" (IPOL 2013). Discrete polynomials replace the cosines,
    since they do not respond to smooth shading.

    Parameters
    ----------
    image : (h, w, 3) uint8, uint16 or float
        Stored values.
    response : Response
        Map from stored values to linear light.

    Returns
    -------
    NoiseEstimate
        Overestimated where the fine structure contains texture, and underestimated where JPEG smoothed the noise. The
        coarser and the finer structure then disagree, and the standard errors include the difference.

    Raises
    ------
    CameraError
        If too few blocks are neither dark nor saturated.
    ImageError
        If the array is not an image.
    """
    return _estimate(_blocks(as_colour(image), None, response), response, single=True)


# Brightness and variation of a block of one channel
_BLOCK = np.dtype(
    [
        ("level", float),  # mean linear light
        ("rounding", float),  # variance that the rounding of stored values adds to linear light
        ("energy", float, 2 * SIDE - 1),  # sum of squared polynomial coefficients of each degree
        ("place", int),  # index of the block in its image, the same for its three channels
        ("weight", float),  # at most 1
    ]
)


def _variance(blocks: np.ndarray, low: int, high: int = 2 * SIDE - 2) -> np.ndarray:
    """Variance (n,) from the coefficients of degrees low to high; its *median* is unbiased for white noise."""
    count = sum(min(d + 1, 2 * SIDE - 1 - d) for d in range(low, high + 1))
    median = (1.0 - 2.0 / (9.0 * count)) ** 3  # of chi squared over its degrees of freedom (Wilson, Hilferty 1931)
    return blocks["energy"][:, low : high + 1].sum(axis=1) / (count * median)


def _blocks(first: np.ndarray, second: np.ndarray | None, response: Response) -> np.ndarray:
    """Blocks of one image, or of the difference of two images of one scene, scaled to have the noise of one.

    Dark and saturated blocks are excluded; for a pair by the mean, which is independent of the difference.
    """
    stored, linear, usable = _values(first, response)
    signal, level = linear, stored.mean(axis=2, keepdims=True)
    if second is not None:
        other_stored, other_linear, other_finite = _values(second, response)
        level = stored = (stored + other_stored) / 2
        usable &= other_finite
    low, high = usable_range(response, first.dtype.str)
    usable &= ((level >= low) & (level <= high)).all(axis=2)
    if second is not None:
        before, after = (light.mean(axis=2)[usable] for light in (linear, other_linear))
        flicker = float(np.median(after / np.maximum(before, 1e-6))) if usable.any() else 1.0
        if abs(flicker - 1) > FLICKER:
            fault = f"the pair's images differ in brightness by {abs(flicker - 1):.0%}"
            raise CameraError(f"{fault}: take both with one exposure under one light")
        gain = np.sqrt(flicker)
        signal = (linear * gain - other_linear / gain) / np.sqrt(2)
        linear = (linear + other_linear) / 2
    positive = np.maximum(stored, 1e-4)
    step = 1.0 / np.iinfo(first.dtype).max if first.dtype.kind == "u" else 0.0
    rounding = np.square(step * log_slope(positive, response) * to_linear(positive, response)).mean(axis=2) / 12
    # Orthonormal polynomials on a block: columns x^i y^j, i slowest, orthonormalised.
    line, _ = np.linalg.qr(np.vander(np.linspace(-1, 1, SIDE), SIDE, increasing=True))
    degree = np.add.outer(np.arange(SIDE), np.arange(SIDE)).ravel()
    energy = np.square(signal @ np.kron(line, line)) @ (degree[:, None] == np.arange(2 * SIDE - 1)).astype(float)
    blocks = np.empty(usable.shape, _BLOCK)
    blocks["level"], blocks["rounding"], blocks["energy"] = linear.mean(axis=2), rounding, energy
    blocks["place"], blocks["weight"] = np.arange(len(stored))[:, None], 1.0
    return blocks[usable]


def _values(image: np.ndarray, response: Response) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Stored values and linear light of blocks (n, 3, SIDE^2) of an image, and which are finite throughout (n, 3).

    The blocks are disjoint, and if there are many, a subset that is spread evenly.
    """
    windows = np.lib.stride_tricks.sliding_window_view(image, (SIDE, SIDE), axis=(0, 1))
    every = SIDE * int(np.ceil(np.sqrt(windows.shape[0] * windows.shape[1] / (ENOUGH_BLOCKS * SIDE**2))))
    cut = windows[::every, ::every].reshape(-1, 3, SIDE**2)
    finite = np.asarray(np.isfinite(cut).all(axis=2))
    stored = np.clip(np.where(finite[..., None], stored_values(cut, np.float64), 0.0), -1.0, 4.0)
    return stored, np.asarray(to_linear(stored, response), dtype=np.float64), finite


def _regions(pictures: list[np.ndarray], boxes: np.ndarray) -> list[np.ndarray]:
    """Cut boxes (n, 4) out of images."""
    if boxes.ndim != 2 or boxes.shape[1] != 4 or boxes.dtype.kind not in "iu":
        raise CameraError(f"boxes of shape {boxes.shape} and type {boxes.dtype}: give integers, (n, 4)")
    for (number, picture), (x0, y0, x1, y1) in product(enumerate(pictures, 1), boxes):
        inside = min(x0, y0) >= 0 and x1 <= picture.shape[1] and y1 <= picture.shape[0]
        if not inside or min(x1 - x0, y1 - y0) < SIDE:
            raise CameraError(
                f"box {x0}, {y0}, {x1}, {y1}: give x0, y0, x1, y1 of at least {SIDE}×{SIDE} pixels inside image "
                f"{number}, which has {_size(picture)}"
            )
    return [picture[y0:y1, x0:x1] for picture in pictures for x0, y0, x1, y1 in boxes]


def _size(picture: np.ndarray) -> str:
    return f"{picture.shape[1]}×{picture.shape[0]} pixels of {picture.dtype}"


def _line(blocks: np.ndarray, low: int, high: int = 2 * SIDE - 2, start: np.ndarray | None = None) -> np.ndarray:
    """Fit slope and offset, (2,) float64, to the variance of blocks in the degrees low to high.

    Iteratively reweighted least squares minimise the sum of relative deviations, so up to half of the blocks may be
    outliers. Both numbers are non-negative, unless the fit continues from a start for standard errors.
    """
    variance = _variance(blocks, low, high)
    wanted = variance - blocks["rounding"]
    design = np.column_stack([blocks["level"], np.ones(len(blocks))])
    line = np.array([max(np.median(wanted / blocks["level"]), 0.0), 0.0]) if start is None else start
    least = max(1e-3 * float(np.median(variance)), 1e-16)
    for _ in range(40 if start is None else 12):
        expected = np.maximum(design @ line + blocks["rounding"], least)
        deviation = np.abs(wanted - design @ line) / expected
        weight = blocks["weight"] / (np.square(expected) * np.maximum(deviation, BEND))
        normal, right = (design.T * weight) @ design, (design.T * weight) @ wanted
        line = np.linalg.lstsq(normal, right, rcond=1e-12)[0]
        if start is None and line.min() < 0:
            kept = int(line[0] < 0)  # fit one number with the other at 0
            line = np.zeros(2)
            line[kept] = max(right[kept] / normal[kept, kept], 0.0)
    return line


def _estimate(blocks: np.ndarray, response: Response, single: bool = False) -> NoiseEstimate:
    """Fit the line to blocks, and test whether the noise is observable."""
    white = float(to_linear(np.array(1.0), response))
    noisy = _enough(blocks)[blocks["energy"][:, TREND + 1 :].sum(axis=1) > CONSTANT]
    if len(noisy) < FEWEST:
        return _below_rounding(blocks)
    low = FINE if single else TREND + 1
    if single:  # the blocks of the least texture in each class of brightness
        fraction = max(WEAKEST, min(1.0, FEWEST / len(noisy)))
        texture = noisy["energy"][:, TREND + 1 : COARSE].sum(axis=1)
        classes = np.array_split(np.argsort(noisy["level"]), int(np.clip(len(noisy) // BIN, 1, BINS)))
        best = [class_[np.argsort(texture[class_])[: int(np.ceil(fraction * len(class_)))]] for class_ in classes]
        noisy = noisy[np.concatenate(best)]
    used, line = _fitted(noisy, low, single)
    reach = 3 * np.sqrt(used["level"] * line[0] + line[1])
    used = _enough(used[(used["level"] > reach) & (used["level"] < white - reach)])  # clipping hides noise
    used, line = _fitted(used, low, single)
    steps = (used["level"] * line[0] + line[1]) / np.maximum(12 * used["rounding"], 1e-300)
    if np.median(steps) < ROUNDED**2:
        return _below_rounding(used)
    coarse = _variance(used, COARSE, FINE - 1) if single else _variance(used, low, COARSE - 1)
    ratio, not_white = float(np.median(coarse) / max(np.median(_variance(used, FINE)), 1e-300)), ""
    if ratio >= COLOURED:
        cause = "it contains texture, or JPEG or demosaicking" if single else "JPEG or demosaicking"
        not_white = f"; it is {np.sqrt(ratio):.1f} times as strong in coarse as in fine structure: {cause} smoothed it"
    darkest, brightest = np.percentile(used["level"], [5, 95])
    if brightest < NARROW * darkest:  # all noise is attributed to photons, which dominate at ordinary exposures
        slope = float(np.median((_variance(used, low) - used["rounding"]) / used["level"]))
        model = NoiseModel(max(slope, 0.0), 0.0)
        message = (
            f"{_deviations(model, [float(np.median(used['level']))])}; one brightness does not separate photon "
            f"noise from noise in the dark, so photon noise is assumed: add darker or brighter surfaces{not_white}"
        )
        return NoiseEstimate(model, message=message, n=len(used))
    spread = _spread(used, low, line, single)
    ends = np.column_stack([white * np.array(ENDS), np.ones(2)])
    vague = (np.sqrt(np.einsum("ij,jk,ik->i", ends, spread, ends)) > 2 * VAGUE * (ends @ line)).any()
    model, (slope_error, offset_error) = NoiseModel(*line.tolist()), np.sqrt(np.diag(spread)).tolist()
    message = _deviations(model, [white * rho for rho in (ENDS[0], 0.2, ENDS[1])])
    if vague:
        message += (
            f"; this is uncertain, from {len(used)} blocks with brightnesses of {darkest:.2g} to {brightest:.2g}: give "
            "more, darker or brighter surfaces"
        )
    return NoiseEstimate(model, slope_error, offset_error, not vague, message + not_white, len(used))


def _fitted(blocks: np.ndarray, low: int, single: bool) -> tuple[np.ndarray, np.ndarray]:
    """Blocks and their line. In a single image, blocks whose texture exceeds the noise get less weight."""
    line, blocks = _line(blocks, low), blocks.copy()
    for _ in range(3 * single):
        noise = np.maximum(blocks["level"] * line[0] + line[1] + blocks["rounding"], CONSTANT)
        texture = np.maximum(_variance(blocks, TREND + 1, COARSE - 1), CONSTANT)
        blocks["weight"] = np.square(np.minimum(1.0, noise / texture))
        line = _line(blocks, low)
    return blocks, line


def _enough(blocks: np.ndarray) -> np.ndarray:
    if len(blocks) >= FEWEST:
        return blocks
    raise CameraError(
        f"only {len(blocks)} blocks of {SIDE}×{SIDE} pixels, counted per channel, are usable (not dark, saturated, "
        f"non-finite or clipped by noise), and {FEWEST} are needed: give larger regions or a better exposed image"
    )


def _below_rounding(blocks: np.ndarray) -> NoiseEstimate:
    """Report that rounding hides the noise, with the largest noise that it can hide."""
    hidden = ROUNDED**2 * 12 * float(np.median(blocks["rounding"]))
    message = (
        "there is no noise beyond the rounding of stored values: its standard deviation is at most about "
        f"{np.sqrt(hidden):.2g}, or JPEG smoothed it; give images of 16 bits, or RAW files"
        if hidden > 0
        else "there is no noise: this image was computed, not taken; give images from a camera"
    )
    return NoiseEstimate(NoiseModel(0.0, hidden), message=message, n=len(blocks))


def _spread(blocks: np.ndarray, low: int, line: np.ndarray, single: bool) -> np.ndarray:
    """Covariance (2, 2) of slope and offset.

    The channels of a block are left out together. For a single image so are blocks of similar brightness, which share
    texture, and a significant difference between coarser and finer structure is added. On simulated portraits, 95 %
    intervals contain the true offset in 85 to 100 % of cases, without these two terms in 54 to 60 %.
    """

    def again(part: np.ndarray) -> np.ndarray:
        return _line(part, low, start=line)

    def disagreement(part: np.ndarray) -> np.ndarray:
        return again(part) - _line(part, COARSE, FINE - 1, start=line)

    def without(groups: np.ndarray, estimate: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
        return jackknife(np.array([estimate(blocks[groups != number]) for number in np.unique(groups)]))

    chance = without(np.unique(blocks["place"], return_inverse=True)[1] % GROUPS, again)
    if not single:
        return chance
    alike = np.argsort(np.argsort(blocks["level"])) * CLASSES // len(blocks)
    excess = np.square(disagreement(blocks)) - np.diag(without(alike, disagreement))
    return chance + without(alike, again) + np.diag(np.maximum(excess, 0.0))


def _deviations(model: NoiseModel, levels: list[float]) -> str:
    """Describe the standard deviations at some brightnesses."""
    parts = [f"{np.sqrt(model.variance(np.array(level))):.2g} at brightness {level:.2g}" for level in levels]
    return f"noise with a standard deviation of {', '.join(parts)}"
