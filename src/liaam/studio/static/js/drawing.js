// Drawing of points, names, the frame with its handles, and the loupe.

import { drawContours, drawEllipses } from "./overlays.js";
import { frameOf } from "./gestures.js";

// Colours for any picture: yellow is placed, blue is proposed, white is selected.
export const COLOURS = {
  placed: "#ffd166", proposed: "#6fd3ff", chosen: "#ffffff", rim: "rgb(0 0 0 / 65%)", axis: "#ff7ab8",
};
const LOUPE = 62; // css pixels, radius
const MAGNIFIED = 4;

function pathOf(ctx, viewer, points, indices, radius) {
  ctx.beginPath();
  for (const i of indices) {
    const [x, y] = viewer.toScreen(points[i]);
    ctx.moveTo(x + radius, y);
    ctx.arc(x, y, radius, 0, 2 * Math.PI);
  }
}

function outlined(ctx, colour, width, dash = []) {
  ctx.setLineDash([]);
  ctx.strokeStyle = COLOURS.rim;
  ctx.lineWidth = width + 2;
  ctx.stroke();
  ctx.setLineDash(dash);
  ctx.strokeStyle = colour;
  ctx.lineWidth = width;
  ctx.stroke();
  ctx.setLineDash([]);
}

/** Draw all points. A few paths serve all of them, so that hundreds are as fast as ten. */
export function drawMarks(ctx, viewer, view) {
  const { points, invisible, selection, active = -1, hovered = -1, suggested, radius = 4 } = view;
  const colour = suggested ? COLOURS.proposed : COLOURS.placed;
  const [filled, hollow, chosen] = [[], [], []];
  points.forEach((point, i) => {
    if (!point) return;
    (invisible.has(i) || suggested ? hollow : filled).push(i);
    if (selection.has(i)) chosen.push(i);
  });
  pathOf(ctx, viewer, points, filled, radius);
  ctx.fillStyle = colour;
  ctx.fill();
  ctx.lineWidth = 1.5;
  ctx.strokeStyle = COLOURS.rim;
  ctx.stroke();
  pathOf(ctx, viewer, points, hollow, radius);
  if (suggested) {
    // transparent, so that the picture can be checked through it
    ctx.fillStyle = "rgb(111 211 255 / 35%)";
    ctx.fill();
  }
  outlined(ctx, colour, 1.5);
  pathOf(ctx, viewer, points, chosen, radius + 3.5);
  outlined(ctx, COLOURS.chosen, 1.8);
  for (const i of [hovered, active]) {
    if (i < 0 || !points[i]) continue;
    pathOf(ctx, viewer, points, [i], radius + 6.5);
    outlined(ctx, colour, 1.5);
  }
}

export function drawPaths(ctx, viewer, points, contours, suggested) {
  const colour = suggested ? COLOURS.proposed : COLOURS.placed;
  ctx.globalAlpha = 0.85;
  drawContours(ctx, viewer, points, contours, { colour, width: 1.3, dash: suggested ? [5, 4] : [] });
  ctx.globalAlpha = 1;
}

export function drawSpread(ctx, viewer, points, covariances) {
  drawEllipses(ctx, viewer, points, covariances, { colour: COLOURS.proposed, width: 1.1 });
}

export function drawText(ctx, text, x, y, { colour = "#fff", align = "left" } = {}) {
  ctx.font = "600 12px system-ui, sans-serif";
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
  const { clientWidth, clientHeight } = viewer.canvas;
  for (const i of indices) {
    if (!points[i]) continue;
    const [x, y] = viewer.toScreen(points[i]);
    if (x < -100 || y < 0 || x > clientWidth || y > clientHeight) continue;
    drawText(ctx, names[i], x + 9, y - 9);
  }
}

export function drawFrame(ctx, viewer, points, indices) {
  const frame = frameOf(viewer, points, indices);
  if (frame === null) return;
  const [x0, y0, x1, y1] = frame.box;
  ctx.beginPath();
  ctx.rect(x0, y0, x1 - x0, y1 - y0);
  ctx.moveTo((x0 + x1) / 2, y0);
  ctx.lineTo(...frame.handles[4].at);
  ctx.moveTo((x0 + x1) / 2, y1);
  ctx.lineTo(...frame.handles[5].at);
  outlined(ctx, "rgb(255 255 255 / 80%)", 1, [4, 3]);
  for (const {
    kind, at: [x, y],
  } of frame.handles) {
    ctx.beginPath();
    if (kind === "scale") ctx.rect(x - 5, y - 5, 10, 10);
    else ctx.arc(x, y, 9, 0, 2 * Math.PI);
    ctx.fillStyle = "#fff";
    ctx.fill();
    ctx.strokeStyle = COLOURS.rim;
    ctx.lineWidth = 1.5;
    ctx.stroke();
    if (kind !== "scale") drawSign(ctx, kind, x, y);
  }
}

