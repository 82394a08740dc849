// Review of the open picture and of the folder: checks, history, accuracy of the models, and tables of all pictures.

import { percent, several } from "./annotate-words.js";
import { act, askName, some, whoAmI } from "./bulk.js";
import { pictureLinks } from "./left-out.js";
import { createAgreement } from "./sets.js";
import { showModelAgreement } from "./shape-agreement.js";
import { STATES } from "./strip-filters.js";
import { button, h, listOf, menu, saveFile } from "./ui.js";

const DID = {
  placed: "placed points", accepted: "accepted proposed points", cleared: "removed all points", checked: "checked it", unchecked: "withdrew the check",
  "left out": "left it out of training", "taken in": "took it into training", discarded: "discarded proposed points",
  restored: "restored proposed points", deleted: "deleted the landmarks", undeleted: "restored the landmarks",
  scaled: "set the scale, with those of other pictures", unscaled: "took that scale back",
};
const EXPORTS = { pts: ".pts files (zip)", coco: "COCO keypoints", tps: "tpsDig (.tps)", csv: "Table (.csv)", sliders: "Sliders (.csv)", measure: "Measurements (opens Measure)", model: "Model (.liaam)" };
const IN_OTHERS = "The .csv and .tps files say which is which";
const ABOUT_SIDES = { pts: IN_OTHERS, coco: IN_OTHERS, csv: "Its column side says which is which", tps: "A comment of each record says which is which" };
const UNMEASURED = "It is measured on pictures that a training on four or more keeps for testing. In these, a person must " +
  "have placed, moved or confirmed (Y) at least half of the points: accepted ones would confirm the model that made them.";
export const sentence = (/** @type {HistoryEntry} */ { who, did }) => `${who || "Someone"} ${DID[did]}`;

/** Whether a fit counts; otherwise all have failed, and said so. @param {Version} version */
const isMeasured = ({ held_out: count, failed }) => failed.length < count;

/** The error of a model, and of how many pictures it is the median. @param {Version} version */
export function errorText({ error, held_out: count, failed }) {
  const used = count - failed.length;
  if (!used) return `not measured, since ${count === 1 ? "the fit to the picture" : `the fits to all ${count} pictures`} kept for testing failed`;
  const median = used === 1 ? "1 picture" : `median of ${used} pictures`;
  const not = failed.length && `${some(failed)} not counted, since the ${failed.length === 1 ? "fit" : "fits"} failed`;
  return `${percent(error)}, ${median}${not ? `; ${not}` : ""}`;
}

/** What the errors of models are. @param {Version[]} versions */
export function accuracyText(versions) {
  const { held_out: count } = versions.at(-1);
  const others = versions.some(({ same }) => !same) ? " Pale bars: measured on other pictures." : "";
  const what = "Distance of fitted points from those that a person placed, moved or confirmed, in percent of the object's size: " +
    `the smaller, the better. Measured on ${several(count, "picture")} kept for testing, on which that model was not trained.`;
  const few = count < 8 ? ` ${count === 1 ? "One picture says" : `${count} pictures say`} little; from 32 such pictures on, it is measured on 8.` : "";
  return `${what}${few}${others}`;
}

/** {element, exportAll(): open the list of formats}. @param {import("./annotate.js").Tab} tab */
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
    small: true, kind: "ghost", title: "Your name in the history", onclick: () => askName(app).then(show),
  });
  const save = async (format) => {
    if (format === "measure") return app.openTab("measure");
    if (format === "model") return saveFile(...(await api.file(api.url("model/file"))));
    const { file: [blob, name], hasBothSides } = await api.landmarks(format);
    return saveFile(blob, name, hasBothSides ? `. Specimens of both sides are saved as they lie in the pictures, none reflected. ${ABOUT_SIDES[format]}` : "");
  };
  const files = menu("Export all…", EXPORTS, save, {
    class: "small", "aria-label": "Export all landmarks", testid: "export-all",
  });
  const element = h("section.panel.review", { "aria-label": "Review" },
    h("div.row", now, check), h("div.review-more", history, accuracy, createAgreement(tab)),
    h("div.row", files, h("span.grow"), name));

  async function fetchHistory() {
    const picture = state.current;
    if (!history.open || !picture) return;
    const lines = await api.get(api.url("pictures/{name}/history", { name: picture }), { quiet: true });
    if (picture !== state.current) return;
    const texts = lines.map((line) => `${sentence(line)}, ${new Date(line.time).toLocaleString()}`);
    entries.replaceChildren(listOf(texts.length ? texts : ["Nothing yet"]));
  }

  /** @param {Project} project */
  function draw({ versions, model }) {
    accuracy.hidden = !versions.length && model?.source !== "studio";
    if (!versions.length) {
      accuracy.firstChild.textContent = "Error of the models: not measured yet";
      return chart.replaceChildren(h("p.muted", UNMEASURED));
    }
    const most = Math.max(...versions.filter(isMeasured).map(({ error }) => error));
    const said = (version) => `${errorText(version)}, trained on ${version.pictures} pictures`;
    const { error, held_out: held, failed } = versions.at(-1);
    const fits = `${failed.length ? `${held - failed.length} of ${held}` : several(held, "picture")}`;
    accuracy.firstChild.textContent = isMeasured(versions.at(-1)) ? `Error of the models: ${percent(error)} (${fits})`
      : `Error of the models: not measured, ${failed.length === 1 ? "the fit" : `all ${failed.length} fits`} failed`;
    accuracy.firstChild.title = errorText(versions.at(-1));
    const bars = versions.map((version) => h("span", {
      class: version.same && "same", title: said(version), style: { height: isMeasured(version) ? `${(100 * version.error) / most}%` : "0" },
    }));
    const lost = failed.length > 0 && h("p.muted", { testid: "not-counted" }, "Not counted, since the fit failed and said so: ",
      pictureLinks(failed, (picture) => state.select(picture), "fit-failed"));
    const label = `Errors of the models: ${versions.map(said).join("; ")}`;
    const shapes = button("Shapes for statistics…", {
      small: true, kind: "ghost", testid: "model-agreement", onclick: () => showModelAgreement(app),
      title: "Slope, variance ratio and intraclass correlation of the model's shapes in pictures kept for testing",
    });
    return chart.replaceChildren(h("div",
      h("div.version-chart", { role: "img", "aria-label": label }, bars), h("p.muted", accuracyText(versions)), lost, shapes));
  }

  function show() {
    const { checked, state: progress, unconfirmed } = /** @type {Partial<Picture>} */ (state.picture() ?? {});
    element.hidden = !state.project.template;
    const seen = unconfirmed ? `${unconfirmed} unconfirmed` : "Not checked yet";
    now.textContent = checked ? `Checked by ${checked}` : progress === "done" ? seen : "";
    now.title = unconfirmed ? "Points that were accepted together with others. Y confirms the selected point, for accuracy and agreement" : STATES.checked.about;
    check.style.visibility = progress === "done" ? "" : "hidden"; // its place stays
    check.lastChild.textContent = checked ? "Withdraw" : "Mark as checked";
    name.textContent = whoAmI(state.project) || "Your name…";
    draw(state.project);
    fetchHistory().catch(() => {}); // the next change fetches it again
  }

  for (const event of ["project", "select"]) state.addEventListener(event, show);
  show();
  return { element, exportAll: () => files.showPicker() };
}
