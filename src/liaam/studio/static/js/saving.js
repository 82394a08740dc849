// Saving after every change: one request at a time per picture, with the latest content, which is kept in the browser
// while the server is unreachable. The content is {points, invisible, absent, origins, bar}, as far as it is known. This
// module is independent of the page.

/** @typedef {Pick<SaveMarks, "points" | "invisible" | "absent" | "origins" | "bar">} Content */

import { sameBar, sameMarks } from "./points.js";
import { carried } from "./template.js";

const DELAY = 250; // milliseconds between a change and its request
const RETRY = [1000, 2000, 4000, 8000];

/** Body of a request: the content with the revisions of the file and, if known, of the template. A scale bar that stays
 *  is left out, since it may have been set with those of other pictures meanwhile. @returns {SaveMarks} */
function body(/** @type {{sent: Content, saved: Content | null, revision: string | null, template: any}} */ entry) {
  const { sent, saved, revision, template } = entry;
  const { bar, ...points } = sent;
  const { absent, origins } = saved ?? {};
  /** @type {SaveMarks} */
  const asked = { ...(saved && sameBar(bar, saved.bar) ? points : sent), revision };
  /** @type {Base} */
  const base = {};
  if (absent) base.absent = absent;
  if (origins) base.origins = origins;
  if (absent || origins) asked.base = base;
  if (template?.revision !== undefined) asked.template = template.revision;
  return asked;
}

const sizeOf = ({ width = null, height = null }) => ({ width, height });

/** Whether two sizes may belong to the same picture; unknown sizes may. */
const mayBeOne = (a, b) => !a?.width || !b?.width || (a.width === b.width && a.height === b.height);

/** The contents of a picture's landmark file, from the server's answer; proposals are not in a file.
 *  @param {Pick<Marks, "points" | "invisible" | "absent" | "origins" | "source"> & Partial<Marks>} marks; @returns {Content} */
export function contentOf({ points, invisible, absent, origins, source, bar = null }) {
  const known = { ...(absent && { absent }), ...(source === "file" && origins && { origins }) };
  return source === "file" ? { points, invisible, bar, ...known }
    : { points: points.map(() => null), invisible: [], bar, ...known };
}

/** States of an entry, worst first: the status line shows the worst of all pictures. */
export const STATES = ["conflict", "refused", "failing", "offline", "saving", "saved"];

/** Whether the request may succeed later, because the server was unreachable or requires its token. */
const isOffline = ({ status }) => !status || [401, 403, 421].includes(status);
const isFinal = (error) => error.status >= 400 && error.status < 500 && !isOffline(error);

const DEFAULTS = {
  onSaved() {}, onForeign() {}, onTemplate() {}, onLost() {}, template: () => null, delay: DELAY,
  setTimer: (f, ms) => setTimeout(f, ms), clearTimer: (id) => clearTimeout(id),
};

export class Saver {
  #options;
  #unsaved;
  #template;
  #entries = new Map();

  /** @param {any} options
   *  put(name, body) -> Promise of {revision}; rejects with {status, message, body}. It should outlive the page, so
   *  that a flush is enough on closing; unsaved: Unsaved; template() -> {names, revision}; onStatus(state, message);
   *  onSaved(name, answer); onConflict(name, current); onForeign(name): the landmarks were changed elsewhere;
   *  onTemplate(name): update `template`, then call `rebase`; onLost(name, sentence): unsaved marks cannot be saved */
  constructor(options) {
    this.#options = { ...DEFAULTS, ...options };
    this.#unsaved = options.unsaved;
    this.#template = this.#options.template;
  }

  #entry(name) {
    const fresh = {
      revision: null, beside: null, template: null, size: null, deleted: false, saved: null, wanted: null, sent: null, timer: null,
      retries: 0, state: "saved", message: "", heard: null, request: null,
    };
    if (!this.#entries.has(name)) this.#entries.set(name, fresh);
    return this.#entries.get(name);
  }

  /** beside: what else changes with the landmarks, if it is known. */
  known(name, revision, content, size = null, beside = null) {
    const entry = this.#entry(name);
    Object.assign(entry, { revision, saved: content, size: size ?? entry.size, beside });
  }

  /** The content that is not on the server yet, or null. */
  pending(name) {
    const entry = this.#entries.get(name);
    return entry?.wanted ?? entry?.sent ?? null;
  }

