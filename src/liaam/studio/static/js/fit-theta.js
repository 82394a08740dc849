// The invariant image with the slider of theta.

import { api } from "./api.js";
import {
  COLOURS, foldedTheta, measurable, paintInvariant, parseChroma, PHYSICAL, robustRange, sampleChroma, steadyRange,
  thetaAfterKey,
} from "./invariant.js";
import { button, consume, FrameMeter, h, segmented, slider } from "./ui.js";

const SIZE = 1024; // longest side of the requested chroma: full size for 640x480, and fast to draw for all pictures
const USUAL = 118; // typical angle of real cameras in degrees, for pictures without a model or a fit
const PAUSE = 350; // milliseconds after the last key until the contrast is adapted, as at the end of a drag

export class InvariantView {
  meter = new FrameMeter();
  theta = USUAL;
  marks = { model: null, fit: null };
  canvas = document.createElement("canvas");
  colours = "grey";
  _chroma = null;
  _dirty = false; // whether the canvas is out of date
  _held = null; // range of the colours while theta is dragged
  _chosen = false; // whether theta was chosen for the picture

  constructor(viewer) {
    this.viewer = viewer;
    this.controls = this._controls();
    this._show();
  }

  get image() {
    if (!this._chroma || !this._dirty) return this._chroma && this.canvas;
    const range = this._held ? steadyRange(this._sample, this._radians, this._held) : this._range;
    paintInvariant(this._chroma, this._radians, range, COLOURS[this.colours], this._pixels);
    this.canvas.getContext("2d").putImageData(this._image, 0, 0);
    this._dirty = false;
    if (this._held) this.meter.tick();
    return this.canvas;
  }

  /** Part of the picture that the image covers, in its pixels; null: all. */
  get covered() { return this._chroma?.covered ?? null; }

  /** Drop the picture; its chroma is fetched when the view is opened. */
  clear() {
    this._chroma = null;
    this._chosen = false;
    this._note.textContent = "";
    this._asked = null;
  }

  async load(source) {
    if (this._asked === source) return;
    this._asked = source;
    await source.ready;
    try {
      const chroma = parseChroma(await api.buffer(source.address("chroma", { size: SIZE })));
      if (this._asked === source) this._take(chroma);
    } catch (error) {
      if (this._asked !== source) return;
      this._asked = null;
      throw error;
    }
  }

  _take(chroma) {
    this._chroma = chroma;
    this._sample = sampleChroma(chroma);
    Object.assign(this.canvas, { width: chroma.width, height: chroma.height });
    this._image = new ImageData(chroma.width, chroma.height);
    this._pixels = new Uint32Array(this._image.data.buffer);
    const lost = 1 - measurable(chroma);
    this._note.textContent = lost > 0.5 ? `${Math.round(100 * lost)} % too dark or overexposed (hatched)` : "";
    this._adaptContrast();
  }

  /** Mark the angles of the model and the fit, in degrees. The fit's, or else the model's, is the initial value. */
  mark({ model = null, fit = null }) {
    this.marks = { model: model == null ? null : foldedTheta(model), fit: fit == null ? null : foldedTheta(fit) };
    this._use(this._chosen ? this.theta : this._default, this._chosen);
  }

  _use(theta, chosen = false) {
    Object.assign(this, { theta, _chosen: chosen });
    this._show();
    this._adaptContrast();
  }

  get _default() { return Math.round(10 * (this.marks.fit ?? this.marks.model ?? USUAL)) / 10; }

  key(event) {
    const next = thetaAfterKey(this.theta, event);
    if (next === null) return false;
    this._move(next);
    clearTimeout(this._timer);
    this._timer = setTimeout(() => this._adaptContrast(), PAUSE);
    return true;
  }

  _move(theta) {
    this._chosen = true;
    this.theta = theta;
    if (this._chroma) this._held ??= this._range;
    this._dirty = true;
    this._show();
    this.viewer.redraw();
  }

  /** Adapt the contrast to the angle at the end of a drag. */
  _adaptContrast() {
    this._held = null;
    if (!this._chroma) return;
    this._range = robustRange(this._sample, this._radians);
    this._dirty = true;
    this.viewer.redraw();
  }

  get _radians() { return (this.theta * Math.PI) / 180; }

  _controls() {
    this._slider = slider({
      min: "0", max: "180", step: "0.1", testid: "theta-slider",
      "aria-label": "Angle θ of the invariant image in degrees",
      oninput: () => this._move(Number(this._slider.value)), onchange: () => this._adaptContrast(),
      onkeydown: (event) => this.key(event) && consume(event),
    });
    this._text = h("output.number.fit-theta-text", { testid: "theta-value" });
    this._marks = h("div.fit-theta-marks", { "aria-hidden": "true" });
    this._note = h("span.small.muted");
    const reset = button("Reset", {
      small: true, testid: "theta-reset", title: "Reset to the angle of the fit or the model",
      onclick: () => this._use(this._default),
    });
    const choices = [{ value: "grey", label: "Grey" }, { value: "viridis", label: "Viridis" }];
    const colours = segmented("Colours", choices, this.colours, (value) => {
      this.colours = value;
      this._dirty = true;
      this.viewer.redraw();
    });
    return h("div.fit-controls",
      h("span.fit-theta-name", "θ"), h("div.fit-theta", this._slider, this._marks),
      this._text, reset, colours.element, this._note);
  }

  _show() {
    this._slider.value = String(this.theta);
    this._text.textContent = `${this.theta.toFixed(1)}°`;
    this._slider.setAttribute("aria-valuetext", `${this.theta.toFixed(1)} degrees`);
    const { model, fit } = this.marks;
    if (this._marked === this.marks) return;
    this._marked = this.marks;
    const mark = (name, at) => h("span.mark", { class: name, title: name, style: `--at: ${at / 180}` }, name);
    const [from, to] = PHYSICAL.map((degrees) => degrees / 180);
    const isApart = fit != null && (model == null || Math.abs(fit - model) > 0.05);
    this._marks.replaceChildren(...[
      h("span.range", { title: "Angles of real cameras: between 90° and 135°", style: `--from: ${from}; --to: ${to}` }),
      model != null && mark("model", model), isApart && mark("fit", fit),
    ].filter(Boolean));
  }
}
