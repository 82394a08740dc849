// A picture with zoom and pan, layers drawn over it, and a tool that handles the pointer.
//
// Landmark coordinates have (0, 0) at the centre of the top-left pixel; canvas coordinates at its corner.

import { button, h } from "./ui.js";

const LARGEST = 64; // maximum zoom, screen pixels per picture pixel
const EASE = 0.0016; // zoom per pixel of the wheel
const SHARP_FROM = 3; // zoom from which pixels are shown as squares

export class Viewer extends EventTarget {
  constructor(container, { label = "Picture" } = {}) {
    super();
    this.container = container;
    this.canvas = h("canvas", { tabindex: "0", role: "application", "aria-label": label });
    this.tool = null;
    this.source = null;
    this.width = this.height = 0;
    this.scale = 1;
    this.left = this.top = 0; // position of the picture's corner, css pixels
    this._layers = [];
    this._pointers = new Map();
    this._taken = null;
    this._fitted = true;
    this._waiting = false;
    this._space = false;
    this._scaled = null; // {canvas, view}: cached scaled picture
    this._zoomText = h("span", { class: "number", "aria-hidden": "true" }, "100 %");
    container.classList.add("viewer");
    container.append(this.canvas, h("div", { class: "viewer-zoom", role: "group", "aria-label": "Zoom" },
      button("Zoom out", { icon: "minus", iconOnly: true, kind: "ghost", small: true, shortcut: "-", onclick: () => this.zoomBy(1 / 1.3) }),
      this._zoomText,
      button("Zoom in", { icon: "plus", iconOnly: true, kind: "ghost", small: true, shortcut: "+", onclick: () => this.zoomBy(1.3) }),
      button("Whole picture", { icon: "fit", iconOnly: true, kind: "ghost", small: true, shortcut: "0", onclick: () => this.fit() }),
    ));
    this._listen();
    new ResizeObserver(() => this._resize()).observe(container);
    this._resize();
  }

  /** Show a picture; width and height are those of landmark coordinates, the source may have any resolution. */
  setPicture(source, width = 0, height = 0) {
    const same = width === this.width && height === this.height;
    if (same && source === this.source) return;
    this.source = source;
    this.width = width;
    this.height = height;
    if (!same) this.fit();
    this.redraw();
  }

  /** Replace the source of the picture; the view stays. */
  setSource(source) {
    this.source = source;
    this.redraw();
  }

  fit() {
    this._fitted = true;
    const { w, h } = this._size();
    if (!this.width || !w || !h) return;
    const margin = Math.min(24, 0.04 * w);
    this.scale = Math.min((w - 2 * margin) / this.width, (h - 2 * margin) / this.height, LARGEST);
    this.left = (w - this.scale * this.width) / 2;
    this.top = (h - this.scale * this.height) / 2;
    this._changed();
  }

  /** Show a box [x0, y0, x1, y1] of the picture with a margin. */
  show([x0, y0, x1, y1], room = 0.3) {
    const { w, h } = this._size();
    const width = (x1 - x0) * (1 + 2 * room), height = (y1 - y0) * (1 + 2 * room);
    if (!(width > 0 && height > 0 && w && h)) return;
    this._fitted = false;
    this.scale = Math.min(w / width, h / height, LARGEST);
    this.left = w / 2 - this.scale * ((x0 + x1) / 2 + 0.5);
    this.top = h / 2 - this.scale * ((y0 + y1) / 2 + 0.5);
    this._changed();
  }

  zoomBy(factor, at = null) {
    if (!this.width) return;
    const { w, h } = this._size();
    const [cx, cy] = at ?? [w / 2, h / 2];
    const least = 0.25 * Math.min(w / this.width, h / this.height, 1);
    const scale = Math.min(Math.max(this.scale * factor, least), LARGEST);
    const ratio = scale / this.scale;
    this.left = cx - ratio * (cx - this.left);
    this.top = cy - ratio * (cy - this.top);
    this.scale = scale;
    this._fitted = false;
    this._changed();
  }

