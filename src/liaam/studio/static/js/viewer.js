// A picture with zoom and pan, layers drawn over it, and a tool that handles the pointer.
//
// Landmark coordinates have (0, 0) at the centre of the top-left pixel. Screen coordinates are css pixels from the
// corner of the container, which is the area that no panel covers. The canvas may be larger, so that the picture goes
// on under the panels.

import { look } from "./look.js";
import { button, h, perFrame, press, runKey } from "./ui.js";
import { attempt } from "./unsaved.js";

const LARGEST = 64; // maximum zoom, css pixels per picture pixel
const ZOOM_STEP = 1.3; // of a key or button
const WHEEL_ZOOM = 0.0016; // change of the logarithm of the zoom per pixel of the wheel
const WHEEL_LINE = 16; // pixels in a line, for wheels that count lines
const WHEEL_MOST = 300; // pixels of one event that count, since some wheels report jumps
const TRACKPAD_PINCH = 4; // times the wheel's zoom: browsers report a pinch as a slow wheel with Ctrl
const GLOW_SIZE = 8; // pixels
const MIDDLE_BUTTON = 1; // as MouseEvent.button counts
const RIGHT_BUTTON = 2;
const SHARP_FROM = 3; // zoom from which pixels are shown as squares
const SMALLEST_SHARE = 1 / 4; // of the zoom that shows the whole picture, to which the user can zoom out
const MOST_MARGIN = 14; // around the whole picture, css pixels
const MARGIN_SHARE = 0.03; // of the container's shorter side, if that is less
const BAR = 60; // css pixels that the buttons of the view need at a border, so that they cover nothing of the whole picture
const narrow = globalThis.matchMedia?.("(max-width: 899px)");

