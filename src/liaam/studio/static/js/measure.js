// The Measure tab: measures of all pictures as a table and a histogram, and the space of their shapes. It follows the
// points as they are placed.

import { several } from "./annotate-words.js";
import { bins, joined, keepWanted, KINDS, measured, measureOf, measuresIn, measureText, numberText, summary, wantedIn } from "./measures.js";
import { createShapeSpace } from "./shape-space.js";
import { groupMark, histogram, picker } from "./shape-plots.js";
import { button, fileField, h, icon, iconButton, menu, runKey, isPlain, saveFile, segmented } from "./ui.js";
import { attempt } from "./unsaved.js";

const ROWS = 400; // rows of the table that are shown
const AGAIN = 300; // milliseconds after a change until all is measured again
const BY = { "": "No groups", folder: "By subfolder", name: "By name", table: "By a table…" };
const EXPORTS = { csv: "Table (.csv)", svg: "Plots (.svg)" };
const NAMES = "By the letters with which names begin, such as male of male_07.jpg; or by a table with the columns specimen and group";

export class Tab {
  shortcuts = [
    { keys: "Enter", what: "Open the chosen picture for annotation" },
    { keys: "M S", what: "Measures, shapes" },
  ];
  visible = false;
  /** @type {Shapes | null} */
  data = null;
  picked = []; // indices of the points of the measure that is being made, in order
  column = null; // name of the column that the histogram shows
  order = { name: "", down: false }; // of the table
  _asked = 0;
  _timer = null;
  _stale = true;

  /** @param {HTMLElement} root; @param {App} app */
  constructor(root, app) {
    this.app = app;
    this.state = app.state;
    const { id } = this.state.project;
    this._key = `liaam-studio:measure-view:${id}`;
    this.by = attempt(() => JSON.parse(localStorage.getItem(this._key)).by) ?? "";
    this.space = createShapeSpace(this);
    this._build(root);
    this.state.addEventListener("select", () => this._draw());
    for (const event of ["project", "landmarks"]) this.state.addEventListener(event, () => this._soon());
    measured.addEventListener("change", () => this._soon(0));
    window.liaamStudio.measure = { data: () => this.data, space: this.space, tab: this };
  }

  get names() { return this.state.project.template?.names ?? []; }
  get contours() { return this.state.project.template?.contours ?? []; }
  get wanted() { return wantedIn(this.state.project.id); }
  /** Index of the selected picture in the data; -1 if it has no landmarks. */
  get chosen() { return this.data?.pictures.indexOf(this.state.current) ?? -1; }
  /** The groups' names in the order of their colours, and the group of each picture as an index; -1 for none. */
  get groups() {
    const names = [...new Set(this.data.groups.filter(Boolean))].sort();
    return { names, of: this.data.groups.map((group) => names.indexOf(group)) };
  }

  show() {
    this.visible = true;
    if (this._stale) this._fetch();
  }

  hide() { this.visible = false; }

  key(event) {
    const view = (name) => () => this._view(name);
    return isPlain(event) && runKey(event, { enter: () => this.open(), m: view("measures"), s: view("shapes") });
  }

  /** Open the selected picture for annotation. */
  open() { this.app.openTab("annotate"); }

  /** Select a picture of the data. */
  choose(index) {
    const name = this.data.pictures[index];
    if (name) this.state.select(name);
  }

  _soon(after = AGAIN) {
    this._stale = true;
    clearTimeout(this._timer);
    this._timer = setTimeout(() => this.visible && this._fetch(), after);
  }

  get query() {
    const { measures, scale } = this.wanted;
    return { measures: measures || null, scale: scale || null, by: this.by || null, estimate: this.estimate.checked ? "1" : null };
  }

  async _fetch() {
    this._stale = false;
    const asked = ++this._asked;
    const { api } = this.app;
    try {
      const data = await api.get(api.url("shapes", this.query), { quiet: Boolean(this.data) });
      if (asked !== this._asked) return;
      this.data = data;
      this._say("");
    } catch (error) {
      if (asked !== this._asked) return;
      if (!this.state.pictures.some(({ placed }) => placed)) this.data = null;
      this._say(error.message);
    }
    this._draw();
  }

  _say(text) {
    this._fault.textContent = text;
    this._fault.hidden = !text || !this.data;
  }

