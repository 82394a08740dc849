// Drawing over pictures. Lines have a dark rim to be visible on any picture.

export const RIM = "rgb(0 0 0 / 60%)";
const CHI = Math.sqrt(-2 * Math.log(1 - 0.95)); // radius of a 95 % ellipse, standard deviations

export function inked(ctx, colour, width, dash = []) {
  ctx.setLineDash(dash);
  ctx.strokeStyle = colour;
  ctx.lineWidth = width;
  ctx.stroke();
  ctx.setLineDash([]);
}

export function stroked(ctx, colour, width, dash = []) {
  ctx.lineJoin = "round";
  inked(ctx, RIM, width + 1.8, dash);
  inked(ctx, colour, width, dash);
}

/** Make a path of chains of places on the screen: [[x, y], ...] each. */
export function lines(ctx, chains) {
  ctx.beginPath();
  for (const chain of chains) chain.forEach(([x, y], i) => ctx[i ? "lineTo" : "moveTo"](x, y));
}

export function filled(ctx, colour) {
  ctx.fillStyle = colour;
  ctx.fill();
}

export function drawContours(ctx, viewer, points, contours, { colour = "#ffd166", width = 1.6, dash = [] } = {}) {
  contourPath(ctx, viewer, points, contours);
  stroked(ctx, colour, width, dash);
}

/** Make a path of the contours without the segments at missing points.
 *  @param {CanvasRenderingContext2D} ctx; @param {any} viewer; @param {Point[]} points; @param {Contour[]} contours */
export function contourPath(ctx, viewer, points, contours) {
  ctx.beginPath();
  for (const { indices, closed } of contours) {
    let pen = "moveTo";
    for (const index of closed ? [...indices, indices[0]] : indices) {
      if (points[index]) ctx[pen](...viewer.toScreen(points[index]));
      pen = points[index] ? "lineTo" : "moveTo";
    }
  }
}

/** Draw points, all in one path, so that hundreds are as fast as ten. */
export function drawPoints(ctx, viewer, points, { colour = "#ffd166", radius = 4 } = {}) {
  discs(ctx, viewer, points, radius);
  filled(ctx, colour);
  inked(ctx, RIM, 1.4);
}

/** Make a path of a circle around each point; null has none. */
export function discs(ctx, viewer, points, radius) {
  ctx.beginPath();
  for (const point of points) {
    if (!point) continue;
    const [x, y] = viewer.toScreen(point);
    ctx.moveTo(x + radius, y);
    ctx.arc(x, y, radius, 0, 2 * Math.PI);
  }
}

/** Draw triangles. @param {CanvasRenderingContext2D} ctx; @param {any} viewer; @param {Point[]} points; @param {Model["triangles"]} triangles */
export function drawMesh(ctx, viewer, points, triangles, { colour = "rgb(255 255 255 / 70%)", width = 1 } = {}) {
  const at = points.map((point) => point && viewer.toScreen(point));
  const whole = triangles.filter((corners) => corners.every((i) => at[i]));
  lines(ctx, whole.map(([a, b, c]) => [at[a], at[b], at[c], at[a]]));
  inked(ctx, colour, width);
}

export function drawEllipses(ctx, viewer, points, covariances, { colour = "#5ad1ff", width = 1.3 } = {}) {
  ctx.beginPath();
  points.forEach((point, i) => {
    const covariance = covariances?.[i];
    if (!point || !covariance) return;
    const [[a, b], [, c]] = covariance;
    const spread = Math.hypot((a - c) / 2, b);
    const turn = (viewer.mirrored ? -0.5 : 0.5) * Math.atan2(2 * b, a - c);
    const [x, y] = viewer.toScreen(point);
    const [major, minor] = [(a + c) / 2 + spread, (a + c) / 2 - spread].map((variance) =>
      Math.min(CHI * Math.sqrt(Math.max(variance, 0)) * viewer.scale, 1e4));
    ctx.moveTo(x + major * Math.cos(turn), y + major * Math.sin(turn));
    ctx.ellipse(x, y, major, minor, turn, 0, 2 * Math.PI);
  });
  stroked(ctx, colour, width);
}
