// The picture with its views, overlays and divider, and the controls of each view.

import { api } from "./api.js";
import { Divider } from "./divider.js";
import { expert } from "./expert.js";
import { drawFit, drawOver, drawSpecimens, Overlays } from "./fit-draw.js";
import { IS_TOUCH, several } from "./annotate-words.js";
import { objectOf, reducedText, significant } from "./fit-run.js";
import { InvariantView } from "./fit-theta.js";
import { look } from "./look.js";
import { Balance, balanceQuery, Light, lightQuery, numbersOf, RoughLight } from "./relight.js";
import { button, FrameMeter, h, press, segmented, slider } from "./ui.js";
import { Viewer } from "./viewer.js";

const AS_SHOWN = "in the strength that the panel shows, without points and contours";
/** saves: what of the view is saved as a picture, if it can be. */
const VIEWS = [
  { name: "picture", label: "Picture", hint: `For another picture, ${IS_TOUCH ? "" : "drop or paste it here, or "}press “Open…”.` },
  { name: "flat", label: "Remove shading", after: "Without shading", work: "Removing the shading…", saves: `The whole picture without its shading, ${AS_SHOWN}`,
    hint: "The picture without its shading: in the even light of the pictures that the model was trained on." },
  { name: "balanced", label: "White balance", after: "Colour corrected", work: "Correcting the colour of the light…",
    saves: `The whole picture with the colour of its light corrected, ${AS_SHOWN}`, hint: "Only the colour of the light is corrected, in the whole picture. The shading stays." },
  { name: "shading", label: "Shading", after: "Shading", work: "Computing the shading…", saves: "Only the shading: the surroundings are transparent",
    hint: "The effect of the light alone." },
  { name: "residual", label: "Residual", after: "Residual", work: "Computing the residual…", hint: "The difference between the picture and the model.",
    expert: true },
  { name: "invariant", label: "Invariant", after: "Invariant", work: "Computing the invariant image…", expert: true },
  { name: "relit", label: "Relight", after: "Relit", work: "Relighting…", saves: `The whole picture in this light, ${AS_SHOWN}`,
    hint: "Drag the lamp over the picture.",
    splitHint: "Drag the lamp over the picture, and the line between before and after." },
];

/** What is said where the light is that of training, by view: then none has anything to show or to save. */
const EVEN = {
  balanced: "The light here has no clear colour: there is nothing to correct.",
  flat: "The light here is as even as in the pictures that the model was trained on: nothing is taken off.",
  shading: "The light here is as even as in the pictures that the model was trained on: there is no shading to show.",
};
/** The same over the picture. */
const evenly = (view) => (view === "balanced" ? "No colour to correct" : "Already in even light");

const RELIGHT = "Change its light by the buttons above it. ";
const NOTHING_TO_SAVE = "To save a picture here, remove its shading, correct its colour or relight it first. Export has other files";

const LIKE_PICTURES = ["flat", "balanced", "relit"]; // brightness and contrast change them, too; in the others, colours are values

/** Layers fetched from the server for a view, once per fit. */
const FETCHED = { flat: ["flat"], balanced: ["balanced"], shading: ["shading"], residual: ["residual"], relit: ["flat", "normals"] };
const LAYER_SIZE = 1600;
const REST = 150; // milliseconds after the last move of a lamp until the exact picture is fetched

export class FitView {
  #source = null;
  /** @type {Fit | null} */
  #fit = null;
  /** @type {Fit[]} */
  #others = []; // fits of the other specimens
  #name = "picture";
  #iteration = null; // {shape, final} of the slider, null for the result
  #opacity = Object.fromEntries(VIEWS.map(({ name }) => [name, 1])); // of views and overlays
  #meter = new FrameMeter();
  #divider;
  // Each view has its own overlays, since those of the picture would hide the others.
  #drawn = new Map(VIEWS.map(({ name }) => [name, new Set(name === "picture" ? ["contours", "landmarks"] : [])]));
  #images = new Map();
  #faults = new Map(); // view -> error message of the server
  /** @type {Map<string, Partial<ColourScale & LayerChange & LayerPlace>>} */
  #scales = new Map(); // by view
  #split = new Set(LIKE_PICTURES); // views that are shown beside the picture
  /** @type {import("./fit.js").Tab} */
  #tab;
  #rough = null; // computes the relit picture in the browser
  #moved = false; // whether it has not been painted since a lamp moved
  #isRough = false; // whether it is shown
  #awaited = null; // timer of the exact relit picture; null once it is shown
  // Elements.
  #choice; #hint; #layerName; #layerText; #legend; #saveButton; #slider; #state;

