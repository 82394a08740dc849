// Saving after every change: one request in flight per picture, the latest wins, nothing is lost while the server is
// away. Knows neither the page nor what points mean: what is saved is {points, invisible}.

import { sameMarks } from "./points.js";
import { carried } from "./template.js";

export const DELAY = 250; // milliseconds from a change to its request
const RETRY = [1000, 2000, 4000, 8000];

/** What is sent says which file and which template it is made for; a server that tells no revision is not told one. */
function body({ sent, revision, template }) {
  return template?.revision === undefined
    ? { ...sent, revision }
    : { ...sent, revision, template: template.revision };
}

const sizeOf = ({ width = null, height = null }) => ({ width, height });

/** Whether two sizes may be of one picture: those that were not told may be. */
const mayBeOne = (a, b) => !a?.width || !b?.width || (a.width === b.width && a.height === b.height);

/** What a picture's landmark file holds, of what the server tells: proposals are not in any file. */
export function contentOf({ points, invisible, source }) {
  return source === "file" ? { points, invisible } : { points: points.map(() => null), invisible: [] };
}

/** Unsaved marks of a folder, kept where a reload finds them. Tabs share the storage, so what is kept says whose it is:
 *  `page` names this page. */
export class Unsaved {
  /** `folder`: the project's id, as folders of one name are many. */
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
export const STATES = ["conflict", "refused", "failing", "offline", "saving", "saved"];

/** Answers after which the same again may be taken: none, one that wants the token, and a server that cannot now. */
const isOffline = ({ status }) => !status || [401, 403, 421].includes(status);
const isFinal = (error) => error.status >= 400 && error.status < 500 && !isOffline(error);

export class Saver {
  /** @param {object} options
   *  put(name, body) -> Promise of {revision}; rejects with {status, message, body}. It should outlive the page
   *  (keepalive), so that a flush when the page goes away is enough; what does not land is kept in `unsaved`.
   *  unsaved: Unsaved; template() -> {names, revision} that marks are made for now;
   *  onStatus(state, message); onSaved(name, answer); onConflict(name, current); onForeign(name);
   *  onTemplate(name): the server has another template: give the new one to `template`, then call `rebase`;
   *  onLost(name, sentence): something that was kept cannot be saved */
  constructor({
    put,
    unsaved,
    onStatus,
    onSaved = () => {},
    onConflict,
    onForeign = () => {},
    onTemplate = () => {},
    onLost = () => {},
    template = () => null,
    delay = DELAY,
    setTimer = (f, ms) => setTimeout(f, ms),
    clearTimer = (id) => clearTimeout(id),
  }) {
    Object.assign(this, { put, unsaved, onStatus, onSaved, onConflict, onForeign, onTemplate, onLost });
    Object.assign(this, { template, delay, setTimer, clearTimer });
    this.entries = new Map();
  }

