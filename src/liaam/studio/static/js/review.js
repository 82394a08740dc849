// Review of the open picture and of the folder: checks, history, accuracy of the models, and tables of all pictures.

import { percent, several } from "./annotate-words.js";
import { act, askName, whoAmI } from "./bulk.js";
import { createAgreement } from "./sets.js";
import { button, dialog, h, iconButton, listOf, menu, saveFile } from "./ui.js";

const DID = {
  placed: "placed points", accepted: "accepted proposed points", cleared: "removed all points", checked: "checked it", unchecked: "withdrew the check",
  "left out": "left it out of training", "taken in": "took it into training", discarded: "discarded proposed points",
  restored: "restored proposed points", deleted: "deleted the landmarks", undeleted: "restored the landmarks",
  scaled: "set the scale, with those of other pictures", unscaled: "took that scale back",
};
const EXPORTS = { pts: ".pts files (zip)", coco: "COCO keypoints", tps: "tpsDig (.tps)", csv: "Table (.csv)", sliders: "Sliders (.csv)", measure: "Measurements (.csv)…" };
const UNMEASURED = "It is measured on pictures that are held out from a training on four or more. In these, a person must " +
  "have placed, moved or confirmed (Y) at least half of the points: accepted ones would confirm the model that made them.";
export const sentence = ({ who, did }) => `${who || "Someone"} ${DID[did]}`;

export function accuracyText(versions) {
  const { held_out: count } = versions.at(-1);
  const others = versions.some(({ same }) => !same) ? " Pale bars: measured on other pictures." : "";
  const on = count === 1 ? "on 1 picture" : `median of ${count} pictures`;
  const what = "Distance of fitted points from those that a person placed, moved or confirmed, in percent of the object's size";
  return `${what}: ${on} held out from training.${others}`;
}

/** @param {import("./annotate.js").Tab} tab */
export function createReview(tab) {
  const { app, app: { state, api } } = tab;
  const part = (testid, title, content, ontoggle) =>
    h("details.small", { name: "review", ontoggle, testid }, h("summary", title), content);
  const now = h("span.small.muted.grow", { role: "status", testid: "review-state" });
  const toggle = () => act(app, state.picture().checked ? "unchecked" : "checked", [state.current]);
  const check = button("Mark as checked", {
    icon: "check", small: true, testid: "check", onclick: (event) => tab.act(event, toggle),
  });
  const entries = h("div");
  const history = part("history", "History", entries, () => fetchHistory());
  const chart = h("div");
  const accuracy = part("versions", "", chart);
  const name = button("", {
    small: true, kind: "ghost", title: "Your name in the history", onclick: () => askName(state.project).then(show),
  });
  const save = async (format) =>
    (format === "measure" ? measureAll(app) : saveFile(...(await api.file(api.url("export", format)))));
  const files = menu("Export all…", EXPORTS, save, {
    class: "small", "aria-label": "Export all landmarks", testid: "export-all",
  });
  const element = h("section.panel.review", { "aria-label": "Review" },
    h("div.row", now, check), history, accuracy, createAgreement(tab),
    h("div.row", files, h("span.grow"), name));

  async function fetchHistory() {
    const picture = state.current;
    if (!history.open || !picture) return;
    const lines = await api.get(api.url("pictures", picture, "history"), { quiet: true });
    if (picture !== state.current) return;
    const texts = lines.map((line) => `${sentence(line)}, ${new Date(line.time).toLocaleString()}`);
    entries.replaceChildren(listOf(texts.length ? texts : ["Nothing yet"]));
  }

  function draw({ versions, model }) {
    accuracy.hidden = !versions.length && model?.source !== "studio";
    if (!versions.length) {
      accuracy.firstChild.textContent = "Accuracy of the models: not measured yet";
      return chart.replaceChildren(h("p.muted", UNMEASURED));
    }
    const most = Math.max(...versions.map(({ error }) => error));
    const said = ({ error, pictures }) => `${percent(error)}, trained on ${pictures} pictures`;
    accuracy.firstChild.textContent = `Accuracy of the models: ${percent(versions.at(-1).error)}`;
    const bars = versions.map((version) => h("span", {
      class: version.same && "same", title: said(version), style: { height: `${(100 * version.error) / most}%` },
    }));
    const label = `Errors of the models: ${versions.map(said).join("; ")}`;
    return chart.replaceChildren(
      h("div.version-chart", { role: "img", "aria-label": label }, bars), h("p.muted", accuracyText(versions)));
  }

  function show() {
    const { checked, state: progress, unconfirmed } = /** @type {any} */ (state.picture() ?? {});
    element.hidden = !state.project.template;
    const seen = unconfirmed ? `${several(unconfirmed, "point")} not confirmed` : "Not checked yet";
    now.textContent = checked ? `Checked by ${checked}` : progress === "done" ? seen : "";
    now.title = unconfirmed ? "Accepted as proposed. Y confirms the selected point, for accuracy and agreement" : "";
    check.style.visibility = progress === "done" ? "" : "hidden"; // its place stays
    check.lastChild.textContent = checked ? "Withdraw" : "Mark as checked";
    name.textContent = whoAmI(state.project) || "Your name…";
    draw(state.project);
    fetchHistory().catch(() => {}); // the next change fetches it again
  }

  for (const event of ["project", "select"]) state.addEventListener(event, show);
  show();
  return element;
}

