// The card in which a measure is made by clicking points, with the list of measures and the scale.

import { joined, keepWanted, KINDS, measureOf, measuresIn, measureText } from "./measures.js";
import { picker } from "./shape-plots.js";
import { button, h, iconButton, segmented } from "./ui.js";

const SCALE = "Scale, if the pictures have none: length of a pixel, or two points and the length between them, such as 11-12=5 mm";

export class MeasureBuilder {
  /** @type {number[]} */
  picked = []; // indices of the points of the measure that is being made, in order
  element = h("section.panel.measure-card", { "aria-label": "New measure" });

  /** @param {import("./measure.js").Tab} tab */
  constructor(tab) {
    this.tab = tab;
    const kinds = Object.entries(KINDS).map(([value, { label }]) => ({ value, label }));
    this._kind = segmented("Kind of measure", kinds, "distance", () => this._pick([]), "measure-kind");
    this._add = button("Add", { kind: "primary", small: true, testid: "measure-add", onclick: () => this._addPicked() });
    this._picker = h("div.measure-plot");
    this._hint = h("p.small.muted", { role: "status" });
    this._list = h("ul.measure-list", { "aria-label": "Measures", testid: "measure-list" });
    this._scale = h("input.text", {
      type: "text",
      placeholder: "of each picture, or in pixels",
      testid: "measure-scale",
      value: tab.wanted.scale,
      onchange: () => this._keep({ scale: this._scale.value.trim() }),
    });
    this.element.append(
      h("h2.panel-title", "Measures"),
      h("div.row", this._kind.element, h("span.grow"), this._add),
      this._picker,
      this._hint,
      this._list,
      h("label.field", SCALE, this._scale));
  }

  get _measures() { return measuresIn(this.tab.wanted.measures); }

  _keep(change) { keepWanted(this.tab.state.project.id, { ...this.tab.wanted, ...change }); }

  _pick(indices) {
    this.picked = indices;
    this.draw();
  }

  /** A click on a point adds it, or takes it out; of too many points, the first goes. */
  _toggle(index) {
    const { most } = KINDS[this._kind.value];
    const isPicked = this.picked.includes(index);
    const next = isPicked ? this.picked.filter((i) => i !== index) : [...this.picked, index].slice(-most);
    this._pick(next);
    this._picker.querySelector(`[data-index="${index}"]`)?.focus();
    if (next.length === most) this._addPicked();
  }

  _addPicked() {
    if (this.picked.length < KINDS[this._kind.value].fewest) return;
    this._keep({ measures: joined([...this._measures, measureOf(this._kind.value, this.picked)]) });
    this._pick([]);
  }

  _remove(measure) { this._keep({ measures: joined(this._measures.filter((each) => each !== measure)) }); }

  /** Where points are drawn to be clicked: the mean shape, the template, or the open picture's points. */
  _layout() {
    const { template } = this.tab.state.project;
    const { space } = this.tab.data ?? {};
    if (space && space.landmarks.length === this.tab.names.length) return space.mean;
    return template?.points ?? window.liaamStudio.annotate?.points() ?? [];
  }

  draw() {
    this._add.disabled = this.picked.length < KINDS[this._kind.value].fewest;
    this._hint.textContent = this._hintText();
    this._drawPicker();
    this._drawList();
  }

  _hintText() {
    const { picked, tab } = this;
    const { fewest, most } = KINDS[this._kind.value];
    const count = fewest === most ? String(fewest) : `${fewest} or more`;
    if (!picked.length) return `Click ${count} points${this._kind.value === "angle" ? "; the angle is at the second" : ""}.`;
    const names = picked.map((i) => tab.names[i]).join(" – ");
    const lacking = fewest - picked.length;
    return lacking > 0 ? `${names}: ${lacking} more` : names;
  }

  _drawPicker() {
    const { names, contours } = this.tab;
    const points = this._layout();
    const closed = this._kind.value === "area";
    this._picker.replaceChildren(points.some(Boolean)
      ? picker({ points, names, contours, lit: this.picked, closed, onpick: (i) => this._toggle(i) })
      : h("p.muted.small", "The points are drawn here once three pictures are done."));
  }

  _drawList() {
    const row = (measure) => {
      const text = measureText(measure, this.tab.names);
      const remove = iconButton(`Remove ${text}`, "close", () => this._remove(measure), { small: true });
      return h("li.row", h("span.grow", text), remove);
    };
    this._list.replaceChildren(...this._measures.map(row));
  }
}
