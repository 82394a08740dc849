// Random sequences of what a person does in the Annotate tab, compared with a plain model after every step: clicks,
// drags, undo, redo, contours that are traced, other pictures, reloads, and changes in other tabs. The parts of the tab
// are those of the page; its viewer and the server are replaced. Run by test_annotate_modules.py, by Node.

import assert from "node:assert/strict";
import { test } from "node:test";

import { createCommands } from "./modules/annotate-commands.js";
import { createOpening } from "./modules/annotate-opening.js";
import { createSaving } from "./modules/annotate-saving.js";
import { Shown } from "./modules/annotate-shown.js";
import { PointTool } from "./modules/gestures.js";
import { Marking } from "./modules/marking.js";
import { sameMarks } from "./modules/points.js";
import { Tracing } from "./modules/tracing.js";

const STEPS = Number(process.env.LIAAM_STEPS ?? 500);
const SEED = Number(process.env.LIAAM_SEED ?? 1);
const SIZE = 4000; // pixels of a side
const ROOM = 60; // least pixels between points, so that a press hits the point it is meant for
const NAMES = ["a", "b", "c", "d", "e", "f", "g", "h"];
const KINDS = NAMES.map((_, i) => ([3, 4, 5].includes(i) ? "semilandmark" : "landmark"));
const TEMPLATE = {
  names: NAMES, kinds: KINDS, contours: [{ indices: [2, 3, 4, 5, 6], closed: false }], mirror: [1, 0, 2, 3, 4, 5, 6, 7],
  points: null, revision: "t",
};
const PICTURES = ["1.png", "2.png", "3.png"];
const PROPOSED = NAMES.map((_, i) => [300 + 400 * i, 500 + 100 * (i % 3)]);
const OWN = ["placed", "moved", "confirmed"];
const none = () => NAMES.map(() => null);
const copy = (value) => JSON.parse(JSON.stringify(value));

class Storage {
  getItem(key) { return this[key] ?? null; }
  setItem(key, value) { this[key] = value; }
  removeItem(key) { delete this[key]; }
}

/** Numbers from 0 to 1 that are the same for a seed (mulberry32). */
function generator(seed) {
  let state = seed;
  return () => {
    state = (state + 0x6d2b79f5) | 0;
    let t = Math.imul(state ^ (state >>> 15), 1 | state);
    t = (t + Math.imul(t ^ (t >>> 7), 61 | t)) ^ t;
    return ((t ^ (t >>> 14)) >>> 0) / 4294967296;
  };
}

/** What the server keeps. The third picture has a proposal. */
class Server {
  files = new Map();
  revision = 0;

  marks(name) {
    const file = this.files.get(name) ?? { points: none(), invisible: [], absent: [], origins: none(), revision: null };
    const size = { width: SIZE, height: SIZE, bar: null, covariances: null, doubtful: false };
    if (file.points.some(Boolean)) return { ...copy(file), ...size, source: "file" };
    if (name !== PICTURES[2]) return { ...copy(file), ...size, source: "none" };
    return { ...copy(file), ...size, points: copy(PROPOSED), origins: null, source: "proposal" };
  }

  put(name, { points, invisible, absent, origins, revision }) {
    const current = this.marks(name);
    if (revision !== current.revision) throw Object.assign(new Error("changed"), { status: 409, body: { current } });
    this.revision += 1;
    const known = { absent: absent ?? current.absent, origins: origins ?? none() };
    this.files.set(name, copy({ points, invisible, ...known, revision: `r${this.revision}` }));
    return { revision: `r${this.revision}`, picture: { name } };
  }
}

