"""Learn the appearances of a level from textures."""

import numpy as np

from liaam.model.appearance import AppearanceModel, Textures, train_appearance_model, train_illumination
from liaam.model.pca import Variance, count_by_evidence, some_folds
from liaam.photometry import invariant_row
from liaam.training.textures import SAMPLED, Sampled


def level_appearances(
    sampled: Sampled, view: str, level: int, theta: float, variance: Variance, folds: list[np.ndarray]
) -> dict[str, AppearanceModel]:
    """Learn all appearances of one level of a view."""
    textures = {name: sampled.textures[name][level] for name in SAMPLED[view] if name in sampled.textures}
    if "log" in textures and not sampled.grey:
        # LIT: project first, then learn (paper section 4).
        log = textures["log"]
        textures["invariant"] = Textures.of(log.values @ invariant_row(theta).T.astype(np.float32), log.usable)
    appearances, every = {}, some_folds(sampled.n_samples)
    for name, each in textures.items():
        kept = count_by_evidence(each.vectors, sampled.folds(name, folds)) if variance == "auto" else variance
        appearances[name] = train_appearance_model(each, kept, left_out=sampled.folds(name, every))
    if "varied" in textures:
        # Evidence from left-out images under the training light cannot choose the number of illumination modes.
        kept, relit = 0.98 if variance == "auto" else variance, textures["varied"].of_rows(sampled.copies)
        appearances["illumination"] = train_illumination(appearances["value"], relit, kept)
    return appearances
