// The Compare tab: two methods on the same picture, side by side, with the same zoom.

import { api } from "./api.js";
import { drawFit, drawTruth, entries, modelNeeded, offer, Overlays } from "./fit-draw.js";
import { betterOf, comparison, factsOf, meanDistance, verdictOf } from "./fit-run.js";
import { SourceTab } from "./fit-source.js";
import { bounds } from "./points.js";
import { button, h, icon, isPlain, press, runKey } from "./ui.js";
import { Viewer } from "./viewer.js";

const FAMILIAR = ["rgb", "grey"]; // methods to compare the default with at first: the best known
const SMALL = 300; // css pixels of height below which the object fills a view

class Side {
  fit = null;
  _run = 0;

  /** @param {Tab} tab */
  constructor(tab, name, method) {
    const { methods } = tab.state.project;
    const options = methods.map(({ name: value, summary: title }) => h("option", { value, title }, value));
    this.select = h("select.text", {
      "aria-label": `Method on the ${name}`, testid: `compare-method-${name}`, onchange: () => {
        this.take(null);
        tab.run();
      },
    }, options);
    this.select.value = method;
    this.badge = h("span.badge", { hidden: true });
    this.facts = h("dl.fit-facts.compare-facts");
    this.message = h("p.small.muted.compare-message");
    this.container = h("div.fit-viewer");
    this.viewer = new Viewer(this.container, { label: `Picture, fitted with the method on the ${name}` });
    this.viewer.addLayer((ctx, viewer) => {
      if (tab.truth && tab.showTruth) drawTruth(ctx, viewer, tab.truth);
      if (this.fit) drawFit(ctx, viewer, this.fit, tab.overlays.shown);
    });
    this.element = h("section.compare-side", { "aria-label": `Method on the ${name}`, testid: `compare-${name}` },
      h("div.compare-head", this.select, this.badge), this.container,
      h("div.compare-result", { role: "status", "aria-live": "polite" }, this.facts, this.message));
  }

  get method() { return this.select.value; }
  show(source) { this.viewer.setPicture(source?.image ?? null, source?.width ?? 0, source?.height ?? 0, source?.tiles ?? null); }

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
  async run(fits, source) {
    const run = (this._run += 1);
    try {
      const fit = fits.recall(source, this.method) ?? (await fits.run(source, this.method));
      if (run === this._run) this.take(fit);
    } catch (error) {
      if (run !== this._run) return false;
      this.take(null);
      this.say(error.message, true);
    }
    return run === this._run;
  }

  reset() {
    this._run += 1;
    this.take(null);
  }
}

export class Tab extends SourceTab {
  shortcuts = [
    { keys: "Enter F", what: "Fit with both methods" },
    { keys: "X", what: "Swap the sides" },
    { keys: "C L M E T", what: "Show contours, points, mesh, ellipses, ground truth" },
  ];
  truth = null;
  showTruth = true;

  /** @param {HTMLElement} root; @param {App} app */
  constructor(root, app) {
    super(app);
    const { methods, default_method: first } = this.state.project;
    const known = this.state.project.model?.methods ?? methods.map(({ name }) => name);
    const other = [...FAMILIAR, first].find((name) => known.includes(name)) ?? first;
    this.sides = [new Side(this, "left", first), new Side(this, "right", other)];
    this.left = this.sides[0];
    this.right = this.sides[1];
    this._build(root);
    const [left, right] = this.sides.map((side) => side.viewer);
    for (const [one, other] of [[left, right], [right, left]]) // keep zoom and pan of both sides equal
      one.addEventListener("view", () => one.width === other.width && other.setView(one.view));
    this.sources.addEventListener("ready", () => this.sides.forEach((side) => side.show(this.sources.current)));
    this.state.addEventListener("landmarks", (/** @type {any} */ { detail }) => {
      if (this.sources.current?.name !== detail.name) return;
      this._truth();
      if (this.visible) this.run();
    });
    this.follow();
    window.liaamStudio.compare = { left: this.left, right: this.right };
  }

  get _works() { return Boolean(this.sources.current && this.state.project.model); }

  key(event) {
    const keys = { enter: () => this.run(), f: () => this.run(), x: () => this.swap(), t: () => this._toggleTruth() };
    return isPlain(event) && (runKey(event, keys) || this.overlays.key(event) || this.right.viewer.key(event));
  }

