// Points of a picture as immutable values: every function returns new arrays. A point is [x, y] in pixels of the
// picture, or null if it is not placed. This module is independent of the page.

/** Step right and down of each arrow key. */
export const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
const isPlaced = (point) => point !== null && point !== undefined;
export const indicesOf = (points) => points.map((_, index) => index);
export const placed = (points) => indicesOf(points).filter((index) => isPlaced(points[index]));
export const missing = (points) => indicesOf(points).filter((index) => !isPlaced(points[index]));

/** Round to a hundredth of a pixel, finer than a person can place a point. @param {number[]} point */
export const rounded = ([x, y]) => [Math.round(x * 100) / 100, Math.round(y * 100) / 100];
export const place = (points, index, xy) => points.map((point, i) => (i === index ? rounded(xy) : point));
export const remove = (points, indices) => points.map((point, i) => (indices.includes(i) ? null : point));

export const mean = (values) => values.reduce((sum, value) => sum + value, 0) / values.length;
export const distance = (p, q) => Math.hypot(p[0] - q[0], p[1] - q[1]);

function change(points, indices, update) {
  const result = points.slice();
  for (const i of indices) if (isPlaced(points[i])) result[i] = update(points[i], i);
  return result;
}

export const move = (points, indices, dx, dy) => change(points, indices, ([x, y]) => rounded([x + dx, y + dy]));

/** Rotate by `angle` (radians, clockwise on the screen) and scale by `factor` about `centre`. */
export function turn(points, indices, centre, angle, factor = 1) {
  const [cos, sin] = [factor * Math.cos(angle), factor * Math.sin(angle)];
  return change(points, indices, ([x, y]) => {
    const [dx, dy] = [x - centre[0], y - centre[1]];
    return rounded([centre[0] + cos * dx - sin * dy, centre[1] + sin * dx + cos * dy]);
  });
}

export function bounds(points, indices = placed(points)) {
  const own = indices.map((i) => points[i]).filter(isPlaced);
  if (!own.length) return null;
  const [xs, ys] = [0, 1].map((axis) => own.map((point) => point[axis]));
  return [Math.min(...xs), Math.min(...ys), Math.max(...xs), Math.max(...ys)];
}

/** Corners of a box, clockwise from the upper left. @param {number[]} box */
export const cornersOf = ([x0, y0, x1, y1]) => [[x0, y0], [x1, y0], [x1, y1], [x0, y1]];
/** The line around a box. @param {number[]} box */
export const outlineOf = (box) => [...cornersOf(box), [box[0], box[1]]];
export const middleOf = (/** @type {number[]} */ [x0, y0, x1, y1]) => [(x0 + x1) / 2, (y0 + y1) / 2];

export function centroid(points, indices = placed(points)) {
  const own = indices.map((i) => points[i]).filter(isPlaced);
  return own.length ? [0, 1].map((axis) => mean(own.map((point) => point[axis]))) : null;
}

/** The placed points in a box of two opposite corners. @param {number[][]} points; @param {number[]} corners */
export function inBox(points, [x0, y0, x1, y1]) {
  const isBetween = (v, a, b) => v >= Math.min(a, b) && v <= Math.max(a, b);
  return placed(points).filter((i) => isBetween(points[i][0], x0, x1) && isBetween(points[i][1], y0, y1));
}

/** The placed point nearest to xy within `radius`, or -1. Points in `preferred` count as closer, so that a selected
 *  point can be dragged off another one. */
export function nearest(points, xy, radius, preferred = new Set()) {
  let best = -1;
  let least = radius;
  points.forEach((point, i) => {
    if (!isPlaced(point)) return;
    const away = distance(point, xy) * (preferred.has(i) ? 0.6 : 1);
    if (away <= least) [best, least] = [i, away];
  });
  return best;
}

/** The points that are still to be placed: those without a position, but not the absent ones. */
export const leftToPlace = (points, absent = []) => missing(points).filter((i) => !absent.includes(i));
/** The first of some ascending indices after `index`, cyclically; -1 if there is none. */
export const nextOf = (indices, index = -1) => indices.find((i) => i > index) ?? indices[0] ?? -1;
/** The first missing point after `index`, cyclically; -1 if all are placed. */
export const nextMissing = (points, index = -1) => nextOf(missing(points), index);

