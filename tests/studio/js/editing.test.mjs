// What is edited on a picture, without a page: its marks, a template that is made on it, and how both are told in words.
// Run by test_annotate_modules.py, by Node.

import assert from "node:assert/strict";
import { test } from "node:test";

import * as words from "./modules/annotate-words.js";
import { createOpening } from "./modules/annotate-opening.js";
import { Drafting } from "./modules/drafting.js";
import { FirstMarks } from "./modules/annotate-opening.js";
import { History } from "./modules/history.js";
import { Marking } from "./modules/marking.js";
import { layoutIn } from "./modules/points.js";
import { foundText, ScaleBar } from "./modules/scale-bar.js";
import { axisOf, EMPTY } from "./modules/template.js";

const NAMES = ["left", "right", "tip"];
const TRIANGLE = [
  [10, 20],
  [30, 20],
  [20, 30],
];
const TEMPLATE = { names: NAMES, mirror: [1, 0, 2], points: TRIANGLE, contours: [], revision: "r" };
const MOUSE = { shiftKey: false };

/** Marks of a picture that is open, and what was told of them. */
function marking(state = {}, template = TEMPLATE) {
  const told = [];
  const made = new Marking({
    template: () => template,
    onchange: () => told.push("change"),
    onselect: () => told.push("select"),
    onplaced: (index) => told.push(`placed ${index}`),
  });
  made.open({ history: new History({ points: TRIANGLE, invisible: [], source: "file", ...state }), doubtful: false });
  return { made, told };
}

// Marks -------------------------------------------------------------------------------------------------------------

test("a scale bar is a step to undo, and accepts no points", () => {
  const bar = { ends: [[0, 0], [9, 0]], length: 1, unit: "cm" };
  for (const source of ["none", "layout", "proposal", "file"]) {
    const { made, told } = marking({ source });
    made.change({ bar }, "scale bar");
    assert.deepEqual([made.state.bar, made.state.source, made.history.undoes], [bar, source, "scale bar"]);
    made.change({ bar: { ...bar } }, "scale bar"); // the same
    assert.equal(made.history.steps, 1);
    made.commit([[5, 5], ...TRIANGLE.slice(1)], "move");
    assert.deepEqual([made.state.bar, made.state.source], [bar, "file"]);
    made.travel("undo");
    made.travel("undo");
    assert.equal(made.state.bar ?? null, null);
    assert.equal(told.filter((each) => each === "change").length, 4);
  }
});

test("what was suggested is the person's after the first step, and undo gives it back", () => {
  const { made, told } = marking({ source: "proposal" });
  assert.equal(made.suggested, true);
  assert.equal(made.stateOf(0), "proposed");
  made.accept();
  assert.deepEqual([made.state.source, made.stateOf(0), told], ["file", "accepted", ["change"]]);
  assert.equal(made.travel("undo"), "accept");
  assert.equal(made.state.source, "proposal");
  assert.equal(made.travel("undo"), null);
  assert.equal(made.travel("redo"), "accept");
});

test("a step that changes nothing is none", () => {
  const { made, told } = marking();
  made.commit(
    TRIANGLE.map((point) => [...point]),
    "move",
  );
  assert.deepEqual([told, made.history.canUndo], [[], false]);
});

test("a point that has no place is visible by definition", () => {
  const { made } = marking({ invisible: [1] });
  assert.deepEqual([...made.invisible], [1]);
  made.select([1, 2], 2);
  assert.equal(made.toggleInvisible(), true); // mixed: all become so
  made.select([1]);
  made.removeChosen();
  assert.deepEqual([made.points[1], made.state.invisible, made.stateOf(1)], [null, [2], "missing"]);
});

test("a click places the chosen point that is missing, and none else", () => {
  const { made, told } = marking({ points: [TRIANGLE[0], null, null] });
  assert.equal(made.adding([1, 1]), null);
  made.select([1]);
  const gesture = made.adding([29, 19]);
  gesture.move([30, 20]);
  assert.deepEqual(made.points[1], [29, 19]); // the tool shows a gesture by its loupe; the step is taken at its end
  gesture.up();
  assert.deepEqual(made.points, [TRIANGLE[0], [30, 20], null]);
  assert.deepEqual(told, ["select", "change", "placed 1"]);
  assert.equal(made.history.undoes, "place right");
});

