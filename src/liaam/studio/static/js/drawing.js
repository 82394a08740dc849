// Drawing over the open picture: of points, names, the frame with its handles, the loupe, marks and the template.

import { contourPath, discs, drawContours, drawEllipses, drawPoints, filled, inked, lines, RIM, stroked } from "./overlays.js";
import { frameOf } from "./gestures.js";
import { ARROWS, bounds, fitInto, indicesOf, outlineOf } from "./points.js";

// Colours for any picture: yellow is placed, blue is proposed, white is selected.
export const COLOURS = { placed: "#ffd166", proposed: "#6fd3ff", chosen: "#ffffff", axis: "#ff7ab8", slip: "#ff5a4f" };
const SCREEN = { toScreen: (point) => point }; // a viewer, for places that are on the screen already
const LOUPE = 62; // css pixels, radius
const MAGNIFIED = 4;
const LEAST_SCALE = 2; // screen pixels per picture pixel

/** Draw all points. In the loupe, the others are hollow, since they would hide what is looked at. */
export function drawMarks(ctx, viewer, view) {
  const { points, invisible, selection, active, hovered, suggested, proposed = new Set(), radius = 4 } = view;
  const colour = suggested ? COLOURS.proposed : COLOURS.placed;
  if (viewer.isLoupe) {
    discs(ctx, viewer, points.filter((_, i) => i !== active), radius);
    stroked(ctx, colour, 1.5);
    return;
  }
  const isHollow = (i) => suggested || invisible.has(i) || proposed.has(i);
  drawPoints(ctx, viewer, points.filter((_, i) => !isHollow(i)), { colour, radius });
  discs(ctx, viewer, points.filter((_, i) => isHollow(i)), radius);
  if (suggested) filled(ctx, "rgb(111 211 255 / 35%)"); // transparent, so that the picture can be checked through it
  stroked(ctx, colour, 1.5);
  if (proposed.size) {
    discs(ctx, viewer, points.filter((_, i) => proposed.has(i)), radius);
    stroked(ctx, COLOURS.proposed, 1.5);
  }
  discs(ctx, viewer, points.filter((_, i) => selection.has(i)), radius + 3.5);
  stroked(ctx, COLOURS.chosen, 1.8);
  discs(ctx, viewer, points.filter((_, i) => i === hovered || i === active), radius + 6.5);
  stroked(ctx, colour, 1.5);
}

export function drawPaths(ctx, viewer, points, contours, suggested) {
  const colour = suggested ? COLOURS.proposed : COLOURS.placed;
  drawContours(ctx, viewer, points, contours, { colour, width: 1.3, dash: suggested ? [5, 4] : [] });
}

const FONT = "600 12px Inter, system-ui, sans-serif";

/** The width of a text, css pixels. */
export function widthOf(ctx, text) {
  ctx.font = FONT;
  return ctx.measureText(text).width;
}

export function drawText(ctx, text, x, y, { colour = "#fff", align = "left" } = {}) {
  ctx.font = FONT;
  ctx.textAlign = align;
  ctx.textBaseline = "middle";
  ctx.lineJoin = "round";
  ctx.lineWidth = 3.5;
  ctx.strokeStyle = "rgb(0 0 0 / 75%)";
  ctx.strokeText(text, x, y);
  ctx.fillStyle = colour;
  ctx.fillText(text, x, y);
}

/** Draw names beside points. Names off the canvas are skipped, because text is slow. */
export function drawNames(ctx, viewer, points, names, indices) {
  if (viewer.isLoupe) return;
  const { clientWidth, clientHeight } = viewer.container;
  for (const i of indices) {
    if (!points[i]) continue;
    const [x, y] = viewer.toScreen(points[i]);
    if (x < -100 || y < 0 || x > clientWidth || y > clientHeight) continue;
    drawText(ctx, names[i], x + 9, y - 9);
  }
}

const SIGNS = {
  turn: "M1.4-4.3A4.5 4.5 0 1 1-4.3-1.4M4-6.5 1-4.4 4-2",
  move: "M-6 0H6M0-6V6M4-2 6 0 4 2M-4-2-6 0-4 2M-2-4 0-6 2-4M-2 4 0 6 2 4",
};

export function drawFrame(ctx, viewer, points, indices) {
  const frame = frameOf(viewer, points, indices);
  if (frame === null) return;
  const [x0, y0, x1, y1] = frame.box;
  const middle = (x0 + x1) / 2;
  const [turn, move] = frame.handles.slice(4);
  lines(ctx, [outlineOf(frame.box), [[middle, y0], turn.at], [[middle, y1], move.at]]);
  stroked(ctx, "rgb(255 255 255 / 80%)", 1, [4, 3]);
  for (const { kind, at } of frame.handles) drawHandle(ctx, kind, at);
}

