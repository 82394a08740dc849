// Starts of a fit: a drawn box, or the model's mean shape dragged onto the object.

import {
  boxAfterKey, boxBetween, boxMoved, firstPlacement, handlesOf, isDrawn, isWithin, normalised, placed,
  placementAfterKey, pulled,
} from "./fit-geometry.js";
import { drawContours, drawMesh, drawPoints } from "./overlays.js";

const REACH = 14; // css pixels around a handle
const REACH_TOUCH = 24;
const KNOB = 34; // css pixels between the box and its knob
const COLOUR = "#5ad1ff";

const reachOf = (event) => (event?.pointerType === "touch" ? REACH_TOUCH : REACH);

function isNear(viewer, point, xy, event) {
  const [ax, ay] = viewer.toScreen(point);
  const [bx, by] = viewer.toScreen(xy);
  return Math.hypot(ax - bx, ay - by) <= reachOf(event);
}

/** Draw a handle: a square, or a knob if it is round. */
function handle(ctx, [x, y], isRound = false) {
  ctx.beginPath();
  if (isRound) ctx.arc(x, y, 7, 0, 2 * Math.PI);
  else ctx.rect(x - 5, y - 5, 10, 10);
  ctx.fillStyle = "#ffffff";
  ctx.fill();
  ctx.strokeStyle = "#0b4a66";
  ctx.lineWidth = 1.5;
  ctx.stroke();
}

function outline(ctx, corners) {
  ctx.beginPath();
  corners.forEach(([x, y], i) => (i ? ctx.lineTo(x, y) : ctx.moveTo(x, y)));
  ctx.closePath();
  for (const [colour, width] of [["rgb(0 0 0 / 50%)", 3.5], [COLOUR, 1.6]]) {
    ctx.strokeStyle = colour;
    ctx.lineWidth = width;
    ctx.stroke();
  }
}

/** A box around the object; `ready` is called when it has been drawn. */
export class BoxTool {
  constructor(viewer, ready) {
    this.viewer = viewer;
    this.box = null;
    this._ready = ready;
    this._drag = null;
  }

  get start() { return this.box && isDrawn(this.box) ? { box: this.box } : null; }

  clear() {
    this.box = null;
    this._drag = null;
  }

  down(event, xy) {
    const before = this.box;
    this._drag = { kind: "draw", from: xy, before };
    if (before) {
      const [x0, y0, x1, y1] = before;
      const corners = [[x0, y0], [x1, y0], [x1, y1], [x0, y1]];
      const near = corners.findIndex((corner) => isNear(this.viewer, corner, xy, event));
      // While a corner is dragged, the opposite one stays.
      if (near >= 0) this._drag = { kind: "draw", from: corners[(near + 2) % 4], before };
      else if (xy[0] > x0 && xy[0] < x1 && xy[1] > y0 && xy[1] < y1) this._drag = { kind: "move", from: xy, before };
    }
    return true;
  }

  move(event, xy) {
    if (!this._drag) return;
    const { kind, from, before } = this._drag;
    const { width, height } = this.viewer;
    const [dx, dy] = [xy[0] - from[0], xy[1] - from[1]];
    this.box = kind === "move" ? boxMoved(before, [dx, dy], width, height) : boxBetween(from, xy, width, height);
    this.viewer.redraw();
  }

  up() {
    const before = this._drag?.before ?? null;
    this._drag = null;
    // Ignore a click or a very short drag.
    if (!this.start) this.box = before;
    this.viewer.redraw();
    if (this.start && this.box !== before) this._ready();
  }

  cancel() {
    if (this._drag) this.box = this._drag.before;
    this._drag = null;
    this.viewer.redraw();
  }

  cursor() {
    return "crosshair";
  }

  key(event) {
    const box = boxAfterKey(this.box, event, this.viewer.width, this.viewer.height);
    if (!box) return false;
    this.box = box;
    this.viewer.redraw();
    return true;
  }

  draw(ctx, viewer) {
    if (!this.box) return;
    const [x0, y0, x1, y1] = this.box;
    const corners = [[x0, y0], [x1, y0], [x1, y1], [x0, y1]].map((corner) => viewer.toScreen(corner));
    outline(ctx, corners);
    corners.forEach((corner) => handle(ctx, corner));
  }
}