test("a gesture that is given up leaves all as it was", () => {
  const { made } = marking({ points: [null, TRIANGLE[1], TRIANGLE[2]] });
  made.select([0]);
  made.adding([5, 5]).cancel();
  assert.deepEqual([made.points[0], made.history.canUndo], [null, false]);
});

test("by keys a missing point is placed where the others suggest, or in the middle", () => {
  const size = { width: 100, height: 60 };
  const shifted = TRIANGLE.map(([x, y]) => [x + 5, y + 5]);
  const { made } = marking({ points: [shifted[0], shifted[1], null] });
  assert.equal(made.placeChosen(size), 2);
  assert.deepEqual(made.points[2], [25, 35]);
  assert.equal(made.placeChosen(size), -1);
  const blank = marking({ points: [null, null, null] }, { ...TEMPLATE, points: null }).made;
  blank.placeChosen(size);
  assert.deepEqual(blank.points[0], [50, 30]);
});

test("Tab goes through the points and then on", () => {
  const { made } = marking();
  assert.deepEqual([1, 1, 1, 1].map((by) => made.step(by)), [0, 1, 2, -1]);
  assert.equal(made.selection.size, 0);
  assert.equal(made.step(-1), 2);
});

test("twins move along only where that is wanted", () => {
  const { made } = marking();
  const after = [[8, 22], TRIANGLE[1], TRIANGLE[2]];
  assert.equal(made.follow(TRIANGLE, after, [0]), after);
  made.toggleMirrored();
  assert.deepEqual(made.follow(TRIANGLE, after, [0])[1], [32, 22]);
});

test("the frame is around the chosen points, or all of a mean shape", () => {
  const { made } = marking();
  assert.deepEqual(made.framed(), []);
  made.select([0, 2]);
  assert.deepEqual(made.framed(), [0, 2]);
  const { made: mean } = marking({ source: "layout" });
  assert.deepEqual(mean.framed(), [0, 1, 2]);
  const shifted = (points) => points.map(([x, y]) => [x + 5, y]);
  mean.commit(shifted(mean.points), "move"); // the frame stays, to be turned and scaled
  assert.deepEqual([mean.state.source, mean.framed()], ["file", [0, 1, 2]]);
  mean.commit(shifted(mean.points), "scale");
  assert.deepEqual(mean.framed(), [0, 1, 2]);
  mean.commit([[1, 1], ...mean.points.slice(1)], "move"); // until a single point is moved
  assert.deepEqual(mean.framed(), []);
  mean.travel("undo");
  assert.deepEqual(mean.framed(), [0, 1, 2]);
});

test("nothing is edited while no picture is open, or all is hidden", () => {
  const { made } = marking();
  assert.equal(made.editable, true);
  made.hide(true);
  assert.equal(made.editable, false);
  made.hide(false);
  made.open(null);
  assert.deepEqual([made.editable, made.points, made.suggested, made.placing], [false, [], false, false]);
});

test("undo selects the point that the next click placed, and redo the one after it", () => {
  const { made } = marking({ points: [null, null, null] });
  made.onplaced = (index) => made.select([made.nextMissing(index)]);
  made.select([0]);
  for (const xy of [[1, 1], [2, 2]]) made.adding(xy).up();
  assert.equal(made.active, 2);
  made.travel("undo");
  assert.deepEqual([made.active, made.placing, [...made.selection]], [1, true, [1]]);
  made.adding([3, 3]).up();
  assert.deepEqual(made.points, [[1, 1], [3, 3], null]);
  made.travel("undo");
  made.travel("undo");
  assert.equal(made.active, 0);
  made.travel("redo");
  assert.equal(made.active, 1); // as before it was undone
});