  panBy(dx, dy) {
    this.left += dx;
    this.top += dy;
    this._fitted = false;
    this._changed();
  }

  /** Set the view to that of another viewer with a picture of the same size. */
  setView({ scale, left, top }, silent = false) {
    Object.assign(this, { scale, left, top, _fitted: false });
    this._changed(silent);
  }

  get view() {
    return { scale: this.scale, left: this.left, top: this.top };
  }

  toScreen([x, y]) {
    return [this.left + this.scale * (x + 0.5), this.top + this.scale * (y + 0.5)];
  }

  /** Picture coordinates of an event or of [cx, cy] in the canvas. */
  toImage(place) {
    const [cx, cy] = Array.isArray(place) ? place : this.place(place);
    return [(cx - this.left) / this.scale - 0.5, (cy - this.top) / this.scale - 0.5];
  }

  /** Position of an event in the canvas, css pixels. */
  place(event) {
    const box = this.canvas.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  }

  /** Position of a landmark on the page, for tests and tooltips. */
  toClient(point) {
    const box = this.canvas.getBoundingClientRect();
    const [x, y] = this.toScreen(point);
    return [box.left + x, box.top + y];
  }

  addLayer(draw) {
    this._layers.push(draw);
    this.redraw();
    return () => {
      this._layers = this._layers.filter((other) => other !== draw);
      this.redraw();
    };
  }

  redraw() {
    if (this._waiting) return;
    this._waiting = true;
    requestAnimationFrame(() => {
      this._waiting = false;
      this._draw();
    });
  }

