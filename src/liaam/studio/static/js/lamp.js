// A lamp on a picture: its direction, as a place over a ball around the object. It is dragged, or moved with the arrow
// keys. The parent element is as large as the ball, or `middle` says where in it the ball is.

import { directionAfterKey, directionAt, directionInWords } from "./fit-geometry.js";
import { grip } from "./ui.js";

/** onmove(direction). Further attributes are those of the element. */
export class LampHandle {
  direction = [0, 0, 1];

  constructor({ onmove, middle = [0.5, 0.5], ...attributes }) {
    this.middle = middle;
    this._onmove = onmove;
    this.element = grip("div.lamp", {
      "aria-roledescription": "movable lamp", "aria-valuemin": "0", "aria-valuemax": "90",
      onkey: (event) => this.key(event), onmove: (event) => onmove(this.at(event)), ...attributes,
    });
  }

  /** Direction to a place on the page. */
  at({ clientX, clientY }) {
    const { left, top, width, height } = this.element.parentElement.getBoundingClientRect();
    const [u, v] = this.middle;
    return directionAt([(2 * (clientX - left)) / width - 2 * u, (2 * (clientY - top)) / height - 2 * v]);
  }

  show(direction) {
    this.direction = direction;
    const [x, y, z] = direction;
    this.element.style.left = `${100 * (this.middle[0] + x / 2)}%`;
    this.element.style.top = `${100 * (this.middle[1] + y / 2)}%`;
    this.element.setAttribute("aria-valuetext", directionInWords(direction));
    this.element.setAttribute("aria-valuenow", String(Math.round((Math.acos(Math.min(z, 1)) * 180) / Math.PI)));
  }

  /** Move by an arrow key; return whether it was one. */
  key(event) {
    const next = directionAfterKey(this.direction, event);
    if (next) this._onmove(next);
    return next !== null;
  }
}