export function drawHandle(ctx, kind, /** @type {number[]} */ [x, y]) {
  ctx.beginPath();
  if (kind === "scale") ctx.rect(x - 5, y - 5, 10, 10);
  else ctx.arc(x, y, 9, 0, 2 * Math.PI);
  filled(ctx, "#fff");
  inked(ctx, RIM, 1.5);
  if (kind === "scale") return;
  ctx.save();
  ctx.translate(x, y);
  ctx.strokeStyle = "#222";
  ctx.lineWidth = 1.4;
  ctx.stroke(new Path2D(SIGNS[kind]));
  ctx.restore();
}

/** Position of the loupe: beside a mouse, above a finger, and always inside the canvas. */
export function loupePlace([x, y], type, width, height) {
  const r = LOUPE + 6;
  const up = type === "touch" ? 110 : 86;
  const aside = type === "touch" ? 0 : 86;
  const cx = x + aside + r > width ? x - aside : x + aside;
  const cy = y - up - r < 0 ? y + up : y - up;
  // At the top edge the loupe goes beside the finger instead.
  const dodge = type === "touch" && y - up - r < 0 ? (x > width / 2 ? -120 : 120) : 0;
  return [Math.min(Math.max(cx + dodge, r), width - r), Math.min(Math.max(cy, r), height - r)];
}

/** The loupe over `xy`, with the pointer at a place: {centre, scale}, or null if there is no room. */
export function loupeOver(viewer, pointer) {
  const { clientWidth: width, clientHeight: height } = viewer.container;
  if (!viewer.source || width < 200 || height < 200) return null;
  return {
    centre: loupePlace(pointer.at, pointer.type, width, height),
    scale: Math.min(Math.max(viewer.scale * MAGNIFIED, LEAST_SCALE), 24),
  };
}

/** Draw the surroundings of `xy` with the points around it, and a cross at the position itself. */
export function drawLoupe(ctx, viewer, xy, pointer, colour = COLOURS.placed) {
  const { centre: [cx, cy], scale } = loupeOver(viewer, pointer) ?? { centre: [] };
  if (!scale) return;
  const circle = () => discs(ctx, SCREEN, [[cx, cy]], LOUPE);
  ctx.save();
  circle();
  filled(ctx, "#1b2030");
  ctx.clip();
  viewer.drawAs(ctx, { scale, ...viewer.cornerFor(xy, [cx, cy], scale) });
  const arm = (/** @type {number[]} */ [dx, dy]) => [6, 22].map((away) => [cx + away * dx, cy + away * dy]);
  lines(ctx, Object.values(ARROWS).map(arm));
  stroked(ctx, colour, 1.4);
  ctx.restore();
  circle();
  stroked(ctx, "#fff", 2.5);
}

/** Draw the template's layout in a small canvas, with the next point highlighted. */
export function drawHint(canvas, layout, contours, lit, style) {
  const ratio = window.devicePixelRatio || 1;
  const { clientWidth: width, clientHeight: height } = canvas;
  if (!width || !layout) return;
  canvas.width = width * ratio;
  canvas.height = height * ratio;
  const ctx = canvas.getContext("2d");
  ctx.scale(ratio, ratio);
  const points = fitInto(layout, width, height, 0.85);
  const [muted, accent, panel] = ["--muted", "--accent", "--panel"].map((name) => style.getPropertyValue(name));
  ctx.globalAlpha = 0.7;
  contourPath(ctx, SCREEN, points, contours);
  inked(ctx, muted, 1.2);
  discs(ctx, SCREEN, points, 1.8);
  filled(ctx, muted);
  ctx.globalAlpha = 1;
  discs(ctx, SCREEN, [points[lit]], 5);
  filled(ctx, accent);
  inked(ctx, panel, 1.5);
}

/** Where on the screen the axis is dragged: near the top, since clicks elsewhere on the line place points. */
export function gripOf(viewer, axis) {
  const [x, top] = viewer.toScreen([axis, 0]);
  return [x, Math.min(Math.max(top, 0) + 16, viewer.container.clientHeight - 16)];
}

