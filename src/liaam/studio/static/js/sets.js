// Several sets of landmarks in a folder: which one the page shows, new ones, and the agreement between observers.

import { calledSet, percent, several } from "./annotate-words.js";
import { COLOURS, drawNames } from "./drawing.js";
import { numberText } from "./measures.js";
import { createLeftOut } from "./left-out.js";
import { discs, lines, stroked } from "./overlays.js";
import { distance } from "./points.js";
import { shapeFacts, shapeNote } from "./shape-agreement.js";
import { button, dialog, h, press, relist, saveFile, toast } from "./ui.js";

const NEW = "+"; // no name of a set
const APART = 12; // css pixels from which on a point of another observer is named
const SHOWN = 12; // rows of a table

/** Open the page of a set, with the same tab and picture. @param {App} app */
async function go(app, name) {
  await app.saved();
  location.assign(`${name ? `/set/${name}/` : "/"}${location.search}${location.hash}`);
}

/** The list beside the folder's name that shows and changes the set. @param {App} app; @returns {HTMLElement} */
export function createSetList(app) {
  const { state } = app;
  const list = h("select.text.set-list", {
    "aria-label": "Set of landmarks", title: "Sets of landmarks in this folder", testid: "sets",
    onchange: () => {
      const { value } = list;
      list.value = state.project.set; // until the other page opens, or if this one stays
      if (value === NEW) makeSet(app);
      else go(app, value);
    },
  });
  const show = () => {
    const { set, sets } = state.project;
    const labels = Object.fromEntries([...sets.map((name) => [name, calledSet(name)]), [NEW, "New set…"]]);
    list.hidden = sets.length < 2;
    relist(list, labels, set);
  };
  state.addEventListener("project", show);
  show();
  return list;
}

/** Ask for the name and the points of a new set, and open its page. @param {App} app */
export async function makeSet(app) {
  const { api, state } = app;
  const { template, set } = state.project;
  const choice = (value, title, what, more) => h("label.check.set-kind",
    h("input", { type: "radio", name: "set-kind", value, testid: `set-${value}`, ...more }),
    h("span", title, h("span.small.muted", what)));
  const name = h("input.text", {
    required: true, maxlength: "30", pattern: "[A-Za-z0-9][A-Za-z0-9_\\-]*", autocomplete: "off", spellcheck: "false",
    title: "Letters from A to Z, digits, - and _", placeholder: "such as hand, lateral or anna", testid: "set-name",
  });
  const same = `The points of ${set ? `the set ${set}` : "this set"}, placed again by somebody who does not see these.`;
  const body = h("div.column",
    h("label.field", "Name, also of the subfolder with its landmark files", name),
    choice("own", "Other points", "A template of its own, such as hand beside face. Not every picture needs both.", { checked: true }),
    choice("same", "The same points, another observer", same, { disabled: !template }));
  const work = async () => {
    /** @type {MakeSet} */
    const asked = { name: name.value, same: body.querySelector("input:checked").value === "same" };
    await state.send((folder) => api.post(api.url("sets"), { ...asked, folder }));
  };
  const make = { label: "Make the set", kind: "primary", value: "make", checks: true, work, testid: "set-make" };
  if ((await dialog("New set of landmarks", body, [{ label: "Cancel", value: null }, make])) === "make") go(app, name.value);
}

/** Indices of the points that two observers placed so far apart on the screen that one may ask which is which.
 *  @param {Point[]} own; @param {Point[]} others; @param {{toScreen: (point: any) => number[]}} viewer */
export const far = (own, others, viewer) => [...own.keys()].filter((i) =>
  own[i] && others[i] && distance(viewer.toScreen(own[i]), viewer.toScreen(others[i])) > APART);

/** The buttons that compare observers, for the review. @param {import("./annotate.js").Tab} tab */
export function createAgreement(tab) {
  const { app, state, viewer } = tab;
  let others = {}; // points of the open picture by set
  let asked = "";
  const toggle = button("Show the others", {
    small: true, pressed: false, testid: "show-others", onclick: (event) => tab.act(event, turn),
    title: "Show where other observers placed these points, once all of yours are placed",
  });
  const open = button("Agreement…", { small: true, testid: "agreement", onclick: () => showAgreement(app, onopen) });
  const element = h("div.row", open, toggle);
  const onopen = () => { press(toggle, true); follow(); }; // a picture in which observers are far apart
  const turn = () => { press(toggle, toggle.getAttribute("aria-pressed") === "false"); follow(); };

  /** Fetch the points of others whenever the picture or its points change. */
  async function follow() {
    const { current, project } = state;
    const picture = state.picture();
    element.hidden = project.observers.length < 2;
    toggle.disabled = picture?.state !== "done";
    const isOn = toggle.getAttribute("aria-pressed") === "true" && !toggle.disabled;
    const wanted = isOn ? `${current} ${picture.revision}` : "";
    if (wanted === asked) return;
    asked = wanted;
    const read = () => app.api.get(app.api.url("pictures/{name}/others", { name: current }), { quiet: true });
    const found = isOn ? await read().catch(() => ({})) : {};
    if (wanted !== asked) return;
    others = found;
    if (isOn && !Object.keys(others).length) toast("No other observer has placed all points of this picture yet.");
    viewer.redraw();
  }

  viewer.addLayer((ctx) => {
    if (tab.name !== state.current || tab.editing || !tab.marking.book) return;
    const { points: own } = tab.marking.state;
    const names = state.project.template?.names ?? [];
    for (const [set, points] of Object.entries(others)) {
      const apart = far(own, points, viewer);
      lines(ctx, apart.map((i) => [own[i], points[i]].map((point) => viewer.toScreen(point))));
      stroked(ctx, COLOURS.axis, 1.2);
      discs(ctx, viewer, points, 5);
      stroked(ctx, COLOURS.axis, 1.8);
      const whose = Object.keys(others).length > 1 ? ` (${calledSet(set)})` : "";
      drawNames(ctx, viewer, points, names.map((name) => `${name}${whose}`), apart);
    }
  });
  for (const event of ["project", "select"]) state.addEventListener(event, follow);
  follow();
  return element;
}

