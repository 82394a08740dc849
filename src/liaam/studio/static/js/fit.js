// The Fit tab: fit the model to a picture and inspect the result.

import { mismatch } from "./assist.js";
import { expert } from "./expert.js";
import { Iterations } from "./fit-iterations.js";
import { AUTO } from "./fit-run.js";
import { ExportMenu, guestPanel, ResultPanel, SetupPanel } from "./fit-setup.js";
import { SourceTab } from "./fit-source.js";
import { BoxTool, MeanTool } from "./fit-start.js";
import { FitView } from "./fit-view.js";
import { afterPaint, button, fileField, h, icon, isPlain, runKey } from "./ui.js";

/** @type {Fits} */
const NONE = { fits: [], faults: [] };

export class Tab extends SourceTab {
  shortcuts = [
    { keys: "Enter F", what: "Fit" },
    { keys: "V Shift+V", what: "Next, previous view" },
    { keys: "S", what: "Before and after" },
    { keys: "C L M E", what: "Show contours, points, mesh, ellipses" },
    { keys: "O", what: "Make the view more transparent" },
    { keys: ", .", what: "Resize the start" },
    { keys: "Arrows", what: "Move the lamp, or the start" },
    { keys: ", . P", what: "Previous, next iteration; play the iterations", expert: true },
    { keys: "Arrows", what: "Change θ of the invariant image (Shift: 0.1°)", expert: true },
  ];
  #method;
  #start = "auto";
  #side = AUTO; // of the object in the picture, if the model knows two
  /** @type {Fit | null} */
  #fit = null;
  #lastDropMs = null; // from the newest drop to the first frame painted with its fit
  /** @type {Fit["objects"]} */
  #objects = []; // boxes of several in the picture, that of the fit first
  /** @type {Fits} */
  #specimens = NONE; // all of the picture that were fitted together
  #run = 0; // number of the newest run, to drop answers of older ones
  // Parts.
  #box; #exports; #guest; #iterations; #mean; #result; #setup; #view;
  // Elements.
  #empty; #file; #layers; #steps; #words;

