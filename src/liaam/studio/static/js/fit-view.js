// The picture with its views, overlays and divider, and the controls of each view.

import { api } from "./api.js";
import { Divider } from "./divider.js";
import { expert } from "./expert.js";
import { drawFit, drawOver, drawSpecimens, Overlays } from "./fit-draw.js";
import { significant } from "./fit-run.js";
import { InvariantView } from "./fit-theta.js";
import { look } from "./look.js";
import { Light, lightQuery, numbersOf, RoughLight } from "./relight.js";
import { button, FrameMeter, h, press, segmented, slider } from "./ui.js";
import { Viewer } from "./viewer.js";

const VIEWS = [
  { name: "picture", label: "Picture", hint: "Drop or paste another picture here, or select one in the list." },
  { name: "flat", label: "Flat", after: "Without shading",
    hint: "The object under the training light, without the shading of this picture." },
  { name: "shading", label: "Shading", after: "Shading",
    hint: "The effect of the light: the picture divided by its flat appearance." },
  { name: "residual", label: "Residual", after: "Residual", hint: "The difference between the picture and the model.",
    expert: true },
  { name: "invariant", label: "Invariant", after: "Invariant", expert: true },
  { name: "relit", label: "Relight", after: "Relit", hint: "Drag the lamp over the picture, and the line between before and after." },
];

const LIKE_PICTURES = ["flat", "relit"]; // brightness and contrast change them, too; in the others, colours are values

/** Layers fetched from the server for a view, once per fit. */
const FETCHED = { flat: ["flat"], shading: ["shading"], residual: ["residual"], relit: ["flat", "normals"] };
const LAYER_SIZE = 1600;
const REST = 150; // milliseconds after the last move of a lamp until the exact picture is fetched

export class FitView {
  source = null;
  fit = null;
  others = []; // fits of the other specimens
  name = "picture";
  iteration = null; // {shape, final} of the slider, null for the result
  opacity = Object.fromEntries(VIEWS.map(({ name }) => [name, 1])); // of views and overlays
  meter = new FrameMeter(); // of a dragged lamp
  // Each view has its own overlays, since those of the picture would hide the others.
  _drawn = new Map(VIEWS.map(({ name }) => [name, new Set(name === "picture" ? ["contours", "landmarks"] : [])]));
  _images = new Map();
  _faults = new Map(); // view -> error message of the server
  _scales = new Map(); // view -> {limit, what} of its colours
  _split = new Set(["flat", "relit"]); // views that are shown beside the picture

  /** @param {import("./fit.js").Tab} tab */
  constructor(tab) {
    this._tab = tab;
    this.container = h("div.fit-viewer", { testid: "fit-viewer" });
    this.viewer = new Viewer(this.container, { label: "Picture to fit" });
    this.divider = new Divider(this.viewer, () => this.viewer.redraw());
    this.invariant = new InvariantView(this.viewer);
    this.light = new Light(tab.state.project.default_ambient);
    this.container.append(this.light.stage);
    this.light.addEventListener("change", () => this._relight());
    const choices = VIEWS.map(({ name, label, hint }) => ({ value: name, label, title: hint }));
    this._choice = segmented("View", choices, this.name, (name) => this.show(name), "layer");
    this.chooser = this._choice.element;
    this.splitter = button("Before | after", {
      icon: "compare", kind: "roomy", small: true, pressed: false, shortcut: "S", testid: "fit-split",
      title: "Show the picture on the left of a line and the view on its right", onclick: () => this.toggleSplit(),
    });
    this.overlays = new Overlays([], () => this.viewer.redraw(), "layer");
    this.layers = this._layers();
    this._hint = h("p.small.muted.fit-hint");
    this._legend = h("div.fit-legend.small.muted");
    this.bar = h("div.fit-bar", this._hint, this._legend, this.invariant.controls);
    this.viewer.addLayer((ctx, viewer) => this._draw(ctx, viewer));
    this.show("picture");
    expert.follow(() => this._offer());
  }

  setSource(source) {
    const another = source?.key !== this.source?.key;
    this.source = source;
    this.viewer.setPicture(source?.image ?? null, source?.width ?? 0, source?.height ?? 0, source?.tiles ?? null);
    if (!another) return;
    if (source) this.viewer.fit();
    this.invariant.clear();
    this.setFit(null);
  }

  setFit(fit) {
    this.fit = fit;
    this.iteration = null;
    for (const known of [this._images, this._faults, this._scales]) known.clear();
    this._rough = null; // computes the relit picture in the browser
    this._moved = this._isRough = false; // whether it has not been painted since a lamp moved, and whether it is shown
    this._dropRelit();
    this.show(this.name);
  }

