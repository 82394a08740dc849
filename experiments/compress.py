"""Images kept as shape, appearance and light (paper section 1), beside JPEG and WebP at equal numbers of bytes.

A generic model is fitted to images of unseen objects under several lights. Kept are the landmarks (pose and shape
modes), the coordinates of the appearance under the training light, and those of the light. They are rounded, and coded
by an arithmetic coder whose probabilities are the model's variances, so that modes with little variance cost almost
nothing. A residual image, stored as WebP, may follow. All bytes of an image count; the model is shared and does not.

Quality is measured inside the mesh only: PSNR over all channels, and SSIM of luma. JPEG and WebP keep the
mesh's bounding box, at its size, at half or at a quarter of it. Outside the mesh the box is filled smoothly, which
costs few bytes. JPEG's tables and WebP's container could be shared as well, and are not counted.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from experiments.charts import Panel, figure_of_curves
from experiments.generic import GenericRequest, HeldOut, get_folds, get_trained, request_of_folders
from experiments.measures import or_dash
from experiments.protocol import Header, Table, eight_bit, tell
from experiments.runner import Experiment, Row
from liaam.errors import LiaamError
from liaam.evaluation import finite_or_none
from liaam.model import AAM
from liaam.model.shape import Similarity, align
from liaam.photometry.response import from_linear, log_slope
from liaam.relighting.basis import light_on_frame
from liaam.relighting.painting import box_around, eight_bits, paint
from liaam.training.textures import sample_appearance

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TOTAL = 1 << 16
"""Sum of the frequencies of each symbol's table."""

POSE_STEP, SHAPE_STEP = 1 / 16, 1.0
"""Steps of the pose (image pixels) and of the shape modes' coordinates (reference pixels): the landmarks move by about
a tenth of a pixel."""

STEPS = (0.5, 1.0, 2.0, 4.0, 8.0)
"""Steps of the appearance's coordinates, which trade quality for bytes; modes are of unit length."""

UNDER_RESIDUAL = 1.0
"""The step used below a residual."""

LIGHT_STEP = 0.1
"""Step of the light's coordinates for a step of 1 of the appearance's; they have unit variance."""

NOISE = 0.1
"""Standard deviation of the model's errors in log light, the weight of the prior when coordinates are estimated."""

QUALITIES = (0, 5, 10, 20, 30, 45, 60, 75, 90)
SCALES = (1, 2, 4)
BUDGETS = (32, 48, 64, 96, 128, 192, 256, 384, 512, 1024, 2048)
JPEG_SCAN, WEBP_CONTAINER = 14, 20
"""Bytes of the header of JPEG's scan, which follows the tables, and of WebP's container before the frame."""

CODECS = ("liaam", "liaam + residual", "jpeg", "webp")
MEASURES = {"psnr": ".1f", "ssim": ".3f"}


