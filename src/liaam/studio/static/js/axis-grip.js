// The axis of symmetry over the picture. It is dragged by a grip near the top, since clicks elsewhere on the line place
// points.

import { COLOURS, drawText } from "./drawing.js";

const REACH = 20; // css pixels

export class AxisGrip {
  /** x: of the axis, in pixels of the picture. */
  constructor(viewer, x) {
    this.viewer = viewer;
    const top = viewer.toScreen([0, 0])[1];
    this.at = [viewer.toScreen([x, 0])[0], Math.min(Math.max(top, 0) + 16, viewer.container.clientHeight - 16)];
  }

  /** Whether a position in the picture lies under the grip. */
  isAt(xy) {
    const [x, y] = this.viewer.toScreen(xy);
    return Math.hypot(x - this.at[0], y - this.at[1]) <= REACH;
  }

  draw(ctx) {
    const [x, y] = this.at;
    ctx.beginPath();
    ctx.moveTo(x, 0);
    ctx.lineTo(x, this.viewer.container.clientHeight);
    ctx.setLineDash([8, 5]);
    ctx.strokeStyle = COLOURS.axis;
    ctx.lineWidth = 1.5;
    ctx.stroke();
    ctx.setLineDash([]);
    ctx.beginPath();
    ctx.arc(x, y, 11, 0, 2 * Math.PI);
    ctx.fillStyle = COLOURS.axis;
    ctx.fill();
    drawText(ctx, "⇔", x, y, { align: "center" });
  }
}