  /** @param {HTMLElement} root; @param {App} app */
  constructor(root, app) {
    super(app);
    this.#method = this.state.project.default_method;
    this.#view = new FitView(this);
    this.overlays = this.#view.overlays;
    this.#box = new BoxTool(this.#view.viewer, () => this.run());
    this.#mean = new MeanTool(this.#view.viewer);
    this.#iterations = new Iterations((index, last) =>
      this.#view.setIteration(last ? null : { shape: this.#fit.iterations[index].shape, final: false }));
    this.#exports = new ExportMenu(this);
    this.#guest = guestPanel(app);
    this.#result = new ResultPanel(this);
    this.#setup = new SetupPanel(this);
    this.#build(root);
    this.sources.addEventListener("taken", (/** @type {any} */ { detail }) => {
      this.#lastDropMs = null;
      if (this.visible && this.state.project.model) detail.source.fitWith(this.#method);
    });
    this.sources.addEventListener("ready", () => this.#view.setSource(this.sources.current));
    this.state.addEventListener("online", (/** @type {any} */ { detail }) => detail && this.#online());
    this.state.addEventListener("training", (/** @type {any} */ { detail }) => {
      if (detail.state === "done") this.state.refresh().catch(() => {});
    });
    this.follow();
    expert.addEventListener("change", () => this.#expert());
    this.#expose();
  }

  get method() { return this.#method; }
  get fit() { return this.#fit; }
  /** All specimens of the picture that were fitted together: {fits, faults}. */
  get specimens() { return this.#specimens; }

  /** @param {{view?: string}} options view: the view to show, if another than now */
  show({ view } = {}) {
    if (view) this.#view.show(view);
    super.show();
  }

  hide() {
    super.hide();
    this.#iterations.pause();
    this.#exports.close();
  }

  key(event) {
    return isPlain(event) && (this.startTool?.key(event) || runKey(event, {
      enter: () => this.run(), f: () => this.run(), v: () => this.#view.cycle(event.shiftKey ? -1 : 1),
      s: () => this.#view.toggleSplit(), o: () => this.#view.fade(),
    }) || (expert.on && runKey(event, {
      p: () => this.#iterations.toggle(), ",": () => this.#iterations.step(-1), ".": () => this.#iterations.step(1),
    })) || this.#view.key(event));
  }

  /** Fit the shown picture from a start, or the chosen one. Resolves once the fit is painted. @param {Start | null} given */
  async run(given = null) {
    const source = this.sources.current;
    if (!source || !this.state.project.model) return null;
    const tool = this.startTool;
    const start = given ?? tool?.start ?? null;
    if (tool && !start) {
      this.#result.showMessage("info", "Draw a box around the object first.");
      return null;
    }
    const run = (this.#run += 1);
    this.#busy(true);
    try {
      const fit = await this.app.fits.run(source, this.#method, start, this.#side);
      if (run !== this.#run || this.sources.current !== source) return null;
      this.#take(fit);
      await afterPaint();
      return fit;
    } catch (error) {
      if (run === this.#run) this.refuse(error); // the earlier fit stays
      return null;
    } finally {
      if (run === this.#run) this.#busy(false);
    }
  }

  /** Fit all specimens of the shown picture, and select the first. */
  async runAll() {
    const source = this.sources.current;
    const run = (this.#run += 1);
    this.#busy(true);
    try {
      const all = await this.app.fits.runAll(source, this.#method, this.#side);
      if (run !== this.#run || this.sources.current !== source) return;
      this.#specimens = all;
      this.choose(all.fits[0]);
    } catch (error) {
      if (run === this.#run) this.refuse(error);
    } finally {
      if (run === this.#run) this.#busy(false);
    }
  }

  /** Select one of the specimens that were fitted together. */
  choose(/** @type {Fit} */ fit) {
    this.app.fits.choose(this.sources.current, this.#method, this.#side, fit);
    this.#take(fit);
    this.#view.viewer.redraw();
  }

  /** What is to be done at the picture before it is fitted; "" if nothing. */
  get startHint() { return { box: "Draw a box around the object.", mean: "Drag the shape onto the object." }[this.#start] ?? ""; }

  get startTool() { return { box: this.#box, mean: this.#mean }[this.#start] ?? null; }

  #take(/** @type {Fit | null} */ fit) {
    this.#fit = fit;
    if (!this.#specimens.fits.includes(fit)) this.#specimens = NONE;
    if (fit?.objects?.length) this.#objects = [...fit.objects];
    this.#view.setFit(fit, this.#specimens.fits.filter((other) => other !== fit));
    this.#view.invariant.mark({ model: this.state.project.model?.theta_deg, fit: fit?.theta_deg });
    this.#iterations.show(fit?.iterations ?? []);
    this.#exports.show();
    this.#showResult();
    this.#mean.showFit(Boolean(fit));
  }

  forgotten(/** @type {Fit} */ fit) {
    this.app.fits.forget(fit);
    this.app.toast("The server no longer has this fit, so the picture is fitted again.");
    if (fit.specimen) this.runAll();
    else this.run();
  }

  /** The server is reachable again: fetch what has failed meanwhile. */
  #online() {
    const { current } = this.sources;
    if (this.visible && current && !this.#fit) this.showFit(current);
    this.#view.retry();
  }

  useSource(source) {
    this.#objects = [];
    this.#run += 1;
    this.#busy(false);
    this.#view.setSource(source);
    this.#box.clear();
    this.#mean.clear();
    this.#take(null);
    this.#side = AUTO;
    this.#setup.showSide(AUTO);
    if (source && !source.ofFolder) this.setStart("auto");
  }

  async showFit(source) {
    if (this.#fit) return;
    const { fits } = this.app;
    const known = fits.recall(source, this.#method, this.#side);
    this.#specimens = fits.recallAll(source, this.#method, this.#side) ?? NONE;
    if (known) this.#take(known);
    else if (!this.state.project.model || this.#start !== "auto") this.#showResult();
    else if ((await this.run()) && !source.ofFolder) this.#lastDropMs ??= performance.now() - source.started;
  }

  useModel(/** @type {Model | null} */ model) {
    this.#run += 1;
    this.#side = AUTO;
    this.#setup.offerSides(model);
    this.#mean.use(model);
    this.#take(null);
    this.followSource();
  }

  /** Fit the next of the objects that a search has found in the picture. */
  next() {
    this.#objects.push(this.#objects.shift());
    this.run({ box: this.#objects[0] });
  }

  #build(root) {
    this.#file = fileField((file) => this.app.adding.take([{ file, path: file.name }]), {
      accept: "image/*,.tif,.tiff,.ppm,.pgm,.bmp,.liaam", testid: "fit-file", "aria-label": "Open a picture to fit",
    });
    const toolbar = h("div.toolbar", { role: "toolbar", "aria-label": "View" },
      this.#view.chooser, this.#view.splitter, h("span.grow"), this.#view.saveButton, this.#exports.element);
    this.#words = h("p");
    this.#empty = h("div.empty.big.fit-empty", icon("image", 56), h("h2", "A picture to fit"), this.#words,
      button("Open a picture…", { icon: "upload", kind: "primary", onclick: () => this.chooseFile() }));
    const stage = h("div.fit-stage", this.#view.container, this.#empty);
    this.#layers = h("section.panel", { "aria-label": "Layers and their opacity" }, this.#view.layers);
    this.#steps = h("section.panel", { "aria-label": "Iterations" }, this.#iterations.element);
    // What is always there comes first, so that nothing moves as views change, and messages come and go.
    const panels = [this.#guest.element, this.#setup.element, this.#layers, this.#view.light.element, this.#setup.notes,
      this.#result.element, this.#steps];
    root.append(h("div.fit-tab", { testid: "fit-drop" },
      h("div.workspace", toolbar, stage, this.#view.bar), h("div.side.fit-side", panels), this.#file));
  }

  setMethod(name) {
    this.#method = name;
    this.#take(null);
    if (this.startTool) this.run();
    else if (this.sources.current) this.showFit(this.sources.current);
  }

  setSide(side) {
    this.#side = side;
    this.run();
  }

  /** Expert was turned on or off. Without it, no method can be seen or chosen, so it is the usual one. */
  #expert() {
    const { default_method: usual } = this.state.project;
    this.offer();
    this.#showResult();
    if (expert.on) return;
    this.#iterations.show(this.#fit?.iterations ?? []);
    this.#view.setIteration(null);
    if (this.#method !== usual && !this.#setup.needsMethod(usual)) this.#setup.choose(usual);
  }

  /** The lights of the view Relight: {lamps, ambient}. */
  get lights() { return this.#view.light; }

  /** Whether the colour of the light is corrected. */
  get balance() { return this.#view.balance; }

  /** Opacity of a view. */
  opacityOf(view) { return this.#view.opacityOf(view); }

  /** Save the picture of a view: "flat", "balanced", "shading" or "relit". */
  save(view) { return this.#exports.save(view); }

  /** Let a person choose a picture to fit. */
  chooseFile() { this.#file.click(); }

  focus() { this.#view.viewer.canvas.focus({ preventScroll: true }); }

  setStart(value) {
    this.#start = value;
    this.#setup.showStart(value);
    this.#mean.showFit(false);
    this.#view.viewer.use(this.startTool);
    this.#view.showStart();
  }

  #busy(now) {
    this.#setup.setBusy(now);
    if (now && !this.#fit) this.#result.showMessage("info", "Fitting…");
  }

  #showResult() {
    if (this.#fit) return this.#result.show(this.#fit, this.#objects.length > 1);
    const { model } = this.state.project;
    const what = this.sources.current ? "Not fitted yet." : "Open a picture to fit the model to it.";
    return this.#result.showMessage("info", model ? what : "");
  }

  refuse(error) {
    this.#result.showMessage("bad", error.message);
    if (document.documentElement.dataset.side === "away") this.app.toast(error, "bad");
  }

  /** Why the model does not match the folder's template, or "". */
  get mismatch() { return this.state.guest ? "" : mismatch(this.state.project); }

  offer() {
    const source = this.sources.current;
    const { model, pictures } = this.state.project;
    this.#guest.show();
    this.#setup.show();
    this.#exports.show();
    this.#layers.hidden = !model;
    this.#steps.hidden = !model || !expert.on;
    this.#empty.hidden = Boolean(source);
    const where = `${pictures.length ? "select one on the left, " : ""}drop one here, or open one`;
    this.#words.textContent = `Use any picture of the model's object: ${where}. It stays on this machine.`;
  }

  /** Hooks for browser tests and benchmarks: the displayed values, and frames per second of the newest drag. */
  #expose() {
    const [tab, view] = [this, this.#view];
    window.liaamStudio.fit = {
      viewer: view.viewer, invariantFps: () => view.invariant.meter.rate(), relightFps: () => view.meter.rate(),
      get lastDropMs() { return tab.#lastDropMs; },
      get fit() { return tab.fit; },
      get view() { return view.name; },
      get hasLayer() { return view.hasImage; },
      get theta() { return view.invariant.theta; },
      get light() { return { lamps: view.light.lamps, ambient: view.light.ambient, selected: view.light.selected }; },
      get relightBusy() { return view.isRelighting; },
      get start() { return tab.startTool?.start ?? null; },
      get shownShape() { return view.shownShape; },
    };
  }
}
