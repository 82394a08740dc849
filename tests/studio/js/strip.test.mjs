// The list of pictures without a page: what it shows, and the texts of the review. Run by test_annotate_modules.py, by Node.

import assert from "node:assert/strict";
import { test } from "node:test";

import { namesFor, summary } from "./modules/adding.js";
import { outcome, whoAmI } from "./modules/bulk.js";
import { percent } from "./modules/annotate-words.js";
import { faultIn, meant } from "./modules/hotkeys.js";
import { leftOut, reasonText } from "./modules/left-out.js";
import { bins, decimalsOf, kindFor, measureOf, measureText, numberText, parsed, scaleText, summary as summaryOf, valueOf } from "./modules/measures.js";
import { accuracyText, errorText, sentence } from "./modules/review.js";
import { faultOfLength, typedNumber } from "./modules/scale-bar.js";
import { between, describe, FILTERS, foldersOf, matching, meaning, openIn, STATES } from "./modules/strip-filters.js";
import { isChoosing } from "./modules/ui.js";
import { acceptable } from "./modules/wall.js";

const PICTURES = [
  { name: "a/1.png", state: "done", checked: "Ann" },
  { name: "a/2.png", state: "done", checked: null },
  { name: "a/b/10.png", state: "proposed", uncertainty: 0.2 },
  { name: "c/1.png", state: "proposed", uncertainty: 0.1, doubtful: true },
  { name: "c/2.png", state: "partial", placed: 3, left_out: "Bob" },
];
const ALL = { text: "", filter: "all", folder: "", order: "name" };
const names = (wanted, left = {}) => matching(PICTURES, { ...ALL, ...wanted }, left).map(({ name }) => name);

test("subfolders are listed with those between, and their numbers of pictures", () => {
  assert.deepEqual(Object.values(foldersOf(PICTURES)), ["a (3)", "a/b (1)", "c (2)"]);
  assert.deepEqual(foldersOf([{ name: "1.png" }]), {});
});

test("pictures are found by folder, name and state, and sorted by uncertainty", () => {
  assert.deepEqual(names({ folder: "a" }), ["a/1.png", "a/2.png", "a/b/10.png"]);
  assert.deepEqual(names({ text: "c/" }), ["c/1.png", "c/2.png"]);
  assert.deepEqual(names({ filter: "checked" }), ["a/1.png"]);
  assert.deepEqual(names({ filter: "review" }), ["a/2.png"]);
  assert.deepEqual(names({ filter: "left" }, { "a/2.png": "why", "c/1.png": "not done" }), ["a/2.png", "c/2.png"]);
  assert.deepEqual(names({ order: "uncertainty" }).slice(0, 2), ["c/1.png", "a/b/10.png"]);
  assert.deepEqual(names({}), PICTURES.map(({ name }) => name)); // sorting leaves the list itself alone
  assert.ok(Object.values(FILTERS).every(({ label }) => label));
});

test("pictures are sorted by quality, slips and doubtful ones first", () => {
  const made = (name, more) => ({ name, doubtful: false, quality: null, slip: null, ...more });
  const all = [made("done"), made("good", { quality: 0.9 }), made("bad", { quality: 0.6 }), made("slip", { slip: "?" }),
    made("nothing", { quality: 0.3, doubtful: true, nothing_found: true }), made("doubtful", { quality: 0.8, doubtful: true })];
  const order = matching(all, { ...ALL, order: "quality" }, {}).map(({ name }) => name);
  assert.deepEqual(order, ["slip", "doubtful", "nothing", "bad", "good", "done"]);
});

test("added files keep their names, or get those of their folders where two would clash", () => {
  assert.deepEqual(namesFor(["day/a.png", "day/a.pts", "day/more/b.png"]), ["a.png", "a.pts", "b.png"]);
  assert.deepEqual(namesFor(["x/1.png", "x/1.pts", "y/1.png"]), ["x_1.png", "x_1.pts", "y_1.png"]);
});

