// The Annotate tab's parts that need no page: points, undo, saving, templates, and when to train.
// Run by test_annotate_modules.py, by Node.

import assert from "node:assert/strict";
import { test } from "node:test";

import { nameIn } from "./modules/state.js";
import * as assist from "./modules/assist.js";
import { loupePlace } from "./modules/drawing.js";
import { shownValue } from "./modules/look.js";
import { History } from "./modules/history.js";
import * as points from "./modules/points.js";
import { contentOf, Saver } from "./modules/saving.js";
import { State } from "./modules/state.js";
import * as template from "./modules/template.js";
import { complaints } from "./modules/ui.js";
import { Page, Unsaved } from "./modules/unsaved.js";

const FACE = [
  [10, 20],
  [30, 20],
  [20, 30],
  [14, 40],
  [26, 40],
];
const MIRROR = [1, 0, 2, 4, 3];
const close = (p, q, tolerance = 0.011) =>
  assert.ok(Math.hypot(p[0] - q[0], p[1] - q[1]) <= tolerance, `${p} is not ${q}`);

// Points ------------------------------------------------------------------------------------------------------------

test("edits give new arrays and leave the old ones", () => {
  const before = structuredClone(FACE);
  const moved = points.move(FACE, [0, 2], 1.234, -2);
  assert.deepEqual(FACE, before);
  assert.deepEqual(moved[0], [11.23, 18]);
  assert.equal(moved[1], FACE[1]);
});

test("points without a place stay so whatever is done to all", () => {
  const some = points.remove(FACE, [1]);
  for (const result of [points.move(some, [0, 1, 2], 3, 3), points.turn(some, [0, 1, 2], [0, 0], 1, 2)])
    assert.equal(result[1], null);
  assert.deepEqual(points.missing(some), [1]);
  assert.equal(points.nextMissing(some, 3), 1);
  assert.equal(points.nextMissing(FACE), -1);
});

test("a quarter turn and a doubling", () => {
  const [p] = points.turn([[2, 1]], [0], [1, 1], Math.PI / 2, 2);
  close(p, [1, 3]);
});

test("the nearest point within reach; a chosen one wins over one as near", () => {
  const two = [
    [0, 0],
    [4, 0],
  ];
  assert.equal(points.nearest(two, [1.9, 0], 5), 0);
  assert.equal(points.nearest(two, [1.9, 0], 5, new Set([1])), 1);
  assert.equal(points.nearest(two, [50, 0], 5), -1);
});

test("a similarity is found from the points in common", () => {
  const target = points.move(points.turn(FACE, [0, 1, 2, 3, 4], [0, 0], 0.3, 1.7), [0, 1, 2, 3, 4], 12, -5);
  const some = target.map((p, i) => (i === 3 ? null : p));
  close(points.expected(FACE, some)[3], target[3], 0.03);
  assert.deepEqual(
    points.expected(
      FACE,
      FACE.map(() => null),
    ),
    FACE,
  );
  close(points.expected(FACE, [[15, 25], null, null, null, null])[1], [35, 25]); // one point: a shift
});

test("the mean layout lies as the shapes do in pictures of another size", () => {
  const shape = (scale) => ({
    points: FACE.map(([x, y]) => [x * scale, y * scale]),
    width: 40 * scale,
    height: 60 * scale,
  });
  const mean = points.meanLayout([shape(1), shape(3)], 80, 120);
  mean.forEach((p, i) => close(p, [2 * FACE[i][0], 2 * FACE[i][1]], 0.05));
  assert.equal(points.meanLayout([{ ...shape(1), points: [null, ...FACE.slice(1)] }], 80, 120), null);
});

test("the mean layout is of the side of most shapes", () => {
  const lopsided = points.move(FACE, [3], 9, 5);
  const right = { points: lopsided, width: 40, height: 60 };
  const left = { ...right, points: lopsided.map(([x, y]) => [40 - x, y]) };
  for (const shapes of [[right, right, left], [left, right, right]])
    points.meanLayout(shapes, 40, 60).forEach((p, i) => close(p, lopsided[i], 0.05));
});

test("a layout from elsewhere is put into the middle of the picture", () => {
  const box = points.bounds(points.fitInto(FACE, 200, 100, 0.6));
  close([(box[0] + box[2]) / 2, (box[1] + box[3]) / 2], [100, 50]);
  assert.ok(box[3] - box[1] <= 60.02);
});

test("a twin moves by its partner's move, mirrored; both chosen move as they are", () => {
  const after = points.move(FACE, [0], 2, 3);
  const both = points.withTwins(FACE, after, [0], MIRROR);
  close(both[1], [28, 23]);
  assert.deepEqual(points.withTwins(FACE, points.move(FACE, [0, 1], 2, 3), [0, 1], MIRROR)[1], [32, 23]);
  assert.deepEqual(points.withTwins(FACE, points.move(FACE, [2], 2, 0), [2], MIRROR)[2], [22, 30]);
});

test("mirroring follows the axis of a turned object", () => {
  const all = [0, 1, 2, 3, 4];
  const turned = points.turn(FACE, all, [20, 30], Math.PI / 2);
  const result = points.withTwins(turned, points.move(turned, [0], 0, 3), [0], MIRROR); // along the pair: mirrored
  close([result[1][0] - turned[1][0], result[1][1] - turned[1][1]], [0, -3]);
});

test("flipping twice changes nothing, once swaps what twins mark", () => {
  const lopsided = points.move(FACE, [3], 0, 5);
  const once = points.flip(lopsided, MIRROR);
  close(once[4], [26, 45]);
  points.flip(once, MIRROR).forEach((p, i) => close(p, lopsided[i]));
  assert.deepEqual(points.flipIndices([0, 3], MIRROR), [1, 4]);
});

test("a group of mixed points becomes invisible, then visible", () => {
  assert.deepEqual(points.toggle([1], [1, 2]), [1, 2]);
  assert.deepEqual(points.toggle([1, 2], [1, 2]), []);
});

