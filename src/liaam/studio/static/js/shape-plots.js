// Plots of shapes and measures, as SVG elements that can be saved: functions of data, which know nothing of the page. `width` is
// that of the place for them, in css pixels, so that their text has its own size.

import { bounds, nearest } from "./points.js";
import { svg } from "./ui.js";

/** Colours of groups, which differ for people with any colour vision (Okabe & Ito 2008), in either theme. */
export const GROUP_COLOURS = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#8a6d00", "#7a7a7a"];
const SHAPES = ["circle", "square", "triangle", "diamond"]; // so that groups differ without colours as well
const PAD = 14;
const AXIS = 34; // room for numbers beside an axis
const MOST_NAMED = 24; // points that are all named where they are picked
const ROOM_FOR_NAME = 90;
const REACH = 24; // css pixels around a point in which a click or a tap picks it
const LONGEST = 14; // characters of a name that are drawn

export const colourOf = (index) => GROUP_COLOURS[index % GROUP_COLOURS.length];

/** A picture of a size, with a description. */
export function plot(width, height, label, ...children) {
  return svg("svg", {
    viewBox: `0 0 ${width} ${height}`, width: "100%", role: "group", "aria-label": label, class: "shape-plot",
    xmlns: "http://www.w3.org/2000/svg",
  }, ...children.flat(Infinity).filter(Boolean));
}

function mark(kind, x, y, r, attributes) {
  if (kind === "circle") return svg("circle", { cx: x, cy: y, r, ...attributes });
  const corners = {
    square: [[-0.9, -0.9], [0.9, -0.9], [0.9, 0.9], [-0.9, 0.9]],
    triangle: [[0, -1.2], [1.1, 0.8], [-1.1, 0.8]], diamond: [[0, -1.3], [1.3, 0], [0, 1.3], [-1.3, 0]],
  }[kind].map(([dx, dy]) => `${x + r * dx},${y + r * dy}`);
  return svg("polygon", { points: corners.join(" "), ...attributes });
}

/** The mark of a group in a legend. */
export const groupMark = (index) =>
  svg("svg", { viewBox: "0 0 12 12", width: 12, height: 12, "aria-hidden": "true" },
    mark(SHAPES[index % SHAPES.length], 6, 6, 4, { fill: colourOf(index) }));

/** About four round numbers between two. */
export function ticks(least, most) {
  const span = most - least || 1;
  const raw = span / 4;
  const power = 10 ** Math.floor(Math.log10(raw));
  const step = power * ([1, 2, 5, 10].find((factor) => factor * power >= raw) ?? 10);
  const first = Math.ceil(least / step - 1e-9);
  const last = Math.floor(most / step + 1e-9);
  return Array.from({ length: last - first + 1 }, (_, i) => Number(((first + i) * step).toPrecision(12)));
}

const text = (x, y, content, attributes = {}) => {
  const element = svg("text", { x, y, class: "plot-text", ...attributes });
  element.textContent = content;
  return element;
};

/** A scatter of points [x, y]: groups -> index of the group of each; chosen: index; unusual: set of indices;
 *  titles: of both axes; names; onpick(index). */
export function scatter({ points, groups, chosen, unusual, titles, names, onpick, width = 520, height = 0.73 * width }) {
  const [left, right, top, bottom] = [AXIS + PAD, width - PAD, PAD, height - AXIS];
  const [x0, y0, x1, y1] = bounds(points) ?? [0, 0, 1, 1];
  // One scale for both axes, since distances in the plot are distances of shapes.
  const scale = Math.min((right - left - 16) / (x1 - x0 || 1e-9), (bottom - top - 16) / (y1 - y0 || 1e-9));
  const at = ([x, y]) => [(left + right) / 2 + scale * (x - (x0 + x1) / 2), (top + bottom) / 2 - scale * (y - (y0 + y1) / 2)];
  const back = [((left - right) / 2) / scale, ((right - left) / 2) / scale].map((v) => v + (x0 + x1) / 2);
  const down = [((top - bottom) / 2) / scale, ((bottom - top) / 2) / scale].map((v) => v + (y0 + y1) / 2);
  const across = ticks(back[0], back[1]).map((value) => [value, at([value, 0])[0]]);
  const upward = ticks(down[0], down[1]).map((value) => [value, at([0, value])[1]]);
  const marks = points.map((point, i) => {
    const [x, y] = at(point);
    const isChosen = i === chosen;
    const element = mark(SHAPES[Math.max(groups[i], 0) % SHAPES.length], x, y, isChosen ? 7 : 4.5, {
      class: `plot-mark${isChosen ? " chosen" : ""}${unusual.has(i) ? " unusual" : ""}`, "data-index": i,
      fill: groups[i] < 0 ? "currentColor" : colourOf(groups[i]),
    });
    const title = svg("title", {});
    title.textContent = names[i];
    element.append(title);
    element.addEventListener("click", () => onpick(i));
    return element;
  });
  return plot(width, height, `Scatter of ${points.length} shapes: ${titles[0]} across, ${titles[1]} upward`,
    across.map(([value, x]) => [svg("line", { x1: x, x2: x, y1: top, y2: bottom, class: value ? "plot-line" : "plot-axis" }),
      text(x, bottom + 16, String(value), { "text-anchor": "middle" })]),
    upward.map(([value, y]) => [svg("line", { x1: left, x2: right, y1: y, y2: y, class: value ? "plot-line" : "plot-axis" }),
      text(left - 6, y + 4, String(value), { "text-anchor": "end" })]),
    text((left + right) / 2, height - 3, titles[0], { "text-anchor": "middle" }),
    text(10, (top + bottom) / 2, titles[1], { "text-anchor": "middle", transform: `rotate(-90 10 ${(top + bottom) / 2})` }),
    marks.filter((_, i) => i !== chosen), marks[chosen]);
}