  /** @param {import("./fit.js").Tab} tab */
  constructor(tab) {
    this.#tab = tab;
    this.container = h("div.fit-viewer", { testid: "fit-viewer" });
    this.viewer = new Viewer(this.container, { label: "Picture to fit" });
    this.#divider = new Divider(this.viewer, () => this.viewer.redraw());
    this.invariant = new InvariantView(this.viewer);
    this.light = new Light(tab.state.project.default_ambient);
    this.#state = h("span.fit-state", { role: "status", hidden: true, testid: "fit-state" });
    this.container.append(this.light.stage, this.#state);
    this.light.addEventListener("change", () => this.#relight());
    this.balance = new Balance();
    this.balance.addEventListener("change", () => this.#rebalance());
    const choices = VIEWS.map(({ name, label, hint }) => ({ value: name, label, title: hint }));
    this.#choice = segmented("View", choices, this.#name, (name) => this.show(name), "layer");
    this.chooser = this.#choice.element;
    this.splitter = button("Before | after", {
      icon: "compare", kind: "roomy", small: true, pressed: false, shortcut: "S", testid: "fit-split",
      title: "Show the picture on the left of a line and the view on its right", onclick: () => this.toggleSplit(),
    });
    this.#saveButton = button("Save", {
      icon: "download", kind: "primary", small: true, testid: "fit-save", onclick: () => this.#save(),
    });
    this.overlays = new Overlays([], () => this.viewer.redraw(), "layer");
    this.layers = this.#layers();
    this.#hint = h("p.small.muted.fit-hint");
    this.#legend = h("div.fit-legend.small.muted");
    this.bar = h("div.fit-bar", this.#hint, this.#legend, this.invariant.controls);
    this.viewer.addLayer((ctx, viewer) => this.#draw(ctx, viewer));
    this.setSource(null);
    this.show("picture");
    expert.follow(() => this.#offer());
  }

  /** Name of the view. */
  get name() { return this.#name; }
  /** The button that saves the picture that is shown. */
  get saveButton() { return this.#saveButton; }
  /** Frames of a dragged lamp. */
  get meter() { return this.#meter; }
  /** Whether the view's own image has come, and whether the exact relit picture is awaited. */
  get hasImage() { return this.#image() !== null; }
  get isRelighting() { return this.#awaited !== null; }
  /** The shape that is drawn: that of an iteration, or of the fit. */
  get shownShape() { return this.#iteration?.shape ?? this.#fit?.shape ?? null; }

  setSource(source) {
    const another = source?.key !== this.#source?.key;
    this.#source = source;
    this.container.classList.toggle("without", !source);
    this.bar.hidden = !source;
    this.viewer.setPicture(source?.image ?? null, source?.width ?? 0, source?.height ?? 0, source?.tiles ?? null);
    if (!another) return;
    if (source) this.viewer.fit();
    for (const view of LIKE_PICTURES) this.#opacity[view] = 1; // the strength that was chosen for another picture
    this.#divider.centre();
    this.invariant.clear();
    this.setFit(null);
  }

  /** Show a fit, and those of the other specimens that were fitted with it. @param {Fit | null} fit; @param {Fit[]} others */
  setFit(fit, others = []) {
    this.#fit = fit;
    this.#others = others;
    this.#iteration = null;
    for (const known of [this.#images, this.#faults, this.#scales]) known.clear();
    this.#rough = null;
    this.#moved = this.#isRough = false;
    this.#dropRelit();
    this.show(this.#name);
  }

  /** Fetch again what has failed. */
  retry() {
    if (!this.#faults.size) return;
    this.#faults.clear();
    this.show(this.#name);
  }

  opacityOf(view) { return this.#opacity[view]; }

  setIteration(iteration) {
    this.#iteration = iteration;
    this.viewer.redraw();
  }

  show(name) {
    this.#name = name;
    this.#faults.delete(name); // retry a view that has failed
    this.#choice.value = name;
    this.overlays.show(this.#drawn.get(name));
    this.#load();
    this.#changed();
  }

  /** Names of the views that may be chosen. */
  get #offered() { return VIEWS.filter((view) => expert.on || !view.expert).map(({ name }) => name); }

  #offer() {
    const offered = this.#offered;
    for (const each of this.#choice.element.children) each.hidden = !offered.includes(each.value);
    if (!offered.includes(this.#name)) this.show("picture");
  }

  cycle(by) {
    const can = this.#offered.filter((name) => !this.#why(name));
    this.show(can[(can.indexOf(this.#name) + by + can.length) % can.length] ?? "picture");
  }

  toggleSplit() {
    if (!this.#source) return;
    // The picture has no counterpart: switch to the most useful view.
    const isSplit = this.#split.has(this.#name);
    if (this.#name === "picture") this.show(this.#offered.find((name) => ["flat", "invariant"].includes(name) && !this.#why(name)) ?? "picture");
    if (this.#why(this.#name)) return;
    const alike = LIKE_PICTURES.includes(this.#name) ? LIKE_PICTURES : [this.#name];
    if (isSplit) for (const name of alike) this.#split.delete(name);
    else if (this.#name !== "picture") for (const name of alike) this.#split.add(name);
    this.#changed();
  }

  key(event) {
    if (this.#name === "invariant" && event.key.startsWith("Arrow")) return this.invariant.key(event);
    if (this.light.isShown && event.key.startsWith("Arrow")) return this.light.key(event);
    return this.overlays.key(event) || this.viewer.key(event);
  }

  // Why a view is unavailable, or "".

  #why(name) {
    if (name === "picture") return "";
    if (this.#faults.has(name)) return this.#faults.get(name);
    if (!this.#source) return "Open a picture first.";
    if (name === "invariant") return "";
    if (!this.#fit) return "This picture has not been fitted yet.";
    if (this.#fit.nothing_found && name !== "residual") {
      const object = objectOf(this.#tab.state.project.model);
      return `No ${object} was found in this picture, so its light cannot be changed. If there is one, draw a box around it.`;
    }
    const layer = name === "relit" ? "flat" : name;
    if (this.#fit.layers.includes(layer)) return "";
    return `${this.#fit.no_flat[0].toUpperCase()}${this.#fit.no_flat.slice(1)}.`;
  }

  async #load() {
    if (this.#why(this.#name)) return;
    if (this.#name === "relit" && !this.#images.has("relit")) this.#relight(0);
    await Promise.all((FETCHED[this.#name] ?? []).map((layer) => this.#fetch(layer)));
    if (this.#name !== "invariant") return;
    const source = this.#source;
    try {
      await this.invariant.load(source);
    } catch (error) {
      if (this.#source === source) this.#failed("invariant", error);
    }
  }

  /** The colour of the light is corrected from now on, or kept. */
  #rebalance() {
    for (const layer of ["flat", "relit"]) this.#images.delete(layer);
    this.#rough = null;
    this.#moved = this.#isRough = false;
    this.show(this.#name);
  }

  async #fetch(layer) {
    const [fit, { corrects }] = [this.#fit, this.balance];
    if (this.#images.has(layer)) return;
    this.#images.set(layer, null); // requested
    const query = layer === "flat" ? balanceQuery(corrects) : {};
    try {
      const { image, scale } = await api.layer(api.url("fits/{id}/layers/{layer}", { id: fit.id, layer, size: LAYER_SIZE, ...query }));
      if (this.#fit !== fit || (layer === "flat" && corrects !== this.balance.corrects)) return;
      this.#images.set(layer, image);
      this.#scales.set(layer, scale);
      this.#changed();
    } catch (error) {
      if (this.#fit === fit) this.#images.delete(layer);
      this.#failed(layer, error, fit);
    }
  }

  /** Show the error of a view. If the server no longer has the fit, it is fitted again. */
  #failed(name, error, fit = null) {
    if (fit && fit !== this.#fit) return;
    if (fit && error.status === 404) return this.#tab.forgotten(fit);
    this.#faults.set(name, error.message);
    return this.#changed();
  }

  /** Show the object under the lamps: what the browser can compute at once, and the exact picture when they rest. */
  #relight(wait = REST) {
    this.#dropRelit();
    if (this.#name !== "relit" || this.#why("relit")) return;
    const layers = FETCHED.relit.map((layer) => this.#images.get(layer));
    if (this.#images.has("relit") && layers.every(Boolean)) {
      this.#rough ??= new RoughLight(...layers, this.#scales.get("normals").box);
      this.#moved = true;
    }
    this.#awaited = setTimeout(() => this.#fetchRelit(this.#awaited), wait);
    this.viewer.redraw();
  }

  #dropRelit() {
    clearTimeout(this.#awaited);
    this.#awaited = null;
  }

  async #fetchRelit(turn) {
    const fit = this.#fit;
    try {
      const size = Math.min(Math.max(fit.width, fit.height), LAYER_SIZE);
      const query = { ...lightQuery(this.light, size), ...balanceQuery(this.balance.corrects) };
      const { image } = await api.layer(api.url("fits/{id}/relit", { id: fit.id, ...query }));
      if (turn !== this.#awaited) return;
      this.#images.get("relit")?.close();
      this.#images.set("relit", image);
      this.#moved = this.#isRough = false;
    } catch (error) {
      if (turn === this.#awaited) this.#failed("relit", error, fit);
    }
    if (turn === this.#awaited) this.#awaited = null;
    this.viewer.redraw();
  }

  /** The rough relit picture while lamps are moved, or else the exact one. */
  #relitImage() {
    if (this.#moved) {
      this.#rough.draw(numbersOf(this.light));
      this.#meter.tick();
      this.#isRough = true;
    }
    this.#moved = false;
    return this.#isRough ? this.#rough.canvas : this.#images.get("relit");
  }

  #layers() {
    const opacity = (label, of, testid) => slider({
      min: "0", max: "1", step: "0.05", value: "1", "aria-label": `Opacity: ${label}`, testid: `opacity-${testid}`,
      oninput: ({ target }) => this.#setOpacity(of(), Number(target.value)),
    });
    this.#slider = opacity("view", () => this.#name, "view");
    this.#layerName = h("span");
    this.#layerText = h("span.number");
    const overlays = this.overlays.buttons.map((each) => {
      const { name } = each.dataset;
      return [each, opacity(each.textContent, () => name, name)];
    });
    return h("div.fit-layers.small", h("label.fit-layer", this.#layerName, this.#slider, this.#layerText),
      this.balance.element, overlays);
  }

  #setOpacity(layer, opacity) {
    this.#opacity[layer] = opacity;
    this.#changed();
  }

  /** Make the view more transparent in steps, then opaque again. */
  fade() {
    const opacity = this.#opacity[this.#name];
    if (this.#name !== "picture") this.#setOpacity(this.#name, opacity > 0.25 ? opacity - 0.25 : 1);
  }

  /** Save the picture that is shown. A large one takes seconds. */
  async #save() {
    if (this.#saveButton.ariaBusy) return;
    this.#saveButton.ariaBusy = "true";
    await this.#tab.save(this.#name).finally(() => { this.#saveButton.ariaBusy = null; });
  }

  /** What is said over a picture that is not yet, or never will be, what the view says; "" if nothing. */
  #stateOf(image) {
    if (this.#why(this.#name)) return "";
    const { work = "" } = VIEWS.find(({ name }) => name === this.#name);
    if (!image && !this.#isEven) return work;
    return this.#isEven && !this.#split.has(this.#name) ? evenly(this.#name) : "";
  }

  /** What is said of further objects in the picture, as long as only one is fitted. */
  get #beside() {
    const more = (this.#fit?.n_found ?? 1) - 1;
    if (more < 1 || this.#others.length) return "";
    return `${several(more, `more ${objectOf(this.#tab.state.project.model)}`)} in the picture: press “Fit all” in the panel, or draw a box around one. `;
  }

  /** Whether the view has nothing to show, since the light is that of training. */
  get #isEven() { return Boolean(this.#name in EVEN && this.#scales.get(this.#name)?.even); }

  #changed() {
    // What cannot be shown of a fit is not chosen either: the picture is what one sees.
    const why = this.#why(this.#name);
    const view = VIEWS.find(({ name }) => name === (why && this.#fit ? "picture" : this.#name));
    const scale = why ? null : this.#scales.get(this.#name);
    const isEven = !why && this.#isEven;
    const isSplit = this.#split.has(this.#name) && !why;
    const lead = this.#name === "picture" && this.#fit && !this.#why("flat") ? RELIGHT : "";
    const hint = this.#tab.startHint || this.#beside + lead + ((isSplit && view.splitHint) || view.hint || "");
    for (const each of this.#choice.element.children)
      each.classList.toggle("unavailable", Boolean(this.#why(each.value)));
    this.#choice.value = view.name;
    this.#layerName.textContent = view.label;
    this.#slider.disabled = view.name === "picture" || isEven;
    this.#slider.value = String(this.#opacity[view.name]);
    this.#layerText.textContent = isEven ? "–" : `${Math.round(100 * this.#opacity[view.name])} %`;
    this.invariant.show(this.#name === "invariant" && !why);
    const isComing = !why && this.#images.get(this.#name) === null;
    this.#hint.textContent = this.#source ? why || (isEven && EVEN[this.#name]) || (isComing && view.work) || hint : "";
    this.#hint.classList.toggle("error-text", this.#faults.has(this.#name));
    this.#hint.hidden = this.invariant.isShown;
    this.splitter.disabled = !this.#source || Boolean(why);
    this.#saveButton.disabled = !view.saves || Boolean(why) || isEven;
    this.#saveButton.title = isEven ? EVEN[this.#name] : view.saves ? [view.saves, reducedText(this.#fit, this.#most)].filter(Boolean).join(". ") : NOTHING_TO_SAVE;
    this.#explain(scale?.limit && !isEven ? scale : null);
    this.light.show(this.#name === "relit", Boolean(why));
    this.light.note(this.#note());
    this.balance.show((this.#scales.get("flat") ?? this.#scales.get("balanced"))?.colour, this.#name === "balanced");
    press(this.splitter, isSplit);
    if (isSplit) this.#divider.label("Picture", isEven ? evenly(view.name) : view.after);
    this.viewer.redraw();
  }

  /** Show what is to be done at the picture, where the start of a fit is chosen. */
  showStart() { this.#changed(); }

  /** Most pixels of a picture without shading, or relit, that is saved. */
  get #most() { return this.#tab.state.project.limits.relit_pixels; }

  /** What is to be known before the relit picture is saved; "" if nothing. */
  #note() {
    const fit = this.#fit;
    if (!fit) return "";
    return [
      this.#others.length > 0 && `Only the light of ${fit.specimen.name} is changed: choose another one below.`,
      reducedText(fit, this.#most),
    ].filter(Boolean).join(" ");
  }

  #explain(/** @type {Partial<ColourScale> | null} */ scale) {
    this.#legend.hidden = !scale;
    if (!scale) return;
    const shading = this.#name === "shading";
    // Shading is a logarithm; show it as a multiple of the training light.
    const most = shading ? significant(Math.exp(scale.limit)) : significant(scale.limit, 2);
    const [low, high] = shading ? [`1/${most}`, `${most}×`] : [`−${most}`, `+${most}`];
    this.#legend.replaceChildren(
      h("span", scale.what), h("span.number", low),
      h("span.fit-ramp", { class: this.#name, role: "img", "aria-label": `Colours from ${low} to ${high}` }),
      h("span.number", high),
    );
  }

  #image() {
    if (this.#why(this.#name) || (this.#isEven && this.#name === "shading")) return null; // it would be a grey mask
    if (this.#name === "invariant") return this.invariant.image;
    return (this.#name === "relit" ? this.#relitImage() : this.#images.get(this.#name)) ?? null;
  }

  #draw(ctx, viewer) {
    const image = this.#image();
    const isSplit = this.#split.has(this.#name);
    this.#divider.show(isSplit && image !== null); // no label for what is not drawn
    this.#state.textContent = this.#stateOf(image);
    this.#state.hidden = !this.#state.textContent;
    if (image) {
      drawOver(ctx, viewer, image, {
        from: isSplit ? this.#divider.x : null, opacity: this.#opacity[this.#name],
        covered: this.#name === "invariant" ? this.invariant.covered : null,
        filter: LIKE_PICTURES.includes(this.#name) ? look.filter : "none",
      });
    }
    const [fit, opacity, { overlays }] = [this.#fit, this.#opacity, this];
    if (!viewer.tool?.hidesFit) drawSpecimens(ctx, viewer, fit, this.#others, overlays.shown, opacity);
    if (fit && !viewer.tool?.hidesFit) drawFit(ctx, viewer, fit, overlays.shown, { ...this.#iteration, opacity });
    viewer.tool?.draw(ctx, viewer);
    if (fit) this.light.place(viewer, fit.shape);
  }
}
