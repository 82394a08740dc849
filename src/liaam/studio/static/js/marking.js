// The marks of the picture that is open, while they are edited: what is chosen, what is shown, what is undone. This is
// the document that gestures edit (see gestures.js), and knows nothing of the page.
//
// A *state* {points, invisible, source} is a value and what undo goes through; source "file" is the person's own,
// "proposal" the model's and "layout" the mean of what is done, both not saved until taken over. A *book* {history,
// covariances, doubtful, ...} is what this page knows of one picture.

import {
  expected,
  flip,
  flipIndices,
  missing,
  nextMissing,
  place,
  placed,
  remove,
  samePoints,
  toggle,
  withTwins,
} from "./points.js";

export class Marking {
  /** template() -> that of the project, or null; onchange(): the shown state is another; onselect(): others are chosen;
   *  onpreview(): a gesture shows points elsewhere; onplaced(index): a click placed a point that was missing. */
  constructor({ template, onchange = () => {}, onselect = () => {}, onpreview = () => {}, onplaced = () => {} }) {
    Object.assign(this, { templateOf: template, onchange, onselect, onpreview, onplaced });
    this.book = null;
    this.selection = new Set();
    this.active = -1;
    this.invisible = new Set();
    this.shown = null; // points during a gesture
    this.hidden = false; // all marks, for a moment
    this.mirrored = false; // whether twins move along
    this.followsPointer = false;
  }

  // What there is ---------------------------------------------------------------------------------------------------

  get template() {
    return this.templateOf();
  }
  get names() {
    return this.template?.names ?? [];
  }
  get history() {
    return this.book?.history ?? null;
  }
  get state() {
    return this.history?.state ?? null;
  }
  get points() {
    return this.shown ?? this.state?.points ?? [];
  }
  get editable() {
    return this.book !== null && !this.hidden;
  }
  /** Whether the points came from the model or from other pictures. */
  get suggested() {
    return this.state !== null && (this.state.source === "proposal" || this.state.source === "layout");
  }
  /** Whether a click places the chosen point. */
  get placing() {
    return this.book !== null && this.active >= 0 && this.active < this.points.length && !this.points[this.active];
  }
  get chosen() {
    return [...this.selection].sort((a, b) => a - b);
  }
  get chosenPlaced() {
    return this.chosen.filter((i) => this.points[i]);
  }
  get missing() {
    return missing(this.points);
  }

  /** The points that have handles around them. */
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

  // Changes ---------------------------------------------------------------------------------------------------------

  open(book) {
    this.book = book;
    this.invisible = new Set(this.state?.invisible);
  }

  select(indices, active = indices.at(-1) ?? -1) {
    this.selection = new Set(indices);
    this.active = active;
    this.onselect();
  }

  preview(points) {
    this.shown = points;
    this.onpreview();
  }

  revert() {
    this.preview(null);
  }

  /** One step: the points are others. */
  commit(points, what, key = null) {
    this.change({ points }, what, key);
  }

  /** One step: what changes of the marks. Whatever was suggested is the person's from now on. */
  change(change, what, key = null) {
    const before = this.state;
    const { points, invisible } = { ...before, ...change };
    this.shown = null;
    const state = { points, invisible: invisible.filter((i) => points[i]), source: "file" };
    const same = samePoints(points, before.points) && state.invisible.join() === before.invisible.join();
    if (before.source === "file" && same) return;
    this.history.push(state, what, key);
    this.changed();
  }

  /** Take a step back ("undo") or forth ("redo"); gives what that step did, or null where there is none. */
  travel(way) {
    const what = way === "undo" ? this.history?.undoes : this.history?.redoes;
    if (!this.history?.[way]()) return null;
    this.shown = null;
    this.changed();
    return what;
  }

  changed() {
    this.invisible = new Set(this.state.invisible);
    this.onchange();
  }

  // Gestures --------------------------------------------------------------------------------------------------------

  follow(before, after, indices) {
    return this.mirrored ? withTwins(before, after, indices, this.template.mirror) : after;
  }

  press() {
    return false;
  }

  adding(xy) {
    if (!this.placing) return null;
    const marking = this;
    const before = this.points;
    const index = this.active;
    let points = place(before, index, xy);
    this.preview(points);
    return {
      loupe: xy,
      move: function (at) {
        points = place(before, index, at);
        this.loupe = at;
      },
      up: () => {
        marking.commit(points, `place ${marking.names[index]}`);
        marking.onplaced(index);
      },
      cancel: () => marking.revert(),
    };
  }

  // Edits -----------------------------------------------------------------------------------------------------------

  /** Take over what was suggested. */
  accept() {
    if (this.suggested) this.commit(this.points, "accept");
  }

  flip() {
    const { mirror } = this.template;
    this.change({ points: flip(this.points, mirror), invisible: flipIndices(this.state.invisible, mirror) }, "flip");
  }

  /** Make the chosen points invisible, or visible; gives which they are now. */
  toggleInvisible() {
    const chosen = this.chosenPlaced;
    const invisible = toggle(this.state.invisible, chosen);
    this.change({ invisible }, "visibility");
    return invisible.includes(chosen[0]);
  }

  /** Take the chosen points' places away. */
  removeChosen() {
    const chosen = this.chosenPlaced;
    this.commit(remove(this.points, chosen), "take away");
    this.select(chosen, chosen[0]);
  }

  /** Place the point that is chosen, or else the next that is missing, where the others suggest, or in the middle of
   *  the picture; gives which it was, -1 where all are placed. */
  placeChosen({ width, height }) {
    const index = this.placing ? this.active : nextMissing(this.points, this.active);
    if (index < 0) return index;
    const guess = this.template.points ? expected(this.template.points, this.points)[index] : null;
    const inside = guess && guess[0] >= 0 && guess[1] >= 0 && guess[0] < width && guess[1] < height;
    this.commit(place(this.points, index, inside ? guess : [width / 2, height / 2]), `place ${this.names[index]}`);
    this.select([index]);
    return index;
  }

  /** Choose the next point, or the one before; gives it, or -1 past the last, where none is chosen then. */
  step(by) {
    const count = this.points.length;
    const next = this.active < 0 ? (by > 0 ? 0 : count - 1) : this.active + by;
    const inside = next >= 0 && next < count;
    this.select(inside ? [next] : []);
    return inside ? next : -1;
  }
}
