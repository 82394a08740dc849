"""Responses of templates: their correlation with an image's gradient orientations, and its strongest maxima."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from liaam import _core
from liaam.fitting.search.templates import Field, OrientationTemplate, channels_of, spectra

# Sides of tiles, into which fields are cut, in those of the largest template. Tiles overlap by one template, which is
# computed twice. As they have few sizes, the spectra of templates serve images of many sizes.
TILES = (1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 5.0, 6.0)
# Number of pixels of tiles for which spectra are kept, about 320 bytes each of learnt filters.
SPECTRA_KEPT = 600_000
SURROUNDINGS = 2  # radius in pixels within which a place has to be the maximum
LEAST_RESPONSE = 1e-3  # of a place, so that flat regions have none
# Difference of the logarithms of sizes below which two peaks may show the same object: those of neighbouring sizes,
# which are a factor of 1.2 apart, but not of the next ones.
SIMILAR_SIZES = 0.3


class Peaks(NamedTuple):
    """Local maxima of the templates' responses."""

    centres: np.ndarray  # (k, 2) float64: centre of the shape, image pixels
    scales: np.ndarray  # (k,) float64: image pixels per pixel of the reduced model
    fields: np.ndarray  # (k,) int: index of the image's field
    templates: np.ndarray  # (k,) int: index of the template
    responses: np.ndarray  # (k,) float64: mean cosine between expected and measured orientation, by length of both


class Bank:
    """Templates that are correlated with fields of images.

    Objects may extend ``pad`` pixels beyond a field. Responses are mean cosines; or the correlations themselves, if the
    templates are ``normalised`` already, as learnt filters are.
    """

    def __init__(self, templates: Sequence[OrientationTemplate], pad: int, normalised: bool = False) -> None:
        self.templates = tuple(templates)
        self.pad = pad
        self.normalised = normalised
        self.shapes = np.array([template.field.shape[1:] for template in templates])
        self.origins = np.array([template.origin for template in templates])
        self.n_channels = max(len(template.field) for template in templates)
        n_fields = len(templates) + len(templates) % 2  # an even number, for pairs; the last field may be empty
        fields = np.zeros((n_fields, self.n_channels, *self.shapes.max(axis=0)), np.float32)
        for i, template in enumerate(self.templates):
            n_channels, height, width = template.field.shape
            norm = 1.0 if normalised else max(float(np.hypot(*template.field[:2]).sum()), 1e-9)
            fields[i, :n_channels, :height, :width] = template.field / norm
        # With corr(f, t) the sum of a channel f times the conjugate of t, the response to a template a plus i times
        # that to another one b is the sum over channels of corr(f, a - i b), which is kept for each pair.
        self.pairs = fields[::2] - 1j * fields[1::2]
        self._spectra: dict[tuple[int, int], list[np.ndarray]] = {}

    def peaks(self, field: Field, which: int, count: int, worth: float) -> Peaks:
        """Return the strongest local maxima of each template's correlation with a field, at most ``count`` of each.

        ``which`` is the index of the field. Maxima below the fraction ``worth`` of the strongest may be left out.
        """
        size = np.maximum(np.array(field.values.shape) + 2 * self.pad, self.shapes.max(axis=0))  # of the padded field
        floor = LEAST_RESPONSE
        places = []
        responses = []
        # Of an odd number of templates, there is one correlation more: that with the empty field of the last pair.
        for _, cosine in zip(self.templates, self._correlated(field, size), strict=False):
            places_of_template, values = _core.best_peaks(cosine, count, floor, SURROUNDINGS)
            if len(values):
                floor = max(floor, worth * float(values[0]))
            places.append(places_of_template)
            responses.append(values)
        numbers = np.repeat(np.arange(len(self.templates)), [len(values) for values in responses])
        first_pixels = np.concatenate(places)[:, ::-1]  # (x, y) of the templates in the padded field
        return Peaks(
            centres=field.to_image(first_pixels - self.origins[numbers] - self.pad),
            scales=np.full(len(numbers), field.scale),
            fields=np.full(len(numbers), which),
            templates=numbers,
            responses=np.concatenate(responses),
        )

    def _correlated(self, field: Field, size: np.ndarray) -> Iterator[np.ndarray]:
        """Yield the correlation with each template in turn, (rows, columns) float32, where the largest fits in.

        At each position it is the sum of the cosines between orientations, times the lengths of both. One inverse
        transform makes those of two templates, as its real and its imaginary part (see ``pairs``).
        """
        import cv2  # heavy: imported when first needed

        rows, columns = (self._tiles_along(axis, int(length)) for axis, length in enumerate(size))
        sides = rows.side, columns.side
        places = [(top, left) for top in rows.starts for left in columns.starts]
        channels = channels_of(field.values, self.n_channels)
        spectra_of_tiles = [spectra(*self._cut(channels, place, sides), sides) for place in places]
        product = np.empty((*sides, 2), np.float32)
        n_rows, n_columns = size + 1 - self.shapes.max(axis=0)
        is_one_tile = len(places) == 1
        whole = product[:n_rows, :n_columns] if is_one_tile else np.empty((n_rows, n_columns, 2), np.float32)
        for spectra_of_pair in self._spectra_of(sides):
            for (top, left), spectra_of_tile in zip(places, spectra_of_tiles, strict=True):
                _core.correlate(spectra_of_tile, spectra_of_pair, product)
                cv2.idft(product, product)
                if not is_one_tile:
                    part = whole[top : top + rows.step, left : left + columns.step]
                    part[:] = product[: part.shape[0], : part.shape[1]]
            yield whole[..., 0]
            yield whole[..., 1]

    def _tiles_along(self, axis: int, length: int) -> "_Tiles":
        """Return the tiles of a padded field of a length along an axis that have the fewest pixels together."""
        import cv2  # heavy: imported when first needed

        longest = int(self.shapes[:, axis].max())
        choices = []
        for times in TILES:
            side = cv2.getOptimalDFTSize(int(times * longest))
            step = side + 1 - longest
            choices.append(_Tiles(side, step, range(0, length - longest + 1, step)))
        return min(choices, key=lambda tiles: tiles.side * len(tiles.starts))

    def _cut(
        self, channels: np.ndarray, place: tuple[int, int], sides: tuple[int, int]
    ) -> tuple[np.ndarray, tuple[int, int]]:
        """Return a tile's part of the channels of a field, (c, h, w), and its first row and column in the tile.

        The tile is one of the padded field, in which the field itself begins at row and column ``pad``.
        """
        (top, left), (height, width) = place, sides
        first_row = max(top - self.pad, 0)
        first_column = max(left - self.pad, 0)
        part = channels[:, first_row : max(top + height - self.pad, 0), first_column : max(left + width - self.pad, 0)]
        return part, (max(self.pad - top, 0), max(self.pad - left, 0))

    def _spectra_of(self, sides: tuple[int, int]) -> list[np.ndarray]:
        """Return the spectra of all pairs of templates for tiles of a size; those of the last sizes are kept."""
        kept = self._spectra.get(sides)
        if kept is not None:
            return kept
        n_pixels = float(np.prod(sides))  # OpenCV's inverse is not normalised
        spectra_of_pairs = [spectra(pair / n_pixels, (0, 0), sides) for pair in self.pairs]
        sizes = [*self._spectra, sides]  # a copy: other threads may search at the same time
        while sum(height * width for height, width in sizes) > SPECTRA_KEPT and len(sizes) > 1:  # remove the oldest
            self._spectra.pop(sizes.pop(0), None)
        self._spectra[sides] = spectra_of_pairs
        return spectra_of_pairs

    def __getstate__(self) -> dict:
        """Leave out the spectra, which are large and quick to compute."""
        return {**self.__dict__, "_spectra": {}}


