// The Fit tab: fit the model to a picture and inspect the result.

import { mismatch } from "./assist.js";
import { FitView } from "./fit-view.js";
import { hooksOf } from "./fit-hooks.js";
import { ExportMenu, useAsAnnotation } from "./fit-export.js";
import { Iterations } from "./fit-iterations.js";
import { ResultPanel } from "./fit-result.js";
import { EmptyStage, GuestPanel, isGuest } from "./fit-only.js";
import { fitsOf } from "./fit-run.js";
import { afterPaint } from "./fit-schedule.js";
import { SetupPanel } from "./fit-setup.js";
import { sourcesOf } from "./fit-source.js";
import { BoxTool, meanShape, MeanTool } from "./fit-start.js";
import { h } from "./ui.js";

const SHORTCUTS = [
  { keys: "Enter F", what: "Fit" },
  { keys: "V Shift+V", what: "Next, previous view" },
  { keys: "S", what: "Before and after" },
  { keys: "C L M E", what: "Show contours, points, mesh, ellipses" },
  { keys: "O", what: "Make the view more transparent" },
  { keys: ", .", what: "Previous, next iteration (or resize the start)" },
  { keys: "P", what: "Play the iterations" },
  { keys: "Arrows", what: "Change θ (Shift: 0.1°), the light, or the start" },
];

export function mount(root, app) {
  const tab = new FitTab(root, app);
  return {
    show: (options) => tab.open(options), hide: () => tab.leave(), shortcuts: SHORTCUTS, key: (event) => tab.key(event),
  };
}

class FitTab {
  constructor(root, app) {
    this.app = app;
    this.state = app.state;
    this.sources = sourcesOf(app);
    this.store = fitsOf(app);
    this.visible = false;
    this.start = "auto";
    this.method = null;
    this.fit = null;
    this.lastDropMs = null;
    this._run = 0; // number of the newest run, to drop answers of older ones
    this.view = new FitView({ gone: (fit) => this._forgotten(fit), ambient: this.state.project.default_ambient });
    this.box = new BoxTool(this.view.viewer, () => this.run());
    this.mean = new MeanTool(this.view.viewer);
    this.iterations = new Iterations((index, last) => this._iterate(index, last));
    this.exports = new ExportMenu({
      light: () => this.view.light, annotate: (fit) => this._annotate(fit), complain: (error) => this._complain(error),
    });
    this.guest = new GuestPanel(app);
    this.result = new ResultPanel({ onstart: (value) => this._setStart(value, true) });
    this.setup = new SetupPanel({
      app, onback: () => this.sources.backToFolder(), onopen: () => this._file.click(),
      onstart: (value) => this._setStart(value), onclick: () => this._toPicture(),
      onmethod: (name) => this._setMethod(name), onrun: () => this.run(),
    });
    this._build(root);
    this._listen();
    window.liaamStudio.fit = hooksOf(this);
    this._project();
    this._source();
  }

  // Opening and leaving.

  /** @param {{name?: string, view?: string}} options */
  open({ name, view } = {}) {
    if (name) this.state.select(name);
    if (view) this.view.show(view);
    this._watch(true);
    this._source();
  }

  leave() {
    this._watch(false);
    this.iterations.pause();
    this.exports.close();
  }

  /** The tab is opened (true) or left (false). */
  _watch(open) {
    if (open !== this.visible) this.sources.watch(open);
    this.visible = open;
  }

