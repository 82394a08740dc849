// Curves through knots, and tracing a contour with them. Run by test_annotate_modules.py, by Node.

import assert from "node:assert/strict";
import { test } from "node:test";

import { curveThrough, spread } from "./modules/curve.js";
import { History } from "./modules/history.js";
import { Marking } from "./modules/marking.js";
import { Tracing } from "./modules/tracing.js";

const apart = (p, q) => Math.hypot(p[0] - q[0], p[1] - q[1]);
const near = (p, q, tolerance = 1e-9) => assert.ok(apart(p, q) <= tolerance, `${p} is not ${q}`);
const circle = (n, radius = 100) =>
  Array.from({ length: n }, (_, i) => [radius * Math.cos((2 * Math.PI * i) / n), radius * Math.sin((2 * Math.PI * i) / n)]);

// Curves -------------------------------------------------------------------------------------------------------------

test("along a straight line the points are exact, wherever the knots lie on it", () => {
  const line = curveThrough([[0, 0], [3, 6], [4, 8], [40, 80], [50, 100]]);
  const even = spread(line, 6);
  even.forEach((point, i) => near(point, [10 * i, 20 * i], 1e-6));
});

test("two knots are joined by a straight line, with both ends", () => {
  const even = spread(curveThrough([[10, 5], [20, 5]]), 3);
  [[10, 5], [15, 5], [20, 5]].forEach((point, i) => near(even[i], point));
});

test("the curve goes through its knots", () => {
  const knots = [[0, 0], [10, 30], [50, 20], [60, 90]];
  const line = curveThrough(knots);
  for (const knot of knots) assert.ok(line.some((point) => apart(point, knot) < 1e-9));
});

test("a circle by twelve knots is round to a fifth of a percent, and its points are evenly spaced", () => {
  const line = curveThrough(circle(12), true);
  for (const point of line) assert.ok(Math.abs(Math.hypot(...point) - 100) < 0.2);
  near(line[0], line.at(-1));
  const even = spread(line, 20, true);
  even.forEach((point, i) => near(point, circle(20)[i], 0.3));
});

test("points of an open curve are evenly spaced along it", () => {
  const line = curveThrough([[0, 0], [10, 40], [60, 50], [65, 10], [120, 0]]);
  const even = spread(line, 200);
  const steps = even.slice(1).map((point, i) => apart(point, even[i]));
  assert.ok(Math.max(...steps) / Math.min(...steps) < 1.02, `${Math.min(...steps)} to ${Math.max(...steps)}`);
  near(even[0], [0, 0]);
  near(even.at(-1), [120, 0]);
});

test("a knot that is clicked twice changes nothing, and one place is no curve", () => {
  const once = curveThrough([[0, 0], [10, 30], [50, 20]]);
  assert.deepEqual(curveThrough([[0, 0], [10, 30], [10, 30], [50, 20], [50, 20]]), once);
  assert.deepEqual(curveThrough([...circle(5), circle(5)[0]], true), curveThrough(circle(5), true));
  assert.deepEqual(curveThrough([[1, 1], [1, 1]]), [[1, 1]]);
  assert.deepEqual(curveThrough([]), []);
});

test("points that stay keep their index, and those between them are even", () => {
  const line = curveThrough([[0, 0], [100, 0]]);
  const even = spread(line, 5, false, [[3, [30, 2]]]);
  assert.deepEqual(even[3], [30, 2]);
  const place = even.map(([x]) => Math.round(x));
  assert.ok(Math.abs(place[1] - 10) < 2 && Math.abs(place[2] - 20) < 3, place);
  assert.equal(place[4], 100);
});

test("points that stay in another order than along the curve stay too", () => {
  const even = spread(curveThrough([[0, 0], [100, 0]]), 5, false, [[1, [80, 0]], [2, [20, 0]]]);
  assert.deepEqual([even[1], even[2]], [[80, 0], [20, 0]]);
  assert.ok(even.flat().every(Number.isFinite));
});

// Tracing ------------------------------------------------------------------------------------------------------------

const CONTOURS = [
  { indices: [0, 1, 2, 3, 4], closed: false }, // the upper lip, say
  { indices: [0, 5, 6, 4], closed: false }, // the lower lip, between the same corners
  { indices: [7, 8, 9, 10], closed: true },
  { indices: [11, 12], closed: false },
];
const N = 14; // the last two are in no contour to trace
const SLIDING = [1, 2, 3, 5, 6, 8, 9, 10];
const KINDS = Array.from({ length: N }, (_, i) => (SLIDING.includes(i) ? "semilandmark" : "landmark"));

