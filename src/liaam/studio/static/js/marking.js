// The marks of the open picture while they are edited: selection, display and undo history, independent of the page.
//
// A *state* {points, invisible, absent, origins, source, bar} is an immutable value in the undo history. Source "file" is
// placed by the user, "proposal" by the model, and "layout" is the mean of the done pictures. The last two are saved only
// when accepted or moved. `absent` are the points that the specimen does not have, `origins` says where each point comes
// from (origins.js), and `bar` is the scale bar, or null. A *book* {history, covariances, doubtful, ...} holds everything
// about one picture.

/** @typedef {Pick<Marks, "points" | "invisible" | "absent" | "origins" | "bar"> & {source: Marks["source"] | "layout"}} MarksState */

import { Editable, placing } from "./gestures.js";
import { isOwn, nextToConfirm, originsAfter, originsOf } from "./origins.js";
import {
  expected, flip, flipIndices, leftToPlace, nextOf, place, placed, remove, sameBar, samePoint, samePoints, toggle,
  withTwins,
} from "./points.js";

export class Marking extends Editable {
  #book = null;
  #invisible = new Set();
  #hidden = false;
  #whole = null; // the state after all points were moved together, whose frame stays until something else is changed
  #mirrored = false;
  #locked;
  #template;

  /** template() -> template of the project, or null; locked: whether the folder can only be read; handlers: those of
   *  Editable; onplaced(index): a click placed a missing point; ontogether(): proposed points were moved together. */
  constructor({ template, locked = false, ...handlers }) {
    super(handlers);
    this.#template = template;
    this.#locked = locked;
  }

