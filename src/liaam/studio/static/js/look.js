// Brightness, contrast and gamma of the shown pictures. They change what is drawn, never the pictures or their fits,
// and are kept in the browser for each folder.

import { button, h, icon, labelledSlider } from "./ui.js";
import { attempt } from "./unsaved.js";

const NEUTRAL = { brightness: 0, contrast: 0, gamma: 0 }; // powers of two
const LABELS = { brightness: "Brightness", contrast: "Contrast", gamma: "Gamma" };
const LIMIT = 2;

export function shownValue(value, { brightness, contrast, gamma }) {
  const bright = (value * 2 ** brightness) ** (2 ** -gamma);
  return Math.min(1, Math.max(0, (bright - 0.5) * 2 ** contrast + 0.5));
}

class Look extends EventTarget {
  values = NEUTRAL;
  _holder = null; // of the filter, which is an SVG element of the page

  open(folder) {
    this._key = `liaam-look:${folder}`;
    this.set({ ...NEUTRAL, ...attempt(() => JSON.parse(localStorage.getItem(this._key))) });
  }

  set(values) {
    this.values = values;
    this._paint();
    attempt(() => localStorage.setItem(this._key, JSON.stringify(values)));
    this.dispatchEvent(new Event("change"));
  }

  get isNeutral() { return Object.values(this.values).every((value) => value === 0); }

  get filter() { return this.isNeutral ? "none" : "url(#look)"; }

  _paint() {
    const table = Array.from({ length: 256 }, (_, i) => shownValue(i / 255, this.values).toFixed(4)).join(" ");
    const curves = ["R", "G", "B"].map((channel) => `<feFunc${channel} type="table" tableValues="${table}"/>`).join("");
    this._holder ??= document.body.appendChild(h("div.visually-hidden", { "aria-hidden": "true" }));
    this._holder.innerHTML = `<svg><filter id="look" color-interpolation-filters="sRGB">
      <feComponentTransfer>${curves}</feComponentTransfer></filter></svg>`;
  }

  _follow(show) {
    this.addEventListener("change", show);
    show();
  }

  control() {
    const rows = Object.entries(LABELS).map(([name, label]) => {
      const { element, show } = labelledSlider(label, (value) => this.set({ ...this.values, [name]: value }), {
        min: String(-LIMIT), max: String(LIMIT), step: "0.05", "aria-label": label, testid: `look-${name}`,
      });
      this._follow(() => show(this.values[name], `×${(2 ** this.values[name]).toFixed(2)}`));
      return element;
    });
    const reset = button("Reset", { small: true, testid: "look-reset", onclick: () => this.set(NEUTRAL) });
    const face = h("summary.button.ghost.small.icon-only", {
      "aria-label": "Brightness and contrast", "aria-keyshortcuts": "A", title: "Brightness, contrast, gamma (A)",
      testid: "look",
    }, icon("adjust"));
    this._follow(() => face.classList.toggle("on", !this.isNeutral));
    const foot = h("div.row", h("p.small.muted.grow", "Only for looking"), reset);
    const onkeydown = (event) => {
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
