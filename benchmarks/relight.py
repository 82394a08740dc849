"""Errors and seams of relit images, and the time of a new light."""

from dataclasses import replace
from time import perf_counter

import numpy as np

from benchmarks.metrics import report
from experiments.relit import (
    LitPair,
    beyond_error,
    flat_error,
    lit_pairs,
    mesh_mask,
    pixel_error,
    seam,
    train_on_flat_light,
)
from liaam.fitting import FitResult, Fitter
from liaam.model import AAM
from liaam.model.shape import align
from liaam.relighting import Relighter, paint
from liaam.relighting.painting import eight_bits, log_light
from scenes import Head

PERSONS = (3, 5, 8, 11)
"""Seeds of the generated heads."""

ROUNDS = 20
"""Number of timed lights."""


def fitted_at(model: AAM, result: FitResult, shape: np.ndarray) -> FitResult:
    """Return a result with other landmarks."""
    pose = align(model.shape_model.mean, shape)
    return replace(result, landmarks=shape, pose=pose, p=model.shape_model.parameters(pose.inverse()(shape)))


def measured(model: AAM, pair: LitPair, relighter: Relighter) -> tuple[float, ...]:
    """Errors of log light (model alone, flat image, its pixels, next to the mesh untouched and flat), and seams.

    The seams are those of the flat image, one under a lamp, the untouched and the true one.
    """
    shape, picture = relighter.shape, pair.lit.image
    untouched = log_light(picture, relighter.response)
    made = untouched.copy()
    made[relighter.region.box] = relighter.log_flat
    made += relighter.colour.correction()
    alone, _ = paint(picture, shape, relighter.model, relighter.appearance.log_rgb)
    errors = flat_error(relighter.model, alone, shape, pair.flat), flat_error(model, made, shape, pair.flat)
    truth = eight_bits(np.log(np.maximum(pair.flat.linear, 1e-4)), relighter.response)
    pictures = (relighter.flat(), relighter.under((1, 0, 0.3)), picture, truth)
    seams = (seam(model, made, shape, pair.flat) for made in pictures)
    beyond = (beyond_error(model, light, shape, pair.flat) for light in (untouched, made))
    return (*errors, pixel_error(model, made, shape, pair.flat), *beyond, *seams)


def pasted_seam(model: AAM, pair: LitPair, relighter: Relighter) -> float:
    """Seam of the flat object pasted into the original image, as a reference."""
    inside = mesh_mask(model, pair.lit.image, relighter.shape)
    pasted = np.where(inside[..., None], relighter.flat(), pair.lit.image)
    return seam(model, pasted, relighter.shape, pair.flat)


def times(relighter: Relighter) -> float:
    """Median time of a new light, milliseconds."""
    spent = []
    for i in range(ROUNDS):
        before = perf_counter()
        relighter.under((np.cos(i), np.sin(i), 0.5))
        spent.append(perf_counter() - before)
    return 1e3 * float(np.median(spent))


def main() -> None:
    """Print all metrics."""
    rows: dict[str, list[tuple[float, ...]]] = {"found": [], "true": []}
    pasted = []
    for person in PERSONS:
        model = train_on_flat_light(Head(person))
        fitter = Fitter(model)
        for pair in lit_pairs(Head(person)):
            result = fitter.fit(pair.lit.image)
            for start, fitted in (("found", result), ("true", fitted_at(model, result, pair.lit.landmarks))):
                relighter = Relighter.of(fitter, pair.lit.image, fitted)
                rows[start].append(measured(model, pair, relighter))
                values = " ".join(f"{value:.3f}" for value in rows[start][-1])
                print(f"relight_person_{person}_{pair.light}_{start} {values} {result.status}")
                pasted.append(pasted_seam(model, pair, relighter))
    errors = ("model_error", "flat_error", "pixel_error", "untouched_beyond_error", "beyond_error")
    names = (*errors, "flat_seam", "lamp_seam", "untouched_seam", "true_seam")
    for start, found in rows.items():
        for name, values in zip(names, zip(*found, strict=True), strict=True):
            spread = f"mean {np.mean(values):.3f} worst {max(values):.3f}"
            report(f"relight_{name}_{start}", float(np.median(values)), spread)
    report("relight_pasted_seam", float(np.median(pasted)))
    large = next(lit_pairs(Head(PERSONS[-1]), size=(640, 480)))
    before = perf_counter()
    relighter = Relighter.of(fitter, large.lit.image, fitter.fit(large.lit.image))
    report("relight_apart_ms", 1e3 * (perf_counter() - before), "fit included", form=".0f")
    report("relight_light_ms", times(relighter), form=".1f")


if __name__ == "__main__":
    main()
