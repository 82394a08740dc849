// The Compare tab: two methods on the same picture, side by side, with the same zoom.

import { api } from "./api.js";
import { drawFit, drawTruth, entries, modelNeeded, overlayButtons, OVERLAYS, pressOverlays } from "./fit-draw.js";
import { meanDistance } from "./fit-geometry.js";
import { betterOf, comparison, factsOf, fitsOf, verdictOf } from "./fit-run.js";
import { sourcesOf } from "./fit-source.js";
import { button, h, icon } from "./ui.js";
import { Viewer } from "./viewer.js";

/** Methods to compare the default with at first: the best known. */
const FAMILIAR = ["rgb", "grey"];

const SHORTCUTS = [
  { keys: "Enter F", what: "Fit with both methods" },
  { keys: "X", what: "Swap the sides" },
  { keys: "C L M E T", what: "Show contours, points, mesh, ellipses, ground truth" },
];

export function mount(root, app) {
  const tab = new CompareTab(root, app);
  return { show: () => tab.open(), hide: () => tab.watch(false), shortcuts: SHORTCUTS, key: (event) => tab.key(event) };
}

/** One side: its method, its viewer and its result. */
class Side {
  constructor(name, { onmethod, draw }) {
    this.fit = null;
    this._run = 0;
    this.select = h("select.text", {
      "aria-label": `Method on the ${name}`, testid: `compare-method-${name}`, onchange: () => onmethod(this),
    });
    this.badge = h("span.badge", { hidden: true });
    this.facts = h("dl.fit-facts.compare-facts");
    this.message = h("p.small.muted.compare-message");
    this.container = h("div.fit-viewer");
    this.viewer = new Viewer(this.container, { label: `Picture, fitted with the method on the ${name}` });
    this.viewer.addLayer((ctx, viewer) => draw(ctx, viewer, this));
    this.element = h("section.compare-side", { "aria-label": `Method on the ${name}`, testid: `compare-${name}` },
      h("div.compare-head", this.select, this.badge), this.container,
      h("div.compare-result", { role: "status", "aria-live": "polite" }, this.facts, this.message));
  }

  get method() { return this.select.value; }

  methods(methods, chosen) {
    this.select.replaceChildren(
      ...methods.map(({ name, summary }) => h("option", { value: name, title: summary }, name)));
    this.select.value = chosen;
  }

  show(source) {
    this.viewer.setPicture(source?.image ?? null, source?.width ?? 0, source?.height ?? 0);
  }

  take(fit) {
    this.fit = fit;
    this.badge.hidden = !fit;
    this.viewer.redraw();
    this.say(fit?.message ?? "");
    if (!fit) return;
    const { kind, title } = verdictOf(fit);
    this.badge.className = `badge ${kind}`;
    this.badge.textContent = title;
    this.facts.replaceChildren(...entries(factsOf(fit)));
  }

  say(text, bad = false) {
    this.facts.replaceChildren();
    this.message.className = `small ${bad ? "error-text" : "muted"} compare-message`;
    this.message.textContent = this.message.title = text;
  }

  /** Fit; return whether this is still the newest run of the side. */
  async run(store, source) {
    const run = (this._run += 1);
    try {
      const fit = store.recall(source, this.method) ?? (await store.run(source, this.method));
      if (run === this._run) this.take(fit);
    } catch (error) {
      if (run !== this._run) return false;
      this.take(null);
      this.say(error.message, true);
    }
    return run === this._run;
  }

  /** Drop a running fit and the result. */
  reset() {
    this._run += 1;
    this.take(null);
  }
}

class CompareTab {
  /** @param {HTMLElement} root; @param {App} app */
  constructor(root, app) {
    this.app = app;
    this.state = app.state;
    this.sources = sourcesOf(app);
    this.store = fitsOf(app);
    this.shown = new Set(["contours", "landmarks"]);
    this.visible = false;
    this.truth = null;
    this.showTruth = true;
    this.sides = ["left", "right"].map((name) => new Side(name, {
      onmethod: (side) => this._method(side), draw: (ctx, viewer, side) => this._draw(ctx, viewer, side),
    }));
    this.left = this.sides[0];
    this.right = this.sides[1];
    this._build(root);
    this._together();
    this.sources.addEventListener("change", () => this._source());
    this.sources.addEventListener("ready", () => this.sides.forEach((side) => side.show(this.sources.current)));
    this.sources.addEventListener("failed", ({ detail }) => {
      if (this.visible) this._say(detail.error.message, true);
    });
    this.state.addEventListener("project", () => this._project());
    this.state.addEventListener("landmarks", (/** @type {any} */ { detail }) => {
      if (this.sources.current?.name !== detail.name) return;
      this._truth();
      if (this.visible) this.run();
    });
    this._project();
    window.liaamStudio.compare = { left: this.left, right: this.right };
  }

  open() {
    this.watch(true);
    this._source();
  }

  /** The tab is opened (true) or left (false). */
  watch(open) {
    if (open !== this.visible) this.sources.watch(open);
    this.visible = open;
  }

