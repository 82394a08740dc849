// Drawings of the Annotate tab over the open picture.

import { drawAxis } from "./drafting.js";
import { COLOURS, drawBox, drawFrame, drawLoupe, drawMarks, drawNames, drawPaths, drawText } from "./drawing.js";
import { discs, drawEllipses, inked, lines, stroked } from "./overlays.js";
import { bounds, indicesOf } from "./points.js";

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
  if (marking.state.source === "proposal" && show.ellipses && room > 1)
    drawEllipses(ctx, viewer, points, marking.book.covariances, { colour: COLOURS.proposed, width: 1.1 });
  if (show.contours) drawPaths(ctx, viewer, points, marking.template.contours, suggested);
  const radius = Math.min(4, Math.max(1.8, 4 * room));
  drawMarks(ctx, viewer, { points, invisible, selection, active, hovered: tool.hovered, suggested, radius });
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
  if (tool.gesture?.box) drawBox(ctx, viewer, tool.gesture.box);
  const { loupe } = tool;
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