test("marks are the same up to what a file rounds away", () => {
  const one = { points: [[1, 2], null], invisible: [] };
  assert.ok(points.sameMarks(one, { points: [[1.004, 2], null], invisible: [] }));
  assert.ok(!points.sameMarks(one, { points: [[1.1, 2], null], invisible: [] }));
  assert.ok(
    !points.sameMarks(one, {
      points: [
        [1, 2],
        [0, 0],
      ],
      invisible: [],
    }),
  );
  assert.ok(!points.sameMarks(one, { points: [[1, 2], null], invisible: [0] }));
});

// What is left to do ------------------------------------------------------------------------------------------------

test("all is done only if the model was trained on all pictures", () => {
  const project = (states, left_out = {}) => ({
    pictures: states.map((state, i) => ({ name: `${i}.png`, state })),
    model: { left_out },
  });
  assert.equal(assist.unfinished(project(["done", "done"])), "");
  assert.equal(assist.unfinished(project(["done", "unchecked"])), "1 picture is not done.");
  assert.equal(assist.unfinished(project(["done", "done"], { "1.png": "grey" })), "The model leaves out 1.png.");
  const both = project(["new", "broken", "done", "done"], { "2.png": "grey", "3.png": "grey" });
  assert.equal(assist.unfinished(both), "1 picture is not done, and 1 picture cannot be read, and the model leaves out 2 pictures.");
  assert.equal(assist.unfinished({ ...project(["done"]), model: null }), "");
});

test("an error is shown once, until it ends or is another one", () => {
  const log = [];
  const complain = complaints((text) => {
    log.push(text);
    return () => log.push(`not ${text}`);
  });
  for (const text of ["", "a", "a", "b", "", ""]) complain(text);
  assert.deepEqual(log, ["a", "not a", "b", "not b"]);
});

// Undo --------------------------------------------------------------------------------------------------------------

test("250 steps back and forth", () => {
  const history = new History({ n: 0 });
  for (let n = 1; n <= 250; n++) history.push({ n }, `step ${n}`);
  for (let n = 249; n >= 0; n--) assert.equal(history.undo().n, n);
  assert.equal(history.undo(), null);
  for (let n = 1; n <= 250; n++) assert.equal(history.redo().n, n);
  assert.equal(history.redo(), null);
});

test("a new step forgets what was undone", () => {
  const history = new History(0);
  history.push(1);
  history.undo();
  history.push(2);
  assert.equal(history.canRedo, false);
  assert.equal(history.undo(), 0);
});

test("held keys are one step, until they pause or the key is another", () => {
  let time = 0;
  const history = new History(0, { now: () => time, burst: 800 });
  for (let n = 1; n <= 5; n++) {
    time += 100;
    history.push(n, "move", "a");
  }
  assert.equal(history.steps, 1);
  history.push(6, "move", "b");
  time += 900;
  history.push(7, "move", "b");
  assert.equal(history.steps, 3);
  assert.deepEqual([history.undo(), history.undo(), history.undo()], [6, 5, 0]);
});

test("after an undo held keys begin a new step", () => {
  const history = new History(0, { now: () => 0 });
  history.push(1, "", "a");
  history.push(2, "", null);
  history.undo();
  history.push(3, "", "a");
  assert.equal(history.undo(), 1);
});

test("the past is bounded", () => {
  const history = new History(0, { limit: 200 });
  for (let n = 1; n <= 300; n++) history.push(n);
  let steps = 0;
  while (history.undo() !== null) steps += 1;
  assert.equal(steps, 200);
});

// Saving ------------------------------------------------------------------------------------------------------------

class Storage {
  getItem(key) {
    return this[key] ?? null;
  }
  setItem(key, value) {
    this[key] = value;
  }
  removeItem(key) {
    delete this[key];
  }
}

const content = (x, invisible = []) => ({ points: [[x, 0], null], invisible });
const marks = (x, revision) => ({ ...content(x), revision, source: "file" });
const settled = () => new Promise((resolve) => setImmediate(resolve));

/** A saver over a server that is told how to answer, with timers that are run by hand. */
function bench(storage = new Storage(), now = null) {
  const log = { sent: [], states: [], messages: [], conflicts: [], foreign: [], moved: [], lost: [], timers: [] };
  const current = { template: now };
  let revision = 0;
  const pending = [];
  const saver = new Saver({
    put: (name, body) => {
      log.sent.push({ name, body });
      return new Promise((resolve, reject) =>
        pending.push({
          ok: (more = {}) => resolve({ revision: `r${(revision += 1)}`, ...more }),
          fail: (error) => reject(error),
        }),
      );
    },
    unsaved: new Unsaved(storage, "folder"),
    onStatus: (state, message) => {
      log.states.push(state);
      log.messages.push(message);
    },
    template: () => current.template,
    onTemplate: (name) => log.moved.push(name),
    onLost: (name, text) => log.lost.push(text),
    onConflict: (name, current) => log.conflicts.push(current),
    onForeign: (name) => log.foreign.push(name),
    setTimer: (run, delay) => {
      log.timers.push({ run, delay });
      return log.timers.length;
    },
    clearTimer: (id) => {
      if (id !== null) log.timers[id - 1] = null;
    },
  });
  saver.known("a", "r0", content(0));
  const run = () => {
    const due = log.timers.filter(Boolean);
    log.timers.fill(null);
    due.forEach((timer) => timer.run());
  };
  const answer = async (how, error) => {
    pending.shift()[how](error);
    await settled();
  };
  return { saver, log, run, answer, storage, current, state: () => log.states.at(-1) };
}

test("changes wait for one request, at most 250 ms after the first", async () => {
  const { saver, log, run, answer, state } = bench();
  saver.change("a", content(1));
  saver.change("a", content(2));
  assert.deepEqual(
    log.timers.filter(Boolean).map((timer) => timer.delay),
    [250],
  );
  assert.equal(state(), "saving");
  run();
  assert.deepEqual(log.sent, [{ name: "a", body: { ...content(2), revision: "r0" } }]);
  await answer("ok");
  assert.equal(state(), "saved");
});

