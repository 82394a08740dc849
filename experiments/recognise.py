"""Recognition across light (paper section 1): is a person found again in images under other lights?

Every image of a folder is fitted by a generic model of other persons. The gallery holds one image of each person under
the training light, and the probes are the persons' images under another light; in a second pass, the other way round.
The classifier is the same for all methods: the nearest image of the gallery by normalised correlation, after warping
to the model's reference frame by the fitted landmarks.

- ``input``, ``clahe``, ``grey-world``, ``retinex``: stored RGB values of the image, or of the image after that method.
- ``liaam``: those of the image relit by the training light.
- ``model``: those of the model's canonical appearance alone (paper eq 11), estimated jointly with the light.
- ``invariant``: the same, estimated from the light-invariant channel alone, as the paper does.
- ``appearance``, ``shape``, ``both``: the model's coordinates of appearance and of shape (without pose), in standard
  deviations; their similarity is the cosine.

*Times input* is the ratio of rank-1 rates to that of the input. Intervals are at 95 %: Wilson's for rates, counting a
person once if several lights are pooled, and from bootstrap samples of persons for ratios.
"""

from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from experiments.charts import figure_of_bars
from experiments.generic import GenericRequest, get_folds, get_trained, request_of_folders, start_of
from experiments.protocol import Header, Table, eight_bit, in_percent, select, tell
from experiments.relight import PLAIN
from experiments.runner import Experiment, Row
from liaam.errors import LiaamError
from liaam.fitting import FitResult, Fitter
from liaam.model import AAM
from liaam.model.shape import align
from liaam.photometry.response import from_linear
from liaam.relighting import Relighter, shadow_free
from liaam.training.textures import sample_appearance

if TYPE_CHECKING:
    from matplotlib.figure import Figure

METHODS = (*PLAIN, "liaam", "model", "invariant", "appearance", "shape", "both")

DIRECTIONS = ("from training light", "to training light")
"""The gallery is under the training light, or the probes are."""

Z = 1.96
REPLICATES = 2000

FAR, OTHERS = "far", "other"
"""Groups of lights: those named as far, and the rest without the training light."""


@dataclass(frozen=True)
class UnderLight:
    """All images under one light, from one kind of start: one task."""

    start: str
    light: str

    @property
    def key(self) -> str:
        """Key of the task in the journal."""
        return f"light {self.light}, start {self.start}"


def features_of(fitter: Fitter, image: np.ndarray, result: FitResult) -> dict[str, np.ndarray]:
    """Compute the feature vector of a fitted image (h, w, 3) uint8 by method, centred and of unit length."""
    model, shape = fitter.model, result.landmarks
    known = model.levels[-1].appearances["log"]
    relighter = Relighter.of(fitter, image, result)
    pictures = {name: method(image) for name, method in PLAIN.items()} | {"liaam": relighter.flat()}
    found = {
        name: sample_appearance(picture, shape, model.warp, "value", model.response, model.levels[-1].blur)[0]
        for name, picture in pictures.items()
    }
    for name, free in (("model", relighter.appearance), ("invariant", shadow_free(fitter, image, result))):
        found[name] = from_linear(np.exp(free.log_rgb), model.response)
    vectors = {name: values.ravel() - values.mean() for name, values in found.items()}
    vectors["appearance"] = relighter.appearance.lam / np.sqrt(np.maximum(known.eigenvalues, 1e-12))
    vectors["shape"] = shape_coordinates(model, shape)
    vectors["both"] = np.concatenate([vectors["appearance"], vectors["shape"]])
    return {name: vector / max(float(np.linalg.norm(vector)), 1e-12) for name, vector in vectors.items()}


def shape_coordinates(model: AAM, shape: np.ndarray) -> np.ndarray:
    """Return the coordinates of a shape (n, 2) in standard deviations, without its pose."""
    own = model.shape_model.parameters(align(shape, model.shape_model.mean)(shape))[:-4]
    return own / np.sqrt(np.maximum(model.shape_model.eigenvalues, 1e-12))


