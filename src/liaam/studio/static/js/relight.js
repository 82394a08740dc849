// Lamps that are moved over a ball beside the picture, and the relit picture.

import { api } from "./api.js";
import { directionAfterKey, directionAt, directionInWords, litFrom } from "./fit-geometry.js";
import { FrameMeter, LatestWins } from "./fit-schedule.js";
import { button, consume, h, menu, slider } from "./ui.js";

/** @typedef {{direction: number[], colour: string, strength: number, softness: number}} Lamp colour: "#rrggbb" */
/** @typedef {{lamps: Lamp[], ambient: number}} Lights ambient: fraction of white ambient light */

const SIZE_WHILE_MOVING = 800;
const SIZE_AT_REST = 1600;

/** Most lamps that the server takes. */
const MOST = 8;

/** Sliders of a lamp. */
const SLIDERS = [
  { key: "strength", label: "Strength", max: "3", what: "Strength of the lamp" },
  { key: "softness", label: "Softness", max: "1", what: "Softness of the lamp: a large lamp wraps around the object" },
];

/** A lamp at [x, y] over the ball, from -1 to 1. */
function lampAt([x, y], colour = "#ffffff", strength = 1, softness = 0) {
  return { direction: directionAt([x, y]), colour, strength, softness };
}

export const PRESETS = {
  Side: { lamps: [lampAt([-0.9, -0.25])], ambient: 0.1 },
  Portrait: {
    lamps: [lampAt([-0.55, -0.5], "#fff1dc", 1.1, 0.4), lampAt([0.7, 0], "#dfe9ff", 0.35, 0.8)], ambient: 0.15,
  },
  Window: { lamps: [lampAt([-0.8, -0.2], "#e6f0ff", 1.2, 1)], ambient: 0.15 },
  "Two colours": {
    lamps: [lampAt([-0.9, 0], "#ffb070", 1.1, 0.4), lampAt([0.9, 0], "#86a9ff", 1.2, 0.4)], ambient: 0.2,
  },
  Candle: { lamps: [lampAt([-0.15, 0.75], "#ffbe80", 1.2, 0.3)], ambient: 0.15 },
  Overcast: { lamps: [lampAt([0, -0.6], "#f2f6ff", 1, 1)], ambient: 0.5 },
};

/** Red, green and blue of "#rrggbb", 0 to 1. */
const channelsOf = (colour) => [1, 3, 5].map((at) => parseInt(colour.slice(at, at + 2), 16) / 255);

/** Query of a picture under lights. @param {Lights} lights @param {number} [size] */
export function lightQuery({ lamps, ambient }, size) {
  const round = (value) => Number(value.toFixed(4));
  const sent = lamps.map(({ direction, colour, strength, softness }) => ({
    direction: direction.map(round), colour: channelsOf(colour).map(round), strength, softness,
  }));
  return { light: JSON.stringify({ lamps: sent, ambient }), ...(size ? { size } : {}) };
}

/** The panel with the ball, its lamps and their values. Events: "change" and "rest". */
export class Light extends EventTarget {
  /** ambient: initial fraction of ambient light. */
  constructor(ambient) {
    super();
    this.first = { lamps: [lampAt([-0.55, -0.5])], ambient };
    this.element = this._build();
    this.set(this.first);
  }

  get lamp() { return this.lamps[this.selected]; }

  /** Replace all lights. @param {Lights} lights */
  set({ lamps, ambient }) {
    this.lamps = lamps.map((lamp) => ({ ...lamp }));
    this.ambient = ambient;
    this.selected = 0;
    this._show();
  }

  /** Move the selected lamp by an arrow key. */
  key(event) {
    const next = directionAfterKey(this.lamp.direction, event);
    if (!next) return false;
    this.lamp.direction = next;
    this._changed(true);
    return true;
  }

  _build() {
    this._canvas = h("canvas.light-ball", { width: 120, height: 120, "aria-hidden": "true" });
    this._dots = h("div.light-dots", { role: "group", "aria-label": "Lamps over a ball" });
    const how = "Drag a lamp; arrow keys move it";
    this._sphere = h("div.light-sphere", { title: how, testid: "light-ball" }, this._canvas, this._dots);
    this._words = h("p.small", { "aria-live": "polite", testid: "light-words" });
    this._add = button("Add", {
      icon: "plus", small: true, testid: "lamp-add", title: "Add a lamp",
      onclick: () => this._put([...this.lamps, lampAt([-this.lamp.direction[0] || 0.5, -0.2])], this.lamps.length),
    });
    this._remove = button("Remove", {
      icon: "trash", small: true, testid: "lamp-remove", title: "Remove the selected lamp",
      onclick: () => this._put(this.lamps.filter((lamp) => lamp !== this.lamp), 0),
    });
    this._colour = h("input.light-colour", {
      type: "color", "aria-label": "Colour of the lamp", testid: "lamp-colour",
      oninput: () => this._edit("colour", this._colour.value), onchange: () => this._say("rest"),
    });
    const lights = { "One lamp": this.first, ...PRESETS };
    const labels = Object.fromEntries(Object.keys(lights).map((name) => [name, name]));
    const use = (name) => {
      this.set(lights[name]);
      this._changed(true);
    };
    const presets = menu("Presets…", labels, use, { "aria-label": "Preset lights", testid: "light-presets" });
    this._sliders = SLIDERS.map((of) => this._slider(of, () => this.lamp[of.key], (to) => this._edit(of.key, to)));
    const ambient = { label: "Ambient", max: "1", what: "Ambient light: from all directions", key: "ambient" };
    this._sliders.push(this._slider(ambient, () => this.ambient, (value) => {
      this.ambient = value;
      this._changed();
    }));
    this._drag();
    const values = h("div.column.tight.grow", this._words, h("div.row.tight", this._colour, this._add, this._remove));
    return h("section.panel.light", { "aria-label": "Light", hidden: true, testid: "light" },
      presets, h("div.light-top", this._sphere, values), this._sliders.map(({ element }) => element));
  }

