// A light that is moved over the fitted object, and the relit picture.

import { api } from "./api.js";
import { ballOf, directionAfterKey, directionAt, directionInWords, placeOf } from "./fit-geometry.js";
import { LatestWins } from "./fit-schedule.js";
import { button, h, icon } from "./ui.js";

/** Initial direction of the light: from the upper left. */
const FIRST = directionAt([-0.55, -0.5], { x: 0, y: 0, radius: 1 });

const SIZE_WHILE_MOVING = 800;
const SIZE_AT_REST = 1600;

export function lightQuery({ direction: [x, y, z], ambient }, size) {
  return { x: x.toFixed(4), y: y.toFixed(4), z: z.toFixed(4), ambient: ambient.toFixed(3), ...(size ? { size } : {}) };
}

/** The handle over the picture, and the ball and ambient slider in the bar. Events: "change" and "rest". */
export class Light extends EventTarget {
  /** ambient: initial fraction of ambient light. */
  constructor(viewer, ambient) {
    super();
    this.viewer = viewer;
    this.ball = null;
    this.first = { direction: FIRST, ambient };
    Object.assign(this, this.first);
    this.handle = h(
      "div",
      {
        class: "fit-light", role: "slider", tabindex: "0", hidden: true, "aria-label": "Light over the object",
        "aria-roledescription": "movable light", "aria-valuemin": "0", "aria-valuemax": "90",
        title: "Drag the light; arrow keys move it", dataset: { testid: "light-handle" },
      },
      icon("sun", 18),
    );
    viewer.container.append(this.handle);
    this.controls = this._controls();
    this.tool = {
      down: (event, xy) => this._near(xy) && (this._set(directionAt(xy, this.ball)), true),
      move: (event, xy) => this._set(directionAt(xy, this.ball)), up: () => this._say("rest"),
      cancel: () => this._say("rest"), cursor: (event, xy) => (this._near(xy) ? "crosshair" : ""),
    };
    this._listen();
    this._show();
  }

  get visible() {
    return !this.handle.hidden;
  }

  set visible(now) {
    this.handle.hidden = !now || !this.ball;
    this._place();
  }

  /** Set the shape over which the light is moved. */
  over(shape) {
    this.ball = shape ? ballOf(shape) : null;
    if (!this.ball) this.handle.hidden = true;
    this._place();
  }

  /** Draw the rim of the ball and a line from its centre to the light. */
  draw(ctx, viewer) {
    if (!this.visible) return;
    const [cx, cy] = viewer.toScreen([this.ball.x, this.ball.y]);
    const [lx, ly] = viewer.toScreen(placeOf(this.direction, this.ball));
    for (const [colour, width] of [
      ["rgb(0 0 0 / 35%)", 3], ["rgb(255 236 170 / 75%)", 1.2],
    ]) {
      ctx.strokeStyle = colour;
      ctx.lineWidth = width;
      ctx.setLineDash([5, 5]);
      ctx.beginPath();
      ctx.arc(cx, cy, this.ball.radius * viewer.scale, 0, 2 * Math.PI);
      ctx.stroke();
      ctx.setLineDash([]);
      ctx.beginPath();
      ctx.moveTo(cx, cy);
      ctx.lineTo(lx, ly);
      ctx.stroke();
    }
  }

  key(event) {
    const next = directionAfterKey(this.direction, event);
    if (!next) return false;
    this._set(next);
    this._say("rest");
    return true;
  }

  _near([x, y]) {
    return this.ball && Math.hypot(x - this.ball.x, y - this.ball.y) <= 1.1 * this.ball.radius;
  }

  _set(direction) {
    this.direction = direction;
    this._show();
    this._say("change");
  }

  _controls() {
    this._sphere = h("canvas", { class: "fit-sphere", width: 88, height: 88, role: "img" });
    this._words = h("span", { class: "fit-light-words small", "aria-live": "polite" });
    this._ambient = h("input", {
      type: "range", class: "slider", min: "0", max: "1", step: "0.01", "aria-label": "Ambient light",
      dataset: { testid: "light-ambient" },
    });
    this._ambientText = h("span", { class: "number" });
    const reset = button("Reset", {
      small: true, testid: "light-reset", title: "Reset the light",
      onclick: () => {
        Object.assign(this, this.first);
        this._show();
        this._say("change");
        this._say("rest");
      },
    });
    return h(
      "div",
      { class: "fit-controls" },
      this._sphere, this._words,
      h("label", { class: "fit-slider-label small muted" }, "Ambient", this._ambient, this._ambientText),
      reset,
    );
  }

