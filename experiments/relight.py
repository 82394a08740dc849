"""Relighting of unseen objects: how alike do images of one object become, and does the change of light show a border?

Every image of a folder is brought to the training light by a generic model, and by methods without a model: CLAHE,
grey-world and multi-scale retinex. Images of an object show it under several lights and without movement.

- Agreement: correlation of log luminance inside the mesh of the true landmarks, with the object's other images (median)
  and with its image under the training light.
- Seam: mean gradient of log(relit / original), blurred by 1 pixel, across the mesh's border, over that inside the mesh.
- Brow and jaw: CIE76 distance at equal lightness, sqrt(da^2 + db^2), between the mean colour of skin inside the mesh
  and of skin up to a quarter of the distance between the eyes above the brows, and below the jaw. Skin is found in the
  image under the training light, and is the same for all methods: within 10 in (a, b) and 25 in L of the median
  inside the mesh.
"""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from experiments.charts import figure_of_bars
from experiments.generic import GenericRequest, get_folds, get_trained, request_of_folders
from experiments.measures import or_dash
from experiments.protocol import Header, Table, eight_bit, face_size, tell
from experiments.relit import GRAIN, mesh_mask
from experiments.runner import Experiment, Named, Row
from liaam.distance_transform import distance_transform
from liaam.errors import LiaamError
from liaam.formatting import finite_or_none
from liaam.photometry.response import srgb_to_linear
from liaam.relighting import Relighter

if TYPE_CHECKING:
    from matplotlib.figure import Figure

NEAR, LEAST = 0.25, 15
"""Width of the bands of skin outside the mesh, in distances between the eyes, and smallest number of pixels."""

SKIN_COLOUR, SKIN_LIGHTNESS = 10.0, 25.0
MEASURES = {"agreement": ".3f", "truth": ".3f", "seam": ".2f", "brow": ".1f", "jaw": ".1f"}


def clahe(image: np.ndarray) -> np.ndarray:
    """Equalise the lightness of tiles with limited contrast."""
    import cv2

    lab = cv2.cvtColor(image, cv2.COLOR_RGB2LAB)
    lightness = cv2.createCLAHE(2.0, (8, 8)).apply(np.ascontiguousarray(lab[..., 0]))
    return cv2.cvtColor(np.dstack([lightness, lab[..., 1:]]), cv2.COLOR_LAB2RGB)


def grey_world(image: np.ndarray) -> np.ndarray:
    """Scale the channels to equal means."""
    return np.clip(image * (image.mean() / np.maximum(image.mean(axis=(0, 1)), 1.0)), 0, 255).astype(np.uint8)


def retinex(image: np.ndarray) -> np.ndarray:
    """Subtract blurred logarithms at three scales: 2, 10 and 31 % of the image's longer side."""
    import cv2

    log, longer = np.log(image.astype(np.float32) + 1.0), max(image.shape[:2])
    found = sum(log - cv2.GaussianBlur(log, (0, 0), scale * longer) for scale in (0.02, 0.1, 0.31)) / 3.0
    low, high = np.percentile(found, [1, 99])
    return np.clip((found - low) / (high - low) * 255, 0, 255).astype(np.uint8)


PLAIN: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "input": np.copy,
    "clahe": clahe,
    "grey-world": grey_world,
    "retinex": retinex,
}


def log_luminance(image: np.ndarray) -> np.ndarray:
    """Logarithm of linear luminance plus that of a stored value of 2, (h, w) float."""
    floor = srgb_to_linear(np.array(2 / 255))
    return np.log(srgb_to_linear(image / 255.0) @ np.array([0.2126, 0.7152, 0.0722]) + floor)


def lab_of(image: np.ndarray) -> np.ndarray:
    """Convert an image to CIE L, a, b, (h, w, 3) float32."""
    import cv2

    return cv2.cvtColor(np.asarray(image / 255.0, np.float32), cv2.COLOR_RGB2LAB)


def skin_of(image: np.ndarray, inside: np.ndarray, points: np.ndarray) -> dict[str, np.ndarray]:
    """Masks of skin by place: in the mesh (``face``), above the brows (``brow``) and below the jaw (``jaw``)."""
    lab = lab_of(image)
    distance = lab - np.median(lab[inside], axis=0)
    skin = (np.hypot(distance[..., 1], distance[..., 2]) < SKIN_COLOUR) & (np.abs(distance[..., 0]) < SKIN_LIGHTNESS)
    away = distance_transform(~inside)
    band = (away > 0) & (away <= NEAR * face_size(points)) & skin
    y, x = np.indices(inside.shape)
    low, high = np.quantile(points[:, 0], [0.1, 0.9])
    middle = points[:, 1].mean()
    band &= (x > low) & (x < high)
    return {"face": inside & skin, "brow": band & (y < middle), "jaw": band & (y > middle)}