  _view(name) {
    this.views.value = name;
    this._measures.hidden = name !== "measures";
    this.space.element.hidden = name !== "shapes";
    this._draw();
  }

  _build(root) {
    this.views = segmented("Measures or shapes", [{ value: "measures", label: "Measures" }, { value: "shapes", label: "Shapes" }],
      "measures", (name) => this._view(name), "measure-view");
    this.groupList = h("select.text.measure-by", {
      "aria-label": "Groups", title: NAMES, testid: "measure-by", onchange: () => this._group(this.groupList.value),
    }, Object.entries(BY).map(([value, label]) => h("option", { value }, label)));
    this.groupList.value = this.by;
    this._file = fileField((file) => this._takeTable(file), { accept: ".csv,text/csv", "aria-label": "Table of groups", testid: "measure-table-file" });
    this.estimate = h("input", { type: "checkbox", testid: "measure-estimate", onchange: () => this._fetch() });
    const estimate = h("label.check.small", { title: "By a thin-plate spline from the complete pictures; without, pictures that lack points have no shape" },
      this.estimate, "Estimate missing points");
    const save = menu("Save…", EXPORTS, (kind) => this._save(kind), { "aria-label": "Save", testid: "measure-save" });
    this._legend = h("span.row.tight.small", { testid: "measure-legend" });
    this._fault = h("p.error-text.small", { role: "alert", hidden: true, testid: "measure-fault" });
    this._builder = h("section.panel.measure-card", { "aria-label": "New measure" });
    this._chart = h("section.panel.measure-card", { "aria-label": "Histogram" });
    this._table = h("div.measure-table", { tabindex: "0", role: "region", "aria-label": "Table of all pictures" });
    this._measures = h("div.measure-view", h("div.measure-cards", this._builder, h("div.measure-results", this._chart, this._table)));
    this.space.element.hidden = true;
    this._empty = h("div.empty.big", { hidden: true });
    this._chosen = h("div.row.measure-chosen", { role: "status", testid: "measure-chosen" });
    this._content = h("div.measure-content.glass", this._fault, this._measures, this.space.element);
    root.append(h("div.workspace.measure-tab",
      h("div.toolbar", { role: "toolbar", "aria-label": "Measure" }, this.views.element, this.groupList, this._file, this._legend,
        h("span.grow"), estimate, save),
      this._content, this._empty, this._chosen));
    this._buildBuilder();
  }

  _buildBuilder() {
    const kinds = Object.entries(KINDS).map(([value, { label }]) => ({ value, label }));
    this.kind = segmented("Kind of measure", kinds, "distance", () => this._pick([]), "measure-kind");
    this._picker = h("div.measure-plot");
    this._hint = h("p.small.muted", { role: "status" });
    this._list = h("ul.measure-list", { "aria-label": "Measures", testid: "measure-list" });
    this._scale = h("input.text", {
      type: "text", placeholder: "of each picture, or in pixels", testid: "measure-scale", value: this.wanted.scale,
      onchange: () => keepWanted(this.state.project.id, { ...this.wanted, scale: this._scale.value.trim() }),
    });
    this._add = button("Add", { kind: "primary", small: true, testid: "measure-add", onclick: () => this._addPicked() });
    this._builder.append(h("h2.panel-title", "Measures"), h("div.row", this.kind.element, h("span.grow"), this._add), this._picker, this._hint, this._list,
      h("label.field", "Scale, if the pictures have none: length of a pixel, or two points and the length between them, such as 11-12=5 mm", this._scale));
  }

  _pick(indices) {
    this.picked = indices;
    this._drawBuilder();
  }

  _toggle(index) {
    const { most } = KINDS[this.kind.value];
    const without = this.picked.filter((i) => i !== index);
    const next = without.length < this.picked.length ? without : [...this.picked, index].slice(-most);
    this._pick(next);
    this._picker.querySelector(`[data-index="${index}"]`)?.focus();
    if (next.length === most) this._addPicked();
  }

  _addPicked() {
    if (this.picked.length < KINDS[this.kind.value].fewest) return;
    this._keep([...measuresIn(this.wanted.measures), measureOf(this.kind.value, this.picked)]);
    this._pick([]);
  }

  _keep(list) { keepWanted(this.state.project.id, { ...this.wanted, measures: joined(list) }); }