/** How shapes of about size 1 are drawn: a function from [x, y] to the place in a plot. */
function fitted(points, width, height, pad = PAD) {
  const [x0, y0, x1, y1] = bounds(points) ?? [0, 0, 1, 1];
  const scale = Math.min((width - 2 * pad) / (x1 - x0 || 1e-9), (height - 2 * pad) / (y1 - y0 || 1e-9));
  return (/** @type {number[]} */ [x, y]) => [width / 2 + scale * (x - (x0 + x1) / 2), height / 2 + scale * (y - (y0 + y1) / 2)];
}

const pathOf = (points, closed = false) => points.length ? `M${points.map(([x, y]) => `${x.toFixed(1)} ${y.toFixed(1)}`).join("L")}${closed ? "Z" : ""}` : "";
const outlines = (shape, contours, at) => contours.map(({ indices, closed }) => pathOf(indices.filter((i) => shape[i]).map((i) => at(shape[i])), closed)).join("");

/** All shapes over each other, with their mean, and the chosen one. */
export function superimposed({ shapes, mean, contours, chosen, groups, width = 460, height = 0.5 * width }) {
  const at = fitted([...shapes.flat(), ...mean], width, height);
  const byGroup = new Map();
  shapes.forEach((shape, i) => byGroup.set(groups[i], [...(byGroup.get(groups[i]) ?? []), ...shape]));
  const dot = (r) => ([x, y]) => `M${(x - r).toFixed(1)} ${y.toFixed(1)}h${2 * r}`;
  return plot(width, height, `${shapes.length} shapes after Procrustes superimposition, with their mean`,
    [...byGroup].map(([group, points]) => svg("path", {
      d: points.map(at).map(dot(0.01)).join(""), stroke: group < 0 ? "currentColor" : colourOf(group), class: "plot-cloud",
    })),
    svg("path", { d: outlines(mean, contours, at), class: "plot-mean-line" }),
    mean.map(at).map(([x, y]) => svg("circle", { cx: x, cy: y, r: 3.2, class: "plot-mean" })),
    chosen && svg("path", { d: outlines(chosen, contours, at), class: "plot-chosen-line" }),
    chosen && chosen.map(at).map(([x, y]) => svg("circle", { cx: x, cy: y, r: 3.6, class: "plot-chosen" })));
}

const combined = (base, parts, scores) =>
  base.map(([x, y], i) => parts.reduce(([u, v], part, c) => [u + scores[c] * part[i][0], v + scores[c] * part[i][1]], [x, y]));

/** The shape at some scores. */
export const shapeAt = ({ mean, axes }, scores) => combined(mean, axes, scores);

/** The thin-plate grid that takes the mean shape to that at some scores. */
export function bentGrid(/** @type {Space} */ space, scores, { contours, label, width = 460, height = 0.5 * width }) {
  const { rows, columns, points, bends } = space.grid;
  const bent = combined(points, bends, scores);
  const shape = shapeAt(space, scores);
  const at = fitted([...bent, ...shape], width, height);
  const row = (r) => bent.slice(r * columns, (r + 1) * columns);
  const column = (c) => Array.from({ length: rows }, (_, r) => bent[r * columns + c]);
  const lines = [...Array.from({ length: rows }, (_, r) => row(r)), ...Array.from({ length: columns }, (_, c) => column(c))];
  return plot(width, height, label,
    svg("path", { d: lines.map((line) => pathOf(line.map(at))).join(""), class: "plot-grid" }),
    svg("path", { d: space.mean.map((from, i) => pathOf([at(from), at(shape[i])])).join(""), class: "plot-arrow" }),
    svg("path", { d: outlines(shape, contours, at), class: "plot-mean-line" }),
    shape.map(at).map(([x, y]) => svg("circle", { cx: x, cy: y, r: 3.2, class: "plot-mean" })));
}

/** The values of a bin, one part for each group that has some, in the order of the groups; one without a group if it is empty.
 *  @param {number[]} values; @param {number[] | null} groups the index of each; -1 for none */
