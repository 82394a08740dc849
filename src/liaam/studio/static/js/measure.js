// The Measure tab: measures of all pictures as a table and a histogram, and the space of their shapes. It follows the
// points as they are placed.

import { several } from "./annotate-words.js";
import { createLeftOut, leftOut } from "./left-out.js";
import { MeasureBuilder } from "./measure-builder.js";
import { bins, decimalsOf, endsOf, measureText, numberText, summary } from "./measures.js";
import { plotFiles } from "./plot-files.js";
import { createShapeSpace } from "./shape-space.js";
import { groupMark, histogram } from "./shape-plots.js";
import { button, complaints, fileField, h, icon, menu, runKey, isPlain, saveFile, saveFiles, segmented } from "./ui.js";

const MOST_ROWS = 400; // of the table that is shown
const MOST_GROUPS = 8; // in the legend
const MEASURE_AFTER = 300; // milliseconds after a change
const VIEWS = [{ value: "measures", label: "Measures" }, { value: "shapes", label: "Shapes" }];
const GROUPED_BY = { "": "No groups", folder: "By subfolder", name: "By name", table: "By a table…" };
const EXPORTS = { csv: "Table (.csv)", only: "Measures only (.csv)", svg: "Plots (.svg)" };
const ABOUT_GROUPS =
  "By the letters in which names differ, such as male of male_07.jpg, or B of wing16_B.jpg; or by a table with the columns picture and group";
const NO_GROUPS = { name: "No groups: the names have no letters in which pictures differ", table: "No groups: the table names none of these pictures" };
const TABLE = "A .csv file with the columns picture and group, and a line for each picture, such as:";
const TABLE_LINES = "picture,group\n63001.jpg,female\n63002.jpg,male";
const MOST_NUMBERED = 12; // landmarks that are named with their numbers
const ABOUT_ESTIMATES =
  "By a thin-plate spline from the complete pictures; without, pictures that lack points have no shape";

export class Tab {
  shortcuts = [
    { keys: "Enter", what: "Open the chosen picture for annotation" },
    { keys: "M S", what: "Measures, shapes" },
  ];
  #visible = false;
  /** @type {Shapes | null} */
  #data = null;
  #space;
  #shownColumn = null; // name of the column that the histogram shows
  #order = { name: "", down: false }; // of the table: the name of a column, "group", or "" for the pictures'
  #isStale = true; // whether something has changed since the data were fetched
  #newest = 0; // number of the newest request; answers to earlier ones are ignored
  #timer = null;
  #complain = complaints(); // about tables of groups
  // Elements.
  #builder; #chart; #chosen; #content; #empty; #estimate; #fault; #groupList; #leftOut; #legend; #measures; #saveMenu; #table; #tableFile; #views;