  onplaced(_index) {}
  ontogether() {}
  get book() { return this.#book; }
  /** Whether the folder can only be read. */
  get locked() { return this.#locked; }
  /** Whether all marks are hidden for a moment. */
  get hidden() { return this.#hidden; }
  /** Whether mirrored points (twins) move together. */
  get mirrored() { return this.#mirrored; }
  get invisible() { return this.#invisible; }
  /** @returns {Template | null} */
  get template() { return this.#template(); }
  get names() { return this.template?.names ?? []; }
  get history() { return this.#book?.history ?? null; }
  /** @returns {MarksState | null} */
  get state() { return this.history?.state ?? null; }
  get points() { return this.shown ?? this.state?.points ?? []; }
  get editable() { return this.#book !== null && !this.#hidden && !this.#locked; }
  /** Whether the points are from the model or from other pictures, and not accepted yet. */
  get suggested() {
    return this.state !== null && (this.state.source === "proposal" || this.state.source === "layout");
  }
  get placing() {
    return this.#book !== null && this.active >= 0 && this.active < this.points.length && !this.points[this.active];
  }
  get chosen() { return [...this.selection].sort((a, b) => a - b); }
  get chosenPlaced() { return this.chosen.filter((i) => this.points[i]); }
  get absent() { return this.state?.absent ?? []; }
  /** The points that have no position yet, and are not absent. */
  get missing() { return leftToPlace(this.points, this.absent); }
  /** The first of them after `index`, cyclically; -1 if there is none. */
  nextMissing(index = -1) { return nextOf(this.missing, index); }
  get origins() { return this.state ? originsOf(this.state) : []; }
  /** The number of points that are still as they were proposed, in a picture that was changed since. */
  get proposed() { return this.suggested ? 0 : this.origins.filter((origin) => origin === "proposed").length; }

  /** The points that are where the model proposed them, null for others, whose uncertainty is not known. */
  get uncertain() {
    const { fitted = [] } = this.#book ?? {};
    return this.points.map((point, i) =>
      (point && fitted[i] && this.origins[i] === "proposed" && samePoint(point, fitted[i]) ? point : null));
  }

  framed() {
    if (this.selection.size > 1) return [...this.selection].filter((i) => this.points[i]);
    return this.#isFramed(this.state) ? placed(this.points) : [];
  }

  #isFramed(state) { return state !== null && (state.source === "layout" || state === this.#whole); }

  /** "missing", "absent", "invisible", "proposed", "accepted" or "placed". */
  stateOf(index) {
    if (!this.points[index]) return this.absent.includes(index) ? "absent" : "missing";
    if (this.invisible.has(index)) return "invisible";
    const origin = this.suggested ? "proposed" : (this.origins[index] ?? "placed");
    return isOwn(origin) ? "placed" : origin;
  }

  /** Edit the marks of a book; null: of none. */
  open(book) {
    this.setShown(null);
    this.#book = book;
    this.#invisible = new Set(this.state?.invisible);
  }

  /** Whether the marks are as they were when the picture was opened. */
  get isAsOpened() { return this.state === this.#book?.seen; }

  hide(on) { this.#hidden = on; }

  /** Let mirrored points move together, or no longer; return which. */
  toggleMirrored() { return (this.#mirrored = !this.#mirrored); }

  /** @typedef {{alone?: number, fresh?: string, changed?: string | null, accepts?: boolean, keepsLayout?: boolean, context?: any, beyond?: any}} Options
   *  Those of originsAfter, whether a mean shape stays one although its points move, what the next click depended on before the step, if that is not the present, and what the
   *  step has changed beyond this picture (of History.push). */

  /** @param {any} points; @param {string} what; @param {string | null} key; @param {Options} options */
  commit(points, what, key = null, options = {}) { this.change({ points }, what, key, options); }

  /** One undo step. It accepts a proposal, unless it changes the scale bar, and the mean shape if a point moves.
   *  @param {any} change; @param {string} what; @param {string | null} key; @param {Options} options */
  change(change, what, key = null, { context = this.contextBefore, beyond = null, ...options } = {}) {
    if (this.#locked) return;
    const before = this.state;
    const { points, invisible, absent = [], bar = null } = { ...before, ...change };
    this.setShown(null);
    // One that is moved alone is a person's own afterwards. The twin that moves along is not, nor are several.
    const alone = this.selection.size === 1 ? this.active : -1;
    const origins = change.origins ?? originsAfter(before, points, { alone, ...options });
    const isTouched = options.accepts || "origins" in change ||
      !points.every((point, i) => !point || samePoint(point, before.points[i]));
    const stays = "bar" in change || (before.source === "layout" && (!isTouched || options.keepsLayout));
    const source = stays ? before.source : "file";
    const state = {
      points, invisible: invisible.filter((i) => points[i]), absent: absent.filter((i) => !points[i]), origins, source, bar,
    };
    const same = samePoints(points, before.points) && state.invisible.join() === before.invisible.join() &&
      state.absent.join() === (before.absent ?? []).join() && origins.join() === originsOf(before).join() &&
      sameBar(before.bar, bar);
    if (before.source === source && same && !beyond) return;
    const moved = placed(points).filter((i) => !samePoint(points[i], before.points[i]));
    if (this.#isFramed(before) && moved.length && moved.length === placed(points).length) this.#whole = state;
    this.history.push(state, what, key, context, beyond);
    this.changed();
    const isPart = moved.length > 1 && moved.length < placed(points).length;
    if (isPart && this.selection.size > 1 && moved.some((i) => !isOwn(origins[i]))) this.ontogether();
  }

  changed() {
    this.#invisible = new Set(this.state.invisible);
    this.onchange();
  }

  follow(before, after, indices) {
    return this.#mirrored ? withTwins(before, after, indices, this.template.mirror) : after;
  }

  adding(xy) {
    if (!this.placing) return null;
    const before = this.points;
    const index = this.active;
    let at = xy;
    this.preview(place(before, index, xy));
    const up = () => {
      this.commit(place(before, index, at), `place ${this.names[index]}`);
      this.onplaced(index);
    };
    return placing(xy, (to) => { at = to; }, up, () => this.preview(null));
  }

  /** Accept all points that are still as they were proposed. */
  accept() {
    if (this.suggested || this.proposed) this.change({}, "accept", null, { accepts: true });
  }

  /** Confirm the selected point where it is, and select the next one that no person has placed, moved or confirmed.
   *  Return the index of the confirmed point; -1 if not exactly one point with a position is selected. */
  confirm() {
    const index = this.active;
    if (this.selection.size !== 1 || !this.points[index]) return -1;
    const origins = this.origins.map((origin, i) => (i === index && !isOwn(origin) ? "confirmed" : origin));
    this.change({ origins }, `confirm ${this.names[index]}`);
    const next = nextToConfirm(this.origins, index);
    if (next >= 0) this.select([next]);
    return index;
  }

  flip() {
    const { mirror } = this.template;
    const points = flip(this.points, mirror);
    const origins = points.map((point, i) => (point ? this.origins[mirror ? mirror[i] : i] : null));
    const [invisible, absent] = [this.state.invisible, this.absent].map((some) => flipIndices(some, mirror));
    this.change({ points, invisible, absent, origins }, "flip", null, { keepsLayout: true });
  }

  /** Say that the specimen lacks the selected points, or that they are there but missing. Return whether it lacks them
   *  now; null if none is selected. */
  toggleAbsent() {
    const { chosen } = this;
    if (!chosen.length) return null;
    const absent = toggle(this.absent, chosen);
    const isAbsent = absent.includes(chosen[0]);
    this.change({ points: isAbsent ? remove(this.points, chosen) : this.points, absent }, isAbsent ? "absent" : "not absent");
    const next = isAbsent ? this.nextMissing(chosen.at(-1)) : chosen[0];
    if (next < 0) this.select(chosen, -1); // so that a click beside it does not place it
    else this.select([next]);
    return isAbsent;
  }

  toggleInvisible() {
    const chosen = this.chosenPlaced;
    const invisible = toggle(this.state.invisible, chosen);
    this.change({ invisible }, "visibility");
    return invisible.includes(chosen[0]);
  }

  removeChosen() {
    const chosen = this.chosenPlaced;
    this.commit(remove(this.points, chosen), "clear");
    this.select(chosen, chosen[0]);
  }

  /** Place the selected point, or else the next missing one, at its expected position or in the middle of the picture;
   *  return its index, or -1 if all are placed. */
  placeChosen({ width, height }) {
    const index = this.placing ? this.active : this.nextMissing(this.active);
    if (index < 0) return index;
    const guess = this.template.points ? expected(this.template.points, this.points)[index] : null;
    const inside = guess && guess[0] >= 0 && guess[1] >= 0 && guess[0] < width && guess[1] < height;
    const at = inside ? guess : [width / 2, height / 2];
    this.commit(place(this.points, index, at), `place ${this.names[index]}`, null, { fresh: "proposed" });
    this.select([index]);
    return index;
  }

  /** Select the next or previous point; return its index, or -1 past the last, which clears the selection. */
  step(by) {
    const count = this.points.length;
    const next = this.active < 0 ? (by > 0 ? 0 : count - 1) : this.active + by;
    const inside = next >= 0 && next < count;
    this.select(inside ? [next] : []);
    return inside ? next : -1;
  }
}
