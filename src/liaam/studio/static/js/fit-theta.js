// The light-invariant image of a picture, with the slider of theta. It is computed in the browser, so that each frame
// follows the slider:
//     L(theta) = cos(theta) log R/B + sin(theta) log G/B.
// The server sends the two logarithms once, as 16-bit integers. A frame takes two products and a look-up per pixel.

import { api } from "./api.js";
import { button, consume, FrameMeter, h, segmented, slider } from "./ui.js";

export const STEPS = 4096; // integer steps of the server's chroma per unit of natural logarithm
export const MASKED = -32768; // value of an unusable pixel (too dark or overexposed)
const LEAST_HALF = 0.02; // half width of the displayed range, so that it is not filled by the noise of a grey picture
const SAMPLED = 4096; // pixels for percentiles: 1 % of them are forty pixels, and they can be sorted in each frame
const SHARE = 0.01;

/** Chroma of a picture from the server's bytes, little-endian: two uint32 (width, height), two float32 (covered width
 *  and height of the picture from its upper left, in its pixels), then int16 (height, width, 2). */
export function parseChroma(buffer) {
  const found = buffer.byteLength;
  if (found < 16) throw new RangeError("The picture's chroma is incomplete: reload the page.");
  const [width, height] = new Uint32Array(buffer, 0, 2);
  const expected = 16 + 4 * width * height;
  if (found !== expected)
    throw new RangeError(`The picture's chroma has ${found} bytes instead of ${expected}: reload the page.`);
  return { width, height, covered: [...new Float32Array(buffer, 8, 2)], values: new Int16Array(buffer, 16) };
}

const commonDivisor = (a, b) => (b ? commonDivisor(b, a % b) : a);

/** Evenly spaced usable pixels, the same for every theta, so that the range does not jump between frames. */
export function sampleChroma({ width, values }, limit = SAMPLED) {
  const n = values.length / 2;
  let stride = Math.max(1, Math.floor(n / limit));
  // A stride with a common factor with the width would sample a few columns only.
  while (commonDivisor(width, stride) > 1) stride += 1;
  const spaced = Array.from({ length: Math.ceil(n / stride) }, (_, i) => 2 * i * stride);
  const usable = spaced.filter((at) => values[at] !== MASKED);
  const channel = (c) => Float32Array.from(usable, (at) => values[at + c] / STEPS);
  return { red: channel(0), green: channel(1) };
}

export function measurable({ values }) {
  const usable = values.filter((value, i) => i % 2 === 0 && value !== MASKED).length;
  return values.length ? (2 * usable) / values.length : 0;
}

/** Range {centre, half} of the invariant between the 1st and 99th percentile of the pixels. */
export function robustRange({ red, green }, theta) {
  const n = red.length;
  if (!n) return { centre: 0, half: 1 };
  const [c, s] = [Math.cos(theta), Math.sin(theta)];
  const projected = new Float32Array(n);
  for (let i = 0; i < n; i += 1) projected[i] = c * red[i] + s * green[i];
  projected.sort();
  const low = projected[Math.floor(SHARE * (n - 1))];
  const high = projected[Math.ceil((1 - SHARE) * (n - 1))];
  return { centre: (low + high) / 2, half: Math.max((high - low) / 2, LEAST_HALF) };
}

/** Range while theta is dragged: the contrast stays, so that an edge fades only because the light cancels. */
export const steadyRange = (sample, theta, held) => ({ centre: robustRange(sample, theta).centre, half: held.half });

/** Write the colours of the invariant image into 32-bit pixels. Unusable ones are hatched, unlike dark ones. */
export function paintInvariant({ width, height, values }, theta, { centre, half }, colours, out) {
  const gain = 128 / (half * STEPS);
  const c = Math.cos(theta) * gain;
  const s = Math.sin(theta) * gain;
  const shift = 128 - (128 * centre) / half;
  let i = 0;
  for (let y = 0; y < height; y += 1) {
    for (let x = 0; x < width; x += 1, i += 1) {
      const red = values[2 * i];
      if (red === MASKED) {
        out[i] = (x + y) & 4 ? HATCH_LIGHT : HATCH_DARK;
        continue;
      }
      const level = c * red + s * values[2 * i + 1] + shift;
      out[i] = colours[level < 0 ? 0 : level > 255 ? 255 : level | 0];
    }
  }
}

