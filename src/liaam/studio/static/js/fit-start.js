// Starts of a fit: a drawn box, or the model's mean shape dragged onto the object.

import { drawFrame, drawHandle } from "./drawing.js";
import { CURSORS, dragging, Editable, frameOf, handleAt, handleReach, turning } from "./gestures.js";
import { drawContours, drawMesh, drawPoints, lines, stroked } from "./overlays.js";
import { ARROWS, bounds, cornersOf, fitInto, indicesOf, middleOf, move, nearest, turn } from "./points.js";

const COLOUR = "#5ad1ff";
const SMALLEST = 12; // longer side of the placed mean shape, picture pixels

const isInside = (/** @type {number[]} */ [x0, y0, x1, y1], /** @type {number[]} */ [x, y]) =>
  x > x0 && x < x1 && y > y0 && y < y1;

/** Whether a key enlarges (1) or shrinks (-1) the start. */
const GROWTH = { ",": -1, "<": -1, ".": 1, ">": 1 };

/** Box between two corners in any order, clipped to the picture. */
export function boxBetween(a, b, width, height) {
  const inside = ([x, y]) => [Math.min(Math.max(x, 0), width - 1), Math.min(Math.max(y, 0), height - 1)];
  return bounds([inside(a), inside(b)]);
}

/** Whether a box is large enough to be intended. @param {number[]} box */
export const isDrawn = ([x0, y0, x1, y1], least = 8) => x1 - x0 >= least && y1 - y0 >= least;

/** Box after a key: arrows move it, comma and full stop resize it; null for other keys. */
export function boxAfterKey(box, { key, shiftKey = false }, width, height) {
  const step = shiftKey ? 10 : 1;
  const [x0, y0, x1, y1] = box ?? [0.25 * width, 0.2 * height, 0.75 * width, 0.8 * height];
  const move = ARROWS[key];
  const grow = step * GROWTH[key];
  if (move) return boxMoved([x0, y0, x1, y1], move.map((by) => step * by), width, height);
  if (!grow) return null;
  const grown = [x0 - grow, y0 - grow, x1 + grow, y1 + grow];
  return isDrawn(grown) ? boxBetween(grown.slice(0, 2), grown.slice(2), width, height) : [x0, y0, x1, y1];
}

export function boxMoved([x0, y0, x1, y1], /** @type {number[]} */ [dx, dy], width, height) {
  const mx = Math.min(Math.max(dx, -x0), width - 1 - x1);
  const my = Math.min(Math.max(dy, -y0), height - 1 - y1);
  return [x0 + mx, y0 + my, x1 + mx, y1 + my];
}

/** A box around the object; `ready` is called when it has been drawn. */
export class BoxTool {
  #viewer;
  #box = null;
  #drag = null;
  #ready;

  constructor(viewer, ready) {
    this.#viewer = viewer;
    this.#ready = ready;
  }

