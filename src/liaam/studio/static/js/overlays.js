// Drawing over pictures. Lines have a dark rim to be visible on any picture.

const CHI = Math.sqrt(-2 * Math.log(1 - 0.95)); // radius of a 95 % ellipse, standard deviations

function stroked(ctx, colour, width, dash = []) {
  ctx.lineJoin = "round";
  ctx.setLineDash(dash);
  ctx.strokeStyle = "rgb(0 0 0 / 45%)";
  ctx.lineWidth = width + 1.6;
  ctx.stroke();
  ctx.strokeStyle = colour;
  ctx.lineWidth = width;
  ctx.stroke();
  ctx.setLineDash([]);
}

/** Draw contours without the segments at missing points. */
export function drawContours(ctx, viewer, points, contours, { colour = "#ffd166", width = 1.6, dash = [] } = {}) {
  ctx.beginPath();
  for (const { indices, closed } of contours) {
    const line = closed ? [...indices, indices[0]] : indices;
    let pen = false;
    for (const index of line) {
      const point = points[index];
      if (!point) { pen = false; continue; }
      const [x, y] = viewer.toScreen(point);
      if (pen) ctx.lineTo(x, y);
      else ctx.moveTo(x, y);
      pen = true;
    }
  }
  stroked(ctx, colour, width, dash);
}

/** Draw points: hollow if invisible, with a ring if selected. */
export function drawPoints(ctx, viewer, points, options = {}) {
  const { colour = "#ffd166", radius = 4, selected = new Set(), invisible = new Set(), hovered = -1 } = options;
  points.forEach((point, i) => {
    if (!point) return;
    const [x, y] = viewer.toScreen(point);
    ctx.beginPath();
    ctx.arc(x, y, i === hovered ? radius + 1.5 : radius, 0, 2 * Math.PI);
    ctx.lineWidth = 1.5;
    if (invisible.has(i)) {
      stroked(ctx, colour, 1.5);
    } else {
      ctx.fillStyle = selected.has(i) ? "#ffffff" : colour;
      ctx.fill();
      ctx.strokeStyle = "rgb(0 0 0 / 70%)";
      ctx.stroke();
    }
    if (!selected.has(i)) return;
    ctx.beginPath();
    ctx.arc(x, y, radius + 4, 0, 2 * Math.PI);
    stroked(ctx, "#5ad1ff", 2);
  });
}

export function drawMesh(ctx, viewer, points, triangles, { colour = "rgb(255 255 255 / 70%)", width = 1 } = {}) {
  const at = points.map((point) => point && viewer.toScreen(point));
  ctx.beginPath();
  for (const [a, b, c] of triangles) {
    if (!at[a] || !at[b] || !at[c]) continue;
    ctx.moveTo(...at[a]);
    ctx.lineTo(...at[b]);
    ctx.lineTo(...at[c]);
    ctx.closePath();
  }
  ctx.strokeStyle = colour;
  ctx.lineWidth = width;
  ctx.stroke();
}

/** Draw the 95 % confidence ellipse of each landmark. */
export function drawEllipses(ctx, viewer, points, covariances, { colour = "#5ad1ff", width = 1.3 } = {}) {
  points.forEach((point, i) => {
    const covariance = covariances?.[i];
    if (!point || !covariance) return;
    const { radii: [major, minor], turn } = ellipse(covariance);
    const [x, y] = viewer.toScreen(point);
    ctx.beginPath();
    ctx.ellipse(x, y, Math.min(major * viewer.scale, 1e4), Math.min(minor * viewer.scale, 1e4), turn, 0, 2 * Math.PI);
    stroked(ctx, colour, width);
  });
}

/** Radii and angle of the 95 % confidence ellipse of a Gaussian with covariance [[a, b], [b, c]]. */
export function ellipse([[a, b], [, c]]) {
  const middle = (a + c) / 2;
  const spread = Math.hypot((a - c) / 2, b);
  const radius = (variance) => CHI * Math.sqrt(Math.max(variance, 0));
  return { radii: [radius(middle + spread), radius(middle - spread)], turn: 0.5 * Math.atan2(2 * b, a - c) };
}
