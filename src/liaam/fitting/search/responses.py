"""Responses of templates: their correlation with an image's gradient orientations, and its strongest maxima."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from liaam import _core
from liaam.fitting.search.templates import Field, OrientationTemplate, spectra

# Number of field pixels for which spectra are cached, about 100 bytes each. Larger fields, of panoramas and strips, are
# cut into tiles of so many pixels at most, so that memory for spectra and the time per pixel do not grow with them.
SPECTRA_KEPT = 600_000
SURROUNDINGS = 2  # radius in pixels within which a place has to be the maximum
LEAST_RESPONSE = 1e-3  # of a place, so that flat regions have none
# Difference of the logarithms of sizes below which two peaks may show the same object: those of neighbouring sizes,
# which are a factor of 1.2 apart, but not of the next ones.
SIMILAR_SIZES = 0.3
# Least length of a tile, in lengths of the longest template: tiles overlap by one of these, which is computed twice.
TEMPLATES_PER_TILE = 4


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
        self.shapes = np.array([template.field.shape for template in templates])
        self.origins = np.array([template.origin for template in templates])
        n_fields = len(templates) + len(templates) % 2  # an even number, for pairs; the last field may be empty
        fields = np.zeros((n_fields, *self.shapes.max(axis=0)), np.complex64)
        for i, template in enumerate(self.templates):
            height, width = template.field.shape
            norm = 1.0 if normalised else max(float(np.abs(template.field).sum()), 1e-9)
            fields[i, :height, :width] = template.field / norm
        first = fields[::2]
        second = fields[1::2]
        # With corr(f, t) the sum of f times the conjugate of t, the real response to a template t is half the sum of
        # corr(f, t) and corr(conj f, conj t). Of a pair a and b, the response to a plus i times that to b is therefore
        # corr(f, a - i b) / 2 + corr(conj f, conj a - i conj b) / 2. These two fields are kept for each pair.
        self.pairs = 0.5 * np.stack([first - 1j * second, first.conj() - 1j * second.conj()], axis=1)
        self._spectra: dict[tuple[int, int], list[np.ndarray]] = {}

    def peaks(self, field: Field, which: int, count: int, worth: float) -> Peaks:
        """Return the strongest local maxima of each template's correlation with a field, at most ``count`` of each.

        ``which`` is the index of the field. Maxima below the fraction ``worth`` of the strongest may be left out.
        """
        size = np.maximum(np.array(field.values.shape) + 2 * self.pad, self.shapes.max(axis=0))  # of the padded field
        n_positions = (size + 1 - self.shapes).tolist()  # of each template in it: (rows, columns)
        floor = LEAST_RESPONSE
        places = []
        responses = []
        # Of an odd number of templates, there is one correlation more: that with the empty field of the last pair.
        for (height, width), cosine in zip(n_positions, self._correlated(field, size), strict=False):
            places_of_template, values = _core.best_peaks(cosine[:height, :width], count, floor, SURROUNDINGS)
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
        """Yield the correlation with each template in turn, (rows, columns) float32.

        At each position it is the sum of the cosines between orientations, times the lengths of both. One inverse
        transform makes those of two templates, as its real and its imaginary part (see ``pairs``).
        """
        import cv2  # heavy: imported when first needed

        fast, tiles = self._tiles(size)
        spectra_of_tiles = [spectra(*self._cut(field.values, tile), fast) for tile in tiles]
        product = np.empty((*fast, 2), np.float32)
        whole = product if len(tiles) == 1 else np.empty((*size, 2), np.float32)
        for spectra_of_pair in self._spectra_of(fast):
            for tile, spectra_of_tile in zip(tiles, spectra_of_tiles, strict=True):
                _core.correlate(spectra_of_tile, spectra_of_pair, product)
                cv2.idft(product, product)
                if whole is not product:
                    # Where templates reach beyond the tile's end, the product is wrong: the next tile overwrites that.
                    part = whole[tile]
                    part[:] = product[: part.shape[0], : part.shape[1]]
            yield whole[..., 0]
            yield whole[..., 1]

    def _tiles(self, size: np.ndarray) -> tuple[tuple[int, int], list[tuple[slice, slice]]]:
        """Cut a padded field of a size along its longer side; return the size of transforms, and the tiles.

        Tiles overlap, so that each template lies in one of them wherever it is.
        """
        import cv2  # heavy: imported when first needed

        axis = int(size[1] >= size[0])  # the longer one: 0 for rows, 1 for columns
        length = int(size[axis])
        breadth = int(size[1 - axis])
        longest_template = int(self.shapes[:, axis].max())
        shortest_template = int(self.shapes[:, axis].min())
        longest_tile = max(SPECTRA_KEPT // breadth, TEMPLATES_PER_TILE * longest_template)
        tile_size = size.copy()
        tile_size[axis] = min(length, longest_tile)
        fast = int(cv2.getOptimalDFTSize(int(tile_size[0]))), int(cv2.getOptimalDFTSize(int(tile_size[1])))
        if length <= longest_tile:
            return fast, [(slice(0, int(size[0])), slice(0, int(size[1])))]
        step = fast[axis] + 1 - longest_template  # positions at which every template lies in a tile
        across = slice(0, breadth)
        tiles = []
        for first in range(0, length - shortest_template + 1, step):
            along = slice(first, min(first + fast[axis], length))
            tiles.append((along, across) if axis == 0 else (across, along))
        return fast, tiles

    def _cut(self, values: np.ndarray, tile: tuple[slice, slice]) -> tuple[np.ndarray, tuple[int, int]]:
        """Return a tile's part of a field and its conjugate, (2, h, w), and its first row and column in the tile.

        A tile is one of the padded field, in which the field itself begins at row and column ``pad``.
        """
        rows, columns = tile
        field_rows = slice(max(rows.start - self.pad, 0), max(rows.stop - self.pad, 0))
        field_columns = slice(max(columns.start - self.pad, 0), max(columns.stop - self.pad, 0))
        first = max(self.pad - rows.start, 0), max(self.pad - columns.start, 0)
        part = values[field_rows, field_columns]
        return np.array([part, part.conj()]), first

    def _spectra_of(self, size: tuple[int, int]) -> list[np.ndarray]:
        """Return the spectra of all pairs of templates for fields of a size; those of the last sizes are cached."""
        cached = self._spectra.get(size)
        if cached is not None:
            return cached
        n_pixels = float(np.prod(size))  # OpenCV's inverse is not normalised
        spectra_of_pairs = [spectra(pair / n_pixels, (0, 0), size) for pair in self.pairs]
        sizes = [*self._spectra, size]  # a copy: other threads may search at the same time
        while sizes and sum(height * width for height, width in sizes) > SPECTRA_KEPT:  # remove the oldest
            oldest = sizes.pop(0)
            self._spectra.pop(oldest, None)
        if sizes:  # else this one is too large to be cached
            self._spectra[size] = spectra_of_pairs
        return spectra_of_pairs

    def __getstate__(self) -> dict:
        """Leave out the spectra, which are large and quick to compute."""
        return {**self.__dict__, "_spectra": {}}


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