test("what was added is told in one sentence", () => {
  const none = { pictures: 0, known: 0, landmarks: 0, placed: 0, refused: [] };
  assert.equal(summary({ ...none, pictures: 48, landmarks: 1, placed: 12, refused: ["a: why"] }),
    "48 pictures added, landmarks for 12, 1 file left out: a: why.");
  assert.equal(summary({ ...none, known: 2 }), "2 files already here.");
  assert.match(summary({ ...none, refused: ["a.csv: name the columns as x,y."] }), /as x,y\.$/);
  assert.doesNotMatch(summary({ ...none, refused: ["a.csv: name the columns as x,y."] }), /\.\./);
  assert.match(summary({ ...none, refused: ["a", "b", "c", "d"] }), /4 files left out: a; b; c; and 1 more/);
});

test("states are described", () => {
  const said = PICTURES.map((picture) => describe(picture, { "a/2.png": "why" }));
  assert.deepEqual(said, ["checked", "left out", "proposed", "doubtful", "left out"]);
  const partial = { name: "d.png", state: "partial", placed: 68 };
  assert.equal(describe(partial, {}), "68 placed");
  assert.equal(describe({ ...partial, proposed: 67 }, {}), "67 only proposed");
  assert.equal(describe({ name: "coin.jpg", state: "proposed", doubtful: true, nothing_found: true }, {}), "nothing found");
  assert.equal(describe({ ...partial, error: "d.pts has 68 points" }, {}), "points do not fit");
});

test("each state and each filter says what it means, in words of its own", () => {
  for (const table of [STATES, FILTERS]) {
    const [labels, abouts] = ["label", "about"].map((key) => Object.values(table).map((each) => each[key]));
    for (const said of [labels, abouts]) assert.equal(new Set(said).size, said.length);
    assert.ok([...labels, ...abouts].every(Boolean));
  }
  assert.match(meaning({ name: "a", state: "done", checked: "Ann" }, {}), /marked as checked/);
  assert.match(meaning({ name: "a", state: "partial", proposed: 2 }, {}), /not accepted yet/);
});

test("a decimal comma is taken, and one that may separate thousands is not", () => {
  const typed = ["0,5", "0.5", " 12,5 ", "1250", "0,125", "1e3"].map(typedNumber);
  assert.deepEqual(typed, [0.5, 0.5, 12.5, 1250, 0.125, 1000]);
  assert.equal(faultOfLength("2,5"), "");
  assert.equal(faultOfLength("1,250"), "1,250 may be 1.250 or 1250: write one of these.");
  for (const wrong of ["", "0", "1.000,5", "1,2,3", "0x10", "five"]) assert.match(faultOfLength(wrong), /^Enter a length/, wrong);
});

test("a range goes both ways and needs its beginning", () => {
  assert.deepEqual(between(["a", "b", "c", "d"], "c", "a"), ["a", "b", "c"]);
  assert.deepEqual(between(["a", "b"], "gone", "b"), ["b"]);
});

test("the outcome of an action is said with what was refused", () => {
  const refused = { "b.png": "checked already", "c.png": "checked already" };
  assert.equal(outcome("checked", { changed: ["a.png"], refused }),
    "1 picture marked as checked. 2 pictures not changed: checked already (b.png, c.png).");
  assert.equal(outcome("deleted", { changed: ["a.png", "b.png"], refused: { "c.png": "no landmarks" } }),
    "Landmarks of 2 pictures deleted. c.png not changed: no landmarks.");
  assert.equal(outcome("deleted", { changed: ["a.png", "b.png"], refused: {} }, "accepted"),
    "Points of 2 pictures are proposed again, no longer accepted.");
  assert.equal(outcome("scaled", { changed: [], refused: { "a.png": "has a scale", "b.png": "is small", "c.png": "is small" } }),
    "3 pictures not changed: has a scale (a.png); is small (b.png, c.png).");
});