  /** Where points are drawn to be clicked: the mean shape, the template, or the open picture's points. */
  _layout() {
    const { template } = this.state.project;
    const { space } = this.data ?? {};
    if (space && space.landmarks.length === this.names.length) return space.mean;
    return template?.points ?? window.liaamStudio.annotate?.points() ?? [];
  }

  _drawBuilder() {
    const { names, contours, picked } = this;
    const { fewest, most } = KINDS[this.kind.value];
    const points = this._layout();
    this._picker.replaceChildren(points.some(Boolean)
      ? picker({ points, names, contours, lit: picked, closed: this.kind.value === "area", onpick: (i) => this._toggle(i) })
      : h("p.muted.small", "The points are drawn here once three pictures are done."));
    this._add.disabled = picked.length < fewest;
    const left = Math.max(0, fewest - picked.length);
    this._hint.textContent = picked.length ? picked.map((i) => names[i]).join(" – ")
      : `Click ${fewest === most ? fewest : `${fewest} or more`} points${this.kind.value === "angle" ? "; the angle is at the second" : ""}.`;
    if (picked.length && left) this._hint.textContent += `: ${left} more`;
    const remove = (measure) => this._keep(measuresIn(this.wanted.measures).filter((each) => each !== measure));
    this._list.replaceChildren(...measuresIn(this.wanted.measures).map((each) => {
      const words = measureText(each, names);
      return h("li.row", h("span.grow", words), iconButton(`Remove ${words}`, "close", () => remove(each), { small: true }));
    }));
  }

  async _group(by) {
    if (by === "table" && (!this.data?.has_table || this.by === "table")) {
      this.groupList.value = this.by;
      return this._file.click();
    }
    this.by = by;
    attempt(() => localStorage.setItem(this._key, JSON.stringify({ by })));
    return this._fetch();
  }

  async _takeTable(file) {
    const { api, toast } = this.app;
    const text = await file.text();
    const { specimens } = await this.state.send((folder) => api.put(api.url("groups"), { text, name: file.name, folder }));
    toast(`Groups of ${several(specimens, "specimen")} read.`, "good");
    this.by = "";
    this.data = { ...this.data, has_table: true };
    this.groupList.value = "table";
    await this._group("table");
  }

  async _save(kind) {
    const { api } = this.app;
    if (kind === "csv") return saveFile(...(await api.file(api.url("measurements", this.query))));
    const style = [".shape-plot { color: #444; background: #fff; }", ...[...document.styleSheets].flatMap((sheet) => attempt(() => [...sheet.cssRules]) ?? [])
      .map(({ cssText }) => cssText).filter((rule) => rule.startsWith(".plot-") || rule.startsWith(".shape-plot"))].join("\n");
    const colours = getComputedStyle(document.documentElement);
    const plain = style.replace(/var\((--[a-z-]+)\)/g, (_, name) => colours.getPropertyValue(name));
    const shown = this.views.value === "shapes" ? this.space.element : this._measures;
    for (const [number, plot] of [...shown.querySelectorAll("svg.shape-plot")].filter((one) => !one.querySelector(".plot-pick")).entries()) {
      const copy = /** @type {SVGElement} */ (plot.cloneNode(true));
      const sheet = document.createElementNS("http://www.w3.org/2000/svg", "style");
      sheet.textContent = plain;
      copy.prepend(sheet);
      const text = new XMLSerializer().serializeToString(copy);
      saveFile(new Blob([text], { type: "image/svg+xml" }), `${this.state.project.folder}-${this.views.value}-${number + 1}.svg`);
    }
    return undefined;
  }

  _draw() {
    if (!this.visible) return;
    const { data } = this;
    this._content.hidden = !data;
    this._empty.hidden = Boolean(data);
    this._chosen.hidden = !data;
    if (!data) {
      const go = button("Place landmarks", { kind: "primary", onclick: () => this.app.openTab("annotate") });
      this._empty.replaceChildren(icon("ruler", 56), h("h2", "Measures and shapes of all pictures"),
        h("p", "Place the landmarks of a picture. Its measures are then here, and from three pictures on their shapes."), h("div.row", go));
      return;
    }
    const { names } = this.groups;
    this._legend.replaceChildren(...names.slice(0, 8).map((name, i) => h("span.row.tight", groupMark(i), name)), names.length > 8 ? `+ ${names.length - 8}` : "");
    this._drawChosen();
    if (this.views.value === "shapes") return void this.space.draw();
    this._drawBuilder();
    this._drawChart();
    this._drawTable();
  }

