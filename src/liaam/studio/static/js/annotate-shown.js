// What the Annotate tab draws beside the points, and which pictures it shows mirrored.

/** Event "change": something else is drawn. */
export class Shown extends EventTarget {
  #drawn = { names: false, contours: true, ellipses: true, measures: true };
  #mirrored = new Set(); // names of pictures

  /** Whether each of names, contours, ellipses and measures is drawn. */
  get drawn() { return { ...this.#drawn }; }

  draw(what, on = true) {
    this.#drawn[what] = on;
    this.dispatchEvent(new Event("change"));
  }

  /** Draw something, or no longer; return which. */
  toggle(what) {
    this.draw(what, !this.#drawn[what]);
    return this.#drawn[what];
  }

  isMirrored(picture) { return this.#mirrored.has(picture); }

  /** Show a picture mirrored, or as it is; return which. */
  toggleMirrored(picture) {
    if (!this.#mirrored.delete(picture)) this.#mirrored.add(picture);
    return this.#mirrored.has(picture);
  }
}