/** The pictures that the agreement of observers leaves out, and why: [{why, names}].
 *  @param {Pick<Picture, "name">[]} all; @param {Pick<Agreement, "pictures" | "unconfirmed" | "alone">} found */
export function notCompared(all, { pictures, unconfirmed, alone }) {
  const known = new Set([...pictures.map(([name]) => name), ...unconfirmed, ...Object.keys(alone)]);
  const by = [...new Set(Object.values(alone))].map((observer) => ({
    why: `are finished in ${calledSet(observer)} only`, names: Object.keys(alone).filter((name) => alone[name] === observer),
  }));
  return [
    { why: "have points that were accepted as they were proposed: move or confirm (Y) each of them", names: unconfirmed },
    ...by,
    { why: "are not finished by any observer", names: all.map(({ name }) => name).filter((name) => !known.has(name)) },
  ].filter(({ names }) => names.length);
}

/** Show how far observers are apart, and the pictures and points where most; onopen(): a picture was chosen there.
 *  @param {App} app; @param {() => void} onopen */
export async function showAgreement({ api, state }, onopen) {
  const found = await api.get(api.url("agreement"));
  const { observers, sd, percent: share, repeatability, points, pictures, file, table: text, shapes, pixel } = found;
  const inUnit = (value) => (pixel ? ` (${numberText(value * pixel.length, pixel.unit)})` : "");
  const pixels = (value) => `${value.toFixed(2)} px${inUnit(value)}`;
  const table = (title, head, rows) => h("section.agreement-table", h("h3", title), h("table",
    h("thead", h("tr", head.map((what) => h("th", { scope: "col" }, what)))), h("tbody", rows.slice(0, SHOWN))));
  const openPicture = (name) => (event) => { event.target.closest("dialog").close(); state.select(name); onopen(); };
  const without = createLeftOut((name) => { body.closest("dialog").close(); state.select(name); }, "agreement-left-out");
  const all = state.project.pictures;
  without.show(pictures.length === all.length ? `All ${several(all.length, "picture")} count.`
    : `Left out: ${several(all.length - pictures.length, "picture")} of ${all.length}`, notCompared(all, found));
  const pictureRow = ([name, value]) => h("tr", h("th", { scope: "row" },
    button(name, { small: true, kind: "ghost", testid: "agreement-picture", onclick: openPicture(name) })), h("td", pixels(value)));
  const pointRow = ([name, value, own]) =>
    h("tr", h("th", { scope: "row" }, name), h("td", pixels(value)), h("td", percent(own / 100)));
  const fact = (what, value, testid) => h("div", h("dt.small.muted", what), h("dd", { testid }, value));
  const body = h("div.column",
    h("p", `${several(pictures.length, "picture")} done by at least two of: ${observers.map(calledSet).join(", ")}.`), without.element,
    h("dl.agreement-facts",
      fact("Standard deviation of a point", pixels(sd), "agreement-sd"), fact("of the centroid size", percent(share / 100)),
      fact("Repeatability of the shape", repeatability === null ? "needs 2 pictures" : repeatability.toFixed(3))),
    shapes.map((each) => shapeFacts(each, calledSet)), shapes.length > 0 && shapeNote(),
    h("div.agreement-tables",
      table("Points, worst first", ["Point", "Deviation", "of size"], points.map(pointRow)),
      table("Pictures, worst first", ["Picture", "Deviation"], pictures.map(pictureRow))),
    h("p.small.muted", "Deviation: standard deviation of an observer from the mean of all. Repeatability: share of the variance of shapes that is between specimens, 1 if observers agree."));
  const save = { label: "Save the table", value: "save", testid: "agreement-save" };
  const close = { label: "Close", kind: "primary", value: null };
  if ((await dialog("Agreement of observers", body, [save, close], { wide: true })) === "save")
    saveFile(new Blob([text], { type: "text/csv" }), file);
}
