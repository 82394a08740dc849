// Geometry of boxes, shapes and lights in a picture, independent of the page. Points are [x, y] in image pixels.

import { ARROWS, indicesOf } from "./points.js";

/** Whether a key enlarges (1) or shrinks (-1) the start. */
export const GROWTH = { ",": -1, "<": -1, ".": 1, ">": 1 };

/** Corners of a box, clockwise from the upper left. */
export const cornersOf = (/** @type {number[]} */ [x0, y0, x1, y1]) => [[x0, y0], [x1, y0], [x1, y1], [x0, y1]];

/** Box between two corners in any order, clipped to the picture. */
export function boxBetween(/** @type {number[]} */ [ax, ay], /** @type {number[]} */ [bx, by], width, height) {
  const inside = (value, size) => Math.min(Math.max(value, 0), size - 1);
  return [
    inside(Math.min(ax, bx), width), inside(Math.min(ay, by), height),
    inside(Math.max(ax, bx), width), inside(Math.max(ay, by), height),
  ];
}

/** Whether a box is large enough to be intended. @param {number[]} box */
export const isDrawn = ([x0, y0, x1, y1], least = 8) => x1 - x0 >= least && y1 - y0 >= least;

/** Box after a key: arrows move it, comma and full stop resize it; null for other keys. */
export function boxAfterKey(box, { key, shiftKey = false }, width, height) {
  const step = shiftKey ? 10 : 1;
  const [x0, y0, x1, y1] = box ?? [0.25 * width, 0.2 * height, 0.75 * width, 0.8 * height];
  const move = ARROWS[key];
  const grow = step * GROWTH[key];
  if (move) return boxMoved([x0, y0, x1, y1], move.map((by) => step * by), width, height);
  if (!grow) return null;
  const grown = [x0 - grow, y0 - grow, x1 + grow, y1 + grow];
  return isDrawn(grown) ? boxBetween(grown.slice(0, 2), grown.slice(2), width, height) : [x0, y0, x1, y1];
}

/** Box moved by [dx, dy] within the picture. */
export function boxMoved([x0, y0, x1, y1], /** @type {number[]} */ [dx, dy], width, height) {
  const mx = Math.min(Math.max(dx, -x0), width - 1 - x1);
  const my = Math.min(Math.max(dy, -y0), height - 1 - y1);
  return [x0 + mx, y0 + my, x1 + mx, y1 + my];
}

/** Mean distance between two shapes in pixels, over their common points; NaN without any. */
export function meanDistance(first, second) {
  const both = indicesOf(first).filter((i) => first[i] && second[i]);
  const distances = both.map((i) => Math.hypot(first[i][0] - second[i][0], first[i][1] - second[i][1]));
  return distances.reduce((sum, distance) => sum + distance, 0) / both.length;
}

/** Sine of the largest angle of a light: at 90 degrees it would not reach the front. */
const RIM = Math.sin((85 * Math.PI) / 180);

/** Unit direction to a lamp (x right, y down, z to the viewer) at [x, y] over a ball of radius 1. @param {number[]} place */
export function directionAt([x, y]) {
  const r = Math.hypot(x, y);
  if (r > RIM) [x, y] = [(x * RIM) / r, (y * RIM) / r];
  return [x, y, Math.sqrt(Math.max(0, 1 - x * x - y * y))];
}

/** Direction after an arrow key; null for other keys. */
export function directionAfterKey(direction, { key, shiftKey = false }) {
  const step = shiftKey ? 0.15 : 0.04;
  const move = ARROWS[key];
  if (key === "Home") return [0, 0, 1];
  if (!move) return null;
  return directionAt([direction[0] + step * move[0], direction[1] + step * move[1]]);
}

/** Direction in words: "from the upper left, 42° off the view". @param {number[]} direction */
export function directionInWords([x, y, z]) {
  const angle = Math.round((Math.acos(Math.min(1, Math.max(-1, z))) * 180) / Math.PI);
  if (angle < 5) return "from the front";
  const vertical = y < -0.38 * Math.hypot(x, y) ? "upper " : y > 0.38 * Math.hypot(x, y) ? "lower " : "";
  const horizontal = x < -0.38 * Math.hypot(x, y) ? "left" : x > 0.38 * Math.hypot(x, y) ? "right" : "";
  const side = `${vertical}${horizontal}`.trim();
  return `from the ${{ upper: "top", lower: "bottom" }[side] ?? side}, ${angle}° off the view`;
}

/** Curves of a fit's cost for a plot of width x height, x being the iteration. Each level has its own scale, because
 *  costs are comparable within a level only. */
export function costRuns(iterations, width, height, margin = 4) {
  const n = iterations.length;
  const across = (i) => (n > 1 ? margin + (i * (width - 2 * margin)) / (n - 1) : width / 2);
  const runs = [];
  iterations.forEach(({ level, cost }, index) => {
    if (runs.at(-1)?.level !== level) runs.push({ level, points: [] });
    runs.at(-1).points.push({ index, cost });
  });
  for (const run of runs) {
    const costs = run.points.map((p) => p.cost).filter(Number.isFinite);
    const [low, high] = [Math.min(...costs), Math.max(...costs)];
    for (const point of run.points) {
      const relative = high > low && Number.isFinite(point.cost) ? (point.cost - low) / (high - low) : 0;
      point.x = across(point.index);
      point.y = height - margin - relative * (height - 2 * margin);
    }
  }
  return runs;
}
