// Saving after every change: one request in flight per picture, the latest wins, nothing is lost while the server is
// away. Knows neither the page nor what points mean: what is saved is {points, invisible}.

import { sameMarks } from "./points.js";

export const DELAY = 250; // milliseconds from a change to its request
const RETRY = [1000, 2000, 4000, 8000];

const body = (entry) => ({ ...entry.sent, revision: entry.revision });

/** What a picture's landmark file holds, of what the server tells: proposals are not in any file. */
export function contentOf({ points, invisible, source }) {
  return source === "file" ? { points, invisible } : { points: points.map(() => null), invisible: [] };
}

/** Unsaved marks of a folder, kept where a reload finds them. Tabs share the storage, so what is kept says whose it is:
 *  `page` names this page. */
export class Unsaved {
  constructor(storage, folder, page = "") {
    this.storage = storage;
    this.page = page;
    this.prefix = `liaam-studio:unsaved:${folder}:`;
  }

  set(name, entry) {
    try {
      this.storage.setItem(this.prefix + name, JSON.stringify({ ...entry, page: this.page }));
    } catch {
      // A full or forbidden storage must not keep anyone from working; the request is under way all the same.
    }
  }

  get(name) {
    try {
      return JSON.parse(this.storage.getItem(this.prefix + name));
    } catch {
      return null;
    }
  }

  delete(name) {
    try {
      this.storage.removeItem(this.prefix + name);
    } catch {
      // As above.
    }
  }

  names() {
    try {
      return Object.keys(this.storage)
        .filter((key) => key.startsWith(this.prefix))
        .map((key) => key.slice(this.prefix.length));
    } catch {
      return [];
    }
  }
}

const LOCK = "liaam-studio:page:";
const LAST = "liaam-studio:last-page";

/** This page among the tabs: its name, and which others live. A lock is held for as long as a page lives, so that what
 *  a tab is about to save is not taken for what a dead one left. */
export class Page {
  constructor({ locks = globalThis.navigator?.locks, session = sessionStorage } = {}) {
    this.locks = locks;
    this.name = `${Date.now().toString(36)}-${Math.random().toString(36).slice(2)}`;
    try {
      this.before = session.getItem(LAST); // the page that this tab showed before it was loaded again
      session.setItem(LAST, this.name);
    } catch {
      this.before = null;
    }
    locks?.request(LOCK + this.name, () => new Promise(() => {})).catch(() => {});
  }

  /** Whether what `page` kept is nobody's any more, and so ours to save. */
  async inherits(page) {
    if (page === this.name || page === this.before || !this.locks) return true;
    const { held } = await this.locks.query();
    return !held.some((lock) => lock.name === LOCK + page);
  }
}

/** What an entry is waiting for, worst first: the status line shows the worst of all pictures. */
export const STATES = ["conflict", "refused", "offline", "saving", "saved"];

export class Saver {
  /** @param {object} options
   *  put(name, body) -> Promise of {revision}; rejects with {status, message, body}. It should outlive the page
   *  (keepalive), so that a flush when the page goes away is enough; what does not land is kept in `unsaved`.
   *  unsaved: Unsaved; onStatus(state, message); onSaved(name, answer); onConflict(name, current); onForeign(name) */
  constructor({
    put,
    unsaved,
    onStatus,
    onSaved = () => {},
    onConflict,
    onForeign = () => {},
    delay = DELAY,
    setTimer = (f, ms) => setTimeout(f, ms),
    clearTimer = (id) => clearTimeout(id),
  }) {
    Object.assign(this, { put, unsaved, onStatus, onSaved, onConflict, onForeign, delay, setTimer, clearTimer });
    this.entries = new Map();
  }

  entry(name) {
    if (!this.entries.has(name)) {
      this.entries.set(name, {
        revision: null,
        saved: null,
        wanted: null,
        sent: null,
        timer: null,
        retries: 0,
        state: "saved",
        message: "",
        heard: null,
      });
    }
    return this.entries.get(name);
  }

  /** What the server has now. */
  known(name, revision, content) {
    const entry = this.entry(name);
    entry.revision = revision;
    entry.saved = content;
  }

  /** Whether something of this picture is not on the server yet. */
  isDirty(name) {
    const entry = this.entries.get(name);
    return Boolean(entry && (entry.wanted || entry.sent));
  }

  get anyDirty() {
    return [...this.entries.keys()].some((name) => this.isDirty(name));
  }

  /** A picture whose conflict waits to be decided, or null. */
  get conflicted() {
    return [...this.entries].find(([, entry]) => entry.state === "conflict")?.[0] ?? null;
  }

  change(name, content) {
    const entry = this.entry(name);
    if (!entry.sent && !entry.wanted && entry.saved && sameMarks(entry.saved, content, 0)) return;
    entry.wanted = content;
    this.keep(name, entry);
    if (entry.state === "conflict") return; // the person decides first
    this.mark(entry, "saving");
    if (entry.sent) return; // goes when the one in flight is back
    this.schedule(name, entry, this.delay);
  }

