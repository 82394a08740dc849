// The Fit and Compare tabs' pure parts. Run by test_fit_modules.py, by Node.

import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { test } from "node:test";

import { fileNameIn } from "./modules/api.js";
import { shareAfterKey } from "./modules/divider.js";
import {
  betterOf, cleaned, comparison, duration, factsOf, FitStore, kindOf, meanDistance, objectOf, reducedText, significant, verdictOf,
} from "./modules/fit-run.js";
import { relativeCosts } from "./modules/fit-iterations.js";
import { FrameMeter } from "./modules/ui.js";
import { specimenText, useAsAnnotation } from "./modules/fit-setup.js";
import { createSideList, sidesInWords } from "./modules/sides.js";
import { Sources } from "./modules/fit-source.js";
import { boxAfterKey, boxBetween, boxMoved, BoxTool, isDrawn, MeanTool } from "./modules/fit-start.js";
import * as inv from "./modules/fit-theta.js";
import { directionAfterKey, directionAt, directionInWords, freePlace, lightQuery, PRESETS } from "./modules/relight.js";
import { State } from "./modules/state.js";
import { levelFor, Tiles, tilesIn } from "./modules/tiles.js";

const close = (a, b, tolerance = 1e-6) => assert.ok(Math.abs(a - b) <= tolerance, `${a} is not ${b}`);
const closePoints = (a, b, tolerance = 1e-6) => a.forEach((p, i) => p.forEach((v, k) => close(v, b[i][k], tolerance)));

function buffer(width, height, pairs) {
  const bytes = new ArrayBuffer(16 + 4 * width * height);
  new Uint32Array(bytes, 0, 2).set([width, height]);
  new Int16Array(bytes, 16).set(pairs.flat());
  return bytes;
}

const level = (pixel) => pixel & 255;

// Invariant image

test("the invariant image is liaam's own, at each angle", () => {
  const folder = process.env.LIAAM_INVARIANT;
  const bytes = readFileSync(`${folder}/chroma.bin`);
  const chroma = inv.parseChroma(bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.byteLength));
  const cases = JSON.parse(readFileSync(`${folder}/expected.json`, "utf8"));
  const out = new Uint32Array(chroma.width * chroma.height);
  assert.ok(cases.length >= 3);
  for (const { theta, values } of cases) {
    assert.equal(values.length, out.length);
    const range = inv.robustRange(inv.sampleChroma(chroma), theta);
    inv.paintInvariant(chroma, theta, range, inv.COLOURS.grey, out);
    let seen = 0;
    values.forEach((value, i) => {
      if (value === null) {
        assert.equal(chroma.values[2 * i], inv.MASKED);
        return;
      }
      seen += 1;
      const wanted = Math.min(255, Math.max(0, 128 + (128 * (value - range.centre)) / range.half));
      // 16 bits of log-chromaticity leave a small part of a grey level.
      assert.ok(Math.abs(level(out[i]) - wanted) < 1.2, `pixel ${i} at ${theta}: ${level(out[i])} for ${wanted}`);
    });
    assert.ok(seen > 0.2 * values.length);
  }
});

test("pixels that cannot be measured are hatched, never black", () => {
  const chroma = inv.parseChroma(
    buffer(
      16,
      1,
      Array.from({ length: 16 }, () => [inv.MASKED, inv.MASKED]),
    ),
  );
  const out = new Uint32Array(16);
  inv.paintInvariant(chroma, 1, inv.robustRange(inv.sampleChroma(chroma), 1), inv.COLOURS.grey, out);
  assert.equal(new Set(out).size, 2);
  for (const pixel of out) assert.ok(level(pixel) > 30 && pixel >>> 24 === 255);
  assert.equal(inv.measurable(chroma), 0);
});

test("chroma that is cut short is refused with a remedy", () => {
  assert.throws(() => inv.parseChroma(new ArrayBuffer(3)), /reload/);
  assert.throws(
    () =>
      inv.parseChroma(
        buffer(2, 2, [
          [1, 1],
          [1, 1],
          [1, 1],
          [1, 1],
        ]).slice(0, 20),
      ),
    /20 bytes instead of 32/,
  );
});