/** The parts of the Annotate tab that a step goes through, on a server and a storage. */
async function openTab(server, storage, first) {
  Object.assign(globalThis, { localStorage: storage, sessionStorage: storage });
  const canvas = { listeners: {}, addEventListener(kind, f) { this.listeners[kind] = f; } };
  const viewer = {
    canvas, scale: 1, width: SIZE, height: SIZE, container: { clientWidth: SIZE, clientHeight: SIZE },
    redraw() {}, setPicture() {}, mirror() {}, fit() {}, panBy() {},
    toScreen: (point) => point, toImage: (point) => point, place: ({ at }) => at,
  };
  const pictures = PICTURES.map((name) => ({ name, state: "new", tag: "t", rank: null }));
  let opening = null;
  const state = {
    project: { id: "p", template: TEMPLATE, pictures, model: null }, pictures, current: null, folder: "", worstFirst: false,
    picture: (name) => pictures.find((each) => each.name === name) ?? null,
    update() {}, refresh: async () => {},
    select(name) { this.current = name; opening = tab.opening.open(name); },
    saveMarks: async (name, body) => server.put(name, copy(body)),
  };
  const api = { url: (_, { name }) => name, get: async (name) => server.marks(name) };
  const toasts = [];
  const toast = (text) => { toasts.push(text); return () => {}; };
  const app = { state, api, toast, ui: { dialog: async () => "theirs" }, pictures: { fetch: async () => ({ bitmap: {} }) } };
  const tab = {
    app, state, viewer, visible: true, editing: false, template: TEMPLATE, shown: new Shown(), status: { show() {} }, assist: { left() {} }, templates: {}, toasts,
    say() {}, sayPlace() {}, refresh() {}, focus() {}, act: (_, work) => work(),
    leavePicture(name) { tab.saver.flush(name); },
    get name() { return tab.opening.name; },
    get drawing() { return tab.tracing.on ? tab.tracing : undefined; },
    get doc() { return tab.drawing ?? tab.marking; },
  };
  tab.marking = new Marking({
    template: () => TEMPLATE, onchange: () => tab.saving.change(tab.name, tab.marking.state),
    onplaced: (index) => {
      const next = tab.marking.nextMissing(index);
      tab.marking.select([next < 0 ? index : next]);
    },
  });
  tab.tracing = new Tracing(tab.marking, {});
  tab.commands = createCommands(tab);
  tab.opening = createOpening(tab, { begins: () => "click", cover: {} });
  tab.saving = createSaving(tab);
  tab.saver = tab.saving.saver;
  tab.tool = new PointTool(viewer, () => tab.doc);
  tab.press = (at, to = at) => {
    const event = (place) => ({ button: 0, pointerType: "mouse", at: place, clientX: place[0], clientY: place[1] });
    tab.tool.down(event(at), at);
    if (to !== at) tab.tool.move(event(to), to);
    tab.tool.up(event(to), to);
    canvas.listeners.pointerup(event(to));
  };
  tab.settled = () => opening;
  state.select(first);
  await opening;
  return tab;
}

/** The marks of one picture as a person expects them, with all that undo and redo restore. */
class Expected {
  past = [];
  future = [];

  constructor({ points, origins, absent, invisible, source }) {
    const suggested = source === "proposal";
    this.now = {
      points, absent, invisible, suggested, chosen: [], active: -1,
      origins: points.map((point, i) => point && (origins?.[i] ?? (suggested ? "proposed" : "placed"))),
    };
  }

  /** A step: what undo restores are the marks and the selection before it. */
  step(change) {
    const before = copy(this.now);
    change(this.now);
    this.past.push(before);
    this.future = [];
  }

  travel(from, to) {
    if (!from.length) return;
    to.push(copy(this.now));
    this.now = from.pop();
  }

  undo() { this.travel(this.past, this.future); }
  redo() { this.travel(this.future, this.past); }
  select(indices, active = indices.at(-1) ?? -1) { Object.assign(this.now, { chosen: indices, active }); }

  get left() { return NAMES.map((_, i) => i).filter((i) => !this.now.points[i] && !this.now.absent.includes(i)); }
  after(index) { return this.left.find((i) => i > index) ?? this.left[0] ?? -1; }
}

