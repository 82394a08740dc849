"""Learn the appearances of a level from textures."""

import numpy as np

from liaam.model import MESH
from liaam.model.appearance import AppearanceModel, Textures, train_appearance_model, train_illumination
from liaam.model.pca import Variance, count_by_evidence, some_folds
from liaam.photometry import invariant_row
from liaam.training.textures import SAMPLED, Sampled


def _counted(values: np.ndarray, variance: Variance, folds: list[np.ndarray]) -> float | int:
    """Fraction or number of modes of textures (n, n_pixels, c) to keep; resolves ``auto`` by the evidence."""
    return count_by_evidence(values.reshape(len(values), -1), folds) if variance == "auto" else variance


def mesh_appearances(
    sampled: Sampled, level: int, theta: float, variance: Variance, folds: list[np.ndarray]
) -> dict[str, AppearanceModel]:
    """Learn all appearances of one level of the view ``mesh``."""
    textures = {name: sampled.textures[name][level] for name in SAMPLED[MESH] if name in sampled.textures}
    if not sampled.grey:
        # LIT: project first, then learn (paper section 4).
        log = textures["log"]
        textures["invariant"] = Textures.of(log.values @ invariant_row(theta).T.astype(np.float32), log.usable)
    appearances, every = {}, some_folds(sampled.n_samples)
    for name, each in textures.items():
        kept = _counted(each.values, variance, sampled.folds(name, folds))
        appearances[name] = train_appearance_model(each, kept, left_out=sampled.folds(name, every))
    if "varied" in textures:
        # Evidence from left-out images under the training light cannot choose the number of illumination modes.
        kept, relit = 0.98 if variance == "auto" else variance, textures["varied"].of_rows(sampled.copies)
        appearances["illumination"] = train_illumination(appearances["value"], relit, kept)
    return appearances


def soft_appearance(sampled: Sampled, level: int, variance: Variance, folds: list[np.ndarray]) -> AppearanceModel:
    """Learn gradient and invariant in one PCA, since they are correlated."""
    textures = sampled.textures["soft"][level]
    kept = _counted(textures.values, variance, sampled.folds("soft", folds))
    return train_appearance_model(textures, kept, left_out=sampled.folds("soft", some_folds(sampled.n_samples)))
