// A picture with zoom and pan, layers drawn over it, and a tool that handles the pointer.
//
// Landmark coordinates have (0, 0) at the centre of the top-left pixel. Screen coordinates are css pixels from the
// corner of the container, which is the area that no panel covers. The canvas may be larger, so that the picture goes
// on under the panels.

import { look } from "./look.js";
import { button, h, perFrame, runKey } from "./ui.js";
import { attempt } from "./unsaved.js";

const LARGEST = 64; // maximum zoom, screen pixels per picture pixel
const EASE = 0.0016; // zoom per pixel of the wheel
const GLOW_SIZE = 8; // pixels
const SHARP_FROM = 3; // zoom from which pixels are shown as squares

export class Viewer extends EventTarget {
  tool = null;
  source = null;
  tiles = null;
  width = 0;
  height = 0;
  scale = 1;
  left = 0; // position of the picture's corner, css pixels
  top = 0;
  mirrored = false; // whether left and right of the picture are exchanged on the screen
  isLoupe = false; // whether the loupe is being drawn
  look = look.control();
  _layers = [];
  _pointers = new Map();
  _taken = null; // id of the pointer that the tool has
  _fitted = true;
  _space = false;
  _scaled = null; // {canvas, what, at}: the scaled picture, cached
  _glow = h("div.viewer-glow"); // shows a tiny copy of the picture, as tones around it
  _zoomText = h("span.number", { "aria-hidden": "true" }, "100 %");
  redraw = perFrame(() => this._draw());

  constructor(container, { label = "Picture" } = {}) {
    super();
    this.container = container;
    this.canvas = h("canvas", {
      tabindex: "0", role: "application", "aria-label": label,
      onpointerdown: (event) => this._down(event), onpointermove: (event) => this._move(event),
      onpointerup: (event) => this._end(event, "up"), onpointercancel: (event) => this._end(event, "cancel"),
      onpointerleave: (event) => this._pointers.size || this.tool?.leave?.(event),
      onwheel: (event) => this._wheel(event), oncontextmenu: (event) => event.preventDefault(),
      onkeydown: (event) => this._hold(event, "grab"), onkeyup: (event) => this._hold(event, ""),
      onblur: () => { this._space = false; },
    });
    container.classList.add("viewer");
    const tool = (label, icon, shortcut, onclick) =>
      button(label, { icon, shortcut, onclick, iconOnly: true, kind: "ghost", small: true });
    this._turnBack = button("Mirrored", {
      small: true, pressed: true, hidden: true, shortcut: "F", testid: "mirrored-view", title: "The picture is shown mirrored: show it as it is",
      onclick: () => this.dispatchEvent(new Event("unmirror")),
    });
    container.append(this._glow, this.canvas, h("div.viewer-zoom", { role: "group", "aria-label": "View" }, this._turnBack,
      tool("Zoom out", "minus", "-", () => this.zoomBy(1 / 1.3)), this._zoomText,
      tool("Zoom in", "plus", "+", () => this.zoomBy(1.3)), tool("Whole picture", "fit", "0", () => this.fit()),
      this.look));
    look.addEventListener("change", () => this.redraw());
    const watch = new ResizeObserver(() => this._resize());
    for (const element of [container, this.canvas]) watch.observe(element);
    this._resize();
  }

  /** Show a picture; width and height are those of landmark coordinates, the source may have any resolution. Tiles are
   *  drawn over it. @param {any} source; @param {import("./tiles.js").Tiles | null} tiles */
  setPicture(source, width = 0, height = 0, tiles = null) {
    const same = width === this.width && height === this.height;
    if (same && source === this.source && tiles === this.tiles) return;
    this.source = source;
    this.tiles?.removeEventListener("ready", this.redraw);
    this.tiles = tiles;
    tiles?.addEventListener("ready", this.redraw);
    this.width = width;
    this.height = height;
    if (!same) this.fit();
    this.redraw();
  }