/** A picture with these points, and nothing else. */
function begin(points = {}, { source = "file", active = -1 } = {}) {
  const all = Array.from({ length: N }, (_, i) => points[i] ?? null);
  const template = { names: all.map((_, i) => `p${i}`), kinds: KINDS, contours: CONTOURS, mirror: null, points: null };
  const marking = new Marking({ template: () => template });
  marking.open({ history: new History({ points: all, invisible: [], source, bar: null }) });
  if (active >= 0) marking.select([active]);
  const tracing = new Tracing(marking, {});
  return { marking, tracing };
}

/** Click a place of the picture. */
function click(tracing, xy) {
  const gesture = tracing.adding(xy);
  gesture.up();
}

test("an open contour is traced, and its points are placed in one step", () => {
  const { marking, tracing } = begin();
  tracing.turn(tracing.wanted);
  for (const x of [0, 10, 80]) click(tracing, [x, 5]);
  assert.deepEqual(marking.points[2], [40, 5]); // shown already
  assert.equal(marking.state.points[2], null); // and not kept yet
  tracing.finish();
  assert.ok(!tracing.on);
  assert.deepEqual(marking.state.points.slice(0, 6), [[0, 5], [20, 5], [40, 5], [60, 5], [80, 5], null]);
  assert.equal(marking.history.steps, 1);
  marking.travel("undo");
  assert.ok(marking.points.every((point) => point === null));
});

test("a closed contour begins at the first click and needs three places", () => {
  const { marking, tracing } = begin({}, { active: 8 });
  tracing.turn(tracing.wanted);
  click(tracing, [100, 0]);
  click(tracing, [0, 100]);
  assert.equal(tracing.whole, null);
  tracing.finish();
  assert.ok(tracing.on, "two places end nothing");
  click(tracing, [-100, 0]);
  click(tracing, [0, -100]);
  assert.ok(tracing.press(0), "a press on the first place ends it");
  assert.ok(!tracing.on);
  [[100, 0], [0, 100], [-100, 0], [0, -100]].forEach((point, i) => near(marking.state.points[7 + i], point, 0.1));
});

test("points that were placed before are replaced, but not those of other contours", () => {
  const { marking, tracing } = begin({ 1: [1, 1], 2: [2, 2], 7: [7, 7], 13: [9, 9] }, { active: 2 });
  tracing.turn(tracing.wanted);
  for (const x of [0, 40]) click(tracing, [x, 0]);
  tracing.finish();
  assert.deepEqual(marking.state.points.slice(0, 5), [[0, 0], [10, 0], [20, 0], [30, 0], [40, 0]]);
  assert.deepEqual([marking.state.points[7], marking.state.points[13]], [[7, 7], [9, 9]]);
});

test("corners that another contour has placed stay, and the curve begins and ends there", () => {
  const { marking, tracing } = begin({ 0: [0, 0], 4: [60, 0] });
  tracing.turn(CONTOURS[1]);
  assert.equal(marking.points[5], null, "without a click there is no curve");
  click(tracing, [30, 0]);
  assert.deepEqual([0, 5, 6, 4].map((i) => marking.points[i]), [[0, 0], [20, 0], [40, 0], [60, 0]]);
  assert.ok(tracing.press(0), "a corner is not dragged");
  assert.ok(tracing.on);
  assert.ok(tracing.press(2), "a press on the last corner ends it");
  assert.deepEqual(marking.state.points[6], [40, 0]);
});

test("corners that the model has proposed do not bind", () => {
  const { marking, tracing } = begin({ 0: [0, 0], 4: [60, 0] }, { source: "proposal" });
  tracing.turn(CONTOURS[0]);
  for (const x of [10, 50]) click(tracing, [x, 8]);
  tracing.finish();
  assert.deepEqual([marking.state.points[0], marking.state.points[4]], [[10, 8], [50, 8]]);
  assert.equal(marking.state.source, "file");
});

test("the contour is that of the selected point, or the next one with a missing point", () => {
  const wanted = (points, active) => begin(points, { active }).tracing.wanted;
  assert.equal(wanted({}, 9), CONTOURS[2]);
  assert.equal(wanted({}, -1), CONTOURS[0]);
  assert.equal(wanted({ 0: [0, 0], 1: [1, 1], 2: [2, 2], 3: [3, 3], 4: [4, 4] }, 4), CONTOURS[1], "that of two which is not done");
  assert.equal(wanted({}, 12), CONTOURS[0], "two points make no curve, so the next one after them");
  const all = Object.fromEntries(Array.from({ length: N }, (_, i) => [i, [i, i]]));
  assert.equal(wanted(all, 13), null);
  assert.equal(wanted(all, 2), CONTOURS[0]);
});