test("each point says whether a person placed, moved or confirmed it, or accepted it with others", () => {
  const { made } = marking({ source: "proposal" });
  made.select([0]);
  made.commit([[5, 5], ...TRIANGLE.slice(1)], "move");
  assert.deepEqual([made.origins, made.proposed], [["moved", "proposed", "proposed"], 2]);
  made.select([1]);
  assert.equal(made.confirm(), 1);
  assert.deepEqual([made.origins, made.active], [["moved", "confirmed", "proposed"], 2]);
  made.accept();
  assert.deepEqual([made.origins, made.stateOf(2), made.proposed], [["moved", "confirmed", "accepted"], "accepted", 0]);
  made.travel("undo");
  assert.equal(made.origins[2], "proposed");
  assert.deepEqual(marking().made.origins, ["placed", "placed", "placed"]); // a file that says nothing
});

test("points that move together are not placed one by one, nor is the twin that moves along", () => {
  const { made } = marking({ source: "layout" });
  const shifted = TRIANGLE.map(([x, y]) => [x + 3, y]);
  made.commit(shifted, "move"); // by its frame
  assert.deepEqual([made.state.source, made.origins], ["file", ["proposed", "proposed", "proposed"]]);
  made.select([0, 1]);
  made.commit([[1, 1], [2, 2], shifted[2]], "move");
  assert.deepEqual(made.origins, ["proposed", "proposed", "proposed"]);
  made.toggleMirrored();
  made.select([0]);
  made.commit([[0, 3], [4, 4], shifted[2]], "move");
  assert.deepEqual(made.origins, ["moved", "proposed", "proposed"]);
});

test("a flip exchanges origins as it does points, and by keys a point is placed as proposed", () => {
  const { made } = marking({ source: "proposal", points: [TRIANGLE[0], TRIANGLE[1], null] });
  made.select([0]);
  made.commit([[5, 5], TRIANGLE[1], null], "move");
  made.flip();
  assert.deepEqual(made.origins, ["proposed", "moved", null]);
  made.placeChosen({ width: 100, height: 60 });
  assert.equal(made.origins[2], "proposed");
});

test("a click after the last missing point was marked as absent does not place it", () => {
  const { made } = marking({ points: TRIANGLE });
  made.select([1]);
  assert.equal(made.toggleAbsent(), true);
  assert.equal(made.adding([7, 7]), null);
  assert.deepEqual([made.placing, made.chosen], [false, [1]]);
  assert.equal(made.toggleAbsent(), false); // it is still selected, to be taken back
  assert.equal(made.placing, true);
});

test("an absent point is not waited for, until it is placed after all", () => {
  const { made } = marking({ points: [TRIANGLE[0], null, null] });
  made.select([1]);
  assert.equal(made.toggleAbsent(), true);
  assert.deepEqual([made.missing, made.stateOf(1), made.active, words.tallyOf(made)], [[2], "absent", 2, "1 of 3, 1 absent"]);
  made.select([1]);
  made.adding([7, 7]).up();
  assert.deepEqual([made.state.absent, made.stateOf(1)], [[], "placed"]);
  made.select([1]);
  made.toggleAbsent();
  assert.deepEqual([made.points[1], made.absent], [null, [1]]);
  made.select([1]);
  assert.equal(made.toggleAbsent(), false);
  assert.deepEqual(made.missing, [1, 2]);
});

test("ellipses stay around the points that are still as the model proposed them", () => {
  const { made } = marking();
  const seen = { points: TRIANGLE, invisible: [], source: "proposal" };
  made.open({ history: new History(seen), doubtful: false, seen, fitted: TRIANGLE });
  assert.deepEqual(made.uncertain, TRIANGLE);
  made.select([1]);
  made.commit(TRIANGLE.map((point, i) => (i === 1 ? [31, 21] : point)), "move");
  assert.deepEqual(made.uncertain, [TRIANGLE[0], null, TRIANGLE[2]]);
  made.accept();
  assert.deepEqual(made.uncertain, [null, null, null]);
});

