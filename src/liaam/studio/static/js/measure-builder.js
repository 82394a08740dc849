// The card in which a measure is made by clicking points, with the list of measures and the scale.

import { KINDS, measureOf, measureText } from "./measures.js";
import { picker } from "./shape-plots.js";
import { button, h, iconButton, segmented } from "./ui.js";

const SCALE = "Scale, if the pictures have none: length of a pixel, or two points, by name or number, and the length between them, such as 11-12=5 mm";

export class MeasureBuilder {
  /** @type {number[]} */
  #picked = []; // indices of the points of the measure that is being made, in order
  element = h("section.panel.measure-card", { "aria-label": "New measure" });
  /** @type {import("./measure.js").Tab} */
  #tab;
  #shownScale; // the kept one that the field was last given
  // Elements.
  #add; #gone; #hint; #kind; #list; #picker; #scale;

  /** @param {import("./measure.js").Tab} tab */
  constructor(tab) {
    this.#tab = tab;
    this.#shownScale = tab.measuring.scale;
    const kinds = Object.entries(KINDS).map(([value, { label }]) => ({ value, label }));
    this.#kind = segmented("Kind of measure", kinds, "distance", () => this.#pick([]), "measure-kind");
    this.#add = button("Add", { kind: "primary", small: true, testid: "measure-add", onclick: () => this.#addPicked() });
    this.#picker = h("div.measure-plot");
    this.#hint = h("p.small.muted", { role: "status" });
    this.#list = h("ul.measure-list", { "aria-label": "Measures", testid: "measure-list" });
    this.#scale = h("input.text", {
      type: "text",
      placeholder: "of each picture, or in pixels",
      testid: "measure-scale",
      value: tab.measuring.scale,
      onchange: () => this.#change({ scale: this.#scale.value.trim() }),
    });
    this.#gone = h("div.row.small", { role: "status", hidden: true, testid: "measures-gone" });
    this.element.append(
      h("h2.panel-title", "Measures"),
      h("div.row", this.#kind.element, h("span.grow"), this.#add),
      this.#picker,
      this.#hint,
      this.#list,
      this.#gone,
      h("label.field", SCALE, this.#scale));
  }

  /** What is wrong with a measure or a scale is said; what was typed stays. @param {SaveMeasuring} change */
  #change(change) { this.#tab.state.changeMeasuring(change).catch((error) => this.#tab.app.toast(error, "bad")); }

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

  #remove(measure) { this.#change({ remove: [measure] }); }

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
    this.#drawList();
    this.#drawGone();
    const { scale } = this.#tab.measuring;
    if (scale !== this.#shownScale) { // it follows its points; what is being typed stays
      this.#shownScale = scale;
      this.#scale.value = scale;
    }
  }

  #hintText() {
    const [picked, tab] = [this.#picked, this.#tab];
    const { fewest, most } = KINDS[this.#kind.value];
    const count = fewest === most ? String(fewest) : `${fewest} or more`;
    if (!picked.length) return `Click ${count} points${this.#kind.value === "angle" ? "; the angle is at the second" : ""}.`;
    const names = picked.map((i) => tab.names[i]).join(" – ");
    const lacking = fewest - picked.length;
    return lacking > 0 ? `${names}: ${lacking} more` : names;
  }

  #drawPicker() {
    const { names, contours } = this.#tab;
    const points = this.#layout();
    const closed = this.#kind.value === "area";
    this.#picker.replaceChildren(points.some(Boolean)
      ? picker({ points, names, contours, lit: this.#picked, closed, onpick: (i) => this.#toggle(i) })
      : h("p.muted.small", "The points are drawn here once three pictures are done."));
  }

  #drawList() {
    const row = (measure) => {
      const text = measureText(measure, this.#tab.names);
      const remove = iconButton(`Remove ${text}`, "close", () => this.#remove(measure), { small: true });
      return h("li.row", h("span.grow", text), remove);
    };
    this.#list.replaceChildren(...this.#tab.measuring.measures.map(row));
  }

  /** Name the measures that a change of the template has removed with their points. */
  #drawGone() {
    const { gone } = this.#tab.measuring;
    this.#gone.hidden = !gone.length;
    const seen = iconButton("Dismiss", "close", () => this.#change({ seen: true }), { small: true });
    this.#gone.replaceChildren(h("span.grow.warn-text", `Removed with points of the template: ${gone.join("; ")}.`), seen);
  }
}