/** The mean shape: dragged, scaled by its corners and rotated by its knob. */
export class MeanTool {
  constructor(viewer) {
    this.viewer = viewer;
    this.unit = null;
    this.placement = null;
    this.fitted = false; // whether the fit from this start is shown; then only the frame is drawn until it is moved
    this._drag = null;
  }

  get start() { return this.placement && this.unit ? { shape: placed(this.unit, this.placement) } : null; }

  /** Whether the last fit is hidden while the shape is placed. */
  get hidesFit() { return !this.fitted && this.start !== null; }

  /** Set the model's mean shape, in any units. */
  use(shape, { contours, triangles }) {
    this.unit = normalised(shape);
    this.contours = contours ?? [];
    this.triangles = triangles ?? [];
    this.placement ??= firstPlacement(this.viewer.width, this.viewer.height);
    this.viewer.redraw();
  }

  clear() {
    this.placement = this.viewer.width ? firstPlacement(this.viewer.width, this.viewer.height) : null;
    this._drag = null;
  }

  _grasped(event, xy) {
    if (!this.unit || !this.placement) return null;
    const { corners, knob } = this._handles();
    if (isNear(this.viewer, knob, xy, event)) return "turn";
    if (corners.some((corner) => isNear(this.viewer, corner, xy, event))) return "size";
    return isWithin(this.unit, this.placement, xy) ? "move" : null;
  }

  _handles() {
    return handlesOf(this.unit, this.placement, KNOB / this.viewer.scale);
  }

  down(event, xy) {
    const what = this._grasped(event, xy);
    if (!what) return false;
    this._drag = { what, from: xy, before: this.placement };
    return true;
  }

  move(event, xy) {
    if (!this._drag) return;
    this.fitted = false;
    const { what, from, before } = this._drag;
    const moved = () => ({ ...before, x: before.x + xy[0] - from[0], y: before.y + xy[1] - from[1] });
    this.placement = what === "move" ? moved() : pulled(before, from, xy, what);
    this.viewer.redraw();
  }

  up() {
    this._drag = null;
  }

  cancel() {
    if (this._drag) this.placement = this._drag.before;
    this._drag = null;
    this.viewer.redraw();
  }

  cursor(event, xy) {
    return { turn: "grab", size: "nwse-resize", move: "move" }[this._grasped(event, xy)] ?? "";
  }

  key(event) {
    const next = this.placement && placementAfterKey(this.placement, event);
    if (!next) return false;
    this.placement = next;
    this.fitted = false;
    this.viewer.redraw();
    return true;
  }

  draw(ctx, viewer) {
    if (!this.start) return;
    const { shape } = this.start;
    if (!this.fitted) this._drawShape(ctx, viewer, shape);
    const { corners, top, knob } = this._handles();
    const at = corners.map((corner) => viewer.toScreen(corner));
    outline(ctx, at);
    const [from, to] = [viewer.toScreen(top), viewer.toScreen(knob)];
    ctx.beginPath();
    ctx.moveTo(...from);
    ctx.lineTo(...to);
    ctx.strokeStyle = COLOUR;
    ctx.stroke();
    at.forEach((corner) => handle(ctx, corner));
    handle(ctx, to, true);
  }

  _drawShape(ctx, viewer, shape) {
    if (this.contours.length) drawContours(ctx, viewer, shape, this.contours, { colour: COLOUR, width: 1.6 });
    else drawMesh(ctx, viewer, shape, this.triangles, { colour: "rgb(90 209 255 / 55%)" });
    drawPoints(ctx, viewer, shape, { colour: COLOUR, radius: 2.5 });
  }
}

/**
 * The model's mean shape: from the server, else the template's layout, else the start of a fit, which is the mean shape
 * placed by the search. Null if none is known.
 */
export function meanShape(project, fit) {
  const { model, template } = project ?? {};
  if (model?.mean) return model.mean;
  const layout = template?.points; // for models without a mean
  if (layout && layout.length === model?.n_points && layout.every(Boolean)) return layout;
  return fit?.iterations?.[0]?.shape ?? null;
}