function byGroup(values, groups) {
  const groupOf = (i) => groups?.[i] ?? -1;
  const found = values.length ? [...new Set(values.map(groupOf))].sort((a, b) => a - b) : [-1];
  return found.map((group) => ({ group, own: values.filter((i) => groupOf(i) === group) }));
}

/** A histogram: {edges, of}; lit: index of the value that is chosen; groups -> index of the group of each value, of which each
 *  has its part of a bar; onbin(indices). */
export function histogram({ edges, of }, { title, lit, groups = null, onbin, width = 560, height = 0.34 * width }) {
  if (!of.length) return plot(width, height, `${title}: no values`, text(width / 2, height / 2, "No values", { "text-anchor": "middle" }));
  const [left, right, top, bottom] = [AXIS, width - PAD, PAD, height - AXIS];
  const most = Math.max(...of.map((each) => each.length));
  const across = (value) => left + ((value - edges[0]) / (edges.at(-1) - edges[0] || 1)) * (right - left);
  const up = (count) => bottom - (count / most) * (bottom - top);
  const isOne = of.length === 1; // of one value, at the left of its bin
  const bars = of.flatMap((each, i) => {
    let below = 0; // values of the groups before, on which this one stands
    return byGroup(each, groups).map(({ group, own }) => {
      const colour = group < 0 ? {} : { fill: colourOf(group) };
      const bar = svg("rect", {
        x: across(edges[i]) + 0.5, width: Math.max(1, across(edges[i + 1]) - across(edges[i]) - 1), y: up(below + own.length),
        height: up(below) - up(below + own.length), class: `plot-bar${own.includes(lit) ? " lit" : ""}`, "data-count": own.length, ...colour,
      });
      below += own.length;
      const words = svg("title", {});
      words.textContent = `${own.length} from ${edges[i].toPrecision(4)} to ${edges[i + 1].toPrecision(4)}`;
      bar.append(words);
      bar.addEventListener("click", () => own.length && onbin(own));
      return bar;
    });
  });
  return plot(width, height, `Histogram of ${title}`, bars,
    svg("line", { x1: left, x2: right, y1: bottom, y2: bottom, class: "plot-axis" }),
    (isOne ? [edges[0]] : ticks(edges[0], edges.at(-1))).map((value) => text(across(value), bottom + 16, String(Number(value.toPrecision(4))), { "text-anchor": "middle" })),
    text(left - 6, up(most) + 9, String(most), { "text-anchor": "end" }),
    text((left + right) / 2, height - 3, title, { "text-anchor": "middle" }));
}

/** The template with points to be clicked: lit: indices of those that are chosen, in order. onpick(index). */
export function picker({ points, names, contours, lit, closed, onpick, width = 420, height = 0.55 * width }) {
  const at = fitted(points.filter(Boolean), width, height, REACH);
  const line = lit.map((i) => at(points[i]));
  const dots = points.map((point, i) => {
    if (!point) return null;
    const [x, y] = at(point);
    const order = lit.indexOf(i);
    const dot = svg("g", {
      role: "checkbox", tabindex: "0", "aria-checked": String(order >= 0), "aria-label": names[i], "data-index": i, class: "plot-pick",
    }, svg("circle", { cx: x, cy: y, r: 11, fill: "transparent" }), svg("circle", { cx: x, cy: y, r: 5, class: order >= 0 ? "plot-chosen" : "plot-mean" }));
    const title = svg("title", {});
    title.textContent = `${i + 1}: ${names[i]}`; // a scale names points by their numbers
    dot.append(title);
    dot.addEventListener("keydown", (event) => {
      if (event.key !== " " && event.key !== "Enter") return;
      event.preventDefault();
      event.stopPropagation();
      onpick(i);
    });
    return dot;
  });
  /** The name of a point, beside it; apart from the point, so that it takes no click of another. */
  const named = (point, i) => {
    if (!point || (points.length > MOST_NAMED && !lit.includes(i))) return null;
    const [x, y] = at(point);
    const isRight = x > width - ROOM_FOR_NAME;
    const name = names[i].length > LONGEST ? `${names[i].slice(0, LONGEST - 1)}…` : names[i];
    return text(x + (isRight ? -8 : 8), y - 8, name, { "text-anchor": isRight ? "end" : "start", "aria-hidden": "true", "pointer-events": "none" });
  };
  const drawn = plot(width, height, "Points to measure between", svg("path", { d: outlines(points, contours, at), class: "plot-mean-line" }),
    svg("path", { d: pathOf(line, closed), class: "plot-measure" }), dots, points.map(named));
  drawn.addEventListener("click", ({ target, clientX, clientY }) => {
    const hit = target.closest(".plot-pick");
    if (hit) return onpick(Number(hit.dataset.index));
    const { x, y } = new DOMPoint(clientX, clientY).matrixTransform(drawn.getScreenCTM().inverse());
    const index = nearest(points.map((point) => point && at(point)), [x, y], REACH);
    return index < 0 ? undefined : onpick(index);
  });
  return drawn;
}
