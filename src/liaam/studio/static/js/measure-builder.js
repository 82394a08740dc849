// The card in which a measure is made by clicking points, with the list of measures and the scale.

import { CLICK } from "./annotate-words.js";
import { KINDS, measureOf, measureText, scaleText } from "./measures.js";
import { picker } from "./shape-plots.js";
import { curveText } from "./template.js";
import { button, complaints, h, iconButton, segmented } from "./ui.js";

const SCALE = "Scale of pictures that have none: the length of a pixel (0.005 mm, or 200 px/mm); or of all, two points and their distance (11-12=5 mm)";

export class MeasureBuilder {
  /** @type {Map<string, {element: HTMLElement, about: HTMLElement, name: any, remove: HTMLElement}>} */
  #rows = new Map(); // of the list, by measure: what is being typed stays when the list is drawn
  /** @type {number[]} */
  #picked = []; // indices of the points of the measure that is being made, in order
  #complain = complaints(); // about measures
  element = h("section.panel.measure-card", { "aria-label": "New measure" });
  /** @type {import("./measure.js").Tab} */
  #tab;
  #shownScale; // the kept one that the field was last given
  // Elements.
  #add; #curves; #fault; #gone; #hint; #kind; #list; #picker; #scale; #scaleFault; #scaleMeans;