const packed = (r, g, b) => ((255 << 24) | (b << 16) | (g << 8) | r) >>> 0;
const HATCH_DARK = packed(52, 50, 58);
const HATCH_LIGHT = packed(84, 80, 94);

/** Anchors of viridis (Smith and van der Walt, CC0), evenly spaced. */
const VIRIDIS = [
  [68, 1, 84], [72, 40, 120], [62, 73, 137], [49, 104, 142], [38, 130, 142], [31, 158, 137], [53, 183, 121],
  [110, 206, 88], [181, 222, 43], [253, 231, 37],
];

function colourTable(anchors) {
  return Uint32Array.from({ length: 256 }, (_, level) => {
    const at = (level / 255) * (anchors.length - 1);
    const below = Math.min(Math.floor(at), anchors.length - 2);
    const mixed = anchors[below].map((value, k) => Math.round(value + (at - below) * (anchors[below + 1][k] - value)));
    return packed(...mixed);
  });
}

export const COLOURS = { grey: colourTable([[0, 0, 0], [255, 255, 255]]), viridis: colourTable(VIRIDIS) };
const PHYSICAL = [90, 135]; // the angles of real cameras, degrees

/** Angle after an arrow key, degrees; null for other keys. Shift moves in small steps. */
export function thetaAfterKey(theta, { key, shiftKey = false }) {
  const step = shiftKey ? 0.1 : 1;
  const moved = {
    ArrowLeft: theta - step, ArrowDown: theta - step, ArrowRight: theta + step, ArrowUp: theta + step,
    PageDown: theta - 10, PageUp: theta + 10, Home: 0, End: 180,
  }[key];
  if (moved === undefined) return null;
  return Math.round(10 * Math.min(180, Math.max(0, moved))) / 10;
}

/** Angle in degrees, folded into 0..180, which covers every invariant up to its sign. */
export const foldedTheta = (degrees) => ((degrees % 180) + 180) % 180;

const SIZE = 1024; // longest side of the requested chroma: full size for 640x480, and fast to draw for all pictures
const USUAL = 118; // typical angle of real cameras in degrees, for pictures without a model or a fit
const PAUSE = 350; // milliseconds after the last key until the contrast is adapted, as at the end of a drag

export class InvariantView {
  #viewer;
  #meter = new FrameMeter();
  #theta = USUAL;
  #angles = { model: null, fit: null }; // that are marked, degrees
  #canvas = document.createElement("canvas");
  #colours = "grey";
  #chroma = null;
  #dirty = false; // whether the canvas is out of date
  #held = null; // range of the colours while theta is dragged
  #chosen = false; // whether theta was chosen for the picture
  #asked = null; // the source whose chroma was asked for
  #sample = null; // pixels of the chroma that the range is taken from
  #range = null;
  #image = null; // that is painted, and its pixels
  #pixels = null;
  #timer = null; // until the contrast is adapted
  #marked = null; // the angles whose marks are shown
  // Elements.
  #marks; #note; #slider; #text;

  constructor(viewer) {
    this.#viewer = viewer;
    this.controls = this.#controls();
    this.#show();
  }

