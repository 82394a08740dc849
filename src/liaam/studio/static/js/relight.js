// Lamps that are moved over the object in the picture, and the object under them, as far as the browser can compute it
// at once: Lambert's law on the server's normals, as in relighting/relighter.py, but for noise, and light beyond white.

import { ARROWS, bounds, middleOf } from "./points.js";
import { button, grip, h, labelledSlider, menu } from "./ui.js";

/** @typedef {{direction: number[], colour: string, strength: number, softness: number}} Lamp colour: "#rrggbb" */
/** @typedef {{lamps: Lamp[], ambient: number}} Lights ambient: fraction of white ambient light */

const BALL = 1.4; // diameter of the ball that lamps are on, relative to the object's box
const LEAST = 120; // css pixels of its diameter
const EDGE = 20; // css pixels between a lamp and the border of the view, if there is room
const MOST = 8; // lamps that the server takes

const SLIDERS = [
  { key: "strength", label: "Strength", max: "3", what: "Strength of the lamp" },
  { key: "softness", label: "Softness", max: "1", what: "Softness of the lamp: a large lamp wraps around the object" },
  { key: "ambient", label: "Ambient", max: "1", what: "Ambient light: from all directions" },
];

/** Sine of the largest angle of a light: at 90 degrees it would not reach the front. */
const RIM = Math.sin((85 * Math.PI) / 180);

/** Unit direction to a lamp (x right, y down, z to the viewer) at [x, y] over a unit ball. @param {any} place */
export function directionAt([x, y]) {
  const r = Math.hypot(x, y);
  if (r > RIM) [x, y] = [(x * RIM) / r, (y * RIM) / r];
  return [x, y, Math.sqrt(Math.max(0, 1 - x * x - y * y))];
}

export function directionAfterKey(direction, { key, shiftKey = false }) {
  const step = shiftKey ? 0.15 : 0.04;
  const move = ARROWS[key];
  if (key === "Home") return [0, 0, 1];
  if (!move) return null;
  return directionAt([direction[0] + step * move[0], direction[1] + step * move[1]]);
}

/** Direction in words: "from the upper left, 42° from the front". @param {number[]} direction */
export function directionInWords([x, y, z]) {
  const angle = Math.round((Math.acos(Math.min(1, Math.max(-1, z))) * 180) / Math.PI);
  if (angle < 5) return "from the front";
  const vertical = y < -0.38 * Math.hypot(x, y) ? "upper " : y > 0.38 * Math.hypot(x, y) ? "lower " : "";
  const horizontal = x < -0.38 * Math.hypot(x, y) ? "left" : x > 0.38 * Math.hypot(x, y) ? "right" : "";
  const side = `${vertical}${horizontal}`.trim();
  return `from the ${{ upper: "top", lower: "bottom" }[side] ?? side}, ${angle}° from the front`;
}

const SOFTNESS = 0.4; // of a new lamp: hard ones show each fault of the fit as an edge

/** A lamp at [x, y] over the object, from -1 to 1. */
function lampAt(/** @type {any} */ [x, y], colour = "#ffffff", strength = 1, softness = SOFTNESS) {
  return { direction: directionAt([x, y]), colour, strength, softness };
}

/** Places of further lamps, [x, y] over a unit ball: the middle, and around it. */
const PLACES = [[0, 0], ...[0, 1, 2, 3, 4, 5, 6, 7].map((turn) => [Math.cos, Math.sin].map((of) => 0.75 * of((turn * Math.PI) / 4)))];
const APART = 0.3; // least distance over the ball between a new lamp and the others, if its own place is to be taken

/** Where a new lamp is put: at `wanted`, [x, y] over a unit ball, or farthest from all lamps if one is there already.
 *  @param {Pick<Lamp, "direction">[]} lamps; @param {number[]} wanted */
