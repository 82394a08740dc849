// Gestures that edit points: dragging, selecting with a box, placing, and the handles that rotate and scale.
// A gesture is {move(xy, event), up(), cancel(), loupe: xy | null}.

import { ARROWS, bounds, centroid, cornersOf, distance, inBox, middleOf, move, nearest, turn } from "./points.js";

const REACH = { mouse: 9, pen: 14, touch: 24 }; // css pixels around a point that hit it
const REACH_PLACING = { mouse: 5, pen: 7, touch: 11 }; // smaller while placing, so that points can be close together
const HANDLE_REACH = { mouse: 11, pen: 15, touch: 24 };
export const CURSORS = { scale: "nwse-resize", turn: "grab", move: "move" }; // by kind of a handle
const FRAME = 16; // css pixels between the points and their frame
const KNOB = 26; // css pixels from the frame to the knobs
const NUDGED = 1200; // milliseconds that the loupe stays after a key
const STILL = 4; // maximum movement of a click, css pixels
const SLIP = { mouse: 1, pen: 2, touch: 5 }; // maximum movement of a click that does not move a point, css pixels
export const NOTHING = { loupe: null, move() {}, up() {}, cancel() {} };

/** What gestures edit: the marks of a picture, what is being drawn over it, or a template. It has `points` and a
 *  `history`, and adding(xy) -> gesture | null, for a press on an empty place. */
export class Editable {
  selection = new Set(); // indices of points
  active = -1; // the one that was selected last
  invisible = new Set();
  shown = null; // points during a gesture
  began = null; // the context when the gesture in progress began

  /** handlers: what to call when points are selected, during a gesture, and when the state has changed. */
  constructor(handlers = {}) { Object.assign(this, handlers); }
  onselect() {}
  onpreview() {}
  onchange() {}

  get editable() { return true; }

  /** What the next click depends on besides the state: undo and redo restore it, too. */
  get context() { return { selection: [...this.selection], active: this.active }; }
  /** The context before a step: a press that selects the point which it moves belongs to the step. */
  get contextBefore() { return this.began ?? this.context; }

  /** Indices of the points with a frame and handles. */
  framed() { return []; }
  /** Whether a press on a point has another meaning than dragging. */
  press(_index, _event) { return false; }
  /** Also move the mirrored points (twins). */
  follow(_before, after, _indices) { return after; }
  /** End of a gesture: one undo step. */
  commit(_points, _what, _key = null) {}
  changed() { this.onchange(); }

  select(indices, active = indices.at(-1) ?? -1) {
    Object.assign(this, { selection: new Set(indices), active });
    this.onselect();
  }

  /** Show points during a gesture; null: restore them. */
  preview(points) {
    this.shown = points;
    this.onpreview();
  }

  /** Undo or redo a step; return its description, or null if there is none. @this {any} */
  travel(way) {
    const what = way === "undo" ? this.history?.undoes : this.history?.redoes;
    if (!this.history?.[way](this.context)) return null;
    const { selection = [], active = -1 } = this.history.context ?? {};
    Object.assign(this, { shown: null, selection: new Set(selection), active });
    this.changed();
    this.onselect();
    return what;
  }
}