  /** The revision of a picture's landmarks that this page has read or saved; null without a file. */
  revisionOf(name) { return this.#entry(name).revision; }

  isDirty(name) { return this.pending(name) !== null; }

  /** Whether the unsaved content of a picture belongs to an earlier template. */
  isStale(name) {
    return this.isDirty(name) && this.#entry(name).template?.revision !== this.#template()?.revision;
  }

  get dirty() { return [...this.#entries.keys()].filter((name) => this.isDirty(name)); }

  get conflicted() { return [...this.#entries].find(([, entry]) => entry.state === "conflict")?.[0] ?? null; }

  isInConflict(name) { return this.#entry(name).state === "conflict"; }

  /** Whether the landmark file of a picture in conflict was deleted. */
  isDeleted(name) { return this.#entry(name).deleted; }

  /** Resolves once the running request of a picture is answered. */
  async answered(name) { await this.#entry(name).request; }

  /** What a page could not save of a picture, with its `page`, or null; and the names of such pictures. */
  kept(name) { return this.#unsaved.get(name); }
  get keptNames() { return this.#unsaved.names(); }

  change(name, content) {
    const entry = this.#entry(name);
    if (!entry.sent && !entry.wanted && entry.saved && sameMarks(entry.saved, content, 0)) return;
    entry.wanted = content;
    entry.template = this.#template();
    this.#keep(name, entry);
    if (entry.state === "conflict") return; // the user has to decide first
    this.#mark(entry, "saving");
    if (entry.sent) return; // sent after the answer to the running request
    this.#schedule(name, entry, this.#options.delay);
  }

  #schedule(name, entry, delay) {
    if (entry.timer !== null) return; // at most `delay` after the first change, not after the last
    entry.timer = this.#options.setTimer(() => {
      entry.timer = null;
      this.#send(name);
    }, delay);
  }

  #keep(name, entry) {
    const { wanted, sent, revision, saved, template, size } = entry;
    this.#unsaved.set(name, { wanted: wanted ?? sent, sent, revision, saved, template, size });
  }

  #mark(entry, state, message = "") {
    Object.assign(entry, { state, message });
    this.report();
  }

  #conflict(name, entry, current) {
    this.#mark(entry, "conflict");
    this.#options.onConflict(name, current);
  }

  #settle(name, entry) {
    this.#unsaved.delete(name);
    this.#mark(entry, "saved");
  }

  report() {
    const all = [...this.#entries.values()];
    const worst = STATES.find((state) => all.some((entry) => entry.state === state)) ?? "saved";
    this.#options.onStatus(worst, all.find((entry) => entry.state === worst)?.message ?? "");
  }

  flush(name = null) {
    const names = name === null ? [...this.#entries.keys()] : [name];
    return Promise.all(names.map((each) => this.#send(each)));
  }

  async #send(name) {
    const entry = this.#entry(name);
    if (!entry.sent && entry.wanted && entry.state !== "conflict") entry.request = this.#sendNow(name, entry);
    await entry.request;
  }

  async #sendNow(name, entry) {
    this.#options.clearTimer(entry.timer);
    Object.assign(entry, { timer: null, sent: entry.wanted, wanted: null });
    this.#keep(name, entry);
    try {
      await this.#landed(name, entry, await this.#options.put(name, body(entry)));
    } catch (error) {
      await this.#failed(name, entry, error);
    }
  }

  /** @param {string} name; @param {any} entry; @param {Partial<Saved>} answer */
  #landed(name, entry, answer) {
    const { revision, beside = null, merged = false } = answer;
    Object.assign(entry, { revision, beside, saved: entry.sent, sent: null, retries: 0 });
    this.#options.onSaved(name, answer);
    if (merged) entry.heard = { revision, beside: "" }; // others have changed what this page does not show yet
    if (entry.wanted) {
      this.#keep(name, entry);
      return this.#sendNow(name, entry);
    }
    this.#settle(name, entry);
    return this.#handleHeard(name, entry);
  }

  #failed(name, entry, error) {
    const sent = entry.sent;
    entry.wanted ??= sent;
    entry.sent = null;
    this.#keep(name, entry);
    const { current, template } = /** @type {Partial<Fault>} */ ((error.status === 409 && error.body) || {});
    if (template && !current) {
      this.#mark(entry, "failing", error.message);
      this.#options.onTemplate(name); // not awaited: it waits for this request
      return undefined;
    }
    if (current) {
      entry.deleted = current.revision === null && entry.revision !== null;
      entry.revision = current.revision;
      entry.saved = contentOf(current);
      // If only the answer to an earlier request was lost, there is no conflict.
      if (sameMarks(entry.saved, sent)) {
        if (entry.wanted === sent) entry.wanted = null;
        entry.sent = sent;
        return this.#landed(name, entry, { revision: current.revision });
      }
      return this.#conflict(name, entry, current);
    }
    if (isFinal(error)) return this.#mark(entry, "refused", error.message); // a retry would be refused, too
    const wait = RETRY[Math.min(entry.retries, RETRY.length - 1)];
    entry.retries += 1;
    if (isOffline(error)) this.#mark(entry, "offline", error.status === 401 ? error.message : "");
    else this.#mark(entry, "failing", error.message);
    return this.#schedule(name, entry, wait);
  }

  retry() {
    for (const [name, { state }] of this.#entries) if (state === "offline" || state === "failing") this.#send(name);
  }

  /** Resolve a conflict: "mine" overwrites the server's version, "theirs" discards the version of this page. */
  async resolveConflict(name, which) {
    const entry = this.#entry(name);
    if (entry.state !== "conflict") return undefined;
    Object.assign(entry, { state: "saving", deleted: false });
    if (which === "mine") {
      this.#keep(name, entry);
      return this.#send(name);
    }
    entry.wanted = null;
    return this.#settle(name, entry);
  }

  heard(name, revision, beside = null) {
    const entry = this.#entry(name);
    entry.heard = { revision, beside };
    if (!this.isDirty(name)) this.#handleHeard(name, entry);
  }

  #handleHeard(name, entry) {
    const { heard } = entry;
    entry.heard = null;
    const isOther = (mine, other) => mine !== null && other !== null && mine !== other;
    if (heard && (heard.revision !== entry.revision || isOther(entry.beside, heard.beside))) this.#options.onForeign(name);
  }

  /** Convert the unsaved marks of a picture to the current template.
   *  current: the server's marks with that template; `mapping`: old index or null of each new point, if known.
   *  @param {string} name; @param {Marks} current; @param {(number | null)[] | null} mapping */
  rebase(name, current, mapping = null) {
    const entry = this.#entry(name);
    const content = this.pending(name);
    if (!content || entry.sent) return; // a running request calls this again through its answer
    const origins = this.isStale(name) ? mapping : null; // it may have been converted already
    const moved = this.#carry(name, { wanted: content, saved: entry.saved, template: entry.template }, current, origins);
    this.known(name, current.revision, contentOf(current), sizeOf(current), current.beside ?? null);
    this.#options.clearTimer(entry.timer);
    Object.assign(entry, { template: this.#template(), state: "saving", retries: 0, timer: null });
    this.#resume(name, entry, moved, current);
  }

  /** Convert marks of another template to the current one: {wanted: null if no point can be converted, ours}. */
  #carry(name, { wanted, saved, template }, current, mapping = null) {
    const now = contentOf(current);
    const names = this.#template()?.names ?? [];
    const move = (content) => carried(content, template?.names ?? null, names, now, mapping);
    const { content, lost } = move(wanted);
    if (lost.length) {
      const what = lost.length > 3 ? `${lost.length} points` : lost.map((point) => `'${point}'`).join(", ");
      this.#options.onLost(name, `The template no longer has ${what}, which you had placed in ${name}.`);
    }
    return { wanted: content, ours: content && saved ? sameMarks(move(saved).content ?? now, now) : false };
  }

  /** Save restored marks, or report a conflict if the server's content differs. */
  #resume(name, entry, { wanted, ours }, current) {
    if (!wanted || sameMarks(wanted, contentOf(current))) {
      entry.wanted = null;
      this.#settle(name, entry);
      return null;
    }
    entry.wanted = wanted;
    this.#keep(name, entry);
    if (!ours) this.#conflict(name, entry, current);
    else {
      this.#mark(entry, "saving");
      this.#schedule(name, entry, 0);
    }
    return wanted;
  }

  /** Restore marks that an earlier page could not save; return the content to show, or null if there is none.
   *  @param {string} name; @param {Marks} current */
  restore(name, current) {
    const kept = this.#unsaved.get(name);
    const content = contentOf(current);
    this.known(name, current.revision, content, sizeOf(current), current.beside ?? null);
    const drop = (why) => {
      if (why) this.#options.onLost(name, why);
      this.#unsaved.delete(name);
      return null;
    };
    if (!kept?.wanted) return drop("");
    if (!mayBeOne(kept.size, current))
      return drop(`${name} was replaced by another picture: the unsaved points of the earlier one were dropped.`);
    const entry = this.#entry(name);
    const now = this.#template();
    const another = Boolean(kept.template?.names) && kept.template.revision !== now?.revision;
    entry.template = now;
    if (another) return this.#resume(name, entry, this.#carry(name, kept, current), current);
    if (kept.wanted.points?.length !== content.points.length)
      return drop(`The unsaved points of ${name} belong to another template and were dropped.`);
    entry.deleted = current.revision === null && (kept.revision ?? null) !== null;
    const ours = kept.revision === current.revision || Boolean(kept.sent && sameMarks(kept.sent, content));
    return this.#resume(name, entry, { wanted: kept.wanted, ours }, current);
  }
}