export function freePlace(lamps, wanted) {
  const room = (/** @type {any} */ [x, y]) => Math.min(...lamps.map(({ direction: [u, v] }) => Math.hypot(x - u, y - v)));
  if (room(wanted) >= APART) return wanted;
  return PLACES.reduce((best, place) => (room(place) > room(best) ? place : best));
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

const channelsOf = (colour) => [1, 3, 5].map((at) => parseInt(colour.slice(at, at + 2), 16) / 255);

/** Lights with colours as numbers, for the server and for the computation in the browser.
 *  @param {Lights} lights; @returns {SentLight} */
export function numbersOf({ lamps, ambient }) {
  const round = (value) => Number(value.toFixed(4));
  /** @returns {SentLamp} */
  const sent = (/** @type {Lamp} */ { direction, colour, strength, softness }) => (
    { direction: direction.map(round), colour: channelsOf(colour).map(round), strength, softness });
  return { lamps: lamps.map(sent), ambient };
}

/** Query of a picture under lights. @param {Lights} lights; @param {number} [size]; @returns {LightQuery} */
export const lightQuery = (lights, size = null) => ({ light: JSON.stringify(numbersOf(lights)), size });

/** Query that keeps the colour of a picture's own light, or corrects it. @returns {{balance?: string}} */
export const balanceQuery = (/** @type {boolean} */ corrects) => (corrects ? {} : { balance: "0" });

/** Whether the colour of the light is corrected in flat and relit pictures, and what it is. Event: "change". */
export class Balance extends EventTarget {
  #box = h("input", {
    type: "checkbox", disabled: true, testid: "balance", onchange: () => {
      this.#corrects = this.#box.checked;
      this.dispatchEvent(new Event("change"));
    },
  });
  #found = h("span.muted", { testid: "light-colour" });
  element = h("label.check.fit-balance",
    this.#box, h("span.grow", "Correct the colour of the light"), this.#found);

  #corrects = true; // as chosen, also while there is nothing to correct
  get corrects() { return this.#corrects; }

  /** Show the name of the colour that was found, "" if it is as in training; null: not known. isGiven: the view corrects it
   *  in any case. @param {string | null | undefined} colour; @param {boolean} isGiven */
  show(colour, isGiven = false) {
    this.#found.textContent = colour === "" ? "neutral" : colour ?? "";
    this.#box.disabled = !colour || isGiven;
    this.#box.checked = Boolean(colour) && (isGiven || this.#corrects);
    this.element.title = colour ? "Take the colour of the light off the whole picture, object and background alike"
      : colour === "" ? "The light is neutral, as in the pictures that the model was trained on: there is no colour to correct"
      : "The colour of the light is measured when it is corrected, the shading is removed, or the picture is relit";
  }
}

/** A lamp on a picture, over a ball around the object that fills the parent element, or is at `middle` of it.
 *  onmove(direction); further attributes are those of the element. */
export function lampHandle({ onmove, middle = [0.5, 0.5], ...attributes }) {
  const [u, v] = middle;
  let direction = [0, 0, 1];
  const element = grip("div.lamp", {
    "aria-roledescription": "movable lamp", "aria-valuemin": "0", "aria-valuemax": "90",
    onkey: key, onmove: (event) => onmove(at(event)), ...attributes,
  });

  function at({ clientX, clientY }) {
    const { left, top, width, height } = element.parentElement.getBoundingClientRect();
    return directionAt([(2 * (clientX - left)) / width - 2 * u, (2 * (clientY - top)) / height - 2 * v]);
  }

  function show(to) {
    direction = to;
    const [x, y, z] = to;
    element.style.left = `${100 * (u + x / 2)}%`;
    element.style.top = `${100 * (v + y / 2)}%`;
    element.setAttribute("aria-valuetext", directionInWords(to));
    element.setAttribute("aria-valuenow", String(Math.round((Math.acos(Math.min(z, 1)) * 180) / Math.PI)));
  }

  function key(event) {
    const next = directionAfterKey(direction, event);
    if (next) onmove(next);
    return next !== null;
  }

  /** Show the lamp's colour and whether it is selected; and how much of it is seen, from 0 to 1. */
  function dress({ colour, isSelected, label }) {
    element.style.backgroundColor = colour;
    element.classList.toggle("selected", isSelected);
    element.setAttribute("aria-label", label);
  }

  const fade = (opacity) => { element.style.opacity = String(opacity); };
  return { element, at, show, dress, fade, key };
}

/** The lamps over the picture, in `stage`, and the panel with their values. Event: "change". */
export class Light extends EventTarget {
  /** @type {Lamp[]} */
  #lamps = [];
  #ambient = 0;
  #selected = 0;
  #handles = [];
  #preset = ""; // name of the preset that is shown, until something is changed
  // Elements.
  #add; #colour; #note; #presets; #remove; #sliders; #words;

  /** ambient: initial fraction of ambient light. */
  constructor(ambient) {
    super();
    const first = { lamps: [lampAt([-0.55, -0.5])], ambient };
    this.element = this.#build(first);
    this.set(first);
  }

  get lamps() { return this.#lamps; }
  get ambient() { return this.#ambient; }
  /** Index of the lamp whose values the panel shows. */
  get selected() { return this.#selected; }
  get #lamp() { return this.#lamps[this.#selected]; }

  /** Replace all lights, by those of a preset if it is named. @param {Lights} lights; @param {string} preset */
  set({ lamps, ambient }, preset = "") {
    this.#preset = preset;
    this.#lamps = lamps.map((lamp) => ({ ...lamp }));
    this.#ambient = ambient;
    this.#selected = 0;
    this.#changed();
  }

  key(event) { return this.#handles[this.#selected].key(event); }
  get isShown() { return !this.stage.hidden; }

  /** Show the panel, or not; isIdle: it stays where it is although there is nothing to light, so that nothing moves. */
  show(on, isIdle = false) {
    this.element.hidden = !on;
    this.element.inert = isIdle;
    this.stage.hidden = !on || isIdle;
  }

  /** Say what is to be known before the picture is saved. @param {string} text */
  note(text) {
    this.#note.textContent = text;
    this.#note.hidden = !text;
  }

  /** Lay the lamps over the object, inside the view where possible. */
  place(viewer, shape) {
    const box = bounds(shape);
    if (!box || !this.isShown) return;
    const { clientWidth: w, clientHeight: high } = viewer.container;
    const [x, y] = viewer.toScreen(middleOf(box));
    const room = 2 * (Math.min(x, y, w - x, high - y) - EDGE);
    const size = Math.max(LEAST, Math.min(BALL * viewer.scale * Math.max(box[2] - box[0], box[3] - box[1]), room));
    const css = { left: x - size / 2, top: y - size / 2, width: size, height: size };
    for (const [side, value] of Object.entries(css)) this.stage.style[side] = `${value}px`;
  }

  #build(first) {
    this.stage = h("div.light-stage", { role: "group", "aria-label": "Lamps", hidden: true, testid: "light-stage" });
    this.#words = h("p.small.light-words", { "aria-live": "polite", testid: "light-words" });
    this.#add = button("Add", {
      icon: "plus", small: true, testid: "lamp-add", title: "Add a lamp",
      onclick: () => this.#put([...this.#lamps, lampAt(this.#freePlace())], this.#lamps.length),
    });
    this.#remove = button("Remove", {
      icon: "trash", small: true, testid: "lamp-remove", title: "Remove the selected lamp",
      onclick: () => this.#put(this.#lamps.filter((lamp) => lamp !== this.#lamp), 0),
    });
    this.#colour = h("input.light-colour", {
      type: "color", "aria-label": "Colour of the lamp", testid: "lamp-colour",
      oninput: () => this.#edit("colour", this.#colour.value),
    });
    const lights = { "One lamp": first, ...PRESETS };
    const labels = Object.fromEntries(Object.keys(lights).map((name) => [name, name]));
    this.#presets = menu("Presets…", labels, (name) => this.set(lights[name], name), {
      "aria-label": "Preset lights", testid: "light-presets",
    });
    this.#sliders = SLIDERS.map((of) => this.#slider(of));
    const values = h("div.column.tight", this.#words, h("div.row.tight", this.#colour, this.#add, this.#remove));
    this.#note = h("p.small.muted", { hidden: true, testid: "light-note" });
    return h("section.panel.light", { "aria-label": "Light", hidden: true, testid: "light" },
      this.#presets, values, this.#sliders.map(({ element }) => element), this.#note);
  }

  #freePlace() { return freePlace(this.#lamps, [-this.#lamp.direction[0] || 0.5, -0.2]); }

  #slider({ key, label, max, what }) {
    const { element, show } = labelledSlider(label, (value) => this.#edit(key, value), {
      class: "light-slider small", title: what, min: "0", max, step: "0.01", "aria-label": what, testid: `light-${key}`,
    });
    const valueOf = () => (key === "ambient" ? this.#ambient : this.#lamp[key]);
    return { element, show: () => show(valueOf(), `${Math.round(100 * valueOf())} %`) };
  }

  #handle() {
    const handle = lampHandle({
      class: "light-lamp", title: "Drag the lamp; arrow keys move it", testid: "lamp",
      onmove: (direction) => this.#edit("direction", direction),
      onfocus: () => {
        this.#selected = this.#handles.indexOf(handle);
        this.#show();
      },
    });
    return handle;
  }

  #put(lamps, selected) {
    this.#lamps = lamps;
    this.#preset = "";
    this.#selected = selected;
    this.#changed();
    this.#handles[selected].element.focus({ preventScroll: true });
  }

  #edit(key, value) {
    this.#preset = "";
    if (key === "ambient") this.#ambient = value;
    else this.#lamp[key] = value;
    this.#changed();
  }

  #changed() {
    this.#show();
    this.dispatchEvent(new Event("change"));
  }

  #show() {
    const [lamps, lamp, selected] = [this.#lamps, this.#lamp, this.#selected];
    const handles = this.#handles;
    while (handles.length < lamps.length) this.stage.append(handles[handles.push(this.#handle()) - 1].element);
    while (handles.length > lamps.length) handles.pop().element.remove();
    lamps.forEach(({ direction, colour }, i) => {
      handles[i].show(direction);
      handles[i].dress({ colour, isSelected: i === selected, label: `Lamp ${i + 1}` });
    });
    const which = lamps.length > 1 ? `Lamp ${selected + 1} of ${lamps.length}` : "Lamp";
    this.#words.textContent = `${which} ${directionInWords(lamp.direction)}`;
    this.#colour.value = lamp.colour;
    this.#presets.value = this.#preset;
    this.#add.disabled = lamps.length >= MOST;
    this.#remove.disabled = lamps.length < 2;
    for (const { show } of this.#sliders) show();
  }
}

const DARKEST = 0.02; // least light
const LONGEST = 1.5; // largest exposure
const GAMMA = 2.2;
const INSIDE = 250; // share of light, of 255, from which a pixel counts as the object's
const LONGEST_SIDE = 800; // pixels

/** Light of a lamp from the cosine between normal and lamp. */
const lit = (facing, softness) =>
  Math.abs(facing) < softness ? (facing + softness) ** 2 / (4 * softness) : Math.max(facing, 0);

export const pixelsOf = (image) => {
  const ctx = new OffscreenCanvas(image.width, image.height).getContext("2d");
  ctx.drawImage(image, 0, 0);
  return ctx.getImageData(0, 0, image.width, image.height);
};

export class RoughLight {
  #box; #flat; #layer;
  #brighter; #darker;
  #n; // pixels
  #x; #y; #z; #share; #light; #frontal; // of each

  /** flat: the picture without shading; normals: x and y in red and green, the share of light in blue; box: [left, top,
   *  width, height] of these in the picture, as fractions. */
  constructor(flat, normals, box) {
    const factor = Math.min(1, LONGEST_SIDE / Math.max(flat.width, flat.height));
    const [width, height] = [flat.width, flat.height].map((side) => Math.round(factor * side));
    this.canvas = Object.assign(document.createElement("canvas"), { width, height });
    this.#flat = new OffscreenCanvas(width, height);
    this.#flat.getContext("2d").drawImage(flat, 0, 0, width, height);
    this.#box = box.map((side, i) => side * [width, height][i % 2]);
    this.#darker = pixelsOf(normals); // factors below 1, by which the picture is multiplied
    this.#brighter = pixelsOf(normals); // 1 - 1 / factor of those above 1, with which it is dodged
    this.#layer = new OffscreenCanvas(normals.width, normals.height);
    const { data } = pixelsOf(normals);
    this.#n = data.length / 4;
    const part = (of) => Float32Array.from({ length: this.#n }, (_, i) => of(data.subarray(4 * i)));
    this.#x = part(([red]) => (red - 128) / 127);
    this.#y = part(([, green]) => (green - 128) / 127);
    this.#z = this.#x.map((x, i) => Math.sqrt(Math.max(1 - x * x - this.#y[i] ** 2, 0)));
    this.#share = part(([, , blue]) => blue / 255);
    this.#light = new Float32Array(3 * this.#n);
    this.#frontal = new Float32Array(this.#n);
  }

  /** Paint the object under lights with colours as numbers. */
  draw({ lamps, ambient }) {
    const ctx = this.canvas.getContext("2d");
    this.#compute(lamps, ambient);
    ctx.globalCompositeOperation = "copy";
    ctx.drawImage(this.#flat, 0, 0);
    this.#blend(ctx, "multiply", this.#darker);
    this.#blend(ctx, "color-dodge", this.#brighter);
  }

  /** @param {GlobalCompositeOperation} how */
  #blend(ctx, how, factors) {
    this.#layer.getContext("2d").putImageData(factors, 0, 0);
    ctx.globalCompositeOperation = how;
    ctx.drawImage(this.#layer, ...this.#box);
  }

  #compute(lamps, ambient) {
    const [n, x, y, z] = [this.#n, this.#x, this.#y, this.#z];
    const [share, light, frontal] = [this.#share, this.#light, this.#frontal];
    const linear = lamps.map(({ colour, strength, ...lamp }) =>
      ({ ...lamp, channels: colour.map((value) => strength * value ** GAMMA) }));
    const [darker, brighter, sums] = [this.#darker.data, this.#brighter.data, { frontal: 0, light: 0 }];
    for (let i = 0; i < n; i += 1) {
      frontal[i] = Math.max(ambient + (1 - ambient) * z[i], DARKEST);
      for (let c = 0; c < 3; c += 1) light[3 * i + c] = ambient;
      for (const { direction: [u, v, w], channels, softness } of linear) {
        const from = (1 - ambient) * lit(u * x[i] + v * y[i] + w * z[i], softness);
        for (let c = 0; c < 3; c += 1) light[3 * i + c] += from * channels[c];
      }
      for (let c = 0; c < 3; c += 1) light[3 * i + c] = Math.max(light[3 * i + c], DARKEST);
      if (share[i] < INSIDE / 255) continue;
      sums.frontal += frontal[i];
      sums.light += (light[3 * i] + light[3 * i + 1] + light[3 * i + 2]) / 3;
    }
    const exposure = Math.min(Math.sqrt(sums.frontal / Math.max(sums.light, 1e-6)), LONGEST);
    for (let i = 0; i < n; i += 1)
      for (let c = 0; c < 3; c += 1) {
        const factor = share[i] ? ((exposure * light[3 * i + c]) / frontal[i]) ** (share[i] / GAMMA) : 1;
        darker[4 * i + c] = 255 * Math.min(factor, 1);
        brighter[4 * i + c] = 255 * (1 - 1 / Math.max(factor, 1));
      }
  }
}
