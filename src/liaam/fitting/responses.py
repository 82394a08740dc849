"""Responses of templates: their correlation with an image's gradient orientations, and its strongest maxima."""

from collections.abc import Sequence

import numpy as np

from liaam import _core
from liaam.fitting.peaks import Peaks
from liaam.fitting.templates import Field, Template, spectra

SPECTRA_KEPT = 600_000
"""Number of field pixels for which spectra are cached, about 90 bytes each: enough for one size, except panoramas."""

SURROUNDINGS = 2
"""Radius in pixels within which a place has to be the maximum."""

LEAST_RESPONSE = 1e-3
"""Smallest response of a place."""


class Bank:
    """Templates that are correlated with fields of images.

    Parameters
    ----------
    templates : sequence of Template
    pad : int
        Number of pixels that an object may extend beyond a field.
    normalised : bool
        Whether responses are the correlations themselves, not mean cosines.
    """

    def __init__(self, templates: Sequence[Template], pad: int, normalised: bool = False) -> None:
        self.templates, self.pad = tuple(templates), pad
        self.norms = [1.0 if normalised else max(float(np.abs(t.field).sum()), 1e-9) for t in self.templates]
        self._spectra: dict[tuple[int, int], list[np.ndarray]] = {}

    def peaks(self, field: Field, which: int, count: int, worth: float) -> Peaks:
        """Return the strongest local maxima of each template's correlation with a field (of index ``which``).

        Maxima below the fraction ``worth`` of the strongest may be left out.
        """
        import cv2  # heavy: imported when first needed

        sizes = [(template.field.shape, template.origin) for template in self.templates]
        size = np.maximum(np.array(field.values.shape) + 2 * self.pad, np.max([shape for shape, _ in sizes], axis=0))
        fast = int(cv2.getOptimalDFTSize(int(size[0]))), int(cv2.getOptimalDFTSize(int(size[1])))
        seen, product, correlated = spectra(field.values, fast, self.pad), *np.empty((2, *fast), np.float32)
        places, responses, floor = [], [], LEAST_RESPONSE
        for (shape, origin), expected in zip(sizes, self._spectra_of(fast), strict=True):
            _core.correlate(seen, expected, product)
            cosine = cv2.idft(product, correlated)  # between both orientations, times their lengths
            inside = cosine[: size[0] - shape[0] + 1, : size[1] - shape[1] + 1]
            best, values = _core.best_peaks(inside, count, floor, SURROUNDINGS)
            floor = max(floor, worth * float(values[0])) if len(values) else floor
            places.append(best[:, ::-1] - origin)
            responses.append(values)
        numbers = np.repeat(np.arange(len(sizes)), [len(values) for values in responses])
        scales, same = (np.full(len(numbers), value) for value in (field.scale, which))
        centres = field.to_image(np.concatenate(places) - self.pad)
        return Peaks(centres, scales, same, numbers, np.concatenate(responses))

    def _spectra_of(self, size: tuple[int, int]) -> list[np.ndarray]:
        """Return the spectra of all templates for fields of a size; those of the last sizes are cached."""
        known = self._spectra.get(size)
        if known is not None:
            return known
        pixels = size[0] * size[1]  # OpenCV's inverse transform is not normalised
        pairs = zip(self.templates, self.norms, strict=True)
        made = [spectra(t.field, size) / (pixels * norm) for t, norm in pairs]
        kept = [*self._spectra, size]  # a copy: other threads may search at the same time
        while kept and sum(height * width for height, width in kept) > SPECTRA_KEPT:
            self._spectra.pop(kept.pop(0), None)
        if kept:
            self._spectra[size] = made
        return made

    def __getstate__(self) -> dict:
        """Leave out the spectra, which are large and quick to compute."""
        return {**self.__dict__, "_spectra": {}}