/** The least-squares similarity that maps `from` to `to`, over points placed in both: {a, b, x, y} maps (u, v) to
 *  (a u - b v + x, b u + a v + y). With one common point it is a translation; without any it is null. */
export function similarity(from, to) {
  const both = indicesOf(from).filter((i) => isPlaced(from[i]) && isPlaced(to[i]));
  if (both.length === 0) return null;
  const p = centroid(from, both);
  const q = centroid(to, both);
  let [dot, cross, square] = [0, 0, 0];
  for (const i of both) {
    const [px, py, qx, qy] = [from[i][0] - p[0], from[i][1] - p[1], to[i][0] - q[0], to[i][1] - q[1]];
    dot += px * qx + py * qy;
    cross += px * qy - py * qx;
    square += px * px + py * py;
  }
  const [a, b] = square > 1e-9 && Math.hypot(dot, cross) > 1e-9 ? [dot / square, cross / square] : [1, 0];
  return { a, b, x: q[0] - a * p[0] + b * p[1], y: q[1] - b * p[0] - a * p[1] };
}

const carry = ({ a, b, x, y }, [px, py]) => [a * px - b * py + x, b * px + a * py + y];

/** Expected position of each point, from the layout and the placed points. */
export function expected(layout, points) {
  const map = similarity(layout, points) ?? { a: 1, b: 0, x: 0, y: 0 };
  return layout.map((p) => p && rounded(carry(map, p)));
}

/** Centre the layout in a picture and scale it to the fraction `share` of its size. */
export function fitInto(layout, width, height, share = 0.6) {
  const box = bounds(layout);
  if (box === null) return layout;
  const [w, h] = [Math.max(box[2] - box[0], 1e-6), Math.max(box[3] - box[1], 1e-6)];
  const scale = share * Math.min(width / w, height / h);
  const [cx, cy] = middleOf(box);
  return layout.map((p) => p && rounded([width / 2 + scale * (p[0] - cx), height / 2 + scale * (p[1] - cy)]));
}

/** A layout on a picture, or null: unchanged if it is large and inside (but for `slack` pixels), else centred. */
export function layoutIn(layout, width, height, slack = 0) {
  const box = layout && bounds(layout);
  if (!box) return null;
  const inside = Math.min(box[0], box[1]) >= -slack && box[2] < width + slack && box[3] < height + slack;
  const large = Math.max((box[2] - box[0]) / width, (box[3] - box[1]) / height) > 0.2;
  return inside && large ? layout : fitInto(layout, width, height);
}

const spread = (points, centre) => Math.sqrt(mean(points.map((point) => distance(point, centre) ** 2)));

/** The mean of complete shapes, aligned so that rotations do not blur it, in a picture at their mean relative position.
 *  Shapes of mirrored objects are reflected to the side of most.
 *  @param {{points: number[][], width: number, height: number}[]} shapes */
export function meanLayout(shapes, width, height) {
  const whole = ofOneSide(shapes.filter((shape) => shape.points.length > 0 && shape.points.every(isPlaced)));
  if (whole.length === 0) return null;
  const first = whole[0].points;
  const aligned = whole.map((shape) => expected(shape.points, first));
  const shape = first.map((_, i) => [0, 1].map((axis) => mean(aligned.map((points) => points[i][axis]))));
  const middles = whole.map(({ points }) => centroid(points));
  const [x, y] = ["width", "height"].map((side, axis) => mean(whole.map((each, k) => middles[k][axis] / each[side])));
  const size = mean(whole.map((each, k) => spread(each.points, middles[k]) / Math.hypot(each.width, each.height)));
  const turns = whole.map(({ points }) => similarity(shape, points));
  const [cos, sin] = ["a", "b"].map((part) => mean(turns.map((map) => map[part] / Math.hypot(map.a, map.b))));
  const middle = centroid(shape);
  const factor = (size * Math.hypot(width, height)) / Math.max(spread(shape, middle), 1e-9);
  const turned = turn(shape, indicesOf(shape), middle, Math.atan2(sin, cos), factor);
  return move(turned, indicesOf(turned), x * width - middle[0], y * height - middle[1]);
}