  /** Frames of a dragged slider. */
  get meter() { return this.#meter; }
  /** The angle, in degrees. */
  get theta() { return this.#theta; }
  get isShown() { return !this.controls.hidden; }
  /** Show the controls, or not. */
  show(on) { this.controls.hidden = !on; }

  get image() {
    if (!this.#chroma || !this.#dirty) return this.#chroma && this.#canvas;
    const range = this.#held ? steadyRange(this.#sample, this.#radians, this.#held) : this.#range;
    paintInvariant(this.#chroma, this.#radians, range, COLOURS[this.#colours], this.#pixels);
    this.#canvas.getContext("2d").putImageData(this.#image, 0, 0);
    this.#dirty = false;
    if (this.#held) this.#meter.tick();
    return this.#canvas;
  }

  /** Part of the picture that the image covers, in its pixels; null: all. */
  get covered() { return this.#chroma?.covered ?? null; }

  /** Drop the picture; its chroma is fetched when the view is opened. */
  clear() {
    this.#chroma = null;
    this.#chosen = false;
    this.#note.textContent = "";
    this.#asked = null;
  }

  async load(source) {
    if (this.#asked === source) return;
    this.#asked = source;
    await source.ready;
    try {
      const chroma = parseChroma(await api.buffer(source.address("chroma", SIZE)));
      if (this.#asked === source) this.#take(chroma);
    } catch (error) {
      if (this.#asked !== source) return;
      this.#asked = null;
      throw error;
    }
  }

  #take(chroma) {
    this.#chroma = chroma;
    this.#sample = sampleChroma(chroma);
    Object.assign(this.#canvas, { width: chroma.width, height: chroma.height });
    this.#image = new ImageData(chroma.width, chroma.height);
    this.#pixels = new Uint32Array(this.#image.data.buffer);
    const lost = 1 - measurable(chroma);
    this.#note.textContent = lost > 0.5 ? `${Math.round(100 * lost)} % too dark or overexposed (hatched)` : "";
    this.#adaptContrast();
  }

  /** Mark the angles of the model and the fit, in degrees. The fit's, or else the model's, is the initial value. */
  mark({ model = null, fit = null }) {
    this.#angles = { model: model == null ? null : foldedTheta(model), fit: fit == null ? null : foldedTheta(fit) };
    this.#use(this.#chosen ? this.#theta : this.#default, this.#chosen);
  }

  #use(theta, chosen = false) {
    this.#theta = theta;
    this.#chosen = chosen;
    this.#show();
    this.#adaptContrast();
  }

  get #default() { return Math.round(10 * (this.#angles.fit ?? this.#angles.model ?? USUAL)) / 10; }

  key(event) {
    const next = thetaAfterKey(this.#theta, event);
    if (next === null) return false;
    this.#move(next);
    clearTimeout(this.#timer);
    this.#timer = setTimeout(() => this.#adaptContrast(), PAUSE);
    return true;
  }

  #move(theta) {
    this.#chosen = true;
    this.#theta = theta;
    if (this.#chroma) this.#held ??= this.#range;
    this.#dirty = true;
    this.#show();
    this.#viewer.redraw();
  }

  #adaptContrast() {
    this.#held = null;
    if (!this.#chroma) return;
    this.#range = robustRange(this.#sample, this.#radians);
    this.#dirty = true;
    this.#viewer.redraw();
  }

  get #radians() { return (this.#theta * Math.PI) / 180; }

  #controls() {
    this.#slider = slider({
      min: "0", max: "180", step: "0.1", testid: "theta-slider",
      "aria-label": "Angle θ of the invariant image in degrees",
      oninput: () => this.#move(Number(this.#slider.value)), onchange: () => this.#adaptContrast(),
      onkeydown: (event) => this.key(event) && consume(event),
    });
    this.#text = h("output.number.fit-theta-text", { testid: "theta-value" });
    this.#marks = h("div.fit-theta-marks", { "aria-hidden": "true" });
    this.#note = h("span.small.muted");
    const reset = button("Reset", {
      small: true, testid: "theta-reset", title: "Reset to the angle of the fit or the model",
      onclick: () => this.#use(this.#default),
    });
    const choices = [{ value: "grey", label: "Grey" }, { value: "viridis", label: "Viridis" }];
    const colours = segmented("Colours", choices, this.#colours, (value) => {
      this.#colours = value;
      this.#dirty = true;
      this.#viewer.redraw();
    });
    return h("div.fit-controls",
      h("span.fit-theta-name", "θ"), h("div.fit-theta", this.#slider, this.#marks),
      this.#text, reset, colours.element, this.#note);
  }

  #show() {
    this.#slider.value = String(this.#theta);
    this.#text.textContent = `${this.#theta.toFixed(1)}°`;
    this.#slider.setAttribute("aria-valuetext", `${this.#theta.toFixed(1)} degrees`);
    const { model, fit } = this.#angles;
    if (this.#marked === this.#angles) return;
    this.#marked = this.#angles;
    const mark = (name, at) => h("span.mark", { class: name, title: name, style: `--at: ${at / 180}` }, name);
    const [from, to] = PHYSICAL.map((degrees) => degrees / 180);
    const isApart = fit != null && (model == null || Math.abs(fit - model) > 0.05);
    this.#marks.replaceChildren(...[
      h("span.range", { title: "Angles of real cameras: between 90° and 135°", style: `--from: ${from}; --to: ${to}` }),
      model != null && mark("model", model), isApart && mark("fit", fit),
    ].filter(Boolean));
  }
}