class _Tiles(NamedTuple):
    """Tiles of a padded field along an axis."""

    side: int  # pixels of one
    step: int  # positions at which every template lies in a tile
    starts: range  # first pixels


def joined(parts: Sequence[Peaks]) -> Peaks:
    """Return the maxima of several fields as one record."""
    return Peaks(
        centres=np.concatenate([peaks.centres for peaks in parts]),
        scales=np.concatenate([peaks.scales for peaks in parts]),
        fields=np.concatenate([peaks.fields for peaks in parts]),
        templates=np.concatenate([peaks.templates for peaks in parts]),
        responses=np.concatenate([peaks.responses for peaks in parts]),
    )


def strongest(peaks: Peaks, apart: float, count: int) -> np.ndarray:
    """Return indices of the ``count`` strongest peaks, without those near a stronger one of similar size.

    Peaks are near each other if they are less than ``apart`` pixels of the reduced model apart.
    """
    responses = peaks.responses.copy()  # 0 where a peak is chosen, or near one
    log_scales = np.log(peaks.scales)
    chosen = []
    while len(chosen) < count and responses.size and responses.max() > 0:
        best = int(responses.argmax())
        chosen.append(best)
        distances = np.linalg.norm(peaks.centres - peaks.centres[best], axis=1)
        is_near = distances < apart * np.minimum(peaks.scales, peaks.scales[best])
        is_similar = np.abs(log_scales - log_scales[best]) < SIMILAR_SIZES
        responses[is_near & is_similar] = 0.0
        responses[best] = 0.0
    return np.array(chosen, dtype=int)
