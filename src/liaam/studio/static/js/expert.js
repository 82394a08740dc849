// Whether the page shows what only people who study the fitting need: methods and their comparison, residuals, iterations
// with their levels and costs, and the angle of the invariant image. The browser remembers it.

import { h } from "./ui.js";
import { attempt } from "./unsaved.js";

const KEY = "liaam-studio:expert";

/** Tells listeners of "change" that parts of the page are to be shown or hidden. */
class Expert extends EventTarget {
  #on = attempt(() => localStorage.getItem(KEY)) === "on";

  get on() { return this.#on; }

  turn(on) {
    this.#on = on;
    attempt(() => localStorage.setItem(KEY, on ? "on" : "off"));
    this.dispatchEvent(new Event("change"));
  }

  /** Call `show` now, and after each change. */
  follow(show) {
    this.addEventListener("change", show);
    show();
  }

  /** The box that turns it on and off. */
  control() {
    const box = h("input", { type: "checkbox", testid: "expert", onchange: () => this.turn(box.checked) });
    this.follow(() => { box.checked = this.on; });
    const what = "Show methods, residual and invariant image, iterations, and the tab Compare if the model knows several methods";
    return h("label.check.small", { title: what }, box, "Expert");
  }
}

export const expert = new Expert();
