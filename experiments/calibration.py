"""How accurately do calibrations estimate the camera's angle, and are their error bars correct?

The data are posters and charts under Planckian light, from a camera with a known angle, with 8-bit noise added.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from experiments.charts import figure_of_bars
from experiments.measures import or_dash
from experiments.runner import Experiment, Row, Trial
from liaam.calibration import AngleEstimate, theta_from_chart, theta_from_image, theta_from_scene
from liaam.calibration.estimate import axis_difference
from liaam.error_measures import root_mean_square
from liaam.errors import LiaamError
from liaam.photometry.encoding import DARK, SATURATED
from liaam.photometry.invariant import CHROMATICITY
from liaam.photometry.response import to_linear
from scenes import (
    Camera,
    colour_chart,
    even_light,
    narrow_band_camera,
    photograph,
    poster,
    uneven_light,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SIGMAS = (2.0, 8.0)
SIZE = (180, 240)
LAMPS_K = (3600.0, 5500.0, 3000.0, 4500.0)
OURS, PLAIN = "#19a979", "#9a9a9a"
"""Colours of our calibrations and of the reference."""

INSET = 3
"""Margin of each chart patch to ignore, in pixels."""

CAMERAS = {
    "line sensors": replace(narrow_band_camera(response="srgb"), bits=8),
    "broad sensors": Camera(read_noise=0.0, shot_noise=0.0, vignetting=0.0),
}
"""Cameras. The paper's theory is exact for the first. The second has bands of 24 to 30 nm, so that each surface moves
slightly differently."""

CHOICES = (
    "Lamps of 2600 to 6300 K (each drawn within 15 % of 3600, 5500, 3000, 4500 K) over skylight of 8000 K with cast "
    "shadows on posters; charts under 2800 to 4200 K and 5500 to 8000 K, even.",
    "Noise is white, of the stored values, rounded and cut to [0, 255], on top of the camera's own rounding.",
    "The truth for broad sensors is the direction in which a grey surface moves between 4000 and 6500 K.",
    "Plain least squares: all pixels of the first two pictures with every channel in 8 to 250, unweighted, unaveraged.",
)


@dataclass(frozen=True)
class Setup:
    """Settings shared by all trials."""

    seed: int
    sigmas: tuple[float, ...]


def run_trial(setup: Setup, trial: Trial) -> list[Row]:
    """Calibrate one random scene and one chart with each camera and method, at each noise level."""
    rows = []
    for camera_name, camera in CAMERAS.items():
        truth = camera.theta("wien")
        for sigma in setup.sigmas:
            rng = np.random.default_rng([setup.seed, trial.number, int(10 * sigma)])
            for kind, (estimate, plain) in _estimates(camera, sigma, setup.seed * 10_000 + trial.number, rng).items():
                rows.append(
                    {
                        "camera": camera_name,
                        "kind": kind,
                        "sigma_n": sigma,
                        "trial": trial.number,
                        "error_deg": float(np.rad2deg(axis_difference(estimate.theta, truth))),
                        "standard_error_deg": float(np.rad2deg(estimate.standard_error)),
                        "observable": int(estimate.observable),
                        "inside": int(estimate.interval[0] <= truth <= estimate.interval[1]),
                        "plain_error_deg": float(np.rad2deg(axis_difference(plain, truth))),
                    }
                )
    return rows


def _estimates(
    camera: Camera, sigma: float, seed: int, rng: np.random.Generator
) -> dict[str, tuple[AngleEstimate, float]]:
    """Return each kind's estimate, and that of plain least squares on the same images."""
    sheet = poster(SIZE, seed)
    lamps = np.array(LAMPS_K) * rng.uniform(0.85, 1.15, len(LAMPS_K))
    lights = [uneven_light(SIZE, 7 * seed + i, lamp_K=float(lamp)) for i, lamp in enumerate(lamps)]
    scene = [_noisy(photograph(sheet, light, camera, seed=seed), sigma, rng) for light in lights]
    reflectance, boxes = colour_chart()
    size, kelvins = reflectance.shape[:2], (rng.uniform(2800, 4200), rng.uniform(5500, 8000))
    chart = [_noisy(photograph(reflectance, even_light(size, k), camera, seed=seed), sigma, rng) for k in kelvins]
    patches = boxes + np.array([INSET, INSET, -INSET, -INSET])
    plain = _plain_angle(scene[:2])
    return {
        "chart": (theta_from_chart(chart, [patches] * 2), _plain_angle(chart)),
        "pair": (theta_from_scene(scene[:2]), plain),
        "scene": (theta_from_scene(scene), plain),
        "image": (theta_from_image(scene[0]), plain),
    }