  /** Handle a key of the view; return whether it was handled. */
  key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return false;
    const keys = { "+": () => this.zoomBy(1.3), "=": () => this.zoomBy(1.3), "-": () => this.zoomBy(1 / 1.3), 0: () => this.fit() };
    if (!keys[event.key]) return false;
    keys[event.key]();
    return true;
  }

  _size() {
    return { w: this.canvas.clientWidth, h: this.canvas.clientHeight };
  }

  _resize() {
    const ratio = window.devicePixelRatio || 1;
    const { w, h } = this._size();
    if (!w || !h) return;
    this.canvas.width = Math.round(w * ratio);
    this.canvas.height = Math.round(h * ratio);
    if (this._fitted) this.fit();
    // Draw at once, because a resized canvas is blank.
    this._draw();
  }

  _changed(silent = false) {
    this._zoomText.textContent = `${Math.round(100 * this.scale)} %`;
    this.redraw();
    if (!silent) this.dispatchEvent(new Event("view"));
  }

  _draw() {
    if (!this.canvas.clientWidth) return; // in a hidden tab; drawn when the tab is opened and resized
    const ctx = this.canvas.getContext("2d");
    const ratio = this.canvas.width / (this.canvas.clientWidth || 1);
    ctx.setTransform(1, 0, 0, 1, 0, 0);
    ctx.clearRect(0, 0, this.canvas.width, this.canvas.height);
    ctx.setTransform(ratio, 0, 0, ratio, 0, 0);
    if (this.source && this.width) this._drawPicture(ctx, ratio);
    else this._scaled = null;
    for (const draw of this._layers) {
      ctx.save();
      draw(ctx, this);
      ctx.restore();
    }
  }

  /** Draw the picture from a cached scaled copy, because scaling takes longer than all other drawing. */
  _drawPicture(ctx, ratio) {
    const { width, height } = this.canvas;
    const view = [this.source, this.left, this.top, this.scale, this.width, this.height, ratio, width, height];
    if (!view.every((value, i) => value === this._scaled?.view[i])) {
      const canvas = this._scaled?.canvas ?? document.createElement("canvas");
      Object.assign(canvas, { width, height }); // also clears it
      const scaled = canvas.getContext("2d");
      scaled.setTransform(ratio, 0, 0, ratio, 0, 0);
      scaled.imageSmoothingEnabled = this.scale < SHARP_FROM;
      scaled.imageSmoothingQuality = "high";
      scaled.drawImage(this.source, this.left, this.top, this.scale * this.width, this.scale * this.height);
      this._scaled = { canvas, view };
    }
    ctx.save();
    ctx.setTransform(1, 0, 0, 1, 0, 0);
    ctx.drawImage(this._scaled.canvas, 0, 0);
    ctx.restore();
  }

  // Pointers go to the tool first; otherwise they pan, and two fingers zoom.

  _listen() {
    const canvas = this.canvas;
    canvas.addEventListener("pointerdown", (event) => this._down(event));
    canvas.addEventListener("pointermove", (event) => this._move(event));
    canvas.addEventListener("pointerup", (event) => this._up(event));
    canvas.addEventListener("pointercancel", (event) => this._cancel(event));
    canvas.addEventListener("pointerleave", (event) => { if (!this._pointers.size) this.tool?.leave?.(event); });
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      const step = event.deltaMode === 1 ? 16 * event.deltaY : event.deltaY;
      this.zoomBy(Math.exp(-EASE * Math.max(-300, Math.min(300, step)) * (event.ctrlKey ? 4 : 1)), this.place(event));
    }, { passive: false });
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    canvas.addEventListener("keydown", (event) => { if (event.key === " ") this._hold(event, true); });
    canvas.addEventListener("keyup", (event) => { if (event.key === " ") this._hold(event, false); });
    canvas.addEventListener("blur", () => { this._space = false; });
  }

  _hold(event, down) {
    event.preventDefault();
    this._space = down;
    canvasCursor(this.canvas, down ? "grab" : "");
  }

  _down(event) {
    this.canvas.focus({ preventScroll: true });
    this._pointers.set(event.pointerId, [event.clientX, event.clientY]);
    try {
      this.canvas.setPointerCapture(event.pointerId);
    } catch {
      // The pointer may have been released already.
    }
    if (this._pointers.size === 2) { // a second finger ends the tool's gesture
      if (this._taken != null) this.tool?.cancel?.(event);
      this._taken = null;
      return;
    }
    const mine = this._space || event.button === 1 || event.button === 2;
    if (!mine && this._pointers.size === 1 && this.tool?.down?.(event, this.toImage(event))) this._taken = event.pointerId;
    else canvasCursor(this.canvas, "grabbing");
    event.preventDefault();
  }

  _move(event) {
    const before = this._pointers.get(event.pointerId);
    if (!before) {
      this.tool?.hover?.(event, this.toImage(event));
      canvasCursor(this.canvas, this._space ? "grab" : this.tool?.cursor?.(event, this.toImage(event)) ?? "");
      return;
    }
    if (this._taken === event.pointerId) {
      this.tool?.move?.(event, this.toImage(event));
      return;
    }
    const now = [event.clientX, event.clientY];
    if (this._pointers.size === 2) this._pinch(event.pointerId, before, now);
    else if (this._taken == null) this.panBy(now[0] - before[0], now[1] - before[1]);
    this._pointers.set(event.pointerId, now);
  }

  _pinch(id, before, now) {
    const other = [...this._pointers].find(([key]) => key !== id)[1];
    const box = this.canvas.getBoundingClientRect();
    const apart = (a) => Math.hypot(a[0] - other[0], a[1] - other[1]) || 1;
    const middle = (a) => [(a[0] + other[0]) / 2 - box.left, (a[1] + other[1]) / 2 - box.top];
    const [from, to] = [middle(before), middle(now)];
    this.panBy(to[0] - from[0], to[1] - from[1]);
    this.zoomBy(apart(now) / apart(before), to);
  }

  _up(event) {
    if (!this._pointers.delete(event.pointerId)) return;
    canvasCursor(this.canvas, "");
    if (this._taken !== event.pointerId) return;
    this._taken = null;
    this.tool?.up?.(event, this.toImage(event));
  }

  _cancel(event) {
    this._pointers.delete(event.pointerId);
    canvasCursor(this.canvas, "");
    if (this._taken !== event.pointerId) return;
    this._taken = null;
    this.tool?.cancel?.(event);
  }
}

function canvasCursor(canvas, cursor) {
  if (canvas.style.cursor !== cursor) canvas.style.cursor = cursor;
}