  _listen() {
    this._ambient.addEventListener("input", () => {
      this.ambient = Number(this._ambient.value);
      this._show();
      this._say("change");
    });
    this._ambient.addEventListener("change", () => this._say("rest"));
    const handle = this.handle;
    handle.addEventListener("pointerdown", (event) => {
      if (event.button !== 0) return;
      handle.setPointerCapture(event.pointerId);
      handle.focus({ preventScroll: true });
      event.preventDefault();
    });
    handle.addEventListener("pointermove", (event) => {
      if (handle.hasPointerCapture(event.pointerId)) this._set(directionAt(this.viewer.toImage(event), this.ball));
    });
    handle.addEventListener("lostpointercapture", () => this._say("rest"));
    handle.addEventListener("keydown", (event) => {
      if (!this.key(event)) return;
      event.preventDefault();
      event.stopPropagation();
    });
    this.viewer.addEventListener("view", () => this._place());
  }

  _show() {
    const words = directionInWords(this.direction);
    this._words.textContent = `Light ${words}`;
    this.handle.setAttribute("aria-valuetext", words);
    this.handle.setAttribute("aria-valuenow", String(Math.round((Math.acos(this.direction[2]) * 180) / Math.PI)));
    this._sphere.setAttribute("aria-label", `A ball lit ${words}`);
    this._ambient.value = String(this.ambient);
    this._ambientText.textContent = `${Math.round(100 * this.ambient)} %`;
    drawBall(this._sphere, this.direction, this.ambient);
    this._place();
  }

  _place() {
    if (!this.ball) return;
    const [x, y] = this.viewer.toScreen(placeOf(this.direction, this.ball));
    this.handle.style.transform = `translate(${x}px, ${y}px) translate(-50%, -50%)`;
    this.viewer.redraw();
  }

  _say(type) {
    this.dispatchEvent(new Event(type));
  }
}

/** Draw a matt ball under the light, to show its direction. */
export function drawBall(canvas, [lx, ly, lz], ambient) {
  const size = canvas.width;
  const ctx = canvas.getContext("2d");
  const image = ctx.createImageData(size, size);
  const half = size / 2;
  for (let py = 0; py < size; py += 1) {
    for (let px = 0; px < size; px += 1) {
      const x = (px + 0.5 - half) / (half - 1);
      const y = (py + 0.5 - half) / (half - 1);
      const r = x * x + y * y;
      if (r > 1) continue;
      const lit = ambient + (1 - ambient) * Math.max(0, x * lx + y * ly + Math.sqrt(1 - r) * lz);
      const shade = 255 * Math.min(1, lit) ** (1 / 2.2);
      const at = 4 * (py * size + px);
      image.data.set([shade, 0.94 * shade, 0.82 * shade, 255 * Math.min(1, (1 - r) * 0.25 * size)], at);
    }
  }
  ctx.putImageData(image, 0, 0);
}

/** Fetches the relit picture, with at most one request at a time for the newest light. */
export class Relighter {
  constructor({ done, failed }) {
    this._asks = new LatestWins(
      async ({ fit, light, size }) => {
        const blob = await api.blob(api.url("fits", fit.id, "relit", lightQuery(light, size)));
        return createImageBitmap(blob);
      },
      { done: (image, { fit }) => done(image, fit), failed },
    );
  }

  get busy() {
    return this._asks.busy;
  }

  ask(fit, light, resting) {
    const { direction, ambient } = light;
    const longest = Math.max(fit.width, fit.height);
    this._asks.ask({
      fit, light: { direction, ambient }, size: Math.min(longest, resting ? SIZE_AT_REST : SIZE_WHILE_MOVING),
    });
  }

  cancel() {
    this._asks.cancel();
  }
}