@dataclass(frozen=True, eq=False)
class Features:
    """Features of the images under one light.

    Attributes
    ----------
    objects : list of str
        The persons.
    vectors : dict of str to (n, d) float64
        By method.
    statuses : list of str
        Statuses of the fits.
    """

    objects: list[str]
    vectors: dict[str, np.ndarray]
    statuses: list[str]


@lru_cache(maxsize=2)
def get_features(request: GenericRequest, task: UnderLight) -> Features:
    """Fit all images under one light; the training light's are needed for every other light."""
    trained, (fold,) = get_trained(request, 0), get_folds(request)[0]
    fitter, found = trained.fitters["soft-li"], {}
    for name, pictures in fold.tested.items():
        for shown in pictures:
            if shown.light == task.light:
                image = eight_bit(shown.sample)
                result = fitter.fit(image, start_of(request, task.start, trained.mean, shown.sample, 0))
                found[name] = features_of(fitter, image, result), str(result.status)
    vectors = {method: np.array([each[method] for each, _ in found.values()]) for method in METHODS}
    return Features(list(found), vectors, [status for _, status in found.values()])


def recognise(request: GenericRequest, task: UnderLight) -> list[Row]:
    """Find every person under one light among all under the training light, and the other way round."""
    training, other = (
        get_features(request, UnderLight(task.start, x)) for x in (str(request.training_lamp), task.light)
    )
    rows = []
    for direction, gallery, probes in zip(DIRECTIONS, (training, other), (other, training), strict=True):
        for method in METHODS:
            similar = probes.vectors[method] @ gallery.vectors[method].T
            for name, status, row in zip(probes.objects, probes.statuses, similar, strict=True):
                if name in gallery.objects:
                    rank = 1 + int((row > row[gallery.objects.index(name)]).sum())
                    labels = {"direction": direction, "start": task.start, "light": task.light, "object": name}
                    rows.append({"method": method, **labels, "rank": rank, "of": len(row), "status": status})
    return rows


def recognise_experiment(
    data: Path,
    test: Path,
    training_lamp: str,
    lamps: Path | None = None,
    diagonal: float = 150.0,
    far: tuple[str, ...] = (),
    starts: tuple[str, ...] = ("none", "box"),
) -> Experiment:
    """Make the experiment; :data:`experiments.cli.HELP` describes the parameters."""
    request, settings, left_out = request_of_folders(data, test, lamps, training_lamp, diagonal, starts=starts)
    shown = [each for pictures in get_folds(request)[0][0].tested.values() for each in pictures]
    lights = sorted({each.light for each in shown})
    for name in (training_lamp, *far):
        if name not in lights:
            raise LiaamError(f"{test}: no image under the light {name}; choose from {', '.join(lights)}")
    return Experiment(
        name="recognise",
        title="Persons, recognised across light",
        settings={"far": list(far), **settings},
        tasks=tuple(UnderLight(start, light) for start in starts for light in lights),
        work=partial(recognise, request),
        columns=dict.fromkeys(("method", "direction", "start", "light", "object", "rank", "of", "status"), ""),
        summarise=partial(summarise, training_lamp, far),
        draw=lambda _, summary: draw(summary),
        report=lambda summary: tell(str(__doc__).strip(), table(summary)),
        left_out=left_out,
    )


def summarise(training_lamp: str, far: tuple[str, ...], rows: list[Row]) -> dict[str, Any]:
    """Rank-1 rates by start, direction, method and group of lights."""
    lights = sorted({row["light"] for row in rows})
    groups = {light: (light,) for light in lights} | {FAR: tuple(light for light in far if light in lights)}
    groups[OTHERS] = tuple(light for light in lights if light not in (*far, training_lamp))
    groups = {name: own for name, own in groups.items() if own}

    def cells(own: list[Row]) -> dict[str, Any]:
        return {
            name: {
                method: _cell(*(hits(select(own, method=which), lights) for which in (method, "input")))
                for method in METHODS
            }
            for name, lights in groups.items()
        }

    return {
        "persons": len({row["object"] for row in rows}),
        "gallery": max(row["of"] for row in rows),
        "starts": {
            start: {d: cells(select(rows, start=start, direction=d)) for d in DIRECTIONS}
            for start in dict.fromkeys(row["start"] for row in rows)
        },
    }


