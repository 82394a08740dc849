// The iterations of a fit: a slider, a play button, and a plot of the cost.

import { significant } from "./fit-run.js";
import { indicesOf } from "./points.js";
import { button, h, icon, slider, svg } from "./ui.js";

const [WIDTH, HEIGHT, MARGIN] = [264, 58, 6];
const STEP = 140; // milliseconds per iteration while playing

export class Iterations {
  iterations = [];
  index = 0;
  _timer = null;

  constructor(onmove) {
    this._onmove = onmove;
    this.slider = slider({
      min: "0", max: "0", value: "0", "aria-label": "Iteration", testid: "fit-iterations",
      oninput: () => this.step(Number(this.slider.value) - this.index),
    });
    this.player = button("Play the iterations", {
      icon: "play", iconOnly: true, small: true, shortcut: "P", testid: "fit-play", onclick: () => this.toggle(),
    });
    this.text = h("p.small.muted.fit-iteration-text");
    this.plot = svg("svg", {
      viewBox: `0 0 ${WIDTH} ${HEIGHT}`, class: "fit-plot", role: "img", "aria-label": "Cost by iteration",
    });
    this.plot.addEventListener("pointerdown", (event) => this._pick(event));
    this.plot.addEventListener("pointermove", (event) => event.buttons & 1 && this._pick(event));
    this.element = h("div.column.fit-iterations",
      this.plot, h("div.row.fit-play-row", this.player, this.slider), this.text);
    this.show([]);
  }

  get last() { return this.iterations.length - 1; }

  show(iterations) {
    this.pause();
    this.iterations = iterations;
    this.index = Math.max(0, this.last);
    this._turns = this.iterations.some(({ theta_deg: theta }) => theta !== this.iterations[0].theta_deg);
    this.slider.max = String(Math.max(0, this.last));
    this.slider.disabled = this.player.disabled = this.iterations.length < 2;
    this._draw();
    this._mark();
  }

  _go(index) {
    if (!this.iterations.length) return;
    this.index = Math.min(Math.max(index, 0), this.last);
    this._mark();
    this._onmove(this.index, this.index === this.last);
  }

  step(by) {
    this.pause();
    this._go(this.index + by);
  }

  toggle() {
    if (this._timer) return this.pause();
    if (this.iterations.length < 2) return;
    if (this.index === this.last) this._go(0);
    this.pause(setInterval(() => {
      this._go(this.index + 1);
      if (this.index === this.last) this.pause();
    }, STEP));
  }

  /** Pause, or play by a timer. */
  pause(timer = null) {
    clearInterval(this._timer);
    this._timer = timer;
    this.player.replaceChildren(icon(timer ? "pause" : "play"));
    this.player.setAttribute("aria-label", timer ? "Pause" : "Play the iterations");
  }

  _draw() {
    const { iterations, last } = this;
    const across = (i) => MARGIN + (last > 0 ? i / last : 0.5) * (WIDTH - 2 * MARGIN);
    this._points = relativeCosts(iterations).map((cost, i) => [across(i), MARGIN + (1 - cost) * (HEIGHT - 2 * MARGIN)]);
    this._cursor = svg("line", { class: "cursor", y1: 0, y2: HEIGHT });
    this._dot = svg("circle", { class: "dot-now", r: 3.5 });
    const starts = indicesOf(iterations).filter((i) => iterations[i].level !== iterations[i - 1]?.level);
    const edges = [...starts.map((i) => (i ? across(i - 0.5) : -1)), WIDTH]; // of levels; the first is out of sight
    const drawn = starts.flatMap((start, k) => [
      svg("line", { class: "between", x1: edges[k], x2: edges[k], y1: 0, y2: HEIGHT }),
      svg("polyline", { points: this._points.slice(start, starts[k + 1]).join(" "), class: "cost" }),
      // Costs decrease, so the top right of each level is free.
      svg("text", { x: edges[k + 1] - 5, y: 12, class: "level", "text-anchor": "end" },
        starts.length > 1 && edges[k + 1] - edges[k] > 36 ? `level ${iterations[start].level}` : ""),
    ]);
    const dots = this._points.map(([cx, cy]) => svg("circle", { cx, cy, r: 1.6, class: "cost-point" }));
    this.plot.replaceChildren(...dots, ...drawn, ...(dots.length ? [this._cursor, this._dot] : []));
  }

  _mark() {
    this.slider.value = String(this.index);
    const now = this.iterations[this.index];
    this.text.textContent = "The iterations of a fit appear here.";
    if (!now) return;
    const [x, y] = this._points[this.index];
    this._cursor.setAttribute("transform", `translate(${x} 0)`);
    this._dot.setAttribute("transform", `translate(${x} ${y})`);
    // Methods that do not estimate the angle keep it constant.
    const theta = now.theta_deg == null || !this._turns ? "" : ` · θ ${now.theta_deg.toFixed(1)}°`;
    const text = `${this.index} of ${this.last} · level ${now.level} · cost ${significant(now.cost)}${theta}`;
    this.text.textContent = text;
    this.slider.setAttribute("aria-valuetext", `iteration ${text}`);
  }

  _pick({ clientX }) {
    const { left, width } = this.plot.getBoundingClientRect();
    const share = (((clientX - left) / width) * WIDTH - MARGIN) / (WIDTH - 2 * MARGIN);
    this.step(Math.round(share * this.last) - this.index);
  }
}

/** Cost of each iteration from 0 to 1, within its level, since costs of other levels are not comparable. */
export function relativeCosts(iterations) {
  return iterations.map(({ level, cost }) => {
    const ofLevel = iterations.filter((other) => other.level === level);
    const costs = ofLevel.map((other) => other.cost).filter(Number.isFinite);
    const [low, high] = [Math.min(...costs), Math.max(...costs)];
    return high > low && Number.isFinite(cost) ? (cost - low) / (high - low) : 0;
  });
}