test("a scale bar of another picture is known as such until another is drawn", () => {
  const bar = { ends: [[0, 0], [9, 0]], length: 1, unit: "cm" };
  const { made } = marking();
  const state = { points: TRIANGLE, invisible: [], source: "file", bar };
  made.open({ history: new History(state), doubtful: false, sharedBar: { ...bar } });
  const ruler = new ScaleBar(made, { onchange() {}, onpreview() {} });
  assert.equal(ruler.isShared, true);
  made.change({ bar: { ...bar, length: 2 } }, "scale bar");
  assert.equal(ruler.isShared, false);
});

test("with the box, either button sets the scale in all pictures", () => {
  const { made } = marking();
  const shared = [];
  const done = [];
  const onshare = (bar, anyway) => {
    shared.push([bar.length, anyway]);
    return { redo: () => done.push("redo"), undo: () => done.push("undo") };
  };
  const ruler = new ScaleBar(made, { onchange() {}, onpreview() {}, onshare });
  const bar = { ends: [[0, 0], [9, 0]], length: 1, unit: "cm" };
  ruler.settle("save", { ...bar, anyway: false }, "scale bar");
  assert.deepEqual(shared, []);
  ruler.settle("save", { ...bar, length: 2, anyway: true }, "scale bar");
  assert.deepEqual(shared, [[2, true]]);
  made.travel("undo"); // one action has one undo, here and in the others
  assert.deepEqual([made.state.bar.length, done], [1, ["redo", "undo"]]);
  made.travel("redo");
  assert.deepEqual([made.state.bar.length, done], [2, ["redo", "undo", "redo"]]);
});

test("an end of a scale bar that is being drawn is undone first, then drawing ends", () => {
  const { made } = marking({ points: [TRIANGLE[0], null, TRIANGLE[2]] });
  made.select([1]);
  made.adding([30, 20]).up();
  const ruler = new ScaleBar(made, { onchange() {}, onpreview() {} });
  ruler.turn(true);
  ruler.adding([1, 1]).up();
  assert.equal(ruler.travel("undo"), "an end of the scale bar");
  assert.deepEqual([ruler.on, ruler.ends, made.points[1]], [true, [null, null], [30, 20]]);
  ruler.travel("undo");
  assert.deepEqual([ruler.on, made.points[1], made.active], [false, null, 1]);
});

test("what the server finds is drawn, and is a step to undo once it is used", async () => {
  const { made } = marking();
  const found = { bar: { ends: [[5, 5], [85, 5]], length: 8, unit: "mm" }, pixel: 0.1, error: 0.0004, ticks: 9 };
  const asked = [];
  const ruler = new ScaleBar(made, {
    onchange() {}, onpreview() {},
    onfind: async (what) => { asked.push(what); return found; },
  });
  globalThis.localStorage = { getItem: () => null, setItem() {} };
  ruler.askKind = async (before) => [true, before];
  let drawn = null;
  ruler.offer = async () => { drawn = ruler.ends; return ["save", false]; };
  await ruler.find();
  assert.deepEqual(asked, [{ kind: "ruler", length: 1, unit: "mm" }]);
  assert.deepEqual([drawn, made.state.bar, ruler.on], [found.bar.ends, found.bar, false]);
  made.travel("undo");
  assert.equal(made.state.bar ?? null, null);
  ruler.offer = async () => [null, false]; // cancelled
  await ruler.find();
  assert.deepEqual([made.state.bar ?? null, ruler.on], [null, false]);
  ruler.onfind = async () => null; // refused
  await ruler.find();
  assert.equal(made.state.bar ?? null, null);
  assert.equal(foundText(found), "9 ticks: 0.1 ± 0.00004 mm per pixel (0.04 %)");
  delete globalThis.localStorage;
});

// What a picture begins with ----------------------------------------------------------------------------------------

function first({ begins = "layout", marks = {}, pictures = [], template = TEMPLATE } = {}) {
  const asked = [];
  const fetchMarks = async (name) => {
    asked.push(name);
    if (!marks[name]) throw new Error("not now");
    return marks[name];
  };
  return { asked, first: new FirstMarks({ state: { project: { template, pictures } }, fetchMarks, begins: () => begins }) };
}

