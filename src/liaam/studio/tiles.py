"""Large pictures as tiles, on levels of which each has half the width and height of the one before.

All tiles of a level are made at once, when the first is asked for, and kept as JPEG. Level 0 is the picture itself: it
is decoded in strips, as the whole takes too much memory. The others are decoded smaller where the format can.
"""

from collections.abc import Iterator
from functools import partial
from math import ceil, log2, prod

import numpy as np

from liaam.drawing import as_picture
from liaam.photometry.encoding import as_colour
from liaam.studio.pictures import TILE, Kept, Pictures, PictureSource, jpeg_bytes, shown
from liaam.studio.refusal import Refusal

KEPT_BYTES = 200_000_000
"""Bytes of tiles that are kept: all levels of a picture of 200 megapixels, at up to 6 bits per pixel."""

Level = dict[tuple[int, int], bytes]
"""Tiles of a level by column and row."""


class Tiles:
    """Makes and keeps tiles; thread-safe."""

    def __init__(self, pictures: Pictures) -> None:
        self._pictures = pictures
        self._levels: Kept[tuple[str, str, int], Level] = Kept(KEPT_BYTES, lambda level: sum(map(len, level.values())))

    def get(self, source: PictureSource, level: int, column: int, row: int) -> bytes:
        """Return a tile as JPEG. Tiles at the right and lower border may be smaller."""
        if not 0 <= level <= log2(max(source.size)):
            raise Refusal(404, f"{source.name} has no level {level}: ask for 0, its full size, or a little more")
        key = (source.name, source.tag, level)
        tiles = self._levels.get(key, partial(self._made, source, level))
        if (column, row) not in tiles:
            raise Refusal(404, f"{source.name} has no tile {column}, {row} on level {level}: reload the page")
        return tiles[column, row]

    def _made(self, source: PictureSource, level: int) -> Level:
        with self._pictures.room.of(prod(source.size) if level == 0 else prod(size_at(source, level))):
            tiles: Level = {}
            for row, strip in enumerate(self._strips(source, level)):
                for column in range(ceil(strip.shape[1] / TILE)):
                    tiles[column, row] = jpeg_bytes(strip[:, TILE * column : TILE * (column + 1)])
            return tiles

    def _strips(self, source: PictureSource, level: int) -> Iterator[np.ndarray]:
        """Yield the strips of :data:`TILE` rows of a level, (h, w, 3) uint8."""
        if level == 0 and source.strips is not None and not source.raw:
            for strip in source.strips():
                yield as_picture(as_colour(strip, source.name))
            return
        to = size_at(source, level)
        image = source.preview(min(to)) if level and source.preview is not None else source.read()
        whole = shown(as_colour(image, source.name), to, source.raw)
        for top in range(0, len(whole), TILE):
            yield whole[top : top + TILE]


def size_at(source: PictureSource, level: int) -> tuple[int, int]:
    """Return the width and height of a level."""
    width, height = source.size
    return max(1, ceil(width / 2**level)), max(1, ceil(height / 2**level))