def seam_of(change: np.ndarray, inside: np.ndarray) -> float:
    """Ratio of the mean step of a change of light (h, w) across a mask's border to that inside; NaN if none."""
    across, within = [], []
    for axis in (0, 1):
        steps = np.abs(np.diff(change, axis=axis))
        first, second = (np.delete(inside, which, axis=axis) for which in (-1, 0))
        across.append(steps[first ^ second])
        within.append(steps[first & second])
    interior = np.concatenate(within).mean()
    return float(np.concatenate(across).mean() / interior) if interior > 1e-6 else np.nan


def hue_distance(lab: np.ndarray, one: np.ndarray, other: np.ndarray) -> float:
    """CIE76 distance at equal lightness of the mean colours in two masks; NaN if one is small."""
    if min(one.sum(), other.sum()) < LEAST:
        return np.nan
    return float(np.linalg.norm((lab[one].mean(axis=0) - lab[other].mean(axis=0))[1:]))


def relight_object(request: GenericRequest, task: Named) -> list[Row]:
    """Bring all images of one object to the training light, by all methods."""
    from scipy.ndimage import gaussian_filter

    trained, shown = get_trained(request, task.group), get_folds(request)[0][task.group].tested[task.name]
    fitter = trained.fitters["soft-li"]
    images = {each.light: eight_bit(each.sample) for each in shown}
    base = next((each for each in shown if each.light == request.training_lamp), None)
    if base is None:
        raise LiaamError(f"{task.name}: no image under the training light {request.training_lamp}")
    points = base.sample.landmarks.points
    inside = mesh_mask(trained.model, images[base.light], points)
    skin, truth = skin_of(images[base.light], inside, points), log_luminance(images[base.light])[inside]
    fits = {light: fitter.fit(image) for light, image in images.items()}
    made = {name: {light: method(image) for light, image in images.items()} for name, method in PLAIN.items()}
    made["liaam"] = {light: Relighter.of(fitter, image, fits[light]).flat() for light, image in images.items()}
    rows = []
    for method, pictures in made.items():
        logs = {light: log_luminance(picture) for light, picture in pictures.items()}
        for light, log in logs.items():
            others = [np.corrcoef(log[inside], logs[other][inside])[0, 1] for other in logs if other != light]
            lab, change = lab_of(pictures[light]), gaussian_filter(log - log_luminance(images[light]), GRAIN)
            row = {"method": method, "object": task.name, "light": light, "agreement": float(np.median(others))}
            row["truth"] = float(np.corrcoef(log[inside], truth)[0, 1]) if light != base.light else np.nan
            row |= {place: hue_distance(lab, skin[place], skin["face"]) for place in ("brow", "jaw")}
            rows.append(row | {"seam": seam_of(change, inside), "status": str(fits[light].status)})
    return rows


def relight_experiment(
    data: Path, test: Path, training_lamp: str, lamps: Path | None = None, diagonal: float = 150.0
) -> Experiment:
    """Make the experiment; the parameters are those of :class:`GenericRequest`."""
    request, settings, left_out = request_of_folders(data, test, lamps, training_lamp, diagonal)
    return Experiment(
        name="relight",
        title="Unseen objects, brought to the training light",
        settings=settings,
        tasks=tuple(Named(0, name) for name in get_folds(request)[0][0].tested),
        work=partial(relight_object, request),
        summarise=summarise,
        draw=lambda _, summary: draw(summary),
        report=lambda summary: tell(str(__doc__).strip(), table(summary)),
        left_out=left_out,
    )


def summarise(rows: list[Row]) -> dict[str, Any]:
    """Median of each measure by method."""
    groups = {name: [row for row in rows if row["method"] == name] for name in dict.fromkeys(r["method"] for r in rows)}

    def median(group: list[Row], measure: str) -> float | None:
        values = np.array([row[measure] for row in group], np.float64)
        return finite_or_none(np.nanmedian(values)) if np.isfinite(values).any() else None

    return {"methods": {name: {m: median(group, m) for m in MEASURES} for name, group in groups.items()}}


def table(summary: dict[str, Any]) -> tuple[Header, Table]:
    """Header and rows of the report's table."""
    found = summary["methods"]
    rows = [[name, *(or_dash(values[m], form) for m, form in MEASURES.items())] for name, values in found.items()]
    return ["method", *MEASURES], rows


def draw(summary: dict[str, Any]) -> "Figure":
    """Draw the agreement by method."""
    agreement = {name: values["agreement"] for name, values in summary["methods"].items()}
    return figure_of_bars({"images of one object": agreement}, "correlation of log luminance", lambda _: "0.4")