  _drawChosen() {
    const { chosen, data, state } = this;
    const at = data.space?.of.indexOf(chosen) ?? -1;
    const facts = at < 0 ? "" : `${numberText(data.space.distances[at])} from the mean shape${data.space.distances[at] > data.space.limit ? ", unusual" : ""}`;
    const open = button("Open its points", { small: true, shortcut: "Enter", testid: "measure-open", onclick: () => this.open() });
    this._chosen.replaceChildren(h("strong", state.current ?? ""),
      h("span.muted.grow", chosen < 0 ? "has no landmarks yet" : facts), open);
  }

  /** Title of a column for people. */
  title({ measure, unit }) { return `${measure === null ? "Centroid size" : measureText(measure, this.names)}, ${unit}`; }

  get _column() {
    const { columns } = this.data;
    return columns.find(({ name }) => name === this.column) ?? columns[0];
  }

  _drawChart() {
    const column = this._column;
    const { n, mean, sd, least, most } = summary(column.values);
    const facts = n ? `${several(n, "picture")}: ${numberText(mean, column.unit)}${sd === null ? "" : ` ± ${numberText(sd)} (standard deviation)`}, ` +
      `${numberText(least)} to ${numberText(most)}` : "No picture has all points of this measure, or a scale.";
    this._chart.replaceChildren(h("h2.panel-title", this.title(column)), h("p.small.muted", { testid: "measure-facts" }, facts),
      h("div.measure-plot", histogram(bins(column.values), { title: this.title(column), lit: this.chosen, onbin: (of) => this._next(of) })));
  }

  /** Select the next picture of a bin after the selected one. */
  _next(of) { this.choose(of[(of.indexOf(this.chosen) + 1) % of.length]); }

  _sorted() {
    const { data, order } = this;
    const column = data.columns.find(({ name }) => name === order.name);
    const value = column ? (i) => column.values[i] : order.name === "group" ? (i) => data.groups[i] : (i) => i;
    const rank = (a, b) => (a === null ? 1 : b === null ? -1 : a < b ? -1 : a > b ? 1 : 0);
    const indices = data.pictures.map((_, i) => i).sort((i, j) => rank(value(i), value(j)));
    return order.down ? indices.reverse() : indices;
  }

  _sort(name) {
    this.order = { name, down: this.order.name === name && !this.order.down };
    this.column = this.data.columns.some((column) => column.name === name) ? name : this.column;
    this._draw();
  }

  _drawTable() {
    const { data, order, chosen } = this;
    const grouped = this.groups.names.length > 0;
    const head = (name, label) => h("th", { scope: "col", "aria-sort": order.name !== name ? null : order.down ? "descending" : "ascending" },
      button(label, { kind: "ghost", small: true, pressed: name === this._column.name || null, testid: `sort-${name || "picture"}`, onclick: () => this._sort(name) }));
    const sorted = this._sorted();
    const shown = sorted.slice(0, ROWS);
    const group = (i) => h("td", this.groups.of[i] >= 0 && groupMark(this.groups.of[i]), " ", data.groups[i]);
    const estimated = (i) => (data.estimated[i] ? h("span.muted.small", ` ${data.estimated[i]} estimated`) : null);
    const row = (i) => h("tr", { class: i === chosen && "chosen", "data-index": String(i), onclick: () => this.choose(i), ondblclick: () => this.open() },
      h("th", { scope: "row" }, button(data.pictures[i], { kind: "ghost", small: true, onclick: () => this.choose(i) }), estimated(i)),
      grouped && group(i), data.columns.map(({ values }) => h("td.number", numberText(values[i]))));
    this._table.replaceChildren(h("table", { testid: "measure-table" },
      h("thead", h("tr", head("", "Picture"), grouped && head("group", "Group"), data.columns.map((column) => head(column.name, this.title(column))))),
      h("tbody", shown.map(row))),
    sorted.length > ROWS && h("p.small.muted", `${ROWS} of ${sorted.length} pictures. The saved table has all.`));
  }
}
