// The Fit tab's panels: for a guest model, the picture, the start and the method, and with the result; and its exports.

import { api } from "./api.js";
import { expert } from "./expert.js";
import { entries, modelNeeded, offer } from "./fit-draw.js";
import { AUTO, factsOf, objectOf, reducedText, verdictOf } from "./fit-run.js";
import { balanceQuery, lightQuery } from "./relight.js";
import { sidesInWords } from "./sides.js";
import { button, h, iconButton, saveFile, segmented } from "./ui.js";

const STARTS = [
  { value: "auto", label: "Automatic", title: "Search the picture for the object", hint: "" },
  {
    value: "box", label: "Box", title: "Draw a box around the object",
    hint: "Draw a box around the object. Arrow keys move it, comma and full stop resize it, Enter fits.",
  },
  {
    value: "mean", label: "Mean shape", title: "Drag the model's mean shape onto the object",
    hint: "Drag the shape onto the object. Its corners resize it, the knob rotates it. Keys: arrows move, " +
      "comma and full stop resize, brackets rotate, Enter fits.",
  },
];

const SIDES = { left: "Left", right: "Right", original: "Not mirrored", mirrored: "Mirrored" };

export class SetupPanel {
  /** @type {import("./fit.js").Tab} */
  #tab;
  // Elements.
  #aside; #back; #hint; #label; #method; #mismatch; #needsModel; #notes; #ofMethod; #ofSides; #place; #runner; #sides; #starts; #withModel;