const EMPTY_MARKS = { points: [null, null, null], invisible: [], source: "none", width: 100, height: 60 };
const DONE = { ...EMPTY_MARKS, points: TRIANGLE, source: "file" };

test("a picture begins with its file, or the proposal, unless it is of another template", async () => {
  const { first: one } = first();
  assert.equal((await one.of("a", DONE)).points, TRIANGLE);
  assert.equal((await one.of("a", { ...DONE, source: "proposal" })).source, "proposal");
  assert.equal((await one.of("a", { ...DONE, points: [[1, 1]] })).source, "layout");
});

test("else with the mean of others that are done; each is asked for once, and one that fails is left out", async () => {
  const pictures = ["a", "b", "c", "d"].map((name) => ({ name, state: name === "d" ? "new" : "done" }));
  const { first: one, asked } = first({ pictures, marks: { b: DONE, d: DONE } });
  const state = await one.of("a", EMPTY_MARKS);
  assert.deepEqual([state.points, state.source], [TRIANGLE, "layout"]);
  await one.of("a", EMPTY_MARKS);
  assert.deepEqual(asked, ["b", "c", "c"]);
  one.forget("b");
  await one.of("a", EMPTY_MARKS);
  assert.deepEqual(asked.slice(3).sort(), ["b", "c"]);
});

test("what a picture begins with lacks the absent points", async () => {
  const absent = [1];
  const shown = await first().first.of("a", { ...DONE, source: "proposal", absent });
  assert.deepEqual([shown.points[1], shown.absent], [null, absent]);
  const layout = await first().first.of("a", { ...EMPTY_MARKS, absent });
  assert.deepEqual([layout.source, layout.points[1], layout.absent], ["layout", null, absent]);
});

test("or with nothing, where the points are clicked or there is no layout", async () => {
  assert.equal((await first({ begins: "click" }).first.of("a", EMPTY_MARKS)).source, "none");
  const bare = { ...TEMPLATE, points: null };
  assert.deepEqual((await first({ template: bare }).first.of("a", EMPTY_MARKS)).points, [null, null, null]);
});

test("a layout stays where it fills a part of the picture", () => {
  assert.equal(layoutIn(TRIANGLE, 60, 60), TRIANGLE);
  for (const [width, height] of [[30, 60], [600, 600]]) assert.notEqual(layoutIn(TRIANGLE, width, height), TRIANGLE);
  assert.equal(layoutIn(TRIANGLE, 30, 60, 1), TRIANGLE); // counted from 1
  assert.equal(layoutIn(null, 60, 60), null);
});

/** The opening of a tab in which the picture "a" does not arrive. */
function openingOf(tab) {
  const marking = { setShown() {}, select() {}, open() {}, ...tab.marking };
  const all = {
    template: {}, viewer: {}, app: { pictures: { fetch: () => new Promise(() => {}) } }, refresh() {}, ...tab, marking,
    tool: { cancel() {}, leave() {} }, saving: { fetchMarks: async () => null, ...tab.saving },
  };
  const opening = createOpening(all, { begins: () => "click", cover: {} });
  opening.open("a");
  return opening;
}

test("marks that were fetched before this page saved newer ones do not replace them", async () => {
  let revision = "1";
  const saver = { isDirty: () => false, revisionOf: () => revision };
  const saving = {
    tryToFetch: async () => {
      const marks = { revision };
      revision = "2"; // saved while the server answers
      return marks;
    },
    inherited: async (_name, marks) => { throw new Error(`taken: ${marks.revision}`); },
  };
  const state = { picture: () => ({ state: "done" }) };
  await assert.rejects(openingOf({ state, saver, saving }).reload(), { message: "taken: 2" });
});

