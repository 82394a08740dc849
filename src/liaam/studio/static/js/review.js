// Review of the open picture and of the folder: checks, history, accuracy of the models, and tables of all pictures.

import { percent, several } from "./annotate-words.js";
import { act, askName, whoAmI } from "./bulk.js";
import { createAgreement } from "./sets.js";
import { button, dialog, h, listOf, menu, saveFile } from "./ui.js";

const DID = {
  placed: "placed points", accepted: "accepted proposed points", cleared: "removed all points", checked: "checked it", unchecked: "withdrew the check",
  "left out": "left it out of training", "taken in": "took it into training", discarded: "discarded proposed points",
  restored: "restored proposed points", deleted: "deleted the landmarks", undeleted: "restored the landmarks",
  scaled: "set the scale, with those of other pictures", unscaled: "took that scale back",
};
const EXPORTS = { pts: ".pts files (zip)", coco: "COCO keypoints", tps: "tpsDig (.tps)", csv: "Table (.csv)", sliders: "Sliders (.csv)", measure: "Measurements (.csv)…" };
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
    small: true, kind: "ghost", title: "Your name in the history", onclick: () => askName().then(show),
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

  function draw(versions) {
    accuracy.hidden = !versions.length;
    if (!versions.length) return;
    const most = Math.max(...versions.map(({ error }) => error));
    const said = ({ error, pictures }) => `${percent(error)}, trained on ${pictures} pictures`;
    accuracy.firstChild.textContent = `Accuracy of the models: ${percent(versions.at(-1).error)}`;
    const bars = versions.map((version) => h("span", {
      class: version.same && "same", title: said(version), style: { height: `${(100 * version.error) / most}%` },
    }));
    const label = `Errors of the models: ${versions.map(said).join("; ")}`;
    chart.replaceChildren(
      h("div.version-chart", { role: "img", "aria-label": label }, bars), h("p.muted", accuracyText(versions)));
  }

  function show() {
    const { checked, state: progress, unconfirmed } = /** @type {any} */ (state.picture() ?? {});
    element.hidden = !state.project.template;
    const seen = unconfirmed ? `${several(unconfirmed, "point")} not confirmed` : "Not checked yet";
    now.textContent = checked ? `Checked by ${checked}` : progress === "done" ? seen : "";
    now.title = unconfirmed ? "Accepted as proposed. Y confirms the selected point, for accuracy and agreement" : "";
    check.hidden = progress !== "done";
    check.lastChild.textContent = checked ? "Withdraw" : "Mark as checked";
    name.textContent = whoAmI() || "Your name…";
    draw(state.project.versions);
    fetchHistory().catch(() => {}); // the next change fetches it again
  }

  for (const event of ["project", "select"]) state.addEventListener(event, show);
  show();
  return element;
}

const KINDS = { 2: "distance", 3: "angle" }; // of so many selected points; more are an area

/** The measure of points with indices from 0, as liaam measure takes it. */
const measureOf = (indices) => `${KINDS[indices.length] ?? "area"}:${indices.map((i) => i + 1).join("-")}`;

export async function measureAll({ api, state, selection }) {
  const key = `liaam-studio:measures:${state.project.id}`;
  const [known = "", scaled = ""] = JSON.parse(localStorage.getItem(key) ?? "[]");
  const chosen = selection();
  const value = known || measureOf(chosen.length > 1 ? chosen : [0, 1]);
  const measures = h("input.text", { type: "text", testid: "measures", value });
  const scale = h("input.text", { type: "text", testid: "measure-scale", value: scaled, placeholder: "in pixels" });
  const body = h("div.column",
    h("label.field", "Measures of points, by number or name", measures),
    h("p.small.muted", "distance:1-5 angle:1-2-3 (at point 2) area:1-2-3-4, with spaces between."),
    h("label.field", "Scale: length of a pixel, or two points and the length between them, such as 11-12=5", scale));
  const save = { label: "Save the table", kind: "primary", value: "save", testid: "measure-save" };
  if ((await dialog("Measure all pictures", body, [{ label: "Cancel", value: null }, save])) !== "save") return;
  localStorage.setItem(key, JSON.stringify([measures.value, scale.value]));
  saveFile(...(await api.file(api.url("measurements", { measures: measures.value, scale: scale.value }))));
}