  setIteration(iteration) {
    this.iteration = iteration;
    this.viewer.redraw();
  }

  show(name) {
    this.name = name;
    this._faults.delete(name); // retry a view that has failed
    this._choice.value = name;
    this.overlays.show(this._drawn.get(name));
    this._load();
    this._changed();
  }

  /** Names of the views that may be chosen. */
  get _offered() { return VIEWS.filter((view) => expert.on || !view.expert).map(({ name }) => name); }

  _offer() {
    const offered = this._offered;
    for (const each of this._choice.element.children) each.hidden = !offered.includes(each.value);
    if (!offered.includes(this.name)) this.show("picture");
  }

  cycle(by) {
    const can = this._offered.filter((name) => !this._why(name));
    this.show(can[(can.indexOf(this.name) + by + can.length) % can.length] ?? "picture");
  }

  toggleSplit() {
    if (!this.source) return;
    // The picture has no counterpart: switch to the most useful view.
    const isSplit = this._split.has(this.name);
    if (this.name === "picture") this.show(this._offered.find((name) => ["flat", "invariant"].includes(name) && !this._why(name)) ?? "picture");
    if (isSplit) this._split.delete(this.name);
    else if (this.name !== "picture") this._split.add(this.name);
    this._changed();
  }

  key(event) {
    if (this.name === "invariant" && event.key.startsWith("Arrow")) return this.invariant.key(event);
    if (!this.light.hidden && event.key.startsWith("Arrow")) return this.light.key(event);
    return this.overlays.key(event) || this.viewer.key(event);
  }

  // Why a view is unavailable, or "".

  _why(name) {
    if (name === "picture") return "";
    if (this._faults.has(name)) return this._faults.get(name);
    if (!this.source) return "Open a picture first.";
    if (name === "invariant") return "";
    if (!this.fit) return "This picture has not been fitted yet.";
    const layer = name === "relit" ? "flat" : name;
    if (this.fit.layers.includes(layer)) return "";
    return `${this.fit.no_flat[0].toUpperCase()}${this.fit.no_flat.slice(1)}.`;
  }

  async _load() {
    if (this._why(this.name)) return;
    if (this.name === "relit" && !this._images.has("relit")) this._relight(0);
    await Promise.all((FETCHED[this.name] ?? []).map((layer) => this._fetch(layer)));
    if (this.name !== "invariant") return;
    const { source } = this;
    try {
      await this.invariant.load(source);
    } catch (error) {
      if (this.source === source) this._failed("invariant", error);
    }
  }

  async _fetch(layer) {
    const { fit } = this;
    if (this._images.has(layer)) return;
    this._images.set(layer, null); // requested
    try {
      const { image, scale } = await api.layer(api.url("fits", fit.id, "layers", layer, { size: LAYER_SIZE }));
      if (this.fit !== fit) return;
      this._images.set(layer, image);
      this._scales.set(layer, scale);
      this._changed();
    } catch (error) {
      if (this.fit === fit) this._images.delete(layer);
      this._failed(layer, error, fit);
    }
  }

  /** Show the error of a view. If the server no longer has the fit, it is fitted again. */
  _failed(name, error, fit = null) {
    if (fit && fit !== this.fit) return;
    if (fit && error.status === 404) return this._tab.forgotten(fit);
    this._faults.set(name, error.message);
    return this._changed();
  }

  /** Show the object under the lamps: what the browser can compute at once, and the exact picture when they rest. */
  _relight(wait = REST) {
    this._dropRelit();
    if (this.name !== "relit" || this._why("relit")) return;
    const layers = FETCHED.relit.map((layer) => this._images.get(layer));
    if (this._images.has("relit") && layers.every(Boolean)) {
      this._rough ??= new RoughLight(...layers, this._scales.get("normals").box);
      this._moved = true;
    }
    this._awaited = setTimeout(() => this._fetchRelit(this._awaited), wait);
    this.viewer.redraw();
  }

  _dropRelit() {
    clearTimeout(this._awaited);
    this._awaited = null;
  }

  async _fetchRelit(turn) {
    const { fit } = this;
    try {
      const size = Math.min(Math.max(fit.width, fit.height), LAYER_SIZE);
      const { image } = await api.layer(api.url("fits", fit.id, "relit", lightQuery(this.light, size)));
      if (turn !== this._awaited) return;
      this._images.get("relit")?.close();
      this._images.set("relit", image);
      this._moved = this._isRough = false;
    } catch (error) {
      if (turn === this._awaited) this._failed("relit", error, fit);
    }
    if (turn === this._awaited) this._awaited = null;
    this.viewer.redraw();
  }