test("history and accuracy are said", () => {
  assert.equal(sentence({ who: "", did: "placed" }), "Someone placed points");
  assert.equal(percent(0.0312), "3.1\u00a0%");
  assert.equal(percent(0.0012), "0.12\u00a0%");
  const versions = [{ error: 0.04, held_out: 1, failed: [], same: false }, { error: 0.02, held_out: 4, failed: ["a.png", "b.png"], same: true }]
    .map((version) => ({ ...version, time: null, pictures: 9 }));
  assert.match(accuracyText(versions), /Measured on 4 pictures kept for testing.*4 pictures say little.*Pale/);
  assert.equal(errorText(versions[0]), "4.0\u00a0%, 1 picture");
  assert.equal(errorText(versions[1]), "2.0\u00a0%, median of 2 pictures; a.png, b.png not counted, since the fits failed");
  assert.equal(errorText({ ...versions[0], failed: ["a.png"] }), "not measured, since the fit to the picture kept for testing failed");
  assert.doesNotMatch(accuracyText(versions.slice(1)), /Pale/);
});

test("the wall accepts sure proposals, and opens slips and what is not done", () => {
  const made = (name, state, more = {}) => ({ name, state, doubtful: false, quality: null, slip: null, ...more });
  const all = [
    made("slip", "done", { slip: "?" }), made("doubtful", "proposed", { quality: 0.95, doubtful: true }),
    made("low", "proposed", { quality: 0.8 }), made("sure", "proposed", { quality: 0.9 }), made("done", "done"),
    made("broken", "broken"), made("reading", "reading"),
  ];
  assert.deepEqual(acceptable(all, 0.9), ["sure"]);
  assert.deepEqual(openIn(all).map(({ name }) => name), ["slip", "doubtful", "low", "sure"]);
});

test("measures are told with the names of their points", () => {
  assert.equal(measureOf(kindFor(3), [2, 3, 4]), "angle:3-4-5");
  const names = ["fork of L2", "tip", "base"];
  assert.equal(measureText("angle:1-2-3", names), "angle: fork of L2 – tip – base");
  for (const other of ["distance:tip-base", "distance:1-9", "nonsense"]) assert.equal(measureText(other, names), other);
});

test("measures have the values of liaam measure, in the unit of the scale", () => {
  const points = [[0, 0], [3, 4], [3, 10], [0, 10], null];
  const value = (measure, pixel = null) => valueOf(parsed(measure, ["a", "b", "c", "d", "e"]), points, pixel);
  assert.deepEqual(value("distance:1-2"), { value: 5, unit: "px" });
  assert.deepEqual(value("length:1-2-3", { length: 0.5, unit: "mm" }), { value: 5.5, unit: "mm" });
  assert.deepEqual(value("area:2-3-4", { length: 0.5, unit: "mm" }), { value: 2.25, unit: "mm²" });
  assert.equal(Math.round(value("angle:2-3-4", { length: 0.5, unit: "mm" }).value), 90);
  assert.equal(value("distance:1-5"), null);
  assert.equal(numberText(1234.56, "px"), "1235\u00a0px");
  assert.equal(numberText(0.00001234), "1.234e-5");
  assert.equal(numberText(null, "px"), "–");
  const column = [5, 4.4, 4.393];
  assert.deepEqual(column.map((value) => numberText(value, "", decimalsOf(column))), ["5.000", "4.400", "4.393"]);
  assert.deepEqual([1234.5, 2].map((value) => numberText(value, "", decimalsOf([1234.5, 2]))), ["1235", "2"]);
  const ends = ["tip", "base"];
  assert.equal(scaleText("0,5 mm", ends), "1 pixel is 0,5 mm.");
  assert.equal(scaleText("200 px/mm", ends), "1 mm is 200 pixels.");
  assert.equal(scaleText("1-2=0.5 mm", ends), "tip to base is 0.5 mm in every picture. These two points are no part of shapes.");
  assert.equal(scaleText("", ends), "");
});

test("a histogram holds each known value once", () => {
  const values = [1, 2, 2, 3, null, 10, 2.5, 2.2];
  const { edges, of } = bins(values);
  assert.deepEqual(of.flat().sort(), [0, 1, 2, 3, 5, 6, 7]);
  assert.equal(edges.length, of.length + 1);
  assert.deepEqual(bins([4, 4, 4]).of, [[0, 1, 2]]);
  assert.deepEqual(bins([5, null]).edges, [4.75, 5.25]); // around the only value
  assert.deepEqual(bins([null]).of, []);
  const { n, mean, sd } = summaryOf([1, null, 3]);
  assert.deepEqual([n, mean, sd], [2, 2, Math.SQRT2]);
});