  /** Show a part of the picture, [left, top, right, bottom], as large as it fits with a margin (css pixels). */
  fitTo(/** @type {number[]} */ [left, top, right, bottom], margin, fitted = false) {
    const { w, h } = this._size();
    this.scale = Math.min((w - 2 * margin) / (right - left), (h - 2 * margin) / (bottom - top), LARGEST);
    const middle = (left + right) / 2;
    this.left = w / 2 - this.scale * (this.mirrored ? this.width - middle : middle);
    this.top = h / 2 - (this.scale * (top + bottom)) / 2;
    this._fitted = fitted;
    this._changed();
  }

  fit() {
    const { w, h } = this._size();
    this._fitted = true;
    if (this.width && w && h) this.fitTo([0, 0, this.width, this.height], Math.min(14, 0.03 * Math.min(w, h)), true);
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

  /** Pan; return by how much, since the picture stays on the grid of the screen's pixels. */
  panBy(dx, dy) {
    const { left, top } = this;
    this.left += dx;
    this.top += dy;
    this._fitted = false;
    this._changed();
    return [this.left - left, this.top - top];
  }

  /** Set the view to that of another viewer with a picture of the same size, without the event "view". */
  setView(view) {
    Object.assign(this, view);
    this._changed(true);
  }

  get view() {
    const { scale, left, top, _fitted } = this;
    return { scale, left, top, _fitted };
  }

  /** Show the picture mirrored, or as it is. Only what is seen changes, not the coordinates of points. */
  mirror(on) {
    if (on === this.mirrored) return;
    this.mirrored = on;
    this._turnBack.hidden = !on;
    this._changed();
  }

  /** How far a point is from the picture's left border on the screen, in pixels of the picture. */
  _across(x) { return this.mirrored ? this.width - x - 0.5 : x + 0.5; }

  toScreen([x, y]) { return [this.left + this.scale * this._across(x), this.top + this.scale * (y + 0.5)]; }

  /** The corner of the picture with which a point is at a place of the screen, at a scale. */
  cornerFor([x, y], [cx, cy], scale) { return { left: cx - scale * this._across(x), top: cy - scale * (y + 0.5) }; }

  /** Picture coordinates of an event or of [cx, cy] on the screen. */
  toImage(place) {
    const [cx, cy] = Array.isArray(place) ? place : this.place(place);
    const across = (cx - this.left) / this.scale;
    return [(this.mirrored ? this.width - across : across) - 0.5, (cy - this.top) / this.scale - 0.5];
  }

  /** Position of an event on the screen, css pixels. */
  place(event) {
    const box = this.container.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  }

  /** Position of a landmark on the page, for tests. */
  toClient(point) {
    const { left, top } = this.container.getBoundingClientRect();
    const [x, y] = this.toScreen(point);
    return [left + x, top + y];
  }

  addLayer(draw) {
    this._layers.push(draw);
    this.redraw();
  }

  key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return false;
    return runKey(event, {
      "+": () => this.zoomBy(1.3), "=": () => this.zoomBy(1.3), "-": () => this.zoomBy(1 / 1.3), 0: () => this.fit(),
      a: () => {
        this.look.open = !this.look.open;
        (this.look.open ? this.look.querySelector("input") : this.canvas).focus();
      },
    });
  }

  /** Size of the area that no panel covers, css pixels. */
  _size() { return { w: this.container.clientWidth, h: this.container.clientHeight }; }

  /** Position of that area in the canvas. */
  _offset() {
    const [outer, inner] = [this.canvas, this.container].map((element) => element.getBoundingClientRect());
    return [inner.left - outer.left, inner.top - outer.top];
  }

  _resize() {
    const { canvas } = this;
    const ratio = window.devicePixelRatio || 1;
    const { w, h } = this._size();
    if (!w || !h) return;
    const [width, height] = [canvas.clientWidth, canvas.clientHeight].map((size) => Math.round(size * ratio));
    // Setting the size of a canvas clears it.
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    const [x, y] = this._offset();
    const [dx, dy] = this._at ? [this._at[0] - x, this._at[1] - y] : [0, 0];
    this._at = [x, y];
    if (this._fitted) this.fit();
    else if (dx || dy) { // a panel has moved, but not what the user looks at
      const moved = this.panBy(dx, dy);
      this._at = [x + dx - moved[0], y + dy - moved[1]]; // what rounding has left is for the next time
    }
    // Draw at once, because a resized canvas is blank.
    this._draw();
  }