  /** @param {HTMLElement} root; @param {App} app */
  constructor(root, app) {
    this.app = app;
    this.state = app.state;
    this.#space = createShapeSpace(this);
    this.#build(root);
    this.state.addEventListener("select", () => this.#draw());
    for (const event of ["project", "landmarks"]) this.state.addEventListener(event, () => this.#fetchSoon());
    this.state.addEventListener("measuring", () => this.#fetchSoon(0));
    window.liaamStudio.measure = { data: () => this.#data };
  }

  /** What the server has measured, or null. */
  get data() { return this.#data; }
  get names() { return this.state.project.template?.names ?? []; }
  get contours() { return this.state.project.template?.contours ?? []; }
  /** What is measured. */
  get measuring() { return this.state.project.measuring; }
  /** Index of the selected picture in the data; -1 if it has no landmarks. */
  get chosen() { return this.#data?.pictures.indexOf(this.state.current) ?? -1; }
  /** The groups' names in the order of their colours, and the group of each picture as an index; -1 for none. */
  get groups() {
    const names = [...new Set(this.#data.groups.filter(Boolean))].sort();
    return { names, of: this.#data.groups.map((group) => names.indexOf(group)) };
  }

  show() {
    this.#visible = true;
    if (this.#isStale) this.#fetch();
  }

  hide() {
    this.#visible = false;
    this.#builder.leave();
  }

  key(event) {
    return isPlain(event) && runKey(event, {
      enter: () => this.#open(), m: () => this.#showView("measures"), s: () => this.#showView("shapes"),
    });
  }

  /** Open the selected picture for annotation. */
  #open() { this.app.openTab("annotate"); }

  /** Select a picture of the data. */
  choose(index) {
    const name = this.#data.pictures[index];
    if (name) this.state.select(name);
  }

  /** Fetch once the changes pause, or when the tab is shown. */
  #fetchSoon(after = MEASURE_AFTER) {
    this.#isStale = true;
    clearTimeout(this.#timer);
    this.#timer = setTimeout(() => {
      if (this.#visible) this.#fetch();
    }, after);
  }

  /** Parameters of the requests for measures and shapes. @returns {ShapesQuery} */
  get #query() {
    const { measures, scale, by } = this.measuring;
    const estimate = this.#estimate.checked ? "1" : null;
    return { measures: measures.join(" ") || null, scale: scale || null, by: by || null, estimate };
  }

  async #fetch() {
    this.#isStale = false;
    this.#newest += 1;
    const request = this.#newest;
    const { api } = this.app;
    try {
      const data = await api.get(api.url("shapes", this.#query), { quiet: Boolean(this.#data) });
      if (request !== this.#newest) return;
      this.#data = data;
      this.#showFault("");
    } catch (error) {
      if (request !== this.#newest) return;
      const hasLandmarks = this.state.pictures.some(({ placed }) => placed);
      if (!hasLandmarks) this.#data = null; // else what was measured stays below the fault
      this.#showFault(error.message);
    }
    this.#draw();
  }

  /** Say what is wrong, and that the table is the earlier one; without data, the tab says what to do instead. */
  #showFault(text) {
    this.#fault.textContent = text && this.#data ? `${text.replace(/\.$/, "")}. Below is what was measured before.` : "";
    this.#fault.hidden = !this.#fault.textContent;
  }

  #showView(name) {
    this.#views.value = name; // "measures" or "shapes"
    this.#measures.hidden = name !== "measures";
    this.#space.show(name === "shapes");
    this.#draw();
  }

  #build(root) {
    this.#views = segmented("Measures or shapes", VIEWS, "measures", (name) => this.#showView(name), "measure-view");
    this.#fault = h("p.error-text.small", { role: "alert", hidden: true, testid: "measure-fault" });
    this.#builder = new MeasureBuilder(this);
    this.#chart = h("section.panel.measure-card", { "aria-label": "Histogram" });
    this.#table = h("div.measure-table", { tabindex: "0", role: "region", "aria-label": "Table of all pictures" });
    this.#measures = h("div.measure-view",
      h("div.measure-cards", this.#builder.element, h("div.measure-results", this.#chart, this.#table)));
    this.#space.show(false);
    this.#empty = h("div.empty.big", { hidden: true });
    this.#chosen = h("div.row.measure-chosen", { role: "status", testid: "measure-chosen" });
    this.#leftOut = createLeftOut((name) => this.state.select(name), "left-out");
    this.#content = h("div.measure-content.glass", this.#fault, this.#leftOut.element, this.#measures, this.#space.element);
    root.append(h("div.workspace.measure-tab", this.#toolbar(), this.#content, this.#empty, this.#chosen));
  }

  #toolbar() {
    const groupings = Object.entries(GROUPED_BY).map(([value, label]) => h("option", { value }, label));
    this.#groupList = h("select.text.measure-by", {
      "aria-label": "Groups", title: ABOUT_GROUPS, testid: "measure-by", onchange: () => this.#chooseGroups(this.#groupList.value),
    }, groupings);
    this.#groupList.value = this.measuring.by;
    this.#tableFile = fileField((file) => this.#takeTable(file), {
      accept: ".csv,text/csv", "aria-label": "Table of groups", testid: "measure-table-file",
    });
    this.#legend = h("span.row.tight.small", { testid: "measure-legend" });
    this.#estimate = h("input", { type: "checkbox", testid: "measure-estimate", onchange: () => this.#fetch() });
    const estimate = h("label.check.small", { title: ABOUT_ESTIMATES }, this.#estimate, "Estimate missing points");
    this.#saveMenu = menu("Save…", EXPORTS, (kind) => this.#save(kind), { "aria-label": "Save", testid: "measure-save" });
    return h("div.toolbar", { role: "toolbar", "aria-label": "Measure" },
      this.#views.element, this.#groupList, this.#tableFile, this.#legend, h("span.grow"), estimate, this.#saveMenu);
  }

  /** Group the pictures in another way. "By a table" asks for a file if there is none, or if it is chosen once more. */
  async #chooseGroups(by) {
    const now = this.measuring.by;
    const needsFile = by === "table" && (!this.#data?.has_table || now === "table");
    if (!needsFile) return this.#group(by);
    this.#groupList.value = now; // until a file is chosen
    const choose = { label: "Choose the file…", kind: "primary", value: true, testid: "measure-table-choose" };
    const body = h("div.column", h("p", TABLE), h("pre.small", TABLE_LINES));
    if (await this.app.ui.dialog("Groups by a table", body, [{ label: "Cancel", value: null }, choose])) this.#tableFile.click();
    return undefined;
  }

  async #group(by) {
    try {
      await this.state.changeMeasuring({ by });
    } finally {
      this.#groupList.value = this.measuring.by;
    }
    return this.#fetch();
  }

  async #takeTable(file) {
    const { api, toast } = this.app;
    const text = await file.text();
    const put = (folder) => api.put(api.url("groups"), { text, name: file.name, folder });
    const answer = await this.state.send(put).catch((error) => void this.#complain(error.message));
    if (!answer) return;
    this.#complain(""); // of an earlier table
    const { specimens } = answer;
    toast(`Groups of ${several(specimens, "specimen")} read.`, "good");
    await this.#group("table");
  }

  async #save(kind) {
    if (kind !== "svg") return this.#saveTable(kind === "only");
    const shown = this.#views.value === "shapes" ? this.#space.element : this.#measures;
    const name = `${this.state.project.folder}-${this.#views.value}`;
    saveFiles(plotFiles(shown).map((file, i) => [file, `${name}-${i + 1}.svg`]));
    return undefined;
  }

  /** only: without coordinates, scores and standard errors. */
  async #saveTable(only) {
    const { api } = this.app;
    const [blob, name] = await api.file(api.url("measurements", { ...this.#query, only: only ? "1" : null }));
    saveFile(blob, name);
  }

  #draw() {
    if (!this.#visible) return;
    const data = this.#data;
    this.#saveMenu.title = aboutSaved(this.names);
    this.#groupList.value = this.measuring.by; // another page may have changed it
    this.#content.hidden = !data;
    this.#empty.hidden = Boolean(data);
    this.#chosen.hidden = !data;
    if (!data) return this.#drawEmpty();
    this.#drawLegend();
    this.#drawChosen();
    this.#drawLeftOut(data);
    if (this.#views.value === "shapes") return this.#space.draw();
    this.#builder.draw();
    this.#drawChart();
    this.#drawTable();
  }

  #drawEmpty() {
    const go = button("Place landmarks", { kind: "primary", onclick: () => this.app.openTab("annotate") });
    this.#empty.replaceChildren(
      icon("ruler", 56),
      h("h2", "Measures and shapes of all pictures"),
      h("p", this.state.pictures.some(({ state }) => state === "proposed")
        ? "Proposed points are not measured: accept those of a picture, or correct them. Its measures are then here, and from three pictures on their shapes."
        : "Place the landmarks of a picture. Its measures are then here, and from three pictures on their shapes."),
      h("div.row", go));
  }

  /** Say how many pictures the figures are of, and which they leave out. @param {Shapes} data */
  #drawLeftOut(data) {
    const { pictures } = this.state.project;
    const ofShapes = this.#views.value === "shapes";
    const groups = leftOut(pictures, data, ofShapes);
    const used = ofShapes && data.space ? data.space.of.length : data.pictures.length;
    const estimated = data.estimated.filter((count) => count > 0).length;
    const ends = ofShapes ? endsOf(this.measuring.scale).map((i) => this.names[i]) : [];
    const what = ofShapes ? "Shapes" : "Measures";
    const without = ends.length ? `, without ${ends.join(" and ")}, the ends of the scale` : "";
    const some = used === pictures.length ? `all ${several(used, "picture")}` : `${used} of ${several(pictures.length, "picture")}`;
    this.#leftOut.show(`${what} of ${some}${without}${estimated ? `, ${estimated} of them with estimated points` : ""}` +
      `${groups.length ? `. ${missing(groups)}` : "."}`, groups);
  }

  #drawLegend() {
    const { names } = this.groups;
    const marks = names.slice(0, MOST_GROUPS).map((name, i) => h("span.row.tight", groupMark(i), name));
    const why = names.length ? "" : (NO_GROUPS[this.measuring.by] ?? "");
    if (why) return this.#legend.replaceChildren(h("span.muted", { title: why }, why));
    return this.#legend.replaceChildren(...marks, names.length > MOST_GROUPS ? `+ ${names.length - MOST_GROUPS}` : "");
  }

  #drawChosen() {
    const open = button("Open its points", { small: true, shortcut: "Enter", testid: "measure-open", onclick: () => this.#open() });
    this.#chosen.replaceChildren(h("strong", this.state.current ?? ""), h("span.muted.grow", this.#aboutChosen()), open);
  }

  #aboutChosen() {
    const { chosen } = this;
    if (chosen < 0) return this.state.picture()?.state === "proposed" ? "has proposed points only: accept them to measure it" : "has no landmarks yet";
    const { space } = this.#data;
    const shape = space ? space.of.indexOf(chosen) : -1;
    if (shape < 0) return space ? "has no shape, since points are missing" : "";
    const distance = space.distances[shape];
    return `Procrustes distance from the mean shape: ${numberText(distance)}${distance > space.limit ? ", unusual" : ""}`;
  }

  /** Title of a column for people. @param {Column} column */
  #title({ measure, called, unit }) {
    const text = called || (measure === null ? "Centroid size" : measureText(measure, this.names));
    return `${text}, ${unit}`;
  }

  /** The column that the histogram shows. */
  get #column() {
    const { columns } = this.#data;
    return columns.find(({ name }) => name === this.#shownColumn) ?? columns[0];
  }

  #drawChart() {
    const column = this.#column;
    const place = h("div.measure-plot");
    this.#chart.replaceChildren(
      h("h2.panel-title", this.#title(column)),
      h("p.small.muted", { testid: "measure-facts" }, summaryText(column)),
      this.#factsOfGroups(column),
      place);
    place.append(histogram(bins(column.values), {
      title: this.#title(column), lit: this.chosen, groups: this.groups.of, onbin: (indices) => this.#chooseNextOf(indices), width: place.clientWidth || undefined,
    }));
  }

  /** Number, mean, standard deviation and range of each group; "" without groups. @param {Column} column */
  #factsOfGroups(column) {
    const { names, of } = this.groups;
    const line = (name, k) => h("li", groupMark(k), ` ${name}: ${summaryText(column, column.values.filter((_, i) => of[i] === k))}`);
    const how = names.length > 2 ? "Alexander and Govern’s test" : "Welch’s t test";
    const test = column.p !== null && h("li", `Difference between the means: P ${column.p < 0.001 ? "< 0.001" : `= ${column.p.toFixed(3)}`} (${how})`);
    return names.length > 1 ? h("ul.measure-groups.small.muted", { testid: "measure-groups" }, names.slice(0, MOST_GROUPS).map(line), test) : "";
  }

  /** Select the picture of a bin that follows the selected one, or else its first. */
  #chooseNextOf(indices) {
    const position = indices.indexOf(this.chosen);
    this.choose(indices[(position + 1) % indices.length]);
  }

