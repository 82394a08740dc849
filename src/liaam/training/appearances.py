"""Appearances learnt from textures, level by level."""

import numpy as np

from liaam.model import (
    MESH,
)
from liaam.model.appearance import (
    AppearanceModel,
    Textures,
    train_appearance_model,
    train_illumination,
)
from liaam.model.pca import Variance, count_by_evidence, some_folds
from liaam.photometry import invariant_row
from liaam.training.textures import SAMPLED, Sampled


def _counted(values: np.ndarray, variance: Variance, folds: list[np.ndarray]) -> float | int:
    """Share or count to keep of textures (n, n_pixels, c): counted by evidence where that is asked for."""
    return count_by_evidence(values.reshape(len(values), -1), folds) if variance == "auto" else variance


def mesh_appearances(
    sampled: Sampled, level: int, theta: float, asked: Variance, folds: list[np.ndarray]
) -> dict[str, AppearanceModel]:
    """All appearances of one level of the view ``mesh``."""
    textures = {name: sampled.textures[name][level] for name in SAMPLED[MESH] if name in sampled.textures}
    if not sampled.grey:
        # LIT: project first, then learn (paper section 4).
        log = textures["log"]
        textures["invariant"] = Textures.of(log.values @ invariant_row(theta).T.astype(np.float32), log.usable)
    appearances, every = {}, some_folds(sampled.n_samples)
    for name, each in textures.items():
        share = _counted(each.values, asked, sampled.folds(name, folds))
        appearances[name] = train_appearance_model(each, share, left_out=sampled.folds(name, every))
    if "varied" in textures:
        # How many modes another light asks for, pictures left out under their own cannot tell.
        share, relit = 0.98 if asked == "auto" else asked, textures["varied"].of_rows(sampled.copies)
        appearances["illumination"] = train_illumination(appearances["value"], relit, share)
    return appearances


def soft_appearance(sampled: Sampled, level: int, variance: Variance, folds: list[np.ndarray]) -> AppearanceModel:
    """Learn gradient and invariant together: what changes one changes the other."""
    textures = sampled.textures["soft"][level]
    share = _counted(textures.values, variance, sampled.folds("soft", folds))
    return train_appearance_model(textures, share, left_out=sampled.folds("soft", some_folds(sampled.n_samples)))