  /** The rough relit picture while lamps are moved, or else the exact one. */
  _relitImage() {
    if (this._moved) {
      this._rough.draw(numbersOf(this.light));
      this.meter.tick();
      this._isRough = true;
    }
    this._moved = false;
    return this._isRough ? this._rough.canvas : this._images.get("relit");
  }

  _layers() {
    const opacity = (label, of, testid) => slider({
      min: "0", max: "1", step: "0.05", value: "1", "aria-label": `Opacity: ${label}`, testid: `opacity-${testid}`,
      oninput: ({ target }) => this._setOpacity(of(), Number(target.value)),
    });
    this._slider = opacity("view", () => this.name, "view");
    this._layerName = h("span");
    this._layerText = h("span.number");
    const overlays = this.overlays.buttons.map((each) => {
      const { name } = each.dataset;
      return [each, opacity(each.textContent, () => name, name)];
    });
    return h("div.fit-layers.small", h("label.fit-layer", this._layerName, this._slider, this._layerText), overlays);
  }

  _setOpacity(layer, opacity) {
    this.opacity[layer] = opacity;
    this._changed();
  }

  /** Make the view more transparent in steps, then opaque again. */
  fade() {
    const opacity = this.opacity[this.name];
    if (this.name !== "picture") this._setOpacity(this.name, opacity > 0.25 ? opacity - 0.25 : 1);
  }

  _changed() {
    const view = VIEWS.find(({ name }) => name === this.name);
    const why = this._why(this.name);
    for (const each of this._choice.element.children)
      each.classList.toggle("unavailable", Boolean(this._why(each.value)));
    this._layerName.textContent = view.label;
    this._slider.disabled = this.name === "picture";
    this._slider.value = String(this.opacity[this.name]);
    this._layerText.textContent = `${Math.round(100 * this.opacity[this.name])} %`;
    this.invariant.controls.hidden = this.name !== "invariant" || Boolean(why);
    this._hint.textContent = this.source ? why || view.hint || "" : "";
    this._hint.classList.toggle("error-text", this._faults.has(this.name));
    this._hint.hidden = !this.invariant.controls.hidden;
    this.splitter.disabled = !this.source;
    this._explain(why ? null : this._scales.get(this.name));
    this.light.hidden = this.name !== "relit" || Boolean(why);
    const isSplit = this._split.has(this.name);
    press(this.splitter, isSplit);
    if (isSplit) this.divider.label("Picture", view.after);
    this.viewer.redraw();
  }

  _explain(scale) {
    this._legend.hidden = !scale;
    if (!scale) return;
    const shading = this.name === "shading";
    // Shading is a logarithm; show it as a multiple of the training light.
    const most = shading ? significant(Math.exp(scale.limit)) : significant(scale.limit, 2);
    const [low, high] = shading ? [`1/${most}`, `${most}×`] : [`−${most}`, `+${most}`];
    this._legend.replaceChildren(
      h("span", scale.what), h("span.number", low),
      h("span.fit-ramp", { class: this.name, role: "img", "aria-label": `Colours from ${low} to ${high}` }),
      h("span.number", high),
    );
  }

  _image() {
    if (this._why(this.name)) return null;
    if (this.name === "invariant") return this.invariant.image;
    return (this.name === "relit" ? this._relitImage() : this._images.get(this.name)) ?? null;
  }

  _draw(ctx, viewer) {
    const image = this._image();
    const isSplit = this._split.has(this.name);
    this.divider.element.hidden = !isSplit || !image; // no label for what is not drawn
    if (image) {
      drawOver(ctx, viewer, image, {
        from: isSplit ? this.divider.x : null, opacity: this.opacity[this.name],
        covered: this.name === "invariant" ? this.invariant.covered : null,
        filter: LIKE_PICTURES.includes(this.name) ? look.filter : "none",
      });
    }
    const { fit, opacity, overlays } = this;
    if (!viewer.tool?.hidesFit) drawSpecimens(ctx, viewer, fit, this.others, overlays.shown, opacity);
    if (fit && !viewer.tool?.hidesFit) drawFit(ctx, viewer, fit, overlays.shown, { ...this.iteration, opacity });
    viewer.tool?.draw(ctx, viewer);
    if (fit) this.light.place(viewer, fit.shape);
  }
}