  _changed(silent = false) {
    const ratio = window.devicePixelRatio || 1;
    // On the grid of pixels, so that panning can reuse what is drawn.
    for (const side of ["left", "top"]) this[side] = Math.round(this[side] * ratio) / ratio;
    this._zoomText.textContent = `${Math.round(100 * this.scale)} %`;
    this.redraw();
    if (!silent) this.dispatchEvent(new Event("view"));
  }

  _draw() {
    const { canvas } = this;
    // In a hidden tab, or under the wall; drawn when it is shown again and resized.
    if (!this.container.clientWidth || !canvas.width || !canvas.clientWidth) return;
    const ctx = canvas.getContext("2d");
    const ratio = canvas.width / (canvas.clientWidth || 1);
    const [x, y] = this._offset();
    ctx.setTransform(1, 0, 0, 1, 0, 0);
    ctx.clearRect(0, 0, canvas.width, canvas.height);
    if (!("filter" in ctx)) canvas.style.filter = look.filter; // in Safari: changes the points, too
    if (this.source && this.width) ctx.drawImage(this._scaledTo(canvas, ratio, x, y), 0, 0);
    else this._showGlow(this._scaled = null);
    ctx.setTransform(ratio, 0, 0, ratio, ratio * x, ratio * y);
    this._drawLayers(ctx);
  }

  _drawLayers(ctx) {
    for (const draw of this._layers) {
      ctx.save();
      draw(ctx, this);
      ctx.restore();
    }
  }

  _drawPicture(ctx) {
    ctx.save();
    if (this.mirrored) {
      ctx.translate(2 * this.left + this.scale * this.width, 0);
      ctx.scale(-1, 1);
    }
    ctx.filter = look.filter;
    ctx.imageSmoothingEnabled = this.scale < SHARP_FROM;
    ctx.imageSmoothingQuality = this.tiles && this.scale * this.width > this.source.width ? "low" : "high"; // tiles follow
    if (!this.tiles?.cover(ctx, this))
      ctx.drawImage(this.source, this.left, this.top, this.scale * this.width, this.scale * this.height);
    this.tiles?.draw(ctx, this);
    ctx.restore();
  }

  /** Draw the picture and its layers with another view, as in a loupe. */
  drawAs(ctx, view) {
    const { view: before } = this;
    Object.assign(this, view, { isLoupe: true });
    this._drawPicture(ctx);
    this._drawLayers(ctx);
    Object.assign(this, before, { isLoupe: false });
  }

  /** The scaled picture on a canvas of the same size. It is cached, because scaling takes longer than other drawing. */
  _scaledTo({ width, height }, ratio, x, y) {
    const { source } = this;
    const what = [source, this.mirrored, this.tiles?.version, this.scale, this.width, this.height, ratio, width, height, look.values];
    const at = [this.left + x, this.top + y].map((v) => v * ratio);
    const before = this._scaled;
    const moved = what.every((value, i) => value === before?.what[i]) && at.map((v, i) => v - before.at[i]);
    if (moved && !moved[0] && !moved[1]) return before.canvas;
    const canvas = before?.canvas ?? document.createElement("canvas");
    const ctx = canvas.getContext("2d");
    const isShift = moved && moved.every((v) => Math.abs(v - Math.round(v)) < 1e-6);
    if (!isShift) Object.assign(canvas, { width, height }); // also clears it
    const whole = [[0, 0, width, height]];
    for (const [left, top, across, down] of isShift ? shifted(ctx, moved.map(Math.round)) : whole) {
      ctx.save();
      ctx.beginPath();
      ctx.rect(left, top, across, down);
      ctx.clip();
      ctx.clearRect(left, top, across, down); // strips overlap, and pictures may be transparent
      ctx.setTransform(ratio, 0, 0, ratio, ratio * x, ratio * y);
      this._drawPicture(ctx);
      ctx.restore();
    }
    this._scaled = { canvas, what, at };
    this._showGlow(canvas, [at[0], at[1], ratio * this.scale * this.width, ratio * this.scale * this.height]);
    return canvas;
  }