test("one save in flight, the latest wins, with the revision of the one before", async () => {
  const { saver, log, run, answer, state } = bench();
  saver.change("a", content(1));
  run();
  for (const x of [2, 3, 4]) saver.change("a", content(x));
  run();
  assert.equal(log.sent.length, 1);
  await answer("ok");
  assert.deepEqual(log.sent[1].body, { ...content(4), revision: "r1" });
  assert.equal(state(), "saving");
  await answer("ok");
  assert.equal(state(), "saved");
  assert.equal(saver.dirty.length > 0, false);
});

test("what is the same as saved is not sent", () => {
  const { saver, log } = bench();
  saver.change("a", content(0));
  assert.equal(log.timers.length, 0);
});

test("an unreachable server: kept, tried again, and at once when it is back", async () => {
  const { saver, log, run, answer, storage, state } = bench();
  saver.change("a", content(1));
  run();
  await answer("fail", { status: 0 });
  assert.equal(state(), "offline");
  assert.deepEqual(new Unsaved(storage, "folder").get("a").wanted, content(1));
  run();
  await answer("fail", { status: 0 });
  assert.deepEqual(
    log.timers.filter(Boolean).map((timer) => timer.delay),
    [2000],
  );
  saver.retry();
  await answer("ok");
  assert.equal(state(), "saved");
  assert.equal(new Unsaved(storage, "folder").get("a"), null);
});

test("what the server refuses is not sent again until it changes", async () => {
  const { saver, log, run, answer, state } = bench();
  saver.change("a", content(1));
  run();
  await answer("fail", { status: 422, message: "no" });
  assert.equal(state(), "refused");
  assert.equal(log.timers.filter(Boolean).length, 0);
  saver.change("a", content(2));
  run();
  await answer("ok");
  assert.equal(state(), "saved");
});

test("a conflict is the person's to decide: mine goes with the new revision", async () => {
  const { saver, log, run, answer, state } = bench();
  saver.change("a", content(1));
  run();
  await answer("fail", { status: 409, body: { current: marks(9, "r9") } });
  assert.equal(state(), "conflict");
  assert.equal(saver.conflicted, "a");
  assert.equal(log.conflicts[0].points[0][0], 9);
  saver.change("a", content(2));
  run();
  assert.equal(log.sent.length, 1);
  saver.resolveConflict("a", "mine");
  assert.deepEqual(log.sent[1].body, { ...content(2), revision: "r9" });
  await answer("ok");
  assert.equal(state(), "saved");
});

test("a save says what it has changed from, and what others have changed meanwhile is shown", async () => {
  const { saver, log, run, answer } = bench();
  const mine = (x) => ({ ...content(x), absent: [1], origins: ["placed", null] });
  saver.known("a", "r0", mine(0), null, "b0");
  saver.change("a", mine(2));
  run();
  assert.deepEqual(log.sent[0].body.base, { absent: [1], origins: ["placed", null] });
  saver.heard("a", "r1", "b1");
  await answer("ok", { beside: "b1" });
  assert.deepEqual(log.foreign, []); // the event was of this save
  saver.heard("a", "r1", "b2"); // another tab has marked a point as absent: the file stays as it is
  assert.deepEqual(log.foreign, ["a"]);
  saver.change("a", mine(3));
  run();
  await answer("ok", { beside: "b3", merged: true });
  assert.deepEqual(log.foreign, ["a", "a"]);
});

test("a conflict: theirs forgets mine", async () => {
  const { saver, run, answer, storage, state } = bench();
  saver.change("a", content(1));
  run();
  await answer("fail", { status: 409, body: { current: marks(9, "r9") } });
  saver.resolveConflict("a", "theirs");
  assert.equal(state(), "saved");
  assert.equal(saver.isDirty("a"), false);
  assert.equal(new Unsaved(storage, "folder").get("a"), null);
});

test("a save whose answer was lost is no conflict", async () => {
  const { saver, log, run, answer, state } = bench();
  saver.change("a", content(1));
  run();
  await answer("fail", { status: 409, body: { current: marks(1, "r5") } });
  assert.equal(state(), "saved");
  assert.equal(log.conflicts.length, 0);
  assert.equal(saver.revisionOf("a"), "r5");
});

test("news of another tab is told once nothing is unsaved; our own is not news", async () => {
  const { saver, log, run, answer } = bench();
  saver.change("a", content(1));
  run();
  saver.heard("a", "r1");
  await answer("ok");
  assert.deepEqual(log.foreign, []);
  saver.heard("a", "r7");
  assert.deepEqual(log.foreign, ["a"]);
});

test("a new page takes up what the old one could not save", async () => {
  const first = bench();
  first.saver.change("a", content(1)); // killed before it was sent
  const second = bench(first.storage);
  assert.deepEqual(second.saver.restore("a", marks(0, "r0")), content(1));
  second.run();
  assert.deepEqual(second.log.sent[0].body, { ...content(1), revision: "r0" });
});

test("a new page knows a request that landed after the old one was gone", async () => {
  const first = bench();
  first.saver.change("a", content(1));
  first.run(); // sent; the answer never came
  first.saver.change("a", content(2));
  const second = bench(first.storage);
  assert.deepEqual(second.saver.restore("a", marks(1, "r1")), content(2)); // what was sent is there: no conflict
  assert.equal(second.log.conflicts.length, 0);
  second.run();
  assert.equal(second.log.sent[0].body.revision, "r1");
  const third = bench(first.storage);
  assert.equal(third.saver.restore("a", marks(2, "r2")), null);
});

test("a new page asks where the file was changed otherwise", () => {
  const first = bench();
  first.saver.change("a", content(1));
  const second = bench(first.storage);
  second.saver.restore("a", marks(5, "r5"));
  assert.equal(second.log.conflicts.length, 1);
});

