// Graphs over time beside the picture of the Live tab: a distance of two points, the pose, and the quality.

import { distanceOf, firstPair } from "./live-track.js";
import { attempt } from "./unsaved.js";
import { h, relist } from "./ui.js";

const LIBRARY = "../vendor/uplot/uPlot.esm.js"; // uPlot: https://github.com/leeoniya/uPlot
const LATELY = 30; // seconds of a camera that are shown
const [HEIGHT, AXIS] = [50, 18]; // css pixels
const KEY = "liaam-studio:live-distance"; // the pair of points that was chosen last
const MOUTH = ["upper_lip_bottom", "lower_lip_top"]; // its opening, in the model of faces that comes with liaam
const NOTE = "Roll is the turn in the picture from the model's mean shape. Turns to the side and nods are not measured.";

export class LiveGraphs {
  /** @type {App} */
  #app;
  #seek;
  #pair = null; // the two points of the distance, by index
  #graphs;
  #ends; // lists of the two points of the distance
  #model = null; // number of the model whose points these offer
  #range = [0, 1]; // seconds that are shown
  #now = null; // seconds where a line is drawn, or null

  /** seek(time): a click on a graph of a video. @param {App} app */
  constructor(app, seek) {
    this.#app = app;
    this.#seek = seek;
    this.#ends = ["From", "To"].map((label) => h("select.text", {
      "aria-label": `${label} point`, testid: `live-${label.toLowerCase()}`, onchange: () => this.#choose(),
    }));
    this.#graphs = [
      { name: "Distance", unit: " px", of: (frame) => distanceOf(this.#pair)(frame), more: this.#ends },
      { name: "Roll", unit: "°", of: ({ roll }) => roll },
      { name: "Size", unit: " px", of: ({ size }) => size },
      { name: "Quality", unit: " %", of: ({ quality }) => (quality === null ? null : 100 * quality), range: [0, 100] },
    ].map((graph) => ({ ...graph, chart: null, value: h("span.number"), plot: h("div.live-graph", { role: "img" }) }));
    this.element = h("section.panel.live-graphs", { "aria-label": "Over time" },
      this.#graphs.map(({ name, value, plot, more }) =>
        [h("div.row.tight.small", h("span.grow", name), value), more && h("div.row.tight", more), plot]),
      h("p.small.muted", NOTE));
  }

  get pair() { return this.#pair; }

  show(on) { this.element.hidden = !on; }

  /** Offer the points of a model that is new. */
  offer(/** @type {Model | null} */ model) {
    if (!model || model.number === this.#model) return;
    this.#model = model.number;
    const names = Array.from({ length: model.n_points }, (_, i) => model.names[i] ?? `point ${i + 1}`);
    const kept = (key) => attempt(() => JSON.parse(localStorage.getItem(key)));
    const measures = this.#app.state.project.measuring.measures.join(" ");
    this.#pair = firstPair(names, [kept(KEY), /distance:(.+?)-(\S+)/.exec(measures)?.slice(1), MOUTH].filter(Boolean));
    this.#ends.forEach((select, end) => relist(select, { ...names }, String(this.#pair[end])));
    this.#name();
  }

  /** A long name is cut off in its list, and whole beside the pointer. */
  #name() { for (const select of this.#ends) select.title = select.selectedOptions[0]?.textContent ?? ""; }

  #choose() {
    this.#pair = this.#ends.map(({ value }) => Number(value));
    this.#name();
    localStorage.setItem(KEY, JSON.stringify(this.#ends.map(({ selectedOptions: [option] }) => option.textContent)));
  }

  /** Draw the track of a source. It has no width while the tab is hidden. */
  async draw({ video, isFile }, track) {
    const width = this.#graphs[0].plot.clientWidth;
    if (!width || !this.#pair || !track.rows.size) return;
    const { default: Plot } = await import(LIBRARY);
    const now = isFile ? video.currentTime : track.end;
    this.#range = isFile ? [0, video.duration || 1] : [now - LATELY, now];
    this.#now = isFile ? now : null; // where a line is drawn
    const [times, ...all] = track.graphs(this.#graphs.map(({ of }) => of), this.#range[0]);
    this.#graphs.forEach((graph, i) => {
      graph.chart ??= new Plot(this.#options(graph), [[], []], graph.plot);
      if (graph.chart.width !== width) graph.chart.setSize({ width, height: graph.chart.height });
      graph.chart.setData([times, all[i]]);
      const at = graph.chart.cursor.idx ?? times.findLastIndex((time) => time <= now + 1e-3); // at the pointer, or now
      graph.value.textContent = all[i][at] == null ? "–" : `${all[i][at].toFixed(1)}${graph.unit}`;
      graph.plot.setAttribute("aria-label", `${graph.name} over time: ${graph.value.textContent}`);
    });
  }

  #options(graph) {
    const style = getComputedStyle(this.element);
    const colour = (name) => () => style.getPropertyValue(`--${name}`);
    const axis = {
      stroke: colour("muted"), font: "11px Inter, system-ui, sans-serif", gap: 2, ticks: { show: false },
      grid: { stroke: colour("line"), width: 1 },
    };
    const secondsOf = (tick) => (this.#now === null ? Math.round(tick - this.#range[1]) : tick);
    const seconds = (_, ticks) => ticks.map((tick) => `${secondsOf(tick)} s`);
    const below = graph === this.#graphs.at(-1) ? { size: AXIS, values: seconds } : { size: 0, values: () => [] };
    return {
      width: 0, height: HEIGHT + below.size, padding: [6, 12, 4, 0], legend: { show: false },
      scales: { x: { time: false, range: () => this.#range }, y: { range: graph.range ?? widened } },
      axes: [{ ...axis, ...below, space: 60 }, { ...axis, size: 40, space: 18 }],
      series: [{}, { stroke: colour("accent"), width: 1.5, points: { show: false } }],
      cursor: { sync: { key: "liaam" }, y: false, drag: { x: false }, points: { size: 6 } },
      hooks: {
        init: [({ over, posToVal, cursor }) => {
          over.addEventListener("click", () => this.#now !== null && this.#seek(posToVal(cursor.left, "x")));
        }],
        draw: [({ ctx, bbox: { top, height }, valToPos }) => {
          ctx.fillStyle = colour("text")();
          if (this.#now !== null) ctx.fillRect(Math.round(valToPos(this.#now, "x", true)), top, devicePixelRatio, height);
        }],
      },
    };
  }
}

/** A range with some room, so that noise does not fill a graph. */
function widened(_chart, low, high) {
  const [middle, half] = [(low + high) / 2, Math.max((high - low) / 2, 1)];
  return [middle - 1.1 * half, middle + 1.1 * half];
}
