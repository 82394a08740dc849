// Smooth curves through a few knots, and points at even distances along them. This module is independent of the page.

const PIECES = 32; // straight pieces of a curve between two knots
const LEAST = 1e-6; // pixels between two knots
const apart = (p, q) => Math.hypot(p[0] - q[0], p[1] - q[1]);

/** The centripetal Catmull-Rom curve through knots (Yuksel et al. 2011), as a dense line; if closed, back to its start. */
export function curveThrough(knots, closed = false) {
  const own = knots.filter((knot, i) => i === 0 || apart(knot, knots[i - 1]) > LEAST);
  if (closed && own.length > 1 && apart(own[0], own.at(-1)) <= LEAST) own.pop();
  const n = own.length;
  if (n < 2) return own;
  // An open curve goes on beyond its ends as straight as it began.
  const beyond = (end, inner) => [2 * end[0] - inner[0], 2 * end[1] - inner[1]];
  const line = closed ? [own[n - 1], ...own, own[0], own[1]]
    : [beyond(own[0], own[1]), ...own, beyond(own[n - 1], own[n - 2])];
  const pieces = line.slice(3).flatMap((_, i) => piece(line.slice(i, i + 4)));
  return [...pieces, line.at(-2)];
}

/** The curve between the second and the third of four knots, without its end. */
function piece(/** @type {number[][]} */ [p, q, r, s]) {
  const [before, own, after] = [[p, q], [q, r], [r, s]].map(([from, to]) => Math.sqrt(apart(from, to)));
  const coefficients = [0, 1].map((axis) => {
    const step = r[axis] - q[axis];
    const out = step + own * ((q[axis] - p[axis]) / before - (r[axis] - p[axis]) / (before + own));
    const into = step + own * ((s[axis] - r[axis]) / after - (s[axis] - q[axis]) / (own + after));
    return [q[axis], out, 3 * step - 2 * out - into, out + into - 2 * step];
  });
  return Array.from({ length: PIECES }, (_, i) => i / PIECES)
    .map((t) => coefficients.map(([a, b, c, d]) => a + t * (b + t * (c + t * d))));
}

/** `number` points at even distances along a line: with both ends, or, if closed, from the start where it also ends.
 *  fixed: [index, point] of those that stay where they are; the others are spread evenly between them. */
export function spread(line, number, closed = false, fixed = []) {
  let sum = 0;
  const lengths = line.map((point, i) => (sum += i ? apart(point, line[i - 1]) : 0));
  const [indices, places] = [[0], [[0]]]; // of points, and where they are along the line
  for (const [index, point] of fixed) {
    const away = line.map((other) => apart(other, point));
    const place = lengths[away.indexOf(Math.min(...away))];
    if (place <= places.at(-1)[0] || place >= sum) continue;
    indices.push(index);
    places.push([place]);
  }
  indices.push(closed ? number : number - 1);
  places.push([sum]);
  const even = Array.from({ length: number }, (_, i) => between(lengths, line, between(indices, places, i)[0]));
  for (const [index, point] of fixed) even[index] = point;
  return even;
}

/** The value at a place, by linear interpolation of values at increasing places. */
function between(places, values, place) {
  const next = places.findIndex((other) => other > place);
  const i = next < 0 ? places.length - 1 : next;
  const share = (place - places[i - 1]) / Math.max(places[i] - places[i - 1], 1e-12);
  return values[i].map((value, axis) => values[i - 1][axis] + share * (value - values[i - 1][axis]));
}