test("a storage that cannot be used does not stop saving", async () => {
  const broken = {
    getItem() {
      throw new Error("no");
    },
    setItem() {
      throw new Error("no");
    },
    removeItem() {
      throw new Error("no");
    },
  };
  const { saver, run, answer, state } = bench(broken);
  saver.change("a", content(1));
  run();
  await answer("ok");
  assert.equal(state(), "saved");
});

test("a page inherits from dead pages and from itself, not from a tab that lives", async () => {
  const held = [];
  const locks = {
    request: async (name) => {
      held.push({ name });
    },
    query: async () => ({ held }),
  };
  const session = new Storage();
  const dead = new Page({ locks, session });
  held.length = 0;
  const living = new Page({ locks, session: new Storage() });
  const again = new Page({ locks, session });
  assert.equal(await again.inherits(living.name), false);
  assert.equal(await again.inherits(dead.name), true);
  assert.equal(await living.inherits(dead.name), true);
  assert.equal(again.before, dead.name);
  assert.equal(await again.inherits(again.name), true);
  assert.equal(await new Page({ locks: null, session }).inherits(living.name), true); // without locks: nothing is lost
});

test("a proposal is in no file, but the scale bar of its picture is", () => {
  const bar = { ends: [[0, 0], [9, 0]], length: 1, unit: "cm" };
  const proposed = { points: [[1, 2]], invisible: [0], source: "proposal" };
  assert.deepEqual(contentOf(proposed), { points: [null], invisible: [], bar: null });
  assert.deepEqual(contentOf({ ...proposed, bar }), { points: [null], invisible: [], bar });
});

const BEFORE = { names: ["a", "b"], revision: "t1" };
const AFTER = { names: ["new", "b", "a"], revision: "t2" };
const after = (points, revision) => ({ points, invisible: [], revision, source: "file" });

test("a disk that is full is tried again, and what the server says is shown", async () => {
  for (const status of [507, 503, 500]) {
    const { saver, log, run, answer, state } = bench();
    saver.change("a", content(1));
    run();
    await answer("fail", { status, message: "there is no space left" });
    assert.equal(state(), "failing");
    assert.equal(log.messages.at(-1), "there is no space left");
    run();
    await answer("ok");
    assert.equal(state(), "saved");
    assert.equal(log.messages.at(-1), "");
  }
});

test("marks say which template they are of, and go over to another by their names", async () => {
  const { saver, log, run, answer, current, state } = bench(new Storage(), BEFORE);
  saver.change("a", { points: [[1, 0], [2, 0]], invisible: [1] });
  run();
  assert.equal(log.sent[0].body.template, "t1");
  await answer("fail", { status: 409, body: { error: "changed", template: AFTER } });
  assert.deepEqual(log.moved, ["a"]);
  current.template = AFTER;
  saver.rebase("a", after([[9, 9], null, [0, 0]], "r5")); // the file, rewritten for the new order, and one point more
  run();
  assert.deepEqual(log.sent[1].body, {
    points: [[9, 9], [2, 0], [1, 0]],
    invisible: [1],
    revision: "r5",
    template: "t2",
  });
  await answer("ok");
  assert.equal(state(), "saved");
  assert.deepEqual([log.lost, log.conflicts], [[], []]);
});

test("a scale bar is sent if it changes, since it may have been set for all pictures meanwhile", async () => {
  const { saver, log, run, answer } = bench();
  const bar = { ends: [[0, 0], [9, 0]], length: 1, unit: "mm" };
  const send = async (what) => {
    saver.change("a", { points: [[1, 1]], invisible: [], ...what });
    run();
    await answer("ok");
    return log.sent.at(-1).body;
  };
  saver.known("a", "r1", { points: [[0, 0]], invisible: [], bar: null });
  assert.equal("bar" in (await send({ bar: null })), false);
  assert.deepEqual((await send({ bar })).bar, bar);
  assert.equal((await send({ bar: null })).bar, null);
});

test("where the picture was changed as well as its template, the person is asked", async () => {
  const { saver, log, run, answer, current, state } = bench(new Storage(), BEFORE);
  saver.change("a", content(1));
  run();
  await answer("fail", { status: 409, body: { error: "changed", template: AFTER } });
  current.template = AFTER;
  saver.rebase("a", after([null, null, [7, 7]], "r5"));
  assert.equal(state(), "conflict");
  assert.equal(log.conflicts.length, 1);
});

test("a point that the template has no more is not lost without a word", async () => {
  const { saver, log, run, answer, current } = bench(new Storage(), BEFORE);
  saver.change("a", { points: [[1, 0], [2, 0]], invisible: [] });
  run();
  await answer("fail", { status: 409, body: { error: "changed", template: {} } });
  current.template = { names: ["b"], revision: "t3" };
  saver.rebase("a", after([null], "r5"));
  assert.equal(log.lost.length, 1);
  assert.match(log.lost[0], /no longer has 'a'/);
  run();
  assert.deepEqual(log.sent[1].body.points, [[2, 0]]);
});

test("what an earlier page kept goes over to the template of now", () => {
  const first = bench(new Storage(), BEFORE);
  first.saver.change("a", { points: [[1, 0], [2, 0]], invisible: [] });
  const second = bench(first.storage, AFTER);
  const shown = second.saver.restore("a", after([null, null, [0, 0]], "r5"));
  assert.deepEqual(shown.points, [null, [2, 0], [1, 0]]);
  second.run();
  assert.equal(second.log.sent[0].body.template, "t2");
  assert.equal(second.log.sent[0].body.revision, "r5");
});

test("marks of a picture that another took the place of are not saved, and that is said", () => {
  const first = bench();
  first.saver.known("a", "r0", content(0), { width: 100, height: 80 });
  first.saver.change("a", content(1));
  const second = bench(first.storage);
  assert.equal(second.saver.restore("a", { ...marks(0, "r0"), width: 300, height: 80 }), null);
  assert.match(second.log.lost[0], /another picture/);
  assert.equal(second.saver.isDirty("a"), false);
});