  key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return false;
    const onControl = event.target instanceof HTMLElement && event.target.matches("button, a");
    if (event.key === "Enter" && onControl) return false;
    const overlay = OVERLAYS.find(({ key }) => key.toLowerCase() === event.key.toLowerCase());
    const actions = {
      enter: () => this.run(), f: () => this.run(), x: () => this.swap(), t: () => this._toggleTruth(),
    };
    if (overlay) this._toggle(overlay.name);
    else if (actions[event.key.toLowerCase()]) actions[event.key.toLowerCase()]();
    else return this.right.viewer.key(event);
    return true;
  }

  /** Fit with both methods at once. */
  async run() {
    const source = this.sources.current;
    if (!source || !this.state.project?.model) return;
    this._say("Fitting…");
    const newest = await Promise.all(this.sides.map((side) => side.run(this.store, source)));
    if (newest.every(Boolean)) this._verdict();
  }

  swap() {
    const [a, b] = [this.left.method, this.right.method];
    const fits = [this.left.fit, this.right.fit];
    this.sides.forEach((side) => side.reset());
    this.left.select.value = b;
    this.right.select.value = a;
    this.left.take(fits[1]);
    this.right.take(fits[0]);
    this._verdict();
  }

  async _method(side) {
    const source = this.sources.current;
    side.take(null);
    if (!source || !this.state.project?.model) return;
    if (await side.run(this.store, source)) this._verdict();
  }

  _source() {
    const source = this.sources.current;
    if (this._seen !== source) {
      this._seen = source;
      this.truth = null;
      for (const side of this.sides) {
        side.reset();
        side.show(source);
        if (source) side.viewer.fit();
      }
    }
    this._emptiness();
    if (!source || !this.visible) return;
    this._truth();
    if (!this.left.fit && !this.right.fit) this.run();
  }

  async _truth() {
    const source = this.sources.current;
    const marks = source?.ofFolder ? await api.get(source.address("landmarks")).catch(() => null) : null;
    if (this.sources.current !== source) return;
    this.truth = marks?.source === "file" && marks.points.some(Boolean) ? marks.points : null;
    this._truthButton.disabled = !this.truth;
    this.sides.forEach((side) => side.viewer.redraw());
  }

  _project() {
    const { methods = [], default_method: first, model } = this.state.project ?? {};
    const names = methods.map(({ name }) => name);
    if (this._names !== names.join()) {
      this._names = names.join();
      this.left.methods(methods, first ?? names[0]);
      const other = FAMILIAR.find((name) => names.includes(name) && name !== first);
      this.right.methods(methods, other ?? names[1] ?? names[0]);
    }
    const trained = model?.trained ?? null;
    const another = this._trained !== undefined && this._trained !== trained;
    this._trained = trained;
    this._overlays.get("contours").disabled = !model?.contours?.length;
    pressOverlays(this._overlays, this.shown);
    this._emptiness();
    if (!another) return;
    this.sides.forEach((side) => side.reset());
    if (this.visible) this.run();
  }

  _verdict() {
    const [a, b] = this.sides.map((side) => side.fit);
    this._say(a && b ? comparison(a, b, meanDistance(a.shape, b.shape)) : "");
    const better = a && b ? betterOf(a, b) : null;
    for (const side of this.sides) side.element.classList.toggle("nearer", better !== null && side.fit === better);
  }

  _say(text, bad = false) {
    this._verdictText.textContent = text;
    this._verdictText.classList.toggle("error-text", bad);
    if (bad || text === "Fitting…") for (const side of this.sides) side.element.classList.remove("nearer");
  }

  // The page.

  _build(root) {
    this._overlays = overlayButtons(this.shown, (name) => this._toggle(name));
    this._truthButton = button("Ground truth", {
      small: true, shortcut: "T", pressed: this.showTruth, disabled: true, testid: "compare-truth",
      title: "Show the known landmarks of the picture as crosses", onclick: () => this._toggleTruth(),
    });
    this._runButton = button("Fit both", {
      icon: "target", kind: "primary", small: true, shortcut: "Enter", testid: "compare-run", onclick: () => this.run(),
    });
    const swap = button("Swap", {
      icon: "swap", small: true, shortcut: "X", testid: "compare-swap", onclick: () => this.swap(),
    });
    this._verdictText = h("p.compare-verdict.grow", { role: "status", "aria-live": "polite", testid: "compare-verdict" });
    this._name = h("span.fit-source-name");
    const toolbar = h("div.toolbar", { role: "toolbar", "aria-label": "Compare" },
      this._runButton, swap, h("span.rule"), [...this._overlays.values()], this._truthButton, h("span.grow"), this._name);
    this._pair = h("div.compare-pair", this.left.element, this.right.element);
    this._empty = h("div.empty.big");
    const foot = h("div.compare-foot", this._verdictText);
    root.append(h("div.workspace.compare-tab", toolbar, this._pair, this._empty, foot));
  }

  /** Keep zoom and pan of both sides equal. */
  _together() {
    const [left, right] = this.sides.map((side) => side.viewer);
    for (const [one, other] of [[left, right], [right, left]]) {
      one.addEventListener("view", () => one.width === other.width && other.setView(one.view, true));
    }
  }

  _toggle(name) {
    if (!this.shown.delete(name)) this.shown.add(name);
    pressOverlays(this._overlays, this.shown);
    this.sides.forEach((side) => side.viewer.redraw());
  }

  _toggleTruth() {
    this.showTruth = !this.showTruth;
    this._truthButton.setAttribute("aria-pressed", String(this.showTruth));
    this.sides.forEach((side) => side.viewer.redraw());
  }

  _draw(ctx, viewer, side) {
    if (this.truth && this.showTruth) drawTruth(ctx, viewer, this.truth);
    if (side.fit) drawFit(ctx, viewer, side.fit, this.shown);
  }

  _emptiness() {
    const source = this.sources.current;
    const model = this.state.project?.model;
    const works = Boolean(source && model);
    this._pair.hidden = !works;
    this._empty.hidden = works;
    this._runButton.disabled = !works;
    this._name.textContent = this._name.title = source?.name ?? "";
    if (works) return;
    const remedy = model ? [h("p", "Select a picture in the list, or drop one here.")] : modelNeeded(this.app);
    this._empty.replaceChildren(icon("compare", 56), h("h2", "Two methods, side by side"), ...remedy);
  }
}