  /** Show the tones of the picture, which is at `box` of a canvas, around it. */
  _showGlow(canvas, /** @type {number[]} */ [left, top, width, height] = []) {
    this._glow.hidden = !canvas;
    if (!canvas) return;
    const isWhole = left >= 0 && top >= 0 && left + width <= canvas.width && top + height <= canvas.height;
    if (this._glowOf === this.source || !isWhole) return;
    this._glowOf = this.source;
    const tiny = Object.assign(document.createElement("canvas"), { width: GLOW_SIZE, height: GLOW_SIZE });
    tiny.getContext("2d").drawImage(canvas, left, top, width, height, 0, 0, GLOW_SIZE, GLOW_SIZE);
    this._glow.style.backgroundImage = `url(${tiny.toDataURL()})`;
  }

  // Pointers go to the tool first; otherwise they pan, and two fingers zoom.

  _wheel(event) {
    event.preventDefault();
    const step = event.deltaMode === 1 ? 16 * event.deltaY : event.deltaY;
    this.zoomBy(Math.exp(-EASE * Math.max(-300, Math.min(300, step)) * (event.ctrlKey ? 4 : 1)), this.place(event));
  }

  _hold(event, cursor) {
    if (event.key !== " ") return;
    event.preventDefault();
    this._space = cursor !== "";
    this._cursor = cursor;
  }

  set _cursor(cursor) { this.canvas.style.cursor = cursor; }

  _down(event) {
    this.canvas.focus({ preventScroll: true });
    this._pointers.set(event.pointerId, [event.clientX, event.clientY]);
    attempt(() => this.canvas.setPointerCapture(event.pointerId)); // it may have been released already
    if (this._pointers.size === 2) { // a second finger ends the tool's gesture
      if (this._taken != null) this.tool?.cancel?.(event);
      this._taken = null;
      return;
    }
    const mine = this._space || event.button === 1 || event.button === 2;
    const isFirst = !mine && this._pointers.size === 1;
    if (isFirst && this.tool?.down?.(event, this.toImage(event))) this._taken = event.pointerId;
    else this._cursor = "grabbing";
    event.preventDefault();
  }

  _move(event) {
    const before = this._pointers.get(event.pointerId);
    if (!before) {
      this.tool?.hover?.(event, this.toImage(event));
      this._cursor = this._space ? "grab" : this.tool?.cursor?.(event, this.toImage(event)) ?? "";
      return;
    }
    if (this._taken === event.pointerId) return this.tool?.move?.(event, this.toImage(event));
    const now = [event.clientX, event.clientY];
    if (this._pointers.size === 2) this._pinch(event.pointerId, before, now);
    else if (this._taken == null) {
      const [dx, dy] = this.panBy(now[0] - before[0], now[1] - before[1]);
      now.splice(0, 2, before[0] + dx, before[1] + dy);
    }
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

  _end(event, how) {
    if (!this._pointers.delete(event.pointerId)) return;
    this._cursor = "";
    if (this._taken !== event.pointerId) return;
    this._taken = null;
    this.tool?.[how]?.(event, this.toImage(event));
  }
}

/** Move what is drawn by whole pixels; return the strips [x, y, width, height] that have become free. */
function shifted(ctx, /** @type {number[]} */ [dx, dy]) {
  const { canvas } = ctx;
  const { width, height } = canvas;
  ctx.globalCompositeOperation = "copy";
  ctx.drawImage(canvas, dx, dy);
  ctx.globalCompositeOperation = "source-over";
  const [across, down] = [Math.abs(dx), Math.abs(dy)];
  return [[dx > 0 ? 0 : width - across, 0, across, height], [0, dy > 0 ? 0 : height - down, width, down]];
}