def frequencies(deviation: float, step: float) -> np.ndarray:
    """Cumulative frequencies of rounded values of N(0, deviation^2), symmetric about 0, (2 k + 2,) int."""
    from scipy.special import ndtr

    k = min(int(np.ceil(6.0 * deviation / step)), TOTAL // 8)
    edges = ndtr((np.arange(-k, k + 2) - 0.5) * step / deviation)
    edges[0], edges[-1] = 0.0, 1.0
    return np.rint(edges * (TOTAL - 2 * k - 1)).astype(int) + np.arange(2 * k + 2)


UNIFORM = np.arange(TOTAL + 1)
"""Cumulative frequencies of equally probable symbols."""


def encode_symbols(symbols: Sequence[int], tables: Sequence[np.ndarray]) -> bytes:
    """Code symbols by their cumulative frequencies: arithmetic coding with exact integers."""
    low, width, bits = 0, 1, 0
    for symbol, table in zip(symbols, tables, strict=True):
        first, last = int(table[symbol]), int(table[symbol + 1])
        low, width, bits = low * TOTAL + width * first, width * (last - first), bits + 16
    for n_bytes in range(bits // 8 + 1):  # the shortest fraction in [low, low + width) / 2^bits
        shift = bits - 8 * n_bytes
        value = -(-low >> shift)
        if value << shift < low + width:
            break
    return value.to_bytes(n_bytes, "big")


def decode_symbols(code: bytes, tables: Sequence[np.ndarray]) -> list[int]:
    """Decode what :func:`encode_symbols` has coded."""
    bits = 16 * len(tables)
    value = int.from_bytes(code, "big") << (bits - 8 * len(code))
    low, width, symbols = 0, 1, []
    for table in tables:
        bits -= 16
        at = ((value >> bits) - low * TOTAL) // width
        symbols.append(int(np.searchsorted(table, at, side="right")) - 1)
        first, last = int(table[symbols[-1]]), int(table[symbols[-1] + 1])
        low, width = low * TOTAL + width * first, width * (last - first)
    return symbols


@dataclass(frozen=True, eq=False)
class Codec:
    """Coder of a fitted object: coordinates of pose, shape, appearance and light, in this order, as bytes.

    Attributes
    ----------
    model : AAM
    step : float
        One of :data:`STEPS`.
    """

    model: AAM
    step: float

    @cached_property
    def lit(self) -> np.ndarray:
        """Modes of the model's light, (k, n_pixels, 3); k is 0 without lamps."""
        modes = light_on_frame(self.model)
        return modes if self.model.light is not None else modes[:0]

    @cached_property
    def variances(self) -> tuple[np.ndarray, ...]:
        """Variances of the coordinates of shape, appearance and light."""
        return (
            self.model.shape_model.eigenvalues,
            self.model.levels[-1].appearances["log"].eigenvalues,
            np.ones(len(self.lit)),
        )

    @cached_property
    def steps(self) -> np.ndarray:
        """Steps of all coordinates, (n,)."""
        sizes = SHAPE_STEP, self.step, LIGHT_STEP * self.step
        return np.concatenate([np.full(4, POSE_STEP), *map(np.full, map(len, self.variances), sizes)])

    @cached_property
    def tables(self) -> list[np.ndarray]:
        """Cumulative frequencies of all coordinates."""
        deviations = np.sqrt(np.maximum(np.concatenate(self.variances), 1e-12))
        return [UNIFORM] * 4 + [frequencies(*each) for each in zip(deviations, self.steps[4:], strict=True)]

    def encode(self, coordinates: np.ndarray) -> bytes:
        """Round coordinates (n,) and code them; those beyond six standard deviations are clipped."""
        middles = np.array([len(table) // 2 - 1 for table in self.tables])
        rounded = np.rint(coordinates / self.steps).astype(int)
        return encode_symbols((middles + np.clip(rounded, -middles, middles)).tolist(), self.tables)

    def decode(self, code: bytes) -> np.ndarray:
        """Return the rounded coordinates, (n,) float64."""
        middles = np.array([len(table) // 2 - 1 for table in self.tables])
        return (np.array(decode_symbols(code, self.tables)) - middles) * self.steps

    def coordinates_of_shape(self, shape: np.ndarray) -> np.ndarray:
        """Return the coordinates of pose and shape modes of landmarks (n_points, 2)."""
        pose = align(self.model.shape_model.mean, shape)
        own = self.model.shape_model.parameters(pose.inverse()(shape))[:-4]
        return np.concatenate([pose.matrix[:, 0] * self.model.diagonal / 2, pose.offset, own])

    def shape_of(self, coordinates: np.ndarray) -> np.ndarray:
        """Return the landmarks (n_points, 2) of coordinates."""
        (a, b), offset = coordinates[:2] / (self.model.diagonal / 2), coordinates[2:4]
        own = np.append(coordinates[4 : 4 + len(self.variances[0])], np.zeros(4))
        return Similarity(np.array([[a, -b], [b, a]]), offset)(self.model.shape_model.shape(own))

    def coordinates_of_light(self, image: np.ndarray, shape: np.ndarray) -> np.ndarray:
        """Estimate the coordinates of appearance and light that reproduce an image, by least squares.

        The residuals of log light are weighted so that they count as differences of stored values.
        """
        known, blur = self.model.levels[-1].appearances["log"], self.model.levels[-1].blur
        log, usable = sample_appearance(image, shape, self.model.warp, "log", self.model.response, blur)
        slopes = usable[:, None] / log_slope(from_linear(np.exp(log), self.model.response), self.model.response)
        weights = np.square(slopes / max(float(slopes.max()), 1e-12)).ravel()
        modes = np.concatenate([known.modes, self.lit]).reshape(-1, log.size).astype(np.float64)
        weighted = modes * weights
        prior = NOISE**2 / np.maximum(np.concatenate(self.variances[1:]), 1e-12)
        return np.linalg.solve(weighted @ modes.T + np.diag(prior), weighted @ (log - known.mean).ravel())

    def picture(self, image: np.ndarray, coordinates: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Paint an object at its place in an image, whose size alone is used: (h, w, 3) uint8, and (h, w) bool."""
        _, appearance, light = np.split(coordinates[4:], np.cumsum([len(each) for each in self.variances[:2]]))
        lit = np.tensordot(light, self.lit, axes=1)
        log_rgb = self.model.levels[-1].appearances["log"].texture(appearance) + lit
        painted, inside = paint(image, self.shape_of(coordinates), self.model, log_rgb.astype(np.float32))
        return eight_bits(painted, self.model.response), inside


@dataclass(frozen=True)
class Kept:
    """A codec's picture: number of bytes, and quality inside the mesh."""

    codec: str
    n_bytes: int
    psnr: float
    ssim: float


@dataclass(frozen=True, eq=False)
class Target:
    """The crop of an image (h, w, 3) uint8 that is kept, and the mesh in it, (h, w) bool."""

    crop: np.ndarray
    inside: np.ndarray

    def kept(self, codec: str, n_bytes: int, picture: np.ndarray) -> Kept:
        """Measure a picture (h, w, 3) uint8; outside the mesh it counts as right."""
        picture = np.where(self.inside[..., None], picture, self.crop)
        difference = (picture.astype(float) - self.crop)[self.inside]
        psnr = 10 * np.log10(255**2 / max(float(np.square(difference).mean()), 1e-3))
        return Kept(codec, n_bytes, psnr, float(ssim_map(self.crop, picture)[self.inside].mean()))


def ssim_map(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Structural similarity of the luma of two images, (h, w) float (Wang et al., 2004)."""
    import cv2

    x, y = (cv2.cvtColor(image, cv2.COLOR_RGB2GRAY).astype(np.float64) for image in (one, other))

    def blurred(image: np.ndarray) -> np.ndarray:
        return cv2.GaussianBlur(image, (11, 11), 1.5)

    mx, my = blurred(x), blurred(y)
    vx, vy, vxy = blurred(x * x) - mx * mx, blurred(y * y) - my * my, blurred(x * y) - mx * my
    a, b = (0.01 * 255) ** 2, (0.03 * 255) ** 2
    return (2 * mx * my + a) * (2 * vxy + b) / ((mx * mx + my * my + a) * (vx + vy + b))


def stored(image: np.ndarray, codec: str, quality: int) -> tuple[int, np.ndarray]:
    """Code an image (h, w, 3) uint8 as JPEG or WebP; return the counted bytes and the decoded image."""
    import cv2

    option = cv2.IMWRITE_JPEG_QUALITY if codec == "jpeg" else cv2.IMWRITE_WEBP_QUALITY
    worked, code = cv2.imencode(f".{codec}", image[..., ::-1], [option, max(quality, 1)])
    decoded = cv2.imdecode(code, cv2.IMREAD_COLOR) if worked else None
    if decoded is None:
        raise LiaamError(f"this build of OpenCV cannot write {codec}; install opencv-python-headless")
    shared = bytes(code).index(b"\xff\xda") + JPEG_SCAN if codec == "jpeg" else WEBP_CONTAINER
    return len(code) - shared, decoded[..., ::-1]


def at_all_sizes(image: np.ndarray, codec: str) -> Iterator[tuple[int, np.ndarray]]:
    """Code an image (h, w, 3) uint8 at all scales and qualities; yield the bytes and the decoded image."""
    import cv2

    height, width = image.shape[:2]
    for scale in SCALES:
        small = cv2.resize(image, (-(-width // scale), -(-height // scale)), interpolation=cv2.INTER_AREA)
        for quality in QUALITIES:
            n_bytes, decoded = stored(small, codec, quality)
            yield n_bytes, cv2.resize(decoded, (width, height), interpolation=cv2.INTER_CUBIC)


def of_rivals(target: Target) -> Iterator[Kept]:
    """Keep a crop as JPEG and WebP."""
    import cv2

    filled = cv2.inpaint(target.crop, (~target.inside).astype(np.uint8), 3, cv2.INPAINT_TELEA)
    for codec in ("jpeg", "webp"):
        for n_bytes, picture in at_all_sizes(filled, codec):
            yield target.kept(codec, n_bytes, picture)


def with_residual(target: Target, picture: np.ndarray, n_bytes: int) -> Iterator[Kept]:
    """Keep a crop as the model's picture of n bytes and a residual."""
    residual = np.where(target.inside[..., None], target.crop.astype(int) - picture, 0)
    for more, decoded in at_all_sizes(np.clip(residual + 128, 0, 255).astype(np.uint8), "webp"):
        made = np.clip(picture + (decoded.astype(int) - 128), 0, 255).astype(np.uint8)
        yield target.kept("liaam + residual", n_bytes + more, made)


def keep_object(request: GenericRequest, task: HeldOut) -> list[Row]:
    """Keep all images of one object with every codec; one row for each codec and budget."""
    trained, rows = get_trained(request, task.fold), []
    codecs = [Codec(trained.model, step) for step in STEPS]
    for shown in get_folds(request)[0][task.fold].tested[task.name]:
        image = eight_bit(shown.sample)
        result = trained.fitters["soft-li"].fit(image)
        kept = list(keep(codecs, image, result.landmarks))
        labels = {"object": task.name, "light": shown.light, "status": str(result.status)}
        for codec in CODECS:
            for budget in BUDGETS:
                affordable = [each for each in kept if each.codec == codec and each.n_bytes <= budget]
                best = max(affordable, key=lambda each: each.psnr, default=Kept(codec, 0, -np.inf, -np.inf))
                values = {"bytes": best.n_bytes, "psnr": best.psnr, "ssim": best.ssim}
                rows.append({"codec": codec, **labels, "budget": budget, **values})
    return rows


def keep(codecs: Sequence[Codec], image: np.ndarray, shape: np.ndarray) -> Iterator[Kept]:
    """Keep an image (h, w, 3) uint8 with fitted landmarks (n, 2) by all codecs."""
    own = codecs[0].coordinates_of_shape(shape)
    places = codecs[0].decode(codecs[0].encode(np.concatenate([own, np.zeros(len(codecs[0].steps) - len(own))])))
    shape = codecs[0].shape_of(places)  # rounded: the same for all steps
    light, target = codecs[0].coordinates_of_light(image, shape), None
    for codec in codecs:
        code = codec.encode(np.concatenate([own, light]))
        picture, inside = codec.picture(image, codec.decode(code))
        if not inside.any():  # the fit is lost
            return
        box = box_around(inside, 0.0)
        if target is None:
            target = Target(np.ascontiguousarray(image[box]), inside[box])
            yield from of_rivals(target)
        yield target.kept("liaam", len(code), picture[box])
        if codec.step == UNDER_RESIDUAL:
            yield from with_residual(target, picture[box], len(code))


def compress_experiment(data: Path, test: Path, lamps: Path | None, training_lamp: str, diagonal: float) -> Experiment:
    """Make the experiment; the parameters are those of :class:`GenericRequest`."""
    request, settings, left_out = request_of_folders(data, test, lamps, training_lamp, diagonal)
    return Experiment(
        name="compress",
        title="Images kept as appearance and light",
        settings=settings,
        tasks=tuple(HeldOut(0, name) for name in get_folds(request)[0][0].tested),
        work=partial(keep_object, request),
        columns={
            **dict.fromkeys(("codec", "object", "light", "status", "budget", "bytes"), ""),
            "psnr": ".4f",
            "ssim": ".6f",
        },
        summarise=summarise,
        draw=lambda _, summary: draw(summary),
        report=lambda _, summary: tell(str(__doc__).strip(), table(summary)),
        left_out=left_out,
    )


def summarise(rows: list[Row]) -> dict[str, Any]:
    """Median quality by codec and budget; None if half of the images do not fit the budget."""

    def median(codec: str, budget: int, measure: str) -> float | None:
        own = [row[measure] for row in rows if row["codec"] == codec and row["budget"] == budget]
        return finite_or_none(np.quantile(own, 0.5, method="lower"))

    return {
        "images": len({(row["object"], row["light"]) for row in rows}),
        "codecs": {c: {m: [[b, median(c, b, m)] for b in BUDGETS] for m in MEASURES} for c in CODECS},
    }


def table(summary: dict[str, Any]) -> tuple[Header, Table]:
    """Tabulate the quality by bytes."""
    rows = [
        [codec, measure, *(or_dash(value, form) for _, value in found[measure])]
        for measure, form in MEASURES.items()
        for codec, found in summary["codecs"].items()
    ]
    return ["codec", "at bytes", *map(str, BUDGETS)], rows


def draw(summary: dict[str, Any]) -> "Figure":
    """Draw the quality against bytes."""
    labels = {"psnr": "PSNR inside the mesh, dB", "ssim": "SSIM inside the mesh"}
    panels = [
        Panel("bytes", label, {codec: found[measure] for codec, found in summary["codecs"].items()})
        for measure, label in labels.items()
    ]
    figure = figure_of_curves(panels)
    for axis, low in zip(figure.axes, (18.0, 0.5), strict=True):
        axis.set_xscale("log", base=2)
        axis.xaxis.set_major_formatter("{x:.0f}")
        axis.set_ylim(bottom=low)
    return figure