test("folders of one name do not share what is unsaved", () => {
  const storage = new Storage();
  new Unsaved(storage, "id-one").set("a", { wanted: content(1) });
  assert.equal(new Unsaved(storage, "id-two").get("a"), null);
  assert.deepEqual(new Unsaved(storage, "id-two").names(), []);
});

test("a file that was deleted is said to be", async () => {
  const { saver, run, answer, log, state } = bench();
  saver.change("a", content(1));
  run();
  const gone = { points: [null, null], invisible: [], revision: null, source: "none" };
  await answer("fail", { status: 409, body: { current: gone } });
  assert.equal(saver.isDeleted("a"), true);
  saver.resolveConflict("a", "mine");
  assert.equal(saver.isDeleted("a"), false);
  assert.equal(log.sent[1].body.revision, null);
  await answer("ok");
  assert.equal(state(), "saved");
});

test("what was made for another folder than the server shows is refused, and the page is loaded anew", async (t) => {
  let reloads = 0;
  const [before, place] = [globalThis.fetch, globalThis.location];
  t.after(() => Object.assign(globalThis, { fetch: before, location: place }));
  globalThis.location = { reload: () => (reloads += 1) };
  globalThis.fetch = async () => new Response(JSON.stringify({ id: "two", pictures: [] }));
  const state = new State({ id: "one", pictures: [] });
  assert.equal(await state.send(async (folder) => folder), "one");
  const refused = Object.assign(new Error("another folder"), { status: 409, body: { folder: "two" } });
  const wrong = Object.assign(new Error("wrong"), { status: 422, body: {} });
  await assert.rejects(state.send(() => Promise.reject(wrong)), wrong);
  assert.equal(reloads, 0);
  // As where nothing was sent: it is kept, since it may be of use once the folder is served again.
  await assert.rejects(state.send(() => Promise.reject(refused)), { status: 0 });
  assert.equal(reloads, 1);
  state.doubt();
  await assert.rejects(state.send(() => assert.fail("asked before it is sure")), { status: 0 });
  assert.equal(reloads, 2);
});

test("an address that names no picture is no fault", () => {
  assert.equal(nameIn("#100%"), "");
  assert.equal(nameIn("#a%20b.png"), "a b.png");
});

// Templates ---------------------------------------------------------------------------------------------------------

/** Clicks while a curve is being drawn. */
const clicks = (list, options) =>
  list.reduce((draft, xy) => template.addPoint(draft, xy, options), template.startPath(template.EMPTY));

test("a click adds a landmark by itself, until a curve is drawn", () => {
  const single = [[0, 0], [1, 0], [1, 1]].reduce((draft, xy) => template.addPoint(draft, xy), template.EMPTY);
  assert.deepEqual([single.contours, single.kinds], [[], ["landmark", "landmark", "landmark"]]);
  const twins = template.addPoint(single, [2, 2], { axis: 10 });
  assert.deepEqual([twins.contours, twins.mirror], [[], [0, 1, 2, 4, 3]]);
  const curve = [[5, 5], [6, 6], [7, 5], [8, 4]].reduce((draft, xy) => template.addPoint(draft, xy), template.startPath(single));
  const ended = template.newPath(curve);
  assert.deepEqual(ended.contours, [{ indices: [3, 4, 5, 6], closed: false }]);
  assert.deepEqual(ended.kinds.slice(3), ["landmark", "semilandmark", "semilandmark", "landmark"]);
  assert.deepEqual(template.addPoint(ended, [9, 9]).contours, ended.contours);
  assert.deepEqual(template.templateOf(curve).kinds, ended.kinds); // also if it was not ended
});

test("a point's kind is changed, and goes along when points are deleted, moved or taken off their curve", () => {
  const draft = template.newPath(clicks([[0, 0], [1, 0], [2, 0], [3, 0]]));
  const changed = template.changeKind(draft, 1);
  assert.deepEqual(changed.kinds, ["landmark", "landmark", "semilandmark", "landmark"]);
  assert.deepEqual(template.reorder(changed, 2, 0).kinds, ["semilandmark", "landmark", "landmark", "landmark"]);
  assert.deepEqual(template.deletePoints(changed, [0]).kinds, ["landmark", "semilandmark", "landmark"]);
  assert.deepEqual(template.removePath(changed, 0).kinds, Array(4).fill("landmark"));
  const single = template.addPoint(changed, [9, 9]);
  assert.equal(template.changeKind(single, 4).kinds[4], "landmark"); // on no curve it cannot slide
});

test("a sliders file gives semilandmarks and their curves, whatever the order of its rows", () => {
  const draft = { ...template.EMPTY, names: ["a", "b", "c", "d", "e", "f", "g"], kinds: Array(7).fill("landmark") };
  const open = template.withSliders(draft, 'before,slide,after\n"3","4","5"\n"1","2","3"\n"2","3","4"\n');
  assert.deepEqual(open.contours, [{ indices: [0, 1, 2, 3, 4], closed: false }]);
  assert.deepEqual([1, 2, 3].map((i) => template.slides(open, i)), [true, true, true]);
  assert.deepEqual([0, 4, 5].map((i) => template.slides(open, i)), [false, false, false]);
  assert.deepEqual(template.withSliders(draft, "4 1 2\n1 2 3\n2 3 4\n3 4 1").contours, [{ indices: [3, 0, 1, 2], closed: true }]);
  assert.deepEqual(template.withSliders(draft, "1 2 3\n2 3 4\n3 4 1").contours, [{ indices: [0, 1, 2, 3], closed: true }]);
  for (const text of ["", "x,y\n1,2", "1 2 9", "before slide after"]) assert.equal(template.withSliders(draft, text), null, text);
});

