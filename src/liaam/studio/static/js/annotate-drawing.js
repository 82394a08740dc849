// What the Annotate tab draws over the picture that is open, or over that on which a template is made.

import {
  COLOURS,
  drawBox,
  drawFrame,
  drawLoupe,
  drawMarks,
  drawNames,
  drawPaths,
  drawSpread,
  drawText,
} from "./drawing.js";
import { indicesOf } from "./points.js";

const MANY = 150; // points from which on they are drawn smaller
const NAMED = 6; // chosen points up to which their names are shown

/** The marks of a picture; show: {names, contours, ellipses}. */
export function drawMarking(ctx, viewer, tool, marking, show) {
  const { points, suggested, selection, active, invisible, names } = marking;
  if (marking.state.source === "proposal" && show.ellipses) drawSpread(ctx, viewer, points, marking.book.covariances);
  if (show.contours) drawPaths(ctx, viewer, points, marking.template.contours, suggested);
  drawMarks(ctx, viewer, {
    points,
    invisible,
    selection,
    active,
    hovered: tool.hovered,
    suggested,
    radius: points.length > MANY ? 3 : 4,
  });
  if (!tool.gesture) drawFrame(ctx, viewer, points, marking.framed());
  const few = selection.size <= NAMED ? [...selection] : [];
  const named = show.names ? indicesOf(points) : [...new Set([...few, tool.hovered].filter((i) => i >= 0))];
  drawNames(ctx, viewer, points, names, named);
  if (marking.placing && tool.pointer && !tool.gesture && tool.hovered < 0) {
    drawText(ctx, names[active], tool.pointer.at[0] + 14, tool.pointer.at[1] + 16);
  }
}

/** What a gesture shows while it lasts: its box, and the loupe under the pointer. */
export function drawGesture(ctx, viewer, tool, suggested) {
  if (tool.gesture?.box) drawBox(ctx, viewer, tool.gesture.box);
  if (tool.gesture?.loupe && tool.pointer)
    drawLoupe(ctx, viewer, tool.gesture.loupe, tool.pointer, suggested ? COLOURS.proposed : COLOURS.placed);
}
