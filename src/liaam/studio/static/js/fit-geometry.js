// Geometry of shapes and lights in a picture, independent of the page. Points are [x, y] in image pixels.

/** Smallest box around points: {x0, y0, x1, y1}; null without finite points. */
export function boundsOf(points) {
  const finite = (points ?? []).filter((p) => p && Number.isFinite(p[0]) && Number.isFinite(p[1]));
  if (!finite.length) return null;
  const xs = finite.map((p) => p[0]);
  const ys = finite.map((p) => p[1]);
  return { x0: Math.min(...xs), y0: Math.min(...ys), x1: Math.max(...xs), y1: Math.max(...ys) };
}

/** Box between two corners in any order, clipped to the picture. */
export function boxBetween([ax, ay], [bx, by], width, height) {
  const inside = (value, size) => Math.min(Math.max(value, 0), size - 1);
  const [x0, x1] = [inside(Math.min(ax, bx), width), inside(Math.max(ax, bx), width)];
  const [y0, y1] = [inside(Math.min(ay, by), height), inside(Math.max(ay, by), height)];
  return [x0, y0, x1, y1];
}

/** Whether a box is large enough to be intended. */
export function isDrawn([x0, y0, x1, y1], least = 8) {
  return x1 - x0 >= least && y1 - y0 >= least;
}

/** Normalise a shape: its box is centred, and the longer half side is 1. */
export function normalised(points) {
  const box = boundsOf(points);
  const half = Math.max(box.x1 - box.x0, box.y1 - box.y0) / 2 || 1;
  const [cx, cy] = [(box.x0 + box.x1) / 2, (box.y0 + box.y1) / 2];
  return points.map(([x, y]) => [(x - cx) / half, (y - cy) / half]);
}

/** Apply a placement {x, y, size, turn} to a normalised shape; size: longer half side in pixels, turn: radians. */
export function placed(unit, { x, y, size, turn }) {
  const c = Math.cos(turn) * size;
  const s = Math.sin(turn) * size;
  return unit.map(([u, v]) => [x + c * u - s * v, y + s * u + c * v]);
}

/** Initial placement: 0.6 of a picture's shorter side, in its middle. */
export function firstPlacement(width, height) {
  return { x: (width - 1) / 2, y: (height - 1) / 2, size: 0.3 * Math.min(width, height), turn: 0 };
}

/** Minimum size of a dragged shape, which can still be grabbed. */
const LEAST_SIZE = 6;

/** Placement after its corner (size) or its knob (turn) was dragged from one point to another. */
export function pulled(placement, from, to, what) {
  const [ax, ay] = [from[0] - placement.x, from[1] - placement.y];
  const [bx, by] = [to[0] - placement.x, to[1] - placement.y];
  const [before, after] = [Math.hypot(ax, ay), Math.hypot(bx, by)];
  if (!before || !after) return placement;
  if (what === "turn") return { ...placement, turn: placement.turn + Math.atan2(by, bx) - Math.atan2(ay, ax) };
  return { ...placement, size: Math.max(LEAST_SIZE, (placement.size * after) / before) };
}

/** Handles of a placed shape: the corners of its rotated box, and a knob above the middle of the top side. */
export function handlesOf(unit, placement, gap) {
  const box = boundsOf(unit);
  const corners = [[box.x0, box.y0], [box.x1, box.y0], [box.x1, box.y1], [box.x0, box.y1]];
  const middle = [0, box.y0];
  const knob = [0, box.y0 - gap / placement.size];
  const [top, above, ...rest] = placed([middle, knob, ...corners], placement);
  return { corners: rest, top, knob: above };
}

/** Whether a point is in the rotated box of a placed shape. */
export function isWithin(unit, placement, [px, py]) {
  const box = boundsOf(unit);
  const c = Math.cos(placement.turn) / placement.size;
  const s = Math.sin(placement.turn) / placement.size;
  const [dx, dy] = [px - placement.x, py - placement.y];
  const [u, v] = [c * dx + s * dy, c * dy - s * dx];
  return u >= box.x0 && u <= box.x1 && v >= box.y0 && v <= box.y1;
}

