"""Estimate the angle from one image with shadows, by minimising the entropy of the projected colours.

Finlayson, Drew and Lu, "Intrinsic images by entropy minimization" (ECCV 2004) and "Entropy minimization for shadow
removal" (IJCV 2009): along L(theta) each surface has one value, lit or shadowed, so the distribution of values has
peaks. Along other directions shadows blur it. Shannon's entropy is computed from a histogram, Renyi's quadratic entropy
from a kernel density.

Unlike in the papers, all angles have one bin width, since with Scott's rule per angle the entropy does not depend on
the spread, and the width is a quarter of Scott's, which is optimal for one Gaussian and not for peaks. On simulated
scenes nine tenths of the angles are then correct, otherwise one third to three quarters.
"""

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from liaam.calibration.estimate import PHYSICAL, AngleEstimate, axis_difference
from liaam.error_measures import root_mean_square
from liaam.errors import CameraError
from liaam.photometry.encoding import as_colour, encode, refuse_grey
from liaam.photometry.invariant import CHROMATICITY, invariant_row, temperature_direction
from liaam.photometry.response import Response

Entropy = Literal["quadratic", "shannon"]
"""Renyi's quadratic entropy of a kernel density; Shannon's of a histogram."""

THETAS = np.deg2rad(np.arange(180.0))  # Angles of a curve, radians
SOME_THETAS = THETAS[::15]  # Some of them, over which the spread of the colours is averaged
KEPT = 0.98  # Central fraction of the projected values that is used; the papers use 0.9
FINENESS = 0.25  # Width of a bin, and twice the kernel's standard deviation, in units of Scott's width
SMOOTHING = 2.0  # Standard deviation, in pixels, of the blur of log-RGB, since noise and JPEG blocks blur the peaks
MOST_PIXELS = 310_000  # Largest number of pixels; larger images are averaged in blocks, in linear light
FEWEST_PIXELS = 1000  # Least number of well-exposed pixels
FEWEST_VALUES = 100  # Least number of pixels for a curve
LEAST_COLOUR = 1e-3  # Standard deviation of log-chromaticity below which an image has one colour only
SCOTT = 3.5  # Scott's width of a bin, in standard deviations of n values and multiplied by n^(1/3)
SUBDIVISION = 2  # Cells of a histogram per bin; Shannon's entropy is averaged over as many origins of the bins
WIDEST_HISTOGRAM = 6000  # Largest number of cells of a histogram, in case of distant outliers
# Half the width of a histogram, in units of the distance from the median that one in a thousand values exceeds
REACH = 1.5
BLOCKS = 8  # Number of blocks along each axis of the image, which the bootstrap draws
REPLICATES = 40  # Number of bootstrap replicates
COARSER = 2  # Step, in angles of a curve, of the bootstrap's curves, for speed; a parabola refines their minima
# Error that the bootstrap does not include, radians: broad sensors and coloured surfaces
MODEL_ERROR = float(np.deg2rad(1.0))
NEAR = float(np.deg2rad(10.0))  # Distance up to which angles belong to one minimum, radians
# Limit of the spread over bootstrap replicates, and of the difference between the two entropies, radians
WIDEST_SPREAD = float(np.deg2rad(5.0))
LEAST_MARGIN = 0.1  # Least difference to the next minimum, bits
# Least change of log(R / B) at one value of the invariant that distinguishes light from noise and texture
LEAST_CHANGE = 0.15
# Least correlation of redness and brightness, at one value of the invariant, that indicates a change of light.
# Colours aligned by chance have none, and pigments, as warm shadows, a negative one
LEAST_BLUER = 0.2
# Ratio of the spread across and along the main direction of all colours, below which they lie on a line, as those of
# skin and wood
LINE = 0.4