  /** Indices of the pictures in the order of the table. */
  #sorted() {
    const [data, order] = [this.#data, this.#order];
    const indices = data.pictures.map((_, i) => i);
    const values = this.#valuesFor(order.name);
    if (values) return indices.sort((i, j) => compared(values[i], values[j], order.down));
    return order.down ? indices.reverse() : indices;
  }

  /** What the table is sorted by; null for the order of the pictures. */
  #valuesFor(name) {
    if (name === "group") return this.#data.groups;
    return this.#data.columns.find((column) => column.name === name)?.values ?? null;
  }

  /** Sort by a column, and once more the other way round. The histogram shows it, if it has values. */
  #sort(name) {
    const isSorted = this.#order.name === name;
    this.#order = { name, down: isSorted && !this.#order.down };
    if (this.#data.columns.some((column) => column.name === name)) this.#shownColumn = name;
    this.#draw();
  }

  #drawTable() {
    const sorted = this.#sorted();
    const { groups } = this;
    const decimals = this.#data.columns.map(({ values }) => decimalsOf(values));
    const rows = sorted.slice(0, MOST_ROWS).map((i) => this.#row(i, groups, decimals));
    const table = h("table", { testid: "measure-table" }, h("thead", this.#headRow(groups)), h("tbody", rows));
    const more = sorted.length > MOST_ROWS
      ? h("p.small.muted", `${MOST_ROWS} of ${sorted.length} pictures. The saved table has all.`) : "";
    this.#table.replaceChildren(table, more);
  }

  #headRow(groups) {
    const group = groups.names.length > 0 && this.#head("group", "Group");
    const columns = this.#data.columns.map((column) => this.#head(column.name, this.#title(column)));
    return h("tr", this.#head("", "Picture"), group, columns);
  }

  #head(name, label) {
    const order = this.#order;
    const direction = order.down ? "descending" : "ascending";
    return h("th", { scope: "col", "aria-sort": order.name === name ? direction : null }, button(label, {
      kind: "ghost", small: true, pressed: name === this.#column.name || null, testid: `sort-${name || "picture"}`,
      onclick: () => this.#sort(name),
    }));
  }

  #row(i, groups, decimals) {
    const data = this.#data;
    const choose = () => this.choose(i);
    const estimated = data.estimated[i] > 0 && h("span.muted.small", ` ${data.estimated[i]} estimated`);
    const name = button(data.pictures[i], { kind: "ghost", small: true, onclick: choose });
    const group = groups.of[i];
    const groupCell = groups.names.length > 0 && h("td", group >= 0 && groupMark(group), " ", data.groups[i]);
    return h("tr", { class: i === this.chosen && "chosen", "data-index": String(i), onclick: choose, ondblclick: () => this.#open() },
      h("th", { scope: "row" }, name, estimated),
      groupCell,
      data.columns.map(({ values, unit }, c) => (values[i] === null
        ? h("td.number.muted.small", data.unscaled.includes(i) && unit !== "°" ? "no scale" : "no point") : h("td.number", numberText(values[i], "", decimals[c])))));
  }
}

