// The line between before and after. It is dragged, or moved with the arrow keys.

import { h } from "./ui.js";

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
    this.share = 0.5;
    this._onmove = onmove;
    this._before = h("span", { class: "fit-divider-label before" });
    this._after = h("span", { class: "fit-divider-label after" });
    this.element = h(
      "div",
      {
        class: "fit-divider", role: "slider", tabindex: "0", hidden: true, "aria-orientation": "horizontal",
        "aria-valuemin": "0", "aria-valuemax": "100", dataset: { testid },
      },
      h("span", { class: "fit-divider-line" }),
      h("span", { class: "fit-divider-grip", "aria-hidden": "true" }, "‹ ›"),
      this._before, this._after,
    );
    viewer.container.append(this.element);
    this.element.addEventListener("pointerdown", (event) => this._down(event));
    this.element.addEventListener("pointermove", (event) => this._move(event));
    this.element.addEventListener("keydown", (event) => this._key(event));
    this._show();
  }

  get visible() {
    return !this.element.hidden;
  }

  set visible(now) {
    this.element.hidden = !now;
  }

  /** Position of the line in the canvas, css pixels. */
  get x() {
    return this.share * this.viewer.container.clientWidth;
  }

  label(before, after) {
    this._before.textContent = before;
    this._after.textContent = after;
    this.element.setAttribute("aria-label", `Divider between ${before.toLowerCase()} and ${after.toLowerCase()}`);
  }

  set(share) {
    this.share = Math.min(1, Math.max(0, share));
    this._show();
    this._onmove();
  }

  _show() {
    const percent = Math.round(100 * this.share);
    this.element.style.left = `${100 * this.share}%`;
    this.element.setAttribute("aria-valuenow", String(percent));
    this.element.setAttribute("aria-valuetext", `${percent} % of the width`);
    // Near an edge there is no room for the label on that side.
    this._before.hidden = this.share < 0.08;
    this._after.hidden = this.share > 0.92;
  }

  _down(event) {
    if (event.button !== 0) return;
    this.element.setPointerCapture(event.pointerId);
    this.element.focus({ preventScroll: true });
    event.preventDefault();
    event.stopPropagation();
  }

  _move(event) {
    if (!this.element.hasPointerCapture(event.pointerId)) return;
    this.set(this.viewer.place(event)[0] / this.viewer.container.clientWidth);
  }

  _key(event) {
    const next = shareAfterKey(this.share, event);
    if (next === null) return;
    event.preventDefault();
    event.stopPropagation();
    this.set(next);
  }
}