/** Box after a key: arrows move it, comma and full stop resize it; null for other keys. */
export function boxAfterKey(box, { key, shiftKey = false }, width, height) {
  const step = shiftKey ? 10 : 1;
  const [x0, y0, x1, y1] = box ?? [0.25 * width, 0.2 * height, 0.75 * width, 0.8 * height];
  const move = { ArrowLeft: [-step, 0], ArrowRight: [step, 0], ArrowUp: [0, -step], ArrowDown: [0, step] }[key];
  const grow = { ",": -step, "<": -step, ".": step, ">": step }[key];
  if (move) return boxMoved([x0, y0, x1, y1], move, width, height);
  if (!grow) return null;
  if (x1 - x0 + 2 * grow < 8 || y1 - y0 + 2 * grow < 8) return [x0, y0, x1, y1];
  return boxBetween([x0 - grow, y0 - grow], [x1 + grow, y1 + grow], width, height);
}

/** Box moved by [dx, dy] within the picture. */
export function boxMoved([x0, y0, x1, y1], [dx, dy], width, height) {
  const mx = Math.min(Math.max(dx, -x0), width - 1 - x1);
  const my = Math.min(Math.max(dy, -y0), height - 1 - y1);
  return [x0 + mx, y0 + my, x1 + mx, y1 + my];
}

/** Placement after a key; null for other keys. */
export function placementAfterKey(placement, { key, shiftKey = false }) {
  const step = shiftKey ? 10 : 1;
  const { x, y, size, turn } = placement;
  const turned = (by) => ({ turn: turn + (by * step * Math.PI) / 180 });
  const sized = (by) => ({ size: Math.max(LEAST_SIZE, size * (1 + 0.01 * by * step)) });
  const change = {
    ArrowLeft: { x: x - step }, ArrowRight: { x: x + step }, ArrowUp: { y: y - step }, ArrowDown: { y: y + step },
    "[": turned(-1), "{": turned(-1), "]": turned(1), "}": turned(1),
    ",": sized(-1), "<": sized(-1), ".": sized(1), ">": sized(1),
  }[key];
  return change ? { ...placement, ...change } : null;
}

/** Interpolate between two shapes; share 0 is the first. */
export function between(first, second, share) {
  return first.map(([x, y], i) => [x + share * (second[i][0] - x), y + share * (second[i][1] - y)]);
}

/** Mean distance between two shapes in pixels, over their common points; NaN without any. */
export function meanDistance(first, second) {
  let sum = 0;
  let count = 0;
  for (let i = 0; i < first.length; i += 1) {
    const [a, b] = [first[i], second[i]];
    if (!a || !b) continue;
    sum += Math.hypot(a[0] - b[0], a[1] - b[1]);
    count += 1;
  }
  return count ? sum / count : NaN;
}

/** Sine of the largest angle of a light: at 90 degrees it would not reach the front. */
const RIM = Math.sin((85 * Math.PI) / 180);

/** Unit direction to a lamp (x right, y down, z to the viewer) at [x, y] over a ball of radius 1. */
export function directionAt([x, y]) {
  const r = Math.hypot(x, y);
  if (r > RIM) [x, y] = [(x * RIM) / r, (y * RIM) / r];
  return [x, y, Math.sqrt(Math.max(0, 1 - x * x - y * y))];
}

/** Light of a white lamp from the cosine between normal and lamp, as lit() in relighting/lamp.py. */
export function litFrom(facing, softness) {
  if (softness > 0 && Math.abs(facing) < softness) return (facing + softness) ** 2 / (4 * softness);
  return Math.max(0, facing);
}

/** Direction after an arrow key; null for other keys. */
export function directionAfterKey(direction, { key, shiftKey = false }) {
  const step = shiftKey ? 0.15 : 0.04;
  const move = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[key];
  if (key === "Home") return [0, 0, 1];
  if (!move) return null;
  return directionAt([direction[0] + step * move[0], direction[1] + step * move[1]]);
}

/** Direction in words: "from the upper left, 42° off the view".
 *  @param {number[]} direction */
export function directionInWords([x, y, z]) {
  const angle = Math.round((Math.acos(Math.min(1, Math.max(-1, z))) * 180) / Math.PI);
  if (angle < 5) return "from the front";
  const vertical = y < -0.38 * Math.hypot(x, y) ? "upper " : y > 0.38 * Math.hypot(x, y) ? "lower " : "";
  const horizontal = x < -0.38 * Math.hypot(x, y) ? "left" : x > 0.38 * Math.hypot(x, y) ? "right" : "";
  const side = `${vertical}${horizontal}`.trim();
  return `from the ${{ upper: "top", lower: "bottom" }[side] ?? side}, ${angle}° off the view`;
}

/**
 * Curves of a fit's cost for a plot of width x height, x being the iteration. Each level has its own scale, because
 * costs are comparable within a level only.
 */
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