function drawAxis(ctx, viewer, axis) {
  const [x, y] = gripOf(viewer, axis);
  lines(ctx, [[[x, 0], [x, viewer.container.clientHeight]]]);
  inked(ctx, COLOURS.axis, 1.5, [8, 5]);
  discs(ctx, SCREEN, [[x, y]], 11);
  filled(ctx, COLOURS.axis);
  drawText(ctx, "⇔", x, y, { align: "center" });
}

const CLOSE = 24; // css pixels between points from which on there is room for ellipses and for points of full size
const NAMED = 6; // the names of up to so many selected points are shown

/** How far points lie apart on the screen, were they spread evenly. */
function spacing(viewer, points) {
  const [x0, y0, x1, y1] = bounds(points) ?? [0, 0, 0, 0];
  return viewer.scale * Math.sqrt(((x1 - x0) * (y1 - y0)) / Math.max(points.length, 1)) || CLOSE;
}

/** Draw the marks of a picture; show: {names, contours, ellipses}; wrong: indices of points that may be slips. */
export function drawMarking(ctx, viewer, tool, marking, show, wrong) {
  const { points, suggested, selection, active, invisible, names } = marking;
  const room = spacing(viewer, points) / CLOSE;
  if (show.ellipses && room > 1)
    drawEllipses(ctx, viewer, marking.uncertain, marking.book.covariances, { colour: COLOURS.proposed, width: 1.1 });
  if (show.contours) drawPaths(ctx, viewer, points, marking.template.contours, suggested);
  const radius = Math.min(4, Math.max(1.8, 4 * room));
  const proposed = new Set(suggested ? [] : indicesOf(points).filter((i) => marking.origins[i] === "proposed"));
  drawMarks(ctx, viewer, { points, invisible, selection, active, hovered: tool.hovered, suggested, proposed, radius });
  const slips = points.filter((_, i) => wrong.includes(i));
  const isClear = spacing(viewer, slips) >= CLOSE;
  discs(ctx, viewer, slips, radius + (isClear ? 5 : 2));
  stroked(ctx, COLOURS.slip, 2);
  if (!tool.gesture) drawFrame(ctx, viewer, points, marking.framed());
  const few = [[...selection], isClear ? wrong : []].flatMap((some) => (some.length <= NAMED ? some : []));
  const named = show.names ? indicesOf(points) : [...new Set([...few, tool.hovered].filter((i) => i >= 0))];
  drawNames(ctx, viewer, points, names, named);
  if (marking.placing && !viewer.isLoupe && tool.pointer && !tool.gesture && tool.hovered < 0)
    drawText(ctx, names[active], tool.pointer.at[0] + 14, tool.pointer.at[1] + 16);
}

export function drawGesture(ctx, viewer, tool, suggested) {
  if (viewer.isLoupe) return;
  const { loupe, gesture } = tool;
  if (gesture?.box) {
    lines(ctx, [outlineOf(gesture.box).map((corner) => viewer.toScreen(corner))]);
    filled(ctx, "rgb(255 255 255 / 12%)");
    stroked(ctx, "#fff", 1, [4, 3]);
  }
  if (loupe) drawLoupe(ctx, viewer, loupe, tool.pointer, suggested ? COLOURS.proposed : COLOURS.placed);
}

export function drawDrafting(ctx, viewer, tool, drafting) {
  const { draft, selection, active, invisible, axis } = drafting;
  const ghost = tool.gesture?.ghost ?? draft;
  const points = tool.gesture?.ghost ? ghost.points : drafting.points;
  if (axis !== null) drawAxis(ctx, viewer, axis);
  drawPaths(ctx, viewer, points, ghost.contours, false);
  if (ghost.path >= 0 && !viewer.isLoupe && !tool.gesture && tool.pointer && tool.hovered < 0 && drafting.placing)
    drawNextLine(ctx, viewer, draft, tool.pointer.at);
  drawMarks(ctx, viewer, { points, invisible, selection, active, hovered: tool.hovered, suggested: false });
  const named = [...new Set([...selection, tool.hovered])].filter((i) => i >= 0);
  drawNames(ctx, viewer, points, ghost.names, named);
  if (!tool.gesture) drawFrame(ctx, viewer, points, drafting.framed());
}

function drawNextLine(ctx, viewer, draft, at) {
  const last = draft.points[draft.contours[draft.path]?.indices.at(-1)];
  if (!last) return;
  lines(ctx, [[viewer.toScreen(last), at]]);
  ctx.globalAlpha = 0.7;
  inked(ctx, COLOURS.placed, 1.2, [3, 4]);
  ctx.globalAlpha = 1;
}