test("contrast is held while theta moves, and outliers do not set it", () => {
  const pairs = Array.from({ length: 1000 }, (_, i) => [i === 0 ? 32000 : i, 2 * i]);
  const sample = inv.sampleChroma(inv.parseChroma(buffer(100, 10, pairs)));
  const held = inv.robustRange(sample, 0);
  assert.ok(held.half < 0.6 * (1000 / inv.STEPS));
  for (const theta of [0.1, 1, 2]) assert.equal(inv.steadyRange(sample, theta, held).half, held.half);
  const flat = inv.sampleChroma(
    inv.parseChroma(
      buffer(
        10,
        10,
        Array.from({ length: 100 }, () => [7, 7]),
      ),
    ),
  );
  assert.ok(inv.robustRange(flat, 1).half >= 0.02);
});

test("the sample does not look at a few columns only", () => {
  const [width, height] = [640, 480];
  const pairs = Array.from({ length: width * height }, (_, i) => [i % width, 0]);
  const columns = new Set(inv.sampleChroma(inv.parseChroma(buffer(width, height, pairs))).red);
  assert.ok(columns.size > 500, `${columns.size} columns`);
});

test("colour tables go from their first to their last colour", () => {
  assert.equal(inv.COLOURS.grey[0], 0xff000000);
  assert.equal(inv.COLOURS.grey[255], 0xffffffff);
  assert.equal(inv.COLOURS.viridis[0], 0xff540144);
  assert.equal(inv.COLOURS.viridis[255], 0xff25e7fd);
});

test("keys move theta by one degree, with shift by a tenth, within 0 to 180", () => {
  assert.equal(inv.thetaAfterKey(120, { key: "ArrowRight" }), 121);
  assert.equal(inv.thetaAfterKey(120, { key: "ArrowLeft", shiftKey: true }), 119.9);
  assert.equal(inv.thetaAfterKey(179.5, { key: "ArrowUp" }), 180);
  assert.equal(inv.thetaAfterKey(0, { key: "ArrowDown" }), 0);
  assert.equal(inv.thetaAfterKey(5, { key: "a" }), null);
  close(inv.foldedTheta(-62), 118);
  close(inv.foldedTheta(298), 118);
});

// Scheduling

const settled = () =>
  new Promise((resolve) => {
    setImmediate(resolve);
  });

test("frames are counted over one drag", () => {
  const meter = new FrameMeter();
  assert.equal(meter.rate(), 0);
  for (const time of [0, 20, 40]) meter.tick(time);
  close(meter.rate(), 50);
  for (const time of [5000, 5100]) meter.tick(time);
  close(meter.rate(), 10);
});

// Geometry

test("a place over the ball is a direction, never behind the object", () => {
  assert.deepEqual(directionAt([0, 0]), [0, 0, 1]);
  const direction = directionAt([0.3, -0.4]);
  close(Math.hypot(...direction), 1);
  closePoints([direction.slice(0, 2)], [[0.3, -0.4]]);
  const grazing = directionAt([100, 0]);
  close(Math.hypot(...grazing), 1);
  assert.ok(grazing[0] > 0.99 && grazing[2] > 0 && grazing[2] < 0.1);
});