  key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return false;
    const onControl = event.target instanceof HTMLElement && event.target.matches("button, a, [role=radio]");
    if (event.key === "Enter" && onControl) return false; // Enter activates the control
    if (this._startTool()?.key(event)) return true;
    const letter = event.key.length === 1 ? event.key.toLowerCase() : event.key;
    const actions = {
      Enter: () => this.run(), f: () => this.run(), v: () => this.view.cycle(event.shiftKey ? -1 : 1),
      s: () => {
        this.view.split = !this.view.split;
      },
      c: () => this.view.toggle("contours"), l: () => this.view.toggle("landmarks"), m: () => this.view.toggle("mesh"),
      e: () => this.view.toggle("ellipses"), o: () => this.view.fade(),
      ",": () => this.iterations.step(-1),
      ".": () => this.iterations.step(1),
      p: () => this.iterations.toggle(),
    };
    if (!actions[letter]) return this.view.key(event);
    actions[letter]();
    return true;
  }

  // Fitting.

  /** Fit the shown picture from the chosen start. Resolves once the fit is painted. */
  async run() {
    const source = this.sources.current;
    const { model } = this.state.project ?? {};
    if (!source || !model) return null;
    const start = this._start();
    if (start === undefined) return null;
    const run = (this._run += 1);
    this._busy(true);
    try {
      const fit = await this._asked(source, start);
      if (run !== this._run || this.sources.current !== source) return null;
      this._take(fit);
      await afterPaint();
      return fit;
    } catch (error) {
      if (run === this._run) this._refused(error);
      return null;
    } finally {
      if (run === this._run) this._busy(false);
    }
  }

  /** Request the fit of a dropped file while the browser is still decoding it. */
  _early(source) {
    this.lastDropMs = null;
    if (!this.visible || !this.state.project?.model) return;
    const { method } = this;
    const answer = this.store.run(source, method);
    answer.catch(() => {}); // reported by the run that waits for it, or by the upload
    this._ahead = { source, method, answer };
  }

  /** The answer with the fit; reuses an early request for the same source, method and start. */
  _asked(source, start) {
    const { _ahead: ahead, method } = this;
    this._ahead = null;
    if (ahead && start === null && ahead.source === source && ahead.method === method) return ahead.answer;
    return this.store.run(source, method, start);
  }

  /** The chosen start; undefined, with a message, if it is not complete. */
  _start() {
    const tool = this._startTool();
    if (!tool) return null;
    if (tool.start) return tool.start;
    this.result.showMessage(
      "info",
      this.start === "box"
        ? "Draw a box around the object first."
        : "The mean shape is not known yet: run an automatic fit first.",
    );
    return undefined;
  }

  _startTool() {
    return { box: this.box, mean: this.mean }[this.start] ?? null;
  }

  _take(fit) {
    this.fit = fit;
    const ofFolder = Boolean(this.sources.current?.ofFolder);
    this.view.setFit(fit);
    this.view.setAngles({ model: this.state.project.model?.theta_deg, fit: fit?.theta_deg });
    this.iterations.show(fit?.iterations ?? []);
    this.exports.show(fit, ofFolder && this._mayAnnotate);
    this._result();
    if (this.start === "mean") this._useMean();
    this.mean.fitted = Boolean(fit);
  }

  _iterate(index, last) {
    this.view.setIteration(last ? null : { shape: this.fit.iterations[index].shape, final: false });
  }

  _forgotten(fit) {
    this.store.forget(fit);
    this.app.toast("The server no longer has this fit, so the picture is fitted again.");
    this.run();
  }

  async _annotate(fit) {
    try {
      if (await useAsAnnotation(this.app, fit)) this.app.toast(`Saved as the landmarks of ${fit.picture}.`, "good");
    } catch (error) {
      this._complain(error);
    }
  }

  // The source.

  _listen() {
    this.sources.addEventListener("taken", ({ detail }) => this._early(detail.source));
    this.sources.addEventListener("change", () => this._source());
    this.sources.addEventListener("ready", () => this.view.setSource(this.sources.current));
    this.sources.addEventListener("failed", ({ detail }) => {
      if (this.visible) this._refused(detail.error);
    });
    this.state.addEventListener("project", () => this._project());
    this.state.addEventListener("training", ({ detail }) => {
      if (detail.state === "done") this.state.refresh().catch(() => {});
    });
  }

  /** The picture has changed: show it with its fit, or fit it if the start is automatic. */
  _source() {
    const source = this.sources.current;
    if (this._seen !== source) {
      this._seen = source;
      this._run += 1;
      this._busy(false);
      this.view.setSource(source);
      this.box.clear();
      this.mean.clear();
      this._take(null);
      if (source?.kind === "upload") this._setStart("auto");
    }
    this._emptiness();
    if (!source || this.fit || !this.visible) return;
    const known = this.store.recall(source, this.method);
    if (known) this._take(known);
    else if (this.state.project.model && this.start === "auto") this._runAtOnce(source);
    else this._result();
  }

  async _runAtOnce(source) {
    const fit = await this.run();
    if (fit && source.kind === "upload" && !source.timed) {
      source.timed = true;
      this.lastDropMs = performance.now() - source.started;
    }
  }

  /** The project has changed: update the methods and the model. */
  _project() {
    const { methods = [], default_method: first, model } = this.state.project ?? {};
    const names = methods.map((method) => method.name).join();
    if (this._methodNames !== names) {
      this._methodNames = names;
      this.method ??= first ?? methods[0]?.name ?? "soft-li";
      this.setup.offer(methods, first, this.method);
    }
    const number = model?.number ?? null;
    const another = this._number !== undefined && this._number !== number;
    this._number = number;
    this.view.hasContours = Boolean(model?.contours?.length);
    this._emptiness();
    if (!another) return;
    // The model has changed, so earlier fits are out of date.
    this._run += 1;
    this.mean.unit = null;
    this._take(null);
    this._source();
  }

  // The page.

  _build(root) {
    this._file = h("input.visually-hidden", {
      type: "file", accept: "image/*,.tif,.tiff,.ppm,.pgm,.bmp,.liaam", tabindex: "-1", testid: "fit-file",
      "aria-label": "Open a picture to fit",
      onchange: () => {
        const [file] = this._file.files;
        this._file.value = "";
        if (file) this.app.take(file);
      },
    });
    const toolbar = h("div.toolbar", { role: "toolbar", "aria-label": "View" },
      this.view.chooser, this.view.splitter, h("span.grow"), this.exports.element);
    this._empty = new EmptyStage(this.app, () => this._file.click());
    const stage = h("div.fit-stage", this.view.container, this._empty.element);
    this._ofFits = [
      h("section.panel", { "aria-label": "Layers and their opacity" }, this.view.layers),
      h("section.panel", { "aria-label": "Iterations" }, this.iterations.element),
    ];
    const panels = [this.view.light, this.guest, this.setup, this.result].map(({ element }) => element);
    this._side = h("div.side.fit-side", panels, this._ofFits);
    this._area = h("div.fit-tab", { testid: "fit-drop" },
      h("div.workspace", toolbar, stage, this.view.bar), this._side, this._file);
    root.append(this._area);
  }

  _setMethod(name) {
    this.method = name;
    this._take(null);
    const source = this.sources.current;
    const known = source && !this._startTool() && this.store.recall(source, name);
    if (known) this._take(known);
    else this.run();
  }

  /** After a click on a start, focus the picture for its keys; arrow keys in the row of starts stay there. */
  _toPicture() {
    if (this._startTool()) this.view.viewer.canvas.focus({ preventScroll: true });
  }

  _setStart(value, focus = false) {
    this.start = value;
    this.setup.start = value;
    if (value === "mean") {
      this.mean.fitted = false;
      this._useMean();
    }
    this.view.tool = this._startTool();
    this.view.viewer.redraw();
    if (focus) this.view.viewer.canvas.focus();
  }

  /** Set the mean shape of its tool; if it is unknown, get it from an automatic fit. */
  async _useMean() {
    if (this.mean.unit) return;
    const { project } = this.state;
    let shape = meanShape(project, this.fit);
    const source = this.sources.current;
    if (!shape && source && project.model) {
      try {
        shape = meanShape(project, await this.store.run(source, project.default_method));
      } catch (error) {
        this._complain(error);
      }
    }
    if (shape && source === this.sources.current) this.mean.use(shape, project.model);
  }

  _busy(now) {
    this.setup.canRun = !now && Boolean(this.sources.current);
    if (now && !this.fit) this.result.showMessage("info", "Fitting…");
  }

  _result() {
    if (this.fit) {
      this.result.show(this.fit);
      return;
    }
    const { model } = this.state.project ?? {};
    const what = this.sources.current ? "Not fitted yet." : "Open a picture to fit the model to it.";
    this.result.showMessage("info", model ? what : "");
  }

  /** Show why the fit failed; the earlier fit stays. */
  _refused(error) {
    this.result.showMessage("bad", error.message);
  }

  _complain(error) {
    this.app.toast(error, "bad");
  }

  get _mayAnnotate() {
    const { project } = this.state;
    return !isGuest(project) && !mismatch(project);
  }

  _emptiness() {
    const source = this.sources.current;
    const { model } = this.state.project ?? {};
    this.guest.show(this.state.project);
    const wrong = isGuest(this.state.project) ? "" : mismatch(this.state.project ?? {});
    const canGoBack = source?.kind === "upload" && Boolean(this.state.current);
    this.setup.show({ source, model, canGoBack, mismatch: wrong });
    this.exports.show(this.fit, Boolean(source?.ofFolder) && this._mayAnnotate);
    for (const panel of this._ofFits) panel.hidden = !model;
    this.view.container.classList.toggle("without", !source);
    this._empty.show(!source, this.visible && !model);
  }
}