def theta_from_image(image: np.ndarray, response: Response = "srgb") -> AngleEstimate:
    """Estimate the angle from one image with shadows, and test whether it is reliable.

    There is always a minimum. It is accepted if the angle is that of a camera (90 to 135 degrees), the two entropies
    agree, the bootstrap over image blocks finds it stable, other minima are clearly higher, the colours do not lie on a
    line, and darker pixels of a surface are bluer, as in shadows. On simulated scenes, 97 % of the accepted angles are
    correct to 5 degrees; half of the posters with bluish shadows are accepted, and no portraits.

    Parameters
    ----------
    image : (h, w, 3) uint8, uint16 or float
        Stored values; dark and saturated pixels are ignored.
    response : Response
        Map from stored values to linear light.

    Returns
    -------
    AngleEstimate
        The angle of the least quadratic entropy; not observable if the minimum fails a test.

    Raises
    ------
    CameraError
        If the image is grey, has one colour only, or too few pixels are well exposed.
    ImageError
        If the array is not an image.
    """
    image = as_colour(image)
    refuse_grey(image, "image", "an angle needs colour", CameraError)
    reduce = int(np.ceil(np.sqrt(image.shape[0] * image.shape[1] / MOST_PIXELS)))
    encoded = encode(image, "log", response, blur=SMOOTHING, reduce=max(reduce, 1))
    usable = encoded[..., 3] > 0
    if usable.sum() < FEWEST_PIXELS:
        raise CameraError(
            f"only {usable.sum()} of the image's {usable.size} pixels are well exposed, {FEWEST_PIXELS} are needed: "
            "give one that is neither dark nor overexposed (stored values of 8 to 250 of 255 in every channel)"
        )
    log_rgb = encoded[..., :3][usable]
    histograms, width = _histograms(log_rgb, _block_numbers(*usable.shape)[usable], KEPT)
    whole = [counts.sum(axis=0, keepdims=True) for counts in histograms]
    entropies = _curve("quadratic", whole)[0]
    theta = _lowest(THETAS, entropies)
    margin = _margin(entropies, theta)
    disagreement = abs(axis_difference(_lowest(THETAS, _curve("shannon", whole)[0]), theta))
    spread = _bootstrap_spread(histograms, theta)
    colours = _colour_variation(log_rgb, theta, width)
    tests = (
        (not PHYSICAL[0] <= theta <= PHYSICAL[1], "the angle is outside the range of cameras (90° to 135°)"),
        (disagreement > WIDEST_SPREAD, f"the other entropy differs by {np.rad2deg(disagreement):.0f}°"),
        (spread > WIDEST_SPREAD, f"parts of the image differ by {np.rad2deg(spread):.0f}°"),
        (margin < LEAST_MARGIN, f"another minimum is only {margin:.2f} bits higher"),
        (colours.aspect < LINE, "the image's colours lie on a line, as those of skin, with or without shadows"),
        (colours.change < LEAST_CHANGE, "the colour of the light does not vary in the image"),
        (colours.redness < LEAST_BLUER, "the darker pixels of a surface are not bluer, as shadows are"),
    )
    error = float(np.hypot(spread, MODEL_ERROR))
    message = (
        f"the next minimum of the entropy is {margin:.2f} bits higher; the light on surfaces varies by "
        f"{colours.change:.2f} in log R/B, bluer where they are darker (correlation {colours.redness:.2f})"
    )
    faults = [fault for has_failed, fault in tests if has_failed]
    if faults:
        error = float("inf")
        message = (
            f"the entropy is least at {np.rad2deg(theta):.0f}°, which is not reliable: {'; '.join(faults)}. Give "
            "an image of many colours with cast shadows, or better two images under different lights"
        )
    return AngleEstimate(theta, error, message, colours.change, len(log_rgb))


def entropy_curve(
    log_rgb: np.ndarray, kind: Entropy = "quadratic", *, keep: float = KEPT
) -> tuple[np.ndarray, np.ndarray]:
    """Compute the entropy of log-chromaticities projected onto the unit vector along L(theta), for all angles.

    Parameters
    ----------
    log_rgb : (n, 3) float
        Logarithms of linear light, finite.
    kind : {"quadratic", "shannon"}
    keep : float
        Central fraction of the projected values to use, 0.5 to 1.

    Returns
    -------
    thetas, entropies : (180,) float64
        Angles, radians in [0, pi), and entropies, bits, up to a constant.

    Raises
    ------
    CameraError
        If there are fewer than 100 values, some are not finite, or they have one colour only.
    """
    if kind not in get_args(Entropy):
        raise CameraError(f"entropy {kind!r} is unknown: give one of {', '.join(get_args(Entropy))}")
    log_rgb = np.asarray(log_rgb, dtype=np.float32).reshape(-1, 3)
    one_block = np.zeros(len(log_rgb), dtype=np.int64)
    histograms, _ = _histograms(log_rgb, one_block, keep)
    return THETAS.copy(), _curve(kind, histograms)[0]