  entry(name) {
    if (!this.entries.has(name)) {
      this.entries.set(name, {
        revision: null,
        template: null,
        size: null,
        deleted: false,
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
  known(name, revision, content, size = null) {
    const entry = this.entry(name);
    entry.revision = revision;
    entry.saved = content;
    entry.size = size ?? entry.size;
  }

  /** What is not on the server yet, or null. */
  pending(name) {
    const entry = this.entries.get(name);
    return entry?.wanted ?? entry?.sent ?? null;
  }

  /** Whether a conflict is about a file that is no longer there. */
  wasDeleted(name) {
    return this.entry(name).deleted;
  }

  /** Whether something of this picture is not on the server yet. */
  isDirty(name) {
    const entry = this.entries.get(name);
    return Boolean(entry && (entry.wanted || entry.sent));
  }

  /** Names of all pictures that have something unsaved. */
  get dirty() {
    return [...this.entries.keys()].filter((name) => this.isDirty(name));
  }

  get anyDirty() {
    return this.dirty.length > 0;
  }

  /** A picture whose conflict waits to be decided, or null. */
  get conflicted() {
    return [...this.entries].find(([, entry]) => entry.state === "conflict")?.[0] ?? null;
  }

  change(name, content) {
    const entry = this.entry(name);
    if (!entry.sent && !entry.wanted && entry.saved && sameMarks(entry.saved, content, 0)) return;
    entry.wanted = content;
    entry.template = this.template();
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
    const { wanted, sent, revision, saved, template, size } = entry;
    this.unsaved.set(name, { wanted: wanted ?? sent, sent, revision, saved, template, size });
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
    const { current, template } = error.body ?? {};
    if (error.status === 409 && template && !current) {
      this.mark(entry, "failing", error.message);
      this.onTemplate(name);
      return;
    }
    if (error.status === 409 && current) {
      entry.deleted = current.revision === null && entry.revision !== null;
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
    if (isFinal(error)) {
      this.mark(entry, "refused", error.message); // the same again would be refused again
      return;
    }
    const wait = RETRY[Math.min(entry.retries, RETRY.length - 1)];
    entry.retries += 1;
    if (isOffline(error)) this.mark(entry, "offline", error.status === 401 ? error.message : "");
    else this.mark(entry, "failing", error.message);
    this.schedule(name, entry, wait);
  }

  /** The server answers again. */
  retry() {
    for (const [name, entry] of this.entries) {
      if (entry.state !== "offline" && entry.state !== "failing") continue;
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
    entry.deleted = false;
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

  /** Unsaved marks of a picture were made for another template than there is now: carry them over.
   *  current: Marks of the picture under the new template; `mapping`: old index or null of each new point, if known. */
  rebase(name, current, mapping = null) {
    const entry = this.entry(name);
    const content = this.pending(name);
    if (!content || entry.sent) return; // what is under way comes back here by its answer
    const moved = this.carry(name, { wanted: content, saved: entry.saved, template: entry.template }, current, mapping);
    this.known(name, current.revision, contentOf(current), sizeOf(current));
    entry.template = this.template();
    entry.state = "saving";
    entry.retries = 0;
    this.clearTimer(entry.timer);
    entry.timer = null;
    this.resume(name, entry, moved, current);
  }

  /** Marks of another template as marks of this one: {wanted, ours}; null where none of them has a place in it. */
  carry(name, { wanted, saved, template }, current, mapping = null) {
    const now = contentOf(current);
    const names = this.template()?.names ?? [];
    const move = (content) => carried(content, template?.names ?? null, names, now, mapping);
    const { content, lost } = move(wanted);
    if (lost.length) {
      const what = lost.length > 3 ? `${lost.length} points` : lost.map((point) => `'${point}'`).join(", ");
      this.onLost(name, `The template has no ${what} any more, which you had placed in ${name}.`);
    }
    return { wanted: content, ours: content && saved ? sameMarks(move(saved).content ?? now, now) : false };
  }

  /** Save what was taken up, or ask where the server has something else. */
  resume(name, entry, { wanted, ours }, current) {
    if (!wanted || sameMarks(wanted, contentOf(current))) {
      entry.wanted = null;
      this.unsaved.delete(name);
      this.mark(entry, "saved");
      return null;
    }
    entry.wanted = wanted;
    this.keep(name, entry);
    if (ours) {
      this.mark(entry, "saving");
      this.schedule(name, entry, 0);
    } else {
      this.mark(entry, "conflict");
      this.onConflict(name, current);
    }
    return wanted;
  }

  /** Take up what an earlier page could not save. `current`: what the server has. Returns the content to show, or
   *  null where the server has it all. */
  restore(name, current) {
    const kept = this.unsaved.get(name);
    const content = contentOf(current);
    this.known(name, current.revision, content, sizeOf(current));
    if (!kept?.wanted) {
      this.unsaved.delete(name);
      return null;
    }
    const entry = this.entry(name);
    if (!mayBeOne(kept.size, current)) {
      this.onLost(name, `${name} is another picture now: the points that were not saved yet belong to the one before.`);
      this.unsaved.delete(name);
      return null;
    }
    const now = this.template();
    const another = Boolean(kept.template?.names) && kept.template.revision !== now?.revision;
    entry.template = now;
    if (another) return this.resume(name, entry, this.carry(name, kept, current), current);
    if (kept.wanted.points?.length !== content.points.length) {
      this.onLost(name, `Points of ${name} that were not saved yet are of another template, and were given up.`);
      this.unsaved.delete(name);
      return null;
    }
    entry.deleted = current.revision === null && (kept.revision ?? null) !== null;
    const ours = kept.revision === current.revision || Boolean(kept.sent && sameMarks(kept.sent, content));
    return this.resume(name, entry, { wanted: kept.wanted, ours }, current);
  }
}
