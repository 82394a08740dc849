// A template while it is edited over a picture: its draft, selection, undo history, and the effect of clicks.

import { called, several } from "./annotate-words.js";
import { gripOf } from "./drawing.js";
import { Editable, NOTHING } from "./gestures.js";
import { History } from "./history.js";
import { distance, flip, indicesOf, place, samePoint, withTwins } from "./points.js";
import * as drafts from "./template.js";

const AXIS_REACH = 8; // css pixels; a new point closer to the axis is placed on it
const GRIP_REACH = 20; // css pixels

export class Drafting extends Editable {
  #viewer;
  /** @type {Template | null} */
  #saved = null;
  #isFresh = true;
  #axis = null;
  #history;

  /** handlers: those of Editable, and say(text): announce to screen readers. */
  constructor({ viewer, ...handlers }) {
    super({ onpreview: () => viewer.redraw(), ...handlers });
    this.#viewer = viewer;
    this.start(null, null, drafts.EMPTY);
  }

  /** Edit `template` with its points at `points` on the picture, or `draft` of a new template if it is null. */
  start(template, points, draft = null) {
    this.#saved = template;
    this.#isFresh = template === null;
    this.#axis = null;
    this.setShown(null);
    this.restore();
    const kinds = draft?.kinds ?? draft?.names.map(() => "landmark"); // drafts of earlier versions have none
    this.#history = new History(template ? drafts.draftOf(template, points) : { ...draft, kinds });
  }

  rebase(/** @type {Template} */ template) {
    const draft = drafts.rebased(this.draft, this.saved, template);
    this.#saved = template;
    this.#history = new History(drafts.draftOf(template));
    this.setShown(null);
    this.apply(draft, "earlier changes");
  }