const STEP = {
  click({ tab, expected, free }) {
    const { now } = expected;
    const at = free();
    const index = now.active;
    if (index >= 0 && !now.points[index]) {
      expected.step((to) => {
        to.points[index] = at;
        to.origins[index] = "placed";
        to.absent = to.absent.filter((i) => i !== index);
        to.suggested = false;
      });
      const next = expected.after(index);
      expected.select([next < 0 ? index : next]);
    } else expected.select([]);
    tab.press(at);
  },

  drag({ tab, expected, free, random }) {
    const placed = NAMES.map((_, i) => i).filter((i) => expected.now.points[i]);
    if (!placed.length) return;
    const index = placed[Math.floor(random() * placed.length)];
    const from = expected.now.points[index];
    const to = free();
    const wasChosen = expected.now.chosen;
    if (wasChosen.length > 1 && wasChosen.includes(index)) return; // several would move
    expected.step((now) => {
      now.points[index] = to;
      if (now.origins[index] !== "placed") now.origins[index] = "moved";
      now.suggested = false;
    });
    expected.select([index]);
    tab.press(from, to);
  },

  choose({ tab, expected, random }) {
    const index = Math.floor(random() * NAMES.length);
    tab.marking.select([index]);
    expected.select([index]);
  },

  undo({ tab, expected }) {
    expected.undo();
    tab.commands.travel("undo");
  },

  redo({ tab, expected }) {
    expected.redo();
    tab.commands.travel("redo");
  },

  clear({ tab, expected }) {
    const chosen = expected.now.chosen.filter((i) => expected.now.points[i]);
    tab.commands.removeChosen();
    if (!chosen.length) return;
    expected.step((now) => {
      for (const i of chosen) [now.points[i], now.origins[i]] = [null, null];
      now.invisible = now.invisible.filter((i) => !chosen.includes(i));
      now.suggested = false;
    });
    expected.select(chosen);
    expected.now.active = chosen[0];
  },

  hide({ tab, expected }) {
    const [index] = expected.now.chosen;
    tab.commands.toggleInvisible();
    if (expected.now.chosen.length !== 1 || !expected.now.points[index]) return;
    expected.step((now) => {
      const is = now.invisible.includes(index);
      now.invisible = is ? now.invisible.filter((i) => i !== index) : [...now.invisible, index].sort((p, q) => p - q);
      now.suggested = false;
    });
  },

  absent({ tab, expected }) {
    const [index] = expected.now.chosen;
    tab.commands.toggleAbsent();
    if (expected.now.chosen.length !== 1) return;
    const is = !expected.now.absent.includes(index);
    expected.step((now) => {
      if (is) [now.points[index], now.origins[index]] = [null, null];
      now.absent = is ? [...now.absent, index].sort((p, q) => p - q) : now.absent.filter((i) => i !== index);
      now.invisible = now.invisible.filter((i) => now.points[i]);
      now.suggested = false;
    });
    const next = is ? expected.after(index) : index;
    if (next < 0) expected.select([index], -1); // no click places it
    else expected.select([next]);
  },

  confirm({ tab, expected }) {
    const { chosen, points, origins } = expected.now;
    tab.commands.confirm();
    const [index] = chosen;
    if (chosen.length !== 1 || !points[index]) return;
    if (!OWN.includes(origins[index]))
      expected.step((now) => {
        now.origins[index] = "confirmed";
        now.suggested = false;
      });
    const left = NAMES.map((_, i) => i).filter((i) => expected.now.points[i] && !OWN.includes(expected.now.origins[i]));
    const next = left.find((i) => i > index) ?? left[0];
    if (next !== undefined) expected.select([next]);
  },

  accept({ tab, expected }) {
    const { suggested, origins } = expected.now;
    tab.marking.accept();
    if (suggested || origins.includes("proposed"))
      expected.step((now) => {
        now.origins = now.origins.map((origin) => (origin === "proposed" ? "accepted" : origin));
        now.suggested = false;
      });
  },

  /** Trace the contour, take places back, and end or leave it. */
  trace({ tab, expected, free, random }) {
    const { marking, tracing, commands } = tab;
    const before = copy(expected.now);
    tab.commands.trace();
    if (!tracing.on) return;
    const count = 1 + Math.floor(4 * random());
    for (let i = 0; i < count; i += 1) tab.press(free());
    const taken = Math.floor(random() * (count + 1));
    for (let i = 0; i < taken; i += 1) commands.travel("undo");
    assert.equal(tracing.on, true, "undo of a place ended tracing");
    if (random() < 0.3 || !tracing.whole) {
      commands.escape();
      expected.select([]);
      return;
    }
    commands.trace();
    const { indices } = TEMPLATE.contours[0];
    for (const i of NAMES.keys()) {
      const stays = before.points[i] && (!indices.includes(i) || (KINDS[i] === "landmark" && before.origins[i] !== "proposed"));
      if (stays) assert.deepEqual(marking.points[i], before.points[i], `tracing moved ${NAMES[i]}`);
      if (before.absent.includes(i)) assert.equal(marking.points[i], null, `tracing placed ${NAMES[i]}, which is absent`);
      else if (indices.includes(i)) assert.ok(marking.points[i], `tracing did not place ${NAMES[i]}`);
      else assert.deepEqual(marking.points[i], before.points[i]);
    }
    const traced = copy(marking.points);
    const isStep = JSON.stringify(traced) !== JSON.stringify(before.points); // all others of the contour may be absent
    if (isStep) expected.step((now) => {
      for (const i of indices)
        if (JSON.stringify(traced[i]) !== JSON.stringify(now.points[i])) now.origins[i] = "placed";
      now.points = traced;
      now.absent = now.absent.filter((i) => !traced[i]);
      now.suggested = false;
    });
    const next = expected.after(indices.at(-1));
    expected.select([next < 0 ? indices.at(-1) : next]);
  },
};