/** Complete shapes, of which those that are nearer to the others as mirror images are reflected in their pictures. */
function ofOneSide(shapes) {
  if (shapes.length < 2) return shapes;
  const reflected = shapes.map(({ points, ...rest }) => ({ ...rest, points: points.map(([x, y]) => [rest.width - x, y]) }));
  const first = shapes[0].points;
  const away = ({ points }) => mean(expected(points, first).map((point, i) => distance(point, first[i]) ** 2));
  const isOther = shapes.map((shape, k) => away(reflected[k]) < away(shape));
  const isFirstOfFew = 2 * isOther.filter(Boolean).length > shapes.length;
  return shapes.map((shape, k) => (isOther[k] === isFirstOfFew ? shape : reflected[k]));
}

/** Unit normal of the object's axis of symmetry, from placed twins (mirrored points); horizontal without any. */
export function axisNormal(points, mirror) {
  let [x, y] = [0, 0];
  (mirror ?? []).forEach((twin, i) => {
    if (twin <= i || !isPlaced(points[i]) || !isPlaced(points[twin])) return;
    const [dx, dy] = [points[twin][0] - points[i][0], points[twin][1] - points[i][1]];
    const sign = x * dx + y * dy < 0 ? -1 : 1; // pairs may be listed in either order
    x += sign * dx;
    y += sign * dy;
  });
  const length = Math.hypot(x, y);
  return length < 1e-9 ? [1, 0] : [x / length, y / length];
}

/** Move the twins of `indices` by the mirrored move from `before` to `after`. Twins that are in `indices` keep their
 *  own move, and points on the axis move freely. */
export function withTwins(before, after, indices, mirror) {
  if (!mirror) return after;
  const [nx, ny] = axisNormal(before, mirror);
  const moved = new Set(indices);
  const result = after.slice();
  for (const i of indices) {
    const twin = mirror[i];
    if (twin === i || moved.has(twin) || ![before[twin], before[i], after[i]].every(isPlaced)) continue;
    const [dx, dy] = [after[i][0] - before[i][0], after[i][1] - before[i][1]];
    const along = 2 * (dx * nx + dy * ny);
    result[twin] = rounded([before[twin][0] + dx - along * nx, before[twin][1] + dy - along * ny]);
  }
  return result;
}

/** Flip left and right: each point moves to the mirror image of its twin, about the middle of the points. */
export function flip(points, mirror) {
  const box = bounds(points);
  if (box === null) return points;
  const sum = box[0] + box[2];
  return points.map((_, i) => {
    const source = points[mirror ? mirror[i] : i];
    return isPlaced(source) ? rounded([sum - source[0], source[1]]) : null;
  });
}

export const flipIndices = (indices, mirror) => mirror ? indices.map((i) => mirror[i]).sort((a, b) => a - b) : indices;

export function toggle(indices, changed) {
  const result = new Set(indices);
  const add = !changed.every((i) => result.has(i)); // in a mixed selection, switch all on
  for (const i of changed) add ? result.add(i) : result.delete(i);
  return [...result].sort((a, b) => a - b);
}

export const samePoint = (p, q) => p === q || (isPlaced(p) && isPlaced(q) && p[0] === q[0] && p[1] === q[1]);
export const samePoints = (p, q) => p.length === q.length && p.every((point, i) => samePoint(point, q[i]));

export const sameBar = (one, other) => JSON.stringify(one ?? null) === JSON.stringify(other ?? null);

/** Whether two contents of a landmark file are equal up to rounding in the file. */
export function sameMarks(one, other, tolerance = 0.006) {
  const near = (p, q) => (isPlaced(p) && isPlaced(q) ? p.every((v, axis) => Math.abs(v - q[axis]) <= tolerance)
    : isPlaced(p) === isPlaced(q));
  const sameList = (what) => !one[what] || !other[what] || one[what].join() === other[what].join(); // where both are known
  const same = one.points.length === other.points.length && one.invisible.join() === other.invisible.join() &&
    sameBar(one.bar, other.bar) && sameList("origins") && sameList("absent");
  return same && one.points.every((p, i) => near(p, other.points[i]));
}