  async run() {
    if (!this._works) return;
    this._say("Fitting…");
    const newest = await Promise.all(this.sides.map((side) => side.run(this.app.fits, this.sources.current)));
    if (newest.every(Boolean)) this._verdict();
    this._enlarge();
  }

  /** In a small view, show the object instead of the whole picture, unless the user has zoomed. */
  _enlarge() {
    const [{ viewer }, shape] = [this.left, this.sides.find(({ fit }) => fit?.ok)?.fit.shape];
    if (!shape || viewer.container.clientHeight > SMALL || !viewer.showsWhole) return;
    const box = bounds(shape);
    viewer.fitTo(box, 0.07 * viewer.container.clientHeight);
  }

  swap() {
    const [a, b] = this.sides;
    [a.select.value, b.select.value] = [b.method, a.method];
    for (const side of this.sides) side.reset();
    this.run();
  }

  _another(source) {
    this.truth = null;
    for (const side of this.sides) {
      side.reset();
      side.show(source);
      if (source) side.viewer.fit();
    }
  }

  _showFit() {
    this._truth();
    if (!this.left.fit && !this.right.fit) this.run();
  }

  _anotherModel() {
    for (const side of this.sides) side.reset();
    if (this.visible) this.run();
  }

  _refused(error) { this._say(error.message, { bad: true }); }

  async _truth() {
    const source = this.sources.current;
    const marks = source?.ofFolder ? await api.get(source.address("landmarks")).catch(() => null) : null;
    if (this.sources.current !== source) return;
    this.truth = marks?.source === "file" && marks.points.some(Boolean) ? marks.points : null;
    this._truthButton.disabled = !this.truth;
    this._redraw();
  }

  _verdict() {
    const [a, b] = this.sides.map((side) => side.fit);
    if (a && b) this._say(comparison(a, b, meanDistance(a.shape, b.shape)), { better: betterOf(a, b) });
    else this._say("");
  }

  _say(text, { bad = false, better = null } = {}) {
    this._verdictText.textContent = text;
    this._verdictText.classList.toggle("error-text", bad);
    for (const { element, fit } of this.sides) element.classList.toggle("nearer", better !== null && fit === better);
  }

  _build(root) {
    this.overlays = new Overlays(["contours", "landmarks"], () => this._redraw(), "compare");
    const tool = (label, shortcut, name, onclick, more) =>
      button(label, { small: true, shortcut, testid: `compare-${name}`, onclick, ...more });
    this._truthButton = tool("Ground truth", "T", "truth", () => this._toggleTruth(), {
      pressed: this.showTruth, disabled: true, title: "Show the known landmarks of the picture as crosses",
    });
    this._runButton = tool("Fit both", "Enter", "run", () => this.run(), { icon: "target", kind: "primary" });
    const swap = tool("Swap", "X", "swap", () => this.swap(), { icon: "swap" });
    this._verdictText = h("p.compare-verdict.grow", { role: "status", testid: "compare-verdict" });
    this._name = h("span.fit-source-name");
    this._pair = h("div.compare-pair", this.left.element, this.right.element);
    this._empty = h("div.empty.big");
    root.append(h("div.workspace.compare-tab",
      h("div.toolbar", { role: "toolbar", "aria-label": "Compare" }, this._runButton, swap, h("span.rule"),
        this.overlays.buttons, this._truthButton, h("span.grow"), this._name),
      this._pair, this._empty, h("div.compare-foot", this._verdictText)));
  }

  _redraw() { for (const { viewer } of this.sides) viewer.redraw(); }

  _toggleTruth() {
    this.showTruth = !this.showTruth;
    press(this._truthButton, this.showTruth);
    this._redraw();
  }

  _emptiness() {
    const works = this._works;
    this.sides.forEach((side) => offer(side.select, this.state.project.model));
    this._pair.hidden = this._runButton.disabled = !works;
    this._empty.hidden = works;
    this._name.textContent = this._name.title = this.sources.current?.name ?? "";
    if (works) return;
    const select = h("p", "Select a picture in the list, or drop one here.");
    const remedy = this.state.project.model ? [select] : modelNeeded(this.app);
    this._empty.replaceChildren(icon("compare", 56), h("h2", "Two methods, side by side"), ...remedy);
  }
}
