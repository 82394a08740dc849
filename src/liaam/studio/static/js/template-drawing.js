// Drawing of a template while it is edited.

import { AxisGrip } from "./axis-grip.js";
import { COLOURS, drawFrame, drawMarks, drawNames, drawPaths } from "./drawing.js";

export function drawDrafting(ctx, viewer, tool, drafting) {
  const { draft, selection, active, invisible, axis } = drafting;
  const ghost = tool.gesture?.ghost ?? draft;
  const points = tool.gesture?.ghost ? ghost.points : drafting.points;
  if (axis !== null) new AxisGrip(viewer, axis).draw(ctx);
  drawPaths(ctx, viewer, points, ghost.contours, false);
  if (ghost.path >= 0 && !tool.gesture && tool.pointer && tool.hovered < 0 && drafting.placing)
    drawNextLine(ctx, viewer, draft, tool.pointer.at);
  drawMarks(ctx, viewer, { points, invisible, selection, active, hovered: tool.hovered, suggested: false });
  const named = [...new Set([...selection, tool.hovered])].filter((i) => i >= 0);
  drawNames(ctx, viewer, points, ghost.names, named);
  if (!tool.gesture) drawFrame(ctx, viewer, points, drafting.framed());
}

/** Draw the line that a click would add, from the path's last point to the pointer. */
function drawNextLine(ctx, viewer, draft, at) {
  const last = draft.points[draft.contours[draft.path]?.indices.at(-1)];
  if (!last) return;
  ctx.beginPath();
  ctx.moveTo(...viewer.toScreen(last));
  ctx.lineTo(...at);
  ctx.setLineDash([3, 4]);
  ctx.strokeStyle = COLOURS.placed;
  ctx.lineWidth = 1.2;
  ctx.globalAlpha = 0.7;
  ctx.stroke();
  ctx.setLineDash([]);
  ctx.globalAlpha = 1;
}