test("marks that another program has changed are fetched, also after changes of this page", () => {
  const fetched = [];
  const picture = { tag: "t", state: "done", revision: "1" };
  const tab = {
    editing: false, state: { picture: () => picture },
    marking: { book: { tag: "t" }, history: { canUndo: true }, state: { source: "file" } },
    saver: { isDirty: () => false, revisionOf: () => "1" },
    saving: { tryToFetch: async (name) => { fetched.push(name); return null; } },
  };
  const opening = openingOf(tab);
  opening.refresh();
  assert.deepEqual(fetched, []);
  picture.revision = "2";
  opening.refresh();
  assert.deepEqual(fetched, ["a"]);
});

// The template ------------------------------------------------------------------------------------------------------

/** A template that is made on a picture of 100 x 60 at twice its size. */
function drafting() {
  const said = [];
  const viewer = {
    width: 100,
    height: 60,
    scale: 2,
    container: { clientWidth: 200, clientHeight: 120 },
    redraw() {},
    toScreen: ([x, y]) => [2 * x, 2 * y],
    toImage: ([x, y]) => [x / 2, y / 2],
  };
  const made = new Drafting({ viewer, say: (text) => said.push(text) });
  const click = (xy) => made.adding(xy).up();
  return { made, click, said };
}

test("a click adds a point at its end, and shows it before", () => {
  const { made, said } = drafting();
  const gesture = made.adding([5, 5]);
  gesture.move([6, 7]);
  assert.deepEqual([made.draft, gesture.ghost.points], [EMPTY, [[6, 7]]]);
  gesture.up();
  assert.deepEqual([made.points, [...made.selection], said], [[[6, 7]], [0], ["point 1 added"]]);
});

test("a click on the path's first point closes it, with Shift or on another point the path runs through it", () => {
  const { made, click } = drafting();
  made.togglePath();
  TRIANGLE.forEach(click);
  assert.equal(made.press(1, MOUSE), false);
  assert.equal(made.press(0, MOUSE), true);
  assert.deepEqual(made.draft.contours, [{ indices: [0, 1, 2], closed: true }]);
  made.togglePath();
  click([50, 50]);
  assert.equal(made.press(1, { shiftKey: true }), true);
  assert.deepEqual(made.draft.contours[1].indices, [3, 1]);
  made.click(2); // without dragging it
  made.click(2);
  assert.deepEqual(made.draft.contours[1].indices, [3, 1, 2]);
  made.endPath();
  made.click(0);
  assert.deepEqual(made.draft.contours[1].indices, [3, 1, 2]);
});

test("while mirroring a click makes twins, but on the grip it drags the axis", () => {
  const { made, click } = drafting();
  assert.equal(made.toggleMirror(), true);
  assert.equal(made.axis, 49.5);
  made.shiftAxis({ key: "ArrowRight", shiftKey: false });
  assert.equal(made.axis, 50.5);
  const gesture = made.adding([50.5, 8]); // the grip is 16 css pixels below the picture's top
  gesture.move([40, 8]);
  assert.equal(made.axis, 40);
  gesture.cancel();
  assert.equal(made.axis, 50.5);
  click([30, 30]);
  assert.deepEqual([made.points, made.draft.mirror], [[[30, 30], [71, 30]], [1, 0]]);
  click([52, 40]); // within reach of the axis
  assert.deepEqual([made.points[2], made.draft.mirror[2]], [[50.5, 40], 2]);
});

test("undo forgets what it takes away from the choice", () => {
  const { made, click } = drafting();
  TRIANGLE.forEach(click);
  assert.deepEqual([...made.selection], [2]);
  made.travel("undo");
  assert.deepEqual([made.names.length, [...made.selection], made.active], [2, [], -1]);
  made.travel("redo");
  assert.equal(made.names.length, 3);
});

test("points of a file are put in place before single ones are edited", () => {
  const { made } = drafting();
  made.load("a.pts", TEMPLATE, TRIANGLE);
  assert.deepEqual([made.placing, made.framed(), made.draft.origins], [false, [0, 1, 2], [null, null, null]]);
  assert.equal(made.adding([5, 5]), null);
  assert.equal(made.press(0, { shiftKey: true }), false);
  made.endLayout();
  assert.deepEqual([made.placing, made.framed()], [true, []]);
});