def hits(rows: list[Row], lights: tuple[str, ...]) -> np.ndarray:
    """Numbers of a person's images under some lights, and of those of rank 1, (n, 2)."""
    found: dict[str, list[int]] = {}
    for row in rows:
        if row["light"] in lights:
            counts = found.setdefault(row["object"], [0, 0])
            counts[0] += 1
            counts[1] += row["rank"] == 1
    return np.array(list(found.values()))


def _cell(own: np.ndarray, reference: np.ndarray) -> dict[str, Any]:
    """Rank-1 rate with its interval, and its ratio to that of the reference with its interval; None if unknown."""
    drawn = np.random.default_rng(0).integers(len(own), size=(REPLICATES, len(own)))
    right, right_of_reference = (each[drawn, 1].sum(axis=1) for each in (own, reference))
    base, known = int(reference[:, 1].sum()), right_of_reference > 0
    ratios = right[known] / right_of_reference[known]
    return {
        "images": int(own[:, 0].sum()),
        "rank_1": float(own[:, 1].sum() / own[:, 0].sum()),
        "interval": wilson(float(own[:, 1].sum() / own[:, 0].sum()), len(own)),
        "times_input": float(own[:, 1].sum() / base) if base else None,
        "times_interval": [float(x) for x in np.quantile(ratios, [0.025, 0.975])] if base else None,
    }


def wilson(rate: float, n: int) -> list[float]:
    """Wilson's 95 % interval of a rate of n independent trials."""
    middle = (rate + Z**2 / (2 * n)) / (1 + Z**2 / n)
    half = Z * np.sqrt(rate * (1 - rate) / n + Z**2 / (4 * n**2)) / (1 + Z**2 / n)
    return [max(0.0, float(middle - half)), min(1.0, float(middle + half))]


def table(summary: dict[str, Any]) -> tuple[Header, Table]:
    """Tabulate rank-1 rates in per cent with their intervals, and the ratios to the input of pooled lights."""
    first = next(iter(summary["starts"].values()))[DIRECTIONS[0]]
    pooled = [group for group in (FAR, OTHERS) if group in first]
    rows = [
        [start, direction, method]
        + [_with_interval(cells[group][method], "rank_1", "interval", 100, ".0f") for group in cells]
        + [_with_interval(cells[group][method], "times_input", "times_interval", 1, ".2f") for group in pooled]
        for start, directions in summary["starts"].items()
        for direction, cells in directions.items()
        for method in METHODS
    ]
    return ["start", "direction", "method", *first, *(f"{group}, times input" for group in pooled)], rows


def _with_interval(cell: dict[str, Any], value: str, interval: str, factor: int, style: str) -> str:
    if cell[value] is None:
        return "–"
    rate, low, high = (format(factor * x, style) for x in (cell[value], *cell[interval]))
    return f"{rate} ({low}–{high})"


def draw(summary: dict[str, Any]) -> "Figure":
    """Draw the rank-1 rates of pooled lights, or of all lights if none are far, from the first kind of start."""
    cells = next(iter(summary["starts"].values()))[DIRECTIONS[0]]
    shown = {name: cells[name] for name in (FAR, OTHERS) if name in cells} or cells
    groups = {
        f"{name} lights": in_percent({method: cell["rank_1"] for method, cell in group.items()})
        for name, group in shown.items()
    }
    return figure_of_bars(groups, "rank 1, %", lambda _: "0.4")
