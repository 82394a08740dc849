// Gestures that edit points: dragging, selecting with a box, placing, and the handles that rotate and scale.
// A gesture is {move(xy, event), up(), cancel(), loupe}: from a press to its release. xy: landmark coordinates of the
// pointer; event: {at: its place on the screen, shiftKey}; loupe: what is shown enlarged, or null.

import { ARROWS, bounds, centroid, cornersOf, distance, inBox, middleOf, move, nearest, turn } from "./points.js";

// By the type of the pointer, in css pixels.
const REACH = { mouse: 9, pen: 14, touch: 24 }; // around a point, in which a press hits it
const REACH_PLACING = { mouse: 5, pen: 7, touch: 11 }; // smaller while placing, so that points can be close together
const HANDLE_REACH = { mouse: 11, pen: 15, touch: 24 };
const SLIP = { mouse: 1, pen: 2, touch: 5 }; // maximum movement of a click on a point, which does not move it

export const CURSORS = { scale: "nwse-resize", turn: "grab", move: "move" }; // by kind of a handle
const EDGE = 4; // css pixels outside a frame that still belong to it
const FRAME = 16; // css pixels between the points and their frame
const KNOB = 26; // css pixels from the frame to the knobs
const LOUPE_AFTER_KEY = 1200; // milliseconds that the loupe stays
const CLICK = 4; // maximum movement of a click on an empty place, css pixels
const ANGLE_STEP = Math.PI / 36; // of a rotation with Shift: 5 degrees
const SMALLEST = 0.02; // factor of one gesture that scales, so that points do not fall together
export const NOTHING = { loupe: null, move() {}, up() {}, cancel() {} };

const NONE = new Set();

/** What gestures edit: the marks of a picture, what is being drawn over it, or a template. It has `points` and a
 *  `history`, and adding(xy, at) -> gesture | null, for a press on an empty place, which is `at` on the screen. */
export class Editable {
  #selection = new Set();
  #active = -1;
  #shown = null;
  #began = null; // the context when the gesture in progress began

  /** handlers: what to call when points are selected, during a gesture, and when the state has changed. */
  constructor(handlers = {}) { Object.assign(this, handlers); }
  onselect() {}
  onpreview() {}
  onchange() {}