const KINDS = { 2: "distance", 3: "angle" }; // of so many selected points; more are an area
const measuresIn = (text) => text.split(/\s+/).filter(Boolean);

/** The measure of points with indices from 0, as liaam measure takes it. */
const measureOf = (indices) => `${KINDS[indices.length] ?? "area"}:${indices.map((i) => i + 1).join("-")}`;

/** A measure in words, with the names of its points; as it is if it names them in another way. */
export function measureText(measure, names) {
  const [kind, points = ""] = measure.split(":");
  const called = points.split("-").map((number) => names[Number(number) - 1]);
  return called.includes(undefined) ? measure : `${kind}: ${called.join(" – ")}`;
}

/** The measures that were saved last, with that of the selected points. */
export function measuresWith(known, chosen) {
  const all = [...measuresIn(known), ...(chosen.length > 1 ? [measureOf(chosen)] : [])];
  return all.length ? [...new Set(all)].join(" ") : measureOf([0, 1]);
}

/** Save a table of measures of all pictures. @param {App} app */
export async function measureAll({ api, state, selection }) {
  const { id, template } = state.project;
  const key = `liaam-studio:measures:${id}`;
  const [known = "", scaled = ""] = JSON.parse(localStorage.getItem(key) ?? "[]");
  const measures = h("input.text", {
    type: "text", testid: "measures", value: measuresWith(known, selection()), oninput: () => show(),
  });
  const list = h("ul.measure-list", { "aria-label": "Measures", testid: "measure-list" });
  const remove = (measure) => {
    measures.value = measuresIn(measures.value).filter((each) => each !== measure).join(" ");
    show();
  };
  const row = (measure, text) =>
    h("li.row", h("span.grow", text), iconButton(`Remove ${text}`, "trash", () => remove(measure), { small: true }));
  const show = () =>
    list.replaceChildren(...measuresIn(measures.value).map((each) => row(each, measureText(each, template.names))));
  show();
  const scale = h("input.text", { type: "text", testid: "measure-scale", value: scaled, placeholder: "in pixels" });
  const how = "Select points in the picture first (with Shift) to add their measure: two a distance, three an angle " +
    "at the second, four or more an area. In writing: distance:1-5 angle:1-2-3 area:1-2-3-4, with spaces between.";
  const body = h("div.column", list,
    h("label.field", "Measures of points, by number or name", measures), h("p.small.muted", how),
    h("label.field", "Scale: length of a pixel, or two points and the length between them, such as 11-12=5", scale));
  const save = { label: "Save the table", kind: "primary", value: "save", testid: "measure-save" };
  if ((await dialog("Measure all pictures", body, [{ label: "Cancel", value: null }, save])) !== "save") return;
  localStorage.setItem(key, JSON.stringify([measures.value, scale.value]));
  saveFile(...(await api.file(api.url("measurements", { measures: measures.value, scale: scale.value }))));
}