  get box() { return this.#box; }
  /** @returns {Start | null} */
  get start() { return this.#box && isDrawn(this.#box) ? { box: this.#box } : null; }

  clear() {
    this.#box = null;
    this.#drag = null;
  }

  #show(box) {
    this.#box = box;
    this.#viewer.redraw();
  }

  down(event, xy) {
    const before = this.#box;
    const { width, height, scale } = this.#viewer;
    const corners = before ? cornersOf(before) : [];
    const near = nearest(corners, xy, handleReach(event) / scale);
    const from = near < 0 ? xy : corners[(near + 2) % 4]; // while a corner is dragged, the opposite one stays
    const moves = near < 0 && before !== null && isInside(before, xy);
    const to = ([x, y]) => (moves ? boxMoved(before, [x - xy[0], y - xy[1]], width, height)
      : boxBetween(from, [x, y], width, height));
    this.#drag = { before, to };
    return true;
  }

  move(_event, xy) { if (this.#drag) this.#show(this.#drag.to(xy)); }

  up() {
    if (!this.#drag) return;
    const { before } = this.#drag;
    this.#drag = null;
    this.#show(this.start ? this.#box : before); // otherwise it was a click, or a very short drag
    if (this.start && this.#box !== before) this.#ready();
  }

  cancel() {
    this.#show(this.#drag ? this.#drag.before : this.#box);
    this.#drag = null;
  }

  cursor() { return "crosshair"; }

  key(event) {
    const box = boxAfterKey(this.#box, event, this.#viewer.width, this.#viewer.height);
    if (box) this.#show(box);
    return box !== null;
  }

  draw(ctx, viewer) {
    if (!this.#box) return;
    const corners = cornersOf(this.#box).map((corner) => viewer.toScreen(corner));
    lines(ctx, [[...corners, corners[0]]]);
    stroked(ctx, COLOUR, 1.6);
    for (const at of corners) drawHandle(ctx, "scale", at);
  }
}

/** The mean shape, which gestures edit by its frame. */
export class MeanTool extends Editable {
  #viewer;
  /** @type {Model | null} */
  #model = null;
  #placed = null; // the points
  #isFitted = false; // whether the fit from this start is shown; then only the frame is drawn until it is moved
  #gesture = null;

  constructor(viewer) {
    super();
    this.#viewer = viewer;
    this.use(null);
  }

  use(/** @type {Model | null} */ model) {
    this.#model = model;
    this.clear();
  }

  clear() {
    const { width, height } = this.#viewer;
    this.setShown(null);
    this.#placed = this.#model && width ? fitInto(this.#model.mean, width, height) : null;
    this.#gesture = null;
    this.#viewer.redraw();
  }

  /** @returns {Start | null} */
  get start() { return this.#placed && { shape: this.#placed }; }

  /** Its fit is shown, or no longer. */
  showFit(on) { this.#isFitted = on; }

  get hidesFit() { return !this.#isFitted && this.#placed !== null; }
  get points() { return this.shown ?? this.#placed ?? []; }
  framed() { return indicesOf(this.points); }

  preview(points) {
    this.setShown(points);
    if (points) this.#isFitted = false; // null: a click, or a gesture that was cancelled
    this.#viewer.redraw();
  }

  commit(points) {
    const [x0, y0, x1, y1] = bounds(points);
    // Points are rounded, so a smaller shape would not keep its form.
    if (Math.max(x1 - x0, y1 - y0) >= SMALLEST) {
      this.#placed = points;
      this.#isFitted = false;
    }
    this.preview(null);
  }

  /** The handle under the pointer, or the frame itself, which moves the shape; null: neither. */
  #grasped(event) {
    const viewer = this.#viewer;
    const at = viewer.place(event);
    const handle = handleAt(viewer, this, event);
    const frame = frameOf(viewer, this.points, this.framed());
    return handle ?? (frame && isInside(frame.box, at) ? { kind: "move" } : null);
  }

  down(event, xy) {
    const handle = this.#grasped(event);
    const all = this.framed();
    if (handle?.kind === "move") this.#gesture = dragging(this, -1, all, xy);
    else this.#gesture = handle && turning(this.#viewer, this, handle, all);
    return handle !== null;
  }

  move(event, xy) { this.#gesture?.move(xy, event); }
  up() { this.#gesture?.up(); }
  cancel() { this.#gesture?.cancel(); }
  cursor(event) { return CURSORS[this.#grasped(event)?.kind] ?? ""; }

  /** Arrows move the shape, comma and full stop scale it, brackets rotate it. */
  key({ key, shiftKey }) {
    const step = shiftKey ? 10 : 1;
    const [dx, dy] = ARROWS[key] ?? [0, 0];
    const degrees = { "[": -step, "{": -step, "]": step, "}": step }[key] ?? 0;
    const growth = step * (GROWTH[key] ?? 0);
    if (!this.#placed || !(dx || dy || degrees || growth)) return false;
    const all = this.framed();
    const centre = middleOf(bounds(this.points));
    const turned = turn(this.points, all, centre, (degrees * Math.PI) / 180, 1 + 0.01 * growth);
    this.commit(move(turned, all, step * dx, step * dy));
    return true;
  }

  draw(ctx, viewer) {
    const { points } = this;
    const model = this.#model;
    if (!points.length) return;
    if (!this.#isFitted) {
      if (model.contours.length) drawContours(ctx, viewer, points, model.contours, { colour: COLOUR });
      else drawMesh(ctx, viewer, points, model.triangles, { colour: "rgb(90 209 255 / 55%)" });
      drawPoints(ctx, viewer, points, { colour: COLOUR, radius: 2.5 });
    }
    drawFrame(ctx, viewer, points, this.framed());
  }
}