  /** @param {import("./fit.js").Tab} tab */
  constructor(tab) {
    this.#tab = tab;
    const { app } = tab;
    this.#label = h("span.fit-source-name.grow");
    const onback = () => tab.sources.backToFolder();
    this.#back = iconButton("Back to the folder", "left", onback, { small: true, hidden: true });
    const open = button("Open…", {
      icon: "image", small: true, title: "Open another picture without adding it to the folder",
      onclick: () => tab.chooseFile(),
    });
    this.#aside = h("p.small.muted.grow", {
      hidden: true, testid: "fit-aside", title: "This picture is only looked at: it is not in the folder",
    }, "Not in the folder");
    this.#place = button("Place its landmarks", {
      icon: "plus", small: true, hidden: true, testid: "fit-place", title: "Add the picture to the folder, and annotate it",
      onclick: () => app.adding.keep(tab.sources.current.file),
    });
    this.#starts = segmented("Start", STARTS, "auto", (value) => tab.setStart(value), "start");
    this.#starts.element.addEventListener("click", ({ detail, target }) => {
      if (!detail || !target.value) return; // chosen by keys
      tab.setStart(target.value);
      if (tab.startTool) tab.focus();
    });
    this.#hint = h("p.small.muted", { hidden: true });
    const { methods, default_method: first } = app.state.project;
    const sorted = [...methods].sort((a, b) => Number(b.name === first) - Number(a.name === first));
    const summary = h("p.small.muted.fit-method-summary", { id: "fit-method-summary" });
    const summarise = () => {
      const chosen = methods.find(({ name }) => name === method.value);
      summary.textContent = `${chosen.summary}${chosen.needs_colour ? " Needs colour." : ""}`;
      return chosen.name;
    };
    const method = this.#method = h("select.text", {
      "aria-describedby": "fit-method-summary", testid: "fit-method", onchange: () => tab.setMethod(summarise()),
    }, sorted.map(({ name }) => h("option", { value: name }, name)));
    summarise();
    this.#runner = button("Fit", {
      icon: "target", kind: "primary", shortcut: "Enter", testid: "fit-run", onclick: () => tab.run(),
    });
    this.#runner.append(h("kbd.kbd", "Enter"));
    this.#mismatch = h("p.small.error-text", { hidden: true, testid: "fit-mismatch" });
    this.#needsModel = h("div.column", modelNeeded(app, "fit-to-annotate"));
    this.#ofSides = h("div.column.tight", { testid: "fit-sides" });
    this.#ofMethod = h("div.column.tight", h("label.field", "Method", method), summary);
    this.#withModel = h("div.column",
      this.#starts.element, h("div.row", expert.control(), h("span.grow"), this.#runner), // these stay where they are
      this.#hint, this.#ofSides, this.#ofMethod);
    this.element = h("section.panel", { "aria-label": "Fit" },
      h("div.row.fit-source", this.#back, this.#label, open), this.#needsModel, this.#withModel);
    this.#notes = h("section.panel", { "aria-label": "Notes" }, this.#mismatch, h("div.row", this.#aside, this.#place));
  }

  /** What comes and goes, to be shown below what is pressed. */
  get notes() { return this.#notes; }

  /** Show which start is chosen. */
  showStart(value) {
    this.#starts.value = value;
    this.#hint.textContent = STARTS.find((start) => start.value === value).hint;
    this.#hint.hidden = !this.#hint.textContent;
  }

  /** Let a side of the object be chosen, if the model knows two. @param {Model | null} model */
  offerSides(model) {
    const sides = model?.sides;
    this.#ofSides.hidden = !sides;
    this.#sides = null;
    if (!sides) return;
    const choices = [
      { value: AUTO, label: "Either side", title: "Try both sides, and take the likelier" },
      ...[sides.own, sides.other].map((side) => ({ value: side, label: SIDES[side], title: `Fit as ${side}` })),
    ];
    this.#sides = segmented("Side", choices, AUTO, (value) => this.#tab.setSide(value), "side");
    this.#ofSides.replaceChildren(this.#sides.element, h("p.small.muted", sidesInWords(sides)));
  }

  showSide(value) { if (this.#sides) this.#sides.value = value; }

  /** A fit runs, or no longer. */
  setBusy(busy) { this.#runner.disabled = busy || !this.#tab.sources.current; }

  /** Whether a method has to be chosen, since the model was not trained for this one. */
  needsMethod(name) {
    const { model } = this.#tab.state.project;
    return Boolean(model) && !model.methods.includes(name);
  }

  /** Choose a method as if by hand. */
  choose(name) {
    this.#method.value = name;
    this.#method.dispatchEvent(new Event("change"));
  }

  show() {
    const { sources: { current: source }, state, mismatch } = this.#tab;
    const { model } = state.project;
    this.#label.textContent = this.#label.title = source?.name ?? "No picture";
    this.#place.hidden = !source?.file || state.guest;
    this.#aside.hidden = this.#place.hidden;
    this.#back.hidden = !source || source.ofFolder || !state.current;
    this.#needsModel.hidden = Boolean(model);
    this.#withModel.hidden = !model;
    offer(this.#method, model);
    this.#ofMethod.hidden = !expert.on && !this.needsMethod(this.#tab.method);
    this.#mismatch.textContent = mismatch;
    this.#mismatch.hidden = !mismatch;
    this.#notes.hidden = this.#mismatch.hidden && this.#aside.hidden;
    this.#runner.disabled = !source;
  }
}

/** The panel that says that the page only fits, with a model that was dropped on it, and ends that. */
export function guestPanel({ state, openTab }) {
  const words = h("p.small.guest-words");
  const onclick = async () => {
    await api.delete(api.url("model/guest"));
    await state.refresh();
    openTab("annotate");
  };
  const leave = button("Leave", {
    small: true, testid: "leave-guest", title: "Use the model of the folder again", onclick,
  });
  const element = h("section.panel", { "aria-label": "Fit only", testid: "guest" },
    h("div.panel-title", h("h2.grow", "Fit only"), leave), words);
  const show = () => {
    element.hidden = !state.guest;
    if (!state.guest) return words.replaceChildren();
    const { name, n_points: count } = state.project.model ?? {};
    words.textContent = `Pictures are fitted with ${name}.liaam (${count} points). Nothing is trained, and no ` +
      "landmarks are saved.";
    return undefined;
  };
  return { element, show };
}

export class ResultPanel {
  /** @type {import("./fit.js").Tab} */
  #tab;
  // Elements.
  #all; #facts; #next; #remedies; #specimens; #status;

  /** @param {import("./fit.js").Tab} tab */
  constructor(tab) {
    const start = (value) => {
      tab.setStart(value);
      tab.focus();
    };
    this.#status = h("div.column.tight.fit-status", { role: "status", "aria-live": "polite", testid: "fit-status" });
    this.#next = button("Next object", { icon: "right", small: true, onclick: () => tab.next() });
    this.#all = button("Fit all", {
      icon: "target", small: true, testid: "fit-all", title: "Fit all specimens of the picture", onclick: () => tab.runAll(),
    });
    this.#specimens = h("div.column.tight", { role: "group", "aria-label": "Specimens", testid: "fit-specimens" });
    this.#remedies = h("div.row.tight.fit-remedies", { hidden: true }, this.#all, this.#next,
      button("Draw a box", { icon: "box", small: true, onclick: () => start("box") }),
      button("Drag the mean shape", { icon: "target", small: true, onclick: () => start("mean") }));
    this.#facts = h("dl.fit-facts");
    this.element = h("section.panel.fit-result", { "aria-label": "Result" }, this.#status, this.#remedies,
      this.#specimens, this.#facts);
    this.#tab = tab;
  }

  /** Show a message in place of a fit, or nothing for ""; kind: "info" or "bad". */
  showMessage(kind, message) {
    this.element.hidden = !message;
    this.#status.replaceChildren(h(kind === "bad" ? "p.error-text" : "p.small", message));
    this.#remedies.hidden = true;
    this.#facts.replaceChildren();
    this.#specimens.replaceChildren();
  }

  /** List specimens that were fitted together: a press selects one. What is not clear about the picture comes last.
   *  @param {Fits} all; @param {Fit} chosen */
  #list({ fits, faults }, chosen) {
    const row = (/** @type {Fit} */ fit) => button(specimenText(fit, expert.on), {
      small: true, kind: "ghost", pressed: fit === chosen, title: fit.specimen.fault, testid: "fit-specimen",
      onclick: () => this.#tab.choose(fit),
    });
    this.#specimens.replaceChildren(...fits.map(row), ...faults.map((fault) => h("p.small.muted", fault)));
  }

  show(/** @type {Fit} */ fit, several = false) {
    this.element.hidden = false;
    const { kind, title, advice } = verdictOf(fit, expert.on, objectOf(this.#tab.state.project.model));
    const isPlain = fit.status === "converged" || fit.nothing_found; // the title and the advice say all
    const lines = [
      h("span.badge", { class: kind, dataset: { status: fit.status } }, title),
      (expert.on || !isPlain) && h("p.small", fit.message),
      fit.trained_on && h("p.small.muted", "The model was trained on this picture."),
      advice && h("p.small.muted", advice),
    ];
    this.#status.replaceChildren(...lines.filter(Boolean));
    this.#remedies.hidden = !advice && !several;
    this.#next.hidden = this.#all.hidden = !several;
    this.#list(this.#tab.specimens, fit);
    this.#facts.replaceChildren(...entries(factsOf(fit, expert.on)));
  }
}

/** A specimen in words, such as "tray#2: converged, quality 94 %". */
export const specimenText = (/** @type {Fit} */ fit, isExpert = true) => `${fit.specimen.name}: ${verdictOf(fit, isExpert).title}`;

const EXPORTS = {
  Landmarks: { pts: "Landmarks .pts", ljson: "Landmarks .ljson", csv: "Table .csv", json: "Fit .json" },
  Pictures: {
    overlay: "Picture with its points", flat: "Picture without shading", balanced: "Picture with corrected colour", shading: "Shading", relit: "Relit picture",
    crop: "Part around the object",
  },
};
const ABOUT = {
  pts: "Its coordinates count from 1, as usual for .pts files; those of the other files count from 0",
  flat: "In the strength that the panel shows, without points and contours",
  balanced: "In the strength that the panel shows, without points and contours",
  shading: "Only the shading: the surroundings are transparent",
  relit: "In the strength that the panel shows, without points and contours",
};
const SHOWN_OVER = ["flat", "balanced", "relit"]; // the picture, in a strength
const WHOLE = ["flat", "balanced", "shading", "relit"]; // that are computed in so many pixels at most
const NEEDS = { flat: "flat", balanced: "balanced", shading: "shading", relit: "flat" }; // a layer of the fit

/** Width and height in the head of a PNG file; null for other files. @param {Blob} blob */
async function sizeOfPng(blob) {
  if (blob.type !== "image/png") return null;
  const head = new DataView(await blob.slice(16, 24).arrayBuffer());
  return { width: head.getUint32(0), height: head.getUint32(4) };
}

export class ExportMenu {
  /** @type {import("./fit.js").Tab} */
  #tab;
  // Elements.
  #annotate; #button; #panel; #table;

  /** @param {import("./fit.js").Tab} tab */
  constructor(tab) {
    this.#tab = tab;
    this.#annotate = button("Use as annotation", {
      icon: "edit", kind: "ghost", small: true, testid: "export-annotation",
      title: "Save these landmarks beside the picture",
      onclick: () => {
        this.close();
        useAsAnnotation(tab.app, tab.fit);
      },
    });
    this.#table = this.#item("table", "All specimens .csv");
    const groups = Object.entries(EXPORTS).map(([title, items]) =>
      h("div.fit-menu-group", h("h3.small.muted", title), Object.entries(items).map((item) => this.#item(...item))));
    // The browser closes it with Escape, or by a press elsewhere.
    this.#panel = h("div.fit-menu", {
      popover: "auto", role: "group", "aria-label": "Export", onbeforetoggle: () => this.#place(),
      ontoggle: ({ newState }) => newState === "open" && this.#panel.querySelector("a").focus(),
    }, groups, h("div.fit-menu-group", this.#table, this.#annotate));
    this.#button = button("Export", {
      small: true, testid: "export-menu", popoverTargetElement: this.#panel,
    });
    const onfocusout = ({ relatedTarget: to }) => to && !this.element.contains(to) && this.close();
    this.element = h("div.fit-export", { onfocusout }, this.#button, this.#panel);
  }

  show() {
    const { fit, sources: { current }, state, mismatch } = this.#tab;
    const isNothing = Boolean(fit?.nothing_found) && !expert.on;
    this.#button.disabled = !fit || isNothing;
    this.#button.title = isNothing ? `No ${objectOf(state.project.model)} was found in this picture, so there is nothing to save` : "";
    this.#annotate.hidden = !current?.ofFolder || state.guest || Boolean(mismatch);
    if (!fit) this.close();
  }

  close() { if (this.#panel.isConnected) this.#panel.hidePopover(); }

  #item(what, label) {
    const onclick = (event) => {
      event.preventDefault(); // a plain link would show neither progress nor errors
      if (!event.target.ariaBusy) this.#save(event.target);
    };
    return h("a.button.ghost.small", { download: "", title: ABOUT[what], dataset: { what, testid: `export-${what}` }, onclick }, label);
  }

  #address(what) {
    const { fit: { id }, lights } = this.#tab;
    const { light } = what === "relit" ? lightQuery(lights) : { light: null };
    const isShown = SHOWN_OVER.includes(what);
    const opacity = isShown ? this.#tab.opacityOf(what) : 1;
    const balance = isShown ? balanceQuery(this.#tab.balance.corrects) : {};
    return api.url("fits/{id}/export", { id, what, light, opacity: opacity < 1 ? opacity : null, ...balance });
  }

  /** Save a file of the fit without the menu. */
  async save(what) { await this.#keep(await api.file(this.#address(what))); }

  /** Save a file, and say if it is smaller than the picture. */
  async #keep([blob, name]) {
    const { fit } = this.#tab;
    const saved = await sizeOfPng(blob);
    const isReduced = saved && !name.endsWith("_crop.png") && fit && saved.width < fit.width;
    saveFile(blob, name, isReduced ? `, reduced to ${saved.width}×${saved.height} from ${fit.width}×${fit.height} pixels. “liaam relight” keeps all` : "");
  }

  async #save(link) {
    link.ariaBusy = "true";
    const file = await api.file(link.getAttribute("href")).finally(() => { link.ariaBusy = null; });
    await this.#keep(file);
    this.close();
  }

  #place() {
    const { right, bottom } = this.#button.getBoundingClientRect();
    Object.assign(this.#panel.style, { right: `${innerWidth - right}px`, top: `${bottom + 6}px`, maxHeight: `${innerHeight - bottom - 14}px` });
    const { fit } = this.#tab;
    const { fits } = this.#tab.specimens;
    for (const link of fit ? this.#panel.querySelectorAll("a") : []) {
      const { what } = link.dataset;
      if (link === this.#table) {
        link.href = api.url("fits/table", { fits: fits.map(({ id }) => id).join() });
        link.hidden = !fits.length;
        continue;
      }
      link.href = this.#address(what);
      const reduced = WHOLE.includes(what) && reducedText(fit, this.#tab.state.project.limits.relit_pixels);
      link.title = [ABOUT[what], reduced].filter(Boolean).join(". ");
      link.hidden = what in NEEDS && !fit.layers.includes(NEEDS[what]);
    }
  }
}

/** Save a fit's landmarks for its picture; ask before replacing others. @param {App} app; @param {Fit} fit */
export async function useAsAnnotation(app, fit) {
  const { state } = app;
  const known = await api.get(api.url("pictures/{name}/landmarks", { name: fit.picture }));
  const placed = known.source === "file" && known.points.some(Boolean);
  const text = `${fit.picture} already has landmarks (${known.file ?? "in its file"}).`;
  const replace = () =>
    app.confirm("Replace the landmarks?", `${text} They will be replaced by those of the fit.`, "Replace");
  if (placed && !(await replace())) return;
  /** @type {SaveMarks["origins"]} */
  const origins = fit.shape.map((point) => (point ? "accepted" : null));
  const saved = await state.saveMarks(fit.picture, {
    points: fit.shape, origins, invisible: placed ? known.invisible : [], revision: known.revision,
    template: state.project.template?.revision,
  });
  state.update(saved.picture);
  app.toast(`Saved as the landmarks of ${fit.picture}.`, "good");
}