  /** Indices of the selected points. */
  get selection() { return this.#selection; }
  /** The one that was selected last; -1 for none. */
  get active() { return this.#active; }
  get invisible() { return NONE; }
  /** Points during a gesture; null without. */
  get shown() { return this.#shown; }
  get editable() { return true; }

  /** What the next click depends on besides the state: undo and redo restore it, too. */
  get context() { return { selection: [...this.selection], active: this.active }; }
  /** The context before a step: a press that selects the point which it moves belongs to the step. */
  get contextBefore() { return this.#began ?? this.context; }
  /** A gesture begins, before it selects a point; and it has ended. */
  beginGesture() { this.#began = this.context; }
  endGesture() { this.#began = null; }

  /** Indices of the points with a frame and handles. */
  framed() { return []; }
  /** Whether a press on a point has another meaning than dragging. */
  press(_index, _event) { return false; }
  /** A point was clicked, and not dragged. */
  click(_index) {}
  /** Also move the mirrored points (twins). */
  follow(_before, after, _indices) { return after; }
  /** End of a gesture: one undo step. */
  commit(_points, _what, _key = null) {}
  changed() { this.onchange(); }

  select(indices, active = indices.at(-1) ?? -1) {
    this.restore({ selection: indices, active });
    this.onselect();
  }

  /** Select what a context says, without telling. @param {{selection?: Iterable<number>, active?: number}} context */
  restore({ selection = [], active = -1 } = {}) {
    this.#selection = new Set(selection);
    this.#active = active;
  }

  /** Show points during a gesture; null: restore them. */
  preview(points) {
    this.setShown(points);
    this.onpreview();
  }

  /** The same without telling. */
  setShown(points) { this.#shown = points; }

  /** Undo or redo a step, "undo" or "redo"; return its description, or null if there is none. @this {any} */
  travel(way) {
    const { history } = this;
    const what = way === "undo" ? history?.undoes : history?.redoes;
    const beyond = history?.beyond(way);
    const isDone = history?.[way](this.context);
    if (!isDone) return null;
    this.setShown(null);
    this.restore(history.context ?? {}); // that to which the step has led
    this.changed();
    this.onselect();
    beyond?.[way]();
    return what;
  }
}

/** The frame of `indices` in css pixels: its box, and handles {kind, at, fixed} (fixed: the corner that stays). */
export function frameOf(viewer, points, indices) {
  const box = indices.length > 1 ? bounds(points, indices) : null;
  if (box === null) return null;
  const [xOfOne, top] = viewer.toScreen([box[0], box[1]]);
  const [xOfOther, bottom] = viewer.toScreen([box[2], box[3]]);
  const x0 = Math.min(xOfOne, xOfOther) - FRAME; // the view may be mirrored
  const x1 = Math.max(xOfOne, xOfOther) + FRAME;
  const y0 = top - FRAME;
  const y1 = bottom + FRAME;
  const middle = (x0 + x1) / 2;
  const corners = cornersOf([x0, y0, x1, y1]);
  const oppositeOf = (i) => corners[(i + 2) % 4];
  return {
    box: [x0, y0, x1, y1],
    handles: [
      ...corners.map((at, i) => ({ kind: "scale", at, fixed: oppositeOf(i) })),
      { kind: "turn", at: [middle, y0 - KNOB] },
      { kind: "move", at: [middle, y1 + KNOB] },
    ],
  };
}

export const handleReach = ({ pointerType }) => HANDLE_REACH[pointerType] ?? HANDLE_REACH.mouse;

export function handleAt(viewer, doc, event) {
  const frame = frameOf(viewer, doc.points, doc.framed());
  const at = viewer.place(event);
  return frame?.handles.find((handle) => distance(handle.at, at) <= handleReach(event)) ?? null;
}

/** Whether an event is in the frame or at its edge, where a press places no point. */
function isInFrame(viewer, doc, event) {
  const frame = doc.placing ? null : frameOf(viewer, doc.points, doc.framed());
  if (!frame) return false;
  const [x, y] = viewer.place(event);
  const [x0, y0, x1, y1] = frame.box;
  return x > x0 - EDGE && x < x1 + EDGE && y > y0 - EDGE && y < y1 + EDGE;
}

/** A gesture that places a point: show(xy) at first and with each move. */
export function placing(xy, show, up, cancel) {
  show(xy);
  return {
    loupe: xy,
    move(at) {
      this.loupe = at;
      show(at);
    },
    up,
    cancel,
  };
}

/** A gesture that moves points.
 *  index: the point under the pointer, or -1; indices: the points that move; start: where the pointer was pressed.
 *  isFar(place on the screen): whether the pointer has moved further than in a click; onclick(): it never did. */
export function dragging(doc, index, indices, start, isFar = (_at) => true, onclick = () => {}) {
  const before = doc.points;
  let dx = 0;
  let dy = 0;
  let isDrag = false;
  const moved = () => doc.follow(before, move(before, indices, dx, dy), indices);
  return {
    loupe: index < 0 ? null : before[index],
    move(xy, event) {
      isDrag ||= isFar(event.at); // and stays one if the pointer comes back
      if (!isDrag) return; // a click must not move a point
      dx = xy[0] - start[0];
      dy = xy[1] - start[1];
      const points = moved();
      this.loupe = index < 0 ? null : points[index];
      doc.preview(points);
    },
    up() {
      if (dx || dy) doc.commit(moved(), "move");
      else doc.preview(null);
      if (!isDrag) onclick();
    },
    cancel: () => doc.preview(null),
  };
}

/** A gesture of a handle that scales the points about the opposite corner, or rotates them about their middle. */
export function turning(viewer, doc, handle, indices) {
  const before = doc.points;
  const scales = handle.kind === "scale";
  const fixed = scales ? viewer.toImage(handle.fixed) : middleOf(bounds(before, indices));
  const start = viewer.toImage(handle.at);
  const angleOf = ([x, y]) => Math.atan2(y - fixed[1], x - fixed[0]);
  let points = before;

  const factorAt = (xy) => Math.max(distance(xy, fixed) / Math.max(distance(start, fixed), 1e-9), SMALLEST);
  const angleAt = (xy, inSteps) => {
    const angle = angleOf(xy) - angleOf(start);
    return inSteps ? Math.round(angle / ANGLE_STEP) * ANGLE_STEP : angle;
  };
  return {
    loupe: null,
    move(xy, event) { // turn() rotates by an angle and scales by a factor
      if (scales) points = turn(before, indices, fixed, 0, factorAt(xy));
      else points = turn(before, indices, fixed, angleAt(xy, event.shiftKey));
      doc.preview(points);
    },
    up() {
      if (points === before) doc.preview(null);
      else doc.commit(points, scales ? "scale" : "rotate");
    },
    cancel: () => doc.preview(null),
  };
}

/** A gesture that selects the points in a box; adds: in addition to those that were selected. */
function boxing(doc, start, adds) {
  const before = adds ? [...doc.selection] : [];
  return {
    loupe: null,
    box: [...start, ...start],
    move(xy) {
      this.box = [...start, ...xy];
      doc.select([...new Set([...before, ...inBox(doc.points, this.box)])]);
    },
    up: () => doc.select([...doc.selection]),
    cancel: () => doc.select(before),
  };
}

/** The viewer's tool that edits the document `current()`. */
export class PointTool {
  #viewer;
  #current;
  #onend;
  #gesture = null;
  #hovered = -1;
  #pointer = null;
  #boxes = false; // whether a drag on an empty place selects with a box
  #magnifies = true; // whether the loupe shows where a click would place a point
  #pressed = null; // position on the page of a press that started no gesture
  #doc = null; // what the gesture in progress edits
  #loupeTimer = null;

  /** onend(): after every gesture.
   *  @param {any} viewer; @param {() => any} current; @param {{onend?: () => void}} options */
  constructor(viewer, current, { onend = () => {} } = {}) {
    this.#viewer = viewer;
    this.#current = current;
    this.#onend = onend;
    viewer.canvas.addEventListener("pointerup", (event) => this.#deselectByClick(event));
    viewer.canvas.addEventListener("blur", () => this.leave());
  }

  /** The gesture in progress, or null. */
  get gesture() { return this.#gesture; }
  /** Index of the point under the pointer, or -1. */
  get hovered() { return this.#hovered; }
  /** {at: css pixels, xy, type} of the last pointer that hovered, or of a point moved by keys; null without. */
  get pointer() { return this.#pointer; }

  /** Let a drag on an empty place select with a box, or no longer; return which. */
  toggleBoxes() { return (this.#boxes = !this.#boxes); }

  /** Show where a click would place a point under a loupe, or no longer. */
  toggleLoupe() { this.#magnifies = !this.#magnifies; }

  /** Index of the point that an event hits; -1 for none. */
  find(event, xy) {
    const doc = this.#current();
    const reach = (doc.placing ? REACH_PLACING : REACH)[event.pointerType] ?? REACH.mouse;
    return nearest(doc.points, xy, reach / this.#viewer.scale, doc.selection);
  }

  down(event, xy) {
    this.#pressed = null;
    if (event.button > 0) return false;
    const doc = this.#current();
    doc.beginGesture(); // before the press selects a point
    this.#gesture = this.#begin(doc, event, xy);
    this.#notePointer(event, xy);
    this.#viewer.redraw();
    if (this.#gesture === null) {
      doc.endGesture();
      this.#pressed = [event.clientX, event.clientY];
      return false;
    }
    this.#doc = doc;
    return true;
  }

  /** The gesture that a press begins; null for none. */
  #begin(doc, event, xy) {
    if (!doc.editable) return null;
    const adds = event.shiftKey || event.ctrlKey || event.metaKey;
    const index = this.find(event, xy);
    if (index >= 0) {
      if (doc.press(index, event)) return { ...NOTHING };
      return this.#grab(doc, index, adds, xy, SLIP[event.pointerType] ?? SLIP.mouse);
    }
    const handle = handleAt(this.#viewer, doc, event);
    if (handle?.kind === "move") return dragging(doc, -1, doc.framed(), xy);
    if (handle) return turning(this.#viewer, doc, handle, doc.framed());
    if (adds || this.#boxes) return boxing(doc, xy, adds);
    if (isInFrame(this.#viewer, doc, event)) return this.#dragFrame(doc, event, xy);
    return doc.adding(xy, this.#viewer.place(event));
  }

  /** A drag in the frame, or at its edge, moves all that it is around; a click there selects nothing. */
  #dragFrame(doc, event, xy) {
    const at = this.#viewer.place(event);
    return dragging(doc, -1, doc.framed(), xy, (to) => distance(to, at) > CLICK, () => doc.select([], -1));
  }

  /** A press on a point selects it, or adds it to the selection or takes it out; then the selected points are dragged. */
  #grab(doc, index, adds, xy, slip) {
    const isSelected = doc.selection.has(index);
    if (adds && isSelected) {
      doc.select([...doc.selection].filter((each) => each !== index), -1);
      return { ...NOTHING };
    }
    if (adds) doc.select([...doc.selection, index], index);
    else doc.select(isSelected ? [...doc.selection] : [index], index);

    const at = this.#viewer.toScreen(xy);
    const isFar = (to) => distance(to, at) > slip;
    const onclick = () => {
      if (!adds) doc.click(index);
      if (!adds && doc.selection.size > 1) doc.select([index], index); // a click on one of several
    };
    return dragging(doc, index, [...doc.selection], xy, isFar, onclick);
  }

  move(event, xy) {
    if (!this.#gesture) return;
    this.#notePointer(event, xy);
    this.#gesture.move(xy, { shiftKey: event.shiftKey, at: this.#viewer.place(event) });
    this.#viewer.redraw();
  }

  up(event, xy) {
    if (!this.#gesture) return;
    this.#notePointer(event, xy);
    const gesture = this.#gesture;
    this.#gesture = null; // what it does below may begin another
    gesture.up();
    this.#forgetDocument();
    this.#onend();
    this.#viewer.redraw();
  }

  cancel() {
    this.#gesture?.cancel();
    this.#forgetDocument();
    this.#gesture = null;
    this.#pressed = null;
    this.#viewer.redraw();
  }

  /** The gesture has ended. */
  #forgetDocument() {
    this.#doc?.endGesture();
    this.#doc = null;
  }

  #deselectByClick(event) {
    const pressed = this.#pressed;
    this.#pressed = null;
    if (pressed && distance(pressed, [event.clientX, event.clientY]) <= CLICK) this.#current().select([], -1);
  }

  hover(event, xy) {
    this.#notePointer(event, xy);
    const doc = this.#current();
    const index = this.find(event, xy);
    const isDrawnAnew = index !== this.#hovered || doc.placing || doc.followsPointer;
    this.#hovered = index;
    if (isDrawnAnew) this.#viewer.redraw();
  }

  #notePointer(event, xy) { this.#pointer = { at: this.#viewer.place(event), xy, type: event.pointerType }; }

  /** What the loupe shows: the point of a gesture or of keys, or the place for a click; null without a loupe. */
  get loupe() {
    const [pointer, gesture] = [this.#pointer, this.#gesture];
    if (!pointer) return null;
    if (gesture) return gesture.loupe;
    if (pointer.type === "keys") return pointer.xy;
    const wouldPlace = this.#current().placing && this.#hovered < 0;
    return this.#magnifies && wouldPlace ? pointer.xy : null;
  }

  /** Show the loupe over a point that was moved by keys, for a moment. */
  nudged(xy) {
    this.#pointer = { at: this.#viewer.toScreen(xy), xy, type: "keys" };
    clearTimeout(this.#loupeTimer);
    this.#loupeTimer = setTimeout(() => {
      if (this.#pointer?.type === "keys") this.leave();
    }, LOUPE_AFTER_KEY);
  }

  leave() {
    this.#pointer = null;
    this.#hovered = -1;
    this.#viewer.redraw();
  }

  cursor(event, xy) {
    const doc = this.#current();
    if (!doc.editable) return "";
    if (this.find(event, xy) >= 0) return "move";
    const handle = handleAt(this.#viewer, doc, event);
    if (handle) return CURSORS[handle.kind];
    if (!this.#boxes && !event.shiftKey && isInFrame(this.#viewer, doc, event)) return CURSORS.move;
    return doc.placing || this.#boxes || event.shiftKey ? "crosshair" : "";
  }
}

const KEY_ANGLE = Math.PI / 180; // one degree
const KEY_FACTOR = 1.01; // of the size
const KEYS_WITH_SHIFT = 5; // times as much
const KEY_STEP = 1; // pixels of the picture
const FINE_KEY_STEP = 0.1; // with Alt
const COARSE_KEY_STEP = 10; // with Shift

/** Edit points with a key: {points, what, key} or null; edits in a row with the same `key` are one step of undo.
 *  An arrow moves the `chosen` points; with Ctrl it rotates (left, right) or scales (up, down) the points `indices`. */
export function keyEdit(event, points, indices, chosen, mirrored = false) {
  const arrow = ARROWS[event.key];
  if (arrow === undefined) return null;
  const across = mirrored ? -arrow[0] : arrow[0];
  const down = arrow[1];
  if (event.ctrlKey || event.metaKey) return turnedByKey(points, indices, across, down, event.shiftKey);
  if (chosen.length === 0) return null;
  let step = KEY_STEP;
  if (event.altKey) step = FINE_KEY_STEP;
  else if (event.shiftKey) step = COARSE_KEY_STEP;
  return { points: move(points, chosen, step * across, step * down), what: "move", key: `move ${chosen.join()}` };
}

function turnedByKey(points, indices, across, down, withShift) {
  const centre = centroid(points, indices);
  if (centre === null) return null;
  const times = withShift ? KEYS_WITH_SHIFT : 1;
  const key = `turn ${indices.join()}`;
  if (across) return { points: turn(points, indices, centre, across * KEY_ANGLE * times, 1), what: "rotate", key };
  const factor = KEY_FACTOR ** (-down * times); // y is downwards, and an arrow up enlarges
  return { points: turn(points, indices, centre, 0, factor), what: "scale", key };
}