  /** @param {import("./measure.js").Tab} tab */
  constructor(tab) {
    this.#tab = tab;
    this.#shownScale = tab.measuring.scale;
    const kinds = Object.entries(KINDS).map(([value, { label, about }]) => ({ value, label, title: about }));
    this.#kind = segmented("Kind of measure", kinds, "distance", () => this.#pick([]), "measure-kind");
    this.#add = button("Add", { kind: "primary", small: true, testid: "measure-add", onclick: () => this.#addPicked() });
    this.#picker = h("div.measure-plot");
    this.#hint = h("p.small.muted", { role: "status" });
    this.#curves = h("div.row.tight.small", { testid: "measure-curves" });
    this.#list = h("ul.measure-list", { "aria-label": "Measures", testid: "measure-list" });
    this.#fault = h("p.small.error-text", { role: "alert", hidden: true, testid: "measure-name-fault" });
    this.#scale = h("input.text", {
      type: "text",
      placeholder: "of each picture, or in pixels",
      testid: "measure-scale",
      value: tab.measuring.scale,
      onchange: () => this.#changeScale(),
    });
    this.#scaleFault = h("p.small.error-text", { role: "alert", hidden: true, testid: "measure-scale-fault" });
    this.#scaleMeans = h("p.small.muted", { role: "status", testid: "measure-scale-means" });
    this.#gone = h("div.row.small", { role: "status", hidden: true, testid: "measures-gone" });
    this.element.append(
      h("h2.panel-title", "Measures"),
      h("div.row", this.#kind.element, h("span.grow"), this.#add),
      this.#picker,
      this.#hint,
      this.#curves,
      this.#list,
      this.#fault,
      this.#gone,
      h("label.field", SCALE, this.#scale),
      this.#scaleMeans,
      this.#scaleFault);
  }

  /** Add, remove or dismiss measures; whether that was done. @param {SaveMeasuring} change */
  async #change(change) {
    const fault = await this.#tab.state.changeMeasuring(change).then(() => null, (error) => error);
    this.#complain(fault && !fault.unreachable ? fault.message : "");
    return !fault;
  }

  /** A scale that is refused stays in the field, with what is wrong below it, to be corrected. */
  async #changeScale() {
    const typed = this.#scale.value.trim();
    const fault = await this.#tab.state.changeMeasuring({ scale: typed }).then(() => "", ({ message }) => message);
    if (this.#scale.value.trim() !== typed) return; // more has been typed since
    this.#showScaleFault(fault);
    if (!fault) this.#showScale();
  }

  #showScale() {
    this.#shownScale = this.#tab.measuring.scale;
    this.#scale.value = this.#shownScale;
  }

  #showScaleFault(text) {
    this.#scale.setAttribute("aria-invalid", String(Boolean(text)));
    this.#scaleFault.textContent = text;
    this.#scaleFault.hidden = !text;
  }

  /** Before the tab is left: take back what was said of the values, and a scale that was refused. */
  leave() {
    this.#complain(""); // it would cover other tabs
    this.#showScaleFault("");
    this.#showScale();
  }

  #pick(indices) {
    this.#picked = indices;
    this.draw();
  }

  /** A click on a point adds it, or takes it out; of too many points, the first goes. */
  #toggle(index) {
    const { most } = KINDS[this.#kind.value];
    const isPicked = this.#picked.includes(index);
    const next = isPicked ? this.#picked.filter((i) => i !== index) : [...this.#picked, index].slice(-most);
    this.#pick(next);
    this.#picker.querySelector(`[data-index="${index}"]`)?.focus();
    if (next.length === most) this.#addPicked();
  }

  #addPicked() {
    if (this.#picked.length < KINDS[this.#kind.value].fewest) return;
    this.#change({ add: [measureOf(this.#kind.value, this.#picked)] });
    this.#pick([]);
  }

  async #remove(measure) {
    const { names } = this.#tab.measuring;
    const called = names[measure];
    if (!(await this.#change({ remove: [measure] }))) return;
    const undo = () => this.#change({ add: [`${called ? `${called}=` : ""}${measure}`] });
    this.#tab.app.toast(`${called || measureText(measure, this.#tab.names)} removed.`, "info", { label: "Undo", onclick: undo });
  }

  /** Where points are drawn to be clicked: the mean shape, the template, or the open picture's points. */
  #layout() {
    const { template } = this.#tab.state.project;
    const { space } = this.#tab.data ?? {};
    if (space && space.landmarks.length === this.#tab.names.length) return space.mean;
    return template?.points ?? this.#tab.app.points();
  }

  draw() {
    this.#add.disabled = this.#picked.length < KINDS[this.#kind.value].fewest;
    this.#hint.textContent = this.#hintText();
    this.#drawPicker();
    this.#drawCurves();
    this.#drawList();
    this.#drawGone();
    const isTyped = this.#scale.value !== this.#shownScale; // and not sent yet, or refused
    if (!isTyped) this.#showScale(); // it follows its points
    this.#scaleMeans.textContent = isTyped ? "" : scaleText(this.#shownScale, this.#tab.names);
  }

  #hintText() {
    const [picked, tab] = [this.#picked, this.#tab];
    const { about, fewest, most } = KINDS[this.#kind.value];
    const count = fewest === most ? `${fewest} points` : `${fewest} or more points in order`;
    if (!picked.length) return `${about}. ${CLICK} ${count}.`;
    const names = picked.map((i) => tab.names[i]).join(" – ");
    const lacking = fewest - picked.length;
    return lacking > 0 ? `${names}: ${lacking} more` : names;
  }

  #drawPicker() {
    const { names, contours } = this.#tab;
    const points = this.#layout();
    const closed = this.#kind.value === "area";
    this.#picker.replaceChildren(points.some(Boolean)
      ? picker({ points, names, contours, lit: this.#picked, closed, onpick: (i) => this.#toggle(i), width: this.#picker.clientWidth || undefined })
      : h("p.muted.small", "The points are drawn here once three pictures are done."));
  }

  /** Buttons that measure a curve of the template as a whole: the length of an open one, or the area of a closed one. */
  #drawCurves() {
    const kind = this.#kind.value;
    const { fewest } = KINDS[kind];
    const isFit = ({ indices, closed }) => indices.length >= fewest && closed === (kind === "area");
    const buttons = kind === "length" || kind === "area" ? this.#tab.contours.flatMap((curve, k) => (isFit(curve)
      ? [button(curveText(curve, k), { small: true, testid: "measure-curve", onclick: () => this.#addCurve(kind, curve) })] : [])) : [];
    this.#curves.hidden = !buttons.length;
    this.#curves.replaceChildren(h("span.muted", kind === "area" ? "Or the area of a whole curve:" : "Or the length of a whole curve:"), ...buttons);
  }

  /** @param {string} kind; @param {Contour} curve */
  #addCurve(kind, { indices, name = "" }) {
    this.#change({ add: [`${name && `${name} ${kind}=`}${measureOf(kind, indices)}`] });
    this.#pick([]);
  }

  #drawList() {
    const { measures, names } = this.#tab.measuring;
    const shown = [...this.#rows.keys()];
    for (const gone of shown.filter((measure) => !measures.includes(measure))) this.#rows.delete(gone);
    for (const measure of measures) if (!this.#rows.has(measure)) this.#rows.set(measure, this.#row(measure));
    if (shown.join() !== measures.join()) this.#list.replaceChildren(...measures.map((measure) => this.#rows.get(measure).element));
    for (const [measure, { about, name, remove }] of this.#rows) {
      const text = measureText(measure, this.#tab.names);
      about.textContent = text;
      name.setAttribute("aria-label", `Name of ${text}`);
      remove.setAttribute("aria-label", `Remove ${text}`);
      if (name !== document.activeElement && name.getAttribute("aria-invalid") !== "true") name.value = names[measure] ?? "";
    }
  }

  /** A measure in the list, with its name. */
  #row(measure) {
    const name = h("input.text.measure-name", {
      type: "text", placeholder: "Name", spellcheck: "false", autocomplete: "off", maxlength: "60",
      title: "What you call it, such as wing length: in the table, the plots and the saved file", testid: "measure-name",
      onchange: () => this.#rename(measure, name),
      onkeydown: (event) => { if (event.key === "Enter") name.blur(); },
    });
    const about = h("span.grow.muted.small");
    const remove = iconButton("Remove", "close", () => this.#remove(measure), { small: true });
    return { element: h("li.row", name, about, remove), about, name, remove };
  }

  /** A name that another measure has is refused, and stays to be changed. */
  async #rename(measure, field) {
    const fault = await this.#tab.state.changeMeasuring({ names: { [measure]: field.value.trim() } }).then(() => "", ({ message }) => message);
    field.setAttribute("aria-invalid", String(Boolean(fault)));
    this.#fault.textContent = fault;
    this.#fault.hidden = !fault;
    this.#drawList();
  }

  /** Name the measures that a change of the template has removed with their points. */
  #drawGone() {
    const { gone } = this.#tab.measuring;
    this.#gone.hidden = !gone.length;
    if (!gone.length) return this.#gone.replaceChildren();
    const seen = iconButton("Dismiss", "close", () => this.#change({ seen: true }), { small: true });
    return this.#gone.replaceChildren(h("span.grow.warn-text", `Removed with points of the template: ${gone.join("; ")}.`), seen);
  }
}