def _block_numbers(height: int, width: int) -> np.ndarray:
    """Number of the bootstrap's block at each pixel of an image, (height, width) int64."""
    rows = np.arange(height) * BLOCKS // height
    columns = np.arange(width) * BLOCKS // width
    return rows[:, None] * BLOCKS + columns


def _histograms(log_rgb: np.ndarray, blocks: np.ndarray, keep: float) -> tuple[list[np.ndarray], float]:
    """Histograms of log-RGB (n, 3) float32, of blocks (n,) int64, projected along L(theta), for each of the angles.

    Only the central fraction ``keep`` of the values is counted.

    Returns
    -------
    histograms : list of (blocks, cells) float32
        Counts for each of :data:`THETAS`.
    width : float
        Width of a bin by Scott's rule, for the median spread over directions.
    """
    if len(log_rgb) < FEWEST_VALUES or not np.isfinite(log_rgb).all():
        raise CameraError(f"entropy needs {FEWEST_VALUES} or more pixels, all finite; there are {len(log_rgb)}")
    if not 0.5 <= keep <= 1:
        raise CameraError(f"keep is {keep}: give the fraction of values to use, 0.5 to 1")
    chroma = log_rgb @ CHROMATICITY.T.astype(np.float32)
    chroma -= np.median(chroma, axis=0)
    spread = float(np.median([np.std(chroma @ _direction(theta)) for theta in SOME_THETAS]))
    if spread < LEAST_COLOUR:
        raise CameraError(
            "the image has one colour only: an angle needs surfaces of several colours, in light and shadow"
        )
    scott = SCOTT * spread * len(chroma) ** (-1 / 3)
    reach = REACH * float(np.quantile(np.abs(chroma).max(axis=1), 0.999))
    cell_width = max(FINENESS * scott / SUBDIVISION, 2 * reach / WIDEST_HISTOGRAM)
    n_cells = int(2 * reach / cell_width) + 2
    n_blocks = int(blocks.max()) + 1

    def along(theta: float) -> np.ndarray:
        """Histogram along L(theta), of the cells that hold the central fraction of the values."""
        position = (chroma @ _direction(theta)) / cell_width + 0.5 * n_cells
        cells = np.clip(position, 0, n_cells - 1).astype(np.int64)  # outliers fall into the outermost
        counts = np.bincount(cells + blocks * n_cells, minlength=n_blocks * n_cells).reshape(n_blocks, n_cells)
        share = np.cumsum(counts.sum(axis=0)) / len(chroma)
        # Less by 1e-9, so that no rounding error includes a further cell.
        first, last = np.searchsorted(share, [0.5 - 0.5 * keep, 0.5 + 0.5 * keep - 1e-9])
        return counts[:, first : last + 1].astype(np.float32)

    return [along(theta) for theta in THETAS], scott


def _direction(theta: float) -> np.ndarray:
    """Unit vector (2,) float32 along L(theta) in the coordinates of the chromaticity plane."""
    along = CHROMATICITY @ invariant_row(theta)[0]
    return (along / np.linalg.norm(along)).astype(np.float32)


def _curve(kind: str, histograms: list[np.ndarray]) -> np.ndarray:
    """Entropies (b, k) float64, bits, of k histograms of counts, each (b, cells), whose numbers of cells may differ."""
    entropy = _quadratic if kind == "quadratic" else _shannon
    columns = [entropy(counts / counts.sum(axis=1, keepdims=True)) for counts in histograms]
    return np.stack(columns, axis=1).astype(np.float64)


def _bootstrap_spread(histograms: list[np.ndarray], theta: float) -> float:
    """Root mean square difference from theta, radians, of the angles of images made of blocks that are drawn."""
    n_blocks = len(histograms[0])
    rng = np.random.default_rng(0)
    times_drawn = rng.multinomial(n_blocks, np.full(n_blocks, 1 / n_blocks), size=REPLICATES).astype(np.float32)
    curves = _curve("quadratic", [times_drawn @ counts for counts in histograms[::COARSER]])
    return root_mean_square([axis_difference(_lowest(THETAS[::COARSER], curve), theta) for curve in curves])