test("clicks make points and go on with the curve that is drawn", () => {
  const draft = clicks([
    [0, 0],
    [1, 0],
    [1, 1],
  ]);
  assert.deepEqual(draft.names, ["point 1", "point 2", "point 3"]);
  const closed = template.newPath(draft, true);
  assert.deepEqual(closed.contours, [{ indices: [0, 1, 2], closed: true }]);
  assert.deepEqual(closed.kinds, ["landmark", "semilandmark", "semilandmark"]);
  const next = template.addPoint(template.startPath(closed), [5, 5]);
  assert.deepEqual(next.contours[1], { indices: [3], closed: false });
  assert.deepEqual(template.templateOf(next).contours.length, 1); // a lone point is no curve
  assert.equal(template.templateOf(next).kinds[3], "landmark");
  assert.equal(template.templateOf(next).mirror, null);
});

test("mirrored clicks make twins, and one path where both sides meet on the axis", () => {
  const options = { axis: 10, tolerance: 0.5 };
  const jaw = clicks(
    [
      [2, 0],
      [4, 5],
      [10.2, 8],
    ],
    options,
  );
  assert.deepEqual(jaw.points, [
    [2, 0],
    [18, 0],
    [4, 5],
    [16, 5],
    [10, 8],
  ]);
  assert.deepEqual(jaw.mirror, [1, 0, 3, 2, 4]);
  assert.deepEqual(template.newPath(jaw).contours, [{ indices: [0, 2, 4, 3, 1], closed: false }]);
  const lips = clicks(
    [
      [10, 0],
      [5, 2],
      [10, 4],
    ],
    options,
  );
  assert.deepEqual(template.newPath(lips, true).contours, [{ indices: [0, 1, 3, 2], closed: true }]);
  const eyes = clicks(
    [
      [2, 0],
      [4, 1],
      [3, 2],
    ],
    options,
  );
  assert.deepEqual(template.newPath(eyes, true).contours, [
    { indices: [0, 2, 4], closed: true },
    { indices: [1, 3, 5], closed: true },
  ]);
});

test("every ending of a mirrored path goes through each point once", () => {
  for (const [path, twin] of [
    [
      [0, 1],
      [0, 2],
    ],
    [
      [1, 0],
      [2, 0],
    ],
    [
      [0, 1, 3],
      [0, 2, 3],
    ],
    [
      [1, 4],
      [2, 5],
    ],
    [[0], [0]],
  ]) {
    for (const closed of [false, true]) {
      for (const { indices } of template.joined(path, twin, closed))
        assert.equal(new Set(indices).size, indices.length, `${path} ${closed}`);
    }
  }
});

test("deleting keeps paths, twins and origins right", () => {
  const draft = template.draftOf({
    names: ["a", "b", "c", "d"],
    contours: [{ indices: [0, 1, 2, 3], closed: true }],
    mirror: [3, 2, 1, 0],
    points: [
      [0, 0],
      [1, 0],
      [2, 0],
      [3, 0],
    ],
  });
  const less = template.deletePoints(draft, [1]);
  assert.deepEqual(less.contours, [{ indices: [0, 1, 2], closed: true }]);
  assert.deepEqual(less.mirror, [2, 1, 0]); // the twin of a deleted point is its own
  assert.deepEqual(less.origins, [0, 2, 3]);
  assert.deepEqual(template.changes(less, 4), ["1 point will be deleted"]);
  assert.equal(template.deletePoints(draft, [0, 1, 2]).contours.length, 0);
});

test("before points change, what is lost is named: files, the model, checks", () => {
  const draft = template.deletePoints(template.draftOf({ names: ["a", "b", "c", "d"], contours: [], points: FACE }), [3]);
  const known = { measuring: { measures: [], scale: "", by: "", gone: [] }, observers: [], set: "" };
  const said = (pictures, model = null, more = {}) =>
    template.consequences(draft, ["a", "b", "c", "d"], { ...known, pictures, model, ...more });
  assert.equal(said([{ placed: 0, state: "new" }]), "");
  assert.equal(
    said([{ placed: 4, state: "done", checked: "Ann" }], { source: "studio" }),
    "The landmark files of 1 picture will be rewritten: 1 point will be deleted. The trained model and its proposed " +
      "points will be removed. A copy of the model stays in .liaam-studio/kept. The checks of 1 picture will be withdrawn.",
  );
  assert.equal(said([{ placed: 0, state: "new" }], { source: "file" }), ""); // a model given by the user stays
  const measuring = { ...known.measuring, measures: ["distance:1-2", "distance:1-4"] };
  const gone = said([], null, { measuring, observers: ["", "bob"] });
  assert.match(gone, /^1 measure will be removed: distance: a – d\. bob keeps its points as they are, /);
});

test("new names are confirmed only where another observer would be left behind", () => {
  const project = { pictures: [], model: null, measuring: { measures: [], scale: "", by: "", gone: [] }, observers: ["", "bob"], set: "bob" };
  const names = ["a", "b", "c"];
  const draft = template.draftOf({ names, kinds: null, contours: [], mirror: null, points: null });
  assert.equal(template.consequences(draft, names, project), "");
  const renamed = { ...draft, names: ["a", "b", "tip"] };
  assert.match(template.consequences(renamed, names, project), /^Main set keeps its points/);
  assert.equal(template.consequences(renamed, names, { ...project, observers: [] }), "");
});

test("reordering carries everything along", () => {
  const draft = template.draftOf({
    names: ["a", "b", "c"],
    contours: [{ indices: [0, 2], closed: false }],
    mirror: [2, 1, 0],
    points: [
      [0, 0],
      [1, 0],
      [2, 0],
    ],
  });
  const moved = template.reorder(draft, 0, 2);
  assert.deepEqual(moved.names, ["b", "c", "a"]);
  assert.deepEqual(moved.contours, [{ indices: [2, 1], closed: false }]);
  assert.deepEqual(moved.mirror, [0, 2, 1]);
  assert.deepEqual(moved.origins, [1, 2, 0]);
  assert.ok(template.rearranges(moved, 3));
  assert.ok(!template.rearranges(template.rename(draft, 0, "x"), 3));
});