  _slider({ key, label, max, what }, get, set) {
    const input = slider({
      min: "0", max, step: "0.01", "aria-label": what, testid: `light-${key}`,
      oninput: () => set(Number(input.value)), onchange: () => this._say("rest"),
    });
    const text = h("span.number");
    const show = () => {
      input.value = String(get());
      text.textContent = `${Math.round(100 * get())} %`;
    };
    return { element: h("label.light-slider.small", { title: what }, h("span", label), input, text), show };
  }

  /** Drag over the ball: the lamp under the pointer, or else the selected one. */
  _drag() {
    const sphere = this._sphere;
    const move = (event) => {
      const { left, top, width } = this._canvas.getBoundingClientRect();
      const half = width / 2;
      this._edit("direction", directionAt([(event.clientX - left - half) / half, (event.clientY - top - half) / half]));
    };
    sphere.addEventListener("pointerdown", (event) => {
      if (event.button !== 0) return;
      const dot = event.target.closest("[role=slider]");
      if (dot) this.selected = [...this._dots.children].indexOf(dot);
      else move(event);
      sphere.setPointerCapture(event.pointerId);
      this._show();
      this._dots.children[this.selected].focus({ preventScroll: true });
      event.preventDefault();
    });
    sphere.addEventListener("pointermove", (event) => sphere.hasPointerCapture(event.pointerId) && move(event));
    sphere.addEventListener("lostpointercapture", () => this._say("rest"));
  }

  _dot() {
    const select = () => {
      this.selected = [...this._dots.children].indexOf(dot);
      this._show();
    };
    const dot = h("div.light-lamp", {
      role: "slider", tabindex: "0", "aria-roledescription": "movable lamp", "aria-valuemin": "0",
      "aria-valuemax": "90", testid: "lamp", onfocus: select,
      onkeydown: (event) => this.key(event) && consume(event),
    });
    return dot;
  }

  _put(lamps, selected) {
    Object.assign(this, { lamps, selected });
    this._changed(true);
    this._dots.children[selected].focus({ preventScroll: true });
  }

  _edit(key, value) {
    this.lamp[key] = value;
    this._changed();
  }

  _changed(rested = false) {
    this._show();
    this._say("change");
    if (rested) this._say("rest");
  }

  _show() {
    const { lamps, lamp, selected, _dots: dots } = this;
    while (dots.children.length < lamps.length) dots.append(this._dot());
    while (dots.children.length > lamps.length) dots.lastChild.remove();
    lamps.forEach(({ direction: [x, y, z], colour }, i) => {
      const dot = dots.children[i];
      Object.assign(dot.style, { left: `${50 + 50 * x}%`, top: `${50 + 50 * y}%`, backgroundColor: colour });
      dot.classList.toggle("selected", i === selected);
      dot.setAttribute("aria-label", `Lamp ${i + 1}`);
      dot.setAttribute("aria-valuetext", directionInWords([x, y, z]));
      dot.setAttribute("aria-valuenow", String(Math.round((Math.acos(z) * 180) / Math.PI)));
    });
    const which = lamps.length > 1 ? `Lamp ${selected + 1} of ${lamps.length}` : "Lamp";
    this._words.textContent = `${which} ${directionInWords(lamp.direction)}`;
    this._colour.value = lamp.colour;
    this._add.disabled = lamps.length >= MOST;
    this._remove.disabled = lamps.length < 2;
    for (const { show } of this._sliders) show();
    drawBall(this._canvas, this);
  }

  _say(type) {
    this.dispatchEvent(new Event(type));
  }
}

/** Draw a matt ball under the lights. */
function drawBall(canvas, { lamps, ambient }) {
  const size = canvas.width;
  const ctx = canvas.getContext("2d");
  const image = ctx.createImageData(size, size);
  const half = size / 2;
  const all = lamps.map((lamp) => ({ ...lamp, channels: channelsOf(lamp.colour).map((value) => value ** 2.2) }));
  for (let py = 0; py < size; py += 1) {
    for (let px = 0; px < size; px += 1) {
      const [x, y] = [(px + 0.5 - half) / (half - 1), (py + 0.5 - half) / (half - 1)];
      const r = x * x + y * y;
      if (r > 1) continue;
      const light = [ambient, ambient, ambient];
      for (const { direction: [lx, ly, lz], strength, softness, channels } of all) {
        const lit = (1 - ambient) * strength * litFrom(x * lx + y * ly + Math.sqrt(1 - r) * lz, softness);
        for (let c = 0; c < 3; c += 1) light[c] += lit * channels[c];
      }
      const shades = light.map((value) => 235 * Math.min(1, value) ** (1 / 2.2));
      image.data.set([...shades, 255 * Math.min(1, (1 - r) * 0.25 * size)], 4 * (py * size + px));
    }
  }
  ctx.putImageData(image, 0, 0);
}

/** Fetches the relit picture, with at most one request at a time for the newest light. */
export class Relighter extends LatestWins {
  constructor({ done, failed }) {
    const task = async ({ fit, query }) => createImageBitmap(await api.blob(api.url("fits", fit.id, "relit", query)));
    const shown = (image, { fit }) => {
      this.meter.tick();
      done(image, fit);
    };
    super(task, { done: shown, failed });
    this.meter = new FrameMeter();
  }

  relight(fit, light, resting) {
    const size = Math.min(Math.max(fit.width, fit.height), resting ? SIZE_AT_REST : SIZE_WHILE_MOVING);
    this.ask({ fit, query: lightQuery(light, size) });
  }
}