  schedule(name, entry, delay) {
    if (entry.timer !== null) return; // at most `delay` after the first change, not after the last
    entry.timer = this.setTimer(() => {
      entry.timer = null;
      this.send(name);
    }, delay);
  }

  keep(name, entry) {
    this.unsaved.set(name, { wanted: entry.wanted ?? entry.sent, sent: entry.sent, revision: entry.revision });
  }

  mark(entry, state, message = "") {
    entry.state = state;
    entry.message = message;
    this.report();
  }

  report() {
    const all = [...this.entries.values()];
    const worst = STATES.find((state) => all.some((entry) => entry.state === state)) ?? "saved";
    this.onStatus(worst, all.find((entry) => entry.state === worst)?.message ?? "");
  }

  flush(name = null) {
    const names = name === null ? [...this.entries.keys()] : [name];
    return Promise.all(names.map((each) => this.send(each)));
  }

  async send(name) {
    const entry = this.entry(name);
    if (entry.sent || !entry.wanted || entry.state === "conflict") return;
    this.clearTimer(entry.timer);
    entry.timer = null;
    entry.sent = entry.wanted;
    entry.wanted = null;
    this.keep(name, entry);
    try {
      this.landed(name, entry, await this.put(name, body(entry)));
    } catch (error) {
      this.failed(name, entry, error);
    }
  }

  landed(name, entry, answer) {
    entry.revision = answer.revision;
    entry.saved = entry.sent;
    entry.sent = null;
    entry.retries = 0;
    this.onSaved(name, answer);
    if (entry.wanted) {
      this.keep(name, entry);
      this.send(name);
      return;
    }
    this.unsaved.delete(name);
    this.mark(entry, "saved");
    this.settleHeard(name, entry);
  }

  failed(name, entry, error) {
    const sent = entry.sent;
    entry.wanted ??= sent;
    entry.sent = null;
    this.keep(name, entry);
    const current = error.body?.current;
    if (error.status === 409 && current) {
      entry.revision = current.revision;
      entry.saved = contentOf(current);
      // Our own request may have landed although its answer was lost: then there is nothing to decide.
      if (sameMarks(entry.saved, sent)) {
        if (entry.wanted === sent) entry.wanted = null;
        entry.sent = sent;
        this.landed(name, entry, { revision: current.revision });
        return;
      }
      this.mark(entry, "conflict");
      this.onConflict(name, current);
      return;
    }
    if (
      error.status >= 400 &&
      error.status < 500 &&
      error.status !== 401 &&
      error.status !== 403 &&
      error.status !== 421
    ) {
      this.mark(entry, "refused", error.message); // the same again would be refused again
      return;
    }
    const wait = RETRY[Math.min(entry.retries, RETRY.length - 1)];
    entry.retries += 1;
    this.mark(entry, "offline", error.status === 401 ? error.message : "");
    this.schedule(name, entry, wait);
  }

  /** The server answers again. */
  retry() {
    for (const [name, entry] of this.entries) {
      if (entry.state !== "offline") continue;
      this.clearTimer(entry.timer);
      entry.timer = null;
      this.send(name);
    }
  }

  /** After a conflict: "mine" writes ours over theirs, "theirs" forgets ours. */
  settle(name, which) {
    const entry = this.entry(name);
    if (entry.state !== "conflict") return Promise.resolve();
    entry.state = "saving";
    if (which === "mine") {
      this.keep(name, entry);
      return this.send(name);
    }
    entry.wanted = null;
    this.unsaved.delete(name);
    this.mark(entry, "saved");
    return Promise.resolve();
  }

  /** The server says that a picture's landmarks have this revision now. */
  heard(name, revision) {
    const entry = this.entry(name);
    entry.heard = revision;
    if (!this.isDirty(name)) this.settleHeard(name, entry);
  }

  settleHeard(name, entry) {
    const { heard } = entry;
    entry.heard = null;
    if (heard !== null && heard !== entry.revision) this.onForeign(name);
  }

  /** Take up what an earlier page could not save. `current`: what the server has. Returns the content to show, or
   *  null where the server has it all. */
  restore(name, current) {
    const kept = this.unsaved.get(name);
    const content = contentOf(current);
    this.known(name, current.revision, content);
    if (!kept?.wanted || kept.wanted.points?.length !== content.points.length || sameMarks(kept.wanted, content)) {
      this.unsaved.delete(name);
      return null;
    }
    const entry = this.entry(name);
    const ours = kept.revision === current.revision || (kept.sent && sameMarks(kept.sent, content));
    entry.wanted = kept.wanted;
    if (!ours) {
      this.mark(entry, "conflict");
      this.onConflict(name, current);
      return kept.wanted;
    }
    this.mark(entry, "saving");
    this.schedule(name, entry, 0);
    return kept.wanted;
  }
}