test("points of the last done picture before this one are copied as proposed, in one step", async () => {
  const [server, storage] = [new Server(), new Storage()];
  server.put(PICTURES[0], { points: PROPOSED, invisible: [], origins: NAMES.map(() => "placed"), revision: null });
  const tab = await openTab(server, storage, PICTURES[1]);
  Object.assign(tab.state, { order: PICTURES });
  await tab.commands.copyPrevious();
  assert.match(tab.toasts[0], /No picture before/);
  tab.state.pictures[0].state = "done";
  tab.press([50, 50]); // the first point
  await tab.commands.copyPrevious();
  assert.deepEqual([tab.marking.points, new Set(tab.marking.origins)], [PROPOSED, new Set(["proposed"])]);
  tab.commands.travel("undo");
  assert.deepEqual(tab.marking.points, [[50, 50], ...none().slice(1)]);
  await tab.saver.flush();
});

/** Weights of the steps; the others are of the whole session. */
const WEIGHTS = { click: 12, drag: 6, choose: 4, undo: 7, redo: 4, clear: 2, hide: 1, absent: 1, confirm: 2, accept: 1, trace: 2 };
const SESSION = { go: 2, reload: 0.4, elsewhere: 1 };

test(`${STEPS} random steps leave the names and points that a plain model expects`, async () => {
  const random = generator(SEED);
  const [server, storage] = [new Server(), new Storage()];
  const books = new Map(); // what is expected of each picture that was opened since the page was loaded
  const choices = Object.entries({ ...WEIGHTS, ...SESSION });
  const total = choices.reduce((sum, [, weight]) => sum + weight, 0);
  const behind = new Set(); // the pictures that another tab has changed since they were open
  const log = [];
  let name = PICTURES[0];
  let tab = await openTab(server, storage, name);

  const expectedOf = (picture) => {
    if (!books.has(picture)) books.set(picture, new Expected(server.marks(picture)));
    return books.get(picture);
  };
  /** As the page opens a picture: points are clicked one after another. */
  const opened = () => {
    behind.delete(name);
    const expected = expectedOf(name);
    expected.select([]);
    if (!expected.now.suggested && expected.left.length) expected.select([expected.left[0]]);
  };
  const check = () => {
    const { now } = expectedOf(name);
    const { marking } = tab;
    const found = {
      points: marking.points, origins: marking.origins, absent: marking.absent, invisible: [...marking.invisible],
      suggested: marking.suggested, chosen: [...marking.selection], active: marking.active,
    };
    const { points, origins, absent, invisible, suggested, chosen, active } = now;
    assert.deepEqual(copy(found), copy({ points, origins, absent, invisible, suggested, chosen, active }), `after ${log.slice(-12).join(" ")}`);
  };
  const saved = async () => {
    await tab.saver.flush();
    assert.equal(tab.saver.dirty.length, 0);
    for (const [picture, { now }] of books) {
      if (now.suggested) continue;
      const { points, invisible, absent, origins } = server.marks(picture);
      const isEmpty = !now.points.some(Boolean);
      if (isEmpty) assert.ok(!server.files.get(picture)?.points.some(Boolean));
      else assert.ok(sameMarks({ points, invisible, absent, origins }, now, 0), `${picture} after ${log.slice(-12).join(" ")}`);
    }
  };
  /** A place that is far from all points. */
  const free = () => {
    const used = [...(tab.marking.points ?? []), ...(tab.tracing.on ? tab.tracing.points : [])].filter(Boolean);
    for (;;) {
      const at = [Math.floor(random() * SIZE), Math.floor(random() * SIZE)];
      if (used.every((point) => Math.hypot(point[0] - at[0], point[1] - at[1]) > ROOM)) return at;
    }
  };

  /** Another tab takes its last step in a picture back, or places a point: Undo here is to take back the same as there. */
  const elsewhere = (picture, step) => {
    const marks = server.marks(picture);
    const expected = books.get(picture);
    const isOpen = picture === name;
    if (!isOpen && behind.has(picture)) return; // several changes are one step of a page that does not show the picture
    behind.add(picture);
    const [chosen, active] = isOpen ? [expected.now.chosen, expected.now.active] : [[], -1];
    const before = expected?.past.at(-1);
    const takesBack = before && !before.suggested && before.points.some(Boolean) && random() < 0.5;
    const index = Math.floor(random() * NAMES.length);
    const points = takesBack ? before.points : marks.points.map((point, i) => (i === index ? [step + 0.5, 7] : point));
    const origins = takesBack ? before.origins
      : points.map((point, i) => point && (i === index ? "placed" : (marks.origins?.[i] ?? "proposed")));
    const { absent, invisible } = takesBack ? before : { ...marks, absent: marks.absent.filter((i) => i !== index) };
    const { revision } = server.put(picture, { points, origins, absent, invisible, revision: marks.revision });
    tab.saver.heard(picture, revision);
    if (!expected) return;
    if (!isOpen) expected.select([]);
    if (takesBack) expected.undo();
    else expected.step((now) => Object.assign(now, copy({ points, origins, absent, invisible, suggested: false })));
    expected.select(chosen, active);
    if (isOpen && !chosen.length && expected.left.length) expected.select([expected.left[0]]);
  };

  opened();
  check();
  for (let step = 0; step < STEPS; step += 1) {
    let draw = random() * total;
    const what = choices.find(([, weight]) => (draw -= weight) < 0)?.[0] ?? "click";
    log.push(what);
    if (what === "go") {
      name = PICTURES[Math.floor(random() * PICTURES.length)];
      tab.state.select(name);
      await tab.settled();
      await saved();
      opened();
    } else if (what === "reload") {
      await saved();
      books.clear();
      behind.clear();
      tab = await openTab(server, storage, name);
      opened();
    } else if (what === "elsewhere") {
      await saved();
      elsewhere(PICTURES[Math.floor(random() * PICTURES.length)], step);
      await new Promise(setImmediate); // the open picture follows
    } else STEP[what]({ tab, expected: expectedOf(name), free, random });
    check();
  }
  await saved();
});
