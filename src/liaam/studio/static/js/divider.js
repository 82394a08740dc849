// The line between before and after. It is dragged, or moved with the arrow keys.

import { grip, h } from "./ui.js";

/** Position of the line, as a fraction of the width, after a key; null for other keys. */
export function shareAfterKey(share, { key, shiftKey = false }) {
  const step = shiftKey ? 0.1 : 0.02;
  const next = { ArrowLeft: share - step, ArrowRight: share + step, Home: 0, End: 1 }[key];
  return next === undefined ? null : Math.min(1, Math.max(0, next));
}

const BESIDE = 8; // css pixels between the line and a label

export class Divider {
  #viewer;
  #onmove;
  #share = 0.5; // position of the line, as a fraction of the width
  #before; // the labels
  #after;

  /** `onmove` is called when the line has moved; `testid` tells the dividers of the tabs apart. */
  constructor(viewer, onmove, testid = "divider") {
    this.#viewer = viewer;
    this.#onmove = onmove;
    this.#before = h("span.fit-divider-label.before");
    this.#after = h("span.fit-divider-label.after");
    this.element = grip("div.fit-divider", {
      hidden: true, "aria-orientation": "horizontal", "aria-valuemin": "0", "aria-valuemax": "100", testid,
      onmove: (event) => this.#set(viewer.place(event)[0] / viewer.container.clientWidth),
      onkey: (event) => {
        const next = shareAfterKey(this.#share, event);
        if (next !== null) this.#set(next);
        return next !== null;
      },
    },
    h("span.fit-divider-line"), h("span.fit-divider-grip", { "aria-hidden": "true" }, "‹ ›"),
    this.#before, this.#after);
    viewer.container.append(this.element);
    this.#set(0.5);
  }

  /** Put the line in the middle. */
  centre() { this.#set(0.5); }

  /** Position of the line in the container, css pixels. */
  get x() { return this.#share * this.#viewer.container.clientWidth; }

  show(on) {
    this.element.hidden = !on;
    if (on) this.#makeRoom();
  }

  label(before, after) {
    this.#before.textContent = before;
    this.#after.textContent = after;
    this.element.setAttribute("aria-label", `Divider between ${before.toLowerCase()} and ${after.toLowerCase()}`);
  }

  #set(share) {
    this.#share = Math.min(1, Math.max(0, share));
    const percent = Math.round(100 * this.#share);
    this.element.style.left = `${100 * this.#share}%`;
    this.element.setAttribute("aria-valuenow", String(percent));
    this.element.setAttribute("aria-valuetext", `${percent} % of the width`);
    this.#makeRoom();
    this.#onmove();
  }

  /** Near an edge there is no room for the label on that side. */
  #makeRoom() {
    const width = this.#viewer.container.clientWidth;
    const isCut = (label, room) => { label.style.visibility = room < label.offsetWidth + BESIDE ? "hidden" : ""; };
    isCut(this.#before, this.x);
    isCut(this.#after, width - this.x);
  }
}