test("the frame of loaded points is undone, redone and stored with them", () => {
  const { made } = drafting();
  made.load("a.pts", TEMPLATE, TRIANGLE);
  made.endLayout();
  const shown = (way) => (made.travel(way), [made.layingOut, made.names.length]);
  assert.deepEqual(["undo", "undo", "redo", "redo"].map(shown), [[true, 3], [false, 0], [true, 3], [false, 3]]);
  made.travel("undo");
  const again = drafting().made;
  again.start(null, null, JSON.parse(JSON.stringify(made.draft)));
  assert.deepEqual([again.layout.file, again.placing], ["a.pts", false]);
  again.deleteChosen([0, 1, 2]);
  assert.equal(again.placing, true);
  assert.equal(again.layout, null);
});

test("loaded points are unmoved until one is moved or they are said to be in place", () => {
  const { made } = drafting();
  assert.equal(made.isUnmoved, false);
  made.load("a.pts", TEMPLATE, TRIANGLE);
  made.deleteChosen([0]);
  assert.equal(made.isUnmoved, true);
  made.endLayout();
  assert.equal(made.isUnmoved, false);
  made.travel("undo");
  made.commit([[31, 20], [20, 30]], "move");
  assert.equal(made.isUnmoved, false);
});

test("what was made goes on under a template that is another now, as one step", () => {
  const { made, click } = drafting();
  made.start(TEMPLATE, TRIANGLE);
  click([50, 50]);
  made.rebase({ ...TEMPLATE, names: ["tip", "left", "right"], revision: "s" });
  assert.deepEqual([made.saved.revision, made.draft.origins], ["s", [1, 2, 0, null]]);
  assert.equal(made.history.undoes, "earlier changes");
});

test("the axis is half-way between twins, else in the middle of the points or the picture", () => {
  const draft = { names: NAMES, points: TRIANGLE, mirror: [1, 0, 2] };
  assert.equal(axisOf({ ...draft, points: [[10, 20], [34, 20], [90, 30]] }, 100), 22);
  assert.equal(axisOf({ ...draft, mirror: [0, 1, 2] }, 100), 20);
  assert.equal(axisOf(EMPTY, 100), 49.5);
});

// In words ----------------------------------------------------------------------------------------------------------

test("where a point is, what comes next, and what is missing", () => {
  const { made } = marking({ points: [TRIANGLE[0], null, TRIANGLE[2]], invisible: [2] });
  assert.equal(words.placeOf(made, 0), "left, 10.0, 20.0");
  assert.equal(words.placeOf(made, 2, 1), "tip, 20.0, 30.0, invisible. Next: right");
  assert.equal(words.placeOf(made, 1), "right, missing");
  assert.equal(words.tallyOf(made), "2 of 3, 1 invisible");
  assert.equal(words.outsideText(made, { width: 40, height: 40 }), "");
  assert.match(words.outsideText(made, { width: 40, height: 30 }), /^tip lies outside the picture: drag it back/);
  assert.equal(words.tallyOf(marking({ points: TRIANGLE, source: "layout" }).made), "mean shape");
  const proposal = marking({ points: [...TRIANGLE.slice(0, 2), null], source: "proposal", absent: [2] }).made;
  assert.equal(words.tallyOf(proposal), "2 of 3 proposed, 1 absent");
  assert.equal(words.tallyOf(marking({ points: TRIANGLE, source: "proposal" }).made), "3 proposed");
  assert.equal(words.tallyOf(marking({ points: TRIANGLE }).made), "3 points");
  assert.match(words.promptOf(proposal), /^Placed by the model \(tip absent: U if not\)/);
  assert.match(words.promptOf(made), /^right is missing: select it in the list, then click its position/);
  made.select([1]);
  assert.equal(words.promptOf(made), "Click right");
  assert.match(words.missingText(NAMES, [1]), /^'right' is still missing here\. Place it,/);
  assert.match(words.missingText(NAMES, [0, 1]), /^2 points are still missing here\. Place them,/);
  assert.match(words.descriptionOf("a.png", made), /^a\.png: 2 of 3 points, placed or accepted\./);
});
