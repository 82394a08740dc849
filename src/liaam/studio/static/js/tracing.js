// Tracing a contour of the open picture: clicks add the knots of a smooth curve, along which the contour's points are
// placed at even distances. Only semilandmarks that have a position are moved: landmarks, and points that other contours
// have too, stay where a person has placed or accepted them.

import { curveThrough, spread } from "./curve.js";
import { COLOURS } from "./drawing.js";
import { Editable, placing } from "./gestures.js";
import { History } from "./history.js";
import { isOwn } from "./origins.js";
import { discs, drawContours, drawPoints, stroked } from "./overlays.js";
import { indicesOf, rounded } from "./points.js";
import { slides } from "./template.js";

const LEAST = 3; // points of a contour that is traced

export class Tracing extends Editable {
  /** @type {import("./marking.js").Marking} */
  #marking;
  #contour = null; // that is traced, or null
  #history = new History([]); // of the knots; `shown` are those during a gesture
  #fixed = []; // [place in the contour, point] of points that stay
  #before = null; // the context of the marks when tracing began

  /** handlers: onchange(): tracing starts, stops or goes on.
   *  @param {import("./marking.js").Marking} marking */
  constructor(marking, handlers) {
    super(handlers);
    this.#marking = marking;
  }

  get on() { return this.#contour !== null; }
  get history() { return this.#history; }
  get editable() { return this.#marking.editable; }
  /** The points that stay at the contour's start and at its end, if there are some. */
  get first() { return this.fixedAt(0); }
  get last() { return this.#contour.closed ? [] : this.fixedAt(this.#contour.indices.length - 1); }
  get placing() { return this.editable; }
  get knots() { return this.shown ?? this.#history.state; }
  get points() { return [...this.first, ...this.knots, ...this.last]; }
  get prompt() {
    const { indices, closed, name } = this.#contour;
    const { names } = this.#marking;
    const [from, to] = [indices[0], indices.at(-1)].map((index) => names[index]);
    return `Click along ${name || "the curve"} from ${from}${closed ? "" : ` to ${to}`}. Enter or a click on the last place ends it`;
  }

  /** The contour to trace: that of the selected point, or of the next one to place; null if there is none. */
  get wanted() {
    const { active, missing: missed, template } = this.#marking;
    const long = template?.contours.filter(({ indices }) => indices.length >= LEAST) ?? [];
    for (const index of [active, ...missed.filter((i) => i > active), ...missed]) {
      const own = long.filter(({ indices }) => indices.includes(index));
      if (own.length) return own.find(({ indices }) => indices.some((i) => missed.includes(i))) ?? own[0];
    }
    return null;
  }

  /** The points of a contour that stay: [place in the contour, point]. Proposed ones bind nobody. */
  fixedOf({ indices }) {
    const { origins, points, template } = this.#marking;
    const isShared = (index) => template.contours.filter((each) => each.indices.includes(index)).length > 1;
    const stays = (index) => origins[index] !== "proposed" && (isShared(index) || !slides(template, index));
    return indices.flatMap((index, place) => (points[index] && stays(index) ? [[place, points[index]]] : []));
  }

  /** Whether a contour has a point that may be placed or moved. */
  mayChange(contour) { return this.fixedOf(contour).length < contour.indices.length; }

  fixedAt(end) { return this.#fixed.filter(([place]) => place === end).map(([, point]) => point); }

  /** Begin to trace a contour; false: stop. */
  turn(/** @type {any} */ contour) {
    const fixed = contour ? this.fixedOf(contour) : [];
    const before = contour ? this.#marking.context : null;
    this.#contour = contour || null;
    this.#fixed = fixed;
    this.#before = before;
    this.#history = new History([]);
    this.setShown(null);
    this.select([]);
    this.#marking.preview(null);
    this.onchange();
  }

  /** The points of the picture with those along the curve; null while it has too few knots. */
  get whole() {
    const [contour, fixed, { points }] = [this.#contour, this.#fixed, this];
    const line = curveThrough(points, contour.closed);
    const enough = this.knots.length && points.length > (contour.closed ? 2 : 1) && line.length > 1;
    return enough ? this.along(line, contour, fixed) : null;
  }

  along(line, { indices, closed }, fixed) {
    const { absent, state } = this.#marking;
    const points = state.points.slice();
    spread(line, indices.length, closed, fixed).forEach((point, place) => {
      const index = indices[place];
      if (!absent.includes(index)) points[index] = rounded(point);
    });
    return points;
  }

  finish() {
    const { whole } = this;
    const [contour, before] = [this.#contour, this.#before];
    if (!whole) return;
    this.turn(false);
    this.#marking.commit(whole, "trace the curve", null, { changed: "placed", context: before });
    this.#marking.onplaced(contour.indices.at(-1));
  }

  /** Space the points of a contour evenly along the curve through those that are placed. */
  space(contour) {
    const knots = contour.indices.map((index) => this.#marking.points[index]).filter(Boolean);
    if (knots.length < LEAST) return;
    const line = curveThrough(knots, contour.closed);
    const { origins } = this.#marking;
    const isOfPerson = contour.indices.every((index) => !origins[index] || isOwn(origins[index]));
    const fresh = isOfPerson ? "placed" : "proposed"; // what runs through proposed points is no person's either
    this.#marking.commit(this.along(line, contour, this.fixedOf(contour)), "space the curve evenly", null, { fresh });
  }

  /** The knots among points that a gesture has edited. */
  ownOf(points) { return points.slice(this.first.length, points.length - this.last.length); }

  preview(points) {
    this.setShown(points && this.ownOf(points));
    this.#marking.preview(this.whole);
  }

  commit(points, what, key = null) {
    this.#history.push(this.ownOf(points), what, key, this.contextBefore);
    this.changed();
  }

  /** Undo or redo a place. Before the first one, undo leaves tracing, and undoes the last step of the marks. */
  travel(way) {
    if (way === "undo" ? this.#history.canUndo : this.#history.canRedo) return super.travel(way);
    if (!(way === "undo" ? this.#marking.history?.canUndo : this.#marking.history?.canRedo)) return null;
    this.turn(false);
    return this.#marking.travel(way);
  }

  /** Remove the last knot. */
  drop() {
    const { first, knots, last } = this;
    if (knots.length) this.commit([...first, ...knots.slice(0, -1), ...last], "remove the last place");
  }

  changed() {
    if (this.active >= this.points.length - this.last.length) this.select([]);
    this.preview(null);
    this.onchange();
  }

  adding(xy) {
    const { first, knots, last } = this;
    const show = (at) => this.preview([...first, ...knots, rounded(at), ...last]);
    const up = () => {
      this.commit(this.points, "place on the curve");
      this.select([first.length + knots.length]);
    };
    return placing(xy, show, up, () => this.preview(null));
  }

  /** A press on the last knot, on an end that stays, or on the first knot of a closed contour ends it. */
  press(index) {
    const { points, first, last } = this;
    const contour = this.#contour;
    const ends = index >= points.length - last.length - 1 || (index === 0 && contour.closed);
    if (ends) this.finish();
    return ends || index < first.length;
  }

  draw(ctx, viewer) {
    const line = curveThrough(this.points, this.#contour.closed);
    drawContours(ctx, viewer, line, [{ indices: indicesOf(line), closed: false }], { colour: COLOURS.chosen });
    if (viewer.isLoupe) return;
    drawPoints(ctx, viewer, this.points, { colour: COLOURS.chosen, radius: 5 });
    discs(ctx, viewer, this.points.filter((_, i) => this.selection.has(i)), 9);
    stroked(ctx, COLOURS.chosen, 1.8);
  }
}
