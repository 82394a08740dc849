// Brightness, contrast and gamma of the shown pictures. They change what is drawn, never the pictures or their fits,
// and are kept in the browser for each folder.

import { button, h, icon, labelledSlider } from "./ui.js";
import { attempt } from "./unsaved.js";

const NEUTRAL = { brightness: 0, contrast: 0, gamma: 0 }; // exponents of 2, so that 0 changes nothing
const LABELS = { brightness: "Brightness", contrast: "Contrast", gamma: "Gamma" };
const LIMIT = 2; // largest exponent of a slider: from a quarter to four times

const ABOUT = "For looking only, in all pictures of this folder: files and fits are not changed";

const factorOf = (/** @type {number} */ exponent) => `×${(2 ** exponent).toFixed(2)}`;

/** How a stored value of a picture is shown, both 0 to 1: brightness is a factor, gamma a power, and contrast a factor
 *  about middle grey. */
export function shownValue(value, { brightness, contrast, gamma }) {
  const bright = (value * 2 ** brightness) ** (2 ** -gamma);
  return Math.min(1, Math.max(0, (bright - 0.5) * 2 ** contrast + 0.5));
}

/** The settings of the page. Tells listeners of "change" that pictures have to be drawn again. */
class Look extends EventTarget {
  #values = NEUTRAL;
  #holder = null; // element that holds the filter, an SVG element that has to be part of the page
  #key = "";

  get values() { return this.#values; }

  /** Take the settings that were used last for a folder, by its id. */
  open(folder) {
    this.#key = `liaam-look:${folder}`;
    this.set({ ...NEUTRAL, ...attempt(() => JSON.parse(localStorage.getItem(this.#key))) });
  }

  set(values) {
    this.#values = values;
    this.#paint();
    attempt(() => localStorage.setItem(this.#key, JSON.stringify(values)));
    this.dispatchEvent(new Event("change"));
  }

  get isNeutral() { return Object.values(this.values).every((value) => value === 0); }

  /** Value of `filter`, of a canvas or in CSS. */
  get filter() { return this.isNeutral ? "none" : "url(#look)"; }

  /** Write the filter: a table of the 256 values of each channel, which are not converted to linear light. */
  #paint() {
    const table = Array.from({ length: 256 }, (_, i) => shownValue(i / 255, this.values).toFixed(4)).join(" ");
    const curves = ["R", "G", "B"].map((channel) => `<feFunc${channel} type="table" tableValues="${table}"/>`).join("");
    this.#holder ??= document.body.appendChild(h("div.visually-hidden", { "aria-hidden": "true" }));
    this.#holder.innerHTML = `<svg><filter id="look" color-interpolation-filters="sRGB">
      <feComponentTransfer>${curves}</feComponentTransfer></filter></svg>`;
  }

  /** What is changed, in words: "brightness ×1.32, gamma ×0.50"; "" if nothing. */
  get words() {
    const changed = Object.keys(LABELS).filter((name) => this.values[name] !== 0);
    return changed.map((name) => `${LABELS[name].toLowerCase()} ${factorOf(this.values[name])}`).join(", ");
  }

  /** What says over a picture that it is not shown as it is, and resets that. It holds for all pictures. */
  notice() {
    const text = h("span");
    const element = h("div.look-notice.glass", { role: "status", title: ABOUT, testid: "look-notice" }, text,
      button("Reset", { small: true, title: "Show pictures as they are", testid: "look-off", onclick: () => this.set(NEUTRAL) }));
    this.#follow(() => {
      element.hidden = this.isNeutral;
      text.textContent = this.isNeutral ? "" : `Shown with ${this.words}`;
    });
    return element;
  }

  /** Call `show` now, and after each change. */
  #follow(show) {
    this.addEventListener("change", show);
    show();
  }

  /** A button that opens a box with a slider for each setting. Each view has one; all show the same settings. */
  control() {
    const rows = Object.entries(LABELS).map(([name, label]) => {
      const { element, show } = labelledSlider(label, (value) => this.set({ ...this.values, [name]: value }), {
        min: String(-LIMIT), max: String(LIMIT), step: "0.05", "aria-label": label, testid: `look-${name}`,
      });
      this.#follow(() => show(this.values[name], factorOf(this.values[name])));
      return element;
    });
    const reset = button("Reset", { small: true, testid: "look-reset", onclick: () => this.set(NEUTRAL) });
    const face = h("summary.button.ghost.small.icon-only", {
      "aria-label": "Brightness and contrast", "aria-keyshortcuts": "A", title: "Brightness, contrast, gamma (A)",
      testid: "look",
    }, icon("adjust"));
    this.#follow(() => face.classList.toggle("on", !this.isNeutral));
    const foot = h("div.row", h("p.small.muted.grow", "Only for looking"), reset);
    const onkeydown = (event) => {
      // Arrows move a slider, and Escape closes the box. The page must not move or deselect points as well.
      if (event.key.startsWith("Arrow") || event.key === "Escape") event.stopPropagation();
      if (event.key !== "Escape") return;
      box.open = false;
      face.focus();
    };
    const box = h("details.look", { onkeydown }, face, h("div.look-box.glass", rows, foot));
    return box;
  }
}

export const look = new Look();