function drawSign(ctx, kind, x, y) {
  ctx.beginPath();
  if (kind === "turn") {
    ctx.arc(x, y, 4.5, -0.4 * Math.PI, 1.1 * Math.PI);
    ctx.moveTo(x + 4, y - 6.5);
    ctx.lineTo(x + 1, y - 4.4);
    ctx.lineTo(x + 4, y - 2);
  } else {
    for (const [dx, dy] of [
      [1, 0], [-1, 0], [0, 1], [0, -1],
    ]) {
      ctx.moveTo(x, y);
      ctx.lineTo(x + 6 * dx, y + 6 * dy);
      ctx.moveTo(x + 6 * dx - 2 * (dx || dy), y + 6 * dy - 2 * (dy || dx));
      ctx.lineTo(x + 6 * dx, y + 6 * dy);
      ctx.lineTo(x + 6 * dx - 2 * (dx || -dy), y + 6 * dy - 2 * (dy || -dx));
    }
  }
  ctx.strokeStyle = "#222";
  ctx.lineWidth = 1.4;
  ctx.stroke();
}

export function drawBox(ctx, viewer, [x0, y0, x1, y1]) {
  const [a, b] = [viewer.toScreen([x0, y0]), viewer.toScreen([x1, y1])];
  ctx.beginPath();
  ctx.rect(a[0], a[1], b[0] - a[0], b[1] - a[1]);
  ctx.fillStyle = "rgb(255 255 255 / 12%)";
  ctx.fill();
  outlined(ctx, "#fff", 1, [4, 3]);
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

/** Draw the surroundings of `xy` magnified, with a cross at the point. */
export function drawLoupe(ctx, viewer, xy, pointer, colour = COLOURS.placed) {
  const { clientWidth: width, clientHeight: height } = viewer.canvas;
  if (!viewer.source || width < 200 || height < 200) return;
  const [cx, cy] = loupePlace(pointer.at, pointer.type, width, height);
  const scale = Math.min(Math.max(viewer.scale * MAGNIFIED, 2), 24);
  ctx.save();
  ctx.beginPath();
  ctx.arc(cx, cy, LOUPE, 0, 2 * Math.PI);
  ctx.fillStyle = "#1b2030";
  ctx.fill();
  ctx.clip();
  // The whole picture is drawn and clipped, so that the resolution of the source does not matter.
  ctx.imageSmoothingEnabled = scale < 6;
  ctx.drawImage(
    viewer.source,
    cx - scale * (xy[0] + 0.5),
    cy - scale * (xy[1] + 0.5),
    scale * viewer.width,
    scale * viewer.height,
  );
  ctx.beginPath();
  for (const [dx, dy] of [
    [1, 0], [-1, 0], [0, 1], [0, -1],
  ]) {
    ctx.moveTo(cx + 6 * dx, cy + 6 * dy);
    ctx.lineTo(cx + 22 * dx, cy + 22 * dy);
  }
  outlined(ctx, colour, 1.4);
  ctx.beginPath();
  ctx.arc(cx, cy, 1.4, 0, 2 * Math.PI);
  ctx.fillStyle = colour;
  ctx.fill();
  ctx.restore();
  ctx.beginPath();
  ctx.arc(cx, cy, LOUPE, 0, 2 * Math.PI);
  ctx.strokeStyle = COLOURS.rim;
  ctx.lineWidth = 5;
  ctx.stroke();
  ctx.strokeStyle = "#fff";
  ctx.lineWidth = 2.5;
  ctx.stroke();
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
  const xs = layout.filter(Boolean).map((p) => p[0]);
  const ys = layout.filter(Boolean).map((p) => p[1]);
  const [x0, x1, y0, y1] = [Math.min(...xs), Math.max(...xs), Math.min(...ys), Math.max(...ys)];
  const scale = Math.min((width - 20) / Math.max(x1 - x0, 1), (height - 20) / Math.max(y1 - y0, 1));
  const at = ([x, y]) => [width / 2 + scale * (x - (x0 + x1) / 2), height / 2 + scale * (y - (y0 + y1) / 2)];
  ctx.strokeStyle = style.getPropertyValue("--muted");
  ctx.fillStyle = style.getPropertyValue("--muted");
  ctx.lineWidth = 1.2;
  ctx.globalAlpha = 0.7;
  ctx.beginPath();
  for (const { indices, closed } of contours) {
    indices.filter((i) => layout[i]).forEach((i, k) => ctx[k ? "lineTo" : "moveTo"](...at(layout[i])));
    if (closed) ctx.closePath();
  }
  ctx.stroke();
  ctx.beginPath();
  layout.forEach((p) => {
    if (p) {
      const [x, y] = at(p);
      ctx.moveTo(x + 1.8, y);
      ctx.arc(x, y, 1.8, 0, 2 * Math.PI);
    }
  });
  ctx.fill();
  ctx.globalAlpha = 1;
  if (!layout[lit]) return;
  const [x, y] = at(layout[lit]);
  ctx.beginPath();
  ctx.arc(x, y, 5, 0, 2 * Math.PI);
  ctx.fillStyle = style.getPropertyValue("--accent");
  ctx.fill();
  ctx.strokeStyle = style.getPropertyValue("--panel");
  ctx.lineWidth = 1.5;
  ctx.stroke();
}