test("lights are sent with colours as numbers, and presets are valid", () => {
  const lamp = { direction: [0, -0.5, 0.866025], colour: "#ff8000", strength: 1.5, softness: 0.25 };
  const { light, size } = lightQuery({ lamps: [lamp], ambient: 0.25 }, 640);
  assert.equal(size, 640);
  assert.deepEqual(JSON.parse(light), {
    lamps: [{ direction: [0, -0.5, 0.866], colour: [1, 0.502, 0], strength: 1.5, softness: 0.25 }], ambient: 0.25,
  });
  for (const { lamps, ambient } of Object.values(PRESETS)) {
    assert.ok(ambient >= 0 && ambient <= 1 && lamps.length);
    for (const { direction, colour, strength, softness } of lamps) {
      close(Math.hypot(...direction), 1);
      assert.match(colour, /^#[0-9a-f]{6}$/);
      assert.ok(strength > 0 && strength <= 3 && softness >= 0 && softness <= 1);
    }
  }
});

test("a light is told in words, and moved by keys", () => {
  assert.equal(directionInWords([0, 0, 1]), "from the front");
  assert.match(directionInWords([-0.5, -0.5, Math.SQRT1_2]), /^from the upper left, 45°/);
  assert.match(directionInWords([0, 0.6, 0.8]), /^from the bottom/);
  const [x] = directionAfterKey([0, 0, 1], { key: "ArrowRight" });
  assert.ok(x > 0);
  assert.equal(directionAfterKey([0, 0, 1], { key: "q" }), null);
  assert.deepEqual(directionAfterKey([0.5, 0, 0.8], { key: "Home" }), [0, 0, 1]);
});

test("a box is what was drawn, in whatever direction, within the picture", () => {
  const box = boxBetween([50, -20], [10, 30], 100, 80);
  assert.deepEqual(box, [10, 0, 50, 30]);
  assert.ok(isDrawn(box) && !isDrawn([1, 1, 4, 40]));
  assert.deepEqual(boxMoved(box, [-30, 5], 100, 80), [0, 5, 40, 35]);
  assert.deepEqual(boxAfterKey(box, { key: "ArrowRight", shiftKey: true }, 100, 80), [20, 0, 60, 30]);
  assert.ok(isDrawn(boxAfterKey(null, { key: "." }, 100, 80)));
  assert.equal(boxAfterKey(box, { key: "x" }, 100, 80), null);
});

/** A viewer of a picture of 200 x 100 pixels at a scale of 2. */
const viewer = {
  width: 200, height: 100, scale: 2, redraw() {}, toScreen: ([x, y]) => [2 * x, 2 * y],
  toImage: ([x, y]) => [x / 2, y / 2], place: ({ at }) => at,
};

/** Drag from one position in the picture to another; returns whether the tool took the press. */
function drag(tool, from, to, event = {}) {
  const [press, release] = [from, to].map((xy) => ({ ...event, pointerType: "mouse", at: viewer.toScreen(xy) }));
  if (!tool.down(press, from)) return false;
  tool.move(release, to);
  tool.up(release, to);
  return true;
}

test("the mean shape is placed in the picture, and dragged, scaled and rotated by its frame", () => {
  const tool = new MeanTool(viewer);
  assert.deepEqual([tool.start, tool.key({ key: "ArrowUp" }), drag(tool, [100, 50], [1, 1])], [null, false, false]);
  tool.use({ mean: [[-1, -2], [1, -2], [1, 2], [-1, 2]], contours: [], triangles: [] });
  const first = [[85, 20], [115, 20], [115, 80], [85, 80]];
  closePoints(tool.start.shape, first);
  assert.equal(tool.cursor({ at: [200, 100], pointerType: "mouse" }), "move");
  assert.ok(drag(tool, [100, 50], [110, 45]));
  closePoints(tool.start.shape, first.map(([x, y]) => [x + 10, y - 5]));
  assert.ok(!drag(tool, [10, 10], [20, 20]));
  tool.clear();
  assert.ok(drag(tool, [100, 20 - 8 - 13], [151, 50])); // from the knob above the frame, by a quarter
  closePoints([tool.start.shape[0]], [[130, 35]], 0.02);
  tool.clear();
  const corner = [115 + 8, 80 + 8];
  assert.equal(tool.cursor({ at: viewer.toScreen(corner), pointerType: "mouse" }), "nwse-resize");
  assert.ok(drag(tool, corner, [77 + 2 * 46, 12 + 2 * 76]));
  closePoints(tool.start.shape, first.map(([x, y]) => [77 + 2 * (x - 77), 12 + 2 * (y - 12)]), 0.02);
});

test("keys move, scale and rotate the mean shape, which hides the fit until it is fitted", () => {
  const tool = new MeanTool(viewer);
  tool.use({ mean: [[-1, -2], [1, -2], [1, 2], [-1, 2]], contours: [], triangles: [] });
  tool.showFit(true);
  assert.ok(!tool.hidesFit && !tool.key({ key: "z" }));
  assert.ok(tool.key({ key: "ArrowUp", shiftKey: true }) && tool.hidesFit);
  closePoints([tool.start.shape[0]], [[85, 10]]);
  tool.key({ key: ">", shiftKey: true });
  closePoints([tool.start.shape[0]], [[83.5, 7]]);
  tool.clear();
  for (let i = 0; i < 9; i += 1) tool.key({ key: "}", shiftKey: true });
  closePoints([tool.start.shape[0]], [[130, 35]], 0.1);
});

test("a click on the mean shape keeps the fit in sight, and it cannot be shrunk to nothing", () => {
  const tool = new MeanTool(viewer);
  tool.use({ mean: [[-1, -2], [1, -2], [1, 2], [-1, 2]], contours: [], triangles: [] });
  tool.showFit(true);
  const event = { pointerType: "mouse", at: viewer.toScreen([100, 50]) };
  assert.ok(tool.down(event, [100, 50]));
  tool.up();
  assert.ok(tool.down(event, [100, 50]));
  tool.cancel();
  assert.ok(!tool.hidesFit);
  for (let i = 0; i < 60; i += 1) tool.key({ key: "<", shiftKey: true });
  const [[x0, y0], , [x1, y1]] = tool.start.shape;
  assert.ok(y1 - y0 >= 12 && Math.abs((y1 - y0) / (x1 - x0) - 2) < 0.01);
});

test("a box is drawn, moved and resized by its corners; a click draws none", () => {
  const made = [];
  const tool = new BoxTool(viewer, () => made.push(tool.box));
  drag(tool, [50, 50], [51, 51]);
  assert.deepEqual([tool.start, made], [null, []]);
  drag(tool, [50, 60], [10, 20]);
  assert.deepEqual(tool.start, { box: [10, 20, 50, 60] });
  drag(tool, [30, 40], [35, 45]);
  drag(tool, [15, 25], [20, 30]);
  assert.deepEqual(made, [[10, 20, 50, 60], [15, 25, 55, 65], [20, 30, 55, 65]]);
});

test("costs are drawn by level, each to its own scale", () => {
  const steps = [
    [0, 10],
    [0, 5],
    [1, 400],
    [1, 300],
    [1, 200],
    [2, 7],
  ].map(([stage, cost]) => ({ level: stage, cost }));
  assert.deepEqual(relativeCosts(steps), [1, 0, 1, 0.5, 0, 0]);
  assert.deepEqual(relativeCosts([{ level: 0, cost: null }, { level: 0, cost: 3 }, { level: 0, cost: NaN }]), [0, 0, 0]);
  assert.deepEqual(relativeCosts([]), []);
});

test("distances leave out what either shape lacks", () => {
  close(
    meanDistance(
      [[0, 0], [3, 4], null],
      [
        [0, 2],
        [0, 0],
        [9, 9],
      ],
    ),
    3.5,
  );
  assert.ok(Number.isNaN(meanDistance([null], [[1, 1]])));
});

test("the divider's keys stay within the picture", () => {
  close(shareAfterKey(0.5, { key: "ArrowLeft" }), 0.48);
  assert.equal(shareAfterKey(0.95, { key: "ArrowRight", shiftKey: true }), 1);
  assert.equal(shareAfterKey(0.5, { key: "Home" }), 0);
  assert.equal(shareAfterKey(0.5, { key: "Tab" }), null);
});

// What is said

const fit = (changes = {}) => ({
  id: "1",
  method: "soft-li",
  ok: true,
  status: "converged",
  message: "",
  quality: 0.93,
  seconds: { search: 0.04, fit: 1.23 },
  theta_deg: 118.04,
  found: { score: 1, doubtful: false },
  shape: [[1, 2]],
  covariances: [
    [
      [1, 0],
      [0, 1],
    ],
  ],
  iterations: [],
  error: null,
  ...changes,
});

test("a fit that failed or is doubtful says what to do", () => {
  assert.equal(verdictOf(fit()).advice, "");
  assert.equal(verdictOf(fit()).kind, "good");
  assert.equal(specimenText(fit({ specimen: { name: "tray#2", number: 2, fault: "" } })), `tray#2: ${verdictOf(fit()).title}`);
  const doubt = verdictOf(fit({ found: { score: 0.1, doubtful: true } }));
  assert.match(doubt.title, /search uncertain$/);
  assert.match(doubt.advice, /box/);
  const failed = verdictOf(fit({ ok: false, status: "diverged" }));
  assert.equal(failed.kind, "bad");
  assert.match(failed.advice, /mean shape/);
  assert.match(verdictOf(fit({ n_found: 3 })).advice, /^2 more objects in the picture/);
  assert.match(verdictOf(fit({ n_found: 2 }), false, "face").advice, /^1 more face in the picture. Fit all/);
  assert.equal(verdictOf(fit({ n_found: 1 })).advice, "");
  assert.equal(verdictOf(fit({ found: null })).kind, "good");
  assert.equal(verdictOf(fit()).title, "converged, quality 93 %");
  assert.equal(verdictOf(fit({ quality: null })).title, "converged, quality unknown");
  assert.ok(!JSON.stringify(factsOf(fit({ theta_deg: 118 }), false)).includes("θ"));
  assert.equal(verdictOf(fit(), false).title, "Quality 93 %");
  const unfinished = verdictOf(fit({ ok: false, status: "max iterations" }), false);
  assert.deepEqual([unfinished.kind, unfinished.title], ["warn", "not finished"]);
});

test("where neither search nor fit find an object, the page says so, and not that a fit converged", () => {
  const nothing = fit({ ok: false, status: "doubtful", quality: 0, nothing_found: true });
  const { title, advice } = verdictOf(nothing, false, objectOf({ source: "face" }));
  assert.equal(title, "No face found");
  assert.match(advice, /If there is a face, draw a box/);
  assert.equal(verdictOf(nothing, false, objectOf({ source: "studio" })).title, "No object found");
  assert.equal(verdictOf({ ...nothing, nothing_found: false }, false).title, "doubtful");
});

test("specimens that were fitted together are recalled with the one that was chosen last", async () => {
  const state = Object.assign(new EventTarget(), { project: { model: { number: 1 } }, send: () => Promise.resolve({ fits: both, faults: [] }) });
  const both = [1, 2].map((number) => fit({ id: String(number), picture: "tray.jpg", specimen: { number, name: `tray#${number}`, fault: "" } }));
  const [store, source] = [new FitStore(state), { key: "tray", ready: Promise.resolve(), reference: { picture: "tray.jpg" } }];
  const all = await store.runAll(source, "soft-li", "auto");
  assert.equal(store.recallAll(source, "soft-li"), all);
  store.choose(source, "soft-li", "auto", all.fits[1]);
  assert.equal(store.recall(source, "soft-li"), all.fits[1]);
  assert.equal(store.recallAll({ ...source, key: "other" }, "soft-li"), null);
  store.forget(all.fits[0]);
  assert.equal(store.recallAll(source, "soft-li"), null);
  await store.runAll(source, "soft-li", "auto");
  state.dispatchEvent(new CustomEvent("landmarks", { detail: { name: "tray.jpg" } }));
  assert.equal(store.recallAll(source, "soft-li"), null);
});

test("no new lamp lies on another one", () => {
  const lamps = [{ direction: directionAt([-0.55, -0.5]) }];
  while (lamps.length < 8) {
    const { direction: [x] } = lamps.at(-1);
    const place = freePlace(lamps, [-x || 0.5, -0.2]);
    assert.ok(Math.hypot(...place) <= 1);
    for (const { direction: [u, v] } of lamps) assert.ok(Math.hypot(place[0] - u, place[1] - v) > 0.25, String(lamps.length));
    lamps.push({ direction: directionAt(place) });
  }
});

test("the colour of a fit follows from its status alone, as in overlays", () => {
  const expected = JSON.parse(readFileSync(`${process.env.LIAAM_INVARIANT}/kinds.json`, "utf8"));
  for (const [status, { kind, ok }] of Object.entries(expected)) {
    assert.equal(kindOf(status), kind, status);
    for (const quality of [0.3, 0.9, null]) assert.equal(verdictOf(fit({ status, ok, quality })).kind, kind, status);
  }
  assert.ok(Object.keys(expected).length > 5);
});

test("numbers are told in people's units", () => {
  assert.deepEqual([duration(0.0384), duration(1.26), duration(NaN)], ["38 ms", "1.3 s", "–"]);
  assert.deepEqual(
    [significant(12.3456), significant(0), significant(null), significant(0.00001234)],
    ["12.3", "0", "–", "1.23e-5"],
  );
  assert.deepEqual(factsOf(fit({ error: { pixels: 1.234, percent: 0.4 } })), [
    ["Quality", "93 %"],
    ["Error", "1.23 px (0.4 %)"],
    ["θ", "118.0°"],
    ["Time", "40 ms search + 1.2 s fit"],
  ]);
  assert.deepEqual(factsOf(fit({ quality: null, theta_deg: null, seconds: { search: 0, fit: 0.01 } })), [
    ["Quality", "unknown"],
    ["Time", "10 ms"],
  ]);
});

test("the comparison names which is nearer, and says when nobody knows", () => {
  const near = fit({ error: { pixels: 1, percent: 0.5 } });
  const far = fit({ method: "rgb", error: { pixels: 3, percent: 1.5 } });
  assert.equal(comparison(near, far, 2), "soft-li is closer to the landmarks: 1 px (0.5 %), rgb: 3 px (1.5 %).");
  assert.equal(comparison(far, near, 2), comparison(near, far, 2));
  assert.match(comparison(near, near, 0), /^Equal errors/);
  assert.match(comparison({ ...near, trained_on: true }, far, 2), /trained on this picture/);
  assert.equal(betterOf(near, far), near);
});

test("landmarks that are a fit's own do not tell which fit is better", () => {
  const own = fit({ error: { pixels: 0.004, percent: 0.001 } });
  const other = fit({ method: "rgb", error: { pixels: 3, percent: 1.5 } });
  assert.match(comparison(own, other, 3), /^The landmarks come from the fit with soft-li.*3 px apart/);
  assert.equal(comparison(other, own, 3), comparison(own, other, 3));
  assert.equal(betterOf(own, other), null);
});

test("without landmarks, fits are compared by their quality", () => {
  const [good, poor] = [fit({ quality: 0.9 }), fit({ method: "rgb", quality: 0.6 })];
  assert.match(comparison(poor, good, 2.5), /soft-li is more likely to be right: quality 90 %, rgb: 60 %.*2.5 px apart/);
  assert.equal(betterOf(poor, good), good);
  assert.match(comparison(good, good, 0), /equal quality: 90 %/);
  assert.equal(betterOf(good, good), null);
  const unknown = fit({ method: "grey", quality: null });
  assert.match(comparison(good, unknown, 2.5), /the quality of grey is unknown/);
  assert.equal(comparison(null, good, 2), "");
});

test("points that are not finite become null", () => {
  const { shape, covariances, iterations } = cleaned(
    fit({
      shape: [
        [1, null],
        [2, 3],
      ],
      covariances: [
        [
          [null, 1],
          [1, 2],
        ],
      ],
      iterations: [{ level: 0, cost: 1, shape: [[null, null]] }],
    }),
  );
  assert.deepEqual(shape, [null, [2, 3]]);
  assert.deepEqual(covariances, [null]);
  assert.deepEqual(iterations[0].shape, [null]);
});

test("a fit is remembered by picture, method, side and model only", async () => {
  const state = Object.assign(new EventTarget(), {
    project: { model: { number: 1 } },
    send: (request) => request("here"),
  });
  const source = { key: "picture a", ready: Promise.resolve(), reference: { picture: "a" }, takeFit: () => null };
  const sent = [];
  globalThis.fetch = async (address, { body }) => {
    sent.push([address, JSON.parse(body)]);
    return new Response(JSON.stringify(fit({ picture: "a" })), { status: 200 });
  };
  const store = new FitStore(state);
  const made = await store.run(source, "soft-li", { box: [0, 0, 9, 9] });
  const asked = { picture: "a", method: "soft-li", start: { box: [0, 0, 9, 9] }, side: "auto", folder: "here" };
  assert.deepEqual(sent, [["/api/fits", asked]]);
  assert.equal(store.recall(source, "soft-li"), made);
  assert.equal(store.recall(source, "rgb"), null);
  assert.equal(store.recall(source, "soft-li", "left"), null);
  state.project.model.number = 2;
  assert.equal(store.recall(source, "soft-li"), null);
  state.project.model.number = 1;
  store.forget(made);
  assert.equal(store.recall(source, "soft-li"), null);
  await store.run(source, "soft-li");
  state.dispatchEvent(Object.assign(new Event("landmarks"), { detail: { name: "another" } }));
  assert.notEqual(store.recall(source, "soft-li"), null);
  state.dispatchEvent(Object.assign(new Event("landmarks"), { detail: { name: "a" } }));
  assert.equal(store.recall(source, "soft-li"), null);
});

test("a fit that is answered after its landmarks or its model have changed is not kept as theirs", async () => {
  const state = Object.assign(new EventTarget(), {
    project: { model: { number: 1 } },
    send: (request) => request("here"),
  });
  const source = { key: "picture a", name: "a", ofFolder: true, ready: Promise.resolve(), reference: { picture: "a" }, takeFit: () => null };
  const answers = [];
  globalThis.fetch = () => new Promise((resolve) => {
    answers.push(() => resolve(new Response(JSON.stringify(fit({ picture: "a" })), { status: 200 })));
  });
  const store = new FitStore(state);
  const first = store.run(source, "soft-li");
  await settled();
  state.dispatchEvent(Object.assign(new Event("landmarks"), { detail: { name: "a" } }));
  const second = store.run(source, "soft-li");
  await settled();
  answers[0]();
  await first;
  assert.equal(store.recall(source, "soft-li"), null);
  state.project.model.number = 2;
  answers[1]();
  const made = await second;
  assert.equal(store.recall(source, "soft-li"), null);
  state.project.model.number = 1;
  assert.equal(store.recall(source, "soft-li"), made);
});

test("the picture that is selected is shown, although another one was opening", async () => {
  const opening = new Map(); // name -> end its loading
  const load = (name) => new Promise((resolve) => opening.set(name, () => resolve({ bitmap: name, width: 5, height: 5 })));
  globalThis.createImageBitmap = () => settled().then(() => ({ width: 3, height: 2 }));
  globalThis.fetch = async () => new Response('{"id": "u1", "width": 6, "height": 4}', { status: 200 });
  const state = Object.assign(new EventTarget(), { current: "a", project: { limits: { upload_bytes: 9 } } });
  state.picture = () => ({ tag: "1" });
  const sources = new Sources(state, { fetch: load });
  const select = (name) => { state.current = name; state.dispatchEvent(new Event("select")); };
  sources.watch("fit");
  opening.get("a")();
  await settled();
  assert.equal(sources.current.name, "a");
  select("b");
  select("a");
  opening.get("b")();
  await settled();
  assert.equal(sources.current.name, "a");
  const taken = sources.take({ name: "new.png", size: 5 });
  state.dispatchEvent(new Event("project")); // must not drop the file
  await taken;
  assert.deepEqual([sources.current.name, sources.current.width, sources.current.ofFolder], ["new.png", 6, false]);
  state.dispatchEvent(new Event("project"));
  assert.equal(sources.current.name, "new.png");
  let isClosed = false;
  sources.current.show({}, 6, 4, { close: () => { isClosed = true; } }); // of a large file
  sources.backToFolder();
  assert.ok(isClosed);
});

test("a file that the server refuses does not stay, although the browser can show it", async () => {
  const state = Object.assign(new EventTarget(), { current: "a", project: { limits: { upload_bytes: 9 } } });
  state.picture = () => ({ tag: "1" });
  const sources = new Sources(state, { fetch: async (name) => ({ bitmap: name, width: 5, height: 5 }) });
  const shown = [];
  sources.addEventListener("change", () => shown.push(sources.current?.name));
  sources.addEventListener("failed", ({ detail }) => shown.push(detail.error.message));
  sources.watch("fit");
  await settled();
  globalThis.createImageBitmap = async () => ({ width: 3, height: 2 });
  globalThis.fetch = async () => {
    await settled();
    return new Response('{"error": "moving.gif has several frames"}', { status: 422 });
  };
  await sources.take({ name: "moving.gif", size: 5 });
  assert.deepEqual(shown, ["a", "moving.gif", "a", "moving.gif has several frames"]);
  state.dispatchEvent(new Event("project"));
  assert.equal(sources.current.name, "a");
});

test("a fit that becomes the landmarks is saved in the name of the person", async () => {
  globalThis.localStorage = { getItem: () => "Ann" };
  const { app, sent } = pageWith({ source: "file", points: [[0, 0]], invisible: [0], revision: "r" });
  await useAsAnnotation(app, { picture: "a.png", shape: [[1, 2]] });
  const body = { points: [[1, 2]], origins: ["accepted"], invisible: [0], revision: "r", template: "t", folder: "here", who: "Ann" };
  assert.deepEqual(sent, [["/api/pictures/a.png/landmarks", body]]);
  app.confirm = async () => false;
  await useAsAnnotation(app, { picture: "a.png", shape: [[1, 2]] });
  assert.equal(sent.length, 1);
});

/** The app of a page whose server has these marks, and the bodies that are sent to it. */
function pageWith(marks) {
  const [state, sent] = [new State({ id: "here", pictures: [], template: { revision: "t" } }), []];
  globalThis.fetch = async (address, { method, body }) => {
    if (method === "PUT") sent.push([address, JSON.parse(body)]);
    return new Response(JSON.stringify(method === "PUT" ? { picture: { name: "a.png" } } : marks), { status: 200 });
  };
  return { app: { state, confirm: async () => true, toast() {} }, sent };
}

test("chroma says how much of the picture it covers", () => {
  const bytes = new ArrayBuffer(16 + 4 * 2);
  new Uint32Array(bytes, 0, 2).set([2, 1]);
  new Float32Array(bytes, 8, 2).set([1001, 996.5]);
  new Int16Array(bytes, 16).set([1, 2, 3, inv.MASKED]);
  const chroma = inv.parseChroma(bytes);
  assert.deepEqual([chroma.width, chroma.height, chroma.covered], [2, 1, [1001, 996.5]]);
  assert.deepEqual([...chroma.values], [1, 2, 3, inv.MASKED]);
});

test("a file is called what the server says", () => {
  assert.equal(fileNameIn("attachment; filename=\"a.png\"; filename*=UTF-8''%C3%A4%3B.png"), "ä;.png");
  assert.equal(fileNameIn(null), "file");
});

test("a view needs the tiles that it shows, of the level that its zoom needs", () => {
  assert.deepEqual([levelFor(1), levelFor(2), levelFor(0.25), levelFor(0.25, 2), levelFor(0.01)], [0, 0, 2, 1, 7]);
  assert.deepEqual(tilesIn([0, 0, 1000, 500], 0, 1300, 700), [[0, 0], [1, 0]]);
  assert.deepEqual(tilesIn([-50, 600, 3000, 900], 1, 1300, 700), [[0, 0], [1, 0]]);
  assert.deepEqual(tilesIn([1300, 0, 1500, 100], 0, 1300, 700), []);
});

test("tiles are asked for from the middle of the view, and drawn once they are there", async () => {
  const asked = [];
  const drawn = [];
  const waiting = [];
  const tiles = new Tiles(4096, 4096, 256, (...tile) => {
    asked.push(tile.join("/"));
    return new Promise((done) => waiting.push(() => done({ width: 512, height: 512, close() {} })));
  });
  const ctx = {
    getTransform: () => ({ a: 1, d: 1, e: 0, f: 0 }), canvas: { width: 1536, height: 512 },
    drawImage: (_, ...place) => drawn.push(place.join(" ")),
  };
  const view = { scale: 1, left: 0, top: 0 };
  tiles.draw(ctx, view);
  assert.equal(asked[0], "0/1/0");
  assert.deepEqual([drawn, tiles.cover(ctx, view)], [[], false]);
  while (waiting.length) {
    waiting.shift()();
    await new Promise((done) => setTimeout(done));
  }
  assert.ok(tiles.cover(ctx, view));
  tiles.draw(ctx, view);
  assert.ok(drawn.includes("512 0 512 512"));
  tiles.close();
  assert.equal(tiles.cover(ctx, view), false);
});

test("what training did about sides is told", () => {
  const told = (own, other, nOther) => sidesInWords({ own, other, n_own: 7, n_other: nOther });
  assert.equal(told("right", "left", 2), "2 of 9 training pictures were left, and reflected to be right.");
  assert.equal(told("original", "mirrored", 1), "1 of 8 training pictures was mirrored, and reflected.");
  assert.equal(told("right", "left", 0), "All training pictures are right.");
});

test("a side that could not be saved is not shown as said", async () => {
  const made = [];
  globalThis.document = /** @type {any} */ ({
    createElement(tag) {
      const element = Object.assign(new EventTarget(), { tag, dataset: {}, append() {}, setAttribute() {} });
      made.push(element);
      return element;
    },
  });
  const picture = { name: "a.png", side: "left" };
  const state = Object.assign(new EventTarget(), {
    project: { model: null, pictures: [picture] }, current: picture.name, readOnly: false, picture: () => picture,
    send: () => Promise.reject(new Error("no connection")),
  });
  const told = [];
  const api = { url: () => "", get: () => Promise.reject(new Error("no connection")) };
  createSideList({ app: { api, state, toast: (error) => told.push(error.message) }, state });
  const list = made.find(({ tag }) => tag === "select");
  list.value = "right";
  list.dispatchEvent(new Event("change"));
  await new Promise((resolve) => setTimeout(resolve));
  delete globalThis.document;
  assert.equal(list.value, "left");
  assert.deepEqual(told, ["no connection"]);
});

test("a picture that is not saved whole is said to be reduced", () => {
  assert.match(reducedText({ width: 3688, height: 4920 }, 16_000_000), /has 18.1 million pixels, and is saved with 16 million/);
  assert.deepEqual([reducedText({ width: 4000, height: 4000 }, 16_000_000), reducedText(null, 1)], ["", ""]);
});
