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
  /** seek(time): a click on a graph of a video. @param {App} app */
  constructor(app, seek) {
    this.app = app;
    this.seek = seek;
    this._ends = ["From", "To"].map((label) => h("select.text", {
      "aria-label": `${label} point`, testid: `live-${label.toLowerCase()}`, onchange: () => this._choose(),
    }));
    this._graphs = [
      { name: "Distance", unit: " px", of: (frame) => distanceOf(this.pair)(frame), more: this._ends },
      { name: "Roll", unit: "°", of: ({ roll }) => roll },
      { name: "Size", unit: " px", of: ({ size }) => size },
      { name: "Quality", unit: " %", of: ({ quality }) => (quality === null ? null : 100 * quality), range: [0, 100] },
    ].map((graph) => ({ ...graph, chart: null, value: h("span.number"), plot: h("div.live-graph", { role: "img" }) }));
    this.element = h("section.panel.live-graphs", { "aria-label": "Over time" },
      this._graphs.map(({ name, value, plot, more }) =>
        [h("div.row.tight.small", h("span.grow", name), value), more && h("div.row.tight", more), plot]),
      h("p.small.muted", NOTE));
  }

  /** Offer the points of a model that is new. */
  offer(/** @type {Model | null} */ model) {
    if (!model || model.number === this._model) return;
    this._model = model.number;
    const names = Array.from({ length: model.n_points }, (_, i) => model.names[i] ?? `point ${i + 1}`);
    const kept = (key) => attempt(() => JSON.parse(localStorage.getItem(key)));
    const [measures] = kept(`liaam-studio:measures:${this.app.state.project.id}`) ?? []; // those of Measure
    this.pair = firstPair(names, [kept(KEY), /distance:(.+?)-(\S+)/.exec(measures)?.slice(1), MOUTH].filter(Boolean));
    this._ends.forEach((select, end) => relist(select, { ...names }, String(this.pair[end])));
  }

  _choose() {
    this.pair = this._ends.map(({ value }) => Number(value));
    localStorage.setItem(KEY, JSON.stringify(this._ends.map(({ selectedOptions: [option] }) => option.textContent)));
  }

  /** Draw the track of a source. It has no width while the tab is hidden. */
  async draw({ video, isFile }, track) {
    const width = this._graphs[0].plot.clientWidth;
    if (!width || !this.pair || !track.rows.size) return;
    const { default: Plot } = await import(LIBRARY);
    const now = isFile ? video.currentTime : track.end;
    this._range = isFile ? [0, video.duration || 1] : [now - LATELY, now];
    this._now = isFile ? now : null; // where a line is drawn
    const [times, ...all] = track.graphs(this._graphs.map(({ of }) => of), this._range[0]);
    this._graphs.forEach((graph, i) => {
      graph.chart ??= new Plot(this._options(graph), [[], []], graph.plot);
      if (graph.chart.width !== width) graph.chart.setSize({ width, height: graph.chart.height });
      graph.chart.setData([times, all[i]]);
      const at = graph.chart.cursor.idx ?? times.findLastIndex((time) => time <= now + 1e-3); // at the pointer, or now
      graph.value.textContent = all[i][at] == null ? "–" : `${all[i][at].toFixed(1)}${graph.unit}`;
      graph.plot.setAttribute("aria-label", `${graph.name} over time: ${graph.value.textContent}`);
    });
  }

  _options(graph) {
    const style = getComputedStyle(this.element);
    const colour = (name) => () => style.getPropertyValue(`--${name}`);
    const axis = {
      stroke: colour("muted"), font: "11px Inter, system-ui, sans-serif", gap: 2, ticks: { show: false },
      grid: { stroke: colour("line"), width: 1 },
    };
    const secondsOf = (tick) => (this._now === null ? Math.round(tick - this._range[1]) : tick);
    const seconds = (_, ticks) => ticks.map((tick) => `${secondsOf(tick)} s`);
    const below = graph === this._graphs.at(-1) ? { size: AXIS, values: seconds } : { size: 0, values: () => [] };
    return {
      width: 0, height: HEIGHT + below.size, padding: [6, 12, 4, 0], legend: { show: false },
      scales: { x: { time: false, range: () => this._range }, y: { range: graph.range ?? widened } },
      axes: [{ ...axis, ...below, space: 60 }, { ...axis, size: 40, space: 18 }],
      series: [{}, { stroke: colour("accent"), width: 1.5, points: { show: false } }],
      cursor: { sync: { key: "liaam" }, y: false, drag: { x: false }, points: { size: 6 } },
      hooks: {
        init: [({ over, posToVal, cursor }) => {
          over.addEventListener("click", () => this._now !== null && this.seek(posToVal(cursor.left, "x")));
        }],
        draw: [({ ctx, bbox: { top, height }, valToPos }) => {
          ctx.fillStyle = colour("text")();
          if (this._now !== null) ctx.fillRect(Math.round(valToPos(this._now, "x", true)), top, devicePixelRatio, height);
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
