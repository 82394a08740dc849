"""Procrustes superimposition into the tangent space of the mean shape, as the analysis of shape variation needs it.

It is that of ``gpagen`` of the R package geomorph with its defaults: a generalised *partial* Procrustes analysis (Rohlf
& Slice 1990), in which shapes keep their centroid size of 1, and the orthogonal projection onto the tangent space at
the mean shape (Dryden & Mardia 2016, section 4.4.1).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from liaam.formatting import short_repr
from liaam.morphometry.measures import procrustes

TOLERANCE = 1e-4
"""Change of the sum of squares that ends the rounds of rotation, that of geomorph, so that results have all its digits.
On geomorph's mosquitoes a tolerance of 0 changes sums of squares by a hundred-millionth of the whole."""

_MOST_ROUNDS = 100  # each reduces the remaining change by the variance of shape, a thousandth in most data


@dataclass(frozen=True, eq=False)
class Superimposition:
    """Shapes on each other.

    Attributes
    ----------
    shapes : (m, k, 2) float64
        Tangent coordinates: the mean shape plus the projected differences from it, in the mean orientation of the
        shapes that were given.
    sizes : (m,) float64
        Centroid sizes of the shapes that were given.
    mean : (k, 2) float64
        Mean shape, of centroid size 1.
    """

    shapes: np.ndarray
    sizes: np.ndarray
    mean: np.ndarray

    __repr__ = short_repr


def superimpose(shapes: np.ndarray, tolerance: float = TOLERANCE) -> Superimposition:
    """Superimpose shapes by partial Procrustes analysis, and project them onto the tangent space at their mean.

    Parameters
    ----------
    shapes : (m, k, 2) float
        Shapes without gaps, none with all points in one place.
    tolerance : float
        Change of the sum of squared differences from the mean, in units of centroid size, that ends the rounds.

    Returns
    -------
    Superimposition
    """
    centred = np.asarray(shapes, np.float64) - np.mean(shapes, axis=1, keepdims=True)
    sizes = np.linalg.norm(centred, axis=(1, 2))
    # Points as complex numbers, which rotations multiply.
    given = (centred[..., 0] + 1j * centred[..., 1]) / sizes[:, None]
    rotated = _rotated(given, given[0])
    mean = _unit(rotated.mean(axis=0))
    squares = _squares(rotated)
    for _ in range(_MOST_ROUNDS):
        rotated = _rotated(rotated, mean)
        mean = _unit(rotated.mean(axis=0))
        before = squares
        squares = _squares(rotated)
        if abs(before - squares) <= tolerance:
            break
    turn = _unit_number(np.vdot(rotated, given))  # back to the mean orientation of the shapes that were given
    mean = mean * turn
    rotated = rotated * turn
    along = np.real(rotated @ mean.conj())  # the component along the mean, which the projection makes 1
    projected = rotated + (1 - along)[:, None] * mean
    return Superimposition(_as_points(projected), sizes, _as_points(mean))


def tangent_covariances(shapes: np.ndarray, covariances: np.ndarray, mean: np.ndarray) -> np.ndarray:
    """Carry covariances of landmarks to those of the tangent coordinates of shapes.

    Errors of different landmarks are taken as independent.

    Parameters
    ----------
    shapes : (m, k, 2) float
        Shapes as they are.
    covariances : (m, k, 2, 2) float
        Covariances of their landmarks.
    mean : (k, 2) float
        Mean shape, of centroid size 1.

    Returns
    -------
    (m, 2 k, 2 k) float64
    """
    from scipy.linalg import block_diag

    along = mean.ravel()
    projection = np.eye(len(along)) - np.outer(along, along)
    carried = np.empty((len(shapes), len(along), len(along)))
    for i, (shape, spread) in enumerate(zip(shapes, covariances, strict=True)):
        jacobian = projection @ procrustes(shape, mean)[1]
        carried[i] = jacobian @ np.asarray(block_diag(*spread)) @ jacobian.T
    return carried


def _rotated(shapes: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Rotate centred shapes (m, k) complex to a target (k,)."""
    return shapes * _unit_number(shapes.conj() @ target)[:, None]


def _unit_number(number: np.ndarray) -> np.ndarray:
    """Return complex numbers divided by their size; 1 for 0, at which no rotation is better than another."""
    size = np.abs(number)
    return np.where(size > 0, number, 1.0) / np.where(size > 0, size, 1.0)


def _unit(shape: np.ndarray) -> np.ndarray:
    return shape / np.linalg.norm(shape)


def _squares(shapes: np.ndarray) -> float:
    """Sum of squared differences of shapes of size 1 from their mean."""
    return float(len(shapes) * (1 - np.linalg.norm(shapes.mean(axis=0)) ** 2))


def _as_points(numbers: np.ndarray) -> np.ndarray:
    return np.stack([np.real(numbers), np.imag(numbers)], axis=-1)