export class Viewer extends EventTarget {
  #tool = null;
  #pinched = null; // place in the picture that two fingers hold between them
  #source = null;
  #tiles = null;
  #width = 0;
  #height = 0;
  #scale = 1;
  #left = 0;
  #top = 0;
  #mirrored = false;
  #isLoupe = false;
  #showsWhole = true; // and stays so when the size of the container changes
  #look = look.control();
  #layers = [];
  #pointers = new Map(); // pointers that are down: id -> [x, y] on the page
  #toolPointer = null; // id of the pointer that the tool handles
  #spaceIsDown = false; // then a drag pans whatever the tool is
  #offsetBefore = null; // position of the container in the canvas when it was last resized
  #scaled = null; // {canvas, settings, corner}: the scaled picture, cached
  #glowOf = null; // the source that the glow shows
  #glow = h("div.viewer-glow"); // shows a tiny copy of the picture, as tones around it
  #zoomText = h("span.number", { "aria-hidden": "true" }, "100 %");
  redraw = perFrame(() => this.#draw());
  #bar; #mirrorButton; // elements

  /** mirrors: whether there is a button that asks, by an event "mirror", to show the picture mirrored, or as it is. */
  constructor(container, { label = "Picture", mirrors = false } = {}) {
    super();
    this.container = container;
    this.canvas = h("canvas", {
      tabindex: "0", role: "application", "aria-label": label,
      onpointerdown: (event) => this.#down(event), onpointermove: (event) => this.#move(event),
      onpointerup: (event) => this.#end(event, "up"), onpointercancel: (event) => this.#end(event, "cancel"),
      onpointerleave: (event) => this.#leave(event),
      onwheel: (event) => this.#wheel(event), oncontextmenu: (event) => event.preventDefault(),
      onkeydown: (event) => this.#spaceKey(event, true), onkeyup: (event) => this.#spaceKey(event, false),
      onblur: () => { this.#spaceIsDown = false; },
    });
    container.classList.add("viewer");
    this.#bar = this.#viewButtons(mirrors);
    container.append(this.#glow, this.canvas, look.notice(), this.#bar);
    look.addEventListener("change", () => this.redraw());
    const watch = new ResizeObserver(() => this.#resize());
    for (const element of [container, this.canvas]) watch.observe(element);
    this.#resize();
  }

  /** What handles the pointer, or null. */
  get tool() { return this.#tool; }
  get source() { return this.#source; }
  get width() { return this.#width; }
  get height() { return this.#height; }
  get scale() { return this.#scale; }
  /** Position of the picture's corner in the container, css pixels. */
  get left() { return this.#left; }
  get top() { return this.#top; }
  /** Whether left and right of the picture are exchanged on the screen. */
  get mirrored() { return this.#mirrored; }
  /** Whether the loupe is being drawn. */
  get isLoupe() { return this.#isLoupe; }
  /** Whether the whole picture is shown. */
  get showsWhole() { return this.#showsWhole; }

  /** Let a tool handle the pointer; null: none. */
  use(tool) {
    this.#tool = tool;
    this.redraw();
  }

  #viewButtons(mirrors) {
    const tool = (label, icon, shortcut, onclick) =>
      button(label, { icon, shortcut, onclick, iconOnly: true, kind: "ghost", small: true });
    this.#mirrorButton = button("Mirror", {
      small: true, pressed: false, hidden: !mirrors, shortcut: "F", testid: "mirrored-view", title: "Show the picture mirrored; points and files stay as they are",
      onclick: () => this.dispatchEvent(new Event("mirror")),
    });
    return h("div.viewer-zoom", { role: "group", "aria-label": "View" },
      this.#mirrorButton,
      tool("Zoom out", "minus", "-", () => this.zoomBy(1 / ZOOM_STEP)),
      this.#zoomText,
      tool("Zoom in", "plus", "+", () => this.zoomBy(ZOOM_STEP)),
      tool("Whole picture", "fit", "0", () => this.fit()),
      this.#look);
  }

  /** Show a picture; width and height are those of landmark coordinates, the source may have any resolution. Tiles are
   *  drawn over it. The view stays if the size does. @param {any} source; @param {import("./tiles.js").Tiles | null} tiles */
  setPicture(source, width = 0, height = 0, tiles = null) {
    const sameSize = width === this.#width && height === this.#height;
    if (sameSize && source === this.#source && tiles === this.#tiles) return;
    this.#source = source;
    this.#tiles?.removeEventListener("ready", this.redraw);
    this.#tiles = tiles;
    tiles?.addEventListener("ready", this.redraw);
    this.#width = width;
    this.#height = height;
    if (!sameSize) this.fit();
    this.redraw();
  }

  /** Show a part of the picture, [left, top, right, bottom] from its corner, as large as it fits with a margin (css
   *  pixels). */
  fitTo(box, margin) {
    this.#showsWhole = false;
    this.#frame(box, margin);
  }

  /** Show the whole picture. */
  fit() {
    const { clientWidth, clientHeight } = this.container;
    const margin = Math.min(MOST_MARGIN, MARGIN_SHARE * Math.min(clientWidth, clientHeight));
    this.#showsWhole = true;
    if (!this.#width || !clientWidth || !clientHeight) return;
    // The buttons stand at the right; on narrow pages where they take less of the picture.
    const scales = [[BAR, 0], [0, BAR]].map(([x, y]) => Math.min(
      (clientWidth - margin - Math.max(margin, x)) / this.#width, (clientHeight - margin - Math.max(margin, y)) / this.#height));
    const stands = !narrow?.matches || scales[0] >= scales[1];
    this.#bar.classList.toggle("upright", stands);
    this.#frame([0, 0, this.#width, this.#height], margin, stands ? [BAR, 0] : [0, BAR]);
  }

  /** room: what is kept free at the right and at the bottom, if the picture would reach there. */
  #frame(/** @type {number[]} */ [left, top, right, bottom], margin, room = [0, 0]) {
    const { clientWidth, clientHeight } = this.container;
    const [atRight, atBottom] = room.map((side) => Math.max(margin, side));
    this.#scale = Math.min((clientWidth - margin - atRight) / (right - left), (clientHeight - margin - atBottom) / (bottom - top), LARGEST);
    const middle = (left + right) / 2;
    // In the middle of the container, or as near to it as the room allows.
    const centre = (/** @type {number} */ side, /** @type {number} */ size, /** @type {number} */ kept) =>
      Math.min(side / 2, side - kept - (this.#scale * size) / 2);
    this.#left = centre(clientWidth, right - left, atRight) - this.#scale * (this.#mirrored ? this.#width - middle : middle);
    this.#top = centre(clientHeight, bottom - top, atBottom) - (this.#scale * (top + bottom)) / 2;
    this.#changed();
  }

  /** Zoom; the place `at` of the container, or else its middle, keeps what it shows. */
  zoomBy(factor, at = null) {
    if (!this.#width) return;
    const { clientWidth, clientHeight } = this.container;
    const [x, y] = at ?? [clientWidth / 2, clientHeight / 2];
    const scaleOfWhole = Math.min(clientWidth / this.#width, clientHeight / this.#height, 1);
    const scale = Math.min(Math.max(this.#scale * factor, SMALLEST_SHARE * scaleOfWhole), LARGEST);
    const ratio = scale / this.#scale;
    this.#left = x - ratio * (x - this.#left);
    this.#top = y - ratio * (y - this.#top);
    this.#scale = scale;
    this.#showsWhole = false;
    this.#changed();
  }

  /** Pan; return by how much, since the picture stays on the grid of the screen's pixels. */
  panBy(dx, dy) {
    const [left, top] = [this.#left, this.#top];
    this.#left += dx;
    this.#top += dy;
    this.#showsWhole = false;
    this.#changed();
    return [this.#left - left, this.#top - top];
  }

  /** Set the view to that of another viewer with a picture of the same size, without the event "view". */
  setView(view) {
    this.#setView(view);
    this.#show();
  }

  #setView({ scale, left, top, showsWhole = this.#showsWhole }) {
    this.#scale = scale;
    this.#left = left;
    this.#top = top;
    this.#showsWhole = showsWhole;
  }

  get view() {
    const { scale, left, top, showsWhole } = this;
    return { scale, left, top, showsWhole };
  }

  /** Show the picture mirrored, or as it is. Only what is seen changes, not the coordinates of points. */
  mirror(on) {
    if (on === this.#mirrored) return;
    this.#mirrored = on;
    press(this.#mirrorButton, on);
    this.#changed();
  }

  /** How far a point is from the border that is on the left of the screen, in pixels of the picture. */
  #fromLeft(x) { return this.#mirrored ? this.#width - x - 0.5 : x + 0.5; }

  /** Screen coordinates of a landmark. */
  toScreen([x, y]) { return [this.#left + this.#scale * this.#fromLeft(x), this.#top + this.#scale * (y + 0.5)]; }

  /** Position {left, top} of the picture's corner that puts a landmark at a place of the screen, at a scale. */
  cornerFor([x, y], [screenX, screenY], scale) {
    return { left: screenX - scale * this.#fromLeft(x), top: screenY - scale * (y + 0.5) };
  }

  /** Landmark coordinates of an event or of a place [x, y] of the screen. */
  toImage(place) {
    const [screenX, screenY] = Array.isArray(place) ? place : this.place(place);
    const fromLeft = (screenX - this.#left) / this.#scale;
    return [(this.#mirrored ? this.#width - fromLeft : fromLeft) - 0.5, (screenY - this.#top) / this.#scale - 0.5];
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

  /** Draw draw(context, viewer) over the picture, after the layers that were added before. */
  addLayer(draw) {
    this.#layers.push(draw);
    this.redraw();
  }

  key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return false;
    return runKey(event, {
      "+": () => this.zoomBy(ZOOM_STEP),
      "=": () => this.zoomBy(ZOOM_STEP), // "+" without Shift on many keyboards
      "-": () => this.zoomBy(1 / ZOOM_STEP),
      0: () => this.fit(),
      a: () => { // brightness, contrast and gamma
        this.#look.open = !this.#look.open;
        (this.#look.open ? this.#look.querySelector("input") : this.canvas).focus();
      },
    });
  }

  /** Position of the container in the canvas, css pixels. */
  #offset() {
    const canvas = this.canvas.getBoundingClientRect();
    const container = this.container.getBoundingClientRect();
    return [container.left - canvas.left, container.top - canvas.top];
  }

  #resize() {
    const { canvas, container } = this;
    if (!container.clientWidth || !container.clientHeight) return;
    const ratio = window.devicePixelRatio || 1;
    const width = Math.round(canvas.clientWidth * ratio);
    const height = Math.round(canvas.clientHeight * ratio);
    // Setting the size of a canvas clears it.
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    this.#keepInPlace();
    // Draw at once, because a resized canvas is blank.
    this.#draw();
  }

  /** After a change of the container: keep the whole picture whole, or else keep on the page what the user looks at,
   *  although a panel has moved the container. */
  #keepInPlace() {
    const offset = this.#offset();
    const before = this.#offsetBefore ?? offset;
    this.#offsetBefore = offset;
    if (this.#showsWhole) return this.fit();
    const dx = before[0] - offset[0];
    const dy = before[1] - offset[1];
    if (dx === 0 && dy === 0) return;
    const [pannedX, pannedY] = this.panBy(dx, dy);
    // A pan is rounded. What it lacks counts as movement of the container the next time.
    const leftX = dx - pannedX;
    const leftY = dy - pannedY;
    this.#offsetBefore = [offset[0] + leftX, offset[1] + leftY];
  }

  /** Show another view, and say so by the event "view". */
  #changed() {
    this.#show();
    this.dispatchEvent(new Event("view"));
  }

  #show() {
    const ratio = window.devicePixelRatio || 1;
    // On the grid of the screen's pixels, so that panning can reuse what is drawn.
    this.#left = Math.round(this.#left * ratio) / ratio;
    this.#top = Math.round(this.#top * ratio) / ratio;
    this.#zoomText.textContent = `${Math.round(100 * this.#scale)} %`;
    this.redraw();
  }

  #draw() {
    const { canvas } = this;
    // In a hidden tab, or under the wall; drawn when it is shown again and resized.
    if (!this.container.clientWidth || !canvas.width || !canvas.clientWidth) return;
    const ctx = canvas.getContext("2d");
    const ratio = canvas.width / canvas.clientWidth; // pixels of the canvas per css pixel
    const offset = this.#offset();
    ctx.setTransform(1, 0, 0, 1, 0, 0);
    ctx.clearRect(0, 0, canvas.width, canvas.height);
    if (!("filter" in ctx)) canvas.style.filter = look.filter; // in Safari: changes the points, too
    if (this.#source && this.#width) ctx.drawImage(this.#scaledPicture(ratio, offset), 0, 0);
    else this.#forgetPicture();
    toContainer(ctx, ratio, offset);
    this.#drawLayers(ctx);
  }

  #forgetPicture() {
    this.#scaled = null;
    this.#glow.hidden = true;
  }

  #drawLayers(ctx) {
    for (const draw of this.#layers) {
      ctx.save();
      draw(ctx, this);
      ctx.restore();
    }
  }

  #drawPicture(ctx) {
    ctx.save();
    if (this.#mirrored) {
      ctx.translate(2 * this.#left + this.#scale * this.#width, 0); // mirrored at the middle of the picture
      ctx.scale(-1, 1);
    }
    ctx.filter = look.filter;
    ctx.imageSmoothingEnabled = this.#scale < SHARP_FROM;
    ctx.imageSmoothingQuality = this.#tiles && this.#scale * this.#width > this.#source.width ? "low" : "high"; // tiles follow
    if (!this.#tiles?.cover(ctx, this))
      ctx.drawImage(this.#source, this.#left, this.#top, this.#scale * this.#width, this.#scale * this.#height);
    this.#tiles?.draw(ctx, this);
    ctx.restore();
  }

  /** Draw the picture and its layers with another view {scale, left, top}, as in a loupe. */
  drawAs(ctx, view) {
    const before = this.view;
    this.#setView(view);
    this.#isLoupe = true;
    this.#drawPicture(ctx);
    this.#drawLayers(ctx);
    this.#setView(before);
    this.#isLoupe = false;
  }

  /** The scaled picture on a canvas of the same size. It is cached, because scaling takes longer than other drawing.
   *  After a pan by whole pixels, only the strips that came into view are drawn. */
  #scaledPicture(ratio, offset) {
    const { width, height } = this.canvas;
    const settings = [
      this.#source, this.#mirrored, this.#tiles?.version, this.#scale, this.#width, this.#height, ratio, width, height, look.values,
    ];
    const corner = [ratio * (this.#left + offset[0]), ratio * (this.#top + offset[1])]; // of the picture, pixels of the canvas
    const pan = this.#panSinceScaled(settings, corner);
    if (pan?.every((by) => by === 0)) return this.#scaled.canvas;

    const canvas = this.#scaled?.canvas ?? document.createElement("canvas");
    const ctx = canvas.getContext("2d");
    let parts; // that are to be drawn, [x, y, width, height]
    if (pan?.every(isWhole)) parts = shifted(ctx, Math.round(pan[0]), Math.round(pan[1]));
    else {
      Object.assign(canvas, { width, height }); // also clears it
      parts = [[0, 0, width, height]];
    }
    for (const part of parts) this.#drawPart(ctx, part, ratio, offset);
    this.#scaled = { canvas, settings, corner };
    this.#showGlow(canvas, [...corner, ratio * this.#scale * this.#width, ratio * this.#scale * this.#height]);
    return canvas;
  }

  /** How far the picture has moved since it was scaled, [x, y] in pixels of the canvas; null if all else has not stayed
   *  as it was. */
  #panSinceScaled(settings, corner) {
    const cached = this.#scaled;
    if (cached === null || settings.some((value, i) => value !== cached.settings[i])) return null;
    return [corner[0] - cached.corner[0], corner[1] - cached.corner[1]];
  }

  /** Draw the picture anew in a part [x, y, width, height] of a canvas. */
  #drawPart(ctx, /** @type {number[]} */ [x, y, width, height], ratio, offset) {
    ctx.save();
    ctx.beginPath();
    ctx.rect(x, y, width, height);
    ctx.clip();
    ctx.clearRect(x, y, width, height); // strips overlap, and pictures may be transparent
    toContainer(ctx, ratio, offset);
    this.#drawPicture(ctx);
    ctx.restore();
  }

  /** Show the tones of the picture, which is at [left, top, width, height] of a canvas, around it. */
  #showGlow(canvas, /** @type {number[]} */ [left, top, width, height]) {
    this.#glow.hidden = false;
    const isInside = left >= 0 && top >= 0 && left + width <= canvas.width && top + height <= canvas.height;
    if (this.#glowOf === this.#source || !isInside) return;
    this.#glowOf = this.#source;
    const tiny = Object.assign(document.createElement("canvas"), { width: GLOW_SIZE, height: GLOW_SIZE });
    tiny.getContext("2d").drawImage(canvas, left, top, width, height, 0, 0, GLOW_SIZE, GLOW_SIZE);
    this.#glow.style.backgroundImage = `url(${tiny.toDataURL()})`;
  }

  // Pointers go to the tool first; otherwise they pan, and two fingers zoom.

  #wheel(event) {
    event.preventDefault();
    const pixels = event.deltaMode === WheelEvent.DOM_DELTA_LINE ? WHEEL_LINE * event.deltaY : event.deltaY;
    const clipped = Math.max(-WHEEL_MOST, Math.min(WHEEL_MOST, pixels));
    const speed = event.ctrlKey ? TRACKPAD_PINCH * WHEEL_ZOOM : WHEEL_ZOOM;
    this.zoomBy(Math.exp(-speed * clipped), this.place(event));
  }

  #spaceKey(event, isDown) {
    if (event.key !== " ") return;
    event.preventDefault();
    this.#spaceIsDown = isDown;
    this.#cursor = isDown ? "grab" : "";
  }

  set #cursor(cursor) { this.canvas.style.cursor = cursor; }

  #down(event) {
    this.canvas.focus({ preventScroll: true });
    this.#pointers.set(event.pointerId, [event.clientX, event.clientY]);
    this.#pinched = null;
    attempt(() => this.canvas.setPointerCapture(event.pointerId)); // it may have been released already
    if (this.#pointers.size === 2) { // a second finger ends the tool's gesture
      if (this.#toolPointer !== null) this.#tool?.cancel?.(event);
      this.#toolPointer = null;
      return;
    }
    event.preventDefault();
    const pans = this.#spaceIsDown || event.button === MIDDLE_BUTTON || event.button === RIGHT_BUTTON;
    const mayEdit = !pans && this.#pointers.size === 1;
    if (mayEdit && this.#tool?.down?.(event, this.toImage(event))) this.#toolPointer = event.pointerId;
    else this.#cursor = "grabbing";
  }

  #move(event) {
    const before = this.#pointers.get(event.pointerId);
    if (!before) return this.#hover(event);
    if (this.#toolPointer === event.pointerId) return this.#tool?.move?.(event, this.toImage(event));
    const now = [event.clientX, event.clientY];
    if (this.#pointers.size === 2) {
      this.#pinch(event.pointerId, before, now);
      this.#pointers.set(event.pointerId, now);
    } else if (this.#toolPointer === null) {
      const [dx, dy] = this.panBy(now[0] - before[0], now[1] - before[1]);
      this.#pointers.set(event.pointerId, [before[0] + dx, before[1] + dy]); // what rounding has left is for the next move
    }
  }

  /** A pointer leaves the canvas; one that is down goes on with what it does. */
  #leave(event) {
    if (this.#pointers.size === 0) this.#tool?.leave?.(event);
  }

  /** A pointer moves that is not down. */
  #hover(event) {
    const point = this.toImage(event);
    this.#tool?.hover?.(event, point);
    this.#cursor = this.#spaceIsDown ? "grab" : this.#tool?.cursor?.(event, point) ?? "";
  }

  /** One of two fingers moves from a place of the page to another: pan with their middle, zoom with their distance. */
  #pinch(id, before, now) {
    const otherId = [...this.#pointers.keys()].find((key) => key !== id);
    const other = this.#pointers.get(otherId);
    const box = this.container.getBoundingClientRect();
    const distanceFrom = (a) => Math.hypot(a[0] - other[0], a[1] - other[1]) || 1;
    const middleOf = (a) => [(a[0] + other[0]) / 2 - box.left, (a[1] + other[1]) / 2 - box.top];
    this.#pinched ??= this.toImage(middleOf(before));
    const to = middleOf(now);
    this.zoomBy(distanceFrom(now) / distanceFrom(before), to);
    const [x, y] = this.toScreen(this.#pinched);
    this.panBy(to[0] - x, to[1] - y); // what is between the fingers stays there, however often the view was rounded
  }

  /** A pointer is released ("up"), or the browser takes it for something else ("cancel"). */
  #end(event, how) {
    if (!this.#pointers.delete(event.pointerId)) return;
    this.#cursor = "";
    if (this.#toolPointer !== event.pointerId) return;
    this.#toolPointer = null;
    this.#tool?.[how]?.(event, this.toImage(event));
  }
}

/** Draw from now on in css pixels from the corner of the container, which is at `offset` of the canvas. */
const toContainer = (ctx, ratio, offset) => ctx.setTransform(ratio, 0, 0, ratio, ratio * offset[0], ratio * offset[1]);

const isWhole = (pixels) => Math.abs(pixels - Math.round(pixels)) < 1e-6; // the rest is rounding

/** Move what is drawn by whole pixels; return the strips [x, y, width, height] that have become free. */
function shifted(ctx, dx, dy) {
  const { canvas } = ctx;
  const { width, height } = canvas;
  ctx.globalCompositeOperation = "copy";
  ctx.drawImage(canvas, dx, dy);
  ctx.globalCompositeOperation = "source-over";
  const across = Math.abs(dx);
  const down = Math.abs(dy);
  return [
    [dx > 0 ? 0 : width - across, 0, across, height],
    [0, dy > 0 ? 0 : height - down, width, down],
  ];
}
