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
  /** @type {Fit | null} */
  #fit = null;
  #run = 0; // number of the newest run, to drop answers of older ones
  // Elements.
  #badge; #facts; #message; #select;

  /** drawn(): names of the overlays that are drawn; truth(): points to mark, or null; onmethod(): another was chosen.
   *  @param {Project} project; @param {string} name; @param {string} method; @param {any} handlers */
  constructor({ methods }, name, method, { drawn, truth, onmethod }) {
    const options = methods.map(({ name: value, summary: title }) => h("option", { value, title }, value));
    this.#select = h("select.text", {
      "aria-label": `Method on the ${name}`, testid: `compare-method-${name}`, onchange: () => {
        this.#take(null);
        onmethod();
      },
    }, options);
    this.#select.value = method;
    this.#badge = h("span.badge", { hidden: true });
    this.#facts = h("dl.fit-facts.compare-facts");
    this.#message = h("p.small.muted.compare-message");
    const container = h("div.fit-viewer");
    this.viewer = new Viewer(container, { label: `Picture, fitted with the method on the ${name}` });
    this.viewer.addLayer((ctx, viewer) => {
      if (truth()) drawTruth(ctx, viewer, truth());
      if (this.#fit) drawFit(ctx, viewer, this.#fit, drawn());
    });
    this.element = h("section.compare-side", { "aria-label": `Method on the ${name}`, testid: `compare-${name}` },
      h("div.compare-head", this.#select, this.#badge), container,
      h("div.compare-result", { role: "status", "aria-live": "polite" }, this.#facts, this.#message));
  }

  get fit() { return this.#fit; }
  get method() { return this.#select.value; }

  /** Choose a method; its fit is still to be made. */
  choose(method) {
    this.#select.value = method;
    this.reset();
  }

  /** Offer the methods that the model was trained for. */
  offer(model) { offer(this.#select, model); }

  /** Show that this side is the better one, or not. */
  praise(on) { this.element.classList.toggle("nearer", on); }

  show(source) { this.viewer.setPicture(source?.image ?? null, source?.width ?? 0, source?.height ?? 0, source?.tiles ?? null); }

  #take(/** @type {Fit | null} */ fit) {
    this.#fit = fit;
    this.#badge.hidden = !fit;
    this.viewer.redraw();
    this.#say(fit?.message ?? "");
    if (!fit) return;
    const { kind, title } = verdictOf(fit);
    this.#badge.className = `badge ${kind}`;
    this.#badge.textContent = title;
    this.#facts.replaceChildren(...entries(factsOf(fit)));
  }

  #say(text, bad = false) {
    this.#facts.replaceChildren();
    this.#message.className = `small ${bad ? "error-text" : "muted"} compare-message`;
    this.#message.textContent = this.#message.title = text;
  }

  /** Fit; return whether this is still the newest run of the side. */
  async run(fits, source) {
    const run = (this.#run += 1);
    try {
      const fit = fits.recall(source, this.method) ?? (await fits.run(source, this.method));
      if (run === this.#run) this.#take(fit);
    } catch (error) {
      if (run !== this.#run) return false;
      this.#take(null);
      this.#say(error.message, true);
    }
    return run === this.#run;
  }

  reset() {
    this.#run += 1;
    this.#take(null);
  }
}

export class Tab extends SourceTab {
  shortcuts = [
    { keys: "Enter F", what: "Fit with both methods" },
    { keys: "X", what: "Swap the sides" },
    { keys: "C L M E T", what: "Show contours, points, mesh, ellipses, ground truth" },
  ];
  /** @type {Point[] | null} */
  #truth = null; // points of the picture, or null
  #showsTruth = true;
  #left;
  #right;
  // Elements.
  #empty; #name; #pair; #runButton; #truthButton; #verdictText;

  /** @param {HTMLElement} root; @param {App} app */
  constructor(root, app) {
    super(app);
    const { methods, default_method: first } = this.state.project;
    const known = this.state.project.model?.methods ?? methods.map(({ name }) => name);
    const other = [...FAMILIAR, first].find((name) => known.includes(name)) ?? first;
    const handlers = {
      drawn: () => this.overlays.shown, truth: () => (this.#showsTruth ? this.#truth : null), onmethod: () => this.#run(),
    };
    this.#left = new Side(this.state.project, "left", first, handlers);
    this.#right = new Side(this.state.project, "right", other, handlers);
    this.#build(root);
    const [left, right] = this.#sides.map((side) => side.viewer);
    for (const [one, other] of [[left, right], [right, left]]) // keep zoom and pan of both sides equal
      one.addEventListener("view", () => one.width === other.width && other.setView(one.view));
    this.sources.addEventListener("ready", () => this.#sides.forEach((side) => side.show(this.sources.current)));
    this.state.addEventListener("landmarks", (/** @type {any} */ { detail }) => {
      const { name } = /** @type {LandmarksChanged} */ (detail);
      if (this.sources.current?.name !== name) return;
      this.#fetchTruth();
      if (this.visible) this.#run();
    });
    this.follow();
    window.liaamStudio.compare = { left: this.#left, right: this.#right };
  }

  get #sides() { return [this.#left, this.#right]; }
  get #works() { return Boolean(this.sources.current && this.state.project.model); }

  key(event) {
    const keys = { enter: () => this.#run(), f: () => this.#run(), x: () => this.#swap(), t: () => this.#toggleTruth() };
    return isPlain(event) && (runKey(event, keys) || this.overlays.key(event) || this.#right.viewer.key(event));
  }

  async #run() {
    if (!this.#works) return;
    this.#say("Fitting…");
    const newest = await Promise.all(this.#sides.map((side) => side.run(this.app.fits, this.sources.current)));
    if (newest.every(Boolean)) this.#verdict();
    this.#enlarge();
  }

  /** In a small view, show the object instead of the whole picture, unless the user has zoomed. */
  #enlarge() {
    const [{ viewer }, shape] = [this.#left, this.#sides.find(({ fit }) => fit?.ok)?.fit.shape];
    if (!shape || viewer.container.clientHeight > SMALL || !viewer.showsWhole) return;
    const box = bounds(shape);
    viewer.fitTo(box, 0.07 * viewer.container.clientHeight);
  }

  #swap() {
    const methods = this.#sides.map(({ method }) => method).reverse();
    this.#sides.forEach((side, i) => side.choose(methods[i]));
    this.#run();
  }

  useSource(source) {
    this.#truth = null;
    for (const side of this.#sides) {
      side.reset();
      side.show(source);
      if (source) side.viewer.fit();
    }
  }

  showFit() {
    this.#fetchTruth();
    if (!this.#left.fit && !this.#right.fit) this.#run();
  }

  useModel() {
    for (const side of this.#sides) side.reset();
    if (this.visible) this.#run();
  }

  refuse(error) { this.#say(error.message, { bad: true }); }

  async #fetchTruth() {
    const source = this.sources.current;
    const read = (name) => api.get(api.url("pictures/{name}/landmarks", { name })).catch(() => null);
    const marks = source?.ofFolder ? await read(source.name) : null;
    if (this.sources.current !== source) return;
    this.#truth = marks?.source === "file" && marks.points.some(Boolean) ? marks.points : null;
    this.#truthButton.disabled = !this.#truth;
    this.#redraw();
  }

  #verdict() {
    const [a, b] = this.#sides.map((side) => side.fit);
    if (a && b) this.#say(comparison(a, b, meanDistance(a.shape, b.shape)), { better: betterOf(a, b) });
    else this.#say("");
  }

  #say(text, { bad = false, better = null } = {}) {
    this.#verdictText.textContent = text;
    this.#verdictText.classList.toggle("error-text", bad);
    for (const side of this.#sides) side.praise(better !== null && side.fit === better);
  }

  #build(root) {
    this.overlays = new Overlays(["contours", "landmarks"], () => this.#redraw(), "compare");
    const tool = (label, shortcut, name, onclick, more) =>
      button(label, { small: true, shortcut, testid: `compare-${name}`, onclick, ...more });
    this.#truthButton = tool("Ground truth", "T", "truth", () => this.#toggleTruth(), {
      pressed: this.#showsTruth, disabled: true, title: "Show the known landmarks of the picture as crosses",
    });
    this.#runButton = tool("Fit both", "Enter", "run", () => this.#run(), { icon: "target", kind: "primary" });
    const swap = tool("Swap", "X", "swap", () => this.#swap(), { icon: "swap" });
    this.#verdictText = h("p.compare-verdict.grow", { role: "status", testid: "compare-verdict" });
    this.#name = h("span.fit-source-name");
    this.#pair = h("div.compare-pair", this.#left.element, this.#right.element);
    this.#empty = h("div.empty.big");
    root.append(h("div.workspace.compare-tab",
      h("div.toolbar", { role: "toolbar", "aria-label": "Compare" }, this.#runButton, swap, h("span.rule"),
        this.overlays.buttons, this.#truthButton, h("span.grow"), this.#name),
      this.#pair, this.#empty, h("div.compare-foot", this.#verdictText)));
  }

  #redraw() { for (const { viewer } of this.#sides) viewer.redraw(); }

  #toggleTruth() {
    this.#showsTruth = !this.#showsTruth;
    press(this.#truthButton, this.#showsTruth);
    this.#redraw();
  }

  offer() {
    const works = this.#works;
    for (const side of this.#sides) side.offer(this.state.project.model);
    this.#pair.hidden = this.#runButton.disabled = !works;
    this.#empty.hidden = works;
    this.#name.textContent = this.#name.title = this.sources.current?.name ?? "";
    if (works) return;
    const select = h("p", "Select a picture in the list, or drop one here.");
    const remedy = this.state.project.model ? [select] : modelNeeded(this.app);
    this.#empty.replaceChildren(icon("compare", 56), h("h2", "Two methods, side by side"), ...remedy);
  }
}