def _shannon(fractions: np.ndarray) -> np.ndarray:
    """Shannon's entropy (b,), bits, of normalised histograms (b, cells), averaged over the bins' origins."""
    from scipy.special import entr  # heavy: imported when first needed

    total = np.zeros(len(fractions))
    for origin in range(SUBDIVISION):
        to_whole_bin = -(fractions.shape[1] + origin) % SUBDIVISION
        padded = np.pad(fractions, ((0, 0), (origin, to_whole_bin)))
        bins = padded.reshape(len(fractions), -1, SUBDIVISION).sum(axis=2)
        total += entr(bins).sum(axis=1)
    return total / (SUBDIVISION * np.log(2.0))


def _quadratic(fractions: np.ndarray) -> np.ndarray:
    """Renyi's quadratic entropy (b,), bits, of normalised histograms (b, cells).

    It is -log of the information potential sum_ij G(x_i - x_j; 2 s^2) / n^2: the blurred histogram is the inner sum in
    units of a cell, and there are SUBDIVISION cells in a bin.
    """
    from scipy.ndimage import gaussian_filter1d  # heavy: imported when first needed

    # The kernel of pairs is sqrt(2) times as wide as that of the density, whose standard deviation is half a bin.
    around = gaussian_filter1d(fractions, np.sqrt(2.0) * 0.5 * SUBDIVISION, axis=1, mode="constant")
    return -np.log2((around * fractions).sum(axis=1) * SUBDIVISION)


def _lowest(thetas: np.ndarray, entropies: np.ndarray) -> float:
    """Angle of least entropy, radians in [0, pi), refined by a parabola through its neighbours."""
    i = int(entropies.argmin())
    here = entropies[i]
    before = entropies[i - 1]  # angles repeat after pi, so that the first follows the last
    after = entropies[(i + 1) % len(entropies)]
    bend = before - 2 * here + after
    shift = 0.5 * (before - after) / bend if bend > 0 else 0.0  # in steps of thetas
    return float((thetas[i] + shift * (thetas[1] - thetas[0])) % np.pi)


def _margin(entropies: np.ndarray, theta: float) -> float:
    """Difference of the lowest minimum, at theta, to the next one, bits; the range of the curve if there is none."""
    far = np.abs([axis_difference(angle, theta) for angle in THETAS]) > NEAR
    minima = far & (entropies <= np.roll(entropies, 1)) & (entropies <= np.roll(entropies, -1))
    others = entropies[minima] if minima.any() else entropies.max()
    return float(np.min(others) - entropies.min())


@dataclass(frozen=True)
class _ColourVariation:
    """How colours vary: those of pixels with the same invariant, so by light, and all.

    Attributes
    ----------
    change : float
        Root mean square difference of two pixels with the same invariant along the temperature direction, as
        log(R / B).
    redness : float
        Correlation of redness and brightness of pixels with the same invariant.
    aspect : float
        Ratio of the spread of all colours across and along their main direction.
    """

    change: float
    redness: float
    aspect: float


def _colour_variation(log_rgb: np.ndarray, theta: float, width: float) -> _ColourVariation:
    """Measure the variation of log-RGB (n, 3) float32; values of the invariant within a width count as one."""
    towards_blue = temperature_direction(theta)
    chroma = log_rgb @ CHROMATICITY.T.astype(np.float32)
    variances = np.linalg.eigvalsh(np.cov(chroma, rowvar=False))  # the smaller first
    across, along = np.sqrt(np.maximum(variances, 0.0))
    invariant = chroma @ _direction(theta)
    low, high = np.quantile(invariant, [0.01, 0.99])  # outliers would be alone in their bins
    inside = (invariant >= low) & (invariant <= high)
    bins = ((invariant[inside] - low) / width).astype(np.int64)
    count = np.maximum(np.bincount(bins), 1)

    def about_mean(values: np.ndarray) -> np.ndarray:
        """Subtract the mean of each bin from values (n,) of the pixels inside."""
        return values - (np.bincount(bins, weights=values) / count)[bins]

    blueness = about_mean((log_rgb @ towards_blue.astype(np.float32))[inside])
    brightness = about_mean(log_rgb.mean(axis=1)[inside])
    blueness_variance = float(np.square(blueness).mean())
    brightness_variance = float(np.square(brightness).mean())
    # The difference of two values has twice their variance.
    change = float(np.sqrt(2.0 * blueness_variance) * abs(towards_blue[0] - towards_blue[2]))
    both = np.sqrt(blueness_variance * brightness_variance)
    redness = float(-(blueness * brightness).mean() / max(both, 1e-12))
    return _ColourVariation(change, redness, float(across / along))
