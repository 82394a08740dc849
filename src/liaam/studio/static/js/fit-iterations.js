// The iterations of a fit: a slider, a play button, and a plot of the cost.

import { significant } from "./fit-run.js";
import { button, h, icon, slider, svg } from "./ui.js";

const [WIDTH, HEIGHT] = [264, 58];
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
    const runs = costRuns(this.iterations, WIDTH, HEIGHT, 6);
    this._points = runs.flatMap(({ points }) => points);
    this._cursor = svg("line", { class: "cursor", y1: 0, y2: HEIGHT });
    this._dot = svg("circle", { class: "dot-now", r: 3.5 });
    const drawn = runs.map(({ level, points }, run) => {
      const line = points.map(({ x, y }) => `${x.toFixed(1)},${y.toFixed(1)}`).join(" ");
      const left = run ? (points[0].x + runs[run - 1].points.at(-1).x) / 2 : 0;
      const next = runs[run + 1];
      const right = next ? (points.at(-1).x + next.points[0].x) / 2 : WIDTH;
      const label = runs.length > 1 && right - left > 36 ? `level ${level}` : "";
      return svg("g", {},
        ...(run ? [svg("line", { class: "between", x1: left, x2: left, y1: 0, y2: HEIGHT })] : []),
        svg("polyline", { points: line, class: "cost" }),
        ...points.map(({ x, y }) => svg("circle", { cx: x, cy: y, r: 1.6, class: "cost-point" })),
        // Costs decrease, so the top right of each level is free.
        svg("text", { x: right - 5, y: 12, class: "level", "text-anchor": "end" }, label));
    });
    this.plot.replaceChildren(...drawn, ...(this.iterations.length ? [this._cursor, this._dot] : []));
  }

  _mark() {
    this.slider.value = String(this.index);
    const now = this.iterations[this.index];
    this.text.textContent = "The iterations of a fit appear here.";
    if (!now) return;
    const { x, y } = this._points[this.index];
    this._cursor.setAttribute("transform", `translate(${x} 0)`);
    this._dot.setAttribute("transform", `translate(${x} ${y})`);
    // Methods that do not estimate the angle keep it constant.
    const theta = now.theta_deg == null || !this._turns ? "" : ` · θ ${now.theta_deg.toFixed(1)}°`;
    const text = `${this.index} of ${this.last} · level ${now.level} · cost ${significant(now.cost)}${theta}`;
    this.text.textContent = text;
    this.slider.setAttribute("aria-valuetext", `iteration ${text}`);
  }

  _pick(event) {
    if (!this.iterations.length) return;
    const box = this.plot.getBoundingClientRect();
    const x = ((event.clientX - box.left) / box.width) * WIDTH;
    const nearest = this._points.reduce((best, each) => (Math.abs(each.x - x) < Math.abs(best.x - x) ? each : best));
    this.step(nearest.index - this.index);
  }
}

/** Curves of the cost by iteration, for a plot. Costs are comparable within a level only, so each has a scale. */
export function costRuns(iterations, width, height, margin = 4) {
  const n = iterations.length;
  const across = (i) => (n > 1 ? margin + (i * (width - 2 * margin)) / (n - 1) : width / 2);
  const runs = [];
  iterations.forEach(({ level, cost }, index) => {
    if (runs.at(-1)?.level !== level) runs.push({ level, points: [] });
    runs.at(-1).points.push({ index, cost });
  });
  for (const run of runs) {
    const costs = run.points.map((p) => p.cost).filter(Number.isFinite);
    const [low, high] = [Math.min(...costs), Math.max(...costs)];
    for (const point of run.points) {
      const relative = high > low && Number.isFinite(point.cost) ? (point.cost - low) / (high - low) : 0;
      point.x = across(point.index);
      point.y = height - margin - relative * (height - 2 * margin);
    }
  }
  return runs;
}