test("a path is gone on with, and goes through a point once", () => {
  const draft = template.newPath(
    clicks([
      [0, 0],
      [1, 0],
      [1, 1],
    ]),
    true,
  );
  const open = template.continuePath(draft, 0);
  assert.equal(open.contours[open.path].closed, false);
  assert.equal(template.connect(open, 1), open);
  assert.deepEqual(template.addPoint(open, [0, 1]).contours[0].indices, [0, 1, 2, 3]);
});

test("what is wrong with a template is said", () => {
  assert.match(template.fault(template.EMPTY), /three points/);
  const draft = clicks([
    [0, 0],
    [1, 0],
    [1, 1],
  ]);
  assert.equal(template.fault(draft), null);
  assert.match(template.fault(template.rename(draft, 1, " ")), /Point 2 has no name/);
  assert.match(template.fault(template.rename(draft, 1, "point 1")), /Two points have the name 'point 1'/);
  assert.match(template.fault({ ...draft, points: [[0, 0], null, [1, 1]] }), /'point 2' is not placed/);
});

test("points are the same by their names, and where a template was only renamed by their places", () => {
  assert.deepEqual(template.mappingByNames(["a", "b", "c"], ["c", "x", "a"]), [2, null, 0]);
  assert.deepEqual(template.mappingByNames(["a", "b", "c"], ["a", "x", "c"]), [0, 1, 2]);
  assert.deepEqual(template.mappingByNames(["a", "b"], ["a", "c", "b"]), [0, null, 1]);
});

test("a draft goes on under a template that was changed elsewhere", () => {
  const before = { names: ["a", "b", "c"], contours: [], mirror: null, points: [[0, 0], [1, 0], [2, 0]] };
  const draft = template.deletePoints(template.rename(template.draftOf(before), 0, "first"), [1]);
  const now = { names: ["new", "c", "a"] };
  assert.deepEqual(template.rebased(draft, before, now).origins, [2, 1]);
  const fresh = clicks([[0, 0], [1, 0], [1, 1]]);
  assert.deepEqual(template.rebased(fresh, null, { names: ["point 3", "other"] }).origins, [null, null, 0]);
});

// Training ----------------------------------------------------------------------------------------------------------

const project = (states, more = {}) => ({
  template: {},
  model: null,
  training: { state: "idle" },
  ...more,
  pictures: states.map((state, i) => ({ name: `${i}`, state, rank: null, uncertainty: null })),
});

test("the first model comes with four pictures, the next after three more", () => {
  const four = ["done", "done", "done", "done", "new"];
  const auto = { auto: true };
  assert.ok(!assist.shouldTrain(project(four.slice(1)), auto));
  assert.ok(assist.shouldTrain(project(four), auto));
  assert.ok(!assist.shouldTrain(project(four), { auto: false }));
  assert.ok(!assist.shouldTrain({ ...project(four), set_aside: true }, auto)); // a person went back to the face model
  const withSlip = (states) => {
    const all = project([...states, "done"]);
    all.pictures.at(-1).slip = "?";
    return all;
  };
  assert.ok(!assist.shouldTrain(withSlip(four.slice(1)), auto)); // it is left out
  assert.ok(assist.shouldTrain(withSlip(four), auto));
  assert.ok(!assist.shouldTrain(project(four, { training: { state: "running" } }), auto));
  assert.ok(!assist.shouldTrain(project(four, { model: { stale: 2, source: "studio" } }), auto));
  assert.ok(assist.shouldTrain(project(four, { model: { stale: 3, source: "studio" } }), auto));
  assert.ok(!assist.shouldTrain(project(four, { model: { stale: 3, source: "file" } }), auto));
  const face = project(four, { model: { stale: 4, source: "face" } });
  assert.ok(assist.shouldTrain(face, auto));
  face.pictures.forEach((picture) => Object.assign(picture, { placed: 9, unconfirmed: 9 }));
  assert.ok(!assist.shouldTrain(face, auto)); // accepted points of the face model are no reason to replace it
  // One side that is stated may tell those of all.
  assert.ok(assist.shouldTrain(project(four, { model: { stale: 1, sides_changed: true, source: "studio" } }), auto));
});

test("a picture without some absent points counts for training, one with hardly any point does not", () => {
  const all = project(["done", "done", "done", "done"]);
  Object.assign(all.pictures[0], { absent: 4, placed: 3 });
  assert.ok(assist.shouldTrain(all, { auto: true }));
  Object.assign(all.pictures[0], { absent: 5, placed: 2 });
  assert.ok(!assist.shouldTrain(all, { auto: true }));
});

test("what failed is not tried again by itself until something changes", () => {
  const four = project(["done", "done", "done", "done"]);
  const failedAt = assist.situation(four);
  assert.ok(!assist.shouldTrain(four, { auto: true, failedAt }));
  assert.match(assist.whenItHelps(four, { auto: true, failedAt }), /^Train the model/);
  assert.match(assist.whenItHelps({ ...four, checked: false }, { auto: true }), /^After training/);
  assert.match(assist.whenItHelps(project(["done", "done"]), { auto: true }), /^After 2 more pictures/);
  assert.ok(assist.shouldTrain(project(["done", "done", "done", "done", "done"]), { auto: true, failedAt }));
});

test("a picture that is left out of training does not count for it, and leaving it out is a change", () => {
  const pictures = ["a", "b", "c", "d", "e"].map((name) => ({ name, state: "done", left_out: null }));
  const of = (...left) => ({
    ...project([]), pictures: pictures.map((picture) => ({ ...picture, left_out: left.includes(picture.name) && "Ann" })),
  });
  assert.ok(assist.shouldTrain(of("a"), { auto: true }));
  assert.ok(!assist.shouldTrain(of("a", "b"), { auto: true }));
  assert.ok(assist.shouldTrain(of("b"), { auto: true, failedAt: assist.situation(of("a")) }));
});