def _plain_angle(images: Sequence[np.ndarray]) -> float:
    """Angle of least squares over the pixels of two images: orthogonal to the main direction of change."""
    stored = np.stack(images) / 255.0
    usable = ((stored >= DARK) & (stored <= SATURATED)).all(axis=(0, 3))
    first, second = np.log(to_linear(stored[:, usable], "srgb"))
    chroma = (first - second) @ CHROMATICITY.T
    row = np.cross(np.linalg.eigh(chroma.T @ chroma)[1][:, 1] @ CHROMATICITY, np.ones(3))
    return float(np.arctan2(row[1], row[0]) % np.pi)


def _noisy(image: np.ndarray, sigma: float, rng: np.random.Generator) -> np.ndarray:
    return np.clip(np.rint(image + rng.normal(0.0, sigma, image.shape)), 0, 255).astype(np.uint8)


def calibration_experiment(trials: int = 24, seed: int = 0, sigmas: Sequence[float] = SIGMAS) -> Experiment:
    """Make the experiment. A trial is a draw of scene, lights and noise; the noise is in 8-bit units."""
    if trials < 1 or not all(0 <= sigma <= 50 for sigma in sigmas):
        raise LiaamError("the calibration experiment needs at least one trial, and noise of 0 to 50 of 255")
    return Experiment(
        name="calibration",
        title="How well calibrations find the camera's angle",
        settings={"trials": trials, "seed": seed, "sigma_n": list(map(float, sigmas))},
        tasks=tuple(Trial("all", number) for number in range(trials)),
        work=partial(run_trial, Setup(seed, tuple(map(float, sigmas)))),
        summarise=summarise,
        draw=draw,
        report=report,
        choices=CHOICES,
    )


def summarise(rows: list[Row]) -> dict[str, Any]:
    """Errors of the observable estimates, and the coverage of their intervals."""
    cells = []
    for camera, kind, sigma in dict.fromkeys((r["camera"], r["kind"], r["sigma_n"]) for r in rows):
        own = [r for r in rows if (r["camera"], r["kind"], r["sigma_n"]) == (camera, kind, sigma)]
        told = [r for r in own if r["observable"]]
        errors = np.abs([r["error_deg"] for r in told])
        cells.append(
            {
                "camera": camera,
                "kind": kind,
                "sigma_n": sigma,
                "trials": len(own),
                "observable": len(told),
                "median_deg": _or_none(np.median, errors),
                "p95_deg": _or_none(partial(np.percentile, q=95), errors),
                "worst_deg": _or_none(np.max, errors),
                "rms_deg": _or_none(root_mean_square, errors),
                "standard_error_deg": _or_none(np.median, [r["standard_error_deg"] for r in told]),
                "coverage": _or_none(np.mean, [r["inside"] for r in told]),
                "plain_median_deg": _or_none(np.median, np.abs([r["plain_error_deg"] for r in own])),
            }
        )
    return {"cells": cells}


def _or_none(statistic: Callable, values) -> float | None:
    return float(statistic(values)) if len(values) else None


def draw(rows: list[Row], summary: dict[str, Any]) -> "Figure":
    """Median errors as bars, a panel for each camera and noise."""
    groups: dict[str, dict[str, float | None]] = {}
    for cell in summary["cells"]:
        group = groups.setdefault(f"{cell['camera']}, noise {cell['sigma_n']:g} of 255", {})
        group[cell["kind"]] = cell["median_deg"]
        if cell["kind"] == "pair":
            group["pair, plain squares"] = cell["plain_median_deg"]
    return figure_of_bars(groups, "median error of theta, degrees", lambda kind: PLAIN if "plain" in kind else OURS)


def report(summary: dict[str, Any]) -> str:
    """Table of all cells."""
    lines = [
        "Error of the angle in degrees (median, 95th percentile), the median standard error that was stated, the share "
        "of trials whose 95 % interval holds the truth, and plain least squares on the same pictures.",
        "",
        "| camera | kind | noise | told | median | p95 | stated | coverage | plain |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    lines += [
        f"| {c['camera']} | {c['kind']} | {c['sigma_n']:g} | {c['observable']}/{c['trials']} | "
        f"{or_dash(c['median_deg'])} | {or_dash(c['p95_deg'])} | {or_dash(c['standard_error_deg'])} | "
        f"{or_dash(c['coverage'], '.2f')} | {or_dash(c['plain_median_deg'])} |"
        for c in summary["cells"]
    ]
    return "\n".join(lines)
