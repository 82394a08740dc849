// Which pictures figures of many leave out, and why: in words, with the pictures to open.

import { several } from "./annotate-words.js";
import { h } from "./ui.js";

const NAMED = 100; // pictures of a reason that are named

/** Why pictures without any measured point have none, the first that applies. A reason follows "4 pictures".
 *  @type {[string, (picture: Picture) => unknown][]} */
const UNMEASURED = [
  ["cannot be read", ({ state }) => state === "broken"],
  ["are still being read", ({ state }) => state === "reading"],
  ["have a file with points that do not fit the template", ({ state, error, placed }) => placed > 0 && state === "partial" && error],
  ["have only a guess of the model, which found nothing: place their points", ({ nothing_found: nothing }) => nothing],
  ["have doubtful points of the model: look at them, then accept them", ({ doubtful }) => doubtful],
  ["have proposed points only: accept them", ({ state, proposed = 0 }) => state === "proposed" || proposed > 0],
  ["have no points yet", () => true],
];

/** Why pictures with measured points have no shape. */
const INCOMPLETE = [
  ["have points that are only proposed: accept them", ({ proposed = 0 }) => proposed > 0],
  ["lack points that are marked as absent", ({ absent = 0 }) => absent > 0],
  ["are not finished: points are missing", () => true],
];

/** The pictures that measures, or else shapes, leave out: [{why, names}], of which measures without a scale have lacksScale.
 *  @param {Picture[]} pictures; @param {Pick<Shapes, "pictures" | "space" | "unscaled">} data; @param {boolean} ofShapes */
export function leftOut(pictures, { pictures: measured, space, unscaled }, ofShapes) {
  const position = new Map(measured.map((name, i) => [name, i]));
  const shaped = new Set(space?.of ?? measured.map((_, i) => i)); // without a space, another message says why
  const unmeasured = grouped(pictures.filter(({ name }) => !position.has(name)), UNMEASURED);
  if (ofShapes) return [...unmeasured, ...grouped(pictures.filter(({ name }) => position.has(name) && !shaped.has(position.get(name))), INCOMPLETE)];
  const bare = unscaled.map((i) => measured[i]);
  return bare.length ? [...unmeasured, { why: "have no scale, and so no lengths and areas: draw a scale bar (S)", names: bare, lacksScale: true }] : unmeasured;
}

function grouped(pictures, reasons) {
  const names = new Map(reasons.map(([why]) => [why, []]));
  for (const picture of pictures) names.get(reasons.find(([, has]) => has(picture))[0]).push(picture.name);
  return [...names].map(([why, own]) => ({ why, names: own })).filter((each) => each.names.length);
}

const ONE = { have: "has", are: "is", lack: "lacks", their: "its" };
const singular = (why) => why.replace(/^(have|are|lack)\b|\btheir\b/g, (word) => ONE[word]);

/** A reason with the number of its pictures. */
export const reasonText = ({ why, names }) => `${several(names.length, "picture")} ${names.length === 1 ? singular(why) : why}`;

/** Pictures as links that choose them. @param {string[]} names; @param {(name: string) => void} choose; @param {string} testid */
export function pictureLinks(names, choose, testid) {
  const links = names.slice(0, NAMED).flatMap((name, i) => [
    i > 0 && ", ", h("button.link", { type: "button", onclick: () => choose(name), testid: `${testid}-picture` }, name)]);
  const more = names.length - NAMED;
  return [...links, more > 0 && `, and ${more} more`];
}

/** {element, show(sentence, groups)}: a sentence, and on a click the pictures that are left out by their reasons.
 *  @param {(name: string) => void} choose; @param {string} testid */
export function createLeftOut(choose, testid) {
  const sentence = h("summary");
  const list = h("ul.assist-lines");
  const details = h("details.left-out.small", { testid }, sentence, list);
  const whole = h("p.left-out.small.muted", { testid: `${testid}-none` });
  const element = h("div", { role: "status" }, whole, details);
  let shown = "";

  function show(text, groups) {
    const now = JSON.stringify([text, groups]);
    if (now === shown) return; // an opened list stays as it is
    shown = now;
    whole.hidden = groups.length > 0;
    details.hidden = !groups.length;
    whole.textContent = text;
    sentence.textContent = text;
    list.replaceChildren(...groups.map(line));
  }

  const line = (group) => h("li", `${reasonText(group)} – `, pictureLinks(group.names, choose, testid));

  return { element, show };
}
