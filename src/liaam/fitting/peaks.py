"""Local maxima of the responses of templates, at which a search fits the model."""

from typing import NamedTuple

import numpy as np


class Peaks(NamedTuple):
    """Local maxima of the templates' responses."""

    centres: np.ndarray
    """(k, 2) float64: centre of the shape, image pixels."""
    scales: np.ndarray
    """(k,) float64: image pixels per pixel of the reduced model."""
    fields: np.ndarray
    """(k,) int: index of the image's field."""
    templates: np.ndarray
    """(k,) int: index of the template."""
    responses: np.ndarray
    """(k,) float64: mean cosine between expected and measured orientation, weighted by the length of both."""

    def take(self, which: np.ndarray) -> "Peaks":
        """Return the peaks with these indices."""
        return Peaks(*(column[which] for column in self))

    def places(self) -> list["Place"]:
        """Return the places without their responses."""
        columns = (column.tolist() for column in self[:-1])
        return [Place(tuple(centre), *rest) for centre, *rest in zip(*columns, strict=True)]

    @staticmethod
    def join(parts: list["Peaks"]) -> "Peaks":
        """Return the peaks of several fields together."""
        return Peaks(*map(np.concatenate, zip(*parts, strict=True)))


class Place(NamedTuple):
    """A row of :class:`Peaks` without its response."""

    centre: tuple[float, float]
    scale: float
    field: int
    template: int


def strongest(peaks: Peaks, apart: float, count: int) -> np.ndarray:
    """Return indices of the strongest peaks, without those near a stronger one of similar size."""
    left, chosen = peaks.responses.copy(), []
    logs = np.log(peaks.scales)
    while len(chosen) < count and left.size and left.max() > 0:
        best = int(left.argmax())
        chosen.append(best)
        near = np.linalg.norm(peaks.centres - peaks.centres[best], axis=1) < apart * np.minimum(
            peaks.scales, peaks.scales[best]
        )
        left[near & (np.abs(logs - logs[best]) < 0.3)] = 0.0
        left[best] = 0.0
    return np.array(chosen, dtype=int)
