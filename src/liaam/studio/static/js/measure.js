// Measurements of all pictures with landmarks, as a table.

import { dialog, h, saveFile, toast } from "./ui.js";

const KINDS = { 2: "distance", 3: "angle" }; // of so many selected points; more are an area

/** The measure of points with indices from 0, as liaam measure takes it. */
const measureOf = (indices) => `${KINDS[indices.length] ?? "area"}:${indices.map((i) => i + 1).join("-")}`;

/** Ask what to measure, and save the table. */
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
  const actions = [{ label: "Cancel", value: null }, { label: "Save the table", kind: "primary", value: "save", testid: "measure-save" }];
  if ((await dialog("Measure all pictures", body, actions)) !== "save") return;
  localStorage.setItem(key, JSON.stringify([measures.value, scale.value]));
  try {
    saveFile(...(await api.file(api.url("measurements", { measures: measures.value, scale: scale.value }))));
  } catch (error) {
    toast(error, "bad");
  }
}