  say(_text) {}
  get history() { return this.#history; }
  /** The edited template, or null for a new one. */
  get saved() { return this.#saved; }
  /** Whether there was no template at the start. */
  get isFresh() { return this.#isFresh; }
  /** x of the mirror line while mirroring, or null. */
  get axis() { return this.#axis; }
  get draft() { return this.history.state; }

  /** {file, points} of a loaded template whose layout as a whole is being placed; otherwise null. It is a part of the
   *  draft, so that it is undone and stored with it. */
  get layout() { return (this.started && this.draft.layout) || null; }
  get layingOut() { return this.layout !== null; }
  get isUnmoved() {
    return this.layingOut && this.draft.points.every((p) => this.layout.points.some((q) => samePoint(p, q)));
  }

  get names() { return this.draft.names; }
  get points() { return this.shown ?? this.draft.points; }
  get placing() { return !this.layingOut; }
  get followsPointer() { return this.axis !== null; }
  get started() { return this.names.length > 0; }

  framed() {
    if (this.selection.size > 1) return [...this.selection];
    return this.layingOut ? indicesOf(this.draft.points) : [];
  }

  apply(next, what, key = null) {
    this.history.push(next, what, key, this.contextBefore);
    this.changed();
  }

  changed() {
    const isThere = (i) => i < this.names.length;
    this.restore({ selection: [...this.selection].filter(isThere), active: isThere(this.active) ? this.active : -1 });
    this.onchange();
  }

  commit(points, what, key = null) {
    this.setShown(null);
    this.apply({ ...this.draft, points }, what, key);
  }

  follow(before, after, indices) {
    return this.axis === null ? after : withTwins(before, after, indices, this.draft.mirror);
  }

  adding(xy) {
    const [viewer, axis] = [this.#viewer, this.#axis];
    if (axis !== null && distance(gripOf(viewer, axis), viewer.toScreen(xy)) <= GRIP_REACH) return this.draggingAxis();
    if (this.layingOut) return null;
    const unplaced = this.draft.points.findIndex((point) => !point);
    const index = unplaced >= 0 ? unplaced : this.names.length;
    const add = (at) =>
      unplaced >= 0 ? { ...this.draft, points: place(this.draft.points, unplaced, at) } : this.withPoint(at);
    // The ghost shows the new point and its line; the point is added when the pointer goes up.
    const gesture = {
      loupe: xy, ghost: add(xy),
      move: (at) => { Object.assign(gesture, { loupe: at, ghost: add(at) }); },
      up: () => {
        this.select([index]);
        this.apply(gesture.ghost, "add a point");
        this.say(`${this.names[index]} added`);
      },
      cancel() {},
    };
    return gesture;
  }

  withPoint(at) {
    return drafts.addPoint(this.draft, at, { axis: this.axis, tolerance: AXIS_REACH / this.#viewer.scale });
  }

  draggingAxis() {
    const before = this.axis;
    const move = ([x]) => { this.#axis = Math.round(x * 10) / 10; };
    return { ...NOTHING, move, cancel: () => { this.#axis = before; } };
  }

  /** Handle a press on a point: with Shift, connect the curve to it; on the curve's first point, close the curve. */
  press(index, event) {
    if (this.layingOut) return false;
    const path = this.draft.contours[this.draft.path]?.indices;
    if (event.shiftKey) this.apply(drafts.connect(this.draft, index), "connect");
    else if (path?.length > 2 && path[0] === index) this.close();
    else return false;
    return true;
  }

  /** While a curve is drawn, a click on another point leads it there. */
  click(index) {
    if (this.draft.path >= 0) this.apply(drafts.connect(this.draft, index), "connect");
  }

  close() { this.endPath(true, "close the curve", "Curve closed"); }

  /** Begin to draw a curve, or end the one that is being drawn. */
  togglePath() {
    if (this.draft.path >= 0) return this.endPath();
    if (this.layingOut) return undefined;
    this.apply(drafts.startPath(this.draft), "draw a curve");
    return this.say("The next points are on a curve");
  }

  endPath(closed = false, what = "end the curve", said = "The next point is a landmark by itself") {
    if (this.draft.path < 0) return;
    this.apply(drafts.newPath(this.draft, closed), what);
    this.say(said);
  }

  changeKind(index) {
    this.apply(drafts.changeKind(this.draft, index), "change the kind");
    this.say(`${this.names[index]} is a ${this.draft.kinds[index]}`);
  }

  /** Take semilandmarks and curves from the text of a sliders file; return whether it is one for these points. */
  loadSliders(text) {
    const next = drafts.withSliders(this.draft, text);
    if (next) this.apply(next, "load sliders");
    return next !== null;
  }

  flip() { this.apply({ ...this.draft, points: flip(this.draft.points, this.draft.mirror) }, "flip"); }

  addInTheMiddle() {
    if (this.layingOut) return;
    const { clientWidth, clientHeight } = this.#viewer.container;
    const index = this.names.length;
    this.apply(this.withPoint(this.#viewer.toImage([clientWidth / 2, clientHeight / 2])), "add a point");
    this.select([index], index);
    this.say(`${this.names[index]} added in the middle. Arrow keys move it`);
  }

  deleteChosen(indices = [...this.selection]) {
    if (indices.length === 0) return;
    const what = called(this.names, indices);
    this.select([]);
    this.apply(drafts.deletePoints(this.draft, indices), "delete");
    this.say(`${what} deleted`);
  }

  shift(from, to) {
    if (to < 0 || to >= this.names.length || from === to) return;
    this.apply(drafts.reorder(this.draft, from, to), "reorder");
    this.select([to], to);
    this.say(`${this.names[to]} is now number ${to + 1}`);
  }

  toggleMirror() {
    const on = this.axis === null;
    this.#axis = on ? drafts.axisOf(this.draft, this.#viewer.width) : null;
    this.say(on ? "Mirroring on: each new point is mirrored" : "Mirroring off");
    this.onchange();
    return on;
  }

  shiftAxis(event) {
    const by = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
    if (this.axis === null || !by) return false;
    this.#axis += by * (event.shiftKey ? 10 : 1);
    this.#viewer.redraw();
    return true;
  }

  /** kinds: of the points, if they are not those of the template. */
  load(file, template, points, kinds = template.kinds) {
    this.select([]);
    const draft = drafts.draftOf({ ...template, kinds }, points);
    this.apply({ ...draft, origins: template.names.map(() => null), layout: { file, points }, loaded: true }, "load");
    this.say(`${several(template.names.length, "point")} loaded. Move them into place`);
  }

  endLayout() {
    this.select([]);
    this.apply({ ...this.draft, layout: null }, "put in place");
  }
}