test("places are undone, redone, removed and moved", () => {
  const { marking, tracing } = begin();
  tracing.turn(CONTOURS[0]);
  for (const x of [0, 10, 80]) click(tracing, [x, 0]);
  assert.equal(tracing.travel("undo"), "place on the curve");
  assert.deepEqual(tracing.points, [[0, 0], [10, 0]]);
  assert.deepEqual(marking.points[4], [10, 0]);
  tracing.travel("redo");
  tracing.drop();
  tracing.drop();
  assert.deepEqual(tracing.points, [[0, 0]]);
  assert.equal(marking.points[4], null);
  tracing.drop();
  tracing.drop();
  assert.deepEqual(tracing.points, []);
  tracing.travel("undo");
  tracing.preview([[5, 5]]); // while it is dragged
  assert.deepEqual(tracing.points, [[5, 5]]);
  tracing.preview(null);
  assert.deepEqual(tracing.points, [[0, 0]]);
});

test("Escape leaves without a change", () => {
  const { marking, tracing } = begin({ 1: [1, 1] });
  tracing.turn(CONTOURS[0]);
  for (const x of [0, 40]) click(tracing, [x, 0]);
  tracing.turn(false);
  assert.deepEqual(marking.points[1], [1, 1]);
  assert.equal(marking.history.steps, 0);
});

test("the present points are spaced evenly, and missing ones among them are placed", () => {
  const { marking, tracing } = begin({ 0: [0, 0], 1: [1, 0], 3: [3, 0], 4: [40, 0] });
  tracing.space(CONTOURS[0]);
  assert.deepEqual(marking.state.points.slice(0, 5), [[0, 0], [10, 0], [20, 0], [30, 0], [40, 0]]);
  assert.equal(marking.history.steps, 1);
});

test("tracing and spacing move semilandmarks only: a landmark that a person has placed stays", () => {
  const { marking, tracing } = begin({ 0: [0, 0], 1: [9, 9], 4: [40, 0] });
  tracing.turn(CONTOURS[0]);
  for (const x of [300, 400]) click(tracing, [x, 300]);
  tracing.finish();
  assert.deepEqual([0, 4].map((i) => marking.state.points[i]), [[0, 0], [40, 0]]);
  assert.notDeepEqual(marking.state.points[1], [9, 9]);
  const before = marking.state.points;
  marking.template.kinds = Array(N).fill("landmark");
  try {
    tracing.space(CONTOURS[0]);
    assert.equal(marking.state.points, before);
    assert.equal(tracing.mayChange(CONTOURS[0]), false);
  } finally {
    marking.template.kinds = KINDS;
  }
});

test("what a person traces is the person's own, and what is spaced through proposed points is not", () => {
  const { marking, tracing } = begin({ 0: [0, 0], 4: [40, 0] }, { source: "proposal" });
  tracing.turn(CONTOURS[0]);
  for (const x of [10, 50]) click(tracing, [x, 8]);
  tracing.finish();
  assert.deepEqual(marking.origins.slice(0, 5), Array(5).fill("placed"));
  const other = begin({ 7: [0, 0], 8: [10, 0], 9: [10, 10] }, { source: "proposal" });
  other.tracing.space(CONTOURS[2]);
  assert.deepEqual(other.marking.origins.slice(7, 11), Array(4).fill("proposed"));
});

test("undo of a traced contour brings back the points, and the point that was to be placed next", () => {
  const { marking, tracing } = begin({}, { active: 2 });
  tracing.turn(CONTOURS[0]);
  marking.select([]); // as the command does
  for (const x of [0, 40]) click(tracing, [x, 0]);
  tracing.finish();
  marking.travel("undo");
  assert.deepEqual([marking.active, marking.placing, marking.points[2], tracing.on], [2, true, null, false]);
});

test("undo before the first place leaves tracing and undoes the step before it", () => {
  const { marking, tracing } = begin({}, { active: 13 });
  const gesture = marking.adding([5, 5]);
  gesture.up();
  tracing.turn(CONTOURS[0]);
  click(tracing, [1, 1]);
  assert.equal(tracing.travel("undo"), "place on the curve");
  assert.equal(tracing.on, true);
  tracing.travel("undo");
  assert.deepEqual([tracing.on, marking.points[13], marking.active], [false, null, 13]);
  assert.equal(tracing.travel("undo"), null);
});

test("two points do not show how a contour runs", () => {
  const { marking, tracing } = begin({ 0: [0, 0], 4: [40, 0] });
  tracing.space(CONTOURS[0]);
  assert.equal(marking.history.steps, 0);
});