test("a letter of one's own means its command, and the old letter nothing", () => {
  const chosen = { q: "c", c: "v" };
  assert.deepEqual(["q", "Q", "c", "v", "x"].map((key) => meant(key, chosen)), ["c", "c", "v", "", "x"]);
  assert.equal(faultIn({ n: "n", p: "q" }), "");
  assert.match(faultIn({ n: "x", p: "x" }), /have the same key, X/);
  assert.match(faultIn({ n: "" }), /give one letter/);
});

test("an observer's set logs under its name, other sets under that of the browser", (t) => {
  const before = globalThis.localStorage;
  t.after(() => { globalThis.localStorage = before; });
  const stored = { "liaam-studio:who": "Ben", "liaam-studio:who:carl": "Carla" };
  globalThis.localStorage = /** @type {any} */ ({ getItem: (key) => stored[key] ?? null });
  assert.equal(whoAmI({ set: "", observers: ["", "anna"] }), "Ben");
  assert.equal(whoAmI({ set: "anna", observers: ["", "anna"] }), "anna");
  assert.equal(whoAmI({ set: "carl", observers: ["", "carl"] }), "Carla");
  assert.equal(whoAmI({ set: "hand", observers: ["hand"] }), "Ben"); // other points, not another observer
  delete stored["liaam-studio:who"]; // another browser, or another port of the server
  assert.equal(whoAmI({ set: "", observers: [""], who: "Ben" }), "Ben");
  assert.equal(whoAmI({ set: "", observers: [""], who: "" }), "");
});

test("done pictures say what they lack, and the filter finds those with points that nobody looked at", () => {
  assert.equal(describe({ name: "a", state: "done", absent: 2 }, {}), "done, 2 absent");
  const all = [{ name: "a", state: "done", unconfirmed: 3 }, { name: "b", state: "done", unconfirmed: 0 }];
  assert.deepEqual(all.filter(FILTERS.unconfirmed.has).map(({ name }) => name), ["a"]);
});

test("keys that choose in a closed list open a menu of actions, and others do what they do", () => {
  for (const key of ["ArrowDown", "ArrowLeft", "PageUp", "PageDown", "Home", "End", "Enter", " ", "t"])
    assert.ok(isChoosing({ key }), key);
  for (const key of ["Tab", "Escape", "Shift", "F2", "Delete"]) assert.ok(!isChoosing({ key }), key);
  assert.ok(!isChoosing({ key: "a", ctrlKey: true }));
  assert.ok(!isChoosing({ key: "ArrowDown", altKey: true })); // opens the list by itself
});

test("figures say which pictures they leave out, and why", () => {
  const pictures = [
    { name: "a", state: "done" }, { name: "b", state: "done", absent: 1 }, { name: "c", state: "partial", proposed: 2, placed: 5 },
    { name: "d", state: "partial", placed: 3 }, { name: "e", state: "proposed", doubtful: true }, { name: "f", state: "proposed" },
    { name: "g", state: "broken" }, { name: "h", state: "new" }, { name: "i", state: "new" },
    { name: "j", state: "partial", placed: 3, error: "3 points where the template has 5" }, { name: "k", state: "proposed", nothing_found: true, doubtful: true },
  ];
  const data = { pictures: ["a", "b", "c", "d"], space: { of: [0] }, unscaled: [1] };
  const told = (ofShapes) => leftOut(pictures, data, ofShapes).map(({ why, names }) => [names.join(), why.split(":")[0]]);
  const unmeasured = [
    ["g", "cannot be read"], ["j", "have a file with points that do not fit the template"],
    ["k", "have only a guess of the model, which found nothing"], ["e", "have doubtful points of the model"],
    ["f", "have proposed points only"], ["h,i", "have no points yet"],
  ];
  assert.deepEqual(told(false), [...unmeasured, ["b", "have no scale, and so no lengths and areas"]]);
  assert.deepEqual(told(true), [
    ...unmeasured, ["c", "have points that are only proposed"], ["b", "lack points that are marked as absent"], ["d", "are not finished"],
  ]);
  assert.match(reasonText(leftOut(pictures, data, false)[2]), /^1 picture has only a guess .* its points$/);
});
