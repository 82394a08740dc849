// Whether the shapes of an observer, or of the model, agree with those of a person for statistics of shape.

import { dialog, h } from "./ui.js";

const number = (value) => (value === null ? "–" : value.toFixed(2));
const range = (/** @type {(number | null)[]} */ [low, high]) => (low === null ? "" : ` (${low.toFixed(2)} to ${high.toFixed(2)})`);
const NOTE = "Slope: by how much a difference in the labels appears in these shapes; 1 is right, less means that they are " +
  "drawn to their mean. Variance ratio: their variance as a multiple of that of the labels. Squared correlation: " +
  "with the labels. Intervals hold with 95 % probability.";

/** The measures of agreement as a list; called: names of the sets for people; sentences: for a paper, which speak of
 *  automatic landmarks. @param {ShapeAgreement} found */
export function shapeFacts(found, called, sentences = false) {
  const fact = (what, value, testid) => h("div", h("dt.small.muted", what), h("dd", { testid }, value));
  const [ours, labels] = found.names.map(called);
  return h("section.column", { "aria-label": `Shapes of ${ours}` },
    h("h3", `Shapes of ${ours} on those of ${labels}, ${found.pictures} pictures`),
    h("dl.agreement-facts",
      fact("Slope", `${number(found.slope)}${range(found.slope_interval)}`, "shape-slope"),
      fact("Variance ratio", number(found.variance_ratio), "shape-ratio"),
      fact("Intraclass correlation", number(found.repeatability), "shape-icc"),
      fact("Squared correlation", number(found.reliability)),
      found.attenuation !== null && fact("Differences between groups, ×", `${number(found.attenuation)}${range(found.attenuation_interval)}`, "shape-attenuation"),
      fact("Mean shapes apart", `${found.mean_distance.toFixed(1)} SE, P = ${found.p.toFixed(3)}`),
      fact("Correlation of sizes", number(found.size_correlation))),
    sentences && h("details.small", h("summary", "Sentences for Methods"), h("p", found.methods)));
}

export const shapeNote = () => h("p.small.muted", NOTE);

/** Show how the model's shapes agree with a person's in pictures that were held out. @param {App} app */
export async function showModelAgreement({ api }) {
  const found = await api.get(api.url("agreement/model"));
  const called = (name) => (name === "model" ? "the model" : "people");
  await dialog("Are the model's shapes good enough for statistics?", h("div.column", shapeFacts(found, called, true), shapeNote(),
    h("p.small.muted", "Of pictures that a training kept for testing. For all pictures, and with an interval that is narrower, use liaam evaluate.")), undefined, { wide: true });
}
