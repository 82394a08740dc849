// The Live tab's pure parts. Run by test_live_module.py, by Node.

import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import test from "node:test";

import { FrameMeter } from "./modules/ui.js";
import { distanceOf, firstPair, isJump, parseRow, sentSize, Track, verdictOfFrame } from "./modules/live-track.js";

const [header, found, lost] = readFileSync(process.env.LIAAM_ROWS, "utf8").split(/(?<=\n)/);

test("large frames are sent smaller, at most 480,000 pixels", () => {
  assert.deepEqual(sentSize(640, 480), { width: 640, height: 480 });
  const { width, height } = sentSize(1920, 1080);
  assert.ok(width * height <= 480_000 && width * height > 470_000);
  assert.ok(Math.abs(width / height - 16 / 9) < 0.01);
});

test("the object is searched anew at first, after a pause, and after a step back", () => {
  assert.deepEqual([[null, 0], [1, 0.9], [1, 1], [1, 2]].map(([before, time]) => isJump(before, time)), [true, true, true, true]);
  assert.ok(!isJump(1, 1.04));
});

test("a row of the server is a fit", () => {
  const fit = parseRow(found);
  assert.deepEqual([fit.status, fit.fitStatus], ["found", "converged"]);
  assert.ok(fit.ok);
  assert.equal(fit.quality, 0.875);
  assert.deepEqual(fit.shape, [[1.5, 2], [3, 4.25]]);
  assert.deepEqual([fit.roll, fit.size, fit.centre], [90, 1.912, [2.25, 3.125]]);
  assert.deepEqual(fit.covariances, [[[0.5, 0.1], [0.1, 0.25]], [[2, 0], [0, 1]]]);
});

test("a lost frame has no points", () => {
  const fit = parseRow(lost);
  assert.deepEqual([fit.ok, fit.quality, fit.shape, fit.roll, fit.size], [false, null, [], null, null]);
});

test("the table is in the order of time, and frames are counted by the shortest interval", () => {
  const track = new Track(header);
  for (const time of [0.2, 0.04, 0.08]) track.set(time, found);
  track.set(0.08, lost); // seen once more
  assert.deepEqual([track.rows.size, track.lost, track.skipped], [3, 1, 2]);
  assert.match(track.gaps, /3 frames; 2 between them were skipped/);
  const lines = track.csv().split("\n");
  assert.equal(`${lines[0]}\n`, header);
  assert.deepEqual(lines.slice(1, 4).map((line) => line.split(",")[0]), ["0", "1", "4"]);
  assert.equal(lines[2].split(",")[2], "lost");
  assert.equal(track.at(0.0404), found);
  assert.equal(track.at(0.3), null);
});

test("a table of one frame, and of none", () => {
  const track = new Track(header);
  assert.equal(track.csv(), header);
  track.set(0, found);
  assert.deepEqual([track.skipped, Boolean(track.gaps)], [0, false]);
  assert.equal(track.csv().split("\n")[1].split(",")[0], "0");
});

test("the timeline has a mark for each frame", () => {
  const track = new Track(header);
  track.set(0, found);
  track.set(0.5, lost);
  track.set(1, found.replace("converged", "max iterations"));
  assert.deepEqual(track.marks(), [[0, "good"], [0.5, "bad"], [1, "warn"]]);
});

test("graphs show the rows of the table, in the order of time, with gaps where the object is lost", () => {
  const track = new Track(header);
  track.set(0.5, lost);
  track.set(0.25, found);
  track.set(0.75, found);
  const length = Math.hypot(1.5, 2.25);
  const values = [distanceOf([0, 1]), ({ roll }) => roll, ({ quality }) => quality];
  assert.deepEqual(track.graphs(values), [
    [0.25, 0.5, 0.75], [length, null, length], [90, null, 90], [0.875, null, 0.875],
  ]);
  assert.deepEqual(track.graphs(values, 0.6), [[0.75], [length], [90], [0.875]]);
  assert.equal(track.end, 0.75);
});

test("what was not watched is a gap, and not skipped", () => {
  const track = new Track(header);
  for (const time of [0, 0.04, 0.12]) track.set(time, found);
  const { run } = track;
  track.leap();
  track.set(0.16, found, run); // was on its way
  for (const time of [60, 60.04]) track.set(time, found);
  track.leap();
  track.set(0.2, found); // played on from the first frames
  assert.deepEqual(track.graphs([({ roll }) => roll]), [
    [0, 0.04, 0.12, 0.16, 0.2, 30.1, 60, 60.04], [90, 90, 90, 90, 90, null, 90, 90],
  ]);
  assert.equal(track.skipped, 1); // at 0.08
});

test("the first distance is one that was measured before, or the first that the model has", () => {
  const names = ["brow", "chin", "nose"];
  assert.deepEqual(firstPair(names, [["lip", "chin"], ["nose", "brow"]]), [2, 0]);
  assert.deepEqual(firstPair(names, [["2", "3"]]), [1, 2]);
  assert.deepEqual(firstPair(names, [["1", "9"], ["chin", "chin"]]), [0, 1]);
  assert.deepEqual(firstPair(names, []), [0, 1]);
});

test("advice is for a camera or for a file, and only about what is known", () => {
  const [frame, gone] = [found, lost].map((row) => ({ fit: parseRow(row), flat: null, asked: false }));
  const said = (shown, of = {}) => verdictOfFrame(shown, { isFile: false, isFlat: false, rate: null, ...of }).text;
  assert.match(said(gone), /facing the camera/);
  assert.equal(said(gone, { isFile: true }), "The object is lost in this frame.");
  assert.equal(said(gone, { isFile: true, object: "face", wasFound: false }), "No face was found yet.");
  assert.equal(said(frame), "The object is found, quality 88 %.");
  const kind = verdictOfFrame(frame, { isFile: false, isFlat: false, rate: null }).kind;
  assert.equal(kind, "good"); // by the status of the fit, not by that of the track
  assert.equal(said(frame, { isFlat: true }), said(frame)); // the frame was sent before
  assert.match(said({ ...frame, asked: true }, { isFlat: true }), /must have colour/);
  assert.match(said(frame, { rate: 7.25 }), /slow: 7.3 frames/);
  assert.equal(said(frame, { rate: 25 }), said(frame));
});

test("the speed is not known before enough frames were counted, nor after a pause", () => {
  const meter = new FrameMeter(3, Infinity);
  for (const time of [0, 1000, 2000]) {
    assert.ok(!meter.isFull);
    meter.tick(time);
  }
  assert.ok(meter.isFull);
  assert.equal(meter.rate(), 1);
  meter.reset();
  assert.deepEqual([meter.isFull, meter.rate()], [false, 0]);
});