test("next is a picture of the subfolder that the list shows", () => {
  const pictures = ["a/1", "b/1", "ab/1", "a/c/2"].map((name, i) => ({ name, rank: 9 - i, state: "new" }));
  const state = new State({ pictures });
  const told = [];
  state.addEventListener("folder", () => told.push(state.folder));
  const next = () => assist.nextToTeach(state.pictures, "a/1")?.name;
  assert.equal(next(), "a/c/2");
  state.showFolder("b");
  assert.deepEqual([next(), told], ["b/1", ["b"]]);
  state.showFolder("a");
  assert.equal(next(), "a/c/2");
  pictures.pop();
  assert.equal(next(), undefined);
});

test("next is the picture of the best rank, else the next in the folder, round", () => {
  const { pictures } = project(["new", "done", "new", "broken", "new"]);
  assert.equal(assist.nextToTeach(pictures, "2").name, "4");
  assert.equal(assist.nextToTeach(pictures, "4").name, "0");
  const without = pictures.map((picture) => (picture.name === "4" ? { ...picture, nothing_found: true, rank: 1 } : picture));
  assert.notEqual(assist.nextToTeach(without, "2").name, "4"); // there is nothing to correct
  assert.equal(assist.nextToTeach(without.filter(({ name, state }) => name === "4" || state === "done"), "2").name, "4");
  pictures[2].rank = 2;
  pictures[4].rank = 1;
  assert.equal(assist.nextToTeach(pictures, "0").name, "4");
  assert.equal(assist.nextToTeach(project(["done", "done"]).pictures, "0"), null);
});

test("the reason is the uncertainty, in words", () => {
  const picture = { state: "proposed", uncertainty: 0.031, rank: 1, doubtful: false };
  const others = [picture, { uncertainty: 0.01 }, { uncertainty: 0.008 }];
  assert.match(assist.reason(picture, others, {}), /least certain.*3\.1\s% of the object's size.*median 1\.0\s%/);
  assert.match(assist.reason({ ...picture, doubtful: true }, others, {}), /low confidence/);
  const nothing = assist.reason({ ...picture, doubtful: true, nothing_found: true }, others, { source: "face" });
  assert.match(nothing, /^No face was found in this picture\. If there is none, skip it/);
  assert.match(assist.reason(picture, others, null), /Next in the folder/);
  assert.equal(assist.reason({ ...picture, slip: "a point lies outside" }, others, {}), "Possible slip: a point lies outside.");
});

test("a fit that has blown up is not told in numbers, and none is called least sure that is not", () => {
  const wild = { state: "proposed", uncertainty: 1218.1, rank: 1, doubtful: true };
  const sure = { state: "proposed", uncertainty: 0.0026, rank: 2, doubtful: false };
  const other = { state: "proposed", uncertainty: 0.004, rank: 1, doubtful: false };
  assert.match(assist.reason(wild, [wild, sure, other], {}), /over 100\s%/);
  assert.doesNotMatch(assist.reason(sure, [wild, sure, other], {}), /least certain/);
  assert.match(assist.reason(other, [wild, sure, other], {}), /least certain.*0\.40\s%.*median 0\.26\s%/);
});

test("what was left out, what was passed over, and a model of another template are told", () => {
  const names = ["a", "b"];
  assert.deepEqual(assist.notices({ model: { n_points: 2 }, template: { names } }), []);
  const groups = assist.notices({
    model: { n_points: 3, left_out: { "x.png": "too dark" } },
    template: { names },
    problems: ["2 pictures passed over"],
  });
  assert.equal(groups.length, 3);
  assert.match(groups[0].lines[0], /3 points where the template has 2/);
  assert.deepEqual(groups[1].lines, [{ name: "x.png", why: "too dark" }]);
});

test("brightness, contrast and gamma of zero change nothing, and 1 stands for a factor of two", () => {
  const neutral = { brightness: 0, contrast: 0, gamma: 0 };
  for (const value of [0, 0.25, 0.5, 1]) assert.equal(shownValue(value, neutral), value);
  assert.equal(shownValue(0.25, { ...neutral, brightness: 1 }), 0.5);
  assert.equal(shownValue(0.25, { ...neutral, gamma: 1 }), 0.5);
  assert.equal(shownValue(0.6, { ...neutral, contrast: 1 }).toFixed(6), "0.700000");
  assert.equal(shownValue(0.9, { brightness: 2, contrast: 2, gamma: 2 }), 1);
});

test("waiting for the state of pictures does not end with an answer from before", async (t) => {
  const of = (placed) => ({ id: "one", pictures: [{ name: "a.png", state: "broken", placed }] });
  const [state, answers] = [new State(of(null)), []];
  const before = globalThis.fetch;
  t.after(() => Object.assign(globalThis, { fetch: before }));
  globalThis.fetch = () => new Promise((resolve) => {
    answers.push((placed) => resolve(new Response(JSON.stringify(of(placed)))));
  });
  state.refresh();
  const waiting = state.settled(); // after a change, which the request under way may have missed
  const end = waiting.then(() => state.project.pictures[0].placed);
  for (let placed = 0; placed < 3; placed++) {
    answers[placed]?.(placed);
    await new Promise((resolve) => { setTimeout(resolve); });
  }
  assert.ok((await end) >= 1);
});

test("the loupe stays inside the canvas and off the finger", () => {
  for (const type of ["mouse", "touch"]) {
    for (const at of [
      [0, 0],
      [400, 10],
      [799, 599],
      [5, 300],
      [400, 300],
    ]) {
      const [x, y] = loupePlace(at, type, 800, 600);
      assert.ok(x >= 62 && x <= 738 && y >= 62 && y <= 538, `${at}`);
      assert.ok(Math.hypot(x - at[0], y - at[1]) > 62, `${type} ${at} is under the loupe`);
    }
  }
});