/** The frame of `indices` in css pixels: its box, and handles {kind, at, fixed} (fixed: the corner that stays). */
export function frameOf(viewer, points, indices) {
  const box = indices.length > 1 ? bounds(points, indices) : null;
  if (box === null) return null;
  const [one, other] = [viewer.toScreen([box[0], box[1]]), viewer.toScreen([box[2], box[3]])];
  const [x0, y0] = [Math.min(one[0], other[0]) - FRAME, one[1] - FRAME]; // the view may be mirrored
  const [x1, y1] = [Math.max(one[0], other[0]) + FRAME, other[1] + FRAME];
  const middle = (x0 + x1) / 2;
  const corners = cornersOf([x0, y0, x1, y1]);
  return {
    box: [x0, y0, x1, y1],
    handles: [
      ...corners.map((at, i) => ({ kind: "scale", at, fixed: corners[(i + 2) % 4] })),
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

/** A gesture that places a point: show(xy) at first and with each move. */
export function placing(xy, show, up, cancel) {
  show(xy);
  const gesture = { loupe: xy, move: (at) => { show(gesture.loupe = at); }, up, cancel };
  return gesture;
}

/** A gesture that moves points; index: the point under the pointer, or -1. isFar(place on the screen): whether it is
 *  more than a click; still(): it was only a click. */
export function dragging(doc, index, indices, start, isFar = (_at) => true, still = () => {}) {
  const before = doc.points;
  let [dx, dy] = [0, 0];
  let far = false;
  const after = () => doc.follow(before, move(before, indices, dx, dy), indices);
  return {
    loupe: index < 0 ? null : before[index],
    move(xy, event) {
      far ||= isFar(event.at);
      if (!far) return; // a click must not move a point
      [dx, dy] = [xy[0] - start[0], xy[1] - start[1]];
      const points = after();
      this.loupe = index < 0 ? null : points[index];
      doc.preview(points);
    },
    up() {
      if (dx || dy) doc.commit(after(), "move");
      else doc.preview(null);
      if (!far) still();
    },
    cancel: () => doc.preview(null),
  };
}

export function turning(viewer, doc, handle, indices) {
  const before = doc.points;
  const fixed = handle.kind === "scale" ? viewer.toImage(handle.fixed) : middleOf(bounds(before, indices));
  const start = viewer.toImage(handle.at);
  let points = before;
  return {
    loupe: null,
    move(xy, event) {
      if (handle.kind === "scale") {
        const factor = Math.max(distance(xy, fixed) / Math.max(distance(start, fixed), 1e-9), 0.02);
        points = turn(before, indices, fixed, 0, factor);
      } else {
        const [from, to] = [start, xy].map(([x, y]) => Math.atan2(y - fixed[1], x - fixed[0]));
        const step = event.shiftKey ? Math.PI / 36 : 0;
        points = turn(before, indices, fixed, step ? Math.round((to - from) / step) * step : to - from);
      }
      doc.preview(points);
    },
    up() {
      if (points === before) doc.preview(null);
      else doc.commit(points, handle.kind === "scale" ? "scale" : "rotate");
    },
    cancel: () => doc.preview(null),
  };
}

function boxing(doc, start, adds) {
  const kept = adds ? [...doc.selection] : [];
  return {
    loupe: null, box: [...start, ...start],
    move(xy) {
      this.box = [...start, ...xy];
      doc.select([...new Set([...kept, ...inBox(doc.points, this.box)])]);
    },
    up: () => doc.select([...doc.selection]), cancel: () => doc.select(kept),
  };
}

/** The viewer's tool that edits the document `current()`.
 *  options.boxes() -> whether a drag on an empty place selects with a box; options.onend(): after every gesture. */
export class PointTool {
  gesture = null;
  hovered = -1;
  pointer = null; // {at: css pixels, xy, type} of the last pointer that hovered, or of a point moved by keys
  magnifies = true; // whether the loupe shows where a click would place a point
  pressed = null; // position of a press that started no gesture
  doc = null; // what the gesture in progress edits

  /** @param {any} viewer; @param {() => any} current; @param {{boxes?: () => boolean, onend?: () => void}} options */
  constructor(viewer, current, { boxes = () => false, onend = () => {} } = {}) {
    this.viewer = viewer;
    this.current = current;
    this.boxes = boxes;
    this.onend = onend;
    viewer.canvas.addEventListener("pointerup", (event) => this.released(event));
    viewer.canvas.addEventListener("blur", () => this.leave());
  }

  find(event, xy) {
    const doc = this.current();
    const reach = (doc.placing ? REACH_PLACING : REACH)[event.pointerType] ?? REACH.mouse;
    return nearest(doc.points, xy, reach / this.viewer.scale, doc.selection);
  }

  down(event, xy) {
    this.pressed = null;
    if (event.button > 0) return false;
    const doc = this.current();
    doc.began = doc.context;
    this.gesture = this.begin(event, xy);
    this.doc = this.gesture && doc;
    if (!this.gesture) doc.began = null;
    this.note(event, xy);
    if (this.gesture === null) this.pressed = [event.clientX, event.clientY];
    this.viewer.redraw();
    return this.gesture !== null;
  }

  begin(event, xy) {
    const doc = this.current();
    if (!doc.editable) return null;
    const adds = event.shiftKey || event.ctrlKey || event.metaKey;
    const handle = handleAt(this.viewer, doc, event);
    const index = this.find(event, xy);
    const framed = doc.framed();
    if (handle && index < 0)
      return handle.kind === "move" ? dragging(doc, -1, framed, xy) : turning(this.viewer, doc, handle, framed);
    if (index >= 0) {
      if (doc.press(index, event)) return { ...NOTHING };
      return this.grab(doc, index, adds, xy, SLIP[event.pointerType] ?? SLIP.mouse);
    }
    if (adds || this.boxes()) return boxing(doc, xy, adds);
    return doc.adding(xy);
  }

  grab(doc, index, adds, xy, slip) {
    if (adds) {
      const chosen = new Set(doc.selection);
      if (!chosen.delete(index)) chosen.add(index);
      doc.select([...chosen], chosen.has(index) ? index : -1);
      if (!chosen.has(index)) return { ...NOTHING };
    } else doc.select(doc.selection.has(index) ? [...doc.selection] : [index], index);
    const at = this.viewer.toScreen(xy);
    const still = () => !adds && doc.selection.size > 1 && doc.select([index], index); // a click on one of several
    return dragging(doc, index, [...doc.selection], xy, (to) => distance(to, at) > slip, still);
  }

  move(event, xy) {
    if (!this.gesture) return;
    this.note(event, xy);
    this.gesture.move(xy, { shiftKey: event.shiftKey, at: this.viewer.place(event) });
    this.viewer.redraw();
  }

  up(event, xy) {
    if (!this.gesture) return;
    this.note(event, xy);
    const { gesture } = this;
    this.gesture = null;
    gesture.up();
    this.ended();
    this.onend();
    this.viewer.redraw();
  }

  cancel() {
    this.gesture?.cancel();
    this.ended();
    this.gesture = null;
    this.pressed = null;
    this.viewer.redraw();
  }

  ended() {
    if (this.doc) this.doc.began = null;
    this.doc = null;
  }

  released(event) {
    const { pressed } = this;
    this.pressed = null;
    if (pressed && distance(pressed, [event.clientX, event.clientY]) <= STILL) this.current().select([], -1);
  }

  hover(event, xy) {
    this.note(event, xy);
    const index = this.find(event, xy);
    if (index === this.hovered && !this.current().placing && !this.current().followsPointer) return;
    this.hovered = index;
    this.viewer.redraw();
  }

  note(event, xy) { this.pointer = { at: this.viewer.place(event), xy, type: event.pointerType }; }

  /** What the loupe shows: the point of a gesture or of keys, or the place for a click; null without a loupe. */
  get loupe() {
    const { pointer, gesture } = this;
    if (!pointer || gesture || pointer.type === "keys") return pointer && (gesture ? gesture.loupe : pointer.xy);
    return this.magnifies && this.hovered < 0 && this.current().placing ? pointer.xy : null;
  }

  /** Show the loupe over a point that was moved by keys, for a moment. */
  nudged(xy) {
    this.pointer = { at: this.viewer.toScreen(xy), xy, type: "keys" };
    clearTimeout(this.resting);
    this.resting = setTimeout(() => this.pointer?.type === "keys" && this.leave(), NUDGED);
  }

  leave() {
    this.pointer = null;
    this.hovered = -1;
    this.viewer.redraw();
  }

  cursor(event, xy) {
    const doc = this.current();
    if (!doc.editable) return "";
    if (this.find(event, xy) >= 0) return "move";
    const handle = handleAt(this.viewer, doc, event);
    if (handle) return CURSORS[handle.kind];
    return doc.placing || this.boxes() || event.shiftKey ? "crosshair" : "";
  }
}

const TURN = Math.PI / 180;
const GROW = 1.01;

/** Edit points with a key: {points, what, key} or null. `indices`: the selected points, or all. */
export function keyEdit(event, points, indices, chosen, mirrored = false) {
  const [across, down] = ARROWS[event.key] ?? [];
  const arrow = across === undefined ? null : [mirrored ? -across : across, down];
  const more = event.shiftKey ? 5 : 1;
  if (arrow && (event.ctrlKey || event.metaKey)) {
    const centre = centroid(points, indices);
    if (centre === null) return null;
    const [angle, factor] = arrow[0] ? [arrow[0] * TURN * more, 1] : [0, GROW ** (-arrow[1] * more)];
    return {
      points: turn(points, indices, centre, angle, factor), what: arrow[0] ? "rotate" : "scale",
      key: `turn ${indices.join()}`,
    };
  }
  if (!arrow || chosen.length === 0) return null;
  const step = event.altKey ? 0.1 : event.shiftKey ? 10 : 1;
  return { points: move(points, chosen, step * arrow[0], step * arrow[1]), what: "move", key: `move ${chosen.join()}` };
}
