// The marks of the open picture while they are edited: selection, display and undo history, independent of the page.
//
// A *state* {points, invisible, source, bar} is an immutable value in the undo history. Source "file" is placed by the user,
// "proposal" by the model, and "layout" is the mean of the done pictures. The last two are saved only when accepted or
// moved. `bar` is the scale bar, or null. A *book* {history, covariances, doubtful, ...} holds everything about one picture.

import { Editable, placing } from "./gestures.js";
import {
  expected, flip, flipIndices, missing, nextMissing, place, placed, remove, sameBar, samePoint, samePoints, toggle,
  withTwins,
} from "./points.js";

export class Marking extends Editable {
  book = null;
  hidden = false; // whether all marks are hidden for a moment
  mirrored = false; // whether mirrored points (twins) move together

  /** template() -> template of the project, or null; handlers: those of Editable, and onplaced(index): a click placed a
   *  missing point. */
  constructor({ template, ...handlers }) {
    super(handlers);
    this.templateOf = template;
  }

  onplaced(_index) {}
  get template() { return this.templateOf(); }
  get names() { return this.template?.names ?? []; }
  get history() { return this.book?.history ?? null; }
  get state() { return this.history?.state ?? null; }
  get points() { return this.shown ?? this.state?.points ?? []; }
  get editable() { return this.book !== null && !this.hidden; }
  /** Whether the points are from the model or from other pictures, and not accepted yet. */
  get suggested() {
    return this.state !== null && (this.state.source === "proposal" || this.state.source === "layout");
  }
  get placing() {
    return this.book !== null && this.active >= 0 && this.active < this.points.length && !this.points[this.active];
  }
  get chosen() { return [...this.selection].sort((a, b) => a - b); }
  get chosenPlaced() { return this.chosen.filter((i) => this.points[i]); }
  get missing() { return missing(this.points); }

  framed() {
    if (this.selection.size > 1) return [...this.selection].filter((i) => this.points[i]);
    return this.state?.source === "layout" ? placed(this.points) : [];
  }

  /** "missing", "invisible", "proposed" or "placed". */
  stateOf(index) {
    if (!this.points[index]) return "missing";
    if (this.invisible.has(index)) return "invisible";
    return this.suggested ? "proposed" : "placed";
  }

  open(book) {
    this.book = book;
    this.invisible = new Set(this.state?.invisible);
  }

  commit(points, what, key = null) { this.change({ points }, what, key); }

  /** One undo step. It accepts a proposal, unless it changes the scale bar, and the mean shape if a point moves. */
  change(change, what, key = null, accepts = false) {
    const before = this.state;
    const { points, invisible, bar = null } = { ...before, ...change };
    this.shown = null;
    const still = points.every((point, i) => !point || samePoint(point, before.points[i]));
    const stays = "bar" in change || (before.source === "layout" && still && !accepts);
    const source = stays ? before.source : "file";
    const state = { points, invisible: invisible.filter((i) => points[i]), source, bar };
    const same = samePoints(points, before.points) && state.invisible.join() === before.invisible.join() &&
      sameBar(before.bar, bar);
    if (before.source === source && same) return;
    this.history.push(state, what, key);
    this.changed();
  }

  changed() {
    this.invisible = new Set(this.state.invisible);
    this.onchange();
  }

  follow(before, after, indices) {
    return this.mirrored ? withTwins(before, after, indices, this.template.mirror) : after;
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

  accept() {
    if (this.suggested) this.change({}, "accept", null, true);
  }

  flip() {
    const { mirror } = this.template;
    this.change({ points: flip(this.points, mirror), invisible: flipIndices(this.state.invisible, mirror) }, "flip");
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
    const index = this.placing ? this.active : nextMissing(this.points, this.active);
    if (index < 0) return index;
    const guess = this.template.points ? expected(this.template.points, this.points)[index] : null;
    const inside = guess && guess[0] >= 0 && guess[1] >= 0 && guess[0] < width && guess[1] < height;
    this.commit(place(this.points, index, inside ? guess : [width / 2, height / 2]), `place ${this.names[index]}`);
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
