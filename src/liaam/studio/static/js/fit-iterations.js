// The iterations of a fit: a slider, a play button, and a plot of the cost.

import { significant } from "./fit-run.js";
import { indicesOf } from "./points.js";
import { button, h, icon, slider, svg } from "./ui.js";

// Of the plot, in its units, which are css pixels unless the panel is narrower.
const WIDTH = 264;
const HEIGHT = 58;
const MARGIN = 6;
const ROOM_FOR_NAME = 36; // width of a level above which its name fits into it
const STEP = 140; // milliseconds per iteration while playing
const PRIMARY_BUTTON = 1; // as MouseEvent.buttons counts

export class Iterations {
  /** @type {Iteration[]} */
  #iterations = [];
  #index = 0;
  #timer = null;
  #onmove;
  // Elements.
  #player; #plot; #slider; #text;
  #thetaChanges = false;
  #points = []; // of the plot, one for each iteration
  #cursor; // marks of the plot at the shown iteration
  #dot;

  constructor(onmove) {
    this.#onmove = onmove;
    this.#slider = slider({
      min: "0", max: "0", value: "0", "aria-label": "Iteration", testid: "fit-iterations",
      oninput: () => this.step(Number(this.#slider.value) - this.#index),
    });
    this.#player = button("Play the iterations", {
      icon: "play", iconOnly: true, small: true, shortcut: "P", testid: "fit-play", onclick: () => this.toggle(),
    });
    this.#text = h("p.small.muted.fit-iteration-text");
    this.#plot = svg("svg", {
      viewBox: `0 0 ${WIDTH} ${HEIGHT}`, class: "fit-plot", role: "img", "aria-label": "Cost by iteration",
    });
    this.#plot.addEventListener("pointerdown", (event) => this.#pick(event));
    this.#plot.addEventListener("pointermove", (event) => {
      if (event.buttons & PRIMARY_BUTTON) this.#pick(event);
    });
    this.element = h("div.column.fit-iterations",
      this.#plot, h("div.row.fit-play-row", this.#player, this.#slider), this.#text);
    this.show([]);
  }

  get #last() { return this.#iterations.length - 1; }

  /** @param {Iteration[]} iterations */
  show(iterations) {
    this.pause();
    this.#iterations = iterations;
    this.#index = Math.max(0, this.#last);
    // Methods that do not estimate the angle keep it constant.
    this.#thetaChanges = iterations.some(({ theta_deg: theta }) => theta !== iterations[0].theta_deg);
    this.#slider.max = String(Math.max(0, this.#last));
    const isSingle = iterations.length < 2;
    this.#slider.disabled = isSingle;
    this.#player.disabled = isSingle;
    this.#draw();
    this.#mark();
  }

  #go(index) {
    if (!this.#iterations.length) return;
    this.#index = Math.min(Math.max(index, 0), this.#last);
    this.#mark();
    this.#onmove(this.#index, this.#index === this.#last);
  }

  step(by) {
    this.pause();
    this.#go(this.#index + by);
  }

  toggle() {
    if (this.#timer) return this.pause();
    if (this.#iterations.length < 2) return;
    if (this.#index === this.#last) this.#go(0);
    this.#playBy(setInterval(() => {
      this.#go(this.#index + 1);
      if (this.#index === this.#last) this.pause();
    }, STEP));
  }

  pause() { this.#playBy(null); }

  /** Play by a timer instead of the one before; null: pause. */
  #playBy(timer) {
    clearInterval(this.#timer);
    this.#timer = timer;
    this.#player.replaceChildren(icon(timer ? "pause" : "play"));
    this.#player.setAttribute("aria-label", timer ? "Pause" : "Play the iterations");
  }

  /** Place of an iteration in the plot; a single one is in the middle. */
  #across(i) {
    const share = this.#last > 0 ? i / this.#last : 0.5;
    return MARGIN + share * (WIDTH - 2 * MARGIN);
  }

  #draw() {
    const heightOf = (cost) => MARGIN + (1 - cost) * (HEIGHT - 2 * MARGIN);
    this.#points = relativeCosts(this.#iterations).map((cost, i) => [this.#across(i), heightOf(cost)]);
    this.#cursor = svg("line", { class: "cursor", y1: 0, y2: HEIGHT });
    this.#dot = svg("circle", { class: "dot-now", r: 3.5 });
    const dots = this.#points.map(([cx, cy]) => svg("circle", { cx, cy, r: 1.6, class: "cost-point" }));
    const now = dots.length ? [this.#cursor, this.#dot] : [];
    this.#plot.replaceChildren(...dots, ...this.#drawnLevels(), ...now);
  }

  /** For each level its left edge, the line of its costs, and its name. */
  #drawnLevels() {
    const iterations = this.#iterations;
    const starts = indicesOf(iterations).filter((i) => iterations[i].level !== iterations[i - 1]?.level);
    const leftEdges = starts.map((i) => (i === 0 ? -1 : this.#across(i - 0.5))); // the first is out of sight
    return starts.flatMap((start, k) => {
      const left = leftEdges[k];
      const right = leftEdges[k + 1] ?? WIDTH;
      const isNamed = starts.length > 1 && right - left > ROOM_FOR_NAME;
      return [
        svg("line", { class: "between", x1: left, x2: left, y1: 0, y2: HEIGHT }),
        svg("polyline", { points: this.#points.slice(start, starts[k + 1]).join(" "), class: "cost" }),
        // Costs decrease, so the top right of each level is free.
        svg("text", { x: right - 5, y: 12, class: "level", "text-anchor": "end" },
          isNamed ? `level ${iterations[start].level}` : ""),
      ];
    });
  }

  #mark() {
    this.#slider.value = String(this.#index);
    const now = this.#iterations[this.#index];
    this.#text.textContent = "The iterations of a fit appear here.";
    if (!now) return;
    const [x, y] = this.#points[this.#index];
    this.#cursor.setAttribute("transform", `translate(${x} 0)`);
    this.#dot.setAttribute("transform", `translate(${x} ${y})`);
    const hasTheta = now.theta_deg != null && this.#thetaChanges;
    const theta = hasTheta ? ` · θ ${now.theta_deg.toFixed(1)}°` : "";
    const text = `${this.#index} of ${this.#last} · level ${now.level} · cost ${significant(now.cost)}${theta}`;
    this.#text.textContent = text;
    this.#slider.setAttribute("aria-valuetext", `iteration ${text}`);
  }

  #pick({ clientX }) {
    const { left, width } = this.#plot.getBoundingClientRect();
    const share = (((clientX - left) / width) * WIDTH - MARGIN) / (WIDTH - 2 * MARGIN);
    this.step(Math.round(share * this.#last) - this.#index);
  }
}

/** Cost of each iteration from 0 to 1, within its level, since costs of other levels are not comparable.
 *  @param {Iteration[]} iterations */
export function relativeCosts(iterations) {
  return iterations.map(({ level, cost }) => {
    const ofLevel = iterations.filter((other) => other.level === level);
    const costs = ofLevel.map((other) => other.cost).filter(Number.isFinite);
    const low = Math.min(...costs);
    const high = Math.max(...costs);
    return high > low && Number.isFinite(cost) ? (cost - low) / (high - low) : 0;
  });
}
