// The line between before and after. It is dragged, or moved with the arrow keys.

import { grip, h } from "./ui.js";

/** Position of the line, as a fraction of the width, after a key; null for other keys. */
export function shareAfterKey(share, { key, shiftKey = false }) {
  const step = shiftKey ? 0.1 : 0.02;
  const next = { ArrowLeft: share - step, ArrowRight: share + step, Home: 0, End: 1 }[key];
  return next === undefined ? null : Math.min(1, Math.max(0, next));
}

export class Divider {
  /** `onmove` is called when the line has moved; `testid` tells the dividers of the tabs apart. */
  constructor(viewer, onmove, testid = "divider") {
    this.viewer = viewer;
    this._onmove = onmove;
    this._before = h("span.fit-divider-label.before");
    this._after = h("span.fit-divider-label.after");
    this.element = grip("div.fit-divider", {
      hidden: true, "aria-orientation": "horizontal", "aria-valuemin": "0", "aria-valuemax": "100", testid,
      onmove: (event) => this._set(viewer.place(event)[0] / viewer.container.clientWidth),
      onkey: (event) => {
        const next = shareAfterKey(this.share, event);
        if (next !== null) this._set(next);
        return next !== null;
      },
    },
    h("span.fit-divider-line"), h("span.fit-divider-grip", { "aria-hidden": "true" }, "‹ ›"),
    this._before, this._after);
    viewer.container.append(this.element);
    this._set(0.5);
  }

  get x() { return this.share * this.viewer.container.clientWidth; }

  label(before, after) {
    this._before.textContent = before;
    this._after.textContent = after;
    this.element.setAttribute("aria-label", `Divider between ${before.toLowerCase()} and ${after.toLowerCase()}`);
  }

  _set(share) {
    this.share = Math.min(1, Math.max(0, share));
    const percent = Math.round(100 * this.share);
    this.element.style.left = `${100 * this.share}%`;
    this.element.setAttribute("aria-valuenow", String(percent));
    this.element.setAttribute("aria-valuetext", `${percent} % of the width`);
    // Near an edge there is no room for the label on that side.
    this._before.hidden = this.share < 0.08;
    this._after.hidden = this.share > 0.92;
    this._onmove();
  }
}