/** What the saved table has, with the landmarks of its numbered columns. @param {string[]} names */
function aboutSaved(names) {
  const numbered = names.slice(0, MOST_NUMBERED).map((name, i) => (name === String(i + 1) ? name : `${i + 1} ${name}`)).join(", ");
  return "The table has the columns of “liaam measure”. Names without a unit are in pixels. X1, Y1 and so on are coordinates after " +
    `Procrustes superimposition, not positions in pictures, of the points ${numbered}${names.length > MOST_NUMBERED ? " and so on" : ""}.`;
}

/** Order of two values, rising or falling (down); those that are missing come last either way. */
function compared(a, b, down) {
  if (a === b) return 0;
  if (a === null) return 1;
  if (b === null) return -1;
  return a < b === down ? 1 : -1;
}

/** How many pictures are left out, or lack a scale only. */
function missing(groups) {
  const count = (some) => some.reduce((sum, { names }) => sum + names.length, 0);
  const [unscaled, others] = [true, false].map((is) => count(groups.filter(({ lacksScale = false }) => lacksScale === is)));
  return [others && `Missing: ${several(others, "picture")}`, unscaled && `Without a scale: ${several(unscaled, "picture")}`]
    .filter(Boolean).join(". ");
}

/** Number, mean, standard deviation and range of a column in words, and of some of its values as of all. @param {Column} column */
function summaryText({ values, unit }, some = values) {
  const { n, mean, sd, least, most } = summary(some);
  if (!n) return "No picture has all points of this measure, or a scale.";
  const decimals = decimalsOf(values);
  const spread = sd === null ? "" : ` ± ${numberText(sd, "", decimals)} (standard deviation)`;
  return `${several(n, "picture")}: ${numberText(mean, unit, decimals)}${spread}, ` +
    `${numberText(least, "", decimals)} to ${numberText(most, "", decimals)}`;
}
