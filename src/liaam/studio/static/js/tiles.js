// The tiles of a large picture: which of them a view needs, and those that have been fetched. Each level has half the
// width and height of the one before; level 0 is the picture itself.

const TILE = 512; // pixels, as the server makes them
const KEPT = 160; // tiles, which take a megabyte each
const AT_ONCE = 4; // requests
const FINER = 1.3; // screen pixels that a pixel of a level may cover
/** Pixels from which on a picture is shown as tiles. */
export const TILED_FROM = 25e6;

const addressOf = (level, column, row) => `${level}/${column}/${row}`;

/** The level that a zoom needs: css pixels per picture pixel, and screen pixels per css pixel. */
export const levelFor = (scale, ratio = 1) => Math.max(0, Math.floor(Math.log2(FINER / (scale * ratio))));

/** The columns and rows of the tiles of a level in a part of the picture: [left, top, right, bottom]. */
export function tilesIn(/** @type {number[]} */ [left, top, right, bottom], level, width, height) {
  const step = TILE * 2 ** level;
  const [columns, rows] = [width, height].map((side) => Math.ceil(Math.ceil(side / 2 ** level) / TILE));
  const clipped = (value, count) => Math.min(Math.max(Math.floor(value / step), 0), count - 1);
  const tiles = [];
  if (right <= 0 || bottom <= 0 || left >= width || top >= height) return tiles;
  for (let row = clipped(top, rows); row <= clipped(bottom, rows); row += 1)
    for (let column = clipped(left, columns); column <= clipped(right, columns); column += 1) tiles.push([column, row]);
  return tiles;
}

/** Event "ready": a tile has arrived. */
export class Tiles extends EventTarget {
  #version = 0; // changes with each tile that arrives
  #tiles = new Map(); // address -> bitmap, or null while it is fetched; those used last come last
  #wanted = []; // [level, column, row] of the newest view that are not there, the middle ones first
  #running = 0;

  #width;
  #height;
  #fetch;
  #coarsest;

  /** fetch(level, column, row) -> Promise of a bitmap; shown: width of the bitmap of the whole picture. */
  constructor(width, height, shown, fetch) {
    super();
    this.#width = width;
    this.#height = height;
    this.#fetch = fetch;
    this.#coarsest = Math.max(0, Math.ceil(Math.log2(width / shown)) - 1); // levels beyond are no finer than that bitmap
  }

  get version() { return this.#version; }

  /** The level, the part of the picture and the tiles that a view on a canvas needs; null if no tile is finer. */
  #need(ctx, { scale, left, top }) {
    const { a, d: ratio, e, f } = ctx.getTransform(); // a is negative if the picture is mirrored
    const level = levelFor(scale, ratio);
    if (level > this.#coarsest) return null;
    const { width, height } = ctx.canvas;
    const across = [0, width].map((place) => ((place - e) / a - left) / scale).sort((one, other) => one - other);
    const down = [0, height].map((place) => ((place - f) / ratio - top) / scale);
    const part = [across[0], down[0], across[1], down[1]];
    const tiles = tilesIn(part, level, this.#width, this.#height);
    return { level, part, ratio, tiles, isWhole: tiles.every(([column, row]) => this.#tiles.get(addressOf(level, column, row))) };
  }

  /** Whether the tiles for a view are all there, so that nothing needs to be drawn below them. */
  cover(ctx, view) { return this.#need(ctx, view)?.isWhole ?? false; }

  /** Draw the tiles that are there over the coarser ones, for a view; ask for those that lack. */
  draw(ctx, view) {
    const need = this.#need(ctx, view);
    if (!need) return;
    const { level, part, ratio, tiles, isWhole } = need;
    const { scale, left, top } = view;
    ctx.imageSmoothingQuality = "low"; // the level is right for the zoom
    for (let each = isWhole ? level : this.#coarsest; each >= level; each -= 1)
      this.#drawLevel(ctx, each, part, { scale, left, top, ratio });
    const step = TILE * 2 ** level;
    const [x, y] = [(part[0] + part[2]) / 2 / step - 0.5, (part[1] + part[3]) / 2 / step - 0.5];
    const away = ([column, row]) => Math.hypot(column - x, row - y);
    const lacking = tiles.filter(([column, row]) => !this.#tiles.has(addressOf(level, column, row)));
    this.#wanted = lacking.sort((one, other) => away(one) - away(other)).map(([column, row]) => [level, column, row]);
    this.#next();
  }

  #drawLevel(ctx, level, part, { scale, left, top, ratio }) {
    const sides = [this.#width, this.#height].map((side) => Math.ceil(side / 2 ** level));
    const [across, down] = [this.#width / sides[0], this.#height / sides[1]]; // picture pixels per pixel of the level
    const grid = (value) => Math.round(value * ratio) / ratio; // of screen pixels, so that there are no seams
    for (const [column, row] of tilesIn(part, level, this.#width, this.#height)) {
      const address = addressOf(level, column, row);
      const bitmap = this.#tiles.get(address);
      if (!bitmap) continue;
      this.#tiles.delete(address);
      this.#tiles.set(address, bitmap);
      const [x0, y0] = [grid(left + scale * across * TILE * column), grid(top + scale * down * TILE * row)];
      const [x1, y1] = [grid(left + scale * across * (TILE * column + bitmap.width)), grid(top + scale * down * (TILE * row + bitmap.height))];
      ctx.drawImage(bitmap, x0, y0, x1 - x0, y1 - y0);
    }
  }

  #next() {
    while (this.#running < AT_ONCE && this.#wanted.length) {
      const [level, column, row] = this.#wanted.shift();
      this.#load(addressOf(level, column, row), level, column, row);
    }
  }

  async #load(address, level, column, row) {
    this.#running += 1;
    this.#tiles.set(address, null);
    try {
      this.#tiles.set(address, await this.#fetch(level, column, row));
      this.#version += 1;
      for (const [old, bitmap] of this.#tiles) if (bitmap && this.#tiles.size > KEPT) this.#forget(old, bitmap);
      this.dispatchEvent(new Event("ready"));
    } catch {
      this.#tiles.delete(address); // the next drawing asks again
    }
    this.#running -= 1;
    this.#next();
  }

  #forget(address, bitmap) {
    this.#tiles.delete(address);
    bitmap.close();
  }

  /** Free all tiles. */
  close() {
    this.#wanted = [];
    for (const [address, bitmap] of this.#tiles) if (bitmap) this.#forget(address, bitmap);
  }
}
